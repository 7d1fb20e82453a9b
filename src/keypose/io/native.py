"""Project files, ``.keypose``: one file that holds a whole document and opens for ever.

It is a safetensors file (`keypose.io.tensors`). Its metadata has the document as JSON under ``keypose_project``, with the
version of the schema; arrays are named there and lie behind it, bit for bit, each once. Characters are inside, with their
meshes and pictures, so that a project needs no other file. The same document gives the same bytes, and a checksum of them
tells of a single flipped bit.

**Versions.** A file of an older schema is migrated step by step on reading (`MIGRATIONS`); one of a newer schema is refused
and names the version it needs. A schema that was once released never changes: the tests keep a file of each.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from keypose.arrays import Array, frozen
from keypose.errors import FormatError, KeyposeError
from keypose.io import atomic
from keypose.io import native_values as values
from keypose.io.json_values import Json, parse_json
from keypose.io.native_characters import character_json, read_character
from keypose.io.native_rigs import read_rig, rig_json
from keypose.io.tensors import pack_tensors, unpack_tensors
from keypose.model import Document, Motion, Scene

VERSION = 2
"""Of the schema: 2 knows rigs. A document that has none is written as version 1, which older programs open."""

KEY = "keypose_project"
CHECKSUM = "keypose_checksum"
LARGEST_BYTES = 8 << 30

MIGRATIONS: Mapping[int, Callable[[dict[str, Any]], dict[str, Any]]] = {1: lambda fields: {**fields, "version": 2}}
"""Version -> what makes the next version's JSON of it. Arrays are never touched, so their names stay."""


# ---- documents ---------------------------------------------------------------------------------------------------------


class Storing:
    """Collects arrays under names; one that is there already, to the bit, is not stored again."""

    def __init__(self) -> None:
        self.arrays: dict[str, Array] = {}
        self._known: dict[tuple[str, tuple[int, ...], bytes], str] = {}

    def __call__(self, array: Array) -> str:
        """The name of an array."""
        array = np.ascontiguousarray(array)
        key = array.dtype.str, array.shape, hashlib.blake2b(array.reshape(-1).view(np.uint8), digest_size=20).digest()
        if key not in self._known:
            self._known[key] = f"a{len(self.arrays)}"
            self.arrays[self._known[key]] = array
        return self._known[key]


def fetching(arrays: Mapping[str, Array]) -> values.Fetch:
    """The way back: arrays by name, read-only; those of one name are one array again."""
    made: dict[str, Array] = {}

    def fetch(item: Json) -> Array:
        name = item.value
        if not isinstance(name, str) or name not in arrays:
            item.fail(f"no array {str(name)[:40]!r} in the file")
        if name not in made:
            made[name] = frozen(arrays[name])
        return made[name]

    return fetch


def document_bytes(document: Document) -> bytes:
    """A document as the bytes of a project file; equal documents give equal bytes.

    Raises:
        FormatError: where it holds what a file cannot, such as a number that is not finite.
    """
    store = Storing()
    fields = {
        "version": _version(document),
        "name": document.name,
        "characters": [character_json(character, store) for character in document.characters.values()],
        "clips": [values.clip_json(clip, store) for clip in document.clips.values()],
        "timelines": [values.timeline_json(timeline, store) for timeline in document.timelines.values()],
        "poses": [values.pose_json(pose) for pose in document.poses.values()],
        "performs": dict(document.performs),
        "settings": {name: setting_json(value) for name, value in document.settings.items()},
    }
    if document.rigs:
        fields["rigs"] = [rig_json(rig, store) for rig in document.rigs.values()]
    text = json_text(fields)
    return pack_tensors(store.arrays, {KEY: text, CHECKSUM: _checksum(text, store.arrays)})


def _version(document: Document) -> int:
    return 2 if document.rigs else 1


def _checksum(text: str, arrays: Mapping[str, Array]) -> str:
    """Of all that a project is made of, whatever the order of its bytes in the file."""
    digest = hashlib.blake2b(text.encode("utf-8", "surrogatepass"), digest_size=16)
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def json_text(fields: dict[str, Any]) -> str:
    """JSON in ASCII; raises `FormatError` for a number that is not finite."""
    try:
        return json.dumps(fields, separators=(",", ":"), allow_nan=False)
    except ValueError:
        raise FormatError("the project holds a number that is not finite, which no file keeps") from None


