"""Anticipation, overshoot, moving holds and breakdowns: what they add, where, and that everything else stays."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from keypose.editing.moves import anticipate, breakdown, moving_hold, on_moves, overshoot, tween_keys
from keypose.editing.selection import Selection
from keypose.errors import ShapeError
from keypose.evaluate import sample_curve
from keypose.math import quat
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation, Property

AXIS = np.array([0.0, 0.6, 0.8])


def move(times=(0.0, 1.0, 3.0), values=(0.0, 10.0, 10.0), mode=Interpolation.LINEAR):
    return Curve(times, np.array(values)[:, None], mode, kind=CurveKind.SCALAR)


def turn(times=(0.0, 1.0, 3.0), angles=(0.0, 1.2, 1.2)):
    return Curve(times, quat.from_axis_angle(np.broadcast_to(AXIS, (len(times), 3)), angles), kind=CurveKind.ROTATION)


def angles_of(curve, at):
    return quat.to_rotation_vector(sample_curve(curve, at)) @ AXIS


def test_anticipation_goes_back_first():
    curve = anticipate(move(), [0], amount=0.2, lead_s=0.25)
    at = np.linspace(0, 1, 4001)
    found = sample_curve(curve, at)[:, 0]
    assert found.min() == pytest.approx(-2.0, abs=1e-6)
    assert at[np.argmin(found)] == pytest.approx(0.25, abs=1e-3)
    assert found[0] == 0 and found[-1] == 10
    assert abs(found[1]) < 1e-4  # starts from rest
    assert (found[-1] - found[-2]) / (at[-1] - at[-2]) == pytest.approx(10.0, rel=1e-2)  # arrives as it did
    np.testing.assert_array_equal(sample_curve(curve, [1.5, 3.0]), 10)
    # never longer than four tenths of the move
    assert anticipate(move(), [0], lead_s=5.0).times_s[1] == pytest.approx(0.4)


def test_anticipation_of_a_rotation_is_that_of_its_angle():
    at = np.linspace(0, 1, 101)
    found = angles_of(anticipate(turn(), [0], 0.2, 0.25), at)
    expected = sample_curve(anticipate(move(values=(0.0, 1.2, 1.2)), [0], 0.2, 0.25), at)[:, 0]
    np.testing.assert_allclose(found, expected, atol=0.012)  # a cubic of quaternions, not of the angle
    assert found.min() == pytest.approx(-0.24, abs=1e-3)


def test_overshoot_is_the_damped_spring():
    """Against the differential equation, solved by SciPy from the speed of the arrival."""
    frequency, damping = 2.0, 0.3
    curve = overshoot(move(times=(0.0, 1.0, 6.0)), [0], 0.15, frequency, damping)
    at = np.linspace(1.0, 2.5, 3001)
    found = sample_curve(curve, at)[:, 0] - 10
    assert found.max() == pytest.approx(1.5, rel=1e-3)
    speed = (found[1] - found[0]) / (at[1] - at[0])
    before = (sample_curve(curve, 1.0) - sample_curve(curve, 1.0 - 1e-6))[0] / 1e-6
    assert before == pytest.approx(speed, rel=1e-2)  # no jump at the arrival
    natural = 2 * np.pi * frequency
    exact = solve_ivp(
        lambda _, s: [s[1], -2 * damping * natural * s[1] - natural**2 * s[0]],
        (1.0, 2.5), [0.0, before], t_eval=at, rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    np.testing.assert_allclose(found, exact.y[0], atol=0.03 * 1.5)
    assert np.all(sample_curve(curve, [0.0, 1.0, 6.0])[:, 0] == [0, 10, 10])
    rest = sample_curve(curve, np.linspace(3.5, 6, 50))[:, 0]
    np.testing.assert_allclose(rest, 10, atol=1e-12)


def test_overshoot_at_the_end_adds_time_and_rests():
    curve = overshoot(move(times=(0.0, 1.0), values=(0.0, -4.0)), [0], 0.1, 3.0, 0.4)
    assert curve.times_s[-1] > 1.5
    assert sample_curve(curve, curve.times_s[-1] + 5)[0] == -4
    assert sample_curve(curve, np.linspace(1, 2, 999)).min() == pytest.approx(-4.4, abs=1e-3)


def test_overshoot_of_a_rotation():
    curve = overshoot(turn(), [0], 0.15)
    found = angles_of(curve, np.linspace(1, 3, 999))
    assert found.max() == pytest.approx(1.2 * 1.15, abs=2e-3)
    assert found[-1] == pytest.approx(1.2, abs=1e-12)


def test_overshoot_needs_a_hold_with_room():
    no_hold = move(values=(0.0, 10.0, 3.0))
    assert overshoot(no_hold, [0]) is no_hold
    short = move(times=(0.0, 1.0, 1.1))
    assert overshoot(short, [0]) is short
    tight = overshoot(move(times=(0.0, 1.0, 1.5)), [0])
    assert tight.times_s[-1] == 1.5 and np.all(np.diff(tight.times_s) > 0)


def test_a_moving_hold_drifts_on_in_the_direction_of_the_move():
    curve = moving_hold(move(), [1], 0.05)
    at = np.linspace(1, 3, 200)
    found = sample_curve(curve, at)[:, 0]
    assert found[-1] == pytest.approx(10.5) and found[0] == 10
    steps = np.diff(found)
    assert np.all(steps > 0) and np.all(np.diff(steps) < 1e-12)  # ever slower
    angles = angles_of(moving_hold(turn(), [1], 0.05), at)
    assert angles[-1] == pytest.approx(1.26)
    moves_only = move()
    np.testing.assert_array_equal(moving_hold(moves_only, [0]).values, moves_only.values)


@pytest.mark.parametrize("favour", [-0.2, 0.0, 0.3, 0.5, 1.0, 1.2])
@pytest.mark.parametrize("mode", [Interpolation.LINEAR, Interpolation.HERMITE])
def test_a_breakdown_lies_between_its_neighbours(favour, mode):
    zeros = np.zeros((3, 1))
    curve = Curve([0, 1, 3], [[0.0], [10], [10]], mode, zeros, zeros, CurveKind.SCALAR)
    made = breakdown(curve, 0.4, favour)
    assert made.key_count == 4 and sample_curve(made, 0.4)[0] == pytest.approx(10 * favour, abs=1e-12)
    np.testing.assert_array_equal(sample_curve(made, [0, 1, 2, 3]), sample_curve(curve, [0, 1, 2, 3]))
    again = breakdown(made, 0.4, 0.5)  # a key that is there gets the new value
    assert again.key_count == 4 and sample_curve(again, 0.4)[0] == pytest.approx(5)
    turned = breakdown(turn(), 0.4, favour)
    assert angles_of(turned, 0.4) == pytest.approx(1.2 * favour, abs=1e-12)
    for nowhere in (-1.0, 0.0, 3.0, 5.0):
        assert breakdown(curve, nowhere, 0.5) is curve


def test_tweened_keys_go_between_the_ones_that_stay():
    channel = Channel("hand", Property.TRANSLATION)
    curve = Curve([0, 1, 2, 3], np.array([[0.0, 0, 0], [5, 5, 5], [6, 6, 6], [8, 0, 4]]))
    made = tween_keys(Clip({channel: curve}), Selection(keys={channel: (1, 2)}), 0.25).curves[channel]
    np.testing.assert_allclose(made.values[1:3], [[2, 0, 1], [2, 0, 1]])
    np.testing.assert_array_equal(made.values[[0, 3]], curve.values[[0, 3]])


def test_only_chosen_channels_and_times_are_changed():
    a, b = Channel("a", Property.WEIGHT), Channel("b", Property.WEIGHT)
    clip = Clip({a: move((0, 1, 2, 3), (0, 1, 0, 1)), b: move()})
    made = on_moves(clip, Selection(channels=(a,), start_s=0.9, end_s=2.0), anticipate)
    assert made.curves[b] is clip.curves[b]
    assert list(made.curves[a].times_s) == pytest.approx([0, 1, 1.2, 2, 3])


def test_wrong_numbers_are_named():
    for wrong in (lambda: anticipate(move(), [0], -1), lambda: anticipate(move(), [0], lead_s=0),
                  lambda: overshoot(move(), [0], -0.1), lambda: overshoot(move(), [0], frequency_hz=0),
                  lambda: overshoot(move(), [0], damping=1.5), lambda: moving_hold(move(), [1], -1),
                  lambda: anticipate(move(), [7])):  # fmt: skip
        with pytest.raises(ShapeError, match="expected"):
            wrong()
