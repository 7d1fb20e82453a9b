"""What a format cannot hold of a VRM character is told, not dropped silently."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from keypose import io, samples
from keypose.analysis import scene_error
from keypose.model import Character, Material, Pose, Scene, Skeleton


@pytest.fixture(scope="module")
def vrm() -> Character:
    human = samples.load("human").character
    about = {"extensions": {"VRMC_materials_mtoon": {"specVersion": "1.0"}, "KHR_materials_unlit": {}}}
    toon = Material("toon", unlit=True, extras={"gltf": about})
    parts = (replace(human.parts[0], material=toon), *human.parts[1:])
    return replace(human, parts=parts, extras={"vrm": {"springBone": {}, "meta": {}}})


@pytest.mark.parametrize("suffix", [".fbx", ".dae", ".obj"])
def test_shading_and_springs(suffix: str, vrm: Character, tmp_path: Path) -> None:
    if suffix == ".fbx":
        pytest.importorskip("ufbx")
    notes = io.save(vrm, tmp_path / f"a{suffix}")
    assert "material extensions are not in the file: VRMC_materials_mtoon" in notes
    assert "VRM: spring bones, licence are not in the file" in notes
    plain = io.save(replace(vrm, parts=vrm.parts[1:], extras={}), tmp_path / f"b{suffix}")
    assert not any("extensions" in note or "VRM" in note for note in plain)


@pytest.mark.parametrize("suffix", [".bvh", ".amc"])
def test_a_rest_pose_with_rotations_is_kept_as_a_motion(suffix: str, tmp_path: Path) -> None:
    """Formats whose rest pose cannot turn joints hold it in one frame, which is what the proof looks at."""
    rng = np.random.default_rng(2)
    rotations = rng.normal(size=(5, 4))
    rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
    rest = Pose(rng.uniform(-0.3, 0.3, (5, 3)), rotations, np.ones((5, 3)) * (1 + 1e-7))
    scene = Scene((Character(Skeleton(tuple("abcde"), np.array([-1, 0, 1, 1, 3]), rest)),))
    notes = io.save(scene, tmp_path / f"a{suffix}")
    assert not any("scaled" in note for note in notes)
    error = scene_error(scene, io.load(tmp_path / f"a{suffix}", unit=0.01 if suffix == ".bvh" else None))
    assert error.motion is not None and error.motion.within(2e-3, 2e-4)
