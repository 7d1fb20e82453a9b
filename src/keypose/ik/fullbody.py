"""Full-body inverse kinematics: one pose, or millions, that does what weighted tasks ask as well as its limits allow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from keypose.arrays import Array, Floats, Ints
from keypose.errors import ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.evaluate.compiled import kernels_for
from keypose.ik import fullbody_dense as dense
from keypose.ik.fullbody_dense import State
from keypose.ik.fullbody_problem import (
    Problem,
    RootMotion,
    RootPolicy,
    Term,
    batch_of,
    make_problem,
    rotation_above,
)
from keypose.ik.fullbody_tables import is_compiled, solve_compiled
from keypose.ik.limits import JointLimit
from keypose.ik.tasks import Joint, Smoothness, Task
from keypose.math import quat
from keypose.model import Pose, Skeleton

OUTCOMES = ("reached", "settled", "out of steps")
_TYPICAL_STEPS = 20
_AT_ONCE = 256  # solves that NumPy holds Jacobians of at a time


@dataclass(frozen=True, slots=True)
class SolveOptions:
    """How long and how closely to solve.

    ``iterations``: steps at most; ``tolerance_m``, ``tolerance_rad``: what counts as reached, of every task but priors;
    ``settled_rad``: steps smaller than this (radians, metres of the root) end a solve that cannot reach; ``damping``: of the
    first step, as a share of the cost; ``restarts``: how often solves that settled without reaching begin again elsewhere
    (poses spread about the first by ``spread_rad``, the same every time); the best is kept. Restarts may make neighbouring
    targets' poses jump.
    """

    iterations: int = 100
    tolerance_m: float = 1e-5
    tolerance_rad: float = 1e-5
    settled_rad: float = 1e-8
    damping: float = 0.1
    restarts: int = 0
    spread_rad: float = 0.7

    def __post_init__(self) -> None:
        if self.iterations < 0 or self.restarts < 0:
            raise ShapeError(f"iterations, restarts: expected at least 0, got {self.iterations} and {self.restarts}")
        for name in ("tolerance_m", "tolerance_rad", "settled_rad", "damping", "spread_rad"):
            if not getattr(self, name) > 0:
                raise ShapeError(f"{name}: expected more than 0, got {getattr(self, name)}")


@dataclass(frozen=True, slots=True, eq=False)
class TaskResidual:
    """What is left of a task, unweighted (*B): metres, radians, or both for a relative task; None where there is none such.

    Of a prior the angle is that of the joint that is furthest from its pose.
    """

    distance_m: Floats | None
    angle_rad: Floats | None


@dataclass(frozen=True, slots=True, eq=False)
class IkResult:
    """A pose that does what was asked as well as it can.

    Shapes and units: ``pose`` of batch shape (*B,); ``residuals`` one for each task; ``cost`` (*B,) half the sum of the
    weighted squares, square metres; ``iterations`` (*B,) steps; ``outcome`` (*B,) indices of `OUTCOMES`: all tasks are
    within their tolerances; no step makes it better (targets out of reach, against each other or against limits); or steps
    ran out.
    """

    pose: Pose
    residuals: tuple[TaskResidual, ...]
    cost: Floats
    iterations: Ints
    outcome: Ints

    @property
    def reached(self) -> Array:
        """(*B,) whether all tasks but priors are within their tolerances."""
        return self.outcome == 0

    @property
    def converged(self) -> Array:
        """(*B,) whether nothing is left to gain."""
        return self.outcome != 2

    @property
    def reasons(self) -> Array:
        """(*B,) the outcomes in words."""
        return np.asarray(OUTCOMES)[self.outcome]


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

    Large batches, and all once it is loaded, go through a compiled solver whose step is linear in joints and tasks; relative
    tasks, centres of mass and limits of proper Euler angles are solved by NumPy, with the same result.

    Raises:
        UnknownName: for a joint, policy or axis that does not exist.
        ShapeError: where shapes, numbers or scales make no sense.

    Source: damped least squares after K. Levenberg (1944) and D. Marquardt (1963), damping after T. Sugihara, "Solvability-
        unconcerned inverse kinematics by the Levenberg-Marquardt method" (2011) and H. Nielsen (1999); bounds after D.
        Bertsekas, "Projected Newton methods" (1982).
    """
    chosen = SolveOptions() if options is None else options
    motion = root if isinstance(root, RootMotion) else RootMotion(root)
    batch = batch_of(pose, tasks)
    problem = make_problem(skeleton, pose, tasks, batch, limits or {}, fixed, locked or {}, motion)
    smooth = any(term.kind is Smoothness for term in problem.terms)
    if smooth and not batch:
        raise ShapeError("Smoothness: expected frames as the first axis of the batch, got a single pose")
    state = _in_order(problem, batch, chosen) if smooth else _solve(problem, chosen)
    return _result(problem, pose, batch, state, chosen)


def _solve(problem: Problem, options: SolveOptions) -> State:
    state = _begin(problem, problem.start.copy(), np.zeros((len(problem.start), 3)), options)
    _run(problem, state, options)
    if options.restarts:
        rng = np.random.default_rng(0)
        for _ in range(options.restarts):
            left = np.flatnonzero(state.miss > 1.0)
            if not len(left):
                break
            part = problem.take(left)
            turns = rng.normal(size=(len(left), problem.skeleton.joint_count, 3)) * options.spread_rad
            turns[:, problem.free == 0] = 0.0
            if problem.upright >= 0:
                turns[:, problem.upright, ::2] = 0.0
            away = quat.multiply(part.start, quat.from_rotation_vector(turns))
            other = _begin(part, away, state.shift[left].copy(), options)
            _run(part, other, options)
            better = other.cost < state.cost[left]
            state.steps[left] += other.steps
            for name in ("rotations", "shift", "cost", "miss", "done"):
                getattr(state, name)[left[better]] = getattr(other, name)[better]
    return state


