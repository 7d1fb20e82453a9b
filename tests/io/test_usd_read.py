"""Reading USD: small files for each thing that a stage may hold, checked by hand and against usd-core."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import keypose.io
from keypose.deform import deform_part
from keypose.errors import FormatError, UnknownName
from keypose.evaluate import sample, sample_morphs, world
from keypose.io import guarded
from keypose.io.usd import process, read, read_many
from keypose.io.usd.morphs import amounts, with_turning_points
from keypose.math import quat
from keypose.model import Channel, Property
from tests.io.test_fbx_write import PNG
from tests.io.usd_files import HEAD, ours, theirs, usda

pytest.importorskip("pxr")

SQUARE = """
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
        uniform token subdivisionScheme = "none"
"""
EYE = "( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1) )"
AT = "( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), ({}, {}, {}, 1) )"


def skeleton(
    joints: str = '"a", "a/b"', bind: str = f"{EYE}, {AT.format(0, 1, 0)}", rest: str = "", more: str = ""
) -> str:
    return f"""
    def Skeleton "Skel" (prepend apiSchemas = ["SkelBindingAPI"])
    {{
        uniform token[] joints = [{joints}]
        uniform matrix4d[] bindTransforms = [{bind}]
        uniform matrix4d[] restTransforms = [{rest or f"{EYE}, {AT.format(0, 1, 0)}"}]
        {more}
    }}
"""


def root(*contents: str) -> str:
    body = "\n".join(contents)
    return f'def SkelRoot "Root" (prepend apiSchemas = ["SkelBindingAPI"])\n{{\n    rel skel:skeleton = </Root/Skel>\n{body}\n}}\n'


def mesh(name: str = "Mesh", more: str = "", square: str = SQUARE) -> str:
    return f'    def Mesh "{name}" (prepend apiSchemas = ["SkelBindingAPI", "MaterialBindingAPI"])\n    {{{square}{more}\n    }}\n'


def influences(joints: str, weights: str, width: int, interpolation: str = "vertex") -> str:
    about = f'(\n            elementSize = {width}\n            interpolation = "{interpolation}"\n        )'
    return f"""
        int[] primvars:skel:jointIndices = [{joints}] {about}
        float[] primvars:skel:jointWeights = [{weights}] {about}
"""


ONE = influences("0, 0, 0, 0", "1, 1, 1, 1", 1)


# --- hierarchies ------------------------------------------------------------------------------------------------------


def test_xforms_are_joints_and_their_samples_curves(tmp_path: Path) -> None:
    text = """
def Xform "arm"
{
    double3 xformOp:translate = (1, 2, 3)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Scope "stuff"
    {
        def Xform "hand"
        {
            double3 xformOp:translate.timeSamples = { 0: (0, 0, 0), 10: (0, 5, 0) }
            quatf xformOp:orient.timeSamples = { 0: (1, 0, 0, 0), 10: (0, 1, 0, 0) }
            float3 xformOp:scale = (1, 2, 1)
            uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient", "xformOp:scale"]
        }
    }
    def Xform "free"
    {
        double3 xformOp:translate = (7, 0, 0)
        uniform token[] xformOpOrder = ["!resetXformStack!", "xformOp:translate"]
    }
}
"""
    scene = read(usda(tmp_path / "a.usda", text, unit=0.01, rate=20))
    skeleton = scene.character.skeleton
    assert skeleton.names == ("arm", "hand", "free") and skeleton.parents.tolist() == [-1, 0, -1]
    np.testing.assert_allclose(skeleton.rest.translations, [[0.01, 0.02, 0.03], [0, 0, 0], [0.07, 0, 0]])
    np.testing.assert_allclose(skeleton.rest.scales[1], [1, 2, 1])
    (clip,) = scene.animations
    assert set(map(str, clip.curves)) == {"hand.translation", "hand.rotation"} and clip.duration_s == 0.5
    pose = sample(clip, skeleton, np.array([0.25]))[0]
    np.testing.assert_allclose(pose.translations[1], [0, 0.025, 0], atol=1e-12)
    np.testing.assert_allclose(pose.rotations[1], quat.from_axis_angle([1, 0, 0], np.pi / 2), atol=1e-7)


def test_whole_turns_of_angles_are_kept(tmp_path: Path) -> None:
    """Two keys, 0 and 720 degrees, are one and the same rotation; what lies between them tells them apart."""
    text = """
