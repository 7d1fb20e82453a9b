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
from keypose.deform.weights_sight import Sight
from keypose.deform.weights_solid import bent_ways
from keypose.deform.weights_surface import Surface, laplacian

_CANDIDATES = 8  # nearest bones that are looked at
_NEARLY = 1.1  # bones that are up to so many times as far as the nearest one share with it, the less the farther
_PULL = 0.25  # power of the thickness of a limb that makes its bones count as nearer
_DOUBT = (
    1.5  # where the nearest bone in sight is so many times as far as the nearest one, the way through the body counts
)
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


def sources_of(sight: Sight, used: Ints, bones: Bones, joint_count: int, strength: float) -> Sources:
    """The nearest visible bones of the points ``used`` (P,); where none is visible, the one nearest through the body.

    Bones of thick limbs count as nearer: the side of the trunk belongs to the spine, though the arm is beside it.
    """
    from scipy.sparse import coo_array

    solid, size_m, points = sight.solid, sight.surface.size_m, sight.surface.points[used]
    count = len(points)
    few = min(_CANDIDATES, bones.count)
    nearest = np.full((count, few), np.inf)
    which = np.zeros((count, few), np.int64)
    pull = solid.thickness(bones) ** _PULL
    lengths = np.zeros((count, few))
    closest = np.zeros(count)
    middles = (bones.starts + bones.ends) / 2
    rows = max(2_000_000 // max(bones.count, 1), 1)
    for begin in range(0, count, rows):
        part = slice(begin, begin + rows)
        places, distances = bones.nearest(points[part])
        pulled = distances / pull
        order = np.argpartition(pulled, few - 1, axis=1)[:, :few]
        order = np.take_along_axis(order, np.argsort(np.take_along_axis(pulled, order, 1), axis=1), 1)
        here = np.take_along_axis(pulled, order, axis=1)
        closest[part] = here[:, 0]
        lengths[part] = np.take_along_axis(distances, order, axis=1)
        goals = np.take_along_axis(places, order[..., None], axis=1)
        pending = np.arange(len(here))
        for k in range(few):  # a farther bone matters only where no nearer one is seen, or it is as near
            best = nearest[part][pending].min(axis=1)
            pending = pending[(here[pending, k] <= best * _NEARLY)]
            if not len(pending):
                break
            found = _seen(sight, used[part][pending], goals[pending, k], middles[order[pending, k]])
            nearest[begin + pending, k] = np.where(found, here[pending, k], np.inf)
        which[part] = order
    best = nearest.min(axis=1)
    seen = np.isfinite(best)
    bent = np.zeros(count, bool)
    doubtful = np.nonzero(best > _DOUBT * closest)[0]
    if len(doubtful):
        bone, ways = bent_ways(solid, points[doubtful], bones)
        pulled = np.where(bone >= 0, ways / pull[bone], np.inf)
        shorter = pulled < best[doubtful]
        lost, bone = doubtful[shorter], bone[shorter]
        nearest[lost] = np.inf
        which[lost, 0], lengths[lost, 0] = bone, ways[shorter]
        nearest[lost, 0] = best[lost] = pulled[shorter]
        bent[lost] = True
    tiny = _LEAST * size_m
    ratio = np.maximum(nearest, tiny) / np.where(seen | bent, np.maximum(best, tiny), 1.0)[:, None]
    parts = np.clip((_NEARLY - ratio) / (_NEARLY - 1.0), 0.0, 1.0)
    owners = bones.joints[which]
    for k in range(1, few):  # two bones of one joint are not two joints
        again = (owners[:, :k] == owners[:, k, None]) & (parts[:, :k] > 0)
        parts[again.any(axis=1), k] = 0.0
    parts /= np.maximum(parts.sum(axis=1, keepdims=True), 1e-30)
    at, k = np.nonzero(parts)
    shares = coo_array((parts[at, k], (at, owners[at, k])), (count, joint_count)).tocsr()
    way = np.take_along_axis(lengths, np.argmin(nearest, axis=1)[:, None], axis=1)[:, 0]
    heat = np.where(seen | bent, strength / np.clip(way, tiny, _FAR * size_m) ** 2, 0.0)
    return Sources(heat, shares, seen, bent)


def _seen(sight: Sight, points: Ints, goals: Floats, middles: Floats) -> Any:
    """Whether the nearest places on bones are in straight sight, or places as far again towards the bones' middles.

    At the end of a limb, straight across is along the surface.
    """
    found = sight.sees(points, goals)
    left = np.nonzero(~found)[0]
    inward = middles[left] - goals[left]
    lengths = np.linalg.norm(inward, axis=1)
    ways = np.minimum(lengths, np.linalg.norm(goals[left] - sight.surface.points[points[left]], axis=1))
    further = goals[left] + inward * (ways / np.maximum(lengths, 1e-30))[:, None]
    found[left] = sight.sees(points[left], further)
    return found


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