def setting_json(value: str | float | bool | None) -> str | float | bool | None:
    """A setting; numbers are always written as such with a fraction, so that they are read as what they were."""
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def document_from_bytes(data: bytes | memoryview) -> Document:
    """The document of a project file.

    Raises:
        FormatError: where the file is damaged, no project, or of a newer version than this program knows; names the place.
    """
    arrays, metadata = unpack_tensors(data)
    text = metadata.get(KEY)
    if not isinstance(text, str):
        raise FormatError("a safetensors file, but no keypose project", where="__metadata__")
    promised = metadata.get(CHECKSUM)
    if promised is not None and promised != _checksum(text, arrays):
        raise FormatError(
            "its checksum does not fit: bytes of it were changed after it was saved (a tool that means to change it leaves "
            f"{CHECKSUM} out)",
            where="__metadata__",
        )
    root = migrated(parse_json(text.encode("utf-8", "surrogatepass")))
    fetch = fetching(arrays)
    found = {
        "characters": [read_character(each, fetch) for each in root.items("characters")],
        "clips": [values.read_clip(each, fetch) for each in root.items("clips")],
        "timelines": [values.read_timeline(each, fetch) for each in root.items("timelines")],
        "poses": [values.read_pose(each) for each in root.items("poses")],
        "rigs": [read_rig(each, fetch) for each in root.items("rigs")],
    }
    named: dict[str, dict[str, Any]] = {}
    for kind, items in found.items():
        named[kind] = {item.name: item for item in items}
        if len(named[kind]) != len(items):
            root.need(kind).fail("two have the same name")
    settings = {name: _setting(value) for name, value in root.members("settings")}
    return values.built(
        root, lambda: Document(root.text("name"), **named, performs=values.texts(root, "performs"), settings=settings)
    )


def migrated(root: Json) -> Json:
    """The JSON of the present version; raises `FormatError` for a version that is newer or none."""
    version = root.integer("version", least=1)
    if version > VERSION:
        raise FormatError(
            f"made by a newer keypose (project version {version}; this one knows {VERSION}): install the newest keypose",
            where="version",
        )
    fields = root.object()
    for step in range(version, VERSION):
        fields = MIGRATIONS[step](fields)
    return Json(fields, "")


def _setting(value: Json) -> str | float | bool:
    return value.value if isinstance(value.value, (str, bool)) else value.as_number()


# ---- as a format -------------------------------------------------------------------------------------------------------


def read_document(path: Path) -> Document:
    """The document of a project file; raises `FormatError` naming the place."""
    size = path.stat().st_size
    if size > LARGEST_BYTES:
        raise FormatError(f"{size >> 20} MiB; at most {LARGEST_BYTES >> 20} MiB are read", path=path)
    return document_from_bytes(path.read_bytes())


def read(path: Path) -> Scene:
    """The characters of a project, what its timelines make of them, and its other clips (`rig.perform`).

    ``extras["project"]`` says what the project holds: clips with their keys, timelines, poses and performances.

    Raises:
        FormatError: where the file is damaged, with the place.
    """
    from keypose.rig import perform

    document = read_document(path)
    try:
        scene = perform(document)
    except KeyposeError as error:
        raise FormatError(str(error), path=path) from None
    return replace(scene, extras={"project": summary(document)})


def summary(document: Document) -> dict[str, Any]:
    """What a project holds, in names and numbers."""
    return {
        "name": document.name,
        "version": _version(document),
        "characters": [
            {"name": name, "joints": who.skeleton.joint_count, "timeline": document.performs.get(name)}
            for name, who in document.characters.items()
        ],
        "clips": [
            {"name": name, "curves": len(clip.curves), "keys": sum(c.key_count for c in clip.curves.values())}
            for name, clip in document.clips.items()
        ],
        "timelines": [
            {
                "name": name,
                "layers": len(track.layers),
                "placements": sum(len(layer.placements) for layer in track.layers),
                "start_s": track.start_s,
                "end_s": track.end_s,
                "rate_hz": track.rate_hz,
            }
            for name, track in document.timelines.items()
        ],
        "poses": list(document.poses),
        "rigs": [
            {"name": name, "character": rig.character, "controls": rig.controls.joint_count}
            for name, rig in document.rigs.items()
        ],
    }


def write(scene: Scene, path: Path) -> tuple[str, ...]:
    """A scene as a project: its characters, its animations as clips, the first of them on a timeline.

    Raises:
        FormatError: where the file cannot be written.
    """
    from keypose.evaluate.performing import to_document

    data = document_bytes(to_document(scene, path.stem))
    with atomic.replacing(path) as temporary:
        temporary.write_bytes(data)
    motions = sum(isinstance(animation, Motion) for animation in scene.animations)
    notes = [f"{motions} of its animations were dense; they have a key on every frame now"] if motions else []
    lost = {"markers": scene.markers, "signals": scene.signals, "force plates": scene.plates, "labels": scene.tiers}
    notes += [f"a project holds no {kind}; they are left out" for kind, items in lost.items() if items]
    return tuple(notes)
