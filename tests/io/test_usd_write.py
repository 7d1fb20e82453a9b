"""Writing USD: what is read back is what was written, by keypose and by usd-core, whose validators find nothing wrong."""

from __future__ import annotations

import doctest
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import keypose.io
from keypose.analysis import scene_error
from keypose.deform import deform_character
from keypose.errors import FormatError, MissingExtra, ShapeError, UnknownName
from keypose.evaluate import bake, sample_clip, sample_morphs, world
from keypose.io.usd import process, read, write
from keypose.math import quat
from keypose.model import (
    Channel,
    Character,
    Clip,
    Curve,
    CurveKind,
    Image,
    Interpolation,
    Material,
    Motion,
    Part,
    Pose,
    Property,
    Scene,
    Skeleton,
    SkinningMethod,
)
from keypose.samples import load as load_sample
from tests.conftest import ROOT, data_files
from tests.io.test_fbx_write import PNG, assert_same_vertices, small_character
from tests.io.usd_files import ours, theirs

pytest.importorskip("pxr")

SUFFIXES = ["usda", "usdc", "usdz", "usd"]


def assert_valid(path: Path) -> None:
    """All validators that come with usd-core are content."""
    from pxr import Usd

    try:
        from pxr import UsdValidation
    except ImportError:  # of an old usd-core
        return
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) >= 20
    stage = Usd.Stage.Open(str(path))
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [e.GetMessage() for e in errors] == []


def motion_of(character: Character, rng: np.random.Generator, rate: float, name: str = "jump") -> Motion:
    """Frames with large turns, moves, scales and weights."""
    frames, joints = 20, character.skeleton.joint_count
    turns = quat.normalize(np.cumsum(rng.normal(size=(frames, joints, 4)), axis=0))
    pose = Pose(rng.normal(size=(frames, joints, 3)), turns, np.exp(rng.normal(size=(frames, joints, 3)) * 0.1))
    weights = rng.normal(size=(frames, len(character.morph_names)))
    return Motion(character.skeleton.names, pose, rate, name, 0.5, character.morph_names, weights)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("unit", ["m", "cm"])
def test_a_character_comes_back(suffix: str, unit: str, tmp_path: Path) -> None:
    character = small_character(np.random.default_rng(3))
    path = tmp_path / f"a b.{suffix}"
    notes = keypose.io.save(character, path, unit=unit)
    assert [n for n in notes if "rest at 0" not in n] == []
    scene = keypose.io.load(path)
    assert scene.notes == () and scene.up == "Y" and scene.format == "usd"
    assert scene.unit_m == pytest.approx({"m": 1.0, "cm": 0.01}[unit])
    assert scene.extras["usd"]["encoding"] == ("usdc" if suffix == "usd" else suffix)
    back = scene.character
    a, b = character.skeleton, back.skeleton
    assert b.names == a.names and b.parents.tolist() == a.parents.tolist() and back.name == "small"
    np.testing.assert_allclose(b.rest.translations, a.rest.translations, atol=1e-12)
    np.testing.assert_allclose(b.rest.scales, a.rest.scales, atol=1e-12)
    assert np.max(quat.angle_between(b.rest.rotations, a.rest.rotations)) < 1e-7
    assert b.end_offsets[0][0] == 2
    np.testing.assert_allclose(b.end_offsets[0][1], a.end_offsets[0][1])
    assert dict(back.roles) == dict(character.roles)
    assert back.morph_names == character.morph_names
    np.testing.assert_allclose(back.rest_morph_weights, character.rest_morph_weights, atol=1e-7)
    assert_same_vertices(character, back)
    for p, q in zip(character.parts, back.parts, strict=True):
        np.testing.assert_array_equal(q.mesh.triangles, p.mesh.triangles)
        for name in ("normals", "uvs", "colors"):
            np.testing.assert_allclose(getattr(q.mesh, name), getattr(p.mesh, name), atol=1e-6)
        for name in ("name", "alpha_mode", "double_sided", "unlit"):
            assert getattr(q.material, name) == getattr(p.material, name)
        np.testing.assert_allclose(q.material.base_color, p.material.base_color, atol=1e-6)
        assert q.material.roughness == pytest.approx(p.material.roughness)
        assert (q.joint, q.group) == (p.joint, p.group)
    skin, copy = character.parts[0].skin, back.parts[0].skin
    assert skin is not None and copy is not None
    np.testing.assert_array_equal(copy.palette, skin.palette)
    np.testing.assert_array_equal(copy.joints, skin.joints)
    np.testing.assert_allclose(copy.joint_from_mesh, skin.joint_from_mesh, atol=1e-6)
    image = back.parts[0].material.base_color_image
    assert image is not None and (image.name, image.mime_type, image.data) == ("skin.png", "image/png", PNG)
    assert_valid(path)


