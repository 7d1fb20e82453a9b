"""Graph editor and dope sheet, driven with a real mouse; what happened is read as numbers."""

from __future__ import annotations

import functools
import http.server
import subprocess
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from tests.conftest import ROOT
from tests.io.gltf_node import node_executable, npm_package

pytestmark = pytest.mark.browser

ARM, BALL, HEAD, SMILE = (
    "\0".join((*name.split("."), "")) for name in ("LeftArm.euler", "ball.translation", "Head.rotation", "smile.weight")
)
FRAME = 1 / 25


class Views:
    """The harness: the curve views with a document of their own (client/harness)."""

    def __init__(self, page: Any) -> None:
        self.page, self.mouse, self.keyboard = page, page.mouse, page.keyboard
        self.complaints: list[str] = []
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on(
            "console", lambda m: self.complaints.append(m.text) if m.type == "error" and "404" not in m.text else None
        )

    def ask(self, name: str, *given: Any) -> Any:
        return self.page.evaluate("([name, given]) => keypose.test.curves[name](...given)", [name, list(given)])

    def state(self, key: str) -> Any:
        return self.ask("state")[key]

    def settle(self) -> None:
        """Until a picture was drawn of what is now."""
        self.page.evaluate(
            "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(0))))"
        )

    def curve(self, channel: str) -> dict[str, Any]:
        found = self.ask("curve", channel)
        found["values"] = np.array(found["values"]).reshape(len(found["times"]), -1)
        found["times"] = np.array(found["times"])
        return found

    def frames(self, channel: str) -> list[float]:
        return [round(t * 25, 6) for t in self.curve(channel)["times"]]

    def labels(self) -> list[str]:
        return self.page.evaluate("() => harness.editor.labels")

    def pick(self, *rows: str) -> None:
        """Rows of the tree whose curves alone are shown, framed."""
        for n, row in enumerate(rows):
            self.page.click(f"[data-row='{row}'] .name", modifiers=["Control"] if n else [])
        self.ask("frame", "all")
        self.settle()

    def drag(self, start: Any, by: tuple[float, float], *modifiers: str, steps: int = 5) -> None:
        x, y = start
        self.mouse.move(x, y)
        for key in modifiers:
            self.keyboard.down(key)
        self.mouse.down()
        self.mouse.move(x + by[0], y + by[1], steps=steps)
        self.settle()
        self.mouse.up()
        for key in modifiers:
            self.keyboard.up(key)
        self.settle()

    def click(self, at: Any, *modifiers: str, button: str = "left") -> None:
        for key in modifiers:
            self.keyboard.down(key)
        self.mouse.click(*at, button=button)
        for key in modifiers:
            self.keyboard.up(key)
        self.settle()

    def menu(self, label: str) -> None:
        self.page.get_by_role("menuitem", name=label, exact=True).click()
        self.settle()

    def selected(self) -> dict[str, list[int]]:
        return {s["channel"]: s["keys"] for s in self.state("selection")}

    def per_frame(self) -> float:
        return self.state("view")["perSecond"] / 25

    def per_unit(self) -> float:
        return self.state("view")["perUnit"]


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The harness, built and served."""
    vite = npm_package("vite")
    out = tmp_path_factory.mktemp("harness")
    command = [node_executable(), vite / "bin" / "vite.js", "build", "--config", "harness/vite.config.ts"]
    options = ["--outDir", out, "--emptyOutDir", "--logLevel", "warn"]
    done = subprocess.run(
        [*command, *options], cwd=ROOT / "client", capture_output=True, text=True, timeout=180, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: Any) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(out)))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/index.html"
    server.shutdown()
    thread.join(10)


@pytest.fixture
def views(chromium: Any, address: str) -> Iterator[Callable[..., Views]]:
    opened: list[Views] = []
    contexts: list[Any] = []

    def visit(scene: str = "few", size: tuple[int, int] = (1280, 480)) -> Views:
        contexts.append(chromium.new_context(viewport={"width": size[0], "height": size[1]}))
        opened.append(Views(contexts[-1].new_page()))
        opened[-1].page.goto(f"{address}?scene={scene}")
        opened[-1].settle()
        return opened[-1]

    yield visit
    for context in contexts:
        context.close()
    for page in opened:
        assert page.complaints == []


@pytest.fixture
def arm(views: Callable[..., Views]) -> Views:
    """The graph with the three angles of one joint."""
    page = views()
    page.pick("t:LeftArm")
    return page


# ---- graph -----------------------------------------------------------------------------------------------------------


def test_a_key_goes_where_it_is_dragged(arm: Views) -> None:
    before = arm.curve(ARM)
    arm.drag(arm.ask("key", ARM, 2, 2), (6 * arm.per_frame() + 2, -30))
    after = arm.curve(ARM)
    assert arm.frames(ARM) == [0, 12, 30, 48, 60, 96], "it lands on a whole frame"
    change = after["values"] - before["values"]
    # a screen's pixel may be half off
    assert np.degrees(change[2, 2]) == pytest.approx(30 / arm.per_unit(), abs=0.6 / arm.per_unit())
    change[2, 2] = 0
    assert not change.any(), "no other component and no other key"
    assert arm.labels() == ["Move keys"], "one step of undo"
    assert arm.selected() == {ARM: [2]}
    arm.keyboard.press("Control+z")
    again = arm.curve(ARM)
    for name in ("times", "values", "inHandles", "outHandles", "types"):
        assert np.array_equal(again[name], before[name]), name


def test_shift_keeps_to_one_axis_and_alt_lets_go_of_frames(arm: Views) -> None:
    before = arm.curve(ARM)
    arm.drag(arm.ask("key", ARM, 2, 2), (4 * arm.per_frame(), 9))
    x, y = arm.ask("key", ARM, 2, 2)
    arm.mouse.move(x, y)
    arm.mouse.down()
    arm.keyboard.down("Shift")
    arm.mouse.move(x + 3, y + 40, steps=3)
    arm.settle()
    arm.keyboard.up("Shift")
    assert "frame" not in arm.state("readout")
    arm.mouse.up()
    assert arm.frames(ARM)[2] == 28
    arm.click(arm.ask("key", ARM, 1, 2))
    x, y = arm.ask("key", ARM, 1, 2)
    arm.mouse.move(x, y)
    arm.mouse.down()
    arm.keyboard.down("Alt")
    arm.mouse.move(x + 2.4 * arm.per_frame(), y, steps=3)
    arm.settle()
    arm.mouse.up()
    arm.keyboard.up("Alt")
    assert arm.frames(ARM)[1] == pytest.approx(14.4, abs=0.06)
    assert np.array_equal(arm.curve(ARM)["values"][[0, 3, 4, 5]], before["values"][[0, 3, 4, 5]])


def test_control_snaps_values_to_the_grid(arm: Views) -> None:
    x, y = arm.ask("key", ARM, 3, 2)
    arm.mouse.move(x, y)
    arm.mouse.down()
    arm.keyboard.down("Control")
    arm.mouse.move(x, y - 52, steps=3)
    arm.settle()
    arm.mouse.up()
    arm.keyboard.up("Control")
    degrees = np.degrees(arm.curve(ARM)["values"][3, 2])
    assert degrees == pytest.approx(60, abs=1e-9)


def test_escape_gives_everything_back(arm: Views) -> None:
    before = arm.curve(ARM)
    x, y = arm.ask("key", ARM, 2, 2)
    arm.mouse.move(x, y)
    arm.mouse.down()
    arm.mouse.move(x + 80, y + 30, steps=4)
    arm.settle()
    assert arm.state("dragging")
    assert not np.array_equal(arm.curve(ARM)["times"], before["times"]), "it is shown while it is dragged"
    arm.keyboard.press("Escape")
    arm.mouse.up()
    arm.settle()
    assert np.array_equal(arm.curve(ARM)["values"], before["values"])
    assert arm.labels() == []


def test_a_handle_bends_its_curve_and_keeps_the_other_side_in_line(arm: Views) -> None:
    arm.click(arm.ask("key", ARM, 2, 2))
    x, y = arm.ask("handle", ARM, 2, 1, 2)
    before = arm.curve(ARM)
    arm.drag((x, y), (20, 36))
    after = arm.curve(ARM)
    handles = np.array(after["outHandles"]).reshape(6, 3, 2)[2, 2]
    old = np.array(before["outHandles"]).reshape(6, 3, 2)[2, 2]
    assert handles[0] - old[0] == pytest.approx(
        20 / arm.state("view")["perSecond"], abs=0.6 / arm.state("view")["perSecond"]
    )
    assert np.degrees(handles[1] - old[1]) == pytest.approx(-36 / arm.per_unit(), abs=0.6 / arm.per_unit())
    back = np.array(after["inHandles"]).reshape(6, 3, 2)[2, 2]
    assert back[1] / back[0] == pytest.approx(handles[1] / handles[0])
    assert after["types"][4:6] == [1, 1], "aligned from now on"
    assert arm.labels() == ["Move a handle"]


def test_a_box_selects_adds_and_removes(arm: Views) -> None:
    def box(first: int, last: int, *modifiers: str) -> None:
        (x0, y0), (x1, y1) = arm.ask("key", ARM, first, 2), arm.ask("key", ARM, last, 2)
        low, high = min(y0, y1) - 14, max(y0, y1) + 14
        arm.drag((x0 - 14, low), (x1 - x0 + 28, high - low), *modifiers)

    box(1, 2)
    assert arm.state("selection") == [{"channel": ARM, "keys": [1, 2], "masks": [4, 4]}]
    box(4, 4, "Shift")
    assert arm.selected() == {ARM: [1, 2, 4]}
    box(2, 2, "Control")
    assert arm.selected() == {ARM: [1, 4]}
    view = arm.state("view")
    arm.click(arm.ask("place", 80 * FRAME, arm.page.evaluate("0") + 85))
    assert arm.selected() == {}
    assert arm.state("view") == view


def test_a_click_on_a_curve_selects_its_keys_and_with_control_makes_one(arm: Views) -> None:
    time = 30 * FRAME
    value = np.degrees(value_at(arm, ARM, time)[2])
    arm.click(arm.ask("place", time, value))
    assert arm.state("selection") == [{"channel": ARM, "keys": [0, 1, 2, 3, 4, 5], "masks": [4] * 6}]
    before = [value_at(arm, ARM, t) for t in np.linspace(0, 4, 60)]
    arm.click(arm.ask("place", time, value), "Control")
    assert arm.frames(ARM) == [0, 12, 24, 30, 48, 60, 96]
    after = [value_at(arm, ARM, t) for t in np.linspace(0, 4, 60)]
    assert np.allclose(before, after, atol=1e-9), "the motion stays"
    assert arm.labels() == ["Insert keys"]


def value_at(page: Views, channel: str, time: float) -> np.ndarray:
    """Python's value of the curve that is shown."""
    from keypose import evaluate
    from keypose.model import Curve, CurveKind

    c = page.curve(channel)
    shape = (*c["values"].shape, 2)
    curve = Curve(
        c["times"], c["values"], np.array(c["modes"], np.uint8), kind=CurveKind.VECTOR,
        in_handles=np.array(c["inHandles"]).reshape(shape), out_handles=np.array(c["outHandles"]).reshape(shape),
    )  # fmt: skip
    return evaluate.sample_curve(curve, time)


