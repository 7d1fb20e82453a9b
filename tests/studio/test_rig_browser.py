"""Rigs on the edit page: controls are picked, dragged and keyed there, and joints go where Python says."""

from __future__ import annotations

import http.client
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edit_ui import EditUi
from studio_page import StudioPage
from studio_scenes import Start

from keypose import io, samples
from keypose.evaluate import world_rotations_positions
from keypose.io.native import document_from_bytes
from keypose.model import Document, Scene
from keypose.rig import sample_rig
from keypose.studio import StudioServer

pytestmark = [pytest.mark.browser, pytest.mark.slow]

ACTOR = "keypose.studio.actors[0]"


class RigUi(EditUi):
    """The edit page with a rigged character."""

    def add_rig(self) -> None:
        self.tab("rig")
        self.test_id("rig-add").click()
        self.studio.until(
            lambda: self.page.evaluate(f"{ACTOR} ? {ACTOR}.rig.count - {ACTOR}.rig.jointCount : 0") > 0, "controls", 60
        )
        self.rested()

    def rested(self) -> None:
        """Wait until the rig's joints are those of what is shown."""
        self.settled()
        self.studio.until(lambda: self.page.evaluate("keypose.editor.rigging.settled"), "the rig has settled", 60)
        self.page.wait_for_timeout(30)

    def hook(self, name: str, *arguments: Any) -> Any:
        return self.page.evaluate("([name, args]) => keypose.test.viewport[name](...args)", [name, list(arguments)])

    def drag(self, control: str, by: tuple[float, float], steps: int = 12) -> None:
        """Take a control by a click, move it with G and the pointer, and let it go."""
        self.hook("selectJoints", [control])
        x, y = self.hook("pointOf", control)
        self.page.mouse.move(x, y)
        self.page.keyboard.press("g")
        for n in range(1, steps + 1):
            self.page.mouse.move(x + by[0] * n / steps, y + by[1] * n / steps)
            self.page.wait_for_timeout(15)
        self.page.mouse.down()
        self.page.mouse.up()
        self.rested()

    def bytes(self) -> bytes:
        connection = http.client.HTTPConnection("127.0.0.1", self.server.port)
        connection.request("GET", "/api/project/export/keypose", headers={"X-Keypose-Token": self.server.token})
        data = connection.getresponse().read()
        connection.close()
        return data

    def document(self) -> Document:
        return document_from_bytes(self.bytes())

    def places(self, time_s: float) -> np.ndarray:
        """Where the page puts the joints at a time."""
        return np.array(
            self.page.evaluate(
                f"""(time) => {{
                  const actor = {ACTOR}, {{ rig }} = actor;
                  actor.evaluate(time);
                  return Array.from({{ length: rig.jointCount }}, (_, j) => [...rig.world.subarray(12 * j + 9, 12 * j + 12)]);
                }}""",
                time_s,
            )
        )

    def python_places(self, time_s: float) -> np.ndarray:
        """Where the library puts them."""
        document = self.document()
        (name, who), *_ = document.characters.items()
        rig, line = document.rig_of(name), document.timeline(document.performs[name])
        assert rig is not None
        pose = sample_rig(rig, who.skeleton, line, document.clips, np.array([time_s])).pose
        return np.asarray(world_rotations_positions(who.skeleton, pose)[1])[0]


@pytest.fixture(scope="module")
def opened(chromium: Any, start: Start) -> Iterator[Callable[[str, Scene, str], RigUi]]:
    contexts: list[Any] = []

    def run(name: str, scene: Scene, character: str) -> RigUi:
        server: StudioServer = start((name, scene))
        context = chromium.new_context(
            viewport={"width": 1280, "height": 720}, color_scheme="dark", reduced_motion="reduce"
        )
        context.set_default_timeout(30_000)
        contexts.append(context)
        studio = StudioPage(context.new_page())
        studio.page.goto(server.url)
        studio.ready(1)
        ui = RigUi(studio, server)
        ui.begin(character)
        return ui

    yield run
    for context in contexts:
        context.close()


@pytest.fixture
def human(opened: Any) -> Iterator[RigUi]:
    ui = opened("sample:human", samples.open_scene("sample:human"), "sample:human")
    ui.add_rig()
    yield ui
    assert ui.studio.complaints == []


