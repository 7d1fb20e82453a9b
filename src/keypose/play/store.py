"""What is stored of a compiled clip, and the arrays that the decoder runs on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import FormatError
from keypose.math import quat

FINEST = 5  # a slot is halved so often at most
FRAMES, MAX_BITS, MARGIN, ENTRY, ROWS, HEADER = 16, 24, 64, 128, 10, 16

# What a joint's rotation is made of.
IDENTITY, CONSTANT, EXACT, THREE, FOUR = range(5)


@dataclass(frozen=True, slots=True, eq=False)
class Packed:
    """Everything of a compiled clip that is stored, in the precision in which it is stored.

    J joints, M morphs, N tracks (sorted by row w x y z, translation, scale, then by joint; then morphs),
    S segments of 16 frames, P profiles.
    """

    info: dict[str, Any]
    kinds: Array  # (J,) uint8
    moving: Array  # (J,) uint16, bits 0-9: w x y z, translation, scale
    before: Array  # (J, 4) float64: rotation = before * coded * after
    after: Array  # (J, 4)
    translations: Array  # (J, 3) float32
    scales: Array  # (J, 3) float32
    morphs: Array  # (M,) float32
    morphs_moving: Array  # (M,) bool
    steps: Array  # (N,) int16: a step is 2 ** (n / 4)
    book: Array  # (P, 16) uint8 bit widths, sorted by their sums
    segment_scales: Array  # (S,) int8: 2 ** (n / 8)
    codes: bytes  # per segment N profiles and the coefficients

    @property
    def track_count(self) -> int:
        """N."""
        return len(self.steps)


@dataclass(frozen=True, slots=True, eq=False)
class Decoder:
    """The arrays that `keypose.kernels.decode` runs on; see there for the layout."""

    layout: Array
    tables: Array
    book: Array
    codes: Array

    @property
    def padded(self) -> int:
        """Joints, filled up to a multiple of 16."""
        return int(self.layout[0])

    @property
    def room(self) -> int:
        """float32 numbers that decoding needs beside its result."""
        return int(self.layout[1]) + 16

    @property
    def stride(self) -> int:
        """float32 numbers of one decoded pose."""
        return ROWS * self.padded + int(self.layout[3])


def cosines() -> Array:
    """The orthonormal cosine transform of a segment, (16 frames, 16 coefficients) float64."""
    frame, k = np.arange(FRAMES)[:, None], np.arange(FRAMES)
    basis = np.cos(np.pi * (frame + 0.5) * k / FRAMES) * np.sqrt(2 / FRAMES)
    basis[:, 0] = np.sqrt(1 / FRAMES)
    return basis


# --- quaternions in eight bytes ------------------------------------------------------------------------------------------

_FINE = (1 << 19) - 1  # largest number of 20 bits with a sign
# No component but the largest can be greater than sqrt(1/2). Among nearly equal ones the first counts as the largest, so
# that what was unpacked packs to the same number again.
_ALIKE, _REACH = 1e-5, 0.7072


def pack_quaternions(q: Array) -> Array:
    """Unit quaternions (N, 4) as (N,) uint64: which component is largest, and the three others in 20 bits each."""
    q = np.asarray(q, np.float64)
    rows = np.arange(len(q))
    size = np.abs(q)
    largest = np.argmax(size >= np.max(size, axis=1, keepdims=True) - _ALIKE, axis=1)
    q = q * np.where(q[rows, largest] < 0, -1.0, 1.0)[:, None]
    packed = largest.astype(np.uint64)
    for k in range(1, 4):
        value = np.rint(q[rows, (largest + k) % 4] / _REACH * _FINE)
        code = (np.clip(value, -_FINE, _FINE) + _FINE).astype(np.uint64)
        packed |= code << np.uint64(20 * k - 18)
    return packed


def unpack_quaternions(packed: Array) -> Array:
    """The inverse of `pack_quaternions`, (N, 4) float64; any number gives a unit quaternion."""
    packed = np.asarray(packed, np.uint64)
    rows = np.arange(len(packed))
    q = np.zeros((len(packed), 4))
    largest = (packed & np.uint64(3)).astype(np.intp)
    for k in range(1, 4):
        code = (packed >> np.uint64(20 * k - 18)) & np.uint64((1 << 20) - 1)
        q[rows, (largest + k) % 4] = (code.astype(np.float64) - _FINE) / _FINE * _REACH
    q[rows, largest] = np.sqrt(np.maximum(0.0, 1.0 - np.sum(q * q, axis=1)))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


# --- tracks --------------------------------------------------------------------------------------------------------------


def moving_rows(packed: Packed) -> Array:
    """Which numbers of the pose have a track, (10, J) bool; tracks are stored in this order, then those of morphs."""
    return (packed.moving[None, :] >> np.arange(ROWS)[:, None]) & 1 > 0


def track_targets(packed: Packed, padded: int) -> Array:
    """Where in a decoded pose the number of each track is, (N,)."""
    row, joint = np.nonzero(moving_rows(packed))
    return np.concatenate([row * padded + joint, ROWS * padded + np.nonzero(packed.morphs_moving)[0]])


def _masks(packed: Packed, padded: int, morph_room: int) -> Array:
    """Per 16 numbers of the pose which have a track, as bits, and how many tracks come before, (blocks, 2) int64."""
    moves = np.zeros(ROWS * padded + morph_room, bool)
    moves[track_targets(packed, padded)] = True
    blocks = moves.reshape(-1, FRAMES)
    counts = blocks.sum(axis=1)
    return np.stack([(blocks << np.arange(FRAMES)).sum(axis=1), np.cumsum(counts) - counts], axis=1).astype(np.int64)


def slot_levels(info: Mapping[str, Any]) -> list[list[int]]:
    """Of each slot of 16 frames the levels of its segments, in order of time: level n lasts 16 / 2 ** n frames."""
    slots = [[0] for _ in range(-(-info["frames"] // FRAMES))]
    for slot, levels in info["refined"]:
        slots[slot] = levels
    return slots


def segment_starts(slots: list[list[int]]) -> tuple[Array, Array]:
    """The first frame of each segment, (S,) float64, and its level, (S,)."""
    levels = np.array([n for slot in slots for n in slot], np.int64)
    lengths = FRAMES / (1 << levels)
    return np.cumsum(lengths) - lengths, levels


def _cells(slots: list[list[int]]) -> tuple[Array, Array]:
    """The slots' and the cells' entries of the decoder's layout."""
    entries, cells, segment = [], [], 0
    for slot in slots:
        deepest = max(slot)
        entries.append(len(cells) * 8 + deepest)
        for level in slot:
            cells += [segment * 8 + level] * (1 << (deepest - level))
            segment += 1
    return np.array(entries, np.int64), np.array(cells, np.int64)


