"""Habits of animators on the edit page: a stretch of time is selected, what is posed is taken back, keys work over the rig's panel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from edit_ui import EditUi
from studio_page import StudioPage
from studio_scenes import Start

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def shared(chromium: Any, start: Start) -> Iterator[EditUi]:
    server = start()
    context = chromium.new_context(viewport={"width": 1280, "height": 720}, reduced_motion="reduce")
    context.set_default_timeout(8_000)
    studio = StudioPage(context.new_page())
    studio.page.goto(server.url)
    studio.ready(0)
    yield EditUi(studio, server)
    context.close()


@pytest.fixture
def ui(shared: EditUi) -> Iterator[EditUi]:
    shared.studio.complaints.clear()
    yield shared
    assert shared.studio.complaints == []


def ruler(ui: EditUi, frame: float) -> tuple[float, float]:
    """A place on the ruler."""
    x, y = ui.page.evaluate("(frame) => keypose.test.curves.ruler(frame / keypose.editor.rate)", frame)
    return x, y


def select_time(ui: EditUi, first: float, last: float) -> None:
    ui.page.keyboard.down("Shift")
    ui.page.mouse.move(*ruler(ui, first))
    ui.page.mouse.down()
    for share in (0.3, 0.7, 1.0):
        ui.page.mouse.move(*ruler(ui, first + share * (last - first)))
    ui.page.mouse.up()
    ui.page.keyboard.up("Shift")


def hand(ui: EditUi, frames: range) -> np.ndarray:
    return np.array([ui.local("LeftHand", frame)["position"] for frame in frames])


def test_operators_keep_to_the_selected_time(ui: EditUi) -> None:
    ui.begin("sample:human")
    ui.select("LeftForeArm")
    for frame in (0, 60):
        ui.frame(frame)
        ui.key("Rotation")
    ui.tab("operators")
    ui.test_id("operator-reach").click()
    assert ui.test_id("parameter-first_frame").count() == 1
    select_time(ui, 25.2, 34.7)
    assert np.multiply(ui.state()["span"], ui.page.evaluate("keypose.editor.rate")) == pytest.approx([25, 35])
    assert ui.test_id("parameter-first_frame").count() == 0  # it is said already
    assert ") in frames 25 to 35" in " ".join(ui.test_id("operator-scope").inner_text().split())
    ui.test_id("parameter-joint").select_option("LeftHand")
    ui.type("parameter-ease_s", 0.3)
    before = hand(ui, range(0, 61, 5))
    ui.test_id("operator-run").click()
    ui.settled()
    moved = np.linalg.norm(hand(ui, range(0, 61, 5)) - before, axis=1)
    assert moved[5:8] == pytest.approx(0.1, abs=1e-4)
    assert moved[[0, 1, 2, 3, 9, 10, 11, 12]].max() < 1e-6
    ui.press("Control+z")
    ui.settled()
    assert np.abs(hand(ui, range(0, 61, 5)) - before).max() < 1e-9
    select_time(ui, 20, 20)  # a press alone
    assert ui.state()["span"] is None and ui.test_id("parameter-first_frame").count() == 1


def test_what_is_posed_and_not_keyed_is_taken_back_first(ui: EditUi) -> None:
    ui.begin("sample:ball")
    ui.select("Ball")
    ui.type("translation-1", 1.5)
    ui.type("translation-0", 0.5)
    assert ui.local("Ball", 0)["translation"] == pytest.approx([0.5, 1.5, 0.0])
    ui.press("Control+z")
    assert ui.local("Ball", 0)["translation"][:2] == pytest.approx([0.0, 1.5])
    ui.press("Control+z")
    assert ui.state()["posed"] == [] and ui.local("Ball", 0)["translation"][1] != pytest.approx(1.5)
    assert ui.test_id("undo").is_disabled() and ui.state()["undo"] == ""
    ui.press("Control+Shift+z")
    ui.press("Control+Shift+z")
    assert ui.local("Ball", 0)["translation"] == pytest.approx([0.5, 1.5, 0.0])
    ui.press("k")
    ui.settled()
    assert ui.state()["undo"].startswith("Key") and ui.state()["posed"] == []
    # once keyed, undo goes by the document
    ui.press("Control+z")
    ui.settled()
    assert ui.curves() == {} and ui.state()["posed"] == []


def shares(ui: EditUi, *names: str) -> list[float]:
    told = "(names) => { const { rig } = keypose.editor.actor; return names.map((n) => rig.pose.morphs[rig.attributeIndex(n)]); }"
    return ui.page.evaluate(told, list(names))


def test_a_rig_is_worked_from_its_panel(ui: EditUi) -> None:
    ui.begin("sample:human")
    camera = "keypose.studio.view.orbit.camera.position.toArray()"
    ui.page.evaluate("keypose.studio.view.frameAll('side', true)")
    looked = ui.page.evaluate(camera)
    ui.tab("rig")
    ui.test_id("rig-add").click()
    ui.studio.until(lambda: ui.page.evaluate("keypose.editor.rigging.active !== null"), "controls", 60)
    ui.studio.until(lambda: ui.page.evaluate("keypose.editor.rigging.settled"), "the rig has settled", 60)
    assert ui.page.evaluate(camera) == pytest.approx(looked)  # it is looked at as before
    assert ui.page.evaluate("keypose.studio.toasts.at(-1).message").endswith("controls")

    def pick(*controls: str) -> None:
        ui.page.evaluate("(names) => keypose.test.viewport.selectJoints(names)", list(controls))

    # both arms go over together, from wherever the pointer is
    pick("hand_ik.L", "hand_ik.R")
    ui.test_id("rig-panel").hover()
    assert shares(ui, "arm.L.ik", "arm.R.ik", "leg.L.ik") == [0.0, 0.0, 1.0]
    ui.page.keyboard.press("Shift+K")
    ui.studio.until(lambda: shares(ui, "arm.L.ik", "arm.R.ik") == [1.0, 1.0], "both arms by IK")
    # the numbers of spaces are out of the way until they are asked for
    assert not ui.test_id("rig-shares").evaluate("(e) => e.open")
    # what the slider sets is held, and K over the panel keys it and nothing else of that hand
    slider = ui.test_id("rig-slider-arm.R.soft")
    slider.fill("0.25")
    slider.dispatch_event("change")
    slider.hover()
    ui.page.keyboard.press("k")
    ui.settled()
    keyed = set(ui.curves())
    assert {"arm.R.soft.value", "arm.L.ik.value", "arm.R.ik.value"} <= keyed
    assert not any(name.startswith("leg") for name in keyed)
    # from a control to what hangs on it, and back
    pick("upper_arm.L")
    ui.page.keyboard.press("Alt+ArrowDown")
    assert ui.state()["selectedJoints"] == ["lower_arm.L"]
    ui.page.keyboard.press("Alt+ArrowUp")
    assert ui.state()["selectedJoints"] == ["upper_arm.L"]
