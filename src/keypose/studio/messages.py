"""What server and browser say to each other, as dataclasses.

The TypeScript twins in ``client/src/generated/messages.ts`` are generated from this file, `keypose.studio.scene_messages`
and `keypose.studio.edit_messages` (`keypose.studio.typescript`); a test keeps the two equal. Every message and every scene travels in one binary container (`keypose.studio.container`):
a JSON header, which is one of these dataclasses, and aligned arrays, which the header names by `ArrayRef`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from keypose.studio.edit_messages import ProjectMessage, ProjectRequest
from keypose.studio.scene_messages import ArrayRef, MorphData, SceneEntry

PROTOCOL = 3
"""Version of the messages; the client refuses another one and says so."""

# ---- server to browser -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class GraphEntry:
    """An animation graph that can be played."""

    id: str
    name: str


@dataclass(frozen=True, slots=True)
class Hello:
    """First message of a connection: what is open now, and what the page begins with."""

    type: Literal["hello"]
    protocol: int
    version: str
    upload_limit_bytes: int
    scenes: list[SceneEntry]
    expected: int
    """How many scenes will be there once those still being prepared are ready."""
    graphs: list[GraphEntry]
    start: Literal["view", "play", "edit"]
    graph: str
    """Id of the graph that is played first."""
    recoverable: int
    """How many projects were not saved before their studio ended."""


@dataclass(frozen=True, slots=True)
class SceneReady:
    """A scene was opened."""

    type: Literal["scene_ready"]
    scene: SceneEntry


@dataclass(frozen=True, slots=True)
class SceneClosed:
    """A scene was closed."""

    type: Literal["scene_closed"]
    id: str


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a job is; ``fraction`` is None where it cannot be known. A newer one replaces an undelivered older one."""

    type: Literal["progress"]
    job: str
    label: str
    fraction: float | None
    done: bool


@dataclass(frozen=True, slots=True)
class Failure:
    """Something went wrong that a person must read."""

    type: Literal["failure"]
    title: str
    message: str


@dataclass(frozen=True, slots=True)
class Notice:
    """Something a person may want to know."""

    type: Literal["notice"]
    title: str
    message: str


# ---- browser to server -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Acknowledge:
    """All messages up to ``sequence`` were handled; the server may send newer ones."""

    type: Literal["acknowledge"]
    sequence: int


@dataclass(frozen=True, slots=True)
class CloseScene:
    """Forget a scene."""

    type: Literal["close_scene"]
    id: str


@dataclass(frozen=True, slots=True)
class OpenSample:
    """Open a built-in character or performance by its name."""

    type: Literal["open_sample"]
    name: str


@dataclass(frozen=True, slots=True)
class UploadFile:
    """One dropped file: its name (with folders, where a folder was dropped) and bytes."""

    name: str
    bytes: ArrayRef


@dataclass(frozen=True, slots=True)
class Upload:
    """Header of ``POST api/scenes``: files dropped together."""

    type: Literal["upload"]
    files: list[UploadFile]


@dataclass(frozen=True, slots=True)
class UploadResult:
    """Answer to an upload: what was opened, and one line for each file that was not."""

    opened: list[SceneEntry] = field(default_factory=list[SceneEntry])
    errors: list[str] = field(default_factory=list[str])
    graphs: list[GraphEntry] = field(default_factory=list[GraphEntry])


# ---- play, server to browser -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class GraphReady:
    """A graph was opened (again, where its id is known)."""

    type: Literal["graph_ready"]
    graph: GraphEntry


@dataclass(frozen=True, slots=True)
class PlayParameter:
    """An input of the graph; ``default`` has one number, or three for a vector."""

    name: str
    kind: Literal["float", "int", "bool", "trigger", "vector"]
    default: list[float]
    minimum: float | None
    maximum: float | None
    half_life_s: float


@dataclass(frozen=True, slots=True)
class PlayNumber:
    """A number of a node: the parameter that gives it, or (``parameter`` is empty) its value."""

    field: str
    parameter: str
    value: float


@dataclass(frozen=True, slots=True)
class PlayTransition:
    """A transition of a state machine, its conditions in words."""

    source: str
    target: str
    kind: Literal["crossfade", "frozen", "inertial", "dead"]
    duration_s: float
    when: str


@dataclass(frozen=True, slots=True)
class PlayNode:
    """A node of the graph's tree, parents before children.

    ``slot``: what it is to its parent (a state's name, ``base``, ``layer``). ``at``: its place in the parent's blend
    space. ``target``: the vector parameter that an aiming node follows.
    """

    name: str
    kind: str
    parent: int
    slot: str
    at: list[float]
    clip: str
    target: str
    sync: str
    mask: str
    numbers: list[PlayNumber]
    states: list[str]
    transitions: list[PlayTransition]
    triangles: list[list[int]]
    """Of a 2D blend space: triples of its children, counted from 0."""


