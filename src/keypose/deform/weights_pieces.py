"""The pieces of a surface: which are warmed by bones, which go along with others, which belong to one joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.deform.weights_bones import Bones
from keypose.deform.weights_nearest import nearest_on, windings
from keypose.deform.weights_surface import Surface
from keypose.model import Skeleton

_BESIDE = 0.02  # of the size; what is no farther from the body than that, and holds no bone, goes along with it
_MOSTLY = 90  # percent of its points
_AT_ONE_PLACE = 0.4  # of the piece's size: what touches the body in no more than that is held there
_OF_A_JOINT = 0.1  # of the size; a piece so small around a leaf joint is that joint's own, as eyes are
_CENTRED = 0.2  # of the piece's size, how near to its middle that joint is
_AROUND = 0.5  # winding number
_AT_ONCE = 16
_PLACES = (0.25, 0.5, 0.75)  # along a bone


def _none() -> list[int]:
    return []


@dataclass(slots=True)
class Pieces:
    """Numbers of the shells of each kind; ``owner`` is the joint of each that has one of its own.

    ``held`` are things that touch the body at one place, as what a hand holds: they do not bend, and go along with the
    body there; with the points that touch.
    """

    heated: list[int] = field(default_factory=_none)
    attached: list[int] = field(default_factory=_none)
    held: dict[int, Ints] = field(default_factory=dict[int, Ints])
    owner: dict[int, int] = field(default_factory=dict[int, int])


def sort_pieces(surface: Surface, skeleton: Skeleton, places: Floats, joints: Sequence[int], bones: Bones) -> Pieces:
    """Sort the shells of a surface; ``places`` (J, 3) are those of the joints, ``joints`` those that may move anything."""
    order = np.argsort(surface.shell_of, kind="stable")
    rows = np.split(order, np.cumsum(np.bincount(surface.shell_of, minlength=surface.shell_count))[:-1])
    own_triangles = surface.shell_of[surface.triangles[:, 0]]
    leaves = [j for j in joints if not np.any(skeleton.parents == j)]
    samples = np.concatenate([bones.starts + (bones.ends - bones.starts) * share for share in _PLACES])
    found = Pieces()
    waiting: list[int] = []
    for shell, mine in enumerate(rows):
        low, high = surface.points[mine].min(axis=0), surface.points[mine].max(axis=0)
        size = float(np.linalg.norm(high - low))
        joint = _joint_in_middle(places, leaves, (low + high) / 2, size) if shell else None
        if joint is not None and size < _OF_A_JOINT * surface.size_m:
            found.owner[shell] = joint
            continue
        triangles = surface.triangles[own_triangles == shell]
        if not shell and len(triangles):
            found.heated.append(shell)
            continue
        if len(triangles) and _around_any(surface.points, triangles, samples, low, high):
            found.heated.append(shell)
        else:
            waiting.append(shell)
    body = surface.triangles_of(np.isin(np.arange(surface.shell_count), [*found.heated, *found.owner]))
    for shell in waiting:
        mine = rows[shell]
        if not np.any(own_triangles == shell) or not len(body):
            found.attached.append(shell)
            continue
        _, _, ways = nearest_on(surface.points, body, surface.points[mine])
        if np.percentile(ways, _MOSTLY) < _BESIDE * surface.size_m:
            found.attached.append(shell)
            continue
        touching = mine[ways <= ways.min() + _BESIDE * surface.size_m]
        extents = [float(np.linalg.norm(np.ptp(surface.points[part], axis=0))) for part in (touching, mine)]
        if extents[0] < _AT_ONE_PLACE * extents[1]:
            found.held[shell] = touching
        else:
            found.heated.append(shell)
    return found


def _around_any(points: Floats, triangles: Ints, samples: Floats, low: Floats, high: Floats) -> bool:
    """Whether a shell with this box goes around any of the places; those in its middle are tried first."""
    samples = samples[np.all((samples > low) & (samples < high), axis=1)]
    samples = samples[np.argsort(np.linalg.norm(samples - (low + high) / 2, axis=1))]
    return any(
        np.abs(windings(points, triangles, samples[begin : begin + _AT_ONCE])).max() > _AROUND
        for begin in range(0, len(samples), _AT_ONCE)
    )


def _joint_in_middle(places: Floats, leaves: list[int], middle: Floats, size: float) -> int | None:
    if not leaves or size <= 0:
        return None
    ways = np.linalg.norm(places[leaves] - middle, axis=1)
    nearest = int(np.argmin(ways))
    return leaves[nearest] if ways[nearest] < _CENTRED * size else None
