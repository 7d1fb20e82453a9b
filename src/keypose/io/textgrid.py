"""Praat TextGrid files, in the long and the short text form: tiers of labelled intervals or points.

Source: P. Boersma and D. Weenink, "Praat: doing phonetics by computer", manual page "TextGrid file formats".
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, NoReturn

import numpy as np

from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.io import atomic
from keypose.io.text import shown
from keypose.model import Scene, Tier

_LARGEST_BYTES = 256 << 20
_LARGEST_S = 1e7
_TOKEN = re.compile(r'"(?P<text>(?:[^"]|"")*+)"|(?P<flag><[A-Za-z]+>)|(?P<remark>![^\n]*)|(?P<word>[^\s"]+)')
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?%?")


def read(path: Path) -> Scene:
    """Read a TextGrid; its tiers are the scene's ``tiers``.

    Raises:
        FormatError: at the first thing that does not follow the format, with its line.
    """
    size = path.stat().st_size
    if size > _LARGEST_BYTES:
        raise FormatError(f"{size >> 20} MiB; at most {_LARGEST_BYTES >> 20} MiB are read", path=path)
    text = _decoded(path.read_bytes())
    notes: list[str] = []
    tiers = _Parser(text, notes).tiers()
    return Scene(format="textgrid", tiers=tuple(tiers), notes=tuple(notes))


def _decoded(data: bytes) -> str:
    if data.startswith(b"ooBinaryFile"):
        raise FormatError("a binary TextGrid; save it as a text file", where="byte 0")
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding == "utf-16":
            raise FormatError("expected UTF-16 text", where=f"byte {error.start}") from None
    return data.decode("latin-1")  # what old versions of Praat wrote


class _Parser:
    """Reads free-standing numbers, texts and flags; words and what is glued to them are remarks, as Praat has it."""

    def __init__(self, text: str, notes: list[str]) -> None:
        self.text, self.notes = text, notes
        self.tokens = self.free(text)
        self.place = 0

    def free(self, text: str) -> Iterator[re.Match[str]]:
        for match in _TOKEN.finditer(text):
            kind = match.lastgroup
            if kind in ("text", "flag") or (kind == "word" and _NUMBER.fullmatch(match["word"])):
                self.place = match.start()
                yield match
        self.place = len(text)

    def fail(self, what: str) -> NoReturn:
        raise FormatError(what, where=f"line {self.text.count(chr(10), 0, self.place) + 1}")

    def next(self, kind: str, what: str) -> str:
        match = next(self.tokens, None)
        if match is None:
            self.fail(f"the file ends where {what} is expected")
        if match.lastgroup != kind:
            self.fail(f"expected {what}, got {shown(match[0])}")
        return match[kind]

    def string(self, what: str) -> str:
        return self.next("text", what).replace('""', '"')

    def number(self, what: str) -> float:
        word = self.next("word", what)
        try:
            value = float(word)
        except ValueError:
            self.fail(f"expected {what}, got {shown(word)}")
        if not abs(value) <= _LARGEST_S:
            self.fail(f"{what} {shown(word)} is out of range")
        return value

    def count(self, what: str) -> int:
        value = self.number(what)
        if value != int(value) or value < 0:
            self.fail(f"expected {what}, got {value:g}")
        if value > len(self.text):  # each takes at least a character
            self.fail(f"{what} is {value:g}, more than the file can hold")
        return int(value)

    def tiers(self) -> list[Tier]:
        kind, name = self.string("the file type"), self.string("the object class")
        if not kind.startswith("ooTextFile") or name != "TextGrid":
            self.fail(f"expected a TextGrid, got {shown(name)}")
        self.number("the start time")
        self.number("the end time")
        if self.next("flag", "<exists> or <absent>") != "<exists>":
            return []
        found = [self.tier() for _ in range(self.count("the number of tiers"))]
        if next(self.tokens, None) is not None:
            self.notes.append("there is more in the file than it says; it was passed over")
        return found

    def tier(self) -> Tier:
        kind, name = self.string("the class of a tier"), self.string("the name of a tier")
        if kind not in ("IntervalTier", "TextTier"):
            self.fail(f"expected IntervalTier or TextTier, got {shown(kind)}")
        start, end = self.number("the start of the tier"), self.number("the end of the tier")
        rows: list[tuple[float, float, str]] = []
        for _ in range(self.count("the number of labels")):
            first = self.number("a time")
            last = self.number("the end of the interval") if kind == "IntervalTier" else first
            if last < first:
                self.fail(f"the interval ends at {last:g} s, before it starts at {first:g} s")
            rows.append((first, last, self.string("a label")))
        if any(a[0] > b[0] for a, b in itertools.pairwise(rows)):
            self.notes.append(f"tier '{name[:40]}': its labels are not in order of time and were sorted")
            rows.sort(key=lambda row: row[:2])
        if kind == "IntervalTier" and any(a[1] > b[0] + 1e-9 for a, b in itertools.pairwise(rows)):
            self.notes.append(f"tier '{name[:40]}': intervals overlap")
        starts, ends = np.array([r[0] for r in rows]), np.array([r[1] for r in rows])
        try:
            return Tier(name, starts, ends, tuple(r[2] for r in rows), kind == "TextTier", start, max(start, end))
        except ShapeError as error:
            self.fail(str(error))


def write(scene: Scene, path: Path, *, form: Literal["long", "short"] = "long") -> tuple[str, ...]:
    """Write the tiers of a scene as a TextGrid; gaps in a tier of intervals become intervals without a label.

    Raises:
        FormatError: where the scene has no tiers, intervals overlap or the file cannot be written.
        UnknownName: for another form than "long" and "short".
    """
    if form not in ("long", "short"):
        raise UnknownName("form", form, ("long", "short"))
    if not scene.tiers:
        raise FormatError("the scene has no tiers, and a TextGrid holds nothing else", path=path)
    notes: list[str] = []
    if scene.characters or scene.animations or scene.markers:
        notes.append("a TextGrid holds only tiers; characters, animations and markers were not written")
    start = min([float(t.start_s or 0.0) for t in scene.tiers])
    end = max([float(t.end_s or 0.0) for t in scene.tiers])
    write_tiers = _long if form == "long" else _short
    text = "\n".join(['File type = "ooTextFile"', 'Object class = "TextGrid"', "", *write_tiers(scene, start, end)])
    with atomic.replacing(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8", newline="\n")
    return tuple(notes)


def _rows(tier: Tier, start: float, end: float) -> list[tuple[float, float, str]]:
    rows = list(zip(tier.starts_s.tolist(), tier.ends_s.tolist(), tier.labels, strict=True))
    if tier.is_points:
        return rows
    filled: list[tuple[float, float, str]] = []
    at = start
    for first, last, label in rows:
        if first < at - 1e-9:
            raise FormatError(f"tier '{tier.name}': the interval at {first:g} s overlaps the one before it")
        if first > at:
            filled.append((at, first, ""))
        if last > first:  # Praat has no empty intervals
            filled.append((first, last, label))
        at = last
    if at < end:
        filled.append((at, end, ""))
    return filled


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"'


def _short(scene: Scene, start: float, end: float) -> list[str]:
    lines = [repr(start), repr(end), "<exists>", str(len(scene.tiers))]
    for tier in scene.tiers:
        rows = _rows(tier, start, end)
        lines += ['"TextTier"' if tier.is_points else '"IntervalTier"', _quoted(tier.name), repr(start), repr(end)]
        lines.append(str(len(rows)))
        for first, last, label in rows:
            lines += [repr(first), *([] if tier.is_points else [repr(last)]), _quoted(label)]
    return lines


def _long(scene: Scene, start: float, end: float) -> list[str]:
    lines = [f"xmin = {start!r} ", f"xmax = {end!r} ", "tiers? <exists> ", f"size = {len(scene.tiers)} ", "item []: "]
    for number, tier in enumerate(scene.tiers, 1):
        rows = _rows(tier, start, end)
        what = "points" if tier.is_points else "intervals"
        lines += [
            f"    item [{number}]:",
            f'        class = "{"TextTier" if tier.is_points else "IntervalTier"}" ',
            f"        name = {_quoted(tier.name)} ",
            f"        xmin = {start!r} ",
            f"        xmax = {end!r} ",
            f"        {what}: size = {len(rows)} ",
        ]
        for k, (first, last, label) in enumerate(rows, 1):
            lines.append(f"        {what} [{k}]:")
            if tier.is_points:
                lines += [f"            number = {first!r} ", f"            mark = {_quoted(label)} "]
            else:
                lines += [f"            xmin = {first!r} ", f"            xmax = {last!r} "]
                lines.append(f"            text = {_quoted(label)} ")
    return lines
