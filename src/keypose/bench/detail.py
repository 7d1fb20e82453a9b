# pyright: basic
"""Crowd skinning beside what memory can take, and with level of detail."""

from __future__ import annotations

import numpy as np

from keypose import deform, evaluate, samples
from keypose.bench import data, plain
from keypose.bench.suite import Suite
from keypose.kernels import sample, skin, skincrowd
from keypose.kernels.runtime import WIDTH, aligned, kernel
from keypose.kernels.vectors import fill, store_past
from keypose.play import detail as lod
from keypose.play import steering
from keypose.samples import crowds

_CHECKED = 16  # characters compared with NumPy
_MANY = 1008  # characters whose vertices no cache holds
_LIMIT = "memory, as many bytes:"


def add(suite: Suite) -> None:
    """All rows of crowd skinning."""
    _skinning(suite)
    _levels(suite)


@kernel
def _fill_past(out, number):
    v = fill(out, number)
    for i in range(0, out.shape[0], 4 * WIDTH):
        store_past(out, i, v)
        store_past(out, i + WIDTH, v)
        store_past(out, i + 2 * WIDTH, v)
        store_past(out, i + 3 * WIDTH, v)


def _skinning(suite: Suite) -> None:
    """The mesh that other benchmarks of the same work have: 4,000 vertices, four joints each."""
    rng = np.random.default_rng(1)
    parents, offsets = data.body()
    motions = data.clips(offsets, rng)
    places, weights = data.crowd(_MANY, rng)
    clips = sample.compile_clips(parents, motions)
    models = sample.animate_crowd(clips, sample.mix(clips, np.arange(3), places, weights))
    mesh = data.cloud(parents, offsets, rng)
    count = len(mesh.positions)
    made = skin.compile_mesh(
        mesh.joints, mesh.weights, mesh.positions, mesh.normals, np.arange(len(parents)), mesh.joint_from_mesh
    )
    few = models[: -(-_CHECKED // WIDTH)]
    square = np.tile(np.eye(4), (_CHECKED, len(parents), 1, 1))
    square[:, :, :3] = few.transpose(0, 3, 1, 2).reshape(-1, len(parents), 3, 4)[:_CHECKED]
    palette = (square @ mesh.joint_from_mesh).astype(np.float32)
    wanted = np.concatenate(plain.skin(palette, mesh.joints, mesh.weights, mesh.positions, mesh.normals), axis=2)
    got = skincrowd.skin_crowd(made, few, True).transpose(0, 3, 1, 2).reshape(-1, count, 6)[:_CHECKED]
    suite.check("crowd skinning: position + normal", abs(got - wanted).max(), 2e-5)
    one = aligned(count * 6 * WIDTH).reshape(1, count, 6, WIDTH)
    suite.case(
        "skinning, crowd, position + normal", "ns/vertex", WIDTH * count,
        lambda: skincrowd.skin_crowd(made, models[:1], True, one),
        lambda: plain.skin(palette[:1], mesh.joints, mesh.weights, mesh.positions, mesh.normals), "NumPy", count,
    )  # fmt: skip
    for characters in (64, _MANY):
        blocks = characters // WIDTH
        # Each side has a memory of its own.
        out = aligned(blocks * count * 6 * WIDTH).reshape(blocks, count, 6, WIDTH)
        other = aligned(out.size)
        name = f"skinning, crowd of {characters:,}, separate outputs, pos + normal"
        suite.case(
            name, "ns/vertex", characters * count,
            lambda blocks=blocks, out=out: skincrowd.skin_crowd(made, models[:blocks], True, out),
            lambda other=other: _fill_past(other, 1.5), _LIMIT, note=f"{out.nbytes / 2**20:.0f} MB",
        )  # fmt: skip
    past = aligned(64 << 20)
    past[:] = 1
    suite.case("limit: store 256 MB (RAM), past the caches", "GB/s", past.nbytes, lambda: _fill_past(past, 1.5))


def _levels(suite: Suite) -> None:
    """A thousand of the built-in human on a round place, seen from its edge."""
    human, levels = samples.load("human").character, crowds.levels()
    count, radius = 1000, 48.0
    roots = steering.place(count, radius, 1)
    models = _standing(human, roots)
    heights = lod.view_heights(roots[:, :2], np.array([0.0, 3.0, radius]), 1.7, 35.0)
    crowd = lod.prepare(levels, count)
    lod.choose(crowd, heights)
    for _ in range(4):
        lod.skin(crowd, models)
    worst = 0.0
    square = np.tile(np.eye(4), (WIDTH, human.skeleton.joint_count, 1, 1))
    square[:, :, :3] = models[0].transpose(2, 0, 1).reshape(WIDTH, -1, 3, 4)
    for character in range(WIDTH):
        level = levels[crowd.level[character]]
        true = deform.skin(level.mesh, level.skin, square[character])
        worst = max(worst, abs(lod.vertices_of(crowd, character)[0] - true).max())
    suite.check("crowd skinning with level of detail: metres", worst, 1e-4)
    finest = levels[0]
    few = models[: 128 // WIDTH]
    whole = aligned(len(few) * finest.mesh.vertex_count * 6 * WIDTH).reshape(len(few), -1, 6, WIDTH)
    suite.case(
        "crowd skinning with level of detail, 1,000 characters", "characters/ms", count,
        lambda: lod.skin(crowd, models),
        lambda: skincrowd.skin_crowd(finest.compiled, few, True, whole), "all at the finest level:", len(few) * WIDTH,
        note=f"{finest.mesh.vertex_count:,} vertices at the finest; at each level {'/'.join(map(str, crowd.shown))}",
    )  # fmt: skip
    for n, level in enumerate(levels):
        out = aligned(level.mesh.vertex_count * 6 * WIDTH).reshape(1, -1, 6, WIDTH)
        suite.case(
            f"skinning, built-in human, level {n}, position + normal", "ns/vertex", WIDTH * level.mesh.vertex_count,
            lambda level=level, out=out: skincrowd.skin_crowd(level.compiled, models[:1], True, out),
            note=f"{level.mesh.vertex_count:,} vertices, {level.triangle_count:,} triangles, {level.joint_count} joints, "
            f"{1e3 * level.error.max_m:.0f} mm at most, {1e3 * level.error.rms_m:.1f} mm RMS",
        )  # fmt: skip


def _standing(human, roots) -> np.ndarray:
    """Everybody in some pose of the performances, at a place, in lanes."""
    examples = crowds.examples()
    own = np.asarray(evaluate.world(human.skeleton, examples))
    own[:, :, [0, 2], 3] -= own[:, :1, [0, 2], 3]
    sin, cos = np.sin(roots[:, 2]), np.cos(roots[:, 2])
    world = np.tile(np.eye(4), (len(roots), 1, 1))
    world[:, 0, 0], world[:, 0, 2], world[:, 2, 0], world[:, 2, 2] = cos, sin, -sin, cos
    world[:, [0, 2], 3] = roots[:, :2]
    placed = (world[:, None] @ own[np.arange(len(roots)) % len(own)])[:, :, :3]
    blocks = -(-len(roots) // WIDTH)
    rows = np.zeros((blocks * WIDTH, human.skeleton.joint_count, 12), np.float32)
    rows[: len(roots)] = placed.reshape(len(roots), -1, 12)
    lanes = rows.reshape(blocks, WIDTH, -1, 12).transpose(0, 2, 3, 1)
    out = aligned(lanes.size).reshape(lanes.shape)
    out[:] = lanes
    return out
