"""Relative tasks and centres of mass, which tie bodies together: both paths alike, as good as SciPy, and what they ask for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from keypose import evaluate, samples
from keypose.analysis import find_roles, human_limits, human_masses
from keypose.ik import (
    CenterOfMassTask,
    Cone,
    EulerRange,
    Hinge,
    JointLimit,
    LookAtTask,
    PosePrior,
    PositionTask,
    RelativeTask,
    RootMotion,
    SolveOptions,
    Task,
    prepare_solver,
    solve_pose,
)
from keypose.math import quat
from keypose.model import Pose, Skeleton
from tests.synthetic import random_pose, random_rotations, random_skeleton

JOINTS, COUNT = 12, 23
LIMITS: dict[str, JointLimit] = {
    "joint1": Cone((0.0, 1.0, 0.2), (0.8, 0.5), -0.4, 0.6, across=(1.0, 0.0, 0.3)),
    "joint2": Hinge((0.3, 0.0, 1.0), -1.0, 0.7),
    "joint3": EulerRange("ZXY", (-0.4, -0.5, -0.2), (0.9, 0.3, 0.6)),
}


@pytest.fixture(autouse=True)
def compiled() -> Any:
    """The compiled path: it is taken once its kernels are loaded."""
    import keypose.kernels.fullbody as kernels

    return kernels


def relative(rng: np.random.Generator, *batch: int) -> list[Task]:
    return [RelativeTask(10, 9, rng.normal(size=(*batch, 3)), None, 0.7, offset=(0.1, 0.2, 0.0))]


def turned(rng: np.random.Generator, *batch: int) -> list[Task]:
    return [RelativeTask(8, 7, None, random_rotations(rng, *batch, 1)[..., 0, :], rotation_weight=0.4)]


def heavy(rng: np.random.Generator, *batch: int) -> list[Task]:
    masses, centers = rng.uniform(size=JOINTS), 0.1 * rng.normal(size=(JOINTS, 3))
    return [CenterOfMassTask(rng.normal(size=(*batch, 3)), masses, centers, (1.0, 0.5, 1.0), 0.8)]


def heavy_in_some(rng: np.random.Generator, *batch: int) -> list[Task]:
    return [CenterOfMassTask(rng.normal(size=(*batch, 3)), np.arange(JOINTS) % 3 == 0)]


def each_in_the_other(rng: np.random.Generator, *batch: int) -> list[Task]:
    return [RelativeTask(10, 4, rng.normal(size=(*batch, 3))), RelativeTask(4, 10, rng.normal(size=3))]


def everything(rng: np.random.Generator, *batch: int) -> list[Task]:
    turns = random_rotations(rng, *batch, 1)[..., 0, :]
    return [
        RelativeTask(10, 9, rng.normal(size=(*batch, 3)), turns, rng.uniform(0.5, 1.0, batch), 0.3),
        CenterOfMassTask(rng.normal(size=(*batch, 3)), np.linspace(0.1, 1.0, JOINTS), None, (1.0, 0.0, 1.0)),
        LookAtTask(8, 3.0 * rng.normal(size=(*batch, 3))),
        RelativeTask(11, 3, rng.normal(size=(*batch, 3))),
    ]


TASKS: dict[str, Callable[..., list[Task]]] = {
    made.__name__: made for made in (relative, turned, heavy, heavy_in_some, each_in_the_other, everything)
}


@pytest.mark.parametrize("name", TASKS)
def test_both_paths_take_the_same_steps(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Free and limited, with every root, under curvature too: the tree with a few rows more is the whole system."""
    rng = np.random.default_rng(sum(map(ord, name)))
    skeleton = random_skeleton(rng, JOINTS)
    start = random_pose(rng, (COUNT,), JOINTS)
    start = replace(start, scales=np.repeat(rng.uniform(0.8, 1.2, (COUNT, JOINTS, 1)), 3, axis=-1))
    tasks = [PositionTask(11, rng.normal(size=(COUNT, 3))), *TASKS[name](rng, COUNT), PosePrior(weight=0.05)]
    for steps, root, limits in (
        (1, "free", LIMITS), (3, "ground", {}), (5, "translation", LIMITS), (5, "fixed", LIMITS), (7, "free", {}),
        (4, RootMotion("free", "joint1"), {}),
    ):  # fmt: skip
        arguments: dict[str, Any] = {
            "limits": limits, "fixed": ["joint5"], "root": root, "options": SolveOptions(iterations=steps),
        }  # fmt: skip
        fast = solve_pose(skeleton, start, tasks, **arguments)
        with monkeypatch.context() as patch:
            patch.setattr("keypose.ik.fullbody.kernels_for", lambda *_: None)
            patch.setattr("keypose.ik.fullbody_run.kernels_for", lambda *_: None)
            plain = solve_pose(skeleton, start, tasks, **arguments)
        np.testing.assert_allclose(fast.cost, plain.cost, rtol=1e-6)
        assert float(np.max(quat.angle_between(fast.pose.rotations, plain.pose.rotations))) < 1e-5
        np.testing.assert_allclose(fast.pose.translations, plain.pose.translations, atol=1e-5)
        np.testing.assert_array_equal(fast.iterations, plain.iterations)
        np.testing.assert_array_equal(fast.outcome, plain.outcome)
        for ours, theirs in zip(fast.residuals, plain.residuals, strict=True):
            for a, b in ((ours.distance_m, theirs.distance_m), (ours.angle_rad, theirs.angle_rad)):
                assert (a is None) == (b is None)
                if a is not None and b is not None:
                    np.testing.assert_allclose(a, b, atol=1e-5)


