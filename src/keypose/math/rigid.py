"""Transforms as translation, rotation, scale (TRS) and as 4x4 matrices for column vectors.

A matrix ``parent_from_joint`` holds the joint's axes (times their scales) in its columns and its origin in the last one;
it is T R S. All batch shapes broadcast, float32 stays float32.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.math import quat
from keypose.math.elementary import beside, cross, dot, eps, join, norm, parts, take, unit


def from_trs(translation: Array, rotation: Array, scale: Array | None = None) -> Array:
    """The matrix T R S (*B, 4, 4) of translations (*B, 3), unit quaternions (*B, 4) and scales (*B, 3), default 1."""
    if scale is None:
        xp, t, r = take(translation=(translation, (3,)), rotation=(rotation, (4,)))
    else:
        xp, t, r, s = take(translation=(translation, (3,)), rotation=(rotation, (4,)), scale=(scale, (3,)))
    w, x, y, z = parts(r)
    tx, ty, tz = parts(t)
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz = x * y2, x * z2, y * z2
    wx, wy, wz = w * x2, w * y2, w * z2
    m00, m01, m02 = 1.0 - yy - zz, xy - wz, xz + wy
    m10, m11, m12 = xy + wz, 1.0 - xx - zz, yz - wx
    m20, m21, m22 = xz - wy, yz + wx, 1.0 - xx - yy
    if scale is not None:
        sx, sy, sz = parts(s)  # pyright: ignore[reportPossiblyUnboundVariable]
        m00, m10, m20 = m00 * sx, m10 * sx, m20 * sx
        m01, m11, m21 = m01 * sy, m11 * sy, m21 * sy
        m02, m12, m22 = m02 * sz, m12 * sz, m22 * sz
    zero = xp.zeros_like(m00)
    entries = join(
        xp, m00, m01, m02, tx, m10, m11, m12, ty, m20, m21, m22, tz, zero, zero, zero, xp.ones_like(zero)
    )  # fmt: skip
    return xp.reshape(entries, (*entries.shape[:-1], 4, 4))


def to_trs(matrix: Array) -> tuple[Array, Array, Array]:
    """Translation (*B, 3), rotation (*B, 4) and scale (*B, 3) of affine matrices (*B, 4, 4).

    from_trs(*to_trs(m)) is m for every product T R S, also with negative or zero scales:
    a negative determinant is put into the scale of X (always X, so that neighbouring frames agree), and an axis whose
    scale is zero is completed from the other two to a right-handed frame. Where only one is left, the rotation is the
    shortest that leads to it; where none is left, the identity.
    Shear, which TRS cannot hold, is dropped: the X axis keeps its direction and Y stays in the plane of X and Y.
    """
    xp, m = take(matrix=(matrix, (4, 4)))
    x, y, z = m[..., :3, 0], m[..., :3, 1], m[..., :3, 2]
    scales = join(xp, norm(xp, x), norm(xp, y), norm(xp, z))
    x, y, z = unit(xp, x), unit(xp, y), unit(xp, z)
    mirrored = (dot(xp, cross(xp, x, y), z) < 0)[..., None]
    sign = xp.where(mirrored, beside(xp, (-1.0, 1.0, 1.0), m), beside(xp, (1.0, 1.0, 1.0), m))
    x = xp.where(mirrored, -x, x)
    x, y, z = _complete_frame(xp, x, y, z)
    return m[..., :3, 3], quat.from_axes(x, y, z), sign * scales


def inverse(matrix: Array) -> Array:
    """The inverse (*B, 4, 4) of affine matrices; shear and scale are allowed.

    A matrix that flattens space (determinant exactly 0) has none: it gets a zero linear part, which sends everything to
    the origin and stays finite. Raises nothing, because a scale may pass through zero for one frame of a clip.
    """
    xp, m = take(matrix=(matrix, (4, 4)))
    x, y, z, t = m[..., :3, 0], m[..., :3, 1], m[..., :3, 2], m[..., :3, 3]
    rows = (cross(xp, y, z), cross(xp, z, x), cross(xp, x, y))
    determinant = dot(xp, x, rows[0])
    flat = determinant == 0
    factor = xp.where(flat, 0.0, 1.0 / xp.where(flat, 1.0, determinant))[..., None]
    entries: list[Array] = []
    for row in rows:
        row = factor * row
        entries += [*parts(row), -dot(xp, row, t)]
    zero = xp.zeros_like(determinant)
    out = join(xp, *entries, zero, zero, zero, xp.ones_like(zero))
    return xp.reshape(out, (*out.shape[:-1], 4, 4))


def compose(a: Array, b: Array) -> Array:
    """The matrix product a b (*B, 4, 4): ``a_from_c = compose(a_from_b, b_from_c)``."""
    xp, a, b = take(a=(a, (4, 4)), b=(b, (4, 4)))
    return xp.matmul(a, b)


def transform_points(matrix: Array, points: Array) -> Array:
    """Points (*B, 3) moved by affine matrices (*B, 4, 4); batch shapes broadcast, so one matrix moves any cloud."""
    _, m, p = take(matrix=(matrix, (4, 4)), points=(points, (3,)))
    return _linear(m, p) + m[..., :3, 3]


def transform_vectors(matrix: Array, vectors: Array) -> Array:
    """Directions and velocities (*B, 3) turned and scaled, but not moved, by affine matrices (*B, 4, 4)."""
    _, m, v = take(matrix=(matrix, (4, 4)), vectors=(vectors, (3,)))
    return _linear(m, v)


def _linear(m: Array, v: Array) -> Array:
    return v[..., :1] * m[..., :3, 0] + v[..., 1:2] * m[..., :3, 1] + v[..., 2:] * m[..., :3, 2]


def _complete_frame(xp: Any, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """A right-handed orthonormal frame from axes that are unit or zero: x leads, then y, then z."""
    noise = 4 * eps(xp, x)

    def missing(v: Array) -> Array:
        return dot(xp, v, v) <= noise * noise

    def choose(condition: Array, a: Array, b: Array) -> Array:
        return xp.where(condition[..., None], a, b)

    normal = cross(xp, x, y)
    lost = missing(normal)  # x or y is missing, or they are parallel
    if not isinstance(x, np.ndarray) or np.any(lost):
        # X: itself, else from y and z, else where the shortest rotation to the only axis left takes it.
        from_yz = cross(xp, y, z)
        by_y, by_z = (_led_by(xp, i, axis)[0] for i, axis in ((1, y), (2, z)))
        alone = choose(missing(y), by_z, by_y)
        x = choose(missing(x), choose(missing(from_yz), alone, unit(xp, from_yz)), x)
        # The normal of X and Y: from y, else from z, else where the shortest rotation to x takes Z.
        normal_y, y_from_z = cross(xp, x, y), cross(xp, z, x)
        last = choose(missing(y_from_z), _led_by(xp, 0, x)[2], cross(xp, x, y_from_z))
        normal = choose(missing(normal_y), last, normal_y)
    z = unit(xp, normal)
    return x, cross(xp, z, x), z


def _led_by(xp: Any, index: int, axis: Array) -> tuple[Array, ...]:
    """X, Y, Z after the shortest rotation that takes the one of that index to ``axis``; unchanged where it is zero."""
    basis = beside(xp, [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)], axis)
    turned = quat.to_matrix(quat.from_two_vectors(basis[index, :], axis))
    return turned[..., 0], turned[..., 1], turned[..., 2]
