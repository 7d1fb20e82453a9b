"""Writing VRM 1 (.vrm) and VRM Animation (.vrma).

Source: VRM Consortium, "VRMC_vrm-1.0", "VRMC_springBone-1.0", "VRMC_vrm_animation-1.0".
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from keypose.errors import FormatError
from keypose.io.gltf.humanoid import ROLES
from keypose.io.gltf.out_animations import WrittenCharacter, clip_of
from keypose.io.gltf.out_materials import plain_json
from keypose.io.gltf.writer import write as write_gltf
from keypose.io.gltf.writer import write_binary
from keypose.io.notes import Notes, UniqueNames
from keypose.model import (
    Channel,
    Character,
    Clip,
    Curve,
    CurveKind,
    MorphSet,
    Motion,
    Part,
    Pose,
    Property,
    Scene,
    Skeleton,
)

PRESETS = (
    "happy", "angry", "sad", "relaxed", "surprised", "aa", "ih", "ou", "ee", "oh", "blink", "blinkLeft", "blinkRight",
    "lookUp", "lookDown", "lookLeft", "lookRight", "neutral",
)  # fmt: skip
_LOOKS = ("lookUp", "lookDown", "lookLeft", "lookRight")
REQUIRED = (
    "hips", "spine", "head",
    *(f"{side}_{bone}" for side in ("left", "right") for bone in (
        "upper_leg", "lower_leg", "foot", "upper_arm", "lower_arm", "hand")),
)  # fmt: skip
_LICENSE = "https://vrm.dev/licenses/1.0/"
_SIDEWAYS = 0.9  # cosine between an upper arm and the side that still is a T pose


def write(scene: Scene, path: Path, *, embed: bool = False) -> tuple[str, ...]:
    """Write a scene as .glb, .gltf, .vrm (VRM 1) or .vrma; returns notes of what was changed or could not be held.

    A .vrm holds one character with the roles that VRM needs, a .vrma its joints and animations: rotations of humanoid
    bones, translation of the hips, weights of expressions. Morph channels are expressions: those of the VRM that the
    character came from, else one for each channel.

    Raises:
        FormatError: where there is no character, a required role is missing or the file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in (".vrm", ".vrma"):
        return write_gltf(scene, path, embed=embed)
    if not scene.characters:
        raise FormatError("the scene has no character, and VRM holds nothing else", path=path)
    notes = Notes()
    if len(scene.characters) > 1:
        notes.add(f"a VRM file holds one character; {len(scene.characters) - 1} more were not written")
    character = scene.character
    missing = [role for role in REQUIRED if role not in character.roles]
    if missing:
        shown = ", ".join(missing[:6]) + (", …" if len(missing) > 6 else "")
        raise FormatError(f"VRM needs {len(missing)} roles that the character has not: {shown}", path=path)
    if suffix == ".vrm":
        _write_character(scene, character, path, notes)
    else:
        _write_animation(scene, character, path, notes)
    return notes.texts()


def _vrm(character: Character) -> Mapping[str, Any]:
    kept = character.extras.get("vrm")
    return kept if isinstance(kept, Mapping) else {}


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _list(value: Any) -> Sequence[Any]:
    return value if isinstance(value, (list, tuple)) else []


def _bones(character: Character) -> dict[str, Any]:
    """Nodes are written in the order of the joints, the first character first."""
    return {
        re.sub(r"_([a-z])", lambda m: m[1].upper(), role): {"node": joint}
        for role, joint in sorted(character.roles.items(), key=lambda item: item[1])
        if role in ROLES
    }


# --- characters


def _write_character(scene: Scene, character: Character, path: Path, notes: Notes) -> None:
    if scene.animations:
        notes.add(f"a .vrm holds no animation: {len(scene.animations)} were not written; a .vrma does")
    _note_pose(character, notes)
    vrm = _vrm(character)
    expressions = _mapping(vrm.get("expressions"))
    derived = {str(e.get("channel")) for e in map(_mapping, expressions.values())}
    bare = _without_channels(character, derived)

    def extend(document: dict[str, Any], written: Sequence[WrittenCharacter]) -> None:
        nodes = _Nodes(document, written[0], notes)
        block: dict[str, Any] = {
            "specVersion": "1.0",
            "meta": _meta(vrm, character, notes),
            "humanoid": {"humanBones": _bones(character)},
        }
        views = [
            {"node": node, "type": str(view.get("type", "auto"))}
            for view in map(_mapping, _list(vrm.get("firstPerson")))
            if (node := nodes.mesh(view.get("node"), "first person")) is not None
        ]
        if views:
            block["firstPerson"] = {"meshAnnotations": views}
        look_at = {k: v for k, v in _mapping(vrm.get("lookAt")).items() if k != "node"}
        if look_at:
            block["lookAt"] = plain_json(look_at, notes, "look-at")
        found = nodes.known_expressions(expressions) if expressions else nodes.channels_as_expressions(bare)
        if found:
            block["expressions"] = found
        extensions = document.setdefault("extensions", {})
        extensions["VRMC_vrm"] = block
        springs = nodes.springs(_mapping(vrm.get("springBone")))
        if springs:
            extensions["VRMC_springBone"] = springs
        _use(document, extensions)

    write_binary(Scene((bare,), extras=_without_extension(scene.extras)), path, notes, extend)


