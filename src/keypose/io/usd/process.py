"""Reading through usd-core in a process of its own."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Sequence
from pathlib import Path

from keypose.errors import FormatError, MissingExtra
from keypose.io import guarded
from keypose.io.guarded import Limits, Record

CHILD = Path(__file__).with_name("child.py")
LIMITS = Limits(base_memory=700 << 20, memory_per_byte=48, output_per_byte=48, base_cpu_s=5.0)
# One thread and one heap: more would each reserve addresses; nothing is looked for outside the file's own folder.
_ENVIRONMENT = {
    "PXR_WORK_THREAD_LIMIT": "1",
    "MALLOC_ARENA_MAX": "1",
    "PXR_AR_DEFAULT_SEARCH_PATH": "",
    "PXR_PLUGINPATH_NAME": "",
}


def records(paths: Sequence[Path]) -> Iterator[Record | FormatError]:
    """What each file holds, or why it cannot be read, in the order of ``paths``.

    Raises:
        MissingExtra: where usd-core is not installed.
    """
    need_usd("reading USD")
    return guarded.records(paths, CHILD, LIMITS, _ENVIRONMENT)


def need_usd(feature: str) -> None:
    """Raise `MissingExtra` where usd-core is not installed."""
    if importlib.util.find_spec("pxr") is None:
        raise MissingExtra(feature, "usd")
