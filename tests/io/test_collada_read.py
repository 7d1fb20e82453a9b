"""Reading COLLADA: facts of real files, every kind of transform, channel and primitive by hand, other libraries' reading."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BPoly
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import keypose.io
from keypose import deform, evaluate
from keypose.errors import FormatError
from keypose.io.collada_nodes import matrix_of
from keypose.model import Channel, Clip, Curve, Interpolation, Property, Scene
from tests.conftest import ROOT
from tests.io.collada_files import NODES, collada, sampler

Z_TO_Y = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])


def load(folder: Path, **options: Any) -> Scene:
    path = folder / "small.dae"
    path.write_text(collada(**options))
    return keypose.io.load(path)


def clip_of(scene: Scene) -> Clip:
    clip = scene.animation()
    assert isinstance(clip, Clip)
    return clip


def places(scene: Scene, times: Any) -> dict[str, np.ndarray]:
    skeleton = scene.character.skeleton
    matrices = np.asarray(evaluate.world(skeleton, evaluate.sample_clip(clip_of(scene), skeleton, np.asarray(times))))
    return {name: matrices[..., j, :, :] for j, name in enumerate(skeleton.names)}


# --- facts of real files ----------------------------------------------------------------------------------------------------


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "up", "unit_m", "joints", "clips", "vertices"),
    [
        ("assimp/library_animation_clips.dae", "Z", 1.0, 5, 2, True),
        ("ozz/astro_maya.dae", "Y", 0.01, 55, 1, True),
        ("ozz/seymour.dae", "Y", 0.01, 19, 1, True),
        ("ozz/skeleton.dae", "Y", 0.01, 67, 1, False),  # its skin is of a geometry that the file does not hold
        ("ozz/walk.dae", "Y", 0.01, 67, 1, False),
    ],
)
def test_facts_of_real_files(
    data_dir: Path, name: str, up: str, unit_m: float, joints: int, clips: int, vertices: bool
) -> None:
    path = data_dir / "collada" / name
    scene = keypose.io.load(path)
    assert (scene.format, scene.up, scene.unit_m, len(scene.animations)) == ("collada", up, unit_m, clips)
    text = path.read_text()
    assert text.count('type="JOINT"') == joints
    assert scene.character.skeleton.joint_count >= joints
    assert bool(scene.character.vertex_count) == vertices
    if name.startswith("ozz"):  # stands upright, on the ground, faces +Z
        clip, skeleton = clip_of(scene), scene.character.skeleton
        pose = evaluate.sample_clip(clip, skeleton, np.array([clip.start_s]))
        positions = np.asarray(evaluate.world(skeleton, pose))[0, :, :3, 3]
        assert np.argmax(np.ptp(positions, axis=0)) in (0, 1) and positions[:, 1].min() > -0.05
        left = [j for j, n in enumerate(skeleton.names) if n.lower().startswith(("l_", "left"))]
        right = [j for j, n in enumerate(skeleton.names) if n.lower().startswith(("r_", "right"))]
        assert positions[left, 0].mean() > positions[right, 0].mean()
    if name == "ozz/skeleton.dae":
        assert any("not in the file" in note for note in scene.notes)


@pytest.mark.data
def test_clips_of_their_own(data_dir: Path) -> None:
    scene = keypose.io.load(data_dir / "collada/assimp/library_animation_clips.dae")
    assert [(c.name, round(c.start_s, 6), round(c.end_s, 6)) for c in scene.animations if isinstance(c, Clip)] == [
        ("bend", 0.041667, 0.625), ("turn", 0.0, 0.833333),
    ]  # fmt: skip


@pytest.mark.data
def test_matrices_of_a_real_walk(data_dir: Path) -> None:
    """Every key of every joint, read here with a regular expression."""
    import re

    path = data_dir / "collada/ozz/walk.dae"
    text, scene = path.read_text(), keypose.io.load(path)
    clip, skeleton = clip_of(scene), scene.character.skeleton
    checked = 0
    for name in ("Hips", "LeftLeg", "RightArm", "Head", "Spine2"):
        block = re.search(rf'<float_array id="{name}-Matrix-animation-output-transform-array"[^>]*>([^<]*)<', text)
        times = re.search(rf'<float_array id="{name}-Matrix-animation-input-array"[^>]*>([^<]*)<', text)
        if not block or not times:
            continue
        expected = np.array(block[1].split(), float).reshape(-1, 4, 4)
        expected[:, :3, 3] *= 0.01
        pose = evaluate.sample_clip(clip, skeleton, np.array(times[1].split(), float))
        joint = skeleton.index(name)
        from keypose.math import rigid

        pose = pose.broadcast()
        found = rigid.from_trs(pose.translations[:, joint], pose.rotations[:, joint], pose.scales[:, joint])
        np.testing.assert_allclose(found, expected, atol=3e-6)  # the file has six digits
        checked += 1
    assert checked >= 4


@pytest.mark.data
@pytest.mark.parametrize("name", ["assimp/library_animation_clips", "ozz/astro_maya", "ozz/seymour"])
def test_meshes_as_pycollada_reads_them(data_dir: Path, name: str) -> None:
    pycollada = pytest.importorskip("collada", reason="pycollada is not installed")
    path = data_dir / f"collada/{name}.dae"
    theirs = pycollada.Collada(str(path), ignore=[pycollada.common.DaeError])
    scene = keypose.io.load(path)
    unit_m = scene.unit_m
    other = []
    for geometry in theirs.geometries:
        for primitive in geometry.primitives:
            triangles = primitive.triangleset() if hasattr(primitive, "triangleset") else primitive
            corners = triangles.vertex[triangles.vertex_index].reshape(-1, 3) * unit_m
            uv = None
            if triangles.texcoordset:
                uv = triangles.texcoordset[0][triangles.texcoord_indexset[0]].reshape(-1, 2)
            other.append((corners, uv, triangles.normal[triangles.normal_index].reshape(-1, 3)))
    mine = scene.character.parts
    assert len(mine) == len(other) > 0
    for part in mine:
        corners = np.asarray(part.mesh.positions)[part.mesh.triangles].reshape(-1, 3)
        match = next(o for o in other if o[0].shape == corners.shape and np.allclose(o[0], corners, atol=1e-6))
        assert part.mesh.normals is not None
        normals = match[2] / np.linalg.norm(match[2], axis=1, keepdims=True)
        np.testing.assert_allclose(
            np.asarray(part.mesh.normals)[part.mesh.triangles].reshape(-1, 3), normals, atol=1e-5
        )
        if match[1] is not None:
            assert part.mesh.uvs is not None
            uvs = np.asarray(part.mesh.uvs)[part.mesh.triangles].reshape(-1, 2)
            np.testing.assert_allclose(uvs, match[1] * (1, -1) + (0, 1), atol=1e-5)


@pytest.mark.data
@pytest.mark.parametrize("name", ["ozz/astro_maya", "ozz/seymour"])
def test_a_bound_skin_stands_where_its_geometry_is(data_dir: Path, name: str) -> None:
    """At the bind pose, skinning changes nothing: the matrices of all influences agree on it."""
    scene = keypose.io.load(data_dir / f"collada/{name}.dae")
    part = next(p for p in scene.character.parts if p.skin is not None)
    assert part.skin is not None
    world = np.linalg.inv(np.asarray(part.skin.joint_from_mesh))
    palette = world @ np.asarray(part.skin.joint_from_mesh)
    np.testing.assert_allclose(palette, np.broadcast_to(np.eye(4), palette.shape), atol=1e-9)
    assert (
        len(part.skin.palette) == (44 if "astro" in name else len(part.skin.palette))
        and part.skin.influence_count <= 16
    )
    np.testing.assert_allclose(np.asarray(part.skin.weights).sum(axis=1), 1, atol=1e-12)


@pytest.mark.data
@pytest.mark.parametrize(("name", "alike"), [("walk", 67), ("skeleton", 37)])
def test_the_same_scene_as_fbx(data_dir: Path, name: str, alike: int) -> None:
    """Every joint of the walk; of the other file all but the fingers, which the two exports bend differently."""
    pytest.importorskip("ufbx", reason="ufbx is not installed")
    scenes = [
        keypose.io.load(data_dir / f"collada/ozz/{name}.dae"),
        keypose.io.load(data_dir / f"fbx/ozz_pab/{name}.fbx"),
    ]
    mine, theirs = (scene.character.skeleton for scene in scenes)
    times = np.linspace(0, 1.3, 14)
    a, b = (
        np.asarray(evaluate.world_rotations_positions(k, evaluate.sample(s.animations[0], k, times))[1])
        for s, k in zip(scenes, (mine, theirs), strict=True)
    )
    distance = [
        np.linalg.norm(a[:, joint] - b[:, theirs.index(joint_name)], axis=1).max()
        for joint, joint_name in enumerate(mine.names)
    ]
    same = np.array(distance) < 5e-6
    assert same.sum() == alike
    assert all(any(word in n for word in ("Thumb", "Index", "Middle", "Ring", "Pinky", "Finger"))
               for n, s in zip(mine.names, same, strict=True) if not s)  # fmt: skip


# --- transforms -------------------------------------------------------------------------------------------------------------


def test_transforms_by_hand() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        axis, angle = rng.normal(size=3), rng.uniform(-400, 400)
        expected = Rotation.from_rotvec(np.radians(angle) * axis / np.linalg.norm(axis)).as_matrix()
        np.testing.assert_allclose(matrix_of("rotate", [*axis, angle])[:3, :3], expected, atol=1e-12)
    np.testing.assert_array_equal(matrix_of("rotate", [0, 0, 0, 50]), np.eye(4))
    np.testing.assert_array_equal(matrix_of("matrix", np.arange(16))[1], [4, 5, 6, 7])
    np.testing.assert_array_equal(matrix_of("translate", [1, 2, 3])[:3, 3], [1, 2, 3])
    np.testing.assert_array_equal(np.diag(matrix_of("scale", [1, 2, 3])), [1, 2, 3, 1])
    eye, target, up = np.array([1.0, 2, 3]), np.array([4.0, -1, 0]), np.array([0.0, 1, 0])
    look = matrix_of("lookat", np.concatenate([eye, target, up]))
    np.testing.assert_allclose(look[:3, 3], eye)
    np.testing.assert_allclose(-look[:3, 2], (target - eye) / np.linalg.norm(target - eye))
    assert look[:3, 1] @ up > 0 and abs(look[1, 0]) < 1e-12
    np.testing.assert_allclose(look[:3, :3] @ look[:3, :3].T, np.eye(3), atol=1e-12)
    # what points where up points, and what looks nowhere, still gives a frame
    for odd in ([0, 0, 0, 0, 5, 0, 0, 1, 0], [1, 1, 1, 1, 1, 1, 0, 1, 0], [0, 0, 0, 0, 0, 1, 0, 0, 0]):
        frame = matrix_of("lookat", odd)[:3, :3]
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    skewed = matrix_of("skew", [45, 0, 1, 0, 1, 0, 0])  # y is moved along x
    np.testing.assert_allclose(skewed[:3, :3] @ (0, 1, 0), (1, 1, 0), atol=1e-12)


def test_the_node_tree(tmp_path: Path) -> None:
    scene = load(tmp_path)
    skeleton = scene.character.skeleton
    assert skeleton.names == ("arm", "elbow", "flag", "looker", "pair", "spare", "spare_2")
    assert any("lamp" in note or "1 nodes that hold neither" in note for note in scene.notes)
    rest = np.asarray(evaluate.world(skeleton, skeleton.rest))
    flag = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    np.testing.assert_allclose(rest[2, :3, 3], Z_TO_Y @ flag @ (0.1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(rest[2, :3, :3], Z_TO_Y @ flag @ np.diag([1, 2, 1]), atol=1e-12)
    np.testing.assert_allclose(rest[6, :3, 3], Z_TO_Y @ (0, 0.03, 0), atol=1e-12)
    assert scene.character.name == "test" and scene.up == "Z" and scene.unit_m == 0.01
    # options overrule
    other = keypose.io.load(tmp_path / "small.dae", up="Y", unit="m")
    positions = np.asarray(evaluate.world(other.character.skeleton, other.character.skeleton.rest))
    np.testing.assert_allclose(positions[3, :3, 3], (1, 2, 3), atol=1e-12)
    x_up = load(tmp_path, up="X_UP")
    positions = np.asarray(evaluate.world(x_up.character.skeleton, x_up.character.skeleton.rest))
    np.testing.assert_allclose(positions[3, :3, 3], (-0.02, 0.01, 0.03), atol=1e-12)


# --- meshes, skins, morphs ----------------------------------------------------------------------------------------------------


def test_meshes(tmp_path: Path) -> None:
    scene = load(tmp_path)
    parts = {part.name: part for part in scene.character.parts}
    assert set(parts) == {"Tube", "Flag_0", "Flag_1", "Flag_2"}
    tube = parts["Tube"].mesh
    assert tube.vertex_count == 7 and len(tube.triangles) == 4  # point 2 has two texture coordinates
    corners = np.asarray(tube.positions)[tube.triangles].reshape(-1, 3) * 100
    np.testing.assert_allclose(corners[:3], [(0, -1, 0), (2, -1, 0), (2, 1, 0)], atol=1e-12)
    assert tube.uvs is not None and tube.normals is not None
    np.testing.assert_allclose(np.asarray(tube.uvs)[tube.triangles[2, 0]], (0.5, 0.75))
    np.testing.assert_array_equal(tube.normals, np.tile((0, 0, 1), (7, 1)))
    assert len(parts["Flag_0"].mesh.triangles) == 3 and parts["Flag_0"].mesh.colors is not None
    np.testing.assert_array_equal(parts["Flag_1"].mesh.triangles, [(0, 1, 3), (1, 2, 3)])  # both turn the same way
    np.testing.assert_array_equal(parts["Flag_2"].mesh.triangles, [(0, 1, 2), (0, 2, 3)])
    material = parts["Tube"].material
    assert (material.name, material.base_color, material.emissive) == ("Red", (0.9, 0.1, 0.2, 1.0), (0, 0.5, 0))
    assert any("lines" in note for note in scene.notes)


def test_skin_by_hand(tmp_path: Path) -> None:
    """v = sum of weight * world * inverse bind * bind shape * v, in the file's space."""
    scene = load(tmp_path)
    part = next(p for p in scene.character.parts if p.skin is not None)
    skeleton, time = scene.character.skeleton, 0.8
    pose = evaluate.sample_clip(clip_of(scene), skeleton, np.array([time]))[0]
    found = deform.skin(part.mesh, part.skin, evaluate.world(skeleton, pose))
    found = np.asarray(found[0] if isinstance(found, tuple) else found)
    arm, elbow = np.eye(4), np.eye(4)
    arm[0, 3] = BPoly.from_derivatives([0, 2], [[0, 3], [4, 0]])(time)  # the file has the slope times the span, 2 s
    angle = bezier_angle(time)
    elbow[:3, :3], elbow[0, 3] = Rotation.from_euler("z", angle, degrees=True).as_matrix(), 2
    world = [arm, arm @ elbow]
    shape, binds = np.eye(4), [np.eye(4), np.eye(4)]
    shape[2, 3], binds[0][2, 3], binds[1][2, 3], binds[1][0, 3] = 5, -5, -5, -2
    points = np.array([(0, -1, 0), (0, 1, 0), (2, -1, 0), (2, 1, 0), (4, -1, 0), (4, 1, 0)], float)
    weights = [(1, 0), (1, 0), (0.5, 0.5), (0.5, 0.5), (0, 1), (0.5, 0.5)]
    expected = []
    for point, own in zip(points, weights, strict=True):
        vector = np.array([*point, 1])
        expected.append(sum(w * (m @ b @ shape @ vector) for w, m, b in zip(own, world, binds, strict=True))[:3])
    expected = np.array(expected) * 0.01 @ Z_TO_Y.T
    order = [int(np.argmin(np.linalg.norm(points * 0.01 - p, axis=1))) for p in np.asarray(part.mesh.positions)]
    np.testing.assert_allclose(found, expected[order], atol=1e-5)
    assert any("did not add up to 1" in note for note in scene.notes)  # the last one has two quarters


