"""Easings on spans: the easing's values within the error stated, keys and other spans untouched; slow in, slow out; warps."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.editing.ease import ease_spans, ease_warp, slow_in_out
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import sample_curve
from keypose.math import ease, quat
from keypose.model import Curve, CurveKind, Interpolation, Tangent

TIMES = np.array([0.0, 0.5, 2.0, 3.0])
PLACES = Curve(TIMES, np.array([[0.0, 1, 2], [1, 1, 5], [3, -4, 5], [3, 0, 0]]))
TURNS = Curve(
    TIMES,
    np.array([[1.0, 0, 0, 0], *quat.from_axis_angle([[0, 1, 0], [0, 1, 1], [1, 0, 0]], [1.0, -2.8, 0.4])]),
    kind=CurveKind.ROTATION,
)
EXACT = {"linear", "back_in", "back_out", "back_in_out", "smoothstep", "ease", "ease_in", "ease_out", "ease_in_out"} | {
    f"{family}_{end}" for family in ("quad", "cubic", "bounce") for end in ("in", "out", "in_out")
}
MORE = ("steps(4)", "steps(3, jump-none)", "cubic-bezier(0.2, 1.5, 0.8, -0.5)")


@pytest.mark.parametrize("name", [*ease.names(), *MORE])
def test_a_span_goes_by_its_easing(name):
    u = np.linspace(0, 1, 1001)[:-1]
    inside = TIMES[1] + u * (TIMES[2] - TIMES[1])
    eased = ease_spans(PLACES, [1], name)
    expected = PLACES.values[1] + ease.ease(name, u)[:, None] * (PLACES.values[2] - PLACES.values[1])
    off = np.linalg.norm(sample_curve(eased.curve, inside) - expected, axis=-1).max()
    size = np.linalg.norm(PLACES.values[2] - PLACES.values[1])
    assert off <= eased.error * 1.02 + 1e-12
    assert eased.error <= (1e-12 if name in EXACT or name in MORE else 1.1e-3 * size)
    turned = ease_spans(TURNS, [1], name)
    wanted = quat.slerp(TURNS.values[1], TURNS.values[2], ease.ease(name, u))
    angle = quat.angle_between(sample_curve(turned.curve, inside), wanted).max()
    assert angle <= turned.error * 1.02 + 1e-7
    whole = quat.angle_between(TURNS.values[1], TURNS.values[2])
    assert turned.error <= (0.02 if "circ" in name else 1.1e-3) * whole


@pytest.mark.parametrize("name", ["elastic_out", "steps(5)", "ease", "bounce_in", "circ_in_out"])
def test_keys_and_other_spans_stay_bit_for_bit(name):
    for curve in (PLACES, TURNS):
        eased = ease_spans(curve, [1], name).curve
        found = sample_curve(eased, TIMES)
        same = np.all(found == curve.values, axis=-1) | np.all(found == -curve.values, axis=-1)
        assert same.all()
        for a, b in ((0.0, 0.5), (2.0, 3.0)):
            at = np.linspace(a, b, 57)
            sign = 1e-15 if curve is TURNS else 0
            np.testing.assert_allclose(np.abs(sample_curve(eased, at)), np.abs(sample_curve(curve, at)), atol=sign)
    assert ease_spans(PLACES, [], name).curve is PLACES


def test_several_spans_and_a_finer_tolerance():
    all_of_them = ease_spans(PLACES, [0, 1, 2], "sine_in_out", 1e-3)
    fine = ease_spans(PLACES, [0, 1, 2], "sine_in_out", 1e-6)
    assert fine.error < 1e-5 < all_of_them.error < 1e-2
    assert fine.curve.key_count > all_of_them.curve.key_count


def test_float32_stays_float32():
    curve = Curve(TIMES, PLACES.values.astype(np.float32))
    assert ease_spans(curve, [1], "expo_in").curve.values.dtype == np.float32
    assert ease_spans(curve, [1], "ease").curve.out_handles.dtype == np.float32


@pytest.mark.parametrize("curve", [PLACES, TURNS], ids=["places", "turns"])
def test_slow_in_slow_out_stops_at_the_key(curve):
    slow = slow_in_out(curve, [1, 2])
    np.testing.assert_array_equal(slow.times_s, curve.times_s)

    def speed(at):
        a, b = sample_curve(slow, at - 1e-5), sample_curve(slow, at + 1e-5)
        return np.linalg.norm(b - a) / 2e-5

    for key in TIMES[1:3]:
        assert speed(key) < 1e-3 and speed(key - 0.1) > 0.05
    assert Tangent(int(slow.tangent_types[1, 0])) is Tangent.FLAT
    # the ends keep the speed they had, and half an amount halves it
    first = sample_curve(curve, 1e-5) - sample_curve(curve, 0.0)
    np.testing.assert_allclose(sample_curve(slow, 1e-5) - sample_curve(slow, 0.0), first, rtol=1e-4, atol=1e-12)
    half = slow_in_out(PLACES, [1], slow_in=0.5, slow_out=0.0)
    np.testing.assert_allclose(half.in_tangents[1], 0.5 * (PLACES.values[1] - PLACES.values[0]) / 0.5)
    np.testing.assert_allclose(half.out_tangents[1], (PLACES.values[2] - PLACES.values[1]) / 1.5)


def test_slow_in_and_out_of_two_keys_is_the_smoothstep():
    curve = slow_in_out(Curve([0, 2], [[0.0], [10.0]], kind=CurveKind.SCALAR), [0, 1])
    u = np.linspace(0, 1, 21)
    np.testing.assert_allclose(sample_curve(curve, 2 * u)[:, 0], 10 * (3 * u**2 - 2 * u**3), atol=1e-13)
    assert curve.modes[0] == Interpolation.HERMITE


def test_time_warps():
    warp = ease_warp("cubic_in_out", 1.0, 3.0, from_s=10.0, to_s=14.0)
    u = np.linspace(0, 1, 50)
    np.testing.assert_allclose(sample_curve(warp, 1 + 2 * u)[:, 0], 10 + 4 * ease.ease("cubic_in_out", u), atol=1e-12)
    assert warp.kind is CurveKind.SCALAR
    assert sample_curve(ease_warp("linear", 0, 2.5), 2.5)[0] == 2.5


def test_wrong_input_is_named():
    with pytest.raises(UnknownName, match="nearest"):
        ease_spans(PLACES, [0], "sine-inout")
    with pytest.raises(ShapeError, match="spans: expected numbers from 0 to 2, got 3"):
        ease_spans(PLACES, [3], "linear")
    with pytest.raises(ShapeError, match="tolerance"):
        ease_spans(PLACES, [0], "linear", 0.0)
    with pytest.raises(ShapeError, match="slow_in"):
        slow_in_out(PLACES, [0], slow_in=2.0)
    with pytest.raises(ShapeError, match="boolean"):
        ease_spans(Curve([0, 1], [[0.0], [1]], Interpolation.STEP, kind=CurveKind.BOOLEAN), [0], "linear")
