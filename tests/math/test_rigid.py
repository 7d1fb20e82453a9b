"""Rigid and affine transforms: TRS and matrices, mirrored and flattened ones included."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from keypose.errors import ShapeError
from keypose.math import quat, rigid


def random_quats(rng, *shape):
    q = rng.normal(size=(*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def test_the_matrix_is_t_r_s(library, rng):
    t, q, s = rng.normal(size=(30, 3)), random_quats(rng, 30), rng.uniform(-2, 2, size=(30, 3))
    ours = library.numpy(rigid.from_trs(library.array(t), library.array(q), library.array(s)))
    expected = np.broadcast_to(np.eye(4), (30, 4, 4)).copy()
    expected[:, :3, :3] = Rotation.from_quat(q, scalar_first=True).as_matrix() * s[:, None, :]
    expected[:, :3, 3] = t
    np.testing.assert_allclose(ours, expected, atol=8 * library.eps)
    unscaled = library.numpy(rigid.from_trs(library.array(t), library.array(q)))
    np.testing.assert_allclose(np.linalg.det(unscaled[:, :3, :3]), 1, atol=8 * library.eps)


def test_trs_round_trip_of_positive_scales(library, rng):
    t, q, s = rng.normal(size=(40, 3)), random_quats(rng, 40), rng.uniform(0.1, 3, size=(40, 3))
    m = rigid.from_trs(library.array(t), library.array(q), library.array(s))
    back_t, back_q, back_s = (library.numpy(x) for x in rigid.to_trs(m))
    np.testing.assert_allclose(back_t, t, atol=2 * library.eps)
    np.testing.assert_allclose(back_s, s, rtol=12 * library.eps)
    np.testing.assert_allclose(np.abs((back_q * q).sum(-1)), 1, atol=8 * library.eps)
    assert np.all(back_q[:, 0] >= 0)


@pytest.mark.parametrize("scale", list(itertools.product([-1.5, 0.0, 1.0], repeat=3)), ids=str)
def test_mirrored_and_flattened_matrices_come_back(scale, library, rng):
    q = np.concatenate([random_quats(rng, 8), [[1, 0, 0, 0]]])
    m = rigid.from_trs(library.array(np.ones((9, 3))), library.array(q), library.array(np.array(scale)))
    t, r, s = rigid.to_trs(m)
    np.testing.assert_allclose(library.numpy(rigid.from_trs(t, r, s)), library.numpy(m), atol=12 * library.eps)
    np.testing.assert_allclose(np.linalg.norm(library.numpy(r), axis=-1), 1, atol=4 * library.eps)
    assert np.all(
        (library.numpy(s)[:, 0] < 0) == (np.prod(scale) < 0)
    )  # a mirror goes into X, nothing else is negative
    assert np.all(library.numpy(s)[:, 1:] >= 0)


def test_a_scale_of_zero_keeps_what_is_known(library):
    turned = [np.cos(0.3), 0, 0, np.sin(0.3)]
    for scale in ([1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 0, 0], [0, 1, 0]):
        m = rigid.from_trs(library.array([0, 0, 0]), library.array(turned), library.array(scale))
        np.testing.assert_allclose(
            library.numpy(rigid.to_trs(m)[1])[[0, 3]], [turned[0], turned[3]], atol=4 * library.eps
        )
    _, q, s = rigid.to_trs(library.array(np.diag([0, 0, 0, 1.0])))
    np.testing.assert_array_equal(library.numpy(q), [1, 0, 0, 0])
    np.testing.assert_array_equal(library.numpy(s), [0, 0, 0])
    _, q, _ = rigid.to_trs(library.array(np.diag([0, 2, 0, 1.0])))
    np.testing.assert_array_equal(library.numpy(q), [1, 0, 0, 0])


def test_shear_is_dropped_but_x_keeps_its_direction(rng):
    m = np.eye(4)
    m[:3, :3] = rng.normal(size=(3, 3))
    m[:3, 0] *= np.sign(np.linalg.det(m[:3, :3]))
    _, q, s = rigid.to_trs(m)
    axes = quat.to_matrix(q)
    np.testing.assert_allclose(axes[:, 0], m[:3, 0] / np.linalg.norm(m[:3, 0]), atol=1e-14)
    assert abs(np.dot(axes[:, 2], m[:3, 1])) < 1e-14  # Y stays in the plane of X and Y
    np.testing.assert_allclose(s, np.linalg.norm(m[:3, :3], axis=0), atol=1e-14)


def test_inverse_of_affine_matrices(library, rng):
    m = np.broadcast_to(np.eye(4), (30, 4, 4)).copy()
    m[:, :3] = rng.normal(size=(30, 3, 4))
    m = m[np.linalg.cond(m) < 50]
    ours = library.numpy(rigid.inverse(library.array(m)))
    np.testing.assert_allclose(ours, np.linalg.inv(m), atol=2000 * library.eps)
    np.testing.assert_array_equal(ours[:, 3], np.broadcast_to([0, 0, 0, 1], ours[:, 3].shape))


def test_a_flattened_space_has_a_finite_inverse(library):
    flat = rigid.from_trs(library.array([1, 2, 3]), library.array([1, 0, 0, 0]), library.array([1, 0, 1]))
    expected = np.diag([0, 0, 0, 1.0])
    np.testing.assert_array_equal(np.abs(library.numpy(rigid.inverse(flat))), expected)


def test_compose_chains_and_points_follow(library, rng):
    a, b = (rigid.from_trs(library.array(rng.normal(size=(20, 3))), library.array(random_quats(rng, 20))) for _ in "ab")
    p = library.array(rng.normal(size=(20, 3)))
    number = library.numpy
    np.testing.assert_allclose(number(rigid.compose(a, b)), number(a) @ number(b), atol=12 * library.eps)
    stepwise = rigid.transform_points(a, rigid.transform_points(b, p))
    np.testing.assert_allclose(
        number(rigid.transform_points(rigid.compose(a, b), p)), number(stepwise), atol=30 * library.eps
    )
    back = rigid.transform_points(rigid.inverse(a), rigid.transform_points(a, p))
    np.testing.assert_allclose(number(back), number(p), atol=30 * library.eps)
    origin = number(rigid.transform_vectors(a, library.array([0, 0, 0])))
    np.testing.assert_array_equal(origin, np.zeros((20, 3)))


def test_broadcasting_and_empty_batches(library, rng):
    m = rigid.from_trs(library.array(np.zeros((6, 1, 3))), library.array([1, 0, 0, 0]), library.array([1, 2, 3]))
    assert library.numpy(m).shape == (6, 1, 4, 4)
    assert library.numpy(rigid.transform_points(m, library.array(rng.normal(size=(5, 3))))).shape == (6, 5, 3)
    none = library.array(np.zeros((0, 4, 4)))
    assert [library.numpy(x).shape for x in rigid.to_trs(none)] == [(0, 3), (0, 4), (0, 3)]
    assert library.numpy(rigid.inverse(none)).shape == (0, 4, 4)
    assert rigid.transform_points(np.eye(4).tolist(), [1, 2, 3]).tolist() == [1, 2, 3]
    assert rigid.from_trs(np.zeros(3, np.float32), [1, 0, 0, 0]).dtype == np.float32


def test_wrong_shapes_are_named():
    with pytest.raises(ShapeError, match=r"matrix: expected \(\*B, 4, 4\), got \(3, 3\)"):
        rigid.inverse(np.eye(3))
    with pytest.raises(ShapeError, match=r"scale: expected \(\*B, 3\)"):
        rigid.from_trs(np.zeros(3), np.ones(4), 2.0)
