"""Fewer triangles: edge collapses by quadric error on the vertices that are there, so that weights and morphs stay theirs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.errors import ShapeError

_BORDER = 10.0  # how much more an open border weighs than the surface beside it
_SEAM = 1.0
_BEND = (
    0.25  # how much a collapse between differently bound vertices costs; 1: as if the surface moved by all its length
)
_SHAPE = 1e-3  # what long edges cost on a plane
_PASSES = 200


@dataclass(frozen=True, slots=True)
class SurfaceError:
    """How far two surfaces are from each other, in metres: the largest distance, and the root of the mean square."""

    max_m: float
    rms_m: float


def simplify(
    positions: Floats,
    triangles: Ints,
    target: int,
    *,
    features: Floats | None = None,
    importance: Floats | None = None,
) -> Ints:
    """At most about ``target`` of the triangles, by half-edge collapses: vertices vanish, none moves.

    Vertices at the same place belong together, so seams between parts and texture islands stay closed. Borders shrink
    along themselves only. Stops earlier where nothing can go without a fold or a torn surface.

    Shapes and units:
        positions: (V, 3) metres; triangles: (F, 3).
        features: (V, K) of what must not be mixed without need, such as dense skin weights.
        importance: (V,) factor of the error at each vertex, 1 where it is not given.
        Returns (F', 3) indices of the same vertices, in the order of the triangles they came from.

    Raises:
        ShapeError: where shapes disagree or ``target`` is negative.

    Source: M. Garland, P. Heckbert, "Surface simplification using quadric error metrics", 1997 (error and boundary
    planes); H. Hoppe, "New quadric metric for simplifying meshes with appearance attributes", 1999 (seams).
    """
    from keypose.kernels.collapse import collapse_pass

    positions = np.ascontiguousarray(positions, np.float64)
    triangles = np.array(triangles, np.int64)
    if positions.ndim != 2 or positions.shape[1] != 3 or triangles.ndim != 2 or triangles.shape[1] != 3:
        raise ShapeError(f"simplify: expected (V, 3) and (F, 3), got {positions.shape} and {triangles.shape}")
    if target < 0:
        raise ShapeError(f"target: expected a number of triangles, got {target}")
    factor = np.ones(len(positions)) if importance is None else np.asarray(importance, np.float64)
    if factor.shape != (len(positions),) or (features is not None and len(features) != len(positions)):
        raise ShapeError(f"features, importance: expected {len(positions)} rows to match the positions")
    _, first, point_of = np.unique(positions, axis=0, return_index=True, return_inverse=True)
    point_of = point_of.reshape(-1).astype(np.int64)
    places = np.ascontiguousarray(positions[first])
    corners = point_of[triangles]
    whole = (corners != np.roll(corners, 1, axis=1)).all(axis=1)  # no point twice
    triangles, corners = triangles[whole], corners[whole]
    quadrics, weights = _quadrics(places, triangles, corners, factor[first])
    normals = _point_normals(places, corners)
    traits = None if features is None else np.asarray(features, np.float64)[first]
    for _ in range(_PASSES):
        if len(triangles) <= target:
            break
        froms, tos, costs = _candidates(places, triangles, point_of[triangles], quadrics, weights, traits)
        wanted = len(triangles) - target
        enough = costs[min(len(costs) - 1, wanted // 2 + len(costs) // 20)] if len(costs) else 0.0
        few = int(np.searchsorted(costs, enough * 1.5, "right"))
        starts, around = _triangles_of(point_of[triangles], len(places))
        if not collapse_pass(
            places, normals, triangles, point_of, starts, around, froms[:few], tos[:few], quadrics, weights, wanted
        ) and (few == len(froms) or not collapse_pass(
            places, normals, triangles, point_of, starts, around, froms, tos, quadrics, weights, wanted
        )):  # fmt: skip
            break
        triangles = np.ascontiguousarray(triangles[triangles[:, 0] >= 0])
    return triangles.astype(np.int32)


def surface_distance(points: Floats, positions: Floats, triangles: Ints, spacing_m: float) -> Floats:
    """The distance of each point (N, 3) to a surface, in metres.

    The surface is sampled every ``spacing_m`` and at its corners; the exact distance to the triangles of the nearest
    samples is taken.
    """
    from scipy.spatial import KDTree

    from keypose.kernels.collapse import distances_to_triangles

    points = np.array(points, np.float64)
    samples, owners = surface_samples(positions, triangles, spacing_m)
    _, near = KDTree(samples).query(points, k=min(16, len(samples)))
    candidates = owners[np.reshape(near, (len(points), -1))]
    out = np.empty(len(points))
    distances_to_triangles(points, np.array(positions, np.float64), np.array(triangles, np.int64), candidates, out)
    return out


def surface_error(
    positions: Floats, triangles: Ints, others: Floats, other_triangles: Ints, spacing_m: float | None = None
) -> SurfaceError:
    """How far two surfaces are apart, measured from samples on each to the other one: all corners, and every ``spacing_m``,
    which is a hundredth of their size if not given.
    """
    if spacing_m is None:
        both = np.concatenate([np.asarray(positions)[triangles], np.asarray(others)[other_triangles]]).reshape(-1, 3)
        spacing_m = max(float(np.linalg.norm(np.ptp(both, axis=0))) / 100, 1e-9)
    one, _ = surface_samples(positions, triangles, spacing_m)
    other, _ = surface_samples(others, other_triangles, spacing_m)
    apart = np.concatenate(
        [
            surface_distance(one, others, other_triangles, spacing_m),
            surface_distance(other, positions, triangles, spacing_m),
        ]
    )
    return SurfaceError(float(apart.max(initial=0.0)), float(np.sqrt(np.mean(apart**2))))


def surface_samples(positions: Floats, triangles: Ints, spacing_m: float) -> tuple[Floats, Ints]:
    """Points on a surface, evenly over each triangle and at its corners, with the triangle of each: (N, 3), (N,)."""
    corners = np.asarray(positions, np.float64)[np.asarray(triangles)]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max(axis=1)
    steps = np.clip(np.ceil(longest / spacing_m).astype(np.int64), 1, 64)
    found: list[Floats] = []
    owners: list[Ints] = []
    for n in np.unique(steps):
        of = np.nonzero(steps == n)[0]
        a, b = np.divmod(np.arange((n + 1) ** 2), n + 1)
        inside = a + b <= n
        u, v = a[inside] / n, b[inside] / n
        shares = np.stack([1 - u - v, u, v], axis=1)
        found.append(np.einsum("sk,fkc->fsc", shares, corners[of]).reshape(-1, 3))
        owners.append(np.repeat(of, len(shares)))
    return np.concatenate(found), np.concatenate(owners)


def _triangles_of(corners: Ints, count: int) -> tuple[Ints, Ints]:
    flat = corners.reshape(-1)
    starts = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=count))])
    return starts.astype(np.int64), (np.argsort(flat, kind="stable") // 3).astype(np.int64)


def _edges(corners: Ints) -> tuple[Ints, Ints, Ints]:
    """Edges (E, 2) of points, how many triangles each has, and the edge of each side of each triangle (F, 3)."""
    sides = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    key = sides[:, 0] * (int(corners.max(initial=0)) + 1) + sides[:, 1]
    _, at, inverse, uses = np.unique(key, return_index=True, return_inverse=True, return_counts=True)
    return sides[at], uses, inverse.reshape(-1, 3)


def _planes(normals: Floats, points: Floats, weights: Floats) -> Floats:
    """Quadrics (N, 10) of planes through points: xx xy xz xw yy yz yw zz zw ww."""
    plane = np.concatenate([normals, -np.sum(normals * points, axis=1, keepdims=True)], axis=1)
    i, j = np.triu_indices(4)
    return plane[:, i] * plane[:, j] * weights[:, None]


def _point_normals(places: Floats, corners: Ints) -> Floats:
    """Unit normals (N, 3): the mean of the faces around, by their size."""
    a, b, c = (places[corners[:, k]] for k in range(3))
    faces = np.cross(b - a, c - a)
    normals = np.zeros_like(places)
    for k in range(3):
        np.add.at(normals, corners[:, k], faces)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def _quadrics(places: Floats, triangles: Ints, corners: Ints, factor: Floats) -> tuple[Floats, Floats]:
    a, b, c = (places[corners[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    double = np.linalg.norm(cross, axis=1)
    normals = cross / np.maximum(double, 1e-30)[:, None]
    area = double / 2
    quadrics, weights = np.zeros((len(places), 10)), np.zeros(len(places))
    of_faces = _planes(normals, a, area)
    for k in range(3):
        np.add.at(quadrics, corners[:, k], of_faces * factor[corners[:, k], None])
        np.add.at(weights, corners[:, k], area * factor[corners[:, k]])
    # Borders and seams: a plane through the edge, across the triangle.
    edges, uses, of = _edges(corners)
    ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1)
    flipped = corners > np.roll(corners, -1, axis=1)
    ends = np.where(flipped[..., None], ends[..., ::-1], ends)
    low, high = (np.full(len(edges), -1), np.full(len(edges), -1))
    low[of], high[of] = ends[..., 0], ends[..., 1]
    differs = np.zeros(len(edges), bool)
    np.logical_or.at(differs, of, (ends[..., 0] != low[of]) | (ends[..., 1] != high[of]))
    weight = np.where(uses == 1, _BORDER, np.where(differs, _SEAM, 0.0))
    for k in range(3):
        mine = np.nonzero(weight[of[:, k]] > 0)[0]
        p, q = corners[mine, k], corners[mine, (k + 1) % 3]
        along = places[q] - places[p]
        across = np.cross(along, normals[mine])
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
        planes = _planes(across, places[p], weight[of[mine, k]] * np.sum(along * along, axis=1))
        np.add.at(quadrics, p, planes * factor[p, None])
        np.add.at(quadrics, q, planes * factor[q, None])
    return quadrics, weights


def _candidates(
    places: Floats, triangles: Ints, corners: Ints, quadrics: Floats, weights: Floats, traits: Floats | None
) -> tuple[Ints, Ints, Floats]:
    """Collapses that may be tried, from and to, by rising cost."""
    edges, uses, _ = _edges(corners)
    border, knotted = np.zeros(len(places), bool), np.zeros(len(places), bool)
    border[edges[uses == 1].reshape(-1)] = True
    knotted[edges[uses > 2].reshape(-1)] = True  # three surfaces meet: leave it
    froms, tos = (np.concatenate([edges[:, k], edges[:, 1 - k]]) for k in (0, 1))
    on_border = np.concatenate([uses == 1] * 2)
    allowed = ~knotted[froms] & (~border[froms] | on_border)
    froms, tos = froms[allowed], tos[allowed]
    x, y, z = places[tos].T
    q = (quadrics[froms] + quadrics[tos]).T
    costs = (
        q[0] * x * x + q[4] * y * y + q[7] * z * z + q[9]
        + 2 * (q[1] * x * y + q[2] * x * z + q[3] * x + q[5] * y * z + q[6] * y + q[8] * z)
    )  # fmt: skip
    length = np.sum((places[froms] - places[tos]) ** 2, axis=1)
    apart = np.full(len(froms), _SHAPE)
    if traits is not None:
        apart += _BEND * np.minimum(0.5 * np.abs(traits[froms] - traits[tos]).sum(axis=1), 1.0) ** 2
    costs = np.maximum(costs, 0.0) + apart * length * weights[froms]
    order = np.argsort(costs, kind="stable")
    return froms[order], tos[order], costs[order]
