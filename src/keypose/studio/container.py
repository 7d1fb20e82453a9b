"""The binary container in which every message travels: one JSON header and aligned arrays.

Layout, little-endian::

    0   4 bytes   "KPS1"
    4   uint32    length of the header in bytes, a multiple of 8 less 8, so that the body starts at a multiple of 8
    8   header    UTF-8 JSON, padded with spaces
    ... body      arrays, each at a multiple of 8 from the start of the body

The browser makes typed arrays that look straight into the received buffer: nothing is parsed or copied twice.
"""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np

from keypose.errors import FormatError
from keypose.studio.scene_messages import ArrayRef

MAGIC = b"KPS1"
_ELEMENTS = {
    "float32": "<f4",
    "float64": "<f8",
    "uint8": "|u1",
    "uint16": "<u2",
    "uint32": "<u4",
    "int32": "<i4",
}


class Body:
    """Collects the arrays of a container and hands out their `ArrayRef`."""

    def __init__(self) -> None:
        self._chunks: list[bytes] = []
        self._size = 0

    def add(self, array: Any, element: str) -> ArrayRef:
        """Append an array, converted to the element type."""
        values = np.ascontiguousarray(array, dtype=_ELEMENTS[element])
        data = values.tobytes()
        ref = ArrayRef(self._size, len(data), element, [int(n) for n in values.shape])  # type: ignore[arg-type]
        self._chunks.append(data)
        self._chunks.append(b"\0" * (-len(data) % 8))
        self._size += len(data) + (-len(data) % 8)
        return ref

    def add_bytes(self, data: bytes) -> ArrayRef:
        """Append bytes."""
        return self.add(np.frombuffer(data, np.uint8), "uint8")

    def chunks(self) -> list[bytes]:
        """All parts of the body in order."""
        return self._chunks


def pack(header: Any, body: Body | None = None) -> bytes:
    """A container with this dataclass (or dict) as header."""
    fields = dataclasses.asdict(header) if dataclasses.is_dataclass(header) and not isinstance(header, type) else header
    text = json.dumps(fields, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
    text += b" " * (-len(text) % 8)
    return b"".join([MAGIC, len(text).to_bytes(4, "little"), text, *(body.chunks() if body else ())])


def unpack(data: bytes | memoryview) -> tuple[dict[str, Any], memoryview]:
    """Header and body of a container.

    Raises:
        FormatError: where it is not a container, is cut off, or the header is not a JSON object.
    """
    view = memoryview(data)
    if len(view) < 8 or bytes(view[:4]) != MAGIC:
        raise FormatError("expected a container that starts with 'KPS1'", where="byte 0")
    length = int.from_bytes(view[4:8], "little")
    if length > len(view) - 8:
        raise FormatError(f"header of {length} bytes, but only {len(view) - 8} bytes follow", where="byte 4")
    try:
        header = json.loads(bytes(view[8 : 8 + length]))
    except (ValueError, RecursionError):
        raise FormatError("the header is not JSON", where="byte 8") from None
    if not isinstance(header, dict):
        raise FormatError("the header is not a JSON object", where="byte 8")
    return header, view[8 + length :]


def array(body: memoryview, ref: dict[str, Any]) -> memoryview:
    """The bytes that an `ArrayRef`, as it came out of JSON, names.

    Raises:
        FormatError: where it reaches outside the body.
    """
    offset, size = ref.get("offset"), ref.get("bytes")
    if not (isinstance(offset, int) and isinstance(size, int)) or offset < 0 or size < 0 or offset + size > len(body):
        raise FormatError(f"an array at {offset} of {size} bytes is outside the body of {len(body)} bytes")
    return body[offset : offset + size]
