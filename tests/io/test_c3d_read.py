"""C3D in the small: files made byte by byte, odd encodings, long trials, options, and what is written."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import keypose.io
from keypose.errors import FormatError, UnknownName
from keypose.io.c3d_parameters import DEC, chars, compose, dec_floats, floats, parse, strings
from keypose.io.registry import format_of_content
from keypose.model import Markers, Scene, Signals
from tests.io.c3d_files import c3d_bytes, differences, lab, saved, walk

_TEXT, _INT, _FLOAT = -1, 2, 4


def _points(values: np.ndarray, fourth: np.ndarray | float = 0.0) -> bytes:
    out = np.zeros((*values.shape[:2], 4), "<f4")
    out[..., :3], out[..., 3] = values, fourth
    return out.tobytes()


def _simple(tmp_path: Path, values: np.ndarray, fourth: np.ndarray | float = 0.0, **point: tuple) -> Path:
    """A file of floats in millimetres with labels A, B, ... and whatever parameters of POINT are given."""
    count = values.shape[1]
    labels = "".join(chr(65 + i) for i in range(count)).encode()
    parameters = {"LABELS": (_TEXT, (1, count), labels), "UNITS": (_TEXT, (2,), b"mm"), **point}
    path = tmp_path / "simple.c3d"
    path.write_bytes(
        c3d_bytes({"POINT": parameters}, points=count, frames=(1, len(values)), data=_points(values, fourth))
    )
    return path


def test_vax_floats() -> None:
    """Values of the VAX architecture manual: 1.0 is 0x4080, -0.5 is 0xC000, each in the first half."""
    raw = bytes.fromhex("8040 0000 00C0 0000 0000 0000 2041 0000 8041 0000".replace(" ", ""))
    assert floats(raw, DEC).tolist() == [1.0, -0.5, 0.0, 2.5, 4.0]
    largest = dec_floats(np.array([0x7FFFFFFF], np.uint32))
    assert np.isfinite(largest).all() and largest[0] == pytest.approx(1.7014117e38)


@pytest.mark.parametrize(
    ("right", "up", "expected"),
    [
        (b"+X", b"+Z", (1, 3, -2)),
        (b"+Y", b"+Z", (2, 3, 1)),
        (b"+X", b"+Y", (1, 2, 3)),
        (b"-X", b"+Z", (-1, 3, 2)),
        (b"+X", b"-Z", (1, -3, 2)),
    ],
)
def test_axes_of_the_screen(tmp_path: Path, right: bytes, up: bytes, expected: tuple[int, ...]) -> None:
    values = np.array([[(1000.0, 2000.0, 3000.0)]])
    path = _simple(tmp_path, values, X_SCREEN=(_TEXT, (2,), right), Y_SCREEN=(_TEXT, (2,), up))
    scene = keypose.io.load(path)
    assert scene.markers[0].positions[0, 0].tolist() == list(expected)
    assert scene.up == up.decode()[-1]
    assert not any("names none" in note for note in scene.notes)
    again, _ = saved(scene, tmp_path / "again.c3d")
    assert again.markers[0].positions.tolist() == scene.markers[0].positions.tolist()
    # the numbers themselves are those of the first file
    raw = keypose.io.load(tmp_path / "again.c3d", unit="m", up="Y").markers[0].positions
    told = keypose.io.load(path, unit="m", up="Y").markers[0].positions
    assert raw.tolist() == told.tolist()


def test_units_and_up_by_option(tmp_path: Path) -> None:
    path = _simple(tmp_path, np.array([[(1.0, 2.0, 3.0)]]), UNITS=(_TEXT, (4,), b"furl"))
    guessed = keypose.io.load(path)
    assert guessed.unit_m == 0.001 and any("'furl'" in note for note in guessed.notes)
    given = keypose.io.load(path, unit="cm", up="Y")
    np.testing.assert_allclose(given.markers[0].positions[0, 0], (0.01, 0.02, 0.03))
    with pytest.raises(UnknownName, match="up axis"):
        keypose.io.load(path, up="W")
    with pytest.raises(UnknownName, match="unit"):
        keypose.io.load(path, unit="ell")


@pytest.mark.parametrize(
    ("word", "metres"),
    [(b"mete", 1.0), (b"Meters", 1.0), (b"cm", 0.01), (b"MM", 0.001), (b"mill", 0.001), (b"in", 0.0254)],
)
def test_words_for_units(tmp_path: Path, word: bytes, metres: float) -> None:
    path = _simple(tmp_path, np.ones((2, 1, 3)), UNITS=(_TEXT, (len(word),), word))
    assert keypose.io.load(path).unit_m == metres


def test_the_fourth_word(tmp_path: Path) -> None:
    """Low byte: residual in steps of the scale. High byte: cameras. Below 0, also as 65535: not seen."""
    fourth = np.array([[0.0, 5 * 256 + 40, -1.0, 65535.0, -32768.0]])
    scene = keypose.io.load(_simple(tmp_path, np.ones((1, 5, 3)), fourth))
    markers = scene.markers[0]
    assert markers.visible.tolist() == [[True, True, False, False, False]]
    assert markers.cameras is not None and markers.cameras[0].tolist() == [0, 5, 0, 0, 0]
    np.testing.assert_allclose(markers.residuals[0, :2], (0, 0.040), rtol=1e-6)
    assert np.isnan(markers.residuals[0, 2:]).all() and np.isnan(markers.positions[0, 2:]).all()


def test_analog_scales(tmp_path: Path) -> None:
    """(raw - OFFSET) * SCALE * GEN_SCALE, signed and unsigned, with the offset in any type."""
    raw = np.array([[10.0, 40000.0], [20.0, 50000.0]], "<f4")
    for kind, offsets in ((_INT, np.array((2, -25536), "<i2")), (_FLOAT, np.array((2, 40000), "<f4"))):
        analog = {
            "USED": (_INT, (), struct.pack("<h", 2)),
            "FORMAT": (_TEXT, (8,), b"UNSIGNED"),
            "GEN_SCALE": (_FLOAT, (), struct.pack("<f", 0.5)),
            "SCALE": (_FLOAT, (2,), struct.pack("<2f", 4.0, 0.25)),
            "OFFSET": (kind, (2,), offsets.tobytes()),
            "LABELS": (_TEXT, (2, 2), b"F1F2"),
        }
        path = tmp_path / "analog.c3d"
        content = c3d_bytes({"ANALOG": analog}, points=0, frames=(1, 1), data=raw.tobytes(), analog=4, samples=2)
        path.write_bytes(content)
        signals = keypose.io.load(path).signals[0]
        assert signals.values.tolist() == [[16.0, 0.0], [36.0, 1250.0]]
        assert signals.rate_hz == 100.0 and signals.names == ("F1", "F2")
        again, _ = saved(keypose.io.load(path), tmp_path / "again.c3d")
        assert again.signals[0].values.tolist() == signals.values.tolist()


def test_everything_comes_back(tmp_path: Path) -> None:
    scene = lab()
    again, notes = saved(scene, tmp_path / "lab.c3d")
    assert notes == () and again.notes == ()
    assert differences(replace(scene, markers=again.markers), again) == []
    np.testing.assert_allclose(again.markers[0].positions, scene.markers[0].positions, atol=1e-6, equal_nan=True)
    # residuals are bytes: to half a step
    apart = np.abs(again.markers[0].residuals - scene.markers[0].residuals)
    assert np.nanmax(apart) <= 0.51 * np.nanmax(scene.markers[0].residuals) / 255
    assert np.array_equal(again.markers[0].cameras, scene.markers[0].cameras)
    (event,) = again.extras["events"]
    assert event == {**scene.extras["events"][0], "time_s": pytest.approx(0.05)}


@pytest.mark.parametrize(("unit", "up"), [("m", "Y"), ("cm", "Z"), ("inch", "X"), ("mm", "Y")])
def test_units_and_axes_of_the_file_written(tmp_path: Path, unit: str, up: str) -> None:
    scene = lab()
    again, _ = saved(scene, tmp_path / "other.c3d", unit=unit, up=up)
    assert again.up == up and again.unit_m == keypose.io.axes.UNITS_M[unit]
    np.testing.assert_allclose(again.markers[0].positions, scene.markers[0].positions, atol=1e-6, equal_nan=True)
    np.testing.assert_allclose(again.plates[0].corners, scene.plates[0].corners, atol=1e-6)
    third, _ = saved(again, tmp_path / "third.c3d", unit="mm", up="Z")
    np.testing.assert_allclose(third.markers[0].positions, scene.markers[0].positions, atol=2e-6, equal_nan=True)


def test_more_than_255_labels(tmp_path: Path) -> None:
    names = tuple(f"P{i:04d}" for i in range(700))
    positions = np.random.default_rng(3).normal(0, 1, (4, 700, 3))
    scene = Scene(markers=(Markers(names, positions, 100.0),))
    again, _ = saved(scene, tmp_path / "many.c3d")
    assert again.markers[0].names == names
    kept = again.extras["c3d"].groups["POINT"].parameters
    assert [kept[n].dims[1] for n in ("LABELS", "LABELS2", "LABELS3")] == [255, 255, 190]
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is not installed")
    theirs = ezc3d.c3d(str(tmp_path / "many.c3d"))
    assert theirs["data"]["points"].shape == (4, 700, 4)
    # fewer again: the continuations must not stay
    few, _ = saved(replace(again, markers=(Markers(names[:3], positions[:, :3], 100.0),)), tmp_path / "few.c3d")
    assert few.markers[0].names == names[:3]


def test_more_frames_than_16_bits_count(tmp_path: Path) -> None:
    frames = 70_000
    positions = np.linspace(0, 1, frames * 3).reshape(frames, 1, 3)
    scene = Scene(markers=(Markers(("A",), positions, 1000.0, start_frame=5),))
    again, _ = saved(scene, tmp_path / "long.c3d")
    assert again.markers[0].frame_count == frames and again.markers[0].start_frame == 5
    np.testing.assert_allclose(again.markers[0].positions, positions, atol=1e-6)
    back, _ = saved(
        replace(again, markers=(replace(again.markers[0], positions=positions[:10], visible=None),)),
        tmp_path / "short.c3d",
    )
    assert back.markers[0].frame_count == 10
    # without TRIAL: POINT:LONG_FRAMES, else POINT:FRAMES as an unsigned number
    data = _points(positions * 1000)
    point = {"LONG_FRAMES": (_FLOAT, (), struct.pack("<f", frames)), "LABELS": (_TEXT, (1, 1), b"A")}
    path = tmp_path / "longer.c3d"
    path.write_bytes(c3d_bytes({"POINT": point}, points=1, frames=(1, 65535), data=data))
    assert keypose.io.load(path).markers[0].frame_count == frames


def test_first_frame_0_and_late_ones(tmp_path: Path) -> None:
    for start in (0, 1, 40, 65000, 70000):
        scene = Scene(markers=(walk(start_frame=start),))
        again, _ = saved(scene, tmp_path / "start.c3d")
        assert again.markers[0].start_frame == start
        assert again.markers[0].frame_count == 20


def test_names(tmp_path: Path) -> None:
    """Empty and double labels get names, and keep their labels in the file."""
    path = _simple(tmp_path, np.ones((2, 4, 3)), LABELS=(_TEXT, (2, 3), b"A A B "))
    scene = keypose.io.load(path)
    assert scene.markers[0].names == ("A", "A_2", "B", "point_4")
    assert any("came twice" in note for note in scene.notes) and any("1 of 4 points" in note for note in scene.notes)
    again, _ = saved(scene, tmp_path / "again.c3d")
    assert strings(again.extras["c3d"].groups, "POINT", "LABELS") == ["A", "A", "B"]
    assert again.markers[0].names == scene.markers[0].names


def test_signals_that_do_not_fit_are_told(tmp_path: Path) -> None:
    odd = Signals(("A",), np.zeros((33, 1)), 123.4, name="odd")
    computed = Signals(("B",), np.zeros((7, 1, 3)), 100.0, kind="angle", name="short")
    scene = Scene(markers=(walk(),), signals=(odd, computed))
    notes = keypose.io.save(scene, tmp_path / "odd.c3d")
    assert any("'odd'" in note for note in notes) and any("'short'" in note for note in notes)
    with pytest.raises(FormatError, match="no markers and no signals"):
        keypose.io.save(Scene(), tmp_path / "none.c3d")
    assert not (tmp_path / "none.c3d").exists()


def test_only_analog(tmp_path: Path) -> None:
    scene = Scene(signals=(Signals(("A", "B"), np.arange(20.0).reshape(10, 2), 1000.0, ("V", "V")),))
    again, _ = saved(scene, tmp_path / "analog.c3d")
    assert again.markers == () and differences(scene, again) == []


def test_cut_files(tmp_path: Path) -> None:
    scene = lab()
    keypose.io.save(scene, tmp_path / "lab.c3d")
    content = (tmp_path / "lab.c3d").read_bytes()
    cut = tmp_path / "cut.c3d"
    cut.write_bytes(content[:-2000])
    with pytest.raises(FormatError, match=r"byte \d+: 20 frames .* announced"):
        keypose.io.load(cut)
    kept = keypose.io.load(cut, truncated="keep")
    count = kept.markers[0].frame_count
    assert 0 < count < 20 and any("kept" in note for note in kept.notes)
    np.testing.assert_allclose(kept.markers[0].positions, scene.markers[0].positions[:count], atol=1e-6, equal_nan=True)
    for size in (0, 1, 100, 511, 512, 600):
        cut.write_bytes(content[:size])
        with pytest.raises(FormatError):
            keypose.io.load(cut)


def test_content_before_suffix(tmp_path: Path) -> None:
    keypose.io.save(lab(), tmp_path / "lab.c3d")
    other = tmp_path / "lab.bvh"
    other.write_bytes((tmp_path / "lab.c3d").read_bytes())
    scene = keypose.io.load(other)
    assert scene.format == "c3d" and any("its content is c3d" in note for note in scene.notes)
    assert format_of_content(b"\x02P" + b"text that goes on" * 60) is None


def test_parameter_sections_of_any_size() -> None:
    """Groups, types and lengths come back as they were; records chain over blocks."""
    from keypose.io.c3d_parameters import Group, Parameter, ints, reals

    dice = np.random.default_rng(5)
    groups = {
        f"G{g}": Group(
            {
                "WORDS": chars([f"word {i}" for i in range(g * 4)], description="some words"),
                "INTS": ints(dice.integers(0, 65536, 9).tolist(), (3, 3)),
                "REALS": reals(dice.normal(0, 1, 24), (2, 3, 4)),
                "ONE": ints([g], ()),
                "BYTES": Parameter("byte", (4,), np.array((-128, -1, 0, 127), np.int8), "bytes", True),
            },
            f"group {g}",
            g % 2 == 0,
        )
        for g in range(60)
    }
    section = compose(groups)
    notes: list[str] = []
    found = parse(b"\0" * 512 + section, 512, 512 + len(section), 84, notes)
    assert notes == [] and list(found) == list(groups)
    for name, group in groups.items():
        assert (found[name].description, found[name].locked) == (group.description, group.locked)
        for own, parameter in group.parameters.items():
            other = found[name].parameters[own]
            assert (other.kind, other.dims, other.description, other.locked) == (
                parameter.kind, parameter.dims, parameter.description, parameter.locked,
            )  # fmt: skip
            assert np.array_equal(np.asarray(other.values), np.asarray(parameter.values))


def test_strings_of_no_length_cost_no_memory(tmp_path: Path) -> None:
    """Each of these parameters claims 65,025 empty strings in a dozen bytes."""
    import tracemalloc

    claims = {f"P{i:05d}": (_TEXT, (0, 255, 255), b"") for i in range(5000)}
    path = tmp_path / "claims.c3d"
    path.write_bytes(c3d_bytes({"POINT": claims}, points=1, frames=(1, 1), data=_points(np.ones((1, 1, 3)))))
    tracemalloc.start()
    keypose.io.load(path)
    assert tracemalloc.get_traced_memory()[1] < 64e6
    tracemalloc.stop()