def test_a_hand_is_dragged_keyed_played_and_undone_to_the_byte(human: RigUi) -> None:
    ui = human
    kept = [ui.bytes()]
    at_rest = ui.places(0.0)
    ui.page.evaluate("keypose.editor.autoKey = true")
    ui.hook("selectJoints", ["hand_ik.L"])
    ui.test_id("rig-ik").click()
    ui.rested()
    np.testing.assert_allclose(ui.places(0.0), at_rest, atol=1e-6)  # going over to IK moves nothing
    kept.append(ui.bytes())
    for frame, way in ((0, (-50.0, -55.0)), (20, (40.0, -30.0)), (40, (-30.0, 80.0))):
        ui.page.evaluate(f"keypose.editor.seekFrame({frame})")
        ui.rested()
        ui.drag("hand_ik.L", way)
        kept.append(ui.bytes())
        hand, control = ui.hook("placeOf", "LeftHand"), ui.hook("placeOf", "hand_ik.L")
        assert np.linalg.norm(np.subtract(hand, control)) < 1e-6
    curves = ui.document().clips[next(iter(ui.document().clips))].curves
    assert {c.target: curve.key_count for c, curve in curves.items()} == {"arm.L.ik": 1, "hand_ik.L": 3}
    # on frames and between them, joints are the library's (the page blends between frames of the track)
    for frame in (0, 7, 20, 33, 40):
        time_s = frame / 25
        np.testing.assert_allclose(ui.places(time_s), ui.python_places(time_s), atol=2e-6)
    between = 10.5 / 25
    assert np.abs(ui.places(between) - ui.python_places(between)).max() < 2e-3
    for steps, wanted in enumerate(reversed(kept[:-1]), 1):
        ui.press("Control+z")
        ui.rested()
        assert ui.bytes() == wanted, f"after {steps} steps back"
    for wanted in kept[1:]:
        ui.press("Control+Shift+z")
        ui.rested()
        assert ui.bytes() == wanted


def test_numbers_spaces_and_fk_keep_the_pose(human: RigUi) -> None:
    ui = human
    ui.page.evaluate("keypose.editor.autoKey = true")
    ui.hook("selectJoints", ["hand_ik.R"])
    ui.test_id("rig-ik").click()
    ui.rested()
    ui.drag("hand_ik.R", (70.0, -90.0))
    posed = ui.places(0.0)
    space = ui.test_id("rig-space")
    labels = space.locator("option").all_inner_texts()
    assert len(labels) > 2
    space.select_option(label=labels[-1])
    ui.rested()
    np.testing.assert_allclose(ui.places(0.0), posed, atol=1e-5)
    ui.press("Shift+K")
    ui.rested()
    np.testing.assert_allclose(ui.places(0.0), posed, atol=1e-5)
    assert ui.document().clips[next(iter(ui.document().clips))].curves  # FK controls are keyed now
    np.testing.assert_allclose(ui.python_places(0.0), posed, atol=1e-5)
    # a foot rolls on its ball: the toes stay
    toes = ui.hook("placeOf", "RightToeBase")
    ui.hook("selectJoints", ["foot_ik.R"])
    ui.type("rig-value-foot.R.roll", 30)
    ui.rested()
    assert np.linalg.norm(np.subtract(ui.hook("placeOf", "RightToeBase"), toes)) < 2e-3
    assert ui.hook("placeOf", "RightFoot")[1] > posed[ui.page.evaluate(f"{ACTOR}.rig.index('RightFoot')")][1] + 0.02


def test_what_was_posed_by_hand_is_keyed_with_its_numbers(human: RigUi) -> None:
    ui = human
    ui.hook("selectJoints", ["hand_ik.L"])
    ui.test_id("rig-ik").click()
    ui.rested()
    ui.drag("hand_ik.L", (-40.0, -50.0))
    posed = ui.places(0.0)
    assert ui.document().clips[next(iter(ui.document().clips))].curves == {}
    ui.press("k")
    ui.rested()
    assert ui.page.evaluate("keypose.editor.posed.size") == 0
    np.testing.assert_allclose(ui.python_places(0.0), posed, atol=1e-5)


def test_controls_are_picked_on_the_stage(human: RigUi) -> None:
    ui = human
    x, y = ui.hook("pointOf", "look")
    ui.page.mouse.move(x, y)
    found = None
    for dx in range(-30, 31, 3):  # the outline lies around its centre
        found = ui.hook("jointAt", x + dx, y)
        if found == "look":
            ui.page.mouse.click(x + dx, y)
            break
    assert found == "look"
    assert ui.state()["selectedJoints"] == ["look"]
    assert ui.test_id("list-controls").get_attribute("aria-pressed") == "true"
    ui.test_id("show-controls").click()
    assert ui.hook("jointAt", x, y) != "look"


@pytest.mark.data
@pytest.mark.parametrize("name", ["vrm/debug_robot.vrm", "fbx/geno/Geno.fbx"])
def test_real_characters_are_rigged_and_dragged(opened: Any, data_dir: Path, name: str) -> None:
    path = data_dir / name
    scene = io.load(path)
    ui = opened(path.name, scene, "s1")
    ui.add_rig()
    ui.page.evaluate("keypose.editor.autoKey = true")
    ui.hook("selectJoints", ["hand_ik.L"])
    ui.test_id("rig-ik").click()
    ui.rested()
    ui.drag("hand_ik.L", (-30.0, -60.0))
    size = float(np.ptp(ui.places(0.0)[:, 1]))
    np.testing.assert_allclose(ui.places(0.0), ui.python_places(0.0), atol=1e-6 * max(1.0, size))
    assert ui.studio.complaints == []
