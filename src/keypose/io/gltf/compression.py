"""Compressed geometry: meshoptimizer's buffer views, and Draco's primitives through an optional library.

Source: KHR_draco_mesh_compression of the Khronos glTF extension registry.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keypose.errors import FormatError, MissingExtra
from keypose.io.gltf.meshopt import MESHOPT_MOST, unpack_meshopt

__all__ = ["MESHOPT_MOST", "DracoMesh", "unpack_draco", "unpack_meshopt"]


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
    try:
        library = importlib.import_module("DracoPy")
    except ImportError:
        raise MissingExtra("reading glTF data compressed by Draco", "compression") from None
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
