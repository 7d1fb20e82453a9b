"""MakeHuman: the real body against its facts and against the joints of its own BVH file, laws, errors, damage."""

from __future__ import annotations

import doctest
import json
import re
from pathlib import Path

import numpy as np
import pytest

import keypose.io
from keypose.deform import deform_part
from keypose.errors import FormatError, KeyposeError, UnknownName
from keypose.evaluate import world
from keypose.io.gltf.humanoid import ROLES
from keypose.io.makehuman_files import read_target
from keypose.model import Character, Motion, Scene
from tests.conftest import ROOT
from tests.io.damage import damaged, load_damaged
from tests.io.makehuman_files import skeleton, weights, write_figure


@pytest.fixture(scope="module")
def human(data_dir: Path) -> Scene:
    return keypose.io.load(data_dir / "makehuman/default.mhskel", pose_units="both")


def places(character: Character) -> dict[str, np.ndarray]:
    """Rest positions by role."""
    at_rest = np.asarray(world(character.skeleton, character.skeleton.rest))
    return {role: at_rest[joint, :3, 3] for role, joint in character.roles.items()}


# --- the real body ---------------------------------------------------------------------------------------------------


@pytest.mark.data
def test_joints_are_at_the_mean_of_their_vertices(human: Scene, data_dir: Path) -> None:
    lines = (data_dir / "makehuman/base.obj").read_text().splitlines()
    vertices = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    rig = json.loads((data_dir / "makehuman/default.mhskel").read_text())
    skeleton = human.character.skeleton
    assert len(skeleton.names) == 163
    at_rest = np.asarray(world(skeleton, skeleton.rest))[:, :3, 3]
    lift = at_rest[0] - vertices[rig["joints"][rig["bones"]["root"]["head"]]].mean(axis=0) / 10
    assert np.allclose(lift[[0, 2]], 0, atol=1e-9)
    for joint, name in enumerate(skeleton.names):
        bone = rig["bones"][name]
        assert np.allclose(at_rest[joint], vertices[rig["joints"][bone["head"]]].mean(axis=0) / 10 + lift, atol=1e-9)
        parent = skeleton.parents[joint]
        assert (skeleton.names[parent] if parent >= 0 else None) == bone["parent"]
    for joint, tip in skeleton.end_offsets:
        tail = vertices[rig["joints"][rig["bones"][skeleton.names[joint]]["tail"]]].mean(axis=0) / 10 + lift
        turned = np.asarray(world(skeleton, skeleton.rest))[joint, :3, :3] @ tip
        assert np.allclose(at_rest[joint] + turned, tail, atol=1e-9)


@pytest.mark.data
def test_joints_have_the_axes_of_the_bvh_files_that_makehuman_writes(human: Scene, data_dir: Path) -> None:
    """Its figure has other proportions, but bones run the same way in the same axes."""
    theirs = keypose.io.load(data_dir / "makehuman/face-poseunits.bvh", unit="dm", up="Z").character.skeleton
    ours = human.character.skeleton
    assert set(ours.names) == set(theirs.names)
    for joint, name in enumerate(ours.names):
        other = theirs.index(name)
        assert np.allclose(ours.rest.rotations[joint], theirs.rest.rotations[other])
        if ours.parents[joint] >= 0:
            assert ours.names[ours.parents[joint]] == theirs.names[theirs.parents[other]]
            a, b = ours.rest.translations[joint], theirs.rest.translations[other]
            assert np.linalg.norm(a - b) < 0.05
            if min(np.linalg.norm(a), np.linalg.norm(b)) > 0.1:
                assert a @ b > 0.9 * np.linalg.norm(a) * np.linalg.norm(b), name


@pytest.mark.data
def test_the_body_stands_on_the_ground_and_looks_forward(human: Scene) -> None:
    character = human.character
    at = places(character)
    body = character.parts[0]
    assert body.name == "body" and human.unit_m == 0.1 and human.up == "Y"
    lowest, highest = body.mesh.positions.min(axis=0), body.mesh.positions.max(axis=0)
    assert abs(lowest[1]) < 1e-6 and 1.5 < highest[1] < 1.8
    for side, sign in (("left", 1), ("right", -1)):
        hip, knee, ankle, toes = (at[f"{side}_{j}"] for j in ("upper_leg", "lower_leg", "foot", "toes"))
        assert hip[1] > knee[1] > ankle[1] > toes[1] > 0 and toes[2] > ankle[2] + 0.05
        shoulder, elbow, hand = (at[f"{side}_{j}"] for j in ("upper_arm", "lower_arm", "hand"))
        assert 0 < sign * shoulder[0] < sign * elbow[0] < sign * hand[0]
        assert at[f"{side}_eye"][2] > at["head"][2]
    assert (
        at["hips"][1]
        < at["spine"][1] + 0.1
        < at["chest"][1] + 0.1
        < at["upper_chest"][1] + 0.1
        < at["neck"][1]
        < at["head"][1]
    )
    assert set(character.roles) == ROLES


