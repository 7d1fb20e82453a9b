"""The edit page in a real browser: edits, undo to the byte, layers, files, recovery, keys, and how it looks."""

from __future__ import annotations

import base64
import hashlib
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edit_ui import EditUi
from studio_page import StudioPage
from studio_scenes import Start, arm_scene

from keypose import evaluate, io
from keypose.io.native import document_bytes
from keypose.project import file
from keypose.project.workspace import Workspace
from keypose.studio import StudioServer

pytestmark = pytest.mark.browser

Visit = Callable[..., StudioPage]


@pytest.fixture(scope="module")
def server(start: Start) -> StudioServer:
    return start()


@pytest.fixture(scope="module")
def shared(chromium: Any, server: StudioServer) -> Iterator[EditUi]:
    """One page for the tests that need no other."""
    context = chromium.new_context(
        viewport={"width": 1280, "height": 720}, color_scheme="dark", reduced_motion="reduce"
    )
    context.set_default_timeout(8_000)
    studio = StudioPage(context.new_page())
    studio.page.goto(server.url)
    studio.ready(0)
    yield EditUi(studio, server)
    context.close()


@pytest.fixture
def ui(shared: EditUi) -> Iterator[EditUi]:
    """A new project with the ball; the test fails if the page complains."""
    shared.studio.complaints.clear()
    shared.begin("sample:ball")
    yield shared
    assert shared.studio.complaints == []


def digest(ui: EditUi) -> str:
    return hashlib.sha256(ui.bytes()).hexdigest()


def keyed_ball(ui: EditUi) -> None:
    ui.select("Ball")
    ui.test_id("auto-key").click()
    for frame, height in ((0, 1.5), (10, 0.25), (20, 1.25)):
        ui.frame(frame)
        ui.type("translation-1", height)
    ui.test_id("auto-key").click()


# ---- edits and undo --------------------------------------------------------------------------------------------------


def test_every_edit_can_be_undone_to_the_byte(ui: EditUi) -> None:
    keyed_ball(ui)
    rng = random.Random(7)
    page = ui.page

    def drag_value() -> None:
        ui.tab("joint")
        if ui.state()["autoKey"] is False:
            ui.test_id("auto-key").click()
        ui.frame(rng.randrange(0, 40))
        ui.drag(
            f"[data-testid={rng.choice(['translation', 'scale', 'euler'])}-{rng.randrange(3)}]",
            (rng.randrange(10, 90), 0),
        )

    def key_menu() -> None:
        ui.select(rng.choice(["Ball", "Squash", "Spin"]))
        ui.frame(rng.randrange(0, 40))
        ui.key(rng.choice(["Location", "Rotation", "Scale", "Location, rotation and scale"]))

    def remove_key() -> None:
        ui.select("Ball")
        ui.tab("joint")
        ui.press("ArrowUp" if ui.state()["frame"] < 20 else "ArrowDown")
        dot = ui.test_id("dot-translation")
        if dot.get_attribute("data-state") == "key":
            dot.click()

    def layer() -> None:
        ui.test_id(rng.choice(["layer-add", "layer-add-additive"])).click()

    def flags() -> None:
        names = [each["name"] for each in ui.state()["timeline"]["layers"]]
        page.get_by_role("button", name=f"{rng.choice(['Mute', 'Solo'])} {rng.choice(names)}", exact=True).click()

    def influence() -> None:
        ui.tab("clip")
        ui.drag("[data-testid=influence]", (rng.randrange(-40, 10), 0))

    def key_influence() -> None:
        ui.tab("clip")
        ui.test_id("dot-influence").click()

    def mask() -> None:
        ui.tab("clip")
        ui.select(rng.choice(["Ball", "Squash"]))
        ui.test_id("mask").click()

    def range_and_marker() -> None:
        ui.type("transport-end", rng.randrange(30, 90))
        ui.press("m")

    def exposure() -> None:
        ui.tab("clip")
        ui.test_id("exposure").select_option(str(rng.randrange(4)))

    def placement() -> None:
        ui.tab("clip")
        ui.type("placement-speed", rng.choice([0.5, 2, 1.25]))

    def operator() -> None:
        page.locator("[data-layer=Base] .pick").click()
        ui.select("Ball")
        ui.tab("operators")
        ui.test_id(f"operator-{rng.choice(['ease', 'slow_in_out', 'overshoot'])}").click()
        ui.test_id("operator-run").click()

    def drag_key() -> None:
        page.locator("[data-layer=Base] .pick").click()
        ui.select("Ball")
        ui.press("Home", "curves")
        x, y = page.evaluate("() => keypose.test.curves.key('Ball\\0translation\\0', 1, 1)")
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 9, y - 12)
        page.mouse.move(x + 23, y - 20)
        page.mouse.up()

    kinds = [
        drag_value,
        key_menu,
        remove_key,
        layer,
        flags,
        influence,
        key_influence,
        mask,
        range_and_marker,
        exposure,
        placement,
        operator,
        drag_key,
    ]
    order = kinds + rng.choices(kinds, k=5)
    rng.shuffle(order)
    for act in order:
        act()
        ui.settled()
    done = ui.state()["past"]
    assert len(done) >= len(order), done
    seen = [digest(ui)]
    while ui.state()["undo"]:
        ui.press("Control+z")
        ui.settled()
        seen.append(digest(ui))
    assert len(seen) == len(done) + 1
    assert ui.state()["characters"], "the project began with its character"
    assert len(set(seen)) == len(seen), "every step changes something"
    for wanted in reversed(seen[:-1]):
        ui.press("Control+Shift+z")
        ui.settled()
        assert digest(ui) == wanted, ui.state()["undo"]
    # the page holds what the server holds
    mine = ui.curves()
    ui.page.evaluate("keypose.test.editRefetch()")
    ui.settled()
    assert ui.curves() == mine


