"""Dual quaternions: the group of rigid motions, SciPy's RigidTransform as a reference, screws and blends."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial import transform

from keypose.errors import ShapeError
from keypose.math import dualquat, quat, rigid


def random_motions(library, rng, *shape):
    q = rng.normal(size=(*shape, 4))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    return dualquat.from_rigid(library.array(q), library.array(rng.normal(size=(*shape, 3))))


def matrices(library, d):
    r, t = dualquat.to_rigid(d)
    return library.numpy(rigid.from_trs(t, r)).astype(np.float64)


def test_rotation_and_translation_come_back(library, rng):
    d = random_motions(library, rng, 40)
    again = dualquat.from_rigid(*dualquat.to_rigid(d))
    np.testing.assert_allclose(library.numpy(again), library.numpy(d), atol=8 * library.eps)
    real, dual = library.numpy(d)[:, :4], library.numpy(d)[:, 4:]
    np.testing.assert_allclose((real * dual).sum(-1), 0, atol=4 * library.eps)


def test_group_axioms(library, rng):
    a, b, c = (random_motions(library, rng, 30) for _ in range(3))
    number, tolerance = library.numpy, 30 * library.eps
    left = dualquat.multiply(dualquat.multiply(a, b), c)
    right = dualquat.multiply(a, dualquat.multiply(b, c))
    np.testing.assert_allclose(number(left), number(right), atol=tolerance)
    none = dualquat.identity(like=a)
    np.testing.assert_array_equal(number(dualquat.multiply(a, none)), number(a))
    np.testing.assert_allclose(
        number(dualquat.multiply(a, dualquat.conjugate(a))), [[1, 0, 0, 0, 0, 0, 0, 0]] * 30, atol=tolerance
    )
    product = matrices(library, dualquat.multiply(a, b))
    np.testing.assert_allclose(product, matrices(library, a) @ matrices(library, b), atol=tolerance)


def test_points_move_as_by_the_matrix(library, rng):
    d, p = random_motions(library, rng, 30), library.array(rng.normal(size=(30, 3)))
    moved = (matrices(library, d) @ np.append(library.numpy(p), np.ones((30, 1)), -1)[..., None])[:, :3, 0]
    np.testing.assert_allclose(library.numpy(dualquat.transform_points(d, p)), moved, atol=30 * library.eps)


@pytest.mark.skipif(not hasattr(transform, "RigidTransform"), reason="SciPy before 1.16 has no RigidTransform")
def test_scipy_agrees(rng):
    q = rng.normal(size=(30, 4))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    t = rng.normal(size=(30, 3))
    theirs = transform.RigidTransform.from_components(t, transform.Rotation.from_quat(q, scalar_first=True))
    ours = dualquat.from_rigid(q, t)
    expected = theirs.as_dual_quat(scalar_first=True)
    side = np.sign((ours[:, :4] * expected[:, :4]).sum(-1, keepdims=True))
    np.testing.assert_allclose(ours * side, expected, atol=1e-14)
    composed = dualquat.to_rigid(dualquat.multiply(ours, ours[::-1]))
    np.testing.assert_allclose(rigid.from_trs(*composed[::-1]), (theirs * theirs[::-1]).as_matrix(), atol=1e-14)


def test_powers_are_those_of_the_matrix(rng):
    """SciPy's matrix exponential and logarithm know nothing of screws."""
    d = dualquat.from_rigid(quat.normalize(rng.normal(size=(5, 4))), rng.normal(size=(5, 3)))
    for u in (-0.5, 0.3, 2.0):
        powers = [expm(u * logm(m)).real for m in rigid.from_trs(*dualquat.to_rigid(d)[::-1])]
        np.testing.assert_allclose(rigid.from_trs(*dualquat.to_rigid(dualquat.power(d, u))[::-1]), powers, atol=1e-13)


def test_normalize_makes_a_motion(library, rng):
    d = library.array(rng.normal(size=(30, 8)))
    n = library.numpy(dualquat.normalize(d))
    np.testing.assert_allclose((n[:, :4] ** 2).sum(-1), 1, atol=4 * library.eps)
    np.testing.assert_allclose((n[:, :4] * n[:, 4:]).sum(-1), 0, atol=20 * library.eps)
    motion = random_motions(library, rng, 30)
    np.testing.assert_allclose(
        library.numpy(dualquat.normalize(2.5 * motion)), library.numpy(motion), atol=8 * library.eps
    )
    nothing = library.numpy(dualquat.normalize(library.array(np.zeros(8))))
    np.testing.assert_array_equal(nothing, [1, 0, 0, 0, 0, 0, 0, 0])


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.01, 0.15, 0.3, 1.0, 3.0, np.pi, 5.0, 6.2])
def test_exp_and_log_are_inverse(angle, library, rng):
    axis = rng.normal(size=(30, 3))
    r = quat.from_axis_angle(axis, angle)
    d = dualquat.from_rigid(library.array(r), library.array(rng.normal(size=(30, 3))))
    back = library.numpy(dualquat.exp(dualquat.log(d)))
    loss = 8 if angle < 5 else 200  # the axis is read from a small vector part near a whole turn
    np.testing.assert_allclose(back, library.numpy(d), atol=loss * library.eps)


def test_log_of_a_whole_turn_is_finite(library):
    d = library.array([-1, 0, 0, 0, 0, 0.5, 0, 0])
    np.testing.assert_allclose(library.numpy(dualquat.exp(dualquat.log(d))), -library.numpy(d), atol=library.eps)


