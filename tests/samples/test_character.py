"""The built-in human: joints, meshes, weights."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from keypose.errors import UnknownName
from keypose.evaluate import world
from keypose.model import Character
from keypose.samples import load, names, open_scene
from keypose.samples.human import human
from keypose.samples.skeleton import bend_axis, hand_axes, rest_positions, roles, skeleton, twist_axis
from tests.samples.geometry import components, depth_from_front, directed_edges, face_normals, open_edges, volume

PARTS = [part.name for part in human().parts]
CLOSED = (
    "hands", "zip", "star", "pockets", "seams", "laces", "brows", "eyes", "catchlights", "upper_teeth", "lower_teeth", "tongue", "lashes",
    "ears", "hair",
)  # fmt: skip


def _part(character: Character, name: str):
    return next(p for p in character.parts if p.name == name)


# --- skeleton --------------------------------------------------------------------------------------------------------


def test_skeleton_has_the_usual_humanoid_joints() -> None:
    body = skeleton()
    assert body.joint_count >= 60
    sides = [
        f"{side}{name}"
        for side in ("Left", "Right")
        for name in (
            "Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "ToeBase", "Eye",
            *(f"Hand{f}{n}" for f in ("Thumb", "Index", "Middle", "Ring", "Pinky") for n in (1, 2, 3)),
        )
    ]  # fmt: skip
    for name in ("Hips", "Spine", "Spine1", "Spine2", "Neck", "Head", "Jaw", *sides):
        body.index(name)


def test_rest_rotations_are_the_identity_and_places_agree() -> None:
    body = skeleton()
    assert np.all(body.rest.rotations == np.float32([1, 0, 0, 0]))
    model_from_joint = world(body, body.rest)
    for joint, name in enumerate(body.names):
        assert np.allclose(model_from_joint[joint, :3, 3], rest_positions()[name], atol=1e-6)


def test_skeleton_is_mirror_symmetric() -> None:
    places = rest_positions()
    for name, place in places.items():
        if name.startswith("Left"):
            assert np.allclose(places["Right" + name[4:]], place * (-1, 1, 1))
        elif not name.startswith("Right"):
            assert place[0] == 0


def test_roles_name_joints_of_their_side() -> None:
    found = roles()
    assert len(found) >= 50 and len(set(found.values())) == len(found)
    for role, joint in found.items():
        name = skeleton().names[joint]
        assert role.startswith("left_") == name.startswith("Left")
        assert role.startswith("right_") == name.startswith("Right")
    assert skeleton().names[found["right_little_distal"]] == "RightHandPinky3"


def _turned(axis: np.ndarray, vector: np.ndarray, angle: float = 0.3) -> np.ndarray:
    return (
        vector * np.cos(angle) + np.cross(axis, vector) * np.sin(angle) + axis * (axis @ vector) * (1 - np.cos(angle))
    )


@pytest.mark.parametrize("side", ["Left", "Right"])
def test_positive_bends_fold_the_limbs(side: str) -> None:
    def moved(name: str) -> np.ndarray:
        return _turned(bend_axis(side + name), twist_axis(side + name)) - twist_axis(side + name)

    outside = 1.0 if side == "Left" else -1.0
    palm = hand_axes()[2] * (outside, 1, 1)
    assert moved("ForeArm")[2] > 0.2, "the forearm swings forward"
    assert moved("Leg")[2] < -0.2, "the shin swings back"
    assert moved("UpLeg")[2] > 0.2, "the thigh lifts forward"
    assert moved("Foot")[1] > 0.2, "the toes point up"
    assert moved("Arm")[1] > 0.1, "the arm lifts"
    for finger in ("Index", "Middle", "Ring", "Pinky"):
        assert moved(f"Hand{finger}2") @ palm > 0.2, "fingers curl into the palm"
    thumb = moved("HandThumb2")
    assert thumb @ palm > 0.1 and thumb[2] < -0.1, "the thumb folds across the palm"


def test_unknown_joints_name_the_nearest() -> None:
    with pytest.raises(UnknownName, match="nearest: 'LeftForeArm'"):
        bend_axis("LeftForearm")


# --- samples ---------------------------------------------------------------------------------------------------------


def test_samples_are_found_by_name() -> None:
    assert names()[0] == "human"
    scene = load("human")
    assert scene.format == "sample" and scene.character is human()
    assert open_scene("sample:human").character is human()
    with pytest.raises(UnknownName, match="nearest: 'human'"):
        load("humann")


def test_generation_is_deterministic() -> None:
    code = (
        "import hashlib; from keypose.samples.human import human; h = hashlib.sha256();"
        "[h.update(a.tobytes()) for p in human().parts for a in (p.mesh.positions, p.mesh.triangles, p.mesh.normals,"
        " p.skin.weights, p.skin.joints) + ((p.morphs.position_deltas,) if p.morphs else ())]; print(h.hexdigest())"
    )
    runs = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120).stdout
        for _ in range(2)
    ]
    assert runs[0] == runs[1]


# --- meshes ----------------------------------------------------------------------------------------------------------


def test_counts_and_height(character: Character) -> None:
    assert 10_000 <= character.triangle_count < 20_000
    points = np.vstack([p.mesh.positions for p in character.parts])
    assert abs(points[:, 1].min()) < 2e-3, "the soles stand on y = 0"
    assert 1.68 < points[:, 1].max() < 1.76
    assert len({p.material.base_color for p in character.parts}) >= 8


@pytest.mark.parametrize("name", PARTS)
def test_triangles_and_normals_are_sound(character: Character, name: str) -> None:
    mesh = _part(character, name).mesh
    crossed = face_normals(mesh.positions, mesh.triangles)
    assert np.linalg.norm(crossed, axis=1).min() / 2 > 1e-8, "a triangle is degenerate"
    assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-4)
    assert np.all(np.isfinite(mesh.positions))
    edges = directed_edges(mesh.triangles)
    assert len(np.unique(edges, axis=0)) == len(edges), "two triangles use one edge in the same direction"
    mean = mesh.normals[mesh.triangles].mean(1)
    against = np.sum(mean * crossed, 1) < 0
    assert against.mean() < 0.01, "normals disagree with the triangles' winding"


@pytest.mark.parametrize("name", CLOSED)
def test_closed_bodies_are_watertight_and_face_outward(character: Character, name: str) -> None:
    mesh = _part(character, name).mesh
    assert not len(open_edges(mesh.triangles))
    label = components(mesh.triangles, mesh.vertex_count)
    for body in range(label.max() + 1):
        assert volume(mesh.positions, mesh.triangles[label[mesh.triangles[:, 0]] == body]) > 0


@pytest.mark.parametrize("group", [1, 2, 3, 4])
def test_clothes_face_outward_and_end_inside(character: Character, group: int) -> None:
    """The materials of one garment fit together without gaps; its only borders are turned in."""
    parts = [p for p in character.parts if p.group == group]
    points = np.vstack([p.mesh.positions for p in parts])
    offsets = np.cumsum([0, *(p.mesh.vertex_count for p in parts)])
    triangles = np.vstack([p.mesh.triangles + o for p, o in zip(parts, offsets, strict=False)])
    _, weld = np.unique(np.round(points, 6), axis=0, return_inverse=True)
    welded = weld.reshape(-1)[triangles]
    unique = np.zeros((weld.max() + 1, 3))
    unique[weld.reshape(-1)] = points
    assert volume(unique, welded) > 0
    loops = open_edges(welded)
    label = components(np.stack([loops[:, 0], loops[:, 1], loops[:, 1]], 1), len(unique)) if len(loops) else []
    count = len(np.unique(label[loops[:, 0]])) if len(loops) else 0
    assert count == {1: 4, 2: 2, 3: 3, 4: 0}[group], "hem, cuffs and neckline of the jacket; shirt; waist and legs"


@pytest.mark.parametrize("name", [n for n in PARTS if n not in ("hair", "star", "catchlights", "zip", "seams")])
def test_mirror_symmetry(character: Character, name: str) -> None:
    mesh = _part(character, name).mesh
    distance, _ = cKDTree(mesh.positions).query(mesh.positions * np.float32([-1, 1, 1]))
    assert distance.max() < 2e-5


def test_hair_is_one_body_without_gaps(character: Character) -> None:
    """From the back and the sides no skin shows between the crown and the hairline."""
    mesh = _part(character, "hair").mesh
    assert components(mesh.triangles, mesh.vertex_count).max() == 0
    head = _part(character, "head").mesh
    back, height = np.meshgrid(np.linspace(-0.085, 0.085, 35), np.linspace(1.56, 1.70, 29))
    places = np.stack([back.ravel(), height.ravel()], 1) + 1.3e-5
    turned = np.array([-1, 1, -1])
    hair = depth_from_front(mesh.positions * turned, mesh.triangles, places)
    skin = depth_from_front(head.positions * turned, head.triangles, places)
    assert np.all(hair > skin + 0.002)
    behind, height = np.meshgrid(np.linspace(0.0, 0.11, 23), np.linspace(1.60, 1.70, 21))
    for side in (1, -1):  # the side's own x runs backwards on the left, forwards on the right
        seen = np.array([[0, 0, -side], [0, 1, 0], [side, 0, 0]])
        places = np.stack([side * behind.ravel(), height.ravel()], 1) + 1.3e-5
        hair = depth_from_front(mesh.positions @ seen.T, mesh.triangles, places)
        skin = depth_from_front(head.positions @ seen.T, head.triangles, places)
        assert np.isfinite(skin).sum() > 300
        assert np.all((hair > skin + 0.002) | np.isinf(skin))


def test_colours_are_tints(character: Character) -> None:
    for part in character.parts:
        if part.mesh.colors is not None:
            assert part.mesh.colors.min() >= 0 and part.mesh.colors.max() <= 1


# --- weights ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PARTS)
def test_weights_sum_to_one_over_at_most_four_joints(character: Character, name: str) -> None:
    skin = _part(character, name).skin
    assert skin.influence_count <= 4
    assert np.allclose(skin.weights.sum(1), 1, atol=1e-6)
    assert skin.weights.min() >= 0


def test_rest_pose_gives_the_mesh_back(character: Character, posed) -> None:
    vertices = posed()
    for part in character.parts:
        assert np.allclose(vertices[part.name], part.mesh.positions, atol=2e-6)


def _dense(character: Character, name: str) -> np.ndarray:
    skin = _part(character, name).skin
    dense = np.zeros((len(skin.joints), character.skeleton.joint_count))
    np.add.at(dense, (np.arange(len(skin.joints))[:, None], skin.palette[skin.joints]), skin.weights)
    return dense


@pytest.mark.parametrize("name", ["trousers", "turn_ups", "hands", "sleeves", "sneakers", "soles"])
def test_no_weights_bleed_across_the_body(character: Character, name: str) -> None:
    dense = _dense(character, name)
    x = _part(character, name).mesh.positions[:, 0]
    for side, sign in (("Left", 1), ("Right", -1)):
        joints = [j for j, n in enumerate(character.skeleton.names) if n.startswith(side)]
        far = sign * x < (-0.06 if name == "trousers" else -0.01)
        assert dense[far][:, joints].max(initial=0) == 0
        assert dense[sign * x < -0.03][:, joints].max(initial=0) < 0.1, "the crotch is shared, the thighs are not"


def test_no_weights_bleed_between_fingers(character: Character) -> None:
    dense = _dense(character, "hands")
    names_ = character.skeleton.names
    share = {
        f: dense[:, [j for j, n in enumerate(names_) if f"Hand{f}" in n and n.startswith("Left")]].sum(1)
        for f in ("Thumb", "Index", "Middle", "Ring", "Pinky")
    }
    for a in share:
        for b in share:
            if a < b:
                assert not np.any((share[a] > 0.6) & (share[b] > 0.15)), f"{a} and {b}"


def test_every_joint_but_the_eyes_moves_something(character: Character) -> None:
    total = sum(_dense(character, p.name).sum(0) for p in character.parts)
    still = [n for n, t in zip(character.skeleton.names, total, strict=True) if t < 1e-3]
    assert not still


# --- documentation ---------------------------------------------------------------------------------------------------


def test_the_page_lists_what_there_is(character: Character) -> None:
    page = (Path(__file__).parents[2] / "docs" / "character.md").read_text(encoding="utf-8")
    for name in (*character.morph_names, *(p.name for p in character.parts)):
        assert f"`{name}`" in page, name
    for name in character.skeleton.names:
        assert name.startswith("Right") or f"| `{name}` |" in page, name
    assert f"{character.triangle_count} triangles, {character.vertex_count} vertices" in page
