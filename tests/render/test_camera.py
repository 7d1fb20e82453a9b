"""Framing: nothing is cut off, nothing is wasted."""

import numpy as np
import pytest

from keypose.model import Scene
from keypose.render import Camera, RenderSettings
from keypose.render.camera import Framing, frame
from keypose.render.stage import Stage
from tests.render.conftest import arm, wave


def seen(view, points):
    clip = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ view.clip_from_world.T
    assert np.all(clip[:, 3] > 0)
    return clip[:, :3] / clip[:, 3:]


def stage_of(travel=0.0, **changes):
    character = arm()
    settings = RenderSettings(**changes)
    return Stage(Scene((character,), (wave(character, travel=travel),)), None, settings), settings


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("aspect", [0.4, 1.0, 16 / 9])
@pytest.mark.parametrize("angles", [(0, 0), (32, 10), (-120, 60), (250, -35)])
def test_the_subject_fits_and_fills(orthographic, aspect, angles):
    stage, _ = stage_of()
    camera = Camera(*angles, orthographic=orthographic, margin=0.1)
    framing = Framing(stage, camera, aspect)
    reach = np.zeros(2)
    for time_s, points in zip(stage.survey_times, stage.survey_points, strict=True):
        view = framing.views(np.array([time_s]))[0]
        reach = np.maximum(reach, np.abs(seen(view, points)[:, :2]).max(axis=0))
    # with a margin of a tenth on either side, what is seen reaches to 0.8, in at least one direction
    assert reach.max() == pytest.approx(0.8, abs=2e-3)
    assert reach.min() <= 0.8 + 1e-6


def test_framing_does_not_depend_on_the_unit_or_place():
    points = np.random.default_rng(0).normal(size=(200, 3))
    eye, _ = frame(points, Camera(), 1.5)
    for scale, shift in ((1e-4, 0.0), (1e5, 3e6)):
        moved, _ = frame(points * scale + shift, Camera(), 1.5)
        np.testing.assert_allclose((moved - shift) / scale, eye, rtol=1e-4, atol=1e-4)


def test_one_point_can_be_framed():
    eye, _ = frame(np.zeros((1, 3)), Camera(), 1.0)
    assert np.all(np.isfinite(eye))


def test_a_traveller_is_followed():
    stage, settings = stage_of(travel=40.0)
    framing = Framing(stage, settings.camera, 16 / 9)
    widths = []
    for time_s, points in zip(stage.survey_times, stage.survey_points, strict=True):
        screen = seen(framing.views(np.array([time_s]))[0], points)
        assert np.abs(screen[:, :2]).max() < 1
        widths.append(np.ptp(screen[:, 1]))
    assert min(widths) > 0.8  # a camera that saw the whole way would show it tiny


def test_follow_can_be_turned_off():
    stage, settings = stage_of(travel=40.0, camera=Camera(follow=False))
    views = Framing(stage, settings.camera, 16 / 9).views(np.array([0.0, 0.9]))
    np.testing.assert_array_equal(views[0].clip_from_world, views[1].clip_from_world)
    for time_s, points in zip(stage.survey_times, stage.survey_points, strict=True):
        assert np.abs(seen(Framing(stage, settings.camera, 16 / 9).views(np.array([time_s]))[0], points)).max() < 1


def test_a_turntable_fits_from_all_sides_and_keeps_its_distance():
    stage, settings = stage_of()
    framing = Framing(stage, settings.camera, 1.0, turning=True)
    angles = np.arange(0, 360, 15.0)
    views = framing.views(np.full(len(angles), stage.start_s), angles)
    center = stage.survey_points.reshape(-1, 3)
    center = (center.min(axis=0) + center.max(axis=0)) / 2
    distances = [np.linalg.norm((v.eye - center)[[0, 2]]) for v in views]
    assert np.ptp(distances) < 0.02 * np.mean(distances)
    for view in views:
        for points in stage.survey_points:
            assert np.abs(seen(view, points)[:, :2]).max() < 0.9
    np.testing.assert_allclose(
        framing.views(np.zeros(1), np.array([360.0]))[0].clip_from_world, views[0].clip_from_world, atol=1e-9
    )


def test_target_and_distance_are_obeyed():
    stage, _ = stage_of()
    view = Framing(stage, Camera(target=(1.0, 2.0, 3.0), distance=5.0), 1.0).views(np.zeros(1))[0]
    assert np.linalg.norm(view.eye - (1, 2, 3)) == pytest.approx(5)
    np.testing.assert_allclose(seen(view, np.array([[1.0, 2.0, 3.0]]))[0, :2], 0, atol=1e-9)


def test_the_key_lights_box_holds_the_subject():
    stage, settings = stage_of(travel=10.0)
    framing = Framing(stage, settings.camera, 1.0)
    for time_s, points in zip(stage.survey_times, stage.survey_points, strict=True):
        view = framing.views(np.array([time_s]))[0]
        light = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ view.light_from_world.T
        assert np.abs(light[:, :3]).max() < 0.97


def test_the_grid_follows_the_size_of_the_subject():
    for scale in (0.001, 1.0, 250.0):
        character = arm()
        motion = wave(character)
        grown = motion.with_pose(
            type(motion.pose)(motion.pose.translations * scale, motion.pose.rotations, np.full((8, 3), 1.0))
        )
        stage = Stage(Scene((type(character)(character.skeleton),), (grown,)), None, RenderSettings())
        cell = Framing(stage, Camera(), 1.0).views(np.zeros(1))[0].cell
        assert 0.1 * stage.height < cell <= 0.55 * stage.height * (1 + 1e-6)
