"""The doctor: what it finds in healthy and in spoilt characters and motions, and on real files."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from keypose import io, samples
from keypose.analysis import Finding, examine
from keypose.analysis.anatomy import find_body, side_of, words_of
from keypose.analysis.findings import note_level
from keypose.cli.app import app
from keypose.math import quat
from keypose.model import Character, Markers, Motion, Pose, Scene, Skeleton


@pytest.mark.parametrize(
    ("name", "side"),
    [
        ("LeftArm", "left"), ("mixamorig:RightUpLeg", "right"), ("CC_Base_L_Thigh", "left"), ("lShldr", "left"),
        ("Bip01 R Hand", "right"), ("J_Bip_L_Hand", "left"), ("lfemur", "left"), ("rhumerus", "right"), ("hand.L", "left"),
        ("upperarm_r", "right"), ("lowerback", ""), ("root", ""), ("Spine", ""), ("LHipJoint", "left"), ("ribs", ""),
        ("RightHandIndex1", "right"), ("leftEye", "left"), ("RL_BoneRoot", ""), ("rightfoot", "right"), ("neck", ""),
    ],
)  # fmt: skip
def test_names_tell_sides(name: str, side: str) -> None:
    assert side_of(name) == side


def test_words_and_pairs() -> None:
    assert words_of("mixamorig:LeftHandIndex1") == ["left", "hand", "index", "1"]
    names = (
        "Hips",
        "LeftUpLeg",
        "RightUpLeg",
        "l_hand",
        "r_hand",
        "lfemur",
        "rfemur",
        "CC_Base_L_Foot",
        "CC_Base_R_Foot",
    )
    assert [(names[a], names[b]) for a, b in find_body(names).pairs] == [
        ("LeftUpLeg", "RightUpLeg"), ("l_hand", "r_hand"), ("lfemur", "rfemur"), ("CC_Base_L_Foot", "CC_Base_R_Foot"),
    ]  # fmt: skip


@pytest.fixture(scope="module")
def human() -> Scene:
    return samples.load("walk")


def warnings(scene: Scene) -> dict[str, str]:
    return {f.topic: f.text for f in examine(scene).warnings}


def changed(scene: Scene, **more: Any) -> Scene:
    """The scene with another rest pose or motion of its first character."""
    character, motion = scene.character, scene.animations[0]
    if "skeleton" in more:
        character = Character(more["skeleton"], name=character.name)
    return replace(scene, characters=(character,), animations=(more.get("motion", motion),))


def test_the_built_in_human_is_well(human: Scene) -> None:
    found = examine(human)
    assert not found.warnings
    assert found.facts["forward"] == "+Z" and found.facts["handedness"] == "right"
    assert found.facts["rest_pose"] == "A" and found.facts["rate_hz"] == 60
    assert found.facts["stature_m"] == pytest.approx(1.7, abs=0.12)
    assert abs(found.facts["ground_m"]) < 0.05


def scaled(skeleton: Skeleton, factor: float) -> Skeleton:
    rest = skeleton.rest
    return replace(skeleton, rest=Pose(np.asarray(rest.translations) * factor, rest.rotations, rest.scales))


def scaled_motion(motion: Any, factor: float) -> Motion:
    pose = motion.pose
    return motion.with_pose(Pose(np.asarray(pose.translations) * factor, pose.rotations, pose.scales))


def test_a_wrong_unit_is_seen(human: Scene) -> None:
    spoilt = changed(
        human, skeleton=scaled(human.character.skeleton, 100), motion=scaled_motion(human.animations[0], 100)
    )
    assert "16" in warnings(spoilt)["scale"] or "17" in warnings(spoilt)["scale"]


def test_swapped_sides_are_seen(human: Scene) -> None:
    names = human.character.skeleton.names
    swapped = tuple(n.replace("Left", "?").replace("Right", "Left").replace("?", "Right") for n in names)
    skeleton = replace(human.character.skeleton, names=swapped)
    motion = replace(human.animations[0], joint_names=swapped)
    found = examine(changed(human, skeleton=skeleton, motion=motion))
    assert found.facts["handedness"] == "mirrored"
    assert "swapped" in {f.topic: f.text for f in found.warnings}["sides"]


def test_a_character_that_faces_elsewhere_is_seen(human: Scene) -> None:
    skeleton = human.character.skeleton
    rest = skeleton.rest
    turn = quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), np.pi / 2)
    rotations, translations = np.array(rest.rotations), np.array(rest.translations)
    rotations[0] = quat.multiply(turn, rotations[0])
    translations[0] = quat.rotate(turn, translations[0])
    turned = replace(skeleton, rest=Pose(translations, rotations, rest.scales))
    found = examine(changed(human, skeleton=turned))
    assert found.facts["forward"] == "+X"
    assert "faces +X" in {f.topic: f.text for f in found.warnings}["forward"]


def test_a_floating_motion_and_a_collapsed_rest_are_seen(human: Scene) -> None:
    motion = human.animations[0]
    translations = np.array(motion.pose.broadcast().translations)
    translations[:, 0, 1] += 0.8
    lifted = motion.with_pose(Pose(translations, motion.pose.rotations, motion.pose.scales))
    assert "0.8" in warnings(changed(human, motion=lifted))["ground"]
    skeleton = human.character.skeleton
    heap = replace(
        skeleton, rest=Pose(np.zeros_like(skeleton.rest.translations), skeleton.rest.rotations, skeleton.rest.scales)
    )
    found = examine(changed(human, skeleton=heap))
    assert found.facts["rest_pose"] == "collapsed"
    assert found.facts["stature_m"] == pytest.approx(1.7, abs=0.2)  # from the motion


def test_jumps_and_calibration_poses_are_seen(human: Scene) -> None:
    motion = human.animations[0]
    for frame, text in ((0, "calibration"), (40, "between frames 39 and 40")):
        translations = np.array(motion.pose.broadcast().translations)
        translations[frame, 0, 0] += 2.0
        spoilt = motion.with_pose(Pose(translations, motion.pose.rotations, motion.pose.scales))
        assert text in warnings(changed(human, motion=spoilt))["frames"]


def test_bones_that_stretch_and_odd_rates_are_seen(human: Scene) -> None:
    motion = human.animations[0]
    translations = np.array(motion.pose.broadcast().translations)
    joint = human.character.skeleton.index("LeftHand")
    translations[:, joint] *= np.linspace(1, 1.2, len(translations))[:, None]
    spoilt = replace(motion.with_pose(Pose(translations, motion.pose.rotations, motion.pose.scales)), rate_hz=37.3)
    found = warnings(changed(human, motion=spoilt))
    assert "'LeftHand'" in found["bones"] and "37.3 Hz" in found["rate"]


def test_weights_and_flat_triangles_are_seen(human: Scene) -> None:
    whole = samples.load("human")
    part = next(p for p in whole.character.parts if p.skin is not None)
    assert part.skin is not None
    weights = np.array(part.skin.weights)
    weights[:5] *= 0.5
    triangles = np.array(part.mesh.triangles)
    flat = len(triangles) // 20
    triangles[:flat, 2] = triangles[:flat, 1]
    spoilt = replace(part, skin=replace(part.skin, weights=weights), mesh=replace(part.mesh, triangles=triangles))
    found = warnings(replace(whole, characters=(replace(whole.character, parts=(spoilt,)),)))
    assert "0.5 to 1" in found["weights"] and f"{flat:,} of" in found["mesh"]


def test_markers_are_judged() -> None:
    positions = np.random.default_rng(0).uniform(0, 2, (200, 4, 3))
    positions[50:80, 0] = np.nan
    positions[:, 3] = np.nan
    found = examine(Scene(markers=(Markers(("a", "b", "*12", "d"), positions, 120.0),)))
    texts = [f.text for f in found.findings]
    assert found.facts["markers"] == 4 and found.facts["missing_share"] == pytest.approx(230 / 800)
    assert any("1 of 4 markers are never seen: d" in t for t in texts)
    assert any("longest gap is 30 frames from frame 51 ('a')" in t for t in texts)
    assert any("1 trajectory has no name" in t for t in texts)


def test_guesses_come_with_the_option_that_settles_them() -> None:
    scene = Scene(unit_m=0.01, up="Z", notes=("unit: the file names none; taken as cm", "up axis: taken as Z", "odd"))
    command = "keypose convert FILE OUT.glb --unit cm --up Z"
    assert examine(scene).findings == (
        Finding("guess", "unit", "the file names none; taken as cm", command),
        Finding("guess", "up", "taken as Z", command),
        Finding("repair", "reading", "odd"),
    )


@pytest.mark.parametrize(
    ("text", "level"),
    [
        ("up axis: the file names none; taken as Y", "guess"), ("frame time .0083333 s is a rounded 120 Hz", "guess"),
        ("3 nodes that hold neither mesh nor joint were dropped", "loss"), ("picture 'a.tga' was not read", "loss"),
        ("normals: the file has none; smooth ones were computed", "repair"), ("2 nodes were numbered", "repair"),
    ],
)  # fmt: skip
def test_notes_of_readers_are_told_apart(text: str, level: str) -> None:
    assert note_level(text) == level


def test_the_command(tmp_path) -> None:
    path = tmp_path / "walk.bvh"
    io.save(samples.load("walk"), path)
    shown = CliRunner().invoke(app, ["check", str(path)])
    assert shown.exit_code == 0 and "Euler orders" in shown.output and "60 Hz" in shown.output
    told = json.loads(CliRunner().invoke(app, ["check", str(path), "--json"]).output)
    assert told["up"] == "Y" and told["rest_pose"] == "A" and str(path) in told["findings"][0]["fix"]
    assert CliRunner().invoke(app, ["check", "sample:walk", "--strict"]).exit_code == 0
    assert CliRunner().invoke(app, ["check", str(path), "--strict", "--unit", "m"]).exit_code == 1


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "facts", "topics"),
    [
        (
            "cmu_01_01/01_01.bvh",
            {"rest_pose": "T", "rate_hz": 120, "euler_orders": {"ZYX": 31}, "forward": "+Z"},
            {"frames"},
        ),
        ("bvh/fair1/dab.bvh", {"rest_pose": "T", "euler_orders": {"XYZ": 25, "YXZ": 2}}, set()),
        ("bvh/cmu_iclone_007/007_01.bvh", {"rest_pose": "collapsed", "rate_hz": 60}, {"rest pose"}),
        ("bvh/cmu_iclone_007/007_05.bvh", {"rest_pose": "collapsed", "rate_hz": 60}, {"rest pose", "frames"}),
    ],
)
def test_real_files(data_dir, name: str, facts: dict[str, Any], topics: set[str]) -> None:
    found = examine(io.load(data_dir / name))
    assert {key: found.facts[key] for key in facts} == facts
    assert {f.topic for f in found.warnings} == topics


@pytest.mark.parametrize(
    ("rate_hz", "level", "fix"),
    [
        (60.0, "", ""), (23.976, "", ""), (59.88, "fact", ""), (119.6, "fact", ""),
        (37.3, "warning", "keypose convert FILE OUT --rate 50"), (61.0, "warning", "keypose convert FILE OUT --rate 60"),
    ],
)  # fmt: skip
def test_rates_that_a_clock_explains_are_left_alone(human: Scene, rate_hz: float, level: str, fix: str) -> None:
    found = [
        f
        for f in examine(changed(human, motion=replace(human.animations[0], rate_hz=rate_hz))).findings
        if f.topic == "rate"
    ]
    assert [(f.level, f.fix) for f in found] == ([(level, fix)] if level else [])


def test_sparse_keys_have_no_frame_rate(human: Scene) -> None:
    """Keys a second apart are no frames: such clips are listed once, whatever their number."""
    from keypose.model import Channel, Clip, Curve, Property

    curve = Curve(np.arange(4.0), np.eye(4)[:, :3])
    clips = tuple(Clip({Channel("Hips", Property.TRANSLATION): curve}, name) for name in "abc")
    found = examine(replace(human, animations=clips))
    (rate,) = [f for f in found.findings if f.topic == "rate"]
    assert rate.level == "fact" and rate.text == "3 of 3 clips have keys but no frame rate: a, b, c"
    assert found.facts["rate_hz"] is None and found.facts["clips"] == 3
