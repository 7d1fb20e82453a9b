"""Damaged FBX files, read under watch in a process of their own; run as a program it prints what happened."""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

from tests.io.damage import damaged
from tests.io.guarded_damage import report

MEMORY = 1 << 30


def main(count: int, seed: int, sources: list[Path]) -> None:
    """Read damaged files in one go; print counts of outcomes and every outcome that should not be."""
    from keypose.io.fbx import read_many, write

    sound = [path.read_bytes() for path in sources]
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder, f"{seed + n}.fbx") for n in range(count)]
        for n, path in enumerate(paths):
            path.write_bytes(damaged(sound[n % len(sound)], seed + n))
        print(json.dumps(report(paths, read_many, lambda scene, path: write(scene, path.with_name("copy.fbx")))))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), [Path(p) for p in sys.argv[3:]])
