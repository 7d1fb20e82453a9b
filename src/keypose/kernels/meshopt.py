# pyright: basic
"""The byte loops of meshoptimizer's three codecs, as EXT_meshopt_compression and KHR_meshopt_compression specify them.

Every read is checked against the bytes that are there, every loop runs over a count that is known before. A decoder
returns its values, a fault and the byte where it stopped; only with the fault `OK` do the values mean anything.

Source: KHR_meshopt_compression, Khronos glTF extension registry, appendix A (bitstream).
"""

from __future__ import annotations

import numpy as np

from keypose.errors import ShapeError
from keypose.kernels.runtime import exact_kernel, readable

OK, SHORT, LEFT_OVER, LONG, UNWRITTEN = range(
    5
)  # the last two: a number of over five bytes; a queue entry never filled

BLOCK = 256  # most elements of one block of attributes
GROUP = 16  # elements that share a bit width
_BYTES, _PAIRS, _WORDS = range(3)  # channel modes
_WORD = 0xFFFFFFFF

# Bits of one delta, by control mode and by the two header bits of the group. Row 2 is version 0, which has one mode.
_BITS = np.array([[0, 1, 2, 4], [1, 2, 4, 8], [0, 2, 4, 8]])
_ZEROS, _LITERAL, _VERSION_0 = 2, 3, 4


