# pyright: basic
"""Full-body inverse kinematics: damped Newton steps in time linear in joints and tasks, one solve per lane.

A row of the table holds everything of one solve: rotations, offsets, displacement of the root, state, and the tasks' data.
Lanes take a step, keep it where the cost fell, and set their damping each for itself.
"""

from __future__ import annotations

import numpy as np

from keypose.kernels.fullbodylimits import find_normals, force_to_bound, hold_inside
from keypose.kernels.fullbodystep import eliminate, follow, gather_forces
from keypose.kernels.fullbodytables import (
    BEST,
    BEST_SIDE,
    COST,
    CURVED,
    DAMPING,
    DONE,
    FORCED,
    GROWTH,
    INERTIA,
    J_LIMIT,
    JOINT_COLUMNS,
    KEEP,
    MISS,
    O_FLOOR,
    O_GROWTH,
    O_LEAST,
    O_MOST,
    O_PASSES,
    O_ROUNDING,
    O_SETTLED,
    O_SHRINK,
    O_SLOW,
    O_TOLERANCE_M,
    O_TOLERANCE_RAD,
    SAVED,
    SIDE,
    SLOTS,
    STATES,
    STEPS,
    SUMS,
)
from keypose.kernels.fullbodytasks import forward, gather_tasks
from keypose.kernels.rotations import store3
from keypose.kernels.runtime import kernel, scratch_like
from keypose.kernels.vectors import fill, lanes, load, pointer, store


@kernel
def solve_rows(
    rows, columns, picked, steps, joints, count, mover, ways, terms, term_count, limits, limit_count, numbers, options
):  # fmt: skip
    """Solve some rows of a table in place, lanes at a time, for up to so many steps each.

    A row: rotations 4 of each joint, offsets 3 of each, displacement 3, state, data.
    """
    n = lanes(rows)
    cells = (columns + count * SLOTS + 40) * n
    memory = scratch_like(rows, cells)
    row, flat = pointer(memory), pointer(rows)
    total = picked.shape[0]
    q, off, shift = 0, 4 * count * n, 7 * count * n
    state = (7 * count + 3) * n
    data = state + STATES * n
    work = columns * n
    extra = work + count * SLOTS * n
    near, best_shift, move = extra, extra + 9 * n, extra + 12 * n
    active, promised, size, sound = extra + 15 * n, extra + 16 * n, extra + 17 * n, extra + 18 * n
    cost, miss, damping = extra + 19 * n, extra + 20 * n, extra + 21 * n
    first = np.int64(0)
    jt, tt = pointer(joints), pointer(terms)
    lt = pointer(limits)
    while first < total:
        for k in range(n):
            at = picked[min(first + k, total - 1)] * columns
            for c in range(columns):
                row[c * n + k] = flat[at + c]
        _solve_block(
            jt, count, mover, ways, tt, term_count, lt, limit_count, numbers, options, memory, row, n, steps, q, off,
            shift, state, data, work, near, best_shift, move, active, promised, size, sound, cost, miss, damping,
        )  # fmt: skip
        for k in range(min(n, total - first)):
            at = picked[first + k] * columns
            for c in range(4 * count):
                flat[at + c] = row[c * n + k]
            for c in range(7 * count, 7 * count + 3 + STATES):
                flat[at + c] = row[c * n + k]
        first += n


@kernel
def _solve_block(
    joints, count, mover, ways, terms, term_count, limits, limit_count, numbers, options, memory, row, n, steps, q, off,
    shift, state, data, work, near, best_shift, move, active, promised, size, sound, cost, miss, damping,
):  # fmt: skip
    per_m, per_rad = 1.0 / options[O_TOLERANCE_M], 1.0 / options[O_TOLERANCE_RAD]
    live = memory[active : active + n]
    live[:] = 1.0
    for limit in range(limit_count):
        hold_inside(limits, numbers, limit, row, q, data, work, near, n, live)
    forward(joints, count, mover, row, q, off, shift, work, n)
    armed = False
    for k in range(n):
        armed = armed or row[state + CURVED * n + k] != 0.0
    gather_tasks(
        joints, count, terms, term_count, row, q, shift, work, data, near, cost, miss, n, armed, per_m, per_rad
    )
    for k in range(n):
        row[state + COST * n + k], row[state + MISS * n + k] = row[cost + k], row[miss + k]
        if row[miss + k] <= 1.0:
            row[state + DONE * n + k] = 1.0
    _keep(joints, count, row, q, shift, best_shift, work, n, live)
    for _ in range(steps):
        running, curved = False, False
        for k in range(n):
            busy = row[state + DONE * n + k] == 0.0
            live[k] = 1.0 if busy else 0.0
            running = running or busy
            curved = curved or (busy and row[state + CURVED * n + k] != 0.0)
            row[damping + k] = max(row[state + DAMPING * n + k] * row[state + COST * n + k], options[O_FLOOR])
        if not running:
            break
        gather_forces(joints, count, row, work, n, curved)
        for limit in range(limit_count):
            find_normals(joints, limits, numbers, limit, row, q, data, work, n)
        if limit_count:
            _force_none(count, row, work, n)
            _copy_sums(count, row, work, n, INERTIA, SAVED)
        forced = False
        for again in range(2):
            if again:
                _copy_sums(count, row, work, n, SAVED, INERTIA)
            eliminate(
                joints, count, mover, ways, row, work, near, move, n, curved, forced, damping,
                state + CURVED * n, sound,
            )  # fmt: skip
            follow(
                joints, count, mover, row, q, work, move, active, promised, size, n, curved, forced, damping,
                state + CURVED * n,
            )  # fmt: skip
            hit = False
            for limit in range(limit_count):
                hit = hold_inside(limits, numbers, limit, row, q, data, work, near, n, live) or hit
            if not hit or again + 1 >= options[O_PASSES]:
                break
            hit = False
            for limit in range(limit_count):
                hit = force_to_bound(joints, limits, limit, row, q, work, n, live) or hit
            if not hit:
                break
            forced = True
        mask = load(row, active)
        for k in range(3):
            store(row, shift + k * n, load(row, best_shift + k * n) + mask * load(row, move + k * n))
        forward(joints, count, mover, row, q, off, shift, work, n)
        gather_tasks(
            joints, count, terms, term_count, row, q, shift, work, data, near, cost, miss, n, armed, per_m, per_rad
        )  # fmt: skip
        lost, bends = _judge(row, n, state, live, cost, miss, promised, size, sound, options)
        if lost:
            _restore(joints, count, row, q, shift, best_shift, work, n, live)
        _keep(joints, count, row, q, shift, best_shift, work, n, live)
        if lost or (bends and not armed):
            armed = armed or bends
            forward(joints, count, mover, row, q, off, shift, work, n)
            gather_tasks(
                joints, count, terms, term_count, row, q, shift, work, data, near, cost, miss, n, armed, per_m, per_rad
            )  # fmt: skip


