"""Crowds that play compiled clips, against sampling, blending and forward kinematics one after another."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.synthetic import random_skeleton

from keypose import evaluate, play
from keypose.errors import ShapeError
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton
from keypose.play import crowd
from keypose.samples import performances
from keypose.samples import skeleton as samples_skeleton

Floats = NDArray[np.floating[Any]]


def made_clip(skeleton: Skeleton, frames: int, seed: int, loop: bool, speed: float = 1.0) -> play.CompiledClip:
    """Smooth turning of all joints; some translations and scales move, others do not."""
    rng = np.random.default_rng(seed)
    joints = skeleton.joint_count
    phase = 2 * np.pi * np.arange(frames) / max(frames - 1, 1)
    waves = np.stack([np.sin(phase), np.cos(phase), np.sin(2 * phase)], axis=1)
    turns = np.einsum("fw,wja->fja", waves, rng.normal(0, 0.2 * speed, (3, joints, 3)))
    rotations = quat.multiply(skeleton.rest.rotations, quat.from_rotation_vector(turns))
    translations = np.tile(skeleton.rest.translations, (frames, 1, 1))
    translations[:, ::7] += waves[:, None, :] * rng.normal(0, 0.05, (1, len(translations[0, ::7]), 3))
    scales = np.ones((frames, joints, 3))
    scales[:, ::5] += 0.2 * waves[:, None, :] * rng.random((1, len(scales[0, ::5]), 3))
    motion = Motion(skeleton.names, Pose(translations, rotations, scales), 30.0, name=f"clip{seed}")
    return play.compile_clip(motion, skeleton, loop=loop)


@pytest.fixture(scope="module")
def rig() -> tuple[Skeleton, tuple[play.CompiledClip, ...]]:
    skeleton = random_skeleton(np.random.default_rng(2), 21)
    sizes = ((41, True), (75, False), (17, True), (1, False))
    return skeleton, tuple(made_clip(skeleton, n, seed, loop) for seed, (n, loop) in enumerate(sizes))


def step_by_step(
    skeleton: Skeleton, clips: tuple[play.CompiledClip, ...], which: Any, times: Any, weights: Any, loop: Any = None
) -> Floats:
    """The same by the slow functions, one sample at a time."""
    poses: list[Pose] = []
    for k in range(which.shape[1]):
        each = [play.sample(clips[c], t, loop=loop) for c, t in zip(which[:, k], times[:, k], strict=True)]
        poses.append(
            Pose(*(np.stack([getattr(p, name) for p in each]) for name in ("translations", "rotations", "scales")))
        )
    return evaluate.world(skeleton, evaluate.blend(poses, weights))


def mixture(rng: np.random.Generator, count: int, many: int, clips: int) -> tuple[Any, Any, Any]:
    weights = rng.dirichlet(np.ones(many), count) * rng.uniform(0.1, 5, (count, 1))
    return rng.integers(0, clips, (count, many)), rng.uniform(-2, 4, (count, many)), weights


@pytest.mark.parametrize(("count", "many"), [(1, 1), (1, 3), (7, 2), (16, 3), (37, 4), (80, 3)])
@pytest.mark.parametrize("loop", [None, True, False])
def test_a_crowd_is_where_sampling_blending_and_kinematics_put_it(rig: Any, count: int, many: int, loop: Any) -> None:
    skeleton, clips = rig
    made = crowd.prepare(clips, skeleton, count, loop=loop)
    rng = np.random.default_rng(count * 10 + many)
    for _ in range(2):  # the second call finds samples in the pool
        numbers = mixture(rng, count, many, len(clips))
        got = crowd.model_matrices(made, crowd.animate(made, *numbers))
        true = step_by_step(skeleton, clips, *numbers, loop=loop)
        assert np.abs(got[..., :3, 3] - true[..., :3, 3]).max() < 1e-4
        assert np.abs(got - true).max() < 1e-3
        lengths = np.linalg.norm(true[..., :3, :3], axis=-2)
        assert np.abs(lengths - 1).max() > 0.05  # scale is there


def test_a_crowd_of_performances() -> None:
    skeleton = samples_skeleton.skeleton()
    clips = tuple(
        play.compile_clip(performances.make(name), skeleton, loop=name != "jump") for name in ("walk", "run", "jump")
    )
    made = crowd.prepare(clips, skeleton, 50)
    numbers = mixture(np.random.default_rng(8), 50, 3, 3)
    got = crowd.model_matrices(made, crowd.animate(made, *numbers))
    off = (got - step_by_step(skeleton, clips, *numbers))[..., :3, 3]
    assert np.linalg.norm(off, axis=-1).max() < 1e-4


def test_fast_turning_gets_more_samples() -> None:
    skeleton = random_skeleton(np.random.default_rng(2), 9)
    clips = (made_clip(skeleton, 30, 3, False, speed=5.0),)
    made = crowd.prepare(clips, skeleton, 64)
    numbers = mixture(np.random.default_rng(9), 64, 1, 1)
    got = crowd.model_matrices(made, crowd.animate(made, *numbers))
    assert np.abs((got - step_by_step(skeleton, clips, *numbers))[..., :3, 3]).max() < 1e-4
    frames = clips[0].frame_count
    assert made.parts["knot_times"].size > 2 * frames


def test_the_first_and_last_frame_and_both_sides_of_a_segment(rig: Any) -> None:
    skeleton, clips = rig
    clip = clips[1]
    frames = np.array([0, 1, 15, 15.5, 15.999, 16, 31.25, 32, 73.9, 74, 80, -1.0])
    times = (clip.start_s + frames / clip.rate_hz)[:, None]
    made = crowd.prepare([clip], skeleton, len(frames))
    one = np.zeros_like(times, np.int64), times, np.ones_like(times)
    got = crowd.model_matrices(made, crowd.animate(made, *one))
    off = np.abs(got - step_by_step(skeleton, (clip,), *one))
    assert off[..., :3, 3].max() < 1e-4
    assert off[frames % 1 == 0].max() < 1e-5  # nothing is interpolated


@pytest.mark.parametrize("time_s", [1e300, -1e300, 1.7e308, -1.7e308])
def test_times_at_the_end_of_the_numbers(rig: Any, time_s: float) -> None:
    skeleton, clips = rig
    made = crowd.prepare(clips, skeleton, 4)
    got = crowd.animate(made, np.arange(4)[:, None], np.full((4, 1), time_s), np.ones((4, 1)))
    assert np.all(np.isfinite(got))


def test_a_small_pool_gives_the_same_bits(rig: Any) -> None:
    skeleton, clips = rig
    large, small = (crowd.prepare(clips, skeleton, 200, clips_each=1, pool_bytes=n) for n in (1 << 24, 1))
    assert small.pool_bytes < large.pool_bytes
    rng = np.random.default_rng(4)
    for _ in range(5):
        numbers = mixture(rng, 200, 1, len(clips))
        assert np.array_equal(crowd.animate(large, *numbers), crowd.animate(small, *numbers))
    assert small.decoded_count > large.decoded_count


def test_a_pool_that_is_too_small_keeps_what_it_has(rig: Any) -> None:
    skeleton, clips = rig
    knots = crowd.prepare(clips, skeleton, 2000, clips_each=1, pool_bytes=1 << 24)
    made = crowd.prepare(clips, skeleton, 2000, clips_each=1, pool_bytes=knots.pool_bytes * 3 // 4)
    numbers = mixture(np.random.default_rng(4), 2000, 1, len(clips))
    wanted = np.array(crowd.animate(knots, *numbers))
    decoded: list[int] = []
    for _ in range(4):
        before = made.decoded_count
        assert np.array_equal(crowd.animate(made, *numbers), wanted)
        decoded.append(made.decoded_count - before)
    assert max(decoded) < 2 * 2000 / 4  # of two samples each; first in, first out would find few of them again
    assert decoded[-1] > 0


def test_arrays_come_again_with_other_numbers_and_other_arrays_come(rig: Any) -> None:
    skeleton, clips = rig
    made, rng = crowd.prepare(clips, skeleton, 40), np.random.default_rng(8)
    kept = mixture(rng, 40, 3, len(clips))
    for many in (3, 3, 2, 3, 4):
        fresh = mixture(rng, 40, many, len(clips))
        if many == 3:
            for array, values in zip(kept, fresh, strict=True):
                array[:] = values
        got = crowd.model_matrices(made, crowd.animate(made, *(kept if many == 3 else fresh)))
        assert np.abs(got - step_by_step(skeleton, clips, *fresh))[..., :3, 3].max() < 1e-4
    kept[1][7, 1] = np.nan
    with pytest.raises(ShapeError, match=r"times_s: .* character 7"):
        crowd.animate(made, *kept)
    with pytest.raises(ShapeError, match="clip_indices"):
        crowd.animate(made, None, None, None)  # pyright: ignore[reportArgumentType]


def test_each_sample_is_decoded_once(rig: Any) -> None:
    skeleton, clips = rig
    made = crowd.prepare(clips, skeleton, 300)
    numbers = mixture(np.random.default_rng(5), 300, 3, len(clips))
    first = np.array(crowd.animate(made, *numbers))
    decoded = made.decoded_count
    assert 0 < decoded <= made.parts["knot_times"].size
    assert np.array_equal(crowd.animate(made, *numbers), first)
    assert made.decoded_count == decoded
    crowd.forget(made)
    assert np.array_equal(crowd.animate(made, *numbers), first)
    assert made.decoded_count == 2 * decoded


def test_weights_of_any_sum_and_of_none(rig: Any) -> None:
    skeleton, clips = rig
    made = crowd.prepare(clips, skeleton, 5)
    which, times, weights = mixture(np.random.default_rng(6), 5, 3, len(clips))
    one = np.array(crowd.animate(made, which, times, weights))
    assert np.abs(crowd.animate(made, which, times, weights * 1e6) - one).max() < 1e-5
    nothing = np.array(crowd.animate(made, which, times, weights * 0))
    first = np.array(crowd.animate(made, which[:, :1].copy(), times[:, :1].copy(), np.ones((5, 1))))
    assert np.abs(nothing - first).max() < 1e-6


def test_numbers_of_other_types_and_shapes(rig: Any) -> None:
    skeleton, clips = rig
    made = crowd.prepare(clips, skeleton, 6)
    times = np.linspace(0, 1, 6)[:, None]
    same = np.array(crowd.animate(made, np.tile([0, 1], (6, 1)), np.tile(times, (1, 2)), np.full((6, 2), 0.5)))
    assert np.array_equal(crowd.animate(made, np.array([0, 1], np.uint8), times, np.float32(0.5)), same)


def test_nothing_is_allocated(rig: Any) -> None:
    skeleton, clips = rig
    made = crowd.prepare(clips, skeleton, 64)
    numbers = mixture(np.random.default_rng(7), 64, 3, len(clips))
    crowd.animate(made, *numbers)
    tracemalloc.start()
    try:
        for _ in range(3):
            assert crowd.animate(made, *numbers) is made.models
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        crowd.animate(made, *numbers)
        assert tracemalloc.get_traced_memory()[1] - before < 2048  # Python's own frames and numbers
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("many", [1, 2, 4])
def test_one_character_alone_is_where_a_crowd_has_it(rig: Any, many: int) -> None:
    skeleton, clips = rig
    made = crowd.prepare(clips, skeleton, 20)
    which, times, weights = mixture(np.random.default_rng(many), 20, many, len(clips))
    wanted = crowd.model_matrices(made, crowd.animate(made, which, times, weights))
    same = tuple(np.array(a[0]) for a in (which, times, weights))
    got = np.zeros(0)
    for n in range(20):
        got = crowd.animate_one(made, which[n], times[n], weights[n])
        assert np.abs(got - wanted[n]).max() < 1e-5
        for array, source in zip(same, (which, times, weights), strict=True):
            array[:] = source[n]
        assert np.array_equal(crowd.animate_one(made, *same), got)  # the same arrays, other numbers
    assert np.array_equal(crowd.animate_one(made, which[19].tolist(), times[19].tolist(), weights[19].tolist()), got)


def test_one_character_with_wrong_numbers_is_refused(rig: Any) -> None:
    skeleton, clips = rig
    made = crowd.prepare(clips, skeleton, 1)
    which, times, weights = np.array([0, 1]), np.zeros(2), np.ones(2)
    crowd.animate_one(made, which, times, weights)
    which[1] = 4
    with pytest.raises(ShapeError, match="clip_indices: expected 0 to 3"):
        crowd.animate_one(made, which, times, weights)
    which[1], times[0] = 1, np.nan
    with pytest.raises(ShapeError, match="times_s"):
        crowd.animate_one(made, which, times, weights)
    with pytest.raises(ShapeError, match="weights"):
        crowd.animate_one(made, which, np.zeros(2), -weights)
    with pytest.raises(ShapeError, match="K from 1 to 4"):
        crowd.animate_one(made, np.zeros(5, np.int64), np.zeros(5), np.ones(5))
    with pytest.raises(ShapeError):
        crowd.animate_one(made, which, np.zeros(3), np.ones(2))


def test_wrong_input_is_refused(rig: Any) -> None:
    skeleton, clips = rig
    made = crowd.prepare(clips, skeleton, 5)
    good = mixture(np.random.default_rng(1), 5, 2, len(clips))
    before = np.array(crowd.animate(made, *good))
    for which, value, said in ((0, 4, "clip_indices"), (0, -1, "clip_indices"), (1, np.nan, "times_s"), (1, np.inf, "times_s"), (2, -0.1, "weights"), (2, np.nan, "weights"), (2, np.inf, "weights")):  # fmt: skip
        bad = [np.array(a) for a in good]
        bad[which][3, 1] = value
        with pytest.raises(ShapeError, match=rf"{said}: .*character 3"):
            crowd.animate(made, *bad)
    assert np.array_equal(made.models, before)
    with pytest.raises(ShapeError, match=r"\(5, K\)"):
        crowd.animate(made, *(a[:4] for a in good))
    with pytest.raises(ShapeError, match="K from 1 to 4"):
        crowd.animate(made, *(np.tile(a, (1, 3)) for a in good))
    with pytest.raises(ShapeError, match="integers"):
        crowd.animate(made, good[1], good[1], good[2])
    with pytest.raises(ShapeError, match="at least one"):
        crowd.prepare([], skeleton, 5)
    with pytest.raises(ShapeError, match="count"):
        crowd.prepare(clips, skeleton, 0)
    with pytest.raises(ShapeError, match="joints of the skeleton"):
        crowd.prepare(clips, random_skeleton(np.random.default_rng(3), 20), 5)
