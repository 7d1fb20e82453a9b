"""Skinning kernels against sums of matrices in float64."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.errors import ShapeError
from keypose.kernels import skin, skincrowd
from keypose.kernels.runtime import WIDTH

from .conftest import random_motion, unit

TOLERANCE = {np.float32: 2e-5, np.float64: 1e-12}


def random_mesh(vertices, influences, palette, seed, zeros=0.3):
    rng = np.random.default_rng(seed)
    joints = rng.integers(0, palette, (vertices, influences))
    weights = rng.random((vertices, influences)) + 0.01
    weights[:, 1:] *= rng.random((vertices, influences - 1)) > zeros
    return joints, weights / weights.sum(axis=1, keepdims=True), rng.normal(size=(vertices, 3)), unit(
        rng.normal(size=(vertices, 3))
    )  # fmt: skip


def blended(matrices, joints, weights):
    return np.einsum("vk,...vkrc->...vrc", weights, matrices[..., joints, :3, :])


def applied(matrices, joints, weights, points):
    m = blended(matrices, joints, weights)
    return np.einsum("...vrc,vc->...vr", m[..., :3], points) + m[..., 3]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("influences", [1, 2, 4, 5, 8, 13])
@pytest.mark.parametrize("vertices", [0, 1, 15, 16, 200])
def test_any_number_of_influences_and_vertices(dtype, influences, vertices):
    joints, weights, positions, normals = random_mesh(vertices, influences, 9, seed=influences * vertices)
    matrices = random_motion(1, 9, seed=4).models[0]
    moved, turned = skin.linear_blend(
        matrices.astype(dtype), joints, weights.astype(dtype), positions.astype(dtype), normals.astype(dtype)
    )
    alone = skin.linear_blend(matrices.astype(dtype), joints, weights.astype(dtype), positions.astype(dtype))
    wanted = applied(matrices, joints, weights, positions)
    wanted_normals = np.einsum("vrc,vc->vr", blended(matrices, joints, weights)[..., :3], normals)
    assert moved.dtype == dtype and moved.shape == (vertices, 3)
    scale = TOLERANCE[dtype] * (1 + abs(matrices).max())
    assert abs(moved - wanted).max(initial=0) < scale
    assert abs(alone - wanted).max(initial=0) < scale
    assert abs(turned - wanted_normals).max(initial=0) < scale


@pytest.mark.parametrize("rows", [3, 4])
def test_batches_of_poses_and_three_row_matrices(rows):
    joints, weights, positions, _ = random_mesh(50, 4, 6, seed=1)
    matrices = random_motion(6, 6, seed=2).models.reshape(2, 3, 6, 4, 4)
    moved = skin.linear_blend(matrices[..., :rows, :], joints, weights, positions)
    assert moved.shape == (2, 3, 50, 3)
    assert abs(moved - applied(matrices, joints, weights, positions)).max() < 1e-12


def test_normals_by_their_own_matrices_have_length_one_and_zero_stays_zero():
    joints, weights, positions, normals = random_mesh(70, 4, 5, seed=3)
    normals[11] = 0
    models = random_motion(1, 5, seed=1).models[0]
    own = np.linalg.inv(models[:, :3, :3]).transpose(0, 2, 1) * 3.0
    mesh = skin.compile_mesh(joints, weights, positions, normals)
    _, turned = skin.skin(mesh, models, own, with_normals=True)
    wanted = np.einsum("vk,vkrc,vc->vr", weights, own[joints], normals)
    wanted = np.divide(wanted, np.linalg.norm(wanted, axis=1, keepdims=True), where=normals != 0, out=np.zeros((70, 3)))
    assert abs(turned - wanted).max() < 1e-6
    assert not turned[11].any()


def test_the_order_of_vertices_does_not_matter(rng):
    joints, weights, positions, _ = random_mesh(300, 4, 7, seed=9)
    matrices = random_motion(1, 7, seed=6).models[0]
    order = rng.permutation(300)
    moved = skin.linear_blend(matrices, joints, weights, positions)
    shuffled = skin.linear_blend(matrices, joints[order], weights[order], positions[order])
    assert np.allclose(shuffled, moved[order], atol=1e-13)


def test_the_same_joint_in_two_slots_counts_twice():
    matrices = random_motion(1, 3, seed=1).models[0]
    twice = skin.linear_blend(matrices, [[2, 2, 1]], [[0.25, 0.25, 0.5]], [[1.0, 2, 3]])
    once = skin.linear_blend(matrices, [[2, 1]], [[0.5, 0.5]], [[1.0, 2, 3]])
    assert np.allclose(twice, once, atol=1e-14)


@pytest.mark.parametrize("influences", [1, 3, 4, 6, 9])
def test_crowds_equal_single_characters(influences):
    characters, bones = 2 * WIDTH, 11
    joints, weights, positions, normals = random_mesh(130, influences, bones - 2, seed=influences)
    palette = np.arange(bones - 2) + 2
    bind = random_motion(1, bones - 2, seed=5).models[0]
    models = random_motion(characters, bones, seed=8).models
    lanes = models[:, :, :3].reshape(2, WIDTH, bones, 12).transpose(0, 2, 3, 1)
    mesh = skin.compile_mesh(joints, weights.astype(np.float32), positions.astype(np.float32), normals, palette, bind)
    wanted = applied(models[:, palette] @ bind, joints, weights, positions)
    limit = 1e-5 * (1 + abs(wanted).max())
    for with_normals in (False, True):
        out = skincrowd.skin_crowd(mesh, np.ascontiguousarray(lanes, np.float32), with_normals)
        flat = out.transpose(0, 3, 1, 2).reshape(characters, 130, -1)
        assert abs(flat[..., :3] - wanted).max() < limit
    turned = np.einsum("...vrc,vc->...vr", blended(models[:, palette] @ bind, joints, weights)[..., :3], normals)
    assert abs(flat[..., 3:] - turned).max() < limit


def test_weights_that_do_not_sum_to_one_are_taken_as_they_are():
    joints, weights, positions, normals = random_mesh(64, 4, 5, seed=2)
    models = random_motion(WIDTH, 5, seed=3).models
    mesh = skin.compile_mesh(
        joints, (0.4 * weights).astype(np.float32), positions.astype(np.float32), normals, np.arange(5),
        np.tile(np.eye(4), (5, 1, 1)),
    )  # fmt: skip
    lanes = np.ascontiguousarray(models[:, :, :3].reshape(1, WIDTH, 5, 12).transpose(0, 2, 3, 1), np.float32)
    wanted = 0.4 * applied(models, joints, weights, positions)
    assert abs(skincrowd.skin_crowd(mesh, lanes).transpose(0, 3, 1, 2)[0] - wanted).max() < 1e-5 * (
        1 + abs(wanted).max()
    )
    assert abs(skin.skin(mesh, models[0])[0] - wanted[0]).max() < 1e-5 * (1 + abs(wanted).max())


def test_what_does_not_fit_is_refused():
    mesh = skin.compile_mesh([[4]], [[1.0]], [[0.0, 0, 0]])
    with pytest.raises(ShapeError, match="matrices"):
        skin.skin(mesh, np.zeros((4, 4, 4)))
    with pytest.raises(ShapeError, match="normals"):
        skin.skin(mesh, np.zeros((5, 4, 4)), with_normals=True)
    with pytest.raises(ShapeError, match="joints"):
        skin.compile_mesh([[-1]], [[1.0]], [[0.0, 0, 0]])
    with pytest.raises(ShapeError, match="mesh"):
        skin.compile_mesh([[0]], [[1.0], [1.0]], [[0.0, 0, 0]])
    with pytest.raises(ShapeError, match="palette"):
        skincrowd.skin_crowd(mesh, np.zeros((1, 5, 12, WIDTH), np.float32))
