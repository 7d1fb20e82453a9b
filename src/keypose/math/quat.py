"""Unit Hamilton quaternions (*B, 4), components wxyz: the rotations of keypose.

``q`` and ``-q`` are one rotation. Functions that scale or compare rotations take the short way of the two; the purely
algebraic ones (`multiply`, `exp`, `log`) keep the sign. All batch shapes broadcast, float32 stays float32, and every
singular point has a defined value and a finite gradient. Parameters such as ``u`` and ``weights`` are used in the
precision of the quaternions.

A zero quaternion (a squared norm below the smallest normal number) stands for no rotation: `normalize` and `inverse`
turn it into the identity.
"""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import ShapeError
from keypose.math.elementary import (
    angle_ratio,
    beside,
    constant,
    cos_sinc,
    cross,
    dot,
    eps,
    join,
    matched,
    norm,
    parts,
    perpendiculars,
    scaled,
    sign,
    slerp_weights,
    take,
    unit,
    vanishes,
)

_IDENTITY = (1.0, 0.0, 0.0, 0.0)


# --- algebra ---------------------------------------------------------------------------------------------------------


def identity(batch_shape: tuple[int, ...] = (), *, like: Array | None = None) -> Array:
    """No rotation, (*batch_shape, 4); float64 NumPy, or of the library and precision of ``like``."""
    values = np.broadcast_to(np.asarray(_IDENTITY), (*batch_shape, 4)).copy()
    if like is None:
        return values
    xp, reference = take(like=(like, ()))
    return beside(xp, values, reference)


def multiply(a: Array, b: Array) -> Array:
    """The rotation b followed by a: the Hamilton product a b, (*B, 4); "adding" rotations.

    Source: Hamilton; lecture notes, Rotations: ``[w1 w2 - v1.v2, w1 v2 + w2 v1 + v1 x v2]``.
    """
    xp, a, b = take(a=(a, (4,)), b=(b, (4,)))
    return _product(xp, a, b)


def conjugate(q: Array) -> Array:
    """The opposite rotation of a unit quaternion: the vector part negated, (*B, 4)."""
    xp, q = take(q=(q, (4,)))
    return _conjugate(xp, q)


def inverse(q: Array) -> Array:
    """The multiplicative inverse of a quaternion of any length, (*B, 4); of a zero quaternion the identity."""
    xp, q = take(q=(q, (4,)))
    squared = dot(xp, q, q)
    zero = vanishes(xp, squared)
    factor = xp.where(zero, 0.0, 1.0 / xp.where(zero, 1.0, squared))
    w, x, y, z = parts(q)
    return join(xp, xp.where(zero, 1.0, factor * w), -factor * x, -factor * y, -factor * z)


def normalize(q: Array) -> Array:
    """The unit quaternion along q, (*B, 4); a zero quaternion becomes the identity."""
    xp, q = take(q=(q, (4,)))
    return _normalize(xp, q)


def shortest(q: Array) -> Array:
    """The one of q and -q whose rotation angle is at most half a turn (w >= 0), (*B, 4)."""
    xp, q = take(q=(q, (4,)))
    return _shortest(xp, q)


def rotate(q: Array, v: Array) -> Array:
    """Vectors (*B, 3) rotated by unit quaternions (*B, 4): the vector part of q v q^-1.

    Source: lecture notes, Rotations; the form with two cross products is v + 2 w (u x v) + 2 u x (u x v).
    """
    xp, q, v = take(q=(q, (4,)), v=(v, (3,)))
    w, x, y, z = parts(q)
    vx, vy, vz = parts(v)
    tx, ty, tz = y * vz - z * vy, z * vx - x * vz, x * vy - y * vx
    tx, ty, tz = tx + tx, ty + ty, tz + tz
    return join(xp, vx + w * tx + (y * tz - z * ty), vy + w * ty + (z * tx - x * tz), vz + w * tz + (x * ty - y * tx))


# --- axis and angle, exponential map -----------------------------------------------------------------------------------


def from_axis_angle(axis: Array, angle: Array) -> Array:
    """The rotation by ``angle`` (*B) radians about ``axis`` (*B, 3) of any length, (*B, 4).

    A zero axis gives the identity. Source: lecture notes, Rotations: the quaternion holds the half angle.
    """
    xp, axis, angle = take(axis=(axis, (3,)), angle=(angle, ()))
    half = 0.5 * angle
    half = xp.where(vanishes(xp, dot(xp, axis, axis)), 0.0 * half, half)
    x, y, z = parts(unit(xp, axis))
    s = xp.sin(half)
    return join(xp, xp.cos(half), x * s, y * s, z * s)


