"""A program as flat tables of numbers, in the form that the kernels of crowds read (`keypose.kernels.graphtables`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.play.graph import control
from keypose.play.graph.build import LineWeigher, PlaneWeigher, Program, ShareWeigher
from keypose.play.graph.control import RtNode, Value
from keypose.play.graph.machine import RtMachine
from keypose.play.graph.program import Look, Reach
from keypose.play.graph.solvers import Limb, LookSolver, PlantSolver, ReachSolver
from keypose.play.graph.spaces import Bands, Line, Plane


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """The tables, and what the numbers of the queue mean.

    ``events``: number -> (name, data, clip); ``nodes``: the nodes by number, each before all that is below it.
    """

    node_table: Array
    words: Array
    reals: Array
    nodes: tuple[RtNode, ...]
    events: tuple[tuple[str, str, str], ...]
    memories: int
    longest_path: int


@dataclass(slots=True)
class _Writer:
    program: Program
    place_of: Array  # of each joint of the skeleton in the order of the crowd
    parents: Array  # in the order of the crowd
    nodes: list[RtNode] = field(default_factory=list[RtNode])
    number_of: dict[int, int] = field(default_factory=dict[int, int])  # by id
    words: list[int] = field(default_factory=list[int])
    reals: list[float] = field(default_factory=list[float])
    events: list[tuple[str, str, str]] = field(default_factory=list[tuple[str, str, str]])
    memories: int = 0
    longest_path: int = 1

    def put(self, *values: int) -> int:
        at = len(self.words)
        self.words += [int(v) for v in values]
        return at

    def put_reals(self, *values: float) -> int:
        at = len(self.reals)
        self.reals += [float(v) for v in values]
        return at


def lower(program: Program, place_of: Array, parents: Array) -> Tables:
    """The tables of a program for a crowd whose joints are in an order of their own."""
    from keypose.kernels import graphtables as k

    w = _Writer(program, place_of, parents)
    _number(w, program.root)
    table = np.zeros((len(w.nodes), k.FIELDS), np.int64)
    for i, node in enumerate(w.nodes):
        row: dict[int, int] = {
            k.END: i + _size(node),
            k.SYNCED: node.synced,
            k.INDEX: node.index,
            k.SOURCE: _source(w, node),
        }
        entered, members = _enter_list(w, node), _members(w, node)
        row[k.ENTER], row[k.ENTER_COUNT] = w.put(*entered), len(entered)
        row[k.MEMBERS], row[k.MEMBER_COUNT] = w.put(*members), len(members)
        children = _children(node)
        row[k.CHILDREN], row[k.COUNT] = w.put(*(w.number_of[id(c)] for c in children)), len(children)
        row |= _fields(w, node)
        for column, value in row.items():
            table[i, column] = value
    return Tables(
        table.ravel(),
        np.array([*w.words, 0], np.int64),
        np.array([*w.reals, 0.0]),
        tuple(w.nodes),
        tuple(w.events),
        w.memories,
        w.longest_path,
    )


def _children(node: RtNode) -> tuple[RtNode, ...]:
    match node:
        case control.RtMix():
            return node.children
        case RtMachine():
            return node.states
        case control.RtTop():
            return node.base, node.top
        case control.RtOver():
            return (node.base,)
        case _:
            return ()


def _number(w: _Writer, node: RtNode) -> None:
    w.number_of[id(node)] = len(w.nodes)
    w.nodes.append(node)
    for child in _children(node):
        _number(w, child)


def _size(node: RtNode) -> int:
    return 1 + sum(_size(c) for c in _children(node))


def _enter_list(w: _Writer, node: RtNode) -> list[int]:
    """Whom entering a node reaches, children first."""
    below = (node.states[node.entry],) if isinstance(node, RtMachine) else _children(node)
    return [*(n for child in below for n in _enter_list(w, child)), w.number_of[id(node)]]


def _members(w: _Writer, node: RtNode) -> list[int]:
    """Who moves with a node when it is taken to a place among its sync markers, children first."""
    own = w.number_of[id(node)]
    match node:
        case control.RtClip():
            return [own] if node.table is not None else []
        case control.RtMix():
            below = [n for c in node.children if c.synced for n in _members(w, c)]
            return [*below, own] if node.group else []
        case control.RtOver():
            return [*_members(w, node.base), own] if node.synced else []
        case _:
            return []


def _source(w: _Writer, node: RtNode) -> int:
    """The node that knows where a synchronised node stands."""
    match node:
        case control.RtClip():
            return w.number_of[id(node)] if node.table is not None else -1
        case control.RtMix():
            return w.number_of[id(node)] if node.group else -1
        case control.RtOver():
            return _source(w, node.base)
        case _:
            return -1


def _fields(w: _Writer, node: RtNode) -> dict[int, int]:
    from keypose.kernels import graphtables as k

    match node:
        case control.RtRest():
            return {k.KIND: k.REST}
        case control.RtClip():
            return _clip(w, node)
        case control.RtMix():
            return _mix(w, node)
        case RtMachine():
            return _machine(w, node)
        case control.RtTop():
            adds = node.reference >= 0
            # Two rows of each mask: for layers, and for what is added, which leaves contacts alone.
            return {
                k.KIND: k.ADD if adds else k.OVER,
                k.A: node.weight.slot,
                k.B: w.number_of[id(node.top)],
                k.C: 2 * (node.mask + 1) + adds,
                k.D: node.reference,
                k.NUMBERS: w.put_reals(node.weight.constant),
            }
        case control.RtWarp():
            return {k.KIND: k.WARP, k.A: node.speed.slot, k.NUMBERS: w.put_reals(node.speed.constant)}
        case control.RtSteer():
            turn = node.turn_deg_s
            return {k.KIND: k.STEER, k.A: turn.slot, k.FLOATS: node.way, k.NUMBERS: w.put_reals(turn.constant)}
        case control.RtAim():
            return _aim(w, node)
        case _:
            raise TypeError(f"unknown node {type(node).__name__}")


def _clip(w: _Writer, node: control.RtClip) -> dict[int, int]:
    from keypose.kernels import graphtables as k

    asset = node.asset
    numbers = w.put_reals(node.speed.constant, asset.duration_s, node.start, asset.track.rate_hz)
    first_event = len(w.events)
    w.events += [(name, data, asset.name) for _, name, data in asset.events]
    times = node.table.times_s if node.table is not None else ()
    data = w.put(
        len(node.warp),
        w.put_reals(*(n for point in node.warp for n in point)),
        len(times),
        w.put_reals(*times),
        len(asset.events),
        w.put_reals(*(e[0] for e in asset.events)),
        first_event,
        len(asset.track.ground),
        w.put_reals(*asset.track.ground.ravel().tolist()),
    )
    return {
        k.KIND: k.CLIP,
        k.A: node.speed.slot,
        k.B: node.clip,
        k.C: node.loops,
        k.FLOATS: node.time,
        k.INTS: node.loop,
        k.DATA: data,
        k.NUMBERS: numbers,
    }


def _mix(w: _Writer, node: control.RtMix) -> dict[int, int]:
    from keypose.kernels import graphtables as k

    lead = next((w.number_of[id(c)] for c in node.children if c.synced), -1)
    row = {k.KIND: k.MIX, k.B: node.group, k.C: node.pattern, k.D: lead, k.FLOATS: node.share, k.INTS: node.interval}
    weigher = node.weigher
    match weigher:
        case LineWeigher():
            kind, values = k.LINE, [weigher.at]
        case PlaneWeigher():
            kind, values = (k.PLANE if isinstance(weigher.space, Plane) else k.BANDS), [weigher.x, weigher.y]
        case ShareWeigher():
            kind, values = k.SHARES, list(weigher.values)
        case _:
            raise TypeError(f"unknown weights {type(weigher).__name__}")
    words, reals = [v.slot for v in values], [v.constant for v in values]
    if not isinstance(weigher, ShareWeigher):
        more_words, more_reals = _space(w, weigher.space)
        words, reals = words + more_words, reals + more_reals
    return row | {k.A: kind, k.DATA: w.put(*words), k.NUMBERS: w.put_reals(*reals)}


def _space(w: _Writer, space: Any) -> tuple[list[int], list[float]]:
    def group(shares: Sequence[tuple[int, float]]) -> int:
        return w.put(len(shares), w.put_reals(*(s for _, s in shares)), *(child for child, _ in shares))

    def even(children: Sequence[int]) -> list[tuple[int, float]]:
        return [(c, 1.0 / len(children)) for c in children]

    match space:
        case Line():
            return [len(space.places), *(group(even(g)) for g in space.groups)], list(space.places)
        case Plane() if space.along is not None:
            line = space.along
            groups = [
                group([(c, share / len(g)) for point in g for c, share in even(space.groups[point])])
                for g in line.groups
            ]
            return [1, len(line.places), *groups], [*space.axis, *line.places]
        case Plane():
            corners = [c for t in space.triangles for c in t]
            ends = [e for edge in space.hull for e in edge]
            counts = [len(space.points), len(space.triangles), len(space.hull)]
            groups = [group(even(g)) for g in space.groups]
            return [0, *counts, *groups, *corners, *ends], [*space.axis, *(n for p in space.points for n in p)]
        case Bands():
            return [len(space.points), *(group(even(g)) for g in space.groups)], [n for p in space.points for n in p]
        case _:
            raise TypeError(f"unknown blend space {type(space).__name__}")


def _machine(w: _Writer, node: RtMachine) -> dict[int, int]:
    from keypose.kernels import graphtables as k

    rows: list[int] = []
    for t in node.transitions:
        conditions: list[int] = []
        for c in t.conditions:
            conditions += [c.value.slot, k.TESTS.index(c.test), c.trigger, w.put_reals(c.against)]
        how = ("crossfade", "frozen", "inertial", "dead").index(t.kind)
        rows += [t.source, t.target, how, k.INTERRUPTS.index(t.interrupt), t.sync, len(t.conditions)]
        rows += [w.put(*conditions), t.exit_time is not None]
    remembers = any(t.kind != "crossfade" or t.interrupt != "none" or t.source == t.target for t in node.transitions)
    memory = -1
    if remembers:
        memory, w.memories = w.memories, w.memories + 1
    return {
        k.KIND: k.MACHINE,
        k.A: node.entry,
        k.C: len(node.transitions),
        k.D: memory,
        k.FLOATS: node.elapsed,
        k.INTS: node.state,
        k.DATA: w.put(*rows),
        k.NUMBERS: w.put_reals(*(n for t in node.transitions for n in (t.exit_time or 0.0, t.duration_s))),
    }


def _aim(w: _Writer, node: control.RtAim) -> dict[int, int]:
    from keypose.kernels import graphtables as k

    solver: Any = w.program.resources.solvers[node.solver]
    kind = k.LOOK if node.kind is Look else k.REACH if node.kind is Reach else k.PLANT
    match solver:
        case LookSolver():
            path, number = _path(w, solver.joints)
            data = w.put(len(solver.joints), *(number[j] for j in solver.joints), *path)
            reals = [solver.limit_rad, *solver.forward, *solver.shares]
        case ReachSolver():
            path, number = _path(w, _joints(solver.limb))
            data = w.put(*(number[j] for j in _joints(solver.limb)), *path)
            reals = [solver.limb.softness_m, *solver.limb.bend]
        case PlantSolver():
            path, number = _path(w, [j for _, joint, limb in solver.feet for j in (joint, *_joints(limb))])
            feet = [
                [contact, number[joint], *(number[j] for j in _joints(limb))] for contact, joint, limb in solver.feet
            ]
            data = w.put(len(feet), *(n for foot in feet for n in foot), *path)
            reals = [n for c, _, limb in solver.feet for n in (float(solver.floors_m[c]), *limb.bend)]
        case _:
            raise TypeError(f"unknown solver {type(solver).__name__}")
    weight: Value = node.weight
    return {
        k.KIND: kind,
        k.A: weight.slot,
        k.C: node.target,
        k.DATA: data,
        k.NUMBERS: w.put_reals(weight.constant, *reals),
    }


def _joints(limb: Limb) -> tuple[int, int, int]:
    return limb.upper, limb.middle, limb.end


def _path(w: _Writer, joints: Sequence[int]) -> tuple[list[int], dict[int, int]]:
    """The joints of the skeleton that must be walked for some of them, parents first, and their numbers in that path."""
    needed: set[int] = set()
    for joint in joints:
        at = int(w.place_of[joint])
        while at >= 0:
            needed.add(at)
            at = int(w.parents[at])
    order = sorted(needed)
    number = {at: n for n, at in enumerate(order)}
    w.longest_path = max(w.longest_path, len(order))
    path = [len(order)]
    for at in order:
        up = int(w.parents[at])
        path += [at, number[up] if up >= 0 else -1]
    return path, {j: number[int(w.place_of[j])] for j in joints}
