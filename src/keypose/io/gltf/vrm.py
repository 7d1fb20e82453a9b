"""VRM 0, VRM 1 and VRM Animation files: glTF with a humanoid, expressions, look-at, spring bones and permissions.

What a VRM says beyond glTF is kept in ``character.extras["vrm"]`` in VRM 1's terms, with joint names for node numbers;
expressions become morph channels. The writer is `keypose.io.gltf.vrm_writer`.

Source: VRM Consortium, specifications "VRM 0.0", "VRMC_vrm-1.0", "VRMC_springBone-1.0", "VRMC_vrm_animation-1.0".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from keypose.arrays import Floats
from keypose.errors import FormatError
from keypose.io.axes import turn_roots
from keypose.io.gltf import vrm_zero
from keypose.io.gltf.hierarchy import Hierarchy
from keypose.io.gltf.items import Document
from keypose.io.gltf.reader import read_with
from keypose.io.gltf.surfaces import target_names
from keypose.io.gltf.vrm_writer import PRESETS
from keypose.io.gltf.vrm_writer import write as write
from keypose.io.json_values import Json
from keypose.io.notes import Notes
from keypose.math import quat
from keypose.model import (
    Channel,
    Clip,
    Curve,
    CurveKind,
    MorphSet,
    Motion,
    Part,
    Property,
    Scene,
)

__all__ = ["read", "write"]

_HALF_TURN = np.array([0.0, 0.0, 1.0, 0.0])  # about Y


def read(path: Path) -> Scene:
    """Read a glTF file; one with VRM's extensions also with what these say.

    Raises:
        FormatError: where the file is damaged, a humanoid bone or a bind names what does not exist, or a file named
            .vrm or .vrma has no VRM extension.
        MissingExtra: where it is compressed and the library for that is not installed.
    """
    scene = read_with(path, _understand)
    if path.suffix.lower() in (".vrm", ".vrma") and scene.format != "vrm":
        raise FormatError(f"named '{path.suffix}', but it has no VRM extension", where="extensions", path=path)
    return scene


def _understand(scene: Scene, root: Json, document: Document, tree: Hierarchy, notes: Notes) -> Scene:
    extensions = root.get("extensions")
    if extensions is None or not scene.characters:
        return scene
    old, new, moving = (extensions.get(name) for name in ("VRM", "VRMC_vrm", "VRMC_vrm_animation"))
    if old is None and new is None and moving is None:
        return scene
    reader = _Reader(scene, document, tree, notes)
    if new is not None:
        scene = reader.one(new, extensions.get("VRMC_springBone"))
    elif old is not None:
        scene = reader.zero(old)
    elif moving is not None:
        scene = reader.animation(moving)
    return replace(scene, format="vrm")


@dataclass(frozen=True, slots=True)
class _Bind:
    node: int
    target: str
    weight: float


class _Reader:
    """Turns the extensions of one file into a character's channels and extras."""

    def __init__(self, scene: Scene, document: Document, tree: Hierarchy, notes: Notes) -> None:
        self.scene, self.document, self.tree, self.notes = scene, document, tree, notes
        self.character = scene.character
        self.extras: dict[str, Any] = {}
        shown = [index for index in tree.nodes if document.nodes[index].mesh is not None]
        self.group_of_node = {node: group for group, node in enumerate(shown)}  # as the reader numbers parts

    # --- the three kinds of files

    def one(self, vrm: Json, springs: Json | None) -> Scene:
        self.check_bones(vrm.need("humanoid").members("humanBones"))
        self.extras = {"version": vrm.text("specVersion", "1.0")[:20]}
        self.keep("meta", vrm.get("meta"))
        self.keep("lookAt", vrm.get("lookAt"))
        first_person = vrm.get("firstPerson")
        if first_person is not None:
            views = [
                {"node": self.name(item.need("node")), "type": item.text("type", "auto")}
                for item in first_person.items("meshAnnotations")
            ]
            self.extras["firstPerson"] = views
        if springs is not None:
            self.extras["springBone"] = self.springs(springs)
        expressions = vrm.get("expressions")
        if expressions is not None:
            for kind in ("preset", "custom"):
                for name, item in expressions.members(kind):
                    self.expression(name, kind == "preset", item, self.binds(item))
        return self.result()

    def zero(self, vrm: Json) -> Scene:
        humanoid = vrm.get("humanoid")
        if humanoid is not None:
            self.check_bones([(b.text("bone"), b) for b in humanoid.items("humanBones")])
        self.turn()
        self.extras = {"version": "0.0"}
        meta = vrm.get("meta")
        if meta is not None:
            self.extras["meta"] = vrm_zero.meta(meta, self.notes)
            self.extras["meta_0"] = dict(meta.object())
        first_person = vrm.get("firstPerson")
        if first_person is not None:
            self.extras["lookAt"] = vrm_zero.look_at(first_person, self.notes)
            nodes_of_mesh: dict[int, list[str]] = {}
            for node in self.group_of_node:
                nodes_of_mesh.setdefault(int(self.document.nodes[node].mesh or 0), []).append(self.node_name(node))
            views = vrm_zero.views(first_person, nodes_of_mesh, len(self.document.meshes))
            self.extras["firstPerson"] = views
        springs = vrm.get("secondaryAnimation")
        if springs is not None and (springs.items("boneGroups") or springs.items("colliderGroups")):
            names = self.character.skeleton.names
            children: dict[str, list[str]] = {}
            for joint, parent in enumerate(self.character.skeleton.parents.tolist()):
                if parent >= 0:
                    children.setdefault(names[parent], []).append(names[joint])
            self.extras["springBone"] = vrm_zero.spring_bones(springs, self.name, children, self.notes)
        master = vrm.get("blendShapeMaster")
        for item in [] if master is None else master.items("blendShapeGroups"):
            preset = vrm_zero.PRESETS.get(item.text("presetName", "unknown").lower(), "")
            name = preset or item.text("name", "") or "expression"
            self.expression(name, bool(preset), item, self.binds_zero(item))
        if any(item.text("shader", "").startswith("VRM/") for item in vrm.items("materialProperties")):
            self.notes.add("MToon shading of VRM 0 (materialProperties) was dropped; materials are those of the glTF")
        return self.result()

    def animation(self, vrma: Json) -> Scene:
        self.check_bones(vrma.need("humanoid").members("humanBones"))
        self.extras = {"version": vrma.text("specVersion", "1.0")[:20], "animation": True}
        drivers: dict[str, str] = {}
        expressions = vrma.get("expressions")
        if expressions is not None:
            for kind in ("preset", "custom"):
                for name, item in expressions.members(kind):
                    kept = self.expression(name, kind == "preset", Json({}, item.where), [])
                    kept["node"] = self.name(item.need("node"))
                    drivers.setdefault(kept["node"], kept["channel"])
        look_at = vrma.get("lookAt")
        if look_at is not None:
            self.extras["lookAt"] = {**self.plain(look_at.object()), "node": self.name(look_at.need("node"))}
        scene = self.result()
        return _with_driven_weights(scene, drivers) if drivers else scene

    # --- pieces

    def name(self, node: Json) -> str:
        """The joint's name of a node that a field names."""
        return self.node_name(node.as_integer(0, len(self.document.nodes), "node"), node.where)

    def node_name(self, node: int, where: str = "") -> str:
        joint = self.tree.joint_of_node.get(node)
        if joint is not None:
            return self.character.skeleton.names[joint]
        if node not in self.group_of_node:  # else it only carries a mesh, and has the mesh's name
            raise FormatError(f"nodes[{node}] is not in the scene", where=where)
        return self.document.nodes[node].name or f"node_{node}"

    def check_bones(self, bones: Any) -> None:
        """Every humanoid bone has to name a node of the file; unknown roles are noted where roles are read."""
        for _, bone in bones:
            node = bone.need("node")
            if node.value != -1:  # "none", as some write it; the roles note it
                node.as_integer(0, len(self.document.nodes), "node")

    def plain(self, value: Mapping[str, Any]) -> dict[str, Any]:
        return {k: v for k, v in value.items() if k not in ("extensions", "node")}

    def keep(self, key: str, item: Json | None) -> None:
        if item is not None:
            self.extras[key] = self.plain(item.object())

    def springs(self, item: Json) -> dict[str, Any]:
        colliders = [{**self.plain(c.object()), "node": self.name(c.need("node"))} for c in item.items("colliders")]
        groups: list[dict[str, Any]] = []
        for group in item.items("colliderGroups"):
            group.indices("colliders", len(colliders), "collider")
            groups.append(self.plain(group.object()))
        springs: list[dict[str, Any]] = []
        for spring in item.items("springs"):
            spring.indices("colliderGroups", len(groups), "collider group")
            joints = [{**self.plain(j.object()), "node": self.name(j.need("node"))} for j in spring.items("joints")]
            kept = {**self.plain(spring.object()), "joints": joints}
            center = spring.get("center")
            if center is not None:
                kept["center"] = self.name(center)
            springs.append(kept)
        return {"colliders": colliders, "colliderGroups": groups, "springs": springs}

    def targets(self, node: int, index: Json) -> str:
        mesh = self.document.nodes[node].mesh
        names = () if mesh is None else target_names(self.document.meshes[mesh], self.notes)
        return names[index.as_integer(0, len(names), "morph target")]

    def binds(self, item: Json) -> list[_Bind]:
        found: list[_Bind] = []
        for bind in item.items("morphTargetBinds"):
            node = bind.need("node").as_integer(0, len(self.document.nodes), "node")
            self.node_name(node, bind.where)
            found.append(_Bind(node, self.targets(node, bind.need("index")), bind.number("weight", 1.0)))
        return found

    def binds_zero(self, item: Json) -> list[_Bind]:
        """Of a mesh: for every node that shows it; weights in percent."""
        found: list[_Bind] = []
        for bind in item.items("binds"):
            mesh = bind.need("mesh").as_integer(0, len(self.document.meshes), "mesh")
            for node in (n for n in self.group_of_node if self.document.nodes[n].mesh == mesh):
                target = self.targets(node, bind.need("index"))
                found.append(_Bind(node, target, bind.number("weight", 100.0) / 100.0))
        return found

    def expression(self, name: str, preset: bool, item: Json, binds: Sequence[_Bind]) -> dict[str, Any]:
        kept: dict[str, Any] = {"preset": preset and name in PRESETS}
        for key in ("isBinary", "overrideBlink", "overrideLookAt", "overrideMouth"):
            if key in item.object():
                kept[key] = item.object()[key]
        for key in ("materialColorBinds", "textureTransformBinds"):
            rows: list[dict[str, Any]] = []
            for bind in item.items(key):
                number = bind.to("material", len(self.document.materials), "material")
                material = self.document.materials[number].text("name", "") or f"material_{number}"
                rows.append({**{k: v for k, v in bind.object().items() if k != "material"}, "material": material})
            if rows:
                kept[key] = rows
                self.notes.add(f"expression '{name[:40]}': what it does to materials is kept, but not shown")
        if item.items("materialValues"):
            self.notes.add(f"expression '{name[:40]}': what it does to materials was dropped")
        kept["binds"] = [{"node": self.node_name(b.node), "target": b.target, "weight": b.weight} for b in binds]
        expressions = self.extras.setdefault("expressions", {})
        while name in expressions:  # a custom one named like a preset, or twice the same
            name += "_2"
        kept["channel"] = self.channel(name, binds)
        expressions[name] = kept
        return kept

    def channel(self, name: str, binds: Sequence[_Bind]) -> str:
        """The morph channel of an expression: a new one, whose targets are the sums of what it binds."""
        character = self.character
        channel = name
        while channel in character.morph_names:
            channel += " (expression)"
        number = len(character.morph_names)
        parts: list[Part] = []
        for part in character.parts:
            mine = [b for b in binds if self.group_of_node.get(b.node) == part.group]
            parts.append(_with_sum(part, channel, number, [(b.target, b.weight) for b in mine]))
        weights = np.append(np.asarray(character.rest_morph_weights), np.float32(0.0)).astype(np.float32)
        self.character = replace(
            character, parts=tuple(parts), morph_names=(*character.morph_names, channel), rest_morph_weights=weights
        )
        return channel

    def turn(self) -> None:
        """VRM 0 faces -Z: half a turn of the roots, and of what moves them, makes it face +Z."""
        skeleton = self.character.skeleton
        rest = turn_roots(skeleton.rest, skeleton.parents, _HALF_TURN.astype(np.float32))
        self.character = replace(self.character, skeleton=replace(skeleton, rest=rest))
        roots = {skeleton.names[j] for j in np.nonzero(skeleton.parents < 0)[0]}
        animations = [_turned(a, roots) if isinstance(a, Clip) else a for a in self.scene.animations]
        self.scene = replace(self.scene, animations=tuple(animations))
        self.notes.add("VRM 0 characters face -Z; turned by half a turn about Y to face +Z")

    def result(self) -> Scene:
        extras = {**self.character.extras, "vrm": self.extras}
        character = replace(self.character, extras=extras)
        return replace(self.scene, characters=(character, *self.scene.characters[1:]))


