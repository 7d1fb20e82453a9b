"""CSM files: the marker text of Autodesk's Character Studio, as capture software exports it for 3ds Max.

Source: the files of several exporters, and the reader of the Open Asset Import Library (assimp), which quotes the
format's specification: a marker that was not seen is the word DROPOUT instead of its three numbers.
"""

from __future__ import annotations

import difflib
import re
from math import log
from pathlib import Path
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import FormatError, ShapeError
from keypose.io.atomic import replacing
from keypose.io.axes import (
    UNITS_M,
    checked_up,
    guess_markers_up,
    right_of,
    screen_turn,
    turn_in,
    unit_in_metres,
)
from keypose.io.marker_tables import decoded, numbered_lines, parse_table, to_write, unique_names
from keypose.io.text import shown, to_number
from keypose.model import Markers, Scene

__all__ = ["read", "write"]

_KEYWORDS = (
    "Filename",
    "Date",
    "Time",
    "Actor",
    "Comments",
    "FirstFrame",
    "LastFrame",
    "Rate",
    "Order",
    "Points",
    "Units",
    "Spinal",
)
_DROPOUT = re.compile(rb"[A-Za-z]+")
_DEFAULT_RATE_HZ = 120.0
_SAMPLED_FRAMES = 9
_MOST_NOTES = 8
_STATURE_M = 1.5  # from the lowest to the highest marker of a standing adult
_FEWEST_MARKERS = 10
_MOST_FILLED = 4  # rows there may be for each that the file holds, where frames are left out

_Line = tuple[int, bytes]


def read(path: Path, *, unit: str | float | None = None, up: str = "auto") -> Scene:
    """Read a CSM file as markers.

    Shapes and units: the file names neither unit nor axes. ``unit`` is a name ("mm") or metres per file unit, by default
    the one that makes the figure a human's size, else millimetres; ``up`` is "X", "Y", "Z" or "auto", which goes by
    markers of head and feet and takes Z where there are none.

    Raises:
        FormatError: where $Order or $Points is missing, or at the first thing that does not follow, with its line.
        UnknownName: for an option's value that does not exist.
    """
    given_unit = None if unit is None else unit_in_metres(unit)
    given_up = None if up == "auto" else checked_up(up)
    return _Reader(path.read_bytes(), path.stem).scene(given_unit, given_up)


