"""Many curves at once: the same as one by one, for every kind, mode, extrapolation, precision and order of times."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import CubicHermiteSpline

from keypose.errors import ShapeError
from keypose.evaluate import prepare_curves, sample_curve, sample_curves
from keypose.model import Curve, CurveKind, Extrapolation, Interpolation
from tests.evaluate.test_evaluate_curves import BOTH, HERMITE, LINEAR, TIMES, make


def every_curve(dtype: type = np.float64) -> list[Curve]:
    rng = np.random.default_rng(0)
    curves: list[Curve] = []
    for kind, mode in BOTH:
        for before in Extrapolation:
            keys = np.cumsum(rng.uniform(0.05, 1.0, rng.integers(1, 9)))
            after = list(Extrapolation)[rng.integers(5)]
            curves.append(make(kind, mode, dtype, times=keys, before=before, after=after))
    return curves


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_together_is_one_by_one(dtype: type) -> None:
    curves = every_curve(dtype)
    table = prepare_curves(curves)
    times = np.random.default_rng(1).uniform(-7, 12, (13, 17))
    found = sample_curves(table, times)
    assert found.dtype == dtype
    assert found.shape == (13, 17, table.component_count)
    for n, curve in enumerate(curves):
        own = found[..., table.starts[n] : table.starts[n + 1]]
        expected = sample_curve(curve, times)
        # beside an upright stretch rounding of the time is seen
        steep = curve.modes[0] == Interpolation.BEZIER
        loose = np.abs(own - expected) > (1e-4 if dtype is np.float32 else 1e-9)
        assert np.mean(loose) < (0.02 if steep else 1e-9), (n, curve.kind, curve.modes[0])


def test_at_keys_the_values_are_the_keys() -> None:
    curves = [make(kind, mode) for kind, mode in BOTH]
    found = sample_curves(prepare_curves(curves), TIMES)
    assert_array_equal(found, np.concatenate([c.values for c in curves], axis=1))


@pytest.mark.parametrize("times", [0.7, [0.7], [[2.0, 0.3], [9.0, -1.0]], []])
def test_times_of_any_shape_and_order(times: object) -> None:
    curve = make(CurveKind.VECTOR, HERMITE)
    assert_allclose(sample_curves(prepare_curves([curve]), times), sample_curve(curve, times), atol=1e-14)


@pytest.mark.parametrize("rate_hz", [60.0, 59.0, 120.0, 30.0])
def test_frames_of_a_rate_at_frames_of_another(rate_hz: float) -> None:
    rng = np.random.default_rng(9)
    lines = [Curve(s + np.arange(200) / 60, rng.normal(size=(200, 3)).astype(np.float32)) for s in (0.0, -0.004, 0.003)]
    times = 0.01 + np.arange(int(3.2 * rate_hz)) / rate_hz
    table = prepare_curves(lines)
    expected = np.concatenate([sample_curve(c, times) for c in lines], axis=1)
    assert_allclose(sample_curves(table, times), expected, atol=2e-6)
    memory = np.empty((9, len(times)), np.float32)
    again = sample_curves(table, times, memory)
    assert np.shares_memory(again, memory)
    assert_array_equal(again, sample_curves(table, times))
    forth = again.copy()
    assert_array_equal(sample_curves(table, times[::-1], memory), forth[::-1])
    with pytest.raises(ShapeError, match="out: expected a contiguous array"):
        sample_curves(table, times, memory[:, 1:])


def test_thousands_of_keys_are_found_however_uneven() -> None:
    rng = np.random.default_rng(2)
    keys = np.cumsum(rng.exponential(size=5000) ** 4 + 1e-9)
    values, slopes = rng.normal(size=(5000, 2)), rng.normal(size=(5000, 2))
    curve = Curve(keys, values, HERMITE, slopes, slopes)
    times = rng.uniform(keys[0], keys[-1], 20000)
    table = prepare_curves([curve])
    expected = CubicHermiteSpline(keys, values, slopes)(times)
    assert_allclose(sample_curves(table, times), expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max())
    single = [float(sample_curves(table, t)[0]) for t in times[:50]]
    assert_allclose(single, sample_curve(curve, times[:50])[:, 0])


def test_empty_tables_and_wrong_arrays() -> None:
    assert sample_curves(prepare_curves([]), [0.0, 1.0]).shape == (2, 0)
    torch = pytest.importorskip("torch")
    with pytest.raises(ShapeError, match="curves: expected NumPy arrays, got Tensor"):
        prepare_curves([Curve([0.0], torch.ones((1, 1)))])
    with pytest.raises(ShapeError, match="dtype: expected float32 or float64, got int64"):
        prepare_curves([make(CurveKind.VECTOR, LINEAR)], np.int64)
