"""What the parts of a human weigh and where: masses and centres by joint, from roles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from keypose.analysis.roles import SIDES, RoleMap, joints_by_role
from keypose.arrays import Floats
from keypose.errors import ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.math import quat
from keypose.model import Skeleton

# Per cent of the whole, and how far along the segment from its upper joint the centre is; means of women and men.
_LIMBS = {
    "upper_arm": (2.63, 0.576, "lower_arm"),
    "lower_arm": (1.50, 0.457, "hand"),
    "upper_leg": (14.47, 0.365, "lower_leg"),
    "lower_leg": (4.57, 0.443, "foot"),
}
_HAND, _FOOT, _HEAD = 0.585, 1.33, 6.81
_TRUNK = {"hips": 11.82, "middle": 15.49, "upper": 15.70}  # lower, middle and upper trunk


@dataclass(frozen=True, slots=True, eq=False)
class BodyMasses:
    """Shares of the whole mass (J,), sum 1, and their centres (J, 3) in the joints' spaces, metres."""

    masses: Floats
    centers: Floats


def human_masses(skeleton: Skeleton, roles: RoleMap | Mapping[str, int]) -> BodyMasses:
    """How a human's mass is shared out over the joints of a skeleton; what has no role weighs nothing.

    The centre of a limb's segment is on the way to the next joint, that of the trunk's parts and of hands and feet half way to
    the next role's joint; head and neck weigh at the head. Use with `keypose.ik.CenterOfMassTask`.

    Raises:
        ShapeError: where no role that weighs anything is given, or a role is no joint.

    Source: P. de Leva, "Adjustments to Zatsiorsky-Seluyanov's segment inertia parameters" (1996), table 4.
    """
    joints = joints_by_role(roles, skeleton)
    turned, places = (np.asarray(a, np.float64) for a in world_rotations_positions(skeleton, skeleton.rest))
    masses, centers = np.zeros(skeleton.joint_count), np.zeros((skeleton.joint_count, 3))

    def put(role: str, mass: float, towards: str | None, share: float) -> None:
        if role not in joints:
            return
        joint = joints[role]
        way = np.zeros(3)
        if towards is not None and towards in joints:
            way = share * (places[joints[towards]] - places[joint])
        masses[joint] += mass
        centers[joint] = quat.rotate(quat.conjugate(turned[joint]), way)

    trunk = [role for role in ("hips", "spine", "chest", "upper_chest") if role in joints]
    after = [*trunk[1:], "neck" if "neck" in joints else "head"]
    weights = _shared(trunk)
    for role, following in zip(trunk, after[: len(trunk)], strict=True):
        put(role, weights[role], following, 0.5)
    put("head", _HEAD, None, 0.0)
    for side in SIDES:
        for part, (mass, share, following) in _LIMBS.items():
            put(f"{side}_{part}", mass, f"{side}_{following}", share)
        put(f"{side}_hand", _HAND, f"{side}_middle_proximal", 0.7)
        put(f"{side}_foot", _FOOT, f"{side}_toes", 0.5)
    total = float(masses.sum())
    if not total > 0:
        raise ShapeError("roles: expected at least one that weighs something, such as hips or head")
    return BodyMasses(masses / total, centers)


def _shared(trunk: list[str]) -> dict[str, float]:
    """The trunk's mass over the joints there are: the lower part at the hips, the upper at the highest."""
    whole = sum(_TRUNK.values())
    if len(trunk) <= 1:
        return dict.fromkeys(trunk, whole)
    found = dict.fromkeys(trunk, 0.0)
    found[trunk[0]] += _TRUNK["hips"]
    if len(trunk) == 2:
        found[trunk[1]] += _TRUNK["middle"] + _TRUNK["upper"]
        return found
    found[trunk[-1]] += _TRUNK["upper"]
    for role in trunk[1:-1]:
        found[role] += _TRUNK["middle"] / (len(trunk) - 2)
    return found
