"""Full-body problems solved: compiled or by NumPy, begun again elsewhere, frame after frame; and what has come of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from keypose.arrays import Floats
from keypose.evaluate import world_rotations_positions
from keypose.evaluate.compiled import kernels_for
from keypose.ik import fullbody_dense as dense
from keypose.ik.fullbody_dense import State
from keypose.ik.fullbody_problem import Problem, Term, rotation_above
from keypose.ik.fullbody_result import IkResult, SolveOptions, TaskResidual
from keypose.ik.fullbody_tables import is_compiled, solve_compiled
from keypose.ik.tasks import Smoothness
from keypose.math import quat
from keypose.model import Pose

TYPICAL_STEPS = 20
_AT_ONCE = 256  # solves that NumPy holds Jacobians of at a time


def solve_problem(problem: Problem, options: SolveOptions, times: int = 1) -> State:
    """Solve all poses of a problem; ``times``: how many such problems there are, so that it pays to compile."""
    state = begin(problem, options)
    _run(problem, state, options, times)
    restart(problem, state, options, times)
    return state


def begin(problem: Problem, options: SolveOptions) -> State:
    """Where solves start."""
    return _begin(problem, problem.start.copy(), np.zeros((len(problem.start), 3)), options)


def restart(problem: Problem, state: State, options: SolveOptions, times: int = 1) -> None:
    """Solves that have not reached begin again elsewhere, as often as asked; the best is kept, in place."""
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
        _run(part, other, options, times)
        better = other.cost < state.cost[left]
        state.steps[left] += other.steps
        for name in ("rotations", "shift", "cost", "miss", "done"):
            getattr(state, name)[left[better]] = getattr(other, name)[better]


def _begin(problem: Problem, rotations: Floats, shift: Floats, options: SolveOptions) -> State:
    count = len(rotations)
    dense.hold(problem, rotations)
    ones = np.ones(count)
    return State(
        rotations, shift, options.damping * ones, dense.GROWTH * ones, np.zeros(count), np.zeros(count),
        np.zeros(count, bool), np.zeros(count), np.zeros(count), np.zeros(count, np.int64),
    )  # fmt: skip


def _run(problem: Problem, state: State, options: SolveOptions, times: int) -> None:
    count = len(state.cost)
    if not count:
        return
    tolerances = options.tolerance_m, options.tolerance_rad, options.settled_rad, options.still_m
    work = times * count * problem.skeleton.joint_count * min(options.iterations, TYPICAL_STEPS)
    if options.iterations and problem.terms and is_compiled(problem):
        kernels = kernels_for("fullbody", work, problem.start)
        if kernels is not None:
            solve_compiled(problem, state, kernels, options.iterations, *tolerances)
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


def solve_in_order(problem: Problem, batch: tuple[int, ...], options: SolveOptions) -> State:
    """Frame after frame, each with the one before as what to stay near."""
    frames, each = batch[0], len(problem.start) // max(batch[0], 1)
    whole = begin(problem, options)
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
        before = solve_problem(replace(part, terms=tuple(terms)), options, times=frames)
        whole.put(rows, before)
    return whole


def result_of(problem: Problem, pose: Pose, batch: tuple[int, ...], state: State) -> IkResult:
    """What a solve of poses of a batch shape has come to."""
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
