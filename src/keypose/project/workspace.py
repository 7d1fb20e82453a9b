"""Workspace: the project that is open, its history and its file. It knows no clock but the system's, and no socket."""

from __future__ import annotations

import time
from collections.abc import Sequence

from keypose.model import Document
from keypose.project.commands import Command, apply_all
from keypose.project.history import History

UNTITLED = "Untitled"


class Workspace:
    """One open project. Methods may block on the disk; a caller with an event loop calls them in a thread, one at a time."""

    def __init__(self) -> None:
        self.history = History(Document(UNTITLED))
        self.path = ""
        self._saved: Document | None = self.history.document
        self._saved_revision = 0

    @property
    def document(self) -> Document:
        """The project as it is now."""
        return self.history.document

    @property
    def saved_revision(self) -> int:
        """The revision that the file holds: the present one where the document is what was saved."""
        return self.history.revision if self._saved is self.document else self._saved_revision

    def begin(self, document: Document) -> None:
        """Let a document that was never saved take the place of what is open."""
        self.history, self.path = History(document), ""
        self._mark_saved()

    def edit(self, commands: Sequence[Command], label: str, *, merge: str = "") -> None:
        """One step of undo; all of the commands or none. Returns when it cannot be lost any more.

        Raises:
            KeyposeError: where a command cannot be applied.
        """
        document = apply_all(self.document, commands)
        self.history.do(document, label, merge=merge, at_s=time.time())

    def undo(self) -> str:
        """One step back; returns its label, empty where there was none."""
        return self.history.undo()

    def redo(self) -> str:
        """One step forward; returns its label, empty where there was none."""
        return self.history.redo()

    def _mark_saved(self) -> None:
        self._saved, self._saved_revision = self.document, self.history.revision