def block_elements(stride: int) -> int:
    """How many elements of ``stride`` bytes a full block holds."""
    return min((8192 // stride) & ~(GROUP - 1), BLOCK)


def decode_attributes(
    data: np.ndarray, count: int, baseline: np.ndarray, channels: np.ndarray | None
) -> tuple[np.ndarray, int, int]:
    """(bytes (count * stride), fault, place) of a stream without its tail.

    ``baseline`` is the element before the first, uint8 (stride); ``channels`` are the modes of version 1,
    uint8 (stride / 4), None for version 0.
    """
    stride = baseline.size
    if stride % 4 or not 4 <= stride <= 256:
        raise ShapeError(f"baseline: expected 4 to 256 bytes, a multiple of 4; got {stride}")
    if channels is not None and channels.size != stride // 4:
        raise ShapeError(f"channels: expected {stride // 4}, got {channels.size}")
    out = np.empty(max(count, 0) * stride, np.uint8)
    modes = np.zeros(stride // 4, np.uint8) if channels is None else channels
    fault, place = _attributes(
        readable(data, np.uint8),
        count,
        readable(baseline, np.uint8),
        readable(modes, np.uint8),
        channels is not None,
        block_elements(stride),
        out,
    )
    return out, fault, place


def decode_triangles(data: np.ndarray, count: int, table: np.ndarray) -> tuple[np.ndarray, int, int]:
    """(indices (count), fault, place) of a stream without its tail, the ``table`` of 16 bytes."""
    if count < 0 or count % 3 or data.size < 1 + count // 3 or table.size != 16:
        raise ShapeError(f"triangles: {data.size} bytes and a table of {table.size} do not fit {count} indices")
    out = np.empty(count, np.uint32)
    fault, place = _triangles(readable(data, np.uint8), readable(table, np.uint8), out)
    return out, fault, place


def decode_sequence(data: np.ndarray, count: int) -> tuple[np.ndarray, int, int]:
    """(indices (count), fault, place) of a stream without its tail."""
    out = np.empty(max(count, 0), np.uint32)
    fault, place = _sequence(readable(data, np.uint8), out)
    return out, fault, place


# --- attributes: bytes of an element apart, deltas to the element before -------------------------------------------------


@exact_kernel
def _attributes(data, count, baseline, channels, controlled, per_block, out):
    end, at = data.shape[0], 1
    stride = baseline.shape[0]
    last = baseline.copy()
    deltas = np.empty(4 * BLOCK, np.uint8)
    for first in range(0, count, per_block):
        elements = min(per_block, count - first)
        control = at
        if controlled:
            at += channels.shape[0]
            if at > end:
                return SHORT, control
        for channel in range(channels.shape[0]):
            for k in range(4):
                mode = _VERSION_0
                if controlled:
                    mode = (np.int64(data[control + channel]) >> (2 * k)) & 3
                at = _read_deltas(data, at, mode, elements, deltas, k * BLOCK)
                if at < 0:
                    return SHORT, ~at
            mode = np.int64(channels[channel])
            to = first * stride + 4 * channel
            if mode & 15 == _BYTES:
                _add_bytes(deltas, elements, last, 4 * channel, out, to)
            elif mode & 15 == _PAIRS:
                _add_pairs(deltas, elements, last, 4 * channel, out, to)
            else:
                _add_words(deltas, elements, mode >> 4, last, 4 * channel, out, to)
    return (OK if at == end else LEFT_OVER), at


@exact_kernel
def _read_deltas(data, at, mode, elements, deltas, to):
    """The place after one byte position's deltas of a block, which lie from ``to`` on; ~place where bytes are missing."""
    end = data.shape[0]
    if mode == _ZEROS:
        _fill(deltas, to, elements)
        return at
    if mode == _LITERAL:
        if at + elements > end:
            return ~at
        _copy(data, at, deltas, to, elements)
        return at + elements
    groups = (elements + GROUP - 1) // GROUP
    header = at
    at += (groups + 3) >> 2
    if at > end:
        return ~header
    row = min(mode, 2)
    for group in range(groups):
        bits = _BITS[row, (data[header + (group >> 2)] >> ((group & 3) * 2)) & 3]
        place = to + group * GROUP
        if bits == 0:
            _fill(deltas, place, GROUP)
            continue
        if at + 2 * bits > end:
            return ~at
        if bits == 8:
            _copy(data, at, deltas, place, GROUP)
            at += GROUP
        elif bits == 4:
            at = _read_packed(data, at, 4, deltas, place)
        elif bits == 2:
            at = _read_packed(data, at, 2, deltas, place)
        else:
            at = _read_packed(data, at, 1, deltas, place)
        if at < 0:
            return at
    return at


@exact_kernel
def _fill(deltas, to, count):
    for k in range(count):
        deltas[to + k] = 0


@exact_kernel
def _copy(data, at, deltas, to, count):
    for k in range(count):
        deltas[to + k] = data[at + k]


@exact_kernel
def _read_packed(data, at, bits, deltas, to):
    """The place after one group of deltas of a few bits; a delta of all ones stands in full after the group."""
    end = data.shape[0]
    full = (1 << bits) - 1
    after = at + 2 * bits
    for k in range(GROUP):
        bit = k * bits
        shift = bit & 7 if bits == 1 else 8 - bits - (bit & 7)  # single bits lie the other way round
        delta = (np.int64(data[at + (bit >> 3)]) >> shift) & full
        if delta == full:
            if after >= end:
                return ~after
            delta = np.int64(data[after])
            after += 1
        deltas[to + k] = delta
    return after


@exact_kernel
def _add_bytes(deltas, elements, last, place, out, to):
    stride = last.shape[0]
    a, b, c, d = np.int64(last[place]), np.int64(last[place + 1]), np.int64(last[place + 2]), np.int64(last[place + 3])
    for k in range(elements):
        a += _signed(np.int64(deltas[k]))
        b += _signed(np.int64(deltas[BLOCK + k]))
        c += _signed(np.int64(deltas[2 * BLOCK + k]))
        d += _signed(np.int64(deltas[3 * BLOCK + k]))
        out[to], out[to + 1], out[to + 2], out[to + 3] = a & 255, b & 255, c & 255, d & 255
        to += stride
    last[place], last[place + 1], last[place + 2], last[place + 3] = a & 255, b & 255, c & 255, d & 255


@exact_kernel
def _add_pairs(deltas, elements, last, place, out, to):
    stride = last.shape[0]
    for half in range(0, 4, 2):
        value = np.int64(last[place + half]) | np.int64(last[place + half + 1]) << 8
        at = to + half
        for k in range(elements):
            value += _signed(np.int64(deltas[half * BLOCK + k]) | np.int64(deltas[half * BLOCK + BLOCK + k]) << 8)
            out[at], out[at + 1] = value & 255, (value >> 8) & 255
            at += stride
        last[place + half], last[place + half + 1] = value & 255, (value >> 8) & 255


@exact_kernel
def _add_words(deltas, elements, turn, last, place, out, to):
    """Differences by exclusive or, which the encoder rotated left by ``turn`` bits: back to the right."""
    stride = last.shape[0]
    value = np.int64(0)
    for k in range(4):
        value |= np.int64(last[place + k]) << (8 * k)
    for k in range(elements):
        delta = np.int64(0)
        for byte in range(4):
            delta |= np.int64(deltas[byte * BLOCK + k]) << (8 * byte)
        value ^= ((delta >> turn) | (delta << (32 - turn))) & _WORD
        for byte in range(4):
            out[to + byte] = (value >> (8 * byte)) & 255
        to += stride
    for k in range(4):
        last[place + k] = (value >> (8 * k)) & 255


@exact_kernel
def _signed(code):
    """0, -1, 1, -2, 2, … for the codes 0, 1, 2, 3, 4, …"""
    return (code >> 1) ^ -(code & 1)


# --- indices ----------------------------------------------------------------------------------------------------------------


@exact_kernel
def _read_number(data, at):
    """(number of 32 bits, place after it, fault): seven bits per byte, the last one has no high bit."""
    number = np.int64(0)
    for shift in range(0, 35, 7):
        if at >= data.shape[0]:
            return number, at, SHORT
        byte = np.int64(data[at])
        at += 1
        number |= (byte & 127) << shift
        if byte < 128:
            return number & _WORD, at, OK
    return number, at, LONG


@exact_kernel
def _sequence(data, out):
    at = 1
    last = np.zeros(2, np.int64)
    for k in range(out.shape[0]):
        code, after, fault = _read_number(data, at)
        if fault != OK:
            return fault, at
        at = after
        which = code & 1
        last[which] = (last[which] + _signed(code >> 1)) & _WORD
        out[k] = last[which]
    return (OK if at == data.shape[0] else LEFT_OVER), at


@exact_kernel
def _triangles(data, table, out):
    triangles = out.shape[0] // 3
    at = 1 + triangles  # of what does not fit into the codes
    edges, corners = np.zeros((16, 2), np.int64), np.zeros(16, np.int64)  # the queues, written round and round
    edge_count, corner_count = 0, 0  # entries ever written
    following, last = np.int64(0), np.int64(0)  # the next new index; the last one that was written out
    for triangle in range(triangles):
        code = np.int64(data[1 + triangle])
        high, low = code >> 4, code & 15
        if high < 15:  # an edge and one more corner
            if high >= edge_count:
                return UNWRITTEN, 1 + triangle
            entry = (edge_count - 1 - high) & 15
            a, b = edges[entry, 0], edges[entry, 1]
            is_new = True
            if low == 0:
                c = following
                following = (following + 1) & _WORD
            elif low < 13:
                if low >= corner_count:
                    return UNWRITTEN, 1 + triangle
                c = corners[(corner_count - 1 - low) & 15]
                is_new = False
            else:
                if low == 15:
                    number, after, fault = _read_number(data, at)
                    if fault != OK:
                        return fault, at
                    at = after
                    last = (last + _signed(number)) & _WORD
                else:
                    last = (last + (1 if low == 14 else -1)) & _WORD
                c = last
            if is_new:
                corners[corner_count & 15] = c
                corner_count += 1
        else:  # three corners, which a byte of the table or of the data describes
            if low < 14:
                pair = np.int64(table[low])
            else:
                if at >= data.shape[0]:
                    return SHORT, at
                pair = np.int64(data[at])
                at += 1
                if pair == 0:
                    following = np.int64(0)
            second, third = pair >> 4, pair & 15
            written_out = low >= 14  # 15 stands for a number only there
            if low == 15:
                number, after, fault = _read_number(data, at)
                if fault != OK:
                    return fault, at
                at = after
                last = (last + _signed(number)) & _WORD
                a = last
            else:
                a = following
                following = (following + 1) & _WORD
            b = c = np.int64(0)
            for corner in range(2):
                which = third if corner else second
                if which == 0:
                    index = following
                    following = (following + 1) & _WORD
                elif which == 15 and written_out:
                    number, after, fault = _read_number(data, at)
                    if fault != OK:
                        return fault, at
                    at = after
                    last = (last + _signed(number)) & _WORD
                    index = last
                else:
                    if which > corner_count:
                        return UNWRITTEN, 1 + triangle
                    index = corners[(corner_count - which) & 15]
                if corner:
                    c = index
                else:
                    b = index
            corners[corner_count & 15] = a
            corner_count += 1
            if second == 0 or second == 15:
                corners[corner_count & 15] = b
                corner_count += 1
            if third == 0 or third == 15:
                corners[corner_count & 15] = c
                corner_count += 1
            edges[edge_count & 15, 0], edges[edge_count & 15, 1] = b, a
            edge_count += 1
        edges[edge_count & 15, 0], edges[edge_count & 15, 1] = c, b
        edges[(edge_count + 1) & 15, 0], edges[(edge_count + 1) & 15, 1] = a, c
        edge_count += 2
        out[3 * triangle], out[3 * triangle + 1], out[3 * triangle + 2] = a, b, c
    return (OK if at == data.shape[0] else LEFT_OVER), at
