"""The HIERARCHY section of a BVH file: a parser without recursion that names the line of whatever is wrong."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from keypose.errors import FormatError
from keypose.io.text import shown, to_number

# A position of 1e9 units is none: such numbers come from damage, and their squares would soon overflow.
LARGEST = 1e9
_LONGEST_LINE = 1 << 20

_LINE = re.compile(rb"([^\r\n]*)(?:\r\n?|\n|\Z)")
_CHANNEL = re.compile(r"([XYZ])(position|rotation)\Z", re.IGNORECASE)
_NAMED = re.compile(r"(?:ROOT|JOINT)(?=[ \t{]|\Z)", re.IGNORECASE)
_BRACES = str.maketrans({"{": " { ", "}": " } "})

Vector = tuple[float, float, float]


@dataclass(slots=True)
class BvhJoint:
    """One ROOT or JOINT block, in the file's units."""

    name: str
    parent: int
    offset: Vector | None = None
    channels: tuple[str, ...] | None = None  # "Xposition", "Zrotation"; None without a CHANNELS line


@dataclass(slots=True)
class Hierarchy:
    """The joints in file order (a parent before its children) and the end sites, in the file's units."""

    joints: list[BvhJoint] = field(default_factory=list[BvhJoint])
    end_sites: list[tuple[int, Vector]] = field(default_factory=list[tuple[int, Vector]])
    notes: list[str] = field(default_factory=list[str])

    @property
    def channel_count(self) -> int:
        """C, the numbers in one frame."""
        return sum(len(joint.channels or ()) for joint in self.joints)


def parse_hierarchy(data: bytes) -> Hierarchy:
    """Read everything that comes before MOTION.

    Raises:
        FormatError: at the first thing that does not follow the format, with its line.
    """
    return _Parser(data).parse()


@dataclass(slots=True)
class _Block:
    """An open pair of braces: a joint's, or one of its End Sites'."""

    joint: int
    is_end: bool
    has_offset: bool = False


class _Words:
    """The words of the section, read line by line; a joint's name is one word."""

    def __init__(self, data: bytes) -> None:
        self._lines = self._split(data.removeprefix(b"\xef\xbb\xbf"))
        self._queue: list[str] = []  # of the current line, last word first
        self.line = 0
        self.latin = False

    def next(self) -> str | None:
        """The next word, taken; None at the end."""
        while not self._queue:
            words = next(self._lines, None)
            if words is None:
                return None
            self.line += 1
            self._queue = words[::-1]
        return self._queue.pop()

    def rest_of_line(self) -> str:
        """Everything up to the end of the line or an opening brace, as one word."""
        words: list[str] = []
        while self._queue and self._queue[-1] != "{":
            words.append(self._queue.pop())
        return " ".join(words)

    def _split(self, data: bytes) -> Iterator[list[str]]:
        for match in _LINE.finditer(data):
            raw = match[1]
            if len(raw) > _LONGEST_LINE:
                raise FormatError(f"a line of {len(raw)} bytes in the hierarchy", where=f"line {self.line + 1}")
            try:
                line = raw.decode().lstrip()
            except UnicodeDecodeError:
                line = raw.decode("latin-1").lstrip()
                self.latin = True
            yield [] if line.startswith(("#", "//")) else _split_line(line)


def _split_line(line: str) -> list[str]:
    """Words of one line; the name after ROOT or JOINT keeps its blanks and stays one word, also when it is empty."""
    named = _NAMED.match(line)
    if named:
        name, brace, rest = line[named.end() :].partition("{")
        return [named[0], name.strip(), *_separated(brace + rest).split()]
    return _separated(line).split()


def _separated(line: str) -> str:
    """The line with blanks around its braces."""
    return line.translate(_BRACES) if "{" in line or "}" in line else line


