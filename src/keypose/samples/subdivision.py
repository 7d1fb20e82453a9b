"""Control cages and Catmull-Clark subdivision: how the built-in human's smooth forms are modelled.

A `Cage` is a coarse mesh of quads (a few n-gons as caps) whose points are where the finished surface shall pass;
every point carries its joint weights and every face a group name, and both are carried through the subdivision.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from keypose.arrays import Floats, Ints

Weights = Mapping[str, float]


@dataclass(slots=True)
class Cage:
    """A control mesh under construction: points, their joint weights by name, faces and their groups."""

    points: list[Floats] = field(default_factory=list[Floats])
    weights: list[dict[str, float]] = field(default_factory=list[dict[str, float]])
    faces: list[tuple[int, ...]] = field(default_factory=list[tuple[int, ...]])
    groups: list[str] = field(default_factory=list[str])

    def add(self, point: Any, weights: Weights) -> int:
        """A new point; returns its index."""
        self.points.append(np.asarray(point, np.float64))
        total = sum(weights.values())
        self.weights.append({joint: w / total for joint, w in weights.items()})
        return len(self.points) - 1

    def ring(self, points: Any, weights: Weights | Sequence[Weights]) -> list[int]:
        """New points with common weights, or weights of their own."""
        each = [weights] * len(points) if isinstance(weights, Mapping) else weights
        return [self.add(p, w) for p, w in zip(points, each, strict=True)]

    def face(self, corners: Sequence[int], group: str) -> None:
        """A face, counter-clockwise seen from outside."""
        self.faces.append(tuple(corners))
        self.groups.append(group)

    def bridge(self, near: Sequence[int], far: Sequence[int], group: str, closed: bool = True) -> None:
        """Quads between two rows of points; rows run so that (along the row) x (near to far) points outside."""
        count = len(near)
        for k in range(count if closed else count - 1):
            n = (k + 1) % count
            self.face((near[k], near[n], far[n], far[k]), group)

    def mirrored(self) -> Cage:
        """The cage with its mirror image in x = 0 added; points on that plane are shared."""
        whole = Cage(list(self.points), list(self.weights), list(self.faces), list(self.groups))
        image: list[int] = []
        for i, (point, weights) in enumerate(zip(self.points, self.weights, strict=True)):
            if abs(point[0]) < 1e-9:
                image.append(i)
                swapped = mirrored_weights(weights)
                whole.weights[i] = {
                    j: (weights.get(j, 0.0) + swapped.get(j, 0.0)) / 2 for j in dict.fromkeys([*weights, *swapped])
                }
            else:
                image.append(whole.add(point * (-1, 1, 1), mirrored_weights(weights)))
        for corners, group in zip(self.faces, self.groups, strict=True):
            whole.face([image[c] for c in reversed(corners)], group)
        return whole


def mirrored_name(name: str) -> str:
    """The joint of the other side; a middle joint is its own mirror image."""
    if name.startswith("Left"):
        return "Right" + name[4:]
    return "Left" + name[5:] if name.startswith("Right") else name


def mirrored_weights(weights: Weights) -> dict[str, float]:
    """The same weights for the other side."""
    return {mirrored_name(joint): w for joint, w in weights.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A finished surface: points (V, 3), quads (Q, 4) with a group each, weights (V, J), all float64."""

    points: Floats
    quads: Ints
    groups: tuple[str, ...]
    weights: Floats


def triangulated(quads: Ints, points: Floats) -> Ints:
    """Two triangles per quad, split along the shorter diagonal."""
    a, b, c, d = (points[quads[:, i]] for i in range(4))
    short = np.sum((a - c) ** 2, 1) <= np.sum((b - d) ** 2, 1) * (1 + 1e-9)
    first = np.where(short[:, None], quads[:, [0, 1, 2]], quads[:, [0, 1, 3]])
    second = np.where(short[:, None], quads[:, [0, 2, 3]], quads[:, [1, 2, 3]])
    return np.stack([first, second], 1).reshape(-1, 3)


def subdivide(cage: Cage, joint_names: Sequence[str], levels: int = 1) -> Surface:
    """The Catmull-Clark surface through the cage's points, on the limit surface of ``levels`` subdivisions.

    Source: E. Catmull, J. Clark, "Recursively generated B-spline surfaces on arbitrary topological meshes", 1978;
    limit points: M. Halstead, M. Kass, T. DeRose, "Efficient, fair interpolation using Catmull-Clark surfaces",
    1993, section 3.
    """
    target = np.array(cage.points)
    faces: list[tuple[int, ...]] | Ints = cage.faces
    groups = list(cage.groups)
    count = len(target)
    refine: Any = None
    for _ in range(levels):
        step, faces, repeats = _refinement(faces, count)
        groups = [g for g, n in zip(groups, repeats, strict=True) for _ in range(n)]
        refine = step if refine is None else step @ refine
        count = step.shape[0]
    quads = np.array(faces)
    to_limit = (_limit(quads, count) @ refine).tocsr()
    # Move the control points until the surface passes through the designed places. The plain iteration leaves the
    # highest frequencies alone, which keeps the interpolating surface from rippling.
    control = target.copy()
    at_cage = to_limit[: len(target)]
    for _ in range(12):
        control += target - at_cage @ control
    column = {name: j for j, name in enumerate(joint_names)}
    weights = np.zeros((len(target), len(joint_names)))
    for i, row in enumerate(cage.weights):
        for name, w in row.items():
            weights[i, column[name]] = w
    return Surface(to_limit @ control, quads, tuple(groups), np.maximum(to_limit @ weights, 0))


