"""The inside of a body as voxels: what is enclosed even by open and overlapping meshes, straight and bent ways in it.

Source: O. Dionne, M. de Lasa, "Geodesic voxel binding for production character meshes", 2013 (solid voxels and distances
through them).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.deform.weights_bones import Bones
from keypose.deform.weights_surface import Surface

_WALLS = 5  # of the six directions along the axes; so many walls enclose a voxel of an open mesh
_COARSE = 2  # voxels to a cell of the grid of winding numbers
_STEP = 0.5  # of a voxel, along a straight way
_PLACES = 17  # looked at along a bone
_AROUND = 16  # directions across it
_VOXELS = (400_000, 2_000_000)  # at least, at most
_CHUNK = 4_000_000  # samples at a time


@dataclass(frozen=True, slots=True)
class Solid:
    """Voxels of the body and of its surface.

    Shapes and units: ``filled`` (X, Y, Z) bool; ``origin_m`` (3,) the corner of the first voxel; ``voxel_m`` its edge.
    """

    filled: Any
    origin_m: Floats
    voxel_m: float

    def cells(self, points: Floats) -> Ints:
        """The voxels (..., 3) of points, clipped to the box."""
        cells = np.floor((points - self.origin_m) / self.voxel_m).astype(np.int64)
        return np.clip(cells, 0, np.array(self.filled.shape) - 1)

    def holds(self, points: Floats) -> Any:
        """Whether points (..., 3) are in filled voxels."""
        cells = self.cells(points)
        return self.filled[cells[..., 0], cells[..., 1], cells[..., 2]]

    def reach(self, starts: Floats, directions: Floats, longest: float) -> Floats:
        """How far one can go from places (..., 3) along unit directions (..., 3) in filled voxels, (...) metres."""
        steps = np.arange(0.0, longest + self.voxel_m, self.voxel_m * _STEP)
        held = self.holds(np.asarray(starts)[..., None, :] + np.asarray(directions)[..., None, :] * steps[:, None])
        return np.minimum(np.where(held.all(axis=-1), longest, steps[np.argmin(held, axis=-1)]), longest)

    def inside_shares(self, bones: Bones) -> Floats:
        """The share (B,) of every bone that is in filled voxels."""
        places = bones.starts + (bones.ends - bones.starts) * np.linspace(0.0, 1.0, _PLACES)[:, None, None]
        return self.holds(places).mean(axis=0)

    def thickness(self, bones: Bones) -> Floats:
        """How far the surface is from every bone (B,), across it: the median; of bones outside, that of all others."""
        along = bones.ends - bones.starts
        lengths = np.linalg.norm(along, axis=1)
        along = np.where(lengths[:, None] > 0, along / np.maximum(lengths, 1e-30)[:, None], [1.0, 0.0, 0.0])
        across = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        other = np.cross(along, across)
        angles = np.linspace(0.0, 2 * np.pi, _AROUND, endpoint=False)
        spokes = np.cos(angles)[:, None, None] * across + np.sin(angles)[:, None, None] * other
        found = np.full((5, _AROUND, bones.count), np.nan)
        longest = 0.25 * float(np.linalg.norm(np.array(self.filled.shape))) * self.voxel_m
        for k, share in enumerate((0.2, 0.35, 0.5, 0.65, 0.8)):
            places = bones.starts + (bones.ends - bones.starts) * share
            held = self.holds(places)
            found[k][:, held] = self.reach(places[held], spokes[:, held], longest)
        rows = np.isfinite(found).any(axis=(0, 1))
        if not rows.any():
            return np.ones(bones.count)
        medians = np.full(bones.count, np.nan)
        medians[rows] = np.nanmedian(found[:, :, rows], axis=(0, 1))
        return np.maximum(np.where(rows, medians, np.nanmedian(medians)), self.voxel_m)


def solid_of(surface: Surface, voxels: int | None = None) -> Solid:
    """The solid of a surface, of about ``voxels`` in the box around it; fewer for coarse meshes if not given."""
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    extent = np.maximum(high - low, 0.02 * surface.size_m)
    if voxels is None:
        spacing = max(float(surface.areas.sum()) / len(surface.points), 1e-12 * surface.size_m**2) ** 0.5
        voxels = int(np.clip(np.prod(extent) / (spacing / 2) ** 3, *_VOXELS))
    edge = float(np.cbrt(np.prod(extent) / voxels))
    low = (low + high - extent) / 2 - 2.5 * edge
    shape = np.ceil(extent / edge).astype(int) + 5
    wall = np.zeros(shape, bool)
    solid = Solid(wall, low, edge)
    loose = solid.cells(surface.points)
    wall[loose[:, 0], loose[:, 1], loose[:, 2]] = True
    for points in _samples(surface, edge * 0.5):
        cells = solid.cells(points)
        wall[cells[:, 0], cells[:, 1], cells[:, 2]] = True
    filled = _filled(wall)
    if not surface.closed.all() and len(surface.triangles):
        filled[1:-1, 1:-1, 1:-1] |= _wound(surface, low, edge, wall.shape)[1:-1, 1:-1, 1:-1]  # the margin stays empty
    return Solid(filled, low, edge)


def _samples(surface: Surface, spacing: float) -> Any:
    """Points all over the triangles, at most ``spacing`` apart."""
    corners = surface.points[surface.triangles]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    parts = np.maximum(np.ceil(sides / spacing).astype(int), 1)
    for count in np.unique(parts):
        i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
        use = i + j <= count
        shares = np.stack([i[use], j[use], count - i[use] - j[use]], axis=1) / count
        mine = corners[parts == count]
        rows = max(_CHUNK // len(shares), 1)
        for begin in range(0, len(mine), rows):
            yield np.einsum("sk,tkc->tsc", shares, mine[begin : begin + rows]).reshape(-1, 3)


def _filled(wall: Any) -> Any:
    """Walls, what they enclose, and what has walls on at least five of its six sides, for meshes with openings."""
    from scipy import ndimage

    label: Any = ndimage.label(~wall)[0]  # type: ignore[index]
    enclosed = ~wall & (label != label[0, 0, 0])
    sides = np.zeros(wall.shape, np.int8)
    for axis in range(3):
        sides += np.logical_or.accumulate(wall, axis=axis)
        sides += np.flip(np.logical_or.accumulate(np.flip(wall, axis), axis=axis), axis)
    return wall | enclosed | (sides >= _WALLS)


def _wound(surface: Surface, origin_m: Floats, edge: float, shape: tuple[int, ...]) -> Any:
    """The voxels that the surface goes around by more than half, for meshes with openings and holes.

    The winding number is the field of the triangles' area vectors as dipoles; it is summed up by a convolution, on a grid
    half as fine.

    Source: A. Jacobson, L. Kavan, O. Sorkine-Hornung, "Robust inside-outside segmentation using generalized winding
    numbers", 2013; G. Barill et al., "Fast winding numbers for soups and clouds", 2018 (dipoles).
    """
    from scipy import fft

    cell = edge * _COARSE
    count = [-(-n // _COARSE) for n in shape]
    corners = surface.points[surface.triangles]
    vectors = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / cell**2
    # A large triangle is several dipoles: at its corners' middles and its own.
    marks = np.concatenate(
        [(corners + corners.mean(axis=1, keepdims=True)) / 2, corners.mean(axis=1, keepdims=True)], 1
    )
    places = (marks.reshape(-1, 3) - origin_m) / cell - 0.5
    amounts = np.repeat(vectors / marks.shape[1], marks.shape[1], axis=0)
    base = np.floor(places).astype(np.int64)
    share = places - base
    size = [int(fft.next_fast_len(2 * n, real=True)) for n in count]  # type: ignore[arg-type]
    around = np.meshgrid(
        *(np.where(np.arange(n) < n // 2, np.arange(n), np.arange(n) - n) for n in size), indexing="ij"
    )
    distance = np.sqrt(sum(np.square(x, dtype=np.float32) for x in around))
    distance[0, 0, 0] = np.inf
    total: Any = 0.0
    for axis in range(3):
        field = np.zeros(count, np.float32)
        for corner in np.ndindex(2, 2, 2):
            weight = np.where(corner, share, 1.0 - share).prod(axis=1)
            at = np.clip(base + corner, 0, np.array(count) - 1)
            np.add.at(field, tuple(at.T), (weight * amounts[:, axis]).astype(np.float32))
        kernel = (around[axis] / (-4.0 * np.pi * distance**3)).astype(np.float32)
        transformed: Any = fft.rfftn(field, size)
        total = total + transformed * fft.rfftn(kernel)
    winding: Any = fft.irfftn(total, size)
    winding = winding[: count[0], : count[1], : count[2]]
    for axis in range(3):
        winding = np.repeat(winding, _COARSE, axis=axis)
    return np.abs(winding[: shape[0], : shape[1], : shape[2]]) > 0.5


def bent_ways(solid: Solid, points: Floats, bones: Bones) -> tuple[Ints, Floats]:
    """For each point (N,) the bone that is nearest through the solid, and how far that is; -1 and infinity if none is."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    cells = np.argwhere(solid.filled)
    number = np.full(solid.filled.shape, -1, np.int64)
    number[tuple(cells.T)] = np.arange(len(cells))
    rows: list[Ints] = []
    columns: list[Ints] = []
    lengths: list[Floats] = []
    around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    for shift in around[14:]:  # one of each two opposite ones
        there = number[tuple((cells + shift).T)]  # the box has an empty margin
        have = there >= 0
        rows.append(np.nonzero(have)[0])
        columns.append(there[have])
        lengths.append(np.full(int(have.sum()), float(np.linalg.norm(shift)) * solid.voxel_m))
    data = (np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns)))
    graph = coo_array(data, (len(cells), len(cells))).tocsr()
    owner = np.full(len(cells), -1, np.int64)
    for bone in range(bones.count):
        start, end = bones.starts[bone], bones.ends[bone]
        steps = max(int(np.ceil(np.linalg.norm(end - start) / (solid.voxel_m * _STEP))), 1)
        there = start + (end - start) * np.linspace(0, 1, steps + 1)[:, None]
        own = number[tuple(solid.cells(there[solid.holds(there)]).T)]
        owner[own[owner[own] < 0]] = bone
    sources = np.nonzero(owner >= 0)[0]
    found = np.full(len(points), -1, np.int64)
    distances = np.full(len(points), np.inf)
    if not len(sources):
        return found, distances
    ways, _, origin = dijkstra(graph, directed=False, indices=sources, return_predecessors=True, min_only=True)
    mine = number[tuple(solid.cells(points).T)]
    reached = (mine >= 0) & np.isfinite(ways[mine])
    found[reached] = owner[origin[mine[reached]]]
    distances[reached] = np.maximum(ways[mine[reached]], solid.voxel_m * 0.5)
    return found, distances