def unscaled(rng: np.random.Generator) -> Skeleton:
    skeleton = random_skeleton(rng, JOINTS)
    return replace(skeleton, rest=replace(skeleton.rest, scales=np.ones((JOINTS, 3))))


@pytest.mark.parametrize("name", TASKS)
def test_a_prepared_solver_solves_the_same(name: str) -> None:
    """One by one for other targets, and all of these together."""
    rng = np.random.default_rng(2)
    skeleton, options = unscaled(rng), SolveOptions(iterations=6)

    def made(seed: int) -> list[Task]:
        other = np.random.default_rng(seed)
        return [PositionTask(11, other.normal(size=3)), *TASKS[name](other), PosePrior(weight=0.05)]

    tasks = made(3)
    solver = prepare_solver(skeleton, tasks, options=options)
    assert solver.alone is not None
    wanted = [
        solve_pose(
            skeleton,
            skeleton.rest,
            [aimed(a, target_of(b)) for a, b in zip(tasks, made(n), strict=True)],
            options=options,
        )
        for n in range(4, 9)
    ]
    found = [solver.solve(targets=[target_of(task) for task in made(n)]) for n in range(4, 9)]
    every = zip(*([target_of(task) for task in made(n)] for n in range(4, 9)), strict=True)
    together = solver.solve(targets=[None if each[0] is None else np.stack(each) for each in every])
    assert together.pose.batch_shape == (5,)
    for n, (ours, theirs) in enumerate(zip(found, wanted, strict=True)):
        for cost, turns in ((ours.cost, ours.pose.rotations), (together.cost[n], together.pose.rotations[n])):
            np.testing.assert_allclose(cost, theirs.cost, rtol=1e-8)
            assert float(np.max(quat.angle_between(turns, theirs.pose.rotations))) < 1e-6
        for a, b in zip(ours.residuals, theirs.residuals, strict=True):
            for x, y in ((a.distance_m, b.distance_m), (a.angle_rad, b.angle_rad)):
                assert (x is None) == (y is None)
                if x is not None and y is not None:
                    np.testing.assert_allclose(x, y, atol=1e-8)


def target_of(task: Task) -> Any:
    """Where a task wants to."""
    if isinstance(task, RelativeTask):
        return task.rotation if task.position is None else task.position
    return getattr(task, "target", None)


def aimed(task: Task, target: Any) -> Task:
    """The task with another target."""
    if isinstance(task, RelativeTask):
        return replace(task, rotation=target) if task.position is None else replace(task, position=target)
    return task if target is None else replace(task, target=target)


