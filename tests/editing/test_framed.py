"""Edits of frames on clips: what changed is keyed frame by frame, what did not stays the curve that it was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from keypose import samples
from keypose.editing.displacement import displace
from keypose.editing.framed import clip_rate, edit_frames
from keypose.editing.operators import run_operator
from keypose.editing.reach import found_roles
from keypose.editing.selection import Selection
from keypose.evaluate import bake, sample_clip, to_clip, world
from keypose.math import quat
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation, Property, Skeleton


@pytest.fixture(scope="module")
def human():
    scene = samples.load("human")
    return {a.name: a for a in scene.animations}, scene.character.skeleton


def bump(skeleton: Skeleton, joint: str, first: int, last: int):
    def change(motion):
        turn = np.zeros((motion.frame_count, 3))
        turn[first : last + 1] = (0.0, 0.4, 0.1)
        return displace(motion, {skeleton.index(joint): turn})

    return change


def key_clip(skeleton, mode=Interpolation.LINEAR):
    """A few keys on three joints, one with Euler angles, one with a curve for each component of its place."""
    times = np.array([0.0, 0.5, 1.0, 2.0])
    turns = quat.from_rotation_vector(np.array([[0.0, 0, 0], [0.3, 0.2, 0], [0, 0.5, 0.1], [0.2, 0, 0]]))
    curves = {
        Channel("Head", Property.ROTATION): Curve(times, turns, mode, kind=CurveKind.ROTATION),
        Channel("Spine", Property.EULER): Curve(
            times, np.float64([[0, 0, 0], [0.2, 0, 0], [0, 0.3, 0], [0, 0, 0.1]]), kind=CurveKind.EULER
        ),
        Channel("Hips", Property.TRANSLATION, 1): Curve(
            times, np.float64([[0.9], [1.0], [0.8], [0.9]]), kind=CurveKind.SCALAR
        ),
    }
    return Clip(curves, "keys", 30.0)


@pytest.mark.parametrize("mode", [Interpolation.LINEAR, Interpolation.STEP, Interpolation.SQUAD])
def test_only_changed_frames_get_keys(human, mode):
    skeleton = human[1]
    clip = key_clip(skeleton, mode)
    change = bump(skeleton, "Head", 20, 24)
    made = edit_frames(clip, skeleton, change)
    channel = Channel("Head", Property.ROTATION)
    assert all(made.curves[c] is clip.curves[c] for c in clip.curves if c != channel)
    curve = made.curves[channel]
    inside = (curve.times_s > 19.5 / 30) & (curve.times_s < 24.5 / 30)
    assert inside.sum() == 5
    assert curve.key_count == (61 if mode is Interpolation.SQUAD else 4 + 5 + 2)
    wanted = change(bake(clip, skeleton, 30.0))
    at = np.arange(61) / 30
    got = sample_clip(made, skeleton, at)
    off = quat.angle_between(
        np.float64(got.rotations[:, skeleton.index("Head")]),
        np.float64(wanted.pose.rotations[:, skeleton.index("Head")]),
    )
    assert off.max() < 1e-6
    # between the old keys outside, too
    outside = np.concatenate([np.linspace(0, 19 / 30, 50), np.linspace(25 / 30, 2, 50)])
    old, new = (
        np.float64(sample_clip(c, skeleton, outside).rotations[:, skeleton.index("Head")]) for c in (clip, made)
    )
    # a spline on the sphere goes straight from frame to frame now
    assert quat.angle_between(old, new).max() < (1e-3 if mode is Interpolation.SQUAD else 1e-6)


def test_euler_angles_and_single_components_become_whole_curves(human):
    skeleton = human[1]
    clip = key_clip(skeleton)
    turned = bump(skeleton, "Spine", 10, 12)
    wanted = turned(bake(clip, skeleton, 30.0))
    made = edit_frames(clip, skeleton, turned)
    assert Channel("Spine", Property.EULER) not in made.curves
    moved = np.zeros((61, 3))
    moved[30] = (0.1, 0.1, 0.0)
    made = edit_frames(made, skeleton, lambda m: displace(m, None, {0: moved}))
    assert Channel("Hips", Property.TRANSLATION, 1) not in made.curves
    got = sample_clip(made, skeleton, np.arange(61) / 30)
    np.testing.assert_allclose(
        got.translations[:, 0],
        np.broadcast_to(wanted.pose.translations, (61, skeleton.joint_count, 3))[:, 0] + moved,
        atol=1e-6,
    )
    spine = skeleton.index("Spine")
    assert (
        quat.angle_between(np.float64(got.rotations[:, spine]), np.float64(wanted.pose.rotations[:, spine])).max()
        < 1e-6
    )


def test_a_joint_that_had_no_keys_rests_outside(human):
    skeleton = human[1]
    made = edit_frames(key_clip(skeleton), skeleton, bump(skeleton, "LeftArm", 20, 24))
    curve = made.curves[Channel("LeftArm", Property.ROTATION)]
    np.testing.assert_allclose(curve.times_s * 30, np.arange(19, 26), atol=1e-9)
    rest = skeleton.rest.rotations[skeleton.index("LeftArm")]
    np.testing.assert_allclose(curve.values[[0, -1]], np.stack([rest, rest]), atol=1e-12)


def test_no_change_is_the_same_clip(human):
    motions, skeleton = human
    clip = to_clip(motions["walk"])
    made = edit_frames(clip, skeleton, lambda m: m)
    assert dict(made.curves) == dict(clip.curves)
    assert clip_rate(replace(clip, rate_hz=None)) == 30.0


def places(clip, skeleton, at):
    return np.asarray(world(skeleton, sample_clip(clip, skeleton, at)), np.float64)[..., :3, 3]


def test_reach_as_an_operator(human):
    motions, skeleton = human
    roles = found_roles(skeleton)
    clip = to_clip(motions["idle"])
    hand = Channel("LeftHand", Property.ROTATION)
    parameters = {"x_m": 0.1, "y_m": 0.2, "z_m": 0.2, "first_frame": 60, "last_frame": 70}
    done = run_operator("reach", clip, skeleton, Selection(channels=(hand,)), parameters)
    assert "LeftHand is there" in done.report
    at = motions["idle"].times_s
    before, after = places(clip, skeleton, at), places(done.clip, skeleton, at)
    np.testing.assert_allclose(
        after[60:71, roles["left_hand"]] - before[60:71, roles["left_hand"]],
        np.tile([0.1, 0.2, 0.2], (11, 1)),
        atol=1e-4,
    )
    assert np.array_equal(before[:36], after[:36]) and np.array_equal(before[95:], after[95:])
    untouched = [c for c in clip.curves if done.clip.curves[c] is clip.curves[c]]
    assert len(untouched) == len(clip.curves) - 3  # the arm's three joints
    # selected keys say when
    keyed = run_operator("reach", clip, skeleton, Selection(channels=(hand,), keys={hand: [100, 110]}), {"x_m": 0.1})
    moved = np.flatnonzero(np.abs(places(keyed.clip, skeleton, at) - before).max(axis=(1, 2)) > 1e-6)
    assert moved[0] > 75 and moved[-1] < 135 and 105 in moved
    far = run_operator(
        "reach", clip, skeleton, Selection(channels=(hand,)), {"y_m": 3.0, "first_frame": 60, "last_frame": 60}
    )
    assert "mm away" in far.report


def test_path_pose_and_space_time_as_operators(human):
    motions, skeleton = human
    roles = found_roles(skeleton)
    walk = to_clip(motions["walk"])
    at = motions["walk"].times_s
    bent = run_operator("bend_path", walk, skeleton, parameters={"angle_deg": 90})
    assert bent.report.startswith("2.50 m, turning by ")
    hips = places(bent.clip, skeleton, at)[:, roles["hips"]]
    assert hips[-1, 0] > 1.0  # to the left
    closed = run_operator("bend_path", walk, skeleton, parameters={"close": True})
    hips = places(closed.clip, skeleton, at)[:, roles["hips"]]
    assert np.linalg.norm(hips[-1, [0, 2]] - hips[0, [0, 2]]) < 0.1
    ball = samples.load("ball").character.skeleton
    height = Curve([0.0, 1.0], [[0.0, 0.3, 0.0], [0.0, 0.5, 0.0]])
    clip_of_a_ball = Clip({Channel("Ball", Property.TRANSLATION): height}, "", 30.0)
    assert "no path to bend" in run_operator("bend_path", clip_of_a_ball, ball).report

    idle = to_clip(motions["idle"])
    at = motions["idle"].times_s
    before = places(idle, skeleton, at)
    posed = run_operator(
        "pose_fall_off",
        idle,
        skeleton,
        parameters={"joint": "Hips", "x_deg": 25.0, "first_frame": 60, "keep_feet": True},
    )
    after = places(posed.clip, skeleton, at)
    assert np.abs(after[60, roles["head"]] - before[60, roles["head"]]).max() > 0.1
    np.testing.assert_allclose(after[:, roles["left_foot"]], before[:, roles["left_foot"]], atol=1e-4)
    low = run_operator(
        "spacetime",
        idle,
        skeleton,
        parameters={"joint": "LeftHand", "y_m": -0.5, "z_m": 0.3, "first_frame": 60, "last_frame": 62},
    )
    assert "LeftHand is there" in low.report
    after = places(low.clip, skeleton, at)
    np.testing.assert_allclose(after[:, roles["right_foot"]], before[:, roles["right_foot"]], atol=2e-4)
