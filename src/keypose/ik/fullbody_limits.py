"""Limits as the full-body solver meets them: at which bounds a joint stands, and which way each of them is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from keypose.arrays import Array, Floats, Ints
from keypose.ik.limits import Cone, EulerRange, Hinge, JointLimit, swing_axes
from keypose.math import euler, quat

AT_BOUND_RAD = 1e-7
_WHOLE_TURN = 2.0 * np.pi - 1e-12

FREE, HIGH, LOW, HELD = 0, 1, -1, 2


@dataclass(frozen=True, slots=True)
class Bounds:
    """The bounds of N joints: what limits them are three numbers each, of which some are at an end of their ranges.

    Shapes and units: ``directions`` (N, 3, 3) in the parent's space, along which a small turn raises what is bounded;
    ``sides`` (N, 3) which end it is at: `HIGH`, `LOW`, `HELD` (it must not change at all) or `FREE`; ``up``, ``down`` (N, 3)
    radians to turn along the direction, and against it, to either end, as far as the slope here tells.
    """

    directions: Floats
    sides: Ints
    up: Floats
    down: Floats

    def room_to(self, sides: Ints) -> Floats:
        """Radians (N, 3) from here to the ends that ``sides`` (N, 3) name; 0 where none is named."""
        return np.where(sides == LOW, self.down, np.where(sides == FREE, 0.0, self.up))


def find_bounds(limit: JointLimit, rotation: Floats, home: Floats) -> Bounds:
    """The bounds of a joint at local ``rotation`` and with the rotation ``home`` that its limit counts from, both (N, 4).

    Source: the gradients of the twist angle and of the swing vector of a quaternion, by the chain rule.
    """
    turn = quat.multiply(quat.conjugate(home), rotation)
    match limit:
        case Hinge():
            return _of_hinge(limit, turn, home)
        case EulerRange():
            return _of_angles(limit, turn, home)
        case Cone():
            return _of_cone(limit, turn, home)


def _around(value: Floats, low: float, high: float) -> Floats:
    """An angle from the middle of its range, on the circle."""
    return (value - 0.5 * (low + high) + np.pi) % (2.0 * np.pi) - np.pi


def _side(value: Floats, low: float, high: float) -> Ints:
    """Which end of its range an angle stands at, on the circle."""
    if high - low >= _WHOLE_TURN:
        return np.zeros(value.shape, np.int8)
    if high - low < 2.0 * AT_BOUND_RAD:
        return np.full(value.shape, HELD, np.int8)
    around, half = _around(value, low, high), 0.5 * (high - low)
    found = np.where(around > half - AT_BOUND_RAD, HIGH, FREE)
    return np.where(around < AT_BOUND_RAD - half, LOW, found).astype(np.int8)


def _of_hinge(limit: Hinge, turn: Floats, home: Floats) -> Bounds:
    axis = np.asarray(limit.axis, np.float64) / float(np.linalg.norm(limit.axis))
    angle = 2.0 * np.arctan2(turn[:, 1:] @ axis, turn[:, 0])
    basis = np.stack([axis, *_across(axis)])
    sides = np.full((len(turn), 3), HELD, np.int8)
    sides[:, 0] = _side(angle, limit.low_rad, limit.high_rad)
    around, half = _around(angle, limit.low_rad, limit.high_rad), 0.5 * (limit.high_rad - limit.low_rad)
    up, down = np.zeros((len(turn), 3)), np.zeros((len(turn), 3))
    up[:, 0], down[:, 0] = half - around, half + around
    return Bounds(_turned(home, np.broadcast_to(basis, (len(turn), 3, 3))), sides, up, down)


def _of_angles(limit: EulerRange, turn: Floats, home: Floats) -> Bounds:
    angles = allowed_angles(limit, turn)
    order, columns = limit.order, list(range(3))
    if order.islower():  # fixed axes are moving ones in the other order
        order, columns = order.upper()[::-1], columns[::-1]
    axes = [np.eye(3)["XYZ".index(letter)] for letter in order]
    rates, before = [], np.broadcast_to([1.0, 0.0, 0.0, 0.0], turn.shape)
    for axis, column in zip(axes, columns, strict=True):
        along = np.broadcast_to(axis, (len(turn), 3))
        rates.append(quat.rotate(before, along))
        before = quat.multiply(before, quat.from_axis_angle(along, angles[:, column]))
    volume = np.sum(np.cross(rates[0], rates[1]) * rates[2], axis=-1)
    directions, sides = np.empty((len(turn), 3, 3)), np.empty((len(turn), 3), np.int8)
    up, down = np.empty((len(turn), 3)), np.empty((len(turn), 3))
    for n, column in enumerate(columns):
        # The angle's own direction is across the axes of the other two; at gimbal lock there is none.
        directions[:, n] = np.cross(rates[(n + 1) % 3], rates[(n + 2) % 3]) * np.sign(volume)[:, None]
        low, high = limit.low_rad[column], limit.high_rad[column]
        sides[:, n] = _side(angles[:, column], low, high)
        around, slow = _around(angles[:, column], low, high), np.abs(volume)
        slow = slow / np.maximum(
            np.linalg.norm(directions[:, n], axis=-1), 1e-300
        )  # radians of turn for one of the angle
        up[:, n], down[:, n] = slow * (0.5 * (high - low) - around), slow * (0.5 * (high - low) + around)
    sides[np.linalg.norm(directions, axis=-1) < 1e-6] = FREE
    return Bounds(_turned(home, directions), sides, up, down)


def allowed_angles(limit: EulerRange, turn: Floats) -> Floats:
    """Of the two triples of Euler angles of rotations (N, 4), the one that is less outside the limit."""
    low, high = np.asarray(limit.low_rad), np.asarray(limit.high_rad)
    first = np.asarray(euler.from_quat(turn, limit.order))
    proper = limit.order[0] == limit.order[2]
    middle = -first[:, 1] if proper else np.pi - first[:, 1]
    second = np.stack([first[:, 0] + np.pi, middle, first[:, 2] + np.pi], axis=-1)
    middles = 0.5 * (low + high)
    over = []
    for triple in (first, second):
        around = (triple - middles + np.pi) % (2.0 * np.pi) - np.pi
        over.append(np.maximum(np.abs(around) - 0.5 * (high - low), 0.0).sum(axis=1))
    return np.where((over[1] < over[0] - 1e-9)[:, None], second, first)


def _of_cone(limit: Cone, turn: Floats, home: Floats) -> Bounds:
    axis = np.asarray(limit.axis, np.float64) / float(np.linalg.norm(limit.axis))
    center = np.broadcast_to(np.asarray(limit.center, np.float64), turn.shape)
    turn = quat.multiply(quat.conjugate(center), turn)
    frame = quat.multiply(home, center)
    w, v = turn[:, :1], turn[:, 1:]
    along = v @ axis
    directions = np.zeros((len(turn), 3, 3))
    sides = np.zeros((len(turn), 3), np.int8)
    # Twist: 2 atan2(v.a, w); its gradient in the joint's own axes, turned into those of the cone.
    size = np.maximum(w[:, 0] ** 2 + along**2, 1e-300)[:, None]
    rate = (w * w * axis + w * np.cross(axis, v) + along[:, None] * v) / size
    directions[:, 0] = quat.rotate(turn, rate)
    twist, slow = 2.0 * np.arctan2(along, w[:, 0]), 1.0 / np.linalg.norm(rate, axis=-1)
    sides[:, 0] = _side(twist, limit.twist_low_rad, limit.twist_high_rad)
    around, half = _around(twist, limit.twist_low_rad, limit.twist_high_rad), limit.twist_high_rad - limit.twist_low_rad
    up, down = np.zeros((len(turn), 3)), np.zeros((len(turn), 3))
    up[:, 0], down[:, 0] = slow * (0.5 * half - around), slow * (0.5 * half + around)
    # Swing: the ellipse is a function of where the axis points.
    u, other = swing_axes(limit)
    a, b = limit.swings
    pointed = quat.rotate(turn, np.broadcast_to(axis, v.shape))
    x, y, z = pointed @ u, pointed @ other, pointed @ axis
    sine = np.hypot(x, y)
    angle = np.arctan2(sine, z)
    cos, sin = x / np.maximum(sine, 1e-12), y / np.maximum(sine, 1e-12)
    shape = sin * sin / a**2 + cos * cos / b**2  # swing about u moves the axis along the other
    about = -sin[:, None] * u + cos[:, None] * other
    slope = 2.0 * angle * shape
    turning = angle**2 * 2.0 * sin * cos * (1.0 / a**2 - 1.0 / b**2) / np.maximum(sine, 1e-12)
    gradient = slope[:, None] * about + turning[:, None] * np.cross(pointed, about)
    length = np.linalg.norm(gradient, axis=-1)
    directions[:, 1] = gradient / np.maximum(length, 1e-12)[:, None]
    up[:, 1] = (1.0 - angle**2 * shape) / np.maximum(length, 1e-12)
    if max(a, b) < np.pi:
        reach = angle * np.sqrt(shape)
        sides[:, 1] = np.where((reach > 1.0 - AT_BOUND_RAD) & (length > 1e-9), HIGH, FREE)
    return Bounds(_turned(frame, directions), sides, up, down)


def pulls_of(limit: JointLimit, directions: Floats, sides: Ints, pull: Floats) -> tuple[Array, Floats]:
    """Which bounds are in the way of a joint (N, 3), and how hard it is pulled over each (N, 3).

    Shapes and units: ``directions``, ``sides`` of `Bounds`, the first in the space of the pull; ``pull`` (N, 3) the negative gradient of the cost. Where a
    joint stands at both bounds of a cone, they push back as much as keeps it from crossing either, and never pull.
    """
    length = np.maximum(np.linalg.norm(directions, axis=-1), 1e-300)
    force = np.einsum("nki,ni->nk", directions, pull) / length * np.where(sides == LOW, -1.0, 1.0)
    blocked = (sides == HELD) | ((sides != FREE) & (force > 0.0))
    if not isinstance(limit, Cone):
        return blocked, force * blocked
    both = (sides[:, 0] != FREE) & (sides[:, 1] != FREE)
    held = sides[:, 0] == HELD
    way = np.sum(directions[:, 0] * directions[:, 1], axis=-1) / (length[:, 0] * length[:, 1])
    way = way * np.where(sides[:, 0] == LOW, -1.0, 1.0)
    first, second = force[:, 0], force[:, 1]
    rest = second - way * first
    pair = both & (rest > 0.0) & (held | (first > way * second))
    twist = both & ~pair & (held | ((first > 0.0) & (rest <= 0.0)))
    swing = both & ~pair & ~twist
    blocked[:, 0] = np.where(both, pair | twist, blocked[:, 0])
    blocked[:, 1] = np.where(both, pair | (swing & (second > 0.0)), blocked[:, 1])
    force[:, 1] = np.where(pair, rest / np.maximum(1.0 - way * way, 1e-6), second)
    return blocked, force * blocked


def edge_of_cone(limit: Cone, turn: Floats) -> Floats:
    """How curved the edge of a cone is on the sphere where a joint is turned (N, 4) from its middle, per radian (N,).

    The second derivative along the edge of what is bounded, over its slope across, in the angles of spherical coordinates.
    """
    axis = np.asarray(limit.axis, np.float64) / float(np.linalg.norm(limit.axis))
    u, other = swing_axes(limit)
    pointed = quat.rotate(turn, np.broadcast_to(axis, (len(turn), 3)))
    first, second, cosine = pointed @ u, pointed @ other, pointed @ axis
    sine = np.maximum(np.hypot(first, second), 1e-12)
    angle, cos, sin = np.arctan2(sine, cosine), first / sine, second / sine
    ra, rb = 1.0 / limit.swings[0] ** 2, 1.0 / limit.swings[1] ** 2
    shape, slope = sin * sin * ra + cos * cos * rb, 2.0 * sin * cos * (ra - rb)
    by_angle, by_way = 2.0 * angle * shape, angle**2 * slope / sine
    steep = np.maximum(np.hypot(by_angle, by_way), 1e-300)
    along, around = -by_way / steep, by_angle / (steep * sine)
    bent = 2.0 * shape * along**2 + 4.0 * angle * slope * along * around
    bent += 2.0 * angle**2 * (cos**2 - sin**2) * (ra - rb) * around**2
    bent += by_angle * sine * cosine * around**2 - 2.0 * by_way * cosine * along * around
    return np.where(sine > 1e-6, bent / steep, 0.0)


def _turned(frame: Floats, directions: Floats) -> Floats:
    return quat.rotate(np.broadcast_to(frame[:, None], (*directions.shape[:-1], 4)), directions)


def _across(axis: Floats) -> tuple[Floats, Floats]:
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)
