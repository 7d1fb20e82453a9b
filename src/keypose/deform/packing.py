"""Packing a skin to a few influences per vertex, with the error stated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from keypose.arrays import Array, Floats, Ints
from keypose.deform.skinning import skin as skin_mesh
from keypose.errors import ShapeError
from keypose.model import Mesh, Skin


@dataclass(frozen=True, slots=True)
class PackReport:
    """What leaving out the smallest influences cost."""

    influences: int  # kept per vertex
    influences_before: int  # of the vertex that had most
    vertices: int
    vertices_changed: int
    max_lost_weight: float  # of a vertex whose weights sum to 1
    mean_lost_weight: float  # over all vertices
    worst_vertex: int  # the one that lost most weight; -1 where none lost any
    max_displacement_m: float | None = None  # over the poses that were given

    def __str__(self) -> str:
        if not self.vertices_changed:
            return f"{self.vertices} vertices, at most {self.influences_before} influences: nothing lost"
        moved = (
            ""
            if self.max_displacement_m is None
            else f", vertices move by up to {self.max_displacement_m * 1e3:.3g} mm"
        )
        return (
            f"{self.vertices_changed} of {self.vertices} vertices packed from up to {self.influences_before} to "
            f"{self.influences} influences: lost weight {self.max_lost_weight:.3g} at most (vertex {self.worst_vertex}), "
            f"{self.mean_lost_weight:.3g} on average{moved}"
        )


def pack(
    binding: Skin, influences: int = 4, *, mesh: Mesh | None = None, model_from_joint: Array | None = None
) -> tuple[Skin, PackReport]:
    """The skin with exactly ``influences`` influences per vertex: the largest are kept and scaled to the old sum.

    Influences of one joint are first added up. With a mesh and poses ``model_from_joint`` (*B, J, 4, 4) the report
    holds the largest displacement of a vertex that packing causes in them.

    Raises:
        ShapeError: where ``influences`` is not positive, or only one of mesh and poses is given.
    """
    if influences < 1:
        raise ShapeError(f"influences: expected at least 1, got {influences}")
    if (mesh is None) != (model_from_joint is None):
        raise ShapeError("pack: expected both mesh and model_from_joint, or neither")
    joints, weights = _sorted_influences(np.asarray(binding.joints), np.asarray(binding.weights))
    count = len(joints)
    before = int(np.count_nonzero(weights, axis=1).max(initial=0))
    totals = weights.sum(axis=1, dtype=np.float64)
    kept_joints = np.zeros((count, influences), np.int32)
    kept = np.zeros((count, influences), weights.dtype)
    columns = min(influences, joints.shape[1])
    kept_joints[:, :columns] = joints[:, :columns]
    kept[:, :columns] = weights[:, :columns]
    lost = weights[:, columns:].sum(axis=1, dtype=np.float64)
    lost_share = lost / np.where(totals > 0, totals, 1.0)
    changed = lost > 0
    sums = kept.sum(axis=1, dtype=np.float64)
    factor = np.where(changed, totals / np.where(sums > 0, sums, 1.0), 1.0)
    kept = (kept * factor[:, None]).astype(weights.dtype)
    kept_joints[kept == 0] = 0
    packed = Skin(binding.palette, binding.joint_from_mesh, kept_joints, kept, binding.method)
    displacement = None
    if mesh is not None and model_from_joint is not None:
        moved = skin_mesh(mesh, packed, model_from_joint) - skin_mesh(mesh, binding, model_from_joint)
        displacement = float(np.linalg.norm(moved, axis=-1).max(initial=0.0))
    report = PackReport(
        influences,
        before,
        count,
        int(np.count_nonzero(changed)),
        float(lost_share.max(initial=0.0)),
        float(lost_share.mean()) if count else 0.0,
        int(np.argmax(lost_share)) if np.any(changed) else -1,
        displacement,
    )
    return packed, report


def _sorted_influences(joints: Ints, weights: Floats) -> tuple[Ints, Floats]:
    """Influences by falling weight, those of one joint added up."""
    order = np.argsort(joints, axis=1, kind="stable")
    joints = np.take_along_axis(joints, order, axis=1)
    weights = np.take_along_axis(weights, order, axis=1).copy()
    for k in range(joints.shape[1] - 1, 0, -1):
        same = joints[:, k] == joints[:, k - 1]
        weights[same, k - 1] += weights[same, k]
        weights[same, k] = 0
    order = np.argsort(-weights, axis=1, kind="stable")
    return np.take_along_axis(joints, order, axis=1), np.take_along_axis(weights, order, axis=1)
