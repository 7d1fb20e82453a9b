"""Forward kinematics: from local transforms to the model's space.

Joints of one depth are handled together: a skeleton of 100 joints takes about 15 steps, whatever the batch.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from keypose.arrays import Array, Ints, checked, gather, namespace, unified
from keypose.evaluate.compiled import kernels_for
from keypose.math import quat, rigid
from keypose.model import Pose, Skeleton


def world(skeleton: Skeleton, pose: Pose) -> Array:
    """The transform of every joint in the model's space, ``model_from_joint``.

    Shapes and units: a pose of batch shape (*B,); returns (*B, J, 4, 4), metres. Scale is handled as glTF does: every
    joint is translation * rotation * scale and the 4x4 matrices are multiplied, so that a non-uniform scale above a
    rotation gives shear.

    Raises:
        ShapeError: where pose and skeleton have different numbers of joints.

    Source: lecture notes, "Skeletal Animation": ``P = R0 (R1 (O2) + O1) + O0``; glTF 2.0 specification, 3.5.3.
    """
    _checked_pose(skeleton, pose)
    translations, rotations, scales = unified(pose.translations, pose.rotations, pose.scales)
    fk = kernels_for("fk", _work(pose), translations, rotations, scales)
    if fk is not None:
        batch, joints = pose.batch_shape, pose.joint_count
        scales = None if np.all(scales == 1) else _frames(scales, batch)
        chained = fk.matrices(skeleton.parents, _all_frames(rotations, batch), _frames(translations, batch), scales)
        return chained.reshape(*batch, joints, 4, 4)
    return _chain(rigid.from_trs(translations, rotations, scales), skeleton.parents)


def world_rotations_positions(skeleton: Skeleton, pose: Pose) -> tuple[Array, Array]:
    """Rotations and positions of every joint in the model's space.

    Shapes and units: a pose of batch shape (*B,); returns quaternions (*B, J, 4) and metres (*B, J, 3). The rotations
    are products of the local rotations; scales move the positions, exactly as in `world`, but do not enter the
    rotations (under non-uniform scale a joint's matrix holds shear that no rotation can say).

    Raises:
        ShapeError: where pose and skeleton have different numbers of joints.
    """
    _checked_pose(skeleton, pose)
    translations, rotations, scales = unified(pose.translations, pose.rotations, pose.scales)
    xp = namespace(rotations)
    batch = pose.batch_shape
    scaled = not (isinstance(scales, np.ndarray) and np.all(scales == 1))
    # Under scale the positions come from the matrices.
    fk = kernels_for("fk", _work(pose), translations, rotations, scales)
    if fk is not None:
        offsets = np.zeros((pose.joint_count, 3), rotations.dtype) if scaled else translations
        turned, moved = fk.rotations_positions(skeleton.parents, _all_frames(rotations, batch), _frames(offsets, batch))
        turned, moved = turned.reshape(*batch, -1, 4), moved.reshape(*batch, -1, 3)
    elif scaled:
        full = xp.broadcast_to(rotations, (*batch, *rotations.shape[-2:]))
        (turned,) = _walk(skeleton.parents, (full,), lambda up, own: (quat.multiply(up[0], own[0]),))
        moved = None
    else:
        full = tuple(xp.broadcast_to(a, (*batch, *a.shape[-2:])) for a in (rotations, translations))
        turned, moved = _walk(
            skeleton.parents,
            full,
            lambda up, own: (quat.multiply(up[0], own[0]), up[1] + quat.rotate(up[0], own[1])),
        )
    return turned, world(skeleton, pose)[..., :3, 3] if scaled else moved


def local(skeleton: Skeleton, model_from_joint: Array) -> Array:
    """The inverse of `world`: ``parent_from_joint`` (*B, J, 4, 4) from ``model_from_joint``.

    Raises:
        ShapeError: where the number of joints differs.
    """
    (model_from_joint,) = unified(
        checked(model_from_joint, (..., skeleton.joint_count, 4, 4), "model_from_joint", "the skeleton")
    )
    xp = namespace(model_from_joint)
    roots = skeleton.parents < 0
    model_from_parent = gather(model_from_joint, np.where(roots, 0, skeleton.parents), -3)
    parent_from_joint = xp.matmul(rigid.inverse(model_from_parent), model_from_joint)
    return xp.where(xp.asarray(roots)[:, None, None], model_from_joint, parent_from_joint)


@lru_cache(maxsize=64)
def _levels(parents: bytes) -> tuple[tuple[tuple[Ints, Ints], ...], Ints]:
    """Per depth: the joints and where their parents stand among the joints handled before; and the way back.

    The first level's second array is empty: roots have no parent.
    """
    above = np.frombuffer(parents, np.int32)
    depths = np.zeros(len(above), np.int32)
    for joint, parent in enumerate(above):
        depths[joint] = depths[parent] + 1 if parent >= 0 else 0
    order = np.argsort(depths, kind="stable")
    place = np.empty(len(above), np.intp)
    place[order] = np.arange(len(above))
    levels = [np.nonzero(depths == depth)[0] for depth in range(int(depths.max(initial=-1)) + 1)]
    steps: list[tuple[Ints, Ints]] = []
    start = 0
    for depth, joints in enumerate(levels):
        # Parents are all in the level just before: count their place from its start.
        steps.append((joints, place[above[joints]] - start if depth else joints[:0]))
        start += len(levels[depth - 1]) if depth else 0
    return tuple(steps), place


def _checked_pose(skeleton: Skeleton, pose: Pose) -> None:
    checked(
        pose.rotations, (..., skeleton.joint_count, 4), "rotations", f"the skeleton's {skeleton.joint_count} joints"
    )


def _work(pose: Pose) -> int:
    return math.prod(pose.batch_shape) * pose.joint_count


def _all_frames(array: Array, batch: tuple[int, ...]) -> Array:
    """(*B, J, C) as the kernels' (F, J, C)."""
    return np.broadcast_to(array, (*batch, *array.shape[-2:])).reshape(-1, *array.shape[-2:])


def _frames(array: Array, batch: tuple[int, ...]) -> Array:
    """The same, but what is one for all frames stays (J, C)."""
    return array if array.ndim == 2 else _all_frames(array, batch)


def _walk(parents: Ints, local: tuple[Array, ...], combine: Any) -> tuple[Array, ...]:
    """Local values (*B, J, C) combined down the hierarchy, level by level."""
    xp = namespace(*local)
    steps, place = _levels(parents.tobytes())
    done: list[tuple[Array, ...]] = []
    for joints, above in steps:
        own = tuple(gather(a, joints, -2) for a in local)
        done.append(combine(tuple(gather(a, above, -2) for a in done[-1]), own) if done else own)
    if not done:
        return local
    return tuple(gather(xp.concat([level[i] for level in done], axis=-2), place, -2) for i in range(len(local)))


def _chain(parent_from_joint: Array, parents: Ints) -> Array:
    """Products of matrices (*B, J, 4, 4) down the hierarchy."""
    xp = namespace(parent_from_joint)
    steps, place = _levels(parents.tobytes())
    if isinstance(parent_from_joint, np.ndarray):
        result = np.array(parent_from_joint)
        for depth, (joints, _) in enumerate(steps):
            if depth:
                result[..., joints, :, :] = result[..., parents[joints], :, :] @ parent_from_joint[..., joints, :, :]
        return result
    done: list[Array] = []
    for joints, above in steps:
        own = gather(parent_from_joint, joints, -3)
        done.append(xp.matmul(gather(done[-1], above, -3), own) if done else own)
    return gather(xp.concat(done, axis=-3), place, -3) if done else parent_from_joint
