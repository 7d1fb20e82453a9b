"""Motions as arrays: .npz and .safetensors bit for bit, AMASS takes, what other libraries read, bombs, damage."""

from __future__ import annotations

import doctest
import io
import pickle
import struct
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import keypose.io
from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.evaluate import world
from keypose.io import arrays_npz
from keypose.io.arrays_amass import LAYOUTS
from keypose.io.gltf.humanoid import ROLES
from keypose.model import Character, Clip, Event, Motion, Pose, Scene, Skeleton
from tests.conftest import ROOT
from tests.io.damage import load_damaged

SUFFIXES = (".npz", ".safetensors")


def sample(dtype: Any = np.float32, frames: int = 7, moving: bool = True) -> Scene:
    rng = np.random.default_rng(8)
    joints = 4
    rotations = rng.normal(size=(frames, joints, 4))
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    shape = (frames, joints, 3) if moving else (joints, 3)
    pose = Pose(rng.normal(size=shape).astype(dtype), rotations.astype(dtype), np.ones((joints, 3), dtype))
    rest = Pose(rng.normal(size=(joints, 3)), np.tile((1.0, 0, 0, 0), (joints, 1)), np.ones((joints, 3)))
    names = ("hips", "knee ü", "foot", "tail")
    skeleton = Skeleton(names, [-1, 0, 1, 0], rest, ((2, (0.0, -0.1, 1 / 3)),))
    weights = rng.uniform(size=(frames, 2)).astype(dtype)
    events = (Event(0.1, "step", "left"), Event(0.2, "step"))
    motion = Motion(names, pose, 29.97, "walk", -1 / 3, ("aa", "blink"), weights, events)
    return Scene((Character(skeleton, name="Ann", roles={"hips": 0}),), (motion,))


def assert_same(scene: Scene, again: Scene) -> None:
    a, b = scene.animations[0], again.animations[0]
    assert isinstance(a, Motion) and isinstance(b, Motion)
    for name in ("translations", "rotations", "scales"):
        mine, copy = getattr(a.pose, name), getattr(b.pose, name)
        assert mine.dtype == copy.dtype and np.array_equal(mine, copy), name
    assert (a.joint_names, a.name, a.rate_hz, a.start_s, a.morph_names) == (
        b.joint_names,
        b.name,
        b.rate_hz,
        b.start_s,
        b.morph_names,
    )
    assert np.array_equal(a.morph_weights, b.morph_weights)
    assert [(e.time_s, e.name, e.data) for e in a.events] == [(e.time_s, e.name, e.data) for e in b.events]
    mine, copy = scene.character, again.character
    assert mine.skeleton.names == copy.skeleton.names and np.array_equal(mine.skeleton.parents, copy.skeleton.parents)
    assert mine.skeleton.end_offsets == copy.skeleton.end_offsets
    assert (mine.name, dict(mine.roles)) == (copy.name, dict(copy.roles))
    assert np.array_equal(mine.skeleton.rest.translations, copy.skeleton.rest.translations)


