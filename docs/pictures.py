"""Draws the pictures of the docs: ``python docs/pictures.py`` (needs keypose installed; writes docs/images).

The pages of the studio are photographed in a real browser: those need Playwright and Chromium.
"""

from __future__ import annotations

import io as streams
import shutil
import threading
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from keypose import samples
from keypose.evaluate import sample, sample_morphs
from keypose.model import Motion, Scene
from keypose.render import Camera, RenderSettings, contact_sheet, render_image

IMAGES = Path(__file__).parent / "images"


def held(motion: Motion, time_s: float) -> Motion:
    """One moment of a performance, with the hips over the origin."""
    human = samples.load("human").character
    pose = sample(motion, human.skeleton, np.array([time_s]))
    translations = np.array(pose.translations)
    translations[:, 0, [0, 2]] = 0
    weights = sample_morphs(motion, human.morph_names, np.array([time_s]), human.rest_morph_weights)
    return Motion(
        human.skeleton.names,
        replace(pose, translations=translations),
        1.0,
        name=motion.name,
        morph_names=human.morph_names,
        morph_weights=weights,
    )


def performances() -> None:
    """Six performances in one row."""
    human = samples.load("human").character
    moments = (("talk", 2.2), ("walk", 0.06), ("wave", 1.42), ("jump", 0.86), ("run", 0.21), ("idle", 0.5))
    motions = tuple(held(samples.load(name).animation(name), time) for name, time in moments)
    scene = Scene((human,) * len(motions), motions)
    settings = RenderSettings(
        width=1600,
        height=600,
        camera=Camera(azimuth_deg=9, elevation_deg=6, fov_deg=15, margin=0.03),
        arrangement="row",
    )
    save(render_image(scene, list(motions), 0.0, settings), "performances.jpg")


def turnaround() -> None:
    """The built-in human from all sides."""
    still = replace(samples.load("human"), animations=())
    settings = RenderSettings(width=1600, height=680, sheet_frames=5, camera=Camera(elevation_deg=5, margin=0.02))
    save(contact_sheet(still, settings=settings), "turnaround.jpg")


def faces() -> None:
    """A few of the face shapes."""
    scene = samples.load("idle")
    human = scene.character
    looks: list[dict[str, float]] = [
        {},
        {"mouthSmileLeft": 0.8, "mouthSmileRight": 0.8, "cheekSquintLeft": 0.5, "cheekSquintRight": 0.5},
        {"jawOpen": 0.5, "mouthSmileLeft": 0.7, "mouthSmileRight": 0.7, "browInnerUp": 0.4},
        {"browDownLeft": 0.9, "browDownRight": 0.9, "mouthFrownLeft": 0.6, "mouthFrownRight": 0.6},
        {"eyeWideLeft": 1, "eyeWideRight": 1, "browInnerUp": 1, "browOuterUpLeft": 1, "browOuterUpRight": 1, "viseme_O": 0.8},
        {"eyeBlinkLeft": 1, "eyeBlinkRight": 1, "mouthSmileLeft": 0.3, "mouthSmileRight": 0.3},
        {"viseme_aa": 0.9},
        {"viseme_U": 0.9},
    ]  # fmt: skip
    tiles = []
    for look in looks:
        rest = held(scene.animation("idle"), 0.0)
        weights = np.array([[look.get(name, 0.0) for name in human.morph_names]], np.float32)
        shown = Scene((human,), (replace(rest, morph_weights=weights),))
        camera = Camera(azimuth_deg=22, elevation_deg=2, target=(0.0, 1.53, 0.02), distance=0.98)
        tiles.append(render_image(shown, None, 0.0, RenderSettings(width=400, height=400, camera=camera)))
    rows = [np.concatenate(tiles[i : i + 4], axis=1) for i in (0, 4)]
    save(np.concatenate(rows, axis=0), "faces.jpg")


@contextmanager
def studio_page(*, graph: bool, theme: str, opened: tuple[tuple[str, Scene], ...] | None = None) -> Generator[Any]:
    """The studio on the built-in human or graph, or on other scenes, in a browser without a window."""
    from playwright.sync_api import sync_playwright

    from keypose.studio import StudioServer
    from keypose.studio.graphs import built_in

    listening = threading.Event()
    scenes = opened if opened is not None else () if graph else (("sample:human", samples.load("human")),)
    graphs = (built_in("locomotion"),) if graph else ()
    server = StudioServer(scenes, graphs=graphs, ready=lambda _: listening.set())
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    listening.wait(20)
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=shutil.which("chromium"), args=["--no-sandbox", "--use-angle=swiftshader"]
            )
            page = browser.new_page(viewport={"width": 1440, "height": 810}, color_scheme=theme)  # type: ignore[arg-type]
            page.goto(server.url)
            until(page, "Boolean(window.keypose?.test.ready())")
            yield page
            browser.close()
    finally:
        server.stop()
        thread.join(10)