@pytest.mark.data
def test_parts_hold_the_body_and_nothing_that_helps(human: Scene, data_dir: Path) -> None:
    parts = {part.name: part for part in human.character.parts}
    assert list(parts) == ["body", "eyes", "teeth", "tongue"]
    text = (data_dir / "makehuman/base.obj").read_text()
    faces = re.search(r"^g body\ns off\n((?:f .*\n)+)", text, re.M)
    assert faces
    corners = [line.split()[1:] for line in faces[1].splitlines()]
    body = parts["body"].mesh
    assert len(body.triangles) == sum(len(c) - 2 for c in corners)
    assert body.vertex_count == len({word for line in corners for word in line})
    assert (
        len(np.unique(body.positions, axis=0))
        <= len({word.split("/")[0] for line in corners for word in line})
        == 13380
    )
    bare = keypose.io.load(data_dir / "makehuman/default.mhskel", keep=(), ground=False, pose_units="none")
    assert [part.name for part in bare.character.parts] == ["body"] and not bare.animations
    assert bare.character.parts[0].mesh.positions.min(axis=0)[1] < -0.8


@pytest.mark.data
def test_the_skin_leaves_the_rest_pose_alone(human: Scene) -> None:
    character = human.character
    at_rest = world(character.skeleton, character.skeleton.rest)
    for part in character.parts:
        assert part.skin is not None and part.skin.influence_count <= 8
        assert np.allclose(np.asarray(part.skin.weights).sum(axis=1), 1, atol=1e-6)
        assert np.abs(deform_part(character, part, at_rest) - part.mesh.positions).max() < 1e-6


@pytest.mark.data
def test_targets_move_the_stated_vertices(human: Scene, data_dir: Path) -> None:
    listed = re.findall(
        r"`(makehuman/targets/[\w-]+\.target)`.*?\| (\d+) moved vertices", (data_dir / "README.md").read_text()
    )
    assert len(listed) == 15
    body = human.character.parts[0]
    assert body.morphs is not None
    for name, moved in listed:
        vertices, deltas = read_target(data_dir / name, 19158)
        assert len(vertices) == int(moved) and np.isfinite(deltas).all()
        stem = Path(name).stem
        index = human.character.morph_index(stem)
        mine = body.morphs.names.index(stem)
        assert body.morph_channels is not None and body.morph_channels[mine] == index
        found = body.morphs.position_deltas[body.morphs.starts[mine] : body.morphs.starts[mine + 1]]
        known = {tuple(np.round(d, 6)) for d in deltas * 0.1} | {(0.0, 0.0, 0.0)}  # none: where the normal turns
        assert {tuple(np.round(d.astype(float), 6)) for d in found} <= known
    blink = human.character.morph_index("eye-left-closure")
    touched = body.morphs.vertices[body.morphs.starts[blink] : body.morphs.starts[blink + 1]]
    assert np.all(body.mesh.positions[touched, 0] > 0)  # left is +X


@pytest.mark.data
def test_pose_units_are_named_and_morphs_of_them_are_the_skinned_mesh(human: Scene, data_dir: Path) -> None:
    (motion,) = human.animations
    assert isinstance(motion, Motion) and motion.rate_hz == 24 and motion.frame_count == 60
    names = json.loads((data_dir / "makehuman/face-poseunits.json").read_text())["framemapping"]
    assert [event.name for event in motion.events] == names
    assert np.allclose([event.time_s for event in motion.events], motion.times_s)
    character = human.character
    at_rest = world(character.skeleton, character.skeleton.rest)
    for name in ("JawDrop", "LeftUpperLidClosed", "CheeksPump", "TongueOut"):
        weights = np.zeros(len(character.morph_names))
        weights[character.morph_index(name)] = 1
        posed = world(character.skeleton, motion.pose[names.index(name)])
        for part in character.parts:
            skinned = np.asarray(deform_part(character, part, posed))
            assert np.abs(skinned - deform_part(character, part, at_rest, weights)).max() < 2e-6
    jaw = np.asarray(
        deform_part(character, character.parts[2], world(character.skeleton, motion.pose[names.index("JawDrop")]))
    )
    assert (jaw - character.parts[2].mesh.positions)[:, 1].min() < -0.015  # the lower teeth go down


