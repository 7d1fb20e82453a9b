# pyright: basic
"""Every kernel on synthetic data: checked against plain NumPy, then timed beside it."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from keypose.bench import data, plain
from keypose.bench.suite import Suite
from keypose.kernels import fk, sample, skin, skincrowd, text
from keypose.kernels.runtime import WIDTH, aligned, aligned_copy, kernel
from keypose.math import quat

_CHECKED = 16  # characters compared with NumPy


def add(suite: Suite) -> None:
    """All rows of the suite."""
    _characters(suite)
    _text(suite)
    _whole_clips(suite)


_single = sample.single_character


@kernel
def _repeat_single(times, call):
    for _ in range(times):
        _single(call)


def _characters(suite: Suite) -> None:
    rng = np.random.default_rng(1)
    parents, offsets = data.body()
    motions = data.clips(offsets, rng)
    clips = sample.compile_clips(parents, motions)
    _one_character(suite, parents, motions, clips, *data.crowd(1, rng))
    _crowd(suite, parents, motions, clips, *data.crowd(16, rng))
    kept = _crowd(suite, parents, motions, clips, *data.crowd(256, rng))
    _crowd(suite, parents, motions, clips, *data.crowd(4096, rng))
    _skinning(suite, parents, offsets, *kept, rng)


def _chain(parents, motions, places, weights) -> np.ndarray:
    return plain.matrices(*plain.kinematics(parents, *plain.blend(motions, places, weights)))


def _one_character(suite, parents, motions, clips, places, weights) -> None:
    state = sample.mix(clips, np.arange(3), places, weights)
    out = sample.animate_one(clips, state)
    suite.check("one character: model matrices", abs(out - _chain(parents, motions, places, weights)[0]).max(), 2e-5)
    suite.case(
        "chain, 1 character, call from Python", "ns/character", 1, partial(sample.animate_one, clips, state, out),
        lambda: _chain(parents, motions, places, weights),
    )  # fmt: skip
    call = sample.single_call(clips, state, out)
    suite.case(
        "chain, 1 character, call inside a kernel", "ns/character", 200, lambda: _repeat_single(200, call.ctypes.data),
        lambda: _chain(parents, motions, places, weights), reference_count=1,
    )  # fmt: skip


def _crowd(suite, parents, motions, clips, places, weights) -> tuple[np.ndarray, np.ndarray]:
    characters = len(places)
    state = sample.mix(clips, np.arange(3), places, weights)
    models = sample.animate_crowd(clips, state)
    truth = _chain(parents, motions, places[:_CHECKED], weights[:_CHECKED])
    got = models.transpose(0, 3, 1, 2).reshape(-1, len(parents), 3, 4)[:_CHECKED]
    suite.check(f"crowd of {characters}: model matrices", abs(got - truth[:, :, :3]).max(), 2e-5)
    few, light = places[:256], weights[:256]  # more take NumPy no less for each
    suite.case(
        f"chain, {characters} characters", "ns/character", characters,
        lambda: sample.animate_crowd(clips, state, models), lambda: _chain(parents, motions, few, light),
        reference_count=len(few),
    )  # fmt: skip
    if characters == 256:
        _sampling(suite, parents, motions, clips, state, places, weights)
    return models, truth


def _sampling(suite, parents, motions, clips, state, places, weights) -> None:
    small = sample.compile_clips(parents, motions, quantized=True)
    truth = np.concatenate(plain.blend(motions, places, weights), axis=2)
    for name, made, limit in (("float32", clips, 2e-6), ("int16", small, 1e-4)):
        got = np.concatenate(sample.sample(made, state), axis=2)
        suite.check(f"{name} clips: local poses", abs(got - truth).max(), limit)
        poses = aligned(WIDTH * 7 * made.padded).reshape(WIDTH, 7, made.padded)
        suite.case(
            f"sample + blend only, {name} clips", "ns/character", len(places),
            lambda made=made, poses=poses: sample.sample_rows(made, state, poses),
            lambda: plain.blend(motions, places, weights),
        )  # fmt: skip


def _skinning(suite, parents, offsets, models, truth, rng) -> None:
    mesh, blocks = data.cloud(parents, offsets, rng), 64 // WIDTH
    count = len(mesh.positions)
    made = skin.compile_mesh(
        mesh.joints, mesh.weights, mesh.positions, mesh.normals, np.arange(len(parents)), mesh.joint_from_mesh
    )
    palette = (truth.astype(np.float64) @ mesh.joint_from_mesh).astype(np.float32)
    wanted = np.concatenate(plain.skin(palette, mesh.joints, mesh.weights, mesh.positions, mesh.normals), axis=2)
    per_character = {
        True: lambda: plain.skin(palette[:1], mesh.joints, mesh.weights, mesh.positions, mesh.normals),
        False: lambda: plain.skin(palette[:1], mesh.joints, mesh.weights, mesh.positions),
    }
    for normals, name in ((True, "position + normal"), (False, "position only")):
        rows = 6 if normals else 3
        got = skincrowd.skin_crowd(made, models[: -(-_CHECKED // WIDTH)], normals)
        got = got.transpose(0, 3, 1, 2).reshape(-1, count, rows)[:_CHECKED]
        suite.check(f"crowd skinning: {name}", abs(got - wanted[:, :, :rows]).max(), 2e-5)
        out = aligned(count * rows * WIDTH).reshape(1, count, rows, WIDTH)
        suite.case(
            f"skinning, crowd, {name}", "ns/vertex", WIDTH * count,
            lambda normals=normals, out=out: skincrowd.skin_crowd(made, models[:1], normals, out),
            per_character[normals], reference_count=count,
        )  # fmt: skip
    out = aligned(blocks * count * 6 * WIDTH).reshape(blocks, count, 6, WIDTH)
    suite.case(
        "skinning, crowd of 64, separate outputs, pos + normal", "ns/vertex", 64 * count,
        lambda: skincrowd.skin_crowd(made, models[:blocks], True, out), per_character[True], reference_count=count,
    )  # fmt: skip
    target: Any = skin.skin(made, palette[0], with_normals=True)
    suite.check("one character skinning", abs(np.concatenate(target, axis=1) - wanted[0]).max(), 2e-5)
    one = palette[0].copy()
    suite.case(
        "skinning, 1 character, position + normal", "ns/vertex", count,
        lambda: skin.skin(made, one, with_normals=True, out=target), per_character[True],
    )  # fmt: skip
    suite.case(
        "skinning, 1 character, position only", "ns/vertex", count,
        lambda: skin.skin(made, one, out=target), per_character[False],
    )  # fmt: skip


def _text(suite: Suite) -> None:
    header, numbers, content = data.bvh(np.random.default_rng(4))
    start = len(header)

    def read() -> np.ndarray:
        values, wrong = text.parse_numbers(content, start)
        return values if wrong < 0 else values[:0]

    suite.check("BVH parse: difference from float()", abs(read() - numbers.ravel()).max(), 0)
    same = header + text.format_numbers(numbers, 6) == content
    suite.check("BVH write: bytes that differ from '%.6f'", float(not same), 0)
    suite.case(
        "BVH motion parse", "MB/s", len(content), read,
        lambda: np.array(content[start:].split(), np.float64),
    )  # fmt: skip
    row = " ".join(["%.6f"] * numbers.shape[1]) + "\n"
    suite.case(
        "BVH motion write", "MB/s", len(content), lambda: header + text.format_numbers(numbers, 6),
        lambda: "".join([row % tuple(r) for r in numbers.tolist()]).encode(), against="Python's %",
    )  # fmt: skip


def _whole_clips(suite: Suite) -> None:
    rng = np.random.default_rng(5)
    parents, offsets = data.body(data.BODY_JOINTS)
    frames, joints = 10240, data.BODY_JOINTS
    rotations = data.unit(rng.normal(size=(frames, joints, 4))).astype(np.float32)
    roots, offsets = rng.normal(size=(frames, 3)).astype(np.float32), offsets.astype(np.float32)
    local = np.broadcast_to(offsets, (frames, joints, 3)).copy()
    local[:, 0] = roots
    truth = np.concatenate(plain.kinematics(parents, rotations.astype(np.float64), local.astype(np.float64)), axis=2)
    slow = lambda: plain.kinematics(parents, rotations, local)  # noqa: E731
    result = fk.rotations_positions(parents, rotations, offsets, roots)
    suite.check("clip FK, [frame, joint]", abs(np.concatenate(result, axis=2) - truth).max(), 2e-5)
    suite.case(
        "clip FK, 26 joints, [frame, joint]", "frames/s", frames,
        lambda: fk.rotations_positions(parents, rotations, offsets, roots, result), slow,
    )  # fmt: skip
    row = -(-joints * 4 // 16) * 16
    rows = aligned(frames * row).reshape(frames, row)
    rows[:, : joints * 4] = rotations.reshape(frames, -1)
    root_lanes = aligned_copy(roots.reshape(-1, WIDTH, 3).transpose(0, 2, 1)).reshape(-1, 3, WIDTH)
    out = fk.rotations_positions_lanes(parents, rows, offsets, root_lanes)
    suite.check("clip FK, lanes", abs(out.transpose(0, 3, 1, 2).reshape(frames, joints, 7) - truth).max(), 2e-5)
    suite.case(
        "clip FK, 26 joints, lanes", "frames/s", frames,
        lambda: fk.rotations_positions_lanes(parents, rows, offsets, root_lanes, out), slow,
    )  # fmt: skip
    _slerp(suite, rotations.reshape(-1, 4), frames * 25, rng)


def _slerp(suite: Suite, rotations: np.ndarray, count: int, rng: np.random.Generator) -> None:
    a, b, t = rotations[:count], rotations[-count:], rng.random(count).astype(np.float32)
    truth = quat.slerp(a.astype(np.float64), b.astype(np.float64), t.astype(np.float64))
    suite.check("slerp, [n, 4]", abs(sample.slerp(a, b, t) - truth).max(), 1e-4)
    rows = aligned_copy(a.T).reshape(4, count), aligned_copy(b.T).reshape(4, count)
    steps, out = aligned_copy(t), aligned(4 * count).reshape(4, count)
    suite.check("slerp, lanes", abs(sample.slerp_lanes(*rows, steps, out).T - truth).max(), 1e-4)
    slow = lambda: quat.slerp(a, b, t)  # noqa: E731
    suite.case("slerp, [n, 4]", "slerps/s", count, lambda: sample.slerp(a, b, t), slow)
    suite.case("slerp, lanes", "slerps/s", count, lambda: sample.slerp_lanes(*rows, steps, out), slow)
