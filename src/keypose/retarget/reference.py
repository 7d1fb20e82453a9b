"""A motion beside what somebody else made of the same performance: directions of bones, without what is a matter of taste."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from keypose.analysis.quality import carried_speeds
from keypose.analysis.roles import SIDES, stands_on_all_fours
from keypose.arrays import Floats
from keypose.errors import KeyposeError, ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.model import Motion, Skeleton
from keypose.retarget.report import angles_deg

GROUPS: Mapping[str, tuple[tuple[str, str], ...]] = {
    "arms": tuple(
        (f"{s}_{a}", f"{s}_{b}") for s in SIDES for a, b in (("upper_arm", "lower_arm"), ("lower_arm", "hand"))
    ),
    "legs": tuple(
        (f"{s}_{a}", f"{s}_{b}") for s in SIDES for a, b in (("upper_leg", "lower_leg"), ("lower_leg", "foot"))
    ),
    "shoulders": tuple((f"{s}_shoulder", f"{s}_upper_arm") for s in SIDES),
    "trunk": (("hips", "neck"),),
    "head": (("neck", "head"),),
    "feet": tuple((f"{s}_foot", f"{s}_toes") for s in SIDES),
}
"""Bones by group, as roles of their two ends."""

# How far apart in time two takes of one performance may lie, in seconds, where it is looked for.
_MOST_SHIFT_S = 0.1

_FEWEST_FRAMES = 3


@dataclass(frozen=True, slots=True)
class ReferenceReport:
    """A motion beside a reference.

    Units: ``direction_deg`` group -> mean angle between the bones of both in degrees, over the frames of the reference;
    ``mean_direction_deg`` over all bones; ``turned_deg`` how far the reference is turned about the vertical, and ``shift_s``
    how much later the motion has what the reference shows: both are taken out first; ``slide_cm_s`` and
    ``reference_slide_cm_s`` mean level speed of the feet's carrying points in contact.
    """

    direction_deg: dict[str, float]
    mean_direction_deg: float
    turned_deg: float
    shift_s: float
    slide_cm_s: float
    reference_slide_cm_s: float
    frame_count: int

    def lines(self) -> list[str]:
        """The figures as short lines for people."""
        parts = ", ".join(f"{group} {angle:.2f}" for group, angle in self.direction_deg.items())
        return [
            f"bone directions beside the reference: {self.mean_direction_deg:.2f} degrees on average ({parts})",
            f"the reference is turned by {self.turned_deg:.1f} degrees and shifted by {1000.0 * self.shift_s:.1f} ms; "
            f"its feet slide {self.reference_slide_cm_s:.2f} cm/s, these {self.slide_cm_s:.2f}",
        ]


def compare_with_reference(
    motion: Motion,
    skeleton: Skeleton,
    roles: Mapping[str, int],
    reference: Motion,
    reference_skeleton: Skeleton,
    reference_roles: Mapping[str, int],
    touching: Mapping[str, np.ndarray],
) -> ReferenceReport:
    """How far a motion is from an independent result of the same performance, on any skeleton and at any rate.

    Shapes and units: ``touching`` (T,) bool for each point of the feet, by frames of ``motion``, as `foot_contacts` gives it.
    The time between both is looked for within 0.1 s, frame by frame of ``motion``.

    Raises:
        KeyposeError: where only one of the two stands on four feet.
        ShapeError: where the two have no frames in common, or no bones.
    """
    if len({_on_all_fours(s, r) for s, r in ((skeleton, roles), (reference_skeleton, reference_roles))}) > 1:
        raise KeyposeError("one body stands on four feet and the other on two; their motions cannot be compared")
    mine, theirs = (
        np.asarray(world_rotations_positions(s, m.pose.broadcast())[1], np.float64)
        for s, m in ((skeleton, motion), (reference_skeleton, reference))
    )
    bones = {
        group: [pair for pair in pairs if all(role in r for role in pair for r in (roles, reference_roles))]
        for group, pairs in GROUPS.items()
    }
    limbs = bones["arms"] + bones["legs"]
    if not limbs:
        raise ShapeError("the two bodies have no bone of an arm or leg in common")
    most = round(_MOST_SHIFT_S * motion.rate_hz)
    shifts = [n for n in range(-most, most + 1) if len(_frames(motion, reference, n)[0]) >= _FEWEST_FRAMES]
    if not shifts:
        raise ShapeError(f"motions: expected frames in common, got {motion.frame_count} and {reference.frame_count}")

    def pair_up(shift: int, pairs: list[tuple[str, str]]) -> tuple[Floats, Floats]:
        own, other = _frames(motion, reference, shift)
        return _ways(mine[own], roles, pairs), _ways(theirs[other], reference_roles, pairs)

    def error(shift: int) -> float:
        a, b = pair_up(shift, limbs)
        return float(angles_deg(a, _turned(b, _heading(a, b))).mean())

    best = min(shifts, key=lambda n: (error(n), abs(n)))
    heading = _heading(*pair_up(best, limbs))
    found: dict[str, float] = {}
    every: list[Floats] = []
    for group, pairs in bones.items():
        if pairs:
            a, b = pair_up(best, pairs)
            angles = angles_deg(a, _turned(b, heading))
            found[group] = float(angles.mean())
            every.append(angles.mean(axis=0))
    own, other = _frames(motion, reference, best)
    at = np.full(len(theirs), -1)
    at[other] = own
    there = {point: flags[np.maximum(at, 0)] & (at >= 0) for point, flags in touching.items()}
    speeds = carried_speeds(roles, mine, touching, motion.rate_hz)
    beside = carried_speeds(reference_roles, theirs, there, reference.rate_hz)
    return ReferenceReport(
        found,
        float(np.concatenate(every).mean()),
        float(np.degrees(-heading)),
        best / motion.rate_hz,
        float(speeds.mean()) if len(speeds) else 0.0,
        float(beside.mean()) if len(beside) else 0.0,
        len(own),
    )


def _on_all_fours(skeleton: Skeleton, roles: Mapping[str, int]) -> bool:
    """Whether a body rests on hands and feet."""
    return stands_on_all_fours(np.asarray(world_rotations_positions(skeleton, skeleton.rest)[1], np.float64), roles)


def _frames(motion: Motion, reference: Motion, shift: int) -> tuple[np.ndarray, np.ndarray]:
    """Frames of the motion and of the reference that show the same moment."""
    other = np.arange(reference.frame_count)
    own = np.rint(other * (motion.rate_hz / reference.rate_hz)).astype(np.intp) + shift
    inside = (own >= 0) & (own < motion.frame_count)
    return own[inside], other[inside]


def _ways(places: Floats, roles: Mapping[str, int], pairs: list[tuple[str, str]]) -> Floats:
    """Unit directions of bones (T, N, 3)."""
    ways = np.stack([places[:, roles[b]] - places[:, roles[a]] for a, b in pairs], axis=1)
    return ways / np.maximum(np.linalg.norm(ways, axis=-1, keepdims=True), 1e-12)


def _heading(a: Floats, b: Floats) -> float:
    """The turn about the vertical that brings directions ``b`` nearest to ``a`` (least squares), radians."""
    sine = np.sum(b[..., 2] * a[..., 0] - b[..., 0] * a[..., 2])
    cosine = np.sum(b[..., 0] * a[..., 0] + b[..., 2] * a[..., 2])
    return float(np.arctan2(sine, cosine))


def _turned(ways: Floats, heading: float) -> Floats:
    sine, cosine = np.sin(heading), np.cos(heading)
    x, y, z = ways[..., 0], ways[..., 1], ways[..., 2]
    return np.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=-1)
