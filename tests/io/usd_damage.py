"""Damaged USD files, read under watch in a process of their own; run as a program it prints what happened."""

from __future__ import annotations

import collections
import json
import random
import resource
import struct
import sys
import tempfile
import time
import warnings
import zipfile
from io import BytesIO
from pathlib import Path

from tests.io.damage import damaged, peak_mib


def damaged_usd(data: bytes, seed: int) -> bytes:
    """Damaged bytes; half of the packages are damaged inside, so that their directory still fits."""
    dice = random.Random(seed)
    if data[:4] != b"PK\x03\x04" or dice.random() < 0.5:
        return damaged(data, seed)
    with zipfile.ZipFile(BytesIO(data)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    victim = dice.choice([*files])
    files[victim] = damaged(files[victim], seed)
    return packed(files)


def packed(files: dict[str, bytes]) -> bytes:
    """A package with its files at multiples of 64 bytes, as the format wants it."""
    out = BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name)
            gap = -(out.tell() + 30 + len(name) + 4) % 64
            entry.extra = struct.pack("<HH", 0x1986, gap) + bytes(gap)
            archive.writestr(entry, content)
    return out.getvalue()


def main(count: int, seed: int, sources: list[Path]) -> None:
    """Read damaged files in one go; print counts of outcomes and every outcome that should not be."""
    from keypose.errors import FormatError
    from keypose.io.usd import read_many, write

    warnings.simplefilter("error")  # a silent overflow or a NaN on the way is a wrong outcome too
    outcomes: collections.Counter[str] = collections.Counter()
    wrong: list[str] = []
    places = 0
    slowest = 0.0
    slow_file = ""
    sound = [path.read_bytes() for path in sources]
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder, f"{seed + n}{sources[n % len(sources)].suffix}") for n in range(count)]
        for n, path in enumerate(paths):
            path.write_bytes(damaged_usd(sound[n % len(sound)], seed + n) or b"\0")
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
                    if "understood" in text:
                        wrong.append(f"{path.name}: {text}")
                else:
                    outcomes["loaded"] += 1
                    if n % 5 == 0:
                        try:  # what was understood can also be written
                            write(scene, path.with_name("copy.usdc"))
                        except FormatError as error:
                            outcomes[f"not written: {error.what}"] += 1
            except Exception as error:
                wrong.append(f"{path.name}: {type(error).__name__}: {error}")
                results = read_many(paths[paths.index(path) + 1 :])
            if time.perf_counter() - started > slowest:
                slowest, slow_file = time.perf_counter() - started, path.name
            started = time.perf_counter()
    peak = max(int(peak_mib() * (1 << 20)), resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024)
    print(
        json.dumps(
            {
                "outcomes": outcomes,
                "places": places,
                "wrong": wrong[:50],
                "slowest_s": slowest,
                "slowest": slow_file,
                "peak_bytes": peak,
            }
        )
    )


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), [Path(p) for p in sys.argv[3:]])
