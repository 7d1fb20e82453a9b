"""Mesh, Skin, MorphSet, Material: what a character looks like."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Any

import numpy as np

from keypose.arrays import Array, Ints, as_float, checked, frozen
from keypose.errors import ShapeError, UnknownName


def _nothing() -> Mapping[str, Any]:
    return {}


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """An encoded picture (PNG or JPEG bytes), or only the name of one that is not there."""

    name: str
    mime_type: str = "image/png"
    data: bytes | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """A surface after glTF's metallic-roughness model; colours are linear RGB(A).

    Textures are `Image` objects; only the base colour's is kept.
    """

    name: str = ""
    base_color: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)
    metallic: float = 0.0
    roughness: float = 0.8
    emissive: tuple[float, float, float] = (0.0, 0.0, 0.0)
    base_color_image: Image | None = None
    alpha_mode: str = "OPAQUE"  # OPAQUE, MASK or BLEND
    alpha_cutoff: float = 0.5
    double_sided: bool = False
    unlit: bool = False
    extras: Mapping[str, Any] = field(default_factory=_nothing)  # what the file said beyond this, kept as it was


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles over V vertices.

    Shapes and units:
        positions: (V, 3) metres.
        triangles: (F, 3) int32, counter-clockwise seen from outside.
        normals: (V, 3) unit, or None.
        uvs: (V, 2), origin at the top left (as glTF), or None.
        colors: (V, 4) linear RGBA 0..1, or None.
        attributes: anything else per vertex, (V, ...), by its glTF name (``TANGENT``, ``TEXCOORD_1``).

    Raises:
        ShapeError: where lengths disagree or a triangle names a vertex that does not exist.
    """

    positions: Array
    triangles: Ints
    normals: Array | None = None
    uvs: Array | None = None
    colors: Array | None = None
    attributes: Mapping[str, Array] = field(default_factory=_nothing)

    def __post_init__(self) -> None:
        positions = checked(as_float(self.positions), ("V", 3), "positions")
        count = len(positions)
        object.__setattr__(self, "positions", frozen(positions))
        triangles = np.asarray(self.triangles)
        # A reshaped array is a view, which would be copied though it is frozen already.
        triangles = frozen(triangles if triangles.ndim == 2 else triangles.reshape(-1, 3), np.int32)
        checked(triangles, ("F", 3), "triangles")
        if len(triangles) and (triangles.min() < 0 or triangles.max() >= count):
            bad = int(triangles.max() if triangles.max() >= count else triangles.min())
            raise ShapeError(f"triangles: vertex {bad} does not exist; the mesh has {count}")
        object.__setattr__(self, "triangles", triangles)
        for name, width in (("normals", 3), ("uvs", 2), ("colors", 4)):
            array = getattr(self, name)
            if array is not None:
                array = checked(as_float(array), (count, width), name, f"{count} positions")
                object.__setattr__(self, name, frozen(array))
        kept: dict[str, Array] = {}
        for name, array in self.attributes.items():
            if len(array) != count:
                raise ShapeError(f"attribute {name}: expected {count} rows to match the positions, got {len(array)}")
            kept[name] = frozen(array)
        object.__setattr__(self, "attributes", MappingProxyType(kept))

    @property
    def vertex_count(self) -> int:
        """V."""
        return len(self.positions)


