"""A full-body problem with everything looked up: arrays over N poses, tasks as terms, limits with their homes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from keypose.arrays import Array, Floats, Ints
from keypose.errors import ShapeError, UnknownName
from keypose.ik.limits import EulerRange, Hinge, JointLimit
from keypose.ik.tasks import (
    CenterOfMassTask,
    ContactTask,
    Joint,
    LookAtTask,
    OrientationTask,
    PosePrior,
    PositionTask,
    RelativeTask,
    Smoothness,
    Task,
)
from keypose.math import quat
from keypose.model import Pose, Skeleton

LEAST_DAMPING = 1e-6  # square metres, for tasks of weight 1
POLICIES = ("free", "fixed", "translation", "ground")
RootPolicy = Literal["free", "fixed", "translation", "ground"]


_NOTHING: Floats = np.zeros(0)


@dataclass(frozen=True, slots=True)
class RootMotion:
    """What the root may do: ``policy`` and which joint it is (the root above the first task's joint if not said).

    ``free``: moves and turns; ``fixed``: neither; ``translation``: moves, does not turn; ``ground``: moves level and turns
    about the vertical.
    """

    policy: RootPolicy = "free"
    joint: Joint | None = None

    def __post_init__(self) -> None:
        if self.policy not in POLICIES:
            raise UnknownName("root policy", self.policy, POLICIES)


def _nothing() -> Floats:
    return _NOTHING


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """A task over N poses. ``target`` etc. (N, ...); offsets are in the joint's axes, scaled; ``weight`` (N,)."""

    task: Task
    kind: type[Task]
    joint: int = -1
    other: int = -1
    weight: Floats = field(default_factory=_nothing)
    target: Floats = field(default_factory=_nothing)
    turn: Floats | None = None
    turn_weight: Floats = field(default_factory=_nothing)
    offset: Floats = field(default_factory=_nothing)
    axis: Floats = field(default_factory=_nothing)
    masses: Floats = field(default_factory=_nothing)
    by_joint: Floats = field(default_factory=_nothing)
    root_weight: float = 0.0
    positioned: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Limited:
    """The limit of a joint and (N, 4) the rotation that it counts from."""

    joint: int
    limit: JointLimit
    home: Floats
    follows: bool = False  # from where the joint starts, not from its rest


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """N poses to solve at once.

    ``offsets`` (N, J, 3): a joint from its parent along the parent's axes, scaled; ``start`` (N, J, 4) rotations;
    ``free`` (J,) joints that turn; ``upright`` the joint that turns about the vertical alone, or -1; ``mover`` the joint
    that moves, or -1, along ``ways`` (3,) 1 or 0; ``above`` (J, J) whether the first joint is the second or stands above it.
    """

    skeleton: Skeleton
    offsets: Floats
    start: Floats
    free: Ints
    upright: int
    mover: int
    ways: Floats
    above: Ints
    terms: tuple[Term, ...]
    limited: tuple[Limited, ...]
    least_damping: float = 1e-6

    @property
    def parents(self) -> Ints:
        """(J,)."""
        return self.skeleton.parents

    def take(self, rows: Ints) -> Problem:
        """The problem of some of the poses."""

        def some(array: Floats) -> Floats:
            return array if array is _NOTHING else array[rows]

        terms = tuple(
            replace(
                t,
                weight=some(t.weight),
                target=some(t.target),
                turn=None if t.turn is None else t.turn[rows],
                turn_weight=some(t.turn_weight),
                offset=some(t.offset),
            )
            for t in self.terms
        )
        limited = tuple(replace(one, home=one.home[rows]) for one in self.limited)
        return replace(self, offsets=self.offsets[rows], start=self.start[rows], terms=terms, limited=limited)


def batch_of(pose: Pose, tasks: Sequence[Task]) -> tuple[int, ...]:
    """The batch shape of a pose and all targets together; raises `ShapeError` where they do not broadcast."""
    shapes: list[tuple[int, ...]] = [pose.batch_shape]
    for n, task in enumerate(tasks):
        for name, width in _BATCHED.get(type(task), ()):
            value = getattr(task, name)
            if value is None:
                continue
            shapes.append(np.shape(value)[: np.ndim(value) - width])
            try:
                np.broadcast_shapes(*shapes)
            except ValueError:
                what = f"tasks[{n}] {type(task).__name__}.{name}"
                expected = np.broadcast_shapes(*shapes[:-1])
                raise ShapeError(f"{what}: batch {shapes[-1]} does not broadcast with {expected}") from None
    return np.broadcast_shapes(*shapes)


_BATCHED: dict[type, tuple[tuple[str, int], ...]] = {
    PositionTask: (("target", 1), ("weight", 0)),
    OrientationTask: (("target", 1), ("weight", 0)),
    LookAtTask: (("target", 1), ("weight", 0)),
    RelativeTask: (("position", 1), ("rotation", 1), ("weight", 0), ("rotation_weight", 0)),
    CenterOfMassTask: (("target", 1), ("weight", 0)),
    ContactTask: (("point", 1), ("normal", 1), ("weight", 0)),
}


def make_problem(
    skeleton: Skeleton,
    pose: Pose,
    tasks: Sequence[Task],
    batch: tuple[int, ...],
    limits: Mapping[str, JointLimit],
    fixed: Sequence[Joint],
    locked: Mapping[str, str],
    root: RootMotion,
) -> Problem:
    """Look everything up and check it; raises `ShapeError` and `UnknownName`."""
    count, joints = math.prod(batch), skeleton.joint_count
    if pose.joint_count != joints:
        raise ShapeError(f"pose: expected the skeleton's {joints} joints, got {pose.joint_count}")
    above = _above(skeleton)
    used = _joints_used(skeleton, tasks)
    translations, start, scales = (
        np.broadcast_to(np.asarray(a, np.float64), (*batch, *a.shape[-2:])).reshape(count, *a.shape[-2:])
        for a in (pose.translations, pose.rotations, pose.scales)
    )
    for name, array in (("translations", translations), ("rotations", start), ("scales", scales)):
        if not np.isfinite(array.sum()):
            raise ShapeError(f"pose.{name}: expected finite numbers")
    start = quat.normalize(start)
    scale = _scales(skeleton, scales, above, used)
    parents = skeleton.parents
    over = np.where(parents[None, :, None] >= 0, scale[:, np.maximum(parents, 0), None], 1.0)
    offsets = np.ascontiguousarray(translations * over)

    mover = _moving_joint(skeleton, root, used)
    free = np.ones(joints, np.int64)
    for joint in fixed:
        free[skeleton.index(joint)] = 0
    if mover >= 0:
        free[above[:, mover] & (np.arange(joints) != mover)] = 0
    upright = -1
    if mover >= 0 and root.policy in ("fixed", "translation"):
        free[mover] = 0
    elif mover >= 0 and root.policy == "ground" and free[mover]:
        upright = mover
    ways = np.array([1.0, 1.0, 1.0])
    if root.policy == "fixed":
        mover, ways = -1, np.zeros(3)
    elif root.policy == "ground":
        ways = np.array([1.0, 0.0, 1.0])

    limited = _limited(skeleton, start, limits, locked, free, upright)
    terms = tuple(_term(skeleton, task, batch, scale, start) for task in tasks)
    if mover >= 0:
        terms = tuple(_with_root_path(term, skeleton, mover, batch, translations, start, over) for term in terms)
    least = least_damping(tasks)
    return Problem(skeleton, offsets, start, free, upright, mover, ways, above, terms, limited, least)


def least_damping(tasks: Sequence[Task]) -> float:
    """What no damping falls below: rounding grows with the square of the weights over it."""
    weights = [np.asarray(t.weight) for t in tasks if not isinstance(t, (PosePrior, Smoothness))]
    most = max((float(w.max()) for w in weights if w.size), default=1.0)
    return LEAST_DAMPING * max(most, 1e-6) ** 2


def fields_of(task: Task) -> list[tuple[str, Floats, int]]:
    """Name, array and number of axes that are no batch, of what may differ from pose to pose, in the order of the tables."""
    named = [(name, getattr(task, name), width) for name, width in _BATCHED.get(type(task), ())]
    return [(name, np.asarray(value), width) for name, value, width in named if value is not None]


def target_of(task: Task) -> str:
    """The name of the part of a task that says where to; empty for priors."""
    if isinstance(task, RelativeTask):
        return "rotation" if task.position is None else "position"
    if isinstance(task, ContactTask):
        return "point"
    return "" if isinstance(task, (PosePrior, Smoothness)) else "target"


def with_target(task: Task, target: Floats) -> Task:
    """The task with another target."""
    return replace(task, **{target_of(task): target})


def _above(skeleton: Skeleton) -> Ints:
    above = np.eye(skeleton.joint_count, dtype=bool)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            above[:, joint] |= above[:, parent]
    return above


def _joints_used(skeleton: Skeleton, tasks: Sequence[Task]) -> list[int]:
    used: list[int] = []
    for task in tasks:
        if isinstance(task, CenterOfMassTask):
            if len(task.masses) != skeleton.joint_count:
                raise ShapeError(f"masses: expected ({skeleton.joint_count},) numbers, got {np.shape(task.masses)}")
            used += [int(j) for j in np.flatnonzero(task.masses)]
        elif isinstance(task, RelativeTask):
            used += [skeleton.index(task.joint), skeleton.index(task.other)]
        elif not isinstance(task, (PosePrior, Smoothness)):
            used.append(skeleton.index(task.joint))
    return used


def _scales(skeleton: Skeleton, scales: Floats, above: Ints, used: Sequence[int]) -> Floats:
    """The scale (N, J) of each joint's own space; only scales that turn with everything below make sense here."""
    if np.all(scales == 1.0):
        return np.ones(scales.shape[:2])
    inner = np.zeros(skeleton.joint_count, bool)
    for joint in used:
        inner |= above[:, joint]
    mean = scales.mean(axis=-1)
    uneven = (np.abs(scales - mean[..., None]) > 1e-4 * np.abs(mean[..., None])).any(axis=(0, 2)) & inner
    if uneven.any():
        joint = int(np.flatnonzero(uneven)[0])
        raise ShapeError(
            f"pose.scales: joint '{skeleton.names[joint]}' is scaled by {tuple(np.round(scales[0, joint], 4))}; "
            "expected one scale for all three axes above a task's joint"
        )
    whole = np.empty(mean.shape)
    for joint, parent in enumerate(skeleton.parents):
        whole[:, joint] = mean[:, joint] * (whole[:, parent] if parent >= 0 else 1.0)
    return whole


def _moving_joint(skeleton: Skeleton, root: RootMotion, used: Sequence[int]) -> int:
    if root.joint is not None:
        return skeleton.index(root.joint)
    if not skeleton.joint_count:
        return -1
    joint = used[0] if used else 0
    while skeleton.parents[joint] >= 0:
        joint = int(skeleton.parents[joint])
    return joint


def _limited(
    skeleton: Skeleton,
    start: Floats,
    limits: Mapping[str, JointLimit],
    locked: Mapping[str, str],
    free: Ints,
    upright: int,
) -> tuple[Limited, ...]:
    found: list[Limited] = []
    rest = np.asarray(skeleton.rest.rotations, np.float64)
    for name, limit in limits.items():
        joint = skeleton.index(name)
        if name in locked:
            raise ShapeError(f"joint '{name}': expected a limit or locked axes, got both")
        if free[joint] and joint != upright:
            found.append(Limited(joint, limit, np.broadcast_to(rest[joint], (len(start), 4))))
    for name, letters in locked.items():
        joint = skeleton.index(name)
        axes = "".join(sorted(set(letters.lower())))
        if not axes or axes.strip("xyz"):
            raise ShapeError(f"locked axes of '{name}': expected some of x, y and z, got '{letters}'")
        if joint == upright:
            raise ShapeError(f"joint '{name}': expected no locked axes of a root that turns about the vertical alone")
        left = [axis for axis in "xyz" if axis not in axes]
        if not left:
            free[joint] = 0
        elif free[joint]:
            found.append(Limited(joint, _lock(left, axes), start[:, joint], True))
    return tuple(found)


def _lock(left: Sequence[str], axes: str) -> JointLimit:
    """The limit of a joint that still turns about the axes that are left."""
    if len(left) == 1:
        x, y, z = (1.0 if axis == left[0] else 0.0 for axis in "xyz")
        return Hinge((x, y, z), -np.pi, np.pi)
    return EulerRange((left[0] + left[1] + axes).upper(), (-np.pi, -np.pi, 0.0), (np.pi, np.pi, 0.0))


def _with_root_path(
    term: Term,
    skeleton: Skeleton,
    mover: int,
    batch: tuple[int, ...],
    translations: Floats,
    start: Floats,
    over: Floats,
) -> Term:
    """Where a prior wants the root: a displacement (N, 3) in the model's space from where it starts."""
    if term.kind is not PosePrior and term.kind is not Smoothness:
        return term
    away = np.zeros((len(start), 3))
    pose = term.task.pose if isinstance(term.task, PosePrior) else None
    if pose is not None:
        wanted = np.asarray(pose.translations, np.float64)[..., mover, :]
        away = np.broadcast_to(wanted, (*batch, 3)).reshape(-1, 3) - translations[:, mover]
        away = quat.rotate(rotation_above(skeleton, start, mover), away * over[:, mover])
    return replace(term, offset=away)


def rotation_above(skeleton: Skeleton, rotations: Floats, joint: int) -> Floats:
    """The model-space rotations (N, 4) of a joint's parent."""
    above = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (len(rotations), 4))
    joint = int(skeleton.parents[joint])
    while joint >= 0:
        above = quat.multiply(rotations[:, joint], above)
        joint = int(skeleton.parents[joint])
    return above