def Xform "wheel"
{
    float xformOp:rotateY.timeSamples = { 0: 0, 48: 720 }
    uniform token[] xformOpOrder = ["xformOp:rotateY"]
}
"""
    scene = read(usda(tmp_path / "a.usda", text))
    curve = scene.animations[0].curves[Channel("wheel", Property.ROTATION)]
    assert curve.key_count == 49
    pose = sample(scene.animations[0], scene.character.skeleton, np.array([0.25, 0.5]))
    expected = quat.from_axis_angle([0, 1, 0], np.radians([90.0, 180.0])[:, None])
    assert np.max(quat.angle_between(pose.rotations[:, 0], np.asarray(expected).reshape(2, 4))) < 1e-6


@pytest.mark.parametrize("up", ["X", "Y", "Z"])
def test_any_axis_up(up: str, tmp_path: Path) -> None:
    """A figure that stands along the file's axis stands along Y; from Z up it faces +Z where it faced -Y."""
    along = {"X": (2, 0, 0), "Y": (0, 2, 0), "Z": (0, 0, 2)}[up]
    text = root(skeleton(rest=f"{EYE}, {AT.format(*along)}"), mesh(more=ONE))
    path = usda(tmp_path / "a.usda", text, up="Y" if up == "X" else up)
    scene = read(path, up="X") if up == "X" else read(path)  # usd-core knows two only
    assert scene.up == up
    at = np.asarray(world(scene.character.skeleton, scene.character.skeleton.rest))
    np.testing.assert_allclose(at[1, :3, 3], [0, 2, 0], atol=1e-12)
    if up == "Z":
        np.testing.assert_allclose(at[0, :3, :3] @ [0, -1, 0], [0, 0, 1], atol=1e-12)


def test_a_unit_that_is_missing_or_wrong(tmp_path: Path) -> None:
    text = 'def Xform "a" {\n    double3 xformOp:translate = (1, 0, 0)\n    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
    path = tmp_path / "a.usda"
    path.write_text("#usda 1.0\n" + text)
    scene = keypose.io.load(path)
    assert scene.unit_m == 0.01 and scene.character.skeleton.rest.translations[0, 0] == 0.01
    assert any("names none" in note for note in scene.notes)
    for unit, size in (("m", 1.0), (0.5, 0.5)):
        scene = keypose.io.load(path, unit=unit)
        assert scene.unit_m == size and scene.character.skeleton.rest.translations[0, 0] == size and scene.notes == ()
    with pytest.raises(UnknownName, match="no unit 'parsec'"):
        keypose.io.load(path, unit="parsec")


def test_what_stands_above_a_skeleton_is_worked_into_its_roots(tmp_path: Path) -> None:
    text = root(skeleton(), mesh(more=ONE)).replace("</Root/", "</Top/Root/")
    top = """
def Xform "Top"
{
    double3 xformOp:translate = (1, 0, 0)
    float xformOp:rotateZ = 90
    float3 xformOp:scale = (2, 2, 2)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ", "xformOp:scale"]
"""
    path = usda(tmp_path / "a.usda", top + text + "}\n")
    scene = read(path)
    assert scene.character.skeleton.names == ("a", "b")
    ((_, (expected,)),) = theirs(path, [0.0]).items()
    np.testing.assert_allclose(ours(scene, scene.character.parts[0]), expected, atol=1e-6)
    uneven = usda(tmp_path / "b.usda", (top + text + "}\n").replace("(2, 2, 2)", "(2, 1, 3)"))
    scene = read(uneven)
    assert scene.character.skeleton.names == ("Top", "Root", "Skel", "a", "b")
    ((_, (expected,)),) = theirs(uneven, [0.0]).items()
    np.testing.assert_allclose(ours(scene, scene.character.parts[0]), expected, atol=1e-6)


def test_a_skeleton_that_is_carried_about(tmp_path: Path) -> None:
    """Moving prims above a skeleton are joints, and a prop beside it hangs on its own."""
    text = root(
        "    double3 xformOp:translate.timeSamples = { 0: (0, 0, 0), 24: (0, 0, 4) }\n"
        '    uniform token[] xformOpOrder = ["xformOp:translate"]\n',
        skeleton(),
        mesh(more=ONE),
        '    def Mesh "Prop" {' + SQUARE + "}\n",
    )
    path = usda(tmp_path / "a.usda", text)
    scene = read(path)
    assert scene.character.skeleton.names == ("Root", "a", "b")
    body, prop = scene.character.parts
    assert prop.joint == 0 and body.skin is not None
    for code, expected in zip((0.0, 12.0), theirs(path, [0.0, 12.0])["/Root/Mesh"], strict=True):
        np.testing.assert_allclose(ours(scene, body, code), expected, atol=1e-6)


def test_joints_in_any_order_and_with_names_of_their_own(tmp_path: Path) -> None:
    joints, rest = '"a/b", "a", "a/b/c/d"', f"{AT.format(0, 1, 0)}, {AT.format(5, 0, 0)}, {AT.format(0, 0, 3)}"
    names = 'uniform token[] jointNames = ["spine", "hips", "tip"]'
    found = read(usda(tmp_path / "a.usda", root(skeleton(joints, rest, rest, names)))).character.skeleton
    assert found.names == ("hips", "spine", "tip") and found.parents.tolist() == [-1, 0, 1]
    np.testing.assert_allclose(found.rest.translations, [[5, 0, 0], [0, 1, 0], [0, 0, 3]])


def test_two_skeletons_with_the_same_names(tmp_path: Path) -> None:
    first = root(skeleton(), mesh(more=ONE))
    second = first.replace('"Root"', '"Other"').replace("</Root/", "</Other/")
    scene = read(usda(tmp_path / "a.usda", first + second.replace("(0, 1, 0, 1)", "(0, 2, 0, 1)")))
    assert scene.character.skeleton.names == ("a", "b", "a_2", "b_2")
    assert [p.skin.palette.tolist() for p in scene.character.parts if p.skin is not None] == [[0], [2]]
    assert any("'a_2'" in note for note in scene.notes)


