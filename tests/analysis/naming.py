"""Which joint plays which role under the namings of the field, written down by hand from the joints' names in the files.

``{S}``, ``{s}`` and ``{L}`` stand for Left, l and L (and so on for the right side), ``{n}`` for the bone of a finger. ``-`` says
that nothing plays the role; ``a|b`` that either is right, as where a chest is one of the middle joints of a spine.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from keypose.analysis.roles import ROLES, SIDES

FINGERS = ("thumb", "index", "middle", "ring", "little")
BONES = dict.fromkeys(FINGERS, ("proximal", "intermediate", "distal")) | {"thumb": ("metacarpal", "proximal", "distal")}
TRUNK = ("hips", "spine", "chest", "upper_chest", "neck", "head", "jaw")
LIMBS = ("shoulder", "upper_arm", "lower_arm", "hand", "upper_leg", "lower_leg", "foot", "toes", "eye")


@dataclass(frozen=True)
class Naming:
    """A naming: roles of the trunk and of a side in the orders above, and fingers by how their bones are called."""

    title: str
    trunk: str
    limbs: str
    fingers: Mapping[str, str] = field(default_factory=dict[str, str])
    bones: int = 3
    prefix: str = ""
    left: Mapping[str, str] = field(
        default_factory=dict[str, str]
    )  # where one file spells its left side in another way

    def roles(self) -> dict[str, str]:
        """Role -> name, for all roles."""
        found = {
            role: self.prefix + name if name != "-" else "-"
            for role, name in zip(TRUNK, self.trunk.split(), strict=True)
        }
        for side in SIDES:
            words = {"S": side.title(), "s": side[0], "L": side[0].upper()}
            for part, name in zip(LIMBS, self.limbs.split(), strict=True):
                found[f"{side}_{part}"] = self.prefix + name.format(**words) if name != "-" else "-"
            for finger in FINGERS:
                for n, bone in enumerate(BONES[finger]):
                    name = self.fingers.get(finger, "-")
                    there = name != "-" and (n < self.bones or "{n}" not in name) and ("{n}" in name or n == 0)
                    found[f"{side}_{finger}_{bone}"] = self.prefix + name.format(n=n + 1, **words) if there else "-"
        found.update({f"left_{role}": name for role, name in self.left.items()})
        assert set(found) == set(ROLES)
        return found


def of(template: str, *words: str) -> dict[str, str]:
    """Fingers by one template, whose ``{F}`` is the finger's word."""
    return {finger: template.replace("{F}", word) for finger, word in zip(FINGERS, words, strict=True) if word != "-"}


_MIXAMO_LIMBS = "{S}Shoulder {S}Arm {S}ForeArm {S}Hand {S}UpLeg {S}Leg {S}Foot {S}ToeBase"
_MIXAMO_FINGERS = of("{S}Hand{F}{n}", "Thumb", "Index", "Middle", "Ring", "Pinky")
_MAKEHUMAN = Naming(
    "MakeHuman",
    "root spine05 spine04|spine03|spine02 spine01 neck01 head jaw",
    "shoulder01.{L} upperarm01.{L} lowerarm01.{L} wrist.{L} upperleg01.{L} lowerleg01.{L} foot.{L} toe1-1.{L} eye.{L}",
    of("finger{F}-{n}.{L}", "1", "2", "3", "4", "5"),
)
_BIPED = Naming(
    "Biped",
    "Hips Spine Spine1|Spine2 Spine3 Neck Head -",
    _MIXAMO_LIMBS.replace("ToeBase", "FootThumb1") + " -",
    _MIXAMO_FINGERS,
    left={"hand": "Lefthand"}
    | {f"little_{bone}": f"LeftHandRingPinky{n + 1}" for n, bone in enumerate(BONES["little"])},
)
_FOUR_SPINES = "Hips Spine Spine1|Spine2 Spine3 Neck Head -"
_ICLONE = Naming(
    "Character Creator",
    "CC_Base_Hip CC_Base_Waist CC_Base_Spine01 CC_Base_Spine02 CC_Base_NeckTwist01 CC_Base_Head CC_Base_JawRoot",
    "CC_Base_{L}_Clavicle CC_Base_{L}_Upperarm CC_Base_{L}_Forearm CC_Base_{L}_Hand CC_Base_{L}_Thigh CC_Base_{L}_Calf "
    "CC_Base_{L}_Foot CC_Base_{L}_ToeBase CC_Base_{L}_Eye",
    of("CC_Base_{L}_{F}{n}", "Thumb", "Index", "Mid", "Ring", "Pinky"),
)
_CMU = Naming(
    "CMU, Acclaim",
    "root lowerback upperback thorax lowerneck head -",
    "{s}clavicle {s}humerus {s}radius {s}wrist {s}femur {s}tibia {s}foot {s}toes -",
    {"thumb": "{s}thumb"},
)
_CMU_BVH = Naming("CMU, BVH", "Hips LowerBack Spine Spine1 Neck Head -", _MIXAMO_LIMBS + " -", {"thumb": "{L}Thumb"})
_CMU_BVH_FINGER = Naming("CMU, BVH", _CMU_BVH.trunk, _CMU_BVH.limbs, {"thumb": "{L}Thumb", "index": "{S}HandIndex1"})
_GENO = Naming("Geno", _FOUR_SPINES, _MIXAMO_LIMBS + " -", _MIXAMO_FINGERS)
_FAIR = Naming("Animated Drawings", _FOUR_SPINES, _MIXAMO_LIMBS + " -", {"thumb": "{S}HandThumb1"})

