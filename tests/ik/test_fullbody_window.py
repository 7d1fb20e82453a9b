"""Frames solved together: the sum of squares beside finite differences, its limits of little and much smoothness, no lag."""

from __future__ import annotations

import importlib
import itertools
from dataclasses import replace

import numpy as np
import pytest

from keypose import evaluate, samples
from keypose.analysis import find_roles, human_limits
from keypose.arrays import Floats
from keypose.errors import ShapeError
from keypose.ik import (
    CenterOfMassTask,
    OrientationTask,
    PosePrior,
    PositionTask,
    RootMotion,
    Smoothness,
    SolveOptions,
    Task,
    limit_violation,
    solve_pose,
    solve_window,
)
from keypose.ik import fullbody_dense as dense
from keypose.ik.fullbody_problem import make_problem
from keypose.ik.fullbody_window import Window
from keypose.math import quat
from keypose.model import Pose, Skeleton
from tests.synthetic import random_pose, random_skeleton

FRAMES = 16
SEEN = (
    "Spine1", "Head", *(f"{side}{part}" for side in ("Left", "Right") for part in ("Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot")),
)  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    """Frames alone take the compiled path once its kernels are loaded."""
    importlib.import_module("keypose.kernels.fullbody")


@pytest.fixture(scope="module")
def body() -> Skeleton:
    return samples.load("human").character.skeleton


def walk_of(body: Skeleton, frames: int, noise_m: float, seed: int = 5) -> tuple[Floats, Floats]:
    """Where all ends go in a soft swing of the arms (T, J, 3), exactly and with noise."""
    turns = np.zeros((frames, body.joint_count, 3))
    phase = np.linspace(0.0, 2.0 * np.pi, frames)
    for name, way in (("LeftArm", 1.0), ("RightArm", -1.0), ("LeftUpLeg", -0.7), ("RightUpLeg", 0.7), ("Spine1", 0.2)):
        turns[:, body.index(name), 0] = 0.5 * way * np.sin(phase)
    rest = np.asarray(body.rest.rotations, np.float64)
    pose = Pose(body.rest.translations, quat.multiply(rest, quat.from_rotation_vector(turns)), body.rest.scales)
    places = np.asarray(evaluate.world_rotations_positions(body, pose.broadcast())[1], np.float64)
    return places, places + np.random.default_rng(seed).normal(size=places.shape) * noise_m


def still(skeleton: Skeleton, frames: int) -> Pose:
    """The rest pose of every frame, in double precision."""
    arrays = (skeleton.rest.translations, skeleton.rest.rotations, skeleton.rest.scales)
    return Pose(*(np.broadcast_to(np.asarray(a, np.float64), (frames, *a.shape)) for a in arrays))


def reach(body: Skeleton, places: Floats) -> list[Task]:
    """Points say nothing of how bones roll about themselves; a little of the rest pose does."""
    points: list[Task] = [PositionTask(name, places[:, body.index(name)]) for name in SEEN]
    return [*points, PosePrior(weight=0.03)]


def spread_of_speed(rotations: Floats) -> Floats:
    """How the turns from frame to frame change (T - 2, J), radians, worked out by multiplying alone."""
    step = quat.multiply(rotations[1:], quat.conjugate(rotations[:-1]))
    return quat.angle_between(step[1:], step[:-1])


