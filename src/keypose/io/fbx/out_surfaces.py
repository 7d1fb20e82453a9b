"""Parts as FBX geometries with clusters and blend shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.io.fbx.binary import Long, Node, node, properties
from keypose.io.fbx.out_materials import MaterialWriter
from keypose.io.fbx.out_nodes import MESH, Model, Objects, add_model, matrix_values, number, place_of, transform_rows
from keypose.io.fbx.surfaces import DQ_ATTRIBUTE
from keypose.io.notes import Notes
from keypose.model import Character, Part, Skin, SkinningMethod

KEPT_ATTRIBUTES = ("TEXCOORD_", DQ_ATTRIBUTE)


@dataclass(frozen=True, slots=True)
class Group:
    """Parts that are written as one mesh: they share node, skin and morph channels."""

    parts: tuple[Part, ...]
    joint: int | None  # of the node that shows them
    carried: bool = field(default=False)  # by a node of their own, below the joint if there is one

    @property
    def first(self) -> Part:
        """Any of the parts, for what they share."""
        return self.parts[0]


def group_parts(character: Character, notes: Notes) -> list[Group]:
    """The parts of a character in as few meshes as possible, and the nodes that show them."""
    known = {name: joint for joint, name in enumerate(character.skeleton.names)}
    deforming = {int(j) for p in character.parts if p.skin is not None for j in p.skin.palette}
    found: dict[tuple[Any, ...], tuple[int | None, list[Part]]] = {}
    for part in character.parts:
        if not len(part.mesh.triangles):
            notes.add(f"part '{part.name}': it has no triangles and was left out")
            continue
        place = place_of(part.extras)
        joint = part.joint if part.skin is None else known.get(place or "")
        skin = part.skin
        skin_key = skin and (skin.palette.tobytes(), np.asarray(skin.joint_from_mesh).tobytes(), skin.method)
        channels = None if part.morph_channels is None else part.morph_channels.tobytes()
        uvs = sum(name.startswith("TEXCOORD_") for name in part.mesh.attributes)
        layers = (part.mesh.normals is None, part.mesh.uvs is None, part.mesh.colors is None, uvs)
        found.setdefault((part.group, joint, skin_key, channels, layers), (joint, []))[1].append(part)
    taken: set[int] = set()
    groups: list[Group] = []
    for joint, parts in found.values():
        if joint is None or joint in taken or joint in deforming:
            groups.append(Group(tuple(parts), joint if parts[0].skin is None else None, carried=True))
        else:
            taken.add(joint)
            groups.append(Group(tuple(parts), joint))
    return groups


class SurfaceWriter:
    """Writes the meshes of one character."""

    def __init__(self, objects: Objects, materials: MaterialWriter, scale: float, notes: Notes) -> None:
        self._objects, self._materials, self._scale, self._notes = objects, materials, scale, notes
        self.blend_channels: list[tuple[int, int]] = []  # morph channel of the character, number of the blend channel

    def add(self, character: Character, group: Group, models: Sequence[Model], world_from_joint: Floats) -> None:
        """One mesh with everything that hangs on it."""
        first = group.parts[0]
        if group.carried or group.joint is None:
            rows = [*transform_rows((0, 0, 0), (0, 0, 0), (1, 1, 1)), ("keypose_carrier", "bool", "", "U", 1)]
            model = add_model(self._objects, first.name or "mesh", MESH, rows)
            self._objects.connect(model, 0 if group.joint is None else models[group.joint].identity)
        else:
            model = models[group.joint].identity
        world_from_mesh = np.eye(4) if group.joint is None else np.asarray(world_from_joint[group.joint], np.float64)
        geometry = self._geometry(group, model)
        if first.skin is not None:
            self._skin(group, first.skin, geometry, model, models, world_from_mesh, world_from_joint)
        if first.morphs is not None and len(first.morphs.names):
            self._morphs(character, group, geometry)

    def _geometry(self, group: Group, model: int) -> int:
        parts, first = group.parts, group.first
        identity, item = self._objects.add("Geometry", _mesh_name(parts), "Mesh")
        self._objects.connect(identity, model)
        if len(parts) > 1:
            item.children.append(properties([("keypose_parts", "KString", "", "U", "\n".join(p.name for p in parts))]))
        offsets = _offsets(parts)
        positions = np.concatenate([np.asarray(p.mesh.positions, np.float64) for p in parts]) * self._scale
        triangles = np.concatenate([p.mesh.triangles + o for p, o in zip(parts, offsets, strict=False)]).astype(
            np.int32
        )
        corners = triangles.reshape(-1)
        closed = triangles.copy()
        closed[:, 2] = ~closed[:, 2]
        item.add("GeometryVersion", 124)
        item.add("Vertices", positions.reshape(-1))
        item.add("PolygonVertexIndex", closed.reshape(-1))
        layers: list[tuple[str, Node]] = []
        if first.mesh.normals is not None:
            normals = np.concatenate([np.asarray(p.mesh.normals, np.float64) for p in parts])
            layers.append(("LayerElementNormal", _layer("Normal", 0, 101, "", "ByPolygonVertex", "Direct")))
            layers[-1][1].add("Normals", normals[corners].reshape(-1))
        for number_of_layer, name in enumerate(_uv_names(first)):
            uvs = np.concatenate([np.asarray(_uvs(p, name), np.float64) for p in parts])
            uvs = np.stack([uvs[:, 0], 1 - uvs[:, 1]], axis=1)
            layer = _layer("UV", number_of_layer, 101, f"UV{number_of_layer}", "ByPolygonVertex", "IndexToDirect")
            layer.add("UV", uvs.reshape(-1))
            layer.add("UVIndex", corners)
            layers.append(("LayerElementUV", layer))
        if first.mesh.colors is not None:
            colors = np.concatenate([np.asarray(p.mesh.colors, np.float64) for p in parts])
            layer = _layer("Color", 0, 101, "Color", "ByPolygonVertex", "IndexToDirect")
            layer.add("Colors", colors.reshape(-1))
            layer.add("ColorIndex", corners)
            layers.append(("LayerElementColor", layer))
        slots = self._materials.connect([p.material for p in parts], model)
        mapping = "AllSame" if len(set(slots)) == 1 else "ByPolygon"
        layer = _layer("Material", 0, 101, "", mapping, "IndexToDirect")
        each = np.repeat(slots, [len(p.mesh.triangles) for p in parts]).astype(np.int32)
        layer.add("Materials", each if mapping == "ByPolygon" else each[:1])
        layers.append(("LayerElementMaterial", layer))
        item.children += [layer for _, layer in layers]
        item.children += _layer_lists(layers)
        for part in parts:
            dropped = [name for name in part.mesh.attributes if not name.startswith(KEPT_ATTRIBUTES)]
            if dropped:
                self._notes.add(f"part '{part.name}': vertex attributes were dropped: {', '.join(dropped)}")
        return identity

    def _skin(
        self,
        group: Group,
        skin: Skin,
        geometry: int,
        model: int,
        models: Sequence[Model],
        world_from_mesh: Floats,
        world_from_joint: Floats,
    ) -> None:
        parts = group.parts
        deformer, item = self._objects.add("Deformer", _mesh_name(parts), "Skin")
        self._objects.connect(deformer, geometry)
        item.add("Version", 101)
        item.add("Link_DeformAcuracy", 50.0)
        amount = [p.mesh.attributes.get(DQ_ATTRIBUTE) for p in parts]
        if any(a is not None for a in amount):
            filled = [
                np.zeros(p.mesh.vertex_count) if a is None else np.asarray(a, np.float64).reshape(-1)
                for p, a in zip(parts, amount, strict=True)
            ]
            blend = np.concatenate(filled)
            item.add("SkinningType", "Blend")
            item.add("Indexes", np.arange(len(blend), dtype=np.int32))
            item.add("BlendWeights", blend)
        else:
            dual = skin.method is SkinningMethod.DUAL_QUATERNION
            item.add("SkinningType", "DualQuaternion" if dual else "Linear")
        vertex, influence, weight = _influences(parts)
        order = np.argsort(influence, kind="stable")
        bounds = np.searchsorted(influence[order], np.arange(len(skin.palette) + 1))
        pose: dict[int, Floats] = {model: world_from_mesh}
        for k, joint in enumerate(skin.palette.tolist()):
            rows = order[bounds[k] : bounds[k + 1]]
            joint_from_mesh = np.asarray(skin.joint_from_mesh[k], np.float64)
            world_from_bone = self._bind(world_from_mesh, joint_from_mesh, world_from_joint[joint], parts[0].name)
            identity, cluster = self._objects.add("Deformer", f"bone {joint}", "Cluster", "SubDeformer")
            cluster.add("Version", 100)
            cluster.add("UserData", "", "")
            if len(rows):
                cluster.add("Indexes", vertex[rows].astype(np.int32))
                cluster.add("Weights", weight[rows])
            cluster.add("Transform", matrix_values(joint_from_mesh, self._scale))
            cluster.add("TransformLink", matrix_values(world_from_bone, self._scale))
            self._objects.connect(identity, deformer)
            self._objects.connect(models[joint].identity, identity)
            pose.setdefault(models[joint].identity, world_from_bone)
        self._bind_pose(pose, parts[0].name)

    def _bind(self, world_from_mesh: Floats, joint_from_mesh: Floats, at_rest: Floats, name: str) -> Floats:
        """Where the bone was when the mesh was bound."""
        if abs(np.linalg.det(joint_from_mesh[:3, :3])) > 1e-18:
            return world_from_mesh @ np.linalg.inv(joint_from_mesh)
        self._notes.add(
            f"part '{name}': an inverse bind matrix flattens the mesh; the rest pose stands in for its bind pose"
        )
        return np.asarray(at_rest, np.float64)

    def _bind_pose(self, matrices: dict[int, Floats], name: str) -> None:
        _, item = self._objects.add("Pose", name, "BindPose")
        item.add("Type", "BindPose")
        item.add("Version", 100)
        item.add("NbPoseNodes", len(matrices))
        for model, matrix in matrices.items():
            entry = item.add("PoseNode")
            entry.add("Node", Long(model))
            entry.add("Matrix", matrix_values(matrix, self._scale))

    def _morphs(self, character: Character, group: Group, geometry: int) -> None:
        parts = group.parts
        first = parts[0]
        deformer, item = self._objects.add("Deformer", _mesh_name(parts), "BlendShape")
        item.add("Version", 100)
        self._objects.connect(deformer, geometry)
        offsets = _offsets(parts)
        channels = first.morph_channels
        for target in range(len(channels) if channels is not None else 0):
            morph = int(channels[target]) if channels is not None else 0
            name = character.morph_names[morph]
            percent = float(np.asarray(character.rest_morph_weights)[morph]) * 100
            identity, channel = self._objects.add("Deformer", name, "BlendShapeChannel", "SubDeformer")
            channel.add("Version", 100)
            channel.add("DeformPercent", percent)
            channel.add("FullWeights", np.array([100.0]))
            channel.children.append(
                properties([number("DeformPercent", percent), ("keypose_place", "int", "Integer", "U", morph)])
            )
            self._objects.connect(identity, deformer)
            shape, geometry_of_shape = self._objects.add("Geometry", name, "Shape")
            self._objects.connect(shape, identity)
            vertices, positions, normals = _deltas(parts, offsets, target)
            geometry_of_shape.add("Version", 100)
            geometry_of_shape.add("Indexes", vertices)
            geometry_of_shape.add("Vertices", (positions * self._scale).reshape(-1))
            geometry_of_shape.add("Normals", normals.reshape(-1))
            self.blend_channels.append((morph, identity))


def _mesh_name(parts: Sequence[Part]) -> str:
    """The parts' common name: of several, without the number that tells them apart."""
    name = parts[0].name
    return name if len(parts) == 1 else name.removesuffix("_0")


