"""The full-body solver: reach, limits, settling, roots, batches, precision; both paths; beside SciPy's least squares."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from keypose import evaluate, io, samples
from keypose.analysis import find_roles, human_limits
from keypose.errors import ShapeError, UnknownName
from keypose.ik import (
    Cone,
    ContactTask,
    EulerRange,
    Hinge,
    IkResult,
    JointLimit,
    LookAtTask,
    OrientationTask,
    PosePrior,
    PositionTask,
    RelativeTask,
    RootMotion,
    Smoothness,
    SolveOptions,
    Task,
    clamp_pose,
    limit_violation,
    prepare_solver,
    solve_pose,
)
from keypose.math import quat
from keypose.model import Pose, Skeleton
from tests.synthetic import random_pose, random_rotations, random_skeleton

ENDS = ("head", "left_hand", "right_hand", "left_foot", "right_foot")
FINE = ("Thumb", "Index", "Middle", "Ring", "Pinky", "Eye", "Jaw")


@pytest.fixture(scope="module")
def body() -> Skeleton:
    return samples.load("human").character.skeleton


@pytest.fixture(scope="module")
def roles(body: Skeleton) -> dict[str, int]:
    return dict(find_roles(body).roles)


@pytest.fixture(scope="module")
def limits(body: Skeleton, roles: dict[str, int]) -> dict[str, JointLimit]:
    found = human_limits(body, roles)
    return {name: limit for name, limit in found.items() if not any(part in name for part in FINE)}


@pytest.fixture
def compiled() -> Any:
    """The compiled path: it is taken once its kernels are loaded."""
    import keypose.kernels.fullbody as kernels

    return kernels


def posed_inside(body: Skeleton, limits: dict[str, JointLimit], count: int, seed: int, spread: float = 1.0) -> Pose:
    """Random poses that keep their limits, anywhere."""
    rng = np.random.default_rng(seed)
    turns = quat.from_rotation_vector(rng.normal(size=(count, body.joint_count, 3)) * spread)
    rest = Pose(*(np.asarray(a, np.float64) for a in (body.rest.translations, body.rest.rotations, body.rest.scales)))
    inside = clamp_pose(Pose(rest.translations, quat.multiply(rest.rotations, turns), rest.scales), body, limits)
    places = np.broadcast_to(np.asarray(rest.translations), (count, body.joint_count, 3)).copy()
    places[:, 0] += rng.normal(size=(count, 3)) * 0.3
    return Pose(places, inside.rotations, inside.scales)


def world_of(skeleton: Skeleton, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    turned, places = evaluate.world_rotations_positions(skeleton, pose)
    return np.asarray(turned), np.asarray(places)


def rest_of(skeleton: Skeleton) -> Pose:
    return Pose(
        *(
            np.asarray(a, np.float64)
            for a in (skeleton.rest.translations, skeleton.rest.rotations, skeleton.rest.scales)
        )
    )


def worst_violation(skeleton: Skeleton, limits: dict[str, JointLimit], pose: Pose) -> float:
    rest = np.asarray(skeleton.rest.rotations)
    joints = {name: skeleton.index(name) for name in limits}
    return max(
        float(np.max(limit_violation(limits[n], np.asarray(pose.rotations)[..., j, :], rest[j])))
        for n, j in joints.items()
    )


def left_of(found: IkResult) -> np.ndarray:
    return np.stack([r.distance_m for r in found.residuals if r.distance_m is not None], axis=-1)


def reach(places: np.ndarray, roles: dict[str, int], names: tuple[str, ...] = ENDS, **more: Any) -> list[Task]:
    return [PositionTask(roles[name], places[..., roles[name], :], **more) for name in names]


def test_ten_thousand_random_reachable_targets_are_all_reached(
    body: Skeleton, roles: dict[str, int], limits: dict[str, JointLimit], compiled: Any
) -> None:
    places = world_of(body, posed_inside(body, limits, 10_000, 7))[1]
    found = solve_pose(
        body, rest_of(body), reach(places, roles), limits=limits, options=SolveOptions(restarts=40, iterations=100)
    )
    assert found.reached.all(), (~found.reached).sum()
    left = world_of(body, found.pose)[1] - places
    assert max(np.linalg.norm(left[:, roles[e]], axis=1).max() for e in ENDS) < 1e-4
    assert worst_violation(body, limits, found.pose) < 1e-6


def test_ten_thousand_unreachable_ones_settle_without_jitter(
    body: Skeleton, roles: dict[str, int], limits: dict[str, JointLimit], compiled: Any
) -> None:
    count = 10_000
    away = np.random.default_rng(8).normal(size=(count, body.joint_count, 3))
    places = away / np.linalg.norm(away, axis=-1, keepdims=True) * 3.0  # all ends in all directions
    found = solve_pose(body, rest_of(body), reach(places, roles), limits=limits, options=SolveOptions(iterations=1000))
    assert not found.reached.any()
    assert found.converged.all(), (~found.converged).sum()
    assert (np.quantile(found.iterations, [0.5, 0.95, 0.99, 0.999]) < (40, 100, 200, 500)).all()
    assert worst_violation(body, limits, found.pose) < 1e-6
    # In a hundred steps more, no task of a settled pose comes closer, or goes further, by what anyone could see.
    again = solve_pose(
        body, found.pose, reach(places, roles), limits=limits,
        options=SolveOptions(settled_rad=1e-15, still_m=1e-15),
    )  # fmt: skip
    assert (again.cost <= found.cost * (1.0 + 1e-12)).all()
    moved = np.abs(left_of(again) - left_of(found)).max(axis=1)
    assert (np.quantile(moved, [0.95, 0.99, 1.0]) < (1e-7, 1e-6, 1e-5)).all()


def test_the_cost_falls_with_every_step(
    body: Skeleton, roles: dict[str, int], limits: dict[str, JointLimit], compiled: Any
) -> None:
    places = 2.0 * world_of(body, posed_inside(body, limits, 200, 9))[1]
    before = np.full(200, np.inf)
    for steps in range(25):
        found = solve_pose(
            body, rest_of(body), reach(places, roles), limits=limits, options=SolveOptions(iterations=steps)
        )
        assert (found.cost <= before).all(), steps
        before = found.cost


def test_a_prepared_solver_solves_the_same(
    body: Skeleton, roles: dict[str, int], limits: dict[str, JointLimit], compiled: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Targets one by one, all at once, by task, from poses: all as NumPy solves the tasks with these targets."""
    rng = np.random.default_rng(10)
    places = world_of(body, posed_inside(body, limits, 6, 10))[1]
    turns = random_rotations(rng, 6)
    hand, foot = roles["left_hand"], roles["right_foot"]

    def tasks(n: Any) -> list[Task]:
        return [
            PositionTask(hand, places[n, hand], np.array([1.0, 2.0, 0.5, 1.0, 1.0, 3.0])[n], (0.0, 0.05, 0.0)),
            OrientationTask(foot, 1.5 * turns[n], 0.3),
            LookAtTask("Head", places[n, foot], weight=0.2),
            ContactTask("RightToeBase", places[n, foot], (0.0, 2.0, 0.5), on=True),
            PosePrior(weight=0.05, root_weight=0.1),
        ]

    options = SolveOptions(iterations=6)
    every = slice(None)
    others = {name: limit for name, limit in limits.items() if name != "LeftHand"}
    arguments: dict[str, Any] = {"limits": others, "locked": {"LeftHand": "y"}, "options": options}
    start = posed_inside(body, {}, 6, 11, 0.3)
    prepared = prepare_solver(body, tasks(every), **arguments)
    for pose in (None, start):
        begun = rest_of(body) if pose is None else pose
        with monkeypatch.context() as patch:
            patch.setattr("keypose.ik.fullbody.kernels_for", lambda *_: None)
            patch.setattr("keypose.ik.fullbody_run.kernels_for", lambda *_: None)
            plain = solve_pose(body, begun, tasks(every), **arguments)
        for found in (
            prepared.solve(pose),
            prepare_solver(body, tasks(every), **arguments).solve(
                pose, [places[:, hand], turns, places[:, foot], places[:, foot], None]
            ),
        ):
            np.testing.assert_allclose(found.cost, plain.cost, rtol=1e-6)
            np.testing.assert_array_equal(found.iterations, plain.iterations)
            np.testing.assert_allclose(found.pose.translations, plain.pose.translations, atol=1e-5)
            apart = quat.angle_between(np.asarray(found.pose.rotations), np.asarray(plain.pose.rotations))
            assert float(np.max(apart)) < 1e-5
            for ours, theirs in zip(found.residuals, plain.residuals, strict=True):
                for a, b in ((ours.distance_m, theirs.distance_m), (ours.angle_rad, theirs.angle_rad)):
                    assert (a is None) == (b is None)
                    if a is not None and b is not None:
                        np.testing.assert_allclose(a, b, atol=1e-5)
    one = [replace(task, weight=1.0) if isinstance(task, PositionTask) else task for task in tasks(0)]
    alone = prepare_solver(body, one, **arguments)
    for n in range(6):
        now = [replace(task, weight=1.0) if isinstance(task, PositionTask) else task for task in tasks(n)]
        wanted = solve_pose(body, start[n], now, **arguments)
        found = alone.solve(
            start[n], {one[0]: places[n, hand], one[1]: turns[n], one[2]: places[n, foot], one[3]: places[n, foot]}
        )
        assert found.pose.batch_shape == () and found.cost.shape == ()
        np.testing.assert_allclose(found.pose.rotations, wanted.pose.rotations, atol=1e-9)
        np.testing.assert_allclose(left_of(found), left_of(wanted), atol=1e-9)


