"""Curves: glTF's interpolation, exactness at keys, extrapolation, precision, gradients."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import BPoly, CubicHermiteSpline
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation, Slerp

from keypose.errors import ShapeError
from keypose.evaluate import sample_curve
from keypose.math import quat, rotation_splines
from keypose.model import Curve, CurveKind, Extrapolation, Interpolation
from tests.synthetic import random_rotations

STEP, LINEAR, HERMITE, BEZIER = Interpolation.STEP, Interpolation.LINEAR, Interpolation.HERMITE, Interpolation.BEZIER
TIMES = np.array([0.1, 0.35, 0.4, 1.0, 2.5])
MODES = [STEP, LINEAR, HERMITE]
SPHERE = [Interpolation.SQUAD, Interpolation.SPHERICAL_BEZIER, Interpolation.LOG_CUBIC]
WIDTHS = {
    CurveKind.SCALAR: 1, CurveKind.VECTOR: 3, CurveKind.ROTATION: 4, CurveKind.EULER: 3, CurveKind.COLOR: 4,
    CurveKind.BOOLEAN: 1,
}  # fmt: skip


def modes_of(kind: CurveKind) -> list[Interpolation]:
    """The modes that a kind of curve can have."""
    if kind is CurveKind.BOOLEAN:
        return [STEP]
    return [*MODES, *(SPHERE if kind is CurveKind.ROTATION else [BEZIER])]


def smoothest(kind: CurveKind) -> Interpolation:
    return STEP if kind is CurveKind.BOOLEAN else HERMITE


BOTH = [(kind, mode) for kind in CurveKind for mode in modes_of(kind)]


def make(kind: CurveKind, mode: object, dtype: type = np.float64, times: object = TIMES, **options: object) -> Curve:
    rng = np.random.default_rng(5)
    width, count = WIDTHS[kind], len(times)
    values = random_rotations(rng, count) if kind is CurveKind.ROTATION else rng.normal(size=(count, width))
    if kind is CurveKind.BOOLEAN:
        values = (values > 0).astype(float)
    tangents = rng.normal(size=(2, count, width)).astype(dtype)
    if kind is not CurveKind.ROTATION:
        handles = rng.normal(size=(2, count, width, 2)).astype(dtype)
        handles[..., 0] = np.abs(handles[..., 0]) * [[[-0.3]], [[0.3]]]
        options = {"in_handles": handles[0], "out_handles": handles[1], **options}
    return Curve(times, values.astype(dtype), mode, tangents[0], tangents[1], kind, **options)


def same_rotation(a: object, b: object, atol: float) -> None:
    a, b = np.asarray(a), np.asarray(b)
    assert_allclose(np.where(np.sum(a * b, -1, keepdims=True) < 0, -a, a), b, atol=atol)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("kind", "mode"), BOTH)
def test_at_a_key_the_value_is_the_key_bit_for_bit(kind: CurveKind, mode: Interpolation, dtype: type) -> None:
    curve = make(kind, mode, dtype)
    sampled = sample_curve(curve, TIMES)
    assert sampled.dtype == dtype
    assert_array_equal(sampled, curve.values)


@pytest.mark.parametrize("shape", [(), (1,), (7,), (2, 3), (0,), (2, 0, 4)])
@pytest.mark.parametrize(("kind", "mode"), BOTH)
def test_times_of_any_shape(kind: CurveKind, mode: Interpolation, shape: tuple[int, ...]) -> None:
    curve = make(kind, mode)
    times = np.random.default_rng(1).uniform(-1, 4, shape)
    sampled = sample_curve(curve, times)
    assert sampled.shape == (*shape, curve.values.shape[1])
    for index in np.ndindex(shape):
        assert_allclose(sampled[index], sample_curve(curve, float(times[index])), rtol=0, atol=1e-14)


def test_step_holds_until_the_very_moment_of_the_next_key() -> None:
    curve = make(CurveKind.VECTOR, STEP)
    just_before = np.nextafter(TIMES[1:], -np.inf)
    assert_array_equal(sample_curve(curve, just_before), curve.values[:-1])


def test_linear_is_a_straight_line() -> None:
    curve = make(CurveKind.VECTOR, LINEAR)
    times = np.linspace(0, 3, 301)
    expected = np.stack([np.interp(times, TIMES, column) for column in curve.values.T], axis=-1)
    assert_allclose(sample_curve(curve, times), expected, atol=1e-14)


def test_linear_rotation_is_scipys_slerp() -> None:
    curve = make(CurveKind.ROTATION, LINEAR)
    times = np.linspace(TIMES[0], TIMES[-1], 301)
    expected = Slerp(TIMES, Rotation.from_quat(np.roll(curve.values, -1, axis=1)))(times)
    same_rotation(sample_curve(curve, times), np.roll(expected.as_quat(), 1, axis=1), 1e-14)


def test_linear_rotation_takes_the_short_way_whatever_the_signs() -> None:
    a, b = quat.from_axis_angle(np.array([[0.0, 1, 0]]), np.array([0.2, 1.2]))
    near = sample_curve(Curve([0, 1], np.stack([a, b]), kind=CurveKind.ROTATION), 0.5)
    far = sample_curve(Curve([0, 1], np.stack([a, -b]), kind=CurveKind.ROTATION), 0.5)
    same_rotation(near, quat.from_axis_angle(np.array([0.0, 1, 0]), 0.7), 1e-15)
    same_rotation(far, near, 1e-15)


def test_hermite_is_scipys_and_the_specifications_cubic() -> None:
    curve = make(CurveKind.VECTOR, HERMITE, times=TIMES)
    both = Curve(TIMES, curve.values, HERMITE, curve.out_tangents, curve.out_tangents)
    times = np.linspace(TIMES[0], TIMES[-1], 203)
    assert_allclose(
        sample_curve(both, times), CubicHermiteSpline(TIMES, curve.values, curve.out_tangents)(times), atol=1e-13
    )
    # glTF 2.0, appendix C.5, written out for one time of a span with different in and out tangents.
    t, k = 0.7, 2
    span = TIMES[k + 1] - TIMES[k]
    u = (t - TIMES[k]) / span
    expected = (
        (2 * u**3 - 3 * u**2 + 1) * curve.values[k]
        + span * (u**3 - 2 * u**2 + u) * curve.out_tangents[k]
        + (-2 * u**3 + 3 * u**2) * curve.values[k + 1]
        + span * (u**3 - u**2) * curve.in_tangents[k + 1]
    )
    assert_allclose(sample_curve(curve, t), expected, atol=1e-14)


def test_hermite_rotation_is_the_cubic_normalised() -> None:
    curve = make(CurveKind.ROTATION, HERMITE)
    plain = Curve(TIMES, curve.values, HERMITE, curve.in_tangents, curve.out_tangents)
    times = np.linspace(0.11, 2.4, 97)
    cubic = sample_curve(plain, times)
    assert_allclose(sample_curve(curve, times), cubic / np.linalg.norm(cubic, axis=-1, keepdims=True), atol=1e-14)


@pytest.mark.parametrize("kind", CurveKind)
def test_each_span_has_its_own_mode(kind: CurveKind) -> None:
    possible = modes_of(kind)
    last = smoothest(kind)
    modes = [possible[-1], STEP, last, possible[len(possible) // 2], last]
    mixed = make(kind, modes)
    times = np.linspace(0, 2.6, 509)
    span = np.clip(np.searchsorted(TIMES, times, side="right") - 1, 0, len(TIMES) - 1)
    pure = {mode: sample_curve(make(kind, mode), times) for mode in possible}
    expected = np.stack([pure[modes[s]][i] for i, s in enumerate(span)])
    assert_allclose(sample_curve(mixed, times), expected, atol=1e-15)


def test_the_last_keys_mode_has_no_span_and_needs_no_tangents() -> None:
    curve = Curve([0.0, 1.0], [[0.0], [2.0]], [LINEAR, HERMITE], kind=CurveKind.SCALAR)
    assert_array_equal(sample_curve(curve, [0.5, 1.0, 3.0]), [[1.0], [2.0], [2.0]])


@pytest.mark.parametrize("rule", Extrapolation)
@pytest.mark.parametrize(("kind", "mode"), BOTH)
def test_a_single_key_is_constant(kind: CurveKind, mode: Interpolation, rule: Extrapolation) -> None:
    curve = make(kind, mode, times=np.array([0.5]), before=rule, after=rule)
    assert_array_equal(sample_curve(curve, [-3.0, 0.5, 9.0]), np.repeat(curve.values, 3, axis=0))


def test_very_short_and_very_long_spans_stay_finite_and_between_the_keys() -> None:
    times = np.array([0.0, np.nextafter(0.0, 1.0), 1.0, 1.0 + 1e-15, 1e9])
    curve = Curve(times, [[0.0], [1.0], [2.0], [3.0], [4.0]], kind=CurveKind.SCALAR)
    sampled = sample_curve(curve, np.concatenate([times, np.linspace(0, 1e9, 50)]))
    assert np.all((sampled >= 0) & (sampled <= 4))
    assert_array_equal(sampled[:5], curve.values)


def test_a_constant_curve_is_constant() -> None:
    for kind, value in ((CurveKind.VECTOR, [0.1, -7.3, 1e5]), (CurveKind.ROTATION, [0.5, 0.5, -0.5, 0.5])):
        curve = Curve(TIMES, np.tile(np.float32(value), (5, 1)), LINEAR, kind=kind)
        assert_allclose(sample_curve(curve, np.linspace(0, 3, 100)), np.tile(np.float32(value), (100, 1)), rtol=2e-7)


# --- extrapolation ----------------------------------------------------------------------------------------------------

START, END = TIMES[0], TIMES[-1]
LENGTH = END - START
OUTSIDE = np.concatenate([START - np.linspace(0.001, 7.3, 41), END + np.linspace(0.001, 7.3, 41)])


@pytest.mark.parametrize("kind", CurveKind)
def test_hold(kind: CurveKind) -> None:
    curve = make(kind, smoothest(kind))
    sampled = sample_curve(curve, OUTSIDE)
    assert_array_equal(sampled[:41], np.repeat(curve.values[:1], 41, 0))
    assert_array_equal(sampled[41:], np.repeat(curve.values[-1:], 41, 0))


@pytest.mark.parametrize("mode", [LINEAR, HERMITE])
def test_linear_extrapolation_goes_on_with_the_speed_at_the_ends(mode: Interpolation) -> None:
    curve = make(CurveKind.VECTOR, mode, before=Extrapolation.LINEAR, after=Extrapolation.LINEAR)
    h = 1e-6
    for end, side in ((START, 1), (END, -1)):
        inner = (sample_curve(curve, end + side * h) - sample_curve(curve, end)) / (side * h)
        outer = (sample_curve(curve, end - side * 2.0) - sample_curve(curve, end)) / (-side * 2.0)
        assert_allclose(outer, inner, atol=2e-4)
        third = sample_curve(curve, end - side * np.array([0.0, 1.0, 2.0]))
        assert_allclose(third[2] - third[1], third[1] - third[0], atol=1e-14)


@pytest.mark.parametrize("mode", [LINEAR, HERMITE, *SPHERE])
def test_linear_extrapolation_of_a_rotation_keeps_its_angular_velocity(mode: Interpolation) -> None:
    curve = make(CurveKind.ROTATION, mode, before=Extrapolation.LINEAR, after=Extrapolation.LINEAR)
    h = 1e-5

    def velocity(t: float) -> np.ndarray:
        return quat.to_rotation_vector(quat.difference(sample_curve(curve, t - h), sample_curve(curve, t + h))) / (
            2 * h
        )

    for end, side in ((START, 1), (END, -1)):
        inner = quat.to_rotation_vector(quat.difference(sample_curve(curve, end), sample_curve(curve, end + side * h)))
        assert_allclose(velocity(end - side * 3.0), side * inner / h, atol=2e-3)
        assert_allclose(velocity(end - side * 30.0), velocity(end - side * 3.0), atol=1e-6)


def test_linear_extrapolation_of_a_step_holds() -> None:
    curve = make(CurveKind.VECTOR, STEP, before=Extrapolation.LINEAR, after=Extrapolation.LINEAR)
    assert_array_equal(sample_curve(curve, OUTSIDE), sample_curve(make(CurveKind.VECTOR, STEP), OUTSIDE))


@pytest.mark.parametrize("kind", CurveKind)
def test_cycle_repeats(kind: CurveKind) -> None:
    curve = make(kind, smoothest(kind), before=Extrapolation.CYCLE, after=Extrapolation.CYCLE)
    times = np.linspace(START, END, 37)[1:-1]
    for cycles in (-3, -1, 1, 2, 50):
        assert_allclose(sample_curve(curve, times + cycles * LENGTH), sample_curve(curve, times), atol=1e-12)


def test_cycle_offset_goes_on_where_the_last_cycle_ended() -> None:
    rule = Extrapolation.CYCLE_OFFSET
    curve = make(CurveKind.VECTOR, HERMITE, before=rule, after=rule)
    step = curve.values[-1] - curve.values[0]
    times = np.linspace(START, END, 37)[1:-1]
    for cycles in (-3, -1, 1, 2, 50):
        expected = sample_curve(curve, times) + cycles * step
        assert_allclose(sample_curve(curve, times + cycles * LENGTH), expected, atol=1e-11)
    for seam in START + LENGTH * np.arange(-3, 5):
        left, right = sample_curve(curve, [seam - 1e-9, seam + 1e-9])
        assert_allclose(left, right, atol=1e-7)


def test_cycle_offset_of_rotations_turns_on() -> None:
    rule = Extrapolation.CYCLE_OFFSET
    axis = np.array([0.0, 1.0, 0.0])
    quarter = Curve([0.0, 1.0], quat.from_axis_angle(axis, np.array([0.3, 0.3 + np.pi / 2])), LINEAR,
                    kind=CurveKind.ROTATION, before=rule, after=rule)  # fmt: skip
    times = np.linspace(-9.3, 11.7, 400)
    same_rotation(sample_curve(quarter, times), quat.from_axis_angle(axis, 0.3 + times * np.pi / 2), 1e-12)
    curve = make(CurveKind.ROTATION, HERMITE, before=rule, after=rule)
    for seam in START + LENGTH * np.arange(-3, 5):
        left, right = sample_curve(curve, [seam - 1e-9, seam + 1e-9])
        same_rotation(left, right, 1e-7)


def test_cycle_seams_never_count_a_cycle_too_many() -> None:
    # 0.1 is not a binary fraction: quotient and remainder round differently unless they are taken together.
    curve = Curve([0.0, 0.1], [[0.0], [1.0]], kind=CurveKind.SCALAR,
                  before=Extrapolation.CYCLE_OFFSET, after=Extrapolation.CYCLE_OFFSET)  # fmt: skip
    seams = 0.1 * np.arange(-3000, 3000)
    times = np.concatenate([seams, np.nextafter(seams, -np.inf), np.nextafter(seams, np.inf)])
    assert_allclose(sample_curve(curve, times)[:, 0], times / 0.1, atol=1e-9)


@pytest.mark.parametrize("kind", CurveKind)
def test_ping_pong_mirrors(kind: CurveKind) -> None:
    rule = Extrapolation.PING_PONG
    curve = make(kind, smoothest(kind), before=rule, after=rule)
    ahead = np.linspace(0, 3 * LENGTH, 50)
    assert_allclose(sample_curve(curve, END + ahead), sample_curve(curve, END - ahead), atol=1e-12)
    assert_allclose(sample_curve(curve, START + ahead), sample_curve(curve, START - ahead), atol=1e-12)


def test_before_and_after_are_independent() -> None:
    curve = make(CurveKind.VECTOR, LINEAR, before=Extrapolation.CYCLE, after=Extrapolation.LINEAR)
    cyclic = make(CurveKind.VECTOR, LINEAR, before=Extrapolation.CYCLE, after=Extrapolation.CYCLE)
    straight = make(CurveKind.VECTOR, LINEAR, before=Extrapolation.LINEAR, after=Extrapolation.LINEAR)
    assert_array_equal(sample_curve(curve, OUTSIDE[:41]), sample_curve(cyclic, OUTSIDE[:41]))
    assert_array_equal(sample_curve(curve, OUTSIDE[41:]), sample_curve(straight, OUTSIDE[41:]))


# --- precision, errors, speed -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "mode"), BOTH)
@pytest.mark.parametrize("rule", Extrapolation)
def test_float32_stays_and_agrees(kind: CurveKind, mode: Interpolation, rule: Extrapolation) -> None:
    single = sample_curve(make(kind, mode, np.float32, before=rule, after=rule), OUTSIDE)
    double = sample_curve(make(kind, mode, np.float64, before=rule, after=rule), OUTSIDE)
    assert single.dtype == np.float32
    same_rotation(single, double, 1e-4) if kind is CurveKind.ROTATION else assert_allclose(single, double, atol=1e-4)


def test_late_times_keep_their_resolution_in_float32() -> None:
    # An hour into a take float32 time has a resolution of 0.2 ms; the position in a span must not.
    times = 3600 + np.arange(11) / 100
    curve = Curve(times, np.arange(11, dtype=np.float32)[:, None], kind=CurveKind.SCALAR)
    asked = 3600 + np.linspace(0, 0.1, 57)
    assert_allclose(sample_curve(curve, asked)[:, 0], np.linspace(0, 10, 57), atol=1e-5)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_times_must_be_finite(bad: float) -> None:
    with pytest.raises(ShapeError, match="times_s: expected finite"):
        sample_curve(make(CurveKind.VECTOR, LINEAR), [0.0, bad])


@pytest.mark.parametrize("kind", [CurveKind.VECTOR, CurveKind.ROTATION])
@pytest.mark.parametrize("mode", [[LINEAR] * 5, [HERMITE] * 5, [STEP, LINEAR, HERMITE, LINEAR, STEP]])
@pytest.mark.parametrize("rule", Extrapolation)
def test_torch_agrees_and_gradients_are_those_of_finite_differences(
    kind: CurveKind, mode: list[Interpolation], rule: Extrapolation
) -> None:
    torch = pytest.importorskip("torch")
    plain = make(kind, mode, before=rule, after=rule)
    times = np.array([-0.6, 0.1, 0.2, 0.37, 0.8, 1.9, 2.5, 3.3])

    def sampled(values: object, incoming: object, outgoing: object) -> object:
        return sample_curve(Curve(TIMES, values, mode, incoming, outgoing, kind, rule, rule), times)

    inputs = [
        torch.tensor(np.array(a), requires_grad=True) for a in (plain.values, plain.in_tangents, plain.out_tangents)
    ]
    assert_allclose(sampled(*inputs).detach().numpy(), sample_curve(plain, times), atol=1e-12)
    assert torch.autograd.gradcheck(sampled, inputs, atol=1e-6)


# --- handles and splines on the sphere --------------------------------------------------------------------------------


def test_a_bezier_span_is_the_plane_curve_of_seconds_and_value() -> None:
    """Against SciPy's Bernstein polynomials with the time solved by bisection."""
    curve = make(CurveKind.SCALAR, BEZIER)
    for k in range(4):
        span = TIMES[k + 1] - TIMES[k]
        out, back = curve.out_handles[k, 0], curve.in_handles[k + 1, 0]
        out, back = out * min(1, span / out[0]), back * min(1, span / -back[0])
        x = BPoly(np.array([0, out[0], span + back[0], span])[:, None], [0, 1])
        y0, y1 = curve.values[k, 0], curve.values[k + 1, 0]
        y = BPoly(np.array([y0, y0 + out[1], y1 + back[1], y1])[:, None], [0, 1])
        for share in (0.07, 0.3, 0.62, 0.95):
            u = brentq(lambda u, x=x, at=share * span: float(x(u)) - at, 0, 1, xtol=1e-15)
            assert_allclose(sample_curve(curve, TIMES[k] + share * span)[0], y(u), atol=1e-6)


