"""TRC files: marker trajectories as a table of text, as Motion Analysis, OpenSim and many others write it.

The table says its unit and rate but not its axes. Headers in the wild count wrongly, name fewer markers than the rows
hold, or stand beside their columns; the rows decide, and every difference is told in the notes.
"""

from __future__ import annotations

import re
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
    unit_of_word,
)
from keypose.io.marker_tables import decoded, numbered_lines, parse_table, to_write, unique_names
from keypose.io.text import shown, to_number
from keypose.model import Markers, Scene

__all__ = ["read", "write"]

_FIELDS = (
    "DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame", "OrigNumFrames",
)  # fmt: skip
_NUMBER = re.compile(rb"\s*[-+]?[0-9]+(?:\.[0-9]*)?(?:[eE][-+]?[0-9]+)?\s*\Z")
_WORDS = {"m": "m", "dm": "dm", "cm": "cm", "mm": "mm", "inch": "in", "foot": "ft"}
_DEFAULT_RATE_HZ = 100.0
_SAMPLED_FRAMES = 9

_Line = tuple[int, bytes]


def read(path: Path, *, unit: str | float | None = None, up: str = "auto") -> Scene:
    """Read a TRC file as markers.

    Shapes and units: ``unit`` is a name ("mm") or metres per file unit, by default what Units says; ``up`` is "X", "Y",
    "Z" or "auto", which goes by markers of head and feet and takes Y where there are none.

    Raises:
        FormatError: where the header is cut, or at the first cell that is no number, with its line.
        UnknownName: for an option's value that does not exist.
    """
    given_unit = None if unit is None else unit_in_metres(unit)
    given_up = None if up == "auto" else checked_up(up)
    return _Reader(path.read_bytes(), path.stem).scene(given_unit, given_up)


