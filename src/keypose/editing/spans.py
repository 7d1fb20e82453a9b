"""What operators need of curves: differences of values of any kind, slopes at keys, and spans put in the place of others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.math import quat
from keypose.math import rotation_splines as splines
from keypose.model import Curve, CurveKind, Interpolation, Tangent

_SPLINES: dict[int, tuple[Any, splines.Method]] = {
    Interpolation.SQUAD: (splines.squad_controls, "squad"),
    Interpolation.SPHERICAL_BEZIER: (splines.spherical_bezier_controls, "spherical_bezier"),
    Interpolation.LOG_CUBIC: (splines.log_cubic_controls, "log_cubic"),
}


def difference(kind: CurveKind, a: Array, b: Array) -> Array:
    """What leads from value a to value b: b - a, for rotations the half-angle vector of the short way in a's frame."""
    if kind is CurveKind.ROTATION:
        return quat.log(quat.shortest(quat.multiply(quat.conjugate(a), b)))
    return b - a


def moved(kind: CurveKind, a: Array, step: Array) -> Array:
    """The value that a `difference` leads to from a."""
    return quat.multiply(a, quat.exp(step)) if kind is CurveKind.ROTATION else a + step


def tangent_of(kind: CurveKind, value: Array, rate: Array) -> Array:
    """The tangent per second of a rate of `difference` per second at a value."""
    if kind is not CurveKind.ROTATION:
        return rate
    rate = np.asarray(rate)
    return quat.multiply(value, np.concatenate([np.zeros_like(rate[..., :1]), rate], axis=-1))


def rate_of(kind: CurveKind, value: Array, tangent: Array) -> Array:
    """The rate of `difference` per second of a tangent per second: the opposite of `tangent_of`."""
    return quat.multiply(quat.conjugate(value), tangent)[..., 1:] if kind is CurveKind.ROTATION else tangent


def rates(curve: Curve) -> tuple[Array, Array]:
    """Rates (K, D) per second in which the curve leaves each key and comes to it; D is 3 for rotations, else C.

    They are those of the spans that lie there; beside a step, and beyond the first and the last key, the rate is 0.
    """
    kind, values, count = curve.kind, np.asarray(curve.values, np.float64), curve.key_count
    width = 3 if kind is CurveKind.ROTATION else values.shape[1]
    leaving, coming = np.zeros((count, width)), np.zeros((count, width))
    if count < 2:
        return leaving, coming
    spans = np.diff(curve.times_s)[:, None]
    modes = np.asarray(curve.modes[:-1])
    chord = difference(kind, values[:-1], values[1:])
    straight = chord / spans
    starts, ends = straight.copy(), straight.copy()
    starts[modes == Interpolation.STEP] = ends[modes == Interpolation.STEP] = 0
    hermite = modes == Interpolation.HERMITE
    if np.any(hermite) and curve.out_tangents is not None and curve.in_tangents is not None:
        starts[hermite] = rate_of(kind, values[:-1], np.asarray(curve.out_tangents[:-1], np.float64))[hermite]
        ends[hermite] = rate_of(kind, values[1:], np.asarray(curve.in_tangents[1:], np.float64))[hermite]
    bezier = modes == Interpolation.BEZIER
    if np.any(bezier) and curve.out_handles is not None and curve.in_handles is not None:
        out, back = np.asarray(curve.out_handles[:-1], np.float64), np.asarray(curve.in_handles[1:], np.float64)
        starts[bezier] = _handle_rates(out, straight)[bezier]
        ends[bezier] = _handle_rates(back, straight)[bezier]
    for mode, (controls, method) in _SPLINES.items():
        here = modes == mode
        if np.any(here):
            first, last = splines.end_velocities(controls(values, curve.times_s), spans[:, 0], method)
            starts[here], ends[here] = 0.5 * first[here], 0.5 * last[here]
    leaving[:-1], coming[1:] = starts, ends
    return leaving, coming


def _handle_rates(handles: Array, straight: Array) -> Array:
    seconds, value = handles[..., 0], handles[..., 1]
    upright = seconds == 0
    return np.where(upright, straight, value / np.where(upright, 1.0, seconds))


@dataclass(frozen=True, slots=True)
class Span:
    """What takes the place of one span: N keys between its ends, and how all N + 1 parts go.

    Shapes and units: ``times_s`` (N,), ``values`` (N, C); ``starts`` and ``ends`` (N + 1, C) tangents per second at the start
    and the end of each part, needed for HERMITE; ``out_handles`` and ``in_handles`` (N + 1, C, 2) likewise for BEZIER.
    """

    times_s: Array
    values: Array
    mode: Interpolation
    starts: Array | None = None
    ends: Array | None = None
    out_handles: Array | None = None
    in_handles: Array | None = None


