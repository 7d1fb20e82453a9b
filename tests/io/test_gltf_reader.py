"""Reading glTF: every way a file may say the same thing, and a named place for everything that is wrong."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from keypose import evaluate
from keypose.errors import FormatError
from keypose.io.gltf import read
from keypose.math import quat
from keypose.model import Clip, CurveKind, Interpolation, Property, Scene
from tests.conftest import data_files
from tests.io.gltf_files import GltfFile, glb_of

HALF = float(np.sqrt(0.5))


def loaded(file: GltfFile, folder: Path, name: str = "file.glb") -> Scene:
    return read(file.save(folder, name))


# --- accessors -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stored", "expected"),
    [
        (np.array([[0, 255, 51]], np.uint8), [0.0, 1.0, 0.2]),
        (np.array([[-128, 127, 0]], np.int8), [-1.0, 1.0, 0.0]),  # -128 and -127 both mean -1
        (np.array([[0, 65535, 13107]], np.uint16), [0.0, 1.0, 0.2]),
        (np.array([[-32768, 32767, -32767]], np.int16), [-1.0, 1.0, -1.0]),
    ],
)
def test_normalised_integers(stored: Any, expected: list[float], tmp_path: Path) -> None:
    file = GltfFile()
    primitive = file.triangle()
    primitive["attributes"]["POSITION"] = file.accessor(np.repeat(stored, 3, axis=0), normalized=True)
    file.json["extensionsUsed"] = file.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    mesh = loaded(file, tmp_path).character.parts[0].mesh
    assert mesh.positions.dtype == np.float32
    np.testing.assert_allclose(mesh.positions[0], expected, rtol=0, atol=1e-7)


@pytest.mark.parametrize("kind", ["i1", "u1", "<i2", "<u2"])
def test_quantised_positions_that_are_not_normalised_keep_their_numbers(kind: str, tmp_path: Path) -> None:
    file = GltfFile()
    primitive = file.triangle()
    numbers = np.array([[0, 1, 2], [100, 50, 25], [7, 8, 9]]).astype(kind)
    primitive["attributes"]["POSITION"] = file.accessor(numbers)
    np.testing.assert_array_equal(loaded(file, tmp_path).character.parts[0].mesh.positions, numbers)


def test_strides_and_offsets(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    positions, normals = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    interleaved = np.zeros((3, 10), np.float32)  # position, normal, four numbers of something else
    interleaved[:, :3], interleaved[:, 4:7] = positions, normals
    file = GltfFile()
    primitive = file.triangle()
    view = file.view(b"\0" * 8 + interleaved.tobytes()[:-12], byteStride=40)  # the last padding is cut off
    for name, offset in (("POSITION", 8), ("NORMAL", 24)):
        file.json["accessors"].append(
            {"bufferView": view, "byteOffset": offset, "componentType": 5126, "count": 3, "type": "VEC3"}
        )
        primitive["attributes"][name] = len(file.json["accessors"]) - 1
    mesh = loaded(file, tmp_path).character.parts[0].mesh
    np.testing.assert_array_equal(mesh.positions, positions.astype(np.float32))
    np.testing.assert_array_equal(mesh.normals, normals.astype(np.float32))


@pytest.mark.parametrize("index", [np.uint8, np.uint16, np.uint32])
@pytest.mark.parametrize("with_base", [True, False])
def test_sparse_accessors(index: Any, with_base: bool, tmp_path: Path) -> None:
    file = GltfFile()
    primitive = file.triangle()
    base = np.arange(9, dtype=np.float32).reshape(3, 3)
    number = file.floats(base)
    accessor = file.json["accessors"][number]
    if not with_base:
        del accessor["bufferView"]
        base = np.zeros_like(base)
    component = {np.uint8: 5121, np.uint16: 5123, np.uint32: 5125}[index]
    accessor["sparse"] = {
        "count": 2,
        "indices": {"bufferView": file.view(np.array([0, 2], index).tobytes()), "componentType": component},
        "values": {"bufferView": file.view(np.array([[9, 9, 9], [8, 8, 8]], np.float32).tobytes())},
    }
    primitive["attributes"]["POSITION"] = number
    base[[0, 2]] = [[9] * 3, [8] * 3]
    np.testing.assert_array_equal(loaded(file, tmp_path).character.parts[0].mesh.positions, base)


@pytest.mark.parametrize("component", [np.uint8, np.uint16, np.uint32])
@pytest.mark.parametrize(
    ("mode", "corners", "expected"),
    [
        (4, [0, 1, 2, 2, 1, 3], [[0, 1, 2], [2, 1, 3]]),
        (5, [0, 1, 2, 3, 4], [[0, 1, 2], [1, 3, 2], [2, 3, 4]]),
        (6, [0, 1, 2, 3], [[1, 2, 0], [2, 3, 0]]),
    ],
)
def test_triangles_strips_and_fans(
    mode: int, corners: list[int], expected: list[list[int]], component: Any, tmp_path: Path
) -> None:
    file = GltfFile()
    primitive = file.triangle()
    primitive["attributes"] = {"POSITION": file.floats(np.random.default_rng(0).normal(size=(5, 3)))}
    primitive |= {"mode": mode, "indices": file.accessor(np.array(corners, component))}
    scene = loaded(file, tmp_path)
    assert scene.character.parts[0].mesh.triangles.tolist() == expected
    assert "no normals" in " ".join(scene.notes)


@pytest.mark.parametrize(("mode", "word"), [(0, "points"), (1, "lines"), (3, "lines")])
def test_points_and_lines_are_dropped_with_a_note(mode: int, word: str, tmp_path: Path) -> None:
    file = GltfFile()
    file.triangle()["mode"] = mode
    scene = loaded(file, tmp_path)
    assert scene.character.parts == ()
    assert any(word in note and "meshes[0].primitives[0]" in note for note in scene.notes)


def test_computed_normals_are_smooth_and_unit(tmp_path: Path) -> None:
    file = GltfFile()
    primitive = file.triangle()
    positions = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [5, 5, 5]]  # two faces share an edge; a loose vertex
    primitive["attributes"] = {"POSITION": file.floats(positions)}
    primitive["indices"] = file.accessor(np.array([0, 1, 2, 0, 2, 3], np.uint16))
    normals = loaded(file, tmp_path).character.parts[0].mesh.normals
    assert normals is not None
    np.testing.assert_allclose(normals[0], [HALF, 0, HALF], atol=1e-6)
    np.testing.assert_allclose(normals[1], [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(normals[4], [0, 1, 0], atol=0)


# --- nodes -----------------------------------------------------------------------------------------------------------


def test_names_are_unique_and_order_is_topological(tmp_path: Path) -> None:
    file = GltfFile()
    file.json["nodes"] = [{"name": "arm"}, {"name": "arm", "children": [0]}, {"children": [1]}, {"name": "arm_2"}]
    file.json["scenes"] = [{"nodes": [2, 3]}]
    scene = loaded(file, tmp_path)
    skeleton = scene.character.skeleton
    assert skeleton.names == ("node_2", "arm", "arm_3", "arm_2")
    assert skeleton.parents.tolist() == [-1, 0, 1, -1]
    assert any("numbered: arm_3" in note for note in scene.notes)
    assert any("1 nodes have no name" in note for note in scene.notes)


def test_the_order_of_the_file_is_kept_where_parents_come_first(tmp_path: Path) -> None:
    file = GltfFile()
    file.json["nodes"] = [{"name": "a", "children": [2]}, {"name": "b", "children": [3]}, {"name": "c"}, {"name": "d"}]
    file.json["scenes"] = [{"nodes": [0, 1]}]
    assert loaded(file, tmp_path).character.skeleton.names == ("a", "b", "c", "d")


def test_matrices_become_translation_rotation_scale(tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    rotation, scale, move = quat.normalize(rng.normal(size=4)), np.array([2.0, 0.5, 3.0]), rng.normal(size=3)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.asarray(quat.to_matrix(rotation)) * scale, move
    file = GltfFile()
    file.json["nodes"] = [{"matrix": matrix.T.ravel().tolist()}]
    scene = loaded(file, tmp_path)
    rest = scene.character.skeleton.rest
    np.testing.assert_allclose(rest.translations[0], move, atol=1e-6)
    np.testing.assert_allclose(rest.scales[0], scale, rtol=1e-6)
    assert quat.angle_between(rest.rotations[0].astype(float), rotation) < 1e-6
    assert not any("shear" in note for note in scene.notes)


def test_mirrors_keep_their_matrix_and_shear_is_told(tmp_path: Path) -> None:
    mirror = np.diag([1.0, -2.0, 3.0, 1.0])
    shear = np.eye(4)
    shear[0, 1] = 0.5
    file = GltfFile()
    file.json["nodes"] = [{"matrix": mirror.T.ravel().tolist()}, {"matrix": shear.T.ravel().tolist()}]
    file.json["scenes"] = [{"nodes": [0, 1]}]
    scene = loaded(file, tmp_path)
    skeleton = scene.character.skeleton
    np.testing.assert_allclose(np.asarray(evaluate.world(skeleton, skeleton.rest))[0], mirror, atol=1e-6)
    assert [n for n in scene.notes if "shear" in n] == ["nodes[1]: the shear of the matrix was dropped"]


def test_rotations_are_wxyz(tmp_path: Path) -> None:
    file = GltfFile()
    file.json["nodes"] = [{"rotation": [HALF, 0, 0, HALF]}]
    skeleton = loaded(file, tmp_path).character.skeleton
    np.testing.assert_allclose(skeleton.rest.rotations[0], [HALF, HALF, 0, 0], atol=1e-7)


def test_one_mesh_on_several_nodes_gives_parts_that_share_it(tmp_path: Path) -> None:
    file = GltfFile()
    file.triangle()
    file.json["nodes"] = [{"name": "a", "mesh": 0}, {"name": "b", "mesh": 0}]
    file.json["scenes"] = [{"nodes": [0, 1]}]
    first, second = loaded(file, tmp_path).character.parts
    assert (first.joint, second.joint) == (0, 1)
    assert first.group != second.group
    assert first.mesh is second.mesh


# --- skins -----------------------------------------------------------------------------------------------------------


def skinned(joints: Any, weights: Any, count: int = 3) -> GltfFile:
    file = GltfFile()
    primitive = file.triangle()
    for number in range(np.shape(joints)[1] // 4):
        columns = slice(4 * number, 4 * number + 4)
        primitive["attributes"][f"JOINTS_{number}"] = file.accessor(np.asarray(joints, np.uint8)[:, columns])
        primitive["attributes"][f"WEIGHTS_{number}"] = file.floats(np.asarray(weights)[:, columns])
    file.json["nodes"][0]["skin"] = 0
    file.json["nodes"] += [{"name": f"joint{i}"} for i in range(count)]
    file.json["scenes"] = [{"nodes": list(range(count + 1))}]
    file.json["skins"] = [{"joints": list(range(1, count + 1))}]
    return file


def test_several_sets_of_influences(tmp_path: Path) -> None:
    joints = np.tile(np.arange(8), (3, 1))
    weights = np.full((3, 8), 0.125)
    skin = loaded(skinned(joints, weights, count=8), tmp_path).character.parts[0].skin
    assert skin is not None
    assert skin.influence_count == 8
    assert skin.palette.tolist() == list(range(1, 9))
    np.testing.assert_array_equal(skin.joints, joints)
    np.testing.assert_array_equal(skin.joint_from_mesh, np.tile(np.eye(4), (8, 1, 1)))


def test_weights_are_made_to_sum_to_one(tmp_path: Path) -> None:
    weights = [[0.5, 0.5, 0, 0], [0.3, 0.3, 0, 0], [0, 0, 0, 0]]
    scene = loaded(skinned([[0, 1, 0, 0]] * 3, weights), tmp_path)
    skin = scene.character.parts[0].skin
    assert skin is not None
    np.testing.assert_allclose(skin.weights, [[0.5, 0.5, 0, 0], [0.5, 0.5, 0, 0], [1, 0, 0, 0]], atol=1e-7)
    notes = " ".join(scene.notes)
    assert "1 vertices have no weight" in notes
    assert "did not sum to 1" in notes


def test_inverse_bind_matrices_are_stored_by_columns(tmp_path: Path) -> None:
    file = skinned([[0, 0, 0, 0]] * 3, [[1, 0, 0, 0]] * 3, count=1)
    matrix = np.eye(4)
    matrix[:3, 3] = (1, 2, 3)
    file.json["skins"][0]["inverseBindMatrices"] = file.floats(matrix.T.reshape(1, 16))
    skin = loaded(file, tmp_path).character.parts[0].skin
    assert skin is not None
    np.testing.assert_array_equal(skin.joint_from_mesh[0], matrix)


def test_joints_outside_the_scene_are_brought_in(tmp_path: Path) -> None:
    file = skinned([[0, 1, 0, 0]] * 3, [[0.5, 0.5, 0, 0]] * 3)
    file.json["scenes"] = [{"nodes": [0]}]
    scene = loaded(file, tmp_path)
    assert scene.character.skeleton.joint_count == 4
    assert any("was added to the scene because skins[0] needs it" in note for note in scene.notes)


# --- morph targets ---------------------------------------------------------------------------------------------------


def face(*node_names: str) -> GltfFile:
    """A mesh with targets "smile" and "blink" on several nodes."""
    file = GltfFile()
    primitive = file.triangle()
    moved = [[0, 0, 0], [0, 1, 0], [0, 0, 0]]
    primitive["targets"] = [{"POSITION": file.floats(moved)}, {"POSITION": file.floats(np.negative(moved))}]
    file.json["meshes"][0]["extras"] = {"targetNames": ["smile", "blink"], "more": 1}
    file.json["nodes"] = [{"name": name, "mesh": 0} for name in node_names]
    file.json["scenes"] = [{"nodes": list(range(len(node_names)))}]
    return file


def test_equal_targets_of_several_meshes_share_a_channel(tmp_path: Path) -> None:
    file = face("head", "teeth")
    for node in (0, 1):
        file.animate("weights", [0, 1], [[0, 1], [1, 0]], node=node)
    file.json["animations"] = [
        {
            "samplers": [a["samplers"][0] for a in file.json["animations"]],
            "channels": [{"sampler": n, "target": {"node": n, "path": "weights"}} for n in (0, 1)],
        }
    ]
    scene = loaded(file, tmp_path)
    character = scene.character
    assert character.morph_names == ("smile", "blink")
    assert [p.morph_channels.tolist() for p in character.parts if p.morph_channels is not None] == [[0, 1], [0, 1]]
    clip = scene.animations[0]
    assert isinstance(clip, Clip)
    np.testing.assert_array_equal(clip.curve("blink", Property.WEIGHT).values, [[1], [0]])
    assert clip.curve("smile", Property.WEIGHT).kind is CurveKind.SCALAR


def test_targets_that_move_differently_get_channels_of_their_own(tmp_path: Path) -> None:
    file = face("head", "teeth")
    file.animate("weights", [0, 1], [[0, 0.5], [1, 0.5]], node=0)
    file.json["nodes"][1]["weights"] = [0, 0.25]
    scene = loaded(file, tmp_path)
    character = scene.character
    assert character.morph_names == ("head.smile", "head.blink", "teeth.smile", "teeth.blink")
    np.testing.assert_array_equal(character.rest_morph_weights, np.float32([0, 0, 0, 0.25]))
    assert {c.target for c in scene.animations[0].curves} == {"head.smile", "head.blink"}  # type: ignore[union-attr]
    assert any("blink, smile" in note for note in scene.notes)


def test_targets_without_names_are_numbered_and_rest_weights_come_from_the_mesh(tmp_path: Path) -> None:
    file = face("head")
    file.json["meshes"][0] |= {"extras": {}, "weights": [0.5, 1]}
    character = loaded(file, tmp_path).character
    assert character.morph_names == ("target_0", "target_1")
    np.testing.assert_array_equal(character.rest_morph_weights, np.float32([0.5, 1]))


# --- animations ------------------------------------------------------------------------------------------------------


def curve_of(file: GltfFile, folder: Path, property: Property) -> Any:
    scene = loaded(file, folder)
    clip = scene.animations[0]
    assert isinstance(clip, Clip)
    return clip.curve("root", property), scene


@pytest.mark.parametrize(("name", "mode"), [("STEP", Interpolation.STEP), ("LINEAR", Interpolation.LINEAR)])
def test_keys_keep_their_times_and_values(name: str, mode: Interpolation, tmp_path: Path) -> None:
    times = np.array([0.1, 0.2, 1 / 3], np.float32)
    file = GltfFile()
    file.animate("translation", times, np.arange(9).reshape(3, 3), name)
    curve, _ = curve_of(file, tmp_path, Property.TRANSLATION)
    np.testing.assert_array_equal(curve.times_s, times.astype(np.float64))
    assert curve.modes.tolist() == [mode] * 3
    np.testing.assert_array_equal(curve.values, np.arange(9).reshape(3, 3))


def test_cubic_splines_of_rotations(tmp_path: Path) -> None:
    rows = np.arange(24, dtype=np.float32).reshape(2, 3, 4)  # key, (in, value, out), xyzw
    file = GltfFile()
    file.animate("rotation", [0, 1], rows.reshape(-1, 4), "CUBICSPLINE")
    curve, _ = curve_of(file, tmp_path, Property.ROTATION)
    assert curve.modes.tolist() == [Interpolation.HERMITE] * 2
    for name, index in (("in_tangents", 0), ("values", 1), ("out_tangents", 2)):
        np.testing.assert_array_equal(getattr(curve, name), rows[:, index][:, [3, 0, 1, 2]])


def test_cubic_splines_of_morph_weights(tmp_path: Path) -> None:
    file = face("root")
    rows = np.arange(12, dtype=np.float32).reshape(2, 3, 2)  # key, (in, value, out), target
    file.animate("weights", [0, 1], rows, "CUBICSPLINE")
    scene = loaded(file, tmp_path)
    blink = scene.animations[0].curve("blink", Property.WEIGHT)  # type: ignore[union-attr]
    np.testing.assert_array_equal(blink.values[:, 0], rows[:, 1, 1])
    np.testing.assert_array_equal(blink.in_tangents[:, 0], rows[:, 0, 1])
    np.testing.assert_array_equal(blink.out_tangents[:, 0], rows[:, 2, 1])


@pytest.mark.parametrize("kind", [np.int8, np.int16])
def test_rotations_of_normalised_integers_are_unit(kind: Any, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    rotations = rng.normal(size=(6, 4))
    rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
    stored = np.round(rotations * np.iinfo(kind).max).astype(kind)
    file = GltfFile()
    animation = file.animate("rotation", range(6), rotations)
    animation["samplers"][0]["output"] = file.accessor(stored, normalized=True)
    curve, _ = curve_of(file, tmp_path, Property.ROTATION)
    np.testing.assert_allclose(np.linalg.norm(curve.values, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(curve.values, rotations[:, [3, 0, 1, 2]], atol=3 / np.iinfo(kind).max)


def test_several_keys_at_one_time_are_a_jump(tmp_path: Path) -> None:
    file = GltfFile()
    file.animate("translation", [0, 1, 1, 1, 2], [[0, 0, 0], [1, 0, 0], [5, 5, 5], [3, 0, 0], [4, 0, 0]])
    curve, scene = curve_of(file, tmp_path, Property.TRANSLATION)
    assert curve.key_count == 4
    assert curve.times_s[1] < 1 == curve.times_s[2]
    np.testing.assert_array_equal(curve.values[:, 0], [0, 1, 3, 4])
    assert any("animations[0].samplers[0].input: 2 keys" in note for note in scene.notes)


def test_animations_of_nothing_known_are_dropped_with_a_note(tmp_path: Path) -> None:
    file = GltfFile()
    file.json["nodes"].append({"name": "elsewhere"})
    animation = file.animate("translation", [0, 1], [[0, 0, 0]] * 2, node=1)
    animation["channels"] += [
        {"sampler": 0, "target": {"path": "pointer"}},
        {"sampler": 0, "target": {"node": 0, "path": "weights"}},
        {"sampler": 0, "target": {"node": 0, "path": "translation"}},
        {"sampler": 0, "target": {"node": 0, "path": "translation"}},
    ]
    scene = loaded(file, tmp_path)
    assert [(c.target, c.property) for c in scene.animations[0].curves] == [("root", Property.TRANSLATION)]  # type: ignore[union-attr]
    for word in ("not in the scene", "animates no node", "no morph targets", "animated twice"):
        assert any(word in note for note in scene.notes), word


# --- files and URIs --------------------------------------------------------------------------------------------------


def test_buffers_beside_the_file(tmp_path: Path) -> None:
    file = GltfFile()
    file.triangle()
    (tmp_path / "with space").mkdir()
    (tmp_path / "with space" / "dätä.bin").write_bytes(file.data)
    document = {**file.json, "buffers": [{"byteLength": len(file.data), "uri": "with%20space/d%C3%A4t%C3%A4.bin"}]}
    path = tmp_path / "file.gltf"
    path.write_text(json.dumps(document))
    assert read(path).character.vertex_count == 3


@pytest.mark.parametrize(
    "uri",
    [
        "/etc/passwd",
        "../secret.bin",
        "sub/../../secret.bin",
        "%2e%2e/secret.bin",
        "http://example.org/a.bin",
        "file:///etc/passwd",
        "..\\secret.bin",
        "//host/a.bin",
        "link.bin",
    ],
)
def test_files_elsewhere_are_not_read(uri: str, tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (tmp_path / "secret.bin").write_bytes(b"\0" * 1000)
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    file = GltfFile()
    file.triangle()
    file.json["buffers"] = [{"byteLength": len(file.data), "uri": uri}]
    path = folder / "file.gltf"
    path.write_text(json.dumps(file.json))
    with pytest.raises(FormatError, match=r"file.gltf: buffers\[0\]: .*(outside|not fetched)"):
        read(path)


def test_a_missing_picture_is_no_error(tmp_path: Path) -> None:
    file = GltfFile()
    file.triangle()["material"] = 0
    file.json["images"] = [{"uri": "lost.png"}, {"uri": "../up.jpg"}]
    file.json["textures"] = [{"source": 0}, {"source": 1}]
    file.json["materials"] = [
        {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "emissiveTexture": {"index": 1}}
    ]
    scene = loaded(file, tmp_path)
    image = scene.character.parts[0].material.base_color_image
    assert image is not None
    assert (image.name, image.data) == ("lost.png", None)
    assert any("images[0]: the picture 'lost.png' is missing" in note for note in scene.notes)
    assert any("images[1]" in note and "outside" in note for note in scene.notes)


def test_materials(tmp_path: Path) -> None:
    png = b"\x89PNG\r\n\x1a\n" + b"\0" * 20
    file = GltfFile()
    file.triangle()["material"] = 0
    file.json["samplers"] = [{"wrapS": 33071}]
    file.json["images"] = [{"bufferView": file.view(png), "mimeType": "image/png", "name": "skin"}]
    file.json["textures"] = [{"source": 0, "sampler": 0}]
    transform = {"KHR_texture_transform": {"scale": [2, 2]}}
    file.json["materials"] = [
        {
            "name": "cloth",
            "pbrMetallicRoughness": {
                "baseColorFactor": [0.1, 0.2, 0.3, 0.4],
                "metallicFactor": 0.25,
                "baseColorTexture": {"index": 0, "texCoord": 1, "extensions": transform},
            },
            "normalTexture": {"index": 0, "scale": 0.5},
            "emissiveFactor": [1, 0, 0.5],
            "alphaMode": "MASK",
            "alphaCutoff": 0.3,
            "doubleSided": True,
            "extensions": {"KHR_materials_unlit": {}, "KHR_materials_ior": {"ior": 1.4}},
            "extras": {"author": "me"},
        }
    ]
    material = loaded(file, tmp_path).character.parts[0].material
    assert material.name == "cloth"
    assert material.base_color == (0.1, 0.2, 0.3, 0.4)
    assert (material.metallic, material.roughness, material.emissive) == (0.25, 1.0, (1.0, 0.0, 0.5))
    assert (material.alpha_mode, material.alpha_cutoff, material.double_sided, material.unlit) == (
        "MASK",
        0.3,
        True,
        True,
    )
    assert material.base_color_image is not None
    assert material.base_color_image.data == png
    assert material.extras["author"] == "me"
    kept = material.extras["gltf"]
    assert kept["extensions"]["KHR_materials_ior"] == {"ior": 1.4}
    assert kept["normalTexture"]["image"] is material.base_color_image
    assert kept["normalTexture"]["scale"] == 0.5
    assert kept["pbrMetallicRoughness"]["baseColorTexture"] == {
        "texCoord": 1,
        "sampler": {"wrapS": 33071},
        "extensions": transform,
    }


def test_extras_are_kept(tmp_path: Path) -> None:
    file = face("head")
    file.json["asset"] |= {"extras": {"a": 1}, "copyright": "(c)"}
    file.json["scenes"][0]["extras"] = {"b": [2]}
    file.json["nodes"][0]["extras"] = {"c": 3}
    file.json["meshes"][0]["primitives"][0]["extras"] = {"d": 4}
    scene = loaded(file, tmp_path)
    assert scene.extras["gltf"]["asset_extras"] == {"a": 1}
    assert scene.extras["gltf"]["asset"]["copyright"] == "(c)"
    assert scene.extras["gltf"]["scene_extras"] == {"b": [2]}
    assert scene.character.extras["gltf"]["nodes"] == {"head": {"c": 3}}
    assert scene.character.parts[0].extras == {"d": 4, "gltf": {"node": "head", "mesh_extras": {"more": 1}}}


# --- VRM -------------------------------------------------------------------------------------------------------------


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "count", "some"),
    [
        ("basic_armature.vrm", 53, {"hips", "left_upper_arm", "right_thumb_metacarpal", "left_little_distal"}),
        ("debug_robot.vrm", 53, {"hips", "left_thumb_metacarpal", "left_eye", "right_toes"}),
        ("minimal.vrm", 17, {"hips", "spine", "head", "right_foot"}),
        ("sphere.vrm", 22, {"hips"}),
        ("idle_loop.vrma", 22, {"hips", "left_lower_leg"}),
        ("nop.vrma", 53, {"right_eye", "left_eye"}),
        ("test.vrma", 51, {"hips"}),
    ],
)
def test_roles_of_vrm(name: str, count: int, some: set[str], data_dir: Path) -> None:
    character = read(data_dir / "vrm" / name).character
    assert len(character.roles) == count
    assert some <= set(character.roles)
    parents = character.skeleton.parents
    joint = character.roles["left_foot"]
    while joint >= 0 and joint != character.roles["hips"]:
        joint = int(parents[joint])
    assert joint == character.roles["hips"]  # the foot hangs below the hips


@pytest.mark.data
def test_malformed_vrm_loads_with_notes(data_dir: Path) -> None:
    empty = read(data_dir / "vrm" / "empty.vrm")
    assert empty.characters == ()
    assert empty.notes == ("the file holds no nodes",)
    bad = read(data_dir / "vrm" / "human_bone.vrm")
    assert bad.character.roles == {}
    assert any("humanBones[0]" in note and "12345" in note for note in bad.notes)
    assert any("humanBones[1]" in note for note in bad.notes)


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "joints", "vertices", "clips", "morphs"),
    [  # counts of the data folder's own README, made by another program
        ("khronos/cesium_man.gltf", 22, 3273, 1, 0),
        ("khronos/Fox.glb", 26, 1728, 3, 0),
        ("castle_fox/Fox.gltf", 26, 1728, 3, 0),
        ("cc0/Knight.glb", 57, 7024, 76, 0),
        ("cc0/greenman.glb", 14, 196, 4, 0),
        ("cc0/robot.glb", 58, 7218, 14, 0),
        ("khronos/MorphStressTest.gltf", 1, 1528, 3, 8),
        ("khronos/SimpleSkin.gltf", 3, 10, 1, 0),
        ("khronos/box_animated.gltf", 4, 320, 1, 0),
        ("khronos/interpolation_test.gltf", 12, 220, 9, 0),
        ("khronos/rigged_simple.gltf", 5, 160, 1, 0),
        ("tinygltf/singleBlendshapeCube_sparse.glb", 2, 24, 1, 1),
        ("blender_io/06_parent-inverse-anim/06_parent-inverse-anim.gltf", 12, 240, 5, 0),
    ],
)
def test_real_files(name: str, joints: int, vertices: int, clips: int, morphs: int, data_dir: Path) -> None:
    scene = read(data_dir / "gltf" / name)
    character = scene.character
    assert character.skeleton.joint_count == joints
    assert character.vertex_count == vertices
    assert len(scene.animations) == clips
    assert len(character.morph_names) == morphs
    for clip in scene.animations:
        assert isinstance(clip, Clip)
        assert not evaluate.unmatched(clip, character.skeleton, character.morph_names)


@pytest.mark.data
def test_every_real_file_loads(data_dir: Path) -> None:
    files = [p for pattern in ("gltf/**/*.gltf", "gltf/**/*.glb", "vrm/*.vrm*") for p in data_files(pattern)]
    assert len(files) >= 27
    for path in files:
        assert read(path).format == "gltf"


# --- refusals --------------------------------------------------------------------------------------------------------


def _giant_count(file: GltfFile) -> None:
    file.json["accessors"][0]["count"] = 2**40


def _giant_zeros(file: GltfFile) -> None:
    del file.json["accessors"][0]["bufferView"]
    file.json["accessors"][0]["count"] = 2**31


def _giant_sparse(file: GltfFile) -> None:
    accessor = file.json["accessors"][0]
    accessor["sparse"] = {
        "count": 2,
        "indices": {"bufferView": 0, "byteOffset": 12, "componentType": 5125},  # the number 1.0 as an integer
        "values": {"bufferView": 0},
    }


def _overlapping_views(file: GltfFile) -> None:
    """A few bytes, asked for ten thousand times."""
    primitive = file.json["meshes"][0]["primitives"][0]
    big = file.floats(np.zeros((20000, 3)))
    accessor = file.json["accessors"][big]
    primitive["attributes"]["POSITION"] = primitive["attributes"]["NORMAL"] = big
    primitive["targets"] = []
    for _ in range(10000):
        file.json["accessors"].append({**accessor, "byteOffset": 0})
        primitive["targets"].append({"POSITION": len(file.json["accessors"]) - 1})


def _many_parts(file: GltfFile) -> None:
    file.json["meshes"][0]["primitives"] *= 3000
    file.json["nodes"] = [{"mesh": 0} for _ in range(3000)]
    file.json["scenes"] = [{"nodes": list(range(3000))}]


def _set(path: str, value: Any) -> Callable[[GltfFile], None]:
    def change(file: GltfFile) -> None:
        holder: Any = file.json
        *way, last = [int(p) if p.isdigit() else p for p in path.split(".")]
        for key in way:
            holder = holder[key]
        holder[last] = value

    return change


def _indices(values: list[int]) -> Callable[[GltfFile], None]:
    def change(file: GltfFile) -> None:
        file.json["meshes"][0]["primitives"][0]["indices"] = file.accessor(np.array(values, np.uint16))

    return change


def _animate(times: list[float], values: Any, mode: str = "LINEAR") -> Callable[[GltfFile], None]:
    return lambda file: file.animate("translation", times, values, mode) and None


REFUSED: dict[str, tuple[Callable[[GltfFile], None], str]] = {
    "version": (_set("asset.version", "1.0"), r"asset.version: expected glTF version 2, got '1.0'"),
    "extension": (_set("extensionsRequired", ["ACME_x", "KHR_y"]), r"extensionsRequired: .*ACME_x, KHR_y"),
    "own child": (_set("nodes.0.children", [0]), r"nodes\[0\]: a node is its own child"),
    "cycle": (
        _set("nodes", [{"mesh": 0}, {"children": [2]}, {"children": [1]}]),
        r"nodes\[1\]: the node is its own ancestor",
    ),
    "two parents": (
        _set("nodes", [{"children": [2]}, {"children": [2]}, {}]),
        r"nodes\[1\]: nodes\[2\] has two parents, nodes\[0\] and nodes\[1\]",
    ),
    "child": (_set("nodes.0.children", [7]), r"nodes\[0\].children\[0\]: node 7 does not exist; the file has 1"),
    "wrong type": (
        _set("nodes.0.translation", [1, "2", 3]),
        r"nodes\[0\].translation\[1\]: expected a number, got a text",
    ),
    "too short": (_set("nodes.0.rotation", [0, 0, 1]), r"nodes\[0\].rotation: expected 4 numbers, got 3"),
    "huge number": (_set("nodes.0.scale", [10**400, 1, 1]), r"nodes\[0\].scale\[0\]: the number is too large"),
    "count": (_giant_count, r"accessors\[0\].count: 1099511627776 elements need \d+ bytes; bufferViews\[0\] has 36"),
    "zeros": (_giant_zeros, r"accessors\[0\]: the file asks for \d+ MiB of data but holds only \d+ bytes"),
    "sparse": (_giant_sparse, r"accessors\[0\].sparse.indices: element \d+ does not exist; there are 3"),
    "overlap": (_overlapping_views, r"accessors\[\d+\]: the file asks for \d+ MiB"),
    "many parts": (_many_parts, r"nodes\[\d+\]: the file asks for \d+ MiB"),
    "view": (
        _set("bufferViews.0.byteLength", 10**6),
        r"bufferViews\[0\]: bytes 0 to 1000000 do not exist; buffer 0 has",
    ),
    "stride": (_set("bufferViews.0.byteStride", 4), r"accessors\[0\]: elements of 12 bytes do not fit a stride of 4"),
    "component": (_set("accessors.0.componentType", 5124), r"accessors\[0\].componentType: expected one of"),
    "kind": (_set("accessors.0.type", "VEC2"), r"meshes\[0\].primitives\[0\].attributes.POSITION: expected VEC3"),
    "no type": (lambda file: file.json["accessors"][0].pop("type"), r"accessors\[0\]: 'type' is missing"),
    "corner": (_indices([0, 1, 9]), r"meshes\[0\].primitives\[0\].indices: vertex 9 does not exist; there are 3"),
    "times": (
        _animate([0, 2, 1], [[0, 0, 0]] * 3),
        r"animations\[0\].samplers\[0\].input: key 2 at 1 s is before key 1",
    ),
    "outputs": (_animate([0, 1], [[0, 0, 0]] * 3), r"samplers\[0\].output: expected 2 elements for 2 keys, got 3"),
    "tangents": (
        _animate([0, 1], [[0, 0, 0]] * 2, "CUBICSPLINE"),
        r"samplers\[0\].output: expected 6 elements for 2 keys, got 2",
    ),
    "interpolation": (_animate([0, 1], [[0, 0, 0]] * 2, "BEZIER"), r"animations\[0\].samplers\[0\]: .*got 'BEZIER'"),
    "NaN time": (_animate([0, float("nan")], [[0, 0, 0]] * 2), r"accessors\[2\]: element 1 is not a finite number"),
    "weights": (_set("nodes.0.weights", [1, 2]), ""),  # of a mesh without targets: harmless, and loaded
}


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_the_place_of_what_is_wrong_is_named(name: str, suffix: str, tmp_path: Path) -> None:
    change, message = REFUSED[name]
    file = GltfFile()
    file.triangle()
    change(file)
    path = file.save(tmp_path, f"file{suffix}")
    if not message:
        assert read(path).character.vertex_count == 3
        return
    with pytest.raises(FormatError, match=message) as refused:
        read(path)
    assert str(refused.value).startswith(str(path))
    assert "\n" not in str(refused.value)


GOOD = glb_of(b'{"asset":{"version":"2.0"}}')


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "byte 0: the file is empty"),
        (b"hello", "byte 0: the file is neither GLB, which starts with 'glTF', nor JSON"),
        (b"glTF\2\0", "byte 6: the GLB header is cut off"),
        (b"glTF" + struct.pack("<II", 1, 12), "byte 4: expected GLB version 2, got 1"),
        (GOOD[:-5], f"byte {len(GOOD) - 5}: the file is cut off: expected {len(GOOD)} bytes"),
        (GOOD[:12] + struct.pack("<I", 9999) + GOOD[16:], "byte 12: a chunk of 9999 bytes does not fit"),
        (GOOD[:16] + b"BIN\0" + GOOD[20:], "byte 12: expected the JSON chunk first"),
        (b"{", "JSON line 1 column 2: Expecting property name"),
        (b'{"a":\n nope}', "JSON line 2 column 2: Expecting value"),
        (b'{"a":NaN}', "JSON: NaN is no JSON number"),
        (b'{"a":"\xff"}', "JSON byte 6: expected UTF-8 text"),
        (b'{"a":' + b"[" * 100_000, "JSON: brackets are nested too deeply"),
        (b'{"asset":{"version":"2.0"},"nodes":[' + b'{"a":' * 400 + b"1" + b"}" * 400 + b"]}", ""),
        (b"{}", "root: 'asset' is missing"),
        (b'{"asset":[]}', "asset: expected an object, got an array"),
        (b'{"asset":{"version":"2.0"},"scene":3}', "scene: scene 3 does not exist; the file has 0"),
    ],
)
def test_containers(data: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "file.gltf"
    path.write_bytes(data)
    if not message:
        read(path)
        return
    with pytest.raises(FormatError) as refused:
        read(path)
    assert str(refused.value).startswith(f"{path}: {message}")


def test_unknown_chunks_and_bytes_after_the_end_are_ignored(tmp_path: Path) -> None:
    data = GOOD + struct.pack("<II", 4, 0x12345678) + b"abcd"
    data = data[:8] + struct.pack("<I", len(data)) + data[12:] + b"tail"
    path = tmp_path / "file.glb"
    path.write_bytes(data)
    assert any("4 bytes after the end" in note for note in read(path).notes)


def test_thousands_of_equal_names_take_no_time(tmp_path: Path) -> None:
    file = GltfFile()
    file.json["nodes"] = [{"name": "x"} for _ in range(30_000)]
    file.json["scenes"] = [{"nodes": list(range(30_000))}]
    scene = loaded(file, tmp_path)
    assert scene.character.skeleton.names[-1] == "x_30000"
    assert len(scene.notes) == 1


@pytest.mark.parametrize(
    ("key", "index", "change", "message"),
    [
        ("nodes", 0, {"children": {}}, "expected an array"), ("nodes", 0, {"children": [99999]}, "does not exist"),
        ("nodes", 0, {"translation": "abc"}, "expected an array"), ("nodes", 0, {"rotation": [0, 0, 0]}, "expected 4 numbers"),
        ("nodes", 0, {"scale": [1, 1, True]}, "expected a number"), ("nodes", 0, {"name": 3}, "expected a text"),
        ("accessors", 0, {"count": 0}, "1 or more"), ("accessors", 0, {"count": "3"}, "expected an integer"),
        ("accessors", 0, {"type": ["VEC3"]}, "expected a text"), ("accessors", 0, {"componentType": [5126]}, "expected an integer"),
        ("accessors", 0, {"bufferView": 99999}, "does not exist"), ("accessors", 0, {"sparse": []}, "expected an object"),
        ("bufferViews", 0, {"buffer": 7}, "does not exist"), ("bufferViews", 0, {"byteStride": 400}, "1 to 255"),
        ("bufferViews", 0, {"byteLength": None}, "expected an integer"),
    ],
)  # fmt: skip
def test_the_short_way_through_the_json_refuses_what_the_careful_one_does(
    key: str, index: int, change: dict[str, Any], message: str, tmp_path: Path
) -> None:
    """Numerous items are read quickly where they are as usual; what is odd is still refused by its name."""
    from keypose import samples
    from keypose.io.gltf.writer import write

    write(samples.load("walk"), tmp_path / "a.gltf")
    document = json.loads((tmp_path / "a.gltf").read_text())
    document[key][index].update(change)
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    with pytest.raises(FormatError, match=message) as refused:
        read(tmp_path / "a.gltf")
    assert f"{key}[{index}]" in str(refused.value)