NAMINGS: Mapping[str, Naming] = {
    **{f"asf_amc/cmu_02/02{take}": _CMU for take in (".asf", "_01.amc", "_02.amc", "_03.amc", "_04.amc", "_05.amc")},
    "cmu_01_01/01.asf": _CMU,
    "cmu_01_01/01_01.amc": _CMU,
    "cmu_01_01/01_01.bvh": _CMU_BVH,
    "bvh/cmu_cgspeed/cmu_12_01_walk.bvh": _CMU_BVH_FINGER,
    **{f"bvh/cmu_iclone_002/002_0{n}.bvh": _ICLONE for n in range(1, 5)},
    **{f"bvh/cmu_iclone_007/007_{n:02}.bvh": _ICLONE for n in range(1, 13)},
    "bvh/fair1/dab.bvh": _FAIR,
    "bvh/fair1/zombie.bvh": _FAIR,
    "bvh/freebvh/test_freebvh.bvh": Naming(
        "Mixamo",
        "Hips Spine Spine1 Spine2 Neck Head -",
        _MIXAMO_LIMBS + " {S}Eye",
        _MIXAMO_FINGERS,
        prefix="mixamorig:",
    ),
    "bvh/geno/Geno_bind.bvh": _GENO,
    "bvh/geno/Geno_stance.bvh": _GENO,
    "bvh/rokoko/jesse_dance.bvh": Naming(
        "Rokoko", "Hips Spine Spine1 Spine2 Neck Head -", _MIXAMO_LIMBS + " -", _MIXAMO_FINGERS
    ),
    "collada/ozz/astro_maya.dae": Naming(
        "Maya",
        "root spine01 spine02 - neck01 head -",
        "{L}_clavicle {L}_shoulder {L}_elbow {L}_wrist {L}_hip {L}_knee_01 {L}_ankle {L}_toeBall -",
        of("{L}_{F}_0{n}", "thumb", "index", "middle", "-", "pinky"),
        bones=2,
    ),
    "collada/ozz/seymour.dae": Naming(
        "Maya, bones of the body",
        "root spine - - neck null_head -",
        "- {s}_humerus {s}_ulna {s}_wrist {s}_hip {s}_knee {s}_ankle - -",
    ),
    "collada/ozz/skeleton.dae": _BIPED,
    "collada/ozz/walk.dae": _BIPED,
    "fbx/geno/Geno.fbx": _GENO,
    **{f"fbx/ozz_pab/{n}.fbx": _BIPED for n in ("arnaud", "crossarms", "jog", "run", "skeleton", "walk")},
    "fbx/ufbx_skin/maya_kenney_character_7700_binary.fbx": Naming(
        "Kenney",
        "Hips Spine Chest UpperChest Neck Head -",
        _MIXAMO_LIMBS.replace("ToeBase", "Toes") + " -",
        # the thumb has two bones and a tip
        of("{S}Hand{F}{n}", "-", "Index", "-", "-", "-"),
        left={"thumb_metacarpal": "LeftHandThumb1", "thumb_proximal": "LeftHandThumb2"},
    ),
    "gltf/cc0/Knight.glb": Naming(
        "KayKit",
        "hips spine chest - - head -",
        "- upperarm.{s} lowerarm.{s} wrist.{s} upperleg.{s} lowerleg.{s} foot.{s} toes.{s} -",
    ),
    "gltf/cc0/robot.glb": Naming(
        "Blender, goals for feet",
        "Body Abdomen Torso_2 - Neck Head_2 -",
        "Shoulder.{L}_2 UpperArm.{L} LowerArm.{L} Palm2.{L} UpperLeg.{L} LowerLeg.{L}_2 Foot.{L}_2 - -",
        # four fingers, of which the first bones are called Thumb, Index, Middle1 and Ring1
        {},
    ),
    "gltf/khronos/cesium_man.gltf": Naming(
        "none (node_7)",
        "node_2 node_11 node_12 - node_19 node_20 -",
        "- node_16 node_17 node_18 node_7 node_8 node_9 node_10 -",
    ),
    "makehuman/default.mhskel": _MAKEHUMAN,
    "makehuman/face-poseunits.bvh": _MAKEHUMAN,
    "makehuman/tpose.bvh": _MAKEHUMAN,
    "makehuman/walk1.bvh": Naming(
        "MakeHuman of old",
        "Root Spine1 Spine2 Spine3 Neck Head Jaw",
        "Clavicle_{L} UpArm_{L} LoArm_{L} Hand_{L} UpLeg_{L} LoLeg_{L} Foot_{L} Toe_{L} Eye_{L}",
        of("{F}{n}_{L}", "Thumb", "Index", "Middle", "Ring", "Pinky"),
    ),
    "usd/RiggedFigure.usdz": Naming(
        "none (arm_joint_L_2)",
        "torso_joint_1 torso_joint_2 torso_joint_3 - neck_joint_1 neck_joint_2 -",
        "- arm_joint_{L}_1 arm_joint_{L}_2 arm_joint_{L}_3 leg_joint_{L}_1 leg_joint_{L}_2 leg_joint_{L}_3 leg_joint_{L}_5 -",
    ),
}

