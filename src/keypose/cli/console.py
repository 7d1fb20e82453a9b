"""What is printed for people: the console and the progress bar."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager

from rich.console import Console

Progress = Callable[[int, int], None]


def console() -> Console:
    """The console of standard output."""
    return Console(highlight=False, soft_wrap=True)


def counted(count: int, word: str, plural: str | None = None) -> str:
    """``1 clip``, ``3 clips``."""
    return f"{count:,} {word if count == 1 else plural or word + 's'}"


@contextmanager
def progress_bar(label: str, *, quiet: bool = False, after_s: float = 0.4) -> Generator[Progress]:
    """A function ``(done, total)`` that draws a bar on a terminal once the work has taken a moment."""
    if quiet or not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    bar = Bar(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    task = bar.add_task(label, total=None)
    begin = time.monotonic()

    def show(done: int, total: int) -> None:
        if not bar.live.is_started and time.monotonic() - begin > after_s:
            bar.start()
        bar.update(task, completed=done, total=total)

    try:
        yield show
    finally:
        bar.stop()
