"""A rubber ball, and its first exercise: bouncing, from keys and the operators that an animator would use.

The joint ``Ball`` is at the ball's centre and carries it; ``Squash``, at its lowest point, is scaled (and turned, so that the
ball is stretched along its path); ``Level`` turns back; ``Spin``, at the centre again, rolls.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from keypose.editing.operators import run_operator
from keypose.editing.selection import Selection
from keypose.math import quat
from keypose.model import (
    Channel,
    Character,
    Clip,
    Curve,
    CurveKind,
    Interpolation,
    Material,
    Mesh,
    Part,
    Pose,
    Property,
    Skeleton,
)

RADIUS_M = 0.25
NAMES = ("Ball", "Squash", "Level", "Spin")

_CORAL = Material("coral", (0.805, 0.099, 0.056, 1.0), roughness=0.42)
_CREAM = Material("cream", (0.913, 0.815, 0.604, 1.0), roughness=0.42)

# Meridians and parallels; wedges of the two colours meet along meridians.
_AROUND, _ACROSS, _WEDGES = 96, 64, 8
_SWIRL = 0.55  # radians by which a wedge turns from the middle to a pole
_CAP = 4  # parallels of the caps


@cache
def ball() -> Character:
    """The ball: 0.25 m in radius, on the ground, of eight wedges in two colours that swirl about the Z axis."""
    rest = Pose(
        np.array([[0, RADIUS_M, 0], [0, -RADIUS_M, 0], [0, 0, 0], [0, RADIUS_M, 0]], np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (4, 1)),
        np.ones((4, 3), np.float32),
    )
    skeleton = Skeleton(NAMES, np.arange(-1, 3, dtype=np.int32), rest)
    return Character(skeleton, _parts(), name="Ball")


def _parts() -> tuple[Part, ...]:
    polar = np.linspace(0, np.pi, _ACROSS + 1)
    turn = np.linspace(0, 2 * np.pi, _AROUND + 1)
    p, a = np.meshgrid(polar, turn, indexing="ij")
    a = a + _SWIRL * np.cos(p)
    normals = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(_ACROSS), np.arange(_AROUND), indexing="ij")
    here = i * (_AROUND + 1) + j
    below = here + _AROUND + 1
    faces = np.stack([np.stack([here, below, below + 1], -1), np.stack([here, below + 1, here + 1], -1)], axis=2)
    solid = np.ones(faces.shape[:3], bool)
    solid[0, :, 1] = solid[-1, :, 0] = False  # at the poles one of the two triangles has no area
    wedge = (j * _WEDGES // _AROUND) % 2
    cap = (i < _CAP) | (i >= _ACROSS - _CAP)
    coral = (wedge == 0) & ~cap
    parts: list[Part] = []
    for material, where in ((_CORAL, coral), (_CREAM, ~coral)):
        triangles = faces[where][solid[where]]
        used, index = np.unique(triangles, return_inverse=True)
        mesh = Mesh(
            (RADIUS_M * normals[used]).astype(np.float32), index.reshape(-1, 3), normals[used].astype(np.float32)
        )
        parts.append(Part(f"ball {material.name}", mesh, material, joint=NAMES.index("Spin")))
    return tuple(parts)


# Seconds on frames of 25 in a second: how long it touches the ground, and how long it flies after that.
_FALL_S = 0.52
_TOUCHES_S = (0.08, 0.08, 0.04, 0.04)
_FLIGHTS_S = (0.88, 0.64, 0.44, 0.28)
_ROLL_S = 1.2
_SPEED = 0.9
_GRAVITY = 9.81
_START_X = -1.6


@cache
def bounce() -> Clip:
    """The ball falls, bounces four times and rolls out: parabolas between keys, eased roll, squash and stretch."""
    path, spin = _keys()
    clip = Clip(
        {Channel("Ball", Property.TRANSLATION): path, Channel("Spin", Property.ROTATION): spin}, "bounce", rate_hz=25.0
    )
    skeleton = ball().skeleton
    last = {c: (curve.key_count - 2, curve.key_count - 1) for c, curve in clip.curves.items()}
    # The roll slows down evenly; both curves go by the same easing, so that nothing slips.
    clip = run_operator("ease", clip, skeleton, Selection(keys=last), {"easing": "quad_out", "tolerance": 1e-4}).clip
    moving = Selection(channels=(Channel("Ball", Property.TRANSLATION),))
    return run_operator("squash_and_stretch", clip, skeleton, moving, {"joint": "Ball", "contact_s": 0.06}).clip


def _keys() -> tuple[Curve, Curve]:
    """Path and rotation: a key at each highest point, each landing and each take-off, and at the end of the roll."""
    times, heights, arriving, leaving = [0.0], [RADIUS_M + 0.5 * _GRAVITY * _FALL_S**2], [0.0], [0.0]

    def key(after_s: float, height: float, speed_in: float, speed_out: float) -> None:
        times.append(round(times[-1] + after_s, 6))
        heights.append(height)
        arriving.append(speed_in)
        leaving.append(speed_out)

    key(_FALL_S, RADIUS_M, -_GRAVITY * _FALL_S, 0.0)
    for touch, flight in zip(_TOUCHES_S, _FLIGHTS_S, strict=True):
        speed = 0.5 * _GRAVITY * flight
        key(touch, RADIUS_M, 0.0, speed)
        key(0.5 * flight, RADIUS_M + 0.125 * _GRAVITY * flight**2, 0.0, 0.0)
        key(0.5 * flight, RADIUS_M, -speed, 0.0)
    along = _START_X + _SPEED * np.array(times)
    # What slows down evenly covers half of what it would have at its first speed.
    key(_ROLL_S, RADIUS_M, 0.0, 0.0)
    along = np.append(along, along[-1] + 0.5 * _SPEED * _ROLL_S)
    count = len(times)
    positions = np.stack([along, heights, np.zeros(count)], axis=-1)
    forward = np.full(count, _SPEED)
    path = Curve(
        times,
        positions,
        Interpolation.HERMITE,
        np.stack([forward, arriving, np.zeros(count)], axis=-1),
        np.stack([forward, leaving, np.zeros(count)], axis=-1),
    )
    rolled = quat.from_axis_angle([0.0, 0.0, -1.0], (along - along[0]) / RADIUS_M)
    return path, Curve(times, quat.align_signs(rolled), Interpolation.LINEAR, kind=CurveKind.ROTATION)
