"""Polygons cut into triangles, and their corners joined to vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from keypose.arrays import Floats, Ints
from keypose.errors import FormatError

_MOST_CORNERS = 4096  # of one polygon that is not convex; cutting ears takes quadratic time


def triangulate(positions: Floats, corners: Ints, faces: Ints, where: str) -> tuple[Ints, Ints]:
    """Triangles (T, 3) of corner numbers, and the face of each (T,).

    Shapes: ``faces`` (F, 2) first corner and number of corners. Points and lines have no triangles. Polygons that are
    not convex are cut along diagonals inside them.
    """
    begins, counts = faces[:, 0].astype(np.int64), faces[:, 1].astype(np.int64)
    found: list[Ints] = [np.zeros((0, 3), np.int64)]
    owners: list[Ints] = [np.zeros(0, np.int64)]
    threes = np.nonzero(counts == 3)[0]
    found.append(begins[threes, None] + np.arange(3))
    owners.append(threes)
    fours = np.nonzero(counts == 4)[0]
    if len(fours):
        quads = begins[fours, None] + np.arange(4)
        turned = _better_diagonal(positions[corners[quads]])
        quads = np.where(turned[:, None], np.roll(quads, -1, axis=1), quads)
        found += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
        owners += [fours, fours]
    for face in np.nonzero(counts > 4)[0]:
        begin, count = int(begins[face]), int(counts[face])
        cut = begin + _cut(positions[corners[begin : begin + count]], f"{where}: face {face}")
        found.append(cut)
        owners.append(np.full(len(cut), face))
    triangles, owner = np.concatenate(found), np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return triangles[order], owner[order]


def distinct(rows: NDArray[np.uint32]) -> tuple[Ints, Ints]:
    """The first of each kind of equal rows, and for each row which of these it equals."""
    dice = np.random.default_rng(7)
    factors = dice.integers(1, 2**63, rows.shape[1], np.uint64) * np.uint64(2) + np.uint64(1)
    with np.errstate(over="ignore"):
        mixed = (rows.astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15)) * factors
        mixed ^= mixed >> np.uint64(29)
        keys = mixed.sum(axis=1, dtype=np.uint64)
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    if not np.array_equal(rows[first][inverse], rows):  # two different rows have one key
        _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return first, inverse.reshape(-1)


def _better_diagonal(points: Floats) -> NDArray[np.bool_]:
    """Of quads (Q, 4, 3): whether the diagonal from the second corner is the one that lies inside."""
    a, b, c, d = (points[:, i] for i in range(4))
    first = np.sum(np.cross(b - a, c - a) * np.cross(c - a, d - a), axis=-1)
    second = np.sum(np.cross(c - b, d - b) * np.cross(d - b, a - b), axis=-1)
    return (first < 0) & (second >= 0)


def _cut(points: Floats, where: str) -> Ints:
    """The triangles (N - 2, 3) of one polygon (N, 3)."""
    count = len(points)
    following = np.roll(points, -1, axis=0)
    normal = np.cross(points - points[0], following - points[0]).sum(axis=0)
    size = float(np.linalg.norm(normal))
    turns = np.cross(points - np.roll(points, 1, axis=0), following - points) @ normal
    if size == 0 or np.all(turns >= 0):
        fan = np.arange(1, count - 1)
        return np.stack([np.zeros_like(fan), fan, fan + 1], axis=1)
    if count > _MOST_CORNERS:
        raise FormatError(f"a polygon of {count:,} corners that is not convex", where=where)
    drop = int(np.argmax(np.abs(normal)))
    axes = [(1, 2), (2, 0), (0, 1)][drop]
    flat = points[:, axes] * (1.0 if normal[drop] > 0 else np.array([-1.0, 1.0]))
    left, triangles = list(range(count)), list[tuple[int, int, int]]()
    while len(left) > 3:
        ear = next((k for k in range(len(left)) if _is_ear(flat, left, k)), 0)
        triangles.append((left[ear - 1], left[ear], left[(ear + 1) % len(left)]))
        del left[ear]
    triangles.append((left[0], left[1], left[2]))
    return np.array(triangles)


def _is_ear(flat: Floats, left: list[int], k: int) -> bool:
    a, b, c = flat[left[k - 1]], flat[left[k]], flat[left[(k + 1) % len(left)]]
    if _side(a, b, c) <= 0:
        return False
    others = [v for v in left if v not in (left[k - 1], left[k], left[(k + 1) % len(left)])]
    points = flat[others]
    inside = (_side(a, b, points) > 0) & (_side(b, c, points) > 0) & (_side(c, a, points) > 0)
    return not bool(np.any(inside))


def _side(a: Floats, b: Floats, points: Floats) -> Floats:
    return (b[0] - a[0]) * (points[..., 1] - a[1]) - (b[1] - a[1]) * (points[..., 0] - a[0])
