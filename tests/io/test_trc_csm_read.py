"""TRC and CSM in the small: headers as they are in the wild, gaps, typing errors, and what is written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import keypose.io
from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.model import Markers, Scene
from tests.conftest import find_data_dir
from tests.io.c3d_files import lab, saved, walk
from tests.io.damage import load_damaged

TRC = """PathFileType\t4\t(X/Y/Z)\tsmall.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames
50.00\t50.00\t3\t2\tmm\t50.00\t1\t3
Frame#\tTime\tA\t\t\tB\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2

1\t0.00\t1\t2\t3\t4\t5\t6
2\t0.02\t\t\t\t40\t50\t60
3\t0.04\t100\t200\t300\t\t\t
"""
CSM = """$Filename small.csm
$Actor Anna
$Comments
two lines
of comments

$FirstFrame 7
$LastFrame 9
$Rate 50

$Order
A B
C
$Points
7  1 2 3  4 5 6  7 8 9
8  10 20 30  DROPOUT  70 80 90
9  DROPOUT  DROPOUT  700 800 900
"""
_EXPECTED = np.array([[(1, 2, 3), (4, 5, 6)], [(np.nan,) * 3, (40, 50, 60)], [(100, 200, 300), (np.nan,) * 3]]) / 1000


def _load(tmp_path: Path, text: str, suffix: str = "trc", **options: object) -> Scene:
    path = tmp_path / f"small.{suffix}"
    path.write_bytes(text.encode())
    return keypose.io.load(path, **options)


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t,
        lambda t: t.replace("\n", "\r\n"),
        lambda t: t.replace("\n", "\r"),
        lambda t: "\ufeff" + t,
        lambda t: t.replace("\t", ","),
        lambda t: t.replace("\t", ";"),
        lambda t: t.replace("\t\t\t\t40", "\tNaN\tnan\tNAN\t40").replace("300\t\t\t", "300\tnan\t-nan\t1.#QNAN"),
        lambda t: t.replace("300\t\t\t\n", "300\n"),
        lambda t: t.replace("300\t\t\t\n", "300\t \t \t \t\t\n"),
        lambda t: t.replace("Frame#\tTime\tA\t\t\tB\t\t", "frame#\ttime\tA\tB"),
        lambda t: t.replace("Frame#\tTime\tA\t\t\tB\t\t", "Frame#\tTime\t\tA\t\tB"),
        lambda t: t.replace("\n\n", "\n"),
        lambda t: t.replace("1\t0.00", "1.000000\t0.00"),
        lambda t: t.replace("DataRate\tCameraRate", "datarate\tCAMERARATE").replace("PathFile", "pathfile"),
        lambda t: t.replace("\t3\t2\tmm", "\t999\t0\tmm"),
        lambda t: t.replace("50.00\t50.00", "\t50.00"),
        lambda t: t.replace("50.00\t50.00", "zero\t"),
    ],
    ids=lambda _: "",
)
def test_headers_in_the_wild(tmp_path: Path, change: object) -> None:
    scene = _load(tmp_path, change(TRC))
    markers = scene.markers[0]
    assert markers.names == ("A", "B") and markers.rate_hz == pytest.approx(50)
    np.testing.assert_allclose(markers.positions, _EXPECTED, equal_nan=True)


def test_decimal_commas_and_blanks(tmp_path: Path) -> None:
    scene = _load(tmp_path, TRC.replace("\t100\t", "\t100,0\t"))
    np.testing.assert_allclose(scene.markers[0].positions, _EXPECTED, equal_nan=True)
    assert any("commas" in note for note in scene.notes)
    whole = TRC.replace("\t\t\t\t40", "\tnan\tnan\tnan\t40").replace("300\t\t\t", "300\tnan\tnan\tnan")
    blanks = _load(tmp_path, whole.replace("\t\t\t", " ").replace("\t", "  "))
    np.testing.assert_allclose(blanks.markers[0].positions, _EXPECTED, equal_nan=True)
    assert blanks.markers[0].names == ("A", "B") and any("blanks" in note for note in blanks.notes)


def test_unlabelled_trajectories(tmp_path: Path) -> None:
    scene = _load(tmp_path, TRC.replace("Frame#\tTime\tA\t\t\tB\t\t", "Frame#\tTime\t").replace("\t2\tmm", "\t0\tmm"))
    assert scene.markers[0].names == ("marker_1", "marker_2")
    np.testing.assert_allclose(scene.markers[0].positions, _EXPECTED, equal_nan=True)
    hole = _load(tmp_path, TRC.replace("A\t\t\tB", "\t\t\tB"))
    assert hole.markers[0].names == ("marker_1", "B")


def test_units_axes_and_errors(tmp_path: Path) -> None:
    metres = _load(tmp_path, TRC.replace("mm", "m"), up="Z")
    np.testing.assert_allclose(metres.markers[0].positions[0, 0], (1, 3, -2))
    assert (metres.unit_m, metres.up) == (1.0, "Z")
    np.testing.assert_allclose(_load(tmp_path, TRC, unit="cm").markers[0].positions[0, 0], (0.01, 0.02, 0.03))
    with pytest.raises(FormatError, match=r"line 8: expected a number, found 'x1'"):
        _load(tmp_path, TRC.replace("\t40\t", "\tx1\t"))
    with pytest.raises(FormatError, match=r"line 9: 1e\+30"):
        _load(tmp_path, TRC.replace("\t100\t", "\t1e30\t"))
    with pytest.raises(FormatError, match=r"Frame#"):
        _load(tmp_path, "\n".join(TRC.split("\n")[:3]))
    with pytest.raises(UnknownName):
        _load(tmp_path, TRC, up="W")
    with pytest.raises(ShapeError, match="decimals"):
        keypose.io.save(Scene(markers=(walk(),)), tmp_path / "a.trc", decimals=30)


def test_csm(tmp_path: Path) -> None:
    scene = _load(tmp_path, CSM, "csm", up="Y")
    markers = scene.markers[0]
    assert markers.names == ("A", "B", "C") and markers.rate_hz == 50 and markers.start_frame == 7
    assert markers.visible.tolist() == [[True] * 3, [True, False, True], [False, False, True]]
    np.testing.assert_allclose(markers.positions[2, 2], (0.7, 0.8, 0.9))
    assert markers.extras["csm"]["Comments"] == "two lines\nof comments"
    again, notes = saved(scene, tmp_path / "again.csm", up="Y")
    again = keypose.io.load(tmp_path / "again.csm", up="Y", unit="mm")
    assert notes == () and again.markers[0].extras["csm"] == markers.extras["csm"]
    np.testing.assert_allclose(again.markers[0].positions, markers.positions, atol=1e-8, equal_nan=True)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda t: t.replace("DROPOUT", "DROPOUT DROPOUT DROPOUT"), ""),
        (lambda t: t.replace("DROPOUT", "dropout"), ""),
        (lambda t: t.replace("DROPOUT", "DROUPOUT"), ""),
        (lambda t: t.lower(), ""),
        (lambda t: t.upper(), ""),
        (lambda t: t.replace("$FirstFrame", "$FristFrame").replace("$Order", "$Oder"), "taken as $Order"),
        (lambda t: t.replace("$Rate 50", "$Rate  50\n$Wibble 3"), "not known"),
        (lambda t: t.replace("$LastFrame 9", "$LastFrame 90"), "$LastFrame says 90"),
        (lambda t: t.replace("$FirstFrame 7", "$FirstFrame 1"), "$FirstFrame says 1"),
        (lambda t: t.replace("\n", "\r\n").replace("  ", "\t"), ""),
    ],
    ids=lambda _: "",
)
def test_csm_in_the_wild(tmp_path: Path, change: object, told: str) -> None:
    scene = _load(tmp_path, change(CSM), "csm", up="Y", unit="mm")
    markers = scene.markers[0]
    assert [name.upper() for name in markers.names] == ["A", "B", "C"] and markers.start_frame == 7
    assert markers.rate_hz == 50
    assert markers.visible.tolist() == [[True] * 3, [True, False, True], [False, False, True]]
    np.testing.assert_allclose(markers.positions[1, 2], (0.07, 0.08, 0.09))
    assert told in " ".join(scene.notes)


def test_csm_frames_left_out(tmp_path: Path) -> None:
    scene = _load(tmp_path, CSM.replace("\n9  DROP", "\n11  DROP").replace("LastFrame 9", "LastFrame 11"), "csm")
    markers = scene.markers[0]
    assert markers.frame_count == 5 and not markers.visible[2:4].any() and markers.visible[4, 2]
    assert any("2 frames are left out" in note for note in scene.notes)


def test_csm_errors(tmp_path: Path) -> None:
    for change, place in (
        (CSM.replace("$Order", ""), r"there is no \$Order"),
        (CSM.replace("$Points", "$Date"), r"there is no \$Points"),
        (CSM.replace("8  10 20 30", "8  10 20"), r"line 16: expected a frame number and 3 markers"),
        (CSM.replace("8  10 20 30", "8  10 20 oops"), r"line 16: .*'oops'"),
        (CSM.replace("8  10 20 30", "8  10 20 1e40"), r"line 16: 1e\+40"),
    ):
        with pytest.raises(FormatError, match=place):
            _load(tmp_path, change, "csm")


def test_what_text_cannot_hold_is_told(tmp_path: Path) -> None:
    for suffix in ("trc", "csm"):
        notes = " ".join(keypose.io.save(lab(), tmp_path / f"lab.{suffix}"))
        for lost in ("3 sets of signals", "1 force plates", "1 events", "residuals", "camera masks"):
            assert lost in notes, suffix
        with pytest.raises(FormatError, match="no markers"):
            keypose.io.save(Scene(), tmp_path / f"none.{suffix}")


@pytest.mark.parametrize("suffix", ["trc", "csm"])
@pytest.mark.parametrize(("unit", "up"), [("mm", "Y"), ("m", "Z"), ("cm", "X")])
def test_round_trips(tmp_path: Path, suffix: str, unit: str, up: str) -> None:
    scene = Scene(markers=(walk(40, 7, quality=False, start_frame=12),))
    path = tmp_path / f"walk.{suffix}"
    assert keypose.io.save(scene, path, unit=unit, up=up) == ()
    again = keypose.io.load(path, unit=unit, up=up).markers[0]
    assert again.names == scene.markers[0].names and again.start_frame == 12 and again.rate_hz == 100
    np.testing.assert_allclose(again.positions, scene.markers[0].positions, atol=0.6e-8, equal_nan=True)


def test_large_tables_and_small_ones_are_read_alike(tmp_path: Path) -> None:
    """Beyond 200 kB the compiled parser takes over."""
    scene = Scene(markers=(walk(900, 30, quality=False),))
    for suffix in ("trc", "csm"):
        keypose.io.save(scene, tmp_path / f"large.{suffix}", unit="mm", up="Y")
        again = keypose.io.load(tmp_path / f"large.{suffix}", unit="mm", up="Y").markers[0]
        np.testing.assert_allclose(again.positions, scene.markers[0].positions, atol=0.6e-8, equal_nan=True)


def test_no_markers_at_all(tmp_path: Path) -> None:
    scene = Scene(markers=(Markers((), np.zeros((4, 0, 3)), 50.0),))
    again, _ = saved(scene, tmp_path / "empty.trc")
    assert again.markers[0].frame_count == 4 and again.markers[0].names == ()


@pytest.mark.parametrize("suffix", ["trc", "csm"])
def test_a_thousand_damaged_files(tmp_path: Path, suffix: str) -> None:
    """Each is refused with one clear line, or loads as sound data."""
    small = tmp_path / f"small.{suffix}"
    small.write_text(TRC if suffix == "trc" else CSM)
    made = tmp_path / f"walk.{suffix}"
    keypose.io.save(Scene(markers=(walk(30, 6, quality=False),)), made)
    data = find_data_dir()
    names = {
        "trc": ("trc/motion_analysis/10002-20130626160334-Unnamed.trc",),
        "csm": ("csm/malformed_zero_framerange.csm",),
    }
    files = [small, made] + [data / name for name in names[suffix] if data]
    result = load_damaged(files, 1000, tmp_path)
    assert result["wrong"] == []
    assert result["slowest_s"] < 2, result["slowest"]
    assert result["peak_mib"] < 1024
    assert result["loaded"] > 50 and result["refused"] > 150


@pytest.mark.parametrize("suffix", ["trc", "csm"])
@pytest.mark.parametrize("letter", ["\t", "$a\n", "A ", "1\t", "nan\t", "DROPOUT ", "\n"])
def test_floods_of_one_thing(tmp_path: Path, suffix: str, letter: str) -> None:
    """Half a megabyte of the same at several places: no quadratic time."""
    import time

    text = TRC if suffix == "trc" else CSM
    flood = letter * (500_000 // len(letter))
    for place in (0, 60, 110, 230, len(text)):
        start = time.process_time()
        try:
            _load(tmp_path, text[:place] + flood + text[place:], suffix)
        except FormatError as error:
            assert len(str(error)) < 600
        assert time.process_time() - start < 5, place