def test_the_list_of_steps_goes_back_and_forth(ui: EditUi) -> None:
    keyed_ball(ui)
    after = digest(ui)
    ui.test_id("history").click()
    rows = ui.test_id("history-list").get_by_role("option")
    assert rows.count() == 4
    rows.last.click()
    ui.studio.until(lambda: not ui.state()["undo"] and ui.state()["settled"], "all is undone")
    assert ui.curves() == {}
    rows.first.click()
    ui.studio.until(lambda: not ui.state()["redo"] and ui.state()["settled"], "all is done again")
    assert digest(ui) == after
    ui.test_id("history").click(force=True)
    ui.page.mouse.click(5, 400)


def test_a_refused_edit_is_rolled_back(ui: EditUi) -> None:
    keyed_ball(ui)
    before = digest(ui)
    shown = ui.page.evaluate(
        """() => {
          const { editor } = keypose;
          const [name, timeline] = [...editor.document.timelines][0];
          const [layer] = timeline.layers;
          const broken = { ...timeline, layers: [{ ...layer, placements: [{ ...layer.placements[0], animation: "nowhere" }] }] };
          editor.commit("Place nothing", { timelines: new Map([[name, broken]]) });
          return editor.placement.animation;
        }"""
    )
    assert shown == "nowhere", "shown at once"
    ui.studio.until(lambda: ui.studio.state("toasts"), "it is said")
    ui.settled()
    assert "Place nothing" in ui.studio.state("toasts")[0]["title"]
    assert ui.page.evaluate("keypose.editor.placement.animation") != "nowhere"
    assert digest(ui) == before
    assert all("400" in complaint for complaint in ui.studio.complaints)  # the browser's own word on the answer
    ui.studio.complaints.clear()


def test_two_pages_see_the_same(ui: EditUi, visit: Visit, server: StudioServer) -> None:
    other = EditUi(visit(server, size=(900, 600)), server)
    keyed_ball(ui)
    other.studio.until(lambda: other.curves() == ui.curves(), "the other page has the keys")
    other.press("Control+z")
    other.settled()
    ui.studio.until(lambda: len(ui.curves()["Ball.translation"]["times"]) == 2, "the first page has undone it too")
    assert other.curves() == ui.curves()


def test_a_locked_layer_and_a_locked_channel_do_not_change(ui: EditUi) -> None:
    keyed_ball(ui)
    ui.page.get_by_role("button", name="Lock Base", exact=True).click()
    ui.settled()
    before = digest(ui)
    ui.frame(30)
    ui.key("Location")
    assert digest(ui) == before
    assert "locked" in ui.studio.state("toasts")[-1]["title"]
    ui.page.get_by_role("button", name="Lock Base", exact=True).click()
    ui.settled()
    ui.page.evaluate("keypose.editor.locked = new Set(['Ball\\0translation\\0'])")
    before = digest(ui)
    ui.key("Location")
    assert digest(ui) == before
    ui.page.evaluate("keypose.editor.locked = new Set()")
    ui.key("Location")
    assert digest(ui) != before


# ---- posing and keying -----------------------------------------------------------------------------------------------


