"""How keys lead to each other: interpolation, tangent types and what a curve does beyond its keys."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np

from keypose.arrays import Array
from keypose.editing.keys import KeyedCurve, key_indices, merge_keys, pick_keys
from keypose.editing.tangents import update_tangents, with_handles, with_tangents, with_types
from keypose.errors import ShapeError
from keypose.evaluate import sample_curve
from keypose.math import quat, spline
from keypose.model import ROTATION_ONLY, Curve, CurveKind, Extrapolation, Interpolation, Tangent

_CUBIC = (Interpolation.HERMITE, Interpolation.BEZIER)


def modes_of(kind: CurveKind) -> tuple[Interpolation, ...]:
    """The interpolations that a kind of curve can have."""
    if kind is CurveKind.BOOLEAN:
        return (Interpolation.STEP,)
    plain = (Interpolation.STEP, Interpolation.LINEAR, Interpolation.HERMITE)
    return (*plain, *(ROTATION_ONLY if kind is CurveKind.ROTATION else (Interpolation.BEZIER,)))


def set_interpolation(curve: Curve, keys: Any, mode: Interpolation) -> KeyedCurve:
    """The spans that start at these keys (indices) in another mode.

    From Hermite to Bezier is exact; from Bezier to Hermite where handles have a third of their span. From a line or a step to a
    cubic, the sides of the span become CLAMPED where they were FREE. ``error`` is the largest distance from the curve as it was
    in the spans that were cubics before and after, else 0: there another shape was asked for.

    Raises: ShapeError where an index is none of the curve's, or the kind of curve cannot have the mode.
    """
    if mode not in modes_of(curve.kind):
        raise ShapeError(f"mode: a {curve.kind.value} curve cannot have {mode.name}")
    chosen = key_indices(curve, keys)
    if mode not in _CUBIC:
        return KeyedCurve(_with_modes(curve, chosen, mode), chosen)
    made = with_handles(curve) if mode is Interpolation.BEZIER else with_tangents(_on_one_side(curve))
    made = with_types(made)
    old = np.asarray(curve.modes)
    span = chosen[(chosen < curve.key_count - 1) & (old[chosen] != mode)]
    was_cubic = np.isin(old[span], _CUBIC)
    changes: dict[str, Array] = {}
    error = 0.0
    if np.any(was_cubic):
        changes, error = _converted(made, span[was_cubic], mode)
    types = np.array(made.tangent_types)
    for side, at in ((1, span[~was_cubic]), (0, span[~was_cubic] + 1)):
        types[at, side] = np.where(types[at, side] == Tangent.FREE, Tangent.CLAMPED, types[at, side])
    made = replace(_with_modes(made, chosen, mode), tangent_types=types, **changes)
    return KeyedCurve(update_tangents(made), chosen, error)


def set_tangent_types(curve: Curve, keys: Any, type: Tangent, side: Literal["in", "out"] | None = None) -> Curve:
    """Sides of keys (indices) of another type, both where none is said; lines and steps beside them become cubics.

    ALIGNED brings both sides of a key into one line, the mean of their directions.

    Raises: ShapeError where an index is none of the curve's, or the kind of curve has no cubics.
    """
    smooth = Interpolation.HERMITE if curve.kind is CurveKind.ROTATION else Interpolation.BEZIER
    if smooth not in modes_of(curve.kind):
        raise ShapeError(f"a {curve.kind.value} curve has no tangents")
    chosen = key_indices(curve, keys)
    spans = np.concatenate([chosen - 1 if side != "out" else chosen[:0], chosen if side != "in" else chosen[:0]])
    spans = np.unique(spans[(spans >= 0) & (spans < curve.key_count - 1)])
    spans = spans[~np.isin(np.asarray(curve.modes)[spans], _CUBIC)]
    made = with_types(set_interpolation(curve, spans, smooth).curve if len(spans) else curve)
    types = np.array(made.tangent_types)
    for n, name in ((0, "in"), (1, "out")):
        if side in (None, name):
            types[chosen, n] = type
    made = replace(made, tangent_types=types)
    return update_tangents(_aligned(made, chosen) if type is Tangent.ALIGNED else made)


def set_extrapolation(curve: Curve, before: Extrapolation | None = None, after: Extrapolation | None = None) -> Curve:
    """What the curve does before its first and after its last key; None leaves it."""
    return replace(curve, before=before or curve.before, after=after or curve.after)


def _with_modes(curve: Curve, chosen: Array, mode: Interpolation) -> Curve:
    modes = np.array(curve.modes)
    modes[chosen] = mode
    return replace(curve, modes=modes)


def _on_one_side(curve: Curve) -> Curve:
    """Rotations with signs that keep neighbours on one side of the sphere, as cubics need them."""
    if curve.kind is not CurveKind.ROTATION:
        return curve
    values = quat.align_signs(np.asarray(curve.values), axis=0)
    sign = np.where(np.any(values != curve.values, axis=-1, keepdims=True), -1, 1).astype(values.dtype)
    tangents = {n: None if (a := getattr(curve, n)) is None else a * sign for n in ("in_tangents", "out_tangents")}
    return replace(curve, values=values, **tangents)


def _converted(curve: Curve, span: Array, mode: Interpolation) -> tuple[dict[str, Array], float]:
    """Tangents or handles of spans that were the other cubic, and the largest distance of both."""
    span_s = np.diff(curve.times_s)[span]
    values = np.asarray(curve.values, np.float64)
    names = ("tangents", "handles")
    sides = {f"{d}_{n}": getattr(curve, f"{d}_{n}") for d in ("in", "out") for n in names}
    made = {name: np.array(side) for name, side in sides.items() if side is not None}
    if mode is Interpolation.BEZIER:
        third = np.broadcast_to(span_s[:, None] / 3, (len(span), values.shape[1]))
        made["out_handles"][span] = np.stack([third, third * made["out_tangents"][span]], axis=-1)
        made["in_handles"][span + 1] = np.stack([-third, -third * made["in_tangents"][span + 1]], axis=-1)
        return {n: made[n] for n in ("in_handles", "out_handles")}, 0.0
    # Handles of a third of the span are Hermite tangents already; only the others have to be measured.
    third = span_s[:, None] / 3
    out, back = made["out_handles"][span], made["in_handles"][span + 1]
    off = np.maximum(np.abs(out[..., 0] - third), np.abs(back[..., 0] + third)).max(axis=1)
    other = off > 1e-12 + 1e-7 * third[:, 0] * (out.dtype == np.float32)
    made["out_tangents"][span] = 3 * out[..., 1] / span_s[:, None]
    made["in_tangents"][span + 1] = -3 * back[..., 1] / span_s[:, None]
    error = 0.0
    if np.any(other):
        s = span[other]
        m0, m1, distance = spline.hermite_from_weighted(
            values[s], out[other], values[s + 1], back[other], span_s[other]
        )
        made["out_tangents"][s], made["in_tangents"][s + 1] = m0, m1
        error = float(np.max(distance))
    return {n: made[n] for n in ("in_tangents", "out_tangents")}, error


def _aligned(curve: Curve, keys: Array) -> Curve:
    """Both sides of keys in one line: the mean of their slopes."""
    changes: dict[str, Array] = {}
    if curve.in_tangents is not None and curve.out_tangents is not None:
        mean = (curve.in_tangents[keys] + curve.out_tangents[keys]) / 2
        for name in ("in_tangents", "out_tangents"):
            changes[name] = np.array(getattr(curve, name))
            changes[name][keys] = mean
    if curve.in_handles is not None and curve.out_handles is not None:
        back, out = np.array(curve.in_handles), np.array(curve.out_handles)
        t0, t1 = back[keys, :, 0], out[keys, :, 0]
        upright = (t0 == 0) | (t1 == 0)
        slope = (back[keys, :, 1] / np.where(upright, 1, t0) + out[keys, :, 1] / np.where(upright, 1, t1)) / 2
        back[keys, :, 1] = np.where(upright, back[keys, :, 1], slope * t0)
        out[keys, :, 1] = np.where(upright, out[keys, :, 1], slope * t1)
        changes |= {"in_handles": back, "out_handles": out}
    return replace(curve, **changes)


def resample_keys(curve: Curve, rate_hz: float, start_s: float | None = None, end_s: float | None = None) -> KeyedCurve:
    """The curve keyed at every frame of a rate between two times (its own first and last key), straight between them.

    Keys of the curve outside stay. ``error`` is the largest distance from the curve as it was, at 16 times a frame.

    Raises: ShapeError where the rate is not positive or the end comes before the start.
    """
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise ShapeError(f"rate_hz: expected more than 0, got {rate_hz}")
    start = float(curve.times_s[0]) if start_s is None else float(start_s)
    end = float(curve.times_s[-1]) if end_s is None else float(end_s)
    if end < start:
        raise ShapeError(f"end_s: expected {start} s or later, got {end} s")
    frames = np.arange(np.ceil(start * rate_hz - 1e-6), np.floor(end * rate_hz + 1e-6) + 1) / rate_hz
    # The ends stay where they are, so that the curve is as long as it was.
    times = np.unique(np.concatenate([[start], frames[(frames > start + 1e-6) & (frames < end - 1e-6)], [end]]))
    values = np.asarray(sample_curve(curve, times))
    if curve.kind is CurveKind.ROTATION:
        values = quat.align_signs(values, axis=0)
    mode = Interpolation.STEP if curve.kind is CurveKind.BOOLEAN else Interpolation.LINEAR
    dense = Curve(times, values, mode, kind=curve.kind, before=curve.before, after=curve.after)
    looked = (times[:-1, None] + np.diff(times)[:, None] * (np.arange(16) + 0.5) / 16).ravel()
    error = 0.0
    if len(looked):
        was, now = sample_curve(curve, looked), sample_curve(dense, looked)
        turned = curve.kind is CurveKind.ROTATION
        error = float(np.max(quat.angle_between(was, now) if turned else np.abs(was - now)))
    outside = np.nonzero((curve.times_s < start) | (curve.times_s > end))[0]
    rest = pick_keys(curve, outside)
    if rest is None:
        return KeyedCurve(dense, np.arange(dense.key_count), error)
    merged, indices = merge_keys(rest, dense)
    return KeyedCurve(update_tangents(merged), indices, error)