@pytest.mark.data
def test_other_bvh_files_of_makehuman_drive_it(human: Scene, data_dir: Path) -> None:
    from keypose.evaluate import match

    pose = keypose.io.load(data_dir / "makehuman/tpose.bvh", unit="dm", up="Z").animations[0]
    assert isinstance(pose, Motion)
    matched = match(pose, human.character.skeleton)
    at = np.asarray(world(human.character.skeleton, matched.pose))[0]
    roles = human.character.roles
    for side in ("left", "right"):
        arm = at[roles[f"{side}_hand"], :3, 3] - at[roles[f"{side}_upper_arm"], :3, 3]
        assert abs(arm[0]) > 0.98 * np.linalg.norm(arm)  # a T pose


# --- a tiny one ------------------------------------------------------------------------------------------------------


def test_a_tiny_figure(tmp_path: Path) -> None:
    scene = keypose.io.load(write_figure(tmp_path), pose_units="both")
    character = scene.character
    assert scene.format == "makehuman" and character.skeleton.names == ("low", "high")
    assert [p.name for p in character.parts] == ["body", "eyes"] and character.morph_names == ("grow", "Nod")
    at_rest = np.asarray(world(character.skeleton, character.skeleton.rest))
    assert np.allclose(at_rest[:, :3, 3], [[0, 0.2, 0], [0, 1.0, 0]])
    (motion,) = scene.animations
    nod = np.asarray(deform_part(character, character.parts[0], world(character.skeleton, motion.pose[1])))
    top = character.parts[0].mesh.positions[:, 1] > 1
    # 90 degrees about X of the file is 90 degrees about +X here: what was up points forward, to +Z
    expected = character.parts[0].mesh.positions.copy()
    x, y, z = expected[top].T
    expected[top] = np.stack([x, 1.0 - z, y - 1.0], axis=1)
    assert np.allclose(nod, expected, atol=1e-6)
    grown = np.asarray(deform_part(character, character.parts[0], at_rest, np.array([1.0, 0.0])))
    assert np.allclose(grown - character.parts[0].mesh.positions, np.where(top[:, None], (0, 0.1, 0), 0), atol=1e-6)


def test_the_rest_of_makehumans_folders(tmp_path: Path) -> None:
    for name in ("rigs", "3dobjs", "poseunits"):
        (tmp_path / name).mkdir()
    write_figure(tmp_path)
    for name, folder in (
        ("tiny.mhskel", "rigs"), ("tiny.mhw", "rigs"), ("base.obj", "3dobjs"),
        ("face-poseunits.json", "poseunits"), ("face-poseunits.bvh", "poseunits"),
    ):  # fmt: skip
        (tmp_path / name).rename(tmp_path / folder / name)
    scene = keypose.io.load(tmp_path / "rigs/tiny.mhskel", targets=tmp_path / "targets")
    assert len(scene.animations) == 1 and scene.character.morph_names == ("grow",)
    with pytest.raises(FormatError, match="option base"):
        (tmp_path / "3dobjs/base.obj").unlink()
        keypose.io.load(tmp_path / "rigs/tiny.mhskel")


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("tiny.mhskel", '"parent": null', '"parent": "high"', "bones.high: the bone is its own ancestor"),
        ("tiny.mhskel", '"parent": "low"', '"parent": "lower"', "bones.high: its parent 'lower' is no bone"),
        ("tiny.mhskel", '"head": "h"', '"head": "x"', "bones.high: its head 'x' is no joint"),
        ("tiny.mhskel", "31\n", "4711\n", "joints.l[7]: vertex 4711 does not exist; the file has 48"),
        ("tiny.mhskel", '"bones"', '"bone"', "no bones"),
        ("tiny.mhskel", "{", "{{", "JSON line 1 column 2"),
        ("tiny.mhw", "0.5", "-0.5", "weights.low[0]: weight -0.5 is negative"),
        ("tiny.mhw", "0.5", '"a"', "weights.low[0]: expected a vertex and its weight"),
        ("tiny.mhw", "[\n    0,", "[\n    48,", "weights.low[0]: vertex 48 does not exist; the mesh has 48"),
        ("targets/grow.target", "7 0 1 0", "7 0 1", "line 5: expected a vertex and three numbers, got 3 words"),
        ("targets/grow.target", "7 0 1 0", "7 0 1 x", "line 5"),
        ("targets/grow.target", "7 0 1 0", "77 0 1 0", "vertex 77 of row 4 does not exist"),
        ("base.obj", "f 1 3 4 2", "f 1 3 4 99", "line 50"),
        ("face-poseunits.json", "framemapping", "frames", "'framemapping' is missing"),
        ("face-poseunits.bvh", "Frames: 2", "Frames: 3", "face-poseunits.bvh"),
    ],
)
def test_what_is_wrong_is_named_with_file_and_place(
    tmp_path: Path, file: str, old: str, new: str, message: str
) -> None:
    path = write_figure(tmp_path)
    change(tmp_path / file, old, new)
    with pytest.raises(FormatError) as error:
        keypose.io.load(path)
    assert message in str(error.value)
    assert str(tmp_path / file) in str(error.value)


