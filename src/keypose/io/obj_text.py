"""The text of a Wavefront OBJ file as arrays: vertices, texture coordinates, normals, polygons and their groups.

Runs of lines of one kind go to NumPy as a block; whatever does not fit the plain pattern is read word by word, which
also finds the line of what is wrong.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.errors import FormatError
from keypose.io.notes import Notes
from keypose.io.text import line_of, parse_block, shown, to_number

LARGEST_BYTES = 1 << 30
_LARGEST = 1e30
_SHORT_RUN = 24  # lines; below, words one by one are faster
_LINE = re.compile(rb"[^\n]*\n?")
_KNOWN = re.compile(rb"[A-Za-z_][A-Za-z0-9_.]{0,31}")
_BLANKS = bytes(32 if code <= 32 else code for code in range(256))
_VALUES = {b"v": (3, 4, 6, 7), b"vt": (1, 2, 3), b"vn": (3,)}
_IGNORED = {b"vp", b"l", b"p", b"curv", b"curv2", b"surf", b"cstype", b"deg", b"parm", b"trim", b"hole", b"end", b"sp"}


@dataclass(frozen=True, slots=True)
class Group:
    """What was in force when faces were named: object, group and material name, and whether smoothing was switched off."""

    object: str = ""
    group: str = ""
    material: str = ""
    flat: bool = False


@dataclass(slots=True)
class ObjText:
    """Everything in the file's own numbers.

    Shapes and units:
        positions (V, 3), colors (V, 3) or None with NaN where a vertex has none, uvs (U, 2), normals (N, 3).
        corners: (C, 3) indices of position, texture coordinate and normal, -1 for none; sizes: (F,) corners per face.
        face_groups: (F,) indices into ``groups``.
    """

    positions: Floats
    colors: Floats | None
    uvs: Floats
    normals: Floats
    corners: Ints
    sizes: Ints
    face_groups: Ints
    groups: list[Group]
    libraries: list[str]


@dataclass(slots=True)
class _State:
    notes: Notes
    values: dict[bytes, list[Floats]] = field(default_factory=lambda: {b"v": [], b"vt": [], b"vn": []})
    counts: dict[bytes, int] = field(default_factory=lambda: {b"v": 0, b"vt": 0, b"vn": 0})
    corners: list[Ints] = field(default_factory=list)
    sizes: list[Ints] = field(default_factory=list)
    face_groups: list[Ints] = field(default_factory=list)
    places: list[tuple[int, int]] = field(default_factory=list)  # first corner of a run, its byte offset
    corner_count: int = 0
    groups: dict[Group, int] = field(default_factory=dict)
    group: Group = Group()
    libraries: list[str] = field(default_factory=list)


def read_text(path: Path, notes: Notes) -> ObjText:
    """Read and parse a file.

    Raises:
        FormatError: at the first line that does not follow the format, or a face that names what does not exist.

    Source: Wavefront Technologies, "Object Files (.obj)", Advanced Visualizer manual, appendix B1.
    """
    size = path.stat().st_size
    if size > LARGEST_BYTES:
        raise FormatError(f"{size >> 20} MiB; at most {LARGEST_BYTES >> 20} MiB are read", path=path)
    return parse(path.read_bytes(), notes)


def parse(data: bytes, notes: Notes) -> ObjText:
    """The arrays of a file's bytes; see `read_text`."""
    if data.startswith(b"\xef\xbb\xbf"):
        data = b"   " + data[3:]
    if b"\0" in data:
        at = data.index(b"\0")
        raise FormatError("a null byte; this is no text", where=f"line {line_of(data, at)}")
    plain = data
    if b"\r" in plain:  # of equal length, so that offsets stay true
        plain = plain.replace(b"\r\n", b" \n").replace(b"\r", b"\n")
    if b"\\\n" in plain or b"\\ \n" in plain:
        plain = plain.replace(b"\\ \n", b"   ").replace(b"\\\n", b"  ")
    state = _State(notes)
    at, end = 0, len(plain)
    while at < end:
        stop = plain.find(b"\n", at)
        stop = end if stop < 0 else stop + 1
        words = plain[at:stop].split(None, 1)
        keyword = words[0] if words else b""
        if keyword in _VALUES or keyword == b"f":
            stop = _run_end(plain, at, keyword)
            _run(plain, data, at, stop, keyword, state)
        elif words and not keyword.startswith(b"#"):
            _statement(data, at, keyword, words[1].strip() if len(words) > 1 else b"", state)
        at = stop
    return _joined(data, state)


def _run_end(data: bytes, at: int, keyword: bytes) -> int:
    """Where the lines that start with the keyword end."""
    for other in _starts(keyword).finditer(data, at):
        return other.start() + 1
    return len(data)


def _starts(keyword: bytes) -> re.Pattern[bytes]:
    return re.compile(rb"\n(?!" + keyword + rb"[ \t])")


