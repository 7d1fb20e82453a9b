"""Motions in .safetensors files, our own layout: `keypose.io.motion_arrays` with the facts in the metadata.

The format is a length, a JSON header and raw arrays; it is read without any library and cannot hold code.

Source: Hugging Face, "Safetensors: format", github.com/huggingface/safetensors.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from keypose.errors import FormatError
from keypose.io import atomic
from keypose.io.json_values import Json, parse_json
from keypose.io.motion_arrays import Record, facts_text, to_record, to_scene
from keypose.model import Scene

_LARGEST_HEADER = 16 << 20
_LARGEST_BYTES = 1 << 30
_TYPES = {"F64": "<f8", "F32": "<f4", "F16": "<f2", "I64": "<i8", "I32": "<i4", "I16": "<i2", "I8": "i1", "U8": "u1"}
_NAMES = {np.dtype(code).newbyteorder("="): name for name, code in _TYPES.items()}
_KEY = "keypose"


def read(path: Path) -> Scene:
    """Read a motion that keypose has written.

    Raises:
        FormatError: where the file is damaged or holds something else, with the place.
    """
    size = path.stat().st_size
    if size > _LARGEST_BYTES:
        raise FormatError(f"{size >> 20} MiB; at most {_LARGEST_BYTES >> 20} MiB are read", path=path)
    return to_scene(_record(path.read_bytes()), path.stem, "safetensors")


def _record(data: bytes) -> Record:
    if len(data) < 8:
        raise FormatError("the file ends within the length of its header", where="byte 0")
    (length,) = struct.unpack_from("<Q", data)
    if length > min(_LARGEST_HEADER, len(data) - 8):
        raise FormatError(f"a header of {length} bytes; the file has {len(data) - 8} more", where="byte 0")
    root = parse_json(data[8 : 8 + length])
    body = memoryview(data)[8 + length :]
    arrays: dict[str, Any] = {}
    for name in root.object():
        if name != "__metadata__":
            arrays[name] = _array(root.need(name), body)
    metadata = root.get("__metadata__")
    text = None if metadata is None else metadata.object().get(_KEY)
    if not isinstance(text, str):
        raise FormatError(f"no motion of keypose: its metadata has no '{_KEY}'", where="__metadata__")
    return Record(arrays, parse_json(text.encode()).object())


def _array(item: Json, body: memoryview) -> Any:
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


def write(scene: Scene, path: Path) -> tuple[str, ...]:
    """Write the first animation of a scene, bit for bit; returns notes of what is left out.

    Raises:
        FormatError: where there is no animation, or the file cannot be written.
    """
    record, notes = to_record(scene)
    header: dict[str, Any] = {"__metadata__": {_KEY: facts_text(record.facts)}}
    blobs: list[bytes] = []
    at = 0
    # the widest first, so that every array is aligned without padding, which the format forbids
    for name, array in sorted(record.arrays.items(), key=lambda item: (-item[1].dtype.itemsize, item[0])):
        blob = array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes()
        shape = list(array.shape)
        header[name] = {"dtype": _NAMES[array.dtype], "shape": shape, "data_offsets": [at, at + len(blob)]}
        at += len(blob)
        blobs.append(blob)
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 8)
    with atomic.replacing(path) as temporary, temporary.open("wb") as file:
        file.write(struct.pack("<Q", len(text)) + text)
        file.writelines(blobs)
    return notes
