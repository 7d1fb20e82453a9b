"""Measures of meshes that the tests of the built-in human share."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components


def directed_edges(triangles: np.ndarray) -> np.ndarray:
    return np.stack([triangles, np.roll(triangles, -1, 1)], -1).reshape(-1, 2)


def open_edges(triangles: np.ndarray) -> np.ndarray:
    """Directed edges (N, 2) whose opposite is missing: the borders."""
    edges = directed_edges(triangles)
    count = int(triangles.max()) + 1
    keys, opposite = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    return edges[~np.isin(keys, opposite)]


def components(triangles: np.ndarray, count: int) -> np.ndarray:
    """The number of the connected body that each vertex belongs to."""
    edges = directed_edges(triangles)
    graph = sparse.coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (count, count))
    return connected_components(graph, directed=False)[1]


def volume(points: np.ndarray, triangles: np.ndarray) -> float:
    """Signed volume; borders are closed by fans to their middles."""
    points = np.asarray(points, np.float64)
    rim = open_edges(triangles)
    if len(rim):
        label = components(np.stack([rim[:, 0], rim[:, 1], rim[:, 1]], 1), len(points))
        caps = []
        for loop in np.unique(label[rim[:, 0]]):
            edges = rim[label[rim[:, 0]] == loop]
            points = np.vstack([points, points[edges[:, 0]].mean(0)])
            caps.append(np.stack([edges[:, 1], edges[:, 0], np.full(len(edges), len(points) - 1)], 1))
        triangles = np.vstack([triangles, *caps])
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6)


def face_normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (points[triangles[:, i]].astype(np.float64) for i in range(3))
    return np.cross(b - a, c - a)


def depth_from_front(points: np.ndarray, triangles: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The greatest z of the mesh over each place (N, 2) of the xy plane; -inf where there is nothing."""
    return seen_from_front(points, triangles, at)[0]


def seen_from_front(points: np.ndarray, triangles: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is seen over each place (N, 2) of the xy plane: its z (-inf where there is nothing) and its triangle."""
    corners = points[triangles].astype(np.float64)
    a, b, c = (corners[:, i, :2] for i in range(3))

    def cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]

    area = cross(b - a, c - a)
    area = np.where(np.abs(area) < 1e-15, np.nan, area)
    p = at[:, None]
    u, v = cross(p - a, c - a) / area, cross(b - a, p - a) / area
    share = np.stack([1 - u - v, u, v], -1)
    inside = np.min(share, -1) >= -1e-9
    z = np.einsum("nfk,fk->nf", share, corners[:, :, 2])
    z = np.where(inside, z, -np.inf)
    return np.max(z, 1), np.argmax(z, 1)
