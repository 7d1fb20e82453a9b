"""The quality meter: motions with known faults, and captures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from keypose import evaluate, samples
from keypose.analysis import compare_takes, measure_quality
from keypose.errors import ShapeError
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton


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
