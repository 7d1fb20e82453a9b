"""Where a damaged FBX file is damaged, as far as its outer structure shows it.

Source: the layout of FBX's binary node records as described by A. Gessler, "FBX binary file format specification"
(Blender developers' blog, 2013).
"""

from __future__ import annotations

import struct
from pathlib import Path

MARK = b"Kaydara FBX Binary  \x00\x1a\x00"
_HEADER = 27
_MOST_BYTES = 64 << 20
_MOST_NODES = 200_000
_MOST_DEPTH = 64


def place_of_damage(path: Path) -> str:
    """The first place that does not fit: a byte and the node that it lies in, or a line; at least the kind of file."""
    try:
        with path.open("rb") as file:
            data = file.read(_MOST_BYTES)
    except OSError:
        return ""
    if data.startswith(MARK[:20]):
        return _in_binary(data)
    return _in_text(data)


def _in_binary(data: bytes) -> str:
    if len(data) < _HEADER:
        return f"byte {len(data)}, within the header"
    version = int.from_bytes(data[23:27], "little")
    layout = struct.Struct("<QQQB") if version >= 7500 else struct.Struct("<IIIB")
    position, count = _HEADER, 0
    open_nodes: list[tuple[str, int]] = []  # name and end of the nodes around the position
    last = "the header"
    while count < _MOST_NODES:
        count += 1
        if open_nodes and position >= open_nodes[-1][1]:
            if position > open_nodes[-1][1]:
                return f"byte {position}, after node '{_way(open_nodes)}'"
            open_nodes.pop()
            continue
        if position + layout.size > len(data):
            break
        end, _, length, name_length = layout.unpack_from(data, position)
        if end == 0:  # the empty record that ends a list of nodes
            if not open_nodes:
                return f"version {version} binary"
            position += layout.size
            continue
        name = data[position + layout.size : position + layout.size + name_length].decode("ascii", "replace")
        body = position + layout.size + name_length + length
        inside = open_nodes[-1][1] if open_nodes else 1 << 62
        if end > inside or body > end or not name.isprintable() or len(open_nodes) > _MOST_DEPTH:
            within = f" in node '{_way(open_nodes)}'" if open_nodes else f" after {last}"
            return f"byte {position}{within}"
        last = f"node '{_way([*open_nodes, (name, end)])}'"
        if body < end:
            open_nodes.append((name, end))
            position = body
        else:
            position = end
    if position + layout.size > len(data):
        return f"byte {len(data)}, after {last}"
    return f"version {version} binary"


def _way(nodes: list[tuple[str, int]]) -> str:
    return "/".join(name for name, _ in nodes)


def _in_text(data: bytes) -> str:
    line, opened = 0, list[int]()
    for line, text in enumerate(data.split(b"\n"), 1):
        code = _without_strings(text)
        for sign in code:
            if sign == 0x7B:
                opened.append(line)
            elif sign == 0x7D:
                if not opened:
                    return f"line {line}, a bracket that nothing opens"
                opened.pop()
        if b"\0" in text:
            return f"line {line}, a null character"
    if opened:
        return f"line {line}, where the bracket of line {opened[-1]} is still open"
    return f"{line} lines of text"


def _without_strings(text: bytes) -> bytes:
    return b"".join(text.split(b'"')[::2]).split(b";", 1)[0]
