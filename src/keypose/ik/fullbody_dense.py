"""The full-body solver in NumPy: Jacobians written out, any task; what the compiled solver is held to.

All turns are small rotation vectors in the model's axes. A task of one joint's body is a few rows over the body's six
motions, turning and moving at the joint's place; its Jacobian for a joint above is that of a rigid body turned about it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from keypose.arrays import Array, Floats, Ints
from keypose.ik.fullbody_limits import FREE, LOW, Bounds, edge_of_cone, find_bounds, pulls_of
from keypose.ik.fullbody_problem import Limited, Problem, Term
from keypose.ik.limits import Cone, clamp_rotation
from keypose.ik.tasks import (
    CenterOfMassTask,
    ContactTask,
    LookAtTask,
    OrientationTask,
    PositionTask,
    RelativeTask,
)
from keypose.math import quat

# How the damping follows what was gained: after H. Nielsen, "Damping parameter in Marquardt's method" (1999).
SHRINK, GROWTH = 1.0 / 5.0, 2.0
LEAST_FACTOR, MOST_FACTOR = 1e-8, 1e9  # of the cost
SLOW = 0.5  # a step that leaves more than this share of the cost calls for curvature
PASSES = 2
SAME = 0.03  # radians between directions that are one
NEAR = 0.05  # radians from a bound within which it is met where a joint stands, not where a step ended
ROUNDING = 1e-15
CALM = 3  # steps in a row that change nothing
FIRM = 1e4  # times the least damping: steps damped more say nothing about what is left to gain


@dataclass(slots=True)
class State:
    """Where N solves are: local rotations (N, J, 4), displacement of the root (N, 3), damping and its growth (N,), the
    cost (N,) in square metres, the miss (N,) in tolerances, and which are ``done`` (N,)."""

    rotations: Floats
    shift: Floats
    damping: Floats
    growth: Floats
    cost: Floats
    miss: Floats
    done: Array
    curved: Floats
    calm: Floats
    steps: Ints

    def take(self, rows: Ints) -> State:
        """Some of the solves, as copies."""
        return State(*(getattr(self, field.name)[rows] for field in fields(self)))

    def put(self, rows: Ints, some: State) -> None:
        """Write some of the solves back."""
        for field in fields(self):
            getattr(self, field.name)[rows] = getattr(some, field.name)


@dataclass(frozen=True, slots=True)
class Rows:
    """Residuals (N, m), unweighted and weighted, and how they follow the bodies: (joint, by turning, by moving) (N, m, 3)."""

    residual: Floats
    weight: Floats
    parts: tuple[tuple[int, Floats, Floats], ...] = ()
    by_joint: Floats | None = None  # (N, m, J, 3) for what no body of its own has
    by_shift: Floats | None = None  # (N, m, 3)
    angular: bool = False
    soft: bool = False


def forward(problem: Problem, rotations: Floats, shift: Floats) -> tuple[Floats, Floats]:
    """Rotations (N, J, 4) and places (N, J, 3) in the model's space."""
    turned, places = np.empty_like(rotations), np.empty((*rotations.shape[:2], 3))
    for joint, parent in enumerate(problem.parents):
        if parent < 0:
            turned[:, joint] = rotations[:, joint]
            places[:, joint] = problem.offsets[:, joint]
        else:
            turned[:, joint] = quat.multiply(turned[:, parent], rotations[:, joint])
            places[:, joint] = places[:, parent] + quat.rotate(turned[:, parent], problem.offsets[:, joint])
        if joint == problem.mover:
            places[:, joint] += shift
    return turned, places


