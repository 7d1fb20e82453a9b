"""The retarget page's further options in a browser: moments in which bodies stand, props, and somebody else's result."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studio_page import StudioPage
from studio_scenes import Start

from keypose import io, samples
from keypose.model import Motion, Pose
from keypose.retarget import ground_under, retarget

pytestmark = pytest.mark.browser


def now(page: StudioPage) -> dict[str, Any]:
    return page.ask("retarget")


def settled(page: StudioPage) -> dict[str, Any]:
    def there() -> bool:
        told = now(page)  # once: between two questions it may begin
        return told["settled"] and not told["stale"]

    page.until(there, "the motion is there", 60)
    return now(page)["done"]


@pytest.fixture(scope="module")
def retargeting(chromium: Any, start: Start) -> Iterator[StudioPage]:
    server = start(("walk.glb", samples.load("walk")))
    context = chromium.new_context(viewport={"width": 1280, "height": 720}, reduced_motion="reduce")
    context.set_default_timeout(30_000)
    studio = StudioPage(context.new_page())
    studio.page.goto(server.url)
    studio.ready(1)
    studio.page.evaluate("keypose.studio.view.draw = () => {}")
    studio.test_id("page-retarget").click()
    # software rendering is what takes most of the time
    studio.until(lambda: studio.page.evaluate("keypose.retarget.stages !== null"), "the stages")
    studio.page.evaluate("for (const view of Object.values(keypose.retarget.stages.views)) view.draw = () => {}")
    settled(studio)
    yield studio
    assert studio.complaints == []
    context.close()


def positions(page: StudioPage, side: str, frame: int) -> np.ndarray:
    page.page.evaluate("(frame) => keypose.retarget.seekFrame(frame)", frame)
    page.page.evaluate("for (const v of Object.values(keypose.retarget.stages.views)) v.pose()")
    return np.array(page.ask("retargetPositions", side))


def test_a_body_stands_as_in_a_frame(retargeting: StudioPage) -> None:
    page = retargeting
    page.page.evaluate("document.querySelector('.retarget-panel details').open = true")
    plain = settled(page)
    page.page.evaluate("keypose.retarget.seekFrame(12)")
    page.test_id("option-source-reference").select_option("own")
    done = settled(page)
    walk = samples.load("walk")
    take, body = walk.animations[0], walk.character
    assert isinstance(take, Motion)
    pose = take.pose.broadcast()
    stand = Pose(pose.translations[12], pose.rotations[12], pose.scales[12])
    expected = retarget(
        take, body.skeleton, body.skeleton, source_reference=stand, target_ground_m=ground_under(body)
    ).report
    assert done["mean_direction_deg"] == pytest.approx(expected.mean_direction_deg, abs=1e-4)
    assert done["mean_direction_deg"] > plain["mean_direction_deg"] + 0.1
    # another frame by its number
    page.test_id("stand-frame-source").click()
    page.page.keyboard.type("0")
    page.page.keyboard.press("Enter")
    assert settled(page)["mean_direction_deg"] != pytest.approx(done["mean_direction_deg"], abs=1e-3)
    # the target as in another file of its rig
    (other,) = page.page.evaluate("keypose.studio.files.map((f) => f.id)")
    if now(page)["subjects"]["target"]["reference"] != other:
        page.test_id("option-target-reference").select_option(f"file {other}")
        settled(page)
        stand = now(page)["options"]["stands"]["target"]
        assert stand["scene"] == other and now(page)["error"] == ""
    page.page.get_by_title("All as at the beginning").click()
    assert settled(page)["mean_direction_deg"] == pytest.approx(plain["mean_direction_deg"], abs=1e-6)


def test_a_prop_is_put_where_a_hand_is(retargeting: StudioPage) -> None:
    page = retargeting
    free = settled(page)
    names = page.ask("retargetJoints", "source")
    hand = positions(page, "source", 30)[names.index("LeftHand")]
    page.test_id("add-prop-left_hand").click()
    done = settled(page)
    (prop,) = done["props"]
    np.testing.assert_allclose(prop[:3], hand, atol=6e-4)  # to the millimetre
    assert free["hands_off_cm"] is None and done["hands_off_cm"] is not None
    before = positions(page, "target", 30)[names.index("LeftHand")]
    # somewhere else on the target, ten centimetres higher
    page.test_id("prop-0-elsewhere").click()
    settled(page)
    page.test_id("prop-0-there-1").click()
    page.page.keyboard.type(str(prop[4] + 0.1))
    page.page.keyboard.press("Enter")
    moved = settled(page)["props"][0]
    np.testing.assert_allclose(np.subtract(moved, prop), [0, 0, 0, 0, 0.1, 0], atol=2e-3)
    reached = positions(page, "target", 30)[names.index("LeftHand")] - before
    assert reached[1] > 0.05 and np.linalg.norm(reached) < 0.15
    page.test_id("prop-0-remove").click()
    assert settled(page)["props"] == [] and now(page)["options"]["props"] == []


def test_somebody_elses_result_is_opened_and_compared(retargeting: StudioPage, tmp_path: Path) -> None:
    page = retargeting
    bodies = now(page)["subjects"]
    theirs = tmp_path / "theirs.bvh"
    io.save(samples.load("walk"), theirs)
    with page.page.expect_file_chooser() as chooser:
        page.test_id("option-against").select_option("open")
    chooser.value.set_files(str(theirs))
    page.until(lambda: now(page)["options"]["against"], "the file is there", 60)
    beside = settled(page)["beside"]
    assert beside["name"] == "theirs.bvh" and beside["error"] == ""
    assert beside["direction_deg"]["arms"] < 0.5
    assert now(page)["subjects"] == bodies  # it has taken nobody's place
    assert "Arms" in page.test_id("retarget-beside").inner_text()
    page.test_id("option-against").select_option("")
    assert settled(page)["beside"] is None
