"""Blending of poses: weighted means, additive layers and the differences that make them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from keypose.arrays import Array, as_float, checked, namespace, unified
from keypose.errors import ShapeError
from keypose.math import quat
from keypose.model import Pose


def blend(poses: Sequence[Pose], weights: Any, mask: Any = None) -> Pose:
    """The weighted mean of N poses.

    Shapes: poses of broadcastable batch shapes (*B,); ``weights`` (*B, N), >= 0, of any sum; ``mask`` (J,) or (N, J)
    multiplies the weights joint by joint, a mask (J,) those of all poses but the first, so that the others lie over it.
    Returns batch shape (*B,). Rotations are summed on the short side of what is summed so far and normalised; a joint
    whose weights are all zero keeps the first pose.

    Raises:
        ShapeError: where numbers disagree or a weight is negative.

    Source: lecture notes, "Interpolating Rotations"; for two poses this is nlerp.
    """
    if not poses:
        raise ShapeError("poses: expected at least one pose to blend")
    joints = poses[0].joint_count
    for pose in poses:
        checked(pose.rotations, (..., joints, 4), "rotations", "the first pose")
    weights = checked(as_float(weights), (..., len(poses)), "weights", f"{len(poses)} poses")
    _not_negative(weights, "weights")
    translations = unified(weights, *(p.translations for p in poses))
    rotations = unified(weights, *(p.rotations for p in poses))
    scales = unified(weights, *(p.scales for p in poses))
    shares = _shares(weights, _full_mask(mask, len(poses), joints), rotations[0])
    return Pose(
        _mean(translations[1:], shares),
        _mean_rotation(rotations[1:], shares),
        _mean(scales[1:], shares),
    )


def difference(pose: Pose, reference: Pose) -> Pose:
    """What has to be added to ``reference`` to get ``pose``: ``add(reference, difference(pose, reference), 1)`` is ``pose``.

    Shapes: broadcastable batch shapes. Rotations are in the joint's own frame (reference^-1 * pose), translations are
    subtracted, scales divided; where the reference's scale is zero the ratio is undefined and taken as 1.
    """
    t, rt = unified(pose.translations, reference.translations)
    r, rr = unified(pose.rotations, reference.rotations)
    s, rs = unified(pose.scales, reference.scales)
    xp = namespace(s)
    ratio = xp.where(rs == 0, xp.ones_like(rs), s / xp.where(rs == 0, xp.ones_like(rs), rs))
    return Pose(t - rt, quat.multiply(quat.conjugate(rr), r), ratio)


def add(pose: Pose, delta: Pose, weight: Any = 1.0, mask: Any = None) -> Pose:
    """A pose with an additive layer: rotation ``pose * power(delta, weight)``, translation ``pose + weight * delta``.

    Shapes: broadcastable batch shapes (*B,); ``weight`` (*B,), any real number; ``mask`` (J,) multiplies it joint by
    joint. A scale is multiplied by ``1 + weight * (delta - 1)``. A rotation is taken the short way.

    Source: lecture notes, "Rotations": vector addition becomes multiplication, scaling scales the angle.
    """
    weight = as_float(weight)
    mask = 1.0 if mask is None else checked(as_float(mask), (pose.joint_count,), "mask", "the joints")
    amount = weight[..., None] * mask if hasattr(mask, "shape") else weight[..., None]
    t, dt, wt = _in_precision(pose.translations, delta.translations, amount)
    r, dr, wr = _in_precision(pose.rotations, delta.rotations, amount)
    s, ds, ws = _in_precision(pose.scales, delta.scales, amount)
    xp = namespace(dr)
    short = xp.where(dr[..., :1] < 0, -dr, dr)
    return Pose(
        t + wt[..., None] * dt,
        quat.normalize(quat.multiply(r, quat.power(short, wr))),
        s * (1 + ws[..., None] * (ds - 1)),
    )


def _in_precision(own: Array, other: Array, amount: Array) -> tuple[Array, Array, Array]:
    """The three in one library; plain NumPy weights do not raise the precision of the pose."""
    if isinstance(own, np.ndarray) and isinstance(other, np.ndarray) and isinstance(amount, np.ndarray):
        return own, other, amount.astype(np.result_type(own, other))
    own, other, amount = unified(own, other, amount)
    return own, other, amount


def _not_negative(weights: Array, name: str) -> None:
    if isinstance(weights, np.ndarray) and not (np.all(np.isfinite(weights)) and np.all(weights >= 0)):
        raise ShapeError(f"{name}: expected finite numbers >= 0")


def _full_mask(mask: Any, poses: int, joints: int) -> Array | None:
    if mask is None:
        return None
    mask = as_float(mask)
    _not_negative(mask, "mask")
    if mask.ndim == 1:
        checked(mask, (joints,), "mask", "the joints")
        xp = namespace(mask)
        return xp.stack([xp.ones_like(mask)] + [mask] * (poses - 1), axis=0)
    return checked(mask, (poses, joints), "mask", "poses and joints")


def _shares(weights: Array, mask: Array | None, like: Array) -> list[Array]:
    """Per pose the share (*B, J or 1, 1) of each joint; they sum to 1."""
    if mask is not None:
        weights, mask = unified(weights, mask)
        weights = weights[..., None] * mask
    else:
        weights = weights[..., None]
    xp = namespace(weights)
    total = xp.sum(weights, axis=-2, keepdims=True)
    nothing = total == 0
    first = xp.zeros_like(weights) + xp.astype(xp.arange(weights.shape[-2])[:, None] == 0, weights.dtype)
    shares = xp.where(nothing, first, weights / xp.where(nothing, xp.ones_like(total), total))
    return [shares[..., n, :, None] for n in range(weights.shape[-2])]


def _mean(arrays: Sequence[Array], shares: Sequence[Array]) -> Array:
    total = 0.0
    for array, share in zip(arrays, shares, strict=True):
        total = total + _as_type(share, array) * array
    return total


def _mean_rotation(arrays: Sequence[Array], shares: Sequence[Array]) -> Array:
    xp = namespace(arrays[0])
    total: Array = None
    for array, share in zip(arrays, shares, strict=True):
        share = _as_type(share, array)
        if total is None:
            total = share * array
            continue
        # q and -q are one rotation: add on the side of the sum so far, which can then never shrink to nothing.
        side = xp.sum(total * array, axis=-1, keepdims=True)
        total = total + xp.where(side < 0, -share, share) * array
    return quat.normalize(total)


def _as_type(share: Array, like: Array) -> Array:
    xp = namespace(like)
    return share if share.dtype == like.dtype else xp.astype(unified(share, like)[0], like.dtype)
