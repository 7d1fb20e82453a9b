"""The 3D view of the edit page as the tests drive it, and characters whose joints are made to be difficult."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from studio_page import StudioPage
from studio_scenes import arm_mesh, arm_skeleton

from keypose.model import Character, Material, Part, Pose, Scene, Skeleton


class View:
    """The 3D view of a page that edits one character."""

    def __init__(self, page: StudioPage) -> None:
        self.studio, self.page = page, page.page

    def ask(self, name: str, *arguments: Any) -> Any:
        return self.page.evaluate(
            "([name, given]) => window.keypose.test.viewport[name](...given)", [name, list(arguments)]
        )

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        return self.studio.until(condition, what)

    def settle(self) -> None:
        """Wait until what was done is drawn, and the server has it."""
        self.until(lambda: self.page.evaluate("keypose.editor.waiting === 0"), "the server has every edit")
        self.studio.drawn()

    def add(self, source: str) -> None:
        """Take a character into the project and wait until it stands there."""
        self.page.evaluate("(source) => keypose.project.addCharacter(source)", source)
        self.until(lambda: self.page.evaluate("Boolean(keypose.editor.actor && keypose.test.viewport)"), "it is there")
        self.settle()

    def select(self, *names: str) -> None:
        self.ask("selectJoints", list(names))
        self.settle()

    def tools(self, **change: Any) -> Any:
        found = self.ask("viewTools", change)
        self.settle()
        return found

    def auto_key(self, on: bool = True) -> None:
        self.page.evaluate("(on) => (keypose.editor.autoKey = on)", on)

    def seek(self, time: float) -> None:
        self.page.evaluate("(time) => keypose.editor.seek(time)", time)
        self.settle()

    def keys(self, *keys: str) -> None:
        """Press keys with the pointer over the stage."""
        box = self.page.get_by_test_id("canvas").bounding_box()
        self.page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 0.6 * box["height"])
        for key in keys:
            self.page.keyboard.press(key)
        self.settle()

    def drag(
        self, start: list[float], end: list[float], *, steps: int = 6, hold: str = "", release: bool = True
    ) -> None:
        self.page.mouse.move(*start)
        self.page.wait_for_timeout(60)
        self.page.mouse.down()
        if hold:
            self.page.keyboard.down(hold)
        self.page.mouse.move(*end, steps=steps)
        if hold:
            self.page.keyboard.up(hold)
        if release:
            self.page.mouse.up()
        self.settle()

    def undo(self) -> None:
        self.page.evaluate("keypose.editor.undo()")
        self.settle()

    def place(self, name: str) -> np.ndarray:
        return np.array(self.ask("placeOf", name))

    def axes(self, name: str) -> np.ndarray:
        """Columns of model_from_joint, with its scale."""
        return np.array(self.ask("worldOf", name)[:9]).reshape(3, 3).T

    def local(self, name: str) -> dict[str, np.ndarray]:
        return {key: np.array(value) for key, value in self.ask("localOf", name).items()}

    def curves(self) -> dict[str, list[float]]:
        """Times of the keys of the active clip's curves."""
        found: dict[str, list[float]] = self.page.evaluate(
            """() => Object.fromEntries([...(keypose.editor.clip?.curves.values() ?? [])].map(
                 (c) => [c.channel.key.replaceAll("\\u0000", "."), [...c.times]]))"""
        )
        return found

    def document(self) -> str:
        """Everything that the document holds, as text."""
        return str(
            self.page.evaluate(
                """() => JSON.stringify(keypose.editor.document, (_, v) =>
                     v instanceof Map ? [...v] : ArrayBuffer.isView(v) ? Array.from(v, (x) => x.toString()) : v)"""
            )
        )


def crooked_scene() -> Scene:
    """The tube on joints that are turned and scaled at rest, so that no axis of a joint is one of the model's."""
    plain = arm_skeleton()
    turns = Rotation.from_euler("XYZ", [[0, 0, 0], [20, 35, -40], [-50, 15, 30], [10, -60, 25]], degrees=True)
    rotations = np.roll(turns.as_quat(), 1, axis=-1)
    scales = np.array([[1, 1, 1], [1.6, 1.6, 1.6], [0.7, 0.7, 0.7], [1, 1, 1.0]])
    skeleton = Skeleton(plain.names, plain.parents, Pose(plain.rest.translations, rotations, scales))
    mesh, skin = arm_mesh(plain)
    part = Part("tube", mesh, Material("clay", (0.8, 0.3, 0.2, 1.0), double_sided=True), skin)
    return Scene((Character(skeleton, (part,), "crooked"),), format="made")


def odd_person() -> Scene:
    """A symmetric stick figure whose joints have arbitrary axes of their own."""
    rng = np.random.default_rng(7)
    centre = {"Hips": ("", (0, 1, 0.02)), "Chest": ("Hips", (0, 1.4, 0)), "Head": ("Chest", (0, 1.6, 0.05))}
    left = {"LeftArm": ("Chest", (0.2, 1.38, 0)), "LeftHand": ("LeftArm", (0.5, 1.1, 0.1)),
            "l_thumb": ("LeftHand", (0.52, 1.05, 0.15)), "LeftLeg": ("Hips", (0.1, 0.9, 0)), "LeftFoot": ("LeftLeg", (0.12, 0.1, 0))}  # fmt: skip
    other = {"l_thumb": "r_thumb"} | {name: name.replace("Left", "Right") for name in left if "Left" in name}
    right = {other[n]: (other.get(p, p), (-x, y, z)) for n, (p, (x, y, z)) in left.items()}
    joints = centre | left | right
    names = tuple(joints)
    world = Rotation.random(len(names), rng=rng)
    parents = np.array([names.index(p) if p else -1 for p, _ in joints.values()])
    places = np.array([place for _, place in joints.values()], float)
    rotations, translations = np.zeros((len(names), 4)), np.zeros((len(names), 3))
    for j, p in enumerate(parents):
        up = Rotation.identity() if p < 0 else world[p]
        rotations[j] = np.roll((up.inv() * world[j]).as_quat(), 1)
        translations[j] = up.inv().apply(places[j] - (0 if p < 0 else places[p]))
    skeleton = Skeleton(names, parents, Pose(translations, rotations, np.ones((len(names), 3))))
    return Scene((Character(skeleton, (), "odd"),), format="made")


def unit(columns: np.ndarray) -> np.ndarray:
    return columns / np.linalg.norm(columns, axis=0)


def about(axis: np.ndarray | list[float], degrees: float) -> np.ndarray:
    return Rotation.from_rotvec(np.radians(degrees) * np.asarray(axis, float)).as_matrix()


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """Degrees between two rotations, wxyz."""
    return float(np.degrees(2 * np.arccos(min(1.0, abs(float(np.dot(a, b)))))))


def drop(view: View) -> None:
    view.page.evaluate("(keypose.editor.posed = new Map(), keypose.studio.view.invalidatePose())")
    view.settle()


def bouncing(view: View) -> None:
    """The root at three places, keyed."""
    view.auto_key()
    view.tools(space="global", turns="individual")
    view.select("Root")
    for time, height in ((0.0, "0"), (0.4, "1"), (0.8, "-")):
        view.seek(time)
        view.keys("g", "y", *height, *(["1"] if height == "-" else []), "Enter")
