"""Reading FBX: facts of real files, files made node by node, and a reader that no file can take along."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import keypose.io
from keypose.deform import deform_character, deform_part
from keypose.errors import FormatError, MissingExtra
from keypose.evaluate import sample, sample_morphs, world
from keypose.io import guarded
from keypose.io.fbx import process, read, read_many
from keypose.io.fbx.morphs import effective_weights
from keypose.model import Channel, Property
from tests.conftest import data_files, find_data_dir
from tests.io.fbx_files import SQUARE, FbxFile

pytest.importorskip("ufbx")

REAL = data_files("**/*.fbx")


def _facts() -> dict[str, tuple[str, int, int, int]]:
    """Of each file: encoding, version, bones and blend channels, as the data folder's README counts their names."""
    folder = find_data_dir()
    text = (folder / "README.md").read_text(encoding="utf-8") if folder else ""
    pattern = re.compile(
        r"\| `([^`]+\.fbx)`.*\| (ascii|binary) (\d+).*LimbNode (\d+), Cluster \d+, BlendShapeChannel (\d+)"
    )
    return {m[1]: (m[2], int(m[3]), int(m[4]), int(m[5])) for m in pattern.finditer(text)}


@pytest.fixture(scope="module")
def real_scenes(data_dir: Path) -> dict[Path, Any]:
    return dict(zip(REAL, read_many(REAL), strict=True))


@pytest.mark.data
@pytest.mark.parametrize("path", REAL, ids=lambda p: p.stem)
def test_real_files_have_their_facts(path: Path, real_scenes: dict[Path, Any]) -> None:
    folder = find_data_dir()
    assert folder is not None
    facts = _facts()
    name = next(n for n in facts if n.endswith("/" + path.name))
    encoding, version, bones, channels = facts[name]
    scene = real_scenes[path]
    assert not isinstance(scene, FormatError), scene
    about, character = scene.extras["fbx"], scene.character
    assert (about["encoding"], about["version"]) == (encoding, version)
    found = len(character.extras["fbx"]["bones"])
    if encoding == "binary":  # the kind of a node stands behind its name
        models = re.findall(rb"\x00\x01ModelS....(LimbNode|Limb|Root)", path.read_bytes(), re.DOTALL)
        assert found == len(models)
    if version >= 7000:  # the word stands twice for each such bone: at the model and at its attribute
        assert found >= bones // 2
        assert len(character.morph_names) == channels
    else:
        assert (found > 0) == (bones > 0)
    assert scene.format == "fbx"
    for part in character.parts:
        assert np.isfinite(part.mesh.positions).all()
        np.testing.assert_allclose(np.linalg.norm(part.mesh.normals, axis=1), 1, atol=1e-5)
        if part.skin is not None:
            np.testing.assert_allclose(part.skin.weights.sum(axis=1), 1, atol=1e-5)


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "height_m"),
    [("geno/Geno", 1.71), ("ozz_pab/arnaud", 1.83), ("ozz_pab/skeleton", 1.83)],
)
def test_characters_stand_upright_on_the_ground_and_face_forward(name: str, height_m: float, data_dir: Path) -> None:
    """Y up, metres, toes in front of the heels; heights as seen in the tools that made them, within 6 %."""
    character = read(data_dir / "fbx" / f"{name}.fbx").character
    points = np.concatenate(deform_character(character, world(character.skeleton, character.skeleton.rest)))
    low, high = points.min(axis=0), points.max(axis=0)
    assert abs(low[1]) < 0.03
    assert high[1] == pytest.approx(height_m, rel=0.06)
    assert high[1] > high[2] - low[2]
    at = dict(zip(character.skeleton.names, world(character.skeleton, character.skeleton.rest)[:, :3, 3], strict=True))
    toes = [p for name, p in at.items() if re.search(r"toe|footthumb", name, re.IGNORECASE)]
    feet = [p for name, p in at.items() if re.search(r"foot$", name, re.IGNORECASE)]
    assert np.mean(toes, axis=0)[2] > np.mean(feet, axis=0)[2] + 0.05
    left, right = (
        next(p for n, p in at.items() if re.search(f"{side}.?(up)?leg", n, re.IGNORECASE)) for side in ("left", "right")
    )
    assert left[0] > right[0]


