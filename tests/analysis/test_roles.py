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


def test_further_chains_are_named_by_hand() -> None:
    skeleton = samples.open_scene("sample:human").characters[0].skeleton
    found = roles_from_json('{"hips": "Hips", "tail:1": "Spine"}', skeleton)
    assert found.roles["tail:1"] == skeleton.names.index("Spine")
    with pytest.raises(UnknownName):
        roles_from_json('{"tail": "Spine"}', skeleton)
