"""Playing a graph over a real socket: pages without a browser."""

from __future__ import annotations

import asyncio
import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from play_graphs import PlainPage, arm_graph, opened_arm
from studio_scenes import Start, arm_scene, upload
from test_server import request, with_token

from keypose import io
from keypose.play import graph as g
from keypose.studio import StudioServer, describe
from keypose.studio.app import build_app
from keypose.studio.desk import MOST_PLAYERS
from keypose.studio.pacing import WINDOW, WINDOW_FOR_INPUT
from keypose.studio.session import Session

sync = pytest.importorskip("websockets.sync.client")


@pytest.fixture(scope="module")
def server(start: Start) -> StudioServer:
    return start(graphs=[opened_arm()])


def address(server: StudioServer) -> str:
    return f"ws://127.0.0.1:{server.port}/api/events?token={server.token}"


@contextmanager
def page(server: StudioServer, graph: str = "file:0", *, draws: bool = True) -> Iterator[PlainPage]:
    with sync.connect(address(server), max_size=None) as socket:
        plain = PlainPage(socket, draws=draws)
        if graph:
            plain.say("play_open", graph=graph)
            plain.until("play_ready")
        yield plain


def players() -> int:
    return sum(thread.name == "keypose player" for thread in threading.enumerate())


def wait_for(condition: Any, what: str) -> None:
    end = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.01)


def test_the_greeting_names_the_graphs_and_where_to_begin(server: StudioServer) -> None:
    with sync.connect(address(server), max_size=None) as socket:
        hello = PlainPage(socket).until("hello")
    assert [graph["id"] for graph in hello["graphs"]] == ["sample:locomotion", "file:0"]
    assert (hello["start"], hello["graph"]) == ("play", "file:0")


def test_a_graph_says_what_it_is_before_it_plays(server: StudioServer) -> None:
    with sync.connect(address(server), max_size=None) as socket:
        plain = PlainPage(socket)
        plain.say("play_open", graph="file:0")
        ready = plain.until("play_ready")
        plain.until("play_frame")
    graph = arm_graph()
    assert {node["name"] for node in ready["nodes"]} == set(graph.nodes)
    for node in ready["nodes"][1:]:
        parent = ready["nodes"][node["parent"]]["name"]
        assert node["name"] in [below for _, below in g.definition.inputs_of(graph.nodes[parent])]
    assert [p["name"] for p in ready["parameters"]] == list(graph.parameters)
    machine = next(node for node in ready["nodes"] if node["kind"] == "state_machine")
    assert machine["states"] == ["go", "rest", "slow"]
    assert [t["when"] for t in machine["transitions"]] == ["stop", "stop", "stop", "fast"]
    status, _, scene = request(server, "GET", f"/api/scenes/{ready['scene']['id']}", headers=with_token(server))
    assert status == 200
    assert len(scene) == ready["scene"]["bytes"]


def test_frames_are_the_reference_evaluators_own_poses(server: StudioServer) -> None:
    with page(server) as plain:
        plain.set(speed=1.0, amount=0.25)
        plain.until("play_frame", lambda f: f["time_s"] > 0.4)
        program, _ = g.assemble(arm_graph(), open_scene=lambda _: arm_scene())
        state, heard = g.init(program), 0
        for n, frame in enumerate(plain.frames):
            values = {"speed": 1.0, "amount": 0.25} if frame["heard"] > heard else {}
            heard = frame["heard"]
            state, output = g.step(state, values, dt_s=frame["dt_s"])
            pose = np.concatenate([output.pose.translations, output.pose.rotations, output.pose.scales], axis=-1)
            assert np.array_equal(plain.array("pose", n), pose.astype(np.float32))
            assert frame["root"] == list(output.root)
            assert frame["time_s"] == pytest.approx(state.time_s)


def test_time_is_real_and_steps_come_steadily(server: StudioServer) -> None:
    with page(server) as plain:
        plain.until("play_frame", lambda f: f["number"] > 5)
        plain.frames.clear()
        began = time.perf_counter()
        last = plain.until("play_frame", lambda f: f["time_s"] > 1.3)
        passed = time.perf_counter() - began
    first = plain.frames[0]
    went = last["time_s"] - first["time_s"]
    assert went <= passed + 0.05  # less where the machine stalled: that is not caught up
    assert max(frame["dt_s"] for frame in plain.frames) <= 0.1
    assert sum(frame["dt_s"] for frame in plain.frames[1:]) == pytest.approx(went, abs=1e-9)
    assert last["number"] - first["number"] <= 66 * passed + 3
    assert np.median([frame["dt_s"] for frame in plain.frames]) == pytest.approx(1 / 60, abs=0.01)


