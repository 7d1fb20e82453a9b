"""What happened in a step, in words and numbers that can be drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Floats
from keypose.play.graph.build import Program
from keypose.play.graph.control import Moment, RtClip, RtMix
from keypose.play.graph.machine import NONE, RtMachine, smooth
from keypose.play.graph.program import (
    Add,
    BeginInertial,
    Change,
    Dead,
    Fired,
    Held,
    Mix,
    Operation,
    Over,
    Rest,
    Sample,
)


@dataclass(frozen=True, slots=True)
class MachineTrace:
    """A state machine: the state it is in or goes to, where it comes from, and how far it is (1: there)."""

    machine: str
    state: str
    source: str
    kind: str
    share: float


@dataclass(frozen=True, slots=True)
class ClipTrace:
    """A clip that was sampled: its time, its share of the playing time, its largest weight on any joint."""

    node: str
    clip: str
    time_s: float
    phase: float
    weight: float


@dataclass(frozen=True, slots=True)
class SyncTrace:
    """A synchronised blend: the marker it has passed and the share of the way to the next one; weights by child."""

    node: str
    marker: int
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """One step explained.

    ``weights``: per mixing node the weight of each child. ``contributions``: clip -> (J,), how much of each joint's
    rotation comes from it (what is added counts on top, what a memory or the rest pose gives counts under ``"memory"``
    and ``"rest"``). ``operations`` counts the pose program; the two times are what the step took.
    """

    time_s: float
    machines: tuple[MachineTrace, ...]
    clips: tuple[ClipTrace, ...]
    syncs: tuple[SyncTrace, ...]
    weights: Mapping[str, Mapping[str, float]]
    contributions: Mapping[str, Floats]
    parameters: Mapping[str, tuple[float, ...]]
    events: tuple[Fired, ...]
    changes: tuple[Change, ...]
    operations: Mapping[str, int]
    control_s: float
    pose_s: float


def make_trace(
    program: Program, moment: Moment, ops: Sequence[Operation], time_s: float, control_s: float, pose_s: float
) -> Trace:
    """The trace of a step from the numbers it left and the pose program it ran."""
    shares = contributions(program, ops)
    machines: list[MachineTrace] = []
    syncs: list[SyncTrace] = []
    weights: dict[str, dict[str, float]] = {}
    for node in program.nodes:
        if isinstance(node, RtMachine):
            machines.append(_machine(node, moment))
        elif isinstance(node, RtMix):
            values = node.weigher.weights(moment)
            weights[node.name] = {c.name: w for c, w in zip(node.children, values, strict=True)}
            if node.group:
                marker, share = node.position(moment)
                syncs.append(SyncTrace(node.name, marker, share))
    names = list(program.graph.nodes)
    by_index = {n.index: n for n in program.nodes}
    clips: list[ClipTrace] = []
    for op in ops:
        if not isinstance(op, Sample):
            continue
        node = by_index[op.node]
        asset = program.assets[op.clip]
        if isinstance(node, RtClip):
            phase = op.time_s / asset.duration_s if asset.duration_s > 0 else 0.0
            weight = float(np.max(shares.get(asset.name, np.zeros(1))))
            clips.append(ClipTrace(names[op.node], asset.name, op.time_s, phase, weight))
    counts: dict[str, int] = {}
    for op in ops:
        counts[type(op).__name__] = counts.get(type(op).__name__, 0) + 1
    parameters = {name: tuple(moment.floats[i.slot : i.slot + i.width]) for name, i in program.inputs.items()}
    return Trace(
        time_s,
        tuple(machines),
        tuple(clips),
        tuple(syncs),
        weights,
        shares,
        parameters,
        tuple(moment.events),
        tuple(moment.changes),
        counts,
        control_s,
        pose_s,
    )


def contributions(program: Program, ops: Sequence[Operation]) -> dict[str, Floats]:
    """Which clip gives how much of each joint: the pose program run on weights instead of poses."""
    joints = program.resources.layout.joints
    stack: list[dict[str, Floats]] = []
    for op in ops:
        match op:
            case Sample():
                stack.append({program.assets[op.clip].name: np.ones(joints)})
            case Rest():
                stack.append({"rest": np.ones(joints)})
            case Mix():
                top = stack[-len(op.weights) :]
                del stack[-len(op.weights) :]
                stack.append(_sum([(s, np.full(joints, w)) for s, w in zip(top, op.weights, strict=True)]))
            case Over():
                layer, base = stack.pop(), stack.pop()
                share = op.weight * (np.ones(joints) if op.mask < 0 else program.resources.masks[op.mask][0])
                stack.append(_sum([(base, 1.0 - share), (layer, share)]))
            case Add():
                pose, base = stack.pop(), stack.pop()
                share = op.weight * (np.ones(joints) if op.mask < 0 else program.resources.masks[op.mask][0])
                stack.append(_sum([(base, np.ones(joints)), (pose, share)]))
            case Held() | Dead():
                new = np.full(joints, op.weight)
                stack.append(_sum([({"memory": np.ones(joints)}, 1.0 - new), (stack.pop(), new)]))
            case BeginInertial():
                end = stack.pop()
                stack.pop()
                stack.append(end)
            case _:
                pass
    return stack[-1]


def _sum(parts: Sequence[tuple[Mapping[str, Floats], Floats]]) -> dict[str, Floats]:
    total: dict[str, Floats] = {}
    for shares, weight in parts:
        for name, share in shares.items():
            total[name] = total.get(name, 0.0) + weight * share
    return total


def _machine(node: RtMachine, m: Moment) -> MachineTrace:
    state, _, origin, running = m.ints[node.state : node.state + 4]
    name = node.state_names[state]
    if running == NONE:
        return MachineTrace(node.name, name, name, "", 1.0)
    t = node.transitions[running]
    share = smooth(m.floats[node.elapsed] / t.duration_s)
    return MachineTrace(node.name, name, node.state_names[origin], t.kind, share)
