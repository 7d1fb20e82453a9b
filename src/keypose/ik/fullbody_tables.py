"""Full-body problems as the tables that the compiled solver reads, and its way through them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Array, Floats, Ints
from keypose.ik import fullbody_dense as dense
from keypose.ik.fullbody_dense import State
from keypose.ik.fullbody_problem import Limited, Problem, Term
from keypose.ik.limits import Cone, EulerRange, Hinge, swing_axes
from keypose.ik.tasks import (
    CenterOfMassTask,
    ContactTask,
    LookAtTask,
    OrientationTask,
    PosePrior,
    PositionTask,
    RelativeTask,
    Smoothness,
)
from keypose.kernels import fullbodytables as columns
from keypose.math import quat

_FEW_STEPS = 8  # after which solves that are done make room for others
_ALONE = 2  # up to so many are solved one by one


def is_compiled(problem: Problem) -> bool:
    """Whether the compiled solver knows everything that is asked for."""
    return not any(isinstance(o.limit, EulerRange) and o.limit.order[0] == o.limit.order[2] for o in problem.limited)


def solve_compiled(
    problem: Problem,
    state: State,
    kernels: Any,
    steps: int,
    tolerance_m: float,
    tolerance_rad: float,
    settled: float,
    still: float,
) -> None:
    """Bring all solves to their end, or as far as so many steps go; the state is changed in place."""
    tables = make_tables(problem, tolerance_m, tolerance_rad, settled, still)
    tables.write(state)
    run_rows(kernels, tables, tables.rows, np.flatnonzero(~state.done), steps)
    tables.read(state)


def run_rows(kernels: Any, tables: Tables, rows: Floats, left: Ints, steps: int) -> None:
    """Take the solves of some rows as far as so many steps go; rows that are done make room for others."""
    done, taken, few = tables.state[columns.DONE], 0, _FEW_STEPS
    flat, width = rows.reshape(-1), rows.shape[1]
    if len(left) <= _ALONE:
        kernels.solve_alone(flat, width, left, steps, *tables.arguments)
        return
    while len(left) and taken < steps:
        few = min(few, steps - taken)
        kernels.solve_rows(flat, width, left, few, *tables.arguments)
        taken += few
        few *= 2
        left = left[rows[left, done] == 0.0]


@dataclass(frozen=True, slots=True)
class Tables:
    """``rows`` (N, columns) of everything a solve has of its own, which ``joints`` they hold, and what all share.

    ``terms``: the term of each entry in the table, and where its data begin; ``homes``: joints of limits and where they
    count from; ``entries``: the first column of what is left of each entry.
    """

    joints: Ints
    rows: Floats
    state: dict[int, int]
    arguments: tuple[Any, ...]
    names: tuple[tuple[int, str], ...]
    terms: tuple[tuple[int, int], ...]
    homes: tuple[tuple[int, int], ...]
    entries: int

    def write(self, state: State) -> None:
        """Put where the solves are into the rows."""
        count = len(self.joints)
        self.rows[:, : 4 * count] = state.rotations[:, self.joints].reshape(len(self.rows), -1)
        self.rows[:, 7 * count : 7 * count + 3] = state.shift
        for column, name in self.names:
            self.rows[:, self.state[column]] = getattr(state, name)

    def read(self, state: State) -> None:
        """Take where the solves are from the rows."""
        count = len(self.joints)
        state.rotations[:, self.joints] = self.rows[:, : 4 * count].reshape(len(self.rows), count, 4)
        state.shift[:] = self.rows[:, 7 * count : 7 * count + 3]
        for column, name in self.names:
            getattr(state, name)[:] = self.rows[:, self.state[column]]


def make_tables(problem: Problem, tolerance_m: float, tolerance_rad: float, settled: float, still: float) -> Tables:
    """The tables of a problem that `is_compiled`."""
    count, parents = len(problem.start), problem.parents
    used = _used(problem)
    place = np.full(len(parents), -1)
    place[used] = np.arange(len(used))
    joints = np.zeros((len(used), columns.JOINT_COLUMNS), np.int64)
    joints[:, columns.J_PARENT] = [place[p] if p >= 0 else -1 for p in parents[used]]
    joints[:, columns.J_KIND] = np.where((problem.free > 0)[used] & ~_idle(problem)[used], columns.FREE, columns.FIXED)
    joints[:, columns.J_LIMIT] = -1
    if problem.upright >= 0:
        joints[place[problem.upright], columns.J_KIND] = columns.UPRIGHT
    entries = [(n, *entry) for n, term in enumerate(problem.terms) for entry in _entries(problem, term)]
    writer = _Writer(count)
    writer.add(np.zeros((count, 2 * len(entries))))  # what is left of each, at the best pose and at the last
    terms: list[Ints] = []
    for _, kind, joint, option, values in entries:
        terms.append(np.array([kind, place[joint], writer.width, option], np.int64))
        writer.add(*values)
        if kind == columns.PRIOR:
            joints[place[joint], columns.J_PRIOR] = 1
    coupled = _coupled([(n, place[_bodies(problem.terms[entry[0]], entry[1])]) for n, entry in enumerate(entries)])
    limits: list[list[int]] = []
    homes: list[tuple[int, int]] = []
    numbers: list[Floats] = []
    for one in problem.limited:
        if place[one.joint] >= 0:
            joints[place[one.joint], columns.J_LIMIT] = len(limits)
            kind, home, axes, table = _limit_entry(one)
            limits.append([kind, int(place[one.joint]), writer.width, *axes])
            homes.append((one.joint, writer.width))
            writer.add(home)
            numbers.append(table)
    options = np.zeros(columns.OPTIONS)
    for column, value in (
        (columns.O_TOLERANCE_M, tolerance_m), (columns.O_TOLERANCE_RAD, tolerance_rad), (columns.O_SETTLED, settled),
        (columns.O_SHRINK, dense.SHRINK), (columns.O_GROWTH, dense.GROWTH), (columns.O_LEAST, dense.LEAST_FACTOR),
        (columns.O_MOST, dense.MOST_FACTOR), (columns.O_FLOOR, problem.least_damping), (columns.O_SLOW, dense.SLOW),
        (columns.O_ROUNDING, dense.ROUNDING), (columns.O_PASSES, dense.PASSES),
        (columns.O_STILL, still), (columns.O_CALM, dense.CALM), (columns.O_FIRM, dense.FIRM),
    ):  # fmt: skip
        options[column] = value
    size = len(used)
    start = 7 * size + 3
    rows = np.zeros((count, start + columns.STATES + writer.width))
    rows[:, 4 * size : 7 * size] = problem.offsets[:, used].reshape(count, -1)
    if writer.columns:
        rows[:, start + columns.STATES :] = np.concatenate(writer.columns, axis=1)
    arguments = (
        joints.ravel(), size, int(place[problem.mover]) if problem.mover >= 0 else -1,
        sum(1 << n for n in range(3) if problem.ways[n]), np.concatenate([*terms, coupled]), len(terms),
        np.array(limits, np.int64).ravel(), len(limits), np.array(numbers, np.float64).ravel(), options,
    )  # fmt: skip
    names = (
        (columns.DAMPING, "damping"), (columns.GROWTH, "growth"), (columns.COST, "cost"), (columns.MISS, "miss"),
        (columns.DONE, "done"), (columns.CURVED, "curved"), (columns.CALM, "calm"), (columns.STEPS, "steps"),
    )  # fmt: skip
    first = start + columns.STATES
    return Tables(
        used, rows, {column: start + column for column, _ in names}, arguments, names,
        tuple((entry[0], first + term[2]) for entry, term in zip(entries, terms, strict=True)),
        tuple((joint, first + at) for joint, at in homes), first,
    )  # fmt: skip


def _used(problem: Problem) -> Ints:
    """The joints that tasks depend on; nothing else is even looked at."""
    needed = np.zeros(len(problem.parents), bool)
    for term in problem.terms:
        if term.kind is PosePrior or term.kind is Smoothness:
            needed |= (term.by_joint > 0) & (problem.free > 0)
        elif term.kind is CenterOfMassTask:
            needed |= term.masses > 0
        else:
            needed[term.joint] = True
            if term.other >= 0:
                needed[term.other] = True
    if problem.mover >= 0:
        needed[problem.mover] = True
    return np.flatnonzero(problem.above[:, needed].any(axis=1))


def _idle(problem: Problem) -> Array:
    """Joints (J,) whose turn changes nothing: the places of the last joints of limbs are all that is asked of them."""
    moved = np.zeros(len(problem.parents), bool)
    for term in problem.terms:
        if term.kind is PosePrior or term.kind is Smoothness:
            moved |= term.by_joint > 0
            continue
        if term.kind is CenterOfMassTask:
            heavy = term.masses > 0
            moved |= problem.above[:, heavy].any(axis=1) if np.any(term.offset) else _over(problem, heavy)
            continue
        if term.other >= 0:
            moved |= problem.above[:, term.other]
        above = problem.above[:, term.joint].copy()
        if term.kind is PositionTask and not np.any(term.offset):
            above[term.joint] = False
        moved |= above
    for one in problem.limited:
        moved[one.joint] = True  # it may have to come inside
    return ~moved


def _over(problem: Problem, joints: Array) -> Array:
    """Joints that stand above some of these."""
    others = problem.above & ~np.eye(len(joints), dtype=bool)
    return others[:, joints].any(axis=1)


def _bodies(term: Term, kind: int) -> Ints:
    """The joints of an entry that couples several."""
    if kind == columns.CENTER:
        return np.flatnonzero(term.masses)
    return np.array(
        [term.joint, term.other] if kind in (columns.RELATIVE_PLACE, columns.RELATIVE_TURN) else [], np.int64
    )


def _coupled(bodies: list[tuple[int, Ints]]) -> Ints:
    """What follows the terms in their table: which couple which bodies."""
    bodies = [(term, places) for term, places in bodies if len(places)]
    counts = [len(places) for _, places in bodies]
    heads = [(term, len(places), sum(counts[:n])) for n, (term, places) in enumerate(bodies)]
    parts = [
        np.array([len(bodies), sum(counts)]),
        *(np.array(head) for head in heads),
        *(places for _, places in bodies),
    ]
    return np.concatenate(parts).astype(np.int64)


class _Writer:
    def __init__(self, count: int) -> None:
        self.count, self.width = count, 0
        self.columns: list[Floats] = []

    def add(self, *arrays: Floats) -> None:
        for values in arrays:
            self.columns.append(values.reshape(self.count, -1))
            self.width += self.columns[-1].shape[1]


def _entries(problem: Problem, term: Term) -> list[tuple[int, int, int, tuple[Floats, ...]]]:
    """Kind, joint, option and data of a term's entries in the table."""
    count = len(problem.start)
    if term.kind is PositionTask:
        pointed = int(bool(np.any(term.offset)))
        return [(columns.POSITION, term.joint, pointed, (term.target, term.weight, term.offset))]
    if term.kind is OrientationTask:
        return [(columns.ORIENTATION, term.joint, 0, (term.target, term.weight))]
    if term.kind is LookAtTask:
        axis = np.broadcast_to(term.axis, (count, 3))
        return [(columns.LOOK_AT, term.joint, 0, (term.target, term.weight, term.offset, axis))]
    if term.kind is ContactTask and term.turn is not None:
        on = int(isinstance(term.task, ContactTask) and term.task.on)
        return [(columns.CONTACT, term.joint, on, (term.target, term.turn, term.weight, term.offset))]
    found: list[tuple[int, int, int, tuple[Floats, ...]]] = []
    if term.kind is RelativeTask:
        if term.positioned:
            found.append((columns.RELATIVE_PLACE, term.joint, 0, (term.target, term.weight, term.offset)))
        if term.turn is not None:
            found.append((columns.RELATIVE_TURN, term.joint, 0, (term.turn, term.turn_weight)))
        return found
    if term.kind is CenterOfMassTask:
        heavy = np.flatnonzero(term.masses)
        masses = np.broadcast_to(term.masses[heavy, None], (count, len(heavy), 1))
        points = np.concatenate([np.broadcast_to(term.offset[..., heavy, :], (count, len(heavy), 3)), masses], axis=-1)
        axes = np.broadcast_to(term.axis, (count, 3))
        return [(columns.CENTER, int(heavy[0]), 0, (term.target, term.weight, axes, points))]
    for joint in np.flatnonzero((term.by_joint > 0) & (problem.free > 0)):
        weight = np.full(count, term.by_joint[joint])
        found.append((columns.PRIOR, int(joint), 0, (term.target[:, joint], weight)))
    if term.root_weight > 0 and problem.mover >= 0:
        found.append((columns.ROOT_PRIOR, problem.mover, 0, (term.offset, np.full(count, term.root_weight))))
    return found


