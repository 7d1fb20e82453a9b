"""Chains and limits: reach, limits held, unreachable targets, batches, real skeletons."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from keypose import evaluate, samples
from keypose.errors import ShapeError, UnknownName
from keypose.ik import (
    Cone,
    EulerRange,
    Hinge,
    JointLimit,
    chain_between,
    clamp_pose,
    clamp_rotation,
    find_limit_breaks,
    limit_violation,
    solve_ccd,
    solve_fabrik,
)
from keypose.math import euler, quat
from keypose.model import Motion, Pose, Skeleton

SOLVERS = {"ccd": solve_ccd, "fabrik": solve_fabrik}
LIMITS: dict[str, JointLimit] = {
    "hinge": Hinge((0.0, 0.0, 1.0), -0.3, 1.9),
    "euler": EulerRange("ZXY", (-0.5, -0.4, -0.3), (1.0, 0.8, 0.6)),
    "cone": Cone((1.0, 0.2, 0.0), (0.9, 0.5), -0.4, 0.7),
}


def arm(count: int = 5, seed: int = 1) -> Skeleton:
    rng = np.random.default_rng(seed)
    translations = np.tile([0.3, 0.0, 0.0], (count, 1)) + rng.normal(size=(count, 3)) * 0.02
    rotations = quat.from_rotation_vector(rng.normal(size=(count, 3)) * 0.4)
    return Skeleton(
        tuple(f"j{n}" for n in range(count)),
        np.arange(-1, count - 1),
        Pose(translations, rotations, np.ones((count, 3))),
    )


def end_of(skeleton: Skeleton, pose: Pose) -> np.ndarray:
    return np.asarray(evaluate.world_rotations_positions(skeleton, pose)[1])[..., -1, :]


def random_pose(skeleton: Skeleton, rng: np.random.Generator, batch: tuple[int, ...], spread: float = 0.8) -> Pose:
    rest = skeleton.rest
    turns = quat.from_rotation_vector(rng.normal(size=(*batch, skeleton.joint_count, 3)) * spread)
    return Pose(rest.translations, quat.multiply(rest.rotations, turns), rest.scales)


@pytest.mark.parametrize("solver", SOLVERS)
def test_reachable_targets_are_reached(solver: str) -> None:
    skeleton, rng = arm(), np.random.default_rng(4)
    chain = chain_between(skeleton, "j0", "j4")
    targets = end_of(skeleton, random_pose(skeleton, rng, (2000,)))
    found = SOLVERS[solver](skeleton, random_pose(skeleton, rng, (2000,), 0.3), chain, targets, iterations=400)
    got = end_of(skeleton, found.pose)
    np.testing.assert_allclose(np.linalg.norm(got - targets, axis=-1), found.error_m, atol=1e-9)
    assert found.converged.mean() > 0.995
    assert np.array_equal(found.converged, found.error_m <= 1e-4)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_target_out_of_reach_is_approached_as_far_as_bones_go(solver: str) -> None:
    skeleton = arm()
    chain = chain_between(skeleton, "j0", "j4")
    places = np.asarray(evaluate.world_rotations_positions(skeleton, skeleton.rest)[1])
    reach = np.linalg.norm(np.diff(places[list(chain)], axis=0), axis=-1).sum()
    for way in np.random.default_rng(5).normal(size=(3, 3)):
        target = places[0] + 3.0 * way / np.linalg.norm(way)
        found = SOLVERS[solver](skeleton, skeleton.rest, chain, target, iterations=300)
        assert not found.converged
        assert found.error_m == pytest.approx(3.0 - reach, abs=2e-3)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("kind", LIMITS)
def test_limits_hold_and_what_they_allow_is_reached(solver: str, kind: str) -> None:
    skeleton, rng = arm(6, 2), np.random.default_rng(6)
    limits: dict[str, JointLimit] = {f"j{n}": LIMITS[kind] for n in (1, 3)}
    chain = chain_between(skeleton, "j0", "j5")
    allowed = clamp_pose(random_pose(skeleton, rng, (300,)), skeleton, limits)
    targets = end_of(skeleton, allowed)
    found = SOLVERS[solver](skeleton, skeleton.rest, chain, targets, limits=limits, iterations=400)
    for name, limit in limits.items():
        joint = skeleton.index(name)
        off = limit_violation(limit, found.pose.rotations[:, joint], skeleton.rest.rotations[joint])
        assert off.max() < 1e-7
    assert found.converged.mean() > 0.9


@pytest.mark.parametrize("solver", SOLVERS)
def test_singular_cases_are_finite(solver: str) -> None:
    skeleton = arm()
    chain = chain_between(skeleton, "j0", "j4")
    places = np.asarray(evaluate.world_rotations_positions(skeleton, skeleton.rest)[1])
    straight = Skeleton(
        skeleton.names, skeleton.parents, Pose(np.tile([0.3, 0, 0], (5, 1)), quat.identity((5,)), np.ones((5, 3)))
    )
    for body, target in (
        (skeleton, places[0]),
        (skeleton, places[-1]),
        (straight, [0.3, 0.0, 0.0]),
        (straight, [-1.0, 0.0, 0.0]),
    ):
        found = SOLVERS[solver](body, body.rest, chain, target)
        assert np.isfinite(found.pose.rotations).all() and np.isfinite(found.error_m)
        np.testing.assert_allclose(np.linalg.norm(found.pose.rotations, axis=-1), 1.0, atol=1e-9)
    still = SOLVERS[solver](skeleton, skeleton.rest, chain, places[-1])
    assert still.iterations == 0
    np.testing.assert_allclose(still.pose.rotations, skeleton.rest.rotations, atol=1e-12)


def test_batches_broadcast() -> None:
    skeleton, rng = arm(), np.random.default_rng(8)
    chain = chain_between(skeleton, 0, 4)
    targets = end_of(skeleton, random_pose(skeleton, rng, (3, 4)))
    found = solve_ccd(skeleton, skeleton.rest, chain, targets)
    assert found.pose.batch_shape == (3, 4) and found.error_m.shape == (3, 4)
    one = solve_ccd(skeleton, skeleton.rest, chain, targets[1, 2])
    # another number of rounds may be made for the batch; both are within the tolerance
    assert abs(float(one.error_m) - float(found.error_m[1, 2])) < 1e-4


def test_a_damped_turn_bends_the_whole_chain() -> None:
    skeleton = arm()
    chain = chain_between(skeleton, "j0", "j4")
    target = end_of(skeleton, random_pose(skeleton, np.random.default_rng(9), ()))
    quick = solve_ccd(skeleton, skeleton.rest, chain, target, iterations=500)
    even = solve_ccd(skeleton, skeleton.rest, chain, target, iterations=500, damping_rad=0.05)
    assert even.converged
    turns = [quat.angle_between(skeleton.rest.rotations, r.pose.rotations)[:4] for r in (quick, even)]
    assert turns[1].max() <= turns[0].max() + 1e-6


def test_a_hand_of_the_human_reaches_his_head() -> None:
    body = samples.open_scene("sample:human").character
    skeleton = body.skeleton
    chain = chain_between(skeleton, "LeftShoulder", "LeftHand")
    places = np.asarray(evaluate.world_rotations_positions(skeleton, skeleton.rest)[1], np.float64)
    target = places[skeleton.index("Head")] + [0.12, 0.1, 0.05]
    elbow: dict[str, JointLimit] = {"LeftForeArm": Hinge((0.0, 1.0, 0.0), -2.6, 0.0)}
    for solver in SOLVERS.values():
        found = solver(skeleton, skeleton.rest, chain, target, limits=elbow, iterations=500)
        got = np.asarray(evaluate.world_rotations_positions(skeleton, found.pose)[1])[skeleton.index("LeftHand")]
        np.testing.assert_allclose(got, target, atol=2e-3)
        assert found.pose.rotations.dtype == skeleton.rest.rotations.dtype


# --- limits -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", LIMITS)
def test_clamping_is_idempotent_and_keeps_what_is_allowed(kind: str) -> None:
    rng, limit = np.random.default_rng(3), LIMITS[kind]
    q, rest = quat.normalize(rng.normal(size=(500, 4))), quat.normalize(rng.normal(size=4))
    inside = clamp_rotation(limit, q, rest)
    again = clamp_rotation(limit, inside, rest)
    np.testing.assert_allclose(quat.angle_between(inside, again), 0.0, atol=1e-7)
    assert (limit_violation(limit, q, rest) > 0.01).mean() > 0.5
    np.testing.assert_allclose(np.linalg.norm(inside, axis=-1), 1.0, atol=1e-12)


def test_a_hinge_keeps_its_angle_against_scipy() -> None:
    hinge = Hinge((0.0, 0.0, 2.0), -0.5, 1.0)
    for angle, asked in ((0.3, 0.3), (1.4, 1.0), (-0.9, -0.5), (3.0, 1.0), (-2.8, -0.5)):
        got = clamp_rotation(hinge, Rotation.from_euler("z", angle).as_quat(scalar_first=True))
        np.testing.assert_allclose(Rotation.from_quat(got, scalar_first=True).as_rotvec(), [0, 0, asked], atol=1e-12)


def test_euler_ranges_against_scipy() -> None:
    rng = np.random.default_rng(4)
    low, high = np.array([-0.5, -0.4, -0.3]), np.array([1.0, 0.8, 0.6])
    angles = rng.uniform(low, high, size=(200, 3))
    q = Rotation.from_euler("ZXY", angles).as_quat(scalar_first=True)
    np.testing.assert_allclose(limit_violation(LIMITS["euler"], q), 0.0, atol=1e-7)
    over = angles.copy()
    over[:, 0] = high[0] + 0.2
    got = clamp_rotation(LIMITS["euler"], Rotation.from_euler("ZXY", over).as_quat(scalar_first=True))
    np.testing.assert_allclose(np.asarray(euler.from_quat(got, "ZXY"))[:, 0], high[0], atol=1e-9)


def test_a_cone_is_an_ellipse_of_swing_with_a_range_of_twist() -> None:
    cone = Cone((1.0, 0.0, 0.0), (0.6, 0.3), -0.2, 0.2)
    for vector, asked in (
        ([0.0, 0.5, 0.0], [0.0, 0.5, 0.0]),
        ([0.0, 1.2, 0.0], [0.0, 0.6, 0.0]),
        ([0.0, 0.0, -1.2], [0.0, 0.0, -0.3]),
        ([0.9, 0.0, 0.0], [0.2, 0.0, 0.0]),
    ):
        got = clamp_rotation(cone, quat.from_rotation_vector(np.array(vector)))
        np.testing.assert_allclose(quat.to_rotation_vector(got), asked, atol=1e-12)


def test_breaks_of_a_motion_are_listed() -> None:
    skeleton = arm(3)
    rest = skeleton.rest
    angles = np.linspace(0.0, 1.0, 11)
    rotations = np.tile(np.asarray(rest.rotations), (11, 1, 1))
    rotations[:, 1] = quat.multiply(rotations[:, 1], quat.from_axis_angle(np.tile([0.0, 0.0, 1.0], (11, 1)), angles))
    motion = Motion(skeleton.names, Pose(np.tile(rest.translations, (11, 1, 1)), rotations, np.ones((11, 3, 3))), 10.0)
    (found,) = find_limit_breaks(motion, skeleton, {"j1": Hinge((0.0, 0.0, 1.0), 0.0, 0.75), "j2": LIMITS["cone"]})
    assert (found.joint, found.frame) == ("j1", 10)
    assert found.worst_rad == pytest.approx(0.25) and found.share == pytest.approx(3 / 11)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Hinge((0.0, 0.0, 0.0), 0.0, 1.0),
        lambda: Hinge((0.0, 0.0, 1.0), 1.0, 0.0),
        lambda: Cone((1.0, 0.0, 0.0), 0.0),
        lambda: Cone((1.0, 0.0, 0.0), (0.5, 4.0)),
        lambda: EulerRange("XYZ", (0.0, 0.0, 0.0), (1.0, -1.0, 1.0)),
        lambda: EulerRange("XYZ", (0.0, 0.0), (1.0, 1.0)),  # pyright: ignore[reportArgumentType]
        lambda: Hinge((np.nan, 0.0, 1.0), 0.0, 1.0),
        lambda: Hinge((0.0, 1.0), 0.0, 1.0),  # pyright: ignore[reportArgumentType]
        lambda: Cone((1.0, 0.0, 0.0), np.nan),
        lambda: Cone((1.0, 0.0, 0.0), 1.0, center=(np.nan, 0.0, 0.0, 0.0)),
        lambda: Cone((1.0, 0.0, 0.0), 1.0, across=(0.0, np.nan, 0.0)),
    ],
)
def test_limits_that_make_no_sense_are_refused(make: Any) -> None:
    with pytest.raises(ShapeError):
        make()


def test_wrong_input_is_refused() -> None:
    skeleton = arm()
    with pytest.raises(UnknownName, match="nearest"):
        chain_between(skeleton, "j0", "j9")
    with pytest.raises(ShapeError, match="does not hang below"):
        chain_between(skeleton, "j3", "j1")
    for number in (-1, 99):
        with pytest.raises(ShapeError, match=f"joint: expected 0 to 4, got {number}"):
            chain_between(skeleton, 0, number)
        with pytest.raises(ShapeError, match=f"joint: expected 0 to 4, got {number}"):
            solve_fabrik(skeleton, skeleton.rest, (0, number), [0.0, 0.0, 0.0])
    with pytest.raises(ShapeError, match="damping_rad: expected positive numbers, got 8 and nan"):
        solve_ccd(skeleton, skeleton.rest, (0, 1), [0.0, 0.0, 0.0], iterations=8, damping_rad=np.nan)
    with pytest.raises(ShapeError, match="no child"):
        solve_ccd(skeleton, skeleton.rest, (0, 2), [0.0, 0.0, 0.0])
    with pytest.raises(ShapeError, match="at least 2"):
        solve_fabrik(skeleton, skeleton.rest, (0,), [0.0, 0.0, 0.0])
    with pytest.raises(ShapeError, match="target"):
        solve_fabrik(skeleton, skeleton.rest, (0, 1), [0.0, np.nan, 0.0])
    with pytest.raises(UnknownName):
        solve_ccd(skeleton, skeleton.rest, (0, 1), [0.0, 0.0, 0.0], limits={"x": LIMITS["hinge"]})
    with pytest.raises(UnknownName, match="Euler order"):
        EulerRange("XYQ", (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
