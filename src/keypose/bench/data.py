"""Data for the benchmarks, made from scratch: a body, looping clips, a crowd, a mesh, a BVH text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]
Ints = NDArray[np.integer[Any]]

CLIP_FRAMES = (41, 25, 21)  # of the three looping clips, at 30 Hz; the last frame is the first again
BODY_JOINTS = 26  # of the 67; the rest are fingers and the jaw

_SPINE = ((0, 0.1, 0), (0, 0.12, 0.01), (0, 0.12, 0.01), (0, 0.12, 0))
_HEAD = ((0, 0.1, 0), (0, 0.08, 0.02), (0, 0.1, 0.01))
_ARM = ((0.04, 0.05, 0), (0.14, 0, 0), (0.27, -0.05, -0.06), (0.24, -0.02, 0.08), (0.08, 0, 0))
_LEG = ((0.09, -0.05, 0), (0.01, -0.41, 0.07), (0, -0.41, -0.08), (0, -0.05, 0.15))


def body(joints: int | None = None) -> tuple[Ints, Floats]:
    """Parents (67,) and offsets (67, 3) in metres, or of the first joints only.

    The first 26 are a body with head, hands and feet.
    """
    parents, offsets = [-1], [(0.0, 0.95, 0.0)]

    def chain(parent: int, steps: tuple[tuple[float, ...], ...], side: float = 1.0) -> int:
        for x, y, z in steps:
            parents.append(parent)
            offsets.append((side * x, y, z))
            parent = len(parents) - 1
        return parent

    chest = chain(0, _SPINE)
    head = chain(chest, _HEAD)
    hands = [chain(chest, _ARM, side) for side in (1, -1)]
    for side in (1, -1):
        chain(0, _LEG, side)
    for side, hand in zip((1, -1), hands, strict=True):
        for finger in range(5):
            chain(hand, ((0.02, 0, 0.02 * (finger - 2)), (0.04, 0, 0), (0.03, 0, 0), (0.02, 0, 0)), side)
    chain(head, ((0, -0.05, 0.08),))
    return np.array(parents)[:joints], np.array(offsets)[:joints]


def unit(vectors: Floats) -> Floats:
    """Vectors (*B, C) brought to length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def clips(offsets: Floats, rng: np.random.Generator) -> list[tuple[Floats, Floats]]:
    """Three looping clips: rotations (F, J, 4) wxyz that swing about 0.2 radians, and translations (F, J, 3)."""
    made: list[tuple[Floats, Floats]] = []
    for frames in CLIP_FRAMES:
        phase = 2 * np.pi * np.arange(frames) / (frames - 1)
        waves = np.stack([np.sin(phase), np.cos(phase), np.sin(2 * phase), np.ones(frames)], axis=1)
        turns = np.einsum("fw,wja->fja", waves, rng.normal(0, 0.15, (4, len(offsets), 3)))
        half = np.linalg.norm(turns, axis=-1, keepdims=True) / 2
        rotations = np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * turns], axis=-1)
        translations = np.broadcast_to(offsets, (frames, *offsets.shape)).copy()
        translations[:, 0] += waves[:, :3] * (0.02, 0.03, 0.02)
        made.append((rotations.astype(np.float32), translations.astype(np.float32)))
    return made


def crowd(characters: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Where each character is in its three clips, in frames, and how much they weigh: (n, 3) each."""
    return rng.random((characters, 3)) * (np.array(CLIP_FRAMES) - 1), rng.dirichlet((2, 2, 2), characters)


@dataclass(frozen=True, slots=True)
class Cloud:
    """Vertices round the joints of a body in its rest pose, four influences each."""

    joints: Ints
    weights: Floats
    positions: Floats
    normals: Floats
    joint_from_mesh: Floats


def cloud(parents: Ints, offsets: Floats, rng: np.random.Generator, vertices: int = 4000) -> Cloud:
    """A mesh of ``vertices`` vertices for a skeleton whose rest pose has no rotations."""
    places = offsets.copy()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            places[joint] += places[parent]
    main = np.sort(rng.integers(0, len(parents), vertices))
    up = np.maximum(parents[main], 0)
    joints = np.stack([main, up, np.maximum(parents[up], 0), np.minimum(main + 1, len(parents) - 1)], axis=1)
    normals = unit(rng.normal(size=(vertices, 3)))
    bind = np.tile(np.eye(4), (len(parents), 1, 1))
    bind[:, :3, 3] = -places
    weights = rng.dirichlet((4, 2, 1, 1), vertices)
    positions = places[main] + 0.05 * normals
    return Cloud(joints, *(a.astype(np.float32) for a in (weights, positions, normals, bind)))


def bvh(rng: np.random.Generator, frames: int = 5000, joints: int = 31) -> tuple[bytes, Floats, bytes]:
    """A BVH file of about 5 MB: everything before the numbers, the numbers (F, C), and the whole file."""
    lines = ["HIERARCHY", "ROOT j0", "{", "OFFSET 0 0 0"]
    lines += ["CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation"]
    for joint in range(1, joints):
        lines += [f"JOINT j{joint}", "{", "OFFSET 0 10 0", "CHANNELS 3 Zrotation Yrotation Xrotation"]
    lines += ["End Site", "{", "OFFSET 0 5 0", "}"] + ["}"] * joints
    lines += ["MOTION", f"Frames: {frames}", "Frame Time: 0.008333"]
    numbers = np.round(np.cumsum(rng.normal(0, 0.8, (frames, 3 * joints + 3)), axis=0), 6)
    row = " ".join(["%.6f"] * numbers.shape[1])
    header = ("\n".join(lines) + "\n").encode()
    return header, numbers, header + "".join(row % tuple(r) + "\n" for r in numbers.tolist()).encode()
