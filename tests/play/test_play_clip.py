"""Compiled clips: the error on the body holds, time runs in any order, files are what they were or refused."""

from __future__ import annotations

import doctest
import random
import struct
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.conftest import ROOT
from tests.synthetic import chain, random_skeleton

from keypose import evaluate, play
from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.io.compiled import load_compiled, save_compiled
from keypose.math import quat
from keypose.model import Channel, Clip, Curve, CurveKind, Event, Interpolation, Motion, Pose, Property, Skeleton
from keypose.play import clipfile, store
from keypose.samples import performances
from keypose.samples import skeleton as samples_skeleton


def smooth_motion(
    rng: np.random.Generator, joints: int, frames: int, *, scaled: bool = False, size_m: float = 0.3, morphs: int = 0
) -> tuple[Skeleton, Motion]:
    """Slow waves on every joint, about half of which rest."""
    skeleton = random_skeleton(rng, joints)
    time = np.linspace(0, 2 * np.pi, frames)[:, None, None]
    wave = np.sin(time * rng.integers(1, 3, (1, joints, 1)) + rng.uniform(0, 6, (1, joints, 1)))
    rests = rng.random((1, joints, 1)) < 0.5
    axes = rng.normal(size=(1, joints, 3))
    turns = quat.from_rotation_vector(np.where(rests, 0.0, 0.4 * wave * axes))
    rotations = quat.multiply(skeleton.rest.rotations, turns)
    offsets = size_m * np.asarray(skeleton.rest.translations) / 0.3
    translations = np.broadcast_to(offsets, (frames, joints, 3)).copy()
    translations[:, 0] += size_m * np.sin(time[:, 0] * [1, 2, 1])
    scales = np.ones((frames, joints, 3))
    if scaled:
        scales += 0.2 * wave * rng.random((1, joints, 3))
    names = tuple(f"morph{m}" for m in range(morphs))
    weights = 0.5 + 0.5 * np.sin(time[:, 0] + np.arange(morphs)) if morphs else None
    return skeleton, Motion(skeleton.names, Pose(translations, rotations, scales), 30.0, "waves", 0.5, names, weights)


def shell_points(skeleton: Skeleton, pose: Pose, shell_m: float) -> Any:
    """Points off every joint on its axes, in model space, (F, J, 3 axes, 3), by our slow forward kinematics."""
    pose = Pose(*(np.asarray(a, np.float64) for a in (pose.translations, pose.rotations, pose.scales)))
    world = np.asarray(evaluate.world(skeleton, pose))
    return world[..., None, :3, 3] + shell_m * np.swapaxes(world[..., :3, :3], -1, -2)


def body_error(clip: play.CompiledClip, motion: Motion, skeleton: Skeleton, times: Any) -> Any:
    """Largest distance of the points of each joint, (F, J) metres."""
    true = shell_points(skeleton, evaluate.sample_motion(evaluate.match(motion, skeleton), times), clip.shell_m)
    return np.linalg.norm(shell_points(skeleton, play.sample(clip, times), clip.shell_m) - true, axis=-1).max(axis=-1)


def fine_times(motion: Motion, per_frame: int = 4) -> Any:
    return motion.start_s + np.arange(per_frame * (motion.frame_count - 1) + 1) / (per_frame * motion.rate_hz)


