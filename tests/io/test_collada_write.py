"""Writing COLLADA: what is read back here, and what other libraries read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import keypose.io
from keypose import analysis, deform, evaluate, samples
from keypose.errors import FormatError
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
    Mesh,
    MorphSet,
    Motion,
    Part,
    Pose,
    Property,
    Scene,
    Skeleton,
    Skin,
)
from tests.io.collada_files import collada


def random_rotations(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return np.asarray(quat.normalize(rng.normal(size=(*shape, 4))))


def rig(seed: int = 0, frames: int = 6) -> Scene:
    """A random tree with a skinned, morphing mesh, a rigid one, odd names and a motion."""
    rng = np.random.default_rng(seed)
    joints = 7
    parents = np.array([-1, *(int(rng.integers(0, j)) for j in range(1, joints))])
    rest = Pose(rng.normal(size=(joints, 3)), random_rotations(rng, joints), rng.uniform(0.5, 2, (joints, 3)))
    names = ("root", "a b", "ä<&>\"'", "2nd", "x.y/z", "#", "last")
    skeleton = Skeleton(names, parents, rest)
    triangles = np.array([(0, 1, 2), (2, 3, 4), (4, 5, 0), (1, 3, 5)])
    mesh = Mesh(
        rng.normal(size=(6, 3)), triangles, np.tile((0.0, 0, 1), (6, 1)), rng.uniform(size=(6, 2)), rng.uniform(size=(6, 4)),
        {"TEXCOORD_1": rng.uniform(size=(6, 2))},
    )  # fmt: skip
    weights = rng.uniform(size=(6, 3))
    matrices = np.tile(np.eye(4), (3, 1, 1))
    matrices[:, :3] = rng.normal(size=(3, 3, 4))
    skin = Skin(np.array([1, 4, 6]), matrices, np.tile([0, 1, 2], (6, 1)), weights / weights.sum(axis=1, keepdims=True))
    morphs = MorphSet.from_dense(("smile", "blink"), rng.normal(size=(2, 6, 3)))
    material = Material("red & white", (0.5, 0.25, 0.125, 1.0), emissive=(0.1, 0.0, 0.0), double_sided=True)
    parts = (
        Part("body", mesh, material, skin=skin, morphs=morphs, morph_channels=np.array([0, 1])),
        Part("hat", Mesh(mesh.positions, triangles), Material("hat", unlit=True), joint=2),
    )
    translations = np.asarray(rest.translations) + 0.1 * rng.normal(size=(frames, joints, 3))
    pose = Pose(translations, random_rotations(rng, frames, joints), np.asarray(rest.scales))
    motion = Motion(names, pose, 24.0, "dance", 0.5, ("smile", "blink"), rng.uniform(size=(frames, 2)))
    character = Character(skeleton, parts, "someone", ("smile", "blink"), np.array([0.0, 0.5]))
    return Scene((character,), (motion,))


def deformed(scene: Scene, time: float) -> list[np.ndarray]:
    character, animation = scene.character, scene.animations[0]
    pose = evaluate.sample(animation, character.skeleton, np.array([time]))[0]
    world = evaluate.world(character.skeleton, pose)
    weights = np.asarray(
        evaluate.sample_morphs(animation, character.morph_names, np.array([time]), character.rest_morph_weights)
    )[0]
    result = []
    for part in character.parts:
        mesh = part.mesh
        positions = np.array(mesh.positions, np.float64)
        if part.morphs is not None:
            positions += np.einsum("m,mvk->vk", weights[part.morph_channels], part.morphs.dense(mesh.vertex_count)[0])
        mesh = Mesh(positions, mesh.triangles)
        if part.skin is not None:
            found: Any = deform.skin(mesh, part.skin, world)
            result.append(np.asarray(found[0] if isinstance(found, tuple) else found))
        else:
            matrix = np.asarray(world)[part.joint]
            result.append(positions @ matrix[:3, :3].T + matrix[:3, 3])
    return result


@pytest.mark.parametrize("seed", range(5))
def test_any_rig_comes_back(tmp_path: Path, seed: int) -> None:
    scene = rig(seed)
    keypose.io.save(scene, tmp_path / "rig.dae")
    back = keypose.io.load(tmp_path / "rig.dae")
    mine, theirs = scene.character, back.character
    assert set(theirs.skeleton.names) == set(mine.skeleton.names) and theirs.name == "someone"  # in depth-first order
    for name, parent in zip(mine.skeleton.names, mine.skeleton.parents.tolist(), strict=True):
        above = int(theirs.skeleton.parents[theirs.skeleton.index(name)])
        assert (mine.skeleton.names[parent] if parent >= 0 else "") == (
            theirs.skeleton.names[above] if above >= 0 else ""
        )
    found = analysis.roundtrip_error(scene.animations[0], back.animations[0], mine.skeleton, theirs.skeleton)
    assert found.position_mm < 1e-3 and found.rotation_deg < 1e-4
    assert back.animations[0].name == "dance"
    assert theirs.morph_names == ("smile", "blink")
    np.testing.assert_allclose(theirs.rest_morph_weights, mine.rest_morph_weights)
    by_name = {p.name: p for p in theirs.parts}
    for part in mine.parts:
        other = by_name[part.name]
        np.testing.assert_array_equal(other.mesh.triangles, part.mesh.triangles)
        np.testing.assert_allclose(other.mesh.positions, part.mesh.positions, rtol=1e-9)
        for name in ("normals", "uvs", "colors"):
            if getattr(part.mesh, name) is not None:
                np.testing.assert_allclose(getattr(other.mesh, name), getattr(part.mesh, name), atol=1e-9)
        assert other.mesh.attributes.keys() == part.mesh.attributes.keys()
        assert (other.material.name, other.material.unlit, other.material.double_sided) == (
            part.material.name, part.material.unlit, part.material.double_sided,
        )  # fmt: skip
        np.testing.assert_allclose(other.material.base_color, part.material.base_color, rtol=1e-9)
    for time in (0.5, 0.5 + 2 / 24, 0.5 + 5 / 24):
        names = [p.name for p in theirs.parts]
        again = dict(zip(names, deformed(back, time), strict=True))
        for part, expected in zip(mine.parts, deformed(scene, time), strict=True):
            np.testing.assert_allclose(again[part.name], expected, atol=1e-6)


def test_clips_keep_their_keys(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    skeleton = rig().character.skeleton
    times = np.array([0.0, 0.4, 1.1])
    curves = {
        Channel("root", Property.TRANSLATION): Curve(
            times, rng.normal(size=(3, 3)), Interpolation.HERMITE, rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
        ),
        Channel("a b", Property.ROTATION): Curve(times, random_rotations(rng, 3), kind=CurveKind.ROTATION),
        Channel("2nd", Property.TRANSLATION): Curve(times, rng.normal(size=(3, 3)), Interpolation.STEP),
        Channel("last", Property.TRANSLATION): Curve(times, rng.normal(size=(3, 3)), Interpolation.STEP),
        Channel("last", Property.SCALE): Curve(times, rng.uniform(1, 2, (3, 3))),
        Channel("smile", Property.WEIGHT): Curve(times, rng.uniform(size=(3, 1)), kind=CurveKind.SCALAR),
    }
    clip = Clip(curves, "keys")
    character = rig().character
    keypose.io.save([character, clip], tmp_path / "keys.dae")
    back = keypose.io.load(tmp_path / "keys.dae")
    again = back.animation("keys")
    assert isinstance(again, Clip)
    np.testing.assert_allclose(again.curve("a b", Property.ROTATION).times_s, times, atol=1e-9)
    step = again.curve("2nd", Property.TRANSLATION)
    assert np.all(np.asarray(step.modes) == Interpolation.STEP) and step.key_count == 3
    at = np.sort(rng.uniform(0, 1.1, 300))
    at = at[np.abs(at[:, None] - times).min(axis=1) > 1e-4]  # not on a step itself
    a, b = (evaluate.sample_clip(evaluate.match(c, skeleton), skeleton, at).broadcast() for c in (clip, again))
    np.testing.assert_allclose(b.translations, a.translations, atol=3e-5)
    np.testing.assert_allclose(b.scales, a.scales, atol=1e-6)
    assert np.asarray(quat.angle_between(a.rotations, b.rotations)).max() < 1e-6
    weights = [evaluate.sample_morphs(c, ("smile",), at, np.zeros(1)) for c in (clip, again)]
    np.testing.assert_allclose(weights[1], weights[0], atol=1e-6)


def test_the_human(tmp_path: Path) -> None:
    """29 parts, skins over morphs, six performances: vertices on the way."""
    human = samples.load("human")
    short = Scene(human.characters, (human.animation("talk"),))
    notes = keypose.io.save(short, tmp_path / "human.dae")
    assert any("tips" in note for note in notes)
    back = keypose.io.load(tmp_path / "human.dae")
    assert back.character.morph_names and set(back.character.morph_names) <= set(human.character.morph_names)
    expected, found = deformed(short, 1.0), deformed(back, 1.0)
    assert len(expected) == len(found)
    for a, b in zip(expected, found, strict=True):
        assert np.linalg.norm(a - b, axis=1).max() < 2e-6


@pytest.mark.data
@pytest.mark.parametrize("name", ["assimp/library_animation_clips", "ozz/astro_maya", "ozz/seymour", "ozz/walk"])
def test_real_files_come_back(data_dir: Path, tmp_path: Path, name: str) -> None:
    scene = keypose.io.load(data_dir / f"collada/{name}.dae")
    keypose.io.save(scene, tmp_path / "again.dae")
    back = keypose.io.load(tmp_path / "again.dae")
    for a, b in zip(scene.animations, back.animations, strict=True):
        found = analysis.roundtrip_error(a, b, scene.character.skeleton, back.character.skeleton)
        assert found.position_mm < 1e-3 and found.rotation_deg < 1e-4
    assert back.character.triangle_count == scene.character.triangle_count


def test_pycollada_reads_it(tmp_path: Path) -> None:
    pycollada = pytest.importorskip("collada", reason="pycollada is not installed")
    scene = rig()
    body, hat = scene.character.parts
    plain = Part("body", body.mesh, body.material, skin=body.skin)  # it knows no skin of a morph
    character = Character(scene.character.skeleton, (plain, hat), "someone")
    keypose.io.save(Scene((character,), scene.animations), tmp_path / "rig.dae")
    theirs = pycollada.Collada(str(tmp_path / "rig.dae"))
    assert not theirs.errors and theirs.assetInfo.upaxis == "Y_UP" and theirs.assetInfo.unitmeter == 1
    triangles = theirs.geometries["body-mesh"].primitives[0]
    np.testing.assert_array_equal(triangles.vertex_index, plain.mesh.triangles)
    np.testing.assert_allclose(triangles.vertex, plain.mesh.positions, atol=1e-6)
    controller = theirs.controllers["body-skin"]
    assert plain.skin is not None
    np.testing.assert_allclose(
        sorted(controller.weights.data.ravel()), sorted(np.asarray(plain.skin.weights).ravel()), atol=1e-6
    )
    matrices = [controller.joint_matrices[name] for name in controller.weight_joints]
    np.testing.assert_allclose(matrices, plain.skin.joint_from_mesh, atol=1e-6)
    bound = list(theirs.scene.objects("geometry"))
    assert len(bound) == 1  # the hat hangs on its joint, at rest
    joint = np.asarray(evaluate.world(character.skeleton, character.skeleton.rest))[2]
    expected = np.asarray(hat.mesh.positions) @ joint[:3, :3].T + joint[:3, 3]
    np.testing.assert_allclose(next(iter(bound[0].primitives())).vertex, expected, atol=1e-5)
    assert tuple(theirs.effects[0].diffuse)[:3] == pytest.approx((0.5, 0.25, 0.125))


def test_assimp_reads_it(tmp_path: Path) -> None:
    assimp = pytest.importorskip("assimp_py", reason="assimp-py is not installed")
    scene = rig()
    body, hat = scene.character.parts
    plain = Part("body", body.mesh, body.material, skin=body.skin)  # assimp 5.4 loses its way in any morph controller
    character = Character(scene.character.skeleton, (plain, hat), "someone")
    keypose.io.save(Scene((character,), scene.animations), tmp_path / "rig.dae")
    theirs = assimp.import_file(str(tmp_path / "rig.dae"), assimp.Process_Triangulate)
    counts = sorted(len(np.asarray(m.indices).reshape(-1, 3)) for m in theirs.meshes)
    assert counts == [4, 4]
    corners = np.asarray(body.mesh.positions)[body.mesh.triangles].reshape(-1, 3)
    found = [np.asarray(m.vertices).reshape(-1, 3)[np.asarray(m.indices).ravel()] for m in theirs.meshes]
    assert any(np.allclose(f, corners, atol=1e-5) for f in found)


def test_notes_and_options(tmp_path: Path) -> None:
    scene = rig()
    part = scene.character.parts[1]
    picture = Material("m", (1, 1, 1, 0.5), base_color_image=Image("a b.png", data=b"x"), alpha_mode="BLEND")
    character = Character(scene.character.skeleton, (Part("hat", part.mesh, picture, joint=2),))
    notes = keypose.io.save(Scene((character, character), scene.animations), tmp_path / "a.dae")
    assert any("picture" in n for n in notes) and any("transparency" in n for n in notes)
    assert any("first character only" in n for n in notes)
    back = keypose.io.load(tmp_path / "a.dae")
    image = back.character.parts[0].material.base_color_image
    assert image is not None and image.name == "a b.png" and image.data is None
    keypose.io.save(scene, tmp_path / "b.dae", rate_hz=48)
    clip = keypose.io.load(tmp_path / "b.dae").animation()
    assert isinstance(clip, Clip) and clip.curve("root", Property.ROTATION).key_count == 11
    with pytest.raises(FormatError, match="no character"):
        keypose.io.save(Scene(), tmp_path / "c.dae")
    keypose.io.save(scene, tmp_path / "d.dae")
    keypose.io.save(scene, tmp_path / "e.dae")
    assert (tmp_path / "d.dae").read_bytes() == (tmp_path / "e.dae").read_bytes()


def test_what_was_read_is_written_again(tmp_path: Path) -> None:
    (tmp_path / "small.dae").write_text(collada())
    scene = keypose.io.load(tmp_path / "small.dae")
    keypose.io.save(scene, tmp_path / "again.dae")
    back = keypose.io.load(tmp_path / "again.dae")
    assert back.up == "Y" and back.unit_m == 1
    for time in (0.0, 0.7, 1.3):
        again = dict(zip([p.name for p in back.character.parts], deformed(back, time), strict=True))
        for part, expected in zip(scene.character.parts, deformed(scene, time), strict=True):
            np.testing.assert_allclose(again[part.name], expected, atol=2e-6)