def with_spans(curve: Curve, spans: Mapping[int, Span]) -> Curve:
    """The curve with spans, named by the key that starts them, replaced; its own keys stay, the rest is as it was.

    Rotations get signs so that neighbours are on the short side of each other.
    """
    if not spans:
        return curve
    order = sorted(spans)
    at = np.concatenate([np.full(len(spans[k].times_s), k + 1) for k in order]).astype(np.intp)

    def woven(old: Array, parts: list[Array]) -> Array:
        return np.insert(np.asarray(old, np.float64), at, np.concatenate(parts), axis=0) if len(at) else np.array(old)

    times = woven(curve.times_s, [np.asarray(spans[k].times_s, np.float64) for k in order])
    width = curve.values.shape[1]
    values = woven(curve.values, [np.asarray(spans[k].values, np.float64).reshape(-1, width) for k in order])
    old = np.arange(curve.key_count) + np.searchsorted(at, np.arange(curve.key_count), side="right")
    modes = np.zeros(len(times), np.uint8)
    modes[old] = curve.modes
    types = np.zeros((len(times), 2), np.uint8)
    if curve.tangent_types is not None:
        types[old] = curve.tangent_types
    sides: dict[str, Array | None] = {}
    for name, mode, shape in (
        ("in_tangents", Interpolation.HERMITE, values.shape),
        ("out_tangents", Interpolation.HERMITE, values.shape),
        ("in_handles", Interpolation.BEZIER, (*values.shape, 2)),
        ("out_handles", Interpolation.BEZIER, (*values.shape, 2)),
    ):
        given = getattr(curve, name)
        if given is None and not any(spans[k].mode == mode for k in order):
            sides[name] = None
            continue
        side = np.zeros(shape)
        if given is not None:
            side[old] = given
        sides[name] = side
    for k in order:
        span = spans[k]
        first, parts = int(old[k]), len(span.times_s) + 1
        here = slice(first, first + parts)
        after = slice(first + 1, first + 1 + parts)
        modes[here] = span.mode
        types[here, 1] = types[after, 0] = Tangent.FREE
        for name, given, where in (
            ("out_tangents", span.starts, here),
            ("in_tangents", span.ends, after),
            ("out_handles", span.out_handles, here),
            ("in_handles", span.in_handles, after),
        ):
            side = sides[name]
            if given is not None and side is not None:
                side[where] = given
    precision = np.asarray(curve.values).dtype
    return _aligned(
        replace(
            curve,
            times_s=times,
            values=values.astype(precision),
            modes=modes,
            tangent_types=types if curve.tangent_types is not None or np.any(types) else None,
            **{name: None if side is None else side.astype(precision) for name, side in sides.items()},
        )
    )


def hermite_spans(curve: Curve, spans: Array, leaving: Array, coming: Array) -> Curve:
    """The curve with spans (indices of the keys that start them) made smooth, with rates (K, D) per second at all keys' sides.

    ``leaving`` counts at the start of a span, ``coming`` at its end; keys stay (rotations get signs as `with_spans` gives).
    """
    spans = np.asarray(spans, np.intp)
    if len(spans) == 0:
        return curve
    curve = _aligned(curve)
    values = np.asarray(curve.values, np.float64)
    out, back = (
        np.zeros(values.shape) if side is None else np.array(side, np.float64)
        for side in (curve.out_tangents, curve.in_tangents)
    )
    out[spans] = tangent_of(curve.kind, values[spans], leaving[spans])
    back[spans + 1] = tangent_of(curve.kind, values[spans + 1], coming[spans + 1])
    modes = np.array(curve.modes)
    modes[spans] = Interpolation.HERMITE
    types = np.zeros((curve.key_count, 2), np.uint8) if curve.tangent_types is None else np.array(curve.tangent_types)
    types[spans, 1] = types[spans + 1, 0] = Tangent.FREE
    precision = np.asarray(curve.values).dtype
    return replace(
        curve,
        modes=modes,
        out_tangents=out.astype(precision),
        in_tangents=back.astype(precision),
        tangent_types=types if curve.tangent_types is not None else None,
    )


def _aligned(curve: Curve) -> Curve:
    """Signs of rotations, and of their tangents, with which neighbours lie on the short side of each other."""
    if curve.kind is not CurveKind.ROTATION:
        return curve
    values = quat.align_signs(curve.values)
    flipped = np.any(values != curve.values, axis=-1)
    if not np.any(flipped):
        return curve
    sign = np.where(flipped, -1.0, 1.0).astype(values.dtype)[:, None]
    tangents = {
        name: None if side is None else side * sign
        for name, side in (("in_tangents", curve.in_tangents), ("out_tangents", curve.out_tangents))
    }
    return replace(curve, values=values, **tangents)


def hermite_span(
    kind: CurveKind, times_s: Array, values: Array, start: Array, starts: Array, ends: Array, end: Array
) -> Span:
    """A span of smooth parts: N inner keys (N,) with values (N, C), and rates (N + 1, D) per second at the ends of the parts.

    ``start`` and ``end`` (C,) are the values of the keys that it lies between.
    """
    values = np.asarray(values, np.float64).reshape(len(times_s), len(start))
    begins = np.concatenate([np.asarray(start, np.float64)[None], values])
    finishes = np.concatenate([values, np.asarray(end, np.float64)[None]])
    if kind is CurveKind.ROTATION:
        # The last key may be stored with the other sign; its tangent goes with the sign that is nearer.
        finishes[-1] = quat.align_signs(np.stack([begins[-1], finishes[-1]]))[1]
        flip = -1.0 if np.dot(finishes[-1], end) < 0 else 1.0
    else:
        flip = 1.0
    out, back = tangent_of(kind, begins, np.asarray(starts)), tangent_of(kind, finishes, np.asarray(ends))
    back[-1] *= flip
    return Span(times_s, values, Interpolation.HERMITE, starts=out, ends=back)
