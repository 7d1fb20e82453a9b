"""Euler tools: distance to gimbal lock along a clip, best order, other orders of the same motion, the Euler filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from keypose.editing.euler import best_order, filter_euler, gimbal_report, reorder_euler
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import sample_curve
from keypose.math import euler, quat
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation, Property

ARM = Channel("arm", Property.EULER)


def angles_clip(degrees, order="XYZ", times=None, **more):
    values = np.radians(np.asarray(degrees, float))
    curve = Curve(np.arange(len(values)) if times is None else times, values, kind=CurveKind.EULER, **more)
    return Clip({ARM: curve}, rate_hz=25, euler_orders={"arm": order})


def scipys(angles, order):
    return Rotation.from_euler(order, angles)


def test_the_report_names_the_frames_near_the_lock():
    clip = angles_clip([[0, 0, 0], [10, 90, 0], [0, 20, 0]])
    (report,) = gimbal_report(clip, threshold_deg=18)
    assert (report.joint, report.order, report.nearest_frame) == ("arm", "XYZ", 25)
    assert report.nearest_deg == pytest.approx(0, abs=1e-9) and report.nearest_s == 1.0
    degrees = np.interp(np.arange(51) / 25, [0, 1, 2], [0, 90, 20])
    assert report.frames == tuple(np.nonzero(90 - degrees < 18)[0])
    assert report.best_deg > 20 and report.best_order in str(report) and "frame 25" in str(report)


def test_joints_with_quaternions_are_measured_in_the_order_asked_for():
    turn = quat.from_axis_angle([0.0, 1, 0], np.radians([0.0, 80]))
    tip = quat.from_axis_angle([1.0, 0, 0], np.radians([0.0, 80]))
    clip = Clip(
        {Channel(n, Property.ROTATION): Curve([0, 1], q, kind=CurveKind.ROTATION) for n, q in (("a", turn), ("b", tip))}
    )
    nearest = {r.joint: r.nearest_deg for r in gimbal_report(clip, "XYZ")}
    assert nearest["a"] == pytest.approx(10) and nearest["b"] == pytest.approx(90)
    assert next(iter(gimbal_report(clip, "XYZ"))).joint == "a"  # the nearest first
    assert {r.joint: r.nearest_deg for r in gimbal_report(clip, "YXZ")}["b"] == pytest.approx(10)


def test_the_best_order_keeps_furthest_from_the_lock(rng):
    nod = quat.from_axis_angle([0.0, 1, 0], np.linspace(-1.5, 1.5, 50))
    best, distance = best_order(nod)
    assert best[1] != "Y" and distance == pytest.approx(np.pi / 2)
    random = Rotation.random(20, rng).as_quat()[:, [3, 0, 1, 2]]
    best, distance = best_order(random)
    each = {
        o: np.abs(np.abs(Rotation.from_quat(random[:, [1, 2, 3, 0]]).as_euler(o)[:, 1]) - np.pi / 2).min()
        for o in euler.CONVENTIONS[:6]
    }
    assert best == max(each, key=each.get) and distance == pytest.approx(each[best], abs=1e-9)


@pytest.mark.parametrize("order", ["ZXY", "YZX", "XZY", "ZYX"])
def test_another_order_is_the_same_motion_at_every_frame(order):
    clip = angles_clip([[0, 0, 0], [70, -40, 130], [-100, 60, 300], [0, 10, 20]], times=[0, 0.33, 1.0, 2.0])
    made, error = reorder_euler(clip, order)
    assert made.euler_orders["arm"] == order
    at = np.unique(np.append(np.arange(51) / 25, clip.curves[ARM].times_s))
    before = scipys(sample_curve(clip.curves[ARM], at), "XYZ")
    after = scipys(sample_curve(made.curves[ARM], at), order)
    assert (before.inv() * after).magnitude().max() < 1e-12
    between = at[:-1] + 0.5 * np.diff(at)
    off = (
        scipys(sample_curve(clip.curves[ARM], between), "XYZ").inv()
        * scipys(sample_curve(made.curves[ARM], between), order)
    ).magnitude()
    assert off.max() <= error * 1.05 + 1e-12
    assert np.abs(np.diff(made.curves[ARM].values, axis=0)).max() < 2.0  # no flips
    keys_only, worse = reorder_euler(clip, {"arm": order}, every_frame=False)
    assert keys_only.curves[ARM].key_count == 4 and worse > error
    same, none = reorder_euler(clip, "XYZ")
    assert same.curves[ARM] is clip.curves[ARM] and none == 0


def test_the_filter_takes_turns_and_flips_out_and_keeps_rotations():
    smooth = np.radians([[0, 0, 0], [30, 50, 100], [60, 80, 200], [90, 100, 300], [120, 110, 400]])
    wrapped = euler.from_quat(euler.to_quat(smooth, "XYZ"), "XYZ")
    assert np.abs(np.diff(wrapped, axis=0)).max() > np.radians(150)
    clip = angles_clip(np.degrees(wrapped))
    made = filter_euler(clip).curves[ARM]
    np.testing.assert_allclose(made.values, smooth, atol=1e-12)
    kept = scipys(made.values, "XYZ") * scipys(wrapped, "XYZ").inv()
    assert kept.magnitude().max() < 1e-12


def test_tangents_go_with_their_angles():
    """A curve and its twin (a + 180, 180 - b, c + 180) are one motion; filtered against each other so are their tangents."""
    values = np.radians([[0.0, 10, 0], [10.0, 20, 30], [20.0, 15, 10]])
    slopes = np.array([[0.1, 0.4, 0.2], [0.3, -0.2, 0.1], [0.0, 0.3, -0.1]])
    twin, twin_slopes = values.copy(), slopes.copy()
    twin[1:] = np.stack([values[1:, 0] + np.pi, np.pi - values[1:, 1], values[1:, 2] - np.pi], axis=-1)
    twin_slopes[1:, 1] *= -1
    handles = np.stack([np.full((3, 3), 0.2), 0.2 * twin_slopes], axis=-1)
    back = np.stack([np.full((3, 3), -0.2), -0.2 * twin_slopes], axis=-1)
    hermite = Curve([0, 1, 2], twin, Interpolation.HERMITE, twin_slopes, twin_slopes, CurveKind.EULER)
    bezier = Curve([0, 1, 2], twin, Interpolation.BEZIER, kind=CurveKind.EULER, in_handles=back, out_handles=handles)
    for curve in (hermite, bezier):
        made = filter_euler(Clip({ARM: curve})).curves[ARM]
        np.testing.assert_allclose(made.values, values, atol=1e-14)
        if curve is hermite:
            np.testing.assert_allclose(made.out_tangents, slopes)
        else:
            np.testing.assert_allclose(made.out_handles[..., 1], 0.2 * slopes)
            np.testing.assert_allclose(made.out_handles[..., 0], 0.2)


def test_single_angles_are_filtered_together():
    smooth = np.radians([[0, 0, 0], [30, 50, 100], [60, 80, 200], [90, 100, 300]])
    wrapped = euler.from_quat(euler.to_quat(smooth, "XYZ"), "XYZ")
    channels = [Channel("arm", Property.EULER, c) for c in range(3)]
    curves = {c: Curve(np.arange(4), wrapped[:, [n]], kind=CurveKind.SCALAR) for n, c in enumerate(channels)}
    made = filter_euler(Clip(curves))
    for n, channel in enumerate(channels):
        np.testing.assert_allclose(made.curves[channel].values[:, 0], smooth[:, n], atol=1e-12)
    curves[channels[1]] = Curve([0, 1, 2.5, 3], wrapped[:, [1]], kind=CurveKind.SCALAR)
    with pytest.raises(ShapeError, match="join them first"):
        filter_euler(Clip(curves))
    alone = Clip({channels[0]: curves[channels[0]]})
    assert filter_euler(alone).curves[channels[0]] is curves[channels[0]]


def test_wrong_input_is_named():
    clip = angles_clip([[0, 0, 0], [1, 1, 1]])
    with pytest.raises(UnknownName, match="nearest: 'arm'"):
        gimbal_report(clip, joints=["amr"])
    with pytest.raises(UnknownName, match="Euler order"):
        reorder_euler(clip, "XYY")
    with pytest.raises(UnknownName, match="joint with Euler angles"):
        reorder_euler(clip, {"leg": "ZXY"})
    with pytest.raises(ShapeError, match="rate_hz"):
        gimbal_report(clip, rate_hz=0)
