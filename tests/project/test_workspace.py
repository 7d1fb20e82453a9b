"""One open project: its file, its journal, its locks, and what the next start offers."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from keypose.errors import FormatError, KeyposeError, UnknownName
from keypose.io.native import document_bytes
from keypose.model import Document
from keypose.project import commands as c
from keypose.project import journal as j
from keypose.project import workspace as w
from keypose.project.disk import Disk
from keypose.project.file import load, save, state_folder
from keypose.project.locks import Lock, Locked
from keypose.project.workspace import NotSaved, Workspace
from tests.project.edits import random_commands, random_document


@pytest.fixture
def state(tmp_path: Path) -> Path:
    folder = tmp_path / "state"
    folder.mkdir()
    return folder


@pytest.fixture
def work(state: Path) -> Iterator[Workspace]:
    workspace = Workspace(state)
    yield workspace
    workspace.close()


def edit(workspace: Workspace, seed: int) -> bytes:
    workspace.edit(random_commands(np.random.default_rng([seed, 11]), workspace.document), f"edit {seed}")
    workspace.sync()
    return document_bytes(workspace.document)


def abandoned(workspace: Workspace) -> None:
    """End it as a killed process ends: its locks go, nothing is written any more."""
    journal = workspace._journal  # pyright: ignore[reportPrivateUsage]
    if journal is not None:
        journal.close()
    for lock in (workspace._journal_lock, workspace._file_lock):  # pyright: ignore[reportPrivateUsage]
        if lock is not None:
            lock.release()
    workspace._journal = workspace._journal_lock = workspace._file_lock = None  # pyright: ignore[reportPrivateUsage]


@pytest.mark.parametrize("seed", range(6))
def test_everything_is_offered_after_a_sudden_end_and_goes_on_from_there(
    seed: int, state: Path, tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    one = Workspace(state)
    one.begin(random_document(seed, 3))
    seen = [document_bytes(one.document)]
    for n in range(12):
        seen.append(edit(one, 100 * seed + n))
        if rng.random() < 0.3:
            one.undo()
            one.sync()
            seen.pop()
    last, label = document_bytes(one.document), one.history.undo_label
    abandoned(one)

    two = Workspace(state)
    (offer,) = two.recoverable()
    assert (offer.path, offer.edits > 0) == ("", True)
    two.recover(offer.id)
    assert document_bytes(two.document) == last
    assert two.history.undo_label == label
    assert two.saved_revision != two.history.revision
    assert two.recoverable() == [], "what is open is not offered again"
    for wanted in reversed(seen[:-1]):
        two.undo()
        assert document_bytes(two.document) == wanted
    two.sync()
    abandoned(two)

    three = Workspace(state)
    three.recover(three.recoverable()[0].id)
    assert document_bytes(three.document) == seen[0]
    three.save(str(tmp_path / "saved"))
    three.close()
    assert Workspace(state).recoverable() == []
    assert document_bytes(load(tmp_path / "saved.keypose")) == seen[0]
    assert sorted(p.name for p in state.iterdir()) == []


def test_steps_from_before_the_last_save_can_be_undone_and_are_recovered(state: Path, tmp_path: Path) -> None:
    work = Workspace(state)
    work.begin(random_document(1, 2))
    seen = [document_bytes(work.document)] + [edit(work, n) for n in range(4)]
    work.save(str(tmp_path / "p"))
    for wanted in reversed(seen[:-1]):
        work.undo()
        assert document_bytes(work.document) == wanted
    work.redo()
    work.redo()
    work.sync()
    abandoned(work)
    again = Workspace(state)
    again.recover(again.recoverable()[0].id)
    assert document_bytes(again.document) == seen[2]
    assert again.path == str(tmp_path / "p.keypose")
    again.save()
    assert document_bytes(load(tmp_path / "p.keypose")) == seen[2]
    again.close()


def test_a_saved_project_leaves_nothing_and_an_unsaved_one_stays_offered(
    work: Workspace, state: Path, tmp_path: Path
) -> None:
    edit(work, 1)
    work.save(str(tmp_path / "a"))
    assert work.saved_revision == work.history.revision
    work.begin(Document("next"))
    assert work.recoverable() == []
    edit(work, 2)
    work.begin(Document("third"))
    assert [u.name for u in work.recoverable()] == ["next"]
    work.discard(work.recoverable()[0].id)
    assert work.recoverable() == []
    edit(work, 3)
    work.begin(Document("fourth"), discard=True)
    assert work.recoverable() == []
    edit(work, 4)
    work.undo()  # back to what counts as saved
    work.begin(Document("fifth"))
    assert work.recoverable() == []
    with pytest.raises(UnknownName):
        work.recover("nothing")


def test_saving_asks_before_it_overwrites_what_is_not_its_own(work: Workspace, tmp_path: Path) -> None:
    other = tmp_path / "other.keypose"
    save(Document("theirs"), other)
    edit(work, 1)
    with pytest.raises(NotSaved) as refused:
        work.save(str(other))
    assert refused.value.reason == "exists"
    assert load(other).name == "theirs"
    work.save(str(other), force=True)
    edit(work, 2)
    os.utime(other, ns=(1, 1))
    with pytest.raises(NotSaved) as refused:
        work.save()
    assert refused.value.reason == "changed"
    work.save(force=True)
    assert document_bytes(load(other)) == document_bytes(work.document)
    for path, what in [
        ("", "name of a file"),
        ("a\0b", "name of a file"),
        (str(tmp_path / "no" / "x"), "does not exist"),
    ]:
        with pytest.raises(NotSaved, match=what) as refused:
            work.save(path)
        assert refused.value.reason == "failed"
    work.save(str(tmp_path / "walk.glb"))
    assert (tmp_path / "walk.glb.keypose").exists(), "a project is never written under another format's name"


def test_a_link_to_its_own_file_is_its_own_file(work: Workspace, tmp_path: Path) -> None:
    save(Document("p"), tmp_path / "p.keypose")
    (tmp_path / "link.keypose").symlink_to(tmp_path / "p.keypose")
    work.open(tmp_path / "p.keypose")
    edit(work, 1)
    work.save(str(tmp_path / "link.keypose"))
    assert document_bytes(load(tmp_path / "p.keypose")) == document_bytes(work.document)


def test_what_no_file_could_hold_is_not_begun(work: Workspace) -> None:
    with pytest.raises(KeyposeError, match="finite"):
        work.begin(Document("p", settings={"zoom": float("nan")}))
    assert work.document.name == "Untitled"


def test_two_studios_do_not_write_one_project(work: Workspace, state: Path, tmp_path: Path) -> None:
    path = tmp_path / "p.keypose"
    save(Document("p"), path)
    work.open(path)
    other = Workspace(state)
    with pytest.raises(Locked, match=f"p.keypose is open in another studio \\(process {os.getpid()} on"):
        other.open(path)
    other.begin(Document("q"))
    with pytest.raises(NotSaved) as refused:
        other.save(str(path), force=True)
    assert refused.value.reason == "locked"
    edit(work, 1)
    assert other.recoverable() == [], "what another studio has open is not offered"
    work.begin(Document("r"), discard=True)
    other.open(path)
    assert other.document.name == "p"
    other.close()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["p.keypose", "state"]


def test_the_lock_of_a_dead_process_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / ".p.keypose.lock"
    code = "import sys, time; from pathlib import Path; from keypose.project.locks import Lock\nLock(Path(sys.argv[1])).acquire('p'); print('held', flush=True); time.sleep(60)"
    child = subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE)
    assert child.stdout is not None
    child.stdout.readline()
    lock = Lock(path)
    with pytest.raises(Locked, match=f"process {child.pid} on"):
        lock.acquire("p")
    child.kill()
    child.wait()
    assert path.exists(), "it had no time to tidy up"
    lock.acquire("p")
    lock.release()
    assert not path.exists()
    child.stdout.close()


def test_opening_the_same_file_again_goes_back_to_what_is_saved(work: Workspace, tmp_path: Path) -> None:
    path = tmp_path / "p.keypose"
    save(random_document(2), path)
    work.open(path)
    saved = document_bytes(work.document)
    edit(work, 1)
    work.open(path, discard=True)
    assert document_bytes(work.document) == saved
    path.write_bytes(b"ruined")
    with pytest.raises(FormatError, match=r"p\.keypose"):
        work.open(path)
    assert document_bytes(work.document) == saved, "what is open stays"
    with pytest.raises(Locked):
        Workspace().open(path)


def test_a_torn_or_damaged_end_of_a_journal_costs_only_what_is_damaged(state: Path) -> None:
    work = Workspace(state)
    work.begin(random_document(5, 1))
    seen = [edit(work, n) for n in range(5)]
    abandoned(work)
    (path,) = state.glob("*.journal")
    data = path.read_bytes()
    ends = [j.read_journal(data[:n]).edits for n in range(len(data) - 3000, len(data), 97)]
    assert ends == sorted(ends)
    for size in range(len(data) - 1, len(data) - 400, -61):
        bad = data[:size]
        assert j.read_journal(bad).edits == 4
        flipped = bytearray(data)
        flipped[size] ^= 0x55
        assert j.read_journal(bytes(flipped)).edits == 4
    path.write_bytes(data[:-1])
    again = Workspace(state)
    again.recover(again.recoverable()[0].id)
    assert document_bytes(again.document) == seen[3]
    edit(again, 77)  # the torn end is gone, so that this follows on what is whole
    last = document_bytes(again.document)
    abandoned(again)
    third = Workspace(state)
    third.recover(third.recoverable()[0].id)
    assert document_bytes(third.document) == last
    third.close(discard=True)


def test_a_thousand_damaged_journals_never_break_the_start(state: Path) -> None:
    work = Workspace(state)
    work.begin(random_document(6, 1))
    for n in range(3):
        edit(work, n)
    abandoned(work)
    (path,) = state.glob("*.journal")
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    again = Workspace(state)
    for n in range(1000):
        bad = bytearray(data[: rng.integers(len(data))] if n % 2 else data)
        for at in rng.integers(0, max(len(bad), 1), 0 if n % 2 else 3):
            bad[at] = rng.integers(256)
        path.write_bytes(bad)
        for offer in again.recoverable():
            try:
                j.replay(j.read_journal(path.read_bytes()))
            except KeyposeError as error:
                assert str(error)
            assert offer.edits <= 3


def test_a_long_journal_begins_anew_and_loses_nothing(state: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(w, "COMPACT_BYTES", 20_000)
    work = Workspace(state)
    work.begin(random_document(7, 1))
    sizes: list[int] = []
    seen = [document_bytes(work.document)]
    for n in range(60):
        seen.append(edit(work, n))
        sizes.append(sum(p.stat().st_size for p in state.glob("*.journal")))
    assert np.any(np.diff(sizes) < 0), "it was never shortened"
    for wanted in reversed(seen[20:-1]):  # undo goes back beyond the new beginning
        work.undo()
        assert document_bytes(work.document) == wanted
    work.sync()
    abandoned(work)
    again = Workspace(state)
    again.recover(again.recoverable()[0].id)
    assert document_bytes(again.document) == seen[20]
    again.close(discard=True)


class FailingDisk(Disk):
    """A disk that is full from some moment on."""

    def __init__(self) -> None:
        self.full = False

    def write(self, handle: int, data: bytes) -> None:
        if self.full:
            super().write(handle, data[: len(data) // 2])
            raise OSError(28, "No space left on device")
        super().write(handle, data)


def test_a_full_disk_is_said_and_editing_goes_on(state: Path, tmp_path: Path) -> None:
    disk = FailingDisk()
    work = Workspace(state, disk)
    work.begin(random_document(8, 1))
    edit(work, 1)
    disk.full = True
    edit(work, 2)
    assert work.unsafe == "unsaved changes cannot be kept: No space left on device"
    with pytest.raises(NotSaved, match="No space left on device"):
        work.save(str(tmp_path / "p"))
    assert [p.name for p in tmp_path.iterdir()] == ["state"]
    disk.full = False
    last = edit(work, 3)
    assert work.unsafe == ""
    abandoned(work)
    again = Workspace(state)
    again.recover(again.recoverable()[0].id)
    assert document_bytes(again.document) == last, "what could not be written is in the journal's new beginning"
    again.close(discard=True)


def test_what_cannot_be_done_leaves_everything_as_it_was(work: Workspace) -> None:
    edit(work, 1)
    before, revision = work.document, work.history.revision
    with pytest.raises(UnknownName):
        work.edit([c.RemovePose("none")], "no")
    assert (work.document, work.history.revision) == (before, revision)


def test_the_state_folder_is_the_users_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "deep" / "state"))
    folder = state_folder()
    assert folder == tmp_path / "deep" / "state" / "keypose"
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    monkeypatch.setenv("XDG_STATE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert state_folder().is_relative_to(tmp_path)
    work = Workspace(folder)
    edit(work, 1)
    (path,) = folder.glob("*.journal")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    work.close(discard=True)
