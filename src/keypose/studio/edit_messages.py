"""The editor's messages: the project as the page knows it, what changed in it, and what a page may ask.

Values have the fields of `keypose.io.native_values`, so that one schema serves the project file, the journal and the
page. Changes come over HTTP (``POST api/project/edit`` and ``api/project/operate``, `EditRequest` and `OperateRequest` as
headers of containers, with JSON answers); everything else goes over the socket. The other messages are in
`keypose.studio.messages`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from keypose.studio.rig_messages import RigData
from keypose.studio.scene_messages import ArrayRef, CurveData, SceneEntry

# ---- the document ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ChannelData:
    """What a curve drives, without the curve."""

    target: str
    property: Literal["translation", "rotation", "euler", "scale", "weight", "value"]
    component: int | None


@dataclass(frozen=True, slots=True)
class ProjectClip:
    """A clip of the project with all its curves."""

    name: str
    rate_hz: float | None
    curves: list[CurveData]
    euler_orders: dict[str, str]


@dataclass(frozen=True, slots=True)
class PlacementData:
    """As `keypose.model.Placement`; curves of time and weight drive no channel."""

    animation: str
    start_s: float
    in_s: float | None
    out_s: float | None
    speed: float
    cycles: float
    fade_in_s: float
    fade_out_s: float
    time_warp: CurveData | None
    weight: CurveData | None
    hold: bool
    muted: bool


@dataclass(frozen=True, slots=True)
class LayerData:
    """As `keypose.model.Layer`; ``joints`` is empty and ``properties`` null for all."""

    name: str
    placements: list[PlacementData]
    mode: Literal["replace", "add"]
    influence: float | CurveData
    joints: dict[str, float]
    properties: list[Literal["translation", "rotation", "euler", "scale", "weight", "value"]] | None
    muted: bool
    solo: bool
    locked: bool


@dataclass(frozen=True, slots=True)
class TimeMarker:
    """A named moment on a timeline."""

    time_s: float
    name: str


@dataclass(frozen=True, slots=True)
class TimelineData:
    """As `keypose.model.Timeline`; layers lowest first."""

    name: str
    layers: list[LayerData]
    rate_hz: float
    start_s: float
    end_s: float
    hold_frames: int
    markers: list[TimeMarker]


@dataclass(frozen=True, slots=True)
class JointTransform:
    """A joint's local transform; rotation wxyz."""

    translation: list[float]
    rotation: list[float]
    scale: list[float]


@dataclass(frozen=True, slots=True)
class PoseData:
    """A pose of the library, by names of joints and morphs."""

    name: str
    joints: dict[str, JointTransform]
    morphs: dict[str, float]


@dataclass(frozen=True, slots=True)
class ProjectCharacter:
    """A character; ``GET api/scenes/{scene.id}`` holds its mesh. ``timeline`` moves it, empty for none."""

    name: str
    scene: SceneEntry
    timeline: str


@dataclass(frozen=True, slots=True)
class OperatorParameter:
    """What an operator asks for; ``unit`` is for people. A joint is its name, empty for the operator's own choice."""

    name: str
    label: str
    kind: Literal["number", "integer", "boolean", "choice", "joint", "text"]
    default: float | bool | str
    low: float | None
    high: float | None
    unit: str
    choices: list[str]
    help: str


@dataclass(frozen=True, slots=True)
class OperatorSpec:
    """An operator as its form is drawn; ``GET api/project/operators`` lists all. ``group``: what has to be selected for it."""

    name: str
    label: str
    group: str
    help: str
    parameters: list[OperatorParameter]


# ---- server to browser -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ProjectStatus:
    """Where the project stands; in every message about it.

    ``revision`` counts every change, undo and redo too; ``saved_revision`` is the one that the file holds, so the project
    is saved where both are equal. ``undo`` and ``redo`` say what would be undone and redone, empty for nothing.
    ``path`` is empty for a project that was never saved. ``unsafe`` says why edits would be lost if the studio ended now; it
    is empty as long as they are journaled.
    """

    name: str
    path: str
    revision: int
    saved_revision: int
    undo: str
    redo: str
    unsafe: str


@dataclass(frozen=True, slots=True)
class Recoverable:
    """A project that was not saved before its studio ended; ``changed_s`` is seconds since 1970."""

    id: str
    name: str
    path: str
    edits: int
    changed_s: float


