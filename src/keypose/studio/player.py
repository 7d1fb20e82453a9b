"""A graph that is being played: its state, what is recorded of it, and its steps as messages. It knows no clock and no socket."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from keypose.play import graph as g
from keypose.play.graph.rootmotion import STILL
from keypose.studio import describe
from keypose.studio.container import Body
from keypose.studio.graphs import OpenedGraph, Stage
from keypose.studio.messages import PlayChange, PlayEvent, PlayFrame, PlayReady

RATE_HZ = 60.0
LONGEST_STEP_S = 0.1  # a page that was not seen for a minute goes on where it was
LONGEST_TAKE_S = 120.0

Values = Mapping[str, list[float]]


@dataclass(slots=True)
class Recording:
    """What is needed to run a piece again: the state it began in, and the inputs since."""

    start: g.State
    inputs: list[g.Inputs] = field(default_factory=list[g.Inputs])
    duration_s: float = 0.0

    @property
    def frame_count(self) -> int:
        """Of the baked run, first and last moment included."""
        return int(self.duration_s * RATE_HZ + 1e-6) + 1


class Player:
    """One character in one graph."""

    def __init__(self, number: int, opened: OpenedGraph, stage: Stage) -> None:
        self.number, self.opened, self.stage = number, opened, stage
        self.joint = -1
        self.frames = 0
        self.recording: Recording | None = None
        self._explainer = describe.Explainer(stage.program)
        self._state = g.init(stage.program)

    def ready(self) -> PlayReady:
        """All that stays as it is."""
        program = self.stage.program
        return PlayReady(
            type="play_ready",
            player=self.number,
            graph=self.opened.entry,
            scene=self.stage.scene,
            parameters=describe.parameters(program.graph),
            nodes=describe.nodes(program.graph),
            clips=describe.clips(program),
            contacts=describe.contacts(program),
            contributors=describe.contributors(program),
            rate_hz=RATE_HZ,
        )

    def unknown(self, values: Values) -> str:
        """What is wrong with values that a browser sent, or nothing."""
        inputs = self.stage.program.inputs
        for name, numbers in values.items():
            if name not in inputs:
                return f"the graph has no parameter '{name[:60]}'"
            if len(numbers) != inputs[name].width:
                return f"parameter '{name}': expected {inputs[name].width} numbers, got {len(numbers)}"
            if inputs[name].definition.kind == "int" and numbers[0] != int(numbers[0]):
                return f"parameter '{name}': expected a whole number, got {numbers[0]:g}"
        return ""

    # ---- steps -----------------------------------------------------------------------------------------------------

    def step(self, values: Values, dt_s: float, *, heard: int = 0, round_trip_s: float = 0.0) -> tuple[PlayFrame, Body]:
        """Set parameters, move on, and say what happened; without time, only the pose is computed again."""
        recording = self.recording
        if recording is not None and values:
            # they act in the step that begins now, not in one that ends now
            recording.inputs.append(g.Inputs(recording.duration_s + 1e-6, dict(values)))
        self._state, output = g.step(self._state, values, dt_s=dt_s, trace=True)
        if recording is not None:
            recording.duration_s += dt_s
        self.frames += 1
        return self._frame(output, dt_s, heard, round_trip_s)

    def reset(self) -> None:
        """Back to the first state; a recording that runs is lost."""
        self._state = g.init(self.stage.program)
        self.recording = None

    def record(self) -> None:
        """Begin to record here; the recording begins at the origin, facing +Z."""
        self.recording = Recording(replace(self._state, root=STILL))

    def end_recording(self) -> Recording | None:
        """What was recorded."""
        recording, self.recording = self.recording, None
        return recording

    def _frame(self, output: g.Output, dt_s: float, heard: int, round_trip_s: float) -> tuple[PlayFrame, Body]:
        trace, body, explain = output.trace, Body(), self._explainer
        if trace is None:
            raise RuntimeError("a step without a trace")
        pose = np.concatenate([output.pose.translations, output.pose.rotations, output.pose.scales], axis=-1)
        parameters = [number for values in trace.parameters.values() for number in values]
        frame = PlayFrame(
            type="play_frame",
            player=self.number,
            number=self.frames,
            time_s=trace.time_s,
            dt_s=dt_s,
            heard=heard,
            root=[float(n) for n in output.root],
            pose=body.add(pose, "float32"),
            morphs=body.add(output.morph_weights, "float32"),
            contacts=body.add(list(output.contacts.values()), "float32"),
            parameters=body.add(parameters, "float32"),
            shares=body.add(explain.shares(trace), "float32"),
            phases=body.add(explain.phases(trace), "float32"),
            machines=body.add(explain.machines(trace), "float32"),
            syncs=body.add(explain.syncs(trace), "float32"),
            joint=self.joint,
            contributions=body.add(explain.contributions(trace, self.joint), "float32"),
            events=[PlayEvent(*event) for event in output.events],
            changes=[PlayChange(*change) for change in output.changes],
            control_us=trace.control_s * 1e6,
            pose_us=trace.pose_s * 1e6,
            round_trip_ms=round_trip_s * 1e3,
            recorded_s=None if self.recording is None else self.recording.duration_s,
        )
        return frame, body


def bake(recording: Recording, stage: Stage) -> g.Run:
    """Run a recording again at an even rate: the same graph from the same state with the same inputs."""
    return g.run_program(
        stage.program,
        recording.inputs,
        frame_count=recording.frame_count,
        rate_hz=RATE_HZ,
        character=stage.character,
        start=recording.start,
    )
