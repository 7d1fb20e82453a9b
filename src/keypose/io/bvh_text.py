"""BVH as text: bytes to a plain description of the file, and back.

The description keeps the file's own units, axes, channel orders and degrees; `keypose.io.bvh` gives it its meaning.

Source: M. Meredith and S. Maddock, "Motion Capture File Formats Explained" (University of Sheffield, CS-01-11), section
on BVH, with the variations found in the files of many exporters.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import BufferedReader

import numpy as np

from keypose.arrays import Floats
from keypose.errors import FormatError
from keypose.io.bvh_hierarchy import LARGEST, Hierarchy, Vector, parse_hierarchy
from keypose.io.text import SMALL_BYTES, SMALL_NUMBERS, format_rows, line_of, parse_block, shown, to_number

# Joints without channels cost no bytes in the motion block, but memory in every frame: a file may ask for this many
# bytes of poses per byte of its own (a joint of three rotations needs about two), and for _FREE_BYTES in any case.
_BYTES_PER_BYTE = 64
_FREE_BYTES = 1 << 26
_DEEPEST_INDENT = 100
# Large enough that the work per block does not show, small enough for the second-level cache.
_BLOCK_BYTES = 1 << 19
_BLOCK_NUMBERS = 1 << 15
_HEAD_BYTES = 1 << 16

_MOTION = re.compile(rb"(?:\A|[\r\n])[ \t]*MOTION(?=\s|\Z)", re.IGNORECASE)
_GAP = rb"\s*+(?:(?:#|//)[^\r\n]*+\s*+)*+"
_FRAMES = re.compile(_GAP + rb"Frames[ \t]*:?[ \t]*([^\s]+)", re.IGNORECASE)
_FRAME_TIME = re.compile(_GAP + rb"Frame[ \t]*Time[ \t]*:?[ \t]*([^\s]+)", re.IGNORECASE)
_COMMENT = re.compile(rb"(?:\A|(?<=[\r\n]))[ \t]*+(?:#|//)[^\r\n]*+")
_LINE = re.compile(rb"([^\r\n]*+)(?:\r\n?|\n|\Z)")


@dataclass(slots=True)
class BvhText:
    """What a BVH file says.

    Shapes and units:
        hierarchy: J joints and their C channels.
        frame_count: T; 0 where the file has no MOTION.
        blocks: the frames as tables (N, C) of degrees and the file's length unit, one after the other, T rows in all.
            They are read as they are asked for, so that large files are never in memory as a whole table; a fault is
            raised where it is met.
        frame_time_s: with its text as written; None where the file has no MOTION.
        notes: what was odd.
    """

    hierarchy: Hierarchy
    frame_count: int
    blocks: Iterable[Floats]
    frame_time_s: float | None
    frame_time_text: str
    notes: list[str]


def parse(file: BufferedReader, *, keep_whole_frames: bool = False) -> BvhText:
    """Read a BVH file that is open for reading bytes, and stays open until the blocks have been read.

    ``keep_whole_frames`` accepts a motion block that is shorter or longer than ``Frames:`` says and keeps the whole
    frames that are there; without it such a file is refused.

    Raises:
        FormatError: at the first thing that does not follow the format, with its line.
    """
    head, motion = _head(file)
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise FormatError("the text is UTF-16; expected UTF-8 or ASCII", where="line 1")
    hierarchy = parse_hierarchy(head[: motion.start()] if motion else head)
    text = BvhText(hierarchy, 0, (), None, "", list(hierarchy.notes))
    if motion:
        _parse_motion(file, head, motion.end(), text, keep_whole_frames)
    else:
        text.notes.append("no MOTION section: the file holds a skeleton only")
    return text


def _head(file: BufferedReader) -> tuple[bytes, re.Match[bytes] | None]:
    """The start of the file to beyond MOTION and its two lines, and the place of MOTION; all of it without one."""
    head = b""
    while True:
        more = file.read(max(len(head), _HEAD_BYTES))  # doubles: a long hierarchy is searched a few times only
        head += more
        motion = _MOTION.search(head)
        if not more or (motion and len(head) - motion.end() >= _HEAD_BYTES // 2):
            return head, motion


def _parse_motion(file: BufferedReader, data: bytes, at: int, text: BvhText, keep_whole_frames: bool) -> None:
    frames = _FRAMES.match(data, at)
    if not frames:
        raise FormatError("expected 'Frames:' after MOTION", where=f"line {line_of(data, at)}")
    where = f"line {line_of(data, frames.start(1))}"
    if not (frames[1].isdigit() and len(frames[1]) < 16):
        raise FormatError(f"Frames: expected a count, found {shown(frames[1])}", where=where)
    announced = int(frames[1])
    timed = _FRAME_TIME.match(data, frames.end())
    if not timed:
        raise FormatError(
            "expected 'Frame Time:' after the frame count", where=f"line {line_of(data, frames.end()) + 1}"
        )
    text.frame_time_text = timed[1].decode("latin-1")
    text.frame_time_s = _frame_time(text.frame_time_text, f"line {line_of(data, timed.start(1))}")
    size = file.seek(0, os.SEEK_END)
    motion = _Motion(file, size, timed.end(), text.hierarchy.channel_count, announced, where)
    if motion.channels == 0:
        motion.refuse_numbers()
        if announced:
            text.notes.append(f"no joint has channels: the {announced} frames hold nothing")
        return
    if keep_whole_frames:
        text.blocks, text.frame_count = motion.kept(text.notes)
    else:
        # a number takes two bytes at least: what cannot be there must not ask for memory
        if announced * motion.channels * 2 > size - motion.start + 1:
            raise motion.too_few()
        text.blocks, text.frame_count = motion.blocks(), announced
    joints = len(text.hierarchy.joints)
    pose_bytes = text.frame_count * joints * 7 * 8
    if pose_bytes > max(_FREE_BYTES, _BYTES_PER_BYTE * size):
        raise FormatError(
            f"{text.frame_count} frames of {joints} joints, nearly all without channels, "
            f"would take {pose_bytes >> 20} MiB",
            where=where,
        )


class _Motion:
    """The numbers behind Frame Time, read in blocks that fit the processor's cache."""

    def __init__(self, file: BufferedReader, size: int, start: int, channels: int, announced: int, where: str) -> None:
        self.file, self.size, self.start = file, size, start
        self.channels, self.announced, self.where = channels, announced, where
        self.left_over = 0

    def blocks(self) -> Iterator[Floats]:
        """Whole frames, block by block; raises at the end where their number is not the announced one."""
        found = 0
        for values in self.tables():
            found += len(values)
            if found > self.announced:
                raise self.wrong_count()
            yield values
        if found != self.announced or self.left_over:
            raise self.wrong_count()

    def kept(self, notes: list[str]) -> tuple[list[Floats], int]:
        """All whole frames that are there, and their number."""
        blocks = list(self.tables())
        found = sum(map(len, blocks))
        if found != self.announced or self.left_over:
            notes.append(
                f"Frames: says {self.announced}, but the file holds {found * self.channels + self.left_over} numbers: "
                f"{found} whole frames of {self.channels} kept, {self.left_over} numbers dropped"
            )
        return blocks, found

    def refuse_numbers(self) -> None:
        """Without channels there must be none."""
        for offset, text, end in self.texts():
            if len(self.numbers(offset, text, end)):
                line = line_of(self.whole(), self.start) + 1
                raise FormatError("numbers follow, but no joint has channels", where=f"line {line}")

    def tables(self) -> Iterator[Floats]:
        """Tables (N, C) of whole frames; a frame that lies across two blocks, or lines, is put together."""
        rest = np.zeros(0)
        self.left_over = 0
        read = 0
        for offset, text, end in self.texts():
            values = self.numbers(offset, text, end)
            # two reductions and no temporary array; NaN cannot come from text that is all digits
            if len(values) and (values.max() > LARGEST or values.min() < -LARGEST):
                raise self.too_large(read, values)
            read += len(values)
            if len(rest):
                values = np.concatenate([rest, values])
            whole = len(values) // self.channels * self.channels
            rest = values[whole:].copy()
            if whole:
                yield values[:whole].reshape(-1, self.channels)
        self.left_over = len(rest)

    def texts(self) -> Iterator[tuple[int, bytearray, int]]:
        """Pieces of the file, cut between lines, or between words of a very long line.

        Each is an offset in the file and a buffer with the length of the text in it; the buffer is used again.
        """
        self.file.seek(self.start)
        offset, buffer, used = self.start, bytearray(2 * _BLOCK_BYTES), 0
        while True:
            if len(buffer) - used < _BLOCK_BYTES:  # a word that is longer than a block
                buffer = buffer + bytearray(len(buffer))
            with memoryview(buffer) as view, view[used : used + _BLOCK_BYTES] as room:
                count = self.file.readinto(room)
            if not count:
                break
            used += count
            cut = 1 + max(buffer.rfind(b"\n", 0, used), buffer.rfind(b"\r", 0, used))
            cut = cut or 1 + max(buffer.rfind(b" ", 0, used), buffer.rfind(b"\t", 0, used))
            if cut:
                yield offset, buffer, cut
                buffer[: used - cut] = buffer[cut:used]
                offset, used = offset + cut, used - cut
        if used:
            yield offset, buffer, used

    def numbers(self, offset: int, text: bytearray, end: int) -> Floats:
        """The numbers of one piece, without comments."""
        compiled = self.size - self.start > SMALL_BYTES
        values, wrong = parse_block(text, 0, end, compiled=compiled)
        if wrong >= 0 and text.startswith((b"#", b"/"), wrong):
            # comments keep their length, so that places in the text stay what they are
            plain = _COMMENT.sub(lambda comment: b" " * len(comment[0]), bytes(text[:end]))
            values, wrong = parse_block(plain, 0, end, compiled=compiled)
        if wrong >= 0:
            word = bytes(text[wrong : min(wrong + 64, end)]).split(None, 1)[0]
            hint = "; decimals are written with a point" if b"," in word else ""
            where = f"line {line_of(self.whole(), offset + wrong)}"
            raise FormatError(f"expected a number, found {shown(word)}{hint}", where=where)
        return values

    def whole(self) -> bytes:
        """The whole file, to say where something is wrong."""
        self.file.seek(0)
        return self.file.read()

    def lines(self) -> Iterator[tuple[int, int]]:
        """Line number and number count of every line that holds numbers."""
        data = self.whole()
        for number, line in enumerate(_LINE.finditer(data, self.start), line_of(data, self.start)):
            count = len(line[1].split())
            if count and not line[1].lstrip().startswith((b"#", b"//")):
                yield number, count

    def too_large(self, read: int, values: Floats) -> FormatError:
        """The error for a number beyond all sense, ``read`` numbers before these."""
        at = int(np.argmax(np.abs(values) > LARGEST))
        frame, channel = divmod(read + at, self.channels)
        return FormatError(
            f"frame {frame}, channel {channel}: {values[at]:g} is not within ±{LARGEST:g}",
            where=f"line {self.line_of_number(read + at)}",
        )

    def line_of_number(self, index: int) -> int:
        """The line of the index-th number."""
        for number, count in self.lines():
            if index < count:
                return number
            index -= count
        return line_of(self.whole(), self.size)

    def too_few(self) -> FormatError:
        """The error for a frame count that cannot be; of a text that has other faults, those."""
        numbers = self.announced * self.channels
        for _ in self.tables():
            pass
        if self.announced < 2**31 and numbers < 4 * self.size:
            return self.wrong_count()
        return FormatError(
            f"Frames: {self.announced} frames of {self.channels} numbers cannot be in a file of {self.size} bytes",
            where=self.where,
        )

    def wrong_count(self) -> FormatError:
        """The error for more or fewer numbers than announced: the first line that differs, else the frame count."""
        cure = "--option truncated=keep, in Python load(path, truncated='keep'), takes the whole frames that are there"
        lines = list(self.lines())
        odd = next(((number, count) for number, count in lines if count != self.channels), None)
        if odd and len(lines) > 1:
            number, count = odd
            last = " in the last line (the file was cut?)" if number == lines[-1][0] else ""
            return FormatError(
                f"expected {self.channels} numbers in each frame, found {count}{last}; {cure}", where=f"line {number}"
            )
        found = sum(count for _, count in lines)
        held = f"{found} numbers ({found / self.channels:.6g} frames of {self.channels})"
        return FormatError(f"Frames: says {self.announced}, but the file holds {held}; {cure}", where=self.where)


