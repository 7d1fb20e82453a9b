"""Simplifying: the stated error holds at every frame on the body, and few keys are left."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import keypose.io
from keypose.deform import deform_character
from keypose.editing.simplify import simplify
from keypose.errors import ShapeError
from keypose.evaluate import match, sample_clip, sample_morphs, to_clip, world
from keypose.model import (
    Channel,
    Character,
    Clip,
    Curve,
    CurveKind,
    Interpolation,
    Motion,
    Part,
    Pose,
    Property,
    Skeleton,
)
from tests.synthetic import random_mesh, random_skeleton, random_skin


def off_on_the_body(clip: Clip, motion: Motion, skeleton: Skeleton, shell_m: float = 0.03) -> float:
    """Written anew: the largest distance of the points 3 cm off the joints, from matrices."""
    found = world(skeleton, sample_clip(clip, skeleton, motion.times_s))
    true = world(skeleton, match(motion, skeleton).pose)
    points = np.concatenate([shell_m * np.eye(3), np.ones((3, 1))], axis=1)
    moved = np.einsum("tjab,pb->tjpa", np.asarray(found, np.float64) - np.asarray(true, np.float64), points)
    return float(np.linalg.norm(moved[..., :3], axis=-1).max())


def swing(frames: int = 240) -> tuple[Motion, Skeleton]:
    """A chain that swings about changing axes."""
    from keypose.math import quat

    skeleton = random_skeleton(np.random.default_rng(3), 6)
    times = np.arange(frames) / 60
    turns = np.stack([np.sin(times * (1 + 0.3 * j))[:, None] * np.array([0.4, 0.1 * j, 0.3]) for j in range(6)], axis=1)
    rotations = quat.multiply(skeleton.rest.rotations, quat.from_rotation_vector(turns))
    translations = np.array(np.broadcast_to(skeleton.rest.translations, (frames, 6, 3)))
    translations[:, 0, 1] += 0.1 * np.sin(3 * times)
    pose = Pose(translations, rotations, skeleton.rest.scales)
    weights = (0.5 + 0.5 * np.sin(2 * times))[:, None]
    return Motion(skeleton.names, pose, 60.0, "swing", 1.0, ("smile",), weights), skeleton


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4])
def test_the_stated_error_holds_and_fewer_keys_do_for_more_of_it(tolerance: float) -> None:
    motion, skeleton = swing()
    found = simplify(motion, skeleton, tolerance)
    assert found.holds
    off = off_on_the_body(found.clip, motion, skeleton)
    assert off <= tolerance
    assert off == pytest.approx(found.error_m, rel=1e-6)
    assert found.keys_after < {1e-2: 0.05, 1e-3: 0.08, 1e-4: 0.15}[tolerance] * found.keys_before
    weights = sample_morphs(found.clip, ["smile"], motion.times_s)
    assert np.abs(weights - motion.morph_weights).max() == pytest.approx(found.morph_error, rel=1e-6)
    assert found.morph_error <= 1e-3


def test_what_stands_still_has_one_key() -> None:
    motion, skeleton = swing(30)
    first = motion.pose[:1]
    still = motion.with_pose(
        Pose(*(np.repeat(a, 30, axis=0) for a in (first.translations, first.rotations, first.scales)))
    )
    found = simplify(still, skeleton)
    assert found.error_m < 1e-12
    assert all(c.key_count == 1 for ch, c in found.clip.curves.items() if ch.property is not Property.WEIGHT)


def test_a_clip_keeps_its_channels_and_named_values() -> None:
    motion, skeleton = swing()
    full = to_clip(motion)
    lamp = Curve([0.0, 1.0], [[0.0], [1.0]], Interpolation.LINEAR, kind=CurveKind.SCALAR)
    names = list(skeleton.names[:3])
    part = Clip(
        {c: v for c, v in full.curves.items() if c.target in names} | {Channel("lamp", Property.VALUE): lamp},
        "part",
        60.0,
    )
    found = simplify(part, skeleton)
    assert set(found.clip.curves) == set(part.curves)
    assert found.clip.curve("lamp", Property.VALUE) is lamp
    times = motion.times_s
    exact = world(skeleton, sample_clip(part, skeleton, times))[..., :3, 3]
    own = world(skeleton, sample_clip(found.clip, skeleton, times))[..., :3, 3]
    assert np.linalg.norm(own - exact, axis=-1).max() <= found.error_m + 1e-12
    assert found.error_m <= 1e-3


def test_with_a_mesh_its_vertices_hold_too() -> None:
    motion, skeleton = swing()
    rng = np.random.default_rng(4)
    mesh = random_mesh(rng, 60)
    mesh = replace(mesh, positions=mesh.positions * 2)  # some vertices far off the joints
    character = Character(skeleton, (Part("skin", mesh, skin=random_skin(rng, skeleton, 60, 3)),))
    found = simplify(Motion(motion.joint_names, motion.pose, 60.0, start_s=1.0), character, 1e-3)
    assert found.holds
    vertices = [
        deform_character(character, world(skeleton, pose))[0]
        for pose in (sample_clip(found.clip, skeleton, motion.times_s), motion.pose)
    ]
    off = np.linalg.norm(np.asarray(vertices[0]) - np.asarray(vertices[1]), axis=-1).max()
    assert off <= found.error_m + 1e-9 <= 1e-3 + 1e-9


def test_nonsense_is_refused_and_a_single_frame_is_kept() -> None:
    motion, skeleton = swing()
    with pytest.raises(ShapeError, match="tolerance_m: expected a positive number, got 0"):
        simplify(motion, skeleton, 0)
    with pytest.raises(ShapeError, match="rate_hz: expected more than 0, got -1"):
        simplify(to_clip(motion), skeleton, rate_hz=-1)
    one = simplify(motion.with_pose(motion.pose[:1]) if motion.morph_weights is None else
                   Motion(motion.joint_names, motion.pose[:1], 60.0), skeleton)  # fmt: skip
    assert one.error_m == 0
    assert one.keys_after == one.keys_before


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("name", ["01_01.amc", "01_01.bvh"])
def test_the_first_take_of_cmu_keeps_few_keys(data_dir: Path, name: str) -> None:
    scene = keypose.io.load(data_dir / "cmu_01_01" / name)
    skeleton, motion = scene.characters[0].skeleton, scene.animations[0]
    found = simplify(motion, skeleton, 1e-3)
    assert found.holds
    assert off_on_the_body(found.clip, motion, skeleton) <= 1e-3
    assert found.keys_after < 0.15 * found.keys_before
    assert_array_equal(found.clip.start_s, motion.start_s)
