"""UsdSkel bindings as skins, or as the one joint that carries a mesh.

Source: Pixar, "UsdSkel Schemas", section "Skinning": ``skinned = sum_j w_j joint_j inverse(bind_j) geomBind point``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.errors import FormatError
from keypose.io.guarded import Record, sane
from keypose.io.notes import Notes
from keypose.io.usd.hierarchy import Hierarchy, inverted
from keypose.math import rigid
from keypose.model import Skin, SkinningMethod

_WEIGHT_TOLERANCE = 1e-4
_METHODS = {"classicLinear": SkinningMethod.LINEAR, "dualQuaternion": SkinningMethod.DUAL_QUATERNION}


@dataclass(frozen=True, slots=True)
class Binding:
    """A skin of all points of a mesh; or, where all follow one joint alone, that joint.

    ``geometry`` (4, 4) is applied to the points first, in metres.
    """

    geometry: Floats
    joint: int | None
    palette: Ints
    joint_from_mesh: Floats
    joints: Ints
    weights: Floats
    method: SkinningMethod

    def of(self, control_points: Ints) -> Skin:
        """The skin of some vertices."""
        joints, weights = self.joints[control_points], self.weights[control_points]
        matrices = self.joint_from_mesh.astype(np.float32)
        return Skin(self.palette, matrices, joints, weights.astype(np.float32), self.method)


def bind(
    record: Record, item: Mapping[str, Any], tree: Hierarchy, unit_m: float, where: str, notes: Notes
) -> Binding | None:
    """The binding of a mesh to its skeleton; None where it has none that can be used."""
    found, skeleton = item["skin"], int(item["skeleton"])
    tokens = tree.joint_of_token.get(skeleton, {})
    if not tokens:
        notes.add(f"{where}: its skeleton has no joints; it was taken as a mesh without a skin")
        return None
    count = len(record.array(item["positions"], 3)) if item["positions"] is not None else 0
    joints, weights = _influences(record, found, count, where)
    order = [str(t) for t in (found["order"] if found["order"] is not None else tokens)]
    if len(joints) and (joints.min() < 0 or joints.max() >= len(order)):
        bad = int(joints.max() if joints.max() >= len(order) else joints.min())
        raise FormatError(f"joint {bad} does not exist; there are {len(order)}", where=where)
    unknown = [k for k, token in enumerate(order) if token not in tokens]
    if unknown:
        notes.add(f"{where}: {len(unknown)} of its joints are not in the skeleton and were dropped")
        weights = np.where(np.isin(joints, unknown), 0.0, weights)
    weights = _summing_to_one(weights, where, notes)
    used = np.unique(joints[weights > 0]) if found["order"] is None else np.arange(len(order))
    used = np.setdiff1d(used, unknown)
    if not len(used):
        notes.add(f"{where}: none of its joints is in the skeleton; it was taken as a mesh without a skin")
        return None
    places = np.zeros(len(order), np.int64)
    places[used] = np.arange(len(used))
    first = np.asarray(found["bind"], np.float64).reshape(4, 4).T
    if not sane(first):
        raise FormatError("its bind transform holds impossible numbers", where=where)
    matrices = np.stack([_inverse(tree.bind[skeleton][order[k]], order[k], where, notes) for k in used])
    palette = np.array([tokens[order[k]] for k in used], np.int32)
    joints = np.where(weights > 0, places[joints], 0)
    method = _METHODS.get(str(found["method"]))
    if method is None:
        notes.add(f"{where}: its skinning method '{found['method']}' is unknown; it was taken as linear")
        method = SkinningMethod.LINEAR
    geometry = np.eye(4)
    if found["constant"] and joints.shape[1] and np.count_nonzero(weights[:1]) == 1:
        column = int(np.argmax(weights[0])) if len(weights) else 0
        joint = int(joints[0, column]) if len(joints) else 0
        geometry = _metres(matrices[joint] @ first, unit_m)
        if np.allclose(geometry, np.eye(4), rtol=0, atol=1e-9):
            geometry = np.eye(4)
        return Binding(geometry, int(palette[joint]), palette, matrices, joints, weights, method)
    if method is SkinningMethod.DUAL_QUATERNION and not _is_rigid(first):
        geometry = _metres(first, unit_m)  # before the joints: what they blend has to be rigid
    else:
        matrices = matrices @ first
    return Binding(geometry, None, palette, _metres(matrices, unit_m), joints, weights, method)


def _influences(record: Record, found: Mapping[str, Any], count: int, where: str) -> tuple[Ints, Floats]:
    """Joints and weights (points, K) as the file has them."""
    width = max(int(found["width"]), 0)
    joints = np.zeros(0, np.int64) if found["joints"] is None else record.integers(found["joints"], where)
    weights = np.zeros(0) if found["weights"] is None else record.floats(found["weights"])
    rows = 1 if found["constant"] else count
    if not width or len(joints) != len(weights) or len(joints) != rows * width:
        raise FormatError(f"{len(joints)} joints and {len(weights)} weights for {rows} points", where=where)
    if not sane(weights) or np.any(weights < 0):
        raise FormatError("a weight is impossible", where=where)
    joints, weights = joints.reshape(rows, width), weights.reshape(rows, width)
    if found["constant"]:
        joints, weights = np.tile(joints, (count, 1)), np.tile(weights, (count, 1))
    return joints, weights


def _summing_to_one(weights: Floats, where: str, notes: Notes) -> Floats:
    sums = weights.sum(axis=1)
    empty = sums <= 0
    off = np.abs(sums[~empty] - 1)
    if len(off) and off.max() > _WEIGHT_TOLERANCE:
        notes.add(
            f"{where}: the weights of {int((off > _WEIGHT_TOLERANCE).sum())} points did not sum to 1 "
            f"(by {off.max():.2g}) and were scaled"
        )
    if np.any(empty):
        notes.add(f"{where}: {int(empty.sum())} points have no weight; they follow the first joint")
    scaled = weights / np.where(empty, 1.0, sums)[:, None]
    if scaled.shape[1]:
        scaled[empty, 0] = 1.0
    # weights that sum to 1 within single precision stay as they are
    return np.where((np.abs(sums - 1) <= 1e-6)[:, None], weights, scaled)


def _inverse(bind: Floats, name: str, where: str, notes: Notes) -> Floats:
    found = inverted(bind)
    if found is not None:
        return found
    notes.add(f"{where}: the bind transform of '{name}' has no volume; it was taken as none")
    return np.eye(4)


def _metres(matrix: Floats, unit_m: float) -> Floats:
    scaled = np.array(matrix, np.float64)
    scaled[..., :3, 3] *= unit_m
    return scaled


def _is_rigid(matrix: Floats) -> bool:
    linear = matrix[:3, :3]
    return bool(np.allclose(linear @ linear.T, np.eye(3), atol=1e-9) and np.linalg.det(linear) > 0)


def moved(matrix: Floats, points: Floats) -> Floats:
    """Points (V, 3) after a matrix."""
    return np.asarray(rigid.transform_points(matrix, np.asarray(points, np.float64)))
