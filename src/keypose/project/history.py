"""History: undo and redo without limit, by keeping the documents themselves.

Documents are frozen and share whatever did not change, so a step costs only what it changed, and going back is exact: it
is the very document that was there before.
"""

from __future__ import annotations

from dataclasses import dataclass

from keypose.model import Document

MERGE_S = 1.0
"""Edits of one merge key that follow each other sooner than this are one step."""


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One step: the document on its other side, and what it is called."""

    document: Document
    label: str
    merge: str
    at_s: float


class History:
    """A document and how it came to be. ``revision`` counts every change, undo and redo too."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.revision = 0
        self._past: list[Step] = []
        self._future: list[Step] = []

    @property
    def undo_label(self) -> str:
        """What `undo` would take back; empty where there is nothing."""
        return self._past[-1].label if self._past else ""

    @property
    def redo_label(self) -> str:
        """What `redo` would do again; empty where there is nothing."""
        return self._future[-1].label if self._future else ""

    @property
    def undo_document(self) -> Document | None:
        """What `undo` would give back; None where there is nothing."""
        return self._past[-1].document if self._past else None

    @property
    def redo_document(self) -> Document | None:
        """What `redo` would give; None where there is nothing."""
        return self._future[-1].document if self._future else None

    @property
    def steps(self) -> int:
        """How many steps can be undone."""
        return len(self._past)

    @property
    def redo_steps(self) -> int:
        """How many steps can be redone."""
        return len(self._future)

    def do(self, document: Document, label: str, *, merge: str = "", at_s: float = 0.0) -> bool:
        """Go on to a new document; what could be redone is forgotten. Returns whether it became one with the last step.

        A step of the same ``merge`` key as the last one, not empty, and less than `MERGE_S` after it, becomes one with it.
        """
        last = self._past[-1] if self._past and not self._future else None
        merged = last is not None and bool(merge) and merge == last.merge and 0 <= at_s - last.at_s < MERGE_S
        if merged and last is not None:
            self._past[-1] = Step(last.document, label or last.label, merge, at_s)
        else:
            self._past.append(Step(self.document, label, merge, at_s))
        self._future.clear()
        self._go(document)
        return merged

    def undo(self) -> str:
        """Back to the document before the last step; returns the step's label, empty where there is none."""
        return self._move(self._past, self._future)

    def redo(self) -> str:
        """Forward again; returns the step's label, empty where there is none."""
        return self._move(self._future, self._past)

    def seal(self) -> None:
        """What follows does not become one with the last step, whatever its key."""
        if self._past:
            last = self._past[-1]
            self._past[-1] = Step(last.document, last.label, "", last.at_s)

    def _move(self, source: list[Step], target: list[Step]) -> str:
        if not source:
            return ""
        step = source.pop()
        target.append(Step(self.document, step.label, "", step.at_s))
        self._go(step.document)
        return step.label

    def _go(self, document: Document) -> None:
        self.document = document
        self.revision += 1
