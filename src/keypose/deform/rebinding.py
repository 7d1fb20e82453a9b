"""Skins on fewer joints: what dropped joints moved is moved by the nearest joint above that is kept."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from keypose.arrays import Array, Ints
from keypose.errors import ShapeError
from keypose.math import rigid
from keypose.model import Mesh, Skeleton, Skin


def nearest_kept(skeleton: Skeleton, kept: Sequence[bool]) -> Ints:
    """For every joint itself where it is kept, else the nearest joint above that is, (J,).

    Raises:
        ShapeError: where ``kept`` does not have J entries, or a root is not kept.
    """
    if len(kept) != skeleton.joint_count:
        raise ShapeError(f"kept: expected {skeleton.joint_count} flags, got {len(kept)}")
    found = np.arange(skeleton.joint_count)
    for joint, parent in enumerate(skeleton.parents.tolist()):
        if not kept[joint]:
            if parent < 0:
                raise ShapeError(f"kept: the root '{skeleton.names[joint]}' cannot be dropped")
            found[joint] = found[parent]
    return found


def rebind(
    mesh: Mesh, binding: Skin, skeleton: Skeleton, kept: Sequence[bool], model_from_joint: Array
) -> tuple[Mesh, Skin]:
    """The mesh and its skin without the joints that are not ``kept`` (J,): their weights go to the nearest joint above.

    Dropped joints keep the place towards that joint which they have in ``model_from_joint`` (J, 4, 4), a relaxed pose:
    a hand without fingers does not open. What one kept joint moves, with dropped ones below, comes out exactly as if the
    dropped joints stood still; the rest is as near as a blend can be. Morph targets are not turned.

    Raises:
        ShapeError: where shapes do not fit, or a root is not kept.
    """
    model_from_joint = np.asarray(model_from_joint, np.float64)
    if model_from_joint.shape != (skeleton.joint_count, 4, 4):
        raise ShapeError(
            f"model_from_joint: expected {(skeleton.joint_count, 4, 4)} to match the skeleton, got {model_from_joint.shape}"
        )
    above = nearest_kept(skeleton, kept)
    palette = np.asarray(binding.palette)
    targets = above[palette]
    bind = np.asarray(binding.joint_from_mesh, np.float64)
    carried = np.linalg.inv(model_from_joint[targets]) @ model_from_joint[palette] @ bind  # target_from_mesh
    # Where a kept joint is in no palette, its own bind is what stands in for it: the first of those it takes over.
    joints, slots = np.unique(targets, return_inverse=True)
    slots = slots.reshape(-1)
    own = {int(joint): p for p, joint in enumerate(palette) if targets[p] == joint}
    first = [own.get(int(joint), int(np.argmax(slots == n))) for n, joint in enumerate(joints)]
    binds = np.where((palette[first] == joints)[:, None, None], bind[first], carried[first])
    # In the bind pose every kept joint's matrix is the identity; a dropped one's says where its vertices now are.
    moves = np.linalg.inv(binds[slots]) @ carried
    moves[palette == targets] = np.eye(4)
    weights = np.asarray(binding.weights, np.float64)
    blended = np.einsum("vk,vkrc->vrc", weights, moves[binding.joints])
    blended[:, 3, 3] = 1.0
    total = weights.sum(axis=1)
    blended[:, :3] /= np.where(total > 0, total, 1.0)[:, None, None]
    blended[total <= 0] = np.eye(4)
    positions = rigid.transform_points(blended, np.asarray(mesh.positions, np.float64))
    normals = mesh.normals
    if normals is not None:
        turned = np.einsum("vrc,vc->vr", blended[:, :3, :3], np.asarray(normals, np.float64))
        normals = turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-30)
        normals = normals.astype(mesh.normals.dtype)  # type: ignore[union-attr]
    moved = Mesh(
        positions.astype(mesh.positions.dtype), mesh.triangles, normals, mesh.uvs, mesh.colors, mesh.attributes
    )
    dense = np.zeros((len(weights), len(joints)))
    np.add.at(dense, (np.arange(len(weights))[:, None], slots[binding.joints]), weights)
    width = min(weights.shape[1], len(joints))
    order = np.argsort(-dense, axis=1, kind="stable")[:, :width]
    kept_weights = np.take_along_axis(dense, order, axis=1).astype(binding.weights.dtype)
    return moved, Skin(
        joints.astype(np.int32),
        binds.astype(binding.joint_from_mesh.dtype),
        np.where(kept_weights > 0, order, 0).astype(np.int32),
        kept_weights,
        binding.method,
    )
