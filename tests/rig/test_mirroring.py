"""A mirrored pose of controls gives the mirror image of the body."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.errors import ShapeError, UnknownName
from keypose.model import Pose
from keypose.rig import evaluate_rig, mirror_controls
from tests.rig.bodies import apart, human, human_rig, places, random_controls

VALUES = {
    "arm.L.ik": 1.0, "spine.ik": 0.7, "head.look": 0.4, "foot.L.roll": 0.5, "foot.R.bank": 0.3, "foot.L.swivel": -0.2,
    "leg.R.twist": 0.3, "arm.R.lower_twist": -0.4, "hand.L.curl": 0.8, "hand.R.spread": 0.2, "index.L.curl": -0.3,
    "hand_ik.L.space": 3.0, "knee.R.space": 2.0,
}  # fmt: skip


@pytest.mark.parametrize("values", [{}, VALUES])
def test_joints_are_where_a_mirror_shows_them(values: dict[str, float]) -> None:
    skeleton, rig = human().skeleton, human_rig()
    other = [
        skeleton.index(n.replace("Left", "Right") if "Left" in n else n.replace("Right", "Left"))
        for n in skeleton.names
    ]
    rest = places(skeleton, skeleton.rest)
    assert np.abs(rest[other] * [-1, 1, 1] - rest).max() < 1e-6, "the human is its own mirror image"
    controls = random_controls(rig, np.random.default_rng(1), (10,), 0.03)
    one = evaluate_rig(rig, skeleton, controls, values)
    mirrored, swapped = mirror_controls(rig, controls, values)
    two = evaluate_rig(rig, skeleton, mirrored, swapped)
    assert np.abs(places(skeleton, one)[:, other] * [-1, 1, 1] - places(skeleton, two)).max() < 1e-5


def test_a_mirror_in_a_mirror_shows_the_pose_itself() -> None:
    skeleton, rig = human().skeleton, human_rig()
    rng = np.random.default_rng(2)
    controls = random_controls(rig, rng, (3, 2))
    controls = Pose(
        controls.translations, controls.rotations, 1 + 0.1 * rng.random((3, 2, *rig.controls.rest.scales.shape))
    )
    once, values = mirror_controls(rig, controls, VALUES)
    twice, again = mirror_controls(rig, once, values)
    assert apart(rig.controls, twice, controls) < 1e-7
    assert np.abs(twice.scales - controls.scales).max() < 1e-12
    assert {n: float(v) for n, v in again.items() if n in VALUES} == VALUES
    assert (
        apart(skeleton, evaluate_rig(rig, skeleton, mirror_controls(rig, rig.controls.rest)[0]), skeleton.rest) < 1e-6
    )


def test_wrong_input_is_named() -> None:
    rig = human_rig()
    with pytest.raises(ShapeError, match="control_pose: expected"):
        mirror_controls(rig, human().skeleton.rest)
    with pytest.raises(UnknownName, match="no attribute 'arm'"):
        mirror_controls(rig, rig.controls.rest, {"arm": 1.0})
