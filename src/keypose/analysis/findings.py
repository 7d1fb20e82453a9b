"""What the doctor finds, and how the notes of readers are told apart."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Level = Literal["fact", "guess", "repair", "loss", "warning"]

_GUESSED = re.compile(
    r"taken as|taken in|rounded|looks like|for they|seem|which was read|was read$|frame rate:|skeleton:"
)
_LOST = re.compile(
    r"dropped|left out|not read|ignored|not beside|is missing|no counterpart|not kept|not in the file|were taken as none|"
    r"the rest was|another file|cannot be read"
)


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was found; ``fix`` is the command that cures it, with FILE and OUT for the names of files.

    ``level``: a fact that is worth knowing, what the reader guessed, repaired or lost, or a warning.
    """

    level: Level
    topic: str
    text: str
    fix: str = ""


@dataclass(frozen=True, slots=True)
class Examination:
    """What is known of a scene (``facts``, plain values by name) and what was found."""

    facts: Mapping[str, Any]
    findings: tuple[Finding, ...]

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Findings that say that something is wrong."""
        return tuple(f for f in self.findings if f.level == "warning")


def note_level(text: str) -> Level:
    """Whether a reader's note tells of something lost, guessed or repaired."""
    if _LOST.search(text):
        return "loss"
    return "guess" if _GUESSED.search(text) else "repair"


def listed(names: list[str], most: int = 5) -> str:
    """The first names, and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
