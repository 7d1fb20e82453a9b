"""Quaternions: group axioms, SciPy as a reference, singular points, accuracy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from keypose.errors import ShapeError
from keypose.math import quat

PI = np.pi


def random_quats(rng, *shape):
    q = rng.normal(size=(*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def scipy(q):
    return Rotation.from_quat(np.asarray(q, np.float64), scalar_first=True)


def same_rotation(a, b, tolerance):
    """Equal up to sign, per component."""
    a, b = np.broadcast_arrays(np.asarray(a, np.float64), np.asarray(b, np.float64))
    error = np.minimum(np.abs(a - b).max(-1), np.abs(a + b).max(-1))
    assert error.max(initial=0.0) <= tolerance, error.max()


def exact_angle(a, b):
    """The angle between rotations in extended precision, written independently of the library."""
    a, b = np.asarray(a, np.longdouble), np.asarray(b, np.longdouble)
    minus, plus = np.sqrt(((a - b) ** 2).sum(-1)), np.sqrt(((a + b) ** 2).sum(-1))
    return 4 * np.arctan2(np.minimum(minus, plus), np.maximum(minus, plus))


# --- group axioms ------------------------------------------------------------------------------------------------------


def test_group_axioms(library, rng):
    a, b, c = (library.array(random_quats(rng, 50)) for _ in range(3))
    tolerance = 8 * library.eps
    number = library.numpy
    left, right = quat.multiply(quat.multiply(a, b), c), quat.multiply(a, quat.multiply(b, c))
    np.testing.assert_allclose(number(left), number(right), atol=tolerance)
    np.testing.assert_allclose(number(quat.multiply(a, quat.identity(like=a))), number(a), atol=0)
    np.testing.assert_allclose(number(quat.multiply(a, quat.inverse(a))), [[1, 0, 0, 0]] * 50, atol=tolerance)
    np.testing.assert_allclose(
        number(quat.conjugate(quat.multiply(a, b))),
        number(quat.multiply(quat.conjugate(b), quat.conjugate(a))),
        atol=tolerance,
    )


def test_hamilton_wrote_i_j_k_on_the_bridge():
    one, i, j, k = np.eye(4)
    np.testing.assert_array_equal(quat.multiply(i, j), k)
    np.testing.assert_array_equal(quat.multiply(j, i), -k)
    for unit in (i, j, k):
        np.testing.assert_array_equal(quat.multiply(unit, unit), -one)
    np.testing.assert_array_equal(quat.multiply(quat.multiply(i, j), k), -one)


def test_rotation_is_a_homomorphism_and_an_isometry(library, rng):
    a, b = library.array(random_quats(rng, 50)), library.array(random_quats(rng, 50))
    v, w = library.array(rng.normal(size=(50, 3))), library.array(rng.normal(size=(50, 3)))
    number = library.numpy
    one_by_one = number(quat.rotate(a, quat.rotate(b, v)))
    np.testing.assert_allclose(number(quat.rotate(quat.multiply(a, b), v)), one_by_one, atol=40 * library.eps)
    dots = (number(quat.rotate(a, v)) * number(quat.rotate(a, w))).sum(-1)
    np.testing.assert_allclose(dots, (number(v) * number(w)).sum(-1), atol=60 * library.eps)


def test_rotate_is_the_sandwich_product(rng):
    q, v = random_quats(rng, 20), rng.normal(size=(20, 3))
    pure = np.concatenate([np.zeros((20, 1)), v], -1)
    sandwich = quat.multiply(quat.multiply(q, pure), quat.conjugate(q))
    np.testing.assert_allclose(sandwich[:, 1:], quat.rotate(q, v), atol=1e-14)
    np.testing.assert_allclose(sandwich[:, 0], 0, atol=1e-15)


def test_a_third_of_a_turn_about_the_diagonal_permutes_the_axes():
    q = quat.from_axis_angle([1, 1, 1], 2 * PI / 3)
    np.testing.assert_allclose(q, [0.5, 0.5, 0.5, 0.5], atol=1e-16)
    np.testing.assert_allclose(quat.rotate(q, np.eye(3)), np.roll(np.eye(3), 1, axis=1), atol=1e-15)


def test_inverse_of_any_length(library, rng):
    q = library.array(rng.normal(size=(20, 4)) * 3)
    product = library.numpy(quat.multiply(q, quat.inverse(q)))
    np.testing.assert_allclose(product, [[1, 0, 0, 0]] * 20, atol=8 * library.eps)


def test_zero_quaternions_stand_for_no_rotation(library):
    q = library.array([[0, 0, 0, 0], [0, 2, 0, 0], [1e-30, 0, 0, 0]])

    np.testing.assert_array_equal(library.numpy(quat.normalize(q)), [[1, 0, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0]])
    np.testing.assert_array_equal(library.numpy(quat.inverse(q))[0], [1, 0, 0, 0])


def test_not_a_number_stays_visible():
    assert np.isnan(quat.normalize([np.nan, 0, 0, 1])).all()
    assert np.isnan(quat.slerp([1.0, 0, 0, 0], [np.nan, 0, 0, 0], 0.5)).any()


# --- SciPy as reference --------------------------------------------------------------------------------------------------


def test_scipy_agrees(library, rng):
    qa, qb, v = random_quats(rng, 200), random_quats(rng, 200), rng.normal(size=(200, 3))
    a, b, points = library.array(qa), library.array(qb), library.array(v)
    ra, rb = scipy(library.numpy(a)), scipy(library.numpy(b))
    number, tolerance = library.numpy, 12 * library.eps
    same_rotation(number(quat.multiply(a, b)), (ra * rb).as_quat(scalar_first=True), tolerance)
    same_rotation(number(quat.difference(a, b)), (rb * ra.inv()).as_quat(scalar_first=True), tolerance)
    same_rotation(number(quat.from_matrix(library.array(ra.as_matrix()))), ra.as_quat(scalar_first=True), tolerance)
    same_rotation(number(quat.from_rotation_vector(library.array(ra.as_rotvec()))), number(a), tolerance)
    np.testing.assert_allclose(number(quat.rotate(a, points)), ra.apply(number(points)), atol=4 * tolerance)
    np.testing.assert_allclose(number(quat.to_matrix(a)), ra.as_matrix(), atol=tolerance)
    np.testing.assert_allclose(number(quat.to_rotation_vector(a)), ra.as_rotvec(), atol=2 * tolerance)
    np.testing.assert_allclose(number(quat.angle_between(a, b)), (ra.inv() * rb).magnitude(), atol=2 * tolerance)
    np.testing.assert_allclose(
        number(quat.to_sixd(a)), ra.as_matrix()[..., :2].swapaxes(1, 2).reshape(-1, 6), atol=tolerance
    )
    powers = number(quat.power(a, 0.3))
    same_rotation(powers, Rotation.from_rotvec(0.3 * ra.as_rotvec()).as_quat(scalar_first=True), tolerance)


def test_slerp_agrees_with_scipy(library, rng):
    qa, qb = random_quats(rng, 30), random_quats(rng, 30)
    u = np.linspace(0, 1, 9)
    a, b = library.array(qa), library.array(qb)
    ours = library.numpy(quat.slerp(a[:, None, :], b[:, None, :], library.array(u)))
    for i in range(30):
        path = Slerp([0, 1], scipy(np.stack([library.numpy(a)[i], library.numpy(b)[i]])))(u)
        same_rotation(ours[i], path.as_quat(scalar_first=True), 16 * library.eps)


def test_average_agrees_with_scipy_and_ignores_signs(library, rng):
    spread = random_quats(rng, 8, 1) + 0.3 * rng.normal(size=(8, 5, 4))
    spread /= np.linalg.norm(spread, axis=-1, keepdims=True)
    flips = rng.choice([-1.0, 1.0], size=(8, 5, 1))
    weights = rng.uniform(0.1, 2, size=(8, 5))
    ours = library.numpy(quat.average(library.array(spread * flips), library.array(weights)))
    for i in range(8):
        mean = scipy(spread[i]).mean(weights[i]).as_quat(scalar_first=True)
        same_rotation(ours[i], mean, 60 * library.eps)
    np.testing.assert_array_less(-1e-30, ours[..., 0])
    unsigned = library.numpy(quat.average(library.array(spread), library.array(weights)))
    np.testing.assert_allclose(ours, unsigned, atol=60 * library.eps)


def test_look_rotation_agrees_with_scipy_align(rng):
    forward, up = rng.normal(size=(20, 3)), rng.normal(size=(20, 3))
    ours = quat.look_rotation(forward, up)
    for f, p, q in zip(forward, up, ours, strict=True):
        reference, _ = Rotation.align_vectors([f, p], [[0, 0, 1], [0, 1, 0]], weights=[np.inf, 1])
        same_rotation(q, reference.as_quat(scalar_first=True), 1e-12)


# --- axis, angle, exponential map ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-160, 1e-12, 1e-8, 1e-4, 0.1, 0.2, 1.0, 3.0, PI - 1e-8, PI - 1e-12])
def test_rotation_vectors_survive_exp_and_log(angle, rng):
    axis = rng.normal(size=(64, 3))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    v = axis * angle
    back = quat.to_rotation_vector(quat.from_rotation_vector(v))
    np.testing.assert_allclose(back, v, rtol=4e-15, atol=angle * 1e-15)
    np.testing.assert_allclose(
        quat.to_rotation_vector(-quat.from_rotation_vector(v)), v, rtol=4e-15, atol=angle * 1e-15
    )


def test_exp_and_log_are_accurate_in_each_precision(library, rng):
    angles = np.concatenate([10.0 ** np.arange(-12, 0), np.linspace(0.15, 0.25, 9), np.linspace(0.2, PI - 1e-3, 30)])
    v = rng.normal(size=(len(angles), 3))
    v *= (angles / np.linalg.norm(v, axis=-1))[:, None]
    v = np.asarray(v, library.dtype)
    exact = np.asarray(v, np.longdouble)
    n = np.sqrt((exact**2).sum(-1, keepdims=True))
    reference = np.concatenate([np.cos(n), np.sin(n) / n * exact], -1)
    q = library.numpy(quat.exp(library.array(v)))
    assert np.abs(q - reference).max() < 2 * library.eps
    short = angles < 1.0  # there also relative to the tiny components themselves
    assert (np.abs(q - reference) / np.abs(reference))[short].max() < 4 * library.eps
    back = library.numpy(quat.log(library.array(q)))
    relative = np.linalg.norm((back - v).astype(np.float64), axis=-1) / angles
    # Near pi the half-angle's sine is small and its own rounding is what is left: one eps of absolute error.
    assert np.all(relative < 4 * library.eps), relative.max()


def test_log_keeps_the_sign_and_exp_inverts_it(library, rng):
    q = library.array(random_quats(rng, 100))
    np.testing.assert_allclose(library.numpy(quat.exp(quat.log(q))), library.numpy(q), atol=4 * library.eps)


def test_log_of_minus_one_is_half_a_turn_of_half_angles_about_x(library):
    v = quat.log(library.array([[-1, 0, 0, 0], [1, 0, 0, 0]]))
    np.testing.assert_allclose(library.numpy(v), [[PI, 0, 0], [0, 0, 0]], rtol=library.eps)
    np.testing.assert_allclose(library.numpy(quat.exp(v))[0], [-1, 0, 0, 0], atol=library.eps)


def test_axis_and_angle(library, rng):
    axis = rng.normal(size=(30, 3))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = rng.uniform(0.01, PI - 0.01, 30)
    q = quat.from_axis_angle(library.array(3 * axis), library.array(angle))
    back_axis, back_angle = quat.to_axis_angle(-q)
    np.testing.assert_allclose(library.numpy(back_angle), angle, atol=8 * library.eps)
    np.testing.assert_allclose(library.numpy(back_axis), axis, atol=400 * library.eps)
    none_axis, none_angle = quat.to_axis_angle(library.array([[1, 0, 0, 0], [-1, 0, 0, 0]]))
    np.testing.assert_array_equal(library.numpy(none_axis), [[1, 0, 0]] * 2)
    np.testing.assert_array_equal(library.numpy(none_angle), [0, 0])
    np.testing.assert_array_equal(
        library.numpy(quat.from_axis_angle(library.array([0, 0, 0]), library.array(2.0))), [1, 0, 0, 0]
    )


def test_half_a_turn_has_angle_pi_about_both_signs():
    for axis in np.eye(3):
        found, angle = quat.to_axis_angle(np.concatenate([[0.0], axis]))
        assert angle == PI
        np.testing.assert_array_equal(found, axis)


# --- slerp and its relatives -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [1e-12, 1e-7, 1e-3, 0.05, 0.2, 1.0, 2.0, 3.1, PI - 1e-7, PI - 1e-12])
def test_slerp_has_constant_angular_speed(angle, rng):
    a = random_quats(rng, 20)
    axis = rng.normal(size=(20, 3))
    b = quat.multiply(quat.from_axis_angle(axis, angle), a)
    path = quat.slerp(a[:, None], b[:, None], np.linspace(0, 1, 101))
    steps = exact_angle(path[:, 1:], path[:, :-1])
    assert np.abs(steps - angle / 100).max() < 4e-15
    assert np.abs(np.linalg.norm(path, axis=-1) - 1).max() < 2e-15


def test_slerp_goes_the_short_way(rng):
    a = random_quats(rng, 20)
    b = quat.multiply(quat.from_axis_angle(rng.normal(size=(20, 3)), 2.0), a)
    for u in (0.25, 0.5, 1.0):
        same_rotation(quat.slerp(a, -b, u), quat.slerp(a, b, u), 1e-15)
    np.testing.assert_array_equal(quat.slerp(a, b, 0.0), a)
    assert exact_angle(a, quat.slerp(a, -b, 0.5)).max() < 1.0 + 1e-14


def test_slerp_is_exact_at_its_ends_and_between_equal_rotations(library, rng):
    a, b = library.array(random_quats(rng, 40)), library.array(random_quats(rng, 40))
    b = quat.multiply(b, quat.identity(like=b))
    np.testing.assert_array_equal(library.numpy(quat.slerp(a, b, 0)), library.numpy(a))
    end = library.numpy(quat.slerp(a, b, 1))
    assert np.all(np.all(end == library.numpy(b), -1) | np.all(end == -library.numpy(b), -1))
    np.testing.assert_allclose(library.numpy(quat.slerp(a, a, 0.3)), library.numpy(a), atol=library.eps)
    np.testing.assert_allclose(library.numpy(quat.slerp(a, -a, 0.3)), library.numpy(a), atol=library.eps)


def test_slerp_goes_on_beyond_its_ends(rng):
    a, axis = random_quats(rng, 10), rng.normal(size=(10, 3))
    b = quat.multiply(quat.from_axis_angle(axis, 0.4), a)
    c = quat.multiply(quat.from_axis_angle(axis, 1.0), a)
    same_rotation(quat.slerp(a, b, 2.5), c, 1e-14)


def test_nlerp_takes_the_same_path_at_another_speed(library, rng):
    a, b = library.array(random_quats(rng, 20)), library.array(random_quats(rng, 20))
    half = library.numpy(quat.nlerp(a, b, 0.5))
    np.testing.assert_allclose(half, library.numpy(quat.slerp(a, b, 0.5)), atol=8 * library.eps)
    quarter = quat.nlerp(a, b, 0.25)
    total = quat.angle_between(a, quarter) + quat.angle_between(quarter, b)
    np.testing.assert_allclose(library.numpy(total), library.numpy(quat.angle_between(a, b)), atol=30 * library.eps)
    assert np.abs(library.numpy(quarter) - library.numpy(quat.slerp(a, b, 0.25))).max() > 1e-3


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 1.0, PI - 1e-9, PI])
def test_angle_between_is_accurate_everywhere(angle, rng):
    a = random_quats(rng, 30)
    b = quat.multiply(quat.from_axis_angle(rng.normal(size=(30, 3)), angle), a)
    np.testing.assert_allclose(quat.angle_between(a, -b), np.asarray(exact_angle(a, b), np.float64), atol=1e-15)
    np.testing.assert_allclose(quat.angle_between(a, b), angle, atol=2e-15)


def test_add_subtract_and_scale_rotations(library, rng):
    a, b = library.array(random_quats(rng, 20)), library.array(random_quats(rng, 20))
    number, tolerance = library.numpy, 16 * library.eps
    same_rotation(number(quat.multiply(quat.difference(a, b), a)), number(b), tolerance)
    same_rotation(number(quat.multiply(quat.power(a, 0.25), quat.power(a, 0.75))), number(a), tolerance)
    same_rotation(number(quat.power(a, -1)), number(quat.inverse(a)), tolerance)
    same_rotation(number(quat.power(a, 0)), [1, 0, 0, 0], 0)
    same_rotation(number(quat.power(-a, 0.5)), number(quat.power(a, 0.5)), tolerance)
    steps = quat.multiply(quat.power(quat.difference(a, b), 0.3), a)
    same_rotation(number(steps), number(quat.slerp(a, b, 0.3)), tolerance)


# --- average ---------------------------------------------------------------------------------------------------------------


def test_average_of_two_is_half_way(rng):
    a, b = random_quats(rng, 20), random_quats(rng, 20)
    same_rotation(quat.average(np.stack([a, b], 1)), quat.slerp(a, b, 0.5), 1e-13)


def test_average_of_one_of_equals_and_of_nothing(library, rng):
    q = library.array(random_quats(rng, 6))
    same_rotation(library.numpy(quat.average(q[:, None, :])), library.numpy(q), 8 * library.eps)
    same_rotation(
        library.numpy(quat.average(library.array(np.repeat(library.numpy(q)[:, None], 7, 1)))),
        library.numpy(q),
        8 * library.eps,
    )
    np.testing.assert_array_equal(library.numpy(quat.average(q, library.array(np.zeros(6)))), [1, 0, 0, 0])
    np.testing.assert_array_equal(library.numpy(quat.average(q[:0, :])), [1, 0, 0, 0])


def test_average_minimises_the_chordal_distance(rng):
    q, w = random_quats(rng, 12), rng.uniform(0.1, 1, 12)
    mean = quat.average(q, w)

    def cost(m):
        return (w * (1 - (q @ m) ** 2)).sum()

    for nudge in rng.normal(size=(50, 3)) * 1e-3:
        assert cost(quat.multiply(quat.exp(nudge), mean)) > cost(mean)


# --- swing and twist -----------------------------------------------------------------------------------------------------------


def test_swing_and_twist_make_the_rotation(library, rng):
    q, axis = library.array(random_quats(rng, 60)), library.array(rng.normal(size=(60, 3)))
    swing, twist = quat.swing_twist(q, axis)
    number, tolerance = library.numpy, 30 * library.eps
    np.testing.assert_allclose(number(quat.multiply(swing, twist)), number(q), atol=tolerance)
    np.testing.assert_allclose(np.cross(number(twist)[:, 1:], number(axis)), 0, atol=tolerance)
    np.testing.assert_allclose((number(swing)[:, 1:] * number(axis)).sum(-1), 0, atol=10 * tolerance)
    np.testing.assert_allclose(number(quat.rotate(twist, axis)), number(axis), atol=tolerance)


def test_a_swing_by_half_a_turn_has_no_twist(library):
    q = library.array([[0, 1, 0, 0], [library.eps / 3, 0, 0, 1], [0, 0, 1, 0]])
    swing, twist = quat.swing_twist(q, library.array([0, 1, 0]))
    np.testing.assert_array_equal(library.numpy(twist)[:2], [[1, 0, 0, 0]] * 2)
    np.testing.assert_array_equal(library.numpy(swing)[:2], library.numpy(q)[:2])
    np.testing.assert_array_equal(library.numpy(twist)[2], [0, 0, 1, 0])
    _, none = quat.swing_twist(library.array([0.6, 0.8, 0, 0]), library.array([0, 0, 0]))
    np.testing.assert_array_equal(library.numpy(none), [1, 0, 0, 0])


# --- signs along time ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", [0, 1, -2])
def test_align_signs_gives_back_a_continuous_track(library, axis, rng):
    angle = np.linspace(0, 12, 40)[:, None] * np.array([1.0, 0.3, -0.7])
    track = quat.from_axis_angle(np.array([[0, 0, 1.0], [1, 1, 0], [0.2, 0.5, 1]]), angle)
    flipped = track * np.where(rng.random((40, 3, 1)) < 0.5, -1, 1)
    flipped[0] = track[0]
    expected = track
    if axis != 0:
        flipped, expected = flipped.swapaxes(0, 1), track.swapaxes(0, 1)
    aligned = library.numpy(quat.align_signs(library.array(flipped), axis=axis))
    np.testing.assert_allclose(aligned, expected, atol=library.eps)


def test_align_signs_of_few_and_of_wrong_axes():
    for count in (0, 1):
        assert quat.align_signs(np.ones((count, 4))).shape == (count, 4)
    for axis in (1, 2, -1, -3):
        with pytest.raises(ShapeError, match="axis"):
            quat.align_signs(np.ones((5, 4)), axis=axis)
    with pytest.raises(ShapeError, match="axis"):
        quat.align_signs(np.ones(4))


# --- matrices, 6D ------------------------------------------------------------------------------------------------------------------


def test_matrices_survive_at_every_branch(library, rng):
    exact = [np.array(q, float) for q in itertools.product([-1, 0, 1], repeat=4) if any(q)]
    near = [q + 1e-9 * rng.normal(size=4) for q in exact]
    small = [np.array([1.0, *v]) for v in rng.normal(size=(5, 3)) * 1e-6]
    q = np.stack(exact + near + small)
    q = np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True), library.dtype)
    back = library.numpy(quat.from_matrix(quat.to_matrix(library.array(q))))
    same_rotation(back, q, 4 * library.eps)
    assert np.all(back[..., 0] >= 0)


def test_from_axes_reads_columns(rng):
    q = random_quats(rng, 10)
    m = quat.to_matrix(q)
    same_rotation(quat.from_axes(m[..., 0], m[..., 1], m[..., 2]), q, 1e-15)


def test_sixd_round_trip_and_gram_schmidt(library, rng):
    q = library.array(random_quats(rng, 40))
    same_rotation(library.numpy(quat.from_sixd(quat.to_sixd(q))), library.numpy(q), 8 * library.eps)
    raw = rng.normal(size=(40, 6))
    first = raw[:, :3] / np.linalg.norm(raw[:, :3], axis=-1, keepdims=True)
    second = raw[:, 3:] - (first * raw[:, 3:]).sum(-1, keepdims=True) * first
    second /= np.linalg.norm(second, axis=-1, keepdims=True)
    expected = np.stack([first, second, np.cross(first, second)], -1)
    got = library.numpy(quat.to_matrix(quat.from_sixd(library.array(raw))))
    np.testing.assert_allclose(got, expected, atol=400 * library.eps)


def test_sixd_of_nothing_is_still_a_rotation(library):
    odd = library.array(
        [[0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 2, 0], [1, 2, 3, 2, 4, 6], [0, 0, 1, 0, 0, 0], [1, 0, 0, -3, 0, 0]]
    )
    q = quat.from_sixd(odd)
    m = library.numpy(quat.to_matrix(q)).astype(np.float64)
    np.testing.assert_allclose(m.swapaxes(1, 2) @ m, np.broadcast_to(np.eye(3), m.shape), atol=4 * library.eps)
    np.testing.assert_allclose(np.linalg.det(m), 1, atol=8 * library.eps)
    np.testing.assert_allclose(library.numpy(q)[:2], [[1, 0, 0, 0]] * 2, atol=library.eps)


# --- directions --------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gap", [0.0, 1e-15, 1e-12, 1e-8, 1e-4, 0.1, 1.5])
def test_from_two_vectors_near_parallel_and_opposite(gap, rng):
    a = rng.normal(size=(50, 3))
    a /= np.linalg.norm(a, axis=-1, keepdims=True)
    side = np.cross(a, rng.normal(size=(50, 3)))
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    for towards in (1, -1):
        b = towards * np.cos(gap) * a + np.sin(gap) * side
        q = quat.from_two_vectors(3 * a, 0.2 * b)
        np.testing.assert_allclose(quat.rotate(q, a), b, atol=2e-15)
        np.testing.assert_allclose(np.linalg.norm(q, axis=-1), 1, atol=4e-16)
        angle = gap if towards > 0 else PI - gap
        np.testing.assert_allclose(2 * np.arccos(np.clip(q[:, 0], -1, 1)), angle, atol=3e-8)  # the shortest


def test_from_two_vectors_in_each_library(library, rng):
    a, b = rng.normal(size=(30, 3)), rng.normal(size=(30, 3))
    a[:3], b[:3] = np.eye(3), -np.eye(3)
    q = quat.from_two_vectors(library.array(a), library.array(b))
    unit_a, unit_b = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (a, b))
    turned = library.numpy(quat.rotate(q, library.array(unit_a)))
    np.testing.assert_allclose(turned, unit_b, atol=8 * library.eps)
    zero = quat.from_two_vectors(library.array([0, 0, 0]), library.array([1, 0, 0]))
    np.testing.assert_array_equal(library.numpy(zero), [1, 0, 0, 0])


def test_plus_z_turns_to_minus_z_about_x():
    np.testing.assert_array_equal(quat.from_two_vectors([0, 0, 1], [0, 0, -1]), [0, 1, 0, 0])


def test_look_rotation(library, rng):
    forward = rng.normal(size=(30, 3))
    q = quat.look_rotation(library.array(forward))
    number, tolerance = library.numpy, 16 * library.eps
    unit = forward / np.linalg.norm(forward, axis=-1, keepdims=True)
    np.testing.assert_allclose(number(quat.rotate(q, library.array([0, 0, 1]))), unit, atol=tolerance)
    np.testing.assert_allclose(number(quat.rotate(q, library.array([1, 0, 0])))[:, 1], 0, atol=tolerance)  # level
    assert np.all(number(quat.rotate(q, library.array([0, 1, 0])))[:, 1] > 0)
    same_rotation(number(quat.look_rotation(library.array([0, 0, 5]))), [1, 0, 0, 0], library.eps)


def test_look_rotation_straight_up_and_to_nowhere(library):
    q = quat.look_rotation(library.array([[0, 3, 0], [0, -1, 0], [0, 0, 0]]))
    turned = library.numpy(quat.rotate(q, library.array([0, 0, 1])))
    np.testing.assert_allclose(turned, [[0, 1, 0], [0, -1, 0], [0, 0, 1]], atol=2 * library.eps)
    back = quat.look_rotation(library.array([0, 0, -1]), library.array([0, 0, 1]))
    np.testing.assert_allclose(library.numpy(quat.rotate(back, library.array([0, 0, 1]))), [0, 0, -1], atol=library.eps)


# --- shapes, types -------------------------------------------------------------------------------------------------------------------


def test_batch_shapes_broadcast_and_may_be_empty(library, rng):
    a, b = library.array(random_quats(rng, 5, 1)), library.array(random_quats(rng, 3))
    u = library.array(rng.random((2, 1, 1)))
    assert library.numpy(quat.multiply(a, b)).shape == (5, 3, 4)
    assert library.numpy(quat.slerp(a, b, u)).shape == (2, 5, 3, 4)
    assert library.numpy(quat.nlerp(a, b, u)).shape == (2, 5, 3, 4)
    assert library.numpy(quat.rotate(a, library.array(np.ones((7, 1, 1, 3))))).shape == (7, 5, 1, 3)
    assert library.numpy(
        quat.average(library.array(random_quats(rng, 2, 5)), library.array([1, 2, 3, 4, 5]))
    ).shape == (2, 4)
    assert library.numpy(quat.from_axis_angle(library.array([0, 1, 0]), library.array(np.ones(6)))).shape == (6, 4)
    assert library.numpy(quat.look_rotation(library.array(np.ones((2, 3, 3))))).shape == (2, 3, 4)
    none = library.array(np.zeros((0, 4)))
    for function in (quat.normalize, quat.inverse, quat.log, quat.to_matrix, quat.to_sixd, quat.to_rotation_vector):
        assert library.numpy(function(none)).shape[0] == 0
    assert library.numpy(quat.slerp(none, none, 0.5)).shape == (0, 4)
    assert library.numpy(quat.from_matrix(library.array(np.zeros((0, 3, 3))))).shape == (0, 4)
    assert library.numpy(quat.average(library.array(np.zeros((0, 3, 4))))).shape == (0, 4)
    one = library.array(random_quats(rng))
    assert library.numpy(quat.slerp(one, one, 0.5)).shape == (4,)


def test_parameters_do_not_change_the_precision():
    q = np.array([[1, 0, 0, 0], [0, 1, 0, 0]], np.float32)
    for u in (0.3, np.float64(0.3), np.array([0.3, 0.4]), [0, 1], np.array([0, 1])):
        for function in (quat.slerp, quat.nlerp):
            assert function(q, q, u).dtype == np.float32
        assert quat.power(q, u).dtype == np.float32
    assert quat.average(q, [1, 2]).dtype == np.float32
    assert quat.rotate(q, [0, 1, 0]).dtype == np.float32
    assert quat.look_rotation(np.ones(3, np.float32)).dtype == np.float32
    assert quat.multiply([1, 0, 0, 0], np.array([1, 0, 0, 0])).dtype == np.float64
    assert quat.identity((2,), like=q).dtype == np.float32


def test_wrong_shapes_are_named():
    with pytest.raises(ShapeError, match=r"q: expected \(\*B, 4\), got \(5, 3\)"):
        quat.normalize(np.ones((5, 3)))
    with pytest.raises(ShapeError, match=r"v: expected \(\*B, 3\), got \(\)"):
        quat.rotate(np.ones(4), 1.0)
    with pytest.raises(ShapeError, match=r"do not broadcast: a \(2,\), b \(3,\)"):
        quat.multiply(np.ones((2, 4)), np.ones((3, 4)))
    with pytest.raises(ShapeError, match="weights"):
        quat.average(np.ones((3, 4)), [1.0, 2.0])
    with pytest.raises(ShapeError, match=r"expected \(\*B, N, 4\)"):
        quat.average(np.ones(4))


def test_mixed_libraries_are_named(torch):
    with pytest.raises(ShapeError, match="arrays of one library, got numpy and torch"):
        quat.multiply(np.ones(4), torch.ones(4))


def test_inputs_are_left_alone(rng):
    q = random_quats(rng, 5)
    q.setflags(write=False)
    for result in (quat.normalize(q), quat.slerp(q, -q, 0.5), quat.align_signs(q), quat.average(q), quat.shortest(q)):
        assert result.shape[-1] == 4
