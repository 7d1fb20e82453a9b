"""Built-in characters and performances, made by code: nothing is loaded from disk.

>>> from keypose import samples
>>> samples.names()
['human', 'walk', 'idle', 'run', 'jump', 'wave', 'talk', 'ball', 'bounce']
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from keypose.errors import UnknownName
from keypose.model import Scene

__all__ = ["load", "names", "open_scene"]

PREFIX = "sample:"
_BALLS = ("ball", "bounce")


def names() -> list[str]:
    """The samples there are: the human (with all performances), each performance of it alone, the ball still and bouncing."""
    from keypose.samples import performances

    return ["human", *performances.names(), *_BALLS]


@cache
def load(name: str) -> Scene:
    """The built-in human with one performance; with all of them, the walk first, for ``human``; the ball, or it and its bounce.

    Raises:
        UnknownName: for a sample that does not exist, naming the nearest.
    """
    from keypose.samples import performances

    if name not in names():
        raise UnknownName("sample", name, names())
    if name in _BALLS:
        from keypose.samples import ball

        return Scene((ball.ball(),), (ball.bounce(),) if name == "bounce" else (), format="sample")
    from keypose.samples.human import human

    wanted = performances.names() if name == "human" else [name]
    return Scene((human(),), tuple(performances.make(n) for n in wanted), format="sample")


def open_scene(reference: str, **options: Any) -> Scene:
    """The scene that a user named: ``sample:NAME``, or the path of a file, with options of its reader.

    Raises:
        UnknownName: for a sample that does not exist, or options given for a sample.
        FormatError: where the file cannot be read.
    """
    if reference.startswith(PREFIX):
        if options:
            raise UnknownName("option of a sample", next(iter(options)), ())
        return load(reference.removeprefix(PREFIX))
    from keypose import io

    return io.load(Path(reference), **options)
