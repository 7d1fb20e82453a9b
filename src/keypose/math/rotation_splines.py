"""Smooth curves through unit quaternions (K, *G, 4) at any increasing times: squad, Shoemake's Bezier, the cubic in log space.

Every span from a key to the next is written in the frame of its first key by three half-angle vectors, ``controls``
(K-1, *G, 3, 3): what leads to the outer control of the first key, what leads to the next key (the short way), and what leads
from the next key to its own control. `squad_controls`, `spherical_bezier_controls` and `log_cubic_controls` compute them once;
`squad`, `spherical_bezier` and `log_cubic` evaluate any number of places. At u = 0 the result is the key itself, bit for bit,
and at u = 1 the next one (or its negative, the same rotation) to rounding.

All three keep the angular velocity continuous over keys, whatever their times; the cubic in log space keeps the angular
acceleration continuous, too. At the first and the last key the velocity is that of slerp along the first and last span. Two
keys alone are joined as slerp joins them. No velocity at a key of squad or Bezier is above one turn in the longer span beside it.
"""

from __future__ import annotations

from math import pi
from typing import Any, Literal

import numpy as np

from keypose.arrays import Array, checked, gather
from keypose.errors import ShapeError, UnknownName
from keypose.math import quat
from keypose.math.elementary import (
    beside,
    cos_sinc,
    cross,
    dot,
    eps,
    join,
    matched,
    norm,
    parts,
    scaled,
    sinc_slope,
    take,
)

Method = Literal["squad", "spherical_bezier", "log_cubic"]


# --- squad -----------------------------------------------------------------------------------------------------------


def squad_controls(values: Array, times_s: Array) -> Array:
    """Controls of squad through keys (K, *G, 4) at times (K,), (K-1, *G, 3, 3).

    At a key the angular velocity is that of the parabola through the key and its neighbours in the key's tangent space; at
    equal distances the inner quadrangle points are Shoemake's q exp(-(log(q^-1 next) + log(q^-1 previous)) / 4).

    Raises: ShapeError where shapes disagree or times do not increase.
    Source: Shoemake, Quaternion calculus and fast animation (SIGGRAPH course notes, 1987).
    """
    xp, chords, spans = _chords(values, times_s)
    rates = _inner(xp, chords, spans, lambda a, b, share: share * a + (1.0 - share) * b)
    outgoing = 0.5 * (spans * rates[:-1, ...] - chords)
    incoming = 0.5 * (chords - spans * rates[1:, ...])
    return xp.stack([outgoing, chords, incoming], axis=-2)


def squad(start: Array, controls: Array, u: Array) -> Array:
    """Spherical quadrangle interpolation from keys (*B, 4) with controls (*B, 3, 3) at u (*B), (*B, 4)."""
    xp, start, controls, u = _take_span(start, controls, u)
    outgoing, chord, incoming = _split(controls)
    to = quat.exp(chord)
    side = scaled(xp, u, chord)
    inner = _arc(xp, quat.exp(outgoing), quat.multiply(to, quat.exp(incoming)), u)
    return _leave(xp, start, _arc(xp, quat.exp(side), inner, 2.0 * u * (1.0 - u)), u)


# --- Shoemake's Bezier curves ------------------------------------------------------------------------------------------


def spherical_bezier_controls(values: Array, times_s: Array) -> Array:
    """Controls of Bezier curves on the sphere through keys (K, *G, 4) at times (K,), (K-1, *G, 3, 3).

    The previous key is doubled over the key and bisected with the next one; a third of the way there is the control of the
    span that starts, and as far on the opposite side the one of the span that ends. At unequal times both neighbours are
    first brought to the shorter of the two distances, and the bisection is weighted by the times.

    Raises: ShapeError where shapes disagree or times do not increase.
    Source: Shoemake, Animating Rotation with Quaternion Curves (SIGGRAPH 1985), section 4.3: Double and Bisect.
    """
    xp, chords, spans = _chords(values, times_s)

    def rate(a: Array, b: Array, share: Array) -> Array:
        # Doubled, the previous key lies as far behind the key as it lay before it.
        before, after = spans[:-1, ...], spans[1:, ...]
        step = xp.where(before < after, before, after)
        mirrored, following = quat.exp(step * a), quat.exp(step * b)
        return quat.log(_arc(xp, mirrored, following, (1.0 - share)[..., 0])) / step

    rates = _inner(xp, chords, spans, rate)
    third = spans / 3.0
    return xp.stack([third * rates[:-1, ...], chords, -third * rates[1:, ...]], axis=-2)


