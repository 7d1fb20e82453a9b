"""Parts as UsdGeom meshes with skins and blend shapes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from keypose.arrays import Array, Floats, Ints
from keypose.io.notes import Notes
from keypose.io.usd.library import Names, entitle, identifier, keep, matrix, vectors
from keypose.io.usd.out_materials import MaterialWriter
from keypose.io.usd.out_skeleton import Bound
from keypose.model import Character, Mesh, MorphSet, Part, Skin, SkinningMethod


class SurfaceWriter:
    """Writes the meshes of one character."""

    def __init__(
        self, usd: Any, stage: Any, materials: MaterialWriter, tokens: Sequence[str], scale: float, notes: Notes
    ) -> None:
        self._usd, self._stage, self._materials, self._tokens = usd, stage, materials, tokens
        self._scale, self._notes = scale, notes

    def add(self, character: Character, part: Part, bound: Bound, path: str, place: int) -> None:
        """One part as a mesh."""
        usd, mesh = self._usd, part.mesh
        schema = usd.UsdGeom.Mesh.Define(self._stage, path)
        prim = schema.GetPrim()
        entitle(prim, part.name)
        keep(prim, place=place, group=int(part.group))
        points = vectors(usd, np.asarray(mesh.positions, np.float64) * self._scale)
        schema.CreatePointsAttr(points)
        schema.CreateExtentAttr(usd.UsdGeom.PointBased.ComputeExtent(points))
        triangles = np.ascontiguousarray(mesh.triangles, np.int32)
        schema.CreateFaceVertexCountsAttr(usd.Vt.IntArray.FromNumpy(np.full(len(triangles), 3, np.int32)))
        schema.CreateFaceVertexIndicesAttr(usd.Vt.IntArray.FromNumpy(triangles.reshape(-1)))
        schema.CreateSubdivisionSchemeAttr(usd.UsdGeom.Tokens.none)
        schema.CreateDoubleSidedAttr(bool(part.material.double_sided))
        if mesh.normals is not None:
            schema.CreateNormalsAttr(vectors(usd, mesh.normals))
            schema.SetNormalsInterpolation(usd.UsdGeom.Tokens.vertex)
        self._primvars(schema, mesh, part.name)
        self._materials.bind(prim, part.material, part.mesh.uvs is not None)
        binding = usd.UsdSkel.BindingAPI.Apply(prim)
        binding.CreateSkeletonRel().SetTargets([bound.skeleton])
        binding.CreateGeomBindTransformAttr(matrix(usd, bound.geometry, self._scale))
        if part.skin is None:
            self._carried(binding, int(part.joint or 0))
        else:
            self._skin(binding, part.skin)
        if part.morphs is not None and len(part.morphs.names):
            self._morphs(binding, character, part, part.morphs, path)

    def _primvars(self, schema: Any, mesh: Mesh, part: str) -> None:
        types, api = self._usd.Sdf.ValueTypeNames, self._usd.UsdGeom.PrimvarsAPI(schema.GetPrim())
        vertex, vt = self._usd.UsdGeom.Tokens.vertex, self._usd.Vt

        def put(name: str, kind: Any, array: Any, values: Any) -> None:
            api.CreatePrimvar(name, kind, vertex).Set(array.FromNumpy(np.ascontiguousarray(values, np.float32)))

        sets = {} if mesh.uvs is None else {"st": mesh.uvs}
        for name, values in mesh.attributes.items():
            if name.startswith("TEXCOORD_") and np.shape(values)[1:] == (2,):
                sets[f"st{name.removeprefix('TEXCOORD_')}"] = values
        for name, values in sets.items():
            flipped = np.asarray(values, np.float64) * [1, -1] + [0, 1]  # the origin is at the bottom in USD
            put(name, types.TexCoord2fArray, vt.Vec2fArray, flipped)
        if mesh.colors is not None:
            colors = np.asarray(mesh.colors, np.float32)
            put("displayColor", types.Color3fArray, vt.Vec3fArray, colors[:, :3])
            if not np.all(colors[:, 3] == 1):
                put("displayOpacity", types.FloatArray, vt.FloatArray, colors[:, 3])
        kinds = {
            1: (types.FloatArray, vt.FloatArray),
            2: (types.Float2Array, vt.Vec2fArray),
            3: (types.Float3Array, vt.Vec3fArray),
            4: (types.Float4Array, vt.Vec4fArray),
        }
        dropped: list[str] = []
        for name, values in mesh.attributes.items():
            table = np.asarray(values)
            width = int(np.prod(table.shape[1:]))
            if f"st{name.removeprefix('TEXCOORD_')}" in sets and name.startswith("TEXCOORD_"):
                continue
            if table.dtype.kind != "f" or width not in kinds or identifier(name, "_") != name:
                dropped.append(name)
            else:
                put(name, *kinds[width], table.reshape(-1) if width == 1 else table.reshape(-1, width))
        if dropped:
            self._notes.add(f"part '{part}': vertex attributes were dropped: {', '.join(dropped)}")

    def _carried(self, binding: Any, joint: int) -> None:
        binding.CreateJointsAttr(self._usd.Vt.TokenArray([self._tokens[joint]]))
        binding.CreateJointIndicesPrimvar(True, 1).Set(self._usd.Vt.IntArray([0]))
        binding.CreateJointWeightsPrimvar(True, 1).Set(self._usd.Vt.FloatArray([1.0]))

    def _skin(self, binding: Any, skin: Skin) -> None:
        vt = self._usd.Vt
        binding.CreateJointsAttr(vt.TokenArray([self._tokens[j] for j in skin.palette.tolist()]))
        joints = np.ascontiguousarray(skin.joints, np.int32).reshape(-1)
        weights = np.ascontiguousarray(skin.weights, np.float32).reshape(-1)
        binding.CreateJointIndicesPrimvar(False, skin.influence_count).Set(vt.IntArray.FromNumpy(joints))
        binding.CreateJointWeightsPrimvar(False, skin.influence_count).Set(vt.FloatArray.FromNumpy(weights))
        if skin.method is SkinningMethod.DUAL_QUATERNION:
            binding.CreateSkinningMethodAttr(self._usd.UsdSkel.Tokens.dualQuaternion)

    def _morphs(self, binding: Any, character: Character, part: Part, morphs: MorphSet, path: str) -> None:
        usd, names, paths = self._usd, Names(), list[str]()
        channels = [] if part.morph_channels is None else part.morph_channels.tolist()
        titles = [character.morph_names[channel] for channel in channels]
        for number, title in enumerate(titles):
            paths.append(f"{path}/{names.add(title, 'shape')}")
            schema = usd.UsdSkel.BlendShape.Define(self._stage, paths[-1])
            rows = slice(int(morphs.starts[number]), int(morphs.starts[number + 1]))
            vertices, positions, normals = _deltas(morphs, rows)
            schema.CreateOffsetsAttr(vectors(usd, positions * self._scale))
            schema.CreatePointIndicesAttr(usd.Vt.IntArray.FromNumpy(vertices))
            if normals is not None:
                schema.CreateNormalOffsetsAttr(vectors(usd, normals))
        binding.CreateBlendShapesAttr(usd.Vt.TokenArray(titles))
        binding.CreateBlendShapeTargetsRel().SetTargets(paths)


def _deltas(morphs: MorphSet, rows: slice) -> tuple[Ints, Floats, Array | None]:
    """Each vertex once; one that is moved twice moves by the sum."""
    unique, inverse = np.unique(morphs.vertices[rows], return_inverse=True)
    positions = np.zeros((len(unique), 3))
    np.add.at(positions, inverse.reshape(-1), np.asarray(morphs.position_deltas[rows], np.float64))
    if morphs.normal_deltas is None:
        return unique.astype(np.int32), positions, None
    normals = np.zeros_like(positions)
    np.add.at(normals, inverse.reshape(-1), np.asarray(morphs.normal_deltas[rows], np.float64))
    return unique.astype(np.int32), positions, normals
