# pyright: basic
"""Edge collapses on a triangle mesh whose vertices stay where they are, and distances to triangles.

Triangles name *vertices*; vertices at one place (on a seam, where two parts meet) are one *point*. A collapse moves every
triangle of a point to a neighbour, which vertex it takes there is read from the two triangles that vanish, so seams
stay closed and each side keeps its own vertices.
"""

from __future__ import annotations

import numpy as np

from keypose.kernels.runtime import exact_kernel

_FLAT = 0.25  # cosine of how far a triangle may turn in one collapse
_AWAY = 0.3  # sum of three cosines: what a triangle may turn away from its vertices' normals in all
_THIN = 0.02  # twice the area over the square of the longest side


@exact_kernel
def collapse_pass(positions, normals, triangles, point_of, starts, around, froms, tos, quadrics, weights, limit):
    """Collapse ``froms[k]`` to ``tos[k]`` in this order where that keeps the surface sound; returns triangles removed.

    positions and normals [point][3] float64; triangles [t][3] vertices, a removed one becomes -1, changed in place; starts and around:
    the triangles of each point; quadrics [point][10] and weights [point] are summed up at the points that stay.
    """
    points = positions.shape[0]
    touched = np.zeros(points, np.bool_)
    mark = np.full(points, -1, np.int64)
    corner_from, corner_to = np.zeros(2, np.int64), np.zeros(2, np.int64)
    removed = 0
    for k in range(froms.shape[0]):
        if removed >= limit:
            break
        u, v = froms[k], tos[k]
        if touched[u] or touched[v]:
            continue
        # What vanishes, and which vertex at v each side takes.
        gone, sound = 0, True
        for i in range(starts[u], starts[u + 1]):
            at_u, at_v = -1, -1
            for c in range(3):
                vertex = triangles[around[i], c]
                if point_of[vertex] == u:
                    at_u = vertex
                elif point_of[vertex] == v:
                    at_v = vertex
            if at_v >= 0:
                if gone == 2:
                    sound = False
                    break
                corner_from[gone], corner_to[gone] = at_u, at_v
                gone += 1
        if not sound or gone == 0:
            continue
        if gone == 2 and corner_from[0] == corner_from[1] and corner_to[0] != corner_to[1]:
            continue
        # Neighbours of both, and of nothing else than the vanishing triangles (the link condition).
        for i in range(starts[v], starts[v + 1]):
            for c in range(3):
                mark[point_of[triangles[around[i], c]]] = k
        shared = 0
        for i in range(starts[u], starts[u + 1]):
            for c in range(3):
                point = point_of[triangles[around[i], c]]
                if point != u and point != v and mark[point] == k:
                    mark[point] = -1
                    shared += 1
        if shared != gone:
            continue
        for i in range(starts[u], starts[u + 1]):
            t = around[i]
            if not _may_move(positions, normals, triangles, point_of, t, u, v, corner_from, gone) or _lies_on_another(
                triangles, point_of, starts, around, t, u, v
            ):
                sound = False
                break
        if not sound:
            continue
        for i in range(starts[u], starts[u + 1]):
            t = around[i]
            vanishes = False
            for c in range(3):
                point = point_of[triangles[t, c]]
                touched[point] = True
                vanishes = vanishes or point == v
            for c in range(3):
                if vanishes:
                    triangles[t, c] = -1
                elif point_of[triangles[t, c]] == u:
                    other = gone == 2 and triangles[t, c] == corner_from[1]
                    triangles[t, c] = corner_to[1] if other else corner_to[0]
            removed += vanishes
        for i in range(starts[v], starts[v + 1]):
            for c in range(3):
                vertex = triangles[around[i], c]
                if vertex >= 0:
                    touched[point_of[vertex]] = True
        touched[u] = touched[v] = True
        quadrics[v] += quadrics[u]
        weights[v] += weights[u]
    return removed