def test_the_box_around_the_selection_scales_it(arm: Views) -> None:
    arm.click(arm.ask("key", ARM, 1, 2))
    arm.click(arm.ask("key", ARM, 2, 2), "Shift")
    arm.click(arm.ask("key", ARM, 3, 2), "Shift")
    before = arm.curve(ARM)
    (x0, _), (x1, _) = arm.ask("key", ARM, 1, 2), arm.ask("key", ARM, 3, 2)
    top, bottom = (arm.ask("key", ARM, k, 2)[1] for k in (2, 3))
    # the grip in the middle of the right side, drawn nine pixels outside
    arm.drag((x1 + 9, (top + bottom) / 2), ((x1 - x0) / 6, 0))
    assert arm.frames(ARM)[1:4] == pytest.approx([12, 12 + 12 * 7 / 6, 12 + 36 * 7 / 6], abs=0.1)
    assert np.array_equal(arm.curve(ARM)["values"], before["values"])
    assert arm.labels() == ["Scale keys"]
    arm.keyboard.press("Control+z")
    arm.settle()
    arm.drag(((x0 + x1) / 2, top - 9), (0, -(bottom - top)))
    values = np.degrees(arm.curve(ARM)["values"][:, 2])
    assert values[3] == pytest.approx(40)
    assert values[2] - 40 == pytest.approx(2 * (92 - 40), abs=0.5)
    assert np.array_equal(arm.curve(ARM)["values"][:, :2], before["values"][:, :2])


