"""Blend shapes as morph targets; a channel with in-betweens becomes one target for each of its shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.errors import FormatError
from keypose.io.guarded import Record, sane
from keypose.io.notes import Notes, UniqueNames
from keypose.model import MorphSet


@dataclass(frozen=True, slots=True)
class Target:
    """One shape of a blend channel."""

    channel: int  # of the character
    shape: int  # of the file


@dataclass(frozen=True, slots=True)
class Morphs:
    """The morph channels of the character, and what each blend deformer of the file moves with them."""

    names: tuple[str, ...]
    rest_weights: Floats
    targets: Sequence[Sequence[Target]]  # of each blend deformer
    tracks: Sequence[Sequence[Floats]]  # of each animation stack and morph channel: weights at its frames, or none


def build(record: Record, notes: Notes) -> Morphs:
    """Channels that have one name, one weight and one animation in several meshes are one channel here."""
    facts: Sequence[Mapping[str, Any]] = record.facts["morph_channels"]
    deformers: Sequence[Mapping[str, Any]] = record.facts["morph_deformers"]
    stacks: Sequence[Mapping[str, Any]] = record.facts["stacks"]
    weights = [[record.array(w["values"]) for w in stack["weights"]] for stack in stacks]
    unique, names, rest = UniqueNames(), list[str](), list[float]()
    places: list[int] = []  # that keypose has written
    known: dict[Any, int] = {}
    tracks: list[list[Floats]] = [[] for _ in stacks]
    targets: list[list[Target]] = []
    for deformer in deformers:
        mine = list[Target]()
        for number in deformer["channels"]:
            item = facts[number]
            keys = [(float(weight), int(shape)) for weight, shape in item["keys"]]
            name = _channel_name(str(item["name"]), str(deformer["name"]), number)
            for place, key_name in enumerate(_key_names(name, keys, notes)):
                values = [effective_weights(keys, np.array([float(item["weight"])]))[place]]
                values += [effective_weights(keys, stack[number])[place] if stack else np.zeros(0) for stack in weights]
                if not all(sane(v) for v in values):
                    raise FormatError("a weight is impossible", where=f"blend channel '{item['name']}'")
                identity = (key_name, *(v.tobytes() for v in values))
                taken = {t.channel for t in mine}
                if identity not in known or known[identity] in taken:
                    known[identity] = len(names)
                    names.append(unique.add(key_name))
                    if names[-1] != key_name:
                        notes.add(f"blend channel '{key_name}' appears more than once; one became '{names[-1]}'")
                    rest.append(float(values[0][0]))
                    places.append(int(item["place"]))
                    for stack, track in zip(tracks, values[1:], strict=True):
                        stack.append(track)
                mine.append(Target(known[identity], keys[place][1]))
        targets.append(mine)
    order = np.argsort(places, kind="stable") if min(places, default=-1) >= 0 else np.arange(len(places))
    rank = np.argsort(order)
    return Morphs(
        tuple(names[k] for k in order),
        np.array(rest, np.float64)[order],
        [[Target(int(rank[t.channel]), t.shape) for t in mine] for mine in targets],
        [[stack[k] for k in order] if stack else [] for stack in tracks],
    )


def _channel_name(name: str, deformer: str, number: int) -> str:
    """The channel's name without that of its deformer, which Maya puts before it."""
    short = name.removeprefix(f"{deformer}.") if deformer else name
    return short or name or f"channel_{number}"


def _key_names(name: str, keys: Sequence[tuple[float, int]], notes: Notes) -> list[str]:
    if len(keys) < 2:
        return [name] * len(keys)
    names = [name if place == len(keys) - 1 else f"{name}@{weight:g}" for place, (weight, _) in enumerate(keys)]
    notes.add(
        f"blend channel '{name}': its {len(keys) - 1} in-betweens became targets of their own, {', '.join(names[:-1])}"
    )
    return names


def effective_weights(keys: Sequence[tuple[float, int]], weights: Floats) -> list[Floats]:
    """How much of each shape of a channel is added at the channel's weights (T,): K arrays (T,).

    Between two neighbouring shapes, and between the first and none at weight 0, the amounts change linearly; beyond the
    last they go on.
    """
    result: list[Floats] = [np.zeros(len(weights)) for _ in keys]
    for side in (1, -1):
        on_side = [k for k, (target, _) in enumerate(keys) if target * side > 0]
        on_side.sort(key=lambda k: abs(keys[k][0]))
        here = (weights > 0) if side > 0 else (weights <= 0)
        if not on_side:
            # as ufbx does it: nothing on this side, so the nearest shape of the other goes on
            on_side = sorted(
                (k for k, (target, _) in enumerate(keys) if target * side < 0), key=lambda k: abs(keys[k][0])
            )[:1]
            for k in on_side:
                result[k] = np.where(here, weights / keys[k][0], result[k])
            continue
        stops = np.array([0.0, *(keys[k][0] * side for k in on_side)])
        value = weights * side
        span = np.clip(np.searchsorted(stops, value, side="right") - 1, 0, len(stops) - 2)
        size = np.maximum(stops[span + 1] - stops[span], 1e-12)
        t = (value - stops[span]) / size
        for place, k in enumerate(on_side, 1):
            rising, falling = span + 1 == place, span == place
            result[k] = np.where(here & rising, t, np.where(here & falling, 1 - t, result[k]))
    return result


def morph_set(
    record: Record,
    targets: Sequence[Target],
    names: Sequence[str],
    control_points: Ints,
    count: int,
    linear: Floats,
    where: str,
) -> tuple[MorphSet, Ints]:
    """The targets of some vertices of a mesh of ``count`` control points, and the channels that drive them.

    ``linear`` (3, 3) takes the file's offsets to metres in the space of the part.
    """
    starts, vertices = [0], list[Ints]()
    positions, normals = list[Floats](), list[Floats]()
    turn = np.linalg.inv(linear).T * np.cbrt(abs(np.linalg.det(linear))) if np.linalg.det(linear) else np.eye(3)
    any_normals = False
    for target in targets:
        shape = record.facts["shapes"][target.shape]
        rows = record.array(shape["vertices"]).astype(np.int64)
        offsets, turned = record.array(shape["positions"], 3), record.array(shape["normals"], 3)
        turned = turned if len(turned) == len(rows) else np.zeros((len(rows), 3))
        if len(rows) != len(offsets) or not (sane(offsets) and sane(turned)):
            raise FormatError("its numbers do not fit together", where=f"{where}: shape '{shape['name']}'")
        fits = rows < count
        both = np.zeros((count, 6))
        np.add.at(both, rows[fits], np.concatenate([offsets @ linear.T, turned @ turn.T], axis=1)[fits])
        mine = both[control_points].astype(np.float32)
        moved = np.nonzero(np.any(mine != 0, axis=1))[0]
        vertices.append(moved)
        positions.append(mine[moved, :3])
        normals.append(mine[moved, 3:])
        any_normals |= bool(np.any(mine[moved, 3:]))
        starts.append(starts[-1] + len(moved))
    morphs = MorphSet(
        tuple(names[t.channel] for t in targets),
        np.array(starts),
        np.concatenate(vertices),
        np.concatenate(positions),
        np.concatenate(normals) if any_normals else None,
    )
    return morphs, np.array([t.channel for t in targets], np.int32)