@pytest.mark.data
def test_ascii_and_binary_of_one_animation_agree(data_dir: Path) -> None:
    folder = data_dir / "fbx" / "ufbx_anim"
    clips = [read(folder / f"maya_interpolation_modes_7500_{kind}.fbx").animation() for kind in ("ascii", "binary")]
    assert clips[0].curves.keys() == clips[1].curves.keys() and clips[0].curves
    for channel, curve in clips[0].curves.items():
        np.testing.assert_allclose(curve.times_s, clips[1].curves[channel].times_s)
        np.testing.assert_allclose(curve.values, clips[1].curves[channel].values, atol=1e-8)


@pytest.mark.data
def test_takes_rates_and_layers_of_real_files(data_dir: Path) -> None:
    folder = data_dir / "fbx"
    blender = read(folder / "ufbx_skin" / "blender_279_sausage_7400_binary.fbx")
    assert [c.name for c in blender.animations] == ["Skeleton|Base", "Skeleton|Spin", "Skeleton|Wiggle"]
    assert {c.rate_hz for c in blender.animations} == {24.0}
    walk = read(folder / "ozz_pab" / "walk.fbx").animation()
    assert walk.rate_hz == 30.0 and walk.duration_s == pytest.approx(4 / 3)
    layers = read(folder / "ufbx_anim" / "maya_anim_layers_7500_binary.fbx")
    assert any("3 layers were baked" in note for note in layers.notes)
    inch = read(folder / "ozz" / "cube.fbx")
    assert inch.unit_m == pytest.approx(0.0254)


# --- files made node by node ------------------------------------------------------------------------------------------


def test_units_hierarchy_and_instances(tmp_path: Path) -> None:
    file = FbxFile({"UnitScaleFactor": 2.54})
    top = file.model("top", kind="Null", Lcl_Translation=(10, 0, 0))
    one = file.model("one", top, Lcl_Translation=(0, 5, 0))
    two = file.model("two", top, Lcl_Scaling=(2, 2, 2))
    file.mesh(one, two)
    scene = read(file.save(tmp_path / "a.fbx"))
    character = scene.character
    assert character.skeleton.names == ("top", "one", "two")
    assert character.skeleton.parents.tolist() == [-1, 0, 0]
    assert scene.unit_m == pytest.approx(0.0254)
    at = world(character.skeleton, character.skeleton.rest)
    first, second = (deform_part(character, part, at) for part in character.parts)
    np.testing.assert_allclose(first, np.add(SQUARE, [10, 5, 0]) * 0.0254, atol=1e-7)
    np.testing.assert_allclose(second, (SQUARE * 2 + [10, 0, 0]) * 0.0254, atol=1e-7)


def test_geometric_transform_moves_the_mesh_but_not_the_children(tmp_path: Path) -> None:
    file = FbxFile()
    node = file.model("node", GeometricTranslation=(0, 0, 7), GeometricScaling=(1, 3, 1))
    file.model("child", node, "Null", Lcl_Translation=(1, 0, 0))
    file.mesh(node)
    character = read(file.save(tmp_path / "a.fbx")).character
    at = world(character.skeleton, character.skeleton.rest)
    np.testing.assert_allclose(at[1, :3, 3], [0.01, 0, 0])
    np.testing.assert_allclose(
        deform_part(character, character.parts[0], at), (SQUARE * [1, 3, 1] + [0, 0, 7]) * 0.01, atol=1e-8
    )


