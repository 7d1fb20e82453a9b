"""Linear and Hermite splines: exact at keys, derivatives, SciPy's cubic as a reference, degenerate spans."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from keypose.errors import ShapeError
from keypose.math import spline


def test_lerp_is_exact_at_keys_and_for_constants(library, rng):
    a, b = (library.array(rng.normal(size=(50, 3)) * 10.0 ** rng.integers(-6, 6, size=(50, 1))) for _ in "ab")
    np.testing.assert_array_equal(library.numpy(spline.lerp(a, b, 0)), library.numpy(a))
    np.testing.assert_array_equal(library.numpy(spline.lerp(a, b, 1)), library.numpy(b))
    for u in rng.random(20):
        np.testing.assert_array_equal(library.numpy(spline.lerp(a, a, u)), library.numpy(a))
    u = rng.random(50)
    expected = (1 - u[:, None]) * library.numpy(a).astype(float) + u[:, None] * library.numpy(b).astype(float)
    got = library.numpy(spline.lerp(a, b, library.array(u)))
    size = np.maximum(np.abs(library.numpy(a)), np.abs(library.numpy(b)))
    assert np.all(np.abs(got - expected) <= 4 * library.eps * size)
    assert library.numpy(spline.lerp(a[0], b[0], library.array(u))).shape == (50, 3)


def test_parameter_of_time(library):
    u = spline.parameter(library.array([0, 1, 1.5, 2, 3]), 1, 2)
    np.testing.assert_array_equal(library.numpy(u), [-1, 0, 0.5, 1, 2])
    assert library.numpy(spline.parameter(library.array(1.0), 1, 1)) == 1


def test_hermite_is_scipys_cubic(library, rng):
    p, m = rng.normal(size=(2, 4)), rng.normal(size=(2, 4))
    span = 0.7
    reference = CubicHermiteSpline([0, span], p, m)
    u = np.linspace(-0.5, 1.5, 41)
    arguments = [library.array(x) for x in (p[0], m[0], p[1], m[1], u)]
    tolerance = 40 * library.eps
    np.testing.assert_allclose(library.numpy(spline.hermite(*arguments, span)), reference(u * span), atol=tolerance)
    velocity = library.numpy(spline.hermite_derivative(*arguments, span))
    np.testing.assert_allclose(velocity, reference(u * span, 1), atol=4 * tolerance)


def test_hermite_is_exact_at_keys_and_for_constants(library, rng):
    p0, m0, p1, m1 = (library.array(rng.normal(size=(50, 3))) for _ in range(4))
    number = library.numpy
    np.testing.assert_array_equal(number(spline.hermite(p0, m0, p1, m1, 0, 2.5)), number(p0))
    np.testing.assert_array_equal(number(spline.hermite(p0, m0, p1, m1, 1, 2.5)), number(p1))
    np.testing.assert_array_equal(number(spline.hermite_derivative(p0, m0, p1, m1, 0, 2.5)), number(m0))
    np.testing.assert_array_equal(number(spline.hermite_derivative(p0, m0, p1, m1, 1, 2.5)), number(m1))
    flat = library.array(np.zeros((50, 3)))
    for u in rng.random(10):
        np.testing.assert_array_equal(number(spline.hermite(p0, flat, p0, flat, u, 2.5)), number(p0))


def test_tangents_are_per_second_whatever_the_span(rng):
    """The same straight motion, keyed over any span, is the same line."""
    p0, velocity = rng.normal(size=3), rng.normal(size=3)
    for span in (1 / 120, 1.0, 30.0):
        for u in (0.1, 0.5, 0.9):
            line = spline.hermite(p0, velocity, p0 + span * velocity, velocity, u, span)
            np.testing.assert_allclose(line, p0 + u * span * velocity, atol=1e-14 * max(span, 1))
            np.testing.assert_allclose(
                spline.hermite_derivative(p0, velocity, p0 + span * velocity, velocity, u, span), velocity, rtol=1e-12
            )


def test_the_derivative_is_the_finite_difference(rng):
    p0, m0, p1, m1 = rng.normal(size=(4, 3))
    span, h = 0.4, 1e-6
    for u in np.linspace(0.05, 0.95, 7):
        up, down = (spline.hermite(p0, m0, p1, m1, u + s * h, span) for s in (1, -1))
        found = spline.hermite_derivative(p0, m0, p1, m1, u, span)
        np.testing.assert_allclose(found, (up - down) / (2 * h * span), atol=1e-8)


def test_ease_in_and_out_is_the_smoothstep():
    u = np.linspace(0, 1, 11)
    got = spline.hermite([0.0], [0.0], [1.0], [0.0], u, 1.0)[:, 0]
    np.testing.assert_allclose(got, u * u * (3 - 2 * u), atol=1e-15)


def test_spans_of_no_length_are_finite(library):
    p0, p1, m = library.array([0, 1]), library.array([2, 3]), library.array([5, 5])
    u = library.array([0, 0.5, 1])
    np.testing.assert_array_equal(library.numpy(spline.hermite(p0, m, p1, m, u, 0)), [[0, 1], [1, 2], [2, 3]])
    derivative = library.numpy(spline.hermite_derivative(p0, m, p1, m, u, 0))
    np.testing.assert_array_equal(derivative[[0, 2]], [[5, 5], [5, 5]])
    assert np.isfinite(derivative).all()


def test_shapes_and_precision():
    values = np.ones((4, 3), np.float32)
    assert spline.lerp(values, values, np.linspace(0, 1, 4)).dtype == np.float32
    assert spline.hermite(values, values, values, values, np.linspace(0, 1, 4), np.float64(2)).dtype == np.float32
    assert spline.lerp(values[:, None], values, 0.5).shape == (4, 4, 3)
    assert spline.lerp(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)).shape == (0, 3)
    assert spline.lerp([1, 2], [3, 4], 0.5).tolist() == [2, 3]
    with pytest.raises(ShapeError, match="give a scalar curve one component"):
        spline.lerp(1.0, 2.0, 0.5)
    with pytest.raises(ShapeError, match=r"do not broadcast: a \(4,\), b \(4,\), u \(5,\)"):
        spline.lerp(values, values, np.zeros(5))
    with pytest.raises(ShapeError, match=r"components of a \(3,\), components of b \(2,\)"):
        spline.lerp(np.zeros(3), np.zeros(2), 0.5)
