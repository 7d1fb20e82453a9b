"""Paths over the ground: read, bent, drawn, closed; motions follow them and their feet do not slide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from keypose import io, samples
from keypose.analysis import measure_quality
from keypose.editing.paths import (
    GroundPath,
    bend_path,
    close_path,
    extract_path,
    follow_points,
    move_path,
    put_on_path,
    retime,
    scale_path,
    speeds_for,
    turn_path,
)
from keypose.editing.reach import found_roles
from keypose.errors import ShapeError
from keypose.evaluate import world
from keypose.model import Event, Pose


def places(skeleton, motion):
    return np.asarray(world(skeleton, motion.pose.broadcast()), np.float64)[..., :3, 3]


def knee_acceleration(skeleton, roles, motion):
    """The largest second derivative of a knee's angle, rad / s^2."""
    at = places(skeleton, motion)
    worst = 0.0
    for side in ("left", "right"):
        hip, knee, foot = (at[:, roles[f"{side}_{p}"]] for p in ("upper_leg", "lower_leg", "foot"))
        a, b = hip - knee, foot - knee
        cosine = np.sum(a * b, axis=-1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)
        worst = max(worst, np.abs(np.diff(np.arccos(np.clip(cosine, -1, 1)), 2)).max() * motion.rate_hz**2)
    return worst


@pytest.fixture(scope="module")
def walk():
    scene = samples.load("walk")
    return scene.animations[0], scene.character.skeleton, found_roles(scene.character.skeleton)


@pytest.fixture
def curved():
    t = np.linspace(0, 2, 121)
    return GroundPath(np.stack([0.3 * np.sin(2 * t), 1.3 * t], axis=-1), 60.0)


def test_a_straight_walk_has_a_straight_path(walk):
    motion, skeleton, roles = walk
    path = extract_path(motion, skeleton)
    assert path.lengths_m[-1] == pytest.approx(2.5, abs=0.01)
    np.testing.assert_allclose(path.headings_rad, 0, atol=0.04)
    np.testing.assert_allclose(path.speeds_m_s, 1.2, atol=0.1)
    swaying = extract_path(motion, skeleton, smooth_s=0.0)
    np.testing.assert_allclose(swaying.points, places(skeleton, motion)[:, roles["hips"]][:, [0, 2]], atol=1e-6)
    assert np.ptp(path.points[:, 0]) < np.ptp(swaying.points[:, 0])


def test_bending_keeps_steps_and_adds_the_angle(curved):
    for angle in (-3.0, 0.5, 2 * np.pi):
        bent = bend_path(curved, angle)
        steps = [np.linalg.norm(np.diff(p.points, axis=0), axis=-1) for p in (curved, bent)]
        np.testing.assert_allclose(steps[1], steps[0], atol=1e-12)
        assert bent.turning_rad - curved.turning_rad == pytest.approx(angle, abs=0.06)  # by half a step at both ends
    back = bend_path(bend_path(curved, 1.0), -1.0)
    np.testing.assert_allclose(back.points, curved.points, atol=1e-9)
    late = bend_path(curved, 1.0, 60)
    np.testing.assert_allclose(late.points[:61], curved.points[:61], atol=1e-12)


def test_a_whole_turn_of_a_straight_way_is_a_circle():
    straight = GroundPath(np.stack([np.zeros(241), np.linspace(0, 2 * np.pi, 241)], axis=-1), 60.0)
    ring = bend_path(straight, 2 * np.pi).points
    centre = ring[:-1].mean(axis=0)
    np.testing.assert_allclose(np.linalg.norm(ring - centre, axis=-1), 1.0, atol=1e-3)
    np.testing.assert_allclose(centre, [1.0, 0.0], atol=1e-2)  # to the left, which is +X
    assert np.linalg.norm(ring[-1] - ring[0]) < 1e-9