def _refinement(faces: Any, count: int) -> tuple[Any, Ints, Ints]:
    """One Catmull-Clark step: the (new, old) matrix, the new quads, and how many came from each face."""
    from scipy import sparse

    sizes = np.array([len(f) for f in faces])
    corners = np.concatenate([np.asarray(f) for f in faces])
    face_of = np.repeat(np.arange(len(sizes)), sizes)
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    place = np.arange(len(corners)) - starts[face_of]
    following = corners[starts[face_of] + (place + 1) % sizes[face_of]]
    preceding_slot = starts[face_of] + (place - 1) % sizes[face_of]
    pairs = np.sort(np.stack([corners, following], 1), 1)
    edges, edge_of = np.unique(pairs, axis=0, return_inverse=True)
    edge_of = edge_of.reshape(-1)
    uses = np.bincount(edge_of, minlength=len(edges))
    face_points = sparse.csr_array((1 / sizes[face_of], (face_of, corners)), (len(sizes), count))
    middles = sparse.csr_array(
        (np.full(2 * len(edges), 0.5), (np.repeat(np.arange(len(edges)), 2), edges.reshape(-1))), (len(edges), count)
    )
    inner = uses == 2
    around = sparse.csr_array((np.where(inner[edge_of], 0.25, 0.0), (edge_of, face_of)), (len(edges), len(sizes)))
    edge_points = sparse.diags_array(np.where(inner, 0.5, 1.0)) @ middles + around @ face_points
    # Points: inner (F + 2 R + (n - 3) P) / n; on a border a cubic B-spline along it.
    border = np.zeros(count, bool)
    border[edges[~inner].reshape(-1)] = True
    valence = np.maximum(np.bincount(corners, minlength=count), 1)
    inside = np.where(border, 0.0, 1.0)
    mean_faces = sparse.csr_array((inside[corners] / valence[corners], (corners, face_of)), (count, len(sizes)))
    ends = edges.reshape(-1)
    mean_edges = sparse.csr_array(
        (inside[ends] / valence[ends], (ends, np.repeat(np.arange(len(edges)), 2))), (count, len(edges))
    )
    per_point = sparse.diags_array(1 / valence)
    points = per_point @ (mean_faces @ face_points + 2 * (mean_edges @ middles))
    points = points + sparse.diags_array(inside * (valence - 3) / valence)
    rim = edges[~inner]
    rows = np.concatenate([rim[:, 0], rim[:, 1], np.nonzero(border)[0]])
    columns = np.concatenate([rim[:, 1], rim[:, 0], np.nonzero(border)[0]])
    values = np.concatenate([np.full(2 * len(rim), 0.125), np.full(int(border.sum()), 0.75)])
    points = points + sparse.csr_array((values, (rows, columns)), (count, count))
    matrix = sparse.vstack([points, edge_points, face_points]).tocsr()
    quads = np.stack(
        [
            corners,
            count + edge_of,
            count + len(edges) + face_of,
            count + edge_of[preceding_slot],
        ],
        1,
    )
    return matrix, quads, sizes


def _limit(quads: Ints, count: int) -> Any:
    """The (V, V) matrix that moves the points of an all-quad mesh onto its limit surface."""
    from scipy import sparse

    corner = quads.reshape(-1)
    ahead = np.roll(quads, -1, 1).reshape(-1)
    across = np.roll(quads, -2, 1).reshape(-1)
    pairs = np.sort(np.stack([corner, ahead], 1), 1)
    edges, uses = np.unique(pairs, axis=0, return_counts=True)
    rim = edges[uses == 1]
    border = np.zeros(count, bool)
    border[rim.reshape(-1)] = True
    valence = np.bincount(corner, minlength=count).astype(np.float64)
    inside = ~border
    weight = np.where(inside, 1 / np.maximum(valence * (valence + 5), 1), 0)
    both = np.concatenate([edges, edges[:, ::-1]])
    matrix = sparse.csr_array((4 * weight[both[:, 0]], (both[:, 0], both[:, 1])), (count, count))
    matrix = matrix + sparse.csr_array((weight[corner], (corner, across)), (count, count))
    matrix = matrix + sparse.diags_array(np.where(inside, valence * valence * weight, 4 / 6))
    both = np.concatenate([rim, rim[:, ::-1]])
    return matrix + sparse.csr_array((np.full(len(both), 1 / 6), (both[:, 0], both[:, 1])), (count, count))
