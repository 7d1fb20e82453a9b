"""A thousand damaged ASF files and a thousand AMC files: each is refused with one clear line, or loads as sound data."""

from __future__ import annotations

from pathlib import Path

from tests.conftest import find_data_dir
from tests.io.acclaim_files import AMC, ASF
from tests.io.damage import load_damaged


def test_a_thousand_damaged_skeletons(tmp_path: Path) -> None:
    files = [tmp_path / "small.asf", tmp_path / "crlf.asf"]
    files[0].write_text(ASF)
    files[1].write_text(ASF, newline="\r\n")
    data = find_data_dir()
    files += [data / "cmu_01_01/01.asf"] if data else []
    folder = tmp_path / "damaged"
    folder.mkdir()
    result = load_damaged(files, 1000, folder)
    assert result["wrong"] == []
    assert result["slowest_s"] < 2, result["slowest"]
    assert result["peak_mib"] < 1024
    assert result["loaded"] > 50 and result["refused"] > 300


def test_a_thousand_damaged_motions(tmp_path: Path) -> None:
    """Beside a sound skeleton, which the search finds."""
    files = [tmp_path / "small.amc", tmp_path / "held.amc"]
    files[0].write_text(AMC)
    files[1].write_text(AMC.replace(":FULLY-SPECIFIED\n", "").replace("head 12\n", ""))
    folder = tmp_path / "damaged"
    folder.mkdir()
    (folder / "small.asf").write_text(ASF)
    result = load_damaged(files, 1000, folder)
    assert result["wrong"] == []
    assert result["slowest_s"] < 2, result["slowest"]
    assert result["peak_mib"] < 1024
    assert result["loaded"] > 50 and result["refused"] > 300
