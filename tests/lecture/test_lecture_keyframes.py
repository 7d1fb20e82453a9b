"""One test for every formula of the lecture's keyframing and rotation sections, in the lecture's order.

Each states the formula with its own numbers and compares with an implementation that is not ours: the formula written out by hand
on plain numbers, SciPy, or NumPy's matrices.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import BPoly, CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from keypose.editing.ease import slow_in_out
from keypose.evaluate import sample_curve, sample_timeline
from keypose.math import euler, quat, rotation_splines, spline, tangents
from keypose.model import Channel, Clip, Curve, CurveKind, Layer, Placement, Pose, Property, Skeleton, Timeline


def scipys(q):
    return Rotation.from_quat(np.asarray(q, float)[..., [1, 2, 3, 0]])


def product(q1, q2):
    """[w1 w2 - v1.v2, w1 v2 + w2 v1 + v1 x v2], by hand."""
    w1, v1, w2, v2 = q1[0], np.array(q1[1:]), q2[0], np.array(q2[1:])
    return np.array([w1 * w2 - v1 @ v2, *(w1 * v2 + w2 * v1 + np.cross(v1, v2))])


def about(axis, degrees):
    """w = cos(angle / 2), v = V sin(angle / 2), by hand."""
    half = math.radians(degrees) / 2
    return np.array([math.cos(half), *(math.sin(half) * np.asarray(axis, float))])


# --- Traditional animation ----------------------------------------------------------------------------------------------


def test_25_frames_per_second():
    """Film shows 25 images a second: the rate of a timeline where nothing else is said, and frames lie on its grid."""
    assert Timeline().rate_hz == 25
    skeleton = Skeleton(("a",), [-1], Pose(np.zeros((1, 3)), [[1.0, 0, 0, 0]], np.ones((1, 3))))
    clip = Clip({Channel("a", Property.TRANSLATION): Curve([0, 1], [[0.0, 0, 0], [1, 0, 0]])}, "move")
    timeline = Timeline((Layer("l", (Placement("move"),)),), hold_frames=1)
    times = np.arange(0, 1, 0.007)
    shown = sample_timeline(timeline, {"move": clip}, skeleton, times).translations[:, 0, 0]
    np.testing.assert_allclose(shown, np.floor(times * 25 + 1e-9) / 25, atol=1e-12)


# --- Keyframing ---------------------------------------------------------------------------------------------------------


def test_keyframes_are_time_and_value():
    curve = Curve([0.0, 0.4, 1.0], [[0.0, 2, 0], [1, 0.5, 0], [3, 2, 0]])
    pairs = list(zip(curve.times_s.tolist(), curve.values.tolist(), strict=True))
    assert pairs == [(0.0, [0, 2, 0]), (0.4, [1, 0.5, 0]), (1.0, [3, 2, 0])]
    for time, value in pairs:
        assert sample_curve(curve, time).tolist() == value


def test_linear_interpolation():
    """P(t) = (1 - t) P(t_k-1) + t P(t_k), the ball a quarter and three quarters of the way."""
    a, b = np.array([1.0, 4.0, 0.0]), np.array([5.0, 0.0, 2.0])
    for t in (0.0, 0.25, 0.75, 1.0):
        by_hand = [(1 - t) * p + t * q for p, q in zip(a, b, strict=True)]
        np.testing.assert_allclose(spline.lerp(a, b, t), by_hand, atol=1e-15)
    assert spline.lerp(a, b, 0.25).tolist() == [2, 3, 0.5]


def test_times_are_normalised():
    """u = (t - t_k-1) / (t_k - t_k-1): keys at 2 s and 6 s, so that 3 s is a quarter."""
    assert spline.parameter(3.0, 2.0, 6.0) == 0.25
    curve = Curve([2.0, 6.0], [[10.0], [30.0]], kind=CurveKind.SCALAR)
    times = np.linspace(2, 6, 33)
    np.testing.assert_allclose(sample_curve(curve, times)[:, 0], np.interp(times, [2, 6], [10, 30]), atol=1e-12)


POINTS = np.array([[0.0, 0.0], [1.0, 3.0], [4.0, 3.0], [5.0, -1.0]])


def test_bezier():
    """(1-u)^3 p0 + 3u(1-u)^2 p1 + 3u^2(1-u) p2 + u^3 p3, and the same by De Casteljau; SciPy's Bernstein polynomials agree."""
    u = np.linspace(0, 1, 17)
    reference = BPoly(POINTS[:, None, :], [0, 1])(u)
    np.testing.assert_allclose(spline.bezier(*POINTS, u), reference, atol=1e-14)
    np.testing.assert_allclose(spline.de_casteljau(POINTS, u), reference, atol=1e-14)
    assert spline.bezier(*POINTS, 0.5).tolist() == [2.5, 2.125]  # (0 + 3 + 12 + 5) / 8, (0 + 9 + 9 - 1) / 8
    # smooth, but not through the inner points
    distance = np.linalg.norm(reference[:, None] - POINTS[1:3], axis=-1)
    assert distance.min() > 0.5


