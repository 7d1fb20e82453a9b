"""Cures change what they say and nothing else: laws on the joints, the skinned vertices and the markers of a scene."""

from __future__ import annotations

import doctest
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from keypose import io, samples
from keypose.analysis import cures, scene_error
from keypose.deform import deform_part
from keypose.errors import ShapeError
from keypose.evaluate import bake, sample, sample_morphs, to_clip, world
from keypose.model import Clip, ForcePlate, Interpolation, Markers, Motion, Scene, Signals
from tests.conftest import ROOT


@pytest.fixture(scope="module", params=["motion", "linear", "hermite"])
def scene(request: pytest.FixtureRequest) -> Scene:
    found = samples.load("walk")
    character = found.character
    motion = found.animations[0]
    assert isinstance(motion, Motion)
    animation: Motion | Clip = motion
    if request.param != "motion":
        animation = to_clip(motion, Interpolation.LINEAR if request.param == "linear" else Interpolation.HERMITE)
    markers = Markers(("a", "b"), np.random.default_rng(0).normal(size=(30, 2, 3)), 60.0, residuals=np.ones((30, 2)))
    plate = ForcePlate(np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]]), np.array([0.0, 0, -0.04]), 2)
    signals = Signals(("s",), np.arange(60.0)[:, None], 120.0)
    return Scene((character,), (animation,), markers=(markers,), plates=(plate,), signals=(signals,))


def shape(scene: Scene, time_s: float) -> tuple[Any, Any]:
    """Places of all joints and all vertices at a time."""
    character = scene.character
    pose = sample(scene.animations[0], character.skeleton, np.array([time_s]))[0]
    weights = sample_morphs(
        scene.animations[0], character.morph_names, np.array([time_s]), character.rest_morph_weights
    )[0]
    matrices = np.asarray(world(character.skeleton, pose), np.float64)
    parts = [np.asarray(deform_part(character, part, matrices, weights), np.float64) for part in character.parts]
    return matrices[:, :3, 3], np.concatenate(parts)


TURN = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # +Z becomes +X


@pytest.mark.parametrize(
    ("cure", "change"),
    [
        (lambda s: cures.scaled(s, 2.5), lambda p: 2.5 * p),
        (lambda s: cures.turned(s, 90), lambda p: p @ TURN.T),
        (lambda s: cures.raised(s, 0.3), lambda p: p + np.array([0, 0.3, 0])),
    ],
)
def test_everything_goes_along(scene: Scene, cure: Any, change: Any) -> None:
    cured = cure(scene)
    for time_s in (0.0, 0.317):
        for before, after in zip(shape(scene, time_s), shape(cured, time_s), strict=True):
            np.testing.assert_allclose(after, change(before), atol=3e-6)
    rest = world(scene.character.skeleton, scene.character.skeleton.rest)[:, :3, 3]
    np.testing.assert_allclose(
        world(cured.character.skeleton, cured.character.skeleton.rest)[:, :3, 3], change(rest), atol=3e-6
    )
    np.testing.assert_allclose(cured.markers[0].positions, change(scene.markers[0].positions), atol=1e-12)


def test_plates_stay_on_the_ground_and_residuals_scale(scene: Scene) -> None:
    np.testing.assert_array_equal(cures.raised(scene, 1).plates[0].corners, scene.plates[0].corners)
    np.testing.assert_allclose(cures.scaled(scene, 3).plates[0].corners, 3 * scene.plates[0].corners)
    np.testing.assert_allclose(cures.scaled(scene, 3).plates[0].origin, [0, 0, -0.12])
    np.testing.assert_allclose(np.asarray(cures.scaled(scene, 3).markers[0].residuals), 3.0)
    np.testing.assert_allclose(cures.turned(scene, 90).plates[0].corners[1], [0, 0, -1], atol=1e-12)


def test_turning_back_is_nothing(scene: Scene) -> None:
    again = cures.turned(cures.turned(scene, 37), -37)
    error = scene_error(scene, again)
    assert error.within(1e-3, 1e-3) and not error.missing


def test_frames_are_left_out_at_the_start(scene: Scene) -> None:
    cut = cures.without_first(scene, 4)
    before, after = scene.animations[0], cut.animations[0]
    assert after.start_s + after.duration_s == pytest.approx(before.start_s + before.duration_s)
    assert after.start_s == pytest.approx(before.start_s + 4 / 60)
    for a, b in zip(shape(scene, 0.4), shape(cut, 0.4), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-7)
    assert cut.markers[0].frame_count == 26 and cut.markers[0].start_frame == 5
    np.testing.assert_array_equal(cut.markers[0].positions, scene.markers[0].positions[4:])
    np.testing.assert_array_equal(cut.signals[0].values[:, 0], np.arange(8.0, 60.0))
    with pytest.raises(ShapeError, match="cannot be left out"):
        cures.without_first(Scene(markers=scene.markers), 30)


def test_rates(scene: Scene) -> None:
    found = cures.at_rate(scene, 24.0).animations[0]
    assert isinstance(found, Motion) and found.rate_hz == 24
    animation = scene.animations[0]
    if isinstance(animation, Clip):
        expected = bake(animation, scene.character.skeleton, 24.0)
        np.testing.assert_allclose(found.pose.rotations, expected.pose.rotations, atol=1e-6)
    with pytest.raises(ShapeError, match="no animation"):
        cures.at_rate(Scene(markers=scene.markers), 24.0)


def test_packing_says_what_it_changes() -> None:
    human = samples.load("human")
    few, notes = cures.packed(human, 2)
    assert all(p.skin is None or p.skin.influence_count <= 2 for p in few.character.parts) and notes
    same, none = cures.packed(human, 64)
    assert not none and same.character.parts[0].skin is human.character.parts[0].skin


def test_the_cured_scene_is_written_and_read(scene: Scene, tmp_path: Path) -> None:
    cured = cures.raised(cures.turned(cures.scaled(scene, 0.5), 30), 0.1)
    io.save(Scene(cured.characters, cured.animations), tmp_path / "a.glb")
    back = io.load(tmp_path / "a.glb")
    assert scene_error(Scene(cured.characters, cured.animations), back).within(2e-3, 2e-3)


def test_the_page_on_checking() -> None:
    result = doctest.testfile(str(ROOT / "docs" / "check.md"), module_relative=False, encoding="utf-8")
    assert result.attempted and not result.failed
