"""VRM 0, VRM 1 and VRMA: real files, laws of expressions, facing and round trips, the Khronos validator, damage."""

from __future__ import annotations

import doctest
import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import keypose.io
from keypose.deform import deform_part
from keypose.errors import FormatError
from keypose.evaluate import sample_morphs, world
from keypose.io.gltf.humanoid import ROLES
from keypose.io.gltf.vrm_writer import REQUIRED
from keypose.model import (
    Channel,
    Character,
    Clip,
    Curve,
    CurveKind,
    Mesh,
    MorphSet,
    Part,
    Pose,
    Property,
    Scene,
    Skeleton,
)
from tests.conftest import ROOT, data_files, find_data_dir
from tests.io.damage import load_damaged
from tests.io.gltf_node import validate
from tests.io.test_gltf_validator import OF_THE_SOURCE

REAL = [p for p in data_files("vrm/*.vrm*") if p.name not in ("empty.vrm", "human_bone.vrm")]


def json_of(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length])


def repacked(path: Path, document: dict[str, Any], target: Path) -> Path:
    """The file with another JSON."""
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    target.write_bytes(
        struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest
    )
    return target


def errors(*files: Path) -> list[str]:
    return [
        f"{file.name}: {code}: {text}"
        for file, report in zip(files, validate(*files), strict=True)
        for severity, code, text in report
        if severity == 0 or (severity == 1 and code not in OF_THE_SOURCE)
    ]


# --- a made figure ---------------------------------------------------------------------------------------------------

PLACES = {
    "hips": ("", (0, 1, 0)), "spine": ("hips", (0, 0.1, 0)), "head": ("spine", (0, 0.5, 0)),
    **{f"{s}_upper_leg": ("hips", (x * 0.1, -0.05, 0)) for s, x in (("left", 1), ("right", -1))},
    **{f"{s}_lower_leg": (f"{s}_upper_leg", (0, -0.45, 0)) for s in ("left", "right")},
    **{f"{s}_foot": (f"{s}_lower_leg", (0, -0.45, 0.02)) for s in ("left", "right")},
    **{f"{s}_upper_arm": ("spine", (x * 0.15, 0.35, 0)) for s, x in (("left", 1), ("right", -1))},
    **{f"{s}_lower_arm": (f"{s}_upper_arm", (x * 0.3, 0, 0)) for s, x in (("left", 1), ("right", -1))},
    **{f"{s}_hand": (f"{s}_lower_arm", (x * 0.25, 0, 0)) for s, x in (("left", 1), ("right", -1))},
}  # fmt: skip


def figure() -> Character:
    names = tuple(PLACES)
    parents = [-1 if not above else names.index(above) for above, _ in PLACES.values()]
    translations = np.array([at for _, at in PLACES.values()], np.float32)
    count = len(names)
    rest = Pose(translations, np.tile(np.float32([1, 0, 0, 0]), (count, 1)), np.ones((count, 3), np.float32))
    face = Mesh(np.float32([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0]]), [[0, 1, 2], [2, 1, 3]])
    deltas = np.zeros((3, 4, 3), np.float32)
    deltas[0, 0], deltas[1, 1], deltas[2, 2:] = (0, 0, 0.1), (0, 0, 0.2), (0.1, 0, 0)
    morphs = MorphSet.from_dense(("smile_L", "smile_R", "aa"), deltas)
    part = Part("face", face, joint=names.index("head"), morphs=morphs)
    roles = {role: j for j, role in enumerate(names)}
    return Character(Skeleton(names, parents, rest), (part,), "figure", ("smile_L", "smile_R", "aa"), roles=roles)


