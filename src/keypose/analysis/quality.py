"""The quality of a motion in figures: sliding and sinking feet, floating, jerks and pops, bodies that pass through themselves,
and how well a loop closes. A take can be compared with another frame by frame.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from keypose.analysis.contacts import foot_contacts, foot_points
from keypose.analysis.roles import SIDES, find_roles
from keypose.arrays import Floats
from keypose.errors import ShapeError
from keypose.evaluate import match, match_report, world_rotations_positions
from keypose.math import quat
from keypose.model import Motion, Skeleton

_GRAVITY = 9.81

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


@dataclass(frozen=True, slots=True, eq=False)
class Quality:
    """Figures of one motion; None where the skeleton does not tell (no feet, no humanoid).

    Units:
        skate_cm_s, worst_skate_cm_s: level speed of the carrying point of feet in contact, mean and largest.
        contact_share: share of the frames with a foot on the ground.
        sink_cm, sink_share: deepest place of a foot under the ground; share of frames deeper than 1 cm.
        float_share: share of frames in which both feet are clear of the ground and the body does not fall.
        jerk_m_s3: root mean square jerk of all joints; pops: (frame, joint, times the usual step of acceleration), worst first.
        overlap_cm: how deep two limbs or limb and trunk lie in each other at most, and overlap: which and when.
        loop_cm, loop_deg: between the last and the first frame, root travel taken out, largest joint distance and rotation.
    """

    frames: int
    rate_hz: float
    ground_m: float
    skate_cm_s: float | None
    worst_skate_cm_s: float | None
    contact_share: float | None
    sink_cm: float | None
    sink_share: float | None
    float_share: float | None
    jerk_m_s3: float
    pops: tuple[tuple[int, str, float], ...]
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
        if self.overlap_cm is not None:
            found.append(
                f"limbs overlap {self.overlap_cm:.1f} cm at most{f' ({self.overlap})' if self.overlap else ''}"
            )
        found.append(f"as a loop it jumps {self.loop_cm:.1f} cm and {self.loop_deg:.1f} degrees")
        return found


def measure_quality(
    motion: Motion, skeleton: Skeleton, roles: Mapping[str, int] | None = None, ground_m: float | None = None
) -> Quality:
    """The quality meter.

    ``roles`` are found if not given. ``ground_m`` is the height of the ground; if not given, the lowest height of toes and
    feet, without the lowest two in a hundred frames, less nothing: a joint lies inside the foot.

    Raises:
        ShapeError: where the motion has fewer than two frames.

    Source: foot skate as in Ikemoto et al. (I3D 2006); jerk as the third derivative of joint positions (Flash and Hogan 1985).
    """
    motion = match(motion, skeleton)
    if motion.frame_count < 2:
        raise ShapeError(f"motion '{motion.name}': expected at least 2 frames, got {motion.frame_count}")
    places = np.asarray(world_rotations_positions(skeleton, motion.pose.broadcast())[1], np.float64)
    known = dict(find_roles(skeleton).roles if roles is None else roles)
    feet = _Feet(known, places, motion.rate_hz, ground_m)
    depth, pair = _overlap(known, places)
    jump, turn = _loop(motion, skeleton, known, places)
    rms, pops = _jerks(places, motion.rate_hz, skeleton.names)
    return Quality(
        motion.frame_count, motion.rate_hz, feet.ground, feet.skate, feet.worst, feet.share, feet.sink, feet.sinking,
        feet.floating, rms, pops, depth, pair, jump, turn,
    )  # fmt: skip


class _Feet:
    """What feet do with the ground."""

    def __init__(self, roles: Mapping[str, int], places: Floats, rate_hz: float, ground_m: float | None) -> None:
        points = [roles[f"{s}_{p}"] for s in SIDES for p in ("toes", "foot") if f"{s}_{p}" in roles]
        self.ground = float(places[..., 1].min()) if ground_m is None else ground_m
        self.skate = self.worst = self.share = self.sink = self.sinking = self.floating = None
        if not points or any(f"{s}_{p}" not in roles for s in SIDES for p in ("upper_leg", "lower_leg", "foot")):
            return
        if ground_m is None:
            self.ground = float(np.percentile(places[:, points, 1].min(axis=1), 2.0))
        hip, knee, foot = (places[0, roles[f"left_{p}"]] for p in ("upper_leg", "lower_leg", "foot"))
        leg = float(np.linalg.norm(knee - hip) + np.linalg.norm(foot - knee))
        touching = foot_contacts(roles, places, rate_hz, leg)
        standing = np.any(list(touching.values()), axis=0)
        self.share = float(standing.mean())
        speeds = carried_speeds(roles, places, touching, rate_hz)
        self.skate, self.worst = (float(speeds.mean()), float(speeds.max())) if len(speeds) else (0.0, 0.0)
        under = 100.0 * (self.ground - places[:, points, 1].min(axis=1))
        self.sink, self.sinking = max(0.0, float(under.max())), float((under > 1.0).mean())
        clear = places[:, points, 1].min(axis=1) - self.ground > 0.05 * leg
        self.floating = _floating(places, roles, standing | ~clear, rate_hz)


def carried_speeds(
    roles: Mapping[str, int], places: Floats, touching: Mapping[str, np.ndarray], rate_hz: float
) -> Floats:
    """Level speeds in cm/s (N,) of the points that carry: a foot's ball while it is down, else its heel.

    Only steps that begin and end in contact count; ``touching`` is that of `foot_contacts`.
    """
    found: list[Floats] = []
    none = np.zeros(len(places), bool)
    points = foot_points(roles, places, touching)
    for side in SIDES:
        ball, heel = touching.get(f"{side}_ball", none), touching.get(f"{side}_heel", none)
        for name, flag in ((f"{side}_ball", ball), (f"{side}_heel", heel & ~ball)):
            if name not in points:
                continue
            step = np.diff(points[name], axis=0)[flag[1:] & flag[:-1]]
            found.append(100.0 * rate_hz * np.hypot(step[:, 0], step[:, 2]))
    return np.concatenate(found) if found else np.zeros(0)


def _floating(places: Floats, roles: Mapping[str, int], carried: np.ndarray, rate_hz: float) -> float:
    """Share of the frames in which nothing carries the body and it does not fall either."""
    if len(places) < 5 or "hips" not in roles:
        return 0.0
    trunk = places[:, [roles[r] for r in ("hips", "chest", "spine", "head") if r in roles], 1].mean(axis=1)
    # over a tenth of a second, or the noise of a capture hides what gravity does
    half = max(1, round(0.05 * rate_hz))
    fall = np.zeros(len(trunk))
    fall[half:-half] = (trunk[2 * half :] - 2 * trunk[half:-half] + trunk[: -2 * half]) * (rate_hz / half) ** 2
    inner = np.zeros(len(trunk), bool)
    inner[half:-half] = True
    return float((inner & ~carried & (fall > -0.4 * _GRAVITY)).mean())


def _jerks(places: Floats, rate_hz: float, names: tuple[str, ...]) -> tuple[float, tuple[tuple[int, str, float], ...]]:
    if len(places) < 5:
        return 0.0, ()
    third = np.linalg.norm(np.diff(places, n=3, axis=0), axis=-1)  # (T - 3, J) metres a frame cubed
    rms = float(np.sqrt(np.mean(third**2))) * rate_hz**3
    # A motion made by hand is smooth to nothing: what cannot be seen (half a millimetre) is no measure.
    usual = np.maximum(np.median(third, axis=0), 5e-4)
    ratio = third / usual
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


@dataclass(frozen=True, slots=True)
class TakeDifference:
    """Two takes frame by frame: mean and largest joint distance (cm), mean and largest angle of local rotations (degrees),
    and L2P / L2Q, the norms used to compare in-betweens (Harvey et al., SIGGRAPH 2020).
    """

    frames: int
    mean_cm: float
    worst_cm: float
    mean_deg: float
    worst_deg: float
    l2p: float
    l2q: float

    def lines(self) -> list[str]:
        """The figures as short lines for people."""
        return [
            f"joints differ {self.mean_cm:.2f} cm on average, {self.worst_cm:.2f} at most",
            f"rotations differ {self.mean_deg:.2f} degrees on average, {self.worst_deg:.2f} at most",
            f"L2P {self.l2p:.4f} m, L2Q {self.l2q:.4f} over {self.frames} frames",
        ]


def compare_takes(first: Motion, second: Motion, skeleton: Skeleton) -> TakeDifference:
    """Two motions of one skeleton, over the frames that both have.

    Raises:
        ShapeError: where their rates differ, or most joints of one have no namesake in the skeleton.
    """
    if abs(first.rate_hz - second.rate_hz) > 1e-6 * first.rate_hz:
        raise ShapeError(f"rates differ: {first.rate_hz:g} and {second.rate_hz:g} Hz; resample one of them")
    for motion in (first, second):
        found = match_report(motion, skeleton)
        if len(found.sources) * 2 < len(found.sources) + len(found.unused):
            raise ShapeError(
                f"only {len(found.sources)} of the {len(motion.joint_names)} joints of '{motion.name}' have a namesake in the "
                "skeleton; takes of different skeletons cannot be compared (retarget one of them)"
            )
    a, b = match(first, skeleton), match(second, skeleton)
    frames = min(a.frame_count, b.frame_count)
    if frames == 0:
        raise ShapeError("a motion has no frames")
    sides = [
        [np.asarray(x, np.float64)[:frames] for x in world_rotations_positions(skeleton, m.pose.broadcast())]
        for m in (a, b)
    ]
    apart = np.linalg.norm(sides[0][1] - sides[1][1], axis=-1)
    locals_ = [np.asarray(m.pose.broadcast().rotations, np.float64)[:frames] for m in (a, b)]
    angle = np.degrees(quat.angle_between(*locals_))
    p, q = sides[0][1], sides[1][1]
    u, v = sides[0][0], sides[1][0]
    v = np.where(np.sum(u * v, axis=-1, keepdims=True) < 0, -v, v)
    return TakeDifference(
        frames,
        100.0 * float(apart.mean()),
        100.0 * float(apart.max()),
        float(angle.mean()),
        float(angle.max()),
        float(np.mean(np.sqrt(np.sum((p - q) ** 2, axis=(1, 2))))),
        float(np.mean(np.sqrt(np.sum((u - v) ** 2, axis=(1, 2))))),
    )