def test_a_page_that_does_not_draw_gets_no_further_frames_and_no_catching_up(server: StudioServer) -> None:
    with page(server, draws=False) as plain:
        assert plain.silence(1.0) == WINDOW
        for value in range(40):  # inputs do not make it pile up either
            plain.set(speed=value / 40)
        assert plain.silence(0.4) <= WINDOW_FOR_INPUT - WINDOW
        before = plain.frames[-1]
        plain.draws = True
        plain.say("play_acknowledge", number=before["number"])
        after = plain.until("play_frame")
        assert after["number"] == before["number"] + 1
        assert after["time_s"] - before["time_s"] <= 0.1 + 1e-9


def test_an_acknowledgement_of_what_was_never_sent_opens_nothing(server: StudioServer) -> None:
    with page(server, draws=False) as plain:
        assert plain.silence(0.3) == WINDOW
        plain.say("play_acknowledge", number=1 << 40)
        plain.say("play_acknowledge", number=-5)
        assert plain.silence(0.3) == 0


def test_an_input_is_obeyed_at_once_and_only_by_its_own_page(server: StudioServer) -> None:
    with page(server) as one, page(server) as two:
        two.until("play_frame")
        waits = []
        for n in range(12):
            began = time.perf_counter()
            wanted = one.set(speed=n / 12)
            frame = one.until("play_frame", lambda f, wanted=wanted: f["heard"] >= wanted)
            waits.append(time.perf_counter() - began)
            assert one.array("parameters")[0] == pytest.approx(n / 12)
            assert frame["heard"] == wanted
        assert sorted(waits)[6] < 0.05, waits
        two.until("play_frame", lambda f: f["time_s"] > 0.5)
        assert two.frames[-1]["heard"] == 0
        assert two.array("parameters")[0] == 0


def test_pause_single_steps_slow_motion_and_reset(server: StudioServer) -> None:
    with page(server) as plain:
        plain.until("play_frame", lambda f: f["time_s"] > 0.2)
        plain.say("play_pace", paused=True, speed=1.0)
        plain.silence(0.2)
        held = plain.frames[-1]
        assert plain.silence(0.3) == 0
        for _ in range(3):
            plain.say("play_step")
        plain.silence(0.3)
        assert [f["dt_s"] for f in plain.frames[-3:]] == [1 / 60] * 3
        assert plain.frames[-1]["number"] == held["number"] + 3
        plain.set(amount=1.0)  # seen while time stands
        assert plain.until("play_frame")["dt_s"] == 0
        plain.say("play_pace", paused=False, speed=0.25)
        began, start = time.perf_counter(), plain.frames[-1]["time_s"]
        plain.silence(1.0)
        went = plain.frames[-1]["time_s"] - start
        assert 0.05 < went <= 0.25 * (time.perf_counter() - began) + 0.03
        plain.say("play_reset")
        again = plain.until("play_frame", lambda f: f["time_s"] < start)
        assert again["time_s"] <= 0.1
        assert plain.array("parameters")[3] == 0


def test_transitions_and_events_arrive_once_each(server: StudioServer) -> None:
    with page(server) as plain:
        for source in ("go", "rest", "slow"):
            plain.set(stop=1)
            frame = plain.until("play_frame", lambda f: f["changes"])
            assert [c["source"] for c in frame["changes"]] == [source]
            plain.until("play_frame", lambda f, t=frame["time_s"]: f["time_s"] > t + 0.4)
        kinds = [c["kind"] for f in plain.frames for c in f["changes"]]
        assert kinds == ["crossfade", "inertial", "frozen"]
        plain.say("play_reset")
        plain.until("play_frame", lambda f: f["time_s"] <= 0.1)
        plain.frames.clear()
        plain.bodies.clear()
        plain.until("play_frame", lambda f: f["time_s"] > 2.2)
        assert [e["name"] for f in plain.frames for e in f["events"]] == ["half", "half"]


def test_shares_sum_to_one_and_a_joint_is_explained(server: StudioServer) -> None:
    with page(server) as plain:
        plain.set(speed=0.7, amount=0.4)
        plain.say("play_explain", joint=2)
        plain.until("play_frame", lambda f: f["joint"] == 2 and f["heard"] == 1)
        nodes = [placed.name for placed in describe.tree(arm_graph())]
        shares = dict(zip(nodes, plain.array("shares"), strict=True))
        assert shares["wave"] + shares["sway"] == pytest.approx(1.0)
        assert shares["sway"] == pytest.approx(0.35)
        assert shares["extra"] == pytest.approx(0.4)
        wave, sway, memory, rest = plain.array("contributions")
        assert (wave, sway) == (pytest.approx(0.6 * 0.65), pytest.approx(0.6 * 0.35 + 0.4))
        assert (memory, rest) == (0, 0)
        plain.say("play_explain", joint=999)
        plain.until("play_frame", lambda f: f["joint"] == 999)
        assert plain.array("contributions").size == 0


