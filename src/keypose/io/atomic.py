"""Writing that leaves either the whole new file or the old one: a temporary file beside the target, then a rename."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Generator
from os import PathLike
from pathlib import Path

from keypose.errors import FormatError


def check_place(path: str | PathLike[str]) -> Path:
    """Where a file of this name would be written, links followed.

    Raises:
        FormatError: where the folder does not exist, or the target is a folder or read-only.
    """
    named = Path(path)
    target = Path(os.path.realpath(named))
    if target.is_dir():
        raise FormatError("is a folder; expected the name of a file to write", path=named)
    if target.exists() and not target.stat().st_mode & 0o222:  # a rename would replace it all the same
        raise FormatError("is read-only; name another file, or make it writable", path=named)
    if not target.parent.is_dir():
        raise FormatError(f"the folder '{named.parent}' does not exist", path=named)
    return target


@contextlib.contextmanager
def replacing(path: str | PathLike[str]) -> Generator[Path]:
    """A path to write to; it takes the target's place when the block ends, and vanishes if the block fails.

    The temporary file lies in the target's own folder, so that the rename cannot cross file systems, and has the
    target's suffix, for writers that choose by it. The new file has the permissions of the one it replaces, else
    those that any new file gets. A symbolic link keeps pointing where it does; the file behind it is replaced.

    Raises:
        FormatError: where the folder does not exist, the target is a folder or read-only, or the place is not writable.
    """
    target = check_place(path)
    named = Path(path)
    temporary = target.with_name(f".{target.stem[:64]}-{secrets.token_hex(4)}{target.suffix}")
    try:
        mode = target.stat().st_mode & 0o777 if target.exists() else 0o666
        # made here, exclusively and with the final permissions; the writer then opens an existing file
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode))
        if target.exists():
            os.chmod(temporary, mode)
    except OSError as error:
        raise FormatError(f"cannot be written: {error.strerror or error}", path=named) from None
    try:
        yield temporary
        os.replace(temporary, target)
    finally:
        with contextlib.suppress(FileNotFoundError):  # gone already when the rename succeeded
            temporary.unlink()
