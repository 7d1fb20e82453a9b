"""Unit dual quaternions (*B, 8): rigid motions, as a rotation (wxyz) followed by a dual part (wxyz).

The dual part of a rotation r and a translation t (applied after r) is 0.5 (0, t) r. Like quaternions, ``d`` and ``-d`` are
one motion; `blend` and `sclerp` take the short way. All batch shapes broadcast, float32 stays float32, gradients are
finite.

Source: Kavan et al., Geometric Skinning with Approximate Dual Quaternion Blending (ACM TOG 2008).
"""

from __future__ import annotations

from typing import Any

import array_api_compat

from keypose.arrays import Array
from keypose.errors import ShapeError
from keypose.math import quat
from keypose.math.elementary import (
    angle_ratio,
    angle_ratio_gap,
    cos_sinc,
    dot,
    join,
    matched,
    parts,
    scaled,
    sign,
    sinc_slope,
    take,
    vanishes,
)


def identity(batch_shape: tuple[int, ...] = (), *, like: Array | None = None) -> Array:
    """No motion, (*batch_shape, 8); float64 NumPy, or of the library and precision of ``like``."""
    real = quat.identity(batch_shape, like=like)
    xp, real = take(real=(real, (4,)))
    return xp.concat([real, xp.zeros_like(real)], axis=-1)


def from_rigid(rotation: Array, translation: Array) -> Array:
    """The motion that rotates by unit quaternions (*B, 4) and then translates by (*B, 3) metres, (*B, 8)."""
    xp, r, t = take(rotation=(rotation, (4,)), translation=(translation, (3,)))
    w, x, y, z = parts(r)
    tx, ty, tz = (0.5 * c for c in parts(t))
    return join(
        xp,
        w, x, y, z,
        -(tx * x + ty * y + tz * z),
        tx * w + (ty * z - tz * y),
        ty * w + (tz * x - tx * z),
        tz * w + (tx * y - ty * x),
    )  # fmt: skip


def to_rigid(d: Array) -> tuple[Array, Array]:
    """Rotation (*B, 4) and translation (*B, 3) in metres of unit dual quaternions (*B, 8)."""
    xp, d = take(d=(d, (8,)))
    return d[..., :4], _translation(xp, d)


def multiply(a: Array, b: Array) -> Array:
    """The motion b followed by a, (*B, 8)."""
    xp, a, b = take(a=(a, (8,)), b=(b, (8,)))
    return _product(xp, a, b)


def conjugate(d: Array) -> Array:
    """The inverse motion of a unit dual quaternion: both parts conjugated, (*B, 8)."""
    xp, d = take(d=(d, (8,)))
    return _conjugate(xp, d)


def normalize(d: Array) -> Array:
    """The unit dual quaternion of d: real part of length 1, dual part perpendicular to it, (*B, 8).

    A dual quaternion whose real part is zero is no motion and becomes the identity.
    """
    xp, d = take(d=(d, (8,)))
    return _normalize(xp, d)


def transform_points(d: Array, points: Array) -> Array:
    """Points (*B, 3) moved by unit dual quaternions (*B, 8)."""
    xp, d, p = take(d=(d, (8,)), points=(points, (3,)))
    return quat.rotate(d[..., :4], p) + _translation(xp, d)


def exp(screw: Array) -> Array:
    """The unit dual quaternion (*B, 8) of half a screw (*B, 6): half-angle vector, then half of the moment.

    Source: Kavan et al. (2008); written with sinc and its slope, so that pure translations need no case.
    """
    xp, v = take(screw=(screw, (6,)))
    return _exp(xp, v)


def log(d: Array) -> Array:
    """Half of the screw motion (*B, 6) of unit dual quaternions (*B, 8): exp(log(d)) = d.

    Exact for pure translations. Where the real part is -1 (a whole turn), whose axis is lost, the motion is taken the short
    way: exp(log(d)) = -d there.
    """
    xp, d = take(d=(d, (8,)))
    whole_turn = (d[..., 0] < 0) & vanishes(xp, dot(xp, d[..., 1:4], d[..., 1:4]))
    one = xp.ones_like(d[..., 0])
    return _log(xp, scaled(xp, xp.where(whole_turn, -one, one), d))


def power(d: Array, exponent: Array) -> Array:
    """The screw motion scaled by ``exponent`` (*B), taken the short way, (*B, 8)."""
    xp, d, e = take(d=(d, (8,)), exponent=(exponent, ()))
    return _power(xp, d, matched(xp, e, d))


