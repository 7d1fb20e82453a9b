"""Hips that come along with planted feet: knees bend as they did where they can, and do not jump."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded, solveh_banded
from scipy.ndimage import gaussian_filter1d

from keypose.analysis.contacts import LEG_M
from keypose.arrays import Floats
from keypose.editing.planting_legs import Leg, knee_angles, reached_angles
from keypose.editing.planting_paths import FootPath, norms, smooth_over

# What counts as much as a radian that a knee changes: the hips' path by the metre and its acceleration by the metre a second
# squared (for a leg of LEG_M), and the acceleration of a knee by the radian a second squared.
_PATH_WEIGHT = 20.0
_LEVEL_WEIGHT = 100.0  # for the part along the ground
_ACCELERATION_WEIGHTS = 0.01, 0.003  # the second where knees cannot be bounded with the first
_KNEE_ACCELERATION_WEIGHT = 0.006
_LEAST_BENT = 0.06  # a knee is taken as bent at least so far, radians
_JUMP = 1000.0  # an angular acceleration of a knee that no knee has, radians a second squared
_NEWTON_STEPS = 4
_STRAIGHTEST = 0.997  # share of a leg's length that planting may ask for
_STAY_M = 0.1  # hips stay where they are along the ground while feet together go no farther, for a leg of LEG_M

# The bounded problem: how much a broken bound weighs, how often it is made linear, and steps between.
_STIFFNESS = 10.0
_BOUND_ROUNDS, _BOUND_STEPS = 8, 60
_INSIDE = 0.97  # share of a bound that is aimed at, for what linear knees leave
_REACH_M = 0.01  # what counts as much as a knee's whole bound, too far for a leg of LEG_M


def hips_path(
    legs: Sequence[Leg], paths: Sequence[FootPath], rate_hz: float, upright: bool, knee_limit: float
) -> Floats:
    """How the hips are moved (T, 3) so that knees bend as they did where they can.

    A leg that is nearly straight cannot become longer, and its knee turns fast for little; the jitter of a captured body would
    go into the knees of feet that stand still: there the hips go along. The path is the least-squares answer for what both
    knees change, in angle and in acceleration, for how far the hips are from the middle of the feet's own corrections, and for
    their acceleration; what is out of reach brings the hips down. Where a knee would be accelerated more than ``knee_limit``
    (radians a second squared), the same is solved within that bound and within reach. ``upright``: they only go up and down.

    Source: S. Boyd et al., "Distributed optimization and statistical learning via the alternating direction method of
    multipliers" (2011), for the bounds; each round takes knees as linear about the path before.
    """
    best, least = np.zeros((len(legs[0].hip), 3)), np.inf
    for weight in _ACCELERATION_WEIGHTS:
        problem = _Problem(legs, paths, rate_hz, upright, weight)
        shift = np.zeros_like(best)
        for _ in range(_NEWTON_STEPS):
            shift = problem.least_squares(shift)
        bounds: list[_Bound] = []
        for n in range(_BOUND_ROUNDS + 1):
            if n > 0:
                bounds = problem.bounds(shift, _INSIDE * knee_limit, bounds)
                shift = problem.bounded(shift, bounds)
            found = problem.lowered(shift)
            worst = problem.knee_peak(found)
            if worst < least:
                best, least = found, worst
            if least <= knee_limit:
                return best
    return best


@dataclass(frozen=True, slots=True, eq=False)
class _Bound:
    """What a path x of the hips has to keep: low <= scale (free + along . x) <= high, or so the second difference of it.

    ``dual`` (T,) is how hard the bound presses; it is changed in place.
    """

    along: Floats
    free: Floats
    scale: float
    second: bool
    low: float
    high: float
    dual: Floats

    def values(self, path: Floats) -> Floats:
        """What is bounded (T,)."""
        inner = self.free + np.einsum("ti,ti->t", self.along, path)
        return self.scale * (_second_difference(inner) if self.second else inner)

    def pull(self, wanted: Floats) -> Floats:
        """Right-hand side (T, 3) of the least squares for wanted values (T,)."""
        free = _second_difference(self.free) if self.second else self.free
        missing = self.scale * (wanted - self.scale * free)
        if self.second:
            missing = _spread_difference(missing)
        return self.along * missing[:, None]


class _Problem:
    """Feet that are given, and hips to be found."""

    def __init__(
        self, legs: Sequence[Leg], paths: Sequence[FootPath], rate_hz: float, upright: bool, acceleration: float
    ) -> None:
        self.legs, self.paths, self.rate_hz, self.upright = legs, paths, rate_hz, upright
        self.acceleration = acceleration * rate_hz**2
        self.frames = len(legs[0].hip)
        self.size = float(legs[0].length[0]) / LEG_M
        # where a knee jumps in the source (a glitch, or a pose of calibration before the motion) no hips can mend it
        self.smooth: list[Floats] = []
        for leg in legs:
            jump = np.abs(_second_difference(knee_angles(leg))) * rate_hz**2
            self.smooth.append(1.0 / (1.0 + (jump / _JUMP) ** 2))
        self.before = [norms(leg.ankle - leg.hip) for leg in legs]
        self.farthest = [np.maximum(_STRAIGHTEST * leg.length, far) for leg, far in zip(legs, self.before, strict=True)]
        both = np.mean([path.shift for path in paths], axis=0)
        level = both * (0.0 if upright else np.array([1.0, 0.0, 1.0]))
        level *= np.maximum(1.0 - _STAY_M * self.size / np.maximum(norms(level), 1e-12), 0.0)[:, None]
        self.wanted = gaussian_filter1d(level, 0.3 * rate_hz, axis=0, mode="nearest")
        self.wanted[:, 1] = gaussian_filter1d(both[:, 1], 0.1 * rate_hz, mode="nearest")

    def least_squares(self, shift: Floats) -> Floats:
        """The best path for knees that are linear about a path."""
        return self._held(self._system(shift).solution())

    def bounds(self, shift: Floats, knee_limit: float, last: Sequence[_Bound]) -> list[_Bound]:
        """What knees and legs have to keep, linear about a path, with the duals of the last bounds."""
        found: list[_Bound] = []
        for leg, path, farthest in zip(self.legs, self.paths, self.farthest, strict=True):
            line = leg.ankle + path.shift - leg.hip - shift
            distance = norms(line)
            along = line / np.maximum(distance, 1e-12)[:, None]
            angle = reached_angles(leg, distance)
            bend = (distance / _rate_under(leg, angle))[:, None] * along
            free = angle - np.einsum("ti,ti->t", bend, shift)
            over = distance + np.einsum("ti,ti->t", along, shift) - farthest
            for row, rest, scale, second, low in (
                (bend, free, self.rate_hz**2 / knee_limit, True, -1.0),
                (-along, over, 1.0 / (_REACH_M * self.size), False, -np.inf),
            ):
                dual = last[len(found)].dual if last else np.zeros(self.frames)
                found.append(_Bound(row, rest, scale, second, low, 1.0 if second else 0.0, dual))
        return found

    def bounded(self, shift: Floats, bounds: Sequence[_Bound]) -> Floats:
        """The best path within bounds, for knees that are linear about a path."""
        system = self._system(shift)
        for bound in bounds:
            system.add_square(bound.along, np.sqrt(_STIFFNESS) * bound.scale, bound.second)
        factor = cholesky_banded(system.band(), overwrite_ab=True, check_finite=False)
        for step in range(_BOUND_STEPS):
            right = system.right.copy()
            for bound in bounds:
                values = bound.values(shift)
                kept = np.clip(values + bound.dual, bound.low, bound.high)
                if step > 0:
                    bound.dual[:] += values - kept
                right += _STIFFNESS * bound.pull(kept - bound.dual)
            shift = cho_solve_banded((factor, False), right.reshape(-1), check_finite=False).reshape(-1, 3)
        return self._held(shift)

    def lowered(self, shift: Floats) -> Floats:
        """A path that goes down where feet are out of reach."""
        need = np.zeros(self.frames)
        for leg, path, farthest in zip(self.legs, self.paths, self.farthest, strict=True):
            far = leg.ankle + path.shift - leg.hip - shift
            height = np.sqrt(np.clip(farthest**2 - far[:, 0] ** 2 - far[:, 2] ** 2, 0.0, None))
            need = np.maximum(need, np.clip(-far[:, 1] - height, 0.0, 0.3 * leg.length))
        if need.max(initial=0.0) <= 1e-9 * self.size:
            return shift
        result = shift.copy()
        result[:, 1] -= smooth_over(need, 0.12 * self.rate_hz)
        return result

    def knee_peak(self, shift: Floats) -> float:
        """The largest angular acceleration of a knee, radians a second squared."""
        worst = 0.0
        for leg, path in zip(self.legs, self.paths, strict=True):
            angles = reached_angles(leg, norms(leg.ankle + path.shift - leg.hip - shift))
            worst = max(worst, float(np.abs(np.diff(angles, 2)).max(initial=0.0)) * self.rate_hz**2)
        return worst

    def _system(self, shift: Floats) -> _System:
        system = _System(self.frames)
        system.add_own(self.wanted, self.upright, self.size, self.acceleration)
        for leg, path, before, smooth in zip(self.legs, self.paths, self.before, self.smooth, strict=True):
            line = leg.ankle + path.shift - leg.hip - shift
            distance = norms(line)
            along = line / np.maximum(distance, 1e-12)[:, None]
            # radians of the knee for a metre
            rate = before / _rate_under(leg, reached_angles(leg, np.minimum(before, distance)))
            change = rate * (distance - before + np.sum(along * shift, axis=-1))
            system.add_knee(rate[:, None] * along, change, smooth * (_KNEE_ACCELERATION_WEIGHT * self.rate_hz**2))
        return system

    def _held(self, shift: Floats) -> Floats:
        return shift * np.array([0.0, 1.0, 0.0]) if self.upright else shift


class _System:
    """Normal equations of a path (T, 3) with second differences in them: a band of 8 beside the diagonal."""

    def __init__(self, frames: int) -> None:
        self.frames = frames
        self.blocks = [np.zeros((frames, 3, 3)) for _ in range(3)]  # between frames t and t, t + 1, t + 2
        self.right = np.zeros((frames, 3))

    def add_own(self, wanted: Floats, upright: bool, size: float, acceleration: float) -> None:
        """How far the path is from a wanted one (T, 3), and the path's second difference."""
        squares = _second_differences(np.full(self.frames, acceleration / size))
        for block, weight in zip(self.blocks, squares, strict=True):
            block += weight[:, None, None] * np.eye(3)
        level = 1e9 if upright else _LEVEL_WEIGHT
        weights = (np.array([level, _PATH_WEIGHT, level]) / size) ** 2
        self.blocks[0] += np.diag(weights)
        self.right += weights * wanted

    def add_knee(self, along: Floats, change: Floats, acceleration: Floats) -> None:
        """``change - along . path`` (T,), and its second difference."""
        weights = _second_differences(acceleration)
        weights[0] += 1.0
        self._add_blocks(along, weights)
        total = weights[0] * change
        for n, weight in enumerate(weights[1:], 1):
            last = self.frames - n
            total[:last] += weight[:last] * change[n:]
            total[n:] += weight[:last] * change[:last]
        self.right += along * total[:, None]

    def add_square(self, along: Floats, weight: float, second: bool) -> None:
        """The left-hand side of ``weight along . path`` (T,), or of its second difference."""
        weights = np.full(self.frames, weight)
        self._add_blocks(along, _second_differences(weights) if second else [weights**2])

    def band(self) -> Floats:
        """The upper form of the equations: band[8 + i - j, j] = A[i, j]."""
        band = np.zeros((9, 3 * self.frames))
        for n, block in enumerate(self.blocks):
            for i in range(3):
                for j in range(3):
                    if n > 0 or j >= i:
                        band[8 + i - (3 * n + j), 3 * n + j :: 3] = block[: self.frames - n, i, j]
        return band

    def solution(self) -> Floats:
        """The path."""
        right = self.right.reshape(-1)
        return solveh_banded(self.band(), right, overwrite_ab=True, check_finite=False).reshape(-1, 3)

    def _add_blocks(self, along: Floats, weights: Sequence[Floats]) -> None:
        for n, weight in enumerate(weights):
            last = self.frames - n
            self.blocks[n][:last] += weight[:last, None, None] * along[:last, :, None] * along[n:, None, :]


