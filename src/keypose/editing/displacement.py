"""Displacement maps: smooth curves of change that are laid over a motion, coarse B-splines first, finer ones for what is left.

A map says for every frame by how much a joint turns (a rotation vector in the joint's own axes, q' = q exp(d)) or moves. It
meets given values at given frames exactly, is twice continuously differentiable, and is exactly nothing beyond its range.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import solveh_banded

from keypose.arrays import Array, Floats, Ints, checked
from keypose.errors import ShapeError
from keypose.math import quat
from keypose.model import Motion, Pose

# Bending against exactness at a coarse level. More would leave too much to the finer ones; less lets wide splines swing far
# beyond values that lie close together.
_BENDING = 1e-2


@dataclass(frozen=True, slots=True)
class Level:
    """One layer of a hierarchical fit: distance of its knots in frames, and what it leaves at the constraints at most."""

    spacing: float
    left: float


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """A fitted displacement map.

    Shapes: ``values`` (T, C); exactly 0 outside ``ranges``, first and last frame of each, where it also has no slope and no
    curvature. ``levels`` of the range with most of them, coarse to fine.
    """

    values: Floats
    ranges: tuple[tuple[int, int], ...]
    levels: tuple[Level, ...]


def fit_displacement(frames: Any, values: Any, frame_count: int, ease_frames: int) -> Displacement:
    """The smooth displacement that has given values at given frames and is gone ``ease_frames`` before and after them.

    Shapes and units: ``frames`` (N,) whole, rising; ``values`` (N, C). Ranges that touch are fitted together. A range that
    reaches beyond the motion's ends goes on there unseen. The result is linear in ``values``.

    Raises:
        ShapeError: where shapes disagree, frames do not rise or lie outside the motion, or the range is under 2 frames.

    Source: J. Lee and S. Y. Shin, "A hierarchical approach to interactive motion editing for human-like figures"
    (SIGGRAPH 1999), section 4; among coarse splines that fit alike the one that bends least is taken.
    """
    at = np.asarray(frames)
    wanted = checked(np.asarray(values, np.float64), ("N", "C"), "values")
    if at.shape != (len(wanted),) or not np.issubdtype(at.dtype, np.integer):
        raise ShapeError(f"frames: expected {len(wanted)} whole numbers to match the values, got {at.dtype} {at.shape}")
    if len(at) and (at[0] < 0 or at[-1] >= frame_count or np.any(np.diff(at) <= 0)):
        raise ShapeError(f"frames: expected rising frames from 0 to {frame_count - 1}, got {at.tolist()[:8]}")
    if ease_frames < 2:
        raise ShapeError(f"ease_frames: expected 2 or more, got {ease_frames}")
    if not np.all(np.isfinite(wanted)):
        raise ShapeError("values: expected finite numbers")
    result = np.zeros((frame_count, wanted.shape[1]))
    ranges: list[tuple[int, int]] = []
    levels: tuple[Level, ...] = ()
    cuts = np.flatnonzero(np.diff(at) >= 2 * ease_frames) + 1
    for rows in np.split(np.arange(len(at)), cuts):
        if not len(rows):
            continue
        start, end = int(at[rows[0]]) - ease_frames, int(at[rows[-1]]) + ease_frames
        inside = np.arange(max(start + 1, 0), min(end, frame_count))
        fitted, steps = _fit_range(at[rows], wanted[rows], start, end, ease_frames, inside)
        result[inside] = fitted
        ranges.append((start, end))
        levels = max(levels, steps, key=len)
    return Displacement(result, tuple(ranges), levels)


def knot_weights(frames: Any, start: float, spacing: float, count: int) -> tuple[Ints, Floats]:
    """Which control points of a uniform cubic B-spline act at each frame, and how much: (N, 4) indices and (N, 4) weights.

    Control point k acts from ``start + k * spacing`` over four spacings. Those outside 0 .. ``count`` - 1 weigh 0, so the curve
    and its first two derivatives are 0 at ``start`` and ``start + (count + 3) * spacing``.
    """
    place = (np.asarray(frames, np.float64) - start) / spacing
    first = np.floor(place).astype(np.intp)
    u = place - first
    v = 1.0 - u
    weights = np.stack([v**3, 3 * u**3 - 6 * u**2 + 4, 3 * v**3 - 6 * v**2 + 4, u**3], axis=-1) / 6.0
    indices = first[:, None] + np.arange(-3, 1)
    known = (indices >= 0) & (indices < count)
    return np.clip(indices, 0, max(count - 1, 0)), np.where(known, weights, 0.0)


def rotation_change(before: Array, after: Array) -> Floats:
    """The rotation vectors (*B, 3), in the joint's own axes, that carry rotations (*B, 4) to others: after = before exp(d)."""
    a, b = np.asarray(before, np.float64), np.asarray(after, np.float64)
    return np.asarray(quat.to_rotation_vector(quat.shortest(quat.multiply(quat.conjugate(a), b))))