def rows_of(
    problem: Problem, term: Term, rotations: Floats, shift: Floats, turned: Floats, places: Floats
) -> list[Rows]:
    """The residuals of one term, and what each motion changes of them."""
    zero = np.zeros((len(shift), 3, 3))
    eye = np.broadcast_to(np.eye(3), zero.shape)
    joint = term.joint
    if term.kind is PositionTask:
        arm = quat.rotate(turned[:, joint], term.offset)
        miss = places[:, joint] + arm - term.target
        return [Rows(miss, term.weight[:, None], ((joint, _crossing(arm), eye),))]
    if term.kind is OrientationTask:
        off = turn_between(term.target, turned[:, joint])
        return [Rows(off, term.weight[:, None], ((joint, inverse_left(off), zero),), angular=True)]
    if term.kind is LookAtTask:
        arm = quat.rotate(turned[:, joint], term.offset)
        axis = quat.rotate(turned[:, joint], np.broadcast_to(term.axis, arm.shape))
        way = term.target - places[:, joint] - arm
        far = np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-9)
        way = way / far
        slant = (eye - way[:, :, None] * way[:, None, :]) / far[:, :, None]
        part = (joint, _crossing(axis) + slant @ _crossing(arm), slant)
        return [Rows(axis - way, term.weight[:, None], (part,), angular=True)]
    if term.kind is ContactTask:
        normal = term.turn if term.turn is not None else zero[:, 0]
        arm = quat.rotate(turned[:, joint], term.offset)
        height = np.sum((places[:, joint] + arm - term.target) * normal, axis=-1)[:, None]
        on = isinstance(term.task, ContactTask) and term.task.on
        active = np.ones_like(height) if on else (height < 0).astype(np.float64)
        part = (joint, np.cross(arm, normal)[:, None] * active[..., None], (normal * active)[:, None])
        return [Rows(height * active, term.weight[:, None], (part,))]
    if term.kind is RelativeTask:
        return _relative_rows(term, turned, places)
    if term.kind is CenterOfMassTask:
        return [_mass_rows(problem, term, turned, places)]
    return _prior_rows(problem, term, rotations, shift, turned)


def _relative_rows(term: Term, turned: Floats, places: Floats) -> list[Rows]:
    joint, other = term.joint, term.other
    found: list[Rows] = []
    if term.positioned:  # two points that are pulled together, in the model's axes
        arm, theirs = quat.rotate(turned[:, joint], term.offset), quat.rotate(turned[:, other], term.target)
        miss = places[:, joint] + arm - places[:, other] - theirs
        eye = np.broadcast_to(np.eye(3), (len(miss), 3, 3))
        parts = ((joint, _crossing(arm), eye), (other, -_crossing(theirs), -eye))
        found.append(Rows(miss, term.weight[:, None], parts))
    if term.turn is not None:
        back = np.asarray(quat.to_matrix(quat.conjugate(turned[:, other])))
        off = turn_between(term.turn, quat.multiply(quat.conjugate(turned[:, other]), turned[:, joint]))
        by, zero = inverse_left(off) @ back, np.zeros((len(off), 3, 3))
        found.append(Rows(off, term.turn_weight[:, None], ((joint, by, zero), (other, -by, zero)), angular=True))
    return found


def _mass_rows(problem: Problem, term: Term, turned: Floats, places: Floats) -> Rows:
    heavy = places + quat.rotate(turned, term.offset)
    miss = (term.masses[:, None] * heavy).sum(axis=1) - term.target
    below = problem.above.T * term.masses[:, None]  # [b, k]: the mass of b where k is above it
    moment = np.einsum("bk,nbi->nki", below, heavy) - below.sum(axis=0)[:, None] * places
    axes = np.asarray(term.axis)
    by_joint = -_cross_matrix(moment).transpose(0, 2, 1, 3) * axes[:, None, None]
    moved = float(below[:, problem.mover].sum()) if problem.mover >= 0 else 0.0
    by_shift = np.broadcast_to(np.diag(axes * moved), (len(miss), 3, 3))
    return Rows(miss * axes, term.weight[:, None], by_joint=by_joint, by_shift=by_shift)