def _begin(problem: Problem, rotations: Floats, shift: Floats, options: SolveOptions) -> State:
    count = len(rotations)
    dense.hold(problem, rotations)
    ones = np.ones(count)
    return State(
        rotations, shift, options.damping * ones, dense.GROWTH * ones, np.zeros(count), np.zeros(count),
        np.zeros(count, bool), np.zeros(count), np.zeros(count, np.int64),
    )  # fmt: skip


def _run(problem: Problem, state: State, options: SolveOptions) -> None:
    count = len(state.cost)
    if not count:
        return
    tolerances = options.tolerance_m, options.tolerance_rad, options.settled_rad
    work = count * problem.skeleton.joint_count * min(options.iterations, _TYPICAL_STEPS)
    if options.iterations and problem.terms and is_compiled(problem):
        kernels = kernels_for("fullbody", work, problem.start)
        if kernels is not None:
            solve_compiled(problem, state, kernels.solve_rows, options.iterations, *tolerances)
            return
    for first in range(0, count, _AT_ONCE):
        rows = np.arange(first, min(first + _AT_ONCE, count))
        part, some = problem.take(rows), state.take(rows)
        dense.measure(part, some, *tolerances[:2])
        for _ in range(options.iterations):
            dense.step(part, some, *tolerances)
            if some.done.all():
                break
        state.put(rows, some)


def _in_order(problem: Problem, batch: tuple[int, ...], options: SolveOptions) -> State:
    """Frame after frame, each with the one before as what to stay near."""
    frames, each = batch[0], len(problem.start) // max(batch[0], 1)
    count = len(problem.start)
    whole = _begin(problem, problem.start.copy(), np.zeros((count, 3)), options)
    before: State | None = None
    for frame in range(frames):
        rows = np.arange(frame * each, (frame + 1) * each)
        part = problem.take(rows)
        terms: list[Term] = []
        for term in part.terms:
            if term.kind is not Smoothness:
                terms.append(term)
            elif before is not None:
                moved = problem.offsets[rows - each, problem.mover] - problem.offsets[rows, problem.mover]
                if problem.mover >= 0 and problem.parents[problem.mover] >= 0:
                    above = rotation_above(problem.skeleton, part.start, int(problem.mover))
                    moved = quat.rotate(above, moved)
                terms.append(replace(term, target=before.rotations, offset=before.shift + moved))
        before = _solve(replace(part, terms=tuple(terms)), options)
        whole.put(rows, before)
    return whole


def _result(problem: Problem, pose: Pose, batch: tuple[int, ...], state: State, options: SolveOptions) -> IkResult:
    dtype = np.result_type(np.asarray(pose.rotations).dtype, np.float32)
    joints = problem.skeleton.joint_count
    translations = np.asarray(pose.translations, np.float64)
    if problem.mover >= 0:
        translations = np.array(np.broadcast_to(translations, (*batch, joints, 3))).reshape(-1, joints, 3)
        translations[:, problem.mover] += _in_parent(problem, pose, batch, state.shift)
        translations = translations.reshape(*batch, joints, 3)
    rotations = state.rotations.reshape(*batch, joints, 4)
    solved = Pose(translations.astype(dtype), rotations.astype(dtype), pose.scales)
    turned, places = (
        np.asarray(a, np.float64).reshape(len(state.cost), *a.shape[-2:])
        for a in world_rotations_positions(
            problem.skeleton, Pose(translations, rotations, np.asarray(pose.scales, np.float64))
        )
    )
    residuals = tuple(_residual(problem, term, state, turned, places, batch) for term in problem.terms)
    outcome = np.where(state.miss <= 1.0, 0, np.where(state.done, 1, 2)).reshape(batch)
    return IkResult(solved, residuals, state.cost.reshape(batch), state.steps.astype(np.int64).reshape(batch), outcome)


def _in_parent(problem: Problem, pose: Pose, batch: tuple[int, ...], shift: Floats) -> Floats:
    """A displacement in the model's space along the axes of the moving joint's parent, before its scale."""
    parent = int(problem.parents[problem.mover])
    if parent < 0:
        return shift
    scale = np.ones(len(shift))
    joint = parent
    scales = np.broadcast_to(np.asarray(pose.scales, np.float64), (*batch, problem.skeleton.joint_count, 3))
    scales = scales.reshape(len(shift), -1, 3).mean(axis=-1)
    while joint >= 0:
        scale = scale * scales[:, joint]
        joint = int(problem.parents[joint])
    above = rotation_above(problem.skeleton, problem.start, problem.mover)
    return quat.rotate(quat.conjugate(above), shift) / scale[:, None]


def _residual(
    problem: Problem, term: Term, state: State, turned: Floats, places: Floats, batch: tuple[int, ...]
) -> TaskResidual:
    distance: Floats | None = None
    angle: Floats | None = None
    for rows in dense.rows_of(problem, term, state.rotations, state.shift, turned, places):
        size = np.linalg.norm(rows.residual, axis=-1)
        if rows.soft and rows.angular:
            parts = np.linalg.norm(rows.residual.reshape(len(size), -1, 3), axis=-1)
            size = parts.max(axis=-1, initial=0.0)
        if rows.angular:
            angle = size.reshape(batch)
        else:
            distance = size.reshape(batch)
    return TaskResidual(distance, angle)
