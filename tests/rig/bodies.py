"""Rigs, moved controls and comparisons that the tests of rigs share."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from keypose import evaluate, samples
from keypose.math import quat
from keypose.model import Character, Pose, Property, Rig, Skeleton
from keypose.rig import auto_rig


@cache
def human() -> Character:
    """The built-in human, in float64 so that laws can be told from rounding."""
    character = samples.load("human").character
    return Character(double(character.skeleton), character.parts, "Robin", character.morph_names, roles=character.roles)


@cache
def human_rig() -> Rig:
    return auto_rig(human().skeleton, character=human())


def double(skeleton: Skeleton) -> Skeleton:
    rest = skeleton.rest
    turned = quat.normalize(np.asarray(rest.rotations, np.float64))
    full = Pose(np.asarray(rest.translations, np.float64), turned, np.asarray(rest.scales, np.float64))
    return Skeleton(skeleton.names, skeleton.parents, full, skeleton.end_offsets)


def moved(rig: Rig, moves: Mapping[str, tuple[Any, Any]]) -> Pose:
    """Controls at rest but for some: metres that they are moved and a rotation vector that they are turned by."""
    t, r = np.array(rig.controls.rest.translations), np.array(rig.controls.rest.rotations)
    for name, (step, turn) in moves.items():
        n = rig.controls.index(name)
        t[n] = t[n] + np.asarray(step, float)
        r[n] = quat.multiply(r[n], quat.from_rotation_vector(np.asarray(turn, float)))
    return Pose(t, r, rig.controls.rest.scales)


def random_controls(rig: Rig, rng: np.random.Generator, batch: tuple[int, ...] = (), size: float = 0.05) -> Pose:
    """Controls moved and turned at random, as far as they may be."""
    rest = rig.controls.rest
    count = rig.controls.joint_count
    places, turned = (
        np.array([[float(p in look.moves)] for look in rig.looks]) for p in (Property.TRANSLATION, Property.ROTATION)
    )
    turns = quat.from_rotation_vector(2 * size * turned * rng.normal(size=(*batch, count, 3)))
    return Pose(
        rest.translations + size * places * rng.normal(size=(*batch, count, 3)),
        quat.multiply(np.broadcast_to(rest.rotations, (*batch, count, 4)), turns),
        rest.scales,
    )


def free_joints(rig: Rig, skeleton: Skeleton) -> list[int]:
    return [j for j, name in enumerate(skeleton.names) if name not in rig.joints]


def places(skeleton: Skeleton, pose: Pose) -> np.ndarray:
    return np.asarray(evaluate.world_rotations_positions(skeleton, pose.broadcast())[1], np.float64)


def turns(skeleton: Skeleton, pose: Pose) -> np.ndarray:
    return np.asarray(evaluate.world_rotations_positions(skeleton, pose.broadcast())[0], np.float64)


def apart(skeleton: Skeleton, a: Pose, b: Pose) -> float:
    """The greatest distance in metres, or angle in radians, of any joint in two poses."""
    distance = np.abs(places(skeleton, a) - places(skeleton, b)).max()
    angle = np.asarray(quat.angle_between(turns(skeleton, a), turns(skeleton, b))).max()
    return float(max(distance, angle))
