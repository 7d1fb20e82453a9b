"""Small scenes and uploads made by code, so that the tests need no files."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from keypose.model import (
    Channel,
    Character,
    Clip,
    Curve,
    CurveKind,
    Interpolation,
    Material,
    Mesh,
    MorphSet,
    Motion,
    Part,
    Pose,
    Property,
    Scene,
    Skeleton,
    Skin,
)
from keypose.studio import StudioServer
from keypose.studio.container import Body, pack

Start = Callable[..., StudioServer]


def upload(*files: tuple[str, bytes]) -> bytes:
    """The container of files dropped together."""
    body = Body()
    entries = []
    for name, data in files:
        ref = body.add_bytes(data)
        entries.append({"name": name, "bytes": {"offset": ref.offset, "bytes": ref.bytes}})
    return pack({"type": "upload", "files": entries}, body)


def turn(angles: np.ndarray, axis: int = 2) -> np.ndarray:
    """Rotations about one axis, wxyz."""
    q = np.zeros((*np.shape(angles), 4))
    q[..., 0], q[..., 1 + axis] = np.cos(np.asarray(angles) / 2), np.sin(np.asarray(angles) / 2)
    return q


def arm_skeleton(joints: int = 4, size: float = 1.0) -> Skeleton:
    """A chain that stands upright, half a metre (times ``size``) from joint to joint."""
    translations = np.zeros((joints, 3))
    translations[1:, 1] = 0.5 * size
    rest = Pose(translations, turn(np.zeros(joints)), np.ones((joints, 3)))
    names = ("Root", *(f"Joint{n}" for n in range(1, joints)))
    return Skeleton(names, np.arange(-1, joints - 1), rest, ((joints - 1, (0.0, 0.3, 0.0)),))


def arm_mesh(skeleton: Skeleton, influences: int = 2) -> tuple[Mesh, Skin]:
    """A tube around the chain, smoothly bound to it."""
    rings, sides = 25, 12
    height = np.linspace(0, 0.5 * skeleton.joint_count, rings)
    angle = np.arange(sides) / sides * 2 * np.pi
    around = np.stack([np.cos(angle), np.zeros(sides), np.sin(angle)], -1)
    positions = (0.15 * around[None] + height[:, None, None] * [0, 1, 0]).reshape(-1, 3)
    r, s = np.meshgrid(np.arange(rings - 1), np.arange(sides), indexing="ij")
    a, b = (r * sides + s).ravel(), (r * sides + (s + 1) % sides).ravel()
    triangles = np.concatenate([np.stack([a, a + sides, b], -1), np.stack([b, a + sides, b + sides], -1)])
    distance = np.abs(positions[:, 1, None] - 0.5 * np.arange(skeleton.joint_count) - 0.25)
    joints = np.argsort(distance, axis=1)[:, :influences]
    weights = np.exp(-4 * np.take_along_axis(distance, joints, 1))
    weights /= weights.sum(1, keepdims=True)
    inverse = np.tile(np.eye(4), (skeleton.joint_count, 1, 1))
    inverse[:, 1, 3] = -0.5 * np.arange(skeleton.joint_count)
    mesh = Mesh(positions.astype(np.float32), triangles, np.tile(around, (rings, 1)).astype(np.float32))
    return mesh, Skin(np.arange(skeleton.joint_count), inverse, joints, weights)


def arm_clip(skeleton: Skeleton) -> Clip:
    """One second of waving with every kind of interpolation, and a morph that swells."""
    times = np.array([0.0, 0.25, 0.6, 1.0])
    curves = {
        Channel("Root", Property.TRANSLATION): Curve(times, np.array([[0, 0, 0], [0.2, 0, 0], [0.2, 0.1, 0], [0, 0, 0.3]])),
        Channel("Joint1", Property.ROTATION): Curve(times, turn(np.array([0, 0.6, -0.4, 0])), kind=CurveKind.ROTATION),
        Channel("Joint2", Property.ROTATION): Curve(
            times, turn(np.array([0, 0.9, 0.2, 0]), 0), Interpolation.STEP, kind=CurveKind.ROTATION
        ),
        Channel("Joint3", Property.SCALE): Curve(
            times, np.array([[1, 1, 1], [1.2, 1, 1], [1, 0.8, 1], [1, 1, 1]]), Interpolation.HERMITE,
            np.full((4, 3), 0.3), np.full((4, 3), -0.2),
        ),
        Channel("swell", Property.WEIGHT): Curve(times, np.array([[0], [1], [0.3], [0]]), kind=CurveKind.SCALAR),
    }  # fmt: skip
    return Clip(curves, "wave", 30.0)


def arm_motion(skeleton: Skeleton, frames: int = 61) -> Motion:
    """One second of swaying at 60 Hz; bones keep their lengths."""
    t = np.linspace(0, 1, frames)
    rotations = np.stack([turn(0.3 * (j + 1) * np.sin(2 * np.pi * t), j % 3) for j in range(skeleton.joint_count)], 1)
    return Motion(
        skeleton.names, Pose(skeleton.rest.translations, rotations, skeleton.rest.scales), frames - 1.0, "sway"
    )


def arm_scene(influences: int = 2, *, skeleton_only: bool = False, size: float = 1.0) -> Scene:
    """The tube with a morph, a clip and a motion; or the chain alone with the motion."""
    skeleton = arm_skeleton(size=size)
    if skeleton_only:
        return Scene(
            (Character(skeleton, name="chain"),), (arm_motion(skeleton),), format="made", notes=("made by code",)
        )
    mesh, skin = arm_mesh(skeleton, influences)
    swell = np.where(mesh.positions[:, 1:2] > 1.5, np.asarray(mesh.normals) * 0.1, 0.0)
    morphs = MorphSet.from_dense(("swell", "lean"), np.stack([swell, np.tile([0.05, 0, 0], (len(swell), 1))]))
    part = Part("tube", mesh, Material("clay", (0.8, 0.3, 0.2, 1.0), double_sided=True), skin, morphs=morphs)
    corners = np.array([[x, y, z] for x in (-0.08, 0.08) for y in (0.1, 0.2) for z in (-0.08, 0.08)], np.float32)
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    box = Mesh(corners, np.array([[q[i], q[j], q[k]] for q in faces for i, j, k in ((0, 1, 2), (0, 2, 3))]))
    tip = Part("tip", box, Material("tip", (0.1, 0.5, 0.6, 1.0)), joint=3)
    character = Character(skeleton, (part, tip), "arm", ("swell", "lean"))
    return Scene((character,), (arm_clip(skeleton), arm_motion(skeleton)), format="made", notes=("made by code",))
