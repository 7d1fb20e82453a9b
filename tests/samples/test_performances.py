"""The built-in performances: loops close, feet stay where they stand, nothing sinks into the floor, nobody floats."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.analysis import measure_quality
from keypose.errors import UnknownName
from keypose.evaluate import world_rotations_positions
from keypose.math import quat
from keypose.model import Motion
from keypose.samples import performances
from keypose.samples.skeleton import skeleton

NAMES = performances.names()
SOLE_M = 0.026  # height of the toe joint over the sole


def _world(motion: Motion):
    return world_rotations_positions(skeleton(), motion.pose)


@pytest.mark.parametrize("name", NAMES)
def test_is_a_sound_motion(name: str) -> None:
    motion = performances.make(name)
    assert motion.joint_names == skeleton().names and motion.name == name
    assert motion.pose.rotations.dtype == np.float32
    assert np.allclose(np.linalg.norm(motion.pose.rotations, axis=-1), 1, atol=1e-5)
    steps = np.sum(motion.pose.rotations[1:] * motion.pose.rotations[:-1], axis=-1)
    assert np.min(steps) > 0.9, "a rotation changes sign or jumps between two frames"
    assert motion.morph_weights is not None and np.all((motion.morph_weights >= 0) & (motion.morph_weights <= 1))


@pytest.mark.parametrize("name", NAMES)
def test_ends_as_it_begins(name: str) -> None:
    motion = performances.make(name)
    first, last = motion.pose.rotations[0], motion.pose.rotations[-1]
    assert np.max(quat.angle_between(first, last)) < np.radians(1.0)
    moved = motion.pose.translations[-1, 0] - motion.pose.translations[0, 0]
    assert np.allclose(moved, [0, 0, {"walk": 2.5, "run": 4.6}.get(name, 0.0)], atol=2e-3)


@pytest.mark.parametrize("name", NAMES)
def test_soles_stay_above_the_floor(name: str) -> None:
    rotations, positions = _world(performances.make(name))
    for side in ("Left", "Right"):
        ankle, ball = skeleton().index(f"{side}Foot"), skeleton().index(f"{side}ToeBase")
        heel = positions[:, ankle] + quat.rotate(rotations[:, ankle], np.float32([0, -0.098, -0.045]))
        tip = positions[:, ball] + quat.rotate(rotations[:, ball], np.float32([0, -SOLE_M, 0.074]))
        assert heel[:, 1].min() > -2e-3
        assert tip[:, 1].min() > -4e-3
        assert positions[:, ball, 1].min() > SOLE_M - 1e-3


@pytest.mark.parametrize("name", NAMES)
def test_planted_feet_do_not_slide(name: str) -> None:
    """While the heel or the toe joint is on the ground, that point stands still."""
    motion = performances.make(name)
    rotations, positions = _world(motion)
    planted = 0
    for side in ("Left", "Right"):
        ankle, ball = skeleton().index(f"{side}Foot"), skeleton().index(f"{side}ToeBase")
        heel = positions[:, ankle] + quat.rotate(rotations[:, ankle], np.float32([0, -0.098, -0.045]))
        toe = positions[:, ball] - np.float32([0, SOLE_M, 0])
        for point in (heel, toe):
            on_ground = point[:, 1] < 2e-4
            both = on_ground[1:] & on_ground[:-1]
            speed = np.linalg.norm(np.diff(point[:, [0, 2]], axis=0), axis=1) * motion.rate_hz
            planted += int(both.sum())
            if both.any():
                assert speed[both].max() < 0.02
    assert planted > 0.35 * motion.frame_count


@pytest.mark.parametrize("name", NAMES)
def test_knees_never_snap_straight(name: str) -> None:
    _, positions = _world(performances.make(name))
    for side in ("Left", "Right"):
        hip, knee, ankle = (positions[:, skeleton().index(side + j)] for j in ("UpLeg", "Leg", "Foot"))
        full = np.linalg.norm(knee - hip, axis=1) + np.linalg.norm(ankle - knee, axis=1)
        assert np.max(np.linalg.norm(ankle - hip, axis=1) / full) < 0.9985


def test_jump_flies_on_a_parabola() -> None:
    motion = performances.make("jump")
    _, positions = _world(motion)
    ball = np.minimum(*(positions[:, skeleton().index(f"{s}ToeBase"), 1] for s in ("Left", "Right")))
    air = np.nonzero(ball > SOLE_M + 0.02)[0]
    height = motion.pose.translations[air, 0, 1].astype(np.float64)
    assert len(air) > 20
    fall = np.diff(height, n=2) * motion.rate_hz**2
    assert np.allclose(np.median(fall), -9.81, atol=0.15)


def test_run_has_a_flight_and_walk_has_none() -> None:
    for name, flies in (("run", True), ("walk", False)):
        rotations, positions = _world(performances.make(name))
        lowest = []
        for side in ("Left", "Right"):
            ankle, ball = skeleton().index(f"{side}Foot"), skeleton().index(f"{side}ToeBase")
            heel = positions[:, ankle] + quat.rotate(rotations[:, ankle], np.float32([0, -0.098, -0.045]))
            lowest.append(np.minimum(heel[:, 1], positions[:, ball, 1] - SOLE_M))
        assert bool(np.any(np.minimum(*lowest) > 0.02)) is flies


@pytest.mark.parametrize("name", NAMES)
def test_the_quality_meter_finds_nothing(name: str) -> None:
    found = measure_quality(performances.make(name), skeleton())
    assert not found.limit_breaks
    assert not found.pops
    assert found.overlap_cm is not None and found.overlap_cm < 0.1


def test_unknown_performance_names_the_nearest() -> None:
    with pytest.raises(UnknownName, match="nearest: 'walk'"):
        performances.make("walks")
