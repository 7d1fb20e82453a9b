"""Project files on disk: load and save a `Document`, and where unsaved work is kept."""

from __future__ import annotations

import os
import sys
from os import PathLike
from pathlib import Path

from keypose.errors import FormatError, KeyposeError
from keypose.io.native import document_bytes, document_from_bytes, read_document
from keypose.model import Document
from keypose.project.disk import Disk, write_whole
from keypose.project.document import check

SUFFIX = ".keypose"


def load(path: str | PathLike[str]) -> Document:
    """The document of a project file.

    Raises:
        FormatError: where the file is missing, damaged, no project, or of a newer version; names file and place.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise FormatError("is a folder; expected a project file", path=path)
        return checked(read_document(path))
    except FormatError as error:
        raise (error if error.path else error.at(path)) from None
    except KeyposeError as error:
        raise FormatError(str(error), path=path) from None
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        what = (
            "no such file" if isinstance(error, FileNotFoundError) else getattr(error, "strerror", None) or str(error)
        )
        raise FormatError(what, path=path) from None


def save(document: Document, path: str | PathLike[str]) -> None:
    """Write a document as a project file, whole or not at all; it survives a loss of power on return.

    Raises:
        FormatError: where the place cannot be written, or the document holds a number that is not finite.
    """
    path = Path(path)
    data = document_bytes(checked(document))
    try:
        write_whole(Disk(), path, data)
    except (OSError, ValueError) as error:
        raise FormatError(f"cannot be written: {getattr(error, 'strerror', None) or error}", path=path) from None


def from_bytes(data: bytes) -> Document:
    """The document of a project file's bytes; raises `FormatError` as `load` does."""
    return checked(document_from_bytes(data))


def checked(document: Document) -> Document:
    """The document itself; raises where it names what is not there."""
    check(document)
    return document


def state_folder() -> Path:
    """Where unsaved work of this user is kept; made if it is not there, closed to others.

    ``XDG_STATE_HOME/keypose``, else ``~/.local/state/keypose``; on macOS ``~/Library/Application Support/keypose``, on
    Windows ``%LOCALAPPDATA%\\keypose``.

    Raises:
        OSError: where it cannot be made.
    """
    given = os.environ.get("XDG_STATE_HOME", "")
    if given and os.path.isabs(given):  # the specification says to pass over relative ones
        base = Path(given)
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Application Support"
    else:
        base = Path.home() / ".local" / "state"
    folder = base / "keypose"
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    if os.name != "nt":
        folder.chmod(0o700)
    return folder
