"""What VRM 0 says, in the terms of VRM 1: permissions, look-at, first person, spring bones, names of expressions.

VRM 0 gives vectors in Unity's left-handed axes. In its glTF the character faces -Z; this module is used after the roots
were turned to face +Z, so vectors in a joint's space only change hands (z), those of the world are turned too (x).

Source: VRM Consortium, "VRM 0.0 specification"; VRM Consortium, "VRMC_vrm-1.0", "VRMC_springBone-1.0".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from keypose.io.json_values import Json
from keypose.io.notes import Notes

PRESETS = {
    "joy": "happy", "angry": "angry", "sorrow": "sad", "fun": "relaxed", "a": "aa", "i": "ih", "u": "ou", "e": "ee",
    "o": "oh", "blink": "blink", "blink_l": "blinkLeft", "blink_r": "blinkRight", "lookup": "lookUp",
    "lookdown": "lookDown", "lookleft": "lookLeft", "lookright": "lookRight", "neutral": "neutral",
}  # fmt: skip
_LICENSE = "https://vrm.dev/licenses/1.0/"
_USERS = {"Everyone": "everyone", "ExplicitlyLicensedPerson": "onlySeparatelyLicensedPerson"}
_VIEWS = {"Both": "both", "ThirdPersonOnly": "thirdPersonOnly", "FirstPersonOnly": "firstPersonOnly"}
_STRAIGHT = [0, 0, 0, 1, 1, 1, 1, 0]
_RANGES = {
    "lookAtHorizontalInner": "rangeMapHorizontalInner",
    "lookAtHorizontalOuter": "rangeMapHorizontalOuter",
    "lookAtVerticalDown": "rangeMapVerticalDown",
    "lookAtVerticalUp": "rangeMapVerticalUp",
}
NameOf = Callable[[Json], str]


def meta(item: Json, notes: Notes) -> dict[str, Any]:
    """Permissions; what VRM 0 does not say stays forbidden, as VRM 1 has it."""
    raw = {k: v for k, v in item.object().items() if isinstance(v, str)}
    found: dict[str, Any] = {
        "name": raw.get("title") or "untitled",
        "authors": [raw.get("author") or "unknown"],
        "licenseUrl": _LICENSE,
        "avatarPermission": _USERS.get(raw.get("allowedUserName", ""), "onlyAuthor"),
        "allowExcessivelyViolentUsage": raw.get("violentUssageName") == "Allow",
        "allowExcessivelySexualUsage": raw.get("sexualUssageName") == "Allow",
        "commercialUsage": "personalProfit" if raw.get("commercialUssageName") == "Allow" else "personalNonProfit",
    }
    for theirs, ours in (("version", "version"), ("contactInformation", "contactInformation")):
        if raw.get(theirs):
            found[ours] = raw[theirs]
    if raw.get("reference"):
        found["references"] = [raw["reference"]]
    terms = [raw[k] for k in ("otherLicenseUrl", "otherPermissionUrl") if raw.get(k)]
    if terms:
        found["otherLicenseUrl"] = terms[0]
    if raw.get("licenseName"):
        notes.add(
            f"the licence of VRM 0 ({raw['licenseName'][:60]}) has no counterpart in VRM 1: what it allows beyond use is kept as "
            "forbidden; its text is kept in the character's extras"
        )
    return found


def look_at(first_person: Json, notes: Notes) -> dict[str, Any]:
    """The look-at settings."""
    kind = first_person.text("lookAtTypeName", "Bone")
    found: dict[str, Any] = {
        "type": "expression" if kind == "BlendShape" else "bone",
        "offsetFromHeadBone": _of_joint(first_person.get("firstPersonBoneOffset")),
    }
    for theirs, ours in _RANGES.items():
        item = first_person.get(theirs)
        if item is None:
            continue
        curve = item.object().get("curve", _STRAIGHT)
        if curve != _STRAIGHT:
            notes.add(f"{item.where}: its curve was replaced by a straight line")
        found[ours] = {"inputMaxValue": item.number("xRange", 90.0), "outputScale": item.number("yRange", 10.0)}
    return found


def views(first_person: Json, nodes_of_mesh: Mapping[int, Sequence[str]], mesh_count: int) -> list[dict[str, str]]:
    """Which meshes are seen from where: joint names and types."""
    found: list[dict[str, str]] = []
    for item in first_person.items("meshAnnotations"):
        mesh = item.integer("mesh", -1, least=-1, limit=mesh_count)
        kind = _VIEWS.get(item.text("firstPersonFlag", "Auto"), "auto")
        found += [{"node": name, "type": kind} for name in nodes_of_mesh.get(mesh, ())]
    return found


def spring_bones(item: Json, name_of: NameOf, children: Mapping[str, Sequence[str]], notes: Notes) -> dict[str, Any]:
    """Colliders, their groups and springs; every chain of joints below a root becomes a spring."""
    colliders: list[dict[str, Any]] = []
    groups: list[dict[str, Any]] = []
    for number, group in enumerate(item.items("colliderGroups")):
        node = name_of(group.need("node"))
        members: list[int] = []
        for collider in group.items("colliders"):
            sphere = {"offset": _of_joint(collider.get("offset")), "radius": collider.number("radius", 0.0)}
            members.append(len(colliders))
            colliders.append({"node": node, "shape": {"sphere": sphere}})
        groups.append({"name": f"group_{number}", "colliders": members})
    springs: list[dict[str, Any]] = []
    for number, group in enumerate(item.items("boneGroups")):
        settings = {
            "hitRadius": group.number("hitRadius", 0.02),
            "stiffness": group.number("stiffiness", 1.0),  # spelt so in the format
            "gravityPower": group.number("gravityPower", 0.0),
            "gravityDir": _of_world(group.get("gravityDir")),
            "dragForce": group.number("dragForce", 0.4),
        }
        center = group.get("center")
        common: dict[str, Any] = {
            "colliderGroups": list(group.indices("colliderGroups", len(groups), "collider group"))
        }
        if center is not None and center.value != -1:
            common["center"] = name_of(center)
        title = group.text("comment", "") or f"spring_{number}"
        for bone in group.items("bones"):
            for chain in _chains(name_of(bone), children):
                joints = [{"node": node, **settings} for node in chain]
                springs.append({"name": title, "joints": joints, **common})
    if springs:
        notes.add(
            "spring bones of VRM 0: the tip beyond the last joint of a chain, which it adds by itself, is not kept"
        )
    return {"colliders": colliders, "colliderGroups": groups, "springs": springs}


def _chains(root: str, children: Mapping[str, Sequence[str]]) -> list[list[str]]:
    found: list[list[str]] = []
    starts = [root]
    while starts:
        node = starts.pop()
        chain = [node]
        while children.get(node):
            first, *others = children[node]
            starts += others[::-1]
            chain.append(first)
            node = first
        found.append(chain)
    return found


def _vector(item: Json | None, default: tuple[float, float, float]) -> tuple[float, float, float]:
    if item is None:
        return default
    return item.number("x", 0.0), item.number("y", 0.0), item.number("z", 0.0)


def _of_joint(item: Json | None) -> list[float]:
    x, y, z = _vector(item, (0.0, 0.0, 0.0))
    return [x, y, -z or 0.0]


def _of_world(item: Json | None) -> list[float]:
    x, y, z = _vector(item, (0.0, -1.0, 0.0))
    return [-x or 0.0, y, z]
