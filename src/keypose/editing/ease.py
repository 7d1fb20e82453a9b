"""Easings on spans of keys, exactly where a curve can be the easing, else by added keys with the error stated; time warps."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from math import ceil, log, pi, tan

import numpy as np

from keypose.arrays import Array
from keypose.editing.selection import Selection, chosen_channels, chosen_keys, chosen_spans, with_curves
from keypose.editing.spans import Span, difference, hermite_span, hermite_spans, moved, rates, tangent_of, with_spans
from keypose.errors import ShapeError
from keypose.math import quat, spline
from keypose.math.ease import Easing, easing
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation, Tangent

# Parts of a span are measured at so many places; a part is halved at most so often.
_PLACES = np.linspace(0.0, 1.0, 34)[1:-1]
_MOST_HALVINGS = 9


@dataclass(frozen=True, slots=True, eq=False)
class Eased:
    """A curve and the largest distance of its spans from the easing, in its own units (radians for rotations)."""

    curve: Curve
    error: float


def ease_spans(curve: Curve, spans: Iterable[int], name: str, tolerance: float = 1e-3) -> Eased:
    """The curve with spans, named by the key that starts each, going by an easing from one key's value to the next.

    Quadratic and cubic easings, back, bounce, smoothstep and CSS's curves and steps are exact; of the rest, and of all
    on rotations, keys are added until the error is within ``tolerance``, a share of the change over the span. (Circular
    easings of rotations, which would have to stand upright at an end, stop at about a hundredth.) Keys keep time and value.

    Raises: UnknownName for an easing that does not exist; ShapeError for spans that do not exist.
    """
    if not 0 < tolerance < 1:
        raise ShapeError(f"tolerance: expected a share between 0 and 1, got {tolerance}")
    shape = easing(name)
    chosen = sorted({int(k) for k in spans})
    if chosen and not 0 <= chosen[0] <= chosen[-1] < curve.key_count - 1:
        raise ShapeError(f"spans: expected numbers from 0 to {curve.key_count - 2}, got {chosen[0]} to {chosen[-1]}")
    if curve.kind is CurveKind.BOOLEAN:
        raise ShapeError("a boolean curve goes in steps and cannot be eased")
    made = {k: _span(curve, k, shape, tolerance) for k in chosen}
    error = max((error for _, error in made.values()), default=0.0)
    return Eased(with_spans(curve, {k: span for k, (span, _) in made.items()}), error)


def slow_in_out(curve: Curve, keys: Iterable[int], slow_in: float = 1.0, slow_out: float = 1.0) -> Curve:
    """The curve slowing down into keys and starting slowly from them: 1 is a stop, 0 leaves the speed as it is.

    "Slow in" is the arrival at a key, "slow out" the start from it. Spans in steps stay; the others become smooth
    ones with the speed they had at their other end.

    Raises: ShapeError where an amount is not in 0..1.
    Source: lecture notes, Keyframing: zero tangents give slow in, slow out.
    """
    for label, amount in (("slow_in", slow_in), ("slow_out", slow_out)):
        if not 0 <= amount <= 1:
            raise ShapeError(f"{label}: expected 0..1, got {amount}")
    leaving, coming = rates(curve)
    chosen = np.zeros(curve.key_count, bool)
    chosen[list(keys)] = True
    leaving[chosen] *= 1.0 - slow_out
    coming[chosen] *= 1.0 - slow_in
    if curve.kind is CurveKind.BOOLEAN or not np.any(chosen):
        return curve
    modes = np.asarray(curve.modes[:-1])
    result = hermite_spans(
        curve, np.nonzero((chosen[:-1] | chosen[1:]) & (modes != Interpolation.STEP))[0], leaving, coming
    )
    types = np.zeros((curve.key_count, 2), np.uint8) if result.tangent_types is None else np.array(result.tangent_types)
    for side, rate in enumerate((coming, leaving)):
        types[chosen & np.all(rate == 0, axis=-1), side] = Tangent.FLAT
    return replace(result, tangent_types=types)


def ease_clip(clip: Clip, selection: Selection, name: str, tolerance: float = 1e-3) -> tuple[Clip, float]:
    """The clip with an easing on every chosen span, and the largest error as a share of a span's change is kept below.

    Returns the clip and the largest error in the units of the curve that has it.
    """
    made: dict[Channel, Curve] = {}
    largest = 0.0
    for channel in chosen_channels(clip, selection):
        curve = clip.curves[channel]
        if curve.kind is CurveKind.BOOLEAN:
            continue
        eased = ease_spans(curve, chosen_spans(channel, curve, selection).tolist(), name, tolerance)
        made[channel], largest = eased.curve, max(largest, eased.error)
    return with_curves(clip, made), largest


def slow_clip(clip: Clip, selection: Selection, slow_in: float, slow_out: float) -> Clip:
    """`slow_in_out` at the chosen keys of a clip."""
    return with_curves(
        clip,
        {
            c: slow_in_out(clip.curves[c], chosen_keys(c, clip.curves[c], selection).tolist(), slow_in, slow_out)
            for c in chosen_channels(clip, selection)
        },
    )


def ease_warp(
    name: str, start_s: float, end_s: float, from_s: float = 0.0, to_s: float | None = None, tolerance: float = 1e-3
) -> Curve:
    """A time warp: a scalar curve that goes from time ``from_s`` to ``to_s`` by an easing while start_s to end_s pass.

    ``to_s`` is ``from_s`` plus the time that passes where it is not given. For the ``time_warp`` of a `Placement`.
    """
    until = from_s + end_s - start_s if to_s is None else to_s
    straight = Curve([start_s, end_s], [[from_s], [until]], kind=CurveKind.SCALAR)
    return ease_spans(straight, [0], name, tolerance).curve


# --- an easing as spans -----------------------------------------------------------------------------------------------------


def _span(curve: Curve, k: int, shape: Easing, tolerance: float) -> tuple[Span, float]:
    """One span by an easing, and its error in the curve's units."""
    start, end = np.asarray(curve.values[k], np.float64), np.asarray(curve.values[k + 1], np.float64)
    begin_s, span_s = float(curve.times_s[k]), float(curve.times_s[k + 1] - curve.times_s[k])
    step = difference(curve.kind, start, end)
    size = float(np.linalg.norm(step)) * (2.0 if curve.kind is CurveKind.ROTATION else 1.0)
    if shape.steps:
        at = np.array([p.start for p in shape.pieces[1:]])
        levels = shape(at)
        if shape(0.0) != 0.0:
            # A jump at the start would move the key itself; the stairs begin a moment later.
            at, levels = np.concatenate([[1e-6], at]), np.concatenate([[shape(0.0)], levels])
        values = moved(curve.kind, start, levels[:, None] * step)
        return Span(begin_s + span_s * at, values, Interpolation.STEP), 0.0
    if shape.name == "linear":
        return Span(np.zeros(0), np.zeros((0, len(start))), Interpolation.LINEAR), 0.0
    if curve.kind is not CurveKind.ROTATION and (shape.handles or shape.name.startswith("circ")):
        u, y, out, back = _handles(shape, tolerance)
        return (
            Span(
                begin_s + span_s * u[1:-1],
                start + y[1:-1, None] * step,
                Interpolation.BEZIER,
                out_handles=_placed(out, span_s, step),
                in_handles=_placed(back, span_s, step),
            ),
            size * _bezier_error(shape, u, y, out, back),
        )
    u, y, begins, ends, error = _parts(shape, tolerance, _rounded_up(step) if curve.kind is CurveKind.ROTATION else 0.0)
    values = moved(curve.kind, start, y[1:-1, None] * step)
    rate = step / span_s
    begins, ends = begins[:, None] * rate, ends[:, None] * rate
    return hermite_span(curve.kind, begin_s + span_s * u[1:-1], values, start, begins, ends, end), size * error


