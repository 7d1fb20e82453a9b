"""Where a damaged USD file is damaged, from what the library says and from the outline of a binary layer.

Source: Pixar, OpenUSD, `pxr/usd/sdf/crateFile.h`: a bootstrap of 88 bytes that leads to a table of sections.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path

from keypose.errors import FormatError

_LINE = re.compile(r":(\d+):(\d+): (.+)$")
_OLDER_LINE = re.compile(r"^(.+) on line (\d+) in file")  # before 25.x
_MESSAGE = re.compile(r" : '(.*?)'(?: Error in |$)")
_BYTE = re.compile(r"at offset (\d+)")
_SECTION = 32
_MOST_SECTIONS = 64


def place_of_damage(path: Path, error: FormatError) -> tuple[str, str]:
    """Where it is, and what is wrong there."""
    found = _MESSAGE.search(error.what)
    what = (found[1] if found else error.what).replace(str(path.resolve()), "").strip()
    line = _LINE.search(what)
    if line:
        return f"line {line[1]} column {line[2]}", line[3]
    line = _OLDER_LINE.search(what)
    if line:
        return f"line {line[2]}", line[1]
    byte = _BYTE.search(what)
    return error.where or (f"byte {byte[1]}" if byte else _outline(path)), what


def _outline(path: Path) -> str:
    """The first part of a layer that does not lie inside of the file."""
    with path.open("rb") as file:
        head = file.read(24)
        size = path.stat().st_size
        if head[:8] != b"PXR-USDC":
            return "package" if head[:2] == b"PK" else "contents"
        if len(head) < 24 or size < 88:
            return f"byte {size}, within the header"
        table = int.from_bytes(head[16:24], "little")
        if table + 8 > size:
            return f"byte {size}, before the table of sections"
        file.seek(table)
        count = int.from_bytes(file.read(8), "little")
        for _ in range(min(count, _MOST_SECTIONS)):
            entry = file.read(_SECTION)
            if len(entry) < _SECTION:
                return f"byte {size}, within the table of sections"
            name, start, length = struct.unpack("<16sqq", entry)
            if start < 0 or length < 0 or start + length > size:
                shown = name.split(b"\0")[0].decode("ascii", "replace")
                return f"section '{shown}'"
    return "contents"
