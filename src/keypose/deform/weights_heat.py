"""Bone heat: which bones warm which point of the surface, and how the heat spreads over it.

Source: I. Baran, J. Popović, "Automatic rigging and animation of 3D characters", 2007, section 4 (heat equilibrium
``-Δw + H w = H p``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.deform.weights_bones import Bones
from keypose.deform.weights_solid import Solid, bent_ways
from keypose.deform.weights_surface import Surface, laplacian

_CANDIDATES = 8  # nearest bones that are looked at
_EQUAL = 1.001  # bones so near to each other's distance share
_PULL = 0.25  # power of the thickness of a limb that makes its bones count as nearer
_FAR = 0.02  # of the size; what is farther from its bone is no colder: thick limbs would blend all over
_LEAST = 1e-4  # of the size: what is nearer to a bone is no warmer
_RIGHT_HAND_SIDES = 32  # solved at a time, between two reports of progress


@dataclass(frozen=True, slots=True)
class Sources:
    """What warms P points.

    Shapes and units: ``heat`` (P,) 1/m^2; ``shares`` (P, J) sparse, rows summing to 1 where heat is not 0;
    ``seen`` (P,) whether a bone is in straight sight; ``bent`` (P,) whether it was found around corners.
    """

    heat: Floats
    shares: Any
    seen: Any
    bent: Any

    def rows(self, flags: Any) -> Sources:
        """Those of the points that are flagged (P,)."""
        return Sources(self.heat[flags], self.shares[flags], self.seen[flags], self.bent[flags])


def sources_of(points: Floats, size_m: float, bones: Bones, joint_count: int, solid: Solid, strength: float) -> Sources:
    """The nearest visible bones of points (P, 3); where none is visible, the one nearest through the body.

    Bones of thick limbs count as nearer: the side of the trunk belongs to the spine, though the arm is beside it.
    """
    from scipy.sparse import coo_array

    count = len(points)
    few = min(_CANDIDATES, bones.count)
    nearest = np.full((count, few), np.inf)
    which = np.zeros((count, few), np.int64)
    pull = solid.thickness(bones) ** _PULL
    lengths = np.zeros((count, few))
    rows = max(2_000_000 // max(bones.count, 1), 1)
    for begin in range(0, count, rows):
        part = slice(begin, begin + rows)
        places, distances = bones.nearest(points[part])
        pulled = distances / pull
        order = np.argpartition(pulled, few - 1, axis=1)[:, :few]
        order = np.take_along_axis(order, np.argsort(np.take_along_axis(pulled, order, 1), axis=1), 1)
        here = np.take_along_axis(pulled, order, axis=1)
        lengths[part] = np.take_along_axis(distances, order, axis=1)
        goals = np.take_along_axis(places, order[..., None], axis=1)
        pending = np.arange(len(here))
        for k in range(few):  # a farther bone matters only where no nearer one is seen, or it is as near
            best = nearest[part][pending].min(axis=1)
            pending = pending[(here[pending, k] <= best * _EQUAL)]
            if not len(pending):
                break
            sight = solid.straight(points[part][pending], goals[pending, k])
            nearest[begin + pending, k] = np.where(sight, here[pending, k], np.inf)
        which[part] = order
    best = nearest.min(axis=1)
    seen = np.isfinite(best)
    bent = np.zeros(count, bool)
    lost = np.nonzero(~seen)[0]
    if len(lost):
        bone, ways = bent_ways(solid, points[lost], bones)
        reached = bone >= 0
        which[lost[reached], 0] = bone[reached]
        nearest[lost[reached], 0] = best[lost[reached]] = ways[reached] / pull[bone[reached]]
        lengths[lost[reached], 0] = ways[reached]
        bent[lost[reached]] = True
    equal = (nearest <= best[:, None] * _EQUAL) & np.isfinite(nearest)
    at, k = np.nonzero(equal)
    shares = coo_array((1.0 / equal.sum(axis=1)[at], (at, bones.joints[which[at, k]])), (count, joint_count)).tocsr()
    shares.data = np.minimum(shares.data, 1.0)
    shares = _by_joint(shares)
    way = np.where(equal, lengths, np.inf).min(axis=1)
    heat = np.where(np.isfinite(way), strength / np.clip(way, _LEAST * size_m, _FAR * size_m) ** 2, 0.0)
    return Sources(heat, shares, seen, bent)


def _by_joint(shares: Any) -> Any:
    """Rows that sum to 1 again: two bones of one joint are not two joints."""
    from scipy.sparse import csr_array

    shares = csr_array((np.ones_like(shares.data), shares.indices, shares.indptr), shares.shape)
    totals = np.asarray(shares.sum(axis=1)).reshape(-1)
    shares.data /= np.repeat(totals, np.diff(shares.indptr))
    return shares


def spread(surface: Surface, triangles: Ints, used: Ints, sources: Sources, progress: Any = None) -> Floats:
    """The equilibrium of heat at the points ``used`` (U,) of a surface, all in ``triangles``, with their sources: (U, J)."""
    from scipy.sparse import csc_array, dia_array
    from scipy.sparse.linalg import splu

    place = np.full(len(surface.points), -1, np.int64)
    place[used] = np.arange(len(used))
    stiffness, lumped = laplacian(surface.points[used], place[triangles])
    warmth = lumped * sources.heat
    system = csc_array(stiffness + dia_array((warmth[None], [0]), (len(used), len(used))))
    factors = splu(system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    right = (sources.shares.multiply(warmth[:, None])).tocsc()
    out = np.zeros((len(used), right.shape[1]))
    columns = np.nonzero(np.diff(right.indptr))[0]
    for begin in range(0, len(columns), _RIGHT_HAND_SIDES):
        some = columns[begin : begin + _RIGHT_HAND_SIDES]
        out[:, some] = factors.solve(right[:, some].toarray())
        if progress is not None:
            progress(begin + len(some), len(columns))
    out = np.clip(out, 0.0, None)
    return out / out.sum(axis=1, keepdims=True)
