# pyright: basic
"""Tasks that tie several bodies together, in the step of the full-body solver: few rows, on top of the tree's equations.

The elimination from the leaves to the root knows what each task does to one body. A task that couples bodies adds U U^T to the
damped equations H of the tree, U its few rows. Their step is that of the tree, with each row pulling as much as it changes:
(I + U^T H^-1 U) y = U^T x, x + H^-1 U y. So the tree answers each row once more, by what its elimination left behind.

Source: W. Hager, "Updating the inverse of a matrix" (1989), equation 2 (Woodbury); E. Haynsworth, "Determination of the inertia of
    a partitioned Hermitian matrix" (1968).
"""

from __future__ import annotations

from keypose.kernels.fullbodystep import negative
from keypose.kernels.fullbodytables import (
    BY_MOVE,
    BY_PULL,
    BY_TURN,
    C_BODIES,
    C_BODY_COUNT,
    C_COUNT,
    C_FIRST,
    C_TERMS,
    COUPLING_COLUMNS,
    FIXED,
    FORCE,
    J_KIND,
    J_PARENT,
    JOINT_COLUMNS,
    MOTION,
    PLACE,
    SLOTS,
    TERM_COLUMNS,
    TORQUE,
    WRENCHES,
)
from keypose.kernels.fullbodytasks import add, add3, cross, first_body
from keypose.kernels.rotations import load3, store3
from keypose.kernels.runtime import inlined, kernel
from keypose.kernels.vectors import absolute, fill, load, store

_ROWS = 3  # of each term
_OF_JOINT = 15  # slots: inverse 6, what is pulled at it 6, what it answers 3


@inlined
def room_of_coupled(terms, term_count, count):
    """How many slots the terms that couple bodies need, after all others."""
    couples = term_count * TERM_COLUMNS
    rows = _ROWS * terms[couples + C_COUNT]
    if rows == 0:
        return 0
    return WRENCHES * terms[couples + C_BODIES] + rows * rows + 2 * rows + _OF_JOINT * count + 9


@inlined
def inverses_of(terms, term_count, room, n):
    """Where the elimination leaves the inverses of joints (six slots each) and of the root; -1 if nobody asks for them."""
    couples = term_count * TERM_COLUMNS
    rows = _ROWS * terms[couples + C_COUNT]
    return room + (WRENCHES * terms[couples + C_BODIES] + rows * rows + 2 * rows) * n if rows else -1


@kernel
def follow_coupled(joints, count, mover, terms, term_count, row, work, room, inverses, move, sound, gain, n, forced):
    """What the terms that couple bodies change of the answers of all joints, of the root's motion and of the promise."""
    couples = term_count * TERM_COLUMNS
    rows = _ROWS * terms[couples + C_COUNT]
    matrix = room + WRENCHES * terms[couples + C_BODIES] * n
    found = matrix + rows * rows * n  # what the tree's own step changes of the rows, and how much they pull
    pulls, pulled = found + rows * n, inverses + (6 * count + 6) * n
    answers = pulled + 6 * count * n
    shift = answers + 3 * count * n
    _move_bodies(joints, count, mover, row, work, work + BY_PULL * n, SLOTS, move, n)
    _project(terms, couples, row, work, room, found, 1, n)
    for k in range(rows):
        _clear(row, pulled, 6 * count, n)
        for other in range(rows):
            store(row, pulls + other * n, fill(row, 1.0 if other == k else 0.0))
        _pull_bodies(terms, couples, row, room, pulls, pulled, n)
        _answer(joints, count, mover, row, work, inverses, pulled, answers, shift, n)
        _move_bodies(joints, count, mover, row, work, answers, 3, shift, n)
        _project(terms, couples, row, work, room, matrix + k * n, rows, n)
    # With the rows all is positive definite just where they have as many negative eigenvalues as the tree.
    below = sound + n
    tree = load(row, below)
    store(row, below, fill(row, 0.0))
    _solve(row, matrix, found, pulls, rows, n, below)
    store(row, sound, 0.5 - absolute(tree - load(row, below)))
    _clear(row, pulled, 6 * count, n)
    _pull_bodies(terms, couples, row, room, pulls, pulled, n)
    _answer(joints, count, mover, row, work, inverses, pulled, answers, shift, n)
    for j in range(count):
        w, out = work + j * SLOTS * n, pulled + 6 * j * n
        x, y, z = load3(row, out, n)
        add3(row, w + FORCE * n, n, x, y, z)
        x, y, z = load3(row, out + 3 * n, n)
        add3(row, w + TORQUE * n, n, x, y, z)
        if joints[j * JOINT_COLUMNS + J_KIND] != FIXED:
            x, y, z = load3(row, answers + 3 * j * n, n)
            add3(row, w + BY_PULL * n, n, x, y, z)
    if mover >= 0:
        x, y, z = load3(row, shift, n)
        add3(row, move, n, x, y, z)
    if not forced:
        for k in range(rows):
            add(row, gain, 0.0 - 0.5 * load(row, found + k * n) * load(row, pulls + k * n))


