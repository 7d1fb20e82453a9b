"""Real C3D files: facts measured by other tools, other readers' numbers, and round trips that lose nothing."""

from __future__ import annotations

import itertools
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import keypose.io
from keypose.errors import FormatError
from keypose.io.c3d_data import Kept
from keypose.math import quat
from keypose.model import Scene
from tests.io.c3d_files import differences

pytestmark = pytest.mark.data

_ROW = re.compile(
    r"^\| `((?:c3d|cmu_01_01)/[^`]*\.c3d)` \| \d+ .*?\| (?:PC|DEC|SGI) (?:int|real), (\d+) points, frames (\d+)-(\d+) \((\d+)\), ([\d.]+) Hz, "
    r"analog (\d+)/frame \(x(\d+)\), scale ([-\d.]+), .*?; ezc3d 1.7.2 (?:reads: .*? units (\w+), ([\d.]+)% missing, labels e.g. (.*?)|fails: .*?)(?:; maker .*?)? \|$",
    re.MULTILINE | re.IGNORECASE,
)
_SIX = [f"c3d/c3d_org_sample01/Eb015{name}.c3d" for name in ("pi", "pr", "vi", "vr", "si", "sr")]
# ezc3d takes the fourth word 65535 of the first two for "seen"; the points are 0, 0, 0 there. In the third it reads the
# analog values as points, for ANALOG:RATE is missing.
_EZC3D_WRONG = ("FunctionalLHip", "FunctionalStatic", "type1")
_Y_UP = ("MotionMonitor", "type1", "ndi_optotrak")


@pytest.fixture(scope="module")
def rows(data_dir: Path) -> dict[str, tuple[str, ...]]:
    """The README's facts by file."""
    return {row[0]: row[1:] for row in _ROW.findall((data_dir / "README.md").read_text())}


@pytest.fixture(scope="module")
def scenes(data_dir: Path, rows: dict[str, Any]) -> dict[str, Scene]:
    """Every file, loaded without options."""
    return {name: keypose.io.load(data_dir / name) for name in rows}


def all_names(scene: Scene) -> list[str]:
    kept: Kept = scene.extras["c3d"]
    return [name for name, _ in kept.points]


def test_the_table_names_every_file(data_dir: Path, rows: dict[str, Any]) -> None:
    files = {str(p.relative_to(data_dir)) for p in data_dir.glob("c3d/**/*") if p.suffix.lower() == ".c3d"}
    assert files - set(rows) == {"c3d/misc/Empty.c3d"} and len(files) == 35
    assert "cmu_01_01/01_01.c3d" in rows
    with pytest.raises(FormatError, match=r"Empty\.c3d.*empty"):
        keypose.io.load(data_dir / "c3d/misc/Empty.c3d")


def test_facts_measured_by_other_tools(rows: dict[str, Any], scenes: dict[str, Scene]) -> None:
    for name, (points, first, last, frames, rate, analog, samples, _scale, units, missing, labels) in rows.items():
        scene = scenes[name]
        markers = scene.markers[0]
        assert len(all_names(scene)) == int(points), name
        assert (markers.start_frame, markers.frame_count) == (int(first), int(frames)), name
        assert markers.start_frame + markers.frame_count - 1 == int(last), name
        assert markers.rate_hz == pytest.approx(float(rate), rel=1e-5), name
        channels = next((s for s in scene.signals if s.kind == "analog"), None)
        if int(analog) and "MotionMonitor" not in name:  # there the header counts the channels only
            assert channels is not None and channels.values.shape[1] * int(samples) == int(analog), name
            assert len(channels.values) == int(frames) * int(samples), name
            assert channels.rate_hz == pytest.approx(markers.rate_hz * int(samples)), name
        else:
            assert (channels is None) == (int(analog) == 0), name
        if units:
            assert scene.unit_m == (1.0 if units.startswith("m") and units != "mm" else 0.001), name
            seen = int(markers.visible.sum()) + sum(
                int(np.isfinite(s.values[..., 0]).sum()) for s in scene.signals if s.values.ndim == 3
            )
            share = 100 * (1 - seen / (int(points) * int(frames)))
            if not any(odd in name for odd in _EZC3D_WRONG):
                assert share == pytest.approx(float(missing), abs=0.051), name
            shown = [label for label in labels.split() if label]
            raw = [label for _, label in scene.extras["c3d"].points if label]
            assert raw[: len(shown)] == shown or " " in "".join(raw[:4]), name