def spherical_bezier(start: Array, controls: Array, u: Array) -> Array:
    """De Casteljau's construction with arcs in place of lines, from keys (*B, 4) at u (*B), (*B, 4).

    Source: Shoemake (SIGGRAPH 1985); lecture notes, Rotations.
    """
    xp, start, controls, u = _take_span(start, controls, u)
    outgoing, chord, incoming = _split(controls)
    to = quat.exp(chord)
    inner, last = quat.exp(outgoing), quat.multiply(to, quat.exp(incoming))
    first = quat.exp(scaled(xp, u, outgoing))
    middle, third = _arc(xp, inner, last, u), _arc(xp, last, to, u)
    return _leave(xp, start, _arc(xp, _arc(xp, first, middle, u), _arc(xp, middle, third, u), u), u)


def controls_of(values: Array, outgoing: Array, incoming: Array) -> Array:
    """Controls (K-1, *G, 3, 3) of `squad` or `spherical_bezier` with given inner points (K-1, *G, 4) of every span.

    ``outgoing`` are the control points after the key that starts a span, ``incoming`` those before the key that ends it.
    Of each point and its negative the nearer to its key is meant.
    """
    xp, values, outgoing, incoming = take(values=(values, (4,)), outgoing=(outgoing, (4,)), incoming=(incoming, (4,)))
    shape = (values.shape[0] - 1, *values.shape[1:])
    checked(outgoing, shape, "outgoing", "spans of values")
    checked(incoming, shape, "incoming", "spans of values")
    chords = _log_between(values[:-1, ...], values[1:, ...])
    out, back = _log_between(values[:-1, ...], outgoing), _log_between(values[1:, ...], incoming)
    return xp.stack([out, chords, back], axis=-2)


def control_points(values: Array, controls: Array) -> tuple[Array, Array]:
    """The inner points (K-1, *G, 4) after the first and before the second key of every span: the opposite of `controls_of`."""
    outgoing, _, incoming = _split(controls)
    return quat.multiply(values[:-1, ...], quat.exp(outgoing)), quat.multiply(values[1:, ...], quat.exp(incoming))


# --- cubic in the logarithm -----------------------------------------------------------------------------------------------


def log_cubic_controls(values: Array, times_s: Array) -> Array:
    """Controls of cubics in log space through keys (K, *G, 4) at times (K,), (K-1, *G, 3, 3), that join with one acceleration.

    The rotation vector of each span, from its first key, is a cubic of time; the angular velocities at the inner keys are
    those for which the angular accelerations of both sides agree. They solve a block-tridiagonal system with a small
    quadratic part, found by Newton's method; where that does not converge (spans near half a turn in very unequal
    times) the best velocities found are taken, and the acceleration jumps a little there. Backwards in time the curve is
    another one.

    Raises: ShapeError where shapes disagree or times do not increase.
    Source: the curve of SciPy's `RotationSpline`; the derivatives of the exponential map are those of Rodrigues' formula.
    """
    xp, half_chords, spans = _chords(values, times_s)
    chords = 2.0 * half_chords
    if chords.shape[0] == 0:
        return xp.stack([half_chords] * 3, axis=-2)
    velocities = chords / spans
    velocities = xp.concat([velocities[:1, ...], velocities], axis=0)
    if chords.shape[0] > 1:
        velocities = _with_one_acceleration(xp, chords, spans, velocities)
    slope = _apply(_inverse_jacobian(xp, chords), velocities[1:, ...])
    sixth = spans / 6.0
    return xp.stack([sixth * velocities[:-1, ...], half_chords, -sixth * slope], axis=-2)


def log_cubic(start: Array, controls: Array, u: Array) -> Array:
    """The cubic in log space from keys (*B, 4) with controls (*B, 3, 3) at u (*B), (*B, 4)."""
    xp, start, controls, u = _take_span(start, controls, u)
    outgoing, chord, incoming = _split(controls)
    v = 1.0 - u
    bend = scaled(xp, 3.0 * u * v * v, outgoing) + scaled(xp, 3.0 * u * u * v, chord + incoming)
    return _leave(xp, start, quat.exp(bend + scaled(xp, u * u * u, chord)), u)


# --- whole curves ---------------------------------------------------------------------------------------------------------

_CONTROLS = {"squad": squad_controls, "spherical_bezier": spherical_bezier_controls, "log_cubic": log_cubic_controls}
_CURVES = {"squad": squad, "spherical_bezier": spherical_bezier, "log_cubic": log_cubic}


