"""Parts as meshes, skins and morph targets of a file that is being written.

Source: glTF 2.0 Specification, section 3.7.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keypose.arrays import Ints
from keypose.io.gltf.buffers import Buffers
from keypose.io.gltf.hierarchy import OWN
from keypose.io.gltf.out_materials import MaterialWriter, plain_json
from keypose.io.gltf.surfaces import WEIGHT_TOLERANCE
from keypose.io.normals import smooth_normals
from keypose.io.notes import Notes
from keypose.model import Character, Mesh, Part, Skin, SkinningMethod

# How far normals and tangents may be from unit length before they are scaled; the Khronos validator allows 6.7e-3.
UNIT_TOLERANCE = 6e-3


@dataclass(frozen=True, slots=True)
class MeshGroup:
    """Parts that are written as one mesh: they share node, skin and morph targets."""

    parts: tuple[Part, ...]
    joint: int | None  # the node that shows the mesh, if a joint does

    @property
    def first(self) -> Part:
        """Any of the parts, for what they share."""
        return self.parts[0]


def group_parts(character: Character, notes: Notes) -> list[MeshGroup]:
    """The parts of a character in as few meshes as the format allows."""
    known = {name: joint for joint, name in enumerate(character.skeleton.names)}
    groups: dict[tuple[Any, ...], tuple[int | None, list[Part]]] = {}
    for part in character.parts:
        if not len(part.mesh.triangles):
            notes.add(f"part '{part.name}': it has no triangles and was left out")
            continue
        joint = part.joint if part.skin is None else known.get(str(place_of(part).get("node")))
        key = (part.group, joint, _skin_key(part.skin), *_morph_key(part))
        groups.setdefault(key, (joint, []))[1].append(part)
    return [MeshGroup(tuple(parts), joint) for joint, parts in groups.values()]


def place_of(part: Part) -> Mapping[str, Any]:
    """What the reader noted about where the part was in its file."""
    place = part.extras.get("gltf")
    return place if isinstance(place, Mapping) else {}


def _skin_key(skin: Skin | None) -> tuple[bytes, bytes] | None:
    return None if skin is None else (skin.palette.tobytes(), np.asarray(skin.joint_from_mesh, np.float32).tobytes())


def _morph_key(part: Part) -> tuple[Any, ...]:
    if part.morphs is None or part.morph_channels is None:
        return ((), b"")
    return (part.morphs.names, part.morph_channels.tobytes())


class SurfaceWriter:
    """Collects meshes and skins; shared ones are written once."""

    def __init__(self, buffers: Buffers, materials: MaterialWriter, notes: Notes) -> None:
        self._buffers, self._materials, self._notes = buffers, materials, notes
        self.meshes: list[dict[str, Any]] = []
        self.skins: list[dict[str, Any]] = []
        self._known_meshes: dict[Any, int] = {}
        self._known_skins: dict[Any, int] = {}
        self._attributes: dict[Any, dict[str, int]] = {}
        self._kept: list[object] = []  # what is known by identity must live as long as we know it

    def mesh(self, character: Character, group: MeshGroup) -> int:
        """The number of the mesh that shows these parts."""
        weights: list[float] = []
        if group.first.morph_channels is not None:
            weights = [float(w) for w in np.asarray(character.rest_morph_weights)[group.first.morph_channels]]
        place = place_of(group.first)
        extras: dict[str, Any] = dict(plain_json(place.get("mesh_extras", {}), self._notes, "a mesh"))
        if group.first.morphs is not None:
            extras["targetNames"] = list(group.first.morphs.names)
        key = tuple(
            (
                id(p.mesh),
                id(p.material),
                id(p.morphs),
                None if p.skin is None else (id(p.skin.joints), id(p.skin.weights)),
            )
            for p in group.parts
        )
        key = (key, tuple(weights), str(extras), place.get("mesh"), group.first.name)
        if key not in self._known_meshes:
            name = str(place.get("mesh") or (group.first.name if len(group.parts) == 1 else ""))
            item: dict[str, Any] = {"name": name} if name else {}
            item["primitives"] = [
                self._primitive(p, self._read_name(item, group, i)) for i, p in enumerate(group.parts)
            ]
            if any(weights):
                item["weights"] = weights
            if extras:
                item["extras"] = extras
            self._known_meshes[key] = len(self.meshes)
            self._kept += [value for p in group.parts for value in (p.mesh, p.material, p.morphs, p.skin)]
            self.meshes.append(item)
        return self._known_meshes[key]

    @staticmethod
    def _read_name(item: Mapping[str, Any], group: MeshGroup, number: int) -> str:
        """The name the reader will give the part by itself."""
        base = str(item.get("name", ""))
        return base if len(group.parts) == 1 else f"{base}_{number}"

    def skin(self, skin: Skin, first_node: int) -> int:
        """The number of a skin whose joints start at a node."""
        key = (_skin_key(skin), first_node)
        if key not in self._known_skins:
            matrices = np.array(skin.joint_from_mesh, np.float32)
            matrices[:, 3] = (0, 0, 0, 1)
            columns = np.ascontiguousarray(matrices.swapaxes(1, 2)).reshape(-1, 16)
            self._known_skins[key] = len(self.skins)
            self.skins.append(
                {
                    "joints": [first_node + int(j) for j in skin.palette],
                    "inverseBindMatrices": self._buffers.plain(columns),
                }
            )
        return self._known_skins[key]

    def _primitive(self, part: Part, read_name: str) -> dict[str, Any]:
        mesh = part.mesh
        attributes = dict(self._vertex_attributes(part))
        if part.skin is not None:
            attributes |= self._influences(part, part.skin)
        item: dict[str, Any] = {
            "attributes": attributes,
            "indices": self._buffers.indices(mesh.triangles, mesh.vertex_count),
        }
        material = self._materials.index(part.material)
        if material is not None:
            item["material"] = material
        targets = self._targets(part)
        if targets:
            item["targets"] = targets
        extras = {k: v for k, v in part.extras.items() if k != "gltf"}
        extras = dict(plain_json(extras, self._notes, f"part '{part.name}'"))
        if part.name != read_name:
            extras[OWN] = {"name": part.name}
        if extras:
            item["extras"] = extras
        return item

    def _vertex_attributes(self, part: Part) -> dict[str, int]:
        mesh = part.mesh
        if id(mesh) in self._attributes:
            return self._attributes[id(mesh)]
        self._kept.append(mesh)
        attributes = {"POSITION": self._buffers.vertices(_float32(mesh.positions), bounds=True)}
        if mesh.normals is not None:
            attributes["NORMAL"] = self._buffers.vertices(self._unit_normals(mesh, part.name))
        if mesh.uvs is not None:
            attributes["TEXCOORD_0"] = self._buffers.vertices(_float32(mesh.uvs))
        if mesh.colors is not None:
            attributes["COLOR_0"] = self._buffers.vertices(np.clip(_float32(mesh.colors), 0, 1))
        for name, array in mesh.attributes.items():
            written = self._attribute(name, np.asarray(array), part.name)
            if written is not None:
                attributes[written[0]] = self._buffers.vertices(written[1])
        self._attributes[id(mesh)] = attributes
        return attributes

    def _attribute(self, name: str, array: NDArray[Any], part: str) -> tuple[str, NDArray[Any]] | None:
        array = array.reshape(len(array), -1)
        if name == "TANGENT":
            lengths = np.linalg.norm(array[:, :3].astype(np.float64), axis=1)
            if array.shape[1] != 4 or np.any(np.abs(lengths - 1) > UNIT_TOLERANCE) or np.any(np.abs(array[:, 3]) != 1):
                self._notes.add(f"part '{part}': its tangents are not of unit length and were dropped")
                return None
        if array.shape[1] > 4:
            self._notes.add(f"part '{part}': attribute {name} of {array.shape[1]} components was dropped")
            return None
        kind = array.dtype.str[1:]
        if kind not in ("u1", "i1", "u2", "i2") or not name.startswith("_"):
            array = _float32(array)
        known = name in ("TANGENT",) or name.startswith(("TEXCOORD_", "COLOR_", "_"))
        return (name if known else f"_{name}"), np.ascontiguousarray(array)

    def _unit_normals(self, mesh: Mesh, part: str) -> NDArray[np.float32]:
        normals = _float32(mesh.normals)
        lengths = np.linalg.norm(normals.astype(np.float64), axis=1)
        off = ~(np.abs(lengths - 1) <= UNIT_TOLERANCE)
        if not np.any(off):
            return normals
        self._notes.add(f"part '{part}': {int(off.sum())} normals were not of unit length and were scaled")
        with np.errstate(divide="ignore", invalid="ignore"):
            scaled = normals / lengths[:, None]
        without = off & ~(lengths > 1e-12)
        if np.any(without):
            scaled[without] = smooth_normals(_float32(mesh.positions), mesh.triangles)[without]
        return np.where(off[:, None], scaled, normals).astype(np.float32)

    def _influences(self, part: Part, skin: Skin) -> dict[str, int]:
        if skin.method is not SkinningMethod.LINEAR:
            self._notes.add(f"part '{part.name}': its skin asks for dual quaternions; glTF has linear skins only")
        joints, weights = self._merged(np.asarray(skin.joints), _float32(skin.weights), part.name)
        sets = max(-(-joints.shape[1] // 4), 1)
        padding = ((0, 0), (0, sets * 4 - joints.shape[1]))
        weights = np.pad(weights, padding)
        weights = _summing_to_one(weights)
        joints = np.where(weights > 0, np.pad(joints, padding), 0)
        joints = joints.astype(np.uint8 if len(skin.palette) <= 256 else np.uint16)
        attributes: dict[str, int] = {}
        for number in range(sets):
            columns = slice(4 * number, 4 * number + 4)
            attributes[f"JOINTS_{number}"] = self._buffers.vertices(np.ascontiguousarray(joints[:, columns]))
            attributes[f"WEIGHTS_{number}"] = self._buffers.vertices(np.ascontiguousarray(weights[:, columns]))
        return attributes

    def _merged(self, joints: Ints, weights: NDArray[np.float32], part: str) -> tuple[Ints, NDArray[np.float32]]:
        """No joint twice in one vertex, as the format demands."""
        influences = joints.shape[1]
        twice = np.zeros(len(joints), bool)
        for a in range(influences):
            for b in range(a + 1, influences):
                twice |= (joints[:, a] == joints[:, b]) & (weights[:, a] > 0) & (weights[:, b] > 0)
        if not np.any(twice):
            return joints, weights
        self._notes.add(f"part '{part}': {int(twice.sum())} vertices named a joint twice; its weights were added")
        weights = weights.copy()
        for a in range(influences):
            for b in range(a + 1, influences):
                same = twice & (joints[:, a] == joints[:, b])
                weights[same, a] += weights[same, b]
                weights[same, b] = 0
        return joints, weights

    def _targets(self, part: Part) -> list[dict[str, int]]:
        morphs = part.morphs
        if morphs is None:
            return []
        count = part.mesh.vertex_count
        positions = _float32(morphs.position_deltas)
        normals = None if morphs.normal_deltas is None or part.mesh.normals is None else _float32(morphs.normal_deltas)
        targets: list[dict[str, int]] = []
        for number in range(len(morphs.names)):
            rows = slice(int(morphs.starts[number]), int(morphs.starts[number + 1]))
            vertices, position = _unique_rows(morphs.vertices[rows], positions[rows])
            target = {"POSITION": self._buffers.deltas(vertices, position, count)}
            if normals is not None:
                vertices, normal = _unique_rows(morphs.vertices[rows], normals[rows])
                moved = np.any(normal != 0, axis=1)
                target["NORMAL"] = self._buffers.deltas(vertices[moved], normal[moved], count)
            targets.append(target)
        return targets


def _unique_rows(vertices: Ints, deltas: NDArray[np.float32]) -> tuple[Ints, NDArray[np.float32]]:
    """Each vertex once; a vertex that is moved twice moves by the sum."""
    unique, inverse = np.unique(vertices, return_inverse=True)
    if len(unique) == len(vertices):
        return vertices, deltas
    sums = np.zeros((len(unique), 3))
    np.add.at(sums, inverse, deltas)
    return unique.astype(np.int32), sums.astype(np.float32)


def _summing_to_one(weights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Weights whose sum in single precision, in the order in which readers add them, is within the limit."""
    total = np.zeros(len(weights), np.float32)
    for column in range(4):
        for index in range(column, weights.shape[1], 4):
            total = total + weights[:, index]
    used = np.maximum((weights > 0).sum(axis=1), 1)
    off = np.abs(total.astype(np.float64) - 1) > WEIGHT_TOLERANCE * used
    if not np.any(off):
        return weights
    sums = weights.sum(axis=1, dtype=np.float64)
    empty = sums <= 0
    result = np.where(off[:, None], weights / np.where(empty, 1.0, sums)[:, None], weights).astype(np.float32)
    result[empty, 0] = 1
    return result


def _float32(array: Any) -> NDArray[np.float32]:
    return np.ascontiguousarray(np.asarray(array, np.float32))


def common_root_missing(parents: Sequence[int], skins: Sequence[Skin]) -> bool:
    """Whether a skin's joints hang on several roots, which the format does not allow."""
    root = list(range(len(parents)))
    for joint, parent in enumerate(parents):
        if parent >= 0:
            root[joint] = root[parent]
    return any(len({root[int(j)] for j in skin.palette}) > 1 for skin in skins)
