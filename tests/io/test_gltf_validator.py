"""What keypose writes has no errors in the Khronos validator, and no warnings that its source did not have."""

from __future__ import annotations

from pathlib import Path

import pytest

from keypose.io.gltf import read, write
from tests.conftest import data_files
from tests.io.gltf_node import validate

# Warnings about how the source built its node tree, which is kept as it is.
OF_THE_SOURCE = {
    "NODE_SKINNED_MESH_NON_ROOT",
    "NODE_SKINNED_MESH_LOCAL_TRANSFORMS",
    "ANIMATION_CHANNEL_TARGET_NODE_SKIN",
}

REAL = [p for pattern in ("gltf/**/*.gltf", "gltf/**/*.glb", "vrm/*.vrm", "vrm/*.vrma") for p in data_files(pattern)]


def problems(*files: Path) -> list[str]:
    found: list[str] = []
    for file, report in zip(files, validate(*files), strict=True):
        found += [f"{file.name}: {code}: {text}" for severity, code, text in report if severity == 0]
        found += [
            f"{file.name}: {code}: {text}"
            for severity, code, text in report
            if severity == 1 and code not in OF_THE_SOURCE
        ]
    return found


@pytest.mark.data
def test_every_real_file_is_written_without_errors(data_dir: Path, tmp_path: Path) -> None:
    written: list[Path] = []
    for number, path in enumerate(REAL):
        scene = read(path)
        names = [(f"{number}_{path.stem}.glb", False)]
        if path.name != "Knight.glb":  # large: once is enough
            names.append((f"{number} {path.stem}.gltf", number % 2 == 0))
        for name, embed in names:
            write(scene, tmp_path / name, embed=embed)
            written.append(tmp_path / name)
    assert len(written) >= 50
    assert problems(*written) == []
