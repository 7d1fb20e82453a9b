"""Real processes that edit and save, killed by SIGKILL at random moments: ``python -m tests.project.kill 1000``."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from keypose.project.disk import Disk
from keypose.project.workspace import Workspace
from tests.project.crashes import Said, check_crash, session


def kill_many(root: Path, count: int, seed: int = 0) -> tuple[int, int]:
    """So many processes, each checked after its end; returns all steps that were safe, and the fewest of any."""
    rng = np.random.default_rng(seed)
    steps: list[int] = []
    for n in range(count):
        folder, state = root / f"{n}", root / f"state {n}"
        folder.mkdir()
        state.mkdir()
        said = killed(folder, state, seed * count + n, float(rng.uniform(0.001, 0.12)))
        steps.append(said.steps)
        check_crash(said, folder, state, Disk(), locking=True).close()
    return sum(steps), min(steps)


def killed(folder: Path, state: Path, seed: int, after_s: float) -> Said:
    """What a process said until it was killed."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(read)

            def say(line: str) -> None:
                os.write(write, f"{line}\n".encode())

            session(Workspace(state), folder, np.random.default_rng(seed), say, 100_000)
        finally:
            os._exit(1)
    os.close(write)
    time.sleep(after_s)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    data = b""
    while chunk := os.read(read, 1 << 16):
        data += chunk
    os.close(read)
    said = Said()
    for line in data.decode().split("\n")[:-1]:  # the last one was cut off, or is nothing
        said.hear(line)
    return said


if __name__ == "__main__":
    kills = int(sys.argv[1])
    began = time.monotonic()
    with tempfile.TemporaryDirectory(dir=sys.argv[2] if len(sys.argv) > 2 else None) as temporary:
        total, least = kill_many(Path(temporary), kills, seed=1)
    print(
        f"{kills} kills, {total} steps that were safe ({least} at least): all there, in {time.monotonic() - began:.0f} s"
    )
