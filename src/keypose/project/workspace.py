"""Workspace: the project that is open, with its history, its file, its journal and its locks.

Every change is written to a journal in the user's state folder before it counts, and the journal goes when the project is
saved; so whatever ends the program, the next one offers everything up to the last change (`recoverable`, `recover`).
"""

from __future__ import annotations

import contextlib
import os
import secrets
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from keypose.errors import FormatError, KeyposeError, UnknownName
from keypose.io.native import document_bytes
from keypose.model import Document
from keypose.project import journal as j
from keypose.project.commands import Command, apply_all
from keypose.project.disk import Disk, remove_parts, write_whole
from keypose.project.file import SUFFIX, checked, from_bytes, state_folder
from keypose.project.history import History
from keypose.project.locks import Lock, Locked

UNTITLED = "Untitled"
COMPACT_BYTES = 64 << 20
COMPACT_TIMES = 4
"""A journal longer than this, and so many times as long as its beginning, begins anew with the document as it is."""

Stamp = tuple[int, int, int]
Reason = Literal["exists", "changed", "locked", "failed"]


class NotSaved(KeyposeError):
    """A project was not saved, and why."""

    def __init__(self, reason: Reason, path: str, message: str) -> None:
        self.reason: Reason = reason
        self.path = path
        super().__init__(message)


@dataclass(frozen=True, slots=True)
class Unsaved:
    """A project that was not saved before its program ended; ``changed_s`` in seconds since 1970."""

    id: str
    name: str
    path: str
    edits: int
    changed_s: float


