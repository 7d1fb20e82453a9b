"""The quality meter: motions with known faults, and captures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from keypose import evaluate, samples
from keypose.analysis import compare_takes, find_roles, measure_quality
from keypose.analysis.ground import Ground
from keypose.analysis.quality import quality_tracks
from keypose.analysis.quality_chart import draw_quality
from keypose.analysis.quality_demands import Demand, read_demands, unmet
from keypose.editing.planting import PlantOptions, plant_feet
from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton
from keypose.samples import performances


@pytest.fixture(scope="module")
def skeleton() -> Skeleton:
    return samples.open_scene("sample:human").character.skeleton


def standing(skeleton: Skeleton, frames: int = 60, rate_hz: float = 30.0, hips: np.ndarray | None = None) -> Motion:
    rest = skeleton.rest
    translations = np.broadcast_to(np.asarray(rest.translations, np.float64), (frames, *rest.translations.shape)).copy()
    if hips is not None:
        translations[:, 0] += hips
    rotations = np.broadcast_to(np.asarray(rest.rotations, np.float64), (frames, *rest.rotations.shape)).copy()
    scales = np.ones((frames, *rest.scales.shape))
    return Motion(skeleton.names, Pose(translations, rotations, scales), rate_hz)


def test_standing_still_is_faultless(skeleton: Skeleton) -> None:
    found = measure_quality(standing(skeleton), skeleton)
    assert (found.skate_cm_s, found.contact_share, found.sink_cm, found.float_share) == (0.0, 1.0, 0.0, 0.0)
    assert found.jerk_m_s3 == pytest.approx(0.0, abs=1e-6) and found.pops == ()
    assert found.loop_cm == pytest.approx(0.0, abs=1e-9) and found.loop_deg == pytest.approx(0.0, abs=1e-5)
    assert found.overlap_cm == 0.0


def test_a_slide_is_measured_in_its_speed(skeleton: Skeleton) -> None:
    way = np.zeros((60, 3))
    way[:, 0] = 0.1 * np.arange(60) / 30.0  # 10 cm/s
    found = measure_quality(standing(skeleton, hips=way), skeleton)
    assert found.skate_cm_s == pytest.approx(10.0, rel=1e-6)
    assert found.worst_skate_cm_s == pytest.approx(10.0, rel=1e-6)
    assert found.loop_cm == pytest.approx(0.0, abs=1e-6)  # the way along the ground is no fault of a loop


def test_sinking_and_floating(skeleton: Skeleton) -> None:
    way = np.zeros((100, 3))
    way[40:60, 1] = -0.05
    found = measure_quality(standing(skeleton, 100, hips=way), skeleton, ground_m=_ground(skeleton))
    assert found.sink_cm == pytest.approx(5.0, abs=0.01) and found.sink_share == pytest.approx(0.2)
    way[:] = 0
    way[30:90, 1] = 0.3  # hangs in the air
    found = measure_quality(standing(skeleton, 100, hips=way), skeleton)
    assert found.float_share is not None and found.float_share > 0.5
    fall = np.zeros((20, 3))
    fall[:, 1] = 1.0 - 0.5 * 9.81 * (np.arange(20) / 100.0) ** 2
    falling = measure_quality(standing(skeleton, 20, 100.0, fall), skeleton, ground_m=_ground(skeleton))
    assert falling.float_share == 0.0


def _ground(skeleton: Skeleton) -> float:
    places = np.asarray(evaluate.world_rotations_positions(skeleton, skeleton.rest)[1], np.float64)
    return float(places[[skeleton.names.index(n) for n in ("LeftToeBase", "LeftFoot")], 1].min())


def test_a_pop_is_found_where_it_is(skeleton: Skeleton) -> None:
    rng = np.random.default_rng(2)
    motion = standing(skeleton, 120)
    rotations = np.array(motion.pose.rotations)
    arm = skeleton.names.index("LeftArm")
    angle = 0.3 * np.sin(np.arange(120) / 10.0)
    angle[70:] += 0.2
    rotations[:, arm] = quat.from_axis_angle(np.array([0.0, 0.0, 1.0]), angle)
    moved = replace(motion, pose=replace(motion.pose, rotations=rotations))
    found = measure_quality(moved, skeleton)
    frame, joint, times = found.pops[0]
    assert abs(frame - 70) <= 2 and times > 12
    assert joint in {skeleton.names[j] for j in range(len(skeleton.names)) if "Left" in skeleton.names[j]}
    assert measure_quality(standing(skeleton, 120, hips=rng.normal(size=(120, 3)) * 1e-5), skeleton).pops == ()


def test_a_hand_in_the_thigh_overlaps(skeleton: Skeleton) -> None:
    motion = standing(skeleton)
    rotations = np.array(motion.pose.rotations)
    for name, turn in (("LeftArm", -1.35), ("LeftForeArm", -0.5)):
        rotations[:, skeleton.names.index(name)] = quat.from_axis_angle(np.array([0.0, 0.0, 1.0]), np.array(turn))
    found = measure_quality(replace(motion, pose=replace(motion.pose, rotations=rotations)), skeleton)
    assert found.overlap_cm is not None and found.overlap_cm > 1.0 and "left lower arm" in found.overlap


def test_a_loop_that_turns_is_still_a_loop(skeleton: Skeleton) -> None:
    motion = standing(skeleton)
    rotations = np.array(motion.pose.rotations)
    rotations[:, 0] = quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), np.linspace(0, 2.5, 60))
    found = measure_quality(replace(motion, pose=replace(motion.pose, rotations=rotations)), skeleton)
    assert found.loop_cm == pytest.approx(0.0, abs=1e-6) and found.loop_deg == pytest.approx(0.0, abs=1e-5)


def test_two_takes(skeleton: Skeleton) -> None:
    first = standing(skeleton)
    same = compare_takes(first, first, skeleton)
    assert (same.mean_cm, same.worst_cm, same.l2p, same.l2q) == (0.0, 0.0, 0.0, 0.0)
    way = np.tile([0.0, 0.02, 0.0], (60, 1))
    apart = compare_takes(first, standing(skeleton, hips=way), skeleton)
    assert apart.mean_cm == pytest.approx(2.0) and apart.worst_cm == pytest.approx(2.0)
    assert apart.l2p == pytest.approx(0.02 * np.sqrt(len(skeleton.names)))
    assert apart.worst_deg == pytest.approx(0.0, abs=1e-5)
    assert len(apart.lines()) == 3
    with pytest.raises(ShapeError, match="rates differ"):
        compare_takes(first, standing(skeleton, rate_hz=60.0), skeleton)


@pytest.mark.data
@pytest.mark.parametrize("file", ["asf_amc/cmu_02/02_01.amc", "bvh/rokoko/jesse_dance.bvh", "gltf/khronos/Fox.glb"])
def test_real_motions_get_figures(data_dir: Path, file: str) -> None:
    scene = samples.open_scene(str(data_dir / file))
    animation, body = scene.animations[0], scene.character.skeleton
    motion = animation if isinstance(animation, Motion) else evaluate.bake(animation, body, 30.0)
    found = measure_quality(motion, body)
    figures = [found.jerk_m_s3, found.loop_cm, found.loop_deg, found.skate_cm_s, found.sink_cm, found.float_share]
    assert all(f is not None and np.isfinite(f) and f >= 0 for f in figures)
    assert len(found.lines()) >= 5


def test_too_short_a_motion_is_refused(skeleton: Skeleton) -> None:
    with pytest.raises(ShapeError, match="at least 2 frames"):
        measure_quality(standing(skeleton, 1), skeleton)


def test_joints_beyond_their_limits_are_told(skeleton: Skeleton) -> None:
    motion = standing(skeleton)
    assert measure_quality(motion, skeleton).limit_deg == 0.0
    rotations = np.array(motion.pose.rotations)
    knee = skeleton.names.index("LeftLeg")
    rotations[20:30, knee] = quat.multiply(
        rotations[20:30, knee], quat.from_axis_angle(np.array([1.0, 0.0, 0.0]), np.array(-1.2))
    )
    found = measure_quality(replace(motion, pose=replace(motion.pose, rotations=rotations)), skeleton)
    joint, degrees, frame, share = found.limit_breaks[0]
    assert joint == "LeftLeg" and degrees > 30 and 20 <= frame < 30 and share == pytest.approx(10 / 60)
    assert found.limit_deg == degrees and any("LeftLeg turns" in line for line in found.lines())


def test_on_a_slope_feet_neither_sink_nor_float(skeleton: Skeleton) -> None:
    roles = dict(find_roles(skeleton).roles)
    walk = performances.make("walk")
    flat = plant_feet(walk, skeleton, roles)
    for rise in (0.15, -0.1):
        ground = Ground(0.0, (0.0, rise))
        up = plant_feet(walk, skeleton, roles, touching=flat.touching, options=PlantOptions(ground=ground)).motion
        found = measure_quality(plant_feet(up, skeleton, roles).motion, skeleton)
        assert found.ground.startswith("a slope") and found.skate_cm_s is not None and found.skate_cm_s < 0.1
        assert found.sink_cm is not None and found.sink_cm < 2.0 and found.float_share == 0.0


def test_a_body_that_lies_does_not_float(skeleton: Skeleton) -> None:
    motion = standing(skeleton)
    rotations = np.array(motion.pose.rotations)
    rotations[:, 0] = quat.from_axis_angle(np.array([1.0, 0.0, 0.0]), np.array(-np.pi / 2))
    translations = np.array(motion.pose.translations)
    translations[:, 0, 1] = 0.12
    lying = replace(motion, pose=Pose(translations, rotations, motion.pose.scales))
    # feet up: the legs point to the sky
    for name in ("LeftUpLeg", "RightUpLeg"):
        rotations[:, skeleton.names.index(name)] = quat.multiply(
            quat.from_axis_angle(np.array([1.0, 0.0, 0.0]), np.array(-np.pi / 2)),
            rotations[:, skeleton.names.index(name)],
        )
    found = measure_quality(replace(lying, pose=replace(lying.pose, rotations=rotations)), skeleton, ground_m=0.0)
    assert found.float_share == 0.0


def test_tracks_sum_up_to_the_figures(skeleton: Skeleton) -> None:
    way = np.zeros((90, 3))
    way[:, 0] = 0.05 * np.sin(np.arange(90) / 8.0)
    way[60:70, 1] = -0.03
    motion = standing(skeleton, 90, hips=way)
    figures, tracks = measure_quality(motion, skeleton), quality_tracks(motion, skeleton)
    assert tracks.feet is not None
    speeds = np.concatenate(list(tracks.feet.slide_cm_s.values()))
    assert np.nanmean(speeds) == pytest.approx(figures.skate_cm_s) and np.nanmax(speeds) == figures.worst_skate_cm_s
    assert tracks.feet.sink_cm.max() == figures.sink_cm
    assert np.sqrt(np.mean(tracks.jerk_m_s3[2:-1] ** 2)) == pytest.approx(figures.jerk_m_s3)
    assert {f for f, _, _ in figures.pops} <= set(np.flatnonzero(tracks.pop >= 12.0))


def test_the_chart_shows_contacts_where_they_are(skeleton: Skeleton) -> None:
    motion = standing(skeleton, 60)
    tracks, figures = quality_tracks(motion, skeleton), measure_quality(motion, skeleton)
    for theme in ("light", "dark"):
        picture = draw_quality(tracks, figures, "a stand", width=700, theme=theme)
        assert picture.shape[1] == 700 and picture.dtype == np.uint8 and (picture[..., 3] == 255).all()
    none = {point: np.zeros(60, bool) for point in ("left_heel", "left_ball", "right_heel", "right_ball")}
    empty = draw_quality(quality_tracks(motion, skeleton, touching=none), figures, "a stand", width=700)
    blue = [
        (np.abs(p[..., :3].astype(int) - (0x2F, 0x6F, 0xD6)).sum(-1) < 12).mean()
        for p in (picture_light(tracks, figures), empty)
    ]
    assert blue[0] > 0.01 > 10 * blue[1]  # the word "left" has that colour, too
    with pytest.raises(ShapeError, match="theme"):
        draw_quality(tracks, figures, theme="sepia")


def picture_light(tracks, figures) -> np.ndarray:
    return draw_quality(tracks, figures, "a stand", width=700)


def test_demands_are_read_and_judged(tmp_path: Path) -> None:
    figures = {
        "skate_cm_s": 3.0,
        "sink_cm": None,
        "pops": [1, 2],
        "contact_share": 0.5,
        "direction": {"mean_direction_deg": 4.0},
    }
    assert unmet(figures, read_demands("skate>3.5, pops>2,contact<0.4,direction>5")) == ()
    lacking = unmet(figures, read_demands("skate>2,pops>1,contact<0.6,direction>3,sink>1"))
    assert len(lacking) == 5 and "skate is 3 cm/s, more than 2" in lacking and "not measured" in lacking[-1]
    toml = tmp_path / "limits.toml"
    toml.write_text("[quality]\nskate = 2.0\ncontact = {least = 0.2, most = 0.9}\n")
    js = tmp_path / "limits.json"
    js.write_text('{"skate": 2, "contact": {"least": 0.2, "most": 0.9}}')
    expected = (Demand("skate", ">", 2.0), Demand("contact", "<", 0.2), Demand("contact", ">", 0.9))
    assert read_demands(str(toml)) == read_demands(str(js)) == expected
    for text, error in (("skat>2", UnknownName), ("skate=2", ShapeError), ("skate>two", ShapeError), ("", ShapeError)):
        with pytest.raises(error):
            read_demands(text)
    for name, content in (("bad.toml", "skate = ["), ("list.json", "[1]"), ("gone.toml", None)):
        path = tmp_path / name
        if content is not None:
            path.write_text(content)
        with pytest.raises(FormatError):
            read_demands(str(path))
    toml.write_text("skate = 'low'")
    with pytest.raises(ShapeError, match="expected a number"):
        read_demands(str(toml))
    toml.write_text("skate = {at_most = 2}")
    with pytest.raises(UnknownName):
        read_demands(str(toml))


@pytest.mark.data
def test_an_animal_on_all_fours_is_measured_without_limits_of_people(data_dir: Path) -> None:
    scene = samples.open_scene(str(data_dir / "gltf/khronos/Fox.glb"))
    body = scene.character.skeleton
    found = measure_quality(evaluate.bake(scene.animation("Survey"), body, 24.0), body)
    assert found.limit_deg is None and found.overlap_cm is None
    assert found.contact_share is not None and found.contact_share > 0.5
