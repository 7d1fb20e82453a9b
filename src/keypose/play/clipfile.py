"""The file of a compiled clip.

File, little-endian::

    8   "KEYPCLIP"
    4   version (1)
    8   length of the whole file
    4   CRC-32 of everything after this number
    4   length of the header; the header is JSON, deflated
    ... sections, one after another; their sizes follow from the header and from the sections before

Sections: tables (their length in 4 bytes, then deflated: what each joint's rotation is made of, which numbers move, step
sizes of the tracks, bit profiles, scales of the segments), constant quaternions, translations, scales and morph weights,
codes.
"""

from __future__ import annotations

import json
import struct
import zlib
from typing import Any, cast

import numpy as np

from keypose.arrays import Array
from keypose.errors import FormatError
from keypose.play.store import (
    CONSTANT,
    EXACT,
    FINEST,
    FOUR,
    FRAMES,
    MAX_BITS,
    ROWS,
    THREE,
    Packed,
    pack_quaternions,
    segment_offsets,
    unpack_quaternions,
)

MAGIC, VERSION = b"KEYPCLIP", 1
_PREFIX = struct.Struct("<8sIQII")
HEADER_AT = _PREFIX.size
_LONGEST_HEADER = 1 << 26
_MOVED, _SCALED = 8, 16  # flags: a constant translation, scale is stored


def to_bytes(packed: Packed) -> bytes:
    """The whole file."""
    kinds = packed.kinds
    moved = np.any(packed.translations != 0, axis=1)
    scaled = np.any(packed.scales != 1, axis=1)
    flags = (kinds | np.where(moved, _MOVED, 0) | np.where(scaled, _SCALED, 0)).astype(np.uint8)
    header = zlib.compress(
        json.dumps(
            {
                **packed.info,
                "morph_tracks": np.nonzero(packed.morphs_moving)[0].tolist(),
                "profiles": len(packed.book),
                "tracks": packed.track_count,
            },
            ensure_ascii=False,
            separators=(",", ":"),
            allow_nan=False,
        ).encode(),
        9,
    )
    tables = zlib.compress(
        b"".join(
            (
                flags.tobytes(),
                packed.moving.astype("<u2").tobytes(),
                packed.steps.astype("<i2").tobytes(),
                np.ascontiguousarray(packed.book.T, np.uint8).tobytes(),
                packed.segment_scales.astype(np.int8).tobytes(),
            )
        ),
        9,
    )
    sections = [
        struct.pack("<I", len(tables)),
        tables,
        pack_quaternions(packed.before[(kinds == CONSTANT) | (kinds >= THREE)]).astype("<u8").tobytes(),
        pack_quaternions(packed.after[kinds >= THREE]).astype("<u8").tobytes(),
        packed.before[kinds == EXACT].astype("<f4").tobytes(),
        packed.translations[moved].astype("<f4").tobytes(),
        packed.scales[scaled].astype("<f4").tobytes(),
        packed.morphs.astype("<f4").tobytes(),
        packed.codes,
    ]
    rest = struct.pack("<I", len(header)) + header + b"".join(sections)
    length = _PREFIX.size - 4 + len(rest)
    return _PREFIX.pack(MAGIC, VERSION, length, zlib.crc32(rest), len(header)) + rest[4:]


class _Sections:
    """Takes sections off a file and says where it ends too early."""

    def __init__(self, data: memoryview, at: int) -> None:
        self.data, self.at = data, at

    def take(self, count: int, dtype: str, what: str, columns: int = 0) -> Array:
        size = count * max(columns, 1) * np.dtype(dtype).itemsize
        if size > len(self.data) - self.at:
            raise FormatError(f"the file ends inside the {what}: expected {size} bytes", where=f"byte {self.at}")
        array = np.frombuffer(self.data[self.at : self.at + size], dtype)
        self.at += size
        return array.reshape(count, columns) if columns else array


