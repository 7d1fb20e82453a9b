"""Accessors to arrays: every count is checked against the bytes that are really there before memory is taken.

Source: glTF 2.0 Specification, sections 3.6.1 (buffers and views) and 3.6.2 (accessors).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keypose.errors import FormatError
from keypose.io.gltf import compression
from keypose.io.gltf.container import Container, decode_data_uri, is_data_uri, read_beside
from keypose.io.gltf.items import COMPONENTS, WIDTHS, Accessor, BufferView, Document, Sparse
from keypose.io.notes import Notes

# How much may be decoded from one file: views may overlap and accessors may have no bytes at all, so that a small
# file can ask for any amount of memory.
BUDGET_BASE = 128 << 20
BUDGET_PER_BYTE = 8
_DTYPES = {name: np.dtype(name) for name in COMPONENTS.values()}
XYZW_TO_WXYZ = [3, 0, 1, 2]
PER_ITEM = 2048  # what a part, a morph channel or a curve takes at least: few bytes can ask for many of them


class Arrays:
    """The arrays of a document's accessors, each decoded once and read-only."""

    def __init__(self, document: Document, container: Container, notes: Notes) -> None:
        self._document, self._container, self._notes = document, container, notes
        self._buffers: dict[int, memoryview] = {}
        self._views: dict[int, memoryview] = {}
        self._arrays: dict[int, NDArray[Any]] = {}
        self._floats: dict[int, NDArray[np.float32]] = {}
        self._taken = 0
        self._present = len(container.json) + (0 if container.chunk is None else len(container.chunk))

    def take(self, size: int, where: str) -> None:
        """Count memory that is about to be taken; raises `FormatError` where the file asks for far too much."""
        self._taken += size
        if self._taken > BUDGET_BASE + BUDGET_PER_BYTE * self._present:
            raise FormatError(
                f"the file asks for {self._taken >> 20} MiB of data but holds only {self._present} bytes", where=where
            )

    def buffer(self, index: int) -> memoryview:
        """All bytes of a buffer."""
        if index not in self._buffers:
            item = self._document.buffers[index]
            if item.uri is None:
                chunk = self._container.chunk
                if index != 0 or chunk is None:
                    raise FormatError("the buffer has no URI and the file has no binary chunk for it", where=item.where)
                data: Any = chunk
            elif is_data_uri(item.uri):
                data = decode_data_uri(item.uri, item.where)[1]
            else:
                data = read_beside(self._container.folder, item.uri, item.length, item.where)
                if data is None:
                    raise FormatError(f"the file '{item.uri[:80]}' is missing", where=item.where)
                self._present += len(data)
            if len(data) < item.length:
                raise FormatError(f"expected {item.length} bytes, got {len(data)}", where=f"{item.where}.byteLength")
            self._buffers[index] = memoryview(data)[: item.length]
        return self._buffers[index]

    def range(self, buffer: int, offset: int, length: int, where: str) -> memoryview:
        """Some bytes of a buffer."""
        data = self.buffer(buffer)
        if offset + length > len(data):
            raise FormatError(
                f"bytes {offset} to {offset + length} do not exist; buffer {buffer} has {len(data)}", where=where
            )
        return data[offset : offset + length]

    def view(self, index: int) -> memoryview:
        """The bytes of a buffer view, unpacked where they are compressed."""
        if index not in self._views:
            item = self._document.views[index]
            if item.compressed is not None:
                self._views[index] = self._unpacked(item)
            else:
                if self._document.buffers[item.buffer].fallback and self._document.buffers[item.buffer].uri is None:
                    raise FormatError("the view lies in a fallback buffer that has no data", where=item.where)
                self._views[index] = self.range(item.buffer, item.offset, item.length, item.where)
        return self._views[index]

    def _unpacked(self, item: BufferView) -> memoryview:
        packed = item.compressed
        if packed is None:
            raise FormatError("the view is not compressed", where=item.where)
        source = self.range(packed.buffer, packed.offset, packed.length, item.where)
        size = packed.count * packed.stride
        if size > item.length + 3:  # the view's own length may be rounded up or down to alignment
            raise FormatError(f"{packed.count} elements do not fit into {item.length} bytes", where=item.where)
        if size > compression.MESHOPT_MOST * max(len(source), 1):
            raise FormatError(f"{len(source)} bytes cannot hold {packed.count} elements", where=item.where)
        self.take(size, item.where)
        return memoryview(compression.unpack_meshopt(packed, bytes(source), item.where))

    def array(self, index: int) -> NDArray[Any]:
        """The elements (count, width) of an accessor in their own type, matrices (count, 4 or 9 or 16) column by column."""
        array = self._arrays.get(index)
        if array is None:
            item = self._document.accessors[index]
            array = self._plain(item)
            if item.sparse is not None:
                array = self._replaced(array, item)
            if item.component == "<f4":
                self._check(array, item)
            array.flags.writeable = False
            self._arrays[index] = array
        return array

    @staticmethod
    def _check(array: NDArray[Any], item: Accessor) -> None:
        flat = array.reshape(-1)
        # A sum of squares that is finite has finite terms, and takes one quick pass without memory.
        if not math.isfinite(np.dot(flat, flat)) and not np.isfinite(flat).all():
            element = int(np.nonzero(~np.isfinite(array))[0][0])
            raise FormatError(f"element {element} is not a finite number", where=item.where)

    def _plain(self, item: Accessor) -> NDArray[Any]:
        width, component = WIDTHS[item.kind], _DTYPES[item.component]
        native = component.newbyteorder("=")
        if item.view is None:
            self.take(item.count * width * component.itemsize, item.where)
            return np.zeros((item.count, width), native)
        view = self._document.views[item.view]
        return self._elements(item.view, item.offset, view.stride, item.count, item.kind, component, item.where)

    def _elements(
        self, view: int, offset: int, stride: int | None, count: int, kind: str, component: np.dtype[Any], where: str
    ) -> NDArray[Any]:
        strided = self._in_place(view, offset, stride, count, kind, component, where)
        # The result owns its memory, so that what is built of it need not copy it once more.
        owned = np.empty((count, WIDTHS[kind]), component.newbyteorder("="))
        owned.reshape(strided.shape)[:] = strided
        return owned

    def _in_place(
        self, view: int, offset: int, stride: int | None, count: int, kind: str, component: np.dtype[Any], where: str
    ) -> NDArray[Any]:
        """The elements where they lie in the file, (count, width), or (count, columns, rows) of matrices."""
        data = self.view(view)
        width, bytes_each = WIDTHS[kind], component.itemsize
        rows = {"MAT2": 2, "MAT3": 3, "MAT4": 4}.get(kind)
        # Columns of small matrices start at multiples of four bytes.
        column = None if rows is None else -(-rows * bytes_each // 4) * 4
        element = width * bytes_each if rows is None or column is None else column * rows
        stride = element if stride is None else stride
        if stride < element:
            raise FormatError(f"elements of {element} bytes do not fit a stride of {stride}", where=where)
        needed = offset + (count - 1) * stride + element if count else 0
        if rows is not None and column is not None:  # the last column need not be padded
            needed -= column - rows * bytes_each
        if needed > len(data):
            raise FormatError(
                f"{count} elements need {needed} bytes; bufferViews[{view}] has {len(data)}", where=f"{where}.count"
            )
        self.take(count * width * max(bytes_each, 4), where)
        if rows is None or column is None:
            return np.ndarray((count, width), component, data, offset, (stride, bytes_each))
        return np.ndarray((count, rows, rows), component, data, offset, (stride, column, bytes_each))

    def _replaced(self, array: NDArray[Any], item: Accessor) -> NDArray[Any]:
        if item.sparse is not None and item.sparse.count:
            indices, values = self._replacements(item, item.sparse)
            array[indices] = values
        return array

    def _replacements(self, item: Accessor, sparse: Sparse) -> tuple[NDArray[Any], NDArray[Any]]:
        """Which elements (N,) are replaced, by which values (N, width)."""
        if sparse.count > item.count:
            raise FormatError(f"replaces {sparse.count} of {item.count} elements", where=f"{sparse.where}.count")
        where = f"{sparse.where}.indices"
        component = _DTYPES[sparse.indices_type]
        indices = self._elements(
            sparse.indices_view, sparse.indices_offset, None, sparse.count, "SCALAR", component, where
        )[:, 0]
        if indices.max() >= item.count:
            raise FormatError(f"element {int(indices.max())} does not exist; there are {item.count}", where=where)
        if not (indices[1:] > indices[:-1]).all():
            self._notes.add(f"{where}: the indices of replaced elements do not increase")
        component = _DTYPES[item.component]
        where = f"{sparse.where}.values"
        return indices, self._elements(
            sparse.values_view, sparse.values_offset, None, sparse.count, item.kind, component, where
        )

    def rows(self, index: int, *, place: str) -> tuple[NDArray[Any], NDArray[np.float32]] | None:
        """Elements (N,) of a VEC3 accessor and their values (N, 3) where all others are zero by themselves; None else."""
        item = self.expect(index, ("VEC3",), place)
        if item.view is not None or item.sparse is None or item.sparse.count == 0 or item.component != "<f4":
            return None
        indices, values = self._replacements(item, item.sparse)
        if not (indices[1:] > indices[:-1]).all():
            return None
        self._check(values, item)
        return indices, values

    def floats(self, index: int, *kinds: str, place: str) -> NDArray[np.float32]:
        """An accessor's elements (count, width) as float32; normalised integers become 0..1 or -1..1."""
        item = self.expect(index, kinds, place)
        array = self._floats.get(index)
        if array is None:
            array = self.array(index)
            if item.component != "<f4":
                array = self.as_floats(array, item.normalized)
                array.flags.writeable = False
            self._floats[index] = array
        return array

    def wxyz(self, index: int, *, place: str) -> NDArray[np.float32]:
        """The quaternions (count, 4) of an accessor in keypose's order; the caller's own.

        Whether they are finite is not looked at yet: unit quaternions are; for others there is `check_finite`.
        """
        item = self.expect(index, ("VEC4",), place)
        if item.component != "<f4" or item.view is None or item.sparse is not None:
            return self.floats(index, "VEC4", place=place)[:, XYZW_TO_WXYZ]
        stride = self._document.views[item.view].stride
        xyzw = self._in_place(item.view, item.offset, stride, item.count, "VEC4", _DTYPES["<f4"], item.where)
        owned = np.empty((item.count, 4), np.float32)
        if item.count and xyzw.flags.c_contiguous:
            # All one place further in one block, then each w before its x: six times faster than row by row.
            source, target = xyzw.reshape(-1), owned.reshape(-1)
            target[1:] = source[:-1]
            target[::4] = source[3::4]
        else:
            owned[:, 0] = xyzw[:, 3]
            owned[:, 1:] = xyzw[:, :3]
        return owned

    def passing(self, index: int) -> NDArray[Any]:
        """The elements (count, width) of an accessor where they lie in the file, for whoever copies them anyway."""
        item = self._document.accessors[index]
        if index in self._arrays or item.view is None or item.sparse is not None or item.component == "<f4":
            return self.array(index)
        component, stride = _DTYPES[item.component], self._document.views[item.view].stride
        found = self._in_place(item.view, item.offset, stride, item.count, item.kind, component, item.where)
        return found.reshape(item.count, -1)

    def check_finite(self, array: NDArray[Any], index: int) -> None:
        """Raises `FormatError` where elements of an accessor are no numbers."""
        self._check(array, self._document.accessors[index])

    @staticmethod
    def as_floats(array: NDArray[Any], normalized: bool) -> NDArray[np.float32]:
        """Integers as float32, divided by their largest value where they are normalised."""
        floats = array.astype(np.float32)
        if normalized and array.dtype.kind in "iu":
            floats /= np.float32(np.iinfo(array.dtype).max)
            np.maximum(floats, np.float32(-1), out=floats)
        return floats

    def expect(self, index: int, kinds: tuple[str, ...], place: str) -> Accessor:
        """The accessor, which has to be of one of these types."""
        item = self._document.accessors[index]
        if kinds and item.kind not in kinds:
            raise FormatError(f"expected {' or '.join(kinds)}, but accessors[{index}] is {item.kind}", where=place)
        return item
