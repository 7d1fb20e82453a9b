# pyright: basic
"""Weights of the mixtures of an animation graph, as `keypose.play.graph.spaces` has them."""

from __future__ import annotations

import math

import numpy as np

from keypose.kernels.graphtables import (
    CHILDREN,
    COUNT,
    DATA,
    FIELDS,
    LINE,
    NODES,
    NUMBERS,
    PLANE,
    REALS,
    SHARE,
    SHARES,
    STATE_FLOATS,
    WORDS,
    A,
    number,
)
from keypose.kernels.runtime import exact_inlined, exact_kernel
from keypose.kernels.vectors import float64_at, int64_at


@exact_inlined
def _spread(words, reals, group, children, share, weight):
    """A weight shared out to the samples at one place; a group is a count, a place in the numbers, and children."""
    count, at = words[group], words[group + 1]
    for i in range(count):
        share[words[children + words[group + 2 + i]]] += weight * reals[at + i]


@exact_kernel
def _on_a_line(words, reals, data, numbers, children, share, x):
    places = words[data]
    if not x > reals[numbers]:  # also where it is not a number
        _spread(words, reals, words[data + 1], children, share, 1.0)
    elif x >= reals[numbers + places - 1]:
        _spread(words, reals, words[data + places], children, share, 1.0)
    else:
        right = 1
        while not reals[numbers + right] > x:
            right += 1
        u = (x - reals[numbers + right - 1]) / (reals[numbers + right] - reals[numbers + right - 1])
        _spread(words, reals, words[data + right], children, share, 1.0 - u)
        _spread(words, reals, words[data + 1 + right], children, share, u)


@exact_kernel
def _in_a_plane(words, reals, data, numbers, children, share, x, y):
    """Data: points, triangles, edges of the hull, then the groups' places, corners and ends."""
    points, triangles, edges = words[data], words[data + 1], words[data + 2]
    groups = data + 3
    corners = groups + points
    for t in range(triangles):
        a, b, c = words[corners + 3 * t], words[corners + 3 * t + 1], words[corners + 3 * t + 2]
        ax, ay = reals[numbers + 2 * a], reals[numbers + 2 * a + 1]
        bx, by = reals[numbers + 2 * b], reals[numbers + 2 * b + 1]
        cx, cy = reals[numbers + 2 * c], reals[numbers + 2 * c + 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0:
            continue
        second = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) / area
        third = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) / area
        first = 1.0 - second - third
        if min(first, second, third) >= -1e-12:
            first, second, third = max(first, 0.0), max(second, 0.0), max(third, 0.0)
            total = first + second + third
            _spread(words, reals, words[groups + a], children, share, first / total)
            _spread(words, reals, words[groups + b], children, share, second / total)
            _spread(words, reals, words[groups + c], children, share, third / total)
            return
    hull = corners + 3 * triangles
    best, best_u, nearest = np.inf, 0.0, -1
    for e in range(edges):
        a, b = words[hull + 2 * e], words[hull + 2 * e + 1]
        ax, ay = reals[numbers + 2 * a], reals[numbers + 2 * a + 1]
        dx, dy = reals[numbers + 2 * b] - ax, reals[numbers + 2 * b + 1] - ay
        u = min(max(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy), 0.0), 1.0)
        distance = math.hypot(ax + u * dx - x, ay + u * dy - y)
        if distance < best:
            best, best_u, nearest = distance, u, e
    if nearest < 0:  # the point is not a number
        _spread(words, reals, words[groups], children, share, 1.0)
        return
    a, b = words[hull + 2 * nearest], words[hull + 2 * nearest + 1]
    _spread(words, reals, words[groups + a], children, share, 1.0 - best_u)
    _spread(words, reals, words[groups + b], children, share, best_u)


@exact_inlined
def _least_band(reals, numbers, points, i, x, y):
    ax, ay = reals[numbers + 2 * i], reals[numbers + 2 * i + 1]
    lowest = 1.0
    for k in range(points):
        if k != i:
            dx, dy = reals[numbers + 2 * k] - ax, reals[numbers + 2 * k + 1] - ay
            lowest = min(lowest, 1.0 - ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy))
    return max(lowest, 0.0)


@exact_kernel
def _in_bands(words, reals, data, numbers, children, share, x, y):
    points = words[data]
    total = 0.0
    for i in range(points):
        total += _least_band(reals, numbers, points, i, x, y)
    if not total > 0:
        best, nearest = np.inf, 0
        for i in range(points):
            distance = math.hypot(reals[numbers + 2 * i] - x, reals[numbers + 2 * i + 1] - y)
            if distance < best:
                best, nearest = distance, i
        _spread(words, reals, words[data + 1 + nearest], children, share, 1.0)
        return
    for i in range(points):
        own = _least_band(reals, numbers, points, i, x, y)
        _spread(words, reals, words[data + 1 + i], children, share, own / total)


@exact_kernel
def weigh(h, node):
    """The weights of a mixture's children, written to ``SHARE``: >= 0, of sum 1."""
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, share = float64_at(h[STATE_FLOATS]), float64_at(h[SHARE])
    row = node * FIELDS
    count, children = nodes[row + COUNT], nodes[row + CHILDREN]
    data, numbers, kind = nodes[row + DATA], nodes[row + NUMBERS], nodes[row + A]
    if kind == SHARES:
        total = 0.0
        for i in range(count):
            own = max(number(floats, words[data + i], reals[numbers + i]), 0.0)
            share[words[children + i]] = own
            total += own
        for i in range(count):
            if total > 0:
                share[words[children + i]] /= total
            else:
                share[words[children + i]] = 1.0 if i == 0 else 0.0
        return
    for i in range(count):
        share[words[children + i]] = 0.0
    x = number(floats, words[data], reals[numbers])
    if kind == LINE:
        _on_a_line(words, reals, data + 1, numbers + 1, children, share, x)
        return
    y = number(floats, words[data + 1], reals[numbers + 1])
    if kind == PLANE:
        if words[data + 2] > 0:  # all on one line
            along = x * reals[numbers + 2] + y * reals[numbers + 3]
            _on_a_line(words, reals, data + 3, numbers + 4, children, share, along)
        else:
            _in_a_plane(words, reals, data + 3, numbers + 4, children, share, x, y)
    else:
        _in_bands(words, reals, data + 2, numbers + 2, children, share, x, y)
