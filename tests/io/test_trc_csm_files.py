"""Real TRC and CSM files: facts measured by other tools, the same trials in other formats, and round trips."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import keypose.io
from keypose.errors import FormatError
from keypose.model import Markers, Scene

pytestmark = pytest.mark.data

_ROW = re.compile(
    r"^\| `([^`]*\.trc)` .*?DataRate ([\d.]+), CameraRate [\d.]+, NumFrames\s+(\d+), NumMarkers (\d+), Units (\w+)",
    re.MULTILINE,
)
_Z_UP = ("Gait", "Blanks", "walking2", "pyomeca")


@pytest.fixture(scope="module")
def scenes(data_dir: Path) -> dict[str, Scene]:
    """Every TRC file that is none of the malformed ones, and the CSM file."""
    files = [f for f in data_dir.glob("**/*.trc") if f.name not in ("Empty.trc", "Truncated.trc")]
    files.append(data_dir / "csm/ThomasFechten.csm")
    return {str(f.relative_to(data_dir)): keypose.io.load(f) for f in sorted(files)}


def test_facts_measured_by_other_tools(data_dir: Path, scenes: dict[str, Scene]) -> None:
    rows = _ROW.findall((data_dir / "README.md").read_text())
    assert len(rows) >= 10
    for name, rate, frames, markers, unit in rows:
        scene = scenes[name]
        found = scene.markers[0]
        assert found.rate_hz == float(rate), name
        assert found.frame_count == int(frames), name
        assert scene.unit_m == {"mm": 0.001, "m": 1.0}[unit], name
        assert len(found.names) == (int(markers) or 10), name  # nobody labelled the ten of the file that says 0
    assert [len(m.names) for m in scenes["trc/motion_analysis/Gait.trc"].markers] == [66, 39]  # rows go on behind them
    commas = scenes["trc/pyomeca/markers.trc"]
    assert len(commas.markers[0].names) == 51 and commas.markers[0].rate_hz == 100
    # the header says 652 frames; 93 are there
    assert commas.markers[0].frame_count == 93 and any("says 652" in note for note in commas.notes)


def test_malformed_files_are_refused_with_their_place(data_dir: Path) -> None:
    with pytest.raises(FormatError, match=r"Empty\.trc: the file is empty"):
        keypose.io.load(data_dir / "trc/motion_analysis/Empty.trc")
    with pytest.raises(FormatError, match=r"Truncated\.trc: line 3: the header is cut"):
        keypose.io.load(data_dir / "trc/motion_analysis/Truncated.trc")
    odd = keypose.io.load(data_dir / "csm/malformed_zero_framerange.csm")
    assert odd.markers[0].start_frame == 0 and odd.markers[0].frame_count == 1
    assert any("$Rate" in note for note in odd.notes)


def test_up_axis_and_size(scenes: dict[str, Scene]) -> None:
    for name, scene in scenes.items():
        expected = "Z" if any(part in name for part in (*_Z_UP, "csm")) else "Y"
        assert scene.up == expected, name
        low, high = np.nanpercentile(scene.markers[0].positions[..., 1], (1, 99))
        if not any(part in name for part in ("Unnamed", "Knee", "pyomeca")):
            assert -0.05 < low < 0.1 and 1.3 < high < 1.85, name


def test_the_same_trial_as_c3d(data_dir: Path, scenes: dict[str, Scene]) -> None:
    """Gait.trc and Gait.c3d are one trial, by another filter; walking2 was written by OpenSim."""
    # up="Y" leaves the numbers as they are: a TRC file cannot say which way is right
    text = keypose.io.load(data_dir / "trc/motion_analysis/Gait.trc", up="Y").markers[0]
    binary = keypose.io.load(data_dir / "c3d/misc/Gait.c3d", up="Y").markers[0]
    shared = [("R.Shoulder", "RSHO"), ("R.Elbow", "RELB"), ("L.Wrist", "LWRI"), ("R.Toe", "RTOE")]
    for a, b in shared:
        apart = np.linalg.norm(text.positions[:, text.index(a)] - binary.positions[:, binary.index(b)], axis=-1)
        assert np.isfinite(apart).sum() > 20 and np.nanmedian(apart) < 5e-3, a
    text = scenes["c3d/opensim/std_walking2_markers.trc"].markers[0]
    binary = keypose.io.load(data_dir / "c3d/opensim/walking2.c3d").markers[0]
    columns = [binary.index(name) for name in text.names]
    other = binary.positions[::10][:, columns]
    # the file's axes are those of the C3D file, but it cannot say which way is right
    apart = np.linalg.norm(text.positions[: len(other)], axis=-1) - np.linalg.norm(other, axis=-1)
    assert np.nanmax(np.abs(apart)) < 1e-4


def test_gaps_are_gaps(scenes: dict[str, Scene]) -> None:
    for name, share in (
        ("trc/opensim/dataWithBlanksForMissingMarkers.trc", 0.81),
        ("trc/motion_analysis/Knee.trc", 0.24),
    ):
        assert 1 - scenes[name].markers[0].visible.mean() == pytest.approx(share, abs=0.01)
    blanks = scenes["trc/opensim/dataWithBlanksForMissingMarkers.trc"].markers[0]
    assert not blanks.visible[0].any()  # its first row is empty


def whole(scene: Scene) -> Markers:
    """All sets of markers as one, as files hold them."""
    first = scene.markers[0]
    names = tuple(name for m in scene.markers for name in m.names)
    positions = np.concatenate([m.positions for m in scene.markers], axis=1)
    return Markers(names, positions, first.rate_hz, start_frame=first.start_frame)


def test_every_file_comes_back_the_same(scenes: dict[str, Scene], tmp_path: Path) -> None:
    for name, scene in scenes.items():
        for suffix in ("trc", "csm", "c3d"):
            target = tmp_path / f"again.{suffix}"
            keypose.io.save(scene, target, up=scene.up)
            again = keypose.io.load(target, up=scene.up, unit=scene.unit_m).markers[0]
            first = whole(scene)
            assert np.array_equal(again.visible, first.visible), (name, suffix)
            np.testing.assert_allclose(
                again.positions, first.positions, rtol=0, atol=2e-7, equal_nan=True, err_msg=name
            )
            assert again.rate_hz == pytest.approx(first.rate_hz, rel=1e-7) and again.start_frame == first.start_frame
            if suffix != "csm":  # there names have no blanks
                assert again.names == first.names, (name, suffix)