def test_a_prepared_solver_names_wrong_targets(body: Skeleton) -> None:
    task, prior = PositionTask("LeftHand", (0.0, 0.0, 0.0)), PosePrior()
    solver = prepare_solver(body, [task, prior])
    with pytest.raises(ShapeError, match="one for each of 2 tasks"):
        solver.solve(targets=[np.zeros(3)])
    with pytest.raises(ShapeError, match="another PositionTask"):
        solver.solve(targets={PositionTask("LeftHand", (0.0, 0.0, 0.0)): np.zeros(3)})
    with pytest.raises(ShapeError, match="PosePrior has no target"):
        solver.solve(targets={prior: np.zeros(3)})
    with pytest.raises(ShapeError, match=r"targets\[0\] of PositionTask"):
        solver.solve(targets={task: np.zeros(4)})
    with pytest.raises(ShapeError, match="finite"):
        solver.solve(targets={task: np.full(3, np.nan)})
    with pytest.raises(ShapeError, match="does not broadcast"):
        solver.solve(rest_of(body)[None][[0, 0]], targets={task: np.zeros((3, 3))})


def test_relative_tasks_are_given_targets_too(body: Skeleton) -> None:
    task = RelativeTask("LeftHand", "Head", (0.3, 0.0, 0.2))
    found = prepare_solver(body, [task]).solve(targets={task: [[0.2, 0.1, 0.3], [0.3, -0.1, 0.2]]})
    assert found.reached.all() and found.pose.batch_shape == (2,)


