"""Small FBX files made node by node, and the reference vertices that authoring tools have exported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from keypose.io.fbx.binary import Long, Node, encode, node, properties

TICKS_PER_S = 46_186_158_000
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)


@dataclass
class FbxFile:
    """A file under way; what is not said has the defaults of Maya: cm, Y up, 24 Hz."""

    settings: dict[str, Any] = field(default_factory=dict)
    objects: list[Node] = field(default_factory=list)
    connections: list[Node] = field(default_factory=list)
    last: int = 100

    def add(self, kind: str, name: str, sub_kind: str, label: str = "", rows: Sequence[Any] = ()) -> tuple[int, Node]:
        self.last += 1
        item = node(kind, Long(self.last), f"{name}\x00\x01{label or kind}", sub_kind)
        if rows:
            item.children.append(properties(rows))
        self.objects.append(item)
        return self.last, item

    def connect(self, child: int, parent: int, name: str = "") -> None:
        self.connections.append(node("C", "OP" if name else "OO", Long(child), Long(parent), *([name] if name else [])))

    def model(self, name: str, parent: int = 0, kind: str = "Mesh", **values: Any) -> int:
        """A node; ``values`` are properties such as ``Lcl_Translation=(1, 0, 0)`` or ``RotationOrder=3``."""
        rows = []
        for key, value in values.items():
            key = key.replace("_", " ")
            if isinstance(value, tuple):
                rows.append((key, key if key.startswith("Lcl") else "Vector3D", "", "A", *(float(v) for v in value)))
            else:
                rows.append((key, "enum", "", "", int(value)))
        identity, _ = self.add("Model", name, kind, rows=rows)
        self.connect(identity, parent)
        return identity

    def mesh(self, *models: int, positions: Any = SQUARE, polygons: Sequence[Sequence[int]] = ((0, 1, 2, 3),)) -> int:
        identity, item = self.add("Geometry", "mesh", "Mesh")
        corners = [v if k < len(p) - 1 else ~v for p in polygons for k, v in enumerate(p)]
        item.add("Vertices", np.asarray(positions, np.float64).reshape(-1))
        item.add("PolygonVertexIndex", np.array(corners, np.int32))
        for model in models:
            self.connect(identity, model)
        return identity

    def curve(
        self,
        target: int,
        prop: str,
        channel: str,
        keys: Sequence[tuple[float, float]],
        layer: int,
        rest: Sequence[float] = (),
    ) -> None:
        """Linear keys of one component of a property; ``rest`` are all components where no curve is."""
        rows = [(f"d|{axis}", "Number", "", "A", float(v)) for axis, v in zip("XYZ", rest, strict=False)]
        rows = rows or [(channel, "Number", "", "A", float(keys[0][1]))]
        curve_node, _ = self.add("AnimationCurveNode", prop, "", "AnimCurveNode", rows)
        self.connect(curve_node, layer)
        self.connect(curve_node, target, prop)
        curve, item = self.add("AnimationCurve", "", "", "AnimCurve")
        item.add("Default", float(keys[0][1]))
        item.add("KeyVer", 4008)
        item.add("KeyTime", np.array([round(t * TICKS_PER_S) for t, _ in keys], np.int64))
        item.add("KeyValueFloat", np.array([v for _, v in keys], np.float32))
        item.add("KeyAttrFlags", np.array([4], np.int32))
        item.add("KeyAttrDataFloat", np.zeros(4, np.float32))
        item.add("KeyAttrRefCount", np.array([len(keys)], np.int32))
        self.connect(curve, curve_node, channel)

    def stack(self, name: str, begin: float, end: float) -> int:
        """A stack with one layer, whose number is returned."""
        rows = [("LocalStart", "KTime", "Time", "", Long(round(begin * TICKS_PER_S)))]
        rows.append(("LocalStop", "KTime", "Time", "", Long(round(end * TICKS_PER_S))))
        stack, _ = self.add("AnimationStack", name, "", "AnimStack", rows)
        layer, _ = self.add("AnimationLayer", "layer", "", "AnimLayer")
        self.connect(layer, stack)
        return layer

    def blend_shapes(self, geometry: int, name: str, shapes: Sequence[tuple[float, Any]], weight: float = 0.0) -> int:
        """A blend channel that reaches offsets of all vertices at full weights (percent); returns its number."""
        deformer, _ = self.add("Deformer", "blend", "BlendShape")
        self.connect(deformer, geometry)
        rows = [("DeformPercent", "Number", "", "A", weight)]
        channel, item = self.add("Deformer", name, "BlendShapeChannel", "SubDeformer", rows)
        item.add("FullWeights", np.array([full for full, _ in shapes], np.float64))
        self.connect(channel, deformer)
        for number, (_, offsets) in enumerate(shapes):
            shape, shape_node = self.add("Geometry", f"{name}{number}", "Shape")
            shape_node.add("Indexes", np.arange(len(offsets), dtype=np.int32))
            shape_node.add("Vertices", np.asarray(offsets, np.float64).reshape(-1))
            self.connect(shape, channel)
        return channel

    def save(self, path: Path) -> Path:
        known = {"UpAxis": 1, "UpAxisSign": 1, "FrontAxis": 2, "FrontAxisSign": 1, "CoordAxis": 0, "CoordAxisSign": 1}
        known |= {"UnitScaleFactor": 1.0, "TimeMode": 11, **self.settings}
        rows = [
            (k, "double", "Number", "", v) if isinstance(v, float) else (k, "int", "Integer", "", v)
            for k, v in known.items()
        ]
        header = node("FBXHeaderExtension")
        header.add("FBXVersion", 7400)
        settings = node("GlobalSettings", children=[properties(rows)])
        objects, connections = node("Objects", children=self.objects), node("Connections", children=self.connections)
        path.write_bytes(encode([header, settings, objects, connections]))
        return path


@dataclass(frozen=True)
class Reference:
    """Vertices that an authoring tool has exported at one frame."""

    frame: int
    positions: Any  # (V, 3) in centimetres, or metres from Blender (``position_scale`` is about ufbx's own test)
    conditions: tuple[str, ...]


def reference(path: Path) -> Reference:
    """An OBJ of the data folder, with what its ``# ufbx:`` lines say."""
    positions, conditions = [], []
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("# ufbx:"):
            conditions.append(line.removeprefix("# ufbx:"))
        elif line.startswith("v "):
            positions.append([float(word) for word in line.split()[1:4]])
    frame = path.stem.rpartition("_")[2]
    return Reference(int(frame) if frame.isdigit() else 0, np.array(positions), tuple(conditions))