def test_morphs(tmp_path: Path) -> None:
    scene = load(tmp_path)
    character = scene.character
    assert character.morph_names == ("blown",)
    np.testing.assert_allclose(character.rest_morph_weights, [0.25])
    part = next(p for p in character.parts if p.name == "Flag_1")
    assert part.morphs is not None
    dense = part.morphs.dense(part.mesh.vertex_count)[0][0]
    np.testing.assert_allclose(dense[:, 2], [0, 0.03, 0.03, 0, 0][: len(dense)], atol=1e-12)
    weights = evaluate.sample_morphs(clip_of(scene), character.morph_names, [0, 0.3, 1], character.rest_morph_weights)
    np.testing.assert_allclose(np.asarray(weights)[:, 0], [0, 0.3, 1], atol=1e-12)


# --- animation ----------------------------------------------------------------------------------------------------------------


def bezier_angle(time: float) -> float:
    """The angle of the elbow in the small file, with SciPy's root finder."""
    keys = [((0, 0), (0.5, 0), (0.9, 60), (1, 60)), ((1, 60), (1.3, 80), (1.5, -40), (2, -30))]
    span = np.array(keys[0 if time < 1 else 1], float)

    def at(s: float, column: int) -> float:
        basis = np.array([(1 - s) ** 3, 3 * s * (1 - s) ** 2, 3 * s * s * (1 - s), s**3])
        return float(basis @ span[:, column])

    return at(brentq(lambda s: at(s, 0) - time, 0, 1, xtol=1e-14), 1)


