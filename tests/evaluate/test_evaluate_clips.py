"""Clips and motions on skeletons: rest, names, morphs, baking, resampling, reduction, matching."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from keypose.errors import ShapeError
from keypose.evaluate import (
    bake,
    frame_rate,
    match,
    match_report,
    resample,
    sample,
    sample_clip,
    sample_curve,
    sample_morphs,
    sample_motion,
    to_clip,
    to_motion,
    unmatched,
)
from keypose.math import quat
from keypose.model import (
    Channel,
    Clip,
    Curve,
    CurveKind,
    Event,
    Extrapolation,
    Interpolation,
    Motion,
    Pose,
    Property,
    Skeleton,
)
from tests.synthetic import as_type, random_pose, random_rotations, random_skeleton

T, R, S, W = Property.TRANSLATION, Property.ROTATION, Property.SCALE, Property.WEIGHT


def rotation_curve(rng: np.random.Generator, times: object, dtype: type = np.float64, mode: int = 1) -> Curve:
    values = random_rotations(rng, len(times)).astype(dtype)
    return Curve(times, values, mode, values * 0.1, values * 0.2, kind=CurveKind.ROTATION)


def random_motion(rng: np.random.Generator, frames: int, joints: int, dtype: type = np.float32) -> Motion:
    pose = as_type(random_pose(rng, (frames,), joints, scaled=True), dtype)
    names = tuple(f"joint{j}" for j in range(joints))
    weights = rng.uniform(size=(frames, 2)).astype(dtype)
    return Motion(names, pose, 24.0, "take", 1.5, ("smile", "blink"), weights, (Event(1.6, "step"),))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(42)


# --- clips ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(), (4,), (2, 3), (0,)])
def test_what_a_clip_does_not_animate_stays_at_rest(rng: np.random.Generator, shape: tuple[int, ...]) -> None:
    skeleton = random_skeleton(rng, 5, scaled=True)
    curve = rotation_curve(rng, [0.0, 1.0])
    clip = Clip({Channel("joint2", R): curve})
    times = rng.uniform(0, 1, shape)
    pose = sample_clip(clip, skeleton, times)
    assert pose.batch_shape == shape
    assert pose.translations.shape == pose.scales.shape == (*shape, 5, 3)
    for j in range(5):
        expected = sample_curve(curve, times) if j == 2 else np.broadcast_to(skeleton.rest.rotations[j], (*shape, 4))
        assert_allclose(pose.rotations[..., j, :], expected, atol=1e-15)
    assert_array_equal(pose.translations, np.broadcast_to(skeleton.rest.translations, (*shape, 5, 3)))
    assert_array_equal(pose.scales, np.broadcast_to(skeleton.rest.scales, (*shape, 5, 3)))


def test_curves_evaluated_together_equal_curves_evaluated_alone(rng: np.random.Generator) -> None:
    skeleton = random_skeleton(rng, 30)
    curves: dict[Channel, Curve] = {}
    tables = [np.linspace(0, 2, 9), np.linspace(0.3, 1, 4), np.array([0.5])]
    for name in skeleton.names[:25]:
        times, mode = tables[rng.integers(3)], int(rng.integers(3))
        rule = list(Extrapolation)[rng.integers(5)]
        values = rng.normal(size=(3, len(times), 3))
        curves[Channel(name, T)] = Curve(times, values[0], mode, values[1], values[2], after=rule)
        curves[Channel(name, R)] = rotation_curve(rng, times, mode=mode)
        curves[Channel(name, S)] = Curve(times.copy(), values[1], mode, values[2], values[0], before=rule)
    times = rng.uniform(-1, 4, 50)
    pose = sample_clip(Clip(curves), skeleton, times)
    arrays = {T: pose.translations, R: pose.rotations, S: pose.scales}
    for channel, curve in curves.items():
        own = arrays[channel.property][:, skeleton.index(channel.target)]
        assert_allclose(own, sample_curve(curve, times), atol=1e-14)


def test_unknown_channels_are_passed_over_and_listed(rng: np.random.Generator) -> None:
    skeleton = random_skeleton(rng, 3)
    tail, smile = Channel("tail", R), Channel("smile", W)
    clip = Clip({tail: rotation_curve(rng, [0.0, 1.0]), smile: Curve([0.0], [[0.5]])})
    pose = sample_clip(clip, skeleton, 0.5)
    assert_array_equal(pose.rotations, skeleton.rest.rotations)
    assert unmatched(clip, skeleton) == (tail, smile)
    assert unmatched(clip, skeleton, ["smile"]) == (tail,)


def test_a_curve_of_the_wrong_width_or_kind_is_named(rng: np.random.Generator) -> None:
    skeleton = random_skeleton(rng, 3)
    with pytest.raises(ShapeError, match=r"joint1\.translation: expected values of shape \(K, 3\), got \(1, 2\)"):
        sample_clip(Clip({Channel("joint1", T): Curve([0.0], [[1.0, 2.0]])}), skeleton, 0)
    with pytest.raises(ShapeError, match=r"joint1\.rotation: expected the kind ROTATION, got VECTOR"):
        sample_clip(Clip({Channel("joint1", R): Curve([0.0], [[1.0, 0, 0, 0]])}), skeleton, 0)


def test_float32_clips_on_float32_skeletons_stay_float32(rng: np.random.Generator) -> None:
    base = random_skeleton(rng, 4)
    skeleton = Skeleton(base.names, base.parents, as_type(base.rest, np.float32))
    clip = Clip({Channel("joint1", R): rotation_curve(rng, [0.0, 1.0], np.float32)})
    pose = sample_clip(clip, skeleton, [0.2, 0.4])
    assert pose.rotations.dtype == pose.translations.dtype == pose.scales.dtype == np.float32


def test_a_clip_of_torch_values_gives_a_torch_pose_with_gradients(rng: np.random.Generator) -> None:
    torch = pytest.importorskip("torch")
    skeleton = random_skeleton(rng, 4)
    values = torch.tensor(random_rotations(rng, 3), requires_grad=True)
    clip = Clip({Channel("joint1", R): Curve([0.0, 1.0, 2.0], values, kind=CurveKind.ROTATION)})
    pose = sample_clip(clip, skeleton, np.linspace(0, 2, 5))
    plain = Clip({Channel("joint1", R): Curve([0.0, 1.0, 2.0], values.detach().numpy(), kind=CurveKind.ROTATION)})
    expected = sample_clip(plain, skeleton, np.linspace(0, 2, 5))
    assert_allclose(pose.rotations.detach().numpy(), expected.rotations, atol=1e-14)
    pose.rotations[..., 1, 1].sum().backward()
    assert float(values.grad.abs().max()) > 0


def test_morph_weights_of_clips_and_motions(rng: np.random.Generator) -> None:
    clip = Clip({Channel("smile", W): Curve([0.0, 1.0], [[0.0], [1.0]], kind=CurveKind.SCALAR)})
    rest = np.array([0.25, 0.5])
    assert_allclose(sample_morphs(clip, ["blink", "smile"], [0.0, 0.5], rest), [[0.25, 0.0], [0.25, 0.5]])
    assert_allclose(sample_morphs(clip, ["blink", "smile"], 0.5), [0, 0.5])
    assert sample_morphs(clip, [], [0.0, 0.5]).shape == (2, 0)
    motion = random_motion(rng, 5, 2, np.float64)
    between = sample_morphs(motion, ["frown", "blink"], motion.start_s + np.array([0.5, 1]) / 24, rest)
    weights = motion.morph_weights
    assert_allclose(between, [[0.25, weights[:2, 1].mean()], [0.25, weights[1, 1]]], atol=1e-12)


# --- motions ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("rate_hz", [24.0, 29.97, 120.0, 1 / 0.0083333])
def test_a_motion_at_its_frames_is_itself_bit_for_bit(rng: np.random.Generator, dtype: type, rate_hz: float) -> None:
    pose = as_type(random_pose(rng, (500,), 3), dtype)
    motion = Motion(("a", "b", "c"), pose, rate_hz, start_s=0.7)
    sampled = sample_motion(motion, motion.times_s)
    for own, expected in ((sampled.translations, pose.translations), (sampled.rotations, pose.rotations)):
        assert own.dtype == dtype
        assert_array_equal(own, expected)


def test_between_frames_it_is_lerp_and_slerp_and_outside_it_holds(rng: np.random.Generator) -> None:
    motion = random_motion(rng, 4, 3, np.float64)
    sampled = sample_motion(motion, motion.start_s + np.array([[0.25, 2.5], [-3.0, 99.0]]) / 24)
    assert sampled.batch_shape == (2, 2)
    pose = motion.pose
    assert_allclose(sampled.translations[0, 0], 0.75 * pose.translations[0] + 0.25 * pose.translations[1], atol=1e-12)
    assert_allclose(sampled.rotations[0, 1], quat.slerp(pose.rotations[2], pose.rotations[3], 0.5), atol=1e-12)
    assert_array_equal(sampled.rotations[1, 0], pose.rotations[0])
    assert_array_equal(sampled.rotations[1, 1], pose.rotations[3])


def test_a_loop_has_the_period_of_the_duration(rng: np.random.Generator) -> None:
    motion = random_motion(rng, 13, 3, np.float64)
    times = motion.start_s + np.linspace(0, motion.duration_s, 29)[1:-1]
    for cycles in (-2, 1, 7):
        looped = sample_motion(motion, times + cycles * motion.duration_s, loop=True)
        plain = sample_motion(motion, times)
        assert_allclose(looped.translations, plain.translations, atol=1e-9)
        # Unit quaternions near an antipode may come back with the other sign.
        assert_allclose(np.abs(np.sum(looped.rotations * plain.rotations, axis=-1)), 1, atol=1e-12)
    still = Motion(("a",), random_pose(rng, (1,), 1), 30)
    assert_array_equal(sample_motion(still, [-1.0, 5.0], loop=True).rotations[0], still.pose.rotations[0])


def test_sample_takes_clips_and_motions_alike(rng: np.random.Generator) -> None:
    skeleton = random_skeleton(rng, 3)
    motion = random_motion(rng, 7, 3, np.float64)
    times = np.linspace(1.4, 2.2, 17)
    for loop in (False, True):
        a, b = (sample(x, skeleton, times, loop) for x in (motion, to_clip(motion)))
        assert_allclose(a.translations, b.translations, atol=1e-12)
        assert_allclose(np.abs(np.sum(a.rotations * b.rotations, axis=-1)), 1, atol=1e-12)


def test_sample_matches_names(rng: np.random.Generator) -> None:
    motion = random_motion(rng, 7, 3, np.float64)
    base = random_skeleton(rng, 3)
    skeleton = Skeleton(("ns:Joint0", "ns:Joint1", "other"), base.parents, base.rest)
    for animation in (motion, to_clip(motion)):
        pose = sample(animation, skeleton, motion.times_s)
        assert_array_equal(pose.rotations[:, :2], motion.pose.rotations[:, :2])
        assert_array_equal(pose.rotations[:, 2], np.tile(base.rest.rotations[2], (7, 1)))


def test_a_motion_without_frames_says_so() -> None:
    empty = Motion(("a",), Pose(np.zeros((0, 1, 3)), np.zeros((0, 1, 4)), np.ones((0, 1, 3))), 30, "nothing")
    with pytest.raises(ShapeError, match="motion 'nothing' has no frames"):
        sample_motion(empty, 0.0)


# --- the bridge -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("interpolation", Interpolation)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_motion_to_clip_and_back_changes_nothing(
    rng: np.random.Generator, dtype: type, interpolation: Interpolation
) -> None:
    motion = random_motion(rng, 50, 4, dtype)
    skeleton = random_skeleton(rng, 4)
    skeleton = Skeleton(skeleton.names, skeleton.parents, as_type(skeleton.rest, dtype))
    clip = to_clip(motion, interpolation)
    back = bake(clip, skeleton, motion.rate_hz, morph_names=motion.morph_names)
    assert back.frame_count == 50
    assert back.start_s == motion.start_s
    assert back.joint_names == motion.joint_names
    assert_array_equal(back.pose.translations, motion.pose.translations)
    assert_array_equal(back.pose.scales, motion.pose.scales)
    assert_array_equal(back.morph_weights, motion.morph_weights)
    same = back.pose.rotations == motion.pose.rotations
    if interpolation in (Interpolation.HERMITE, Interpolation.BEZIER):  # there signs are aligned along time
        same = same | (back.pose.rotations == -motion.pose.rotations)
    assert np.all(same)


def test_baking_finds_keys_whose_times_were_rounded_to_float32(rng: np.random.Generator) -> None:
    """An hour of 120 Hz in a format with float32 times: keys are up to 0.1 ms off, no value may be."""
    frames = np.arange(430_000, 430_200)
    exact = frames / 120
    rounded = exact.astype(np.float32).astype(np.float64)
    assert np.abs(rounded - exact).max() > 5e-5
    values = rng.normal(size=(200, 3))
    for mode in (Interpolation.STEP, Interpolation.LINEAR):
        clip = Clip({Channel("joint0", T): Curve(rounded, values, mode)})
        baked = bake(clip, random_skeleton(rng, 1), 120)
        assert baked.frame_count == 200
        assert_array_equal(baked.pose.translations[:, 0], values)


def test_the_range_of_a_bake(rng: np.random.Generator) -> None:
    skeleton = random_skeleton(rng, 1)
    clip = Clip({Channel("joint0", T): Curve([0.0, 1.02], [[0, 0, 0], [1.02, 0, 0]])})
    assert bake(clip, skeleton, 10).frame_count == 11  # the last frame is not after the end
    part = bake(clip, skeleton, 10, start_s=0.35, end_s=0.75)
    assert_allclose(part.pose.translations[:, 0, 0], [0.35, 0.45, 0.55, 0.65, 0.75], atol=1e-15)
    assert bake(Clip(), skeleton, 30).frame_count == 1
    for rate in (0, -1, np.nan, np.inf):
        with pytest.raises(ShapeError, match="rate_hz"):
            bake(clip, skeleton, rate)
    with pytest.raises(ShapeError, match="end_s"):
        bake(clip, skeleton, 30, start_s=2, end_s=1)


def test_the_last_frame_of_a_cyclic_clip_is_its_last_key(rng: np.random.Generator) -> None:
    # 3 / 30 is above 0.1: the frame must not slip over the end into the next cycle.
    curve = Curve([0.0, 0.1], [[0.0, 0, 0], [1.0, 0, 0]], after=Extrapolation.CYCLE)
    baked = bake(Clip({Channel("joint0", T): curve}), random_skeleton(rng, 1), 30)
    assert_allclose(baked.pose.translations[:, 0, 0], [0, 1 / 3, 2 / 3, 1], atol=1e-15)


def test_constant_channels_can_be_one_key(rng: np.random.Generator) -> None:
    motion = random_motion(rng, 10, 3)
    still = motion.with_pose(Pose(motion.pose.translations[0], motion.pose.rotations, np.ones((3, 3))))
    clip = to_clip(still, reduce_constant=True)
    assert {clip.curve("joint1", p).key_count for p in (T, S)} == {1}
    assert clip.curve("joint1", R).key_count == 10
    skeleton = random_skeleton(rng, 3)
    assert_allclose(bake(clip, skeleton, 24).pose.translations, still.pose.broadcast().translations)


def test_hermite_tangents_reproduce_a_parabola() -> None:
    times = np.arange(9) / 24
    translations = np.stack([times**2, 3 * times, 0 * times], axis=-1)[:, None]
    motion = Motion(("a",), Pose(translations, quat.identity((9, 1)), np.ones((1, 3))), 24)
    curve = to_clip(motion, Interpolation.HERMITE).curve("a", T)
    inner = np.linspace(times[1], times[-2], 50)
    assert_allclose(sample_curve(curve, inner)[:, 0], inner**2, atol=1e-14)


def test_resampling_up_and_down_gives_the_frames_back(rng: np.random.Generator) -> None:
    motion = random_motion(rng, 25, 3, np.float64)
    up = resample(motion, 96)
    assert up.frame_count == 97
    assert up.events == motion.events
    assert_array_equal(up.pose.rotations[::4], motion.pose.rotations)
    back = resample(up, 24)
    assert_array_equal(back.pose.translations, motion.pose.translations)
    assert_array_equal(back.morph_weights, motion.morph_weights)
    assert resample(motion, 25).frame_count == 26
    with pytest.raises(ShapeError, match="rate_hz"):
        resample(motion, 0)


def test_an_animation_of_any_kind_becomes_frames_with_its_morphs(rng: np.random.Generator) -> None:
    motion = random_motion(rng, 25, 3, np.float64)
    skeleton = named(*motion.joint_names)
    assert to_motion(motion, skeleton).frame_count == to_motion(motion, skeleton, motion.rate_hz).frame_count == 25
    clip = to_clip(motion)
    again = to_motion(clip, skeleton)
    assert again.rate_hz == motion.rate_hz and again.morph_names == tuple(sorted(motion.morph_names))
    assert_array_equal(again.pose.rotations, motion.pose.rotations)
    column = [again.morph_names.index(name) for name in motion.morph_names]
    assert_array_equal(np.asarray(again.morph_weights)[:, column], motion.morph_weights)
    assert to_motion(clip, skeleton, 96).frame_count == to_motion(motion, skeleton, 96).frame_count == 97
    other = to_motion(clip, named(*(f"mixamorig:{name}" for name in motion.joint_names)))
    assert_array_equal(other.pose.rotations, motion.pose.rotations)
    uneven = replace(clip, rate_hz=None, curves={Channel("a", S): Curve([0.0, 0.1, 0.35], np.ones((3, 3)))})
    assert frame_rate(uneven) == 30.0


# --- names ------------------------------------------------------------------------------------------------------------


def named(*names: str) -> Skeleton:
    return Skeleton(names, [-1, *range(len(names) - 1)], random_pose(np.random.default_rng(1), (), len(names)))


def motion_of(*names: str) -> Motion:
    return Motion(names, random_pose(np.random.default_rng(2), (4,), len(names), scaled=True), 30)


def test_matching_reorders_and_rests() -> None:
    skeleton, motion = named("hips", "spine", "head"), motion_of("head", "tail", "hips")
    matched = match(motion, skeleton)
    assert matched.joint_names == skeleton.names
    assert_array_equal(matched.pose.rotations[:, 0], motion.pose.rotations[:, 2])
    assert_array_equal(matched.pose.translations[:, 2], motion.pose.translations[:, 0])
    assert_array_equal(matched.pose.scales[:, 1], np.tile(skeleton.rest.scales[1], (4, 1)))
    report = match_report(motion, skeleton)
    assert (report.missing, report.unused, report.renamed) == (("spine",), ("tail",), {})
    assert str(report) == "1 joints stay at rest: spine; 1 animated joints are not in the skeleton: tail"
    assert match(matched, skeleton) is matched
    assert str(match_report(matched, skeleton)) == "all 3 joints match by name"


def test_case_and_namespaces_are_forgiven_where_they_are_unambiguous() -> None:
    report = match_report(motion_of("mixamorig:Hips", "Rig|spine", "HEAD"), named("Hips", "ns:Spine", "head"))
    assert report.sources == {"Hips": "mixamorig:Hips", "ns:Spine": "Rig|spine", "head": "HEAD"}
    assert "such as 'mixamorig:Hips' to 'Hips'" in report.notes[0]
    # An exact name is never given away, and what fits two fits none.
    assert match_report(motion_of("a:hand", "hand"), named("hand")).sources == {"hand": "hand"}
    assert match_report(motion_of("a:hand", "b:hand"), named("hand")).sources == {}
    assert match_report(motion_of("hand"), named("a:hand", "b:hand")).sources == {}


def test_matching_a_clip_renames_its_channels() -> None:
    curve = Curve([0.0], [[1.0, 2.0, 3.0]])
    clip = Clip({Channel("x:Hips", T): curve, Channel("tail", T): curve, Channel("smile", W): Curve([0.0], [[1.0]])})
    matched = match(clip, named("hips", "head"))
    assert list(matched.curves) == [Channel("hips", T), Channel("smile", W)]
    assert matched.curve("hips", T) is curve


def test_matching_keeps_float32_and_torch() -> None:
    torch = pytest.importorskip("torch")
    skeleton = named("hips", "spine")
    motion = motion_of("spine", "hips")
    assert match(motion.with_pose(as_type(motion.pose, np.float32)), skeleton).pose.rotations.dtype == np.float32
    tensors = match(motion.with_pose(as_type(motion.pose, torch.float64)), named("spine", "x"))
    assert_allclose(tensors.pose.rotations[:, 0].numpy(), motion.pose.rotations[:, 0])


@pytest.mark.slow
def test_many_times_are_sampled_without_a_loop_over_them(rng: np.random.Generator) -> None:
    curve = rotation_curve(rng, np.arange(5000) / 120, np.float32)
    started = time.perf_counter()
    assert sample_curve(curve, rng.uniform(0, 40, 200_000)).shape == (200_000, 4)
    assert time.perf_counter() - started < 5
