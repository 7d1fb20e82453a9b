"""meshoptimizer's streams and filters: against streams written by its encoder once and now, and against the specification."""

from __future__ import annotations

import base64
import ctypes
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from keypose.errors import FormatError
from keypose.io.gltf import read
from keypose.io.gltf.items import Compressed
from keypose.io.gltf.meshopt import unpack_meshopt
from tests.conftest import data_files
from tests.io.gltf_files import GltfFile

PLACE = "bufferViews[7]"


def unpack(source: bytes, stride: int, count: int, mode: str = "ATTRIBUTES", filter: str = "NONE") -> bytes:
    return unpack_meshopt(Compressed(0, 0, len(source), stride, count, mode, filter), source, PLACE)


def bytes_of(array: Any) -> Any:
    """(count, stride) uint8"""
    array = np.ascontiguousarray(array)
    return array.reshape(len(array), -1).view(np.uint8)


def turned(indices: Any) -> list[list[int]]:
    """Triangles with the smallest turn first: the codec may turn the corners round."""
    return [min(t[k:] + t[:k] for k in range(3)) for t in np.asarray(indices).reshape(-1, 3).tolist()]


# --- streams that the encoder wrote once -----------------------------------------------------------------------------


def noise(count: int) -> Any:
    numbers, state = [], 1
    for _ in range(count):
        state = (state * 1103515245 + 12345) % 2**31
        numbers.append(state >> 16 & 255)
    return np.array(numbers, np.uint8)


