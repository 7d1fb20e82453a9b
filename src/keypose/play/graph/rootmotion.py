"""Root motion: the travel of a character on the ground, as steps (x, z, yaw) of a frame that slides over the floor.

A ground pose (x, z, yaw) is the transform ``world_from_root``: stand at (x, 0, z), turned by yaw about +Y (radians,
counter-clockwise from above: positive turns +Z towards +X). Steps are ground poses seen from the one before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from keypose.arrays import Floats
from keypose.math import quat

Ground: TypeAlias = tuple[float, float, float]  # x m, z m, yaw rad

STILL: Ground = (0.0, 0.0, 0.0)


def compose(a: Ground, b: Ground) -> Ground:
    """First a, then b seen from a."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return a[0] + c * b[0] + s * b[1], a[1] - s * b[0] + c * b[1], a[2] + b[2]


def between(a: Ground, b: Ground) -> Ground:
    """The step from a to b, seen from a: ``compose(a, between(a, b))`` is b."""
    c, s = math.cos(a[2]), math.sin(a[2])
    x, z = b[0] - a[0], b[1] - a[1]
    return c * x - s * z, s * x + c * z, b[2] - a[2]


def repeated(step: Ground, count: int) -> Ground:
    """The step taken ``count`` times; negative counts go back."""
    unit = step if count >= 0 else between(step, STILL)
    result, count = STILL, abs(count)
    while count:
        if count & 1:
            result = compose(result, unit)
        unit = compose(unit, unit)
        count >>= 1
    return result


def scaled(step: Ground, share: float) -> Ground:
    """A part of a step, along the arc of constant curvature that the step is."""
    return arc(_chord_to_arc(step), share)


def arc(twist: Ground, share: float) -> Ground:
    """Where a constant velocity (forward speeds and angular speed, per unit) leads after ``share`` units."""
    x, z, yaw = (share * n for n in twist)
    sinc, cosc = _sinc(yaw), _cosc(yaw)
    return sinc * x + cosc * z, sinc * z - cosc * x, yaw


def blended(steps: list[tuple[float, Ground]]) -> Ground:
    """The weighted mean of steps; nothing where there is no weight."""
    total = sum(weight for weight, _ in steps)
    if total <= 0:
        return STILL
    x = sum(weight * step[0] for weight, step in steps) / total
    z = sum(weight * step[1] for weight, step in steps) / total
    yaw = sum(weight * step[2] for weight, step in steps) / total
    return x, z, yaw


def _sinc(a: float) -> float:
    return 1 - a * a / 6 if abs(a) < 1e-4 else math.sin(a) / a


def _cosc(a: float) -> float:
    return a / 2 if abs(a) < 1e-4 else (1 - math.cos(a)) / a


def _chord_to_arc(step: Ground) -> Ground:
    """The constant velocity that makes the step in one unit: the logarithm of SE(2)."""
    x, z, yaw = step
    sinc, cosc = _sinc(yaw), _cosc(yaw)
    squared = sinc * sinc + cosc * cosc
    if squared < 1e-12:  # whole turns on the spot have no arc; go straight
        return step
    return (sinc * x - cosc * z) / squared, (sinc * z + cosc * x) / squared, yaw


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Ground poses of a clip's frames (T, 3), the first at the origin."""

    ground: Floats
    rate_hz: float

    def ground_at(self, frame: int) -> Ground:
        """The ground pose of a frame."""
        x, z, yaw = self.ground[frame]
        return float(x), float(z), float(yaw)

    def at(self, time_s: float) -> Ground:
        """The ground pose at a time of the clip, linear between frames."""
        last = len(self.ground) - 1
        position = min(max(time_s * self.rate_hz, 0.0), float(last))
        frame = min(int(position), max(last - 1, 0))
        u = position - frame
        a, b = self.ground[frame], self.ground[min(frame + 1, last)]
        return (
            float(a[0] + u * (b[0] - a[0])),
            float(a[1] + u * (b[1] - a[1])),
            float(a[2] + u * (b[2] - a[2])),
        )

    def step(self, loops: tuple[int, int], times_s: tuple[float, float]) -> Ground:
        """From one moment to another, each a count of loops and a time inside the clip."""
        start, end = self.at(times_s[0]), self.at(times_s[1])
        if loops[0] == loops[1]:
            return between(start, end)
        cycle = self.at((len(self.ground) - 1) / self.rate_hz)
        return between(start, compose(repeated(cycle, loops[1] - loops[0]), end))


def extract(
    rotations: Floats,
    translations: Floats,
    rate_hz: float,
    method: Literal["linear", "full", "none"],
    rest_rotation: Floats,
) -> tuple[Track, Floats, Floats]:
    """Split the world motion of a root joint into its travel on the ground and what is left.

    Shapes and units: rotations (T, 4), translations (T, 3) metres, rest_rotation (4,). Returns the track, seen from its
    first frame, and the remaining rotations and translations, which stand over the origin and face +Z. Yaw is the twist
    about +Y against the rest pose. ``full`` follows the joint exactly; ``linear`` is the arc of constant speed with the
    same travel and turn, under the joint's mean place and heading, so that sway stays in the pose.
    """
    count = len(rotations)
    if method == "none" or count == 0:
        return Track(np.zeros((max(count, 1), 3)), rate_hz), rotations, translations
    turned = quat.multiply(rotations, quat.conjugate(rest_rotation))
    _, twist = quat.swing_twist(turned, np.array([0.0, 1.0, 0.0]))
    yaw = np.unwrap(2 * np.arctan2(twist[:, 2], twist[:, 0]))
    places = [(float(p[0]), float(p[2]), float(a)) for p, a in zip(translations, yaw, strict=True)]
    ground = places if method == "full" else _even(places)
    steps = np.array([between(ground[0], g) for g in ground])
    angles = np.array([g[2] for g in ground])
    inverse = quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), -angles)
    moved = translations - np.array([(g[0], 0.0, g[1]) for g in ground])
    return Track(steps, rate_hz), quat.multiply(inverse, rotations), quat.rotate(inverse, moved)


def _even(places: list[Ground]) -> list[Ground]:
    count = len(places)
    shares = [f / max(count - 1, 1) for f in range(count)]
    turn = places[-1][2] - places[0][2]
    heading = sum(p[2] - turn * u for p, u in zip(places, shares, strict=True)) / count
    start, end = (*places[0][:2], heading), (*places[-1][:2], heading + turn)
    velocity = _chord_to_arc(between(start, end))
    ground = [compose(start, arc(velocity, u)) for u in shares]
    sway = [between(g, p) for g, p in zip(ground, places, strict=True)]
    middle = (sum(s[0] for s in sway) / count, sum(s[1] for s in sway) / count, 0.0)
    return [compose(g, middle) for g in ground]