def vrm_one(folder: Path) -> Path:
    """A VRM 1 with a bound expression, look-at, first person and spring bones."""
    path = folder / "one.vrm"
    keypose.io.save(figure(), path)
    document = json_of(path)
    names = [node.get("name") for node in document["nodes"]]
    head, hand = names.index("head"), names.index("left_hand")
    face = next(i for i, node in enumerate(document["nodes"]) if "mesh" in node)
    document["extensions"]["VRMC_vrm"] |= {
        "meta": {"name": "One", "authors": ["A", "B"], "licenseUrl": "https://vrm.dev/licenses/1.0/", "modification": "prohibited"},
        "lookAt": {"type": "bone", "offsetFromHeadBone": [0, 0.06, 0], "rangeMapVerticalUp": {"inputMaxValue": 90, "outputScale": 8}},
        "firstPerson": {"meshAnnotations": [{"node": face, "type": "thirdPersonOnly"}]},
        "expressions": {
            "preset": {
                "happy": {
                    "isBinary": False, "overrideMouth": "blend",
                    "morphTargetBinds": [{"node": face, "index": 0, "weight": 1.0}, {"node": face, "index": 1, "weight": 0.5}],
                },
                "aa": {"morphTargetBinds": [{"node": face, "index": 2, "weight": 1.0}]},
                "neutral": {},
            },
            "custom": {"wink": {"isBinary": True, "morphTargetBinds": [{"node": face, "index": 0, "weight": 0.25}]}},
        },
    }  # fmt: skip
    document["extensions"]["VRMC_springBone"] = {
        "specVersion": "1.0",
        "colliders": [{"node": head, "shape": {"sphere": {"offset": [0, 0.1, 0], "radius": 0.1}}}],
        "colliderGroups": [{"name": "skull", "colliders": [0]}],
        "springs": [{"name": "sleeve", "center": head, "colliderGroups": [0], "joints": [
            {"node": names.index("left_lower_arm"), "stiffness": 0.7, "gravityDir": [0, -1, 0]}, {"node": hand}]}],
    }  # fmt: skip
    document["extensionsUsed"] = ["VRMC_springBone", "VRMC_vrm"]
    return repacked(path, document, folder / "bound.vrm")


# --- real files ------------------------------------------------------------------------------------------------------


@pytest.mark.data
def test_real_files_have_the_stated_facts(data_dir: Path) -> None:
    stated = {
        "basic_armature.vrm": (53, 17), "debug_robot.vrm": (53, 18), "minimal.vrm": (17, 17), "sphere.vrm": (22, 0),
        "idle_loop.vrma": (22, 0), "nop.vrma": (53, 0), "test.vrma": (51, 1),
    }  # fmt: skip
    for name, (bones, expressions) in stated.items():
        scene = keypose.io.load(data_dir / "vrm" / name)
        assert scene.format == "vrm" and len(scene.character.roles) == bones
        assert len(scene.character.extras["vrm"].get("expressions", {})) == expressions
        assert set(scene.character.roles) <= ROLES
    for name, place in (("empty.vrm", "extensions"), ("human_bone.vrm", "extensions.VRM.humanoid.humanBones[0].node")):
        with pytest.raises(FormatError) as error:
            keypose.io.load(data_dir / "vrm" / name)
        assert error.value.where == place


@pytest.mark.data
def test_all_of_them_face_forward(data_dir: Path) -> None:
    """The left side is at +X where +Z is forward and Y up; toes point forward where there are any."""
    for path in REAL:
        character = keypose.io.load(path).character
        at = np.asarray(world(character.skeleton, character.skeleton.rest))[:, :3, 3]
        roles = character.roles
        assert at[roles["left_upper_arm"], 0] > 0 > at[roles["right_upper_arm"], 0], path.name
        assert at[roles["left_foot"], 0] > 0 > at[roles["right_foot"], 0], path.name
        assert at[roles["head"], 1] > at[roles["hips"], 1], path.name
        if "left_toes" in roles:
            assert at[roles["left_toes"], 2] > at[roles["left_foot"], 2], path.name