def test_instances_are_shown_each(tmp_path: Path) -> None:
    text = 'class Xform "proto" {\n    def Mesh "m" {' + SQUARE + "}\n}\n"
    for name, x in (("one", 1), ("two", 2)):
        text += (
            f'def Xform "{name}" (instanceable = true\n inherits = </proto>) {{\n'
            f'    double3 xformOp:translate = ({x}, 0, 0)\n    uniform token[] xformOpOrder = ["xformOp:translate"]\n}}\n'
        )
    scene = read(usda(tmp_path / "a.usda", text))
    starts = [ours(scene, part)[0].tolist() for part in scene.character.parts]
    assert starts == [[1, 0, 0], [2, 0, 0]]


# --- meshes -----------------------------------------------------------------------------------------------------------


def one_part(tmp_path: Path, more: str = "", square: str = SQUARE) -> Any:
    scene = read(
        usda(tmp_path / "m.usda", f'def Mesh "m" (prepend apiSchemas = ["MaterialBindingAPI"]) {{{square}{more}}}\n')
    )
    return scene


def test_faces_and_their_winding(tmp_path: Path) -> None:
    part = one_part(tmp_path).character.parts[0]
    np.testing.assert_array_equal(part.mesh.triangles, [[0, 1, 2], [0, 2, 3]])
    assert part.mesh.normals is None and part.joint == 0 and part.material.double_sided
    turned = one_part(tmp_path, '        uniform token orientation = "leftHanded"\n').character.parts[0]
    np.testing.assert_array_equal(turned.mesh.triangles, [[2, 1, 0], [3, 2, 0]])
    holes = SQUARE.replace("[4]", "[3, 3]").replace("[0, 1, 2, 3]", "[0, 1, 2, 0, 2, 3]")
    holed = one_part(tmp_path, "        int[] holeIndices = [0]\n", holes).character.parts[0]
    np.testing.assert_array_equal(holed.mesh.triangles, [[0, 2, 3]])


def test_what_varies_over_a_mesh(tmp_path: Path) -> None:
    more = """
        normal3f[] normals = [(0, 0, 2)] (interpolation = "uniform")
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1)] (interpolation = "faceVarying")
        int[] primvars:st:indices = [0, 1, 2, 0]
        texCoord2f[] primvars:second = [(0, 0), (0.5, 0), (0, 0.25), (0, 0)] (interpolation = "vertex")
        color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0)] (interpolation = "vertex")
        float[] primvars:displayOpacity = [0.5] (interpolation = "constant")
        float3[] primvars:flow = [(1, 2, 3), (1, 2, 3), (1, 2, 3), (1, 2, 4)] (interpolation = "varying")
        float[] primvars:short = [1, 2] (interpolation = "vertex")
"""
    scene = one_part(tmp_path, more)
    found = scene.character.parts[0].mesh
    np.testing.assert_allclose(found.normals, [[0, 0, 1]] * 4)
    np.testing.assert_allclose(found.uvs, [[0, 1], [1, 1], [1, 0], [0, 1]])
    np.testing.assert_allclose(found.attributes["TEXCOORD_1"], [[0, 1], [0.5, 1], [0, 0.75], [0, 1]])
    np.testing.assert_allclose(found.colors[1], [0, 1, 0, 0.5])
    np.testing.assert_allclose(found.attributes["flow"][3], [1, 2, 4])
    assert any("short do not fit" in note for note in scene.notes)


def test_a_corner_with_two_normals_is_two_vertices_that_move_as_one(tmp_path: Path) -> None:
    faces = SQUARE.replace("[4]", "[3, 3]").replace("[0, 1, 2, 3]", "[0, 1, 2, 0, 2, 3]")
    normals = "[(0, 0, 1), (0, 0, 1), (0, 0, 1), (1, 0, 0), (1, 0, 0), (1, 0, 0)]"
    more = f'        normal3f[] normals = {normals} (interpolation = "faceVarying")\n'
    path = usda(
        tmp_path / "a.usda", root(skeleton(), mesh(more=more + influences("0, 1, 1, 0", "1, 1, 1, 1", 1), square=faces))
    )
    part = read(path).character.parts[0]
    assert part.mesh.vertex_count == 6 and part.skin is not None
    points = np.asarray(part.mesh.positions)
    assert {tuple(p): int(part.skin.palette[j]) for p, j in zip(points.tolist(), part.skin.joints[:, 0], strict=True)} == {
        (0, 0, 0): 0, (1, 0, 0): 1, (1, 1, 0): 1, (0, 1, 0): 0,
    }  # fmt: skip