def to_axis_angle(q: Array) -> tuple[Array, Array]:
    """Unit axis (*B, 3) and angle (*B) in [0, pi] of the short way; no rotation has the axis X."""
    xp, q = take(q=(q, (4,)))
    q = _shortest(xp, q)
    v = q[..., 1:]
    squared = dot(xp, v, v)
    none = vanishes(xp, squared)
    n = xp.sqrt(xp.where(none, 1.0, squared))
    axis = xp.where(none[..., None], beside(xp, (1.0, 0.0, 0.0), q), v / n[..., None])
    return axis, xp.where(none, 0.0 * n, 2.0 * xp.atan2(n, q[..., 0]))


def exp(v: Array) -> Array:
    """The unit quaternion [cos |v|, sin |v| v/|v|] of a half-angle vector (*B, 3), (*B, 4)."""
    xp, v = take(v=(v, (3,)))
    return _exp(xp, v)


def log(q: Array) -> Array:
    """The half-angle vector (*B, 3), of length in [0, pi], with exp(log(q)) = q/|q|.

    The singular point q = -1, where every axis would do, gives (pi, 0, 0).
    """
    xp, q = take(q=(q, (4,)))
    return _log(xp, q)


def from_rotation_vector(v: Array) -> Array:
    """The rotation by |v| radians about v, (*B, 3) -> (*B, 4)."""
    xp, v = take(v=(v, (3,)))
    return _exp(xp, 0.5 * v)


def to_rotation_vector(q: Array) -> Array:
    """Axis times angle of the short way, (*B, 4) -> (*B, 3), of length in [0, pi]."""
    xp, q = take(q=(q, (4,)))
    return 2.0 * _log(xp, _shortest(xp, q))


# --- between rotations -------------------------------------------------------------------------------------------------


def slerp(a: Array, b: Array, u: Array) -> Array:
    """From a to b along the great arc at constant angular speed, the short way, (*B, 4); u (*B) in 0..1 or beyond.

    Exactly a at u = 0, and b (or -b, the same rotation) at u = 1. Where both ways are equally long, b's sign decides.
    Source: Shoemake, Animating Rotation with Quaternion Curves (SIGGRAPH 1985); lecture notes, Slerp. The angle comes
    from atan2(|a - b|, |a + b|), which is accurate at every angle (Kahan), and the two weights are ratios of sines, by
    their series where the arc is short.
    """
    xp, a, b, u = take(a=(a, (4,)), b=(b, (4,)), u=(u, ()))
    u = matched(xp, u, a)
    b = _align(xp, a, b)
    weight_a, weight_b = slerp_weights(xp, _arc_squared(xp, a, b), u)
    return join(xp, *(weight_a * p + weight_b * q for p, q in zip(parts(a), parts(b), strict=True)))


def nlerp(a: Array, b: Array, u: Array) -> Array:
    """From a to b along the chord, the short way, normalised: the path of slerp at uneven speed, (*B, 4); u (*B)."""
    xp, a, b, u = take(a=(a, (4,)), b=(b, (4,)), u=(u, ()))
    u = matched(xp, u, a)
    v, u = 1.0 - u, u * sign(xp, dot(xp, a, b))
    return _normalize(xp, join(xp, *(v * p + u * q for p, q in zip(parts(a), parts(b), strict=True))))


def power(q: Array, exponent: Array) -> Array:
    """The rotation with its angle scaled by ``exponent`` (*B), taken the short way, (*B, 4); "scaling" a rotation."""
    xp, q, exponent = take(q=(q, (4,)), exponent=(exponent, ()))
    return _exp(xp, scaled(xp, matched(xp, exponent, q), _log(xp, _shortest(xp, q))))


def difference(a: Array, b: Array) -> Array:
    """The rotation that leads from a to b: b a^-1, so that multiply(difference(a, b), a) = b; "subtracting" rotations."""
    xp, a, b = take(a=(a, (4,)), b=(b, (4,)))
    return _product(xp, b, _conjugate(xp, a))


def angle_between(a: Array, b: Array) -> Array:
    """The angle of the rotation from a to b, in [0, pi] radians, (*B); its gradient at a = b is 0."""
    xp, a, b = take(a=(a, (4,)), b=(b, (4,)))
    minus, plus = norm(xp, a - b), norm(xp, a + b)
    return 4.0 * xp.atan2(xp.minimum(minus, plus), xp.maximum(minus, plus))


