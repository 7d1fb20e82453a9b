"""Euler angles: SciPy as a reference in all 24 conventions, gimbal lock, the Euler filter."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from keypose.errors import ShapeError, UnknownName
from keypose.math import euler, quat

PI = np.pi
every_order = pytest.mark.parametrize("order", euler.CONVENTIONS)


def is_proper(order):
    return order[0] == order[2]


def locked_angles(order):
    return (0.0, PI) if is_proper(order) else (-PI / 2, PI / 2)


def random_angles(order, rng, count=200, margin=0.01):
    angles = rng.uniform(-PI, PI, size=(count, 3))
    low, high = (0, PI) if is_proper(order) else (-PI / 2, PI / 2)
    angles[:, 1] = rng.uniform(low + margin, high - margin, size=count)
    return angles


def scipy(q):
    return Rotation.from_quat(np.asarray(q, np.float64), scalar_first=True)


def rotation_error(q, reference):
    return quat.angle_between(np.asarray(q, np.float64), reference).max(initial=0.0)


def turns_apart(a, b):
    """The largest difference of two sets of angles, whole turns not counted."""
    return np.abs((a - b + PI) % (2 * PI) - PI).max(initial=0.0)


def test_there_are_24_conventions():
    assert len(set(euler.CONVENTIONS)) == 24


@every_order
def test_scipy_agrees_both_ways(order, library, rng):
    angles = np.asarray(random_angles(order, rng), library.dtype)
    q = euler.to_quat(library.array(angles), order)
    reference = Rotation.from_euler(order, angles.astype(np.float64))
    assert rotation_error(library.numpy(q), reference.as_quat(scalar_first=True)) < 8 * library.eps
    back = library.numpy(euler.from_quat(q, order))
    theirs = scipy(library.numpy(q)).as_euler(order)
    assert turns_apart(back, theirs) < 400 * library.eps
    assert turns_apart(back, angles.astype(np.float64)) < 600 * library.eps


@every_order
def test_axis_quaternions_multiplied_one_by_one(order, rng):
    angles = rng.uniform(-7, 7, size=(20, 3))
    factors = [quat.from_axis_angle(np.eye(3)["xyz".index(a)], angles[:, n]) for n, a in enumerate(order.lower())]
    if order.islower():
        factors.reverse()
    product = quat.multiply(quat.multiply(factors[0], factors[1]), factors[2])
    np.testing.assert_allclose(euler.to_quat(angles, order), product, atol=1e-15)


@every_order
def test_every_rotation_comes_back_in_range(order, rng):
    q = rng.normal(size=(500, 4))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    angles = euler.from_quat(q, order)
    assert rotation_error(euler.to_quat(angles, order), q) < 3e-15
    assert np.all(np.abs(angles[:, [0, 2]]) <= PI)
    low, high = (0, PI) if is_proper(order) else (-PI / 2, PI / 2)
    assert np.all((angles[:, 1] >= low) & (angles[:, 1] <= high))
    assert turns_apart(euler.from_quat(-q, order), angles) < 1e-12


@every_order
def test_at_the_lock_the_third_angle_is_zero(order, library, rng):
    angles = rng.uniform(-PI, PI, size=(60, 3))
    angles[:, 1] = rng.choice(locked_angles(order), size=60)
    angles[:9, [0, 2]] = np.array(np.meshgrid([0, PI / 2, PI], [0, PI / 2, PI])).reshape(2, 9).T
    q = euler.to_quat(library.array(angles), order)
    found = library.numpy(euler.from_quat(q, order)).astype(np.float64)
    np.testing.assert_array_equal(found[:, 2], 0)
    assert rotation_error(euler.to_quat(found, order), library.numpy(q).astype(np.float64)) < 12 * library.eps
    assert np.abs(found[:, 1] - angles[:, 1]).max() < 40 * library.eps
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # SciPy warns of the lock and makes the same choice
        theirs = scipy(library.numpy(q)).as_euler(order)
    if library.dtype == "float64":
        assert turns_apart(found, theirs) < 1e-14


@every_order
@pytest.mark.parametrize("gap", [1e-15, 1e-14, 1e-12, 1e-9, 1e-7, 1e-4])
def test_near_the_lock_the_rotation_stays_exact(order, gap, rng):
    angles = rng.uniform(-PI, PI, size=(60, 3))
    lock = rng.choice(locked_angles(order), size=60)
    angles[:, 1] = lock - gap * np.where(lock == max(locked_angles(order)), 1, -1)
    q = euler.to_quat(angles, order)
    found = euler.from_quat(q, order)
    assert (
        rotation_error(euler.to_quat(found, order), q) < 64 * np.finfo(float).eps
    )  # a lock within 16 eps is taken as one
    np.testing.assert_allclose(found[:, 1], angles[:, 1], atol=64 * np.finfo(float).eps)


@every_order
def test_gimbal_distance_measures_the_middle_angle(order, library):
    for lock in locked_angles(order):
        middle = lock + np.array([0, 0.1, -0.2, PI, PI + 0.3, -3 * PI, 0.5 * PI])
        angles = np.stack([np.ones(7), middle, np.ones(7)], -1)
        distance = library.numpy(euler.gimbal_distance(library.array(angles), order))
        np.testing.assert_allclose(distance, [0, 0.1, 0.2, 0, 0.3, 0, 0.5 * PI], atol=12 * library.eps)


@every_order
def test_unroll_gives_back_a_continuous_track(order, library):
    t = np.linspace(0, 1, 400)[:, None, None]
    middle = 0.4 * PI * np.sin(5 * t) + (0.5 * PI if is_proper(order) else 0)
    track = np.concatenate([9 * t, middle, -7 * t + 1], -1) * np.ones((1, 2, 1))
    wrapped = library.array(euler.from_quat(euler.to_quat(track, order), order))
    smooth = library.numpy(euler.unroll(wrapped, order))
    assert np.abs(np.diff(smooth, axis=0)).max() < 0.05
    np.testing.assert_allclose(smooth, track, atol=300 * library.eps)
    other_axis = euler.unroll(library.array(library.numpy(wrapped).swapaxes(0, 1)), order, axis=1)
    np.testing.assert_array_equal(library.numpy(other_axis).swapaxes(0, 1), smooth)


@every_order
def test_unroll_passes_through_the_lock(order, library):
    """A middle angle that runs through the lock and on: wrapped angles jump by half a turn there, unrolled ones do not."""
    t = np.linspace(-1, 1, 101)[:, None]  # even count of steps, but no frame exactly at the lock
    track = np.concatenate([0.3 + 0 * t, max(locked_angles(order)) + 0.7 * (t + 0.003), -0.5 + 0 * t], -1)
    q = euler.to_quat(track, order)
    wrapped = euler.from_quat(q, order)
    assert np.abs(np.diff(wrapped, axis=0)).max() > 3
    smooth = library.numpy(euler.unroll(library.array(wrapped), order))
    assert np.abs(np.diff(smooth, axis=0)).max() < 0.02
    assert rotation_error(euler.to_quat(smooth, order), q) < 16 * library.eps


def test_unroll_keeps_rotations_of_any_noise(rng):
    angles = rng.uniform(-20, 20, size=(50, 3))
    for order in ("XYZ", "zxz"):
        smooth = euler.unroll(angles, order)
        np.testing.assert_array_equal(smooth[0], angles[0])
        assert rotation_error(euler.to_quat(smooth, order), euler.to_quat(angles, order)) < 1e-13


def test_shapes(library):
    angles = library.array(np.zeros((2, 0, 3)))
    assert library.numpy(euler.from_quat(euler.to_quat(angles, "ZXY"), "ZXY")).shape == (2, 0, 3)
    assert library.numpy(euler.unroll(angles, "ZXY", axis=1)).shape == (2, 0, 3)
    assert library.numpy(euler.gimbal_distance(angles, "ZXY")).shape == (2, 0)
    assert euler.to_quat([0, 0, PI / 2], "XYZ").shape == (4,)
    assert euler.from_quat([1, 0, 0, 0], "XYZ").tolist() == [0, 0, 0]


def test_errors_teach():
    with pytest.raises(UnknownName, match="no Euler order 'XYYZ'"):
        euler.to_quat([0, 0, 0], "XYYZ")
    for order in ("XXZ", "Xyz", "", "XY"):
        with pytest.raises(UnknownName):
            euler.from_quat([1, 0, 0, 0], order)
    with pytest.raises(ShapeError, match=r"angles: expected \(\*B, 3\)"):
        euler.to_quat([0, 0, 0, 0], "XYZ")
    with pytest.raises(ShapeError, match="axis"):
        euler.unroll(np.zeros((4, 3)), "XYZ", axis=1)