def _frame_time(word: str, where: str) -> float:
    try:
        seconds = to_number(word, LARGEST)
    except ValueError:
        seconds = 0.0
    if not 1e-6 <= seconds <= 1e6:
        raise FormatError(f"Frame Time: expected seconds above 0, found {shown(word)}", where=where)
    return seconds


def compose(hierarchy: Hierarchy, frame_time_text: str, values: Floats, decimals: int) -> Iterator[bytes]:
    """The bytes of a BVH file, in pieces: the hierarchy, then the motion, with ``decimals`` digits after the point.

    Joints must be in depth-first order, as the format has them.
    """
    ends: dict[int, list[Vector]] = {}
    for joint, offset in hierarchy.end_sites:
        ends.setdefault(joint, []).append(offset)
    lines = ["HIERARCHY"]
    open_joints: list[int] = []

    def close() -> None:
        tabs = _tabs(len(open_joints))
        for offset in ends.get(open_joints.pop(), ()):
            lines.extend((f"{tabs}End Site", f"{tabs}{{", f"{tabs}\tOFFSET {_offset(offset, decimals)}", f"{tabs}}}"))
        lines.append(f"{_tabs(len(open_joints))}}}")

    for index, joint in enumerate(hierarchy.joints):
        while open_joints and open_joints[-1] != joint.parent:
            close()
        tabs = _tabs(len(open_joints))
        lines.append(f"{tabs}{'ROOT' if joint.parent < 0 else 'JOINT'} {joint.name}")
        lines.append(f"{tabs}{{")
        lines.append(f"{tabs}\tOFFSET {_offset(joint.offset or (0.0, 0.0, 0.0), decimals)}")
        if joint.channels is not None:
            lines.append(f"{tabs}\tCHANNELS {' '.join((str(len(joint.channels)), *joint.channels))}")
        open_joints.append(index)
    while open_joints:
        close()
    lines += ["MOTION", f"Frames: {len(values)}", f"Frame Time: {frame_time_text}", ""]
    yield "\n".join(lines).encode()
    rows = max(_BLOCK_NUMBERS // max(values.shape[1], 1), 1)
    for first in range(0, len(values), rows):
        yield format_rows(values[first : first + rows], decimals, compiled=values.size > SMALL_NUMBERS)


def _tabs(depth: int) -> str:
    """The indentation; a chain of 100,000 joints would else take gigabytes of tabs."""
    return "\t" * min(depth, _DEEPEST_INDENT)


def _offset(offset: Vector, decimals: int) -> str:
    return " ".join(f"{value + 0.0:.{decimals}f}" for value in offset)
