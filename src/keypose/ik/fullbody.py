"""Full-body inverse kinematics: one pose, or millions, that does what weighted tasks ask as well as its limits allow."""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from keypose.arrays import Floats, as_float, checked
from keypose.errors import ShapeError
from keypose.evaluate.compiled import kernels_for
from keypose.ik.fullbody_alone import SolverOfOne, make_solver_of_one
from keypose.ik.fullbody_dense import State
from keypose.ik.fullbody_plan import Plan, Targets, is_plain, make_plan
from keypose.ik.fullbody_problem import (
    Problem,
    RootMotion,
    RootPolicy,
    batch_of,
    make_problem,
    rotation_above,
    target_of,
    with_target,
)
from keypose.ik.fullbody_result import IkResult, SolveOptions
from keypose.ik.fullbody_run import TYPICAL_STEPS, restart, result_of, solve_in_order, solve_problem
from keypose.ik.fullbody_tables import run_rows
from keypose.ik.limits import JointLimit
from keypose.ik.tasks import Joint, OrientationTask, PosePrior, Smoothness, Task
from keypose.kernels import fullbodytables as columns
from keypose.math import quat
from keypose.model import Pose, Skeleton

_BLOCK = 512  # rows that stay in the processor's cache


def solve_pose(
    skeleton: Skeleton,
    pose: Pose,
    tasks: Sequence[Task],
    *,
    limits: Mapping[str, JointLimit] | None = None,
    fixed: Sequence[Joint] = (),
    locked: Mapping[str, str] | None = None,
    root: RootPolicy | RootMotion = "free",
    options: SolveOptions | None = None,
) -> IkResult:
    """Turn all joints, and move the root, so that weighted tasks are met as well as limits allow.

    Shapes and units: ``pose`` (*B) is where solves start, and says bone lengths and scales; targets (*B, ...) broadcast with
    it, so one call solves all frames of all characters. ``limits`` joint name -> limit, held in the result to rounding;
    ``fixed`` joints do not turn; ``locked`` joint name -> axes (``"x"``, ``"yz"``) of the joint, about which it does not turn
    from where it starts; ``root`` what the root may do. A target out of reach, or tasks against each other, are no error: the
    result says what is left, and the cost falls with every step. With `Smoothness`, the first axis of the batch is time.

    Large batches, and all once it is loaded, go through a compiled solver whose step is linear in joints and tasks; limits of
    proper Euler angles are solved by NumPy, with the same result. Who solves the same tasks again and again prepares them
    once: `prepare_solver`.

    Raises:
        UnknownName: for a joint, policy or axis that does not exist.
        ShapeError: where shapes, numbers or scales make no sense.

    Source: damped least squares after K. Levenberg (1944) and D. Marquardt (1963), damping after T. Sugihara, "Solvability-
        unconcerned inverse kinematics by the Levenberg-Marquardt method" (2011) and H. Nielsen (1999); bounds after D.
        Bertsekas, "Projected Newton methods" (1982).
    """
    return _prepare(skeleton, tasks, limits, fixed, locked, root, options).solve(pose)


def prepare_solver(
    skeleton: Skeleton,
    tasks: Sequence[Task],
    *,
    limits: Mapping[str, JointLimit] | None = None,
    fixed: Sequence[Joint] = (),
    locked: Mapping[str, str] | None = None,
    root: RootPolicy | RootMotion = "free",
    options: SolveOptions | None = None,
) -> PoseSolver:
    """Look up and check everything of `solve_pose` but pose and targets, and load its compiled half.

    Shapes and units: as of `solve_pose`; targets of ``tasks`` stand until others are given.

    Raises:
        UnknownName: for a joint, policy or axis that does not exist.
        ShapeError: where shapes or numbers make no sense.
    """
    solver = _prepare(skeleton, tasks, limits, fixed, locked, root, options)
    if solver.plan is None:
        return solver
    kernels = importlib.import_module("keypose.kernels.fullbody")
    return replace(solver, kernels=kernels, alone=make_solver_of_one(solver.plan, solver.options))


