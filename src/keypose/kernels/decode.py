# pyright: basic
"""Decoding one pose of a compiled clip at any time.

The frames are cut into *slots* of 16. A slot is one segment of 16 samples; where the motion is so fast that the straight way
between frames would miss it, it is halved into two, those again, and so on, at most five times (level 5).

A *track* is one number of the pose that moves. Over a segment it is 16 coefficients of the cosine transform,
each with a bit width of its own, which a *profile* lists. Sampling is linear in the coefficients: the weights of a sample,
or of a mixture of two, are one row of 16 numbers, and a track costs one unpacking, one product and one sum, with the
coefficients in the lanes. Rotations are finished with joints in the lanes.

Layout of the arrays (all made by `keypose.play.store.decoder`; tracks are sorted by row, then by joint)
    layout   int64    HEADER numbers; per row and block of 16 joints which have a track (bits) and the first of these
                      tracks; the same per block of morphs; per slot 8 times its first cell plus its deepest level n (it
                      has 2 ** n cells); per cell 8 times its segment plus the segment's level; the byte offset of each
                      segment
    tables   float32  cosine rows [16][16]; steps of the tracks; scales of the segments; the constant pose, with coded
                      rotations in each 16 joints of which one turns, else with rotations; per joint the rotations before and after the coded one, and 1 where its numbers are x, y, z / (1 + w)
    book     uint8    per profile 128 bytes: of each coefficient the four bytes that hold it (4 x 16), how far to shift left
                      (16), then right (16; 0 where none is stored), where each four coefficients start (4), how many bytes
                      they take together; the four bytes count from the start of the track, or of their four (WINDOWED)
    codes    uint8    MARGIN bytes, then per segment one profile per track, filled up to a multiple of 16 with an empty
                      one, and the packed coefficients, then MARGIN bytes
    sums     float32  room for the tracks, filled up to a multiple of 16, and 16 more
    out      float32  rows [10][padded joints]: w x y z, translation, scale; then the morph weights, padded as well
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types

from keypose.kernels.rotations import load4, quat_multiply, store4
from keypose.kernels.runtime import FEATURES, inlined, intrinsic, kernel
from keypose.kernels.vectors import (
    Vector,
    address,
    call_llvm,
    lanes,
    load,
    load_sixteen,
    pointer,
    read,
    rsqrt,
    shuffle,
    store,
)

FRAMES = 16
ROWS = 10
MARGIN = 64  # bytes before and after the codes that may be read but mean nothing
ENTRY = 128  # bytes of one profile
PADDED, TRACKS, FRAME_COUNT, MORPHS, SLOTS, STEPS, SCALES, BASE, BEFORE, MASKS, OFFSETS, CELLS = range(12)
HEADER = 16

_I8, _I16, _I32, _I64 = (ir.IntType(n) for n in (8, 16, 32, 64))
_WORDS = ir.VectorType(_I32, FRAMES)
_SIXTEEN = Vector(32, FRAMES)
_LEFT, _RIGHT, _WINDOWS, SIZE = 64, 80, 96, 100
# Whether four coefficients at a time are looked up in the 16 bytes from where they start; else all in 64 bytes.
WINDOWED = "avx512vbmi" not in FEATURES


def _at(builder, data, offset, kind):
    place = builder.gep(data, [_I64(offset)]) if offset else data
    return builder.bitcast(place, kind.as_pointer())


def _gather_words(builder, data, table):
    """The 32 bits around each coefficient."""
    if not WINDOWED:
        whole = ir.VectorType(_I8, 64)
        codes, where = read(builder, _at(builder, data, 0, whole), 1), read(builder, _at(builder, table, 0, whole), 1)
        found = call_llvm(builder, "llvm.x86.avx512.permvar.qi.512", whole, [codes, where])
        return builder.bitcast(found, _WORDS)
    fours = [_gather_four(builder, data, table, first) for first in range(0, FRAMES, 4)]
    low, high = (shuffle(builder, fours[k], fours[k + 1], range(8)) for k in (0, 2))
    return shuffle(builder, low, high, range(FRAMES))


def _gather_four(builder, data, table, first):
    start = builder.zext(builder.load(_at(builder, table, _WINDOWS + first // 4, _I8)), _I64)
    window, four = builder.gep(data, [start]), ir.VectorType(_I32, 4)
    if "ssse3" in FEATURES:
        part = ir.VectorType(_I8, 16)
        codes, where = (read(builder, _at(builder, *place, part), 1) for place in ((window, 0), (table, 4 * first)))
        return builder.bitcast(call_llvm(builder, "llvm.x86.ssse3.pshuf.b.128", part, [codes, where]), four)
    out = ir.Constant(four, ir.Undefined)
    for k in range(4):
        offset = builder.zext(builder.load(_at(builder, table, 4 * (first + k), _I8)), _I64)
        word = read(builder, builder.bitcast(builder.gep(window, [offset]), _I32.as_pointer()), 1)
        out = builder.insert_element(out, word, _I32(k))
    return out


@intrinsic
def unpack_coefficients(typing, codes, start, book, entry):
    """The sixteen coefficients of a track, in half steps (2 q + 1; 0 where none is stored), from a byte on."""

    def generate(context, builder, sig, args):
        data, table = (address(context, builder, sig, args, which, _I8) for which in (0, 2))
        words = _gather_words(builder, data, table)
        left, right = (
            builder.zext(read(builder, _at(builder, table, offset, ir.VectorType(_I8, FRAMES)), 1), _WORDS)
            for offset in (_LEFT, _RIGHT)
        )
        stored = builder.icmp_signed(">", right, ir.Constant(_WORDS, [_I32(0)] * FRAMES))
        # The coefficient to the top, for its sign, then down but for one bit, which is always set.
        halves = builder.ashr(builder.shl(words, left), right)
        halves = builder.or_(halves, ir.Constant(_WORDS, [_I32(1)] * FRAMES))
        return builder.select(stored, builder.sitofp(halves, _SIXTEEN.llvm), ir.Constant(_SIXTEEN.llvm, [0.0] * FRAMES))

    return _SIXTEEN(codes, start, book, entry), generate


def _joined(near, far):
    """Add numbers of two vectors, each to the one beside it; ``near`` and ``far`` say of which lanes (16 more: of b)."""

    @intrinsic
    def join(typing, a, b):
        def generate(context, builder, sig, args):
            parts = [shuffle(builder, args[0], args[1], order) for order in (near, far)]
            return builder.fadd(parts[0], parts[1], flags=("contract", "nsz"))

        return _SIXTEEN(a, b), generate

    return join


def _fours(*places):
    """Lanes of every group of four."""
    return [four + k for four in range(0, FRAMES, 4) for k in places]


# Halves side by side, then quarters; the last two steps stay inside each four lanes, which is what registers do best.
_join_halves = _joined([*range(8), *range(16, 24)], [*range(8, 16), *range(24, 32)])
_join_quarters = _joined(*([half + k for half in range(0, 32, 8) for k in range(at, at + 4)] for at in (0, 4)))
_join_pairs = _joined(_fours(0, 1, 16, 17), _fours(2, 3, 18, 19))
_join_single = _joined(_fours(0, 2, 16, 18), _fours(1, 3, 17, 19))


@intrinsic
def expand(typing, values, index, bits, base, at):
    """``base[at:at + 16]`` with neighbouring ``values`` from an index on added to the lanes whose bit is set."""

    def generate(context, builder, sig, args):
        mask = builder.bitcast(
            builder.trunc(context.cast(builder, args[2], sig.args[2], types.int64), _I16),
            ir.VectorType(ir.IntType(1), FRAMES),
        )
        first = address(context, builder, sig, args, 0, ir.FloatType())
        none = ir.Constant(_SIXTEEN.llvm, [0.0] * FRAMES)
        spread = call_llvm(builder, "llvm.masked.expandload.v16f32", _SIXTEEN.llvm, [first, mask, none])
        rest = read(builder, address(context, builder, sig, args, 3, _SIXTEEN.llvm), 4)
        return builder.fadd(spread, rest, flags=("contract", "nsz"))

    return _SIXTEEN(values, index, bits, base, at), generate


@inlined
def _one(codes, profile, start, book, weights):
    entry = np.int64(codes[profile]) * ENTRY
    return unpack_coefficients(codes, start, book, entry) * weights, start + book[entry + SIZE]


@inlined
def _eight(codes, profile, start, book, weights):
    """Eight tracks: in each vector that returns one and the fourth after it, eight numbers each."""
    a, start = _one(codes, profile, start, book, weights)
    b, start = _one(codes, profile + 1, start, book, weights)
    c, start = _one(codes, profile + 2, start, book, weights)
    d, start = _one(codes, profile + 3, start, book, weights)
    e, start = _one(codes, profile + 4, start, book, weights)
    f, start = _one(codes, profile + 5, start, book, weights)
    g, start = _one(codes, profile + 6, start, book, weights)
    h, start = _one(codes, profile + 7, start, book, weights)
    return (_join_halves(a, e), _join_halves(b, f), _join_halves(c, g), _join_halves(d, h)), start


@inlined
def _eight_of_both(codes, profile, start, book, first, second):
    """As `_eight`, for two mixtures of the same coefficients."""
    a, i, start = _both(codes, profile, start, book, first, second)
    b, j, start = _both(codes, profile + 1, start, book, first, second)
    c, k, start = _both(codes, profile + 2, start, book, first, second)
    d, m, start = _both(codes, profile + 3, start, book, first, second)
    e, n, start = _both(codes, profile + 4, start, book, first, second)
    a, i = _join_halves(a, e), _join_halves(i, n)
    e, n, start = _both(codes, profile + 5, start, book, first, second)
    b, j = _join_halves(b, e), _join_halves(j, n)
    e, n, start = _both(codes, profile + 6, start, book, first, second)
    c, k = _join_halves(c, e), _join_halves(k, n)
    e, n, start = _both(codes, profile + 7, start, book, first, second)
    d, m = _join_halves(d, e), _join_halves(m, n)
    return (a, b, c, d), (i, j, k, m), start


@inlined
def _both(codes, profile, start, book, first, second):
    entry = np.int64(codes[profile]) * ENTRY
    coefficients = unpack_coefficients(codes, start, book, entry)
    return coefficients * first, coefficients * second, start + book[entry + SIZE]


@inlined
def _joined_fours(low, high):
    a, b, c, d = low
    e, f, g, h = high
    ab = _join_pairs(_join_quarters(a, e), _join_quarters(b, f))
    cd = _join_pairs(_join_quarters(c, g), _join_quarters(d, h))
    return _join_single(ab, cd)


@inlined
def sum_tracks(layout, tables, book, codes, segment, weights, again, sums):
    """Each track's sum of coefficients times ``weights`` (16 lanes), times its step; added to ``sums`` if ``again``."""
    tracks = layout[TRACKS]
    profiles = layout[layout[OFFSETS] + segment]
    start = profiles + tracks
    steps = layout[STEPS]
    for track in range(0, tracks, FRAMES):
        low, start = _eight(codes, profiles + track, start, book, weights)
        high, start = _eight(codes, profiles + track + 8, start, book, weights)
        total = _joined_fours(low, high) * load_sixteen(tables, steps + track)
        if again:
            total = total + load_sixteen(sums, track)
        store(sums, track, total)


