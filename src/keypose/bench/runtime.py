# pyright: basic
"""The real-time runtime: how small compiled clips are, how far they are off, how fast they are decoded and played."""

from __future__ import annotations

import os
from functools import partial  # a lambda would take a fifth of what it calls
from pathlib import Path
from typing import Any

import numpy as np

from keypose import evaluate, io, play
from keypose.bench import data, detail, graphs
from keypose.bench.suite import Suite
from keypose.kernels import crowd as crowd_kernel
from keypose.kernels.decode import FRAME_COUNT, decode_pose, frame_at
from keypose.kernels.runtime import aligned, kernel
from keypose.kernels.vectors import pointer
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton
from keypose.play import crowd

# N. Frechette, "Animation Compression Library", results on the CMU database: ratio at an error of 0.01 cm asked for.
_PUBLISHED, _PUBLISHED_NAME = 21.8, "ACL, published, CMU"
_FILES = ("cmu_01_01/01_01.bvh", "bvh/cmu_iclone_007/*.bvh")
_POSES = 1000


def add(suite: Suite) -> None:
    """All rows of the suite.

    Real captures are looked for in the folder that the environment variable KEYPOSE_DATA names.
    """
    _compression(suite)
    _decompression(suite)
    _crowds(suite)
    graphs.add(suite)
    detail.add(suite)


def _compression(suite: Suite) -> None:
    from keypose.samples import performances, skeleton

    sources: list[tuple[str, Any, Skeleton, float | None]] = [
        (name, performances.make(name), skeleton.skeleton(), None) for name in performances.names()
    ]
    folder = os.environ.get("KEYPOSE_DATA")
    if folder:
        for path in (p for pattern in _FILES for p in sorted(Path(folder).glob(pattern))):
            scene = io.load(path)
            sources.append((path.name, scene.animations[0], scene.character.skeleton, _PUBLISHED))
    for name, motion, bones, published in sources:
        clip = play.compile_clip(motion, bones)
        suite.check(f"compression, {name}: error on the body in tolerances", clip.error.ratio, 1.0)
        note = f"{clip.error.max_m * 100:.4f} cm, {clip.byte_count / 1024:.1f} KiB"
        against = "" if published is None else _PUBLISHED_NAME
        suite.known(f"compression, {name}", ":1", clip.ratio, published, against, note)


@kernel
def _decode_all(layout, tables, book, codes, start_s, rate_hz, times_s, sums, out):
    frames = layout[FRAME_COUNT]
    clip = (pointer(layout), pointer(tables), pointer(book), pointer(codes))
    sums_at, out_at = pointer(sums), pointer(out)
    for n in range(times_s.shape[0]):
        frame, share = frame_at(times_s[n], start_s, rate_hz, frames, False)
        decode_pose(clip, frame, share, sums_at, out_at, 0)


def _decompression(suite: Suite) -> None:
    rng = np.random.default_rng(1)
    parents, offsets = data.body()
    rotations, translations = data.clips(offsets, rng)[0]
    joints = len(parents)
    rest = Pose(offsets, np.tile([1.0, 0, 0, 0], (joints, 1)), np.ones((joints, 3)))
    skeleton = Skeleton(tuple(f"joint{j}" for j in range(joints)), parents, rest)
    motion = Motion(skeleton.names, Pose(translations, rotations, np.ones((joints, 3))), 30.0)
    every = play.compile_clip(motion, skeleton)
    # As in captures: the fingers rest.
    still = np.array(rotations)
    still[:, data.BODY_JOINTS :] = still[:1, data.BODY_JOINTS :]
    body = play.compile_clip(motion.with_pose(Pose(translations, still, np.ones((joints, 3)))), skeleton)
    for clip, label in ((body, ""), (every, ", all turning")):
        times = rng.uniform(clip.start_s, clip.end_s, _POSES)
        true = evaluate.sample_motion(motion, times)
        if clip is every:
            off = np.abs(play.sample(clip, times).translations - true.translations).max()
            suite.check("decompress one pose: translations in metres", off, 2e-4)
        d = clip.decoder
        arguments = (d.layout, d.tables, d.book, d.codes, clip.start_s, clip.rate_hz, times, aligned(d.room))
        out = aligned(d.stride)
        few = times[:100]
        suite.case(
            f"decompress one pose, {joints} joints, random time{label}", "ns", _POSES,
            lambda arguments=arguments, out=out: _decode_all(*arguments, out),
            lambda few=few: evaluate.sample_motion(motion, few), "NumPy, raw", len(few),
            note=f"{clip.packed.track_count} numbers move",
        )  # fmt: skip


_GROWING = (1, 2, 3, 4, 5, 7)  # joints whose scale moves: the spine and the head
_CHARACTERS = (1, 16, 256, 4096)
_LONG_S, _SMALL_POOL, _STEP_S = 20, 1 << 20, 1 / 60
_alone = crowd_kernel.animate_one


@kernel
def _repeat_alone(times, call):
    for _ in range(times):
        _alone(call)


