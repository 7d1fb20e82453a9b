"""What a full-body solver is asked for: tasks as values, each with a weight.

A task's residual is in metres; an angle counts as many metres as its weight says (metres per radian), so that weights of
all tasks compare. Targets may have any batch shape that broadcasts with the pose's.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TypeAlias

import numpy as np

from keypose.arrays import Array, as_float, checked, frozen
from keypose.errors import ShapeError
from keypose.ik.limits import Vector
from keypose.model import Pose

Joint: TypeAlias = str | int
_ORIGIN: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class PositionTask:
    """A point of a joint is to be at a place.

    Shapes and units: ``target`` (*B, 3) metres in the model's space; ``offset`` (3,) the point in the joint's space;
    ``weight`` (*B) or a number.
    """

    joint: Joint
    target: Array
    weight: Array | float = 1.0
    offset: Vector = _ORIGIN

    def __post_init__(self) -> None:
        _freeze(self, target=(..., 3), weight=(...,), offset=(3,))


@dataclass(frozen=True, slots=True, eq=False)
class OrientationTask:
    """A joint is to be turned like this in the model's space.

    Shapes and units: ``target`` (*B, 4) quaternions wxyz; ``weight`` (*B) metres per radian.
    """

    joint: Joint
    target: Array
    weight: Array | float = 1.0

    def __post_init__(self) -> None:
        _freeze(self, target=(..., 4), weight=(...,))


@dataclass(frozen=True, slots=True, eq=False)
class LookAtTask:
    """An axis of a joint is to point at a place.

    Shapes and units: ``target`` (*B, 3) metres; ``axis`` (3,) direction and ``offset`` (3,) its foot, both in the joint's
    space; ``weight`` (*B) metres per radian (of the chord between the directions).
    """

    joint: Joint
    target: Array
    axis: Vector = (0.0, 0.0, 1.0)
    weight: Array | float = 1.0
    offset: Vector = _ORIGIN

    def __post_init__(self) -> None:
        _freeze(self, target=(..., 3), weight=(...,), offset=(3,), axis=(3,))
        if float(np.linalg.norm(self.axis)) < 1e-9:
            raise ShapeError(f"axis: expected a direction, got {tuple(self.axis)}")


@dataclass(frozen=True, slots=True, eq=False)
class RelativeTask:
    """A joint is to be at a place in another joint's space, turned in it as said, or both.

    Shapes and units: ``position`` (*B, 3) metres along the other joint's axes (scales are not applied), of the point
    ``offset`` (3,) of ``joint``; ``rotation`` (*B, 4); ``weight`` (*B), ``rotation_weight`` (*B) metres per radian.
    """

    joint: Joint
    other: Joint
    position: Array | None = None
    rotation: Array | None = None
    weight: Array | float = 1.0
    rotation_weight: Array | float = 1.0
    offset: Vector = _ORIGIN

    def __post_init__(self) -> None:
        if self.position is None and self.rotation is None:
            raise ShapeError("relative task: expected a position, a rotation or both")
        shapes: dict[str, tuple[object, ...]] = {"weight": (...,), "rotation_weight": (...,), "offset": (3,)}
        if self.position is not None:
            shapes["position"] = (..., 3)
        if self.rotation is not None:
            shapes["rotation"] = (..., 4)
        _freeze(self, **shapes)


@dataclass(frozen=True, slots=True, eq=False)
class CenterOfMassTask:
    """The centre of mass is to be at a place.

    Shapes and units: ``target`` (*B, 3) metres; ``masses`` (J,) of what hangs on each joint, in any unit, and ``centers``
    (J, 3) where in the joint's space (`keypose.analysis.human_masses` has both); ``axes`` (3,) how much each axis counts:
    ``(1, 0, 1)`` holds it above a point of the ground; ``weight`` (*B).
    """

    target: Array
    masses: Array
    centers: Array | None = None
    axes: Vector = (1.0, 1.0, 1.0)
    weight: Array | float = 1.0

    def __post_init__(self) -> None:
        shapes: dict[str, tuple[object, ...]] = {"target": (..., 3), "masses": ("J",), "weight": (...,), "axes": (3,)}
        if self.centers is not None:
            shapes["centers"] = (len(np.asarray(self.masses)), 3)
        _freeze(self, **shapes)
        if np.any(np.asarray(self.masses) < 0) or not float(np.sum(self.masses)) > 0:
            raise ShapeError("masses: expected numbers of at least 0 that do not all vanish")


@dataclass(frozen=True, slots=True, eq=False)
class ContactTask:
    """A point of a joint is to stay on a plane, or on its upper side.

    Shapes and units: ``point`` (*B, 3) metres and ``normal`` (*B, 3) direction say where the plane is; ``offset`` (3,) the
    point in the joint's space; ``on``: hold it on the plane, not only above; ``weight`` (*B).
    """

    joint: Joint
    point: Array = _ORIGIN
    normal: Array = (0.0, 1.0, 0.0)
    on: bool = False
    weight: Array | float = 1.0
    offset: Vector = _ORIGIN

    def __post_init__(self) -> None:
        _freeze(self, point=(..., 3), normal=(..., 3), weight=(...,), offset=(3,))
        if np.any(np.linalg.norm(self.normal, axis=-1) < 1e-9):
            raise ShapeError("normal: expected directions, got one without length")


@dataclass(frozen=True, slots=True, eq=False)
class PosePrior:
    """Joints are to stay near a pose: the one that the solver starts from, or another.

    Shapes and units: ``weight`` a number or (J,), metres per radian; ``root_weight`` for the path of the root, 1 = metres.
    """

    pose: Pose | None = None
    weight: Array | float = 0.01
    root_weight: float = 0.0

    def __post_init__(self) -> None:
        _freeze(self, weight=(...,))


@dataclass(frozen=True, slots=True, eq=False)
class Smoothness:
    """Joints are to stay near the pose of the frame before; frames are the first axis of the batch and solved in order.

    Who has all frames smooths them better together: to `solve_window` it says that speeds are to stay even, and nothing lags.

    Shapes and units: ``weight`` a number or (J,), metres per radian; ``root_weight`` for the path of the root, 1 = metres.
    """

    weight: Array | float = 0.05
    root_weight: float = 0.0

    def __post_init__(self) -> None:
        _freeze(self, weight=(...,))


BodyTask: TypeAlias = PositionTask | OrientationTask | LookAtTask | ContactTask
Task: TypeAlias = BodyTask | RelativeTask | CenterOfMassTask | PosePrior | Smoothness


def _freeze(task: object, **shapes: tuple[object, ...]) -> None:
    for field in fields(task):  # pyright: ignore[reportArgumentType]
        if field.name not in shapes:
            continue
        value = as_float(getattr(task, field.name))
        what = f"{type(task).__name__}.{field.name}"
        array = np.asarray(value)
        if field.name != "weight" and field.name != "rotation_weight":
            checked(array, shapes[field.name], what)
        elif np.any(array < 0):
            raise ShapeError(f"{what}: expected numbers of at least 0, got {float(array.min())}")
        if not np.all(np.isfinite(array)):
            raise ShapeError(f"{what}: expected finite numbers")
        if shapes[field.name][-1] == 4 and np.any(np.linalg.norm(array, axis=-1) < 1e-9):
            raise ShapeError(f"{what}: expected quaternions, got one without length")
        object.__setattr__(task, field.name, frozen(array, np.float64))
