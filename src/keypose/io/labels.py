"""HTS and HTK label files (.lab): phones with start and end in units of 100 ns, plain or in full context.

Source: HTS working group, "A list of HTS context-dependent labels" (lab_format.pdf); S. Young et al., "The HTK Book",
section 6.2.1.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from keypose.errors import FormatError
from keypose.io.text import shown
from keypose.model import Scene, Tier

_LARGEST_BYTES = 256 << 20
_UNITS_PER_S = 1e7
_LARGEST_S = 1e7
_CONTEXT = re.compile(r"[^\s^-]+\^[^\s-]+-(?P<phone>[^\s+]+)\+[^\s=]+=")
_STATE = re.compile(r"\[\d+\]$")
_TIME = re.compile(r"[0-9]{1,18}(?:\.[0-9]{0,18})?")


def read(path: Path) -> Scene:
    """Read a label file as one tier named "phone"; full-context labels are kept in ``scene.extras["hts"]["context"]``.

    Times without a decimal point are in 100 ns, others in seconds (noted).

    Raises:
        FormatError: at the first line that is not start, end and label.
    """
    size = path.stat().st_size
    if size > _LARGEST_BYTES:
        raise FormatError(f"{size >> 20} MiB; at most {_LARGEST_BYTES >> 20} MiB are read", path=path)
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError("expected UTF-8 text", where=f"byte {error.start}") from None
    notes: list[str] = []
    starts: list[str] = []
    ends: list[str] = []
    labels: list[str] = []
    contexts: list[str] = []
    further = states = 0
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    places: list[int] = []
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words:
            continue
        if len(words) < 3 or not (_TIME.fullmatch(words[0]) and _TIME.fullmatch(words[1])):
            raise FormatError(f"expected start, end and label, got {shown(line.strip())}", where=f"line {number}")
        starts.append(words[0])
        ends.append(words[1])
        places.append(number)
        full = words[2]
        match = _CONTEXT.match(full)
        bare = _STATE.sub("", match["phone"] if match else full)
        states += bool(_STATE.search(full))
        further += len(words) > 3
        contexts.append(full)
        labels.append(bare)
    if not labels:
        raise FormatError("no labels", where="end of file")
    in_seconds = any("." in word for word in (*starts, *ends))
    if in_seconds:
        notes.append("times have decimal points and were taken as seconds")
    unit = 1.0 if in_seconds else _UNITS_PER_S
    first = np.array([float(word) / unit for word in starts])
    last = np.array([float(word) / unit for word in ends])
    _check(first, last, places)
    if states:
        notes.append(f"{states} labels are of states of a phone; each state is a label of its own")
    if further:
        notes.append(f"what follows the label in {further} lines (scores, words) was dropped")
    if np.any(last[:-1] > first[1:] + 1e-9):
        notes.append("labels overlap")
    tier = Tier("phone", first, last, tuple(labels))
    extras = {"hts": {"context": contexts}} if contexts != labels else {}
    return Scene(format="hts", tiers=(tier,), notes=tuple(notes), extras=extras)


def _check(first: np.ndarray, last: np.ndarray, places: list[int]) -> None:
    for wrong, what in (
        (last > _LARGEST_S, "the time is out of range"),
        (last < first, "the label ends before it starts"),
        (np.concatenate([[False], first[1:] < first[:-1]]), "the label starts before the one before it"),
    ):
        if wrong.any():
            raise FormatError(what, where=f"line {places[int(np.argmax(wrong))]}")
