"""What an animator adds to a move from one key to the next: anticipation, overshoot and settling, moving holds, breakdowns.

A move is a span whose two keys differ. All work on values of any kind; of rotations the short way is meant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from math import atan2, ceil, exp, isfinite, log, pi, sqrt
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.editing.selection import (
    SAME_TIME_S,
    Selection,
    chosen_channels,
    chosen_keys,
    chosen_spans,
    edited,
    with_curves,
)
from keypose.editing.spans import Span, difference, hermite_span, moved, rates, with_spans
from keypose.errors import ShapeError
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation

# Changes below this share of a curve's whole range are none.
_STILL = 1e-6


def anticipate(curve: Curve, spans: Iterable[int], amount: float = 0.15, lead_s: float = 0.2) -> Curve:
    """The curve with a move the other way before each of the moves that start at the given keys.

    The first ``lead_s`` seconds of the span (at most four tenths of it) go back to a new key, ``amount`` of the move beyond the
    start; from there the move begins at rest and arrives as it did. All keys stay.

    Raises: ShapeError where ``amount`` is negative or ``lead_s`` not positive.
    """
    if amount < 0:
        raise ShapeError(f"amount: expected 0 or more, got {amount}")
    if lead_s <= 0:
        raise ShapeError(f"lead_s: expected more than 0 seconds, got {lead_s}")
    _, coming = rates(curve)
    steps, still_spans = _steps(curve)
    made: dict[int, Span] = {}
    for k, start, end, step in _moves(curve, spans, still_spans, steps):
        span_s = float(curve.times_s[k + 1] - curve.times_s[k])
        at = float(curve.times_s[k]) + min(lead_s, 0.4 * span_s)
        back = moved(curve.kind, start, -amount * step)
        still = np.zeros_like(step)
        made[k] = hermite_span(
            curve.kind,
            np.array([at]),
            back[None],
            start,
            np.stack([still, still]),
            np.stack([still, coming[k + 1]]),
            end,
        )
    return with_spans(curve, made)


def overshoot(
    curve: Curve, spans: Iterable[int], amount: float = 0.12, frequency_hz: float = 2.5, damping: float = 0.35
) -> Curve:
    """The curve shooting past the end of moves and settling there as a damped spring does.

    The move arrives with the speed with which the spring first passes its key by ``amount`` of the move; then it swings about the
    key, with a key at every turning point and every passage, and comes to rest before the next key. It needs a hold (or the end
    of the curve) after the move: where the next key comes sooner than half a swing, or wants another value, nothing is done.

    Raises: ShapeError where ``amount`` is negative, ``frequency_hz`` not positive or ``damping`` not in 0.05..0.95.
    Source: the under-damped spring, x = v / w e^(-d w0 t) sin(w t) with w = w0 sqrt(1 - d²).
    """
    if amount < 0:
        raise ShapeError(f"amount: expected 0 or more, got {amount}")
    if frequency_hz <= 0:
        raise ShapeError(f"frequency_hz: expected more than 0, got {frequency_hz}")
    if not 0.05 <= damping <= 0.95:
        raise ShapeError(f"damping: expected 0.05 (swings long) to 0.95 (hardly swings), got {damping}")
    leaving, _ = rates(curve)
    steps, still_spans = _steps(curve)
    made: dict[int, Span] = {}
    tail: tuple[int, Array, Span] | None = None
    for k, start, end, step in _moves(curve, spans, still_spans, steps):
        last = k + 1 == curve.key_count - 1
        if not last and not still_spans[k + 1]:
            continue
        room = np.inf if last else float(curve.times_s[k + 2] - curve.times_s[k + 1])
        times, places, speeds = _swing(frequency_hz, damping, room)
        if len(times) == 0:
            continue
        arrival = amount * step
        made[k] = hermite_span(
            curve.kind,
            np.zeros(0),
            np.zeros((0, len(start))),
            start,
            leaving[k : k + 1],
            speeds[0] * arrival[None],
            end,
        )
        values = moved(curve.kind, end, places[1:, None] * arrival)
        begins, ends = speeds[:-1, None] * arrival, speeds[1:, None] * arrival
        at = float(curve.times_s[k + 1]) + times[1:]
        if last:
            tail = k + 1, at, hermite_span(curve.kind, at[:-1], values[:-1], end, begins, ends, values[-1])
        else:
            still = np.zeros((1, len(step)))
            begins, ends = np.concatenate([begins, still]), np.concatenate([ends, still])
            made[k + 1] = hermite_span(
                curve.kind, at, values, end, begins, ends, np.asarray(curve.values[k + 2], float)
            )
    if tail is not None:
        key, at, span = tail
        curve = _with_last_key(curve, float(at[-1]))
        made[key] = span
    return with_spans(curve, made)


def moving_hold(curve: Curve, spans: Iterable[int], amount: float = 0.04) -> Curve:
    """The curve with life in its holds: each drifts on by ``amount`` of the move that led to it, slower and slower.

    A hold is a span between two keys of one value after a move; its second key is moved, and the next move starts from there.
    Raises: ShapeError where ``amount`` is negative.
    """
    if amount < 0:
        raise ShapeError(f"amount: expected 0 or more, got {amount}")
    values = np.array(curve.values, np.float64)
    made: dict[int, Span] = {}
    leaving, coming = rates(curve)
    _, still_spans = _steps(curve)
    for k in sorted({int(k) for k in spans}):
        if not 0 < k < curve.key_count - 1 or curve.kind is CurveKind.BOOLEAN or not still_spans[k]:
            continue
        step = difference(curve.kind, values[k - 1], values[k])
        if not np.any(step):
            continue
        values[k + 1] = moved(curve.kind, values[k], amount * step)
        seconds = float(curve.times_s[k + 1] - curve.times_s[k])
        # It leaves the move at a speed that dies away over the hold, as a parabola does.
        rate = 2.0 * amount * step / seconds
        empty = np.zeros(0), np.zeros((0, values.shape[1]))
        if curve.modes[k - 1] != Interpolation.STEP:
            made[k - 1] = hermite_span(curve.kind, *empty, values[k - 1], leaving[k - 1 : k], rate[None], values[k])
        made[k] = hermite_span(curve.kind, *empty, values[k], rate[None], 0.0 * rate[None], values[k + 1])
        if k + 2 < curve.key_count and curve.modes[k + 1] != Interpolation.STEP:
            made[k + 1] = hermite_span(
                curve.kind, *empty, values[k + 1], 0.0 * rate[None], coming[k + 2 : k + 3], values[k + 2]
            )
    precision = np.asarray(curve.values).dtype
    return with_spans(replace(curve, values=values.astype(precision)), made)


def breakdown(curve: Curve, time_s: float, favour: float = 0.5) -> Curve:
    """The curve with a key at a time between two others, on the way from the previous (0) to the next (1).

    Below 0 and above 1 it goes beyond. A key that is there already gets the new value. Beside the new key the speed is the one of
    the move as a whole (half of it beyond the ends); outside the two neighbours nothing changes, nor before the first and after
    the last key.
    """
    times = curve.times_s
    here = int(np.argmin(np.abs(times - time_s)))
    if abs(float(times[here]) - time_s) <= SAME_TIME_S:
        if not 0 < here < curve.key_count - 1:
            return curve
        curve = _without_key(curve, here)
        times = curve.times_s
    k = int(np.searchsorted(times, time_s, side="right")) - 1
    if not 0 <= k < curve.key_count - 1:
        return curve
    start, end = np.asarray(curve.values[k], np.float64), np.asarray(curve.values[k + 1], np.float64)
    step = difference(curve.kind, start, end)
    value = moved(curve.kind, start, favour * step)
    mode = Interpolation(int(curve.modes[k]))
    if curve.kind is CurveKind.BOOLEAN or mode in (Interpolation.STEP, Interpolation.LINEAR):
        if curve.kind is CurveKind.BOOLEAN:
            value = (value >= 0.5).astype(float)
        return with_spans(curve, {k: Span(np.array([time_s]), value[None], mode)})
    leaving, coming = rates(curve)
    speed = step / float(times[k + 1] - times[k]) * (1.0 if 0 <= favour <= 1 else 0.5)
    span = hermite_span(
        curve.kind,
        np.array([time_s]),
        value[None],
        start,
        np.stack([leaving[k], speed]),
        np.stack([speed, coming[k + 1]]),
        end,
    )
    return with_spans(curve, {k: span})


# --- clips --------------------------------------------------------------------------------------------------------------------


def on_moves(clip: Clip, selection: Selection, change: Callable[[Curve, list[int]], Curve]) -> Clip:
    """The clip with ``change`` done to each chosen channel and its chosen spans."""

    def each(channel: Channel, curve: Curve) -> Curve:
        return change(curve, chosen_spans(channel, curve, selection).tolist())

    return edited(clip, selection, each)


def overshoot_clip(clip: Clip, selection: Selection, amount: float, frequency_hz: float, damping: float) -> Clip:
    """`overshoot` after each chosen move; of a row of moves, the one that a hold or the end follows."""
    return on_moves(clip, selection, lambda curve, spans: overshoot(curve, spans, amount, frequency_hz, damping))


def breakdown_clip(clip: Clip, selection: Selection, time_s: float, favour: float) -> Clip:
    """`breakdown` of each chosen channel that has keys on both sides of the time."""
    return edited(clip, selection, lambda _, curve: breakdown(curve, time_s, favour))


def tween_keys(clip: Clip, selection: Selection, favour: float) -> Clip:
    """The selected keys between others moved towards the previous (0) or the next (1) unselected ones: a tween machine."""
    made: dict[Channel, Curve] = {}
    for channel in chosen_channels(clip, selection):
        curve = clip.curves[channel]
        keys = chosen_keys(channel, curve, selection)
        made[channel] = _tweened(curve, keys, favour)
    return with_curves(clip, made)


def _tweened(curve: Curve, keys: Array, favour: float) -> Curve:
    chosen = np.zeros(curve.key_count, bool)
    chosen[keys] = True
    fixed = np.nonzero(~chosen)[0]
    values = np.array(curve.values, np.float64)
    for k in keys:
        before, after = fixed[fixed < k], fixed[fixed > k]
        if len(before) and len(after) and curve.kind is not CurveKind.BOOLEAN:
            a, b = values[before[-1]], values[after[0]]
            values[k] = moved(curve.kind, a, favour * difference(curve.kind, a, b))
    return replace(curve, values=values.astype(np.asarray(curve.values).dtype))


# --- parts --------------------------------------------------------------------------------------------------------------------


def _steps(curve: Curve) -> tuple[Array, Array]:
    """Differences (K - 1, D) from each key to the next, and whether they are none (K - 1,)."""
    values = np.asarray(curve.values, np.float64)
    steps = difference(curve.kind, values[:-1], values[1:])
    whole = 1.0 if curve.kind is CurveKind.ROTATION else float(np.ptp(values, axis=0).max())
    return steps, np.abs(steps).max(axis=-1, initial=0.0) <= _STILL * whole


def _moves(curve: Curve, spans: Iterable[int], still: Array, steps: Array) -> Iterable[tuple[int, Array, Array, Array]]:
    """Key, start, end and difference of those of the spans whose ends differ."""
    if curve.kind is CurveKind.BOOLEAN:
        return
    values = np.asarray(curve.values, np.float64)
    for k in sorted({int(k) for k in spans}):
        if not 0 <= k < curve.key_count - 1:
            raise ShapeError(f"spans: expected numbers from 0 to {curve.key_count - 2}, got {k}")
        if not still[k] and curve.modes[k] != Interpolation.STEP:
            yield k, values[k], values[k + 1], steps[k]


def _swing(frequency_hz: float, damping: float, room_s: float) -> tuple[Array, Array, Array]:
    """Times from the arrival, places and speeds of a spring that first goes beyond by 1; the last is at rest at 0.

    Nothing where there is no room for one swing to the other side.
    """
    natural = 2 * pi * frequency_hz
    swing = natural * sqrt(1 - damping * damping)
    half = pi / swing
    if room_s < 1.2 * half:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    peak = atan2(swing, damping * natural) / swing  # when it turns for the first time
    start = natural * exp(damping * natural * peak)  # the speed whose first turn is at 1
    # Until a turn is below a twentieth of the first one, or as long as there is room.
    turns = ceil(log(20.0) / (damping * natural * half)) + 1
    if isfinite(room_s):
        turns = min(turns, int((0.95 * room_s) / half))
    times: list[float] = [0.0]
    for n in range(max(turns, 1)):
        times += [peak + n * half, (n + 1) * half]
    at = np.array(times)
    decay = np.exp(-damping * natural * at)
    places = start / swing * decay * np.sin(swing * at)
    speeds = start * decay * (np.cos(swing * at) - damping * natural / swing * np.sin(swing * at))
    # What is left of the swing at the last passage is below seeing, and stops there.
    places[0::2], speeds[1::2] = 0.0, 0.0
    speeds[-1] = 0.0
    return at, places, speeds


def _with_last_key(curve: Curve, time_s: float) -> Curve:
    """The curve with its last key once more, later."""

    def grown(name: str) -> Any:
        side = getattr(curve, name)
        return None if side is None else np.concatenate([side, 0 * np.asarray(side)[-1:]])

    sides = {n: grown(n) for n in ("in_tangents", "out_tangents", "in_handles", "out_handles", "tangent_types")}
    return replace(
        curve,
        times_s=np.append(curve.times_s, time_s),
        values=np.concatenate([curve.values, curve.values[-1:]]),
        modes=np.append(curve.modes, curve.modes[-1]),
        **sides,
    )


def _without_key(curve: Curve, key: int) -> Curve:
    def less(array: Any) -> Any:
        return None if array is None else np.delete(array, key, axis=0)

    names = ("times_s", "values", "modes", "in_tangents", "out_tangents", "in_handles", "out_handles", "tangent_types")
    return replace(curve, **{name: less(getattr(curve, name)) for name in names})