def test_closing(curved):
    for turns in (None, 1, -1, 2):
        closed = close_path(curved, turns)
        assert np.linalg.norm(closed.points[-1] - closed.points[0]) < 1e-9
        assert closed.turning_rad == pytest.approx(2 * np.pi * (turns or np.sign(curved.turning_rad)), abs=0.3)
    with pytest.raises(ShapeError, match="does not turn cannot close"):
        close_path(curved, 0)


def test_turned_scaled_and_moved(curved):
    turned = turn_path(curved, 0.7, 30)
    np.testing.assert_allclose(turned.headings_rad - curved.headings_rad, 0.7, atol=1e-9)
    np.testing.assert_allclose(turned.lengths_m, curved.lengths_m, atol=1e-12)
    assert np.array_equal(turned.points[30], curved.points[30])
    scaled = scale_path(curved, 1.5)
    np.testing.assert_allclose(scaled.lengths_m, 1.5 * curved.lengths_m, atol=1e-12)
    moved = move_path(curved, {60: (0.3, -0.1)}, ease_s=0.5)
    np.testing.assert_allclose(moved.points[60] - curved.points[60], [0.3, -0.1], atol=1e-12)
    assert np.array_equal(moved.points[:31], curved.points[:31])


def test_following_a_drawing(curved):
    drawn = np.array([[0.0, 0], [0, 1], [1, 2], [3, 2]])
    path = follow_points(curved, drawn)
    np.testing.assert_allclose(path.lengths_m, curved.lengths_m, rtol=2e-3)
    for point in drawn[:3]:
        assert np.linalg.norm(path.points - point, axis=-1).min() < 0.02
    stretched = follow_points(curved, drawn, stretch=True)
    np.testing.assert_allclose(stretched.points[[0, -1]], drawn[[0, -1]], atol=1e-9)
    short = follow_points(curved, [[0.0, 0], [0, 0.5]])
    np.testing.assert_allclose(short.points[:, 0], 0, atol=1e-12)
    assert short.points[-1, 1] == pytest.approx(curved.lengths_m[-1], abs=1e-6)  # straight on
    ring = follow_points(curved, [[1.0, 0], [0, 1], [-1, 0], [0, -1]], closed=True)
    assert np.linalg.norm(ring.points, axis=-1).max() < 1.05 and np.linalg.norm(ring.points, axis=-1).min() > 0.95
    with pytest.raises(ShapeError, match="twice"):
        follow_points(curved, [[0, 0], [0, 0], [1, 1]])
    with pytest.raises(ShapeError, match="3 finite ones or more"):
        follow_points(curved, [[0, 0], [1, 1]], closed=True)


def test_the_own_path_changes_no_bit_and_a_rigid_one_nothing_else(walk):
    motion, skeleton, roles = walk
    path = extract_path(motion, skeleton, roles=roles)
    assert put_on_path(motion, skeleton, path).motion is motion
    moved = turn_path(path, 0.8)
    moved = GroundPath(moved.points + np.array([1.0, -2.0]), moved.rate_hz)
    done = put_on_path(motion, skeleton, moved, old=path)
    before, after = places(skeleton, motion), places(skeleton, done.motion)
    apart = [np.linalg.norm(w[:, :, None] - w[:, None], axis=-1) for w in (before[::20], after[::20])]
    np.testing.assert_allclose(apart[0], apart[1], atol=1e-5)
    np.testing.assert_allclose(after[..., 1], before[..., 1], atol=1e-6)
    c, s = np.cos(0.8), np.sin(0.8)
    pivot = path.points[0]
    x, z = before[..., 0] - pivot[0], before[..., 2] - pivot[1]
    np.testing.assert_allclose(after[..., 0], pivot[0] + 1 + c * x + s * z, atol=1e-5)
    np.testing.assert_allclose(after[..., 2], pivot[1] - 2 + c * z - s * x, atol=1e-5)
    others = range(1, skeleton.joint_count)
    assert np.array_equal(done.motion.pose.rotations[:, others], motion.pose.rotations[:, others])