def plain_decode(clip: play.CompiledClip, time_s: float) -> Any:
    """One pose (10, J) from the stored parts by NumPy alone."""
    packed = clip.packed
    base = np.concatenate([np.zeros((len(packed.kinds), 4)), packed.translations, packed.scales], axis=1).T
    rows = base.astype(np.float64).ravel()
    position = np.clip((time_s - clip.start_s) * clip.rate_hz, 0, clip.frame_count - 1)
    if packed.track_count:
        offsets = store.segment_offsets(packed)
        starts, levels = store.segment_starts(store.slot_levels(packed.info))
        segment = int(np.searchsorted(starts, position, side="right")) - 1
        local = (position - starts[segment]) * (1 << int(levels[segment]))
        first = 16 * segment + min(int(local), 15)
        share = local - min(int(local), 15)
        for index, weight in ((first, 1 - share), (first + 1, share)):
            if weight > 0 and index // 16 < len(packed.segment_scales):
                coefficients = store.unpack_segment(packed, offsets, index // 16)
                sums = coefficients @ store.cosines()[index % 16]
                rows[store.track_targets(packed, len(packed.kinds))] += weight * sums
    rows = rows.reshape(10, -1)
    coded = rows[:4].T.copy()
    three = packed.kinds != store.FOUR
    square = np.sum(coded[three, 1:] ** 2, axis=1, keepdims=True)
    coded[three] = np.concatenate([1 - square, 2 * coded[three, 1:]], axis=1) / (1 + square)
    coded /= np.linalg.norm(coded, axis=1, keepdims=True)
    rows[:4] = quat.multiply(quat.multiply(packed.before, coded), packed.after).T
    return rows


@pytest.fixture(scope="module")
def waves() -> tuple[Skeleton, Motion, play.CompiledClip]:
    skeleton, motion = smooth_motion(np.random.default_rng(3), 19, 75)
    return skeleton, motion, play.compile_clip(motion, skeleton)


@pytest.mark.parametrize("name", performances.names())
def test_the_error_stays_under_the_tolerance_on_the_performances(name: str) -> None:
    motion, skeleton = performances.make(name), samples_skeleton.skeleton()
    clip = play.compile_clip(motion, skeleton)
    error = body_error(clip, motion, skeleton, fine_times(motion))
    assert clip.error.holds
    assert error.max() <= 1e-4
    assert error.max() == pytest.approx(clip.error.max_m, rel=1e-3)
    assert clip.ratio > 15
    if motion.morph_names:
        true = evaluate.sample_morphs(motion, motion.morph_names, fine_times(motion), np.zeros(len(motion.morph_names)))
        assert np.abs(play.sample_weights(clip, fine_times(motion)) - true).max() <= 1e-3


@pytest.mark.data
@pytest.mark.parametrize(("file", "least"), [("cmu_01_01/01_01.bvh", 22.0), ("bvh/cmu_iclone_007/007_01.bvh", 22.0)])
def test_the_error_and_the_size_on_real_captures(data_dir: Path, file: str, least: float) -> None:
    from keypose import io

    scene = io.load(data_dir / file)
    motion, skeleton = scene.animations[0], scene.character.skeleton
    assert isinstance(motion, Motion)
    clip = play.compile_clip(motion, skeleton)
    some = fine_times(motion)[:2000]
    assert clip.error.holds
    assert body_error(clip, motion, skeleton, some).max() <= 1e-4
    assert clip.raw_byte_count == motion.frame_count * skeleton.joint_count * 40
    assert clip.byte_count == len(play.to_bytes(clip))
    assert clip.ratio >= least


def test_the_stated_error_is_that_of_independent_kinematics(waves: Any) -> None:
    skeleton, motion, clip = waves
    matrices = [chain(skeleton, p) for p in (evaluate.sample_motion(motion, 1.23), play.sample(clip, 1.23))]
    a, b = (m[:, None, :3, 3] + 0.03 * np.swapaxes(m[:, :3, :3], -1, -2) for m in matrices)
    assert 0 < np.linalg.norm(a - b, axis=-1).max() <= clip.error.max_m <= 1e-4


def test_the_kernel_decodes_what_plain_numpy_decodes(waves: Any) -> None:
    _, motion, clip = waves
    for time_s in np.random.default_rng(0).uniform(motion.start_s - 0.1, motion.start_s + motion.duration_s + 0.1, 60):
        rows = play.sample_rows(clip, [time_s])[0, :, : len(clip.joint_names)]
        np.testing.assert_allclose(rows, plain_decode(clip, time_s), atol=3e-6)


def test_random_access_equals_sequential_access(waves: Any) -> None:
    _, motion, clip = waves
    times = fine_times(motion, 7)
    order = np.random.default_rng(1).permutation(len(times))
    ordered, shuffled = play.sample(clip, times), play.sample(clip, times[order])
    assert np.array_equal(ordered.rotations[order], shuffled.rotations)
    assert np.array_equal(ordered.translations[order], shuffled.translations)
    one = play.sample(clip, times[40])
    assert one.batch_shape == () and np.array_equal(one.rotations, ordered.rotations[40])
    grid = play.sample(clip, times[:12].reshape(3, 4))
    assert grid.batch_shape == (3, 4)
    assert ordered.rotations.dtype == ordered.translations.dtype == ordered.scales.dtype == np.float32


def test_time_is_clamped_or_wrapped(waves: Any) -> None:
    skeleton, motion, clip = waves
    ends = play.sample(clip, [motion.start_s, motion.start_s + motion.duration_s])
    outside = play.sample(clip, [-1e9, 1e9])
    assert np.array_equal(outside.rotations, ends.rotations)
    inside = np.array([0.7, 1.9, 2.6])
    for turns in (-3, 1, 5):
        wrapped = play.sample(clip, inside + turns * motion.duration_s, loop=True)
        np.testing.assert_allclose(wrapped.rotations, play.sample(clip, inside).rotations, atol=1e-5)
    looping = play.compile_clip(motion, skeleton, loop=True)
    at = motion.start_s + motion.duration_s + 0.2
    np.testing.assert_allclose(
        play.sample(looping, at).rotations, play.sample(looping, motion.start_s + 0.2).rotations, atol=1e-5
    )
    assert not np.allclose(
        play.sample(looping, at, loop=False).rotations, play.sample(looping, at).rotations, atol=1e-3
    )


def test_joints_come_in_the_order_of_a_skeleton(waves: Any) -> None:
    skeleton, _, clip = waves
    few = Skeleton(
        (skeleton.names[5], skeleton.names[2]),
        np.array([-1, -1]),
        Pose(np.zeros((2, 3)), quat.identity((2,)), np.ones((2, 3))),
    )
    pose = play.sample(clip, 1.0, few)
    assert np.array_equal(pose.rotations, play.sample(clip, 1.0).rotations[[5, 2]])
    stranger = Skeleton(("jont5",), np.array([-1]), Pose(np.zeros((1, 3)), quat.identity((1,)), np.ones((1, 3))))
    with pytest.raises(UnknownName, match="joint5"):
        play.sample(clip, 1.0, stranger)


def test_scales_are_held_too() -> None:
    skeleton, motion = smooth_motion(np.random.default_rng(5), 9, 40, scaled=True)
    clip = play.compile_clip(motion, skeleton)
    assert clip.error.holds
    assert body_error(clip, motion, skeleton, fine_times(motion)).max() <= 1e-4
    found = play.sample(clip, motion.times_s).scales
    assert np.abs(found - motion.pose.scales).max() < 2e-3
    assert np.ptp(found, axis=0).max() > 0.1


def test_morph_weights_keep_their_own_tolerance() -> None:
    skeleton, motion = smooth_motion(np.random.default_rng(6), 4, 50, morphs=18)
    clip = play.compile_clip(motion, skeleton, morph_tolerance=1e-4)
    assert np.abs(play.sample_weights(clip, motion.times_s) - motion.morph_weights).max() <= 1e-4
    few = play.compile_clip(motion, skeleton, morph_names=("morph3", "absent"))
    weights = play.sample_weights(few, motion.times_s)
    assert np.abs(weights[:, 0] - np.asarray(motion.morph_weights)[:, 3]).max() <= 1e-3
    assert np.all(weights[:, 1] == 0)


def test_an_override_is_for_one_joint() -> None:
    skeleton, motion = smooth_motion(np.random.default_rng(7), 12, 60)
    strict = play.compile_clip(motion, skeleton, tolerance_m=1e-3, overrides={"joint7": 2e-5})
    error = body_error(strict, motion, skeleton, fine_times(motion)).max(axis=0)
    assert strict.error.holds
    assert error[7] <= 2e-5
    assert error.max() > 1e-4
    loose = play.compile_clip(motion, skeleton, tolerance_m=1e-3)
    assert loose.byte_count < strict.byte_count


def test_what_rests_takes_no_room() -> None:
    skeleton, motion = smooth_motion(np.random.default_rng(8), 30, 2)
    still = replace(motion, pose=Pose(*(np.repeat(a[:1], 500, axis=0) for a in (
        motion.pose.translations, motion.pose.rotations, motion.pose.scales))))  # fmt: skip
    clip = play.compile_clip(still, skeleton)
    assert clip.packed.track_count == 0
    assert clip.byte_count < 1500
    assert body_error(clip, still, skeleton, fine_times(still)[::50]).max() < 2e-5
    single = play.compile_clip(replace(motion, pose=motion.pose[:1]), skeleton)
    assert single.frame_count == 1 and single.duration_s == 0
    assert np.array_equal(play.sample(single, [0, 9], loop=True).rotations, play.sample(clip, [5, 6]).rotations)
    again = play.from_bytes(play.to_bytes(clip))
    assert np.array_equal(play.sample(again, [0.6]).rotations, play.sample(clip, [0.6]).rotations)


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_any_unit_of_length(size: float) -> None:
    skeleton, motion = smooth_motion(np.random.default_rng(9), 8, 40, size_m=0.3 * size)
    skeleton = replace(skeleton, rest=replace(skeleton.rest, translations=skeleton.rest.translations * size))
    clip = play.compile_clip(motion, skeleton, tolerance_m=1e-4 * size, shell_m=0.03 * size)
    assert clip.error.holds
    assert body_error(clip, motion, skeleton, fine_times(motion)).max() <= 1e-4 * size


def test_what_float32_cannot_hold_is_reported() -> None:
    skeleton, motion = smooth_motion(np.random.default_rng(10), 5, 30, size_m=1e6)
    clip = play.compile_clip(motion, skeleton)
    assert not clip.error.holds
    assert clip.error.joint in skeleton.names
    assert clip.error.max_m < 10  # metres, of a thousand kilometres


def test_a_fast_turn_gets_more_samples() -> None:
    skeleton, motion = smooth_motion(np.random.default_rng(11), 6, 64)
    rotations = np.array(motion.pose.rotations)
    rotations[40:, 1] = quat.multiply(rotations[40:, 1], quat.from_axis_angle([0.0, 1.0, 0.0], 2.0))
    motion = motion.with_pose(replace(motion.pose, rotations=rotations))
    clip = play.compile_clip(motion, skeleton)
    assert clip.packed.info["refined"]
    assert clip.error.holds
    assert body_error(clip, motion, skeleton, fine_times(motion, 16)).max() <= 1.05e-4
    for time_s in 0.5 + np.random.default_rng(2).uniform(38, 42, 20) / 30:
        rows = play.sample_rows(clip, [time_s])[0, :, :6]
        np.testing.assert_allclose(rows, plain_decode(clip, time_s), atol=3e-6)


def test_clips_of_curves_are_sampled_as_they_are() -> None:
    skeleton, _ = smooth_motion(np.random.default_rng(12), 3, 2)
    turn = quat.from_axis_angle(np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.2, -0.4]))
    zero = np.zeros((3, 3))
    curves = {
        Channel("joint1", Property.ROTATION): Curve([0.0, 0.71, 1.0], turn, kind=CurveKind.ROTATION),
        Channel("joint0", Property.TRANSLATION): Curve(
            [0.0, 0.5, 1.0], [[0, 0, 0], [0, 1, 0], [1, 0, 0]], Interpolation.HERMITE, zero, zero
        ),
        Channel("smile", Property.WEIGHT): Curve([0.0, 1.0], [[0.0], [1.0]], kind=CurveKind.SCALAR),
    }  # fmt: skip
    source = Clip(curves, "curves", 60.0)
    clip = play.compile_clip(source, skeleton)
    times = np.linspace(0, 1, 333)
    true = shell_points(skeleton, evaluate.sample_clip(source, skeleton, times), 0.03)
    found = shell_points(skeleton, play.sample(clip, times), 0.03)
    assert clip.morph_names == ("smile",)
    assert np.abs(play.sample_weights(clip, times)[:, 0] - times).max() < 1e-3
    off = np.linalg.norm(found - true, axis=-1).max(axis=(1, 2))
    beside_the_kink = np.abs(times - 0.71) > 1 / 60
    assert off[beside_the_kink].max() <= 1e-4


