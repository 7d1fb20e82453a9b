"""BVH as text: bytes to a plain description of the file, and back.

The description keeps the file's own units, axes, channel orders and degrees; `keypose.io.bvh` gives it its meaning.

Source: M. Meredith and S. Maddock, "Motion Capture File Formats Explained" (University of Sheffield, CS-01-11), section
on BVH, with the variations found in the files of many exporters.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Floats
from keypose.errors import FormatError
from keypose.io.bvh_hierarchy import LARGEST, Hierarchy, Vector, parse_hierarchy
from keypose.io.text import format_rows, line_of, parse_block, shown, to_number

# Joints without channels cost no bytes in the motion block, but memory in every frame: a file may ask for this many
# bytes of poses per byte of its own (a joint of three rotations needs about two), and for _FREE_BYTES in any case.
_BYTES_PER_BYTE = 64
_FREE_BYTES = 1 << 26
_DEEPEST_INDENT = 100

_MOTION = re.compile(rb"(?:\A|[\r\n])[ \t]*MOTION(?=\s|\Z)", re.IGNORECASE)
_GAP = rb"\s*+(?:(?:#|//)[^\r\n]*+\s*+)*+"
_FRAMES = re.compile(_GAP + rb"Frames[ \t]*:?[ \t]*([^\s]+)", re.IGNORECASE)
_FRAME_TIME = re.compile(_GAP + rb"Frame[ \t]*Time[ \t]*:?[ \t]*([^\s]+)", re.IGNORECASE)
_COMMENT = re.compile(rb"(?m)^[ \t]*+(?:#|//)[^\r\n]*+")
_LINE = re.compile(rb"([^\r\n]*+)(?:\r\n?|\n|\Z)")


@dataclass(slots=True)
class BvhText:
    """What a BVH file says.

    Shapes and units:
        hierarchy: J joints and their channels.
        values: (T, C), degrees and the file's length unit; C is the number of channels of all joints.
        frame_time_s: with its text as written; None where the file has no MOTION.
        notes: what was odd.
    """

    hierarchy: Hierarchy
    values: Floats
    frame_time_s: float | None
    frame_time_text: str
    notes: list[str]


def parse(data: bytes, *, keep_whole_frames: bool = False) -> BvhText:
    """Read the bytes of a BVH file.

    ``keep_whole_frames`` accepts a motion block that is shorter or longer than ``Frames:`` says and keeps the whole
    frames that are there; without it such a file is refused.

    Raises:
        FormatError: at the first thing that does not follow the format, with its line.
    """
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise FormatError("the text is UTF-16; expected UTF-8 or ASCII", where="line 1")
    motion = _MOTION.search(data)
    hierarchy = parse_hierarchy(data[: motion.start()] if motion else data)
    text = BvhText(hierarchy, np.zeros((0, hierarchy.channel_count)), None, "", list(hierarchy.notes))
    if motion:
        _parse_motion(data, motion.end(), text, keep_whole_frames)
    else:
        text.notes.append("no MOTION section: the file holds a skeleton only")
    return text


def _parse_motion(data: bytes, at: int, text: BvhText, keep_whole_frames: bool) -> None:
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
    start, channels, joints = timed.end(), text.hierarchy.channel_count, len(text.hierarchy.joints)
    if announced * channels > len(data) and not keep_whole_frames:
        raise FormatError(
            f"Frames: {announced} frames of {channels} numbers cannot be in a file of {len(data)} bytes", where=where
        )
    values = _parse_values(data, start)
    if channels == 0:
        if len(values):
            raise FormatError("numbers follow, but no joint has channels", where=f"line {line_of(data, start) + 1}")
        if announced:
            text.notes.append(f"no joint has channels: the {announced} frames hold nothing")
        return
    if len(values) != announced * channels:
        if not keep_whole_frames:
            raise _wrong_count(data, start, announced, channels, len(values), where)
        kept = len(values) // channels
        text.notes.append(
            f"Frames: says {announced}, but the file holds {len(values)} numbers: "
            f"{kept} whole frames of {channels} kept, {len(values) - kept * channels} numbers dropped"
        )
        announced = kept
    pose_bytes = announced * joints * 7 * 8
    if pose_bytes > max(_FREE_BYTES, _BYTES_PER_BYTE * len(data)):
        raise FormatError(
            f"{announced} frames of {joints} joints, nearly all without channels, would take {pose_bytes >> 20} MiB",
            where=where,
        )
    text.values = values[: announced * channels].reshape(announced, channels)
    # two reductions and no temporary array of the file's size; NaN cannot come from text that is all digits
    if announced and (text.values.max() > LARGEST or text.values.min() < -LARGEST):
        frame, channel = (int(i) for i in np.argwhere(np.abs(text.values) > LARGEST)[0])
        raise FormatError(
            f"frame {frame}, channel {channel}: {text.values[frame, channel]:g} is not within ±{LARGEST:g}",
            where=f"line {_line_of_value(data, start, frame * channels + channel)}",
        )


def _frame_time(word: str, where: str) -> float:
    try:
        seconds = to_number(word, LARGEST)
    except ValueError:
        seconds = 0.0
    if not 1e-6 <= seconds <= 1e6:
        raise FormatError(f"Frame Time: expected seconds above 0, found {shown(word)}", where=where)
    return seconds


def _parse_values(data: bytes, start: int) -> Floats:
    values, wrong = parse_block(data, start, len(data))
    if wrong >= 0 and data[wrong : wrong + 1] in (b"#", b"/"):
        blanked = _COMMENT.sub(lambda comment: b" " * len(comment[0]), data[start:])
        values, wrong = parse_block(blanked, 0, len(blanked))
        wrong = wrong + start if wrong >= 0 else wrong
    if wrong >= 0:
        word = data[wrong : wrong + 64].split(None, 1)[0]
        hint = "; decimals are written with a point" if b"," in word else ""
        raise FormatError(f"expected a number, found {shown(word)}{hint}", where=f"line {line_of(data, wrong)}")
    return values


def _data_lines(data: bytes, start: int) -> Iterator[tuple[int, int]]:
    """Line number and number count of every line of the motion block that holds numbers."""
    for number, line in enumerate(_LINE.finditer(data, start), line_of(data, start)):
        count = len(line[1].split())
        if count and not line[1].lstrip().startswith((b"#", b"//")):
            yield number, count


def _line_of_value(data: bytes, start: int, index: int) -> int:
    for number, count in _data_lines(data, start):
        if index < count:
            return number
        index -= count
    return line_of(data, len(data))


def _wrong_count(data: bytes, start: int, announced: int, channels: int, found: int, where: str) -> FormatError:
    cure = "truncated='keep' loads the whole frames that are there"
    lines = list(_data_lines(data, start))
    odd = next(((number, count) for number, count in lines if count != channels), None)
    if odd and len(lines) > 1:
        number, count = odd
        last = " in the last line (the file was cut?)" if number == lines[-1][0] else ""
        return FormatError(
            f"expected {channels} numbers in each frame, found {count}{last}; {cure}", where=f"line {number}"
        )
    held = f"{found} numbers ({found / channels:.6g} frames of {channels})"
    return FormatError(f"Frames: says {announced}, but the file holds {held}; {cure}", where=where)


def compose(text: BvhText, decimals: int) -> list[bytes]:
    """The bytes of a BVH file, in pieces: the hierarchy, then the motion, with ``decimals`` digits after the point.

    Joints must be in depth-first order, as the format has them.
    """
    ends: dict[int, list[Vector]] = {}
    for joint, offset in text.hierarchy.end_sites:
        ends.setdefault(joint, []).append(offset)
    lines = ["HIERARCHY"]
    open_joints: list[int] = []

    def close() -> None:
        tabs = _tabs(len(open_joints))
        for offset in ends.get(open_joints.pop(), ()):
            lines.extend((f"{tabs}End Site", f"{tabs}{{", f"{tabs}\tOFFSET {_offset(offset, decimals)}", f"{tabs}}}"))
        lines.append(f"{_tabs(len(open_joints))}}}")

    for index, joint in enumerate(text.hierarchy.joints):
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
    lines += ["MOTION", f"Frames: {len(text.values)}", f"Frame Time: {text.frame_time_text}", ""]
    return ["\n".join(lines).encode(), format_rows(text.values, decimals)]


def _tabs(depth: int) -> str:
    """The indentation; a chain of 100,000 joints would else take gigabytes of tabs."""
    return "\t" * min(depth, _DEEPEST_INDENT)


def _offset(offset: Vector, decimals: int) -> str:
    return " ".join(f"{value + 0.0:.{decimals}f}" for value in offset)
