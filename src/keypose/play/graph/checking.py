"""Everything that can be wrong with a graph's definition by itself, each message naming the node and the field."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import fields, is_dataclass
from typing import Any

from keypose.errors import ShapeError, UnknownName
from keypose.play.graph.definition import (
    Additive,
    Blend,
    Blend1D,
    Blend2D,
    ClipNode,
    Graph,
    Layer,
    LookAt,
    Node,
    Plant,
    StateMachine,
    Steer,
    TimeWarp,
    TwoBone,
    inputs_of,
)

_NUMBERS: dict[type[Any], tuple[str, ...]] = {
    ClipNode: ("speed",),
    Blend1D: ("parameter",),
    Blend2D: ("x", "y"),
    Additive: ("weight",),
    Layer: ("weight",),
    TimeWarp: ("speed",),
    Steer: ("turn_deg_s",),
    LookAt: ("weight",),
    TwoBone: ("weight",),
    Plant: ("weight",),
}
DEEPEST = 100


class GraphError(ShapeError):
    """A graph's definition is wrong; ``node`` and ``field`` say where."""

    def __init__(self, node: str, field: str, what: str) -> None:
        self.node, self.field = node, field
        place = f"node '{node}'" if node else "graph"
        super().__init__(f"{place}: {field + ': ' if field else ''}{what}")


def check(graph: Graph) -> None:
    """Raises `GraphError` for the first thing that is wrong with the definition; it needs no skeleton and no clips."""
    for error in problems(graph):
        raise error


def problems(graph: Graph) -> Iterator[GraphError]:
    """All faults of the definition, in reading order."""
    if not graph.nodes:
        yield GraphError("", "nodes", "expected at least one node")
        return
    if graph.output not in graph.nodes:
        yield _unknown("", "output", "node", graph.output, graph.nodes)
    yield from _parameters(graph)
    for path, number in _floats(graph, "graph"):
        if not math.isfinite(number):
            yield GraphError("", path.removeprefix("graph."), f"expected a finite number, got {number}")
            return
    sound = True
    for name, node in graph.nodes.items():
        for error in _node(graph, name, node):
            sound = sound and not error.field.startswith(
                ("samples", "inputs", "base", "delta", "layer", "input", "states")
            )
            yield error
    if sound and graph.output in graph.nodes:
        yield from _tree(graph)


def _parameters(graph: Graph) -> Iterator[GraphError]:
    for name, p in graph.parameters.items():
        where = f"parameters['{name}']"
        vector = isinstance(p.default, tuple)
        if (p.kind == "vector") != vector and not (p.kind == "vector" and p.default == 0.0):
            yield GraphError("", where, f"default: expected {'three numbers' if p.kind == 'vector' else 'one number'}")
        if p.minimum is not None and p.maximum is not None and p.minimum > p.maximum:
            yield GraphError("", where, f"minimum {p.minimum:g} is above maximum {p.maximum:g}")
        if p.half_life_s < 0 or (p.half_life_s > 0 and p.kind not in ("float", "vector")):
            yield GraphError("", where, "half_life_s: expected 0, or a positive time of a float or vector")
    for name, contact in graph.contacts.items():
        if not (contact.height_m > 0 and contact.speed_m_s > 0):
            yield GraphError("", f"contacts['{name}']", "height_m, speed_m_s: expected positive numbers")
    for name, clip in graph.clips.items():
        if clip.start_s is not None and clip.end_s is not None and clip.end_s <= clip.start_s:
            yield GraphError(
                "", f"clips['{name}']", f"end_s: expected a time after {clip.start_s:g} s, got {clip.end_s:g} s"
            )


def _node(graph: Graph, name: str, node: Node) -> Iterator[GraphError]:
    for field, below in inputs_of(node):
        if below not in graph.nodes:
            yield _unknown(name, field, "node", below, graph.nodes)
    for field in _NUMBERS.get(type(node), ()):
        yield from _number(graph, name, field, getattr(node, field))
    match node:
        case ClipNode():
            if node.clip not in graph.clips:
                yield _unknown(name, "clip", "clip", node.clip, graph.clips)
            if node.loops < 0:
                yield GraphError(name, "loops", f"expected a count, or 0 for ever, got {node.loops}")
            if not 0 <= node.start <= 1:
                yield GraphError(name, "start", f"expected a share from 0 to 1, got {node.start:g}")
            yield from _warp(name, node.warp)
        case Blend1D() | Blend2D():
            if not node.samples:
                yield GraphError(name, "samples", "expected at least one sample")
        case Blend():
            if not node.inputs:
                yield GraphError(name, "inputs", "expected at least one input")
            for i, entry in enumerate(node.inputs):
                yield from _number(graph, name, f"inputs[{i}].weight", entry.weight)
        case Additive():
            yield from _mask(graph, name, node.mask)
            if node.reference != "rest" and node.reference not in graph.clips:
                yield _unknown(name, "reference", "clip", node.reference, ["rest", *graph.clips])
        case Layer():
            yield from _mask(graph, name, node.mask)
        case StateMachine():
            yield from _machine(graph, name, node)
        case LookAt() | TwoBone():
            if node.target not in graph.parameters:
                yield _unknown(name, "target", "parameter", node.target, graph.parameters)
            elif graph.parameters[node.target].kind != "vector":
                yield GraphError(name, "target", f"parameter '{node.target}' is no vector")
            if isinstance(node, LookAt):
                if not node.joints or any(share < 0 for share in node.joints.values()) or not sum(node.joints.values()):
                    yield GraphError(name, "joints", "expected at least one joint with a positive share")
                if node.forward == (0.0, 0.0, 0.0):
                    yield GraphError(name, "forward", "expected a direction, got zero")
            elif node.softness_m < 0:
                yield GraphError(name, "softness_m", f"expected a length, got {node.softness_m:g}")
        case Plant():
            for i, contact in enumerate(node.contacts):
                if contact not in graph.contacts:
                    yield _unknown(name, f"contacts[{i}]", "contact", contact, graph.contacts)
                elif not graph.contacts[contact].limb:
                    yield GraphError(name, f"contacts[{i}]", f"contact '{contact}' names no limb")
        case _:
            pass