def _with_sum(part: Part, name: str, channel: int, bound: Sequence[tuple[str, float]]) -> Part:
    """The part with one more target: the weighted sum of others."""
    morphs = part.morphs
    known = [] if morphs is None else [(morphs.names.index(t), w) for t, w in bound if t in morphs.names]
    if morphs is None or part.morph_channels is None or not known:
        return part
    rows = [np.arange(morphs.starts[m], morphs.starts[m + 1]) for m, _ in known]
    factors = np.concatenate([np.full(len(r), w) for r, (_, w) in zip(rows, known, strict=True)])[:, None]
    index = np.concatenate(rows)
    vertices, place = np.unique(morphs.vertices[index], return_inverse=True)

    def summed(deltas: Floats) -> Floats:
        total = np.zeros((len(vertices), 3))
        np.add.at(total, place, deltas[index] * factors)
        return np.concatenate([deltas, total.astype(deltas.dtype)])

    target = name
    while target in morphs.names:
        target += " (expression)"
    more = MorphSet(
        (*morphs.names, target),
        np.append(morphs.starts, morphs.starts[-1] + len(vertices)),
        np.concatenate([morphs.vertices, vertices]),
        summed(np.asarray(morphs.position_deltas)),
        None if morphs.normal_deltas is None else summed(np.asarray(morphs.normal_deltas)),
    )
    return replace(part, morphs=more, morph_channels=np.append(part.morph_channels, channel))


