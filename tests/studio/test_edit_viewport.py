"""The 3D view of the edit page: gizmos, paths, ghosts, poses and films, by mouse and keys in a real browser."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edit_view import View, about, angle, bouncing, crooked_scene, drop, odd_person, unit
from scipy.spatial.transform import Rotation
from studio_page import StudioPage
from studio_scenes import Start

from keypose.model import Scene

pytestmark = pytest.mark.browser


@pytest.fixture
def edit(visit: Callable[..., StudioPage], start: Start, tmp_path: Path) -> Iterator[Callable[..., View]]:
    """Open the edit page with a character: a built-in one, or that of a scene."""

    def opened(source: str | Scene, size: tuple[int, int] = (1100, 760), theme: str = "dark") -> View:
        scenes = [] if isinstance(source, str) else [("made.glb", source)]
        studio = visit(start(*scenes, state=tmp_path), size=size, theme=theme)
        view = View(studio)
        given = source if isinstance(source, str) else str(studio.page.evaluate("keypose.studio.files[0].id"))
        studio.page.evaluate("keypose.studio.turnTo('edit')")
        view.until(lambda: studio.page.evaluate("keypose.project.status !== null"), "a project is open")
        view.add(given)
        return view

    yield opened


# ---- gizmos ----------------------------------------------------------------------------------------------------------


def test_a_ring_turns_the_joint_as_far_as_the_pointer_goes_around(edit: Callable[..., View]) -> None:
    view = edit(crooked_scene())
    view.auto_key()
    view.tools(tool="rotate", space="local")
    view.select("Joint2")
    before, place, text = unit(view.axes("Joint2")), view.place("Joint2"), view.document()
    gizmo = view.ask("gizmo")
    start, centre = np.array(gizmo["handles"]["z"]), np.array(gizmo["centre"])
    view.drag(list(start), list(centre + about([0, 0, 1], 40)[:2, :2] @ (start - centre)), release=False)
    read = float(view.tools()["text"].split("°")[0].split()[-1])
    view.page.mouse.up()
    view.settle()
    assert abs(read) > 15
    np.testing.assert_allclose(
        unit(view.axes("Joint2")), about(before[:, 2], read) @ before, atol=2e-3
    )  # of a rounded text
    np.testing.assert_allclose(view.place("Joint2"), place, atol=1e-6)
    assert view.curves() == {"Joint2.euler.": [0.0]}
    view.undo()
    assert view.document() == text
    np.testing.assert_allclose(unit(view.axes("Joint2")), before, atol=1e-7)


@pytest.mark.parametrize("space", ["global", "parent", "local"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_typed_angles_turn_about_the_axes_of_the_space_through_turned_and_scaled_parents(
    edit_crooked: View, space: str, axis: int
) -> None:
    view = edit_crooked
    view.tools(space=space, turns="individual")
    view.select("Joint2")
    before, parent = unit(view.axes("Joint2")), unit(view.axes("Joint1"))
    vector = {"global": np.eye(3), "parent": parent, "local": before}[space][:, axis]
    view.keys("r", "xyz"[axis], "-", "3", "7", ".", "5", "Enter")
    np.testing.assert_allclose(unit(view.axes("Joint2")), about(vector, -37.5) @ before, atol=1e-6)
    view.page.evaluate("keypose.editor.posed = new Map()")
    view.page.evaluate("keypose.studio.view.invalidatePose()")


@pytest.fixture(scope="module")
def edit_crooked(chromium: Any, start: Start, tmp_path_factory: pytest.TempPathFactory) -> Iterator[View]:
    """One page with the crooked tube for tests that leave it as it was."""
    context = chromium.new_context(viewport={"width": 1000, "height": 700}, reduced_motion="reduce")
    context.set_default_timeout(30_000)
    studio = StudioPage(context.new_page())
    studio.page.goto(start(("made.glb", crooked_scene()), state=tmp_path_factory.mktemp("state")).url)
    studio.ready(1)
    source = studio.page.evaluate("keypose.studio.files[0].id")
    studio.page.evaluate("keypose.studio.turnTo('edit')")
    view = View(studio)
    view.until(lambda: studio.page.evaluate("keypose.project.status !== null"), "a project is open")
    view.add(source)
    yield view
    assert studio.complaints == []
    context.close()


def test_a_joint_that_may_leave_its_bone_moves_by_typed_metres(edit_crooked: View) -> None:
    view = edit_crooked
    view.tools(space="global", turns="individual", detach=True)
    view.select("Joint3")
    before = view.place("Joint3")
    view.keys("g", "x", "0", ".", "2", "5", "Enter")
    np.testing.assert_allclose(view.place("Joint3") - before, [0.25, 0, 0], atol=1e-6)
    view.keys("g", "1", "Tab", "-", ".", "5", "Tab", "2", "Enter")
    np.testing.assert_allclose(view.place("Joint3") - before, [1.25, -0.5, 2], atol=1e-6)
    drop(view)
    # the same axis again: in the joint's own space
    axes = unit(view.axes("Joint3"))
    view.keys("g", "y", "y", "0", ".", "3", "Enter")
    np.testing.assert_allclose(view.place("Joint3") - before, 0.3 * axes[:, 1], atol=1e-6)
    drop(view)
    # in a plane: all but that axis
    view.keys("g", "Shift+X", "0", ".", "1", "Tab", "0", ".", "2", "Enter")
    np.testing.assert_allclose(view.place("Joint3") - before, [0, 0.1, 0.2], atol=1e-6)
    drop(view)
    view.tools(detach=False)


def test_without_that_only_roots_move(edit_crooked: View) -> None:
    view = edit_crooked
    view.tools(space="global", detach=False)
    view.select("Joint3")
    view.keys("g", "x", "1", "Enter")
    assert view.ask("held") == []
    assert "parent" in view.page.evaluate("keypose.studio.toasts.at(-1).title")
    view.select("Root")
    view.keys("g", "x", "1", "Enter")
    np.testing.assert_allclose(view.place("Root"), [1, 0, 0], atol=1e-9)
    drop(view)


def test_scale_goes_along_own_axes(edit_crooked: View) -> None:
    view = edit_crooked
    view.tools(space="local", turns="individual")
    view.select("Joint2")
    before = view.local("Joint2")["scale"]
    view.keys("s", "2", "Enter")
    np.testing.assert_allclose(view.local("Joint2")["scale"], 2 * before, rtol=1e-9)
    view.keys("s", "z", "0", ".", "5", "Enter")
    np.testing.assert_allclose(view.local("Joint2")["scale"], before * [2, 2, 1], rtol=1e-9)
    drop(view)


def test_a_chain_curls_individually_and_turns_as_one_about_a_point(edit_crooked: View) -> None:
    view = edit_crooked
    view.tools(space="local", turns="individual")
    view.select("Joint1", "Joint2", "Joint3")
    before = {n: view.local(n)["rotation"] for n in ("Joint1", "Joint2", "Joint3")}
    view.keys("r", "z", "2", "0", "Enter")
    for name, was in before.items():
        assert angle(view.local(name)["rotation"], was) == pytest.approx(20, abs=1e-6)
    drop(view)
    # as one: the topmost alone turns, and carries the others
    view.tools(space="global", turns="common")
    axes = unit(view.axes("Joint3"))
    view.keys("r", "y", "2", "0", "Enter")
    assert view.ask("held") == ["Joint1.rotation."]
    np.testing.assert_allclose(unit(view.axes("Joint3")), about([0, 1, 0], 20) @ axes, atol=1e-6)
    drop(view)
    view.tools(turns="individual")


def test_ctrl_turns_in_steps_and_escape_takes_all_back(edit_crooked: View) -> None:
    view = edit_crooked
    view.tools(tool="rotate", space="local", turns="individual")
    view.select("Joint1")
    before = view.local("Joint1")["rotation"]
    gizmo = view.ask("gizmo")
    start, centre = np.array(gizmo["handles"]["x"]), np.array(gizmo["centre"])
    end = centre + about([0, 0, 1], 50)[:2, :2] @ (start - centre)
    view.drag(list(start), list(end), hold="Control")
    turned = angle(view.local("Joint1")["rotation"], before)
    assert turned > 3
    assert turned / 5 == pytest.approx(round(turned / 5), abs=1e-6)
    held = view.ask("localOf", "Joint1")
    view.keys("r", "x", "4", "4")
    assert view.ask("localOf", "Joint1") != held
    view.page.keyboard.press("Escape")
    view.settle()
    assert view.ask("localOf", "Joint1") == held
    drop(view)
    # with auto-key nothing was committed either
    view.auto_key()
    text = view.document()
    view.keys("r", "x", "4", "4")
    assert angle(view.local("Joint1")["rotation"], before) == pytest.approx(44, abs=1e-6)
    view.page.keyboard.press("Escape")
    view.settle()
    assert view.document() == text
    np.testing.assert_allclose(view.local("Joint1")["rotation"], before, atol=1e-9)
    view.auto_key(False)


def test_an_arrow_follows_the_pointer(edit_crooked: View) -> None:
    view = edit_crooked
    view.tools(tool="move", space="global", turns="individual")
    view.select("Root")
    gizmo = view.ask("gizmo")
    start = gizmo["handles"]["y"]
    # to where the arrow's end is seen half a metre further up
    handle = np.array(start)
    per_metre = np.array(view.ask("pointOf", "Joint1")) - np.array(view.ask("pointOf", "Root"))  # about half a metre
    view.drag(start, list(handle + per_metre))
    moved = view.place("Root")
    assert moved[0] == moved[2] == 0
    assert moved[1] == pytest.approx(0.5, abs=0.08)  # of a view in perspective
    # what was under the pointer still is
    assert np.linalg.norm(np.array(view.ask("gizmo")["handles"]["y"]) - (handle + per_metre)) < 12
    drop(view)


def test_the_outer_ring_turns_about_the_view_and_the_ball_inside_freely(edit_crooked: View) -> None:
    view = edit_crooked
    view.tools(tool="rotate", space="local", turns="individual")
    view.select("Joint2")
    before, place = unit(view.axes("Joint2")), view.place("Joint2")
    camera = view.ask("camera")
    eye = np.subtract(camera["position"], place)
    gizmo = view.ask("gizmo")
    start, centre = np.array(gizmo["handles"]["screen"]), np.array(gizmo["centre"])
    # against the clock on the screen, whose y points down
    view.drag(list(start), list(centre + about([0, 0, 1], -35)[:2, :2] @ (start - centre)))
    turned = Rotation.from_matrix(unit(view.axes("Joint2")) @ before.T).as_rotvec(degrees=True)
    forward = np.subtract(camera["position"], camera["target"])
    np.testing.assert_allclose(turned, 35 * forward / np.linalg.norm(forward), atol=0.6)
    assert turned @ eye > 0
    drop(view)
    # to the right: about what is up in the picture
    start = np.array(view.ask("gizmo")["handles"]["free"])
    view.drag(list(start), list(start + np.array([55, 0])))
    turned = Rotation.from_matrix(unit(view.axes("Joint2")) @ before.T).as_rotvec()
    assert np.linalg.norm(turned) == pytest.approx(0.5, abs=0.03)
    assert turned[1] > 0.45 and abs(turned @ forward) < 1e-6 * np.linalg.norm(forward) + 1e-3
    drop(view)


def test_a_plane_lets_two_axes_go(edit_crooked: View) -> None:
    view = edit_crooked
    view.tools(tool="move", space="global", turns="individual")
    view.select("Root")
    before = np.array(view.ask("pointOf", "Root"))
    start = np.array(view.ask("gizmo")["handles"]["xy"])
    view.drag(list(start), list(start + np.array([30, -25])))
    moved = view.place("Root")
    assert moved[2] == 0 and abs(moved[0]) > 0.01 and moved[1] > 0.01
    np.testing.assert_allclose(np.array(view.ask("pointOf", "Root")) - before, [30, -25], atol=3)
    drop(view)


# ---- selecting -------------------------------------------------------------------------------------------------------


def test_joints_are_selected_on_the_body_by_bones_and_by_a_rectangle(edit_crooked: View) -> None:
    view = edit_crooked
    view.tools(tool="select", bones=True)
    view.select()
    point = view.ask("pointOf", "Joint2")
    view.page.mouse.click(*point)
    view.settle()
    assert view.ask("selectedJoints") == ["Joint2"]
    view.page.keyboard.down("Shift")
    view.page.mouse.click(*view.ask("pointOf", "Joint1"))
    view.page.keyboard.up("Shift")
    view.settle()
    assert view.ask("selectedJoints") == ["Joint2", "Joint1"]
    # without bones, the surface: whose weights are largest where the pointer meets it
    view.tools(bones=False)
    a, b = (np.array(view.ask("pointOf", n)) for n in ("Joint1", "Joint2"))
    view.page.mouse.click(*(a + 0.4 * (b - a)))
    view.settle()
    assert view.ask("selectedJoints") == ["Joint1"]
    box = view.page.get_by_test_id("canvas").bounding_box()
    view.keys("b")
    view.drag([box["x"] + 8, box["y"] + 60], [box["x"] + box["width"] - 8, box["y"] + box["height"] - 8])
    assert sorted(view.ask("selectedJoints")) == ["Joint1", "Joint2", "Joint3", "Root"]
    view.page.mouse.click(box["x"] + 20, box["y"] + box["height"] - 60)
    view.settle()
    assert view.ask("selectedJoints") == []
    view.tools(bones=True, tool="rotate")


# ---- keys ------------------------------------------------------------------------------------------------------------


def test_a_pose_is_held_until_it_is_keyed_or_time_moves(edit: Callable[..., View]) -> None:
    view = edit(crooked_scene())
    view.select("Joint1")
    before = view.local("Joint1")["rotation"]
    view.keys("r", "z", "3", "0", "Enter")
    assert view.ask("held") == ["Joint1.rotation."] and view.curves() == {}
    assert view.page.get_by_test_id("held").is_visible()
    view.seek(0.2)
    assert view.ask("held") == []
    np.testing.assert_allclose(view.local("Joint1")["rotation"], before, atol=1e-9)
    view.keys("r", "z", "3", "0", "Enter")
    view.keys("k")
    assert view.ask("held") == [] and view.curves() == {"Joint1.euler.": [0.2]}
    assert angle(view.local("Joint1")["rotation"], before) == pytest.approx(30, abs=1e-6)


def test_auto_key_turns_on_and_on_without_a_jump(edit: Callable[..., View]) -> None:
    view = edit(crooked_scene())
    view.auto_key()
    view.tools(space="local")
    view.select("Joint1")
    view.keys("r", "z", "0", "Enter")
    view.keys("r", "z", "1", "0", "Enter")
    for frame in range(1, 8):
        view.seek(frame / 25)
        view.keys("r", "z", "1", "0", "0", "Enter")
    values = np.array(
        view.page.evaluate("[...[...keypose.editor.clip.curves.values()].find((c) => c.kind === 'euler').values]")
    ).reshape(-1, 3)
    # 100 degrees a step for two turns: angles that go on, never a jump by a turn
    assert np.abs(np.diff(values, axis=0)).max() < math.pi
    assert view.curves()["Joint1.euler."] == pytest.approx([f / 25 for f in range(8)])


def test_on_an_additive_layer_the_key_makes_the_result_what_was_dragged(edit: Callable[..., View]) -> None:
    view = edit(crooked_scene())
    view.auto_key()
    view.tools(space="local")
    view.select("Joint2")
    view.keys("r", "x", "2", "5", "Enter")
    view.page.get_by_test_id("layer-add-additive").click()
    view.settle()
    assert view.page.evaluate("keypose.editor.layer.mode") == "add"
    before = view.local("Joint2")["rotation"]
    view.keys("r", "y", "4", "0", "Enter")
    after = view.local("Joint2")["rotation"]
    assert angle(after, before) == pytest.approx(40, abs=1e-5)
    wanted = Rotation.from_quat(np.roll(before, -1)) * Rotation.from_euler("Y", 40, degrees=True)
    assert angle(after, np.roll(wanted.as_quat(), 1)) < 1e-4


# ---- paths and ghosts ------------------------------------------------------------------------------------------------


def test_a_path_goes_through_the_places_of_the_joint_and_its_keys_can_be_dragged(edit: Callable[..., View]) -> None:
    view = edit(crooked_scene())
    view.auto_key()
    view.tools(space="global", turns="individual")
    view.select("Root")
    for time, keys in ((0.0, ["x", "0", ".", "0", "1"]), (0.4, ["y", "1"]), (0.8, ["x", "0", ".", "5"])):
        view.seek(time)
        view.keys("g", *keys, "Enter")
    view.tools(paths=True)
    view.until(lambda: view.ask("paths")["complete"] and view.ask("paths")["paths"], "the path is measured")
    (path,) = view.ask("paths")["paths"]
    assert path["draggable"] and path["keys"] == pytest.approx([0.0, 0.4, 0.8])
    times, places = np.array(path["times"]), np.array(path["positions"]).reshape(-1, 3)
    assert len(times) == 101  # every frame of four seconds at 25
    for n in (0, 4, 10, 15, 20, 60):
        view.seek(float(times[n]))
        np.testing.assert_allclose(places[n], view.place("Root"), atol=1e-5)
    text = view.document()
    start = view.ask("pathKeyPoint", "Root", 0.4)
    view.tools(tool="select")
    view.drag(start, [start[0] + 40, start[1] - 30])
    moved = view.ask("pathKeyPoint", "Root", 0.4)
    np.testing.assert_allclose(np.array(moved) - start, [40, -30], atol=1.5)
    assert view.curves()["Root.translation."] == pytest.approx([0.0, 0.4, 0.8])
    view.undo()
    assert view.document() == text
    # a joint that only turns shows its path, and lets nobody drag it
    view.select("Joint3")
    view.until(lambda: view.ask("paths")["complete"], "the path is measured")
    assert [p["draggable"] for p in view.ask("paths")["paths"]] == [False]


def test_ghosts_stand_at_frames_or_at_keys(edit: Callable[..., View]) -> None:
    view = edit(crooked_scene())
    bouncing(view)
    view.seek(0.4)
    view.tools(ghosts=True, ghostsBy="frames", ghostCount=2, ghostStep=3)
    assert sorted(view.ask("ghostPlaces")) == pytest.approx([0.16, 0.28, 0.52, 0.64])
    view.tools(ghostsBy="keys")
    assert sorted(view.ask("ghostPlaces")) == pytest.approx([0.0, 0.8])
    view.seek(0.5)
    assert sorted(view.ask("ghostPlaces")) == pytest.approx([0.0, 0.4, 0.8])


# ---- poses -----------------------------------------------------------------------------------------------------------


def test_a_mirror_image_is_a_reflection_and_twice_is_the_pose_whatever_the_axes(edit: Callable[..., View]) -> None:
    view = edit(odd_person())
    rng = np.random.default_rng(3)
    names = view.page.evaluate("keypose.editor.actor.rig.names")
    values = {
        f"{n}\0rotation\0": np.roll(q, 1).tolist()
        for n, q in zip(names, Rotation.random(len(names), rng=rng).as_quat(), strict=True)
    }
    values |= {"Hips\0translation\0": [0.3, 1.2, -0.4], "LeftHand\0scale\0": [1.5, 1, 0.7]}
    view.page.evaluate("(v) => keypose.editor.pose(new Map(Object.entries(v)), 'pose', true)", values)
    view.settle()
    found = view.ask("mirrorTwice")
    assert found["normal"] == [1, 0, 0]
    places, images = view.ask("placesOf", found["pose"]), view.ask("placesOf", found["once"])
    for name in names:
        other = name.replace("Left", "*").replace("Right", "Left").replace("*", "Right")
        other = {"l_thumb": "r_thumb", "r_thumb": "l_thumb"}.get(name, other)
        # a scale is a joint's own and reaches its children; all else is a reflection to rounding
        if "thumb" not in name:
            np.testing.assert_allclose(images[other], np.array(places[name]) * [-1, 1, 1], atol=1e-9, err_msg=name)
        for part in ("translation", "scale"):
            np.testing.assert_allclose(
                found["twice"]["joints"][name][part], found["pose"]["joints"][name][part], atol=1e-9
            )
        a, b = (np.array(found[k]["joints"][name]["rotation"]) for k in ("twice", "pose"))
        np.testing.assert_allclose(a * np.sign(a @ b), b, atol=1e-9)


def test_a_copied_arm_is_pasted_on_the_other_side(edit: Callable[..., View]) -> None:
    view = edit("sample:human")
    view.auto_key()
    view.tools(space="global", turns="individual")
    view.select("LeftArm")
    view.keys("r", "z", "4", "0", "Enter")
    view.keys("r", "x", "2", "0", "Enter")
    view.select("LeftArm", "LeftForeArm", "LeftHand")
    view.keys("Control+c")
    view.keys("Control+Shift+V")
    for side in ("Arm", "ForeArm", "Hand", "HandThumb3"):
        np.testing.assert_allclose(view.place(f"Right{side}"), view.place(f"Left{side}") * [-1, 1, 1], atol=2e-6)
    assert set(view.curves()) == {"LeftArm.euler.", "RightArm.euler."}
    view.undo()
    assert set(view.curves()) == {"LeftArm.euler."}
    # and back where it came from, later
    view.seek(0.4)
    view.keys("Alt+r")
    assert angle(view.local("LeftArm")["rotation"], np.array([1.0, 0, 0, 0])) < 1e-6
    view.keys("Control+v")
    assert angle(view.local("LeftArm")["rotation"], np.array([1.0, 0, 0, 0])) > 30


def test_poses_are_kept_with_pictures_and_put_on_by_a_share(edit: Callable[..., View]) -> None:
    view = edit("sample:human")
    view.page.get_by_test_id("tab-poses").click()
    view.select("RightArm")
    rest = view.local("RightArm")["rotation"]
    view.keys("r", "z", "-", "8", "0", "Enter")
    raised = view.local("RightArm")["rotation"]
    view.select()
    view.studio.draw()  # the small pictures
    view.page.get_by_test_id("pose-name").fill("Raised")
    view.page.get_by_test_id("pose-save").click()
    view.settle()
    drop(view)
    view.page.get_by_test_id("pose-name").fill("Rest")
    view.page.get_by_test_id("pose-save").click()
    view.settle()
    view.until(lambda: view.page.locator("[data-testid=pose] img").count() == 2, "both pictures are drawn")
    pictures = [view.page.locator("[data-testid=pose] img").nth(n).get_attribute("src") for n in range(2)]
    assert pictures[0] != pictures[1] and all(p.startswith("data:image/") and len(p) > 2000 for p in pictures)
    view.studio.draw(False)
    view.auto_key()
    view.page.locator("[data-pose=Raised] [data-testid=pose-apply]").click()
    view.settle()
    assert angle(view.local("RightArm")["rotation"], raised) < 1e-4
    assert set(view.curves()) == {"RightArm.euler."}
    # mirrored: the other arm
    view.undo()
    view.page.locator("[data-pose=Raised]").hover()
    view.page.locator("[data-pose=Raised] [data-testid=pose-mirror]").click()
    view.settle()
    assert angle(view.local("RightArm")["rotation"], rest) < 1e-4
    assert angle(view.local("LeftArm")["rotation"], rest) == pytest.approx(80, abs=1e-3)
    view.undo()
    # half of it, by the slider: one step of undo
    view.page.locator("[data-pose=Raised] [data-testid=pose-choose]").click()
    slider = view.page.get_by_test_id("pose-blend")
    box = slider.bounding_box()
    text = view.document()
    view.drag([box["x"] + 7, box["y"] + box["height"] / 2], [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])
    share = float(view.page.locator("[data-testid=pose-blend-panel] output").inner_text().split()[0]) / 100
    assert 0.4 < share < 0.6
    assert angle(view.local("RightArm")["rotation"], rest) == pytest.approx(80 * share, abs=1e-3)
    view.undo()
    assert view.document() == text


# ---- the camera and films --------------------------------------------------------------------------------------------


def test_views_along_the_axes_are_parallel_until_they_are_turned(edit_crooked: View) -> None:
    view = edit_crooked
    view.keys("Numpad1")
    camera = view.ask("camera")
    assert camera["parallel"]
    way = np.subtract(camera["position"], camera["target"])
    np.testing.assert_allclose(way / np.linalg.norm(way), [0, 0, 1], atol=1e-5)
    # in parallel, two points at one height are seen at one height
    view.keys("Numpad3")
    way = np.subtract(*(view.ask("camera")[k] for k in ("position", "target")))
    np.testing.assert_allclose(way / np.linalg.norm(way), [1, 0, 0], atol=1e-5)
    box = view.page.get_by_test_id("canvas").bounding_box()
    view.select()
    view.drag([box["x"] + 40, box["y"] + 200], [box["x"] + 100, box["y"] + 230])
    assert not view.ask("camera")["parallel"]
    view.keys("Numpad5")
    assert view.ask("camera")["parallel"]
    view.keys("Numpad5")
    view.select("Joint2")
    view.keys("f")
    np.testing.assert_allclose(
        view.ask("camera")["target"], 0.5 * (view.place("Joint2") + view.place("Joint3")), atol=0.2
    )


def test_a_film_is_exact_and_cancelling_makes_none(edit: Callable[..., View], tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    from PIL import Image

    view = edit(crooked_scene())
    bouncing(view)
    view.select()
    view.studio.draw()
    page = view.page
    page.get_by_test_id("open-playblast").click()
    page.get_by_test_id("playblast-size").select_option(label="640 × 360")
    page.get_by_test_id("playblast-last").fill("19")
    page.get_by_test_id("playblast-last").press("Tab")

    def made(kind: str) -> bytes:
        page.get_by_test_id(f"playblast-{kind}").click()
        with page.expect_download(timeout=120_000) as download:
            page.get_by_test_id("playblast-go").click()
        path = tmp_path / kind
        download.value.save_as(path)
        page.get_by_test_id("playblast-result").wait_for()
        return path.read_bytes()

    archive = zipfile.ZipFile(io.BytesIO(made("png")))
    assert archive.testzip() is None
    assert archive.namelist() == [f"frame-{n:04d}.png" for n in range(20)]
    pictures = [
        np.asarray(Image.open(io.BytesIO(archive.read(n))).convert("RGB"), np.int16) for n in archive.namelist()
    ]
    assert pictures[0].shape == (360, 640, 3)
    assert np.abs(pictures[0] - pictures[10]).mean() > 1  # something moves
    again = zipfile.ZipFile(io.BytesIO(made("png")))
    assert [again.read(n) for n in again.namelist()] == [archive.read(n) for n in archive.namelist()]
    for kind, codec in (("webm", "vp9"), ("gif", "gif"), ("mp4", "h264")):
        if not page.get_by_test_id(f"playblast-{kind}").is_enabled():
            assert kind == "mp4", "browsers encode VP9"
            continue
        with av.open(io.BytesIO(made(kind))) as film:
            stream = film.streams.video[0]
            frames = list(film.decode(stream))
            assert stream.codec_context.name == codec and (stream.width, stream.height) == (640, 360)
            assert [float(f.time) for f in frames] == pytest.approx([n / 25 for n in range(20)], abs=1e-3)
            for n in (0, 7, 19):
                shown = np.asarray(frames[n].to_image().convert("RGB"), np.int16)
                others = [np.abs(shown - p).mean() for p in pictures]
                assert int(np.argmin(others)) in (n, 20 - n) and others[n] < 6  # up and down look alike
    page.get_by_test_id("playblast-png").click()
    page.get_by_test_id("playblast-size").select_option(label="1920 × 1080")
    page.get_by_test_id("playblast-go").click()
    page.get_by_test_id("playblast-cancel").click()
    page.get_by_test_id("playblast-go").wait_for()
    assert not page.get_by_test_id("playblast-result").is_visible()
    page.keyboard.press("Escape")
    # the window is as it was
    view.settle()
    box = page.get_by_test_id("canvas").bounding_box()
    assert page.evaluate("[keypose.studio.view.canvas.width, keypose.studio.view.canvas.height]") == [
        math.floor(box["width"]), math.floor(box["height"])
    ]  # fmt: skip