def test_keys_are_grabbed_and_scaled_from_the_keyboard(arm: Views) -> None:
    arm.click(arm.ask("key", ARM, 4, 2))
    x, y = arm.ask("key", ARM, 4, 2)
    arm.keyboard.press("g")
    arm.keyboard.press("x")
    arm.mouse.move(x + 5 * arm.per_frame(), y + 60, steps=4)
    arm.settle()
    arm.mouse.click(x + 5 * arm.per_frame(), y + 60)
    arm.settle()
    assert arm.frames(ARM)[4] == 65
    assert np.degrees(arm.curve(ARM)["values"][4, 2]) == pytest.approx(71), "x keeps the value"
    arm.keyboard.press("Shift+D")
    arm.mouse.move(x + 15 * arm.per_frame(), y + 60, steps=4)
    arm.settle()
    arm.keyboard.press("Enter")
    arm.settle()
    assert arm.frames(ARM) == [0, 12, 24, 48, 65, 75, 96]
    arm.keyboard.press("g")
    arm.mouse.move(x + 40 * arm.per_frame(), y, steps=4)
    arm.settle()
    arm.mouse.click(x, y, button="right")
    arm.settle()
    assert arm.frames(ARM) == [0, 12, 24, 48, 65, 75, 96], "the right button gives back"
    arm.keyboard.press("x")
    assert arm.frames(ARM) == [0, 12, 24, 48, 65, 96]
    assert arm.labels() == ["Move keys", "Duplicate keys", "Delete keys"]