class _Reader:
    """Gives the table its meaning; collects notes on the way."""

    def __init__(self, data: bytes, name: str) -> None:
        self.size, self.name = len(data), name
        self.notes: list[str] = []
        self.labels_found: list[str] = []
        lines = numbered_lines(data)
        self.header_lines = lines[:4]
        self.delimiter = self.find_delimiter()
        self.header = self.read_header()
        label_at, first = self.find_rows(lines)
        self.labels_line = lines[label_at]
        self.rows = self.table_rows(lines[first:])

    # --- the header ---

    def find_delimiter(self) -> bytes:
        """What separates cells: tabs, else commas or semicolons, else blanks."""
        text = b"\n".join(line for _, line in self.header_lines)
        for delimiter in (b"\t", b",", b";"):
            if delimiter in text:
                if delimiter != b"\t":
                    self.notes.append(f"cells are separated by '{delimiter.decode()}' instead of tabs")
                return delimiter
        self.notes.append("cells are separated by blanks instead of tabs")
        return b" "

    def cells(self, line: bytes) -> list[bytes]:
        return line.split() if self.delimiter == b" " else [cell.strip() for cell in line.split(self.delimiter)]

    def read_header(self) -> dict[str, str]:
        lines = self.header_lines
        if not lines[0][1].strip().lower().startswith(b"pathfiletype"):
            raise FormatError(f"expected 'PathFileType', found {shown(lines[0][1].strip())}", where="line 1")
        if len(lines) < 3 or not lines[1][1].strip() or not lines[2][1].strip():
            raise FormatError(
                "the header is cut: expected names such as DataRate and, below, their values",
                where=f"line {len(lines)}",
            )
        names, values = (self.cells(line) for _, line in lines[1:3])
        if len([v for v in values if v]) < 2:
            names, values = lines[1][1].split(), lines[2][1].split()
        found: dict[str, str] = {}
        for name, value in zip(names, values, strict=False):
            known = next((field for field in _FIELDS if field.lower() == decoded(name).strip().lower()), None)
            if known:
                found[known] = decoded(value).strip()
        return found

    def number(self, field: str) -> float | None:
        try:
            return to_number(self.header.get(field, "").replace(",", "."), 1e12)
        except ValueError:
            return None

    def find_rows(self, lines: list[_Line]) -> tuple[int, int]:
        """Where the labels are, and where the first row of numbers."""
        label_at = next(
            (i for i, (_, line) in enumerate(lines[:64]) if line.strip().lower().startswith(b"frame")), None
        )
        if label_at is None:
            number = min(4, len(lines))
            raise FormatError(
                "expected the line that begins with 'Frame#' and names the markers", where=f"line {number}"
            )
        for i in range(label_at + 1, len(lines)):
            cells = self.cells(lines[i][1])
            if cells and _NUMBER.match(cells[0]):
                return label_at, i
        return label_at, len(lines)

    # --- the rows ---

    def table_rows(self, lines: list[_Line]) -> tuple[list[int], list[bytes]]:
        """Line numbers and rows with tabs between their cells, without the empty cells at their ends."""
        numbers: list[int] = []
        rows: list[bytes] = []
        commas = False
        for number, line in lines:
            if self.delimiter == b" ":
                row = b"\t".join(line.split())
            else:
                if self.delimiter != b",":
                    commas = commas or b"," in line
                    line = line.replace(b",", b".")
                row = (line if self.delimiter == b"\t" else line.replace(self.delimiter, b"\t")).rstrip()
            if row.strip():
                numbers.append(number)
                rows.append(row)
        if commas:
            self.notes.append("decimals are written with commas")
        return numbers, rows

    def labels(self) -> list[str]:
        """The labels by marker: each stands over the first of its three columns, or simply in order."""
        cells = [decoded(cell) for cell in self.cells(self.labels_line[1])[2:]]
        while cells and not cells[-1]:
            cells.pop()
        if not any(cell for i, cell in enumerate(cells) if i % 3) and self.delimiter != b" ":
            return cells[::3]
        named = [cell for cell in cells if cell]
        if self.delimiter != b" ":
            self.notes.append("the labels do not stand over their columns; they were taken in order")
        return named

    def scene(self, unit_m: float | None, up: str | None) -> Scene:
        numbers, rows = self.rows
        width = max((row.count(b"\t") + 1 for row in rows), default=2)
        labels = self.labels_found = self.labels()
        count = max(-(-(width - 2) // 3), len(labels), 0)
        table = parse_table(rows, numbers, 2 + 3 * count, self.size)
        labels = self.checked_labels(labels, count, max(width, 2))
        names = unique_names(labels, "marker", self.notes)
        counted = self.counted(count)
        if unit_m is None:
            unit_m = self.unit()
        raw = table[:, 2:].reshape(len(rows), count, 3)
        sampled = raw[np.unique(np.linspace(0, max(len(raw) - 1, 0), _SAMPLED_FRAMES).astype(np.intp))[: len(raw)]]
        if up is None:
            up, note = guess_markers_up(names, sampled, np.zeros((0, 4, 3)), "Y")
            self.notes.append(note)
        positions = turn_in(raw, screen_turn(right_of(up), up), unit_m)
        positions[~np.isfinite(positions).all(axis=-1)] = np.nan  # a marker with one coordinate only was not seen
        rate = self.rate(table[:, 1])
        first = self.frame_numbers(table[:, 0])
        extras: dict[str, Any] = {"header": dict(self.header), "labels": tuple(labels[:counted])}
        if len(table) and np.isfinite(table[0, 1]):
            extras["start_s"] = float(table[0, 1])
        sets = [
            Markers(
                tuple(names[:counted]),
                positions[:, :counted],
                rate,
                None,
                None,
                None,
                first,
                self.name,
                {"trc": extras},
            )
        ]
        if counted < count:
            sets.append(
                Markers(tuple(names[counted:]), positions[:, counted:], rate, start_frame=first, name="unlabelled")
            )
        return Scene(format="trc", unit_m=unit_m, up=up, notes=tuple(self.notes), markers=tuple(sets))

    def counted(self, count: int) -> int:
        """How many of the columns are markers that the header knows; what lies behind are trajectories nobody labelled."""
        said = self.number("NumMarkers")
        known = max(len(self.labels_found), int(said) if said is not None else 0)
        if not 0 < known < count:
            return count
        self.notes.append(
            f"the {count - known} trajectories behind the {known} markers of the header are a set of their own"
        )
        return known

    def checked_labels(self, labels: list[str], count: int, width: int) -> list[str]:
        said = self.number("NumMarkers")
        held = -(-(width - 2) // 3)
        if said is not None and said != count:
            self.notes.append(
                f"NumMarkers says {said:g}; there are {len(labels)} labels, and rows of up to {held} markers"
            )
        if (width - 2) % 3:
            self.notes.append(f"the longest row has {width - 2} coordinates, which is not a multiple of 3")
        return labels + [""] * (count - len(labels))

    def unit(self) -> float:
        word = self.header.get("Units", "")
        unit = unit_of_word(word)
        if unit is None:
            self.notes.append(f"unit: Units is {shown(word)}; taken as mm")
        return UNITS_M[unit or "mm"]

    def rate(self, times: Array) -> float:
        steps = np.diff(times[np.isfinite(times)])
        step = float(np.median(steps)) if len(steps) else 0.0
        for field in ("DataRate", "CameraRate"):
            rate = self.number(field)
            if rate is not None and 1e-3 <= rate <= 1e6:
                # times have few digits, so that only their mean over many frames says much
                mean = float(steps.mean()) if len(steps) else 0.0
                if mean > 0 and abs(mean * rate - 1) > 0.05:
                    self.notes.append(f"{field} is {rate:g} Hz, but the times are {mean:.4g} s apart; {field} counts")
                return rate
        if 1e-6 <= step <= 1e3:
            self.notes.append(f"DataRate is {shown(self.header.get('DataRate', ''))}; the times say {1 / step:.6g} Hz")
            return 1 / step
        self.notes.append(f"the file says no frame rate; taken as {_DEFAULT_RATE_HZ:g} Hz")
        return _DEFAULT_RATE_HZ

    def frame_numbers(self, frames: Array) -> int:
        said = self.number("NumFrames")
        if said is not None and said != len(frames):
            self.notes.append(f"NumFrames says {said:g}; the file holds {len(frames)} rows")
        if not len(frames):
            self.notes.append("there are no rows: the file holds names only")
            return 1
        if (np.diff(frames) != 1).any():
            self.notes.append("the frames are not numbered one after the other; rows were taken as they come")
        return int(frames[0]) if np.isfinite(frames[0]) and abs(frames[0]) < 2**31 else 1


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
    marker file it came from, else millimetres, and Y is up unless it came from a TRC file with other axes. ``decimals`` is the number of digits after the point, by default
    1e-8 m. What was not seen is an empty cell.

    Raises:
        FormatError: where there are no markers.
    """
    if decimals is not None and not 0 <= decimals <= 12:
        raise ShapeError(f"decimals: expected 0 to 12, got {decimals}")
    notes: list[str] = []
    out = to_write(scene, "TRC", unit, up, decimals, notes)
    markers = out.markers
    kept: Any = markers.extras.get("trc", {})
    names = _file_names(out.names, notes)
    header: dict[str, str] = {
        "DataRate": f"{markers.rate_hz:.12g}", "CameraRate": f"{markers.rate_hz:.12g}",
        "NumFrames": str(markers.frame_count), "NumMarkers": str(len(names)), "Units": _WORDS[out.unit],
        "OrigDataRate": f"{markers.rate_hz:.12g}", "OrigDataStartFrame": str(markers.start_frame),
        "OrigNumFrames": str(markers.frame_count),
    }  # fmt: skip
    for field in ("CameraRate", "OrigDataRate", "OrigDataStartFrame", "OrigNumFrames"):
        header[field] = str(kept.get("header", {}).get(field) or header[field])
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "\t".join(header),
        "\t".join(header.values()),
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"X{i}\tY{i}\tZ{i}" for i in range(1, len(names) + 1)),
        "",
    ]
    start = float(kept.get("start_s", 0.0))
    cell = f"%.{out.decimals}f"
    for i, row in enumerate(out.positions.reshape(markers.frame_count, -1).tolist()):
        # what is not a number is unlike itself
        cells = "\t".join([cell % value if value == value else "" for value in row])
        lines.append(f"{markers.start_frame + i}\t{start + i / markers.rate_hz:.6f}\t{cells}")
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    return tuple(notes)


def _file_names(names: tuple[str, ...], notes: list[str]) -> list[str]:
    clean = [re.sub(r"[\t\r\n\x00]", " ", name) for name in names]
    if clean != list(names):
        notes.append("tabs and line ends in names became blanks")
    return clean
