"""Follow-through, overlap, arcs and stop motion."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from keypose.editing.arcs import arcs, path_corners
from keypose.editing.follow import follow_through, lag, overlap
from keypose.editing.selection import Selection
from keypose.editing.stopmotion import stop_motion
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import sample_clip, sample_curve, world_rotations_positions
from keypose.math import quat
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation, Pose, Property, Skeleton

NAMES = ("body", "tail1", "tail2", "tail3")
CHAIN = Skeleton(
    NAMES, np.arange(-1, 3), Pose([[0, 1, 0]] + 3 * [[0.3, 0, 0]], np.tile([1.0, 0, 0, 0], (4, 1)), np.ones((4, 3)))
)


def rotation(name):
    return Channel(name, Property.ROTATION)


def turned(angles, times, axis=(0, 1, 0)):
    q = quat.from_axis_angle(np.broadcast_to(np.array(axis, float), (len(times), 3)), np.array(angles))
    return Curve(times, q, kind=CurveKind.ROTATION)


def swing(times=(0.0, 0.4, 2.0), angles=(0.0, 1.0, 1.0)):
    return Clip({rotation("body"): turned(angles, times)}, rate_hz=50)


def test_a_step_is_answered_as_a_damped_spring_answers():
    """The body turns within a hundredth of a second; the tail's way is that of SciPy's solution from rest."""
    frequency, damping = 1.5, 0.25
    clip = Clip({rotation("body"): turned([0, 0.8], [0.0, 0.01])}, rate_hz=200)
    made = follow_through(clip, CHAIN, joints=("tail1",), drag=1.0, frequency_hz=frequency, damping=damping, settle_s=2)
    at = np.arange(0.05, 2.0, 0.01)
    model, _ = world_rotations_positions(CHAIN, sample_clip(made, CHAIN, at))
    found = quat.to_rotation_vector(model[:, 1])[:, 1]
    w = 2 * np.pi * frequency
    exact = solve_ivp(
        lambda t, s: [s[1], -2 * damping * w * s[1] - w * w * (s[0] - min(80.0 * t, 0.8))],
        (0, 2), [0.0, 0.0], t_eval=at, rtol=1e-9, atol=1e-10, max_step=0.005,
    )  # fmt: skip
    np.testing.assert_allclose(found, exact.y[0], atol=0.012)
    assert found.max() > 1.05  # it swings beyond


def test_drag_is_how_much_of_it_is_seen():
    at = np.linspace(0, 2, 200)
    clip = swing()
    none = follow_through(clip, CHAIN, joints=NAMES[1:], drag=0.0)
    assert lag(clip, CHAIN, "tail3", at, none).max() < 1e-7
    half, full = (follow_through(clip, CHAIN, joints=NAMES[1:2], drag=d) for d in (0.5, 1.0))
    whole = lag(clip, CHAIN, "tail1", at, full)
    np.testing.assert_allclose(lag(clip, CHAIN, "tail1", at, half), 0.5 * whole, atol=2e-3)
    stiff = follow_through(clip, CHAIN, joints=NAMES[1:2], drag=1.0, frequency_hz=20, damping=1.0)
    assert lag(clip, CHAIN, "tail1", at, stiff).max() < 0.25 * whole.max()


def test_the_end_of_a_chain_is_latest_and_all_come_to_rest():
    clip = swing()
    made = follow_through(clip, CHAIN, joints=NAMES[1:], settle_s=4.0, damping=0.5)
    at = np.linspace(0, 2, 400)
    model, _ = world_rotations_positions(CHAIN, sample_clip(made, CHAIN, at))
    angle = quat.to_rotation_vector(model)[..., 1]
    half_way = [at[np.argmax(angle[:, j] > 0.5)] for j in range(4)]
    assert half_way == sorted(half_way) and half_way[3] > half_way[1] > half_way[0]
    end, _ = world_rotations_positions(CHAIN, sample_clip(made, CHAIN, 6.0))
    assert quat.angle_between(end, end[:1]).max() < 1e-2
    assert made.curves[rotation("body")] is clip.curves[rotation("body")]
    again = follow_through(clip, CHAIN, joints=NAMES[1:], settle_s=4.0, damping=0.5)
    np.testing.assert_array_equal(again.curves[rotation("tail3")].values, made.curves[rotation("tail3")].values)


@pytest.mark.parametrize("damping", [0.02, 0.999999, 1.0, 1.6])
def test_springs_of_any_damping_are_stable(damping):
    made = follow_through(swing(), CHAIN, joints=NAMES[1:], frequency_hz=20.0, damping=damping, rate_hz=25)
    for name in NAMES[1:]:
        values = made.curves[rotation(name)].values
        np.testing.assert_allclose(np.linalg.norm(values, axis=-1), 1, atol=1e-12)
        assert quat.angle_between(values, quat.identity()).max() < 2.1


def test_overlap_is_the_same_curve_later():
    clip = Clip({rotation(n): turned([0, 1, -1, 0], [0, 0.3, 0.7, 1.0]) for n in NAMES})
    made = overlap(clip, CHAIN, delay_s=0.1)
    at = np.linspace(0.3, 1.0, 50)
    for n, name in enumerate(NAMES):
        found, expected = (
            sample_curve(made.curves[rotation(name)], at),
            sample_curve(clip.curves[rotation(name)], at - 0.1 * n),
        )
        assert quat.angle_between(found, expected).max() < 1e-12
    chosen = overlap(clip, CHAIN, Selection(channels=(rotation("tail1"), rotation("tail3"))), 0.1)
    assert chosen.curves[rotation("tail1")].times_s[0] == 0 and chosen.curves[rotation("tail3")].times_s[0] == 0.1


def test_arcs_take_the_corners_out_of_a_path_and_keep_the_keys():
    keys = [0, 0.4, 1.0, 1.7]
    place = Curve(keys, np.array([[0.0, 1, 0], [1, 1.5, 0], [1.5, 1, 1], [0, 1, 2]]))
    clip = Clip({Channel("body", Property.TRANSLATION): place, rotation("body"): turned([0, 1, -1, 0.5], keys)})
    inner = keys[1:-1]
    assert path_corners(clip, CHAIN, "tail3", inner).min() > 0.5
    for curve in ("squad", "spherical bezier", "log cubic"):
        made = arcs(clip, CHAIN, rotations=curve)
        assert path_corners(made, CHAIN, "tail3", inner).max() < 5e-3
        for channel, old in clip.curves.items():
            np.testing.assert_array_equal(sample_curve(made.curves[channel], keys), old.values)
    half = arcs(clip, CHAIN, Selection(channels=(Channel("body", Property.TRANSLATION),)), 0.5)
    assert half.curves[rotation("body")].modes[0] == Interpolation.SQUAD  # the joints above count, and the joint itself
    body = [path_corners(c, CHAIN, "body", inner).max() for c in (clip, half, arcs(clip, CHAIN))]
    assert body[0] > body[1] > body[2]


def test_a_bow_lifts_the_middle_of_a_move():
    channel = Channel("body", Property.TRANSLATION)
    clip = Clip({channel: Curve([0, 2], [[0.0, 1, 0], [4, 1, 3]])})
    made = arcs(clip, CHAIN, bow=0.2).curves[channel]
    np.testing.assert_allclose(sample_curve(made, 1.0), [2, 1 + 0.2 * 5, 1.5], atol=1e-12)


def test_arcs_leave_holds_and_steps():
    channel = Channel("body", Property.TRANSLATION)
    values = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 1, 0], [3, 0, 0]])
    modes = [1, 1, 1, 0, 0]
    made = arcs(Clip({channel: Curve([0, 1, 2, 3, 4], values, modes)}), CHAIN).curves[channel]
    np.testing.assert_array_equal(sample_curve(made, np.linspace(1, 2, 20)), np.broadcast_to(values[1], (20, 3)))
    np.testing.assert_array_equal(sample_curve(made, 3.9), values[3])


def test_stop_motion_holds_poses():
    clip = swing()
    for hold in (1, 2, 3):
        made = stop_motion(clip, hold_frames=hold, rate_hz=25.0)
        at = np.arange(50) / 25.0
        exposures = np.floor(np.arange(50) / hold) * hold / 25.0
        expected = sample_curve(clip.curves[rotation("body")], exposures)
        found = sample_curve(made.curves[rotation("body")], at + 0.013)
        assert quat.angle_between(found, expected).max() < 1e-12


def test_the_hands_of_stop_motion_are_unsteady_and_seeded():
    clip = Clip({**swing().curves, Channel("body", Property.TRANSLATION): Curve([0, 40], [[0.0, 1, 0], [1, 1, 1]])})
    a, b, c = (stop_motion(clip, jitter_deg=1.0, jitter_m=0.01, hold_frames=1, seed=s) for s in (1, 1, 2))
    for channel in clip.curves:
        np.testing.assert_array_equal(a.curves[channel].values, b.curves[channel].values)
        assert np.any(a.curves[channel].values != c.curves[channel].values)
    moved = a.curves[Channel("body", Property.TRANSLATION)]
    off = moved.values - sample_curve(clip.curves[Channel("body", Property.TRANSLATION)], moved.times_s)
    assert np.sqrt(np.mean(np.sum(off**2, axis=-1))) == pytest.approx(0.01, rel=0.1)
    still = stop_motion(clip)
    exact = sample_curve(clip.curves[rotation("body")], still.curves[rotation("body")].times_s)
    np.testing.assert_array_equal(still.curves[rotation("body")].values, exact)


def test_wrong_input_is_named():
    with pytest.raises(ShapeError, match="drag: expected 0 to 1"):
        follow_through(swing(), CHAIN, joints=("tail1",), drag=2)
    with pytest.raises(UnknownName, match="nearest: 'tail1'"):
        follow_through(swing(), CHAIN, joints=("tial1",))
    with pytest.raises(ShapeError, match="hold_frames"):
        stop_motion(swing(), hold_frames=0)
    with pytest.raises(UnknownName, match="nearest: 'squad'"):
        arcs(swing(), CHAIN, rotations="squat")
    with pytest.raises(ShapeError, match="delay_s"):
        overlap(swing(), CHAIN, delay_s=float("nan"))
