"""Legs that reach their planted feet: hips that come along where knees would have to jump, then knees and hips turned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded
from scipy.ndimage import gaussian_filter1d

from keypose.arrays import Floats
from keypose.editing.planting_paths import FootPath, norms, smooth_over
from keypose.evaluate import world_rotations_positions
from keypose.math import quat
from keypose.model import Skeleton

# What counts as much as a radian that a knee changes: the hips' path by the metre and its acceleration by the metre a second
# squared, and the acceleration of a knee by the radian a second squared.
_PATH_WEIGHT = 20.0
_LEVEL_WEIGHT = 100.0  # for the part along the ground
_ACCELERATION_WEIGHT = 0.003
_KNEE_ACCELERATION_WEIGHT = 0.006
_LEAST_BENT = 0.06  # a knee is taken as bent at least so far, radians
_JUMP = 1000.0  # an angular acceleration of a knee that no knee has, radians a second squared
_NEWTON_STEPS = 4
_STRAIGHTEST = 0.997  # share of a leg's length that planting may ask for


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """One leg of a motion.

    Shapes and units: joints ``upper``, ``lower``, ``foot``; places (T, 3) of ``hip``, ``knee``, ``ankle`` in metres; ``bend`` (T, 3)
    unit, across the leg, the way the knee goes.
    """

    upper: int
    lower: int
    foot: int
    hip: Floats
    knee: Floats
    ankle: Floats
    bend: Floats

    @property
    def length(self) -> Floats:
        """Of both bones together (T,)."""
        return norms(self.knee - self.hip) + norms(self.ankle - self.knee)


def find_leg(side: str, roles: Mapping[str, int], skeleton: Skeleton, turned: Floats, places: Floats) -> Leg:
    """The leg of a side: ``turned`` (T, J, 4) and ``places`` (T, J, 3) in the model."""
    upper, lower, foot = (roles[f"{side}_{part}"] for part in ("upper_leg", "lower_leg", "foot"))
    hip, knee, ankle = places[:, upper], places[:, lower], places[:, foot]
    pole = _pole(hip, knee, ankle, turned[:, upper], _forward(skeleton, upper, lower, foot))
    line = ankle - hip
    along = line / np.maximum(norms(line), 1e-12)[:, None]
    pole = pole - along * np.sum(pole * along, axis=-1, keepdims=True)
    return Leg(upper, lower, foot, hip, knee, ankle, pole / np.maximum(norms(pole), 1e-12)[:, None])


def knee_angles(leg: Leg) -> Floats:
    """How far the knee is bent in every frame (T,), radians."""
    thigh, shank = leg.knee - leg.hip, leg.ankle - leg.knee
    return np.arctan2(norms(np.cross(thigh, shank)), np.sum(thigh * shank, axis=-1))


def reached_angles(leg: Leg, distance: Floats) -> Floats:
    """How far the knee is bent (T,) where the ankle is so far from the hip."""
    a, b = norms(leg.knee - leg.hip), norms(leg.ankle - leg.knee)
    return np.arccos(np.clip((distance**2 - a * a - b * b) / np.maximum(2.0 * a * b, 1e-12), -1.0, 1.0))


def hips_path(
    legs: Sequence[Leg], paths: Sequence[FootPath], rate_hz: float, upright: bool, care: Floats | None = None
) -> Floats:
    """How the hips are moved (T, 3) so that knees bend as they did where they can.

    A leg that is nearly straight cannot become longer, and its knee turns fast for little; the jitter of a captured body would
    go into the knees of feet that stand still: there the hips go along. The path is the least-squares answer for what both
    knees change, in angle and in acceleration, for how far the hips are from the middle of the feet's own corrections, and for
    their acceleration, in a few Newton steps; what is out of reach then brings the hips down. ``upright``: they only go up and down. ``care`` (T,) multiplies what knees weigh.
    """
    frames = len(legs[0].hip)
    shift = np.zeros((frames, 3))
    care = np.ones(frames) if care is None else np.sqrt(care)
    smooth: dict[int, Floats] = {}
    for leg in legs:
        # where a knee jumps in the source (a glitch, or a pose of calibration before the motion) no hips can mend it
        jump = np.zeros(frames)
        jump[1:-1] = np.abs(np.diff(knee_angles(leg), 2)) * rate_hz**2
        smooth[leg.lower] = 1.0 / (1.0 + (jump / _JUMP) ** 2)
    both = np.mean([path.shift for path in paths], axis=0)
    along_with = gaussian_filter1d(both, 0.1 * rate_hz, axis=0, mode="nearest") * np.array([0.0, 1.0, 0.0])
    for _ in range(_NEWTON_STEPS):
        system = _System(frames)
        system.add_own(along_with, upright, _ACCELERATION_WEIGHT * rate_hz**2)
        for leg, path in zip(legs, paths, strict=True):
            line = leg.ankle + path.shift - leg.hip - shift
            distance = norms(line)
            along = line / np.maximum(distance, 1e-12)[:, None]
            before = norms(leg.ankle - leg.hip)
            a, b = norms(leg.knee - leg.hip), norms(leg.ankle - leg.knee)
            bent = np.maximum(np.sin(reached_angles(leg, np.minimum(before, distance))), _LEAST_BENT)
            rate = care * before / np.maximum(a * b * bent, 1e-12)  # radians of the knee for a metre
            change = rate * (distance - before + np.sum(along * shift, axis=-1))
            system.add_knee(rate[:, None] * along, change, smooth[leg.lower] * (_KNEE_ACCELERATION_WEIGHT * rate_hz**2))
        shift = system.solution()
        if upright:
            shift[:, [0, 2]] = 0.0
    need = np.zeros(frames)
    for leg, path in zip(legs, paths, strict=True):
        far = leg.ankle + path.shift - leg.hip - shift
        limit = np.maximum(_STRAIGHTEST * leg.length, norms(leg.ankle - leg.hip))
        height = np.sqrt(np.clip(limit**2 - far[:, 0] ** 2 - far[:, 2] ** 2, 0.0, None))
        need = np.maximum(need, np.clip(-far[:, 1] - height, 0.0, 0.3 * leg.length))
    if need.max(initial=0.0) > 1e-9:
        shift[:, 1] -= smooth_over(need, 0.12 * rate_hz)
    return shift


class _System:
    """Normal equations of a path (T, 3) with second differences in them: a band of 8 beside the diagonal."""

    def __init__(self, frames: int) -> None:
        self.frames = frames
        self.blocks = [np.zeros((frames, 3, 3)) for _ in range(3)]  # between frames t and t, t + 1, t + 2
        self.right = np.zeros((frames, 3))

    def add_own(self, wanted: Floats, upright: bool, acceleration: float) -> None:
        """How far the path is from a wanted one (T, 3), and the path's second difference."""
        for block, weight in zip(self.blocks, _second_differences(np.full(self.frames, acceleration)), strict=True):
            block += weight[:, None, None] * np.eye(3)
        level = 1e9 if upright else _LEVEL_WEIGHT
        weights = np.array([level, _PATH_WEIGHT, level]) ** 2
        self.blocks[0] += np.diag(weights)
        self.right += weights * wanted

    def add_knee(self, along: Floats, change: Floats, acceleration: Floats) -> None:
        """``change - along . path`` (T,), and its second difference."""
        weights = _second_differences(acceleration)
        weights[0] += 1.0
        total = weights[0] * change
        for n, (block, weight) in enumerate(zip(self.blocks, weights, strict=True)):
            last = self.frames - n
            block[:last] += weight[:last, None, None] * along[:last, :, None] * along[n:, None, :]
            if n > 0:
                total[:last] += weight[:last] * change[n:]
                total[n:] += weight[:last] * change[:last]
        self.right += along * total[:, None]

    def solution(self) -> Floats:
        """The path."""
        band = np.zeros((9, 3 * self.frames))  # upper form: band[8 + i - j, j] = A[i, j]
        for n, block in enumerate(self.blocks):
            for i in range(3):
                for j in range(3):
                    if n > 0 or j >= i:
                        band[8 + i - (3 * n + j), 3 * n + j :: 3] = block[: self.frames - n, i, j]
        return solveh_banded(band, self.right.reshape(-1), overwrite_ab=True, check_finite=False).reshape(-1, 3)


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


