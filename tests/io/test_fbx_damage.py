"""A thousand damaged FBX files: each is refused in one clear line or loads; none crashes, hangs or eats memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from keypose.io.fbx import write
from keypose.model import Scene
from tests.conftest import ROOT, find_data_dir
from tests.io.fbx_files import SQUARE, FbxFile

pytest.importorskip("ufbx")

REAL = [
    "fbx/ufbx_anim/maya_cube_7500_ascii.fbx",
    "fbx/ufbx_morph/maya_blend_shape_cube_6100_ascii.fbx",
    "fbx/ufbx_morph/maya_blend_shape_cube_7700_binary.fbx",
    "fbx/ufbx_skin/maya_game_sausage_6100_binary_wiggle.fbx",
    "fbx/ufbx_skin/maya_game_sausage_7500_ascii_wiggle.fbx",
    "fbx/ufbx_skin/maya_transformed_skin_7700_binary.fbx",
]


def everything(folder: Path) -> Path:
    """A small file, its arrays not compressed, with nodes, a mesh, in-betweens and two takes."""
    file = FbxFile()
    top = file.model("top", kind="LimbNode", Lcl_Translation=(1, 2, 3))
    node = file.model("node", top, GeometricTranslation=(0, 1, 0), RotationOrder=4)
    geometry = file.mesh(node, polygons=[(0, 1, 2), (0, 2, 3)])
    channel = file.blend_shapes(geometry, "smile", [(50, SQUARE), (100, -SQUARE)], 20.0)
    for name in ("one", "two"):
        layer = file.stack(name, 0, 1)
        file.curve(top, "Lcl Rotation", "d|Y", [(0, 0.0), (0.5, 90.0)], layer, (0, 0, 0))
        file.curve(channel, "DeformPercent", "d|DeformPercent", [(0, 0.0), (1, 100.0)], layer)
    return file.save(folder / "everything.fbx")


def skinned(folder: Path) -> Path:
    """What the writer makes of a skinned mesh."""
    from tests.io.test_fbx_write import small_character

    path = folder / "skinned.fbx"
    write(Scene((small_character(np.random.default_rng(0)),)), path)
    return path


def read_damaged(count: int, seed: int, sources: list[Path]) -> dict[str, Any]:
    """What a process of its own says of damaged files; it may neither hang nor crash."""
    command = [sys.executable, "-m", "tests.io.fbx_damage", str(count), str(seed), *map(str, sources)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=ROOT, check=False)
    assert done.returncode == 0, f"rc {done.returncode}: {done.stderr[-2000:]}"
    return json.loads(done.stdout)


def assert_all_clear(report: dict[str, Any], count: int) -> None:
    outcomes = report["outcomes"]
    assert report["wrong"] == []
    assert outcomes["refused"] + outcomes["loaded"] == count
    assert report["places"] == outcomes["refused"], "a refusal does not say where"
    assert outcomes["refused"] > count / 4, "the damage does no harm: the test is too soft"
    assert outcomes["loaded"] > count / 20, "everything is refused: the damage is too coarse to reach far"
    assert report["slowest_s"] < 10
    assert report["peak_bytes"] < 1 << 30


def test_damaged_files_made_by_hand(tmp_path: Path) -> None:
    assert_all_clear(read_damaged(1000, 1, [everything(tmp_path), skinned(tmp_path)]), 1000)


@pytest.mark.data
def test_damaged_real_files(data_dir: Path) -> None:
    data = find_data_dir() or data_dir
    assert_all_clear(read_damaged(1000, 5000, [data / name for name in REAL]), 1000)