def test_subsets_are_parts_with_materials(tmp_path: Path) -> None:
    faces = SQUARE.replace("[4]", "[3, 3]").replace("[0, 1, 2, 3]", "[0, 1, 2, 0, 2, 3]")
    more = """
        rel material:binding = </red>
        def GeomSubset "sub" (prepend apiSchemas = ["MaterialBindingAPI"])
        {
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = [1]
            rel material:binding = </blue>
        }
"""
    scene = one_part(tmp_path, more, faces)
    text = (tmp_path / "m.usda").read_text() + _material("red", "(1, 0, 0)") + _material("blue", "(0, 0, 1)")
    (tmp_path / "m.usda").write_text(text)
    scene = read(tmp_path / "m.usda")
    assert [p.name for p in scene.character.parts] == ["m", "m_sub"]
    assert [p.material.base_color[:3] for p in scene.character.parts] == [(1, 0, 0), (0, 0, 1)]
    assert [p.group for p in scene.character.parts] == [0, 0]
    np.testing.assert_allclose(scene.character.parts[1].mesh.positions, [[0, 0, 0], [1, 1, 0], [0, 1, 0]])


def _material(name: str, color: str, more: str = "") -> str:
    return f"""
def Material "{name}"
{{
    token outputs:surface.connect = </{name}/s.outputs:surface>
    def Shader "s"
    {{
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor = {color}
        {more}
        token outputs:surface
    }}
}}
"""


def test_what_is_not_shown_is_left_out(tmp_path: Path) -> None:
    more = {"hidden": 'token visibility = "invisible"', "helper": 'uniform token purpose = "guide"', "seen": ""}
    text = "".join(f'def Mesh "{name}" {{{SQUARE}        {line}\n}}\n' for name, line in more.items())
    scene = read(usda(tmp_path / "a.usda", text + 'def Sphere "ball" {}\ndef Camera "eye" {}\n'))
    assert [p.name for p in scene.character.parts] == ["seen"]
    notes = " ".join(scene.notes)
    assert "invisible" in notes and "guide" in notes and "1 Sphere" in notes and "1 Camera" in notes


def test_subdivision_and_moving_points_are_told(tmp_path: Path) -> None:
    moving = SQUARE.replace('uniform token subdivisionScheme = "none"', "")
    moving += "        point3f[] points.timeSamples = { 1: [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 5)], 2: [] }\n"
    scene = one_part(tmp_path, "", moving)
    notes = " ".join(scene.notes)
    assert "subdivision" in notes and "move by themselves" in notes
    np.testing.assert_allclose(scene.character.parts[0].mesh.normals, [[0, 0, 1]] * 4)
    np.testing.assert_allclose(scene.character.parts[0].mesh.positions[3], [0, 1, 0])


# --- skins ------------------------------------------------------------------------------------------------------------

BENT = """
        rel skel:animationSource = </Root/Skel/Anim>
        def SkelAnimation "Anim"
        {
            uniform token[] joints = ["a/b", "a"]
            float3[] translations.timeSamples = { 0: [(0, 1, 0), (0, 0, 0)], 24: [(0, 1, 0), (0, 0, 3)] }
            quatf[] rotations.timeSamples = {
                0: [(1, 0, 0, 0), (1, 0, 0, 0)],
                24: [(0.7071068, 0.7071068, 0, 0), (0, 0, 1, 0)] }
            half3[] scales = [(1, 1, 1), (1, 1, 1)]
        }
"""


@pytest.mark.parametrize(
    "binding",
    [
        influences("0, 1, 0, 1, 0, 1, 0, 1", "1, 0, 0.5, 0.5, 0.25, 0.75, 0, 1", 2),
        influences("0, 1, 0, 1", "1, 1, 1, 1", 1) + '        uniform token[] skel:joints = ["a/b", "a"]\n',
        influences("1", "1", 1, "constant"),
        influences("0, 1", "0.25, 0.75", 2, "constant"),
        influences("1, 0", "1, 0", 2, "constant") + '        uniform token[] skel:joints = ["a/b", "a"]\n',
        influences("0, 1, 0, 1, 0, 1, 0, 1", "1, 0, 0.5, 0.5, 0.25, 0.75, 0, 1", 2)
        + '        uniform token primvars:skel:skinningMethod = "dualQuaternion"\n',
    ],
)
@pytest.mark.parametrize(
    "geometry",
    ["", "matrix4d primvars:skel:geomBindTransform = ( (0, 2, 0, 0), (-2, 0, 0, 0), (0, 0, 2, 0), (1, 2, 3, 1) )"],
)
def test_every_kind_of_binding_is_what_usd_skel_makes_of_it(binding: str, geometry: str, tmp_path: Path) -> None:
    text = root(skeleton(more=BENT), mesh(more=f"{binding}        {geometry}\n"))
    path = usda(tmp_path / "a.usda", text, unit=0.01)
    scene = read(path)
    codes = [0.0, 12.0, 17.5, 24.0]
    ((_, expected),) = theirs(path, codes).items()
    (part,) = scene.character.parts
    for code, points in zip(codes, expected, strict=True):
        np.testing.assert_allclose(ours(scene, part, code), points, atol=2e-6 * 10)
    assert (part.joint is not None) == ('"constant"' in binding and "0.25" not in binding)