def _rate_under(leg: Leg, angle: Floats) -> Floats:
    """What the distance of hip and ankle is divided by for the radians that a knee turns for a metre, square metres."""
    sine = np.maximum(np.sin(angle), _LEAST_BENT)
    return np.maximum(norms(leg.knee - leg.hip) * norms(leg.ankle - leg.knee) * sine, 1e-12)


def _second_difference(values: Floats) -> Floats:
    """(T,), 0 at both ends."""
    result = np.zeros(len(values))
    result[1:-1] = np.diff(values, 2)
    return result


def _spread_difference(values: Floats) -> Floats:
    """The transpose of `_second_difference`."""
    result = np.zeros(len(values))
    inner = values[1:-1]
    result[:-2] += inner
    result[1:-1] -= 2.0 * inner
    result[2:] += inner
    return result


def _second_differences(weight: Floats) -> list[Floats]:
    """Diagonals of the square of weighted (T,) second differences: of t with t, t + 1, t + 2, (T,) each."""
    frames = len(weight)
    found: list[Floats] = [np.zeros(frames) for _ in range(3)]
    if frames > 2:
        square = weight[1:-1] ** 2
        for n, count in ((0, 1.0), (1, 4.0), (2, 1.0)):
            found[0][n : frames - 2 + n] += count * square
        for n in (0, 1):
            found[1][n : frames - 2 + n] -= 2.0 * square
        found[2][: frames - 2] += square
    return found
