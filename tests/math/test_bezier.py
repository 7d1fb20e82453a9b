"""Bezier curves and conversions: De Casteljau and polynomials agree, SciPy's BPoly, exact ways there and back."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BPoly, CubicHermiteSpline

from keypose.errors import ShapeError
from keypose.math import spline


def test_polynomial_and_de_casteljau_agree_with_scipy(library, rng):
    points = rng.normal(size=(4, 3))
    u = np.linspace(-0.2, 1.2, 29)
    reference = BPoly(points[:, None, :], [0, 1])(u)
    p = [library.array(x) for x in points]
    tolerance = 60 * library.eps
    for found in (spline.bezier(*p, library.array(u)), spline.de_casteljau(library.array(points), library.array(u))):
        np.testing.assert_allclose(library.numpy(found), reference, atol=tolerance)
    slope = BPoly(points[:, None, :], [0, 1]).derivative()(u)
    np.testing.assert_allclose(library.numpy(spline.bezier_derivative(*p, library.array(u))), slope, atol=8 * tolerance)


def test_de_casteljau_of_any_degree(rng):
    for degree in (0, 1, 2, 5, 9):
        points = rng.normal(size=(degree + 1, 2))
        u = np.linspace(0, 1, 11)
        np.testing.assert_allclose(spline.de_casteljau(points, u), BPoly(points[:, None, :], [0, 1])(u), atol=1e-12)
    with pytest.raises(ShapeError, match="points: expected"):
        spline.de_casteljau(np.zeros(3), 0.5)


def test_both_halves_are_the_whole(rng):
    p = rng.normal(size=(4, 5, 3))
    at = rng.random(5)
    left, right = spline.split_bezier(*p, at)
    for u in np.linspace(0, 1, 13):
        np.testing.assert_allclose(spline.bezier(*left, u), spline.bezier(*p, at * u), atol=1e-14)
        np.testing.assert_allclose(spline.bezier(*right, u), spline.bezier(*p, at + (1 - at) * u), atol=1e-14)


def test_a_curve_does_not_pass_its_inner_points_but_leaves_towards_them():
    p = np.array([[0.0, 0], [0, 1], [1, 1], [1, 0]])
    np.testing.assert_allclose(spline.bezier(*p, 0.5), [0.5, 0.75])
    np.testing.assert_allclose(spline.bezier_derivative(*p, 0.0), 3 * (p[1] - p[0]))


# --- conversions ------------------------------------------------------------------------------------------------------


def test_hermite_to_bezier_and_back_is_exact(library, rng):
    p0, m0, p1, m1 = rng.normal(size=(4, 20, 3))
    span = rng.uniform(0.01, 5, 20)
    a = [library.array(x) for x in (p0, m0, p1, m1)]
    b1, b2 = spline.bezier_from_hermite(*a, library.array(span))
    u = library.array(rng.random(20))
    same = spline.bezier(a[0], b1, b2, a[2], u) - spline.hermite(*a, u, library.array(span))
    assert np.abs(library.numpy(same)).max() < 100 * library.eps
    back = spline.hermite_from_bezier(a[0], b1, b2, a[2], library.array(span))
    for found, expected in zip(back, (m0, m1), strict=True):
        error = np.abs(library.numpy(found) - expected).max()
        assert error < (1e-12 if library.dtype == "float64" else 1e-3)


def test_the_lectures_conversion():
    """m0 = 3 (b1 - b0), m1 = 3 (b3 - b2) over a span of one."""
    b = np.array([[0.0, 0], [1, 2], [3, 3], [4, 0]])
    m0, m1 = spline.hermite_from_bezier(*b, 1.0)
    np.testing.assert_array_equal(m0, 3 * (b[1] - b[0]))
    np.testing.assert_array_equal(m1, 3 * (b[3] - b[2]))


def test_weighted_handles_say_how_far_hermite_is_off(rng):
    p0, p1 = rng.normal(size=(2, 30, 2))
    span = rng.uniform(0.2, 2, 30)
    out = np.stack([rng.uniform(0.05, 1, (30, 2)) * span[:, None], rng.normal(size=(30, 2))], -1)
    back = np.stack([-rng.uniform(0.05, 1, (30, 2)) * span[:, None], rng.normal(size=(30, 2))], -1)
    m0, m1, error = spline.hermite_from_weighted(p0, out, p1, back, span)
    s = np.linspace(0, 1, 1025)[:, None]
    off = np.abs(spline.weighted_bezier(p0, out, p1, back, s, span) - spline.hermite(p0, m0, p1, m1, s, span)).max(0)
    assert np.all(error <= off * (1 + 1e-9) + 1e-15)
    assert np.all(error >= 0.7 * off - 1e-12)
    third = np.stack([np.repeat(span[:, None] / 3, 2, 1), out[..., 1]], -1)
    m0, _, error = spline.hermite_from_weighted(p0, third, p1, third * [-1, 1], span)
    assert error.max() < 1e-13
    np.testing.assert_allclose(m0, 3 * out[..., 1] / span[:, None])


# --- handles in time --------------------------------------------------------------------------------------------------


def test_the_parameter_is_found_everywhere(rng):
    a, b, x = rng.random((3, 50_000))
    a[:100], b[:100] = 1, 0  # upright in the middle
    a[100:200], b[100:200] = 0, 0
    a[200:300], b[200:300] = 1, 1
    a[300:400] = 10 ** rng.uniform(-20, 0, 100)
    x[350:450] = 10 ** rng.uniform(-30, 0, 100)
    u = spline.bezier_parameter(a, b, x)
    v = 1 - u
    assert np.all((u >= 0) & (u <= 1))
    np.testing.assert_allclose(3 * a * u * v * v + 3 * b * u * u * v + u**3, x, atol=1e-15, rtol=1e-14)
    np.testing.assert_array_equal(spline.bezier_parameter(a, b, 0.0), 0)
    np.testing.assert_array_equal(spline.bezier_parameter(a, b, 1.0), 1)
    rising = spline.bezier_parameter(0.9, 0.05, np.linspace(0, 1, 4001))
    assert np.all(np.diff(rising) > 0)


def test_the_parameter_in_single_precision_and_tensors(library, rng):
    a, b, x = rng.uniform(0.1, 0.9, (3, 500))
    u = library.numpy(spline.bezier_parameter(*(library.array(v) for v in (a, b, x)))).astype(float)
    np.testing.assert_allclose(3 * a * u * (1 - u) ** 2 + 3 * b * u * u * (1 - u) + u**3, x, atol=20 * library.eps)


def test_time_and_value_of_a_weighted_span_are_on_the_bezier_curve(rng):
    """Each component is the plane curve of seconds and value with its own control points."""
    span, p0, p1 = 1.7, np.array([0.3]), np.array([-1.1])
    out, back = np.array([[1.2, 0.8]]), np.array([[-0.9, 2.0]])
    u = np.linspace(0, 1, 101)
    plane = spline.bezier([0, 0.3], [1.2, 1.1], [span - 0.9, 0.9], [span, -1.1], u)
    found = spline.weighted_bezier(p0, out, p1, back, plane[:, 0] / span, span)
    np.testing.assert_allclose(found[:, 0], plane[:, 1], atol=1e-12)
    long = spline.weighted_bezier(p0, out * 10, p1, back, 0.4, span)  # 12 s long: shortened to the span
    short = spline.weighted_bezier(p0, out * (1.7 / 1.2), p1, back, 0.4, span)
    np.testing.assert_allclose(long, short, atol=1e-14)


def test_handles_of_a_third_are_hermite(rng):
    p, m = rng.normal(size=(2, 3)), rng.normal(size=(2, 3))
    span = 0.8
    third = np.full(3, span / 3)
    out, back = np.stack([third, third * m[0]], -1), np.stack([-third, -third * m[1]], -1)
    s = np.linspace(0, 1, 77)
    expected = CubicHermiteSpline([0, span], p, m)(s * span)
    np.testing.assert_allclose(spline.weighted_bezier(p[0], out, p[1], back, s, span), expected, atol=1e-13)


def test_gradients_flow_to_values_and_both_parts_of_handles(torch, rng):
    p0, p1 = (torch.tensor(rng.normal(size=(5, 2)), requires_grad=True) for _ in "ab")
    seconds = rng.uniform(0.1, 0.6, (2, 5, 2))
    out = torch.tensor(np.stack([seconds[0], rng.normal(size=(5, 2))], -1), requires_grad=True)
    back = torch.tensor(np.stack([-seconds[1], rng.normal(size=(5, 2))], -1), requires_grad=True)
    s = torch.linspace(0.05, 0.95, 5, dtype=torch.float64)
    assert torch.autograd.gradcheck(
        lambda *a: spline.weighted_bezier(*a, s, 0.9), (p0, out, p1, back), atol=1e-6, eps=1e-7
    )
