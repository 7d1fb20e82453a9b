"""Reading through ufbx in a process of its own."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Sequence
from pathlib import Path

from keypose.errors import FormatError, MissingExtra
from keypose.io import guarded
from keypose.io.guarded import Limits, Record

CHILD = Path(__file__).with_name("child.py")
BASE_CPU_S = 8.0


def records(paths: Sequence[Path]) -> Iterator[Record | FormatError]:
    """What each file holds, or why it cannot be read, in the order of ``paths``.

    Raises:
        MissingExtra: where ufbx is not installed.
    """
    if importlib.util.find_spec("ufbx") is None:
        raise MissingExtra("reading FBX", "fbx")
    return guarded.records(paths, CHILD, Limits(base_memory=700 << 20, base_cpu_s=BASE_CPU_S))