@inlined
def _sum_tracks_of_both(layout, tables, book, codes, segment, first, second, sums, after):
    """As `sum_tracks`, for two mixtures at once; the sums of the second stand ``after`` places later."""
    tracks = layout[TRACKS]
    profiles = layout[layout[OFFSETS] + segment]
    start = profiles + tracks
    steps = layout[STEPS]
    for track in range(0, tracks, FRAMES):
        low, other_low, start = _eight_of_both(codes, profiles + track, start, book, first, second)
        high, other_high, start = _eight_of_both(codes, profiles + track + 8, start, book, first, second)
        step = load_sixteen(tables, steps + track)
        store(sums, track, _joined_fours(low, high) * step)
        store(sums, after + track, _joined_fours(other_low, other_high) * step)


@inlined
def _mixture(layout, tables, frame, share):
    """The segment of a place, the weights of its coefficients, and the share of the next segment's first sample."""
    slot = frame // FRAMES
    entry = layout[layout[SLOTS] + slot]
    position = frame - slot * FRAMES + share
    cells = 1 << (entry & 7)
    cell = min(int(position * cells) >> 4, cells - 1)
    found = layout[layout[CELLS] + (entry >> 3) + cell]
    segment, samples = found >> 3, 1 << (found & 7)  # samples per frame
    position *= samples
    sample = min(int(position), FRAMES * samples - 1)
    share = position - sample
    local = sample & (FRAMES - 1)
    row = local * FRAMES
    scale = tables[layout[SCALES] + segment]
    weights, next_share = load_sixteen(tables, row), 0.0
    if frame + 1 < layout[FRAME_COUNT]:
        weights = weights * ((1 - share) * scale)
        if local < FRAMES - 1:
            weights = weights + load_sixteen(tables, row + FRAMES) * (share * scale)
        else:
            next_share = share
    else:
        weights = weights * scale
    return segment, weights, next_share


