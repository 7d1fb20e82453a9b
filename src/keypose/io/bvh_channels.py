"""BVH channels: numbers in channel order to poses, and back.

A joint's channels are position and rotation channels in any order and number. Its rotation is the product of its
rotation channels from left to right (``Zrotation Yrotation Xrotation`` is Rz Ry Rx); angles are degrees.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from keypose.arrays import Floats, Ints
from keypose.math import euler, quat

Positions = Literal["replace", "add"]
Flags = NDArray[np.bool_]

_SMALL_TURNS = 7_000  # joints times frames below which the compiled kernels are not worth loading


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the channels of J joints are found in a frame of C numbers.

    Shapes and units:
        orders: per joint the three axes of its rotation ("ZYX"); axes without a channel stand last.
        rotation_columns: (J, 3), in that order; C where there is no channel.
        position_columns: (J, 3), X Y Z; C where there is no channel.
        column_count: C.
    """

    orders: tuple[str, ...]
    rotation_columns: Ints
    position_columns: Ints
    column_count: int

    @property
    def moving(self) -> Ints:
        """The joints that have position channels."""
        return np.nonzero((self.position_columns < self.column_count).any(axis=1))[0]


def layout(channels: Sequence[Sequence[str]]) -> Layout:
    """The layout of joints that have these channels ("Xposition", "Zrotation"), one after the other."""
    count = sum(len(names) for names in channels)
    rotations = np.full((len(channels), 3), count, np.intp)
    positions = np.full((len(channels), 3), count, np.intp)
    orders: list[str] = []
    column = 0
    for joint, names in enumerate(channels):
        order = ""
        for name in names:
            if name.endswith("rotation"):
                rotations[joint, len(order)] = column
                order += name[0]
            else:
                positions[joint, "XYZ".index(name[0])] = column
            column += 1
        orders.append(order + "".join(axis for axis in _rest_of(order) if axis not in order))
    return Layout(tuple(orders), rotations, positions, count)


def _rest_of(order: str) -> str:
    return "ZYX" if not order else "XYZ"


def read_frames(blocks: Iterable[Floats], frames: int, where: Layout) -> tuple[Floats, Floats]:
    """The rotations (T, J, 4) of all joints, sign-aligned along time, and the positions (T, M, 3) of the moving ones.

    Shapes and units: ``blocks`` of (N, C), T rows in all; angles in degrees, positions in the file's unit, 0 where a
    component has no channel.
    """
    joints = len(where.orders)
    rotations = np.empty((frames, joints, 4))
    columns = where.position_columns[where.moving]
    present = columns < where.column_count
    positions = np.zeros((frames, len(columns), 3))
    first = 0
    for values in blocks:
        _write_rotations(values, where, rotations, first)
        positions[first : first + len(values), present] = values[:, columns[present]]
        first += len(values)
    return rotations, positions


def _write_rotations(values: Floats, where: Layout, rotations: Floats, first: int) -> None:
    if rotations.shape[0] * rotations.shape[1] > _SMALL_TURNS:
        from keypose.kernels.euler import quaternions_from_degrees

        quaternions_from_degrees(values, where.rotation_columns, where.orders, rotations, first)
        return
    frames = len(values)
    padded = np.concatenate([values, np.zeros((frames, 1))], axis=1)
    part = rotations[first : first + frames]
    for order in sorted(set(where.orders)):
        chosen = [j for j, other in enumerate(where.orders) if other == order]
        part[:, chosen] = euler.to_quat(np.radians(padded[:, where.rotation_columns[chosen]]), order)
    before = max(first - 1, 0)  # the last row that is already there starts the run
    rotations[before : first + frames] = quat.align_signs(rotations[before : first + frames], axis=0)


def translations_of(positions: Floats, where: Layout, offsets: Floats, adds: Flags, scale: float = 1.0) -> Floats:
    """The translations (T, J, 3) of all joints.

    Shapes and units: ``positions`` (T, M, 3) as from `read_frames` and ``offsets`` (J, 3) in one unit; the result is
    ``scale`` times that unit. ``adds`` (J,) is true where positions are added to the offset instead of replacing it. A
    component without a channel keeps its offset.
    """
    translations = np.empty((len(positions), *offsets.shape))
    translations[:] = offsets * scale
    for index, joint in enumerate(where.moving):
        for axis in range(3):
            if where.position_columns[joint, axis] < where.column_count:
                base = offsets[joint, axis] * scale if adds[joint] else 0.0
                translations[:, joint, axis] = positions[:, index, axis] * scale + base
    return translations


def child_positions_rule(offsets: Floats, means: Floats) -> tuple[Positions, float]:
    """Whether position channels of child joints replace OFFSET or are added to it, and by what margin.

    Shapes and units: ``offsets`` (N, 3) and ``means`` (N, 3), the mean over time of the channels, of the N children
    that have them, in one unit; the margin is in that unit too.

    An exporter writes either all local translations, which lie around OFFSET, or all changes, which lie around zero:
    the nearer of the two, summed over all joints, wins.
    """
    to_offset = float(np.linalg.norm(means - offsets, axis=-1).sum())
    to_zero = float(np.linalg.norm(means, axis=-1).sum())
    return ("replace", to_zero - to_offset) if to_offset <= to_zero else ("add", to_offset - to_zero)


def root_positions_rule(offset: Floats, positions: Floats, lowest: Floats) -> Positions:
    """Whether a root's position channels replace OFFSET, as the format has it, or are added to it.

    Shapes and units: ``offset`` (3,); ``positions`` (F, 3) its channels; ``lowest`` (F,) how far the lowest joint is
    along OFFSET's direction if the channels replace; all in one unit.

    Some exporters write a pelvis that stays near zero over an OFFSET of its full height. They are told by two signs
    together: along OFFSET the channels stay nearer to zero than to OFFSET, and adding brings the body nearer to the
    ground.
    """
    length = float(np.linalg.norm(offset))
    if length == 0 or not len(positions):
        return "replace"
    along = float(np.median(positions @ offset)) / length
    ground = float(np.median(lowest))
    return "add" if along < 0.5 * length and abs(ground + length) < abs(ground) else "replace"


def write_degrees(values: Floats, rotations: Floats, where: Layout) -> Floats:
    """Write the angles of all joints, each in its own order and smooth along time, into their columns.

    Shapes and units: ``values`` (T, C) gets degrees; ``rotations`` (T, J, 4). Returns (J, 3), the largest size of the
    angles that have no column.
    """
    frames, joints = rotations.shape[:2]
    if frames * joints > _SMALL_TURNS:
        from keypose.kernels.euler import degrees_from_quaternions

        return degrees_from_quaternions(rotations, where.orders, where.rotation_columns, values)
    lost = np.zeros((joints, 3))
    for order in sorted(set(where.orders)):
        chosen = [j for j, other in enumerate(where.orders) if other == order]
        angles = euler.from_quat(rotations[:, chosen], order)
        degrees = np.degrees(euler.unroll(angles, order, axis=0))
        columns = where.rotation_columns[chosen]
        used = columns < where.column_count
        values[:, columns[used]] = degrees[:, used]
        lost[chosen] = np.where(used, 0.0, np.abs(degrees).max(axis=0, initial=0.0))
    return lost