@pytest.mark.parametrize("rule", Extrapolation)
def test_handles_have_gradients(rule: Extrapolation) -> None:
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(3)
    values = rng.normal(size=(5, 2))
    out = np.stack([np.full((5, 2), 0.02), rng.normal(size=(5, 2))], -1)
    back = np.stack([np.full((5, 2), -0.015), rng.normal(size=(5, 2))], -1)
    times = np.array([-0.6, 0.1, 0.2, 0.37, 0.8, 1.9, 2.5, 3.3])

    def sampled(values: object, back: object, out: object) -> object:
        return sample_curve(
            Curve(TIMES, values, BEZIER, in_handles=back, out_handles=out, before=rule, after=rule), times
        )

    inputs = [torch.tensor(a, requires_grad=True) for a in (values, back, out)]
    assert_allclose(sampled(*inputs).detach().numpy(), sampled(values, back, out), atol=1e-12)
    assert torch.autograd.gradcheck(sampled, inputs, atol=1e-5, eps=1e-7)


def test_linear_extrapolation_goes_on_along_handles() -> None:
    curve = make(CurveKind.VECTOR, BEZIER, before=Extrapolation.LINEAR, after=Extrapolation.LINEAR)
    before, after = curve.out_handles[0], curve.in_handles[-1]
    assert_allclose(sample_curve(curve, START - 2), curve.values[0] - 2 * before[:, 1] / before[:, 0])
    assert_allclose(sample_curve(curve, END + 2), curve.values[-1] + 2 * after[:, 1] / after[:, 0])
    upright = Curve([0.0, 1.0], [[0.0], [3.0]], BEZIER, after=Extrapolation.LINEAR,
                    in_handles=np.array([[[0.0, 1]], [[0, 1]]]), out_handles=np.zeros((2, 1, 2)))  # fmt: skip
    assert_allclose(sample_curve(upright, 2.0), [6.0])  # along the chord


@pytest.mark.parametrize("mode", SPHERE)
def test_splines_on_the_sphere_are_those_of_the_mathematics(mode: Interpolation) -> None:
    curve = make(CurveKind.ROTATION, mode)
    method = mode.name.lower()
    times = np.linspace(-0.2, 3, 211)
    same_rotation(sample_curve(curve, times), rotation_splines.interpolate(curve.values, TIMES, times, method), 1e-12)
    for t in times[::20]:  # a few spans alone are bent by the same neighbours
        same_rotation(sample_curve(curve, t), rotation_splines.interpolate(curve.values, TIMES, t, method), 1e-12)


def test_what_is_on_or_off_comes_back_as_it_was() -> None:
    curve = Curve(
        [0.0, 1.0, 2.0], [[0.0], [1.0], [1.0]], STEP, kind=CurveKind.BOOLEAN, after=Extrapolation.CYCLE_OFFSET
    )
    assert_array_equal(sample_curve(curve, [2.5, 3.5, 4.5])[:, 0], [0, 1, 0])
