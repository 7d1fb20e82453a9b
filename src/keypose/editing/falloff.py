"""One pose changed, and its neighbours with it, less and less: the change fades by a chosen fall-off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from keypose.arrays import Array, Floats, checked
from keypose.editing.displacement import rotation_change
from keypose.editing.limb_pose import keep_ends
from keypose.editing.reach import found_roles, joint_of
from keypose.errors import ShapeError, UnknownName
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton

FallOff = Literal["smooth", "linear", "constant"]
FALL_OFFS: tuple[FallOff, ...] = ("smooth", "linear", "constant")
"""``smooth`` has no corner anywhere (twice differentiable), ``linear`` has three, ``constant`` jumps at both ends."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseEditResult:
    """The motion after a pose edit.

    Shapes and units: ``weights`` (T,) how much of the change each frame got; ``kept_m`` how far joints that were to be kept
    are from their old places at most.
    """

    motion: Motion
    weights: Floats
    kept_m: float


def fall_off(frame_count: int, frame: int, before_frames: int, after_frames: int, shape: FallOff = "smooth") -> Floats:
    """Weights (T,) that are 1 at a frame and 0 from ``before_frames`` before it and ``after_frames`` after it on.

    Raises:
        ShapeError: where the frame is not there or a range is negative.
        UnknownName: for another shape.
    """
    if shape not in FALL_OFFS:
        raise UnknownName("fall-off", shape, FALL_OFFS)
    if not 0 <= frame < frame_count:
        raise ShapeError(f"frame: expected 0 to {frame_count - 1}, got {frame}")
    if before_frames < 0 or after_frames < 0:
        raise ShapeError(f"range: expected 0 frames or more, got {before_frames} and {after_frames}")
    away = np.arange(frame_count) - frame
    ranges = np.where(away < 0, before_frames, after_frames)
    near = 1.0 - np.minimum(np.abs(away) / np.maximum(ranges, 1), 1.0)
    near[frame] = 1.0
    if shape == "smooth":
        return near**3 * (near * (6.0 * near - 15.0) + 10.0)
    return near if shape == "linear" else (near > 0).astype(np.float64)


def edit_pose(
    motion: Motion,
    skeleton: Skeleton,
    frame: int,
    pose: Pose,
    *,
    before_s: float = 0.5,
    after_s: float = 0.5,
    shape: FallOff = "smooth",
    keep: Sequence[str] = (),
    roles: Mapping[str, int] | None = None,
) -> PoseEditResult:
    """A motion that has a new pose at a frame, and a fading share of the change around it.

    Changes are added in every joint's own axes (rotation vectors; metres; ratios of scale). The frame itself has the pose
    bit for bit, and so has every frame out of range its old one, unless joints are kept.

    Shapes and units: ``pose`` of batch shape (); ``keep`` joints or roles at the ends of limbs (``left_foot``) that stay
    where they are in the motion, as they are turned there, in all frames; the rest of the limb gives way.

    Raises:
        ShapeError: where the pose has other joints, the frame is not there, or a joint to keep ends no limb.
        UnknownName: for a joint that is not there.
    """
    checked(pose.rotations, (skeleton.joint_count, 4), "pose: rotations", "the skeleton")
    checked(motion.pose.rotations, (..., skeleton.joint_count, 4), "motion: rotations", "the skeleton")
    for name, span in (("before_s", before_s), ("after_s", after_s)):
        if not (np.isfinite(span) and span >= 0):
            raise ShapeError(f"{name}: expected 0 or more seconds, got {span}")
    ranges = [round(s * motion.rate_hz) for s in (before_s, after_s)]
    weights = fall_off(motion.frame_count, frame, ranges[0], ranges[1], shape)
    full = motion.pose.broadcast()
    rows = np.flatnonzero(weights)
    share = weights[rows, None]
    rotations, translations, scales = (np.array(a) for a in (full.rotations, full.translations, full.scales))
    turn = rotation_change(rotations[frame], pose.rotations)
    move = np.asarray(pose.translations, np.float64) - translations[frame]
    for joint in np.flatnonzero(np.any(turn != 0, axis=-1)):
        own = np.asarray(rotations[rows, joint], np.float64)
        rotations[rows, joint] = quat.normalize(quat.multiply(own, quat.from_rotation_vector(share * turn[joint])))
    for joint in np.flatnonzero(np.any(move != 0, axis=-1)):
        translations[rows, joint] += share * move[joint]
    old, new = np.asarray(scales[frame], np.float64), np.asarray(pose.scales, np.float64)
    for joint in np.flatnonzero(np.any(old != new, axis=-1)):
        ratio = np.where(
            (old[joint] > 0) & (new[joint] > 0), new[joint] / np.where(old[joint] > 0, old[joint], 1.0), 0.0
        )
        scales[rows, joint] = np.where(
            ratio > 0,
            scales[rows, joint] * np.where(ratio > 0, ratio, 1.0) ** share,
            scales[rows, joint] + share * (new[joint] - old[joint]),
        )
    rotations[frame], translations[frame], scales[frame] = pose.rotations, pose.translations, pose.scales
    edited = replace(motion, pose=Pose(translations, rotations, scales))
    if not keep:
        return PoseEditResult(edited, weights, 0.0)
    known = found_roles(skeleton) if roles is None else roles
    joints = [joint_of(skeleton, name, known) for name in keep]
    kept, away = keep_ends(motion, edited, skeleton, joints, np.flatnonzero(weights), known)
    return PoseEditResult(kept, weights, away)


def with_joints(
    pose: Pose,
    skeleton: Skeleton,
    rotations: Mapping[str, Array] | None = None,
    translations: Mapping[str, Array] | None = None,
) -> Pose:
    """A pose of batch shape () with some joints' local rotations (4,) and translations (3,) replaced, by joint name.

    Raises:
        UnknownName: for a joint that is not there.
        ShapeError: where a value does not fit.
    """
    checked(pose.rotations, (skeleton.joint_count, 4), "pose: rotations", "the skeleton")
    turned, moved = np.array(pose.rotations), np.array(pose.translations)
    for name, value in (rotations or {}).items():
        turned[skeleton.index(name)] = quat.normalize(checked(np.asarray(value, np.float64), (4,), f"{name}: rotation"))
    for name, value in (translations or {}).items():
        moved[skeleton.index(name)] = checked(np.asarray(value, np.float64), (3,), f"{name}: translation")
    return Pose(moved, turned, pose.scales)
