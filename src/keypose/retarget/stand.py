"""Upright stands: the reference poses out of which motions turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from keypose.analysis.roles import SIDES, stands_on_all_fours
from keypose.arrays import Floats
from keypose.errors import ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton

# A reference pose whose trunk or legs lean further than this is no stand.
_LEAN_LIMIT = np.radians(35.0)

# A rest pose that is turned upright by less does not lie: it was saved in the middle of a motion.
_LYING = np.radians(45.0)

# Frames that lean no further than the most upright one and this are looked at for a stand.
_LEAN_MORE = np.radians(12.0)

# No part of a frame with spread arms may be further from that than this.
_SPREAD_LIMIT = np.radians(15.0)

_UP = np.array([0.0, 1.0, 0.0])
_DOWN = -_UP


def find_stand(skeleton: Skeleton, roles: Mapping[str, int], motion: Motion | None = None) -> tuple[Pose | None, str]:
    """An upright stand of a skeleton, and in words where it is not its rest pose (then None and nothing).

    A rest pose that lies or stands on its head is turned upright as a whole. Where even that is no stand, or the rest pose only
    leans and a motion is upright somewhere, a frame of the motion is taken that stands upright with its arms spread, as many
    begin; else the mean of the upright frames, facing +Z, with straight legs and the feet as they stand.
    """
    rest = skeleton.rest
    places = np.asarray(world_rotations_positions(skeleton, rest)[1], np.float64)
    if is_stand(places, roles):
        return None, ""
    upright = raised(skeleton, rest, roles)
    if upright is not None and _lies(places, roles):
        return upright, "the rest pose lies; it was turned upright"
    shown = None
    if motion is not None and motion.frame_count:
        shown = np.asarray(world_rotations_positions(skeleton, motion.pose.broadcast())[1], np.float64)
    if upright is not None and (shown is None or float(lean(shown, roles).min()) >= _LEAN_LIMIT):
        return upright, "the rest pose leans; it was turned upright"
    if motion is None or shown is None:
        return None, "the rest pose is no upright stand; name a reference pose"
    frame = _spread_frame(shown, roles)
    if frame is not None:
        pose = motion.pose.broadcast()
        note = f"the rest pose is no upright stand; frame {frame} of the motion stands with its arms spread and is taken for one"
        return Pose(pose.translations[frame], pose.rotations[frame], pose.scales[frame]), note
    pose, used = _mean_stand(skeleton, roles, motion)
    return pose, f"the rest pose is no upright stand; the mean of {used} upright frames is taken for one"


def pose_of_other(skeleton: Skeleton, other: Skeleton, pose: Pose) -> Pose:
    """A pose of another skeleton of the same rig (no batch) by the names of joints, which turn in the model's space as there.

    Files of one rig may have another root or lack some joints: those keep their rest beside their parent. Joints are told by
    names without a prefix that ends in a colon, in any case.

    Raises:
        ShapeError: where not even half of the joints are found.
    """
    known = {_plain(name): j for j, name in enumerate(other.names)}
    found = [known.get(_plain(name)) for name in skeleton.names]
    if sum(j is not None for j in found) * 2 < skeleton.joint_count:
        raise ShapeError(
            "reference pose: its skeleton is of another rig; not even half of the joints have the same names"
        )
    there = np.asarray(world_rotations_positions(other, pose)[0], np.float64)
    rest = np.asarray(skeleton.rest.rotations, np.float64)
    turned, local = np.empty_like(rest), np.array(rest)
    for joint, (parent, same) in enumerate(zip(skeleton.parents, found, strict=True)):
        above = turned[int(parent)] if parent >= 0 else np.array([1.0, 0.0, 0.0, 0.0])
        if same is not None:
            local[joint] = quat.multiply(quat.conjugate(above), there[same])
        turned[joint] = quat.multiply(above, local[joint])
    return Pose(skeleton.rest.translations, quat.normalize(local), skeleton.rest.scales)


def _plain(name: str) -> str:
    return name.rpartition(":")[2].lower()


def lean(places: Floats, roles: Mapping[str, int]) -> Floats:
    """How far trunk and legs are from upright (...), radians; pi where they cannot be told. ``places`` (..., J, 3)."""
    worst = np.zeros(places.shape[:-2])
    for low, high in (("hips", "head"), *((f"{s}_foot", f"{s}_upper_leg") for s in SIDES)):
        if low not in roles or high not in roles:
            return np.full(places.shape[:-2], np.pi)
        up = places[..., roles[high], :] - places[..., roles[low], :]
        length = np.linalg.norm(up, axis=-1)
        cosine = np.clip(up[..., 1] / np.maximum(length, 1e-12), -1.0, 1.0)
        worst = np.maximum(worst, np.where(length < 1e-9, np.pi, np.arccos(cosine)))
    return worst


def leftward(places: Floats, roles: Mapping[str, int]) -> Floats:
    """Level directions from right to left by hips and shoulders, not normalised (..., 3)."""
    left = np.zeros((*places.shape[:-2], 3))
    for part in ("upper_leg", "upper_arm"):
        if f"left_{part}" in roles and f"right_{part}" in roles:
            left += places[..., roles[f"left_{part}"], :] - places[..., roles[f"right_{part}"], :]
    left[..., 1] = 0.0
    return left


def standing_feet(places: Floats, roles: Mapping[str, int]) -> tuple[float, float | None]:
    """Heights of ankle and of toe joint of a foot that stands: the lowest that both feet have in a motion (T, J, 3).

    The lowest two in a hundred frames are left out; the toes' height is None where no foot has any.
    """

    def lowest(part: str) -> float | None:
        joints = [roles[f"{side}_{part}"] for side in SIDES if f"{side}_{part}" in roles]
        return float(np.percentile(places[:, joints, 1], 2.0, axis=0).min()) if joints else None

    ankle = lowest("foot")
    return 0.0 if ankle is None else ankle, lowest("toes")


def is_stand(places: Floats, roles: Mapping[str, int]) -> bool:
    """Whether a body stands at joints' places (J, 3): upright on two feet, or on all fours."""
    return bool(lean(places, roles) < _LEAN_LIMIT) or stands_on_all_fours(places, roles)