@exact_kernel
def _may_move(positions, normals, triangles, point_of, t, u, v, corner_from, gone):
    """Whether triangle t stays on its side, and keeps a vertex of its own, when its corner goes from u to v."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    pa, pb, pc = point_of[a], point_of[b], point_of[c]
    if pa == v or pb == v or pc == v:
        return True
    mine = a if pa == u else b if pb == u else c
    if mine != corner_from[0] and (gone == 1 or mine != corner_from[1]):
        return False
    x0, y0, z0, _ = _normal(positions, pa, pb, pc)
    x1, y1, z1, longest = _normal(positions, v if pa == u else pa, v if pb == u else pb, v if pc == u else pc)
    before, after = np.sqrt(x0 * x0 + y0 * y0 + z0 * z0), np.sqrt(x1 * x1 + y1 * y1 + z1 * z1)
    if after < _THIN * longest:
        return False
    if x0 * x1 + y0 * y1 + z0 * z1 <= _FLAT * before * after:
        return False
    was = _facing(normals, pa, pb, pc, x0, y0, z0) * after
    now = _facing(normals, v if pa == u else pa, v if pb == u else pb, v if pc == u else pc, x1, y1, z1) * before
    return now > _AWAY * before * after or now > was


@exact_kernel
def _facing(normals, a, b, c, x, y, z):
    """How far a triangle's normal agrees with what its points' normals were before all collapses."""
    facing = 0.0
    facing += x * (normals[a, 0] + normals[b, 0] + normals[c, 0])
    facing += y * (normals[a, 1] + normals[b, 1] + normals[c, 1])
    facing += z * (normals[a, 2] + normals[b, 2] + normals[c, 2])
    return facing


@exact_kernel
def _lies_on_another(triangles, point_of, starts, around, t, u, v):
    """Whether v already has a triangle at the side of t that is opposite to u: the last faces of a closed piece."""
    for i in range(starts[v], starts[v + 1]):
        shared = 0
        for c in range(3):
            point = point_of[triangles[around[i], c]]
            if point == u:
                shared = -3
            for e in range(3):
                other = point_of[triangles[t, e]]
                if other == v:
                    return False
                if other != u and other == point:
                    shared += 1
        if shared == 2:
            return True
    return False


@exact_kernel
def _normal(positions, a, b, c):
    """Twice the area times the normal, and the square of the longest side."""
    ux, uy, uz = positions[b, 0] - positions[a, 0], positions[b, 1] - positions[a, 1], positions[b, 2] - positions[a, 2]
    vx, vy, vz = positions[c, 0] - positions[a, 0], positions[c, 1] - positions[a, 1], positions[c, 2] - positions[a, 2]
    wx, wy, wz = vx - ux, vy - uy, vz - uz
    longest = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz)
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx, longest


@exact_kernel
def distances_to_triangles(points, positions, triangles, near, out):
    """The distance of each point to the nearest of some triangles, near [point][candidate].

    Source: C. Ericson, "Real-Time Collision Detection", 2004, 5.1.5.
    """
    for n in range(points.shape[0]):
        best, last = np.inf, -1
        for k in range(near.shape[1]):
            t = near[n, k]
            if t != last:
                best = min(best, _square_to_triangle(points[n], positions, triangles[t]))
            last = t
        out[n] = np.sqrt(best)


@exact_kernel
def _square_to_triangle(point, positions, corners):
    a, b, c = positions[corners[0]], positions[corners[1]], positions[corners[2]]
    nx, ny, nz, _ = _normal(positions, corners[0], corners[1], corners[2])
    square = nx * nx + ny * ny + nz * nz
    px, py, pz = point[0] - a[0], point[1] - a[1], point[2] - a[2]
    if square > 0:
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        v = (py * wz - pz * wy) * nx + (pz * wx - px * wz) * ny + (px * wy - py * wx) * nz
        w = (uy * pz - uz * py) * nx + (uz * px - ux * pz) * ny + (ux * py - uy * px) * nz
        if v >= 0 and w >= 0 and v + w <= square:
            height = px * nx + py * ny + pz * nz
            return height * height / square
    return min(_square_to_side(point, a, b), _square_to_side(point, b, c), _square_to_side(point, c, a))


@exact_kernel
def _square_to_side(point, start, end):
    along, length = 0.0, 0.0
    for k in range(3):
        along += (point[k] - start[k]) * (end[k] - start[k])
        length += (end[k] - start[k]) ** 2
    share = min(max(along / length, 0.0), 1.0) if length > 0 else 0.0
    total = 0.0
    for k in range(3):
        total += (point[k] - start[k] - share * (end[k] - start[k])) ** 2
    return total