class _Reader:
    """Gives the text its meaning; collects notes on the way."""

    def __init__(self, data: bytes, name: str) -> None:
        self.size, self.name = len(data), name
        self.notes: list[str] = []
        self.faults = 0
        self.by_fold = {keyword.lower(): keyword for keyword in _KEYWORDS}
        self.known: dict[str, str | None] = {**self.by_fold}
        self.sections = self.read_sections(numbered_lines(data))

    def read_sections(self, lines: list[_Line]) -> dict[str, list[_Line]]:
        """The lines behind each keyword, what stands in the keyword's own line first."""
        found: dict[str, list[_Line]] = {}
        current: list[_Line] | None = None
        for number, line in lines:
            text = line.strip()
            if text.startswith(b"$"):
                word, _, rest = text[1:].strip().partition(b" ")
                keyword = self.keyword(word, number)
                if keyword is None:
                    current = None
                    continue
                if keyword in found:
                    self.fault(f"line {number}: ${keyword} comes twice; the first one counts")
                    current = None
                    continue
                current = found.setdefault(keyword, [])
                if rest.strip():
                    current.append((number, rest.strip()))
            elif text and current is not None:
                current.append((number, text))
        for needed in ("Order", "Points"):
            if needed not in found:
                raise FormatError(f"there is no ${needed}", where=f"line {lines[-1][0]}")
        return found

    def fault(self, note: str) -> None:
        """A note of an odd line; a flood of them is told once."""
        self.faults += 1
        if self.faults <= _MOST_NOTES:
            self.notes.append(note)
        elif self.faults == _MOST_NOTES + 1:
            self.notes.append("more such lines follow")

    def keyword(self, word: bytes, number: int) -> str | None:
        """The keyword that a word means, whatever its case, and with a typing error or two."""
        text = decoded(word[:64])
        folded = re.sub(r"[^a-z]", "", text.lower())
        if folded not in self.known:
            close = difflib.get_close_matches(folded, self.by_fold, n=1, cutoff=0.75) if len(self.known) < 1000 else []
            self.known[folded] = self.by_fold[close[0]] if close else None
        found = self.known[folded]
        if found is None:
            self.fault(f"line {number}: {shown('$' + text)} is not known; passed over")
        elif text.lower() != found.lower():
            self.fault(f"line {number}: {shown('$' + text)} taken as ${found}")
        return found

    def value(self, keyword: str) -> str:
        lines = self.sections.get(keyword, [])
        return decoded(lines[0][1]).strip() if lines else ""

    def number(self, keyword: str) -> float | None:
        try:
            return to_number(self.value(keyword), 1e12)
        except ValueError:
            return None

    def scene(self, unit_m: float | None, up: str | None) -> Scene:
        labels = [decoded(word) for _, line in self.sections["Order"] for word in line.split()]
        names = unique_names(labels, "marker", self.notes)
        if not names:
            raise FormatError("$Order names no markers", where=f"line {self.line('Order')}")
        table = self.table(len(names))
        first, raw = self.frames(table, len(names))
        sampled = raw[np.unique(np.linspace(0, max(len(raw) - 1, 0), _SAMPLED_FRAMES).astype(np.intp))[: len(raw)]]
        if up is None:
            up, note = guess_markers_up(names, sampled, np.zeros((0, 4, 3)), "Z")
            self.notes.append(note)
        if unit_m is None:
            unit_m = self.guessed_unit(sampled, up)
        positions = turn_in(raw, screen_turn(right_of(up), up), unit_m)
        positions[~np.isfinite(positions).all(axis=-1)] = np.nan
        positions.setflags(write=False)
        extras: dict[str, Any] = {
            keyword: "\n".join(decoded(line) for _, line in self.sections[keyword])
            for keyword in ("Filename", "Date", "Time", "Actor", "Comments")
            if keyword in self.sections
        }
        markers = Markers(
            tuple(names), positions, self.rate(), start_frame=first, name=self.name, extras={"csm": extras}
        )
        return Scene(format="csm", unit_m=unit_m, up=up, notes=tuple(self.notes), markers=(markers,))

    def line(self, keyword: str) -> int:
        lines = self.sections[keyword]
        return lines[0][0] if lines else 1

    def table(self, count: int) -> Array:
        """Frame numbers and coordinates, (R, 1 + 3 * count)."""
        width = 1 + 3 * count
        rows: list[bytes] = []
        numbers: list[int] = []
        nothing: set[bytes] = set()  # words that stand for a marker that was not seen
        for number, line in self.sections["Points"]:
            cells = line.split()
            dropped = (
                [i for i, cell in enumerate(cells) if _DROPOUT.fullmatch(cell)]
                if re.search(rb"[A-DF-Za-df-z]", line)
                else []
            )
            if dropped:
                for i in dropped:
                    if cells[i] not in nothing:
                        word = decoded(cells[i][:16]).upper()
                        if not difflib.get_close_matches(word, ["DROPOUT", "DROPOUTS", "NAN"], n=1, cutoff=0.7):
                            raise FormatError(
                                f"expected a number or DROPOUT, found {shown(cells[i])}", where=f"line {number}"
                            )
                        nothing.add(cells[i])
                # the word stands for a marker, or for each of its three numbers
                each = 3 if len(cells) != width and len(cells) + 2 * len(dropped) == width else 1
                cells = _replaced(cells, set(dropped), each)
            if len(cells) != width:
                raise FormatError(
                    f"expected a frame number and {count} markers of three numbers or DROPOUT, found {len(cells)} words",
                    where=f"line {number}",
                )
            rows.append(b"\t".join(cells))
            numbers.append(number)
        if not rows:
            self.notes.append("$Points is empty: the file holds names only")
        return parse_table(rows, numbers, width, self.size)

    def frames(self, table: Array, count: int) -> tuple[int, Array]:
        """The first frame's number, and coordinates (T, N, 3) with gaps where frames are left out."""
        raw = table[:, 1:].reshape(len(table), count, 3)
        first, last = self.number("FirstFrame"), self.number("LastFrame")
        begin = int(first) if first is not None and abs(first) < 2**31 else 1
        if not len(table):
            return begin, raw
        if not np.isfinite(table[:, 0]).all() or (table[:, 0] != np.rint(table[:, 0])).any():
            self.notes.append("frames are not numbered; rows were taken as they come")
            return begin, raw
        places = table[:, 0].astype(np.int64)
        if first is not None and places[0] != begin:
            self.notes.append(f"$FirstFrame says {first:g}; the rows begin with {places[0]}, which counts")
        steps = np.diff(places)
        if (steps < 1).any():
            self.notes.append("frame numbers do not rise; rows were taken as they come")
            return int(places[0]), raw
        total = int(places[-1] - places[0]) + 1
        if last is not None and last != places[-1]:
            self.notes.append(f"$LastFrame says {last:g}; the rows end with {places[-1]}, which counts")
        if total > len(places):
            if total > _MOST_FILLED * len(places):
                self.notes.append(f"{total - len(places)} of {total} frames are left out; rows were taken as they come")
                return int(places[0]), raw
            self.notes.append(f"{total - len(places)} frames are left out; nothing was seen in them")
            filled = np.full((total, count, 3), np.nan)
            filled[places - places[0]] = raw
            raw = filled
        return int(places[0]), raw

    def rate(self) -> float:
        rate = self.number("Rate")
        if rate is not None and 1e-3 <= rate <= 1e6:
            return rate
        self.notes.append(f"$Rate is {shown(self.value('Rate'))}; taken as {_DEFAULT_RATE_HZ:g} Hz")
        return _DEFAULT_RATE_HZ

    def guessed_unit(self, sampled: Array, up: str) -> float:
        heights = sampled[..., "XYZ".index(up)]
        seen = np.isfinite(heights)
        if sampled.shape[1] < _FEWEST_MARKERS or not seen.any():
            self.notes.append("unit: the file names none and the markers are too few to judge; taken as mm")
            return 0.001
        low = np.where(seen, heights, np.inf).min(axis=1)
        high = np.where(seen, heights, -np.inf).max(axis=1)
        height = float(np.median((high - low)[seen.any(axis=1)]))
        if not height > 0:
            self.notes.append("unit: the file names none and the markers lie flat; taken as mm")
            return 0.001
        name = min(("mm", "cm", "inch", "m"), key=lambda unit: abs(log(height * UNITS_M[unit] / _STATURE_M)))
        self.notes.append(
            f"unit: the file names none; taken as {name}, which makes the figure {height * UNITS_M[name]:.2f} m high"
        )
        return UNITS_M[name]