def bend_leg(
    leg: Leg, skeleton: Skeleton, turned: Floats, hips: Floats, path: FootPath, rotations: Floats, carries: bool
) -> Floats:
    """Turn a leg's joints (in ``rotations`` (T, J, 4), changed in place) so that its foot follows its path; the distance left (T,).

    The knee turns about its hinge until the ankle is as far from the hip as wanted, then the whole leg swings over. What needs
    no change is not changed. ``carries``: the foot's joint hangs on the leg and turns with it.
    """
    thigh, shank = leg.knee - leg.hip, leg.ankle - leg.knee
    line = leg.ankle - leg.hip
    wanted = leg.ankle + path.shift - leg.hip - hips
    along = line / np.maximum(norms(line), 1e-12)[:, None]
    hinge = np.cross(leg.bend, along)  # turning about it bends the knee
    hinge /= np.maximum(norms(hinge), 1e-12)[:, None]
    a, b = norms(thigh), norms(shank)
    reach = np.clip(norms(wanted), np.abs(a - b), a + b)
    # thigh . turned shank = across + size cos(angle - start), as the part along the hinge does not turn
    across = np.sum(thigh * hinge, axis=-1) * np.sum(shank * hinge, axis=-1)
    cosine = np.sum(thigh * shank, axis=-1) - across
    sine = np.sum(thigh * np.cross(hinge, shank), axis=-1)
    start = np.arctan2(sine, cosine)
    size = np.maximum(np.hypot(cosine, sine), 1e-12)
    angle = start + np.arccos(np.clip(((reach**2 - a * a - b * b) / 2.0 - across) / size, -1.0, 1.0))
    bend = quat.from_axis_angle(hinge, angle)
    reached = thigh + quat.rotate(bend, shank)
    swing = quat.from_two_vectors(reached, wanted)
    whole = quat.multiply(swing, bend)
    parents = skeleton.parents
    above = int(parents[leg.upper])
    new_upper = quat.multiply(swing, turned[:, leg.upper])
    rotations[:, leg.upper] = new_upper if above < 0 else quat.multiply(quat.conjugate(turned[:, above]), new_upper)
    over_knee = quat.multiply(swing, turned[:, int(parents[leg.lower])])
    rotations[:, leg.lower] = quat.multiply(quat.conjugate(over_knee), quat.multiply(whole, turned[:, leg.lower]))
    over_foot = turned[:, int(parents[leg.foot])]
    if carries:
        over_foot = quat.multiply(whole, over_foot)
    rotations[:, leg.foot] = quat.multiply(quat.conjugate(over_foot), quat.multiply(path.turn, turned[:, leg.foot]))
    return norms(wanted - quat.rotate(swing, reached))