def test_menus_set_interpolation_tangents_and_ends(arm: Views) -> None:
    arm.click(arm.ask("key", ARM, 2, 2))
    arm.keyboard.press("t")
    arm.menu("Linear")
    assert arm.curve(ARM)["modes"] == [3, 3, 1, 3, 3, 3]
    arm.keyboard.press("t")
    arm.menu("Bezier")
    arm.keyboard.press("v")
    arm.menu("Vector")
    assert arm.curve(ARM)["types"][4:6] == [2, 2]
    out = np.array(arm.curve(ARM)["outHandles"]).reshape(6, 3, 2)[2, 2]
    values = arm.curve(ARM)["values"][:, 2]
    assert out[1] / out[0] == pytest.approx((values[3] - values[2]) / (24 * FRAME))
    arm.keyboard.press("Shift+E")
    arm.page.get_by_role("menuitem", name="Cycle with offset", exact=True).nth(1).click()
    assert (arm.curve(ARM)["before"], arm.curve(ARM)["after"]) == ("hold", "cycle_offset")
    arm.click(arm.ask("key", ARM, 2, 2), button="right")
    assert "Snap to frames" in arm.state("menu")
    arm.keyboard.press("Escape")
    assert arm.state("menu") is None


def test_copy_and_paste_at_the_playhead(arm: Views) -> None:
    arm.click(arm.ask("key", ARM, 1, 2))
    arm.click(arm.ask("key", ARM, 2, 2), "Shift")
    arm.keyboard.press("Control+c")
    arm.click(arm.ask("ruler", 70 * FRAME))
    arm.mouse.move(*arm.ask("place", 1, 40))
    arm.keyboard.press("Control+v")
    arm.settle()
    assert arm.frames(ARM) == [0, 12, 24, 48, 60, 70, 82, 96]
    assert np.array_equal(arm.curve(ARM)["values"][[5, 6]], arm.curve(ARM)["values"][[1, 2]])
    assert arm.selected() == {ARM: [5, 6]}
    arm.keyboard.press("Control+z")
    arm.keyboard.press("Control+Shift+V")
    arm.settle()
    assert np.array_equal(arm.curve(ARM)["values"][[5, 6]], arm.curve(ARM)["values"][[2, 1]])


def test_numbers_of_the_active_key_can_be_typed(arm: Views) -> None:
    arm.click(arm.ask("key", ARM, 2, 2))
    for name, text in (("key-frame", "27"), ("key-value", "80.5"), ("handle-frames-1", "5"), ("handle-value-1", "-10")):
        arm.page.get_by_test_id(name).fill(text)
        arm.page.get_by_test_id(name).press("Enter")
        arm.settle()
    assert arm.frames(ARM)[2] == 27
    assert np.degrees(arm.curve(ARM)["values"][2]).tolist() == pytest.approx([20, -14, 80.5])
    handle = np.array(arm.curve(ARM)["outHandles"]).reshape(6, 3, 2)[2, 2]
    assert handle[0] == pytest.approx(5 * FRAME)
    assert np.degrees(handle[1]) == pytest.approx(-10)