@dataclass(frozen=True, slots=True)
class ProjectState:
    """The whole project; sent to a page that watches, and whenever another project takes its place."""

    type: Literal["project_state"]
    status: ProjectStatus
    characters: list[ProjectCharacter]
    clips: list[ProjectClip]
    timelines: list[TimelineData]
    poses: list[PoseData]
    rigs: list[RigData]
    settings: dict[str, str | float | bool]
    recoverable: list[Recoverable]
    operators: list[str]
    """Names that `OperateRequest` knows."""
    exports: list[str]
    """Formats that ``GET api/project/export/{format}`` writes."""
    folder: str
    """Where files without a folder are saved."""


@dataclass(frozen=True, slots=True)
class ClipChange:
    """What changed in a clip: its curves now, and channels that have none any more; the clip is made where it was not."""

    name: str
    rate_hz: float | None
    euler_orders: dict[str, str]
    curves: list[CurveData]
    removed: list[ChannelData]


@dataclass(frozen=True, slots=True)
class ProjectChanged:
    """The difference of two documents, and where the project stands now.

    ``edit`` is the id that a page gave its edit, empty for undo, redo and saving; ``label`` says what was done. A renamed
    thing is removed under the old name and there under the new. ``characters`` are all of them where any changed, else
    null, and ``settings`` and ``rigs`` likewise.
    """

    type: Literal["project_changed"]
    status: ProjectStatus
    edit: str
    label: str
    cause: Literal["edit", "undo", "redo", "save"]
    clips: list[ClipChange]
    removed_clips: list[str]
    timelines: list[TimelineData]
    removed_timelines: list[str]
    poses: list[PoseData]
    removed_poses: list[str]
    rigs: list[RigData] | None
    characters: list[ProjectCharacter] | None
    settings: dict[str, str | float | bool] | None


@dataclass(frozen=True, slots=True)
class ProjectNotSaved:
    """A project was not saved, for a reason that a person can decide about; say it again with ``force`` to do it.

    ``exists``: another file is there. ``changed``: the file was changed by something else since it was opened or saved.
    ``locked``: another studio has it open (force does not help). ``failed``: it cannot be written.
    """

    type: Literal["project_not_saved"]
    path: str
    reason: Literal["exists", "changed", "locked", "failed"]
    message: str


@dataclass(frozen=True, slots=True)
class FolderFile:
    """A project in a folder."""

    name: str
    bytes: int
    changed_s: float


@dataclass(frozen=True, slots=True)
class ProjectFolder:
    """What a dialog to open or save shows: the folders and projects of a folder."""

    type: Literal["project_folder"]
    folder: str
    parent: str
    folders: list[str]
    files: list[FolderFile]


ProjectMessage = ProjectState | ProjectChanged | ProjectNotSaved | ProjectFolder

# ---- browser to server, over the socket ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ProjectWatch:
    """Send the project, and from now on what changes in it."""

    type: Literal["project_watch"]


@dataclass(frozen=True, slots=True)
class ProjectNew:
    """Begin a project, with a character where ``character`` is ``sample:NAME`` or the id of a scene.

    What was not saved before stays recoverable, unless ``discard`` says that nobody wants it.
    """

    type: Literal["project_new"]
    name: str
    character: str
    discard: bool


@dataclass(frozen=True, slots=True)
class ProjectOpen:
    """Open a project file instead."""

    type: Literal["project_open"]
    path: str
    discard: bool


@dataclass(frozen=True, slots=True)
class ProjectSave:
    """Save under a path, or where it was saved before (``path`` is null); ``force`` overwrites what is there."""

    type: Literal["project_save"]
    path: str | None
    force: bool


@dataclass(frozen=True, slots=True)
class ProjectUndo:
    """One step back."""

    type: Literal["project_undo"]


@dataclass(frozen=True, slots=True)
class ProjectRedo:
    """One step forward again."""

    type: Literal["project_redo"]


@dataclass(frozen=True, slots=True)
class ProjectRecover:
    """Go on with a project that was not saved before its studio ended."""

    type: Literal["project_recover"]
    id: str


@dataclass(frozen=True, slots=True)
class ProjectDiscard:
    """Nobody wants what could be recovered."""

    type: Literal["project_discard"]
    id: str


@dataclass(frozen=True, slots=True)
class ProjectAddCharacter:
    """Add a built-in character (``sample:human``) or those of an opened scene (its id), each with a timeline and a clip."""

    type: Literal["project_add_character"]
    source: str


@dataclass(frozen=True, slots=True)
class ProjectRemoveCharacter:
    """Remove a character; its timeline and clips stay."""

    type: Literal["project_remove_character"]
    name: str