# --- our own layout --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("moving", [True, False])
def test_it_comes_back_bit_for_bit(tmp_path: Path, suffix: str, dtype: Any, moving: bool) -> None:
    scene = sample(dtype, moving=moving)
    assert keypose.io.save(scene, tmp_path / f"a{suffix}") == ()
    again = keypose.io.load(tmp_path / f"a{suffix}")
    assert again.format == suffix[1:] and again.notes == ()
    assert_same(scene, again)
    keypose.io.save(again, tmp_path / f"b{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_motions_without_skeleton_and_clips(tmp_path: Path, suffix: str) -> None:
    scene = sample()
    keypose.io.save(scene.animations[0], tmp_path / f"a{suffix}")
    alone = keypose.io.load(tmp_path / f"a{suffix}")
    assert alone.characters == () and alone.animations[0].joint_names == scene.character.skeleton.names
    from keypose.evaluate import to_clip

    clip = to_clip(scene.animations[0])
    notes = keypose.io.save(
        [replace(scene.character, morph_names=("aa", "blink"), rest_morph_weights=None), clip], tmp_path / f"b{suffix}"
    )
    assert any("sampled at 29.97 Hz" in note for note in notes)
    baked = keypose.io.load(tmp_path / f"b{suffix}").animations[0]
    assert isinstance(baked, Motion) and baked.frame_count == 7
    assert np.abs(baked.pose.broadcast().translations - scene.animations[0].pose.translations).max() < 1e-5
    for wrong in (Scene(), Scene(animations=(clip,))):
        with pytest.raises(FormatError):
            keypose.io.save(wrong, tmp_path / f"c{suffix}")
    assert not (tmp_path / f"c{suffix}").exists()


def test_numpy_reads_ours_without_pickle(tmp_path: Path) -> None:
    scene = sample()
    keypose.io.save(scene, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as arrays:
        assert set(arrays) == {
            "keypose", "rotations", "translations", "scales", "parents", "rest_translations", "rest_rotations", "rest_scales",
            "end_joints", "end_offsets", "morph_weights", "event_times_s",
        }  # fmt: skip
        assert np.array_equal(arrays["rotations"], scene.animations[0].pose.rotations)
        assert b'"rate_hz":29.97' in arrays["keypose"].tobytes()


def test_the_safetensors_library_reads_ours_and_we_read_its(tmp_path: Path) -> None:
    library = pytest.importorskip("safetensors.numpy", reason="safetensors is not installed")
    scene = sample()
    keypose.io.save(scene, tmp_path / "a.safetensors")
    arrays = library.load_file(tmp_path / "a.safetensors")
    assert np.array_equal(arrays["rotations"], scene.animations[0].pose.rotations)
    from safetensors import safe_open

    with safe_open(tmp_path / "a.safetensors", "numpy") as file:
        metadata = file.metadata()
    library.save_file(arrays, tmp_path / "b.safetensors", metadata=metadata)
    assert_same(scene, keypose.io.load(tmp_path / "b.safetensors"))


# --- AMASS -----------------------------------------------------------------------------------------------------------


def amass(folder: Path, width: int = 156, frames: int = 20, **changes: Any) -> Path:
    rng = np.random.default_rng(4)
    arrays: dict[str, Any] = {
        "poses": rng.normal(size=(frames, width)) * 0.3, "trans": rng.normal(size=(frames, 3)), "betas": rng.normal(size=16),
        "dmpls": np.zeros((frames, 8)), "gender": np.array("female"), "mocap_framerate": np.array(120.0),
    }  # fmt: skip
    arrays |= changes
    path = folder / f"take_{width}.npz"
    np.savez(path, **{k: v for k, v in arrays.items() if v is not None})
    return path


@pytest.mark.parametrize(("width", "joints"), [(66, 22), (72, 24), (156, 52), (165, 55)])
def test_takes_have_the_standard_joints_and_the_rotations_of_scipy(tmp_path: Path, width: int, joints: int) -> None:
    path = amass(tmp_path, width)
    scene = keypose.io.load(path)
    skeleton = scene.character.skeleton
    (motion,) = scene.animations
    assert isinstance(motion, Motion) and motion.rate_hz == 120 and len(skeleton.names) == joints and scene.up == "Z"
    assert set(scene.character.roles) <= ROLES and len(scene.character.roles) >= 22
    with np.load(path) as arrays:
        vectors = arrays["poses"].reshape(-1, joints, 3)
        assert scene.character.extras["amass"]["betas"] == arrays["betas"].tolist()
        z_up = Rotation.from_euler("x", -90, degrees=True)
        expected = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(-1, joints, 3, 3)
        expected[:, 0] = z_up.as_matrix() @ expected[:, 0]
        mine = Rotation.from_quat(np.asarray(motion.pose.rotations).reshape(-1, 4)[:, [1, 2, 3, 0]]).as_matrix()
        assert np.abs(mine.reshape(expected.shape) - expected).max() < 1e-12
        assert np.allclose(motion.pose.translations[:, 0], z_up.apply(arrays["trans"]))
    assert scene.character.extras["amass"]["gender"] == "female"
    assert any("without its body model" in note for note in scene.notes)


def test_the_order_of_joints_is_that_of_the_body_models() -> None:
    names = [name for name, *_ in LAYOUTS[156][1]]
    parents = [p for _, p, _, _ in LAYOUTS[156][1]]
    # kintree_table of SMPL-H
    table = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 22, 23, 20, 25, 26, 20, 28, 29, 20, 31, 32,
             20, 34, 35, 21, 37, 38, 21, 40, 41, 21, 43, 44, 21, 46, 47, 21, 49, 50]  # fmt: skip
    assert [names.index(p) if p else -1 for p in parents] == table
    assert (
        names[15] == "head"
        and names[22] == "left_index1"
        and names[37] == "right_index1"
        and names[51] == "right_thumb3"
    )


def test_the_figure_stands_and_faces_forward(tmp_path: Path) -> None:
    """A standing take: in AMASS's Z-up world the root turns the Y-up body upright."""
    poses = np.zeros((2, 156))
    poses[:, :3] = (np.pi / 2, 0, 0)
    scene = keypose.io.load(amass(tmp_path, poses=poses, trans=np.tile((0.0, 0.0, 0.97), (2, 1))))
    at = np.asarray(world(scene.character.skeleton, scene.animations[0].pose))[0, :, :3, 3]
    roles = scene.character.roles
    assert at[roles["head"], 1] > 1.4 and -0.02 < at[roles["left_toes"], 1] < 0.1
    assert at[roles["left_hand"], 0] > 0.6 and at[roles["left_toes"], 2] > 0.05
    assert 1.5 < np.ptp(at[:, 1]) + 0.15 < 1.8


def test_takes_are_written_too(tmp_path: Path) -> None:
    path = amass(tmp_path)
    scene = keypose.io.load(path)
    keypose.io.save(scene, tmp_path / "copy.npz", layout="amass")
    with np.load(path) as a, np.load(tmp_path / "copy.npz") as b:
        turns = [Rotation.from_rotvec(f["poses"].reshape(-1, 3)) for f in (a, b)]
        assert (turns[0].inv() * turns[1]).magnitude().max() < 1e-9
        assert np.allclose(a["trans"], b["trans"]) and b["mocap_framerate"] == 120 and str(b["gender"]) == "female"
        assert np.array_equal(a["betas"], b["betas"])
    keypose.io.save(scene, tmp_path / "ours.npz")
    assert_rotations = keypose.io.load(tmp_path / "ours.npz").animations[0].pose.rotations
    assert np.array_equal(assert_rotations, scene.animations[0].pose.rotations)
    with pytest.raises(FormatError, match="SMPL"):
        keypose.io.save(sample(), tmp_path / "x.npz", layout="amass")
    with pytest.raises(UnknownName):
        keypose.io.save(scene, tmp_path / "x.npz", layout="other")


def test_options_of_takes(tmp_path: Path) -> None:
    path = amass(tmp_path, mocap_framerate=None)
    assert any("taken as 60 Hz" in note for note in keypose.io.load(path).notes)
    assert keypose.io.load(path, rate_hz=100.0).animations[0].rate_hz == 100
    upright = keypose.io.load(path, up="Y")
    with np.load(path) as arrays:
        assert np.array_equal(upright.animations[0].pose.translations[:, 0], arrays["trans"])
    with pytest.raises(ShapeError):
        keypose.io.load(path, rate_hz=-1.0)
    with pytest.raises(UnknownName):
        keypose.io.load(path, up="W")


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"poses": np.zeros((20, 100))}, "poses"),
        ({"poses": np.full((20, 156), np.nan)}, "poses"),
        ({"poses": np.full((20, 156), 1e6)}, "poses"),
        ({"poses": np.zeros((20, 156), complex)}, "poses"),
        ({"trans": np.zeros((19, 3))}, "trans"),
        ({"trans": np.array(["a"] * 60).reshape(20, 3)}, "trans"),
        ({"mocap_framerate": np.array(0.0)}, "mocap_framerate"),
        ({"trans": None}, ""),
    ],
)
def test_wrong_takes_are_refused_by_the_name_of_the_array(tmp_path: Path, changes: dict[str, Any], where: str) -> None:
    with pytest.raises(FormatError) as error:
        keypose.io.load(amass(tmp_path, **changes))
    assert error.value.where == where


