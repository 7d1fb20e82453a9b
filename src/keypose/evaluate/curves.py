"""Curves at any times.

Semantics are glTF's: STEP holds, LINEAR is a straight line (slerp the short way for rotations), HERMITE is CUBICSPLINE
(tangents in units per second, scaled by the span; rotations are normalised afterwards). BEZIER solves each component's
time curve for the asked time. Rotations alone have SQUAD, SPHERICAL_BEZIER and LOG_CUBIC. At the time of a key the value is
the key's own, bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from keypose.arrays import Array, gather, namespace, unified
from keypose.errors import ShapeError
from keypose.math import quat, rotation_splines, spline
from keypose.model import Curve, CurveKind, Extrapolation, Interpolation


def sample_curve(curve: Curve, times_s: Any) -> Array:
    """The curve's values at times of any shape.

    Shapes and units: ``times_s`` (*B,) seconds; returns (*B, C) in the precision of ``curve.values``. Gradients flow to
    values, tangents and handles, not to times. Before the first and after the last key, ``curve.before`` and ``curve.after``
    decide; a curve of one key is constant.

    Raises:
        ShapeError: where a time is not finite.

    Source: glTF 2.0 specification, appendix C; lecture notes, "Keyframing" (linear and Hermite interpolation).
    """
    return sample_group([curve], finite_times(times_s))[..., 0, :]


def finite_times(times_s: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Times in double precision; raises `ShapeError` where one is not finite."""
    times = np.asarray(times_s, np.float64)
    if not np.all(np.isfinite(times)):
        raise ShapeError("times_s: expected finite numbers")
    return times


@dataclass(frozen=True, slots=True)
class _Location:
    """Where times fall on a curve: times brought into its range, spans, and what extrapolation has to add."""

    span: np.ndarray[Any, np.dtype[np.intp]]  # index of the key that starts the span
    following: np.ndarray[Any, np.dtype[np.intp]]
    span_s: np.ndarray[Any, np.dtype[np.float64]]
    share: np.ndarray[Any, np.dtype[np.float64]]  # u in [0, 1)
    cycles: np.ndarray[Any, np.dtype[np.float64]] | None  # whole cycles to add, for CYCLE_OFFSET
    before_s: np.ndarray[Any, np.dtype[np.float64]] | None  # time before the first key (<= 0), for LINEAR
    after_s: np.ndarray[Any, np.dtype[np.float64]] | None  # time after the last key (>= 0), for LINEAR


def _locate(curve: Curve, times: Array) -> _Location:
    keys, before, after = curve.times_s, curve.before, curve.after
    start, end = keys[0], keys[-1]
    early, late = times < start, times > end
    cycles = before_s = after_s = None
    inside = np.clip(times, start, end)
    if len(keys) > 1 and (np.any(early) or np.any(late)):
        for outside, rule in ((early, before), (late, after)):
            if rule is Extrapolation.LINEAR:
                if outside is early:
                    before_s = np.where(early, times - start, 0.0)
                else:
                    after_s = np.where(late, times - end, 0.0)
            elif rule is Extrapolation.PING_PONG:
                phase = np.mod(times - start, 2 * (end - start))
                inside = np.where(outside, start + np.minimum(phase, 2 * (end - start) - phase), inside)
            elif rule in (Extrapolation.CYCLE, Extrapolation.CYCLE_OFFSET):
                # divmod, so that whole cycles and the rest agree to the last bit.
                whole, rest = np.divmod(times - start, end - start)
                inside = np.where(outside, start + rest, inside)
                # What is on or off comes back as it was.
                if rule is Extrapolation.CYCLE_OFFSET and curve.kind is not CurveKind.BOOLEAN:
                    whole = np.where(outside, whole, 0.0)
                    cycles = whole if cycles is None else cycles + whole
    inside = np.clip(inside, start, end)
    span = np.clip(np.searchsorted(keys, inside, side="right") - 1, 0, len(keys) - 1)
    following = np.minimum(span + 1, len(keys) - 1)
    span_s = keys[following] - keys[span]
    share = (inside - keys[span]) / np.where(span_s > 0, span_s, 1.0)
    return _Location(span, following, span_s, share, cycles, before_s, after_s)


