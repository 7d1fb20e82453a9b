"""Motions in NumPy's .npz files: our own layout (`keypose.io.motion_arrays`) and AMASS takes.

Nothing is ever unpickled, and no array is made larger than the bytes that are there for it: a file of a few kilobytes
that unpacks to gigabytes is refused.

Source: NumPy, "NEP 1: A simple file format for NumPy arrays".
"""

from __future__ import annotations

import struct
import warnings
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np

from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.io import arrays_amass, atomic
from keypose.io.axes import checked_up
from keypose.io.json_values import parse_json
from keypose.io.motion_arrays import Record, facts_text, to_record, to_scene
from keypose.io.text import shown
from keypose.model import Scene

_LARGEST_BYTES = 512 << 20  # unpacked, of all arrays that are read
_LARGEST_RATIO = (
    200  # of packed arrays that are together larger than this many bytes (scales alone pack to next to nothing):
)
_SMALL_BYTES = 16 << 20
_MOST_ARRAYS = 256
_FACTS = "keypose"
_AMASS = ("poses", "trans", "betas", "gender", "mocap_framerate", "mocap_frame_rate", "fps", "framerate")
_OWN = (
    _FACTS, "rotations", "translations", "scales", "parents", "rest_translations", "rest_rotations", "rest_scales",
    "end_joints", "end_offsets", "morph_weights", "event_times_s",
)  # fmt: skip


def read(path: Path, *, up: str = "Z", rate_hz: float | None = None) -> Scene:
    """Read a motion that keypose has written, or an AMASS take (SMPL, SMPL-H or SMPL-X).

    Shapes and units: ``up`` is the up axis of a take's world, ``rate_hz`` its rate where the file names none or a wrong
    one; our own files say both.

    Raises:
        FormatError: where the file is damaged, unpacks to too much or holds something else, with the array's name.
        UnknownName: for an axis that does not exist.
    """
    up = checked_up(up)
    if rate_hz is not None and not (np.isfinite(rate_hz) and rate_hz > 0):
        raise ShapeError(f"rate_hz: expected a positive number, got {rate_hz}")
    try:
        with zipfile.ZipFile(path) as archive:
            arrays = _arrays(archive)
    except FormatError:
        raise
    # a damaged directory or stream shows itself in all these ways
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        OSError,
        RuntimeError,
        ValueError,
        struct.error,
        OverflowError,
    ) as error:
        raise FormatError(f"no sound .npz file: {shown(str(error), 80)}") from None
    if _FACTS in arrays:
        return _own(arrays, path.stem)
    if arrays_amass.is_amass(arrays):
        return arrays_amass.to_scene(arrays, path.stem, up, rate_hz)
    listed = ", ".join(list(arrays)[:8]) or "none that is known"
    raise FormatError(f"neither a motion of keypose nor an AMASS take (poses, trans); its arrays: {listed}")


def _own(arrays: Mapping[str, Any], name: str) -> Scene:
    text = arrays[_FACTS]
    if text.dtype != np.uint8 or text.ndim != 1:
        raise FormatError("expected a text in bytes", where=_FACTS)
    record = Record({k: v for k, v in arrays.items() if k != _FACTS}, parse_json(text.tobytes()).object())
    return to_scene(record, name, "npz")


def _arrays(archive: zipfile.ZipFile) -> dict[str, Any]:
    members = archive.infolist()
    if len(members) > _MOST_ARRAYS:
        raise FormatError(f"{len(members)} arrays; at most {_MOST_ARRAYS} are read")
    wanted = {
        m.filename.removesuffix(".npy"): m for m in members if m.filename.removesuffix(".npy") in (*_OWN, *_AMASS)
    }
    total = sum(m.file_size for m in wanted.values())
    packed = max(sum(m.compress_size for m in wanted.values()), 1)
    if total > _LARGEST_BYTES or (total > _SMALL_BYTES and total / packed > _LARGEST_RATIO):
        largest = max(wanted, key=lambda n: wanted[n].file_size)
        raise FormatError(f"arrays unpack from {packed} to {total} bytes, which is too much", where=largest)
    for name, member in wanted.items():
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise FormatError(f"packed by method {member.compress_type}; NumPy stores or deflates", where=name)
        if member.flag_bits & 1:
            raise FormatError("the array is encrypted", where=name)
    found: dict[str, Any] = {}
    for name, member in wanted.items():
        with archive.open(member) as file:
            found[name] = _array(file, member.file_size, name)
    return found


def _array(file: IO[bytes], size: int, name: str) -> Any:
    """One array; its header is checked against the bytes that are there before anything is allocated."""
    head = file.read(12)
    if head[:6] != b"\x93NUMPY" or len(head) < 12 or head[6] not in (1, 2, 3):
        raise FormatError("no NumPy array", where=name)
    extra = 0 if head[6] == 1 else 2
    length = int.from_bytes(head[8 : 10 + extra], "little")
    if length > min(size, 1 << 16):
        raise FormatError(f"a header of {length} bytes", where=name)
    text = head[10 + extra :] + file.read(length - 2 + extra)
    dtype, fortran, shape = _header(text, name)
    if dtype.hasobject:
        raise FormatError("an array of Python objects; such arrays can run code and are never read", where=name)
    count = 1
    for n in shape:
        count *= n
    rest = size - 10 - extra - length
    if count * dtype.itemsize != rest:
        raise FormatError(f"{count} numbers of {dtype.itemsize} bytes, but {max(rest, 0)} bytes", where=name)
    data = file.read(rest)
    if len(data) != rest:
        raise FormatError("the array is cut short", where=name)
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")


def _header(text: bytes, name: str) -> tuple[np.dtype[Any], bool, tuple[int, ...]]:
    """The Python literal of an array's header; only plain dtypes."""
    import ast

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of odd escapes in a damaged header
            value: Any = ast.literal_eval(text.decode("latin-1").strip())
        descr, fortran, shape = value["descr"], value["fortran_order"], value["shape"]
        plain = isinstance(descr, str) and isinstance(fortran, bool) and isinstance(shape, tuple) and len(shape) <= 8
        if not plain or any(type(n) is not int or not 0 <= n < 2**40 for n in shape):
            raise ValueError
        return np.dtype(descr), fortran, shape
    except (ValueError, TypeError, KeyError, SyntaxError, MemoryError, RecursionError, AttributeError):
        raise FormatError("the header of the array makes no sense", where=name) from None


def write(scene: Scene, path: Path, *, layout: Literal["keypose", "amass"] = "keypose") -> tuple[str, ...]:
    """Write the first animation of a scene, bit for bit; returns notes of what is left out.

    ``layout="amass"`` writes the take of a skeleton of the SMPL family as AMASS has it.

    Raises:
        FormatError: where there is no animation, it does not fit the layout, or the file cannot be written.
        UnknownName: for a layout that does not exist.
    """
    if layout not in ("keypose", "amass"):
        raise UnknownName("layout", layout, ("keypose", "amass"))
    if layout == "amass":
        arrays, notes = arrays_amass.to_arrays(scene)
    else:
        record, notes = to_record(scene)
        arrays = {_FACTS: np.frombuffer(facts_text(record.facts).encode(), np.uint8), **record.arrays}
    with atomic.replacing(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy")  # without a date, so that equal motions are equal files
            member.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(member, "w", force_zip64=array.nbytes >= 1 << 31) as file:
                np.lib.format.write_array(file, np.asanyarray(array), allow_pickle=False)
    return notes
