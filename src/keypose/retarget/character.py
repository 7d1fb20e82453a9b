"""What a character says beyond its skeleton: the pose its skin was bound in, and the ground under its soles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from keypose.arrays import Floats
from keypose.evaluate import world, world_rotations_positions
from keypose.math import quat
from keypose.model import Character, Pose
from keypose.retarget.stand import is_stand, raised


def bind_stand(character: Character, roles: Mapping[str, int]) -> Pose | None:
    """The pose in which the skin was bound, set upright on the ground at the origin, where the rest pose is no stand and that one is; else None.

    Files keep the nodes as they were when they were saved, in the middle of a step for instance; a skin is bound to a body
    that stands.
    """
    skeleton = character.skeleton
    if is_stand(np.asarray(world_rotations_positions(skeleton, skeleton.rest)[1], np.float64), roles):
        return None
    bound = _bound_rotations(character)
    if roles["hips"] not in bound:
        return None
    local = np.array(skeleton.rest.rotations, np.float64)
    turned = np.empty_like(local)
    for joint, parent in enumerate(skeleton.parents):
        above = turned[int(parent)] if parent >= 0 else np.array([1.0, 0.0, 0.0, 0.0])
        if joint in bound:
            local[joint] = quat.multiply(quat.conjugate(above), bound[joint])
        turned[joint] = quat.multiply(above, local[joint])
    stand = raised(skeleton, Pose(skeleton.rest.translations, quat.normalize(local), skeleton.rest.scales), roles)
    if stand is None:
        return None
    places = np.asarray(world_rotations_positions(skeleton, stand)[1], np.float64)
    ground = ground_under(character, stand)
    translations = np.array(stand.translations)
    translations[skeleton.parents < 0] -= (places[roles["hips"], 0], ground or 0.0, places[roles["hips"], 2])
    return replace(stand, translations=translations)


def ground_under(character: Character, pose: Pose | None = None) -> float | None:
    """The lowest point of a character's skinned surface in its rest pose or another, in metres; None without a skin."""
    from keypose import deform

    if not any(part.skin is not None for part in character.parts):
        return None
    skeleton = character.skeleton
    standing = deform.deform_character(character, world(skeleton, skeleton.rest if pose is None else pose))
    return min((float(vertices[:, 1].min()) for vertices in standing if len(vertices)), default=None)


def _bound_rotations(character: Character) -> dict[int, Floats]:
    """Rotations of joints in the pose that skins were bound in, in the mesh's axes."""
    found: dict[int, Floats] = {}
    for part in character.parts:
        if part.skin is None:
            continue
        matrices = np.asarray(part.skin.joint_from_mesh, np.float64)[:, :3, :3]
        for joint, matrix in zip(part.skin.palette.tolist(), matrices, strict=True):
            length = np.linalg.norm(matrix, axis=1)
            if joint not in found and float(length.min()) > 1e-9 and float(np.linalg.det(matrix)) > 0:
                left, _, right = np.linalg.svd(np.linalg.inv(matrix))
                found[joint] = quat.from_matrix(left @ right)
    return found
