"""Operations on keys: nothing moves that was not asked to, collisions, mirrors, and types that follow."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import butter, filtfilt

from keypose.editing import channels, filters, keys, modes, tangents
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import sample_clip, sample_curve
from keypose.math import quat
from keypose.model import Channel, Clip, Curve, CurveKind, Extrapolation, Interpolation, Property, Tangent
from tests.evaluate.test_evaluate_curves import BEZIER, BOTH, HERMITE, LINEAR, SPHERE, STEP, TIMES, make, same_rotation
from tests.synthetic import random_skeleton

MANY = np.linspace(-1, 4, 2001)
NUMBERS = [(kind, mode) for kind, mode in BOTH if kind is not CurveKind.ROTATION]


def same_curve(a: Curve, b: Curve, atol: float, times: np.ndarray = MANY) -> None:
    """Equal at many times; a time beside a jump falls on the same side of both."""
    assert_allclose(sample_curve(a, times), sample_curve(b, times), rtol=0, atol=atol)


def soft(kind: CurveKind = CurveKind.VECTOR, **options: object) -> Curve:
    """A Bezier curve whose handles do not overlap, each side of another type."""
    rng = np.random.default_rng(7)
    spans = np.diff(TIMES)
    width = {CurveKind.VECTOR: 3, CurveKind.SCALAR: 1}[kind]
    out = np.stack([rng.uniform(0.05, 0.5, (5, width)) * np.append(spans, 1)[:, None], rng.normal(size=(5, width))], -1)
    back = np.stack(
        [-rng.uniform(0.05, 0.5, (5, width)) * np.insert(spans, 0, 1)[:, None], rng.normal(size=(5, width))], -1
    )
    return Curve(TIMES, rng.normal(size=(5, width)), BEZIER, kind=kind, in_handles=back, out_handles=out, **options)


# --- insert -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "mode"), NUMBERS)
def test_an_inserted_key_changes_nothing(kind: CurveKind, mode: Interpolation) -> None:
    curve = make(kind, mode)
    found = keys.insert_keys(curve, [0.2, 0.36, 0.7, 0.71, 1.9])
    assert found.error == 0
    assert_allclose(found.curve.times_s[found.keys], [0.2, 0.36, 0.7, 0.71, 1.9])
    # where a Bezier curve of these long handles stands upright, rounding of the time is seen in the value
    times = MANY
    if mode is BEZIER:
        slope = np.abs(np.gradient(sample_curve(curve, MANY), MANY, axis=0)).max(axis=1)
        times = MANY[slope < 1e2]
        assert len(times) > 0.9 * len(MANY)
    same_curve(found.curve, curve, 1e-10, times)


def test_a_bezier_span_splits_exactly_and_needs_no_other_key() -> None:
    curve = soft()
    found = keys.insert_keys(curve, [0.8])
    assert found.curve.key_count == 6
    same_curve(found.curve, curve, 1e-12)


def test_overlapping_handles_get_a_key_in_the_middle() -> None:
    long = np.array([[[3.0, 1.0]], [[3.0, 0.5]]])
    curve = Curve([0.0, 1.0], [[0.0], [1.0]], BEZIER, kind=CurveKind.SCALAR, in_handles=-long, out_handles=long)
    found = keys.insert_keys(curve, [0.8])
    assert_allclose(found.curve.times_s, [0, 0.5, 0.8, 1])
    times = np.concatenate([np.linspace(0, 0.49, 100), np.linspace(0.51, 1, 100)])  # it stands upright at 0.5
    same_curve(found.curve, curve, 1e-9, times)


def test_rotations_are_exact_where_they_can_be_and_else_say_how_far_they_are_off() -> None:
    line = make(CurveKind.ROTATION, LINEAR)
    found = keys.insert_keys(line, [0.2, 0.7, 2.0])
    assert found.error == 0
    same_rotation(sample_curve(found.curve, MANY), sample_curve(line, MANY), 1e-12)
    inner = np.random.default_rng(1).uniform(0.1, 2.5, 4000)
    for mode in (HERMITE, *SPHERE):
        curve = make(CurveKind.ROTATION, mode)
        found = keys.insert_keys(curve, [0.7])
        off = quat.angle_between(sample_curve(found.curve, inner), sample_curve(curve, inner)).max()
        assert 1e-6 < found.error <= np.pi
        assert off <= found.error * 1.2
        same_rotation(sample_curve(found.curve, 0.7), sample_curve(curve, 0.7), 1e-12)


def test_there_is_one_key_at_one_time() -> None:
    curve = soft()
    assert keys.insert_keys(curve, [TIMES[1], TIMES[3] + 1e-6]).curve is curve
    twice = keys.insert_keys(curve, [0.7, 0.700001])
    assert twice.curve.key_count == 6
    assert_array_equal(twice.keys, [3])
    with pytest.raises(ShapeError, match="times_s: expected finite"):
        keys.insert_keys(curve, [np.nan])


def test_beyond_the_ends_a_key_takes_what_extrapolation_gives() -> None:
    curve = make(CurveKind.VECTOR, LINEAR, after=Extrapolation.LINEAR)
    found = keys.insert_keys(curve, [4.0])
    assert_allclose(found.curve.values[-1], sample_curve(curve, 4.0))
    same_curve(found.curve, curve, 1e-12)


def test_sides_that_followed_stay_as_they_are() -> None:
    types = np.full((5, 2), Tangent.AUTO)
    curve = tangents.update_tangents(soft(tangent_types=types))
    found = keys.insert_keys(curve, [0.8]).curve
    same_curve(found, curve, 1e-12)
    assert_array_equal(found.tangent_types[:, 0], [3, 3, 3, 1, 1, 3])
    assert_array_equal(found.tangent_types[:, 1], [3, 3, 1, 1, 3, 3])


# --- delete, move, scale ----------------------------------------------------------------------------------------------


def test_deleted_keys_are_gone_and_none_may_be_left() -> None:
    curve = make(CurveKind.VECTOR, [STEP, LINEAR, HERMITE, LINEAR, STEP])
    left = keys.delete_keys(curve, [1, 3])
    assert_array_equal(left.times_s, TIMES[[0, 2, 4]])
    assert_array_equal(left.values, curve.values[[0, 2, 4]])
    assert_array_equal(left.out_tangents, curve.out_tangents[[0, 2, 4]])
    assert keys.delete_keys(curve, range(5)) is None
    with pytest.raises(ShapeError, match="keys: expected indices from 0 to 4, got 5"):
        keys.delete_keys(curve, [2, 5])


@pytest.mark.parametrize(("kind", "mode"), BOTH)
def test_a_whole_curve_moved_in_time_is_the_same_curve_later(kind: CurveKind, mode: Interpolation) -> None:
    curve = make(kind, mode)
    moved = keys.move_keys(curve, range(5), 0.75).curve
    inner = MANY[np.min(np.abs(MANY[:, None] - TIMES), axis=1) > 1e-6]
    assert_allclose(
        sample_curve(moved, inner + 0.75), sample_curve(curve, inner), atol=1e-9 if mode is not BEZIER else 1e-4
    )


@pytest.mark.parametrize("mode", [LINEAR, HERMITE])
def test_scaling_in_value_scales_the_curve(mode: Interpolation) -> None:
    curve = make(CurveKind.VECTOR, mode)
    scaled = keys.scale_keys(curve, range(5), value=-2.5, about_value=[1.0, 2.0, 3.0]).curve
    expected = np.array([1.0, 2, 3]) + -2.5 * (sample_curve(curve, MANY) - [1.0, 2, 3])
    assert_allclose(sample_curve(scaled, MANY), expected, atol=1e-12)
    part = keys.move_keys(curve, range(5), value=[1.0, 5.0, 9.0], components=[1]).curve
    assert_allclose(sample_curve(part, MANY), sample_curve(curve, MANY) + np.array([0.0, 5, 0]), atol=1e-12)


@pytest.mark.parametrize(("kind", "mode"), [(k, m) for k, m in BOTH if m is not STEP])
def test_backwards_is_backwards(kind: CurveKind, mode: Interpolation) -> None:
    curve = make(kind, mode, before=Extrapolation.CYCLE)
    found = keys.reverse_keys(curve)
    turned = found.curve
    middle = TIMES[0] + TIMES[-1]
    times = np.linspace(TIMES[0] + 1e-3, TIMES[-1] - 1e-3, 777)
    there, expected = sample_curve(turned, middle - times), sample_curve(curve, times)
    if mode is SPHERE[2]:
        assert 0 < quat.angle_between(there, expected).max() <= 1.2 * found.error
    elif kind is CurveKind.ROTATION:
        same_rotation(there, expected, 1e-9)
    else:
        slow = np.abs(np.gradient(expected, times, axis=0)).max(axis=1) < 1e2
        assert_allclose(there[slow], expected[slow], atol=1e-8)
    assert turned.after is Extrapolation.CYCLE
    assert_allclose(keys.reverse_keys(turned).curve.times_s, TIMES)
    assert_array_equal(keys.reverse_keys(turned).curve.values, curve.values)


def test_keys_that_are_landed_on_give_way() -> None:
    curve = Curve([0.0, 1, 2, 3], [[0.0], [1], [2], [3]], kind=CurveKind.SCALAR)
    found = keys.move_keys(curve, [0, 1], 2.0)
    assert_array_equal(found.curve.times_s, [2, 3])
    assert_array_equal(found.curve.values[:, 0], [0, 1])
    assert_array_equal(found.keys, [0, 1])
    past = keys.move_keys(curve, [1], 1.5)
    assert_array_equal(past.curve.times_s, [0, 2, 2.5, 3])
    assert_array_equal(past.curve.values[:, 0], [0, 2, 1, 3])
    assert_array_equal(past.keys, [2])
    flat = keys.scale_keys(curve, [0, 1, 2], time=0.0, about_s=0.5)
    assert_array_equal(flat.curve.times_s, [0.5, 3])
    assert_array_equal(flat.curve.values[:, 0], [2, 3])


def test_rotations_and_switches_have_no_values_to_scale() -> None:
    for kind, mode in ((CurveKind.ROTATION, LINEAR), (CurveKind.BOOLEAN, STEP)):
        with pytest.raises(ShapeError, match=f"a {kind.value} curve has no values"):
            keys.move_keys(make(kind, mode), [0], value=1.0)
    curve = make(CurveKind.ROTATION, HERMITE)
    by = quat.from_axis_angle(np.array([0.0, 0, 1]), 0.4)
    turned = keys.turn_keys(curve, range(5), by)
    same_rotation(sample_curve(turned, MANY), quat.multiply(by, sample_curve(curve, MANY)), 1e-12)


def test_copies_land_where_they_are_put() -> None:
    curve = soft()
    copy = keys.pick_keys(curve, [1, 2, 3])
    found = keys.paste_keys(curve, copy, 5.0)
    assert_allclose(found.curve.times_s[found.keys], 5 + TIMES[1:4] - TIMES[1])
    inner = np.linspace(TIMES[1] + 1e-3, TIMES[3] - 1e-3, 50)
    assert_allclose(sample_curve(found.curve, inner + 5 - TIMES[1]), sample_curve(curve, inner), atol=1e-9)
    back = keys.paste_keys(curve, copy, 5.0, mirrored=True)
    assert_allclose(sample_curve(back.curve, 5 + TIMES[3] - inner), sample_curve(curve, inner), atol=1e-9)
    on = keys.paste_keys(curve, copy, 0.5, offset=True, overwrite=True)
    assert_allclose(sample_curve(on.curve, 0.5), sample_curve(curve, 0.5), atol=1e-12)
    assert not np.any((on.curve.times_s > 0.5 + TIMES[3] - TIMES[1] + 1e-4) & (on.curve.times_s < 1.1))
    alone = keys.paste_keys(None, copy, -1.0)
    assert_allclose(alone.curve.times_s, TIMES[1:4] - TIMES[1] - 1)
    with pytest.raises(ShapeError, match="copied: expected 3 components of the kind VECTOR, got 1 of SCALAR"):
        keys.paste_keys(curve, make(CurveKind.SCALAR, LINEAR), 0)


# --- tangents ---------------------------------------------------------------------------------------------------------


def test_sides_follow_their_types() -> None:
    values = np.array([[0.0], [1.0], [1.5], [1.0], [4.0]])
    times = np.array([0.0, 1.0, 3.0, 4.0, 4.5])
    bare = tangents.with_handles(Curve(times, values, LINEAR, kind=CurveKind.SCALAR))
    chords = np.diff(values[:, 0]) / np.diff(times)
    centre = (values[2:, 0] - values[:-2, 0]) / (times[2:] - times[:-2])

    def slopes(type: Tangent) -> tuple[np.ndarray, np.ndarray]:
        made = tangents.update_tangents(Curve(times, values, BEZIER, kind=CurveKind.SCALAR, in_handles=bare.in_handles,
            out_handles=bare.out_handles, tangent_types=np.full((5, 2), type)))  # fmt: skip
        assert_allclose(made.out_handles[:-1, 0, 0], np.diff(times) / 3)
        assert_allclose(-made.in_handles[1:, 0, 0], np.diff(times) / 3)
        return tuple(h[:, 0, 1] / h[:, 0, 0] for h in (made.in_handles, made.out_handles))

    assert_allclose(slopes(Tangent.FLAT), 0)
    before, after = slopes(Tangent.VECTOR)
    assert_allclose(before[1:], chords)
    assert_allclose(after[:-1], chords)
    for side in slopes(Tangent.AUTO):
        assert_allclose(side, [chords[0], *centre, chords[-1]])
    for side in slopes(Tangent.CLAMPED):
        assert_allclose(side, [0, min(centre[0], 3 * chords[1]), 0, 0, 0])


def test_clamped_curves_stay_between_their_keys() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        times = np.cumsum(rng.uniform(0.01, 1, 12))
        curve = Curve(times, rng.normal(size=(12, 2)), LINEAR)
        made = modes.set_tangent_types(curve, range(12), Tangent.CLAMPED)
        assert set(made.modes[:-1]) == {BEZIER}
        u = np.linspace(0, 1, 50)[:, None]
        found = sample_curve(made, times[:-1] + u * np.diff(times))
        low, high = np.minimum(curve.values[:-1], curve.values[1:]), np.maximum(curve.values[:-1], curve.values[1:])
        assert np.all(found >= low - 1e-12)
        assert np.all(found <= high + 1e-12)


def test_only_some_keys_and_only_following_sides_change() -> None:
    types = np.array([[0, 0], [3, 0], [3, 3], [1, 3], [0, 0]])
    curve = soft(tangent_types=types)
    made = tangents.update_tangents(curve, [1, 3])
    changed = (
        np.any(made.in_handles != curve.in_handles, axis=(1, 2)),
        np.any(made.out_handles != curve.out_handles, axis=(1, 2)),
    )
    assert_array_equal(changed, [[False, True, False, False, False], [False, False, False, True, False]])


# --- modes ------------------------------------------------------------------------------------------------------------


def test_hermite_to_bezier_and_back_is_exact() -> None:
    curve = make(CurveKind.VECTOR, HERMITE)
    plain = Curve(curve.times_s, curve.values, HERMITE, curve.in_tangents, curve.out_tangents)
    bezier = modes.set_interpolation(plain, range(5), BEZIER)
    assert bezier.error == 0
    same_curve(bezier.curve, plain, 1e-12)
    back = modes.set_interpolation(bezier.curve, range(5), HERMITE)
    assert back.error < 1e-12
    assert_allclose(back.curve.out_tangents[:-1], plain.out_tangents[:-1], atol=1e-12)


def test_what_is_not_exact_says_how_far_it_is_off() -> None:
    curve = soft()
    found = modes.set_interpolation(curve, [2, 3], HERMITE)
    off = np.abs(sample_curve(found.curve, MANY) - sample_curve(curve, MANY)).max()
    assert 0.9 * off <= found.error <= off * 1.1
    assert found.error > 1e-3
    assert_array_equal(found.curve.modes, [3, 3, 2, 2, 3])


def test_lines_become_soft_and_kinds_refuse_what_they_cannot() -> None:
    line = make(CurveKind.SCALAR, LINEAR)
    bare = Curve(line.times_s, line.values, LINEAR, kind=CurveKind.SCALAR)
    made = modes.set_interpolation(bare, [1], BEZIER).curve
    assert_array_equal(made.tangent_types, [[0, 0], [0, 4], [4, 0], [0, 0], [0, 0]])
    turn = modes.set_tangent_types(make(CurveKind.ROTATION, LINEAR), [1, 2], Tangent.AUTO)
    assert_array_equal(turn.modes, [2, 2, 2, 1, 1])
    with pytest.raises(ShapeError, match="mode: a rotation curve cannot have BEZIER"):
        modes.set_interpolation(make(CurveKind.ROTATION, LINEAR), [0], BEZIER)
    with pytest.raises(ShapeError, match="a boolean curve has no tangents"):
        modes.set_tangent_types(make(CurveKind.BOOLEAN, STEP), [0], Tangent.FLAT)


def test_aligned_sides_are_one_line() -> None:
    made = modes.set_tangent_types(soft(), [1, 2], Tangent.ALIGNED)
    for k in (1, 2):
        assert_allclose(
            made.in_handles[k, :, 1] / made.in_handles[k, :, 0], made.out_handles[k, :, 1] / made.out_handles[k, :, 0]
        )
    assert_array_equal(made.in_handles[3], soft().in_handles[3])


def test_resampling_keeps_the_ends_and_says_how_far_it_is_off() -> None:
    curve = soft()
    found = modes.resample_keys(curve, 25.0)
    assert found.curve.times_s[0] == TIMES[0]
    assert found.curve.times_s[-1] == TIMES[-1]
    assert_allclose(found.curve.times_s[1:-1] * 25, np.rint(found.curve.times_s[1:-1] * 25), atol=1e-9)
    assert_allclose(found.curve.values, sample_curve(curve, found.curve.times_s))
    times = np.linspace(TIMES[0], TIMES[-1], 4001)
    off = np.abs(sample_curve(found.curve, times) - sample_curve(curve, times)).max()
    assert_allclose(found.error, off, rtol=0.1)
    part = modes.resample_keys(curve, 25.0, 0.4, 1.0).curve
    assert set(TIMES[:2]) | {2.5} <= set(part.times_s)
    turned = make(CurveKind.ROTATION, SPHERE[0])
    dense = modes.resample_keys(turned, 400.0)
    assert dense.error < 1e-2
    with pytest.raises(ShapeError, match="rate_hz: expected more than 0, got 0"):
        modes.resample_keys(curve, 0)


# --- smoothing --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["gaussian", "butterworth"])
def test_straight_movement_stays_and_noise_goes(method: str) -> None:
    rng = np.random.default_rng(4)
    times = np.cumsum(rng.uniform(0.02, 0.06, 200))
    line = np.stack([times * 2 - 1, 3 - times], axis=-1)
    smooth = filters.smooth_keys(Curve(times, line), 0.15, method=method)
    assert_allclose(smooth.values, line, atol=2e-3)
    noisy = line + rng.normal(size=line.shape) * 0.1
    calm = filters.smooth_keys(Curve(times, noisy), 0.15, method=method).values
    assert np.std(calm[10:-10] - line[10:-10]) < 0.5 * np.std(noisy - line)
    assert_array_equal(calm[[0, -1]], noisy[[0, -1]])


def test_butterworth_is_scipys_on_even_keys() -> None:
    times = np.arange(400) / 50
    values = np.random.default_rng(0).normal(size=(400, 2)).cumsum(axis=0)
    found = filters.smooth_keys(Curve(times, values), 0.25, method="butterworth", keep_ends=False).values
    b, a = butter(2, (0.5 / 0.25) / 25)
    expected = filtfilt(b, a, values, axis=0, padtype="odd", padlen=75)
    assert_allclose(found[50:-50], expected[50:-50], atol=2e-3)
    wave = Curve(times, np.sin(2 * np.pi * times / 0.5)[:, None], kind=CurveKind.SCALAR)
    left = filters.smooth_keys(wave, 0.25, method="butterworth").values[100:-100, 0]
    assert_allclose(np.abs(left).max(), 0.5, atol=0.01)


def test_rotations_are_smoothed_whatever_their_signs() -> None:
    rng = np.random.default_rng(6)
    times = np.arange(100) / 30
    clean = quat.from_axis_angle(np.array([0.0, 1, 0]), times)
    noisy = quat.multiply(clean, quat.from_rotation_vector(rng.normal(size=(100, 3)) * 0.05))
    noisy = noisy * rng.choice([-1.0, 1.0], (100, 1))
    calm = filters.smooth_keys(Curve(times, noisy, kind=CurveKind.ROTATION), 0.1).values
    assert quat.angle_between(calm, clean)[5:-5].mean() < 0.6 * quat.angle_between(noisy, clean).mean()
    assert_allclose(np.linalg.norm(calm, axis=-1), 1)


def test_smoothing_refuses_nonsense_and_can_be_partial() -> None:
    curve = soft()
    half = filters.smooth_keys(curve, 0.5, [2], amount=0.5)
    whole = filters.smooth_keys(curve, 0.5, [2])
    assert_allclose(half.values[2], (curve.values[2] + whole.values[2]) / 2)
    assert_array_equal(np.delete(half.values, 2, 0), np.delete(curve.values, 2, 0))
    with pytest.raises(ShapeError, match="width_s: expected more than 0"):
        filters.smooth_keys(curve, 0)
    with pytest.raises(UnknownName, match="no filter 'gauss'; nearest: 'gaussian'"):
        filters.smooth_keys(curve, 1, method="gauss")


# --- channels ---------------------------------------------------------------------------------------------------------


def test_taken_apart_and_put_together_nothing_moves() -> None:
    skeleton = random_skeleton(np.random.default_rng(1), 3)
    for curve in (soft(), make(CurveKind.VECTOR, [STEP, LINEAR, HERMITE, LINEAR, STEP])):
        clip = Clip({Channel("joint1", Property.TRANSLATION): curve})
        apart = channels.separate_components(clip, "joint1", Property.TRANSLATION)
        assert [c.component for c in apart.curves] == [0, 1, 2]
        before = sample_clip(clip, skeleton, MANY).translations
        assert_array_equal(sample_clip(apart, skeleton, MANY).translations, before)
        joined, error = channels.join_components(apart, skeleton, "joint1", Property.TRANSLATION)
        assert error == 0
        assert_allclose(sample_clip(joined, skeleton, MANY).translations, before, atol=1e-12)
        assert_allclose(joined.curve("joint1", Property.TRANSLATION).times_s, TIMES)


def test_curves_with_keys_of_their_own_are_joined_exactly() -> None:
    skeleton = random_skeleton(np.random.default_rng(1), 3)
    a, b = soft(CurveKind.SCALAR), make(CurveKind.SCALAR, HERMITE, times=np.array([0.1, 0.8, 1.3, 2.5]))
    clip = Clip({Channel("joint1", Property.TRANSLATION, 0): a, Channel("joint1", Property.TRANSLATION, 2): b})
    joined, error = channels.join_components(clip, skeleton, "joint1", Property.TRANSLATION)
    assert error == 0
    assert_allclose(
        sample_clip(joined, skeleton, MANY).translations, sample_clip(clip, skeleton, MANY).translations, atol=1e-9
    )
    with pytest.raises(UnknownName, match="channel of single components"):
        channels.join_components(joined, skeleton, "joint1", Property.TRANSLATION)


def test_euler_angles_and_back() -> None:
    skeleton = random_skeleton(np.random.default_rng(1), 3)
    curve = make(CurveKind.ROTATION, SPHERE[0])
    clip = Clip({Channel("joint1", Property.ROTATION): curve}, rate_hz=100.0)
    angles, error = channels.to_euler(clip, skeleton, "joint1", "ZXY")
    assert angles.euler_orders == {"joint1": "ZXY"}
    inner = np.linspace(0.1, 2.5, 3001)
    off = quat.angle_between(sample_clip(angles, skeleton, inner).rotations[:, 1], sample_curve(curve, inner))
    assert off.max() <= error * 1.3
    at_keys = sample_clip(angles, skeleton, TIMES).rotations[:, 1]
    assert_allclose(quat.angle_between(at_keys, curve.values), 0, atol=1e-7)
    back, error = channels.to_rotations(angles, skeleton, "joint1")
    assert error <= 1e-4
    assert list(back.curves) == [Channel("joint1", Property.ROTATION)]
    assert back.euler_orders == {}
    with pytest.raises(ShapeError, match="make a rotation Euler angles first"):
        channels.separate_components(clip, "joint1", Property.ROTATION)