def raised(skeleton: Skeleton, pose: Pose, roles: Mapping[str, int]) -> Pose | None:
    """A pose turned as a whole so that it stands and looks along +Z; None where it is no stand even then."""
    places = np.asarray(world_rotations_positions(skeleton, pose)[1], np.float64)
    turn = _upright(places, roles)
    if turn is None:
        return None
    if lean(quat.rotate(np.broadcast_to(turn, (len(places), 4)), places), roles) >= _LEAN_LIMIT:
        return None
    translations, rotations = np.array(pose.translations, np.float64), np.array(pose.rotations, np.float64)
    for root in np.nonzero(skeleton.parents < 0)[0]:
        translations[root] = quat.rotate(turn, translations[root])
        rotations[root] = quat.multiply(turn, rotations[root])
    return Pose(translations, rotations, pose.scales)


def _lies(places: Floats, roles: Mapping[str, int]) -> bool:
    """Whether a body at joints' places (J, 3) has to be tipped far to stand, as files with another axis up have it."""
    turn = _upright(places, roles)
    return turn is not None and float(quat.rotate(turn, _UP)[1]) < np.cos(_LYING)


def _upright(places: Floats, roles: Mapping[str, int]) -> Floats | None:
    """The turn that sets a body on its feet, facing +Z."""
    feet = np.mean([places[roles[f"{s}_foot"]] for s in SIDES], axis=0)
    up = places[roles["head"]] - feet if "head" in roles else places[roles["hips"]] - feet
    left = places[roles["left_upper_leg"]] - places[roles["right_upper_leg"]]
    if float(np.linalg.norm(up)) < 1e-9 or float(np.linalg.norm(left)) < 1e-9:
        return None
    up = up / np.linalg.norm(up)
    left = left - up * float(left @ up)
    left = left / max(float(np.linalg.norm(left)), 1e-12)
    axes = np.stack([left, up, np.cross(left, up)])
    # Files lie along an axis; how a head leans over its feet must not turn the whole body by some degrees.
    whole = np.rint(axes)
    if np.abs(axes - whole).max() < 0.3 and abs(float(np.linalg.det(whole)) - 1.0) < 1e-9:
        axes = whole
    return quat.conjugate(quat.from_axes(*axes))


def _spread_frame(places: Floats, roles: Mapping[str, int]) -> int | None:
    """The frame of (T, J, 3) that is most of a T or A pose: straight legs and arms, arms to the sides; None where none is."""
    ends = [
        f"{side}_{part}"
        for side in SIDES
        for part in ("upper_arm", "lower_arm", "hand", "upper_leg", "lower_leg", "foot")
    ]
    if any(role not in roles for role in (*ends, "hips", "head")):
        return None

    def way(low: str, high: str) -> Floats:
        bone = places[:, roles[high]] - places[:, roles[low]]
        return bone / np.maximum(np.linalg.norm(bone, axis=-1, keepdims=True), 1e-12)

    left = leftward(places, roles)
    left = left / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), 1e-12)
    worst = lean(places, roles)
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        for low, high in (("upper_leg", "lower_leg"), ("lower_leg", "foot")):
            worst = np.maximum(worst, np.arccos(np.clip(-way(f"{side}_{low}", f"{side}_{high}")[:, 1], -1.0, 1.0)))
        arm, fore = way(f"{side}_upper_arm", f"{side}_lower_arm"), way(f"{side}_lower_arm", f"{side}_hand")
        worst = np.maximum(worst, np.arccos(np.clip(np.sum(arm * fore, axis=-1), -1.0, 1.0)))
        aside = np.sum(arm * sign * left, axis=-1)
        ahead = np.abs(np.sum(arm * np.cross(left, _UP), axis=-1))
        worst = np.where(
            (aside > 0.6) & (arm[:, 1] < 0.3), np.maximum(worst, np.arcsin(np.clip(ahead, 0.0, 1.0))), np.pi
        )
    frame = int(np.argmin(worst))
    return frame if float(worst[frame]) < _SPREAD_LIMIT else None