def _without_extension(extras: Mapping[str, Any]) -> dict[str, Any]:
    """What the source file said in its own VRM extensions is written anew, so nobody need hear that it is not copied."""
    gltf = dict(_mapping(extras.get("gltf")))
    gltf["extensions"] = {k: v for k, v in _mapping(gltf.get("extensions")).items() if not k.startswith("VRM")}
    return {**extras, "gltf": gltf}


def _use(document: dict[str, Any], extensions: Mapping[str, Any]) -> None:
    document["extensionsUsed"] = sorted({*document.get("extensionsUsed", ()), *extensions})


def _note_pose(character: Character, notes: Notes) -> None:
    from keypose.evaluate import world

    at = np.asarray(world(character.skeleton, character.skeleton.rest))[:, :3, 3]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        arm = at[character.roles[f"{side}_lower_arm"]] - at[character.roles[f"{side}_upper_arm"]]
        if sign * arm[0] < _SIDEWAYS * float(np.linalg.norm(arm)):
            notes.add("VRM asks for a rest pose with the arms to the sides (T pose); this one is another")
            return


def _meta(vrm: Mapping[str, Any], character: Character, notes: Notes) -> dict[str, Any]:
    meta = dict(plain_json(_mapping(vrm.get("meta")), notes, "meta"))
    if not meta:
        notes.add("VRM asks for an author and permissions; written as unknown and the strictest")
    meta.pop("thumbnailImage", None)  # a number of a picture of the source file
    authors = [a for a in _list(meta.get("authors")) if isinstance(a, str) and a]
    return {
        **meta,
        "name": str(meta.get("name") or character.name or "untitled"),
        "authors": authors or ["unknown"],
        "licenseUrl": str(meta.get("licenseUrl") or _LICENSE),
    }


def _without_channels(character: Character, dropped: set[str]) -> Character:
    """The character without the targets that only repeat what expressions bind."""
    kept = [i for i, name in enumerate(character.morph_names) if name not in dropped]
    if len(kept) == len(character.morph_names):
        return character
    place = {old: new for new, old in enumerate(kept)}
    parts = [_without_targets(part, place) for part in character.parts]
    return replace(
        character,
        parts=tuple(parts),
        morph_names=tuple(character.morph_names[i] for i in kept),
        rest_morph_weights=np.asarray(character.rest_morph_weights)[kept],
    )


def _without_targets(part: Part, place: Mapping[int, int]) -> Part:
    morphs, channels = part.morphs, part.morph_channels
    if morphs is None or channels is None:
        return part
    kept = [m for m, channel in enumerate(channels.tolist()) if channel in place]
    if not kept:
        return replace(part, morphs=None, morph_channels=None)
    rows = np.concatenate([np.arange(morphs.starts[m], morphs.starts[m + 1]) for m in kept])
    starts = np.concatenate([[0], np.cumsum([morphs.starts[m + 1] - morphs.starts[m] for m in kept])])
    fewer = MorphSet(
        tuple(morphs.names[m] for m in kept),
        starts,
        morphs.vertices[rows],
        morphs.position_deltas[rows],
        None if morphs.normal_deltas is None else morphs.normal_deltas[rows],
    )
    return replace(part, morphs=fewer, morph_channels=np.array([place[int(channels[m])] for m in kept], np.int32))