class _Parser:
    def __init__(self, data: bytes) -> None:
        self.words = _Words(data)
        self.result = Hierarchy()
        self.blocks: list[_Block] = []
        self.awaiting: _Block | None = None  # its '{' comes next

    def parse(self) -> Hierarchy:
        first = self.words.next() or ""
        if first.upper() != "HIERARCHY":
            raise self.error(f"expected HIERARCHY, found {shown(first)}")
        while (word := self.words.next()) is not None:
            keyword = word.upper()
            if self.awaiting and keyword != "{":
                raise self.error(f"expected '{{' to open {self.describe(self.awaiting)}, found {shown(word)}")
            match keyword:
                case "ROOT" | "JOINT":
                    self.joint(keyword)
                case "END":
                    self.end_site()
                case "{":
                    self.open()
                case "}":
                    self.close()
                case "OFFSET":
                    self.offset()
                case "CHANNELS":
                    self.channels()
                case _:
                    raise self.unexpected(word)
        unclosed = self.awaiting or (self.blocks[-1] if self.blocks else None)
        if unclosed:
            raise self.error(f"the hierarchy ends inside {self.describe(unclosed)}; a '}}' is missing")
        if not self.result.joints:
            raise self.error("no ROOT in the hierarchy")
        if self.words.latin:
            self.result.notes.append("the hierarchy is not UTF-8; names were read as Latin-1")
        return self.result

    def joint(self, keyword: str) -> None:
        name = self.words.rest_of_line()
        inside = self.blocks[-1] if self.blocks else None
        if keyword == "ROOT" and inside:
            raise self.error(f"ROOT inside {self.describe(inside)}; a '}}' is missing")
        if keyword == "JOINT" and not inside:
            raise self.error(f"JOINT {shown(name)} outside any ROOT")
        if inside and inside.is_end:
            raise self.error(f"JOINT {shown(name)} inside {self.describe(inside)}")
        self.result.joints.append(BvhJoint(name, inside.joint if inside else -1))
        self.awaiting = _Block(len(self.result.joints) - 1, is_end=False)

    def end_site(self) -> None:
        inside = self.blocks[-1] if self.blocks else None
        if not inside or inside.is_end:
            raise self.error("End Site outside a joint")
        self.words.rest_of_line()  # "Site", and a name that some exporters add
        self.awaiting = _Block(inside.joint, is_end=True)

    def open(self) -> None:
        if not self.awaiting:
            raise self.error("'{' without a ROOT, JOINT or End Site before it")
        self.blocks.append(self.awaiting)
        self.awaiting = None

    def close(self) -> None:
        if not self.blocks:
            raise self.error("'}' without an open '{'")
        block = self.blocks.pop()
        if not block.has_offset:
            raise self.error(f"{self.describe(block)} has no OFFSET")

    def offset(self) -> None:
        block = self.block("OFFSET")
        if block.has_offset:
            raise self.error(f"{self.describe(block)} has a second OFFSET")
        numbers: list[float] = []
        for _ in range(3):
            word = self.words.next() or ""
            try:
                numbers.append(to_number(word, LARGEST))
            except ValueError:
                expected = f"OFFSET of {self.describe(block)}: expected three numbers"
                raise self.error(f"{expected}, found {shown(word)}") from None
        block.has_offset = True
        offset = (numbers[0], numbers[1], numbers[2])
        if block.is_end:
            self.result.end_sites.append((block.joint, offset))
        else:
            self.result.joints[block.joint].offset = offset

    def channels(self) -> None:
        block = self.block("CHANNELS")
        if block.is_end:
            raise self.error(f"CHANNELS inside {self.describe(block)}")
        joint = self.result.joints[block.joint]
        if joint.channels is not None:
            raise self.error(f"{self.describe(block)} has a second CHANNELS")
        counted = self.words.next() or ""
        if counted not in ("0", "1", "2", "3", "4", "5", "6"):
            expected = f"CHANNELS of {self.describe(block)}: expected a count from 0 to 6"
            raise self.error(f"{expected}, found {shown(counted)}")
        channels: list[str] = []
        for _ in range(int(counted)):
            word = self.words.next() or ""
            match = _CHANNEL.match(word)
            if not match:
                expected = f"CHANNELS of {self.describe(block)}: expected {counted} of Xposition … Zrotation"
                raise self.error(f"{expected}, found {shown(word)}")
            channel = match[1].upper() + match[2].lower()
            if channel in channels:
                raise self.error(f"CHANNELS of {self.describe(block)}: {channel} comes twice")
            channels.append(channel)
        joint.channels = tuple(channels)

    def block(self, keyword: str) -> _Block:
        if not self.blocks:
            raise self.error(f"{keyword} outside a joint")
        return self.blocks[-1]

    def unexpected(self, word: str) -> FormatError:
        if _CHANNEL.match(word):
            return self.error(f"{shown(word)} is more than the CHANNELS count before it announced")
        return self.error(f"expected JOINT, End Site, OFFSET, CHANNELS or a brace, found {shown(word)}")

    def describe(self, block: _Block) -> str:
        name = shown(self.result.joints[block.joint].name)
        return f"the End Site of joint {name}" if block.is_end else f"joint {name}"

    def error(self, what: str) -> FormatError:
        return FormatError(what, where=f"line {max(self.words.line, 1)}")