@pytest.mark.data
def test_written_files_have_no_errors_and_come_back(data_dir: Path, tmp_path: Path) -> None:
    written: list[Path] = []
    for path in REAL:
        scene = keypose.io.load(path)
        target = tmp_path / path.name
        keypose.io.save(scene, target)
        again = keypose.io.load(target)
        written.append(target)
        assert again.character.skeleton.names == scene.character.skeleton.names
        assert again.character.morph_names == scene.character.morph_names
        assert dict(again.character.roles) == dict(scene.character.roles)
        for key in ("meta", "lookAt", "firstPerson", "expressions", "springBone"):
            a, b = (s.character.extras["vrm"].get(key) for s in (scene, again))
            assert a == b or (not a and not b), (path.name, key)
        for name in ("translations", "rotations", "scales"):
            assert np.array_equal(
                getattr(scene.character.skeleton.rest, name), getattr(again.character.skeleton.rest, name)
            )
        for clip, copy in zip(scene.animations, again.animations, strict=True):
            assert isinstance(clip, Clip) and isinstance(copy, Clip)
            for channel, curve in clip.curves.items():
                if channel in copy.curves:
                    assert np.array_equal(curve.values, copy.curves[channel].values)
                else:  # only what stands still may be missing
                    assert np.ptp(curve.values, axis=0).max() < 1e-6, channel
    assert len(written) == 7 and errors(*written) == []


@pytest.mark.data
def test_the_weight_of_an_expression_moves_with_the_animation(data_dir: Path, tmp_path: Path) -> None:
    path = data_dir / "vrm/test.vrma"
    scene = keypose.io.load(path)
    document = json_of(path)
    node = document["extensions"]["VRMC_vrm_animation"]["expressions"]["preset"]["happy"]["node"]
    raw = keypose.io.gltf.read(path)  # without VRM: the node moves along X
    moving = raw.animations[0].curve(raw.character.skeleton.names[node], Property.TRANSLATION)
    weight = scene.animations[0].curve("happy", Property.WEIGHT)
    assert np.array_equal(weight.values[:, 0], moving.values[:, 0]) and weight.values.max() > 0.5
    assert Channel(scene.character.skeleton.names[node], Property.TRANSLATION) not in scene.animations[0].curves


# --- expressions -----------------------------------------------------------------------------------------------------


def test_expressions_are_the_sums_of_what_they_bind(tmp_path: Path) -> None:
    scene = keypose.io.load(vrm_one(tmp_path))
    character = scene.character
    assert character.morph_names == ("smile_L", "smile_R", "aa", "happy", "aa (expression)", "neutral", "wink")
    at_rest = world(character.skeleton, character.skeleton.rest)

    def shape(**weights: float) -> np.ndarray:
        row = np.array([weights.get(name, 0.0) for name in character.morph_names])
        return np.asarray(deform_part(character, character.parts[0], at_rest, row))

    assert np.allclose(shape(happy=1.0), shape(smile_L=1.0, smile_R=0.5), atol=1e-7)
    assert np.allclose(shape(wink=0.8), shape(smile_L=0.2), atol=1e-7)
    assert np.allclose(shape(neutral=1.0), shape()) and not np.allclose(shape(aa=1.0), shape())
    kept = character.extras["vrm"]["expressions"]
    assert kept["aa"]["channel"] == "aa (expression)" and kept["happy"]["overrideMouth"] == "blend"
    assert kept["wink"]["isBinary"] is True and not kept["wink"]["preset"]


def test_everything_else_is_kept_through_vrm_and_glb(tmp_path: Path) -> None:
    path = vrm_one(tmp_path)
    scene = keypose.io.load(path)
    keypose.io.save(scene, tmp_path / "again.vrm")
    keypose.io.save(scene, tmp_path / "between.glb")
    keypose.io.save(keypose.io.load(tmp_path / "between.glb"), tmp_path / "through.vrm")
    source = json_of(path)
    names = [node.get("name") for node in source["nodes"]]
    for target in (tmp_path / "again.vrm", tmp_path / "through.vrm"):
        document = json_of(target)
        assert [node.get("name") for node in document["nodes"]][: len(names)] == names
        for extension in ("VRMC_vrm", "VRMC_springBone"):
            a, b = dict(source["extensions"][extension]), dict(document["extensions"][extension])
            assert a.pop("humanoid", None) == b.pop("humanoid", None)
            assert a == b
        assert document["meshes"][0]["extras"]["targetNames"] == ["smile_L", "smile_R", "aa"]
    assert errors(path, tmp_path / "again.vrm", tmp_path / "through.vrm") == []


