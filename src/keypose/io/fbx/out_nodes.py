"""Joints as FBX models, and the objects and connections of a file that is being written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from keypose.arrays import Floats
from keypose.io.fbx.binary import Long, Node, node, properties
from keypose.math import euler, quat
from keypose.model import Character

ORDER = "xyz"  # FBX's XYZ: about x first, all about the axes of the parent
LIMB, MESH, NULL = "LimbNode", "Mesh", "Null"


class Objects:
    """The objects of a file with their numbers, and what is connected to what."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.connections: list[Node] = []
        self.counts: dict[str, int] = {}
        self._last = 1_000_000

    def add(self, kind: str, name: str, sub_kind: str, label: str = "") -> tuple[int, Node]:
        """A new object; returns its number and its node. ``label`` is the kind in the name, where it is another one."""
        self._last += 1
        text = name.replace("\x00", " ").replace("\x01", " ") + "\x00\x01" + (label or kind)
        item = node(kind, Long(self._last), text, sub_kind)
        self.nodes.append(item)
        self.counts[kind] = self.counts.get(kind, 0) + 1
        return self._last, item

    def connect(self, child: int, parent: int, name: str = "") -> None:
        """Connect an object to another, or to one of its properties."""
        kind = "OP" if name else "OO"
        self.connections.append(node("C", kind, Long(child), Long(parent), *([name] if name else [])))


def vector(name: str, kind: str, values: Iterable[float], flags: str = "A") -> tuple[Any, ...]:
    """A row of properties with three numbers."""
    return (name, kind, "Vector" if kind.startswith("Vector") else "", flags, *(float(v) for v in values))


def number(name: str, value: float, flags: str = "A") -> tuple[Any, ...]:
    """A row of properties with one number."""
    return (name, "Number", "", flags, float(value))


def degrees(rotations: Floats) -> Floats:
    """FBX's angles (*B, 3) of rotations (*B, 4)."""
    return np.degrees(euler.from_quat(rotations, ORDER))


class Model:
    """A node of the file: its number, its kind and the rotation before its angles."""

    def __init__(self, identity: int, kind: str, pre_rotation: Floats) -> None:
        self.identity, self.kind, self.pre_rotation = identity, kind, pre_rotation


def add_models(
    objects: Objects, character: Character, kinds: Sequence[str], bones: frozenset[int], scale: float
) -> list[Model]:
    """All joints of a character; ``scale`` is file units per metre.

    The rest rotation of a bone is its joint orient (PreRotation), so that its angles are 0 at rest; other nodes have
    theirs as angles.
    """
    skeleton = character.skeleton
    roles = {joint: role for role, joint in character.roles.items()}
    ends = dict(skeleton.end_offsets)
    models: list[Model] = []
    for joint, name in enumerate(skeleton.names):
        kind = kinds[joint]
        rotation = np.asarray(quat.normalize(np.asarray(skeleton.rest.rotations[joint], np.float64)))
        rows = [("InheritType", "enum", "", "", 1)]
        own: list[tuple[Any, ...]] = []
        if joint in bones:
            rows.append(("RotationActive", "bool", "", "", 1))
            rows.append(vector("PreRotation", "Vector3D", degrees(rotation), ""))
            pre, turned = rotation, np.zeros(3)
        else:
            pre, turned = np.array([1.0, 0, 0, 0]), degrees(rotation)
        translation = np.asarray(skeleton.rest.translations[joint], np.float64) * scale
        if joint in roles:
            own.append(("keypose_role", "KString", "", "U", roles[joint]))
        if joint in ends:
            own.append(vector("keypose_end_site", "Vector", [float(e) * scale for e in ends[joint]], "U"))
        model = add_model(
            objects, name, kind, [*rows, *transform_rows(translation, turned, skeleton.rest.scales[joint]), *own]
        )
        parent = int(skeleton.parents[joint])
        objects.connect(model, models[parent].identity if parent >= 0 else 0)
        models.append(Model(model, kind, pre))
    return models


def transform_rows(
    translation: Iterable[float], angles: Iterable[float], scales: Iterable[float]
) -> list[tuple[Any, ...]]:
    """The rows of a local transform."""
    return [
        vector("Lcl Translation", "Lcl Translation", translation),
        vector("Lcl Rotation", "Lcl Rotation", angles),
        vector("Lcl Scaling", "Lcl Scaling", scales),
    ]


def add_model(objects: Objects, name: str, kind: str, rows: Sequence[Sequence[Any]]) -> int:
    """A model and, if it is no mesh, its attribute; returns its number."""
    identity, item = objects.add("Model", name, kind)
    item.add("Version", 232)
    item.children.append(properties(rows))
    item.add("Shading", True)
    item.add("Culling", "CullingOff")
    if kind != MESH:
        attribute, node_of_attribute = objects.add("NodeAttribute", name, kind)
        if kind == LIMB:
            node_of_attribute.children.append(properties([("Size", "double", "Number", "", 1.0)]))
        node_of_attribute.add("TypeFlags", "Skeleton" if kind == LIMB else "Null")
        objects.connect(attribute, identity)
    return identity


def matrix_values(matrix: Floats, scale: float) -> Floats:
    """A matrix as FBX stores it: column after column, its translation in file units."""
    scaled = np.array(matrix, np.float64)
    scaled[:3, 3] *= scale
    return np.ascontiguousarray(scaled.T).reshape(-1)


def place_of(extras: Mapping[str, Any]) -> str | None:
    """The node that showed a part in the file that it came from."""
    for kind in ("fbx", "gltf"):
        place = extras.get(kind)
        if isinstance(place, Mapping) and isinstance(place.get("node"), str):
            return place["node"]
    return None
