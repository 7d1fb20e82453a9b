"""The crowd page in a real browser: a hundred characters that move, levels of detail, and a tab that nobody sees."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image
from play_graphs import opened_arm
from studio_page import StudioPage
from studio_scenes import Start

from keypose.studio.crowd_show import CrowdShow, View
from keypose.studio.graphs import built_in

pytestmark = [pytest.mark.browser, pytest.mark.slow]

COUNT = 100


def now(page: StudioPage) -> dict[str, Any]:
    return page.ask("crowd")


def roots(page: StudioPage) -> np.ndarray:
    return np.array(page.ask("crowdRoots")).reshape(-1, 3)


def shown(page: StudioPage) -> StudioPage:
    page.until(lambda: now(page)["ready"] and now(page)["received"] > 3, "the crowd is there", 120)
    return page


@pytest.fixture(scope="module")
def shared(chromium: Any, start: Start) -> Iterator[StudioPage]:
    """One page with a hundred characters; small, because a software renderer draws its picture."""
    graph = built_in("locomotion")
    # kernels that must be compiled first are, before a page waits for them
    CrowdShow(graph.stage(), "locomotion", COUNT, "wander", 1).step(1 / 30, View((0.0, 2.0, 3.0)))
    server = start(graphs=[graph, opened_arm()])
    context = chromium.new_context(viewport={"width": 760, "height": 460}, color_scheme="dark")
    context.set_default_timeout(60_000)
    page = StudioPage(context.new_page())
    page.page.goto(server.url)
    page.ready()
    page.page.evaluate(
        "(n) => { keypose.crowd.count = n; keypose.crowd.look.orbit = false; keypose.crowd.look.shadows = false; }",
        COUNT,
    )
    page.test_id("tab-crowd").click()
    yield shown(page)
    context.close()


@pytest.fixture
def crowd(shared: StudioPage) -> Iterator[StudioPage]:
    shared.complaints.clear()
    shared.ask("crowdHide", False)
    shared.draw(False)
    shared.page.evaluate(
        """() => {
          const c = keypose.crowd;
          c.setPace({ paused: false, speed: 1, rate: 30 }); c.look.byLevel = false;
          if (c.graph !== "sample:locomotion" || c.count !== 100) { c.graph = "sample:locomotion"; c.count = 100; c.open(); }
        }"""
    )
    shown(shared)
    yield shared
    assert shared.complaints == []


def test_a_hundred_characters_really_move(crowd: StudioPage) -> None:
    assert now(crowd)["count"] == COUNT
    before, began = roots(crowd), now(crowd)
    joints = {n: crowd.ask("crowdMatrices", n) for n in (0, 50, 99)}
    crowd.until(lambda: now(crowd)["time"] > began["time"] + 1.5, "time goes on", 60)
    moved = np.linalg.norm(roots(crowd)[:, :2] - before[:, :2], axis=1)
    assert np.sum(moved > 0.1) > 15
    assert np.linalg.norm(roots(crowd)[:, :2], axis=1).max() < now(crowd)["radius"] + 0.5
    for n, matrices in joints.items():
        assert np.abs(np.array(crowd.ask("crowdMatrices", n)) - matrices).max() > 1e-3


def test_the_picture_shows_them_and_changes(crowd: StudioPage) -> None:
    def picture() -> np.ndarray:
        """What the page shows of a moment: a software renderer cannot follow what moves."""
        crowd.draw()
        crowd.page.evaluate("keypose.crowd.setPace({ paused: true })")
        crowd.page.wait_for_timeout(300)
        png = crowd.test_id("crowd-canvas").screenshot()
        crowd.draw(False)
        crowd.page.evaluate("keypose.crowd.setPace({ paused: false })")
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)

    first, began = picture(), now(crowd)["time"]
    crowd.until(lambda: now(crowd)["time"] > began + 1.0, "time goes on", 60)
    assert np.mean(np.abs(picture() - first).max(axis=2) > 30) > 0.01
    # Clothes of many colours, not one: hues of saturated pixels.
    saturated = first[np.ptp(first, axis=2) > 60]
    assert len(saturated) > 500
    strongest = np.bincount(saturated.argmax(axis=1), minlength=3) / len(saturated)
    assert np.sum(strongest > 0.05) >= 2
    box = crowd.test_id("crowd-canvas").bounding_box()
    assert box["x"] >= 0 and box["x"] + box["width"] <= 760  # nothing pushes it out of the window
    stats = now(crowd)["stats"]
    assert stats["visible"] > 50
    assert stats["drawCalls"] < 16  # by level and pass, not by character


def test_near_ones_are_drawn_fine_and_far_ones_coarse(crowd: StudioPage) -> None:
    crowd.ask("crowdLookFrom", [0, 1.5, 3], [0, 1, 0])
    crowd.until(lambda: now(crowd)["inLevel"][0] > 0, "somebody near is fine", 60)
    crowd.ask("crowdLookFrom", [0, 30, 90], [0, 1, 0])
    crowd.until(lambda: now(crowd)["inLevel"][3] == COUNT, "all are coarse", 60)
    radius = now(crowd)["radius"]
    crowd.ask("crowdLookFrom", [0, 3, radius], [0, 1, 0])
    crowd.until(lambda: sum(n > 0 for n in now(crowd)["inLevel"]) >= 2, "several levels", 60)


def test_faces_of_the_near_ones_live(crowd: StudioPage) -> None:
    crowd.ask("crowdLookFrom", [0, 1.6, 2.5], [0, 1.4, 0])
    crowd.until(lambda: now(crowd)["inLevel"][0] > 0, "somebody near is fine", 60)

    def moved() -> bool:
        near = [n for n, level in enumerate(now(crowd)["levels"]) if level == 0]
        return any(max(crowd.ask("crowdMorphs", n)) > 0.1 for n in near)

    crowd.until(moved, "a face moves", 60)


def test_a_hidden_tab_gets_nothing_and_nothing_piles_up(crowd: StudioPage) -> None:
    crowd.ask("crowdHide", True)
    crowd.page.wait_for_timeout(600)
    received, at = now(crowd)["received"], now(crowd)["time"]
    time.sleep(1.5)
    assert now(crowd)["received"] <= received + 2
    crowd.ask("crowdHide", False)
    crowd.until(lambda: now(crowd)["received"] > received + 4, "it goes on", 60)
    assert now(crowd)["time"] < at + 2.0  # where it was, not where it would be


def test_another_page_lets_the_crowd_stand(crowd: StudioPage) -> None:
    crowd.test_id("page-play").click()
    crowd.page.wait_for_timeout(800)
    received = now(crowd)["received"]
    crowd.page.wait_for_timeout(1000)
    assert now(crowd)["received"] <= received + 1
    crowd.test_id("tab-crowd").click()
    crowd.until(lambda: now(crowd)["received"] > received + 3, "it goes on", 60)


def test_pause_and_slow_motion(crowd: StudioPage) -> None:
    crowd.test_id("crowd-pause").click()
    crowd.page.wait_for_timeout(500)
    at = now(crowd)["time"]
    crowd.page.wait_for_timeout(500)
    assert now(crowd)["time"] == at and now(crowd)["paused"]
    crowd.test_id("crowd-speed").select_option("0.1")
    crowd.test_id("crowd-pause").click()
    began, at = time.monotonic(), now(crowd)["time"]
    crowd.until(lambda: now(crowd)["time"] > at + 0.03, "time goes on", 60)
    assert now(crowd)["time"] - at < 0.25 * (time.monotonic() - began) + 0.02


def test_keys(crowd: StudioPage) -> None:
    for key, held in (("l", "byLevel"), ("s", "shadows"), ("d", "grid")):
        before = crowd.page.evaluate(f"keypose.crowd.look.{held}")
        crowd.page.keyboard.press(key)
        assert crowd.page.evaluate(f"keypose.crowd.look.{held}") is not before
        crowd.page.keyboard.press(key)
    crowd.page.keyboard.press("p")
    assert now(crowd)["paused"]
    crowd.page.keyboard.press("p")
    crowd.page.keyboard.press("g")
    assert now(crowd)["followed"] >= 0
    crowd.page.keyboard.press("f")
    assert now(crowd)["followed"] == -1
    assert not crowd.page.evaluate("keypose.play.paused")  # the other tab's keys are not meant


def test_the_camera_goes_along_with_who_is_clicked(crowd: StudioPage) -> None:
    crowd.ask("crowdLookFrom", [0, 20, 26], [0, 0.9, 0])
    crowd.page.wait_for_timeout(400)
    box = crowd.test_id("crowd-canvas").bounding_box()
    hit = False
    for x, y in ((0.5, 0.5), (0.4, 0.5), (0.6, 0.55), (0.5, 0.6), (0.45, 0.4), (0.55, 0.65)):
        for dx in range(-40, 41, 20):
            crowd.page.mouse.click(box["x"] + x * box["width"] + dx, box["y"] + y * box["height"])
            hit = hit or now(crowd)["followed"] >= 0
            if hit:
                break
        if hit:
            break
    assert hit
    who = now(crowd)["followed"]

    def beside() -> bool:
        target = crowd.ask("crowdCamera")["target"]
        x, z, _ = roots(crowd)[who]
        return bool(np.hypot(target[0] - x, target[2] - z) < 0.5)

    crowd.until(beside, "the camera is with the character", 60)
    crowd.test_id("crowd-unfollow").click()
    assert now(crowd)["followed"] == -1


def test_another_behaviour_and_another_number(crowd: StudioPage) -> None:
    crowd.page.evaluate("() => keypose.crowd.setBehaviour('gather')")
    assert now(crowd)["behaviour"] == "gather"
    crowd.page.evaluate("() => { keypose.crowd.count = 25; keypose.crowd.open(); }")
    crowd.until(lambda: now(crowd)["count"] == 25 and now(crowd)["ready"], "another crowd", 120)
    assert len(roots(crowd)) == 25


def test_a_graph_that_nobody_can_steer_is_refused_in_words(crowd: StudioPage) -> None:
    crowd.page.evaluate(
        "() => { keypose.crowd.graph = keypose.studio.graphs.find((g) => g.name === 'arm.json').id; keypose.crowd.open(); }"
    )
    crowd.until(lambda: "'turn'" in now(crowd)["refused"], "it is refused", 60)
    assert crowd.test_id("crowd-refused").is_visible()
