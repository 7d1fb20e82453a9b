"""Space-time constraints: one displacement of a whole window that meets all its constraints and changes the motion least.

Unknowns are the control points of cubic B-splines, three for every joint above a constraint (rotation vector in the joint's own
axes) and three for every root (metres). What the motion loses, how fast the change itself changes, and what constraints miss
are one sum of squares, solved by damped Gauss-Newton and Newton steps with sparse matrices.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from keypose.arrays import Floats, Ints, checked
from keypose.editing.constraints import (
    Constraint,
    ConstraintRows,
    Hold,
    Turn,
    cross_matrix,
    inverse_right_jacobian,
    right_jacobian,
)
from keypose.editing.displacement import displace, knot_weights
from keypose.editing.reach import REACHED_M, check_finite, found_roles, joint_of
from keypose.errors import ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.ik import JointLimit, clamp_rotation
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class SpacetimeOptions:
    """How a window is solved.

    Units:
        knot_frames: frames between control points. Constraints over many frames in a row need close ones.
        smoothness_s: changes that happen faster than in about this time are made dear: the acceleration of the change counts
            beside the change with the fourth power of this time.
        root_weight: how much a metre of a root counts beside a radian of a joint.
        limit_weight: how much a radian beyond a joint's limit counts, soft.
        hard_weight: the same of a metre or radian missed by a hard constraint; so large that nothing visible is missed.
        iterations: steps at most.
        tolerance: a step that gains less than this share of what the change itself costs ends the work; a hundredth of it
            where hard constraints are not met.
        open_ends: whether the change need not fade where the window ends with the motion.
    """

    knot_frames: int = 2
    smoothness_s: float = 0.15
    root_weight: float = 8.0
    limit_weight: float = 100.0
    hard_weight: float = 1e4
    iterations: int = 100
    tolerance: float = 1e-3
    open_ends: bool = True

    def __post_init__(self) -> None:
        positive = (self.knot_frames, self.root_weight, self.hard_weight, self.tolerance, self.iterations)
        if min(positive) <= 0 or min(self.smoothness_s, self.limit_weight) < 0:
            raise ShapeError("options: expected positive numbers, and a smoothness and a limit weight of 0 or more")


@dataclass(frozen=True, slots=True, eq=False)
class SpacetimeResult:
    """The solved motion.

    Shapes and units: ``error`` for each constraint what it misses in its frames (N,), metres or radians; ``costs`` of the
    motion before and after every accepted step, falling; ``converged`` whether the steps came to rest; ``reached`` whether
    every hard constraint is met to `REACHED_M` (metres or radians); ``over_limit_rad`` the largest turn beyond a limit.
    """

    motion: Motion
    error: tuple[Floats, ...]
    costs: tuple[float, ...]
    converged: bool
    reached: bool
    over_limit_rad: float


def solve_spacetime(
    motion: Motion,
    skeleton: Skeleton,
    window: tuple[int, int],
    constraints: Sequence[Constraint],
    *,
    limits: Mapping[str, JointLimit] | None = None,
    fixed: Sequence[str] = (),
    roles: Mapping[str, int] | None = None,
    options: SpacetimeOptions = SpacetimeOptions(),
    progress: Progress | None = None,
) -> SpacetimeResult:
    """The motion with the least smooth change between two frames that meets constraints over all of them.

    Frames outside the window, and both of its ends unless the motion ends there, keep their bits. Constraints that cannot be met
    together settle where the sum of what they miss, squared, is least.

    Shapes and units: ``window`` first and last frame; ``limits`` by joint name, kept softly; ``fixed`` joints (a root too)
    that do not change.

    Raises:
        UnknownName: for a joint that is not there.
        ShapeError: where frames or shapes do not fit, the window is shorter than four knots, or the motion has numbers that are
            not finite.

    Source: M. Gleicher, "Motion editing with spacetime constraints" (I3D 1997), and "Retargetting motion to new characters"
    (SIGGRAPH 1998), section 4: the change is a spline, and what it changes least is sought.
    """
    problem = SpacetimeProblem(motion, skeleton, window, constraints, limits or {}, fixed, roles, options)
    return problem.solve(progress)


class SpacetimeProblem:
    """The sum of squares of `solve_spacetime`, its residuals and their Jacobian, as functions of the control points."""

    def __init__(
        self,
        motion: Motion,
        skeleton: Skeleton,
        window: tuple[int, int],
        constraints: Sequence[Constraint],
        limits: Mapping[str, JointLimit],
        fixed: Sequence[str],
        roles: Mapping[str, int] | None,
        options: SpacetimeOptions,
    ) -> None:
        checked(motion.pose.rotations, (..., skeleton.joint_count, 4), "rotations", "the skeleton")
        check_finite(motion)
        first, last = window
        if not 0 <= first < last < motion.frame_count:
            raise ShapeError(f"window: expected two rising frames from 0 to {motion.frame_count - 1}, got {window}")
        self.motion, self.skeleton, self.window, self.options = motion, skeleton, window, options
        known = found_roles(skeleton) if roles is None else roles
        self.rows = [ConstraintRows(c, skeleton, known, window) for c in constraints]
        self.limits = {skeleton.index(name): limit for name, limit in limits.items()}
        still = {joint_of(skeleton, name, known) for name in fixed}
        used = sorted({j for r in self.rows for j in r.path} - still)
        self.joints: Ints = np.array(used, np.intp)
        self.roots: Ints = np.array([j for j in used if skeleton.parents[j] < 0], np.intp)
        self._place_knots()
        self._state: tuple[bytes, Any] | None = None

    def _place_knots(self) -> None:
        first, last = self.window
        pieces = max(4, round((last - first) / self.options.knot_frames))
        self.spacing = (last - first) / pieces
        low, high = (
            3 if self.options.open_ends and at_end else 0
            for at_end in (first == 0, last == self.motion.frame_count - 1)
        )
        self.knots = pieces - 3 + low + high
        self.frames: Ints = np.arange(first, last + 1)
        self.indices, self.weights = knot_weights(self.frames, first - low * self.spacing, self.spacing, self.knots)
        frames = len(self.frames)
        self.basis = sparse.csr_array(
            (self.weights.ravel(), (np.repeat(np.arange(frames), 4), self.indices.ravel())), (frames, self.knots)
        )
        self.basis.sum_duplicates()
        # The change beyond both ends counts for its acceleration.
        around = np.arange(first - 2, last + 3)
        indices, weights = knot_weights(around, first - low * self.spacing, self.spacing, self.knots)
        padded = sparse.csr_array(
            (weights.ravel(), (np.repeat(np.arange(len(around)), 4), indices.ravel())), (len(around), self.knots)
        )
        inner = len(around) - 2
        bend = sparse.eye_array(inner, inner + 2) - 2.0 * sparse.eye_array(inner, inner + 2, k=1)
        bend = (bend + sparse.eye_array(inner, inner + 2, k=2)).tocsr()
        curved = bend @ padded * (self.options.smoothness_s * self.motion.rate_hz) ** 2
        self.channels = 3 * (len(self.joints) + len(self.roots))
        cost = (self.basis.T @ self.basis + curved.T @ curved).tocsr()
        scale = np.ones(self.channels)
        scale[3 * len(self.joints) :] = self.options.root_weight
        # Unknowns are ordered knot by knot: what acts together lies together.
        self.quadratic = sparse.kron(cost, sparse.diags_array(scale**2)).tocsc()
        self.spread = sparse.kron(self.basis, sparse.eye_array(self.channels)).tocsr()
        # The same as residuals, for those who want the whole sum.
        self.regular = sparse.kron(sparse.vstack([self.basis, curved]), sparse.diags_array(scale)).tocsr()

    @property
    def size(self) -> int:
        """The number of unknowns."""
        return self.knots * self.channels

    def displaced(self, unknowns: Floats) -> Motion:
        """The motion under control points (size,)."""
        change = self._changes(unknowns)
        count = self.motion.frame_count
        turns: dict[int, Floats] = {}
        moves: dict[int, Floats] = {}
        span = slice(self.window[0], self.window[1] + 1)
        for n, joint in enumerate((*self.joints, *self.roots)):
            whole = np.zeros((count, 3))
            whole[span] = change[:, 3 * n : 3 * n + 3]
            (turns if n < len(self.joints) else moves)[int(joint)] = whole
        return displace(self.motion, turns, moves)

    def residuals(self, unknowns: Floats) -> Floats:
        """What constraints miss and limits are passed by, weighted, without the change itself (`regular` times unknowns)."""
        parts = [r.weight(self.options.hard_weight) * values.ravel() for r, values in self._missed(unknowns)]
        return np.concatenate([*parts, self._over(unknowns)[0]])

    def jacobian(self, unknowns: Floats) -> sparse.csr_array:
        """The derivative of `residuals`, (rows, size), sparse."""
        _, turned, places, jacobians = self._pose(unknowns)
        blocks = [
            self._block(r, turned, places, jacobians, values) * r.weight(self.options.hard_weight)
            for r, values in self._missed(unknowns)
        ]
        blocks.append(self._over(unknowns)[1])
        stacked: Any = sparse.vstack(blocks)
        return (stacked @ self.spread).tocsr()

    def bow(self, unknowns: Floats) -> Any:
        """What missed places add to the second derivative of `cost` because joints move on arcs, (size, size)."""
        _, _, places, jacobians = self._pose(unknowns)
        size = len(self.frames) * self.channels
        total = sparse.csr_array((size, size))
        for rows, values in self._missed(unknowns):
            total = total + self._bow(rows, places, jacobians, rows.weight(self.options.hard_weight) ** 2 * values)
        return self.spread.T @ total @ self.spread

    def cost(self, unknowns: Floats) -> float:
        """Half the sum of all squares."""
        missed = self.residuals(unknowns)
        return 0.5 * float(missed @ missed + unknowns @ (self.quadratic @ unknowns))

    def solve(self, progress: Progress | None = None) -> SpacetimeResult:
        """Damped steps from no change at all, with hard constraints that harden in three stages.

        Very hard ones from the start would allow only tiny steps along their curved surface.
        """
        unknowns = np.zeros(self.size)
        costs = [self.cost(unknowns)]
        converged = self.size == 0 or costs[0] == 0.0
        steps = 0
        wanted = self.options
        for softer in () if converged else (100.0, 10.0, 1.0):
            self.options = replace(wanted, hard_weight=wanted.hard_weight / softer)
            enough = wanted.tolerance if softer == 1.0 else max(3e-3, wanted.tolerance)
            costs = [self.cost(unknowns)]
            damping, converged = 1e-6, False
            most = wanted.iterations if softer == 1.0 else steps + wanted.iterations // 4
            while not converged and steps < most:
                unknowns, cost, damping = self._step(unknowns, costs[-1], damping)
                # Beside what the motion loses; what is missed out of reach would hide it. Rounding ends the work, too.
                change = 0.5 * float(unknowns @ (self.quadratic @ unknowns))
                share = enough if self._is_met(unknowns, REACHED_M * softer**2) else 0.01 * enough
                converged = costs[-1] - cost <= max(share * change, 1e-13 * cost)
                costs.append(cost)
                steps += 1
                if progress is not None:
                    progress(steps, wanted.iterations)
        self.options = wanted
        return self._result(unknowns, costs, converged)

    def _is_met(self, unknowns: Floats, near: float) -> bool:
        """Whether hard constraints are met to ``near`` metres or radians."""
        return all(
            float(np.linalg.norm(values, axis=-1).max(initial=0.0)) <= near
            for rows, values in self._missed(unknowns)
            if rows.constraint.weight is None
        )

    def _step(self, unknowns: Floats, cost: float, damping: float) -> tuple[Floats, float, float]:
        """The next control points, their cost and damping; the same where no step makes it less."""
        jacobian = self.jacobian(unknowns)
        slope = jacobian.T @ self.residuals(unknowns) + self.quadratic @ unknowns
        plain = jacobian.T @ jacobian + self.quadratic
        # Newton's step is the better one near the end and where a target is out of reach, Gauss and Newton's further away.
        ways = [plain, plain + self.bow(unknowns)]
        size = sparse.diags_array(self.quadratic.diagonal() + 1e-9)
        while damping < 1e9:
            tried = [unknowns - _factored(way + damping * size).solve(slope) for way in ways]
            costs = [self.cost(t) for t in tried]
            best = int(np.argmin(costs))
            if costs[best] <= cost:
                return tried[best], costs[best], max(damping * 0.1, 1e-9)
            damping *= 10.0
        return unknowns, cost, damping

    def _result(self, unknowns: Floats, costs: list[float], converged: bool) -> SpacetimeResult:
        errors = tuple(np.linalg.norm(values, axis=-1) for _, values in self._missed(unknowns))
        hard = [e.max(initial=0.0) for e, r in zip(errors, self.rows, strict=True) if r.constraint.weight is None]
        over = self._over_limits(unknowns)
        return SpacetimeResult(
            self.displaced(unknowns),
            errors,
            tuple(costs),
            converged,
            all(e <= REACHED_M for e in hard),
            max((float(angles.max(initial=0.0)) for angles in over.values()), default=0.0),
        )

    def _changes(self, unknowns: Floats) -> Floats:
        return self.basis @ unknowns.reshape(self.knots, self.channels)

    def _pose(self, unknowns: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Local and model rotations, places, and what a change of each rotation vector turns in the model's space."""
        key = unknowns.tobytes()
        if self._state is not None and self._state[0] == key:
            return self._state[1]
        change = self._changes(unknowns)
        span = slice(self.window[0], self.window[1] + 1)
        pose = self.motion.pose[span]
        local = np.array(pose.rotations, np.float64)
        moved = np.array(pose.translations, np.float64)
        vectors = change[:, : 3 * len(self.joints)].reshape(len(change), -1, 3)
        local[:, self.joints] = quat.multiply(local[:, self.joints], quat.from_rotation_vector(vectors))
        moved[:, self.roots] += change[:, 3 * len(self.joints) :].reshape(len(change), -1, 3)
        turned, places = world_rotations_positions(
            self.skeleton, Pose(moved, local, np.asarray(pose.scales, np.float64))
        )
        model_from_vector = quat.to_matrix(turned[:, self.joints]) @ right_jacobian(vectors)
        found = (local, turned, places, model_from_vector)
        self._state = (key, found)
        return found

    def _missed(self, unknowns: Floats) -> list[tuple[ConstraintRows, Floats]]:
        _, turned, places, _ = self._pose(unknowns)
        return [(r, r.missed(turned, places)) for r in self.rows]

    def _block(self, rows: ConstraintRows, turned: Floats, places: Floats, jacobians: Floats, values: Floats) -> Any:
        """The derivative of one constraint's rows (3N) by the changes of all frames (F * C)."""
        at = rows.rows
        columns: list[Floats] = []
        turning, moving = self._parts(rows)
        for n in turning:
            if isinstance(rows.constraint, Turn):
                # The residual is log(target^-1 q): turned on, in the joint's own axes.
                own = quat.to_matrix(quat.conjugate(turned[at, rows.joint])) @ jacobians[at, n]
                columns.append(inverse_right_jacobian(values) @ own)
            else:
                arm = places[at, rows.joint] - places[at, self.joints[n]]
                columns.append(-cross_matrix(arm) @ jacobians[at, n])
        columns += [np.broadcast_to(np.eye(3), (len(at), 3, 3))] * len(moving)
        if not columns:
            return sparse.csr_array((3 * len(at), len(self.frames) * self.channels))
        dense = np.stack(columns, axis=1)  # (N, A, 3 rows, 3 columns)
        row = 3 * np.arange(len(at))[:, None, None, None] + np.arange(3)[:, None]
        column = self._columns(rows)[:, :, None, :]
        where = (np.broadcast_to(row, dense.shape).ravel(), np.broadcast_to(column, dense.shape).ravel())
        block = sparse.coo_array((dense.ravel(), where), (3 * len(at), len(self.frames) * self.channels)).tocsr()
        if isinstance(rows.constraint, Hold):
            mean = sparse.kron(np.full((len(at), len(at)), 1.0 / len(at)), np.eye(3)).tocsr()
            block = block - mean @ block
        return block

    def _bow(self, rows: ConstraintRows, places: Floats, jacobians: Floats, values: Floats) -> Any:
        """What a missed place adds to the second derivative because its path is no line, (F * C, F * C).

        Of turns a about joint i and b about joint j below it, a point p moves by a x (b x (p - j)) in second order.
        """
        at = rows.rows
        turning = self._parts(rows)[0]
        size = len(self.frames) * self.channels
        if isinstance(rows.constraint, Turn) or not turning or not np.any(values):
            return sparse.csr_array((size, size))
        count = len(turning)
        arms = places[at, rows.joint][:, None] - places[at][:, self.joints[turning]]  # (N, A, 3)
        missed = np.sum(arms * values[:, None], axis=-1)[..., None, None]
        bent = arms[..., :, None] * values[:, None, None, :] - missed * np.eye(3)
        full = np.zeros((len(at), count, 3, count, 3))
        # Joints rise from parent to child.
        for lower in range(count):
            full[:, : lower + 1, :, lower] = bent[:, lower][:, None]
        frames = jacobians[at][:, turning]  # (N, A, 3, 3)
        full = np.einsum("niax,niajb,njby->nixjy", frames, full, frames, optimize=True).reshape(
            len(at), 3 * count, 3 * count
        )
        upper = np.kron(np.triu(np.ones((count, count)), 1), np.ones((3, 3)))
        diagonal = np.kron(np.eye(count), np.ones((3, 3)))
        full = full * upper + np.swapaxes(full * upper, 1, 2) + 0.5 * diagonal * (full + np.swapaxes(full, 1, 2))
        column = self._columns(rows)[:, :count].reshape(len(at), -1)
        where = (
            np.broadcast_to(column[:, :, None], full.shape).ravel(),
            np.broadcast_to(column[:, None, :], full.shape).ravel(),
        )
        return sparse.coo_array((full.ravel(), where), (size, size)).tocsr()

    def _parts(self, rows: ConstraintRows) -> tuple[list[int], list[int]]:
        """Which of the turning joints and of the moving roots a constraint depends on."""
        turning = [n for n, joint in enumerate(self.joints) if int(joint) in rows.path]
        if isinstance(rows.constraint, Turn):
            return turning, []
        if int(self.skeleton.parents[rows.joint]) < 0:
            turning = []  # a root's own turn does not move it
        return turning, [n for n, joint in enumerate(self.roots) if int(joint) in rows.path]

    def _columns(self, rows: ConstraintRows) -> Ints:
        """The columns of a constraint's parts among the changes of all frames, (N, A, 3)."""
        turning, moving = self._parts(rows)
        first = np.array([3 * n for n in turning] + [3 * (len(self.joints) + n) for n in moving], np.intp)
        return rows.rows[:, None, None] * self.channels + first[:, None] + np.arange(3)

    def _over_limits(self, unknowns: Floats) -> dict[int, Floats]:
        local = self._pose(unknowns)[0]
        found: dict[int, Floats] = {}
        for n, joint in enumerate(self.joints):
            limit = self.limits.get(int(joint))
            if limit is not None:
                rest = self.skeleton.rest.rotations[joint]
                found[n] = quat.angle_between(local[:, joint], clamp_rotation(limit, local[:, joint], rest))
        return found

    def _over(self, unknowns: Floats) -> tuple[Floats, Any]:
        """Turns beyond limits, weighted, and their derivative: towards the allowed rotation that is nearest now."""
        local = self._pose(unknowns)[0]
        weight = self.options.limit_weight
        columns = len(self.frames) * self.channels
        values: list[Floats] = []
        blocks: list[Any] = []
        vectors = self._changes(unknowns)[:, : 3 * len(self.joints)].reshape(len(self.frames), -1, 3)
        for n, joint in enumerate(self.joints):
            limit = self.limits.get(int(joint))
            if limit is None or weight == 0:
                continue
            own = local[:, joint]
            allowed = clamp_rotation(limit, own, self.skeleton.rest.rotations[joint])
            out = quat.to_rotation_vector(quat.shortest(quat.multiply(quat.conjugate(allowed), own)))
            at = np.flatnonzero(np.linalg.norm(out, axis=-1) > 1e-9)
            if not len(at):
                continue
            values.append(weight * out[at].ravel())
            dense = weight * (inverse_right_jacobian(out[at]) @ right_jacobian(vectors[at, n]))
            row = 3 * np.arange(len(at))[:, None, None] + np.arange(3)[:, None]
            column = self.channels * at[:, None, None] + 3 * n + np.arange(3)
            where = (np.broadcast_to(row, dense.shape).ravel(), np.broadcast_to(column, dense.shape).ravel())
            blocks.append(sparse.coo_array((dense.ravel(), where), (3 * len(at), columns)).tocsr())
        if not blocks:
            return np.zeros(0), sparse.csr_array((0, columns))
        return np.concatenate(values), sparse.vstack(blocks)


def _factored(matrix: Any) -> Any:
    """The factors of a symmetric matrix, in an order that keeps them sparse."""
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