def test_hermite():
    """End points and velocities: (2u^3-3u^2+1) p0 + (u^3-2u^2+u) m0 + (-2u^3+3u^2) p1 + (u^3-u^2) m1."""
    p0, p1, m0, m1 = np.array([0.0, 1]), np.array([2.0, 0]), np.array([3.0, 3]), np.array([0.0, -6])
    u = np.linspace(0, 1, 17)
    by_hand = (
        np.outer(2 * u**3 - 3 * u**2 + 1, p0)
        + np.outer(u**3 - 2 * u**2 + u, m0)
        + np.outer(-2 * u**3 + 3 * u**2, p1)
        + np.outer(u**3 - u**2, m1)
    )
    np.testing.assert_allclose(spline.hermite(p0, m0, p1, m1, u, 1.0), by_hand, atol=1e-14)
    # over a span of 2.5 s the tangents are velocities, in units per second
    span = 2.5
    reference = CubicHermiteSpline([0, span], [p0, p1], [m0, m1])
    np.testing.assert_allclose(spline.hermite(p0, m0, p1, m1, u, span), reference(span * u), atol=1e-13)
    np.testing.assert_allclose(spline.hermite_derivative(p0, m0, p1, m1, u, span), reference(span * u, 1), atol=1e-13)


def test_bezier_to_hermite_and_back():
    """m0 = 3 (b1 - b0), m1 = 3 (b3 - b2); b1 = p0 + m0 / 3, b2 = p1 - m1 / 3."""
    m0, m1 = spline.hermite_from_bezier(*POINTS, 1.0)
    assert m0.tolist() == [3, 9] and m1.tolist() == [3, -12]
    b1, b2 = spline.bezier_from_hermite(POINTS[0], m0, POINTS[3], m1, 1.0)
    np.testing.assert_allclose([b1, b2], POINTS[1:3], atol=1e-15)
    u = np.linspace(0, 1, 17)
    curve = CubicHermiteSpline([0, 1], [POINTS[0], POINTS[3]], [m0, m1])
    np.testing.assert_allclose(spline.bezier(*POINTS, u), curve(u), atol=1e-14)


def test_catmull_rom():
    """The tangent is the average of the distance from the previous key and to the next one."""
    keys = np.array([[0.0, 0], [2.0, 4], [6.0, 0], [7.0, 1]])
    times = np.arange(4.0)
    _, out = tangents.catmull_rom(keys, times)
    for k in (1, 2):
        by_hand = ((keys[k] - keys[k - 1]) + (keys[k + 1] - keys[k])) / 2
        np.testing.assert_allclose(out[k], by_hand, atol=1e-15)
    assert out[1].tolist() == [3, 0]
    # at even times that is the basis matrix of the textbooks
    u = np.linspace(0, 1, 9)
    basis = 0.5 * np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]])
    expected = np.stack([u**0, u, u**2, u**3], axis=-1) @ basis @ keys
    found = spline.hermite(keys[1], out[1], keys[2], out[2], u, 1.0)
    np.testing.assert_allclose(found, expected, atol=1e-14)


