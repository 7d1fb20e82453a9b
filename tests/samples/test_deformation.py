"""How well the built-in human bends: volume kept, triangles not turned over, cloth outside the body."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.math import quat
from keypose.model import Character
from keypose.samples.skeleton import twist_axis
from tests.samples.geometry import face_normals, volume

FIST = {
    f"{side}Hand{finger}{n}": angle
    for side in ("Left", "Right")
    for finger in ("Index", "Middle", "Ring", "Pinky")
    for n, angle in ((1, 75.0), (2, 90.0), (3, 55.0))
}
ARMS = {
    "LeftArm": quat.from_axis_angle(np.array([0.0, 0, 1]), 1.4),
    "RightArm": quat.from_axis_angle(np.array([0.0, 0, -1]), 1.4),
}


def _triangles(character: Character, name: str) -> np.ndarray:
    return next(p for p in character.parts if p.name == name).mesh.triangles


@pytest.mark.parametrize(
    ("part", "bends", "least"),
    [
        ("sleeves", {"LeftForeArm": 90.0, "RightForeArm": 90.0}, 0.95),
        ("sleeves", {"LeftForeArm": 130.0, "RightForeArm": 130.0}, 0.90),
        ("trousers", {"LeftLeg": 90.0, "RightLeg": 90.0}, 0.95),
        ("trousers", {"LeftUpLeg": 90.0, "RightUpLeg": 90.0}, 0.88),
        ("hands", FIST, 0.90),
    ],
)
def test_bending_keeps_the_volume(
    character: Character, posed, part: str, bends: dict[str, float], least: float
) -> None:
    triangles = _triangles(character, part)
    ratio = volume(posed(bends)[part], triangles) / volume(posed()[part], triangles)
    assert least < ratio < 1.06


def test_rolling_the_wrist_does_not_wring_the_sleeve(character: Character, posed) -> None:
    """With half of the roll on the twist joint the sleeve keeps its volume."""
    along = twist_axis("LeftForeArm")
    half, whole = quat.from_axis_angle(along, 0.7), quat.from_axis_angle(along, 1.4)
    triangles = _triangles(character, "sleeves")
    turned = posed(rotations={"LeftForeArmTwist": half, "LeftHand": whole})["sleeves"]
    assert volume(turned, triangles) / volume(posed()["sleeves"], triangles) > 0.97


@pytest.mark.parametrize(
    ("pose", "most"),
    [
        ({"bends": {"LeftForeArm": 120.0, "RightForeArm": 120.0}}, 0.004),
        ({"bends": {"LeftLeg": 120.0, "RightLeg": 120.0}}, 0.004),
        ({"bends": {"LeftUpLeg": 100.0, "RightUpLeg": 100.0, "LeftLeg": 110.0, "RightLeg": 110.0}}, 0.01),
        ({"bends": FIST}, 0.01),
        ({"rotations": ARMS}, 0.01),
        ({"rotations": {"Head": quat.from_axis_angle(np.array([0.0, 1, 0]), 1.2)}}, 0.004),
        ({"bends": {"Spine": 25.0, "Spine1": 25.0, "Spine2": 20.0}}, 0.004),
    ],
    ids=["elbows", "knees", "squat", "fists", "arms up", "head", "bow"],
)
def test_few_triangles_turn_over(character: Character, posed, pose: dict, most: float) -> None:
    """A triangle has turned over when it points against all three of its neighbours' mean direction."""
    vertices = posed(**pose)
    bad, count = 0, 0
    for part in character.parts:
        triangles, points = part.mesh.triangles, vertices[part.name]
        crossed = face_normals(points, triangles)
        smooth = np.zeros((len(points), 3))
        for corner in range(3):
            np.add.at(smooth, triangles[:, corner], crossed)
        mean = smooth[triangles].sum(1) - 3 * crossed
        bad += int(np.sum(np.sum(mean * crossed, 1) < 0)) - int(_already(part))
        count += len(triangles)
    assert bad / count < most


def _already(part) -> int:
    """Triangles at sharp folds of the rest pose that look turned over by the same measure."""
    crossed = face_normals(part.mesh.positions, part.mesh.triangles)
    smooth = np.zeros((part.mesh.vertex_count, 3))
    for corner in range(3):
        np.add.at(smooth, part.mesh.triangles[:, corner], crossed)
    mean = smooth[part.mesh.triangles].sum(1) - 3 * crossed
    return int(np.sum(np.sum(mean * crossed, 1) < 0))


def test_the_jaw_joint_opens_the_mouth(posed) -> None:
    opened, rest = posed({"Jaw": 20.0}), posed()
    moved = opened["lower_teeth"] - rest["lower_teeth"]
    assert moved[:, 1].max() < -0.01
    assert np.allclose(opened["upper_teeth"], rest["upper_teeth"], atol=1e-6)
    assert np.allclose(opened["hair"], rest["hair"], atol=1e-6)
