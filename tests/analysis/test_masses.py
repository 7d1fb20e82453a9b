"""Where a human's mass is."""

from __future__ import annotations

import numpy as np
import pytest

from keypose import evaluate, samples
from keypose.analysis import find_roles
from keypose.analysis.masses import human_masses
from keypose.errors import ShapeError
from keypose.ik import CenterOfMassTask, PositionTask, solve_pose
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton


@pytest.fixture(scope="module")
def body() -> Skeleton:
    return samples.load("human").character.skeleton


def center(skeleton: Skeleton, pose: Pose) -> np.ndarray:
    found = human_masses(skeleton, find_roles(skeleton))
    turned, places = (np.asarray(a) for a in evaluate.world_rotations_positions(skeleton, pose))
    return (found.masses[:, None] * (places + quat.rotate(turned, found.centers))).sum(axis=0)


def test_shares_are_those_of_the_table(body: Skeleton) -> None:
    found = human_masses(body, find_roles(body))
    assert found.masses.sum() == pytest.approx(1.0)
    by_name = dict(zip(body.names, found.masses, strict=True))
    assert by_name["LeftUpLeg"] == by_name["RightUpLeg"] == pytest.approx(0.1447, abs=2e-3)
    assert by_name["LeftArmTwist"] == by_name["LeftHandIndex1"] == 0.0
    trunk = sum(by_name[n] for n in ("Hips", "Spine", "Spine1", "Spine2"))
    assert 0.41 < trunk < 0.45


def test_a_standing_human_has_its_centre_at_the_pelvis(body: Skeleton) -> None:
    """Standing, it is at 55 to 57 per cent of the height, in the middle (arms in an A pose lift it a little)."""
    place = center(body, body.rest)
    assert abs(place[0]) < 1e-6 and 0.93 < place[1] < 1.06


def test_the_solver_brings_it_over_a_foot(body: Skeleton) -> None:
    """The left foot carries all: the centre of mass comes over it, feet stay."""
    rest = Pose(*(np.asarray(a, np.float64) for a in (body.rest.translations, body.rest.rotations, body.rest.scales)))
    places = np.asarray(evaluate.world_rotations_positions(body, rest)[1])
    found = human_masses(body, find_roles(body))
    left, right = body.index("LeftFoot"), body.index("RightFoot")
    tasks = [
        CenterOfMassTask(places[left], found.masses, found.centers, (1.0, 0.0, 1.0)),
        PositionTask(left, places[left]),
        PositionTask(right, places[right]),
    ]
    solved = solve_pose(body, rest, tasks)
    assert solved.reached
    place = center(body, solved.pose)
    np.testing.assert_allclose(place[[0, 2]], places[left][[0, 2]], atol=1e-4)


def test_no_roles_no_mass(body: Skeleton) -> None:
    with pytest.raises(ShapeError, match="weighs something"):
        human_masses(body, {"left_eye": 7})
    with pytest.raises(ShapeError, match="role 'head'"):
        human_masses(body, {"head": 99})


def test_a_role_that_no_joint_plays_is_refused_everywhere() -> None:
    from keypose.analysis import measure_quality
    from keypose.retarget import retarget
    from keypose.rig import auto_rig

    walk = samples.load("walk")
    skeleton, motion = walk.character.skeleton, walk.animations[0]
    assert isinstance(motion, Motion)
    roles = {**find_roles(skeleton).roles, "head": 999}
    for use in (
        lambda: human_masses(skeleton, roles),
        lambda: measure_quality(motion, skeleton, roles),
        lambda: retarget(motion, skeleton, skeleton, target_roles=roles),
        lambda: auto_rig(skeleton, roles),
    ):
        with pytest.raises(ShapeError, match="role 'head': expected a joint from 0 to 60, got 999"):
            use()