def _prior_rows(problem: Problem, term: Term, rotations: Floats, shift: Floats, turned: Floats) -> list[Rows]:
    off = turn_between(term.target, rotations)
    count, joints = off.shape[:2]
    above = np.empty((count, joints, 3, 3))
    for joint, parent in enumerate(problem.parents):
        above[:, joint] = np.eye(3) if parent < 0 else quat.to_matrix(quat.conjugate(turned[:, parent]))
    blocks = inverse_left(off.reshape(-1, 3)).reshape(above.shape) @ above
    used = np.flatnonzero((term.by_joint > 0) & (problem.free > 0))
    by_joint = np.zeros((count, len(used), 3, joints, 3))
    for n, joint in enumerate(used):
        by_joint[:, n, :, joint] = blocks[:, joint]
    weight = np.broadcast_to(np.repeat(term.by_joint[used], 3), (count, 3 * len(used)))
    found = [
        Rows(
            off[:, used].reshape(count, -1), weight, by_joint=by_joint.reshape(count, -1, joints, 3),
            by_shift=np.zeros((count, 3 * len(used), 3)), angular=True, soft=True,
        )
    ]  # fmt: skip
    if term.root_weight > 0 and problem.mover >= 0:
        by_shift = np.broadcast_to(np.eye(3), (count, 3, 3))
        weight = np.full((count, 1), term.root_weight)
        found.append(
            Rows(shift - term.offset, weight, by_joint=np.zeros((count, 3, joints, 3)), by_shift=by_shift, soft=True)
        )
    return found


def evaluate(problem: Problem, rotations: Floats, shift: Floats) -> tuple[Floats, Floats, list[Rows]]:
    """Model rotations, places and all rows."""
    turned, places = forward(problem, rotations, shift)
    return turned, places, [r for t in problem.terms for r in rows_of(problem, t, rotations, shift, turned, places)]


def cost_of(rows: list[Rows], count: int) -> Floats:
    """Half the sum of the weighted squares (N,)."""
    total = np.zeros(count)
    for r in rows:
        total += 0.5 * np.sum((r.weight * r.residual) ** 2, axis=-1)
    return total


def _sizes(rows: list[Rows], count: int) -> Floats:
    """How much is left of everything asked for (N, k): metres, radians; of priors joint by joint."""
    found = [np.zeros((count, 0))]
    for r in rows:
        parts = r.residual.reshape(count, -1, 3) if r.soft else r.residual[:, None]
        found.append(np.linalg.norm(parts, axis=-1))
    return np.concatenate(found, axis=1)


def miss_of(rows: list[Rows], count: int, tolerance_m: float, tolerance_rad: float) -> Floats:
    """The worst of the hard tasks (N,), in tolerances."""
    worst = np.zeros(count)
    for r in rows:
        if not r.soft:
            size = np.linalg.norm(r.residual, axis=-1) / (tolerance_rad if r.angular else tolerance_m)
            worst = np.maximum(worst, np.where(r.weight[:, 0] > 0, size, 0.0))
    return worst


def jacobian(problem: Problem, rows: list[Rows], places: Floats) -> Floats:
    """Rows (N, R, 3J + 3) over the turns of all joints and the root's displacement, weighted."""
    count, joints = places.shape[:2]
    blocks: list[Floats] = []
    for r in rows:
        out = np.zeros((count, r.residual.shape[1], joints + 1, 3))
        if r.by_joint is not None and r.by_shift is not None:
            out[:, :, :joints], out[:, :, joints] = r.by_joint, r.by_shift
        for body, turning, moving in r.parts:
            above = np.flatnonzero(problem.above[:, body])
            arms = places[:, None, body] - places[:, above]
            out[:, :, above] += turning[:, :, None] + np.cross(arms[:, None], moving[:, :, None])
            if problem.mover >= 0 and problem.above[problem.mover, body]:
                out[:, :, joints] += moving
        out *= r.weight[:, :, None, None]
        blocks.append(out.reshape(count, -1, 3 * joints + 3))
    return np.concatenate(blocks, axis=1) if blocks else np.zeros((count, 0, 3 * joints + 3))


def measure(problem: Problem, state: State, tolerance_m: float, tolerance_rad: float) -> None:
    """Cost and miss of where the solves are."""
    rows, count = evaluate(problem, state.rotations, state.shift)[2], len(state.cost)
    state.cost[:], state.miss[:] = cost_of(rows, count), miss_of(rows, count, tolerance_m, tolerance_rad)
    state.done |= state.miss <= 1.0