def sclerp(a: Array, b: Array, u: Array) -> Array:
    """From a to b by one screw motion at constant speed, the short way, (*B, 8); u (*B) in 0..1 or beyond.

    Exactly a at u = 0. Source: Kavan et al. (2008) (screw linear interpolation): a (a^-1 b)^u.
    """
    xp, a, b, u = take(a=(a, (8,)), b=(b, (8,)), u=(u, ()))
    relative = _product(xp, _conjugate(xp, a), b)
    return _product(xp, a, _power(xp, relative, matched(xp, u, a)))


def blend(d: Array, weights: Array) -> Array:
    """The normalised weighted sum (DLB) of K motions (*B, K, 8) under weights (*B, K), (*B, 8).

    Antipodality: each is brought to the side of the one with the largest weight. Weights need not sum to 1; where their
    sum cancels or all are zero the result is the identity.
    Source: Kavan et al. (2008), dual quaternion linear blending.
    """
    xp, d, w = take(d=(d, (8,)), weights=(weights, ()))
    if d.ndim < 2 or w.ndim < 1 or w.shape[-1] != d.shape[-2]:
        raise ShapeError(f"weights: expected (*B, K) to match d (*B, K, 8), got {tuple(w.shape)} and {tuple(d.shape)}")
    w = matched(xp, w, d)
    if d.shape[-2] == 0:
        return identity(tuple((d[..., 0] + w).shape[:-1]), like=d)  # argmax needs one
    pivots = xp.argmax(w, axis=-1)[..., None] == xp.arange(d.shape[-2], device=array_api_compat.device(d))
    pivot = xp.sum(xp.where(pivots[..., None], d[..., :4], 0.0), axis=-2)
    w = w * sign(xp, dot(xp, d[..., :4], pivot[..., None, :]))
    return _normalize(xp, xp.matmul(w[..., None, :], d)[..., 0, :])


# --- unchecked parts -----------------------------------------------------------------------------------------------------


def _translation(xp: Any, d: Array) -> Array:
    """Twice the vector part of dual times conjugate(real)."""
    w, x, y, z, dw, dx, dy, dz = parts(d)
    tx = w * dx - dw * x + (y * dz - z * dy)
    ty = w * dy - dw * y + (z * dx - x * dz)
    tz = w * dz - dw * z + (x * dy - y * dx)
    return join(xp, tx + tx, ty + ty, tz + tz)


def _conjugate(xp: Any, d: Array) -> Array:
    w, x, y, z, dw, dx, dy, dz = parts(d)
    return join(xp, w, -x, -y, -z, dw, -dx, -dy, -dz)


def _product(xp: Any, a: Array, b: Array) -> Array:
    real = quat.multiply(a[..., :4], b[..., :4])
    dual = quat.multiply(a[..., :4], b[..., 4:]) + quat.multiply(a[..., 4:], b[..., :4])
    return xp.concat([real, dual], axis=-1)


def _normalize(xp: Any, d: Array) -> Array:
    squared = dot(xp, d[..., :4], d[..., :4])
    zero = vanishes(xp, squared)
    factor = xp.where(zero, 0.0, 1.0 / xp.sqrt(xp.where(zero, 1.0, squared)))
    w, x, y, z = (factor * c for c in parts(d[..., :4]))
    dw, dx, dy, dz = (factor * c for c in parts(d[..., 4:]))
    along = w * dw + x * dx + y * dy + z * dz
    dual = (dw - along * w, dx - along * x, dy - along * y, dz - along * z)
    return join(xp, xp.where(zero, 1.0, w), x, y, z, *dual)


def _power(xp: Any, d: Array, exponent: Array) -> Array:
    short = scaled(xp, sign(xp, d[..., 0]), d)
    return _exp(xp, scaled(xp, exponent, _log(xp, short)))


def _exp(xp: Any, screw: Array) -> Array:
    # d/dt of [cos |v|, sinc |v| v] along the moment m.
    x, y, z, mx, my, mz = parts(screw)
    squared = x * x + y * y + z * z
    c, s = cos_sinc(xp, squared)
    along = x * mx + y * my + z * mz
    slope = along * sinc_slope(xp, squared)
    return join(
        xp, c, s * x, s * y, s * z, -s * along, s * mx + slope * x, s * my + slope * y, s * mz + slope * z
    )  # fmt: skip


def _log(xp: Any, d: Array) -> Array:
    # d/dt of (atan2(n, w) / n) v along the dual part, for a unit real part.
    w, x, y, z, dw, dx, dy, dz = parts(d)
    squared = x * x + y * y + z * z
    ratio = angle_ratio(xp, squared, w)
    slope = dw * angle_ratio_gap(xp, squared, w)
    return join(
        xp, ratio * x, ratio * y, ratio * z, ratio * dx - slope * x, ratio * dy - slope * y, ratio * dz - slope * z
    )  # fmt: skip
