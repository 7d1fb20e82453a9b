"""Damaged USD files, read under watch in a process of their own; run as a program it prints what happened."""

from __future__ import annotations

import json
import random
import struct
import sys
import tempfile
import zipfile
from io import BytesIO
from pathlib import Path

from tests.io.damage import damaged
from tests.io.guarded_damage import report


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
    from keypose.io.usd import read_many, write

    sound = [path.read_bytes() for path in sources]
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder, f"{seed + n}{sources[n % len(sources)].suffix}") for n in range(count)]
        for n, path in enumerate(paths):
            path.write_bytes(damaged_usd(sound[n % len(sound)], seed + n) or b"\0")
        found = report(
            paths,
            read_many,
            lambda scene, path: write(scene, path.with_name("copy.usdc")),
            every=5,
            understood=False,
        )
        print(json.dumps(found))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), [Path(p) for p in sys.argv[3:]])