def test_what_is_posed_lasts_until_time_moves_or_it_is_keyed(ui: EditUi) -> None:
    ui.select("Ball")
    ui.type("translation-1", 2)
    assert ui.local("Ball", 0)["translation"][1] == 2
    assert ui.curves() == {}
    ui.press("ArrowRight")
    assert ui.local("Ball", 1)["translation"][1] == pytest.approx(0.25)
    ui.type("euler-1", 370)
    ui.key("Rotation")
    assert ui.curves()["Ball.euler"]["values"][1] == pytest.approx(np.deg2rad(370)), "whole turns are kept"
    ui.test_id("dot-euler").click()
    ui.settled()
    assert ui.curves() == {}, "the diamond takes the key away again"


def test_layers_are_what_python_makes_of_them(ui: EditUi) -> None:
    keyed_ball(ui)
    ui.test_id("layer-add-additive").click()
    ui.settled()
    assert ui.state()["layer"] == "Additive"
    ui.select("Ball")
    ui.test_id("auto-key").click()
    ui.frame(5)
    ui.type("translation-0", 1)
    ui.frame(15)
    ui.type("euler-2", 90)
    ui.type("translation-1", 3)  # keyed on the layer so that the whole gives it
    ui.test_id("auto-key").click()
    assert ui.local("Ball", 15)["translation"][1] == pytest.approx(3, abs=1e-9)
    ui.test_id("layer-add").click()
    ui.settled()
    ui.select("Squash")
    ui.frame(8)
    ui.type("scale-1", 0.5)
    ui.key("Scale")
    ui.tab("clip")
    ui.drag("[data-testid=influence]", (-20, 0))
    ui.frame(0)
    ui.test_id("dot-influence").click()
    ui.settled()
    ui.frame(20)
    ui.drag("[data-testid=influence]", (30, 0))
    ui.test_id("exposure").select_option("2")
    ui.settled()
    layers = ui.state()["timeline"]["layers"]
    assert [each["name"] for each in layers] == ["Base", "Additive", "Layer"]
    assert len(layers[2]["influence"]["times"]) == 2

    def agree() -> None:
        document = ui.document()
        timeline, skeleton = document.timeline("Ball"), document.character("Ball").skeleton
        for frame in (0, 3, 5.5, 8, 9, 15, 19.9, 33):
            pose = evaluate.sample_timeline(timeline, document.clips, skeleton, frame / 25)
            for n, joint in enumerate(skeleton.names):
                shown = ui.local(joint, frame)
                assert np.abs(np.array(shown["translation"]) - pose.translations[n]).max() < 1e-6, (joint, frame)
                assert np.abs(np.array(shown["scale"]) - pose.scales[n]).max() < 1e-6, (joint, frame)
                assert 1 - abs(np.dot(shown["rotation"], pose.rotations[n])) < 1e-9, (joint, frame)

    agree()
    for flag in ("Mute Base", "Solo Layer"):
        ui.page.get_by_role("button", name=flag, exact=True).click()
        ui.settled()
        agree()
    # the uppermost is dragged below all others, and renamed
    handle, target = ui.page.locator("[data-layer=Layer] .handle"), ui.page.locator("[data-layer=Base]")
    handle.drag_to(target)
    ui.settled()
    assert [each["name"] for each in ui.state()["timeline"]["layers"]] == ["Layer", "Base", "Additive"]
    ui.page.locator("[data-layer=Additive] .pick").dblclick()
    ui.page.keyboard.type("Lean")
    ui.page.keyboard.press("Enter")
    ui.settled()
    assert [each["name"] for each in ui.state()["timeline"]["layers"]] == ["Layer", "Base", "Lean"]
    agree()


# ---- files -----------------------------------------------------------------------------------------------------------


def test_save_change_guard_and_recover(ui: EditUi, tmp_path: Path) -> None:
    keyed_ball(ui)
    path = tmp_path / "ball.keypose"
    ui.press("Control+Shift+s")
    ui.test_id("save-name").fill(str(path))
    ui.test_id("save-go").click()
    ui.studio.until(lambda: not ui.state()["unsaved"], "saved")
    assert document_bytes(file.load(path)) == ui.bytes()
    ui.frame(30)
    ui.key("Location")
    assert ui.state()["unsaved"]
    ui.press("Control+s")
    ui.studio.until(lambda: not ui.state()["unsaved"], "saved again, without a question")
    assert document_bytes(file.load(path)) == ui.bytes()
    ui.frame(35)
    ui.key("Location")
    changed = ui.bytes()
    # another project: the change is not lost
    ui.test_id("project-menu").click()
    ui.page.get_by_role("menuitem", name="New project…").click()
    ui.test_id("new-name").fill("Other")
    ui.page.get_by_role("button", name="Empty project").click()
    ui.test_id("guard-keep").click()
    ui.studio.until(lambda: ui.state()["name"] == "Other", "another project")
    assert ui.test_id("edit-start").is_visible()
    ui.studio.until(
        lambda: any(r["name"] == "ball" or r["name"] == "Test" for r in ui.state()["recoverable"]), "offered"
    )
    ui.test_id("offer-recovery").click()
    ui.test_id("recoverable").get_by_role("button", name="Recover").first.click()
    ui.arrived()
    assert ui.bytes() == changed
    assert ui.state()["unsaved"]


