"""Full bodies over a window of frames: tasks of all frames and the change of speed from frame to frame as one sum of squares.

Frame after frame, a body that stays near the pose before lags behind its targets; together, frames are smoothed by what comes
as by what was. The normal equations of a frame touch those of the two before and after, so they are a band whose factors cost
time and memory linear in frames.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, solveh_banded

from keypose.arrays import Floats, Ints
from keypose.errors import ShapeError
from keypose.ik import fullbody_dense as dense
from keypose.ik.fullbody_dense import State
from keypose.ik.fullbody_problem import Problem, RootMotion, RootPolicy, Term, batch_of, make_problem
from keypose.ik.fullbody_result import IkResult, SolveOptions, TaskResidual
from keypose.ik.fullbody_run import begin, result_of, solve_problem
from keypose.ik.limits import JointLimit
from keypose.ik.tasks import CenterOfMassTask, Joint, PosePrior, RelativeTask, Smoothness, Task
from keypose.math import quat
from keypose.model import Pose, Skeleton

Progress = Callable[[int, int], None]

_REST = 1e-12  # of the cost: steps that gain less have come to rest
_RESTING = 3  # such steps in a row


def solve_window(
    skeleton: Skeleton,
    pose: Pose,
    tasks: Sequence[Task],
    *,
    limits: Mapping[str, JointLimit] | None = None,
    fixed: Sequence[Joint] = (),
    locked: Mapping[str, str] | None = None,
    root: RootPolicy | RootMotion = "free",
    options: SolveOptions | None = None,
    progress: Progress | None = None,
) -> IkResult:
    """Solve all frames together, so that tasks are met and joints change their speed as little as `Smoothness` says.

    As `solve_pose`, but here `Smoothness` weighs how a joint's turn from one frame to the next differs from that to the frame
    after (radians, metres of the root's path), not how far it is from the frame before: noise goes, and nothing lags. The same
    smoothing at twice the rate wants four times the weight. Only joints that tasks move are smoothed.

    Shapes and units: the first axis of the batch (T, ...) is time, further ones are characters of their own; ``pose`` is where
    frames start; ``cost`` (T, ...) has each frame's own share; memory grows with frames times the square of the number of
    joints that move. ``progress(step, most)`` is told after every step. There are no restarts.

    Raises:
        UnknownName: for a joint, policy or axis that does not exist.
        ShapeError: where shapes, numbers or scales make no sense, or there is no axis of time.

    Source: M. Gleicher, "Motion editing with spacetime constraints" (I3D 1997); the Gauss-Newton equations as a band after
        G. Golub and C. Van Loan, "Matrix Computations", section 4.3.
    """
    chosen = SolveOptions() if options is None else options
    batch = batch_of(pose, tasks)
    if not batch:
        raise ShapeError("solve_window: expected frames as the first axis of the batch, got a single pose")
    motion = root if isinstance(root, RootMotion) else RootMotion(root)
    whole = make_problem(skeleton, pose, tasks, batch, limits or {}, fixed, locked or {}, motion)
    problem = replace(whole, terms=tuple(term for term in whole.terms if term.kind is not Smoothness))
    smooth = [term for term in whole.terms if term.kind is Smoothness and (term.by_joint.any() or term.root_weight)]
    bends = np.zeros((len(problem.start), skeleton.joint_count + 1))
    if smooth and len(bends):
        state = begin(problem, chosen)
        for own in np.arange(len(bends)).reshape(batch[0], -1).T:
            window, some = Window.of(problem.take(own), smooth), state.take(own)
            bends[own] = window.solve(some, chosen, progress)
            state.put(own, some)
    else:
        state = solve_problem(problem, chosen)
    found = result_of(problem, pose, batch, state)
    return replace(found, residuals=_residuals(whole, found, bends, batch))


def _residuals(whole: Problem, found: IkResult, bends: Floats, batch: tuple[int, ...]) -> tuple[TaskResidual, ...]:
    """The residuals of all tasks in their order; of smoothness the largest change of speed."""
    others = iter(found.residuals)
    metres, angles = bends[:, -1].reshape(batch), bends[:, :-1].max(axis=1, initial=0.0).reshape(batch)
    return tuple(
        TaskResidual(metres if term.root_weight > 0 else None, angles) if term.kind is Smoothness else next(others)
        for term in whole.terms
    )


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """The sum of squares about where it is: gradient (T, C), blocks of the Hessian of a frame with itself (T, C, C), and with the
    next (T - 1, M + 1, 3, 3) and next but one (T - 2, M + 1, 3, 3), joint by joint, later frame first; ``bow`` (T, C, C) is what
    the tasks' curvature adds."""

    gradient: Floats
    own: Floats
    bow: Floats
    next: Floats
    after: Floats

    def times(self, change: Floats) -> Floats:
        """The Hessian times a change (T, C)."""
        out = np.einsum("tab,tb->ta", self.own, change)
        parts = change.reshape(len(change), -1, 3)
        for blocks, apart in ((self.next, 1), (self.after, 2)):
            if len(blocks):
                out[apart:] += np.einsum("tmab,tmb->tma", blocks, parts[:-apart]).reshape(len(blocks), -1)
                out[:-apart] += np.einsum("tmba,tmb->tma", blocks, parts[apart:]).reshape(len(blocks), -1)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """The frames (T) of one character: tasks in ``problem``, joints that move (M,), and what their changes of speed count (M,)."""

    problem: Problem
    moving: Ints
    weight: Floats
    root_weight: float

    @staticmethod
    def of(problem: Problem, smooth: Sequence[Term]) -> Window:
        """The window of a problem; joints that no task moves stay."""
        free = problem.free * _moved(problem)
        moving = np.flatnonzero(free)
        weight = np.sqrt(sum((term.by_joint[moving] ** 2 for term in smooth), np.zeros(len(moving))))
        root = float(np.sqrt(sum(term.root_weight**2 for term in smooth))) if problem.mover >= 0 else 0.0
        return Window(replace(problem, free=free), moving, weight, root)

    @property
    def columns(self) -> Ints:
        """Which of the solver's columns are unknowns here (C,): turns of the moving joints and the root's displacement."""
        joints = np.append(self.moving, self.problem.skeleton.joint_count)
        return (3 * joints[:, None] + np.arange(3)).ravel()

    def solve(self, state: State, options: SolveOptions, progress: Progress | None = None) -> Floats:
        """Steps from a state until nothing is left to gain, in place; the changes of speed (T, J + 1) that are left."""
        damping, growth, curved, rests, done = options.damping, dense.GROWTH, False, 0, False
        cost = self.cost(state.rotations, state.shift)
        linear, turned = self.linear(state.rotations, state.shift)
        for step in range(options.iterations):
            old = cost
            floor = max(damping * old / len(state.cost), self.problem.least_damping)
            change, promised = self.change(state, linear, turned, floor, curved)
            new, moved = dense.apply(self.problem, state.rotations, state.shift, turned, self.spread(change))
            tried = self.cost(new, moved) if promised > 0.0 else old
            gain = min(max((old - tried) / max(promised, 1e-300), 0.0), 1.0)
            firm = floor <= dense.FIRM * self.problem.least_damping
            rests = rests + 1 if firm and 0.0 <= promised < _REST * old else 0
            done = rests >= _RESTING or (firm and float(np.abs(change).max(initial=0.0)) < options.settled_rad)
            if tried < old:
                state.rotations[:], state.shift[:], cost = new, moved, tried
                linear, turned = self.linear(state.rotations, state.shift)
                damping *= max(dense.SHRINK, 1.0 - (2.0 * gain - 1.0) ** 3)
                growth, curved = dense.GROWTH, tried > dense.SLOW * old
            else:
                damping, growth = damping * growth, 2.0 * growth
            damping = float(np.clip(damping, dense.LEAST_FACTOR, dense.MOST_FACTOR))
            state.steps += 1
            if progress is not None:
                progress(step + 1, options.iterations)
            if done or damping >= dense.MOST_FACTOR:
                done = True
                break
        return self.settle(state, options, done)

    def settle(self, state: State, options: SolveOptions, done: bool) -> Floats:
        """Cost and miss of every frame into the state; the changes of speed that are left."""
        _, places, rows = dense.evaluate(self.problem, state.rotations, state.shift)
        state.miss[:] = dense.miss_of(rows, len(state.cost), options.tolerance_m, options.tolerance_rad)
        state.cost[:] = dense.cost_of(rows, len(state.cost))
        turns, moves = self.bends(state.rotations, places)
        state.cost[1:-1] += 0.5 * np.sum((self.weight[:, None] * turns) ** 2, axis=(1, 2))
        state.cost[1:-1] += 0.5 * np.sum((self.root_weight * moves) ** 2, axis=1)
        state.done[:] = done
        left = np.zeros((len(state.cost), self.problem.skeleton.joint_count + 1))
        left[1:-1, self.moving] = np.linalg.norm(turns, axis=-1) * (self.weight > 0)
        left[1:-1, -1] = np.linalg.norm(moves, axis=-1)
        return left

    def cost(self, rotations: Floats, shift: Floats) -> float:
        """Half the sum of all weighted squares."""
        _, places, rows = dense.evaluate(self.problem, rotations, shift)
        turns, moves = self.bends(rotations, places)
        soft = np.sum((self.weight[:, None] * turns) ** 2) + np.sum((self.root_weight * moves) ** 2)
        return float(dense.cost_of(rows, len(shift)).sum() + 0.5 * soft)

    def bends(self, rotations: Floats, places: Floats) -> tuple[Floats, Floats]:
        """How turns and the root's steps change from frame to frame: (T - 2, M, 3) radians and (T - 2, 3) metres."""
        own = rotations[:, self.moving]
        steps = dense.turn_between(own[:-1], own[1:])
        path = places[:, max(self.problem.mover, 0)]
        return np.diff(steps, axis=0), np.diff(path, 2, axis=0)

    def linear(self, rotations: Floats, shift: Floats) -> tuple[Linear, Floats]:
        """Gradient and Hessian, and the joints' rotations in the model's space."""
        turned, places, rows = dense.evaluate(self.problem, rotations, shift)
        columns = self.columns
        matrix = dense.jacobian(self.problem, rows, places)[:, :, columns]
        missed = np.concatenate([r.weight * r.residual for r in rows] or [np.zeros((len(shift), 0))], axis=1)
        gradient = np.einsum("trc,tr->tc", matrix, missed)
        own = np.swapaxes(matrix, 1, 2) @ matrix
        bow = dense.curvature(self.problem, turned, places)[:, columns[:, None], columns]
        count = len(self.moving) + 1
        near, far = (np.zeros((max(len(shift) - apart, 0), count, 3, 3)) for apart in (1, 2))
        return self.smoothed(Linear(gradient, own, bow, near, far), rotations, turned, places), turned

    def smoothed(self, linear: Linear, rotations: Floats, turned: Floats, places: Floats) -> Linear:
        """With what changes of speed add, in place."""
        frames, count = len(rotations), len(self.moving)
        if frames < 3:
            return linear
        turns, moves = self.bends(rotations, places)
        own = rotations[:, self.moving]
        steps = dense.turn_between(own[:-1], own[1:]).reshape(-1, 3)
        late = dense.inverse_left(steps).reshape(frames - 1, count, 3, 3)
        early = dense.inverse_left(-steps).reshape(frames - 1, count, 3, 3)
        inward = self.inward(turned)
        parts = np.zeros((3, frames - 2, count + 1, 3, 3))
        parts[0, :, :count] = early[:-1] @ inward[:-2]
        parts[1, :, :count] = -(early[1:] + late[:-1]) @ inward[1:-1]
        parts[2, :, :count] = late[1:] @ inward[2:]
        parts[:, :, count] = np.array([1.0, -2.0, 1.0])[:, None, None, None] * np.eye(3)
        square = np.append(self.weight, self.root_weight)[:, None] ** 2
        missed = square * np.concatenate([turns, moves[:, None]], axis=1)
        gradient = linear.gradient.reshape(frames, count + 1, 3)
        blocks = linear.own.reshape(frames, count + 1, 3, count + 1, 3)
        joint = np.arange(count + 1)
        for first in range(3):
            here = slice(first, frames - 2 + first)
            gradient[here] += np.einsum("tmba,tmb->tma", parts[first], missed)
            for second in range(first + 1):
                product = np.einsum("tmca,tmcb->tmab", square[..., None] * parts[first], parts[second])
                if first == second:
                    blocks[here, joint, :, joint] += np.swapaxes(product, 0, 1)
                elif first == second + 1:
                    linear.next[second : frames - 2 + second] += product
                else:
                    linear.after[:] += product
        return linear

    def inward(self, turned: Floats) -> Floats:
        """From the model's axes into those of the moving joints' parents (T, M, 3, 3)."""
        out = np.broadcast_to(np.eye(3), (len(turned), len(self.moving), 3, 3)).copy()
        above = self.problem.parents[self.moving]
        hung = np.flatnonzero(above >= 0)
        out[:, hung] = quat.to_matrix(quat.conjugate(turned[:, above[hung]]))
        return out

    def spread(self, values: Floats) -> Floats:
        """Values of the unknowns (T, C) among the solver's columns (T, 3J + 3)."""
        out = np.zeros((len(values), 3 * self.problem.skeleton.joint_count + 3))
        out[:, self.columns] = values
        return out

    def change(
        self, state: State, linear: Linear, turned: Floats, damping: float, curved: bool
    ) -> tuple[Floats, float]:
        """The damped step (T, C) that bounds allow, with the tasks' curvature or, where that leads uphill, without; and what it
        promises to gain, nothing where there is no step."""
        problem, joints = self.problem, np.append(self.moving, self.problem.skeleton.joint_count)
        if curved:
            bent = replace(linear, own=linear.own + linear.bow)
            change, promised = self.change(state, bent, turned, damping, curved=False)
            if promised > 0.0:
                return change, promised
        gradient, every = self.spread(linear.gradient), np.ones(len(turned), bool)
        freedom, forced = dense.freedoms(problem, state.rotations, turned, gradient), np.zeros_like(gradient)
        change = np.zeros_like(linear.gradient)
        for _ in range(dense.PASSES):
            held = forced[:, self.columns]
            pull = linear.gradient + linear.times(held)
            try:
                change = held + _banded_step(linear, pull, freedom[:, joints], damping)
            except LinAlgError:
                return change, 0.0
            spread = self.spread(change)
            new, _ = dense.apply(problem, state.rotations, state.shift, turned, spread)
            # What edges of cones stiffen is left out: it only makes steps beside them shorter.
            if (
                dense.stop_at_bounds(problem, state.rotations, turned, gradient, spread, new, every, freedom, forced)
                is None
            ):
                break
        return change, -float(np.sum(linear.gradient * change) + 0.5 * np.sum(change * linear.times(change)))


def _moved(problem: Problem) -> Ints:
    """Which joints (J,) a task depends on."""
    found = np.zeros(problem.skeleton.joint_count, bool)
    for term in problem.terms:
        if term.kind is PosePrior:
            found |= term.by_joint > 0
        elif term.kind is CenterOfMassTask:
            found |= (problem.above[:, term.masses > 0] > 0).any(axis=1)
        else:
            found |= problem.above[:, term.joint] > 0
            if term.kind is RelativeTask:
                found |= problem.above[:, term.other] > 0
    return found.astype(np.int64)


def _banded_step(linear: Linear, pull: Floats, freedom: Floats, damping: float) -> Floats:
    """Minus the inverse of the damped Hessian, within what joints are free to do (T, M + 1, 3, 3), times a pull (T, C)."""
    frames, size = pull.shape
    pull = np.einsum("tmba,tmb->tma", freedom, pull.reshape(frames, -1, 3)).reshape(frames, size)
    own = linear.own.reshape(frames, size // 3, 3, size // 3, 3)
    own = np.einsum("tmca,tmcnd->tmand", freedom, own)
    own = np.einsum("tmand,tndb->tmanb", own, freedom).reshape(frames, size, size)
    band = np.zeros((min(2 * size + 3, frames * size), frames * size))
    row, column = np.tril_indices(size)
    start = size * np.arange(frames)
    band[row - column, start[:, None] + column] = own[:, row, column]
    band[0] += damping
    joint, later, earlier = np.meshgrid(3 * np.arange(size // 3), np.arange(3), np.arange(3), indexing="ij")
    for blocks, apart in ((linear.next, 1), (linear.after, 2)):
        if len(blocks):
            held = np.swapaxes(freedom[apart:], 2, 3) @ blocks @ freedom[:-apart]
            place = start[: frames - apart, None, None, None] + joint + earlier
            band[apart * size + later - earlier, place] = held
    return -solveh_banded(band, pull.ravel(), overwrite_ab=True, lower=True, check_finite=False).reshape(frames, size)