@pytest.mark.parametrize("suffix", ["usda", "usdz"])
def test_usd_skel_computes_the_vertices_that_we_do(suffix: str, tmp_path: Path) -> None:
    """Of skins, morphs and carried parts, at frames and between them."""
    rng = np.random.default_rng(8)
    character = small_character(rng)
    motion = motion_of(character, rng, 30.0)
    pose = Pose(motion.pose.translations, motion.pose.rotations, np.ones((20, 4, 3)))  # theirs has scales in halves
    path = tmp_path / f"a.{suffix}"
    keypose.io.save([character, replace(motion, pose=pose)], path, unit="cm")
    scene = read(path)
    codes = [15.0, 20.0, 20.5, 34.0]
    expected = theirs(path, codes)
    assert len(expected) == len(character.parts) == 3
    for part, points in zip(scene.character.parts, expected.values(), strict=True):
        for code, theirs_then in zip(codes, points, strict=True):
            np.testing.assert_allclose(ours(scene, part, code), theirs_then, atol=2e-3)  # centimetres


@pytest.mark.parametrize("method", list(SkinningMethod))
def test_the_skinning_method_comes_back_and_is_what_usd_skel_does(method: SkinningMethod, tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    character = small_character(rng)
    body = character.parts[0]
    assert body.skin is not None
    plain = Pose(character.skeleton.rest.translations, character.skeleton.rest.rotations, np.ones((4, 3)))
    skeleton = Skeleton(character.skeleton.names, character.skeleton.parents, plain)
    character = replace(character, skeleton=skeleton, parts=(replace(body, skin=replace(body.skin, method=method)),))
    motion = motion_of(character, rng, 24.0)
    pose = Pose(motion.pose.translations, motion.pose.rotations, np.ones((20, 4, 3)))
    keypose.io.save([character, replace(motion, pose=pose)], tmp_path / "a.usdc")
    scene = read(tmp_path / "a.usdc")
    (part,) = scene.character.parts
    assert part.skin is not None and part.skin.method is method
    ((_, expected),) = theirs(tmp_path / "a.usdc", [14.0, 17.25]).items()
    for code, points in zip((14.0, 17.25), expected, strict=True):
        np.testing.assert_allclose(ours(scene, part, code), points, atol=2e-5)


@pytest.mark.parametrize("rate", [24.0, 30.0, 60.0, 29.97, 120.0, 37.5])
def test_motions_come_back_frame_by_frame(rate: float, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    character = small_character(rng)
    motion = motion_of(character, rng, rate)
    notes = write(Scene((character,), (motion,)), tmp_path / "a.usdc")
    assert any("half precision" in note for note in notes)
    scene = read(tmp_path / "a.usdc")
    clip = scene.animation("jump")
    assert isinstance(clip, Clip)
    assert clip.rate_hz == pytest.approx(rate) and clip.start_s == pytest.approx(0.5, abs=1e-9)
    back = bake(clip, scene.character.skeleton, rate, morph_names=scene.character.morph_names)
    assert back.frame_count == motion.frame_count
    np.testing.assert_allclose(back.pose.translations, motion.pose.translations, atol=1e-6)
    np.testing.assert_allclose(back.pose.scales, motion.pose.scales, atol=1e-6)
    assert np.degrees(np.max(quat.angle_between(back.pose.rotations, motion.pose.rotations))) < 1e-4
    weights = sample_morphs(clip, character.morph_names, motion.times_s)
    np.testing.assert_allclose(weights, motion.morph_weights, atol=1e-6)


def test_sparse_keys_steps_and_smooth_curves(tmp_path: Path) -> None:
    """Linear keys stay exact wherever they are, steps too; smooth curves are sampled finely."""
    character = small_character(np.random.default_rng(0))
    times = np.array([0.0, 0.1234, 1.0, 1.7])
    linear = Curve(times, np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 0, 3.0]]))
    step = Curve([0.0, 0.5, 1.5], [[0, 0, 0], [1, 1, 1], [2, 0, 0.0]], Interpolation.STEP)
    tangents = np.array([[0.0], [2.0]])
    smooth = Curve([0.0, 1.0], [[0.0], [1.0]], Interpolation.HERMITE, tangents, tangents, kind=CurveKind.SCALAR)
    turns = quat.from_axis_angle(np.eye(3)[[0, 1, 2, 0]], np.array([0.0, 2.0, 1.0, 3.0]))
    rotation = Curve(times + 0.05, turns, kind=CurveKind.ROTATION)
    clip = Clip(
        {
            Channel("hips", Property.TRANSLATION): linear,
            Channel("head", Property.TRANSLATION): step,
            Channel("spine", Property.ROTATION): rotation,
            Channel("smile", Property.WEIGHT): smooth,
        },
        "sparse",
    )
    notes = write(Scene((character,), (clip,)), tmp_path / "a.usda")
    assert any("no steps" in n for n in notes) and any("sampled at" in n for n in notes)
    scene = read(tmp_path / "a.usda")
    back = scene.animation("sparse")
    assert isinstance(back, Clip)
    moments = np.concatenate([np.linspace(0, 1.8, 61), [0.4999, 0.5001, 1.4999, 1.5001]])
    before, after = (sample_clip(c, character.skeleton, moments) for c in (clip, back))
    np.testing.assert_allclose(after.translations, before.translations, atol=1e-6)
    assert np.max(quat.angle_between(after.rotations, before.rotations)) < 1e-6
    smile = [sample_morphs(c, ("smile",), moments[:30]) for c in (clip, back)]
    assert np.abs(smile[0] - smile[1]).max() < 2e-4