def test_an_ended_studio_offers_what_was_not_saved(start: Start, visit: Visit, tmp_path: Path) -> None:
    state = tmp_path / "state"
    state.mkdir()
    first = start(state=state)
    ui = EditUi(visit(first), first)
    ui.test_id("sample-ball").click()
    ui.arrived()
    keyed_ball(ui)
    wanted = ui.bytes()
    first.stop()
    ui.studio.until(lambda: not ui.page.evaluate("keypose.studio.online"), "the server is gone")
    ui.studio.until(lambda: Workspace(state).recoverable(), "the studio has let go of it")
    ui.page.goto("about:blank")
    ui.studio.complaints.clear()  # the page said that it cannot reach its server
    second = start(state=state)
    again = EditUi(visit(second), second)
    assert again.state()["dialog"] == "recover"
    again.test_id("recoverable").get_by_role("button", name="Recover").click()
    again.arrived()
    assert again.bytes() == wanted


def test_files_of_the_timeline_are_downloaded(ui: EditUi, tmp_path: Path) -> None:
    keyed_ball(ui)
    for kind in ("bvh", "glb"):
        ui.press("Control+e")
        with ui.page.expect_download() as download:
            ui.test_id(f"export-{kind}").click()
        download.value.save_as(tmp_path / f"ball.{kind}")
        assert (tmp_path / f"ball.{kind}").stat().st_size > 500
        assert download.value.suggested_filename == f"Test.{kind}"


# ---- commands and keys -----------------------------------------------------------------------------------------------


def test_the_palette_finds_and_does(ui: EditUi) -> None:
    keyed_ball(ui)
    ui.press("F3")
    ui.page.keyboard.type("addlay")
    ui.page.keyboard.press("Enter")
    ui.settled()
    assert len(ui.state()["timeline"]["layers"]) == 2
    ui.press("Control+k")
    ui.page.keyboard.press("Escape")
    assert ui.test_id("palette").count() == 0


def test_no_key_means_two_things(ui: EditUi) -> None:
    commands = ui.studio.ask("editCommands")
    assert len({c["id"] for c in commands}) == len(commands) > 60
    for keys in ("blender", "maya"):
        taken: dict[tuple[str, str], str] = {}
        for command in commands:
            for key in command[keys].split():
                place = (key, command["area"])
                assert place not in taken, f"{keys}: {key} is {taken[place]} and {command['id']}"
                taken[place] = command["id"]
    labels = [c["label"] for c in commands]
    assert all(label and label[0].isupper() for label in labels)


def test_the_help_is_the_table_in_both_key_maps(ui: EditUi) -> None:
    ui.press("?")
    panel = ui.test_id("help-panel")
    assert "Insert keys" in panel.inner_text()
    ui.test_id("keys-maya").click()
    assert "Key location, rotation and scale" in panel.inner_text()
    ui.page.keyboard.press("Escape")
    ui.select("Ball")
    ui.page.mouse.move(640, 690)  # over the curves, where S is scaling only if keys are selected
    ui.press("Shift+w")
    ui.settled()
    assert list(ui.curves()) == ["Ball.translation"]
    ui.press("z")
    ui.settled()
    assert ui.curves() == {}
    ui.press("?")
    ui.test_id("keys-blender").click()
    ui.page.keyboard.press("Escape")


