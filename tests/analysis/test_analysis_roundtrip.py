"""Round-trip error: known displacements are found, in size and place; tiny angles are resolved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from keypose.analysis import RoundtripError, roundtrip_error
from keypose.errors import ShapeError
from keypose.evaluate import resample, to_clip
from keypose.math import quat
from keypose.model import Clip, Motion, Pose, Skeleton
from tests.synthetic import as_type, random_pose, random_skeleton


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(51)


@pytest.fixture
def skeleton() -> Skeleton:
    """A straight arm along X of three bones, 1 m each, and a root that does not turn."""
    rest = Pose([[0, 0, 0], [1.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0]], quat.identity((4,)), np.ones((4, 3)))
    return Skeleton(("root", "shoulder", "elbow", "hand"), [-1, 0, 1, 2], rest)


@pytest.fixture
def motion(skeleton: Skeleton) -> Motion:
    rest = skeleton.rest
    return Motion(skeleton.names, Pose(rest.translations, np.tile(rest.rotations, (20, 1, 1)), rest.scales), 30)


def changed(motion: Motion, frame: int, joint: int, *, move: object = (0, 0, 0), turn: float = 0.0) -> Motion:
    full = motion.pose.broadcast()
    translations, rotations = full.translations.copy(), full.rotations.copy()
    translations[frame, joint] += move
    twist = quat.from_axis_angle([0.0, 0.0, 1.0], turn)
    rotations[frame, joint] = quat.multiply(rotations[frame, joint], twist)
    return motion.with_pose(Pose(translations, rotations, full.scales))


def test_an_animation_equals_itself(rng: np.random.Generator) -> None:
    skeleton = random_skeleton(rng, 30, scaled=True)
    motion = Motion(skeleton.names, random_pose(rng, (50,), 30, scaled=True), 24)
    for other in (motion, to_clip(motion)):
        error = roundtrip_error(motion, other, skeleton)
        assert error.position_mm == 0
        assert error.rotation_deg == 0
        assert error.within(0, 0)
        assert (error.joints, error.frames) == (30, 50)
    assert str(error) == "30 joints x 50 frames: positions within 0 mm, rotations within 0 degrees"


def test_a_moved_joint_is_found(motion: Motion, skeleton: Skeleton) -> None:
    error = roundtrip_error(motion, changed(motion, 7, 2, move=(0, 0.003, 0.004)), skeleton)
    assert error.position_mm == pytest.approx(5.0)
    assert (error.position_joint, error.position_frame) == ("elbow", 7)
    assert error.rotation_deg == 0
    assert not error.within(4.9, 0)
    assert error.within(5.1, 0)


@pytest.mark.parametrize("degrees", [90.0, 1.0, 1e-3, 1e-6])
def test_a_turned_joint_moves_the_hand_on_its_arc(motion: Motion, skeleton: Skeleton, degrees: float) -> None:
    angle = np.radians(degrees)
    error = roundtrip_error(motion, changed(motion, 3, 1, turn=angle), skeleton)
    assert error.rotation_deg == pytest.approx(degrees, rel=1e-6)
    assert error.position_mm == pytest.approx(1e3 * 2 * 2 * np.sin(angle / 2), rel=1e-6)  # a chord at 2 m
    assert (error.position_joint, error.position_frame, error.rotation_frame) == ("hand", 3, 3)


def test_the_sign_of_a_quaternion_is_no_error(motion: Motion, skeleton: Skeleton) -> None:
    pose = motion.pose
    assert (
        roundtrip_error(motion, motion.with_pose(replace(pose, rotations=-pose.rotations)), skeleton).rotation_deg == 0
    )


def test_float32_is_seen_at_its_size(rng: np.random.Generator) -> None:
    skeleton = random_skeleton(rng, 30)
    motion = Motion(skeleton.names, random_pose(rng, (50,), 30), 24)
    error = roundtrip_error(motion, motion.with_pose(as_type(motion.pose, np.float32)), skeleton)
    assert 0 < error.position_mm < 1e-3
    assert 0 < error.rotation_deg < 1e-4
    assert error.within(1e-3, 1e-4)


def test_late_float32_key_times_are_no_error(rng: np.random.Generator) -> None:
    skeleton = random_skeleton(rng, 5)
    motion = Motion(skeleton.names, random_pose(rng, (200,), 5), 120, start_s=1000.0)
    clip = to_clip(motion)
    times = motion.times_s.astype(np.float32)
    rounded = Clip({c: replace(curve, times_s=times) for c, curve in clip.curves.items()})
    assert roundtrip_error(motion, rounded, skeleton).within(1e-6, 1e-6)
    assert roundtrip_error(rounded, motion, skeleton).within(1e-6, 1e-6)


def test_two_clips_are_also_compared_between_their_keys(rng: np.random.Generator) -> None:
    skeleton = random_skeleton(rng, 5)
    motion = Motion(skeleton.names, random_pose(rng, (6,), 5), 2)
    clip = to_clip(motion)
    assert roundtrip_error(clip, to_clip(motion), skeleton).within(0, 0)
    held = Clip({c: replace(curve, modes=np.zeros(6)) for c, curve in clip.curves.items()})
    assert roundtrip_error(clip, held, skeleton).position_mm > 10


def test_what_is_missing_is_said(motion: Motion, skeleton: Skeleton) -> None:
    rest = skeleton.rest
    rest = Pose(rest.translations[:3], rest.rotations[:3], rest.scales[:3])
    short = Skeleton(skeleton.names[:3], skeleton.parents[:3], rest)
    full = motion.pose.broadcast()
    pose = Pose(full.translations[:15, :3], full.rotations[:15, :3], full.scales[:15, :3])
    error = roundtrip_error(motion, Motion(short.names, pose, 30, start_s=0.5), skeleton, short)
    assert (error.joints_missing, error.frames_missing, error.start_shift_s) == (("hand",), 5, 0.5)
    assert not error.within(1e9, 1e9)
    assert str(error).endswith("1 joints are missing: hand; the copy has 5 frames less; the copy starts 0.5 s later")


def test_other_rates_are_compared_at_the_originals(rng: np.random.Generator) -> None:
    skeleton = random_skeleton(rng, 5)
    motion = Motion(skeleton.names, random_pose(rng, (30,), 5), 30)
    assert roundtrip_error(motion, resample(motion, 120), skeleton).within(1e-6, 1e-6)


def test_nothing_to_compare_is_refused(rng: np.random.Generator, motion: Motion, skeleton: Skeleton) -> None:
    other = random_skeleton(rng, 3)
    with pytest.raises(ShapeError, match="no joint name in common"):
        roundtrip_error(motion, Clip(), skeleton, other)
    with pytest.raises(ShapeError, match=r"use evaluate\.match first"):
        roundtrip_error(motion, motion, other)


def test_not_a_number_is_never_within() -> None:
    error = RoundtripError(np.nan, "a", 0, 0.0, "a", 0, 1, 1)
    assert not error.within(1e9, 1e9)