def test_animations_lie_beside_each_other_in_their_order(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    character = small_character(rng)
    motions = [motion_of(character, rng, rate, name) for rate, name in ((30.0, "walk"), (60.0, "a b"), (30.0, "talk"))]
    write(Scene((character,), tuple(motions)), tmp_path / "a.usda")
    scene = read(tmp_path / "a.usda")
    assert [a.name for a in scene.animations] == ["walk", "a b", "talk"]
    assert [a.rate_hz for a in scene.animations] == [30.0, 60.0, 30.0]
    error = scene_error(Scene((character,), tuple(motions)), scene)
    assert error.within(1e-3, 1e-4), error.lines()


def test_parts_bound_in_different_ways_share_the_joints(tmp_path: Path) -> None:
    """UsdSkel knows one bind transform for each joint; skins that disagree get skeletons of their own, with the same joints."""
    rng = np.random.default_rng(7)
    character = small_character(rng)
    body = character.parts[0]
    assert body.skin is not None
    other = np.array(body.skin.joint_from_mesh)
    other[1] = np.eye(4)
    moved = np.array(body.skin.joint_from_mesh) @ np.linalg.inv(other[0])  # another space, the same bones
    skins = [body.skin, replace(body.skin, joint_from_mesh=other), replace(body.skin, joint_from_mesh=moved)]
    parts = tuple(replace(body, name=f"p{k}", skin=skin, group=k) for k, skin in enumerate(skins))
    character = replace(character, parts=parts)
    write(Scene((character,), (motion_of(character, rng, 30.0),)), tmp_path / "a.usda")
    text = (tmp_path / "a.usda").read_text()
    assert 2 <= text.count("def Skeleton ") <= 3
    back = read(tmp_path / "a.usda")
    assert back.character.skeleton.names == character.skeleton.names
    assert len(back.animations) == 1
    assert_same_vertices(character, back.character, 2e-6)
    pose = back.animations[0]
    at = world(character.skeleton, sample_clip(pose, character.skeleton, np.array(0.8)))
    for x, y in zip(deform_character(character, at), deform_character(back.character, at), strict=True):
        np.testing.assert_allclose(x, y, atol=1e-5)


def test_names_that_usd_does_not_allow_come_back(tmp_path: Path) -> None:
    character = small_character(np.random.default_rng(0))
    names = ("Hüfte", "mixamorig:Spine", "1.head", "a/b c")
    skeleton = Skeleton(names, character.skeleton.parents, character.skeleton.rest)
    parts = tuple(replace(p, name=f"{p.name} ü/1") for p in character.parts)
    character = replace(character, skeleton=skeleton, parts=parts, name="Anna Müller")
    motion = motion_of(character, np.random.default_rng(0), 30.0, "gehen & stehen")
    for suffix in SUFFIXES:
        path = tmp_path / f"ä.{suffix}"
        keypose.io.save([character, motion], path)
        scene = read(path)
        assert scene.character.skeleton.names == names and scene.character.name == "Anna Müller"
        assert [p.name for p in scene.character.parts] == [p.name for p in parts]
        assert scene.animations[0].name == "gehen & stehen"
        assert_valid(path)


def test_the_built_in_human_comes_back_and_is_valid(tmp_path: Path) -> None:
    scene = load_sample("human")
    for suffix in ("usdc", "usdz"):
        path = tmp_path / f"human.{suffix}"
        assert keypose.io.save(scene, path) == ()
        back = keypose.io.load(path)
        error = scene_error(scene, back)
        assert error.within(1e-3, 1e-4), error.lines()
        assert back.character.morph_names == scene.character.morph_names
        assert dict(back.character.roles) == dict(scene.character.roles)
        assert_valid(path)


@pytest.mark.data
@pytest.mark.parametrize(
    "path",
    [p for stem in ("khronos/cesium_man.gltf", "khronos/SimpleMorph/SimpleMorph.gltf", "cc0/robot.glb", "khronos/SimpleSkin.gltf")
     for p in data_files(f"gltf/{stem}")],
    ids=lambda p: p.stem,
)  # fmt: skip
def test_gltf_files_go_through_usd_and_back(path: Path, tmp_path: Path) -> None:
    scene = keypose.io.load(path)
    keypose.io.save(scene, tmp_path / "a.usdz")
    first = keypose.io.load(tmp_path / "a.usdz")
    keypose.io.save(first, tmp_path / "a.glb")
    for copy in (first, keypose.io.load(tmp_path / "a.glb")):
        error = scene_error(scene, copy)
        assert error.within(1e-3, 1e-4), error.lines()
    assert_valid(tmp_path / "a.usdz")


def test_packages_are_plain_and_alike(tmp_path: Path) -> None:
    """Stored, at multiples of 64 bytes, the layer first; equal scenes make equal files."""
    character = small_character(np.random.default_rng(0))
    for name in ("a", "b"):
        keypose.io.save(character, tmp_path / name / "c.usdz") if (tmp_path / name).mkdir() is None else None
    data = (tmp_path / "a" / "c.usdz").read_bytes()
    assert data == (tmp_path / "b" / "c.usdz").read_bytes()
    with zipfile.ZipFile(tmp_path / "a" / "c.usdz") as archive:
        entries = archive.infolist()
    assert [e.filename for e in entries] == ["c.usdc", "textures/skin.png"]
    for entry in entries:
        assert entry.compress_type == zipfile.ZIP_STORED
        at = (
            entry.header_offset
            + 30
            + int.from_bytes(data[entry.header_offset + 26 : entry.header_offset + 28], "little")
        )
        at += int.from_bytes(data[entry.header_offset + 28 : entry.header_offset + 30], "little")
        assert at % 64 == 0


def test_pictures_lie_beside_a_layer(tmp_path: Path) -> None:
    character = small_character(np.random.default_rng(0))
    missing = replace(character.parts[1], material=Material("felt", base_color_image=Image("felt.jpg", "image/jpeg")))
    character = replace(character, parts=(character.parts[0], missing))
    notes = keypose.io.save(character, tmp_path / "a.usda")
    assert any("felt.jpg' is missing" in note for note in notes)
    assert {p.name for p in tmp_path.iterdir()} == {"a.usda", "a_skin.png"}
    assert (tmp_path / "a_skin.png").read_bytes() == PNG
    scene = keypose.io.load(tmp_path / "a.usda")
    image = scene.character.parts[1].material.base_color_image
    assert image is not None and (image.name, image.data) == ("felt.jpg", None)
    assert any("felt.jpg' is not there" in note for note in scene.notes)


def test_materials_come_back(tmp_path: Path) -> None:
    character = small_character(np.random.default_rng(0))
    hat = character.parts[1]
    image = Image("skin", "image/png", PNG)
    looks = [
        Material("a", (0.1, 0.2, 0.3, 1.0), 0.75, 0.25, (0.5, 0.25, 0.125), double_sided=True),
        Material("a", (0.1, 0.2, 0.3, 0.5), alpha_mode="BLEND"),
        Material("", (0.1, 0.2, 0.3, 0.5), alpha_mode="MASK", alpha_cutoff=0.25),
        Material("c", (0.5, 0.25, 1.0, 0.5), base_color_image=image, alpha_mode="MASK", alpha_cutoff=0.75),
        Material("d", (0.5, 0.25, 1.0, 0.5), base_color_image=image, alpha_mode="BLEND", unlit=True),
    ]
    parts = tuple(replace(hat, name=f"h{k}", material=m, group=k) for k, m in enumerate(looks))
    keypose.io.save(replace(character, parts=parts), tmp_path / "a.usdz")
    back = keypose.io.load(tmp_path / "a.usdz").character
    for want, part in zip(looks, back.parts, strict=True):
        got = part.material
        for name in ("alpha_mode", "double_sided", "unlit"):
            assert getattr(got, name) == getattr(want, name)
        for name in ("base_color", "emissive", "metallic", "roughness"):
            np.testing.assert_allclose(getattr(got, name), getattr(want, name), atol=1e-6)
        assert want.alpha_mode != "MASK" or got.alpha_cutoff == pytest.approx(want.alpha_cutoff)
        assert (got.base_color_image is None) == (want.base_color_image is None)
    assert_valid(tmp_path / "a.usdz")


def test_further_attributes_come_back(tmp_path: Path) -> None:
    character = small_character(np.random.default_rng(0))
    hat, rng = character.parts[1], np.random.default_rng(1)
    attributes = {
        "TEXCOORD_1": rng.random((12, 2), np.float32),
        "TANGENT": rng.random((12, 4), np.float32),
        "_HEAT": rng.random(12, np.float32),
        "_NUMBER": np.arange(12),
    }
    mesh = replace(hat.mesh, attributes=attributes)
    notes = keypose.io.save(replace(character, parts=(replace(hat, mesh=mesh),)), tmp_path / "a.usdc")
    assert any("_NUMBER" in note for note in notes)
    back = keypose.io.load(tmp_path / "a.usdc").character.parts[0].mesh.attributes
    assert set(back) == {"TEXCOORD_1", "TANGENT", "_HEAT"}
    for name, values in back.items():
        np.testing.assert_allclose(np.reshape(values, np.shape(attributes[name])), attributes[name], atol=1e-6)


def test_what_usd_cannot_hold_is_said(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    character = small_character(rng)
    motion = motion_of(character, rng, 30.0)
    stranger = Motion(
        ("x",), Pose(np.zeros((2, 1, 3)), np.tile([1.0, 0, 0, 0], (2, 1, 1)), np.ones((2, 1, 3))), 30.0, "s"
    )
    scene = Scene((character, replace(character, name="twin")), (motion, stranger))
    notes = write(scene, tmp_path / "a.usda")
    assert any("2 characters" in n for n in notes) and any("do not exist" in n for n in notes)
    back = read(tmp_path / "a.usda")
    assert len(back.character.skeleton.names) == 8 and len(back.character.parts) == 6
    assert_valid(tmp_path / "a.usda")


def test_scenes_without_characters_parts_or_joints(tmp_path: Path) -> None:
    for number, scene in enumerate((Scene(), Scene((small_joints(),)))):
        path = tmp_path / f"{number}.usda"
        write(scene, path)
        back = read(path)
        joints = sum(c.skeleton.joint_count for c in scene.characters)
        assert sum(c.skeleton.joint_count for c in back.characters) == joints
        assert_valid(path)


def small_joints() -> Character:
    rest = Pose(np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), np.ones((2, 3)))
    return Character(Skeleton(("a", "b"), np.array([-1, 0]), rest))


def test_a_skin_that_flattens_its_mesh(tmp_path: Path) -> None:
    character = small_character(np.random.default_rng(0))
    body = character.parts[0]
    assert body.skin is not None
    flat = np.array(body.skin.joint_from_mesh)
    flat[0, 2, :3] = 0
    part = replace(body, skin=replace(body.skin, joint_from_mesh=flat))
    notes = write(Scene((replace(character, parts=(part,)),)), tmp_path / "a.usda")
    assert any("flattens" in note for note in notes)
    assert read(tmp_path / "a.usda").character.parts[0].skin is not None


def test_options_and_refusals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    character = small_character(np.random.default_rng(0))
    scene = Scene((character,))
    with pytest.raises(UnknownName, match="parsec"):
        write(scene, tmp_path / "a.usda", unit="parsec")
    with pytest.raises(ShapeError, match="rate_hz"):
        write(scene, tmp_path / "a.usda", rate_hz=0)
    with pytest.raises(FormatError, match=r"\.usdz, got '.obj'"):
        write(scene, tmp_path / "a.obj")
    with pytest.raises(FormatError, match="does not exist"):
        keypose.io.save(scene, tmp_path / "no" / "a.usda")
    assert list(tmp_path.iterdir()) == []
    motion = motion_of(character, np.random.default_rng(0), 24.0)
    write(Scene((character,), (motion,)), tmp_path / "a.usda", rate_hz=100)
    assert "timeCodesPerSecond = 100" in (tmp_path / "a.usda").read_text()
    monkeypatch.setattr(process.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingExtra, match=r"pip install 'keypose\[usd\]'"):
        write(scene, tmp_path / "b.usda")
    with pytest.raises(MissingExtra, match=r"pip install 'keypose\[usd\]'"):
        read(tmp_path / "a.usda")


def test_a_file_that_fails_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import keypose.io.usd.writer as module

    (tmp_path / "a.usdz").write_bytes(b"old")

    def fails(*_: Any) -> None:
        raise FormatError("no room")

    monkeypatch.setattr(module, "_export", fails)
    with pytest.raises(FormatError, match="no room"):
        keypose.io.save(small_character(np.random.default_rng(0)), tmp_path / "a.usdz")
    assert [p.name for p in tmp_path.iterdir()] == ["a.usdz"] and (tmp_path / "a.usdz").read_bytes() == b"old"


def test_the_library_is_imported_only_to_write(tmp_path: Path) -> None:
    keypose.io.save(small_character(np.random.default_rng(0)), tmp_path / "a.usda")
    code = f"import sys, keypose.io; keypose.io.load({str(tmp_path / 'a.usda')!r}); sys.exit('pxr' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_examples_of_the_documentation_run() -> None:
    page = ROOT / "docs" / "formats" / "usd.md"
    result = doctest.testfile(str(page), module_relative=False, optionflags=doctest.ELLIPSIS)
    assert result.attempted > 5 and result.failed == 0


def test_parts_that_hang_on_a_joint_are_rigid_bindings(tmp_path: Path) -> None:
    """As UsdSkel wants them: one joint, weight 1, constant over the mesh."""
    from pxr import Usd, UsdSkel

    character = small_character(np.random.default_rng(0))
    keypose.io.save(character, tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath("/small/hat"))
    assert list(binding.GetJointsAttr().Get()) == ["hips/prop"]
    assert binding.GetJointIndicesPrimvar().GetInterpolation() == "constant"
    assert list(binding.GetJointWeightsPrimvar().Get()) == [1.0]


def test_a_part_without_triangles_or_influences_needs_no_special_care(tmp_path: Path) -> None:
    character = small_character(np.random.default_rng(0))
    hat = character.parts[1]
    bare = replace(hat, mesh=replace(hat.mesh, triangles=np.zeros((0, 3), int)))
    keypose.io.save(replace(character, parts=(bare, Part("full", hat.mesh, joint=1))), tmp_path / "a.usda")
    scene = keypose.io.load(tmp_path / "a.usda")
    assert [p.name for p in scene.character.parts] == ["full"]
    assert any("no faces" in note for note in scene.notes)
