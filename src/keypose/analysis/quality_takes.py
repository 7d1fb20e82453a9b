"""Two takes of one skeleton compared frame by frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from keypose.errors import ShapeError
from keypose.evaluate import match, match_report, world_rotations_positions
from keypose.math import quat
from keypose.model import Motion, Skeleton


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
