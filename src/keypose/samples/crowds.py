"""The built-in human for crowds: its levels of detail."""

from __future__ import annotations

from functools import cache

import numpy as np

from keypose import evaluate
from keypose.model import Pose
from keypose.play.levels import Level, LevelSpec, build
from keypose.samples import load

_INSIDE = ("upper_teeth", "lower_teeth", "tongue")
_TRIMMINGS = (*_INSIDE, "mouth", "lashes", "catchlights", "laces", "seams", "zip", "pockets")

SPECS = (
    LevelSpec(above=0.42),
    LevelSpec(0.40, 0.008, above=0.16, without=_INSIDE),
    LevelSpec(0.125, 0.03, 2, above=0.055, without=_TRIMMINGS),
    LevelSpec(0.05, 0.06, 4, without=_TRIMMINGS),
)
_IMPORTANCE = {
    "head": 8.0,
    "eyes": 16.0,
    "brows": 16.0,
    "hair": 1.5,
    "ears": 1.5,
    "hands": 1.5,
    "zip": 20.0,
    "star": 20.0,
    "pockets": 8.0,
}
_EXAMPLES = ("idle", "walk", "run", "jump", "wave")
_EACH = 12  # poses of each performance


@cache
def levels() -> tuple[Level, ...]:
    """The levels of detail of the built-in human, with what its performances do as examples; built once per process."""
    return build(load("human").character, SPECS, examples(), _IMPORTANCE)


def examples() -> Pose:
    """Poses of the performances that a crowd plays."""
    human = load("human")
    found: list[Pose] = []
    for name in _EXAMPLES:
        motion = human.animation(name)
        end = motion.start_s + motion.duration_s
        times = np.linspace(motion.start_s, end, _EACH, endpoint=False)
        found.append(evaluate.sample(motion, human.character.skeleton, times))
    joined = (np.concatenate([getattr(p, field) for p in found]) for field in ("translations", "rotations", "scales"))
    return Pose(*joined)
