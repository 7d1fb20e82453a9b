"""Roles of joints under the namings of the field, without names, and saved maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from keypose import evaluate, samples
from keypose.analysis import find_roles, roles_from_json
from keypose.analysis.roles import REQUIRED, ROLES
from keypose.errors import KeyposeError, ShapeError, UnknownName
from keypose.model import Clip, Motion, Pose, Skeleton

# hips, spine, neck, head; then for a side: shoulder, upper arm, lower arm, hand, upper leg, lower leg, foot, toes
TRUNK = ("hips", "spine", "neck", "head")
LIMBS = ("shoulder", "upper_arm", "lower_arm", "hand", "upper_leg", "lower_leg", "foot", "toes")
MIXAMO = "Hips Spine Neck Head", "{S}Shoulder {S}Arm {S}ForeArm {S}Hand {S}UpLeg {S}Leg {S}Foot {S}ToeBase"
CMU = "root lowerback lowerneck head", "{s}clavicle {s}humerus {s}radius {s}wrist {s}femur {s}tibia {s}foot {s}toes"
CMU_BVH = "Hips LowerBack Neck Head", MIXAMO[1]
ICLONE = (
    "CC_Base_Hip CC_Base_Waist CC_Base_NeckTwist01 CC_Base_Head",
    "CC_Base_{L}_Clavicle CC_Base_{L}_Upperarm CC_Base_{L}_Forearm CC_Base_{L}_Hand CC_Base_{L}_Thigh CC_Base_{L}_Calf "
    "CC_Base_{L}_Foot CC_Base_{L}_ToeBase",
)
MAKEHUMAN = (
    "root spine05 neck01 head",
    "shoulder01.{L} upperarm01.{L} lowerarm01.{L} wrist.{L} upperleg01.{L} lowerleg01.{L} foot.{L} toe1-1.{L}",
)
BIPED = "Hips Spine Neck Head", "{S}Shoulder {S}Arm {S}ForeArm * {S}UpLeg {S}Leg {S}Foot {S}FootThumb1"
MAYA = (
    "root spine01 neck01 head",
    "{L}_clavicle {L}_shoulder {L}_elbow {L}_wrist {L}_hip {L}_knee_01 {L}_ankle {L}_toeBall",
)
VRM = (
    "hips spine neck head",
    "shoulder.{L} upper_arm.{L} lower_arm.{L} hand.{L} upper_leg.{L} lower_leg.{L} foot.{L} toes.{L}",
)
KNIGHT = "hips spine - head", "- upperarm.{s} lowerarm.{s} wrist.{s} upperleg.{s} lowerleg.{s} foot.{s} toes.{s}"
ROBOT = (
    "Body Abdomen Neck Head_2",
    "Shoulder.{L}_2 UpperArm.{L} LowerArm.{L} Palm2.{L} UpperLeg.{L} LowerLeg.{L}_2 Foot.{L}_2 -",
)
SEYMOUR = "root spine neck *", "- {s}_humerus {s}_ulna {s}_wrist {s}_hip {s}_knee {s}_ankle -"
WALK1 = "Root Spine1 Neck Head", "Clavicle_{L} UpArm_{L} LoArm_{L} Hand_{L} * LoLeg_{L} Foot_{L} Toe_{L}"

FILES = {
    "asf_amc/cmu_02/02.asf": CMU,
    "cmu_01_01/01.asf": CMU,
    "cmu_01_01/01_01.bvh": CMU_BVH,
    "bvh/cmu_cgspeed/cmu_12_01_walk.bvh": CMU_BVH,
    "bvh/cmu_iclone_002/002_01.bvh": ICLONE,
    "bvh/cmu_iclone_007/007_02.bvh": ICLONE,
    "bvh/fair1/zombie.bvh": MIXAMO,
    "bvh/freebvh/test_freebvh.bvh": tuple(" ".join(f"mixamorig:{word}" for word in part.split()) for part in MIXAMO),
    "bvh/geno/Geno_bind.bvh": MIXAMO,
    "bvh/rokoko/jesse_dance.bvh": (MIXAMO[0], MIXAMO[1].replace("ToeBase", "*")),
    "fbx/geno/Geno.fbx": MIXAMO,
    "fbx/ozz_pab/arnaud.fbx": BIPED,
    "fbx/ozz_pab/walk.fbx": BIPED,
    "collada/ozz/skeleton.dae": BIPED,
    "collada/ozz/astro_maya.dae": MAYA,
    "collada/ozz/seymour.dae": SEYMOUR,
    "fbx/ufbx_skin/maya_kenney_character_7700_binary.fbx": (MIXAMO[0], MIXAMO[1].replace("ToeBase", "Toes")),
    "gltf/cc0/Knight.glb": KNIGHT,
    "gltf/cc0/robot.glb": ROBOT,
    "makehuman/default.mhskel": MAKEHUMAN,
    "makehuman/walk1.bvh": WALK1,
    "vrm/basic_armature.vrm": VRM,
}


def expected(naming: tuple[str, ...]) -> dict[str, str]:
    asked = dict(zip(TRUNK, naming[0].split(), strict=True))
    for side in ("left", "right"):
        words = {"S": side.title(), "s": side[0], "L": side[0].upper()}
        asked |= {f"{side}_{part}": word.format(**words) for part, word in zip(LIMBS, naming[1].split(), strict=True)}
    return asked


@pytest.mark.data
@pytest.mark.parametrize("file", FILES)
def test_the_namings_of_the_field(data_dir: Path, file: str) -> None:
    skeleton = samples.open_scene(str(data_dir / file)).characters[0].skeleton
    found = find_roles(skeleton)
    assert found.is_humanoid, found.missing
    names = {role: skeleton.names[joint] for role, joint in found.roles.items()}
    for role, asked in expected(FILES[file]).items():
        if asked == "-":
            assert role not in names
        elif not asked.endswith("*"):
            assert names.get(role) == asked, role


@pytest.mark.data
@pytest.mark.parametrize("file", ["gltf/khronos/Fox.glb", "fbx/ozz/robot.fbx", "gltf/cc0/greenman.glb"])
def test_what_is_no_humanoid(data_dir: Path, file: str) -> None:
    found = find_roles(samples.open_scene(str(data_dir / file)).characters[0].skeleton)
    assert not found.is_humanoid
    if "Fox" in file:
        assert found.on_all_fours and any("quadruped" in note for note in found.notes)


def test_the_built_in_human_has_the_roles_that_it_says() -> None:
    character = samples.open_scene("sample:human").characters[0]
    found = find_roles(character.skeleton)
    assert dict(found.roles) == dict(character.roles)
    assert set(found.confidence.values()) == {1.0}
    assert list(found.roles) == [role for role in ROLES if role in found.roles]


def unnamed(skeleton: Skeleton) -> Skeleton:
    return Skeleton(tuple(f"j{n}" for n in range(len(skeleton.names))), skeleton.parents, skeleton.rest)


def test_places_alone_are_enough_for_the_body() -> None:
    character = samples.open_scene("sample:human").characters[0]
    found = find_roles(unnamed(character.skeleton))
    assert found.is_humanoid and any("places alone" in note for note in found.notes)
    assert {role: found.roles[role] for role in REQUIRED} == {role: character.roles[role] for role in REQUIRED}
    assert max(found.confidence.values()) < 1.0


@pytest.mark.data
@pytest.mark.parametrize(
    "file", ["asf_amc/cmu_02/02.asf", "bvh/freebvh/test_freebvh.bvh", "vrm/minimal.vrm", "vrm/basic_armature.vrm"]
)
def test_places_alone_agree_with_names_on_limbs(data_dir: Path, file: str) -> None:
    skeleton = samples.open_scene(str(data_dir / file)).characters[0].skeleton
    named, blind = find_roles(skeleton), find_roles(unnamed(skeleton))
    limbs = [role for role in REQUIRED if role not in ("head", "spine")]
    assert {role: blind.roles[role] for role in limbs} == {role: named.roles[role] for role in limbs}


def test_turning_the_body_round_keeps_left_and_right() -> None:
    skeleton = unnamed(samples.open_scene("sample:human").characters[0].skeleton)
    rest = skeleton.rest
    for degrees in (90, 180, 270):
        half = np.radians(degrees) / 2
        rotations = np.array(rest.rotations)
        rotations[0] = [np.cos(half), 0, np.sin(half), 0]
        turned = Pose(rest.translations, rotations, rest.scales)
        assert dict(find_roles(skeleton, turned).roles) == dict(find_roles(skeleton).roles)


@pytest.mark.data
def test_a_collapsed_rest_pose_needs_a_frame(data_dir: Path) -> None:
    scene = samples.open_scene(str(data_dir / "bvh/cmu_iclone_002/002_01.bvh"))
    skeleton, motion = unnamed(scene.characters[0].skeleton), scene.animations[0]
    assert isinstance(motion, (Clip, Motion))
    pose = evaluate.sample(motion, scene.characters[0].skeleton, motion.start_s)
    assert len(find_roles(skeleton, pose).roles) >= len(find_roles(skeleton).roles)


def test_known_roles_are_kept() -> None:
    skeleton = samples.open_scene("sample:human").characters[0].skeleton
    found = find_roles(skeleton, known={"hips": 3, "own": 5})
    assert found.roles["hips"] == 3 and found.roles["own"] == 5 and found.confidence["own"] == 1.0


def test_a_map_is_saved_and_read_again() -> None:
    skeleton = samples.open_scene("sample:human").characters[0].skeleton
    found = find_roles(skeleton)
    again = roles_from_json(found.to_json(skeleton), skeleton)
    assert dict(again.roles) == dict(found.roles)


@pytest.mark.parametrize(
    ("text", "error", "says"),
    [
        ("[1, 2]", ShapeError, "JSON object"),
        ("{", ShapeError, "JSON object"),
        ('{"hisp": "Hips"}', UnknownName, "nearest: 'hips'"),
        ('{"hips": "Hisp"}', UnknownName, "nearest: 'Hips'"),
    ],
)
def test_a_damaged_map_is_refused(text: str, error: type[KeyposeError], says: str) -> None:
    skeleton = samples.open_scene("sample:human").characters[0].skeleton
    with pytest.raises(error, match=says):
        roles_from_json(text, skeleton)


def test_odd_skeletons_have_no_roles_and_no_crash() -> None:
    rng = np.random.default_rng(5)
    words = ["left", "right", "hand", "foot", "head", "arm", "leg", "spine", "x", "finger1", "toe", "eye", ""]
    for _ in range(300):
        count = int(rng.integers(1, 40))
        parents = np.array([-1, *(int(rng.integers(0, n)) for n in range(1, count))])
        names = tuple(f"{rng.choice(words)}{rng.choice(words)}_{n}" for n in range(count))
        rest = Pose(
            rng.normal(size=(count, 3)) * rng.choice([0.0, 1.0]),
            np.tile([1.0, 0, 0, 0], (count, 1)),
            np.ones((count, 3)),
        )
        found = find_roles(Skeleton(names, parents, rest))
        assert len(set(found.roles.values())) == len(found.roles)
        assert set(found.roles) == set(found.confidence)
