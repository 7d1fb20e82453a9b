"""Our kernels beside a floor that measures the same cases: another bench.py that writes the same JSON.

    python benchmarks/floor.py FOLDER_WITH_BENCH_PY [--repeat 5] [--rounds 15]

The two run in turn, so that a slow minute of the machine hits both; the median of the ratios of each pair of runs is
shown. Above 1 keypose is ahead. The folder is copied first, because the floor writes its code cache into it.
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

LARGER_IS_BETTER = ("/s",)


def main() -> None:
    """Run both, print the ratios; exit status 1 if a kernel is behind."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("floor", type=Path)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows: dict[tuple[str, str], list[tuple[float, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        floor = Path(folder) / "floor"
        shutil.copytree(options.floor, floor, ignore=shutil.ignore_patterns("__pycache__"))
        (floor / "__pycache__").mkdir()
        theirs, ours = Path(folder) / "theirs.json", Path(folder) / "ours.json"
        for _ in range(options.repeat):
            run([sys.executable, "bench.py", "--json", str(theirs), "--rounds", str(options.rounds)], floor)
            code = f"from keypose.bench import run; run('kernels', {str(ours)!r}, {options.rounds})"
            run([sys.executable, "-c", code], floor.parent)
            known = {(r["name"], r["unit"]): r["value"] for r in json.loads(theirs.read_text())["results"]}
            for r in json.loads(ours.read_text())["results"]:
                key = r["name"], r["unit"]
                if key in known:
                    rows.setdefault(key, []).append((r["value"], known[key]))
    results = []
    for (name, unit), pairs in rows.items():
        ratios = [a / b if unit.endswith(LARGER_IS_BETTER) else b / a for a, b in pairs]
        mine, other = (statistics.median(column) for column in zip(*pairs, strict=True))
        ratio = statistics.median(ratios)
        results.append({"name": name, "unit": unit, "value": mine, "reference": other, "ratio": ratio})
        print(f"{name:58s} {mine:12.5g} {other:12.5g} {unit:14s} {ratio:6.2f}x  {min(ratios):.2f}-{max(ratios):.2f}")
    if options.json:
        options.json.write_text(json.dumps({"results": results}, indent=1) + "\n")
    sys.exit(any(r["ratio"] < 0.97 and not r["name"].startswith("limit") for r in results))


def run(command: list[str], folder: Path) -> None:
    """One benchmark, quietly; its output is shown if it fails."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(command)} failed:\n{done.stdout}{done.stderr}")


if __name__ == "__main__":
    main()
