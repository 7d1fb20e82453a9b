"""Primitives as meshes with their skins and morph targets.

Source: glTF 2.0 Specification, section 3.7 (geometry, skins, morph targets).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keypose.errors import FormatError, MissingExtra
from keypose.io.gltf.accessors import Arrays
from keypose.io.gltf.compression import DracoMesh, unpack_draco
from keypose.io.gltf.items import Document, MeshItem, Primitive, SkinItem
from keypose.io.normals import smooth_normals
from keypose.io.notes import Notes, UniqueNames
from keypose.model import Mesh, MorphSet, Skin

# Weights are left as they are while they sum to 1 within this much per influence (the Khronos validator's limit).
WEIGHT_TOLERANCE = 2e-7
KINDS_OF_MODE = {0: "points", 1: "lines", 2: "lines", 3: "lines"}


@dataclass(frozen=True, slots=True)
class Surface:
    """What one primitive holds, before it is bound to a skin or a node."""

    mesh: Mesh
    morphs: MorphSet | None
    joints: NDArray[np.int32] | None  # (V, K)
    weights: NDArray[np.float32] | None


class Surfaces:
    """The primitives of a document, each built once and shared by all nodes that show it."""

    def __init__(self, document: Document, arrays: Arrays, notes: Notes) -> None:
        self._document, self._arrays, self._notes = document, arrays, notes
        self._built: dict[tuple[int, int], Surface | None] = {}
        self._skins: dict[tuple[int, int, int], Skin] = {}

    def surface(self, mesh: int, primitive: int) -> Surface | None:
        """One primitive; None where it has no triangles."""
        key = (mesh, primitive)
        if key not in self._built:
            item = self._document.meshes[mesh]
            self._built[key] = self._build(item, item.primitives[primitive])
        return self._built[key]

    def skin(self, skin: int, mesh: int, primitive: int, joint_of_node: Mapping[int, int]) -> Skin | None:
        """The binding of one primitive to one skin; None where the primitive has no joints."""
        surface = self.surface(mesh, primitive)
        if surface is None or surface.joints is None or surface.weights is None:
            return None
        key = (skin, mesh, primitive)
        if key not in self._skins:
            item = self._document.skins[skin]
            missing = [n for n in item.joints if n not in joint_of_node]
            if missing:
                raise FormatError(f"nodes[{missing[0]}] is no joint", where=item.where)
            if surface.joints.size and surface.joints.max() >= len(item.joints):
                where = self._document.meshes[mesh].primitives[primitive].where
                raise FormatError(
                    f"joint {int(surface.joints.max())} does not exist; {item.where} has {len(item.joints)}",
                    where=f"{where}.attributes.JOINTS_0",
                )
            palette = np.array([joint_of_node[n] for n in item.joints], np.int32)
            self._skins[key] = Skin(palette, self._inverse_bind(item), surface.joints, surface.weights)
        return self._skins[key]

    def _inverse_bind(self, item: SkinItem) -> NDArray[np.float32]:
        count = len(item.joints)
        if item.inverse_bind is None:
            return np.tile(np.eye(4, dtype=np.float32), (count, 1, 1))
        place = f"{item.where}.inverseBindMatrices"
        matrices = self._arrays.floats(item.inverse_bind, "MAT4", place=place)
        if len(matrices) < count:
            raise FormatError(f"{len(matrices)} matrices for {count} joints", where=place)
        by_rows = matrices[:count].reshape(count, 4, 4).swapaxes(1, 2)
        if np.any(np.abs(by_rows[:, 3] - np.array([0, 0, 0, 1], np.float32)) > 1e-4):
            self._notes.add(f"{place}: the last row of a matrix is not 0 0 0 1")
        return by_rows

    def _build(self, item: MeshItem, primitive: Primitive) -> Surface | None:
        if primitive.mode in KINDS_OF_MODE:
            self._notes.add(f"{primitive.where}: {KINDS_OF_MODE[primitive.mode]} were dropped; only triangles are kept")
            return None
        if "POSITION" not in primitive.attributes:
            self._notes.add(f"{primitive.where}: it has no positions and was dropped")
            return None
        source = _Source(self._document, self._arrays, primitive)
        positions = source.floats("POSITION", "VEC3")
        count = len(positions)
        triangles = self._triangles(source, primitive, count)
        if not len(triangles):
            self._notes.add(f"{primitive.where}: it has no triangles and was dropped")
            return None
        normals = source.floats("NORMAL", "VEC3") if "NORMAL" in primitive.attributes else None
        authored_normals = normals is not None
        if normals is None:
            self._notes.add(f"{primitive.where}: it has no normals; smooth ones were computed")
            normals = smooth_normals(positions, triangles)
        uvs = source.floats("TEXCOORD_0", "VEC2") if "TEXCOORD_0" in primitive.attributes else None
        colors = _rgba(source.floats("COLOR_0", "VEC3", "VEC4")) if "COLOR_0" in primitive.attributes else None
        attributes: dict[str, NDArray[Any]] = {}
        for name in primitive.attributes:
            if name in ("POSITION", "NORMAL", "TEXCOORD_0", "COLOR_0") or name.startswith(("JOINTS_", "WEIGHTS_")):
                continue
            if name == "TANGENT":
                attributes[name] = source.floats(name, "VEC4")
            elif name.startswith("TEXCOORD_"):
                attributes[name] = source.floats(name, "VEC2")
            elif name.startswith("COLOR_"):
                attributes[name] = _rgba(source.floats(name, "VEC3", "VEC4"))
            else:
                attributes[name] = source.plain(name)
        joints, weights = self._influences(source, primitive)
        mesh = Mesh(positions, triangles, normals, uvs, colors, attributes)
        morphs = self._morphs(item, primitive, count, authored_normals)
        return Surface(mesh, morphs, joints, weights)

    def _triangles(self, source: _Source, primitive: Primitive, count: int) -> NDArray[np.int32]:
        where = f"{primitive.where}.indices"
        if source.draco is not None:
            indices = source.draco.triangles.reshape(-1)
            mode = 4
        else:
            mode = primitive.mode
            if primitive.indices is None:
                indices = np.arange(count, dtype=np.int32)
            else:
                item = self._arrays.expect(primitive.indices, ("SCALAR",), where)
                if "u" not in item.component:
                    raise FormatError("expected unsigned integers", where=where)
                indices = self._arrays.passing(primitive.indices)[:, 0]
        if len(indices) and int(indices.max()) >= count:
            raise FormatError(f"vertex {int(indices.max())} does not exist; there are {count}", where=where)
        if mode == 4:
            if len(indices) % 3:
                self._notes.add(f"{where}: {len(indices)} corners are no whole triangles; the rest was dropped")
            triangles = indices[: len(indices) // 3 * 3].reshape(-1, 3)
        elif mode == 5:
            triangles = _strip(indices)
        else:
            triangles = _fan(indices)
        owned = np.empty(triangles.shape, np.int32)
        owned[:] = triangles
        owned.flags.writeable = False
        return owned

    def _influences(
        self, source: _Source, primitive: Primitive
    ) -> tuple[NDArray[np.int32] | None, NDArray[np.float32] | None]:
        sets = 0
        while f"JOINTS_{sets}" in primitive.attributes and f"WEIGHTS_{sets}" in primitive.attributes:
            sets += 1
        odd = [n for n in primitive.attributes if n.startswith(("JOINTS_", "WEIGHTS_")) and n[-1:] >= str(sets)]
        if odd and sets < 10:
            self._notes.add(f"{primitive.where}: {', '.join(odd)} have no counterpart and were dropped")
        if sets == 0:
            return None, None
        joints = [source.integers(f"JOINTS_{s}", "VEC4") for s in range(sets)]
        weights = [source.floats(f"WEIGHTS_{s}", "VEC4") for s in range(sets)]
        numbers = joints[0].astype(np.int32) if sets == 1 else np.concatenate(joints, axis=1, dtype=np.int32)
        numbers.flags.writeable = False
        together = weights[0] if sets == 1 else np.concatenate(weights, axis=1)
        return numbers, self._normalized(together, primitive.where)

    def _normalized(self, weights: NDArray[np.float32], where: str) -> NDArray[np.float32]:
        if weights.min(initial=0) < 0:
            self._notes.add(
                f"{where}: {int(np.sum(np.any(weights < 0, axis=1)))} vertices have negative weights, taken as 0"
            )
            weights = np.maximum(weights, np.float32(0))
        quick = weights @ np.ones(weights.shape[1], np.float32)
        if len(quick) and quick.min() >= 1 - WEIGHT_TOLERANCE and quick.max() <= 1 + WEIGHT_TOLERANCE:
            return weights
        sums = weights[:, 0].astype(np.float64)
        for column in range(1, weights.shape[1]):  # many times quicker than NumPy's sum over a short axis
            sums += weights[:, column]
        if np.abs(sums - 1).max(initial=0) <= WEIGHT_TOLERANCE:
            return weights
        empty = sums <= 0
        if np.any(empty):
            self._notes.add(f"{where}: {int(empty.sum())} vertices have no weight; they follow their first joint")
            weights = weights.copy()
            weights[empty] = 0
            weights[empty, 0] = 1
            sums = np.where(empty, 1.0, sums)
        off = np.abs(sums - 1) > WEIGHT_TOLERANCE * np.maximum((weights > 0).sum(axis=1), 1)
        if np.any(off):
            worst = float(np.max(np.abs(sums - 1)))
            if worst > 1e-4:
                self._notes.add(
                    f"{where}: the weights of {int(off.sum())} vertices did not sum to 1 (by {worst:.2g}) and were scaled"
                )
            weights = np.where(off[:, None], weights / sums[:, None], weights).astype(np.float32)
        return weights

    def _morphs(self, item: MeshItem, primitive: Primitive, count: int, authored_normals: bool) -> MorphSet | None:
        if not primitive.targets:
            return None
        names = target_names(item, self._notes)
        starts, vertices = [0], list[NDArray[np.integer[Any]]]()
        positions, normals = list[NDArray[np.float32]](), list[NDArray[np.float32]]()
        any_normals = False
        zero = np.zeros((1, 3), np.float32)
        for number, target in enumerate(primitive.targets):
            where = f"{primitive.where}.targets[{number}]"
            rows, position, normal = self._deltas(target, where, count, authored_normals)
            dropped = [n for n in target if n not in ("POSITION", "NORMAL")]
            if dropped:
                self._notes.add(f"{item.where}: morph deltas of {', '.join(dropped)} were dropped")
            self._arrays.take(len(rows) * 28, where)
            vertices.append(rows)
            positions.append(np.broadcast_to(zero, (len(rows), 3)) if position is None else position)
            normals.append(np.broadcast_to(zero, (len(rows), 3)) if normal is None else normal)
            any_normals |= normal is not None
            starts.append(starts[-1] + len(rows))
        return MorphSet(
            names,
            np.array(starts),
            np.concatenate(vertices, dtype=np.int32),
            np.concatenate(positions),
            np.concatenate(normals) if any_normals else None,
        )

    def _deltas(
        self, target: Mapping[str, int], where: str, count: int, authored_normals: bool
    ) -> tuple[NDArray[np.integer[Any]], NDArray[np.float32] | None, NDArray[np.float32] | None]:
        """The vertices that a target moves, and the deltas of their positions and normals where it has them."""
        for name in ("POSITION", "NORMAL"):
            if name in target and (found := self._document.accessors[target[name]].count) != count:
                raise FormatError(f"{found} deltas for {count} vertices", where=f"{where}.{name}")
        names = [name for name in ("POSITION", "NORMAL") if name in target and (name == "POSITION" or authored_normals)]
        few = [self._arrays.rows(target[name], place=f"{where}.{name}") for name in names]
        kept = [pair for pair in few if pair is not None]
        if kept and len(kept) == len(few):  # only the vertices that move are stored; no more is taken up
            indices, deltas = _joined(kept)
        else:
            indices = None
            deltas = [self._arrays.floats(target[name], "VEC3", place=f"{where}.{name}") for name in names]
        moved = _moved(count if indices is None else len(indices), deltas)
        if len(moved) < (count if indices is None else len(indices)):
            deltas = [values[moved] for values in deltas]
            indices = moved if indices is None else indices[moved]
        elif indices is None:
            indices = moved
        by_name = dict(zip(names, deltas, strict=True))
        return indices, by_name.get("POSITION"), by_name.get("NORMAL")


class _Source:
    """Where a primitive's attributes come from: accessors, or Draco's data."""

    def __init__(self, document: Document, arrays: Arrays, primitive: Primitive) -> None:
        self._document, self._arrays, self._primitive = document, arrays, primitive
        self._count = document.accessors[primitive.attributes["POSITION"]].count
        self.draco = self._unpacked()
        if self.draco is not None:
            where = f"{primitive.where}.attributes.POSITION"
            positions = self._array("POSITION", where)
            self._count = len(positions)

    def _unpacked(self) -> DracoMesh | None:
        packed, primitive = self._primitive.draco, self._primitive
        if packed is None:
            return None
        accessors = [*primitive.attributes.values(), *([] if primitive.indices is None else [primitive.indices])]
        try:
            return unpack_draco(bytes(self._arrays.view(packed.view)), packed.where)
        except MissingExtra:  # the file may hold the same data uncompressed
            if any(self._document.accessors[a].view is None for a in accessors):
                raise
            return None

    def _array(self, name: str, where: str, passing: bool = False) -> NDArray[Any]:
        packed = self._primitive.draco
        if self.draco is not None and packed is not None and name in packed.attributes:
            unique = packed.attributes[name]
            if unique not in self.draco.attributes:
                raise FormatError(f"the Draco data has no attribute {unique}", where=where)
            array = self.draco.attributes[unique]
            array = array if array.ndim == 2 else array.reshape(len(array), -1)
            if array.dtype.kind == "f" and not np.all(np.isfinite(array)):
                raise FormatError("the Draco data holds numbers that are not finite", where=where)
            return array
        accessor = self._primitive.attributes[name]
        return self._arrays.passing(accessor) if passing else self._arrays.array(accessor)

    def _checked(self, name: str, kinds: Sequence[str], passing: bool = False) -> tuple[NDArray[Any], bool]:
        where = f"{self._primitive.where}.attributes.{name}"
        item = self._arrays.expect(self._primitive.attributes[name], tuple(kinds), where)
        array = self._array(name, where, passing)
        widths = {{"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}.get(kind, 0) for kind in kinds}
        if widths and array.shape[1] not in widths:
            raise FormatError(f"expected {' or '.join(kinds)}, got {array.shape[1]} components", where=where)
        if len(array) != self._count:
            raise FormatError(f"{len(array)} elements for {self._count} vertices", where=where)
        return array, item.normalized

    def floats(self, name: str, *kinds: str) -> NDArray[np.float32]:
        """An attribute as float32."""
        array, normalized = self._checked(name, kinds)
        if self.draco is None:
            where = f"{self._primitive.where}.attributes.{name}"
            return self._arrays.floats(self._primitive.attributes[name], *kinds, place=where)
        return self._arrays.as_floats(array, normalized)

    def integers(self, name: str, *kinds: str) -> NDArray[Any]:
        """An attribute of unsigned integers, where it lies in the file."""
        array, _ = self._checked(name, kinds, passing=True)
        if array.dtype.kind == "f" and np.array_equal(array, np.round(array)) and array.min(initial=0) >= 0:
            array = array.astype(np.uint32)  # some exporters write joint numbers as floats
        if array.dtype.kind != "u" or array.max(initial=0) > 65535:
            where = f"{self._primitive.where}.attributes.{name}"
            raise FormatError("expected unsigned integers of 8 or 16 bits", where=where)
        return array

    def plain(self, name: str) -> NDArray[Any]:
        """An attribute of the file's own, as it is; normalised integers as float32."""
        array, normalized = self._checked(name, ())
        return self._arrays.as_floats(array, True) if normalized else array


