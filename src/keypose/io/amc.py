"""AMC: the motion half of Acclaim's format as text; bytes to one table of numbers, and back.

A frame is its number on a line of its own and one line for each bone, a name with its values. Files of a capture system
repeat the same lines in every frame: for these, names are found and blanked out in whole blocks and the rest is parsed
as a plain table. Anything else (comments, frames that leave bones out) is read line by line, with the same result.

Source: M. Schafer, "ASF Skeleton File and AMC Motion Capture Data" (Acclaim Advanced Technologies Group, 1994).
"""

from __future__ import annotations

import contextlib
import json
import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from keypose.arrays import Floats
from keypose.errors import FormatError
from keypose.io.asf import LARGEST, REMARK
from keypose.io.text import SMALL_BYTES, SMALL_NUMBERS, format_rows, line_of, parse_block, shown, to_number

_BLOCK_BYTES = 1 << 19  # fits the second-level cache
_LONGEST_NUMBER = 15
_LINE = re.compile(rb"([^\r\n]*+)(?:\r\n|\r|\n|\Z)")
_HEADER_BYTES = 1 << 20
_ROWS = 256  # written at a time
_SPACE, _NEWLINE = 32, 10
_FREE_BYTES, _BYTES_PER_BYTE = 1 << 26, 64  # memory that a file may ask for, in any case and for each of its bytes


@dataclass(slots=True)
class AmcText:
    """What an AMC file says.

    Shapes and units: ``table`` (T, C), the values of all ``bones`` side by side, ``counts`` of them each, in the file's
    unit and in degrees or, where ``degrees`` is false, radians; ``degrees`` is None where the file does not say.
    """

    bones: tuple[str, ...] = ()
    counts: tuple[int, ...] = ()
    table: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    first_frame: int = 1
    degrees: bool | None = None
    fully_specified: bool = False
    rate_hz: float | None = None
    name: str = ""  # of the animation, where keypose wrote it
    source: str = ""  # the file name behind ``#!OML:ASF``
    notes: list[str] = field(default_factory=list[str])


@dataclass(slots=True)
class AmcStart:
    """The header and the first frame: enough to choose a skeleton. ``at`` is the offset of the first frame number."""

    text: AmcText
    at: int
    counts: dict[str, int]


def parse_start(data: bytes) -> AmcStart:
    """The header of an AMC file and the bones of its first frame.

    Raises:
        FormatError: at the first thing that does not follow the format, with its line.
    """
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise FormatError("the text is UTF-16; expected UTF-8 or ASCII", where="line 1")
    text = AmcText()
    counts: dict[str, int] = {}
    at = -1
    for number, line in enumerate(_LINE.finditer(data), 1):
        words = _words(line[1].removeprefix(b"\xef\xbb\xbf") if number == 1 else line[1])
        if not words:
            _remark(text, line[1])
        elif at < 0 and words[0].startswith(b":"):
            _header_line(text, words, number)
        elif words[0].isdigit() and len(words) == 1:
            if at >= 0:
                break
            at = line.start(1) + line[1].index(words[0])
        elif at < 0:
            raise FormatError(f"expected a frame number, found {shown(words[0])}", where=f"line {number}")
        else:
            name = words[0].decode("utf-8", "replace")
            if name in counts:
                raise FormatError(f"bone {shown(name)} comes twice in one frame", where=f"line {number}")
            counts[name] = len(words) - 1
        if line.end() == len(data) or (at < 0 and line.end() > _HEADER_BYTES):
            break
    return AmcStart(text, at, counts)


def _remark(text: AmcText, line: bytes) -> None:
    """What programs say in comments: the skeleton's file, the frame rate."""
    if source := re.match(rb"#!OML:ASF\s+([^\r\n]{1,1024})", line):
        text.source = re.split(r"[\\/]", source[1].decode("latin-1").strip())[-1]
    elif line.startswith(REMARK):
        with contextlib.suppress(ValueError, RecursionError):
            said = json.loads(line[len(REMARK) :])
            values = cast("dict[str, Any]", said) if isinstance(said, dict) else {}
            rate, name = values.get("rate_hz"), values.get("name")
            if isinstance(rate, (int, float)) and 1e-3 <= rate <= 1e6:
                text.rate_hz = float(rate)
            text.name = name[:256] if isinstance(name, str) else ""


def _header_line(text: AmcText, words: list[bytes], number: int) -> None:
    keyword = words[0][1:].lower()
    if keyword in (b"degrees", b"radians"):
        text.degrees = keyword == b"degrees"
    elif keyword == b"fully-specified":
        text.fully_specified = True
    elif keyword == b"samples-per-second":
        try:
            rate = to_number(words[1].decode("latin-1") if len(words) > 1 else "", LARGEST)
        except ValueError:
            rate = 0.0
        if not 1e-3 <= rate <= 1e6:
            raise FormatError(":SAMPLES-PER-SECOND: expected a positive number", where=f"line {number}")
        text.rate_hz = rate
    elif len(text.notes) < 8:
        text.notes.append(f"line {number}: {shown(words[0])} is not known and was passed over")