def test_bezier(tmp_path: Path) -> None:
    scene = load(tmp_path)
    times = np.random.default_rng(0).uniform(0, 2, 200)
    skeleton = scene.character.skeleton
    pose = evaluate.sample_clip(clip_of(scene), skeleton, times)
    rotation = np.asarray(pose.rotations)[:, skeleton.index("elbow")]
    angles = np.degrees(2 * np.arctan2(rotation[:, 3], rotation[:, 0]))
    angles = (angles + 180) % 360 - 180
    np.testing.assert_allclose(angles, [bezier_angle(t) for t in times], atol=5e-3)


def test_hermite_and_step(tmp_path: Path) -> None:
    scene = load(tmp_path)
    times = np.random.default_rng(1).uniform(0, 2, 200)
    found = places(scene, times)
    slide = BPoly.from_derivatives([0, 2], [[0, 3], [4, 0]])
    np.testing.assert_allclose(found["arm"][:, 0, 3], slide(times) * 0.01, atol=1.5e-5)
    hop = np.where(times < 1, 0, 5)
    flag = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    expected = np.stack([np.full(len(times), 10), hop, np.zeros(len(times))], axis=1) @ (Z_TO_Y @ flag).T * 0.01
    np.testing.assert_allclose(found["flag"][:, :3, 3], expected, atol=1e-12)
    curve = clip_of(scene).curves[Channel("flag", Property.TRANSLATION)]
    assert isinstance(curve, Curve) and np.all(np.asarray(curve.modes) == Interpolation.STEP)


