"""The compiled Euler conversion against `keypose.math.euler` and SciPy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from keypose.errors import ShapeError, UnknownName
from keypose.kernels.euler import degrees_from_quaternions, quaternions_from_degrees
from keypose.math import euler, quat

ORDERS = ["".join(p) for p in itertools.permutations("XYZ")]


def table(
    rng: np.random.Generator, frames: int, joints: int, spread: float = 40, missing: float = 0.1
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Random walks of angles, where each joint's columns are, and its order; some channels are missing."""
    orders = [str(o) for o in rng.choice(ORDERS, joints)]
    count = 3 * joints + 2
    columns = rng.permutation(count)[: 3 * joints].reshape(joints, 3)
    columns[rng.random((joints, 3)) < missing] = count
    return np.cumsum(rng.normal(size=(frames, count)) * spread, axis=0), columns, orders


@pytest.mark.parametrize("joints", [1, 2, 3, 5, 8, 9, 31])
@pytest.mark.parametrize("frames", [0, 1, 2, 40])
def test_rotations_equal_the_reference(joints: int, frames: int) -> None:
    values, columns, orders = table(np.random.default_rng(joints), frames, joints)
    found = quaternions_from_degrees(values, columns, orders)
    padded = np.concatenate([values, np.zeros((frames, 1))], axis=1)
    for joint, order in enumerate(orders):
        angles = padded[:, columns[joint]]
        wanted = euler.to_quat(np.radians(angles), order)
        wanted = quat.align_signs(wanted, axis=0) if frames else wanted
        np.testing.assert_allclose(found[:, joint], wanted, atol=5e-15)
        if frames:
            theirs = Rotation.from_euler(order, angles, degrees=True).as_matrix()
            np.testing.assert_allclose(quat.to_matrix(found[:, joint]), theirs, atol=1e-14)


def test_angles_of_every_size_keep_their_precision() -> None:
    sizes = 10.0 ** np.linspace(-12, 6, 400)
    values = np.concatenate([sizes, -sizes, np.arange(-1440, 1441, 45.0), np.arange(-720, 721, 180) + 1e-9])[:, None]
    found = quaternions_from_degrees(values, np.array([[0, 1, 1]]), ["XYZ"])
    found = found * np.where(np.sum(found * found[:1], axis=-1) < 0, -1, 1)[..., None]
    half = np.radians(np.fmod(values[:, 0], 720)) / 2  # fmod is exact
    wanted = np.stack([np.cos(half), np.sin(half)], axis=-1)
    same = np.abs(np.abs(np.sum(found[:, 0, :2] * wanted, axis=-1)) - 1)
    assert same.max() < 4e-15
    small = np.abs(values[:, 0]) < 1e-3  # a tiny angle keeps its relative precision
    np.testing.assert_allclose(np.abs(found[small, 0, 1]), np.abs(np.sin(np.radians(values[small, 0]) / 2)), rtol=1e-14)


@pytest.mark.parametrize("joints", [1, 3, 8, 31])
@pytest.mark.parametrize("spread", [5, 40, 200])
def test_degrees_equal_the_reference(joints: int, spread: float) -> None:
    values, columns, orders = table(np.random.default_rng(joints), 50, joints, spread, missing=0)
    rotations = quaternions_from_degrees(values, columns, orders)
    out = np.full((50, 3 * joints), np.nan)
    lost = degrees_from_quaternions(rotations, orders, np.arange(3 * joints).reshape(-1, 3), out)
    assert not lost.any()
    for joint, order in enumerate(orders):
        wanted = np.degrees(euler.unroll(euler.from_quat(rotations[:, joint], order), order, axis=0))
        np.testing.assert_allclose(out[:, 3 * joint : 3 * joint + 3], wanted, atol=1e-9)


def test_every_quadrant_and_gimbal_lock() -> None:
    angles = np.array(
        list(
            itertools.product(np.arange(-180, 181, 45.0), [-90, -89.999999, -45, 0, 45, 90], np.arange(-180, 181, 45.0))
        )
    )
    for order in ORDERS:
        rotations = euler.to_quat(np.radians(angles), order)[:, None]
        out = np.empty((len(angles), 3))
        degrees_from_quaternions(rotations, [order], np.array([[0, 1, 2]]), out)
        back = euler.to_quat(np.radians(out), order)
        np.testing.assert_allclose(np.abs(np.sum(back * rotations[:, 0], axis=-1)), 1, atol=1e-14)
        for one, found in zip(
            rotations[::7], out[::7], strict=True
        ):  # single frames: no unrolling, the principal angles
            single = np.empty((1, 3))
            degrees_from_quaternions(one[None], [order], np.array([[0, 1, 2]]), single)
            back = euler.to_quat(np.radians(single[0]), order)
            assert abs(abs(float(np.sum(back * one[0]))) - 1) < 1e-14, found
            assert abs(single[0, 1]) <= 90


def test_angles_without_a_column_are_measured() -> None:
    rotations = euler.to_quat(np.radians([[[30.0, 0, 0], [10, 20, -50]], [[40, 0, 0], [10, 20, 5]]]), "ZYX")
    out = np.zeros((2, 4))
    lost = degrees_from_quaternions(rotations, ["ZYX", "ZYX"], np.array([[0, 4, 4], [1, 2, 4]]), out)
    np.testing.assert_allclose(out, [[30, 10, 20, 0], [40, 10, 20, 0]], atol=1e-13)
    np.testing.assert_allclose(lost, [[0, 0, 0], [0, 0, 50]], atol=1e-13)


def test_wrong_arguments_are_refused_before_anything_is_touched() -> None:
    values, columns = np.zeros((2, 3)), np.array([[0, 1, 2]])
    for bad in (
        (values, columns + 2, ["XYZ"]),
        (values, columns - 1, ["XYZ"]),
        (values, columns, ["XYZ"] * 2),
        (values[0], columns, ["XYZ"]),
    ):
        with pytest.raises(ShapeError):
            quaternions_from_degrees(*bad)
    with pytest.raises(UnknownName):
        quaternions_from_degrees(values, columns, ["XYX"])
    rotations = np.zeros((2, 1, 4))
    frozen = np.zeros((2, 3))
    frozen.setflags(write=False)
    for out, where in (
        (frozen, columns),
        (np.zeros((3, 2)).T, columns),
        (np.zeros((2, 3), np.float32), columns),
        (values, columns + 2),
    ):
        with pytest.raises(ShapeError):
            degrees_from_quaternions(rotations, ["XYZ"], where, out)