def target_names(item: MeshItem, notes: Notes) -> tuple[str, ...]:
    """Unique names of a mesh's morph targets."""
    count = len(item.primitives[0].targets) if item.primitives else 0
    given = item.target_names
    if given is not None and len(given) != count:
        notes.add(f"{item.where}: {len(given)} target names for {count} morph targets")
    unique = UniqueNames()
    names: list[str] = []
    for number in range(count):
        name = given[number] if given is not None and number < len(given) and given[number] else f"target_{number}"
        names.append(unique.add(name))
        if names[-1] != name:
            notes.add(f"{item.where}: morph target '{name}' appears more than once; one became '{names[-1]}'")
    return tuple(names)


def _joined(
    pairs: Sequence[tuple[NDArray[Any], NDArray[np.float32]]],
) -> tuple[NDArray[Any], list[NDArray[np.float32]]]:
    """The rows (N,) that any of several sparse arrays has, and the values (N, 3) of each there."""
    first = pairs[0][0]
    if all(np.array_equal(indices, first) for indices, _ in pairs[1:]):
        return first, [values for _, values in pairs]
    rows = np.unique(np.concatenate([indices for indices, _ in pairs]))
    spread: list[NDArray[np.float32]] = []
    for indices, values in pairs:
        whole = np.zeros((len(rows), 3), np.float32)
        whole[np.searchsorted(rows, indices)] = values
        spread.append(whole)
    return rows, spread


def _moved(count: int, deltas: Sequence[NDArray[np.float32]]) -> NDArray[np.intp]:
    """Which vertices any of the deltas (V, 3) moves."""
    moved = np.zeros(count, bool)
    for delta in deltas:
        for column in range(3):
            moved |= delta[:, column] != 0
    return np.nonzero(moved)[0]


def _rgba(colors: NDArray[np.float32]) -> NDArray[np.float32]:
    if colors.shape[1] == 4:
        return colors
    return np.concatenate([colors, np.ones((len(colors), 1), np.float32)], axis=1)


def _strip(indices: NDArray[np.int32]) -> NDArray[np.int32]:
    i = np.arange(max(len(indices) - 2, 0))
    return np.stack([indices[i], indices[i + 1 + i % 2], indices[i + 2 - i % 2]], axis=-1).reshape(-1, 3)


def _fan(indices: NDArray[np.int32]) -> NDArray[np.int32]:
    i = np.arange(max(len(indices) - 2, 0))
    first = np.broadcast_to(indices[:1], i.shape) if len(i) else indices[i]
    return np.stack([indices[i + 1], indices[i + 2], first], axis=-1).reshape(-1, 3)