def random_window(seed: int, frames: int, root: RootMotion | None = None) -> tuple[Window, Floats, Floats]:
    rng = np.random.default_rng(seed)
    skeleton = random_skeleton(rng, 9)
    pose = random_pose(rng, (frames,), 9)
    pose = Pose(pose.translations, pose.rotations, np.ones_like(pose.scales))
    tasks: list[Task] = [
        PositionTask(8, rng.normal(size=(frames, 3)), offset=(0.1, 0.2, 0.0)),
        OrientationTask(5, quat.normalize(rng.normal(size=(frames, 4))), weight=0.4),
        CenterOfMassTask(rng.normal(size=(frames, 3)), rng.uniform(0.1, 1.0, 9), weight=0.7),
        PosePrior(weight=0.1),
        Smoothness(rng.uniform(0.2, 2.0, 9), root_weight=0.8),
    ]
    problem = make_problem(skeleton, pose, tasks, (frames,), {}, (), {}, root or RootMotion())
    smooth = [term for term in problem.terms if term.kind is Smoothness]
    plain = tuple(term for term in problem.terms if term.kind is not Smoothness)

    window = Window.of(replace(problem, terms=plain), smooth)
    # Joints turn less than half a turn between frames, as frames of a motion do.
    base = quat.normalize(rng.normal(size=(1, 9, 4)))
    turns = np.cumsum(rng.normal(size=(frames, 9, 3)) * 0.4, axis=0)
    return window, quat.multiply(base, quat.from_rotation_vector(turns)), rng.normal(size=(frames, 3)) * 0.3


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("frames", [2, 3, 7])
def test_the_gradient_is_that_of_finite_differences(seed: int, frames: int) -> None:
    window, rotations, shift = random_window(seed, frames)
    linear, turned = window.linear(rotations, shift)
    rng, small = np.random.default_rng(seed), 1e-6
    for _ in range(5):
        way = rng.normal(size=linear.gradient.shape)

        def cost(size: float, way: Floats = way) -> float:
            new, moved = dense.apply(window.problem, rotations, shift, turned, window.spread(size * way))
            return window.cost(new, moved)

        slope = (cost(small) - cost(-small)) / (2.0 * small)
        assert abs(slope - float(np.sum(way * linear.gradient))) < 1e-6 * max(1.0, abs(slope))


def test_the_hessian_is_that_of_the_residuals() -> None:
    """Along any way the squares of what the residuals change by; its band solves as the whole matrix does."""
    window, rotations, shift = random_window(4, 6)
    linear, turned = window.linear(rotations, shift)
    size = linear.gradient.size
    whole = np.stack([linear.times(e.reshape(linear.gradient.shape)).ravel() for e in np.eye(size)])
    np.testing.assert_allclose(whole, whole.T, atol=1e-10)
    assert np.linalg.eigvalsh(whole).min() > -1e-9

    def all_residuals(way: Floats, small: float) -> Floats:
        new, moved = dense.apply(window.problem, rotations, shift, turned, window.spread(small * way))
        _, places, rows = dense.evaluate(window.problem, new, moved)
        turns, moves = window.bends(new, places)
        tasks = [(r.weight * r.residual).ravel() for r in rows]
        return np.concatenate([*tasks, (window.weight[:, None] * turns).ravel(), (window.root_weight * moves).ravel()])

    for n in range(4):
        way = np.random.default_rng(n).normal(size=linear.gradient.shape)
        changed = (all_residuals(way, 1e-6) - all_residuals(way, -1e-6)) / 2e-6
        np.testing.assert_allclose(way.ravel() @ whole @ way.ravel(), changed @ changed, rtol=1e-6)
    zero = np.zeros(6)
    state = dense.State(rotations, shift, zero, zero, zero, zero, zero > 0, zero, zero, zero.astype(np.int64))
    change, promised = window.change(state, linear, turned, 0.01, curved=False)
    expected = -np.linalg.solve(whole + 0.01 * np.eye(size), linear.gradient.ravel())
    np.testing.assert_allclose(change.ravel(), expected, atol=1e-10)
    assert promised > 0


def test_no_smoothness_is_every_frame_alone(body: Skeleton) -> None:
    tasks = reach(body, walk_of(body, FRAMES, 0.01)[1])
    alone = solve_pose(body, still(body, FRAMES), tasks)
    together = solve_window(body, still(body, FRAMES), [*tasks, Smoothness(0.0)])
    assert np.array_equal(alone.pose.rotations, together.pose.rotations)
    assert np.array_equal(alone.pose.translations, together.pose.translations)
    assert np.array_equal(alone.outcome, together.outcome)
    # A little of it changes little.
    little = solve_window(body, still(body, FRAMES), [*tasks, Smoothness(1e-4)])
    assert abs(float(little.cost.sum()) / float(alone.cost.sum()) - 1.0) < 1e-3


