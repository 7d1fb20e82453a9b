"""Linear, Hermite and Bezier interpolation of values (*B, C) by u (*B) in 0..1, exact at both keys, and conversions.

A value that does not change between its keys is returned unchanged. u is used in the precision of the values; beyond
0..1 the same polynomial goes on.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import ShapeError
from keypose.math.elementary import beside, check_broadcast, constant, convert, matched, take


def parameter(time_s: Array, start_s: Array, end_s: Array) -> Array:
    """Where a time lies in its span: u = (t - t0) / (t1 - t0), (*B); a span of no length is at its end, u = 1.

    Source: lecture notes, Keyframes.
    """
    xp, t, start, end = take(time_s=(time_s, ()), start_s=(start_s, ()), end_s=(end_s, ()))
    empty = end == start
    return xp.where(empty, 1.0, (t - start) / xp.where(empty, 1.0, end - start))


def lerp(a: Array, b: Array, u: Array) -> Array:
    """(1 - u) a + u b, (*B, C), exactly a at u = 0 and b at u = 1; u is (*B).

    Source: lecture notes, Keyframes.
    """
    xp, (a, b), (u,) = _take({"a": a, "b": b}, {"u": u})
    d = b - a
    return xp.where(u < 0.5, a + u * d, b - (1.0 - u) * d)


def hermite(p0: Array, m0: Array, p1: Array, m1: Array, u: Array, span_s: Array) -> Array:
    """The cubic from p0 to p1 (*B, C) with tangents m0, m1 (*B, C) in units per second, at u (*B) of a span of span_s (*B).

    Exactly p0 at u = 0 and p1 at u = 1; a span of 0 seconds leaves the tangents without effect.
    Source: lecture notes, Hermite curves; glTF 2.0, appendix C (cubic spline), which scales tangents by the span alike.
    """
    xp, (p0, m0, p1, m1), (u, span) = _take({"p0": p0, "m0": m0, "p1": p1, "m1": m1}, {"u": u, "span_s": span_s})
    v = 1.0 - u
    d = p1 - p0
    bend = span * (u * v) * (v * m0 - u * m1)
    # The two blending functions of the end points sum to 1; the nearer point carries the curve.
    return bend + xp.where(u < 0.5, p0 + (u * u * (3.0 - 2.0 * u)) * d, p1 - (v * v * (3.0 - 2.0 * v)) * d)


def hermite_derivative(p0: Array, m0: Array, p1: Array, m1: Array, u: Array, span_s: Array) -> Array:
    """The velocity of `hermite` in units per second, (*B, C): m0 at u = 0 and m1 at u = 1.

    In a span of 0 seconds the jump from p0 to p1 has no velocity; it is left out.
    """
    xp, (p0, m0, p1, m1), (u, span) = _take({"p0": p0, "m0": m0, "p1": p1, "m1": m1}, {"u": u, "span_s": span_s})
    v = 1.0 - u
    empty = span == 0
    slope = xp.where(empty, 0.0, (p1 - p0) / xp.where(empty, 1.0, span))
    return 6.0 * (u * v) * slope + (v * (1.0 - 3.0 * u)) * m0 + (u * (1.0 - 3.0 * v)) * m1


# --- Bezier -----------------------------------------------------------------------------------------------------------


def bezier(p0: Array, p1: Array, p2: Array, p3: Array, u: Array) -> Array:
    """The cubic Bezier curve of control points (*B, C) at u (*B), as a polynomial; exactly p0 at u = 0 and p3 at u = 1.

    Source: lecture notes, Bezier curves: (1-u)^3 p0 + 3u(1-u)^2 p1 + 3u^2(1-u) p2 + u^3 p3.
    """
    _, (p0, p1, p2, p3), (u,) = _take({"p0": p0, "p1": p1, "p2": p2, "p3": p3}, {"u": u})
    v = 1.0 - u
    return (v * v * v) * p0 + (3.0 * u * v * v) * p1 + (3.0 * u * u * v) * p2 + (u * u * u) * p3


def bezier_derivative(p0: Array, p1: Array, p2: Array, p3: Array, u: Array) -> Array:
    """The derivative of `bezier` by u, (*B, C)."""
    _, (p0, p1, p2, p3), (u,) = _take({"p0": p0, "p1": p1, "p2": p2, "p3": p3}, {"u": u})
    v = 1.0 - u
    return 3.0 * ((v * v) * (p1 - p0) + (2.0 * u * v) * (p2 - p1) + (u * u) * (p3 - p2))


def de_casteljau(points: Array, u: Array) -> Array:
    """The Bezier curve of any degree with control points (*B, N, C) at u (*B), by repeated interpolation, (*B, C).

    Source: lecture notes, Bezier curves (De Casteljau's construction).
    """
    xp, points, u = convert(points=points, u=u)
    if points.ndim < 2 or points.shape[-2] == 0:
        raise ShapeError(f"points: expected (*B, N, C) with N of 1 or more, got {tuple(points.shape)}")
    check_broadcast({"points": tuple(points.shape[:-2]), "u": tuple(u.shape)})
    u = matched(xp, u, points)[..., None, None]
    points = points + 0.0 * u
    while points.shape[-2] > 1:
        a, b = points[..., :-1, :], points[..., 1:, :]
        points = a + u * (b - a)
    return points[..., 0, :]


def split_bezier(p0: Array, p1: Array, p2: Array, p3: Array, u: Array) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Control points (*B, C) of the two cubics that together are the cubic of p0 to p3: from 0 to u, and from u to 1.

    Source: De Casteljau; the two outer sides of his triangle.
    """
    _, (p0, p1, p2, p3), (u,) = _take({"p0": p0, "p1": p1, "p2": p2, "p3": p3}, {"u": u})
    a, b, c = p0 + u * (p1 - p0), p1 + u * (p2 - p1), p2 + u * (p3 - p2)
    d, e = a + u * (b - a), b + u * (c - b)
    middle = d + u * (e - d)
    return (p0, a, d, middle), (middle, e, c, p3)


def bezier_parameter(first: Array, last: Array, share: Array) -> Array:
    """u (*B) in 0..1 where the cubic of 0, first, last, 1 (all in 0..1, so that it never runs back) reaches share (*B).

    Newton's method from the nearer end, in a bracket that the size of the three terms gives; where a step would leave it,
    the bracket is halved. No gradients flow.
    """
    xp, a, b, x = take(first=(first, ()), last=(last, ()), share=(share, ()))
    far = x > (3.0 * a + 3.0 * b + 1.0) / 8.0  # beyond the middle, u = 1/2
    a, b, x = xp.where(far, 1.0 - b, a), xp.where(far, 1.0 - a, b), xp.where(far, 1.0 - x, x)
    c1, c2, c3 = 3.0 * a, 3.0 * (b - 2.0 * a), 1.0 - 3.0 * b + 3.0 * a
    # x is 3a u v^2 + 3b u^2 v + u^3 with v in 1/2..1: no term is more than x, one is a third of it or more.
    tiny = 1e-30
    safe_a, safe_b = xp.where(a > tiny, a, 1.0), xp.where(b > tiny, b, 1.0)
    linear = xp.where(a > tiny, x / safe_a, 1e30)
    square = xp.where(b > tiny, (x / safe_b) ** 0.5, 1e15)
    third = x ** (1.0 / 3.0)
    low = _least(xp, linear / 9.0, square / 3.0, third * 0.69) * 0.999
    high = _least(xp, linear / 0.75, square * 0.82, third * 1.001)
    high = xp.where(high < 0.5, high, 0.5)
    low = xp.where(low < high, low, high)
    u = low
    eager = isinstance(u, (np.ndarray, np.generic))
    for _ in range(_MOST_STEPS):
        error = ((c3 * u + c2) * u + c1) * u - x
        above = error > 0
        high, low = xp.where(above, u, high), xp.where(above, low, u)
        slope = (3.0 * c3 * u + 2.0 * c2) * u + c1
        step = error / xp.where(slope > 0, slope, 1.0)
        moved = u - step
        moved = xp.where((slope > 0) & (moved >= low) & (moved <= high), moved, 0.5 * (low + high))
        if eager and np.all(np.abs(moved - u) <= 4e-16 * u):
            u = moved
            break
        u = moved
    u = xp.where(far, 1.0 - u, u)
    return xp.where(share <= 0, 0.0 * u, xp.where(share >= 1, 0.0 * u + 1.0, u))


def weighted_bezier(p0: Array, out_handle: Array, p1: Array, in_handle: Array, share: Array, span_s: Array) -> Array:
    """Values (*B, C) at the share (*B) of a span of span_s (*B) seconds between p0 and p1 (*B, C), each component by itself.

    Handles (*B, C, 2) are seconds and value from the key to its handle, >= 0 after p0 and <= 0 before p1; one that is longer
    than the span is shortened to it in its own direction. Gradients flow to values and handles.
    Raises: ShapeError where shapes disagree.
    """
    xp, p0, p1, out, back, s, span = convert(
        p0=p0, p1=p1, out_handle=out_handle, in_handle=in_handle, share=share, span_s=span_s
    )
    for name, handle in (("out_handle", out), ("in_handle", back)):
        if handle.ndim < 2 or handle.shape[-1] != 2 or handle.shape[-2] != p0.shape[-1]:
            raise ShapeError(f"{name}: expected (*B, {p0.shape[-1]}, 2), got {tuple(handle.shape)}")
    span, s = matched(xp, span, p0)[..., None], matched(xp, s, p0)[..., None]
    safe = xp.where(span > 0, span, 1.0)
    (a, e0), (b, e1) = _shortened(xp, out, safe), _shortened(xp, -back, safe)
    a, b = a / safe, 1.0 - b / safe
    plain = isinstance(p0, np.ndarray)
    # What is to be solved for time keeps double precision: near an upright handle little time is much of the curve.
    exact = (np.asarray(a, np.float64), np.asarray(b, np.float64), np.asarray(s, np.float64)) if plain else (a, b, s)
    u = matched(xp, bezier_parameter(*(constant(x) for x in exact)), p0)
    if not plain:
        # One step of Newton's method from the solution moves nothing, but carries the handles' gradients.
        v, fixed_a, fixed_b = 1.0 - u, constant(a), constant(b)
        slope = 3.0 * (v * v * fixed_a + 2.0 * u * v * (fixed_b - fixed_a) + u * u * (1.0 - fixed_b))
        change = 3.0 * u * v * (v * (a - fixed_a) + u * (b - fixed_b))
        u = u - xp.where(slope > 0, change / xp.where(slope > 0, slope, 1.0), 0.0 * change)
    v = 1.0 - u
    d = p1 - p0
    bend = 3.0 * u * v * (v * e0 - u * e1)
    return bend + xp.where(u < 0.5, p0 + (u * u * (3.0 - 2.0 * u)) * d, p1 - (v * v * (3.0 - 2.0 * v)) * d)


_MOST_STEPS = 40


def _least(xp: Any, *arrays: Array) -> Array:
    found = arrays[0]
    for array in arrays[1:]:
        found = xp.where(array < found, array, found)
    return found


def _shortened(xp: Any, handle: Array, span: Array) -> tuple[Array, Array]:
    """Seconds and value of handles (*B, C, 2) that point into a span, no longer than it."""
    seconds, value = handle[..., 0], handle[..., 1]
    long = seconds > span
    share = xp.where(long, span / xp.where(long, seconds, 1.0), 1.0)
    return xp.where(long, span + 0.0 * seconds, seconds), value * share


# --- conversions ------------------------------------------------------------------------------------------------------


def bezier_from_hermite(p0: Array, m0: Array, p1: Array, m1: Array, span_s: Array) -> tuple[Array, Array]:
    """The inner control points (*B, C) of the cubic with tangents m0, m1 in units per second; the outer ones are p0 and p1.

    Source: lecture notes, Bezier and Hermite: b1 = p0 + m0 span / 3, b2 = p1 - m1 span / 3.
    """
    _, (p0, m0, p1, m1), (span,) = _take({"p0": p0, "m0": m0, "p1": p1, "m1": m1}, {"span_s": span_s})
    return p0 + (span / 3.0) * m0, p1 - (span / 3.0) * m1


def hermite_from_bezier(p0: Array, p1: Array, p2: Array, p3: Array, span_s: Array) -> tuple[Array, Array]:
    """The tangents (*B, C) in units per second of the cubic with these control points over a span of span_s (*B) seconds.

    Source: lecture notes, Bezier and Hermite: m0 = 3 (b1 - b0), m1 = 3 (b3 - b2), here per second.
    """
    _, (p0, p1, p2, p3), (span,) = _take({"p0": p0, "p1": p1, "p2": p2, "p3": p3}, {"span_s": span_s})
    return 3.0 * (p1 - p0) / span, 3.0 * (p3 - p2) / span


def hermite_from_weighted(
    p0: Array, out_handle: Array, p1: Array, in_handle: Array, span_s: Array
) -> tuple[Array, Array, Array]:
    """The tangents (*B, C) per second that come nearest to a span with weighted handles, and the largest distance (*B, C).

    Exact (a distance of rounding) where both handles have a third of the span. Elsewhere the slopes at both keys are kept
    where they are finite, so that neighbouring spans still join smoothly; an upright handle counts as if it reached a third of
    the span. The distance is the largest at 65 even times.
    """
    xp, p0, p1, out, back, span = convert(p0=p0, p1=p1, out_handle=out_handle, in_handle=in_handle, span_s=span_s)
    span = matched(xp, span, p0)[..., None]
    tangents: list[Array] = []
    for seconds, value in (_shortened(xp, out, span), _shortened(xp, -back, span)):
        upright = seconds < 1e-6 * span
        slope = xp.where(upright, 3.0 * value / span, value / xp.where(upright, 1.0, seconds))
        tangents.append(slope)
    m0, m1 = tangents
    shares = beside(xp, np.linspace(0, 1, 65), p0)
    shape = (65, *[1] * (p0.ndim - 1))
    u = xp.reshape(shares, shape)
    want = weighted_bezier(p0[None, ...], out[None, ...], p1[None, ...], back[None, ...], u, span[None, ..., 0])
    have = hermite(p0[None, ...], m0[None, ...], p1[None, ...], m1[None, ...], u, span[None, ..., 0])
    return m0, m1, xp.max(xp.abs(want - have), axis=0)


def _take(values: dict[str, Array], parameters: dict[str, Array]) -> tuple[Any, tuple[Array, ...], tuple[Array, ...]]:
    """Values (*B, C), and parameters (*B) in their precision with an axis added for the components."""
    xp, *arrays = convert(**values, **parameters)
    count = len(values)
    for name, array in zip(values, arrays, strict=False):
        if array.ndim == 0:
            raise ShapeError(f"{name}: expected values (*B, C), got a number; give a scalar curve one component")
    shapes = [tuple(a.shape) for a in arrays]
    batches = [s[:-1] for s in shapes[:count]] + shapes[count:]
    check_broadcast(dict(zip([*values, *parameters], batches, strict=True)))
    check_broadcast({f"components of {name}": shape[-1:] for name, shape in zip(values, shapes, strict=False)})
    return xp, tuple(arrays[:count]), tuple(matched(xp, p, arrays[0])[..., None] for p in arrays[count:])
