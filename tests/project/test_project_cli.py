"""Projects on the command line: a format like any other, and what the studio refuses to start with."""

from __future__ import annotations

import json
import shutil
import struct
from pathlib import Path

import pytest
from typer.testing import CliRunner

from keypose import io
from keypose.cli.app import app
from keypose.errors import FormatError, KeyposeError, ShapeError
from keypose.studio import serve
from tests.project.test_project_file import GOLDEN, rewritten


def run(*arguments: str) -> str:
    result = CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_info_says_what_a_project_holds() -> None:
    text = run("info", str(GOLDEN))
    for line in (
        "project golden (version 1)",
        "clip everything: 7 curves, 21 keys",
        "timeline tube: 2 layers, 2 placed clips, -1 to 4 s at 25 Hz, moves tube",
        "1 pose: fist",
    ):
        assert line in text
    facts = json.loads(run("info", str(GOLDEN), "--json"))
    assert (facts["format"], facts["joints"], facts["clips"][0]["frames"]) == ("keypose", 3, 126)
    assert facts["project"]["clips"][1] == {"name": "everything", "curves": 7, "keys": 21}


def test_convert_goes_both_ways(tmp_path: Path) -> None:
    out, back = tmp_path / "out.glb", tmp_path / "back.keypose"
    run("convert", str(GOLDEN), str(out))
    assert io.load(out).animations[0].duration_s == pytest.approx(5.0)
    run("convert", "sample:wave", str(back), "--strict")
    assert [a.name for a in io.load(back).animations] == ["wave"]


def test_a_newer_file_says_what_it_needs(tmp_path: Path) -> None:
    path = tmp_path / "new.keypose"
    path.write_bytes(rewritten(GOLDEN.read_bytes(), lambda fields: fields.update(version=99)))
    with pytest.raises(FormatError, match=r"new\.keypose: version: made by a newer keypose"):
        io.load(path)


def test_the_studio_opens_one_project_and_says_before_it_starts_what_is_wrong(tmp_path: Path) -> None:
    one, two = tmp_path / "one.keypose", tmp_path / "two.keypose"
    shutil.copy(GOLDEN, one)
    two.write_bytes(struct.pack("<Q", 10) + b"{}")

    def never(_: str) -> None:
        pytest.fail("it must not listen")

    with pytest.raises(ShapeError, match="only one project can be open"):
        serve([str(one), str(one)], open_browser=False, ready=never)
    with pytest.raises(KeyposeError, match=r"two\.keypose"):
        serve([str(two)], open_browser=False, ready=never)
