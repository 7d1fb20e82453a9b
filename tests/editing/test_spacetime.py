"""Space-time constraints: derivatives by finite differences, the same optimum as SciPy's, hard constraints met, steps that only go down."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from keypose import samples
from keypose.editing.constraints import Hold, Place, Turn, kept_in_place
from keypose.editing.reach import changed_frames, found_roles
from keypose.editing.spacetime import SpacetimeOptions, SpacetimeProblem, solve_spacetime
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import world
from keypose.ik import EulerRange, Hinge, find_limit_breaks
from keypose.math import euler, quat
from keypose.model import Motion, Pose, Skeleton


def arm(joints=4, frames=31, bend=0.3):
    """A chain whose every joint turns a little, moving slowly."""
    offsets = np.zeros((joints, 3))
    offsets[1:] = (0.05, 0.25, 0.0)
    rest = Pose(offsets, np.tile([1.0, 0, 0, 0], (joints, 1)), np.ones((joints, 3)))
    skeleton = Skeleton(tuple(f"a{n}" for n in range(joints)), np.arange(joints) - 1, rest)
    t = np.linspace(0, 1, frames)[:, None]
    vectors = bend * np.stack(
        [np.sin(t + np.arange(joints)), np.cos(2 * t) + 0 * np.arange(joints), t * np.arange(joints)], -1
    )
    return Motion(skeleton.names, Pose(offsets, quat.from_rotation_vector(vectors), rest.scales), 30.0), skeleton


def places(skeleton, motion):
    return np.asarray(world(skeleton, motion.pose.broadcast()), np.float64)


@pytest.fixture(scope="module")
def cast():
    scene = samples.load("human")
    skeleton = scene.character.skeleton
    return {a.name: a for a in scene.animations}, skeleton, found_roles(skeleton)


EVERYTHING = [
    Place("a3", np.array([10, 11, 20]), (0.3, 0.5, 0.2)),
    Turn("a2", np.array([5, 20]), Rotation.random(2, rng=3).as_quat(scalar_first=True), weight=3.0),
    Hold("a3", np.arange(22, 28), weight=10.0),
    Place("a0", np.array([15]), (0.1, 0.0, 0.0)),
]
LIMITS = {"a1": EulerRange("XYZ", (-0.1, -0.1, -0.1), (0.1, 0.1, 0.1)), "a2": Hinge((0, 0, 1), -0.2, 0.2)}


def problem(limits=None, **options):
    motion, skeleton = arm()
    return SpacetimeProblem(motion, skeleton, (2, 29), EVERYTHING, limits or {}, (), {}, SpacetimeOptions(**options))


@pytest.mark.parametrize("size", [0.0, 0.05, 1.0])
def test_jacobian_against_finite_differences(size, rng):
    ours = problem()
    x = size * rng.normal(size=ours.size)
    jacobian = ours.jacobian(x).toarray()
    step = 1e-6
    numeric = np.stack(
        [(ours.residuals(x + step * e) - ours.residuals(x - step * e)) / (2 * step) for e in np.eye(ours.size)], axis=-1
    )
    np.testing.assert_allclose(jacobian, numeric, atol=2e-8 * np.abs(numeric).max())


def test_curvature_against_finite_differences_of_the_slope(rng):
    """At no change yet the second derivative of a place's cost is J'J and the bow of its arcs, to the last digit."""
    motion, skeleton = arm()
    wanted = [Place("a3", np.array([10, 20]), (0.3, 0.5, 0.2)), Hold("a3", np.arange(14, 18))]
    ours = SpacetimeProblem(motion, skeleton, (2, 29), wanted, {}, (), {}, SpacetimeOptions(hard_weight=1.0))
    x = np.zeros(ours.size)
    jacobian = ours.jacobian(x)
    second = (jacobian.T @ jacobian + ours.bow(x)).toarray()

    def slope(at):
        return ours.jacobian(at).T @ ours.residuals(at)

    step = 1e-5
    numeric = np.stack([(slope(step * e) - slope(-step * e)) / (2 * step) for e in np.eye(ours.size)], axis=-1)
    np.testing.assert_allclose(second, numeric, atol=1e-7 * np.abs(numeric).max())


def test_the_same_optimum_as_scipy():
    """A small problem, all soft: SciPy's trust region on the whole stack of residuals finds the same change."""
    motion, skeleton = arm(joints=3, frames=16)
    wanted = [Place("a2", np.array([6]), (0.4, 0.1, 0.1), weight=5.0), Turn("a1", [11], (1, 0, 0, 0), weight=2.0)]
    options = SpacetimeOptions(tolerance=1e-14, knot_frames=4)
    ours = SpacetimeProblem(motion, skeleton, (0, 15), wanted, {}, (), {}, options)
    theirs = least_squares(
        lambda x: np.concatenate([ours.residuals(x), ours.regular @ x]),
        np.zeros(ours.size),
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-12,
    )
    done = ours.solve()
    assert done.converged and done.costs[-1] == pytest.approx(theirs.cost, rel=1e-9)
    np.testing.assert_allclose(done.motion.pose.rotations, ours.displaced(theirs.x).pose.rotations, atol=1e-5)


