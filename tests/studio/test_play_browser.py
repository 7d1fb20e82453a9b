"""The play page in a real browser: keys, gamepad, recordings, and any graph."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from play_graphs import arm_graph, opened_arm
from studio_page import StudioPage
from studio_scenes import Start, arm_scene
from test_browser import drop

from keypose import io
from keypose.errors import FormatError
from keypose.play import graph as g
from keypose.samples import graphs
from keypose.studio.graphs import OpenedGraph, built_in

pytestmark = pytest.mark.browser

Visit = Callable[..., StudioPage]


def now(page: StudioPage) -> dict[str, Any]:
    return page.ask("play")


def playing(page: StudioPage) -> StudioPage:
    page.until(lambda: now(page)["playing"] and now(page)["number"] > 3, "the graph plays", 30)
    return page


@pytest.fixture(scope="module")
def shared(chromium: Any, start: Start) -> Iterator[StudioPage]:
    """One page on the built-in graph."""
    server = start(graphs=[built_in("locomotion")])
    context = chromium.new_context(viewport={"width": 1100, "height": 700}, color_scheme="dark", accept_downloads=True)
    context.set_default_timeout(30_000)
    page = StudioPage(context.new_page())
    page.page.goto(server.url)
    page.ready()
    yield playing(page)
    context.close()


@pytest.fixture
def human(shared: StudioPage) -> Iterator[StudioPage]:
    """The page at the beginning of the graph, nothing pressed."""
    shared.complaints.clear()
    shared.page.set_viewport_size({"width": 1100, "height": 700})
    shared.draw(False)
    shared.ask("gamepad", None)
    shared.page.evaluate(
        """() => {
          const p = keypose.play;
          p.playing.driver.release(); p.setSteering("camera"); p.setSpeed(1); p.explain(-1); p.takes = [];
          if (p.paused) p.togglePause();
          p.follow = p.left = p.right = true;
          p.reset();
          document.activeElement?.blur();
        }"""
    )
    shared.until(lambda: now(shared)["time"] < 1.0 and now(shared)["states"]["body"] == "idle", "it begins anew")
    yield shared
    for key in ("w", "a", "s", "d", "Shift", "ArrowUp"):
        shared.page.keyboard.up(key)
    assert shared.complaints == []


# ---- driving ---------------------------------------------------------------------------------------------------------


def test_w_walks_forward_and_letting_go_stands(human: StudioPage) -> None:
    human.page.keyboard.down("w")
    human.until(lambda: now(human)["states"]["body"] == "move", "it walks")
    human.until(lambda: now(human)["root"][1] > 0.8, "it gets ahead")
    state = now(human)
    assert abs(state["root"][0]) < 0.05
    assert state["parameters"]["speed"][0] == pytest.approx(graphs.WALK_M_S, abs=0.02)
    assert state["cuts"] == ["inertial"]
    human.page.keyboard.up("w")
    human.until(lambda: now(human)["states"]["body"] == "idle", "it stands")
    human.until(lambda: abs(now(human)["parameters"]["speed"][0]) < 0.01, "its speed is gone")


def test_shift_runs_and_arrow_keys_go_where_the_camera_looks(human: StudioPage) -> None:
    human.page.keyboard.down("Shift")
    human.page.keyboard.down("ArrowUp")
    human.until(lambda: now(human)["parameters"]["speed"][0] > 0.97 * graphs.RUN_M_S, "it runs")
    human.page.keyboard.up("Shift")
    human.until(lambda: now(human)["parameters"]["speed"][0] < 1.05 * graphs.WALK_M_S, "it walks again")
    human.page.keyboard.down("a")  # to the left of where the camera looks; left is +X
    human.until(lambda: now(human)["root"][2] > 0.5, "it turns to the left")


def test_steering_by_the_character_turns_at_a_rate(human: StudioPage) -> None:
    human.page.keyboard.press("k")
    human.page.keyboard.down("d")
    human.until(lambda: now(human)["parameters"]["turn"][0] < -60, "it turns to the right")
    assert now(human)["parameters"]["speed"][0] == pytest.approx(0.0, abs=1e-3)


def test_space_jumps_once_with_both_events_and_lands(human: StudioPage) -> None:
    human.page.keyboard.press(" ")
    human.until(lambda: now(human)["states"]["body"] == "jump", "it jumps")
    human.until(lambda: now(human)["states"]["body"] == "idle", "it stands again")
    human.page.wait_for_timeout(400)
    assert now(human)["marks"] == ["take_off", "land"]
    assert now(human)["cuts"] == ["inertial", "inertial"]


@pytest.mark.parametrize("key", ["e", "1"])
def test_a_tap_switches_a_layer_and_another_one_back(human: StudioPage, key: str) -> None:
    human.page.keyboard.press(key)
    human.until(lambda: now(human)["parameters"]["wave"][0] > 0.95, "it waves")
    assert now(human)["states"]["waving"] == "wave"
    human.page.keyboard.press(key)
    human.until(lambda: now(human)["states"]["waving"] == "rest", "it waves no more")


def test_a_gamepad_is_analog(human: StudioPage) -> None:
    human.ask("gamepad", {"axes": [0, -0.45, 0, 0], "buttons": []})
    human.until(lambda: now(human)["states"]["body"] == "move", "it walks")
    human.until(lambda: 0.5 < now(human)["parameters"]["speed"][0] < graphs.WALK_M_S, "slower than W")
    human.ask("gamepad", {"axes": [0, -1, 0, 0], "buttons": []})
    human.until(lambda: now(human)["parameters"]["speed"][0] > 0.97 * graphs.RUN_M_S, "it runs")
    human.ask("gamepad", {"axes": [0, 0, 0, 0], "buttons": [0]})
    human.until(lambda: now(human)["states"]["body"] == "jump", "its first button jumps")
    human.ask("gamepad", {"axes": [0, 0, 0.9, 0], "buttons": []})
    before = now(human)["heading"]
    human.until(lambda: abs(now(human)["heading"] - before) > 0.3, "the right stick turns the camera")
    human.ask("gamepad", None)
    human.until(lambda: now(human)["parameters"]["speed"][0] < 0.01, "it stops")


def test_from_a_key_to_the_step_that_obeys_it(human: StudioPage) -> None:
    """At most two pictures and 15 ms, which is under 50 ms at 60 Hz; all but the graphics card included."""
    human.page.set_viewport_size({"width": 420, "height": 360})
    human.page.evaluate("keypose.play.left = keypose.play.right = false")
    human.page.wait_for_timeout(300)
    human.page.evaluate(
        """() => {
          keypose.play.latencies = [];
          window.pictures = [];
          const note = (now) => { window.pictures.push(now); requestAnimationFrame(note); };
          requestAnimationFrame(note);
        }"""
    )
    for _ in range(12):
        human.page.keyboard.down("w")
        human.page.wait_for_timeout(130)
        human.page.keyboard.up("w")
        human.page.wait_for_timeout(130)
    waits = sorted(now(human)["latencies"])
    between = np.diff(human.page.evaluate("window.pictures"))
    assert len(waits) >= 18
    assert waits[len(waits) // 2] < 2 * max(np.median(between), 1000 / 60) + 15, (waits, between)


def test_keys_in_a_field_do_not_drive(human: StudioPage) -> None:
    slider = human.page.get_by_label("speed", exact=True)
    slider.focus()
    human.page.keyboard.press("ArrowRight")
    human.until(lambda: now(human)["parameters"]["speed"][0] > 0.01, "the slider moves by its own keys")
    assert "forward" not in human.page.evaluate("[...keypose.play.playing.driver.held]")
    human.page.keyboard.press("Home")
    human.until(lambda: now(human)["parameters"]["speed"][0] < 0.01, "and back")


def test_the_look_follows_the_pointer(human: StudioPage) -> None:
    box = human.test_id("play-canvas").bounding_box()
    human.page.mouse.move(box["x"] + 0.1 * box["width"], box["y"] + 0.4 * box["height"])
    human.page.keyboard.press("l")
    human.until(lambda: now(human)["parameters"]["look"][0] > 0.95, "it looks")
    human.until(
        lambda: now(human)["parameters"]["look_at"][0] > 0.5, "to the left of the picture, which is its own left"
    )
    human.page.mouse.move(box["x"] + 0.9 * box["width"], box["y"] + 0.4 * box["height"])
    human.until(lambda: now(human)["parameters"]["look_at"][0] < -0.5, "to the right")


# ---- what is shown ---------------------------------------------------------------------------------------------------


def test_weights_in_the_graph_sum_to_one(human: StudioPage) -> None:
    human.page.evaluate("keypose.play.set({speed: [2.2]})")
    human.until(lambda: now(human)["parameters"]["speed"][0] > 2.1, "between walking and running")
    human.until(lambda: now(human)["states"]["body"] == "move", "it moves")
    nodes = now(human)["shares"]
    for n, node in enumerate(nodes):
        shares = [child["share"] for child in nodes if child["parent"] == n]
        if node["kind"].startswith("blend") or node["kind"] == "state_machine":
            assert sum(shares) == pytest.approx(1.0, abs=1e-5), node["name"]
    walk, run = (next(node["share"] for node in nodes if node["name"] == name) for name in ("walk", "run"))
    assert 0.3 < walk < 0.7
    assert 0.3 < run < 0.7


def test_a_joint_says_which_clip_moves_it(human: StudioPage) -> None:
    names = human.page.evaluate("keypose.play.playing.actor.rig.names")
    human.page.wait_for_timeout(500)
    x, y = human.ask("playJointOnScreen", names.index("RightForeArm"))
    human.page.mouse.click(x, y)
    human.until(lambda: now(human)["joint"] >= 0, "a click on the arm explains a joint of it")
    assert "Right" in names[now(human)["joint"]]
    human.page.get_by_label("Joint", exact=True).select_option(label="RightHand")
    human.page.evaluate("document.activeElement.blur()")
    human.page.keyboard.press("e")
    human.until(lambda: now(human)["contributions"].get("wave", 0) > 0.95, "the wave moves the hand")
    assert sum(now(human)["contributions"].values()) == pytest.approx(1.0, abs=1e-5)
    assert "wave" in human.test_id("joint-shares").inner_text()
    human.page.keyboard.press("Escape")
    human.until(lambda: now(human)["joint"] == -1, "Escape explains nothing")


def test_feet_states_and_costs_are_read_out(human: StudioPage) -> None:
    human.page.keyboard.down("w")
    human.until(lambda: min(now(human)["contacts"]) >= 2, "both feet touch the ground in turn")
    human.until(lambda: human.test_id("state-body").inner_text() == "move", "the state is shown")
    assert "µs" in human.test_id("cost").inner_text()
    box = human.test_id("strip").bounding_box()
    human.page.mouse.move(box["x"] + box["width"] - 14, box["y"] + 24)
    human.until(
        lambda: "body: move" in human.page.locator(".strip .tip").inner_text(),
        "the strip says what is under the pointer",
    )


def test_a_picture_is_saved(human: StudioPage, tmp_path: Path) -> None:
    human.draw()
    with human.page.expect_download() as waiting:
        human.page.keyboard.press("v")
    waiting.value.save_as(tmp_path / "shot.png")
    picture = np.asarray(Image.open(tmp_path / "shot.png").convert("RGB"), np.int16)
    box = human.test_id("play-canvas").bounding_box()
    assert picture.shape[:2] == (round(box["height"]), round(box["width"]))
    assert picture.std() > 5, "the picture is not empty"


def test_pause_one_step_slow_motion_and_reset(human: StudioPage) -> None:
    human.page.keyboard.press("p")
    human.until(lambda: now(human)["paused"], "it pauses")
    human.page.wait_for_timeout(200)
    held = now(human)["time"]
    human.page.wait_for_timeout(200)
    assert now(human)["time"] == held
    human.page.keyboard.press(".")
    human.until(lambda: now(human)["time"] == pytest.approx(held + 1 / 60, abs=1e-6), "one step")
    human.test_id("play-pause").click()
    human.test_id("play-speed").select_option("0.25")
    human.page.wait_for_timeout(100)
    began, start = time.monotonic(), now(human)["time"]
    human.page.wait_for_timeout(800)
    assert now(human)["time"] - start < 0.4 * (time.monotonic() - began)
    human.test_id("play-reset").click()
    human.until(lambda: now(human)["time"] < 0.2, "from the beginning")


def test_a_hidden_page_gets_nothing_and_goes_on_where_it_was(human: StudioPage) -> None:
    human.page.keyboard.down("w")
    human.until(lambda: now(human)["root"][1] > 0.3, "it walks")
    human.ask("hide", True)
    human.page.wait_for_timeout(300)
    before = now(human)
    human.page.wait_for_timeout(1200)
    hidden = now(human)
    assert hidden["received"] - before["received"] <= 3
    human.ask("hide", False)
    human.until(lambda: now(human)["received"] > hidden["received"] + 3, "it goes on")
    assert now(human)["time"] - hidden["time"] < 0.9


def test_a_recording_downloads_and_loads_with_as_many_frames(human: StudioPage, tmp_path: Path) -> None:
    human.page.keyboard.press("r")
    human.page.keyboard.down("w")
    human.until(lambda: (now(human)["recorded"] or 0) > 1.2, "a second is recorded")
    human.test_id("record").click()
    take = human.until(lambda: now(human)["takes"], "it is baked")[0]
    assert take["frames"] >= 72
    for kind in ("GLB", "BVH"):
        with human.page.expect_download() as waiting:
            human.test_id("take").get_by_role("button", name=kind).click()
        path = tmp_path / waiting.value.suggested_filename
        waiting.value.save_as(path)
        scene = io.load(path)
        animation = scene.animations[0]
        assert animation.duration_s == pytest.approx((take["frames"] - 1) / 60, abs=1e-4)
        if kind == "BVH":
            assert animation.frame_count == take["frames"]
        else:
            assert max(len(curve.times_s) for curve in animation.curves.values()) == take["frames"]
            assert len(scene.character.parts) > 5


def test_a_step_costs_the_page_less_than_four_milliseconds(human: StudioPage) -> None:
    human.page.keyboard.down("w")
    human.until(lambda: now(human)["states"]["body"] == "move", "it walks")
    human.ask("resetPlayStats")
    stats = human.until(lambda: (s := now(human)["stats"])["frames"] >= 24 and s, "24 frames are drawn", 25)
    assert stats["script"] < 4.0, stats


@pytest.mark.parametrize("size", [(1920, 1080), (1280, 720), (800, 600), (420, 760)])
def test_nothing_overflows(human: StudioPage, size: tuple[int, int]) -> None:
    human.page.set_viewport_size({"width": size[0], "height": size[1]})
    assert human.page.evaluate("document.documentElement.scrollWidth") == size[0]
    assert human.page.evaluate("document.documentElement.scrollHeight") == size[1]
    for name in ("play-pause", "record", "play-canvas", "page-view", "strip"):
        box = human.test_id(name).bounding_box()
        assert box["x"] >= 0, name
        assert box["x"] + box["width"] <= size[0] + 0.5, name
        assert box["y"] + box["height"] <= size[1] + 0.5, name


def test_the_help_panel_lists_the_keys_of_this_page(human: StudioPage) -> None:
    human.page.keyboard.press("?")
    text = human.test_id("help-panel").inner_text()
    assert "Record, or stop and bake" in text
    assert "Range starts here" not in text
    human.page.keyboard.press("Escape")


def test_to_the_view_page_and_back(human: StudioPage) -> None:
    human.page.keyboard.press("m")
    human.until(lambda: human.test_id("canvas").is_visible(), "the view page")
    human.page.wait_for_timeout(300)
    before = now(human)["received"]
    human.page.wait_for_timeout(500)
    assert now(human)["received"] - before <= 3, "a page that is not seen does not play"
    human.test_id("page-play").click()
    human.until(lambda: now(human)["received"] > before + 10, "it plays on")


# ---- any graph -------------------------------------------------------------------------------------------------------


def test_any_graph_gets_its_own_panel_and_keys(start: Start, visit: Visit) -> None:
    page = playing(visit(start(graphs=[opened_arm()])))
    roles = now(page)["roles"]
    assert roles["speed"]["name"] == "speed"
    assert [(a["name"], a["keys"]) for a in roles["actions"]] == [
        ("stop", ["Space"]),
        ("fast", ["E", "1"]),
        ("amount", ["2"]),
    ]
    for name in arm_graph().parameters:
        assert page.test_id(f"parameter-{name}").is_visible()
    page.page.get_by_label("goal y").fill("2")
    page.until(lambda: now(page)["parameters"]["goal"] == [0, 2, 0], "a vector's part is set")
    page.page.get_by_label("level").fill("1")
    page.test_id("parameter-stop").get_by_role("button").click()
    page.until(lambda: now(page)["states"]["modes"] == "rest", "a trigger is pulled")
    page.page.keyboard.press(" ")
    page.until(lambda: now(page)["states"]["modes"] == "slow", "the space bar pulls it too")
    page.page.keyboard.down("w")
    page.until(lambda: now(page)["parameters"]["speed"] == [2], "W drives the blend space")
    page.page.keyboard.up("w")
    page.page.get_by_test_id("graph-select").select_option(label="locomotion")
    page.until(
        lambda: now(page)["graph"] == "sample:locomotion" and "body" in now(page)["states"], "another graph plays", 30
    )


def test_a_flat_blend_space_is_driven_in_both_directions(start: Start, visit: Visit) -> None:
    clips = {"sway": g.ClipSource("arm", "sway")}
    places = {"a": (0.0, 0.0), "b": (2.0, 0.0), "c": (0.0, 3.0), "d": (-1.0, -1.0)}
    nodes: dict[str, g.Node] = {name: g.ClipNode("sway") for name in places}
    nodes["field"] = g.Blend2D("east", "north", tuple(g.Sample2D(n, at) for n, at in places.items()))
    graph = g.Graph(nodes, "field", {"east": g.Parameter(), "north": g.Parameter()}, clips, character="arm")
    page = playing(visit(start(graphs=[OpenedGraph("file:0", "flat.json", graph, lambda _: arm_scene())])))
    page.page.keyboard.down("Shift")
    page.page.keyboard.down("w")
    page.until(lambda: now(page)["parameters"]["north"] == [3], "ahead")
    page.page.keyboard.up("w")
    page.page.keyboard.down("a")
    page.until(lambda: now(page)["parameters"]["east"] == [-1], "left")
    page.page.keyboard.up("a")
    shares = [n["share"] for n in now(page)["shares"] if n["parent"] == 0]
    assert sum(shares) == pytest.approx(1.0, abs=1e-6)


def test_a_graph_that_cannot_be_played_says_why_on_the_page(start: Start, visit: Visit) -> None:
    def missing(_: str) -> Any:
        raise FormatError("no such file", path="gone.glb")

    page = visit(start(graphs=[OpenedGraph("file:0", "broken.json", arm_graph(), missing)]))
    page.until(lambda: page.test_id("refused").count() == 1, "it is refused")
    assert "broken.json: gone.glb: no such file" in page.test_id("refused").inner_text()
    page.page.get_by_role("button", name="Play the built-in graph").click()
    playing(page)


def test_a_graph_is_dropped_and_played_and_a_broken_one_says_why(start: Start, visit: Visit) -> None:
    page = visit(start(("arm.glb", arm_scene())), actors=1)
    assert now(page)["page"] == "view"
    drop(page, ("bad.json", b'{"format": "keypose-graph", "version": 1, "nodes": {}, "output": "x"}'))
    toast = page.until(lambda: page.state("toasts"), "it is refused")[0]
    assert "bad.json" in toast["message"]
    assert now(page)["page"] == "view"
    data = g.to_json(graphs.locomotion()).replace('"name": "locomotion"', '"name": "mine"').encode()
    drop(page, ("mine.json", data))
    playing(page)
    assert now(page)["graph"] == "dropped:mine.json"
    drop(page, ("other.json", data.replace(b'"name": "mine"', b'"name": "other"')))
    page.until(lambda: now(page)["graph"] == "dropped:other.json", "the newest one plays")
    page.until(lambda: now(page)["playing"] and now(page)["time"] < 3, "from its beginning")
    page.page.reload()
    page.ready()
    page.until(lambda: now(page)["page"] == "play", "the page is kept over a reload")
