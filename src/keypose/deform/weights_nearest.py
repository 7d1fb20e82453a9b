"""The nearest places on a surface, and what is inside a shell."""

from __future__ import annotations

import numpy as np

from keypose.arrays import Floats, Ints

_NEAR = 12  # triangles that are looked at
_CHUNK = 50_000


def nearest_on(positions: Floats, triangles: Ints, points: Floats) -> tuple[Ints, Floats, Floats]:
    """The nearest place on a surface to points (N, 3): its triangle (N,), shares of the corners (N, 3), distance (N,).

    The triangles whose centres and corners are nearest are looked at.
    """
    from scipy.spatial import KDTree

    corners = positions[triangles]
    centres = corners.mean(axis=1)
    marks = np.concatenate([centres, corners.reshape(-1, 3)])
    owners = np.concatenate([np.arange(len(triangles)), np.repeat(np.arange(len(triangles)), 3)])
    tree = KDTree(marks)
    count = min(_NEAR, len(marks))
    triangle = np.zeros(len(points), np.int64)
    shares = np.zeros((len(points), 3))
    distance = np.zeros(len(points))
    for begin in range(0, len(points), _CHUNK):
        part = points[begin : begin + _CHUNK]
        _, near = tree.query(part, k=count)
        near = owners[np.reshape(near, (len(part), count))]
        found = _closest_shares(corners[near], part[:, None])
        places = np.einsum("nkc,nkcx->nkx", found, corners[near])
        ways = np.linalg.norm(places - part[:, None], axis=-1)
        best = np.argmin(ways, axis=1)
        rows = np.arange(len(part))
        triangle[begin : begin + _CHUNK] = near[rows, best]
        shares[begin : begin + _CHUNK] = found[rows, best]
        distance[begin : begin + _CHUNK] = ways[rows, best]
    return triangle, shares, distance


def _closest_shares(corners: Floats, points: Floats) -> Floats:
    """Barycentric coordinates (..., 3) of the places on triangles (..., 3, 3) that are nearest to points (..., 3).

    Source: C. Ericson, "Real-Time Collision Detection", 2005, section 5.1.5 (regions of a triangle's plane).
    """
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    best = np.zeros((*np.broadcast_shapes(a.shape[:-1], points.shape[:-1]), 3))
    least = np.full(best.shape[:-1], np.inf)
    sides = ((0, 1, a, b), (1, 2, b, c), (2, 0, c, a))
    for i, j, p, q in sides:
        along = q - p
        t = np.clip(((points - p) * along).sum(-1) / np.maximum((along * along).sum(-1), 1e-300), 0.0, 1.0)
        away = ((p + t[..., None] * along - points) ** 2).sum(-1)
        closer = away < least
        least = np.where(closer, away, least)
        side = np.zeros_like(best)
        side[..., i], side[..., j] = 1.0 - t, t
        best = np.where(closer[..., None], side, best)
    normal = np.cross(b - a, c - a)
    area = (normal * normal).sum(-1)
    safe = np.maximum(area, 1e-300)
    v = (np.cross(points - a, c - a) * normal).sum(-1) / safe
    w = (np.cross(b - a, points - a) * normal).sum(-1) / safe
    inner = (v >= 0) & (w >= 0) & (v + w <= 1) & (area > 0)
    flat = np.stack([1.0 - v - w, v, w], axis=-1)
    return np.where(inner[..., None], flat, best)


def windings(positions: Floats, triangles: Ints, points: Floats) -> Floats:
    """How often a surface goes around points (N, 3): 1 inside a closed one, 0 outside, between for one with openings.

    Source: A. Jacobson, L. Kavan, O. Sorkine-Hornung, "Robust inside-outside segmentation using generalized winding
    numbers", 2013; A. van Oosterom, J. Strackee, "The solid angle of a plane triangle", 1983.
    """
    out = np.zeros(len(points))
    rows = max(2_000_000 // max(len(triangles), 1), 1)
    for begin in range(0, len(points), rows):
        rays = positions[triangles][None] - points[begin : begin + rows, None, None]
        a, b, c = rays[:, :, 0], rays[:, :, 1], rays[:, :, 2]
        la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
        top = (a * np.cross(b, c)).sum(-1)
        bottom = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
        out[begin : begin + rows] = np.arctan2(top, bottom).sum(axis=1) / (2 * np.pi)
    return out