def step(
    problem: Problem, state: State, tolerance_m: float, tolerance_rad: float, settled: float, still: float
) -> None:
    """One trial step of every solve that is not done; the cost only ever falls."""
    left = np.flatnonzero(~state.done)
    if not len(left):
        return
    part = problem if len(left) == len(state.done) else problem.take(left)
    rotations, shift, old = state.rotations[left], state.shift[left], state.cost[left]
    turned, places, rows = evaluate(part, rotations, shift)
    matrix = jacobian(part, rows, places)
    weighted = np.concatenate([r.weight * r.residual for r in rows] or [np.zeros((len(shift), 0))], axis=1)
    gradient = np.einsum("nrc,nr->nc", matrix, weighted)
    hessian = np.swapaxes(matrix, 1, 2) @ matrix
    hessian += state.curved[left, None, None] * curvature(part, turned, places)
    freedom = freedoms(part, rotations, turned, gradient)
    bend = state.curved[left, None, None]
    hessian += bend * _edges(part, rotations, turned, gradient)
    forced, damping = np.zeros_like(gradient), np.maximum(state.damping[left] * old, part.least_damping)
    change, promised, sound = _damped_step(hessian, gradient, freedom, damping, forced)
    new, moved = apply(part, rotations, shift, turned, change)
    for _ in range(1, PASSES):
        stiffened = stop_at_bounds(part, rotations, turned, gradient, change, new, sound, freedom, forced)
        if stiffened is None:
            break
        hessian += bend * stiffened
        change, promised, sound = _damped_step(hessian, gradient, freedom, damping, forced)
        new, moved = apply(part, rotations, shift, turned, change)
    new_rows = evaluate(part, new, moved)[2]
    cost = cost_of(new_rows, len(shift))
    better, moved_by = sound & (cost < old), change
    taken = left[better]
    state.rotations[taken], state.shift[taken], state.cost[taken] = new[better], moved[better], cost[better]
    state.miss[taken] = miss_of(new_rows, len(shift), tolerance_m, tolerance_rad)[better]
    gain = np.clip((old - cost) / np.maximum(promised, 1e-300), 0.0, 1.0)
    factor = np.where(better, np.maximum(SHRINK, 1.0 - (2.0 * gain - 1.0) ** 3), state.growth[left])
    state.damping[left] = np.clip(state.damping[left] * factor, LEAST_FACTOR, MOST_FACTOR)
    state.growth[left] = np.where(better, GROWTH, 2.0 * state.growth[left])
    state.curved[left] = np.where(better, cost > SLOW * old, sound & (state.curved[left] > 0))
    state.steps[left] += 1
    change = np.abs(_sizes(new_rows, len(shift)) - _sizes(rows, len(shift))).max(axis=1, initial=0.0)
    calm = np.where(change >= still, 0.0, state.calm[left] + (damping <= FIRM * part.least_damping))
    state.calm[left] = np.where(better, calm, state.calm[left])
    small = sound & ((np.max(np.abs(moved_by), axis=1, initial=0.0) < settled) | (np.abs(promised) < ROUNDING * old))
    small |= state.calm[left] >= CALM
    state.done[left] = (state.miss[left] <= 1.0) | small | (state.damping[left] >= MOST_FACTOR)


def curvature(problem: Problem, turned: Floats, places: Floats) -> Floats:
    """What the Hessian (N, C, C) has beyond the squares of the Jacobian, by the forces that tasks pull points with.

    Source: the second derivative of a point by the turns of two joints above it, i above j, is w_i x (w_j x arm of j).
    """
    count, joints = places.shape[:2]
    out = np.zeros((count, joints + 1, 3, joints + 1, 3))
    for term in problem.terms:
        for joint, point, force in _pulls(term, turned, places):
            chain = [int(j) for j in np.flatnonzero(problem.above[:, joint])]
            for low in chain:
                arm = point - places[:, low]
                along = np.sum(arm * force, axis=-1)[:, None, None]
                block = arm[:, :, None] * force[:, None, :] - along * np.eye(3)
                for high in chain:
                    if high < low:
                        out[:, high, :, low] += block
                        out[:, low, :, high] += np.swapaxes(block, 1, 2)
                out[:, low, :, low] += 0.5 * (block + np.swapaxes(block, 1, 2))
    return out.reshape(count, 3 * joints + 3, 3 * joints + 3)