# What the rules above cannot say: single roles by file.
EXCEPTIONS: Mapping[str, Mapping[str, str]] = {
    "fbx/ufbx_skin/maya_kenney_character_7700_binary.fbx": {
        "right_thumb_metacarpal": "RightHandThumb1",
        "right_thumb_proximal": "RightHandThumb2",
    },
    "gltf/cc0/robot.glb": {
        f"{side}_{finger}_{bone}": f"{word}.{side[0].upper()}"
        for side in SIDES
        for finger, words in (
            ("thumb", ("Thumb", "Thumb2")),
            ("index", ("Index", "Index2")),
            ("middle", ("Middle1", "Middle2")),
            ("ring", ("Ring1", "Ring2")),
        )
        for bone, word in zip(BONES[finger], words, strict=False)
    },
    # the other side of this one mirrors the names' numbers
    "gltf/khronos/cesium_man.gltf": dict(
        zip(
            (
                "right_upper_arm",
                "right_lower_arm",
                "right_hand",
                "right_upper_leg",
                "right_lower_leg",
                "right_foot",
                "right_toes",
            ),
            ("node_13", "node_14", "node_15", "node_3", "node_4", "node_5", "node_6"),
            strict=True,
        )
    ),
}


def expected_roles(file: str) -> dict[str, str]:
    """Role -> name of the joint that plays it in a file of the data folder, ``-`` where none does."""
    return NAMINGS[file].roles() | dict(EXCEPTIONS.get(file, {}))
