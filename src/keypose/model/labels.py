"""Tier: what is said when; labelled intervals or points of time, as speech tools mark phones and words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from keypose.arrays import Array, checked, frozen
from keypose.errors import ShapeError


@dataclass(frozen=True, slots=True, eq=False)
class Tier:
    """N labels with their times, in order.

    Shapes and units: ``starts_s``, ``ends_s`` (N,) seconds; of a tier of points (``is_points``) they are equal.
    ``start_s``, ``end_s`` are the ends of the tier, those of its labels if not given.

    Raises:
        ShapeError: where lengths disagree, times are not finite, a label ends before it starts or starts before the one
            before it.
    """

    name: str
    starts_s: Array
    ends_s: Array
    labels: tuple[str, ...]
    is_points: bool = False
    start_s: float | None = None
    end_s: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", tuple(self.labels))
        for name in ("starts_s", "ends_s"):
            times = frozen(getattr(self, name), np.float64)
            object.__setattr__(self, name, checked(times, (len(self.labels),), name, "labels"))
            if not np.all(np.isfinite(times)):
                raise ShapeError(f"{name}: expected finite numbers")
        late = np.nonzero(self.ends_s < self.starts_s)[0]
        if len(late):
            raise ShapeError(f"tier '{self.name}': label {int(late[0])} ends before it starts")
        early = np.nonzero(np.diff(self.starts_s) < 0)[0]
        if len(early):
            raise ShapeError(f"tier '{self.name}': label {int(early[0]) + 1} starts before the one before it")
        if self.start_s is None:
            object.__setattr__(self, "start_s", float(self.starts_s[0]) if len(self.labels) else 0.0)
        if self.end_s is None:
            object.__setattr__(self, "end_s", float(self.ends_s.max(initial=self.start_s or 0.0)))

    def at(self, times_s: Array) -> Array:
        """The number of the label at each time (*B,), -1 where there is none; an end belongs to what follows."""
        times = np.asarray(times_s, np.float64)
        index = np.searchsorted(self.starts_s, times, side="right") - 1
        inside = (index >= 0) & (times < np.append(self.ends_s, -np.inf)[index])
        return np.where(inside, index, -1)