def test_the_skeleton_names_its_weights(tmp_path: Path) -> None:
    path = write_figure(tmp_path)
    (tmp_path / "tiny.mhw").rename(tmp_path / "other.mhw")
    with pytest.raises(FormatError, match="no weights beside the skeleton"):
        keypose.io.load(path)
    scene = keypose.io.load(path, weights=tmp_path / "other.mhw")
    change(path, "tiny.mhw", "../elsewhere.mhw")  # nothing outside the folder is read
    (tmp_path / "other.mhw").rename(tmp_path / "tiny_weights.mhw")
    again = keypose.io.load(path)
    assert any("elsewhere" in note and "tiny_weights.mhw was read" in note for note in again.notes)
    assert len(again.notes) == len(scene.notes) + 1


def test_options_are_checked(tmp_path: Path) -> None:
    path = write_figure(tmp_path)
    with pytest.raises(UnknownName):
        keypose.io.load(path, keep=("ears",))
    with pytest.raises(UnknownName):
        keypose.io.load(path, pose_units="some")
    with pytest.raises(FormatError, match="named as a target"):
        keypose.io.load(path, targets=tmp_path / "none.target")
    only_one = keypose.io.load(path, influences=1)
    assert only_one.character.parts[0].skin is not None and only_one.character.parts[0].skin.influence_count == 1


def test_it_goes_to_glb_and_back(tmp_path: Path) -> None:
    scene = keypose.io.load(write_figure(tmp_path), pose_units="both")
    keypose.io.save(scene, tmp_path / "tiny.glb")
    again = keypose.io.load(tmp_path / "tiny.glb")
    assert again.character.skeleton.names == scene.character.skeleton.names and dict(again.character.roles) == dict(
        scene.character.roles
    )
    assert again.character.morph_names == scene.character.morph_names


# --- damage ----------------------------------------------------------------------------------------------------------


def test_six_hundred_damaged_skeletons(tmp_path: Path) -> None:
    result = load_damaged([write_figure(tmp_path)], 600, tmp_path)
    assert result["wrong"] == [] and result["slowest_s"] < 3 and result["peak_mib"] < 1024
    assert result["loaded"] > 20 and result["refused"] > 200


@pytest.mark.parametrize("name", ["base.obj", "tiny.mhw", "targets/grow.target", "face-poseunits.json"])
def test_damage_of_the_other_files(tmp_path: Path, name: str) -> None:
    path = write_figure(tmp_path)
    sound = (tmp_path / name).read_bytes()
    loaded = 0
    for seed in range(100):
        (tmp_path / name).write_bytes(damaged(sound, seed))
        try:
            scene = keypose.io.load(path)
            loaded += 1
        except KeyposeError as error:
            assert isinstance(error, FormatError) and "\n" not in str(error) and len(str(error)) < 600
            continue
        for part in scene.character.parts:
            assert np.isfinite(part.mesh.positions).all() and np.allclose(
                np.asarray(part.skin.weights).sum(axis=1), 1, atol=1e-5
            )
    assert 0 < loaded < 100


def test_the_files_of_the_tiny_figure_say_what_the_real_ones_say() -> None:
    assert {"bones", "joints", "planes", "weights_file", "name"} <= set(skeleton())
    assert set(weights()) == {"name", "weights"}


def test_the_page() -> None:
    result = doctest.testfile(str(ROOT / "docs/formats/makehuman.md"), module_relative=False, encoding="utf-8")
    assert result.attempted and not result.failed