def test_up_axis_and_size(scenes: dict[str, Scene]) -> None:
    for name, scene in scenes.items():
        assert scene.up == ("Y" if any(part in name for part in _Y_UP) and "propulsion" not in name else scene.up)
        assert scene.up in ("Z", "Y"), name
        markers = scene.markers[0]
        lowest, highest = np.nanpercentile(markers.positions[..., 1], (1, 99))
        assert -0.5 < lowest < 0.7 or "Dance" in name or "propulsion" in name, name
        assert 0.2 < highest < 2.3, name


def test_malformed_parameters_are_told(scenes: dict[str, Scene]) -> None:
    told = " ".join(scenes["c3d/c3d_org_sample18/bad_parameter_section.c3d"].notes)
    assert "byte 5572" in told and "EVENT:LABELS" in told
    told = " ".join(scenes["c3d/misc/badParameterOffset.c3d"].notes)
    assert "byte 1288" in told and "ANALOG:UNITS" in told


def test_six_encodings_of_one_trial_agree(scenes: dict[str, Scene]) -> None:
    first = scenes[_SIX[0]]
    for name in _SIX[1:]:
        other = scenes[name]
        assert differences(first, other) == [], name
        apart = np.nanmax(np.abs(first.markers[0].positions - other.markers[0].positions))
        # 1e-4 mm and a little: floats of 2 m hold their multiple of the integers' scale to 1.2e-4 mm
        assert apart < 1.1e-7, name
        assert other.extras["events"] == first.extras["events"]
    exact = [scenes[name] for name in _SIX if name.endswith("r.c3d")]
    for other in exact[1:]:
        assert np.array_equal(exact[0].markers[0].positions, other.markers[0].positions, equal_nan=True)
    for name in ("TESTA", "TESTB", "TESTC", "TESTD"):
        assert differences(first, scenes[f"c3d/c3d_org_sample08/{name}PI.c3d"]) == []
    plain, whole = (scenes[f"c3d/misc/ADemo1_rewrite_c3d_pc_{kind}.c3d"] for kind in ("float", "integer"))
    assert np.nanmax(np.abs(plain.markers[0].positions - whole.markers[0].positions)) < 0.5e-4 + 1e-7  # half its scale


def test_ezc3d_reads_the_same(data_dir: Path, rows: dict[str, Any]) -> None:
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is not installed")
    compared = 0
    for name, facts in rows.items():
        if (not facts[8] and "Gait" not in name) or any(odd in name for odd in _EZC3D_WRONG):
            continue
        theirs = ezc3d.c3d(str(data_dir / name))["data"]
        ours = keypose.io.load(data_dir / name, unit="m", up="Y")  # so that numbers stay as they are
        columns = [all_names(ours).index(n) for n in ours.markers[0].names]
        points = theirs["points"][:3].transpose(2, 1, 0)
        np.testing.assert_allclose(ours.markers[0].positions, points[:, columns], rtol=1e-6, atol=1e-4, err_msg=name)
        for signals in ours.signals:
            if signals.kind == "analog":
                np.testing.assert_allclose(signals.values, theirs["analogs"][0].T, rtol=1e-9, atol=1e-9, err_msg=name)
            else:
                columns = [all_names(ours).index(n) for n in signals.names]
                np.testing.assert_allclose(signals.values, points[:, columns], rtol=1e-6, atol=1e-4, err_msg=name)
        compared += 1
    assert compared >= 26


def test_the_c3d_package_reads_the_same(data_dir: Path, rows: dict[str, Any]) -> None:
    """It is the judge of residuals: ezc3d takes the byte of the cameras for them."""
    c3d = pytest.importorskip("c3d", reason="the package c3d is not installed")
    compared = 0
    for name in rows:
        ours = keypose.io.load(data_dir / name, unit="m", up="Y")
        try:
            with (data_dir / name).open("rb") as file, warnings.catch_warnings():
                warnings.simplefilter("ignore")
                frames = [points.copy() for _, points, _ in c3d.Reader(file).read_frames()]
        except Exception:  # it refuses a good part of them
            continue
        markers = ours.markers[0]
        if len(frames) != markers.frame_count:
            continue  # it reads one frame too many where the first one has number 0
        columns = [all_names(ours).index(n) for n in markers.names]
        points = np.array(frames)[:, columns]
        seen = np.isfinite(markers.positions).all(axis=-1)
        scale = 1.0 if abs(points[seen][:, :3]).max() else 0.0
        np.testing.assert_allclose(
            markers.positions[seen], scale * points[seen][:, :3], rtol=1e-6, atol=1e-4, err_msg=name
        )
        if markers.residuals is not None and not any(odd in name for odd in _EZC3D_WRONG):
            np.testing.assert_allclose(markers.residuals[seen], points[seen][:, 3], rtol=1e-4, atol=1e-5, err_msg=name)
        compared += 1
    assert compared >= 15


