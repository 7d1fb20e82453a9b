"""Tangents through keys: pyramids, published formulas and SciPy's interpolators, at unequal times."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PchipInterpolator

from keypose.errors import ShapeError, UnknownName
from keypose.math import spline, tangents


@pytest.fixture
def keys(rng):
    return np.cumsum(rng.uniform(0.05, 1.5, 9)), rng.normal(size=(9, 3))


def barry_goldman(p, knots, at):
    """The recursive evaluation of a Catmull-Rom span between the second and third of four points."""

    def mix(a, b, i, j):
        return ((knots[j] - at) * a + (at - knots[i]) * b) / (knots[j] - knots[i])

    a1, a2, a3 = mix(p[0], p[1], 0, 1), mix(p[1], p[2], 1, 2), mix(p[2], p[3], 2, 3)
    return mix(mix(a1, a2, 0, 2), mix(a2, a3, 1, 3), 1, 2)


@pytest.mark.parametrize("knots", ["time", "uniform", "centripetal", "chordal"])
def test_catmull_rom_is_barry_and_goldmans_pyramid(keys, knots):
    times, p = keys
    back, out = tangents.catmull_rom(p, times, knots)
    power = {"uniform": 0, "centripetal": 0.5, "chordal": 1}.get(knots)
    steps = np.diff(times) if power is None else np.linalg.norm(np.diff(p, axis=0), axis=1) ** power
    places = np.concatenate([[0], np.cumsum(steps)])
    for k in range(1, 7):
        for u in (0.0, 0.2, 0.5, 0.9):
            at = places[k] + u * (places[k + 1] - places[k])
            expected = barry_goldman(p[k - 1 : k + 3], places[k - 1 : k + 3], at)
            found = spline.hermite(p[k], out[k], p[k + 1], back[k + 1], u, times[k + 1] - times[k])
            np.testing.assert_allclose(found, expected, atol=1e-12)
    if knots == "time":
        np.testing.assert_array_equal(back, out)


def test_the_lectures_tangent_at_equal_distances():
    p = np.array([[0.0], [1], [4], [2]])
    expected = [(p[2] - p[0]) / 2, (p[3] - p[1]) / 2]
    for found in (tangents.central(p, np.arange(4.0)), tangents.catmull_rom(p, np.arange(4.0), "uniform")[0]):
        np.testing.assert_array_equal(found[1:-1], expected)


def test_ends(keys):
    times, p = keys
    np.testing.assert_array_equal(tangents.central(p, times, "flat")[[0, -1]], 0)
    chord = (p[1] - p[0]) / (times[1] - times[0])
    np.testing.assert_allclose(tangents.central(p, times, "chord")[0], chord)
    bow = 2 * times**2 - times
    np.testing.assert_allclose(tangents.catmull_rom(bow, times, ends="parabola")[0], 4 * times - 1, atol=1e-10)
    with pytest.raises(UnknownName, match="no ends 'flot'; nearest: 'flat'"):
        tangents.central(p, times, "flot")


def test_equal_neighbours_stand_still():
    times = np.array([0.0, 1.0, 2.0, 3.0])
    p = np.array([[0.0, 0], [1, 1], [1, 1], [3, 0]])
    for knots in ("centripetal", "chordal"):
        back, out = tangents.catmull_rom(p, times, knots)
        assert np.all(np.isfinite(back))
        np.testing.assert_array_equal(out[1], 0)
        np.testing.assert_array_equal(back[2], 0)


def test_kochanek_and_bartels(keys):
    times, p = keys
    for found in tangents.kochanek_bartels(p, times):
        np.testing.assert_allclose(found, tangents.central(p, times))
    for found in tangents.kochanek_bartels(p, times, tension=1.0):
        np.testing.assert_array_equal(found, 0)
    # Equations 8 and 9 of the paper with 11 and 12, written out for one key.
    t, c, b, k = 0.3, -0.4, 0.6, 4
    d0, d1 = p[k] - p[k - 1], p[k + 1] - p[k]
    n0, n1 = times[k] - times[k - 1], times[k + 1] - times[k]
    source = (1 - t) * (1 - c) * (1 + b) / 2 * d0 + (1 - t) * (1 + c) * (1 - b) / 2 * d1
    destination = (1 - t) * (1 + c) * (1 + b) / 2 * d0 + (1 - t) * (1 - c) * (1 - b) / 2 * d1
    back, out = tangents.kochanek_bartels(p, times, t, c, b)
    np.testing.assert_allclose(back[k], source * 2 * n0 / (n0 + n1) / n0, atol=1e-13)
    np.testing.assert_allclose(out[k], destination * 2 * n1 / (n0 + n1) / n1, atol=1e-13)
    each = tangents.kochanek_bartels(p, times, np.where(np.arange(9) == k, t, 0), np.where(np.arange(9) == k, c, 0), b)
    np.testing.assert_allclose(each[1][k], out[k])
    with pytest.raises(ShapeError, match=r"tension: expected a number or \(9,\), got \(3,\)"):
        tangents.kochanek_bartels(p, times, [0, 0, 0])


def test_fritsch_and_butland_is_scipys_pchip(keys):
    times, p = keys
    for count in (2, 3, 9):
        expected = PchipInterpolator(times[:count], p[:count])(times[:count], 1)
        np.testing.assert_allclose(tangents.monotone(p[:count], times[:count], "fritsch_butland"), expected, atol=1e-13)


@pytest.mark.parametrize("method", ["fritsch_carlson", "fritsch_butland", "steffen"])
def test_monotone_curves_stay_between_their_keys(rng, method):
    for _ in range(30):
        times = np.cumsum(rng.uniform(0.01, 2, 10))
        p = rng.normal(size=(10, 4)) * (rng.random((10, 4)) < 0.8)
        u = np.linspace(0, 1, 41)
        curve = CubicHermiteSpline(times, p, tangents.monotone(p, times, method))
        found = curve(times[:-1, None] + u * np.diff(times)[:, None])
        low, high = np.minimum(p[:-1], p[1:])[:, None], np.maximum(p[:-1], p[1:])[:, None]
        assert np.all((found >= low - 1e-12) & (found <= high + 1e-12))


def test_steffens_published_limits():
    """Equation 11: the tangent of the parabola, but no more than twice the smaller chord."""
    times, p = np.array([0.0, 1, 2, 3]), np.array([0.0, 1, 10, 11])
    found = tangents.monotone(p, times, "steffen")
    np.testing.assert_allclose(found[1:3], [2.0, 2.0])
    np.testing.assert_allclose(tangents.monotone(np.array([0.0, 1, 2.5, 4]), times, "steffen")[1], 1.25)


def test_natural_is_scipys(keys):
    times, p = keys
    for count in (2, 3, 9):
        expected = CubicSpline(times[:count], p[:count], bc_type="natural")(times[:count], 1)
        np.testing.assert_allclose(tangents.natural(p[:count], times[:count]), expected, atol=1e-12)


def test_tensors_single_keys_and_wrong_times(library, rng):
    times, p = np.arange(5.0), rng.normal(size=(5, 2))
    for name in ("central", "monotone", "natural"):
        find = getattr(tangents, name)
        np.testing.assert_allclose(library.numpy(find(library.array(p), times)), find(p, times), atol=1e-5)
        np.testing.assert_array_equal(library.numpy(find(library.array(p[:1]), [0.0])), 0)
    for found in tangents.catmull_rom(library.array(p), times, "centripetal"):
        library.numpy(found)
    with pytest.raises(ShapeError, match="times_s: expected finite, strictly increasing"):
        tangents.central(p, [0, 1, 1, 2, 3])
    with pytest.raises(UnknownName, match="no knots 'chord'; nearest: 'chordal'"):
        tangents.catmull_rom(p, times, "chord")