@pytest.mark.parametrize(
    ("values", "what"),
    [
        ({"sped": [1.0]}, "no parameter 'sped'"),
        ({"goal": [1.0]}, "'goal': expected 3 numbers, got 1"),
        ({"speed": []}, "'speed': expected 1 numbers, got 0"),
        ({"level": [1.5]}, "'level': expected a whole number, got 1.5"),
    ],
)
def test_an_input_that_does_not_fit_is_refused_and_the_graph_plays_on(
    server: StudioServer, values: dict[str, list[float]], what: str
) -> None:
    with page(server) as plain:
        plain.say("play_input", sequence=1, values=values)
        assert what in plain.until("failure")["message"]
        assert plain.until("play_frame")["heard"] == 0


@pytest.mark.parametrize(
    "text",
    [
        '{"type": "play_open"}',
        '{"type": "play_open", "graph": 3}',
        '{"type": "play_open", "graph": "file:0", "path": "/etc/passwd"}',
        '{"type": "play_input", "sequence": 1, "values": {"speed": 1}}',
        '{"type": "play_input", "sequence": 1, "values": {"speed": [NaN]}}',
        '{"type": "play_input", "sequence": 1, "values": {"speed": [1e999]}}',
        '{"type": "play_input", "sequence": 1.5, "values": {}}',
        '{"type": "play_input", "sequence": true, "values": {}}',
        '{"type": "play_acknowledge", "number": "1"}',
        '{"type": "play_pace", "paused": 0, "speed": 1}',
        '{"type": "play_record", "on": null}',
        '{"type": "play_fly"}',
        "[" * 3000,
    ],
)
def test_what_is_no_message_ends_the_connection(server: StudioServer, text: str) -> None:
    with page(server, graph="") as plain:
        plain.socket.send(text)
        with pytest.raises(Exception, match="1003"):
            while True:
                plain.socket.recv(timeout=10)


def test_the_socket_wants_the_token_the_host_and_the_origin(server: StudioServer) -> None:
    with pytest.raises(Exception, match="403"):
        sync.connect(address(server) + "x")
    with pytest.raises(Exception, match="403"):
        sync.connect(address(server), origin="http://evil.example")
    upgrade = {
        "Host": f"evil.example:{server.port}",
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
    }
    assert request(server, "GET", f"/api/events?token={server.token}", headers=upgrade)[0] == 403


def test_a_session_ends_with_its_connection(server: StudioServer) -> None:
    wait_for(lambda: players() == 0, "players of other tests end")
    with page(server) as plain:
        plain.until("play_frame")
        assert players() == 1
        plain.say("play_open", graph="file:0")  # one page has one player
        plain.until("play_ready")
        plain.until("play_frame", lambda f: f["player"] == 2)
        wait_for(lambda: players() == 1, "the old player ends")
    wait_for(lambda: players() == 0, "the player ends with its page")


def test_a_page_that_goes_in_the_middle_of_a_frame_leaves_no_traceback() -> None:
    async def run() -> None:
        gone = asyncio.Event()

        async def receive() -> dict[str, Any]:
            if not asked:
                asked.append(True)
                return {"type": "websocket.connect"}
            await gone.wait()
            return {"type": "websocket.disconnect", "code": 1006}

        async def send(message: dict[str, Any]) -> None:
            if message["type"] == "websocket.send":
                gone.set()
                raise OSError("nobody is there")

        asked: list[bool] = []
        scope = {"type": "websocket", "path": "/api/events", "query_string": b"", "headers": [], "subprotocols": []}
        await build_app(Session(graphs=[opened_arm()]), {})(scope, receive, send)

    asyncio.run(run())


def test_only_so_many_pages_play_at_once(server: StudioServer) -> None:
    wait_for(lambda: players() == 0, "players of other tests end")
    with ExitStack() as open_sockets:
        sockets = [open_sockets.enter_context(sync.connect(address(server))) for _ in range(MOST_PLAYERS + 1)]
        pages = [PlainPage(socket, draws=False) for socket in sockets]
        for plain in pages[:-1]:
            plain.say("play_open", graph="file:0")
            plain.until("play_ready")
        pages[-1].say("play_open", graph="file:0")
        assert pages[-1].until("failure")["title"] == "Too many players"
        pages[0].say("play_close")
        wait_for(lambda: players() == MOST_PLAYERS - 1, "the first one ends")
        pages[-1].say("play_open", graph="file:0")
        pages[-1].until("play_ready")
    wait_for(lambda: players() == 0, "all end")


def test_a_graph_that_is_not_open_is_said_so(server: StudioServer) -> None:
    with page(server, graph="") as plain:
        plain.say("play_open", graph="/etc/passwd")
        assert "no graph '/etc/passwd' is open" in plain.until("failure")["message"]


