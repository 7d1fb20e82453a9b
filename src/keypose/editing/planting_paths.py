"""Where feet go when they are planted: corrections of ankles and of the feet's orientations, from contacts."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from keypose.analysis.contacts import Footing
from keypose.analysis.ground import true_runs
from keypose.arrays import Floats
from keypose.math import quat

HELD_M = 1e-5
"""A point that stays within this through a contact is held already, for a leg of 0.85 m."""

_HELD_RAD = 5e-5
_RAISED_RAD = 0.1  # a foot that is pitched more stands on its ball, heel up
_LEAST_SHARE = 0.02  # of a lift beside a contact
_LEVEL_RAD = 0.005  # a foot this near to flat is flat


@dataclass(frozen=True, slots=True, eq=False)
class FootPath:
    """What is to be added to a foot.

    Shapes and units: ``shift`` (T, 3) metres to its ankle; ``turn`` (T, 4) from the left to its rotation; ``held`` (T,) frames in
    which it stands on the ground.
    """

    shift: Floats
    turn: Floats
    held: np.ndarray

    @property
    def moves(self) -> bool:
        """Whether it changes anything."""
        return bool(np.any(self.shift)) or bool(np.any(self.turn[:, 1:]))


def foot_path(
    side: str,
    footing: Footing,
    ankle: Floats,
    turned: Floats,
    ball: Floats | None,
    size: float,
    blend_s: float,
    level: bool,
    sink_m: float,
) -> FootPath:
    """The correction of one foot: ``ankle`` and ``ball`` (T, 3) places, ``turned`` (T, 4) the foot's rotation in the model.

    A foot in the air that goes under the ground by no more than ``sink_m`` is left.
    """
    none = np.zeros(len(ankle), bool)
    heels = footing.touching.get(f"{side}_heel", none)
    balls = footing.touching.get(f"{side}_ball", none) if ball is not None else none
    flats = true_runs(heels & balls if ball is not None else heels)
    blend = max(2.0, blend_s * footing.rate_hz)
    turn = _turns(side, footing, flats, turned, ankle, ball, blend, level)
    offsets = {"ball": np.zeros_like(ankle), "heel": np.zeros_like(ankle)}
    if ball is not None:
        if level and footing.ground.kind == "flat":
            flat = heels & balls
            turn = _without_sunk_heels(turn, ball - ankle, footing.soles[side].flat, balls & ~heels, bool(flat.any()))
        offsets["ball"] = quat.rotate(turn, ball - ankle)
        offsets["heel"] = footing.soles[side].heel_offsets(offsets["ball"])
    runs = true_runs(heels | balls)
    shift = np.zeros_like(ankle)
    for start, stop in runs:
        shift[start:stop] = _held(side, footing, start, stop, balls, ankle, offsets, size)
    shift = bridged(shift, runs, blend)
    shift[:, 1] += _lifts(side, footing, runs, ankle + shift, offsets, sink_m)
    return FootPath(shift, turn, heels | balls)


def _turns(
    side: str,
    footing: Footing,
    flats: list[tuple[int, int]],
    turned: Floats,
    ankle: Floats,
    ball: Floats | None,
    blend: float,
    level: bool,
) -> Floats:
    """Turns (T, 4) after which a foot that is flat on the ground does not turn, and lies as the ground does."""
    vectors = np.zeros((len(turned), 3))
    for start, stop in flats:
        own = quat.align_signs(turned[start:stop], axis=0)
        stands = quat.normalize(own.mean(axis=0))
        if ball is not None and level:
            line = ball[start:stop] - ankle[start:stop]
            middle = quat.rotate(quat.multiply(stands, quat.conjugate(own)), line).mean(axis=0)
            stands = quat.multiply(_levelling(side, footing, middle, ankle[start:stop].mean(axis=0)), stands)
        own = quat.to_rotation_vector(
            quat.shortest(quat.multiply(np.broadcast_to(stands, own.shape), quat.conjugate(own)))
        )
        if np.abs(own).max() > _HELD_RAD:
            vectors[start:stop] = own
    return quat.from_rotation_vector(bridged(vectors, flats, blend))


def _without_sunk_heels(turn: Floats, ball_from_ankle: Floats, flat: float, rolls: np.ndarray, known: bool) -> Floats:
    """The turns, and heels no lower than where the foot is flat in frames in which it stands on the ball."""
    line = quat.rotate(turn, ball_from_ankle)
    level = np.hypot(line[:, 0], line[:, 2])
    under = np.where(rolls & known, np.arctan2(line[:, 1], level) - flat, 0.0)
    under = np.where((under > _HELD_RAD) & (level > 0.1 * norms(line)), under, 0.0)
    if not under.any():
        return turn
    across = np.stack([-line[:, 2], np.zeros(len(line)), line[:, 0]], axis=-1) / np.maximum(level, 1e-9)[:, None]
    return quat.multiply(quat.from_axis_angle(across, -under), turn)


def _levelling(side: str, footing: Footing, ball_from_ankle: Floats, ankle: Floats) -> Floats:
    """The turn that lays a foot on the ground: nothing where it lies so already."""
    level = float(np.hypot(ball_from_ankle[0], ball_from_ankle[2]))
    length = float(np.linalg.norm(ball_from_ankle))
    if level < 0.1 * length:
        return np.array([1.0, 0.0, 0.0, 0.0])
    now = float(np.arctan2(ball_from_ankle[1], level))
    wanted = footing.soles[side].flat
    if footing.ground.kind != "flat":
        # under heel and ball: what the ground rises between them, on top of what the foot's own build rises
        ball = ankle + ball_from_ankle
        under = footing.ground.heights(np.stack([ankle, ball]))
        wanted = footing.soles[side].flat - footing.lean[side] + float(np.arctan2(under[1] - under[0], level))
    # a heel that is held up on purpose stays up
    if abs(wanted - now) < _LEVEL_RAD or footing.soles[side].flat - now > _RAISED_RAD:
        return np.array([1.0, 0.0, 0.0, 0.0])
    across = np.array([-ball_from_ankle[2], 0.0, ball_from_ankle[0]]) / level
    return quat.from_axis_angle(across, np.array(wanted - now))


def _held(
    side: str,
    footing: Footing,
    start: int,
    stop: int,
    balls: np.ndarray,
    ankle: Floats,
    offsets: Mapping[str, Floats],
    size: float,
) -> Floats:
    """The ankle's correction through one contact, so that what carries does not move: the ball while it is down, else the heel."""
    carried = balls[start:stop]
    edges = [0, *(np.flatnonzero(np.diff(carried.astype(np.int8))) + 1).tolist(), stop - start]
    path = np.empty((stop - start, 3))
    parts = list(itertools.pairwise(edges))
    anchors: list[Floats] = []
    for a, b in parts:
        offset = offsets["ball" if carried[a] else "heel"][start:stop]
        # where the next point is now, with the correction that the foot has now, it stays
        before = path[a - 1] + offset[a] if a > 0 else ankle[start] + offset[0]
        if a > 0:
            last = offsets["ball" if carried[a - 1] else "heel"][start:stop]
            before = anchors[-1] - last[a] + offset[a]
        anchors.append(before)
        path[a:b] = before - offset[a:b]
    shift = path - ankle[start:stop]
    shift -= shift.mean(axis=0)
    # Its longest part with the ball down (if there is one) lies on the ground.
    longest = max(range(len(parts)), key=lambda k: (carried[parts[k][0]], parts[k][1] - parts[k][0]))
    a = parts[longest][0]
    point = ankle[start + a] + shift[a] + offsets["ball" if carried[a] else "heel"][start + a]
    wanted = float(footing.ground.heights(point)) + footing.stand_m[side]
    shift[:, 1] += wanted - point[1]
    return np.zeros_like(shift) if np.abs(shift).max() < HELD_M * size else shift