@dataclass(frozen=True, slots=True)
class ProjectImportClip:
    """Copy an animation of an opened scene (its id, or ``sample:NAME``) into the project, as keys; -1 for all of them."""

    type: Literal["project_import_clip"]
    source: str
    animation: int


@dataclass(frozen=True, slots=True)
class ProjectBrowse:
    """List the projects of a folder; empty for where the studio was started."""

    type: Literal["project_browse"]
    folder: str


ProjectRequest = (
    ProjectWatch
    | ProjectNew
    | ProjectOpen
    | ProjectSave
    | ProjectUndo
    | ProjectRedo
    | ProjectRecover
    | ProjectDiscard
    | ProjectAddCharacter
    | ProjectRemoveCharacter
    | ProjectImportClip
    | ProjectBrowse
)

# ---- browser to server, over HTTP ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SetCurves:
    """Curves of a clip that take the place of those of their channels, and channels that lose theirs.

    A clip that does not exist is made. Euler orders are added to those of the clip.
    """

    kind: Literal["set_curves"]
    clip: str
    curves: list[CurveData]
    removed: list[ChannelData]
    euler_orders: dict[str, str]


@dataclass(frozen=True, slots=True)
class SetClip:
    """A whole clip, in place of the one of its name."""

    kind: Literal["set_clip"]
    clip: ProjectClip


@dataclass(frozen=True, slots=True)
class RemoveClip:
    """Remove a clip and its placements."""

    kind: Literal["remove_clip"]
    name: str


@dataclass(frozen=True, slots=True)
class SetTimeline:
    """A whole timeline, in place of the one of its name; the clips that it places exist, or are made by the same edit."""

    kind: Literal["set_timeline"]
    timeline: TimelineData


@dataclass(frozen=True, slots=True)
class RemoveTimeline:
    """Remove a timeline; characters that it moves are moved by none."""

    kind: Literal["remove_timeline"]
    name: str


@dataclass(frozen=True, slots=True)
class SetPose:
    """A pose of the library, in place of the one of its name."""

    kind: Literal["set_pose"]
    pose: PoseData


@dataclass(frozen=True, slots=True)
class RemovePose:
    """Remove a pose of the library."""

    kind: Literal["remove_pose"]
    name: str


@dataclass(frozen=True, slots=True)
class SetPerformance:
    """Which timeline moves a character; empty for none."""

    kind: Literal["set_performance"]
    character: str
    timeline: str


@dataclass(frozen=True, slots=True)
class Rename:
    """Give something another name; whatever names it follows."""

    kind: Literal["rename"]
    what: Literal["project", "character", "clip", "timeline", "pose"]
    name: str
    to: str


@dataclass(frozen=True, slots=True)
class SetSettings:
    """Settings that an editor keeps with the project; null removes one."""

    kind: Literal["set_settings"]
    settings: dict[str, str | float | bool | None]


EditCommand = (
    SetCurves
    | SetClip
    | RemoveClip
    | SetTimeline
    | RemoveTimeline
    | SetPose
    | RemovePose
    | SetPerformance
    | Rename
    | SetSettings
)


@dataclass(frozen=True, slots=True)
class EditRequest:
    """Header of ``POST api/project/edit``: commands that are one step of undo, all or none.

    ``id``: the page's own, comes back in `ProjectChanged`. ``merge``: quick successive edits of the same key (not empty)
    become one step. All float arrays are float64, modes and tangent types uint8.
    """

    type: Literal["edit"]
    id: str
    label: str
    merge: str
    commands: list[EditCommand]


@dataclass(frozen=True, slots=True)
class KeyChoice:
    """Keys of a channel: indices (N,) uint32, rising; null for all."""

    channel: ChannelData
    keys: ArrayRef | None


@dataclass(frozen=True, slots=True)
class OperateRequest:
    """Header of ``POST api/project/operate``: run an operator on channels of a clip; one step of undo.

    ``channels``: what it works on, all of the clip where the list is empty. ``start_s`` and ``end_s`` bound it in the clip's
    time, null for its ends. ``character`` is the one whose body errors are measured on, empty for none.
    """

    type: Literal["operate"]
    id: str
    operator: str
    clip: str
    character: str
    channels: list[KeyChoice]
    start_s: float | None
    end_s: float | None
    parameters: dict[str, str | float | bool | list[float]]


@dataclass(frozen=True, slots=True)
class EditResult:
    """Answer to an edit or operator, once it cannot be lost any more; ``error`` is empty where it was done.

    ``report``: what an operator says of its work (keys before and after, largest error), to be read by a person.
    """

    id: str
    revision: int
    error: str
    report: str
