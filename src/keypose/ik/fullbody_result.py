"""What a full-body solve is told about effort, and what comes of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from keypose.arrays import Array, Floats, Ints
from keypose.errors import ShapeError
from keypose.model import Pose

OUTCOMES = ("reached", "settled", "out of steps")


@dataclass(frozen=True, slots=True)
class SolveOptions:
    """How long and how closely to solve.

    ``iterations``: steps at most; ``tolerance_m``, ``tolerance_rad``: what counts as reached, of every task but priors;
    ``settled_rad``: steps smaller than this (radians, metres of the root) end a solve that cannot reach; ``damping``: of the
    first step, as a share of the cost; ``still_m``: what no task changes by (metres, radians) any more in a few steps hardly
    damped, ends it too; ``restarts``: how often solves that settled without reaching begin again elsewhere
    (poses spread about the first by ``spread_rad``, the same every time); the best is kept. Restarts may make neighbouring
    targets' poses jump.
    """

    iterations: int = 100
    tolerance_m: float = 1e-5
    tolerance_rad: float = 1e-5
    settled_rad: float = 1e-8
    still_m: float = 1e-9
    damping: float = 0.1
    restarts: int = 0
    spread_rad: float = 0.7

    def __post_init__(self) -> None:
        if self.iterations < 0 or self.restarts < 0:
            raise ShapeError(f"iterations, restarts: expected at least 0, got {self.iterations} and {self.restarts}")
        for name in ("tolerance_m", "tolerance_rad", "settled_rad", "still_m", "damping", "spread_rad"):
            if not getattr(self, name) > 0:
                raise ShapeError(f"{name}: expected more than 0, got {getattr(self, name)}")


@dataclass(frozen=True, slots=True, eq=False)
class TaskResidual:
    """What is left of a task, unweighted (*B): metres, radians, or both for a relative task; None where there is none such.

    Of a prior the angle is that of the joint that is furthest from its pose.
    """

    distance_m: Floats | None
    angle_rad: Floats | None


class _Unread:
    """Room for what makes parts of a result when they are first looked at."""

    __slots__ = ("_make",)


@dataclass(frozen=True, slots=True, eq=False)
class IkResult(_Unread):
    """A pose that does what was asked as well as it can.

    Shapes and units: ``pose`` of batch shape (*B,); ``residuals`` one for each task; ``cost`` (*B,) half the sum of the
    weighted squares, square metres; ``iterations`` (*B,) steps; ``outcome`` (*B,) indices of `OUTCOMES`: all tasks are
    within their tolerances; no step makes it better (targets out of reach, against each other or against limits); or steps
    ran out.
    """

    pose: Pose
    residuals: tuple[TaskResidual, ...]
    cost: Floats
    iterations: Ints
    outcome: Ints

    @property
    def reached(self) -> Array:
        """(*B,) whether all tasks but priors are within their tolerances."""
        return self.outcome == 0

    @property
    def converged(self) -> Array:
        """(*B,) whether nothing is left to gain."""
        return self.outcome != 2

    @property
    def reasons(self) -> Array:
        """(*B,) the outcomes in words."""
        return np.asarray(OUTCOMES)[self.outcome]

    if not TYPE_CHECKING:  # to the type checker all parts are there

        def __getattr__(self, name: str) -> Any:
            """A part that was not made yet."""
            part = object.__getattribute__(self, "_make")(name)
            object.__setattr__(self, name, part)
            return part


def result_with(pose: Pose, make: Callable[[str], Any]) -> IkResult:
    """A result whose parts but the pose are made, by their names, when they are first looked at.

    What is no part's name is refused with an `AttributeError`.
    """
    found = object.__new__(IkResult)
    object.__setattr__(found, "pose", pose)
    object.__setattr__(found, "_make", make)
    return found
