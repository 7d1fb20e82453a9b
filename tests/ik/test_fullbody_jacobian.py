"""Jacobians of all tasks, and the curvature, against central finite differences on random skeletons."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from keypose.ik import (
    CenterOfMassTask,
    Cone,
    ContactTask,
    EulerRange,
    Hinge,
    JointLimit,
    LookAtTask,
    OrientationTask,
    PosePrior,
    PositionTask,
    RelativeTask,
    RootMotion,
    Smoothness,
    Task,
    clamp_rotation,
    limit_violation,
)
from keypose.ik import fullbody_dense as dense
from keypose.ik.fullbody_limits import FREE, HELD, edge_of_cone, find_bounds
from keypose.ik.fullbody_problem import Problem, make_problem
from keypose.ik.limits import swing_axes
from keypose.math import quat
from keypose.model import Pose
from tests.synthetic import random_pose, random_rotations, random_skeleton

JOINTS, COUNT = 9, 4


def points(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(COUNT, 3))


TASKS: dict[str, Callable[[np.random.Generator], Task]] = {
    "position": lambda rng: PositionTask(7, points(rng), rng.uniform(0.5, 2.0, COUNT), (0.1, 0.2, 0.3)),
    "orientation": lambda rng: OrientationTask(5, random_rotations(rng, COUNT), 0.7),
    "look-at": lambda rng: LookAtTask(6, points(rng), (0.1, 0.5, 1.0), 0.5, (0.1, 0.0, 0.1)),
    "relative place": lambda rng: RelativeTask(8, 4, points(rng), None, 0.4, offset=(0.0, 0.1, 0.0)),
    "relative turn": lambda rng: RelativeTask(8, 4, None, random_rotations(rng, COUNT), rotation_weight=0.6),
    "centre of mass": lambda rng: CenterOfMassTask(
        points(rng), rng.uniform(size=JOINTS), rng.normal(size=(JOINTS, 3)), (1.0, 0.5, 1.0), 0.3
    ),
    "contact": lambda rng: ContactTask(3, points(rng), points(rng), True, 0.9, (0.1, 0.1, 0.0)),
    "contact above": lambda rng: ContactTask(8, points(rng), points(rng), False, 0.9),
    "prior": lambda rng: PosePrior(random_pose(rng, (COUNT,), JOINTS), rng.uniform(size=JOINTS), 0.5),
    "smoothness": lambda _: Smoothness(0.2, 0.1),
}


def problem_of(rng: np.random.Generator, tasks: list[Task]) -> tuple[Problem, np.ndarray, np.ndarray]:
    skeleton = random_skeleton(rng, JOINTS)
    pose = random_pose(rng, (COUNT,), JOINTS)
    pose = Pose(pose.translations, pose.rotations, np.repeat(rng.uniform(0.7, 1.4, (COUNT, JOINTS, 1)), 3, axis=-1))
    problem = make_problem(skeleton, pose, tasks, (COUNT,), {}, (), {}, RootMotion())
    away = quat.from_rotation_vector(rng.normal(size=(COUNT, JOINTS, 3)) * 0.5)
    return problem, quat.multiply(problem.start, away), rng.normal(size=(COUNT, 3))


def weighted(problem: Problem, rotations: np.ndarray, shift: np.ndarray) -> np.ndarray:
    rows = dense.evaluate(problem, rotations, shift)[2]
    return np.concatenate([r.weight * r.residual for r in rows], axis=1)


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_jacobians(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    problem, rotations, shift = problem_of(rng, [TASKS[name](rng)])
    turned, places, rows = dense.evaluate(problem, rotations, shift)
    ours = dense.jacobian(problem, rows, places)
    step, theirs = 1e-6, np.zeros_like(ours)
    for column in range(ours.shape[2]):
        change = np.zeros((COUNT, ours.shape[2]))
        change[:, column] = step
        ahead = weighted(problem, *dense.apply(problem, rotations, shift, turned, change))
        behind = weighted(problem, *dense.apply(problem, rotations, shift, turned, -change))
        theirs[:, :, column] = (ahead - behind) / (2 * step)
    assert np.abs(ours).max() > 0 or name == "contact above"
    np.testing.assert_allclose(ours, theirs, atol=1e-6)


def test_curvature() -> None:
    """With it the model of the cost is right to the third order where tasks are places."""
    rng = np.random.default_rng(4)
    some = ("position", "contact", "relative place", "centre of mass")
    problem, rotations, shift = problem_of(rng, [TASKS[name](rng) for name in some])
    turned, places, rows = dense.evaluate(problem, rotations, shift)
    matrix = dense.jacobian(problem, rows, places)
    gradient = np.einsum("nrc,nr->nc", matrix, weighted(problem, rotations, shift))
    hessian = np.swapaxes(matrix, 1, 2) @ matrix + dense.curvature(problem, turned, places)
    np.testing.assert_allclose(hessian, np.swapaxes(hessian, 1, 2), atol=1e-12)
    way = rng.normal(size=gradient.shape)
    left = []
    for size in (1e-2, 1e-3):
        change = size * way
        cost = 0.5 * np.sum(weighted(problem, *dense.apply(problem, rotations, shift, turned, change)) ** 2, axis=1)
        before = 0.5 * np.sum(weighted(problem, rotations, shift) ** 2, axis=1)
        model = np.sum(gradient * change, axis=1) + 0.5 * np.einsum("na,nab,nb->n", change, hessian, change)
        left.append(np.abs(cost - before - model))
    assert (left[1] < 2e-3 * left[0] + 1e-12).all()  # a thousandth: the third order


LIMITS: dict[str, JointLimit] = {
    "hinge": Hinge((0.0, 0.3, 1.0), -0.3, 1.9),
    "angles": EulerRange("ZXY", (-0.5, -0.4, -0.3), (1.0, 0.8, 0.6)),
    "fixed axes": EulerRange("xyz", (-0.5, -0.4, -0.3), (1.0, 0.8, 0.6)),
    "cone": Cone((1.0, 0.2, 0.0), (0.9, 0.5), -0.4, 0.7),
    "cone elsewhere": Cone((1.0, 0.2, 0.0), (1.3, 0.9), -0.4, 0.7, (0.8, 0.6, 0.0, 0.0), (0.0, 0.1, 1.0)),
}


@pytest.mark.parametrize("name", LIMITS)
def test_bounds_are_known_with_their_directions(name: str) -> None:
    """Outwards along a bound breaks the limit at once, inwards does not; across all bounds met breaks it at most slowly."""
    rng, limit, small = np.random.default_rng(5), LIMITS[name], 1e-4
    home = random_rotations(rng, 200)
    rotations = quat.multiply(home, quat.from_rotation_vector(rng.normal(size=(200, 3))))
    rotations = clamp_rotation(limit, rotations, home)
    met = find_bounds(limit, rotations, home)
    directions, sides = met.directions, met.sides
    assert (sides != FREE).any(axis=1).mean() > 0.5

    def broken(n: int, way: np.ndarray) -> float:
        turn = quat.from_rotation_vector(small * way / np.linalg.norm(way))
        return float(limit_violation(limit, quat.multiply(turn, rotations[n]), home[n])) / small

    slow: list[float] = []
    for n in range(200):
        met = directions[n][sides[n] != FREE]
        for k, side in enumerate(sides[n][sides[n] != FREE]):
            outwards = np.linalg.pinv(met)[:, k] * (1 if side == HELD else side)
            assert broken(n, outwards) > 0.05
            assert side == HELD or broken(n, -outwards) < 1e-3
        if 0 < len(met) < 3:
            slow.append(broken(n, np.linalg.svd(met)[2][-1]))
    assert not slow or np.quantile(slow, 0.95) < 1e-2


@pytest.mark.parametrize("name", LIMITS)
def test_bounds_are_as_far_as_they_are(name: str) -> None:
    """From a little inside, the room along the direction of a bound leads to that bound, but for how it is curved."""
    rng, limit, small = np.random.default_rng(7), LIMITS[name], 1e-3
    home = random_rotations(rng, 400)
    rotations = quat.multiply(home, quat.from_rotation_vector(rng.normal(size=(400, 3))))
    rotations = clamp_rotation(limit, rotations, home)
    met = find_bounds(limit, rotations, home)
    seen = 0
    for k in range(3):
        at = np.flatnonzero(
            (np.abs(met.sides[:, k]) == 1) & ((met.sides != FREE).sum(axis=1) == 1 + 2 * (name == "hinge"))
        )
        sign = met.sides[at, k].astype(float)[:, None]
        ways = sign * met.directions[at, k] / np.linalg.norm(met.directions[at, k], axis=-1, keepdims=True)
        inside = quat.multiply(quat.from_rotation_vector(-small * ways), rotations[at])
        here = find_bounds(limit, inside, home[at])
        room = here.room_to(met.sides[at])[:, k]
        np.testing.assert_allclose(room, small, rtol=0.02)
        np.testing.assert_array_equal(here.room_to(np.full_like(met.sides[at], FREE)), 0.0)
        assert (here.up >= 0).all() and (here.down >= 0).all()
        seen += len(at)
    assert seen > 50


def test_edges_of_cones_are_as_curved_as_they_are() -> None:
    """What leaves a cone along its edge, and along with the turn about the axis, by differences of what is bounded."""
    rng, limit, small = np.random.default_rng(6), LIMITS["cone elsewhere"], 1e-4
    assert isinstance(limit, Cone)
    home, center = random_rotations(rng, 300), np.asarray(limit.center)
    rotations = quat.multiply(home, quat.from_rotation_vector(1.5 * rng.normal(size=(300, 3))))
    rotations = clamp_rotation(limit, rotations, home)
    met = find_bounds(limit, rotations, home)
    directions, sides = met.directions, met.sides
    at = sides[:, 1] != FREE
    assert at.sum() > 50
    home, rotations, normal = home[at], rotations[at], directions[at, 1]
    axis = np.asarray(limit.axis) / np.linalg.norm(limit.axis)
    axis = quat.rotate(rotations, np.broadcast_to(axis, normal.shape))
    edge = np.cross(axis, normal)
    first, second = swing_axes(limit)

    def reach(way: np.ndarray) -> np.ndarray:
        turn = quat.multiply(quat.normalize(np.concatenate([np.ones((len(way), 1)), 0.5 * way], 1)), rotations)
        turn = quat.multiply(quat.conjugate(quat.multiply(home, np.broadcast_to(center, home.shape))), turn)
        own = np.asarray(limit.axis) / np.linalg.norm(limit.axis)
        pointed = quat.rotate(turn, np.broadcast_to(own, way.shape))
        x, y, z = pointed @ first, pointed @ second, pointed @ own
        angle, sine = np.arctan2(np.hypot(x, y), z), np.hypot(x, y)
        return angle * np.hypot(y / sine / limit.swings[0], x / sine / limit.swings[1])

    def bent(way: np.ndarray) -> np.ndarray:
        return (reach(small * way) + reach(-small * way) - 2.0 * reach(0.0 * way)) / small**2

    slope = (reach(small * normal) - reach(-small * normal)) / (2.0 * small)
    turn = quat.multiply(quat.conjugate(quat.multiply(home, np.broadcast_to(center, home.shape))), rotations)
    np.testing.assert_allclose(bent(edge) / slope, edge_of_cone(limit, turn), atol=1e-5)
    np.testing.assert_allclose((bent(edge + axis) - bent(edge - axis)) / (4.0 * slope), -0.5, atol=1e-5)
    np.testing.assert_allclose(bent(axis) / slope, 0.0, atol=1e-5)
