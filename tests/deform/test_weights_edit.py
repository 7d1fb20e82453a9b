"""Changing weights: fewer influences, smoothing, mirroring, transfer."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from keypose import samples
from keypose.deform import (
    automatic_weights,
    limit_influences,
    mirror_weights,
    skin,
    skin_character,
    smooth_weights,
    transfer_weights,
)
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import world
from keypose.model import Mesh, Skin
from tests.deform.test_weights import ARM, chain, shifted, tube
from tests.synthetic import random_skeleton, random_skin


def dense(bound: Skin, joints: int) -> np.ndarray:
    out = np.zeros((len(bound.joints), joints))
    np.add.at(out, (np.arange(len(out))[:, None], np.asarray(bound.palette)[bound.joints]), bound.weights)
    return out


def whole(bound: Skin) -> None:
    assert np.all(bound.weights >= 0)
    assert_allclose(bound.weights.sum(axis=1), 1.0, atol=1e-6)


def hard(mesh: Mesh) -> Skin:
    """All or nothing on either side of x = 2."""
    second = (mesh.positions[:, :1] > 2.0).astype(int)
    return Skin([0, 1], np.linalg.inv(np.asarray(world(ARM, ARM.rest))), second, np.ones((mesh.vertex_count, 1)))


def test_few_influences_are_the_largest_ones() -> None:
    rng = np.random.default_rng(2)
    skeleton = random_skeleton(rng, 9)
    bound = random_skin(rng, skeleton, 60, 6)
    few = limit_influences(bound, 3)
    whole(few)
    full, kept = dense(bound, 9), dense(few, 9)
    largest = np.sort(full, axis=1)[:, -3:]
    assert_allclose(np.sort(kept, axis=1)[:, -3:], largest / largest.sum(axis=1, keepdims=True), atol=1e-12)
    strong = limit_influences(bound, 6, threshold=0.2)
    whole(strong)
    assert np.all((dense(strong, 9) > 0) == (full >= np.minimum(0.2, full.max(axis=1, keepdims=True))))
    single = limit_influences(bound, 6, threshold=0.99)
    assert np.all(np.count_nonzero(single.weights, axis=1) == 1)
    again = limit_influences(few, 3)
    assert_allclose(again.weights, few.weights, atol=1e-15)


def test_smoothing_softens_an_edge_and_keeps_what_is_even() -> None:
    mesh = tube(rings=41)
    bound = hard(mesh)
    weights = dense(smooth_weights(bound, mesh, iterations=8, max_influences=2), 2)
    x = mesh.positions[:, 0]
    near = np.abs(x - 2.05) < 0.06
    assert np.all((weights[near] > 0.25) & (weights[near] < 0.75))
    assert_array_equal(weights[(x < 1.0) | (x > 3.1)], dense(bound, 2)[(x < 1.0) | (x > 3.1)])
    steps = [np.abs(np.diff(dense(smooth_weights(bound, mesh, iterations=n, max_influences=2), 2)[8:-2:16, 1])).max() for n in (0, 2, 8, 30)]  # fmt: skip
    assert all(a > b for a, b in itertools.pairwise(steps))


def test_smoothing_leaves_other_vertices_alone_and_seams_closed() -> None:
    mesh = tube()
    soup = Mesh(mesh.positions[mesh.triangles.reshape(-1)], np.arange(3 * len(mesh.triangles)).reshape(-1, 3))
    whole_one = dense(smooth_weights(hard(mesh), mesh, iterations=3, max_influences=2), 2)
    cut = dense(smooth_weights(hard(soup), soup, iterations=3, max_influences=2), 2)
    assert_allclose(cut, whole_one[mesh.triangles.reshape(-1)], atol=1e-12)
    some = np.nonzero(mesh.positions[:, 1] > 0)[0]
    bound = hard(mesh)
    part = smooth_weights(bound, mesh, iterations=3, vertices=some, max_influences=2)
    rest = np.setdiff1d(np.arange(mesh.vertex_count), some)
    assert_array_equal(dense(part, 2)[rest], dense(bound, 2)[rest])
    assert np.abs(dense(part, 2) - dense(bound, 2))[some].max() > 0.1
    whole(part)


def test_mirroring_makes_both_sides_alike() -> None:
    mesh = Mesh(shifted(tube().positions, -2, 0, 0), tube().triangles)
    body = chain([(0, 0, 0), (0.5, 0, 0), (1.5, 0, 0), (-0.5, 0, 0), (-1.5, 0, 0)], parents=[-1, 0, 1, 0, 3])
    bound = automatic_weights(mesh, body).skins[0]
    rng = np.random.default_rng(3)
    spoilt = dense(bound, 5)
    right = mesh.positions[:, 0] < -1e-9
    spoilt[right] = rng.uniform(size=(int(right.sum()), 5))
    spoilt /= spoilt.sum(axis=1, keepdims=True)
    matrices = np.linalg.inv(np.asarray(world(body, body.rest)))
    wrong = Skin(np.arange(5), matrices, np.tile(np.arange(5), (mesh.vertex_count, 1)), spoilt)
    done = mirror_weights(wrong, mesh, body)
    whole(done)
    weights = dense(done, 5)
    assert_array_equal(weights[mesh.positions[:, 0] > 1e-3], spoilt[mesh.positions[:, 0] > 1e-3])
    images = np.argmin(((mesh.positions[:, None] * [-1, 1, 1] - mesh.positions[None]) ** 2).sum(-1), axis=1)
    assert_allclose(weights[images][:, [0, 3, 4, 1, 2]], weights, atol=1e-6)
    back = mirror_weights(done, mesh, body, source="right")
    assert_allclose(dense(back, 5), weights, atol=1e-6)
    named = mirror_weights(wrong, mesh, body, pairs={"j1": "j3", "j4": "j2"})
    assert_allclose(dense(named, 5), weights, atol=1e-12)


def test_the_human_is_mirrored_joint_by_joint() -> None:
    body = samples.load("human").character
    bound, _ = skin_character(body)
    part = next(p for p in bound.parts if p.name == "hands")
    assert part.skin is not None
    done = mirror_weights(part.skin, part.mesh, body.skeleton)
    names = body.skeleton.names
    other = [names.index(n.replace("Left", "?").replace("Right", "Left").replace("?", "Right")) for n in names]
    positions = np.asarray(part.mesh.positions)
    weights = dense(done, len(names))
    images = np.argmin(((positions[:, None] * [-1, 1, 1] - positions[None]) ** 2).sum(-1), axis=1)
    exact = np.abs(positions[images] * [-1, 1, 1] - positions).max(axis=1) < 1e-6
    assert exact.mean() > 0.9
    assert_allclose(weights[images][exact][:, other], weights[exact], atol=1e-5)


def test_a_skin_with_one_side_only_gets_the_other_sides_joints() -> None:
    mesh = Mesh(shifted(tube().positions, -2, 0, 0), tube().triangles)
    body = chain([(0, 0, 0), (1.0, 0, 0), (-1.0, 0, 0)], parents=[-1, 0, 0])
    joints = (mesh.positions[:, :1] > 1.0).astype(int)
    binds = np.linalg.inv(np.asarray(world(body, body.rest)))[:2]
    done = mirror_weights(Skin([0, 1], binds, joints, np.ones_like(joints, float)), mesh, body)
    assert sorted(done.palette.tolist()) == [0, 1, 2]
    assert_allclose(skin(mesh, done, world(body, body.rest)), mesh.positions, atol=1e-12)
    assert np.all(dense(done, 3)[mesh.positions[:, 0] < -1.15, 2] == 1.0)


def test_weights_go_over_to_a_finer_mesh() -> None:
    coarse, fine = tube(rings=21), tube(rings=81, radius=0.52)
    bound = automatic_weights(coarse, ARM).skins[0]
    taken = transfer_weights(bound, coarse, fine)
    whole(taken)
    x = np.unique(coarse.positions[:, 0])
    means = [dense(bound, 2)[coarse.positions[:, 0] == v, 1].mean() for v in x]
    inner = np.abs(fine.positions[:, 1:]).max(axis=1) > 0.1
    expected = np.interp(fine.positions[inner, 0], x, means)
    assert_allclose(dense(taken, 2)[inner, 1], expected, atol=0.05)
    same = transfer_weights(bound, coarse, coarse)
    assert_allclose(dense(same, 2), dense(bound, 2), atol=1e-6)


def test_wrong_input_is_named() -> None:
    mesh = tube()
    bound = hard(mesh)
    with pytest.raises(ShapeError, match="threshold"):
        limit_influences(bound, 2, threshold=1.0)
    with pytest.raises(ShapeError, match="influences"):
        limit_influences(bound, 0)
    with pytest.raises(ShapeError, match="amount"):
        smooth_weights(bound, mesh, amount=1.5)
    with pytest.raises(ShapeError, match="iterations"):
        smooth_weights(bound, mesh, iterations=-1)
    with pytest.raises(ShapeError, match="indices below"):
        smooth_weights(bound, mesh, vertices=[10_000])
    with pytest.raises(ShapeError, match="flags"):
        smooth_weights(bound, mesh, vertices=np.ones(3, bool))
    other = Mesh(np.eye(3), [[0, 1, 2]])
    for call in (lambda: smooth_weights(bound, other), lambda: mirror_weights(bound, other, ARM), lambda: transfer_weights(bound, other, mesh)):  # fmt: skip
        with pytest.raises(ShapeError, match="the mesh has 3"):
            call()
    with pytest.raises(UnknownName, match="side"):
        mirror_weights(bound, mesh, ARM, source="up")  # type: ignore[arg-type]
    with pytest.raises(UnknownName, match="joint"):
        mirror_weights(bound, mesh, ARM, pairs={"left": "right"})
    with pytest.raises(ShapeError, match="right side"):
        mirror_weights(bound, mesh, ARM, source="right")
    cloud = Mesh(mesh.positions, np.empty((0, 3), int))
    with pytest.raises(ShapeError, match="triangles"):
        transfer_weights(bound, cloud, mesh)
