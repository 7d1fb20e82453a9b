"""The safetensors format: one JSON header and raw arrays. It is read without any library and cannot hold code.

Source: Hugging Face, "Safetensors: format", github.com/huggingface/safetensors.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import FormatError
from keypose.io.json_values import Json, parse_json

LARGEST_HEADER = 64 << 20
_TYPES = {
    "F64": "<f8", "F32": "<f4", "F16": "<f2", "I64": "<i8", "I32": "<i4", "I16": "<i2", "I8": "i1",
    "U64": "<u8", "U32": "<u4", "U16": "<u2", "U8": "u1", "BOOL": "?",
}  # fmt: skip
_NAMES = {np.dtype(code).newbyteorder("="): name for name, code in _TYPES.items()}


def pack_tensors(arrays: Mapping[str, Array], metadata: Mapping[str, str]) -> bytes:
    """The bytes of a file; the same arrays and metadata give the same bytes.

    Raises:
        FormatError: for an array of a type that the format does not have.
    """
    header: dict[str, Any] = {"__metadata__": dict(metadata)}
    blobs: list[bytes] = []
    at = 0
    # the widest first, so that every array is aligned without padding, which the format forbids
    for name, array in sorted(arrays.items(), key=lambda item: -item[1].dtype.itemsize):
        kind = _NAMES.get(array.dtype.newbyteorder("="))
        if kind is None:
            raise FormatError(f"array '{name}': {array.dtype} cannot be stored")
        blob = array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes()
        header[name] = {"dtype": kind, "shape": list(array.shape), "data_offsets": [at, at + len(blob)]}
        at += len(blob)
        blobs.append(blob)
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 8)
    return b"".join([struct.pack("<Q", len(text)), text, *blobs])


def unpack_tensors(data: bytes | memoryview) -> tuple[dict[str, Array], dict[str, Any]]:
    """Arrays by name, which look into ``data``, and the metadata.

    Raises:
        FormatError: where the data is damaged, with the place.
    """
    view = memoryview(data)
    if len(view) < 8:
        raise FormatError("the file ends within the length of its header", where="byte 0")
    (length,) = struct.unpack_from("<Q", view)
    if length > min(LARGEST_HEADER, len(view) - 8):
        raise FormatError(f"a header of {length} bytes; the file has {len(view) - 8} more", where="byte 0")
    root = parse_json(bytes(view[8 : 8 + length]))
    body = view[8 + length :]
    arrays: dict[str, Array] = {}
    used = 0
    for name in root.object():
        if name != "__metadata__":
            arrays[name] = _array(root.need(name), body)
            used += arrays[name].nbytes
    if used != len(body):
        raise FormatError(
            f"{len(body)} bytes follow the header, but its arrays have {used}", where=f"byte {8 + length}"
        )
    metadata = root.get("__metadata__")
    return arrays, {} if metadata is None else metadata.object()


def _array(item: Json, body: memoryview) -> Array:
    kind = item.text("dtype")
    if kind not in _TYPES:
        item.fail(f"arrays of {kind[:20]} are not known; known: {', '.join(_TYPES)}")
    shape = tuple(n.as_integer(0) for n in item.items("shape"))
    if len(shape) > 8:
        item.fail(f"{len(shape)} dimensions")
    dtype = np.dtype(_TYPES[kind])
    offsets = item.items("data_offsets")
    if len(offsets) != 2:
        item.fail("expected two data_offsets")
    start, end = (offset.as_integer(0) for offset in offsets)
    count = 1
    for n in shape:
        count *= n
    if not start <= end <= len(body):
        item.fail(f"its bytes {start} to {end} are beyond the {len(body)} that are there")
    if end - start != count * dtype.itemsize:
        item.fail(f"{end - start} bytes for {count} numbers of {dtype.itemsize} bytes")
    return np.frombuffer(body[start:end], dtype).reshape(shape)
