"""Euler angles (*B, 3) in radians, in all 24 conventions.

An order names three axes, as in SciPy: capitals ('XYZ') turn about the axes of the moving body (intrinsic), small letters
('xyz') about the fixed axes of the parent (extrinsic). Angles are listed as the order is written. 'XYZ' with angles
(a, b, c) is the product Rx(a) Ry(b) Rz(c); 'xyz' with the same angles is Rz(c) Ry(b) Rx(a).

Gimbal lock: three different axes ("Tait-Bryan") lock where the middle angle is a quarter turn, orders that repeat an axis
("proper Euler") where it is 0 or half a turn. There only a sum or difference of the outer angles is determined:
`from_quat` sets the THIRD angle, as written, to 0.
"""

from __future__ import annotations

from math import pi
from typing import Any

from keypose.arrays import Array
from keypose.errors import ShapeError, UnknownName
from keypose.math.elementary import eps, join, matched, parts, root, take

_TAIT_BRYAN = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")
_PROPER = ("XYX", "XZX", "YXY", "YZY", "ZXZ", "ZYZ")

CONVENTIONS: tuple[str, ...] = (*_TAIT_BRYAN, *_PROPER, *(o.lower() for o in (*_TAIT_BRYAN, *_PROPER)))
"""The 24 orders: 12 intrinsic (capitals), then 12 extrinsic (small letters)."""

# Below this multiple of eps the undetermined combination of the outer angles is only rounding noise.
_LOCK_EPS = 16


def to_quat(angles: Array, order: str) -> Array:
    """The rotation (*B, 4) of Euler angles (*B, 3) in radians.

    Raises: UnknownName where ``order`` is none of `CONVENTIONS`.
    Source: the product of three axis quaternions, multiplied out once for each of the two kinds of order.
    """
    i, j, k, parity, proper = _axes(order)
    xp, angles = take(angles=(angles, (3,)))
    half = 0.5 * angles
    c1, c2, c3 = parts(xp.cos(half))
    s1, s2, s3 = parts(xp.sin(half))
    if order.islower():
        c1, s1, c3, s3 = c3, s3, c1, s1
    if proper:
        both, third = c1 * c3 - s1 * s3, s1 * c3 + c1 * s3
        q = {0: c2 * both, i: c2 * third, j: s2 * (c1 * c3 + s1 * s3), k: parity * s2 * (s1 * c3 - c1 * s3)}
    else:
        cc, ss, sc, cs = c1 * c3, s1 * s3, s1 * c3, c1 * s3
        e = parity
        q = {0: c2 * cc - e * s2 * ss, i: c2 * sc + e * s2 * cs, j: s2 * cc - e * c2 * ss, k: c2 * cs + e * s2 * sc}
    return join(xp, q[0], q[1], q[2], q[3])


def from_quat(q: Array, order: str) -> Array:
    """The Euler angles (*B, 3) in radians of unit quaternions (*B, 4).

    Outer angles are in (-pi, pi]; the middle one is in [-pi/2, pi/2], or in [0, pi] where the order repeats an axis.
    At gimbal lock the third angle is 0 (see the module).
    Raises: UnknownName where ``order`` is none of `CONVENTIONS`.
    Source: Bernardes and Viollet, Quaternion to Euler angles conversion (PLoS ONE 2022). The middle angle of Tait-Bryan
    orders is here taken from both its sine and its cosine, which keeps it accurate near zero and at the lock.
    """
    i, j, k, parity, proper = _axes(order)
    xp, q = take(q=(q, (4,)))
    w, qi, qj, qk = q[..., 0], q[..., i], q[..., j], parity * q[..., k]
    # (px, py) points along half of (first + third), (mx, my) along half of (first - third); their lengths are the cosine
    # and sine of half the middle angle (Tait-Bryan: of that plus an eighth of a turn, times sqrt 2).
    if proper:
        px, py, mx, my = w, qi, qj, qk
    else:
        px, py, mx, my = w + qj, qi + qk, w - qj, qi - qk
    p_squared, m_squared = px * px + py * py, mx * mx + my * my
    noise = (_LOCK_EPS * eps(xp, q)) ** 2 * (p_squared + m_squared)
    p_lost, m_lost = p_squared <= noise, m_squared <= noise
    p_length, m_length = root(xp, p_squared), root(xp, m_squared)
    if proper:
        middle = 2.0 * xp.atan2(m_length, p_length)
    else:
        middle = xp.atan2(2.0 * (w * qj + qi * qk), p_length * m_length)
    half_sum = xp.atan2(xp.where(p_lost, 0.0, py), xp.where(p_lost, 1.0, px))
    half_difference = xp.atan2(xp.where(m_lost, 0.0, my), xp.where(m_lost, 1.0, mx))
    # At the lock the third angle as written vanishes; of an extrinsic order that is the first factor of the product.
    keep = -1.0 if order.islower() else 1.0
    half_sum, half_difference = (
        xp.where(p_lost, keep * half_difference, half_sum),
        xp.where(m_lost & ~p_lost, keep * half_sum, half_difference),
    )
    first = _wrapped(xp, half_sum + half_difference)
    third = _wrapped(xp, (half_sum - half_difference) * (1.0 if proper else parity))
    return join(xp, third, middle, first) if order.islower() else join(xp, first, middle, third)