@dataclass(frozen=True, slots=True)
class PlayEventMark:
    """An event of a clip."""

    name: str
    time_s: float


@dataclass(frozen=True, slots=True)
class PlayClip:
    """A clip of the graph."""

    name: str
    duration_s: float
    events: list[PlayEventMark]


@dataclass(frozen=True, slots=True)
class PlayContact:
    """A point that touches the ground."""

    name: str
    joint: int


@dataclass(frozen=True, slots=True)
class PlayReady:
    """A graph plays: everything about it that stays as it is; frames name parts of it by their numbers.

    ``contributors``: what a joint's rotation can come from: the clips, then ``memory`` and ``rest``.
    """

    type: Literal["play_ready"]
    player: int
    graph: GraphEntry
    scene: SceneEntry
    parameters: list[PlayParameter]
    nodes: list[PlayNode]
    clips: list[PlayClip]
    contacts: list[PlayContact]
    contributors: list[str]
    rate_hz: float


@dataclass(frozen=True, slots=True)
class PlayEvent:
    """An event that was fired in a step."""

    name: str
    data: str
    clip: str
    node: str
    weight: float


@dataclass(frozen=True, slots=True)
class PlayChange:
    """A transition that began in a step."""

    machine: str
    source: str
    target: str
    kind: str
    duration_s: float
    interrupted: bool


@dataclass(frozen=True, slots=True)
class PlayFrame:
    """One step of a playing graph.

    ``heard``: the last `PlayInput` that it obeys. ``root``: x, z (metres), yaw (radians). Arrays, all float32: ``pose``
    (J, 10) local translation, rotation wxyz, scale; ``morphs`` (M,); ``contacts`` (E,) 0 to 1; ``parameters`` (P,) as they
    are used, vectors as three; ``shares`` (N,) how much of its parent each node gives; ``phases`` (N,) 0 to 1 for clips,
    -1 for nodes that do not play; ``machines`` (S, 4) state, source, kind (0 none, then in the order of
    `PlayTransition.kind`), share; ``syncs`` (Y, 3) node, marker, share of the way to the next; ``contributions`` (C,) to
    ``joint``, empty for joint -1.
    """

    type: Literal["play_frame"]
    player: int
    number: int
    time_s: float
    dt_s: float
    heard: int
    root: list[float]
    pose: ArrayRef
    morphs: ArrayRef
    contacts: ArrayRef
    parameters: ArrayRef
    shares: ArrayRef
    phases: ArrayRef
    machines: ArrayRef
    syncs: ArrayRef
    joint: int
    contributions: ArrayRef
    events: list[PlayEvent]
    changes: list[PlayChange]
    control_us: float
    pose_us: float
    round_trip_ms: float
    recorded_s: float | None


@dataclass(frozen=True, slots=True)
class PlayTake:
    """A recording was baked; ``GET api/takes/{id}/{format}`` (glb, bvh) gives the file."""

    type: Literal["play_take"]
    player: int
    id: str
    name: str
    frames: int
    rate_hz: float
    duration_s: float


# ---- play, browser to server -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PlayOpen:
    """Play this graph from its first state, instead of what this page played before."""

    type: Literal["play_open"]
    graph: str


@dataclass(frozen=True, slots=True)
class PlayClose:
    """Play nothing."""

    type: Literal["play_close"]


@dataclass(frozen=True, slots=True)
class PlayInput:
    """Set parameters: one number each, three for a vector."""

    type: Literal["play_input"]
    sequence: int
    values: dict[str, list[float]]


@dataclass(frozen=True, slots=True)
class PlayAcknowledge:
    """Frames up to this number were drawn; without it no further steps are made."""

    type: Literal["play_acknowledge"]
    number: int


@dataclass(frozen=True, slots=True)
class PlayPace:
    """How time runs: not at all, slowed down, or as it is."""

    type: Literal["play_pace"]
    paused: bool
    speed: float


@dataclass(frozen=True, slots=True)
class PlayStep:
    """Pause, and make one step of 1/60 s."""

    type: Literal["play_step"]


@dataclass(frozen=True, slots=True)
class PlayReset:
    """Back to the graph's first state at the origin."""

    type: Literal["play_reset"]


@dataclass(frozen=True, slots=True)
class PlayExplain:
    """Say in every frame which clip gives how much of this joint; -1 for none."""

    type: Literal["play_explain"]
    joint: int


@dataclass(frozen=True, slots=True)
class PlayRecord:
    """Begin to record, or stop and bake what was recorded."""

    type: Literal["play_record"]
    on: bool


PlayRequest = (
    PlayOpen | PlayClose | PlayInput | PlayAcknowledge | PlayPace | PlayStep | PlayReset | PlayExplain | PlayRecord
)
"""What goes to the page's own player."""


