"""Feet that stand still where they touch the ground: contacts, anchors, and legs that reach them.

A foot in contact is moved so that the point that carries it (the ball, or the heel before the ball lands) does not move.
Between two contacts the correction goes over smoothly, with the speed it has at both ends, so that no knee jumps. Where a
leg is too short for its foot, the hips come down a little.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from keypose.analysis.contacts import foot_contacts
from keypose.analysis.roles import SIDES
from keypose.arrays import Floats
from keypose.errors import KeyposeError, ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.ik import rotation_between_frames, solve_limb
from keypose.math import quat, spline
from keypose.model import Motion, Pose, Skeleton

Touching = Mapping[str, np.ndarray]


@dataclass(frozen=True, slots=True)
class PlantOptions:
    """What counts as a contact, and how feet are held.

    Units:
        height_m, speed_m_s: limits of a contact for a leg of 0.85 m; they grow with the leg.
        softness: share of the leg's length over which it slows down before it is straight.
        lower_hips: whether the hips may come down for a foot out of reach.
    """

    height_m: float = 0.03
    speed_m_s: float = 0.25
    softness: float = 0.01
    lower_hips: bool = True

    def __post_init__(self) -> None:
        if not (self.height_m > 0 and self.speed_m_s > 0 and 0 <= self.softness < 0.2):
            raise ShapeError("options: expected positive limits and a softness from 0 to 0.2")


@dataclass(frozen=True, slots=True, eq=False)
class PlantResult:
    """The motion with planted feet.

    Shapes and units: ``touching`` point -> (T,) bool for ``left_heel``, ``left_ball`` ...; ``moved_m`` (T,) how far the feet
    were moved at most; ``short_m`` how far a planted foot stays from its anchor at most.
    """

    motion: Motion
    touching: Touching
    moved_m: Floats
    short_m: float


def plant_feet(
    motion: Motion,
    skeleton: Skeleton,
    roles: Mapping[str, int],
    *,
    touching: Touching | None = None,
    heights: Floats | None = None,
    options: PlantOptions = PlantOptions(),
) -> PlantResult:
    """A motion whose feet do not slide while they touch the ground.

    Shapes and units: ``touching`` as `foot_contacts` gives it (found in this motion, if not given); ``heights`` (J,) metres,
    the height of every joint where it stands on the ground (if not given, where the foot is in its contacts).

    Raises:
        KeyposeError: where a leg has no hip, knee or foot.

    Source: L. Kovar, J. Schreiner and M. Gleicher, "Footskate cleanup for motion capture editing" (SCA 2002).
    """
    for side in SIDES:
        for part in ("upper_leg", "lower_leg", "foot"):
            if f"{side}_{part}" not in roles:
                raise KeyposeError(f"feet cannot be planted: nothing plays {side}_{part}")
    turned, places = (np.asarray(a, np.float64) for a in world_rotations_positions(skeleton, motion.pose.broadcast()))
    leg_m = _leg_length(roles, places)
    if touching is None:
        touching = foot_contacts(
            roles, places, motion.rate_hz, leg_m, height_m=options.height_m, speed_m_s=options.speed_m_s
        )
    corrections = {side: _corrections(side, roles, places, touching, heights) for side in SIDES}
    drop = np.zeros((len(places), 3))
    if options.lower_hips:
        drop = _hips_drop(roles, places, corrections, motion.rate_hz, options)
    rotations = np.array(np.asarray(motion.pose.broadcast().rotations, np.float64))
    short = 0.0
    for side in SIDES:
        missed = _bend_leg(
            side, roles, skeleton, turned, places + drop[:, None], corrections[side] - drop, rotations, options
        )
        held = np.zeros(len(places), bool)
        for point in ("heel", "ball"):
            held |= touching.get(f"{side}_{point}", held)
        short = max(short, float(missed[held].max(initial=0.0)))
    pose = motion.pose.broadcast()
    translations = np.array(np.asarray(pose.translations, np.float64))
    hips = roles["hips"]
    parent = int(skeleton.parents[hips])
    size, above = np.ones(3), parent
    while above >= 0:  # what hangs under a joint of another scale goes another way
        size, above = size * np.asarray(pose.scales, np.float64)[:, above], int(skeleton.parents[above])
    translations[:, hips] += drop if parent < 0 else quat.rotate(quat.conjugate(turned[:, parent]), drop) / size
    dtype = pose.rotations.dtype
    planted = Pose(
        translations.astype(pose.translations.dtype), quat.align_signs(rotations, axis=0).astype(dtype), pose.scales
    )
    moved = np.max([np.linalg.norm(c, axis=-1) for c in corrections.values()], axis=0)
    return PlantResult(replace(motion, pose=planted), touching, moved, short)


def _leg_length(roles: Mapping[str, int], places: Floats) -> float:
    hip, knee, foot = (places[0, roles[f"left_{p}"]] for p in ("upper_leg", "lower_leg", "foot"))
    return float(np.linalg.norm(knee - hip) + np.linalg.norm(foot - knee))


def _runs(track: np.ndarray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], track, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _corrections(
    side: str,
    roles: Mapping[str, int],
    places: Floats,
    touching: Touching,
    heights: Floats | None,
) -> Floats:
    """How far the foot of a side has to be moved in every frame (T, 3)."""
    points = {
        name: roles[f"{side}_{role}"]
        for name, role in (("heel", "foot"), ("ball", "toes"))
        if f"{side}_{role}" in roles
    }
    flags = {name: np.asarray(touching.get(f"{side}_{name}", np.zeros(len(places), bool))) for name in points}
    carrying = np.zeros(len(places), bool)
    for flag in flags.values():
        carrying |= flag
    ground = {
        name: float(heights[joint]) if heights is not None else float(np.median(places[flags[name], joint, 1]))
        for name, joint in points.items()
        if heights is not None or flags[name].any()
    }
    # So far the foot's lowest point is under (or, negative, over) the ground.
    under = np.max(
        [ground[name] - places[:, joint, 1] for name, joint in points.items() if name in ground],
        axis=0,
        initial=-np.inf,
    )
    result = np.zeros((len(places), 3))
    runs = _runs(carrying)
    for start, stop in runs:
        result[start:stop] = _held(start, stop, points, flags, places)
        result[start:stop, 1] = under[start:stop]
    result = _bridged(result, runs)
    if heights is not None:
        result[:, 1] = np.maximum(result[:, 1], under)
    return result


def _held(start: int, stop: int, points: Mapping[str, int], flags: Mapping[str, np.ndarray], places: Floats) -> Floats:
    """The level correction through one contact, from landing to lifting."""
    result = np.zeros((stop - start, 3))
    # The ball carries as soon as it is down: a foot rolls about it.
    carrier = ["ball" if "ball" in flags and flags["ball"][f] else "heel" for f in range(start, stop)]
    anchor = places[start, points[carrier[0]]]
    for n, name in enumerate(carrier):
        place = places[start + n, points[name]]
        if n > 0 and name != carrier[n - 1]:
            # where the next point is now, with the correction that the foot has now, it stays
            anchor = place + anchor - places[start + n, points[carrier[n - 1]]]
        result[n] = anchor - place
    return result - result.mean(axis=0)


def _bridged(result: Floats, runs: list[tuple[int, int]]) -> Floats:
    """Corrections between contacts: cubic, with the speed they have at both; before the first and after the last they stay."""
    if not runs:
        return result
    result[: runs[0][0]] = result[runs[0][0]]
    result[runs[-1][1] :] = result[runs[-1][1] - 1]

    def slope(frame: int, other: int) -> Floats:
        return (result[frame] - result[other]) * np.sign(frame - other) if frame != other else np.zeros(3)

    for (before, start), (stop, after) in itertools.pairwise(runs):
        gap = stop - (start - 1)
        u = np.arange(1, gap) / gap
        last = start - 1
        leaving = slope(last, max(last - 1, before))
        landing = slope(min(stop + 1, after - 1), stop)
        result[start:stop] = spline.hermite(
            result[last], leaving, result[stop], landing, u, np.full(len(u), float(gap))
        )
    return result


def _smooth_over(need: Floats, frames: float) -> Floats:
    """A smooth curve (T,) that is never under ``need``."""
    half = max(1, round(frames))
    widest = maximum_filter1d(need, 2 * half + 1, mode="nearest")
    # A mean over no more than the width of the maximum cannot fall under what the maximum covers.
    return uniform_filter1d(uniform_filter1d(widest, half | 1, mode="nearest"), half | 1, mode="nearest")


def _hips_drop(
    roles: Mapping[str, int], places: Floats, corrections: Mapping[str, Floats], rate_hz: float, options: PlantOptions
) -> Floats:
    """How far the hips come down so that both feet are in reach, smooth in time (T, 3)."""
    need = np.zeros(len(places))
    for side in SIDES:
        hip, knee, foot = (places[:, roles[f"{side}_{p}"]] for p in ("upper_leg", "lower_leg", "foot"))
        reach = np.linalg.norm(knee - hip, axis=-1) + np.linalg.norm(foot - knee, axis=-1)
        far = foot + corrections[side] - hip
        limit = (1.0 - 2.0 * options.softness) * reach
        # A leg that was as straight as that before needs no help.
        limit = np.maximum(limit, np.linalg.norm(foot - hip, axis=-1))
        level = np.hypot(far[:, 0], far[:, 2])
        height = np.sqrt(np.clip(limit**2 - level**2, 0.0, None))
        need = np.maximum(need, np.clip(-far[:, 1] - height, 0.0, 0.25 * reach))
    smooth = _smooth_over(need, 0.2 * rate_hz)
    return np.stack([np.zeros_like(smooth), -smooth, np.zeros_like(smooth)], axis=-1)


def _bend_leg(
    side: str,
    roles: Mapping[str, int],
    skeleton: Skeleton,
    turned: Floats,
    places: Floats,
    correction: Floats,
    rotations: Floats,
    options: PlantOptions,
) -> Floats:
    """Turn a leg's joints (in ``rotations``) so that its foot is moved by ``correction``; returns the distance left (T,)."""
    upper, lower, foot = (roles[f"{side}_{part}"] for part in ("upper_leg", "lower_leg", "foot"))
    hip, knee, ankle = places[:, upper], places[:, lower], places[:, foot]
    upper_m, lower_m = (
        float(np.linalg.norm(knee - hip, axis=-1).mean()),
        float(np.linalg.norm(ankle - knee, axis=-1).mean()),
    )
    pole = _pole(hip, knee, ankle, turned[:, upper], _forward(skeleton, upper, lower, foot))
    solved = solve_limb(
        hip,
        ankle + correction,
        pole,
        upper_m=upper_m,
        lower_m=lower_m,
        softness_m=options.softness * (upper_m + lower_m),
    )
    still = np.linalg.norm(correction, axis=-1) < 1e-9
    old_normal = np.cross(ankle - hip, pole)
    turn_upper = rotation_between_frames(knee - hip, old_normal, solved.middle - hip, solved.normal)
    turn_lower = rotation_between_frames(ankle - knee, old_normal, solved.end - solved.middle, solved.normal)
    for turn in (turn_upper, turn_lower):
        turn[still] = (1.0, 0.0, 0.0, 0.0)
    parents = skeleton.parents
    above = int(parents[upper])
    new_upper = quat.multiply(turn_upper, turned[:, upper])
    rotations[:, upper] = new_upper if above < 0 else quat.multiply(quat.conjugate(turned[:, above]), new_upper)
    over_knee = quat.multiply(turn_upper, turned[:, int(parents[lower])])
    rotations[:, lower] = quat.multiply(quat.conjugate(over_knee), quat.multiply(turn_lower, turned[:, lower]))
    over_foot = quat.multiply(turn_lower, turned[:, int(parents[foot])])
    rotations[:, foot] = quat.multiply(quat.conjugate(over_foot), turned[:, foot])
    return np.where(still, 0.0, np.linalg.norm(ankle + correction - solved.end, axis=-1))


