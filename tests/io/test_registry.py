"""The choice of formats, options, and the errors of `load` and `save`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import keypose.io
from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.io import registry
from keypose.model import Scene
from tests.io.bvh_files import SMALL, written


def test_content_decides_before_the_suffix(tmp_path: Path) -> None:
    for name in ("take.BVH", "take.txt", "take", "take.glb"):
        scene = keypose.io.load(written(tmp_path, SMALL, name))
        assert scene.format == "bvh"
    assert any("its content is bvh" in note for note in scene.notes)
    assert registry.format_of_content(b"glTF\x02\0\0\0").name == "gltf"
    assert registry.format_of_content(b'\xef\xbb\xbf \n{"asset": {"version": "2.0"}}').name == "gltf"
    assert registry.format_of_content(b"\xef\xbb\xbf# made by hand\n\n  hierarchy\n").name == "bvh"
    assert registry.format_of_content(b'{"name": "package"}') is None
    assert registry.format_of_content(b"") is None


def test_unknown_files_are_refused_with_the_known_suffixes(tmp_path: Path) -> None:
    for name in ("take.xyz", "take"):
        with pytest.raises(FormatError, match=r"known: \.bvh \.gltf \.glb \.vrm \.vrma") as caught:
            keypose.io.load(written(tmp_path, "no motion here", name))
        assert str(caught.value).startswith(str(tmp_path / name))
        with pytest.raises(FormatError, match=r"known: .*\.bvh"):
            keypose.io.save(Scene(), tmp_path / name)


def test_places_that_cannot_be_read(tmp_path: Path) -> None:
    cases = {
        tmp_path / "missing.bvh": "no such file",
        tmp_path: "is a folder",
        tmp_path / "a" / "b.bvh": "no such file",
        written(tmp_path, b"", "empty.bvh"): "the file is empty",
        tmp_path / "nul\0.bvh": "null",
    }
    for path, message in cases.items():
        with pytest.raises(FormatError, match=message) as caught:
            keypose.io.load(path)
        assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="permissions do not bind the superuser")
def test_files_without_permission(tmp_path: Path) -> None:
    path = written(tmp_path, SMALL)
    path.chmod(0)
    with pytest.raises(FormatError, match="Permission denied"):
        keypose.io.load(path)


def test_unknown_options_name_the_nearest(tmp_path: Path) -> None:
    path = written(tmp_path, SMALL)
    with pytest.raises(UnknownName, match="no bvh option 'units'; nearest: 'unit'"):
        keypose.io.load(path, units="cm")
    scene = keypose.io.load(path)
    with pytest.raises(UnknownName, match="no bvh option 'rate'; nearest: 'rate_hz'"):
        keypose.io.save(scene, path, rate=30)
    for option, value in (("unit", "furlong"), ("up", "W"), ("child_positions", "both"), ("truncated", "yes")):
        with pytest.raises(UnknownName):
            keypose.io.load(path, **{option: value})
    for unit in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ShapeError, match="positive"):
            keypose.io.load(path, unit=unit)


def test_saving_the_pieces_of_a_scene(tmp_path: Path) -> None:
    scene = keypose.io.load(written(tmp_path, SMALL))
    whole, pieces = tmp_path / "whole.bvh", tmp_path / "pieces.bvh"
    keypose.io.save(scene, whole)
    keypose.io.save([scene.character, scene.animations[0]], pieces)
    assert whole.read_bytes() == pieces.read_bytes()
    keypose.io.save(scene.character.skeleton, pieces)
    assert keypose.io.load(pieces).animations[0].frame_count == 1
    with pytest.raises(FormatError, match="needs a skeleton"):
        keypose.io.save(scene.animations[0], pieces)
    with pytest.raises(ShapeError, match="got str"):
        keypose.io.save(["take"], pieces)


def test_a_format_can_be_added_and_only_read(tmp_path: Path) -> None:
    added = registry.Format("lines", (".lines",), lambda head: head.startswith(b"LINES"), f"{__name__}:read_lines")
    registry.register(added)
    try:
        assert keypose.io.load(written(tmp_path, "LINES\n1\n2\n", "a.txt")).notes == ("3 lines",)
        with pytest.raises(FormatError, match="unknown suffix"):
            keypose.io.save(Scene(), tmp_path / "a.lines")
        with pytest.raises(FormatError, match="read but not written"):
            added.writer()
    finally:
        registry._formats.pop("lines")


def read_lines(path: Path) -> Scene:
    """The reader of the test above."""
    return Scene(notes=(f"{len(path.read_text().splitlines())} lines",))


def test_the_package_and_small_files_load_nothing_heavy(tmp_path: Path) -> None:
    code = (
        "import sys, keypose.io\n"
        f"scene = keypose.io.load({str(written(tmp_path, SMALL))!r})\n"
        f"keypose.io.save(scene, {str(tmp_path / 'out.bvh')!r})\n"
        "print([m for m in ('numba', 'scipy', 'moderngl', 'av', 'PIL', 'starlette') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
