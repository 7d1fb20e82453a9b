"""Skinning: linear blend and dual quaternions, any number of influences, positions and normals.

Everything is array-API generic and differentiable.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from keypose.arrays import Array, Ints, checked, gather, namespace, unified
from keypose.deform.compiled import skin_compiled
from keypose.errors import ShapeError, UnknownName
from keypose.math import dualquat, quat, rigid
from keypose.model import Mesh, Skin, SkinningMethod


def skin_matrices(binding: Skin, model_from_joint: Array) -> Array:
    """What each joint of the palette does to the mesh, ``model_from_mesh = model_from_joint @ joint_from_mesh``.

    Shapes: ``model_from_joint`` (*B, J, 4, 4) of the whole skeleton; returns (*B, P, 4, 4).

    Raises:
        ShapeError: where the palette names a joint that is not there.

    Source: lecture notes, "Skinning" (bind pose and inverse bind pose).
    """
    checked(model_from_joint, (..., "J", 4, 4), "model_from_joint")
    if len(binding.palette) and int(binding.palette.max()) >= model_from_joint.shape[-3]:
        raise ShapeError(
            f"model_from_joint: the skin uses joint {int(binding.palette.max())}, there are {model_from_joint.shape[-3]}"
        )
    model_from_joint, joint_from_mesh = unified(model_from_joint, binding.joint_from_mesh)
    xp = namespace(model_from_joint)
    return xp.matmul(gather(model_from_joint, binding.palette, -3), joint_from_mesh)


def skin(
    mesh: Mesh,
    binding: Skin,
    model_from_joint: Array,
    method: SkinningMethod | str | None = None,
    with_normals: bool = False,
) -> Any:
    """The mesh's vertices moved by the skeleton.

    Shapes and units: ``model_from_joint`` (*B, J, 4, 4); returns positions (*B, V, 3) in metres, or with
    ``with_normals`` the pair of positions and unit normals (*B, V, 3). See `skin_points`.

    Raises:
        ShapeError: where skin, mesh and skeleton do not fit, or normals are asked of a mesh that has none.
    """
    checked(binding.joints, (mesh.vertex_count, "K"), "skin", "the mesh's vertices")
    matrices = skin_matrices(binding, model_from_joint)
    positions, normals = skin_points(mesh.positions, _normals(mesh, with_normals), binding, matrices, method)
    return (positions, normals) if with_normals else positions


def skin_points(
    positions: Array,
    normals: Array | None,
    binding: Skin,
    matrices: Array,
    method: SkinningMethod | str | None = None,
) -> tuple[Array, Array | None]:
    """Points and normals of any batch moved by palette matrices.

    Shapes and units: ``positions`` and ``normals`` (*B, V, 3), for example morphed ones; ``matrices`` (*B, P, 4, 4) of
    `skin_matrices`. Returns both as (*B, V, 3). ``method`` is the skin's own if not given.

    "linear" is the weighted sum of the matrices. "dual_quaternion" keeps volume in twists: what scales and shears is
    applied first, as a linear blend in the mesh's space, and the rigid rest is blended as dual quaternions on the side
    of each vertex's strongest influence. Normals are moved without translation by the inverse transpose of each
    joint's matrix, its uniform scale left out, so that they stay right under non-uniform scale and mirroring; without
    scale that is the rotation itself.

    Raises:
        UnknownName: for another method.

    Source: lecture notes, "Skinning": ``T(v) = sum_j w_j R_j v``; Kavan, Collins, Zara, O'Sullivan, Skinning with Dual
    Quaternions, I3D 2007 (section 4), and Geometric Skinning with Approximate Dual Quaternion Blending, TOG 2008
    (two-phase skinning of scale).
    """
    method = binding.method if method is None else method
    if method not in tuple(SkinningMethod):
        raise UnknownName("skinning method", method, SkinningMethod)
    if not binding.influence_count:
        raise ShapeError("skin: expected at least one influence per vertex, got 0")
    if normals is None:
        positions, matrices, weights = unified(positions, matrices, binding.weights)
    else:
        positions, matrices, weights, normals = unified(positions, matrices, binding.weights, normals)
    if method == SkinningMethod.LINEAR:
        return _linear(positions, normals, binding, weights, matrices)
    return _dual_quaternion(positions, normals, binding, weights, matrices)


def transform_normals(matrices: Array, normals: Array) -> Array:
    """Normals (*B, V, 3) moved by one matrix each (*B, 4, 4): inverse transpose, normalised."""
    matrices, normals = unified(matrices, normals)
    xp = namespace(normals)
    return _unit(xp, xp.matmul(normals, xp.matrix_transpose(_normal_matrices(matrices))))


# --- the two methods --------------------------------------------------------------------------------------------------


def _linear(
    positions: Array, normals: Array | None, binding: Skin, weights: Array, matrices: Array
) -> tuple[Array, Array | None]:
    turning = None if normals is None else _normal_matrices(matrices)
    compiled = skin_compiled(positions, normals, binding, weights, matrices, turning)
    if compiled is not None:
        return compiled
    xp = namespace(matrices)
    blended = _blended(xp, matrices[..., :3, :], binding.joints, weights)
    moved = _apply(xp, blended[..., :3], positions) + blended[..., 3]
    if normals is None:
        return moved, None
    return moved, _unit(xp, _apply(xp, _blended(xp, turning, binding.joints, weights), normals))


def _dual_quaternion(
    positions: Array, normals: Array | None, binding: Skin, weights: Array, matrices: Array
) -> tuple[Array, Array | None]:
    xp = namespace(matrices)
    translations, rotations, _ = rigid.to_trs(matrices)
    # The matrix is rotation * stretch, whatever rotation was found: the split is exact under shear and mirroring too.
    stretches = xp.matmul(xp.matrix_transpose(quat.to_matrix(rotations)), matrices[..., :3, :3])
    motions = _blended_motions(xp, dualquat.from_rigid(rotations, translations), binding, weights)
    stretched = _apply(xp, _blended(xp, stretches, binding.joints, weights), positions)
    moved = dualquat.transform_points(motions, stretched)
    if normals is None:
        return moved, None
    turned = _apply(xp, _blended(xp, _normal_matrices(stretches), binding.joints, weights), normals)
    return moved, _unit(xp, quat.rotate(motions[..., :4], turned))


def _blended_motions(xp: Any, motions: Array, binding: Skin, weights: Array) -> Array:
    """Unit dual quaternions per vertex (*B, V, 8), from the palette's (*B, P, 8)."""
    joints = binding.joints
    strongest = np.argmax(np.asarray(binding.weights), axis=1)
    pivot = gather(motions, joints[np.arange(len(joints)), strongest], -2)[..., :4]
    total = 0.0
    for k in range(joints.shape[1]):
        motion = gather(motions, joints[:, k], -2)
        # q and -q are one motion: add on the side of the strongest influence, so that the sum cannot vanish.
        side = xp.sum(motion[..., :4] * pivot, axis=-1, keepdims=True)
        total = total + xp.where(side < 0, -weights[:, k, None], weights[:, k, None]) * motion
    return dualquat.normalize(total)