def test_zero_tangents_at_the_ends_are_slow_in_slow_out():
    """The first and the last tangent set to zero: it starts slowly, is fastest in the middle and stops slowly."""
    curve = slow_in_out(Curve([0.0, 2.0], [[0.0], [8.0]], kind=CurveKind.SCALAR), [0, 1])
    times = np.linspace(0, 2, 201)
    found = sample_curve(curve, times)[:, 0]
    np.testing.assert_allclose(found, CubicHermiteSpline([0, 2], [0, 8], [0, 0])(times), atol=1e-13)
    speed = np.gradient(found, times)
    assert speed[0] < 0.1 and speed[-1] < 0.1 and np.argmax(speed) == 100 and speed.max() == pytest.approx(6, abs=1e-3)


# --- Rotations: Euler angles ----------------------------------------------------------------------------------------------


def test_the_order_of_euler_angles_changes_the_rotation():
    """90 degrees about X, then about Y, is not 90 degrees about Y, then about X: where Z ends up, by hand."""
    quarter = math.pi / 2
    x_first = euler.to_quat([quarter, quarter, 0.0], "xyz")  # about the fixed axes, X first
    y_first = euler.to_quat([quarter, quarter, 0.0], "yxz")
    np.testing.assert_allclose(quat.rotate(x_first, [0, 0, 1]), [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(quat.rotate(y_first, [0, 0, 1]), [1, 0, 0], atol=1e-15)
    for order, found in (("xyz", x_first), ("yxz", y_first)):
        expected = Rotation.from_euler(order, [quarter, quarter, 0])
        assert (expected.inv() * scipys(found)).magnitude() < 1e-15


def test_gimbal_lock():
    """Y by 90 degrees carries Z onto X: then turning about X and about Z does the same, and one freedom is lost."""
    quarter = math.pi / 2
    turned = euler.to_quat([0.0, quarter, 0.0], "XYZ")
    np.testing.assert_allclose(quat.rotate(turned, [0, 0, 1]), [1, 0, 0], atol=1e-15)
    for angle in (0.3, -1.1, 2.0):
        by_x, by_z = euler.to_quat([angle, quarter, 0.0], "XYZ"), euler.to_quat([0.0, quarter, angle], "XYZ")
        assert quat.angle_between(by_x, by_z) < 1e-15
        matrices = [Rotation.from_euler("XYZ", a).as_matrix() for a in ([angle, quarter, 0], [0, quarter, angle])]
        np.testing.assert_allclose(matrices[0], matrices[1], atol=1e-15)
    assert euler.gimbal_distance([0.2, quarter, 0.4], "XYZ") == 0
    assert euler.gimbal_distance([0.2, math.radians(60), 0.4], "XYZ") == pytest.approx(math.radians(30))


def test_constant_speed_of_euler_angles_is_not_constant_speed_of_the_rotation():
    start, end = np.radians([0.0, -80, 0]), np.radians([150.0, 80, 150])
    u = np.linspace(0, 1, 100)
    by_angles = scipys(euler.to_quat(spline.lerp(start, end, u), "XYZ"))
    steps = (by_angles[:-1].inv() * by_angles[1:]).magnitude()
    assert steps.max() > 1.5 * steps.min()
    path = scipys(quat.slerp(euler.to_quat(start, "XYZ"), euler.to_quat(end, "XYZ"), u))
    even = (path[:-1].inv() * path[1:]).magnitude()
    assert np.ptp(even) < 1e-12


# --- Rotations: quaternions ----------------------------------------------------------------------------------------------


def test_conjugate():
    """q* = [w, -v]"""
    assert quat.conjugate([0.5, 0.1, -0.7, 0.5]).tolist() == [0.5, -0.1, 0.7, -0.5]


def test_product():
    """[w1 w2 - v1.v2, w1 v2 + w2 v1 + v1 x v2]: Hamilton's ij = k, jk = i, ki = j, i² = j² = k² = ijk = -1."""
    one, i, j, k = np.eye(4)
    for a, b, c in ((i, j, k), (j, k, i), (k, i, j), (i, i, -one), (j, j, -one), (k, k, -one)):
        np.testing.assert_array_equal(quat.multiply(a, b), c)
    np.testing.assert_array_equal(quat.multiply(quat.multiply(i, j), k), -one)
    a, b = np.array([1.0, 2, 3, 4]), np.array([5.0, 6, 7, 8])
    assert quat.multiply(a, b).tolist() == [-60, 12, 30, 24] == product(a, b).tolist()


def test_angle_and_axis():
    """w = cos(theta / 2), v = V sin(theta / 2): 120 degrees about (1, 1, 1) turns X to Y, Y to Z, Z to X."""
    axis = np.ones(3) / math.sqrt(3)
    q = quat.from_axis_angle(axis, math.radians(120))
    np.testing.assert_allclose(q, [0.5, 0.5, 0.5, 0.5], atol=1e-15)
    np.testing.assert_allclose(q, about(axis, 120), atol=1e-15)
    np.testing.assert_allclose(quat.rotate(q, np.eye(3)), np.roll(np.eye(3), 1, axis=1), atol=1e-15)
    found_axis, angle = quat.to_axis_angle(q)
    np.testing.assert_allclose(found_axis, axis, atol=1e-15)
    assert angle == pytest.approx(math.radians(120))


def test_rotations_are_unit_quaternions():
    for q in (about([0, 1, 0], 70), about([0, 0.6, 0.8], -200), euler.to_quat([1.0, 2, 3], "ZYX")):
        assert np.linalg.norm(q) == pytest.approx(1, abs=1e-15)


def test_rotating_a_vector():
    """v' = q v q^-1 with v = [0, V], and the scalar part of the result is 0."""
    q, v = about([0.6, 0, 0.8], 100), np.array([1.0, -2, 0.5])
    sandwich = product(product(q, [0, *v]), q * [1, -1, -1, -1])
    assert sandwich[0] == pytest.approx(0, abs=1e-15)
    np.testing.assert_allclose(quat.rotate(q, v), sandwich[1:], atol=1e-14)
    np.testing.assert_allclose(quat.rotate(q, v), scipys(q).apply(v), atol=1e-14)


def test_inverse():
    """The inverse of a unit quaternion is its conjugate: together they are no rotation."""
    q = about([0, 0.6, 0.8], 77)
    np.testing.assert_allclose(quat.inverse(q), quat.conjugate(q), atol=1e-15)
    np.testing.assert_allclose(quat.multiply(q, quat.inverse(q)), [1, 0, 0, 0], atol=1e-15)


# --- operators on rotations -------------------------------------------------------------------------------------------------


def test_addition_is_multiplication():
    """One rotation after another is q2 q1, q1 first; the order matters."""
    q1, q2 = about([1, 0, 0], 90), about([0, 1, 0], 90)
    both = quat.multiply(q2, q1)
    np.testing.assert_allclose(quat.rotate(both, [0, 0, 1]), [0, -1, 0], atol=1e-15)  # X first: Z goes to -Y, and stays
    assert ((scipys(q2) * scipys(q1)).inv() * scipys(both)).magnitude() < 1e-15
    assert quat.angle_between(both, quat.multiply(q1, q2)) > 1


def test_subtraction_is_multiplication_by_the_inverse():
    """q2 q1^-1 leads from q1 to q2."""
    q1, q2 = about([0, 0, 1], 30), about([0, 0, 1], 75)
    np.testing.assert_allclose(quat.difference(q1, q2), about([0, 0, 1], 45), atol=1e-15)
    a, b = about([0.6, 0.8, 0], 130), about([0, 0.6, 0.8], -50)
    np.testing.assert_allclose(quat.difference(a, b), product(b, a * [1, -1, -1, -1]), atol=1e-15)
    assert quat.angle_between(quat.multiply(quat.difference(a, b), a), b) < 1e-14


def test_multiplication_by_a_number_scales_the_angle():
    """q.setAngleAxis(t angle, axis)"""
    axis = [0.6, 0, 0.8]
    for t in (0.0, 0.25, 0.5, 1.0, 1.5, -1.0):
        np.testing.assert_allclose(quat.power(about(axis, 100), t), about(axis, 100 * t), atol=1e-15)
        rotvec = t * scipys(about(axis, 100)).as_rotvec()
        assert (Rotation.from_rotvec(rotvec).inv() * scipys(quat.power(about(axis, 100), t))).magnitude() < 1e-14


# --- interpolating rotations --------------------------------------------------------------------------------------------------


def test_interpolating_normally_leaves_the_sphere_and_the_pace():
    a, b = about([0, 0, 1], 0), about([0, 0, 1], 160)
    middle = 0.5 * a + 0.5 * b
    assert np.linalg.norm(middle) == pytest.approx(math.cos(math.radians(40)))  # not 1
    u = np.linspace(0, 1, 5)
    path = quat.nlerp(a, b, u)
    steps = np.degrees(quat.angle_between(path[:-1], path[1:]))
    np.testing.assert_allclose(np.linalg.norm(path, axis=-1), 1)
    assert steps[1] > 1.3 * steps[0]
    even = quat.slerp(a, b, u)
    np.testing.assert_allclose(np.degrees(quat.angle_between(even[:-1], even[1:])), 40, atol=1e-12)


def test_slerp():
    """q1 sin((1-t) theta) / sin theta + q2 sin(t theta) / sin theta, theta from the four-dimensional dot product."""
    q1, q2 = about([0, 1, 0], 20), about([0.6, 0, 0.8], 110)
    theta = math.acos(float(q1 @ q2))
    u = np.linspace(0, 1, 11)
    for t, found in zip(u, quat.slerp(q1, q2, u), strict=True):
        by_hand = q1 * math.sin((1 - t) * theta) / math.sin(theta) + q2 * math.sin(t * theta) / math.sin(theta)
        np.testing.assert_allclose(found, by_hand, atol=1e-14)
    reference = Slerp([0, 1], Rotation.concatenate([scipys(q1), scipys(q2)]))(u)
    assert (reference.inv() * scipys(quat.slerp(q1, q2, u))).magnitude().max() < 1e-14


def test_opposite_quaternions_are_one_rotation_and_slerp_goes_the_short_way():
    """[s, v] and [-s, -v] are the same; if cos theta < 0, q2 is negated."""
    q1, q2 = about([0, 1, 0], 10), about([0, 1, 0], 50)
    np.testing.assert_allclose(quat.rotate(-q2, [1, 2, 3]), quat.rotate(q2, [1, 2, 3]), atol=1e-15)
    assert float(q1 @ -q2) < 0
    for t in (0.25, 0.5, 0.75):
        expected = about([0, 1, 0], 10 + 40 * t)
        assert quat.angle_between(quat.slerp(q1, -q2, t), expected) < 1e-15


def test_de_casteljau_on_the_sphere():
    """Shoemake: De Casteljau's construction with slerp in place of lerp; about one axis it is the Bezier curve of the angles."""
    angles = np.array([0.0, 40.0, 120.0, 90.0])
    points = np.stack([about([0, 0.6, 0.8], a) for a in angles])
    controls = rotation_splines.controls_of(points[[0, 3]], points[1:2], points[2:3])
    for u in np.linspace(0, 1, 9):
        expected = BPoly(angles[:, None], [0, 1])(u)
        found = rotation_splines.spherical_bezier(points[0], controls[0], u)
        assert quat.angle_between(found, about([0, 0.6, 0.8], float(expected))) < 1e-14
    # about several axes, by SciPy's Slerp
    points = np.stack(
        [about(a, d) for a, d in (([1, 0, 0], 20), ([0, 1, 0], 50), ([0, 0, 1], 60), ([0, 0.6, 0.8], 80))]
    )
    controls = rotation_splines.controls_of(points[[0, 3]], points[1:2], points[2:3])
    for u in (0.2, 0.5, 0.8):
        level = list(scipys(points))
        while len(level) > 1:
            level = [Slerp([0, 1], Rotation.concatenate([a, b]))(u) for a, b in pairwise(level)]
        found = scipys(rotation_splines.spherical_bezier(points[0], controls[0], u))
        assert (level[0].inv() * found).magnitude() < 1e-14
