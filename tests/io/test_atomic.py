"""A file appears whole or not at all."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

import keypose.io
from keypose.errors import FormatError
from keypose.io.atomic import replacing
from tests.io.bvh_files import SMALL, written


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    target = written(tmp_path, "old", "file.bin")
    with pytest.raises(ZeroDivisionError), replacing(target) as temporary:
        temporary.write_bytes(b"half of the n")
        raise ZeroDivisionError
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_the_new_file_takes_the_old_ones_place_and_mode(tmp_path: Path) -> None:
    target = written(tmp_path, "old", "file.bin")
    target.chmod(0o640)
    with replacing(target) as temporary:
        assert temporary.parent == tmp_path and temporary.suffix == ".bin"
        temporary.write_bytes(b"new")
        assert target.read_bytes() == b"old"
    assert target.read_bytes() == b"new" and stat.S_IMODE(target.stat().st_mode) == 0o640
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.skipif(os.name != "posix", reason="the umask is POSIX's")
def test_a_new_file_has_the_usual_mode(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        with replacing(tmp_path / "new.bin") as temporary:
            temporary.write_bytes(b"new")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "new.bin").stat().st_mode) == 0o640


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    target = written(tmp_path, "old", "file.bin")
    link = tmp_path / "link.bin"
    link.symlink_to(target)
    with replacing(link) as temporary:
        temporary.write_bytes(b"new")
    assert link.is_symlink() and target.read_bytes() == b"new"


def test_places_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="does not exist"), replacing(tmp_path / "no" / "file.bin"):
        pass
    with pytest.raises(FormatError, match="is a folder"), replacing(tmp_path):
        pass


def test_a_long_name_still_has_a_temporary_file(tmp_path: Path) -> None:
    target = tmp_path / ("n" * 240 + ".bvh")
    keypose.io.save(keypose.io.load(written(tmp_path, SMALL)), target)
    assert keypose.io.load(target).animations


def test_a_writer_that_fails_midway_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = keypose.io.load(written(tmp_path, SMALL))

    def fail(*_: object) -> list[bytes]:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("keypose.io.bvh_writer.compose", fail)
    with pytest.raises(FormatError, match="No space left on device"):
        keypose.io.save(scene, tmp_path / "out.bvh")
    assert [p.name for p in tmp_path.iterdir()] == ["take.bvh"]
