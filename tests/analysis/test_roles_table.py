"""Every skeleton of a humanoid in the data folder gets its roles right; the table in the docs is made here.

What is right is written down by hand (`naming.py`) or is what a VRM file says itself, read here without the product.
``KEYPOSE_UPDATE=1`` writes `docs/roles.md` anew.
"""

from __future__ import annotations

import json
import os
import re
import struct
from pathlib import Path
from typing import Any

import pytest

from keypose import samples
from keypose.analysis import RoleMap, find_roles
from keypose.analysis.roles import REQUIRED, ROLES
from keypose.errors import KeyposeError
from keypose.model import Skeleton
from tests.analysis.naming import NAMINGS, expected_roles
from tests.conftest import ROOT

PAGE = ROOT / "docs" / "roles.md"
VRMS = ("basic_armature.vrm", "debug_robot.vrm", "minimal.vrm", "sphere.vrm", "idle_loop.vrma", "nop.vrma", "test.vrma")
# This file calls the tip of the joint 'head' its head, and the second of seven joints its spine.
TASTES = {"idle_loop.vrma": {"head", "spine"}}
# A file without hands or knees, an arm of a machine, and an animal; all others that are no humanoid have fewer joints.
OTHERS = {
    "gltf/khronos/Fox.glb": "an animal on all fours",
    "gltf/castle_fox/Fox.gltf": "an animal on all fours",
    "gltf/cc0/greenman.glb": "a figure without knees and elbows",
    "fbx/ozz/robot.fbx": "an arm of a machine",
}
SUFFIXES = {".asf", ".amc", ".bvh", ".fbx", ".gltf", ".glb", ".vrm", ".vrma", ".dae", ".usda", ".usdz", ".mhskel"}


def named(found: RoleMap, skeleton: Skeleton) -> dict[str, str]:
    return {role: skeleton.names[found.roles[role]] if role in found.roles else "-" for role in ROLES}


def humanoid_of_vrm(path: Path) -> dict[str, str]:
    """Role -> node name as the file says it, from its JSON chunk alone."""
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    document: dict[str, Any] = json.loads(data[20 : 20 + length])
    extensions: dict[str, Any] = document["extensions"]
    if "VRM" in extensions:
        bones = [(b["bone"], b["node"]) for b in extensions["VRM"]["humanoid"]["humanBones"]]
        old = {"ThumbProximal": "ThumbMetacarpal", "ThumbIntermediate": "ThumbProximal"}  # VRM 0 and 1 differ there
        bones = [(re.sub(r"Thumb\w+", lambda m: old.get(m[0], m[0]), bone), node) for bone, node in bones]
    else:
        vrm: dict[str, Any] = extensions.get("VRMC_vrm") or extensions["VRMC_vrm_animation"]
        bones = [(bone, entry["node"]) for bone, entry in vrm["humanoid"]["humanBones"].items()]
    snake = {role.replace("_", ""): role for role in ROLES}
    return {snake[bone.lower()]: document["nodes"][node].get("name", "") for bone, node in bones}


@pytest.mark.data
@pytest.mark.parametrize("file", NAMINGS)
def test_every_role_of_every_humanoid(data_dir: Path, file: str) -> None:
    skeleton = samples.open_scene(str(data_dir / file)).characters[0].skeleton
    found = find_roles(skeleton)
    names = named(found, skeleton)
    wrong = {role: names[role] for role, asked in expected_roles(file).items() if names[role] not in asked.split("|")}
    assert not wrong
    assert found.is_humanoid


@pytest.mark.data
@pytest.mark.parametrize("file", VRMS)
def test_roles_agree_with_what_a_vrm_says(data_dir: Path, file: str) -> None:
    """By names and places alone, without the file's own map, and with it."""
    path = data_dir / "vrm" / file
    asked = humanoid_of_vrm(path)
    character = samples.open_scene(str(path)).characters[0]
    assert {r: character.skeleton.names[j] for r, j in character.roles.items()} == asked
    blind = named(find_roles(character.skeleton), character.skeleton)
    wrong = {role: blind[role] for role, name in asked.items() if blind[role] != name}
    assert set(wrong) == TASTES.get(file, set())


@pytest.mark.data
@pytest.mark.slow
def test_the_table_of_the_docs(data_dir: Path) -> None:
    rows: list[str] = []
    seen: set[str] = set()
    for path in sorted(data_dir.rglob("*")):
        file = path.relative_to(data_dir).as_posix()
        if path.suffix.lower() not in SUFFIXES:
            continue
        try:
            scene = samples.open_scene(str(path))
        except KeyposeError:
            continue
        for character in scene.characters[:1]:
            found = find_roles(character.skeleton)
            known = file in NAMINGS or file.startswith("vrm/")
            assert found.is_humanoid == known, file  # nothing is taken for a human that is none
            if not known:
                continue
            seen.add(file)
            names = named(found, character.skeleton)
            asked = expected_roles(file) if file in NAMINGS else humanoid_of_vrm(path)
            there = [role for role, name in asked.items() if name != "-"]
            right = sum(names[role] in asked[role].split("|") for role in there)
            title = NAMINGS[file].title if file in NAMINGS else "VRM, the file's own map"
            sure = 100.0 * min(found.confidence[role] for role in REQUIRED)
            rows.append(
                f"| `{file}` | {title} | {character.skeleton.joint_count} | {right} of {len(there)} | {sure:.0f}% |"
            )
    assert seen == {*NAMINGS, *(f"vrm/{name}" for name in VRMS)}
    for file in OTHERS:
        assert not find_roles(samples.open_scene(str(data_dir / file)).characters[0].skeleton).is_humanoid
    text = page(rows)
    if os.environ.get("KEYPOSE_UPDATE"):
        PAGE.write_text(text)
    assert PAGE.read_text() == text, "docs/roles.md is not of today; run with KEYPOSE_UPDATE=1"


def page(rows: list[str]) -> str:
    lines = [
        "# Roles",
        "",
        "Which joint is which in every skeleton of a humanoid among the files that the tests read, by names and places alone: what is",
        "right is written down by hand for each naming, or is the map that a VRM file holds (which `find_roles` is not shown here).",
        "*Sure* is the least confidence of a role that every humanoid has: 100% where name and place agree, 50% where the place",
        "alone speaks. A test makes this page.",
        "",
        "| file | naming | joints | roles right | sure |",
        "|---|---|---:|---:|---:|",
        *rows,
        "",
        f"Told to be none: {'; '.join(f'{what} (`{file}`)' for file, what in OTHERS.items())}.",
    ]
    return "\n".join(lines) + "\n"
