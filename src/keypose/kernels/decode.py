# pyright: basic
"""Decoding one pose of a compiled clip at any time.

The frames are cut into *slots* of 16. A slot is one segment of 16 samples, or 2, 4 ... 32 segments where the motion is so
fast that the straight way between frames would miss it.

A *track* is one number of the pose that moves. Over a segment it is 16 coefficients of the cosine transform,
each with a bit width of its own, which a *profile* lists. Sampling is linear in the coefficients: the weights of a sample,
or of a mixture of two, are one row of 16 numbers, and a track costs one unpacking, one product and one sum, with the
coefficients in the lanes. Rotations are finished with joints in the lanes.

Layout of the arrays (all made by `keypose.play.store`)
    layout   int64    HEADER numbers, then the target of each track, per slot 8 times its first segment plus its
                      refinement, then the byte offset of each segment
    tables   float32  cosine rows [16][16]; steps of the tracks; scales of the segments; the constant pose; per joint the
                      rotations before and after the coded one, and 1 where its numbers are x, y, z / (1 + w)
    book     uint8    per profile 128 bytes: of each coefficient the four bytes that hold it (4 x 16), how far to shift left
                      (16), then right (16), which are stored (one bit each), how many bytes they take together
    codes    uint8    MARGIN bytes, then per segment one profile per track and the packed coefficients, then MARGIN bytes
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
PADDED, TRACKS, FRAME_COUNT, MORPHS, SLOTS, STEPS, SCALES, BASE, BEFORE = range(9)
HEADER = 16

_I8, _I16, _I32, _I64 = (ir.IntType(n) for n in (8, 16, 32, 64))
_WORDS = ir.VectorType(_I32, FRAMES)
_SIXTEEN = Vector(32, FRAMES)
_LEFT, _RIGHT, _STORED, SIZE = 64, 80, 96, 98


def _at(builder, data, offset, kind):
    place = builder.gep(data, [_I64(offset)]) if offset else data
    return builder.bitcast(place, kind.as_pointer())


def _gather_words(builder, data, table):
    """The 32 bits around each coefficient."""
    if "avx512vbmi" in FEATURES:
        whole = ir.VectorType(_I8, 64)
        codes, where = read(builder, _at(builder, data, 0, whole), 1), read(builder, _at(builder, table, 0, whole), 1)
        found = call_llvm(builder, "llvm.x86.avx512.permvar.qi.512", whole, [codes, where])
        return builder.bitcast(found, _WORDS)
    out = ir.Constant(_WORDS, ir.Undefined)
    for k in range(FRAMES):
        offset = builder.zext(builder.load(_at(builder, table, 4 * k, _I8)), _I64)
        word = read(builder, builder.bitcast(builder.gep(data, [offset]), _I32.as_pointer()), 1)
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
        bits = read(builder, _at(builder, table, _STORED, _I16), 2)
        stored = builder.bitcast(bits, ir.VectorType(ir.IntType(1), FRAMES))
        # The coefficient to the top, for its sign, then down but for one bit, which is always set.
        halves = builder.ashr(builder.shl(words, left), right)
        halves = builder.or_(halves, ir.Constant(_WORDS, [_I32(1)] * FRAMES))
        return builder.select(stored, builder.sitofp(halves, _SIXTEEN.llvm), ir.Constant(_SIXTEEN.llvm, [0.0] * FRAMES))

    return _SIXTEEN(codes, start, book, entry), generate


def _add(builder, a, b):
    return builder.fadd(a, b, flags=("contract", "nsz"))


def _halved(builder, value, count):
    """The lower half of the lanes plus the upper."""
    half = count // 2
    low, high = (shuffle(builder, value, value, range(k, k + half)) for k in (0, half))
    return _add(builder, low, high)


@intrinsic
def sum_lanes(typing, vector):
    """The sum of sixteen lanes."""

    def generate(context, builder, sig, args):
        value = args[0]
        for count in (16, 8, 4, 2):
            value = _halved(builder, value, count)
        return builder.extract_element(value, _I32(0))

    return types.float32(_SIXTEEN), generate


@intrinsic
def add_four(typing, out, at, targets, first, steps, step, a, b, c, d):
    """Add the sums of four vectors, times four steps, to ``out[at + targets[first]]`` and the three after it."""

    def generate(context, builder, sig, args):
        a, b, c, d = (_halved(builder, v, 16) for v in args[6:])
        # Eight lanes each: interleave by halves until every vector has its own lane.
        ab, cd = (
            _add(
                builder,
                shuffle(builder, x, y, [0, 1, 2, 3, 8, 9, 10, 11]),
                shuffle(builder, x, y, [4, 5, 6, 7, 12, 13, 14, 15]),
            )
            for x, y in ((a, b), (c, d))
        )
        four = _add(
            builder,
            shuffle(builder, ab, cd, [0, 1, 4, 5, 8, 9, 12, 13]),
            shuffle(builder, ab, cd, [2, 3, 6, 7, 10, 11, 14, 15]),
        )
        four = _add(builder, shuffle(builder, four, four, [0, 2, 4, 6]), shuffle(builder, four, four, [1, 3, 5, 7]))
        kind = ir.VectorType(ir.FloatType(), 4)
        four = builder.fmul(four, read(builder, address(context, builder, sig, args, 4, kind), 4))
        pose = address(context, builder, sig, args, 0, ir.FloatType())
        where = address(context, builder, sig, args, 2, _I64)
        for k in range(4):
            place = builder.gep(pose, [read(builder, builder.gep(where, [_I64(k)]), 8)])
            value = builder.fadd(read(builder, place, 4), builder.extract_element(four, _I32(k)))
            builder.store(value, place)
        return context.get_dummy_value()

    return types.void(out, at, targets, first, steps, step, a, b, c, d), generate


@inlined
def add_tracks(layout, tables, book, codes, segment, weights, out, at):
    """Add each track's sum of coefficients times ``weights`` (16 lanes) to its number of the pose."""
    tracks = layout[TRACKS]
    profiles = layout[HEADER + tracks + layout[SLOTS] + segment]
    start = profiles + tracks
    steps = layout[STEPS]
    layout_at, tables_at, book_at, codes_at, out_at = (
        pointer(layout), pointer(tables), pointer(book), pointer(codes), pointer(out),
    )  # fmt: skip
    whole = tracks & ~3
    for track in range(0, whole, 4):
        p = np.int64(codes[profiles + track]) * ENTRY
        a = unpack_coefficients(codes_at, start, book_at, p) * weights
        start += book[p + SIZE]
        p = np.int64(codes[profiles + track + 1]) * ENTRY
        b = unpack_coefficients(codes_at, start, book_at, p) * weights
        start += book[p + SIZE]
        p = np.int64(codes[profiles + track + 2]) * ENTRY
        c = unpack_coefficients(codes_at, start, book_at, p) * weights
        start += book[p + SIZE]
        p = np.int64(codes[profiles + track + 3]) * ENTRY
        d = unpack_coefficients(codes_at, start, book_at, p) * weights
        start += book[p + SIZE]
        add_four(out_at, at, layout_at, HEADER + track, tables_at, steps + track, a, b, c, d)
    for track in range(whole, tracks):
        p = np.int64(codes[profiles + track]) * ENTRY
        value = sum_lanes(unpack_coefficients(codes_at, start, book_at, p) * weights)
        start += book[p + SIZE]
        out[at + layout[HEADER + track]] += value * tables[steps + track]


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
        slot = frame // FRAMES
        entry = layout[HEADER + layout[TRACKS] + slot]
        samples = 1 << (entry & 7)  # per frame
        position = (frame - slot * FRAMES + share) * samples
        sample = min(int(position), FRAMES * samples - 1)
        mixed = frame + 1 < layout[FRAME_COUNT]
        share = position - sample
        segment = (entry >> 3) + sample // FRAMES
        local = sample % FRAMES
        row = local * FRAMES
        scales = layout[SCALES]
        scale = tables[scales + segment]
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
        rational = load(tables_at, complete + j)
        w = w + rational * (1.0 - square)
        double = 1.0 + rational
        x, y, z = x * double, y * double, z * double
        length = rsqrt(w * w + x * x + y * y + z * z)
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
def decode_to(
    layout, tables, book, codes, start_s, rate_hz, loop, times_s, room, rotations, translations, scales, weights
):
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