def bridged(values: Floats, runs: list[tuple[int, int]], blend: float) -> Floats:
    """Values (T, 3) given in runs, and in between: smoothly from one to the next, with the speed that they have at both.

    The speeds fade within ``blend`` frames. Before the first run and after the last the values stay, once they have come to
    rest.
    """
    result = values.copy()
    if not runs:
        return result

    def slope(frame: int, other: int) -> Floats:
        return (values[frame] - values[other]) * np.sign(frame - other) if frame != other else np.zeros(3)

    for (before, start), (stop, after) in itertools.pairwise(runs):
        gap = stop - (start - 1)
        last = start - 1
        n = np.arange(1, gap)[:, None]
        u = n / gap
        result[start:stop] = values[last] + (values[stop] - values[last]) * (
            u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
        )
        reach = min(blend, gap)
        result[start:stop] += slope(last, max(last - 1, before)) * _fading(n, reach)
        result[start:stop] -= slope(min(stop + 1, after - 1), stop) * _fading(gap - n, reach)
    first, (_, start) = runs[0][0], runs[0]
    if first > 0:
        n = np.arange(first, 0, -1)[:, None]
        result[:first] = values[first] - slope(min(first + 1, start - 1), first) * _fading(n, min(blend, first + 1))
    (before, start), count = runs[-1], len(values)
    if start < count:
        n = np.arange(1, count - start + 1)[:, None]
        last = start - 1
        result[start:] = values[last] + slope(last, max(last - 1, before)) * _fading(n, min(blend, count - start + 1))
    return result


