"""Draws the pictures of docs/constraints.md: ``python docs/pictures_constraints.py`` (writes docs/images)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from pictures_principles import BLUE, CORAL, FAINT, GOLD, GREEN, GRID, IMAGES, Sheet
from PIL import Image

from keypose import samples
from keypose.analysis import find_roles, foot_contacts
from keypose.editing.constraints import Place, kept_in_place
from keypose.editing.paths import GroundPath, close_path, extract_path, follow_points, put_on_path
from keypose.editing.reach import Reach, reach
from keypose.editing.spacetime import solve_spacetime
from keypose.evaluate import world_rotations_positions
from keypose.model import Motion, Pose, Scene, Skeleton
from keypose.render import Camera, RenderSettings, render_image

PIXELS_A_METRE = 110.0


def strip(scene: Scene, rows: Sequence[Motion], frames: Sequence[int], camera: Camera, name: str) -> None:
    """Moments of motions, one motion a row; the camera goes with the hips."""
    lines: list[np.ndarray] = []
    for motion in rows:
        hips = motion.pose.broadcast().translations[:, 0]
        line = []
        for frame in frames:
            target = (float(hips[frame, 0]), camera.target[1] if camera.target else 0.0, float(hips[frame, 2]))
            settings = RenderSettings(width=210, height=330, camera=replace(camera, target=target))
            line.append(
                render_image(replace(scene, animations=(motion,)), motion, frame / motion.rate_hz, settings)[..., :3]
            )
        lines.append(np.concatenate(line, axis=1))
    Image.fromarray(np.concatenate(lines, axis=0)).save(IMAGES / name, quality=88, optimize=True)
    print(f"{IMAGES / name}: {(IMAGES / name).stat().st_size // 1024} KB")


def reaching(scene: Scene, walk: Motion) -> None:
    """A walk before and after a reach."""
    done = reach(walk, scene.character.skeleton, [Reach("left_hand", 60, 66, target=(0.34, 1.3, 1.6))], ease_s=0.45)
    camera = Camera(62.0, 6.0, fov_deg=24.0, target=(0.0, 0.84, 0.0), distance=4.8)
    strip(scene, [walk, done.motion], range(36, 91, 9), camera, "constraints-reach.jpg")


def picking_up(scene: Scene, idle: Motion) -> None:
    """A hand to the ground, the feet where they are."""
    body = scene.character.skeleton
    feet = kept_in_place(idle, body, ["LeftFoot", "RightFoot"], np.arange(10, 121))
    done = solve_spacetime(idle, body, (10, 120), [Place("left_hand", np.arange(62, 69), (0.25, 0.14, 0.42)), *feet])
    camera = Camera(64.0, 6.0, fov_deg=24.0, target=(0.0, 0.8, 0.0), distance=4.9)
    strip(scene, [done.motion], range(26, 105, 13), camera, "constraints-spacetime.jpg")


def repeated(walk: Motion, times: int) -> Motion:
    """A walk that ends as it begins, gone several times in a row."""
    pose = walk.pose.broadcast()
    rotations, translations = pose.rotations[:-1], np.array(pose.translations)
    stride = translations[-1, 0] - translations[0, 0]
    moved = [
        translations[:-1] + np.where(np.arange(pose.joint_count)[:, None] == 0, n * stride, 0.0) for n in range(times)
    ]
    count = times * len(rotations)
    everything = Pose(np.concatenate(moved), np.concatenate([rotations] * times), np.ones((count, pose.joint_count, 3)))
    return Motion(walk.joint_names, everything, walk.rate_hz, name="walk")


def ways(scene: Scene, walk: Motion) -> None:
    """The same walk on three paths, from above, with its footprints."""
    body = scene.character.skeleton
    roles = find_roles(body).roles
    path = extract_path(walk, body, roles=roles)
    drawn = np.array([[0.0, 0.0], [0.1, 1.2], [1.4, 2.1], [1.5, 3.6], [-0.4, 4.2], [-0.6, 5.2]])
    sheet = Sheet(1060, 528)
    for title, way, box, origin in (
        ("As it was", path, (16, 16, 1044, 134), (118.0, 86.0)),
        ("Closed to a circle", close_path(path, 1), (16, 146, 386, 512), (201.0, 464.0)),
        ("On a drawn line", follow_points(path, drawn), (398, 146, 1044, 512), (446.0, 380.0)),
    ):
        sheet.panel(box, title)
        done = put_on_path(walk, body, way, old=path, roles=roles)
        footprints(sheet, done.motion, way, body, roles, origin)
        if "drawn" in title:
            for x, y in on_page(drawn, origin):
                sheet.diamond(x, y)
    sheet.save("constraints-paths.png")


def on_page(points: np.ndarray, origin: tuple[float, float]) -> np.ndarray:
    """Places (N, 2) of x and z seen from above: +Z goes to the right, +X up."""
    x, z = points[:, 0], points[:, 1]
    return np.stack([origin[0] + z * PIXELS_A_METRE, origin[1] - x * PIXELS_A_METRE], axis=-1)


def footprints(
    sheet: Sheet, motion: Motion, way: GroundPath, body: Skeleton, roles: Mapping[str, int], origin: tuple[float, float]
) -> None:
    """The path, the hips' own way, and every frame in which a ball of a foot stands: a foot that slides leaves a smear."""
    places = np.asarray(world_rotations_positions(body, motion.pose.broadcast())[1], np.float64)[..., [0, 2]]
    standing = put_contacts(motion, body, roles)
    sheet.line(on_page(way.points, origin), GRID, 9)
    sheet.line(on_page(way.points, origin), FAINT, 1.2)
    sheet.line(on_page(places[:, roles["hips"]], origin), GREEN, 1.4)
    for side, color in (("left", BLUE), ("right", CORAL)):
        flags = standing[f"{side}_ball"]
        heels, balls = (on_page(places[:, roles[f"{side}_{part}"]], origin) for part in ("foot", "toes"))
        for ball in balls[flags]:
            sheet.dot(ball[0], ball[1], 3.6, color)
        flat = np.flatnonzero(flags & standing[f"{side}_heel"])
        for frames in np.split(flat, np.flatnonzero(np.diff(flat) > 1) + 1):
            if len(frames):
                sheet.line([heels[frames[len(frames) // 2]], balls[frames[len(frames) // 2]]], color, 3.2)
    first = on_page(way.points[:1], origin)[0]
    sheet.dot(first[0], first[1], 4.5, "#ffffff", GOLD)


def put_contacts(motion: Motion, body: Skeleton, roles: Mapping[str, int]) -> dict[str, np.ndarray]:
    """When heels and balls touch the ground."""
    places = np.asarray(world_rotations_positions(body, motion.pose.broadcast())[1], np.float64)
    hip, knee, foot = (places[0, roles[f"left_{p}"]] for p in ("upper_leg", "lower_leg", "foot"))
    leg_m = float(np.linalg.norm(hip - knee) + np.linalg.norm(knee - foot))
    return foot_contacts(roles, places, motion.rate_hz, leg_m)


def main() -> None:
    scene = samples.load("human")
    motions = {a.name: a for a in scene.animations}
    reaching(scene, motions["walk"])
    picking_up(scene, motions["idle"])
    ways(scene, repeated(motions["walk"], 3))


if __name__ == "__main__":
    main()