def test_a_character_from_elsewhere_becomes_a_vrm(tmp_path: Path) -> None:
    notes = keypose.io.save(figure(), tmp_path / "figure.vrm")
    assert any("author" in note for note in notes) and not any("T pose" in note for note in notes)
    block = json_of(tmp_path / "figure.vrm")["extensions"]["VRMC_vrm"]
    assert set(block["humanoid"]["humanBones"]) == {"hips", "spine", "head"} | {
        f"{side}{bone}"
        for side in ("left", "right")
        for bone in ("UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand")
    }
    assert set(block["expressions"]["preset"]) == {"aa"} and set(block["expressions"]["custom"]) == {
        "smile_L",
        "smile_R",
    }
    assert block["meta"]["name"] == "figure" and block["meta"]["licenseUrl"].startswith("https://vrm.dev/")
    assert errors(tmp_path / "figure.vrm") == []


@pytest.mark.slow
def test_the_built_in_human_becomes_a_vrm(tmp_path: Path) -> None:
    from keypose.samples import open_scene

    human = open_scene("sample:human").character
    keypose.io.save(human, tmp_path / "human.vrm")
    again = keypose.io.load(tmp_path / "human.vrm").character
    assert dict(again.roles) == dict(human.roles) and len(again.extras["vrm"]["expressions"]) == len(human.morph_names)
    assert errors(tmp_path / "human.vrm") == []


# --- VRM 0 -----------------------------------------------------------------------------------------------------------


def vrm_zero(folder: Path) -> Path:
    """The figure, turned to -Z as VRM 0 has it, with its extension."""
    character = figure()
    turned = character.skeleton.rest.translations * np.float32([-1, 1, -1])
    skeleton = replace(character.skeleton, rest=replace(character.skeleton.rest, translations=turned))
    path = folder / "zero.glb"
    keypose.io.save(replace(character, skeleton=skeleton), path)
    document = json_of(path)
    names = [node.get("name") for node in document["nodes"]]
    bone = [(n, i) for i, n in enumerate(names) if n in PLACES]
    camel = {n: "".join(p.title() if k else p for k, p in enumerate(n.split("_"))) for n, _ in bone}
    document["extensions"] = {"VRM": {
        "specVersion": "0.0",
        "meta": {"title": "Zero", "author": "Z", "allowedUserName": "Everyone", "violentUssageName": "Allow",
                 "sexualUssageName": "Disallow", "commercialUssageName": "Allow", "licenseName": "CC_BY"},
        "humanoid": {"humanBones": [{"bone": camel[n], "node": i} for n, i in bone]},
        "firstPerson": {"firstPersonBone": names.index("head"), "firstPersonBoneOffset": {"x": 0.01, "y": 0.06, "z": 0.1},
                        "meshAnnotations": [{"mesh": 0, "firstPersonFlag": "ThirdPersonOnly"}], "lookAtTypeName": "Bone",
                        "lookAtVerticalUp": {"curve": [0, 0, 0, 1, 1, 1, 1, 0], "xRange": 80, "yRange": 9}},
        "blendShapeMaster": {"blendShapeGroups": [
            {"name": "Joy", "presetName": "joy", "binds": [{"mesh": 0, "index": 0, "weight": 100}, {"mesh": 0, "index": 1, "weight": 50}]},
            {"name": "Grin", "presetName": "unknown", "binds": [{"mesh": 0, "index": 2, "weight": 30}]}]},
        "secondaryAnimation": {
            "colliderGroups": [{"node": names.index("head"), "colliders": [{"offset": {"x": 0.1, "y": 0.2, "z": 0.3}, "radius": 0.4}]}],
            "boneGroups": [{"comment": "arm", "stiffiness": 0.8, "gravityPower": 0.1, "gravityDir": {"x": 1, "y": 0, "z": 2},
                            "dragForce": 0.3, "center": -1, "hitRadius": 0.05, "bones": [names.index("spine")], "colliderGroups": [0]}]},
    }}  # fmt: skip
    document["extensionsUsed"] = ["VRM"]
    return repacked(path, document, folder / "zero.vrm")


