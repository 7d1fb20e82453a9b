"""What the readers and writers of marker files share: names, tables of numbers with gaps, and what is written of a scene."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Array, Floats
from keypose.errors import FormatError
from keypose.io.axes import UNITS_M, Turn, checked_up, right_of, screen_turn, turn_out, unit_in_metres
from keypose.io.text import line_of, parse_block, shown
from keypose.model import Markers, Scene

MARKER_FORMATS = ("c3d", "trc", "csm")
LARGEST = 1e9
"""No coordinate of a marker is beyond this, in any unit."""

# stands in the text for a marker that was not seen; no file holds such a number, for it is beyond LARGEST
_GAP = b"7e77"
_GAP_VALUE = 7e77
_NOTHING = re.compile(
    rb"[-+]?(?:nan(?:\([a-z]*\))?|1\.#(?:ind|qnan|snan|inf)0*|n/?a|null|none|missing|inf(?:inity)?)(?=[\t\n]|\Z)",
    re.IGNORECASE,
)
_WORDS = re.compile(rb"[^\x00-\x20+\-.0-9eE]")
_RESOLUTION_M = 1e-8
_USUAL_UP = {"TRC": "Y", "CSM": "Z"}


def unique_names(labels: Sequence[str], word: str, notes: list[str]) -> list[str]:
    """Names for the labels of a file, none of them empty and none twice; what was changed is told."""
    taken = {label.strip() for label in labels}
    done: set[str] = set()
    counts: dict[str, int] = {}
    names: list[str] = []
    changed: list[str] = []
    for i, label in enumerate(labels):
        stem = name = label.strip() or f"{word}_{i + 1}"
        count = counts.get(stem, 1)
        while name in done or (name != label.strip() and name in taken):
            count += 1
            name = f"{stem}_{count}"
        counts[stem] = count
        if name != label.strip():
            changed.append(f"{shown(label)} -> '{name}'")
        done.add(name)
        names.append(name)
    if changed:
        listed = ", ".join(changed[:4]) + (", …" if len(changed) > 4 else "")
        notes.append(f"{word} labels that were empty or came twice were changed: {listed}")
    return names


def parse_table(rows: Sequence[bytes], lines: Sequence[int], width: int, size: int) -> Floats:
    """A table (R, width) of the rows' tab-separated cells; empty cells, missing ones and words for nothing are NaN.

    Shapes and units: ``lines`` are the rows' line numbers for messages, ``size`` the file's bytes.

    Raises:
        FormatError: at the first cell that is no number, and for tables that are far larger than their file.
    """
    if not rows or not width:
        return np.zeros((len(rows), width))
    if len(rows) * width > 16 * size + 65536:
        raise FormatError(
            f"{len(rows)} rows, the longest of {width} cells, in a file of {size} bytes: nearly all are empty"
        )
    padded: list[bytes] = []
    for row in rows:
        missing = width - 1 - row.count(b"\t")
        padded.append(row + b"\t" * missing if missing else row)
    text = b"\n".join(padded)
    if b" " in text:
        text = text.replace(b" ", b"")
    if _WORDS.search(text.replace(b"\t", b"")) or b"#" in text:
        text = _NOTHING.sub(_GAP, text)
    gap = b"\t" + _GAP + b"\t"
    text = b"\t" + text.replace(b"\n", b"\t\n\t") + b"\t"
    text = text.replace(b"\t\t", gap).replace(b"\t\t", gap)
    values, wrong = parse_block(text, 0, len(text))
    if wrong >= 0:
        word = text[wrong : wrong + 64].split(None, 1)[0]
        row = text.count(b"\n", 0, wrong)
        raise FormatError(f"expected a number, found {shown(word)}", where=f"line {lines[row]}")
    if len(values) != len(rows) * width:
        raise FormatError(f"{len(values)} numbers in {len(rows)} rows of {width}", where=f"line {lines[0]}")
    table = values.reshape(len(rows), width)
    table[table == _GAP_VALUE] = np.nan
    with np.errstate(invalid="ignore"):
        beyond = np.abs(table) > LARGEST
    if beyond.any():
        row, cell = np.argwhere(beyond)[0]
        raise FormatError(f"{table[row, cell]:g} is not within ±{LARGEST:g}", where=f"line {lines[row]}")
    return table


def numbered_lines(data: bytes) -> list[tuple[int, bytes]]:
    """The lines of a text with their numbers from 1, without their ends; CR LF, LF and CR each end a line."""
    data = data.removeprefix(b"\xef\xbb\xbf")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise FormatError("the text is UTF-16; expected UTF-8 or ASCII", where="line 1")
    if b"\0" in data:
        raise FormatError("a byte 0 in a text", where=f"line {line_of(data, data.index(0))}")
    return list(enumerate(data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n"), 1))


def decoded(raw: bytes) -> str:
    """Text in UTF-8 where it is that, else Windows-1252."""
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("cp1252", "replace")


@dataclass(frozen=True, slots=True)
class Written:
    """Markers in a file's units and axes: ``positions`` (T, N, 3), NaN where not seen, of all sets beside the first."""

    markers: Markers
    names: tuple[str, ...]
    positions: Array
    unit: str
    up: str
    turn: Turn
    decimals: int