def _offsets(parts: Sequence[Part]) -> list[int]:
    return [0, *np.cumsum([p.mesh.vertex_count for p in parts]).tolist()]


def _uv_names(part: Part) -> list[str]:
    extra = sorted(name for name in part.mesh.attributes if name.startswith("TEXCOORD_"))
    return [*(["uvs"] if part.mesh.uvs is not None else []), *extra]


def _uvs(part: Part, name: str) -> Any:
    return part.mesh.uvs if name == "uvs" else part.mesh.attributes[name]


def _layer(kind: str, index: int, version: int, name: str, mapping: str, reference: str) -> Node:
    layer = node(f"LayerElement{kind}", index)
    layer.add("Version", version)
    layer.add("Name", name)
    layer.add("MappingInformationType", mapping)
    layer.add("ReferenceInformationType", reference)
    return layer


def _layer_lists(layers: Sequence[tuple[str, Node]]) -> list[Node]:
    """The first of each kind in layer 0, the second in layer 1 ..."""
    numbers: dict[str, int] = {}
    lists: list[Node] = []
    for kind, _ in layers:
        index = numbers.get(kind, 0)
        numbers[kind] = index + 1
        while len(lists) <= index:
            lists.append(node("Layer", len(lists)))
            lists[-1].add("Version", 100)
        entry = lists[index].add("LayerElement")
        entry.add("Type", kind)
        entry.add("TypedIndex", index)
    return lists