def test_both_precisions_give_the_same_clip_and_the_same_bytes(waves: Any) -> None:
    skeleton, motion, clip = waves
    assert play.to_bytes(play.compile_clip(motion, skeleton)) == play.to_bytes(clip)
    pose = motion.pose
    short = motion.with_pose(
        Pose(*(np.asarray(a, np.float32) for a in (pose.translations, pose.rotations, pose.scales)))
    )
    other = play.compile_clip(short, skeleton)
    assert other.error.holds
    assert quat.angle_between(play.sample(other, 1.5).rotations, play.sample(clip, 1.5).rotations).max() < 4e-3


def test_wrong_input_is_refused(waves: Any) -> None:
    skeleton, motion, clip = waves
    for options in ({"tolerance_m": 0.0}, {"shell_m": -1.0}, {"rate_hz": np.nan}, {"overrides": {"joint1": 0.0}}):
        with pytest.raises(ShapeError):
            play.compile_clip(motion, skeleton, **options)
    with pytest.raises(UnknownName, match="joint3"):
        play.compile_clip(motion, skeleton, overrides={"jiont3": 1e-3})
    rotations = np.array(motion.pose.rotations)
    rotations[9, 4, 2] = np.nan
    with pytest.raises(ShapeError, match=r"rotation of 'joint4' is not finite at 0\.8"):
        play.compile_clip(motion.with_pose(replace(motion.pose, rotations=rotations)), skeleton)
    rotations[9, 4] = 0
    with pytest.raises(ShapeError, match="rotation of 'joint4' is zero"):
        play.compile_clip(motion.with_pose(replace(motion.pose, rotations=rotations)), skeleton)
    with pytest.raises(ShapeError, match="no frames"):
        play.compile_clip(motion.with_pose(motion.pose[:0]), skeleton)
    for times in (np.nan, [0.0, np.inf]):
        with pytest.raises(ShapeError, match="times_s"):
            play.sample(clip, times)


