"""Reading what the user named: files and samples, several at once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from keypose.cli.options import Chosen, choose, parameters, reader_of, with_option
from keypose.errors import FormatError, ShapeError
from keypose.model import Clip, Motion, Scene, Skeleton

if TYPE_CHECKING:
    from keypose.analysis import RoleMap

_FILM_HZ = 30.0  # of clips that name no rate and whose keys are at none


def open_input(
    reference: str,
    *,
    unit: str | None = None,
    up: str | None = None,
    skeleton: str | None = None,
    options: Sequence[str] = (),
) -> Scene:
    """The scene of a file or of ``sample:NAME``; raises where its format does not take the options."""
    return open_inputs([reference], unit=unit, up=up, skeleton=skeleton, options=options)[0]


def open_inputs(
    references: list[str],
    *,
    unit: str | None = None,
    up: str | None = None,
    skeleton: str | None = None,
    options: Sequence[str] = (),
) -> list[Scene]:
    """Several scenes; ``unit``, ``up`` and ``skeleton`` go to those files whose format takes them.

    Raises:
        ShapeError, UnknownName: where no file takes an option that was given.
    """
    return open_chosen(references, choose(options, references), unit=unit, up=up, skeleton=skeleton)


def open_chosen(
    references: list[str],
    chosen: Chosen,
    *,
    unit: str | None = None,
    up: str | None = None,
    skeleton: str | None = None,
) -> list[Scene]:
    """As `open_inputs`, with options that are sorted already."""
    from keypose.samples import open_scene

    for name, value in (("unit", unit), ("up", up)):
        if value is None:
            continue
        if not any(name in parameters(reader_of(r)) for r in references):
            one = len(references) == 1
            what = "this file says its" if one else "all of these files say their"
            raise ShapeError(f"--{name}: {what} {name}, so there is nothing to set")
        chosen = with_option(chosen, references, name, unit_option(value) if name == "unit" else value)
    if skeleton is not None:
        chosen = with_option(chosen, references, "skeleton", skeleton)
    given = [dict(own) for own in chosen.reading]
    # An AMC file, which holds no skeleton, takes the one that is named beside it.
    skeletons = [r for r in references if Path(r).suffix.lower() == ".asf"]
    for own, reference in zip(given, references, strict=True):
        if len(skeletons) == 1 and reference not in skeletons and "skeleton" in parameters(reader_of(reference)):
            own.setdefault("skeleton", skeletons[0])
    return [open_scene(reference, **own) for reference, own in zip(references, given, strict=True)]


def motion_of(scene: Scene, reference: str, clip: str | None = None, rate_hz: float | None = None) -> Motion:
    """The first animation of the first character, or the one of that name, as a motion of its skeleton.

    Raises:
        FormatError: where there is none.
        UnknownName: for a clip that does not exist.
    """
    from keypose.evaluate import match, resample

    if not scene.characters or not scene.animations:
        raise FormatError("it has no motion of a skeleton", path=reference)
    animation = scene.animations[0] if clip is None else scene.animation(clip)
    body = scene.character.skeleton
    if isinstance(animation, Clip):
        return baked(animation, body, rate_hz)
    motion = match(animation, body)
    return motion if rate_hz is None else resample(motion, rate_hz)


def baked(clip: Clip, skeleton: Skeleton, rate_hz: float | None = None) -> Motion:
    """A clip in frames: at the rate that is asked for, else its own, else that of its keys."""
    from keypose.evaluate import bake, key_rate

    return bake(clip, skeleton, rate_hz or clip.rate_hz or key_rate(clip) or _FILM_HZ)


def read_roles(path: Path, skeleton: Skeleton) -> RoleMap:
    """A map of roles, as `keypose roles` writes it.

    Raises:
        FormatError: where the file cannot be read, or holds no map of this skeleton.
    """
    from keypose.analysis import roles_from_json

    try:
        return roles_from_json(path.read_text(encoding="utf-8"), skeleton)
    except (OSError, UnicodeDecodeError) as error:
        raise FormatError(getattr(error, "strerror", None) or "it is no text", path=path) from None


def file_word(count: int, word: str, plural: str | None = None) -> str:
    """``1 clip``, ``3 clips``."""
    return f"{count:,} {word if count == 1 else plural or word + 's'}"


def unit_option(text: str) -> str | float:
    """A unit's name, or metres per unit where the text is a number."""
    try:
        return float(text)
    except ValueError:
        return text
