"""Built-in samples: a procedurally generated human character and performances made by code."""

from __future__ import annotations

from os import PathLike, fspath
from typing import TYPE_CHECKING

from keypose.errors import UnknownName

if TYPE_CHECKING:
    from keypose.model import Scene

__all__ = ["load", "names", "open_scene"]

PREFIX = "sample:"


def names() -> list[str]:
    """Names of all samples: "human", then the performances."""
    from keypose.samples import performances

    return ["human", *performances.names()]


def load(name: str) -> Scene:
    """The built-in human, alone ("human") or with one performance as the scene's animation ("walk").

    Raises:
        UnknownName: for a name that `names` does not list.
    """
    from keypose.model import Scene
    from keypose.samples.human import human

    if name == "human":
        return Scene((human(),), format="sample")
    from keypose.samples import performances

    known = performances.names()
    if name not in known:
        raise UnknownName("sample", name, ["human", *known])
    return Scene((human(),), (performances.make(name),), format="sample")


def open_scene(reference: str | PathLike[str]) -> Scene:
    """The scene that a reference names: "sample:NAME" a built-in sample, anything else the path of a file.

    Raises:
        UnknownName: for an unknown sample.
        FormatError: for a malformed file.
    """
    reference = fspath(reference)
    if reference.startswith(PREFIX):
        return load(reference[len(PREFIX) :])
    from keypose import io

    return io.load(reference)