@inlined
def _clear(row, at, slots, n):
    zero = fill(row, 0.0)
    for k in range(slots):
        store(row, at + k * n, zero)


@kernel
def _pull_bodies(terms, couples, row, room, pulls, pulled, n):
    """All rows pull at their bodies, each as much as said."""
    for c in range(terms[couples + C_COUNT]):
        head = couples + C_TERMS + c * COUPLING_COLUMNS
        bodies = first_body(terms, couples, head)
        for b in range(terms[head + C_BODY_COUNT]):
            at, out = room + WRENCHES * (terms[head + C_FIRST] + b) * n, pulled + 6 * terms[bodies + b] * n
            for k in range(_ROWS):
                size = load(row, pulls + (_ROWS * c + k) * n)
                for m in range(6):
                    add(row, out + m * n, size * load(row, at + (6 * k + m) * n))


@kernel
def _project(terms, couples, row, work, room, out, stride, n):
    """How much the motion of all bodies changes each row."""
    for c in range(terms[couples + C_COUNT]):
        head = couples + C_TERMS + c * COUPLING_COLUMNS
        bodies = first_body(terms, couples, head)
        for k in range(_ROWS):
            total = fill(row, 0.0)
            for b in range(terms[head + C_BODY_COUNT]):
                at = room + (WRENCHES * (terms[head + C_FIRST] + b) + 6 * k) * n
                motion = work + (terms[bodies + b] * SLOTS + MOTION) * n
                for m in range(3):
                    total = total + load(row, at + m * n) * load(row, motion + (3 + m) * n)
                    total = total + load(row, at + (3 + m) * n) * load(row, motion + m * n)
            store(row, out + (_ROWS * c + k) * stride * n, total)


@kernel
def _answer(joints, count, mover, row, work, inverses, pulled, answers, shift, n):
    """From the leaves to the root: what joints and root answer to what is pulled at bodies, and pass on."""
    for back in range(count):
        j = count - 1 - back
        w, p = work + j * SLOTS * n, joints[j * JOINT_COLUMNS + J_PARENT]
        hx, hy, hz = load3(row, pulled + 6 * j * n, n)
        gx, gy, gz = load3(row, pulled + (6 * j + 3) * n, n)
        if joints[j * JOINT_COLUMNS + J_KIND] != FIXED:
            xx, xy, xz = load3(row, inverses + 6 * j * n, n)
            yy, yz, zz = load3(row, inverses + (6 * j + 3) * n, n)
            x, y, z = xx * gx + xy * gy + xz * gz, xy * gx + yy * gy + yz * gz, xz * gx + yz * gy + zz * gz
            store3(row, answers + 3 * j * n, n, x, y, z)
            d0, d1, d2 = load3(row, w + BY_MOVE * n, n)
            d3, d4, d5 = load3(row, w + (BY_MOVE + 3) * n, n)
            d6, d7, d8 = load3(row, w + (BY_MOVE + 6) * n, n)
            hx = hx - (d0 * gx + d3 * gy + d6 * gz)
            hy = hy - (d1 * gx + d4 * gy + d7 * gz)
            hz = hz - (d2 * gx + d5 * gy + d8 * gz)
            a0, a1, a2 = load3(row, w + BY_TURN * n, n)
            a3, a4, a5 = load3(row, w + (BY_TURN + 3) * n, n)
            a6, a7, a8 = load3(row, w + (BY_TURN + 6) * n, n)
            x, y, z = a0 * gx + a3 * gy + a6 * gz, a1 * gx + a4 * gy + a7 * gz, a2 * gx + a5 * gy + a8 * gz
            gx, gy, gz = gx - x, gy - y, gz - z
        if j == mover:
            xx, xy, xz = load3(row, inverses + 6 * count * n, n)
            yy, yz, zz = load3(row, inverses + (6 * count + 3) * n, n)
            x, y, z = xx * hx + xy * hy + xz * hz, xy * hx + yy * hy + yz * hz, xz * hx + yz * hy + zz * hz
            store3(row, shift, n, 0.0 - x, 0.0 - y, 0.0 - z)
        if p >= 0:
            px, py, pz = load3(row, w + PLACE * n, n)
            ux, uy, uz = load3(row, work + (p * SLOTS + PLACE) * n, n)
            x, y, z = cross(px - ux, py - uy, pz - uz, hx, hy, hz)
            add3(row, pulled + 6 * p * n, n, hx, hy, hz)
            add3(row, pulled + (6 * p + 3) * n, n, gx + x, gy + y, gz + z)


