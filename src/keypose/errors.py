"""The exception tree of keypose.

KeyposeError
    ShapeError(ValueError)      an array has the wrong shape or type
    UnknownName(KeyError)       a name is not there; the message gives the nearest one
    FormatError(ValueError)     a file is malformed; the message names the place
    MissingExtra(ImportError)   an optional library is not installed; the message installs it

Wrong input raises one of these; hard problems that may fail to converge return a result that says so.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from os import PathLike, fspath


class KeyposeError(Exception):
    """Base of every error that keypose raises on purpose."""


class ShapeError(KeyposeError, ValueError):
    """An array, number or option does not fit what the function expects."""


class UnknownName(KeyposeError, KeyError):
    """A joint, curve, clip or option is asked for by a name that does not exist."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        self.kind, self.name, self.known = kind, name, tuple(known)
        super().__init__(_unknown_name_message(kind, name, self.known))

    def __str__(self) -> str:  # KeyError would show the repr of its argument
        return str(self.args[0])


class FormatError(KeyposeError, ValueError):
    """A file or a block of data does not follow its format.

    ``where`` is the place a person can find again: ``line 12``, ``byte 300``, ``accessors[4]``.
    """

    def __init__(self, what: str, *, where: str = "", path: str | PathLike[str] | None = None) -> None:
        self.what, self.where = what, where
        self.path = None if path is None else fspath(path)
        super().__init__(what)

    def __str__(self) -> str:
        return ": ".join(part for part in (self.path, self.where, self.what) if part)

    def at(self, path: str | PathLike[str]) -> FormatError:
        """The same error, naming the file it was found in."""
        return FormatError(self.what, where=self.where, path=path)


class MissingExtra(KeyposeError, ImportError):
    """Something needs an optional library; the message holds the install command."""

    def __init__(self, feature: str, extra: str) -> None:
        self.feature, self.extra = feature, extra
        super().__init__(f"{feature} needs an optional library; install it with: pip install 'keypose[{extra}]'")


def _unknown_name_message(kind: str, name: str, known: Sequence[str]) -> str:
    message = f"no {kind} '{name}'"
    folded = {k.casefold(): k for k in known}
    close = difflib.get_close_matches(name.casefold(), folded, n=1, cutoff=0.5)
    if close:
        return f"{message}; nearest: '{folded[close[0]]}'"
    if not known:
        return f"{message}; there are none"
    shown = ", ".join(f"'{k}'" for k in known[:8])
    return f"{message}; known: {shown}{', …' if len(known) > 8 else ''}"
