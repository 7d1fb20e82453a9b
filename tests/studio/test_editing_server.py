"""Editing a project over real sockets: pages without a browser."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from edit_page import EditPage, storing
from studio_scenes import Start, arm_scene, turn
from test_server import request, with_token
from tests.project.edits import random_commands

from keypose import evaluate, io
from keypose.errors import KeyposeError
from keypose.io import native_values as values
from keypose.model import Channel, Curve, CurveKind, Interpolation, Property
from keypose.project import commands as c
from keypose.project.file import from_bytes
from keypose.studio import StudioServer
from keypose.studio import edit_messages as messages
from keypose.studio.container import Body, pack
from keypose.studio.edit_wire import EDIT_LIMIT_BYTES, read_edit

sync = pytest.importorskip("websockets.sync.client")


@pytest.fixture(scope="module")
def server(start: Start) -> StudioServer:
    return start(("arm.glb", arm_scene()))


@contextmanager
def page(server: StudioServer) -> Iterator[EditPage]:
    with sync.connect(f"ws://127.0.0.1:{server.port}/api/events?token={server.token}", max_size=None) as socket:
        plain = EditPage(socket, server)
        plain.hello = plain.until("hello")
        plain.say("project_watch")
        plain.until("project_state")
        yield plain


def bezier(seed: int = 0) -> Curve:
    rng = np.random.default_rng(seed)
    return Curve(
        np.cumsum(rng.random(5)),
        rng.normal(size=(5, 1)),
        Interpolation.BEZIER,
        kind=CurveKind.SCALAR,
        in_handles=rng.random((5, 1, 2)) * [-1, 1],
        out_handles=rng.random((5, 1, 2)),
        tangent_types=rng.integers(0, 6, (5, 2)),
    )


def test_a_curve_survives_the_way_to_the_server_and_to_every_page(server: StudioServer) -> None:
    with page(server) as one, page(server) as two:
        one.say("project_new", name="Bits", character="", discard=True)
        one.until("project_state")
        two.until("project_state")
        channel, curve = Channel("Joint1", Property.TRANSLATION, 1), bezier()
        assert one.set_curves("arm", {channel: curve}, label="Key")["revision"] == 1
        for each in (one, two):
            changed = each.until("project_changed")
            assert (changed["label"], changed["edit"], changed["cause"]) == ("Key", "e", "edit")
            got = each.clips["arm"].curves[channel]
            for name in ("times_s", "values", "in_handles", "out_handles", "modes", "tangent_types"):
                assert np.array_equal(getattr(got, name), getattr(curve, name)), name
        two.say("project_undo")
        assert one.until("project_changed")["removed_clips"] == ["arm"]
        assert one.status["redo"] == "Key"


# ---- everything through the page's protocol ------------------------------------------------------------------------------


def exported(server: StudioServer, kind: str = "keypose", query: str = "") -> bytes:
    status, _, data = request(server, "GET", f"/api/project/export/{kind}{query}", headers=with_token(server))
    assert status == 200, data
    return data


def commands_of(commands: list[c.Command]) -> tuple[list[dict[str, Any]], Body]:
    body = Body()
    return [command.to_json(storing(body)) for command in commands], body


@pytest.mark.parametrize("seed", range(3))
def test_every_edit_made_through_a_page_can_be_undone_to_the_byte(server: StudioServer, seed: int) -> None:
    rng = np.random.default_rng([seed, 5])
    with page(server) as one:
        one.say("project_new", name="Random", character="s1", discard=True)
        one.until("project_state")
        seen = [exported(server)]
        for n in range(25):
            document = from_bytes(seen[-1])
            made, body = commands_of(random_commands(rng, document, page=True))
            answer = one.edit(*made, body=body, id=f"{n}", label=f"step {n}")
            assert not answer["error"]
            changed = one.until("project_changed")
            assert changed["status"]["revision"] == answer["revision"]
            seen.append(exported(server))
            assert one.matches(from_bytes(seen[-1]))
        at, revision = len(seen) - 1, one.status["revision"]
        for _ in range(60):
            back = rng.random() < 0.6
            if (back and at == 0) or (not back and at == len(seen) - 1):
                continue
            one.say("project_undo" if back else "project_redo")
            changed = one.until("project_changed")
            at += -1 if back else 1
            revision += 1
            assert (changed["cause"], changed["status"]["revision"]) == ("undo" if back else "redo", revision)
            assert exported(server) == seen[at]
            assert one.matches(from_bytes(seen[at]))
        while one.status["undo"]:
            one.say("project_undo")
            one.until("project_changed")
        assert exported(server) == seen[0]


def test_what_pages_are_sent_has_the_types_that_they_were_promised(server: StudioServer) -> None:
    with page(server) as one, page(server) as two:
        one.say("project_new", name="Types", character="s1", discard=True)
        one.until("project_state")
        for n in range(12):
            rng = np.random.default_rng(n)
            made, body = commands_of(random_commands(rng, from_bytes(exported(server)), page=True))
            assert not one.edit(*made, body=body)["error"]
            assert fits(one.until("project_changed"), messages.ProjectChanged)
        two.say("project_watch")
        assert fits(two.until("project_state"), messages.ProjectState)
        two.say("project_browse", folder="")
        assert fits(two.until("project_folder"), messages.ProjectFolder)


def fits(value: Any, hint: Any) -> bool:
    """Whether what came as JSON is what a message promises; says where it is not."""
    origin, arguments = get_origin(hint), get_args(hint)
    if dataclasses.is_dataclass(hint):
        hints = get_type_hints(hint)
        assert isinstance(value, dict), (hint, value)
        assert value.keys() == hints.keys(), (hint, value.keys() ^ hints.keys())
        return all(fits(value[name], each) for name, each in hints.items())
    if origin is Literal:
        assert value in arguments, (hint, value)
    elif origin is list:
        assert isinstance(value, list), (hint, value)
        assert all(fits(item, arguments[0]) for item in value)
    elif origin is dict:
        assert isinstance(value, dict), (hint, value)
        assert all(fits(item, arguments[1]) for item in value.values())
    elif origin is not None:
        assert any(quietly(value, each) for each in arguments), (hint, value)
    else:
        kinds = (int, float) if hint is float else hint
        assert isinstance(value, kinds), (hint, value)
    return True


def quietly(value: Any, hint: Any) -> bool:
    try:
        return fits(value, hint)
    except AssertionError:
        return False


# ---- what is refused -----------------------------------------------------------------------------------------------------

CURVE = {"target": "Joint1", "property": "translation", "component": 0, "kind": "scalar", "before": "hold", "after": "hold",
         "in_tangents": None, "out_tangents": None, "in_handles": None, "out_handles": None, "types": None}  # fmt: skip


def keyed(body: Body, **other: Any) -> dict[str, Any]:
    refs = {
        "times": dataclasses.asdict(body.add([0.0, 1.0], "float64")),
        "values": dataclasses.asdict(body.add([[0.0], [1.0]], "float64")),
        "modes": dataclasses.asdict(body.add([1, 1], "uint8")),
    }
    for name, change in other.items():
        if name in refs and isinstance(change, dict):
            refs[name] |= change
        elif name in refs:
            refs[name] = change
    curve = CURVE | refs | {k: v for k, v in other.items() if k not in refs}
    return {"kind": "set_curves", "clip": "arm", "curves": [curve], "removed": [], "euler_orders": {}}


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"times": {"shape": [3]}}, r"curves\[0\]\.times: 16 bytes for 3 numbers of 8 bytes"),
        ({"times": {"shape": [1 << 40, 1 << 40]}}, "16 bytes for"),
        ({"times": {"shape": []}}, "expected 1 to 3 dimensions, got 0"),
        ({"times": {"offset": 8000}}, "are beyond the"),
        ({"times": {"offset": -8}}, "expected 0 or more"),
        ({"times": {"element": "float32"}}, "expected float64, uint8, uint32, got 'float32'"),
        ({"times": None}, "times: expected an object"),
        ({"values": {"element": "uint8", "bytes": 2, "shape": [1, 2]}}, r"Joint1\.translation\.x: values: expected"),
        ({"kind": "colour"}, "kind: expected one of scalar, vector, rotation"),
        ({"property": "position"}, "property: expected one of translation"),
        ({"component": 3}, "component: expected 0 to 2, got 3"),
        ({"after": "bounce"}, "after: expected one of hold"),
        ({"target": 5}, "target: expected a text"),
    ],
)
def test_an_edit_that_does_not_fit_is_refused_by_its_place(
    server: StudioServer, change: dict[str, Any], what: str
) -> None:
    with page(server) as one:
        revision = one.status["revision"]
        body = Body()
        answer = one.edit(keyed(body, **change), body=body)
        assert re.search(what, answer["error"]), answer["error"]
        assert answer["revision"] == revision


@pytest.mark.parametrize(
    ("numbers", "what"),
    [
        ([0.0, np.nan], "expected finite numbers"),
        ([0.0, np.inf], "expected finite numbers"),
        ([1.0, 0.5], "key 1 at 0.5 s does not come after key 0"),
        ([1.0, 1.0], "key 1 at 1.0 s does not come after key 0"),
    ],
)
def test_times_that_are_none_are_refused(server: StudioServer, numbers: list[float], what: str) -> None:
    with page(server) as one:
        body = Body()
        command = keyed(body, times=dataclasses.asdict(body.add(numbers, "float64")))
        assert what in one.edit(command, body=body)["error"]


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"", "expected a container that starts with 'KPS1'"),
        (pack({"type": "upload"}), "expected a container of type 'edit'"),
        (pack({"type": "edit", "id": "", "label": "", "merge": "", "commands": []}), "expected 1 to 20000 commands, got 0"),
        (pack({"type": "edit", "id": "", "label": "x" * 999, "merge": "", "commands": [{"kind": "x"}]}), "999 characters; at most 200"),
        (pack({"type": "edit", "id": "", "label": "", "merge": "", "commands": [{"kind": "add_character"}]}), "no command 'add_character'"),
        (pack({"type": "edit", "id": "", "label": "", "merge": "", "commands": [{"kind": "remove_pose", "name": "x"}]}), "no pose 'x'"),
        (b'KPS1\x18\0\0\0{"type":"edit\\ud800"}    ', "lone surrogate"),
        (pack({"type": "edit", "id": "", "label": "", "merge": "", "commands": [{"kind": "set_settings", "settings": {"a": [1]}}]}), "settings.a: expected a number"),
        (pack({"type": "edit", "id": "", "label": "", "merge": "", "commands": [{"kind": "rename", "what": "clip", "name": "x", "to": "y"}]}), "no clip 'x'"),
    ],
)  # fmt: skip
def test_what_is_no_edit_is_refused(server: StudioServer, data: bytes, what: str) -> None:
    with page(server) as one:
        assert what in one.post("edit", data)["error"]


def test_a_thousand_damaged_edits_change_nothing_or_are_edits(server: StudioServer) -> None:
    rng = np.random.default_rng(0)
    with page(server) as one:
        made, body = commands_of(random_commands(np.random.default_rng(2), from_bytes(exported(server))))
        header = {"type": "edit", "id": "e", "label": "edit", "merge": "", "commands": made}
        data = pack(json.loads(json.dumps(header, default=dataclasses.asdict)), body)
        for n in range(1000):
            bad = bytearray(data[: rng.integers(len(data))] if n % 4 == 0 else data)
            for at in rng.integers(0, max(len(bad), 1), 0 if n % 4 == 0 else rng.integers(1, 6)):
                bad[at] = rng.integers(256)
            answer = read_or_refuse(bytes(bad))
            assert answer == "" or len(answer) > 3
        assert exported(server)
        assert one.post("edit", bytes(data[:-9]))["error"]


def read_or_refuse(data: bytes) -> str:
    try:
        read_edit(data)
    except KeyposeError as error:
        return str(error)
    return ""


def test_an_edit_that_is_too_large_is_refused_unread(server: StudioServer) -> None:
    headers = {**with_token(server), "Content-Length": str(EDIT_LIMIT_BYTES + 1)}
    status, _, answer = request(server, "POST", "/api/project/edit", b"", headers)
    assert (status, "MiB cannot be edited at once" in json.loads(answer)["error"]) == (413, True)


# ---- the project's file --------------------------------------------------------------------------------------------------


def test_a_project_is_saved_opened_and_refused_over_the_socket(server: StudioServer, tmp_path: Path) -> None:
    with page(server) as one:
        one.say("project_new", name="Saving", character="", discard=True)
        one.until("project_state")
        one.set_curves("arm", {Channel("a", Property.TRANSLATION, 1): bezier()})
        one.until("project_changed")
        assert one.status["saved_revision"] != one.status["revision"]
        one.say("project_save", path=None, force=False)
        assert one.until("project_not_saved")["reason"] == "failed"
        one.say("project_save", path=str(tmp_path / "p"), force=False)
        saved = one.until("project_changed", lambda m: m["cause"] == "save")
        assert saved["status"]["saved_revision"] == saved["status"]["revision"] == 1
        assert saved["status"]["path"] == str(tmp_path / "p.keypose")
        assert (tmp_path / "p.keypose").read_bytes() == exported(server)
        (tmp_path / "other.keypose").write_bytes(b"ruined")
        one.say("project_save", path=str(tmp_path / "other.keypose"), force=False)
        assert one.until("project_not_saved")["reason"] == "exists"
        one.say("project_open", path=str(tmp_path / "other.keypose"), discard=False)
        assert "other.keypose" in one.until("failure")["message"]
        one.say("project_browse", folder=str(tmp_path))
        listing = one.until("project_folder")
        assert [f["name"] for f in listing["files"]] == ["other.keypose", "p.keypose"]
        one.say("project_new", name="Else", character="", discard=False)
        assert one.until("project_state")["clips"] == []
        one.say("project_open", path=str(tmp_path / "p.keypose"), discard=False)
        one.until("project_state")
        assert one.clips["arm"].curves.keys() == {Channel("a", Property.TRANSLATION, 1)}
        one.say("project_save", path="half \ud800", force=False)
        assert one.until("project_not_saved")["reason"] == "failed"
        one.say("project_new", name="End", character="", discard=True)
        one.until("project_state")


def test_characters_come_and_go_with_their_scenes(server: StudioServer) -> None:
    with page(server) as one:
        one.say("project_new", name="People", character="", discard=True)
        one.until("project_state")
        for _ in range(2):
            one.say("project_add_character", source="s1")
            one.until("project_changed")
        first, second = one.characters
        assert (first["name"], second["name"], second["timeline"]) == ("arm", "arm 2", "arm 2")
        assert first["scene"] == second["scene"], "one mesh is sent once"
        status, _, data = request(server, "GET", f"/api/scenes/{first['scene']['id']}", headers=with_token(server))
        assert (status, len(data)) == (200, first["scene"]["bytes"])
        one.say("project_import_clip", source="s1", animation=-1)
        one.until("project_changed")
        assert {"wave", "sway"} < one.clips.keys()
        one.say("project_import_clip", source="s1", animation=7)
        assert "no animation '7'" in one.until("failure")["message"]
        one.say("project_remove_character", name="arm")
        one.until("project_changed")
        assert [who["name"] for who in one.characters] == ["arm 2"]
        one.say("project_undo")
        one.until("project_changed")
        assert [who["scene"]["id"] for who in one.characters] == [first["scene"]["id"]] * 2
        one.say("project_add_character", source="s99")
        assert "no scene 's99'" in one.until("failure")["message"]
        one.say("project_new", name="End", character="", discard=True)
        one.until("project_state")


@pytest.mark.parametrize("kind", ["glb", "fbx", "bvh", "dae", "keypose", "usdz"])
def test_the_project_is_exported_in_every_format(server: StudioServer, kind: str, tmp_path: Path) -> None:
    with page(server) as one:
        one.say("project_new", name="Export", character="s1", discard=True)
        one.until("project_state")
        curve = Curve([0.0, 1.0, 2.0], turn(np.array([0.0, 0.7, 0.0])), kind=CurveKind.ROTATION)
        one.set_curves("arm", {Channel("Joint1", Property.ROTATION): curve})
        if kind not in one.state["exports"]:
            pytest.skip("usd-core is not installed")
        path = tmp_path / f"out.{kind}"
        path.write_bytes(exported(server, kind, "?timeline=arm"))
        scene = io.load(path)
        pose = evaluate.sample(scene.animations[0], scene.character.skeleton, np.array([1.0]))
        joint = scene.character.skeleton.names.index("Joint1")
        assert abs(abs(pose.rotations[0, joint, 0]) - np.cos(0.35)) < 1e-4
        status, _, text = request(server, "GET", "/api/project/export/exe", headers=with_token(server))
        assert (status, b"no export 'exe'" in text) == (422, True)
        one.say("project_new", name="End", character="", discard=True)
        one.until("project_state")


def test_operators_run_on_the_project_as_one_step(server: StudioServer) -> None:
    status, _, data = request(server, "GET", "/api/project/operators", headers=with_token(server))
    specs = {spec["name"]: spec for spec in json.loads(data)}
    assert status == 200
    assert fits(list(specs.values()), list[messages.OperatorSpec])
    with page(server) as one:
        assert one.state["operators"] == list(specs)
        one.say("project_new", name="Operate", character="s1", discard=True)
        one.until("project_state")
        channel = Channel("Root", Property.TRANSLATION)
        one.set_curves("arm", {channel: Curve([0.0, 1.0, 2.0], np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]))})
        one.until("project_changed")
        before = exported(server)
        body = Body()
        asked = {
            "type": "operate", "id": "op", "operator": "ease", "clip": "arm", "character": "arm",
            "channels": [{"channel": values.channel_json(channel), "keys": dataclasses.asdict(body.add([0, 1], "uint32"))}],
            "start_s": None, "end_s": None, "parameters": {},
        }  # fmt: skip
        answer = one.post("operate", pack(asked, body))
        assert not answer["error"]
        changed = one.until("project_changed")
        assert (changed["edit"], changed["label"], answer["revision"]) == ("op", specs["ease"]["label"], 2)
        assert [len(change["curves"]) for change in changed["clips"]] == [1]
        assert exported(server) != before
        one.say("project_undo")
        one.until("project_changed")
        assert exported(server) == before
        for change, what in [
            ({"operator": "eas"}, "no operator 'eas'; nearest: 'ease'"),
            ({"clip": "amr"}, "no clip 'amr'"),
            ({"parameters": {"x": 1}}, "no parameter of ease 'x'"),
            (
                {"channels": [{"channel": {"target": "x", "property": "scale", "component": None}, "keys": None}]},
                "no channel",
            ),
        ]:
            assert what in one.post("operate", pack(asked | change, body))["error"]
        backwards = dataclasses.asdict(body.add([1, 0], "uint32"))
        asked["channels"][0]["keys"] = backwards
        assert "expected rising indices" in one.post("operate", pack(asked, body))["error"]
        one.say("project_new", name="End", character="", discard=True)
        one.until("project_state")


# ---- sudden ends ---------------------------------------------------------------------------------------------------------


class Running:
    """`keypose studio` as a process of its own."""

    def __init__(self, state: Path, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "keypose", "studio", "--no-browser", *arguments],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "XDG_STATE_HOME": str(state)},
        )
        assert self.process.stdout is not None
        url = urlsplit(self.process.stdout.readline().split()[-1])
        self.port, self.token = url.port, parse_qs(url.query)["token"][0]

    def end(self, how: int) -> None:
        self.process.send_signal(how)
        self.process.wait(20)
        assert self.process.stdout is not None
        self.process.stdout.close()


def test_after_kill_9_the_next_start_offers_everything_up_to_the_last_edit(tmp_path: Path) -> None:
    project = tmp_path / "p.keypose"
    io.save(arm_scene(), project)
    first = Running(tmp_path, str(project))
    with page(first) as one:  # type: ignore[arg-type]
        hello = one.hello
        assert (hello["start"], hello["recoverable"]) == ("edit", 0)
        assert one.status["path"] == str(project)
        for n in range(5):
            assert not one.set_curves("arm", {Channel("Joint1", Property.TRANSLATION, 1): bezier(n)})["error"]
        wanted = exported(first)  # type: ignore[arg-type]
        first.end(signal.SIGKILL)
    second = Running(tmp_path, str(project))
    with page(second) as one:  # type: ignore[arg-type]
        assert "5 changes of this project were not saved" in one.until("notice")["message"]
    second.end(signal.SIGINT)
    second = Running(tmp_path)
    with page(second) as one:  # type: ignore[arg-type]
        assert (one.hello["start"], one.hello["recoverable"]) == ("view", 1)
        (offer,) = one.state["recoverable"]
        assert (offer["path"], offer["edits"]) == (str(project), 5)
        one.say("project_recover", id=offer["id"])
        one.until("project_state")
        assert exported(second) == wanted  # type: ignore[arg-type]
        one.say("project_save", path=None, force=False)
        one.until("project_changed", lambda m: m["cause"] == "save")
    second.end(signal.SIGINT)
    assert project.read_bytes() == wanted
    assert list((tmp_path / "keypose").iterdir()) == []


def test_a_second_studio_is_told_who_has_the_project(tmp_path: Path) -> None:
    project = tmp_path / "p.keypose"
    io.save(arm_scene(), project)
    first = Running(tmp_path, str(project))
    done = subprocess.run(
        [sys.executable, "-m", "keypose", "studio", "--no-browser", str(project)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    first.end(signal.SIGINT)
    assert (done.returncode, done.stdout) == (1, "")
    assert f"p.keypose is open in another studio (process {first.process.pid}" in done.stderr


def test_a_studio_that_others_reach_stays_in_its_folder(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    outside.mkdir()
    (inside / "out").symlink_to(outside)
    monkeypatch.chdir(inside)
    server = start(host="0.0.0.0")
    with page(server) as one:
        for path in (str(outside / "p"), "../outside/p", "out/p", "~/p"):
            one.say("project_save", path=path, force=True)
            assert "stays in" in one.until("failure")["message"]
        for folder in ("..", "/", "out"):
            one.say("project_browse", folder=folder)
            assert "stays in" in one.until("failure")["message"]
        one.say("project_open", path="/etc/passwd", discard=False)
        assert "stays in" in one.until("failure")["message"]
        one.say("project_save", path="p", force=False)
        one.until("project_changed", lambda m: m["cause"] == "save")
    assert os.listdir(outside) == []
    assert (inside / "p.keypose").is_file()


def test_a_step_without_a_name_can_be_seen_to_be_undone(server: StudioServer) -> None:
    with page(server) as one:
        one.edit({"kind": "set_settings", "settings": {"zoom": 2}}, label="")
        assert one.until("project_changed")["status"]["undo"] == "Edit"
        assert one.settings["zoom"] == 2.0