@inlined
def decode_pose(clip, frame, share, sums, out, at):
    """The pose between two frames, in rows from ``out[at]``; for use inside kernels.

    ``clip`` is (layout, tables, book, codes); these, ``sums`` and ``out`` are pointers (`vectors.pointer`), for which Numba
    counts no references. ``frame`` must be one of the clip's; ``share`` (0 to 1) is how much of the frame after it is mixed in, and is only
    looked at where there is one. All rows and morph weights are written.
    """
    layout, tables, book, codes = clip
    if layout[TRACKS] > 0:
        segment, weights, next_share = _mixture(layout, tables, frame, share)
        sum_tracks(layout, tables, book, codes, segment, weights, False, sums)
        if next_share > 0:
            weights = load_sixteen(tables, 0) * (next_share * tables[layout[SCALES] + segment + 1])
            sum_tracks(layout, tables, book, codes, segment + 1, weights, True, sums)
    _pose(layout, tables, sums, 0, out, at)


@inlined
def decode_two(clip, frame, share, other_frame, other_share, sums, after, out, at, other_at):
    """As `decode_pose` twice, to the same bits, where both are in one segment; else False, and nothing is written.

    ``sums`` has room for another pose from ``after`` on.
    """
    layout, tables, book, codes = clip
    if layout[TRACKS] == 0:
        return False
    segment, weights, next_share = _mixture(layout, tables, frame, share)
    other_segment, other_weights, other_next = _mixture(layout, tables, other_frame, other_share)
    if segment != other_segment or next_share > 0 or other_next > 0:
        return False
    _sum_tracks_of_both(layout, tables, book, codes, segment, weights, other_weights, sums, after)
    for to, places in ((at, 0), (other_at, after)):
        _pose(layout, tables, sums, places, out, to)
    return True


