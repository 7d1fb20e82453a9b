"""Dropped files."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from studio_scenes import arm_scene, upload

from keypose.errors import FormatError
from keypose.model import Scene
from keypose.studio.container import pack
from keypose.studio.uploads import open_upload, safe_name


def opened(data: bytes) -> tuple[list[tuple[str, str]], list[str], list[Path]]:
    """What was read from the temporary folder: names and text."""
    paths: list[Path] = []

    def read(path: Path) -> Scene:
        paths.append(path)
        text = path.read_text()
        if text == "bad":
            raise FormatError("expected something better", where="line 1", path=path)
        return Scene(format=text)

    found = open_upload(data, read, lambda _name, _fraction: None)
    return [(name, scene.format) for name, scene in found.scenes], found.errors, paths


@pytest.mark.parametrize(
    ("name", "safe"),
    [
        ("walk.bvh", "walk.bvh"),
        ("../../etc/passwd", "etc/passwd"),
        ("/etc/passwd", "etc/passwd"),
        ("..\\..\\windows\\x.glb", "windows/x.glb"),
        ("a/./b//c.glb", "a/b/c.glb"),
        ("C:\\x.glb", "C_/x.glb"),
        ("nul\0byte.glb", "nul_byte.glb"),
    ],
)
def test_names_cannot_lead_out_of_the_folder(name: str, safe: str) -> None:
    assert str(safe_name(name)) == safe


@pytest.mark.parametrize("name", ["", "..", "/", "../..", "/".join("a" * 20)])
def test_a_name_of_which_nothing_is_left_is_refused(name: str) -> None:
    with pytest.raises(FormatError, match="no usable name"):
        safe_name(name)


def test_several_files_are_opened_and_their_companions_lie_beside_them() -> None:
    scenes, errors, paths = opened(
        upload(("a.gltf", b"one"), ("textures/skin.png", b"png"), ("b.bvh", b"two"), ("a.bin", b""))
    )
    assert scenes == [("a.gltf", "one"), ("b.bvh", "two")]
    assert errors == []
    assert not paths[0].exists(), "the temporary folder must be gone"


def test_one_bad_file_does_not_spoil_the_others_and_its_error_names_no_folder() -> None:
    scenes, errors, _ = opened(upload(("good.bvh", b"fine"), ("sub/bad.bvh", b"bad")))
    assert scenes == [("good.bvh", "fine")]
    assert errors == ["sub/bad.bvh: line 1: expected something better"]
    assert tempfile.gettempdir() not in errors[0]


def test_files_that_climb_stay_inside() -> None:
    outside = Path(tempfile.gettempdir(), "keypose-outside.bvh")
    scenes, _, paths = opened(upload(("../keypose-outside.bvh", b"x")))
    assert scenes == [("keypose-outside.bvh", "x")]
    assert "keypose-" in str(paths[0].parent)
    assert not outside.exists()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"GIF89a",
        pack({"type": "upload", "files": []}),
        pack({"type": "scene", "files": [{}]}),
        pack({"type": "upload", "files": ["x"]}),
        pack({"type": "upload", "files": [{"name": 3, "bytes": {}}]}),
        pack({"type": "upload", "files": [{"name": "x.bvh", "bytes": {"offset": 0, "bytes": 10**12}}]}),
        pack({"type": "upload", "files": [{"name": "x.bvh", "bytes": {}}] * 3000}),
    ],
)
def test_a_damaged_upload_is_refused(data: bytes) -> None:
    with pytest.raises(FormatError):
        opened(data)


def test_a_file_where_a_folder_should_be_is_refused() -> None:
    with pytest.raises(FormatError, match="cannot be stored"):
        opened(upload(("a", b"x"), ("a/b.bvh", b"y")))


def test_real_files_open(tmp_path: Path) -> None:
    from keypose import io
    from keypose.studio.session import open_path

    io.save(arm_scene(), tmp_path / "arm.glb")
    data = upload(("arm.glb", (tmp_path / "arm.glb").read_bytes()))
    found = open_upload(data, open_path, lambda _name, _fraction: None)
    assert found.errors == []
    assert found.scenes[0][1].character.skeleton.joint_count >= 4
