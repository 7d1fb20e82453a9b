"""Motions that go round: told, laid end to end three times, and cut to one round again."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from keypose.arrays import Floats
from keypose.evaluate import world_rotations_positions
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton

# What is nearer than this closes a cycle, for a leg of LEG_M.
_CLOSED_M, _CLOSED_RAD = 1e-4, 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Cycle:
    """How a motion goes on after its last frame, which is its first: a joint carries all of it over the ground.

    Shapes and units: ``turn`` (4,) about the vertical and ``shift`` (3,) metres along the ground, in the model's space.
    """

    joint: int
    turn: Floats
    shift: Floats


def find_cycle(motion: Motion, skeleton: Skeleton, turned: Floats, places: Floats, size: float) -> Cycle | None:
    """How a motion repeats itself, None where its last frame is not its first.

    Shapes and units: ``turned`` (T, J, 4) and ``places`` (T, J, 3) of the motion in the model's space; ``size`` of its legs by
    `LEG_M`.
    """
    if motion.frame_count < 4:
        return None
    closed = _CLOSED_M * size
    pose = motion.pose.broadcast()
    first, last = pose[0], pose[-1]
    apart = np.linalg.norm(
        np.asarray(last.translations, np.float64) - np.asarray(first.translations, np.float64), axis=-1
    )
    angle = np.asarray(
        quat.angle_between(np.asarray(first.rotations, np.float64), np.asarray(last.rotations, np.float64))
    )
    movers = np.flatnonzero((apart > closed) | (angle > _CLOSED_RAD))
    if len(movers) > 1 or not np.allclose(first.scales, last.scales, atol=1e-5):
        return None
    if not len(movers):
        return Cycle(int(np.argmin(skeleton.parents)), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
    joint = int(movers[0])
    above = [joint]
    while (parent := int(skeleton.parents[above[-1]])) >= 0:
        above.append(parent)
    if np.any(np.asarray(pose.scales)[:, above[1:]] != 1):
        return None
    # all that moves has to hang on it
    hangs = np.zeros(skeleton.joint_count, bool)
    for j, parent in enumerate(skeleton.parents):
        hangs[j] = j == joint or (parent >= 0 and hangs[parent])
    still = np.ptp(places[:, ~hangs], axis=0).max(initial=0.0) < closed
    change = quat.multiply(turned[-1, joint], quat.conjugate(turned[0, joint]))
    tilt, turn = quat.swing_twist(change, np.array([0.0, 1.0, 0.0]))
    shift = places[-1, joint] - quat.rotate(turn, places[0, joint])
    level = float(np.linalg.norm(quat.to_rotation_vector(quat.shortest(tilt)))) < _CLOSED_RAD and abs(shift[1]) < closed
    return Cycle(joint, turn, shift * np.array([1.0, 0.0, 1.0])) if still and level else None


def unroll(motion: Motion, skeleton: Skeleton, cycle: Cycle) -> Motion:
    """Three rounds of a motion, one after the other: the middle one is the motion itself."""
    pose = motion.pose.broadcast()
    period = motion.frame_count - 1
    index = np.arange(3 * period + 1) % period
    index[-1] = period
    arrays = [np.asarray(a, np.float64)[index] for a in (pose.translations, pose.rotations, pose.scales)]
    translations, rotations = arrays[0].copy(), arrays[1].copy()
    turned, places = (np.asarray(a, np.float64) for a in world_rotations_positions(skeleton, Pose(*arrays)))
    for part, rounds in ((slice(0, period), -1), (slice(2 * period, 3 * period + 1), 1)):
        turn, shift = cycle.turn, cycle.shift
        if rounds < 0:
            turn = quat.conjugate(turn)
            shift = -quat.rotate(turn, shift)
        place = (
            quat.rotate(np.broadcast_to(turn, (*places[part, cycle.joint].shape[:-1], 4)), places[part, cycle.joint])
            + shift
        )
        rotation = quat.multiply(np.broadcast_to(turn, turned[part, cycle.joint].shape), turned[part, cycle.joint])
        parent = int(skeleton.parents[cycle.joint])
        if parent >= 0:
            back = quat.conjugate(turned[part, parent])
            place, rotation = quat.rotate(back, place - places[part, parent]), quat.multiply(back, rotation)
        translations[part, cycle.joint], rotations[part, cycle.joint] = place, rotation
    if np.allclose(cycle.turn, (1.0, 0.0, 0.0, 0.0)) and not cycle.shift.any():
        translations, rotations = arrays[0], arrays[1]
    return replace(motion, pose=Pose(translations, rotations, arrays[2]), events=(), morph_names=(), morph_weights=None)


def cut(long: Motion, motion: Motion, skeleton: Skeleton, cycle: Cycle) -> Motion:
    """The middle of three rounds as the motion that they were made from; its last frame is its first, a round on."""
    period = motion.frame_count - 1
    given = motion.pose
    arrays = [
        np.array(a[period : 2 * period + 1]) for a in (long.pose.translations, long.pose.rotations, long.pose.scales)
    ]
    for array in arrays:
        array[-1] = array[0]
    ends = Pose(*(a[[0, -1]] for a in arrays))
    turned, places = (np.asarray(a, np.float64) for a in world_rotations_positions(skeleton, ends))
    parent = int(skeleton.parents[cycle.joint])
    place = quat.rotate(cycle.turn, places[0, cycle.joint]) + cycle.shift
    rotation = quat.multiply(cycle.turn, turned[0, cycle.joint])
    if parent >= 0:
        back = quat.conjugate(turned[1, parent])
        place, rotation = quat.rotate(back, place - places[1, parent]), quat.multiply(back, rotation)
    if cycle.shift.any() or not np.allclose(cycle.turn, (1.0, 0.0, 0.0, 0.0)):
        arrays[0][-1, cycle.joint], arrays[1][-1, cycle.joint] = place, rotation
    arrays[1] = quat.align_signs(arrays[1], axis=0)
    translations, rotations = (
        a.astype(np.result_type(g)) for a, g in zip(arrays, (given.translations, given.rotations), strict=False)
    )
    return replace(motion, pose=Pose(translations, rotations, motion.pose.broadcast().scales))
