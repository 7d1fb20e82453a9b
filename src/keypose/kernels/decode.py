# pyright: basic
"""Decoding one pose of a compiled clip at any time.

A *track* is one number of the pose that moves. Over a segment of 16 frames it is 16 coefficients of the cosine transform,
each with a bit width of its own, which a *profile* lists. Sampling is linear in the coefficients: the weights of a frame,
or of a mixture of two, are one row of 16 numbers, and a track costs one unpacking, one product and one sum, with the
coefficients in the lanes. Rotations are finished with joints in the lanes.

Layout of the arrays (all made by `keypose.play.store`)
    layout   int64    HEADER numbers, then the target of each track, then the byte offset of each segment
    tables   float32  cosine rows [16][16]; steps of the tracks; scales of the segments; the constant pose; per joint the
                      rotations before and after the coded one, and whether its w is to be completed
    book     uint8    per profile 64 bytes: where each coefficient ends (uint16), how far to shift (uint8), which are
                      stored (one bit each), how many bits they take together
    codes    uint8    MARGIN bytes, then per segment one profile per track and the packed coefficients, then MARGIN bytes
    out      float32  rows [10][padded joints]: w x y z, translation, scale; then the morph weights, padded as well
"""

from __future__ import annotations

from llvmlite import ir
from numba import types

from keypose.kernels.rotations import load4, quat_multiply, store4
from keypose.kernels.runtime import FEATURES, WIDTH, inlined, intrinsic, kernel
from keypose.kernels.vectors import (
    Vector,
    address,
    call_llvm,
    fill,
    lanes,
    load,
    load_sixteen,
    maximum,
    pointer,
    read,
    rsqrt,
    shuffle,
    sqrt,
    store,
)

FRAMES = 16
ROWS = 10
MARGIN = 64  # bytes before and after the codes that may be read but mean nothing
ENTRY = 64  # bytes of one profile
PADDED, TRACKS, FRAME_COUNT, MORPHS, SEGMENTS, STEPS, SCALES, BASE, BEFORE = range(9)
HEADER = 16

_I8, _I16, _I32 = ir.IntType(8), ir.IntType(16), ir.IntType(32)
_WORDS = ir.VectorType(_I32, FRAMES)
_SIXTEEN = Vector(32, FRAMES)


def _permute_words(builder, words, where):
    """Lane k is word ``where[k]`` of sixteen."""
    if WIDTH == 16 and "avx512f" in FEATURES:
        return call_llvm(builder, "llvm.x86.avx512.permvar.si.512", _WORDS, [words, where])
    if "avx2" in FEATURES:
        eight = ir.VectorType(_I32, 8)
        low, high = (shuffle(builder, words, words, range(k, k + 8)) for k in (0, 8))
        parts = []
        for k in (0, 8):
            index = shuffle(builder, where, where, range(k, k + 8))
            from_low, from_high = (call_llvm(builder, "llvm.x86.avx2.permd", eight, [half, index]) for half in (low, high))
            upper = builder.icmp_unsigned(">", index, ir.Constant(eight, [_I32(7)] * 8))
            parts.append(builder.select(upper, from_high, from_low))
        return shuffle(builder, *parts, range(16))
    out = ir.Constant(_WORDS, ir.Undefined)
    for k in range(FRAMES):
        out = builder.insert_element(out, builder.extract_element(words, builder.extract_element(where, _I32(k))), _I32(k))
    return out


def _words(builder, scalar):
    one = builder.insert_element(ir.Constant(_WORDS, ir.Undefined), scalar, _I32(0))
    return shuffle(builder, one, one, [0] * FRAMES)


@intrinsic
def unpack_coefficients(typing, codes, bit, book, entry):
    """The sixteen coefficients of a track, in half steps (2 q + 1; 0 where none is stored), from a bit on."""

    def generate(context, builder, sig, args):
        int64 = ir.IntType(64)
        bit = context.cast(builder, args[1], sig.args[1], types.int64)
        at = builder.sub(builder.lshr(bit, int64(3)), int64(4))
        data = context.make_array(sig.args[0])(context, builder, args[0]).data if isinstance(
            sig.args[0], types.Array
        ) else args[0]
        words = read(builder, builder.bitcast(builder.gep(data, [at]), _WORDS.as_pointer()), 1)
        table = address(context, builder, sig, args, 2, _I8)

        def entry_part(offset, kind, align):
            place = builder.gep(table, [int64(offset)])
            return read(builder, builder.bitcast(place, kind.as_pointer()), align)

        ends = builder.zext(entry_part(0, ir.VectorType(_I16, FRAMES), 2), _WORDS)
        shifts = builder.zext(entry_part(32, ir.VectorType(_I8, FRAMES), 1), _WORDS)
        stored = builder.bitcast(entry_part(48, _I16, 2), ir.VectorType(ir.IntType(1), FRAMES))
        # The window of 32 bits that ends where the coefficient ends: shifted down, its sign is in front.
        odd_bits = builder.and_(builder.trunc(bit, _I32), _I32(7))
        start = builder.add(ends, _words(builder, odd_bits))
        word = builder.lshr(start, ir.Constant(_WORDS, [_I32(5)] * FRAMES))
        one = ir.Constant(_WORDS, [_I32(1)] * FRAMES)
        low = _permute_words(builder, words, word)
        high = _permute_words(builder, words, builder.add(word, one))
        window = call_llvm(builder, "llvm.fshr.v16i32", _WORDS, [high, low, start])
        halves = builder.or_(builder.ashr(window, shifts), one)
        return builder.select(stored, builder.sitofp(halves, _SIXTEEN.llvm), ir.Constant(_SIXTEEN.llvm, [0.0] * FRAMES))

    return _SIXTEEN(codes, bit, book, entry), generate


