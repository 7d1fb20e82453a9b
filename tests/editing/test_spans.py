"""What operators read from curves and put into them: rates at keys against differences, spans replaced, spans made smooth."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.editing.spans import Span, difference, hermite_spans, moved, rates, with_spans
from keypose.evaluate import sample_curve
from keypose.math import quat
from keypose.model import Curve, CurveKind, Interpolation

TIMES = np.array([0.0, 0.7, 1.1, 2.0])
MODES = {
    CurveKind.VECTOR: (Interpolation.LINEAR, Interpolation.HERMITE, Interpolation.BEZIER),
    CurveKind.EULER: (Interpolation.LINEAR, Interpolation.HERMITE, Interpolation.BEZIER),
    CurveKind.ROTATION: (
        Interpolation.LINEAR,
        Interpolation.HERMITE,
        Interpolation.SQUAD,
        Interpolation.SPHERICAL_BEZIER,
        Interpolation.LOG_CUBIC,
    ),
}
CASES = [(kind, mode) for kind, modes in MODES.items() for mode in modes]


def curve(kind, mode, rng, dtype=np.float64):
    if kind is CurveKind.ROTATION:
        steps = quat.from_rotation_vector(rng.uniform(-0.8, 0.8, size=(4, 3)))
        values = [steps[0]]
        for step in steps[1:]:
            values.append(quat.multiply(values[-1], step))
        values = np.array(values)
        tangents = [quat.multiply(values, np.insert(rng.normal(size=(4, 3)), 0, 0, axis=1)) for _ in "io"]
    else:
        values = rng.normal(size=(4, 3))
        tangents = [rng.normal(size=(4, 3)) for _ in "io"]
    handles = {}
    if mode is Interpolation.BEZIER:
        handles = {
            "in_handles": np.stack([-rng.uniform(0.05, 0.2, values.shape), rng.normal(size=values.shape)], axis=-1),
            "out_handles": np.stack([rng.uniform(0.05, 0.2, values.shape), rng.normal(size=values.shape)], axis=-1),
        }
    sides = {k: v.astype(dtype) for k, v in handles.items()}
    if mode is Interpolation.HERMITE:
        sides |= {"in_tangents": tangents[0].astype(dtype), "out_tangents": tangents[1].astype(dtype)}
    return Curve(TIMES, values.astype(dtype), mode, kind=kind, **sides)


@pytest.mark.parametrize("kind, mode", CASES)
def test_rates_are_one_sided_differences(kind, mode, rng):
    c = curve(kind, mode, rng)
    leaving, coming = rates(c)
    h = 1e-6
    for k in range(3):
        forth = difference(kind, c.values[k], sample_curve(c, TIMES[k] + h)) / h
        back = -difference(kind, c.values[k + 1], sample_curve(c, TIMES[k + 1] - h)) / h
        np.testing.assert_allclose(forth, leaving[k], atol=3e-4 * max(1, np.abs(leaving).max()))
        np.testing.assert_allclose(back, coming[k + 1], atol=3e-4 * max(1, np.abs(coming).max()))
    assert np.all(leaving[-1] == 0) and np.all(coming[0] == 0)


@pytest.mark.parametrize("kind, mode", CASES)
def test_a_difference_leads_where_it_came_from(kind, mode, rng):
    c = curve(kind, mode, rng)
    there = moved(kind, c.values[0], difference(kind, c.values[0], c.values[2]))
    off = quat.angle_between(there, c.values[2]) if kind is CurveKind.ROTATION else np.abs(there - c.values[2]).max()
    assert off < 1e-14


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("kind, mode", CASES)
def test_replacing_a_span_leaves_the_others(kind, mode, dtype, rng):
    if mode in (Interpolation.SQUAD, Interpolation.SPHERICAL_BEZIER, Interpolation.LOG_CUBIC):
        mode = Interpolation.HERMITE  # those look at their neighbours, which are others now
    c = curve(kind, mode, rng, dtype)
    inner = moved(kind, np.asarray(c.values[1], float), 0.3 * difference(kind, *np.asarray(c.values[1:3], float)))
    made = with_spans(c, {1: Span(np.array([0.9]), inner[None], Interpolation.LINEAR)})
    assert made.key_count == 5 and made.values.dtype == dtype and made.times_s[2] == 0.9
    for a, b in ((0.0, 0.7), (1.1, 2.0)):
        at = np.linspace(a, b, 41)
        old, new = sample_curve(c, at).astype(float), sample_curve(made, at).astype(float)
        off = quat.angle_between(old, new).max() if kind is CurveKind.ROTATION else np.abs(old - new).max()
        assert off < (1e-14 if dtype == np.float64 else 1e-6)
    assert with_spans(c, {}) is c


@pytest.mark.parametrize("kind, mode", CASES)
def test_smooth_spans_have_the_rates_they_were_given(kind, mode, rng):
    c = curve(kind, mode, rng)
    wanted = rng.normal(size=(2, 4, 3))
    made = hermite_spans(c, np.array([0, 2]), *wanted)
    leaving, coming = rates(made)
    np.testing.assert_allclose(leaving[[0, 2]], wanted[0][[0, 2]], atol=1e-14)
    np.testing.assert_allclose(coming[[1, 3]], wanted[1][[1, 3]], atol=1e-14)
    assert [int(m) for m in made.modes[:3]] == [Interpolation.HERMITE, mode, Interpolation.HERMITE]
    assert hermite_spans(c, np.array([], int), *wanted) is c
