"""Crowds of which only some are skinned, from anywhere, with few and many joints each, through the caches and past them."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.kernels import skin, skincrowd
from keypose.kernels.runtime import WIDTH, aligned

JOINTS = 9


def mesh_of(influences: int, seed: int, vertices: int = 90):
    rng = np.random.default_rng(seed)
    sets = np.array([rng.permutation(JOINTS)[:influences] for _ in range(7)])
    weights = rng.dirichlet(np.ones(influences), vertices)
    positions, normals = rng.normal(size=(2, vertices, 3)).astype(np.float32)
    joints = sets[rng.integers(0, 7, vertices)]
    return joints, weights.astype(np.float32), positions, normals


def crowd_of(blocks: int, seed: int):
    rng = np.random.default_rng(seed)
    models = rng.normal(size=(blocks * WIDTH, JOINTS, 3, 4)).astype(np.float32)
    lanes = np.ascontiguousarray(models.reshape(blocks, WIDTH, JOINTS, 12).transpose(0, 2, 3, 1))
    return models, lanes


def plain(models, joints, weights, points, w):
    matrices = np.einsum("vk,nvkrc->nvrc", weights.astype(np.float64), models[:, joints].astype(np.float64))
    return np.einsum("nvrc,vc->nvr", matrices, np.concatenate([points, np.full((len(points), 1), w)], axis=1))


@pytest.mark.parametrize("past", [False, True])
@pytest.mark.parametrize("influences", [1, 2, 3, 4, 6])
def test_members_from_anywhere(influences, past, monkeypatch):
    if past:
        monkeypatch.setattr(skincrowd, "_PAST_BYTES", 0)
    joints, weights, positions, normals = mesh_of(influences, influences)
    models, lanes = crowd_of(5, 1)
    bind = np.tile(np.eye(4), (JOINTS, 1, 1))
    mesh = skin.compile_mesh(joints, weights, positions, normals, np.arange(JOINTS), bind)
    rng = np.random.default_rng(4)
    members = np.concatenate([
        rng.permutation(5 * WIDTH)[:WIDTH],  # mixed up
        np.arange(2 * WIDTH, 3 * WIDTH),  # a block as it is
        np.where(rng.random(WIDTH) < 0.5, rng.permutation(5 * WIDTH)[:WIDTH], -1),  # with gaps
        np.full(WIDTH, -1),  # nobody
        np.arange(2 * WIDTH + 1, 3 * WIDTH + 1),
    ])  # fmt: skip
    out = aligned(5 * 90 * 6 * WIDTH).reshape(5, 90, 6, WIDTH)
    out[:] = 77.0
    skincrowd.skin_members(mesh, lanes, members, np.array([0, 1, 2, 3]), True, out)
    got = out.transpose(0, 3, 1, 2).reshape(-1, 90, 6)
    here = np.nonzero(members[: 4 * WIDTH] >= 0)[0]
    who = members[here]
    assert np.abs(got[here, :, :3] - plain(models[who], joints, weights, positions, 1.0)).max() < 1e-4
    assert np.abs(got[here, :, 3:] - plain(models[who], joints, weights, normals, 0.0)).max() < 1e-4
    assert np.all(out[3:] == 77.0)  # nobody there, and not asked for
    whole = skincrowd.skin_crowd(mesh, lanes, True)
    assert np.array_equal(whole[2], out[1])


def test_an_output_that_no_cache_holds(monkeypatch):
    joints, weights, positions, normals = mesh_of(4, 3)
    _, lanes = crowd_of(3, 2)
    mesh = skin.compile_mesh(joints, weights, positions, normals, np.arange(JOINTS), np.tile(np.eye(4), (JOINTS, 1, 1)))
    near = skincrowd.skin_crowd(mesh, lanes, True)
    monkeypatch.setattr(skincrowd, "_PAST_BYTES", 0)
    assert np.array_equal(skincrowd.skin_crowd(mesh, lanes, True), near)
    odd = np.empty(near.size + 3, np.float32)[3:].reshape(near.shape)  # on no cache line: the ordinary way
    assert np.array_equal(skincrowd.skin_crowd(mesh, lanes, True, odd), near)