def average(q: Array, weights: Array | None = None) -> Array:
    """The rotation nearest to N rotations (*B, N, 4) under weights (*B, N) >= 0, (*B, 4) with w >= 0.

    The signs of the inputs do not matter. No input or no weight gives the identity; where the answer is not unique
    (two opposite rotations of equal weight) it is one of the nearest.
    Source: Markley et al., Averaging Quaternions (JGCD 2007): the eigenvector of the largest eigenvalue of
    sum w q q^T. The gradient is that of first-order perturbation, finite for repeated eigenvalues.
    """
    if weights is None:
        xp, q = take(q=(q, (4,)))
        weighted = q
    else:
        xp, q, w = take(q=(q, (4,)), weights=(weights, ()))
        if w.ndim == 0 or q.ndim < 2 or w.shape[-1] != q.shape[-2]:
            raise ShapeError(f"weights: expected (*B, N) to match q {tuple(q.shape)}, got {tuple(w.shape)}")
        weighted = scaled(xp, matched(xp, w, q), q)
    if q.ndim < 2:
        raise ShapeError(f"q: expected (*B, N, 4), got {tuple(q.shape)}")
    spread = xp.matmul(xp.matrix_transpose(weighted), xp.broadcast_to(q, weighted.shape))  # (*B, 4, 4)
    total = spread[..., 0, 0] + spread[..., 1, 1] + spread[..., 2, 2] + spread[..., 3, 3]
    prefer_identity = beside(xp, [_IDENTITY, *([(0.0,) * 4] * 3)], q)
    fixed = constant(spread)
    fixed = xp.where(vanishes(xp, constant(total))[..., None, None], prefer_identity, fixed)
    values, vectors = xp.linalg.eigh(fixed)
    top = vectors[..., :, 3]
    # d(top) = sum_i v_i (v_i . dM top) / (top value - value_i): added with value zero, it carries the gradient.
    gaps = values[..., 3:] - values[..., :3]
    open_gap = gaps > 4 * eps(xp, q) * values[..., 3:]
    change = xp.matmul(spread - constant(spread), top[..., None])
    along = xp.matmul(xp.matrix_transpose(vectors[..., :, :3]), change)[..., 0]
    along = xp.where(open_gap, along / xp.where(open_gap, gaps, 1.0), 0.0)
    top = top + xp.matmul(vectors[..., :, :3], along[..., None])[..., 0]
    return _normalize(xp, _shortest(xp, top))


def swing_twist(q: Array, axis: Array) -> tuple[Array, Array]:
    """Swing and twist (*B, 4) with q = swing twist: twist turns about ``axis`` (*B, 3), swing about a perpendicular one.

    Singular case, a swing by half a turn (which carries every twist): the twist is the identity. A zero axis has no
    twist. Source: Dobrowolski, Swing-twist decomposition in Clifford algebra (2015).
    """
    xp, q, axis = take(q=(q, (4,)), axis=(axis, (3,)))
    axis = unit(xp, axis)
    along = dot(xp, q[..., 1:], axis)
    x, y, z = parts(axis)
    raw = join(xp, q[..., 0], along * x, along * y, along * z)
    # Below rounding noise there is no twist to be read; what is left would be a random angle.
    noise = 4 * eps(xp, q)
    lost = dot(xp, raw, raw) <= noise * noise
    twist = _normalize(xp, xp.where(lost[..., None], beside(xp, _IDENTITY, q), raw))
    return _product(xp, q, _conjugate(xp, twist)), twist


def align_signs(q: Array, axis: int = 0) -> Array:
    """The same rotations (*B, 4) with signs chosen so that neighbours along ``axis`` are on the short side of each other.

    The first keeps its sign. Raises: ShapeError where ``axis`` is not a batch axis.
    """
    xp, q = take(q=(q, (4,)))
    at = axis + q.ndim if axis < 0 else axis
    if not 0 <= at < q.ndim - 1:
        raise ShapeError(f"axis: expected a batch axis of {tuple(q.shape)}, got {axis}")
    if q.shape[at] < 2:
        return q
    moved = xp.moveaxis(q, at, 0)
    turns = xp.astype(dot(xp, moved[1:, ...], moved[:-1, ...]) < 0, xp.int32)
    odd = xp.cumulative_sum(turns, axis=0) % 2 == 1
    rest = xp.where(odd[..., None], -moved[1:, ...], moved[1:, ...])
    return xp.moveaxis(xp.concat([moved[:1, ...], rest], axis=0), 0, at)