# --- pieces -----------------------------------------------------------------------------------------------------------


def _normals(mesh: Mesh, wanted: bool) -> Array | None:
    if wanted and mesh.normals is None:
        raise ShapeError("normals: the mesh has none")
    return mesh.normals if wanted else None


def _blended(xp: Any, matrices: Array, joints: Ints, weights: Array) -> Array:
    """Weighted sums (*B, V, 3, C) of palette matrices (*B, P, 3, C)."""
    total = 0.0
    for k in range(joints.shape[1]):
        total = total + weights[:, k, None, None] * gather(matrices, joints[:, k], -3)
    return total


def _apply(xp: Any, matrices: Array, vectors: Array) -> Array:
    return xp.matmul(matrices, vectors[..., None])[..., 0]


def _normal_matrices(matrices: Array) -> Array:
    """Inverse transposes of (*B, 4, 4) or (*B, 3, 3) with the uniform part of the scale left out: (*B, 3, 3).

    By cofactors, so that a matrix that flattens the mesh has one too: it sends all normals to that of the plane.
    """
    xp = namespace(matrices)
    x, y, z = matrices[..., :3, 0], matrices[..., :3, 1], matrices[..., :3, 2]
    cofactors = xp.stack([xp.linalg.cross(y, z), xp.linalg.cross(z, x), xp.linalg.cross(x, y)], axis=-1)
    determinant = xp.sum(x * cofactors[..., 0], axis=-1)
    flat = determinant == 0
    size = xp.where(flat, xp.ones_like(determinant), xp.abs(determinant)) ** (2 / 3)
    return cofactors * (xp.where(determinant < 0, -xp.ones_like(size), xp.ones_like(size)) / size)[..., None, None]


def _length(xp: Any, vectors: Array) -> Array:
    """Lengths along the last axis, 1 for zero vectors."""
    squared = xp.sum(vectors * vectors, axis=-1, keepdims=True)
    return xp.sqrt(xp.where(squared == 0, xp.ones_like(squared), squared))


def _unit(xp: Any, vectors: Array) -> Array:
    return vectors / _length(xp, vectors)