def test_through_the_boundary_of_reach_nothing_jumps(body: Skeleton, roles: dict[str, int], compiled: Any) -> None:
    """A hand pulled from near to far away: the pose follows smoothly, straight arm and all."""
    rest = rest_of(body)
    hand, shoulder = roles["left_hand"], roles["left_upper_arm"]
    places = world_of(body, rest)[1]
    way = np.array([0.8, 0.1, 0.59])
    distances = np.linspace(0.35, 1.2, 400)
    targets = places[shoulder] + distances[:, None] * way / np.linalg.norm(way)
    tasks = [PositionTask(hand, targets), PosePrior(weight=0.003)]
    found = solve_pose(body, rest, tasks, root="fixed", fixed=["Spine", "Spine1", "Spine2", "LeftShoulder"])
    assert found.converged.all()
    elbows = world_of(body, found.pose)[1][:, roles["left_lower_arm"]]
    speed = np.linalg.norm(np.diff(elbows, axis=0), axis=1) / np.diff(distances)
    assert speed.max() < 12.0  # a locking elbow alone is infinitely fast
    distance = found.residuals[0].distance_m
    assert distance is not None and distance[0] < 0.01 and distance[-1] > 0.3


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_both_paths_take_the_same_steps(seed: int, compiled: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(seed)
    skeleton = random_skeleton(rng, 12)
    count = 23
    start = random_pose(rng, (count,), 12)
    start = replace(start, scales=np.repeat(rng.uniform(0.8, 1.2, (count, 12, 1)), 3, axis=-1))
    tasks: list[Task] = [
        PositionTask(11, rng.normal(size=(count, 3)), rng.uniform(0.5, 2.0, count), (0.1, 0.2, -0.1)),
        PositionTask(9, rng.normal(size=(count, 3))),
        OrientationTask(10, random_rotations(rng, count), 0.3),
        LookAtTask(8, rng.normal(size=(count, 3)) * 3.0, (0.2, 0.1, 1.0), 0.4, (0.0, 0.1, 0.0)),
        ContactTask(7, rng.normal(size=(count, 3)), rng.normal(size=(count, 3)), False, 0.7, (0.1, 0.0, 0.0)),
        ContactTask(6, rng.normal(size=(count, 3)), rng.normal(size=(count, 3)), True, 0.7),
        PosePrior(random_pose(rng, (), 12), rng.uniform(0.0, 0.1, 12), 0.1),
    ]
    limits: dict[str, JointLimit] = {
        "joint1": Cone((0.0, 1.0, 0.2), (0.8, 0.5), -0.4, 0.6, across=(1.0, 0.0, 0.3)),
        "joint2": Hinge((0.3, 0.0, 1.0), -1.0, 0.7),
        "joint3": EulerRange("ZXY", (-0.4, -0.5, -0.2), (0.9, 0.3, 0.6)),
        "joint4": EulerRange("zyx", (-0.4, -0.5, -0.2), (0.9, 0.3, 0.6)),
    }
    roots = ("free", "ground", "translation", "fixed")
    for steps, root in zip((1, 2, 4, 6), roots, strict=True):
        arguments: dict[str, Any] = {
            "limits": limits, "fixed": ["joint5"], "locked": {"joint8": "xz", "joint9": "y"}, "root": root,
            "options": SolveOptions(iterations=steps),
        }  # fmt: skip
        fast = solve_pose(skeleton, start, tasks, **arguments)
        with monkeypatch.context() as patch:
            patch.setattr("keypose.ik.fullbody.kernels_for", lambda *_: None)
            patch.setattr("keypose.ik.fullbody_run.kernels_for", lambda *_: None)
            plain = solve_pose(skeleton, start, tasks, **arguments)
        np.testing.assert_allclose(fast.cost, plain.cost, rtol=1e-6)
        apart = quat.angle_between(np.asarray(fast.pose.rotations), np.asarray(plain.pose.rotations))
        assert float(np.max(apart)) < 1e-5
        np.testing.assert_allclose(fast.pose.translations, plain.pose.translations, atol=2e-5)
        np.testing.assert_array_equal(fast.iterations, plain.iterations)
        np.testing.assert_array_equal(fast.outcome, plain.outcome)


def test_as_good_as_scipy(compiled: Any) -> None:
    """Minima beside those of SciPy's trust region on the same residuals, over rotation vectors of its own making."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(12)
    skeleton = random_skeleton(rng, 8)
    rest = rest_of(skeleton)
    parents, offsets = skeleton.parents, np.array(rest.translations)
    locals_ = Rotation.from_quat(np.asarray(rest.rotations), scalar_first=True)
    ends = [j for j in range(8) if j not in parents]
    better = 0
    for _ in range(4):
        targets = rng.normal(size=(len(ends), 3)) * 0.8

        def residual(x: np.ndarray, targets: np.ndarray = targets) -> np.ndarray:
            own = locals_ * Rotation.from_rotvec(x[3:].reshape(8, 3))
            turned: list[Any] = [None] * 8
            places = np.zeros((8, 3))
            for j in range(8):
                p = parents[j]
                turned[j] = own[j] if p < 0 else turned[p] * own[j]
                places[j] = offsets[j] + x[:3] if p < 0 else places[p] + turned[p].apply(offsets[j])
            return (places[ends] - targets).ravel()

        theirs = least_squares(residual, np.zeros(27), xtol=1e-12, ftol=1e-12, gtol=1e-10)
        tasks = [PositionTask(j, target) for j, target in zip(ends, targets, strict=True)]
        ours = solve_pose(skeleton, rest, tasks, options=SolveOptions(iterations=300, tolerance_m=1e-9))
        assert float(ours.cost) == pytest.approx(
            0.5 * sum(float(np.sum(r.distance_m**2)) for r in ours.residuals if r.distance_m is not None)
        )
        better += float(ours.cost) <= theirs.cost + 1e-9
    assert better >= 3  # both may stop in different valleys


def test_root_policies(body: Skeleton, roles: dict[str, int], compiled: Any) -> None:
    rng = np.random.default_rng(3)
    rest = rest_of(body)
    goal = world_of(body, rest)[1][roles["left_hand"]] + rng.normal(size=(20, 3)) * 0.6
    tasks = [PositionTask(roles["left_hand"], goal)]
    found = {
        policy: solve_pose(body, rest, tasks, root=policy) for policy in ("free", "fixed", "translation", "ground")
    }
    moved = {
        p: np.asarray(f.pose.broadcast().translations)[:, 0] - np.asarray(rest.translations)[0]
        for p, f in found.items()
    }
    turned = {p: np.asarray(f.pose.rotations)[:, 0] for p, f in found.items()}
    assert np.abs(moved["free"]).min(axis=0).max() > 0 and found["free"].reached.all()
    assert np.abs(moved["fixed"]).max() == 0 and np.abs(turned["fixed"] - [1, 0, 0, 0]).max() == 0
    assert np.abs(moved["translation"]).max() > 0.01 and np.abs(turned["translation"] - [1, 0, 0, 0]).max() == 0
    assert np.abs(moved["ground"][:, 1]).max() < 1e-12 and np.abs(moved["ground"]).max() > 0.01
    assert np.abs(turned["ground"][:, [1, 3]]).max() < 1e-9 and np.abs(turned["ground"][:, 2]).max() > 0.01
    other = solve_pose(body, rest, tasks, root=RootMotion("free", "Spine1"))
    still = np.asarray(other.pose.rotations)
    np.testing.assert_array_equal(still[:, :2], np.broadcast_to(rest.rotations[:2], still[:, :2].shape))
    assert np.abs(np.asarray(other.pose.translations)[:, 2] - rest.translations[2]).max() > 0.01


def test_fixed_and_locked_joints_stay(body: Skeleton, roles: dict[str, int], compiled: Any) -> None:
    goal = world_of(body, rest_of(body))[1][roles["left_hand"]] + np.random.default_rng(4).normal(size=(50, 3)) * 0.5
    names = {"LeftForeArm": "xz", "LeftArm": "y"}
    found = solve_pose(
        body, rest_of(body), [PositionTask("LeftHand", goal)], fixed=["Spine", 0], locked=names, root="fixed"
    )
    turns = np.asarray(found.pose.rotations)
    assert np.abs(turns[:, [0, 1]] - [1, 0, 0, 0]).max() == 0
    assert np.abs(turns[:, body.index("LeftForeArm")][:, [1, 3]]).max() < 1e-9
    from keypose.math import euler

    assert np.abs(euler.from_quat(turns[:, body.index("LeftArm")], "XZY")[:, 2]).max() < 1e-8


def test_every_kind_of_task_is_met(body: Skeleton, roles: dict[str, int], compiled: Any) -> None:
    rest = rest_of(body)
    turn = quat.from_rotation_vector([0.2, 0.9, 0.1])
    eye = np.array([1.0, 1.9, 2.0])
    tasks: list[Task] = [
        PositionTask("LeftHand", (0.5, 1.2, 0.3)),
        OrientationTask("RightHand", turn),
        LookAtTask("Head", eye, (0.0, 0.0, 1.0), offset=(0.0, 0.08, 0.07)),
        ContactTask("LeftToeBase", (0.0, 0.1, 0.0), (0.0, 1.0, 0.0)),
        ContactTask("RightToeBase", (0.0, 0.0, 0.2), (0.0, 0.0, 1.0), on=True),
    ]
    found = solve_pose(body, rest, tasks)
    assert found.reached and found.reasons == "reached"
    turned, places = world_of(body, found.pose)
    np.testing.assert_allclose(places[body.index("LeftHand")], (0.5, 1.2, 0.3), atol=1e-4)
    assert quat.angle_between(turned[body.index("RightHand")], turn) < 1e-4
    head = body.index("Head")
    way = eye - (places[head] + quat.rotate(turned[head], np.array([0.0, 0.08, 0.07])))
    assert np.linalg.norm(quat.rotate(turned[head], np.array([0.0, 0.0, 1.0])) - way / np.linalg.norm(way)) < 1e-4
    assert places[body.index("LeftToeBase"), 1] > 0.1 - 1e-4
    assert abs(places[body.index("RightToeBase"), 2] - 0.2) < 1e-4


def test_a_contact_above_the_plane_does_nothing(body: Skeleton) -> None:
    found = solve_pose(body, rest_of(body), [ContactTask("Head", (0.0, 0.0, 0.0))])
    assert found.reached and found.iterations == 0
    np.testing.assert_array_equal(found.pose.rotations, rest_of(body).rotations)


def test_shapes_precision_and_nothing_to_do(body: Skeleton, compiled: Any) -> None:
    rest = rest_of(body)
    targets = np.random.default_rng(5).normal(size=(3, 1, 3)) * 0.2 + [0.4, 1.2, 0.3]
    weights = np.array([1.0, 0.5, 2.0, 1.5])
    found = solve_pose(body, rest, [PositionTask("LeftHand", targets, weights)])
    assert found.pose.batch_shape == (3, 4) and found.cost.shape == (3, 4) and found.reached.all()
    narrow = Pose(*(np.asarray(a, np.float32) for a in (rest.translations, rest.rotations, rest.scales)))
    small = solve_pose(body, narrow, [PositionTask("LeftHand", targets, weights)])
    assert small.pose.rotations.dtype == np.float32 and found.pose.rotations.dtype == np.float64
    np.testing.assert_allclose(small.pose.rotations, found.pose.rotations, atol=1e-3)
    single = solve_pose(body, rest, [PositionTask("LeftHand", targets[1, 0])])
    np.testing.assert_allclose(single.pose.rotations, found.pose.rotations[1, 0], atol=1e-5)
    idle = solve_pose(body, rest, [])
    np.testing.assert_array_equal(idle.pose.rotations, rest.rotations)
    assert idle.reached and idle.residuals == ()
    none = solve_pose(body, rest, [PositionTask("LeftHand", np.zeros((0, 3)))])
    assert none.pose.batch_shape == (0,)


def test_straight_limbs_bend(body: Skeleton, compiled: Any) -> None:
    """Targets along a limb that is exactly straight: the Jacobian is singular, and the root may not help."""
    skeleton = Skeleton(
        ("a", "b", "c"),
        np.array([-1, 0, 1]),
        Pose(np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0]]), np.tile([1.0, 0, 0, 0], (3, 1)), np.ones((3, 3))),
    )
    target = np.array([[1.0, 0.2, 0.0], [1.999999, 0.001, 0.0], [2.5, 0.0, 0.0], [0.3, 0.3, 0.0]])
    found = solve_pose(
        skeleton, rest_of(skeleton), [PositionTask("c", target)], root=RootMotion("translation"), fixed=[]
    )
    assert np.isfinite(np.asarray(found.pose.rotations)).all()
    held = solve_pose(skeleton, rest_of(skeleton), [PositionTask("c", target)], fixed=[], root=RootMotion("free", "a"))
    assert held.reached.all()


def test_smoothness_follows_the_frame_before(body: Skeleton, compiled: Any) -> None:
    rng = np.random.default_rng(6)
    rest = rest_of(body)
    targets = np.array([0.5, 1.2, 0.3]) + np.cumsum(rng.normal(size=(40, 2, 3)) * 0.03, axis=0)
    tasks: list[Task] = [PositionTask("LeftHand", targets)]
    rough = solve_pose(body, rest, tasks, root="fixed")
    smooth = solve_pose(body, rest, [*tasks, Smoothness(0.3)], root="fixed")

    def speed(found: IkResult) -> float:
        turns = np.asarray(found.pose.rotations)
        return float(np.mean(quat.angle_between(turns[1:], turns[:-1]) ** 2))

    assert smooth.pose.batch_shape == (40, 2)
    assert speed(smooth) < 0.7 * speed(rough)
    distance = smooth.residuals[0].distance_m
    assert distance is not None and distance.mean() < 0.1


@pytest.mark.data
@pytest.mark.parametrize(
    "file", ["bvh/cmu_cgspeed/cmu_12_01_walk.bvh", "makehuman/walk1.bvh", "asf_amc/cmu_02/02_01.amc"]
)
def test_real_skeletons(file: str, data_dir: Path, compiled: Any) -> None:
    """Poses of real motions are found again from the places of hands, feet and head, inside a body's limits."""
    scene = io.load(data_dir / file)
    skeleton, motion = scene.character.skeleton, scene.animations[0]
    assert hasattr(motion, "pose")
    roles = dict(find_roles(skeleton).roles)
    places = world_of(skeleton, motion.pose)[1][::7]
    limits = human_limits(skeleton, roles)
    found = solve_pose(
        skeleton, rest_of(skeleton), reach(places, roles), limits=limits,
        root=RootMotion("free", skeleton.names[roles["hips"]]), options=SolveOptions(restarts=8),
    )  # fmt: skip
    assert found.reached.mean() > 0.97
    assert worst_violation(skeleton, limits, found.pose) < 1e-6


def test_wrong_input_is_named(body: Skeleton) -> None:
    rest = rest_of(body)
    hand = [PositionTask("LeftHand", (0.0, 0.0, 0.0))]
    with pytest.raises(UnknownName, match="LeftHant"):
        solve_pose(body, rest, [PositionTask("LeftHant", (0.0, 0.0, 0.0))])
    with pytest.raises(UnknownName, match="LeftFoots"):
        solve_pose(body, rest, hand, limits={"LeftFoots": Hinge((1, 0, 0), 0, 1)})
    with pytest.raises(UnknownName, match="root policy"):
        solve_pose(body, rest, hand, root="flying")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ShapeError, match=r"PositionTask\.target"):
        PositionTask("LeftHand", (0.0, 0.0))
    with pytest.raises(ShapeError, match="finite"):
        PositionTask("LeftHand", (0.0, np.nan, 0.0))
    with pytest.raises(ShapeError, match="does not broadcast"):
        solve_pose(body, rest, [PositionTask(3, np.zeros((4, 3))), PositionTask(5, np.zeros((3, 3)))])
    with pytest.raises(ShapeError, match="locked axes"):
        solve_pose(body, rest, hand, locked={"LeftArm": "u"})
    with pytest.raises(ShapeError, match="got both"):
        solve_pose(body, rest, hand, locked={"LeftArm": "x"}, limits={"LeftArm": Hinge((1, 0, 0), 0, 1)})
    with pytest.raises(ShapeError, match="one scale for all three axes"):
        solve_pose(body, replace(rest, scales=np.broadcast_to([1.0, 2.0, 1.0], (61, 3))), hand)
    with pytest.raises(ShapeError, match="first axis of the batch"):
        solve_pose(body, rest, [*hand, Smoothness()])
    with pytest.raises(ShapeError, match="tolerance_m"):
        SolveOptions(tolerance_m=0.0)
