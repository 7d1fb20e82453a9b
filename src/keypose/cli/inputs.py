"""Reading what the user named: files and samples, several at once."""

from __future__ import annotations

from typing import Any

from keypose.model import Scene


def open_input(reference: str, *, unit: str | None = None, up: str | None = None) -> Scene:
    """The scene of a file or of ``sample:NAME``."""
    from keypose.samples import open_scene

    options: dict[str, Any] = {}
    if unit is not None:
        options["unit"] = unit
    if up is not None:
        options["up"] = up
    return open_scene(reference, **options)


def file_word(count: int, word: str) -> str:
    """``1 clip``, ``3 clips``."""
    return f"{count:,} {word}{'' if count == 1 else 's'}"
