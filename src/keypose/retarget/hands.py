"""Hands that touch the body or a prop in the source do so on the target: places beside each other, kept by the arms.

Bodies differ, so the directions of all bones bring a hand that lay on the hip beside it. What is kept here is where a hand is
beside the nearest parts of the body, in their own frames and scaled like the body, the more the nearer it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from keypose.analysis.contacts import LEG_M
from keypose.analysis.roles import SIDES
from keypose.arrays import Floats
from keypose.editing.planting_paths import smooth_over
from keypose.errors import ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.ik import rotation_between_frames, solve_limb
from keypose.math import quat
from keypose.model import Pose
from keypose.retarget.body import BodyFrames
from keypose.retarget.posing import ankle_floor_m

# Parts of a body that hands touch: the role whose frame counts and the role at the bone's other end.
_TRUNK = ("hips", "neck")
_LEGS = (("upper_leg", "lower_leg"), ("lower_leg", "foot"))
_ARMS = (("upper_arm", "lower_arm"), ("lower_arm", "hand"))

# How near a palm is to the middle of a part when it touches it, and from where on it has nothing to do with it (metres).
_TOUCH = {
    "trunk": (0.17, 0.24), "head": (0.15, 0.22), "leg": (0.10, 0.17), "arm": (0.07, 0.13), "palm": (0.08, 0.16),
    "prop": (0.10, 0.20),
}  # fmt: skip

# So far goes a head above its joint, in metres of a body with a leg of 0.85 m.
_HEAD_M = 0.16

# Seconds that a hand takes to set out for what it touches.
_EASE_S = 0.12

# A palm's middle lies this share of a forearm beyond the wrist where there are no fingers.
_PALM = 0.35


@dataclass(frozen=True, slots=True, eq=False)
class Prop:
    """A place that hands hold on to in the world: of the source, and, if it is another than scaled, of the target.

    Shapes and units: ``source``, ``target`` (3,) or (T, 3) metres.
    """

    source: Floats
    target: Floats | None = None


@dataclass(frozen=True, slots=True, eq=False)
class HandOptions:
    """Which hands keep their place beside body and props.

    Units: ``reach`` 1 for what counts as touching on a grown human (the palm's distance from the middle of trunk, head, legs,
    the other arm and palm, or a prop; it grows with the leg), more for a wider berth; ``softness`` the share of an arm's
    length over which it slows down before it is straight.
    """

    reach: float = 1.0
    softness: float = 0.01
    props: Sequence[Prop] = ()

    def __post_init__(self) -> None:
        if not (self.reach > 0 and np.isfinite(self.reach) and 0 <= self.softness < 0.2):
            raise ShapeError("hand options: expected a reach of more than 0 and a softness from 0 to 0.2")


@dataclass(frozen=True, slots=True, eq=False)
class HeldHands:
    """A pose with hands kept, and how far palms beside something are from where they should be (N,), metres."""

    pose: Pose
    off_m: Floats


def keep_hands(
    own: BodyFrames,
    turned: Floats,
    places: Floats,
    other: BodyFrames,
    pose: Pose,
    options: HandOptions,
    ratio: float,
    rate_hz: float,
) -> HeldHands:
    """The target's pose (T) with hands beside body and props as in the source (T, J, 4), (T, J, 3).

    A hand sets out for what it will touch a little before, and leaves it in the same way.

    ``ratio``: length on the target for a length on the source, of the way in the world.

    Raises:
        ShapeError: where a prop's place has another number of frames.

    Source: after the relation of bodies by the places of their parts in each other's frames, as in Ho, Komura and Tai,
    "Spatial relationship preserving character motion adaptation" (SIGGRAPH 2010); here in closed form for arms alone.
    """
    size = options.reach * own.leg_m / LEG_M
    ease = _EASE_S * rate_hz
    now, where = (np.asarray(a, np.float64) for a in world_rotations_positions(other.skeleton, pose))
    sides = [
        s for s in SIDES if all(f"{s}_{p}" in b.roles for p in ("upper_arm", "lower_arm", "hand") for b in (own, other))
    ]
    body = other.leg_m / own.leg_m
    girth = _shoulders_m(other) / _shoulders_m(own) if sides else body
    palms = {s: (_palm(own, s, turned, places), _palm(other, s, now, where)) for s in sides}
    goals: dict[str, Floats] = {}
    kept: dict[str, Floats] = {}
    for side in sides:
        palm, moved = palms[side]
        pulls: list[tuple[Floats, Floats]] = []  # (weight (T,), way to go (T, 3))
        alone = np.ones(len(places))
        across = next((s for s in sides if s != side), None)
        if across is not None:  # both go half the way to each other
            beside, its = palms[across]
            offset = quat.rotate(_between(own, other, turned, now), palm - beside) * body
            share = _share(np.linalg.norm(palm - beside, axis=-1), "palm", size, ease)
            pulls.append((share, 0.5 * (its + offset - moved)))
            alone = 1.0 - share
        for part, low, high in _parts(side, own, other):
            wide = girth if part == "trunk" else body
            goal, away = _beside(own, turned, places, other, now, where, low, high, palm, wide)
            # an arm whose hand comes along as well is told by that hand
            pulls.append((_share(away, part, size, ease) * (alone if part == "arm" else 1.0), goal - moved))
        for prop in options.props:
            here, there = prop_places(prop, own, places, other, ratio)
            share = _share(np.linalg.norm(palm - here, axis=-1), "prop", size, ease)
            pulls.append((share, there + body * (palm - here) - moved))
        strength, way = _together(pulls)
        kept[side] = strength * _in_reach(other, side, where, way)
        goals[side] = kept[side][:, None] * way
    rotations = np.array(np.asarray(pose.broadcast().rotations, np.float64))
    off: list[Floats] = []
    for side in sides:
        missed = _reach(side, other, now, where, goals[side], rotations, options.softness)
        off.append(missed[kept[side] > 0.9])
    done = Pose(
        pose.translations, quat.align_signs(rotations, axis=0).astype(np.result_type(pose.rotations)), pose.scales
    )
    return HeldHands(done, np.concatenate(off) if off else np.zeros(0))


def _parts(side: str, own: BodyFrames, other: BodyFrames) -> list[tuple[str, str, str]]:
    """Bones that a hand of a side may touch: all but those of its own arm; of the head, which has no end, twice itself."""
    across = next(s for s in SIDES if s != side)
    bones = [("trunk", *_TRUNK), ("head", "head", "head")]
    bones += [("leg", f"{s}_{a}", f"{s}_{b}") for s in SIDES for a, b in _LEGS]
    bones += [("arm", f"{across}_{a}", f"{across}_{b}") for a, b in _ARMS]
    return [bone for bone in bones if all(role in body.roles for role in bone[1:] for body in (own, other))]


def _shoulders_m(body: BodyFrames) -> float:
    """How broad a trunk is: between the upper arms, in the reference pose."""
    ends = [body.places[body.roles[f"{side}_upper_arm"]] for side in SIDES if f"{side}_upper_arm" in body.roles]
    across = float(np.linalg.norm(ends[0] - ends[-1]))
    return across if across > 1e-6 else body.leg_m


def _palm(body: BodyFrames, side: str, turned: Floats, places: Floats) -> Floats:
    """The middle of a palm (T, 3)."""
    hand, arm = body.roles[f"{side}_hand"], body.roles[f"{side}_lower_arm"]
    knuckles = [body.roles[r] for r in (f"{side}_index_proximal", f"{side}_little_proximal") if r in body.roles]
    if knuckles:
        out = 0.6 * (body.places[knuckles].mean(axis=0) - body.places[hand])
    else:
        out = _PALM * (body.places[hand] - body.places[arm])
    local = quat.rotate(quat.conjugate(body.rotations[hand]), out)
    return places[:, hand] + quat.rotate(turned[:, hand], np.broadcast_to(local, places[:, hand].shape))


def _beside(
    own: BodyFrames,
    turned: Floats,
    places: Floats,
    other: BodyFrames,
    now: Floats,
    where: Floats,
    low: str,
    high: str,
    palm: Floats,
    body: float,
) -> tuple[Floats, Floats]:
    """Where a palm goes beside a bone (T, 3), and how far it is from that bone in the source (T,)."""
    frame = quat.multiply(turned[:, own.roles[low]], own.joint_from_frame[low])
    target = quat.multiply(now[:, other.roles[low]], other.joint_from_frame[low])
    (a, b), (c, d) = (
        _ends(of, frames, at, low, high) for of, frames, at in ((own, frame, places), (other, target, where))
    )
    bone = b - a
    u = np.clip(np.sum((palm - a) * bone, axis=-1) / np.maximum(np.sum(bone * bone, axis=-1), 1e-12), 0.0, 1.0)[:, None]
    out = palm - (a + u * bone)
    offset = quat.rotate(quat.multiply(target, quat.conjugate(frame)), out)
    return c + u * (d - c) + body * offset, np.linalg.norm(out, axis=-1)


def _ends(body: BodyFrames, frames: Floats, places: Floats, low: str, high: str) -> tuple[Floats, Floats]:
    start, end = places[:, body.roles[low]], places[:, body.roles[high]]
    if low == high:
        up = np.array([0.0, _HEAD_M * body.leg_m / LEG_M, 0.0])
        end = start + quat.rotate(frames, np.broadcast_to(up, start.shape))
    return start, end


def _between(own: BodyFrames, other: BodyFrames, turned: Floats, now: Floats) -> Floats:
    """The turn from the source's chest to the target's (T, 4)."""
    role = next((r for r in ("upper_chest", "chest", "spine", "hips") if r in own.roles and r in other.roles), "hips")
    frame = quat.multiply(turned[:, own.roles[role]], own.joint_from_frame[role])
    target = quat.multiply(now[:, other.roles[role]], other.joint_from_frame[role])
    return quat.multiply(target, quat.conjugate(frame))


def prop_places(prop: Prop, own: BodyFrames, places: Floats, other: BodyFrames, ratio: float) -> tuple[Floats, Floats]:
    """Where a prop is in the source's world and in the target's (T, 3), by the places (T, J, 3) of the source's joints.

    What is the same prop scaled is as high over the ground that both walk on, whatever height their reference poses have.

    Raises:
        ShapeError: where the prop has another number of frames, or is at no place.
    """
    frames = len(places)
    found: list[Floats] = []
    for place in (prop.source, prop.target):
        if place is not None:
            array = np.asarray(place, np.float64)
            if array.shape not in ((3,), (frames, 3)) or not np.isfinite(array).all():
                raise ShapeError(f"prop: expected finite places (3,) or ({frames}, 3), got {array.shape}")
            found.append(np.broadcast_to(array, (frames, 3)))
    if len(found) == 1:
        ground = ankle_floor_m(own, places) - own.ankle_m
        found.append(ratio * found[0] + np.array([0.0, other.ground_m - ratio * ground, 0.0]))
    return found[0], found[1]


def _share(away: Floats, part: str, size: float, ease: float) -> Floats:
    """1 when a palm touches a part, 0 when it is far away, smooth in space and in time (T,)."""
    near, far = (size * limit for limit in _TOUCH[part])
    u = np.clip((far - away) / (far - near), 0.0, 1.0)
    return smooth_over(u * u * (3.0 - 2.0 * u), ease)


def _together(pulls: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    """How much is kept at all (T,), and how far all pulls together would move a palm (T, 3); nearer parts count more."""
    weights = np.stack([w for w, _ in pulls])
    ways = np.stack([way for _, way in pulls])
    strength = 1.0 - np.prod(1.0 - weights, axis=0)
    parts = weights**2
    mean = np.sum(parts[..., None] * ways, axis=0) / np.maximum(parts.sum(axis=0), 1e-12)[:, None]
    return strength, mean


def _in_reach(body: BodyFrames, side: str, places: Floats, way: Floats) -> Floats:
    """1 where an arm is long enough, 0 where it is too short by a quarter (T,): hands do not grasp at what is out of reach."""
    start, elbow, wrist = (places[:, body.roles[f"{side}_{part}"]] for part in ("upper_arm", "lower_arm", "hand"))
    arm = np.linalg.norm(elbow - start, axis=-1) + np.linalg.norm(wrist - elbow, axis=-1)
    u = np.clip((1.25 - np.linalg.norm(wrist + way - start, axis=-1) / np.maximum(arm, 1e-12)) / 0.25, 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


def _reach(
    side: str, body: BodyFrames, turned: Floats, places: Floats, way: Floats, rotations: Floats, softness: float
) -> Floats:
    """Turn an arm's joints (in ``rotations``) so that its hand moves by ``way``; returns the distance left (T,)."""
    upper, lower, hand = (body.roles[f"{side}_{part}"] for part in ("upper_arm", "lower_arm", "hand"))
    start, elbow, wrist = places[:, upper], places[:, lower], places[:, hand]
    lengths = [float(np.linalg.norm(b - a, axis=-1).mean()) for a, b in ((start, elbow), (elbow, wrist))]
    along = wrist - start
    pole = (elbow - start) - along * (
        np.sum((elbow - start) * along, axis=-1, keepdims=True)
        / np.maximum(np.sum(along**2, axis=-1, keepdims=True), 1e-12)
    )
    straight = np.linalg.norm(pole, axis=-1, keepdims=True) < 0.01 * sum(lengths)
    back = quat.rotate(turned[:, body.roles["hips"]], _backwards(body, places.shape[0]))
    pole = np.where(straight, pole + 0.01 * sum(lengths) * back, pole)
    solved = solve_limb(
        start, wrist + way, pole, upper_m=lengths[0], lower_m=lengths[1], softness_m=softness * sum(lengths)
    )
    normal = np.cross(along, pole)
    first = rotation_between_frames(elbow - start, normal, solved.middle - start, solved.normal)
    second = rotation_between_frames(wrist - elbow, normal, solved.end - solved.middle, solved.normal)
    still = np.linalg.norm(way, axis=-1) < 1e-9
    for turn in (first, second):
        turn[still] = (1.0, 0.0, 0.0, 0.0)
    parents = body.skeleton.parents
    above = turned[:, int(parents[upper])] if parents[upper] >= 0 else None
    new = quat.multiply(first, turned[:, upper])
    rotations[:, upper] = new if above is None else quat.multiply(quat.conjugate(above), new)
    over_elbow = quat.multiply(first, turned[:, int(parents[lower])])
    rotations[:, lower] = quat.multiply(quat.conjugate(over_elbow), quat.multiply(second, turned[:, lower]))
    over_hand = quat.multiply(second, turned[:, int(parents[hand])])
    rotations[:, hand] = quat.multiply(quat.conjugate(over_hand), turned[:, hand])
    return np.where(still, 0.0, np.linalg.norm(wrist + way - solved.end, axis=-1))


def _backwards(body: BodyFrames, frames: int) -> Floats:
    """Where an elbow points, in the axes of the hips (T, 3)."""
    back = quat.rotate(body.facing, np.array([0.0, 0.0, -1.0]))
    return np.broadcast_to(quat.rotate(quat.conjugate(body.rotations[body.roles["hips"]]), back), (frames, 3))