def _run(plain: bytes, data: bytes, at: int, stop: int, keyword: bytes, state: _State) -> None:
    lines = plain.count(b"\n", at, stop) + (plain[stop - 1 : stop] != b"\n")
    if keyword == b"f":
        known = None if lines < _SHORT_RUN else _face_block(plain[at:stop])
        corners, sizes = known or _face_words(plain, data, at, stop, state)
        counts = np.array([state.counts[b"v"], state.counts[b"vt"], state.counts[b"vn"]])
        relative_too_far = np.nonzero(np.any((corners < 0) & (corners + counts < 0), axis=1))[0]
        corners = np.where(corners > 0, corners - 1, np.where(corners < 0, corners + counts, -1))
        state.places.append((state.corner_count, at))
        state.corners.append(corners)
        state.sizes.append(sizes)
        state.corner_count += len(corners)
        state.face_groups.append(np.full(len(sizes), state.groups.setdefault(state.group, len(state.groups)), np.int32))
        if len(relative_too_far):
            first = int(relative_too_far[0])
            raise FormatError(
                "a face counts back further than there are vertices", where=_face_place(data, at, sizes, first)
            )
        return
    known_values = None if lines < _SHORT_RUN else _value_block(plain, at, stop, lines, keyword)
    values = _value_words(plain, data, at, stop, keyword) if known_values is None else known_values
    state.values[keyword].append(values)
    state.counts[keyword] += len(values)


def _words_per_line(block: bytes) -> Ints:
    """Words in each line that holds any."""
    codes = np.frombuffer(block, np.uint8)
    blank = codes <= 32
    starts = ~blank
    starts[1:] &= blank[:-1]
    line = np.cumsum(codes == 10)
    counts = np.bincount(line[starts])
    return counts[counts > 0]


def _value_block(data: bytes, at: int, stop: int, lines: int, keyword: bytes) -> Floats | None:
    block = data[at:stop]
    words = _words_per_line(block)
    width = int(words[0]) - 1
    if len(words) != lines or np.any(words != words[0]) or width not in _VALUES[keyword]:
        return None
    first = block.lstrip()
    numbers = first[len(keyword) :].replace(b"\n" + keyword, b"\n" + b" " * len(keyword))
    values, wrong = parse_block(numbers, 0, len(numbers))
    if wrong >= 0 or values.size != lines * width or np.any(np.abs(values) > _LARGEST):
        return None
    return _padded(values.reshape(lines, width), keyword)


def _padded(values: Floats, keyword: bytes) -> Floats:
    """Rows of 6 (position and colour) for ``v``, 2 for ``vt``, 3 for ``vn``."""
    if keyword == b"vn":
        return values
    if keyword == b"vt":
        return values[:, :2] if values.shape[1] >= 2 else np.pad(values, ((0, 0), (0, 1)))
    rows = np.full((len(values), 6), np.nan)
    rows[:, :3] = values[:, :3]
    if values.shape[1] >= 6:
        rows[:, 3:] = values[:, -3:]  # after the weight, if there is one
    return rows


def _value_words(plain: bytes, data: bytes, at: int, stop: int, keyword: bytes) -> Floats:
    rows: list[Floats] = []
    for match in _LINE.finditer(plain, at, stop):
        words = match[0].partition(b"#")[0].split()[1:]
        if not match[0].strip():
            continue
        if len(words) not in _VALUES[keyword]:
            expected = " or ".join(str(n) for n in _VALUES[keyword])
            raise FormatError(
                f"'{keyword.decode()}' with {len(words)} numbers; expected {expected}", where=_line(data, match.start())
            )
        try:
            numbers = [to_number(word.decode("latin-1"), _LARGEST) for word in words]
        except ValueError:
            wrong = next(word for word in words if not _is_number(word))
            raise FormatError(f"expected a number, got {shown(wrong)}", where=_line(data, match.start())) from None
        rows.append(_padded(np.array([numbers]), keyword)[0])
    return np.array(rows)


def _is_number(word: bytes) -> bool:
    try:
        to_number(word.decode("latin-1"), _LARGEST)
    except ValueError:
        return False
    return True


def _face_block(block: bytes) -> tuple[Ints, Ints] | None:
    """Corners (C, 3), counted from 1, 0 for none, and sizes (F,); None where lines are not all of one plain style."""
    codes = np.frombuffer(block, np.uint8)
    if np.any((codes > 57) & (codes != 102)) or np.any((codes > 32) & (codes < 45)) or np.any(codes == 46):
        return None  # anything but digits, '-', '/' and the keyword
    blank = codes <= 32
    starts = ~blank
    starts[1:] &= blank[:-1]
    word = np.cumsum(starts) - 1
    line = np.cumsum(codes == 10)
    sizes = np.bincount(line[starts])
    sizes = sizes[sizes > 0] - 1
    slash = np.nonzero(codes == 47)[0]
    is_keyword = np.zeros(int(word[-1]) + 1, bool)
    is_keyword[np.concatenate([[0], np.cumsum(sizes + 1)[:-1]])] = True
    slashes = np.bincount(word[slash], minlength=len(is_keyword))[~is_keyword]
    if not len(slashes) or np.any(slashes != slashes[0]) or np.count_nonzero(codes == 102) != len(sizes):
        return None
    count = int(slashes[0])
    doubled = count == 2 and len(slash) > 1 and bool(np.all(np.diff(slash)[::2] == 1))
    width = 2 if doubled else count + 1
    if count > 2:
        return None
    text = block.translate(_SLASHES)
    values, wrong = parse_block(text, 0, len(text))
    if wrong >= 0 or values.size != width * len(slashes) or np.any(values == 0) or np.any(np.abs(values) > 2**31 - 2):
        return None
    corners = np.zeros((len(slashes), 3), np.int64)
    corners[:, [0, 2] if doubled else list(range(width))] = values.reshape(-1, width).astype(np.int64)
    return corners, sizes.astype(np.int32)