def test_very_much_smoothness_is_an_even_turn(body: Skeleton) -> None:
    """Every joint turns on at one speed about one axis, the root goes straight."""
    tasks = [*reach(body, walk_of(body, FRAMES, 0.01)[1]), Smoothness(1e3, root_weight=1e3)]
    found = solve_window(body, still(body, FRAMES), tasks, options=SolveOptions(iterations=40))
    assert spread_of_speed(np.asarray(found.pose.rotations)).max() < 1e-4
    assert np.abs(np.diff(np.asarray(found.pose.translations)[:, 0], 2, axis=0)).max() < 1e-5
    assert np.ptp(np.asarray(found.pose.translations)[:, 0], axis=0).max() > 1e-3  # straight, not still


def test_the_cost_falls_with_every_step(body: Skeleton) -> None:
    tasks = [*reach(body, walk_of(body, FRAMES, 0.02)[1]), Smoothness(0.2, root_weight=0.2)]
    found = [
        solve_window(body, still(body, FRAMES), tasks, options=SolveOptions(iterations=n)) for n in (1, 2, 3, 5, 8, 100)
    ]
    costs = [float(f.cost.sum()) for f in found]
    assert all(b <= a * (1.0 + 1e-12) for a, b in itertools.pairwise(costs))
    assert found[-1].converged.all() and not found[0].converged.any()
    # What has settled is settled.
    again = solve_window(body, found[-1].pose, [*tasks[:-2], PosePrior(still(body, FRAMES), weight=0.03), tasks[-1]])
    assert abs(float(again.cost.sum()) / costs[-1] - 1.0) < 1e-9


def test_noise_goes_and_nothing_lags(body: Skeleton) -> None:
    """Nearer to the noiseless motion than any of the frames alone; staying near the frame before is late instead."""
    frames = 40
    exact, noisy = walk_of(body, frames, 0.01)
    tasks, seen = reach(body, noisy), body.indices(SEEN)

    speed = np.gradient(exact, axis=0)[:, seen]

    def off(pose: Pose) -> tuple[float, float]:
        """RMS metres from the noiseless motion, and frames by which it is late."""
        away = np.asarray(evaluate.world_rotations_positions(body, pose)[1])[:, seen] - exact[:, seen]
        return float(np.sqrt(np.mean(np.sum(away**2, axis=-1)))), -float(np.sum(away * speed) / np.sum(speed**2))

    begun = still(body, frames)
    alone, before = solve_pose(body, begun, tasks), solve_pose(body, begun, [*tasks, Smoothness(1.0, root_weight=1.0)])
    together = solve_window(body, begun, [*tasks, Smoothness(1.0, root_weight=1.0)])
    assert off(together.pose)[0] < 0.6 * off(alone.pose)[0]
    assert abs(off(together.pose)[1]) < 0.1 < 0.5 < off(before.pose)[1]
    jerk = [np.abs(np.diff(np.asarray(f.pose.rotations), 3, axis=0)).mean() for f in (alone, together)]
    assert jerk[1] < 0.2 * jerk[0]