def segment_offsets(packed: Packed) -> Array:
    """Byte offset of each segment in the codes, and the end of the last, (S + 1,).

    Raises:
        FormatError: where the codes end too early or too late, or name a profile that does not exist.
    """
    tracks, segments = packed.track_count, len(packed.segment_scales)
    sizes = profile_bytes(packed.book)
    codes = np.frombuffer(packed.codes, np.uint8)
    offsets = np.zeros(segments + 1, np.int64)
    at = 0
    for s in range(segments):
        profiles = codes[at : at + tracks]
        if len(profiles) < tracks:
            raise FormatError("the file ends inside the profiles", where=f"segment {s}")
        if tracks and int(profiles.max()) >= len(sizes):
            raise FormatError(f"profile {int(profiles.max())} of {len(sizes)}", where=f"segment {s}")
        at += tracks + int(sizes[profiles].sum())
        offsets[s + 1] = at
    if at != len(codes):
        raise FormatError(f"expected {at} bytes of codes, got {len(codes)}", where=f"segment {segments - 1}")
    return offsets


def decoder(packed: Packed) -> Decoder:
    """The run-time arrays of a compiled clip."""
    from keypose.kernels.runtime import aligned, aligned_copy

    joints, morphs = len(packed.kinds), len(packed.morphs)
    tracks = -(-packed.track_count // FRAMES) * FRAMES
    segments, frames = len(packed.segment_scales), int(packed.info["frames"])
    padded, morph_room = -(-max(joints, 1) // 16) * 16, -(-morphs // 16) * 16
    steps_at = FRAMES * FRAMES
    scales_at = steps_at + tracks
    base_at = -(-(scales_at + segments) // 16) * 16
    before_at = base_at + ROWS * padded + morph_room
    tables = aligned(before_at + 9 * padded)
    tables[:steps_at] = cosines().ravel()
    tables[steps_at:][: packed.track_count] = np.exp2(packed.steps / 4) / 2  # codes count half steps
    tables[scales_at : scales_at + segments] = np.exp2(packed.segment_scales / 8)
    base = tables[base_at : base_at + ROWS * padded].reshape(ROWS, padded)
    base[7:] = 1.0
    base[4:7, :joints] = packed.translations.T
    base[7:, :joints] = packed.scales.T
    tables[base_at + ROWS * padded :][:morphs] = packed.morphs
    around = tables[before_at:].reshape(9, padded)
    around[0], around[4] = 1.0, 1.0
    around[:4, :joints], around[4:8, :joints] = packed.before.T, packed.after.T
    around[8] = 1.0  # x, y, z are divided by 1 + w
    around[8, :joints][packed.kinds == FOUR] = 0.0

    slots, cells = _cells(slot_levels(packed.info) if tracks else [])
    masks = _masks(packed, padded, morph_room)
    resting = ~masks[: 4 * padded // FRAMES, 0].reshape(4, -1).any(axis=0).repeat(FRAMES)
    base[:4, resting] = quat.multiply(around[:4].T, around[4:8].T).T[:, resting]
    masks = masks.ravel()
    slots_at = HEADER + len(masks)
    cells_at = slots_at + len(slots)
    offsets_at = cells_at + len(cells)
    codes, offsets = _run_time_codes(packed, tracks)
    header = np.zeros(HEADER, np.int64)
    header[:12] = (
        padded, tracks, frames, morph_room, slots_at, steps_at, scales_at, base_at, before_at, HEADER, offsets_at,
        cells_at,
    )  # fmt: skip
    layout = np.concatenate([header, masks, slots, cells, offsets])
    arrays = (layout, tables, aligned_copy(_book_table(packed.book), np.uint8), codes)
    for array in arrays:
        array.setflags(write=False)
    return Decoder(*arrays)


def _run_time_codes(packed: Packed, tracks: int) -> tuple[Array, Array]:
    """The codes with the profiles of every segment filled up to ``tracks`` by the empty one, and the segments' offsets."""
    from keypose.kernels.runtime import aligned

    given, filled = packed.track_count, tracks - packed.track_count
    stored = np.frombuffer(packed.codes, np.uint8)
    offsets = segment_offsets(packed)
    moved = offsets[:-1] + filled * np.arange(len(offsets) - 1) + MARGIN
    codes = aligned(2 * MARGIN + len(stored) + filled * len(moved), np.uint8)
    for at, start, end in zip(moved.tolist(), offsets[:-1].tolist(), offsets[1:].tolist(), strict=True):
        codes[at : at + given] = stored[start : start + given]
        codes[at + given : at + tracks] = len(packed.book)
        codes[at + tracks : at + filled + end - start] = stored[start + given : end]
    return codes, moved


def profile_bytes(book: Array) -> Array:
    """Bytes that one track takes with each profile, (P,)."""
    return (book.astype(np.int64).sum(axis=1) + 7) // 8


def _book_table(book: Array) -> Array:
    """Per profile the bytes that the decoder reads: where the coefficients are, shifts, where each four start, size.

    The last one stores nothing.
    """
    from keypose.kernels.decode import WINDOWED

    widths = np.concatenate([book.astype(np.int64), np.zeros((1, FRAMES), np.int64)])
    table = np.zeros((len(widths), ENTRY), np.uint8)
    starts = np.cumsum(widths, axis=1) - widths
    windows = starts[:, ::4] // 8
    where = starts // 8 - (np.repeat(windows, 4, axis=1) if WINDOWED else 0)
    table[:, :64] = (where[:, :, None] + np.arange(4)).reshape(len(widths), 64)
    table[:, 64:80] = np.where(widths > 0, 32 - starts % 8 - widths, 0)
    table[:, 80:96] = np.where(widths > 0, 31 - widths, 0)
    table[:, 96:100] = windows
    table[:, 100] = (widths.sum(axis=1) + 7) // 8
    return table


# --- codes ---------------------------------------------------------------------------------------------------------------


def pack_codes(profiles: Array, coefficients: Array, book: Array) -> bytes:
    """One segment: its profiles (N,), then of each track the coefficients (16,) in the profile's bits, lowest bit first."""
    widths = book[profiles].astype(np.int64)
    fill = profile_bytes(book)[profiles] * 8 - widths.sum(axis=1)  # up to whole bytes
    widths = np.concatenate([widths, fill[:, None]], axis=1).ravel()
    values = np.concatenate([coefficients, np.zeros((len(profiles), 1), np.int64)], axis=1).ravel() & (
        (1 << widths) - 1
    )
    place = np.arange(MAX_BITS)
    bits = ((values[:, None] >> place) & 1).astype(np.uint8)[place < widths[:, None]]
    return profiles.astype(np.uint8).tobytes() + np.packbits(bits, bitorder="little").tobytes()


def unpack_segment(packed: Packed, offsets: Array, segment: int) -> Array:
    """Coefficients (N, 16) float64 of one segment, decoded plainly: what the kernel is tested against."""
    tracks = packed.track_count
    block = np.frombuffer(packed.codes, np.uint8)[offsets[segment] : offsets[segment + 1]]
    widths = packed.book[block[:tracks]].astype(np.int64)
    bits = np.unpackbits(block[tracks:], bitorder="little")
    result, at = np.zeros((tracks, FRAMES)), 0
    steps = np.exp2(packed.steps / 4) * np.exp2(packed.segment_scales[segment] / 8)
    for n in range(tracks):
        for k in range(FRAMES):
            width = int(widths[n, k])
            if width:
                value = int(sum(int(b) << i for i, b in enumerate(bits[at : at + width])))
                value -= (value >> (width - 1)) << width
                result[n, k] = (value + 0.5) * steps[n]
            at += width
        at = -(-at // 8) * 8
    return result