@inlined
def _pose(layout, tables, sums, first, out, at):
    """The pose that the sums of all tracks make, which stand from ``first`` on."""
    padded = layout[PADDED]
    base, masks = layout[BASE], layout[MASKS]
    for k in range(0, padded * ROWS + layout[MORPHS], FRAMES):
        bits = layout[masks]
        if bits:
            store(out, at + k, expand(sums, first + layout[masks + 1], bits, tables, base + k))
        else:
            store(out, at + k, load_sixteen(tables, base + k))
        masks += 2
    before = layout[BEFORE]
    after, complete = before + 4 * padded, before + 8 * padded
    groups = padded // FRAMES
    for j in range(0, padded, lanes(tables)):
        turning = layout[MASKS] + 2 * (j // FRAMES)
        if not (
            layout[turning] | layout[turning + 2 * groups] | layout[turning + 4 * groups] | layout[turning + 6 * groups]
        ):
            continue  # the constant pose holds rotations, where none of a group moves
        w, x, y, z = load4(out, at + j, padded)
        square = x * x + y * y + z * z
        rational = load(tables, complete + j)
        w = w + rational * (1.0 - square)
        double = 1.0 + rational
        x, y, z = x * double, y * double, z * double
        length = rsqrt(w * w + x * x + y * y + z * z)
        aw, ax, ay, az = load4(tables, before + j, padded)
        bw, bx, by, bz = load4(tables, after + j, padded)
        w, x, y, z = quat_multiply(aw, ax, ay, az, w * length, x * length, y * length, z * length)
        w, x, y, z = quat_multiply(w, x, y, z, bw, bx, by, bz)
        store4(out, at + j, padded, w, x, y, z)


@inlined
def frame_at(time_s, start_s, rate_hz, frames, loop):
    """The frame at or before a time, and the share of the frame after it; times outside are clamped or wrapped."""
    last = frames - 1
    position = (time_s - start_s) * rate_hz
    if loop and last > 0:
        position -= (position // last) * last
    position = min(max(position, 0.0), float(last))
    frame = min(int(position), max(last - 1, 0))
    return frame, position - frame


@kernel
def decode_at(layout, tables, book, codes, start_s, rate_hz, loop, times_s, sums, out):
    """Poses at many times, one after another in ``out``."""
    frames = layout[FRAME_COUNT]
    stride = layout[PADDED] * ROWS + layout[MORPHS]
    clip = (pointer(layout), pointer(tables), pointer(book), pointer(codes))
    sums_at, out_at = pointer(sums), pointer(out)
    for n in range(times_s.shape[0]):
        frame, share = frame_at(times_s[n], start_s, rate_hz, frames, loop)
        decode_pose(clip, frame, share, sums_at, out_at, n * stride)


@kernel
def decode_to(
    layout, tables, book, codes, start_s, rate_hz, loop, times_s, sums, room, rotations, translations, scales, weights
):
    """Poses at many times as (N, J, 4), (N, J, 3), (N, J, 3) and (N, M); ``room`` holds the rows of one pose."""
    frames, padded = layout[FRAME_COUNT], layout[PADDED]
    clip = (pointer(layout), pointer(tables), pointer(book), pointer(codes))
    sums_at, room_at = pointer(sums), pointer(room)
    for n in range(times_s.shape[0]):
        frame, share = frame_at(times_s[n], start_s, rate_hz, frames, loop)
        decode_pose(clip, frame, share, sums_at, room_at, 0)
        for j in range(rotations.shape[1]):
            for k in range(4):
                rotations[n, j, k] = room[k * padded + j]
            for k in range(3):
                translations[n, j, k] = room[(4 + k) * padded + j]
                scales[n, j, k] = room[(7 + k) * padded + j]
        for m in range(weights.shape[1]):
            weights[n, m] = room[ROWS * padded + m]
