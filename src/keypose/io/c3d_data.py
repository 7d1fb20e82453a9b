"""The header and the data section of C3D files as arrays: three number formats, integers and floats.

Source: The C3D File Format, A Technical User Guide (Motion Lab Systems, 2021), chapters "The Header Section",
"3D Point Data" and "Analog Data".
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Array
from keypose.errors import FormatError
from keypose.io.axes import right_of
from keypose.io.c3d_parameters import BLOCK, DEC, MIPS, PROCESSORS, Groups, dec_floats, floats, strings, text

_MAGIC = 0x50
_HAS_LONG_LABELS = 12345
_MOST_EVENTS = 18
_AXES = ("+X", "-X", "X", "+Y", "-Y", "Y", "+Z", "-Z", "Z")


@dataclass(frozen=True, slots=True)
class HeaderEvent:
    """One of up to 18 events in the header: seconds from frame 1, four letters, and whether it is shown."""

    time_s: float
    label: str
    shown: bool = True


@dataclass(frozen=True, slots=True)
class Header:
    """The first block of the file.

    Shapes and units: frames are numbered as in the file; ``scale`` is below 0 where the data are floats;
    ``analog_words`` is the number of analog values in each frame, ``samples`` how many of them each channel has.
    """

    parameter_block: int
    processor: int
    points: int
    analog_words: int
    first: int
    last: int
    gap: int
    scale: float
    data_block: int
    samples: int
    rate_hz: float
    events: tuple[HeaderEvent, ...] = ()


def parse_header(data: bytes) -> Header:
    """The header of a file.

    Raises:
        FormatError: where the file is too short, is no C3D file or is of an unknown processor.
    """
    if len(data) < BLOCK:
        raise FormatError(f"{len(data)} bytes; the header of a C3D file alone has {BLOCK}", where=f"byte {len(data)}")
    if data[1] != _MAGIC:
        raise FormatError(f"expected {_MAGIC:#x}, the mark of a C3D file, found {data[1]:#x}", where="byte 1")
    start = (data[0] - 1) * BLOCK
    if data[0] == 0 or start + 4 > len(data):
        raise FormatError(f"the parameter section is in block {data[0]}, which is not in the file", where="byte 0")
    processor = data[start + 3]
    processor += 83 if processor in (1, 2, 3) else 0
    if processor not in PROCESSORS:
        raise FormatError(
            f"processor type {processor}; expected 84 (Intel), 85 (DEC) or 86 (MIPS)", where=f"byte {start + 3}"
        )
    order = ">" if processor == MIPS else "<"
    points, analog, first, last, gap = struct.unpack_from(order + "5H", data, 2)
    block, samples = struct.unpack_from(order + "2H", data, 16)
    scale, rate = float(floats(data[12:16], processor)[0]), float(floats(data[20:24], processor)[0])
    events = _parse_events(data, order, processor)
    return Header(data[0], processor, points, analog, first, last, gap, scale, block, samples, rate, events)


def _parse_events(data: bytes, order: str, processor: int) -> tuple[HeaderEvent, ...]:
    mark, count = struct.unpack_from(order + "2H", data, 298)
    if mark != _HAS_LONG_LABELS or not 0 < count <= _MOST_EVENTS:
        return ()
    times = floats(data[304:376], processor).tolist()
    labels = [text(data[396 + 4 * i : 400 + 4 * i]).strip() for i in range(count)]
    return tuple(HeaderEvent(times[i], labels[i], data[376 + i] == 1) for i in range(count) if np.isfinite(times[i]))


def compose_header(header: Header) -> bytes:
    """The header's block in Intel's order."""
    block = bytearray(BLOCK)
    counts = (header.points, header.analog_words, header.first, header.last, header.gap)
    struct.pack_into("<BB5Hf2Hf", block, 0, header.parameter_block, _MAGIC, *counts, header.scale,
                     header.data_block, header.samples, header.rate_hz)  # fmt: skip
    events = header.events[:_MOST_EVENTS]
    struct.pack_into("<2H", block, 298, _HAS_LONG_LABELS, len(events))
    for i, event in enumerate(events):
        struct.pack_into("<f", block, 304 + 4 * i, event.time_s)
        block[376 + i] = 1 if event.shown else 0
        block[396 + 4 * i : 400 + 4 * i] = event.label.encode("ascii", "replace")[:4].ljust(4)
    return bytes(block)


@dataclass(frozen=True, slots=True, eq=False)
class Words:
    """The data section: ``points`` (T, N, 4) and ``analog`` (T, C * samples), int16 or float32 as in the file."""

    points: Array
    analog: Array
    is_float: bool


def read_words(
    data: bytes, start: int, frames: int, points: int, analog_words: int, processor: int, is_float: bool
) -> Words:
    """The data section's numbers; the caller has checked that they are there."""
    width = 4 * points + analog_words
    count = frames * width
    if is_float and processor == DEC:
        halves = np.frombuffer(data, "<u2", 2 * count, start).reshape(-1, 2)
        bits = halves[:, 0].astype(np.uint32) << np.uint32(16)
        bits |= halves[:, 1]
        table = dec_floats(bits)
    else:
        order = ">" if processor == MIPS else "<"
        table = np.frombuffer(data, order + ("f4" if is_float else "i2"), count, start)
        if order == ">":
            table = table.astype(table.dtype.newbyteorder("="))
    table = table.reshape(frames, width)
    # splitting the last axis of a slice needs no copy
    return Words(table[:, : 4 * points].reshape(frames, points, 4), table[:, 4 * points :], is_float)