# --- files -------------------------------------------------------------------------------------------------------------------


def test_a_file_gives_the_same_clip(waves: Any, tmp_path: Path) -> None:
    skeleton, motion, _ = waves
    motion = replace(motion, events=(Event(0.7, "step", "left"),), name="naïve 🚶")
    clip = play.compile_clip(motion, skeleton, loop=True)
    path = tmp_path / "walk.kpclip"
    save_compiled(clip, path)
    again = load_compiled(path)
    assert path.stat().st_size == clip.byte_count == again.byte_count
    assert play.to_bytes(again) == path.read_bytes()
    for name in ("name", "joint_names", "rate_hz", "start_s", "frame_count", "loop", "tolerance_m", "error"):
        assert getattr(again, name) == getattr(clip, name)
    assert [(e.time_s, e.name, e.data) for e in again.events] == [(0.7, "step", "left")]
    times = np.linspace(0, 4, 50)
    assert np.array_equal(play.sample_rows(again, times), play.sample_rows(clip, times))
    assert list(tmp_path.iterdir()) == [path]


def test_a_changed_or_cut_file_is_refused(waves: Any, tmp_path: Path) -> None:
    data = play.to_bytes(waves[2])
    dice = random.Random(4)
    for _ in range(200):
        broken = bytearray(data)
        for _ in range(dice.choice((1, 1, 2, 9))):
            broken[dice.randrange(len(broken))] ^= 1 << dice.randrange(8)
        if dice.random() < 0.4:
            broken = broken[: dice.randrange(len(broken))]
        if bytes(broken) == data:
            continue
        with pytest.raises(FormatError) as caught:
            play.from_bytes(bytes(broken))
        assert caught.value.where
    path = tmp_path / "cut.kpclip"
    path.write_bytes(data[:100])
    with pytest.raises(FormatError, match=r"cut\.kpclip: byte 12: expected \d+ bytes, the file has 100"):
        load_compiled(path)
    path.write_bytes(b"BVH" + data)
    with pytest.raises(FormatError, match="KEYPCLIP"):
        load_compiled(path)
    with pytest.raises(FormatError, match=r"absent\.kpclip"):
        load_compiled(tmp_path / "absent.kpclip")
    newer = data[:8] + struct.pack("<I", 99) + data[12:]
    with pytest.raises(FormatError, match="version 99"):
        play.from_bytes(newer)


