"""Chains of joints that reach for a point: cyclic coordinate descent and FABRIK, for any number of poses at once, with limits."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Array, Floats, as_float, checked
from keypose.errors import ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.ik.limits import JointLimit, clamp_rotation
from keypose.math import quat
from keypose.model import Pose, Skeleton


@dataclass(frozen=True, slots=True, eq=False)
class ChainResult:
    """A pose whose chain reaches for a target.

    Shapes and units: ``error_m`` (*B,) distance left; ``converged`` (*B,) whether that is within the tolerance; ``iterations``
    that the slowest needed.
    """

    pose: Pose
    error_m: Floats
    converged: np.ndarray
    iterations: int


def chain_between(skeleton: Skeleton, start: str | int, end: str | int) -> tuple[int, ...]:
    """The joints from one down to another, both included.

    Raises:
        UnknownName: where a joint does not exist.
        ShapeError: where ``end`` does not hang below ``start``, or a number is no joint.
    """
    first, joint = skeleton.index(start), skeleton.index(end)
    path = [joint]
    while joint != first:
        joint = int(skeleton.parents[joint])
        if joint < 0:
            raise ShapeError(f"joint '{skeleton.names[path[0]]}' does not hang below '{skeleton.names[first]}'")
        path.append(joint)
    return tuple(path[::-1])


def solve_ccd(
    skeleton: Skeleton,
    pose: Pose,
    chain: Sequence[int],
    target: Array,
    *,
    limits: Mapping[str, JointLimit] | None = None,
    iterations: int = 64,
    tolerance_m: float = 1e-4,
    damping_rad: float = np.pi,
) -> ChainResult:
    """Turn the joints of a chain, the last first, until its end is at a target.

    Shapes and units: ``pose`` of batch shape (*B,), ``target`` (*B, 3) metres in the model's space, ``chain`` from
    `chain_between`; its last joint is the end and does not turn. ``damping_rad`` limits a single turn, which spreads the
    bend over the chain. A target out of reach is approached as far as the chain goes.

    Raises:
        ShapeError: where shapes disagree or a number makes no sense.

    Source: L. Wang and C. Chen, "A combined optimization method for solving the inverse kinematics problem of mechanical
    manipulators" (IEEE 1991).
    """
    work = _Chain(skeleton, pose, chain, target, limits, tolerance_m)
    if iterations < 1 or not damping_rad > 0:
        raise ShapeError(f"iterations, damping_rad: expected positive numbers, got {iterations} and {damping_rad}")
    used = 0
    while used < iterations and len(rows := work.left()):
        used += 1
        work.descend(rows, damping_rad)
    return work.result(used)


def solve_fabrik(
    skeleton: Skeleton,
    pose: Pose,
    chain: Sequence[int],
    target: Array,
    *,
    limits: Mapping[str, JointLimit] | None = None,
    iterations: int = 64,
    tolerance_m: float = 1e-4,
) -> ChainResult:
    """Pull a chain to a target by moving its points along the bones, forwards and backwards, then turn the joints to match.

    Shapes as in `solve_ccd`. With limits each round ends with the joints inside them, and with one round of descent, because
    points that are pulled know nothing of limits and would stop on the way. A target out of reach stretches the chain
    straight towards it.

    Raises:
        ShapeError: where shapes disagree or a number makes no sense.

    Source: A. Aristidou and J. Lasenby, "FABRIK: a fast, iterative solver for the inverse kinematics problem" (2011).
    """
    work = _Chain(skeleton, pose, chain, target, limits, tolerance_m)
    if iterations < 1:
        raise ShapeError(f"iterations: expected at least 1, got {iterations}")
    limited = any(limit is not None for limit in work.limits[:-1])
    used = 0
    while used < iterations and len(rows := work.left()):
        used += 1
        work.pull(rows)
        if limited:
            work.descend(rows, np.pi)
    return work.result(used)


class _Chain:
    """The chain of N poses: local and model rotations and the places of its joints, in float64."""

    def __init__(
        self,
        skeleton: Skeleton,
        pose: Pose,
        chain: Sequence[int],
        target: Array,
        limits: Mapping[str, JointLimit] | None,
        tolerance_m: float,
    ) -> None:
        if len(chain) < 2:
            raise ShapeError(f"chain: expected at least 2 joints, got {len(chain)}")
        for above, joint in itertools.pairwise(skeleton.index(j) for j in chain):
            if int(skeleton.parents[joint]) != above:
                raise ShapeError(
                    f"chain: '{skeleton.names[joint]}' is no child of '{skeleton.names[above]}'; see chain_between"
                )
        if not tolerance_m > 0:
            raise ShapeError(f"tolerance_m: expected more than 0, got {tolerance_m}")
        self.skeleton, self.pose, self.chain, self.tolerance = skeleton, pose, tuple(chain), tolerance_m
        goal = checked(np.asarray(as_float(target), np.float64), (..., 3), "target")
        if not np.all(np.isfinite(goal)):
            raise ShapeError("target: expected finite numbers")
        self.batch = np.broadcast_shapes(pose.batch_shape, goal.shape[:-1])
        self.target = np.broadcast_to(goal, (*self.batch, 3)).reshape(-1, 3)
        turned, places = (np.asarray(a, np.float64) for a in world_rotations_positions(skeleton, pose))
        index = list(chain)
        self.places = (
            np.broadcast_to(places, (*self.batch, *places.shape[-2:]))[..., index, :].reshape(-1, len(index), 3).copy()
        )
        self.turned = (
            np.broadcast_to(turned, (*self.batch, *turned.shape[-2:]))[..., index, :].reshape(-1, len(index), 4).copy()
        )
        above = int(skeleton.parents[index[0]])
        self.above = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (len(self.target), 4))
        if above >= 0:
            self.above = np.broadcast_to(turned[..., above, :], (*self.batch, 4)).reshape(-1, 4)
        known = limits or {}
        for name in known:
            skeleton.index(name)
        self.limits = [known.get(skeleton.names[j]) for j in index]
        self.rest = np.asarray(skeleton.rest.rotations, np.float64)[index]
        everything = np.arange(len(self.target))
        for n, limit in enumerate(self.limits[:-1]):  # begin inside
            if limit is not None:
                self.turn(everything, n, np.broadcast_to([1.0, 0.0, 0.0, 0.0], (len(self.target), 4)))

    def error(self) -> Floats:
        """How far each end is from its target (N,), metres."""
        return np.linalg.norm(self.places[:, -1] - self.target, axis=-1)

    def left(self) -> np.ndarray:
        """The poses that are not there yet."""
        return np.nonzero(self.error() > self.tolerance)[0]

    def descend(self, rows: np.ndarray, damping_rad: float) -> None:
        """One round of cyclic coordinate descent."""
        for n in range(len(self.chain) - 2, -1, -1):
            here = self.places[rows, n]
            turn = turns_between(self.places[rows, -1] - here, self.target[rows] - here)
            if damping_rad < np.pi:
                angle = quat.angle_between(np.broadcast_to([1.0, 0.0, 0.0, 0.0], turn.shape), turn)
                turn = quat.power(turn, np.minimum(1.0, damping_rad / np.maximum(angle, 1e-12)))
            self.turn(rows, n, turn)

    def pull(self, rows: np.ndarray) -> None:
        """One round of FABRIK: points from the target back to the root and forth again, then joints to match."""
        target, points = self.target[rows], self.places[rows]
        root = points[:, 0].copy()
        lengths = np.linalg.norm(np.diff(points, axis=1), axis=-1)
        far = np.linalg.norm(target - root, axis=-1) >= lengths.sum(axis=1)
        points[:, -1] = target
        for n in range(len(self.chain) - 2, -1, -1):
            points[:, n] = points[:, n + 1] + _along(points[:, n] - points[:, n + 1], lengths[:, n])
        points[:, 0] = root
        for n in range(len(self.chain) - 1):
            way = np.where(far[:, None], target - points[:, n], points[:, n + 1] - points[:, n])
            points[:, n + 1] = points[:, n] + _along(way, lengths[:, n])
        for n in range(len(self.chain) - 1):
            here = self.places[rows, n]
            self.turn(rows, n, turns_between(self.places[rows, n + 1] - here, points[:, n + 1] - here))

    def turn(self, rows: np.ndarray, n: int, turn: Floats) -> None:
        """Turn joint n of some poses in the model's space, as far as its limit allows; everything below follows."""
        limit, old = self.limits[n], self.turned[rows, n]
        new = quat.normalize(quat.multiply(turn, old))
        if limit is not None:
            parent = self.above[rows] if n == 0 else self.turned[rows, n - 1]
            local = clamp_rotation(limit, quat.multiply(quat.conjugate(parent), new), self.rest[n])
            new = quat.multiply(parent, local)
        moved = quat.multiply(new, quat.conjugate(old))[:, None]
        here = self.places[rows, n : n + 1]
        below = self.places[rows, n + 1 :] - here
        self.places[rows, n + 1 :] = here + quat.rotate(np.broadcast_to(moved, (*below.shape[:-1], 4)), below)
        following = self.turned[rows, n + 1 :]
        self.turned[rows, n + 1 :] = quat.multiply(np.broadcast_to(moved, following.shape), following)
        self.turned[rows, n] = new

    def result(self, used: int) -> ChainResult:
        """The whole pose; the end keeps its own local rotation."""
        rotations = np.array(np.broadcast_to(self.pose.rotations, (*self.batch, *self.pose.rotations.shape[-2:])))
        flat = rotations.reshape(-1, *rotations.shape[-2:])
        parent = self.above
        for n, joint in enumerate(self.chain[:-1]):
            flat[:, joint] = quat.multiply(quat.conjugate(parent), self.turned[:, n])
            parent = self.turned[:, n]
        error = self.error()
        shape = self.batch
        return ChainResult(
            Pose(self.pose.translations, flat.reshape(rotations.shape), self.pose.scales),
            error.reshape(shape),
            (error <= self.tolerance).reshape(shape),
            used,
        )


def turns_between(a: Floats, b: Floats) -> Floats:
    """The shortest turns (N, 4) from directions to directions; none where one of them is no direction."""
    la, lb = (np.linalg.norm(v, axis=-1, keepdims=True) for v in (a, b))
    lost = (la < 1e-12) | (lb < 1e-12)
    x = np.where(lost, [1.0, 0.0, 0.0], a / np.maximum(la, 1e-300))
    y = np.where(lost, [1.0, 0.0, 0.0], b / np.maximum(lb, 1e-300))
    return quat.from_two_vectors(x, y)


def _along(way: Floats, length: Floats) -> Floats:
    """A vector (N, 3) with another length (N,); up where it has no direction."""
    norm = np.linalg.norm(way, axis=-1, keepdims=True)
    return np.where(norm < 1e-12, [0.0, 1.0, 0.0], way / np.maximum(norm, 1e-300)) * length[:, None]