def sample_group(curves: Sequence[Curve], times: Array) -> Array:
    """Curves that share key times, modes and kind, evaluated together: (*B, G, C)."""
    first = curves[0]
    place = _locate(first, times)
    values = [c.values for c in curves]
    xp = namespace(*values)
    is_rotation = first.kind is CurveKind.ROTATION
    at, to = _rows(xp, values, place.span), _rows(xp, values, place.following)
    modes = first.modes[place.span]
    present = {int(m) for m in np.unique(modes[place.share != 0])}
    share, span_s = column(xp, place.share, at), column(xp, place.span_s, at)
    result = at
    for mode in sorted(present - {Interpolation.STEP}):
        if mode == Interpolation.LINEAR:
            moved = quat.slerp(at, to, share) if is_rotation else spline.lerp(at, to, share)
        elif mode == Interpolation.HERMITE:
            outgoing = _sides(xp, [c.out_tangents for c in curves], place.span, at)
            incoming = _sides(xp, [c.in_tangents for c in curves], place.following, at)
            moved = spline.hermite(at, outgoing, to, incoming, share, span_s)
            moved = quat.normalize(moved) if is_rotation else moved
        elif mode == Interpolation.BEZIER:
            outgoing = _sides(xp, [c.out_handles for c in curves], place.span, at)
            incoming = _sides(xp, [c.in_handles for c in curves], place.following, at)
            # Shares in double precision: near an upright handle little time is much of the curve.
            s = place.share[..., None] if isinstance(at, np.ndarray) else share
            moved = spline.weighted_bezier(at, outgoing, to, incoming, s, span_s)
        else:
            moved = _on_the_sphere(Interpolation(mode), values, first.times_s, place, at, share, modes == mode)
        result = choose(xp, modes == mode, moved, result)
    result = choose(xp, place.share == 0, at, result)
    if place.cycles is not None:
        result = _add_cycles(xp, curves, result, place.cycles)
    if place.before_s is not None:
        result = _extend(xp, curves, result, place.before_s, at_start=True)
    if place.after_s is not None:
        result = _extend(xp, curves, result, place.after_s, at_start=False)
    return result


_SPHERE = {
    Interpolation.SQUAD: (rotation_splines.squad_controls, rotation_splines.squad),
    Interpolation.SPHERICAL_BEZIER: (rotation_splines.spherical_bezier_controls, rotation_splines.spherical_bezier),
    Interpolation.LOG_CUBIC: (rotation_splines.log_cubic_controls, rotation_splines.log_cubic),
}


def _on_the_sphere(
    mode: Interpolation, values: Sequence[Array], keys: Array, place: _Location, at: Array, share: Array, used: Array
) -> Array:
    """Rotation splines (*B, G, 4); the keys beside a span decide how it bends, whatever their own modes."""
    controls_of, evaluate = _SPHERE[mode]
    low, high = 0, len(keys)
    if mode is not Interpolation.LOG_CUBIC:  # which alone depends on all keys
        spans = place.span[used & (place.share != 0)]
        low, high = max(int(spans.min()) - 1, 0), min(int(spans.max()) + 3, high)
    xp = namespace(*values)
    controls = controls_of(xp.stack([v[low:high, ...] for v in values], axis=1), keys[low:high])
    row = np.clip(place.span - low, 0, high - low - 2)
    shape = (*row.shape, *controls.shape[1:])
    taken = controls[row] if isinstance(controls, np.ndarray) else gather(controls, row.reshape(-1), 0)
    return evaluate(at, xp.reshape(taken, shape), share + 0.0 * at[..., 0])


def _rows(xp: ModuleType, tables: Sequence[Array], index: Array) -> Array:
    """Rows of each table at an index of any shape, side by side: (*B, G, ...)."""
    if not isinstance(tables[0], np.ndarray):
        flat = [gather(t, index.reshape(-1), 0) for t in tables]
        return xp.reshape(xp.stack(flat, axis=1), (*index.shape, len(tables), *tables[0].shape[1:]))
    if len(tables) == 1:
        return tables[0][index][..., None, :] if tables[0].ndim == 2 else tables[0][index][..., None, :, :]
    return np.stack([t[index] for t in tables], axis=index.ndim)


def _sides(xp: ModuleType, tables: Sequence[Array | None], index: Array, like: Array) -> Array:
    """Tangents or handles as `_rows`, in the library and precision of the values."""
    found = _rows(namespace(tables[0]), [t for t in tables if t is not None], index)
    return found if isinstance(found, np.ndarray) else xp.astype(unified(found, like)[0], like.dtype)


