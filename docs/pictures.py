"""Draws the pictures of the docs: ``python docs/pictures.py`` (needs keypose installed; writes docs/images)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

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