def _forward(skeleton: Skeleton, upper: int, lower: int, foot: int) -> Floats:
    """Where the knee bends, in the upper joint's axes: across the leg at rest, forwards."""
    turned, places = (np.asarray(a, np.float64) for a in world_rotations_positions(skeleton, skeleton.rest))
    line = places[foot] - places[upper]
    along = line / max(float(np.linalg.norm(line)), 1e-12)
    bend = places[lower] - places[upper]
    bend = bend - along * float(bend @ along)
    if float(np.linalg.norm(bend)) < 1e-3 * float(np.linalg.norm(line)):
        bend = np.array([0.0, 0.0, 1.0]) - along * float(along[2])
    return quat.rotate(quat.conjugate(turned[upper]), bend / max(float(np.linalg.norm(bend)), 1e-12))


def _pole(hip: Floats, knee: Floats, ankle: Floats, turned: Floats, forward: Floats) -> Floats:
    """Where the knee is, across the leg; a leg that is nearly straight takes the way it bends at rest (T, 3)."""
    line = ankle - hip
    along = line / np.maximum(norms(line), 1e-12)[:, None]
    out = (knee - hip) - along * np.sum((knee - hip) * along, axis=-1, keepdims=True)
    bent = norms(out)[:, None]
    limit = 0.03 * norms(knee - hip)[:, None]
    share = np.clip(1.0 - bent / limit, 0.0, 1.0)
    return out + share * limit * quat.rotate(turned, np.broadcast_to(forward, hip.shape))