# ---- crowd: a socket of its own ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class CrowdMaterial:
    """A surface of the crowd's characters; its colour is each character's own."""

    name: str
    roughness: float
    metallic: float
    emissive: list[float]


@dataclass(frozen=True, slots=True)
class CrowdLevel:
    """One level of detail: one mesh with all parts.

    Arrays: ``positions`` and ``normals`` (V, 3) float32; ``triangles`` (F, 3) uint32; ``joints`` (V, 4) uint8, places in
    the level's palette; ``weights`` (V, 4) float32; ``materials`` (V,) uint8; ``shades`` (V, 3) float32, linear, times the
    material's colour; ``morphs`` are the crowd's (`CrowdUpdate.morphs`), or None. ``above``: for characters taller than this
    share of the view. Errors are the largest, in mm.
    """

    positions: ArrayRef
    normals: ArrayRef
    triangles: ArrayRef
    joints: ArrayRef
    weights: ArrayRef
    materials: ArrayRef
    shades: ArrayRef
    morphs: MorphData | None
    palette: int
    joint_count: int
    above: float
    every: int
    error_mm: float
    motion_error_mm: float


@dataclass(frozen=True, slots=True)
class CrowdReady:
    """A crowd stands: everything about it that stays. ``colors``: (N, M, 3) uint8, sRGB, of each character's materials."""

    type: Literal["crowd_ready"]
    crowd: int
    graph: str
    count: int
    radius_m: float
    height_m: float
    unit_m: float
    behaviours: list[str]
    behaviour: str
    materials: list[CrowdMaterial]
    colors: ArrayRef
    morphs: int
    """How many morphs the levels that have any share."""
    levels: list[CrowdLevel]


@dataclass(frozen=True, slots=True)
class CrowdUpdate:
    """Characters of one level whose joints are new: ``who`` (K,) uint16, ``matrices`` (K, P, 12) uint16, to be read as int16.

    ``morphs`` (K, M) uint8: weights of 0 to 1 in 255ths, where the level has morphs.
    """

    who: ArrayRef
    matrices: ArrayRef
    morphs: ArrayRef


@dataclass(frozen=True, slots=True)
class CrowdFrame:
    """One step of a crowd.

    ``roots`` (N, 3) float32: x, z, yaw; ``levels`` (N,) uint8. ``updates`` level by level, empty ones too: skin matrices
    seen from the root, 3x4 by rows, turns in units of 2^-14, places in units of ``unit_m``. Microseconds of the server:
    for all characters.
    """

    type: Literal["crowd_frame"]
    crowd: int
    number: int
    time_s: float
    dt_s: float
    roots: ArrayRef
    levels: ArrayRef
    updates: list[CrowdUpdate]
    steer_us: float
    animate_us: float
    pack_us: float


@dataclass(frozen=True, slots=True)
class CrowdFailure:
    """The crowd cannot be shown, or has stopped."""

    type: Literal["crowd_failure"]
    message: str


CrowdMessage = CrowdReady | CrowdFrame | CrowdFailure


@dataclass(frozen=True, slots=True)
class CrowdOpen:
    """Show a crowd that plays this graph, instead of what this page showed before."""

    type: Literal["crowd_open"]
    graph: str
    count: int
    behaviour: str
    seed: int


@dataclass(frozen=True, slots=True)
class CrowdBehave:
    """Do something else."""

    type: Literal["crowd_behave"]
    behaviour: str


@dataclass(frozen=True, slots=True)
class CrowdPace:
    """How time runs, and how many steps are made in a second."""

    type: Literal["crowd_pace"]
    paused: bool
    speed: float
    rate_hz: float


@dataclass(frozen=True, slots=True)
class CrowdView:
    """Where the camera is: the levels of detail depend on it."""

    type: Literal["crowd_view"]
    eye: list[float]
    fov_deg: float


@dataclass(frozen=True, slots=True)
class CrowdAcknowledge:
    """Frames up to this number were drawn; without it no further steps are made."""

    type: Literal["crowd_acknowledge"]
    number: int


CrowdRequest = CrowdOpen | CrowdBehave | CrowdPace | CrowdView | CrowdAcknowledge


# ---- all of them (the parts above stand alone; what a new part adds is named here) -----------------------------------


ServerMessage = (
    Hello
    | SceneReady
    | SceneClosed
    | Progress
    | Failure
    | Notice
    | GraphReady
    | PlayReady
    | PlayFrame
    | PlayTake
    | ProjectMessage
)


@dataclass(frozen=True, slots=True)
class Envelope:
    """A server message and its number; the browser acknowledges the number."""

    sequence: int
    message: ServerMessage


ClientMessage = Acknowledge | CloseScene | OpenSample | PlayRequest | ProjectRequest
