"""Polygons to triangles, and the smooth normals of a mesh whose file has none."""

from __future__ import annotations

import numpy as np

from keypose.arrays import Floats, Ints

_LARGEST_CLIPPED = 2000  # corners; a larger outline is cut as a fan, whatever its shape


def triangulate(positions: Floats, corners: Ints, sizes: Ints) -> tuple[Ints, Ints]:
    """Triangles of polygons, without new vertices.

    A fan from the first corner where that covers the polygon, the other diagonal of a quad that is dented at it, and
    ears cut off one by one for any other dented polygon. Triangles keep the polygon's winding.

    Shapes and units: ``positions`` (V, 3); ``corners`` (C,) vertex of each corner; ``sizes`` (F,) corners per polygon.
    Returns (T, 3) indices into the corners, and (T,) the polygon of each triangle, in the polygons' order.

    Source: G. Meisters, "Polygons have ears", American Mathematical Monthly 82 (1975).
    """
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64) if len(sizes) else np.zeros(0, np.int64)
    triangles: list[Ints] = []
    owners: list[Ints] = []
    for size in np.unique(sizes[sizes >= 3]).tolist():
        faces = np.nonzero(sizes == size)[0]
        table = starts[faces, None] + np.arange(size)
        fans = _fans(size)
        if size > 3:
            table, dented = _turned(positions, corners, table, fans)
            for face, row in zip(faces[dented], table[dented], strict=True):
                cut = _ears(positions[corners[row]]) if size <= _LARGEST_CLIPPED else fans
                triangles.append(row[cut])
                owners.append(np.full(len(cut), face))
            faces, table = faces[~dented], table[~dented]
        triangles.append(table[:, fans].reshape(-1, 3))
        owners.append(np.repeat(faces, size - 2))
    if not triangles:
        return np.zeros((0, 3), np.int64), np.zeros(0, np.int64)
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(triangles)[order], owner[order]


def _fans(size: int) -> Ints:
    middle = np.arange(1, size - 1)
    return np.stack([np.zeros_like(middle), middle, middle + 1], axis=1)


def _turned(positions: Floats, corners: Ints, table: Ints, fans: Ints) -> tuple[Ints, np.ndarray]:
    """The corners with those quads turned by one whose other diagonal is sound, and which polygons no fan covers."""
    size = table.shape[1]
    bad = _badly_covered(positions[corners[table]], fans)
    if size == 4 and bad.any():
        turned = np.roll(table[bad], -1, axis=1)
        better = ~_badly_covered(positions[corners[turned]], fans)
        table = table.copy()
        table[np.nonzero(bad)[0][better]] = turned[better]
        return table, np.zeros(len(table), bool)  # a quad that crosses itself has no sound diagonal
    return table, bad


def _badly_covered(outline: Floats, fans: Ints) -> np.ndarray:
    """Which of the outlines (F, S, 3) have a fan with a triangle that faces the other way."""
    a, b, c = (outline[:, fans[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    whole = normals.sum(axis=1)
    length = np.einsum("fi,fi->f", whole, whole)
    along = np.einsum("fti,fi->ft", normals, whole)
    return np.any(along < -1e-9 * length[:, None], axis=1)


def _ears(outline: Floats) -> Ints:
    """Triangles of one outline (S, 3): the ear with the best-shaped triangle first."""
    a, b, c = outline[:1], outline[1:-1], outline[2:]
    whole = np.cross(b - a, c - a).sum(axis=0)
    axis = int(np.argmax(np.abs(whole)))
    flat = np.delete(outline, axis, axis=1)
    if (whole[axis] < 0) != (axis == 1):  # the sides of the remaining axes swap for the middle one
        flat = flat * (-1.0, 1.0)
    left = list(range(len(outline)))
    cut: list[tuple[int, int, int]] = []
    while len(left) > 3:
        best = _best_ear(flat, left)
        before, after = left[best - 1], left[(best + 1) % len(left)]
        cut.append((before, left[best], after))
        del left[best]
    cut.append((left[0], left[1], left[2]))
    return np.array(cut)


def _best_ear(flat: Floats, left: list[int]) -> int:
    points = flat[left]
    before, after = np.roll(points, 1, axis=0), np.roll(points, -1, axis=0)
    turn = _cross(points - before, after - points)
    base = np.linalg.norm(after - before, axis=1)
    shape = turn / np.maximum(base * base, 1e-300)
    for ear in np.argsort(-shape, kind="stable").tolist():
        if turn[ear] <= 0:
            break
        a, b, c = before[ear], points[ear], after[ear]
        inside = (_cross(b - a, points - a) >= 0) & (_cross(c - b, points - b) >= 0) & (_cross(a - c, points - c) >= 0)
        same = np.all(points == a, axis=1) | np.all(points == b, axis=1) | np.all(points == c, axis=1)
        if not np.any(inside & ~same):
            return ear
    return int(np.argmax(shape))  # an outline that crosses itself


def _cross(a: Floats, b: Floats) -> Floats:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
