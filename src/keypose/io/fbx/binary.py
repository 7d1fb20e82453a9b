"""The binary form of FBX 7.4: nodes with properties and child nodes.

Source: A. Gessler, "FBX binary file format specification" (Blender developers' blog, 2013).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from keypose.errors import FormatError

VERSION = 7400
HEADER = b"Kaydara FBX Binary  \x00\x1a\x00" + struct.pack("<I", VERSION)
# A file says when it was made and signs that; readers accept this pair, which makes equal scenes equal files.
CREATION_TIME = "1970-01-01 10:00:00:000"
FILE_ID = bytes.fromhex("28b32aebb624ccc2bfc8b02aa92bfcf1")
_FOOT_ID = bytes.fromhex("fabcab09d0c8d466b176fb831cf7267e")
_FOOT_MAGIC = bytes.fromhex("f85a8c6adef5d97eece90ce3758f290b")
_EMPTY = b"\0" * 13
_COMPRESS_FROM = 128
_ARRAY_CODES = {"f8": b"d", "f4": b"f", "i8": b"l", "i4": b"i"}


@dataclass(slots=True)
class Node:
    """A named node; its properties are encoded already."""

    name: str
    properties: list[bytes] = field(default_factory=list[bytes])
    children: list[Node] = field(default_factory=list["Node"])

    def add(self, name: str, *values: Any) -> Node:
        """A new child with these properties."""
        child = node(name, *values)
        self.children.append(child)
        return child


def node(name: str, *values: Any, children: Iterable[Node] = ()) -> Node:
    """A node with properties: booleans, integers (32 bits), floats (double), texts, bytes, `Long` and arrays."""
    return Node(name, [_property(value) for value in values], list(children))


@dataclass(frozen=True, slots=True)
class Long:
    """An integer of 64 bits."""

    value: int


def _property(value: Any) -> bytes:
    if isinstance(value, bool):
        return b"C" + bytes([value])
    if isinstance(value, int):
        return b"I" + struct.pack("<i", value)
    if isinstance(value, Long):
        return b"L" + struct.pack("<q", value.value)
    if isinstance(value, float):
        return b"D" + struct.pack("<d", value)
    if isinstance(value, str):
        data = value.encode("utf-8", "replace")
        return b"S" + struct.pack("<I", len(data)) + data
    if isinstance(value, bytes):
        return b"R" + struct.pack("<I", len(value)) + value
    return _array(np.ascontiguousarray(value))


def _array(array: Any) -> bytes:
    code = _ARRAY_CODES[array.dtype.str[1:]]
    data = array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes()
    if len(data) >= _COMPRESS_FROM:
        packed = zlib.compress(data, 1)
        return code + struct.pack("<III", array.size, 1, len(packed)) + packed
    return code + struct.pack("<III", array.size, 0, len(data)) + data


def properties(rows: Iterable[Sequence[Any]]) -> Node:
    """A ``Properties70`` node from rows of name, type, label, flags and values."""
    return node("Properties70", children=[node("P", *row) for row in rows])


def encode(nodes: Sequence[Node]) -> bytes:
    """A whole file; raises `FormatError` where it is too large for version 7.4."""
    out = bytearray(HEADER)
    for item in nodes:
        _write(out, item)
    out += _EMPTY + _FOOT_ID + b"\0" * 4
    out += b"\0" * (16 - len(out) % 16)
    out += struct.pack("<I", VERSION) + b"\0" * 120 + _FOOT_MAGIC
    if len(out) >= 1 << 32:
        raise FormatError(f"{len(out) >> 20} MiB are more than FBX 7.4 can hold")
    return bytes(out)


def _write(out: bytearray, item: Node) -> None:
    name = item.name.encode("ascii")
    start = len(out)
    data = b"".join(item.properties)
    out += b"\0" * 12 + bytes([len(name)]) + name + data
    for child in item.children:
        _write(out, child)
    if item.children or not item.properties:
        out += _EMPTY
    if len(out) < 1 << 32:
        struct.pack_into("<III", out, start, len(out), len(item.properties), len(data))
