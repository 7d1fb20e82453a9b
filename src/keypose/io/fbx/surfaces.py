"""FBX meshes as parts: polygons cut into triangles, corners joined to vertices, clusters turned into skins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keypose.arrays import Floats, Ints
from keypose.errors import FormatError
from keypose.io.fbx.hierarchy import Hierarchy, affine
from keypose.io.guarded import Record, sane
from keypose.io.normals import smooth_normals
from keypose.io.notes import Notes
from keypose.io.polygons import distinct, triangulate
from keypose.model import Mesh, Skin, SkinningMethod

LINEAR, RIGID, DUAL_QUATERNION, BLENDED = range(4)
DQ_ATTRIBUTE = "_DUAL_QUATERNION"
_WEIGHT_TOLERANCE = 1e-4
# Shares of the surface whose normals point inwards: above the one the normals are of another shape or order than the
# faces (some exporters store those of a posed mesh), above the other the faces are turned.
_CONTRADICTING, _TURNED = 0.06, 0.92


@dataclass(frozen=True, slots=True)
class Surface:
    """The part of a mesh that has one material: its triangles, and the control point of each vertex."""

    slot: int  # which of the node's materials
    mesh: Mesh
    control_points: Ints
    control_point_count: int


class Surfaces:
    """The meshes of a file, each cut and joined once."""

    def __init__(self, record: Record, unit_m: float, notes: Notes) -> None:
        self._record, self._unit_m, self._notes = record, unit_m, notes
        self._built: dict[int, list[Surface]] = {}

    def surfaces(self, mesh: int, where: str) -> list[Surface]:
        """The parts of a mesh in the order of their materials."""
        if mesh not in self._built:
            self._built[mesh] = self._build(self._record.facts["meshes"][mesh], where)
        return self._built[mesh]

    def _build(self, item: Mapping[str, Any], where: str) -> list[Surface]:
        array = self._record.array
        positions = array(item["positions"], 3)
        corners, faces = array(item["corners"]), array(item["faces"], 2)
        if not sane(positions):
            raise FormatError("a vertex position is impossible", where=where)
        positions = positions * self._unit_m
        if len(corners) and int(corners.max()) >= len(positions):
            raise FormatError(f"vertex {int(corners.max())} does not exist; there are {len(positions)}", where=where)
        if len(faces) and int(faces.astype(np.int64).sum(axis=1).max()) > len(corners):
            raise FormatError("a face has more corners than there are", where=where)
        triangles, face_of = triangulate(positions, corners, faces, where)
        if len(face_of) == 0:
            self._notes.add(f"{where}: it has no faces and was left out")
            return []
        if item["generated_normals"]:
            self._notes.add(f"{where}: it has no normals; smooth ones were computed")
        if item["caches"]:
            self._notes.add(f"{where}: a vertex cache moves it; it lies in another file and was not read")
        if item["subdivision"]:
            self._notes.add(f"{where}: it is shown as a subdivision surface; its cage was read")
        columns = self._columns(item, len(corners), where)
        triangles = self._agreeing(positions, corners, triangles, columns, where)
        slots = array(item["face_materials"])
        slot_of = slots[face_of] if len(slots) == len(faces) else np.zeros(len(face_of), np.uint32)
        return [
            self._surface(int(slot), positions, corners, triangles[slot_of == slot], columns)
            for slot in np.unique(slot_of)
        ]

    def _columns(self, item: Mapping[str, Any], corner_count: int, where: str) -> dict[str, NDArray[np.float32]]:
        """What differs from corner to corner, by its name in a mesh."""
        wanted: list[tuple[str, Any, int]] = [("normals", item["normals"], 3), ("colors", item["colors"], 4)]
        wanted += [("uvs" if n == 0 else f"TEXCOORD_{n}", layer, 2) for n, layer in enumerate(item["uvs"])]
        columns: dict[str, NDArray[np.float32]] = {}
        for name, layer, width in wanted:
            if layer is None:
                continue
            values, indices = self._record.array(layer["values"], width), self._record.array(layer["indices"])
            if len(indices) != corner_count or (len(indices) and int(indices.max()) >= len(values)):
                self._notes.add(f"{where}: its {name} do not fit its corners and were dropped")
                continue
            with np.errstate(over="ignore"):
                found = values[indices].astype(np.float32)
            if not np.all(np.isfinite(found)):
                self._notes.add(f"{where}: its {name} hold numbers that are not finite and were dropped")
                continue
            if width == 2:
                found[:, 1] = 1 - found[:, 1]  # the origin is at the top here, at the bottom in FBX
            columns[name] = found
        return columns

    def _agreeing(
        self, positions: Floats, corners: Ints, triangles: Ints, columns: dict[str, NDArray[np.float32]], where: str
    ) -> Ints:
        """The triangles; normals that contradict them are replaced, and triangles that contradict all normals turned."""
        normals = columns.get("normals")
        if normals is None:
            return triangles
        a, b, c = (positions[corners[triangles[:, i]]] for i in range(3))
        faces = np.cross(b - a, c - a)
        against = np.sum(faces[:, None] * normals[triangles], axis=-1) < 0
        share = float(against.mean(axis=1) @ (size := np.linalg.norm(faces, axis=1))) / max(float(size.sum()), 1e-300)
        if share > _TURNED:
            volume = float(np.sum((a - positions.mean(axis=0)) * faces))
            what = "normals point inwards" if volume > 0 else "faces are inside out"
            self._notes.add(f"{where}: its {what}; they were turned")
            if volume <= 0:
                return triangles[:, ::-1]
            columns["normals"] = -normals
            return triangles
        if share > _CONTRADICTING:
            self._notes.add(f"{where}: its normals contradict {share:.0%} of its faces; smooth ones were computed")
            sums = np.zeros_like(positions)
            for i in range(3):
                np.add.at(sums, corners[triangles[:, i]], faces)
            columns["normals"] = sums[corners].astype(np.float32)
        return triangles

    def _surface(
        self,
        slot: int,
        positions: Floats,
        corners: Ints,
        triangles: Ints,
        columns: Mapping[str, NDArray[np.float32]],
    ) -> Surface:
        used = np.unique(triangles)
        rows = [corners[used].astype(np.uint32)[:, None]]
        rows += [np.ascontiguousarray(c[used] + np.float32(0)).view(np.uint32) for c in columns.values()]
        first, inverse = distinct(np.concatenate(rows, axis=1))
        order = np.lexsort((first, corners[used[first]]))  # as the control points are, so that they keep their order
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        vertex_of_corner = np.zeros(int(used.max()) + 1, np.int32)
        vertex_of_corner[used] = rank[inverse]
        corner = used[first[order]]
        control_points = corners[corner].astype(np.int64)
        indices = vertex_of_corner[triangles]
        attributes = {name: values[corner] for name, values in columns.items()}
        points = positions[control_points].astype(np.float32)
        normals = attributes.pop("normals", None)
        mesh = Mesh(
            points,
            indices,
            smooth_normals(points, indices) if normals is None else _unit(normals, points, indices),
            attributes.pop("uvs", None),
            attributes.pop("colors", None),
            attributes,
        )
        return Surface(slot, mesh, control_points, len(positions))


def _unit(normals: NDArray[np.float32], points: NDArray[np.float32], triangles: Ints) -> NDArray[np.float32]:
    lengths = np.linalg.norm(normals.astype(np.float64), axis=1)
    known = lengths > 1e-12
    result = (normals / np.where(known, lengths, 1.0)[:, None]).astype(np.float32)
    if not np.all(known):
        result[~known] = smooth_normals(points, triangles)[~known]
    return result


# --- skins ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Binding:
    """A skin of all control points of a mesh."""

    palette: Ints
    joint_from_mesh: Floats
    joints: Ints  # (control points, K)
    weights: Floats
    method: SkinningMethod
    dual_quaternion: Floats | None  # (control points,) where FBX mixes both methods: how much dual quaternions count

    def of(self, control_points: Ints) -> Skin:
        """The skin of some vertices, with as many influences as they need."""
        joints, weights = self.joints[control_points], self.weights[control_points]
        width = max(int(np.max(np.nonzero(weights.any(axis=0))[0], initial=0)) + 1, 1)
        matrices = self.joint_from_mesh.astype(np.float32)
        return Skin(self.palette, matrices, joints[:, :width], weights[:, :width], self.method)


def bind(
    record: Record,
    skins: Sequence[int],
    node: int,
    count: int,
    tree: Hierarchy,
    unit_m: float,
    where: str,
    notes: Notes,
) -> Binding | None:
    """The skin of a mesh of ``count`` control points that a node shows; None where it has none.

    Weights are scaled to the sum 1; control points that no cluster holds follow the node itself.
    """
    if not skins:
        return None
    if len(skins) > 1:
        notes.add(f"{where}: it has {len(skins)} skins; the first was read")
    item = record.facts["skins"][skins[0]]
    palette, matrices = list[int](), list[Floats]()
    rows, columns, values = list[Ints](), list[Ints](), list[Floats]()
    for cluster in item["clusters"]:
        joint = tree.joint_of_node.get(int(cluster["bone"]))
        if joint is None:
            notes.add(f"{where}: a cluster has no bone and was dropped")
            continue
        matrix = affine(cluster["matrix"], unit_m, where)
        vertices, weights = record.array(cluster["vertices"]), record.array(cluster["weights"])
        fits = vertices < count
        possible = (weights >= 0) & (weights < 1e15)
        if len(vertices) != len(weights):
            raise FormatError("its numbers do not fit together", where=f"{where}: cluster {len(palette)}")
        if not (np.all(fits) and np.all(possible)):
            notes.add(f"{where}: impossible weights or vertices of a cluster were dropped")
        keep = fits & possible & (weights > 0)
        rows.append(vertices[keep].astype(np.int64))
        columns.append(np.full(int(keep.sum()), len(palette)))
        values.append(weights[keep])
        palette.append(joint)
        matrices.append(matrix)
    if not palette:
        return None
    vertex, influence, weight = np.concatenate(rows), np.concatenate(columns), np.concatenate(values)
    sums = np.bincount(vertex, weight, count)
    free = np.nonzero(sums <= 0)[0]
    if len(free) and node in tree.joint_of_node:
        notes.add(f"{where}: {len(free)} vertices have no weight; they follow the node")
        palette.append(tree.joint_of_node[node])
        geometry = record.facts["nodes"][node]["geometry"]
        matrices.append(np.eye(4) if geometry is None else affine(geometry, unit_m, where))
    off = np.abs(sums[sums > 0] - 1)
    if len(off) and off.max() > _WEIGHT_TOLERANCE:
        notes.add(
            f"{where}: the weights of {int((off > _WEIGHT_TOLERANCE).sum())} vertices did not sum to 1 "
            f"(by {off.max():.2g}) and were scaled"
        )
    vertex = np.concatenate([vertex, free])
    influence = np.concatenate([influence, np.full(len(free), len(palette) - 1)])
    weight = np.concatenate([weight, np.ones(len(free))])
    joints, weights = _strongest_first(vertex, influence, weight, count)
    return Binding(
        np.array(palette, np.int32),
        np.stack(matrices),
        joints,
        weights,
        SkinningMethod.DUAL_QUATERNION if int(item["method"]) == DUAL_QUATERNION else SkinningMethod.LINEAR,
        _mixture(record, item, count, notes, where),
    )


def _strongest_first(vertex: Ints, influence: Ints, weight: Floats, count: int) -> tuple[Ints, Floats]:
    """Rows of influences (count, K), each sorted by weight and summing to 1."""
    order = np.lexsort((influence, -weight, vertex))
    vertex, influence, weight = vertex[order], influence[order], weight[order]
    numbers = np.bincount(vertex, minlength=count)
    width = max(int(numbers.max(initial=1)), 1)
    if width * count > 200_000_000:
        raise FormatError(f"a vertex has {width:,} influences", where="skin")
    place = np.arange(len(vertex)) - np.repeat(np.cumsum(numbers) - numbers, numbers)
    joints, weights = np.zeros((count, width), np.int32), np.zeros((count, width))
    joints[vertex, place] = influence
    weights[vertex, place] = weight
    sums = weights.sum(axis=1, keepdims=True)
    weights[:, 0] += np.where(sums[:, 0] > 0, 0.0, 1.0)
    return joints, (weights / np.where(sums > 0, sums, 1.0)).astype(np.float32)


def _mixture(record: Record, item: Mapping[str, Any], count: int, notes: Notes, where: str) -> Floats | None:
    """How much dual quaternions count at each control point, where a skin mixes both methods."""
    if int(item["method"]) != BLENDED:
        return None
    amount = np.zeros(count, np.float32)
    vertices, weights = record.array(item["dq_vertices"]), record.array(item["dq_weights"])
    fits = vertices[: len(weights)] < count
    amount[vertices[: len(weights)][fits]] = np.nan_to_num(np.clip(weights[: len(vertices)][fits], 0, 1))
    notes.add(
        f"{where}: it mixes skinning by dual quaternions and by matrices and is shown by matrices; "
        f"the vertex attribute {DQ_ATTRIBUTE} says how much of each was meant"
    )
    return amount
