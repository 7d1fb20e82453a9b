"""State and steps of a running graph: ``state = init(program)``, ``state, output = step(state, parameters, dt_s=...)``."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import ShapeError, UnknownName
from keypose.math import quat
from keypose.model import Pose
from keypose.play.graph.build import Program
from keypose.play.graph.control import LONGEST_STEP_S, Moment
from keypose.play.graph.poses import Buffer, Layout, Memory, evaluate, to_pose
from keypose.play.graph.program import Change, Fired, Operation
from keypose.play.graph.rootmotion import STILL, Ground, compose
from keypose.play.graph.trace import Trace, make_trace

ParameterValue = float | bool | Sequence[float]


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Everything a running graph knows, as plain numbers and frozen arrays; a step makes a new one and leaves the old.

    ``root`` is where the character has got to: x, z (metres), yaw (radians).
    """

    program: Program
    floats: tuple[float, ...]
    ints: tuple[int, ...]
    memory: tuple[Memory, ...]
    number: int = 0
    time_s: float = 0.0
    root: Ground = STILL


@dataclass(frozen=True, slots=True, eq=False)
class Output:
    """What a step gives.

    Shapes and units: pose of batch shape (); morph_weights (M,); contacts: per contact how far it touches, 0 to 1;
    root and root_step: (x, z, yaw), metres and radians, the step seen from the root before it.
    """

    pose: Pose
    morph_weights: Array
    contacts: Mapping[str, float]
    root: Ground
    root_step: Ground
    events: tuple[Fired, ...]
    changes: tuple[Change, ...]
    trace: Trace | None = None


def init(program: Program, parameters: Mapping[str, ParameterValue] | None = None, root: Ground = STILL) -> State:
    """The first state of a graph; parameters that are given start at their values at once.

    Raises:
        UnknownName, ShapeError: for parameters that do not exist or do not fit.
    """
    moment = Moment(list(program.floats), list(program.ints), 0)
    _set(program, moment.floats, parameters or {})
    for entry in program.inputs.values():
        for i in range(entry.slot, entry.slot + entry.width):
            moment.floats[i] = moment.floats[i + entry.width]
    program.root.enter(moment)
    memory = tuple(Memory() for _ in range(program.memories))
    return State(program, tuple(moment.floats), tuple(moment.ints), memory, root=root)


def step(
    state: State, parameters: Mapping[str, ParameterValue] | None = None, *, dt_s: float, trace: bool = False
) -> tuple[State, Output]:
    """Move a graph on by a time from 0 to 60 s.

    Transitions are decided first, on the state as it is; then times move on, and the pose at the end of the step is
    computed. A step of 0 s only sets parameters and poses. Same state and same inputs give the same bits.

    Raises:
        UnknownName, ShapeError: for parameters or a time that do not fit.
    """
    program = state.program
    began = time.perf_counter() if trace else 0.0
    moment, root_step, ops = control_step(state, parameters or {}, dt_s)
    decided = time.perf_counter() if trace else 0.0
    memory = list(state.memory)
    buffer = evaluate(ops, program.resources, memory)
    root = compose(state.root, root_step)
    layout = program.resources.layout
    posed = _with_root(buffer, program, root) if program.graph.apply_root else buffer
    after = State(
        program,
        tuple(moment.floats),
        tuple(moment.ints),
        tuple(memory),
        state.number + 1,
        state.time_s + dt_s,
        root,
    )
    output = Output(
        to_pose(posed, layout, program.dtype),
        buffer.linear[layout.curve_slice].astype(program.dtype),
        _contacts(program, buffer, layout),
        root,
        root_step,
        tuple(moment.events),
        tuple(moment.changes),
    )
    if trace:
        finished = time.perf_counter()
        made = make_trace(program, moment, ops, state.time_s + dt_s, decided - began, finished - decided)
        output = replace(output, trace=made)
    return after, output


def control_step(
    state: State, parameters: Mapping[str, ParameterValue], dt_s: float
) -> tuple[Moment, Ground, list[Operation]]:
    """The scalar half of a step: new numbers, the step of the root, and the pose program. Nothing is sampled."""
    if not 0 <= dt_s <= LONGEST_STEP_S:
        raise ShapeError(f"dt_s: expected a time from 0 to {LONGEST_STEP_S:g} s, got {dt_s}")
    program = state.program
    moment = Moment(list(state.floats), list(state.ints), state.number)
    _set(program, moment.floats, parameters)
    _smooth(program, moment.floats, float(dt_s))
    root_step = program.root.advance(moment, float(dt_s), 1.0)
    ops: list[Operation] = []
    program.root.emit(moment, ops)
    return moment, root_step, ops


def _set(program: Program, floats: list[float], parameters: Mapping[str, ParameterValue]) -> None:
    for name, value in parameters.items():
        if name not in program.inputs:
            raise UnknownName("parameter", name, program.inputs)
        entry = program.inputs[name]
        p = entry.definition
        numbers = [float(v) for v in np.ravel(np.asarray(value, np.float64))]
        if len(numbers) != entry.width or not all(math.isfinite(n) for n in numbers):
            wanted = "three finite numbers" if entry.width == 3 else "a finite number"
            raise ShapeError(f"parameter '{name}': expected {wanted}, got {value!r}")
        if p.kind in ("bool", "trigger"):
            numbers = [float(numbers[0] != 0)]
        elif p.kind == "int" and numbers[0] != int(numbers[0]):
            raise ShapeError(f"parameter '{name}': expected a whole number, got {value!r}")
        low = -math.inf if p.minimum is None else p.minimum
        high = math.inf if p.maximum is None else p.maximum
        at = entry.slot + entry.width
        floats[at : at + entry.width] = [min(max(n, low), high) for n in numbers]
        if p.kind == "trigger":
            floats[entry.slot] = floats[at]


def _smooth(program: Program, floats: list[float], dt_s: float) -> None:
    """What was set becomes what is used, at once or by its half-life; triggers are used where they were set."""
    for entry in program.inputs.values():
        if entry.definition.kind == "trigger":
            continue
        half = entry.definition.half_life_s
        keep = 2.0 ** (-dt_s / half) if half > 0 else 0.0
        for i in range(entry.slot, entry.slot + entry.width):
            wanted = floats[i + entry.width]
            floats[i] = wanted + keep * (floats[i] - wanted)


def _with_root(buffer: Buffer, program: Program, root: Ground) -> Buffer:
    """The pose where the character has got to."""
    turn = quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), root[2])
    rotations, linear = buffer.rotations.copy(), buffer.linear.copy()
    for top in np.flatnonzero(program.skeleton.parents < 0):
        at = slice(3 * int(top), 3 * int(top) + 3)
        rotations[top] = quat.multiply(turn, rotations[top])
        linear[at] = quat.rotate(turn, linear[at]) + np.array([root[0], 0.0, root[1]])
    return Buffer(rotations, linear)


def _contacts(program: Program, buffer: Buffer, layout: Layout) -> Mapping[str, float]:
    flags: Any = buffer.linear[layout.touching_slice]
    return {name: float(min(max(f, 0.0), 1.0)) for name, f in zip(program.graph.contacts, flags, strict=True)}
