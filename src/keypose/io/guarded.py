"""Reading through native libraries in a throw-away process, which may crash, hang or grow without taking the caller along.

One process reads several files in turn. Where it dies, the file it was at is tried once more as the first of a new
process, and refused if that dies too; the rest goes on. What comes back is checked before it is trusted.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from keypose.errors import FormatError

CHILD = Path(__file__).with_name("guarded_child.py")
ARRAY, FACTS = b"array   ", b"facts   "
_WALL_PER_CPU = 4.0  # how much longer a busy machine may take
_FILES_AT_ONCE = 64

_CODES = {
    "d": np.dtype("<f8"),
    "f": np.dtype("<f4"),
    "e": np.dtype("<f2"),
    "I": np.dtype("<u4"),
    "i": np.dtype("<i4"),
    "B": np.dtype("u1"),
}


@dataclass(frozen=True, slots=True)
class Limits:
    """What a process may use for a file, beside what its library takes: a base, and so much more for every byte of the file."""

    base_memory: int
    memory_per_byte: int = 24
    base_output: int = 128 << 20
    output_per_byte: int = 24
    base_cpu_s: float = 8.0
    cpu_s_per_byte: float = 1e-6


@dataclass(frozen=True, slots=True)
class Record:
    """What the library found in one file: facts, and the arrays that they name."""

    facts: Mapping[str, Any]
    data: bytes

    def array(self, found: Any, width: int = 0) -> NDArray[Any]:
        """The array of a reference, (N,) or (N, width)."""
        reference = cast("dict[str, Any]", found)
        values = np.frombuffer(self.data, _CODES[reference["kind"]], reference["count"], reference["at"])
        return values.reshape(-1, width) if width else values

    def floats(self, found: Any, width: int = 0) -> NDArray[np.float64]:
        """The array of a reference in double precision."""
        with np.errstate(invalid="ignore"):  # numbers that are none, which `sane` tells
            return self.array(found, width).astype(np.float64)

    def integers(self, found: Any, where: str) -> NDArray[np.int64]:
        """The array of a reference, if it has integers; raises `FormatError`."""
        values = self.array(found)
        if values.dtype.kind == "f":
            raise FormatError("expected integers, got fractions", where=where)
        return values.astype(np.int64)


def sane(values: Any) -> bool:
    """Whether all numbers are finite and of a size that can be reckoned with."""
    return bool(np.all(np.abs(values) < 1e15))  # a number that is none compares as False


def records(
    paths: Sequence[Path], reader: Path, limits: Limits, environment: Mapping[str, str] | None = None
) -> Iterator[Record | FormatError]:
    """What each file holds, or why it cannot be read, in the order of ``paths``.

    ``reader`` is the module that the process reads with (see `guarded_child`); ``environment`` is added to its own.
    """
    done = 0
    while done < len(paths):
        with tempfile.TemporaryFile() as out:
            batch = paths[done : done + _FILES_AT_ONCE]
            death = _run(batch, out, reader, limits, environment or {})
            found = 0
            for record in _collected(out, len(batch)):
                found += 1
                yield record
        done += found
        if found == 0:  # it died at the very first file, on which nothing before it can have had an influence
            yield FormatError(f"the file is damaged or too large: the process that read it gave up ({death})")
            done += 1


def _run(paths: Sequence[Path], out: IO[bytes], reader: Path, limits: Limits, environment: Mapping[str, str]) -> str:
    """Let one process read the files; returns how it ended."""
    sizes = [path.stat().st_size for path in paths]
    cpu_s = [limits.base_cpu_s + limits.cpu_s_per_byte * size for size in sizes]
    files = [
        (os.fspath(path.resolve()), seconds, limits.base_output + limits.output_per_byte * size)
        for path, size, seconds in zip(paths, sizes, cpu_s, strict=True)
    ]
    memory = limits.base_memory + limits.memory_per_byte * max(sizes)
    request = {"files": files, "memory_bytes": memory, "reader": os.fspath(reader)}
    process = subprocess.Popen(
        [sys.executable, "-P", os.fspath(CHILD)],
        stdin=subprocess.PIPE,
        stdout=out,
        stderr=subprocess.DEVNULL,
        env={**os.environ, **environment},
    )
    try:
        process.communicate(json.dumps(request).encode(), timeout=_WALL_PER_CPU * sum(cpu_s))
    except subprocess.TimeoutExpired:
        return "it took too long"
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
    return _cause(process.returncode)


def _cause(code: int) -> str:
    if code >= 0:
        return f"it ended with code {code}"
    if -code == getattr(signal, "SIGXCPU", 0):
        return "it took too long"
    try:
        return f"it was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"it was ended by signal {-code}"


def _collected(out: IO[bytes], most: int) -> Iterator[Record | FormatError]:
    """The whole records of a process's output, one after the other."""
    total = out.seek(0, os.SEEK_END)
    start = position = 0
    while most and position + 16 <= total:
        out.seek(position)
        head = out.read(16)
        length = int.from_bytes(head[8:], "little")
        if head[:8] not in (ARRAY, FACTS) or position + 16 + length > total:
            return
        if head[:8] == FACTS:
            out.seek(start)
            arrays = out.read(position - start)
            out.seek(position + 16)
            yield _record(arrays, out.read(length))
            start = position + 16 + length
            most -= 1
        position += 16 + length


def _record(arrays: bytes, text: bytes) -> Record | FormatError:
    facts = json.loads(text)
    if "error" not in facts:
        return Record(facts, arrays)
    what = " ".join(str(facts["error"]).split())[:300]
    what = "its structure is damaged" if what in ("", "Failed to load") else what
    return FormatError(what, where=str(facts.get("where", "")))
