"""Frames (4x4 affine matrices, float64) of many poses at once, as the evaluation of rigs needs them.

Arrays have the batch first, (N, 4, 4) or (N, 3, 3); one frame for all poses is (1, 4, 4). Nothing here checks anything.
"""

from __future__ import annotations

import numpy as np

from keypose.arrays import Floats
from keypose.math import quat, rigid
from keypose.model import Pose

EYE = np.eye(4)


def frames_of(pose: Pose, count: int) -> Floats:
    """Local frames of a pose, joint by joint: (J, N, 4, 4), N the batch flattened or 1 where all poses are one."""
    arrays = [np.asarray(a, np.float64) for a in (pose.translations, pose.rotations, pose.scales)]
    # quaternions of files have the length 1 of float32 alone, which would count as a scale
    arrays[1] = arrays[1] / np.maximum(np.sqrt(np.sum(arrays[1] ** 2, axis=-1, keepdims=True)), 1e-300)
    batch = pose.batch_shape
    if not batch or all(a.ndim == 2 for a in arrays):
        return rigid.from_trs(*arrays).reshape(-1, 1, 4, 4)
    matrices = np.broadcast_to(rigid.from_trs(*arrays), (*batch, pose.joint_count, 4, 4))
    return np.ascontiguousarray(np.moveaxis(matrices.reshape(count, pose.joint_count, 4, 4), 1, 0))


