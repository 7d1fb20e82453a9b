"""What two bodies have in common: a frame for each role that means the same on every skeleton.

A joint's own axes are a matter of taste. Its *anatomical frame* is not: it is built from where joints are in a reference
pose. Limbs and fingers take the direction of their bone, and its roll from the shortest turn out of a T pose, so that T, A and
hanging arms agree; feet take their heading and stand level; trunk and head take the frame of the whole body.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from keypose.analysis.roles import FINGERS, SIDES, RoleMap, find_roles, joints_by_role, stands_on_all_fours
from keypose.arrays import Floats
from keypose.errors import KeyposeError
from keypose.evaluate import world_rotations_positions
from keypose.math import quat
from keypose.model import Pose, Skeleton
from keypose.retarget.stand import leftward

_UP = np.array([0.0, 1.0, 0.0])

# The joint that a limb's bone points to.
_NEXT = {"upper_leg": "lower_leg", "lower_leg": "foot", "upper_arm": "lower_arm", "lower_arm": "hand"}


@dataclass(frozen=True, slots=True, eq=False)
class BodyFrames:
    """A skeleton seen as a body.

    Shapes and units:
        roles: role -> joint index.
        rotations, places: (J, 4) and (J, 3) metres: model_from_joint in the reference pose.
        joint_from_frame: role -> (4,): the anatomical frame in the joint's own axes.
        facing: (4,) the body's own frame: +X to its left, +Y up, +Z forward.
        on_all_fours: whether it stands on four feet in the reference pose.
        leg_m: length of thigh and shin; ankle_m: height of the ankle over the ground of the reference pose; ground_m: that ground.
    """

    skeleton: Skeleton
    roles: Mapping[str, int]
    rotations: Floats
    places: Floats
    joint_from_frame: Mapping[str, Floats]
    facing: Floats
    leg_m: float
    ankle_m: float
    ground_m: float
    on_all_fours: bool = False

    def joints(self, *roles: str) -> list[int]:
        """The joints of those roles that the body has."""
        return [self.roles[role] for role in roles if role in self.roles]


def body_frames(
    skeleton: Skeleton,
    roles: RoleMap | Mapping[str, int] | None = None,
    reference: Pose | None = None,
    ground_m: float | None = None,
    only: set[str] | None = None,
) -> BodyFrames:
    """The anatomical frames of a skeleton in its rest pose or another reference pose (an upright stand, no batch).

    ``only`` limits what decides a frame to roles that another body has as well: a hand without fingers continues the
    forearm, so a hand with fingers must be looked at alike. ``ground_m`` is the height of the ground in that pose, if the
    lowest joint is not it.

    Raises:
        KeyposeError: where hips, a leg or the spine cannot be told.

    Source: the shortest turn between two directions (Shoemake's half-way quaternion) gives a roll that does not depend on
    the pose of the arms.
    """
    found = find_roles(skeleton, reference).roles if roles is None else roles
    known = joints_by_role(found, skeleton)
    shown = known if only is None else {role: j for role, j in known.items() if role in only}
    missing = [r for r in ("hips", "left_upper_leg", "right_upper_leg", "left_foot", "right_foot") if r not in known]
    if missing:
        raise KeyposeError(
            f"no humanoid: nothing plays {', '.join(missing)}; name the joints in a map of roles (`roles_from_json`)"
        )
    rotations, places = (
        np.asarray(a, np.float64)
        for a in world_rotations_positions(skeleton, skeleton.rest if reference is None else reference)
    )
    facing = _facing(known, places)
    four = stands_on_all_fours(places, known)
    frames: dict[str, Floats] = {}
    for role, joint in known.items():
        frame = _frame(role, shown, places, facing, four)
        frames[role] = quat.multiply(quat.conjugate(rotations[joint]), frame)
    lengths: list[float] = []
    for side in SIDES:
        chain = [
            places[known[f"{side}_{part}"]] for part in ("upper_leg", "lower_leg", "foot") if f"{side}_{part}" in known
        ]
        lengths.append(float(sum(np.linalg.norm(b - a) for a, b in itertools.pairwise(chain))))
    feet = [known[r] for r in ("left_foot", "right_foot", "left_toes", "right_toes") if r in known]
    ankle = float(np.mean([places[known[f"{side}_foot"], 1] for side in SIDES]))
    low = float(min(places[j, 1] for j in feet)) if ground_m is None else ground_m
    return BodyFrames(
        skeleton, known, rotations, places, frames, facing, float(np.mean(lengths)), ankle - low, low, four
    )


def _facing(roles: Mapping[str, int], places: Floats) -> Floats:
    """The body's frame: left by hips and shoulders, up, and forward."""
    left = leftward(places, roles)
    length = float(np.linalg.norm(left))
    if length < 1e-9:
        raise KeyposeError("left and right cannot be told: both hips are at one place in the reference pose")
    left /= length
    return quat.from_axes(left, _UP, np.cross(left, _UP))


def _frame(role: str, roles: Mapping[str, int], places: Floats, facing: Floats, four: bool) -> Floats:
    """model_from_frame of a role in the reference pose."""
    side, _, part = role.partition("_")
    if side not in SIDES:
        return facing
    if part in ("foot", "toes") and not four:
        return _heading(side, roles, places, facing)
    along = _bone(side, part, roles, places)
    if along is None or float(np.linalg.norm(along)) < 1e-9:
        return facing
    straight = -_UP if four or "leg" in part else np.array([1.0 if side == "left" else -1.0, 0.0, 0.0])
    out = quat.rotate(facing, straight)
    return quat.multiply(quat.from_two_vectors(out, along / np.linalg.norm(along)), facing)


def _bone(side: str, part: str, roles: Mapping[str, int], places: Floats) -> Floats | None:
    """The direction of a limb's or finger's bone."""
    own = roles.get(f"{side}_{part}")
    if own is None:
        return None
    if part in _NEXT:
        following = roles.get(f"{side}_{_NEXT[part]}")
        return None if following is None else places[following] - places[own]
    if part in ("foot", "toes"):  # of an animal that walks on its toes
        foot, toes = roles.get(f"{side}_foot"), roles.get(f"{side}_toes")
        return None if foot is None or toes is None else places[toes] - places[foot]
    if part == "hand":
        knuckles = [roles[f"{side}_{f}_proximal"] for f in FINGERS[1:] if f"{side}_{f}_proximal" in roles]
        if knuckles:
            return np.mean(places[knuckles], axis=0) - places[own]
        arm = roles.get(f"{side}_lower_arm")  # without fingers a hand continues the forearm
        return None if arm is None else places[own] - places[arm]
    finger, _, bone = part.partition("_")
    if finger not in FINGERS:
        return None
    order = ("metacarpal", "proximal", "distal") if finger == "thumb" else ("proximal", "intermediate", "distal")
    at = order.index(bone)
    if at + 1 < 3 and f"{side}_{finger}_{order[at + 1]}" in roles:
        return places[roles[f"{side}_{finger}_{order[at + 1]}"]] - places[own]
    if at > 0 and f"{side}_{finger}_{order[at - 1]}" in roles:  # a tip goes on like the bone before it
        return places[own] - places[roles[f"{side}_{finger}_{order[at - 1]}"]]
    return None


def _heading(side: str, roles: Mapping[str, int], places: Floats, facing: Floats) -> Floats:
    """A foot's frame: level, turned to where it points."""
    foot, toes = roles.get(f"{side}_foot"), roles.get(f"{side}_toes")
    if foot is None or toes is None:
        return facing
    forward = places[toes] - places[foot]
    forward = np.array([forward[0], 0.0, forward[2]])
    length = float(np.linalg.norm(forward))
    if length < 1e-9:
        return facing
    forward /= length
    return quat.from_axes(np.cross(_UP, forward), _UP, forward)
