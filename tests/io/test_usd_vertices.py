"""Skinned and morphed vertices of our scenes against those that Pixar has baked and those that UsdSkel computes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from keypose.io.usd import read
from keypose.model import SkinningMethod
from tests.io.usd_files import ours, theirs

pytest.importorskip("pxr")
pytestmark = pytest.mark.data


@pytest.mark.parametrize("name", ["lbs", "dqs", "blendshapes"])
def test_vertices_are_those_that_pixar_has_baked(name: str, data_dir: Path) -> None:
    """At all time codes, to a few units in the last place of single precision."""
    from pxr import Usd, UsdGeom

    folder = data_dir / "usd" / "bake_skinning"
    scene = read(folder / f"{name}.usda")
    baked = Usd.Stage.Open(str(folder / f"{name}.baked.usda"))
    meshes = {str(p.GetPath()): UsdGeom.Mesh(p) for p in baked.Traverse() if p.IsA(UsdGeom.Mesh)}
    compared = 0
    for path, mesh in meshes.items():
        attribute = mesh.GetPointsAttr()
        if attribute.Get() is None:  # moves by itself in both files
            continue
        rest = np.array(attribute.Get(), np.float64)
        size = np.ptp(rest, axis=0).max()
        part = [p for p in scene.character.parts if path.endswith(f"/{p.name}")][-1]
        # which point a vertex is: its place in the unbent mesh tells
        points = np.asarray(part.mesh.positions, np.float64) / scene.unit_m
        if part.skin is None:
            points = ours(scene, part)
        elif len(points) == len(rest):
            points = rest
        which = [np.nonzero(np.all(np.isclose(rest, p, atol=1e-5), axis=1))[0] for p in points]
        assert all(len(w) for w in which)
        chosen = np.arange(len(rest)) if len(points) == len(rest) else np.array([w[0] for w in which])
        for code in attribute.GetTimeSamples():
            expected = np.array(attribute.Get(code), np.float64)[chosen]
            np.testing.assert_allclose(ours(scene, part, code), expected, rtol=0, atol=2e-6 * size)
            compared += 1
    assert compared >= 90


def test_dual_quaternions_matter_in_the_reference(data_dir: Path) -> None:
    scene = read(data_dir / "usd" / "bake_skinning" / "dqs.usda")
    assert all(p.skin is not None and p.skin.method is SkinningMethod.DUAL_QUATERNION for p in scene.character.parts)
    linear = read(data_dir / "usd" / "bake_skinning" / "lbs.usda")
    pairs = list(zip(scene.character.parts, linear.character.parts, strict=True))
    apart = [np.abs(ours(scene, a, 20.0) - ours(linear, b, 20.0)).max() for a, b in pairs]
    assert max(apart) > 0.01


@pytest.mark.parametrize("name", ["RiggedFigure.usdz", "RiggedSimple.usdz"])
def test_vertices_of_real_files_are_those_that_usd_skel_computes(name: str, data_dir: Path) -> None:
    path = data_dir / "usd" / name
    scene = read(path)
    codes = [0.0, 1.0, 7.5, 20.25, 30.0, 50.0]
    ((_, expected),) = theirs(path, codes).items()
    (part,) = scene.character.parts
    size = float(np.ptp(expected[0], axis=0).max())
    for code, points in zip(codes, expected, strict=True):
        np.testing.assert_allclose(ours(scene, part, code), points, rtol=0, atol=2e-6 * size)