class SkinningMethod(StrEnum):
    """How the joints that hold a vertex are blended."""

    LINEAR = "linear"  # the weighted sum of their matrices
    DUAL_QUATERNION = "dual_quaternion"  # keeps volume in twists


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """The binding of V vertices to the P joints of a palette, K influences per vertex.

    Shapes and units:
        palette: (P,) int32 indices of skeleton joints.
        joint_from_mesh: (P, 4, 4) inverse bind matrices.
        joints: (V, K) int32 indices into the palette.
        weights: (V, K), each row sums to 1; unused influences have weight 0.
        method: how they are blended (see `keypose.deform.skin`).

    ``palette_matrices = model_from_joint[palette] @ joint_from_mesh`` (see `keypose.deform.skin_matrices`).

    Raises:
        ShapeError: where shapes disagree, an index is out of range, or a weight is negative or not finite.
        UnknownName: for a method that is none.
    """

    palette: Ints
    joint_from_mesh: Array
    joints: Ints
    weights: Array
    method: SkinningMethod = SkinningMethod.LINEAR

    def __post_init__(self) -> None:
        if self.method not in tuple(SkinningMethod):
            raise UnknownName("skinning method", self.method, SkinningMethod)
        object.__setattr__(self, "method", SkinningMethod(self.method))
        palette = frozen(self.palette, np.int32)
        checked(palette, ("P",), "palette")
        matrices = checked(as_float(self.joint_from_mesh), (len(palette), 4, 4), "joint_from_mesh", "the palette")
        joints = frozen(self.joints, np.int32)
        checked(joints, ("V", "K"), "joints")
        weights = checked(as_float(self.weights), tuple(joints.shape), "weights", "joints")
        if joints.size and (joints.min() < 0 or joints.max() >= len(palette)):
            bad = int(joints.max() if joints.max() >= len(palette) else joints.min())
            raise ShapeError(f"joints: influence {bad} is outside the palette of {len(palette)}")
        if isinstance(weights, np.ndarray) and not (np.all(np.isfinite(weights)) and np.all(weights >= 0)):
            raise ShapeError("weights: expected finite numbers >= 0")
        object.__setattr__(self, "palette", palette)
        object.__setattr__(self, "joint_from_mesh", frozen(matrices))
        object.__setattr__(self, "joints", joints)
        object.__setattr__(self, "weights", frozen(weights))

    @property
    def influence_count(self) -> int:
        """K."""
        return int(self.joints.shape[1])


@dataclass(frozen=True, slots=True, eq=False)
class MorphSet:
    """M delta morph targets of one mesh, stored sparsely.

    Target m moves the vertices ``vertices[starts[m]:starts[m + 1]]`` by the rows of the deltas in the same range.

    Shapes and units:
        names: M unique names.
        starts: (M + 1,) int32, rising from 0 to N.
        vertices: (N,) int32.
        position_deltas: (N, 3) metres.
        normal_deltas: (N, 3) or None.
    """

    names: tuple[str, ...]
    starts: Ints
    vertices: Ints
    position_deltas: Array
    normal_deltas: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        if len(set(self.names)) != len(self.names):
            twice = next(n for n in self.names if self.names.count(n) > 1)
            raise ShapeError(f"names: morph target '{twice}' appears more than once")
        starts = frozen(self.starts, np.int32)
        vertices = frozen(self.vertices, np.int32)
        checked(starts, (len(self.names) + 1,), "starts", f"{len(self.names)} morph names")
        checked(vertices, ("N",), "vertices")
        if starts[0] != 0 or starts[-1] != len(vertices) or np.any(np.diff(starts) < 0):
            raise ShapeError(f"starts: expected numbers rising from 0 to {len(vertices)}")
        deltas = checked(as_float(self.position_deltas), (len(vertices), 3), "position_deltas", "vertices")
        object.__setattr__(self, "starts", starts)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "position_deltas", frozen(deltas))
        if self.normal_deltas is not None:
            deltas = checked(as_float(self.normal_deltas), (len(vertices), 3), "normal_deltas", "vertices")
            object.__setattr__(self, "normal_deltas", frozen(deltas))

    @classmethod
    def from_dense(cls, names: tuple[str, ...], position_deltas: Array, normal_deltas: Array | None = None) -> MorphSet:
        """From dense deltas (M, V, 3); vertices that no delta moves are left out."""
        positions = as_float(position_deltas)
        moved = np.any(positions != 0, axis=-1)
        if normal_deltas is not None:
            moved |= np.any(np.asarray(normal_deltas) != 0, axis=-1)
        starts = np.concatenate([[0], np.cumsum(moved.sum(axis=1))])
        return cls(
            names,
            starts,
            np.nonzero(moved)[1],
            positions[moved],
            None if normal_deltas is None else as_float(normal_deltas)[moved],
        )

    def dense(self, vertex_count: int) -> tuple[Array, Array | None]:
        """Dense deltas of positions and normals, (M, V, 3) each."""
        rows = np.repeat(np.arange(len(self.names)), np.diff(self.starts))
        positions = np.zeros((len(self.names), vertex_count, 3), self.position_deltas.dtype)
        positions[rows, self.vertices] = self.position_deltas
        if self.normal_deltas is None:
            return positions, None
        normals = np.zeros_like(positions)
        normals[rows, self.vertices] = self.normal_deltas
        return positions, normals

    def index(self, name: str) -> int:
        """The target's index; raises `UnknownName` with the nearest name."""
        if name not in self.names:
            raise UnknownName("morph target", name, self.names)
        return self.names.index(name)