def test_weights_that_do_not_sum_to_one_and_joints_that_are_not_there(tmp_path: Path) -> None:
    binding = influences("0, 1, 0, 1, 0, 1, 0, 1", "1, 1, 0.5, 0.5, 0.25, 0.25, 0, 0", 2)
    scene = read(usda(tmp_path / "a.usda", root(skeleton(), mesh(more=binding))))
    (part,) = scene.character.parts
    assert part.skin is not None
    np.testing.assert_allclose(part.skin.weights, [[0.5, 0.5], [0.5, 0.5], [0.5, 0.5], [1, 0]])
    assert any("did not sum to 1" in n for n in scene.notes) and any("no weight" in n for n in scene.notes)
    strange = binding + '        uniform token[] skel:joints = ["a", "x"]\n'
    scene = read(usda(tmp_path / "a.usda", root(skeleton(), mesh(more=strange))))
    assert any("not in the skeleton" in n for n in scene.notes)
    beyond = influences("0, 7, 0, 1", "1, 1, 1, 1", 1)
    with pytest.raises(FormatError, match=r"mesh 'Mesh': joint 7 does not exist; there are 2"):
        read(usda(tmp_path / "a.usda", root(skeleton(), mesh(more=beyond))))


def test_skeletons_without_bind_or_rest_transforms(tmp_path: Path) -> None:
    text = root(skeleton(), mesh(more=ONE))
    lines = text.splitlines()
    for word, message in (("bindTransforms", "bind transforms are missing"), ("restTransforms", "no rest transforms")):
        scene = read(usda(tmp_path / "a.usda", "\n".join(line for line in lines if word not in line)))
        assert any(message in note for note in scene.notes)
        np.testing.assert_allclose(scene.character.skeleton.rest.translations[1], [0, 1, 0])
        np.testing.assert_allclose(ours(scene, scene.character.parts[0])[2], [1, 1, 0], atol=1e-6)


# --- blend shapes -----------------------------------------------------------------------------------------------------


def test_in_betweens_are_blended_as_usd_does(rng: np.random.Generator) -> None:
    """Below 0, above the last and everywhere between, against usd-core's own weights of sub-shapes."""
    from pxr import Usd, UsdSkel

    for stops in ((1.0,), (1.0, 0.5), (1.0, 0.25, 0.5), (1.0, 1.5), (1.0, -0.5), (1.0, -1.0, 2.0, 0.1)):
        stage = Usd.Stage.CreateInMemory()
        prim = stage.DefinePrim("/m", "Mesh")
        shape = UsdSkel.BlendShape.Define(stage, "/m/s")
        shape.CreateOffsetsAttr([(1, 0, 0)])
        for number, stop in enumerate(stops[1:]):
            between = shape.CreateInbetween(f"i{number}")
            between.SetWeight(stop)
            between.SetOffsets([(float(number + 2), 0, 0)])
        binding = UsdSkel.BindingAPI.Apply(prim)
        binding.CreateBlendShapesAttr(["s"])
        binding.CreateBlendShapeTargetsRel().SetTargets(["/m/s"])
        query = UsdSkel.BlendShapeQuery(binding)
        offsets = query.ComputeSubShapePointOffsets()
        mine = [1.0, *(number + 2.0 for number in range(len(stops) - 1))]
        for weight in [-1.5, -0.75, -0.2, 0.0, 0.05, 0.3, 0.5, 0.77, 1.0, 1.2, 1.9, 3.0]:
            weights, _, keys = query.ComputeSubShapeWeights([weight])
            expected = sum(w * offsets[k][0][0] for w, k in zip(weights, keys, strict=True) if len(offsets[k]))
            found = sum(float(a[0]) * o for a, o in zip(amounts(stops, np.array([weight])), mine, strict=True))
            assert found == pytest.approx(expected, abs=1e-5), (stops, weight)


def test_keys_are_added_where_a_weight_passes_an_in_between() -> None:
    times, weights = with_turning_points((1.0, 0.5), np.array([0.0, 2.0, 3.0]), np.array([-1.0, 1.0, 0.0]))
    np.testing.assert_allclose(times, [0, 1, 1.5, 2, 2.5, 3])
    np.testing.assert_allclose(weights, [-1, 0, 0.5, 1, 0.5, 0])