def _forward(skeleton: Skeleton, upper: int, lower: int, foot: int) -> Floats:
    """Where the knee bends, in the upper joint's axes: across the leg at rest, forwards."""
    turned, places = (np.asarray(a, np.float64) for a in world_rotations_positions(skeleton, skeleton.rest))
    line = places[foot] - places[upper]
    along = line / max(float(np.linalg.norm(line)), 1e-12)
    bend = places[lower] - places[upper]
    bend = bend - along * float(bend @ along)
    if float(np.linalg.norm(bend)) < 1e-3 * float(np.linalg.norm(line)):
        bend = np.array([0.0, 0.0, 1.0]) - along * float(along[2])
    return quat.rotate(quat.conjugate(turned[upper]), bend / max(float(np.linalg.norm(bend)), 1e-12))


def _pole(hip: Floats, knee: Floats, ankle: Floats, turned: Floats, forward: Floats) -> Floats:
    """Where the knee is, across the leg; a leg that is nearly straight takes the way it bends at rest (T, 3)."""
    line = ankle - hip
    along = line / np.maximum(np.linalg.norm(line, axis=-1, keepdims=True), 1e-12)
    out = (knee - hip) - along * np.sum((knee - hip) * along, axis=-1, keepdims=True)
    bent = np.linalg.norm(out, axis=-1, keepdims=True)
    limit = 0.03 * np.linalg.norm(knee - hip, axis=-1, keepdims=True)
    share = np.clip(1.0 - bent / limit, 0.0, 1.0)
    return out + share * limit * quat.rotate(turned, np.broadcast_to(forward, hip.shape))
