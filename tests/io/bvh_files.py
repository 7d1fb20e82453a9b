"""Small BVH files made by hand, for tests that change one thing at a time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from keypose.model import Pose, Scene, Skeleton

SMALL = """HIERARCHY
ROOT Hips
{
	OFFSET 0.0 90.0 0.0
	CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
	JOINT Spine
	{
		OFFSET 0.0 20.0 0.0
		CHANNELS 3 Zrotation Xrotation Yrotation
		End Site
		{
			OFFSET 0.0 10.0 0.0
		}
	}
	JOINT Leg
	{
		OFFSET 8.0 -5.0 0.0
		CHANNELS 3 Zrotation Yrotation Xrotation
		End Site
		{
			OFFSET 0.0 -85.0 0.0
		}
	}
}
MOTION
Frames: 2
Frame Time: 0.0333333
1.0 91.0 2.0 10.0 20.0 30.0 1.0 2.0 3.0 4.0 5.0 6.0
1.5 92.0 2.5 11.0 21.0 31.0 2.0 3.0 4.0 5.0 6.0 7.0
"""


def written(folder: Path, text: str | bytes, name: str = "take.bvh") -> Path:
    """A file of that content."""
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def one_joint(channels: str, rows: list[list[float]], offset: str = "0 0 0", child: str = "") -> str:
    """A file with one root of these channels, and one child where its block is given."""
    count = len(channels.split())
    body = "\n".join(" ".join(map(repr, row)) for row in rows)
    return (
        f"HIERARCHY\nROOT a\n{{\nOFFSET {offset}\nCHANNELS {count} {channels}\n{child}\n}}\n"
        f"MOTION\nFrames: {len(rows)}\nFrame Time: 0.04\n{body}\n"
    )


def turns(order: str, degrees: list[float]) -> np.ndarray:
    """The matrix of rotations about X, Y and Z, multiplied from left to right: written down from the definition."""
    total = np.eye(3)
    for axis, angle in zip(order, np.radians(degrees), strict=True):
        c, s = np.cos(angle), np.sin(angle)
        total = (
            total
            @ {
                "X": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
                "Y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
                "Z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
            }[axis]
        )
    return total


def world_of(scene: Scene) -> np.ndarray:
    """Joint matrices (T, J, 4, 4) of the scene's first motion."""
    from keypose.evaluate import world

    return np.asarray(world(scene.character.skeleton, scene.animations[0].pose))


def differences(a: Scene, b: Scene) -> tuple[float, float]:
    """Largest distance of joint positions in millimetres, and of joint rotations in degrees."""
    first, second = world_of(a), world_of(b)
    moved = np.linalg.norm(first[..., :3, 3] - second[..., :3, 3], axis=-1).max() * 1e3
    # |R - S| of two rotations is 2 sqrt(2) sin(angle / 2): precise for small angles, unlike the trace
    chord = np.linalg.norm(first[..., :3, :3] - second[..., :3, :3], axis=(-2, -1)).max()
    return float(moved), float(np.degrees(2 * np.arcsin(min(chord / np.sqrt(8), 1))))


def still(names: list[str], parents: list[int], translations: list[list[float]]) -> Skeleton:
    """A skeleton without rest rotations."""
    count = len(names)
    rest = Pose(np.array(translations, float), np.tile((1.0, 0, 0, 0), (count, 1)), np.ones((count, 3)))
    return Skeleton(tuple(names), np.array(parents), rest)


def moving_figure() -> str:
    """A file with position channels on a child, joints with one and no channels, and forty frames."""
    child = (
        "JOINT b\n{\nOFFSET 0 10 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n"
        "JOINT c\n{\nOFFSET 0 10 0\nCHANNELS 1 Xrotation\nJOINT d\n{\nOFFSET 1 2 3\nCHANNELS 0\n}\n}\n}"
    )
    rows = [[t, 90.0 + t, -t, 5 * t, t / 2, t / 3, 0.1 * t, 10.0, 0, t, 2 * t, 3 * t, -t] for t in range(40)]
    return one_joint("Xposition Yposition Zposition Zrotation Yrotation Xrotation", rows, child=child)