def test_a_forged_checksum_cannot_make_the_decoder_leave_its_memory(waves: Any) -> None:
    data = play.to_bytes(waves[2])
    dice = random.Random(5)
    accepted = 0
    for _ in range(300):
        broken = bytearray(data)
        for _ in range(dice.choice((1, 2, 5))):
            broken[dice.randrange(28, len(broken))] = dice.randrange(256)
        if dice.random() < 0.3:
            del broken[dice.randrange(28, len(broken)) :]
        broken[12:20] = struct.pack("<Q", len(broken))
        broken[20:24] = struct.pack("<I", zlib.crc32(bytes(broken[24:])))
        try:
            clip = play.from_bytes(bytes(broken))
        except FormatError as error:
            assert error.where
            continue
        accepted += 1
        play.sample(clip, np.linspace(-1, 5, 40))
    assert accepted < 250


def test_a_forged_header_is_refused_with_the_place(waves: Any) -> None:
    packed = waves[2].packed
    for change in (
        {"frames": 0}, {"frames": 10**30}, {"frames": 1 << 33}, {"rate_hz": 0}, {"rate_hz": 10**400}, {"joints": [1]},
        {"refined": [[0, [9]]]}, {"refined": [[0]]}, {"refined": [[10**9, [1, 1]]]}, {"refined": [[0, [1, 2]]]},
        {"refined": [[0, [2, 1, 2]]]}, {"refined": [[0, 1]]}, {"refined": [[0, [1, 1]], [0, [1, 1]]]}, {"events": [[1]]}, {"error": {}},
        {"start_s": "x"}, {"loop": 1}, {"joints": ["a"] * 70000},
    ):  # fmt: skip
        forged = replace(packed, info={**packed.info, **change})
        with pytest.raises(FormatError) as caught:
            play.from_bytes(clipfile.to_bytes(forged))
        assert caught.value.where


def test_quaternions_in_eight_bytes() -> None:
    rng = np.random.default_rng(0)
    q = np.concatenate(
        [rng.normal(size=(4000, 4)), np.eye(4), -np.eye(4), [[1, 1, 0, 0], [1, -1, 1, -1], [0, 1, -1, 1e-6]]]
    )
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    packed = store.pack_quaternions(q)
    found = store.unpack_quaternions(packed)
    assert quat.angle_between(found, q).max() < 4e-6
    assert np.array_equal(store.pack_quaternions(found), packed)
    anything = store.unpack_quaternions(rng.integers(0, 1 << 64, 1000, np.uint64))
    np.testing.assert_allclose(np.linalg.norm(anything, axis=1), 1)


def test_the_examples_of_the_page() -> None:
    result = doctest.testfile(
        str(ROOT / "docs" / "play.md"),
        module_relative=False,
        optionflags=doctest.ELLIPSIS,
    )
    assert result.attempted > 10
    assert result.failed == 0
