"""What server and browser say to each other, as dataclasses.

The TypeScript twins in ``client/src/generated/messages.ts`` are generated from this file (`keypose.studio.typescript`);
a test keeps the two equal. Every message and every scene travels in one binary container (`keypose.studio.container`):
a JSON header, which is one of these dataclasses, and aligned arrays, which the header names by `ArrayRef`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

PROTOCOL = 1
"""Version of the messages; the client refuses another one and says so."""

Element = Literal["float32", "float64", "uint8", "uint16", "uint32", "int32"]


@dataclass(frozen=True, slots=True)
class ArrayRef:
    """An array in the body of the container: bytes ``offset`` to ``offset + bytes``, row-major."""

    offset: int
    bytes: int
    element: Element
    shape: list[int]


# ---- a scene ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SkeletonData:
    """Joints, parents before children; rest translations (J, 3), rotations (J, 4) wxyz, scales (J, 3)."""

    names: list[str]
    parents: ArrayRef
    translations: ArrayRef
    rotations: ArrayRef
    scales: ArrayRef
    end_joints: list[int]
    end_offsets: ArrayRef


@dataclass(frozen=True, slots=True)
class PictureData:
    """An encoded picture, as the file held it."""

    name: str
    mime_type: str
    bytes: ArrayRef


@dataclass(frozen=True, slots=True)
class MaterialData:
    """A surface; colours are linear."""

    name: str
    base_color: list[float]
    metallic: float
    roughness: float
    emissive: list[float]
    image: int | None
    alpha_mode: str
    alpha_cutoff: float
    double_sided: bool
    unlit: bool


@dataclass(frozen=True, slots=True)
class SkinData:
    """Palette (P,), inverse bind matrices (P, 4, 4), four influences per vertex (V, 4) into the palette."""

    palette: ArrayRef
    joint_from_mesh: ArrayRef
    joints: ArrayRef
    weights: ArrayRef


@dataclass(frozen=True, slots=True)
class MorphData:
    """Sparse delta targets; target m moves ``vertices[starts[m]:starts[m + 1]]`` and is driven by ``channels[m]``."""

    channels: ArrayRef
    starts: ArrayRef
    vertices: ArrayRef
    position_deltas: ArrayRef
    normal_deltas: ArrayRef | None


@dataclass(frozen=True, slots=True)
class PartData:
    """One mesh: skinned, or bound to one joint."""

    name: str
    material: MaterialData
    positions: ArrayRef
    triangles: ArrayRef
    normals: ArrayRef | None
    uvs: ArrayRef | None
    colors: ArrayRef | None
    skin: SkinData | None
    joint: int | None
    morphs: MorphData | None


@dataclass(frozen=True, slots=True)
class CharacterData:
    """A skeleton with its parts and morph channels."""

    name: str
    skeleton: SkeletonData
    parts: list[PartData]
    morph_names: list[str]
    rest_morph_weights: ArrayRef
    roles: dict[str, int]


@dataclass(frozen=True, slots=True)
class CurveData:
    """Keyframes of one property; the client evaluates them exactly as `keypose.evaluate.sample_curve` does.

    Times (K,) float64, values and tangents (K, C) in the precision of the file, modes (K,).
    """

    target: str
    property: Literal["translation", "rotation", "scale", "weight"]
    times: ArrayRef
    values: ArrayRef
    modes: ArrayRef
    in_tangents: ArrayRef | None
    out_tangents: ArrayRef | None
    before: str
    after: str


@dataclass(frozen=True, slots=True)
class ClipData:
    """Sparse animation: curves."""

    kind: Literal["clip"]
    name: str
    start_s: float
    duration_s: float
    rate_hz: float | None
    curves: list[CurveData]


@dataclass(frozen=True, slots=True)
class MotionData:
    """Dense animation: arrays of T frames; an array that does not change is sent once, with one frame."""

    kind: Literal["motion"]
    name: str
    start_s: float
    duration_s: float
    rate_hz: float
    frames: int
    joint_names: list[str]
    translations: ArrayRef
    rotations: ArrayRef
    scales: ArrayRef
    morph_names: list[str]
    morph_weights: ArrayRef | None


@dataclass(frozen=True, slots=True)
class SceneData:
    """All that the browser needs of one opened file; the header of ``GET api/scenes/{id}``."""

    type: Literal["scene"]
    id: str
    name: str
    format: str
    unit_m: float
    up: str
    notes: list[str]
    images: list[PictureData]
    characters: list[CharacterData]
    animations: list[ClipData | MotionData]


# ---- server to browser -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SceneEntry:
    """A scene that can be fetched, and how many bytes it is."""

    id: str
    name: str
    bytes: int


@dataclass(frozen=True, slots=True)
class Hello:
    """First message of a connection: what is open now."""

    type: Literal["hello"]
    protocol: int
    version: str
    upload_limit_bytes: int
    scenes: list[SceneEntry]
    expected: int
    """How many scenes will be there once those still being prepared are ready."""


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


ServerMessage = Hello | SceneReady | SceneClosed | Progress | Failure | Notice


@dataclass(frozen=True, slots=True)
class Envelope:
    """A server message and its number; the browser acknowledges the number."""

    sequence: int
    message: ServerMessage


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


ClientMessage = Acknowledge | CloseScene | OpenSample


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