@pytest.mark.parametrize(
    ("target", "width", "values", "expected"),
    [
        ("looker/matrix", 16, "1 0 0 4 0 1 0 5 0 0 1 6 0 0 0 1", (4, 5, 6)),
        ("looker/matrix(0)(3)", 1, "9", (9, 2, 3)),
        ("looker/matrix(7)", 1, "9", (1, 9, 3)),
        ("looker/at", 3, "7 8 9", (7, 8, 9)),
        ("looker/at.Z", 1, "8", (1, 2, 8)),
        ("looker/at(1)", 1, "8", (1, 8, 3)),
    ],
)
def test_targets(tmp_path: Path, target: str, width: int, values: str, expected: tuple[float, ...]) -> None:
    transform = (
        '<matrix sid="matrix">1 0 0 1 0 1 0 2 0 0 1 3 0 0 0 1</matrix>'
        if "matrix" in target
        else '<translate sid="at">1 2 3</translate>'
    )
    nodes = NODES.replace("<lookat>1 2 3  1 2 0  0 1 0</lookat>", transform)
    scene = load(
        tmp_path, nodes=nodes, animations=sampler("a", "0.5", values, "LINEAR", target, width), up="Y_UP", meter="1"
    )
    np.testing.assert_allclose(places(scene, [0.5])["looker"][0, :3, 3], expected, atol=1e-12)