def _pulls(term: Term, turned: Floats, places: Floats) -> list[tuple[int, Floats, Floats]]:
    """The joints whose bodies a task pulls at, where, and with which force, both (N, 3)."""
    joint, other, square = term.joint, term.other, term.weight[:, None] ** 2
    if term.kind is CenterOfMassTask:
        heavy = places + quat.rotate(turned, term.offset)
        miss = (term.masses[:, None] * heavy).sum(axis=1) - term.target
        force = square * np.asarray(term.axis) ** 2 * miss
        return [(int(j), heavy[:, j], term.masses[j] * force) for j in np.flatnonzero(term.masses)]
    if term.kind is RelativeTask:
        if not term.positioned:
            return []
        point = places[:, joint] + quat.rotate(turned[:, joint], term.offset)
        wanted = places[:, other] + quat.rotate(turned[:, other], term.target)
        force = square * (point - wanted)
        return [(joint, point, force), (other, wanted, -force)]
    if term.kind is not PositionTask and term.kind is not ContactTask and term.kind is not LookAtTask:
        return []
    place = places[:, joint]
    point = place + quat.rotate(turned[:, joint], term.offset)
    if term.kind is PositionTask:
        return [(joint, point, square * (point - term.target))]
    if term.kind is ContactTask and term.turn is not None:
        height = np.sum((point - term.target) * term.turn, axis=-1)[:, None]
        on = isinstance(term.task, ContactTask) and term.task.on
        return [(joint, point, square * term.turn * (height if on else np.minimum(height, 0.0)))]
    axis = quat.rotate(turned[:, joint], np.broadcast_to(term.axis, point.shape))
    way = term.target - point
    far = np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-9)
    off, way = axis - way / far, way / far
    return [(joint, place, square * (off - way * np.sum(way * off, axis=-1, keepdims=True)) / far)]


def _damped_step(
    hessian: Floats, gradient: Floats, freedom: Floats, damping: Floats, forced: Floats
) -> tuple[Floats, Floats, Array]:
    """The damped step (N, C) that what is forced is part of, what it promises to gain, and whether it is one at all."""
    pull = (gradient + np.einsum("nab,nb->na", hessian, forced))[:, None]
    system = hessian.copy()
    _project(system, freedom)
    system = np.swapaxes(system, 1, 2).copy()
    _project(system, freedom)
    _project(pull, freedom)
    diagonal = np.arange(system.shape[1])
    system[:, diagonal, diagonal] += damping[:, None]
    change = forced - np.linalg.solve(system, pull[:, 0, :, None])[..., 0]
    promised = -np.sum(gradient * change, axis=-1) - 0.5 * np.einsum("na,nab,nb->n", change, hessian, change)
    return change, promised, np.linalg.eigvalsh(system)[:, 0] > 0


def stop_at_bounds(
    problem: Problem,
    rotations: Floats,
    turned: Floats,
    gradient: Floats,
    change: Floats,
    new: Floats,
    sound: Array,
    freedom: Floats,
    forced: Floats,
) -> Floats | None:
    """Send joints that a step carried over their bounds just there, free along them; what that adds to the Hessian.

    Close to a bound that is curved, where a step came back inside says little of where it went out: such bounds are taken
    as flat and curved as they are where the joint stands. A step that is none tells nothing of bounds. None where no joint is sent anywhere.
    """
    added: Floats | None = None
    for one in problem.limited:
        joint = one.joint
        own = slice(3 * joint, 3 * joint + 3)
        turn = quat.shortest(quat.multiply(new[:, joint], quat.conjugate(rotations[:, joint])))
        went = _from_parent(problem, turned, joint, 2.0 * turn[:, 1:] / np.maximum(turn[:, :1], 1e-6))
        off = np.linalg.norm(went - change[:, own], axis=-1)
        over = np.flatnonzero(sound & (off > 0.1 * np.linalg.norm(went, axis=-1) + 1e-6))
        if not len(over):
            continue
        if added is None:
            added = np.zeros((len(rotations), gradient.shape[1], gradient.shape[1]))
        met, here = (_bounds_of(problem, one, r, turned, over) for r in (new, rotations))
        room = here.room_to(met.sides)
        near = (room <= NEAR).all(axis=1)
        far = over[~near]
        ways = met.directions * (met.sides != FREE)[..., None]
        freedom[far, joint] = _complement(freedom[far, joint], ways[~near])
        forced[far, own] = went[far] - np.einsum("nij,nj->ni", freedom[far, joint], went[far])
        close = over[near]
        for m in range(3):
            ways = here.directions[near, m] * np.where(met.sides[near, m] == LOW, -1.0, 1.0)[:, None]
            ways = _unit(ways * (met.sides[near, m] != FREE)[:, None])
            across, length = _across(freedom[close, joint], ways)
            left = room[near, m] - np.sum(ways * forced[close, own], axis=-1)
            forced[close, own] += across * (left / np.where(length > SAME, length, np.inf))[:, None]
            freedom[close, joint] = _complement(freedom[close, joint], ways[:, None])
        # Hessians have the edges already at which joints stand.
        either = np.where(met.sides == FREE, here.sides, met.sides)[near]
        added[close, own, own] = _edge(problem, one, rotations, turned, gradient, close, either)
        added[close, own, own] -= _edge(problem, one, rotations, turned, gradient, close, here.sides[near])
    return added


