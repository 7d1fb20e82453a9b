# pyright: basic
"""Inverse kinematics and retargeting: limbs of crowds, whole bodies beside mink on the same problem, characters per second."""

from __future__ import annotations

from typing import Any

import numpy as np

from keypose.bench import bodies
from keypose.bench.suite import Suite
from keypose.ik import rotation_between_frames, solve_limb, solve_limbs
from keypose.kernels.limbs import IN_ROWS, OUT_ROWS, turn_lanes
from keypose.kernels.runtime import WIDTH, aligned
from keypose.math import quat

_LIMBS = 4096
# Frames a second that a published retargeting library with foot contacts reports; the better end.
_PUBLISHED, _PUBLISHED_NAME = 70.0, "published, 35 to 70"


def add(suite: Suite) -> None:
    """All rows of the suite."""
    rng = np.random.default_rng(2)
    _limbs(suite, rng)
    bodies.add(suite, rng)
    _retargeting(suite)


def _limbs(suite: Suite, rng: np.random.Generator) -> None:
    """Arms of a crowd that reach for something; the same arms as the study's."""
    start = np.zeros((_LIMBS, 3), np.float32)
    middle = (np.array([[0], [-0.4], [0.05]]) + rng.normal(0, 0.02, (3, _LIMBS))).T.astype(np.float32)
    end = middle + np.array([0, -0.4, -0.05], np.float32)
    target = (np.array([[0.1], [-0.6], [0.2]]) + rng.normal(0, 0.05, (3, _LIMBS))).T.astype(np.float32)
    pole = np.tile(np.array([0, 0, 1], np.float32), (_LIMBS, 1))
    points = (start, middle, end, target, pole)
    rows = np.concatenate([*(p.T for p in points), np.ones((1, _LIMBS), np.float32)])
    limbs = aligned(rows.size).reshape(-1, IN_ROWS, WIDTH)
    limbs[:] = rows.reshape(IN_ROWS, -1, WIDTH).transpose(1, 0, 2)
    out = aligned(_LIMBS * OUT_ROWS).reshape(-1, OUT_ROWS, WIDTH)
    turns = turn_lanes(limbs, out=out).transpose(0, 2, 1).reshape(-1, OUT_ROWS).astype(np.float64)
    first, second = turns[:, :4], quat.multiply(turns[:, :4], turns[:, 4:8])
    reached = quat.rotate(first, middle - start) + quat.rotate(second, end - middle)
    reach = np.linalg.norm(middle - start, axis=1) + np.linalg.norm(end - middle, axis=1)
    short = np.maximum(np.linalg.norm(target - start, axis=1) - reach, 0)
    missed = np.abs(np.linalg.norm(reached - (target - start), axis=1) - short).max()
    suite.check("two-bone IK: miss of the target (m)", missed, 2e-6)
    lengths = np.linalg.norm(middle - start, axis=1), np.linalg.norm(end - middle, axis=1)

    def slow(softness: Any = 0.0, most: float = 1.0) -> Any:
        normal = np.cross(middle - start, end - middle)
        places = solve_limb(
            start, target, pole, upper_m=lengths[0], lower_m=lengths[1], softness_m=softness, max_stretch=most
        )
        return (
            rotation_between_frames(middle - start, -normal, places.middle - start, places.normal),
            rotation_between_frames(end - middle, -normal, places.end - places.middle, places.normal),
        )

    suite.check("two-bone IK: turns of the upper bone", _turned_apart(first, slow()[0])[short == 0].max(), 1e-3)
    suite.case(
        "two-bone IK", "ns/limb", _LIMBS, lambda: turn_lanes(limbs, out=out), slow,
        note=f"targets in reach to {1e6 * missed:.1g} um",
    )  # fmt: skip
    suite.case(
        "two-bone IK, soft, with stretch", "ns/limb", _LIMBS, lambda: turn_lanes(limbs, 0.05, 1.2, out),
        lambda: slow(0.05 * (lengths[0] + lengths[1]), 1.2),
    )  # fmt: skip
    suite.case("two-bone IK, arrays of points", "ns/limb", _LIMBS, lambda: solve_limbs(*points), slow)


def _turned_apart(a: Any, b: Any) -> Any:
    return np.asarray(quat.angle_between(a, b.astype(np.float64)))


def _retargeting(suite: Suite) -> None:
    """The built-in walk on a body of other proportions, feet planted."""
    from dataclasses import replace

    from keypose import samples
    from keypose.retarget import retarget

    walk, body = samples.load("walk"), samples.load("human").character.skeleton
    offsets = np.asarray(body.rest.translations) * 1.15
    legs = [n for n, name in enumerate(body.names) if name.endswith(("Leg", "Foot"))]
    offsets[legs] *= 1.1
    other = replace(body, rest=replace(body.rest, translations=offsets))
    skeleton = walk.character.skeleton
    motion: Any = walk.animations[0]
    slide = retarget(motion, skeleton, other).report.slide_cm_s
    suite.check("retargeting: feet in contact slide (cm/s)", slide, 1.0)
    suite.case(
        f"retargeting, {body.joint_count} joints, with contacts", "frames/s", motion.frame_count,
        lambda: retarget(motion, skeleton, other), published=_PUBLISHED, against=_PUBLISHED_NAME,
        note=f"{motion.frame_count} frames, feet slide {slide:.2f} cm/s",
    )  # fmt: skip
