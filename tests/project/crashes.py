"""Sessions of editing and saving that are stopped anywhere, and what has to be there afterwards.

A session says what it is about to make (``try``), and that it is safe now (``ok``). After a crash there must be, in files and
in what is offered for recovery, the last state that was ``ok`` or the one that was being made; and every file that was ever
saved must be one that was saved there, or was being saved.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from keypose.io.native import document_bytes
from keypose.model import Document
from keypose.project.commands import AddCharacter, apply_all
from keypose.project.disk import Disk
from keypose.project.file import load
from keypose.project.journal import digest_of
from keypose.project.workspace import UNTITLED, Workspace
from tests.project.edits import random_commands, small_character


@dataclass
class Said:
    """What a session has said."""

    ok: str = ""
    tried: str = ""
    steps: int = 0
    saved: dict[str, str] = field(default_factory=dict)
    saving: dict[str, str] = field(default_factory=dict)

    def hear(self, line: str) -> None:
        word, digest, *path = line.split(" ", 2)
        if word == "try":
            self.tried = digest
            if path:
                self.saving[path[0]] = digest
        else:
            self.ok, self.steps = digest, self.steps + 1
            if path:
                self.saved[path[0]] = digest
                self.saving.pop(path[0], None)


def state_of(document: Document) -> str:
    return digest_of(document_bytes(document))


def session(
    workspace: Workspace, folder: Path, rng: np.random.Generator, say: Callable[[str], None], steps: int
) -> None:
    """Random edits, undos, redos and saves."""
    if workspace.document.name == UNTITLED:
        workspace.begin(AddCharacter(small_character()).apply(Document("crash")))
    for _ in range(steps):
        history, what = workspace.history, rng.random()
        if what < 0.15:
            path = workspace.path or str(folder / "first.keypose")
            if rng.random() < 0.2:
                path = str(folder / f"other {rng.integers(2)}.keypose")
            say(f"try {state_of(workspace.document)} {path}")
            workspace.save(path, force=True)
            say(f"ok {state_of(workspace.document)} {path}")
            continue
        if what < 0.3 and history.undo_document is not None:
            say(f"try {state_of(history.undo_document)}")
            workspace.undo()
        elif what < 0.4 and history.redo_document is not None:
            say(f"try {state_of(history.redo_document)}")
            workspace.redo()
        else:
            commands = random_commands(rng, workspace.document)
            say(f"try {state_of(apply_all(workspace.document, commands))}")
            merge = "drag" if rng.random() < 0.3 else ""
            workspace.edit(commands, "edit", merge=merge)
        workspace.sync()
        assert workspace.unsafe == ""
        say(f"ok {state_of(workspace.document)}")


def check_crash(said: Said, folder: Path, state: Path, disk: Disk, *, locking: bool) -> Workspace:
    """Everything that must be there is there; returns a workspace that goes on with it."""
    allowed = {said.ok, said.tried} - {""}
    files = {str(path): state_of(load(path)) for path in folder.glob("*.keypose")}  # none is unreadable
    for path, digest in files.items():
        known = {said.saved.get(path, ""), said.saving.get(path, "")} - {""}
        assert digest in known, f"{path} holds what was never saved there"
    assert set(said.saved) <= set(files), "a saved project is gone"
    workspace = Workspace(state, disk, locking=locking)
    for unsaved in workspace.recoverable():
        workspace.recover(unsaved.id)
        if state_of(workspace.document) in allowed:
            return workspace
    workspace.close()
    if not said.ok:
        return workspace  # it ended before anything was promised
    current = [path for path, digest in files.items() if digest in allowed]
    assert current, f"after {said.steps} steps the last edit is lost"
    workspace.open(current[0])
    return workspace


class Killed(BaseException):
    """The process is no more."""


class StoppingDisk(Disk):
    """A disk whose program ends after so many units of work: one for each operation, and one for each byte written.

    With ``power`` the machine loses power instead: of what was written but not synced only the beginning is there, and of
    what was renamed, made and removed in a folder since it was synced only the first.
    """

    def __init__(self, budget: float = float("inf"), *, power: np.random.Generator | None = None) -> None:
        self.budget, self.used, self.power = budget, 0, power
        self.dead = False
        self._open: dict[int, Path] = {}
        self._unsynced: dict[Path, int] = {}  # file -> how much of it is safe
        self._log: dict[Path, list[Callable[[], None]]] = {}  # folder -> how to take back what is not safe

    def _work(self, units: int = 1) -> int:
        """How much of it may still be done; ends the program if it is not all."""
        if self.dead:
            raise Killed
        done = min(units, max(int(self.budget - self.used), 0)) if self.budget != float("inf") else units
        self.used += units
        if done < units:
            self.dead = True
        return done

    def _step(self) -> None:
        if self._work() == 0:
            raise Killed

    def create(self, path: Path, mode: int) -> int:
        self._step()
        handle = super().create(path, mode)
        self._open[handle], self._unsynced[path] = path, 0
        self._log.setdefault(path.parent, []).append(lambda: path.unlink(missing_ok=True))
        return handle

    def reopen(self, path: Path, size: int) -> int:
        self._step()
        handle = super().reopen(path, size)
        self._open[handle] = path
        self._unsynced.setdefault(path, size)
        return handle

    def write(self, handle: int, data: bytes) -> None:
        done = self._work(len(data))
        super().write(handle, data[:done])
        if done < len(data):
            raise Killed

    def sync(self, handle: int) -> None:
        self._step()
        self._unsynced[self._open[handle]] = os.fstat(handle).st_size

    def close(self, handle: int) -> None:
        self._open.pop(handle, None)
        super().close(handle)  # a process that ends closes its files, too

    def replace(self, source: Path, target: Path) -> None:
        self._step()
        before = target.read_bytes() if target.exists() else None
        safe = self._unsynced.pop(source, source.stat().st_size)

        def back() -> None:
            target.replace(source)
            self._unsynced[source] = self._unsynced.pop(target, safe)
            if before is not None:
                target.write_bytes(before)

        super().replace(source, target)
        self._unsynced[target] = safe
        self._log.setdefault(target.parent, []).append(back)

    def remove(self, path: Path) -> None:
        self._step()
        if path.exists():
            data, safe = path.read_bytes(), self._unsynced.pop(path, path.stat().st_size)

            def back() -> None:
                path.write_bytes(data)
                self._unsynced[path] = safe

            self._log.setdefault(path.parent, []).append(back)
        super().remove(path)

    def sync_folder(self, folder: Path) -> None:
        self._step()
        self._log.pop(folder, None)

    def lose_power(self) -> None:
        """Take back what was not safe, as much of it as chance will have it."""
        if self.power is None:
            return
        for log in self._log.values():
            for back in reversed(log[self.power.integers(len(log) + 1) :]):
                back()
        for path, safe in self._unsynced.items():
            if path.exists() and path.stat().st_size > safe:
                with path.open("r+b") as file:
                    file.truncate(int(self.power.integers(safe, path.stat().st_size + 1)))
