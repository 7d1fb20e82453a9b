"""A graph run from inputs over time to a baked motion: what the command line and tests use, and what can be saved."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import FormatError, ShapeError
from keypose.model import Character, Clip, Event, Motion, Pose, Scene, Skeleton
from keypose.play.graph.build import Program, build
from keypose.play.graph.checking import GraphError
from keypose.play.graph.definition import Graph
from keypose.play.graph.program import Change, Fired
from keypose.play.graph.stepping import Output, ParameterValue, State, init, step
from keypose.play.graph.trace import Trace

MOST_FRAMES = 1_000_000


@dataclass(frozen=True, slots=True)
class Inputs:
    """Parameters set at a time; triggers among them are pulled at that time."""

    at_s: float
    values: Mapping[str, ParameterValue]


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What a run gave, T frames.

    Shapes and units: motion with the events of the run; root (T, 3): x, z in metres, yaw in radians; contacts (T, E), 0 to
    1; events and changes with their times; traces, one per frame where they were asked for.
    """

    motion: Motion
    root: Array
    contacts: Array
    events: tuple[tuple[float, Fired], ...]
    changes: tuple[tuple[float, Change], ...]
    traces: tuple[Trace, ...]
    character: Character | None = None

    def scene(self) -> Scene:
        """The character with the baked motion, ready for `keypose.io.save`; raises `ShapeError` without a character."""
        if self.character is None:
            raise ShapeError("run: it was given a skeleton, not a character; build a Scene around its motion")
        return Scene((self.character,), (self.motion,), format="keypose-graph")


def run(
    graph: Graph,
    inputs: Sequence[Inputs] = (),
    *,
    duration_s: float,
    rate_hz: float = 60.0,
    open_scene: Callable[[str], Scene] | None = None,
    character: Character | Skeleton | None = None,
    clips: Mapping[str, Motion | Clip] | None = None,
    trace: bool = False,
) -> Run:
    """Run a graph from its first state over a time, and bake what it does.

    ``open_scene`` (`keypose.samples.open_scene`) finds the character and the clips that the graph names; either may be
    given instead. Frame 0 is the graph at time 0; inputs take effect in the step that ends at or after their time.

    Raises:
        GraphError: where the graph does not fit, or names nothing to play and nothing was given.
        ShapeError: where the run is too long, or inputs are not in order of time.
    """
    count = _frames(duration_s, rate_hz)
    program, whom = assemble(graph, open_scene=open_scene, character=character, clips=clips)
    return run_program(program, inputs, frame_count=count, rate_hz=rate_hz, trace=trace, character=whom)


def assemble(
    graph: Graph,
    *,
    open_scene: Callable[[str], Scene] | None = None,
    character: Character | Skeleton | None = None,
    clips: Mapping[str, Motion | Clip] | None = None,
) -> tuple[Program, Character | None]:
    """Find the character and the clips that a graph names, and `build` it; None where a bare skeleton was given.

    Raises:
        GraphError: where the graph does not fit, or names nothing to play and nothing was given.
    """
    whom = _character(graph, character, open_scene)
    found = _clips(graph, clips, open_scene)
    if not isinstance(whom, Character):
        return build(graph, whom, found), None
    names, rest = whom.morph_names, whom.rest_morph_weights
    return build(graph, whom.skeleton, found, morph_names=names, rest_morph_weights=rest), whom


