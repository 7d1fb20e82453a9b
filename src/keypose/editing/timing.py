"""Speed along curves: its jumps at keys, lengths, and time warps that make it constant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from keypose.arrays import Array
from keypose.editing.spans import rates
from keypose.errors import ShapeError
from keypose.evaluate import sample_curve
from keypose.math import quat, spline
from keypose.model import Curve, CurveKind, Interpolation

# A span is measured in so many pieces.
_PIECES = 128


@dataclass(frozen=True, slots=True, eq=False)
class ConstantSpeed:
    """A time warp and how far from constant speed it leaves the curve.

    ``warp`` is a scalar curve from time to the curve's own time. ``error`` is the largest distance from where constant speed
    would be, as a share of the whole length; ``length`` is that of the curve in its units (radians for rotations).
    """

    warp: Curve
    length: float
    error: float


def velocity_jumps(curve: Curve) -> Array:
    """The change of velocity at each key (K,): degrees per second for rotations, else units per second; 0 at the ends.

    Of rotations it is the length of the difference of the two angular velocities. Beside a step the velocity is 0.
    """
    leaving, coming = rates(curve)
    jump = np.linalg.norm(leaving - coming, axis=-1)
    jump[[0, -1]] = 0.0
    return np.degrees(2.0 * jump) if curve.kind is CurveKind.ROTATION else jump


def arc_lengths(curve: Curve, pieces: int = _PIECES) -> tuple[Array, Array]:
    """Times (N,) and the length (N,) of the curve up to each, in its own units; radians turned for rotations.

    Every span is measured in ``pieces`` chords and half as many; what halving changed says what is still missing
    (Richardson), so that the error falls with the fourth power of their length.
    Raises: ShapeError where ``pieces`` is not even and positive.
    """
    if pieces < 2 or pieces % 2:
        raise ShapeError(f"pieces: expected an even number of 2 or more, got {pieces}")
    times = curve.times_s
    if len(times) == 1:
        return np.array(times), np.zeros(1)
    u = np.arange(pieces) / pieces
    at = np.append((times[:-1, None] + np.diff(times)[:, None] * u).ravel(), times[-1])
    values = sample_curve(curve, at).astype(np.float64)

    def lengths(step: int) -> Array:
        a, b = values[:-step:step], values[step::step]
        return quat.angle_between(a, b) if curve.kind is CurveKind.ROTATION else np.linalg.norm(b - a, axis=-1)

    fine, coarse = lengths(1).reshape(-1, 2).sum(axis=-1), lengths(2)
    pairs = fine + (fine - coarse) / 3.0
    return at[::2], np.append(0.0, np.cumsum(np.maximum(pairs, 0.0)))


def constant_speed(curve: Curve, tolerance: float = 1e-3) -> ConstantSpeed:
    """The time warp with which a curve is gone through at one speed, from its first key to its last in the same time.

    For the ``time_warp`` of a placement, or `retimed`. Keys are added until no place is off by more than ``tolerance`` of the
    whole length (or the table's own resolution is reached); a curve that does not move keeps its time.

    Raises: ShapeError where ``tolerance`` is not between 0 and 1.
    """
    if not 0 < tolerance < 1:
        raise ShapeError(f"tolerance: expected a share between 0 and 1, got {tolerance}")
    at, along = arc_lengths(curve)
    start, end, length = float(at[0]), float(at[-1]), float(along[-1])
    if length <= 0 or len(curve.times_s) == 1:
        ends = np.array([start, end if end > start else start + 1.0])
        return ConstantSpeed(Curve(ends, ends[:, None], kind=CurveKind.SCALAR), length, 0.0)
    share = along / length
    moving = np.concatenate([[True], np.diff(share) > 1e-12])
    share_m, at_m = share[moving], at[moving]
    at_m[-1] = end
    # The speed may change at once at the curve's own keys, and the warp bends there.
    keys = np.unique(np.concatenate([[0.0, 1.0], np.interp(curve.times_s, at, share)]))
    keys = keys[np.concatenate([[True], np.diff(keys) > 1e-9])]
    keys[-1] = 1.0
    error = np.inf
    for _ in range(14):
        values = np.interp(keys, share_m, at_m)
        # Where is each place of the table when time goes by the warp?
        u = np.linspace(0, 1, 18)[1:-1]
        places = keys[:-1, None] + np.diff(keys)[:, None] * u
        reached = np.interp(values[:-1, None] + np.diff(values)[:, None] * u, at, share)
        off = np.abs(reached - places).max(axis=1)
        error = float(off.max())
        if error <= tolerance or len(keys) > 4 * len(at):
            break
        split = off > tolerance
        keys = np.sort(np.concatenate([keys, 0.5 * (keys[:-1] + keys[1:])[split]]))
    values = np.interp(keys, share_m, at_m)
    warp = Curve(start + (end - start) * keys, values[:, None], kind=CurveKind.SCALAR)
    return ConstantSpeed(warp, length, error)


def retimed(curve: Curve, warp: Curve, tolerance: float = 1e-3) -> tuple[Curve, float]:
    """The curve as it runs when time goes by a warp, with straight spans (slerp), and its largest error in its own units.

    It has a key where the warp has one and where it reaches a key of the curve, and more until the error at the middle of all
    spans is within ``tolerance`` (radians for rotations).

    Raises: ShapeError where the warp is not a scalar curve or ``tolerance`` is not positive.
    """
    if warp.kind is not CurveKind.SCALAR:
        raise ShapeError(f"warp: expected a SCALAR curve, got {warp.kind.name}")
    if tolerance <= 0:
        raise ShapeError(f"tolerance: expected more than 0, got {tolerance}")
    fine = np.unique(np.concatenate([warp.times_s, np.linspace(warp.times_s[0], warp.times_s[-1], 1024)]))
    inner = sample_curve(warp, fine)[:, 0]
    crossed: list[float] = []
    for key in curve.times_s:
        side = np.signbit(inner - key)
        k = np.nonzero(side[1:] != side[:-1])[0]
        crossed += list(fine[k] + (fine[k + 1] - fine[k]) * (key - inner[k]) / (inner[k + 1] - inner[k]))
    at = np.unique(np.concatenate([warp.times_s, crossed]))
    at = at[np.concatenate([[True], np.diff(at) > 1e-7])]
    error = 0.0
    for _ in range(14):
        values = sample_curve(curve, sample_curve(warp, at)[:, 0]).astype(np.float64)
        middle = 0.5 * (at[:-1] + at[1:])
        wanted = sample_curve(curve, sample_curve(warp, middle)[:, 0]).astype(np.float64)
        if curve.kind is CurveKind.ROTATION:
            off = quat.angle_between(quat.slerp(values[:-1], values[1:], 0.5), wanted)
        else:
            off = np.linalg.norm(spline.lerp(values[:-1], values[1:], 0.5) - wanted, axis=-1)
        error = float(off.max(initial=0.0))
        if error <= tolerance:
            break
        at = np.sort(np.concatenate([at, middle[off > tolerance]]))
    mode = Interpolation.STEP if curve.kind is CurveKind.BOOLEAN else Interpolation.LINEAR
    precision = np.asarray(curve.values).dtype
    values = sample_curve(curve, sample_curve(warp, at)[:, 0])
    if curve.kind is CurveKind.ROTATION:
        values = quat.align_signs(values)
    blank = replace(
        curve,
        times_s=at,
        values=np.asarray(values, precision),
        modes=mode,
        in_tangents=None,
        out_tangents=None,
        in_handles=None,
        out_handles=None,
        tangent_types=None,
    )
    return blank, error
