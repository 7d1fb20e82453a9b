"""The real page in a real browser: numbers through its test hooks, pixels where only they tell."""

from __future__ import annotations

import base64
import io as streams
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from studio_page import StudioPage
from studio_scenes import Start, arm_scene

from keypose import deform, evaluate, io
from keypose.model import Scene
from keypose.studio import StudioServer

pytestmark = pytest.mark.browser

Visit = Callable[..., StudioPage]


@pytest.fixture(scope="module")
def arm_server(start: Start) -> StudioServer:
    return start(("arm.glb", arm_scene()))


def world_positions(scene: Scene, animation: int, time_s: float) -> np.ndarray:
    skeleton = scene.character.skeleton
    pose = evaluate.sample(scene.animations[animation], skeleton, time_s)
    return np.asarray(evaluate.world_rotations_positions(skeleton, pose)[1])


def pixels(studio: StudioPage) -> np.ndarray:
    """The stage alone, drawn now, in full resolution (what moves may be drawn smaller until the next frame)."""
    url = studio.page.evaluate(
        """async () => {
          for (let i = 0; i < 2; i++) await new Promise(requestAnimationFrame);
          const { view } = keypose.studio;
          view.pose();
          window.drawn = true;
          view.draw();
          window.drawn = false;
          return view.canvas.toDataURL('image/png');
        }"""
    )
    png = base64.b64decode(url.split(",")[1])
    return np.asarray(Image.open(streams.BytesIO(png)).convert("RGB"), np.int16)


def drop(studio: StudioPage, *files: tuple[str, bytes]) -> None:
    """Drag files over the page and let them go."""
    encoded = [[name, base64.b64encode(data).decode()] for name, data in files]
    studio.page.evaluate(
        """(files) => {
          const transfer = new DataTransfer();
          for (const [name, text] of files)
            transfer.items.add(new File([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))], name));
          const fire = (kind) => window.dispatchEvent(new DragEvent(kind, { dataTransfer: transfer, bubbles: true, cancelable: true }));
          fire("dragenter");
          window.dropShown = new Promise((done) => setTimeout(() => {
            done(Boolean(document.querySelector('[data-testid=drop]')));
            fire("drop");
          }, 60));
        }""",
        encoded,
    )
    assert studio.page.evaluate("window.dropShown"), "an overlay says that files can be dropped"


# ---- what is computed ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("animation", [0, 1], ids=["clip", "motion"])
def test_joints_are_where_the_library_says(studio: StudioPage, animation: int) -> None:
    scene = arm_scene()
    studio.page.get_by_role("button", name=["wave", "sway"][animation]).click()
    for time_s in (0.0, 0.1, 0.25, 0.4999, 0.6, 0.61, 0.99, 1.0):
        shown = np.array(studio.ask("jointPositions", 0, time_s))
        assert np.abs(shown - world_positions(scene, animation, time_s)).max() < 1e-5


def test_vertices_are_where_the_library_says(studio: StudioPage) -> None:
    scene = arm_scene()
    character, clip = scene.character, scene.animations[0]
    for time_s in (0.0, 0.3, 0.77):
        pose = evaluate.sample(clip, character.skeleton, time_s)
        world = evaluate.world(character.skeleton, pose)
        rest = character.rest_morph_weights
        weights = evaluate.sample_morphs(clip, character.morph_names, time_s, rest)
        for n, part in enumerate(character.parts):
            expected = deform.deform_part(character, part, world, weights)
            shown = np.array(studio.ask("skinnedVertices", 0, n, time_s)).reshape(-1, 3)
            assert np.abs(shown - np.asarray(expected)).max() < 1e-5


def test_the_shader_draws_what_the_processor_computes(studio: StudioPage) -> None:
    studio.page.evaluate("keypose.studio.show('shadows', false); keypose.studio.show('grid', false)")
    for time_s in (0.25, 0.6):  # the tube bends and swells
        studio.page.evaluate("(t) => keypose.studio.seek(t)", time_s)
        with_arm = pixels(studio)
        points = np.array(studio.ask("verticesOnScreen", 0))
        studio.page.evaluate("keypose.studio.toggleHidden(keypose.studio.active)")
        without = pixels(studio)
        studio.page.evaluate("keypose.studio.toggleHidden(keypose.studio.active)")
        rows, columns = np.nonzero(np.abs(with_arm - without).max(-1) > 12)
        drawn = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
        computed = np.concatenate([points.min(0), points.max(0)])
        assert np.abs(drawn - computed).max() < 4, (time_s, drawn, computed)


