"""Random but well-formed models for tests of laws, and plain reference calculations."""

from __future__ import annotations

from typing import Any

import numpy as np

from keypose.model import Mesh, Pose, Skeleton, Skin


def random_rotations(rng: np.random.Generator, *shape: int) -> Any:
    """Uniformly distributed unit quaternions, wxyz."""
    q = rng.normal(size=(*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def random_pose(rng: np.random.Generator, batch: tuple[int, ...], joints: int, *, scaled: bool = False) -> Pose:
    """A pose with bones of about 30 cm."""
    scales = rng.uniform(0.5, 2.0, (*batch, joints, 3)) if scaled else np.ones((*batch, joints, 3))
    return Pose(0.3 * rng.normal(size=(*batch, joints, 3)), random_rotations(rng, *batch, joints), scales)


def random_skeleton(rng: np.random.Generator, joints: int, *, roots: int = 1, scaled: bool = False) -> Skeleton:
    """A tree whose joints are in a valid order, but not in order of depth."""
    parents = [-1] * roots + [int(rng.integers(0, j)) for j in range(roots, joints)]
    return Skeleton(
        tuple(f"joint{j}" for j in range(joints)), np.array(parents), random_pose(rng, (), joints, scaled=scaled)
    )


def random_mesh(rng: np.random.Generator, vertices: int) -> Mesh:
    """A cloud of vertices with unit normals."""
    normals = rng.normal(size=(vertices, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    triangles = np.arange(vertices - vertices % 3).reshape(-1, 3)
    return Mesh(rng.normal(size=(vertices, 3)), triangles, normals)


def random_skin(rng: np.random.Generator, skeleton: Skeleton, vertices: int, influences: int) -> Skin:
    """Random weights, bound in the skeleton's rest pose."""
    joints = np.stack([rng.permutation(skeleton.joint_count)[:influences] for _ in range(vertices)])
    weights = rng.uniform(0.05, 1.0, (vertices, influences))
    inverse_bind = np.linalg.inv(chain(skeleton, skeleton.rest))
    return Skin(np.arange(skeleton.joint_count), inverse_bind, joints, weights / weights.sum(axis=1, keepdims=True))


def as_type(pose: Pose, dtype: Any) -> Pose:
    """The pose in another precision, or as PyTorch tensors where ``dtype`` is one of its types."""
    arrays = (pose.translations, pose.rotations, pose.scales)
    if isinstance(dtype, type) and issubclass(dtype, np.floating):
        return Pose(*(a.astype(dtype) for a in arrays))
    import torch

    return Pose(*(torch.tensor(np.array(a), dtype=dtype) for a in arrays))


def matrix_trs(translation: Any, rotation: Any, scale: Any) -> Any:
    """T R S of one joint by SciPy, 4x4 float64."""
    from scipy.spatial.transform import Rotation

    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat(np.roll(np.asarray(rotation, float), -1)).as_matrix() * np.asarray(scale, float)
    out[:3, 3] = translation
    return out


def chain(skeleton: Skeleton, pose: Pose) -> Any:
    """Forward kinematics of one pose as products of 4x4 matrices, one joint after the other."""
    world = np.zeros((skeleton.joint_count, 4, 4))
    for j, parent in enumerate(skeleton.parents):
        own = matrix_trs(pose.translations[j], pose.rotations[j], pose.scales[j])
        world[j] = own if parent < 0 else world[parent] @ own
    return world
