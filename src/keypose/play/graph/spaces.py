"""Weights of blend spaces: samples on a line, or anywhere in the plane.

Every layout works: one sample, samples on one line, several at one place (they share). Weights are >= 0 and sum to 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Line:
    """Samples on a line: places in rising order, and at each place the samples that share it."""

    places: tuple[float, ...]
    groups: tuple[tuple[int, ...], ...]
    count: int

    def weights(self, at: float) -> list[float]:
        """The weight of every sample at a place; the ends hold."""
        result = [0.0] * self.count
        places = self.places
        if not at > places[0]:  # also where it is not a number
            return _spread(result, self.groups[0], 1.0)
        if at >= places[-1]:
            return _spread(result, self.groups[-1], 1.0)
        right = next(i for i, place in enumerate(places) if place > at)
        u = (at - places[right - 1]) / (places[right] - places[right - 1])
        _spread(result, self.groups[right - 1], 1.0 - u)
        return _spread(result, self.groups[right], u)


def line(places: Sequence[float]) -> Line:
    """A 1D blend space of samples at those places, in any order."""
    unique = sorted(set(places))
    return Line(tuple(unique), tuple(tuple(i for i, p in enumerate(places) if p == at) for at in unique), len(places))


@dataclass(frozen=True, slots=True)
class Plane:
    """Samples in the plane, joined to triangles; without triangles they lie on one line, from ``origin`` along ``axis``."""

    points: tuple[Point, ...]
    groups: tuple[tuple[int, ...], ...]
    triangles: tuple[tuple[int, int, int], ...]
    hull: tuple[tuple[int, int], ...]
    along: Line | None
    axis: Point
    count: int

    def weights(self, x: float, y: float) -> list[float]:
        """The weight of every sample at a point; outside the hull those of the nearest place of the hull."""
        result = [0.0] * self.count
        if self.along is not None:
            shares = self.along.weights(x * self.axis[0] + y * self.axis[1])
            for place, share in enumerate(shares):
                _spread(result, self.groups[place], share)
            return result
        for corners in self.triangles:
            share = _barycentric((x, y), *(self.points[c] for c in corners))
            # A point on an edge belongs to both its triangles and must not fall between them.
            if min(share) >= -1e-12:
                share = [max(s, 0.0) for s in share]
                total = sum(share)
                for corner, s in zip(corners, share, strict=True):
                    _spread(result, self.groups[corner], s / total)
                return result
        best: tuple[float, int, int, float] | None = None
        for a, b in self.hull:
            (ax, ay), (bx, by) = self.points[a], self.points[b]
            dx, dy = bx - ax, by - ay
            u = min(max(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy), 0.0), 1.0)
            distance = math.hypot(ax + u * dx - x, ay + u * dy - y)
            if best is None or distance < best[0]:
                best = distance, a, b, u
        if best is None:  # the point is not a number
            return _spread(result, self.groups[0], 1.0)
        _spread(result, self.groups[best[1]], 1.0 - best[3])
        return _spread(result, self.groups[best[2]], best[3])


def plane(places: Sequence[Point]) -> Plane:
    """A 2D blend space of samples at those places: their Delaunay triangulation.

    Source: B. Delaunay (1934); the triangles are found by Qhull (`scipy.spatial`).
    """
    points = sorted(set(places))
    groups = tuple(tuple(i for i, p in enumerate(places) if p == at) for at in points)
    origin = points[0]
    far = max(points, key=lambda p: math.hypot(p[0] - origin[0], p[1] - origin[1]))
    length = math.hypot(far[0] - origin[0], far[1] - origin[1])
    axis = ((far[0] - origin[0]) / length, (far[1] - origin[1]) / length) if length else (1.0, 0.0)
    across = max(abs((p[0] - origin[0]) * axis[1] - (p[1] - origin[1]) * axis[0]) for p in points)
    if across <= 1e-6 * length:
        along = line([p[0] * axis[0] + p[1] * axis[1] for p in points])
        return Plane(tuple(points), groups, (), (), along, axis, len(places))
    from scipy.spatial import Delaunay

    found = Delaunay(_unit_square(points))
    triangles = tuple((int(a), int(b), int(c)) for a, b, c in found.simplices)
    hull = tuple((int(a), int(b)) for a, b in found.convex_hull)
    return Plane(tuple(points), groups, triangles, hull, None, axis, len(places))


@dataclass(frozen=True, slots=True)
class Bands:
    """Gradient bands in the plane.

    Source: R. S. Johansen, "Automated Semi-Procedural Animation for Character Locomotion" (2009), section 6.3.
    """

    points: tuple[Point, ...]
    groups: tuple[tuple[int, ...], ...]
    count: int

    def weights(self, x: float, y: float) -> list[float]:
        """The weight of every sample at a point: of each pair of samples, how far the point is from the other one."""
        result = [0.0] * self.count
        raw: list[float] = []
        for i, (ax, ay) in enumerate(self.points):
            lowest = 1.0
            for k, (bx, by) in enumerate(self.points):
                if k != i:
                    dx, dy = bx - ax, by - ay
                    lowest = min(lowest, 1.0 - ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy))
            raw.append(max(lowest, 0.0))
        total = sum(raw)
        if not total > 0:
            nearest = min(range(len(raw)), key=lambda i: math.hypot(self.points[i][0] - x, self.points[i][1] - y))
            return _spread(result, self.groups[nearest], 1.0)
        for group, weight in zip(self.groups, raw, strict=True):
            _spread(result, group, weight / total)
        return result


def bands(places: Sequence[Point]) -> Bands:
    """A 2D blend space of gradient bands."""
    points = sorted(set(places))
    return Bands(tuple(points), tuple(tuple(i for i, p in enumerate(places) if p == at) for at in points), len(places))


def _unit_square(points: Sequence[Point]) -> list[Point]:
    """The points moved and scaled evenly into a unit square, where Qhull's tolerances are right."""
    low = (min(p[0] for p in points), min(p[1] for p in points))
    size = max(max(p[0] for p in points) - low[0], max(p[1] for p in points) - low[1])
    return [((p[0] - low[0]) / size, (p[1] - low[1]) / size) for p in points]


def _barycentric(p: Point, a: Point, b: Point, c: Point) -> list[float]:
    area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
    if area == 0:
        return [-1.0, -1.0, -1.0]
    second = ((p[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (p[1] - a[1])) / area
    third = ((b[0] - a[0]) * (p[1] - a[1]) - (p[0] - a[0]) * (b[1] - a[1])) / area
    return [1.0 - second - third, second, third]


def _spread(result: list[float], group: tuple[int, ...], weight: float) -> list[float]:
    for i in group:
        result[i] += weight / len(group)
    return result