# ---- how it looks ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(1920, 1080), (1280, 720), (1000, 640)])
def test_nothing_overlaps_and_everything_says_what_it_is(ui: EditUi, size: tuple[int, int]) -> None:
    keyed_ball(ui)
    page = ui.page
    page.set_viewport_size({"width": size[0], "height": size[1]})
    assert page.evaluate("document.documentElement.scrollWidth") == size[0]
    assert page.evaluate("document.documentElement.scrollHeight") == size[1]
    names = ("edit-left-panel", "canvas", "edit-right-panel", "edit-bottom")
    boxes = [ui.test_id(name).bounding_box() for name in names]
    for n, a in enumerate(boxes):
        assert a["width"] > 100 and a["height"] > 100, names[n]
        for b in boxes[n + 1 :]:
            apart = a["x"] + a["width"] <= b["x"] + 1 or b["x"] + b["width"] <= a["x"] + 1
            assert apart or a["y"] + a["height"] <= b["y"] + 1 or b["y"] + b["height"] <= a["y"] + 1
    silent = """() => [...document.querySelectorAll("button, input, select, [role=treeitem]")]
        .filter((e) => e.offsetParent && !e.closest("[title]")).map((e) => e.outerHTML.slice(0, 120))"""
    # controls of one bar do not lie on each other
    crowded = """() => [...document.querySelectorAll("header, .transport, [role=toolbar]")].filter((bar) => bar.offsetParent).flatMap((bar) => {
      const own = [...bar.querySelectorAll("button")].filter((b) => b.offsetParent).map((b) => [b, b.getBoundingClientRect()]);
      return own.flatMap(([a, p], n) => own.slice(n + 1).filter(([b, q]) => !a.contains(b) && p.left < q.right - 1 && q.left < p.right - 1
        && p.top < q.bottom - 1 && q.top < p.bottom - 1).map(([b]) => `${a.title} / ${b.title}`));
    })"""
    for tab in ("joint", "operators", "poses", "clip"):
        ui.tab(tab)
        assert page.evaluate(silent) == [], tab
    assert page.evaluate(crowded) == []
    page.set_viewport_size({"width": 1280, "height": 720})


def test_an_imported_animation_is_placed_and_renamed(ui: EditUi) -> None:
    ui.test_id("project-menu").click()
    ui.page.get_by_role("menuitem", name="Import an animation…").click()
    ui.test_id("import-bounce").click()
    ui.studio.until(
        lambda: len(ui.page.evaluate("[...keypose.editor.document.clips.keys()]")) == 2, "the clip is there"
    )
    ui.settled()
    name = ui.page.evaluate("[...keypose.editor.document.clips.keys()][1]")
    ui.frame(10)
    ui.tab("clip")
    ui.test_id("place-clip").select_option(name)
    ui.settled()
    assert ui.state()["clip"] == name
    placed = ui.state()["timeline"]["layers"][0]["placements"][1]
    assert (placed["animation"], placed["start"]) == (name, 0.4)
    document = ui.document()
    skeleton = document.character("Ball").skeleton
    for frame in (10, 14.5, 30):
        pose = evaluate.sample_timeline(document.timeline("Ball"), document.clips, skeleton, frame / 25)
        assert np.abs(np.array(ui.local("Ball", frame)["translation"]) - pose.translations[0]).max() < 1e-6
    ui.page.locator(".placement.active").dblclick()
    ui.page.keyboard.type("hop")
    ui.page.keyboard.press("Enter")
    ui.studio.until(lambda: ui.state()["clip"] == "hop", "it has another name everywhere")


def test_a_dropped_character_is_taken_into_the_project(ui: EditUi, tmp_path: Path) -> None:
    io.save(arm_scene(), tmp_path / "arm.glb")
    ui.page.evaluate(
        """(text) => {
          const transfer = new DataTransfer();
          transfer.items.add(new File([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))], "arm.glb"));
          window.dispatchEvent(new DragEvent("drop", { dataTransfer: transfer, bubbles: true, cancelable: true }));
        }""",
        base64.b64encode((tmp_path / "arm.glb").read_bytes()).decode(),
    )
    ui.studio.until(
        lambda: any("arm.glb" in t["title"] for t in ui.studio.state("toasts")), "it is said that it is open"
    )
    assert len(ui.studio.state("actors")) == 1, "it is not on this page's stage yet"
    ui.test_id("add-character").click()
    ui.test_id("character-pick").get_by_role("button", name="arm.glb").click()
    ui.studio.until(lambda: len(ui.state()["characters"]) == 2, "two characters")
    ui.arrived()
    ui.page.get_by_test_id("edit-characters").locator(".pick").last.click()
    joints = ui.page.evaluate("keypose.editor.actor.rig.names")
    ui.select(joints[-1])
    ui.key("Rotation")
    assert [c.split(".")[0] for c in ui.curves()] == [joints[-1]]
    ui.page.get_by_test_id("page-view").click()
    assert [a["name"] for a in ui.studio.state("actors")] == ["arm"], "the View page shows the file"
    ui.page.get_by_test_id("page-edit").click()
    assert len(ui.studio.state("actors")) == 2
    ui.page.evaluate("keypose.studio.close(keypose.studio.files[0].id)")
