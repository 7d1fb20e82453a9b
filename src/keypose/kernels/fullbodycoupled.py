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
_OF_ROW = 9  # slots of a row for each joint: the force and moment that are pulled with, and what the joint answers


@inlined
def room_of_coupled(terms, term_count, count):
    """How many slots the terms that couple bodies need, after all others."""
    couples = term_count * TERM_COLUMNS
    rows = _ROWS * terms[couples + C_COUNT]
    if rows == 0:
        return 0
    return WRENCHES * terms[couples + C_BODIES] + 6 * count + 6 + rows * (rows + 2 + _OF_ROW * count + 6)


@inlined
def inverses_of(terms, term_count, room, n):
    """Where the elimination leaves the inverses of joints (six slots each) and of the root; -1 if nobody asks for them."""
    couples = term_count * TERM_COLUMNS
    return room + WRENCHES * terms[couples + C_BODIES] * n if terms[couples + C_COUNT] else -1


@kernel
def follow_coupled(joints, count, mover, terms, term_count, row, work, room, inverses, move, sound, gain, n, forced):
    """What the terms that couple bodies change of the answers of all joints, of the root's motion and of the promise."""
    couples = term_count * TERM_COLUMNS
    rows = _ROWS * terms[couples + C_COUNT]
    matrix = inverses + (6 * count + 6) * n
    found = matrix + rows * rows * n  # what the tree's own step changes of the rows, and how much they pull
    pulls = found + rows * n
    pulled = pulls + rows * n
    shifts = pulled + rows * count * _OF_ROW * n
    _pull_bodies(terms, couples, row, room, pulled, count, n)
    for k in range(rows):
        _answer(joints, count, mover, row, work, inverses, pulled + k * count * _OF_ROW * n, shifts + 6 * k * n, n)
    # A step is what joints do of themselves, which moves the rows by what these pull at the joints: nothing has to be moved.
    for k in range(rows):
        pull = pulled + k * count * _OF_ROW * n
        total = fill(row, 0.0)
        for j in range(count):
            if joints[j * JOINT_COLUMNS + J_KIND] != FIXED:
                total = total - _product(row, pull + (j * _OF_ROW + 3) * n, work + (j * SLOTS + BY_PULL) * n, n)
        if mover >= 0:
            total = total + _product(row, shifts + 6 * k * n, move, n)
        store(row, found + k * n, total)
        for other in range(k + 1):
            answer = pulled + other * count * _OF_ROW * n
            total = fill(row, 0.0)
            for j in range(count):
                if joints[j * JOINT_COLUMNS + J_KIND] != FIXED:
                    total = total + _product(row, pull + (j * _OF_ROW + 3) * n, answer + (j * _OF_ROW + 6) * n, n)
            if mover >= 0:
                total = total + _product(row, shifts + 6 * k * n, shifts + (6 * other + 3) * n, n)
            store(row, matrix + (k * rows + other) * n, total)
    # With the rows all is positive definite just where they have as many negative eigenvalues as the tree.
    below = sound + n
    tree = load(row, below)
    store(row, below, fill(row, 0.0))
    _solve(row, matrix, found, pulls, rows, n, below)
    store(row, sound, 0.5 - absolute(tree - load(row, below)))
    for k in range(rows):
        size = load(row, pulls + k * n)
        for j in range(count):
            w, out = work + j * SLOTS * n, pulled + (k * count + j) * _OF_ROW * n
            _add_scaled(row, w + FORCE * n, out, size, n)
            _add_scaled(row, w + TORQUE * n, out + 3 * n, size, n)
            if joints[j * JOINT_COLUMNS + J_KIND] != FIXED:
                _add_scaled(row, w + BY_PULL * n, out + 6 * n, size, n)
        if mover >= 0:
            _add_scaled(row, move, shifts + (6 * k + 3) * n, 0.0 - size, n)
        if not forced:
            add(row, gain, 0.0 - 0.5 * load(row, found + k * n) * size)


@inlined
def _product(row, a, b, n):
    x, y, z = load3(row, a, n)
    u, v, w = load3(row, b, n)
    return x * u + y * v + z * w


@inlined
def _add_scaled(row, out, at, size, n):
    x, y, z = load3(row, at, n)
    add3(row, out, n, size * x, size * y, size * z)


@kernel
def _pull_bodies(terms, couples, row, room, pulled, count, n):
    """What each row pulls at each body."""
    zero = fill(row, 0.0)
    for c in range(terms[couples + C_COUNT]):
        head = couples + C_TERMS + c * COUPLING_COLUMNS
        bodies = first_body(terms, couples, head)
        for k in range(_ROWS):
            out = pulled + (_ROWS * c + k) * count * _OF_ROW * n
            for j in range(count):
                for m in range(6):
                    store(row, out + (j * _OF_ROW + m) * n, zero)
            for b in range(terms[head + C_BODY_COUNT]):
                at = room + (WRENCHES * (terms[head + C_FIRST] + b) + 6 * k) * n
                for m in range(6):
                    add(row, out + (terms[bodies + b] * _OF_ROW + m) * n, load(row, at + m * n))


@kernel
def _answer(joints, count, mover, row, work, inverses, pulled, shift, n):
    """From the leaves to the root: what joints and root answer to what is pulled at bodies, and pass on."""
    for back in range(count):
        j = count - 1 - back
        w, p, own = work + j * SLOTS * n, joints[j * JOINT_COLUMNS + J_PARENT], pulled + j * _OF_ROW * n
        hx, hy, hz = load3(row, own, n)
        gx, gy, gz = load3(row, own + 3 * n, n)
        if joints[j * JOINT_COLUMNS + J_KIND] != FIXED:
            xx, xy, xz = load3(row, inverses + 6 * j * n, n)
            yy, yz, zz = load3(row, inverses + (6 * j + 3) * n, n)
            x, y, z = xx * gx + xy * gy + xz * gz, xy * gx + yy * gy + yz * gz, xz * gx + yz * gy + zz * gz
            store3(row, own + 6 * n, n, x, y, z)
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
            store3(row, shift, n, hx, hy, hz)
            store3(row, shift + 3 * n, n, x, y, z)
        if p >= 0:
            px, py, pz = load3(row, w + PLACE * n, n)
            ux, uy, uz = load3(row, work + (p * SLOTS + PLACE) * n, n)
            x, y, z = cross(px - ux, py - uy, pz - uz, hx, hy, hz)
            add3(row, pulled + p * _OF_ROW * n, n, hx, hy, hz)
            add3(row, pulled + (p * _OF_ROW + 3) * n, n, gx + x, gy + y, gz + z)


@kernel
def _solve(row, matrix, found, out, rows, n, below):
    """(I + matrix) out = found by its factors L D L^T, which take the matrix's place; how many D are negative is added up."""
    for i in range(rows):
        for k in range(i + 1):
            total = fill(row, 1.0 if i == k else 0.0) + load(row, matrix + (i * rows + k) * n)
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
