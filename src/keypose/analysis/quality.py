"""The quality of a motion in figures: sliding and sinking feet, floating, jerks and pops, joints beyond their limits, bodies that
pass through themselves, and how well a loop closes.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from keypose.analysis.ground import Ground
from keypose.analysis.limits import human_limits
from keypose.analysis.quality_feet import FeetTracks, carried_speeds, follow_feet
from keypose.analysis.quality_takes import TakeDifference, compare_takes
from keypose.analysis.roles import SIDES, RoleMap, find_roles, joints_by_role
from keypose.arrays import Floats, finite
from keypose.errors import ShapeError
from keypose.evaluate import match, world_rotations_positions
from keypose.ik.limits import find_limit_breaks
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton

__all__ = [
    "Quality",
    "QualityTracks",
    "TakeDifference",
    "carried_speeds",
    "compare_takes",
    "measure_quality",
    "quality_tracks",
]

# Radii of the body's capsules as shares of its height (rounded from anthropometric breadths).
_CAPSULES: tuple[tuple[str, str, float], ...] = (
    ("spine", "neck", 0.075),
    ("neck", "head", 0.045),
    *(
        (f"{side}_{a}", f"{side}_{b}", radius)
        for side in SIDES
        for a, b, radius in (
            ("upper_arm", "lower_arm", 0.024),
            ("lower_arm", "hand", 0.019),
            ("upper_leg", "lower_leg", 0.040),
            ("lower_leg", "foot", 0.027),
        )
    ),
)

# A step of acceleration so many times the usual one is a pop.
_POP = 12.0

_LIMIT_TOLERANCE = np.radians(5.0)  # limits are those of people in general
_NEEDED_FOR_LIMITS = ("hips", *(f"{s}_{p}" for s in SIDES for p in ("upper_leg", "lower_leg", "foot", "upper_arm")))


@dataclass(frozen=True, slots=True, eq=False)
class Quality:
    """Figures of one motion; None where the skeleton does not tell (no feet, no humanoid).

    Units:
        ground_m, ground: height of the ground under the first frame, and its shape in words.
        skate_cm_s, worst_skate_cm_s: level speed of the carrying point of feet in contact, mean and largest.
        contact_share: share of the frames with a foot on the ground.
        sink_cm, sink_share: deepest place of a foot under the ground; share of frames deeper than 1 cm.
        float_share: share of frames in which both feet are clear of the ground and the body does not fall.
        jerk_m_s3: root mean square jerk of all joints; pops: (frame, joint, times the usual step of acceleration), worst first.
        limit_deg: how far a joint turns beyond what joints of people do, at most; limit_breaks: (joint, degrees, frame, share of
            the frames) of each that does by more than 5 degrees, worst first.
        overlap_cm: how deep two limbs or limb and trunk lie in each other at most, and overlap: which and when.
        loop_cm, loop_deg: between the last and the first frame, root travel taken out, largest joint distance and rotation.
    """

    frames: int
    rate_hz: float
    ground_m: float
    ground: str
    skate_cm_s: float | None
    worst_skate_cm_s: float | None
    contact_share: float | None
    sink_cm: float | None
    sink_share: float | None
    float_share: float | None
    jerk_m_s3: float
    pops: tuple[tuple[int, str, float], ...]
    limit_deg: float | None
    limit_breaks: tuple[tuple[str, float, int, float], ...]
    overlap_cm: float | None
    overlap: str
    loop_cm: float
    loop_deg: float

    def lines(self) -> list[str]:
        """The figures as short lines for people."""
        found: list[str] = []
        if self.skate_cm_s is not None and self.worst_skate_cm_s is not None and self.contact_share is not None:
            found.append(
                f"feet in contact slide {self.skate_cm_s:.1f} cm/s on average, {self.worst_skate_cm_s:.1f} at most; "
                f"a foot stands in {self.contact_share:.0%} of the frames"
            )
        if self.sink_cm is not None and self.sink_share is not None:
            found.append(
                f"feet sink {self.sink_cm:.1f} cm at most, deeper than 1 cm in {self.sink_share:.0%} of the frames"
            )
        if self.float_share is not None:
            found.append(f"the body floats in {self.float_share:.0%} of the frames")
        found.append(f"jerk {self.jerk_m_s3:.0f} m/s3 (root mean square)")
        for frame, joint, times in self.pops[:3]:
            found.append(f"pop at frame {frame}: {joint}, {times:.0f} times the usual step of acceleration")
        for joint, degrees, frame, share in self.limit_breaks[:3]:
            found.append(
                f"{joint} turns {degrees:.0f} degrees beyond its limit at frame {frame} ({share:.0%} of the frames)"
            )
        if self.overlap_cm is not None:
            found.append(
                f"limbs overlap {self.overlap_cm:.1f} cm at most{f' ({self.overlap})' if self.overlap else ''}"
            )
        found.append(f"as a loop it jumps {self.loop_cm:.1f} cm and {self.loop_deg:.1f} degrees")
        return found


@dataclass(frozen=True, slots=True, eq=False)
class QualityTracks:
    """What `Quality` sums up, frame by frame.

    Shapes and units: ``feet`` (None without two legs); ``jerk_m_s3`` (T,) root mean square over joints; ``pop`` (T,) the largest
    step of acceleration of a joint, times its usual one.
    """

    rate_hz: float
    start_s: float
    feet: FeetTracks | None
    jerk_m_s3: Floats
    pop: Floats


def measure_quality(
    motion: Motion,
    skeleton: Skeleton,
    roles: RoleMap | Mapping[str, int] | None = None,
    ground_m: float | None = None,
    *,
    ground: Ground | None = None,
    touching: Mapping[str, np.ndarray] | None = None,
    stand: Pose | None = None,
) -> Quality:
    """The quality meter.

    ``roles`` are found if not given. ``ground_m`` is the height of a level ground, ``ground`` any; if not given, it is where feet
    stand: see `find_footing` (a joint lies inside the foot: how high it stands over a known ground is looked at, too).
    ``touching``: contacts as `foot_contacts` has them, if they are known. ``stand``: an upright pose (no batch), where the rest
    pose is none, for the limits of joints.

    Raises:
        ShapeError: where the motion has fewer than two frames, or a joint is at no place.

    Source: foot skate as in Ikemoto et al. (I3D 2006); jerk as the third derivative of joint positions (Flash and Hogan 1985).
    """
    motion = _matched(motion, skeleton)
    places = np.asarray(world_rotations_positions(skeleton, motion.pose.broadcast())[1], np.float64)
    finite(places, "places of the motion's joints")
    known, legs, four = _roles_of(skeleton, roles)
    asked = Ground(ground_m) if ground is None and ground_m is not None else ground
    feet = follow_feet(legs, places, motion.rate_hz, ground=asked, touching=touching)
    skate = worst = share = sink = sinking = floating = None
    low, words = float(places[..., 1].min()) if ground_m is None else ground_m, ""
    if feet is not None:
        low = float(feet.footing.ground.heights(places[:1, legs["left_foot"]])[0])
        words = feet.footing.ground.describe()
        speeds = np.concatenate(list(feet.slide_cm_s.values()))
        speeds = speeds[np.isfinite(speeds)]
        skate, worst = (float(speeds.mean()), float(speeds.max())) if len(speeds) else (0.0, 0.0)
        share = float(np.any(list(feet.footing.touching.values()), axis=0).mean())
        sink, sinking = float(feet.sink_cm.max()), float((feet.sink_cm > 1.0).mean())
        floating = float(feet.floats.mean())
    depth, pair = (None, "") if four else _overlap(known, places)
    jump, turn = _loop(motion, skeleton, known, places)
    rms, pops = _pops(_third_differences(places), motion.rate_hz, skeleton.names)
    beyond, breaks = (None, ()) if four else _limit_breaks(motion, skeleton, known, stand)
    return Quality(
        motion.frame_count, motion.rate_hz, low, words, skate, worst, share, sink, sinking, floating, rms, pops,
        beyond, breaks, depth, pair, jump, turn,
    )  # fmt: skip


def quality_tracks(
    motion: Motion,
    skeleton: Skeleton,
    roles: RoleMap | Mapping[str, int] | None = None,
    *,
    ground: Ground | None = None,
    touching: Mapping[str, np.ndarray] | None = None,
) -> QualityTracks:
    """What feet and jerks do frame by frame, with the arguments and errors of `measure_quality`."""
    motion = _matched(motion, skeleton)
    places = np.asarray(world_rotations_positions(skeleton, motion.pose.broadcast())[1], np.float64)
    feet = follow_feet(_roles_of(skeleton, roles)[1], places, motion.rate_hz, ground=ground, touching=touching)
    third = _third_differences(places)
    jerk, pop = np.zeros(motion.frame_count), np.zeros(motion.frame_count)
    if len(third):
        jerk[2:-1] = np.sqrt(np.mean(third**2, axis=1)) * motion.rate_hz**3
        pop[2:-1] = (third / _usual(third)).max(axis=1)
    return QualityTracks(motion.rate_hz, motion.start_s, feet, jerk, pop)


def _roles_of(
    skeleton: Skeleton, roles: RoleMap | Mapping[str, int] | None
) -> tuple[dict[str, int], dict[str, int], bool]:
    """Roles, roles as of feet that stand on the ground, and whether the body goes on all fours.

    An animal that stands on its toes has its feet, as roles go, in the air.
    """
    found = find_roles(skeleton) if roles is None else roles
    four = isinstance(found, RoleMap) and found.on_all_fours
    known = joints_by_role(found, skeleton)
    legs = {
        role: known.get(role.replace("_foot", "_toes"), joint) if role.endswith("_foot") else joint
        for role, joint in known.items()
        if not role.endswith("_toes")
    }
    return known, legs if four else known, four


def _matched(motion: Motion, skeleton: Skeleton) -> Motion:
    motion = match(motion, skeleton)
    if motion.frame_count < 2:
        raise ShapeError(f"motion '{motion.name}': expected at least 2 frames, got {motion.frame_count}")
    return motion


def _limit_breaks(
    motion: Motion, skeleton: Skeleton, roles: Mapping[str, int], stand: Pose | None
) -> tuple[float | None, tuple[tuple[str, float, int, float], ...]]:
    """By how much joints turn beyond their limits at most, in degrees, and which; None for what is no humanoid."""
    if any(role not in roles for role in _NEEDED_FOR_LIMITS):
        return None, ()
    limits = human_limits(skeleton, roles, stand)
    found = find_limit_breaks(motion, skeleton, limits, _LIMIT_TOLERANCE)
    rows = tuple((b.joint, float(np.degrees(b.worst_rad)), b.frame, b.share) for b in found)
    return max((row[1] for row in rows), default=0.0), rows


def _third_differences(places: Floats) -> Floats:
    """Lengths (T - 3, J), metres a frame cubed; none for fewer than five frames."""
    if len(places) < 5:
        return np.zeros((0, places.shape[1]))
    third = np.diff(places, n=3, axis=0)
    return np.sqrt(np.einsum("...i,...i", third, third))


def _usual(third: Floats) -> Floats:
    # A motion made by hand is smooth to nothing: what cannot be seen (half a millimetre) is no measure.
    return np.maximum(np.median(third, axis=0), 5e-4)


def _pops(third: Floats, rate_hz: float, names: tuple[str, ...]) -> tuple[float, tuple[tuple[int, str, float], ...]]:
    if not len(third):
        return 0.0, ()
    rms = float(np.sqrt(np.mean(third**2))) * rate_hz**3
    ratio = third / _usual(third)
    pops: list[tuple[int, str, float]] = []
    for at in np.argsort(ratio.max(axis=1))[::-1]:
        joint = int(np.argmax(ratio[at]))
        if ratio[at, joint] < _POP or len(pops) == 8:
            break
        if all(abs(at + 2 - frame) > 4 for frame, _, _ in pops):
            pops.append((int(at) + 2, names[joint], float(ratio[at, joint])))
    return rms, tuple(pops)


def _overlap(roles: Mapping[str, int], places: Floats) -> tuple[float | None, str]:
    capsules = [(a, b, r) for a, b, r in _CAPSULES if a in roles and b in roles]
    if len(capsules) < 4 or "head" not in roles:
        return None, ""
    feet = [roles[f"{s}_foot"] for s in SIDES if f"{s}_foot" in roles]
    size = float(np.linalg.norm(places[0, roles["head"]] - places[0, feet].mean(axis=0))) * 1.1 if feet else 1.7
    deepest, words = 0.0, ""
    for (a0, a1, ra), (b0, b1, rb) in itertools.combinations(capsules, 2):
        if len({a0, a1, b0, b1}) < 4 or _neighbours(a0, b0):
            continue
        apart = _segments_apart(*(places[:, roles[n]] for n in (a0, a1, b0, b1)))
        depth = (ra + rb) * size - apart
        frame = int(np.argmax(depth))
        if depth[frame] > deepest:
            deepest, words = float(depth[frame]), f"{a0.replace('_', ' ')} and {b0.replace('_', ' ')}, frame {frame}"
    return 100.0 * deepest, words


def _neighbours(a: str, b: str) -> bool:
    """Limbs that begin at the trunk lie in it a little on every body; so do the two thighs at the hips."""
    pair = {a.removeprefix("left_").removeprefix("right_"), b.removeprefix("left_").removeprefix("right_")}
    return pair in ({"spine", "upper_arm"}, {"spine", "upper_leg"}, {"upper_leg"}, {"neck", "upper_arm"})


def _segments_apart(p: Floats, p1: Floats, q: Floats, q1: Floats) -> Floats:
    """Distances (T,) between segments p-p1 and q-q1, each (T, 3).

    Source: C. Ericson, Real-Time Collision Detection (2005), 5.1.9.
    """
    d1, d2, r = p1 - p, q1 - q, p - q
    a, e = np.maximum(np.sum(d1 * d1, -1), 1e-18), np.maximum(np.sum(d2 * d2, -1), 1e-18)
    b, c, f = np.sum(d1 * d2, -1), np.sum(d1 * r, -1), np.sum(d2 * r, -1)
    det = a * e - b * b
    s = np.where(det > 1e-12 * a * e, np.clip((b * f - c * e) / np.where(det > 0, det, 1.0), 0.0, 1.0), 0.0)
    t = (b * s + f) / e
    s = np.where(t < 0, np.clip(-c / a, 0.0, 1.0), np.where(t > 1, np.clip((b - c) / a, 0.0, 1.0), s))
    t = np.clip(t, 0.0, 1.0)
    return np.linalg.norm((p + s[:, None] * d1) - (q + t[:, None] * d2), axis=-1)


def _loop(motion: Motion, skeleton: Skeleton, roles: Mapping[str, int], places: Floats) -> tuple[float, float]:
    """How far the last frame is from the first, with the root's way along the ground and its turn taken out."""
    root = roles.get("hips", 0)
    turned = np.asarray(world_rotations_positions(skeleton, motion.pose.broadcast())[0], np.float64)[[0, -1]]
    ends = places[[0, -1]] - places[[0, -1]][:, root : root + 1] * np.array([1.0, 0.0, 1.0])
    change = quat.multiply(turned[0, root], quat.conjugate(turned[1, root]))
    heading = quat.swing_twist(change, np.array([0.0, 1.0, 0.0]))[1]
    back = quat.rotate(np.broadcast_to(heading, (*ends[1].shape[:-1], 4)), ends[1])
    local = np.asarray(motion.pose.broadcast().rotations, np.float64)
    inner = [j for j in range(len(skeleton.names)) if j != root]
    angle = quat.angle_between(local[0, inner], local[-1, inner]) if inner else np.zeros(1)
    return 100.0 * float(np.linalg.norm(back - ends[0], axis=-1).max()), float(np.degrees(np.max(angle)))