def test_the_built_in_human_walks_and_costs_less_than_four_milliseconds(human: StudioPage) -> None:
    from keypose import samples

    scene = samples.open_scene("sample:human")
    studio = human
    for time_s in (0.0, 0.31, 1.0):
        shown = np.array(studio.ask("jointPositions", 0, time_s))
        assert np.abs(shown - world_positions(scene, 0, time_s)).max() < 1e-5
    before = np.array(studio.ask("shownPositions", 0))
    studio.test_id("play").click()
    studio.until(lambda: np.abs(np.array(studio.ask("shownPositions", 0)) - before).max() > 0.05, "the human moves")
    studio.ask("resetStats")
    stats = studio.until(lambda: (s := studio.ask("stats"))["frames"] >= 24 and s, "24 frames are drawn", 25)
    assert stats["script"] < 4.0, stats


# ---- playing ---------------------------------------------------------------------------------------------------------


def test_play_pause_step_and_scrub(studio: StudioPage) -> None:
    studio.page.keyboard.press("Space")
    assert studio.state("playing")
    studio.until(lambda: studio.state("time") > 0.1, "time runs")
    studio.page.keyboard.press("Space")
    stopped = studio.state("time")
    assert not studio.state("playing")
    studio.page.keyboard.press("Home")
    assert studio.state("time") == 0
    for _ in range(3):
        studio.page.keyboard.press(".")
    assert studio.state("time") == 3 / 30
    studio.page.keyboard.press(",")
    assert studio.state("time") == 2 / 30
    assert studio.test_id("readout").inner_text() == "2"
    studio.page.keyboard.press("Shift+ArrowRight")
    assert studio.state("time") == 12 / 30
    studio.page.keyboard.press("End")
    assert studio.state("time") == 1.0
    strip = studio.test_id("timeline").bounding_box()
    x = strip["x"] + 16 + 0.5 * (strip["width"] - 32)
    studio.page.mouse.click(x, strip["y"] + 40)
    assert studio.state("time") == 15 / 30, "scrubbing lands on whole frames"
    shown = np.array(studio.until(lambda: studio.ask("shownPositions", 0), "positions"))
    studio.page.wait_for_timeout(100)
    shown = np.array(studio.ask("shownPositions", 0))
    assert np.abs(shown - world_positions(arm_scene(), 0, 0.5)).max() < 1e-5
    assert stopped > 0


def test_the_keyboard_goes_where_a_user_expects(studio: StudioPage) -> None:
    studio.test_id("bones").click()
    studio.page.keyboard.press("Space")
    assert studio.state("playing"), "a clicked button does not take the space bar from playing"
    assert studio.state("display")["bones"]
    studio.page.keyboard.press("Space")
    studio.page.keyboard.press("Tab")
    focused = "document.activeElement.dataset.testid ?? document.activeElement.getAttribute('aria-label')"
    reached = studio.page.evaluate(focused)
    pressed = "document.activeElement.getAttribute('aria-pressed')"
    before = studio.page.evaluate(pressed)
    studio.page.keyboard.press("Space")
    assert not studio.state("playing"), f"'{reached}' was reached by keyboard and keeps its keys"
    assert studio.page.evaluate(pressed) != before
    studio.page.evaluate("keypose.studio.seekFrame(0)")
    studio.page.get_by_test_id("speed").focus()
    studio.page.keyboard.press("ArrowRight")
    assert studio.state("time") == 0, "a slider keeps the keys that move it"
    studio.page.get_by_role("searchbox", name="Find a joint").fill("")
    studio.page.keyboard.type("joint2 b.")
    assert studio.state("time") == 0, "typing is typing"
    assert studio.page.get_by_role("treeitem").count() == 0
    studio.page.keyboard.press("Escape")
    assert studio.page.get_by_role("treeitem").count() == 4, "Escape empties the search"
    studio.page.keyboard.press("Escape")
    studio.page.keyboard.press(".")
    assert studio.state("time") > 0, "and once more gives the keyboard back"


