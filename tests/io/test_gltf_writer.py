"""Writing glTF: what is read back is what was written, bit for bit where it was single precision."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import keypose
from keypose import evaluate, samples
from keypose.analysis.roundtrip import roundtrip_error
from keypose.errors import FormatError
from keypose.io import load, save
from keypose.io.gltf import read, write
from keypose.model import (
    Channel,
    Character,
    Clip,
    Curve,
    CurveKind,
    Event,
    Extrapolation,
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
from tests.conftest import data_files
from tests.io.gltf_files import split
from tests.io.gltf_node import validate
from tests.synthetic import random_skeleton

REAL = [p for pattern in ("gltf/**/*.gltf", "gltf/**/*.glb", "vrm/*.vrm", "vrm/*.vrma") for p in data_files(pattern)]
STEP, LINEAR, HERMITE = Interpolation.STEP, Interpolation.LINEAR, Interpolation.HERMITE


def errors_of(*files: Path) -> list[str]:
    return [f"{code}: {text}" for report in validate(*files) for severity, code, text in report if severity <= 1]


def bone(*names: str, parents: list[int] | None = None) -> Skeleton:
    count = len(names)
    rest = Pose(
        np.float32(np.tile([0, 0.5, 0], (count, 1))),
        np.float32(np.tile([1, 0, 0, 0], (count, 1))),
        np.ones((count, 3), np.float32),
    )
    return Skeleton(names, np.array(list(range(-1, count - 1)) if parents is None else parents), rest)


def cloth(rng: np.random.Generator, vertices: int = 12) -> Mesh:
    normals = rng.normal(size=(vertices, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    triangles = np.arange(vertices).reshape(-1, 3)
    return Mesh(np.float32(rng.normal(size=(vertices, 3))), triangles, np.float32(normals))


def binding(rng: np.random.Generator, vertices: int, palette: list[int], influences: int) -> Skin:
    joints = np.argsort(rng.random((vertices, len(palette))), axis=1)[:, :influences]
    weights = rng.random((vertices, joints.shape[1]))
    weights = np.float32(weights / weights.sum(axis=1, keepdims=True))
    matrices = np.tile(np.eye(4, dtype=np.float32), (len(palette), 1, 1))
    matrices[:, :3, 3] = rng.normal(size=(len(palette), 3))
    return Skin(np.array(palette), matrices, joints, weights)


# --- comparison ------------------------------------------------------------------------------------------------------


def assert_same(a: Any, b: Any, what: str) -> None:
    if a is None or b is None:
        assert a is None and b is None, what
        return
    assert a.dtype == b.dtype, what
    np.testing.assert_array_equal(a, b, err_msg=what)


def assert_same_curve(a: Curve, b: Curve, what: str) -> None:
    assert a.kind == b.kind, what
    for name in ("times_s", "values", "in_tangents", "out_tangents"):
        assert_same(getattr(a, name), getattr(b, name), f"{what} {name}")
    assert_same(a.modes[:-1], b.modes[:-1], f"{what} modes")


def assert_same_scene(a: Scene, b: Scene) -> None:
    """Everything a file holds is equal, bit for bit."""
    assert len(a.characters) == len(b.characters)
    for mine, theirs in zip(a.characters, b.characters, strict=True):
        assert mine.skeleton.names == theirs.skeleton.names
        assert_same(mine.skeleton.parents, theirs.skeleton.parents, "parents")
        assert mine.skeleton.end_offsets == theirs.skeleton.end_offsets
        for name in ("translations", "rotations", "scales"):
            assert_same(getattr(mine.skeleton.rest, name), getattr(theirs.skeleton.rest, name), name)
        assert mine.morph_names == theirs.morph_names
        assert_same(mine.rest_morph_weights, theirs.rest_morph_weights, "rest weights")
        assert dict(mine.roles) == dict(theirs.roles)
        assert mine.extras == theirs.extras
        assert len(mine.parts) == len(theirs.parts)
        for p, q in zip(mine.parts, theirs.parts, strict=True):
            assert_same_part(p, q)
    assert [c.name for c in a.animations] == [c.name for c in b.animations]
    for clip, copy in zip(a.animations, b.animations, strict=True):
        assert isinstance(clip, Clip) and isinstance(copy, Clip)
        assert list(clip.curves) == list(copy.curves)
        for channel, curve in clip.curves.items():
            assert_same_curve(curve, copy.curves[channel], f"{clip.name} {channel}")


def assert_same_part(p: Part, q: Part) -> None:
    assert (p.name, p.joint, p.group, dict(p.extras)) == (q.name, q.joint, q.group, dict(q.extras))
    for name in ("positions", "triangles", "normals", "uvs", "colors"):
        assert_same(getattr(p.mesh, name), getattr(q.mesh, name), f"{p.name} {name}")
    assert set(p.mesh.attributes) == set(q.mesh.attributes)
    for name, array in p.mesh.attributes.items():
        assert_same(array, q.mesh.attributes[name], f"{p.name} {name}")
    assert (p.skin is None) == (q.skin is None)
    if p.skin is not None and q.skin is not None:
        for name in ("palette", "joint_from_mesh", "weights"):
            assert_same(getattr(p.skin, name), getattr(q.skin, name), f"{p.name} {name}")
        used = p.skin.weights > 0  # an influence without weight has no joint to keep
        assert_same(p.skin.joints[used], q.skin.joints[used], f"{p.name} joints")
    assert (p.morphs is None) == (q.morphs is None)
    if p.morphs is not None and q.morphs is not None:
        assert p.morphs.names == q.morphs.names
        for name in ("starts", "vertices", "position_deltas", "normal_deltas"):
            assert_same(getattr(p.morphs, name), getattr(q.morphs, name), f"{p.name} {name}")
        assert_same(p.morph_channels, q.morph_channels, f"{p.name} channels")
    m, n = p.material, q.material
    assert (m.name, m.base_color, m.metallic, m.roughness, m.emissive) == (n.name, n.base_color, n.metallic, n.roughness, n.emissive)  # fmt: skip
    assert (m.alpha_mode, m.double_sided, m.unlit) == (n.alpha_mode, n.double_sided, n.unlit)
    assert without_missing(dict(m.extras)) == without_missing(dict(n.extras))
    image = m.base_color_image
    if image is not None and image.data is not None:
        assert image == n.base_color_image or image.data == getattr(n.base_color_image, "data", None)


def without_missing(value: Any) -> Any:
    """Material settings in a form that compares: pictures by their bytes."""
    if isinstance(value, Image):
        return (value.name, value.mime_type, value.data)
    if isinstance(value, dict):
        return {k: without_missing(v) for k, v in value.items()}
    return [without_missing(v) for v in value] if isinstance(value, list) else value


# --- real files ------------------------------------------------------------------------------------------------------


@pytest.mark.data
@pytest.mark.parametrize("path", REAL, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_real_files_come_back_bit_for_bit(path: Path, tmp_path: Path) -> None:
    scene = read(path)
    write(scene, tmp_path / "copy.glb")
    once = read(tmp_path / "copy.glb")
    if path.name in ("Fox.gltf", "interpolation_test.gltf"):  # their pictures are missing and cannot be written
        assert any("was left out" in note for note in write(scene, tmp_path / "copy.glb"))
        scene = replace(scene, characters=(_without_pictures(scene.character),))
        once = replace(once, characters=(_without_pictures(once.character),))
    if path.name == "sphere.vrm":  # its normals are far from unit length; they are scaled when written
        scene = once
        write(scene, tmp_path / "copy.glb")
        once = read(tmp_path / "copy.glb")
    assert_same_scene(scene, once)
    if path.name == "Knight.glb":  # large: once is enough
        return
    for name, embed in (("copy.gltf", False), ("embedded.gltf", True)):
        write(once, tmp_path / name, embed=embed)
        assert_same_scene(once, read(tmp_path / name))


def _without_pictures(character: Character) -> Character:
    parts = (replace(p, material=replace(p.material, base_color_image=None, extras={})) for p in character.parts)
    return replace(character, parts=tuple(parts))


@pytest.mark.data
@pytest.mark.parametrize("path", [p for p in REAL if p.name != "Knight.glb"], ids=lambda p: f"{p.parent.name}/{p.name}")
def test_writing_twice_gives_the_same_bytes(path: Path, tmp_path: Path) -> None:
    write(read(path), tmp_path / "once.glb")
    write(read(tmp_path / "once.glb"), tmp_path / "twice.glb")
    write(read(tmp_path / "twice.glb"), tmp_path / "thrice.glb")
    assert (tmp_path / "twice.glb").read_bytes() == (tmp_path / "thrice.glb").read_bytes()


BVH = [*data_files("bvh/**/*.bvh"), *data_files("cmu_01_01/**/*.bvh")]


@pytest.mark.data
def test_bvh_to_glb_and_back(tmp_path: Path, data_dir: Path) -> None:
    compared = 0
    for path in BVH:
        try:
            scene = load(path)
        except FormatError:  # malformed files of the collection
            continue
        motion = scene.animations[0] if scene.animations else None
        if not isinstance(motion, Motion) or not 1 < motion.frame_count <= 1500:
            continue
        save(scene, tmp_path / "a.glb")
        between = load(tmp_path / "a.glb")
        skeleton = scene.character.skeleton
        error = roundtrip_error(motion, between.animations[0], skeleton, between.character.skeleton)
        assert error.within(1e-3, 1e-4), f"{path.name} in GLB: {error}"
        assert between.character.extras == scene.character.extras
        assert (between.unit_m, between.up) == (scene.unit_m, scene.up)
        ends = dict(between.character.skeleton.end_offsets)
        for joint, offset in skeleton.end_offsets:
            np.testing.assert_allclose(ends[joint], offset, rtol=1e-6, atol=1e-9)
        save(between, tmp_path / "b.bvh")
        back = load(tmp_path / "b.bvh")
        error = roundtrip_error(motion, back.animations[0], skeleton, back.character.skeleton)
        assert error.within(1e-3, 1e-4), f"{path.name} back in BVH: {error}"
        assert len(back.character.skeleton.end_offsets) == len(skeleton.end_offsets)
        assert back.animations[0].frame_count == motion.frame_count  # type: ignore[union-attr]
        compared += 1
    assert compared >= 20


# --- the built-in human ----------------------------------------------------------------------------------------------


def test_the_human_and_its_performances(tmp_path: Path) -> None:
    scenes = [samples.load(name) for name in ("walk", "talk")]
    human = scenes[0].character
    motions = [s.animations[0] for s in scenes]
    scene = Scene((human,), tuple(motions))
    write(scene, tmp_path / "human.glb")
    copy = read(tmp_path / "human.glb")
    character = copy.character
    assert character.skeleton.names == human.skeleton.names
    assert character.morph_names == human.morph_names
    assert dict(character.roles) == dict(human.roles)
    assert {p.name for p in character.parts} == {p.name for p in human.parts}
    for motion, clip in zip(motions, copy.animations, strict=True):
        assert roundtrip_error(motion, clip, human.skeleton, character.skeleton).within(1e-3, 1e-4)
        assert isinstance(motion, Motion) and isinstance(clip, Clip)
        assert clip.rate_hz == motion.rate_hz
        times = motion.times_s
        ours = evaluate.sample_morphs(motion, human.morph_names, times, human.rest_morph_weights)
        theirs = evaluate.sample_morphs(clip, character.morph_names, times, character.rest_morph_weights)
        np.testing.assert_allclose(theirs, ours, atol=2e-5)  # key times are rounded to single precision
    assert errors_of(tmp_path / "human.glb") == []


# --- skins and meshes ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("influences", "sets"), [(1, 1), (3, 1), (4, 1), (5, 2), (8, 2), (11, 3)])
def test_any_number_of_influences(influences: int, sets: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(influences)
    skeleton = bone(*[f"j{i}" for i in range(12)])
    skin = binding(rng, 12, list(range(12)), influences)
    write(Scene((Character(skeleton, (Part("body", cloth(rng), skin=skin),)),)), tmp_path / "a.glb")
    document, _ = split((tmp_path / "a.glb").read_bytes())
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    assert sum(name.startswith("JOINTS_") for name in attributes) == sets
    part = read(tmp_path / "a.glb").character.parts[0]
    assert part.name == "body"
    assert part.skin is not None
    dense, copy = np.zeros((12, 12)), np.zeros((12, 12))
    np.put_along_axis(dense, np.asarray(skin.joints), skin.weights, axis=1)
    np.add.at(copy, (np.arange(12)[:, None], part.skin.joints), part.skin.weights)
    np.testing.assert_allclose(copy, dense, atol=1e-7)
    assert errors_of(tmp_path / "a.glb") == []


def test_a_palette_of_more_than_256_joints(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    skeleton = bone(*[f"j{i}" for i in range(400)], parents=[-1] + [0] * 399)
    skin = binding(rng, 12, list(range(400)), 4)
    write(Scene((Character(skeleton, (Part("body", cloth(rng), skin=skin),)),)), tmp_path / "a.glb")
    part = read(tmp_path / "a.glb").character.parts[0]
    assert part.skin is not None
    assert_same(skin.joints, part.skin.joints, "joints")
    assert errors_of(tmp_path / "a.glb") == []


def test_repeated_and_unnormalised_influences_are_made_valid(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    skeleton = bone("a", "b")
    joints = np.tile([0, 1, 0, 1], (12, 1))
    weights = np.tile(np.float32([0.2, 0.1, 0.3, 0.1]), (12, 1))
    skin = Skin(np.array([0, 1]), np.tile(np.eye(4), (2, 1, 1)), joints, weights)
    notes = write(Scene((Character(skeleton, (Part("body", cloth(rng), skin=skin),)),)), tmp_path / "a.glb")
    assert any("named a joint twice" in note for note in notes)
    copy = read(tmp_path / "a.glb").character.parts[0].skin
    assert copy is not None
    np.testing.assert_allclose(copy.weights[:, :2], np.tile([5 / 7, 2 / 7], (12, 1)), atol=1e-6)
    assert errors_of(tmp_path / "a.glb") == []


def test_a_skin_over_several_roots_gets_a_common_one_that_is_no_joint(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    skeleton = bone("a", "b", parents=[-1, -1])
    skin = binding(rng, 12, [0, 1], 2)
    write(Scene((Character(skeleton, (Part("body", cloth(rng), skin=skin),)),)), tmp_path / "a.glb")
    copy = read(tmp_path / "a.glb").character
    assert copy.skeleton.names == ("a", "b")
    assert copy.skeleton.parents.tolist() == [-1, -1]
    assert errors_of(tmp_path / "a.glb") == []


def test_parts_of_one_group_are_one_mesh(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    skin = binding(rng, 12, [0, 1], 2)
    meshes = [cloth(rng) for _ in range(3)]
    materials = [Material("red", (1, 0, 0, 1)), Material("blue", (0, 0, 1, 1)), Material("red", (1, 0, 0, 1))]
    parts = [
        Part(f"part{i}", m, mat, skin=replace(skin), group=g)
        for i, (m, mat, g) in enumerate(zip(meshes, materials, [0, 0, 1], strict=True))
    ]
    write(Scene((Character(bone("a", "b"), tuple(parts)),)), tmp_path / "a.glb")
    document, _ = split((tmp_path / "a.glb").read_bytes())
    assert [len(m["primitives"]) for m in document["meshes"]] == [2, 1]
    assert len(document["materials"]) == 2
    assert len(document["skins"]) == 1
    copy = read(tmp_path / "a.glb").character.parts
    assert [(p.name, p.group) for p in copy] == [("part0", 0), ("part1", 0), ("part2", 1)]
    assert errors_of(tmp_path / "a.glb") == []


def test_several_rigid_meshes_on_one_joint(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    parts = tuple(Part(f"p{i}", cloth(rng), joint=1, group=i) for i in range(3))
    write(Scene((Character(bone("a", "b"), parts),)), tmp_path / "a.glb")
    copy = read(tmp_path / "a.glb").character
    assert copy.skeleton.names == ("a", "b")
    assert [(p.name, p.joint) for p in copy.parts] == [("p0", 1), ("p1", 1), ("p2", 1)]
    assert errors_of(tmp_path / "a.glb") == []


def test_attributes_and_colours(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    base = cloth(rng)
    tangents = np.concatenate([base.normals, np.ones((12, 1))], axis=1).astype(np.float32)
    mesh = replace(
        base,
        uvs=np.float32(rng.random((12, 2))),
        colors=np.float32(rng.random((12, 4))),
        attributes={
            "TANGENT": tangents,
            "TEXCOORD_1": np.float32(rng.random((12, 2))),
            "_ID": np.arange(12, dtype=np.uint8).reshape(12, 1),
            "_PAIR": np.arange(24, dtype=np.int16).reshape(12, 2),
            "heat": np.arange(12, dtype=np.float64).reshape(12, 1),
        },
    )
    write(Scene((Character(bone("a"), (Part("p", mesh, joint=0),)),)), tmp_path / "a.glb")
    copy = read(tmp_path / "a.glb").character.parts[0].mesh
    for name in ("uvs", "colors"):
        assert_same(getattr(mesh, name), getattr(copy, name), name)
    for name in ("TANGENT", "TEXCOORD_1", "_ID", "_PAIR"):
        assert_same(mesh.attributes[name], copy.attributes[name], name)
    np.testing.assert_array_equal(copy.attributes["_heat"], mesh.attributes["heat"])
    assert errors_of(tmp_path / "a.glb") == []


def test_normals_that_are_not_unit_are_scaled(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    base = cloth(rng)
    normals = np.array(base.normals) * 2
    normals[0] = 0
    mesh = replace(base, normals=normals)
    notes = write(Scene((Character(bone("a"), (Part("p", mesh, joint=0),)),)), tmp_path / "a.glb")
    assert any("12 normals" in note for note in notes)
    assert errors_of(tmp_path / "a.glb") == []


def test_large_meshes_have_long_indices(tmp_path: Path) -> None:
    positions = np.zeros((70_000, 3), np.float32)
    positions[:, 0] = np.arange(70_000)
    normals = np.tile(np.float32([0, 0, 1]), (70_000, 1))
    mesh = Mesh(positions, [[0, 1, 69_999]], normals)
    write(Scene((Character(bone("a"), (Part("p", mesh, joint=0),)),)), tmp_path / "a.glb")
    copy = read(tmp_path / "a.glb").character.parts[0].mesh
    assert copy.triangles.tolist() == [[0, 1, 69_999]]
    assert errors_of(tmp_path / "a.glb") == []


# --- morphs ----------------------------------------------------------------------------------------------------------


def faces(rng: np.random.Generator, vertices: int = 300) -> Character:
    """Two meshes: the second has some of the first one's targets, in another order."""

    def targets(*names: str) -> MorphSet:
        deltas = np.zeros((len(names), vertices, 3), np.float32)
        deltas[0, :5] = rng.normal(size=(5, 3))
        deltas[1:] = rng.normal(size=(len(names) - 1, vertices, 3)) if len(names) > 1 else 0
        return MorphSet.from_dense(names, deltas, deltas / 2)

    head = Part(
        "head", cloth(rng, vertices), joint=0, morphs=targets("a", "b", "c"), morph_channels=np.array([2, 0, 1])
    )
    teeth = Part(
        "teeth", cloth(rng, vertices), joint=1, morphs=targets("c", "a"), morph_channels=np.array([1, 2]), group=1
    )
    return Character(bone("x", "y"), (head, teeth), "face", ("b", "c", "a"), np.float32([0.25, 0, 0.5]))


