"""Animals on all fours: their roles under any naming, from every side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from keypose import samples
from keypose.analysis import find_roles
from keypose.model import Pose, Skeleton
from tests.animals import ROLES, dog

FOX = (
    "b_Hip_01 b_Spine01_02 b_Spine02_03 b_Neck_04 b_Head_05 b_RightUpperArm_06 b_RightForeArm_07 b_RightHand_08 "
    "b_LeftUpperArm_09 b_LeftForeArm_010 b_LeftHand_011 b_Tail01_012 b_Tail02_013 b_Tail03_014 b_LeftLeg01_015 "
    "b_LeftLeg02_016 b_LeftFoot01_017 b_LeftFoot02_018 b_RightLeg01_019 b_RightLeg02_020 b_RightFoot01_021 b_RightFoot02_022"
)
PARTS = (
    "hips spine chest neck head right_upper_arm right_lower_arm right_hand left_upper_arm left_lower_arm left_hand tail:1 "
    "tail:2 tail:3 left_upper_leg left_lower_leg left_foot left_toes right_upper_leg right_lower_leg right_foot right_toes"
)
OTHERS = (
    "Pelvis Spine1 Spine2 Neck Head FrontLegUpper.R FrontLegLower.R FrontPaw.R FrontLegUpper.L FrontLegLower.L FrontPaw.L "
    "Tail1 Tail2 Tail3 BackLegUpper.L BackLegLower.L BackPaw.L BackToes.L BackLegUpper.R BackLegLower.R BackPaw.R BackToes.R",
    "Hips Spine1 Spine2 Neck Head R_F_Thigh R_F_Calf R_F_Foot L_F_Thigh L_F_Calf L_F_Foot Tail1 Tail2 Tail3 L_B_Thigh "
    "L_B_Calf L_B_Foot L_B_Toe R_B_Thigh R_B_Calf R_B_Foot R_B_Toe",
    "pelvis spine_01 spine_02 neck head foreleg_upper_r foreleg_lower_r forefoot_r foreleg_upper_l foreleg_lower_l forefoot_l "
    "tail_01 tail_02 tail_03 hindleg_upper_l hindleg_lower_l hindfoot_l hindtoe_l hindleg_upper_r hindleg_lower_r hindfoot_r hindtoe_r",
    "Hips Spine Chest Neck Head R_Humerus R_Radius R_FrontHoof L_Humerus L_Radius L_FrontHoof Tail1 Tail2 Tail3 L_Femur "
    "L_Tibia L_Hock L_BackHoof R_Femur R_Tibia R_Hock R_BackHoof",
)  # fmt: skip


@pytest.mark.data
@pytest.mark.parametrize("names", [FOX, *OTHERS, " ".join(f"j{n}" for n in range(22))])
def test_the_fox_under_any_naming(data_dir: Path, names: str) -> None:
    skeleton = samples.open_scene(str(data_dir / "gltf/khronos/Fox.glb")).character.skeleton
    own = dict(zip(FOX.split(), names.split(), strict=True))
    other = Skeleton(
        tuple(own.get(name, f"x{n}") for n, name in enumerate(skeleton.names)), skeleton.parents, skeleton.rest
    )
    found = find_roles(other)
    assert found.on_all_fours and not found.missing and any("quadruped" in note for note in found.notes)
    assert {skeleton.names[j]: role for role, j in found.roles.items()} == dict(
        zip(FOX.split(), PARTS.split(), strict=True)
    )


@pytest.mark.parametrize("facing", [0.0, 90.0, 180.0, -75.0])
@pytest.mark.parametrize("turned", [False, True])
def test_a_dog_from_every_side(facing: float, turned: bool) -> None:
    skeleton = dog(turned=turned, facing_deg=facing)
    found = find_roles(skeleton)
    assert found.on_all_fours and not found.is_humanoid
    assert {role: skeleton.names[j] for role, j in found.roles.items()} == ROLES


def test_places_alone_tell_left_from_right() -> None:
    skeleton = dog()
    bare = Skeleton(tuple(f"j{n}" for n in range(len(skeleton.names))), skeleton.parents, skeleton.rest)
    found = find_roles(bare)
    assert {role: skeleton.names[j] for role, j in found.roles.items()} == ROLES
    assert max(found.confidence.values()) < 1.0


def test_what_has_four_legs_and_no_head_or_lies_is_none() -> None:
    skeleton = dog()
    keep = [
        j for j, n in enumerate(skeleton.names) if n not in ("Throat1", "Throat2", "Skull", "Snout", "EarL", "EarR")
    ]
    rest = skeleton.rest
    headless = Skeleton(
        tuple(skeleton.names[j] for j in keep),
        np.array([keep.index(p) if p >= 0 else -1 for p in skeleton.parents[keep]], np.int32),
        Pose(rest.translations[keep], rest.rotations[keep], rest.scales[keep]),
    )
    assert not find_roles(headless).on_all_fours
    turned = np.array(rest.rotations)
    turned[1] = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
    assert not find_roles(skeleton, Pose(rest.translations, turned, rest.scales)).on_all_fours, "it lies on its side"
