"""Operations on the keys of one curve: insert, delete, move, scale, reverse, copy and paste.

Keys are named by their indices, rising. A curve goes in, a curve comes out; sides whose types follow their keys are brought
up to date (`keypose.editing.tangents`). Keys nearer than `SAME_TIME_S` are one key.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.editing.selection import SAME_TIME_S
from keypose.editing.tangents import update_tangents, with_handles, with_tangents, with_types
from keypose.errors import ShapeError
from keypose.evaluate import sample_curve
from keypose.math import quat, spline
from keypose.model import ROTATION_ONLY, Curve, CurveKind, Interpolation, Tangent

_SIDES = ("in_tangents", "out_tangents", "in_handles", "out_handles", "tangent_types")


@dataclass(frozen=True, slots=True, eq=False)
class KeyedCurve:
    """A curve after an edit, the keys (indices) that were worked on, and how far it now is from what it was.

    ``error`` is in the unit of the values (radians for rotations): 0 where the edit is exact to rounding.
    """

    curve: Curve
    keys: Array
    error: float = 0.0


def pick_keys(curve: Curve, keys: Any) -> Curve | None:
    """Only these keys, as a curve of their own; None of none. What `paste_keys` takes.

    Raises: ShapeError where an index is none of the curve's.
    """
    return _picked(curve, key_indices(curve, keys))


def delete_keys(curve: Curve, keys: Any) -> Curve | None:
    """The curve without these keys; None where none is left.

    Raises: ShapeError where an index is none of the curve's.
    """
    rest = np.setdiff1d(np.arange(curve.key_count), key_indices(curve, keys), assume_unique=True)
    left = _picked(curve, rest)
    return None if left is None else update_tangents(left)


def insert_keys(curve: Curve, times_s: Any) -> KeyedCurve:
    """Keys more at some times, through which the curve goes as before.

    Exact for steps, lines (slerp too), Hermite cubics and Bezier spans, whose handles De Casteljau's construction splits. Where
    the handles of a Bezier span overlap in time, one more key at its middle keeps it exact. Rotations in Hermite cubics and
    splines on the sphere can only be followed: ``error`` says how far they are off at most, at 16 times a span. Sides beside
    the new keys that followed their neighbours stay as they are from now on (ALIGNED, those of VECTOR type FREE). Beyond the
    first and last key the new key takes the value that the curve has there. Where there is a key already, none is added.

    Raises: ShapeError where a time is not finite.
    """
    asked = np.unique(np.asarray(times_s, np.float64).ravel())
    if not np.all(np.isfinite(asked)):
        raise ShapeError("times_s: expected finite numbers")
    wanted = _apart(asked)
    keys = curve.times_s
    right = np.clip(np.searchsorted(keys, wanted), 0, len(keys) - 1)
    left = np.maximum(right - 1, 0)
    distance = np.minimum(np.abs(keys[right] - wanted), np.abs(keys[left] - wanted))
    new = wanted[distance > SAME_TIME_S]
    if len(new) == 0:
        return KeyedCurve(curve, _nearest(keys, asked))
    new = np.union1d(new, _middles_of_overlaps(curve, new))
    result = _inserted(curve, new)
    return KeyedCurve(result, _nearest(result.times_s, asked), _distance(curve, result, new))


def move_keys(
    curve: Curve, keys: Any, seconds: float = 0.0, value: Any = 0.0, *, components: Sequence[int] | None = None
) -> KeyedCurve:
    """Keys moved in time and value (a number, or (C,) numbers); those that they land on give way.

    ``components`` are those whose values move, all where None. Rotations are turned by `turn_keys`.

    Raises: ShapeError where an index is none of the curve's, or a rotation's or switch's value is to be moved.
    """
    return transform_keys(curve, keys, shift_s=seconds, shift_value=value, components=components)


def scale_keys(
    curve: Curve,
    keys: Any,
    time: float = 1.0,
    value: float = 1.0,
    *,
    about_s: float = 0.0,
    about_value: Any = 0.0,
    components: Sequence[int] | None = None,
) -> KeyedCurve:
    """Keys scaled in time and value about a pivot, with their tangents and handles; those that they land on give way.

    A negative scale of time turns their order round. Keys that fall together become one, the last.

    Raises: ShapeError where an index is none of the curve's, or a rotation's or switch's value is to be scaled.
    """
    pivot = np.asarray(about_value, np.float64)
    return transform_keys(
        curve,
        keys,
        scale_time=time,
        shift_s=(1 - time) * about_s,
        scale_value=value,
        shift_value=(1 - value) * pivot,
        components=components,
    )


def reverse_keys(curve: Curve, keys: Any = None) -> KeyedCurve:
    """Keys, or the whole curve, backwards in their own range of time: each span goes as before the other way.

    The cubic in log space alone goes another way backwards; ``error`` says how far from the old one.

    Raises: ShapeError where an index is none of the curve's.
    """
    chosen = np.arange(curve.key_count) if keys is None else key_indices(curve, keys)
    if len(chosen) == 0:
        return KeyedCurve(curve, chosen)
    ends = float(curve.times_s[chosen[0]] + curve.times_s[chosen[-1]])
    if len(chosen) == curve.key_count:
        curve = replace(curve, before=curve.after, after=curve.before)
    result = transform_keys(curve, chosen, scale_time=-1.0, shift_s=ends)
    if curve.key_count < 2 or not np.any(np.asarray(curve.modes) == Interpolation.LOG_CUBIC):
        return result
    low, high = curve.times_s[chosen[0]], curve.times_s[chosen[-1]]
    times = np.linspace(low, high, 16 * len(chosen) + 1)
    off = quat.angle_between(sample_curve(result.curve, times), sample_curve(curve, ends - times))
    return replace(result, error=float(np.max(off)))


def transform_keys(
    curve: Curve,
    keys: Any,
    *,
    scale_time: float = 1.0,
    shift_s: float = 0.0,
    scale_value: float = 1.0,
    shift_value: Any = 0.0,
    components: Sequence[int] | None = None,
) -> KeyedCurve:
    """Keys at ``scale_time * time + shift_s`` with ``scale_value * value + shift_value``; see `move_keys` and `scale_keys`.

    Raises:
        ShapeError: where a number is not finite, or the curve's values cannot be moved (rotations, booleans).
    """
    chosen = key_indices(curve, keys)
    shift = np.broadcast_to(np.asarray(shift_value, np.float64), (curve.values.shape[1],))
    in_value = scale_value != 1 or bool(np.any(shift != 0))
    if in_value and curve.kind in (CurveKind.ROTATION, CurveKind.BOOLEAN):
        raise ShapeError(f"a {curve.kind.value} curve has no values that can be moved or scaled")
    if not (
        np.isfinite(scale_time) and np.isfinite(shift_s) and np.isfinite(scale_value) and np.all(np.isfinite(shift))
    ):
        raise ShapeError("expected finite numbers to move and scale keys by")
    in_time = scale_time != 1 or shift_s != 0
    if len(chosen) == 0 or not (in_time or in_value):
        return KeyedCurve(curve, chosen)
    own = _picked(curve, chosen)
    rest = _picked(curve, np.setdiff1d(np.arange(curve.key_count), chosen, assume_unique=True))
    if own is None:
        return KeyedCurve(curve, chosen)
    factor, offset = np.ones(curve.values.shape[1]), np.zeros(curve.values.shape[1])
    moving = slice(None) if components is None else list(components)
    factor[moving], offset[moving] = scale_value, shift[moving]
    changed = _changed(own, scale_time, shift_s, factor, offset)
    if rest is None:
        everything = np.arange(changed.key_count)
        return KeyedCurve(update_tangents(changed), everything)
    merged, indices = merge_keys(rest, changed)
    return KeyedCurve(update_tangents(merged), indices)


def turn_keys(curve: Curve, keys: Any, rotation: Any, *, local: bool = False) -> Curve:
    """Keys of a rotation curve turned by a quaternion (4,), about the parent's axes or, ``local``, about their own.

    Raises: ShapeError where an index is none of the curve's or the curve holds no rotations.
    """
    if curve.kind is not CurveKind.ROTATION:
        raise ShapeError(f"expected a rotation curve to turn, got a {curve.kind.value} curve")
    chosen = key_indices(curve, keys)
    by = quat.normalize(np.asarray(rotation, np.float64))

    def turned(array: Array | None) -> Array | None:
        if array is None:
            return None
        result = np.array(array)
        own = np.asarray(array[chosen], np.float64)
        result[chosen] = quat.multiply(own, by) if local else quat.multiply(by, own)
        return result

    changed = replace(
        curve,
        values=turned(curve.values),
        in_tangents=turned(curve.in_tangents),
        out_tangents=turned(curve.out_tangents),
    )
    return update_tangents(changed)


def paste_keys(
    curve: Curve | None,
    copied: Curve,
    at_s: float,
    *,
    mirrored: bool = False,
    offset: bool = False,
    overwrite: bool = False,
) -> KeyedCurve:
    """Copied keys (`pick_keys`) put into a curve, or alone where it is None, so that the first comes to a time.

    ``mirrored`` puts them backwards, ``offset`` moves their values so that they go on from the curve's, ``overwrite`` takes away
    the keys that lay between the first and the last of them. Keys that they land on give way.

    Raises: ShapeError where the time is not finite or the curves hold values of different kinds.
    """
    if not np.isfinite(at_s):
        raise ShapeError("at_s: expected a finite number")
    if curve is not None and (curve.kind is not copied.kind or curve.values.shape[1] != copied.values.shape[1]):
        raise ShapeError(
            f"copied: expected {curve.values.shape[1]} components of the kind {curve.kind.name}, "
            f"got {copied.values.shape[1]} of {copied.kind.name}"
        )
    width = copied.values.shape[1]
    first, last = float(copied.times_s[0]), float(copied.times_s[-1])
    scale, shift = (-1.0, at_s + last) if mirrored else (1.0, at_s - first)
    own = _changed(copied, scale, shift, np.ones(width), np.zeros(width))
    if curve is None:
        return KeyedCurve(update_tangents(own), np.arange(own.key_count))
    if offset and curve.kind not in (CurveKind.ROTATION, CurveKind.BOOLEAN):
        there = np.asarray(sample_curve(curve, own.times_s[0]), np.float64)
        own = _changed(own, 1.0, 0.0, np.ones(width), there - np.asarray(own.values[0], np.float64))
    base: Curve | None = curve
    if overwrite:
        outside = (curve.times_s < own.times_s[0] - SAME_TIME_S) | (curve.times_s > own.times_s[-1] + SAME_TIME_S)
        base = _picked(curve, np.nonzero(outside)[0])
    own = replace(own, before=curve.before, after=curve.after)
    if base is None:
        return KeyedCurve(update_tangents(own), np.arange(own.key_count))
    merged, indices = merge_keys(base, own)
    return KeyedCurve(update_tangents(merged), indices)


def merge_keys(base: Curve, added: Curve) -> tuple[Curve, Array]:
    """Two curves of one channel as one, and where the keys of ``added`` are in it; where keys coincide, those win.

    Sides are not brought up to date.
    """
    for make, name in ((with_tangents, "in_tangents"), (with_handles, "in_handles"), (with_types, "tangent_types")):
        if getattr(base, name) is not None or getattr(added, name) is not None:
            base, added = make(base), make(added)
    right = np.clip(np.searchsorted(added.times_s, base.times_s), 0, added.key_count - 1)
    left = np.maximum(right - 1, 0)
    near = np.minimum(np.abs(added.times_s[right] - base.times_s), np.abs(added.times_s[left] - base.times_s))
    kept = near > SAME_TIME_S
    times = np.concatenate([base.times_s[kept], added.times_s])
    order = np.argsort(times, kind="stable")

    def joined(a: Array | None, b: Array | None) -> Array | None:
        if a is None or b is None:
            return None
        return np.concatenate([np.asarray(a)[kept], np.asarray(b).astype(np.asarray(a).dtype, copy=False)])[order]

    fields = {name: joined(getattr(base, name), getattr(added, name)) for name in ("values", "modes", *_SIDES)}
    indices = np.argsort(order, kind="stable")[int(kept.sum()) :]
    return replace(base, times_s=times[order], **fields), indices


# --- parts ------------------------------------------------------------------------------------------------------------


def key_indices(curve: Curve, keys: Any) -> Array:
    """Indices of keys, rising and each once; raises ShapeError where one is none of the curve's."""
    indices = np.unique(np.asarray(keys, np.intp))
    if len(indices) and (indices[0] < 0 or indices[-1] >= curve.key_count):
        wrong = int(indices[0] if indices[0] < 0 else indices[-1])
        raise ShapeError(f"keys: expected indices from 0 to {curve.key_count - 1}, got {wrong}")
    return indices