def test_morph_targets_are_sparse_where_that_is_smaller(tmp_path: Path) -> None:
    character = faces(np.random.default_rng(1))
    write(Scene((character,)), tmp_path / "a.glb")
    document, _ = split((tmp_path / "a.glb").read_bytes())
    targets = document["meshes"][0]["primitives"][0]["targets"]
    stored = [["sparse" in document["accessors"][t[n]] for n in ("POSITION", "NORMAL")] for t in targets]
    assert stored == [[True, True], [False, False], [False, False]]
    assert document["meshes"][0]["extras"]["targetNames"] == ["a", "b", "c"]
    copy = read(tmp_path / "a.glb").character
    assert copy.morph_names == character.morph_names
    np.testing.assert_array_equal(copy.rest_morph_weights, character.rest_morph_weights)
    for p, q in zip(character.parts, copy.parts, strict=True):
        assert p.morphs is not None and q.morphs is not None
        assert_same(p.morph_channels, q.morph_channels, "channels")
        for name in ("starts", "vertices", "position_deltas", "normal_deltas"):
            assert_same(getattr(p.morphs, name), getattr(q.morphs, name), name)
    assert errors_of(tmp_path / "a.glb") == []


def test_a_target_that_moves_nothing(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    mesh = cloth(rng)
    morphs = MorphSet(("none",), [0, 0], [], np.zeros((0, 3), np.float32))
    write(
        Scene((Character(bone("a"), (Part("p", mesh, joint=0, morphs=morphs),), morph_names=("none",)),)),
        tmp_path / "a.glb",
    )
    copy = read(tmp_path / "a.glb").character.parts[0].morphs
    assert copy is not None and copy.names == ("none",) and len(copy.vertices) == 0
    assert errors_of(tmp_path / "a.glb") == []


def test_shared_channels_stay_shared_whatever_moves(tmp_path: Path) -> None:
    character = faces(np.random.default_rng(1))
    curves = {
        Channel("a", Property.WEIGHT): Curve([0, 0.5, 2], np.float32([[0], [1], [0]]), kind=CurveKind.SCALAR),
        Channel("b", Property.WEIGHT): Curve([0.25, 1], np.float32([[0], [1]]), kind=CurveKind.SCALAR),
    }
    clip = Clip(curves, "mixed")
    write(Scene((character,), (clip,)), tmp_path / "a.glb")
    copy = read(tmp_path / "a.glb")
    assert copy.character.morph_names == character.morph_names
    times = np.linspace(-0.5, 2.5, 301)
    ours = evaluate.sample_morphs(clip, character.morph_names, times, character.rest_morph_weights)
    theirs = evaluate.sample_morphs(
        copy.animations[0], copy.character.morph_names, times, copy.character.rest_morph_weights
    )
    np.testing.assert_allclose(theirs, ours, atol=1e-6)
    assert errors_of(tmp_path / "a.glb") == []


@pytest.mark.parametrize("seed", range(12))
def test_weights_of_different_keys_and_interpolations_are_joined_exactly(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    character = faces(rng)
    curves = {}
    for name in ("a", "b", "c"):
        keys = int(rng.integers(1, 6))
        times = np.sort(np.round(rng.uniform(0, 3, keys), 2)) + np.arange(keys) * 0.05
        values, ins, outs = (np.float32(rng.normal(size=(keys, 1))) for _ in range(3))
        modes = rng.integers(0, 3, keys) if seed % 2 else np.full(keys, rng.integers(0, 3))
        curves[Channel(name, Property.WEIGHT)] = Curve(times, values, modes, ins, outs, CurveKind.SCALAR)
    clip = Clip(curves, "mixed")
    write(Scene((character,), (clip,)), tmp_path / "a.glb")
    copy = read(tmp_path / "a.glb")
    times = np.linspace(-0.1, 3.4, 500)
    steps = np.concatenate([c.times_s for c in curves.values()])
    times = times[np.min(np.abs(times[:, None] - steps), axis=1) > 1e-4]  # beside the jumps of steps
    ours = evaluate.sample_morphs(clip, character.morph_names, times, character.rest_morph_weights)
    theirs = evaluate.sample_morphs(copy.animations[0], character.morph_names, times, character.rest_morph_weights)
    assert copy.character.morph_names == character.morph_names
    np.testing.assert_allclose(theirs, ours, atol=2e-5)
    assert errors_of(tmp_path / "a.glb") == []


# --- animations ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("kind", [CurveKind.VECTOR, CurveKind.ROTATION])
def test_curves_of_mixed_interpolation_are_written_exactly(kind: CurveKind, seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    keys, width = 7, 4 if kind is CurveKind.ROTATION else 3
    values, ins, outs = (rng.normal(size=(keys, width)) for _ in range(3))
    if kind is CurveKind.ROTATION:
        values /= np.linalg.norm(values, axis=1, keepdims=True)
        ins, outs = 0.3 * ins, 0.3 * outs
    times = np.cumsum(rng.uniform(0.2, 1, keys))
    modes = [[STEP, LINEAR, HERMITE], [STEP, LINEAR], [LINEAR, HERMITE], [STEP, HERMITE], [LINEAR]][seed % 5]
    curve = Curve(times, values, rng.choice(modes, keys), ins, outs, kind)
    property = Property.ROTATION if kind is CurveKind.ROTATION else Property.TRANSLATION
    clip = Clip({Channel("a", property): curve}, "mixed")
    write(Scene((Character(bone("a")),), (clip,)), tmp_path / "a.glb")
    copy = read(tmp_path / "a.glb").animations[0]
    assert isinstance(copy, Clip)
    at = np.linspace(times[0] - 0.5, times[-1] + 0.5, 400)
    at = at[np.min(np.abs(at[:, None] - times), axis=1) > 1e-4]
    ours = np.asarray(evaluate.sample_curve(curve, at))
    theirs = np.asarray(evaluate.sample_curve(copy.curve("a", property), at))
    if kind is CurveKind.ROTATION:
        theirs = np.where(np.sum(ours * theirs, axis=1, keepdims=True) < 0, -theirs, theirs)
    np.testing.assert_allclose(theirs, ours, atol=5e-6)
    assert errors_of(tmp_path / "a.glb") == []


@pytest.mark.parametrize("mode", [STEP, LINEAR, HERMITE])
def test_one_interpolation_is_written_as_it_is(mode: Interpolation, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    times = np.float32(np.cumsum(rng.random(5))).astype(np.float64)
    values, ins, outs = (np.float32(rng.normal(size=(5, 3))) for _ in range(3))
    tangents = (ins, outs) if mode is HERMITE else (None, None)
    curve = Curve(times, values, mode, *tangents)
    write(Scene((Character(bone("a")),), (Clip({Channel("a", Property.SCALE): curve}, "x"),)), tmp_path / "a.glb")
    copy = read(tmp_path / "a.glb").animations[0]
    assert isinstance(copy, Clip)
    assert_same_curve(curve, copy.curve("a", Property.SCALE), mode.name)


def test_time_before_zero_is_moved_and_moved_back(tmp_path: Path) -> None:
    curve = Curve([-1.5, 0.25], np.float32([[0, 0, 0], [1, 1, 1]]))
    notes = write(
        Scene((Character(bone("a")),), (Clip({Channel("a", Property.TRANSLATION): curve}, "x"),)), tmp_path / "a.glb"
    )
    assert any("moved by 1.5 s" in note for note in notes)
    copy = read(tmp_path / "a.glb").animations[0]
    assert isinstance(copy, Clip)
    np.testing.assert_allclose(copy.curve("a", Property.TRANSLATION).times_s, [-1.5, 0.25], atol=1e-7)
    assert errors_of(tmp_path / "a.glb") == []


def test_what_is_dropped_is_told(tmp_path: Path) -> None:
    moving = Curve([0, 1], np.float32([[0, 0, 0], [1, 1, 1]]), after=Extrapolation.CYCLE)
    clip = Clip({Channel("a", Property.TRANSLATION): moving, Channel("lost", Property.ROTATION): _turn()}, "x")
    nothing = Clip({Channel("lost", Property.ROTATION): _turn()}, "nothing")
    motion = evaluate.bake(clip, bone("a"), 10.0)
    motion = replace(motion, events=(Event(0.5, "step"),), name="with events")
    notes = " ".join(write(Scene((Character(bone("a")),), (clip, nothing, motion)), tmp_path / "a.glb"))
    for word in (
        "other extrapolation",
        "1 targets do not exist and were dropped: lost",
        "'nothing' moves nothing",
        "1 events",
    ):
        assert word in notes, word
    assert [a.name for a in read(tmp_path / "a.glb").animations] == ["x", "with events"]


def _turn() -> Curve:
    return Curve([0, 1], np.float32([[1, 0, 0, 0], [0, 1, 0, 0]]), kind=CurveKind.ROTATION)


@pytest.mark.parametrize("moves", ["nothing", "root", "leaf"])
def test_motions_keep_their_length_and_leave_out_what_rests(moves: str, tmp_path: Path) -> None:
    skeleton = bone("a", "b", "c")
    frames = 9
    translations = np.tile(skeleton.rest.translations, (frames, 1, 1))
    rotations = np.tile(skeleton.rest.rotations, (frames, 1, 1))
    if moves == "root":
        translations[:, 0, 0] = np.arange(frames)
    if moves == "leaf":
        translations[:, 2] = (5, 5, 5)  # still, but not at rest
    motion = Motion(skeleton.names, Pose(translations, rotations, np.ones((3, 3))), 24.0, "m", start_s=0.5)
    write(Scene((Character(skeleton),), (motion,)), tmp_path / "a.glb")
    clip = read(tmp_path / "a.glb").animations[0]
    assert isinstance(clip, Clip)
    assert len(clip.curves) == 1
    assert clip.rate_hz == 24.0
    assert clip.end_s == pytest.approx(0.5 + 8 / 24, abs=1e-6)
    assert roundtrip_error(motion, clip, skeleton).within(1e-3, 1e-4)
    assert errors_of(tmp_path / "a.glb") == []


def test_random_motions_of_random_skeletons(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    for number in range(4):
        skeleton = random_skeleton(rng, 20, roots=1 + number % 2)
        frames = 30
        pose = Pose(
            0.3 * rng.normal(size=(frames, 20, 3)),
            np.asarray(keypose.math.quat.normalize(rng.normal(size=(frames, 20, 4)))),
            np.ones((20, 3)),
        )
        motion = Motion(skeleton.names, pose, 30.0, "random")
        write(Scene((Character(skeleton),), (motion,)), tmp_path / f"{number}.glb")
        copy = read(tmp_path / f"{number}.glb")
        assert copy.character.skeleton.names == skeleton.names
        assert roundtrip_error(motion, copy.animations[0], skeleton, copy.character.skeleton).within(1e-3, 1e-4)
    assert errors_of(*tmp_path.glob("*.glb")) == []


# --- files -----------------------------------------------------------------------------------------------------------


def test_several_characters_are_several_roots(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    one = Character(bone("hips", "spine"), (Part("p", cloth(rng), joint=1),), "one")
    two = Character(bone("tail"), (), "two")
    clip = Clip({Channel("spine", Property.ROTATION): _turn(), Channel("tail", Property.ROTATION): _turn()}, "both")
    notes = write(Scene((one, two), (clip,)), tmp_path / "a.glb")
    assert notes == ()
    copy = read(tmp_path / "a.glb")
    assert copy.character.skeleton.names == ("hips", "spine", "tail")
    assert copy.character.skeleton.parents.tolist() == [-1, 0, -1]
    assert len(copy.animations[0].curves) == 2  # type: ignore[union-attr]


def test_materials_and_pictures_come_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    png = b"\x89PNG\r\n\x1a\n" + bytes(30)
    picture, other = Image("weave", "image/png", png), Image("bump", "image/jpeg", b"\xff\xd8\xff" + bytes(30))
    settings = {
        "normalTexture": {"image": other, "scale": 0.5, "sampler": {"wrapS": 33071}},
        "pbrMetallicRoughness": {"baseColorTexture": {"texCoord": 0, "sampler": {"magFilter": 9729}}},
        "extensions": {"KHR_materials_ior": {"ior": 1.4}},
    }
    material = Material(
        "cloth",
        (0.1, 0.2, 0.3, 0.5),
        0.25,
        0.75,
        (0.5, 0, 1),
        picture,
        "MASK",
        0.25,
        True,
        True,
        {"gltf": settings, "by": "me"},
    )
    mesh = replace(cloth(rng), uvs=np.zeros((12, 2), np.float32))
    write(Scene((Character(bone("a"), (Part("p", mesh, material, joint=0),)),)), tmp_path / "a.glb")
    copy = read(tmp_path / "a.glb").character.parts[0].material
    assert (copy.name, copy.base_color, copy.metallic, copy.roughness) == ("cloth", (0.1, 0.2, 0.3, 0.5), 0.25, 0.75)
    assert (copy.emissive, copy.alpha_mode, copy.alpha_cutoff) == ((0.5, 0, 1), "MASK", 0.25)
    assert (copy.double_sided, copy.unlit) == (True, True)
    assert copy.base_color_image is not None and copy.base_color_image.data == png
    assert copy.extras["by"] == "me"
    assert copy.extras["gltf"]["normalTexture"]["image"].data == other.data
    assert copy.extras["gltf"]["extensions"]["KHR_materials_ior"] == {"ior": 1.4}
    document, _ = split((tmp_path / "a.glb").read_bytes())
    assert set(document["extensionsUsed"]) == {"KHR_materials_ior", "KHR_materials_unlit"}


def test_extras_and_the_generator(tmp_path: Path) -> None:
    skeleton = replace(bone("a", "b"), end_offsets=((1, (0.0, 0.25, 0.0)),))
    extras = {"bvh": {"channels": {"a": "Xposition Zrotation"}, "rate": 120.0, "array": np.arange(3)}}
    character = Character(skeleton, name="actor", roles={"hips": 0}, extras=extras)
    source = {"gltf": {"scene_extras": {"s": 1}, "extras": {"e": 2}, "asset": {"copyright": "(c) me"}}, "mine": [1, 2]}
    write(Scene((character,), unit_m=0.01, up="Z", extras=source), tmp_path / "a.glb")
    document, _ = split((tmp_path / "a.glb").read_bytes())
    assert document["asset"]["generator"] == f"keypose {keypose.__version__}"
    assert document["asset"]["copyright"] == "(c) me"
    copy = read(tmp_path / "a.glb")
    assert (copy.unit_m, copy.up, copy.extras["mine"]) == (0.01, "Z", [1, 2])
    assert copy.character.name == "actor"
    assert copy.character.extras["bvh"] == {**extras["bvh"], "array": [0, 1, 2]}
    assert dict(copy.character.roles) == {"hips": 0}
    assert copy.character.skeleton.end_offsets == ((1, (0.0, 0.25, 0.0)),)
    assert copy.extras["gltf"]["scene_extras"] == {"s": 1}
    assert copy.extras["gltf"]["extras"] == {"e": 2}


def test_gltf_with_its_data_beside_it_or_inside(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    scene = Scene((Character(bone("a"), (Part("p", cloth(rng), joint=0),)),))
    write(scene, tmp_path / "two words.gltf")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["two words.bin", "two words.gltf"]
    document = json.loads((tmp_path / "two words.gltf").read_text())
    assert document["buffers"][0]["uri"] == "two%20words.bin"
    write(scene, tmp_path / "one.gltf", embed=True)
    assert not (tmp_path / "one.bin").exists()
    assert_same_scene(read(tmp_path / "one.gltf"), read(tmp_path / "two words.gltf"))


def test_nothing_is_left_behind_where_writing_fails(tmp_path: Path) -> None:
    scene = Scene((Character(bone("a")),))
    for path in (tmp_path / "no" / "a.glb", tmp_path / "a.vrm", tmp_path / "a.txt"):
        with pytest.raises(FormatError):
            write(scene, path)
    deep: Any = {}
    for _ in range(3000):
        deep = {"d": deep}
    with pytest.raises(FormatError, match="nested too deeply"):
        write(Scene((Character(bone("a"), extras={"deep": deep}),)), tmp_path / "a.glb")
    assert list(tmp_path.iterdir()) == []


def test_an_empty_scene_is_a_valid_file(tmp_path: Path) -> None:
    write(Scene(), tmp_path / "a.glb")
    assert read(tmp_path / "a.glb").characters == ()
    assert errors_of(tmp_path / "a.glb") == []