def test_the_read_out_takes_a_frame_number_and_shows_timecode(studio: StudioPage) -> None:
    studio.test_id("readout").click()
    studio.page.keyboard.type("21")
    studio.page.keyboard.press("Enter")
    assert studio.state("time") == pytest.approx(0.7)
    studio.page.get_by_label("Units of the read-out").select_option("timecode")
    assert studio.test_id("readout").inner_text() == "00:00:00:21"
    studio.page.get_by_label("Units of the read-out").select_option("seconds")
    assert studio.test_id("readout").inner_text() == "0.700"


def test_keys_are_jumped_to_exactly(studio: StudioPage) -> None:
    times = []
    for _ in range(3):
        studio.page.keyboard.press("Shift+.")
        times.append(studio.state("time"))
    assert times == [0.25, 0.6, 1.0]
    studio.page.keyboard.press("Shift+,")
    assert studio.state("time") == 0.6


def test_loop_modes_speed_and_range(studio: StudioPage) -> None:
    assert studio.state("mode") == "loop"
    studio.page.keyboard.press("l")
    assert studio.state("mode") == "once"
    for _ in range(10):
        studio.page.keyboard.press("=")
    assert studio.state("speed") == 4
    studio.page.keyboard.press("Space")
    studio.until(lambda: not studio.state("playing"), "playing once ends")
    assert studio.state("time") == 1.0
    studio.page.keyboard.press("l")
    assert studio.state("mode") == "ping-pong"
    studio.page.evaluate("keypose.studio.seekFrame(6)")
    studio.page.keyboard.press("[")
    studio.page.evaluate("keypose.studio.seekFrame(12)")
    studio.page.keyboard.press("]")
    assert studio.state("range") == pytest.approx([0.2, 0.4])
    studio.page.keyboard.press("Space")
    seen = [studio.state("time") for _ in range(25) if studio.page.wait_for_timeout(20) is None]
    assert min(seen) >= 0.2 - 1e-9
    assert max(seen) <= 0.4 + 1e-9
    assert {np.sign(d) for d in np.diff(seen)} >= {-1.0, 1.0}, "it goes both ways"
    studio.page.keyboard.press("\\")
    assert studio.state("range") == [0, 1]


def test_clips_switch_and_are_found(human: StudioPage) -> None:
    studio = human
    clips = studio.test_id("clips").get_by_role("button")
    names = [a["name"] for a in studio.state("animations")]
    assert len(names) >= 6
    clips.filter(has_text="jump").click()
    assert studio.state("animation") == "jump"
    assert studio.state("time") == 0
    studio.page.keyboard.press("n")
    assert studio.state("animation") == names[names.index("jump") + 1]
    clips.filter(has_text="Rest pose").click()
    assert studio.state("animation") is None
    assert studio.test_id("play").is_disabled()


# ---- looking ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("what", ["bones", "axes", "weights", "ghosts"])
def test_overlays_change_the_picture_and_go_again(studio: StudioPage, what: str) -> None:
    studio.page.evaluate("keypose.studio.seekFrame(8)")
    if what == "weights":
        studio.page.evaluate("keypose.studio.select(2)")

    before = pixels(studio)
    button = studio.test_id(what)
    button.click()
    assert studio.state("display")[what]
    assert button.get_attribute("aria-pressed") == "true"
    changed = (np.abs(pixels(studio) - before).max(-1) > 20).sum()
    assert changed > 80, "nothing to see"
    button.click()
    assert not studio.state("display")[what]
    assert (np.abs(pixels(studio) - before).max(-1) > 20).sum() < 40


def test_a_click_on_a_joint_selects_it_and_shows_its_numbers(studio: StudioPage) -> None:
    studio.page.evaluate("keypose.studio.seekFrame(15)")
    studio.page.wait_for_timeout(100)
    x, y = studio.ask("jointOnScreen", 0, 2)
    studio.page.mouse.click(x, y)
    assert studio.state("selected") == "Joint2"
    inspector = studio.test_id("inspector")
    assert "Joint2" in inspector.inner_text()
    inspector.get_by_role("button", name="World").click()
    expected = world_positions(arm_scene(), 0, 0.5)[2]
    shown = [float(studio.test_id(f"position-{c}").inner_text()) for c in range(3)]
    assert np.abs(np.array(shown) - expected).max() < 6e-5
    studio.page.keyboard.press("Escape")
    assert studio.state("selected") is None
    studio.page.get_by_role("treeitem", name="Joint1").click()
    assert studio.state("selected") == "Joint1"