def _picked(curve: Curve, indices: Array) -> Curve | None:
    if len(indices) == 0:
        return None
    if len(indices) == curve.key_count:
        return curve
    rows = {name: None if (a := getattr(curve, name)) is None else np.asarray(a)[indices] for name in _SIDES}
    return replace(
        curve, times_s=curve.times_s[indices], values=curve.values[indices], modes=curve.modes[indices], **rows
    )


def _apart(times: Array) -> Array:
    """Of times that lie together the first, so that all are further apart than one key."""
    if np.all(np.diff(times) > SAME_TIME_S):
        return times
    kept: list[float] = []
    for time in times.tolist():
        if not kept or time - kept[-1] > SAME_TIME_S:
            kept.append(time)
    return np.array(kept)


def _nearest(keys: Array, times: Array) -> Array:
    right = np.clip(np.searchsorted(keys, times), 0, len(keys) - 1)
    left = np.maximum(right - 1, 0)
    return np.unique(np.where(np.abs(keys[left] - times) < np.abs(keys[right] - times), left, right))


def _changed(own: Curve, scale_s: float, shift_s: float, factor: Array, offset: Array) -> Curve:
    """All keys of a curve moved and scaled; keys that fall together become the last of them."""
    times = scale_s * own.times_s + shift_s
    values = own.values
    if np.any(factor != 1) or np.any(offset != 0):
        values = (np.asarray(own.values, np.float64) * factor + offset).astype(own.values.dtype)
    speed = factor / (scale_s if scale_s != 0 else 1.0)
    fields: dict[str, Any] = {
        name: None if (a := getattr(own, name)) is None else (a * speed).astype(a.dtype)
        for name in ("in_tangents", "out_tangents")
    }
    for name in ("in_handles", "out_handles"):
        handles = getattr(own, name)
        if handles is not None:
            scale = np.stack([np.full_like(factor, scale_s), factor], axis=-1)
            handles = (handles * scale).astype(handles.dtype)
        fields[name] = handles
    fields["tangent_types"] = own.tangent_types
    fields["modes"] = own.modes
    if scale_s < 0:
        # The span that a key started is now the one that ends at it, and its sides change places.
        modes = np.asarray(own.modes)
        fields["modes"] = np.concatenate([modes[-2::-1], modes[-1:]]) if len(modes) > 1 else modes
        turned = {name: None if (a := fields[name]) is None else a[::-1] for name in _SIDES[:4]}
        fields["in_tangents"], fields["out_tangents"] = turned["out_tangents"], turned["in_tangents"]
        fields["in_handles"], fields["out_handles"] = turned["out_handles"], turned["in_handles"]
        if own.tangent_types is not None:
            fields["tangent_types"] = np.asarray(own.tangent_types)[::-1, ::-1]
        times, values = times[::-1], values[::-1]
    kept = np.append(np.diff(times) > SAME_TIME_S, True)
    if scale_s == 0:
        kept = np.append(np.zeros(len(times) - 1, bool), True)
    if not np.all(kept):
        times, values = times[kept], values[kept]
        fields = {name: None if a is None else np.asarray(a)[kept] for name, a in fields.items()}
    return replace(own, times_s=times, values=values, **fields)


