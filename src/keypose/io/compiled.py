"""Compiled clips on disk."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from keypose.errors import FormatError
from keypose.io.atomic import replacing
from keypose.play import CompiledClip, from_bytes, to_bytes
from keypose.play.clipfile import MAGIC

SUFFIX = ".kpclip"
_HEAD = 32


def save_compiled(clip: CompiledClip, path: str | PathLike[str]) -> None:
    """Write a compiled clip: either the whole new file is there afterwards or the old one.

    Raises:
        FormatError: where the place is not writable.
    """
    with replacing(path) as temporary:
        try:
            temporary.write_bytes(to_bytes(clip))
        except OSError as error:
            raise FormatError(f"cannot be written: {error.strerror or error}", path=path) from None


def load_compiled(path: str | PathLike[str]) -> CompiledClip:
    """Read a compiled clip.

    Raises:
        FormatError: where the file is missing, no compiled clip, of another version, changed or cut; it names the place.
    """
    try:
        with Path(path).open("rb") as file:
            data = file.read(_HEAD)
            if data.startswith(MAGIC):  # nothing else is worth reading to its end
                data += file.read()
    except OSError as error:
        raise FormatError(f"cannot be read: {error.strerror or error}", path=path) from None
    try:
        return from_bytes(data)
    except FormatError as error:
        raise error.at(path) from None
