"""Operations on one pose that need the skeleton: look-at, two-bone limbs, planted feet."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Floats
from keypose.evaluate import world_rotations_positions
from keypose.ik import solve_limb
from keypose.ik.limb import rotation_between_frames
from keypose.math import quat
from keypose.model import Pose, Skeleton
from keypose.play.graph.poses import Buffer, Layout


@dataclass(frozen=True, slots=True, eq=False)
class Limb:
    """Upper, middle and end joint of a limb, how far before full reach it slows down, and where it bends at rest.

    ``bend`` is a direction in the upper joint's axes: a limb that is straight bends there.
    """

    upper: int
    middle: int
    end: int
    softness_m: float
    bend: tuple[float, float, float]


def make_limb(skeleton: Skeleton, chain: Sequence[int], softness_m: float) -> Limb:
    """The limb of three joints; one that is straight at rest bends forwards."""
    turned, places = world_rotations_positions(skeleton, skeleton.rest)
    start, middle, end = (np.asarray(places[j], np.float64) for j in chain)
    line = end - start
    along = line / max(float(np.linalg.norm(line)), 1e-30)
    side = (middle - start) - along * float((middle - start) @ along)
    for other in ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)):
        if float(np.linalg.norm(side)) <= 1e-3 * float(np.linalg.norm(line)):
            side = np.array(other) - along * float(np.array(other) @ along)
    local = quat.rotate(quat.conjugate(np.asarray(turned[chain[0]], np.float64)), side / np.linalg.norm(side))
    return Limb(chain[0], chain[1], chain[2], softness_m, (float(local[0]), float(local[1]), float(local[2])))


@dataclass(frozen=True, slots=True, eq=False)
class LookSolver:
    """Turns a chain of joints until the last one faces a target; each joint takes its share of what is left."""

    skeleton: Skeleton
    layout: Layout
    joints: tuple[int, ...]  # from the root side to the head
    shares: tuple[float, ...]
    forward: Floats  # in the last joint's axes
    limit_rad: float

    def __call__(self, buffer: Buffer, target: object, weight: float) -> Buffer:
        """The pose looking at a target (3,), in the character's space."""
        goal = np.asarray(target, np.float64)
        head, left, rotations = self.joints[-1], sum(self.shares), buffer.rotations
        rest_angle: float | None = None  # what weight and limit leave over
        for joint, share in zip(self.joints, self.shares, strict=True):
            if share == 0:
                continue
            turned, places = _world(self.skeleton, self.layout, Buffer(rotations, buffer.linear))
            swing = quat.from_two_vectors(quat.rotate(turned[head], self.forward), goal - places[head])
            angle = float(quat.angle_between(swing, quat.identity()))
            if rest_angle is None:
                rest_angle = angle - min(angle, self.limit_rad) * weight
            wanted = max(angle - rest_angle, 0.0) * share / left
            left -= share
            if wanted > 0:
                own = quat.multiply(quat.power(swing, wanted / angle), turned[joint])
                rotations = _with_world(self.skeleton, rotations, turned, {joint: own})
        return Buffer(rotations, buffer.linear)


@dataclass(frozen=True, slots=True, eq=False)
class ReachSolver:
    """Brings a limb's end to a target; the limb keeps bending the way it bends, the end keeps its facing."""

    skeleton: Skeleton
    layout: Layout
    limb: Limb

    def __call__(self, buffer: Buffer, target: object, weight: float) -> Buffer:
        """The pose with the limb's end at a target (3,), in the character's space."""
        turned, places = _world(self.skeleton, self.layout, buffer)
        end = places[self.limb.end]
        goal = end + weight * (np.asarray(target, np.float64) - end)
        return Buffer(
            _solved(self.skeleton, buffer.rotations, turned, places, self.limb, goal, turned[self.limb.end]),
            buffer.linear,
        )