def test_tangents_without_times(tmp_path: Path) -> None:
    """One number per key: the handles stand at thirds of the span, where a Bezier curve is a plain cubic."""
    animation = sampler("a", "0 3", "0 6", "BEZIER BEZIER", "arm/move.X", tangents="0 5|1 0")
    found = places(load(tmp_path, animations=animation, meter="1"), np.linspace(0, 3, 31))["arm"][:, 0, 3]
    s = np.linspace(0, 1, 31)
    expected = 3 * s * (1 - s) ** 2 * 1 + 3 * s**2 * (1 - s) * 5 + s**3 * 6
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_clips_cut_and_left_over(tmp_path: Path) -> None:
    clips = (
        '<library_animation_clips><animation_clip id="c" name="half" start="0.5" end="1.5"><instance_animation url="#bend"/>'
        "</animation_clip></library_animation_clips>"
    )
    scene = load(tmp_path, clips=clips)
    half, rest = scene.animations
    assert isinstance(half, Clip) and isinstance(rest, Clip)
    assert (half.name, half.start_s, half.end_s) == ("half", 0.5, 1.5) and rest.name == "small"
    assert {c.target for c in half.curves} == {"elbow"} and "elbow" not in {c.target for c in rest.curves}
    skeleton = scene.character.skeleton
    rotation = np.asarray(evaluate.sample_clip(half, skeleton, np.array([0.5, 1.2])).rotations)[
        :, skeleton.index("elbow")
    ]
    angles = np.degrees(2 * np.arctan2(rotation[:, 3], rotation[:, 0]))
    np.testing.assert_allclose(angles, [bezier_angle(0.5), bezier_angle(1.2)], atol=5e-3)


