"""Files with meshes compressed by meshoptimizer and Draco, made here with their own encoders.

The streams themselves, without those libraries: `test_gltf_meshopt`.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from keypose.errors import FormatError, MissingExtra
from keypose.io.gltf import read
from keypose.model import Clip, Property
from tests.io.gltf_files import GltfFile

MESHOPT = "EXT_meshopt_compression"
DRACO = "KHR_draco_mesh_compression"


@pytest.fixture
def meshopt() -> Any:
    return pytest.importorskip("meshoptimizer", reason="meshoptimizer, whose encoder makes the files, is not installed")


@pytest.fixture
def draco() -> Any:
    return pytest.importorskip("DracoPy", reason="keypose[compression] is not installed")


def grid(side: int = 24) -> tuple[Any, Any]:
    """Vertices and triangles of a bent sheet."""
    x, y = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    positions = np.stack([x, y, np.sin(3 * x) * np.cos(2 * y)], axis=-1).reshape(-1, 3).astype(np.float32)
    i = np.arange(side * side).reshape(side, side)
    quads = np.stack([i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]], axis=-1).reshape(-1, 4)
    return positions, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.uint32)


def add_packed(file: GltfFile, packed: bytes, stride: int, count: int, mode: str, filter: str = "NONE") -> int:
    """A compressed buffer view whose plain form would lie in a fallback buffer (1) that has no data."""
    source = file.view(packed)
    raw = file.json["bufferViews"][source]
    file.json["buffers"][1:] = [{"byteLength": 1 << 20, "extensions": {MESHOPT: {"fallback": True}}}]
    extension = {"buffer": 0, "byteOffset": raw["byteOffset"], "byteLength": len(packed), "byteStride": stride}
    extension |= {"count": count, "mode": mode, "filter": filter}
    file.json["bufferViews"].append(
        {"buffer": 1, "byteOffset": 0, "byteLength": stride * count, "extensions": {MESHOPT: extension}}
        | ({"byteStride": stride} if mode == "ATTRIBUTES" else {})
    )
    file.json["extensionsUsed"] = file.json["extensionsRequired"] = [MESHOPT]
    return len(file.json["bufferViews"]) - 1


def add_accessor(file: GltfFile, view: int, component: int, count: int, kind: str, **more: Any) -> int:
    file.json["accessors"].append(
        {"bufferView": view, "componentType": component, "count": count, "type": kind, **more}
    )
    return len(file.json["accessors"]) - 1


@pytest.mark.parametrize("version", [0, 1])
@pytest.mark.parametrize("index_size", [2, 4])
def test_meshopt_attributes_and_triangles(meshopt: Any, version: int, index_size: int, tmp_path: Path) -> None:
    positions, triangles = grid()
    meshopt.encode_vertex_version(version)
    meshopt.encode_index_version(1)
    file = GltfFile()
    primitive = file.triangle()
    view = add_packed(file, meshopt.encode_vertex_buffer(positions), 12, len(positions), "ATTRIBUTES")
    primitive["attributes"] = {"POSITION": add_accessor(file, view, 5126, len(positions), "VEC3")}
    packed = meshopt.encode_index_buffer(triangles.ravel(), triangles.size, len(positions))
    view = add_packed(file, packed, index_size, triangles.size, "TRIANGLES")
    component = 5123 if index_size == 2 else 5125
    primitive["indices"] = add_accessor(file, view, component, triangles.size, "SCALAR")
    mesh = read(file.save(tmp_path)).character.parts[0].mesh
    np.testing.assert_array_equal(mesh.positions, positions)
    ours, theirs = (
        {tuple(np.roll(t, -int(np.argmin(t)))) for t in np.asarray(list_of).tolist()}
        for list_of in (mesh.triangles, triangles)
    )
    assert ours == theirs  # the codec may turn the corners of a triangle round


def test_meshopt_index_sequences(meshopt: Any, tmp_path: Path) -> None:
    strip = np.array([0, 1, 2, 3, 4], np.uint32)
    file = GltfFile()
    primitive = file.triangle()
    primitive["attributes"] = {"POSITION": file.floats(np.random.default_rng(0).normal(size=(5, 3)))}
    view = add_packed(file, meshopt.encode_index_sequence(strip, 5, 5), 4, 5, "INDICES")
    primitive |= {"mode": 5, "indices": add_accessor(file, view, 5125, 5, "SCALAR")}
    triangles = read(file.save(tmp_path)).character.parts[0].mesh.triangles
    assert triangles.tolist() == [[0, 1, 2], [1, 3, 2], [2, 3, 4]]


def test_meshopt_octahedral_normals(meshopt: Any, tmp_path: Path) -> None:
    positions, triangles = grid()
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(len(positions), 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # The encoding of the specification: project onto the octahedron, fold the lower half outwards, 8 bits.
    flat = normals / np.abs(normals).sum(axis=1, keepdims=True)
    folded = (1 - np.abs(flat[:, 1::-1])) * np.where(flat[:, :2] >= 0, 1, -1)
    u = np.where(flat[:, 2:] >= 0, flat[:, :2], folded)
    stored = np.zeros((len(positions), 4), np.int8)
    stored[:, :2], stored[:, 2] = np.round(u * 127), 127
    file = GltfFile()
    primitive = file.triangle()
    packed = meshopt.encode_vertex_buffer(stored.view(np.float32), len(stored), 4)
    view = add_packed(file, packed, 4, len(positions), "ATTRIBUTES", "OCTAHEDRAL")
    primitive["attributes"] = {
        "POSITION": file.floats(positions),
        "NORMAL": add_accessor(file, view, 5120, len(positions), "VEC3", normalized=True),
    }
    primitive["indices"] = file.accessor(triangles.reshape(-1, 1))
    file.json["extensionsUsed"] = file.json["extensionsRequired"] = [MESHOPT, "KHR_mesh_quantization"]
    mesh = read(file.save(tmp_path)).character.parts[0].mesh
    assert mesh.normals is not None
    np.testing.assert_allclose(mesh.normals, normals, atol=0.03)


def test_meshopt_quaternions(meshopt: Any, tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    rotations = rng.normal(size=(32, 4))
    rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
    # The encoding of the specification: the largest component is left out; the others times sqrt(2) in 12 bits.
    largest = np.argmax(np.abs(rotations), axis=1)
    rows = np.arange(32)
    signed = rotations * np.where(rotations[rows, largest] < 0, -1, 1)[:, None]
    others = (largest[:, None] + np.arange(1, 4)) % 4
    scale = 2047
    stored = np.zeros((32, 4), np.int16)
    stored[:, :3] = np.round(signed[rows[:, None], others] * np.sqrt(2) * scale)
    stored[:, 3] = (scale & ~3) | largest
    scaled = stored[:, 3] | 3
    assert np.all(scaled == scale)
    file = GltfFile()
    packed = meshopt.encode_vertex_buffer(stored.view(np.float32), 32, 8)
    view = add_packed(file, packed, 8, 32, "ATTRIBUTES", "QUATERNION")
    del file.json["bufferViews"][view]["byteStride"]
    animation = file.animate("rotation", np.arange(32), np.zeros((32, 4)))
    animation["samplers"][0]["output"] = add_accessor(file, view, 5122, 32, "VEC4", normalized=True)
    clip = read(file.save(tmp_path)).animations[0]
    assert isinstance(clip, Clip)
    values = clip.curve("root", Property.ROTATION).values[:, [1, 2, 3, 0]]
    signs = np.sign(np.sum(values * rotations, axis=1, keepdims=True))
    np.testing.assert_allclose(values * signs, rotations, atol=1e-3)


def test_meshopt_exponential_floats(meshopt: Any, tmp_path: Path) -> None:
    positions, triangles = grid()
    # The encoding of the specification: 24 bits of mantissa, 8 bits of exponent.
    exponent = np.full(positions.shape, -20, np.int32)
    mantissa = np.round(positions.astype(np.float64) * 2.0**20).astype(np.int32)
    stored = ((exponent & 0xFF) << 24) | (mantissa & 0xFFFFFF)
    file = GltfFile()
    primitive = file.triangle()
    packed = meshopt.encode_vertex_buffer(stored.astype(np.int32).view(np.float32), len(positions), 12)
    view = add_packed(file, packed, 12, len(positions), "ATTRIBUTES", "EXPONENTIAL")
    primitive["attributes"] = {"POSITION": add_accessor(file, view, 5126, len(positions), "VEC3")}
    primitive["indices"] = file.accessor(triangles.reshape(-1, 1))
    mesh = read(file.save(tmp_path)).character.parts[0].mesh
    np.testing.assert_allclose(mesh.positions, positions, atol=2**-20)


def packed_grid(meshopt: Any) -> GltfFile:
    positions, _ = grid()
    file = GltfFile()
    primitive = file.triangle()
    view = add_packed(file, meshopt.encode_vertex_buffer(positions), 12, len(positions), "ATTRIBUTES")
    primitive["attributes"] = {"POSITION": add_accessor(file, view, 5126, len(positions), "VEC3")}
    return file


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("count", 2**40, r"bufferViews\[\d+\]: .*elements"),
        ("byteLength", 3, r"bufferViews\[\d+\]: "),
        ("byteStride", 13, r"bufferViews\[\d+\]: "),
        ("mode", "MAGIC", r"unknown mode 'MAGIC'"),
        ("filter", "MAGIC", r"unknown filter 'MAGIC'"),
        ("filter", "OCTAHEDRAL", r"octahedral filter needs a stride"),
        ("mode", "TRIANGLES", r"expected indices of 2 or 4 bytes, got 12"),
    ],
)
def test_damaged_meshopt(meshopt: Any, key: str, value: Any, message: str, tmp_path: Path) -> None:
    file = packed_grid(meshopt)
    file.json["bufferViews"][-1]["extensions"][MESHOPT][key] = value
    with pytest.raises(FormatError, match=message):
        read(file.save(tmp_path))


def test_flipped_bytes_in_meshopt_data(meshopt: Any, tmp_path: Path) -> None:
    file = packed_grid(meshopt)
    view = file.json["bufferViews"][-1]["extensions"][MESHOPT]
    rng = np.random.default_rng(4)
    original = bytes(file.data)
    for _ in range(200):
        file.data[:] = original
        for at in rng.integers(view["byteOffset"], view["byteOffset"] + view["byteLength"], 3):
            file.data[at] = int(rng.integers(256))
        try:
            read(file.save(tmp_path))
        except FormatError as error:
            assert "accessors" in str(error) or "bufferViews" in str(error)


def hide(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ImportError):
        importlib.import_module(name)


def test_nothing_is_needed_to_unpack(meshopt: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = packed_grid(meshopt)
    hide(monkeypatch, "meshoptimizer")
    mesh = read(file.save(tmp_path)).character.parts[0].mesh
    np.testing.assert_array_equal(mesh.positions, grid()[0])


# --- Draco -----------------------------------------------------------------------------------------------------------


def draco_file(draco: Any, with_plain: bool = False) -> tuple[GltfFile, dict[str, Any]]:
    positions, triangles = grid()
    rng = np.random.default_rng(3)
    normals = np.tile([0.0, 0.0, 1.0], (len(positions), 1))
    joints = rng.integers(0, 2, (len(positions), 4)).astype(np.uint8)
    weights = np.tile(np.float32([0.5, 0.5, 0, 0]), (len(positions), 1))
    packed = draco.encode(
        positions.astype(np.float64),
        triangles,
        quantization_bits=16,
        preserve_order=True,
        normals=normals,
        generic_attributes={7: joints, 9: weights},
    )
    unique = {a["attribute_type"]: a["unique_id"] for a in draco.decode(packed).attributes if a["attribute_type"] < 4}
    file = GltfFile()
    primitive = file.triangle()
    count = len(positions)

    def shown(component: int, kind: str) -> int:
        file.json["accessors"].append({"componentType": component, "count": count, "type": kind})
        return len(file.json["accessors"]) - 1

    primitive["attributes"] = {
        "POSITION": file.floats(positions) if with_plain else shown(5126, "VEC3"),
        "NORMAL": file.floats(normals) if with_plain else shown(5126, "VEC3"),
        "JOINTS_0": file.accessor(joints) if with_plain else shown(5121, "VEC4"),
        "WEIGHTS_0": file.floats(weights) if with_plain else shown(5126, "VEC4"),
    }
    primitive["indices"] = (
        file.accessor(triangles.reshape(-1, 1))
        if with_plain
        else add_plain(file, {"componentType": 5125, "count": triangles.size, "type": "SCALAR"})
    )
    primitive["extensions"] = {
        DRACO: {
            "bufferView": file.view(packed),
            "attributes": {"POSITION": unique[0], "NORMAL": unique[1], "JOINTS_0": 7, "WEIGHTS_0": 9},
        }
    }
    file.json["nodes"] = [{"mesh": 0, "skin": 0}, {"name": "a", "children": [2]}, {"name": "b"}]
    file.json["scenes"] = [{"nodes": [0, 1]}]
    file.json["skins"] = [{"joints": [1, 2]}]
    file.json["extensionsUsed"] = [DRACO]
    if not with_plain:
        file.json["extensionsRequired"] = [DRACO]
    return file, {"positions": positions, "triangles": triangles, "joints": joints, "weights": weights}


def add_plain(file: GltfFile, accessor: dict[str, Any]) -> int:
    file.json["accessors"].append(accessor)
    return len(file.json["accessors"]) - 1


def test_draco(draco: Any, tmp_path: Path) -> None:
    file, expected = draco_file(draco)
    part = read(file.save(tmp_path)).character.parts[0]
    np.testing.assert_allclose(part.mesh.positions, expected["positions"], atol=5e-5)
    np.testing.assert_array_equal(part.mesh.triangles, expected["triangles"])
    assert part.mesh.normals is not None
    np.testing.assert_allclose(part.mesh.normals, np.tile([0, 0, 1], (len(part.mesh.positions), 1)), atol=1e-2)
    assert part.skin is not None
    np.testing.assert_array_equal(part.skin.joints, expected["joints"])
    np.testing.assert_array_equal(part.skin.weights, expected["weights"])


def test_without_draco(draco: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, _ = draco_file(draco)
    plain, expected = draco_file(draco, with_plain=True)
    hide(monkeypatch, "DracoPy")
    with pytest.raises(MissingExtra, match=r"Draco.*pip install 'keypose\[compression\]'"):
        read(file.save(tmp_path))
    mesh = read(plain.save(tmp_path)).character.parts[0].mesh
    np.testing.assert_array_equal(mesh.positions, expected["positions"])


def test_damaged_draco(draco: Any, tmp_path: Path) -> None:
    file, _ = draco_file(draco)
    view = file.json["bufferViews"][file.json["meshes"][0]["primitives"][0]["extensions"][DRACO]["bufferView"]]
    original, rng = bytes(file.data), np.random.default_rng(4)
    refused = 0
    for _ in range(200):
        file.data[:] = original
        for at in rng.integers(view["byteOffset"], view["byteOffset"] + view["byteLength"], 3):
            file.data[at] = int(rng.integers(256))
        try:
            read(file.save(tmp_path))
        except FormatError:
            refused += 1
    assert refused
    file.data[:] = original
    file.json["meshes"][0]["primitives"][0]["extensions"][DRACO]["attributes"]["NORMAL"] = 1234
    with pytest.raises(FormatError, match=r"attributes\.NORMAL: the Draco data has no attribute 1234"):
        read(file.save(tmp_path))
