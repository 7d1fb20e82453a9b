"""Tangents that make a cubic Hermite curve go smoothly through keys (K, *G) at any increasing times (K,).

Values of any shape (K, *G) with at least one key; tangents have the same shape and are in units per second. What lies
outside the first and last key decides the tangents there (``ends``): "flat" starts and stops slowly, "chord" goes along the
first and last span, "parabola" takes the slope of the parabola through the three outer keys.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from keypose.arrays import Array, as_float, checked, namespace
from keypose.errors import ShapeError, UnknownName
from keypose.math.elementary import beside

Ends = Literal["flat", "chord", "parabola"]
Knots = Literal["time", "uniform", "chordal", "centripetal"]
Monotone = Literal["fritsch_carlson", "fritsch_butland", "steffen"]

_POWERS = {"uniform": 0.0, "chordal": 1.0, "centripetal": 0.5}


def central(values: Array, times_s: Any, ends: Ends = "chord") -> Array:
    """The chord from the previous key to the next, (v[k+1] - v[k-1]) / (t[k+1] - t[k-1]).

    Raises: ShapeError where shapes disagree or times do not increase; UnknownName for ends that do not exist.
    Source: lecture notes, Catmull-Rom (half of the sum of both chords, at equal distances).
    """
    xp, values, spans = _take(values, times_s, ends)
    if len(spans) == 0:
        return 0.0 * values
    inner = (values[2:, ...] - values[:-2, ...]) / (spans[1:, ...] + spans[:-1, ...])
    return _with_ends(xp, inner, _slopes(values, spans), spans, ends)


def catmull_rom(values: Array, times_s: Any, knots: Knots = "time", ends: Ends = "chord") -> tuple[Array, Array]:
    """Catmull-Rom tangents before and after every key, per second.

    The curve is that of Barry and Goldman's pyramid. With knots at the times of the keys both tangents are one. The other
    knots lie a power of the distance between two values (their last axis) apart: 0 for "uniform", 1/2 for "centripetal", 1
    for "chordal". Then the path is smooth and does not depend on the times, but its speed may change at a key.

    Raises: ShapeError where shapes disagree or times do not increase; UnknownName for knots or ends that do not exist.
    Source: Barry and Goldman, A recursive evaluation algorithm for a class of Catmull-Rom splines (SIGGRAPH 1988);
    Yuksel, Schaefer and Keyser, Parameterization and applications of Catmull-Rom curves (2011).
    """
    xp, values, spans = _take(values, times_s, ends)
    if knots != "time" and knots not in _POWERS:
        raise UnknownName("knots", str(knots), ("time", *_POWERS))
    if len(spans) == 0:
        return 0.0 * values, 0.0 * values
    steps = spans
    if knots != "time":
        d = values[1:, ...] - values[:-1, ...]
        squared = xp.sum(d * d, axis=-1, keepdims=True) if values.ndim > 1 else d * d
        still = squared == 0
        steps = xp.where(still, 0.0, xp.where(still, 1.0, squared) ** (0.5 * _POWERS[knots]))
    # Equal keys make a span without length: nothing moves in it, and beside it the curve goes along its chord.
    empty = steps == 0
    slopes = xp.where(empty, 0.0, (values[1:, ...] - values[:-1, ...]) / xp.where(empty, 1.0, steps))
    before, after = steps[:-1, ...], steps[1:, ...]
    total = before + after
    inner = (slopes[:-1, ...] * after + slopes[1:, ...] * before) / xp.where(total == 0, 1.0, total)
    inner = xp.where(before == 0, slopes[1:, ...], xp.where(after == 0, slopes[:-1, ...], inner))
    per_knot = _with_ends(xp, inner, slopes, xp.where(empty, 1.0, steps), ends)
    speed = steps / spans
    incoming = xp.concat([per_knot[:1, ...] * speed[:1, ...], per_knot[1:, ...] * speed], axis=0)
    outgoing = xp.concat([per_knot[:-1, ...] * speed, per_knot[-1:, ...] * speed[-1:, ...]], axis=0)
    return incoming, outgoing


def kochanek_bartels(
    values: Array, times_s: Any, tension: Any = 0.0, continuity: Any = 0.0, bias: Any = 0.0, ends: Ends = "chord"
) -> tuple[Array, Array]:
    """TCB tangents before and after every key, per second; parameters in -1..1, one for all or (K,) for each key.

    Zeros give `central`. Tension 1 stops at the keys, continuity other than 0 makes corners, bias shifts the weight from
    the chord after a key (-1) to the one before it (+1).

    Raises: ShapeError where shapes disagree or times do not increase; UnknownName for ends that do not exist.
    Source: Kochanek and Bartels, Interpolating splines with local tension, continuity, and bias control (SIGGRAPH 1984),
    equations 8, 9 and, for unequal times, 11 and 12.
    """
    xp, values, spans = _take(values, times_s, ends)
    count = values.shape[0]
    shape = (-1, *[1] * (values.ndim - 1))
    numbers: list[Array] = []
    for name, given in (("tension", tension), ("continuity", continuity), ("bias", bias)):
        array = np.asarray(given, np.float64)
        if array.shape not in ((), (count,)):
            raise ShapeError(f"{name}: expected a number or ({count},), got {array.shape}")
        numbers.append(beside(xp, np.broadcast_to(array, (count,)).copy().reshape(shape), values))
    if len(spans) == 0:
        return 0.0 * values, 0.0 * values
    t, c, b = numbers
    slopes = _slopes(values, spans)
    # A missing neighbour lies where the only chord, or the rule of the ends, points.
    middle = central(values, times_s, ends)
    first, last = 2.0 * middle[:1, ...] - slopes[:1, ...], 2.0 * middle[-1:, ...] - slopes[-1:, ...]
    before, after = xp.concat([first, slopes], axis=0), xp.concat([slopes, last], axis=0)
    h0 = xp.concat([spans[:1, ...], spans], axis=0)
    h1 = xp.concat([spans, spans[-1:, ...]], axis=0)
    back, ahead = before * h0, after * h1
    scale = (1.0 - t) / (h0 + h1)
    incoming = scale * ((1.0 - c) * (1.0 + b) * back + (1.0 + c) * (1.0 - b) * ahead)
    outgoing = scale * ((1.0 + c) * (1.0 + b) * back + (1.0 - c) * (1.0 - b) * ahead)
    return incoming, outgoing


def monotone(values: Array, times_s: Any, method: Monotone = "fritsch_carlson") -> Array:
    """Tangents of a curve that, in each component, never leaves the range of the two keys around it.

    "fritsch_carlson" shortens the tangents of `central` where both of a span leave the circle of radius 3;
    "fritsch_butland" (SciPy's PCHIP) takes a weighted harmonic mean; "steffen" a parabola, limited to twice the smaller chord.

    Raises: ShapeError where shapes disagree or times do not increase; UnknownName for a method that does not exist.
    Source: Fritsch and Carlson, Monotone piecewise cubic interpolation (1980); Fritsch and Butland (1984); Steffen, A simple
    method for monotonic interpolation in one dimension (1990).
    """
    xp, values, spans = _take(values, times_s, "chord")
    if method not in ("fritsch_carlson", "fritsch_butland", "steffen"):
        raise UnknownName("monotone method", str(method), ("fritsch_carlson", "fritsch_butland", "steffen"))
    if len(spans) == 0:
        return 0.0 * values
    slopes = _slopes(values, spans)
    if slopes.shape[0] == 1:
        return xp.concat([slopes, slopes], axis=0)
    s0, s1, h0, h1 = slopes[:-1, ...], slopes[1:, ...], spans[:-1, ...], spans[1:, ...]
    turn = (s0 * s1 <= 0) | (s0 == 0) | (s1 == 0)
    if method == "fritsch_carlson":
        tangents = xp.concat(
            [slopes[:1, ...], xp.where(turn, 0.0, (s0 * h0 + s1 * h1) / (h0 + h1)), slopes[-1:, ...]], axis=0
        )
        flat = slopes == 0
        safe = xp.where(flat, 1.0, slopes)
        a = xp.where(flat, 0.0, tangents[:-1, ...] / safe)
        b = xp.where(flat, 0.0, tangents[1:, ...] / safe)
        length = a * a + b * b
        # Each span asks for a share of the tangents at both its ends; the smaller share of a key's two spans holds.
        share = xp.where(flat, 0.0, xp.where(length > 9.0, 3.0 / xp.where(length > 9.0, length, 1.0) ** 0.5, 1.0))
        left = xp.concat([share[:1, ...], share], axis=0)
        right = xp.concat([share, share[-1:, ...]], axis=0)
        return tangents * xp.where(left < right, left, right)
    if method == "fritsch_butland":
        w0, w1 = 2.0 * h1 + h0, h1 + 2.0 * h0
        inner = (w0 + w1) / (w0 / xp.where(turn, 1.0, s0) + w1 / xp.where(turn, 1.0, s1))
        inner = xp.where(turn, 0.0, inner)
        first = _one_sided(xp, slopes[:1, ...], slopes[1:2, ...], spans[:1, ...], spans[1:2, ...], 3.0)
        last = _one_sided(xp, slopes[-1:, ...], slopes[-2:-1, ...], spans[-1:, ...], spans[-2:-1, ...], 3.0)
        return xp.concat([first, inner, last], axis=0)
    middle = xp.abs((s0 * h1 + s1 * h0) / (h0 + h1))
    limit = xp.where(xp.abs(s0) < xp.abs(s1), xp.abs(s0), xp.abs(s1))
    size = xp.where(0.5 * middle < limit, middle, 2.0 * limit)
    inner = xp.where(turn, 0.0, xp.sign(s0) * size)
    first = _one_sided(xp, slopes[:1, ...], slopes[1:2, ...], spans[:1, ...], spans[1:2, ...], 2.0)
    last = _one_sided(xp, slopes[-1:, ...], slopes[-2:-1, ...], spans[-1:, ...], spans[-2:-1, ...], 2.0)
    return xp.concat([first, inner, last], axis=0)


def natural(values: Array, times_s: Any) -> Array:
    """Tangents of the C2 cubic whose acceleration vanishes at both ends (SciPy's `CubicSpline` with ``natural``).

    Raises: ShapeError where shapes disagree or times do not increase.
    Source: the tridiagonal system of continuous second derivatives, solved by Thomas' elimination.
    """
    xp, values, spans = _take(values, times_s, "chord")
    if len(spans) == 0:
        return 0.0 * values
    slopes = _slopes(values, spans)
    count = values.shape[0]
    inverse = 1.0 / spans
    # Row k: m[k-1]/h0 + 2 (1/h0 + 1/h1) m[k] + m[k+1]/h1 = 3 (s0/h0 + s1/h1), with one side missing at the ends.
    diagonal = [2.0 * inverse[0, ...]]
    right = [3.0 * slopes[0, ...] * inverse[0, ...]]
    for k in range(1, count):
        own = 2.0 * (inverse[k - 1, ...] + inverse[k, ...]) if k < count - 1 else 2.0 * inverse[k - 1, ...]
        both = 3.0 * slopes[k - 1, ...] * inverse[k - 1, ...]
        if k < count - 1:
            both = both + 3.0 * slopes[k, ...] * inverse[k, ...]
        factor = inverse[k - 1, ...] / diagonal[k - 1]
        diagonal.append(own - factor * inverse[k - 1, ...])
        right.append(both - factor * right[k - 1])
    found = [right[-1] / diagonal[-1]]
    for k in range(count - 2, -1, -1):
        found.append((right[k] - inverse[k, ...] * found[-1]) / diagonal[k])
    return xp.stack(found[::-1], axis=0)


def _take(values: Array, times_s: Any, ends: str) -> tuple[Any, Array, Array]:
    """Namespace, values and the spans (K-1, *1) in their precision."""
    values = as_float(values)
    if values.ndim == 0 or values.shape[0] == 0:
        raise ShapeError(f"values: expected (K, *G) with one key or more, got {tuple(values.shape)}")
    times = np.asarray(times_s, np.float64)
    checked(times, (values.shape[0],), "times_s", "values")
    if not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0):
        raise ShapeError("times_s: expected finite, strictly increasing numbers")
    if ends not in ("flat", "chord", "parabola"):
        raise UnknownName("ends", str(ends), ("flat", "chord", "parabola"))
    xp = namespace(values)
    return xp, values, beside(xp, np.diff(times).reshape(-1, *[1] * (values.ndim - 1)), values)


def _slopes(values: Array, spans: Array) -> Array:
    return (values[1:, ...] - values[:-1, ...]) / spans


def _with_ends(xp: Any, inner: Array, slopes: Array, spans: Array, ends: str) -> Array:
    first, last = slopes[:1, ...], slopes[-1:, ...]
    if ends == "flat":
        first, last = 0.0 * first, 0.0 * last
    elif ends == "parabola" and slopes.shape[0] > 1:
        first = _parabola(slopes[:1, ...], slopes[1:2, ...], spans[:1, ...], spans[1:2, ...])
        last = _parabola(slopes[-1:, ...], slopes[-2:-1, ...], spans[-1:, ...], spans[-2:-1, ...])
    return xp.concat([first, inner, last], axis=0)


def _parabola(near: Array, far: Array, near_s: Array, far_s: Array) -> Array:
    return near + (near - far) * near_s / (near_s + far_s)


def _one_sided(xp: Any, near: Array, far: Array, near_s: Array, far_s: Array, limit: float) -> Array:
    """The parabola's slope at an end, but never against the first chord nor too steep for it."""
    slope = _parabola(near, far, near_s, far_s)
    # PCHIP lets the end be steep where the curve does not turn; Steffen limits it always.
    steep = xp.abs(slope) > limit * xp.abs(near)
    if limit == 3.0:
        steep = steep & (near * far <= 0)
    slope = xp.where(steep, limit * near, slope)
    return xp.where(slope * near <= 0, 0.0, slope)