def test_as_good_as_scipy() -> None:
    """Minima beside those of SciPy's trust region on the same residuals, over rotation vectors of its own making."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(12)
    skeleton = unscaled(rng)
    parents, offsets = skeleton.parents.tolist(), np.array(skeleton.rest.translations)
    begun = Rotation.from_quat(np.asarray(skeleton.rest.rotations), scalar_first=True)
    masses, centers = rng.uniform(size=JOINTS), 0.1 * rng.normal(size=(JOINTS, 3))
    for _ in range(2):
        goal, place, balance = rng.normal(size=(3, 3))
        turn = random_rotations(rng, 1)[0]

        def residual(
            x: np.ndarray, goal: Any = goal, place: Any = place, turn: Any = turn, balance: Any = balance
        ) -> Any:
            own = begun * Rotation.from_rotvec(x[3:].reshape(JOINTS, 3))
            world, places = own.as_matrix(), np.zeros((JOINTS, 3))
            for j, p in enumerate(parents):
                if p >= 0:
                    world[j] = world[p] @ world[j]
                places[j] = offsets[j] + x[:3] if p < 0 else places[p] + world[p] @ offsets[j]
            between = Rotation.from_matrix(world[6].T @ world[10]) * Rotation.from_quat(turn, scalar_first=True).inv()
            weighs = masses @ (places + np.einsum("jab,jb->ja", world, centers)) / masses.sum()
            return np.concatenate([
                places[11] - goal, 0.5 * (world[6].T @ (places[10] - places[6]) - place), 0.3 * between.as_rotvec(),
                weighs - balance, 0.1 * (own * begun.inv()).as_rotvec().ravel(),
            ])  # fmt: skip

        theirs = least_squares(residual, np.zeros(3 + 3 * JOINTS), xtol=1e-9, ftol=1e-9, gtol=1e-9).cost
        tasks = [
            PositionTask(11, goal), RelativeTask(10, 6, place, turn, 0.5, 0.3),
            CenterOfMassTask(balance, masses, centers), PosePrior(weight=0.1),
        ]  # fmt: skip
        found = solve_pose(skeleton, skeleton.rest, tasks, options=SolveOptions(iterations=500))
        assert found.converged
        assert found.cost <= theirs * (1.0 + 1e-6)


def test_a_body_balances_while_its_hands_hold_on_to_each_other() -> None:
    """Over one foot, inside the limits of a human, one hand in the other: what is asked for is there."""
    body = samples.load("human").character.skeleton
    roles = dict(find_roles(body).roles)
    weighs = human_masses(body, find_roles(body))
    limits = human_limits(body, roles)
    rest = evaluate.world_rotations_positions(body, body.rest)[1]
    foot = np.asarray(rest)[roles["left_foot"]]
    shifts = np.linspace(0.0, 0.05, 8)[:, None] * np.array([1.0, 0.0, 0.0])
    tasks: list[Task] = [
        PositionTask(roles["left_foot"], foot),
        PositionTask(roles["right_foot"], np.asarray(rest)[roles["right_foot"]] + shifts + [0.0, 0.1, 0.0]),
        RelativeTask(roles["left_hand"], roles["right_hand"], (0.0, 0.0, 0.12)),
        CenterOfMassTask(foot * [1.0, 0.0, 1.0], weighs.masses, weighs.centers, (1.0, 0.0, 1.0)),
        PosePrior(weight=1e-4),
    ]
    start = Pose(*(np.asarray(a, np.float64) for a in (body.rest.translations, body.rest.rotations, body.rest.scales)))
    found = solve_pose(body, start, tasks, limits=limits, options=SolveOptions(tolerance_m=1e-4))
    assert found.reached.all()
    world, places = (np.asarray(a) for a in evaluate.world_rotations_positions(body, found.pose))
    heavy = places + quat.rotate(world, np.asarray(weighs.centers))
    center = (heavy * np.asarray(weighs.masses)[:, None]).sum(axis=1) / np.sum(weighs.masses)
    assert np.abs(center[:, [0, 2]] - foot[[0, 2]]).max() < 1e-4
    left, right = roles["left_hand"], roles["right_hand"]
    between = quat.rotate(quat.conjugate(world[:, right]), places[:, left] - places[:, right])
    np.testing.assert_allclose(between, [[0.0, 0.0, 0.12]] * len(shifts), atol=1e-4)
