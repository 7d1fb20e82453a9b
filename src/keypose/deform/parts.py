"""Whole characters: morphs first, then the skin or the one joint that a part hangs on."""

from __future__ import annotations

from typing import Any

from keypose.arrays import Array, as_float, checked, gather, unified
from keypose.deform.morphing import morph
from keypose.deform.skinning import skin_matrices, skin_points, transform_normals
from keypose.errors import ShapeError
from keypose.math import rigid
from keypose.model import Character, Part, SkinningMethod


def deform_part(
    character: Character,
    part: Part,
    model_from_joint: Array,
    morph_weights: Array | None = None,
    with_normals: bool = False,
    method: SkinningMethod | str | None = None,
) -> Any:
    """One part of a character in the model's space: morphed, then skinned or carried by its joint.

    Shapes and units: ``model_from_joint`` (*B, J, 4, 4); ``morph_weights`` (*B, M) of the character's morph channels,
    its rest weights if not given. Returns positions (*B, V, 3) in metres, or with ``with_normals`` positions and unit
    normals. ``method`` as in `skin`.

    Raises:
        ShapeError: where shapes do not fit the character, or normals are asked of a mesh that has none.
    """
    joints = character.skeleton.joint_count
    checked(model_from_joint, (..., joints, 4, 4), "model_from_joint", f"the character's {joints} joints")
    mesh, normals = part.mesh, None
    if with_normals and mesh.normals is None:
        raise ShapeError(f"part '{part.name}': its mesh has no normals")
    channels = part.morph_channels  # set whenever there are morphs
    if part.morphs is not None and channels is not None and len(channels):
        weights = character.rest_morph_weights if morph_weights is None else morph_weights
        weights = checked(as_float(weights), (..., len(character.morph_names)), "morph_weights", "the morph channels")
        moved = morph(mesh, part.morphs, gather(weights, channels, -1), with_normals)
        positions, normals = moved if with_normals else (moved, None)
    else:
        positions, normals = mesh.positions, mesh.normals if with_normals else None
    if part.skin is not None:
        matrices = skin_matrices(part.skin, model_from_joint)
        positions, normals = skin_points(positions, normals, part.skin, matrices, method)
        return (positions, normals) if with_normals else positions
    # Rigid binding: the mesh is in the joint's space.
    carrier, positions = unified(model_from_joint[..., part.joint, :, :], positions)
    carried = rigid.transform_points(carrier[..., None, :, :], positions)
    return (carried, transform_normals(carrier, normals)) if with_normals else carried


def deform_character(
    character: Character,
    model_from_joint: Array,
    morph_weights: Array | None = None,
    with_normals: bool = False,
    method: SkinningMethod | str | None = None,
) -> list[Any]:
    """All parts of a character in the model's space, in their order; each as `deform_part` returns it."""
    return [
        deform_part(character, part, model_from_joint, morph_weights, with_normals, method) for part in character.parts
    ]
