"""How well a motion on one body repeats that of another: directions of bones, sliding and sinking feet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from keypose.analysis.quality import carried_speeds
from keypose.analysis.roles import SIDES
from keypose.arrays import Floats
from keypose.editing.planting import PlantOptions
from keypose.evaluate import world_rotations_positions
from keypose.math import quat
from keypose.model import Motion
from keypose.retarget.body import BodyFrames
from keypose.retarget.footing import footings

_LIMBS = (
    ("upper_arm", "lower_arm"), ("lower_arm", "hand"), ("upper_leg", "lower_leg"), ("lower_leg", "foot"), ("foot", "toes"),
)  # fmt: skip
_BONES = (
    *((f"{side}_{a}", f"{side}_{b}") for side in SIDES for a, b in _LIMBS),
    ("hips", "neck"),
    ("neck", "head"),
)


@dataclass(frozen=True, slots=True, eq=False)
class RetargetReport:
    """Figures of one body's motion on another.

    Units: ``direction_deg`` bone -> mean angle between the two bones' directions in the model's space (of trunk, neck and feet
    without what the bodies' build differs by in their reference poses); ``mean_direction_deg`` over all bones; ``slide_cm_s``
    mean and ``worst_slide_cm_s`` largest level speed of a foot's carrying point while it touches the ground; ``sink_cm`` deepest
    place of a foot under the ground; ``source_slide_cm_s`` the same mean of the source; ``hands_off_cm`` mean distance of palms
    from the place beside body or prop that they should have (None where that was not asked).
    """

    direction_deg: dict[str, float]
    mean_direction_deg: float
    slide_cm_s: float
    worst_slide_cm_s: float
    source_slide_cm_s: float
    sink_cm: float
    contact_frames: int
    hands_off_cm: float | None = None

    def lines(self) -> list[str]:
        """The figures as short lines for people."""
        worst = max(self.direction_deg, key=lambda bone: self.direction_deg[bone], default="")
        return [
            f"bone directions: {self.mean_direction_deg:.2f} degrees on average"
            + (f", most at {worst} ({self.direction_deg[worst]:.2f})" if worst else ""),
            f"feet in contact slide {self.slide_cm_s:.2f} cm/s on average, {self.worst_slide_cm_s:.2f} at most "
            f"(source {self.source_slide_cm_s:.2f}), {self.contact_frames} frames",
            f"feet sink {self.sink_cm:.2f} cm at most",
            *(
                []
                if self.hands_off_cm is None
                else [f"hands beside body or props are {self.hands_off_cm:.2f} cm off on average"]
            ),
        ]


def compare_motions(
    source: Motion,
    own: BodyFrames,
    target: Motion,
    other: BodyFrames,
    options: PlantOptions,
    touching: Mapping[str, np.ndarray] | None = None,
) -> RetargetReport:
    """The figures of two motions with the same frames; ``touching``: the contacts (T,), if not those of the source by itself."""
    r, a = (np.asarray(x, np.float64) for x in world_rotations_positions(own.skeleton, source.pose.broadcast()))
    s, b = (np.asarray(x, np.float64) for x in world_rotations_positions(other.skeleton, target.pose.broadcast()))
    directions: dict[str, float] = {}
    for low, high in _BONES:
        if all(role in body.roles for role in (low, high) for body in (own, other)):
            theirs, mine = (_way(body, *at, low, high) for body, at in ((own, (r, a)), (other, (s, b))))
            if low in ("hips", "neck"):
                theirs = _built_alike(own, r, theirs, other, low, high)
            directions[low] = float(np.mean(angles_deg(theirs, mine)))
    feet = footings(own, other, a, source.rate_hz, options, touching)
    speeds = np.concatenate([carried_speeds(f.other, b, f.touching, target.rate_hz) for f in feet])
    theirs = np.concatenate([carried_speeds(f.own, a, f.touching, source.rate_hz) for f in feet])
    carried = [flags for f in feet for flags in f.touching.values()]
    frames = int(np.sum(np.any(carried, axis=0))) if carried else 0
    ends = {
        f.other[f"{side}_{end}"]
        for f in feet
        for side in SIDES
        for end in ("foot", "toes")
        if f"{side}_{end}" in f.other
    }
    sink = max((float((other.places[j, 1] - b[:, j, 1]).max()) for j in ends), default=0.0)
    mean = float(np.mean(list(directions.values()))) if directions else 0.0
    return RetargetReport(
        directions,
        mean,
        float(speeds.mean()) if len(speeds) else 0.0,
        float(speeds.max()) if len(speeds) else 0.0,
        float(theirs.mean()) if len(theirs) else 0.0,
        max(0.0, 100.0 * sink),
        frames,
    )


def _way(body: BodyFrames, turned: Floats, places: Floats, low: str, high: str) -> Floats:
    """Where a bone points; a foot's own slope does not count, but how it is turned from where it stands level."""
    if low.endswith("_foot") and not body.on_all_fours:
        ahead = quat.rotate(body.joint_from_frame[low], np.array([0.0, 0.0, 1.0]))
        joint = body.roles[low]
        return quat.rotate(turned[:, joint], np.broadcast_to(ahead, places[:, joint].shape))
    return places[:, body.roles[high]] - places[:, body.roles[low]]


def _built_alike(own: BodyFrames, turned: Floats, way: Floats, other: BodyFrames, low: str, high: str) -> Floats:
    """The way of a source's trunk or neck as on the target's build, which leans in its reference pose as it does.

    Bodies that stand alike have trunks that are jointed in other places; what counts is how they bend, seen from the hips.
    """
    stands = (
        quat.rotate(quat.conjugate(body.facing), body.places[body.roles[high]] - body.places[body.roles[low]])
        for body in (own, other)
    )
    alike = quat.from_two_vectors(*(stand / max(float(np.linalg.norm(stand)), 1e-12) for stand in stands))
    hips = quat.multiply(turned[:, own.roles["hips"]], own.joint_from_frame["hips"])
    return quat.rotate(quat.multiply(quat.multiply(hips, alike), quat.conjugate(hips)), way)


def angles_deg(a: Floats, b: Floats) -> Floats:
    """Degrees between vectors (T, 3), accurate for small angles."""
    a = a / np.maximum(np.linalg.norm(a, axis=-1, keepdims=True), 1e-12)
    b = b / np.maximum(np.linalg.norm(b, axis=-1, keepdims=True), 1e-12)
    return np.degrees(2.0 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)))
