"""The pose that a character's meshes were bound in, all of them in one space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from keypose.arrays import Floats
from keypose.evaluate import world
from keypose.model import Character, Mesh


@dataclass(frozen=True, slots=True, eq=False)
class BoundPose:
    """A character as it was bound.

    Shapes and units: ``meshes`` of all parts in one space, metres; ``model_from_joint`` (J, 4, 4) in it; ``model_from_mesh``
    (4, 4) for each part.
    """

    meshes: tuple[Mesh, ...]
    model_from_joint: Floats
    model_from_mesh: tuple[Floats, ...]


def bound_pose(character: Character) -> BoundPose:
    """Where all joints were when the character was bound: in its rest pose, or as the inverse bind matrices say.

    Joints that bind nothing are where the rest pose has them, seen from the joint above.
    """
    skeleton = character.skeleton
    rest = np.asarray(world(skeleton, skeleton.rest), np.float64)
    bound = np.full(rest.shape, np.nan)
    carriers: list[Floats | None] = [None] * len(character.parts)
    # The largest skin first: it says where its joints are in the model, so that most of it stands as at rest.
    order = sorted(range(len(character.parts)), key=lambda n: -character.parts[n].mesh.vertex_count)
    for number in order:
        skin = character.parts[number].skin
        if skin is None or not len(skin.palette):
            continue
        palette = np.asarray(skin.palette)
        mesh_from_joint = np.linalg.inv(np.asarray(skin.joint_from_mesh, np.float64))
        known = np.nonzero(~np.isnan(bound[palette, 0, 0]))[0]
        used = np.bincount(
            np.asarray(skin.joints).reshape(-1), np.asarray(skin.weights, np.float64).reshape(-1), len(palette)
        )
        if len(known):
            anchor = int(known[np.argmax(used[known])])
            target = bound[palette[anchor]]
        else:
            anchor = int(np.argmax(used))
            target = rest[palette[anchor]]
        carrier = target @ np.linalg.inv(mesh_from_joint[anchor])
        carriers[number] = carrier
        fresh = np.isnan(bound[palette, 0, 0])
        bound[palette[fresh]] = carrier @ mesh_from_joint[fresh]
    for joint, parent in enumerate(skeleton.parents.tolist()):
        if np.isnan(bound[joint, 0, 0]):
            above = rest[parent] if parent >= 0 else np.eye(4)
            bound[joint] = (bound[parent] if parent >= 0 else np.eye(4)) @ np.linalg.solve(above, rest[joint])
    meshes: list[Mesh] = []
    found: list[Floats] = []
    for part, carrier in zip(character.parts, carriers, strict=True):
        if carrier is None:
            carrier = bound[part.joint] if part.joint is not None else np.eye(4)
        found.append(carrier)
        positions = np.asarray(part.mesh.positions, np.float64) @ carrier[:3, :3].T + carrier[:3, 3]
        meshes.append(Mesh(positions, part.mesh.triangles))
    return BoundPose(tuple(meshes), bound, tuple(found))
