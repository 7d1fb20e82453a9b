"""`keypose info` on what a capture lab records."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import keypose.io
from keypose.cli.info import describe, print_info
from tests.io.c3d_files import lab


def test_markers_stand_where_the_clip_would(tmp_path: Path) -> None:
    scene = lab()
    facts = describe(scene)
    assert (facts["markers"], facts["frames"], facts["rate_hz"]) == (5, 20, 100.0)
    assert facts["marker_names"] == ["M0", "M1", "M2", "M3", "M4"] and facts["clips"] == []
    assert facts["duration_s"] == pytest.approx(0.19)
    json.dumps(facts)


def test_what_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keypose.io.save(lab(), tmp_path / "lab.c3d")
    print_info(str(tmp_path / "lab.c3d"), as_json=False)
    out = " ".join(capsys.readouterr().out.split())
    visible = lab().markers[0].visible
    assert visible is not None
    missing = 100 * (1 - visible.mean())
    for said in (
        "5 markers, 20 frames (1 to 20) at 100 Hz", f"{missing:.1f}% missing", "7 analog channels at 400 Hz in N/Nm/V",
        "2 angle signals at 100 Hz in deg", "1 force plate: 0.60 x 0.40 m (type 4)", "1 event",
    ):  # fmt: skip
        assert said in out, out
