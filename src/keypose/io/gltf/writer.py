"""Writing glTF 2.0: .glb, and .gltf with its data beside it or embedded."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

import keypose
from keypose.errors import FormatError
from keypose.io import atomic
from keypose.io.gltf.buffers import Buffers
from keypose.io.gltf.container import BIN_CHUNK, JSON_CHUNK, MAGIC
from keypose.io.gltf.hierarchy import CARRIER, END_SITE, OWN
from keypose.io.gltf.out_animations import AnimationWriter, WrittenCharacter
from keypose.io.gltf.out_materials import MaterialWriter, plain_json
from keypose.io.gltf.out_surfaces import SurfaceWriter, common_root_missing, group_parts
from keypose.io.notes import Notes
from keypose.model import Character, Scene

LARGEST_GLB = 2**32 - 1
Extend = Callable[[dict[str, Any], Sequence[WrittenCharacter]], None]


def write(scene: Scene, path: Path, *, embed: bool = False) -> tuple[str, ...]:
    """Write a scene as .glb or .gltf; returns notes of what was changed or could not be held.

    A .gltf puts its binary data into a .bin of the same name beside it, or into itself with ``embed``.
    Data is single precision; several characters become several roots of one scene.

    Raises:
        FormatError: where the suffix is another one or the file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in (".glb", ".gltf"):
        raise FormatError(f"expected a name ending in .glb or .gltf, got '{path.suffix}'", path=path)
    notes = Notes()
    document, data = _document(scene, path, notes, None)
    if suffix == ".glb":
        _write_glb(path, document, data)
    else:
        _write_gltf(path, document, data, embed)
    return notes.texts()


def write_binary(scene: Scene, path: Path, notes: Notes, extend: Extend) -> None:
    """Write a binary file of any name whose JSON ``extend`` completes with root extensions."""
    document, data = _document(scene, path, notes, extend)
    _write_glb(path, document, data)


def _document(scene: Scene, path: Path, notes: Notes, extend: Extend | None) -> tuple[dict[str, Any], bytes]:
    try:
        writer = _Writer(scene, notes)
        document, data = writer.document()
        if extend is not None:
            extend(document, writer.written)
    except RecursionError:
        raise FormatError("extras are nested too deeply", path=path) from None
    return document, data


