# pyright: basic
"""Full-body inverse kinematics: damped Newton steps in time linear in joints and tasks, one solve per lane.

A row of the table holds everything of one solve: rotations, offsets, displacement of the root, state, what is left of each
term, and the tasks' data.
Lanes take a step, keep it where the cost fell, and set their damping each for itself. A step allocates nothing.
"""

from __future__ import annotations

from keypose.kernels.fullbodycoupled import follow_coupled, inverses_of, room_of_coupled
from keypose.kernels.fullbodylimits import find_normals, force_to_bound, hold_inside
from keypose.kernels.fullbodystep import eliminate, follow, gather_forces
from keypose.kernels.fullbodytables import (
    BEST,
    BEST_SIDE,
    CALM,
    COST,
    CURVED,
    DAMPING,
    DONE,
    EXTRA,
    FORCED,
    GROWTH,
    INERTIA,
    J_LIMIT,
    JOINT_COLUMNS,
    MISS,
    O_CALM,
    O_FIRM,
    O_FLOOR,
    O_GROWTH,
    O_LEAST,
    O_MOST,
    O_PASSES,
    O_ROUNDING,
    O_SETTLED,
    O_SHRINK,
    O_SLOW,
    O_STILL,
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
from keypose.kernels.rotations import load3, load4, store3, store4
from keypose.kernels.runtime import kernel, scratch_like
from keypose.kernels.vectors import fill, lanes, load, pointer, pointer_alone, store


@kernel
def solve_rows(
    rows, columns, picked, steps, joints, count, mover, ways, terms, term_count, limits, limit_count, numbers, options
):  # fmt: skip
    """Solve some rows of a flat table in place, as many at a time as a vector has lanes, for up to so many steps each."""
    n = lanes(rows)
    memory = scratch_like(rows, (columns + count * SLOTS + EXTRA + room_of_coupled(terms, term_count, count)) * n)
    _solve_blocks(
        rows, columns, picked, steps, joints, count, mover, ways, terms, term_count, limits, limit_count, numbers,
        options, memory, pointer(memory), n,
    )  # fmt: skip


@kernel
def solve_alone(
    rows, columns, picked, steps, joints, count, mover, ways, terms, term_count, limits, limit_count, numbers, options
):  # fmt: skip
    """The same, one row at a time: for fewer rows than a vector has lanes."""
    memory = scratch_like(rows, columns + count * SLOTS + EXTRA + room_of_coupled(terms, term_count, count))
    _solve_blocks(
        rows, columns, picked, steps, joints, count, mover, ways, terms, term_count, limits, limit_count, numbers,
        options, memory, pointer_alone(memory), 1,
    )  # fmt: skip


@kernel
def _solve_blocks(
    rows, columns, picked, steps, joints, count, mover, ways, terms, term_count, limits, limit_count, numbers, options,
    memory, row, n,
):  # fmt: skip
    total, first, state = picked.shape[0], 0, 7 * count + 3
    while first < total:
        for k in range(n):
            at = picked[min(first + k, total - 1)] * columns
            for c in range(columns):
                memory[c * n + k] = rows[at + c]
        solve_block(
            pointer(joints), count, mover, ways, pointer(terms), term_count, pointer(limits), limit_count, numbers,
            options, memory, row, n, steps, columns,
        )  # fmt: skip
        for k in range(min(n, total - first)):
            at = picked[first + k] * columns
            for c in range(4 * count):
                rows[at + c] = memory[c * n + k]
            for c in range(7 * count, state + STATES + term_count):
                rows[at + c] = memory[c * n + k]
        first += n


@kernel
def solve_block(
    joints, count, mover, ways, terms, term_count, limits, limit_count, numbers, options, memory, row, n, steps, columns
):  # fmt: skip
    q, off, shift, state = 0, 4 * count * n, 7 * count * n, (7 * count + 3) * n
    data, work = state + STATES * n, columns * n
    extra = work + count * SLOTS * n
    room = extra + EXTRA * n
    kept = inverses_of(terms, term_count, room, n)
    near, best_shift, move, active = extra, extra + 9 * n, extra + 12 * n, extra + 15 * n
    promised, size, sound, cost = extra + 16 * n, extra + 17 * n, extra + 18 * n, extra + 20 * n
    miss, damping, curving = extra + 21 * n, extra + 22 * n, state + CURVED * n
    live, found = memory[active : active + n], memory[extra + 23 * n : extra + 23 * n + 12]
    per_m, per_rad = 1.0 / options[O_TOLERANCE_M], 1.0 / options[O_TOLERANCE_RAD]
    plain = limit_count > 0  # whether plain sums are kept: for bounds and for curvature
    for k in range(n):
        live[k] = 1.0
        plain = plain or row[curving + k] != 0.0
    for limit in range(limit_count):
        hold_inside(limits, numbers, limit, row, q, data, work, near, n, live)
    forward(joints, count, mover, row, q, off, shift, work, n)
    gather_tasks(
        joints, count, terms, term_count, row, q, shift, work, data, near, cost, miss, n, plain, per_m, per_rad
    )
    for k in range(n):
        row[state + COST * n + k], row[state + MISS * n + k] = row[cost + k], row[miss + k]
        if row[miss + k] <= 1.0:
            row[state + DONE * n + k] = 1.0
    _keep(joints, count, row, q, shift, best_shift, work, n)
    for t in range(term_count * n):
        row[data + t] = row[data + term_count * n + t]
    for _ in range(steps):
        running, curved = False, False
        for k in range(n):
            busy = row[state + DONE * n + k] == 0.0
            live[k] = 1.0 if busy else 0.0
            running = running or busy
            curved = curved or (busy and row[curving + k] != 0.0)
            row[damping + k] = max(row[state + DAMPING * n + k] * row[state + COST * n + k], options[O_FLOOR])
        if not running:
            break
        if plain:
            gather_forces(joints, count, row, work, n)
        for limit in range(limit_count):
            find_normals(joints, limits, numbers, limit, row, q, data, work, n, found)
        if limit_count:
            _force_none(count, row, work, n)
            _copy_sums(count, row, work, n, INERTIA, SAVED)
        forced = False
        for again in range(int(options[O_PASSES])):
            if again:
                _copy_sums(count, row, work, n, SAVED, INERTIA)
            eliminate(
                joints, count, mover, ways, row, work, near, move, kept, n, curved, forced, damping, curving, sound,
                promised,
            )  # fmt: skip
            if kept >= 0:
                follow_coupled(
                    joints, count, mover, terms, term_count, row, work, room, kept, move, sound, promised, n, forced
                )
            follow(
                joints, count, mover, row, q, work, move, active, promised, size, n, curved, forced, damping, curving
            )
            hit = False
            for limit in range(limit_count):
                hit = hold_inside(limits, numbers, limit, row, q, data, work, near, n, live) or hit
            if not hit or again + 1 >= options[O_PASSES]:
                break
            hit = False
            for limit in range(limit_count):
                hit = force_to_bound(joints, limits, numbers, limit, row, q, data, work, n, live, sound, found) or hit
            if not hit:
                break
            forced = True
        mask = load(row, active)
        for k in range(0, 3 * n, n):
            store(row, shift + k, load(row, best_shift + k) + mask * load(row, move + k))
        forward(joints, count, mover, row, q, off, shift, work, n)
        gather_tasks(
            joints, count, terms, term_count, row, q, shift, work, data, near, cost, miss, n, plain, per_m, per_rad
        )
        lost, idle, bends = _judge(
            row, n, state, live, cost, miss, promised, size, sound, damping, data, term_count, options
        )
        if lost or idle:
            _restore(joints, count, row, q, shift, best_shift, work, n, live)
        _keep(joints, count, row, q, shift, best_shift, work, n)
        if lost or (bends and not plain):
            plain = plain or bends
            forward(joints, count, mover, row, q, off, shift, work, n)
            gather_tasks(
                joints, count, terms, term_count, row, q, shift, work, data, near, cost, miss, n, plain, per_m, per_rad
            )


@kernel
def _judge(row, n, state, live, cost, miss, promised, size, sound, damping, left, term_count, options):
    """Take what is better and set the damping; ``live`` becomes 0 where nothing was taken.

    Whether there is such a one, whether any solve was done before, and whether any wants curvature.
    """
    lost, idle, bends = False, False, False
    for k in range(n):
        if live[k] == 0.0:
            idle = True
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
            change = 0.0
            for t in range(left + k, left + k + term_count * n, n):
                after = row[t + term_count * n]
                change = max(change, abs(after - row[t]))
                row[t] = after
            # What moves nothing though hardly damped has come to its end, however far it drifts.
            firm = row[damping + k] > options[O_FIRM] * options[O_FLOOR]
            if change >= options[O_STILL]:
                row[state + CALM * n + k] = 0.0
            elif not firm:
                row[state + CALM * n + k] += 1.0
        else:
            row[d] *= row[g]
            row[g] *= 2.0
            row[v] = row[v] if sane else 0.0
            live[k] = 0.0
            lost = True
        row[d] = min(max(row[d], options[O_LEAST]), options[O_MOST])
        row[state + STEPS * n + k] += 1.0
        calm = row[state + CALM * n + k] >= options[O_CALM]
        still = calm or (
            sane and (row[size + k] < options[O_SETTLED] or abs(row[promised + k]) < options[O_ROUNDING] * old)
        )
        if row[state + MISS * n + k] <= 1.0 or still or row[d] >= options[O_MOST]:
            row[state + DONE * n + k] = 1.0
        elif row[v] != 0.0:
            bends = True
    return lost, idle, bends


@kernel
def _force_none(count, row, work, n):
    zero = fill(row, 0.0)
    for j in range(count):
        store3(row, work + (j * SLOTS + FORCED) * n, n, zero, zero, zero)


@kernel
def _copy_sums(count, row, work, n, start, end):
    for j in range(count):
        w = work + j * SLOTS * n
        for k in range(SUMS):
            store(row, w + (end + k) * n, load(row, w + (start + k) * n))


@kernel
def _keep(joints, count, row, q, shift, best_shift, work, n):
    """What is there becomes the best."""
    for j in range(count):
        w = work + j * SLOTS * n
        a, b, c, d = load4(row, q + 4 * j * n, n)
        store4(row, w + BEST * n, n, a, b, c, d)
        if joints[j * JOINT_COLUMNS + J_LIMIT] >= 0:
            a, b, c = load3(row, w + SIDE * n, n)
            store3(row, w + BEST_SIDE * n, n, a, b, c)
    a, b, c = load3(row, shift, n)
    store3(row, best_shift, n, a, b, c)


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