# --- what must never happen ------------------------------------------------------------------------------------------


class Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return (pytest.fail, ("the pickle ran",))


def test_nothing_is_unpickled(tmp_path: Path) -> None:
    path = tmp_path / "evil.npz"
    np.savez(path, poses=np.array([Bomb()], dtype=object), trans=np.zeros((1, 3)))
    with pytest.raises(FormatError, match="Python objects"):
        keypose.io.load(path)
    plain = io.BytesIO()
    with zipfile.ZipFile(plain, "w") as archive:
        archive.writestr("poses.npy", pickle.dumps(Bomb()))
        archive.writestr("trans.npy", b"x" * 100)
    path.write_bytes(plain.getvalue())
    with pytest.raises(FormatError, match="no NumPy array"):
        keypose.io.load(path)


def npy(shape: tuple[int, ...], data: bytes) -> bytes:
    text = repr({"descr": "<f8", "fortran_order": False, "shape": shape}).encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data


def test_a_long_capture_whose_scales_pack_to_nothing_is_no_bomb(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arrays_npz, "_SMALL_BYTES", 1 << 16)  # as if it were 10 minutes long
    scene = sample(frames=8000)
    motion = scene.animations[0]
    assert isinstance(motion, Motion)
    motion = replace(motion, pose=motion.pose.broadcast())
    path = tmp_path / "long.npz"
    keypose.io.save(replace(scene, animations=(motion,)), path)
    with zipfile.ZipFile(path) as archive:
        scales = next(m for m in archive.infolist() if "scales" in m.filename)
    assert scales.file_size > max(1 << 16, 200 * scales.compress_size)
    back = keypose.io.load(path).animations[0]
    assert isinstance(back, Motion) and np.array_equal(back.pose.rotations, motion.pose.rotations)