def test_walking2_as_opensim_reads_it(data_dir: Path) -> None:
    """Every tenth frame, written by OpenSim with its own axes."""
    lines = (data_dir / "c3d/opensim/std_walking2_markers.trc").read_text().splitlines()
    names = [word for word in lines[3].split("\t")[2:] if word.strip()]
    rows = [
        [float(cell) if cell.strip() else np.nan for cell in line.split("\t")] for line in lines[5:] if line.strip()
    ]
    width = 2 + 3 * len(names)
    table = np.array([(row + [np.nan] * width)[:width] for row in rows])[:, 2:].reshape(-1, len(names), 3)
    ours = keypose.io.load(data_dir / "c3d/opensim/walking2.c3d", unit="m", up="Y").markers[0]
    columns = [ours.index(name) for name in names]
    mine = ours.positions[::10][:, columns]
    table = table[: len(mine)]  # its last row lies behind the end of the trial
    both = np.isfinite(mine) & np.isfinite(table)
    assert both.sum() > 0.4 * table.size
    assert np.abs(mine - table)[both].max() < 0.051


def test_nexus_csv(data_dir: Path) -> None:
    """The same trajectories exported by the software that wrote the file."""
    lines = (data_dir / "c3d/pyomeca/markers.csv").read_text(encoding="utf-8-sig").splitlines()
    names = [word.strip() for word in lines[2].split(",") if word.strip()]
    rows = [line.split(",") for line in lines[5:] if line.strip()]
    ours = keypose.io.load(data_dir / "c3d/pyomeca/markers_analogs.c3d", unit="m", up="Y").markers[0]
    width = 2 + 3 * len(names)
    table = np.array([[float(c) if c.strip() else np.nan for c in (row + [""] * width)[:width]] for row in rows])
    values = table[:, 2:].reshape(len(table), len(names), 3)
    columns = [ours.index(name) for name in names]
    frames = table[:, 0].astype(int) - ours.start_frame
    inside = frames < ours.frame_count
    mine = ours.positions[frames[inside]][:, columns]
    both = np.isfinite(mine) & np.isfinite(values[inside])
    assert both.mean() > 0.9
    assert np.abs(mine - values[inside])[both].max() < 1e-2


@pytest.mark.parametrize("name", ["01_01.bvh", "01_01.amc"])  # the first frame of the BVH is a T pose
def test_cmu_markers_around_the_skeleton(name: str, data_dir: Path, scenes: dict[str, Scene]) -> None:
    """The README: from the root to the mean of four waist markers it is 0.2 to 45 mm, in the middle 24 mm."""
    from keypose.evaluate import world

    markers = scenes["cmu_01_01/01_01.c3d"].markers[0]
    waist = markers.positions[:, [markers.index(n) for n in ("LBWT", "RBWT", "LFWT", "RFWT")]].mean(axis=1)
    # the lab's X is to the right in the C3D file, the skeleton's Z: a quarter turn about the vertical
    quarter = np.array((np.sqrt(0.5), 0, -np.sqrt(0.5), 0))
    options = {"unit": "cmu", "up": "Y"} if name.endswith("bvh") else {}
    take = keypose.io.load(data_dir / "cmu_01_01" / name, **options)
    root = np.asarray(world(take.character.skeleton, take.animation().pose))[-2751:, 0, :3, 3]
    apart = np.linalg.norm(quat.rotate(quarter, waist) - root, axis=-1)
    apart = apart[np.isfinite(apart)]
    assert len(apart) > 2600
    assert 0.0001 < apart.min() < 0.0004 and 0.044 < apart.max() < 0.046
    assert np.median(apart) == pytest.approx(0.024, abs=0.001)


def test_events_lie_within_their_trial(scenes: dict[str, Scene]) -> None:
    for name in ("c3d/vicon_pig/PiG_Motion3_FF.c3d", "c3d/functional_calibration/FunctionalWalk.c3d"):
        scene = scenes[name]
        events = scene.extras["events"]
        assert len(events) in (11, 12)
        assert all(-0.01 <= event["time_s"] <= scene.markers[0].duration_s + 0.01 for event in events), name
        assert {event["context"] for event in events} == {"Left", "Right"}
        # a foot strikes and leaves the ground in turn
        left = [event["name"] for event in events if event["context"] == "Left"]
        assert all(a != b for a, b in itertools.pairwise(left)), name