def test_blend_shapes_of_two_meshes_are_one_channel(tmp_path: Path) -> None:
    def shaped(name: str) -> str:
        return mesh(
            name,
            f"""
        uniform token[] skel:blendShapes = ["smile", "blink"]
        rel skel:blendShapeTargets = [</Root/{name}/s>, </Root/{name}/b>]
        def BlendShape "s" {{
            uniform vector3f[] offsets = [(0, 0, 1)]
            uniform vector3f[] normalOffsets = [(0, 1, 0)]
            uniform int[] pointIndices = [2]
        }}
        def BlendShape "b" {{
            uniform vector3f[] offsets = [(1, 0, 0), (1, 0, 0), (1, 0, 0), (1, 0, 0)]
        }}
""",
        )

    anim = """
        rel skel:animationSource = </Root/Skel/Anim>
        def SkelAnimation "Anim"
        {
            uniform token[] blendShapes = ["blink", "nobody", "smile"]
            float[] blendShapeWeights.timeSamples = { 0: [0, 5, 0], 24: [1, 5, 0.5] }
        }
"""
    path = usda(tmp_path / "a.usda", root(skeleton(more=anim), shaped("A"), shaped("B")))
    scene = read(path)
    character = scene.character
    assert character.morph_names == ("smile", "blink")
    weights = sample_morphs(scene.animations[0], character.morph_names, np.array([0.5]))
    np.testing.assert_allclose(weights, [[0.25, 0.5]])
    for name, expected in theirs(path, [12.0]).items():
        part = next(p for p in character.parts if name.endswith(p.name))
        np.testing.assert_allclose(ours(scene, part, 12.0), expected[0], atol=1e-6)
    morphs = character.parts[0].morphs
    assert morphs is not None and morphs.normal_deltas is not None
    np.testing.assert_allclose(morphs.normal_deltas[0], [0, 1, 0])


# --- animations -------------------------------------------------------------------------------------------------------


def test_animations_that_wait_are_clips_of_their_own(tmp_path: Path) -> None:
    waiting = BENT.split("\n", 2)[2].replace('"Anim"', '"Spare"').replace("24:", "48:")
    scene = read(usda(tmp_path / "a.usda", root(skeleton(more=BENT)) + waiting))
    assert [(a.name, a.duration_s) for a in scene.animations] == [("Anim", 1.0), ("Spare", 2.0)]


def test_a_resting_animation_keeps_its_length(tmp_path: Path) -> None:
    still = """
        rel skel:animationSource = </Root/Skel/Anim>
        def SkelAnimation "Anim"
        {
            uniform token[] joints = ["a", "a/b"]
            float3[] translations.timeSamples = { 12: [(0, 0, 0), (0, 1, 0)], 36: [(0, 0, 0), (0, 1, 0)] }
        }
"""
    (clip,) = read(usda(tmp_path / "a.usda", root(skeleton(more=still)))).animations
    assert (clip.start_s, clip.end_s, len(clip.curves)) == (0.5, 1.5, 1)


def test_samples_that_do_not_fit_are_told(tmp_path: Path) -> None:
    bad = BENT.replace("24: [(0, 1, 0), (0, 0, 3)]", "24: [(0, 1, 0)]").replace(
        "half3[] scales = [(1, 1, 1), (1, 1, 1)]", "half3[] scales = [(1, 1, 1)]"
    )
    scene = read(usda(tmp_path / "a.usda", root(skeleton(more=bad))))
    notes = " ".join(scene.notes)
    assert "translations are of different sizes" in notes and "1 scales for 2" in notes
    assert {c.property for c in scene.animations[0].curves} == {Property.ROTATION}


# --- materials --------------------------------------------------------------------------------------------------------


def test_pictures_beside_the_file_and_elsewhere(tmp_path: Path) -> None:
    texture = """
    def Shader "t"
    {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @%s@
        float4 inputs:scale = (0.5, 1, 1, 1)
        float2 inputs:st.connect = </look/r.outputs:result>
        float3 outputs:rgb
    }
    def Shader "r"
    {
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "picture"
        float2 outputs:result
    }
"""
    look = _material("look", "(1, 1, 1)").replace(
        "color3f inputs:diffuseColor = (1, 1, 1)", "color3f inputs:diffuseColor.connect = </look/t.outputs:rgb>"
    )
    uvs = """
        texCoord2f[] primvars:a = [(0, 0), (0, 0), (0, 0), (0, 0)] (interpolation = "vertex")
        texCoord2f[] primvars:picture = [(0, 1), (1, 1), (1, 0), (0, 0)] (interpolation = "vertex")
"""
    folder = tmp_path / "in"
    folder.mkdir()
    for place in (folder, tmp_path):
        (place / "skin.png").write_bytes(PNG)
    (folder / "note.png").write_text("no picture")
    text = look.rstrip().removesuffix("}") + texture + "}\n"
    body = f'def Mesh "m" (prepend apiSchemas = ["MaterialBindingAPI"]) {{{SQUARE}{uvs}    rel material:binding = </look>\n}}\n'
    for file, data, word in (
        ("./skin.png", PNG, ""),
        ("skin.png", PNG, ""),
        ("../skin.png", None, "leads out"),
        (f"{tmp_path}/skin.png", None, "leads out"),
        ("none.png", None, "not there"),
        ("note.png", None, "neither PNG nor JPEG"),
    ):
        scene = read(usda(folder / "a.usda", body + text % file))
        part = scene.character.parts[0]
        image = part.material.base_color_image
        assert image is not None and image.data == data and image.name == Path(file).name
        assert bool(word) == any(word in note for note in scene.notes if "picture" in note)
        np.testing.assert_allclose(part.mesh.uvs, [[0, 0], [1, 0], [1, 1], [0, 1]])
        assert part.material.base_color == (0.5, 1, 1, 1)


