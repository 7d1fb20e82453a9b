"""Writing FBX: what is read back is what was written, by ufbx and by Assimp."""

from __future__ import annotations

import doctest
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import keypose.io
from keypose.analysis import roundtrip_error
from keypose.deform import deform_character
from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.evaluate import bake, sample_morphs, world
from keypose.io.fbx import read, write
from keypose.math import quat, rigid
from keypose.model import (
    Channel,
    Character,
    Clip,
    Curve,
    CurveKind,
    Image,
    Material,
    Mesh,
    MorphSet,
    Motion,
    Part,
    Pose,
    Property,
    Scene,
    Skeleton,
    Skin,
    SkinningMethod,
)
from keypose.samples import load as load_sample
from tests.cli import command
from tests.conftest import ROOT, data_files

pytest.importorskip("ufbx")

PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de0000000c49444154789c63f8cfc00000000301"
    "0100c9fe92ef0000000049454e44ae426082"
)


def small_character(rng: np.random.Generator) -> Character:
    """Four joints in any pose and scale, one skinned part bound elsewhere than at rest, one that hangs on a joint."""
    rest = Pose(rng.normal(size=(4, 3)), quat.normalize(rng.normal(size=(4, 4))), np.exp(rng.normal(size=(4, 3)) * 0.2))
    skeleton = Skeleton(("hips", "spine", "head", "prop"), np.array([-1, 0, 1, 0]), rest, ((2, (0.0, 0.3, 0.1)),))
    positions = rng.normal(size=(12, 3)).astype(np.float32)
    triangles = np.arange(12).reshape(4, 3)
    normals = quat.normalize(rng.normal(size=(12, 4)))[:, :3]
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    faces = np.cross(positions[1::3] - positions[::3], positions[2::3] - positions[::3])
    normals *= np.where(np.sum(np.repeat(faces, 3, axis=0) * normals, axis=1) < 0, -1, 1)[:, None].astype(np.float32)
    mesh = Mesh(
        positions, triangles, normals, rng.random((12, 2)).astype(np.float32), rng.random((12, 4)).astype(np.float32)
    )
    weights = rng.random((12, 3))
    bind = rigid.from_trs(rng.normal(size=(3, 3)), quat.normalize(rng.normal(size=(3, 4))))
    joints = np.stack([rng.permutation(3) for _ in range(12)])
    skin = Skin(np.array([2, 0, 1]), bind.astype(np.float32), joints, weights / weights.sum(axis=1, keepdims=True))
    deltas = rng.normal(size=(2, 12, 3)) * (rng.random((2, 12, 1)) < 0.6)
    morphs = MorphSet.from_dense(("smile", "blink"), deltas.astype(np.float32))
    image = Image("skin.png", "image/png", PNG)
    parts = (
        Part(
            "body", mesh, Material("skin", base_color=(1, 1, 1, 1), base_color_image=image), skin, None, morphs, group=0
        ),
        Part("hat", mesh, Material("felt", base_color=(0.25, 0.5, 0.75, 1), roughness=0.3), joint=3, group=1),
        Part("band", mesh, Material("glass", base_color=(0.5, 0.5, 0.5, 0.5), alpha_mode="BLEND"), joint=3, group=2),
    )
    return Character(
        skeleton, parts, "small", ("smile", "blink"), np.array([0.25, -0.5], np.float32), {"hips": 0, "head": 2}
    )


def assert_same_vertices(a: Character, b: Character, tolerance_m: float = 1e-6) -> None:
    poses = [(c, world(c.skeleton, c.skeleton.rest)) for c in (a, b)]
    first, second = (deform_character(c, at) for c, at in poses)
    assert [p.name for p in a.parts] == [p.name for p in b.parts]
    for x, y in zip(first, second, strict=True):
        np.testing.assert_allclose(x, y, atol=tolerance_m, rtol=0)