def parse_frames(
    data: bytes, start: AmcStart, expected: Mapping[str, int], *, keep_whole_frames: bool = False
) -> AmcText:
    """All frames of an AMC file.

    ``expected`` has the number of values of every bone of the skeleton. ``keep_whole_frames`` stops before a last frame
    that was cut.

    Raises:
        FormatError: at the first thing that does not follow the format or the skeleton, with its line.
    """
    text = start.text
    if start.at < 0:
        text.notes.append("the file holds no frames")
        return text
    lines = [(name, start.counts[name]) for name in start.counts]
    if all(count == expected.get(name) for name, count in lines):
        table = _regular(data, start.at, lines)
        if table is not None:
            text.bones, text.counts = tuple(start.counts), tuple(start.counts.values())
            text.first_frame, text.table = int(table[0, 0]), table[:, 1:]
            return text
    return _Lines(data, start, expected, keep_whole_frames).parse()


def _regular(data: bytes, at: int, lines: Sequence[tuple[str, int]]) -> Floats | None:
    """Frame numbers and values (T, 1 + C) of a file whose frames all have the same lines; None if one is different."""
    end = len(data.rstrip())
    names = [name.encode() for name, _ in lines]
    in_frame = np.array([1, *(count for _, count in lines)], np.uint8)
    if any(count > 255 - 1 for _, count in lines):
        return None
    # where the characters of all names of a frame are, from the starts of their lines
    owner = np.repeat(np.arange(1, len(names) + 1), [len(name) for name in names])
    within = np.concatenate([np.arange(len(name)) for name in names]) if names else np.zeros(0, np.intp)
    letters = np.frombuffer(b"".join(names), np.uint8)
    lengths = np.array([len(name) for name in names], np.intp)
    columns = int(in_frame.sum())
    compiled = end - at > SMALL_BYTES
    tables: list[Floats] = []
    expected_number = -1
    for block in _blocks(data, at, end):
        text = np.frombuffer(block, np.uint8)
        ends = np.flatnonzero(text == _NEWLINE)
        if len(ends) % len(in_frame):
            return None
        starts = np.concatenate([np.zeros(1, np.intp), ends[:-1] + 1]).reshape(-1, len(in_frame))
        places = starts[:, owner] + within
        # a short last line may put a place beyond the block
        if places.size and places.max() >= len(text):
            return None
        if (
            not (text[places] == letters).all()
            or not (text[np.minimum(starts[:, 1:] + lengths, ends[-1])] <= _SPACE).all()
        ):
            return None
        text[places] = _SPACE
        filled = text > _SPACE
        first = filled.copy()
        first[1:] &= ~filled[:-1]
        found = np.add.reduceat(first.view(np.uint8), starts.reshape(-1), dtype=np.uint8).reshape(starts.shape)
        if not (found == in_frame).all():
            return None
        values, wrong = parse_block(block, 0, len(block), compiled=compiled)
        if wrong >= 0 or len(values) != len(starts) * columns:
            return None
        if values.max() > LARGEST or values.min() < -LARGEST:
            return None
        table = values.reshape(-1, columns)
        expected_number = int(table[0, 0]) if expected_number < 0 else expected_number
        if not (table[:, 0] == expected_number + np.arange(len(table))).all():
            return None
        expected_number += len(table)
        tables.append(table)
    if not tables:
        return None
    return tables[0] if len(tables) == 1 else np.concatenate(tables)


def _blocks(data: bytes, at: int, end: int) -> Iterator[bytearray]:
    """Pieces of whole frames, each in memory of its own and with a line feed at its end.

    A frame begins where a line starts with a digit; names do not.
    """
    while at < end:
        cut = min(at + _BLOCK_BYTES, end)
        if cut < end:
            found = _FRAME_START.search(data, cut)
            cut = found.start(1) if found and found.start(1) < end else end
        block = bytearray(data[at:cut])
        if block[-1] != _NEWLINE:
            block += b"\n"
        yield block
        at = cut


_FRAME_START = re.compile(rb"\n([0-9]++[ \t\r]*+\n)")


