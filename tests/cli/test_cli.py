"""The command line, as a user meets it: what is printed, which exit code, and that nothing half-written stays."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

import pytest

from keypose.bench import SUITES
from keypose.cli.app import app
from tests.cli.command import keypose, process, refused

VERBS = (
    "demo", "studio", "play", "info", "check", "convert", "edit", "clean", "retarget", "rig", "roles", "skin", "render",
    "graph", "bench",
)  # fmt: skip


def test_help_lists_every_verb_and_every_verb_has_examples() -> None:
    text = keypose("--help")
    assert text.returncode == 0
    for verb in VERBS:
        assert f" {verb} " in text.stdout
        shown = keypose(verb, "--help")
        assert shown.returncode == 0
        assert "Examples" in shown.stdout and f"keypose {verb}" in shown.stdout
    assert {c.name or getattr(c.callback, "__name__", "") for c in app.registered_commands} == set(VERBS)
    benches = keypose("bench", "--help").stdout
    assert all(suite in benches for suite in SUITES), "the help of bench names every suite"


def test_help_comes_at_once() -> None:
    """Under 0.3 s on a quiet machine; the bound here leaves room for a busy one."""
    times = []
    for _ in range(5):
        begin = time.perf_counter()
        process("--help")
        times.append(time.perf_counter() - begin)
    assert statistics.median(times) < 1.5


def test_version() -> None:
    import keypose as package

    assert process("--version").stdout.strip() == f"keypose {package.__version__}"


@pytest.mark.parametrize(
    "arguments", [["nonsense"], ["convert", "one.bvh"], ["render", "a.glb", "b.png", "--size", "big"], ["info"]]
)
def test_wrong_usage_exits_with_2(arguments: list[str]) -> None:
    result = process(*arguments)
    assert result.returncode == 2
    assert "Traceback" not in result.stderr


def test_info_of_a_sample_as_json() -> None:
    facts = json.loads(keypose("info", "sample:walk", "--json").stdout)
    assert facts["format"] == "sample" and facts["joints"] >= 60 and facts["morphs"] == 67
    assert facts["clips"][0]["name"] == "walk" and facts["rate_hz"] == 60
    assert set(facts) == {
        "format", "unit", "up", "joints", "joint_names", "frames", "rate_hz", "duration_s", "markers", "marker_names",
        "meshes", "vertices", "triangles", "morphs", "morph_names", "clips", "notes",
    }  # fmt: skip


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "joints", "frames", "rate"),
    [
        ("cmu_01_01/01_01.bvh", 31, 2752, 120),
        ("bvh/geno/Geno_bind.bvh", 75, 2, 60),
        ("gltf/khronos/Fox.glb", 26, 83, 24),
    ],
)
def test_info_of_real_files(data_dir: Path, name: str, joints: int, frames: int, rate: float) -> None:
    facts = json.loads(keypose("info", data_dir / name, "--json").stdout)
    assert (facts["joints"], facts["frames"], facts["rate_hz"]) == (joints, frames, rate)
    shown = process("info", data_dir / name)
    assert f"{joints} joints" in shown.stdout


def test_bad_input_is_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    assert "no such file" in refused(process("info", tmp_path / "absent.bvh"))
    assert "nearest: 'walk'" in refused(keypose("info", "sample:wlak"))
    broken = tmp_path / "broken.bvh"
    broken.write_text("HIERARCHY\nROOT Hips\n{\n  OFFSET 0 0\n")
    line = refused(keypose("convert", broken, tmp_path / "out.glb"))
    assert "broken.bvh: line " in line and "OFFSET" in line
    refused(keypose("render", broken, tmp_path / "out.png"))
    assert "no such file" in refused(keypose("play", tmp_path / "absent.glb", "--no-browser"))
    assert ".xyz" in refused(keypose("convert", "sample:walk", tmp_path / "out.xyz"))
    assert "nearest: 'walk'" in refused(keypose("convert", "sample:human", tmp_path / "out.glb", "--clip", "walc"))
    assert [p.name for p in tmp_path.iterdir()] == ["broken.bvh"]


def test_convert_there_and_back_prints_its_proof(tmp_path: Path) -> None:
    glb, bvh = tmp_path / "walk.glb", tmp_path / "walk.bvh"
    first = process("convert", "sample:walk", glb)
    assert first.returncode == 0 and "read back: 61 joints x 125 frames" in first.stdout
    second = keypose("convert", glb, bvh)
    assert second.returncode == 0 and "read back: 61 joints x 125 frames" in second.stdout
    assert "morph" in second.stdout, "what BVH cannot hold is said"
    facts = json.loads(keypose("info", bvh, "--json").stdout)
    assert facts["joints"] == 61 and facts["frames"] == 125


@pytest.mark.data
def test_a_giant_s_proof_is_read_in_the_unit_it_was_written_in(tmp_path: Path, data_dir: Path) -> None:
    result = keypose("convert", data_dir / "gltf/khronos/Fox.glb", tmp_path / "fox.bvh", "--clip", "Walk")
    assert result.returncode == 0, result.stderr
    assert "18 frames: positions within 0.00" in result.stdout, "at the rate of its keys, 24 Hz"
    assert "read it with --unit cm --up Y" in result.stdout


@pytest.mark.data
def test_convert_puts_a_motion_on_a_character(tmp_path: Path, data_dir: Path) -> None:
    keypose("convert", "sample:walk", tmp_path / "walk.bvh")
    keypose("convert", "sample:human", tmp_path / "human.glb")
    out = tmp_path / "both.glb"
    result = keypose("convert", tmp_path / "walk.bvh", tmp_path / "human.glb", out)
    assert result.returncode == 0, result.stderr
    facts = json.loads(keypose("info", out, "--json").stdout)
    assert facts["clips"][0]["name"] == "walk" and facts["meshes"] > 5
    other = data_dir / "gltf/khronos/Fox.glb"
    assert "skeletons differ" in refused(keypose("convert", tmp_path / "walk.bvh", other, tmp_path / "no.glb"))


def test_a_graph_is_run_and_baked(tmp_path: Path) -> None:
    keys = tmp_path / "keys.json"
    keys.write_text('[{"at_s": 0.2, "set": {"speed": 1.2}}, {"at_s": 1.0, "set": {"jump": true}}]')
    result = process("graph", "sample:locomotion", tmp_path / "out.glb", "--inputs", keys, "--seconds", 2, "--rate", 30)
    assert result.returncode == 0, result.stderr
    assert "idle → move" in result.stdout and "move → jump" in result.stdout
    facts = json.loads(keypose("info", tmp_path / "out.glb", "--json").stdout)
    assert facts["clips"][0]["frames"] == 61 and facts["meshes"] > 5
    keys.write_text('[{"at_s": "soon"}]')
    assert "keys.json" in refused(keypose("graph", "sample:locomotion", tmp_path / "no.glb", "--inputs", keys))
    assert "nearest: 'locomotion'" in refused(keypose("graph", "sample:locomotoin", tmp_path / "no.glb"))
    assert not (tmp_path / "no.glb").exists()


@pytest.mark.parametrize("suffix", ["png", "gif", "mp4", "webm"])
def test_render_writes_every_kind(tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"walk.{suffix}"
    command = process if suffix == "png" else keypose
    result = command(
        "render", "sample:walk", out, "--size", "160x120", "--end", "0.2", "--rate", "10", "--backend", "cpu"
    )
    assert result.returncode == 0, result.stderr
    assert out.stat().st_size > 500
    heads = {"png": b"\x89PNG", "gif": b"GIF8", "mp4": b"ftyp", "webm": b"\x1a\x45\xdf\xa3"}
    assert heads[suffix] in out.read_bytes()[:16]


def test_output_cut_off_by_the_reader_is_no_error(tmp_path: Path) -> None:
    command = f"{sys.executable} -m keypose info sample:human --json | head -c 1"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60)
    assert "Traceback" not in result.stderr
