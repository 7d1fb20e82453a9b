"""The doctor on every file of the data folder: it has something to say of each, and every cure that it proposes cures."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from keypose.cli.app import app
from keypose.errors import KeyposeError
from keypose.io.registry import format_of_suffix

pytestmark = pytest.mark.data

LARGEST_BYTES = 8_000_000
FACTS = {"format", "unit", "up", "forward", "handedness", "euler_orders", "rest_pose", "sides", "stature_m", "ground_m",
         "rate_hz", "missing_share"}  # fmt: skip
ANGLES = {"bvh", "asf", "amc", "fbx"}


@dataclass(frozen=True)
class Examined:
    """What ``keypose check FILE --json`` printed, or the error that refused the file."""

    path: Path
    facts: dict[str, Any]
    refused: str = ""


def files(folder: Path) -> Iterator[Path]:
    """One file of each kind and make: those of one folder and suffix are alike."""
    seen: dict[tuple[Path, str], int] = {}
    for path in sorted(folder.rglob("*")):
        known = format_of_suffix(path)
        if known is None or known.name == "usd" or not path.is_file() or path.stat().st_size > LARGEST_BYTES:
            continue
        key = path.parent, path.suffix.lower()
        seen[key] = seen.get(key, 0) + 1
        if seen[key] <= (2 if path.suffix.lower() in (".obj", ".bvh", ".amc") else 99):
            yield path


def check(path: Path, *options: str) -> Examined:
    result = CliRunner().invoke(app, ["check", str(path), "--json", *options])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        assert isinstance(result.exception, KeyposeError), result.exception
        return Examined(path, {}, str(result.exception))
    return Examined(path, json.loads(result.output))


@pytest.fixture(scope="module")
def examined(data_dir: Path) -> list[Examined]:
    return [check(path) for path in files(data_dir)]


def test_every_file_is_understood_or_refused_by_name(examined: list[Examined]) -> None:
    assert len(examined) > 120
    for item in examined:
        if item.refused:
            assert item.path.name in item.refused
            continue
        assert item.facts.keys() >= FACTS
        assert item.facts["up"] in "XYZ" and item.facts["unit_m"] > 0
        assert {f["level"] for f in item.facts["findings"]} <= {"fact", "guess", "repair", "loss", "warning"}
        if item.facts["format"] in ANGLES:
            assert item.facts["euler_orders"] and all(set(o) <= set("XYZ") for o in item.facts["euler_orders"])


def test_figures_are_known(examined: list[Examined]) -> None:
    """Humans, robots and animals of the folder; a prop is none."""
    of = {item.path.name: item.facts for item in examined}
    for name, kind in {
        "01_01.amc": "T", "Geno.fbx": "T", "debug_robot.vrm": "T", "default.mhskel": "A", "walk.dae": "A", "Fox.glb": "on all fours",
        "007_01.bvh": "collapsed", "Knight.glb": "T", "cube.fbx": None, "sphere.vrm": "T", "idle_loop.vrma": "T",
    }.items():  # fmt: skip
        assert of[name]["rest_pose"] == kind, name
    for name, orders in {"01_01.amc": "ZYX", "01_01.bvh": "ZYX", "jesse_dance.bvh": "YXZ", "Geno.fbx": "ZYX"}.items():
        assert max(of[name]["euler_orders"], key=of[name]["euler_orders"].get) == orders
    for name in (
        "01_01.amc",
        "01_01.bvh",
        "Geno.fbx",
        "debug_robot.vrm",
        "walk.dae",
        "Knight.glb",
        "basic_armature.vrm",
    ):
        assert of[name]["forward"] == "+Z" and of[name]["handedness"] == "right", name
    assert of["007_01.bvh"]["forward"] is None and of["007_01.bvh"]["forward_moving"]
    assert of["astro_maya.dae"]["stature_m"] < 0.2
    assert any(f["topic"] == "scale" and "--scale 0.01" in f["fix"] for f in of["Fox.glb"]["findings"])


@pytest.mark.slow
def test_every_command_runs_and_cures(
    examined: list[Examined], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a command is proposed for is not found in what it has written; of like findings the smallest file's is run."""
    monkeypatch.chdir(tmp_path)
    chosen: dict[tuple[str, ...], tuple[int, Path, dict[str, Any]]] = {}
    for item in examined:
        for finding in item.facts.get("findings", ()):
            if finding["fix"]:
                words = shlex.split(finding["fix"])
                assert words[:2] == ["keypose", "convert"] and Path(words[2]) == item.path
                options = [w for w in words[4:] if w.startswith("--")]
                key = (item.facts["format"], finding["topic"], *options)
                size = item.path.stat().st_size
                if key not in chosen or size < chosen[key][0]:
                    chosen[key] = size, item.path, finding
    assert len(chosen) > 20
    for _, path, finding in chosen.values():
        words = shlex.split(finding["fix"])
        result = CliRunner().invoke(app, words[1:])
        assert result.exit_code == 0, (finding, result.output, result.exception)
        after = check(tmp_path / words[3])
        assert not after.refused, (finding, after.refused)
        left = [
            f["text"]
            for f in after.facts["findings"]
            if (f["topic"], f["level"]) == (finding["topic"], finding["level"])
        ]
        assert finding["text"] not in left and len(left) < 2, (path, finding, left)
