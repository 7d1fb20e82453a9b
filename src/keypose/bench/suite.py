"""The cases of a benchmark: how they are checked, timed in turn, shown and stored."""

from __future__ import annotations

import itertools
import json
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from keypose.errors import KeyposeError

if TYPE_CHECKING:
    from rich.table import Table

# Seconds of this thread where the clock is fine enough: what other programs do meanwhile does not count.
_FINE = time.get_clock_info("thread_time").resolution < 1e-6
_clock = time.thread_time if _FINE else time.perf_counter

_ROUND_S = 3e-3  # a case is repeated until one round takes about this long
_REFERENCE_ROUNDS = 3

# seconds per item -> what is shown
_PER_ITEM = {
    "ns": 1e9,
    "ns/character": 1e9,
    "us/character": 1e6,
    "ns/vertex": 1e9,
    "ns/limb": 1e9,
    "us/solve": 1e6,
    "ms": 1e3,
}
_LESS = {"mm", "cm/s"}
_PER_SECOND = {
    "MB/s": 1e-6,
    "GB/s": 1e-9,
    "Gflop/s": 1e-9,
    "frames/s": 1.0,
    "slerps/s": 1.0,
    "characters": 1 / 60,
    "characters/ms": 1e-3,
}


@dataclass(frozen=True, slots=True)
class Result:
    """One row: ``value`` is the 25th percentile over the rounds; ``ratio`` > 1 is ahead of ``reference``."""

    name: str
    unit: str
    value: float | None
    median: float | None
    reference: float | None
    ratio: float | None
    against: str = ""
    note: str = ""
    suite: str = ""


@dataclass(slots=True)
class Case:
    """Something to time: ``call`` handles ``count`` items (or bytes, or operations)."""

    name: str
    unit: str
    count: float
    call: Callable[[], Any]
    against: str = ""
    reference: Callable[[], Any] | None = None
    reference_count: float = 0.0
    note: str = ""
    suite: str = ""
    published: float | None = None
    times: int = 1
    seconds: list[float] = field(default_factory=list[float])
    reference_seconds: list[float] = field(default_factory=list[float])

    def shown(self, seconds: float, count: float) -> float:
        """Seconds per call in the case's unit."""
        each = seconds / count
        return each * _PER_ITEM[self.unit] if self.unit in _PER_ITEM else _PER_SECOND[self.unit] / each


class BenchmarkError(KeyposeError):
    """A kernel's result is not what plain NumPy computes; timing it would mean nothing."""


class Suite:
    """Checks and cases, collected first and run together."""

    def __init__(self) -> None:
        self.name = ""
        self.cases: list[Case] = []
        self.missing: list[Result] = []  # from timing: what is measured otherwise or not at all

    def begin(self, name: str) -> None:
        """What is added from here on belongs to this suite: two may measure the same on different data."""
        self.missing = [replace(r, suite=r.suite or self.name) for r in self.missing]
        self.name = name

    def check(self, name: str, error: float, limit: float) -> None:
        """Refuse to time what computes something else; raises `BenchmarkError`."""
        if not error <= limit:
            raise BenchmarkError(f"{name}: differs from the reference by {error:.3g}, expected at most {limit:g}")

    def case(
        self,
        name: str,
        unit: str,
        count: float,
        call: Callable[[], Any],
        reference: Callable[[], Any] | None = None,
        against: str = "NumPy",
        reference_count: float | None = None,
        note: str = "",
        published: float | None = None,
    ) -> None:
        """Add a case, with the same work done by something else (on ``reference_count`` items) or what others say it takes."""
        counted = count if reference_count is None else reference_count
        self.cases.append(
            Case(
                name,
                unit,
                count,
                call,
                against if reference or published else "",
                reference,
                counted,
                note,
                self.name,
                published,
            )
        )

    def absent(self, name: str, unit: str, against: str) -> None:
        """A row for a library that is not installed."""
        self.missing.append(Result(name, unit, None, None, None, None, against, "not installed", self.name))

    def known(
        self, name: str, unit: str, value: float, reference: float | None = None, against: str = "", note: str = ""
    ) -> None:
        """A row that is not timed; of lengths and speeds less is better, of all else more."""
        ratio = None
        if reference is not None:
            ratio = reference / max(value, 1e-3 * reference) if unit in _LESS else value / reference
        self.missing.append(Result(name, unit, value, value, reference, ratio, against, note, self.name))

    def run(self, rounds: int, json_path: Path | None = None) -> list[Result]:
        """Time all cases in turn; show the table; write the JSON."""
        self._measure(rounds)
        self.begin("")
        results = [_result(case) for case in self.cases] + self.missing
        _show(results)
        if json_path is not None:
            _write(json_path, results, rounds)
        return results

    def _measure(self, rounds: int) -> None:
        for case in self.cases:
            _time(case.call, 1)
            once = min(_time(case.call, 1) for _ in range(3))
            case.times = max(1, int(_ROUND_S / max(once, 1e-7)))
            if case.reference is not None:
                _time(case.reference, 1)
        for number in range(rounds):
            for case in self.cases:
                # The case before has emptied the caches; a large output needs a few calls to be back in them.
                _time(case.call, 1 if case.times > 4 else 4 if case.unit != "ms" else 1)
                case.seconds.append(_time(case.call, case.times))
                # References are slow, so they get fewer rounds; where they get as many, they stand beside ours in each.
                if case.reference is not None and (case.unit == "ms" or number < _REFERENCE_ROUNDS):
                    case.reference_seconds.append(_time(case.reference, 1))


