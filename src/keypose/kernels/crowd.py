# pyright: basic
"""Many characters that play compressed clips: sample, blend, walk the hierarchy with scale.

Decoding a pose takes longer than everything else together, and characters of a crowd are often between the same two
samples of a clip. So decoded samples (*knots*) are kept in a pool of fixed size, about first in, first out; a knot that a
block of W characters needs is never thrown out before the block is done. Where the pool is smaller than what is played, each
knot would be thrown out just before it is needed again; so it keeps what it has, and the other knots are decoded into
places after the pool that belong to the block. From there it goes as in `keypose.kernels.sample`: joints in the lanes to
sample and blend, a register transpose, characters in the lanes to walk. Here the hierarchy is walked in 3x4 matrices, for
a scale above a rotation gives shear; the parent's matrix is read from where the result was just written.

Between two knots rotations are interpolated component by component (nlerp); translations and scales are linear.

Layout
    knots    float32  [slot][4 x padded, then 3 x moving translations, then 3 x moving scales]
    clips    int64    per clip CLIP numbers: addresses of layout, tables, book and codes (see `kernels.decode`), its first
                      knot in the numbering of all clips, how many it has, how many for each sample, whether it loops
    models   float32  [block][joint][12][W]: rows of 3x4 matrices, characters in the lanes
    call     int64    what one call is about, see CALL: handing over one address is quicker than handing over arrays
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types

from keypose.kernels.decode import CELLS, FRAME_COUNT, FRAMES, SLOTS, TRACKS, decode_pose, decode_two
from keypose.kernels.rotations import load3, load4, quat_dot, quat_matrix, store3, store4
from keypose.kernels.runtime import WIDTH, inlined, intrinsic, kernel, short_kernel
from keypose.kernels.vectors import (
    FLAGS,
    Vector,
    address,
    flip_sign,
    float32_at,
    float64_at,
    int64_at,
    load,
    load_sixteen,
    pointer,
    read,
    rsqrt,
    shuffle,
    splat,
    store,
    transpose,
    uint8_at,
    write,
)

GROUP = 16
ROWS = 10
CLIP = 8
LAYOUT, TABLES, BOOK, CODES, FIRST_KNOT, KNOTS, FINENESS, LOOP = range(CLIP)
# Where the one array of sizes and addresses holds what.
(
    JOINTS, PADDED, CLIP_COUNT, MOVED, SCALED, KNOT_SIZE, SLOT_COUNT, HAND, TICK, DECODED, CLIP_TABLE, TIMING, KNOT_TIMES,
    SLOT_OF, KNOT_OF, STAMPS, POOL, MOVED_AT, SCALED_AT, REST, PARENTS, PLACES, SHARES, POSES, SUMS, ROOM,
    LOCAL, MODEL, SPARE, SUM_SIZE, ROOM_SIZE,
) = range(31)  # fmt: skip
# What one call is about: addresses of the handles and the arrays, then sizes.
CALL = 8
_HANDLES, _WHICH, _TIMES, _WEIGHTS, _MODELS, _CHARACTERS, _MANY = range(7)
STILL, UNIT = -1, -2  # in MOVED_AT and SCALED_AT: the group is constant; it is constant and 1
FINE, BAD_CLIP, BAD_TIME, BAD_WEIGHT = range(4)
_LOOKS = 8  # at slots of the pool for one that is not in use


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
    if loop and last > 0 and not 0 <= position < last:
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


@inlined
def _keep(handles, room, at, slot):
    """Move a decoded pose to its slot; of translations and scales only the groups that move in some clip."""
    pool, padded, moved, scaled = float32_at(handles[POOL]), handles[PADDED], handles[MOVED], handles[SCALED]
    to = slot * handles[KNOT_SIZE]
    for k in range(0, 4 * padded, WIDTH):
        store(pool, to + k, load(room, at + k))
    _copy_groups(room, at + 4 * padded, padded, int64_at(handles[MOVED_AT]), pool, to + 4 * padded, moved)
    at, to = at + 7 * padded, to + 4 * padded + 3 * moved
    _copy_groups(room, at, padded, int64_at(handles[SCALED_AT]), pool, to, scaled)
    handles[DECODED] += 1


@inlined
def _place_of(handles, layout, knot):
    """The frame of a knot, and the share of the frame after it."""
    at = min(float64_at(handles[KNOT_TIMES])[knot], float(layout[FRAME_COUNT] - 1))
    frame = int(at)
    return frame, at - frame


@inlined
def _arrays_of(handles, clip):
    """What a clip is decoded from."""
    table = int64_at(handles[CLIP_TABLE])
    return (
        int64_at(table[clip * CLIP + LAYOUT]),
        float32_at(table[clip * CLIP + TABLES]),
        uint8_at(table[clip * CLIP + BOOK]),
        uint8_at(table[clip * CLIP + CODES]),
    )


@kernel
def _decode_knot(handles, clip, knot, slot):
    """Decode one sample of one clip into the pool."""
    arrays, room = _arrays_of(handles, clip), float32_at(handles[ROOM])
    frame, share = _place_of(handles, arrays[0], knot)
    decode_pose(arrays, frame, share, float32_at(handles[SUMS]), room, 0)
    _keep(handles, room, 0, slot)


@kernel
def _decode_knots(handles, clip, knot, slot, after, slot_after):
    """Decode two samples of one clip, together where they are in one segment."""
    arrays, room = _arrays_of(handles, clip), float32_at(handles[ROOM])
    frame, share = _place_of(handles, arrays[0], knot)
    next_frame, next_share = _place_of(handles, arrays[0], after)
    sums, second, half = float32_at(handles[SUMS]), handles[SUM_SIZE], handles[ROOM_SIZE]
    if decode_two(arrays, frame, share, next_frame, next_share, sums, second, room, 0, half):
        _keep(handles, room, 0, slot)
        _keep(handles, room, half, slot_after)
    else:
        _decode_knot(handles, clip, knot, slot)
        _decode_knot(handles, clip, after, slot_after)


@inlined
def _taken_slot(handles, knot, slot_of, knot_of, stamps):
    """The next slot of the pool that this block does not need, for a knot that is not yet there."""
    slots, tick, slot = handles[SLOT_COUNT], handles[TICK], handles[HAND]
    while stamps[slot] == tick:
        slot = slot + 1 if slot + 1 < slots else 0
    handles[HAND] = slot + 1 if slot + 1 < slots else 0
    if knot_of[slot] >= 0:
        slot_of[knot_of[slot]] = -1
    slot_of[knot], knot_of[slot], stamps[slot] = slot, knot, tick
    return slot


@inlined
def _pooled(handles, clip, knot, slot_of, knot_of, stamps):
    """Where the pool holds a knot; it is decoded if it does not yet."""
    slot = slot_of[knot]
    if slot < 0:
        slot = _taken_slot(handles, knot, slot_of, knot_of, stamps)
        _decode_knot(handles, clip, knot, slot)
    stamps[slot] = handles[TICK]
    return slot * handles[KNOT_SIZE]


@inlined
def _slot_for(handles, knot, slot_of, knot_of, stamps, since, spare):
    """The slot of a knot, or the one to decode it to, and whether to do so.

    Knots used ``since`` then stay in the pool: where that leaves no room the spare slot is used.
    """
    slots, slot = handles[SLOT_COUNT], slot_of[knot]
    if slot >= 0:
        stamps[slot] = handles[TICK]
        return slot, False
    if handles[SPARE] > 0:
        slot, looks = handles[HAND], 0
        while looks < _LOOKS and stamps[slot] >= since:
            slot, looks = slot + 1 if slot + 1 < slots else 0, looks + 1
        handles[HAND] = slot
        if looks == _LOOKS:
            return slots + spare, True
    return _taken_slot(handles, knot, slot_of, knot_of, stamps), True


@kernel
def _place(handles, which, times_s, weights, first, many, to, since):
    """Where the pool holds the two knots of each clip of a character, the share between them and the clip's weight.

    Knots used ``since`` then stay in the pool, see `_slot_for`.
    """
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
        knot, after, spare = base + knot, base + after, to + 2 * k
        slot, missing = _slot_for(handles, knot, slot_of, knot_of, stamps, since, spare)
        slot_after, missing_after = slot, False
        if after != knot:
            slot_after, missing_after = _slot_for(handles, after, slot_of, knot_of, stamps, since, spare + 1)
        if missing and missing_after:
            _decode_knots(handles, clip, knot, slot, after, slot_after)
        elif missing:
            _decode_knot(handles, clip, knot, slot)
        elif missing_after:
            _decode_knot(handles, clip, after, slot_after)
        places[spare], places[spare + 1] = slot * handles[KNOT_SIZE], slot_after * handles[KNOT_SIZE]
        shares[to + 2 * k] = np.float32(share)
        # Where nothing weighs anything the first clip is played.
        own = weights[first + k] / total if total > 0 else 1.0 if k == 0 else 0.0
        shares[to + 2 * k + 1] = np.float32(own)


@inlined
def _length_factor(w, x, y, z):
    """1 / length by the series about length 1; knots 30 degrees apart shorten a quaternion to 0.991."""
    n = quat_dot(w, x, y, z, w, x, y, z)
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
        r = flip_sign(r, quat_dot(w, x, y, z, sw, sx, sy, sz))
        sw, sx, sy, sz = sw + w * r, sx + x * r, sy + y * r, sz + z * r
    r = rsqrt(quat_dot(sw, sx, sy, sz, sw, sx, sy, sz))
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
def aim(call, which, times_s, weights):
    """Let a call be about other arrays, of any shape and of a size that the call's sizes tell."""
    about = pointer(call)
    about[_WHICH], about[_TIMES], about[_WEIGHTS] = which.ctypes.data, times_s.ctypes.data, weights.ctypes.data


