"""Crowds for the browser, without one: what is sent, when, and to whom no more."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from play_graphs import opened_arm

from keypose.errors import KeyposeError, ShapeError, UnknownName
from keypose.studio.container import unpack
from keypose.studio.crowd import CrowdRunner
from keypose.studio.crowd_show import CrowdShow, View, varied
from keypose.studio.graphs import Stage, built_in
from keypose.studio.messages import CrowdOpen, CrowdView
from keypose.studio.requests import parse_crowd_request, parse_request

TYPES = {"float32": np.float32, "uint8": np.uint8, "uint16": np.uint16, "uint32": np.uint32}


def arrays(data: bytes) -> tuple[dict[str, Any], Callable[[dict[str, Any]], np.ndarray]]:
    header, body = unpack(data)

    def read(ref: dict[str, Any]) -> np.ndarray:
        return np.frombuffer(body[ref["offset"] : ref["offset"] + ref["bytes"]], TYPES[ref["element"]]).reshape(
            ref["shape"]
        )

    return header, read


@pytest.fixture(scope="module")
def stage() -> Stage:
    return built_in("locomotion").stage()


@pytest.fixture(scope="module")
def show(stage: Stage) -> CrowdShow:
    return CrowdShow(stage, "locomotion", 60, "wander", 3)


def test_what_stays_is_sent_once(show: CrowdShow) -> None:
    header, read = arrays(show.ready())
    assert header["count"] == 60 and len(header["levels"]) == len(show.levels)
    for level, data in zip(show.levels, header["levels"], strict=True):
        assert np.array_equal(read(data["positions"]), level.mesh.positions)
        assert read(data["triangles"]).max() < level.mesh.vertex_count
        assert read(data["joints"]).max() < data["palette"] == len(level.skin.palette)
        assert read(data["materials"]).max() < len(header["materials"])
    morphs = header["levels"][0]["morphs"]
    starts, vertices = read(morphs["starts"]), read(morphs["vertices"])
    assert len(starts) == header["morphs"] + 1 and starts[-1] == len(vertices)
    assert vertices.max() < show.levels[0].mesh.vertex_count
    assert all(data["morphs"] is None for data in header["levels"][1:])
    errors = [data["error_mm"] for data in header["levels"]]
    assert errors[0] == 0 and errors == sorted(errors)
    colors = read(header["colors"])
    assert colors.shape == (60, len(header["materials"]), 3)
    jackets = colors[:, [m["name"] for m in header["materials"]].index("jacket")]
    assert len(np.unique(jackets, axis=0)) > 8  # not cloned
    assert len(np.unique(colors[:, [m["name"] for m in header["materials"]].index("eyes")], axis=0)) == 1


def test_matrices_are_those_of_the_crowd(show: CrowdShow) -> None:
    for _ in range(5):
        header, read = arrays(show.step(1 / 30, View((0.0, 2.0, 3.0))))
    roots = read(header["roots"])
    assert np.allclose(roots, show.crowd.roots, atol=1e-5)
    levels = read(header["levels"])
    checked = 0
    for n, update in enumerate(header["updates"]):
        who, small = read(update["who"]), read(update["matrices"]).view(np.int16)
        assert np.all(levels[who] == n)
        skin = show.levels[n].skin
        for character, matrices in list(zip(who, small, strict=True))[:5]:
            block, lane = divmod(int(character), show.crowd.models.shape[-1])
            world = np.tile(np.eye(4), (len(skin.palette), 1, 1))
            world[:, :3] = show.crowd.models[block, skin.palette, :, lane].reshape(-1, 3, 4)
            x, z, yaw = show.crowd.roots[character]
            at = np.array(
                [[np.cos(yaw), 0, np.sin(yaw), x], [0, 1, 0, 0], [-np.sin(yaw), 0, np.cos(yaw), z], [0, 0, 0, 1]]
            )
            true = (np.linalg.inv(at) @ world @ skin.joint_from_mesh)[:, :3]
            got = matrices.reshape(-1, 3, 4) * np.array([2.0**-14] * 3 + [show.unit_m])
            assert np.abs(got - true).max() < 2e-4
            checked += 1
    assert checked > 8


def test_faces_move_as_deform_moves_them(show: CrowdShow) -> None:
    from keypose import deform

    header, read = arrays(show.ready())
    level, data = show.levels[0], header["levels"][0]["morphs"]
    names = list(show._morphs)
    assert "eyeBlinkLeft" in names and len(names) == header["morphs"]
    character = show.character
    for name in ("eyeBlinkLeft", names[-1]):
        m = names.index(name)
        at = slice(*read(data["starts"])[m : m + 2])
        moved = level.mesh.positions.copy()
        np.add.at(moved, read(data["vertices"])[at], read(data["position_deltas"])[at])
        weights = np.zeros(len(character.morph_names))
        weights[character.morph_index(name)] = 1.0
        for n, part in enumerate(character.parts):
            if part.morphs is not None:
                true = deform.morph(part.mesh, part.morphs, weights[part.morph_channels])
                assert np.abs(moved[level.parts == n] - true[level.vertices[level.parts == n]]).max() < 1e-6


def test_the_near_ones_are_sent_each_time_and_the_far_ones_in_turn(stage: Stage) -> None:
    crowd = CrowdShow(stage, "locomotion", 400, "wander", 1)
    away = View((0.0, 3.0, crowd.radius_m + 1.0))
    crowd.step(1 / 30, away)
    counts: list[list[int]] = []
    seen = [np.zeros(400, int) for _ in range(2)]
    for step in range(24):
        header, read = arrays(crowd.step(1 / 30, away))
        counts.append([len(read(u["who"])) for u in header["updates"]])
        for update in header["updates"]:
            seen[step % 2][read(update["who"])] += 1
    shown, each = np.array(crowd.detail.shown), np.mean(counts, axis=0)
    every = np.array([level.spec.every for level in crowd.levels])
    assert shown[2] > 100 and shown[3] > 20
    assert np.all(np.abs(each - shown / every) <= 0.3 * shown / every + 3)
    total = np.sum(counts, axis=1)
    assert total.max() < 1.7 * total.min()  # all steps cost about the same
    assert np.all(seen[0] + seen[1] >= 24 // 4 - 1)


def test_where_time_stands_only_new_levels_are_sent(stage: Stage) -> None:
    crowd = CrowdShow(stage, "locomotion", 40, "wander", 1)
    crowd.step(1 / 30, View((0.0, 2.0, 60.0)))
    before = crowd.crowd.roots.copy()
    header, read = arrays(crowd.step(0.0, View((0.0, 2.0, 60.0))))
    assert [len(read(u["who"])) for u in header["updates"]] == [0] * len(crowd.levels)
    header, read = arrays(crowd.step(0.0, View((0.0, 1.0, 4.0))))
    assert sum(len(read(u["who"])) for u in header["updates"]) > 0
    assert np.array_equal(crowd.crowd.roots, before) and header["time_s"] == pytest.approx(1 / 30)


def test_the_same_seed_is_the_same_crowd(stage: Stage) -> None:
    def roots(seed: int) -> np.ndarray:
        crowd = CrowdShow(stage, "locomotion", 32, "wander", seed)
        for _ in range(60):
            crowd.step(1 / 30, View())
        return crowd.crowd.roots.copy()

    first = roots(5)
    assert np.array_equal(first, roots(5)) and not np.array_equal(first, roots(6))


def test_a_graph_that_nobody_can_steer_is_refused() -> None:
    with pytest.raises(KeyposeError, match="'speed'"):
        CrowdShow(opened_arm().stage(), "arm", 10, "wander", 0)


def test_numbers_that_do_not_fit_are_refused(stage: Stage) -> None:
    with pytest.raises(ShapeError, match="count"):
        CrowdShow(stage, "locomotion", 0, "wander", 0)
    with pytest.raises(ShapeError, match="count"):
        CrowdShow(stage, "locomotion", 10**9, "wander", 0)
    with pytest.raises(UnknownName, match="wander"):
        CrowdShow(stage, "locomotion", 10, "wonder", 0)


def test_colours_of_any_character_vary_a_little() -> None:
    from keypose.model import Material

    colors = varied([Material("a", (0.8, 0.2, 0.1, 1.0)), Material("b", (0.5, 0.5, 0.5, 1.0))], 200, 0)
    assert colors.shape == (200, 2, 3) and colors.min() >= 0 and colors.max() <= 1
    assert np.allclose(colors[0], [[0.8, 0.2, 0.1], [0.5, 0.5, 0.5]])
    assert colors[1:, 0].std(axis=0).min() > 0.02
    assert np.abs(np.ptp(colors[:, 1], axis=1)).max() < 1e-12  # grey stays grey


# ---- the clock -----------------------------------------------------------------------------------------------------------


class FakeShow:
    """Counts its steps."""

    def __init__(self) -> None:
        self.steps: list[tuple[float, View]] = []

    def ready(self) -> bytes:
        return b"ready"

    def step(self, dt_s: float, view: View) -> bytes:
        self.steps.append((dt_s, view))
        return b"frame"


def until(condition: Callable[[], Any], seconds: float = 5.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


@pytest.fixture
def running():
    show, sent, failed = FakeShow(), [], []
    runner = CrowdRunner(lambda: show, sent.append, failed.append)  # type: ignore[arg-type, return-value]
    runner.start()
    until(lambda: runner.sent >= 2)
    yield runner, show, sent, failed
    runner.close()
    assert runner.join(5) and not failed


def test_nothing_piles_up_for_a_page_that_draws_nothing(running) -> None:
    runner, _, sent, _ = running
    time.sleep(0.4)
    assert len(sent) == 3  # what stays, and two frames
    runner.acknowledge(1)
    until(lambda: runner.sent == 3)
    time.sleep(0.2)
    assert runner.sent == 3
    runner.acknowledge(10**6)  # never sent
    time.sleep(0.1)
    assert runner.sent == 3


def test_time_that_nobody_saw_is_not_caught_up(running) -> None:
    runner, show, _, _ = running
    time.sleep(0.5)
    runner.acknowledge(2)
    until(lambda: runner.sent >= 4)
    assert max(dt for dt, _ in show.steps) <= 0.1


def test_pause_slow_motion_and_a_camera_that_moves_meanwhile(running) -> None:
    runner, show, _, _ = running
    runner.pace(True, 1.0, 30.0)
    runner.acknowledge(2)
    time.sleep(0.2)
    count = runner.sent
    assert count <= 3
    runner.look([1.0, 2.0, 3.0], 40.0)
    until(lambda: runner.sent == count + 1)
    assert show.steps[-1][0] == 0.0 and show.steps[-1][1] == View((1.0, 2.0, 3.0), 40.0)
    runner.pace(False, 0.1, 60.0)
    runner.acknowledge(runner.sent)
    until(lambda: runner.sent >= count + 2)
    assert 0 < show.steps[-1][0] < 0.012


def test_one_crowd_goes_on_until_the_next_is_made() -> None:
    first, second, sent = FakeShow(), FakeShow(), []
    old = CrowdRunner(lambda: first, sent.append, sent.append)  # type: ignore[arg-type, return-value]
    old.start()
    until(lambda: old.sent >= 1)
    wait = threading.Event()

    def make() -> Any:
        wait.wait(10)
        return second

    new = CrowdRunner(make, sent.append, sent.append, old)  # type: ignore[arg-type]
    new.start()
    for n in range(1, 6):
        new.acknowledge(n)  # reaches the one that is shown
        until(lambda n=n: old.sent > n)
    wait.set()
    until(lambda: new.sent >= 1)
    assert old.join(5)
    new.close()
    assert new.join(5)


def test_an_error_is_told() -> None:
    told: list[str] = []

    def make() -> Any:
        raise KeyposeError("no such thing")

    runner = CrowdRunner(make, lambda _: None, told.append)
    runner.start()
    assert runner.join(5) and told == ["no such thing"]


def test_pages_beyond_the_limit_are_told(start: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from websockets.sync.client import connect

    from keypose.studio import crowd as module

    monkeypatch.setattr(module, "MOST_CROWDS", 0)
    server = start(graphs=[built_in("locomotion")])
    url = f"ws://127.0.0.1:{server.port}/api/crowd?token={server.token}"
    with connect(url) as socket:
        socket.send('{"type":"crowd_open","graph":"sample:locomotion","count":5,"behaviour":"wander","seed":1}')
        header, _ = unpack(socket.recv(20))
        assert header["type"] == "crowd_failure" and "already" in header["message"]


def test_a_crowd_over_a_real_socket(start: Any) -> None:
    from websockets.sync.client import connect

    server = start(graphs=[built_in("locomotion")])
    url = f"ws://127.0.0.1:{server.port}/api/crowd?token={server.token}"
    with connect(url, max_size=None) as socket:
        socket.send('{"type":"crowd_open","graph":"nothing","count":5,"behaviour":"wander","seed":1}')
        assert "nothing" in unpack(socket.recv(20))[0]["message"]
        socket.send('{"type":"crowd_open","graph":"sample:locomotion","count":20,"behaviour":"wander","seed":1}')
        assert unpack(socket.recv(60))[0]["count"] == 20
        for number in range(1, 6):
            header, _ = unpack(socket.recv(30))
            assert header["number"] == number
            socket.send(f'{{"type":"crowd_acknowledge","number":{number}}}')
        socket.send("nonsense")
        with pytest.raises(Exception, match=r"1003|unknown"):
            for _ in range(20):
                socket.recv(10)


def test_requests_are_checked() -> None:
    text = '{"type":"crowd_open","graph":"g","count":5,"behaviour":"wander","seed":1}'
    assert parse_crowd_request(text) == CrowdOpen("crowd_open", "g", 5, "wander", 1)
    assert parse_request(text) is None  # not on the other socket
    assert parse_crowd_request('{"type":"crowd_view","eye":[1,2,3],"fov_deg":30}') == CrowdView(
        "crowd_view", [1, 2, 3], 30
    )
    for bad in (
        '{"type":"crowd_open"}',
        '{"type":"close_scene","id":"s1"}',
        "nonsense",
        '{"type":"crowd_view","eye":["a"],"fov_deg":1}',
    ):
        assert parse_crowd_request(bad) is None