def written_as(scene: Scene, kind: str, unit: str | float | None = None, up: str | None = None) -> tuple[float, str]:
    """Metres per unit, and the up axis, in which `to_write` puts a scene into a file of a kind ("TRC", "CSM").

    The unit stays that of any marker file, else millimetres; axes stay those of a file of the same kind, else the usual
    ones, which readers expect where a file cannot say them.
    """
    own_unit = scene.unit_m if scene.format in MARKER_FORMATS else 0.001
    own_up = scene.up if scene.format == kind.lower() else _USUAL_UP[kind]
    return (own_unit if unit is None else unit_in_metres(unit)), (own_up if up is None else checked_up(up))


def to_write(
    scene: Scene,
    kind: str,
    unit: str | float | None,
    up: str | None,
    decimals: int | None,
    notes: list[str],
) -> Written:
    """What a text file of one set of markers holds of a scene; the rest is told.

    Raises:
        FormatError: where the scene has no markers, or their unit has no name.
    """
    if not scene.markers:
        raise FormatError(f"there are no markers to write; {kind} files hold nothing else")
    markers = scene.markers[0]
    sets = [m for m in scene.markers if (m.frame_count, m.rate_hz) == (markers.frame_count, markers.rate_hz)]
    others = [m for m in scene.markers if m not in sets]
    notes += [f"markers '{m.name}' are not in the file: another length or rate than the first" for m in others]
    lost = [
        (len(scene.characters), "characters"), (len(scene.animations), "animations"), (len(scene.signals), "sets of signals"),
        (len(scene.plates), "force plates"), (len(scene.extras.get("events", ())), "events"),
    ]  # fmt: skip
    lost_words = [f"{count} {word}" for count, word in lost if count]
    if markers.residuals is not None:
        lost_words.append("residuals")
    if markers.cameras is not None:
        lost_words.append("camera masks")
    if lost_words:
        notes.append(f"{', '.join(lost_words)} are not in the file: {kind} holds positions")
    unit_m, letter = written_as(scene, kind, unit, up)
    name = next((name for name, size in UNITS_M.items() if abs(size / unit_m - 1) < 1e-9 and name != "cmu"), None)
    if name is None:
        raise FormatError(f"a unit of {unit_m:g} m has no name in {kind}; choose one of m, cm, mm, inch, foot")
    turn = screen_turn(right_of(letter), letter)
    positions = np.concatenate([np.asarray(m.positions, np.float64) for m in sets], axis=1)
    positions = turn_out(positions, turn, unit_m)
    positions[~np.concatenate([np.asarray(m.visible) for m in sets], axis=1)] = np.nan
    names = tuple(unique_names([name for m in sets for name in m.names], "marker", notes))
    if decimals is None:
        decimals = max(0, math.ceil(-math.log10(_RESOLUTION_M / unit_m) - 1e-9))
    return Written(markers, names, positions, name, letter, turn, decimals)
