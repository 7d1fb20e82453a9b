"""A graph in the studio's messages: its tree once, and of every step what changed."""

from __future__ import annotations

import typing
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from keypose.arrays import Floats
from keypose.play import graph as g
from keypose.play.graph import definition as d
from keypose.play.graph.spaces import plane
from keypose.studio import messages

KINDS = ("", "crossfade", "frozen", "inertial", "dead")
"""Of transitions, in the order that `messages.PlayFrame.machines` counts them."""

RECENT = ("memory", "rest")
"""What gives a joint its rotation where no clip does."""

_KIND_OF = {kind: name for name, kind in d.KINDS.items()}


@dataclass(frozen=True, slots=True)
class Placed:
    """A node in the tree: its name, its definition, the number of its parent (-1: none), what it is to it."""

    name: str
    node: d.Node
    parent: int
    slot: str
    at: tuple[float, ...]


def tree(graph: g.Graph) -> tuple[Placed, ...]:
    """The nodes from the output down, parents before children, children in their order."""
    return tuple(_below(graph, graph.output, -1, "", (), [0]))


def _below(
    graph: g.Graph, name: str, parent: int, slot: str, at: tuple[float, ...], count: list[int]
) -> Iterator[Placed]:
    node, number = graph.nodes[name], count[0]
    count[0] += 1
    yield Placed(name, node, parent, slot, at)
    for child, slot, at in _children(node):
        yield from _below(graph, child, number, slot, at, count)


def _children(node: d.Node) -> list[tuple[str, str, tuple[float, ...]]]:
    match node:
        case d.StateMachine():
            return [(below, state, ()) for state, below in node.states.items()]
        case d.Blend1D():
            return [(s.node, "", (s.at,)) for s in node.samples]
        case d.Blend2D():
            return [(s.node, "", tuple(s.at)) for s in node.samples]
        case _:
            return [(below, field.partition("[")[0], ()) for field, below in d.inputs_of(node)]


# ---- once ------------------------------------------------------------------------------------------------------------


def nodes(graph: g.Graph) -> list[messages.PlayNode]:
    """The tree as it is drawn."""
    return [_node(graph, placed) for placed in tree(graph)]


def _node(graph: g.Graph, placed: Placed) -> messages.PlayNode:
    node = placed.node
    machine = node if isinstance(node, d.StateMachine) else None
    flat = isinstance(node, d.Blend2D) and node.method == "delaunay"
    return messages.PlayNode(
        name=placed.name,
        kind=_KIND_OF[type(node)],
        parent=placed.parent,
        slot=placed.slot,
        at=[float(x) for x in placed.at],
        clip=getattr(node, "clip", ""),
        target=node.target if isinstance(node, (d.LookAt, d.TwoBone)) else "",
        sync=str(getattr(node, "sync", "")) if isinstance(getattr(node, "sync", ""), str) else "",
        mask=getattr(node, "mask", ""),
        numbers=[
            messages.PlayNumber(field, *((n, 0.0) if isinstance(n, str) else ("", float(n))))
            for field, n in numbers_of(node)
        ],
        states=list(machine.states) if machine else [],
        transitions=[
            messages.PlayTransition(t.source, t.target, t.kind, t.duration_s, _when(t)) for t in machine.transitions
        ]
        if machine
        else [],
        triangles=_triangles([s.at for s in node.samples]) if isinstance(node, d.Blend2D) and flat else [],
    )


def numbers_of(node: d.Node) -> list[tuple[str, d.Number]]:
    """The fields of a node that are a number or a parameter's name; of a blend the weights, by child."""
    if isinstance(node, d.Blend):
        return [(f"weight of {i.node}", i.weight) for i in node.inputs]
    return [(field, getattr(node, field)) for field in _number_fields(type(node))]


@cache
def _number_fields(kind: type[Any]) -> tuple[str, ...]:
    return tuple(field for field, hint in typing.get_type_hints(kind).items() if hint == d.Number)


def _when(t: d.Transition) -> str:
    parts = [f"after {t.exit_time:g} cycles"] if t.exit_time is not None else []
    return " and ".join([*parts, *map(_test, t.conditions)]) or "always"


def _test(c: d.Condition) -> str:
    if c.test in ("set", "not set"):
        return f"{c.test} {c.parameter}".removeprefix("set ")
    return f"{c.parameter} {c.test} {c.value:g}"


def _triangles(places: Sequence[tuple[float, float]]) -> list[list[int]]:
    space = plane([(float(x), float(y)) for x, y in places])
    return [[space.groups[corner][0] for corner in corners] for corners in space.triangles]


