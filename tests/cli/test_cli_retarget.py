"""`keypose retarget` and `keypose roles` as a user meets them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from keypose import io
from keypose.model import Motion
from tests.cli.command import keypose, process, refused


def test_a_performance_goes_on_the_human(tmp_path: Path) -> None:
    done = process("retarget", "sample:walk", "--to", "sample:human", tmp_path / "out.glb")
    assert done.returncode == 0, done.stderr
    assert "bone directions" in done.stdout and "feet in contact slide" in done.stdout
    assert len(io.load(tmp_path / "out.glb").animations) == 1


@pytest.mark.data
def test_a_capture_goes_on_a_character(data_dir: Path, tmp_path: Path) -> None:
    motion, hero = data_dir / "asf_amc/cmu_02/02_01.amc", data_dir / "fbx/geno/Geno.fbx"
    done = keypose("retarget", motion, "--to", hero, tmp_path / "out.bvh", "--rate", 60, "--no-plant")
    assert done.returncode == 0, done.stderr
    animation = io.load(tmp_path / "out.bvh").animations[0]
    assert isinstance(animation, Motion) and animation.rate_hz == pytest.approx(60)


def test_roles_are_printed_saved_and_used(tmp_path: Path) -> None:
    shown = process("roles", "sample:human", tmp_path / "map.json")
    assert shown.returncode == 0 and "left_upper_arm" in shown.stdout and "LeftArm" in shown.stdout
    assert json.loads((tmp_path / "map.json").read_text())["hips"] == "Hips"
    listed = keypose("roles", "sample:human", "--json")
    assert json.loads(listed.stdout)["roles"]["hips"] == {"joint": "Hips", "confidence": 1.0}
    out = tmp_path / "out.glb"
    done = keypose("retarget", "sample:walk", "--to", "sample:human", out, "--to-roles", tmp_path / "map.json", "-q")
    assert done.returncode == 0 and done.stdout == "" and out.exists()


def test_the_figures_are_one_object_for_programs(tmp_path: Path) -> None:
    out = tmp_path / "out.npz"
    done = keypose("retarget", "sample:walk", "--to", "sample:human", out, "--against", "sample:walk", "--json")
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert (facts["schema"], facts["file"], facts["frames"]) == ("keypose.retarget/1", str(out), 125)
    assert facts["mean_direction_deg"] < 1 and facts["against"]["mean_direction_deg"] < 2
    assert facts["direction_deg"]["left_lower_arm"] < 0.01 and "meshes were not written" in facts["notes"]


def test_a_map_never_takes_the_place_of_a_character(tmp_path: Path) -> None:
    hero = tmp_path / "hero.glb"
    assert keypose("convert", "sample:walk", hero, "-q").returncode == 0
    before = hero.read_bytes()
    assert "one of the inputs" in refused(keypose("roles", hero, hero))
    assert ".json" in refused(keypose("roles", hero, tmp_path / "map.bvh"))
    assert hero.read_bytes() == before and not (tmp_path / "map.bvh").exists()
    (tmp_path / "map.json").write_text("{")
    wrong = refused(keypose("rig", hero, "--roles", tmp_path / "map.json"))
    assert "map.json" in wrong and "JSON object" in wrong


def test_numbers_that_are_none_are_refused(tmp_path: Path) -> None:
    out = tmp_path / "out.glb"
    for option in ("--turn", "--raise", "--scale"):
        assert "expected" in refused(keypose("convert", "sample:walk", out, option, "inf"))
    assert keypose("retarget", "sample:walk", "--to", "sample:human", out, "--rate", "1e9").returncode == 2
    assert keypose("rig", "sample:human", "--motion", "sample:walk").returncode == 2, "keys need a project"
    assert not out.exists()


def test_what_cannot_be_done_is_said_in_one_line(tmp_path: Path) -> None:
    out = tmp_path / "out.glb"
    (tmp_path / "map.json").write_text('{"hips": "Hisp"}')
    asked = ("retarget", "sample:walk", "--to", "sample:human")
    assert "nearest: 'Hips'" in refused(keypose(*asked, out, "--to-roles", tmp_path / "map.json"))
    assert "no such file" in refused(keypose(*asked, out, "--to-roles", tmp_path / "none.json")).lower()
    assert ".xyz" in refused(keypose(*asked, tmp_path / "out.xyz"))
    assert "sample" in refused(keypose("retarget", "sample:nobody", "--to", "sample:human", out))
    assert not out.exists()
    assert keypose("retarget", "sample:walk", out).returncode == 2


def test_the_quality_of_a_take_is_printed_and_compared() -> None:
    shown = process("check", "sample:walk", "--quality")
    assert shown.returncode == 0 and "feet in contact slide" in shown.stdout and "as a loop" in shown.stdout
    listed = keypose("check", "sample:walk", "--against", "sample:walk", "--json")
    found = json.loads(listed.stdout)["quality"][0]
    assert found["difference"]["worst_cm"] == 0.0 and found["skate_cm_s"] >= 0
    assert "no motion" in refused(keypose("check", "sample:ball", "--quality"))


def test_an_input_is_never_written_over(tmp_path: Path) -> None:
    take = tmp_path / "take.bvh"
    assert keypose("convert", "sample:walk", take, "-q").returncode == 0
    before = take.read_bytes()
    assert "one of the inputs" in refused(keypose("convert", take, take))
    assert "one of the inputs" in refused(keypose("retarget", take, "--to", "sample:human", take))
    (tmp_path / "other.bvh").write_bytes(before)
    (tmp_path / "other.bvh").chmod(0o444)
    assert "read-only" in refused(keypose("convert", take, tmp_path / "other.bvh"))
    assert take.read_bytes() == before == (tmp_path / "other.bvh").read_bytes()


@pytest.mark.data
def test_what_cannot_be_told_or_kept_is_refused(data_dir: Path, tmp_path: Path) -> None:
    fox, out = data_dir / "gltf/castle_fox/Fox.gltf", tmp_path / "out.glb"
    assert "four feet" in refused(keypose("retarget", "sample:walk", "--to", fox, out))
    markers = next((data_dir / "c3d").rglob("*.c3d"))
    assert "only markers" in refused(keypose("convert", markers, out))
    assert not out.exists()


@pytest.mark.data
def test_one_take_in_two_formats_agrees(data_dir: Path) -> None:
    """The BVH that somebody else made of the capture has other names, an other trunk and one frame more."""
    bvh, amc = data_dir / "cmu_01_01/01_01.bvh", data_dir / "cmu_01_01/01_01.amc"
    done = keypose("check", bvh, "--against", amc)
    assert done.returncode == 0, done.stderr
    said = " ".join(done.stdout.split())
    assert "arms 0.00, legs 0.00, shoulders 0.00" in said and "shifted by 8.3 ms" in said


@pytest.mark.data
def test_somebody_elses_result_beside_it(data_dir: Path, tmp_path: Path) -> None:
    rig, spread = (data_dir / f"bvh/cmu_iclone_{name}.bvh" for name in ("002/002_04", "007/007_05"))
    args = ("retarget", data_dir / "asf_amc/cmu_02/02_04.amc", "--to", rig, tmp_path / "out.bvh")
    done = keypose(*args, "--against", rig, "--target-reference", f"{spread}:0")
    assert done.returncode == 0, done.stderr
    said = " ".join(done.stdout.split())
    assert "bone directions beside the reference:" in said and "arms 0.4" in said and "trunk 0.0" in said
    assert "turned by -60.3 degrees and shifted by 8.3 ms" in said


@pytest.mark.data
def test_a_bad_reference_pose_is_hinted_at(data_dir: Path, tmp_path: Path) -> None:
    rig = data_dir / "fbx/ozz_pab/jog.fbx"
    args = ("retarget", "sample:walk", "--to", rig, tmp_path / "out.glb")
    good, bad = keypose(*args), keypose(*args, "--target-reference", 0)  # a frame in mid-step
    assert good.returncode == bad.returncode == 0
    assert "--target-reference" not in good.stdout and "--target-reference" in bad.stdout


def test_reference_frames_and_props_are_checked(tmp_path: Path) -> None:
    args = ("retarget", "sample:walk", "--to", "sample:human", tmp_path / "out.glb")
    done = keypose(*args, "--source-reference", 3, "--keep-hands", "--prop", "0,1,0.3:0,1.1,0.3")
    assert done.returncode == 0, done.stderr
    assert "hands beside body or props" in done.stdout
    assert "expected 0 to" in refused(keypose(*args, "--source-reference", 9999))
    assert "FILE:FRAME" in refused(keypose(*args, "--source-reference", "first"))
    assert "x,y,z" in refused(keypose(*args, "--prop", "1,2"))
    assert not list(tmp_path.glob("*.tmp*"))


@pytest.mark.data
def test_an_animal_by_its_roles_and_by_maps(data_dir: Path, tmp_path: Path) -> None:
    fox = data_dir / "gltf/khronos/Fox.glb"
    found = keypose("roles", fox, tmp_path / "fox.json")
    assert found.returncode == 0 and "quadruped" in found.stdout, found.stdout
    nothing = keypose("roles", data_dir / "gltf/khronos/rigged_simple.gltf")
    assert nothing.returncode == 1 and "no humanoid or animal" in nothing.stdout
    roles = json.loads((tmp_path / "fox.json").read_text())
    assert {roles[f"tail:{n}"] for n in (1, 2, 3)} == {f"b_Tail0{n}_01{n + 1}" for n in (1, 2, 3)}
    args = ("retarget", fox, "--to", fox, tmp_path / "out.glb", "--clip", "Run")
    for maps in ((), ("--from-roles", tmp_path / "fox.json", "--to-roles", tmp_path / "fox.json")):
        done = keypose(*args, *maps)
        assert done.returncode == 0, done.stderr
        assert "bone directions: 0.0" in done.stdout