def test_bombs_are_refused_before_they_unpack(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("poses.npy", npy((20_000, 156), bytes(20_000 * 156 * 8)))
        archive.writestr("trans.npy", npy((20_000, 3), bytes(480_000)))
    assert path.stat().st_size < 100_000
    with pytest.raises(FormatError, match="too much") as error:
        keypose.io.load(path)
    assert error.value.where == "poses"
    with zipfile.ZipFile(path, "w") as archive:  # a small member that claims to be huge
        archive.writestr("poses.npy", npy((1 << 38, 156), bytes(1000)))
        archive.writestr("trans.npy", npy((1 << 38, 3), bytes(24)))
    with pytest.raises(FormatError, match="but 1000 bytes"):
        keypose.io.load(path)
    for method in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        with zipfile.ZipFile(path, "w", method) as archive:
            archive.writestr("poses.npy", npy((1, 156), bytes(156 * 8)))
            archive.writestr("trans.npy", npy((1, 3), bytes(24)))
        with pytest.raises(FormatError, match="packed by method"):
            keypose.io.load(path)
    header = b'{"rotations":{"dtype":"F32","shape":[1000000000,4],"data_offsets":[0,16000000000]},"__metadata__":{"keypose":"{}"}}'
    (tmp_path / "a.safetensors").write_bytes(struct.pack("<Q", len(header)) + header + bytes(16))
    with pytest.raises(FormatError, match="beyond the 16 that are there"):
        keypose.io.load(tmp_path / "a.safetensors")
    (tmp_path / "a.safetensors").write_bytes(struct.pack("<Q", 1 << 62) + header)
    with pytest.raises(FormatError, match="a header of"):
        keypose.io.load(tmp_path / "a.safetensors")


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        (b'"keypose.motion\\"', b'"keypose.motions\\"', "format"),
        (b'\\"version\\":1', b'\\"version\\":2', "version"),
        (b'\\"rate_hz\\":29.97', b'\\"rate_hz\\":\\"x\\"', "rate_hz"),
        (b'\\"hips\\",\\"knee', b'\\"foot\\",\\"knee', "joint_names"),
        (b'"rotations":{"dtype":"F32","shape":[7,4,4]', b'"rotations":{"dtype":"F32","shape":[4,7,4]', "rotations"),
        (b'"rotations":', b'"rotation":', "rotations"),
        (b'"shape":[7,4,3]', b'"shape":[7,4,4]', "translations"),
        (b'"dtype":"I32","shape":[4]', b'"dtype":"X32","shape":[4]', "parents"),
        (b"__metadata__", b"__metadata_", "__metadata_"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, old: bytes, new: bytes, where: str) -> None:
    path = tmp_path / "a.safetensors"
    keypose.io.save(sample(), path)
    data = path.read_bytes()
    (length,) = struct.unpack_from("<Q", data)
    header = data[8 : 8 + length]
    assert old in header
    header = header.replace(old, new, 1)
    path.write_bytes(struct.pack("<Q", len(header)) + header + data[8 + length :])
    with pytest.raises(FormatError) as error:
        keypose.io.load(path)
    assert error.value.where.startswith(where)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_thousand_damaged_files(tmp_path: Path, suffix: str) -> None:
    files = [tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"]
    keypose.io.save(sample(), files[0])
    keypose.io.save(sample(np.float64, moving=False), files[1])
    if suffix == ".npz":
        files.append(amass(tmp_path, 66, 3))
    result = load_damaged(files, 1000, tmp_path)
    assert result["wrong"] == []
    assert result["slowest_s"] < 3, result["slowest"]
    assert result["peak_mib"] < 1024
    assert result["loaded"] > 20 and result["refused"] > 300


def test_the_page() -> None:
    result = doctest.testfile(str(ROOT / "docs/formats/arrays.md"), module_relative=False, encoding="utf-8")
    assert result.attempted and not result.failed


def test_a_clip_is_no_amass_take(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="SMPL"):
        keypose.io.save(Clip({}), tmp_path / "x.npz", layout="amass")
