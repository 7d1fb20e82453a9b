"""A thousand damaged COLLADA files: each is refused with one clear line, or loads as sound data."""

from __future__ import annotations

from pathlib import Path

from tests.io.collada_files import collada
from tests.io.damage import load_damaged


def test_a_thousand_damaged_files(tmp_path: Path) -> None:
    files = [tmp_path / "small.dae", tmp_path / "loud.dae"]
    clips = (
        '<library_animation_clips><animation_clip id="c" name="half" start="0.5" end="1.5"><instance_animation url="#bend"/>'
        "</animation_clip></library_animation_clips>"
    )
    files[0].write_text(collada())
    files[1].write_text(collada(clips=clips, up="X_UP").replace("NORMALIZED", "RELATIVE"))
    folder = tmp_path / "damaged"
    folder.mkdir()
    result = load_damaged(files, 1000, folder)
    assert result["wrong"] == []
    assert result["slowest_s"] < 3, result["slowest"]
    assert result["peak_mib"] < 1024
    assert result["loaded"] > 100 and result["refused"] > 300