class Workspace:
    """One open project. Methods may block on the disk; a caller with an event loop calls them in a thread, one at a time.

    ``state``: the folder of the journals, the user's own if not given. ``locking`` is for tests that simulate a disk.
    """

    def __init__(self, state: Path | None = None, disk: Disk | None = None, *, locking: bool = True) -> None:
        self.history = History(Document(UNTITLED))
        self.path = ""
        self.unsafe = ""
        """Why edits are not journaled; empty where they are."""
        self._disk = Disk() if disk is None else disk
        self._locking = locking
        self._state = state
        self._journal: j.Journal | None = None
        self._journal_lock: Lock | None = None
        self._begin_size = 0
        self._reach = [0, 0]  # how many undos and redos the journal's own history can do
        self._file_lock: Lock | None = None
        self._stamp: Stamp | None = None
        self._digest = ""
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

    # ---- another project ---------------------------------------------------------------------------------------------

    def begin(self, document: Document, *, discard: bool = False) -> None:
        """Let a document that was never saved take the place of what is open.

        What was not saved stays recoverable, unless ``discard`` says that nobody wants it.

        Raises:
            KeyposeError: where no file could hold the document, so that nothing of it would be safe.
        """
        document_bytes(checked(document))
        self.close(discard=discard)
        self._adopt(History(document), "", None, "")
        self._mark_saved()

    def open(self, path: str | Path, *, discard: bool = False) -> None:
        """Let a project file take the place of what is open; the file that is open already is read again.

        Raises:
            FormatError: where it cannot be read; what is open stays.
            Locked: where another studio has it open.
        """
        target = Path(os.path.expanduser(path)).absolute()
        ours = str(target) == self.path and self._file_lock is not None
        lock = self._file_lock if ours else self._lock_file(target)
        try:
            data, stamp = self._read(target)
            document = from_bytes(data)
        except BaseException as error:
            if not ours:
                _release(lock)
            if isinstance(error, FormatError):
                raise (error if error.path else error.at(target)) from None
            raise
        if ours:
            self._file_lock = None
        self.close(discard=discard)
        self._adopt(History(document), str(target), stamp, j.digest_of(data))
        self._file_lock = lock
        self._mark_saved()

    def close(self, *, discard: bool = False) -> None:
        """Let go of the project. Its journal goes only if everything is saved, or nobody wants it (``discard``)."""
        if self._journal is not None:
            if discard or self._saved is self.document:
                self._journal.remove()
            else:
                self._journal.close()
        _release(self._journal_lock)
        _release(self._file_lock)
        self._journal = self._journal_lock = self._file_lock = None

    # ---- changes -----------------------------------------------------------------------------------------------------

    def edit(self, commands: Sequence[Command], label: str, *, merge: str = "", at_s: float | None = None) -> None:
        """One step of undo; all of the commands or none. `sync` returns when it cannot be lost any more.

        Raises:
            KeyposeError: where a command cannot be applied.
        """
        document = apply_all(self.document, commands)
        now = time.time() if at_s is None else at_s
        self._write(j.edit_record(commands, label, merge, now))
        merged = self.history.do(document, label, merge=merge, at_s=now)
        self._reach = [self._reach[0] + (not merged), 0]
        self._compact()

    def undo(self) -> str:
        """One step back; returns its label, empty where there was none."""
        return self._move(back=True)

    def redo(self) -> str:
        """One step forward; returns its label, empty where there was none."""
        return self._move(back=False)

    def sync(self) -> None:
        """Return when everything that was done cannot be lost any more (as far as journals can be written)."""
        journal = self._journal
        if journal is not None:
            try:
                journal.sync()
            except OSError as error:
                self._not_safe(error)

    def _move(self, *, back: bool) -> str:
        history = self.history
        label = history.undo_label if back else history.redo_label
        target = history.undo_document if back else history.redo_document
        if target is None:
            return ""
        inside = self._journal is not None and self._reach[0 if back else 1] > 0
        if inside:
            self._write(j.move_record("undo" if back else "redo"))
            step = 1 if back else -1
            self._reach = [self._reach[0] - step, self._reach[1] + step]
        else:  # the journal does not go back as far
            self._write(j.document_record(target, label, time.time()))
            self._reach = [0, 0]  # what the journal would undo now is this step, which is none of ours
        if back:
            history.undo()
        else:
            history.redo()
        return label

    # ---- saving ------------------------------------------------------------------------------------------------------

    def save(self, path: str | None = None, *, force: bool = False) -> None:
        """Write the project to its file, or to another that becomes its file.

        Raises:
            NotSaved: where that would overwrite what is not the project's own (unless ``force``), another studio has the
                file open, or it cannot be written. The old file is whole then, and nothing is lost.
        """
        if path is None and not self.path:
            raise NotSaved("failed", "", "the project has no file yet; say where to save it")
        target = project_path(self.path if path is None else path)
        elsewhere = not self.path or os.path.realpath(target) != os.path.realpath(self.path)
        lock: Lock | None = None
        try:
            lock = self._lock_file(target) if elsewhere else None
        except Locked as error:
            raise NotSaved("locked", str(target), str(error)) from None
        try:
            found = _stamp(target)
            if not force and found is not None and elsewhere:
                raise NotSaved("exists", str(target), f"{target.name} is there already")
            if not force and found is not None and found != self._stamp and not elsewhere:
                raise NotSaved(
                    "changed", str(target), f"{target.name} was changed by another program since it was opened"
                )
            data = document_bytes(checked(self.document))
            digest = j.digest_of(data)
            if self._journal is not None:
                with contextlib.suppress(OSError):
                    self._journal.write(j.saving_record(digest, str(target)))
                    self._journal.sync()
            remove_parts(self._disk, target)  # nobody else writes it: we have its lock
            write_whole(self._disk, target, data)
        except BaseException as error:
            _release(lock)
            if isinstance(error, NotSaved) or not isinstance(error, (OSError, KeyposeError, ValueError)):
                raise
            what = getattr(error, "strerror", None) or str(error)
            raise NotSaved("failed", str(target), f"{target}: cannot be written: {what}") from None
        if elsewhere:
            _release(self._file_lock)
            self._file_lock = lock
        self.path, self._stamp, self._digest = str(target), _stamp(target), digest
        self._mark_saved()
        self.history.seal()
        self._drop_journal()

    # ---- what was not saved ------------------------------------------------------------------------------------------

    def recoverable(self) -> list[Unsaved]:
        """Projects that were not saved before their programs ended, the newest first; those in use are left out."""
        found: list[Unsaved] = []
        for path in self._journals():
            try:
                lock = self._lock_journal(path)
            except (Locked, OSError):
                continue
            try:
                remove_parts(self._disk, path)
                unsaved = self._unsaved(path)
                if unsaved is not None:
                    found.append(unsaved)
            finally:
                _release(lock)
        return sorted(found, key=lambda unsaved: -unsaved.changed_s)

    def recover(self, id: str) -> None:
        """Go on with a project that was not saved; its journal goes on, too.

        Raises:
            UnknownName: where there is none of that id.
            Locked: where another studio has it open.
            FormatError: where the journal is damaged from its very beginning.
        """
        path = self._journal_path(id)
        lock = self._lock_journal(path)
        file_lock: Lock | None = None
        try:
            held = j.read_journal(self._disk.read(path))
            history = j.replay(held)
            # the file may be our own that is open now, as it was saved before
            if held.path and held.path != self.path:
                file_lock = self._lock_file(Path(held.path))
            journal = j.Journal(self._disk, path, held.size)
            journal.sync()  # what is shown now is promised, too
            self._disk.sync_folder(path.parent)
        except BaseException:
            _release(file_lock)
            _release(lock)
            raise
        if held.path and held.path == self.path:
            file_lock, self._file_lock = self._file_lock, None
        self.close()
        stamp = self._stamp_of(held)
        self._adopt(history, held.path, stamp, held.saved)
        self._journal, self._journal_lock, self._file_lock = journal, lock, file_lock
        self._begin_size = held.size
        self._reach = [history.steps, history.redo_steps]
        self._saved_revision = -1

    def discard(self, id: str) -> None:
        """Forget what could be recovered; raises `UnknownName`, or `Locked` where another studio has it open."""
        path = self._journal_path(id)
        lock = self._lock_journal(path)
        try:
            self._disk.remove(path)
        finally:
            _release(lock)

    def _unsaved(self, path: Path) -> Unsaved | None:
        """What a journal would give back; one that has nothing the file does not have is removed."""
        try:
            held = j.read_journal(self._disk.read(path))
            name = held.begin.fields.text("name")
        except (OSError, KeyposeError):
            return None
        last = held.records[-1] if held.records else None
        if last is not None and last.kind == "saving":
            saved = Path(last.fields.text("path"))
            with contextlib.suppress(OSError):
                if j.digest_of(self._disk.read(saved)) == last.fields.text("digest"):
                    self._disk.remove(path)
                    return None
        changed = path.stat().st_mtime if path.exists() else 0.0
        return Unsaved(path.stem, name, held.path, held.edits, changed)

    def _stamp_of(self, held: j.Journaled) -> Stamp | None:
        """The stamp of the file, if it still is what the journal began with."""
        if not held.path:
            return None
        with contextlib.suppress(OSError):
            if j.digest_of(self._disk.read(Path(held.path))) == held.saved:
                return _stamp(Path(held.path))
        return None

    # ---- the journal -------------------------------------------------------------------------------------------------

    def _write(self, record: bytes) -> None:
        """Journal a record; where no journal can be written, say so in `unsafe` and go on."""
        try:
            if self._journal is None or self._journal.broken:
                self._start_journal(record)
            else:
                self._journal.write(record)
            self.unsafe = ""
        except OSError as error:
            self._not_safe(error)

    def _start_journal(self, *records: bytes) -> None:
        """A journal that begins with the document as it is, in place of the one there may be."""
        old = self._journal
        begin = j.begin_record(self.document, self.path, self._digest, time.time())
        if old is not None:
            if os.name == "nt":  # where an open file cannot be replaced
                old.close()
            self._journal = j.Journal.create(self._disk, old.path, [begin, *records])
            old.close()
        else:
            stamp = time.strftime("%Y%m%d-%H%M%S", time.gmtime())
            path = self._folder() / f"{stamp}-{secrets.token_hex(4)}{j.SUFFIX}"
            lock = self._lock_journal(path)
            try:
                self._journal = j.Journal.create(self._disk, path, [begin, *records])
            except BaseException:
                _release(lock)
                raise
            self._journal_lock = lock
        self._begin_size = len(begin)
        self._reach = [0, 0]

    def _compact(self) -> None:
        journal = self._journal
        if journal is not None and journal.size > max(COMPACT_BYTES, COMPACT_TIMES * self._begin_size):
            try:
                self._start_journal()
            except OSError as error:
                self._not_safe(error)

    def _drop_journal(self) -> None:
        if self._journal is not None:
            with contextlib.suppress(OSError):
                self._journal.remove()
        _release(self._journal_lock)
        self._journal = self._journal_lock = None
        self._reach = [0, 0]
        self.unsafe = ""

    def _not_safe(self, error: OSError) -> None:
        self.unsafe = f"unsaved changes cannot be kept: {error.strerror or error}"

    def _folder(self) -> Path:
        if self._state is None:
            self._state = state_folder()
        return self._state

    def _journals(self) -> list[Path]:
        try:
            return sorted(self._folder().glob(f"*{j.SUFFIX}"))
        except OSError:
            return []

    def _journal_path(self, id: str) -> Path:
        known = {path.stem: path for path in self._journals()}
        if id not in known:
            raise UnknownName("unsaved project", id[:60], known)
        return known[id]

    def _lock_journal(self, path: Path) -> Lock | None:
        if not self._locking:
            return None
        lock = Lock(path.with_suffix(".lock"))
        lock.acquire("what was not saved")
        return lock

    # ---- the file ----------------------------------------------------------------------------------------------------

    def _lock_file(self, target: Path) -> Lock | None:
        """The lock of a project file; None where there can be no lock file, as in a folder that is only read."""
        if not self._locking:
            return None
        real = Path(os.path.realpath(target))
        lock = Lock(real.with_name(f".{real.name}.lock"))
        try:
            lock.acquire(target.name)
        except OSError:
            return None
        return lock

    def _read(self, path: Path) -> tuple[bytes, Stamp | None]:
        try:
            stamp = _stamp(path)
            return self._disk.read(path), stamp
        except (OSError, ValueError) as error:
            what = (
                "no such file" if isinstance(error, FileNotFoundError) else getattr(error, "strerror", "") or str(error)
            )
            raise FormatError(what, path=path) from None

    def _adopt(self, history: History, path: str, stamp: Stamp | None, digest: str) -> None:
        self.history, self.path, self._stamp, self._digest = history, path, stamp, digest
        self._saved, self._saved_revision, self.unsafe = None, 0, ""
        self._reach = [0, 0]

    def _mark_saved(self) -> None:
        self._saved, self._saved_revision = self.document, self.history.revision


def project_path(path: str) -> Path:
    """The path that a person means: absolute, with the suffix of projects.

    Raises:
        NotSaved: where it has another suffix, no name, or lies in no folder.
    """
    try:
        os.fsencode(path)
    except ValueError:
        raise NotSaved("failed", "", "the name holds what no file name can") from None
    if not path.strip() or "\0" in path:
        raise NotSaved("failed", path, "expected the name of a file")
    target = Path(os.path.expanduser(path)).absolute()
    if target.suffix.lower() != SUFFIX:
        target = target.with_name(target.name + SUFFIX)
    if target.is_dir():
        raise NotSaved("failed", str(target), f"{target} is a folder; expected the name of a file")
    if not target.parent.is_dir():
        raise NotSaved("failed", str(target), f"the folder {target.parent} does not exist")
    return target


def _stamp(path: Path) -> Stamp | None:
    """What changes when a file does; None where it is not there."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino


def _release(lock: Lock | None) -> None:
    if lock is not None:
        lock.release()
