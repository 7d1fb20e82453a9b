"""Limbs of whole poses: the two bones above a hand or foot turned so that it, or something it carries, is where it should be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.errors import ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.ik import rotation_between_frames, solve_limb
from keypose.ik.chains import turns_between
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton

# Under this share of the upper bone the bend says nothing about where the middle joint belongs.
_STRAIGHT = 0.03


@dataclass(frozen=True, slots=True)
class LimbJoints:
    """The three joints of a limb: where it hangs on the body, its middle, its end; other joints may lie between them."""

    upper: int
    lower: int
    end: int


@dataclass(frozen=True, slots=True, eq=False)
class LimbPose:
    """Local rotations of the three joints (F, 3, 4), and how far the end stays from its target (F,) metres."""

    rotations: Floats
    error_m: Floats


def limb_above(skeleton: Skeleton, joint: int, roles: Mapping[str, int]) -> LimbJoints | None:
    """The limb whose end a joint is or hangs on; without roles for it, the two joints above it where they are no root.

    A root, and a joint right below one, has none.
    """
    path = path_up(skeleton, joint)
    for side in ("left", "right"):
        for parts in (("upper_arm", "lower_arm", "hand"), ("upper_leg", "lower_leg", "foot")):
            joints = [roles.get(f"{side}_{part}", -1) for part in parts]
            if joints[2] in path and all(j in path for j in joints):
                return LimbJoints(*joints)
    played = set(roles.values())
    if joint in played or len(path) < 4 or path[2] in played:
        return None  # the trunk, and what hangs on it, has chains of its own
    return LimbJoints(path[2], path[1], joint)


def bend_direction(motion: Motion, skeleton: Skeleton, limb: LimbJoints) -> Floats:
    """Where the middle joint lies across the limb where the motion bends it most, (3,) in the axes of its first joint."""
    turned, places = (np.asarray(a, np.float64) for a in world_rotations_positions(skeleton, motion.pose))
    turned, places = turned.reshape(-1, *turned.shape[-2:]), places.reshape(-1, *places.shape[-2:])
    out = _across(*(places[:, j] for j in (limb.upper, limb.lower, limb.end)))
    size = np.linalg.norm(out, axis=-1)
    frame = int(np.argmax(size))
    if size[frame] < 1e-6:
        return np.array([0.0, 0.0, 1.0])
    return np.asarray(quat.rotate(quat.conjugate(turned[frame, limb.upper]), out[frame] / size[frame]))


def bend_limb(
    skeleton: Skeleton,
    pose: Pose,
    limb: LimbJoints,
    targets: Floats,
    *,
    bend: Floats,
    rotations: Floats | None = None,
    carried: int | None = None,
    follow: bool = False,
    softness: float | Floats = 0.0,
) -> LimbPose:
    """Turn a limb in F poses so that its end, or the joint ``carried`` by it, is at its target.

    Shapes and units: ``pose`` of batch shape (F,); ``targets`` (F, 3) metres in the model's space; ``rotations`` (F, 4) of the
    end in the model's space, else it keeps its own, or with ``follow`` goes on as the bone above it; ``bend`` as of
    `bend_direction`; ``softness`` the share of the limb's length over which it slows down before it is straight, one or (F,).

    Raises:
        ShapeError: where the limb has a bone without length, or what is carried shall follow.
    """
    turned, places = (np.asarray(a, np.float64) for a in world_rotations_positions(skeleton, pose))
    local = np.asarray(pose.broadcast().rotations, np.float64)
    start, middle, end = (places[:, j] for j in (limb.upper, limb.lower, limb.end))
    end_turned = turned[:, limb.end] if rotations is None else np.asarray(rotations, np.float64)
    goal = np.asarray(targets, np.float64)
    if carried is not None and carried != limb.end:
        if follow and rotations is None:
            raise ShapeError(
                f"'{skeleton.names[carried]}' is carried by '{skeleton.names[limb.end]}', which cannot follow"
            )
        offset = quat.rotate(quat.conjugate(turned[:, limb.end]), places[:, carried] - end)
        goal = goal - quat.rotate(end_turned, offset)
    upper_m, lower_m = (float(np.linalg.norm(b - a, axis=-1).mean()) for a, b in ((start, middle), (middle, end)))
    for joint, length in ((limb.lower, upper_m), (limb.end, lower_m)):
        if not length > 1e-9:
            raise ShapeError(
                f"the limb of '{skeleton.names[limb.end]}': the bone to '{skeleton.names[joint]}' has no length"
            )
    pole = _pole(start, middle, end, turned[:, limb.upper], bend)
    old_normal = np.cross(end - start, pole)
    # The bend turns with the limb.
    swung = quat.rotate(turns_between(end - start, goal - start), pole)
    soft_m = np.asarray(softness, np.float64) * (upper_m + lower_m)
    solved = solve_limb(start, goal, swung, upper_m=upper_m, lower_m=lower_m, softness_m=soft_m)
    turn_upper = rotation_between_frames(middle - start, old_normal, solved.middle - start, solved.normal)
    turn_lower = rotation_between_frames(end - middle, old_normal, solved.end - solved.middle, solved.normal)
    result = np.empty((len(goal), 3, 4))
    above = int(skeleton.parents[limb.upper])
    new_upper = quat.multiply(turn_upper, turned[:, limb.upper])
    result[:, 0] = new_upper if above < 0 else quat.multiply(quat.conjugate(turned[:, above]), new_upper)
    over_middle = quat.multiply(turn_upper, turned[:, int(skeleton.parents[limb.lower])])
    result[:, 1] = quat.multiply(quat.conjugate(over_middle), quat.multiply(turn_lower, turned[:, limb.lower]))
    over_end = quat.multiply(turn_lower, turned[:, int(skeleton.parents[limb.end])])
    if follow and rotations is None:
        result[:, 2] = local[:, limb.end]
    else:
        result[:, 2] = quat.multiply(quat.conjugate(over_end), end_turned)
    for n, joint in enumerate((limb.upper, limb.lower, limb.end)):
        side = np.sum(result[:, n] * local[:, joint], axis=-1, keepdims=True)
        result[:, n] = np.where(side < 0, -result[:, n], result[:, n])
    return LimbPose(quat.normalize(result), np.linalg.norm(solved.end - goal, axis=-1))


def keep_ends(
    before: Motion, edited: Motion, skeleton: Skeleton, joints: Sequence[int], frames: Ints, roles: Mapping[str, int]
) -> tuple[Motion, float]:
    """An edited motion in which the ends of limbs are where they were before, and turned so, from the first of frames to the
    last; and how far they stay from there at most, metres.

    Raises:
        ShapeError: where a joint ends no limb.
    """
    limbs = [limb_above(skeleton, joint, roles) for joint in joints]
    for joint, limb in zip(joints, limbs, strict=True):
        if limb is None or limb.end != joint:
            raise ShapeError(
                f"keep: expected the end of a limb, such as a hand or a foot, got '{skeleton.names[joint]}'"
            )
    if not len(frames) or not limbs:
        return edited, 0.0
    span = slice(int(frames[0]), int(frames[-1]) + 1)
    turned, places = world_rotations_positions(skeleton, before.pose[span])
    away = 0.0
    for limb in limbs:
        if limb is None:
            continue
        solved = bend_limb(
            skeleton,
            edited.pose[span],
            limb,
            places[:, limb.end],
            bend=bend_direction(before, skeleton, limb),
            rotations=turned[:, limb.end],
        )
        rotations = np.array(edited.pose.broadcast().rotations)
        for n, part in enumerate((limb.upper, limb.lower, limb.end)):
            rotations[span, part] = solved.rotations[:, n]
        edited = replace(edited, pose=Pose(edited.pose.translations, rotations, edited.pose.scales))
        away = max(away, float(solved.error_m.max(initial=0.0)))
    return edited, away


def path_up(skeleton: Skeleton, joint: int) -> list[int]:
    """A joint and all above it."""
    path = [joint]
    while (joint := int(skeleton.parents[joint])) >= 0:
        path.append(joint)
    return path


def _across(start: Floats, middle: Floats, end: Floats) -> Floats:
    line = end - start
    along = line / np.maximum(np.linalg.norm(line, axis=-1, keepdims=True), 1e-12)
    return (middle - start) - along * np.sum((middle - start) * along, axis=-1, keepdims=True)


def _pole(start: Floats, middle: Floats, end: Floats, turned: Floats, bend: Floats) -> Floats:
    """Where the middle joint is, across the limb; one that is nearly straight goes over to its usual bend (F, 3)."""
    out = _across(start, middle, end)
    limit = _STRAIGHT * np.linalg.norm(middle - start, axis=-1, keepdims=True)
    share = np.clip(1.0 - np.linalg.norm(out, axis=-1, keepdims=True) / limit, 0.0, 1.0)
    return out + share * limit * quat.rotate(turned, np.broadcast_to(bend, start.shape))