def displace(
    motion: Motion, turns: Mapping[int, Array] | None = None, moves: Mapping[int, Array] | None = None
) -> Motion:
    """A motion with joints turned and moved by displacement maps; frames in which a map is 0 keep their bits.

    Shapes and units: ``turns`` joint -> (T, 3) rotation vectors in radians in the joint's own axes; ``moves`` joint -> (T, 3)
    metres in its parent's axes.

    Raises:
        ShapeError: where a map does not fit the motion.
    """
    pose = motion.pose
    rotations, translations = pose.rotations, pose.translations
    frames = motion.frame_count
    changed = {j: checked(np.asarray(v), (frames, 3), f"turns of joint {j}") for j, v in (turns or {}).items()}
    moved = {j: checked(np.asarray(v), (frames, 3), f"moves of joint {j}") for j, v in (moves or {}).items()}
    for joint in (*changed, *moved):
        if not 0 <= joint < pose.joint_count:
            raise ShapeError(f"joint: expected 0 to {pose.joint_count - 1}, got {joint}")
    changed = {j: v for j, v in changed.items() if np.any(v)}
    moved = {j: v for j, v in moved.items() if np.any(v)}
    if changed:
        rotations = np.array(np.broadcast_to(rotations, (frames, *rotations.shape[-2:])))
        for joint, vectors in changed.items():
            rows = np.flatnonzero(np.any(vectors != 0, axis=-1))
            own = np.asarray(rotations[rows, joint], np.float64)
            turned = quat.normalize(
                quat.multiply(own, quat.from_rotation_vector(np.asarray(vectors[rows], np.float64)))
            )
            rotations[rows, joint] = turned
    if moved:
        translations = np.array(np.broadcast_to(translations, (frames, *translations.shape[-2:])))
        for joint, vectors in moved.items():
            rows = np.flatnonzero(np.any(vectors != 0, axis=-1))
            translations[rows, joint] += vectors[rows]
    if not changed and not moved:
        return motion
    return replace(motion, pose=Pose(translations, rotations, pose.scales))


def _fit_range(
    frames: Ints, values: Floats, start: int, end: int, ease: int, inside: Ints
) -> tuple[Floats, tuple[Level, ...]]:
    """The curve at the frames ``inside`` a range, and its levels."""
    length = end - start
    result = np.zeros((len(inside), values.shape[1]))
    left = values.copy()
    levels: list[Level] = []
    # Knots half the ease apart: one control point alone serves a single constraint.
    pieces = max(4, round(2.0 * length / ease))
    while pieces < length:
        spacing, count = length / pieces, pieces - 3
        indices, weights = knot_weights(frames, start, spacing, count)
        points = _smoothest(indices, weights, left, count)
        left = left - _at(indices, weights, points)
        result += _at(*knot_weights(inside, start, spacing, count), points)
        levels.append(Level(spacing, float(np.abs(left).max(initial=0.0))))
        pieces *= 2
    # One control point for every frame: what is left vanishes, with the smallest control points that do it. The second
    # round takes the rounding of the first.
    for _ in range(2):
        indices, weights = knot_weights(frames, start, 1.0, length - 3)
        points = _smallest(indices, weights, left, length - 3)
        left = left - _at(indices, weights, points)
        result += _at(*knot_weights(inside, start, 1.0, length - 3), points)
    levels.append(Level(1.0, float(np.abs(left).max(initial=0.0))))
    return result, tuple(levels)


def _at(indices: Ints, weights: Floats, points: Floats) -> Floats:
    return np.einsum("nk,nkc->nc", weights, points[indices])


def _smoothest(indices: Ints, weights: Floats, values: Floats, count: int) -> Floats:
    """Control points (K, C) nearest to values (N, C) in least squares; of those that are alike, the ones that bend least."""
    bands = np.zeros((4, count))  # upper form: row 3 - d holds the diagonal d
    right = np.zeros((count, values.shape[1]))
    for a in range(4):
        np.add.at(right, indices[:, a], weights[:, a, None] * values)
        for b in range(a, 4):
            product = weights[:, a] * weights[:, b]
            used = product != 0
            np.add.at(bands, (3 - (b - a), indices[used, b]), product[used])
    scale = _BENDING * max(float(bands[3].max()), 1e-12)
    # Second differences, the points beyond the range being 0: 6, -4, 1.
    for distance, factor in enumerate((6.0, -4.0, 1.0)):
        bands[3 - distance, distance:] += scale * factor
    return solveh_banded(bands, right)


def _smallest(indices: Ints, weights: Floats, values: Floats, count: int) -> Floats:
    """The smallest control points (K, C) that meet values (N, C) at N different frames exactly; knots are a frame apart."""
    rows = len(values)
    # Products of two rows of the matrix of weights: frames up to two apart share control points.
    bands = np.zeros((3, rows))
    for distance in range(min(3, rows)):
        for a in range(4):
            for b in range(4):
                same = indices[: rows - distance, a] == indices[distance:, b]
                product = np.where(same, weights[: rows - distance, a] * weights[distance:, b], 0.0)
                bands[2 - distance, distance:] += product
    factors = solveh_banded(bands, values)
    points = np.zeros((count, values.shape[1]))
    for a in range(4):
        np.add.at(points, indices[:, a], weights[:, a, None] * factors)
    return points
