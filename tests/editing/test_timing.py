"""Velocity jumps, lengths and constant speed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from keypose.editing.ease import ease_spans
from keypose.editing.timing import arc_lengths, constant_speed, retimed, velocity_jumps
from keypose.errors import ShapeError
from keypose.evaluate import sample_curve
from keypose.math import quat, spline
from keypose.model import Curve, CurveKind, Interpolation

TIMES = np.array([0.0, 0.4, 1.3, 2.0, 3.0])
TURNS = quat.from_axis_angle(
    [[0, 1, 0], [1, 0, 0], [0, 0.6, 0.8], [0, 0, 1], [0, 1, 0]], np.array([0.2, 1.0, -1.5, 0.8, 2.0])
)


def curve(mode):
    return Curve(TIMES, TURNS, mode, kind=CurveKind.ROTATION)


def measured(c, key, h=1e-6):
    """Change of the angular velocity over a key in degrees per second, by differences."""
    before, at, after = (sample_curve(c, key + s * h) for s in (-1, 0, 1))
    v = [quat.to_rotation_vector(quat.multiply(quat.conjugate(a), b)) / h for a, b in ((before, at), (at, after))]
    return np.degrees(np.linalg.norm(v[1] - v[0]))


def test_slerp_jumps_at_keys_by_what_is_reported():
    jumps = velocity_jumps(curve(Interpolation.LINEAR))
    assert jumps[0] == jumps[-1] == 0 and np.all(jumps[1:-1] > 50)
    for k in (1, 2, 3):
        assert jumps[k] == pytest.approx(measured(curve(Interpolation.LINEAR), TIMES[k]), rel=1e-3)


@pytest.mark.parametrize("mode", [Interpolation.SQUAD, Interpolation.SPHERICAL_BEZIER, Interpolation.LOG_CUBIC])
def test_smooth_rotation_curves_do_not_jump(mode):
    assert velocity_jumps(curve(mode)).max() < 1e-9
    assert max(measured(curve(mode), k) for k in TIMES[1:-1]) < 0.05


def test_jumps_of_mixed_modes_are_those_of_the_curve():
    eased = ease_spans(curve(Interpolation.LINEAR), [1], "quad_in").curve
    jumps = velocity_jumps(eased)
    for k, at in enumerate(eased.times_s[1:-1], 1):
        assert jumps[k] == pytest.approx(measured(eased, at), rel=1e-3, abs=0.2)
    corner = Curve([0, 1, 2], [[0.0, 0, 0], [1, 0, 0], [1, 2, 0]])
    assert velocity_jumps(corner)[1] == pytest.approx(np.sqrt(5))


def test_lengths_are_the_integrals_of_speed():
    p, m = np.array([[0.0, 0, 0], [3, 1, 0]]), np.array([[0.0, 6, 1], [2, -5, 0]])
    smooth = Curve([0.0, 2.0], p, Interpolation.HERMITE, m, m)
    speed = lambda t: np.linalg.norm(spline.hermite_derivative(p[0], m[0], p[1], m[1], t / 2, 2.0))  # noqa: E731
    times, along = arc_lengths(smooth)
    for t, found in list(zip(times, along, strict=True))[::9]:
        assert found == pytest.approx(quad(speed, 0, t, epsabs=1e-12)[0], abs=1e-7)
    turning = Curve([0, 1, 2], quat.from_axis_angle([0.0, 1, 0], [0.0, 2, 3]), kind=CurveKind.ROTATION)
    assert arc_lengths(turning)[1][-1] == pytest.approx(3.0, abs=1e-12)


@pytest.mark.parametrize(
    "mode", [Interpolation.SQUAD, Interpolation.SPHERICAL_BEZIER, Interpolation.LOG_CUBIC, Interpolation.LINEAR]
)
def test_constant_speed_is_constant(mode):
    c = curve(mode)
    found = constant_speed(c, 1e-4)
    at = np.linspace(0, 3, 9001)
    values = sample_curve(c, sample_curve(found.warp, at)[:, 0])
    gone = np.append(0, np.cumsum(quat.angle_between(values[:-1], values[1:])))
    assert found.error <= 1e-4
    np.testing.assert_allclose(gone / gone[-1], at / 3, atol=1.2e-3)  # the steps cut the corners of slerp
    assert found.length == pytest.approx(gone[-1], rel=1e-3)
    made, error = retimed(c, found.warp, 1e-3)
    assert error <= 1e-3 and made.times_s[0] == 0 and made.times_s[-1] == 3
    assert quat.angle_between(sample_curve(made, at), values).max() < 2e-3
    angle = quat.angle_between(made.values[:-1], made.values[1:]) / np.diff(made.times_s)
    assert np.std(angle) / np.mean(angle) < 0.02
    # every key is still passed
    for key in TURNS:
        assert quat.angle_between(sample_curve(made, np.linspace(0, 3, 20001)), key).min() < 2e-3


def test_holds_are_skipped_and_what_stands_keeps_its_time():
    held = Curve([0, 1, 2, 3], [[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [3, 0, 0]])
    found = constant_speed(held)
    at = np.linspace(0, 3, 31)
    np.testing.assert_allclose(sample_curve(held, sample_curve(found.warp, at)[:, 0])[:, 0], at, atol=0.02)
    still = Curve([0, 2], [[1.0], [1.0]], kind=CurveKind.SCALAR)
    np.testing.assert_allclose(sample_curve(constant_speed(still).warp, [0, 1, 2])[:, 0], [0, 1, 2])


def test_wrong_input_is_named():
    with pytest.raises(ShapeError, match="even number"):
        arc_lengths(curve(1), 3)
    with pytest.raises(ShapeError, match="tolerance"):
        constant_speed(curve(1), 0)
    with pytest.raises(ShapeError, match="SCALAR"):
        retimed(curve(1), curve(1))