def _replaced(cells: list[bytes], dropped: set[int], each: int) -> list[bytes]:
    found: list[bytes] = []
    for i, cell in enumerate(cells):
        found += [b""] * each if i in dropped else [cell]
    return found


def write(
    scene: Scene,
    path: Path,
    *,
    unit: str | float | None = None,
    up: str | None = None,
    decimals: int | None = None,
) -> tuple[str, ...]:
    """Write the first markers of a scene; returns notes of what the file does not hold.

    Shapes and units: ``unit`` is a name ("mm"), ``up`` "X", "Y" or "Z". Without them the unit is that of the
    marker file it came from, else millimetres, and Z is up unless it came from a CSM file with other axes. ``decimals`` is the number of digits after the point, by default
    1e-8 m.

    Raises:
        FormatError: where there are no markers.
    """
    if decimals is not None and not 0 <= decimals <= 12:
        raise ShapeError(f"decimals: expected 0 to 12, got {decimals}")
    notes: list[str] = []
    out = to_write(scene, "CSM", unit, up, decimals, notes)
    markers = out.markers
    if not out.names:
        raise FormatError("there are no markers to write; CSM files hold nothing else")
    kept: Any = markers.extras.get("csm", {})
    names = [re.sub(r"[\s$\x00]+", "_", name) for name in out.names]
    if names != list(out.names):
        notes.append("blanks in names became '_': CSM separates names by blanks")
    last = markers.start_frame + markers.frame_count - 1
    lines = [f"${keyword} {kept[keyword]}" for keyword in ("Filename", "Date", "Time", "Actor") if keyword in kept]
    if kept.get("Comments"):
        lines += ["", "$Comments", kept["Comments"]]
    lines += ["", f"$FirstFrame {markers.start_frame}", f"$LastFrame {last}", f"$Rate {markers.rate_hz:.12g}", ""]
    lines += ["$Order", " ".join(names), "", "$Points"]
    cell = f"%.{out.decimals}f %.{out.decimals}f %.{out.decimals}f"
    for i, row in enumerate(out.positions.tolist()):
        # what is not a number is unlike itself
        cells = "  ".join([cell % tuple(p) if p[0] == p[0] else "DROPOUT" for p in row])
        lines.append(f"{markers.start_frame + i}  {cells}")
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    return tuple(notes)
