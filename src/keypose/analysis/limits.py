"""How far the joints of a human turn: limits of any skeleton's joints from their roles and places."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from keypose.analysis.roles import FINGERS, SIDES, RoleMap, joints_by_role
from keypose.arrays import Floats
from keypose.errors import ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.ik.limits import Cone, JointLimit
from keypose.math import quat
from keypose.model import Pose, Skeleton


@dataclass(frozen=True, slots=True)
class Range:
    """What a joint does, in degrees: flexion from ``bend[0]`` to ``bend[1]``, aside (towards the body's side, for a foot
    outwards) from ``aside[0]`` to ``aside[1]``, and ``twist`` each way."""

    bend: tuple[float, float]
    aside: tuple[float, float]
    twist: float


# Flexion is forwards for trunk, neck, arms and thighs, backwards for shins, up for feet and toes, into the palm for hands.
# Wider than a textbook's passive range by what mocap skeletons put into one joint: the shoulder blade's share is in the
# arm, pronation of the forearm in elbow or wrist, and the knee's axis is not where a marker set believes it.
RANGES: Mapping[str, Range] = {
    "trunk": Range((-50.0, 100.0), (-60.0, 60.0), 70.0),  # the whole spine; shared out over its joints
    "neck": Range((-75.0, 75.0), (-60.0, 60.0), 95.0),  # neck and head together
    "jaw": Range((-5.0, 40.0), (-15.0, 15.0), 10.0),
    "eye": Range((-40.0, 40.0), (-50.0, 50.0), 15.0),
    "shoulder": Range((-40.0, 45.0), (-25.0, 50.0), 45.0),  # retraction and protraction; down and up
    "lower_arm": Range((-20.0, 160.0), (-45.0, 45.0), 110.0),
    "hand": Range((-85.0, 90.0), (-45.0, 50.0), 100.0),
    "thumb": Range((-50.0, 80.0), (-60.0, 60.0), 60.0),
    "thumb_end": Range((-40.0, 95.0), (-25.0, 25.0), 30.0),
    "proximal": Range((-45.0, 105.0), (-35.0, 35.0), 30.0),
    "intermediate": Range((-25.0, 125.0), (-20.0, 20.0), 25.0),
    "distal": Range((-25.0, 100.0), (-20.0, 20.0), 25.0),
    "upper_leg": Range((-45.0, 140.0), (-50.0, 80.0), 65.0),
    "lower_leg": Range((-15.0, 165.0), (-25.0, 25.0), 45.0),
    "foot": Range((-65.0, 50.0), (-45.0, 45.0), 45.0),
    "toes": Range((-60.0, 90.0), (-25.0, 25.0), 30.0),
}
_ARM_CENTER = (0.65, -0.2, 0.73)  # aside, up, forward: the middle of where an upper arm can point
_ARM_SWING, _ARM_TWIST = 118.0, 130.0
_SPINE = ("spine", "chest", "upper_chest")


def human_limits(
    skeleton: Skeleton, roles: RoleMap | Mapping[str, int], pose: Pose | None = None
) -> dict[str, JointLimit]:
    """Anatomical limits for every joint that plays a limited role: joint name -> `Cone`, about the joint's own axes.

    The axes are found from where the joints are, so any rest pose (T, A, arms down, feet not level) and any orientation of
    the joints' own axes gives the same limits in space. ``pose`` (no batch) is looked at in place of a rest pose that is no
    stand; in it the trunk stands upright. Twist joints and the hips have no limits.

    Raises:
        ShapeError: where the pose or a role does not fit the skeleton.

    Source: American Academy of Orthopaedic Surgeons, "Joint Motion: Method of Measuring and Recording" (1965); C. Norkin
        and D. White, "Measurement of Joint Motion" (5th ed. 2016), appendix A; trunk and neck: A. White and M. Panjabi,
        "Clinical Biomechanics of the Spine" (2nd ed. 1990), tables 2-1 to 2-4.
    """
    joints = joints_by_role(roles, skeleton)
    body = _Body(skeleton, skeleton.rest if pose is None else pose, joints)
    found: dict[str, JointLimit] = {}
    for role, limit in body.limits().items():
        found[skeleton.names[joints[role]]] = limit
    return found


class _Body:
    def __init__(self, skeleton: Skeleton, pose: Pose, roles: dict[str, int]) -> None:
        if pose.batch_shape != () or pose.joint_count != skeleton.joint_count:
            raise ShapeError(
                f"pose: expected one pose of {skeleton.joint_count} joints, got batch {pose.batch_shape} of {pose.joint_count}"
            )
        self.skeleton, self.pose, self.roles = skeleton, pose, roles
        turned, places = world_rotations_positions(skeleton, pose)
        self.turned, self.places = np.asarray(turned, np.float64), np.asarray(places, np.float64)
        self.up, self.left, self.forward = self.axes()

    def axes(self) -> tuple[Floats, Floats, Floats]:
        """Up along the trunk, to the left, forwards."""
        up = np.array([0.0, 1.0, 0.0])
        top = next((r for r in ("head", "neck", *_SPINE[::-1]) if r in self.roles), None)
        if "hips" in self.roles and top is not None:
            up = _direction(self.place(top) - self.place("hips"), up)
        pairs = [
            self.place(f"left_{part}") - self.place(f"right_{part}")
            for part in ("upper_leg", "upper_arm", "shoulder")
            if f"left_{part}" in self.roles and f"right_{part}" in self.roles
        ]
        left = np.sum(pairs, axis=0) if pairs else np.array([1.0, 0.0, 0.0])
        left = _direction(left - up * float(left @ up), np.cross(up, [0.0, 0.0, 1.0]))
        return up, left, np.cross(left, up)

    def place(self, role: str) -> Floats:
        return self.places[self.roles[role]]

    def limits(self) -> dict[str, JointLimit]:
        found: dict[str, JointLimit] = {}
        for parts, whole in ((_SPINE, "trunk"), (("neck", "head"), "neck")):
            known = [part for part in parts if part in self.roles]
            for part in known:
                # A bend is not shared out evenly: each joint may do half as much again.
                share = min(1.0, 1.5 / len(known))
                found[part] = self.limit(part, self.up, self.up, self.left, _scaled(RANGES[whole], share), self.left)
        if "jaw" in self.roles:
            way = self.bone("jaw", self.forward)
            found["jaw"] = self.limit("jaw", way, way, self.left, RANGES["jaw"], self.left)
        for side in SIDES:
            out = self.left if side == "left" else -self.left
            if f"{side}_eye" in self.roles:
                found[f"{side}_eye"] = self.limit(
                    f"{side}_eye", self.forward, self.forward, self.left, RANGES["eye"], out
                )
            found |= self.leg(side, out)
            found |= self.arm(side, out)
        return found

    def leg(self, side: str, out: Floats) -> dict[str, JointLimit]:
        found: dict[str, JointLimit] = {}
        upper, lower, foot, toes = (f"{side}_{part}" for part in ("upper_leg", "lower_leg", "foot", "toes"))
        thigh = self.way(upper, lower, -self.up)
        shin = self.way(lower, foot, thigh)
        if upper in self.roles:
            found[upper] = self.limit(upper, thigh, -self.up, -self.left, RANGES["upper_leg"], out)
        if lower in self.roles:
            # About the thigh's own sideways axis: that of the body, turned as the thigh is from hanging down.
            axis = quat.rotate(quat.from_two_vectors(-self.up, thigh), self.left)
            found[lower] = self.limit(lower, shin, thigh, axis, RANGES["lower_leg"], out)
        ahead = self.way(foot, toes, self.forward)
        for role, part in ((foot, "foot"), (toes, "toes")):
            if role in self.roles:
                found[role] = self.limit(role, ahead, ahead, -self.left, RANGES[part], out)
        return found

    def arm(self, side: str, out: Floats) -> dict[str, JointLimit]:
        found: dict[str, JointLimit] = {}
        collar, upper, lower, hand = (f"{side}_{part}" for part in ("shoulder", "upper_arm", "lower_arm", "hand"))
        way = self.way(upper, lower, out - self.up)
        forearm = self.way(lower, hand, way)
        # T poses, A poses and hanging arms differ by a turn in the plane of the shoulders.
        hung = _direction(out - self.up, out)
        raised = quat.from_two_vectors(hung, way)
        if collar in self.roles:
            bone = self.way(collar, upper, out)
            found[collar] = self.limit(collar, bone, bone, np.cross(bone, self.forward), RANGES["shoulder"], self.up)
        if upper in self.roles:
            aside, up, ahead = _ARM_CENTER
            middle = _direction(aside * out + up * self.up + ahead * self.forward, out)
            turn = quat.multiply(quat.from_two_vectors(hung, middle), quat.conjugate(raised))
            found[upper] = self.cone(upper, way, turn, (_ARM_SWING, _ARM_SWING), _ARM_TWIST, self.up)
        if lower in self.roles:
            axis = quat.rotate(raised, np.cross(hung, self.forward))
            found[lower] = self.limit(lower, forearm, way, axis, RANGES["lower_arm"], self.up)
        if hand in self.roles:
            bone = self.bone(hand, forearm)
            thumbwards = quat.rotate(raised, self.forward)
            if f"{side}_index_proximal" in self.roles and f"{side}_little_proximal" in self.roles:
                thumbwards = self.place(f"{side}_index_proximal") - self.place(f"{side}_little_proximal")
            thumbwards = _direction(thumbwards - bone * float(bone @ thumbwards), self.forward)
            palm = np.cross(bone, thumbwards) * (1.0 if side == "left" else -1.0)
            found[hand] = self.limit(hand, bone, forearm, np.cross(bone, palm), RANGES["hand"], thumbwards)
            found |= self.fingers(side, bone, palm, thumbwards)
        return found

    def fingers(self, side: str, bone: Floats, palm: Floats, thumbwards: Floats) -> dict[str, JointLimit]:
        found: dict[str, JointLimit] = {}
        for finger in FINGERS:
            before = bone
            for part in ("metacarpal", "proximal", "intermediate", "distal"):
                role = f"{side}_{finger}_{part}"
                if role not in self.roles:
                    continue
                way = self.bone(role, before)
                kind = part
                if finger == "thumb":
                    kind = "thumb" if part == "metacarpal" else "thumb_end"
                inwards = _direction(palm - thumbwards, palm) if finger == "thumb" else palm
                found[role] = self.limit(role, way, way, np.cross(way, inwards), RANGES[kind], thumbwards)
                before = way
        return found

    def bone(self, role: str, otherwise: Floats) -> Floats:
        """Where a joint's bone points: to the mean of its children, or to its tip."""
        joint = self.roles[role]
        ends = [self.places[c] for c in self.skeleton.children(joint)]
        for owner, offset in self.skeleton.end_offsets:
            if owner == joint:
                ends.append(self.places[joint] + quat.rotate(self.turned[joint], np.asarray(offset)))
        return _direction(np.mean(ends, axis=0) - self.places[joint], otherwise) if ends else otherwise

    def way(self, low: str, high: str, otherwise: Floats) -> Floats:
        """The direction from one role's joint to the next one's."""
        if low not in self.roles or high not in self.roles:
            return _direction(otherwise, self.up)
        return _direction(self.place(high) - self.place(low), otherwise)

    def limit(self, role: str, way: Floats, neutral: Floats, axis: Floats, span: Range, aside: Floats) -> Cone:
        """The cone of a bone that points ``way`` and would point to ``neutral`` unbent; flexion turns about ``axis``."""
        axis = _direction(axis - neutral * float(axis @ neutral), np.cross(neutral, self.up))
        straight = quat.from_two_vectors(way, neutral)
        # Positive turns about this one go aside.
        other = np.cross(neutral, _direction(aside - neutral * float(aside @ neutral), np.cross(neutral, axis)))
        other = _direction(other - axis * float(other @ axis), np.cross(axis, neutral))
        bend, side = np.radians(span.bend), np.radians(span.aside)
        middle = quat.from_rotation_vector(axis * bend.mean() + other * side.mean())
        turn = quat.multiply(middle, straight)
        swings = 0.5 * (span.bend[1] - span.bend[0]), 0.5 * (span.aside[1] - span.aside[0])
        before = quat.rotate(quat.conjugate(straight), axis)
        return self.cone(role, way, turn, swings, span.twist, before)

    def cone(
        self, role: str, way: Floats, turn: Floats, swings: tuple[float, float], twist: float, across: Floats
    ) -> Cone:
        """A cone about a bone: ``turn`` leads from the pose to its middle, in space; degrees."""
        joint = self.roles[role]
        back = quat.conjugate(self.turned[joint])
        local = quat.multiply(quat.multiply(back, turn), self.turned[joint])
        rest = np.asarray(self.skeleton.rest.rotations, np.float64)[joint]
        posed = np.asarray(self.pose.rotations, np.float64)[joint]
        center = quat.normalize(quat.multiply(quat.multiply(quat.conjugate(rest), posed), local))
        across = _direction(across - way * float(across @ way), np.cross(way, self.forward))
        first, second = np.radians(swings)
        return Cone(
            _vector(quat.rotate(back, way)),
            (float(first), float(second)),
            -float(np.radians(twist)),
            float(np.radians(twist)),
            (float(center[0]), float(center[1]), float(center[2]), float(center[3])),
            _vector(quat.rotate(back, across)),
        )


def _scaled(span: Range, share: float) -> Range:
    return Range(
        (span.bend[0] * share, span.bend[1] * share),
        (span.aside[0] * share, span.aside[1] * share),
        span.twist * share,
    )


def _direction(vector: Floats, otherwise: Floats) -> Floats:
    """The unit vector; another where it has no length."""
    length = float(np.linalg.norm(vector))
    if length > 1e-9:
        return np.asarray(vector, np.float64) / length
    other = np.asarray(otherwise, np.float64)
    length = float(np.linalg.norm(other))
    return other / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])


def _vector(values: Floats) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
