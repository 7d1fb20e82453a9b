"""The proof of a conversion: it is zero for a copy, and finds each thing that was spoilt by the amount it was spoilt by."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from keypose import io, samples
from keypose.analysis import scene_error
from keypose.cli.app import app
from keypose.model import Markers, Pose, Scene, Signals


@pytest.fixture(scope="module")
def human() -> Scene:
    whole = samples.load("human")
    return replace(whole, animations=whole.animations[:2])


@pytest.mark.parametrize("often", range(3))  # skinning goes over to kernels when a mesh has been used often enough
def test_a_copy_is_exact(human: Scene, often: int) -> None:
    error = scene_error(human, human)
    assert error.within(0, 0) and error.clips == 2
    assert error.vertex_mm == 0 and error.morph == 0 and not error.missing


def with_part(scene: Scene, **more: Any) -> Scene:
    character = scene.character
    parts = (replace(character.parts[0], **more), *character.parts[1:])
    return replace(scene, characters=(replace(character, parts=parts),))


def test_a_moved_vertex_is_found(human: Scene) -> None:
    part = human.character.parts[0]
    positions = np.array(part.mesh.positions)
    positions[7, 1] += 0.002
    error = scene_error(human, with_part(human, mesh=replace(part.mesh, positions=positions)))
    assert error.vertex_mm == pytest.approx(2.0, rel=1e-3) and error.vertex_part == part.name
    assert not error.within(1, 1)


def test_joints_morphs_and_lengths_are_found(human: Scene) -> None:
    motion = human.animations[0]
    assert motion.morph_weights is not None
    translations = np.array(motion.pose.broadcast().translations)
    translations[3, 0, 0] += 0.005
    moved = motion.with_pose(Pose(translations, motion.pose.rotations, motion.pose.scales))
    error = scene_error(human, replace(human, animations=(moved, human.animations[1])))
    assert error.motion is not None and error.motion.position_mm == pytest.approx(5, rel=1e-3)
    assert error.motion.position_frame == 3
    faced = replace(motion, morph_weights=np.array(motion.morph_weights) + 0.25)
    error = scene_error(human, replace(human, animations=(faced, human.animations[1])))
    assert error.morph == pytest.approx(0.25) and not error.within(1, 1)
    slower = replace(motion, rate_hz=59.0)
    assert scene_error(human, replace(human, animations=(slower, human.animations[1]))).time_s > 0.01


def test_what_is_not_there_is_listed(human: Scene) -> None:
    character = human.character
    bare = replace(human, characters=(replace(character, parts=character.parts[2:]),), animations=human.animations[:1])
    missing = " ".join(scene_error(human, bare).missing)
    assert f"2 of {len(character.parts)} mesh parts ({character.parts[0].name}" in missing
    assert "1 of 2 clips" in missing
    assert scene_error(human, Scene()).missing[0].startswith("1 of 1 characters")


def test_split_vertices_are_compared_with_the_nearest(human: Scene) -> None:
    part = human.character.parts[0]
    mesh = part.mesh
    count = len(mesh.positions)
    twice = np.concatenate([np.arange(count), np.arange(10)])
    assert part.skin is not None
    skin = replace(part.skin, joints=np.asarray(part.skin.joints)[twice], weights=np.asarray(part.skin.weights)[twice])
    attributes = {
        name: np.asarray(value)[twice]
        for name in ("positions", "normals", "uvs")
        if (value := getattr(mesh, name, None)) is not None
    }
    copy = with_part(human, mesh=replace(mesh, **attributes), skin=skin, morphs=None, morph_channels=None)
    error = scene_error(human, copy)
    assert error.vertex_mm is not None and error.vertex_mm < 60  # the face's own shapes only


def test_markers_and_signals() -> None:
    positions = np.random.default_rng(0).normal(size=(5, 2, 3))
    scene = Scene(markers=(Markers(("a", "b"), positions, 100.0),), signals=(Signals(("s",), np.zeros((5, 1)), 100.0),))
    moved = positions.copy()
    moved[2, 1] += (0.0, 0.003, 0.004)
    error = scene_error(scene, Scene(markers=(Markers(("a", "b"), moved, 100.0),)))
    assert error.marker_mm == pytest.approx(5) and error.missing == ("1 of 1 signals",)
    moved[1, 0] = np.nan
    error = scene_error(scene, replace(scene, markers=(Markers(("a", "b"), moved, 100.0),)))
    assert error.missing == ("1 sightings of markers",)


def test_strict_conversion(tmp_path) -> None:
    run = CliRunner()
    assert run.invoke(app, ["convert", "sample:walk", str(tmp_path / "a.glb"), "--strict"]).exit_code == 0
    lost = run.invoke(app, ["convert", "sample:human", str(tmp_path / "a.bvh"), "--strict"])
    assert lost.exit_code == 1 and "not kept: 5 of 6 clips" in str(lost.exception)
    bvh, back = tmp_path / "w.bvh", tmp_path / "w.glb"
    io.save([samples.load("walk").character.skeleton, samples.load("walk").animations[0]], bvh)
    exact = run.invoke(app, ["convert", str(bvh), str(back), "--strict"])
    assert exact.exit_code == 0 and "read back" in exact.output
    rough = run.invoke(app, ["convert", str(bvh), str(back), "--strict", "--limit-mm", "0"])
    assert rough.exit_code == 1


def test_markers_are_found_in_whatever_set_they_are() -> None:
    """A format of one set joins several; nothing is lost by that, and what is, is named."""
    rng = np.random.default_rng(3)
    places = rng.normal(size=(20, 5, 3))
    places[3, 1] = np.nan
    two = Scene(markers=(Markers(tuple("ab"), places[:, :2], 100.0), Markers(tuple("cde"), places[:, 2:], 100.0)))
    moved = places.copy()
    moved[7, 4, 0] += 0.002
    error = scene_error(two, Scene(markers=(Markers(tuple("abcde"), moved, 100.0),)))
    assert error.marker_mm == pytest.approx(2) and not error.missing
    error = scene_error(two, Scene(markers=(Markers(tuple("abcd"), places[:, :4], 100.0),)))
    assert error.marker_mm == 0 and error.missing == ("1 of 3 markers (e)",)
    places[4, 2] = np.nan
    error = scene_error(two, Scene(markers=(Markers(tuple("abcde"), places, 100.0),)))
    assert error.missing == ("1 sightings of markers",)
