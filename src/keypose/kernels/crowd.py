# pyright: basic
"""Many characters that play compressed clips: sample, blend, walk the hierarchy with scale.

Decoding a pose takes longer than everything else together, and characters of a crowd are often between the same two
samples of a clip. So decoded samples (*knots*) are kept in a pool of fixed size, first in, first out; a knot that a
block of W characters needs is never thrown out before the block is done. From there it goes as in
`keypose.kernels.sample`: joints in the lanes to sample and blend, a register transpose, characters in the lanes to walk.
Here the hierarchy is walked in 3x4 matrices, for a scale above a rotation gives shear; the parent's matrix is read
from where the result was just written.

Between two knots rotations are interpolated component by component (nlerp); translations and scales are linear.

Layout
    knots    float32  [slot][4 x padded, then 3 x moving translations, then 3 x moving scales]
    clips    int64    per clip CLIP numbers: addresses of layout, tables, book and codes (see `kernels.decode`), its first
                      knot in the numbering of all clips, how many it has, how many for each sample, whether it loops
    models   float32  [block][joint][12][W]: rows of 3x4 matrices, characters in the lanes
"""

from __future__ import annotations

import numpy as np

from keypose.kernels.decode import CELLS, FRAME_COUNT, FRAMES, SLOTS, TRACKS, decode_pose
from keypose.kernels.rotations import load3, load4, quat_matrix, store3, store4
from keypose.kernels.runtime import WIDTH, inlined, intrinsic, kernel
from keypose.kernels.vectors import (
    flip_sign,
    float32_at,
    float64_at,
    int64_at,
    load,
    load_sixteen,
    pointer,
    rsqrt,
    shuffle,
    splat,
    store,
    transpose,
    uint8_at,
)

GROUP = 16
ROWS = 10
CLIP = 8
LAYOUT, TABLES, BOOK, CODES, FIRST_KNOT, KNOTS, FINENESS, LOOP = range(CLIP)
# Where the one array of sizes and addresses holds what.
(
    JOINTS, PADDED, CLIP_COUNT, MOVED, SCALED, KNOT_SIZE, SLOT_COUNT, HAND, TICK, DECODED, CLIP_TABLE, TIMING, KNOT_TIMES,
    SLOT_OF, KNOT_OF, STAMPS, POOL, MOVED_AT, SCALED_AT, REST, PARENTS, PLACES, SHARES, POSES, SUMS, ROOM,
    LOCAL, MODEL,
) = range(28)  # fmt: skip
STILL, UNIT = -1, -2  # in MOVED_AT and SCALED_AT: the group is constant; it is constant and 1
FINE, BAD_CLIP, BAD_TIME, BAD_WEIGHT = range(4)


@inlined
def _wrong(which, times_s, weights, count, clips):
    """What is wrong with the numbers of a crowd, before anything is done with them."""
    wrong = FINE
    for n in range(count):
        if which[n] < 0 or which[n] >= clips:
            wrong = BAD_CLIP
        if not abs(times_s[n]) < np.inf:
            wrong = BAD_TIME
        if not (weights[n] >= 0 and weights[n] < np.inf):
            wrong = BAD_WEIGHT
    return wrong


@inlined
def _frame_at(time_s, start_s, rate_hz, frames, loop):
    """As `decode.frame_at`, without the division of Python, which takes as long as sampling."""
    last = float(frames - 1)
    position = (time_s - start_s) * rate_hz
    if loop and last > 0:
        position -= np.floor(position / last) * last
    if not position >= 0.0:  # before the start; or so far away that it is no number any more
        position = 0.0
    position = min(position, last)
    frame = min(np.int64(position), max(frames - 2, 0))
    return frame, position - frame


