"""COLLADA files (1.4 and 1.5): characters with skins, morphs, materials and animation, read and written.

Joints, and nodes that carry meshes or lie above either, become the joints of one skeleton; cameras, lights and helpers are
left out. Animation of any transform becomes curves of translation, rotation and scale. See ``docs/formats/collada.md``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.io.axes import checked_up, unit_in_metres, y_up_rotation
from keypose.io.collada_animation import Animations, clips
from keypose.io.collada_materials import Materials
from keypose.io.collada_meshes import Geometry, Surface, read_geometry
from keypose.io.collada_nodes import decomposed, local_matrices, scene_nodes
from keypose.io.collada_writer import write as write
from keypose.io.collada_xml import Document, Element, attempt, parse_xml
from keypose.io.text import shown
from keypose.math import quat
from keypose.model import Character, MorphSet, Part, Pose, Scene, Skeleton, Skin

__all__ = ["read", "write"]

_MOST_INFLUENCES = 16
_UPS = {"X_UP": "X", "Y_UP": "Y", "Z_UP": "Z"}
_MOST_DENSE = 200_000_000  # numbers of all morph targets together


def read(path: Path, *, unit: str | float | None = None, up: str = "auto") -> Scene:
    """Read a COLLADA file as one character with its clips.

    Shapes and units: ``unit`` is a name ("cm") or metres per file unit and ``up`` is "X", "Y" or "Z", both in place of what
    the file says.

    Raises:
        FormatError: where the XML is not sound or the scene refers to what is not there, with the line.
        UnknownName: for a unit or axis that does not exist.

    Source: COLLADA 1.4.1 and 1.5.0 specifications (Khronos).
    """
    given_unit = None if unit is None else unit_in_metres(unit)
    given_up = None if up == "auto" else checked_up(up)
    document = Document(parse_xml(path))
    unit_m, up_axis = _asset(document)
    reader = _Reader(document, given_unit or unit_m, given_up or up_axis)
    return reader.scene(path.stem)


def _asset(document: Document) -> tuple[float, str]:
    unit = document.root.first("asset", "unit")
    unit_m = 1.0
    if unit is not None and unit.get("meter"):
        try:
            unit_m = float(unit.get("meter").replace(",", "."))
        except ValueError:
            raise unit.error(f"meter: expected a number, found {shown(unit.get('meter'))}") from None
        if not 1e-9 < unit_m < 1e9:
            document.note(f"the unit of {unit_m:g} m makes no sense; taken as 1 m")
            unit_m = 1.0
    elif unit is None:
        document.note("unit: the file names none; taken as m, the format's default")
    up = document.root.first("asset", "up_axis")
    word = up.text.strip().upper() if up is not None else "Y_UP"
    if word not in _UPS:
        document.note(f"up axis: {shown(word)} is none; taken as Y, the format's default")
    return unit_m, _UPS.get(word, "Y")


@dataclass(slots=True, eq=False)
class _Bound:
    """What an instance shows: geometry, its morph targets, its skin, and the node that it is at."""

    node: int
    element: Element
    geometry: Geometry
    morph: _Morph | None = None
    skin: _SkinData | None = None


@dataclass(slots=True, eq=False)
class _Morph:
    names: list[str]
    deltas: list[Floats]  # (P, 3) each
    weights: Floats
    source: Element
    channels: list[str] = field(default_factory=list[str])


@dataclass(slots=True, eq=False)
class _SkinData:
    palette: list[int]  # nodes
    joint_from_mesh: Floats  # (P, 4, 4)
    joints: Ints  # (points, K)
    weights: Floats


class _Reader:
    def __init__(self, document: Document, unit_m: float, up: str) -> None:
        self.document, self.unit_m, self.up = document, unit_m, up
        self.nodes, self.scene_name = scene_nodes(document)
        self.geometries: dict[int, Geometry | None] = {}
        self.morphs: dict[int, _Morph | None] = {}
        self.materials = Materials(document)
        self.below: dict[int, list[int]] = {}
        for index, node in enumerate(self.nodes):
            if node.parent >= 0:
                self.below.setdefault(node.parent, []).append(index)
        self.by_sid: dict[str, int] = {}
        self.by_name: dict[str, int] = {}
        self.by_id: dict[str, int] = {}
        for index, node in enumerate(self.nodes):
            self.by_sid.setdefault(node.element.get("sid"), index)
            self.by_name.setdefault(node.element.get("name"), index)
            self.by_id.setdefault(node.element.get("id"), index)

    def scene(self, name: str) -> Scene:
        bound = self.instances()
        joint_of_node, skeleton, turns = self.skeleton(bound)
        if not self.nodes:
            self.document.note("the file shows no nodes")
        animations = Animations(self.document, self.nodes)
        morph_names, rest_weights = self.channels(bound, animations)
        parts = self.parts(bound, joint_of_node, morph_names)
        characters: tuple[Character, ...] = ()
        if len(skeleton.names):
            orders = {skeleton.names[joint]: self.nodes[node].euler_order for node, joint in joint_of_node.items()}
            characters = (
                Character(
                    skeleton,
                    tuple(parts),
                    self.scene_name or name,
                    tuple(morph_names),
                    rest_weights,
                    extras={"euler_orders": {joint: order for joint, order in orders.items() if order}},
                ),
            )
        weights = {id(b.morph.source): b.morph.channels for b in bound if b.morph}
        found = clips(self.document, animations, joint_of_node, skeleton.names, weights, self.unit_m, turns, name)
        return Scene(characters, tuple(found), "collada", self.unit_m, self.up, tuple(self.document.notes))

    # --- skeleton -----------------------------------------------------------------------------------------------------------

    def skeleton(self, bound: Sequence[_Bound]) -> tuple[dict[int, int], Skeleton, dict[int, Floats]]:
        kept = np.zeros(len(self.nodes), bool)
        for item in bound:
            if item.skin is None:
                kept[item.node] = True
            else:
                kept[item.skin.palette] = True
        for index, node in enumerate(self.nodes):
            kept[index] |= node.is_joint
        if not kept.any():
            kept[:] = True
        for index in range(len(self.nodes) - 1, -1, -1):  # and all above
            if kept[index] and self.nodes[index].parent >= 0:
                kept[self.nodes[index].parent] = True
        shown_at = {item.node for item in bound}  # a node that only carries a skin is no loss
        left = sum(not k and i not in shown_at for i, k in enumerate(kept.tolist()))
        if left:
            self.document.note(f"{left} nodes that hold neither mesh nor joint (cameras, lights, helpers) were dropped")
        order = np.nonzero(kept)[0].tolist()
        joint_of_node = {node: joint for joint, node in enumerate(order)}
        names = self.names(order)
        parents = [joint_of_node.get(self.nodes[i].parent, -1) for i in order]
        translations, rotations, scales = np.zeros((len(order), 3)), np.zeros((len(order), 4)), np.ones((len(order), 3))
        turn = y_up_rotation(self.up) if self.up != "Y" else None
        turns: dict[int, Floats] = {}
        for joint, index in enumerate(order):
            node = self.nodes[index]
            t, r, s = decomposed(self.document, node, local_matrices(node, {}, 1), self.unit_m)
            translations[joint], rotations[joint], scales[joint] = t[0], r[0], s[0]
            if parents[joint] < 0 and turn is not None:
                turns[index] = turn
                translations[joint] = quat.rotate(turn, translations[joint])
                rotations[joint] = quat.multiply(turn, rotations[joint])
        skeleton = Skeleton(tuple(names), np.array(parents, np.int32), Pose(translations, rotations, scales))
        return joint_of_node, skeleton, turns

    def names(self, order: Sequence[int]) -> list[str]:
        plain = [self.nodes[i].element.named() or f"node_{i}" for i in order]
        taken, result, counts = set(plain), list[str](), dict[str, int]()
        seen: set[str] = set()
        for name in plain:
            new = name
            while new in seen or (new != name and new in taken):
                counts[name] = counts.get(name, 1) + 1
                new = f"{name}_{counts[name]}"
            seen.add(new)
            result.append(new)
        changed = sum(new != name for new, name in zip(result, plain, strict=True))
        if changed:
            self.document.note(f"{changed} nodes had the name of another and were numbered")
        return result

    # --- what hangs on it ---------------------------------------------------------------------------------------------------

    def instances(self) -> list[_Bound]:
        found: list[_Bound] = []
        for index, node in enumerate(self.nodes):
            for child in node.element.children:
                if child.tag not in ("instance_geometry", "instance_controller"):
                    continue
                what = f"what node {shown(node.element.named())} shows"
                bound = attempt(self.document, what, lambda c=child, i=index: self.instance(i, c))
                if bound is not None:
                    found.append(bound)
        return found

    def instance(self, index: int, element: Element) -> _Bound | None:
        if element.tag == "instance_geometry":
            geometry = self.geometry(self.document.target(element, "url", "geometry"))
            return None if geometry is None else _Bound(index, element, geometry)
        controller = self.document.target(element, "url", "controller")
        skin, morph = controller.first("skin"), controller.first("morph")
        if skin is not None:
            source = self.document.find(skin.get("source"))
            if source is None:
                self.document.note(
                    f"the skin {shown(controller.named())} is of {shown(skin.get('source'))}, which is not in the file"
                )
                return None
            if source.tag == "controller":
                morph = source.first("morph")
                if morph is None:
                    raise source.error("a skin of a skin")
        geometry_element = (
            self.document.target(morph, "source", "geometry")
            if morph is not None
            else self.document.target(skin, "source", "geometry")
            if skin is not None
            else None
        )
        if geometry_element is None:
            raise controller.error("it is neither skin nor morph")
        geometry = self.geometry(geometry_element)
        if geometry is None:
            return None
        bound = _Bound(index, element, geometry)
        if morph is not None:
            bound.morph = self.morph(morph, geometry)
        if skin is not None:
            bound.skin = self.skin(skin, element, len(geometry.positions))
        return bound

    def geometry(self, element: Element) -> Geometry | None:
        if id(element) not in self.geometries:
            self.geometries[id(element)] = read_geometry(self.document, element, self.unit_m)
        return self.geometries[id(element)]

    def morph(self, element: Element, base: Geometry) -> _Morph | None:
        if id(element) in self.morphs:
            return self.morphs[id(element)]
        targets = element.first("targets")
        if targets is None:
            raise element.error("it has no <targets>")
        inputs = self.document.inputs(targets)
        if "MORPH_TARGET" not in inputs or "MORPH_WEIGHT" not in inputs:
            raise targets.error("it needs MORPH_TARGET and MORPH_WEIGHT")
        words = self.document.words(inputs["MORPH_TARGET"])
        weights = self.document.table(inputs["MORPH_WEIGHT"])[:, 0]
        if len(weights) < len(words):
            raise targets.error(f"{len(words)} targets and {len(weights)} weights")
        relative = element.get("method").upper() == "RELATIVE"
        if len(words) * base.positions.size > _MOST_DENSE:
            raise element.error(f"{len(words)} targets of {len(base.positions)} points are too many")
        names: list[str] = []
        deltas: list[Floats] = []
        for word in words:
            found = self.document.find(word)
            if found is None or found.tag != "geometry":
                raise element.error(f"there is no target {shown(word)}")
            target = self.geometry(found)
            if target is None or target.positions.shape != base.positions.shape:
                raise element.error(f"the target {shown(word)} has other points than what it is a target of")
            name = found.named()
            while name in names:
                name += "_"
            names.append(name)
            deltas.append(target.positions if relative else target.positions - base.positions)
        morph = _Morph(names, deltas, weights[: len(words)], inputs["MORPH_WEIGHT"])
        self.morphs[id(element)] = morph
        return morph

    def skin(self, element: Element, instance: Element, points: int) -> _SkinData:
        shape = element.first("bind_shape_matrix")
        bind_shape = shape.numbers(16).reshape(4, 4) if shape is not None else np.eye(4)
        joints_element, weights_element = element.first("joints"), element.first("vertex_weights")
        if joints_element is None or weights_element is None:
            raise element.error("it needs <joints> and <vertex_weights>")
        inputs = self.document.inputs(joints_element)
        if "JOINT" not in inputs or "INV_BIND_MATRIX" not in inputs:
            raise joints_element.error("it needs JOINT and INV_BIND_MATRIX")
        words = self.document.words(inputs["JOINT"])
        matrices = self.document.table(inputs["INV_BIND_MATRIX"], 16)[:, :16].reshape(-1, 4, 4)
        if len(matrices) < len(words):
            raise joints_element.error(f"{len(words)} joints and {len(matrices)} matrices")
        joint_from_mesh = matrices[: len(words)] @ bind_shape
        joint_from_mesh[:, :3, 3] *= self.unit_m
        joint_from_mesh[:, 3] = (0, 0, 0, 1)
        palette = self.palette(words, instance, element)
        joints, weights = self.influences(weights_element, points, len(words))
        return _SkinData(palette, joint_from_mesh, joints, weights)

    def palette(self, words: Sequence[str], instance: Element, skin: Element) -> list[int]:
        """The nodes of a skin's joints: by sid below the instance's roots, else by sid, id or name anywhere."""
        near: dict[str, int] = {}
        for root in instance.all("skeleton"):
            found = self.by_id.get(root.text.strip().lstrip("#"))
            stack = [] if found is None else [found]
            while stack:
                index = stack.pop()
                near.setdefault(self.nodes[index].element.get("sid"), index)
                stack += reversed(self.below.get(index, []))
        result: list[int] = []
        for word in words:
            places = (near, self.by_sid, self.by_id, self.by_name)
            index = next((place[word] for place in places if word in place), None)
            if index is None:
                raise skin.error(f"there is no joint {shown(word)} in the scene")
            result.append(index)
        return result

    def influences(self, element: Element, points: int, joint_count: int) -> tuple[Ints, Floats]:
        """Joints and weights (points, K) of vertices that have any number of them."""
        width, offsets, tables = 0, dict[str, int](), dict[str, Element]()
        for item in element.all("input"):
            offset = int(item.get("offset")) if item.get("offset").strip().isdigit() else 0
            if offset > 64:
                raise item.error(f"offset {offset} makes no sense")
            width = max(width, offset + 1)
            offsets[item.get("semantic")] = offset
            tables[item.get("semantic")] = self.document.target(item, "source", "source")
        counts_element, values_element = element.first("vcount"), element.first("v")
        if "JOINT" not in offsets or "WEIGHT" not in offsets or counts_element is None:
            raise element.error("it needs JOINT, WEIGHT and <vcount>")
        counts = counts_element.integers()
        values = values_element.integers() if values_element is not None else np.zeros(0, np.int64)
        if counts.size and counts.min() < 0:
            raise counts_element.error("a negative number")
        if int(counts.sum()) * width != len(values):
            raise element.error(f"<vcount> adds up to {int(counts.sum())}, <v> has {len(values)} / {width}")
        if len(counts) < points:
            raise element.error(f"weights for {len(counts)} of {points} points")
        rows = values.reshape(-1, width)
        source = self.document.table(tables["WEIGHT"])[:, 0]
        joints, indices = rows[:, offsets["JOINT"]], rows[:, offsets["WEIGHT"]]
        if rows.size and (indices.min() < 0 or indices.max() >= len(source)):
            raise element.error(f"weight {int(indices.max())} is beyond the {len(source)} of its source")
        if rows.size and joints.max() >= joint_count:
            raise element.error(f"joint {int(joints.max())} is beyond the {joint_count} of the skin")
        weights = np.where(joints >= 0, source[indices], 0.0)
        if rows.size and joints.min() < 0:
            self.document.note("weights of the bind shape itself were given to the other joints of the vertex")
        return self.spread(counts, np.maximum(joints, 0), np.maximum(weights, 0.0), points)

    def spread(self, counts: Ints, joints: Ints, weights: Floats, points: int) -> tuple[Ints, Floats]:
        vertex = np.repeat(np.arange(len(counts)), counts)
        strongest = np.lexsort((-weights, vertex))
        rank = np.arange(len(vertex)) - np.repeat(np.cumsum(counts) - counts, counts)
        most = min(int(counts.max(initial=1)), _MOST_INFLUENCES)
        kept = rank < most
        if not kept.all():
            self.document.note(f"vertices with more than {_MOST_INFLUENCES} weights lost the smallest")
        table_joints, table_weights = np.zeros((points, max(most, 1)), np.int64), np.zeros((points, max(most, 1)))
        rows, columns, chosen = vertex[kept], rank[kept], strongest[kept]
        inside = rows < points
        table_joints[rows[inside], columns[inside]] = joints[chosen[inside]]
        table_weights[rows[inside], columns[inside]] = weights[chosen[inside]]
        sums = table_weights.sum(axis=1)
        lost = sums <= 1e-12
        if lost.any():
            self.document.note(f"{int(lost.sum())} vertices without weights follow the skin's first joint")
            table_weights[lost, 0] = 1.0
            sums = np.where(lost, 1.0, sums)
        if np.abs(sums - 1).max(initial=0.0) > 1e-3:
            self.document.note(f"weights of {int((np.abs(sums - 1) > 1e-3).sum())} vertices did not add up to 1")
        return table_joints, table_weights / sums[:, None]

    def channels(self, bound: Sequence[_Bound], animations: Animations) -> tuple[list[str], Floats]:
        """Morph channels: one for all targets of a name that rest and move alike; others of that name get a number."""
        marks = animations.weight_marks()
        names: dict[str, tuple[float, frozenset[bytes]]] = {}
        done: set[int] = set()
        for item in bound:
            if item.morph is None or id(item.morph) in done:
                continue
            done.add(id(item.morph))
            for place, target in enumerate(item.morph.names):
                weight = float(item.morph.weights[place])
                own = (weight, marks.get((id(item.morph.source), place), frozenset[bytes]()))
                name, count = target, 1
                while names.get(name, own) != own or name in item.morph.channels:
                    count += 1
                    name = f"{target}_{count}"
                names[name] = own
                item.morph.channels.append(name)
        return list(names), np.array([weight for weight, _ in names.values()], np.float64)

    def parts(self, bound: Sequence[_Bound], joint_of_node: dict[int, int], morph_names: Sequence[str]) -> list[Part]:
        parts: list[Part] = []
        place = {name: index for index, name in enumerate(morph_names)}
        for group, item in enumerate(bound):
            symbols = self.materials.symbols(item.element)
            for number, surface in enumerate(item.geometry.surfaces):
                name = item.geometry.name if len(item.geometry.surfaces) == 1 else f"{item.geometry.name}_{number}"
                made = attempt(
                    self.document,
                    f"part {shown(name)}",
                    lambda n=name, s=surface, i=item, g=group, y=symbols: self.part(
                        n, s, i, g, y, joint_of_node, place
                    ),
                )
                if made is not None:
                    parts.append(made)
        return parts

    def part(
        self,
        name: str,
        surface: Surface,
        item: _Bound,
        group: int,
        symbols: dict[str, Element],
        joint_of_node: dict[int, int],
        place: dict[str, int],
    ) -> Part:
        points = surface.points
        options: dict[str, Any] = {}
        if item.skin is None:
            options["joint"] = joint_of_node[item.node]
        else:
            palette = np.array([joint_of_node[node] for node in item.skin.palette], np.int32)
            options["skin"] = Skin(
                palette, item.skin.joint_from_mesh, item.skin.joints[points], item.skin.weights[points]
            )
        if item.morph is not None:
            deltas = (
                np.stack([d[points] for d in item.morph.deltas]) if item.morph.deltas else np.zeros((0, len(points), 3))
            )
            options["morphs"] = MorphSet.from_dense(tuple(item.morph.names), deltas)
            options["morph_channels"] = np.array([place[c] for c in item.morph.channels], np.int32)
        return Part(
            name,
            surface.mesh,
            self.materials.material(symbols.get(surface.material), surface.material),
            group=group,
            **options,
        )