@kernel
def _move_bodies(joints, count, mover, row, work, answers, stride, shift, n):
    """From the root to the leaves: the motion of all bodies by what joints and root answer."""
    zero = fill(row, 0.0)
    for j in range(count):
        w, p = work + j * SLOTS * n, joints[j * JOINT_COLUMNS + J_PARENT]
        ox, oy, oz = zero, zero, zero
        vx, vy, vz = zero, zero, zero
        if p >= 0:
            up = work + p * SLOTS * n
            px, py, pz = load3(row, w + PLACE * n, n)
            ux, uy, uz = load3(row, up + PLACE * n, n)
            ox, oy, oz = load3(row, up + MOTION * n, n)
            vx, vy, vz = load3(row, up + (MOTION + 3) * n, n)
            x, y, z = cross(ox, oy, oz, px - ux, py - uy, pz - uz)
            vx, vy, vz = vx + x, vy + y, vz + z
        if j == mover:
            x, y, z = load3(row, shift, n)
            vx, vy, vz = vx + x, vy + y, vz + z
        if joints[j * JOINT_COLUMNS + J_KIND] != FIXED:
            a0, a1, a2 = load3(row, w + BY_TURN * n, n)
            a3, a4, a5 = load3(row, w + (BY_TURN + 3) * n, n)
            a6, a7, a8 = load3(row, w + (BY_TURN + 6) * n, n)
            d0, d1, d2 = load3(row, w + BY_MOVE * n, n)
            d3, d4, d5 = load3(row, w + (BY_MOVE + 3) * n, n)
            d6, d7, d8 = load3(row, w + (BY_MOVE + 6) * n, n)
            x, y, z = load3(row, answers + j * stride * n, n)
            x = x + a0 * ox + a1 * oy + a2 * oz + d0 * vx + d1 * vy + d2 * vz
            y = y + a3 * ox + a4 * oy + a5 * oz + d3 * vx + d4 * vy + d5 * vz
            z = z + a6 * ox + a7 * oy + a8 * oz + d6 * vx + d7 * vy + d8 * vz
            ox, oy, oz = ox - x, oy - y, oz - z
        store3(row, w + MOTION * n, n, ox, oy, oz)
        store3(row, w + (MOTION + 3) * n, n, vx, vy, vz)


@kernel
def _solve(row, matrix, found, out, rows, n, below):
    """(I - matrix) out = found by its factors L D L^T, which take the matrix's place; how many D are negative is added up."""
    for i in range(rows):
        for k in range(i + 1):
            total = fill(row, 1.0 if i == k else 0.0) - load(row, matrix + (i * rows + k) * n)
            for m in range(k):  # above the diagonal stands what is below it times D
                total = total - load(row, matrix + (i * rows + m) * n) * load(row, matrix + (m * rows + k) * n)
            if i == k:
                store(row, matrix + (i * rows + i) * n, total)
                add(row, below, negative(row, total))
            else:
                store(row, matrix + (k * rows + i) * n, total)
                store(row, matrix + (i * rows + k) * n, total / load(row, matrix + (k * rows + k) * n))
    for i in range(rows):
        total = load(row, found + i * n)
        for m in range(i):
            total = total - load(row, matrix + (i * rows + m) * n) * load(row, out + m * n)
        store(row, out + i * n, total)
    for back in range(rows):
        i = rows - 1 - back
        total = load(row, out + i * n) / load(row, matrix + (i * rows + i) * n)
        for m in range(i + 1, rows):
            total = total - load(row, matrix + (m * rows + i) * n) * load(row, out + m * n)
        store(row, out + i * n, total)