class _Nodes:
    """Finds the nodes and targets of a written document that the extensions name."""

    def __init__(self, document: Mapping[str, Any], written: WrittenCharacter, notes: Notes) -> None:
        self.document, self.written, self.notes = document, written, notes
        self.joints = {name: written.first_node + j for j, name in enumerate(written.character.skeleton.names)}
        # first, because a mesh node that is no joint may be named like one
        self.meshes = {
            n["name"]: i for i, n in reversed(list(enumerate(document["nodes"]))) if n.get("name") and "mesh" in n
        }
        self.materials = {item.get("name"): i for i, item in enumerate(document.get("materials", []))}

    def mesh(self, name: Any, what: str) -> int | None:
        """The node that shows a mesh."""
        return self.meshes[name] if name in self.meshes else self.node(name, what)

    def node(self, name: Any, what: str) -> int | None:
        if name not in self.joints:
            self.notes.add(f"{what}: joint '{str(name)[:40]}' does not exist; it was left out")
            return None
        return self.joints[name]

    def targets(self, node: int) -> Sequence[str]:
        mesh = self.document["nodes"][node].get("mesh")
        extras = {} if mesh is None else self.document["meshes"][mesh].get("extras", {})
        return _list(_mapping(extras).get("targetNames"))

    def known_expressions(self, expressions: Mapping[str, Any]) -> dict[str, Any]:
        found: dict[str, dict[str, Any]] = {"preset": {}, "custom": {}}
        for name, value in expressions.items():
            kept = _mapping(value)
            item = {k: kept[k] for k in ("isBinary", "overrideBlink", "overrideLookAt", "overrideMouth") if k in kept}
            binds: list[dict[str, Any]] = []
            for bind in map(_mapping, _list(kept.get("binds"))):
                node = self.mesh(bind.get("node"), f"expression '{name}'")
                names = [] if node is None else self.targets(node)
                if bind.get("target") in names:
                    weight = min(max(float(bind.get("weight", 1.0)), 0.0), 1.0)
                    binds.append({"node": node, "index": list(names).index(bind["target"]), "weight": weight})
            if binds:
                item["morphTargetBinds"] = binds
            for key in ("materialColorBinds", "textureTransformBinds"):
                rows = [
                    {**row, "material": self.materials[row["material"]]}
                    for row in map(_mapping, _list(kept.get(key)))
                    if row.get("material") in self.materials
                ]
                if rows:
                    item[key] = plain_json(rows, self.notes, f"expression '{name}'")
            found["preset" if kept.get("preset") and name in PRESETS else "custom"][name] = item
        return {kind: items for kind, items in found.items() if items}

    def channels_as_expressions(self, character: Character) -> dict[str, Any]:
        found: dict[str, dict[str, Any]] = {"preset": {}, "custom": {}}
        for channel, name in enumerate(character.morph_names):
            binds = [
                {"node": node, "index": index, "weight": 1.0}
                for node, channels in self.written.morph_nodes
                for index in np.nonzero(np.asarray(channels) == channel)[0].tolist()
            ]
            if binds:
                found["preset" if name in PRESETS else "custom"][name] = {"morphTargetBinds": binds}
        return {kind: items for kind, items in found.items() if items}

    def springs(self, springs: Mapping[str, Any]) -> dict[str, Any]:
        if not springs:
            return {}

        def placed(item: Any, what: str) -> dict[str, Any] | None:
            kept = _mapping(item)
            node = self.node(kept.get("node"), what)
            return None if node is None else {**plain_json(kept, self.notes, what), "node": node}

        colliders = [placed(c, "collider") for c in _list(springs.get("colliders"))]
        place = {old: new for new, old in enumerate(i for i, c in enumerate(colliders) if c is not None)}
        groups: list[dict[str, Any]] = []
        for group in map(_mapping, _list(springs.get("colliderGroups"))):
            members = [place[c] for c in _list(group.get("colliders")) if c in place]
            groups.append({**plain_json(group, self.notes, "collider group"), "colliders": members})
        found: list[dict[str, Any]] = []
        for spring in map(_mapping, _list(springs.get("springs"))):
            joints = [j for j in (placed(j, "spring") for j in _list(spring.get("joints"))) if j is not None]
            item = {**plain_json(spring, self.notes, "spring"), "joints": joints}
            item.pop("center", None)
            if spring.get("center") is not None:
                center = self.node(spring["center"], "spring")
                item |= {} if center is None else {"center": center}
            if joints:
                found.append(item)
        result = {"colliders": [c for c in colliders if c is not None], "colliderGroups": groups, "springs": found}
        return {"specVersion": "1.0", **{k: v for k, v in result.items() if v}}


# --- animations