def _middles_of_overlaps(curve: Curve, times: Array) -> Array:
    """Times in the middle (u = 1/2) of Bezier spans that are to be split and whose handles overlap.

    Half of such a span has handles that do not; splits of those reach no further than their parts.
    """
    if curve.out_handles is None or curve.in_handles is None or curve.key_count < 2:
        return np.zeros(0)
    k = np.searchsorted(curve.times_s, times, side="right") - 1
    k = np.unique(k[(k >= 0) & (k < curve.key_count - 1)])
    k = k[np.asarray(curve.modes)[k] == Interpolation.BEZIER]
    span = np.diff(curve.times_s)[k][:, None]
    first = np.minimum(np.asarray(curve.out_handles, np.float64)[k, :, 0], span) / span
    last = 1 - np.minimum(-np.asarray(curve.in_handles, np.float64)[k + 1, :, 0], span) / span
    middle = curve.times_s[k][:, None] + span * (3 * first + 3 * last + 1) / 8
    return np.unique(middle[first > last])


def _inserted(curve: Curve, new: Array) -> Curve:
    keys, count = curve.times_s, curve.key_count
    times = np.concatenate([keys, new])
    order = np.argsort(times, kind="stable")
    place = np.argsort(order, kind="stable")
    old_at, new_at = place[:count], place[count:]
    span = np.searchsorted(keys, new, side="right") - 1
    inner = (span >= 0) & (span < count - 1)
    source = np.clip(span, 0, count - 1)
    values = np.asarray(sample_curve(curve, new))
    if curve.kind is CurveKind.ROTATION:
        values = quat.normalize(values)

    def woven(old: Array, added: Array) -> Array:
        result = np.empty((len(times), *old.shape[1:]), old.dtype)
        result[old_at], result[new_at] = old, added
        return result

    modes = woven(np.asarray(curve.modes), np.asarray(curve.modes)[source])
    fields: dict[str, Any] = {name: getattr(curve, name) for name in _SIDES}
    for name in _SIDES[:4]:
        if fields[name] is not None:
            fields[name] = woven(np.asarray(fields[name], np.float64), np.zeros((len(new), *fields[name].shape[1:])))
    mode_of = np.asarray(curve.modes)[source]
    cubic = inner & ((mode_of == Interpolation.HERMITE) | (mode_of == Interpolation.BEZIER))
    hermite = np.nonzero(inner & (mode_of == Interpolation.HERMITE))[0]
    if len(hermite):
        slopes = _velocity(curve, new[hermite], span[hermite])
        fields["in_tangents"][new_at[hermite]] = fields["out_tangents"][new_at[hermite]] = slopes
    bezier = np.nonzero(inner & (mode_of == Interpolation.BEZIER))[0]
    values = _split_beziers(curve, new, values, span, bezier, old_at, new_at, fields)
    if fields["tangent_types"] is not None:
        types = woven(np.asarray(curve.tangent_types), np.zeros((len(new), 2), np.uint8))
        held = np.unique(span[cubic])
        for side, at in ((1, old_at[held]), (0, old_at[held + 1])):
            own = types[at, side]
            loose = (own == Tangent.VECTOR) | (own == Tangent.FREE)
            types[at, side] = np.where(loose, Tangent.FREE, Tangent.ALIGNED)
        types[new_at[cubic]] = Tangent.ALIGNED
        fields["tangent_types"] = types
    for name in _SIDES[:4]:
        if fields[name] is not None:
            fields[name] = fields[name].astype(getattr(curve, name).dtype)
    grown = replace(curve, times_s=times[order], values=woven(curve.values, values), modes=modes, **fields)
    outside = new_at[~inner]
    return update_tangents(grown, _with_neighbours(outside, len(times))) if len(outside) else grown


