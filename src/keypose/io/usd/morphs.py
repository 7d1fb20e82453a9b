"""Blend shapes as morph targets; a shape with in-betweens becomes one target for each of its keys.

Source: Pixar, "UsdSkel Schemas", section "Blend Shapes".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.errors import FormatError
from keypose.io.guarded import Record, sane
from keypose.io.notes import Notes, UniqueNames
from keypose.io.usd.hierarchy import inverted
from keypose.model import MorphSet


@dataclass(frozen=True, slots=True)
class Channel:
    """What one weight of the file drives: a morph channel for each of the keys of its shapes."""

    stops: tuple[float, ...]  # weights at which the keys are reached, the whole shape's first
    morphs: tuple[int, ...]


@dataclass(slots=True)
class Morphs:
    """The morph channels of the character; those of one skeleton, name and set of in-betweens are one."""

    names: list[str] = field(default_factory=list[str])
    channels: dict[tuple[int, str], list[Channel]] = field(default_factory=dict[tuple[int, str], list[Channel]])
    of_mesh: dict[int, list[Channel]] = field(default_factory=dict[int, list[Channel]])


def build(record: Record, same: Mapping[int, int], notes: Notes) -> Morphs:
    """The channels of all meshes, in the order of the file or, where keypose wrote it, of the character.

    ``same`` says which skeletons are one.
    """
    found, unique = Morphs(), UniqueNames()
    for name in _own_order(record, same):
        found.names.append(unique.add(name))
    for number, mesh in enumerate(record.facts["meshes"]):
        mine = found.of_mesh[number] = []
        for shape in mesh["shapes"]:
            keys = shape["keys"]
            stops = tuple(float(key["weight"]) for key in keys)
            if not sane(np.array(stops)) or 0.0 in stops or len(set(stops)) != len(stops):
                raise FormatError("an in-between has an impossible weight", where=f"blend shape '{shape['name']}'")
            skeleton = int(mesh["skeleton"])
            known = found.channels.setdefault((same.get(skeleton, skeleton), str(shape["name"])), [])
            channel = next((c for c in known if c.stops == stops and c not in mine), None)
            if channel is None:
                names = _key_names(str(shape["name"]), stops, notes)
                channel = Channel(stops, tuple(_place(found, unique, name, notes) for name in names))
                known.append(channel)
            mine.append(channel)
    return found


def _own_order(record: Record, same: Mapping[int, int]) -> list[str]:
    """The names of morph channels that keypose has written, if it was one character."""
    own = [record.facts["prims"][prim]["own"] or {} for prim in sorted(set(same.values()))]
    names = [o["morphs"] for o in own if isinstance(o.get("morphs"), list)]
    if len(names) != 1 or len(set(names[0])) != len(names[0]) or not all(isinstance(n, str) for n in names[0]):
        return []
    return names[0]


def _place(found: Morphs, unique: UniqueNames, name: str, notes: Notes) -> int:
    taken = {m for channels in found.channels.values() for c in channels for m in c.morphs}
    if name in found.names and found.names.index(name) not in taken:
        return found.names.index(name)
    found.names.append(unique.add(name))
    if found.names[-1] != name:
        notes.add(f"blend shape '{name}' appears more than once; one became '{found.names[-1]}'")
    return len(found.names) - 1


def _key_names(name: str, stops: Sequence[float], notes: Notes) -> list[str]:
    names = [name, *(f"{name}@{stop:g}" for stop in stops[1:])]
    if len(names) > 1:
        notes.add(f"blend shape '{name}': its in-betweens became targets of their own, {', '.join(names[1:])}")
    return names


def amounts(stops: Sequence[float], weights: Floats) -> list[Floats]:
    """How much of each key is added at weights (T,): K arrays (T,).

    Between two neighbouring keys, nothing at 0 among them, the amounts change linearly; beyond the outermost they go on.
    """
    if len(stops) == 1:
        return [weights / stops[0]]
    order = np.argsort([0.0, *stops], kind="stable")
    sorted_stops = np.array([0.0, *stops])[order]
    span = np.clip(np.searchsorted(sorted_stops, weights, side="right") - 1, 0, len(sorted_stops) - 2)
    share = (weights - sorted_stops[span]) / (sorted_stops[span + 1] - sorted_stops[span])
    rank = {int(k): place for place, k in enumerate(order)}
    return [
        np.where(span + 1 == rank[k + 1], share, np.where(span == rank[k + 1], 1 - share, 0.0))
        for k in range(len(stops))
    ]


def with_turning_points(stops: Sequence[float], times: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Times and weights with keys wherever a linear weight passes a key of its shape, so that the amounts are linear too."""
    if len(stops) == 1 or len(times) < 2:
        return times, weights
    more_times, more_weights = [times], [weights]
    before, after = weights[:-1], weights[1:]
    for stop in (0.0, *stops):
        passing = np.nonzero((before - stop) * (after - stop) < 0)[0]
        share = (stop - before[passing]) / (after[passing] - before[passing])
        more_times.append(times[passing] + share * (times[passing + 1] - times[passing]))
        more_weights.append(np.full(len(passing), stop))
    joined = np.concatenate(more_times)
    kept, first = np.unique(joined, return_index=True)
    return kept, np.concatenate(more_weights)[first]


def morph_set(
    record: Record,
    mesh: Mapping[str, Any],
    channels: Sequence[Channel],
    names: Sequence[str],
    control_points: Ints,
    linear: Floats,
    where: str,
) -> tuple[MorphSet, Ints] | None:
    """The targets of some vertices of a mesh, and the channels that drive them; None where it has none.

    ``control_points`` (V,) are the points of the vertices; ``linear`` (3, 3) takes the file's offsets to metres in the
    space of the part.
    """
    if not channels:
        return None
    count = len(record.array(mesh["positions"], 3))
    inverse = inverted(linear)
    turn = np.eye(3) if inverse is None else inverse.T * np.cbrt(abs(np.linalg.det(linear)))
    starts, morphs = [0], list[int]()
    vertices, positions, normals = list[Ints](), list[Floats](), list[Floats]()
    for shape, channel in zip(mesh["shapes"], channels, strict=True):
        title = f"{where}: blend shape '{shape['name']}'"
        rows = None if shape["points"] is None else record.integers(shape["points"], title)
        for key, morph in zip(shape["keys"], channel.morphs, strict=True):
            both = np.zeros((count, 6))
            for column, name, matrix in ((0, "offsets", linear), (3, "normals", turn)):
                if key[name] is None:
                    continue
                offsets = record.floats(key[name], 3)
                points = np.arange(count) if rows is None else rows
                if len(points) != len(offsets) or not sane(offsets):
                    raise FormatError(f"{len(offsets)} {name} for {len(points)} points", where=title)
                if len(points) and (points.min() < 0 or points.max() >= count):
                    raise FormatError(f"point {points.max()} does not exist; there are {count}", where=title)
                np.add.at(both[:, column : column + 3], points, offsets @ matrix.T)
            mine = both[control_points].astype(np.float32)
            moved = np.nonzero(np.any(mine != 0, axis=1))[0]
            vertices.append(moved)
            positions.append(mine[moved, :3])
            normals.append(mine[moved, 3:])
            starts.append(starts[-1] + len(moved))
            morphs.append(morph)
    every = np.concatenate(normals)
    found = MorphSet(
        tuple(names[m] for m in morphs),
        np.array(starts),
        np.concatenate(vertices),
        np.concatenate(positions),
        every if np.any(every) else None,
    )
    return found, np.array(morphs, np.int32)