def inverse(m: Floats) -> Floats:
    """The inverse of frames."""
    linear = m[..., :3, :3]
    x, y, z = linear[..., 0], linear[..., 1], linear[..., 2]
    rows = np.empty(linear.shape)
    rows[..., 0, :], rows[..., 1, :], rows[..., 2, :] = cross(y, z), cross(z, x), cross(x, y)
    determinant = np.vecdot(rows[..., 0, :], x)[..., None, None]
    flat = determinant == 0  # a scale of 0 has no inverse; its frame sends everything to the origin
    rows = np.where(flat, 0.0, rows / np.where(flat, 1.0, determinant))
    result = np.zeros(m.shape)
    result[..., :3, :3] = rows
    result[..., :3, 3] = -np.matmul(rows, m[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def lengths(linear: Floats) -> Floats:
    """Lengths of the three columns: the scales (..., 3)."""
    return np.sqrt(np.sum(linear * linear, axis=-2))


def rotation(m: Floats) -> Floats:
    """The rotation part (..., 3, 3): X keeps its direction, Y its plane with X; a mirrored frame stays mirrored."""
    x, y, z = (m[..., :3, n] for n in range(3))
    x = unit(x)
    y = unit(y - np.vecdot(x, y)[..., None] * x)
    z = z - np.vecdot(x, z)[..., None] * x - np.vecdot(y, z)[..., None] * y
    return np.stack([x, y, unit(z)], axis=-1)


def stretched(linear: Floats) -> tuple[Floats, Floats]:
    """The rotation (..., 3, 3) and what is left of a linear part, scales and shear: linear = rotation @ rest."""
    turned = rotation(linear)
    return turned, np.swapaxes(turned, -1, -2) @ linear[..., :3, :3]


def frame(linear: Floats, place: Floats) -> Floats:
    """A frame of its linear part (..., 3, 3) and its origin (..., 3)."""
    batch = np.broadcast_shapes(linear.shape[:-2], place.shape[:-1])
    result = np.zeros((*batch, 4, 4))
    result[..., :3, :3] = linear
    result[..., :3, 3] = place
    result[..., 3, 3] = 1.0
    return result


def moved(m: Floats, vector: Floats) -> Floats:
    """Directions (..., 3) turned and scaled by (..., 3, 3) or by frames' linear part."""
    return np.matmul(m[..., :3, :3], vector[..., None])[..., 0]


def about(place: Floats, turn: Floats, m: Floats) -> Floats:
    """Frames turned by (..., 3, 3) about a place (..., 3)."""
    result = np.empty(np.broadcast_shapes(m.shape, (*turn.shape[:-2], 4, 4), (*place.shape[:-1], 4, 4)))
    result[..., :3, :3] = turn @ m[..., :3, :3]
    result[..., :3, 3] = place + moved(turn, m[..., :3, 3] - place)
    result[..., 3, :] = (0.0, 0.0, 0.0, 1.0)
    return result


def unit(v: Floats) -> Floats:
    """Unit vectors; a zero stays zero."""
    size = np.sqrt(np.vecdot(v, v)[..., None])
    return v / np.where(size == 0, 1.0, size)


def across(v: Floats, direction: Floats, instead: Floats) -> Floats:
    """The unit part of ``v`` across a unit direction; of ``instead`` where there is none, then of any axis."""
    result = v - np.vecdot(v, direction)[..., None] * direction
    noise = 1e-12 * np.sqrt(np.vecdot(v, v)[..., None])
    size = np.sqrt(np.vecdot(result, result)[..., None])
    lost = size <= noise
    if np.any(lost):
        axis = np.eye(3)[np.argmin(np.abs(direction), axis=-1)]
        other = instead - np.vecdot(instead, direction)[..., None] * direction
        small = np.sqrt(np.vecdot(other, other)[..., None]) <= 1e-9
        other = np.where(small, axis - np.vecdot(axis, direction)[..., None] * direction, other)
        result = np.where(lost, other, result)
        size = np.sqrt(np.vecdot(result, result)[..., None])
    return result / size


def oriented(along: Floats, normal: Floats) -> Floats:
    """Rotations (..., 3, 3) whose columns are a unit direction, a unit normal across it and their product."""
    along, normal = np.broadcast_arrays(along, normal)
    return np.stack([along, normal, cross(along, normal)], axis=-1)


def spin(axis: Floats, angle: Floats) -> Floats:
    """Rotations (..., 3, 3) about unit axes (..., 3) by angles (...,). Source: Rodrigues' formula."""
    c, s = np.cos(angle)[..., None, None], np.sin(angle)[..., None, None]
    outer = axis[..., :, None] * axis[..., None, :]
    zero = np.zeros(axis.shape[:-1])
    x, y, z = axis[..., 0], axis[..., 1], axis[..., 2]
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*axis.shape[:-1], 3, 3)
    return c * np.eye(3) + s * skew + (1.0 - c) * outer


def to_quat(linear: Floats) -> Floats:
    """Unit quaternions of rotations (..., 3, 3)."""
    return quat.from_matrix(linear)


def to_matrix(q: Floats) -> Floats:
    """Rotations (..., 3, 3) of unit quaternions."""
    return quat.to_matrix(q)


def mixed(a: Floats, b: Floats, share: Floats) -> Floats:
    """From frames a to frames b by shares (N,): places and scales evenly, rotations by slerp; a and b exact at 0 and 1."""
    if np.all(share == 1):
        return b
    if not np.any(share):
        return a
    u = share[..., None]
    place = a[..., :3, 3] + u * (b[..., :3, 3] - a[..., :3, 3])
    sizes_a, sizes_b = lengths(a[..., :3, :3]), lengths(b[..., :3, :3])
    turned = to_matrix(quat.slerp(to_quat(rotation(a)), to_quat(rotation(b)), share))
    result = frame(turned * (sizes_a + u * (sizes_b - sizes_a))[..., None, :], place)
    k = share[..., None, None]
    return np.where(k == 0, a, np.where(k == 1, b, result))


def shared(turn: Floats, share: Floats) -> Floats:
    """A part (0..1, (N,) or number) of rotations (N, 3, 3), the short way."""
    return turn if np.all(np.asarray(share) == 1) else to_matrix(quat.power(to_quat(turn), share))


def cross(a: Floats, b: Floats) -> Floats:
    """The cross product (..., 3); quicker than `numpy.cross` for few."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    x = ay * bz - az * by
    result = np.empty((*x.shape, 3))
    result[..., 0] = x
    result[..., 1] = az * bx - ax * bz
    result[..., 2] = ax * by - ay * bx
    return result
