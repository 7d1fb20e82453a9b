"""Normals of surfaces whose file has none."""

from __future__ import annotations

import numpy as np

from keypose.arrays import Floats, Ints


def smooth_normals(positions: Floats, triangles: Ints) -> Floats:
    """Unit normals (V, 3) in the precision of the positions: the mean of the triangles around each vertex, weighted by area.

    A vertex without a triangle of any area points up.
    """
    a, b, c = (positions[triangles[:, i]].astype(np.float64) for i in range(3))
    faces = np.cross(b - a, c - a)
    sums = np.stack(
        [
            sum(np.bincount(triangles[:, corner], faces[:, axis], len(positions)) for corner in range(3))
            for axis in range(3)
        ],
        axis=1,
    )
    lengths = np.linalg.norm(sums, axis=1)
    known = (lengths > 0) & np.isfinite(lengths)
    normals = np.zeros((len(positions), 3))
    normals[:, 1] = 1
    normals[known] = sums[known] / lengths[known, None]
    return normals.astype(positions.dtype)
