"""Round trips through every format that is written: what comes back, against what it was; ``pytest -rP`` prints the table."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from keypose import io, samples
from keypose.analysis import SceneError, scene_error
from keypose.io.registry import formats
from keypose.model import Markers, Scene, Tier

NEEDS = {"fbx": "ufbx", "usd": "pxr"}  # to be read
# What single precision and printed digits leave: millimetres, degrees.
BODIES = {
    ".glb": (1e-3, 1e-4), ".gltf": (1e-3, 1e-4), ".fbx": (1e-3, 1e-4), ".dae": (1e-3, 1e-4), ".bvh": (1e-3, 1e-4),
    ".amc": (1e-3, 1e-4), ".npz": (0.0, 0.0), ".safetensors": (0.0, 0.0), ".keypose": (0.0, 0.0), ".usda": (1e-3, 1e-4),
    ".usdc": (1e-3, 1e-4), ".usdz": (1e-3, 1e-4), ".vrm": (1e-3, 1e-4), ".vrma": (1e-3, 1e-4),
}  # fmt: skip
REAL = [
    ("cmu_01_01/01_01.bvh", [".bvh", ".glb", ".amc", ".npz"]), ("asf_amc/cmu_02/02_01.amc", [".amc", ".bvh", ".glb", ".fbx"]),
    ("bvh/fair1/dab.bvh", [".bvh", ".dae", ".safetensors"]), ("gltf/khronos/Fox.glb", [".glb", ".gltf", ".dae", ".usdc"]), ("gltf/cc0/greenman.glb", [".glb", ".fbx"]),
    ("gltf/khronos/MorphStressTest.gltf", [".glb", ".fbx", ".usda"]), ("fbx/geno/Geno.fbx", [".fbx", ".glb", ".dae"]),
    ("fbx/ozz_pab/skeleton.fbx", [".fbx", ".glb"]), ("collada/ozz/astro_maya.dae", [".dae", ".glb"]),
    ("vrm/debug_robot.vrm", [".vrm"]), ("vrm/idle_loop.vrma", [".vrma"]), ("cmu_01_01/01_01.c3d", [".c3d", ".trc", ".csm"]),
    ("trc/opensim/subject01_walk1.trc", [".trc", ".c3d", ".csm"]), ("csm/ThomasFechten.csm", [".csm", ".trc", ".c3d"]),
]  # fmt: skip


def there_and_back(scene: Scene, path: Path) -> SceneError:
    """Written, read in the unit and axes that it was written in, compared; a row of the table is printed."""
    from keypose.cli.convert import _conventions  # pyright: ignore[reportPrivateUsage]

    chosen = next(entry for entry in formats() if path.suffix in entry.suffixes)
    if chosen.name in NEEDS and importlib.util.find_spec(NEEDS[chosen.name]) is None:
        pytest.skip(f"{chosen.name} is read with {NEEDS[chosen.name]}, which is not installed")
    io.save(scene, path)
    error = scene_error(scene, io.load(path, **_conventions(scene, path, None)))
    motion = error.motion
    cells = [
        f"{motion.position_mm:.1e} mm, {motion.rotation_deg:.1e} deg" if motion else "",
        "" if error.vertex_mm is None else f"vertices {error.vertex_mm:.1e} mm",
        "" if error.marker_mm is None else f"markers {error.marker_mm:.1e} mm",
        "" if error.morph is None else f"weights {error.morph:.1e}",
    ]
    print(f"{path.name:40s} " + "; ".join(cell for cell in cells if cell))
    return error


@pytest.mark.parametrize("suffix", list(BODIES))
def test_a_walk(suffix: str, tmp_path: Path) -> None:
    scene = samples.load("walk")
    error = there_and_back(scene, tmp_path / f"walk{suffix}")
    limit_mm, limit_deg = BODIES[suffix]
    assert error.motion is not None and error.motion.within(limit_mm, limit_deg)
    if error.vertex_mm is not None:
        assert error.vertex_mm <= max(limit_mm, 1e-6)
    assert error.morph is None or error.morph <= 1e-6
    assert error.time_s < 1e-6


@pytest.mark.data
@pytest.mark.parametrize(("name", "suffix"), [(name, suffix) for name, suffixes in REAL for suffix in suffixes])
def test_real_files(name: str, suffix: str, data_dir: Path, tmp_path: Path) -> None:
    source = data_dir / name
    if source.suffix == ".fbx" and importlib.util.find_spec("ufbx") is None:
        pytest.skip("FBX is read with ufbx, which is not installed")
    scene = io.load(source)
    error = there_and_back(scene, tmp_path / f"{source.stem}{suffix}")
    relative = 1e-6  # of what is larger than a thousand times the limit
    assert error.motion is None or error.motion.within(max(1e-3, relative * error.size_mm), 2e-4)
    assert (error.marker_mm or 0.0) <= 1e-3 and (error.vertex_mm or 0.0) <= max(1e-3, relative * error.size_mm)
    assert error.time_s < 1e-4


@pytest.mark.parametrize("suffix", [".c3d", ".trc", ".csm"])
def test_markers(suffix: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    positions = rng.uniform(-2, 2, (200, 7, 3))
    positions[20:60, 2] = np.nan
    scene = Scene(markers=(Markers(tuple("abcdefg"), positions, 120.0),))
    error = there_and_back(scene, tmp_path / f"take{suffix}")
    assert error.marker_mm is not None and error.marker_mm < 1e-3 and not error.missing


def test_faces_speech_and_meshes(tmp_path: Path) -> None:
    """Weights in a table of Live Link Face, labels in a TextGrid, vertices in an OBJ: to their printed digits."""
    talk = samples.load("talk")
    error = there_and_back(replace(talk, animations=()), tmp_path / "talk.obj")
    assert error.vertex_mm is not None and error.vertex_mm < 1e-3
    tier = Tier("phones", np.array([0.0, 0.12345678]), np.array([0.12345678, 0.5]), ("a", "b"))
    io.save(Scene(tiers=(tier,)), tmp_path / "a.TextGrid")
    (back,) = io.load(tmp_path / "a.TextGrid").tiers
    np.testing.assert_allclose(back.starts_s, tier.starts_s, atol=1e-9)
    assert back.labels == tier.labels