def _write_glb(path: Path, document: dict[str, Any], data: bytes) -> None:
    if data:
        document["buffers"] = [{"byteLength": len(data)}]
    text = _text(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = [struct.pack("<II", len(text), JSON_CHUNK), text]
    if data:
        chunks += [struct.pack("<II", len(data), BIN_CHUNK), data]
    length = 12 + sum(len(c) for c in chunks)
    if length > LARGEST_GLB:
        raise FormatError(f"{length >> 20} MiB are more than a .glb can hold; write a .gltf", path=path)
    with atomic.replacing(path) as temporary, temporary.open("wb") as file:
        file.write(struct.pack("<4sII", MAGIC, 2, length))
        file.writelines(chunks)


def _write_gltf(path: Path, document: dict[str, Any], data: bytes, embed: bool) -> None:
    beside = path.with_suffix(".bin")
    if data:
        uri = quote(beside.name)
        if embed:
            uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        document["buffers"] = [{"uri": uri, "byteLength": len(data)}]
    with ExitStack() as files:
        text = files.enter_context(atomic.replacing(path))
        if data and not embed:  # entered last, so that it is in place before the file that needs it
            files.enter_context(atomic.replacing(beside)).write_bytes(data)
        text.write_text(_text(document), encoding="utf-8", newline="\n")


def _text(document: Mapping[str, Any]) -> str:
    return json.dumps(document, ensure_ascii=False, separators=(",", ":"), allow_nan=False)


class _Writer:
    def __init__(self, scene: Scene, notes: Notes) -> None:
        self._scene, self._notes = scene, notes
        self._buffers = Buffers()
        self._materials = MaterialWriter(self._buffers, notes)
        self._surfaces = SurfaceWriter(self._buffers, self._materials, notes)
        self._nodes: list[dict[str, Any]] = []
        self._roots: list[int] = []
        self.written: list[WrittenCharacter] = []

    def document(self) -> tuple[dict[str, Any], bytes]:
        """The JSON and the binary data."""
        scene = self._scene
        self.written = [self._character(character) for character in scene.characters]
        animations = AnimationWriter(self._buffers, self.written, self._notes)
        for animation in scene.animations:
            animations.add(animation)
        kept = _mapping(scene.extras.get("gltf"))
        item: dict[str, Any] = {"nodes": self._roots} if self._roots else {}
        if len(scene.characters) == 1 and scene.character.name:
            item["name"] = scene.character.name
        extras = plain_json(_mapping(kept.get("scene_extras")), self._notes, "the scene")
        if extras:
            item["extras"] = extras
        extensions = sorted(self._materials.extensions)
        document: dict[str, Any] = {"asset": self._asset(kept), "scene": 0, "scenes": [item]}
        data = self._buffers.finish()
        lists: dict[str, Sequence[Any]] = {
            "nodes": self._nodes,
            "meshes": self._surfaces.meshes,
            "skins": self._surfaces.skins,
            "materials": self._materials.materials,
            "textures": self._materials.textures,
            "images": self._materials.images,
            "samplers": self._materials.samplers,
            "animations": animations.animations,
            "accessors": self._buffers.accessors,
            "bufferViews": self._buffers.views,
            "extensionsUsed": extensions,
            "extensionsRequired": [e for e in extensions if e in ("EXT_texture_webp", "KHR_texture_basisu")],
        }
        document |= {key: items for key, items in lists.items() if items}
        root_extras = plain_json(_mapping(kept.get("extras")), self._notes, "the file")
        if root_extras:
            document["extras"] = root_extras
        dropped = sorted(_mapping(kept.get("extensions")))
        if dropped:
            self._notes.add(f"extensions of the source file were not written: {', '.join(dropped)}")
        return document, data

    def _asset(self, kept: Mapping[str, Any]) -> dict[str, Any]:
        scene = self._scene
        asset: dict[str, Any] = {"version": "2.0", "generator": f"keypose {keypose.__version__}"}
        copyright = _mapping(kept.get("asset")).get("copyright")
        if isinstance(copyright, str):
            asset["copyright"] = copyright
        own: dict[str, Any] = {}
        if scene.unit_m != 1.0:
            own["unit_m"] = scene.unit_m
        if scene.up != "Y":
            own["up"] = scene.up
        source = {k: v for k, v in scene.extras.items() if k != "gltf"}
        if source:
            own["source"] = plain_json(source, self._notes, "the scene")
        characters = [{k: v for k, v in c.extras.items() if k != "gltf"} for c in scene.characters]
        if len(characters) == 1 and characters[0]:
            own["character"] = plain_json(characters[0], self._notes, "the character")
        if len(scene.characters) == 1 and len({p.group for p in scene.character.parts if p.morphs is not None}) > 1:
            own["morphs"] = list(scene.character.morph_names)  # their order cannot be seen from several meshes
        extras = dict(plain_json(_mapping(kept.get("asset_extras")), self._notes, "the asset"))
        if own:
            extras[OWN] = own
        if extras:
            asset["extras"] = extras
        return asset

    def _character(self, character: Character) -> WrittenCharacter:
        skeleton = character.skeleton
        first = len(self._nodes)
        self._nodes += self._joints(character)
        for joint, parent in enumerate(skeleton.parents.tolist()):
            if parent >= 0:
                self._nodes[first + parent].setdefault("children", []).append(first + joint)
        roots = [first + j for j, parent in enumerate(skeleton.parents.tolist()) if parent < 0]
        skins = [p.skin for p in character.parts if p.skin is not None]
        if common_root_missing(skeleton.parents.tolist(), skins):
            wrapper = {"name": character.name or "root", "children": roots, "extras": {OWN: {CARRIER: True}}}
            roots = [len(self._nodes)]
            self._nodes.append(wrapper)
        morph_nodes: list[tuple[int, Any]] = []
        for group in group_parts(character, self._notes):
            mesh = self._surfaces.mesh(character, group)
            node = None if group.joint is None else first + group.joint
            if node is None or "mesh" in self._nodes[node]:  # a node of its own for the mesh
                carrier = len(self._nodes)
                own = {CARRIER: True}
                item: dict[str, Any] = {"name": group.first.name} if group.first.name else {}
                self._nodes.append({**item, "extras": {OWN: own}})
                if group.first.skin is not None or node is None:
                    roots.append(carrier)
                else:
                    self._nodes[node].setdefault("children", []).append(carrier)
                node = carrier
            self._nodes[node]["mesh"] = mesh
            if group.first.skin is not None:
                self._nodes[node]["skin"] = self._surfaces.skin(group.first.skin, first)
            if group.first.morphs is not None and group.first.morph_channels is not None:
                morph_nodes.append((node, group.first.morph_channels))
        driving = {int(m) for _, channels in morph_nodes for m in channels}
        idle = [name for m, name in enumerate(character.morph_names) if m not in driving]
        if idle:
            shown = ", ".join(idle[:6]) + (", …" if len(idle) > 6 else "")
            self._notes.add(f"character '{character.name}': {len(idle)} morph channels drive nothing: {shown}")
        self._roots += roots
        return WrittenCharacter(character, first, morph_nodes)

    def _joints(self, character: Character) -> list[dict[str, Any]]:
        skeleton = character.skeleton
        rest = skeleton.rest
        extras = _mapping(_mapping(character.extras.get("gltf")).get("nodes"))
        roles = {joint: role for role, joint in character.roles.items()}
        ends = dict(skeleton.end_offsets)
        nodes: list[dict[str, Any]] = []
        for joint, name in enumerate(skeleton.names):
            node: dict[str, Any] = {"name": name} if name else {}
            rotation = np.asarray(rest.rotations[joint], np.float64)
            rotation = rotation / (np.linalg.norm(rotation) or 1.0)
            if abs(np.linalg.norm(rest.rotations[joint]) - 1) <= 1e-5:
                rotation = rest.rotations[joint]
            values = {
                "translation": (rest.translations[joint], (0, 0, 0)),
                "rotation": (np.asarray(rotation)[[1, 2, 3, 0]], (0, 0, 0, 1)),
                "scale": (rest.scales[joint], (1, 1, 1)),
            }
            for key, (value, neutral) in values.items():
                single = np.asarray(value, np.float32)
                if not np.array_equal(single, np.asarray(neutral, np.float32)):
                    node[key] = [_shortest(v) for v in single]
            kept = dict(plain_json(_mapping(extras.get(name)), self._notes, f"node '{name}'"))
            own: dict[str, Any] = {}
            if joint in ends:
                own[END_SITE] = [_shortest(np.float32(v)) for v in ends[joint]]
            if joint in roles:
                own["role"] = roles[joint]
            if own:
                kept[OWN] = own
            if kept:
                node["extras"] = kept
            nodes.append(node)
        return nodes


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _shortest(value: np.float32) -> float:
    """The shortest decimal number that is this single-precision number."""
    return float(str(np.float32(value)))
