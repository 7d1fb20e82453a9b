"""Limbs in one piece: rigs whose feet or hands are goals of IK, hung elsewhere, seen as a body.

What plays the foot of such a rig hangs on the root, not on the shin. It is hung there for the work, at the place that it has
at rest, and gets its own parent's axes back in the end.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from keypose.analysis.roles import SIDES
from keypose.arrays import Floats, Ints
from keypose.evaluate import world_rotations_positions
from keypose.math import quat
from keypose.model import Pose, Skeleton

_CHAINS = (
    *(("hips", *(f"{s}_{part}" for part in ("upper_leg", "lower_leg", "foot", "toes"))) for s in SIDES),
    *((f"{s}_upper_arm", f"{s}_lower_arm", f"{s}_hand") for s in SIDES),
)


@dataclass(frozen=True, slots=True, eq=False)
class Attached:
    """A skeleton whose limbs are in one piece.

    Shapes and units: ``order`` (J,) own joint -> joint of the original; ``changed`` joints of the original with another parent.
    """

    skeleton: Skeleton
    original: Skeleton
    order: Ints
    changed: tuple[int, ...]

    def roles(self, roles: Mapping[str, int]) -> dict[str, int]:
        """Roles by own joints."""
        back = np.argsort(self.order)
        return {role: int(back[joint]) for role, joint in roles.items()}

    def pose_in(self, pose: Pose) -> Pose:
        """A pose (*B) of the original in own joints."""
        return self._pose(pose.broadcast(), self.original, self.skeleton, self.order)

    def pose_out(self, pose: Pose) -> Pose:
        """An own pose (*B) in joints of the original."""
        return self._pose(pose.broadcast(), self.skeleton, self.original, np.argsort(self.order))

    def _pose(self, pose: Pose, of: Skeleton, to: Skeleton, order: Ints) -> Pose:
        turned, places = (np.asarray(a, np.float64)[..., order, :] for a in world_rotations_positions(of, pose))
        translations, rotations, scales = (
            np.array(a, np.float64)[..., order, :] for a in (pose.translations, pose.rotations, pose.scales)
        )
        sizes = accumulated_scales(of, np.asarray(pose.scales, np.float64))[..., order, :]
        moved = {
            joint if to is self.original else int(np.flatnonzero(self.order == joint)[0]) for joint in self.changed
        }
        for joint in sorted(moved):
            parent = int(to.parents[joint])
            if parent < 0:
                translations[..., joint, :], rotations[..., joint, :] = places[..., joint, :], turned[..., joint, :]
                scales[..., joint, :] = sizes[..., joint, :]
                continue
            back = quat.conjugate(turned[..., parent, :])
            offset = quat.rotate(back, places[..., joint, :] - places[..., parent, :])
            translations[..., joint, :] = offset / sizes[..., parent, :]
            rotations[..., joint, :] = quat.multiply(back, turned[..., joint, :])
            scales[..., joint, :] = sizes[..., joint, :] / sizes[..., parent, :]
        dtype = np.result_type(pose.rotations)
        return Pose(translations.astype(dtype), rotations.astype(dtype), scales.astype(dtype))


def attach_limbs(skeleton: Skeleton, roles: Mapping[str, int]) -> Attached | None:
    """The skeleton with feet on shins and hands on forearms; None where they hang there already."""
    parents = [int(p) for p in skeleton.parents]
    changed: list[int] = []
    for chain in _CHAINS:
        present = [roles[role] for role in chain if role in roles]
        for upper, lower in itertools.pairwise(present):
            if upper not in _above(parents, lower) and lower not in _above(parents, upper):
                parents[lower] = upper
                changed.append(lower)
    if not changed:
        return None
    order = _sorted(parents)
    back = np.argsort(order)
    new_parents = np.array([back[parents[j]] if parents[j] >= 0 else -1 for j in order])
    rest = skeleton.rest
    shell = Skeleton(
        tuple(skeleton.names[j] for j in order),
        new_parents,
        Pose(*(np.asarray(a)[order] for a in (rest.translations, rest.rotations, rest.scales))),
    )
    attached = Attached(shell, skeleton, order, tuple(changed))
    return replace(attached, skeleton=replace(shell, rest=attached.pose_in(rest)))


def accumulated_scales(skeleton: Skeleton, scales: Floats) -> Floats:
    """Scales (*B, J, 3) of joints with those above them."""
    total = np.array(scales)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            total[..., joint, :] *= total[..., int(parent), :]
    return total


def _above(parents: list[int], joint: int) -> set[int]:
    found: set[int] = set()
    while parents[joint] >= 0:
        joint = parents[joint]
        found.add(joint)
    return found


def _sorted(parents: list[int]) -> Ints:
    """Joints in an order that has parents first and else keeps them as they are."""
    order, done = list[int](), set[int]()

    def add(joint: int) -> None:
        if joint not in done:
            if parents[joint] >= 0:
                add(parents[joint])
            done.add(joint)
            order.append(joint)

    for joint in range(len(parents)):
        add(joint)
    return np.array(order, np.intp)
