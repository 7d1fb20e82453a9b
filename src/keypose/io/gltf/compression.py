"""Compressed geometry through optional libraries: meshoptimizer's buffer views and Draco's primitives.

Source: EXT_meshopt_compression and KHR_draco_mesh_compression of the Khronos glTF extension registry.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keypose.errors import FormatError, MissingExtra
from keypose.io.gltf.document import Compressed

# The most bytes that one compressed byte can stand for: a control byte of the vertex codec's version 1 covers four
# lanes of 256 elements each. A count beyond it is refused before memory is taken.
MESHOPT_MOST = 1024


def _library(module: str, feature: str) -> ModuleType:
    try:
        return importlib.import_module(module)
    except ImportError:
        raise MissingExtra(feature, "compression") from None


def unpack_meshopt(packed: Compressed, source: bytes, where: str) -> bytes:
    """The bytes of a compressed buffer view.

    Raises:
        FormatError: where the data is damaged.
        MissingExtra: where meshoptimizer is not installed.
    """
    library = _library("meshoptimizer", "reading glTF data compressed by meshoptimizer")
    count, stride = packed.count, packed.stride
    if count == 0:
        return b""
    if not source:
        raise FormatError("the compressed data is empty", where=where)
    try:
        if packed.mode == "ATTRIBUTES":
            return _filtered(library, library.decode_vertex_buffer(count, stride, source), packed, where)
        if stride not in (2, 4):
            raise FormatError(f"expected indices of 2 or 4 bytes, got {stride}", where=where)
        if packed.mode == "TRIANGLES" and count % 3:
            raise FormatError(f"{count} indices are no triangles", where=where)
        decode = library.decode_index_buffer if packed.mode == "TRIANGLES" else library.decode_index_sequence
        return decode(count, 4, source).astype("<u2" if stride == 2 else "<u4").tobytes()
    except (RuntimeError, ValueError) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"the compressed data is damaged: {error}", where=where) from None


def _filtered(library: ModuleType, decoded: NDArray[Any], packed: Compressed, where: str) -> bytes:
    strides = {"OCTAHEDRAL": (4, 8), "QUATERNION": (8,)}.get(packed.filter)
    if strides is not None and packed.stride not in strides:
        raise FormatError(f"the {packed.filter.lower()} filter needs a stride of {strides}", where=where)
    if packed.filter == "NONE":
        return decoded.tobytes()
    name = {"OCTAHEDRAL": "oct", "QUATERNION": "quat", "EXPONENTIAL": "exp"}[packed.filter]
    raw = np.frombuffer(decoded.tobytes(), np.uint8)  # as bytes: rounding floats to integers has no place here
    return getattr(library, f"decode_filter_{name}")(raw, packed.count, packed.stride).tobytes()


@dataclass(frozen=True, slots=True)
class DracoMesh:
    """The unpacked triangles and attributes (by Draco's unique id) of a primitive."""

    triangles: NDArray[np.int32]
    attributes: dict[int, NDArray[Any]]


def unpack_draco(source: bytes, where: str) -> DracoMesh:
    """The triangles and attributes of a compressed primitive.

    Raises:
        FormatError: where the data is damaged.
        MissingExtra: where DracoPy is not installed.
    """
    library = _library("DracoPy", "reading glTF data compressed by Draco")
    try:
        mesh = library.decode(source)
        if not hasattr(mesh, "faces"):
            raise FormatError("the compressed data holds points but no triangles", where=where)
        triangles = np.asarray(mesh.faces, np.int64).reshape(-1, 3)
        attributes = {int(a["unique_id"]): np.asarray(a["data"]) for a in mesh.attributes}
    except FormatError:
        raise
    except Exception as error:  # DracoPy's own exceptions have no common base
        raise FormatError(f"the Draco data is damaged: {error}", where=where) from None
    return DracoMesh(triangles.astype(np.int32), attributes)