def _crowds(suite: Suite) -> None:
    """Sample three compressed clips, blend, and walk the hierarchy with scale; the names of the same work on raw clips."""
    rng = np.random.default_rng(1)
    parents, offsets = data.body()
    joints, raw = len(parents), data.clips(offsets, rng)
    rest = Pose(offsets, np.tile([1.0, 0, 0, 0], (joints, 1)), np.ones((joints, 3)))
    skeleton = Skeleton(tuple(f"joint{j}" for j in range(joints)), parents, rest)
    clips = [_scaled(rotations, translations, skeleton) for rotations, translations in raw]
    for count in _CHARACTERS:
        places, weights = data.crowd(count, rng)
        which, times, weights = np.tile(np.arange(3), (count, 1)), places / 30.0, np.array(weights, np.float64)
        made = crowd.prepare(clips, skeleton, count)
        got = crowd.model_matrices(made, crowd.animate(made, which, times, weights))[:16]
        poses = [play.sample(clip, times[:16, k]) for k, clip in enumerate(clips)]
        true = evaluate.world(skeleton, evaluate.blend(poses, weights[:16]))
        suite.check(f"crowd of {count}, compressed clips: metres", abs(got - true)[..., :3, 3].max(), 1e-4)
        arguments = (made, which, times, weights)
        kept = f"with scale; pool {made.pool_bytes // 1024} KiB, clips {sum(c.byte_count for c in clips) // 1024} KiB"
        if count == 1:
            one = which[0], times[0], weights[0]
            alone = crowd.animate_one(made, *one)
            suite.check("one character, compressed clips: metres", abs(alone - true[0])[:, :3, 3].max(), 1e-4)
            suite.case(
                "chain, 1 character, call from Python", "ns/character", 1,
                partial(crowd.animate_one, made, *one), note=kept,
            )  # fmt: skip
            suite.case(
                "chain, 1 character, call inside a kernel", "ns/character", 200,
                lambda address=made.one_call.address: _repeat_alone(200, address), note=kept,
            )  # fmt: skip
            continue
        suite.case(
            f"chain, {count} characters", "ns/character", count,
            partial(crowd.animate, *arguments), note=kept,
        )  # fmt: skip
        if count >= 256:
            emptied = crowd.prepare(clips, skeleton, count)
            suite.case(
                f"chain, {count} characters, pool emptied", "ns/character", count,
                lambda emptied=emptied, rest=arguments[1:]: _from_nothing(emptied, *rest),
            )  # fmt: skip
    _long_clips(suite, skeleton, rng)


def _long_clips(suite: Suite, skeleton: Skeleton, rng: np.random.Generator) -> None:
    """256 characters anywhere in three long clips, a sixtieth of a second later at every call."""
    joints, frames = skeleton.joint_count, 30 * _LONG_S + 1
    seconds = np.arange(frames) / 30
    clips: list[play.CompiledClip] = []
    for _ in range(3):
        waves = np.sin(2 * np.pi * np.outer(seconds, rng.uniform(0.3, 1.5, 4)) + rng.uniform(0, 6, 4))
        turns = np.einsum("fw,wja->fja", waves, rng.normal(0, 0.15, (4, joints, 3)))
        translations = np.tile(skeleton.rest.translations, (frames, 1, 1))
        translations[:, 0] += 0.03 * waves[:, :3]
        clips.append(_scaled(quat.from_rotation_vector(turns), translations, skeleton))
    which, times = np.tile(np.arange(3), (256, 1)), rng.uniform(0, _LONG_S, (256, 3))
    weights = rng.dirichlet((2, 2, 2), 256)
    for pool_bytes, label in ((8 << 20, "long clips"), (_SMALL_POOL, "long clips, pool too small")):
        made = crowd.prepare(clips, skeleton, 256, pool_bytes=pool_bytes)
        suite.case(
            f"chain, 256 characters, {label}", "ns/character", 256,
            lambda made=made, later=times.copy(): _go_on(made, which, later, weights),
            note=f"pool {made.pool_bytes // 1024} KiB, clips {sum(c.byte_count for c in clips) // 1024} KiB",
        )  # fmt: skip


def _scaled(rotations: Any, translations: Any, skeleton: Skeleton) -> play.CompiledClip:
    """A clip with scales that move, compiled."""
    scales = np.ones((len(rotations), skeleton.joint_count, 3))
    phase = 2 * np.pi * np.arange(len(rotations)) / (len(rotations) - 1)
    scales[:, _GROWING] += (0.05 * np.sin(phase))[:, None, None]
    return play.compile_clip(
        Motion(skeleton.names, Pose(translations, rotations, scales), 30.0), skeleton, loop=True
    )  # fmt: skip


def _go_on(made: crowd.Crowd, which: Any, times: Any, weights: Any) -> None:
    times += _STEP_S
    crowd.animate(made, which, times, weights)


def _from_nothing(made: crowd.Crowd, which: Any, times: Any, weights: Any) -> None:
    crowd.forget(made)
    crowd.animate(made, which, times, weights)