def test_other_shaders_and_plain_colours(tmp_path: Path) -> None:
    other = _material("fancy", "(1, 0, 0)").replace("UsdPreviewSurface", "Arnold")
    colored = '        color3f[] primvars:displayColor = [(0.25, 0.5, 0.75)] (interpolation = "constant")\n'
    scene = read(usda(tmp_path / "a.usda", f'def Mesh "m" {{{SQUARE}{colored}}}\n'))
    assert scene.character.parts[0].material.base_color == (0.25, 0.5, 0.75, 1.0)
    bound = f'def Mesh "m" (prepend apiSchemas = ["MaterialBindingAPI"]) {{{SQUARE}    rel material:binding = </fancy>\n}}\n'
    scene = read(usda(tmp_path / "a.usda", bound + other))
    assert scene.character.parts[0].material.name == "fancy" and any("'Arnold'" in n for n in scene.notes)


# --- layers and packages ----------------------------------------------------------------------------------------------


def test_other_layers_are_read_only_inside_the_folder(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    (folder / "below").mkdir(parents=True)
    for place, name in ((folder / "below", "good"), (tmp_path, "outside"), (folder, "chain")):
        usda(place / f"{name}.usda", f'def Xform "x"\n{{\n    def Xform "{name}" {{}}\n}}\n')
    (folder / "link.usda").symlink_to(tmp_path / "outside.usda")
    (folder / "chain.usda").write_text(
        '#usda 1.0\ndef "x" (references = @../outside.usda@</x>)\n{\n    def Xform "chain" {}\n}\n'
    )
    for arc in ("references", "payload"):
        for asset, inside in (
            ("./below/good.usda", True),
            ("chain.usda", True),
            ("../outside.usda", False),
            (f"{tmp_path}/outside.usda", False),
            ("link.usda", False),
            ("/etc/passwd", False),
            ("`'../outside.usda'`", False),
        ):
            path = usda(folder / "a.usda", f'def Xform "top" ({arc} = @{asset}@</x>) {{}}\n')
            scene = read(path)
            names = scene.character.skeleton.names
            assert "outside" not in names
            assert (len(names) > 1) == inside, (arc, asset, scene.notes)
            assert inside == (not any(asset[:200] in n and "leads out" in n for n in scene.notes))
            if asset == "chain.usda":
                assert any("../outside.usda" in n for n in scene.notes)
    missing = usda(folder / "a.usda", 'def Xform "top" (references = @gone.usda@) {}\n')
    assert any("'gone.usda' is not there" in n for n in read(missing).notes)
    (folder / "a.usda").write_text("#usda 1.0\n(\n    subLayers = [@../outside.usda@, @below/good.usda@]\n)\n")
    assert set(read(folder / "a.usda").character.skeleton.names) == {"x", "good"}
    hidden = 'def Xform "t" (variants = { string v = "b" }\n prepend variantSets = "v") {\n variantSet "v" = { "b" (references = @../outside.usda@</x>) {} }\n}\n'
    assert "outside" not in read(usda(folder / "a.usda", hidden)).character.skeleton.names


def test_layers_that_refer_to_themselves(tmp_path: Path) -> None:
    usda(tmp_path / "a.usda", 'def Xform "a" (references = @b.usda@</b>) {}\n')
    usda(tmp_path / "b.usda", 'def Xform "b" (references = @a.usda@</a>) {}\n')
    try:
        assert read(tmp_path / "a.usda").character.skeleton.names[0] == "a"
    except FormatError as error:
        assert "a.usda" in str(error)


@pytest.mark.slow
def test_a_laugh_of_references_is_refused_in_time(tmp_path: Path) -> None:
    """Each level refers to the one below ten times: 10 to the power of 8 prims from 3 kB."""
    text = 'def Xform "l0" {}\n'
    for level in range(1, 9):
        inner = "".join(f'    def "c{k}" (references = </l{level - 1}>) {{}}\n' for k in range(10))
        text += f'def Xform "l{level}" {{\n{inner}}}\n'
    with pytest.raises(FormatError, match=r"a\.usda: .*(more than|memory|too long|gave up)"):
        read(usda(tmp_path / "a.usda", text))


def test_value_clips_are_refused(tmp_path: Path) -> None:
    text = """
def Xform "a" (
    clips = {
        dictionary default = {
            asset[] assetPaths = [@/etc/x.usda@]
            string primPath = "/a"
        }
    }
)
{
}
"""
    with pytest.raises(FormatError, match=r"/a: it takes its samples from other files"):
        read(usda(tmp_path / "a.usda", text))


def package(path: Path, files: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return path


LAYER = (HEAD.format(unit=1, up="Y", rate=24) + 'def Xform "a" {}\n').encode()


@pytest.mark.parametrize(
    ("files", "method", "message"),
    [
        ({"a.usda": LAYER * 50}, zipfile.ZIP_DEFLATED, r"'a\.usda': it is compressed"),
        ({"a.usda": LAYER, "../x.png": b"1"}, zipfile.ZIP_STORED, "leads out of the package"),
        ({"a.usda": LAYER, "/etc/x": b"1"}, zipfile.ZIP_STORED, "leads out of the package"),
        ({"a.usda": LAYER, "C:\\x": b"1"}, zipfile.ZIP_STORED, "leads out of the package"),
        ({"a.png": b"1", "a.usda": LAYER}, zipfile.ZIP_STORED, "no USD layer"),
        ({f"{n}.usda": b"" for n in range(10_001)}, zipfile.ZIP_STORED, "10,001 files"),
    ],
)
def test_packages_that_are_no_usdz(files: dict[str, bytes], method: int, message: str, tmp_path: Path) -> None:
    path = package(tmp_path / "a.usdz", files, method)
    with pytest.raises(FormatError, match=message):
        read(path)


def test_packages_that_lie_about_their_sizes(tmp_path: Path) -> None:
    path = package(tmp_path / "a.usdz", {"a.usda": LAYER})
    data = bytearray(path.read_bytes())
    at = data.rindex(b"PK\x01\x02")
    data[at + 20 : at + 28] = struct.pack("<II", 1 << 31, 1 << 31)
    path.write_bytes(data)
    with pytest.raises(FormatError, match=r"claims 2,147,483,648 bytes"):
        read(path)
    path.write_bytes(bytes(data[: at - 3]))
    with pytest.raises(FormatError, match=r"directory"):
        read(path)


def test_content_and_name(tmp_path: Path) -> None:
    path = usda(tmp_path / "a.usda", 'def Xform "x" {}\n')
    for name, right in (("b.usd", True), ("b.usdc", False), ("b.usdz", False), ("b.bin", False)):
        (tmp_path / name).write_bytes(path.read_bytes())
        if right:
            assert keypose.io.load(tmp_path / name).character.skeleton.names == ("x",)
        else:
            with pytest.raises(
                FormatError, match=r"it is usda, which is read only under a name ending in \.usda or \.usd"
            ):
                keypose.io.load(tmp_path / name)


def test_damage_is_told_with_its_place(tmp_path: Path) -> None:
    (tmp_path / "a.usda").write_text('#usda 1.0\ndef Xform "a"\n{\n    int b = = 3\n}\n')
    with pytest.raises(FormatError, match=r"a\.usda: line 4\b.*: (Expected|syntax error)"):
        read(tmp_path / "a.usda")
    (tmp_path / "a.usdc").write_bytes(
        b"PXR-USDC" + bytes([0, 8, 0, 0, 0, 0, 0, 0]) + struct.pack("<Q", 1 << 40) + bytes(80)
    )
    with pytest.raises(FormatError, match=r"a\.usdc: byte \d+: "):
        read(tmp_path / "a.usdc")
    for text, message in (
        ("[0, 1, 2, 9]", "vertex 9 does not exist; there are 4"),
        ("[0, 1, 2]", "4 corners, 3 are there"),
        ("[0, 1, 2, -1]", "vertex -1"),
    ):
        broken = f'def Mesh "m" {{{SQUARE.replace("[0, 1, 2, 3]", text)}}}\n'
        with pytest.raises(FormatError, match=rf"mesh 'm': .*{message}"):
            read(usda(tmp_path / "a.usda", broken))


# --- the process ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mishap", "message"),
    [
        ("os.abort()", "SIGABRT"),
        ("os.kill(os.getpid(), 11)", "SIGSEGV"),
        ("while True: pass", "too long"),
        ("x = bytearray(1 << 40)", "too much memory"),
    ],
)
def test_a_process_that_dies_refuses_only_its_file(
    mishap: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = process.CHILD.read_text(encoding="utf-8")
    head = '    """What a file holds."""\n'
    assert head in source
    child = tmp_path / "child.py"
    child.write_text(
        source.replace(head, f"{head}    if path.endswith('b.usda'):\n        {mishap}\n"), encoding="utf-8"
    )
    monkeypatch.setattr(process, "CHILD", child)
    monkeypatch.setattr(process, "LIMITS", guarded.Limits(700 << 20, base_cpu_s=1.0))
    paths = [usda(tmp_path / f"{name}.usda", f'def Xform "{name}" {{}}\n') for name in "abc"]
    results = list(read_many(paths))
    assert [r.character.name if not isinstance(r, FormatError) else "" for r in results] == ["a", "", "c"]
    assert message in str(results[1]) and "b.usda" in str(results[1])


def test_the_module_of_the_process_stands_alone() -> None:
    lines = [line.strip() for line in process.CHILD.read_text(encoding="utf-8").splitlines()]
    imports = [line for line in lines if line.startswith(("import ", "from "))]
    assert imports and not any("keypose" in line for line in imports)


def test_deform_of_an_instance_uses_its_own_joint(tmp_path: Path) -> None:
    text = (
        'def Xform "a" { double3 xformOp:translate = (3, 0, 0)\n uniform token[] xformOpOrder = ["xformOp:translate"]\n'
    )
    scene = read(usda(tmp_path / "a.usda", text + f'    def Mesh "m" {{{SQUARE}}}\n}}\n'))
    (part,) = scene.character.parts
    assert scene.character.skeleton.names == ("a",) and part.joint == 0
    at = world(scene.character.skeleton, scene.character.skeleton.rest)
    np.testing.assert_allclose(deform_part(scene.character, part, at)[0], [3, 0, 0])


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