@kernel
def _judge(row, n, state, live, cost, miss, promised, size, sound, options):
    """Take what is better and set the damping; ``live`` becomes 1 where a step was taken. Whether one was not, and whether
    any wants curvature."""
    lost, bends = False, False
    for k in range(n):
        if live[k] == 0.0:
            lost = True
            continue
        d, g = state + DAMPING * n + k, state + GROWTH * n + k
        c, v = state + COST * n + k, state + CURVED * n + k
        old, new, sane = row[c], row[cost + k], row[sound + k] > 0.0
        if sane and new < old:
            gain = min(max((old - new) / max(row[promised + k], 1e-300), 0.0), 1.0)
            odd = 2.0 * gain - 1.0
            row[d] *= max(options[O_SHRINK], 1.0 - odd * odd * odd)
            row[g] = options[O_GROWTH]
            row[v] = 1.0 if new > options[O_SLOW] * old else 0.0
            row[c], row[state + MISS * n + k] = new, row[miss + k]
        else:
            row[d] *= row[g]
            row[g] *= 2.0
            row[v] = row[v] if sane else 0.0
            live[k] = 0.0
            lost = True
        row[d] = min(max(row[d], options[O_LEAST]), options[O_MOST])
        row[state + STEPS * n + k] += 1.0
        still = sane and (row[size + k] < options[O_SETTLED] or row[promised + k] < options[O_ROUNDING] * old)
        if row[state + MISS * n + k] <= 1.0 or still or row[d] >= options[O_MOST]:
            row[state + DONE * n + k] = 1.0
        bends = bends or row[v] != 0.0
    return lost, bends


@kernel
def _force_none(count, row, work, n):
    one, zero = fill(row, 1.0), fill(row, 0.0)
    for j in range(count):
        w = work + j * SLOTS * n
        store(row, w + KEEP * n, one)
        store3(row, w + FORCED * n, n, zero, zero, zero)


@kernel
def _copy_sums(count, row, work, n, start, end):
    for j in range(count):
        w = work + j * SLOTS * n
        for k in range(SUMS):
            store(row, w + (end + k) * n, load(row, w + (start + k) * n))


@kernel
def _keep(joints, count, row, q, shift, best_shift, work, n, live):
    """What was taken becomes the best."""
    for j in range(count):
        w = work + j * SLOTS * n
        for k in range(4):
            store(row, w + (BEST + k) * n, load(row, q + (4 * j + k) * n))
        if joints[j * JOINT_COLUMNS + J_LIMIT] >= 0:
            for k in range(3):
                store(row, w + (BEST_SIDE + k) * n, load(row, w + (SIDE + k) * n))
    for k in range(3):
        store(row, best_shift + k * n, load(row, shift + k * n))


@kernel
def _restore(joints, count, row, q, shift, best_shift, work, n, live):
    """Where nothing was taken, the best comes back."""
    for k in range(n):
        if live[k] != 0.0:
            continue
        for j in range(count):
            w = work + j * SLOTS * n + k
            for c in range(4):
                row[q + (4 * j + c) * n + k] = row[w + (BEST + c) * n]
            if joints[j * JOINT_COLUMNS + J_LIMIT] >= 0:
                for c in range(3):
                    row[w + (SIDE + c) * n] = row[w + (BEST_SIDE + c) * n]
        for c in range(3):
            row[shift + c * n + k] = row[best_shift + c * n + k]
