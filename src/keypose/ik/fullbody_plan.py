"""What a prepared solver knows of its tasks: the tables of one pose, and where in its row everything goes that differs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from keypose.arrays import Array, Floats
from keypose.ik import fullbody_dense as dense
from keypose.ik.fullbody_problem import Problem, RootMotion, fields_of, least_damping, make_problem, target_of
from keypose.ik.fullbody_result import SolveOptions, TaskResidual
from keypose.ik.fullbody_tables import Tables, is_compiled, make_tables
from keypose.ik.limits import JointLimit
from keypose.ik.tasks import Joint, PosePrior, Smoothness, Task
from keypose.kernels import fullbodytables as columns
from keypose.model import Pose, Skeleton

Targets = Mapping[Task, Any] | Sequence[Any] | Floats


_IN_METRES = (
    columns.POSITION, columns.CONTACT, columns.ROOT_PRIOR, columns.RELATIVE_PLACE, columns.CENTER,
)  # fmt: skip
# A relative task has an entry for its place and one for its turn.
_OF_KIND = {columns.RELATIVE_PLACE: ("position", "weight"), columns.RELATIVE_TURN: ("rotation", "rotation_weight")}


@dataclass(frozen=True, slots=True)
class Field:
    """A part of a task in its rows: which task, its name, the first column, how many."""

    task: int
    name: str
    at: int
    width: int


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """The tables of one pose, and where in its row the parts go that differ from pose to pose.

    ``targets``: of each task, if it has one; ``varying``: parts of tasks with a batch of their own, and these;
    ``from_start``: joints whose rotation at the start is wanted at a column.
    """

    tasks: tuple[Task, ...]
    problem: Problem
    tables: Tables
    targets: tuple[Field | None, ...]
    varying: tuple[tuple[Field, Floats], ...]
    from_start: tuple[tuple[int, int], ...]

    def residuals(self, batch: tuple[int, ...], left: Floats) -> tuple[TaskResidual, ...]:
        """What is left of each task, of what is left (entries, N) of the entries of the tables."""
        metres: list[Array | None] = [None] * len(self.tasks)
        angles: list[Array | None] = [None] * len(self.tasks)
        kinds = _of_terms(self.tables, columns.T_KIND)
        for (task, _), kind, size in zip(self.tables.terms, kinds, left, strict=True):
            sizes = metres if kind in _IN_METRES else angles
            before = sizes[task]
            sizes[task] = size if before is None else np.maximum(before, size)
        for n, task in enumerate(self.tasks):
            if isinstance(task, PosePrior) and angles[n] is None:
                angles[n] = np.zeros(left.shape[1])
        return tuple(
            TaskResidual(None if a is None else a.reshape(batch), None if b is None else b.reshape(batch))
            for a, b in zip(metres, angles, strict=True)
        )


def make_plan(
    skeleton: Skeleton,
    tasks: tuple[Task, ...],
    limits: Mapping[str, JointLimit],
    fixed: Sequence[Joint],
    locked: Mapping[str, str],
    root: RootMotion,
    options: SolveOptions,
) -> Plan | None:
    """The plan of tasks that the compiled solver knows and whose rows can be filled from arrays alone."""
    for task in tasks:
        if isinstance(task, Smoothness) or (isinstance(task, PosePrior) and task.pose is not None):
            return None
    if not options.iterations or not is_plain(skeleton.rest, skeleton):
        return None
    single: list[Task] = []
    for task in tasks:
        own = {name: array for name, array, width in fields_of(task) if array.ndim > width}
        if any(array.size == 0 for array in own.values()):
            return None
        first = {
            name: array.reshape(-1, *array.shape[array.ndim - width :])[0] for name, array, width in fields_of(task)
        }
        single.append(replace(task, **first) if own else task)
    problem = make_problem(skeleton, skeleton.rest, single, (), limits, fixed, locked, root)
    problem = replace(problem, least_damping=least_damping(tasks))
    if not problem.terms or not is_compiled(problem):
        return None
    tables = make_tables(problem, options.tolerance_m, options.tolerance_rad, options.settled_rad, options.still_m)
    tables.rows[:, : 4 * len(tables.joints)] = problem.start[:, tables.joints].reshape(1, -1)
    tables.rows[:, tables.state[columns.DAMPING]] = options.damping
    tables.rows[:, tables.state[columns.GROWTH]] = dense.GROWTH
    return _with_places(tasks, problem, tables)


def _with_places(tasks: tuple[Task, ...], problem: Problem, tables: Tables) -> Plan:
    """Where in a row the targets are, and all else that differs from pose to pose."""
    targets: list[Field | None] = [None] * len(tasks)
    varying: list[tuple[Field, Floats]] = []
    follow = {one.joint for one in problem.limited if one.follows}
    from_start = [(joint, at) for joint, at in tables.homes if joint in follow]
    joints, kinds = _of_terms(tables, columns.T_JOINT), _of_terms(tables, columns.T_KIND)
    for (n, first), joint, kind in zip(tables.terms, joints, kinds, strict=True):
        task, at = tasks[n], first
        if kind == columns.PRIOR and isinstance(task, PosePrior) and task.pose is None:
            from_start.append((int(tables.joints[joint]), at))
        for name, array, width in fields_of(task):
            if name not in _OF_KIND.get(kind, (name,)):
                continue
            size = array.shape[-1] if width else 1
            field = Field(n, name, at, size)
            if name == target_of(task):
                targets[n] = field
            if array.ndim > width:
                if name == "normal" or size == 4:
                    array = array / np.linalg.norm(array, axis=-1, keepdims=True)
                varying.append((field, array if width else array[..., None]))
            at += size
    return Plan(tasks, problem, tables, tuple(targets), tuple(varying), tuple(from_start))


def _of_terms(tables: Tables, column: int) -> list[int]:
    """A column of the table of terms."""
    table, count = tables.arguments[4], tables.arguments[5]
    return table[: count * columns.TERM_COLUMNS].reshape(count, -1)[:, column].tolist()


def is_plain(pose: Pose, skeleton: Skeleton) -> bool:
    """Whether a pose is one of a skeleton, without scales."""
    return pose.joint_count == skeleton.joint_count and bool(np.all(np.asarray(pose.scales) == 1.0))