def host() -> dict[str, Any]:
    """What the results depend on."""
    import numba
    from llvmlite import binding

    from keypose import __version__
    from keypose.kernels.runtime import WIDTH

    return {
        "lanes": WIDTH,
        "cpu": binding.get_host_cpu_name(),
        "machine": platform.machine(),
        "system": platform.system(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "keypose": __version__,
    }


def _time(call: Callable[[], Any], times: int) -> float:
    start = _clock()
    for _ in itertools.repeat(None, times):
        call()
    return (_clock() - start) / times


def _result(case: Case) -> Result:
    value, median = (case.shown(float(np.percentile(case.seconds, p)), case.count) for p in (25, 50))
    reference, ratio = case.published, None
    if case.reference_seconds:
        reference = case.shown(float(np.percentile(case.reference_seconds, 25)), case.reference_count)
    if reference is not None:
        ratio = reference / value if case.unit in _PER_ITEM else value / reference
    return Result(case.name, case.unit, value, median, reference, ratio, case.against, case.note, case.suite)


def _show(results: list[Result]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("case", no_wrap=True)
    for title in ("value", "median", "reference", "ratio"):
        table.add_column(title, justify="right", no_wrap=True, min_width=7)
    table.add_column("unit", no_wrap=True, min_width=12)
    table.add_column("against", no_wrap=True, ratio=1)
    suites = list(dict.fromkeys(r.suite for r in results))
    for suite in suites:
        if len(suites) > 1:
            table.add_row(Text(suite, style="bold"))
        for r in results:
            if r.suite == suite:
                _add_row(table, r)
    where = host()
    console = Console()
    if not console.is_terminal:
        console = Console(width=160)  # in a file or a pipe, one line per row
    console.print(table)
    console.print(
        f"[dim]{where['cpu']}, {where['lanes']} float32 lanes, one thread; Python {where['python']}, "
        f"Numba {where['numba']}, NumPy {where['numpy']}. A ratio above 1 is ahead of the reference.[/dim]"
    )


def _add_row(table: Table, r: Result) -> None:
    from rich.text import Text

    ratio = Text("" if r.ratio is None else (f"{r.ratio:,.0f}x" if r.ratio >= 1000 else f"{r.ratio:.3g}x"))
    if r.ratio is not None:
        ratio.stylize("bold green" if r.ratio >= 1.05 else "yellow" if r.ratio >= 0.95 else "bold red")
    numbers = ("" if n is None else _readable(n) for n in (r.value, r.median, r.reference))
    table.add_row(r.name, *numbers, ratio, r.unit, Text(f"{r.against} {r.note}".strip(), style="dim"))


def _readable(number: float) -> str:
    if number >= 1e6:
        return f"{number / 1e6:.4g}M"
    if number >= 1e4:
        return f"{number:,.0f}"
    return f"{number:.4g}" if number >= 1e-4 else f"{number:.0g}"


def _write(path: Path, results: list[Result], rounds: int) -> None:
    rows = [
        {
            "name": r.name, "unit": r.unit, "value": r.value, "median": r.median, "reference": r.reference,
            "ratio": r.ratio, "against": r.against, "note": r.note, "suite": r.suite,
        }
        for r in results
    ]  # fmt: skip
    content = json.dumps({"host": {**host(), "rounds": rounds}, "results": rows}, indent=1) + "\n"
    from keypose.io.atomic import replacing

    with replacing(path) as temporary:
        temporary.write_text(content)
