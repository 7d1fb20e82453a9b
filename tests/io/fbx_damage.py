"""Damaged FBX files, read under watch in a process of their own; run as a program it prints what happened."""

from __future__ import annotations

import collections
import json
import resource
import sys
import tempfile
import time
import warnings
from pathlib import Path

from tests.io.damage import damaged, peak_mib

MEMORY = 1 << 30


def main(count: int, seed: int, sources: list[Path]) -> None:
    """Read damaged files in one go; print counts of outcomes and every outcome that should not be."""
    from keypose.errors import FormatError
    from keypose.io.fbx import read_many, write

    warnings.simplefilter("error")  # a silent overflow or a NaN on the way is a wrong outcome too
    outcomes: collections.Counter[str] = collections.Counter()
    wrong: list[str] = []
    places = 0
    slowest = 0.0
    sound = [path.read_bytes() for path in sources]
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder, f"{seed + n}.fbx") for n in range(count)]
        for n, path in enumerate(paths):
            path.write_bytes(damaged(sound[n % len(sound)], seed + n))
        started = time.perf_counter()
        results = read_many(paths)
        for path in paths:
            try:
                scene = next(results)
                if isinstance(scene, FormatError):
                    outcomes["refused"] += 1
                    text = str(scene)
                    places += bool(scene.where)
                    if "\n" in text or len(text) > 600 or not text.startswith(str(path)):
                        wrong.append(f"{path.name}: the message is not one line with the path: {text[:500]}")
                    if "gave up" in text or "understood" in text:
                        outcomes[scene.what] += 1
                else:
                    outcomes["loaded"] += 1
                    try:  # what was understood can also be written
                        write(scene, path.with_name("copy.fbx"))
                    except FormatError as error:
                        outcomes[f"not written: {error.what}"] += 1
            except Exception as error:
                wrong.append(f"{path.name}: {type(error).__name__}: {error}")
                results = read_many(paths[paths.index(path) + 1 :])
            slowest = max(slowest, time.perf_counter() - started)
            started = time.perf_counter()
    peak = max(int(peak_mib() * (1 << 20)), resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024)
    report = {"outcomes": outcomes, "places": places, "wrong": wrong[:50], "slowest_s": slowest, "peak_bytes": peak}
    print(json.dumps(report))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), [Path(p) for p in sys.argv[3:]])