def _turned(clip: Clip, roots: set[str]) -> Clip:
    curves: dict[Channel, Curve] = {}
    for channel, curve in clip.curves.items():
        if channel.target in roots and channel.property in (Property.ROTATION, Property.TRANSLATION):
            turn = quat.multiply if channel.property is Property.ROTATION else quat.rotate
            half = _HALF_TURN.astype(np.float32)
            changed = {
                name: np.asarray(turn(half, value), np.float32)
                for name in ("values", "in_tangents", "out_tangents")
                if (value := getattr(curve, name)) is not None
            }
            curve = replace(curve, **changed)
        curves[channel] = curve
    return replace(clip, curves=curves)


def _with_driven_weights(scene: Scene, drivers: Mapping[str, str]) -> Scene:
    """Where a node stands along X is an expression's weight."""
    animations: list[Clip | Motion] = []
    for animation in scene.animations:
        if not isinstance(animation, Clip):
            animations.append(animation)
            continue
        curves: dict[Channel, Curve] = {}
        for channel, curve in animation.curves.items():
            if channel.target not in drivers:
                curves[channel] = curve
            elif channel.property is Property.TRANSLATION:
                tangents = {
                    name: value[:, :1]
                    for name in ("in_tangents", "out_tangents")
                    if (value := getattr(curve, name)) is not None
                }
                weight = replace(curve, values=curve.values[:, :1], kind=CurveKind.SCALAR, **tangents)
                curves[Channel(drivers[channel.target], Property.WEIGHT)] = weight
        animations.append(replace(animation, curves=curves))
    return replace(scene, animations=tuple(animations))
