"""How far joints turn: hinges, ranges of Euler angles, cones of swing and twist.

All limits speak of the turn out of the joint's rest rotation, in the joint's own axes: q = rest * turn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Array, Floats, as_float, checked
from keypose.errors import ShapeError, UnknownName
from keypose.math import euler, quat
from keypose.model import Motion, Pose, Skeleton

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Hinge:
    """A turn about one axis, from ``low_rad`` to ``high_rad``: a knee, an elbow."""

    axis: Vector
    low_rad: float
    high_rad: float

    def __post_init__(self) -> None:
        _check_axis(self.axis)
        _check_range(self.low_rad, self.high_rad, "low_rad, high_rad")


@dataclass(frozen=True, slots=True)
class EulerRange:
    """Three angles in an order of `keypose.math.euler`, each with its range: what Acclaim files say."""

    order: str
    low_rad: Vector
    high_rad: Vector

    def __post_init__(self) -> None:
        if self.order not in euler.CONVENTIONS:
            raise UnknownName("Euler order", self.order, euler.CONVENTIONS)
        if (len(self.low_rad), len(self.high_rad)) != (3, 3):
            raise ShapeError(f"low_rad, high_rad: expected three angles each, got {self.low_rad} and {self.high_rad}")
        for low, high in zip(self.low_rad, self.high_rad, strict=True):
            _check_range(low, high, "low_rad, high_rad")


@dataclass(frozen=True, slots=True)
class Cone:
    """Swing of ``axis`` inside an ellipse, and twist about it: a shoulder, a hip.

    ``swing_rad``: how far it swings about the two axes across ``axis``; one number for a round cone. The first of them is
    ``across``, made perpendicular to ``axis``; without it both are those of the joint that are least along ``axis``, in the
    order x, y, z. ``center``: where the middle of the cone is, a quaternion (w, x, y, z) from the joint at rest; a shoulder
    at rest is nowhere near the middle of what it can do.
    """

    axis: Vector
    swing_rad: float | tuple[float, float]
    twist_low_rad: float = -np.pi
    twist_high_rad: float = np.pi
    center: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    across: Vector | None = None

    def __post_init__(self) -> None:
        _check_axis(self.axis)
        if not abs(float(np.linalg.norm(self.center)) - 1.0) <= 1e-6:
            raise ShapeError(f"center: expected a unit quaternion, got {self.center}")
        if self.across is not None and not float(np.linalg.norm(np.cross(self.axis, self.across))) >= 1e-9:
            raise ShapeError(f"across: expected a direction across the axis {self.axis}, got {self.across}")
        _check_range(self.twist_low_rad, self.twist_high_rad, "twist_low_rad, twist_high_rad")
        if not all(0 < swing <= np.pi for swing in self.swings):
            raise ShapeError(f"swing_rad: expected more than 0 and at most pi, got {self.swing_rad}")

    @property
    def swings(self) -> tuple[float, float]:
        """Both radii of the ellipse."""
        return (self.swing_rad, self.swing_rad) if isinstance(self.swing_rad, (int, float)) else self.swing_rad


JointLimit = Hinge | EulerRange | Cone


def clamp_rotation(limit: JointLimit, rotation: Array, rest: Array = (1.0, 0.0, 0.0, 0.0)) -> Floats:
    """The allowed rotation that lies next to a joint's local rotation (*B, 4), as the limit measures.

    What is allowed already is returned unchanged to rounding. Source: swing and twist after Dobrowolski (2015); the ellipse is
    left along its radius, which is continuous everywhere but opposite to the axis.
    """
    q = checked(np.asarray(as_float(rotation), np.float64), (..., 4), "rotation")
    home = np.broadcast_to(np.asarray(rest, np.float64), q.shape)
    turn = quat.multiply(quat.conjugate(home), q)
    match limit:
        case Hinge(axis=axis, low_rad=low, high_rad=high):
            along = _unit(axis)
            angle = _clamped(_twist_angle(turn, along), low, high)
            allowed = quat.from_axis_angle(np.broadcast_to(along, (*angle.shape, 3)), angle)
        case EulerRange(order=order, low_rad=low, high_rad=high):
            allowed = euler.to_quat(_nearest_angles(turn, order, np.array(low), np.array(high)), order)
        case Cone(axis=axis, center=center):
            middle = np.broadcast_to(np.asarray(center, np.float64), turn.shape)
            allowed = _in_cone(limit, quat.multiply(quat.conjugate(middle), turn), _unit(axis))
            allowed = quat.multiply(middle, allowed)
    return quat.multiply(home, allowed)


def limit_violation(limit: JointLimit, rotation: Array, rest: Array = (1.0, 0.0, 0.0, 0.0)) -> Floats:
    """How far a local rotation (*B, 4) is from what is allowed, radians (*B,)."""
    q = np.asarray(as_float(rotation), np.float64)
    return quat.angle_between(q, clamp_rotation(limit, q, rest))


def clamp_pose(pose: Pose, skeleton: Skeleton, limits: Mapping[str, JointLimit]) -> Pose:
    """A pose of any batch shape with every limited joint inside its limit; raises `UnknownName` for a joint that is not there."""
    rotations = np.array(np.asarray(pose.rotations), copy=True)
    for name, limit in limits.items():
        joint = skeleton.index(name)
        inside = clamp_rotation(limit, rotations[..., joint, :], skeleton.rest.rotations[joint])
        rotations[..., joint, :] = inside
    return Pose(pose.translations, rotations, pose.scales)


@dataclass(frozen=True, slots=True)
class LimitBreak:
    """A joint that goes beyond its limit in a motion: worst by how much and when, and in what share of the frames."""

    joint: str
    worst_rad: float
    frame: int
    share: float


def find_limit_breaks(
    motion: Motion, skeleton: Skeleton, limits: Mapping[str, JointLimit], tolerance_rad: float = 1e-3
) -> tuple[LimitBreak, ...]:
    """The joints of a motion that break their limits, worst first; raises `UnknownName` for a joint that is not there."""
    found: list[LimitBreak] = []
    rotations = motion.pose.broadcast().rotations
    for name, limit in limits.items():
        joint = skeleton.index(name)
        over = limit_violation(limit, rotations[:, joint], skeleton.rest.rotations[joint])
        if len(over) and float(over.max()) > tolerance_rad:
            frame = int(np.argmax(over))
            found.append(LimitBreak(name, float(over[frame]), frame, float((over > tolerance_rad).mean())))
    return tuple(sorted(found, key=lambda b: -b.worst_rad))


def _check_axis(axis: Vector) -> None:
    length = float(np.linalg.norm(axis))
    if np.shape(axis) != (3,) or not (np.isfinite(length) and length >= 1e-9):
        raise ShapeError(f"axis: expected a direction (x, y, z), got {axis}")


def _check_range(low: float, high: float, names: str) -> None:
    if not (np.isfinite(low) and np.isfinite(high) and low <= high):
        raise ShapeError(f"{names}: expected a range from low to high, got {low} to {high}")


def _unit(axis: Vector) -> Floats:
    return np.asarray(axis, np.float64) / float(np.linalg.norm(axis))


def _twist_angle(turn: Floats, axis: Floats) -> Floats:
    """The turn about the axis in (-pi, pi]."""
    angle = 2.0 * np.arctan2(np.sum(turn[..., 1:] * axis, axis=-1), turn[..., 0])
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def _clamped(angle: Floats, low: float, high: float) -> Floats:
    """The allowed angle next to one on the circle; a range of a whole turn allows everything."""
    if high - low >= 2.0 * np.pi - 1e-12:
        return angle
    middle = 0.5 * (low + high)
    around = (angle - middle + np.pi) % (2.0 * np.pi) - np.pi
    return middle + np.clip(around, low - middle, high - middle)


def _nearest_angles(turn: Floats, order: str, low: Floats, high: Floats) -> Floats:
    """Of the two triples of one rotation, the one that is less outside, clamped."""
    first = np.asarray(euler.from_quat(turn, order))
    proper = order[0] == order[2]
    second = np.stack(
        [first[..., 0] + np.pi, -first[..., 1] if proper else np.pi - first[..., 1], first[..., 2] + np.pi], axis=-1
    )
    triples = [np.stack([_clamped(t[..., n], low[n], high[n]) for n in range(3)], axis=-1) for t in (first, second)]
    off = [quat.angle_between(turn, euler.to_quat(t, order)) for t in triples]
    return np.where((off[1] < off[0])[..., None], triples[1], triples[0])


def _in_cone(limit: Cone, turn: Floats, axis: Floats) -> Floats:
    along = np.broadcast_to(axis, (*turn.shape[:-1], 3))
    swing, twist = quat.swing_twist(turn, along)
    angle = _clamped(_twist_angle(twist, axis), limit.twist_low_rad, limit.twist_high_rad)
    across = np.stack(swing_axes(limit))
    vector = np.asarray(quat.to_rotation_vector(quat.shortest(swing)))
    parts = vector @ across.T  # (*B, 2)
    reach = np.linalg.norm(parts / np.array(limit.swings), axis=-1, keepdims=True)
    inside = np.where(reach > 1.0, parts / np.maximum(reach, 1e-300), parts)
    return quat.multiply(quat.from_rotation_vector(inside @ across), quat.from_axis_angle(along, angle))


def swing_axes(limit: Cone) -> tuple[Floats, Floats]:
    """The two unit axes about which a cone swings, across its axis and each other."""
    axis = _unit(limit.axis)
    order = np.argsort(np.abs(axis), kind="stable")[:2]
    first = np.eye(3)[int(order.min())] if limit.across is None else np.asarray(limit.across, np.float64)
    first = first - axis * float(first @ axis)
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)
