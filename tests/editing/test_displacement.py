"""Displacement maps: exact at frames, nothing beyond their range, twice differentiable, linear; compared with SciPy's splines."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from keypose import samples
from keypose.editing.displacement import displace, fit_displacement, knot_weights, rotation_change
from keypose.errors import ShapeError
from keypose.math import quat

CASES = [
    ([50], 24),
    ([0], 10),
    ([99], 10),
    ([2, 99], 30),
    ([40, 41, 45, 80], 20),
    (list(range(40, 61)), 24),
    ([*range(30, 50), 90], 12),
    (list(range(100)), 8),
    ([50], 2),
]


@pytest.mark.parametrize(("frames", "ease"), CASES)
def test_exact_at_frames_and_nothing_beyond(frames, ease, rng):
    values = rng.normal(size=(len(frames), 3))
    made = fit_displacement(np.array(frames), values, 100, ease)
    np.testing.assert_allclose(made.values[frames], values, atol=1e-12)
    outside = np.ones(100, bool)
    for start, end in made.ranges:
        outside[max(start + 1, 0) : max(end, 0)] = False
        inner = [f for f in frames if start < f < end]
        assert inner[0] - start == end - inner[-1] == ease
    assert not made.values[outside].any()  # not small: nothing
    spacings = [level.spacing for level in made.levels]
    assert spacings == sorted(spacings, reverse=True) and made.levels[-1].left < 1e-12


def test_basis_is_the_cubic_b_spline_of_scipy():
    spacing, start, count = 2.7, -3.0, 6
    frames = np.arange(-5, 40)
    indices, weights = knot_weights(frames, start, spacing, count)
    ours = np.zeros((len(frames), count))
    np.add.at(ours, (np.arange(len(frames))[:, None], indices), weights)
    for k in range(count):
        knots = start + spacing * (k + np.arange(5))
        theirs = np.nan_to_num(BSpline.basis_element(knots, extrapolate=False)(frames))
        np.testing.assert_allclose(ours[:, k], theirs, atol=1e-14)


def test_second_differences_have_no_jump():
    """The third difference of a curve with a continuous second derivative vanishes as the frames grow denser."""
    jumps = []
    for fine in (1, 4, 16):
        made = fit_displacement(np.array([50 * fine]), np.array([[1.0]]), 100 * fine + 1, 24 * fine).values[:, 0]
        second = np.diff(made, 2) * fine**2
        jumps.append(np.abs(np.diff(second)).max())
    assert jumps[1] < 0.3 * jumps[0] and jumps[2] < 0.3 * jumps[1]
    # and a bend that the same range needs anyway: of the curves that start and end at rest no one bends less than 6 / ease^2
    assert np.abs(second).max() < 3 * 6 / 24**2


def test_a_hold_does_not_swing():
    held = fit_displacement(np.arange(40, 61), np.ones((21, 1)), 100, 24).values[:, 0]
    assert held.max() < 1 + 1e-9 and held.min() > -0.02


def test_it_is_linear_in_the_values(rng):
    frames = np.array([20, 33, 34, 70])
    a, b = rng.normal(size=(2, 4, 3))
    both, one, other = (fit_displacement(frames, v, 100, 15).values for v in (2 * a - 3 * b, a, b))
    np.testing.assert_allclose(both, 2 * one - 3 * other, atol=1e-10)


def test_displacing_a_motion():
    scene = samples.load("walk")
    motion = scene.animations[0]
    count = motion.frame_count
    turns = {5: np.zeros((count, 3)), 9: np.zeros((count, 3))}
    turns[9][30:40] = (0.1, 0.2, -0.3)
    made = displace(motion, turns, {0: np.zeros((count, 3))})
    old, new = motion.pose.broadcast(), made.pose.broadcast()
    others = [j for j in range(old.joint_count) if j != 9]
    assert np.array_equal(old.rotations[:, others], new.rotations[:, others])
    assert np.array_equal(old.rotations[:30, 9], new.rotations[:30, 9])
    assert made.pose.translations is motion.pose.translations
    np.testing.assert_allclose(
        rotation_change(old.rotations[30:40, 9], new.rotations[30:40, 9]), turns[9][30:40], atol=1e-6
    )
    np.testing.assert_allclose(np.linalg.norm(new.rotations, axis=-1), 1, atol=1e-6)
    assert displace(motion, {5: np.zeros((count, 3))}) is motion


def test_small_turns_add_up(rng):
    """Of two small displacements it does not matter which comes first: the difference is of second order."""
    motion = samples.load("walk").animations[0]
    shape = (motion.frame_count, 3)
    for size in (1e-2, 1e-3):
        a, b = (size * rng.normal(size=shape) for _ in "ab")
        one = displace(displace(motion, {7: a}), {7: b}).pose.rotations[:, 7]
        both = displace(motion, {7: a + b}).pose.rotations[:, 7]
        assert quat.angle_between(np.float64(one), np.float64(both)).max() < 10 * size**2 + 1e-6


@pytest.mark.parametrize(
    ("frames", "values", "ease", "says"),
    [
        ([5, 4], np.zeros((2, 3)), 5, "rising"),
        ([5, 5], np.zeros((2, 3)), 5, "rising"),
        ([-1], np.zeros((1, 3)), 5, "rising frames from 0"),
        ([100], np.zeros((1, 3)), 5, "0 to 99"),
        ([5.5], np.zeros((1, 3)), 5, "whole"),
        ([5], np.zeros((2, 3)), 5, "2 whole numbers"),
        ([5], np.full((1, 3), np.nan), 5, "finite"),
        ([5], np.zeros((1, 3)), 1, "ease_frames: expected 2 or more, got 1"),
    ],
)
def test_wrong_input_is_told(frames, values, ease, says):
    with pytest.raises(ShapeError, match=says):
        fit_displacement(np.array(frames), values, 100, ease)
