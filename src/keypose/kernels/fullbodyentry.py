# pyright: basic
"""One solve of the full-body solver from a single call: pose and targets in, pose and what is left out.

Numba takes longer to look at a dozen arrays than a solve of a few effectors runs. So everything that stays is behind one
address, and only what differs from call to call is handed over, to machine code whose types are known before.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import carray, types  # pyright: ignore[reportPrivateImportUsage]

from keypose.kernels.fullbody import solve_block
from keypose.kernels.fullbodycoupled import room_of_coupled
from keypose.kernels.fullbodytables import EXTRA, J_PARENT, JOINT_COLUMNS, LIMIT_NUMBERS, OPTIONS, SLOTS, TURN
from keypose.kernels.rotations import quat_rotate
from keypose.kernels.runtime import entry_of, inlined, kernel, scratch_like
from keypose.kernels.vectors import float64_at, int64_at, pointer_alone

# What is behind the address: addresses of tables with their sizes.
(
    TEMPLATE, COLUMNS, STEPS, JOINTS, COUNT, MOVER, WAYS, TERMS, TERM_COUNT, LIMITS, LIMIT_COUNT, NUMBERS, SETTINGS,
    USED, HOMES, HOME_COUNT, FIELDS, FIELD_COUNT, ABOUT,
) = range(19)  # fmt: skip
FIELD_COLUMNS, HOME_COLUMNS = 2, 2  # column and width of a target; joint and column of what is taken from the start

_NUMBERS, _ROWS = types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C")
_GIVEN, _POSE = types.Array(types.float64, 1, "C", readonly=True), types.Array(types.float64, 2, "C", readonly=True)


def entry() -> Any:
    """The machine code of `solve_one`, which trusts the types of what it is given."""
    return entry_of(solve_one, (_GIVEN, _POSE, _POSE, _POSE, _ROWS, _ROWS, _NUMBERS, types.int64))


@inlined
def _unit(a, b, c, d):
    """A quaternion of length 1; numbers that are not finite, and no length, give NaN."""
    length = np.sqrt(a * a + b * b + c * c + d * d)
    factor = 1.0 / length if length >= 1e-9 else np.nan
    return factor * a, factor * b, factor * c, factor * d


@kernel
def solve_one(targets, bones, turns, scales, moved, turned, left, address):
    """Solve from a pose (J, 3), (J, 4), (J, 3) for targets one after another, and whether all of that made sense.

    Written are the pose's translations and rotations, the root's displacement, the state and what is left of each term.
    Numbers that are not finite, quaternions without length and scales are left to those who can say what is wrong.
    """
    about = int64_at(address)
    joints, terms, limits = int64_at(about[JOINTS]), int64_at(about[TERMS]), int64_at(about[LIMITS])
    used, homes, fields = int64_at(about[USED]), int64_at(about[HOMES]), int64_at(about[FIELDS])
    count, columns, template = about[COUNT], about[COLUMNS], float64_at(about[TEMPLATE])
    room = room_of_coupled(terms, about[TERM_COUNT], count)
    memory = scratch_like(left, columns + count * SLOTS + EXTRA + room)
    row = pointer_alone(memory)
    for c in range(columns):
        row[c] = template[c]
    total, scaled = 0.0, False
    for j in range(turns.shape[0]):
        a, b, c, d = _unit(turns[j, 0], turns[j, 1], turns[j, 2], turns[j, 3])
        turned[j, 0], turned[j, 1], turned[j, 2], turned[j, 3] = a, b, c, d
        total += a + b + c + d
        for c in range(3):
            moved[j, c] = bones[j, c]
            total += bones[j, c]
            scaled = scaled or scales[j, c] != 1.0
    for k in range(count):
        j = used[k]
        for c in range(4):
            row[4 * k + c] = turned[j, c]
        for c in range(3):
            row[4 * count + 3 * k + c] = bones[j, c]
    for k in range(0, about[HOME_COUNT] * HOME_COLUMNS, HOME_COLUMNS):
        for c in range(4):
            row[homes[k + 1] + c] = turned[homes[k], c]
    at = 0
    for k in range(0, about[FIELD_COUNT] * FIELD_COLUMNS, FIELD_COLUMNS):
        column, width = fields[k], fields[k + 1]
        for c in range(width):
            row[column + c] = targets[at + c]
        if width == 4:
            a, b, c, d = _unit(row[column], row[column + 1], row[column + 2], row[column + 3])
            row[column], row[column + 1], row[column + 2], row[column + 3] = a, b, c, d
        for c in range(width):
            total += row[column + c]
        at += width
    if scaled or not np.isfinite(total):
        return False
    solve_block(
        joints, count, about[MOVER], about[WAYS], terms, about[TERM_COUNT], limits, about[LIMIT_COUNT],
        carray(float64_at(about[NUMBERS]), about[LIMIT_COUNT] * LIMIT_NUMBERS),
        carray(float64_at(about[SETTINGS]), OPTIONS), memory, row, 1, about[STEPS], columns,
    )  # fmt: skip
    for k in range(count):
        j = used[k]
        for c in range(4):
            turned[j, c] = row[4 * k + c]
    for c in range(left.shape[0]):
        left[c] = row[7 * count + c]
    mover = about[MOVER]
    if mover >= 0:
        x, y, z = row[7 * count], row[7 * count + 1], row[7 * count + 2]
        parent, j = joints[mover * JOINT_COLUMNS + J_PARENT], used[mover]
        if parent >= 0:
            w = columns + parent * SLOTS + TURN
            x, y, z = quat_rotate(row[w], -row[w + 1], -row[w + 2], -row[w + 3], x, y, z)
        moved[j, 0], moved[j, 1], moved[j, 2] = bones[j, 0] + x, bones[j, 1] + y, bones[j, 2] + z
    return True
