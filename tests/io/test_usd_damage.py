"""A thousand damaged USD files: each is refused in one clear line or loads; none crashes, hangs or eats memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from keypose.io.usd import write
from keypose.model import Scene
from tests.conftest import ROOT, find_data_dir
from tests.io.test_fbx_write import small_character
from tests.io.test_usd_write import motion_of

pytest.importorskip("pxr")

REAL = [
    "usd/RiggedFigure.usdz",
    "usd/RiggedSimple.usdz",
    "usd/bake_skinning/dqs.usda",
    "usd/bake_skinning/lbs.usda",
]


def small_files(folder: Path) -> list[Path]:
    """Everything that the writer writes, as text, binary and package, twice as often as text."""
    rng = np.random.default_rng(0)
    character = small_character(rng)
    scene = Scene((character,), (motion_of(character, rng, 30.0), motion_of(character, rng, 30.0, "more")))
    paths = [folder / name for name in ("a.usda", "b.usdc", "c.usdz", "d.usdc")]
    for path in paths:
        write(scene, path)
    return paths


def read_damaged(count: int, seed: int, sources: list[Path]) -> dict[str, Any]:
    """What a process of its own says of damaged files; it may neither hang nor crash."""
    command = [sys.executable, "-m", "tests.io.usd_damage", str(count), str(seed), *map(str, sources)]
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


@pytest.mark.slow
def test_damaged_files_made_by_hand(tmp_path: Path) -> None:
    assert_all_clear(read_damaged(1000, 1, small_files(tmp_path)), 1000)


@pytest.mark.data
@pytest.mark.slow
def test_damaged_real_files(data_dir: Path) -> None:
    data = find_data_dir() or data_dir
    assert_all_clear(read_damaged(400, 5000, [data / name for name in REAL]), 400)