def freedoms(problem: Problem, rotations: Floats, turned: Floats, gradient: Floats) -> Floats:
    """What each joint may do now (N, J + 1, 3, 3): the projection onto turns that no bound is in the way of."""
    count, joints = rotations.shape[:2]
    free = np.zeros((count, joints + 1, 3, 3))
    free[:, :joints] = np.eye(3) * problem.free[:, None, None]
    free[:, joints] = np.diag(problem.ways) if problem.mover >= 0 else 0.0
    if problem.upright >= 0:
        free[:, problem.upright] = np.diag([0.0, 1.0, 0.0])
    every = np.arange(count)
    for one in problem.limited:
        here = _bounds_of(problem, one, rotations, turned, every)
        pull = -gradient[:, 3 * one.joint : 3 * one.joint + 3]
        blocked, _ = pulls_of(one.limit, here.directions, here.sides, pull)
        free[:, one.joint] = _complement(free[:, one.joint], here.directions * blocked[..., None])
    return free


def _edges(problem: Problem, rotations: Floats, turned: Floats, gradient: Floats) -> Floats:
    """How joints that are pulled over the edges of their cones stiffen: blocks of the Hessian (N, C, C)."""
    out = np.zeros((len(rotations), gradient.shape[1], gradient.shape[1]))
    every = np.arange(len(rotations))
    for one in problem.limited:
        own = slice(3 * one.joint, 3 * one.joint + 3)
        sides = _bounds_of(problem, one, rotations, turned, every).sides
        out[:, own, own] = _edge(problem, one, rotations, turned, gradient, every, sides)
    return out


def _edge(
    problem: Problem, one: Limited, rotations: Floats, turned: Floats, gradient: Floats, rows: Ints, sides: Ints
) -> Floats:
    """How a joint that is pulled over the edge of its cone stiffens: its block of the Hessian (n, 3, 3).

    A turn along the edge leaves the cone by what the edge is curved, and by half of what the joint turns about its axis
    meanwhile; coming back inside costs as much as it is pulled outwards.
    """
    limit, joint = one.limit, one.joint
    if not isinstance(limit, Cone):
        return np.zeros((len(rows), 3, 3))
    directions = _bounds_of(problem, one, rotations, turned, rows).directions
    normal = directions[:, 1]
    pull = pulls_of(limit, directions, sides, -gradient[rows, 3 * joint : 3 * joint + 3])[1][:, 1, None, None]
    center = np.broadcast_to(np.asarray(limit.center, np.float64), (len(rows), 4))
    turn = quat.multiply(quat.conjugate(quat.multiply(one.home[rows], center)), rotations[rows, joint])
    axis = np.asarray(limit.axis, np.float64) / float(np.linalg.norm(limit.axis))
    axis = quat.rotate(turned[rows, joint], np.broadcast_to(axis, normal.shape))
    along = np.cross(axis, normal)
    mixed = along[:, :, None] * axis[:, None, :]
    bent = edge_of_cone(limit, turn)[:, None, None] * along[:, :, None] * along[:, None, :]
    return pull * (bent - 0.5 * (mixed + np.swapaxes(mixed, 1, 2)))


def _bounds_of(problem: Problem, one: Limited, rotations: Floats, turned: Floats, rows: Ints) -> Bounds:
    """The bounds of a joint of some solves, their directions in the model's space."""
    found = find_bounds(one.limit, rotations[rows, one.joint], one.home[rows])
    return replace(found, directions=_from_parent(problem, turned[rows], one.joint, found.directions))