def test_vrm_0_is_turned_and_put_into_the_words_of_vrm_1(tmp_path: Path) -> None:
    scene = keypose.io.load(vrm_zero(tmp_path))
    character, reference = scene.character, figure()
    assert any("half a turn" in note for note in scene.notes)
    at = np.asarray(world(character.skeleton, character.skeleton.rest))[:, :3, 3]
    meant = np.asarray(world(reference.skeleton, reference.skeleton.rest))[:, :3, 3]
    for role in REQUIRED:
        assert np.allclose(at[character.roles[role]], meant[reference.roles[role]], atol=1e-6), role
    vrm = character.extras["vrm"]
    assert vrm["meta"] == {
        "name": "Zero", "authors": ["Z"], "licenseUrl": "https://vrm.dev/licenses/1.0/", "avatarPermission": "everyone",
        "allowExcessivelyViolentUsage": True, "allowExcessivelySexualUsage": False, "commercialUsage": "personalProfit",
    }  # fmt: skip
    assert vrm["lookAt"]["rangeMapVerticalUp"] == {"inputMaxValue": 80.0, "outputScale": 9.0}
    # 0.1 in front of the head's middle: Unity's +z is forward; the head's own axes look back in VRM 0
    world_from_head = np.asarray(world(character.skeleton, character.skeleton.rest))[character.roles["head"], :3, :3]
    assert np.allclose(world_from_head @ vrm["lookAt"]["offsetFromHeadBone"], [-0.01, 0.06, 0.1], atol=1e-6)
    assert vrm["firstPerson"] == [{"node": "head", "type": "thirdPersonOnly"}]
    assert set(vrm["expressions"]) == {"happy", "Grin"} and vrm["expressions"]["happy"]["preset"]
    assert [b["weight"] for b in vrm["expressions"]["happy"]["binds"]] == [1.0, 0.5]
    springs = vrm["springBone"]["springs"]
    chains = sorted([joint["node"] for joint in spring["joints"]] for spring in springs)
    assert chains == [
        ["left_upper_arm", "left_lower_arm", "left_hand"], ["right_upper_arm", "right_lower_arm", "right_hand"], ["spine", "head"],
    ]  # fmt: skip
    assert springs[0]["joints"][0]["gravityDir"] == [-1.0, 0.0, 2.0] and springs[0]["colliderGroups"] == [0]
    keypose.io.save(scene, tmp_path / "out.vrm")
    again = keypose.io.load(tmp_path / "out.vrm").character
    assert {k: v for k, v in again.extras["vrm"].items() if k not in ("version", "meta_0")} == {
        k: v for k, v in vrm.items() if k not in ("version", "meta_0")
    }
    assert errors(tmp_path / "out.vrm") == []


# --- animations ------------------------------------------------------------------------------------------------------


def test_an_animation_with_expressions_comes_back(tmp_path: Path) -> None:
    character = figure()
    times = np.array([0.0, 0.5, 1.0])
    turn = np.float32([[1, 0, 0, 0], [0.8, 0.6, 0, 0], [1, 0, 0, 0]])
    clip = Clip(
        {
            Channel("head", Property.ROTATION): Curve(times, turn, kind=CurveKind.ROTATION),
            Channel("hips", Property.TRANSLATION): Curve(times, np.float32([[0, 1, 0], [0, 1, 1], [0, 1, 2]])),
            Channel("left_hand", Property.TRANSLATION): Curve(
                times, np.float32([[0.25, 0, 0], [0.5, 0, 0], [0, 0, 0]])
            ),
            Channel("aa", Property.WEIGHT): Curve(times, np.float32([[0], [1], [0.25]]), kind=CurveKind.SCALAR),
            Channel("smile_L", Property.WEIGHT): Curve(times, np.float32([[0.5], [0], [0]]), kind=CurveKind.SCALAR),
        },
        "hello",
    )
    notes = keypose.io.save(Scene((character,), (clip,)), tmp_path / "hello.vrma")
    assert any("left_hand.translation" in note for note in notes) and any("no meshes" in note for note in notes)
    block = json_of(tmp_path / "hello.vrma")["extensions"]["VRMC_vrm_animation"]
    assert set(block["expressions"]["preset"]) == {"aa"} and set(block["expressions"]["custom"]) == {"smile_L"}
    once = keypose.io.load(tmp_path / "hello.vrma")
    keypose.io.save(once, tmp_path / "twice.vrma")
    twice = keypose.io.load(tmp_path / "twice.vrma")
    assert once.character.skeleton.names == twice.character.skeleton.names  # nothing piles up
    for scene in (once, twice):
        copy = scene.animations[0]
        assert isinstance(copy, Clip) and set(copy.curves) == set(clip.curves) - {
            Channel("left_hand", Property.TRANSLATION)
        }
        for channel, curve in copy.curves.items():
            assert np.array_equal(curve.values, clip.curves[channel].values) and np.array_equal(curve.times_s, times)
    weights = sample_morphs(once.animations[0], character.morph_names, [0.25])
    assert np.allclose(weights, [[0.25, 0, 0.5]], atol=1e-6)  # it drives the character by name
    assert errors(tmp_path / "hello.vrma", tmp_path / "twice.vrma") == []