def test_angles_and_forces_are_no_markers(scenes: dict[str, Scene]) -> None:
    scene = scenes["c3d/vicon_pig/PiG_Motion3_FF.c3d"]
    kinds = {s.kind: s for s in scene.signals}
    assert set(kinds) == {"angle", "force", "moment", "power", "analog"}
    assert kinds["angle"].units[0] == "deg" and kinds["moment"].units[0] == "Nmm"
    assert "LHipAnglesV" not in scene.markers[0].names and "LASI" in scene.markers[0].names
    with np.errstate(all="ignore"):
        assert np.nanmax(np.abs(kinds["angle"].values)) < 360


def test_force_plates_lie_on_the_floor(scenes: dict[str, Scene]) -> None:
    counted = 0
    for name, scene in scenes.items():
        for plate in scene.plates:
            assert np.ptp(plate.corners[:, 1]) < 0.05, name
            sides = np.linalg.norm(plate.corners - np.roll(plate.corners, 1, axis=0), axis=-1)
            assert sides.min() > 0.3 and sides.max() < 1.3, name
            counted += 1
    assert counted > 30
    # the same data twice, once with the whole calibration matrix
    two, four = (scenes[f"c3d/c3d_org_sample10/TYPE-{k}.C3D"].plates[0] for k in (2, 4))
    assert two.kind == 2 and four.kind == 4 and four.calibration is not None
    # rows are forces and moments: the diagonal outweighs the rest of its row
    assert np.argmax(np.abs(four.calibration[:3]), axis=1).tolist() == [0, 1, 2]
    assert four.channels == ("FX1", "FY1", "FZ1", "MX1", "MY1", "MZ1")


def test_every_file_comes_back_the_same(scenes: dict[str, Scene], tmp_path: Path) -> None:
    target = tmp_path / "again.c3d"
    for name, scene in scenes.items():
        assert keypose.io.save(scene, target) == (), name
        again = keypose.io.load(target)
        assert differences(scene, again) == [], name
        assert (again.unit_m, again.up) == (scene.unit_m, scene.up), name
        assert again.extras.get("events") == scene.extras.get("events"), name
        if scene.extras["c3d"].header.scale < 0:  # floats keep every bit
            assert np.array_equal(scene.markers[0].positions, again.markers[0].positions, equal_nan=True), name
        header, other = scene.extras["c3d"].header, again.extras["c3d"].header
        assert (header.gap, header.events, header.rate_hz) == (other.gap, other.events, other.rate_hz), name
        lost = parameters_lost(scene, again)
        cut = any("POINT:UNITS is" in note for note in scene.notes)  # a word cut short is written whole
        assert lost <= ({"POINT:UNITS"} if cut else set()) | {
            "POINT:SCALE",
            "POINT:DATA_START",
            "POINT:FRAMES",
            "ANALOG:RATE",
            "ANALOG:SCALE",
            "ANALOG:OFFSET",
        }, name


def parameters_lost(scene: Scene, again: Scene) -> set[str]:
    """Parameters with other values, dimensions, descriptions or locks than before."""
    lost: set[str] = set()
    for group, old in scene.extras["c3d"].groups.items():
        new = again.extras["c3d"].groups[group]
        assert (old.description, old.locked) == (new.description, new.locked)
        for name, parameter in old.parameters.items():
            other = new.parameters[name]
            same = (parameter.kind, parameter.dims, parameter.description, parameter.locked) == (
                other.kind, other.dims, other.description, other.locked,
            )  # fmt: skip
            if not same or not np.array_equal(
                np.asarray(parameter.values), np.asarray(other.values), equal_nan=parameter.kind == "float"
            ):
                lost.add(f"{group}:{name}")
    return lost


def test_what_is_written_is_read_by_others(scenes: dict[str, Scene], tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is not installed")
    c3d = pytest.importorskip("c3d", reason="the package c3d is not installed")
    target = tmp_path / "out.c3d"
    for name, scene in scenes.items():
        keypose.io.save(scene, target)
        markers = keypose.io.load(target, unit="m", up="Y").markers[0]
        columns = [all_names(scene).index(n) for n in markers.names]
        points = ezc3d.c3d(str(target))["data"]["points"][:3].transpose(2, 1, 0)[:, columns]
        assert np.array_equal(points, markers.positions, equal_nan=True), name
        with target.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            frames = np.array([p.copy() for _, p, _ in c3d.Reader(file).read_frames()])[:, columns]
        if len(frames) == markers.frame_count:
            seen = markers.visible
            np.testing.assert_array_equal(
                frames[seen][:, :3], markers.positions[seen].astype(frames.dtype), err_msg=name
            )
            assert (frames[..., 3] >= 0)[seen].all() and (frames[..., 3] < 0)[~seen].all(), name
        else:
            assert markers.start_frame == 0, name
