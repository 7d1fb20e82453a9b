"""Options of formats on the command line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from typer.testing import CliRunner

from keypose import io, samples
from keypose.cli.app import app
from keypose.cli.options import choose, format_lines, parsed
from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.io import formats


def run(*words: str | Path) -> str:
    result = CliRunner().invoke(app, [str(w) for w in words])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("cm", str | float | None, "cm"), ("0.02", str | float | None, 0.02), ("none", str | float | None, None),
        ("8", int, 8), ("29.97", float | None, 29.97), ("Yes", bool, True), ("0", bool, False),
        ("AMASS", Literal["keypose", "amass"], "amass"), ("eyes, teeth", Sequence[str], ["eyes", "teeth"]),
        ("eyes", Sequence[str], ["eyes"]), ("a.obj,b.obj", str | Path | Sequence[str], ["a.obj", "b.obj"]),
        ("faces", str | Path | Sequence[str], "faces"), ("1=2", str, "1=2"),
    ],
)  # fmt: skip
def test_values_have_the_type_of_the_option(text: str, kind: object, value: object) -> None:
    assert parsed("x", text, kind) == value


@pytest.mark.parametrize(
    ("text", "kind", "message"),
    [
        ("many", int, "expected a whole number"), ("fast", float | None, "expected a number"), ("2", bool, "true or false"),
        ("amas", Literal["keypose", "amass"], "nearest: 'amass'"),
    ],
)  # fmt: skip
def test_wrong_values_are_refused(text: str, kind: object, message: str) -> None:
    with pytest.raises((ShapeError, UnknownName), match=message):
        parsed("x", text, kind)


def test_options_find_their_side(tmp_path: Path) -> None:
    take = tmp_path / "a.bvh"
    io.save(samples.load("walk"), take)
    chosen = choose(["truncated=keep", "decimals=4", "in.unit=cm", "out.unit=m"], [str(take)], tmp_path / "b.bvh")
    assert chosen.reading == ({"truncated": "keep", "unit": "cm"},) and chosen.writing == {"decimals": 4, "unit": "m"}
    with pytest.raises(ShapeError, match=r"in\.unit or out\.unit"):
        choose(["unit=cm"], [str(take)], tmp_path / "b.bvh")
    with pytest.raises(UnknownName, match="nearest: 'decimals'"):
        choose(["decimal=4"], [str(take)], tmp_path / "b.bvh")
    with pytest.raises(UnknownName, match="embed"):
        choose(["in.embed=true"], [str(take)], tmp_path / "b.glb")
    with pytest.raises(ShapeError, match="NAME=VALUE"):
        choose(["embed"], [str(take)], tmp_path / "b.glb")


def test_formats_are_listed_with_all_their_options() -> None:
    shown = run("convert", "--formats")
    lines = format_lines()
    assert [line[0] for line in lines] == [entry.name for entry in formats()]
    assert all(name in shown for name in ("makehuman", ".textgrid", "NAME=VALUE"))
    by_name = {line[0]: line for line in lines}
    assert (
        "pose_units=animation (morphs|both|none)" in by_name["makehuman"][2]
        and by_name["makehuman"][3] == "(read only)"
    )
    assert by_name["npz"][3] == "layout=keypose (amass)" and "decimals=none" in by_name["bvh"][3]


def test_layout_of_arrays(tmp_path: Path) -> None:
    run("convert", "sample:walk", tmp_path / "a.npz", "--option", "layout=keypose")
    assert "rotations" in " ".join(np.load(tmp_path / "a.npz").files)
    text = run("convert", "sample:walk", tmp_path / "b.bvh", "-o", "decimals=2", "-q")
    assert not text and max(map(len, (tmp_path / "b.bvh").read_text().split("Frame Time")[1].split()[5:])) < 9


def test_a_skeleton_that_is_named(tmp_path: Path) -> None:
    io.save(samples.load("walk"), tmp_path / "body.asf")
    io.save(samples.load("walk"), tmp_path / "take.amc")
    found = next(tmp_path.glob("*.asf"))
    moved = tmp_path / "other" / "rig.asf"
    moved.parent.mkdir()
    for path in tmp_path.glob("*.asf"):
        moved.write_bytes(path.read_bytes())
        path.unlink()
    assert found.name
    with pytest.raises(FormatError, match="--skeleton"):
        run("check", tmp_path / "take.amc")
    for verb in ("check", "info"):
        assert "60" in run(verb, tmp_path / "take.amc", "--skeleton", moved, "-o", "rate_hz=60")
    run("convert", tmp_path / "take.amc", tmp_path / "take.bvh", "--skeleton", moved)
    with pytest.raises(ShapeError, match="no reader"):
        run("info", "sample:walk", "--skeleton", moved)


@pytest.mark.data
def test_makehuman_with_targets_and_poses(data_dir: Path, tmp_path: Path) -> None:
    source = data_dir / "makehuman" / "default.mhskel"
    run("convert", source, tmp_path / "a.glb", "-o", "pose_units=morphs", "-o", "keep=eyes", "-q",
        "-o", f"targets={data_dir / 'makehuman/targets/mouth-open.target'}")  # fmt: skip
    character = io.load(tmp_path / "a.glb").character
    assert {part.name for part in character.parts} == {"body", "eyes"} and len(character.morph_names) > 10
    assert any("mouth-open" in name for name in character.morph_names)


def test_a_rate_for_formats_that_have_none(tmp_path: Path) -> None:
    run("convert", "sample:walk", tmp_path / "a.glb", "--rate", "24", "-q")
    clip = io.load(tmp_path / "a.glb").animations[0]
    assert clip.rate_hz == 24 or clip.duration_s == pytest.approx(round(clip.duration_s * 24) / 24)


def test_changes_between_reading_and_writing(tmp_path: Path) -> None:
    run("convert", "sample:human", tmp_path / "a.glb", "--scale", "2", "--turn", "90", "--raise", "0.5", "-q")
    shown = run("check", tmp_path / "a.glb")
    assert "faces +X" in shown and "3.4" in shown and "--turn -90" in shown


def test_large_scenes_have_limits_of_their_size(tmp_path: Path) -> None:
    words = ("convert", "sample:walk", tmp_path / "a.fbx", "--scale", "1000", "--strict", "-q")
    with pytest.raises(FormatError, match=r"within 0\.001 mm"):
        run(*words)
    run(*words, "--limit-relative", "1e-6", "--limit-deg", "1e-3")


def test_a_table_of_numbers_is_no_face(tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text("x,y\n1,2\n")
    with pytest.raises(FormatError, match=r"only takes of Live Link Face are understood.*'x,y'"):
        run("info", tmp_path / "table.csv")


def test_rig_takes_what_is_of_a_motion_only_with_one() -> None:
    for option, value in (("--rate", "30"), ("--clip", "Run")):
        done = CliRunner().invoke(app, ["rig", "sample:human", option, value])
        assert done.exit_code == 2 and option in done.output and "--motion" in done.output