def test_limits_and_fixed_joints_hold(body: Skeleton) -> None:
    limits = human_limits(body, find_roles(body))
    frames, few = 8, SolveOptions(iterations=15)
    places = walk_of(body, frames, 0.0)[1] * np.array([1.0, 1.0, 1.6])
    places[:, body.index("LeftFoot")] += [0.0, 0.5, -0.6]  # knees and hips are asked for more than they can
    tasks = [*reach(body, places), Smoothness(0.5)]
    found = solve_window(
        body, still(body, frames), tasks, limits=limits, fixed=["Spine"], root="translation", options=few
    )
    rotations, rest = np.asarray(found.pose.rotations), np.asarray(body.rest.rotations, np.float64)
    for name, limit in limits.items():
        joint = body.index(name)
        assert limit_violation(limit, rotations[:, joint], rest[joint]).max() < 1e-6, name
    for name in ("Spine", body.names[0]):
        joint = body.index(name)
        assert np.array_equal(rotations[:, joint], np.broadcast_to(rotations[0, joint], (frames, 4)))
    free = solve_window(body, still(body, frames), tasks, options=few)
    assert float(free.cost.sum()) < float(found.cost.sum())


def test_joints_that_no_task_moves_stay(body: Skeleton) -> None:
    rng = np.random.default_rng(2)
    turned = quat.multiply(
        np.asarray(body.rest.rotations, np.float64),
        quat.from_rotation_vector(rng.normal(size=(FRAMES, body.joint_count, 3)) * 0.05),
    )
    pose = Pose(still(body, FRAMES).translations, turned, still(body, FRAMES).scales)
    places = walk_of(body, FRAMES, 0.01)[1]
    tasks = [PositionTask("LeftHand", places[:, body.index("LeftHand")]), Smoothness(1.0)]
    found = solve_window(body, pose, tasks, root="fixed")
    for name in ("RightArm", "LeftLeg"):
        joint = body.index(name)
        np.testing.assert_allclose(np.asarray(found.pose.rotations)[:, joint], turned[:, joint], atol=1e-12)


def test_characters_are_windows_of_their_own(body: Skeleton) -> None:
    both = np.stack([walk_of(body, FRAMES, 0.01, seed)[1] for seed in (1, 2)], axis=1)  # (T, 2, J, 3)
    tasks: list[Task] = [PositionTask(name, both[:, :, body.index(name)]) for name in SEEN]
    tasks.append(PosePrior(weight=0.03))
    arrays = (body.rest.translations, body.rest.rotations, body.rest.scales)
    pose = Pose(*(np.broadcast_to(np.asarray(a, np.float64), (FRAMES, 2, *a.shape)) for a in arrays))
    found = solve_window(body, pose, [*tasks, Smoothness(0.2)])
    for n in range(2):
        one = solve_window(body, still(body, FRAMES), [*reach(body, both[:, n]), Smoothness(0.2)])
        np.testing.assert_allclose(np.asarray(found.pose.rotations)[:, n], one.pose.rotations, atol=1e-7)
        np.testing.assert_allclose(found.cost[:, n], one.cost, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("frames", [1, 2])
def test_few_frames_have_no_speed_to_change(body: Skeleton, frames: int) -> None:
    tasks = reach(body, walk_of(body, frames, 0.0)[1])
    found = solve_window(body, still(body, frames), [*tasks, Smoothness(5.0)])
    alone = solve_pose(body, still(body, frames), tasks)
    np.testing.assert_allclose(found.cost, alone.cost, atol=1e-9)


def test_precision_is_that_of_the_pose_and_a_single_pose_is_refused(body: Skeleton) -> None:
    tasks = [*reach(body, walk_of(body, 5, 0.0)[1]), Smoothness(0.1)]
    arrays = (body.rest.translations, body.rest.rotations, body.rest.scales)
    pose = Pose(*(np.broadcast_to(np.asarray(a, np.float32), (5, *a.shape)) for a in arrays))
    assert np.asarray(solve_window(body, pose, tasks).pose.rotations).dtype == np.float32
    with pytest.raises(ShapeError, match="frames as the first axis"):
        solve_window(body, body.rest, [PositionTask("Head", [0.0, 1.6, 0.0]), Smoothness(0.1)])
    told: list[tuple[int, int]] = []
    solve_window(body, pose, tasks, progress=lambda step, most: told.append((step, most)))
    assert told and told[0] == (1, 100)