def test_sclerp_is_one_screw_at_constant_speed(library, rng):
    a, b = random_motions(library, rng, 12), random_motions(library, rng, 12)
    number, tolerance = library.numpy, 60 * library.eps
    np.testing.assert_allclose(number(dualquat.sclerp(a, b, 0)), number(a), atol=0)
    np.testing.assert_allclose(matrices(library, dualquat.sclerp(a, b, 1)), matrices(library, b), atol=tolerance)
    np.testing.assert_allclose(
        matrices(library, dualquat.sclerp(a, -b, 0.3)), matrices(library, dualquat.sclerp(a, b, 0.3)), atol=tolerance
    )
    steps = [dualquat.sclerp(a, b, u) for u in np.linspace(0, 1, 6)]
    moves = [matrices(library, dualquat.multiply(dualquat.conjugate(x), y)) for x, y in pairwise(steps)]
    for move in moves[1:]:
        np.testing.assert_allclose(move, moves[0], atol=4 * tolerance)
    rotations = number(dualquat.to_rigid(steps[2])[0])
    np.testing.assert_allclose(
        np.abs((rotations * number(quat.slerp(a[:, :4], b[:, :4], 0.4))).sum(-1)), 1, atol=tolerance
    )


def test_sclerp_does_not_depend_on_the_frame(rng):
    """Interpolation commutes with moving everything: what a separate lerp of the translation does not do."""
    a, b, frame = (
        dualquat.from_rigid(quat.normalize(rng.normal(size=(9, 4))), rng.normal(size=(9, 3))) for _ in range(3)
    )
    after = dualquat.multiply(dualquat.sclerp(a, b, 0.3), frame)
    before = dualquat.sclerp(dualquat.multiply(a, frame), dualquat.multiply(b, frame), 0.3)
    side = np.sign((after[:, :4] * before[:, :4]).sum(-1, keepdims=True))
    np.testing.assert_allclose(after * side, before, atol=1e-13)


def test_sclerp_of_pure_translations_is_lerp(library, rng):
    t = rng.normal(size=(2, 10, 3))
    r = quat.from_axis_angle([1, 2, 3], 0.7)
    a, b = (dualquat.from_rigid(library.array(r), library.array(x)) for x in t)
    _, found = dualquat.to_rigid(dualquat.sclerp(a, b, 0.25))
    np.testing.assert_allclose(library.numpy(found), 0.75 * t[0] + 0.25 * t[1], atol=8 * library.eps)


def test_a_known_screw():
    """Half a turn about the vertical line x = 1 while rising by 2: half of it is a quarter turn and 1 up."""
    quarter = quat.from_axis_angle([0, 1, 0], np.pi / 2)
    half = dualquat.from_rigid(quat.from_axis_angle([0, 1, 0], np.pi), [2, 2, 0])
    r, t = dualquat.to_rigid(dualquat.power(half, 0.5))
    np.testing.assert_allclose(r, quarter, atol=1e-15)
    np.testing.assert_allclose(t, [1, 1, 1], atol=1e-15)
    np.testing.assert_allclose(dualquat.transform_points(dualquat.power(half, 0.5), [1, 0, 0]), [1, 1, 0], atol=1e-15)


def test_blend(library, rng):
    d = random_motions(library, rng, 20, 5)
    number, tolerance = library.numpy, 30 * library.eps
    alone = number(dualquat.blend(d, library.array([0, 0, 1, 0, 0])))
    np.testing.assert_allclose(alone, number(d)[:, 2], atol=tolerance)
    weights = rng.uniform(size=(20, 5))
    weights[:, 1] += 1
    flips = rng.choice([-1.0, 1.0], size=(20, 5, 1))
    flips[:, 1] = 1
    plain = number(dualquat.blend(d, library.array(weights)))
    flipped = number(dualquat.blend(library.array(number(d) * flips), library.array(3 * weights)))
    np.testing.assert_allclose(flipped, plain, atol=tolerance)
    same = library.array(np.repeat(number(d)[:, :1], 4, axis=1))
    np.testing.assert_allclose(
        number(dualquat.blend(same, library.array([1, 2, 3, 4]))), number(d)[:, 0], atol=tolerance
    )
    near = dualquat.sclerp(d[:, 0, :], d[:, 1, :], 0.02)
    mean = number(
        dualquat.blend(library.array(np.stack([number(d)[:, 0], number(near)], 1)), library.array([0.5, 0.5]))
    )
    np.testing.assert_allclose(mean, number(dualquat.sclerp(d[:, 0, :], near, 0.5)), atol=1e-4)
    nothing = number(dualquat.blend(d, library.array(np.zeros(5))))
    np.testing.assert_array_equal(nothing, [[1, 0, 0, 0, 0, 0, 0, 0]] * 20)


def test_shapes_and_errors(library):
    none = library.array(np.zeros((0, 8)))
    assert library.numpy(dualquat.sclerp(none, none, 0.5)).shape == (0, 8)
    assert library.numpy(dualquat.blend(library.array(np.zeros((3, 0, 8))), library.array(np.zeros(0)))).shape == (3, 8)
    many = dualquat.sclerp(dualquat.identity(like=none), dualquat.identity(like=none), library.array(np.ones((2, 3))))
    assert library.numpy(many).shape == (2, 3, 8)
    assert dualquat.from_rigid([1, 0, 0, 0], [1, 2, 3]).shape == (8,)
    with pytest.raises(ShapeError, match="weights"):
        dualquat.blend(np.zeros((3, 8)), [1.0, 2.0])
    with pytest.raises(ShapeError, match=r"d: expected \(\*B, 8\)"):
        dualquat.normalize(np.zeros(4))