# --- faults -------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</COLLADA>", "", "line .*no well-formed XML"),
        ("<COLLADA", '<!DOCTYPE x [<!ENTITY a "b">]>\n<COLLADA', "line 2: a document type"),
        ("2 0 0</translate>", "2 0</translate>", "<translate>: expected 3 numbers, found 2"),
        ("2 0 0</translate>", "2 0 nan</translate>", "expected a number, found 'nan'"),
        ("2 0 0</translate>", "2 0 1e300</translate>", "a number of size 1e\\+300"),
        ('meter="0.01"', 'meter="one"', "meter: expected a number, found 'one'"),
        ('url="#spare"', 'url="#spars"', "url: there is no <node> '#spars'"),
        ("<translate>0 3 0</translate>", '<instance_node url="#spare"/>', "holds itself"),
    ],
)
def test_faults(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = collada()
    assert old in text
    path = tmp_path / "a.dae"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(FormatError, match=message) as error:
        keypose.io.load(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [
        ("<vcount>4 4</vcount>", "<vcount>4 9</vcount>", "what node 'tube-node' shows was dropped.*corners"),
        ("0 0 0 2 0 2 3 0 3 1 0 1", "0 0 0 2 0 2 3 0 3 1 0 99", "index 99 is beyond the 7 items"),
        ("<vcount>1 1 2 2 1 2</vcount>", "<vcount>1 1 2 2 1 9</vcount>", "adds up to 16"),
        ("J0 J1", "J0 J7", "there is no joint 'J7'"),
        (">flag-blown<", ">tube<", "other points than what it is a target of"),
        ("elbow/rotateZ.ANGLE", "elbow/rotateZ.WHAT", "there is no member 'WHAT'"),
        ("elbow/rotateZ.ANGLE", "elbow/rotateX.ANGLE", "things that are not in the file"),
        ("elbow/rotateZ.ANGLE", "elbow/rotateZ(7)", "a rotate has 4 numbers"),
        ("BEZIER BEZIER BEZIER", "BEZIER BEZIER", "expected 3 names, found 2"),
    ],
)
def test_one_fault_does_not_cost_the_rest(tmp_path: Path, old: str, new: str, note: str) -> None:
    import re

    text = collada()
    assert old in text
    path = tmp_path / "a.dae"
    path.write_text(text.replace(old, new, 1))
    scene = keypose.io.load(path)
    assert scene.character.skeleton.joint_count >= 6
    assert any(re.search(note, n) for n in scene.notes), scene.notes


def test_bombs(tmp_path: Path) -> None:
    path = tmp_path / "bomb.dae"
    laughs = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 9))
    head = '<?xml version="1.0"?>'
    for text, message in (
        (f'{head}<!DOCTYPE COLLADA [<!ENTITY l0 "lol">{laughs}]><COLLADA>&l8;</COLLADA>', "document type"),
        (f'{head}<!DOCTYPE COLLADA SYSTEM "file:///etc/passwd"><COLLADA/>', "document type"),
        (f"{head}<COLLADA>{'<node>' * 100_000}", "nested more than 2000 deep"),
        (f'{head}<COLLADA a="{"x" * 200_000}"/>', "absurd length"),
        (f"{head}<COLLADA>" + '<float_array count="99999999999">1</float_array></COLLADA>', None),
    ):
        path.write_text(text)
        if message is None:
            assert not keypose.io.load(path).characters
            continue
        with pytest.raises(FormatError, match=message):
            keypose.io.load(path)


def test_deep_chains_load(tmp_path: Path) -> None:
    nodes = (
        "".join(f'<node id="n{i}" type="JOINT"><translate>0 1 0</translate>' for i in range(1000)) + "</node>" * 1000
    )
    scene = load(tmp_path, nodes=nodes, animations="")
    assert scene.character.skeleton.joint_count == 1000


def test_the_page_in_the_docs() -> None:
    import doctest

    result = doctest.testfile(str(ROOT / "docs/formats/collada.md"), module_relative=False, encoding="utf-8")
    assert result.attempted > 5 and not result.failed
