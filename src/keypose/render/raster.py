# pyright: basic
"""Numba kernels of the software backend: triangle set-up, depth maps, and the visible surfaces of a band of rows.

Triangles are set up in homogeneous coordinates, so that nothing has to be clipped: what lies behind the eye fails the
inside test by itself. Source: Olano and Greer, "Triangle Scan Conversion using 2D Homogeneous Coordinates" (1997).
"""

import numpy as np
from numba import njit

# columns of the set-up: three edge functions (x, y, constant each), the depth plane, the bounding box, facing
EDGES, DEPTH, LEFT, RIGHT, TOP, BOTTOM, FACING, COLUMNS = 0, 9, 12, 13, 14, 15, 16, 17

OFFSETS_4 = np.array([[-0.125, -0.375], [0.375, -0.125], [-0.375, 0.125], [0.125, 0.375]])
OFFSETS_8 = np.array([[1, -3], [-1, 3], [5, 1], [-3, -5], [-5, 5], [-7, -1], [3, 7], [7, -7]]) / 16
OFFSETS_1 = np.zeros((1, 2))


@njit(cache=True, nogil=True)
def set_up(clip, triangles, width, height, setups):
    """Edge functions of every triangle over a picture of that size; degenerate ones get an empty box."""
    for t in range(len(triangles)):
        ia, ib, ic = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        row = setups[t]
        row[LEFT], row[RIGHT], row[TOP], row[BOTTOM] = 0, -1, 0, -1
        aw, bw, cw = float(clip[ia, 3]), float(clip[ib, 3]), float(clip[ic, 3])
        if not (aw > 0 or bw > 0 or cw > 0):
            continue
        ax, bx, cx = (
            0.5 * width * (clip[ia, 0] + aw),
            0.5 * width * (clip[ib, 0] + bw),
            0.5 * width * (clip[ic, 0] + cw),
        )
        ay = 0.5 * height * (aw - clip[ia, 1])
        by = 0.5 * height * (bw - clip[ib, 1])
        cy = 0.5 * height * (cw - clip[ic, 1])
        # rows of the adjugate: cross products of the corners
        e0x, e0y, e0c = by * cw - bw * cy, bw * cx - bx * cw, bx * cy - by * cx
        e1x, e1y, e1c = cy * aw - cw * ay, cw * ax - cx * aw, cx * ay - cy * ax
        e2x, e2y, e2c = ay * bw - aw * by, aw * bx - ax * bw, ax * by - ay * bx
        determinant = ax * e0x + ay * e0y + aw * e0c
        if not (1e-30 < abs(determinant) < 1e300):  # also what is not finite
            continue
        inverse = 1 / determinant
        row[0], row[1], row[2] = e0x * inverse, e0y * inverse, e0c * inverse
        row[3], row[4], row[5] = e1x * inverse, e1y * inverse, e1c * inverse
        row[6], row[7], row[8] = e2x * inverse, e2y * inverse, e2c * inverse
        az, bz, cz = clip[ia, 2], clip[ib, 2], clip[ic, 2]
        for k in range(3):
            row[DEPTH + k] = az * row[k] + bz * row[3 + k] + cz * row[6 + k]
        row[FACING] = -1.0 if determinant > 0 else 1.0  # pixel rows run downwards
        if aw > 1e-9 and bw > 1e-9 and cw > 1e-9:
            left, right = min(ax / aw, bx / bw, cx / cw), max(ax / aw, bx / bw, cx / cw)
            top, bottom = min(ay / aw, by / bw, cy / cw), max(ay / aw, by / bw, cy / cw)
        else:
            left, right, top, bottom = 0.0, float(width), 0.0, float(height)
        row[LEFT], row[RIGHT] = max(0.0, np.floor(left - 0.5)), min(width - 1.0, np.ceil(right))
        row[TOP], row[BOTTOM] = max(0.0, np.floor(top - 0.5)), min(height - 1.0, np.ceil(bottom))


