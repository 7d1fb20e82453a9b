"""Sampling, blending and crowd kernels against the definition in float64."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from keypose.errors import ShapeError
from keypose.kernels import sample
from keypose.kernels.runtime import WIDTH

from .conftest import chained, multiply, random_parents, unit


def smooth_clips(joints, rng, lengths=(9, 5, 12), root_moves=True):
    """Clips whose neighbouring frames are about ten degrees apart, with signs flipped at random."""
    clips = []
    offsets = rng.normal(size=(joints, 3))
    for frames in lengths:
        start = unit(rng.normal(size=(joints, 4)) * 0.2 + (1, 0, 0, 0))
        steps = unit(np.concatenate([np.ones((frames, joints, 1)), rng.normal(0, 0.05, (frames, joints, 3))], axis=2))
        rotations = [start]
        for step in steps[1:]:
            rotations.append(multiply(rotations[-1], step))
        flips = np.where(rng.random((frames, joints, 1)) < 0.5, -1, 1)
        translations = np.broadcast_to(offsets, (frames, joints, 3)).copy()
        if root_moves:
            translations[:, 0] += rng.normal(0, 0.3, (frames, 3))
        clips.append(((np.stack(rotations) * flips).astype(np.float32), translations.astype(np.float32)))
    return clips


def expected(clips, places, weights):
    """Blended local rotations and translations, clip by clip, in float64."""
    turned, moved = 0.0, 0.0
    for k, (rotations, translations) in enumerate(clips):
        rotations, translations = rotations.astype(float), translations.astype(float)
        whole = np.minimum(places[:, k].astype(int), len(rotations) - 2)
        t = (places[:, k] - whole)[:, None, None]
        a, b = rotations[whole], rotations[whole + 1]
        b = np.where((a * b).sum(axis=2, keepdims=True) < 0, -b, b)
        q = unit(a + t * (b - a))
        if k:
            q = np.where((q * turned).sum(axis=2, keepdims=True) < 0, -q, q)
        turned = turned + weights[:, k, None, None] * q
        moved = moved + weights[:, k, None, None] * (
            translations[whole] + t * (translations[whole + 1] - translations[whole])
        )
    return unit(turned), moved


def scene(joints, characters, seed, **options):
    rng = np.random.default_rng(seed)
    parents, clips = random_parents(joints, rng, deep=seed % 2 == 1), smooth_clips(joints, rng, **options)
    places = rng.random((characters, len(clips))) * [len(r) - 1 for r, _ in clips]
    return parents, clips, places, rng.dirichlet(np.ones(len(clips)), characters)


def same_rotation(a, b):
    return np.minimum(abs(a - b).max(axis=-1), abs(a + b).max(axis=-1)).max(initial=0)


@pytest.mark.parametrize(("quantized", "limit"), [(False, 3e-6), (True, 1e-4)])
@pytest.mark.parametrize("joints", [1, 5, 16, 23, 67])
def test_sampling_blends_as_defined(joints, quantized, limit):
    parents, clips, places, weights = scene(joints, 21, seed=joints)
    made = sample.compile_clips(parents, clips, quantized)
    rotations, translations = sample.sample(made, sample.mix(made, np.arange(3), places, weights))
    turned, moved = expected(clips, places, weights)
    assert same_rotation(rotations, turned) < limit
    assert abs(translations - moved).max() < 1e-5


@pytest.mark.parametrize("joints", [1, 4, 17, 40, 67, 130])
@pytest.mark.parametrize("characters", [1, WIDTH - 1, WIDTH, 2 * WIDTH + 3])
def test_crowds_and_single_characters_reach_the_same_matrices(joints, characters):
    parents, clips, places, weights = scene(joints, characters, seed=joints + characters)
    made = sample.compile_clips(parents, clips)
    state = sample.mix(made, np.arange(3), places, weights)
    wanted = chained(parents, *expected(clips, places, weights))
    limit = 2e-5 * (1 + abs(wanted).max())
    crowd = sample.animate_crowd(made, state).transpose(0, 3, 1, 2).reshape(-1, joints, 3, 4)[:characters]
    assert abs(crowd - wanted[:, :, :3]).max() < limit
    one = sample.animate_one(made, state)
    assert abs(one - wanted[0]).max() < limit
    assert (one[:, 3] == (0, 0, 0, 1)).all()


def test_wide_skeletons_walk_in_several_waves():
    joints = 5 * WIDTH + 3  # more brothers than lanes, on two depths
    parents = np.array([-1] + [0] * (2 * WIDTH + 1) + [1 + k % (2 * WIDTH) for k in range(joints - 2 * WIDTH - 2)])
    rng = np.random.default_rng(0)
    clips = smooth_clips(joints, rng)
    made = sample.compile_clips(parents, clips)
    places, weights = rng.random((1, 3)) * 4, rng.dirichlet(np.ones(3), 1)
    wanted = chained(parents, *expected(clips, places, weights))
    one = sample.animate_one(made, sample.mix(made, np.arange(3), places, weights))
    assert abs(one - wanted[0]).max() < 1e-4


@pytest.mark.parametrize("lengths", [(7,), (4, 6), (3, 4, 5, 6, 7)])
@pytest.mark.parametrize("root_moves", [False, True])
def test_any_number_of_clips_and_still_skeletons(lengths, root_moves):
    parents, clips, places, weights = scene(19, 5, seed=len(lengths), lengths=lengths, root_moves=root_moves)
    made = sample.compile_clips(parents, clips)
    assert made.moving == (16 if root_moves else 0)
    state = sample.mix(made, np.arange(len(lengths)), places, weights)
    wanted = chained(parents, *expected(clips, places, weights))
    crowd = sample.animate_crowd(made, state).transpose(0, 3, 1, 2).reshape(-1, 19, 3, 4)[:5]
    assert abs(crowd - wanted[:, :, :3]).max() < 1e-4


def test_places_beyond_the_ends_stay_at_the_ends_and_single_frames_stand():
    parents, clips, _, _ = scene(6, 1, seed=1, lengths=(1, 4))
    made = sample.compile_clips(parents, clips)
    ends = sample.sample(made, sample.mix(made, [[1]] * 4, [[-5.0], [0.0], [3.0], [99.0]], [[1.0]] * 4))
    assert np.array_equal(ends[0][0], ends[0][1]) and np.array_equal(ends[0][2], ends[0][3])
    assert same_rotation(ends[0][0], clips[1][0][0]) < 1e-6 and same_rotation(ends[0][3], clips[1][0][3]) < 1e-6
    one = sample.sample(made, sample.mix(made, [[0]], [[0.7]], [[1.0]]))
    assert same_rotation(one[0][0], clips[0][0][0]) < 1e-6


def test_frames_that_do_not_exist_are_refused_not_read():
    parents, clips, places, weights = scene(6, 4, seed=2)
    made = sample.compile_clips(parents, clips)
    for frame in (-1, made.frame_count, 2**31 - 1):
        state = sample.mix(made, np.arange(3), places, weights)
        state.frames[0, 1, 0] = frame
        for function in (sample.animate_crowd, sample.animate_one, sample.sample):
            with pytest.raises(ShapeError, match="frames 0 to"):
                function(made, state)
    with pytest.raises(ShapeError, match="out"):
        sample.animate_one(made, sample.mix(made, np.arange(3), places, weights), np.zeros((6, 4, 4)))
    with pytest.raises(ShapeError, match="which"):
        sample.mix(made, [[3]], [[0.0]], [[1.0]])


def test_threads_do_not_meet():
    parents, clips, places, weights = scene(67, 8 * WIDTH, seed=3)
    made = sample.compile_clips(parents, clips)
    states = [sample.mix(made, np.arange(3), np.roll(places, k, axis=0), weights) for k in range(4)]
    wanted = [sample.animate_crowd(made, state) for state in states]
    differ = []

    def work(state, right):
        differ.extend(k for k in range(50) if not np.array_equal(sample.animate_crowd(made, state), right))

    threads = [threading.Thread(target=work, args=pair) for pair in zip(states, wanted, strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not differ


@pytest.mark.parametrize("count", [0, 1, 15, 16, 17, 1000])
def test_slerp_follows_the_arc_the_short_way(count, rng):
    a, b = unit(rng.normal(size=(count, 4))), unit(rng.normal(size=(count, 4)))
    t = rng.random(count)
    near = np.where((a * b).sum(axis=1, keepdims=True) < 0, -b, b)
    angle = np.arccos(np.minimum((a * near).sum(axis=1, keepdims=True), 1))
    wanted = (np.sin((1 - t[:, None]) * angle) * a + np.sin(t[:, None] * angle) * near) / np.sin(angle)
    got = sample.slerp(a, b, t)
    assert got.shape == (count, 4) and got.dtype == np.float32
    assert abs(got - wanted).max(initial=0) < 5e-5


def test_slerp_at_the_ends_for_equal_and_for_opposite_quaternions(rng):
    a = unit(rng.normal(size=(40, 4)))
    for b in (a, -a):
        for t in (0.0, 0.3, 1.0):
            assert abs(sample.slerp(a, b, np.full(40, t)) - a).max() < 1e-6
    b = unit(rng.normal(size=(40, 4)))
    assert abs(sample.slerp(a, b, np.zeros(40)) - a).max() < 5e-5
    assert same_rotation(sample.slerp(a, b, np.ones(40)), b) < 5e-5


def test_slerp_lanes_hold_the_same_numbers(rng):
    count = 5 * WIDTH
    a, b, t = unit(rng.normal(size=(count, 4))), unit(rng.normal(size=(count, 4))), rng.random(count).astype(np.float32)
    rows = [np.ascontiguousarray(x.T, np.float32) for x in (a, b)]
    assert np.allclose(sample.slerp_lanes(*rows, t).T, sample.slerp(a, b, t), atol=1e-6)
    with pytest.raises(ShapeError, match="multiple"):
        sample.slerp_lanes(rows[0][:, :-1], rows[1][:, :-1], t[:-1])