# --- other forms ---------------------------------------------------------------------------------------------------------


def to_matrix(q: Array) -> Array:
    """The rotation matrix (*B, 3, 3) of unit quaternions, for column vectors."""
    xp, q = take(q=(q, (4,)))
    w, x, y, z = parts(q)
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz = x * y2, x * z2, y * z2
    wx, wy, wz = w * x2, w * y2, w * z2
    rows = join(xp, 1.0 - yy - zz, xy - wz, xz + wy, xy + wz, 1.0 - xx - zz, yz - wx, xz - wy, yz + wx, 1.0 - xx - yy)
    return xp.reshape(rows, (*q.shape[:-1], 3, 3))


def from_matrix(matrix: Array) -> Array:
    """The unit quaternion (*B, 4), w >= 0, of rotation matrices (*B, 3, 3) (orthonormal, determinant 1).

    Source: Shepperd, Quaternion from Rotation Matrix (1978): of the four rows of 4 q q^T, all linear in the matrix, the
    one with the largest diagonal is normalised, so that nothing small is ever divided by.
    """
    xp, m = take(matrix=(matrix, (3, 3)))
    return _from_entries(xp, *(m[..., i, j] for i in range(3) for j in range(3)))


def from_axes(x: Array, y: Array, z: Array) -> Array:
    """The rotation (*B, 4) that takes X, Y, Z to three orthonormal right-handed axes (*B, 3): the matrix's columns."""
    xp, x, y, z = take(x=(x, (3,)), y=(y, (3,)), z=(z, (3,)))
    return _from_entries(xp, *(axis[..., i] for i in range(3) for axis in (x, y, z)))


def to_sixd(q: Array) -> Array:
    """The first two columns of the rotation matrix, one after the other, (*B, 6).

    Source: Zhou et al., On the Continuity of Rotation Representations in Neural Networks (CVPR 2019).
    """
    xp, q = take(q=(q, (4,)))
    w, x, y, z = parts(q)
    x2, y2, z2 = x + x, y + y, z + z
    return join(
        xp,
        1.0 - y * y2 - z * z2, x * y2 + w * z2, x * z2 - w * y2,
        x * y2 - w * z2, 1.0 - x * x2 - z * z2, y * z2 + w * x2,
    )  # fmt: skip


def from_sixd(sixd: Array) -> Array:
    """The rotation (*B, 4) nearest in Gram-Schmidt's sense to two columns (*B, 6) of any length.

    Singular cases: a zero first column becomes X; a second column along the first is replaced by a fixed perpendicular.
    Source: Zhou et al. (CVPR 2019), Gram-Schmidt.
    """
    xp, d = take(sixd=(sixd, (6,)))
    first, second = unit(xp, d[..., :3]), unit(xp, d[..., 3:])
    first = xp.where(xp.all(first == 0, axis=-1)[..., None], beside(xp, (1.0, 0.0, 0.0), d), first)
    normal = cross(xp, first, second)
    squared = dot(xp, normal, normal)
    noise = 4 * eps(xp, d)
    parallel = squared <= noise * noise
    _, fallback = perpendiculars(xp, first)
    normal = xp.where(parallel[..., None], cross(xp, first, fallback), normal)
    normal = unit(xp, normal)
    return from_axes(first, cross(xp, normal, first), normal)


def from_two_vectors(a: Array, b: Array) -> Array:
    """The shortest rotation (*B, 4) that takes the direction of a (*B, 3) to that of b.

    Opposite directions (to within 4 eps) turn by half a turn about a fixed axis perpendicular to a, for +Z about X.
    A zero vector gives the identity. Accurate at every angle: a x b is computed from the exact sum or difference of
    the unit vectors.
    """
    xp, a, b = take(a=(a, (3,)), b=(b, (3,)))
    a, b = unit(xp, a), unit(xp, b)
    total = a + b
    obtuse = dot(xp, a, b) < 0
    c = cross(xp, a, xp.where(obtuse[..., None], total, b - a))
    q = join(xp, 0.5 * dot(xp, total, total), *parts(c))  # (1 + a.b, a x b), of length |a + b|
    noise = 4 * eps(xp, q)
    opposite = obtuse & (dot(xp, c, c) <= noise * noise)
    half_turn = join(xp, 0.0 * a[..., 0], *parts(perpendiculars(xp, a)[0]))
    return _normalize(xp, xp.where(opposite[..., None], half_turn, q))