# --- a stand out of a motion ------------------------------------------------------------------------------------------


def _mean_stand(skeleton: Skeleton, roles: Mapping[str, int], motion: Motion) -> tuple[Pose, int]:
    """The mean of a motion's upright frames, without their heading, on straight legs; and how many frames that were."""
    pose = motion.pose.broadcast()
    step = max(1, motion.frame_count // 400)
    turned, places = (np.asarray(a, np.float64)[::step] for a in world_rotations_positions(skeleton, pose))
    leaning = lean(places, roles)
    chosen = np.flatnonzero(leaning <= float(leaning.min()) + _LEAN_MORE)
    left = leftward(places[chosen], roles)
    heading = np.arctan2(-left[:, 2], left[:, 0])
    unturn = quat.from_axis_angle(_UP, -heading)[:, None]
    mean = quat.average(np.moveaxis(quat.multiply(unturn, turned[chosen]), 0, -2))
    stand = _Standing(skeleton, pose, int(chosen[0]) * step, mean)
    ankle, toes = standing_feet(places, roles)
    # Who runs leans forward, and holds the head against it; the head keeps its gaze.
    stand.point(roles["hips"], roles.get("neck", roles["head"]), _UP, keep=roles["head"])
    for side in SIDES:
        upper, lower, foot = (roles.get(f"{side}_{part}") for part in ("upper_leg", "lower_leg", "foot"))
        if upper is not None and lower is not None and foot is not None:
            stand.point(upper, lower, _DOWN)
            stand.point(lower, foot, _DOWN)
            if toes is not None and f"{side}_toes" in roles:
                stand.slope(foot, roles[f"{side}_toes"], toes - ankle)
        arm, fore, hand = (roles.get(f"{side}_{part}") for part in ("upper_arm", "lower_arm", "hand"))
        if arm is not None and fore is not None and hand is not None:
            stand.point(fore, hand, stand.places[fore] - stand.places[arm])
    return stand.pose(ankle, [roles[f"{side}_foot"] for side in SIDES]), len(chosen)


class _Standing:
    """A pose in the model's space whose bones are set one after the other."""

    def __init__(self, skeleton: Skeleton, pose: Pose, frame: int, rotations: Floats) -> None:
        self.skeleton, self.rotations = skeleton, np.array(rotations, np.float64)
        self.translations = np.array(pose.translations[frame], np.float64)
        self.scales = pose.scales[frame]
        self.places = np.zeros_like(self.translations)
        self.place()

    def local(self) -> Floats:
        parents = self.skeleton.parents
        rotations = np.array(self.rotations)
        child = parents >= 0
        rotations[child] = quat.multiply(quat.conjugate(self.rotations[parents[child]]), self.rotations[child])
        return rotations

    def place(self) -> None:
        pose = Pose(self.translations, self.local(), self.scales)
        self.places = np.asarray(world_rotations_positions(self.skeleton, pose)[1], np.float64)

    def below(self, joint: int) -> list[int]:
        found = {joint}
        for child, parent in enumerate(self.skeleton.parents):
            if int(parent) in found:
                found.add(child)
        return sorted(found)

    def turn(self, joint: int, turn: Floats) -> None:
        joints = self.below(joint)
        self.rotations[joints] = quat.multiply(turn, self.rotations[joints])
        self.place()

    def point(self, joint: int, end: int, direction: Floats, keep: int | None = None) -> None:
        """Turn a bone, and all that hangs on it down to ``keep``, into a direction by the shortest way."""
        bone = self.places[end] - self.places[joint]
        length, asked = float(np.linalg.norm(bone)), float(np.linalg.norm(direction))
        if length > 1e-9 and asked > 1e-9:
            turn = quat.from_two_vectors(bone / length, direction / asked)
            self.turn(joint, turn)
            if keep is not None:
                self.turn(keep, quat.conjugate(turn))

    def slope(self, foot: int, toes: int, rise: float) -> None:
        """Pitch a foot so that its toe joint is ``rise`` metres over its ankle."""
        bone = self.places[toes] - self.places[foot]
        length, level = float(np.linalg.norm(bone)), np.array([bone[0], 0.0, bone[2]])
        flat = float(np.linalg.norm(level))
        if length > 1e-9 and flat > 1e-9 and abs(rise) < length:
            ahead = level / flat
            self.point(foot, toes, np.sqrt(length**2 - rise**2) * ahead + rise * _UP)

    def pose(self, ankle_m: float, feet: Sequence[int]) -> Pose:
        """The pose with its ankles at a height."""
        lift = ankle_m - float(np.mean(self.places[feet, 1]))
        for root in np.flatnonzero(self.skeleton.parents < 0):
            self.translations[root, 1] += lift
        return Pose(self.translations, quat.normalize(self.local()), self.scales)