def test_hard_constraints_hold_and_the_rest_changes_least(cast):
    motions, skeleton, roles = cast
    idle = motions["idle"]
    span = np.arange(20, 101)
    target = (0.35, 0.3, 0.45)
    feet = kept_in_place(idle, skeleton, [skeleton.names[roles[f]] for f in ("left_foot", "right_foot")], span)
    seen = []
    done = solve_spacetime(
        idle,
        skeleton,
        (20, 100),
        [Place("left_hand", np.arange(55, 66), target), *feet],
        roles=roles,
        progress=lambda step, most: seen.append((step, most)),
    )
    assert done.converged and done.reached and len(done.error) == 5
    before, after = places(skeleton, idle), places(skeleton, done.motion)
    assert np.linalg.norm(after[55:66, roles["left_hand"], :3, 3] - target, axis=-1).max() < 1e-4
    for foot in ("left_foot", "right_foot"):
        np.testing.assert_allclose(after[20:101, roles[foot]], before[20:101, roles[foot]], atol=1e-4)
    assert not changed_frames(idle, done.motion)[np.r_[:21, 100 : idle.frame_count]].any()
    assert seen and all(a[0] < b[0] for a, b in itertools.pairwise(seen))
    assert np.all(np.diff(done.costs) <= 0)
    # the whole body helps: it squats
    assert after[60, roles["hips"], 1, 3] < before[60, roles["hips"], 1, 3] - 0.01
    # the other hand has no reason to turn
    hand = roles["right_lower_arm"]
    assert np.array_equal(done.motion.pose.rotations[:, hand], idle.pose.rotations[:, hand])


def test_a_foot_that_is_held_does_not_slide(cast):
    motions, skeleton, roles = cast
    walk = motions["walk"]
    before = places(skeleton, walk)[:, roles["left_foot"], :3, 3]
    swing = np.argmax(np.linalg.norm(np.diff(before, axis=0), axis=-1)[20:-40]) + 20
    held = np.arange(swing, swing + 8)
    assert np.ptp(before[held], axis=0).max() > 0.1  # it flies
    done = solve_spacetime(
        walk,
        skeleton,
        (swing - 20, swing + 28),
        [Hold("left_foot", held)],
        roles=roles,
        options=SpacetimeOptions(knot_frames=1),
    )
    after = places(skeleton, done.motion)[:, roles["left_foot"], :3, 3]
    assert done.reached and np.ptp(after[held], axis=0).max() < 2e-4


def test_what_cannot_be_reached_settles_where_least_is_missed():
    motion, skeleton = arm()
    far = np.array([3.0, 0.5, 0.0])
    done = solve_spacetime(motion, skeleton, (0, 30), [Place("a3", [15], far)], fixed=["a0"], roles={})
    near = solve_spacetime(
        motion, skeleton, (0, 30), [Place("a3", [15], far + np.array([1e-3, 0, 0]))], fixed=["a0"], roles={}
    )
    assert done.converged and not done.reached and np.all(np.diff(done.costs) <= 0)
    end = places(skeleton, done.motion)[15, :, :3, 3]
    # a0 does not turn, so the rest stretches from a1 straight at the target
    length = 2 * np.hypot(0.05, 0.25)
    assert done.error[0][0] == pytest.approx(np.linalg.norm(far - end[1]) - length, abs=1e-3)
    assert np.abs(places(skeleton, near.motion) - places(skeleton, done.motion)).max() < 5e-3


