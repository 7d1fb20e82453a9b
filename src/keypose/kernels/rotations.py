# pyright: basic
"""Quaternions (w, x, y, z) and matrices held in vectors: one rotation per lane."""

from __future__ import annotations

from keypose.kernels.runtime import inlined
from keypose.kernels.vectors import add_halves, load, store


@inlined
def quat_dot(aw, ax, ay, az, bw, bx, by, bz):
    """The cosine of half the angle between two unit quaternions."""
    return add_halves(aw * bw + ax * bx, ay * by + az * bz)


@inlined
def quat_multiply(aw, ax, ay, az, bw, bx, by, bz):
    """The Hamilton product a * b: first b, then a."""
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


@inlined
def quat_rotate(w, x, y, z, px, py, pz):
    """A point turned by a unit quaternion: p + 2w (u x p) + 2u x (u x p)."""
    dx, dy, dz = px + px, py + py, pz + pz
    tx, ty, tz = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
    return (
        px + w * tx + y * tz - z * ty,
        py + w * ty + z * tx - x * tz,
        pz + w * tz + x * ty - y * tx,
    )


@inlined
def quat_matrix(w, x, y, z):
    """The nine entries of the rotation matrix of a unit quaternion, row by row."""
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz = x * y2, x * z2, y * z2
    wx, wy, wz = w * x2, w * y2, w * z2
    return (
        1.0 - yy - zz,
        xy - wz,
        xz + wy,
        xy + wz,
        1.0 - xx - zz,
        yz - wx,
        xz - wy,
        yz + wx,
        1.0 - xx - yy,
    )


@inlined
def load3(array, at, stride):
    """Three vectors, ``stride`` elements apart."""
    return load(array, at), load(array, at + stride), load(array, at + 2 * stride)


@inlined
def load4(array, at, stride):
    """Four vectors, ``stride`` elements apart."""
    return load(array, at), load(array, at + stride), load(array, at + 2 * stride), load(array, at + 3 * stride)


@inlined
def store3(array, at, stride, a, b, c):
    """Three vectors, ``stride`` elements apart."""
    store(array, at, a)
    store(array, at + stride, b)
    store(array, at + 2 * stride, c)


@inlined
def store4(array, at, stride, a, b, c, d):
    """Four vectors, ``stride`` elements apart."""
    store3(array, at, stride, a, b, c)
    store(array, at + 3 * stride, d)