def _from_parent(problem: Problem, turned: Floats, joint: int, vectors: Floats) -> Floats:
    """Vectors (N, ..., 3) of a joint's parent in the model's space."""
    parent = int(problem.parents[joint])
    if parent < 0:
        return vectors
    above = turned[:, parent]
    return quat.rotate(above if vectors.ndim == 2 else above[:, None], vectors)


def _complement(free: Floats, normals: Floats) -> Floats:
    """The projections (N, 3, 3) less the directions of normals (N, k, 3); zero ones, and ones nearly out already, do not
    count."""
    for normal in np.moveaxis(_unit(normals), 1, 0):
        across, _ = _across(free, normal)
        free = free - across[:, :, None] * across[:, None, :]
    return free


def _across(free: Floats, normal: Floats) -> tuple[Floats, Floats]:
    """The unit directions (N, 3) of normals as far as they are free, 0 where that is hardly at all, and how far (N,)."""
    across = np.einsum("nij,nj->ni", free, normal)
    length = np.linalg.norm(across, axis=-1)
    return np.where(length > SAME, 1.0, 0.0)[:, None] * across / np.maximum(length, 1e-300)[:, None], length


def _unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-9, vectors / np.maximum(length, 1e-300), 0.0)


def _project(matrix: Floats, freedom: Floats) -> None:
    count, rows, columns = matrix.shape
    blocks = matrix.reshape(count, rows, columns // 3, 3)
    blocks[:] = np.einsum("nrji,njik->nrjk", blocks, freedom)


def apply(problem: Problem, rotations: Floats, shift: Floats, turned: Floats, change: Floats) -> tuple[Floats, Floats]:
    """Local rotations and displacement after a step (N, 3J + 3), limits held."""
    new = np.empty_like(rotations)
    for joint, parent in enumerate(problem.parents):
        turn = change[:, 3 * joint : 3 * joint + 3]
        if parent >= 0:
            turn = quat.rotate(quat.conjugate(turned[:, parent]), turn)
        small = np.concatenate([np.ones((len(turn), 1)), 0.5 * turn], axis=1)
        new[:, joint] = quat.normalize(quat.multiply(small, rotations[:, joint]))
    new[:, problem.free == 0] = rotations[:, problem.free == 0]
    hold(problem, new)
    return new, shift + change[:, -3:]


def hold(problem: Problem, rotations: Floats) -> None:
    """Bring every limited joint inside its limit, in place."""
    for one in problem.limited:
        rotations[:, one.joint] = clamp_rotation(one.limit, rotations[:, one.joint], one.home)


def _crossing(arm: Floats) -> Floats:
    """The matrix (N, 3, 3) that a turn w is multiplied by to give w x arm."""
    return -_cross_matrix(arm)


def _cross_matrix(v: Floats) -> Floats:
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    zero = np.zeros_like(x)
    return np.stack(
        [np.stack([zero, -z, y], axis=-1), np.stack([z, zero, -x], axis=-1), np.stack([-y, x, zero], axis=-1)], axis=-2
    )


def turn_between(start: Floats, end: Floats) -> Floats:
    """The rotation vector that leads from one rotation to another, in the space above both; the shorter way."""
    return np.asarray(quat.to_rotation_vector(quat.shortest(quat.multiply(end, quat.conjugate(start)))))


def inverse_left(v: Floats) -> Floats:
    """How a rotation vector (N, 3) follows a small turn from the left: the inverse left Jacobian of SO(3).

    Source: T. Barfoot, "State Estimation for Robotics" (2017), equation 7.77.
    """
    angle = np.linalg.norm(v, axis=-1)
    half = 0.5 * angle
    safe = np.where(half < 1e-4, 1.0, half)
    cotangent = np.where(half < 1e-4, 1.0 - half**2 / 3.0, safe / np.tan(safe))
    axis = v / np.maximum(angle, 1e-300)[..., None]
    outer = axis[..., :, None] * axis[..., None, :]
    eye = np.broadcast_to(np.eye(3), outer.shape)
    return cotangent[..., None, None] * eye + (1.0 - cotangent)[..., None, None] * outer - 0.5 * _cross_matrix(v)
