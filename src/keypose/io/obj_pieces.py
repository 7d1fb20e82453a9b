"""From corners that index positions, texture coordinates and normals apart, to vertices that a `Mesh` has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.model import MorphSet


@dataclass(frozen=True, slots=True)
class Piece:
    """The vertices and triangles of one part.

    Shapes and units: ``positions``, ``uvs``, ``normals`` (V,) indices into the file's lists, -1 for none;
    ``triangles`` (T, 3) indices of vertices.
    """

    positions: Ints
    uvs: Ints
    normals: Ints
    triangles: Ints


def piece(corners: Ints, triangles: Ints) -> Piece:
    """One vertex for each combination of position, texture coordinate and normal that the triangles use.

    Vertices are in the order of their positions in the file, so that a mesh without seams keeps the file's order.

    Shapes and units: ``corners`` (C, 3); ``triangles`` (T, 3) indices of corners.
    """
    used, place = np.unique(triangles, return_inverse=True)
    rows = corners[used]
    widths = rows.max(axis=0, initial=0) + 2
    key = ((rows[:, 0] * widths[1]) + rows[:, 1] + 1) * widths[2] + rows[:, 2] + 1
    _, first, vertex = np.unique(key, return_index=True, return_inverse=True)
    kept = rows[first]
    return Piece(kept[:, 0], kept[:, 1], kept[:, 2], vertex[place].reshape(-1, 3))


def picked(rows: Floats, index: Ints) -> Floats | None:
    """The rows of an index that may hold -1 for none; None where no vertex has one, zeros for the few that have not."""
    has = index >= 0
    if not len(index) or not has.any():
        return None
    return np.where(has[:, None], rows[np.maximum(index, 0)], 0.0)


def sparse_targets(
    names: list[str], moved: list[tuple[Ints, Floats]], sources: Ints, normals: list[Floats] | None = None
) -> MorphSet | None:
    """Targets over the file's positions as targets over a piece's vertices; None where none of them moves the piece.

    Shapes and units: ``moved`` per target the positions' indices (N,) and deltas (N, 3); ``sources`` (V,) the position
    of each vertex; ``normals`` per target dense deltas (P, 3) over all positions.
    """
    count = int(max([int(sources.max(initial=-1)), *(int(index.max(initial=-1)) for index, _ in moved)])) + 1
    starts, vertices, deltas, turns = [0], [], [], []
    dense = np.zeros((count, 3))
    for number, (index, delta) in enumerate(moved):
        dense[index] = delta
        change = dense[sources]
        turned = None if normals is None else normals[number][sources]
        hit = np.any(change != 0, axis=1)
        if turned is not None:
            hit |= np.any(np.abs(turned) > 1e-6, axis=1)
            turns.append(turned[hit])
        found = np.nonzero(hit)[0]
        vertices.append(found)
        deltas.append(change[found])
        starts.append(starts[-1] + len(found))
        dense[index] = 0.0
    if not starts[-1]:
        return None
    return MorphSet(
        tuple(names),
        np.array(starts),
        np.concatenate(vertices),
        np.concatenate(deltas).astype(np.float32),
        np.concatenate(turns).astype(np.float32) if turns else None,
    )
