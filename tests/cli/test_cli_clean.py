"""`keypose clean` and `keypose check --quality` as a user meets them."""

from __future__ import annotations

import csv
import json
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from keypose import io
from keypose.evaluate import to_motion
from keypose.model import Motion
from tests.cli.command import keypose, process, refused


def test_clean_writes_says_and_a_second_time_changes_nothing(tmp_path: Path) -> None:
    first = process("clean", "sample:walk", tmp_path / "a.glb", "--contacts", tmp_path / "a.json", "--floor", "0")
    assert first.returncode == 0, first.stderr
    assert "feet in contact slide" in first.stdout and "ground: level" in first.stdout
    second = keypose("clean", tmp_path / "a.glb", tmp_path / "b.glb", "--contacts", tmp_path / "b.csv")
    assert "nothing was changed" in second.stdout
    facts = json.loads((tmp_path / "a.json").read_text())
    assert facts["schema"] == "keypose.contacts/1" and facts["frames"] == 125
    with (tmp_path / "b.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [r["point"] for r in rows] == [c["point"] for c in facts["contacts"]]
    assert [int(r["first"]) for r in rows] == [c["first"] for c in facts["contacts"]]


def test_the_figures_are_one_object_for_programs(tmp_path: Path) -> None:
    contacts = tmp_path / "a.json"
    done = keypose("clean", "sample:run", tmp_path / "a.glb", "--contacts", contacts, "--json")
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    listed = json.loads(contacts.read_text())
    assert facts["schema"] == "keypose.clean/1" and facts["frames"] == listed["frames"]
    assert facts["contacts"] == len(listed["contacts"]) and facts["ground"] == listed["ground"]
    assert facts["after"]["skate_cm_s"] <= facts["before"]["skate_cm_s"] + 1e-9 and facts["settled"]


def test_a_face_goes_on_moving_where_the_file_holds_keys(tmp_path: Path) -> None:
    take = tmp_path / "take.glb"
    assert keypose("convert", "sample:walk", take, "-q").returncode == 0
    moved = weights_of(take)
    assert moved
    for verb, *asked in (("clean",), ("edit", "--bend", 20), ("retarget", "--to", "sample:human")):
        out = tmp_path / f"{verb}.glb"
        done = keypose(verb, take, out, *asked, "-q")
        assert done.returncode == 0, done.stderr
        made = weights_of(out)
        assert made.keys() == moved.keys()
        assert all(np.abs(made[name] - moved[name]).max() < 1e-6 for name in moved)


def weights_of(path: Path) -> dict[str, np.ndarray]:
    """The weights of morphs at 60 Hz."""
    scene = io.load(path)
    motion = to_motion(scene.animations[0], scene.character.skeleton, 60.0)
    return {name: np.asarray(motion.morph_weights)[:, n] for n, name in enumerate(motion.morph_names)}


def test_clean_writes_contacts_as_events(tmp_path: Path) -> None:
    done = keypose("clean", "sample:run", tmp_path / "a.npz", "--events", "-q")
    assert done.returncode == 0 and done.stdout == "", done.stderr
    animation = io.load(tmp_path / "a.npz").animations[0]
    assert isinstance(animation, Motion)
    assert {"left_ball.down", "left_ball.up"} <= {e.name for e in animation.events}


def test_clean_refuses_what_it_cannot_do(tmp_path: Path) -> None:
    assert "hill" in refused(keypose("clean", "sample:walk", tmp_path / "a.glb", "--ground", "hill"))
    assert "no motion of a skeleton" in refused(keypose("clean", "sample:ball", tmp_path / "a.glb"))
    binary = tmp_path / "map.json"
    binary.write_bytes(b"\xae\xff")
    assert "no text" in refused(keypose("clean", "sample:walk", tmp_path / "a.glb", "--roles", binary))
    binary.write_text('{"left_foot": ["LeftFoot"]}')
    assert "no joint" in refused(keypose("clean", "sample:walk", tmp_path / "a.glb", "--roles", binary))
    nowhere = tmp_path / "nowhere" / "c.csv"
    assert "nowhere" in refused(keypose("clean", "sample:walk", tmp_path / "a.glb", "--contacts", nowhere))
    assert "--floor" in refused(keypose("clean", "sample:walk", tmp_path / "a.glb", "--floor", "inf"))
    assert ".csv" in refused(keypose("clean", "sample:walk", tmp_path / "a.glb", "--contacts", tmp_path / "c.txt"))
    assert not (tmp_path / "a.glb").exists()


def test_check_fails_on_demands_and_draws(tmp_path: Path) -> None:
    plot = tmp_path / "q.png"
    good = keypose("check", "sample:walk", "--fail-on", "skate>5,sink>3,contact<0.5", "--plot", plot)
    assert good.returncode == 0, good.stdout + good.stderr
    assert np.array(Image.open(plot)).shape[1] == 1400
    bad = process("check", "sample:walk", "--fail-on", "jerk>1", "--json")
    assert bad.returncode == 1
    facts = json.loads(bad.stdout)
    assert facts["schema"] == "keypose.quality/1" and "jerk" in facts["quality"][0]["failed"][0]
    limits = tmp_path / "limits.toml"
    limits.write_text("jerk = 1.0\n")
    again = keypose("check", "sample:walk", "--fail-on", limits)
    assert again.returncode == 1 and "failed" in again.stdout
    assert "skate" in refused(keypose("check", "sample:walk", "--fail-on", "skating>1"))
    assert ".png" in refused(keypose("check", "sample:walk", "--plot", tmp_path / "q.jpg"))


@pytest.mark.data
def test_a_take_beside_one_of_another_skeleton(data_dir: Path) -> None:
    done = keypose(
        "check",
        data_dir / "asf_amc/cmu_02/02_01.amc",
        "--json",
        "--against",
        data_dir / "bvh/cmu_iclone_002/002_01.bvh",
    )
    assert done.returncode == 0, done.stderr
    direction = json.loads(done.stdout)["quality"][0]["direction"]
    assert direction["direction_deg"]["arms"] < 2.0 and direction["mean_direction_deg"] < 8.0


@pytest.mark.parametrize(
    ("words", "label"),
    [
        (("clean", "sample:walk", "{0}/out.bvh"), "planting feet"),
        (("retarget", "sample:walk", "{0}/out.glb", "--to", "sample:human"), "retargeting"),
        (("rig", "sample:human", "{0}/out.keypose", "--motion", "sample:walk"), "fitting controls"),
    ],
)
def test_a_terminal_sees_progress_and_nobody_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], label: str
) -> None:
    from typer.testing import CliRunner

    from keypose.cli import console
    from keypose.cli.app import app

    shown: dict[str, list[tuple[int, int]]] = {}
    quietly: list[bool] = []

    @contextmanager
    def watched(label: str, *, quiet: bool = False) -> Generator[console.Progress]:
        quietly.append(quiet)
        yield lambda done, total: shown.setdefault(label, []).append((done, total))

    for verb in ("clean", "retarget", "rig"):
        monkeypatch.setattr(f"keypose.cli.{verb}.progress_bar", watched)
    line = [word.format(tmp_path) for word in words]
    for more in ([], ["-q"]):
        done = CliRunner().invoke(app, [*line, *more], catch_exceptions=False)
        assert done.exit_code == 0, done.output
    assert quietly == [False, True]
    calls = shown[label][: len(shown[label]) // 2]
    shares = [done / total for done, total in calls]
    assert len(calls) > 3 and shares == sorted(shares) and shares[-1] == 1.0