@intrinsic
def sum_lanes(typing, vector):
    """The sum of sixteen lanes."""

    def generate(context, builder, sig, args):
        value, count = args[0], FRAMES
        while count > 1:
            count //= 2
            low, high = shuffle(builder, value, value, range(count)), shuffle(builder, value, value, range(count, 2 * count))
            value = builder.fadd(low, high, flags=("contract", "nsz"))
        return builder.extract_element(value, _I32(0))

    return types.float32(_SIXTEEN), generate


@inlined
def add_tracks(layout, tables, book, codes, segment, weights, out, at):
    """Add each track's sum of coefficients times ``weights`` (16 lanes) to its number of the pose."""
    tracks = layout[TRACKS]
    start = layout[HEADER + tracks + segment]
    bit = (start + tracks) * 8
    steps = layout[STEPS]
    for track in range(tracks):
        entry = int(codes[start + track]) * ENTRY
        value = sum_lanes(unpack_coefficients(codes, bit, book, entry) * weights)
        out[at + layout[HEADER + track]] += value * tables[steps + track]
        bit += int(book[entry + 50]) + int(book[entry + 51]) * 256


@inlined
def decode_pose(layout, tables, book, codes, frame, share, out, at):
    """The pose between two frames, in rows from ``out[at]``; for use inside kernels.

    ``frame`` must be one of the clip's; ``share`` (0 to 1) is how much of the frame after it is mixed in, and is only
    looked at where there is one. All rows and morph weights are written.
    """
    padded = layout[PADDED]
    width = lanes(tables)
    base = layout[BASE]
    tables_at, out_at = pointer(tables), pointer(out)
    for k in range(0, padded * ROWS + layout[MORPHS], width):
        store(out_at, at + k, load(tables_at, base + k))
    if layout[TRACKS] > 0:
        segment = frame // FRAMES
        local = frame - segment * FRAMES
        row = local * FRAMES
        scales = layout[SCALES]
        scale = tables[scales + segment]
        mixed = frame + 1 < layout[FRAME_COUNT]
        if mixed and local < FRAMES - 1:
            weights = load_sixteen(tables_at, row) * ((1 - share) * scale) + load_sixteen(tables_at, row + FRAMES) * (
                share * scale
            )
            add_tracks(layout, tables, book, codes, segment, weights, out, at)
        elif mixed and share > 0:
            weights = load_sixteen(tables_at, row) * ((1 - share) * scale)
            add_tracks(layout, tables, book, codes, segment, weights, out, at)
            weights = load_sixteen(tables_at, 0) * (share * tables[scales + segment + 1])
            add_tracks(layout, tables, book, codes, segment + 1, weights, out, at)
        else:
            add_tracks(layout, tables, book, codes, segment, load_sixteen(tables_at, row) * scale, out, at)
    before = layout[BEFORE]
    after, complete = before + 4 * padded, before + 8 * padded
    for j in range(0, padded, width):
        w, x, y, z = load4(out_at, at + j, padded)
        square = x * x + y * y + z * z
        w = w + sqrt(maximum(1.0 - square, fill(tables, 0.0))) * load(tables_at, complete + j)
        length = rsqrt(w * w + square)
        aw, ax, ay, az = load4(tables_at, before + j, padded)
        bw, bx, by, bz = load4(tables_at, after + j, padded)
        w, x, y, z = quat_multiply(aw, ax, ay, az, w * length, x * length, y * length, z * length)
        w, x, y, z = quat_multiply(w, x, y, z, bw, bx, by, bz)
        store4(out_at, at + j, padded, w, x, y, z)


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
def decode_at(layout, tables, book, codes, start_s, rate_hz, loop, times_s, out):
    """Poses at many times, one after another in ``out``."""
    frames = layout[FRAME_COUNT]
    stride = layout[PADDED] * ROWS + layout[MORPHS]
    for n in range(times_s.shape[0]):
        frame, share = frame_at(times_s[n], start_s, rate_hz, frames, loop)
        decode_pose(layout, tables, book, codes, frame, share, out, n * stride)


@kernel
def decode_to(layout, tables, book, codes, start_s, rate_hz, loop, times_s, room, rotations, translations, scales, weights):
    """Poses at many times as (N, J, 4), (N, J, 3), (N, J, 3) and (N, M); ``room`` holds the rows of one pose."""
    frames, padded = layout[FRAME_COUNT], layout[PADDED]
    for n in range(times_s.shape[0]):
        frame, share = frame_at(times_s[n], start_s, rate_hz, frames, loop)
        decode_pose(layout, tables, book, codes, frame, share, room, 0)
        for j in range(rotations.shape[1]):
            for k in range(4):
                rotations[n, j, k] = room[k * padded + j]
            for k in range(3):
                translations[n, j, k] = room[(4 + k) * padded + j]
                scales[n, j, k] = room[(7 + k) * padded + j]
        for m in range(weights.shape[1]):
            weights[n, m] = room[ROWS * padded + m]
