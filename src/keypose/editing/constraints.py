"""What a space-time solve is asked for: places, turns and holds, as rows of a least-squares problem; and their calculus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.editing.reach import joint_of
from keypose.errors import ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.math import quat
from keypose.model import Motion, Skeleton


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A joint that should be at places.

    Shapes and units: ``joint`` a name or role; ``frames`` (N,) whole and rising; ``target`` (3,) or (N, 3) metres in the model's
    space; ``weight`` None for a hard constraint, else how much a metre missed counts beside a radian changed, squared.
    """

    joint: str
    frames: Any
    target: Any
    weight: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """A joint that should be turned so: as `Place`, with ``target`` (4,) or (N, 4) in the model's space."""

    joint: str
    frames: Any
    target: Any
    weight: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Hold:
    """A joint that should not move in frames (N,), wherever that is: a foot on the ground."""

    joint: str
    frames: Any
    weight: float | None = None


Constraint = Place | Turn | Hold


def kept_in_place(motion: Motion, skeleton: Skeleton, joints: Sequence[str], frames: Any) -> list[Constraint]:
    """Hard constraints that keep joints where they are in a motion in frames (N,), turned as they are; joints by name.

    Raises:
        UnknownName: for a joint that is not there.
    """
    at = np.asarray(frames)
    turned, places = world_rotations_positions(skeleton, motion.pose.broadcast())
    found: list[Constraint] = []
    for name, joint in zip(joints, skeleton.indices(joints), strict=True):
        found += [Place(name, at, places[at, joint]), Turn(name, at, turned[at, joint])]
    return found


class ConstraintRows:
    """The rows of one constraint: its joint, the joints above it, its frames as rows of the window, its targets."""

    def __init__(
        self, constraint: Constraint, skeleton: Skeleton, roles: Mapping[str, int], window: tuple[int, int]
    ) -> None:
        self.constraint = constraint
        self.joint = joint_of(skeleton, constraint.joint, roles)
        frames = np.asarray(constraint.frames)
        label = f"{type(constraint).__name__} of {constraint.joint}"
        if frames.ndim != 1 or not np.issubdtype(frames.dtype, np.integer) or not len(frames):
            raise ShapeError(f"{label}: expected frames (N,), whole, got {frames.dtype} {frames.shape}")
        if frames.min() < window[0] or frames.max() > window[1]:
            raise ShapeError(
                f"{label}: expected frames from {window[0]} to {window[1]}, got {frames.min()} to {frames.max()}"
            )
        if constraint.weight is not None and not constraint.weight > 0:
            raise ShapeError(f"{label}: expected a positive weight, got {constraint.weight}")
        self.rows: Ints = frames - window[0]
        self.target = np.zeros(0)
        if not isinstance(constraint, Hold):
            width = 3 if isinstance(constraint, Place) else 4
            given = np.asarray(constraint.target, np.float64)
            if given.shape not in ((width,), (len(frames), width)) or not np.all(np.isfinite(given)):
                raise ShapeError(
                    f"{label}: expected a target ({width},) or ({len(frames)}, {width}), got {given.shape}"
                )
            self.target = np.broadcast_to(given, (len(frames), width))
            if isinstance(constraint, Turn):
                self.target = quat.normalize(self.target)
        above = self.joint
        path: list[int] = []
        while above >= 0:
            path.append(above)
            above = int(skeleton.parents[above])
        # A joint's own turn does not move it.
        own = isinstance(constraint, Turn) or int(skeleton.parents[self.joint]) < 0
        self.path = frozenset(path if own else path[1:])

    def weight(self, hard: float) -> float:
        """What a metre or radian counts."""
        return hard if self.constraint.weight is None else self.constraint.weight

    def missed(self, turned: Floats, places: Floats) -> Floats:
        """Metres or radians (N, 3)."""
        match self.constraint:
            case Place():
                return places[self.rows, self.joint] - self.target
            case Hold():
                here = places[self.rows, self.joint]
                return here - here.mean(axis=0)
            case Turn():
                off = quat.multiply(quat.conjugate(self.target), turned[self.rows, self.joint])
                return np.asarray(quat.to_rotation_vector(quat.shortest(off)))


def cross_matrix(v: Floats) -> Floats:
    """The matrices (*B, 3, 3) of v x."""
    zero = np.zeros(v.shape[:-1])
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*v.shape[:-1], 3, 3)


def right_jacobian(v: Floats) -> Floats:
    """exp(v + dv) = exp(v) exp(J dv) to first order, (*B, 3, 3); Source: Chirikjian, "Stochastic Models", volume 2, 10.86."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    cross = cross_matrix(v)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    return np.eye(3) - first * cross + second * (cross @ cross)


def inverse_right_jacobian(v: Floats) -> Floats:
    """The inverses (*B, 3, 3) of `right_jacobian`, for turns below a whole one; the same source, 10.86."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    cross = cross_matrix(v)
    small = angle < 1e-3
    safe = np.where(small, 1.0, angle)
    # cot(angle / 2) written so that half a turn is no singular point
    second = np.where(
        small, 1 / 12 + angle**2 / 720, 1 / safe**2 - np.cos(0.5 * safe) / (2 * safe * np.sin(0.5 * safe))
    )
    return np.eye(3) + 0.5 * cross + second * (cross @ cross)
