"""Limits of a human's joints: what a body does is allowed, what it cannot is not, whatever the rest pose and axes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from keypose import evaluate, io, samples
from keypose.analysis import find_roles, human_limits
from keypose.errors import ShapeError
from keypose.ik import find_limit_breaks, limit_violation
from keypose.math import quat
from keypose.model import Clip, Motion, Pose, Skeleton
from tests.synthetic import random_rotations

# model-space turns of a joint (axis, degrees) that a healthy body can and cannot do, from the built-in human's A pose
CAN = {
    "left_lower_arm": [((0.7, 0.7, 0.0), -140.0)],
    "left_lower_leg": [((1.0, 0.0, 0.0), 140.0)],
    "left_upper_leg": [((1.0, 0.0, 0.0), -110.0), ((0.0, 0.0, 1.0), 40.0), ((1.0, 0.0, 0.0), 20.0)],
    "left_upper_arm": [((0.0, 0.0, 1.0), 130.0), ((0.0, 0.0, 1.0), -60.0), ((1.0, 0.0, 0.0), -160.0)],
    "head": [((0.0, 1.0, 0.0), 60.0), ((1.0, 0.0, 0.0), -30.0), ((1.0, 0.0, 0.0), 40.0)],
    "spine": [((1.0, 0.0, 0.0), 30.0), ((0.0, 1.0, 0.0), 25.0)],
}
CANNOT = {
    "left_lower_arm": [((0.7, 0.7, 0.0), 60.0)],
    "left_lower_leg": [((1.0, 0.0, 0.0), -50.0), ((0.0, 0.0, 1.0), 50.0), ((0.0, 1.0, 0.0), 70.0)],
    "left_upper_leg": [((1.0, 0.0, 0.0), 80.0), ((0.0, 0.0, 1.0), 120.0)],
    "left_upper_arm": [((1.0, 0.0, 0.0), 130.0)],
    "head": [((0.0, 1.0, 0.0), 120.0), ((1.0, 0.0, 0.0), 90.0)],
    "spine": [((1.0, 0.0, 0.0), -70.0), ((0.0, 1.0, 0.0), 90.0)],
}


@pytest.fixture(scope="module")
def body() -> Skeleton:
    return samples.load("human").character.skeleton


def posed(skeleton: Skeleton, joint: int, axis: tuple[float, float, float], degrees: float) -> np.ndarray:
    """The local rotation of a joint that is turned in the model's space."""
    turned = np.asarray(evaluate.world_rotations_positions(skeleton, skeleton.rest)[0])
    unit = np.asarray(axis) / np.linalg.norm(axis)
    turn = quat.from_rotation_vector(unit * np.radians(degrees))
    local = quat.multiply(quat.multiply(quat.conjugate(turned[joint]), turn), turned[joint])
    return quat.multiply(np.asarray(skeleton.rest.rotations)[joint], local)


def with_other_axes(skeleton: Skeleton, seed: int) -> Skeleton:
    """The same body at rest, whose joints have axes of their own in every direction."""
    turned, places = (np.asarray(a) for a in evaluate.world_rotations_positions(skeleton, skeleton.rest))
    new = quat.multiply(turned, random_rotations(np.random.default_rng(seed), len(turned)))
    rotations, translations = new.copy(), places.copy()
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            back = quat.conjugate(new[parent])
            rotations[joint] = quat.multiply(back, new[joint])
            translations[joint] = quat.rotate(back, places[joint] - places[parent])
    return Skeleton(skeleton.names, skeleton.parents, Pose(translations, rotations, np.ones((len(turned), 3))))