def _machine(graph: Graph, name: str, node: StateMachine) -> Iterator[GraphError]:
    if not node.states:
        yield GraphError(name, "states", "expected at least one state")
        return
    if node.entry and node.entry not in node.states:
        yield _unknown(name, "entry", "state", node.entry, node.states)
    for i, t in enumerate(node.transitions):
        where = f"transitions[{i}]"
        if t.source != "*" and t.source not in node.states:
            yield _unknown(name, f"{where}.source", "state", t.source, ["*", *node.states])
        if t.target not in node.states:
            yield _unknown(name, f"{where}.target", "state", t.target, node.states)
        if t.duration_s < 0:
            yield GraphError(name, f"{where}.duration_s", f"expected a time, got {t.duration_s:g} s")
        if t.exit_time is not None and t.exit_time < 0:
            yield GraphError(name, f"{where}.exit_time", f"expected a count of cycles, got {t.exit_time:g}")
        if t.sync and node.sync == "none":
            yield GraphError(name, f"{where}.sync", "the state machine's own sync is 'none'")
        if not t.conditions and t.exit_time is None:
            yield GraphError(name, where, f"'{t.source}' to '{t.target}' needs a condition or an exit time")
        for k, condition in enumerate(t.conditions):
            field = f"{where}.conditions[{k}]"
            known = graph.parameters.get(condition.parameter)
            if known is None:
                yield _unknown(name, f"{field}.parameter", "parameter", condition.parameter, graph.parameters)
                continue
            flag = condition.test in ("set", "not set")
            if known.kind == "vector" or flag != (known.kind in ("bool", "trigger")):
                yield GraphError(
                    name, f"{field}.test", f"'{condition.test}' does not fit the {known.kind} '{condition.parameter}'"
                )
            elif known.kind == "trigger" and condition.test != "set":
                yield GraphError(name, f"{field}.test", f"a trigger can only be 'set', got '{condition.test}'")


def _tree(graph: Graph) -> Iterator[GraphError]:
    """Every node hangs on one other node: its state is its own."""
    above: dict[str, str] = {}
    stack: list[tuple[str, tuple[str, ...]]] = [(graph.output, ())]
    while stack:
        name, path = stack.pop()
        if name in path:
            yield GraphError(name, "", "it is its own input: " + " -> ".join([*path[path.index(name) :], name]))
            return
        if len(path) >= DEEPEST:
            yield GraphError(name, "", f"it is deeper than {DEEPEST} nodes")
            return
        for field, below in inputs_of(graph.nodes[name]):
            if below in above:
                if below in (*path, name):
                    stack.append((below, (*path, name)))
                    continue
                yield GraphError(
                    name, field, f"node '{below}' is already an input of '{above[below]}'; give each its own copy"
                )
                return
            above[below] = name
            stack.append((below, (*path, name)))
    if graph.output in above:
        yield GraphError(above[graph.output], "", f"the output '{graph.output}' cannot be an input")
    for name in graph.nodes:
        if name != graph.output and name not in above:
            yield GraphError(name, "", f"nothing leads from it to the output '{graph.output}'")


def _number(graph: Graph, name: str, field: str, value: Any) -> Iterator[GraphError]:
    if isinstance(value, str):
        if value not in graph.parameters:
            yield _unknown(name, field, "parameter", value, graph.parameters)
        elif graph.parameters[value].kind in ("vector", "trigger"):
            yield GraphError(
                name, field, f"expected a number, but parameter '{value}' is a {graph.parameters[value].kind}"
            )


def _mask(graph: Graph, name: str, mask: str) -> Iterator[GraphError]:
    if mask and mask not in graph.masks:
        yield _unknown(name, "mask", "mask", mask, graph.masks)


def _warp(name: str, warp: tuple[tuple[float, float], ...]) -> Iterator[GraphError]:
    if not warp:
        return
    if len(warp) < 2 or tuple(warp[0]) != (0.0, 0.0) or tuple(warp[-1]) != (1.0, 1.0):
        yield GraphError(name, "warp", "expected points from (0, 0) to (1, 1)")
    elif any(b[0] <= a[0] or b[1] <= a[1] for a, b in itertools.pairwise(warp)):
        yield GraphError(name, "warp", "expected points that rise in both numbers")


def _floats(value: Any, path: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, float):
        yield path, value
    elif is_dataclass(value):
        for f in fields(value):
            yield from _floats(getattr(value, f.name), f"{path}.{f.name}")
    elif isinstance(value, tuple):
        for i, item in enumerate(value):
            yield from _floats(item, f"{path}[{i}]")
    elif hasattr(value, "items"):
        for key, item in value.items():
            yield from _floats(item, f"{path}['{key}']")


def _unknown(node: str, field: str, kind: str, name: str, known: Iterable[str]) -> GraphError:
    return GraphError(node, field, str(UnknownName(kind, name, known)))
