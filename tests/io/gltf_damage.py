"""Damaged glTF files: bytes flipped, cut and repeated, and JSON with absurd numbers, cycles and wrong types.

Run as a program it reads them all under a memory limit and prints what happened, so that a test can see a hang, a crash
or too much memory from outside.
"""

from __future__ import annotations

import collections
import copy
import json
import random
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.io.damage import peak_mib
from tests.io.gltf_files import glb_of, split

MEMORY = 1 << 30
SECONDS_PER_FILE = 10

WRONG = [-1, 0, 1, 2, 7, 0.5, -0.0, 255, 65536, 2**31 - 1, 2**31, 2**32, 2**53, 2**63, 2**64, 10**30, 10**400, 1e-308]
WRONG += [
    1e18,
    1e38,
    1e300,
    -1e300,
    float("nan"),
    float("inf"),
    None,
    True,
    False,
    "",
    "x",
    "é\\0",
    [],
    {},
    [[]],
    [None],
    {"a": 1},
]
WRONG += [
    "data:,",
    "data:application/octet-stream;base64,!!!!",
    "../../../etc/passwd",
    "/etc/passwd",
    "http://a/b",
    "%ff",
]


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path of every value below ``value``."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in items:
        yield (*path, key)
        yield from places(child, (*path, key))


def damage_json(document: Any, rng: random.Random) -> Any:
    """The same document with one to three things wrong."""
    document = copy.deepcopy(document)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        kind = rng.random()
        nodes = document.get("nodes") if isinstance(document, dict) else None
        if kind < 0.15 and isinstance(nodes, list) and nodes:
            node = rng.choice(nodes)
            if isinstance(node, dict):  # cycles, self-parenting, two parents
                children = node.setdefault("children", [])
                if isinstance(children, list):
                    children.append(rng.randrange(-1, len(nodes) + 1))
            continue
        paths = list(places(document))
        if not paths:
            return document
        *way, last = rng.choice(paths)
        holder = document
        for key in way:
            holder = holder[key]
        if kind < 0.35:
            del holder[last]
        elif kind < 0.75:
            holder[last] = copy.deepcopy(rng.choice(WRONG))
        elif kind < 0.85 and isinstance(holder, list):
            holder.extend(copy.deepcopy(holder[last]) for _ in range(rng.choice([1, 2, 50])))
        else:  # something from elsewhere in the file
            *other_way, other = rng.choice(paths)
            source = document
            try:
                for key in (*other_way, other):
                    source = source[key]
                holder[last] = copy.deepcopy(source)
            except (KeyError, IndexError, TypeError):
                holder[last] = None
    return document


def damage_bytes(data: bytes, rng: random.Random) -> bytes:
    """The same bytes with some flipped, cut off, doubled or overwritten."""
    result = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 8, 64])):
        if not result:
            break
        kind, at = rng.random(), rng.randrange(len(result))
        if rng.random() < 0.3:
            at = rng.randrange(min(len(result), 64))  # headers
        if kind < 0.35:
            result[at] ^= 1 << rng.randrange(8)
        elif kind < 0.6:
            result[at] = rng.randrange(256)
        elif kind < 0.7:
            del result[rng.randrange(len(result)) :]
        elif kind < 0.8:
            del result[at : at + rng.randrange(1, 64)]
        elif kind < 0.9:
            result[at:at] = result[at : at + rng.randrange(1, 64)]
        else:
            value = rng.choice([0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x7FC00000, 0x7F800000])
            result[at : at + 4] = value.to_bytes(4, "little")
    return bytes(result)


def damaged(sources: list[Path], count: int, seed: int) -> Iterator[tuple[str, bytes]]:
    """Names and bytes of damaged files."""
    rng = random.Random(seed)
    read = {path: path.read_bytes() for path in sources}
    parts = {path: split(data) for path, data in read.items()}
    for number in range(count):
        path = sources[number % len(sources)]
        data = read[path]
        is_glb = data[:4] == b"glTF"
        if rng.random() < 0.35:
            yield f"{number}{path.suffix}", damage_bytes(data, rng)
            continue
        document, chunk = parts[path]
        text = json.dumps(damage_json(document, rng)).encode()
        if is_glb:
            chunk = damage_bytes(chunk, rng) if chunk and rng.random() < 0.2 else chunk
            yield f"{number}.glb", glb_of(text, chunk)
        else:
            yield f"{number}.gltf", text


def main(count: int, seed: int, sources: list[Path]) -> None:
    """Read damaged files one by one; print counts of outcomes and every outcome that should not be."""
    from keypose.errors import FormatError, MissingExtra
    from keypose.io.gltf import read, write

    for path in sources:
        read(path)
    with open("/proc/self/statm") as statm:
        used = int(statm.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    outcomes: collections.Counter[str] = collections.Counter()
    wrong: list[str] = []
    slowest = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for name, data in damaged(sources, count, seed):
            path = Path(folder, name)
            path.write_bytes(data)
            started = time.process_time()
            signal.alarm(SECONDS_PER_FILE)
            try:
                scene = read(path)
                outcomes["loaded"] += 1
                write(scene, path.with_name("copy.glb"))  # what was understood can also be written and read again
                read(path.with_name("copy.glb"))
            except (FormatError, MissingExtra) as error:
                outcomes[type(error).__name__] += 1
                text = str(error)
                if "\n" in text or len(text) > 400 or not text.startswith(str(path)):
                    wrong.append(f"{name}: the message is not one line with the path: {text[:500]}")
            except Exception as error:
                wrong.append(f"{name}: {type(error).__name__}: {error}")
            signal.alarm(0)
            slowest = max(slowest, time.process_time() - started)
            path.unlink()
    peak = int(peak_mib() * (1 << 20))
    print(json.dumps({"outcomes": outcomes, "wrong": wrong[:50], "slowest_s": slowest, "peak_bytes": peak}))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), [Path(p) for p in sys.argv[3:]])
