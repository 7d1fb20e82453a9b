"""Round-trip error: how far the joints of a copy are from those of the original."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from keypose.arrays import Array, Floats
from keypose.errors import ShapeError
from keypose.evaluate import bake, sample_clip, sample_motion, snap_to_keys, world_rotations_positions
from keypose.math import quat
from keypose.model import Clip, Motion, Pose, Skeleton


@dataclass(frozen=True, slots=True)
class RoundtripError:
    """The largest differences between two animations in the model's space, and where they are."""

    position_mm: float
    position_joint: str
    position_frame: int
    rotation_deg: float
    rotation_joint: str
    rotation_frame: int
    joints: int  # compared
    frames: int  # compared
    frames_missing: int = 0  # frames of the original less those of the copy
    joints_missing: tuple[str, ...] = ()  # of the original, not in the copy
    start_shift_s: float = 0.0  # start of the copy less that of the original; compared after shifting it back

    def within(self, position_mm: float, rotation_deg: float) -> bool:
        """Whether nothing is missing and the errors are at most these."""
        complete = not self.joints_missing and self.frames_missing == 0
        return complete and self.position_mm <= position_mm and self.rotation_deg <= rotation_deg

    def __str__(self) -> str:
        text = (
            f"{self.joints} joints x {self.frames} frames: positions within {self.position_mm:.2g} mm"
            f"{_place(self.position_mm, self.position_joint, self.position_frame)}, "
            f"rotations within {self.rotation_deg:.2g} degrees"
            f"{_place(self.rotation_deg, self.rotation_joint, self.rotation_frame)}"
        )
        if self.joints_missing:
            shown = ", ".join(self.joints_missing[:5]) + (" and more" if len(self.joints_missing) > 5 else "")
            text += f"; {len(self.joints_missing)} joints are missing: {shown}"
        if self.frames_missing:
            count = abs(self.frames_missing)
            text += f"; the copy has {count} frame{'s' * (count != 1)} {'less' if self.frames_missing > 0 else 'more'}"
        if self.start_shift_s:
            text += (
                f"; the copy starts {abs(self.start_shift_s):g} s {'later' if self.start_shift_s > 0 else 'earlier'}"
            )
        return text


def roundtrip_error(
    original: Clip | Motion, copy: Clip | Motion, skeleton: Skeleton, copy_skeleton: Skeleton | None = None
) -> RoundtripError:
    """How far each joint of a copy is from the original, over all frames.

    ``skeleton`` poses the original and ``copy_skeleton`` (the same if not given) the copy; joints are compared by name
    in the model's space, in float64. Motions are compared frame by frame; a clip beside a motion is first baked at the
    motion's rate; two clips are compared at all keys of the original and halfway between them. Angles are measured
    with atan2, so that 1e-6 degrees is still resolved. Scales enter the positions, not the rotations.

    Raises:
        ShapeError: where the two have no joint in common or nothing to compare.
    """
    copy_skeleton = skeleton if copy_skeleton is None else copy_skeleton
    common = [name for name in skeleton.names if name in set(copy_skeleton.names)]
    if not common:
        raise ShapeError("roundtrip_error: the two skeletons have no joint name in common")
    pose, copied, missing = _poses(original, copy, skeleton, copy_skeleton)
    frames = min(pose.batch_shape[0], copied.batch_shape[0])
    if frames == 0:
        raise ShapeError("roundtrip_error: there are no frames to compare")
    rotations, positions = _in_model(skeleton, pose[:frames], common)
    copied_rotations, copied_positions = _in_model(copy_skeleton, copied[:frames], common)
    distance_mm = 1e3 * np.linalg.norm(copied_positions - positions, axis=-1)
    angle_deg = np.degrees(quat.angle_between(copied_rotations, rotations))
    far, turned = _worst(distance_mm), _worst(angle_deg)
    return RoundtripError(
        float(distance_mm[far]),
        common[far[1]],
        far[0],
        float(angle_deg[turned]),
        common[turned[1]],
        turned[0],
        len(common),
        frames,
        missing,
        tuple(name for name in skeleton.names if name not in set(common)),
        round(copy.start_s - original.start_s, 6),
    )


def _poses(
    original: Clip | Motion, copy: Clip | Motion, skeleton: Skeleton, copy_skeleton: Skeleton
) -> tuple[Pose, Pose, int]:
    """Both poses at the same moments, and how many frames the copy lacks."""
    if isinstance(original, Clip) and isinstance(copy, Clip):
        keys = np.unique(np.concatenate([np.zeros(0), *(c.times_s for c in original.curves.values())]))
        if not len(keys):
            keys = np.zeros(1)
        times = np.unique(np.concatenate([keys, (keys[1:] + keys[:-1]) / 2]))
        # Formats store times in float32: a key that has moved by rounding is still the same key.
        moved = snap_to_keys(copy, times - original.start_s + copy.start_s, 1e-6 * (1 + np.abs(times)))
        return sample_clip(original, skeleton, times), sample_clip(copy, copy_skeleton, moved), 0
    rate_hz = original.rate_hz if isinstance(original, Motion) else copy.rate_hz
    if rate_hz is None:
        raise ShapeError("roundtrip_error: expected a motion")
    first, second = _uniform(original, skeleton, rate_hz), _uniform(copy, copy_skeleton, rate_hz)
    return first.pose.broadcast(), second.pose.broadcast(), first.frame_count - second.frame_count


def _uniform(animation: Clip | Motion, skeleton: Skeleton, rate_hz: float) -> Motion:
    if isinstance(animation, Clip):
        return bake(animation, skeleton, rate_hz)
    if animation.joint_names != skeleton.names:
        raise ShapeError("roundtrip_error: the motion's joints are not the skeleton's; use evaluate.match first")
    if animation.rate_hz == rate_hz:
        return animation
    # A rate that was only rounded means the same frames; another rate is sampled at the original's times.
    if abs(animation.rate_hz - rate_hz) * animation.frame_count < 0.1 * rate_hz:
        return animation
    count = int(np.floor(animation.duration_s * rate_hz + 0.01)) + 1
    times = animation.start_s + np.arange(count) / rate_hz
    return Motion(animation.joint_names, sample_motion(animation, times), rate_hz, start_s=animation.start_s)


def _in_model(skeleton: Skeleton, pose: Pose, names: list[str]) -> tuple[Floats, Floats]:
    double = Pose(*(np.asarray(a, np.float64) for a in (pose.translations, pose.rotations, pose.scales)))
    unit = Pose(double.translations, quat.normalize(double.rotations), double.scales)
    rotations, positions = world_rotations_positions(skeleton, unit)
    index = skeleton.indices(names)
    return rotations[:, index], positions[:, index]


def _worst(errors: Array) -> tuple[int, int]:
    frame, joint = np.unravel_index(int(np.argmax(errors)), errors.shape)
    return int(frame), int(joint)


def _place(error: float, joint: str, frame: int) -> str:
    return f" ({joint}, frame {frame})" if error > 0 else ""
