"""Small USD files as text, and what usd-core itself makes of one, for comparison."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from keypose.deform import deform_part
from keypose.evaluate import sample, sample_morphs, world
from keypose.math import rigid
from keypose.model import Part, Scene

HEAD = '#usda 1.0\n(\n    metersPerUnit = {unit}\n    upAxis = "{up}"\n    timeCodesPerSecond = {rate}\n)\n'


def usda(path: Path, text: str, *, unit: float = 1.0, up: str = "Y", rate: float = 24.0) -> Path:
    """A layer with a head that says unit, axis and rate."""
    path.write_text(HEAD.format(unit=unit, up=up, rate=rate) + text, encoding="utf-8")
    return path


def ours(scene: Scene, part: Part, code: float | None = None) -> Any:
    """Vertices of a part (V, 3) at a time code of the file, in the unit and axes of the file."""
    character, weights = scene.character, None
    pose = character.skeleton.rest
    if code is not None and scene.animations:
        time = np.array([code / scene.extras["usd"]["time_codes_per_second"]])
        pose = sample(scene.animations[0], character.skeleton, time)[0]
        weights = sample_morphs(scene.animations[0], character.morph_names, time, character.rest_morph_weights)[0]
    points = deform_part(character, part, world(character.skeleton, pose), weights) / scene.unit_m
    return points[:, [0, 2, 1]] * [1, -1, 1] if scene.up == "Z" else points


def theirs(path: Path, codes: list[float]) -> dict[str, list[Any]]:
    """Points in the world as UsdSkel computes them, of every mesh by its path, at some time codes."""
    from pxr import Usd, UsdGeom, UsdSkel, Vt

    stage = Usd.Stage.Open(str(path))
    cache = UsdGeom.XformCache()
    found: dict[str, list[Any]] = {}
    everything = Usd.TraverseInstanceProxies()
    for root_prim in stage.Traverse():
        if not root_prim.IsA(UsdSkel.Root):
            continue
        root, skels = UsdSkel.Root(root_prim), UsdSkel.Cache()
        skels.Populate(root, everything)
        for binding in skels.ComputeSkelBindings(root, everything):
            skeleton = skels.GetSkelQuery(binding.GetSkeleton())
            for target in binding.GetSkinningTargets():
                prim = target.GetPrim()
                if prim.IsA(UsdGeom.Mesh):
                    found[str(prim.GetPath())] = [_posed(skeleton, target, prim, c, cache, Vt) for c in codes]
    return found


def _posed(skeleton: Any, target: Any, prim: Any, code: float, cache: Any, vt: Any) -> Any:
    from pxr import Usd, UsdGeom, UsdSkel

    cache.SetTime(Usd.TimeCode(code))
    points = UsdGeom.Mesh(prim).GetPointsAttr().Get()
    points = vt.Vec3fArray(points)
    animation = skeleton.GetAnimQuery()
    if target.HasBlendShapes() and animation:
        weights = animation.ComputeBlendShapeWeights(code)
        mapper = target.GetBlendShapeMapper()
        if mapper is not None:
            weights = mapper.Remap(weights)
        query = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(prim))
        amounts, shapes, keys = query.ComputeSubShapeWeights(weights)
        query.ComputeDeformedPoints(
            amounts, shapes, keys, query.ComputeBlendShapePointIndices(), query.ComputeSubShapePointOffsets(), points
        )
    if not target.HasJointInfluences():
        return _moved(np.array(points), cache.GetLocalToWorldTransform(prim))
    joints = skeleton.ComputeSkinningTransforms(code)
    if target.IsRigidlyDeformed():
        matrix = target.ComputeSkinnedTransform(joints, code)
        moved = _moved(np.array(points), matrix)
    else:
        target.ComputeSkinnedPoints(joints, points, code)
        moved = np.array(points)
    return _moved(moved, cache.GetLocalToWorldTransform(skeleton.GetPrim()))


def _moved(points: Any, matrix: Any) -> Any:
    return rigid.transform_points(np.array(matrix).T, np.asarray(points, np.float64))
