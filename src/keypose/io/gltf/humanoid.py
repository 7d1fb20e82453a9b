"""Roles of joints from VRM's humanoid bones (VRM 0, VRM 1 and VRM animation files).

Source: VRM Consortium, specifications of VRM 0.0, VRMC_vrm-1.0 and VRMC_vrm_animation-1.0, section "Humanoid".
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from keypose.errors import FormatError
from keypose.io.json_values import Json
from keypose.io.notes import Notes

# VRM 1 renamed the thumb: what VRM 0 calls proximal is the metacarpal bone.
THUMB = {"thumb_proximal": "thumb_metacarpal", "thumb_intermediate": "thumb_proximal"}


def roles(root: Json, joint_of_node: Mapping[int, int], notes: Notes) -> dict[str, int]:
    """Role ("hips", "left_upper_arm") -> joint; what is wrong in it is noted, never fatal."""
    found: dict[str, int] = {}
    try:
        for name, node, where in _bones(root):
            role = _snake_case(name)
            joint = joint_of_node.get(node)
            if joint is None:
                notes.add(f"{where}: the humanoid bone '{name[:40]}' names node {node}, which is not in the scene")
            elif role not in ROLES:
                notes.add(f"{where}: '{name[:40]}' is no humanoid bone")
            elif role in found:
                notes.add(f"{where}: the humanoid bone '{name}' appears more than once; the first was kept")
            else:
                found[role] = joint
    except FormatError as error:
        notes.add(f"the humanoid bones could not be read: {error}")
    return found


def _bones(root: Json) -> Iterable[tuple[str, int, str]]:
    extensions = root.get("extensions")
    if extensions is None:
        return
    old = extensions.get("VRM")
    if old is not None:
        humanoid = old.get("humanoid")
        for bone in [] if humanoid is None else humanoid.items("humanBones"):
            name = _snake_case(bone.text("bone"))
            for ours, theirs in THUMB.items():
                if name.endswith(ours):
                    name = name.removesuffix(ours) + theirs
                    break
            yield name, bone.need("node").as_integer(-1), bone.where
    for key in ("VRMC_vrm", "VRMC_vrm_animation"):
        new = extensions.get(key)
        humanoid = None if new is None else new.get("humanoid")
        for name, bone in [] if humanoid is None else humanoid.members("humanBones"):
            yield name, bone.need("node").as_integer(-1), bone.where


def _snake_case(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


def _all_roles() -> frozenset[str]:
    middle = ["hips", "spine", "chest", "upper_chest", "neck", "head", "jaw", "left_eye", "right_eye"]
    limbs = ["upper_leg", "lower_leg", "foot", "toes", "shoulder", "upper_arm", "lower_arm", "hand"]
    fingers = [
        f"{f}_{p}" for f in ["index", "middle", "ring", "little"] for p in ["proximal", "intermediate", "distal"]
    ]
    thumb = ["thumb_metacarpal", "thumb_proximal", "thumb_distal"]
    sides = [f"{side}_{part}" for side in ("left", "right") for part in (*limbs, *fingers, *thumb)]
    return frozenset((*middle, *sides))


ROLES = _all_roles()
