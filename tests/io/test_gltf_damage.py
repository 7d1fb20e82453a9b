"""A thousand damaged glTF files: each is refused in one clear line or loads; none crashes, hangs or eats memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import ROOT, find_data_dir
from tests.io.damage import load_damaged
from tests.io.gltf_files import GltfFile

REAL = [
    "gltf/khronos/SimpleSkin.gltf",
    "gltf/tinygltf/singleBlendshapeCube_sparse.glb",
    "gltf/khronos/box_animated.gltf",
    "gltf/khronos/Fox.glb",
    "gltf/khronos/MorphStressTest.gltf",
    "gltf/cc0/greenman.glb",
    "vrm/human_bone.vrm",
    "vrm/debug_robot.vrm",
]


def everything(folder: Path) -> list[Path]:
    """Small files that together use every part of the format that the reader knows."""
    rng = np.random.default_rng(0)
    file = GltfFile()
    primitive = file.triangle()
    primitive["attributes"] |= {
        "TEXCOORD_0": file.accessor(np.full((3, 2), 7, np.uint16), normalized=True),
        "COLOR_0": file.accessor(np.full((3, 4), 7, np.uint8), normalized=True),
        "JOINTS_0": file.accessor(np.zeros((3, 4), np.uint8)),
        "WEIGHTS_0": file.floats([[1, 0, 0, 0]] * 3),
        "_CUSTOM": file.floats([[1], [2], [3]]),
    }
    primitive["indices"] = file.accessor(np.array([0, 1, 2], np.uint16))
    primitive["targets"] = [{"POSITION": file.floats(rng.normal(size=(3, 3)))} for _ in range(2)]
    file.json["accessors"][primitive["targets"][1]["POSITION"]]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": file.view(b"\1"), "componentType": 5121},
        "values": {"bufferView": file.view(np.ones(3, np.float32).tobytes())},
    }
    file.json["meshes"][0] |= {"weights": [0.5, 0], "extras": {"targetNames": ["a", "b"]}}
    file.json["skins"] = [{"joints": [1, 2], "inverseBindMatrices": file.floats(np.tile(np.eye(4).ravel(), (2, 1)))}]
    file.json["nodes"] = [
        {"mesh": 0, "skin": 0, "weights": [0, 1]},
        {"name": "hips", "children": [2], "matrix": np.eye(4).ravel().tolist()},
        {"name": "spine", "rotation": [0, 0, 0, 1], "scale": [1, 2, 1], "extras": {"keypose": {"end_site": [0, 1, 0]}}},
    ]
    file.json["scenes"] = [{"nodes": [0, 1], "name": "all"}]
    file.animate("rotation", [0, 1, 2], rng.normal(size=(9, 4)), "CUBICSPLINE", node=1)
    file.animate("weights", [0, 1], rng.normal(size=(2, 2)), "STEP", node=0)
    file.animate("translation", [0, 1], rng.normal(size=(2, 3)), node=2)
    file.json["images"] = [
        {"bufferView": file.view(b"\x89PNG\r\n\x1a\n0000"), "mimeType": "image/png"},
        {"uri": "a.png"},
    ]
    file.json["textures"] = [{"source": 0, "sampler": 0}, {"source": 1}]
    file.json["samplers"] = [{"wrapS": 33071}]
    file.json["materials"] = [
        {
            "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "baseColorFactor": [1, 0, 0, 1]},
            "normalTexture": {"index": 1},
            "alphaMode": "BLEND",
            "extensions": {"KHR_materials_unlit": {}},
        }
    ]
    primitive["material"] = 0
    humanoid = {"humanBones": [{"bone": "hips", "node": 1}, {"bone": "spine", "node": 2}]}
    file.json["extensions"] = {"VRM": {"humanoid": humanoid}}
    return [file.save(folder, "all.glb"), file.save(folder, "all.gltf")]


def read_damaged(count: int, seed: int, sources: list[Path]) -> dict[str, Any]:
    """What a process of its own says of damaged files; it may neither hang nor crash."""
    command = [sys.executable, "-W", "error", "-m", "tests.io.gltf_damage", str(count), str(seed), *map(str, sources)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=ROOT)
    assert done.returncode == 0, f"rc {done.returncode}: {done.stderr[-2000:]}"
    return json.loads(done.stdout)


def assert_all_clear(report: dict[str, Any], count: int) -> None:
    assert report["wrong"] == []
    assert sum(report["outcomes"].values()) == count
    assert report["outcomes"]["FormatError"] > count / 4, "the damage does no harm: the test is too soft"
    assert report["outcomes"]["loaded"] > count / 50, "everything is refused: the damage is too coarse to reach far"
    assert report["slowest_s"] < 5
    assert report["peak_bytes"] < 1 << 30


def test_damaged_files_made_by_hand(tmp_path: Path) -> None:
    assert_all_clear(read_damaged(1200, 1, everything(tmp_path)), 1200)


@pytest.mark.data
@pytest.mark.parametrize("seed", [2, 3])
def test_damaged_real_files(seed: int, data_dir: Path) -> None:
    data = find_data_dir() or data_dir
    assert_all_clear(read_damaged(500, seed, [data / name for name in REAL]), 500)


def test_files_damaged_as_text(tmp_path: Path) -> None:
    """The damage that other formats get too: numbers, words and lines exchanged, brackets nested 100,000 deep."""
    data = find_data_dir()
    result: dict[str, Any] = load_damaged(
        [*everything(tmp_path), *([data / n for n in REAL] if data else [])], 600, tmp_path
    )
    assert result["wrong"] == []
    assert result["slowest_s"] < 5, result["slowest"]
    assert result["peak_mib"] < 1024
    assert result["loaded"] > 30 and result["refused"] > 200