def _with_neighbours(keys: Array, count: int) -> Array:
    return np.unique(np.clip(np.concatenate([keys - 1, keys, keys + 1]), 0, count - 1))


def _velocity(curve: Curve, times: Array, span: Array) -> Array:
    """Units per second (N, C) inside Hermite spans; of rotations the part along the sphere."""
    values = np.asarray(curve.values, np.float64)
    if curve.out_tangents is None or curve.in_tangents is None:
        raise ShapeError("curve: Hermite spans without tangents")
    span_s = curve.times_s[span + 1] - curve.times_s[span]
    u = (times - curve.times_s[span]) / span_s
    ends = (values[span], curve.out_tangents[span], values[span + 1], curve.in_tangents[span + 1])
    p0, m0, p1, m1 = (np.asarray(a, np.float64) for a in ends)
    slope = spline.hermite_derivative(p0, m0, p1, m1, u, span_s)
    if curve.kind is not CurveKind.ROTATION:
        return slope
    at = spline.hermite(p0, m0, p1, m1, u, span_s)
    length = np.linalg.norm(at, axis=-1, keepdims=True)
    unit = at / length
    return (slope - unit * np.sum(slope * unit, axis=-1, keepdims=True)) / length


def _split_beziers(
    curve: Curve,
    new: Array,
    at_new: Array,
    span: Array,
    chosen: Array,
    old_at: Array,
    new_at: Array,
    fields: dict[str, Any],
) -> Array:
    """Handles of new keys in Bezier spans, and those beside them, cut by De Casteljau's construction; the keys' values."""
    if len(chosen) == 0 or curve.out_handles is None or curve.in_handles is None:
        return at_new
    out, back = fields["out_handles"], fields["in_handles"]
    values, found = np.asarray(curve.values, np.float64), np.array(at_new)
    spans, row = np.unique(span[chosen], return_inverse=True)
    start, span_s = curve.times_s[spans], curve.times_s[spans + 1] - curve.times_s[spans]
    points = _control_points(values, curve, spans, span_s)  # (4, S, C, 2)
    first, last = points[1, ..., 0] / span_s[:, None], points[2, ..., 0] / span_s[:, None]
    at, reached = old_at[spans], np.zeros(first.shape)
    # Times rise within a span: in each round the next one of every span cuts what the last one left.
    turn = np.arange(len(row)) - np.searchsorted(row, row, side="left")
    for n in range(int(turn.max()) + 1):
        mine = chosen[turn == n]
        s = row[turn == n]
        share = np.broadcast_to(((new[mine] - start[s]) / span_s[s])[:, None], first[s].shape)
        # Where handles overlap most the curve stands upright in its middle, and time says little about u.
        middle = np.abs((3 * first[s] + 3 * last[s] + 1) / 8 - share) < 1e-12
        u = np.where(middle, 0.5, spline.bezier_parameter(first[s], last[s], share))
        left_over = 1 - reached[s]
        local = np.where(left_over > 0, (u - reached[s]) / np.where(left_over > 0, left_over, 1.0), 1.0)
        cut = points[:, s]
        left, right = spline.split_bezier(cut[0], cut[1], cut[2], cut[3], local)
        here = new_at[mine]
        out[at[s]] = left[1] - left[0]
        back[here] = left[2] - left[3]
        found[mine] = left[3][..., 1]
        points[:, s], at[s], reached[s] = np.stack(right), here, u
    out[at] = points[1] - points[0]
    back[old_at[spans + 1]] = points[2] - points[3]
    np.maximum(out[..., 0], 0.0, out=out[..., 0])
    np.minimum(back[..., 0], 0.0, out=back[..., 0])
    return found