def look_rotation(forward: Array, up: Array = (0.0, 1.0, 0.0)) -> Array:
    """The rotation (*B, 4) that takes +Z to ``forward`` (*B, 3) and +Y as near as it can to ``up`` (*B, 3).

    Where forward and up are parallel (or up is zero) it is the shortest rotation that takes +Z to forward; a zero
    forward gives the identity.
    """
    xp, forward, up = take(forward=(forward, (3,)), up=(up, (3,)))
    z = unit(xp, forward)
    side = cross(xp, unit(xp, up), z)
    noise = 4 * eps(xp, z)
    parallel = dot(xp, side, side) <= noise * noise
    x = unit(xp, xp.where(parallel[..., None], beside(xp, (1.0, 0.0, 0.0), z), side))
    framed = from_axes(x, cross(xp, z, x), z)
    return xp.where(parallel[..., None], from_two_vectors(beside(xp, (0.0, 0.0, 1.0), z), z), framed)


# --- unchecked parts -----------------------------------------------------------------------------------------------------


def _product(xp: Any, a: Array, b: Array) -> Array:
    aw, ax, ay, az = parts(a)
    bw, bx, by, bz = parts(b)
    return join(
        xp,
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def _conjugate(xp: Any, q: Array) -> Array:
    w, x, y, z = parts(q)
    return join(xp, w, -x, -y, -z)


def _normalize(xp: Any, q: Array) -> Array:
    squared = dot(xp, q, q)
    zero = vanishes(xp, squared)
    factor = xp.where(zero, 0.0, 1.0 / xp.sqrt(xp.where(zero, 1.0, squared)))
    w, x, y, z = parts(q)
    return join(xp, xp.where(zero, 1.0, factor * w), factor * x, factor * y, factor * z)


def _shortest(xp: Any, q: Array) -> Array:
    return scaled(xp, sign(xp, q[..., 0]), q)


def _align(xp: Any, a: Array, b: Array) -> Array:
    """B's sign on the short side of a: q and -q are one rotation."""
    return scaled(xp, sign(xp, dot(xp, a, b)), b)


def _arc_squared(xp: Any, a: Array, b: Array) -> Array:
    """The square of the arc between aligned unit quaternions, a smooth function also at a = b."""
    minus, plus = a - b, a + b
    chord_squared = dot(xp, minus, minus)
    half_arc_over_chord = angle_ratio(xp, chord_squared, norm(xp, plus))
    return 4.0 * chord_squared * half_arc_over_chord * half_arc_over_chord


def _exp(xp: Any, v: Array) -> Array:
    c, s = cos_sinc(xp, dot(xp, v, v))
    x, y, z = parts(v)
    return join(xp, c, s * x, s * y, s * z)


def _log(xp: Any, q: Array) -> Array:
    w, x, y, z = parts(q)
    v = q[..., 1:]
    squared = dot(xp, v, v)
    ratio = angle_ratio(xp, squared, w)
    opposite = (w < 0) & vanishes(xp, squared)
    return join(xp, xp.where(opposite, pi + 0.0 * x, ratio * x), ratio * y, ratio * z)


def _from_entries(
    xp: Any, m00: Array, m01: Array, m02: Array, m10: Array, m11: Array, m12: Array, m20: Array, m21: Array, m22: Array
) -> Array:
    ww, xx = 1.0 + m00 + m11 + m22, 1.0 + m00 - m11 - m22
    yy, zz = 1.0 - m00 + m11 - m22, 1.0 - m00 - m11 + m22
    wx, wy, wz = m21 - m12, m02 - m20, m10 - m01
    xy, xz, yz = m01 + m10, m02 + m20, m12 + m21
    # Two comparisons pick between w and x, y and z; a third between the winners.
    w_wins, y_wins = ww >= xx, yy >= zz
    first = xp.where(w_wins, ww, xx) >= xp.where(y_wins, yy, zz)

    def pick(w_row: Array, x_row: Array, y_row: Array, z_row: Array) -> Array:
        return xp.where(first, xp.where(w_wins, w_row, x_row), xp.where(y_wins, y_row, z_row))

    q = join(xp, pick(ww, wx, wy, wz), pick(wx, xx, xy, xz), pick(wy, xy, yy, yz), pick(wz, xz, yz, zz))
    return _shortest(xp, _normalize(xp, q))