@dataclass(frozen=True, slots=True, eq=False)
class PoseSolver:
    """What `prepare_solver` makes: tasks on a skeleton, ready to be solved for any poses and targets."""

    skeleton: Skeleton
    tasks: tuple[Task, ...]
    limits: Mapping[str, JointLimit]
    fixed: tuple[Joint, ...]
    locked: Mapping[str, str]
    root: RootMotion
    options: SolveOptions
    plan: Plan | None = None
    kernels: Any = None
    alone: SolverOfOne | None = None

    def solve(self, pose: Pose | None = None, targets: Targets | None = None) -> IkResult:
        """Solve the tasks from a pose (the rest pose if not given) for their targets, or for others.

        Shapes and units: ``pose`` (*B); ``targets`` task -> array (*B, 3) metres or (*B, 4) rotations, or such arrays in the
        order of the tasks, None where a task keeps its own; of a contact the point of its plane, of a relative task its
        place, or turn if it has no place. All batches broadcast.

        Raises:
            ShapeError: where shapes, numbers or scales make no sense, or a task has no target.
        """
        found = None if self.alone is None else self.alone.solve(pose, targets)
        if found is not None:
            return found
        given = {} if targets is None else self._given(targets)
        plan, start = self.plan, self.skeleton.rest if pose is None else pose
        if plan is not None and is_plain(start, self.skeleton):
            batch = self._batch(plan, start, given)
            work = math.prod(batch) * self.skeleton.joint_count * min(self.options.iterations, TYPICAL_STEPS)
            kernels = self.kernels or kernels_for("fullbody", work, plan.problem.start)
            if kernels is not None and work:
                return self._solve_rows(plan, kernels, pose, batch, given)
        tasks = [with_target(task, given[n]) if n in given else task for n, task in enumerate(self.tasks)]
        problem, batch = self._problem(start, tasks)
        smooth = any(term.kind is Smoothness for term in problem.terms)
        if smooth and not batch:
            raise ShapeError("Smoothness: expected frames as the first axis of the batch, got a single pose")
        solved = solve_in_order(problem, batch, self.options) if smooth else solve_problem(problem, self.options)
        return result_of(problem, start, batch, solved)

    def _problem(self, pose: Pose, tasks: Sequence[Task]) -> tuple[Problem, tuple[int, ...]]:
        batch = batch_of(pose, tasks)
        problem = make_problem(self.skeleton, pose, tasks, batch, self.limits, self.fixed, self.locked, self.root)
        return problem, batch

    def _given(self, targets: Targets) -> dict[int, Floats]:
        """Targets by the numbers of their tasks, checked."""
        if isinstance(targets, Mapping):
            numbers = {id(task): n for n, task in enumerate(self.tasks)}
            for task in targets:
                if id(task) not in numbers:
                    raise ShapeError(f"targets: expected tasks of this solver, got another {type(task).__name__}")
            pairs = [(numbers[id(task)], value) for task, value in targets.items()]
        else:
            if len(targets) != len(self.tasks):
                raise ShapeError(f"targets: expected one for each of {len(self.tasks)} tasks, got {len(targets)}")
            pairs = list(enumerate(targets))
        found: dict[int, Floats] = {}
        for n, value in pairs:
            if value is None:
                continue
            task = self.tasks[n]
            if isinstance(task, (PosePrior, Smoothness)):
                raise ShapeError(f"targets[{n}]: a {type(task).__name__} has no target")
            width = 4 if target_of(task) == "rotation" or isinstance(task, OrientationTask) else 3
            array = np.asarray(value, np.float64)
            if array.ndim == 0 or array.shape[-1] != width:
                checked(as_float(array), (..., width), f"targets[{n}] of {type(task).__name__}")
            if not math.isfinite(array.sum()):
                raise ShapeError(f"targets[{n}] of {type(task).__name__}: expected finite numbers")
            if width == 4:
                if np.any(np.linalg.norm(array, axis=-1) < 1e-9):
                    raise ShapeError(f"targets[{n}] of {type(task).__name__}: expected quaternions without length 0")
                array = quat.normalize(array)
            found[n] = array
        return found

    def _batch(self, plan: Plan, pose: Pose, given: Mapping[int, Floats]) -> tuple[int, ...]:
        shapes = [pose.batch_shape]
        for field, array in plan.varying:
            if not (field == plan.targets[field.task] and field.task in given):
                shapes.append(array.shape[:-1])
        first = shapes[0]
        if all(shape == first for shape in shapes) and all(a.shape[:-1] == first for a in given.values()):
            return first
        for n, array in given.items():
            shapes.append(array.shape[:-1])
            try:
                np.broadcast_shapes(*shapes)
            except ValueError:
                what = f"targets[{n}] of {type(self.tasks[n]).__name__}"
                expected = np.broadcast_shapes(*shapes[:-1])
                raise ShapeError(f"{what}: batch {shapes[-1]} does not broadcast with {expected}") from None
        try:
            return np.broadcast_shapes(*shapes)
        except ValueError:
            return batch_of(pose, self.tasks)  # which says whose shape it is

    def _solve_rows(
        self, plan: Plan, kernels: Any, pose: Pose | None, batch: tuple[int, ...], given: Mapping[int, Floats]
    ) -> IkResult:
        """The way of poses without scales: rows filled, solved and read, block by block."""
        tables, options, count = plan.tables, self.options, math.prod(batch)
        used, joints = tables.joints, self.skeleton.joint_count
        size, entries = len(used), tables.entries
        fills: list[tuple[int, int, Floats]] = []

        def put(at: int, width: int, array: Floats, tail: tuple[int, ...]) -> None:
            if math.prod(array.shape[: array.ndim - len(tail)]) == 1:
                fills.append((at, width, array.reshape(1, width)))
            else:
                fills.append((at, width, np.broadcast_to(array, (*batch, *tail)).reshape(count, width)))

        if pose is None:
            start = plan.problem.start[0]
        else:
            start = np.asarray(pose.rotations, np.float64)
            if not math.isfinite(start.sum()) or not math.isfinite(np.sum(pose.translations)):
                raise ShapeError("pose: expected finite numbers")
            start = quat.normalize(start)
            every = size == joints
            put(0, 4 * size, start if every else start[..., used, :], (size, 4))
            bones = np.asarray(pose.translations, np.float64)
            put(4 * size, 3 * size, bones if every else bones[..., used, :], (size, 3))
            for joint, at in plan.from_start:
                put(at, 4, start[..., joint, :], (4,))
        for field, array in plan.varying:
            if not (field == plan.targets[field.task] and field.task in given):
                put(field.at, field.width, array, (field.width,))
        for n, array in given.items():
            field = plan.targets[n]
            if field is not None:
                put(field.at, field.width, array, (field.width,))

        precise = np.asarray(self.skeleton.rest.rotations if pose is None else pose.rotations).dtype
        dtype = np.result_type(precise, np.float32)
        rotations = np.empty((count, joints, 4), dtype)
        if size < joints:
            rotations.reshape(*batch, joints, 4)[:] = start
        kept = np.empty((count, entries - 7 * size + len(tables.terms)))
        rows = np.empty((min(count, _BLOCK), tables.rows.shape[1]))
        for first in range(0, count, _BLOCK):
            part = rows[: min(_BLOCK, count - first)]
            last = first + len(part)
            part[:] = tables.rows
            for at, width, array in fills:
                part[:, at : at + width] = array if len(array) == 1 else array[first:last]
            run_rows(kernels, tables, part, np.arange(len(part)), options.iterations)
            turned = part[:, : 4 * size].reshape(len(part), size, 4)
            if size < joints:
                rotations[first:last, used] = turned
            else:
                rotations[first:last] = turned
            kept[first:last] = part[:, 7 * size : entries + len(tables.terms)]
        state = kept[:, 3 : 3 + columns.STATES]
        if options.restarts and np.any(state[:, columns.MISS] > 1.0):
            return self._begin_again(pose, given, rotations, kept)
        return self._read(plan, pose, batch, start, rotations, kept)

    def _begin_again(self, pose: Pose | None, given: Mapping[int, Floats], rotations: Floats, kept: Floats) -> IkResult:
        start = self.skeleton.rest if pose is None else pose
        tasks = [with_target(task, given[n]) if n in given else task for n, task in enumerate(self.tasks)]
        problem, batch = self._problem(start, tasks)
        state = kept[:, 3:]
        damping, growth, cost, miss, done, curved, calm, steps = state[:, : columns.STATES].T.copy()
        there = State(
            rotations.astype(np.float64), kept[:, :3].copy(), damping, growth, cost, miss, done != 0.0, curved,
            calm, steps.astype(np.int64),
        )  # fmt: skip
        restart(problem, there, self.options)
        return result_of(problem, start, batch, there)

    def _read(
        self, plan: Plan, pose: Pose | None, batch: tuple[int, ...], start: Floats, rotations: Floats, kept: Floats
    ) -> IkResult:
        """The values of a result."""
        begun = self.skeleton.rest if pose is None else pose
        dtype, joints, mover = rotations.dtype, self.skeleton.joint_count, plan.problem.mover
        bones = np.asarray(begun.translations)
        if mover >= 0:
            moved = np.empty((*batch, joints, 3), dtype)
            moved[:] = bones
            shift = kept[:, :3].reshape(*batch, 3)
            if plan.problem.parents[mover] >= 0:
                flat = np.broadcast_to(start, (*batch, joints, 4)).reshape(-1, joints, 4)
                above = np.asarray(rotation_above(self.skeleton, flat, mover))
                shift = quat.rotate(quat.conjugate(above), kept[:, :3]).reshape(*batch, 3)
            moved[..., mover, :] = bones[..., mover, :] + shift
            bones = moved
        else:
            bones = bones.astype(dtype)
        rotations = rotations.reshape(*batch, joints, 4) if len(batch) != 1 else rotations
        rotations = rotations if rotations.flags.owndata else rotations.copy()
        for array in (bones, rotations):
            array.setflags(write=False)
        state = kept[:, 3:].T
        miss, done = state[columns.MISS], state[columns.DONE]
        outcome = np.where(miss <= 1.0, 0, np.where(done != 0.0, 1, 2))
        residuals = plan.residuals(batch, state[columns.STATES :])
        return IkResult(
            Pose(bones, rotations, begun.scales), residuals, state[columns.COST].reshape(batch),
            state[columns.STEPS].astype(np.int64).reshape(batch), outcome.reshape(batch),
        )  # fmt: skip


def _prepare(
    skeleton: Skeleton,
    tasks: Sequence[Task],
    limits: Mapping[str, JointLimit] | None,
    fixed: Sequence[Joint],
    locked: Mapping[str, str] | None,
    root: RootPolicy | RootMotion,
    options: SolveOptions | None,
) -> PoseSolver:
    chosen = SolveOptions() if options is None else options
    motion = root if isinstance(root, RootMotion) else RootMotion(root)
    solver = PoseSolver(skeleton, tuple(tasks), limits or {}, tuple(fixed), locked or {}, motion, chosen)
    plan = make_plan(skeleton, solver.tasks, solver.limits, solver.fixed, solver.locked, motion, chosen)
    return replace(solver, plan=plan)
