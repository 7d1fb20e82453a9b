"""The retarget page in a real browser: two characters on one clock, figures, the picker of roles, files and the project."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studio_page import StudioPage
from studio_scenes import Start, arm_scene

from keypose import evaluate, io, samples
from keypose.analysis import find_roles
from keypose.model import Motion
from keypose.retarget import ground_under, retarget

pytestmark = [pytest.mark.browser, pytest.mark.slow]


def now(page: StudioPage) -> dict[str, Any]:
    return page.ask("retarget")


def settled(page: StudioPage) -> StudioPage:
    page.until(lambda: (told := now(page))["settled"] and not told["stale"], "the motion is there", 60)
    page.drawn()
    return page


@pytest.fixture(scope="module")
def shared(chromium: Any, start: Start) -> Iterator[StudioPage]:
    """One page for most tests: the built-in walk on the built-in human."""
    server = start(("arm.glb", arm_scene()), ("sample:walk", samples.load("walk")))
    context = chromium.new_context(
        viewport={"width": 960, "height": 600}, color_scheme="dark", reduced_motion="reduce", accept_downloads=True
    )
    context.set_default_timeout(30_000)
    page = StudioPage(context.new_page())
    page.page.goto(server.url)
    page.ready(2)
    page.test_id("page-retarget").click()
    yield settled(page)
    context.close()


@pytest.fixture
def page(shared: StudioPage) -> Iterator[StudioPage]:
    shared.complaints.clear()
    shared.page.evaluate(
        """() => {
          const r = keypose.retarget;
          keypose.studio.turnTo("retarget"); keypose.studio.toasts = [];
          r.pause(); r.tab = "fit"; r.panel = true; r.atRest = true; r.role = null; r.automatic = true; r.side = "target";
          r.look.linked = r.look.prints = true; r.look.follow = false; r.look.surface = "shaded"; r.applyLook();
          r.maps = { source: null, target: null }; r.history.clear(); r.resetOptions();
          if (r.subjects.source.reference !== "sample:walk") void r.choose("source", "sample:walk");
          if (r.subjects.target.reference !== "sample:human") void r.choose("target", "sample:human");
        }"""
    )
    shared.until(
        lambda: (
            [now(shared)["subjects"][side]["reference"] for side in ("source", "target")]
            == ["sample:walk", "sample:human"]
        ),
        "the usual two",
    )
    settled(shared)
    shared.page.evaluate("() => { keypose.retarget.toStart(); keypose.retarget.stages.frame('three-quarter', true); }")
    yield shared
    assert shared.complaints == []


def shown(page: StudioPage, side: str) -> np.ndarray:
    page.drawn()
    return np.array(page.ask("retargetPositions", side))


def places(motion: Motion, skeleton: Any, frame: int) -> np.ndarray:
    return np.asarray(evaluate.world(skeleton, motion.pose.broadcast()))[frame, :, :3, 3]


def test_both_show_the_same_moment_of_what_the_library_makes(page: StudioPage) -> None:
    walk, human = samples.load("walk"), samples.load("human").character
    expected = retarget(
        walk.animations[0], walk.character.skeleton, human.skeleton, target_ground_m=ground_under(human)
    )
    done = now(page)["done"]
    assert done["frames"] == expected.motion.frame_count
    assert done["slide_cm_s"] == pytest.approx(expected.report.slide_cm_s, abs=1e-3)
    own = walk.animations[0]
    assert isinstance(own, Motion)
    for frame in (0, 11, done["frames"] - 1):
        page.page.evaluate("(t) => keypose.retarget.seek(t)", frame / done["rate_hz"])
        assert np.abs(shown(page, "target") - places(expected.motion, human.skeleton, frame)).max() < 2e-5
        assert np.abs(shown(page, "source") - places(own, walk.character.skeleton, frame)).max() < 2e-5
        times = now(page)["times"]
        assert times["source"] == times["target"]


def test_playing_moves_both_and_leaving_the_page_stops(page: StudioPage) -> None:
    before = shown(page, "target")
    page.page.keyboard.press("Space")
    page.until(lambda: now(page)["playing"] and now(page)["time"] > 0.1, "time goes on")
    assert np.abs(shown(page, "target") - before).max() > 1e-3
    page.test_id("page-view").click()
    page.until(lambda: not now(page)["playing"], "it stands")
    assert page.state("active") is not None  # the other page is as it was


def test_turning_one_camera_turns_the_other(page: StudioPage) -> None:
    def direction(side: str) -> np.ndarray:
        camera = page.ask("retargetCameras")[side]
        away = np.subtract(camera["position"], camera["target"])
        return away / np.linalg.norm(away)

    def still() -> bool:
        first = [direction(side) for side in ("source", "target")]
        page.page.wait_for_timeout(300)
        return np.abs(np.subtract(first, [direction(side) for side in ("source", "target")])).max() < 1e-4

    def drag(x: float) -> None:
        box = page.test_id("retarget-source").bounding_box()
        at = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.page.mouse.move(*at)
        page.page.mouse.down()
        page.page.mouse.move(at[0] + x, at[1], steps=4)
        page.page.mouse.up()
        page.page.wait_for_timeout(200)
        page.until(still, "turning ends softly", 30)

    before = direction("target")
    drag(90)
    assert np.abs(direction("source") - direction("target")).max() < 1e-3
    assert np.abs(direction("target") - before).max() > 0.2
    page.page.keyboard.press("k")
    before = direction("target")
    drag(-90)
    assert np.abs(direction("target") - before).max() < 1e-6
    assert np.abs(direction("source") - before).max() > 0.2


def test_options_are_carried_out_at_once_or_when_asked(page: StudioPage) -> None:
    planted = now(page)["done"]
    page.test_id("option-plant").click()
    settled(page)
    loose = now(page)["done"]
    assert loose["id"] != planted["id"]
    assert loose["slide_cm_s"] == pytest.approx(planted["loose_slide_cm_s"])
    page.page.get_by_label("at once").uncheck()
    page.page.evaluate("keypose.retarget.set({ scale: 0.5 })")
    page.page.wait_for_timeout(400)
    assert now(page)["stale"] and now(page)["done"]["scale"] != 0.5
    page.page.keyboard.press("Enter")
    settled(page)
    assert now(page)["done"]["scale"] == 0.5
    assert page.test_id("retarget-figures").is_visible()


def test_the_saved_file_holds_what_is_shown(page: StudioPage, tmp_path: Path) -> None:
    with page.page.expect_download() as waiting:
        page.test_id("retarget-save-bvh").click()
    path = tmp_path / waiting.value.suggested_filename
    assert path.suffix == ".bvh"
    waiting.value.save_as(path)
    scene = io.load(path)
    motion = scene.animations[0]
    assert isinstance(motion, Motion) and motion.frame_count == now(page)["done"]["frames"]
    frame = 20
    page.page.evaluate("(f) => keypose.retarget.seekFrame(f)", frame)
    names, at = page.ask("retargetJoints", "target"), shown(page, "target")
    for name in ("Hips", "Head", "LeftHand", "RightFoot"):
        joint = scene.character.skeleton.names.index(name)
        assert np.abs(places(motion, scene.character.skeleton, frame)[joint] - at[names.index(name)]).max() < 1e-3


def test_prints_lie_where_the_feet_stand(page: StudioPage) -> None:
    done, prints = now(page)["done"], now(page)["prints"]
    for side in ("source", "target"):
        assert {p["side"] for p in prints[side]} == {"left", "right"}
        for each in prints[side]:
            assert 0 <= each["from"] < each["to"] <= (done["frames"] + 1) / done["rate_hz"]
    # planted feet do not slide, whatever those of the source do
    assert max(p["slide"] for p in prints["target"]) < 1.0


def test_a_role_is_given_to_a_joint_and_taken_back(page: StudioPage) -> None:
    page.test_id("tab-roles").click()
    found = now(page)["roles"]["target"]
    skeleton = samples.load("human").character.skeleton
    assert found == {role: skeleton.names[j] for role, j in find_roles(skeleton).roles.items()}
    first = now(page)["done"]["id"]
    page.test_id("role-left_lower_arm").click()
    assert now(page)["role"] == "left_lower_arm"
    # on the stage: the hand becomes the forearm, and the hand's own role is free
    page.page.wait_for_timeout(300)
    x, y = page.ask("retargetOnScreen", "target", skeleton.names.index("LeftHand"))
    page.page.mouse.click(x, y)
    page.until(lambda: now(page)["roles"]["target"].get("left_lower_arm") == "LeftHand", "the role is given")
    assert now(page)["missing"]["target"] == ["left_hand"] and now(page)["byHand"]["target"]
    assert page.test_id("role-left_hand").get_attribute("data-doubt") == "needed"
    assert page.test_id("role-left_lower_arm").get_attribute("data-doubt") == "set"
    settled(page)
    assert now(page)["done"] is None or now(page)["done"]["id"] != first
    page.page.keyboard.press("Control+z")
    settled(page)
    assert now(page)["roles"]["target"] == found and now(page)["missing"]["target"] == []
    page.page.keyboard.press("Control+Shift+z")
    assert now(page)["roles"]["target"]["left_lower_arm"] == "LeftHand"
    page.test_id("reset-roles").click()
    settled(page)
    assert now(page)["roles"]["target"] == found and not now(page)["byHand"]["target"]


def test_joints_and_roles_show_each_other(page: StudioPage) -> None:
    page.test_id("tab-roles").click()
    page.test_id("joint-search").fill("RightFoot")
    page.test_id("role-joints").get_by_role("button").first.hover()
    assert "hovered" in (page.test_id("role-right_foot").get_attribute("class") or "")
    assert "Right foot" in page.test_id("looked").inner_text()
    page.test_id("role-joints").get_by_role("button").first.click()
    assert now(page)["role"] == "right_foot"
    page.test_id("unassign").click()
    assert now(page)["missing"]["target"] == ["right_foot"]
    page.test_id("joint-search").fill("")
    page.test_id("mirror-left").click()
    assert now(page)["roles"]["target"]["right_foot"] == "RightFoot"
    settled(page)


def test_a_map_is_saved_and_loaded(page: StudioPage, tmp_path: Path) -> None:
    page.test_id("tab-roles").click()
    table = now(page)["roles"]["target"]
    page.page.evaluate("keypose.retarget.assign('jaw', null)")
    with page.page.expect_download() as waiting:
        page.test_id("save-map").click()
    saved = json.loads(Path(waiting.value.path()).read_text())
    assert saved == {role: joint for role, joint in table.items() if role != "jaw"}
    page.page.evaluate("keypose.retarget.resetRoles()")
    path = tmp_path / "map.json"
    path.write_text(json.dumps({**saved, "jaw": "Head", "head": "Neck", "neck": "Spine2"}))

    def load(file: Path) -> None:
        with page.page.expect_file_chooser() as chooser:
            page.test_id("load-map").click()
        chooser.value.set_files(str(file))

    load(path)
    page.until(lambda: now(page)["roles"]["target"]["jaw"] == "Head", "the map is taken")
    path.write_text(json.dumps({"hips": "Hisp"}))
    load(path)
    page.until(lambda: any("no map" in t["title"] for t in page.state("toasts")), "it says why not")
    assert now(page)["roles"]["target"]["jaw"] == "Head"
    page.page.evaluate("keypose.retarget.resetRoles()")
    settled(page)


def test_what_is_no_humanoid_is_told(page: StudioPage) -> None:
    page.test_id("subject-target").click()
    page.test_id("menu").get_by_text("arm.glb").click()
    page.until(lambda: now(page)["error"] != "", "it is refused")
    assert "no humanoid" in page.test_id("retarget-error").inner_text()
    assert "roles missing" in page.test_id("facts-target").inner_text()
    assert page.test_id("send-to-edit").is_disabled()


def drop(page: StudioPage, side: str, *files: Path) -> None:
    """Drop files on one of the two stages."""
    page.page.evaluate(
        """([side, files]) => {
          const transfer = new DataTransfer();
          for (const [name, text] of files) transfer.items.add(new File([text], name));
          document.querySelector(`[data-testid=retarget-${side}]`).parentElement.dispatchEvent(
            new DragEvent("drop", { dataTransfer: transfer, bubbles: true, cancelable: true }));
        }""",
        [side, [[file.name, file.read_text()] for file in files]],
    )


def test_a_dropped_file_takes_the_side_that_it_was_dropped_on(page: StudioPage, tmp_path: Path) -> None:
    path = tmp_path / "jumping.bvh"
    io.save(samples.load("jump"), path)
    drop(page, "source", path)
    page.until(lambda: now(page)["subjects"]["source"]["name"] == "jumping.bvh", "it is the source")
    settled(page)
    assert now(page)["performs"]["source"] == now(page)["done"]["name"]
    assert now(page)["performs"]["target"] == now(page)["done"]["name"]


def test_it_goes_to_the_edit_page_as_one_step(page: StudioPage) -> None:
    done = now(page)["done"]
    page.test_id("send-to-edit").click()
    page.until(lambda: page.ask("edit")["characters"] != [] and page.ask("edit")["settled"], "it is in the project", 30)
    edit = page.ask("edit")
    assert edit["undo"] == f"Retarget {done['name']}"
    assert edit["timeline"]["rate"] == done["rate_hz"]
    assert edit["timeline"]["range"][1] == pytest.approx((done["frames"] - 1) / done["rate_hz"])
    page.page.evaluate("keypose.editor.undo()")
    page.until(lambda: page.ask("edit")["characters"] == [], "one step takes it back")


def test_themes_and_a_small_window(page: StudioPage) -> None:
    page.page.set_viewport_size({"width": 760, "height": 520})
    page.page.keyboard.press("t")
    page.page.wait_for_timeout(300)
    box = page.test_id("retarget-target").bounding_box()
    assert box["x"] + box["width"] <= 760 and box["height"] > 120
    page.page.keyboard.press("t")
    page.page.set_viewport_size({"width": 960, "height": 460})
    page.test_id("tab-roles").click()
    page.test_id("save-map").scroll_into_view_if_needed()
    with page.page.expect_download():
        page.test_id("save-map").click()
    strip = page.page.locator("[data-testid=retarget-page] [data-testid=timeline]")
    strip.click(position={"x": 860, "y": 30})  # no part of the panel lies over it
    page.until(lambda: now(page)["time"] > 1.0, "the strip was hit")
    page.page.set_viewport_size({"width": 960, "height": 600})


@pytest.mark.data
def test_a_real_pair(chromium: Any, start: Start, data_dir: Path) -> None:
    """CMU's walk on the character of an FBX: bones point where they should, feet stand."""
    server = start(
        ("02_01.amc", io.load(data_dir / "asf_amc" / "cmu_02" / "02_01.amc")),
        ("arnaud.fbx", io.load(data_dir / "fbx" / "ozz_pab" / "arnaud.fbx")),
    )
    context = chromium.new_context(viewport={"width": 1000, "height": 640}, reduced_motion="reduce")
    context.set_default_timeout(30_000)
    page = StudioPage(context.new_page())
    page.page.goto(server.url + "#retarget")
    page.until(lambda: page.page.evaluate("Boolean(window.keypose?.test.ready())"), "the page is ready", 60)
    settled(page)
    told = now(page)
    assert told["subjects"]["source"]["name"] == "02_01.amc" and told["subjects"]["target"]["name"] == "arnaud.fbx"
    assert told["done"]["slide_cm_s"] < 1.0 < told["done"]["loose_slide_cm_s"]
    assert told["done"]["mean_direction_deg"] < 5.0
    roles = told["roles"]
    for frame in (40, 150, 300):
        page.page.evaluate("(f) => keypose.retarget.seekFrame(f)", frame)
        ways = []
        for side in ("source", "target"):
            names, at = page.ask("retargetJoints", side), shown(page, side)
            lower, hand = (names.index(roles[side][f"left_{part}"]) for part in ("lower_arm", "hand"))
            way = at[hand] - at[lower]
            ways.append(way / np.linalg.norm(way))
        assert np.degrees(np.arccos(np.clip(ways[0] @ ways[1], -1, 1))) < 1.0
    # another take with its skeleton file, dropped together: the take is the source, and the target stays
    takes = data_dir / "asf_amc" / "cmu_02"
    drop(page, "source", takes / "02_03.amc", takes / "02.asf")
    page.until(lambda: now(page)["subjects"]["source"]["name"] == "02_03.amc", "the take is the source", 60)
    settled(page)
    page.page.wait_for_timeout(500)
    told = now(page)
    assert told["subjects"]["target"]["name"] == "arnaud.fbx" and told["done"]["name"] == "02_03"
    assert page.complaints == []
    context.close()