@njit(cache=True, nogil=True)
def bin_triangles(setups, rows, bands):
    """Which triangles touch which band of rows: starts (bands + 1,) and triangle numbers, in their order."""
    counts = np.zeros(bands + 1, np.int64)
    for t in range(len(setups)):
        top, bottom = int(setups[t, TOP]), int(setups[t, BOTTOM])
        if bottom >= top and setups[t, RIGHT] >= setups[t, LEFT]:
            for b in range(top // rows, bottom // rows + 1):
                counts[b + 1] += 1
    starts = np.cumsum(counts)
    filled = starts.copy()
    members = np.empty(starts[-1], np.int32)
    for t in range(len(setups)):
        top, bottom = int(setups[t, TOP]), int(setups[t, BOTTOM])
        if bottom >= top and setups[t, RIGHT] >= setups[t, LEFT]:
            for b in range(top // rows, bottom // rows + 1):
                members[filled[b]] = t
                filled[b] += 1
    return starts, members


@njit(cache=True, nogil=True)
def span(row, y, reach_x, reach_y, first, last):
    """The pixels of one row that any sample of a triangle may lie in: between its edges, widened by the samples' reach."""
    low, high = float(first), float(last)
    for k in range(3):
        a, b, c = row[3 * k], row[3 * k + 1], row[3 * k + 2]
        rest = b * (y + 0.5) + c + abs(b) * reach_y + abs(a) * reach_x
        if a > 0:
            low = max(low, -rest / a - 0.5)
        elif a < 0:
            high = min(high, -rest / a - 0.5)
        elif rest < 0:
            return 1, 0
    if not (low <= high):
        return 1, 0
    return int(np.ceil(low - 1e-9)), int(np.floor(high + 1e-9))


@njit(cache=True, nogil=True)
def draw_depth(setups, members, alphas, top, bottom, depth):
    """The nearest depth of every pixel of rows top..bottom - 1; ``alphas`` > 0 leaves a triangle out."""
    for m in range(len(members)):
        t = members[m]
        if alphas[t] > 0:
            continue
        row = setups[t]
        zx, zy, zc = row[DEPTH], row[DEPTH + 1], row[DEPTH + 2]
        for y in range(max(top, int(row[TOP])), min(bottom - 1, int(row[BOTTOM])) + 1):
            first, last = span(row, y, 0.0, 0.0, int(row[LEFT]), int(row[RIGHT]))
            z = zx * (first + 0.5) + zy * (y + 0.5) + zc
            for x in range(first, last + 1):
                if z < depth[y, x]:
                    depth[y, x] = z
                z += zx


@njit(cache=True, nogil=True)
def cover_floor(depth, world_from_light, floor, key_height, radius, block, top, bottom, cover):
    """Rows of the cover of the floor: share of each block of the light's depth map, and share times height / 4."""
    size = len(cover)
    rim = max(1, size // 85)  # nothing there, so that nothing is smeared outwards from it
    for j in range(max(rim, top), min(size - rim, bottom)):
        y = 1 - 2 * (j + 0.5) / size
        for i in range(rim, size - rim):
            x = 2 * (i + 0.5) / size - 1
            start = (
                world_from_light[1, 0] * x
                + world_from_light[1, 1] * y
                - world_from_light[1, 2]
                + world_from_light[1, 3]
            )
            floor_depth = (start - floor) / (key_height * 4 * radius)
            share = height = 0.0
            for v in range(block):
                for u in range(block):
                    z = 0.5 * depth[j * block + v, i * block + u] + 0.5
                    gap = (floor_depth - z) * 4
                    if z < 1 and gap > 0:
                        share += 1
                        height += min(0.25 * gap, 1.0)
            cover[j, i, 0], cover[j, i, 1] = share / block**2, height / block**2


@njit(cache=True, nogil=True)
def halve(source, result):
    """Means of blocks of 2x2."""
    for j in range(result.shape[0]):
        for i in range(result.shape[1]):
            for c in range(result.shape[2]):
                four = source[2 * j, 2 * i, c] + source[2 * j + 1, 2 * i, c]
                four += source[2 * j, 2 * i + 1, c] + source[2 * j + 1, 2 * i + 1, c]
                result[j, i, c] = 0.25 * four


@njit(cache=True, nogil=True)
def blur(source, weights, result):
    """A separable filter with weights (1 + n,) of the middle and n neighbours on either side; zero beyond the rim."""
    height, width, channels = source.shape
    between = np.zeros_like(source)
    taps = len(weights)
    for j in range(height):
        for i in range(width):
            for c in range(channels):
                total = weights[0] * source[j, i, c]
                for k in range(1, taps):
                    if i >= k:
                        total += weights[k] * source[j, i - k, c]
                    if i + k < width:
                        total += weights[k] * source[j, i + k, c]
                between[j, i, c] = total
    for j in range(height):
        for i in range(width):
            for c in range(channels):
                total = weights[0] * between[j, i, c]
                for k in range(1, taps):
                    if j >= k:
                        total += weights[k] * between[j - k, i, c]
                    if j + k < height:
                        total += weights[k] * between[j + k, i, c]
                result[j, i, c] = total


@njit(cache=True, nogil=True)
def near_floor(depth, result):
    """Nearness to the floor from the depth map seen from below."""
    for j in range(len(depth)):
        for i in range(len(depth)):
            away = 1 - min(max(0.5 * depth[j, i] + 0.5, 0.0), 1.0)
            result[j, i, 0] = away * away


@njit(cache=True, nogil=True)
def touch(touched, y, first, end):
    touched[y, 0] = min(touched[y, 0], first)
    touched[y, 1] = max(touched[y, 1], end)


@njit(cache=True, nogil=True)
def draw_triangle(row, t, offsets, samples, reach, top, bottom, depth, visible, touched):
    """One triangle into the samples of a band; ``touched`` (rows, 2) grows to the pixels that may have changed."""
    for y in range(max(top, int(row[TOP])), min(bottom - 1, int(row[BOTTOM])) + 1):
        first, last = span(row, y, reach, reach, int(row[LEFT]), int(row[RIGHT]))
        if last < first:
            continue
        touch(touched, y - top, first, last + 1)
        for x in range(first, last + 1):
            for s in range(samples):
                px, py = x + 0.5 + offsets[s, 0], y + 0.5 + offsets[s, 1]
                if row[0] * px + row[1] * py + row[2] < 0:
                    continue
                if row[3] * px + row[4] * py + row[5] < 0:
                    continue
                if row[6] * px + row[7] * py + row[8] < 0:
                    continue
                z = row[9] * px + row[10] * py + row[11]
                if -1 <= z < depth[y - top, x, s]:
                    depth[y - top, x, s] = z
                    visible[y - top, x, s] = t
