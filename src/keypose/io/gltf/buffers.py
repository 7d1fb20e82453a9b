"""The binary half of a glTF that is being written: aligned buffer views and accessors, equal data stored once.

Source: glTF 2.0 Specification, sections 3.6.1 and 3.6.2.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keypose.arrays import Ints

VERTICES = 34962  # ARRAY_BUFFER
INDICES = 34963  # ELEMENT_ARRAY_BUFFER
COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Buffers:
    """Collects data; ``data``, ``views`` and ``accessors`` are what the file will hold."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self._known_views: dict[bytes, int] = {}
        self._known_accessors: dict[Any, int] = {}
        self._keyframes = bytearray()  # of all animations: they share one view, which keeps the JSON small
        self._keyframe_view: int | None = None
        self._known_keyframes: dict[bytes, int] = {}

    def view(self, data: bytes, target: int | None = None, stride: int | None = None) -> int:
        """A buffer view of its own."""
        key = hashlib.blake2b(data, digest_size=16, key=f"{target} {stride}".encode()).digest()
        if key not in self._known_views:
            self._pad()
            view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
            if stride is not None:
                view["byteStride"] = stride
            if target is not None:
                view["target"] = target
            self.data += data
            self._known_views[key] = len(self.views)
            self.views.append(view)
        return self._known_views[key]

    def _pad(self) -> None:
        self.data += bytes(-len(self.data) % 4)

    def vertices(self, array: NDArray[Any], *, bounds: bool = False) -> int:
        """Vertex attributes (V, C); elements of odd size are padded to four bytes."""
        element = array.shape[1] * array.itemsize
        stride = -(-element // 4) * 4
        data = array
        if stride != element:
            data = np.zeros((len(array), stride), np.uint8)
            data[:, :element] = np.ascontiguousarray(array).view(np.uint8).reshape(len(array), element)
        view = self.view(data.tobytes(), VERTICES, stride if stride != element else None)
        return self._accessor(array, view, 0, bounds)

    def indices(self, triangles: Ints, vertex_count: int) -> int:
        """Triangle corners; the largest value of a type is reserved."""
        corners = triangles.reshape(-1, 1).astype(np.uint16 if vertex_count <= 65535 else np.uint32)
        return self._accessor(corners, self.view(corners.tobytes(), INDICES), 0, False)

    def plain(self, array: NDArray[Any]) -> int:
        """Data that is no vertex attribute, such as matrices."""
        return self._accessor(array, self.view(array.tobytes()), 0, False)

    def keyframes(self, array: NDArray[np.float32], *, bounds: bool = False) -> int:
        """Times or values of keyframes (K, C)."""
        if self._keyframe_view is None:
            self._keyframe_view = len(self.views)
            self.views.append({})
        data = array.tobytes()
        key = hashlib.blake2b(data, digest_size=16).digest()
        if key not in self._known_keyframes:
            self._known_keyframes[key] = len(self._keyframes)
            self._keyframes += data
        return self._accessor(array, self._keyframe_view, self._known_keyframes[key], bounds)

    def deltas(self, rows: Ints, deltas: NDArray[np.float32], vertex_count: int) -> int:
        """Morph deltas of some of the vertices: as a sparse accessor where that is smaller."""
        index = np.dtype(np.uint8 if vertex_count <= 256 else np.uint16 if vertex_count <= 65536 else np.uint32)
        sparse_size = len(rows) * (index.itemsize + 12) + 160  # and about that much more JSON
        if sparse_size >= vertex_count * 12:
            dense = np.zeros((vertex_count, 3), np.float32)
            dense[rows] = deltas
            return self.vertices(dense, bounds=True)
        accessor: dict[str, Any] = {"componentType": COMPONENTS["f4"], "count": vertex_count, "type": "VEC3"}
        low, high = np.zeros(3, np.float32), np.zeros(3, np.float32)
        if len(rows):
            low, high = deltas.min(axis=0), deltas.max(axis=0)
            if len(rows) < vertex_count:
                low, high = np.minimum(low, 0), np.maximum(high, 0)
            order = np.argsort(rows, kind="stable")
            accessor["sparse"] = {
                "count": len(rows),
                "indices": {
                    "bufferView": self.view(rows[order].astype(index).tobytes()),
                    "componentType": COMPONENTS[index.str[1:]],
                },
                "values": {"bufferView": self.view(deltas[order].tobytes())},
            }
        accessor |= {"min": [float(v) for v in low], "max": [float(v) for v in high]}
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def _accessor(self, array: NDArray[Any], view: int, offset: int, bounds: bool) -> int:
        kind = KINDS[array.shape[1]]
        key = (view, offset, len(array), kind, array.dtype.str, bounds)
        if key not in self._known_accessors:
            accessor: dict[str, Any] = {"bufferView": view}
            if offset:
                accessor["byteOffset"] = offset
            accessor |= {"componentType": COMPONENTS[array.dtype.str[1:]], "count": len(array), "type": kind}
            if bounds:
                accessor["min"] = [float(v) for v in array.min(axis=0)]
                accessor["max"] = [float(v) for v in array.max(axis=0)]
            self._known_accessors[key] = len(self.accessors)
            self.accessors.append(accessor)
        return self._known_accessors[key]

    def finish(self) -> bytes:
        """All bytes, padded to four."""
        if self._keyframe_view is not None:
            self._pad()
            self.views[self._keyframe_view] = {
                "buffer": 0,
                "byteOffset": len(self.data),
                "byteLength": len(self._keyframes),
            }
            self.data += self._keyframes
        self._pad()
        return bytes(self.data)
