"""Synchronisation: clips of different lengths meet at markers, and move evenly in between.

A place is (number of the marker that was passed, counted on through all cycles; share of the way to the next one).
Between two markers all clips of a group move by the same share, each through its own interval; the time that takes is the
weighted mean of their times. Synchronisation by phase is the case of one marker at the start of each clip.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

Position: TypeAlias = tuple[int, float]

CLOSEST_S = 1e-3  # two markers of a clip must not be nearer


@dataclass(frozen=True, slots=True)
class SyncTable:
    """The markers of a clip: rising times, the first within the clip, the last less than a clip's length later."""

    times_s: tuple[float, ...]
    duration_s: float

    def seconds(self, interval: int) -> float:
        """The length of an interval, counted on through all loops."""
        i = interval % len(self.times_s)
        after = self.times_s[i + 1] if i + 1 < len(self.times_s) else self.times_s[0] + self.duration_s
        return after - self.times_s[i]

    def time(self, at: Position) -> tuple[int, float]:
        """Loop and time inside it at a place."""
        loop, i = divmod(at[0], len(self.times_s))
        time = self.times_s[i] + at[1] * self.seconds(i)
        while time >= self.duration_s:
            loop, time = loop + 1, time - self.duration_s
        return loop, time

    def position(self, loop: int, time_s: float) -> Position:
        """The place at a loop and a time inside it."""
        if time_s < self.times_s[0]:
            loop, time_s = loop - 1, time_s + self.duration_s
        i = bisect_right(self.times_s, time_s) - 1
        share = (time_s - self.times_s[i]) / self.seconds(i)
        return loop * len(self.times_s) + i, min(max(share, 0.0), 1.0)


def progress(at: Position, dt_s: float, seconds: Callable[[int], float]) -> Position:
    """The place after a time, where each interval takes ``seconds(interval)``."""
    interval, share = at
    while dt_s > 0:
        length = max(seconds(interval), 1e-6)
        left = (1.0 - share) * length
        if dt_s < left:
            return interval, share + dt_s / length
        dt_s -= left
        interval, share = interval + 1, 0.0
    return interval, share


def period(names: Sequence[str]) -> tuple[str, ...]:
    """The shortest piece that a cyclic sequence of names repeats."""
    for n in range(1, len(names) + 1):
        if len(names) % n == 0 and all(names[i] == names[i % n] for i in range(len(names))):
            return tuple(names[:n])
    return ()


def table_for(markers: Sequence[tuple[float, str]], pattern: Sequence[str], duration_s: float) -> SyncTable | None:
    """The table of a clip whose markers repeat the pattern, begun where the pattern begins; None where they do not."""
    names, times = [name for _, name in markers], [time for time, _ in markers]
    if not names or len(names) % len(pattern):
        return None
    for first in range(len(names)):
        if all(names[(first + i) % len(names)] == pattern[i % len(pattern)] for i in range(len(names))):
            turned = [*times[first:], *(t + duration_s for t in times[:first])]
            return SyncTable(tuple(turned), duration_s)
    return None