def _write_animation(scene: Scene, character: Character, path: Path, notes: Notes) -> None:
    if character.parts:
        notes.add("a .vrma holds no meshes; they were not written")
    if not scene.animations:
        raise FormatError("the scene has no animation, and .vrma holds nothing else", path=path)
    vrm = _vrm(character)
    look_at = _mapping(vrm.get("lookAt")) if vrm.get("animation") else {}
    gaze = look_at.get("node")
    clips = [clip_of(a) if isinstance(a, Motion) else a for a in scene.animations]
    skeleton = character.skeleton
    names = UniqueNames(reserved=skeleton.names)
    known = {str(e.get("channel")): name for name, e in _expressions(vrm)}
    # a node that drove an expression in the source does so again
    nodes = {str(e.get("channel")): str(e["node"]) for _, e in _expressions(vrm) if e.get("node") in skeleton.names}
    drivers: dict[str, str] = {}
    for clip in clips:
        for channel in clip.curves:
            if channel.property is Property.WEIGHT and channel.target not in drivers:
                drivers[channel.target] = nodes.get(channel.target) or names.add(f"expression_{channel.target}")
    humanoid = {skeleton.names[joint]: role for role, joint in character.roles.items() if role in ROLES}
    moved = [_restricted(clip, humanoid, drivers, gaze, notes) for clip in clips]
    wider = _with_roots(skeleton, [name for name in drivers.values() if name not in skeleton.names])
    bare = Character(wider, name=character.name, roles=character.roles)

    def extend(document: dict[str, Any], written: Sequence[WrittenCharacter]) -> None:
        block: dict[str, Any] = {"specVersion": "1.0", "humanoid": {"humanBones": _bones(bare)}}
        place = {name: written[0].first_node + j for j, name in enumerate(wider.names)}
        found: dict[str, dict[str, Any]] = {"preset": {}, "custom": {}}
        for channel, joint in drivers.items():
            name = known.get(channel, channel)
            if name in _LOOKS:
                notes.add(f"'{name}' is no expression of a .vrma, which has look-at; it was written as a custom one")
            found["preset" if name in PRESETS and name not in _LOOKS else "custom"][name] = {"node": place[joint]}
        if drivers:
            block["expressions"] = {kind: items for kind, items in found.items() if items}
        if gaze in place:
            kept = {k: v for k, v in look_at.items() if k != "node"}
            block["lookAt"] = {**plain_json(kept, notes, "look-at"), "node": place[gaze]}
        document.setdefault("extensions", {})["VRMC_vrm_animation"] = block
        _use(document, document["extensions"])

    write_binary(Scene((bare,), tuple(moved)), path, notes, extend)


def _expressions(vrm: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    return [(name, _mapping(value)) for name, value in _mapping(vrm.get("expressions")).items()]


def _restricted(clip: Clip, humanoid: Mapping[str, str], drivers: Mapping[str, str], gaze: Any, notes: Notes) -> Clip:
    """What a .vrma can say; a weight becomes the place of a node along X."""
    curves: dict[Channel, Curve] = {}
    dropped: dict[str, None] = {}
    strangers: dict[str, None] = {}
    for channel, curve in clip.curves.items():
        role = humanoid.get(channel.target)
        if channel.property is Property.WEIGHT:
            wide = {
                name: np.pad(np.asarray(value), ((0, 0), (0, 2)))
                for name in ("values", "in_tangents", "out_tangents")
                if (value := getattr(curve, name)) is not None
            }
            moved = replace(curve, kind=CurveKind.VECTOR, **wide)
            curves[Channel(drivers[channel.target], Property.TRANSLATION)] = moved
        elif channel.property is Property.ROTATION or (channel.property is Property.TRANSLATION and role == "hips"):
            curves[channel] = curve
            if role is None and channel.target != gaze and _moves(curve):
                strangers[channel.target] = None
        elif _moves(curve):
            dropped[f"{channel.target}.{channel.property.value}"] = None
    for what, names in (
        ("a .vrma cannot hold {} moving channels", dropped),
        ("{} turning joints are no humanoid bones; other programs pass over them", strangers),
    ):
        if names:
            shown = ", ".join(list(names)[:6]) + (", …" if len(names) > 6 else "")
            notes.add(f"animation '{clip.name}': {what.format(len(names))}: {shown}")
    return replace(clip, curves=curves)


def _moves(curve: Curve) -> bool:
    return bool(np.any(np.ptp(np.asarray(curve.values), axis=0) > 1e-6))


def _with_roots(skeleton: Skeleton, names: list[str]) -> Skeleton:
    """The skeleton with more roots behind its joints, which keep their numbers."""
    if not names:
        return skeleton
    rest, count = skeleton.rest, len(names)
    return Skeleton(
        (*skeleton.names, *names),
        np.concatenate([skeleton.parents, np.full(count, -1, np.int32)]),
        Pose(
            np.concatenate([rest.translations, np.zeros((count, 3))]),
            np.concatenate([rest.rotations, np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))]),
            np.concatenate([rest.scales, np.ones((count, 3))]),
        ),
        skeleton.end_offsets,
    )