def gimbal_distance(angles: Array, order: str) -> Array:
    """How far the middle angle is from gimbal lock, (*B, 3) -> (*B) radians in [0, pi/2]; 0 is locked.

    Raises: UnknownName where ``order`` is none of `CONVENTIONS`.
    """
    proper = _axes(order)[4]
    xp, angles = take(angles=(angles, (3,)))
    middle = angles[..., 1]
    lock = 0.0 if proper else 0.5 * pi
    return xp.abs((middle - lock) - pi * xp.round((middle - lock) / pi))


def unroll(angles: Array, order: str, axis: int = 0) -> Array:
    """The same rotations with angles that run on smoothly along ``axis``, (*B, 3): the Euler filter.

    Every frame has two triples in each turn, (a, b, c) and the one with both outer angles half a turn further and the middle
    one mirrored, and each angle may gain whole turns; of these the nearest to the frame before is taken. The first frame
    stays as it is.

    Raises: UnknownName where ``order`` is none of `CONVENTIONS`; ShapeError where ``axis`` is not a batch axis.
    """
    proper = _axes(order)[4]
    xp, angles = take(angles=(angles, (3,)))
    at = axis + angles.ndim if axis < 0 else axis
    if not 0 <= at < angles.ndim - 1:
        raise ShapeError(f"axis: expected a batch axis of {tuple(angles.shape)}, got {axis}")
    if angles.shape[at] < 2:
        return angles
    here = xp.moveaxis(angles, at, 0)
    other = join(xp, here[..., 0] + pi, (0.0 if proper else pi) - here[..., 1], here[..., 2] + pi)
    # Swapping both neighbours for their twins changes no distance, so whether a frame changes sides does not depend on
    # the side the one before ended on: sides are a running parity, and no loop over time is needed.
    stay, swap = _distance(xp, here[:-1, ...], here[1:, ...]), _distance(xp, here[:-1, ...], other[1:, ...])
    on_other_side = xp.cumulative_sum(xp.astype(swap < stay, xp.int32), axis=0) % 2 == 1
    chosen = xp.where(on_other_side[..., None], other[1:, ...], here[1:, ...])
    chosen = xp.concat([here[:1, ...], chosen], axis=0)
    turns = xp.cumulative_sum(xp.round((chosen[1:, ...] - chosen[:-1, ...]) / (2 * pi)), axis=0)
    chosen = xp.concat([chosen[:1, ...], chosen[1:, ...] - matched(xp, turns, angles) * (2 * pi)], axis=0)
    return xp.moveaxis(chosen, 0, at)


def _axes(order: str) -> tuple[int, int, int, float, bool]:
    """Quaternion components of the first, second and remaining axis as applied intrinsically, the parity, and whether
    the first axis comes back."""
    if order not in CONVENTIONS:
        raise UnknownName("Euler order", str(order), CONVENTIONS)
    i, j, k = ("XYZ".index(letter) + 1 for letter in (order.upper() if order.isupper() else order.upper()[::-1]))
    proper = i == k
    if proper:
        k = 6 - i - j
    return i, j, k, 1.0 if (j - i) % 3 == 1 else -1.0, proper


def _wrapped(xp: Any, angle: Array) -> Array:
    """From (-2 pi, 2 pi] into (-pi, pi]."""
    return xp.where(angle > pi, angle - 2 * pi, xp.where(angle <= -pi, angle + 2 * pi, angle))


def _distance(xp: Any, a: Array, b: Array) -> Array:
    """Squared distance of two triples on the torus of whole turns."""
    d = b - a
    d = d - (2 * pi) * xp.round(d / (2 * pi))
    return xp.vecdot(d, d)
