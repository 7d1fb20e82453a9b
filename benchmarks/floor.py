"""Our kernels and our run time beside a floor that measures the same cases: another bench.py that writes the same JSON.

    python benchmarks/floor.py FOLDER_WITH_BENCH_PY [--suite runtime] [--repeat 5] [--rounds 15]

The two run in turn, so that a slow minute of the machine hits both; the median of the ratios of each pair of runs is
shown. Above 1 keypose is ahead. Rows are joined by name and unit; what only we measure follows without a ratio. The
folder is copied first, because the floor writes its code cache into it.
"""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

LARGER_IS_BETTER = ("/s",)


SUITES = ("kernels", "runtime", "ik")
Key = tuple[str, str, str]  # suite, name, unit


def main() -> None:
    """Run both, print the ratios; exit status 1 if a row is behind."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("floor", type=Path)
    parser.add_argument("--suite", choices=SUITES, action="append", help="only this one of ours; may be repeated")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    pairs: dict[Key, list[tuple[float, float]]] = {}
    alone: dict[Key, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        floor = Path(folder) / "floor"
        shutil.copytree(options.floor, floor, ignore=shutil.ignore_patterns("__pycache__"))
        (floor / "__pycache__").mkdir()
        theirs, ours = Path(folder) / "theirs.json", Path(folder) / "ours.json"
        for _ in range(options.repeat):
            for suite in options.suite or SUITES:
                run([sys.executable, "bench.py", "--json", str(theirs), "--rounds", str(options.rounds)], floor)
                code = f"from keypose.bench import run; run({suite!r}, {str(ours)!r}, {options.rounds})"
                run([sys.executable, "-c", code], floor.parent)
                known = {(r["name"], r["unit"]): r["value"] for r in json.loads(theirs.read_text())["results"]}
                for r in json.loads(ours.read_text())["results"]:
                    key = suite, r["name"], r["unit"]
                    if key[1:] in known:
                        pairs.setdefault(key, []).append((r["value"], known[key[1:]]))
                    elif r["value"] is not None:
                        alone.setdefault(key, []).append(r["value"])
    results = [joined(key, rows) for key, rows in pairs.items()]
    results += [row(key, statistics.median(values)) for key, values in alone.items()]
    for suite in options.suite or SUITES:
        print(f"\n{suite:66s} {'keypose':>12s} {'floor':>12s} {'unit':14s} {'ratio':>7s}  spread")
        for r in results:
            if r["suite"] == suite:
                show(r)
    if options.json:
        options.json.write_text(json.dumps({"results": results}, indent=1) + "\n")
    sys.exit(any((r["ratio"] or 1) < 0.97 and not r["name"].startswith("limit") for r in results))


def row(key: Key, value: float) -> dict[str, Any]:
    """A row that the floor does not have."""
    suite, name, unit = key
    return {"suite": suite, "name": name, "unit": unit, "value": value, "reference": None, "ratio": None}


def joined(key: Key, pairs: list[tuple[float, float]]) -> dict[str, Any]:
    """A row of both, in the medians of values and of the pairs' ratios."""
    ratios = [a / b if key[2].endswith(LARGER_IS_BETTER) else b / a for a, b in pairs]
    mine, other = (statistics.median(column) for column in zip(*pairs, strict=True))
    spread = min(ratios), max(ratios)
    return {**row(key, mine), "reference": other, "ratio": statistics.median(ratios), "spread": spread}


def show(r: dict[str, Any]) -> None:
    """One line."""
    line = f"{r['name']:66s} {r['value']:12.5g}"
    if r["ratio"] is None:
        print(f"{line} {'':12s} {r['unit']}")
    else:
        low, high = r["spread"]
        print(f"{line} {r['reference']:12.5g} {r['unit']:14s} {r['ratio']:6.2f}x  {low:.2f}-{high:.2f}")


def run(command: list[str], folder: Path) -> None:
    """One benchmark, quietly; its output is shown if it fails."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(command)} failed:\n{done.stdout}{done.stderr}")


if __name__ == "__main__":
    main()
