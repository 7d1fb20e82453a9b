"""Foot contacts: found where a point is low and slow, with hysteresis, over the seam of a cycle, in real walks."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.analysis.contacts import contact_changes, find_contacts
from keypose.errors import ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.samples import performances
from keypose.samples.skeleton import skeleton


def path(heights, speeds, rate_hz=100.0) -> np.ndarray:
    """One point (T, 1, 3) with those heights, moving along X at those speeds."""
    x = np.concatenate([[0.0], np.cumsum(np.asarray(speeds, float))[:-1] / rate_hz])
    return np.stack([x, np.asarray(heights, float), 0 * x], axis=-1)[:, None]


def spans(touching: np.ndarray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], touching.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def test_low_and_slow() -> None:
    height = np.full(100, 0.2)
    height[20:50] = 0.0
    speed = np.full(100, 2.0)
    speed[30:80] = 0.0
    assert spans(find_contacts(path(height, speed), 100.0)[:, 0]) == [(30, 50)]


def test_hysteresis_bridges_a_flutter_around_the_limit() -> None:
    height = np.full(100, 0.2)
    height[20:60] = np.where(np.arange(40) % 2, 0.029, 0.034)  # around 0.03, below 0.045
    speed = np.zeros(100)
    floor = {"floor_m": 0.0, "shortest_s": 0.0}
    # The step up at frame 20 is a speed: the contact begins with the first slow frame below the limit.
    assert len(spans(find_contacts(path(height, speed), 100.0, speed_m_s=9.0, **floor)[:, 0])) == 1
    assert len(spans(find_contacts(path(height, speed), 100.0, speed_m_s=9.0, release=1.0, **floor)[:, 0])) == 20


def test_short_contacts_and_gaps_are_left_out() -> None:
    height = np.full(200, 0.3)
    height[20:80] = 0.0
    height[50:53] = 0.3  # a gap of 30 ms
    height[120:123] = 0.0  # a touch of 30 ms
    touching = find_contacts(path(height, np.zeros(200)), 100.0, speed_m_s=1e3)[:, 0]
    assert spans(touching) == [(20, 80)]


def test_cycles_go_over_the_seam() -> None:
    height = np.full(101, 0.3)
    height[:20] = height[90:] = 0.0
    points = path(height, np.zeros(101))
    touching = find_contacts(points, 100.0, speed_m_s=1e3, cyclic=True)[:, 0]
    begins, ends = contact_changes(touching, cyclic=True)
    assert begins.tolist() == [90] and ends.tolist() == [20]
    begins, ends = contact_changes(touching)
    assert begins.tolist() == [90] and ends.tolist() == [20]
    assert touching[0] == touching[-1]


@pytest.mark.parametrize(("name", "share"), [("walk", 0.55), ("run", 0.33), ("idle", 1.0)])
def test_share_of_contact_in_the_built_in_gaits(name: str, share: float) -> None:
    motion = performances.make(name)
    _, positions = world_rotations_positions(skeleton(), motion.pose)
    feet = positions[:, [skeleton().index("LeftToeBase"), skeleton().index("RightToeBase")]]
    touching = find_contacts(feet, motion.rate_hz, height_m=0.01, speed_m_s=0.3, cyclic=True)
    assert np.allclose(touching[:-1].mean(axis=0), share, atol=0.04)
    if name != "idle":
        for foot in touching.T:
            begins, ends = contact_changes(foot, cyclic=True)
            assert len(begins) == len(ends) == 2  # two cycles
        left, right = (contact_changes(foot, cyclic=True)[0] for foot in touching.T)
        half = (motion.frame_count - 1) / 4
        assert np.allclose((right - left) % (2 * half), half, atol=1.5)


def test_empty_and_wrong_input() -> None:
    assert find_contacts(np.zeros((0, 3, 3)), 60.0).shape == (0, 3)
    assert find_contacts(np.zeros((1, 2, 3)), 60.0).all()
    for positions, rate in ((np.zeros((5, 3)), 60.0), (np.zeros((5, 1, 3)), 0.0)):
        with pytest.raises(ShapeError):
            find_contacts(positions, rate)
    with pytest.raises(ShapeError, match="release"):
        find_contacts(np.zeros((5, 1, 3)), 60.0, release=0.5)


def test_float32_and_float64_agree() -> None:
    motion = performances.make("walk")
    _, positions = world_rotations_positions(skeleton(), motion.pose)
    a = find_contacts(positions.astype(np.float32), 60.0)
    assert np.array_equal(a, find_contacts(positions.astype(np.float64), 60.0))
