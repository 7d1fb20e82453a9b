"""What the tests of pictures share: a small jointed character, and a skip where there is no OpenGL driver."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from keypose.model import Character, Material, Mesh, MorphSet, Motion, Part, Pose, Scene, Skeleton, Skin
from keypose.render import RenderSettings


@cache
def _gl_problem() -> str:
    from keypose.errors import KeyposeError
    from keypose.render.gl import context

    try:
        context()
    except KeyposeError as problem:
        return str(problem)
    return ""


@pytest.fixture(autouse=True)
def _needs_gl(request: pytest.FixtureRequest) -> None:
    if request.node.get_closest_marker("gl") and _gl_problem():
        pytest.skip(_gl_problem())


def arm(influences: int = 2, material: Material | None = None, seed: int = 1) -> Character:
    """A tube along Y over a chain of joints, with smooth weights, a morph target, vertex colours and uvs."""
    joints, rings, sides, height = 8, 33, 24, 1.6
    step = height / joints
    rest = Pose(
        np.array([[0, 0.0 if j == 0 else step, 0] for j in range(joints)]),
        np.tile([1.0, 0, 0, 0], (joints, 1)),
        np.ones((joints, 3)),
    )
    skeleton = Skeleton(
        tuple(f"joint{j}" for j in range(joints)), np.arange(joints) - 1, rest, ((joints - 1, (0, step, 0)),)
    )
    levels, angles = np.linspace(0, height, rings), np.arange(sides) * (2 * np.pi / sides)
    y, a = (g.ravel() for g in np.meshgrid(levels, angles, indexing="ij"))
    normals = np.stack([np.cos(a), np.zeros_like(a), np.sin(a)], axis=-1)
    positions = normals * (0.12 + 0.05 * np.sin(3 * y))[:, None] + np.stack([0 * y, y, 0 * y], axis=-1)
    quads = [
        (r * sides + s, r * sides + (s + 1) % sides, (r + 1) * sides + s, (r + 1) * sides + (s + 1) % sides)
        for r in range(rings - 1)
        for s in range(sides)
    ]
    triangles = [t for i, j, k, m in quads for t in ((i, k, j), (j, k, m))]
    centers = (np.arange(joints) + 0.5) * step
    strength = np.exp(-(((y[:, None] - centers) / step) ** 2))
    order = np.argsort(-strength, axis=1)[:, :influences]
    weights = np.take_along_axis(strength, order, 1)
    bind = np.tile(np.eye(4), (joints, 1, 1))
    bind[:, 1, 3] = -np.arange(joints) * step
    skin = Skin(np.arange(joints), bind, order, weights / weights.sum(axis=1, keepdims=True))
    random = np.random.default_rng(seed)
    mesh = Mesh(
        positions.astype(np.float32),
        np.array(triangles),
        normals.astype(np.float32),
        np.stack([a / (2 * np.pi), y / height], axis=-1).astype(np.float32),
        np.concatenate([0.3 + 0.6 * random.random((len(y), 3)), np.ones((len(y), 1))], axis=1).astype(np.float32),
    )
    bump = np.where((y > 1.0)[:, None], normals * 0.1, 0)
    morphs = MorphSet.from_dense(("bump",), bump[None].astype(np.float32))
    part = Part("tube", mesh, material or Material("tube", (0.9, 0.6, 0.5, 1), double_sided=True), skin, morphs=morphs)
    return Character(skeleton, (part,), "arm", ("bump",))


def wave(character: Character, frames: int = 12, rate_hz: float = 12.0, travel: float = 0.0) -> Motion:
    """Every joint bends to and fro; the root goes ``travel`` metres along X."""
    joints = character.skeleton.joint_count
    phase = np.arange(frames) / max(frames - 1, 1) * 2 * np.pi
    half = 0.12 * np.sin(phase[:, None] + 0.4 * np.arange(joints))
    rotations = np.stack([np.cos(half), 0.3 * np.sin(half), np.zeros_like(half), np.sin(half)], axis=-1)
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    translations = np.tile(character.skeleton.rest.translations, (frames, 1, 1))
    translations[:, 0, 0] += np.linspace(0, travel, frames)
    pose = Pose(translations, rotations, np.ones((joints, 3)))
    weights = (0.5 + 0.5 * np.sin(phase))[:, None]
    return Motion(character.skeleton.names, pose, rate_hz, "wave", morph_names=("bump",), morph_weights=weights)


@pytest.fixture(scope="session")
def arm_scene() -> Scene:
    character = arm()
    return Scene((character,), (wave(character),))


@pytest.fixture
def small() -> RenderSettings:
    return RenderSettings(width=160, height=120, supersample=1)
