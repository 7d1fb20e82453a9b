"""Forward kinematics kernels against products of 4x4 matrices in float64."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.errors import ShapeError
from keypose.kernels import fk
from keypose.kernels.runtime import aligned

from .conftest import chained, matrix, random_motion

SIZES = [(0, 5), (1, 1), (1, 7), (3, 26), (16, 16), (17, 5), (33, 67), (100, 26)]
TOLERANCE = {np.float32: 2e-5, np.float64: 1e-12}


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("frames", "joints"), SIZES)
def test_rotations_and_positions_are_those_of_the_matrices(dtype, frames, joints):
    motion = random_motion(frames, joints, seed=frames + joints)
    turned, moved = fk.rotations_positions(
        motion.parents, motion.rotations.astype(dtype), motion.translations.astype(dtype)
    )
    assert turned.dtype == moved.dtype == dtype
    assert turned.shape == (frames, joints, 4) and moved.shape == (frames, joints, 3)
    scale = 1 + abs(motion.models[..., :3, 3]).max(initial=0)
    assert abs(matrix(turned.astype(float)) - motion.models[..., :3, :3]).max(initial=0) < TOLERANCE[dtype]
    assert abs(moved - motion.models[..., :3, 3]).max(initial=0) < TOLERANCE[dtype] * scale


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("frames", "joints"), SIZES)
def test_matrices_with_scales_that_move_stand_still_or_are_not_given(dtype, frames, joints):
    m = random_motion(frames, joints, seed=frames * joints, deep=joints < 20)
    still, size = m.translations[:1].reshape(-1, 3)[:joints] if frames else np.zeros((joints, 3)), m.scales
    for translations, scales in ((m.translations, size), (still, None), (m.translations, np.full((joints, 3), 1.5))):
        got = fk.matrices(
            m.parents,
            m.rotations.astype(dtype),
            translations.astype(dtype),
            None if scales is None else scales.astype(dtype),
        )
        wanted = chained(
            m.parents,
            m.rotations,
            np.broadcast_to(translations, m.translations.shape),
            None if scales is None else np.broadcast_to(scales, m.scales.shape),
        )
        assert got.shape == wanted.shape and got.dtype == dtype
        assert abs(got - wanted).max(initial=0) < TOLERANCE[dtype] * (1 + abs(wanted).max(initial=0))


def test_roots_replace_the_translations_of_every_root():
    motion = random_motion(40, 12, seed=3)
    roots = np.random.default_rng(1).normal(size=(40, 3))
    full = motion.translations.copy()
    full[:, motion.parents < 0] = roots[:, None]
    offsets = motion.translations[0]
    wanted = fk.rotations_positions(motion.parents, motion.rotations, np.where(
        (motion.parents < 0)[None, :, None], full, offsets
    ))  # fmt: skip
    got = fk.rotations_positions(motion.parents, motion.rotations, offsets, roots)
    assert all(np.array_equal(a, b) for a, b in zip(got, wanted, strict=True))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", ["any", "chain", "star", "two roots"])
def test_lanes_hold_the_same_numbers(dtype, shape):
    count, joints = fk.lane_count(dtype), 9
    frames, row = 4 * count, 48
    motion = random_motion(frames, joints, seed=5)
    parents = {
        "any": motion.parents,
        "chain": np.arange(joints) - 1,
        "star": np.minimum(np.arange(joints) - 1, 0),
        "two roots": np.array([-1, 0, 1, 1, -1, 4, 4, 2, 6]),
    }[shape]
    roots, offsets = motion.translations[:, 0].astype(dtype), motion.translations[0].astype(dtype)
    rotations = motion.rotations.astype(dtype)
    rows = aligned(frames * row, dtype).reshape(frames, row)
    rows[:, : 4 * joints] = rotations.reshape(frames, -1)
    starts = np.ascontiguousarray(roots.reshape(-1, count, 3).transpose(0, 2, 1))
    out = fk.rotations_positions_lanes(parents, rows, offsets, starts)
    turned, moved = fk.rotations_positions(parents, rotations, offsets, roots)
    wanted = np.concatenate([turned, moved], axis=2)
    assert out.dtype == dtype
    assert np.allclose(out.transpose(0, 3, 1, 2).reshape(wanted.shape), wanted, atol=100 * np.finfo(dtype).eps)
    for array in (rows, offsets, starts):
        array.flags.writeable = False
    assert np.array_equal(fk.rotations_positions_lanes(parents, rows, offsets, starts, np.zeros_like(out)), out)
    with pytest.raises(ShapeError, match="offsets"):
        fk.rotations_positions_lanes(parents, rows, offsets[1:], starts)


def test_frozen_sliced_and_integer_arguments_are_safe():
    motion = random_motion(50, 8, seed=8)
    wanted = fk.rotations_positions(motion.parents, motion.rotations[::2], motion.translations[::2])
    motion.rotations.flags.writeable = False
    got = fk.rotations_positions(motion.parents.astype(np.int32), motion.rotations[::2], motion.translations[::2])
    assert np.array_equal(got[0], wanted[0]) and np.array_equal(got[1], wanted[1])
    whole = fk.rotations_positions([-1], np.array([[[1, 0, 0, 0]]]), np.array([[1, 2, 3]]))
    assert whole[0].dtype == np.float64 and whole[1].tolist() == [[[1, 2, 3]]]


def test_nan_stays_in_its_frame():
    motion = random_motion(40, 6, seed=2)
    motion.rotations[17, 0] = np.nan
    moved = fk.rotations_positions(motion.parents, motion.rotations, motion.translations)[0]
    assert np.isnan(moved[17, 0]).all()
    assert np.isfinite(np.delete(moved, 17, axis=0)).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rotations": np.ones((4, 3, 3))}, "rotations"),
        ({"translations": np.ones((4, 2, 3))}, "translations"),
        ({"parents": [-1, 1, 0]}, "parents"),
        ({"parents": [-1, 0]}, "parents"),
        ({"roots": np.ones((3, 3))}, "roots"),
    ],
)
def test_what_does_not_fit_is_refused(change, message):
    arguments = {"parents": [-1, 0, 1], "rotations": np.ones((4, 3, 4)), "translations": np.ones((3, 3)), "roots": None}
    with pytest.raises(ShapeError, match=message):
        fk.rotations_positions(**{**arguments, **change})