def mixed_bytes(count: int) -> Any:
    """A column for every bit width: nothing, small steps, jumps, noise."""
    k = np.arange(count)
    columns = [0 * k, k // 9, k * (k % 5 == 0), k * 3, 7 * (k == 33), -2 * k, k * (k % 7 < 2), noise(count)]
    return (np.stack(columns, axis=1) & 255).astype(np.uint8)


def mixed_channels(count: int) -> Any:
    """16-bit ramps, words of which only four bits across a byte's edge change, and bytes: every mode of version 1."""
    k = np.arange(count)
    ramps = np.stack([k * 300, 1000 - k * (k % 3) * 40], axis=1).astype("<i2")
    words = ((noise(count) & 15).astype("<u4") << 13) | 0x40000000
    steps = np.stack([k // 16, (k % 40 == 0) * 200, 0 * k, k % 16 // 15], axis=1)
    return np.concatenate([bytes_of(ramps), bytes_of(words), steps.astype(np.uint8)], axis=1)


def slow_bytes(count: int) -> Any:
    k = np.arange(count)
    return np.stack([k // 9, k // 50, 0 * k, 0 * k + 7], axis=1).astype(np.uint8)


MIXED_0 = (
    "oAAVAAAgAAgAAgAAgAAAFQA8DwMKCRQTHsDwPA8dKCcyMTw7A8DAAEZFUCoGZmZmZmZmZmZmZmZmZmZmZmZmZmAAAAAQPAAAAA4NKgMz"
    "MzMzMzMzMzMzMzMzMzMzMzMzMAAAABUkA7AODg8cwDsA7B0qKzg5A7AAAEZHHwCPBis/nzEysrtxRMW/dbP0g+Sl8DjFcEABQluiQ5c6"
    "///AAN3YhdCumThuyAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAADG"
)
SLOW_0 = (
    "oFVVVVUAACAACAACAACAACAACAACAACAACAACAACAACAACAACAACAACAACAACAACAACAACAACAACAACAACAACAACAACAQBAEQQgAAAAA"
    "gAAAAAgAAAAAgAAAAAgAAAAAAAAAAAABACAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAH"
)
BYTES_1 = (
    "oVZVAAACAgQIAgIQAAIAYIwKCRQTHjHGHSgnMjE8OxgBRkVQKgZmZmZmZmZmZmZmZmZmZmZmZmZmYAAAAAAAAAAABgAODSoDMzMzMzMz"
    "MzMzMzMzMzMzMzMzMzAAAAAFJAOwDg4PHMA7AOwdKis4OTgARgJHDwCPBis/nzEysrtxRMW/dbP0g+Sl8DjFcEABQluiQ5c6/wHd2IXQ"
    "rpk4bsgAAAAAAAAAAAAAAAAAAAAAAAAAAADGAAA="
)
MIXED_1 = (
    "oXeaYABYWFhYWFhYWFhYWFhYWFhYWFhYWFhYWFhYWFhYWFhYWFhYWFhYWFhYFSqqqqqqqqqqqqqAAABP70A/3yAvzwAfv+APr8D/n6Dv"
    "j4Dff2DPb0C/XyCvTwCfP+CPL8B/KgABETIlM2RIRaVsZ+ePifkQEq+r+8/AAAAAFBUXKgj6AJnysjDWDw9u74TYAR4yRQ88WJdJQAAA"
    "ABQBAAIBAAIRAgBwAAFvAACAAgGAAQIBAAEAAAAAAAAAAAAAAOgDAMAAQADIAAABMgA="
)
SLOW_1 = (
    "oaEAAAAAAAICBAgCAhAgAgJAgAICAAECAgQCAggQAgIgQAICgAACAQICAgQIAgIQIAICQIACAgABAgIEAgIIEAICQBAEQQQAAhAAAkAA"
    "AgABAgAEAqkAIAACAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAcA"
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (MIXED_0, mixed_bytes(41)),
        (SLOW_0, slow_bytes(270)),
        (BYTES_1, mixed_bytes(41)),
        (MIXED_1, mixed_channels(41)),
        (SLOW_1, slow_bytes(270)),
    ],
    ids=["version 0", "version 0, two blocks", "version 1, bytes", "version 1, channels", "version 1, two blocks"],
)
def test_recorded_attributes(text: str, expected: Any) -> None:
    count, stride = expected.shape
    assert unpack(base64.b64decode(text), stride, count) == expected.tobytes()


TRIANGLES = (
    "4fAQEAAQABAAwBAWABUAFADAEBQAFAAUAPAgH/wPHQ8f/x7//hD/////BsABBOhr/99sQQD/Ao7+CpX+CgD/KgMC9gICnwIC/8bPrPMO"
    "9c+s8w4YAHaHVmd4qYZliWiYAWkAAA=="
)
SHEET = """
    0 1 2  2 1 3  1 4 3  3 4 5  4 6 5  5 6 7  6 8 7  7 8 9  2 3 10  10 3 11  3 5 11  11 5 12  5 7 12  12 7 13  7 9 13
    13 9 14  10 11 15  15 11 16  11 12 16  16 12 17  12 13 17  17 13 18  13 14 18  18 14 19  20 21 22  21 20 23  23 20 3
    3 24 25  24 3 99  99 3 98  99 98 100  100 98 7000  40 7 7  7 7 8  9 90000 5  0 1 2  2 1 3  26 24 25  26 27 1
    28 0 29  2000000000 5 17
"""
SEQUENCE = "0QAEBAQEwYsRBAUEBQoCAgK59O7/DyQAAAAA"
STRIP = [0, 1, 2, 3, 4, 70000, 5, 70001, 6, 70002, 3, 2, 1, 0, 2**30, 9]


def test_recorded_triangles() -> None:
    """A sheet in first-use order, then corners old, new, near the last one, far away, and a restart."""
    expected = np.array(SHEET.split(), np.int64)
    source = base64.b64decode(TRIANGLES)
    whole = np.frombuffer(unpack(source, 4, expected.size, "TRIANGLES"), "<u4")
    assert turned(whole) == turned(expected)
    short = np.frombuffer(unpack(source, 2, expected.size, "TRIANGLES"), "<u2")
    np.testing.assert_array_equal(short, whole & 0xFFFF)


def test_recorded_sequence() -> None:
    source = base64.b64decode(SEQUENCE)
    assert np.frombuffer(unpack(source, 4, len(STRIP), "INDICES"), "<u4").tolist() == STRIP
    short = np.frombuffer(unpack(source, 2, len(STRIP), "INDICES"), "<u2").tolist()
    assert short == [index & 0xFFFF for index in STRIP]


# --- streams of the specification ------------------------------------------------------------------------------------


def attributes_0(columns: list[bytes], stride: int = 4, baseline: bytes = b"") -> bytes:
    return b"\xa0" + b"".join(columns) + bytes(32 - stride) + baseline.ljust(stride, b"\0")


def test_the_deltas_of_the_specification() -> None:
    example = bytes.fromhex("175ff0bc77a9210034b5")
    source = attributes_0([b"\x02" + example, b"\0", b"\0", b"\0"], baseline=b"\x05\x06\x07\x08")
    values = np.frombuffer(unpack(source, 4, 16), np.uint8).reshape(16, 4)
    deltas = [-1, -4, -3, 26, -91, 0, -6, 6, -4, -4, 5, -5, 1, -1, 0, 0]
    np.testing.assert_array_equal(values[:, 0], (5 + np.cumsum(deltas)) & 255)
    assert (values[:, 1:] == (6, 7, 8)).all()


def test_numbers_and_their_two_baselines() -> None:
    # 127, 513 (0x81 0x04 in the specification), 4, 86143 and 2: bit 0 chooses the baseline, the rest zigzags.
    source = b"\xd1" + bytes.fromhex("7f 8104 04 ffa005 02") + bytes(4)
    values = np.frombuffer(unpack(source, 4, 5, "INDICES"), "<i4")
    assert values.tolist() == [-32, -32 + 128, 1, 96 - 21536, 1 - 1]


def test_triangles_by_hand() -> None:
    """One of new corners, then an edge and: a new corner, one far away, its two neighbours, an old corner."""
    codes, far = bytes([0xF0, 0x00, 0x2F, 0x0E, 0x1D, 0x13]), b"\x14"
    source = b"\xe1" + codes + far + bytes(16)
    values = np.frombuffer(unpack(source, 4, 18, "TRIANGLES"), "<u4").reshape(-1, 3)
    assert values.tolist() == [[0, 1, 2], [0, 2, 3], [0, 2, 10], [0, 10, 11], [11, 10, 10], [10, 10, 3]]
    # Fifteen new corners, then an edge and the oldest corner that a code can name.
    source = b"\xe1" + b"\xf0" * 5 + b"\x0c" + bytes(16)
    assert np.frombuffer(unpack(source, 4, 18, "TRIANGLES"), "<u4")[-3:].tolist() == [12, 14, 2]


@pytest.mark.parametrize("mode", ["ATTRIBUTES", "TRIANGLES", "INDICES"])
def test_nothing_is_packed(mode: str) -> None:
    assert unpack(b"\xa0", 4, 0, mode) == b""


# --- filters ---------------------------------------------------------------------------------------------------------


def packed_plainly(array: Any) -> bytes:
    """A version-0 stream in which every delta is a whole byte."""
    data = bytes_of(array)
    count, stride = data.shape
    block = min((8192 // stride) & ~15, 256)
    deltas = np.diff(data, axis=0, prepend=np.zeros((1, stride), np.uint8))
    codes = np.where(deltas & 128, ~(deltas << 1), deltas << 1).astype(np.uint8)
    columns = []
    for first in range(0, count, block):
        part = codes[first : first + block]
        groups = -(-len(part) // 16)
        part = np.pad(part, ((0, groups * 16 - len(part)), (0, 0)))
        header = b"\xff" * -(-groups // 4)
        columns += [header + part[:, k].tobytes() for k in range(stride)]
    return attributes_0(columns, stride) if stride < 32 else b"\xa0" + b"".join(columns) + bytes(stride)


@pytest.mark.parametrize("stride", [4, 8, 32, 36, 64, 252, 256])
@pytest.mark.parametrize("count", [1, 17, 300])
def test_plain_bytes(stride: int, count: int) -> None:
    data = np.random.default_rng(count).integers(0, 256, (count, stride), dtype=np.uint8)
    assert unpack(packed_plainly(data), stride, count) == data.tobytes()


def directions(count: int) -> Any:
    """Unit vectors; the first ones point along the axes and diagonals, where the octahedron folds."""
    corners = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    corners = corners[np.any(corners, axis=1)]
    vectors = np.concatenate([corners, np.random.default_rng(0).normal(size=(count, 3))])
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize(("stride", "bits"), [(4, 4), (4, 7), (4, 8), (8, 4), (8, 10), (8, 15), (8, 16)])
def test_octahedral_filter(stride: int, bits: int) -> None:
    vectors = directions(500)
    kind, most = ("i1", 127) if stride == 4 else ("<i2", 32767)
    one = (1 << (bits - 1)) - 1
    flat = vectors / np.abs(vectors).sum(axis=1, keepdims=True)
    signs = np.where(vectors[:, :2] >= 0, 1, -1)
    folded = np.where(flat[:, 2:] >= 0, flat[:, :2], (1 - np.abs(flat[:, 1::-1])) * signs)
    stored = np.empty((len(vectors), 4), kind)
    stored[:, :2], stored[:, 2] = np.round(folded * one), one
    stored[:, 3] = np.arange(len(vectors)) % 128
    out = np.frombuffer(unpack(packed_plainly(stored), stride, len(stored), filter="OCTAHEDRAL"), kind).reshape(-1, 4)
    np.testing.assert_allclose(out[:, :3] / most, vectors, atol=2 / one + 1 / most)
    np.testing.assert_allclose(np.linalg.norm(out[:, :3] / most, axis=1), 1, atol=1.0 / most)
    np.testing.assert_array_equal(out[:, 3], stored[:, 3])


@pytest.mark.parametrize("bits", [4, 8, 12, 16])
def test_quaternion_filter(bits: int) -> None:
    rotations = np.random.default_rng(1).normal(size=(500, 4))
    rotations[:4] = np.eye(4)
    rotations[4] = 0.5
    rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
    one = (1 << (bits - 1)) - 1
    largest, rows = np.argmax(np.abs(rotations), axis=1), np.arange(len(rotations))
    signed = rotations * np.where(rotations[rows, largest] < 0, -1, 1)[:, None]
    stored = np.empty((len(rotations), 4), "<i2")
    stored[:, :3] = np.round(signed[rows[:, None], (largest[:, None] + [1, 2, 3]) % 4] * np.sqrt(2) * one)
    stored[:, 3] = (one & ~3) | largest
    out = np.frombuffer(unpack(packed_plainly(stored), 8, len(stored), filter="QUATERNION"), "<i2").reshape(-1, 4)
    np.testing.assert_allclose(out / 32767, signed, atol=2 / one + 1 / 32767)
    assert (out[rows, largest] > 0).all()


@pytest.mark.parametrize("stride", [4, 12, 64])
def test_exponential_filter(stride: int) -> None:
    rng = np.random.default_rng(2)
    mantissa = rng.integers(-(2**23), 2**23, (100, stride // 4))
    exponent = rng.integers(-100, 101, mantissa.shape)
    mantissa[0], mantissa[1], exponent[1] = 0, -(2**23), 100
    stored = ((exponent << 24) | (mantissa & 0xFFFFFF)).astype("<i4")
    out = np.frombuffer(unpack(packed_plainly(stored), stride, 100, filter="EXPONENTIAL"), "<f4")
    np.testing.assert_array_equal(out.reshape(mantissa.shape).astype(float), mantissa * 2.0**exponent)


@pytest.mark.parametrize(("stride", "bits"), [(4, 4), (4, 8), (8, 8), (8, 12), (8, 16)])
def test_color_filter(stride: int, bits: int) -> None:
    unsigned, most = ("u1", 255) if stride == 4 else ("<u2", 65535)
    colors = np.random.default_rng(3).random((300, 4))
    colors[:16] = np.stack(np.meshgrid(*[[0.0, 1.0]] * 4), axis=-1).reshape(-1, 4)
    one = (1 << bits) - 1
    red, green, blue = np.round(colors[:, :3] * one).astype(int).T
    orange = (red - blue) // 2
    middle = blue + orange
    chroma = (green - middle) // 2
    alpha = np.round(colors[:, 3] * (one >> 1)).astype(int) | (1 << (bits - 1))
    stored = np.stack([middle + chroma, orange, chroma, alpha], axis=1).astype(f"<i{stride // 4}").view(unsigned)
    out = np.frombuffer(unpack(packed_plainly(stored), stride, 300, filter="COLOR"), unsigned).reshape(-1, 4)
    np.testing.assert_allclose(out / most, colors, atol=3 / one)
    np.testing.assert_array_equal(out[:16, 3], colors[:16, 3] * most)


@pytest.mark.parametrize(
    ("filter", "stride"), [("OCTAHEDRAL", 4), ("OCTAHEDRAL", 8), ("QUATERNION", 8), ("COLOR", 4), ("COLOR", 8)]
)
@pytest.mark.filterwarnings("error")
def test_filters_take_any_bytes(filter: str, stride: int) -> None:
    data = np.random.default_rng(4).integers(0, 256, (5000, stride), dtype=np.uint8)
    data[:500] = 0
    assert len(unpack(packed_plainly(data), stride, 5000, filter=filter)) == data.size


@pytest.mark.parametrize("extension", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
def test_a_whole_file(extension: str, tmp_path: Path) -> None:
    """Positions and colours through filters, and indices, under either name and with no data but the packed."""
    shades = np.array([[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 0], [1, 1, 1, 1]])
    stored = np.array([[63, 127, -64, 255], [127, 0, 127, 255], [64, -128, -63, 128], [255, 0, 0, 255]])
    positions = np.array([[0, 0, 0], [3, 0, 0], [3, -2, 0], [0, -2, 0]])
    exponents = ((-1 & 0xFF) << 24) | (2 * positions & 0xFFFFFF)
    file = GltfFile()
    primitive = file.triangle()
    file.json["buffers"].append({"byteLength": 4096, "extensions": {extension: {"fallback": True}}})
    file.json["extensionsUsed"] = file.json["extensionsRequired"] = [extension]

    def accessor(source: bytes, stride: int, mode: str, filter: str, count: int, **more: Any) -> int:
        view = file.json["bufferViews"][file.view(source)]
        packed = {**view, "byteStride": stride, "count": count, "mode": mode, "filter": filter}
        view |= {"buffer": 1, "byteOffset": 0, "byteLength": count * stride, "extensions": {extension: packed}}
        file.json["accessors"].append({"bufferView": len(file.json["bufferViews"]) - 1, "count": count, **more})
        return len(file.json["accessors"]) - 1

    packed = packed_plainly(exponents.astype("<u4"))
    place = accessor(packed, 12, "ATTRIBUTES", "EXPONENTIAL", 4, componentType=5126, type="VEC3")
    packed = packed_plainly(stored.astype("u1"))
    color = accessor(packed, 4, "ATTRIBUTES", "COLOR", 4, componentType=5121, type="VEC4", normalized=True)
    primitive["attributes"] = {"POSITION": place, "COLOR_0": color}
    triangles = b"\xe1\xf0\x00" + bytes(16)
    primitive["indices"] = accessor(triangles, 2, "TRIANGLES", "NONE", 6, componentType=5123, type="SCALAR")
    mesh = read(file.save(tmp_path)).character.parts[0].mesh
    np.testing.assert_array_equal(mesh.positions, positions)
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.colors is not None
    np.testing.assert_allclose(mesh.colors, shades, atol=2.01 / 255)


# --- damage ----------------------------------------------------------------------------------------------------------

STREAMS: dict[str, tuple[bytes, int, int, str]] = {
    "mixed 0": (base64.b64decode(MIXED_0), 8, 41, "ATTRIBUTES"),
    "slow 0": (base64.b64decode(SLOW_0), 4, 270, "ATTRIBUTES"),
    "bytes 1": (base64.b64decode(BYTES_1), 8, 41, "ATTRIBUTES"),
    "mixed 1": (base64.b64decode(MIXED_1), 12, 41, "ATTRIBUTES"),
    "slow 1": (base64.b64decode(SLOW_1), 4, 270, "ATTRIBUTES"),
    "triangles": (base64.b64decode(TRIANGLES), 4, 123, "TRIANGLES"),
    "sequence": (base64.b64decode(SEQUENCE), 4, len(STRIP), "INDICES"),
}


@pytest.mark.parametrize("name", STREAMS)
def test_every_cut_is_noticed(name: str) -> None:
    source, stride, count, mode = STREAMS[name]
    for size in range(len(source)):
        with pytest.raises(FormatError) as caught:
            unpack(source[:size], stride, count, mode)
        assert str(caught.value).startswith(f"{PLACE}: ")
    with pytest.raises(FormatError):
        unpack(source[:40] + b"\0" + source[40:] if len(source) > 60 else source + b"\0", stride, count, mode)


def mutated(source: bytes, rng: np.random.Generator) -> bytes:
    data = bytearray(source)
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(len(data)))
        choice = rng.integers(5)
        if choice == 0:
            data[at:] = b""
        elif choice == 1:
            data[at:at] = rng.integers(0, 256, int(rng.integers(1, 20)), dtype=np.uint8).tobytes()
        elif choice == 2:
            data[at] = (0, 255, 128, 127)[int(rng.integers(4))]
        else:
            data[at] = int(rng.integers(256))
        data = data or bytearray(b"\0")
    return bytes(data)


@pytest.mark.parametrize("name", STREAMS)
def test_damaged_streams(name: str) -> None:
    source, stride, count, mode = STREAMS[name]
    rng = np.random.default_rng(len(name))
    refused = 0
    tracemalloc.start()
    try:
        for _ in range(500):
            claimed = count if rng.random() < 0.7 else int(2 ** (rng.random() * 60)) // 3 * 3
            try:
                assert len(unpack(mutated(source, rng), stride, claimed, mode)) == claimed * stride
            except FormatError as error:
                assert str(error).startswith(f"{PLACE}: ")
                refused += 1
        assert tracemalloc.get_traced_memory()[1] < 8 << 20
    finally:
        tracemalloc.stop()
    assert refused > 250


@pytest.mark.parametrize(
    ("source", "stride", "count", "mode", "filter", "message"),
    [
        (b"", 4, 1, "ATTRIBUTES", "NONE", "the compressed data is empty"),
        (b"\xa2" + bytes(60), 4, 1, "ATTRIBUTES", "NONE", "begin with 0xa0 or 0xa1, got 0xa2"),
        (b"\xe0" + bytes(60), 4, 3, "TRIANGLES", "NONE", "begin with 0xe1, got 0xe0"),
        (b"\xd0" + bytes(60), 4, 3, "INDICES", "NONE", "begin with 0xd1, got 0xd0"),
        (b"\xa0" + bytes(36), 6, 1, "ATTRIBUTES", "NONE", "a multiple of 4; got 6"),
        (b"\xa0" + bytes(36), 260, 1, "ATTRIBUTES", "NONE", "4 to 256 bytes, .* got 260"),
        (b"\xa0" + bytes(35), 4, 1, "ATTRIBUTES", "NONE", "at least 37 compressed bytes; there are 36"),
        (b"\xa0" + bytes(36), 4, 2**50, "ATTRIBUTES", "NONE", "compressed bytes; there are 37"),
        (b"\xa0" + bytes(37), 4, 1, "ATTRIBUTES", "NONE", r"goes on after its last element \(byte 5\)"),
        (b"\xa0" + b"\3" + bytes(35), 4, 1, "ATTRIBUTES", "NONE", r"ends too early \(byte 2\)"),
        (b"\xa0\1" + b"\xff" * 4 + bytes(32), 4, 1, "ATTRIBUTES", "NONE", r"ends too early \(byte 6\)"),
        (b"\xa1" + bytes(28) + b"\3", 4, 1, "ATTRIBUTES", "NONE", "unknown mode 0x03 of the bytes 0 to 3"),
        (b"\xa1" + bytes(28) + b"\x11", 4, 1, "ATTRIBUTES", "NONE", "unknown mode 0x11"),
        (b"\xa0" + bytes(36), 12, 1, "ATTRIBUTES", "OCTAHEDRAL", "octahedral filter needs a stride of 4 or 8, got 12"),
        (b"\xa0" + bytes(36), 4, 1, "ATTRIBUTES", "QUATERNION", "quaternion filter needs a stride of 8, got 4"),
        (b"\xe1" + bytes(60), 4, 3, "TRIANGLES", "OCTAHEDRAL", "filter is for attributes"),
        (b"\xe1" + bytes(60), 4, 4, "TRIANGLES", "NONE", "4 indices are no triangles"),
        (b"\xe1" + bytes(60), 8, 3, "TRIANGLES", "NONE", "expected indices of 2 or 4 bytes, got 8"),
        (b"\xe1\xf0" + bytes(15) + b"\1", 4, 3, "TRIANGLES", "NONE", "the table .* is damaged"),
        (b"\xe1\xf0\xf0" + bytes(15), 4, 3, "TRIANGLES", "NONE", "the table .* is damaged"),
        (b"\xe1\xf0" + bytes(17), 4, 3, "TRIANGLES", "NONE", r"goes on after its last element \(byte 2\)"),
        (b"\xe1\x00" + bytes(16), 4, 3, "TRIANGLES", "NONE", r"an earlier one that does not exist \(byte 1\)"),
        (b"\xe1\xf0\x30" + bytes(16), 4, 6, "TRIANGLES", "NONE", r"an earlier one that does not exist \(byte 2\)"),
        (b"\xe1\xf0\x03" + bytes(16), 4, 6, "TRIANGLES", "NONE", r"an earlier one that does not exist \(byte 2\)"),
        (b"\xe1\xfe\x01" + bytes(16), 4, 3, "TRIANGLES", "NONE", r"an earlier one that does not exist \(byte 1\)"),
        (b"\xe1\xff\x11" + b"\x80" * 5 + b"\0" + bytes(16), 4, 3, "TRIANGLES", "NONE", "more than five bytes"),
        (b"\xd1" + b"\x80" * 5 + b"\0" + bytes(4), 4, 1, "INDICES", "NONE", r"more than five bytes \(byte 1\)"),
        (b"\xd1\x80" + bytes(4), 4, 1, "INDICES", "NONE", r"ends too early \(byte 1\)"),
        (b"\xd1\0\0" + bytes(4), 4, 1, "INDICES", "NONE", r"goes on after its last element \(byte 2\)"),
        (b"\xd1" + bytes(60), 4, 2**40, "INDICES", "NONE", "compressed bytes; there are 61"),
    ],
)
def test_refused(source: bytes, stride: int, count: int, mode: str, filter: str, message: str) -> None:
    with pytest.raises(FormatError, match=rf"^bufferViews\[7\]: .*{message}"):
        unpack(source, stride, count, mode, filter)


# --- beside the encoder and decoder of meshoptimizer -----------------------------------------------------------------


@pytest.fixture
def meshopt() -> Any:
    return pytest.importorskip("meshoptimizer", reason="meshoptimizer, to compare with, is not installed")


Encoder = Callable[..., bytes]


@pytest.fixture
def encode(meshopt: Any) -> Encoder:
    """encode(array, version, level): level 3 also tries exclusive or, which the Python package has no function for."""
    library = meshopt.encoder.lib

    def run(array: Any, version: int, level: int = 2) -> bytes:
        data = bytes_of(array)
        count, stride = data.shape
        meshopt.encode_vertex_version(version)
        out = np.zeros(library.meshopt_encodeVertexBufferBound(count, stride), np.uint8)
        function = library.meshopt_encodeVertexBufferLevel
        function.restype = ctypes.c_size_t
        function.argtypes = [ctypes.c_void_p, ctypes.c_size_t] * 2 + [ctypes.c_size_t, ctypes.c_int, ctypes.c_int]
        size = function(out.ctypes.data, out.size, data.ctypes.data, count, stride, level, version)
        assert size
        return out[:size].tobytes()

    return run


def attribute_data(kind: str, count: int, stride: int, rng: np.random.Generator) -> Any:
    if kind == "noise":
        return rng.integers(0, 256, (count, stride), dtype=np.uint8)
    if kind == "steps":
        return np.cumsum(rng.integers(-1, 2, (count, stride)), axis=0).astype(np.uint8)
    if kind == "sparse":
        return ((rng.random((count, stride)) < 0.03) * 9).astype(np.uint8)
    if kind == "shorts":
        return bytes_of(np.cumsum(rng.integers(-300, 300, (count, stride // 2)), axis=0).astype("<i2"))
    if kind == "floats":
        return bytes_of(np.cumsum(rng.normal(0, 0.01, (count, stride // 4)), axis=0).astype("<f4"))
    return bytes_of((rng.integers(0, 16, (count, stride // 4)) << rng.integers(0, 28, stride // 4)).astype("<u4"))


@pytest.mark.parametrize("kind", ["noise", "steps", "sparse", "shorts", "floats", "bits"])
@pytest.mark.parametrize(("version", "level"), [(0, 2), (1, 0), (1, 2), (1, 3)])
def test_any_stride_and_count(encode: Encoder, kind: str, version: int, level: int) -> None:
    rng = np.random.default_rng(5)
    for stride in range(4, 257, 4):
        block = min((8192 // stride) & ~15, 256)
        for count in (1, 15, 16, 17, block - 1, block, block + 1, 2 * block + 37):
            data = attribute_data(kind, count, stride, rng)
            assert unpack(encode(data, version, level), stride, count) == data.tobytes(), (stride, count)


def index_data(kind: str, triangles: int, rng: np.random.Generator) -> Any:
    if kind == "near":
        return np.abs(np.cumsum(rng.integers(-3, 4, triangles * 3))).astype(np.uint32)
    if kind == "strip":
        return (np.arange(triangles)[:, None] + [0, 1, 2]).ravel().astype(np.uint32)
    return rng.integers(0, {"few": 12, "many": 300, "huge": 2**30}[kind], triangles * 3).astype(np.uint32)


@pytest.mark.parametrize("kind", ["near", "strip", "few", "many", "huge"])
def test_any_indices(meshopt: Any, kind: str) -> None:
    rng = np.random.default_rng(6)
    meshopt.encode_index_version(1)
    for triangles in (1, 2, 3, 15, 16, 17, 200, 1001):
        indices = index_data(kind, triangles, rng)
        packed = meshopt.encode_index_buffer(indices)
        ours = np.frombuffer(unpack(packed, 4, indices.size, "TRIANGLES"), "<u4")
        np.testing.assert_array_equal(ours, meshopt.decode_index_buffer(indices.size, 4, packed))
        assert turned(ours) == turned(indices)
        for size in (indices.size, indices.size - 2):
            packed = meshopt.encode_index_sequence(indices[:size])
            np.testing.assert_array_equal(np.frombuffer(unpack(packed, 4, size, "INDICES"), "<u4"), indices[:size])


@pytest.mark.parametrize(
    ("filter", "function", "kind", "stride"),
    [
        ("OCTAHEDRAL", "decode_filter_oct", "i1", 4),
        ("OCTAHEDRAL", "decode_filter_oct", "<i2", 8),
        ("QUATERNION", "decode_filter_quat", "<i2", 8),
        ("EXPONENTIAL", "decode_filter_exp", "<f4", 12),
    ],
)
def test_filters_beside_the_library(meshopt: Any, filter: str, function: str, kind: str, stride: int) -> None:
    rng = np.random.default_rng(7)
    for bits in range(4, (8 if stride == 4 else 16) + 1):
        one = (1 << (bits - 1)) - 1
        if filter == "EXPONENTIAL":
            words = (rng.integers(-100, 101, (500, 3)) << 24) | rng.integers(0, 2**24, (500, 3))
            stored = words.astype(np.uint32)
        else:
            stored = rng.integers(-one, one + 1, (500, 4)).astype(kind)
            if filter == "OCTAHEDRAL":
                stored[:, 2] = one
            else:
                stored[:, :3] //= 2  # the three smaller components of a unit quaternion
                stored[:, 3] = (one & ~3) | rng.integers(0, 4, 500)
        raw = np.frombuffer(stored.tobytes(), np.uint8)
        theirs = np.frombuffer(getattr(meshopt, function)(raw.copy(), 500, stride).tobytes(), kind).astype(float)
        ours = np.frombuffer(unpack(packed_plainly(stored), stride, 500, filter=filter), kind).astype(float)
        if filter == "EXPONENTIAL":
            np.testing.assert_array_equal(ours, theirs)
        else:
            np.testing.assert_allclose(ours, theirs, atol=1)  # one unit in the last place is what the standard asks


def test_damage_is_refused_as_by_the_library(meshopt: Any) -> None:
    """What both accept is equal; what the library refuses is refused."""
    rng = np.random.default_rng(8)
    accepted = 0
    for name, (source, stride, count, mode) in STREAMS.items():
        for _ in range(300):
            damaged = mutated(source, rng)
            try:
                if mode == "ATTRIBUTES":
                    theirs = meshopt.decode_vertex_buffer(count, stride, damaged, np.dtype((np.void, stride))).tobytes()
                elif mode == "TRIANGLES":
                    theirs = meshopt.decode_index_buffer(count, 4, damaged).tobytes()
                else:
                    theirs = meshopt.decode_index_sequence(count, 4, damaged).tobytes()
            except RuntimeError:
                theirs = None
            try:
                ours = unpack(damaged, stride, count, mode)
            except FormatError:
                continue
            assert ours == theirs, name
            accepted += 1
    assert accepted > 300


@pytest.mark.data
@pytest.mark.parametrize("path", data_files("gltf/**/*.gl*"), ids=lambda path: path.name)
def test_real_meshes(meshopt: Any, encode: Encoder, path: Path) -> None:
    meshopt.encode_index_version(1)
    for part in read(path).character.parts:
        mesh = part.mesh
        arrays = [mesh.positions, mesh.normals, mesh.uvs]
        if part.skin is not None:
            arrays += [part.skin.weights.astype(np.float32), part.skin.joints.astype(np.uint32)]
            arrays += [np.round(part.skin.weights * 65535).astype("<u4")]
        for array in arrays:
            if array is not None and len(array):
                data = bytes_of(array)
                for version in (0, 1):
                    assert unpack(encode(data, version, 3), data.shape[1], len(data)) == data.tobytes()
        indices = mesh.triangles.astype(np.uint32).ravel()
        packed = meshopt.encode_index_buffer(indices)
        assert turned(np.frombuffer(unpack(packed, 4, indices.size, "TRIANGLES"), "<u4")) == turned(indices)
        packed = meshopt.encode_index_sequence(indices)
        np.testing.assert_array_equal(np.frombuffer(unpack(packed, 4, indices.size, "INDICES"), "<u4"), indices)
