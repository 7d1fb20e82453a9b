"""The tutorials of docs/tutorials, done step by step in the page with real keys and pointer, and measured."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edit_ui import EditUi
from studio_page import StudioPage
from studio_scenes import Start

from keypose import evaluate
from keypose.io.native import document_bytes
from keypose.math import euler
from keypose.model import Document, Pose
from keypose.project import file

pytestmark = pytest.mark.browser

Visit = Callable[..., StudioPage]

RADIUS, RATE = 0.25, 25
TOPS = {0: 0.785, 10: 0.0, 18: 0.502, 26: 0.0, 32: 0.283, 38: 0.0}
"""Height of the ball over the ground by frame: free fall, 9.81 m/s2, to the millimetre."""


def performed(document: Document, character: str, frame: float) -> Pose:
    timeline = document.timeline(document.performs[character])
    skeleton = document.character(character).skeleton
    return evaluate.sample_timeline(timeline, document.clips, skeleton, frame / timeline.rate_hz)


def assert_page_is_python(
    ui: EditUi, document: Document, character: str, joints: list[str], frames: list[float]
) -> None:
    skeleton = document.character(character).skeleton
    for frame in frames:
        pose = performed(document, character, frame)
        for joint in joints:
            n, shown = skeleton.names.index(joint), ui.local(joint, frame)
            assert np.abs(np.array(shown["translation"]) - pose.translations[n]).max() < 1e-6, (joint, frame)
            assert np.abs(np.array(shown["scale"]) - pose.scales[n]).max() < 1e-6, (joint, frame)
            assert 1 - abs(np.dot(shown["rotation"], pose.rotations[n])) < 1e-9, (joint, frame)


def begin(ui: EditUi, name: str, sample: str) -> None:
    """Project menu, New project, a name, a character."""
    ui.test_id("project-menu").click()
    ui.page.get_by_role("menuitem", name="New project…").click()
    ui.test_id("new-name").fill(name)
    ui.test_id("dialog").get_by_test_id(f"sample-{sample}").click()
    ui.studio.until(lambda: ui.state()["name"] == name, "the project")
    ui.arrived()


def save(ui: EditUi, path: Path) -> Document:
    """Ctrl+S, a name, Save; the file as Python reads it."""
    ui.press("Control+s")
    ui.test_id("save-name").fill(str(path))
    ui.test_id("save-go").click()
    ui.studio.until(lambda: not ui.state()["unsaved"] and ui.state()["dialog"] is None, "the project is saved")
    ui.settled()
    return file.load(path)


def run_example(page: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The Python of a tutorial, in the folder where it was saved; what it has named."""
    text = (Path(__file__).resolve().parents[2] / "docs" / "tutorials" / page).read_text(encoding="utf-8")
    named: dict[str, Any] = {}
    monkeypatch.chdir(folder)
    exec(text.split("```python\n")[1].split("```")[0], named)
    return named


