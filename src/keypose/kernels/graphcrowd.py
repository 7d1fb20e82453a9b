# pyright: basic
"""Crowds of animation graphs: one character's step after the other, then the skeletons of W of them at once.

A step's control is scalar, its pose has joints in the lanes (`graphstep`). When W characters have their poses, these are
transposed and the hierarchy is walked with characters in the lanes, as in `keypose.kernels.crowd`.
"""

from __future__ import annotations

import math

from keypose.kernels import crowd as clips
from keypose.kernels.graphclips import compose
from keypose.kernels.graphmachines import enter
from keypose.kernels.graphposes import ZERO, settle_here
from keypose.kernels.graphstep import control, pose
from keypose.kernels.graphtables import (
    CHARACTER,
    CLIP_HANDLES,
    CURVES,
    EFFECTORS,
    EXTRAS,
    FINAL,
    JOINTS,
    JOINTS_NOW,
    PADDED,
    PARENTS,
    POSE,
    QUEUE_ROOM,
    QUEUED,
    STATE_FLOATS,
    STATE_INTS,
    STEP_NUMBER,
    TRAVEL,
)
from keypose.kernels.rotations import load3, load4, quat_matrix, store4
from keypose.kernels.runtime import WIDTH, exact_kernel, kernel
from keypose.kernels.vectors import float32_at, float64_at, int64_at, load, splat, store, transpose

# The numbers of a crowd, beside those of a graph.
(
    GRAPH, CHARACTERS, BLOCKS, FLOAT_COUNT, INT_COUNT, ALL_FLOATS, ALL_INTS, NUMBERS_OF, ROOTS, ROOT_STEPS, WAITED,
    EVERY, JOINTS_OF, INPUTS, INPUT_COUNT, HALF_LIVES, KEEPS, BACKUP, FINALS, TURNED, MODELS, MORPHS, TOUCHING, APPLY_ROOT, CLOCK,
    ORIGINAL, OUTPUT,
) = range(27)  # fmt: skip
INPUT = 3  # of a parameter: slot, width, whether it is smoothed
DONE = -1


@kernel
def _select(g, h, n):
    """Make a character the one that is worked on."""
    h[CHARACTER] = n
    h[STATE_FLOATS] = g[ALL_FLOATS] + 8 * n * g[FLOAT_COUNT]
    h[STATE_INTS] = g[ALL_INTS] + 8 * n * g[INT_COUNT]
    h[STEP_NUMBER] = int64_at(g[NUMBERS_OF])[n]


@kernel
def start_all(crowd):
    """Enter the graph with every character."""
    g = int64_at(crowd)
    h = int64_at(g[GRAPH])
    for n in range(g[CHARACTERS]):
        _select(g, h, n)
        enter(h, ZERO)


@kernel
def start_one(crowd, n):
    """Enter the graph with one character."""
    g = int64_at(crowd)
    h = int64_at(g[GRAPH])
    _select(g, h, n)
    enter(h, ZERO)


@exact_kernel
def _keep(g, dt_s):
    """How much of each parameter's old value is left after a time."""
    halves, keeps = float64_at(g[HALF_LIVES]), float64_at(g[KEEPS])
    for k in range(g[INPUT_COUNT]):
        keeps[k] = 2.0 ** (-dt_s / halves[k]) if halves[k] > 0 else 0.0


@exact_kernel
def _smooth_inputs(g, h):
    """What was set becomes what is used, at once or by its half-life."""
    floats, inputs, keeps = float64_at(h[STATE_FLOATS]), int64_at(g[INPUTS]), float64_at(g[KEEPS])
    for k in range(g[INPUT_COUNT]):
        slot, width, keep = inputs[INPUT * k], inputs[INPUT * k + 1], keeps[k]
        if inputs[INPUT * k + 2]:
            for i in range(slot, slot + width):
                wanted = floats[i + width]
                floats[i] = wanted + keep * (floats[i] - wanted)


