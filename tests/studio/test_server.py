"""The running server, asked over real sockets."""

from __future__ import annotations

import http.client
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from studio_scenes import Start, arm_scene, upload

from keypose.errors import KeyposeError, ShapeError
from keypose.studio import StudioServer, serve
from keypose.studio.container import unpack

SRC = Path(__file__).resolve().parents[2] / "src"


@pytest.fixture(scope="module")
def server(start: Start) -> StudioServer:
    return start(("arm.glb", arm_scene()), upload_limit_bytes=1_000_000)


def request(
    server: StudioServer, method: str, path: str, body: bytes | None = None, headers: dict[str, str] | None = None
) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=20)
    connection.putrequest(method, path, skip_host=True)
    given = {"Host": f"127.0.0.1:{server.port}", **(headers or {})}
    if body is not None:
        given.setdefault("Content-Length", str(len(body)))
    for name, value in given.items():
        connection.putheader(name, value)
    connection.endheaders()
    if body is not None:
        connection.send(body)
    answer = connection.getresponse()
    data = answer.read()
    connection.close()
    return answer.status, {k.lower(): v for k, v in answer.getheaders()}, data


def with_token(server: StudioServer) -> dict[str, str]:
    return {"X-Keypose-Token": server.token}


def test_the_url_opens_the_page_and_other_tokens_do_not(server: StudioServer) -> None:
    url = urlsplit(server.url)
    assert url.hostname == "127.0.0.1"
    status, headers, page = request(server, "GET", f"/?{url.query}")
    assert status == 200
    assert headers["content-type"].startswith("text/html")
    assert headers["x-content-type-options"] == "nosniff"
    assert b"<script" in page
    assert request(server, "GET", "/?token=wrong")[0] == 403
    assert request(server, "GET", "/")[0] == 403
    assert len(server.token) >= 32


def test_a_rebound_name_and_another_page_are_refused(server: StudioServer) -> None:
    path = f"/api/scenes/s1?token={server.token}"
    assert request(server, "GET", path)[0] == 200
    assert request(server, "GET", path, headers={"Host": f"evil.example:{server.port}"})[0] == 403
    assert request(server, "GET", path, headers={"Origin": "http://evil.example"})[0] == 403


@pytest.mark.parametrize(
    "path",
    [
        "/../server.py",
        "/assets/../../server.py",
        "/assets/..%2f..%2fserver.py",
        "/%2e%2e/%2e%2e/pyproject.toml",
        "//etc/passwd",
        "/etc/passwd",
        "/.sources",
        "/index.html",
        "/api/scenes/..%2f..%2fetc%2fpasswd",
        "/api/files/s1",
    ],
)
def test_no_path_leads_anywhere_else(server: StudioServer, path: str) -> None:
    assert request(server, "GET", path, headers=with_token(server))[0] == 404


def test_a_scene_is_one_container_and_an_unknown_one_is_not_there(server: StudioServer) -> None:
    status, _, data = request(server, "GET", "/api/scenes/s1", headers=with_token(server))
    assert status == 200
    assert unpack(data)[0]["name"] == "arm.glb"
    assert request(server, "GET", "/api/scenes/s99", headers=with_token(server))[0] == 404


def test_an_upload_answers_with_what_failed(server: StudioServer) -> None:
    body = upload(("broken.bvh", b"HIERARCHY\nROOT hips\n{ nonsense"))
    status, _, answer = request(server, "POST", "/api/scenes", body, with_token(server))
    result = json.loads(answer)
    assert (status, result["opened"]) == (200, [])
    assert result["errors"][0].startswith("broken.bvh: ")
    assert "keypose-" not in result["errors"][0]
    assert request(server, "POST", "/api/scenes", b"what is this", with_token(server))[0] == 400


def test_too_much_is_refused_whether_announced_or_not(server: StudioServer) -> None:
    assert request(server, "POST", "/api/scenes", b"", {**with_token(server), "Content-Length": "2000000"})[0] == 413
    chunk = b"%x\r\n" % 100_000 + b"a" * 100_000 + b"\r\n"
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=20)
    connection.putrequest("POST", "/api/scenes")
    for name, value in {**with_token(server), "Transfer-Encoding": "chunked"}.items():
        connection.putheader(name, value)
    connection.endheaders()
    try:
        for _ in range(15):
            connection.send(chunk)
        connection.send(b"0\r\n\r\n")
    except OSError:
        pass  # the server has answered and hung up before everything was sent
    assert connection.getresponse().status == 413
    connection.close()


