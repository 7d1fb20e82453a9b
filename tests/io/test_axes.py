"""Units and axes: conversions and the guesses of what a file does not say."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.errors import UnknownName
from keypose.io.axes import (
    UNITS_M,
    checked_up,
    guess_unit,
    guess_up,
    turn_roots,
    unit_in_metres,
    y_up_rotation,
)
from keypose.math import quat
from keypose.model import Pose

# a plain figure of 1.7 m: name, parent, translation in metres, Y up, facing +Z
FIGURE = [
    ("Hips", -1, (0, 0.95, 0)),
    ("Spine", 0, (0, 0.2, 0)),
    ("Chest", 1, (0, 0.25, 0)),
    ("Head", 2, (0, 0.2, 0)),
    *[(f"{side}{name}", parent, (x * sign, y, z)) for side, sign, shift in (("Left", 1, 0), ("Right", -1, 6)) for
      name, parent, (x, y, z) in (
        ("Arm", 2, (0.2, 0.05, 0)), ("ForeArm", 4 + shift, (0.28, 0, 0)), ("Hand", 5 + shift, (0.26, 0, 0)),
        ("UpLeg", 0, (0.1, -0.05, 0)), ("Leg", 7 + shift, (0, -0.42, 0)), ("Foot", 8 + shift, (0, -0.42, 0.05)))],
]  # fmt: skip
NAMES = [name for name, _, _ in FIGURE]
PARENTS = np.array([parent for _, parent, _ in FIGURE])
BONES = np.array([bone for _, _, bone in FIGURE], float)
ENDS = [
    (3, np.array((0, 0.1, 0))),
    *((j, np.array((0.17, 0, 0))) for j in (6, 12)),
    *((j, np.array((0, -0.06, 0.15))) for j in (9, 15)),
]


def standing() -> np.ndarray:
    """Joint positions (J, 3) of the figure in its rest pose."""
    positions = BONES.copy()
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            positions[joint] += positions[parent]
    return positions


@pytest.mark.parametrize("up", ["X", "Y", "Z"])
def test_the_up_axis_turns_to_y(up: str) -> None:
    turn = y_up_rotation(up)
    axis = np.eye(3)["XYZ".index(up)]
    np.testing.assert_allclose(quat.rotate(turn, axis), (0, 1, 0), atol=1e-15)
    assert abs(np.linalg.norm(turn) - 1) < 1e-15
    assert checked_up(up.lower()) == up


def test_a_figure_of_a_z_up_world_faces_forward() -> None:
    np.testing.assert_allclose(quat.rotate(y_up_rotation("Z"), np.array((0.0, -1, 0))), (0, 0, 1), atol=1e-15)
    with pytest.raises(UnknownName):
        checked_up("W")


def test_turning_changes_roots_only_and_turns_the_whole_world() -> None:
    rng = np.random.default_rng(3)
    parents = np.array([-1, 0, 1, -1, 3])
    rotations = rng.normal(size=(6, 5, 4))
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    pose = Pose(rng.normal(size=(6, 5, 3)), rotations, np.ones((5, 3)))
    turn = quat.normalize(np.array((0.3, -0.2, 0.5, 0.7)))
    turned = turn_roots(pose, parents, turn)
    children = parents >= 0
    assert np.array_equal(turned.translations[:, children], pose.translations[:, children])
    assert np.array_equal(turned.rotations[:, children], pose.rotations[:, children])

    def positions(p: Pose) -> np.ndarray:
        from keypose.evaluate import world
        from keypose.model import Skeleton

        skeleton = Skeleton(tuple("abcde"), parents, Pose(p.translations[0], p.rotations[0], p.scales))
        return world(skeleton, p)[..., :3, 3]

    np.testing.assert_allclose(positions(turned), quat.rotate(turn, positions(pose)), atol=1e-14)


@pytest.mark.parametrize("unit", UNITS_M)
@pytest.mark.parametrize("stature", [1.5, 1.7])
def test_the_unit_of_a_human_is_found(unit: str, stature: float) -> None:
    scale = stature / 1.7 / UNITS_M[unit]
    unit_m, note = guess_unit(PARENTS.tolist(), BONES * scale, [(j, o * scale) for j, o in ENDS])
    assert unit_m == UNITS_M[unit]
    assert unit in note


def test_the_unit_does_not_depend_on_the_pose_nor_on_a_root_far_away() -> None:
    rng = np.random.default_rng(8)
    lengths = np.linalg.norm(BONES, axis=-1, keepdims=True)
    other = rng.normal(size=BONES.shape)
    other *= lengths / np.linalg.norm(other, axis=-1, keepdims=True) * 100
    other[0] = (4000, 0, 300)
    assert guess_unit(PARENTS.tolist(), other, [(j, o * 100) for j, o in ENDS])[0] == 0.01


def test_what_is_no_human_is_taken_as_centimetres() -> None:
    for parents, bones in (
        ([-1], [[0, 0, 0]]),
        ([-1, 0, 1], [[0, 0, 0], [0, 5, 0], [0, 5, 0]]),
        (PARENTS.tolist(), BONES * 0),
    ):
        unit_m, note = guess_unit(parents, np.array(bones, float), [])
        assert unit_m == 0.01 and "no human" in note


def test_the_up_axis_of_rest_and_motion() -> None:
    rest = standing()
    frames = np.repeat(rest[None], 5, axis=0)
    z_up = rest @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], float)  # y -> z
    lying = z_up - (0, 0, 0.5)  # not on the ground along z
    none = frames[:0]
    assert guess_up(NAMES, rest, frames)[:2] == ("Y", "Y")
    assert guess_up(NAMES, z_up, np.repeat(z_up[None], 5, axis=0))[:2] == ("Z", "Z")
    assert guess_up(NAMES, rest, np.repeat(z_up[None], 5, axis=0))[:2] == ("Z", "Y")
    assert guess_up(NAMES, z_up, frames)[:2] == ("Y", "Z")
    assert guess_up(NAMES, rest, np.repeat(lying[None], 5, axis=0))[:2] == ("Y", "Y")
    assert guess_up(NAMES, z_up, none)[:2] == ("Z", "Z")
    # crawling along x says nothing; the rest pose decides
    crawling = rest[:, [1, 0, 2]]
    assert guess_up(NAMES, z_up, np.repeat(crawling[None], 5, axis=0))[0] == "Z"
    # without telling names the extent along the axes must do
    nameless = [f"Bone{j}" for j in range(len(NAMES))]
    tall = rest * (0.3, 1, 1)
    assert guess_up(nameless, tall, np.repeat(tall[None], 5, axis=0))[0] == "Y"
    tall = tall[:, [0, 2, 1]]
    assert guess_up(nameless, tall, np.repeat(tall[None], 5, axis=0))[0] == "Z"


def test_names_of_units() -> None:
    assert unit_in_metres("cm") == 0.01 and unit_in_metres(0.05) == 0.05
    assert abs(unit_in_metres("cmu") * 0.45 - 0.0254) < 1e-15
    with pytest.raises(UnknownName, match="nearest: 'inch'"):
        unit_in_metres("inches")