def test_the_camera_goes_where_it_is_told(studio: StudioPage) -> None:

    def direction() -> np.ndarray:
        camera = studio.ask("camera")
        d = np.array(camera["position"]) - np.array(camera["target"])
        return d / np.linalg.norm(d)

    for view, axis in (("front", (0, 0, 1)), ("side", (1, 0, 0)), ("top", (0, 1, 0))):
        studio.test_id(f"view-{view}").click()
        studio.until(lambda axis=axis: direction() @ axis > 0.99, f"the camera looks from the {view}")
    box = studio.test_id("canvas").bounding_box()
    before = direction()
    studio.page.mouse.move(box["x"] + 300, box["y"] + 300)
    studio.page.mouse.down()
    studio.page.mouse.move(box["x"] + 420, box["y"] + 260, steps=4)
    studio.page.mouse.up()
    studio.until(lambda: direction() @ before < 0.99, "dragging orbits")
    assert studio.state("selected") is None, "a drag is no click"


def test_morph_sliders_move_the_face_and_can_be_undone(human: StudioPage) -> None:
    studio = human
    names = studio.page.evaluate("keypose.studio.active.morphNames")
    jaw = names.index("jawOpen")
    studio.test_id("tab-morphs").click()
    studio.page.get_by_role("searchbox", name="Find a shape").fill("jawOp")
    slider = studio.page.get_by_role("slider", name="jawOpen")
    slider.fill("0.8")
    studio.until(lambda: abs(studio.ask("morphs", 0)[jaw] - 0.8) < 1e-6, "the weight arrives")
    studio.page.keyboard.press("Escape")
    studio.page.get_by_role("button", name="Undo jawOpen").click()
    studio.until(lambda: studio.ask("morphs", 0)[jaw] < 1e-6, "undo takes it back")
    studio.page.get_by_role("button", name="Redo jawOpen").click()
    studio.until(lambda: abs(studio.ask("morphs", 0)[jaw] - 0.8) < 1e-6, "redo brings it again")
    studio.page.get_by_role("button", name="Reset all").click()
    studio.until(lambda: studio.ask("morphs", 0)[jaw] < 1e-6, "reset clears it")


def test_themes(arm_server: StudioServer, visit: Visit) -> None:
    studio = visit(arm_server, theme="light", actors=1)
    assert studio.state("theme") == "light"
    light = pixels(studio).mean()
    studio.page.keyboard.press("t")
    assert studio.state("theme") == "dark"
    assert pixels(studio).mean() < light - 60
    assert studio.page.evaluate("localStorage.getItem('keypose.theme')") == "dark", "the choice is remembered"


def test_the_help_panel_lists_the_shortcuts(studio: StudioPage) -> None:
    studio.page.keyboard.press("?")
    panel = studio.test_id("help-panel")
    assert "Play or pause" in panel.inner_text()
    studio.page.keyboard.press("Space")
    assert not studio.state("playing"), "the panel takes the keyboard"
    studio.page.keyboard.press("Escape")
    assert panel.count() == 0


def test_a_picture_is_saved(studio: StudioPage, tmp_path: Path) -> None:
    studio.draw()
    studio.page.evaluate("keypose.studio.seekFrame(7)")
    with studio.page.expect_download() as download:
        studio.page.keyboard.press("p")
    assert download.value.suggested_filename == "arm-wave-0007.png"
    download.value.save_as(tmp_path / "shot.png")
    picture = np.asarray(Image.open(tmp_path / "shot.png").convert("RGB"), np.int16)
    box = studio.test_id("canvas").bounding_box()
    assert picture.shape[:2] == (round(box["height"]), round(box["width"]))
    assert picture.std() > 5, "the picture is not empty"


@pytest.mark.parametrize("size", [(1920, 1080), (1280, 720), (800, 600)])
def test_nothing_overflows(studio: StudioPage, size: tuple[int, int]) -> None:
    studio.page.set_viewport_size({"width": size[0], "height": size[1]})
    assert studio.page.evaluate("document.documentElement.scrollWidth") == size[0]
    assert studio.page.evaluate("document.documentElement.scrollHeight") == size[1]
    for name in ("play", "timeline", "canvas", "help"):
        box = studio.test_id(name).bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= size[0] + 0.5
        assert box["y"] + box["height"] <= size[1] + 0.5


# ---- files -----------------------------------------------------------------------------------------------------------


