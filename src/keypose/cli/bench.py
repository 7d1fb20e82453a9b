"""`keypose bench`: ratios, never bare seconds."""

from __future__ import annotations

from pathlib import Path


def run_bench(name: str | None, json_path: Path | None, rounds: int) -> None:
    """Run one suite or all, print the table and write the JSON if asked."""
    from keypose.bench import run

    run(name, json_path=json_path, rounds=rounds)