@inlined
def _arrays(call):
    about = int64_at(call)
    return (
        int64_at(about[_HANDLES]), int64_at(about[_WHICH]), float64_at(about[_TIMES]), float64_at(about[_WEIGHTS]),
        about[_MANY],
    )  # fmt: skip


@kernel
def animate(call):
    """Sample, blend and walk all characters; `FINE` or what is wrong with the numbers, and then nothing is written.

    ``call`` is the address of CALL numbers, of which clips, times and weights are (characters, clips each).
    """
    handles, clip_of, time_of, weight_of, many = _arrays(call)
    characters, out = int64_at(call)[_CHARACTERS], float32_at(int64_at(call)[_MODELS])
    blocks = (characters + WIDTH - 1) // WIDTH
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
                handles, clip_of, time_of, weight_of, (block * WIDTH + i) * many, many, 2 * i * many,
                max(handles[TICK] - 2 * blocks, 0),
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


_SIXTEEN = Vector(32, 16)


def _quad(context, builder, sig, args, which, index):
    """Four neighbours of argument ``which``, ``index`` steps of the argument after next from the one after."""
    step = context.cast(builder, args[which + 2], sig.args[which + 2], types.intp)
    offset = builder.mul(step, ir.Constant(step.type, index))
    return read(builder, address(context, builder, sig, args, which, ir.VectorType(ir.FloatType(), 4), offset), 4)


