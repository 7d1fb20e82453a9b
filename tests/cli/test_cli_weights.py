"""`keypose skin` as a user meets it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from keypose import io, samples
from keypose.deform.weights import WeightsReport
from keypose.io.registry import formats
from tests.cli.command import keypose, process, refused


@pytest.fixture(scope="module")
def statue(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The human's mesh without a skeleton."""
    path = tmp_path_factory.mktemp("statue") / "statue.obj"
    done = keypose("convert", "sample:human", path, "-q")
    assert done.returncode == 0, done.stderr
    return path


def test_a_statue_gets_a_skeleton_and_moves(statue: Path, tmp_path: Path) -> None:
    out = tmp_path / "hero.glb"
    done = process("skin", statue, out, "--skeleton", "sample:walk")
    assert done.returncode == 0, done.stderr
    assert "bone heat" in done.stdout and "61 joints" in done.stdout
    scene = io.load(out)
    assert len(scene.animations) == 1 and all(p.skin is not None for p in scene.character.parts)
    for part in scene.character.parts:
        assert part.skin is not None and part.skin.influence_count <= 4
        np.testing.assert_allclose(part.skin.weights.sum(axis=1), 1.0, atol=1e-5)
    assert scene.character.vertex_count > 9000


def test_a_character_is_weighted_anew(tmp_path: Path) -> None:
    out = tmp_path / "human.glb"
    done = keypose("skin", "sample:human", out, "--influences", 2, "--strength", 2, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["influences"] == 2 and found["joints_without"] == [] and found["rigid"] >= 2
    assert keypose("skin", "sample:human", tmp_path / "quiet.glb", "-q", "--joints", "Hips, Head").stdout == ""
    skins = [p.skin for p in io.load(tmp_path / "quiet.glb").character.parts]
    assert {int(j) for s in skins if s is not None for j in s.palette[np.unique(s.joints[s.weights > 0])]} <= {0, 5}


def test_what_is_said_to_hold_weights_holds_them(tmp_path: Path) -> None:
    scene = samples.load("human")
    suffixes = [suffix for entry in formats() for suffix in entry.skins]
    assert ".glb" in suffixes and ".keypose" in suffixes
    for suffix in suffixes:
        path = tmp_path / f"human{suffix}"
        io.save(replace(scene, animations=()), path)
        assert any(part.skin is not None for part in io.load(path).character.parts), suffix


@pytest.mark.data
def test_real_files(data_dir: Path, tmp_path: Path) -> None:
    base, bones = data_dir / "makehuman/base.obj", data_dir / "makehuman/tpose.bvh"
    done = keypose("skin", base, tmp_path / "body.glb", "--skeleton", bones, "--dual-quaternion")
    assert done.returncode == 0, done.stderr
    assert "pieces" in done.stdout and io.load(tmp_path / "body.glb").character.vertex_count > 14000


def test_what_cannot_be_done_is_said_in_one_line(statue: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.glb"
    bones = tmp_path / "bones.bvh"
    assert keypose("convert", "sample:walk", bones, "-q").returncode == 0
    assert "no mesh" in refused(keypose("skin", bones, out))
    assert "nearest: 'Hips'" in refused(keypose("skin", "sample:human", out, "--joints", "Hisp"))
    assert "one of the inputs" in refused(keypose("skin", statue, statue, "--skeleton", "sample:walk"))
    assert ".xyz" in refused(keypose("skin", "sample:human", tmp_path / "out.xyz"))
    for suffix in (".bvh", ".vrma", ".obj", ".npz"):
        assert "holds no weights" in refused(keypose("skin", "sample:human", tmp_path / f"out{suffix}"))
    assert "clip 'Run'" in refused(keypose("skin", "sample:walk", out, "--clip", "Run"))
    assert keypose("skin", "sample:human", out, "--influences", 0).returncode == 2
    assert not out.exists()


def test_one_is_no_plural(tmp_path: Path) -> None:
    lone = replace(samples.load("human"), animations=())
    body = lone.character
    part = max(body.parts, key=lambda p: p.mesh.vertex_count)
    notes = io.save(replace(lone, characters=(replace(body, parts=(part,)),)), tmp_path / "one.bvh")
    assert "1 mesh part is not in the file: BVH holds no meshes" in notes
    report = WeightsReport(8, 8, 1, 1, 0, 0, 1, 0, 1, 1, 0.0, ("Hips",), ())
    text = "\n".join(report.lines())
    assert "1 piece: " in text and "1 joint moves something" in text and "1 heated piece is open" in text
    two = "\n".join(replace(report, pieces=2, open_pieces=2, joints=("Hips", "Head")).lines())
    assert "2 pieces: " in two and "2 joints move something" in two and "2 heated pieces are open" in two