def run_program(
    program: Program,
    inputs: Sequence[Inputs] = (),
    *,
    frame_count: int,
    rate_hz: float = 60.0,
    trace: bool = False,
    character: Character | None = None,
    start: State | None = None,
) -> Run:
    """The same for a graph that is built already; from ``start``, a state of it, instead of its first one."""
    if any(b.at_s < a.at_s for a, b in itertools.pairwise(inputs)):
        raise ShapeError("inputs: expected times in rising order")
    if start is not None and start.program is not program:
        raise ShapeError("start: expected a state of the same program")
    state = init(program) if start is None else start
    left = list(inputs)
    outputs: list[Output] = []
    events: list[tuple[float, Fired]] = []
    changes: list[tuple[float, Change]] = []
    for frame in range(frame_count):
        time_s = frame / rate_hz
        values: dict[str, ParameterValue] = {}
        while left and left[0].at_s <= time_s + 1e-9:
            values.update(left.pop(0).values)
        state, output = step(state, values, dt_s=1.0 / rate_hz if frame else 0.0, trace=trace)
        outputs.append(output)
        events += [(time_s, e) for e in output.events]
        changes += [(time_s, c) for c in output.changes]
    pose = Pose(
        np.stack([o.pose.translations for o in outputs]),
        np.stack([o.pose.rotations for o in outputs]),
        np.stack([o.pose.scales for o in outputs]),
    )
    weights = np.stack([o.morph_weights for o in outputs]) if program.curve_names else None
    motion = Motion(
        program.skeleton.names,
        pose,
        rate_hz,
        program.graph.name or "graph",
        morph_names=program.curve_names,
        morph_weights=weights,
        events=tuple(Event(t, e.name, e.data) for t, e in events),
    )
    return Run(
        motion,
        np.array([o.root for o in outputs]),
        np.array([list(o.contacts.values()) for o in outputs]).reshape(len(outputs), -1),
        tuple(events),
        tuple(changes),
        tuple(o.trace for o in outputs if o.trace is not None),
        character,
    )


def inputs_from_json(text: str | bytes) -> tuple[Inputs, ...]:
    """Inputs over time: ``[{"at_s": 0.5, "set": {"speed": 1.2, "jump": true}}, ...]``, sorted by time.

    Raises:
        FormatError: where the text is anything else; the message names the entry.
    """
    try:
        data: Any = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"no JSON: {error}") from None
    if not isinstance(data, list):
        raise FormatError('expected a list of {"at_s": ..., "set": {...}}')
    found: list[Inputs] = []
    for i, entry in enumerate(data):
        where = f"[{i}]"
        if not isinstance(entry, dict) or set(entry) != {"at_s", "set"}:
            raise FormatError('expected an object with "at_s" and "set"', where=where)
        at_s, values = entry["at_s"], entry["set"]
        if isinstance(at_s, bool) or not isinstance(at_s, (int, float)) or not (math.isfinite(at_s) and at_s >= 0):
            raise FormatError("expected a time >= 0", where=f"{where}.at_s")
        if not isinstance(values, dict):
            raise FormatError("expected an object of parameters", where=f"{where}.set")
        for name, value in values.items():
            numbers = value if isinstance(value, list) else [value]
            if not numbers or not all(isinstance(n, (int, float)) for n in numbers):
                raise FormatError("expected a number, true or false, or three numbers", where=f"{where}.set.{name}")
        found.append(Inputs(float(at_s), values))
    return tuple(sorted(found, key=lambda entry: entry.at_s))


def in_place(graph: Graph) -> Graph:
    """The graph with poses that stay over the origin; the root is reported beside them."""
    return replace(graph, apply_root=False)


def _frames(duration_s: float, rate_hz: float) -> int:
    if not (math.isfinite(rate_hz) and rate_hz > 0 and math.isfinite(duration_s) and duration_s >= 0):
        raise ShapeError(f"expected a duration >= 0 s and a rate > 0 Hz, got {duration_s} s at {rate_hz} Hz")
    count = math.floor(duration_s * rate_hz + 1e-6) + 1
    if count > MOST_FRAMES:
        raise ShapeError(f"duration_s: expected at most {MOST_FRAMES} frames, got {count}")
    return count


def _character(
    graph: Graph, given: Character | Skeleton | None, open_scene: Callable[[str], Scene] | None
) -> Character | Skeleton:
    if given is not None:
        return given
    if not graph.character or open_scene is None:
        raise GraphError("", "character", "the graph names none and none was given")
    return open_scene(graph.character).character


def _clips(
    graph: Graph, given: Mapping[str, Motion | Clip] | None, open_scene: Callable[[str], Scene] | None
) -> dict[str, Motion | Clip]:
    found: dict[str, Motion | Clip] = dict(given or {})
    for name, source in graph.clips.items():
        if name in found:
            continue
        if not source.source or open_scene is None:
            raise GraphError("", f"clips['{name}'].source", "it names no file or sample and no animation was given")
        found[name] = open_scene(source.source).animation(source.animation or None)
    return found