def test_wheel_and_middle_button_move_the_view(arm: Views) -> None:
    view = arm.ask("place", 1.2, 30)
    at = [round(n) for n in view]
    slip = np.subtract(view, at)
    arm.mouse.move(*at)
    before = arm.state("view")
    arm.mouse.wheel(0, -200)
    arm.settle()
    zoomed = arm.state("view")
    assert zoomed["perSecond"] > before["perSecond"]
    assert zoomed["perUnit"] > before["perUnit"]
    grown = [zoomed[name] / before[name] for name in ("perSecond", "perUnit")]
    assert np.allclose(arm.ask("place", 1.2, 30), at + slip * grown, atol=0.01), "about the pointer"
    arm.mouse.down(button="middle")
    arm.mouse.move(at[0] + 50, at[1] + 20, steps=4)
    arm.settle()
    arm.mouse.up(button="middle")
    assert np.allclose(arm.ask("place", 1.2, 30), at + slip * grown + [50, 20], atol=0.01)
    assert arm.labels() == []
    arm.click(arm.ask("key", ARM, 1, 2))
    arm.keyboard.press("f")
    arm.settle()
    x, y = arm.ask("key", ARM, 1, 2)
    assert 600 < x < 920
    assert 200 < y < 340


def test_rotations_stay_rotations(views: Callable[..., Views]) -> None:
    page = views()
    page.pick("t:Head")
    before = page.curve(HEAD)["values"]
    page.drag(page.ask("key", HEAD, 1, 2), (0, -25))
    after = page.curve(HEAD)["values"]
    assert np.allclose(np.linalg.norm(after, axis=1), 1)
    assert after[1, 2] - before[1, 2] == pytest.approx(25 / page.per_unit(), abs=0.6 / page.per_unit())


def test_normalised_curves_fill_the_same_height_and_move_alike(views: Callable[..., Views]) -> None:
    page = views()
    page.pick("t:LeftArm", "t:smile")
    page.page.get_by_test_id("normalise").click()
    page.settle()
    tops = [min(page.ask("key", c, k, n)[1] for k in range(count)) for c, n, count in ((ARM, 2, 6), (SMILE, 0, 4))]
    assert tops[0] == pytest.approx(tops[1])
    before = page.curve(SMILE)["values"][2, 0]
    x, y = page.ask("key", SMILE, 2)
    page.drag((x, y), (0, 22))
    assert page.curve(SMILE)["values"][2, 0] - before == pytest.approx(
        -22 / page.per_unit() / 2, abs=0.5 / page.per_unit()
    )


# ---- tree --------------------------------------------------------------------------------------------------------------


def test_search_hide_solo_and_lock(views: Callable[..., Views]) -> None:
    page = views()
    page.page.get_by_test_id("channel-search").fill("left rot")
    page.settle()
    assert {line["channel"].split("\0")[0] for line in page.state("lines")} == {"LeftArm", "LeftHand"}
    page.page.get_by_test_id("channel-search").fill("")
    page.page.hover("[data-row='t:LeftArm']")
    page.page.get_by_role("button", name="Solo LeftArm").click()
    page.settle()
    assert {line["channel"] for line in page.state("lines")} == {ARM}
    page.page.get_by_role("button", name="Solo LeftArm").click()
    page.page.get_by_role("button", name="Hide LeftArm").click()
    page.settle()
    assert ARM not in {line["channel"] for line in page.state("lines")}
    page.page.get_by_role("button", name="Show LeftArm").click()
    page.page.get_by_role("button", name="Lock LeftArm").click()
    page.pick("t:LeftArm")
    page.click(page.ask("key", ARM, 2, 2))
    assert page.selected() == {}
    page.page.get_by_role("button", name="Unfold Rotation").first.click()
    page.settle()
    assert page.page.locator("[data-row^='c:LeftArm'] .value").count() == 3


# ---- dope sheet ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def dope(views: Callable[..., Views]) -> Views:
    page = views()
    page.page.get_by_test_id("show-dope").click()
    page.settle()
    return page


def test_a_diamond_of_the_summary_moves_all_keys_of_its_time(dope: Views) -> None:
    dope.drag(dope.ask("row", "all", 12 * FRAME), (-5 * dope.per_frame(), 0))
    assert dope.frames(ARM)[1] == 7
    assert dope.frames(BALL)[1] == 7
    assert dope.labels() == ["Move keys"]
    dope.keyboard.press("Control+z")
    assert dope.frames(ARM)[1] == 12


