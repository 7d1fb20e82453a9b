# pyright: basic
"""Straight ways through a solid of voxels, past triangles that are listed by voxel."""

from __future__ import annotations

import math

import numpy as np

from keypose.kernels.runtime import exact_kernel

_STEPS = 2  # samples to a voxel
_NEAR = 1e-6  # of a way: what is crossed before that is the place it starts from


@exact_kernel
def list_by_voxel(points, triangles, wanted, origin, edge, shape):
    """The triangles that are ``wanted``, by the voxels of their boxes: (starts [voxel + 1], listed).

    points [p][3] float64, triangles [t][3], wanted [t]; origin [3], edge and shape [3] of the voxels.
    """
    voxels = shape[0] * shape[1] * shape[2]
    starts = np.zeros(voxels + 1, np.int64)
    low, high = np.zeros(3, np.int64), np.zeros(3, np.int64)
    listed = np.zeros(0, np.int32)
    for fill in range(2):
        for t in range(triangles.shape[0]):
            if not wanted[t]:
                continue
            for x in range(3):
                a, b, c = points[triangles[t, 0], x], points[triangles[t, 1], x], points[triangles[t, 2], x]
                low[x] = max(math.floor((min(a, b, c) - origin[x]) / edge), 0)
                high[x] = min(math.floor((max(a, b, c) - origin[x]) / edge), shape[x] - 1)
            for i in range(low[0], high[0] + 1):
                for j in range(low[1], high[1] + 1):
                    for k in range(low[2], high[2] + 1):
                        voxel = (i * shape[1] + j) * shape[2] + k
                        if fill:
                            starts[voxel] -= 1
                            listed[starts[voxel]] = t
                        else:
                            starts[voxel] += 1
        if not fill:
            for voxel in range(voxels):
                starts[voxel + 1] += starts[voxel]
            listed = np.zeros(starts[voxels], np.int32)
    return starts, listed


@exact_kernel
def _crosses(start, goal, a, b, c):
    """Whether a way goes through a triangle (Möller, Trumbore 1997)."""
    wx, wy, wz = goal[0] - start[0], goal[1] - start[1], goal[2] - start[2]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    px, py, pz = wy * vz - wz * vy, wz * vx - wx * vz, wx * vy - wy * vx
    determinant = ux * px + uy * py + uz * pz
    if determinant == 0.0:
        return False
    sx, sy, sz = start[0] - a[0], start[1] - a[1], start[2] - a[2]
    u = (sx * px + sy * py + sz * pz) / determinant
    if u < 0.0 or u > 1.0:
        return False
    qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
    v = (wx * qx + wy * qy + wz * qz) / determinant
    if v < 0.0 or u + v > 1.0:
        return False
    t = (vx * qx + vy * qy + vz * qz) / determinant
    return _NEAR < t < 1.0


@exact_kernel
def look(whose, goals, points, triangles, shell_of, starts, listed, filled, origin, edge, out):
    """Whether points see places: all of the way in filled voxels, and through no listed triangle of the own shell.

    whose [n] points; goals [n][3]; points [p][3]; triangles [t][3]; shell_of [p]; starts and listed of `list_by_voxel`;
    filled [x][y][z]; out [n] is written. Triangles at the point itself are no obstacle.
    """
    nx, ny, nz = filled.shape
    for n in range(whose.shape[0]):
        own = whose[n]
        start, goal = points[own], goals[n]
        length = math.sqrt((goal[0] - start[0]) ** 2 + (goal[1] - start[1]) ** 2 + (goal[2] - start[2]) ** 2)
        steps = max(math.ceil(length / edge) * _STEPS, 2)
        seen = True
        last = -1
        for s in range(steps + 1):
            share = s / steps
            i = math.floor((start[0] + (goal[0] - start[0]) * share - origin[0]) / edge)
            j = math.floor((start[1] + (goal[1] - start[1]) * share - origin[1]) / edge)
            k = math.floor((start[2] + (goal[2] - start[2]) * share - origin[2]) / edge)
            if i < 0 or j < 0 or k < 0 or i >= nx or j >= ny or k >= nz or not filled[i, j, k]:
                seen = False
                break
        if not seen or listed.shape[0] == 0:
            out[n] = seen
            continue
        # every voxel on the way, one after the other (Amanatides, Woo 1987)
        i = math.floor((start[0] - origin[0]) / edge)
        j = math.floor((start[1] - origin[1]) / edge)
        k = math.floor((start[2] - origin[2]) / edge)
        di, dj, dk = goal[0] - start[0], goal[1] - start[1], goal[2] - start[2]
        ti = _to_border(start[0] - origin[0], i, di, edge)
        tj = _to_border(start[1] - origin[1], j, dj, edge)
        tk = _to_border(start[2] - origin[2], k, dk, edge)
        while True:
            voxel = (i * ny + j) * nz + k
            for e in range(starts[voxel], starts[voxel + 1]):
                t = listed[e]
                if t == last:
                    continue
                last = t
                a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
                if a == own or b == own or c == own or shell_of[a] != shell_of[own]:
                    continue
                if _crosses(start, goal, points[a], points[b], points[c]):
                    seen = False
                    break
            least = min(ti, tj, tk)
            if not seen or least >= 1.0:
                break
            if least == ti:
                i += 1 if di > 0 else -1
                ti += edge / abs(di)
            elif least == tj:
                j += 1 if dj > 0 else -1
                tj += edge / abs(dj)
            else:
                k += 1 if dk > 0 else -1
                tk += edge / abs(dk)
            if i < 0 or j < 0 or k < 0 or i >= nx or j >= ny or k >= nz:
                break
        out[n] = seen


@exact_kernel
def _to_border(start, cell, way, edge):
    """The share of a way at which it leaves its first voxel along one axis."""
    if way > 0:
        return ((cell + 1) * edge - start) / way
    if way < 0:
        return (cell * edge - start) / way
    return np.inf
