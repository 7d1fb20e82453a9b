"""Reading what the user named: files and samples, several at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from keypose.cli.options import Chosen, choose, parameters, reader_of, with_option
from keypose.errors import FormatError, KeyposeError, ShapeError
from keypose.model import Character, Clip, Motion, Scene, Skeleton

if TYPE_CHECKING:
    from keypose.analysis import RoleMap


@dataclass(frozen=True, slots=True)
class Reading:
    """What is said about files that do not say it: unit and up axis, the skeleton of a motion, options of their formats."""

    unit: str | None = None
    up: str | None = None
    skeleton: str | None = None
    options: Sequence[str] = ()


AS_THEY_SAY = Reading()


def open_input(reference: str, reading: Reading = AS_THEY_SAY) -> Scene:
    """The scene of a file or of ``sample:NAME``; raises where its format does not take the options."""
    return open_inputs([reference], reading)[0]


def open_inputs(references: list[str], reading: Reading = AS_THEY_SAY) -> list[Scene]:
    """Several scenes; unit, up axis and skeleton go to those files whose format takes them.

    Raises:
        ShapeError, UnknownName: where no file takes an option that was given.
    """
    return open_chosen(references, choose(reading.options, references), reading)


def open_chosen(references: list[str], chosen: Chosen, reading: Reading = AS_THEY_SAY) -> list[Scene]:
    """As `open_inputs`, with the options of formats sorted already.

    Raises:
        ShapeError: where no file takes the unit, up axis or skeleton.
    """
    from keypose.samples import open_scene

    for name, value in (("unit", reading.unit), ("up", reading.up)):
        if value is None:
            continue
        if not any(name in parameters(reader_of(r)) for r in references):
            one = len(references) == 1
            what = "this file says its" if one else "all of these files say their"
            raise ShapeError(f"--{name}: {what} {name}, so there is nothing to set")
        chosen = with_option(chosen, references, name, unit_option(value) if name == "unit" else value)
    if reading.skeleton is not None:
        chosen = with_option(chosen, references, "skeleton", reading.skeleton)
    given = [dict(own) for own in chosen.reading]
    # An AMC file, which holds no skeleton, takes the one that is named beside it.
    skeletons = [r for r in references if Path(r).suffix.lower() == ".asf"]
    for own, reference in zip(given, references, strict=True):
        if len(skeletons) == 1 and reference not in skeletons and "skeleton" in parameters(reader_of(reference)):
            own.setdefault("skeleton", skeletons[0])
    return [open_scene(reference, **own) for reference, own in zip(references, given, strict=True)]


def body_of(scene: Scene, reference: str) -> Character:
    """The first character.

    Raises:
        FormatError: where there is none.
    """
    if not scene.characters:
        raise FormatError("it has no skeleton", path=reference)
    return scene.character


def animation_of(scene: Scene, reference: str, clip: str | None = None) -> Motion | Clip:
    """The first animation, or the one of that name.

    Raises:
        FormatError: where there is none.
        UnknownName: for a clip that does not exist.
    """
    if not scene.animations:
        raise FormatError("it has no motion", path=reference)
    return scene.animations[0] if clip is None else scene.animation(clip)


def motion_of(scene: Scene, reference: str, clip: str | None = None, rate_hz: float | None = None) -> Motion:
    """The first animation of the first character, or the one of that name, as a motion of its skeleton.

    Raises:
        FormatError: where there is none.
        UnknownName: for a clip that does not exist.
    """
    if not scene.characters or not scene.animations:
        raise FormatError("it has no motion of a skeleton", path=reference)
    from keypose.evaluate import to_motion

    return to_motion(animation_of(scene, reference, clip), scene.character.skeleton, rate_hz)


def read_roles(path: Path, skeleton: Skeleton) -> RoleMap:
    """A map of roles, as `keypose roles` writes it.

    Raises:
        FormatError: where the file cannot be read, or holds no map of this skeleton.
    """
    from keypose.analysis import roles_from_json

    try:
        return roles_from_json(path.read_text(encoding="utf-8"), skeleton)
    except UnicodeDecodeError:
        raise FormatError("it is no text", path=path) from None
    except KeyposeError as error:
        raise FormatError(str(error), path=path) from None


def unit_option(text: str) -> str | float:
    """A unit's name, or metres per unit where the text is a number."""
    try:
        return float(text)
    except ValueError:
        return text
