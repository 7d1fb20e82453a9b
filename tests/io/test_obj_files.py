"""OBJ: real files against their facts and against trimesh, laws of cutting polygons, round trips, damage."""

from __future__ import annotations

import doctest
import re
from pathlib import Path

import numpy as np
import pytest

import keypose.io
from keypose.errors import FormatError, UnknownName
from keypose.io.normals import smooth_normals
from keypose.io.notes import Notes
from keypose.io.obj_polygons import triangulate
from keypose.io.obj_text import parse
from keypose.model import Character, Material, Mesh, MorphSet, Part, Pose, Scene, Skeleton
from tests.conftest import ROOT, find_data_dir
from tests.io.damage import load_damaged

CUBE = """# a cube of quads with two materials and its own corners of the picture
mtllib cube.mtl
o cube
v -1 -1 1
v 1 -1 1
v -1 1 1
v 1 1 1
v -1 1 -1
v 1 1 -1
v -1 -1 -1
v 1 -1 -1
vt 0 0
vt 1 0
vt 0 1
vt 1 1
usemtl red
s 1
f 1/1 2/2 4/4 3/3
f 3/1 4/2 6/4 5/3
f 5/4 6/3 8/1 7/2
usemtl blue
f 7/1 8/2 2/4 1/3
f 2/1 8/2 6/4 4/3
f 7/1 1/2 3/4 5/3
"""


def written(folder: Path, text: str | bytes, name: str = "file.obj") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def rows(table: np.ndarray) -> set[tuple[float, ...]]:
    return set(map(tuple, np.round(np.asarray(table, float), 9).tolist()))


# --- real files ------------------------------------------------------------------------------------------------------


@pytest.mark.data
def test_faces_have_the_stated_numbers(data_dir: Path) -> None:
    listed = re.findall(
        r"`(face/ict/\w+\.obj|makehuman/base\.obj)`.*?(\d+) vertices, (\d+) faces", (data_dir / "README.md").read_text()
    )
    assert len(listed) == 11
    for name, vertices, faces in listed:
        scene = keypose.io.load(data_dir / name)
        assert scene.character.extras["obj"] == {"vertices": int(vertices), "faces": int(faces)}
        assert all(np.isfinite(part.mesh.positions).all() for part in scene.character.parts)
        unit = 0.1 if "makehuman" in name else 0.01
        assert scene.unit_m == unit and sum("unit:" in note for note in scene.notes) == 1


@pytest.mark.data
def test_a_face_and_its_shapes_as_trimesh_reads_them(data_dir: Path) -> None:
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    folder = data_dir / "face" / "ict"
    path = folder / "generic_neutral_mesh.obj"
    character = keypose.io.load(path, targets=folder).character
    assert character.morph_names == tuple(sorted(p.stem for p in folder.glob("*.obj") if p != path))

    def theirs(file: Path) -> np.ndarray:
        loaded = trimesh.load(file, force="mesh", process=False, maintain_order=True, skip_materials=True)
        return np.asarray(loaded.vertices[loaded.faces] * 0.01)  # corners of triangles, (T, 3, 3)

    def ours(morph: str | None) -> np.ndarray:
        found = []
        for part in character.parts:
            positions = part.mesh.positions.astype(np.float64)
            if morph and part.morphs is not None and morph in part.morphs.names:
                positions = positions + part.morphs.dense(len(positions))[0][part.morphs.names.index(morph)]
            found.append(positions[part.mesh.triangles])
        return np.concatenate(found)

    for morph in (None, "jawOpen", "eyeBlink_L"):
        reference = theirs(folder / f"{morph}.obj" if morph else path)
        mine = ours(morph)
        assert len(mine) == len(reference) == character.triangle_count
        # the diagonals of quads may differ; the corners that are used, the area and its centre may not
        assert np.allclose(mine.min(axis=(0, 1)), reference.min(axis=(0, 1)), atol=1e-6)
        assert np.allclose(mine.max(axis=(0, 1)), reference.max(axis=(0, 1)), atol=1e-6)
        assert len(rows(np.round(mine.reshape(-1, 3), 6))) == pytest.approx(
            len(rows(np.round(reference.reshape(-1, 3), 6))), abs=20
        )
        area = [
            np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum() / 2 for t in (mine, reference)
        ]
        assert area[0] == pytest.approx(area[1], rel=1e-3)


