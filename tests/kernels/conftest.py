"""Plain float64 references and data for the kernels' tests; the formulas are written out, not shared with the product."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest


def multiply(a, b):
    """Hamilton product, wxyz, by the definition i² = j² = k² = ijk = -1."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def matrix(q):
    """Rotation matrices whose columns are q e q*."""
    conjugate = q * (1, -1, -1, -1)
    columns = []
    for axis in np.eye(3):
        e = np.broadcast_to(np.concatenate([[0.0], axis]), q.shape)
        columns.append(multiply(multiply(q, e), conjugate)[..., 1:])
    return np.stack(columns, axis=-1)


def chained(parents, rotations, translations, scales=None):
    """model_from_joint (..., J, 4, 4): products of 4x4 matrices."""
    local = np.zeros((*rotations.shape[:-1], 4, 4))
    local[..., :3, :3] = matrix(rotations)
    if scales is not None:
        local[..., :3, :3] *= scales[..., None, :]
    local[..., :3, 3], local[..., 3, 3] = translations, 1
    models = local.copy()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            models[..., joint, :, :] = models[..., parent, :, :] @ local[..., joint, :, :]
    return models


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def random_parents(joints, rng, deep=False):
    """A random forest; several roots may occur."""
    low = [max(j - 2, -1) if deep else -1 for j in range(joints)]
    return np.array([-1 if j == 0 else rng.integers(low[j], j) for j in range(joints)])


@dataclass
class Motion:
    parents: np.ndarray
    rotations: np.ndarray
    translations: np.ndarray
    scales: np.ndarray

    @property
    def models(self):
        return chained(self.parents, self.rotations, self.translations)


def random_motion(frames, joints, seed=0, deep=False) -> Motion:
    rng = np.random.default_rng(seed)
    return Motion(
        random_parents(joints, rng, deep),
        unit(rng.normal(size=(frames, joints, 4))),
        rng.normal(size=(frames, joints, 3)),
        rng.uniform(0.5, 2, size=(frames, joints, 3)),
    )


@pytest.fixture
def rng():
    return np.random.default_rng(7)