@kernel
def _animate_character(g, h, n, dt_s):
    """One step of one character; False, and nothing has changed, where the queue of events is too short."""
    _select(g, h, n)
    floats, ints, backup = float64_at(h[STATE_FLOATS]), int64_at(h[STATE_INTS]), float64_at(g[BACKUP])
    kept = int64_at(g[BACKUP])
    float_count, int_count, queued = g[FLOAT_COUNT], g[INT_COUNT], h[QUEUED]
    for i in range(float_count):
        backup[i] = floats[i]
    for i in range(int_count):
        kept[float_count + i] = ints[i]
    clips_of = int64_at(h[CLIP_HANDLES])
    clips_of[clips.TICK] += 1
    _smooth_inputs(g, h)
    control(h, dt_s)
    if h[QUEUED] > h[QUEUE_ROOM]:
        for i in range(float_count):
            floats[i] = backup[i]
        for i in range(int_count):
            ints[i] = kept[float_count + i]
        h[QUEUED] = queued
        return False
    travel, root, step = float64_at(h[TRAVEL]), float64_at(g[ROOTS]), float64_at(g[ROOT_STEPS])
    x, z, a = compose(root[3 * n], root[3 * n + 1], root[3 * n + 2], travel[0], travel[1], travel[2])
    root[3 * n], root[3 * n + 1], root[3 * n + 2] = x, z, a
    for i in range(3):
        step[3 * n + i] = travel[i]
    pose(h, ZERO, ZERO)
    settle_here(h, ZERO)
    final = float32_at(h[FINAL])
    extras, curves, contacts = h[POSE] - h[EXTRAS], h[CURVES], h[EFFECTORS]
    morphs, touching = float32_at(g[MORPHS]), float32_at(g[TOUCHING])
    for i in range(curves):
        morphs[n * curves + i] = final[extras + i]
    for i in range(contacts):
        touching[n * contacts + i] = min(max(final[extras + curves + 3 * contacts + i], 0.0), 1.0)
    int64_at(g[NUMBERS_OF])[n] += 1
    return True


