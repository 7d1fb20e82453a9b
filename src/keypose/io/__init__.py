"""Files in and out: `load` and `save` for every known format.

>>> import keypose.io
>>> [entry.name for entry in keypose.io.formats()][:2]
['bvh', 'gltf']
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from keypose.errors import FormatError, ShapeError
from keypose.io.registry import (
    HEAD_BYTES,
    Format,
    checked_options,
    format_of_content,
    format_of_suffix,
    formats,
    register,
    unknown_format,
)
from keypose.model import Character, Clip, ForcePlate, Markers, Motion, Pose, Scene, Signals, Skeleton

__all__ = ["Format", "formats", "load", "register", "save"]

_Storable = Scene | Character | Skeleton | Motion | Clip | Markers | Signals | ForcePlate


def load(path: str | PathLike[str], **options: Any) -> Scene:
    """Read a file; what was guessed, repaired or dropped is in the scene's ``notes``.

    The format is chosen by the file's content, then by its suffix; ``options`` are those of its reader.

    Raises:
        FormatError: where the file is missing, unreadable, of no known format or malformed; it names the place.
        UnknownName: for an option that the format does not have.
    """
    path = Path(path)
    head = _head(path)
    found, named = format_of_content(head), format_of_suffix(path)
    chosen = found or named
    if chosen is None:
        raise unknown_format(path, writing=False)
    reader = chosen.reader()
    try:
        scene: Scene = reader(path, **checked_options(reader, options, chosen.name))
    except FormatError as error:
        raise (error if error.path else error.at(path)) from None
    except OSError as error:
        raise FormatError(f"cannot be read: {error.strerror or error}", path=error.filename or path) from None
    if found and named and found is not named:
        scene = replace(scene, notes=(*scene.notes, f"named '{path.suffix}', but its content is {found.name}"))
    return scene


def save(scene: _Storable | Iterable[_Storable], path: str | PathLike[str], **options: Any) -> tuple[str, ...]:
    """Write a scene to a file of the format that the suffix names; returns notes of what the format could not hold.

    A character, a skeleton, a motion or clip, markers, signals, force plates, or several of these
    (``save([character, motion], path)``) are put into a scene first. The file appears whole or not at all. ``options`` are those of the format's writer.

    Raises:
        FormatError: where the suffix is unknown, or the place or the content cannot be written.
        UnknownName: for an option that the format does not have.
    """
    path = Path(path)
    chosen = format_of_suffix(path)
    if chosen is None or not chosen.write:
        raise unknown_format(path, writing=True)
    writer = chosen.writer()
    content, remarks = _as_scene(scene), tuple[str, ...]()
    _check_content(content, chosen.name, path)
    if not chosen.every_curve:
        content, remarks = _with_plain_clips(content)
    try:
        notes = writer(content, path, **checked_options(writer, options, chosen.name))
    except FormatError as error:
        raise (error if error.path else error.at(path)) from None
    except OSError as error:
        raise FormatError(f"cannot be written: {error.strerror or error}", path=error.filename or path) from None
    return (*remarks, *(notes or ()))


_NO_SKELETON = Skeleton((), np.zeros(0, np.int32), Pose(np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3))))


_OF_BODIES = ("gltf", "fbx", "usd", "obj", "keypose")
"""Formats that hold characters and what they do, and nothing else."""


def _check_content(scene: Scene, format_name: str, path: Path) -> None:
    """Raises `FormatError` where a scene has something, but nothing that the format keeps: an empty file is no copy."""
    if format_name not in _OF_BODIES or scene.characters or scene.animations:
        return
    held = {"markers": scene.markers, "signals": scene.signals, "force plates": scene.plates, "labels": scene.tiers}
    names = [kind for kind, items in held.items() if items]
    if names:
        raise FormatError(
            f"there is nothing that a {path.suffix} file can hold: no character and no motion, only {', '.join(names)}",
            path=path,
        )


def _with_plain_clips(scene: Scene) -> tuple[Scene, tuple[str, ...]]:
    """The scene as formats know clips: whole channels in steps, lines and Hermite cubics, and notes of what that took."""
    if not any(isinstance(a, Clip) for a in scene.animations):
        return scene, ()
    from keypose.evaluate import match_report, plain_clip

    skeletons = [c.skeleton for c in scene.characters] or [_NO_SKELETON]
    animations: list[Motion | Clip] = []
    notes: list[str] = []
    for animation in scene.animations:
        if isinstance(animation, Clip):
            clip = animation
            nearest = (
                max(skeletons, key=lambda s: len(match_report(clip, s).sources)) if len(skeletons) > 1 else skeletons[0]
            )
            plain = plain_clip(clip, nearest)
            notes.extend(plain.notes)
            if plain.converted:
                notes.append(
                    f"clip '{clip.name}': {plain.converted} channels of Bezier handles, Euler angles, single components or "
                    f"rotation splines are written as Hermite keys, no further than {plain.error:.2g} from them"
                )
            animation = plain.clip
        animations.append(animation)
    return replace(scene, animations=tuple(animations)), tuple(notes)


def _head(path: Path) -> bytes:
    if path.is_dir():
        raise FormatError("is a folder; expected a file", path=path)
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except FileNotFoundError:
        raise FormatError("no such file", path=path) from None
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        raise FormatError(f"cannot be read: {getattr(error, 'strerror', None) or error}", path=path) from None
    if not head:
        raise FormatError("the file is empty", path=path)
    return head


def _as_scene(content: _Storable | Iterable[_Storable]) -> Scene:
    if isinstance(content, Scene):
        return content
    single = (Character, Skeleton, Motion, Clip, Markers, Signals, ForcePlate)
    items = [content] if isinstance(content, single) else list(content)
    characters: list[Character] = []
    animations: list[Motion | Clip] = []
    markers: list[Markers] = []
    signals: list[Signals] = []
    plates: list[ForcePlate] = []
    for item in items:
        if isinstance(item, Skeleton):
            characters.append(Character(item))
        elif isinstance(item, Character):
            characters.append(item)
        elif isinstance(item, (Motion, Clip)):
            animations.append(item)
        elif isinstance(item, Markers):
            markers.append(item)
        elif isinstance(item, Signals):
            signals.append(item)
        elif isinstance(item, ForcePlate):
            plates.append(item)
        else:
            raise ShapeError(
                "expected a Scene, Character, Skeleton, Motion, Clip, Markers, Signals or ForcePlate to save, "
                f"got {type(item).__name__}"
            )
    return Scene(
        tuple(characters), tuple(animations), markers=tuple(markers), signals=tuple(signals), plates=tuple(plates)
    )