def from_bytes(data: bytes) -> Packed:
    """The stored parts of a file, checked.

    Raises:
        FormatError: where the bytes are no compiled clip, of another version, changed or cut.
    """
    if len(data) < _PREFIX.size or data[:8] != MAGIC:
        raise FormatError("not a compiled clip: expected it to start with 'KEYPCLIP'", where="byte 0")
    _, version, length, checksum, header_size = _PREFIX.unpack_from(data)
    if version != VERSION:
        raise FormatError(f"version {version} of compiled clips; this library reads {VERSION}", where="byte 8")
    if length != len(data):
        raise FormatError(f"expected {length} bytes, the file has {len(data)}", where="byte 12")
    if zlib.crc32(memoryview(data)[_PREFIX.size - 4 :]) != checksum:
        raise FormatError("the checksum does not match: the file was changed", where="byte 20")
    view = memoryview(data)
    sections = _Sections(view, _PREFIX.size)
    info = _header(bytes(sections.take(header_size, "u1", "header")))
    joints, morphs, tracks = len(info["joints"]), len(info["morphs"]), info.pop("tracks")
    profiles, morph_tracks = info.pop("profiles"), info.pop("morph_tracks")
    segments = -(-info["frames"] // FRAMES) + sum(len(n) - 1 for _, n in info["refined"]) if tracks else 0
    size = int(sections.take(1, "<u4", "tables")[0])
    where = sections.at
    length = 3 * joints + 2 * tracks + FRAMES * profiles + segments
    tables = _Sections(memoryview(_inflated(bytes(sections.take(size, "u1", "tables")), length, where)), 0)
    flags = tables.take(joints, "u1", "kinds of rotation")
    kinds = flags & 7
    moving = tables.take(joints, "<u2", "moving numbers").astype(np.uint16)
    before, after = np.tile([1.0, 0, 0, 0], (joints, 1)), np.tile([1.0, 0, 0, 0], (joints, 1))
    coded, exact = kinds >= THREE, kinds == EXACT
    short = (kinds == CONSTANT) | coded
    before[short] = unpack_quaternions(sections.take(int(short.sum()), "<u8", "quaternions"))
    after[coded] = unpack_quaternions(sections.take(int(coded.sum()), "<u8", "quaternions"))
    before[exact] = sections.take(int(exact.sum()), "<f4", "quaternions", 4)
    translations, scales = np.zeros((joints, 3), np.float32), np.ones((joints, 3), np.float32)
    moved, scaled = flags & _MOVED > 0, flags & _SCALED > 0
    translations[moved] = sections.take(int(moved.sum()), "<f4", "translations", 3)
    scales[scaled] = sections.take(int(scaled.sum()), "<f4", "scales", 3)
    morph_base = sections.take(morphs, "<f4", "morph weights")
    steps = tables.take(tracks, "<i2", "steps")
    book = tables.take(FRAMES, "u1", "profiles", profiles).T if profiles else np.zeros((0, FRAMES), np.uint8)
    segment_scales = tables.take(segments, "i1", "scales of segments")
    codes = bytes(view[sections.at :])
    morphs_moving = np.zeros(morphs, bool)
    morphs_moving[morph_tracks] = True
    _check_parts(kinds, moving, morphs_moving, tracks, book, before, (translations, scales, morph_base))
    packed = Packed(
        info, kinds, moving, before, after, translations, scales, morph_base, morphs_moving, steps,
        np.ascontiguousarray(book), segment_scales, codes,
    )  # fmt: skip
    segment_offsets(packed)
    return packed


def _check_parts(
    kinds: Array,
    moving: Array,
    morphs_moving: Array,
    tracks: int,
    book: Array,
    before: Array,
    numbers: tuple[Array, ...],
) -> None:
    if len(kinds) and int(kinds.max()) > FOUR:
        raise FormatError(f"unknown kind of rotation {int(kinds.max())}", where="section of kinds")
    bits = np.unpackbits(moving.astype("<u2").view(np.uint8).reshape(-1, 2), axis=1, bitorder="little")
    turning = bits[:, :4].any(axis=1)
    if bits[:, ROWS:].any() or np.any(turning & (kinds < THREE)) or np.any(bits[:, 0].astype(bool) & (kinds != FOUR)):
        raise FormatError("a moving number that its joint does not have", where="section of moving numbers")
    if int(bits.sum()) + int(morphs_moving.sum()) != tracks:
        raise FormatError(
            f"{int(bits.sum()) + int(morphs_moving.sum())} moving numbers for {tracks} tracks", where="header"
        )
    if book.size and int(book.max()) > MAX_BITS:
        raise FormatError(f"a coefficient of {int(book.max())} bits", where="section of profiles")
    if not all(np.all(np.isfinite(n)) for n in (*numbers, before)):
        raise FormatError("a constant is not a finite number", where="section of constants")
    if np.any(np.abs(np.linalg.norm(before, axis=1) - 1) > 1e-3):
        raise FormatError("a constant rotation is not of length one", where="section of quaternions")


_SHAPE: dict[str, type | tuple[type, ...]] = {
    "name": str, "joints": list, "morphs": list, "frames": int, "rate_hz": (int, float), "start_s": (int, float),
    "loop": bool, "tolerance_m": (int, float), "shell_m": (int, float), "error": dict, "events": list, "tracks": int,
    "profiles": int, "morph_tracks": list, "refined": list,
}  # fmt: skip


def _inflated(deflated: bytes, most: int, where: int, exact: bool = True) -> bytes:
    """What was deflated; never more than ``most`` bytes of it are held."""
    try:
        inflate = zlib.decompressobj()
        data = inflate.decompress(deflated, max(most, 1))
        more = not inflate.eof and inflate.decompress(inflate.unconsumed_tail, 1)
    except zlib.error as error:
        raise FormatError(f"cannot be inflated: {error}", where=f"byte {where}") from None
    if more or (exact and len(data) != most):
        raise FormatError(f"expected {most} bytes when inflated", where=f"byte {where}")
    return data


def _halves(pair: Any, slots: int) -> bool:
    """Whether this is a slot and the levels of the segments into which it is halved."""
    if not isinstance(pair, list) or len(cast(list[Any], pair)) != 2:
        return False
    slot, levels = cast(list[Any], pair)
    if type(slot) is not int or not 0 <= slot < slots or not isinstance(levels, list):
        return False
    at, whole = 0, 1 << FINEST
    for level in cast(list[Any], levels):
        if type(level) is not int or not 0 < level <= FINEST or at % (whole >> level):
            return False
        at += whole >> level
    return at == whole


def _header(deflated: bytes) -> dict[str, Any]:
    where = f"byte {_PREFIX.size}"
    try:
        loaded = json.loads(_inflated(deflated, _LONGEST_HEADER, _PREFIX.size, exact=False))
    except (ValueError, RecursionError) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"the header cannot be read: {error}", where=where) from None
    if not isinstance(loaded, dict):
        raise FormatError("the header is no object", where=where)
    info = cast(dict[str, Any], loaded)
    for key, kind in _SHAPE.items():
        if not isinstance(info.get(key), kind) or (kind is not bool and isinstance(info.get(key), bool)):
            raise FormatError(f"header: expected '{key}' to be a {kind}", where=where)
    numbers = [info[k] for k in ("rate_hz", "start_s", "tolerance_m", "shell_m")]
    if not all(abs(n) < 1e300 for n in numbers) or info["rate_hz"] <= 0:  # also false for NaN
        raise FormatError("header: expected finite numbers and a positive rate", where=where)
    if info["frames"] < 1 or info["tracks"] < 0 or not 0 <= info["profiles"] <= 255:
        raise FormatError("header: expected frames, and at most 255 profiles", where=where)
    if info["frames"] > 1 << 40:
        raise FormatError(f"header: {info['frames']} frames", where=where)
    slots = -(-info["frames"] // FRAMES)
    for pair in info["refined"]:
        if not _halves(pair, slots):
            raise FormatError(f"header: no refinement of a slot: {str(pair)[:80]}", where=where)
    if len({slot for slot, _ in info["refined"]}) != len(info["refined"]):
        raise FormatError("header: a slot is refined twice", where=where)
    if not all(isinstance(n, str) for n in (*info["joints"], *info["morphs"])):
        raise FormatError("header: expected names to be text", where=where)
    if not all(isinstance(m, int) and 0 <= m < len(info["morphs"]) for m in info["morph_tracks"]):
        raise FormatError("header: a morph track of no morph", where=where)
    return info
