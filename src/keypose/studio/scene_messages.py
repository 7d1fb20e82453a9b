"""A scene as the browser gets it: the header of ``GET api/scenes/{id}``, and the reference to an array that all messages use.

The other messages are in `keypose.studio.messages`; how both become TypeScript is in `keypose.studio.typescript`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Element = Literal["float32", "float64", "uint8", "uint16", "uint32", "int32"]


@dataclass(frozen=True, slots=True)
class ArrayRef:
    """An array in the body of the container: bytes ``offset`` to ``offset + bytes``, row-major."""

    offset: int
    bytes: int
    element: Element
    shape: list[int]


@dataclass(frozen=True, slots=True)
class SceneEntry:
    """A scene that can be fetched, and how many bytes it is."""

    id: str
    name: str
    bytes: int


# ---- a scene ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SkeletonData:
    """Joints, parents before children; rest translations (J, 3), rotations (J, 4) wxyz, scales (J, 3).

    The last ``controls`` of them are a rig's, with rest transforms in its own hierarchy.
    """

    names: list[str]
    parents: ArrayRef
    translations: ArrayRef
    rotations: ArrayRef
    scales: ArrayRef
    end_joints: list[int]
    end_offsets: ArrayRef
    controls: int


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
    attributes: dict[str, float]
    roles: dict[str, int]


@dataclass(frozen=True, slots=True)
class CurveData:
    """Keyframes of one property; the client evaluates them exactly as `keypose.evaluate.sample_curve` does.

    Times (K,) float64; values and tangents (K, C) and handles (K, C, 2) in the precision of the file (of a project always
    float64); modes (K,) and tangent types (K, 2) uint8, numbers of `keypose.model.Interpolation` and `Tangent`.
    ``component``: the one that the curve drives alone, else null. The fields are those of `keypose.io.native_values`.
    """

    target: str
    property: Literal["translation", "rotation", "euler", "scale", "weight", "value"]
    component: int | None
    kind: Literal["scalar", "vector", "rotation", "euler", "color", "boolean"]
    times: ArrayRef
    values: ArrayRef
    modes: ArrayRef
    in_tangents: ArrayRef | None
    out_tangents: ArrayRef | None
    in_handles: ArrayRef | None
    out_handles: ArrayRef | None
    types: ArrayRef | None
    before: str
    after: str


@dataclass(frozen=True, slots=True)
class ClipData:
    """Sparse animation: curves; ``euler_orders`` by joint, XYZ for those not named."""

    kind: Literal["clip"]
    name: str
    start_s: float
    duration_s: float
    rate_hz: float | None
    curves: list[CurveData]
    euler_orders: dict[str, str]


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