def interpolate(values: Array, times_s: Array, at_s: Array, method: Method) -> Array:
    """Rotations (*B, *G, 4) at times (*B,) of the curve through keys (K, *G, 4) at times (K,); ends hold.

    At the time of a key the result is the key, bit for bit.
    Raises: UnknownName for a method that does not exist; ShapeError where shapes disagree or times do not increase.
    """
    if method not in _CONTROLS:
        raise UnknownName("rotation spline", str(method), _CONTROLS)
    xp, values = take(values=(values, (4,)))
    keys = _checked_times(values, times_s)
    at = np.clip(np.asarray(at_s, np.float64), keys[0], keys[-1])
    span = np.searchsorted(keys, at, side="right") - 1
    begin = gather(values, span.reshape(-1), 0)
    shape = (*span.shape, *values.shape[1:])
    if len(keys) == 1:
        return xp.reshape(begin, shape)
    controls = _CONTROLS[method](values, keys)
    last = np.minimum(span, len(keys) - 2)
    u = (at - keys[last]) / (keys[last + 1] - keys[last])
    u = np.where(span == len(keys) - 1, 0.0, u).reshape(-1, *[1] * (values.ndim - 2))
    found = _CURVES[method](begin, gather(controls, last.reshape(-1), 0), beside(xp, u, values))
    return xp.reshape(found, shape)


def end_velocities(controls: Array, spans_s: Array, method: Method) -> tuple[Array, Array]:
    """Angular velocities (*B, 3) in rad/s at the start and the end of spans (*B) s with controls (*B, 3, 3).

    Each is in the frame of its own key, so that the end of a span and the start of the next can be compared.
    """
    if method not in _CONTROLS:
        raise UnknownName("rotation spline", str(method), _CONTROLS)
    xp, controls, spans = take(controls=(controls, (3, 3)), spans_s=(spans_s, ()))
    outgoing, chord, incoming = _split(controls)
    per_span = matched(xp, 2.0 / spans, controls)[..., None]
    if method == "squad":
        return per_span * (chord + 2.0 * outgoing), per_span * (chord - 2.0 * incoming)
    start, end = 3.0 * per_span * outgoing, -3.0 * per_span * incoming
    if method == "log_cubic":
        end = _apply(_jacobian(xp, 2.0 * chord), end)
    return start, end


# --- parts ------------------------------------------------------------------------------------------------------------------


def _checked_times(values: Array, times_s: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    if values.ndim < 2:
        raise ShapeError(f"values: expected (K, *G, 4), got {tuple(values.shape)}")
    times = np.asarray(times_s, np.float64)
    checked(times, (values.shape[0],), "times_s", "values")
    if len(times) == 0:
        raise ShapeError("times_s: a curve needs at least one key")
    if not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0):
        raise ShapeError("times_s: expected finite, strictly increasing numbers")
    return times


def _chords(values: Array, times_s: Array) -> tuple[Any, Array, Array]:
    """Namespace, half-angle vectors (K-1, *G, 3) from each key to the next, and the spans in seconds (K-1, *1, 1)."""
    xp, values = take(values=(values, (4,)))
    times = _checked_times(values, times_s)
    spans = beside(xp, np.diff(times).reshape(-1, *[1] * (values.ndim - 1)), values)
    return xp, _log_between(values[:-1, ...], values[1:, ...]), spans


def _log_between(a: Array, b: Array) -> Array:
    return quat.log(quat.shortest(quat.multiply(quat.conjugate(a), b)))


def _inner(xp: Any, chords: Array, spans: Array, join_rates: Any) -> Array:
    """Half angular velocities (K, *G, 3) at all keys: ``join_rates`` of both sides, at the ends that of the only span."""
    rates = chords / spans
    if chords.shape[0] == 0:
        return beside(xp, np.zeros((1, *chords.shape[1:])), chords)
    before, after = spans[:-1, ...], spans[1:, ...]
    # The nearer neighbour says more about the velocity.
    inner = join_rates(rates[:-1, ...], rates[1:, ...], after / (before + after))
    # Beside a much shorter span a long one could be asked to turn round and round, which no control point can say.
    longer = xp.where(before > after, before, after)
    turned = longer * norm(xp, inner)[..., None]
    inner = xp.where(turned > pi, inner * (pi / xp.where(turned > pi, turned, 1.0)), inner)
    return xp.concat([rates[:1, ...], inner, rates[-1:, ...]], axis=0)


def _take_span(start: Array, controls: Array, u: Array) -> tuple[Any, Array, Array, Array]:
    xp, start, controls, u = take(start=(start, (4,)), controls=(controls, (3, 3)), u=(u, ()))
    return xp, start, controls, matched(xp, u, start)