def until(page: Any, expression: str) -> None:
    """Wait until a page says so; its policy forbids Playwright's own way to wait."""
    for _ in range(1200):
        if page.evaluate(expression):
            return
        page.wait_for_timeout(50)
    raise TimeoutError(expression)


def photograph(page: Any, name: str) -> None:
    """The page as it is."""
    from PIL import Image

    page.wait_for_timeout(1500)
    save(np.asarray(Image.open(streams.BytesIO(page.screenshot())).convert("RGB")), name)


def view_page() -> None:
    """The studio's first page."""
    with studio_page(graph=False, theme="dark") as page:
        until(page, "keypose.studio.time > 0.2")
        page.evaluate("keypose.studio.pause(); keypose.studio.seekFrame(19); keypose.studio.show('ghosts', true)")
        page.evaluate("keypose.studio.select(keypose.studio.active.rig.names.indexOf('RightForeArm'))")
        photograph(page, "studio.jpg")


def play_page() -> None:
    """The play page in the middle of a jump's beginning, after a walk and a wave; made step by step, so always the same."""
    keyboard: Any = None

    def steps(count: int) -> None:
        for _ in range(count):
            number = page.evaluate("keypose.test.play().number")
            keyboard.press(".")
            until(page, f"keypose.test.play().number > {number}")

    with studio_page(graph=True, theme="dark") as page:
        keyboard = page.keyboard
        until(page, "keypose.test.play().number > 3")
        keyboard.press("p")
        keyboard.press("Backspace")
        until(page, "keypose.test.play().time < 0.1")
        page.evaluate("keypose.test.drawNothing(true)")
        steps(40)
        keyboard.down("w")
        steps(130)
        keyboard.press("e")
        steps(110)
        keyboard.press("e")
        keyboard.press("Shift+w")
        keyboard.down("Shift")
        keyboard.down("w")
        steps(90)
        page.evaluate("keypose.play.set({speed: [2.4]})")
        steps(40)
        keyboard.press(" ")
        page.evaluate("keypose.test.drawNothing(false)")
        page.mouse.move(620, 500)
        page.mouse.down()
        page.mouse.move(742, 506, steps=4)
        page.mouse.up()
        page.mouse.move(620, 420)
        steps(9)
        page.evaluate("keypose.play.node = 6")
        photograph(page, "play.jpg")


def crowd_page() -> None:
    """The crowd page, some seconds after everybody began to walk."""
    with studio_page(graph=True, theme="light") as page:
        page.evaluate("Object.assign(keypose.crowd, { count: 250, seed: 12 })")
        page.evaluate("keypose.crowd.look.orbit = false")
        page.click("[data-testid=tab-crowd]")
        until(page, "keypose.test.crowd().ready && keypose.test.crowd().received > 2")
        page.evaluate("keypose.test.crowdDrawNothing(true)")
        until(page, "keypose.test.crowd().time > 9")
        radius = page.evaluate("keypose.test.crowd().radius")
        page.evaluate(f"keypose.test.crowdLookFrom([{0.36 * radius}, 4.6, {0.86 * radius}], [{-0.1 * radius}, 0.2, 0])")
        until(page, "keypose.test.crowd().inLevel[0] > 0")
        time = page.evaluate("keypose.test.crowd().time")
        until(page, f"keypose.test.crowd().time > {time} + 0.5")
        page.evaluate("keypose.crowd.setPace({ paused: true })")
        page.evaluate("keypose.test.crowdDrawNothing(false)")
        page.wait_for_timeout(3000)
        photograph(page, "crowd.jpg")


def save(picture: np.ndarray, name: str) -> None:
    """Write a picture, small enough for a page."""
    from PIL import Image

    IMAGES.mkdir(exist_ok=True)
    Image.fromarray(np.ascontiguousarray(picture[..., :3])).save(IMAGES / name, quality=90, optimize=True)
    print(f"{IMAGES / name}: {(IMAGES / name).stat().st_size // 1024} KB")


if __name__ == "__main__":
    performances()
    turnaround()
    faces()
    view_page()
    play_page()
    crowd_page()