def test_events_greet_acknowledge_and_close(start: Start) -> None:
    sync = pytest.importorskip("websockets.sync.client")
    server = start(("arm.glb", arm_scene()), ("again.glb", arm_scene()))
    address = f"ws://127.0.0.1:{server.port}/api/events?token="
    with sync.connect(address + server.token, max_size=None) as socket:
        hello = unpack(socket.recv(timeout=10))[0]
        assert hello["message"]["type"] == "hello"
        assert hello["message"]["expected"] == 2
        socket.send(json.dumps({"type": "acknowledge", "sequence": 1}))
        deadline = time.monotonic() + 10
        while request(server, "GET", "/api/scenes/s2", headers=with_token(server))[0] != 200:
            assert time.monotonic() < deadline
        socket.send(json.dumps({"type": "close_scene", "id": "s1"}))
        kinds = []
        while "scene_closed" not in kinds:
            kinds.append(unpack(socket.recv(timeout=10))[0]["message"]["type"])
        assert request(server, "GET", "/api/scenes/s1", headers=with_token(server))[0] == 404
        socket.send("nonsense")
        with pytest.raises(Exception, match="1003"):
            while True:
                socket.recv(timeout=10)
    with pytest.raises(Exception, match="403"):
        sync.connect(address + "wrong")
    with pytest.raises(Exception, match="403"):
        sync.connect(address + server.token, origin="http://evil.example")


def test_a_built_in_character_is_opened_by_name(start: Start) -> None:
    sync = pytest.importorskip("websockets.sync.client")
    server = start()
    with sync.connect(f"ws://127.0.0.1:{server.port}/api/events?token={server.token}", max_size=None) as socket:

        def until(kind: str) -> dict[str, Any]:
            while True:
                got = unpack(socket.recv(timeout=30))[0]
                socket.send(json.dumps({"type": "acknowledge", "sequence": got["sequence"]}))
                if got["message"]["type"] == kind:
                    return got["message"]

        assert until("hello")["scenes"] == []
        socket.send(json.dumps({"type": "open_sample", "name": "wakl"}))
        assert "nearest: 'walk'" in until("failure")["message"]
        socket.send(json.dumps({"type": "open_sample", "name": "walk"}))
        assert until("scene_ready")["scene"]["name"] == "sample:walk"


def test_a_host_that_others_can_reach_needs_to_be_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ShapeError, match="--allow-remote"):
        serve([], host="0.0.0.0", open_browser=False)


def test_a_port_that_is_taken_is_an_error_with_a_name(server: StudioServer) -> None:
    with pytest.raises(KeyposeError, match=f"cannot listen on 127.0.0.1, port {server.port}"):
        StudioServer(port=server.port)


def test_a_bad_file_ends_it_before_anything_is_served(tmp_path: Path) -> None:
    bad = tmp_path / "bad.bvh"
    bad.write_text("HIERARCHY\nROOT")
    with pytest.raises(KeyposeError, match=r"bad\.bvh"):
        serve([str(bad)], open_browser=False, ready=lambda _: pytest.fail("it must not listen"))


def test_ctrl_c_ends_it_quietly(tmp_path: Path) -> None:
    from keypose import io

    io.save(arm_scene(skeleton_only=True), tmp_path / "chain.bvh")
    code = "import sys; from keypose.studio import serve; serve(sys.argv[1:], open_browser=False)"
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path / "chain.bvh")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(SRC)},
    )
    assert process.stdout is not None
    line = process.stdout.readline()
    assert "http://127.0.0.1:" in line
    url = urlsplit(line.split()[-1])
    connection = http.client.HTTPConnection("127.0.0.1", url.port or 0, timeout=10)
    connection.request("GET", f"/?{url.query}")
    assert connection.getresponse().status == 200
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=15)
    assert (process.returncode, out, err) == (0, "", "")


def test_importing_the_studio_loads_no_server_library() -> None:
    code = "import keypose.studio, sys; print([m for m in ('starlette', 'uvicorn', 'websockets', 'numba') if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(SRC)}
    )
    assert done.stdout.strip() == "[]", done.stderr