def _influences(parts: Sequence[Part]) -> tuple[Ints, Ints, Floats]:
    """Vertex, palette entry and weight of every influence; a joint that a vertex names twice has the sum."""
    vertices, influences, weights = list[Ints](), list[Ints](), list[Floats]()
    size = 1
    for part, offset in zip(parts, _offsets(parts), strict=False):
        if part.skin is None:
            continue
        weight = np.asarray(part.skin.weights, np.float64)
        rows, columns = np.nonzero(weight > 0)
        vertices.append(rows + offset)
        influences.append(part.skin.joints[rows, columns].astype(np.int64))
        weights.append(weight[rows, columns])
        size = max(size, len(part.skin.palette))
    vertex, influence, weight = np.concatenate(vertices), np.concatenate(influences), np.concatenate(weights)
    keys, inverse = np.unique(vertex * size + influence, return_inverse=True)
    sums: Floats = np.bincount(inverse.reshape(-1), weight, len(keys)).astype(np.float64)
    return keys // size, keys % size, sums


def _deltas(parts: Sequence[Part], offsets: Sequence[int], target: int) -> tuple[Ints, Floats, Floats]:
    vertices, positions, normals = list[Ints](), list[Floats](), list[Floats]()
    for part, offset in zip(parts, offsets, strict=False):
        morphs = part.morphs
        if morphs is None:
            continue
        rows = slice(int(morphs.starts[target]), int(morphs.starts[target + 1]))
        vertices.append(morphs.vertices[rows] + offset)
        positions.append(np.asarray(morphs.position_deltas[rows], np.float64))
        turned = np.zeros_like(positions[-1]) if morphs.normal_deltas is None else morphs.normal_deltas[rows]
        normals.append(np.asarray(turned, np.float64))
    vertex = np.concatenate(vertices)
    both = np.concatenate([np.concatenate(positions), np.concatenate(normals)], axis=1)
    unique, inverse = np.unique(vertex, return_inverse=True)
    sums = np.zeros((len(unique), 6))
    np.add.at(sums, inverse.reshape(-1), both)
    return unique.astype(np.int32), np.ascontiguousarray(sums[:, :3]), np.ascontiguousarray(sums[:, 3:])
