"""Where the ground is: level, sloping or in steps, found from places at which feet stand still."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from keypose.arrays import Floats
from keypose.errors import ShapeError

GroundKind = Literal["auto", "flat", "slope", "steps"]
GROUND_KINDS: tuple[GroundKind, ...] = ("auto", "flat", "slope", "steps")
HeightFunction = Callable[[Floats, Floats], Floats]

_LEAST_TILT = np.radians(2.0)  # what is less is a floor and the noise of a capture
_MOST_TILT = np.radians(40.0)
_EXPLAINED = 0.85  # share of the standing time that a shape has to explain
_FEWEST_PLACES = 4  # on a slope or on steps
_UNDER_PERCENT = 2.0  # of the frames may lie under the ground


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """The height of the ground over the level plane.

    Units: ``height_m`` at the origin, ``slope`` metres of height for each metre along X and along Z. ``steps`` (N, 3) are
    places on top of steps: the ground is then as high as at the nearest of them. ``function`` (x, z) -> heights goes before
    both.
    """

    height_m: float = 0.0
    slope: tuple[float, float] = (0.0, 0.0)
    steps: Floats | None = None
    function: HeightFunction | None = None

    @property
    def kind(self) -> str:
        """``flat``, ``slope``, ``steps`` or ``function``."""
        if self.function is not None:
            return "function"
        return "steps" if self.steps is not None else "slope" if any(self.slope) else "flat"

    def heights(self, places: Floats) -> Floats:
        """Heights (*B,) of the ground under places (*B, 3), metres."""
        x, z = places[..., 0], places[..., 2]
        if self.function is not None:
            found = np.asarray(self.function(x, z), np.float64)
            if found.shape != x.shape or not np.isfinite(found).all():
                raise ShapeError(f"ground: expected finite heights of shape {x.shape}, got {found.shape}")
            return found
        if self.steps is not None:
            from scipy.spatial import KDTree

            nearest = KDTree(self.steps[:, [0, 2]]).query(np.stack([x, z], axis=-1))[1]
            return self.steps[nearest, 1]
        return self.height_m + self.slope[0] * x + self.slope[1] * z

    def describe(self) -> str:
        """The ground in words."""
        if self.kind == "slope":
            rise = np.degrees(np.arctan(np.hypot(*self.slope)))
            return f"a slope of {rise:.1f} degrees"
        if self.steps is not None:
            levels = len(np.unique(np.round(self.steps[:, 1], 4)))
            return f"{levels} levels from {self.steps[:, 1].min():.2f} to {self.steps[:, 1].max():.2f} m"
        return "as given" if self.function is not None else f"level, {self.height_m:+.3f} m"


@dataclass(frozen=True, slots=True, eq=False)
class Spell:
    """A foot that stands still for a while: its place (3,), frames, side, and whether it may carry the body."""

    place: Floats
    start: int
    stop: int
    side: str
    carries: bool

    @property
    def frames(self) -> int:
        """How long it is."""
        return self.stop - self.start


def still_spells(
    tracks: Mapping[str, Floats], rate_hz: float, speed_m_s: float, near_m: float, shortest: int
) -> list[Spell]:
    """Spells in which points of two feet (side -> (T, 3) metres) stand still.

    One that is higher than the other foot by more than ``near_m`` nearly all the time is held up and does not carry.
    """
    still = {side: point_speeds(track, rate_hz) < speed_m_s for side, track in tracks.items()}
    found: list[Spell] = []
    for side, track in tracks.items():
        for start, stop in true_runs(still[side]):
            if stop - start < max(2, shortest):
                continue
            carries = np.ones(stop - start, bool)
            for other, theirs in tracks.items():
                if other != side:
                    carries &= track[start:stop, 1] - theirs[start:stop, 1] <= near_m
            found.append(Spell(np.median(track[start:stop], axis=0), start, stop, side, bool(carries.mean() > 0.1)))
    return found


def fit_ground(
    spells: Sequence[Spell], tracks: Mapping[str, Floats], tolerance_m: float, kind: GroundKind = "auto"
) -> Ground:
    """The ground on which feet (side -> (T, 3) metres) stand: level if that explains most of it, else sloping, else in steps.

    Raises:
        ShapeError: for a kind that does not exist.
    """
    if kind not in GROUND_KINDS:
        raise ShapeError(f"ground: expected one of {', '.join(GROUND_KINDS)}, got {kind!r}")
    feet = np.concatenate([np.asarray(track, np.float64) for track in tracks.values()] or [np.zeros((0, 3))])
    if not len(feet):
        return Ground()
    lowest = float(np.percentile(feet[:, 1], _UNDER_PERCENT))
    carrying = [s for s in spells if s.carries] or list(spells)
    if not carrying:
        return Ground(lowest)
    places = np.array([s.place for s in carrying])
    weights = np.array([float(s.frames) for s in carrying])
    level, share = _fit_level(places[:, 1], weights, lowest, tolerance_m)
    if kind == "flat":
        return Ground(level)
    slope, explained = _fit_plane(places, weights, tolerance_m)
    if kind == "slope" or (kind == "auto" and _is_tilted(places, weights, level, slope, tolerance_m)):
        return slope
    if kind == "auto" and share >= _EXPLAINED:
        return Ground(level)
    stepped = _levelled(places, weights, tolerance_m)
    if kind == "steps":
        return Ground(level, steps=stepped)
    # A way up or down: several places on it, far apart along the ground for what they differ in height, and no foot under it.
    extent = np.ptp(places, axis=0)
    climbs = len(places) >= _FEWEST_PLACES and extent[1] > 4.0 * tolerance_m and share < 1.0 - 0.5 * _EXPLAINED
    if climbs and float(np.hypot(extent[0], extent[2])) * np.tan(_MOST_TILT) > extent[1]:
        tilt = np.arctan(np.hypot(*slope.slope))
        under = np.mean(feet[:, 1] < slope.heights(feet) - 1.5 * tolerance_m)
        if explained >= _EXPLAINED and tilt > _LEAST_TILT and 100.0 * under < _UNDER_PERCENT:
            return slope
        if len(np.unique(stepped[:, 1])) >= _FEWEST_PLACES:
            return Ground(level, steps=stepped)
    return Ground(level)


def _is_tilted(places: Floats, weights: Floats, level: float, slope: Ground, tolerance: float) -> bool:
    """Whether the floor of a capture leans a little: level it explains the feet badly, leaning it explains them well."""
    if len(places) < _FEWEST_PLACES or np.arctan(np.hypot(*slope.slope)) > _LEAST_TILT:
        return False
    flat = np.sqrt(np.average((places[:, 1] - level) ** 2, weights=weights))
    leaning = np.sqrt(np.average((places[:, 1] - slope.heights(places)) ** 2, weights=weights))
    return bool(flat > 0.4 * tolerance and leaning < 0.5 * flat)


def _fit_level(heights: Floats, weights: Floats, lowest: float, tolerance: float) -> tuple[float, float]:
    """The lowest height at which much time is spent, not over where feet get, and the share of the time near it."""
    low = heights <= lowest + 1.5 * tolerance
    if not low.any():
        return lowest, 0.0
    near = np.abs(heights[:, None] - heights) <= tolerance
    held = (near @ weights) * low
    best = np.flatnonzero(held >= 0.5 * held.max())
    level = float(heights[best[np.argmin(heights[best])]])
    for _ in range(4):
        inside = np.abs(heights - level) <= tolerance
        level = _weighted_median(heights[inside], weights[inside])
    inside = np.abs(heights - level) <= 1.5 * tolerance
    return level, float(weights[inside].sum() / weights.sum())


def _fit_plane(places: Floats, weights: Floats, tolerance: float) -> tuple[Ground, float]:
    """A plane by least squares, three times without what lies far off; one that feet do not tell across their way is level there."""
    keep = np.ones(len(places), bool)
    centre, slope, off = places.mean(axis=0), np.zeros(2), np.zeros(len(places))
    for _ in range(4):
        centre = np.average(places[keep], axis=0, weights=weights[keep])
        root = np.sqrt(weights[keep])[:, None]
        level = (places[keep][:, [0, 2]] - centre[[0, 2]]) * root
        rise = (places[keep][:, 1:2] - centre[1]) * root
        slope = np.linalg.lstsq(level, rise, rcond=0.1)[0][:, 0]
        off = np.abs(places[:, 1] - centre[1] - (places[:, [0, 2]] - centre[[0, 2]]) @ slope)
        closest = np.argsort(off)[: max(3, len(off) * 2 // 3)]
        fresh = off <= 1.5 * tolerance
        fresh[closest] = True
        if np.array_equal(fresh, keep):
            break
        keep = fresh
    explained = float(weights[off <= 1.5 * tolerance].sum() / weights.sum())
    height = float(centre[1] - slope @ centre[[0, 2]])
    return Ground(height, (float(slope[0]), float(slope[1]))), explained


def _levelled(places: Floats, weights: Floats, tolerance: float) -> Floats:
    """Places with the heights of those of nearly the same height made one."""
    order = np.argsort(places[:, 1])
    result = places.copy()
    start = 0
    for stop in range(1, len(order) + 1):
        if stop == len(order) or places[order[stop], 1] - places[order[stop - 1], 1] > tolerance:
            group = order[start:stop]
            result[group, 1] = _weighted_median(places[group, 1], weights[group])
            start = stop
    return result


def _weighted_median(values: Floats, weights: Floats) -> float:
    order = np.argsort(values)
    passed = np.cumsum(weights[order])
    return float(values[order[int(np.searchsorted(passed, 0.5 * passed[-1]))]])


def point_speeds(track: Floats, rate_hz: float) -> Floats:
    """Speed at each frame (T, ...) of points (T, ..., 3): the smaller of the steps before and after, so that a landing counts at once."""
    if len(track) < 2:
        return np.zeros(track.shape[:-1])
    steps = np.linalg.norm(np.diff(track, axis=0), axis=-1) * rate_hz
    return np.minimum(np.concatenate([steps[:1], steps]), np.concatenate([steps, steps[-1:]]))


def true_runs(track: np.ndarray) -> list[tuple[int, int]]:
    """Runs of True as (start, stop)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], track, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