@pytest.mark.parametrize("seed", range(4))
def test_a_character_comes_back(seed: int, tmp_path: Path) -> None:
    character = small_character(np.random.default_rng(seed))
    notes = keypose.io.save(character, tmp_path / "a.fbx")
    assert notes == ()
    back = keypose.io.load(tmp_path / "a.fbx").character
    a, b = character.skeleton, back.skeleton
    assert b.names == a.names and b.parents.tolist() == a.parents.tolist()
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
        assert q.material.name == p.material.name
        np.testing.assert_allclose(q.material.base_color, p.material.base_color, atol=1e-6)
        assert q.material.alpha_mode == p.material.alpha_mode
    image = back.parts[0].material.base_color_image
    assert image is not None and (image.name, image.mime_type, image.data) == ("skin.png", "image/png", PNG)
    assert back.parts[1].material.roughness == pytest.approx(0.3)
    assert back.parts[1].joint == back.parts[2].joint == 3  # the second hat hangs on a carrier, which is no joint


def test_the_skinning_method_comes_back(tmp_path: Path) -> None:
    character = small_character(np.random.default_rng(0))
    body = character.parts[0]
    assert body.skin is not None
    for method in SkinningMethod:
        skinned = replace(body, skin=replace(body.skin, method=method))
        keypose.io.save(replace(character, parts=(skinned,)), tmp_path / "a.fbx")
        scene = keypose.io.load(tmp_path / "a.fbx")
        skin = scene.character.parts[0].skin
        assert skin is not None and skin.method is method
        assert not any("skinning" in note for note in scene.notes)
    for suffix in (".glb", ".dae"):  # hold no method
        notes = keypose.io.save(replace(character, parts=(skinned,)), tmp_path / f"a{suffix}")
        assert any("dual quaternions" in note for note in notes)


