"""Poses with fall-off: the pose itself at its frame, the old motion out of range, the share of the change in between."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from keypose import samples
from keypose.editing.falloff import FALL_OFFS, edit_pose, fall_off, with_joints
from keypose.editing.reach import changed_frames, found_roles
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import world
from keypose.math import quat
from keypose.model import Pose


@pytest.fixture(scope="module")
def walk():
    scene = samples.load("walk")
    return scene.animations[0], scene.character.skeleton


def turned_pose(motion, skeleton, frame, name="Head", angle=0.6, move=(0, 0, 0)):
    pose = motion.pose[frame]
    joint = skeleton.index(name)
    turn = quat.from_rotation_vector(np.array([0.2, angle, -0.1]))
    return with_joints(
        pose,
        skeleton,
        {name: quat.multiply(np.float64(pose.rotations[joint]), turn)},
        {skeleton.names[0]: pose.translations[0] + np.array(move)},
    )


@pytest.mark.parametrize("shape", FALL_OFFS)
def test_weights(shape):
    weights = fall_off(100, 40, 20, 30, shape)
    assert weights[40] == 1 and not weights[:21].any() and not weights[70:].any()
    assert np.all(np.diff(weights[:41]) >= 0) and np.all(np.diff(weights[40:]) <= 0)
    alone = fall_off(100, 40, 0, 0, shape)
    assert alone[40] == 1 and alone.sum() == 1
    fine = fall_off(4001, 2000, 1000, 1000, "smooth")
    # the quintic has no jump in slope or curvature: 10 / sqrt(3) is its largest second derivative
    assert np.abs(np.diff(fine, 2)).max() * 1e6 == pytest.approx(10 / np.sqrt(3), rel=1e-2)
    assert np.abs(np.diff(fine, 3)).max() * 1e9 < 61


@pytest.mark.parametrize("shape", FALL_OFFS)
def test_the_frame_has_the_pose_and_the_rest_is_untouched(walk, shape):
    motion, skeleton = walk
    pose = turned_pose(motion, skeleton, 60, move=(0, 0.1, 0))
    done = edit_pose(motion, skeleton, 60, pose, before_s=0.3, after_s=0.5, shape=shape)
    at = done.motion.pose[60]
    for name in ("rotations", "translations", "scales"):
        assert np.array_equal(getattr(at, name), np.asarray(getattr(pose, name), getattr(at, name).dtype))
    assert np.array_equal(changed_frames(motion, done.motion), done.weights > 0)
    assert not changed_frames(motion, done.motion)[: 60 - 17].any()
    # only what was changed changes, by its share
    head = skeleton.index("Head")
    others = [j for j in range(1, skeleton.joint_count) if j != head]
    assert np.array_equal(done.motion.pose.rotations[:, others], motion.pose.rotations[:, others])
    whole = Rotation.from_quat(motion.pose.rotations[60, head], scalar_first=True).inv() * Rotation.from_quat(
        pose.rotations[head], scalar_first=True
    )
    for frame in (50, 70, 80):
        change = Rotation.from_quat(motion.pose.rotations[frame, head], scalar_first=True).inv() * Rotation.from_quat(
            done.motion.pose.rotations[frame, head], scalar_first=True
        )
        np.testing.assert_allclose(change.as_rotvec(), done.weights[frame] * whole.as_rotvec(), atol=1e-5)
    rise = np.asarray(done.motion.pose.broadcast().translations - motion.pose.broadcast().translations)[:, 0, 1]
    np.testing.assert_allclose(rise, 0.1 * done.weights, atol=1e-6)


def test_the_same_pose_changes_nothing(walk):
    motion, skeleton = walk
    done = edit_pose(motion, skeleton, 60, motion.pose[60])
    assert not changed_frames(motion, done.motion).any()


def test_scales_fade_by_their_ratio(walk):
    motion, skeleton = walk
    pose = motion.pose[60]
    scales = np.array(pose.scales)
    scales[3] = 4.0
    done = edit_pose(motion, skeleton, 60, Pose(pose.translations, pose.rotations, scales), before_s=0.4, after_s=0.4)
    np.testing.assert_allclose(
        done.motion.pose.scales[:, 3, 0], motion.pose.broadcast().scales[:, 3, 0] * 4.0**done.weights, rtol=1e-6
    )


def test_feet_and_hands_stay_where_they_are_kept(walk):
    motion, skeleton = walk
    roles = found_roles(skeleton)
    pose = turned_pose(motion, skeleton, 60, name=skeleton.names[roles["spine"]], angle=0.3, move=(0, -0.05, 0.02))
    keep = ("left_foot", "right_foot", "right_hand")
    free = edit_pose(motion, skeleton, 60, pose).motion
    done = edit_pose(motion, skeleton, 60, pose, keep=keep)
    before, after, loose = (
        np.asarray(world(skeleton, m.pose.broadcast()), np.float64) for m in (motion, done.motion, free)
    )
    for name in keep:
        joint = roles[name]
        assert np.abs(loose[60, joint] - before[60, joint]).max() > 0.01  # else this would test nothing
        np.testing.assert_allclose(after[:, joint], before[:, joint], atol=2e-5)
    assert done.kept_m < 1e-5
    assert not changed_frames(motion, done.motion)[done.weights == 0].any()


def test_wrong_input_is_told(walk):
    motion, skeleton = walk
    pose = motion.pose[60]
    with pytest.raises(ShapeError, match="frame: expected 0 to 124, got 125"):
        edit_pose(motion, skeleton, 125, pose)
    with pytest.raises(UnknownName, match="nearest: 'smooth'"):
        edit_pose(motion, skeleton, 5, pose, shape="smoth")
    with pytest.raises(ShapeError, match="before_s"):
        edit_pose(motion, skeleton, 5, pose, before_s=-1)
    with pytest.raises(ShapeError, match="end of a limb"):
        edit_pose(motion, skeleton, 5, pose, keep=["hips"])
    with pytest.raises(UnknownName, match="nearest: 'Head'"):
        with_joints(pose, skeleton, {"Haed": (1, 0, 0, 0)})
    with pytest.raises(ShapeError, match="rotation"):
        with_joints(pose, skeleton, {"Head": (1, 0, 0)})