@intrinsic
def _store_quads_of_lanes(typing, array, at, a, b, c, d):
    """Four vectors as W groups of four neighbours, first those of every fourth lane from 0 on, then from 1 on and so on.

    In this order eight shuffles do, none of which leaves its 128 bits.
    """

    def generate(context, builder, sig, args):
        count = a.lanes

        def zipped(x, y, first):
            order = [g + first + k // 2 + k % 2 * count for g in range(0, count, 4) for k in range(4)]
            return shuffle(builder, x, y, order)

        r = args[2:]
        low, high = ((zipped(r[0], r[2], first), zipped(r[1], r[3], first)) for first in (0, 2))
        parts = [zipped(*pair, first) for pair in (low, high) for first in (0, 2)]
        for k, part in enumerate(parts):
            offset = ir.Constant(ir.IntType(64), k * count)
            write(builder, part, address(context, builder, sig, args, 0, a.llvm, offset), 4)
        return context.get_dummy_value()

    return types.void(array, at, a, b, c, d), generate


@intrinsic
def _local_matrix(typing, array, at, step):
    """A 4x4 matrix of which three rows stand ``step`` apart."""

    def generate(context, builder, sig, args):
        rows = [_quad(context, builder, sig, args, 0, k) for k in range(3)]
        last = ir.Constant(ir.VectorType(ir.FloatType(), 4), [0.0, 0.0, 0.0, 1.0])
        upper, lower = shuffle(builder, rows[0], rows[1], range(8)), shuffle(builder, rows[2], last, range(8))
        return shuffle(builder, upper, lower, range(16))

    return _SIXTEEN(array, at, step), generate


@intrinsic
def _multiply(typing, parent, array, at, step):
    """The product of a 4x4 matrix in sixteen lanes, row by row, and the `_local_matrix` there.

    Its rows are spread over the lanes as they are loaded, which costs no shuffle.
    """

    def generate(context, builder, sig, args):
        above = args[0]
        bits = ir.VectorType(ir.IntType(32), 16)
        keep = ir.Constant(bits, [-1 if k % 4 == 3 else 0 for k in range(16)])
        total = builder.bitcast(builder.and_(builder.bitcast(above, bits), keep), parent.llvm)
        for k in range(3):
            column = shuffle(builder, above, above, [4 * (n // 4) + k for n in range(16)])
            row = _quad(context, builder, sig, args, 1, k)
            row = shuffle(builder, row, row, [n % 4 for n in range(16)])
            total = builder.fadd(total, builder.fmul(column, row, flags=FLAGS), flags=FLAGS)
        return total

    return parent(parent, array, at, step), generate


@short_kernel
def animate_one(call):
    """The whole chain for one character; `FINE` or what is wrong with the numbers.

    ``call`` is the address of CALL numbers, of which clips, times and weights are (clips,); the matrices [joint][16] are left
    at ``MODEL``.
    """
    handles, clip_of, time_of, weight_of, many = _arrays(call)
    wrong = _wrong(clip_of, time_of, weight_of, many, handles[CLIP_COUNT])
    if wrong != FINE:
        return wrong
    handles[TICK] += 1
    _place(handles, clip_of, time_of, weight_of, 0, many, 0, max(handles[TICK] - 2, 0))
    joints, padded, moved, scaled = handles[JOINTS], handles[PADDED], handles[MOVED], handles[SCALED]
    pool, rest, local, out = (
        float32_at(handles[POOL]),
        float32_at(handles[REST]),
        float32_at(handles[LOCAL]),
        float32_at(handles[MODEL]),
    )
    places, shares = int64_at(handles[PLACES]), float32_at(handles[SHARES])
    moved_at, scaled_at, parents = int64_at(handles[MOVED_AT]), int64_at(handles[SCALED_AT]), int64_at(handles[PARENTS])
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
        _store_quads_of_lanes(local, 12 * j, a, b, c, tx)
        _store_quads_of_lanes(local, 12 * j + 4 * WIDTH, d, e, f, ty)
        _store_quads_of_lanes(local, 12 * j + 8 * WIDTH, g, h, i, tz)
    mine = load_sixteen(out, 0)
    for k in range(joints):
        lane, up = k & (WIDTH - 1), parents[k]
        at = 12 * (k - lane) + (lane & 3) * WIDTH + (lane & ~3)
        if up < 0:
            mine = _local_matrix(local, at, 4 * WIDTH)
        else:
            if up != k - 1:  # else it is still in its register
                mine = load_sixteen(out, up * 16)
            mine = _multiply(mine, local, at, 4 * WIDTH)
        store(out, k * 16, mine)
    return FINE
