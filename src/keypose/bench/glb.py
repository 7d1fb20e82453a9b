# pyright: basic
"""Loading GLB files, against the least that can be done: read the bytes and copy each array out of them."""

from __future__ import annotations

import atexit
import json
import shutil
import struct
import tempfile
from pathlib import Path

import numpy as np

from keypose.bench import data
from keypose.bench.suite import Suite
from keypose.model import (
    Channel,
    Character,
    Clip,
    Curve,
    CurveKind,
    Mesh,
    Part,
    Pose,
    Property,
    Scene,
    Skeleton,
    Skin,
)

_TYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_LARGE = "GLB load, 120,000 vertices, 67 joints x 3,600 frames"
_HUMAN = "GLB load, the built-in human and five clips"
_SMALL = "GLB load, 14 clips x 67 joints x 24 keys"


def add(suite: Suite) -> None:
    """A large file of few arrays, one of a thousand arrays, and one of small ones only."""
    import keypose.io
    from keypose.samples import load

    folder = Path(tempfile.mkdtemp(prefix="keypose-bench-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    scenes = {
        _LARGE: (_scene(120_000, 1, 3600), "aim: 0.5"),
        _HUMAN: (load("human"), ""),
        _SMALL: (_scene(1000, 14, 24), ""),
    }
    for number, (name, (scene, note)) in enumerate(scenes.items()):
        path = folder / f"{number}.glb"
        keypose.io.save(scene, path)
        part, copied = keypose.io.load(path).character.parts[0], plain(path)
        found = any(a.shape == part.mesh.positions.shape and np.array_equal(a, part.mesh.positions) for a in copied)
        suite.check(f"{name}: positions", 0.0 if found else np.inf, 0.0)
        # What was loaded is kept, as it is by whoever loads a file: both sides fill memory that is fresh, not their last result's.
        kept: list[object] = []
        suite.case(
            name,
            "ms",
            1,
            lambda path=path, kept=kept: kept.append(keypose.io.load(path)),
            lambda path=path, kept=kept: kept.append(plain(path)),
            against="bytes and copies",
            note=f"{len(copied):,} arrays, {path.stat().st_size / 1e6:.1f} MB{', ' if note else ''}{note}",
        )


def plain(path: Path) -> list[np.ndarray]:
    """The arrays of a GLB's accessors, sparse ones with their two arrays as they are; nothing is checked."""
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    document, base = json.loads(data[20 : 20 + size]), 28 + size
    views = document["bufferViews"]

    def copy(part: dict, count: int, width: int) -> np.ndarray:
        view, kind = views[part["bufferView"]], np.dtype(_TYPES[part["componentType"]])
        start = base + view.get("byteOffset", 0) + part.get("byteOffset", 0)
        strides = (view.get("byteStride", width * kind.itemsize), kind.itemsize)
        return np.ndarray((count, width), kind, data, start, strides).copy()

    arrays: list[np.ndarray] = []
    for accessor in document["accessors"]:
        count, width = accessor["count"], _WIDTHS[accessor["type"]]
        if "bufferView" in accessor:
            arrays.append(copy(accessor, count, width))
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            arrays.append(copy(sparse["indices"], sparse["count"], 1))
            arrays.append(
                copy({**sparse["values"], "componentType": accessor["componentType"]}, sparse["count"], width)
            )
    return arrays


def _scene(vertices: int, clips: int, frames: int) -> Scene:
    """A body with a skin, and clips that turn every joint."""
    rng = np.random.default_rng(6)
    parents, offsets = data.body()
    count = len(parents)
    rest = Pose(offsets.astype(np.float32), np.tile(np.eye(1, 4, dtype="f4"), (count, 1)), np.ones((count, 3), "f4"))
    skeleton = Skeleton(tuple(f"joint{i:02d}" for i in range(count)), parents, rest)
    cloud = data.cloud(parents, offsets, rng, vertices)
    triangles = rng.integers(0, vertices, (2 * vertices, 3))
    mesh = Mesh(cloud.positions, triangles, cloud.normals, rng.random((vertices, 2)).astype(np.float32))
    part = Part("body", mesh, skin=Skin(np.arange(count), cloud.joint_from_mesh, cloud.joints, cloud.weights))
    takes: list[Clip] = []
    for number in range(clips):
        times = np.arange(frames) / 60
        curves: dict[Channel, Curve] = {}
        for name in skeleton.names:
            turns = np.cumsum(rng.normal(0, 0.02, (frames, 4)), axis=0)
            turns[:, 0] += 1
            rotations = data.unit(turns).astype(np.float32)
            curves[Channel(name, Property.ROTATION)] = Curve(times, rotations, kind=CurveKind.ROTATION)
        takes.append(Clip(curves, f"take{number:02d}"))
    return Scene((Character(skeleton, (part,)),), tuple(takes))
