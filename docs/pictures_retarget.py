"""Draws the picture of docs/retarget.md: ``KEYPOSE_DATA=... python docs/pictures_retarget.py`` (writes docs/images).

Needs the folder of real files: a capture of CMU's (mocap.cs.cmu.edu, funded by NSF EIA-0196217), MakeHuman's body, Geno, a
character of Kenney's and a robot (both CC0).
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from PIL import Image

from keypose import samples
from keypose.analysis import find_roles
from keypose.model import Character, Motion, Pose, Scene
from keypose.render import Camera, RenderSettings, render_image
from keypose.retarget import bind_stand, ground_under, retarget

IMAGES = Path(__file__).parent / "images"
DATA = Path(os.environ.get("KEYPOSE_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
TAKE = "asf_amc/cmu_02/02_03.amc"
BODIES = (
    "sample:human",
    "makehuman/default.mhskel",
    "fbx/geno/Geno.fbx",
    "fbx/ufbx_skin/maya_kenney_character_7700_binary.fbx",
    "gltf/cc0/robot.glb",
)
MOMENTS = (0.17, 0.42)


def opened(name: str) -> Scene:
    return samples.open_scene(name if name.startswith("sample:") else str(DATA / name))


def held(character: Character, motion: Motion, frame: int) -> Motion:
    """One frame, with the hips over the origin."""
    pose = motion.pose.broadcast()
    translations = np.array(pose.translations[frame : frame + 1])
    hips = find_roles(character.skeleton, known=character.roles or None).roles["hips"]
    if character.skeleton.parents[hips] < 0:
        translations[:, hips, [0, 2]] = 0.0
    kept = Pose(translations, pose.rotations[frame : frame + 1], pose.scales[frame : frame + 1])
    return Motion(motion.joint_names, kept, 1.0, name=character.name)


def main() -> None:
    source = opened(TAKE)
    performed = source.animations[0]
    assert isinstance(performed, Motion)
    cast: list[tuple[Character, Motion]] = [(source.character, performed)]
    for name in BODIES:
        character = opened(name).character
        stand = bind_stand(character, find_roles(character.skeleton).roles)
        done = retarget(
            performed,
            source.character.skeleton,
            character.skeleton,
            target_reference=stand,
            target_ground_m=ground_under(character, stand),
        )
        cast.append((character, done.motion))
    tiles: list[np.ndarray] = []
    for moment in MOMENTS:
        frame = round(moment * performed.rate_hz)
        row: list[np.ndarray] = []
        for character, motion in cast:
            still = held(character, motion, frame)
            camera = Camera(azimuth_deg=58, elevation_deg=7, fov_deg=18, margin=0.04)
            settings = RenderSettings(width=320, height=400, camera=camera)
            row.append(render_image(Scene((character,), (still,)), still, 0.0, settings)[..., :3])
        tiles.append(np.concatenate(row, axis=1))
    Image.fromarray(np.concatenate(tiles, axis=0)).save(IMAGES / "retarget.jpg", quality=88)


if __name__ == "__main__":
    main()