def test_files_are_dropped_and_a_damaged_one_says_why(start: Start, visit: Visit, tmp_path: Path) -> None:
    studio = visit(start())
    assert studio.test_id("empty").is_visible()
    io.save(arm_scene(), tmp_path / "arm.glb")
    io.save(arm_scene(skeleton_only=True), tmp_path / "chain.bvh")
    glb, bvh = (tmp_path / "arm.glb").read_bytes(), (tmp_path / "chain.bvh").read_bytes()
    drop(studio, ("arm.glb", glb), ("chain.bvh", bvh))
    studio.ready(2)
    assert studio.test_id("empty").count() == 0
    drop(studio, ("broken.bvh", bvh[: len(bvh) // 3]), ("cut.glb", glb[:200]))
    studio.until(lambda: len(studio.state("toasts")) == 2, "two toasts")
    messages = sorted(t["message"] for t in studio.state("toasts"))
    assert messages[0].startswith("broken.bvh: ")
    assert messages[1].startswith("cut.glb: ")
    assert len(studio.state("actors")) == 2, "what was open stays"


def test_files_stand_side_by_side_and_a_performance_goes_to_the_character_it_fits(start: Start, visit: Visit) -> None:
    studio = visit(start(("sway.bvh", arm_scene(skeleton_only=True)), ("arm.glb", arm_scene())), actors=2)
    first, second = studio.state("actors")
    assert abs(second["x"] - first["x"]) > 0.2
    assert second["animation"] == "sway", "the motion of the other file, whose joints have the same names"
    scene = arm_scene()
    shown = np.array(studio.ask("jointPositions", 1, 0.3))
    assert np.abs(shown - world_positions(scene, 1, 0.3)).max() < 1e-5
    studio.page.get_by_role("button", name="Close sway.bvh").click()
    studio.until(lambda: len(studio.state("actors")) == 1, "it is closed")
    assert studio.state("active") == "arm"


def test_giants_and_mice_are_shown_at_one_size_and_numbers_stay_real(start: Start, visit: Visit) -> None:
    giant = arm_scene(skeleton_only=True, size=100.0)
    studio = visit(start(("arm.glb", arm_scene()), ("giant.bvh", giant)), actors=2)
    assert studio.state("toasts")[0]["title"] == "Shown at one size"
    (x0, top), (_, bottom) = studio.ask("jointOnScreen", 1, 3), studio.ask("jointOnScreen", 1, 0)
    (x1, small_top), (_, small_bottom) = studio.ask("jointOnScreen", 0, 3), studio.ask("jointOnScreen", 0, 0)
    assert x0 - x1 > 30, "side by side"
    assert 0.5 < (bottom - top) / (small_bottom - small_top) < 2
    shown = np.array(studio.ask("jointPositions", 1, 0.0))
    assert shown[3, 1] == pytest.approx(150.0)


def test_what_the_reader_says_is_shown(studio: StudioPage) -> None:
    assert "made by code" in studio.test_id("notes").inner_text()


@pytest.mark.data
def test_real_files_move_as_the_library_says(start: Start, visit: Visit, data_dir: Path) -> None:
    names = ("gltf/khronos/Fox.glb", "gltf/khronos/cesium_man.gltf", "bvh/cmu_cgspeed/cmu_12_01_walk.bvh")
    scenes = [io.load(data_dir / name) for name in names]
    studio = visit(start(*((Path(n).name, s) for n, s in zip(names, scenes, strict=True))), size=(800, 600), actors=3)
    for actor, scene in enumerate(scenes):
        animation, character = scene.animations[0], scene.character
        size = max(1.0, float(np.ptp(world_positions(scene, 0, animation.start_s), axis=0).max()))
        for share in np.linspace(0, 1, 11):
            time_s = animation.start_s + share * animation.duration_s
            shown = np.array(studio.ask("jointPositions", actor, time_s))
            assert np.abs(shown - world_positions(scene, 0, time_s)).max() < 1e-5 * size
            world = evaluate.world(character.skeleton, evaluate.sample(animation, character.skeleton, time_s))
            for n, part in enumerate(character.parts):
                expected = np.asarray(deform.deform_part(character, part, world))
                vertices = np.array(studio.ask("skinnedVertices", actor, n, time_s)).reshape(-1, 3)
                assert np.abs(vertices - expected).max() < 2e-5 * size