def parameters(graph: g.Graph) -> list[messages.PlayParameter]:
    """The inputs, each with its range."""
    found: list[messages.PlayParameter] = []
    for name, p in graph.parameters.items():
        default = p.default if isinstance(p.default, tuple) else (float(p.default),) * (3 if p.kind == "vector" else 1)
        entry = messages.PlayParameter(name, p.kind, [float(x) for x in default], p.minimum, p.maximum, p.half_life_s)
        found.append(entry)
    return found


def clips(program: g.Program) -> list[messages.PlayClip]:
    """The clips with their events."""
    return [
        messages.PlayClip(a.name, a.duration_s, [messages.PlayEventMark(name, time) for time, name, _ in a.events])
        for a in program.assets
    ]


def contacts(program: g.Program) -> list[messages.PlayContact]:
    """The points that touch the ground."""
    index = program.skeleton.index
    return [messages.PlayContact(name, index(c.joint)) for name, c in program.graph.contacts.items()]


def contributors(program: g.Program) -> list[str]:
    """What a joint's rotation can come from."""
    return [*(a.name for a in program.assets), *RECENT]


# ---- every step ------------------------------------------------------------------------------------------------------


class Explainer:
    """Makes rows of numbers from the traces of one program."""

    def __init__(self, program: g.Program) -> None:
        self.nodes = tree(program.graph)
        self._index = {placed.name: n for n, placed in enumerate(self.nodes)}
        self._contributors = contributors(program)
        self._states = {
            p.name: {state: n for n, state in enumerate(p.node.states)}
            for p in self.nodes
            if isinstance(p.node, d.StateMachine)
        }
        self._joints = program.skeleton.joint_count

    def shares(self, trace: g.Trace) -> Floats:
        """How much of its parent each node gives, (N,); 1 for the output."""
        machines = {m.machine: m for m in trace.machines}
        playing = self._playing(trace)
        found = np.ones(len(self.nodes))
        for n, placed in enumerate(self.nodes[1:], 1):
            parent = self.nodes[placed.parent]
            match parent.node:
                case d.Blend1D() | d.Blend2D() | d.Blend():
                    found[n] = trace.weights[parent.name][placed.name]
                case d.StateMachine():
                    found[n] = _state_share(machines[parent.name], placed.slot, playing[n])
                case d.Layer() | d.Additive() if placed.slot != "base":
                    found[n] = min(abs(_value(parent.node.weight, trace)), 1.0)
                case _:
                    pass
        return found

    def _playing(self, trace: g.Trace) -> list[bool]:
        """Which nodes take part: those whose clip was sampled and all above them; what rests takes part."""
        found = [isinstance(placed.node, d.RestNode) for placed in self.nodes]
        for clip in trace.clips:
            found[self._index[clip.node]] = True
        for n in range(len(self.nodes) - 1, 0, -1):
            found[self.nodes[n].parent] |= found[n]
        return found

    def phases(self, trace: g.Trace) -> Floats:
        """Where each clip node is in its clip, (N,); -1 for all others."""
        found = np.full(len(self.nodes), -1.0)
        for clip in trace.clips:
            found[self._index[clip.node]] = clip.phase
        return found

    def machines(self, trace: g.Trace) -> Floats:
        """State, source, kind, share of each state machine in the order of the tree, (S, 4)."""
        by_name = {m.machine: m for m in trace.machines}
        rows: list[tuple[float, ...]] = []
        for name, states in self._states.items():
            m = by_name[name]
            rows.append((states[m.state], states[m.source], KINDS.index(m.kind), m.share))
        return np.array(rows).reshape(-1, 4)

    def syncs(self, trace: g.Trace) -> Floats:
        """Node, marker passed, share of the way to the next, (Y, 3)."""
        return np.array([(self._index[s.node], s.marker, s.share) for s in trace.syncs]).reshape(-1, 3)

    def contributions(self, trace: g.Trace, joint: int) -> Floats:
        """What gives how much of a joint's rotation, (C,); nothing for a joint that is not there."""
        if not 0 <= joint < self._joints:
            return np.zeros(0)
        given = trace.contributions
        return np.array([given[name][joint] if name in given else 0.0 for name in self._contributors])


def _state_share(m: Any, state: str, playing: bool) -> float:
    if state == m.state:
        return 1.0 if m.kind in ("", "inertial") else m.share
    # only a crossfade plays the old state on; every other kind has but a memory of its pose
    return 1.0 - m.share if m.kind == "crossfade" and state == m.source and playing else 0.0


def _value(number: d.Number, trace: g.Trace) -> float:
    return trace.parameters[number][0] if isinstance(number, str) else float(number)