def norms(vectors: Floats) -> Floats:
    """Lengths (*B,) of vectors (*B, 3)."""
    return np.sqrt(np.einsum("...i,...i", vectors, vectors))


def _fading(n: Floats | np.ndarray, reach: float) -> Floats:
    """A path that sets out with speed 1 and is back at nothing, at rest, after ``reach``."""
    u = np.clip(n / reach, 0.0, 1.0)
    return reach * u * (1.0 - u) ** 3 * (1.0 + 3.0 * u)


def _lifts(
    side: str,
    footing: Footing,
    runs: list[tuple[int, int]],
    ankle: Floats,
    offsets: Mapping[str, Floats],
    sink_m: float,
) -> Floats:
    """How far (T,) a foot in the air has to be lifted so that it does not go through the ground."""
    lift = np.zeros(len(ankle))
    need = np.zeros(len(ankle))
    for offset in offsets.values():
        point = ankle + offset
        need = np.maximum(need, footing.ground.heights(point) + footing.stand_m[side] - point[:, 1])
    edges = [0, *itertools.chain.from_iterable(runs), len(ankle)]
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if stop - start < 3:
            continue
        width = min(0.08 * footing.rate_hz, 0.5 * (stop - start))
        n = np.arange(stop - start)
        share = np.ones(stop - start)
        for here, near in ((start > 0, n + 1.0), (stop < len(ankle), (stop - start) - n)):
            if here:
                u = np.clip(near / width, 0.0, 1.0)
                share *= u * u * (3.0 - 2.0 * u)
        # Right beside a contact not much can be lifted without a jerk.
        over = np.maximum(need[start:stop] - 0.5 * sink_m, 0.0) / np.maximum(share, 1e-3)
        over[share < _LEAST_SHARE] = 0.0
        if np.max(share * over, initial=0.0) > 0.5 * sink_m:
            lift[start:stop] = share * smooth_over(over, width)
    return lift


def smooth_over(need: Floats, frames: float) -> Floats:
    """A smooth curve (T,) that is never under ``need``."""
    half = max(1, round(frames))
    widest = maximum_filter1d(need, 2 * half + 1, mode="nearest")
    # A mean over no more than the width of the maximum cannot fall under what the maximum covers.
    return uniform_filter1d(uniform_filter1d(widest, half | 1, mode="nearest"), half | 1, mode="nearest")
