"""Live Link Face takes: what the app writes, drifting and broken time codes, round trips, damage."""

from __future__ import annotations

import csv
import doctest
from pathlib import Path

import numpy as np
import pytest

import keypose.io
from keypose.errors import FormatError, ShapeError
from keypose.io.livelink import COLUMNS
from keypose.model import Channel, Clip, Curve, CurveKind, Motion, Property, Scene
from tests.conftest import ROOT
from tests.io.damage import load_damaged

HEADER = "Timecode,BlendshapeCount," + ",".join(COLUMNS)


def timecode(frames: float, start_s: int = 13 * 3600 + 59 * 60 + 57) -> str:
    """As the app counts: 60 frames a second, thousandths of a frame."""
    thousandths = round(frames * 1000)
    seconds, rest = divmod(thousandths, 60_000)
    at = (start_s + seconds) % 86400
    return f"{at // 3600:02}:{at // 60 % 60:02}:{at % 60:02}:{rest // 1000:02}.{rest % 1000:03}"


def take(frames: np.ndarray, values: np.ndarray, start_s: int = 13 * 3600 + 59 * 60 + 57) -> str:
    lines = [HEADER]
    for frame, row in zip(frames, values, strict=True):
        lines.append(f"{timecode(frame, start_s)},61,{','.join(f'{v:.10f}' for v in row)}")
    return "\n".join(lines) + "\n"


def wave(frames: np.ndarray) -> np.ndarray:
    """Smooth weights, known at any moment."""
    return 0.4 + 0.4 * np.sin(frames[:, None] / 60 * 2 + np.arange(61))


def loaded(path: Path, text: str, **options: object) -> tuple[Scene, Motion]:
    path.write_text(text)
    scene = keypose.io.load(path, **options)
    (motion,) = scene.animations
    assert isinstance(motion, Motion)
    return scene, motion


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "take.csv"


def test_the_columns_are_those_of_arkit() -> None:
    assert len(COLUMNS) == 61 == len(set(COLUMNS))
    from keypose.samples import open_scene

    human = set(open_scene("sample:human").character.morph_names)
    assert sum(name[:1].lower() + name[1:] in human for name in COLUMNS) == 52  # and nine rotations
    assert COLUMNS[0] == "EyeBlinkLeft" and COLUMNS[7] == "EyeBlinkRight" and COLUMNS[51] == "TongueOut"
    assert COLUMNS[52:] == ("HeadYaw", "HeadPitch", "HeadRoll", "LeftEyeYaw", "LeftEyePitch", "LeftEyeRoll", "RightEyeYaw", "RightEyePitch", "RightEyeRoll")  # fmt: skip


def test_the_rate_is_measured_where_the_time_code_drifts(path: Path) -> None:
    """The data folder's README: steps of about 1.002 frames."""
    frames = np.arange(400) * 1.002 + 17
    scene, motion = loaded(path, take(frames, wave(frames)))
    assert motion.rate_hz == pytest.approx(60 / 1.002, rel=1e-5)
    assert motion.morph_names == tuple(n[:1].lower() + n[1:] for n in COLUMNS) and motion.joint_names == ()
    assert np.allclose(motion.morph_weights, wave(frames), atol=1e-9)
    assert any("1.002 frames" in note and "59.88" in note for note in scene.notes)
    rows = list(csv.DictReader(path.open()))  # another reader of the same file
    assert np.allclose(
        [float(r["JawOpen"]) for r in rows], np.asarray(motion.morph_weights)[:, motion.morph_names.index("jawOpen")]
    )


def test_exact_frames_are_60_hz_and_midnight_passes(path: Path) -> None:
    frames = np.arange(300.0)
    scene, motion = loaded(path, take(frames, wave(frames), start_s=86397))
    assert motion.rate_hz == 60 and scene.notes == () and motion.frame_count == 300


def test_frames_that_were_not_recorded_are_filled(path: Path) -> None:
    frames = np.delete(np.arange(200.0), [50, 51, 52, 120])
    scene, motion = loaded(path, take(frames, wave(frames)))
    assert motion.frame_count == 200 and motion.rate_hz == 60
    assert any("196 frames became 200" in note for note in scene.notes)
    assert np.abs(np.asarray(motion.morph_weights) - wave(np.arange(200.0))).max() < 1e-3  # straight lines over a wave
    kept = frames.astype(int)
    assert np.abs(np.asarray(motion.morph_weights)[kept] - wave(frames)).max() < 1e-9


def test_frames_without_a_face_keep_what_was_there(path: Path) -> None:
    frames = np.arange(5.0)
    lines = take(frames, wave(frames)).splitlines()
    lines[1] = f"{timecode(0)},0" + "," * 61
    lines[4] = f"{timecode(3)},0"
    scene, motion = loaded(path, "\n".join(lines))
    expected = wave(np.array([1.0, 1.0, 2.0, 2.0, 4.0]))
    assert np.allclose(motion.morph_weights, expected, atol=1e-9)
    assert any("2 of 5 frames lack values" in note for note in scene.notes)


def test_the_words_give_what_the_block_gives(path: Path) -> None:
    frames = np.arange(20.0)
    text = take(frames, wave(frames))
    reference = loaded(path, text)[1]
    for other in (
        text.replace("\n", "\r\n"),
        text.replace(",61,", ", 61 ,", 1),
        "\ufeff" + text,
        text.rstrip("\n"),
        text + "\n\n",
    ):
        motion = loaded(path, other)[1]
        assert np.array_equal(motion.morph_weights, reference.morph_weights) and motion.rate_hz == reference.rate_hz