def _placed(handles: Array, span_s: float, step: Array) -> Array:
    """Handles (N, 2) in shares of time and change as (N, C, 2) in seconds and value."""
    seconds = np.broadcast_to(handles[:, None, 0] * span_s, (len(handles), len(step)))
    return np.stack([seconds, handles[:, None, 1] * step], axis=-1)


def _handles(shape: Easing, tolerance: float) -> tuple[Array, Array, Array, Array]:
    """Knots u, y and the handles out and in (N, 2) of an easing that is made of Bezier curves."""
    if shape.handles:
        x1, y1, x2, y2 = shape.handles
        return (
            np.array([0.0, 1.0]),
            np.array([0.0, 1.0]),
            np.array([[x1, y1]]),
            np.array([[x2 - 1.0, y2 - 1.0]]),
        )
    # A circle's quarter in as many arcs as it takes: an arc by angle a misses the circle by about a^6 / 45,000.
    parts = 1 if tolerance > 3e-4 else 2 if tolerance > 5e-6 else 4
    angle = np.linspace(0.0, pi / 2, parts + 1)
    length = 4 / 3 * tan(pi / 8 / parts)
    points = np.stack([np.sin(angle), 1 - np.cos(angle)], axis=-1)
    along = length * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    out, back = along[:-1], -along[1:]
    if shape.name == "circ_out":
        points, out, back = 1.0 - points[::-1], -back[::-1], -out[::-1]
    elif shape.name == "circ_in_out":
        points = np.concatenate([0.5 * points, 1.0 - 0.5 * points[-2::-1]])
        out, back = 0.5 * np.concatenate([out, -back[::-1]]), 0.5 * np.concatenate([back, -out[::-1]])
    return points[:, 0], points[:, 1], out, back


