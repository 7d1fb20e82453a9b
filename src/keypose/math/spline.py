"""Linear and Hermite interpolation of values (*B, C) by u (*B) in 0..1, exact at both keys.

A value that does not change between its keys is returned unchanged. u is used in the precision of the values; beyond
0..1 the same polynomial goes on.
"""

from __future__ import annotations

from typing import Any

from keypose.arrays import Array
from keypose.errors import ShapeError
from keypose.math.elementary import check_broadcast, convert, matched, take


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