def test_a_bouncing_ball_with_squash_and_stretch(
    visit: Visit, start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = start()
    ui = EditUi(visit(server, size=(1280, 720)), server)
    begin(ui, "Bounce", "ball")
    # keys of its path: auto-key keeps whatever is typed
    ui.select("Ball")
    ui.test_id("auto-key").click()
    for frame, height in TOPS.items():
        ui.frame(frame)
        ui.type("translation-0", round(-1.14 + 0.06 * frame, 2))
        ui.type("translation-1", round(RADIUS + height, 3))
    ui.test_id("auto-key").click()
    ui.type("transport-end", 38)
    curve = ui.curves()["Ball.translation"]
    assert np.allclose(np.array(curve["times"]) * RATE, list(TOPS))
    assert ui.state()["timeline"]["range"] == [0, 38 / RATE]
    # all keys in straight lines; then the handles of the height make parabolas: two thirds of the height, a third of the time
    ui.press("Home", "curves")
    ui.press("a", "curves")
    ui.curve_menu("v", "Vector")
    frames, heights = list(TOPS), list(TOPS.values())
    for k, frame in enumerate(frames):
        ui.click_key("Ball\0translation\0", k, 1)
        for side, other in ((0, k - 1), (1, k + 1)):
            if not 0 <= other < len(frames):
                continue
            rise = 0.0 if heights[k] else 2 / 3 * abs(heights[other] - heights[k])
            for field, value in (("frames", (frames[other] - frame) / 3), ("value", rise)):
                ui.test_id(f"handle-{field}-{side}").fill(f"{value:.6f}")
                ui.page.keyboard.press("Enter")
                ui.settled()
    for a, b in pairwise(frames):
        top, low = (a, b) if TOPS[a] else (b, a)
        for frame in np.linspace(a, b, 5):
            x, y, z = ui.local("Ball", float(frame))["translation"]
            fallen = TOPS[top] * ((frame - top) / (low - top)) ** 2
            assert abs(y - (RADIUS + TOPS[top] - fallen)) < 2e-6, "free fall: the height is a parabola"
            assert (abs(x - (-1.14 + 0.06 * frame)) < 1e-6) and z == 0, "forward at one speed"
    # squash and stretch
    ui.press("a", "curves")
    ui.tab("operators")
    ui.test_id("operator-squash_and_stretch").click()
    ui.test_id("operator-run").click()
    ui.studio.until(lambda: "Squash.scale" in ui.curves(), "the operator has worked")
    ui.settled()
    for frame in (10, 26):
        assert ui.local("Squash", frame)["scale"][1] < 0.8, "flat where it touches"
    for frame in np.linspace(0, 38, 39):
        assert abs(np.prod(ui.local("Squash", float(frame))["scale"]) - 1) < 1e-6, "the volume is kept"
    document = save(ui, tmp_path / "bounce.keypose")
    assert document_bytes(document) == ui.bytes()
    assert_page_is_python(ui, document, "Ball", ["Ball", "Squash", "Level"], [0, 3.5, 10, 14, 25.25, 38])
    named = run_example("bouncing-ball.md", tmp_path, monkeypatch)
    assert named["pose"].translations[0][1] == pytest.approx(RADIUS, abs=1e-6)


def test_a_waving_character(visit: Visit, start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    server = start()
    ui = EditUi(visit(server, size=(1280, 720)), server)
    begin(ui, "Hello", "human")
    degrees = 180 / np.pi
    # rest, then the arm goes up
    ui.select("RightArm", "RightForeArm")
    ui.key("Rotation")
    ui.frame(12)
    ui.select("RightArm")
    ui.type("euler-2", -45)
    assert ui.state()["posed"][0][0] == "RightArm.euler"
    ui.key("Rotation")
    assert np.allclose(ui.curves()["RightArm.euler"]["values"][-3:], [0, 0, -45 / degrees])
    # the forearm waves: three keys, and then again and again
    ui.select("RightForeArm")
    ui.test_id("auto-key").click()
    for frame, turn in ((12, -65), (17, -110), (22, -65)):
        ui.frame(frame)
        ui.type("euler-2", turn)
    ui.test_id("auto-key").click()
    ui.frame(0)
    assert ui.test_id("dot-euler").get_attribute("data-state") == "key"
    ui.test_id("dot-euler").click()  # its first key goes, so that only the wave is repeated
    ui.settled()
    assert np.allclose(np.array(ui.curves()["RightForeArm.euler"]["times"]) * RATE, [12, 17, 22])
    ui.press("Home", "curves")
    ui.press("a", "curves")
    ui.press("Shift+E", "curves")
    ui.test_id("curve-menu").get_by_role("menuitem", name="Cycle", exact=True).last.click()
    ui.settled()
    assert ui.curves()["RightForeArm.euler"]["after"] == "cycle"
    # a nod on a layer of its own, at half its strength
    ui.test_id("layer-add-additive").click()
    ui.settled()
    ui.select("Head")
    ui.tab("clip")
    ui.test_id("mask").click()
    ui.settled()
    ui.tab("joint")
    ui.frame(10)
    ui.key("Rotation")
    ui.test_id("auto-key").click()
    for frame, turn in ((20, 20), (30, 0)):
        ui.frame(frame)
        ui.type("euler-0", turn)
    ui.tab("clip")
    ui.drag("[data-testid=influence]", (0, 0))  # a click in the middle of the slider
    layer = ui.state()["timeline"]["layers"][1]
    assert (layer["mode"], layer["joints"], layer["influence"]) == ("add", {"Head": 1}, 0.5)
    ui.type("range-end", 72)
    ui.test_id("marker-add").click()
    ui.settled()

    def angle(joint: str, axis: int, frame: float) -> float:
        return float(np.asarray(euler.from_quat(np.array(ui.local(joint, frame)["rotation"]), "XYZ"))[axis] * degrees)

    for frame in (12, 22, 32, 42, 72):
        assert abs(angle("RightForeArm", 2, frame) - -65) < 1e-9, frame
    for frame in (17, 27, 57, 67):
        assert abs(angle("RightForeArm", 2, frame) - -110) < 1e-9, frame
    rest = angle("Head", 0, 0)
    assert abs(angle("Head", 0, 20) - rest - 10) < 1e-6, "half of twenty degrees"
    assert abs(angle("RightArm", 2, 50) - -45) < 1e-9, "the raised arm stays up"
    document = save(ui, tmp_path / "hello.keypose")
    assert document_bytes(document) == ui.bytes()
    character = next(iter(document.characters))
    joints = ["RightArm", "RightForeArm", "Head", "Hips", "LeftArm"]
    assert_page_is_python(ui, document, character, joints, [0, 6.5, 12, 15, 21.3, 44, 72])
    motion = run_example("waving-character.md", tmp_path, monkeypatch)["motion"]
    forearm = euler.from_quat(motion.pose.rotations[:, motion.joint_names.index("RightForeArm")], "XYZ")[:, 2]
    assert np.allclose(np.asarray(forearm)[[12, 17, 22, 27, 32, 37]] * degrees, [-65, -110] * 3, atol=1e-4)
    # the file opens again in the page, as it was
    ui.press("Control+o")
    ui.test_id("listing").wait_for()
    ui.page.keyboard.press("Escape")
    ui.page.evaluate("(path) => keypose.project.openFile(path)", str(tmp_path / "hello.keypose"))
    ui.studio.until(lambda: ui.state()["revision"] == 0 and ui.state()["settled"], "the project was opened")
    ui.arrived()
    assert ui.bytes() == document_bytes(document)
    assert [layer["name"] for layer in ui.state()["timeline"]["layers"]] == ["Base", "Additive"]
