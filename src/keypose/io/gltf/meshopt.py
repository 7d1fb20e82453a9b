"""Buffer views packed by meshoptimizer: attributes, triangles and index sequences, and the filters over attributes.

Both extensions have the same streams: `EXT_meshopt_compression` knows version 0 of the attributes, the newer
`KHR_meshopt_compression` also version 1 and the filter of colours. Either version is read under either name.

Source: EXT_meshopt_compression and KHR_meshopt_compression of the Khronos glTF extension registry, appendices A
(bitstream) and B (filters).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from keypose.errors import FormatError
from keypose.io.gltf.items import Compressed

# The most bytes that one compressed byte can stand for: a control byte of the attributes' version 1 covers four
# bytes of 256 elements each. A count beyond it is refused before memory is taken.
MESHOPT_MOST = 1024

_HEADERS = {"ATTRIBUTES": (0xA0, 0xA1), "TRIANGLES": (0xE1,), "INDICES": (0xD1,)}
_STRIDES = {"OCTAHEDRAL": (4, 8), "QUATERNION": (8,), "COLOR": (4, 8)}
_TAILS = (32, 24)  # least bytes of the attributes' tail, by version
_FAULTS = (  # by the kernels' codes
    "",
    "the compressed data ends too early",
    "the compressed data goes on after its last element",
    "a number takes more than five bytes",
    "a triangle refers to an earlier one that does not exist",
)


def unpack_meshopt(packed: Compressed, source: bytes, where: str) -> bytes:
    """The ``count * stride`` bytes of a compressed buffer view.

    Raises:
        FormatError: where the data is damaged; the message names the byte of the compressed data.

    Source: KHR_meshopt_compression, appendix A.
    """
    _check(packed, where)
    if packed.count == 0:
        return b""
    headers = _HEADERS[packed.mode]
    if not source:
        raise FormatError("the compressed data is empty", where=where)
    if source[0] not in headers:
        expected = " or ".join(f"{header:#04x}" for header in headers)
        raise FormatError(
            f"expected compressed {packed.mode.lower()} to begin with {expected}, got {source[0]:#04x}", where=where
        )
    data = np.frombuffer(source, np.uint8)
    if packed.mode == "ATTRIBUTES":
        return _attributes(packed, data, where)
    indices = _triangles(packed, data, where) if packed.mode == "TRIANGLES" else _sequence(packed, data, where)
    return indices.astype("<u2" if packed.stride == 2 else "<u4").tobytes()


def _check(packed: Compressed, where: str) -> None:
    stride = packed.stride
    if packed.mode == "ATTRIBUTES":
        if stride % 4 or not 4 <= stride <= 256:
            raise FormatError(f"expected a stride of 4 to 256 bytes, a multiple of 4; got {stride}", where=where)
        strides = _STRIDES.get(packed.filter)
        if strides is not None and stride not in strides:
            expected = " or ".join(map(str, strides))
            raise FormatError(
                f"the {packed.filter.lower()} filter needs a stride of {expected}, got {stride}", where=where
            )
        return
    if packed.filter != "NONE":
        raise FormatError(f"the {packed.filter.lower()} filter is for attributes, not for indices", where=where)
    if stride not in (2, 4):
        raise FormatError(f"expected indices of 2 or 4 bytes, got {stride}", where=where)
    if packed.mode == "TRIANGLES" and packed.count % 3:
        raise FormatError(f"{packed.count} indices are no triangles", where=where)


def _need(size: int, least: int, packed: Compressed, where: str) -> None:
    """Refuses what cannot hold its count, before memory is taken for it."""
    if size < least:
        raise FormatError(
            f"{packed.count} elements take at least {least} compressed bytes; there are {size}", where=where
        )


def _done(fault: int, place: int, where: str) -> None:
    if fault:
        raise FormatError(f"{_FAULTS[fault]} (byte {place})", where=where)


def _attributes(packed: Compressed, data: NDArray[np.uint8], where: str) -> bytes:
    from keypose.kernels import meshopt

    count, stride = packed.count, packed.stride
    version = int(data[0]) & 1
    tail = stride + version * (stride // 4)
    end = data.size - max(tail, _TAILS[version])
    full, rest = divmod(count, meshopt.block_elements(stride))
    if version:  # a control byte for four byte positions
        body = (full + (rest > 0)) * (stride // 4)
    else:  # two header bits for each group of each byte position
        body = stride * (full * -(-meshopt.block_elements(stride) // 64) + -(-rest // 64))
    _need(data.size, 1 + body + data.size - end, packed, where)
    baseline = data[data.size - tail :][:stride]
    channels = data[data.size - stride // 4 :] if version else None
    if channels is not None:
        wrong = np.flatnonzero((channels & 15 > 2) | ((channels & 15 < 2) & (channels >> 4 != 0)))
        if wrong.size:
            raise FormatError(
                f"unknown mode {int(channels[wrong[0]]):#04x} of the bytes {4 * int(wrong[0])} to {4 * int(wrong[0]) + 3}",
                where=where,
            )
    values, fault, place = meshopt.decode_attributes(data[:end], count, baseline, channels)
    _done(fault, place, where)
    return values.tobytes() if packed.filter == "NONE" else _FILTERS[packed.filter](values, stride).tobytes()


def _triangles(packed: Compressed, data: NDArray[np.uint8], where: str) -> NDArray[np.uint32]:
    from keypose.kernels import meshopt

    _need(data.size, 1 + packed.count // 3 + 16, packed, where)
    table = data[-16:]
    if table[-2:].any() or np.any((table >> 4 == 15) | (table & 15 == 15)):
        raise FormatError("the table at the end of the compressed triangles is damaged", where=where)
    values, fault, place = meshopt.decode_triangles(data[:-16], packed.count, table)
    _done(fault, place, where)
    return values


def _sequence(packed: Compressed, data: NDArray[np.uint8], where: str) -> NDArray[np.uint32]:
    from keypose.kernels import meshopt

    _need(data.size, 1 + packed.count + 4, packed, where)
    values, fault, place = meshopt.decode_sequence(data[:-4], packed.count)
    _done(fault, place, where)
    return values


# --- filters: what no encoder writes (a scale of 0, components beyond it) gives some value in range ----------------------


def _rounded(values: NDArray[np.floating[Any]], least: int, most: int, kind: str) -> NDArray[Any]:
    """The nearest integers, halves away from zero."""
    return np.clip(np.trunc(values + np.copysign(np.float32(0.5), values)), least, most).astype(kind)


def _octahedral(data: NDArray[np.uint8], stride: int) -> NDArray[Any]:
    """Unit vectors from x and y on the octahedron, scaled by the third component; the fourth passes."""
    kind, most = ("i1", 127) if stride == 4 else ("<i2", 32767)
    stored = data.view(kind).reshape(-1, 4)
    one = np.where(stored[:, 2] == 0, 1, stored[:, 2]).astype(np.float32)
    x, y = stored[:, 0] / one, stored[:, 1] / one
    z = np.float32(1) - np.abs(x) - np.abs(y)
    below = np.maximum(-z, np.float32(0))  # the lower half is folded outwards
    vectors = np.stack([x - np.copysign(below, x), y - np.copysign(below, y), z], axis=1)
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    out = stored.copy()
    out[:, :3] = _rounded(vectors * np.float32(most), -most, most, kind)
    return out


def _quaternion(data: NDArray[np.uint8], stride: int) -> NDArray[Any]:
    """Unit quaternions from three components; the greatest follows, its place is in the lowest bits of the scale."""
    stored = data.view("<i2").reshape(-1, 4)
    one = (stored[:, 3:] | 3).astype(np.float32)
    three = stored[:, :3] / one * np.float32(np.sqrt(0.5))
    greatest = np.sqrt(np.maximum(np.float32(1) - np.sum(three * three, axis=1, keepdims=True), np.float32(0)))
    turned = _rounded(np.concatenate([greatest, three], axis=1) * np.float32(32767), -32767, 32767, "<i2")
    out = np.empty_like(stored)
    places = ((stored[:, 3:] & 3) + np.arange(4)) % 4
    np.put_along_axis(out, places.astype(np.intp), turned, axis=1)
    return out


def _exponential(data: NDArray[np.uint8], stride: int) -> NDArray[Any]:
    """float32 from 24 bits of mantissa and 8 bits of exponent."""
    stored = data.view("<i4")
    with np.errstate(over="ignore", under="ignore"):  # exponents beyond 100 are not valid, and refused as not finite
        return np.ldexp(((stored << 8) >> 8).astype(np.float32), stored >> 24).astype("<f4")


def _color(data: NDArray[np.uint8], stride: int) -> NDArray[Any]:
    """RGBA from luma and two chromas; the highest bit of the last component tells the scale."""
    unsigned, signed, most = ("u1", "i1", 255) if stride == 4 else ("<u2", "<i2", 65535)
    luma = data.view(unsigned).reshape(-1, 4)[:, 0].astype(np.int32)
    orange, green = data.view(signed).reshape(-1, 4)[:, 1:3].astype(np.int32).T
    last = data.view(unsigned).reshape(-1, 4)[:, 3].astype(np.int32)
    scale = (1 << np.frexp(np.maximum(last, 1).astype(np.float32))[1].astype(np.int32)) - 1
    alpha = last & (scale >> 1)
    alpha = (alpha << 1) | (alpha & 1)
    colors = np.stack([luma + orange - green, luma + green, luma - orange - green, alpha], axis=1)
    return _rounded(colors * (np.float32(most) / scale.astype(np.float32))[:, None], 0, most, unsigned)


_FILTERS = {
    "OCTAHEDRAL": _octahedral,
    "QUATERNION": _quaternion,
    "EXPONENTIAL": _exponential,
    "COLOR": _color,
}