class _Lines:
    """The general way: line by line, with the place of every fault."""

    def __init__(self, data: bytes, start: AmcStart, expected: Mapping[str, int], keep_whole_frames: bool) -> None:
        self.data, self.start, self.expected, self.keep = data, start, expected, keep_whole_frames
        self.text = start.text
        self.columns: dict[str, int] = {}
        self.width = 0
        self.row: list[float] = []
        self.given: set[str] = set()
        self.values = array("d")
        self.frame, self.frame_line = -1, 0

    def parse(self) -> AmcText:
        held: set[str] = set()
        number = line_of(self.data, self.start.at) - 1
        cut = False
        for line in _LINE.finditer(self.data, self.start.at):
            number += 1
            words = _words(line[1])
            if words and words[0].isdigit() and len(words) == 1:
                held |= self.close(number)
                self.open(words[0], number)
            elif words:
                fault = self.bone(words, number)
                if fault:
                    if self.keep and not self.data[line.end() :].strip():
                        cut = True
                        break
                    raise fault
            if line.end() == len(self.data):
                break
        if cut or (self.keep and self.text.fully_specified and len(self.given) < len(self.columns)):
            self.text.notes.append(f"the last frame, {self.frame}, was cut and is left out")
            if not self.values:
                raise FormatError("the only frame was cut", where=f"line {self.frame_line}")
        else:
            held |= self.close(number)
        if held:
            self.text.notes.append(f"{len(held)} bones are left out of some frames; they stay as they were before")
        self.text.bones = tuple(self.columns)
        self.text.counts = tuple(self.expected[name] for name in self.columns)
        self.text.table = np.frombuffer(self.values, np.float64).reshape(-1, max(self.width, 1))[:, : self.width]
        return self.text

    def open(self, word: bytes, number: int) -> None:
        if len(word) > _LONGEST_NUMBER:
            raise FormatError(f"frame number {shown(word)} is too large", where=f"line {number}")
        frame = int(word)
        if self.frame >= 0 and frame != self.frame + 1:
            raise FormatError(
                f"frame {frame} follows frame {self.frame}; expected {self.frame + 1}", where=f"line {number}"
            )
        if self.frame < 0:
            self.text.first_frame = frame
        self.frame, self.frame_line = frame, number
        self.given = set()

    def bone(self, words: list[bytes], number: int) -> FormatError | None:
        name = words[0].decode("utf-8", "replace")
        where = f"line {number}"
        if name not in self.expected:
            return FormatError(f"frame {self.frame}: the skeleton has no bone {shown(name)}", where=where)
        if name in self.given:
            return FormatError(f"frame {self.frame}: bone {shown(name)} comes twice", where=where)
        count = self.expected[name]
        if len(words) - 1 != count:
            return FormatError(
                f"frame {self.frame}: bone {shown(name)} has {count} dof in the skeleton, found {len(words) - 1} numbers",
                where=where,
            )
        numbers: list[float] = []
        for word in words[1:]:
            try:
                numbers.append(to_number(word.decode("latin-1"), LARGEST))
            except ValueError:
                return FormatError(f"bone {shown(name)}: expected a number, found {shown(word)}", where=where)
        if name not in self.columns:
            if self.frame > self.text.first_frame:  # it comes late: what is there already must get room for it
                if self.text.fully_specified:
                    return FormatError(
                        f"frame {self.frame}: bone {shown(name)} is not in the frames before, and the file says that "
                        "it is fully specified",
                        where=where,
                    )
                self.widen(count)
            self.columns[name] = self.width
            self.width += count
            self.row += [0.0] * count
        at = self.columns[name]
        self.row[at : at + count] = numbers
        self.given.add(name)
        return None

    def widen(self, count: int) -> None:
        old = np.frombuffer(self.values, np.float64).reshape(-1, self.width) if self.width else None
        rows = self.frame - self.text.first_frame
        if rows * (self.width + count) * 8 > max(_FREE_BYTES, _BYTES_PER_BYTE * len(self.data)):
            raise FormatError("bones that come late would take too much memory", where=f"line {self.frame_line}")
        wide = np.zeros((rows, self.width + count))
        if old is not None:
            wide[:, : self.width] = old
        self.values = array("d", wide.tobytes())

    def close(self, number: int) -> set[str]:
        """The frame is complete: keep it; the bones that it did not mention."""
        if self.frame < 0:
            return set()
        missing = self.columns.keys() - self.given
        if missing and self.text.fully_specified:
            first = next(name for name in self.columns if name in missing)
            hint = "; --option truncated=keep, in Python load(path, truncated='keep'), leaves a cut last frame out"
            raise FormatError(
                f"frame {self.frame} has no values for bone {shown(first)}, and the file says that it is fully specified{hint}",
                where=f"line {number}",
            )
        self.values.extend(self.row)
        return set(missing)


def _words(line: bytes) -> list[bytes]:
    return line.split(b"#", 1)[0].split()


def compose_amc(
    bones: Sequence[str], counts: Sequence[int], table: Floats, decimals: int, first_frame: int, remark: str
) -> Iterator[bytes]:
    """The bytes of an AMC file in degrees, in pieces.

    Shapes and units: ``table`` (T, C), the values of all bones side by side; ``remark`` is a comment for the first line.
    """
    yield REMARK + remark.encode() + b"\n:FULLY-SPECIFIED\n:DEGREES\n"
    used = [(name, count) for name, count in zip(bones, counts, strict=True) if count]
    line = "%s\n" + "".join(name.replace("%", "%%") + " %s" * count + "\n" for name, count in used)
    for start in range(0, len(table), _ROWS):
        part = format_rows(
            np.ascontiguousarray(table[start : start + _ROWS]), decimals, compiled=table.size > SMALL_NUMBERS
        )
        yield "".join(
            line % (first_frame + start + index, *numbers.split())
            for index, numbers in enumerate(part.decode().split("\n")[:-1])
        ).encode()