def _control_points(values: Array, curve: Curve, k: Array, span_s: Array) -> Array:
    """Control points (4, S, C, 2) of spans in seconds from the first key and value; handles no longer than the span."""
    if curve.out_handles is None or curve.in_handles is None:
        raise ShapeError("curve: Bezier spans without handles")
    out, back = (np.asarray(h, np.float64) for h in (curve.out_handles[k], curve.in_handles[k + 1]))
    whole = np.broadcast_to(span_s[:, None], out.shape[:2])

    def short(handle: Array) -> Array:
        length = np.abs(handle[..., 0])
        return handle * np.where(length > whole, whole / np.where(length > whole, length, 1.0), 1.0)[..., None]

    start = np.stack([np.zeros(whole.shape), values[k]], axis=-1)
    end = np.stack([whole, values[k + 1]], axis=-1)
    return np.stack([start, start + short(out), end + short(back), end])


def _distance(old: Curve, new: Curve, added: Array) -> float:
    """The largest distance between two curves in the spans that got keys, where an edit could not be exact."""
    if old.kind is not CurveKind.ROTATION:
        return 0.0
    modes = {Interpolation(int(m)) for m in np.unique(old.modes)}
    if not modes & {Interpolation.HERMITE, *ROTATION_ONLY}:
        return 0.0
    # Splines on the sphere change two keys further away, the cubic in log space everywhere.
    near = new.times_s
    if Interpolation.LOG_CUBIC not in modes:
        at = np.searchsorted(new.times_s, added)
        near = new.times_s[np.unique(np.clip(at[:, None] + np.arange(-3, 4), 0, new.key_count - 1))]
    times = (near[:-1, None] + np.diff(near)[:, None] * (np.arange(16) + 0.5) / 16).ravel()
    if len(times) == 0:
        return 0.0
    return float(np.max(quat.angle_between(sample_curve(old, times), sample_curve(new, times)), initial=0.0))