@kernel
def _walk(g, h, block, present):
    """The model matrices of a block from its characters' poses."""
    c = int64_at(h[CLIP_HANDLES])
    joints, padded, pose = h[JOINTS_NOW], h[PADDED], h[POSE]
    moved, scaled = c[clips.MOVED], c[clips.SCALED]
    moved_at, scaled_at, rest = int64_at(c[clips.MOVED_AT]), int64_at(c[clips.SCALED_AT]), float32_at(c[clips.REST])
    parents, original = int64_at(h[PARENTS]), int64_at(g[ORIGINAL])
    finals, turned, out, place = (
        float32_at(g[FINALS]),
        float32_at(g[TURNED]),
        float32_at(g[MODELS]),
        float32_at(g[OUTPUT]),
    )
    for i in range(present, WIDTH):  # the last character fills up its block
        for at in range(0, pose, WIDTH):
            store(finals, i * pose + at, load(finals, (present - 1) * pose + at))
    base = block * h[JOINTS] * 12 * WIDTH
    stride = clips.ROWS * WIDTH
    cosine, sine, east, north = load4(place, 0, WIDTH)
    for j in range(0, joints, WIDTH):
        moves, grows = moved_at[j // clips.GROUP], scaled_at[j // clips.GROUP]
        for row in range(4):
            transpose(finals, row * padded + j, pose, turned, row * WIDTH, stride)
        if moves >= 0:
            for row in range(3):
                first = 4 * padded + row * moved + moves + j % clips.GROUP
                transpose(finals, first, pose, turned, (4 + row) * WIDTH, stride)
        if grows >= 0:
            for row in range(3):
                first = 4 * padded + 3 * moved + row * scaled + grows + j % clips.GROUP
                transpose(finals, first, pose, turned, (7 + row) * WIDTH, stride)
        for k in range(j, min(j + WIDTH, joints)):
            here, up = (k - j) * stride, parents[k]
            w, x, y, z = load4(turned, here, WIDTH)
            a, b, cc, d, e, f, gg, hh, i9 = quat_matrix(w, x, y, z)
            if moves >= 0:
                tx, ty, tz = load3(turned, here + 4 * WIDTH, WIDTH)
            else:
                tx, ty, tz = splat(rest, k), splat(rest, padded + k), splat(rest, 2 * padded + k)
            if grows != clips.UNIT:
                if grows >= 0:
                    sx, sy, sz = load3(turned, here + 7 * WIDTH, WIDTH)
                else:
                    sx, sy, sz = splat(rest, 3 * padded + k), splat(rest, 4 * padded + k), splat(rest, 5 * padded + k)
                a, b, cc = a * sx, b * sy, cc * sz
                d, e, f = d * sx, e * sy, f * sz
                gg, hh, i9 = gg * sx, hh * sy, i9 * sz
            to = base + original[k] * 12 * WIDTH
            if up < 0:
                store4(
                    out, to, WIDTH,
                    cosine * a + sine * gg, cosine * b + sine * hh, cosine * cc + sine * i9,
                    cosine * tx + sine * tz + east,
                )  # fmt: skip
                store4(out, to + 4 * WIDTH, WIDTH, d, e, f, ty)
                store4(
                    out, to + 8 * WIDTH, WIDTH,
                    cosine * gg - sine * a, cosine * hh - sine * b, cosine * i9 - sine * cc,
                    cosine * tz - sine * tx + north,
                )  # fmt: skip
            else:
                above = base + original[up] * 12 * WIDTH
                for row in range(3):
                    p, q, r, t = load4(out, above + 4 * row * WIDTH, WIDTH)
                    store4(
                        out, to + 4 * row * WIDTH, WIDTH, p * a + q * d + r * gg, p * b + q * e + r * hh,
                        p * cc + q * f + r * i9, p * tx + q * ty + r * tz + t,
                    )  # fmt: skip


@kernel
def animate(crowd, first_block, last_block, dt_s, resume):
    """A step of a range of blocks; `DONE`, or the character before which the queue of events was too short.

    ``resume``: the character to go on with, or `DONE`. Blocks are due every ``EVERY``-th call, with all the time that has passed.
    """
    g = int64_at(crowd)
    h = int64_at(g[GRAPH])
    every, joints_of, waited = int64_at(g[EVERY]), int64_at(g[JOINTS_OF]), float64_at(g[WAITED])
    root, place = float64_at(g[ROOTS]), float32_at(g[OUTPUT])
    clock, known, applied = g[CLOCK], -1.0, g[APPLY_ROOT] != 0
    for block in range(first_block, last_block):
        begins = block * WIDTH
        if resume >= begins + WIDTH:
            continue
        if resume < begins:
            waited[block] += dt_s
        if (clock + block) % every[block] != 0:
            continue
        if waited[block] != known:
            known = waited[block]
            _keep(g, known)
        h[JOINTS_NOW] = joints_of[block]
        present = min(g[CHARACTERS] - begins, WIDTH)
        for i in range(max(resume - begins, 0), present):
            h[FINAL] = g[FINALS] + 4 * i * h[POSE]
            if not _animate_character(g, h, begins + i, known):
                return begins + i
        waited[block] = 0.0
        for i in range(WIDTH):
            n = 3 * (begins + min(i, present - 1))
            place[i] = math.cos(root[n + 2]) if applied else 1.0
            place[WIDTH + i] = math.sin(root[n + 2]) if applied else 0.0
            place[2 * WIDTH + i] = root[n] if applied else 0.0
            place[3 * WIDTH + i] = root[n + 1] if applied else 0.0
        _walk(g, h, block, present)
    return DONE