def _term(skeleton: Skeleton, task: Task, batch: tuple[int, ...], scale: Floats, start: Floats) -> Term:
    def flat(value: Array, width: int = 0) -> Floats:
        array = np.asarray(value, np.float64)
        tail = array.shape[array.ndim - width :]
        return np.ascontiguousarray(np.broadcast_to(array, (*batch, *tail))).reshape(len(start), *tail)

    def by_joint(weight: Array) -> Floats:
        array = np.asarray(weight, np.float64)
        if array.ndim > 1 or (array.ndim == 1 and len(array) != skeleton.joint_count):
            raise ShapeError(f"weight: expected a number or ({skeleton.joint_count},), got {array.shape}")
        return np.broadcast_to(array, (skeleton.joint_count,))

    match task:
        case PosePrior(pose=pose):
            turns = start
            if pose is not None:
                if pose.joint_count != skeleton.joint_count:
                    raise ShapeError(f"prior: expected {skeleton.joint_count} joints, got {pose.joint_count}")
                turns = quat.normalize(flat(pose.rotations, 2))
            return Term(task, PosePrior, target=turns, by_joint=by_joint(task.weight), root_weight=task.root_weight)
        case Smoothness():
            return Term(task, Smoothness, target=start, by_joint=by_joint(task.weight), root_weight=task.root_weight)
        case CenterOfMassTask():
            centers = np.zeros((skeleton.joint_count, 3)) if task.centers is None else np.asarray(task.centers)
            offset = scale[..., None] * centers
            return Term(
                task, CenterOfMassTask, weight=flat(task.weight), target=flat(task.target, 1), offset=offset,
                masses=np.asarray(task.masses) / float(np.sum(task.masses)), axis=np.asarray(task.axes),
            )  # fmt: skip
        case RelativeTask():
            joint, other = skeleton.index(task.joint), skeleton.index(task.other)
            placed = np.zeros(3) if task.position is None else task.position
            turn = None if task.rotation is None else quat.normalize(flat(task.rotation, 1))
            return Term(
                task, RelativeTask, joint, other, flat(task.weight), flat(placed, 1), turn,
                flat(task.rotation_weight), scale[:, joint, None] * np.asarray(task.offset),
                positioned=task.position is not None,
            )  # fmt: skip
        case OrientationTask():
            target = quat.normalize(flat(task.target, 1))
            return Term(task, OrientationTask, skeleton.index(task.joint), weight=flat(task.weight), target=target)
        case PositionTask() | LookAtTask() | ContactTask():
            joint = skeleton.index(task.joint)
            term = Term(
                task,
                type(task),
                joint,
                weight=flat(task.weight),
                offset=scale[:, joint, None] * np.asarray(task.offset),
            )
            if isinstance(task, ContactTask):
                normal = np.asarray(task.normal)
                normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
                return replace(term, target=flat(task.point, 1), turn=flat(normal, 1))
            if isinstance(task, LookAtTask):
                axis = np.asarray(task.axis) / float(np.linalg.norm(task.axis))
                return replace(term, target=flat(task.target, 1), axis=axis)
            return replace(term, target=flat(task.target, 1))