@pytest.mark.parametrize("seed", [None, 1, 2])
def test_what_a_body_can_do_is_allowed_and_what_it_cannot_is_not(body: Skeleton, seed: int | None) -> None:
    skeleton = body if seed is None else with_other_axes(body, seed)
    roles = find_roles(body).roles
    limits = human_limits(skeleton, roles)
    for table, allowed in ((CAN, True), (CANNOT, False)):
        for role, turns in table.items():
            for axis, degrees in turns:
                name = skeleton.names[roles[role]]
                rest = np.asarray(skeleton.rest.rotations)[roles[role]]
                over = limit_violation(limits[name], posed(skeleton, roles[role], axis, degrees), rest)
                assert (np.degrees(float(over)) < 0.01) == allowed, (role, axis, degrees, np.degrees(float(over)))


def test_rest_poses_are_allowed_and_sides_are_alike(body: Skeleton) -> None:
    roles = find_roles(body)
    limits = human_limits(body, roles)
    assert "Hips" not in limits and "LeftArmTwist" not in limits
    assert len(limits) == len(roles.roles) - 1
    for name, limit in limits.items():
        assert limit_violation(limit, np.asarray(body.rest.rotations)[body.index(name)]) < 1e-9
        if name.startswith("Left"):
            other = limits["Right" + name.removeprefix("Left")]
            turn = quat.from_rotation_vector(np.random.default_rng(5).normal(size=(200, 3)))
            mirrored = turn * np.array([1.0, 1.0, -1.0, -1.0])
            np.testing.assert_allclose(limit_violation(limit, turn), limit_violation(other, mirrored), atol=1e-6)


def test_the_rest_pose_does_not_matter(body: Skeleton) -> None:
    """A T pose of the same body: the same places of the limbs are allowed."""
    roles = find_roles(body).roles
    turned = np.asarray(body.rest.rotations).copy()
    for side, sign in (("left", 1.0), ("right", -1.0)):
        turned[roles[f"{side}_upper_arm"]] = quat.from_rotation_vector([0.0, 0.0, sign * np.radians(45.0)])
    pose = Pose(body.rest.translations, turned, body.rest.scales)
    at_t = Skeleton(body.names, body.parents, pose)
    ours, theirs = human_limits(body, roles), human_limits(at_t, roles)
    by_pose = human_limits(body, roles, pose)
    rng = np.random.default_rng(3)
    for role in ("left_upper_arm", "right_lower_arm", "left_hand", "left_index_proximal", "right_upper_leg"):
        name, joint = body.names[roles[role]], roles[role]
        q = quat.multiply(turned[joint], quat.from_rotation_vector(rng.normal(size=(300, 3)) * 1.2))
        first = limit_violation(ours[name], q, np.asarray(body.rest.rotations)[joint])
        second = limit_violation(theirs[name], q, turned[joint])
        third = limit_violation(by_pose[name], q, np.asarray(body.rest.rotations)[joint])
        np.testing.assert_allclose(second, third, atol=1e-6)
        # The A pose is not at exactly 45 degrees: limits differ by as much, where they do at all.
        assert np.abs(first - second).max() < np.radians(4.0), role
        assert (first > 0.01).any() and (first < 1e-6).any(), role


@pytest.mark.data
def test_captures_of_people_keep_within_them(data_dir: Path) -> None:
    for file in ("bvh/cmu_cgspeed/cmu_12_01_walk.bvh", "cmu_01_01/01_01.bvh", "asf_amc/cmu_02/02_01.amc"):
        scene = io.load(data_dir / file)
        skeleton, motion = scene.character.skeleton, scene.animations[0]
        if isinstance(motion, Clip):
            motion = evaluate.bake(motion, skeleton, 30.0)
        assert isinstance(motion, Motion)
        assert find_limit_breaks(motion, skeleton, human_limits(skeleton, find_roles(skeleton))) == (), file


def test_wrong_input_is_named(body: Skeleton) -> None:
    with pytest.raises(ShapeError, match="role 'head'"):
        human_limits(body, {"head": 99})
    frames = Pose(np.zeros((2, 61, 3)), np.tile([1.0, 0, 0, 0], (2, 61, 1)), np.ones((2, 61, 3)))
    with pytest.raises(ShapeError, match="one pose of 61 joints"):
        human_limits(body, {"head": 5}, frames)