def test_what_vrm_cannot_hold_is_refused(tmp_path: Path) -> None:
    character = figure()
    with pytest.raises(FormatError, match="no character"):
        keypose.io.save(Scene(), tmp_path / "a.vrm")
    with pytest.raises(FormatError, match="no animation"):
        keypose.io.save(character, tmp_path / "a.vrma")
    fewer = {role: joint for role, joint in character.roles.items() if role != "left_hand"}
    with pytest.raises(FormatError, match="1 roles that the character has not: left_hand"):
        keypose.io.save(replace(character, roles=fewer), tmp_path / "a.vrm")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("place", "value", "where"),
    [
        (("VRMC_vrm", "humanoid", "humanBones", "hips", "node"), 99, "extensions.VRMC_vrm.humanoid.humanBones.hips.node"),
        (("VRMC_vrm", "expressions", "preset", "happy", "morphTargetBinds", 0, "index"), 3,
         "extensions.VRMC_vrm.expressions.preset.happy.morphTargetBinds[0].index"),
        (("VRMC_vrm", "expressions", "preset", "happy", "morphTargetBinds", 1, "node"), "x",
         "extensions.VRMC_vrm.expressions.preset.happy.morphTargetBinds[1].node"),
        (("VRMC_vrm", "firstPerson", "meshAnnotations"), {}, "extensions.VRMC_vrm.firstPerson.meshAnnotations"),
        (("VRMC_springBone", "springs", 0, "colliderGroups", 0), 1, "extensions.VRMC_springBone.springs[0].colliderGroups[0]"),
        (("VRMC_springBone", "colliders", 0, "node"), -1, "extensions.VRMC_springBone.colliders[0].node"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_its_place(tmp_path: Path, place: tuple[Any, ...], value: Any, where: str) -> None:
    path = vrm_one(tmp_path)
    document = json_of(path)
    item = document["extensions"]
    for key in place[:-1]:
        item = item[key]
    item[place[-1]] = value
    with pytest.raises(FormatError) as error:
        keypose.io.load(repacked(path, document, tmp_path / "wrong.vrm"))
    assert error.value.where == where


def test_a_thousand_damaged_files(tmp_path: Path) -> None:
    keypose.io.save(
        Scene(
            (figure(),), (Clip({Channel("aa", Property.WEIGHT): Curve([0, 1.0], [[0], [1.0]], kind=CurveKind.SCALAR)}),)
        ),
        tmp_path / "hello.vrma",
    )
    files = [vrm_one(tmp_path), vrm_zero(tmp_path), tmp_path / "hello.vrma"]
    data = find_data_dir()
    files += [data / "vrm/minimal.vrm", data / "vrm/test.vrma"] if data else []
    result = load_damaged(files, 1000, tmp_path)
    assert result["wrong"] == []
    assert result["slowest_s"] < 3, result["slowest"]
    assert result["peak_mib"] < 1024
    assert result["loaded"] > 50 and result["refused"] > 400


def test_the_page() -> None:
    result = doctest.testfile(str(ROOT / "docs/formats/vrm.md"), module_relative=False, encoding="utf-8")
    assert result.attempted and not result.failed
