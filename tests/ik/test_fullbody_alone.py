"""One pose through a prepared solver: as `solve_pose` solves it, however targets are given, from many threads."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from keypose import evaluate
from keypose.errors import ShapeError
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
    RootMotion,
    SolveOptions,
    Task,
    prepare_solver,
    solve_pose,
)
from keypose.math import quat
from keypose.model import Pose, Skeleton
from tests.synthetic import random_pose, random_rotations, random_skeleton

JOINTS = 12
LIMITS: dict[str, JointLimit] = {
    "joint1": Cone((0.0, 1.0, 0.2), (0.8, 0.5), -0.4, 0.6, across=(1.0, 0.0, 0.3)),
    "joint2": Hinge((0.3, 0.0, 1.0), -1.0, 0.7),
    "joint3": EulerRange("ZXY", (-0.4, -0.5, -0.2), (0.9, 0.3, 0.6)),
}


@pytest.fixture(autouse=True)
def compiled() -> Any:
    """The compiled path, for `solve_pose` too: it is taken once its kernels are loaded."""
    import keypose.kernels.fullbody as kernels

    return kernels


def as_double(pose: Pose) -> Pose:
    return Pose(*(np.asarray(a, np.float64) for a in (pose.translations, pose.rotations, pose.scales)))


def unscaled(rng: np.random.Generator) -> Pose:
    return replace(as_double(random_pose(rng, (), JOINTS)), scales=np.ones((JOINTS, 3)))


def plain_skeleton(rng: np.random.Generator) -> Skeleton:
    skeleton = random_skeleton(rng, JOINTS)
    return replace(skeleton, rest=replace(as_double(skeleton.rest), scales=np.ones((JOINTS, 3))))


def tasks_of(rng: np.random.Generator) -> list[Task]:
    """One of every kind; from the same numbers at first, then with other targets."""
    return [
        PositionTask(11, rng.normal(size=3), 0.7, (0.1, 0.2, -0.1)),
        PositionTask(9, rng.normal(size=3)),
        PosePrior(weight=np.linspace(0.0, 0.1, JOINTS), root_weight=0.1),
        OrientationTask(10, 3.0 * random_rotations(rng, 1)[0], 0.3),
        LookAtTask(8, 3.0 * rng.normal(size=3), (0.2, 0.1, 1.0), 0.4, (0.0, 0.1, 0.0)),
        ContactTask(7, rng.normal(size=3), rng.normal(size=3), False, 0.7, (0.1, 0.0, 0.0)),
    ]


def targets_of(tasks: list[Task]) -> list[Any]:
    return [
        None if isinstance(t, PosePrior) else getattr(t, "point" if isinstance(t, ContactTask) else "target")
        for t in tasks
    ]


def assert_same(found: IkResult, wanted: IkResult, atol: float = 1e-9) -> None:
    apart = quat.shortest(quat.multiply(found.pose.rotations, quat.conjugate(wanted.pose.rotations)))[:, 1:]
    np.testing.assert_allclose(apart, 0.0, atol=atol)
    np.testing.assert_allclose(found.pose.translations, wanted.pose.translations, atol=atol)
    np.testing.assert_array_equal(found.pose.scales, wanted.pose.scales)
    assert np.asarray(found.pose.rotations).dtype == np.asarray(wanted.pose.rotations).dtype
    assert found.pose.batch_shape == found.cost.shape == found.outcome.shape == ()
    np.testing.assert_allclose(found.cost, wanted.cost, rtol=1e-6, atol=1e-12)
    np.testing.assert_array_equal(found.iterations, wanted.iterations)
    np.testing.assert_array_equal(found.outcome, wanted.outcome)
    assert str(found.reasons) == str(wanted.reasons) and bool(found.reached) == bool(wanted.reached)
    for ours, theirs in zip(found.residuals, wanted.residuals, strict=True):
        for a, b in ((ours.distance_m, theirs.distance_m), (ours.angle_rad, theirs.angle_rad)):
            assert (a is None) == (b is None)
            if a is not None and b is not None:
                assert a.shape == ()
                np.testing.assert_allclose(a, b, atol=max(atol, 1e-8))


ROOTS: dict[str, Any] = {
    "free": "free", "ground": "ground", "fixed": "fixed", "below the root": RootMotion("free", "joint1"),
}  # fmt: skip


@pytest.mark.parametrize("root", ROOTS)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_the_same_as_when_nothing_is_prepared(root: str, dtype: Any) -> None:
    rng = np.random.default_rng(3)
    skeleton, tasks = plain_skeleton(rng), tasks_of(rng)
    limits = {name: limit for name, limit in LIMITS.items() if name != "joint1" or root != "below the root"}
    arguments: dict[str, Any] = {
        "limits": limits, "fixed": ["joint5"], "locked": {"joint8": "xz", "joint6": "y"}, "root": ROOTS[root],
        "options": SolveOptions(iterations=7),
    }  # fmt: skip
    solver = prepare_solver(skeleton, tasks, **arguments)
    assert solver.alone is not None
    for n in range(8):
        pose = None if n == 0 else Pose(*(np.asarray(a, dtype) for a in vars_of(unscaled(rng))))
        begun = skeleton.rest if pose is None else pose
        now = tasks if n == 1 else with_targets_of(tasks_of(rng), tasks)
        wanted = solve_pose(skeleton, begun, now, **arguments)
        found = solver.solve(pose, targets_of(now))
        assert_same(found, wanted, 1e-9 if pose is None or dtype is np.float64 else 2e-6)
        if n == 1:
            assert_same(solver.solve(pose), wanted, 1e-9 if dtype is np.float64 else 2e-6)


def vars_of(pose: Pose) -> tuple[Any, Any, Any]:
    return pose.translations, pose.rotations, pose.scales


def with_targets_of(others: list[Task], tasks: list[Task]) -> list[Task]:
    """Tasks with the targets of others, whose planes are their own."""
    return [
        replace(task, point=other.point) if isinstance(task, ContactTask) and isinstance(other, ContactTask) else other
        for task, other in zip(tasks, others, strict=True)
    ]


def places_of(skeleton: Skeleton, pose: Pose) -> np.ndarray:
    """Where the ends of a pose are."""
    ends = [j for j in range(skeleton.joint_count) if j not in skeleton.parents]
    return np.asarray(evaluate.world_rotations_positions(skeleton, pose)[1])[..., ends, :]


def reaching(rng: np.random.Generator) -> tuple[Skeleton, list[PositionTask], np.ndarray]:
    """A skeleton, tasks for its ends, and places that they can be at all together."""
    skeleton = plain_skeleton(rng)
    tasks = [PositionTask(j, np.zeros(3)) for j in range(JOINTS) if j not in skeleton.parents]
    return skeleton, tasks, places_of(skeleton, replace(unscaled(rng), translations=skeleton.rest.translations))


# Steps of a solve under way: at its end, where nothing but rounding is left, that is what poses differ by.
FEW = SolveOptions(iterations=7)


GIVEN: dict[str, Callable[[list[PositionTask], np.ndarray], Any]] = {
    "one array": lambda tasks, places: places,
    "an array that is no row": lambda tasks, places: np.asfortranarray(places),
    "arrays": lambda tasks, places: list(places),
    "a tuple": lambda tasks, places: tuple(places),
    "numbers": lambda tasks, places: places.tolist(),
    "by task": lambda tasks, places: dict(zip(tasks, places, strict=True)),
    "by task, numbers": lambda tasks, places: dict(zip(tasks[::-1], places[::-1].tolist(), strict=True)),
}


@pytest.mark.parametrize("way", GIVEN)
def test_targets_are_given_in_many_ways(way: str) -> None:
    skeleton, tasks, places = reaching(np.random.default_rng(4))
    now = [replace(t, target=p) for t, p in zip(tasks, places, strict=True)]
    wanted = solve_pose(skeleton, skeleton.rest, now, options=FEW)
    solver = prepare_solver(skeleton, tasks, options=FEW)
    assert_same(solver.solve(targets=GIVEN[way](tasks, places)), wanted)
    assert_same(solver.solve(targets=[p.astype(np.float32) for p in places]), wanted, 1e-4)


def test_what_is_not_given_stays() -> None:
    skeleton, tasks, places = reaching(np.random.default_rng(5))
    tasks = [replace(t, target=p) for t, p in zip(tasks, places, strict=True)]
    solver, other = prepare_solver(skeleton, tasks, options=FEW), places[0] + 0.1
    wanted = solve_pose(skeleton, skeleton.rest, [replace(tasks[0], target=other), *tasks[1:]], options=FEW)
    assert_same(solver.solve(targets={tasks[0]: other}), wanted)
    assert_same(solver.solve(targets=[other, *[None] * (len(tasks) - 1)]), wanted)
    again = solve_pose(skeleton, skeleton.rest, tasks, options=FEW)
    assert_same(solver.solve(), again)  # and nothing of what was given before
    assert_same(solver.solve(targets={}), again)


def test_a_solve_goes_on_from_the_one_before() -> None:
    rng = np.random.default_rng(6)
    skeleton, tasks, _ = reaching(rng)
    solver, pose = prepare_solver(skeleton, tasks), skeleton.rest
    found = solver.solve(targets=places_of(skeleton, pose))
    for _ in range(5):
        turns = quat.from_rotation_vector(0.05 * rng.normal(size=(JOINTS, 3)))
        pose = replace(pose, rotations=quat.multiply(pose.rotations, turns))
        before, found = found, solver.solve(found.pose, places_of(skeleton, pose))
        assert found.reached and found.iterations < 10
        assert np.linalg.norm(places_of(skeleton, found.pose) - places_of(skeleton, pose), axis=1).max() < 1e-5
        assert not np.asarray(found.pose.rotations).flags.writeable
        assert found.pose.rotations is not before.pose.rotations


def test_scales_and_batches_go_the_other_way() -> None:
    rng = np.random.default_rng(7)
    skeleton, tasks, places = reaching(rng)
    solver = prepare_solver(skeleton, tasks, options=FEW)
    scaled = replace(unscaled(rng), scales=np.full((JOINTS, 3), 1.3))
    now = [replace(t, target=p) for t, p in zip(tasks, places, strict=True)]
    assert_same(solver.solve(scaled, places), solve_pose(skeleton, scaled, now, options=FEW), 1e-7)
    many = solver.solve(targets=[np.stack([p, p + 0.05]) for p in places])
    assert many.pose.batch_shape == many.cost.shape == (2,)
    assert_same(solver.solve(targets=places), solve_pose(skeleton, skeleton.rest, now, options=FEW))


def test_threads_share_a_solver() -> None:
    """All at once, each its own target, with the very numbers that they have one after another."""
    rng = np.random.default_rng(8)
    skeleton, tasks, places = reaching(rng)
    solver = prepare_solver(skeleton, tasks, options=SolveOptions(iterations=30))
    goals = places + 0.3 * rng.normal(size=(400, *places.shape))
    poses = [unscaled(rng) for _ in range(len(goals))]
    alone = [solver.solve(pose, goal) for pose, goal in zip(poses, goals, strict=True)]
    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(solver.solve, poses, goals))
    for a, b in zip(alone, together, strict=True):
        np.testing.assert_array_equal(a.pose.rotations, b.pose.rotations)
        np.testing.assert_array_equal(a.cost, b.cost)


def test_results_are_values() -> None:
    skeleton, tasks, places = reaching(np.random.default_rng(9))
    now = [replace(t, target=p) for t, p in zip(tasks, places, strict=True)]
    wanted = solve_pose(skeleton, skeleton.rest, now, options=FEW)
    solver = prepare_solver(skeleton, tasks, options=FEW)
    for other in (copy.copy, copy.deepcopy, lambda found: pickle.loads(pickle.dumps(found))):
        assert_same(other(solver.solve(targets=places)), wanted)
    found = solver.solve(targets=places)
    assert found.residuals is found.residuals and found.cost is found.cost
    assert replace(found, cost=np.array(3.0)).cost == 3.0 and repr(found).startswith("IkResult(pose=")
    with pytest.raises(AttributeError, match="costs"):
        _ = found.costs  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(AttributeError):
        found.cost = 0.0  # pyright: ignore[reportAttributeAccessIssue]


def test_what_makes_no_sense_is_named() -> None:
    rng = np.random.default_rng(10)
    skeleton, tasks = plain_skeleton(rng), tasks_of(rng)
    solver, good = prepare_solver(skeleton, tasks), targets_of(tasks)
    for n, value, words in (
        (0, np.array([0.0, np.inf, 0.0]), r"targets\[0\] of PositionTask: expected finite"),
        (1, np.zeros(2), r"targets\[1\] of PositionTask"),
        (2, np.zeros(3), "a PosePrior has no target"),
        (3, np.zeros(4), r"targets\[3\] of OrientationTask: expected quaternions without length 0"),
        (3, np.array([np.nan, 0.0, 0.0, 1.0]), r"targets\[3\] of OrientationTask: expected finite"),
    ):
        with pytest.raises(ShapeError, match=words):
            solver.solve(targets=[value if m == n else target for m, target in enumerate(good)])
    with pytest.raises(ShapeError, match="one for each of 6 tasks, got 5"):
        solver.solve(targets=good[:5])
    pose = unscaled(rng)
    broken = np.array(pose.translations)
    broken[3, 1] = np.nan
    with pytest.raises(ShapeError, match="finite numbers"):
        solver.solve(replace(pose, translations=broken))
    turns = np.array(pose.rotations)
    turns[4] = np.inf
    with pytest.raises(ShapeError, match="finite numbers"):
        solver.solve(replace(pose, rotations=turns))
    with pytest.raises(ShapeError, match="12 joints"):
        solver.solve(Pose(*(np.asarray(a)[:5] for a in vars_of(pose))))