@pytest.mark.data
def test_reference_meshes_of_other_tools_load(data_dir: Path) -> None:
    files = sorted(data_dir.glob("fbx/**/*.obj"))
    assert len(files) > 15
    for path in files:
        lines = path.read_text().splitlines()
        character = keypose.io.load(path, unit="m").character
        assert character.extras["obj"]["vertices"] == sum(line.startswith("v ") for line in lines)
        assert character.extras["obj"]["faces"] == sum(line.startswith("f ") for line in lines)
        stated = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], float)
        loaded = np.concatenate([part.mesh.positions for part in character.parts])
        assert rows(np.round(loaded, 4)) <= rows(np.round(stated.astype(np.float32), 4))


# --- text ------------------------------------------------------------------------------------------------------------


def test_what_a_small_file_says(tmp_path: Path) -> None:
    written(
        tmp_path,
        "newmtl red\nKd 1 0 0\nNs 250\nillum 2\nnewmtl blue\nKd 0 0 1\nd 0.5\nmap_Kd ../blue.png\n",
        "cube.mtl",
    )
    scene = keypose.io.load(written(tmp_path, CUBE), unit="cm")
    parts = scene.character.parts
    assert [part.name for part in parts] == ["cube red", "cube blue"]
    assert [part.material.base_color for part in parts] == [(1, 0, 0, 1), (0, 0, 1, 0.5)]
    assert parts[0].material.roughness == pytest.approx(0.5) and parts[1].material.alpha_mode == "BLEND"
    assert sum(len(part.mesh.triangles) for part in parts) == 12
    assert scene.unit_m == 0.01 and np.abs(parts[0].mesh.positions).max() == pytest.approx(0.01)
    assert parts[0].mesh.uvs is not None and rows(parts[0].mesh.uvs) == {(0, 0), (0, 1), (1, 0), (1, 1)}
    assert any("blue.png" in note and "beside" in note for note in scene.notes)  # never above the file's folder
    for part in parts:  # outward
        corners = part.mesh.positions[part.mesh.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert np.all(np.einsum("ti,ti->t", normals, corners.mean(axis=1)) > 0)
        assert np.allclose(
            part.mesh.normals, part.mesh.positions / np.linalg.norm(part.mesh.positions, axis=1)[:, None], atol=0.35
        )


def test_indices_that_count_back() -> None:
    forward = parse(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\nv 2 2 2\nf 1 2 4\n", Notes())
    backward = parse(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf -3//-1 -2//-1 -1//-1\nv 2 2 2\nf -4 -3 -1\n", Notes())
    assert np.array_equal(forward.corners, backward.corners)
    assert forward.corners.tolist() == [[0, -1, 0], [1, -1, 0], [2, -1, 0], [0, -1, -1], [1, -1, -1], [3, -1, -1]]


@pytest.mark.parametrize("style", ["{0}", "{0}/{1}", "{0}//{2}", "{0}/{1}/{2}"])
def test_blocks_and_words_give_the_same(style: str) -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(60, 3)).round(4)
    faces = [rng.choice(60, rng.integers(3, 7), replace=False) + 1 for _ in range(50)]

    def text(comment: str) -> bytes:
        lines = [f"v {x} {y} {z}{comment}" for x, y, z in points.tolist()]
        lines += [f"vt {x} {y}{comment}" for x, y, _ in points.tolist()] + [
            f"vn {x} {y} {z}{comment}" for x, y, z in points.tolist()
        ]
        lines += ["f " + " ".join(style.format(i, 61 - i, (i * 7) % 60 + 1) for i in face) + comment for face in faces]
        return "\n".join(lines).encode()

    blocks, words = parse(text(""), Notes()), parse(text(" # slow"), Notes())
    for end in (b"\r\n", b"\r", b" \\\n\n"):
        other = parse(text("").replace(b"\n", end) + b"\n", Notes())
        assert np.array_equal(blocks.corners, other.corners) and np.array_equal(blocks.positions, other.positions)
    for name in ("positions", "uvs", "normals", "corners", "sizes", "face_groups"):
        assert np.array_equal(getattr(blocks, name), getattr(words, name)), name
    assert np.array_equal(blocks.positions, points) and blocks.sizes.tolist() == [len(f) for f in faces]


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("v 0 0\n", "line 1"),
        ("v 0 0 0\nv 0 x 0\n", "line 2"),
        ("v 0 0 0\nv 0 nan 0\n", "line 2"),
        ("v 0 0 0\n\nf 1 2 3\n", "line 3"),
        ("v 0 0 0\nf 1 1 1\nf 1 1 -2\n", "line 3"),
        ("v 0 0 0\nf 1 1 0\n", "line 2"),
        ("v 0 0 0\nf 1/1 1/1 1/1\n", "line 2"),
        ("v 0 0 0\nf 1 1/ /1\n", "line 2"),
        ("v 0 0 0\nf 1 1 1.5\n", "line 2"),
        ("v 0 0 0\n?!\n", "line 2"),
        ("v 0 0 0\n\0\n", "line 2"),
        ("# nothing\n", "end of file"),
        ("\n".join(["v 0 0 0"] * 40 + ["v 0 0"] + ["v 0 0 0"] * 40), "line 41"),
        ("\n".join(["v 0 0 0"] * 3 + ["f 1 2 3"] * 40 + ["f 1 2 4"] + ["f 1 2 3"] * 40), "line 44"),
        ("\n".join(["v 0 0 0"] * 3 + ["f -1 -2 -3"] * 40 + ["f -1 -2 -4"] + ["f 1 2 3"] * 40), "line 44"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(tmp_path: Path, text: str, place: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(FormatError) as error:
        keypose.io.load(path)
    assert error.value.where == place and str(path) in str(error.value)


def test_options(tmp_path: Path) -> None:
    path = written(tmp_path, "v 0 0 180\nv 0 0 0\nv 30 0 0\nf 1 2 3\n")
    scene = keypose.io.load(path, up="Z")
    assert scene.unit_m == 0.01 and scene.up == "Z"
    assert np.allclose(scene.character.parts[0].mesh.positions, [[0, 1.8, 0], [0, 0, 0], [0.3, 0, 0]], atol=1e-6)
    assert keypose.io.load(path, unit=2.0).character.parts[0].mesh.positions[0, 2] == 360
    for options in ({"unit": "mile"}, {"up": "W"}, {"scale": 2}):
        with pytest.raises(UnknownName):
            keypose.io.load(path, **options)
    with pytest.raises(FormatError, match="face 1 has other vertices"):
        keypose.io.load(path, targets=[written(tmp_path, "v 0 0 1\nv 0 0 0\nv 3 0 0\nf 2 1 3\n", "other.obj")])


# --- polygons --------------------------------------------------------------------------------------------------------


def outline(rng: np.random.Generator, corners: int) -> np.ndarray:
    """A star-shaped outline, dented at many corners, in a random plane."""
    angles = (np.arange(corners) + rng.uniform(0.1, 0.9, corners)) * 2 * np.pi / corners
    flat = np.stack([np.cos(angles), np.sin(angles)], axis=1) * rng.uniform(0.2, 1.0, (corners, 1))
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return flat @ q[:2] + rng.normal(size=3)


def test_triangles_cover_every_polygon_once() -> None:
    rng = np.random.default_rng(11)
    outlines = [outline(rng, int(n)) for n in rng.integers(3, 24, 400)]
    positions, sizes = np.concatenate(outlines), np.array([len(o) for o in outlines])
    triangles, owners = triangulate(positions, np.arange(len(positions)), sizes)
    assert np.array_equal(np.bincount(owners), sizes - 2) and np.all(np.diff(owners) >= 0)
    corners = positions[triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    start = 0
    for face, points in enumerate(outlines):
        whole = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0) / 2  # Newell: the polygon's vector area
        mine = cross[owners == face] / 2
        assert np.allclose(mine.sum(axis=0), whole, atol=1e-9)
        # all triangles face as the polygon does, so that their areas cannot cover anything twice
        assert np.linalg.norm(mine, axis=1).sum() == pytest.approx(np.linalg.norm(whole), rel=1e-6)
        assert set(triangles[owners == face].ravel()) == set(range(start, start + len(points)))
        start += len(points)


def test_a_dented_quad_is_cut_at_its_dent() -> None:
    for turn in range(4):
        arrow = np.roll(np.array([[0, 0, 0], [2, 0, 0], [0.5, 0.5, 0], [0, 2, 0.0]]), turn, axis=0)
        triangles, _ = triangulate(arrow, np.arange(4), np.array([4]))
        dent = (2 + turn) % 4
        assert all(dent in triangle for triangle in triangles.tolist())


def test_outlines_without_sense_end() -> None:
    same = np.zeros((40, 3))
    assert len(triangulate(same, np.arange(40), np.array([40]))[0]) == 38
    bow = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0], [0.5, 0.2, 0]], float)
    assert len(triangulate(bow, np.arange(5), np.array([5]))[0]) == 3
    assert len(triangulate(bow, np.arange(5), np.array([2, 1, 2]))[0]) == 0
    circle = np.stack([np.cos(np.arange(9000)), np.sin(np.arange(9000)), np.zeros(9000)], axis=1)
    assert len(triangulate(circle, np.arange(9000), np.array([9000]))[0]) == 8998


def test_smooth_normals_of_a_ball_point_outward() -> None:
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    ball = trimesh.creation.icosphere(3)
    normals = smooth_normals(np.asarray(ball.vertices), np.asarray(ball.faces))
    assert np.all(np.einsum("vi,vi->v", normals, ball.vertices) > 0.999)


# --- round trips -----------------------------------------------------------------------------------------------------


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    positions = rng.normal(size=(50, 3)).astype(np.float32)
    normals = rng.normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    triangles = rng.permutation(50)[:48].reshape(-1, 3)
    mesh = Mesh(positions, triangles, normals, rng.uniform(size=(50, 2)), np.c_[rng.uniform(size=(50, 3)), np.ones(50)])
    deltas = np.zeros((2, 50, 3))
    deltas[0, 3:9] = 0.1
    deltas[1, 20] = (0, -1, 0)
    morphs = MorphSet.from_dense(("up", "down"), deltas)
    skeleton = Skeleton(("root",), [-1], Pose(np.array([[0, 1.0, 0]]), np.array([[0.8, 0, 0.6, 0]]), np.ones((1, 3))))
    material = Material("gold", (1, 0.7, 0.1, 1), metallic=1.0, roughness=0.3)
    part = Part("thing", mesh, material, joint=0, morphs=morphs)
    scene = Scene((Character(skeleton, (part,), "thing", ("up", "down")),))
    for unit in ("m", "cm", 0.0254):
        keypose.io.save(scene, tmp_path / "thing.obj", unit=unit, targets=True)
        again = keypose.io.load(tmp_path / "thing.obj", targets=tmp_path / "thing_targets")
        assert not any("unit" in note for note in again.notes)  # the file says it
        assert again.character.morph_names == ("down", "up")
        (copy,) = again.character.parts
        from keypose.deform import deform_part
        from keypose.evaluate import world

        at_rest = np.asarray(world(skeleton, skeleton.rest))
        for weights, other in (([0, 0], [0, 0]), ([1, 0], [0, 1]), ([0, 1], [1, 0])):
            meant, meant_normals = deform_part(scene.character, part, at_rest, np.array(weights, float), True)
            got, got_normals = deform_part(again.character, copy, np.eye(4)[None], np.array(other, float), True)
            assert np.abs(meant[triangles] - got[copy.mesh.triangles]).max() < 1e-6
            assert np.abs(meant_normals[triangles] - got_normals[copy.mesh.triangles]).max() < 1e-6
        for name, tolerance in (("uvs", 1e-6), ("colors", 1e-5)):
            assert (
                np.abs(getattr(mesh, name)[triangles] - getattr(copy.mesh, name)[copy.mesh.triangles]).max() < tolerance
            )
        assert copy.material.metallic == 1 and copy.material.roughness == pytest.approx(0.3, abs=1e-6)


@pytest.mark.data
def test_a_face_comes_back(data_dir: Path, tmp_path: Path) -> None:
    scene = keypose.io.load(data_dir / "face/ict/generic_neutral_mesh.obj")
    assert keypose.io.save(scene, tmp_path / "face.obj") == ()
    again = keypose.io.load(tmp_path / "face.obj")
    assert again.unit_m == 0.01 and again.character.triangle_count == scene.character.triangle_count
    for a, b in zip(scene.character.parts, again.character.parts, strict=True):
        assert a.material.name == b.material.name
        assert np.abs(a.mesh.positions[a.mesh.triangles] - b.mesh.positions[b.mesh.triangles]).max() < 1e-6


def test_the_proof_of_a_rig_that_becomes_a_mesh(tmp_path: Path) -> None:
    """OBJ holds no joints: the proof says so, and how far the vertices are from those of the rest pose."""
    from keypose.analysis import scene_error

    rest = Pose(np.array([[0, 1.0, 0], [0, 0.5, 0]]), np.tile((0.8, 0.6, 0, 0), (2, 1)), np.ones((2, 3)))
    skeleton = Skeleton(("hips", "chest"), [-1, 0], rest)
    scene = Scene((Character(skeleton, (Part("body", Mesh(np.eye(3), [[0, 1, 2]]), joint=1),), "figure"),))
    keypose.io.save(scene, tmp_path / "figure.obj")
    error = scene_error(scene, keypose.io.load(tmp_path / "figure.obj"))
    assert error.motion is None and "2 of 2 joints (hips, chest)" in error.missing
    assert error.vertex_mm is not None and error.vertex_mm < 1e-3


def test_pictures_go_beside_the_file(tmp_path: Path) -> None:
    from keypose.model import Image

    picture = Image("skin", "image/png", b"\x89PNG\r\n\x1a\n and so on")
    triangle = Mesh(np.eye(3), [[0, 1, 2]])
    skeleton = Skeleton(("root",), [-1], Pose(np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.ones((1, 3))))
    parts = (Part("a", triangle, Material("a", base_color_image=picture), joint=0), Part("b", triangle, joint=0))
    keypose.io.save(Character(skeleton, parts), tmp_path / "two.obj")
    first, second = keypose.io.load(tmp_path / "two.obj").character.parts
    assert first.material.base_color_image is not None and first.material.base_color_image.data == picture.data
    assert second.material.base_color_image is None
    with pytest.raises(FormatError, match="no mesh"):
        keypose.io.save(skeleton, tmp_path / "none.obj")


# --- damage ----------------------------------------------------------------------------------------------------------


def test_a_thousand_damaged_files(tmp_path: Path) -> None:
    written(tmp_path, "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\nd 0.5\n", "cube.mtl")
    files = [written(tmp_path, CUBE, "cube.obj")]
    rng = np.random.default_rng(2)
    grid = "".join(f"v {x} {y} {rng.uniform():.3f}\n" for y in range(8) for x in range(8))
    grid += "".join(
        f"f {8 * y + x + 1} {8 * y + x + 2} {8 * y + x + 10} {8 * y + x + 9}\n" for y in range(7) for x in range(7)
    )
    files.append(written(tmp_path, grid, "grid.obj"))
    data = find_data_dir()
    files += [data / "fbx/ufbx_morph/blender_331_static_blend_shape.obj"] if data else []
    result = load_damaged(files, 1000, tmp_path)
    assert result["wrong"] == []
    assert result["slowest_s"] < 3, result["slowest"]
    assert result["peak_mib"] < 1024
    assert result["loaded"] > 50 and result["refused"] > 300


def test_the_page() -> None:
    result = doctest.testfile(str(ROOT / "docs/formats/obj.md"), module_relative=False, encoding="utf-8")
    assert result.attempted and not result.failed


@pytest.mark.parametrize(
    "flood",
    [
        "{",
        "\n",
        " ",
        "f 1 2 3\n",
        "v 0 0 0\nvt 0 0\n",
        "g a\nf 1 2 3\n",
        "f 1 2 3 4 5 6 7 8 9\n",
        "f" + " 1 2 3" * 3000 + "\n",
        "\\\n",
        "#\n",
    ],
)
def test_floods_of_one_thing(tmp_path: Path, flood: str) -> None:
    """A megabyte of the same: no quadratic time, no recursion."""
    import time

    path = written(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\n" * 3 + flood * (1_000_000 // len(flood)) + "\nf 1 2 3\n")
    start = time.process_time()
    try:
        keypose.io.load(path)
    except FormatError as error:
        assert len(str(error)) < 600
    assert time.process_time() - start < 8


def test_too_many_groups_are_refused(tmp_path: Path) -> None:
    groups = "".join(f"g a{k}\nf 1 2 3\n" for k in range(20_000))
    with pytest.raises(FormatError, match="20000 combinations"):
        keypose.io.load(written(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\n" + groups))