CHANGES = {
    "bent": lambda p: bend_path(p, np.pi / 2),
    "circle": lambda p: close_path(p),
    "moved": lambda p: move_path(p, {len(p.points) // 2: (0.2, 0.0)}, ease_s=0.5 * len(p.points) / p.rate_hz),
    "drawn": lambda p: follow_points(p, p.points[0] + np.array([[0, 0], [0.5, 1], [1.5, 1.5], [2, 3]])),
    "longer": lambda p: scale_path(p, 1.15),
}


def assert_planted(motion, skeleton, roles, path, new, knees):
    done = put_on_path(motion, skeleton, new, old=path, roles=roles)
    before, after = places(skeleton, motion), places(skeleton, done.motion)
    was, now = (measure_quality(m, skeleton, roles) for m in (motion, done.motion))
    assert now.skate_cm_s < 0.1 and now.worst_skate_cm_s < 1.0
    # contacts are not lost; a run that was filmed for a step and a half has few
    assert now.contact_share > min(0.8 * was.contact_share, was.contact_share - 0.02)
    assert done.short_m < 0.005
    # the hips sway about the new path as far as they did about the old one, but for what knees ask of them
    sways = [
        np.linalg.norm(at[:, roles["hips"]][:, [0, 2]] - p.points, axis=-1) for at, p in ((before, path), (after, new))
    ]
    np.testing.assert_allclose(sways[1], sways[0], atol=0.12)
    ratio = knee_acceleration(skeleton, roles, done.motion) / knee_acceleration(skeleton, roles, motion)
    assert ratio < knees and done.knee_ratio == pytest.approx(ratio, rel=0.05)


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", ["walk", "run"])
def test_feet_stay_planted_on_a_new_path(name, change):
    scene = samples.load("human")
    skeleton = scene.character.skeleton
    roles = found_roles(skeleton)
    motion = next(a for a in scene.animations if a.name == name)
    path = extract_path(motion, skeleton, roles=roles)
    assert_planted(motion, skeleton, roles, path, CHANGES[change](path), 1.3)


@pytest.mark.data
@pytest.mark.parametrize("change", ["bent", "circle", "drawn", "longer"])
@pytest.mark.parametrize("take", ["02_01", "02_02", "02_03"])
def test_real_walks_and_runs_on_new_paths(data_dir, take, change):
    scene = io.load(data_dir / "asf_amc" / "cmu_02" / f"{take}.amc")
    skeleton = scene.character.skeleton
    motion, roles = scene.animations[0], found_roles(skeleton)
    path = extract_path(motion, skeleton, roles=roles)
    assert path.lengths_m[-1] > 2
    assert_planted(motion, skeleton, roles, path, CHANGES[change](path), 1.5)


@pytest.mark.data
def test_knees_are_bounded_in_circles_that_are_too_tight(data_dir):
    """A step and a half of a run round a whole circle, and a capture that begins with a pose of calibration at 7 m/s."""
    for take, turn in (("02_03", 2.0), ("007_07", 1.0)):
        file = f"asf_amc/cmu_02/{take}.amc" if take.startswith("02") else f"bvh/cmu_iclone_007/{take}.bvh"
        scene = io.load(data_dir / file)
        skeleton, motion = scene.character.skeleton, scene.animations[0]
        roles = found_roles(skeleton)
        path = extract_path(motion, skeleton, roles=roles)
        done = put_on_path(motion, skeleton, bend_path(path, -2 * np.pi * turn), old=path, roles=roles)
        ratio = knee_acceleration(skeleton, roles, done.motion) / knee_acceleration(skeleton, roles, motion)
        assert ratio < 1.5 and done.knee_ratio < 1.5
        assert measure_quality(done.motion, skeleton, roles).skate_cm_s < 0.1


@pytest.mark.parametrize("size", [0.01, 100.0, 1000.0])
def test_a_body_of_another_size_goes_the_same_way(walk, size):
    motion, skeleton, roles = walk
    results = []
    for scale in (1.0, size):
        pose = motion.pose.broadcast()
        moved = Pose(*(np.asarray(a, float) for a in (pose.translations * scale, pose.rotations, pose.scales)))
        rest = replace(skeleton.rest, translations=scale * np.asarray(skeleton.rest.translations, float))
        body, larger = replace(skeleton, rest=rest), motion.with_pose(moved)
        path = extract_path(larger, body, roles=roles)
        done = put_on_path(larger, body, bend_path(path, 1.5), old=path, roles=roles)
        results.append((places(body, done.motion) / scale, path.headings_rad))
    for n in (0, 1):
        np.testing.assert_allclose(results[1][n], results[0][n], atol=1e-6)


def test_retiming(walk):
    motion, skeleton, roles = walk
    assert retime(motion, skeleton, 1.0) is motion
    double = retime(motion, skeleton, 2.0, plant=False)
    assert double.frame_count == 63
    assert np.array_equal(double.pose.rotations, motion.pose.rotations[::2])
    slow = retime(motion, skeleton, np.linspace(1.0, 0.5, motion.frame_count), roles=roles)
    assert slow.duration_s == pytest.approx(motion.duration_s * 2 * np.log(2), rel=0.01)
    before, after = places(skeleton, motion), places(skeleton, slow)
    np.testing.assert_allclose(after[-1], before[-1], atol=0.02)
    quick = retime(motion, skeleton, 1.3, roles=roles)
    assert measure_quality(quick, skeleton, roles).skate_cm_s < 1.0
    path = extract_path(motion, skeleton, roles=roles)
    brisk = retime(motion, skeleton, speeds_for(path, 1.8), roles=roles)
    inner = extract_path(brisk, skeleton, roles=roles).speeds_m_s[20:-20]
    np.testing.assert_allclose(inner, 1.8, atol=0.15)
    for wrong in (0.0, -1.0, np.ones(3), np.nan):
        with pytest.raises(ShapeError, match="speed"):
            retime(motion, skeleton, wrong)


def test_retiming_takes_events_and_morphs_along():
    scene = samples.load("human")
    talk = next(a for a in scene.animations if a.name == "talk")
    done = retime(talk, scene.character.skeleton, 2.0, plant=False)
    np.testing.assert_allclose(done.morph_weights, talk.morph_weights[::2], atol=1e-6)
    marked = replace(talk, start_s=1.0, events=(Event(1.5, "step", "left"), Event(2.0, "step", "right")))
    slow = retime(marked, scene.character.skeleton, 0.5, plant=False)
    assert [(e.time_s, e.data) for e in slow.events] == [(2.0, "left"), (3.0, "right")]


def test_what_stands_has_no_path_to_bend():
    scene = samples.load("human")
    idle = next(a for a in scene.animations if a.name == "idle")
    path = extract_path(idle, scene.character.skeleton)
    assert np.array_equal(speeds_for(path, 1.0), np.ones(idle.frame_count))
    still = GroundPath(np.zeros((10, 2)), 30.0)
    with pytest.raises(ShapeError, match="one that stands"):
        bend_path(still, 1.0)
    with pytest.raises(ShapeError, match="385 points to match"):
        put_on_path(idle, scene.character.skeleton, still)


def test_a_contact_keeps_one_place_also_far_from_the_origin(walk):
    """Rounding at ten metres is more than at one; a contact that it would break in two must not get two places."""
    motion, skeleton, roles = walk
    pose = motion.pose.broadcast()
    far = np.array(pose.translations)
    far[:, 0] += (3.0, 0.0, 9.0)
    motion = motion.with_pose(Pose(far, pose.rotations, pose.scales))
    path = extract_path(motion, skeleton, roles=roles)
    after = places(skeleton, put_on_path(motion, skeleton, bend_path(path, 3.0), old=path, roles=roles).motion)
    before = places(skeleton, motion)
    for side in ("left", "right"):
        ball = roles[f"{side}_toes"]
        still = np.linalg.norm(np.diff(before[:, ball], axis=0), axis=-1) < 1e-4
        runs = np.split(np.flatnonzero(still), np.flatnonzero(np.diff(np.flatnonzero(still)) > 1) + 1)
        assert len(runs) > 1
        for run in runs:
            assert np.ptp(after[run, ball], axis=0).max() < 2e-3
