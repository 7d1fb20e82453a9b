"""Reading what the user named: files and samples, several at once."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

from keypose.errors import ShapeError
from keypose.model import Scene


def open_input(reference: str, *, unit: str | None = None, up: str | None = None) -> Scene:
    """The scene of a file or of ``sample:NAME``; raises where its format does not take the options."""
    from keypose.samples import open_scene

    return open_scene(reference, **_options(unit, up))


def open_inputs(references: list[str], *, unit: str | None = None, up: str | None = None) -> list[Scene]:
    """Several scenes; the options go to those files whose format does not say its unit and axes.

    Raises:
        ShapeError: where no file takes an option that was given.
    """
    if len(references) == 1:
        return [open_input(references[0], unit=unit, up=up)]
    given = _options(unit, up)
    takers = {name: [r for r in references if _takes(r, name)] for name in given}
    for name, takes in takers.items():
        if not takes:
            raise ShapeError(f"--{name}: all of these files say their {name}, so there is nothing to set")
    skeletons = [r for r in references if Path(r).suffix.lower() == ".asf"]
    return [
        _open(r, {name: value for name, value in given.items() if r in takers[name]}, skeletons) for r in references
    ]


def _open(reference: str, options: dict[str, Any], skeletons: list[str]) -> Scene:
    """One of several inputs; an AMC file, which holds no skeleton, takes the one that is named beside it."""
    from keypose.samples import open_scene

    if len(skeletons) == 1 and _takes(reference, "skeleton") and reference not in skeletons:
        options = {**options, "skeleton": skeletons[0]}
    return open_scene(reference, **options)


def file_word(count: int, word: str, plural: str | None = None) -> str:
    """``1 clip``, ``3 clips``."""
    return f"{count:,} {word if count == 1 else plural or word + 's'}"


def unit_option(text: str) -> str | float:
    """A unit's name, or metres per unit where the text is a number."""
    try:
        return float(text)
    except ValueError:
        return text


def _options(unit: str | None, up: str | None) -> dict[str, Any]:
    options: dict[str, Any] = {}
    if unit is not None:
        options["unit"] = unit_option(unit)
    if up is not None:
        options["up"] = up
    return options


def _takes(reference: str, option: str) -> bool:
    from keypose.io.registry import format_of_suffix

    chosen = None if reference.startswith("sample:") else format_of_suffix(Path(reference))
    return chosen is not None and option in inspect.signature(chosen.reader()).parameters