def test_other_rates_and_columns(path: Path) -> None:
    lines = ["timecode, blendshapecount, JawOpen, Surprise"]
    lines += [f"00:00:{k // 30:02}:{k % 30:02}.000,2,{k / 100},0.5" for k in range(90)]
    scene, motion = loaded(path, "\n".join(lines))
    assert motion.rate_hz == 30 and motion.morph_names == ("jawOpen", "surprise")
    assert any("counts 30 frames" in note for note in scene.notes) and any(
        "60 of the usual 61" in note for note in scene.notes
    )
    assert loaded(path, "\n".join(lines), timecode_rate_hz=60.0)[1].rate_hz != 30
    with pytest.raises(ShapeError):
        keypose.io.load(path, timecode_rate_hz=0.0)


def test_time_codes_that_go_back_are_noted(path: Path) -> None:
    frames = np.array([0.0, 1, 2, 1, 4])
    scene, motion = loaded(path, take(frames, wave(frames)))
    assert motion.frame_count == 5 and motion.rate_hz == 60 and any("line 5" in note for note in scene.notes)


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda t: t.replace("Timecode", "Time"), "line 1"),
        (lambda t: t.replace("EyeBlinkRight", "EyeBlinkLeft"), "line 1"),
        (lambda t: t.replace(timecode(2), "noon"), "line 4"),
        (lambda t: t.replace(timecode(2), "13:61:00:00.0"), "line 4"),
        (lambda t: t.replace(timecode(3) + ",61,0", timecode(3) + ",61,nan"), "line 5"),
        (lambda t: t.replace(timecode(3) + ",61,", timecode(3) + ",61,1,"), "line 5"),
        (lambda t: t.splitlines()[0], "end of file"),
        (lambda t: t + "\0", "byte"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_its_line(path: Path, change: object, place: str) -> None:
    frames = np.arange(5.0)
    path.write_text(change(take(frames, wave(frames))))  # type: ignore[operator]
    with pytest.raises(FormatError) as error:
        keypose.io.load(path)
    assert place in error.value.where


def test_what_is_written_is_read_again(path: Path, tmp_path: Path) -> None:
    frames = np.arange(100) * 1.002
    scene, motion = loaded(path, take(frames, wave(frames)))
    assert keypose.io.save(scene, tmp_path / "copy.csv") == ()
    again = keypose.io.load(tmp_path / "copy.csv")
    copy = again.animations[0]
    assert isinstance(copy, Motion)
    assert copy.rate_hz == pytest.approx(motion.rate_hz, rel=1e-5) and copy.morph_names == motion.morph_names
    assert np.abs(np.asarray(copy.morph_weights) - np.asarray(motion.morph_weights)).max() < 1e-9
    assert (tmp_path / "copy.csv").read_text().splitlines()[1].split(",")[0] == timecode(0)


def test_clips_are_sampled_and_what_has_no_column_is_told(tmp_path: Path) -> None:
    curve = Curve([0.0, 1.0], [[0.0], [1.0]], kind=CurveKind.SCALAR)
    clip = Clip({Channel("jawOpen", Property.WEIGHT): curve, Channel("wink", Property.WEIGHT): curve}, "talk")
    notes = keypose.io.save(clip, tmp_path / "talk.csv", rate_hz=30.0)
    assert any("wink" in note for note in notes)
    motion = keypose.io.load(tmp_path / "talk.csv").animations[0]
    assert isinstance(motion, Motion) and motion.rate_hz == 30 and motion.frame_count == 31
    jaw = np.asarray(motion.morph_weights)[:, motion.morph_names.index("jawOpen")]
    assert np.allclose(jaw, np.arange(31) / 30, atol=1e-9) and np.asarray(motion.morph_weights).sum() == pytest.approx(
        jaw.sum()
    )
    with pytest.raises(FormatError, match="no animation drives"):
        keypose.io.save(Clip({}), tmp_path / "nothing.csv")


def test_a_thousand_damaged_files(tmp_path: Path) -> None:
    files = []
    for number, frames in enumerate((np.arange(30) * 1.002, np.delete(np.arange(60.0), [5, 6]))):
        files.append(tmp_path / f"take{number}.csv")
        files[-1].write_text(take(frames, wave(frames)))
    result = load_damaged(files, 1000, tmp_path)
    assert result["wrong"] == []
    assert result["slowest_s"] < 3, result["slowest"]
    assert result["peak_mib"] < 1024
    assert result["loaded"] > 50 and result["refused"] > 200


def test_the_page() -> None:
    result = doctest.testfile(str(ROOT / "docs/formats/livelink.md"), module_relative=False, encoding="utf-8")
    assert result.attempted and not result.failed


@pytest.mark.parametrize("flood", [",", "a,", "\n", "0,", "00:00:00:00.0,61,\n", ":"])
def test_floods_of_one_thing(path: Path, flood: str) -> None:
    """Half a megabyte of the same in the header and after it: no quadratic time."""
    import time

    for text in (HEADER + flood * (500_000 // len(flood)) + "\n", HEADER + "\n" + flood * (500_000 // len(flood))):
        path.write_text(text)
        start = time.process_time()
        try:
            keypose.io.load(path)
        except FormatError as error:
            assert len(str(error)) < 600
        assert time.process_time() - start < 5
