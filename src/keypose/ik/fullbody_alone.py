"""A prepared solver's way of one pose: targets in a row, one call of machine code, a result that is made as it is read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from keypose.arrays import Floats
from keypose.ik.fullbody_plan import Plan, Targets
from keypose.ik.fullbody_result import IkResult, SolveOptions, result_with
from keypose.ik.tasks import Task
from keypose.kernels import fullbodytables as columns
from keypose.model import Pose

_FLOAT64 = np.dtype(np.float64)
_set = object.__setattr__
_SHIFT = 3  # numbers of the root's displacement, before the state


@dataclass(frozen=True, slots=True, eq=False)
class SolverOfOne:
    """What one pose is solved with; nothing in it changes, so threads may share it.

    ``run`` the machine code and the ``address`` of its tables, which are ``kept``; ``shapes`` of the targets, task by task,
    and ``own``, those that the tasks came with; ``whole`` their shape in one array, () if they are of several kinds;
    ``rest`` translations, rotations and scales.
    """

    plan: Plan
    run: Callable[..., bool]
    address: int
    kept: tuple[Any, ...]
    known: frozenset[Task]
    shapes: list[tuple[int, ...]]
    own: tuple[Floats, ...]
    packed: Floats
    whole: tuple[int, ...]
    rest: tuple[Floats, Floats, Floats]

    def solve(self, pose: Pose | None, targets: Targets | None) -> IkResult | None:
        """The result; None for what is more than one pose, is scaled or makes no sense: that is told elsewhere."""
        packed = self.packed if targets is None else self._packed(targets)
        if packed is None:
            return None
        if pose is None:
            pose = self.plan.problem.skeleton.rest
            bones, turns, scales = self.rest
        else:
            bones = np.ascontiguousarray(pose.translations, np.float64)
            turns = np.ascontiguousarray(pose.rotations, np.float64)
            scales = np.ascontiguousarray(pose.scales, np.float64)
            if turns.shape != self.rest[1].shape or bones.ndim != 2 or scales.ndim != 2:
                return None
        moved, turned = np.empty(bones.shape), np.empty(turns.shape)
        left = np.empty(_SHIFT + columns.STATES + len(self.plan.tables.terms))
        if not self.run(packed, bones, turns, scales, moved, turned, left, self.address):
            return None
        return result_with(_pose(pose, moved, turned), partial(self._part, left))

    def _packed(self, targets: Targets) -> Floats | None:
        """All targets one after another; None if they do not fit."""
        if type(targets) is np.ndarray and targets.dtype is _FLOAT64 and targets.shape == self.whole:
            return targets.ravel()
        if type(targets) is dict or isinstance(targets, Mapping):
            if not targets.keys() <= self.known:
                return None
            targets = [targets.get(task) for task in self.plan.tasks]
        elif len(targets) != len(self.own):
            return None
        try:
            shapes = [target.shape for target in targets]
        except AttributeError:  # a list of numbers, or None where a task keeps its own
            targets = [
                own if t is None else np.asarray(t, np.float64) for t, own in zip(targets, self.own, strict=True)
            ]
            shapes = [target.shape for target in targets]
        if shapes != self.shapes:
            return None
        packed = np.concatenate(targets)
        return packed if packed.dtype is _FLOAT64 else packed.astype(np.float64)

    def _part(self, left: Floats, name: str) -> Any:
        """A part of the result beside the pose, of what a solve has left."""
        state = left[_SHIFT:]
        match name:
            case "residuals":
                return self.plan.residuals((), state[columns.STATES :, None])
            case "cost":
                return np.array(state[columns.COST])
            case "iterations":
                return np.array(state[columns.STEPS], np.int64)
            case "outcome":
                return np.array(0 if state[columns.MISS] <= 1.0 else 1 if state[columns.DONE] != 0.0 else 2)
            case _:
                raise AttributeError(f"'IkResult' has no '{name}'")


def make_solver_of_one(plan: Plan, options: SolveOptions) -> SolverOfOne | None:
    """The way of one pose, its machine code loaded; None where solves begin again, or tasks have a batch of their own."""
    if options.restarts or plan.varying:
        return None
    from keypose.kernels import fullbodyentry as code

    tables, problem = plan.tables, plan.problem
    joints, count, mover, ways, terms, term_count, limits, limit_count, numbers, settings = tables.arguments
    template, rest = tables.rows[0].copy(), problem.skeleton.rest
    own = tuple(np.zeros(0) if f is None else template[f.at : f.at + f.width].copy() for f in plan.targets)
    fields = np.array([(f.at, f.width) for f in plan.targets if f is not None], np.int64)
    homes = np.array(plan.from_start, np.int64)
    used = tables.joints.astype(np.int64)
    about = np.zeros(code.ABOUT, np.int64)
    for column, array in (
        (code.TEMPLATE, template), (code.JOINTS, joints), (code.TERMS, terms), (code.LIMITS, limits),
        (code.NUMBERS, numbers), (code.SETTINGS, settings), (code.USED, used), (code.HOMES, homes), (code.FIELDS, fields),
    ):  # fmt: skip
        about[column] = array.ctypes.data
    for column, number in (
        (code.COLUMNS, len(template)), (code.STEPS, options.iterations), (code.COUNT, count), (code.MOVER, mover),
        (code.WAYS, ways), (code.TERM_COUNT, term_count), (code.LIMIT_COUNT, limit_count),
        (code.HOME_COUNT, len(homes)), (code.FIELD_COUNT, len(fields)),
    ):  # fmt: skip
        about[column] = number
    kept = (about, template, joints, terms, limits, numbers, settings, used, homes, fields)
    widths = {a.size for a in own}
    bones, turns, scales = (
        np.ascontiguousarray(a, np.float64) for a in (rest.translations, rest.rotations, rest.scales)
    )
    return SolverOfOne(
        plan, code.entry(), about.ctypes.data, kept, frozenset(plan.tasks),
        [a.shape for a in own], own, np.concatenate(own), (len(own), *widths) if len(widths) == 1 else (),
        (bones, turns, scales),
    )  # fmt: skip


def _pose(begun: Pose, moved: Floats, turned: Floats) -> Pose:
    """A pose of arrays known to fit, without a look at them: that would take longer than the solve."""
    if np.asarray(begun.rotations).dtype != _FLOAT64:
        moved, turned = moved.astype(np.float32), turned.astype(np.float32)
    moved.flags.writeable = turned.flags.writeable = False
    pose = object.__new__(Pose)
    _set(pose, "translations", moved)
    _set(pose, "rotations", turned)
    _set(pose, "scales", begun.scales)
    return pose
