"""Motions in .safetensors files, our own layout: `keypose.io.motion_arrays` with the facts in the metadata.

The format is a length, a JSON header and raw arrays; it is read without any library and cannot hold code.

Source: Hugging Face, "Safetensors: format", github.com/huggingface/safetensors.
"""

from __future__ import annotations

from pathlib import Path

from keypose.errors import FormatError
from keypose.io import atomic
from keypose.io.json_values import parse_json
from keypose.io.motion_arrays import Record, facts_text, to_record, to_scene
from keypose.io.tensors import pack_tensors, unpack_tensors
from keypose.model import Scene

_LARGEST_BYTES = 1 << 30
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
    arrays, metadata = unpack_tensors(data)
    text = metadata.get(_KEY)
    if not isinstance(text, str):
        raise FormatError(f"no motion of keypose: its metadata has no '{_KEY}'", where="__metadata__")
    return Record(arrays, parse_json(text.encode()).object())


def write(scene: Scene, path: Path) -> tuple[str, ...]:
    """Write the first animation of a scene, bit for bit; returns notes of what is left out.

    Raises:
        FormatError: where there is no animation, or the file cannot be written.
    """
    record, notes = to_record(scene)
    data = pack_tensors(dict(sorted(record.arrays.items())), {_KEY: facts_text(record.facts)})
    with atomic.replacing(path) as temporary, temporary.open("wb") as file:
        file.write(data)
    return notes