def test_rows_select_their_own_keys_and_boxes_several(dope: Views) -> None:
    dope.click(dope.ask("row", "t:LeftArm", 24 * FRAME))
    assert dope.selected() == {ARM: [2]}
    start, end = dope.ask("row", "t:LeftArm", 20 * FRAME), dope.ask("row", "t:LeftHand", 62 * FRAME)
    dope.drag((start[0], start[1] - 8), (end[0] - start[0], end[1] - start[1] + 8))
    selected = dope.selected()
    assert selected[ARM] == [2, 3, 4]
    assert len(selected) == 2
    # the grip at the left end of the box on the summary row
    x = dope.ask("row", "all", 24 * FRAME)[0]
    y = dope.ask("row", "all", 0)[1]
    span = 36 * dope.per_frame()
    dope.drag((x - 9, y), (span / 2, 0))
    assert dope.frames(ARM) == pytest.approx([0, 12, 42, 54, 60, 96], abs=0.1)
    dope.keyboard.press("Control+z")
    dope.keyboard.press("Shift+S")
    assert dope.frames(ARM) == [0, 12, 24, 48, 60, 96]


def test_ripple_takes_later_keys_along(dope: Views) -> None:
    dope.page.get_by_test_id("ripple").click()
    dope.drag(dope.ask("row", "t:LeftArm", 24 * FRAME), (8 * dope.per_frame(), 0))
    assert dope.frames(ARM) == [0, 12, 32, 56, 68, 104]
    dope.drag(dope.ask("row", "t:LeftArm", 32 * FRAME), (-60 * dope.per_frame(), 0))
    assert dope.frames(ARM) == [0, 12, 13, 37, 49, 85], "not past the key before"


def test_the_ruler_scrubs_and_moves_range_and_markers(dope: Views) -> None:
    dope.drag(dope.ask("ruler", 30 * FRAME), (10 * dope.per_frame(), 0))
    assert dope.page.evaluate("harness.editor.time") == pytest.approx(40 * FRAME)
    x, y = dope.ask("ruler", 96 * FRAME)
    dope.drag((x - 2, y), (-20 * dope.per_frame(), 0))
    assert dope.page.evaluate("harness.editor.timeline.end") == pytest.approx(76 * FRAME)
    x, y = dope.ask("ruler", 48 * FRAME)
    dope.drag((x, y + 22), (4 * dope.per_frame(), 0))
    assert dope.page.evaluate("harness.editor.timeline.markers[1].time") == pytest.approx(52 * FRAME)
    x, y = dope.ask("ruler", 60 * FRAME)
    dope.click((x, y), button="right")
    dope.menu("Marker here")
    dope.page.get_by_label("Name of the marker").fill("land")
    dope.page.get_by_label("Name of the marker").press("Enter")
    dope.settle()
    assert dope.page.evaluate("harness.editor.timeline.markers.at(-1).name") == "land"
    assert dope.labels() == ["Move the end", "Move a marker", "Add a marker", "Rename a marker"]


# ---- many keys -----------------------------------------------------------------------------------------------------------


def test_dragging_ten_thousand_keys_draws_only_what_they_change(views: Callable[..., Views]) -> None:
    page = views("dense", (1280, 720))
    page.page.evaluate(
        """() => {
          const { editor } = keypose.test.curves.session();
          editor.selection = new Map(editor.channels.map((c) => [c.channel.key, Uint32Array.from({ length: 50 }, (_, k) => 200 + k)]));
        }"""
    )
    page.settle()
    channel = "joint_00\0translation\0"
    x, y = page.ask("key", channel, 220, 0)
    assert page.state("selected") == 10_000
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y - 6)
    page.settle()

    def traced(places: list[tuple[float, float]]) -> float:
        """Spans that are traced for a picture, while nothing else is drawn anew."""
        before = page.ask("counts")
        for place in places:
            page.mouse.move(*place)
            page.settle()
        after = page.ask("counts")
        assert after["built"] == before["built"], "no path of a whole curve is made anew"
        assert after["backdrops"] == before["backdrops"], "what stands still is not drawn again"
        assert after["frames"] - before["frames"] >= len(places)
        return (after["traced"] - before["traced"]) / (after["frames"] - before["frames"])

    # 200 channels of three components, 50 keys and two neighbours that their tangents reach on either side
    assert traced([(x, y - 8 - n) for n in range(5)]) <= 200 * 3 * 54
    # past other keys: what was swept over, and a little more so that it need not grow with every picture
    page.mouse.move(x + 6, y)
    page.settle()
    assert traced([(x + 6 + n, y) for n in range(3)]) <= 200 * 3 * 80
    page.mouse.up()
    page.settle()
    assert page.labels() == ["Move keys"]
