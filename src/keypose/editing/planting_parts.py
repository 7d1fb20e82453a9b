"""The part of a body that planting looks at: legs, and what they hang on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from keypose.analysis.roles import SIDES
from keypose.arrays import Ints, finite
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton


@dataclass(frozen=True, slots=True, eq=False)
class LegsOnly:
    """The joints of a motion that move feet, as a motion of a skeleton of their own; ``joints`` (K,) are those of the whole."""

    whole: Motion
    joints: Ints
    motion: Motion
    skeleton: Skeleton
    roles: Mapping[str, int]

    def put_back(self, planted: Motion, closes: bool = False) -> Motion:
        """The whole motion with its legs as they are planted; where it ``closes``, its last frame is its first for all joints."""
        if planted is self.motion:
            return self.whole
        pose = self.whole.pose.broadcast()
        translations, rotations = np.array(pose.translations), np.array(pose.rotations)
        if closes:
            translations[-1], rotations[-1] = translations[0], rotations[0]
            rotations = quat.align_signs(rotations, axis=0)
        translations[:, self.joints] = planted.pose.translations
        rotations[:, self.joints] = planted.pose.rotations
        return replace(self.whole, pose=Pose(translations, rotations, pose.scales))


def legs_only(motion: Motion, skeleton: Skeleton, roles: Mapping[str, int], also: Sequence[int] = ()) -> LegsOnly:
    """The joints that play hips, legs and feet, those of ``also``, and all above them.

    Raises:
        ShapeError: where a number of the motion is not finite.
    """
    for name in ("translations", "rotations", "scales"):
        finite(getattr(motion.pose, name), f"{name} of the motion")
    kept = np.zeros(skeleton.joint_count, bool)
    played = ("hips", *(f"{side}_{part}" for side in SIDES for part in ("upper_leg", "lower_leg", "foot", "toes")))
    for joint in (*(roles[role] for role in played if role in roles), *also):
        while joint >= 0 and not kept[joint]:
            kept[joint] = True
            joint = int(skeleton.parents[joint])
    joints = np.flatnonzero(kept)
    place = np.cumsum(kept) - 1
    names = tuple(skeleton.names[j] for j in joints)
    rest, pose = skeleton.rest, motion.pose.broadcast()
    above = skeleton.parents[joints]
    small = Skeleton(
        names,
        np.where(above < 0, -1, place[above]),
        Pose(rest.translations[joints], rest.rotations[joints], rest.scales[joints]),
    )
    legs = Motion(
        names,
        Pose(pose.translations[:, joints], pose.rotations[:, joints], pose.scales[:, joints]),
        motion.rate_hz,
        motion.name,
    )
    found = {role: int(place[joint]) for role, joint in roles.items() if kept[joint]}
    return LegsOnly(motion, joints, legs, small, found)