@inlined
def _knot_at(layout, frame, share):
    """The knot at or before a place of a clip, and how far it is to the next; as `decode_pose` finds them."""
    if layout[TRACKS] == 0:
        return np.int64(0), 0.0
    slot = frame >> 4
    entry = layout[layout[SLOTS] + slot]
    position = frame - slot * FRAMES + share
    cells = 1 << (entry & 7)
    cell = min(int(position * cells) >> 4, cells - 1)
    found = layout[layout[CELLS] + (entry >> 3) + cell]
    samples = 1 << (found & 7)
    position *= samples
    sample = min(int(position), FRAMES * samples - 1)
    return (found >> 3) * FRAMES + (sample & (FRAMES - 1)), position - sample


@inlined
def _copy_groups(room, first, padded, places, pool, to, width):
    """Three rows, only the groups of joints that have a place."""
    for group in range(padded // GROUP):
        if places[group] >= 0:
            for row in range(3):
                for k in range(0, GROUP, WIDTH):
                    value = load(room, first + row * padded + group * GROUP + k)
                    store(pool, to + row * width + places[group] + k, value)


@kernel
def _decode_knot(handles, clip, knot, slot):
    """Decode one sample of one clip into the pool."""
    table = int64_at(handles[CLIP_TABLE])
    layout = int64_at(table[clip * CLIP + LAYOUT])
    decoder = (
        layout,
        float32_at(table[clip * CLIP + TABLES]),
        uint8_at(table[clip * CLIP + BOOK]),
        uint8_at(table[clip * CLIP + CODES]),
    )
    at = min(float64_at(handles[KNOT_TIMES])[knot], float(layout[FRAME_COUNT] - 1))
    frame = int(at)
    room, pool = float32_at(handles[ROOM]), float32_at(handles[POOL])
    decode_pose(decoder, frame, at - frame, float32_at(handles[SUMS]), room, 0)
    padded, moved, scaled = handles[PADDED], handles[MOVED], handles[SCALED]
    to = slot * handles[KNOT_SIZE]
    for k in range(0, 4 * padded, WIDTH):
        store(pool, to + k, load(room, k))
    _copy_groups(room, 4 * padded, padded, int64_at(handles[MOVED_AT]), pool, to + 4 * padded, moved)
    _copy_groups(room, 7 * padded, padded, int64_at(handles[SCALED_AT]), pool, to + 4 * padded + 3 * moved, scaled)


@inlined
def _pooled(handles, clip, knot, slot_of, knot_of, stamps):
    """Where the pool holds a knot; it is decoded if it does not yet."""
    slot = slot_of[knot]
    if slot < 0:
        slots, tick = handles[SLOT_COUNT], handles[TICK]
        slot = handles[HAND]
        while stamps[slot] == tick:  # this block needs it
            slot = slot + 1 if slot + 1 < slots else 0
        handles[HAND] = slot + 1 if slot + 1 < slots else 0
        if knot_of[slot] >= 0:
            slot_of[knot_of[slot]] = -1
        _decode_knot(handles, clip, knot, slot)
        handles[DECODED] += 1
        slot_of[knot], knot_of[slot] = slot, knot
    stamps[slot] = handles[TICK]
    return slot * handles[KNOT_SIZE]


@kernel
def _place(handles, which, times_s, weights, first, many, to):
    """Where the pool holds the two knots of each clip of a character, the share between them and the clip's weight."""
    table, timing = int64_at(handles[CLIP_TABLE]), float64_at(handles[TIMING])
    slot_of, knot_of = int64_at(handles[SLOT_OF]), int64_at(handles[KNOT_OF])
    stamps, places, shares = int64_at(handles[STAMPS]), int64_at(handles[PLACES]), float32_at(handles[SHARES])
    total = 0.0
    for k in range(many):
        total += weights[first + k]
    for k in range(many):
        clip = which[first + k]
        row = clip * CLIP
        layout = int64_at(table[row + LAYOUT])
        start_s, rate_hz = timing[2 * clip], timing[2 * clip + 1]
        frame, part = _frame_at(times_s[first + k], start_s, rate_hz, layout[FRAME_COUNT], table[row + LOOP] != 0)
        knot, share = _knot_at(layout, frame, part)
        fineness = table[row + FINENESS]
        share *= fineness
        part_of = min(int(share), fineness - 1)
        knot, share = knot * fineness + part_of, share - part_of
        after = min(knot + 1, table[row + KNOTS] - 1) if share > 0 else knot
        base = table[row + FIRST_KNOT]
        places[to + 2 * k] = _pooled(
            handles, clip, base + knot, slot_of, knot_of, stamps
        )  # fmt: skip
        places[to + 2 * k + 1] = _pooled(
            handles, clip, base + after, slot_of, knot_of, stamps
        )  # fmt: skip
        shares[to + 2 * k] = np.float32(share)
        # Where nothing weighs anything the first clip is played.
        own = weights[first + k] / total if total > 0 else 1.0 if k == 0 else 0.0
        shares[to + 2 * k + 1] = np.float32(own)


@inlined
def _length_factor(w, x, y, z):
    """1 / length by the series about length 1; knots 30 degrees apart shorten a quaternion to 0.991."""
    n = w * w + x * x + y * y + z * z
    return 1.875 + n * (0.375 * n - 1.25)


@inlined
def _between4(pool, a, b, stride, t):
    w, x, y, z = load4(pool, a, stride)
    bw, bx, by, bz = load4(pool, b, stride)
    return w + t * (bw - w), x + t * (bx - x), y + t * (by - y), z + t * (bz - z)


@inlined
def _rotations(pool, places, shares, first, many, j, padded):
    """Rotations of W joints of one character from joint j on, blended over its clips."""
    w, x, y, z = _between4(pool, places[first] + j, places[first + 1] + j, padded, splat(shares, first))
    r = splat(shares, first + 1) * _length_factor(w, x, y, z)
    sw, sx, sy, sz = w * r, x * r, y * r, z * r
    for k in range(first + 2, first + 2 * many, 2):
        w, x, y, z = _between4(pool, places[k] + j, places[k + 1] + j, padded, splat(shares, k))
        r = splat(shares, k + 1) * _length_factor(w, x, y, z)
        r = flip_sign(r, w * sw + x * sx + y * sy + z * sz)
        sw, sx, sy, sz = sw + w * r, sx + x * r, sy + y * r, sz + z * r
    r = rsqrt(sw * sw + sx * sx + sy * sy + sz * sz)
    return sw * r, sx * r, sy * r, sz * r


@inlined
def _vectors(pool, places, shares, first, many, at, width):
    """Translations or scales of W joints of one character, blended over its clips."""
    t, weight = splat(shares, first), splat(shares, first + 1)
    x, y, z = load3(pool, places[first] + at, width)
    bx, by, bz = load3(pool, places[first + 1] + at, width)
    x, y, z = weight * (x + t * (bx - x)), weight * (y + t * (by - y)), weight * (z + t * (bz - z))
    for k in range(first + 2, first + 2 * many, 2):
        t, weight = splat(shares, k), splat(shares, k + 1)
        ax, ay, az = load3(pool, places[k] + at, width)
        bx, by, bz = load3(pool, places[k + 1] + at, width)
        x, y = x + weight * (ax + t * (bx - ax)), y + weight * (ay + t * (by - ay))
        z = z + weight * (az + t * (bz - az))
    return x, y, z


@kernel
def animate(state, which, times_s, weights, models):
    """Sample, blend and walk all characters; `FINE` or what is wrong with the numbers, and then nothing is written.

    ``which``, ``times_s`` and ``weights`` are (characters, clips each).
    """
    characters, many, blocks = which.shape[0], which.shape[1], models.shape[0]
    clip_of, time_of, weight_of, out = pointer(which), pointer(times_s), pointer(weights), pointer(models)
    handles = pointer(state)
    wrong = _wrong(clip_of, time_of, weight_of, characters * many, handles[CLIP_COUNT])
    if wrong != FINE:
        return wrong
    joints, padded, moved, scaled = handles[JOINTS], handles[PADDED], handles[MOVED], handles[SCALED]
    pool, poses, rest = float32_at(handles[POOL]), float32_at(handles[POSES]), float32_at(handles[REST])
    places, shares = int64_at(handles[PLACES]), float32_at(handles[SHARES])
    moved_at, scaled_at, parents = int64_at(handles[MOVED_AT]), int64_at(handles[SCALED_AT]), int64_at(handles[PARENTS])
    turned = ROWS * WIDTH * WIDTH  # where the transposed poses are
    translations_at, scales_at = 4 * padded, 4 * padded + 3 * moved
    for block in range(blocks):
        handles[TICK] += 1
        present = min(characters - block * WIDTH, WIDTH)
        for i in range(present):
            _place(
                handles, clip_of, time_of, weight_of, (block * WIDTH + i) * many, many, 2 * i * many
            )  # fmt: skip
        base = block * joints * 12 * WIDTH
        for j in range(0, joints, WIDTH):
            moves, grows = moved_at[j // GROUP], scaled_at[j // GROUP]
            for i in range(WIDTH):
                at, first = i * ROWS * WIDTH, 2 * min(i, present - 1) * many
                if i < present:
                    w, x, y, z = _rotations(pool, places, shares, first, many, j, padded)
                    store4(poses, at, WIDTH, w, x, y, z)
                    if moves >= 0:
                        x, y, z = _vectors(
                            pool, places, shares, first, many, translations_at + moves + j % GROUP, moved
                        )
                        store3(poses, at + 4 * WIDTH, WIDTH, x, y, z)
                    if grows >= 0:
                        x, y, z = _vectors(pool, places, shares, first, many, scales_at + grows + j % GROUP, scaled)
                        store3(poses, at + 7 * WIDTH, WIDTH, x, y, z)
                else:  # the last character fills up its block
                    for row in range(ROWS):
                        store(poses, at + row * WIDTH, load(poses, at + (row - ROWS) * WIDTH))
            for row in range(ROWS):
                if row < 4 or (row < 7 and moves >= 0) or (row >= 7 and grows >= 0):
                    transpose(poses, row * WIDTH, ROWS * WIDTH, poses, turned + row * WIDTH, ROWS * WIDTH)
            for k in range(j, min(j + WIDTH, joints)):
                here, up = turned + (k - j) * ROWS * WIDTH, parents[k]
                w, x, y, z = load4(poses, here, WIDTH)
                a, b, c, d, e, f, g, h, i9 = quat_matrix(w, x, y, z)
                if moves >= 0:
                    tx, ty, tz = load3(poses, here + 4 * WIDTH, WIDTH)
                else:
                    tx, ty, tz = splat(rest, k), splat(rest, padded + k), splat(rest, 2 * padded + k)
                if grows != UNIT:
                    if grows >= 0:
                        sx, sy, sz = load3(poses, here + 7 * WIDTH, WIDTH)
                    else:
                        sx, sy, sz = (
                            splat(rest, 3 * padded + k),
                            splat(rest, 4 * padded + k),
                            splat(rest, 5 * padded + k),
                        )
                    a, b, c = a * sx, b * sy, c * sz
                    d, e, f = d * sx, e * sy, f * sz
                    g, h, i9 = g * sx, h * sy, i9 * sz
                to = base + k * 12 * WIDTH
                if up < 0:
                    store4(out, to, WIDTH, a, b, c, tx)
                    store4(out, to + 4 * WIDTH, WIDTH, d, e, f, ty)
                    store4(out, to + 8 * WIDTH, WIDTH, g, h, i9, tz)
                else:
                    above = base + up * 12 * WIDTH
                    for row in range(3):
                        p, q, r, t = load4(out, above + 4 * row * WIDTH, WIDTH)
                        store4(
                            out, to + 4 * row * WIDTH, WIDTH, p * a + q * d + r * g, p * b + q * e + r * h,
                            p * c + q * f + r * i9, p * tx + q * ty + r * tz + t,
                        )  # fmt: skip
    return FINE


# --- one character: joints in the lanes, then one matrix in a register ------------------------------------------------------


@intrinsic
def _multiply(typing, a, b):
    """The product of two 4x4 matrices, each sixteen numbers row by row."""

    def generate(context, builder, sig, args):
        total = None
        for k in range(4):
            column = shuffle(builder, args[0], args[0], [4 * (n // 4) + k for n in range(16)])
            row = shuffle(builder, args[1], args[1], [4 * k + n % 4 for n in range(16)])
            product = builder.fmul(column, row, flags=("contract", "nsz"))
            total = product if total is None else builder.fadd(total, product, flags=("contract", "nsz"))
        return total

    return a(a, b), generate


@kernel
def animate_one(state, which, times_s, weights):
    """The whole chain for one character; `FINE` or what is wrong with the numbers.

    ``which``, ``times_s`` and ``weights`` are (clips,); the matrices [joint][16] are left at ``MODEL``.
    """
    handles, many = pointer(state), which.shape[0]
    clip_of, time_of, weight_of = pointer(which), pointer(times_s), pointer(weights)
    wrong = _wrong(clip_of, time_of, weight_of, many, handles[CLIP_COUNT])
    if wrong != FINE:
        return wrong
    handles[TICK] += 1
    _place(handles, clip_of, time_of, weight_of, 0, many, 0)
    joints, padded, moved, scaled = handles[JOINTS], handles[PADDED], handles[MOVED], handles[SCALED]
    pool, rest, local, out = (
        float32_at(handles[POOL]),
        float32_at(handles[REST]),
        float32_at(handles[LOCAL]),
        float32_at(handles[MODEL]),
    )
    places, shares = int64_at(handles[PLACES]), float32_at(handles[SHARES])
    moved_at, scaled_at, parents = int64_at(handles[MOVED_AT]), int64_at(handles[SCALED_AT]), int64_at(handles[PARENTS])
    matrices = 16 * WIDTH  # after the rows, of which the last four are 0 0 0 1
    for j in range(0, padded, WIDTH):
        moves, grows = moved_at[j // GROUP], scaled_at[j // GROUP]
        w, x, y, z = _rotations(pool, places, shares, 0, many, j, padded)
        a, b, c, d, e, f, g, h, i = quat_matrix(w, x, y, z)
        if moves >= 0:
            tx, ty, tz = _vectors(pool, places, shares, 0, many, 4 * padded + moves + j % GROUP, moved)
        else:
            tx, ty, tz = load3(rest, j, padded)
        if grows != UNIT:
            if grows >= 0:
                sx, sy, sz = _vectors(pool, places, shares, 0, many, 4 * padded + 3 * moved + grows + j % GROUP, scaled)
            else:
                sx, sy, sz = load3(rest, 3 * padded + j, padded)
            a, b, c = a * sx, b * sy, c * sz
            d, e, f = d * sx, e * sy, f * sz
            g, h, i = g * sx, h * sy, i * sz
        store4(local, 0, WIDTH, a, b, c, tx)
        store4(local, 4 * WIDTH, WIDTH, d, e, f, ty)
        store4(local, 8 * WIDTH, WIDTH, g, h, i, tz)
        for row in range(0, 16, WIDTH):
            transpose(local, row * WIDTH, WIDTH, local, matrices + j * 16 + row, 16)
    for k in range(joints):
        mine, up = load_sixteen(local, matrices + k * 16), parents[k]
        if up >= 0:
            mine = _multiply(load_sixteen(out, up * 16), mine)
        store(out, k * 16, mine)
    return FINE