def _bezier_error(shape: Easing, u: Array, y: Array, out: Array, back: Array) -> float:
    if shape.handles:
        return 0.0
    s = _PLACES[:, None]
    v = 1 - s

    def component(a: Array, b: Array, c: Array, d: Array) -> Array:
        return v**3 * a + 3 * s * v * v * (a + b) + 3 * s * s * v * (d + c) + s**3 * d

    x = component(u[:-1], out[:, 0], back[:, 0], u[1:])
    return float(np.abs(component(y[:-1], out[:, 1], back[:, 1], y[1:]) - shape(x)).max())


def _rounded_up(turn: Array) -> float:
    """Half the angle of a turn, rounded up by at most a tenth, so that turns of about one size share their parts."""
    size = float(np.linalg.norm(turn))
    return 1.1 ** ceil(log(max(size, 1e-4), 1.1))


@lru_cache(maxsize=1024)
def _parts(shape: Easing, tolerance: float, half_turn: float) -> tuple[Array, Array, Array, Array, float]:
    """Places u, values there, slopes at both ends of each part, and the error of cubics with them, as a share of the change.

    A part is halved until the cubic follows the easing within the tolerance. Of rotations the cubic is one of quaternions, and
    how well it follows depends on the angle of the whole turn; ``half_turn`` is half of it in radians, 0 for other values.
    """
    turn = np.array([half_turn, 0.0, 0.0])
    edges = [*(p.start for p in shape.pieces), 1.0]
    todo = [(a, b, 0) for a, b in pairwise(edges)]
    done: dict[float, tuple[float, float, float, float]] = {}
    largest = 0.0
    while todo:
        a, b, depth = todo.pop()
        u = np.array([a, b])
        y = np.where(u >= 1, 1.0, shape(u))
        steepest = 3.0 * abs(float(y[1] - y[0])) / (b - a)  # where the easing stands upright
        slopes = [float(shape.slope(u[0])), float(shape.slope(u[1], from_left=True))]
        begin, end = (float(np.clip(s, -steepest, steepest)) if np.isinf(s) else s for s in slopes)
        wanted = shape(a + _PLACES * (b - a))
        if half_turn == 0:
            found = spline.hermite(y[:1], [begin], y[1:], [end], _PLACES, b - a)[:, 0]
            error = float(np.abs(found - wanted).max())
        else:
            # The turns that share these parts are up to a tenth smaller.
            error = max(_rotation_error(t, y, (begin, end), wanted, b - a) for t in (turn, turn / 1.1))
        if depth < _MOST_HALVINGS and error > tolerance:
            middle = 0.5 * (a + b)
            todo += [(a, middle, depth + 1), (middle, b, depth + 1)]
        else:
            done[a] = float(y[0]), begin, end, error
            largest = max(largest, error if error > 1e-12 else 0.0)
    starts = sorted(done)
    table = np.array([done[a] for a in starts])
    return np.array([*starts, 1.0]), np.append(table[:, 0], 1.0), table[:, 1], table[:, 2], largest


def _rotation_error(turn: Array, y: Array, slopes: tuple[float, float], wanted: Array, part: float) -> float:
    """The largest angle between an eased turn and the cubic of quaternions that stands for it, as a share of the turn."""
    keys = quat.exp(y[:, None] * turn)
    tangents = [tangent_of(CurveKind.ROTATION, key, slope * turn) for key, slope in zip(keys, slopes, strict=True)]
    found = quat.normalize(spline.hermite(keys[0], tangents[0], keys[1], tangents[1], _PLACES, part))
    size = max(2.0 * float(np.linalg.norm(turn)), 1e-12)
    return float(quat.angle_between(found, quat.exp(wanted[:, None] * turn)).max()) / size