def test_motions_come_back_at_their_rate(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    character = small_character(rng)
    for rate in (24.0, 30.0, 60.0, 29.97, 120.0, 37.5):
        frames = 40
        turns = quat.normalize(np.cumsum(rng.normal(size=(frames, 4, 4)), axis=0))  # large turns, through gimbal lock
        pose = Pose(rng.normal(size=(frames, 4, 3)), turns, np.exp(rng.normal(size=(frames, 4, 3)) * 0.1))
        weights = rng.normal(size=(frames, 2))
        motion = Motion(character.skeleton.names, pose, rate, "jump", 0.5, character.morph_names, weights)
        write(Scene((character,), (motion,)), tmp_path / "a.fbx")
        scene = read(tmp_path / "a.fbx")
        clip = scene.animation("jump")
        assert isinstance(clip, Clip)
        assert clip.rate_hz == pytest.approx(rate) and clip.start_s == pytest.approx(0.5, abs=1e-9)
        back = bake(clip, scene.character.skeleton, rate, morph_names=scene.character.morph_names)
        assert back.frame_count == frames
        np.testing.assert_allclose(back.pose.translations, pose.translations, atol=1e-6)
        np.testing.assert_allclose(back.pose.scales, pose.scales, atol=1e-6)
        assert np.degrees(np.max(quat.angle_between(back.pose.rotations, turns))) < 1e-4
        np.testing.assert_allclose(sample_morphs(clip, character.morph_names, motion.times_s), weights, atol=1e-6)


def test_the_built_in_human_comes_back(tmp_path: Path) -> None:
    scene = load_sample("human")
    keypose.io.save(scene, tmp_path / "human.fbx")
    back = keypose.io.load(tmp_path / "human.fbx")
    assert back.character.skeleton.names == scene.character.skeleton.names
    assert back.character.morph_names == scene.character.morph_names
    assert dict(back.character.roles) == dict(scene.character.roles)
    assert_same_vertices(scene.character, back.character)
    assert [a.name for a in back.animations] == [a.name for a in scene.animations]
    for a, b in zip(scene.animations, back.animations, strict=True):
        error = roundtrip_error(a, b, scene.character.skeleton, back.character.skeleton)
        assert error.position_mm < 1e-3 and error.rotation_deg < 1e-4


@pytest.mark.data
@pytest.mark.parametrize("path", data_files("fbx/**/*.fbx"), ids=lambda p: p.stem)
def test_real_files_come_back(path: Path, tmp_path: Path) -> None:
    scene = read(path)
    write(scene, tmp_path / "a.fbx")
    back = read(tmp_path / "a.fbx")
    assert back.character.skeleton.names == scene.character.skeleton.names
    assert_same_vertices(scene.character, back.character)
    assert len(back.animations) == len(scene.animations)
    for a, b in zip(scene.animations, back.animations, strict=True):
        error = roundtrip_error(a, b, scene.character.skeleton, back.character.skeleton)
        assert error.position_mm < 1e-3 and error.rotation_deg < 1e-4


def test_assimp_reads_what_is_written(tmp_path: Path) -> None:
    assimp = pytest.importorskip("assimp_py", reason="assimp-py, which reads FBX too, is not installed")
    character = load_sample("human").character
    path = tmp_path / "a.fbx"
    write(Scene((character,)), path)
    found = assimp.import_file(str(path), 0)
    by_name: dict[str, list[np.ndarray]] = {}
    for mesh in found.meshes:
        by_name.setdefault(mesh.name, []).append(np.array(mesh.vertices, np.float64).reshape(-1, 3))
    names: set[str] = set()
    waiting = [found.root_node]
    while waiting:
        node = waiting.pop()
        names.add(node.name)
        waiting += node.children
    assert set(character.skeleton.names) <= {name.partition("_$AssimpFbx$")[0] for name in names}
    triangles = sum(len(v) // 3 for meshes in by_name.values() for v in meshes)
    assert triangles == character.triangle_count
    expected = (
        np.concatenate([np.asarray(p.mesh.positions)[p.mesh.triangles.reshape(-1)] for p in character.parts]) * 100
    )
    vertices = np.concatenate([v for meshes in by_name.values() for v in meshes])
    from scipy.spatial import cKDTree

    assert cKDTree(expected).query(vertices)[0].max() < 1e-4
    assert cKDTree(vertices).query(expected)[0].max() < 1e-4


def test_a_part_whose_joint_bends_another_has_a_node_of_its_own(tmp_path: Path) -> None:
    character = small_character(np.random.default_rng(9))
    hat = replace(character.parts[1], joint=2)  # the head, which the skin uses too
    character = replace(character, parts=(character.parts[0], hat))
    write(Scene((character,)), tmp_path / "a.fbx")
    back = read(tmp_path / "a.fbx").character
    assert back.skeleton.names == character.skeleton.names and back.parts[1].joint == 2
    assert_same_vertices(character, back)


def test_parts_of_one_mesh_stay_together(tmp_path: Path) -> None:
    character = small_character(np.random.default_rng(2))
    body = character.parts[0]
    parts = (replace(body, name="body_0"), replace(body, name="body_1", material=Material("cloth")))
    character = replace(character, parts=parts)
    write(Scene((character,)), tmp_path / "a.fbx")
    back = read(tmp_path / "a.fbx").character
    assert [p.group for p in back.parts] == [0, 0] and [p.material.name for p in back.parts] == ["skin", "cloth"]
    assert_same_vertices(character, back)


def test_units_and_rates_and_the_same_bytes(tmp_path: Path) -> None:
    scene = Scene((small_character(np.random.default_rng(1)),))
    for unit, unit_m in (("m", 1.0), ("mm", 0.001), (0.0254, 0.0254)):
        write(scene, tmp_path / "a.fbx", unit=unit)
        back = read(tmp_path / "a.fbx")
        assert back.unit_m == pytest.approx(unit_m)
        assert_same_vertices(scene.character, back.character)
    write(scene, tmp_path / "b.fbx", unit=0.0254)
    assert (tmp_path / "a.fbx").read_bytes() == (tmp_path / "b.fbx").read_bytes()
    with pytest.raises(UnknownName, match="parsec"):
        write(scene, tmp_path / "c.fbx", unit="parsec")
    with pytest.raises(ShapeError, match="rate_hz"):
        write(scene, tmp_path / "c.fbx", rate_hz=0)
    with pytest.raises(FormatError, match="does not exist"):
        write(scene, tmp_path / "nowhere" / "c.fbx")
    assert not (tmp_path / "c.fbx").exists()


def test_sparse_clips_are_baked_and_what_is_lost_is_said(tmp_path: Path) -> None:
    character = small_character(np.random.default_rng(3))
    curve = Curve(np.array([0.0, 1.0]), np.array([[0.0, 0, 0], [2.0, 0, 0]]), kind=CurveKind.VECTOR)
    moving = Clip(
        {Channel("hips", Property.TRANSLATION): curve, Channel("tail", Property.TRANSLATION): curve}, "slide", 50
    )
    blink = Curve(np.array([0.0, 0.31]), np.array([[0.0], [1.0]]), kind=CurveKind.SCALAR)
    other = Clip({Channel("blink", Property.WEIGHT): blink}, "blink", 10)
    notes = write(Scene((character,), (moving, other)), tmp_path / "a.fbx")
    assert any("tail" in note for note in notes) and any("2 frame rates" in note for note in notes)
    back = read(tmp_path / "a.fbx")
    found = back.animation("slide").curves[Channel("hips", Property.TRANSLATION)]  # type: ignore[union-attr]
    assert found.key_count == 51
    np.testing.assert_allclose(found.values[:, 0], np.linspace(0, 2, 51), atol=1e-6)
    found = back.animation("blink").curves[Channel("blink", Property.WEIGHT)]  # type: ignore[union-attr]
    assert found.times_s[-1] == pytest.approx(0.31) and found.values[-1, 0] == pytest.approx(1, abs=0.02)


def test_several_takes_do_not_mix(tmp_path: Path) -> None:
    """What one take does not animate rests in it, whatever the others do; one in which everything rests keeps its length."""
    rng = np.random.default_rng(11)
    joints = 150
    rest = Pose(rng.normal(size=(joints, 3)), quat.normalize(rng.normal(size=(joints, 4))), np.ones((joints, 3)))
    skeleton = Skeleton(tuple(f"j{j}" for j in range(joints)), np.arange(joints) - 1, rest)
    clips = [Clip({}, "still", 30)]
    for name in ("a", "b", "c"):
        curves = {
            Channel(f"j{j}", Property.TRANSLATION): Curve(np.array([0.0, 1.0]), rng.normal(size=(2, 3)))
            for j in rng.permutation(joints)[:70]
        }
        clips.append(Clip(curves, name, 30))
    pose = Pose(rest.translations[None], rest.rotations[None], rest.scales[None])
    clips[0] = Motion(
        skeleton.names,
        Pose(*(np.repeat(a, 31, axis=0) for a in (pose.translations, pose.rotations, pose.scales))),
        30.0,
        "still",
    )  # type: ignore[call-overload]
    write(Scene((Character(skeleton),), tuple(clips)), tmp_path / "a.fbx")
    back = read(tmp_path / "a.fbx")
    assert [c.name for c in back.animations] == ["still", "a", "b", "c"]
    for clip, found in zip(clips, back.animations, strict=True):
        assert isinstance(found, Clip) and found.duration_s == pytest.approx(1)
        if isinstance(clip, Clip):
            assert found.curves.keys() == clip.curves.keys()
            for channel, curve in clip.curves.items():
                np.testing.assert_allclose(found.curves[channel].values[[0, -1]], curve.values, atol=1e-6)


def test_convert_there_and_back_prints_the_proof(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for source, target in (("sample:walk", "a.fbx"), ("a.fbx", "b.glb"), ("b.glb", "c.fbx")):
        done = command.keypose("convert", source, target)
        assert done.returncode == 0, done.stderr
        found = re.search(r"read back: .* positions within (\S+) mm", done.stdout)
        assert found is not None and float(found[1]) < 1e-3, done.stdout


def test_the_page() -> None:
    result = doctest.testfile(str(ROOT / "docs" / "formats" / "fbx.md"), module_relative=False, encoding="utf-8")
    assert result.attempted and not result.failed