_SLASHES = bytes(32 if code in (47, 102) else code for code in range(256))
_CORNER = re.compile(rb"(-?[0-9]{1,10})(?:/(-?[0-9]{1,10})?(?:/(-?[0-9]{1,10})?)?)?")


def _face_words(plain: bytes, data: bytes, at: int, stop: int, state: _State) -> tuple[Ints, Ints]:
    corners: list[tuple[int, int, int]] = []
    sizes: list[int] = []
    for line in _LINE.finditer(plain, at, stop):
        words = line[0].partition(b"#")[0].split()[1:]
        if not line[0].strip():
            continue
        for word in words:
            match = _CORNER.fullmatch(word)
            numbers = [int(n) if n else 0 for n in match.groups()] if match else []
            if match is None or any(n is not None and int(n) == 0 for n in match.groups()):
                raise FormatError(
                    f"expected a corner like 3, 3/1, 3//2 or 3/1/2, got {shown(word)}", where=_line(data, line.start())
                )
            if max(map(abs, numbers)) > 2**31 - 2:
                raise FormatError(f"corner {shown(word)} is out of range", where=_line(data, line.start()))
            corners.append((numbers[0], numbers[1], numbers[2]))
        sizes.append(len(words))
    return np.array(corners, np.int64).reshape(-1, 3), np.array(sizes, np.int32)


def _statement(data: bytes, at: int, keyword: bytes, rest: bytes, state: _State) -> None:
    text = "".join(c for c in rest.decode("utf-8", "replace") if c.isprintable())[:200]
    group = state.group
    if keyword == b"o":
        state.group = Group(text, "", group.material, group.flat)
    elif keyword == b"g":
        state.group = Group(group.object, text, group.material, group.flat)
    elif keyword == b"usemtl":
        state.group = Group(group.object, group.group, text, group.flat)
    elif keyword == b"s":
        state.group = Group(group.object, group.group, group.material, text in ("off", "0"))
    elif keyword == b"mtllib":
        state.libraries.append(text)
    elif keyword in _IGNORED:
        state.notes.add(f"'{keyword.decode()}' statements (points, lines, curves, surfaces) were dropped")
    elif _KNOWN.fullmatch(keyword):
        state.notes.add(f"{_line(data, at)}: unknown statement {shown(keyword)} was dropped")
    else:
        raise FormatError(f"expected a statement such as v, vt, vn or f, got {shown(keyword)}", where=_line(data, at))


def _joined(data: bytes, state: _State) -> ObjText:
    values = {key: np.concatenate(parts) if parts else np.zeros((0, 1)) for key, parts in state.values.items()}
    vertices = values[b"v"] if len(values[b"v"]) else np.zeros((0, 6))
    corners = np.concatenate(state.corners) if state.corners else np.zeros((0, 3), np.int64)
    sizes = np.concatenate(state.sizes) if state.sizes else np.zeros(0, np.int32)
    totals = np.array([state.counts[b"v"], state.counts[b"vt"], state.counts[b"vn"]])
    beyond = np.nonzero(np.any(corners >= totals, axis=1))[0]
    if len(beyond):
        corner = int(beyond[0])
        kind = int(np.nonzero(corners[corner] >= totals)[0][0])
        name = ("vertex", "texture coordinate", "normal")[kind]
        run = max(k for k, (first, _) in enumerate(state.places) if first <= corner)
        first, offset = state.places[run]
        raise FormatError(
            f"{name} {corners[corner, kind] + 1} does not exist; the file has {totals[kind]}",
            where=_face_place(data, offset, state.sizes[run], corner - first),
        )
    has_color = bool(np.any(np.isfinite(vertices[:, 3])))
    return ObjText(
        vertices[:, :3],
        vertices[:, 3:] if has_color else None,
        values[b"vt"] if len(values[b"vt"]) else np.zeros((0, 2)),
        values[b"vn"] if len(values[b"vn"]) else np.zeros((0, 3)),
        corners,
        sizes,
        np.concatenate(state.face_groups) if state.face_groups else np.zeros(0, np.int32),
        list(state.groups),
        state.libraries,
    )


def _face_place(data: bytes, offset: int, sizes: Ints, corner: int) -> str:
    """The line of a corner of a run of faces, which has a face in every line."""
    face = int(np.searchsorted(np.cumsum(sizes), corner, side="right"))
    return f"line {line_of(data, offset) + face}"


def _line(data: bytes, offset: int) -> str:
    return f"line {line_of(data, offset)}"