def _split(controls: Array) -> tuple[Array, Array, Array]:
    return controls[..., 0, :], controls[..., 1, :], controls[..., 2, :]


def _arc(xp: Any, a: Array, b: Array, u: Array) -> Array:
    """From a to b as they are given, be it the long way: what must not jump cannot choose. Antipodes go round by X."""
    return quat.multiply(a, quat.exp(scaled(xp, u, quat.log(quat.multiply(quat.conjugate(a), b)))))


def _leave(xp: Any, start: Array, moved: Array, u: Array) -> Array:
    return xp.where((u == 0)[..., None], start, quat.multiply(start, moved))


# --- the exponential map's derivatives -----------------------------------------------------------------------------------------

# Series of t = angle²: (1 - sin x / x) / x², its slope by x², and (1 - (x/2) cot(x/2)) / x² by (x/2)².
_B = (1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800, -1 / 6227020800)
_B_SLOPE = (-1 / 120, 2 / 5040, -3 / 362880, 4 / 39916800, -5 / 6227020800, 6 / 1307674368000)
_C = (1 / 12, 1 / 180, 1 / 1890, 1 / 18900, 1 / 187110, 691 / 1277025750)
_SERIES_BELOW = 0.04


def _polynomial(coefficients: tuple[float, ...], t: Array) -> Array:
    total = coefficients[-1] + 0.0 * t
    for c in reversed(coefficients[:-1]):
        total = c + t * total
    return total


def _coefficients(xp: Any, r: Array) -> tuple[Array, Array, Array, Array, Array]:
    """a, b of J = 1 - a [r] + b [r]², c of J^-1 = 1 + [r]/2 + c [r]², and the slopes of a and b by |r|²; (*B, 1) each."""
    t = dot(xp, r, r)[..., None]
    quarter = 0.25 * t
    small = t < _SERIES_BELOW
    near, safe = xp.where(small, t, 0.0), xp.where(small, 1.0, t)
    half_cos, half_sinc = cos_sinc(xp, quarter)
    _, sinc = cos_sinc(xp, t)
    b = xp.where(small, _polynomial(_B, near), (1.0 - sinc) / safe)
    b_slope = xp.where(small, _polynomial(_B_SLOPE, near), -(0.5 * sinc_slope(xp, safe) + b) / safe)
    c = xp.where(small, _polynomial(_C, 0.25 * near), (1.0 - half_cos / half_sinc) / safe)
    return 0.5 * half_sinc * half_sinc, b, c, 0.125 * half_sinc * sinc_slope(xp, quarter), b_slope


def _skew(xp: Any, v: Array) -> Array:
    x, y, z = parts(v)
    o = 0.0 * x
    return xp.reshape(join(xp, o, -z, y, z, o, -x, -y, x, o), (*v.shape[:-1], 3, 3))


def _jacobian(xp: Any, r: Array) -> Array:
    """J with angular velocity (in the turning frame) = J(r) dr/dt for the rotation by |r| about r, (*B, 3, 3)."""
    a, b, *_ = _coefficients(xp, r)
    k = _skew(xp, r)
    return beside(xp, np.eye(3), r) - a[..., None] * k + b[..., None] * xp.matmul(k, k)


def _inverse_jacobian(xp: Any, r: Array) -> Array:
    c = _coefficients(xp, r)[2]
    k = _skew(xp, r)
    return beside(xp, np.eye(3), r) + 0.5 * k + c[..., None] * xp.matmul(k, k)


def _turning(xp: Any, r: Array, p: Array) -> tuple[Array, Array]:
    """(dJ/dt) p at r where dr/dt = p, and its derivative by p, (*B, 3) and (*B, 3, 3)."""
    _, b, _, a_slope, b_slope = _coefficients(xp, r)
    rp = cross(xp, r, p)
    along, bent = dot(xp, r, p)[..., None], b_slope * cross(xp, r, rp) - a_slope * rp
    k, kp, krp = _skew(xp, r), _skew(xp, p), _skew(xp, rp)
    value = 2.0 * along * bent + b * cross(xp, p, rp)
    slope = (
        2.0 * bent[..., :, None] * r[..., None, :]
        + 2.0 * along[..., None] * (b_slope[..., None] * xp.matmul(k, k) - a_slope[..., None] * k)
        + b[..., None] * (xp.matmul(kp, k) - krp)
    )
    return value, slope


def _apply(matrix: Array, v: Array) -> Array:
    return (matrix @ v[..., None])[..., 0]


_NEWTON_STEPS = 7  # six are enough between keys a half turn apart at times that differ by a factor of forty