def _limit_entry(one: Limited) -> tuple[int, Floats, tuple[int, ...], Floats]:
    """Kind, home (N, 4), axes and numbers of a limit in the table."""
    table, limit = np.zeros(columns.LIMIT_NUMBERS), one.limit
    match limit:
        case Hinge(axis=axis):
            table[:3] = np.asarray(axis) / float(np.linalg.norm(axis))
            table[3:5] = limit.low_rad, limit.high_rad
            return columns.HINGE, one.home, (0, 0, 0), table
        case EulerRange(order=order):
            lows, highs = list(limit.low_rad), list(limit.high_rad)
            if order.islower():
                order, lows, highs = order.upper()[::-1], lows[::-1], highs[::-1]
            table[:6] = np.stack([lows, highs], axis=1).ravel()
            return columns.ANGLES, one.home, tuple("XYZ".index(letter) for letter in order), table
        case Cone(axis=axis):
            home = quat.multiply(one.home, np.broadcast_to(np.asarray(limit.center), one.home.shape))
            low, high = limit.twist_low_rad, limit.twist_high_rad
            table[:3] = np.asarray(axis) / float(np.linalg.norm(axis))
            table[3:6], table[6:9] = swing_axes(limit)
            table[9:11], table[11:13] = limit.swings, (low, high)
            # What is inside for sure: less swing than the lesser radius, less twist than either way.
            table[13] = np.cos(0.5 * max(min(limit.swings) - 1e-6, 0.0)) ** 2
            whole = high - low >= 2.0 * np.pi - 1e-12
            table[14] = 1e300 if whole else np.tan(0.5 * max(min(-low, high, np.pi - 1e-6) - 1e-6, 0.0))
            return columns.CONE, home, (0, 0, 0), table