# ---- recordings ------------------------------------------------------------------------------------------------------


def test_a_recording_is_baked_and_loads_again(server: StudioServer, tmp_path: Path) -> None:
    with page(server) as plain:
        plain.set(speed=2.0)
        plain.until("play_frame", lambda f: f["heard"] == 1)
        plain.say("play_record", on=True)
        plain.until("play_frame", lambda f: f["recorded_s"] is not None and f["recorded_s"] > 0.3)
        plain.set(stop=1)
        plain.until("play_frame", lambda f: f["recorded_s"] > 0.9)
        plain.say("play_record", on=False)
        take = plain.until("play_take")
        assert take["frames"] == round(take["duration_s"] * 60) + 1
        assert take["duration_s"] == pytest.approx(0.95, abs=0.15)
        for kind in ("glb", "bvh"):
            status, _, data = request(server, "GET", f"/api/takes/{take['id']}/{kind}", headers=with_token(server))
            assert status == 200
            (tmp_path / f"take.{kind}").write_bytes(data)
            motion = io.load(tmp_path / f"take.{kind}").animations[0]
            assert motion.duration_s == pytest.approx(take["duration_s"], abs=1e-4)
        assert io.load(tmp_path / "take.bvh").animations[0].frame_count == take["frames"]
        path = f"/api/takes/{take['id']}"
        assert request(server, "GET", f"{path}/glb")[0] == 403
        evil = {**with_token(server), "Host": f"evil.example:{server.port}"}
        assert request(server, "GET", f"{path}/glb", headers=evil)[0] == 403
        assert request(server, "GET", f"{path}/exe", headers=with_token(server))[0] == 404
        assert request(server, "GET", "/api/takes/take999/glb", headers=with_token(server))[0] == 404
    wait_for(
        lambda: request(server, "GET", f"{path}/glb", headers=with_token(server))[0] == 404, "it goes with its page"
    )


# ---- dropped graphs ----------------------------------------------------------------------------------------------------


def dropped(server: StudioServer, *files: tuple[str, bytes]) -> dict[str, Any]:
    status, _, answer = request(server, "POST", "/api/scenes", upload(*files), with_token(server))
    assert status == 200
    return json.loads(answer)


def graph_of(source: str) -> bytes:
    clips = {"move": g.ClipSource(source)}
    graph = g.Graph({"play": g.ClipNode("move")}, "play", clips=clips, character=source)
    return g.to_json(graph).encode()


def test_a_graph_is_dropped_with_its_clips_and_played(start: Start, tmp_path: Path) -> None:
    server = start()
    io.save(arm_scene(), tmp_path / "arm.glb")
    result = dropped(
        server, ("game/my.json", graph_of("clips/arm.glb")), ("game/clips/arm.glb", (tmp_path / "arm.glb").read_bytes())
    )
    assert result["errors"] == []
    assert [graph["name"] for graph in result["graphs"]] == ["my.json"]
    with page(server, result["graphs"][0]["id"]) as plain:
        plain.until("play_frame", lambda f: f["time_s"] > 0.2)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (b"{", "my.json: line 1: no JSON"),
        (b'{"format": "keypose-graph", "version": 1, "nodes": {"a": {"kind": "clip", "clip": "no"}}, "output": "b"}', "no node 'b'"),
        (graph_of("arm.glb"), "arm.glb: was not dropped"),
        (graph_of("../../../../etc/hostname"), "is outside of what was dropped"),
        (graph_of("/etc/hostname"), "is outside of what was dropped"),
        (graph_of("sample:humn"), "nearest: 'human'"),
    ],
)  # fmt: skip
def test_a_dropped_graph_that_is_wrong_is_refused_in_one_line(start: Start, text: bytes, what: str) -> None:
    result = dropped(start(), ("my.json", text))
    assert result["graphs"] == []
    assert len(result["errors"]) == 1
    assert what in result["errors"][0]
    assert "\n" not in result["errors"][0]
    assert "keypose-" not in result["errors"][0].replace("keypose-graph", "")


# ---- the command -----------------------------------------------------------------------------------------------------


def test_keypose_play_serves_the_built_in_graph_and_ends_quietly_while_it_plays() -> None:
    command = [sys.executable, "-m", "keypose", "play", "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    url = urlsplit(process.stdout.readline().split()[-1])
    with sync.connect(f"ws://127.0.0.1:{url.port}/api/events?{url.query}", max_size=None) as socket:
        plain = PlainPage(socket)
        hello = plain.until("hello")
        assert (hello["start"], hello["graph"]) == ("play", "sample:locomotion")
        plain.say("play_open", graph=hello["graph"])
        plain.until("play_frame", lambda f: f["time_s"] > 0.3)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=20)
    assert (process.returncode, out, err) == (0, "", "")
