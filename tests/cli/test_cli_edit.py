"""`keypose edit` as a user meets it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from keypose import io, samples
from keypose.cli.edit import Edits, edit_file
from keypose.errors import KeyposeError
from keypose.evaluate import world
from keypose.model import Motion, Scene
from tests.cli.command import keypose, process, refused


def places(scene: Scene) -> np.ndarray:
    """Where all joints are in the frames of the first motion."""
    motion = scene.animations[0]
    assert isinstance(motion, Motion)
    return np.asarray(world(scene.character.skeleton, motion.pose.broadcast()))[..., :3, 3]


def hips_and_hand(path: Path) -> np.ndarray:
    return hips_and_hand_of(io.load(path))


def hips_and_hand_of(scene: Scene) -> np.ndarray:
    body, at = scene.character.skeleton, places(scene)
    return at[:, [body.index("Hips"), body.index("LeftHand")]]


def test_a_place_is_reached(tmp_path: Path) -> None:
    out = tmp_path / "out.bvh"
    done = process("edit", "sample:walk", out, "--reach", "left_hand@60=+0.1,0.2,0.1", "--ease", 0.3)
    assert done.returncode == 0, done.stderr
    assert "left_hand is where it should be" in done.stdout and "frames changed" in done.stdout
    walk = samples.load("walk")
    before = places(walk)[:, walk.character.skeleton.index("LeftHand")]
    after = hips_and_hand(out)[:, 1]
    np.testing.assert_allclose(after[60] - before[60], [0.1, 0.2, 0.1], atol=1e-3)
    np.testing.assert_allclose(after[:40], before[:40], atol=1e-3)


def test_the_walk_goes_round_faster(tmp_path: Path) -> None:
    out = tmp_path / "out.bvh"
    done = keypose("edit", "sample:walk", out, "--loop", "--speed", "2", "-q")
    assert done.returncode == 0 and done.stdout == "", done.stderr
    hips = hips_and_hand(out)[:, 0]
    assert len(hips) == 63 and np.linalg.norm(hips[-1, [0, 2]] - hips[0, [0, 2]]) < 0.1
    drawn = keypose("edit", "sample:walk", out, "--follow", "0,0 0,1 1,2", "--bend", 10, "--stride", 0.9)
    assert drawn.returncode == 0 and "a way of 2.2" in drawn.stdout
    assert "feet in contact slide 0.0 cm/s" in drawn.stdout


def test_the_whole_body_and_poses(tmp_path: Path) -> None:
    out = tmp_path / "out.bvh"
    asked = ("--clip", "idle", "--reach", "left_hand@60-62=0.3,0.3,0.5", "--spacetime", "--turn", "Head@200=0,40,0")
    done = keypose("edit", "sample:human", out, *asked)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("is where it should be") == 3  # hand and feet
    np.testing.assert_allclose(hips_and_hand(out)[60, 1], [0.3, 0.3, 0.5], atol=1e-3)


def test_the_body_helps_a_short_arm(tmp_path: Path) -> None:
    out = tmp_path / "out.bvh"
    for whole_body, near in ((False, 1.0), (True, 1e-3)):
        asked = Edits(reaches=["left_hand@60=0.3,0.25,0.5"], whole_body=whole_body)
        edit_file("sample:human", out, asked, clip="idle", quiet=True)
        left = np.linalg.norm(hips_and_hand(out)[60, 1] - [0.3, 0.25, 0.5])
        assert left < near
        assert whole_body or left > 0.3


@pytest.mark.data
def test_a_capture_is_edited_and_filmed(data_dir: Path, tmp_path: Path) -> None:
    motion = data_dir / "asf_amc/cmu_02/02_01.amc"
    done = keypose("edit", motion, tmp_path / "out.npz", "--loop", "--reach", "lhand@100=+0,0.2,0.1")
    assert done.returncode == 0, done.stderr
    edited = io.load(tmp_path / "out.npz").animations[0]
    assert isinstance(edited, Motion) and edited.frame_count == 343


def test_the_figures_are_one_object_for_programs(tmp_path: Path) -> None:
    out = tmp_path / "out.bvh"
    done = keypose("edit", "sample:walk", out, "--speed", 2, "--bend", 30, "--reach", "left_hand@30=+0,0.1,0", "--json")
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    edited = io.load(out).animations[0]
    assert isinstance(edited, Motion)
    assert (facts["schema"], facts["file"]) == ("keypose.edit/1", str(out))
    assert (facts["frames"], facts["rate_hz"]) == (edited.frame_count, pytest.approx(edited.rate_hz))
    assert facts["path"]["turning_deg"] == pytest.approx(30, abs=1)
    assert [r["joint"] for r in facts["reached"]] == ["left_hand"] and facts["reached"][0]["error_mm"] < 1
    assert facts["after"]["skate_cm_s"] < 1


def test_the_way_is_moved_in_a_frame_and_turned_as_a_whole(tmp_path: Path) -> None:
    out = tmp_path / "out.bvh"
    before = hips_and_hand_of(samples.load("walk"))[:, 0]
    done = keypose("edit", "sample:walk", out, "--move-path", "60=0.3,0.1", "--ease", 0.8, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["path"]["knee_ratio"] < 1.5
    moved = hips_and_hand(out)[:, 0] - before
    np.testing.assert_allclose(moved[60, [0, 2]], [0.3, 0.1], atol=0.03)
    np.testing.assert_allclose(moved[[0, 124]][:, [0, 2]], 0.0, atol=0.03)
    assert keypose("edit", "sample:walk", out, "--turn-path", 90, "-q").returncode == 0
    turned = hips_and_hand(out)[:, 0]
    way, was = turned[-1] - turned[0], before[-1] - before[0]
    # from +Z to +X, and all else as it was
    np.testing.assert_allclose(way, [was[2], was[1], -was[0]], atol=0.03)
    np.testing.assert_allclose(turned[:, 1], before[:, 1], atol=1e-4)


def test_one_frame_has_no_path_but_a_pose(tmp_path: Path) -> None:
    still, out = tmp_path / "still.npz", tmp_path / "out.npz"
    walk = samples.load("walk")
    motion = walk.animations[0]
    assert isinstance(motion, Motion)
    one = replace(motion, pose=motion.pose[:1], morph_weights=None, morph_names=())
    io.save(replace(walk, animations=(one,)), still)
    for edits in (["--loop"], ["--speed", "2"], ["--reach", "left_hand@0=+0,0.1,0", "--spacetime"]):
        assert "one frame only" in refused(keypose("edit", still, out, *edits))
    assert "one frame only" in refused(keypose("clean", still, out))
    assert not out.exists()
    assert keypose("edit", still, out, "--reach", "left_hand@0=+0,0.1,0").returncode == 0


def test_what_cannot_be_done_is_said_in_one_line(tmp_path: Path) -> None:
    out = tmp_path / "out.glb"
    assert "nearest: 'left_hand'" in refused(keypose("edit", "sample:walk", out, "--reach", "left_hnd@60=0,0,0"))
    assert "no motion" in refused(keypose("edit", "sample:ball", out, "--loop"))
    for edits, says in (
        (Edits(reaches=["left_hand@60=0,0"]), "expected 3 numbers"),
        (Edits(reaches=["left_hand=0,0,0"]), "expected JOINT@FRAME"),
        (Edits(reaches=["left_hand@600=0,0,0"]), "up to 124, got 600"),
        (Edits(reaches=["left_hand@600=0,0,0"], spacetime=True), "up to 124, got 600"),
        (Edits(turns=["Head@600=0,0,0"]), "up to 124, got 600"),
        (Edits(turns=["Head=0,0,0"]), "expected JOINT@FRAME"),
        (Edits(speed="fast"), "a factor such as 1.5"),
        (Edits(speed="0"), "positive"),
        (Edits(follow="0,0"), "two places or more"),
        (Edits(follow=""), "two places or more"),
        (Edits(bend_deg=float("nan")), "expected degrees, got nan"),
        (Edits(turn_deg=float("inf")), "expected degrees, got inf"),
        (Edits(moves=["60"]), "expected FRAME=X,Z"),
        (Edits(moves=["60=0.1"]), "expected 2 numbers"),
        (Edits(moves=["125=0.1,0"]), "up to 124, got 125"),
        (Edits(), "no edit"),
        (Edits(loop=True, keep=["left_hand"]), "--keep"),
        (Edits(loop=True, spacetime=True), "--spacetime"),
    ):
        with pytest.raises(KeyposeError, match=says):
            edit_file("sample:walk", out, edits, quiet=True)
    with pytest.raises(KeyposeError, match="xyz"):
        edit_file("sample:walk", tmp_path / "out.xyz", Edits(), quiet=True)
    assert not out.exists()