@pytest.mark.parametrize(
    ("axes", "matrix"),
    [
        # Z up, the front at -Y, as Blender and 3ds Max have it
        ({"UpAxis": 2, "FrontAxis": 1, "FrontAxisSign": -1}, [[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
        ({"UpAxis": 1, "FrontAxis": 2, "FrontAxisSign": -1, "CoordAxisSign": -1}, [[-1, 0, 0], [0, 1, 0], [0, 0, -1]]),
        # left-handed: what the file calls right is ours too, so that the world is mirrored as a whole
        ({"CoordAxisSign": -1}, [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    ],
    ids=["z-up", "turned", "left-handed"],
)
def test_axes(axes: dict[str, int], matrix: Any, tmp_path: Path) -> None:
    file = FbxFile(dict(axes))
    top = file.model("top", Lcl_Translation=(1, 2, 3), Lcl_Rotation=(20, 30, 40))
    node = file.model("node", top, Lcl_Translation=(3, 1, 2), Lcl_Rotation=(50, -10, 20))
    file.mesh(node, positions=np.add(SQUARE, [5, 6, 7]))
    path = file.save(tmp_path / "a.fbx")
    plain = read(FbxFile({}, file.objects, file.connections).save(tmp_path / "plain.fbx")).character
    character = read(path).character
    expected, found = (deform_part(c, c.parts[0], world(c.skeleton, c.skeleton.rest)) for c in (plain, character))
    np.testing.assert_allclose(found, expected @ np.array(matrix).T, atol=1e-7)
    for c in (plain, character):  # and the surface keeps its outside
        mesh = c.parts[0].mesh
        a, b, d = (mesh.positions[mesh.triangles[0, i]] for i in range(3))
        assert np.cross(b - a, d - a) @ mesh.normals[mesh.triangles[0, 0]] > 0


def test_pre_and_post_rotation(tmp_path: Path) -> None:
    """local = Rpre R Rpost^-1, from the documentation of FbxNode."""
    from keypose.math import euler, quat

    file = FbxFile()
    angles = {"PreRotation": (10, 20, 30), "Lcl_Rotation": (40, -50, 60), "PostRotation": (-70, 15, 25)}
    file.model("a", kind="LimbNode", RotationActive=1, **angles)
    character = read(file.save(tmp_path / "a.fbx")).character
    pre, local, post = (euler.to_quat(np.radians(v), "xyz") for v in angles.values())
    expected = quat.multiply(quat.multiply(pre, local), quat.conjugate(post))
    assert abs(quat.angle_between(character.skeleton.rest.rotations[0], expected)) < 1e-7


def test_a_rotation_order_that_is_not_active_does_not_count_in_motion_either(tmp_path: Path) -> None:
    from keypose.math import euler, quat

    file = FbxFile()
    node = file.model("a", RotationOrder=3, Lcl_Rotation=(30, 40, 50), RotationPivot=(1, 2, 3))
    file.mesh(node)
    layer = file.stack("take", 0, 1)
    file.curve(node, "Lcl Rotation", "d|X", [(0, 30), (1, 90)], layer, (30, 40, 50))
    scene = read(file.save(tmp_path / "a.fbx"))
    pose = sample(scene.animation(), scene.character.skeleton, np.array([0.0, 0.5, 1.0]))
    for k, x in enumerate((30, 60, 90)):
        expected = euler.to_quat(np.radians([x, 40, 50]), "xyz")
        assert abs(quat.angle_between(pose.rotations[k, 0], expected)) < 1e-6
        pivot = np.array([1, 2, 3]) * 0.01
        np.testing.assert_allclose(pose.broadcast().translations[k, 0], pivot - quat.rotate(expected, pivot), atol=1e-8)


@pytest.mark.parametrize("up", [1, 2])
def test_takes_of_nodes_with_pivots_do_not_mix(up: int, tmp_path: Path) -> None:
    """A node that turns about a pivot moves by that alone, whatever other takes do with its place."""
    from keypose.math import euler, quat

    rng = np.random.default_rng(4)
    z_up = {"UpAxis": 2, "FrontAxis": 1, "FrontAxisSign": -1}
    file = FbxFile(settings=z_up if up == 2 else {})
    names = ("Lcl_Translation", "RotationPivot", "RotationOffset", "ScalingPivot", "ScalingOffset")
    nodes = []
    for k in range(120):
        values = {name: tuple(rng.uniform(-3, 3, 3).round(3)) for name in names}
        values |= {"Lcl_Rotation": (10.0, 20.0, 30.0), "Lcl_Scaling": (1.5, 0.5, 2.0)}
        if k % 2:
            values["PostRotation"] = (20.0, -30.0, 40.0)
        nodes.append((file.model(f"n{k}", RotationActive=1, **values), values))
        file.mesh(nodes[-1][0])
    turned = set(rng.permutation(120)[:60].tolist())
    for name in ("places", "turns", "more"):
        layer = file.stack(name, 0, 1)
        placed = set(rng.permutation(120)[:50].tolist()) - (turned if name == "turns" else set())
        for k, (node, values) in enumerate(nodes):
            if k in placed:
                file.curve(node, "Lcl Translation", "d|Y", [(0, 5), (1, 9)], layer, values["Lcl_Translation"])
            if k in turned and name == "turns":
                file.curve(node, "Lcl Rotation", "d|X", [(0, 0), (1, 80)], layer, values["Lcl_Rotation"])
    scene = read(file.save(tmp_path / "a.fbx"))
    pose = sample(scene.animation("turns"), scene.character.skeleton, np.array([0.0, 0.5, 1.0])).broadcast()
    flat = euler.to_quat(np.radians([-90.0, 0, 0]), "xyz") if up == 2 else np.array([1.0, 0, 0, 0])
    for k, (_, values) in enumerate(nodes):
        place, pivot, offset, scale_pivot, scale_offset = (np.array(values[name]) for name in names)
        if k not in turned:
            continue
        for frame, x in enumerate((0, 40, 80)):
            post = euler.to_quat(np.radians(values.get("PostRotation", (0, 0, 0))), "xyz")
            turn = quat.multiply(euler.to_quat(np.radians([x, 20, 30]), "xyz"), quat.conjugate(post))
            arm = scale_offset + scale_pivot * (1 - np.array([1.5, 0.5, 2.0])) - pivot
            expected = 0.01 * quat.rotate(flat, place + offset + pivot + quat.rotate(turn, arm))
            joint = scene.character.skeleton.index(f"n{k}")
            np.testing.assert_allclose(pose.translations[frame, joint], expected, atol=1e-6)


def test_layers_that_turn_such_a_node_are_kept_with_a_note(tmp_path: Path) -> None:
    file = FbxFile()
    node = file.model("a", RotationOrder=3, Lcl_Rotation=(30, 40, 50))
    file.mesh(node)
    layer = file.stack("take", 0, 1)
    second, _ = file.add("AnimationLayer", "second", "", "AnimLayer")
    stack = next(o for o in file.objects if o.name == "AnimationStack")
    file.connect(second, int.from_bytes(stack.properties[0][1:], "little"))
    for number in (layer, second):
        file.curve(node, "Lcl Rotation", "d|X", [(0, 0), (1, 10)], number, (0, 0, 0))
    scene = read(file.save(tmp_path / "a.fbx"))
    assert scene.animation("take").curves
    assert any("several layers turn it" in note for note in scene.notes)


def test_in_betweens_become_targets_of_their_own(tmp_path: Path) -> None:
    """At weight 25 % half of the shape of 50 % is seen, at 75 % half of each, at 100 % the last alone."""
    half, full = np.tile([0, 0, 3.0], (4, 1)), np.tile([0, 4.0, 0], (4, 1))
    file = FbxFile()
    node = file.model("a")
    geometry = file.mesh(node)
    channel = file.blend_shapes(geometry, "smile", [(50, half), (100, full)], weight=75.0)
    layer = file.stack("take", 0, 1)
    file.curve(channel, "DeformPercent", "d|DeformPercent", [(0, 0.0), (1, 100.0)], layer)
    scene = read(file.save(tmp_path / "a.fbx"))
    character = scene.character
    assert character.morph_names == ("smile@0.5", "smile")
    at = world(character.skeleton, character.skeleton.rest)
    np.testing.assert_allclose(
        deform_part(character, character.parts[0], at), (SQUARE + 0.5 * half + 0.5 * full) * 0.01, atol=1e-7
    )
    times = np.array([0.25, 0.5, 0.75, 1.0])
    weights = sample_morphs(scene.animation(), character.morph_names, times)
    np.testing.assert_allclose(weights, [[0.5, 0], [1, 0], [0.5, 0.5], [0, 1]], atol=1e-6)
    assert any("in-between" in note for note in scene.notes)


def test_effective_weights_are_piecewise_linear_on_both_sides_of_zero() -> None:
    keys = [(-1.0, 0), (0.5, 1), (1.0, 2)]
    weights = np.array([-2, -1, -0.5, 0, 0.25, 0.5, 0.75, 1, 1.5])
    found = np.stack(effective_weights(keys, weights))
    np.testing.assert_allclose(found[0], [2, 1, 0.5, 0, 0, 0, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(found[1], [0, 0, 0, 0, 0.5, 1, 0.5, 0, -1], atol=1e-12)
    np.testing.assert_allclose(found[2], [0, 0, 0, 0, 0, 0, 0.5, 1, 2], atol=1e-12)


def test_constant_tracks_have_one_key_and_what_rests_has_none(tmp_path: Path) -> None:
    file = FbxFile()
    node = file.model("a", kind="LimbNode", Lcl_Translation=(1, 0, 0))
    layer = file.stack("take", 0, 1)
    file.curve(node, "Lcl Translation", "d|X", [(0, 1.0), (1, 1.0)], layer, (1, 0, 0))
    file.curve(node, "Lcl Rotation", "d|Y", [(0, 30.0), (1, 30.0)], layer, (0, 30, 0))
    file.curve(node, "Lcl Scaling", "d|Z", [(0, 1.0), (1, 2.0)], layer, (1, 1, 1))
    clip = read(file.save(tmp_path / "a.fbx")).animation()
    assert {c.property: curve.key_count for c, curve in clip.curves.items()} == {
        Property.ROTATION: 1,
        Property.SCALE: 25,
    }
    np.testing.assert_allclose(clip.curves[Channel("a", Property.SCALE)].values[12], [1, 1, 1.5], atol=1e-6)


def test_polygons_that_are_not_convex_are_cut_inside(tmp_path: Path) -> None:
    """An arrow of four and a U of eight corners; the areas of the triangles sum to that of the polygon."""
    arrow = np.array([[0, 0, 0], [2, -1, 0], [0, 2, 0], [-2, -1, 0]], np.float64)
    u = np.array([[0, 0], [3, 0], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]], np.float64)
    for points, area in ((arrow, 4.0), (np.c_[u, np.zeros(8)], 7.0), (np.c_[u, np.zeros(8)][:, [2, 0, 1]], 7.0)):
        for turned in (points, points[::-1], np.roll(points, 1, axis=0)):
            file = FbxFile()
            file.mesh(file.model("a"), positions=turned, polygons=[list(range(len(turned)))])
            mesh = read(file.save(tmp_path / "a.fbx")).character.parts[0].mesh
            a, b, c = (np.asarray(mesh.positions, np.float64)[mesh.triangles[:, i]] for i in range(3))
            crosses = np.cross(b - a, c - a) / 2
            assert len(crosses) == len(points) - 2
            assert np.linalg.norm(crosses, axis=1).sum() == pytest.approx(area * 1e-4, rel=1e-5)
            assert np.linalg.norm(crosses.sum(axis=0)) == pytest.approx(area * 1e-4, rel=1e-5)


def test_names_that_repeat_are_told_apart(tmp_path: Path) -> None:
    file = FbxFile()
    file.model("arm", file.model("arm", kind="Null"), "Null")
    scene = read(file.save(tmp_path / "a.fbx"))
    assert scene.character.skeleton.names == ("arm", "arm_2")
    assert any("more than once" in note for note in scene.notes)


def test_a_take_without_end_is_refused_by_name(tmp_path: Path) -> None:
    file = FbxFile()
    node = file.model("a")
    file.curve(node, "Lcl Translation", "d|X", [(0, 0.0), (1, 1.0)], file.stack("endless", 0, 1e8))
    with pytest.raises(FormatError, match=r"endless.*frames"):
        read(file.save(tmp_path / "a.fbx"))


# --- the process ------------------------------------------------------------------------------------------------------


def test_ufbx_is_never_imported_here(tmp_path: Path) -> None:
    file = FbxFile()
    file.mesh(file.model("a"))
    path = file.save(tmp_path / "a.fbx")
    code = f"import sys, keypose.io; keypose.io.load({str(path)!r}); sys.exit('ufbx' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_without_ufbx_the_message_says_how_to_install_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = FbxFile().save(tmp_path / "a.fbx")
    monkeypatch.setattr(process.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingExtra, match=r"pip install 'keypose\[fbx\]'"):
        read(path)


def _files(folder: Path, names: str) -> list[Path]:
    paths = []
    for name in names:
        file = FbxFile()
        file.mesh(file.model(name))
        paths.append(file.save(folder / f"{name}.fbx"))
    return paths


@pytest.mark.parametrize(
    ("mishap", "message"),
    [
        ("import os; os.abort()", "SIGABRT"),
        ("import os; os.kill(os.getpid(), 11)", "SIGSEGV"),
        ("import sys; sys.exit(3)", "code 3"),
        ("while True: pass", "too long"),
        ("x = bytearray(1 << 40)", "too much memory"),
        ("import os; out.write(b'array   ' + bytes(6))\n        out.flush()\n        os._exit(0)", "code 0"),
    ],
)
def test_a_process_that_dies_refuses_only_its_file(
    mishap: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reader that comes to grief at one file; the ones before and after it are read."""
    source = process.CHILD.read_text(encoding="utf-8")
    head = '    """What a file holds, in its own unit, Y up and facing +Z."""\n'
    assert head in source
    wicked = f"{head}    out = record._out\n    if path.endswith('c.fbx'):\n        {mishap}\n"
    child = tmp_path / "child.py"
    child.write_text(source.replace(head, wicked), encoding="utf-8")
    monkeypatch.setattr(process, "CHILD", child)
    monkeypatch.setattr(process, "BASE_CPU_S", 1.0)
    results = list(read_many(_files(tmp_path, "abcde")))
    assert [isinstance(r, FormatError) for r in results] == [False, False, True, False, False]
    assert [r.character.skeleton.names[0] for r in results if not isinstance(r, FormatError)] == list("abde")
    assert message in str(results[2]) and str(tmp_path / "c.fbx") in str(results[2])


def test_files_that_are_no_fbx_and_where_they_stop(tmp_path: Path) -> None:
    (whole,) = _files(tmp_path, "a")
    data = whole.read_bytes()
    cut = tmp_path / "cut.fbx"
    at = data.index(b"PolygonVertexIndex") + 30
    cut.write_bytes(data[:at])
    with pytest.raises(FormatError, match=rf"byte {at}, after node 'Objects/Geometry"):
        keypose.io.load(cut)
    text = tmp_path / "text.fbx"
    text.write_text("; FBX 7.4.0 project file\nObjects: {\n  Vertices: *3 {\n    a: 1,}2,3\n  }\n}\n", encoding="ascii")
    with pytest.raises(FormatError, match="line 6, a bracket that nothing opens"):
        keypose.io.load(text)
    other = tmp_path / "other.fbx"
    other.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    with pytest.raises(FormatError, match=r"other\.fbx"):
        keypose.io.load(other)


def test_the_module_of_the_process_stands_alone() -> None:
    """The process must not import keypose, whose import would be paid for at every file."""
    for module in (guarded.CHILD, process.CHILD):
        source = module.read_text(encoding="utf-8")
        lines = [line for line in source.splitlines() if line.lstrip().startswith(("import ", "from "))]
        assert lines and not any("keypose" in line for line in lines)
