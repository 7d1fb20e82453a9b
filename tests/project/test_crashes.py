"""A thousand ends at any moment of editing and saving: no project lost, none unreadable, the last edit always there."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from keypose.project import workspace as w
from keypose.project.workspace import Workspace
from tests.project.crashes import Killed, Said, StoppingDisk, check_crash, session, state_of
from tests.project.kill import kill_many

STEPS = 10


@pytest.fixture(autouse=True)
def short_journals(monkeypatch: pytest.MonkeyPatch) -> None:
    """Journals begin anew often, so that this is stopped, too."""
    monkeypatch.setattr(w, "COMPACT_BYTES", 10_000)
    monkeypatch.setattr(w, "COMPACT_TIMES", 1.5)


@pytest.fixture
def memory() -> Iterator[Path]:
    """A folder in memory where there is one: nothing here needs a disk."""
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None) as folder:
        yield Path(folder)


def crash(
    root: Path, seed: int, budget: float, *, power: bool, workspace: Workspace | None = None, said: Said | None = None
) -> StoppingDisk:
    """One session that is stopped when its budget is spent; then everything is checked, and it goes on and ends again."""
    folder, state = root / "projects", root / "state"
    folder.mkdir(exist_ok=True)
    state.mkdir(exist_ok=True)
    rng = np.random.default_rng([seed, 7])
    disk = StoppingDisk(budget, power=rng if power else None)
    said = Said()
    try:
        session(Workspace(state, disk, locking=False), folder, np.random.default_rng(seed), said.hear, STEPS)
    except Killed:
        disk.lose_power()
    else:
        return disk
    # the next start takes over, goes on, and is ended once more
    again = StoppingDisk(power=disk.power)
    workspace = check_crash(said, folder, state, again, locking=False)
    if workspace.document.name != w.UNTITLED:  # what is shown after recovery is promised as well
        said.ok = state_of(workspace.document)
    again.budget = again.used + int(rng.integers(1, 20_000))
    try:
        session(workspace, folder, rng, said.hear, 4)
    except Killed:
        again.lose_power()
        check_crash(said, folder, state, StoppingDisk(), locking=False).close()
    return disk


@pytest.mark.slow
@pytest.mark.parametrize("power", [False, True], ids=["killed", "power"])
@pytest.mark.parametrize("seed", range(8))
def test_a_session_may_end_anywhere(seed: int, power: bool, memory: Path) -> None:
    (memory / "whole").mkdir()
    total = crash(memory / "whole", seed, float("inf"), power=power).used
    rng = np.random.default_rng([seed, 3, power])
    points = np.unique(np.concatenate([rng.integers(1, total, 40), total - rng.integers(1, 200, 12)]))
    for point in points:
        root = memory / f"{point}"
        root.mkdir()
        crash(root, seed, float(point), power=power)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_session_may_end_at_every_single_operation(seed: int, memory: Path) -> None:
    """Not at random bytes, but at every boundary between operations, and inside every write."""
    ends: list[int] = []

    class Noting(StoppingDisk):
        def _work(self, units: int = 1) -> int:
            ends.extend({self.used + 1, self.used + units // 2, self.used + units})
            return super()._work(units)

    (memory / "w").mkdir()
    (memory / "s").mkdir()
    session(
        Workspace(memory / "s", Noting(), locking=False),
        memory / "w",
        np.random.default_rng(seed),
        lambda _: None,
        STEPS,
    )
    for n, point in enumerate(sorted(set(ends))):
        root = memory / f"{n}"
        root.mkdir()
        crash(root, seed, float(point), power=bool(n % 2))


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs os.fork")
def test_real_processes_are_killed_while_they_edit_and_save(tmp_path: Path) -> None:
    steps, fewest = kill_many(tmp_path, 60)
    assert steps > 100
    assert fewest == 0, "some are killed before their first edit"