def seen(words: Words) -> tuple[Array, Array]:
    """Which points (T, N) were seen, and the fourth word (T, N) of each as int32.

    The fourth word holds the residual in its low byte and the cameras in its high byte; below 0 nothing was seen. Some
    writers of floats store it without its sign: 65535 is -1.
    """
    fourth = words.points[..., 3]
    if words.is_float:
        sane = np.abs(fourth) < 65536.0  # not so for what is not a number
        whole = np.where(sane, fourth, -1.0).astype(np.int32)
        whole[whole > 32767] -= 65536
    else:
        whole = fourth.astype(np.int32)
    visible = whole >= 0
    if words.is_float:
        visible &= np.isfinite(words.points[..., 0])
        visible &= np.isfinite(words.points[..., 1])
        visible &= np.isfinite(words.points[..., 2])
    return visible, whole


def pack_points(values: Array, visible: Array, fourth: Array) -> Array:
    """float32 words (T, N, 4) of values (T, N, 3); what was not seen becomes 0, 0, 0, -1."""
    out = np.zeros((*visible.shape, 4), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        out[..., :3] = values
    out[..., 3] = fourth
    out[~visible] = (0.0, 0.0, 0.0, -1.0)
    return out


# --- what is kept of a file -------------------------------------------------------------------------------------------

KINDS = {"ANGLES": "angle", "FORCES": "force", "MOMENTS": "moment", "POWERS": "power", "SCALARS": "scalar"}
"""Parameters of POINT that list points which are no markers, and the ``kind`` of their `Signals`."""


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """What a C3D file says beyond its markers and signals, for `write`: the scene's ``extras["c3d"]``.

    Shapes and units:
        groups: all parameters as in the file, by group and name.
        header: the first block of the file.
        points: the unique name and the file's label of every point, in the file's order; ``analog`` likewise.
    """

    groups: Groups
    header: Header
    points: tuple[tuple[str, str], ...]
    analog: tuple[tuple[str, str], ...]


def screen(groups: Groups, up: str | None) -> tuple[str, str] | None:
    """The lab's axes to the right and up ("+X", "+Z") as POINT:X_SCREEN and Y_SCREEN say, with ``up`` ("Z") before them."""
    right = next(iter(strings(groups, "POINT", "X_SCREEN")), "").strip().upper()
    said = next(iter(strings(groups, "POINT", "Y_SCREEN")), "").strip().upper()
    if up is not None and said not in (up, f"+{up}"):
        said = f"+{up}"
    if said not in _AXES:
        return None
    if right not in _AXES or right[-1] == said[-1]:
        right = right_of(said)
    return right, said
