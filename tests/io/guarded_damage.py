"""Damaged files through a reader that works in a guarded process, several in one go: what became of them."""

from __future__ import annotations

import collections
import resource
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from keypose.errors import FormatError
from tests.io.damage import peak_mib


def report(
    paths: Sequence[Path],
    read_many: Callable[[Sequence[Path]], Iterator[Any]],
    copy: Callable[[Any, Path], object],
    every: int = 1,
    understood: bool = True,
) -> dict[str, Any]:
    """Counts of outcomes and every outcome that should not be; every so many files that were understood are also written.

    ``understood``: whether a refusal may say that the library's answer was not understood.
    """
    warnings.simplefilter("error")  # a silent overflow or a NaN on the way is a wrong outcome too
    outcomes: collections.Counter[str] = collections.Counter()
    wrong: list[str] = []
    places, slowest, slow_file = 0, 0.0, ""
    started = time.perf_counter()
    results = read_many(paths)
    for n, path in enumerate(paths):
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
                if "understood" in text and not understood:
                    wrong.append(f"{path.name}: {text}")
            else:
                outcomes["loaded"] += 1
                if n % every == 0:
                    try:  # what was understood can also be written
                        copy(scene, path)
                    except FormatError as error:
                        outcomes[f"not written: {error.what}"] += 1
        except Exception as error:
            wrong.append(f"{path.name}: {type(error).__name__}: {error}")
            results = read_many(paths[n + 1 :])
        if time.perf_counter() - started > slowest:
            slowest, slow_file = time.perf_counter() - started, path.name
        started = time.perf_counter()
    peak = max(int(peak_mib() * (1 << 20)), resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024)
    return {
        "outcomes": outcomes, "places": places, "wrong": wrong[:50], "slowest_s": slowest, "slowest": slow_file,
        "peak_bytes": peak,
    }  # fmt: skip
