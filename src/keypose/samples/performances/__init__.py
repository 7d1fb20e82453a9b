"""Performances of the built-in human, made by code."""

from __future__ import annotations

from functools import cache

from keypose.errors import UnknownName
from keypose.model import Motion

_NAMES = ("walk", "idle", "run", "jump", "wave", "talk")


def names() -> list[str]:
    """The performances there are."""
    return list(_NAMES)


@cache
def make(name: str) -> Motion:
    """The motion of that name on the built-in skeleton; raises `UnknownName`."""
    from keypose.samples.performances import acting, gait

    makers = {m.__name__: m for m in (gait.walk, acting.idle, gait.run, acting.jump, acting.wave, acting.talk)}
    if name not in makers:
        raise UnknownName("performance", name, _NAMES)
    return makers[name]()