def _with_one_acceleration(xp: Any, chords: Array, spans: Array, velocities: Array) -> Array:
    """Angular velocities (K, *G, 3), the ends kept, with which spans of rotation vectors ``chords`` agree in acceleration."""
    r, h = chords[:-1, ...], spans[:-1, ...]  # the span before each inner key
    after = spans[1:, ...]
    jacobian, back, ahead = _jacobian(xp, r), _inverse_jacobian(xp, r), _inverse_jacobian(xp, chords[1:, ...])
    lower = (2.0 / h)[..., None] * jacobian
    upper = (2.0 / after)[..., None] * ahead
    diagonal = (4.0 / h + 4.0 / after)[..., None] * beside(xp, np.eye(3), r) + 0.0 * jacobian
    pull = 6.0 * r / (h * h) + 6.0 * chords[1:, ...] / (after * after)
    first, last = velocities[:1, ...], velocities[-1:, ...]

    def gap(inner: Array) -> tuple[Array, Array]:
        turned, slope = _turning(xp, r, _apply(back, inner))
        left, right = xp.concat([first, inner[:-1, ...]], axis=0), xp.concat([inner[1:, ...], last], axis=0)
        found = pull - turned - _apply(lower, left) - _apply(diagonal, inner) - _apply(upper, right)
        return found, diagonal + xp.matmul(slope, back)

    def size(values: Array) -> Array:
        # One number for each curve of the batch: the largest of its keys and components.
        return xp.max(xp.max(xp.abs(values), axis=0), axis=-1)[None, ..., None]

    # The quadratic part is small: without it the system is dominated by its diagonal and always has an answer.
    inner = velocities[1:-1, ...]
    found, _ = gap(inner)
    turned, _ = _turning(xp, r, _apply(back, inner))
    inner = inner + _solve_tridiagonal(xp, lower, diagonal, upper, found + turned)
    found, slope = gap(inner)
    error, small = size(found), 16.0 * eps(xp, chords) * size(pull)
    for _ in range(_NEWTON_STEPS):
        if isinstance(error, np.ndarray) and np.all(error <= small):
            break
        tried = inner + _solve_tridiagonal(xp, lower, slope, upper, found)
        tried_gap, tried_slope = gap(tried)
        tried_error = size(tried_gap)
        better = tried_error < error  # false where it is not a number
        if isinstance(error, np.ndarray) and not np.any(better):
            break
        inner, found = xp.where(better, tried, inner), xp.where(better, tried_gap, found)
        slope, error = xp.where(better[..., None], tried_slope, slope), xp.where(better, tried_error, error)
    return xp.concat([first, inner, last], axis=0)


def _solve_tridiagonal(xp: Any, lower: Array, diagonal: Array, upper: Array, right: Array) -> Array:
    """x of lower[i] x[i-1] + diagonal[i] x[i] + upper[i] x[i+1] = right[i] for 3x3 blocks, by odd-even reduction.

    Every second unknown is eliminated at once, so that n of them take log n steps of whole arrays.
    """
    count = diagonal.shape[0]
    right = right[..., None]

    def padded(array: Array, before: int, after: int) -> Array:
        zeros = 0.0 * array[:1, ...]
        return xp.concat([zeros] * before + [array] + [zeros] * after, axis=0)

    if count == 1:
        return xp.linalg.solve(diagonal, right)[..., 0]
    odd, even = slice(1, None, 2), slice(0, None, 2)
    sides = xp.concat([lower[odd, ...], upper[odd, ...], right[odd, ...]], axis=-1)
    known = xp.linalg.solve(diagonal[odd, ...], sides)  # of the odd ones, in terms of the even ones beside them
    evens, odds = (count + 1) // 2, count // 2
    left = xp.matmul(lower[even, ...], padded(known, 1, 0)[:evens, ...])
    beyond = xp.matmul(upper[even, ...], padded(known, 0, 1)[:evens, ...])
    at_even = _solve_tridiagonal(
        xp,
        -left[..., 0:3],
        diagonal[even, ...] - left[..., 3:6] - beyond[..., 0:3],
        -beyond[..., 3:6],
        (right[even, ...] - left[..., 6:] - beyond[..., 6:])[..., 0],
    )
    following = padded(at_even, 0, 1)[1 : odds + 1, ...]
    at_odd = known[..., 6] - _apply(known[..., 0:3], at_even[:odds, ...]) - _apply(known[..., 3:6], following)
    woven = xp.stack([at_even, padded(at_odd, 0, evens - odds)], axis=1)
    return xp.reshape(woven, (2 * evens, *right.shape[1:-1]))[:count, ...]