def test_limits_are_kept_softly(cast):
    motions, skeleton, roles = cast
    idle = motions["idle"]
    elbow = skeleton.names[roles["left_lower_arm"]]
    wanted = [Place("left_hand", [60], (0.25, 1.25, 0.25), weight=30.0)]
    # what the elbow does in the motion itself, and a little more
    joint = roles["left_lower_arm"]
    own = quat.multiply(
        quat.conjugate(np.float64(skeleton.rest.rotations[joint])), np.float64(idle.pose.rotations[:, joint])
    )
    angles = euler.from_quat(own, "XYZ")
    limit = {elbow: EulerRange("XYZ", tuple(angles.min(axis=0) - 0.01), tuple(angles.max(axis=0) + 0.01))}
    free = solve_spacetime(idle, skeleton, (20, 100), wanted, roles=roles)
    held = solve_spacetime(idle, skeleton, (20, 100), wanted, limits=limit, roles=roles)
    worst = [
        max((b.worst_rad for b in find_limit_breaks(m.motion, skeleton, limit)), default=0.0) for m in (free, held)
    ]
    assert worst[0] > 0.05 and worst[1] < 0.1 * worst[0]
    assert held.over_limit_rad == pytest.approx(worst[1], abs=1e-3) and free.over_limit_rad == 0.0


def test_limits_have_the_right_slope(rng):
    """The rows of limits pull towards the nearest allowed rotation: their cost falls along minus the slope."""
    ours = problem(LIMITS)
    x = 0.1 * rng.normal(size=ours.size)
    slope = ours.jacobian(x).T @ ours.residuals(x)
    costs = [0.5 * np.sum(ours.residuals(x - s * slope / np.linalg.norm(slope)) ** 2) for s in (0.0, 1e-5)]
    assert costs[1] < costs[0]


def test_already_met_changes_nothing(cast):
    motions, skeleton, roles = cast
    walk = motions["walk"]
    done = solve_spacetime(walk, skeleton, (10, 60), [], roles=roles)
    assert done.motion is walk and done.converged and done.reached
    at = places(skeleton, walk)[30, roles["left_hand"], :3, 3]
    done = solve_spacetime(walk, skeleton, (10, 60), [Place("left_hand", [30], at)], roles=roles)
    assert done.converged and np.abs(places(skeleton, done.motion) - places(skeleton, walk)).max() < 1e-5


def test_the_window_may_be_open_at_the_motions_ends():
    motion, skeleton = arm()
    target = places(skeleton, motion)[0, 3, :3, 3] + [0.1, 0.05, 0.1]
    done = solve_spacetime(motion, skeleton, (0, 20), [Place("a3", [0], target)], roles={})
    assert (
        done.reached and changed_frames(motion, done.motion)[0] and not changed_frames(motion, done.motion)[20:].any()
    )
    closed = solve_spacetime(
        motion, skeleton, (0, 20), [Place("a3", [0], target)], roles={}, options=SpacetimeOptions(open_ends=False)
    )
    assert not closed.reached and closed.motion is motion


def test_wrong_input_is_told():
    motion, skeleton = arm()
    for constraint, says in (
        (Place("a3", [50], (0, 0, 0)), "expected frames from 0 to 30, got 50"),
        (Place("a3", [1.5], (0, 0, 0)), "whole"),
        (Place("a3", [5, 6], np.zeros((3, 3))), r"target \(3,\) or \(2, 3\)"),
        (Turn("a3", [5], (0, 0, 0)), r"target \(4,\)"),
        (Hold("a3", [5, 6], weight=-1.0), "positive weight"),
    ):
        with pytest.raises(ShapeError, match=says):
            solve_spacetime(motion, skeleton, (0, 30), [constraint], roles={})
    with pytest.raises(UnknownName, match="joint or role"):
        solve_spacetime(motion, skeleton, (0, 30), [Hold("b3", [5])], roles={})
    with pytest.raises(ShapeError, match="window"):
        solve_spacetime(motion, skeleton, (5, 31), [], roles={})
    with pytest.raises(ShapeError, match="options"):
        SpacetimeOptions(hard_weight=0)
