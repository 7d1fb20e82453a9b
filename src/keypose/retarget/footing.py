"""What a body stands on: the feet of two-legged ones, all four paws of the others, and when they touch the ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from keypose.analysis.contacts import foot_contacts
from keypose.analysis.ground import true_runs
from keypose.analysis.roles import SIDES
from keypose.arrays import Floats
from keypose.editing.planting import PlantOptions
from keypose.evaluate import world_rotations_positions
from keypose.math import quat
from keypose.model import Pose
from keypose.retarget.body import BodyFrames

# Frames with heel and ball on the ground that are enough to say how a foot stands.
_FEWEST_FLAT = 5

# How fast hips follow the height of the feet that carry them: the width of a Gauss filter in seconds.
_HIPS_FOLLOW_S = 0.15

# Heel and ball are at one height where they differ by no more than this share of the leg.
_SAME_HEIGHT = 0.03

_POINTS = {"heel": "foot", "ball": "toes"}

# Of an animal on all fours the forelegs are legs too.
_FORELEGS = {
    f"{side}_{leg}": f"{side}_{arm}"
    for side in SIDES
    for leg, arm in (("upper_leg", "upper_arm"), ("lower_leg", "lower_arm"), ("foot", "hand"))
}


@dataclass(frozen=True, slots=True, eq=False)
class Footing:
    """One pair of legs of both bodies.

    Shapes and units: ``own``, ``other`` roles as of a pair of human legs -> joint; ``touching`` point -> (T,) bool as of
    `foot_contacts`; ``hind`` whether the hips rest on it.
    """

    own: Mapping[str, int]
    other: Mapping[str, int]
    touching: Mapping[str, np.ndarray]
    hind: bool = True


def footings(
    own: BodyFrames,
    other: BodyFrames,
    places: Floats,
    rate_hz: float,
    options: PlantOptions,
    touching: Mapping[str, np.ndarray] | None = None,
) -> list[Footing]:
    """The pairs of legs that both bodies have, with their contacts in the source's places (T, J, 3).

    ``touching`` has contacts that are known already, as `all_touching` names them.
    """

    def touched(roles: Mapping[str, int], fore: bool = False) -> dict[str, np.ndarray]:
        if touching is not None:
            return {p.replace("_hand", "_heel"): flags for p, flags in touching.items() if p.endswith("_hand") == fore}
        return foot_contacts(roles, places, rate_hz, own.leg_m, height_m=options.height_m, speed_m_s=options.speed_m_s)

    if not own.on_all_fours:
        return [Footing(own.roles, other.roles, touched(own.roles))]
    hind = touched(own.roles)
    toed = any(point.endswith("_ball") for point in hind)  # on toes, then; what plays the foot is in the air
    found = [
        Footing(own.roles, other.roles, {p: flags for p, flags in hind.items() if p.endswith("_ball") or not toed})
    ]
    fore = [
        {"hips": body.roles["hips"]} | {leg: body.roles[arm] for leg, arm in _FORELEGS.items() if arm in body.roles}
        for body in (own, other)
    ]
    if all(leg in roles for roles in fore for leg in _FORELEGS):
        found.append(Footing(fore[0], fore[1], touched(fore[0], fore=True), hind=False))
    return found


def all_touching(footing: Sequence[Footing]) -> dict[str, np.ndarray]:
    """Contacts of all feet; those of forelegs are named ``left_hand`` and ``right_hand``."""
    found: dict[str, np.ndarray] = {}
    for pair in footing:
        for point, flags in pair.touching.items():
            found[point if pair.hind else point.replace("_heel", "_hand")] = flags
    return found


def lengthened(touching: Mapping[str, np.ndarray], now: Mapping[str, np.ndarray], fewest: int) -> dict[str, np.ndarray]:
    """Contacts (T,) with the frames before and after in which the same foot touches the ground ``now``.

    New ones begin only where they last for at least ``fewest`` frames. No contact begins or ends within the first or the last
    step of a motion, where nothing shows that it does.
    """
    found: dict[str, np.ndarray] = {}
    for point, flags in touching.items():
        either = flags | now.get(point, flags)
        side = point.partition("_")[0]
        same = np.any([f for p, f in touching.items() if p.startswith(f"{side}_")], axis=0)
        for start, stop in true_runs(either):
            either[start:stop] = stop - start >= fewest or same[start:stop].any()
        if len(either) > 2:
            either[0] |= either[1]
            either[-1] |= either[-2]
        found[point] = either
    return found


def levelled(own: BodyFrames, turned: Floats, touching: Mapping[str, np.ndarray]) -> BodyFrames:
    """The source with feet that are level where heel and ball stand on the ground, whatever its reference pose says."""
    frames = dict(own.joint_from_frame)
    for side in SIDES:
        if f"{side}_heel" not in touching or f"{side}_ball" not in touching:
            continue
        flat = touching[f"{side}_heel"] & touching[f"{side}_ball"]
        if int(flat.sum()) < _FEWEST_FLAT:
            continue
        for role in (f"{side}_foot", f"{side}_toes"):
            standing = quat.multiply(turned[flat, own.roles[role]], frames[role])
            ahead = quat.rotate(standing, np.broadcast_to([0.0, 0.0, 1.0], (len(standing), 3)))
            rise = float(np.median(np.arcsin(np.clip(ahead[:, 1], -1.0, 1.0))))
            # about the foot's own left: a positive turn lowers the toes
            frames[role] = quat.multiply(frames[role], quat.from_axis_angle(np.array([1.0, 0.0, 0.0]), np.array(rise)))
    return replace(own, joint_from_frame=frames)


def carried_by(other: BodyFrames, pose: Pose, footing: Sequence[Footing]) -> list[Footing]:
    """The footings with contacts of the heel alone, or the ball alone, given to the point that is the lower one on the target.

    How a foot lies in the source is told by the few frames in which it stands; a source that hardly ever stands may take a
    ball for a heel.
    """
    if other.on_all_fours:
        return list(footing)
    places = np.asarray(world_rotations_positions(other.skeleton, pose)[1], np.float64)
    found: list[Footing] = []
    for pair in footing:
        touching = dict(pair.touching)
        for side in SIDES:
            heel, ball = f"{side}_heel", f"{side}_ball"
            if heel not in touching or ball not in touching or f"{side}_toes" not in other.roles:
                continue
            over = [
                places[:, other.roles[role], 1] - other.places[other.roles[role], 1]
                for role in (f"{side}_foot", f"{side}_toes")
            ]
            if int((touching[heel] & touching[ball]).sum()) >= _FEWEST_FLAT:
                continue
            margin = _SAME_HEIGHT * other.leg_m
            swap = (touching[heel] & ~touching[ball] & (over[0] > over[1] + margin)) | (
                touching[ball] & ~touching[heel] & (over[1] > over[0] + margin)
            )
            touching[heel], touching[ball] = touching[heel] ^ swap, touching[ball] ^ swap
        found.append(replace(pair, touching=touching))
    return found


def rise(other: BodyFrames, pose: Pose, footing: Sequence[Footing], rate_hz: float | None) -> Floats:
    """How far the hips have to go up (T,) so that feet in contact are about as high as they stand.

    Smooth in time; without a rate it is the same for all frames.

    Captured feet are some centimetres off their floor, each by its own. Left to the legs alone, knees would bend and stretch
    for that; hips that follow the feet that carry them keep the legs as they are.
    """
    places = np.asarray(world_rotations_positions(other.skeleton, pose)[1], np.float64)
    total, weight = np.zeros(len(places)), np.zeros(len(places))
    for pair in footing:
        for side in SIDES:
            points = [
                np.where(
                    pair.touching[f"{side}_{point}"],
                    other.places[pair.other[f"{side}_{role}"], 1] - places[:, pair.other[f"{side}_{role}"], 1],
                    -np.inf,
                )
                for point, role in _POINTS.items()
                if f"{side}_{role}" in pair.other and f"{side}_{point}" in pair.touching
            ]
            if points:
                under = np.max(points, axis=0)
                carrying = np.isfinite(under)
                total[carrying] += under[carrying]
                weight += carrying
    frames = np.flatnonzero(weight)
    if not len(frames):
        return total
    if rate_hz is None:
        return np.full(len(total), np.median(total[frames] / weight[frames]))
    # Between contacts it goes over in a straight line, and all of it is made smooth.
    curve = np.interp(np.arange(len(total)), frames, total[frames] / weight[frames])
    return gaussian_filter1d(curve, _HIPS_FOLLOW_S * rate_hz, mode="nearest")
