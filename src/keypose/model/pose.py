"""Pose and Motion: the local transforms of all joints, once or along time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from keypose.arrays import Array, as_float, checked, frozen, namespace
from keypose.errors import ShapeError


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Local (parent-from-joint) transforms of J joints, with any leading batch shape *B.

    Shapes and units:
        translations: (*B, J, 3) metres.
        rotations: (*B, J, 4) unit quaternions, wxyz.
        scales: (*B, J, 3).
    The three arrays may have different (broadcastable) batch shapes: a motion whose bones keep their lengths may
    hold rotations (T, J, 4) and translations (J, 3).

    Raises:
        ShapeError: where a shape does not fit the others.
    """

    translations: Array
    rotations: Array
    scales: Array

    def __post_init__(self) -> None:
        rotations = as_float(self.rotations)
        checked(rotations, (..., "J", 4), "rotations")
        joints = rotations.shape[-2]
        for name, array, width in (
            ("translations", self.translations, 3),
            ("rotations", rotations, 4),
            ("scales", self.scales, 3),
        ):
            array = checked(as_float(array), (..., joints, width), name, f"rotations {tuple(rotations.shape)}")
            object.__setattr__(self, name, frozen(array))
        try:
            np.broadcast_shapes(*(a.shape[:-2] for a in (self.translations, self.rotations, self.scales)))
        except ValueError:
            raise ShapeError(
                f"pose: batch shapes {tuple(self.translations.shape[:-2])}, {tuple(self.rotations.shape[:-2])} and "
                f"{tuple(self.scales.shape[:-2])} of translations, rotations and scales do not broadcast"
            ) from None

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """The broadcast batch shape *B."""
        return np.broadcast_shapes(*(a.shape[:-2] for a in (self.translations, self.rotations, self.scales)))

    @property
    def joint_count(self) -> int:
        """J."""
        return int(self.rotations.shape[-2])

    def __getitem__(self, index: Any) -> Pose:
        """The pose at a batch index, for example one frame or a slice of frames."""
        full = self.broadcast()
        if not isinstance(index, tuple):
            index = (index,)
        if Ellipsis not in index:
            index = (*index, Ellipsis)
        index = (*index, slice(None), slice(None))
        return Pose(full.translations[index], full.rotations[index], full.scales[index])

    def broadcast(self) -> Pose:
        """The same pose with all three arrays at the full batch shape."""
        batch = self.batch_shape
        xp = namespace(self.rotations)
        arrays = {
            name: a if a.shape[:-2] == batch else xp.broadcast_to(a, (*batch, *a.shape[-2:]))
            for name, a in (
                ("translations", self.translations),
                ("rotations", self.rotations),
                ("scales", self.scales),
            )
        }
        return Pose(**arrays)


@dataclass(frozen=True, slots=True, eq=False)
class Event:
    """Something that happens at a time of a motion: a foot contact, a sound, a mark."""

    time_s: float
    name: str
    data: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A uniformly sampled performance: a pose whose batch shape is (T,).

    Shapes and units:
        joint_names: J names; a motion is matched to a skeleton by name.
        pose: batch shape (T,).
        rate_hz: samples per second.
        start_s: time of frame 0.
        morph_names, morph_weights: M names and (T, M) weights, or () and None.
        events: in order of time.

    Raises:
        ShapeError: where lengths disagree or the rate is not positive.
    """

    joint_names: tuple[str, ...]
    pose: Pose
    rate_hz: float
    name: str = ""
    start_s: float = 0.0
    morph_names: tuple[str, ...] = ()
    morph_weights: Array | None = None
    events: tuple[Event, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "joint_names", tuple(self.joint_names))
        object.__setattr__(self, "morph_names", tuple(self.morph_names))
        if len(self.joint_names) != self.pose.joint_count:
            raise ShapeError(
                f"motion: {len(self.joint_names)} joint names for a pose of {self.pose.joint_count} joints"
            )
        if len(self.pose.batch_shape) != 1:
            raise ShapeError(f"motion: expected a pose of batch shape (T,), got {self.pose.batch_shape}")
        if not (np.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise ShapeError(f"rate_hz: expected a positive number, got {self.rate_hz}")
        if self.morph_weights is None:
            if self.morph_names:
                raise ShapeError(f"motion: {len(self.morph_names)} morph names without morph weights")
        else:
            shape = (self.frame_count, len(self.morph_names))
            weights = checked(as_float(self.morph_weights), shape, "morph_weights", "frames and morph names")
            object.__setattr__(self, "morph_weights", frozen(weights))

    @property
    def frame_count(self) -> int:
        """T."""
        return int(self.pose.batch_shape[0])

    @property
    def duration_s(self) -> float:
        """Time from the first sample to the last."""
        return max(self.frame_count - 1, 0) / self.rate_hz

    @property
    def times_s(self) -> Array:
        """Times of all samples, (T,) float64."""
        return self.start_s + np.arange(self.frame_count) / self.rate_hz

    def with_pose(self, pose: Pose) -> Motion:
        """The same motion with other joint transforms."""
        return replace(self, pose=pose)