def column(xp: ModuleType, numbers: Array, like: Array) -> Array:
    """NumPy numbers (*B,) as (*B, 1), one for all of a group, in the library and precision of ``like``."""
    if isinstance(like, np.ndarray):
        return np.asarray(numbers, like.dtype)[..., None]
    return xp.astype(unified(np.asarray(numbers), like)[0], like.dtype)[..., None]


def choose(xp: ModuleType, condition: Array, yes: Array, no: Array) -> Array:
    """``yes`` (*B, G, C) where the condition (*B,) holds, else ``no``."""
    if np.all(condition):
        return yes
    if not np.any(condition):
        return no
    return xp.where(xp.asarray(condition)[..., None, None], yes, no)


def _ends(xp: ModuleType, curves: Sequence[Curve], key: int) -> Array:
    return xp.stack([c.values[key] for c in curves], axis=0)


def _add_cycles(xp: ModuleType, curves: Sequence[Curve], result: Array, cycles: Array) -> Array:
    """Each whole cycle starts where the one before it ended."""
    first, last = _ends(xp, curves, 0), _ends(xp, curves, -1)
    count = column(xp, cycles, result)
    if curves[0].kind is CurveKind.ROTATION:
        # Bring one cycle's turn to the power of the number of cycles, before the rotation inside the cycle.
        moved = quat.multiply(quat.power(quat.multiply(last, quat.conjugate(first)), count), result)
    else:
        moved = result + count[..., None] * (last - first)
    return choose(xp, cycles != 0, moved, result)


def _extend(xp: ModuleType, curves: Sequence[Curve], result: Array, outside_s: Array, at_start: bool) -> Array:
    """Go on with the speed at the end: straight lines, and constant angular velocity for rotations."""
    key, span = (0, 0) if at_start else (-1, -2)
    first = curves[0]
    mode = int(first.modes[span])
    span_s = float(first.times_s[1] - first.times_s[0] if at_start else first.times_s[-1] - first.times_s[-2])
    end = _ends(xp, curves, key)
    elapsed = column(xp, outside_s, result)
    if mode == Interpolation.STEP:
        return result
    velocity = (_ends(xp, curves, span + 1) - _ends(xp, curves, span)) / span_s
    if mode == Interpolation.HERMITE:
        tangents = [c.out_tangents if at_start else c.in_tangents for c in curves]
        velocity = xp.stack([t[key] for t in tangents if t is not None], axis=0)
    elif mode == Interpolation.BEZIER:
        handles = [c.out_handles if at_start else c.in_handles for c in curves]
        handle = xp.stack([h[key] for h in handles if h is not None], axis=0)
        # A handle without seconds gives no speed: the chord's then.
        upright = handle[..., 0] == 0
        velocity = xp.where(upright, velocity, handle[..., 1] / xp.where(upright, 1.0, handle[..., 0]))
    if first.kind is not CurveKind.ROTATION:
        return choose(xp, outside_s != 0, end + elapsed[..., None] * velocity, result)
    if mode == Interpolation.HERMITE:
        # q' = (half angular velocity) q; only the part along the sphere turns, normalising removes the other.
        half_velocity = quat.multiply(velocity, quat.conjugate(end))[..., 1:]
    else:
        half_velocity = (
            quat.to_rotation_vector(quat.difference(_ends(xp, curves, span), _ends(xp, curves, span + 1))) / 2 / span_s
        )
    moved = quat.multiply(quat.exp(elapsed[..., None] * half_velocity), end)
    return choose(xp, outside_s != 0, moved, result)


def groups(curves: Sequence[Curve]) -> list[list[int]]:
    """Indices of curves that share key times, modes, kind, precision and extrapolation."""
    # Exporters reuse one time array for many channels: compare contents only where the arrays differ.
    contents: dict[int, bytes] = {}

    def content(array: Array) -> bytes:
        if id(array) not in contents:
            contents[id(array)] = array.tobytes()
        return contents[id(array)]

    groups: dict[tuple[Any, ...], list[int]] = {}
    for i, curve in enumerate(curves):
        key = (
            content(curve.times_s),
            content(curve.modes),
            curve.kind is CurveKind.ROTATION,
            id(curve.before),
            id(curve.after),
            curve.kind is CurveKind.BOOLEAN,
            curve.out_tangents is None,
            curve.out_handles is None,
            curve.values.shape[1],
            curve.values.dtype,
        )
        groups.setdefault(key, []).append(i)
    return list(groups.values())
