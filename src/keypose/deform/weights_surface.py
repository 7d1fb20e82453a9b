"""The surface that heat flows over: vertices of all meshes welded by place, their shells, and the cotangent Laplacian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.errors import ShapeError
from keypose.model import Mesh

_SAME_PLACE = 1e-6  # of the size
_LEAST_COTANGENT = 1e-3  # keeps every weight between 0 and 1 (a maximum principle) whatever the triangles look like


@dataclass(frozen=True, slots=True)
class Surface:
    """Meshes as one: P points, where vertices at the same place are one point, and T triangles without copies.

    Shapes and units:
        points: (P, 3) metres; triangles: (T, 3) points; point_of: for each mesh (V,) the point of its vertices.
        shell_of: (P,) the number of the connected piece of a point, the largest by area first; areas: (S,) m^2.
        closed: (S,) whether a shell has no border and is no heap of loose points.
        size_m: the diagonal of the box around all.
    """

    points: Floats
    triangles: Ints
    point_of: tuple[Ints, ...]
    shell_of: Ints
    areas: Floats
    closed: Any
    size_m: float

    @property
    def shell_count(self) -> int:
        """S."""
        return len(self.areas)

    def triangles_of(self, shells: Any) -> Ints:
        """The triangles whose shell is flagged in ``shells`` (S,)."""
        return self.triangles[np.asarray(shells)[self.shell_of[self.triangles[:, 0]]]]


def weld(meshes: Sequence[Mesh], positions: Sequence[Floats] | None = None) -> Surface:
    """The surface of all meshes, with ``positions`` in place of theirs where given.

    Raises:
        ShapeError: where a coordinate is not finite, or there is no vertex at all.
    """
    places = [np.asarray(m.positions, np.float64) for m in meshes] if positions is None else list(positions)
    counts = [len(p) for p in places]
    everything = np.concatenate(places) if places else np.empty((0, 3))
    if not len(everything):
        raise ShapeError("meshes: expected at least one vertex, got none")
    if not np.all(np.isfinite(everything)):
        vertex = int(np.nonzero(~np.isfinite(everything).all(axis=1))[0][0])
        mesh = int(np.searchsorted(np.cumsum(counts), vertex, "right"))
        raise ShapeError(
            f"positions: vertex {vertex - sum(counts[:mesh])} of mesh {mesh} is not finite: {everything[vertex]}"
        )
    size = float(np.linalg.norm(np.ptp(everything, axis=0)))
    if size <= 0:
        raise ShapeError("positions: all vertices are at one place")
    point_of, first = _welded(everything, size * _SAME_PLACE)
    starts = np.concatenate([[0], np.cumsum(counts)])
    triangles = np.concatenate([np.asarray(m.triangles, np.int64) + s for m, s in zip(meshes, starts, strict=False)])
    triangles = point_of[triangles].reshape(-1, 3)
    whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    triangles = triangles[whole]
    _, once = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    triangles = triangles[np.sort(once)]
    points = everything[first]
    shell_of, areas, closed = _shells(points, triangles)
    return Surface(points, triangles, tuple(np.split(point_of, starts[1:-1])), shell_of, areas, closed, size)


def _welded(positions: Floats, distance: float) -> tuple[Ints, Ints]:
    """The point of every vertex, and the first vertex of every point, in the order of the vertices."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    _, first, same = np.unique(positions, axis=0, return_index=True, return_inverse=True)
    pairs = KDTree(positions[first]).query_pairs(distance, output_type="ndarray")
    count = len(first)
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), (count, count))
    _, label = connected_components(graph, directed=False)
    label = label[same.reshape(-1)]
    _, first, label = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return rank[label.reshape(-1)], first[order]


def triangle_areas(points: Floats, triangles: Ints) -> Floats:
    """(T,) m^2."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def _shells(points: Floats, triangles: Ints) -> tuple[Ints, Any, Any]:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(points)
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    graph = coo_array((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), (count, count))
    shells, label = connected_components(graph, directed=False)
    areas = np.bincount(label[triangles[:, 0]], triangle_areas(points, triangles), minlength=shells)
    # the largest first; where areas are equal, by the first point, so that the order of vertices does not matter much
    rank = np.empty(shells, np.int64)
    rank[np.argsort(-areas, kind="stable")] = np.arange(shells)
    label = rank[label]
    areas = np.sort(areas)[::-1].copy()
    distinct, uses = np.unique(edges, axis=0, return_counts=True)
    closed = np.bincount(label[triangles[:, 0]], minlength=shells) > 3
    closed[label[distinct[uses != 2, 0]]] = False
    return label, areas, closed


def laplacian(points: Floats, triangles: Ints) -> tuple[Any, Any]:
    """The cotangent Laplacian (P, P), positive semi-definite, rows summing to 0, and each point's area (P,) in m^2.

    Source: U. Pinkall, K. Polthier, "Computing discrete minimal surfaces and their conjugates", 1993 (cotangents).
    """
    from scipy.sparse import coo_array, csc_array, dia_array

    count = len(points)
    areas = triangle_areas(points, triangles)
    rows: list[Ints] = []
    values: list[Floats] = []
    for k in range(3):
        i, j, o = triangles[:, (k + 1) % 3], triangles[:, (k + 2) % 3], triangles[:, k]
        u, v = points[i] - points[o], points[j] - points[o]
        tiny = 1e-12 * (np.sum(u * u, axis=1) + np.sum(v * v, axis=1))
        cotangent = np.sum(u * v, axis=1) / np.maximum(2 * areas, np.maximum(tiny, 1e-300))
        rows.append(np.stack([i, j], axis=1))
        values.append(0.5 * np.clip(cotangent, -1e4, 1e4))
    ends, halves = np.concatenate(rows), np.concatenate(values)
    sides = coo_array((halves, (ends[:, 0], ends[:, 1])), (count, count)).tocsc()
    sides = (sides + sides.T).tocoo()  # both triangles of an edge are added up before what is negative is cut off
    data = np.clip(sides.data, _LEAST_COTANGENT, None)
    sides = coo_array((data, (sides.row, sides.col)), (count, count)).tocsc()
    total = np.asarray(sides.sum(axis=1)).reshape(-1)
    lumped = np.bincount(triangles.reshape(-1), np.repeat(areas / 3, 3), minlength=count)
    diagonal = dia_array((total[None], [0]), (count, count))
    return csc_array(diagonal - sides), lumped