@dataclass(frozen=True, slots=True, eq=False)
class PlantSolver:
    """Moves feet so that their contact points are where the pose's effectors say; the feet keep their facing.

    Where a leg is too short for its foot, the whole body sinks as far as it must. No contact goes below the lowest place
    that it has in any clip: a transition that swings through stops at the floor.
    """

    skeleton: Skeleton
    layout: Layout
    feet: tuple[tuple[int, int, Limb], ...]  # (contact, its joint, limb)
    floors_m: Floats  # per contact of the graph

    def __call__(self, buffer: Buffer, target: object, weight: float) -> Buffer:
        """The pose with all feet planted."""
        turned, places = _world(self.skeleton, self.layout, buffer)
        wanted = buffer.linear[self.layout.effector_slice].reshape(-1, 3).copy()
        wanted[:, 1] = np.maximum(wanted[:, 1], self.floors_m)
        turns = weight * buffer.linear[self.layout.turn_slice]
        goals: list[Floats] = []
        facing: list[Floats] = []
        for contact, joint, limb in self.feet:
            turn = quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), turns[contact])
            touch = places[joint] + weight * (wanted[contact] - places[joint])
            goals.append(touch + quat.rotate(turn, places[limb.end] - places[joint]))
            facing.append(quat.multiply(turn, turned[limb.end]))
        sink = max(self._sink(places, limb, goal) for (_, _, limb), goal in zip(self.feet, goals, strict=True))
        linear = buffer.linear
        if sink > 0:
            linear = linear.copy()
            for top in np.flatnonzero(self.skeleton.parents < 0):
                linear[3 * int(top) + 1] -= sink
            places = places - np.array([0.0, sink, 0.0])
        rotations = buffer.rotations
        for (_, _, limb), goal, end in zip(self.feet, goals, facing, strict=True):
            rotations = _solved(self.skeleton, rotations, turned, places, limb, goal, end)
        return Buffer(rotations, linear)

    def _sink(self, places: Floats, limb: Limb, goal: Floats) -> float:
        """How far the body must come down for a limb to reach its goal, in metres; 0 where coming down does not help."""
        start, middle, end = places[limb.upper], places[limb.middle], places[limb.end]
        reach = REACH * float(np.linalg.norm(middle - start) + np.linalg.norm(end - middle))
        across = float(np.hypot(goal[0] - start[0], goal[2] - start[2]))
        if across >= reach:
            return 0.0
        return max(float(start[1] - goal[1]) - float(np.sqrt(reach**2 - across**2)), 0.0)


REACH = 0.9995  # of a limb's length: a straight knee has no side to bend to
BIAS = 1e-5  # of a limb's length, towards where it bends at rest: rounding must not choose for a straight one


def _world(skeleton: Skeleton, layout: Layout, buffer: Buffer) -> tuple[Floats, Floats]:
    j = layout.joints
    pose = Pose(buffer.linear[: 3 * j].reshape(j, 3), buffer.rotations, buffer.linear[layout.scales].reshape(j, 3))
    return world_rotations_positions(skeleton, pose)


def _solved(
    skeleton: Skeleton, rotations: Floats, turned: Floats, places: Floats, limb: Limb, goal: Floats, facing: Floats
) -> Floats:
    """Local rotations with the limb's end at the goal and its world rotation ``facing``."""
    start, middle, end = places[limb.upper], places[limb.middle], places[limb.end]
    upper, lower = middle - start, end - middle
    lengths = float(np.linalg.norm(upper)), float(np.linalg.norm(lower))
    if not (lengths[0] > 0 and lengths[1] > 0):
        return rotations
    # The pole is where the middle joint is now, off the line from start to end.
    line = end - start
    pole = upper - line * (float(upper @ line) / max(float(line @ line), 1e-30))
    pole = pole + BIAS * sum(lengths) * quat.rotate(turned[limb.upper], np.array(limb.bend))
    # Soft reach must not move a limb that is already there: it starts from the limb's present stretch.
    stretch = float(np.linalg.norm(line))
    softness = min(limb.softness_m, max(sum(lengths) - stretch, 0.0))
    result = solve_limb(start, goal, pole, upper_m=lengths[0], lower_m=lengths[1], softness_m=softness)
    normal = np.cross(line, pole)
    if not np.any(normal):
        normal = result.normal
    if float(normal @ result.normal) < 0:
        normal = -normal
    first = rotation_between_frames(upper, normal, result.middle - start, result.normal)
    second = rotation_between_frames(lower, normal, result.end - result.middle, result.normal)
    changed = {
        limb.upper: quat.multiply(first, turned[limb.upper]),
        limb.middle: quat.multiply(second, turned[limb.middle]),
        limb.end: facing,
    }
    return _with_world(skeleton, rotations, turned, changed)


def _with_world(skeleton: Skeleton, rotations: Floats, turned: Floats, changed: Mapping[int, Floats]) -> Floats:
    """Local rotations that give some joints new world rotations; joints between two changed ones keep their local ones."""
    result = rotations.copy()
    fresh: dict[int, Floats] = {}

    def world_of(joint: int) -> Floats:
        if joint in fresh:
            return fresh[joint]
        parent = int(skeleton.parents[joint])
        if parent < 0 or not any(_below(skeleton, joint, c) for c in changed):
            return turned[joint]
        return quat.multiply(world_of(parent), result[joint])

    for joint in sorted(changed):
        parent = int(skeleton.parents[joint])
        above = quat.conjugate(world_of(parent)) if parent >= 0 else quat.identity()
        result[joint] = quat.normalize(quat.multiply(above, changed[joint]))
        fresh[joint] = changed[joint]
    return result


def _below(skeleton: Skeleton, joint: int, top: int) -> bool:
    """Whether ``joint`` is ``top`` or hangs below it."""
    while joint >= 0:
        if joint == top:
            return True
        joint = int(skeleton.parents[joint])
    return False


def descends(skeleton: Skeleton, chain: Sequence[int]) -> bool:
    """Whether every joint hangs below the one before it."""
    return all(_below(skeleton, b, a) and a != b for a, b in itertools.pairwise(chain))
