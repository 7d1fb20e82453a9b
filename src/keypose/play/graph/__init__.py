"""The animation graph: blend spaces, layers, state machines, transitions, synchronisation, root motion, events.

>>> from keypose.play import graph
>>> definition = graph.Graph({"still": graph.RestNode()}, output="still")

A definition (`Graph`) is plain data, in Python or JSON. `build` meets it with a skeleton and clips, `init` gives the first
state, and `step` moves it on. This is the reference evaluator: exact, readable, one character at a time; `prepare_crowd` and
`animate_crowd` do the same for thousands at once.
"""

from keypose.play.graph.assets import find_cycle
from keypose.play.graph.build import Program, build
from keypose.play.graph.checking import GraphError, check, problems
from keypose.play.graph.crowds import (
    GraphCrowd,
    animate_crowd,
    crowd_changes,
    crowd_events,
    crowd_matrices,
    prepare_crowd,
    set_parameter,
)
from keypose.play.graph.definition import (
    Additive,
    Blend,
    Blend1D,
    Blend2D,
    ClipEvent,
    ClipNode,
    ClipSource,
    Condition,
    Contact,
    Graph,
    Input,
    Layer,
    LookAt,
    Marker,
    Mask,
    Parameter,
    Plant,
    RestNode,
    Sample1D,
    Sample2D,
    StateMachine,
    Steer,
    TimeWarp,
    Transition,
    TwoBone,
)
from keypose.play.graph.files import from_json, load, save, to_json
from keypose.play.graph.program import Change, Fired
from keypose.play.graph.running import Inputs, Run, assemble, in_place, inputs_from_json, run, run_program
from keypose.play.graph.stepping import Output, State, init, step
from keypose.play.graph.trace import Trace

__all__ = [
    "Additive",
    "Blend",
    "Blend1D",
    "Blend2D",
    "Change",
    "ClipEvent",
    "ClipNode",
    "ClipSource",
    "Condition",
    "Contact",
    "Fired",
    "Graph",
    "GraphCrowd",
    "GraphError",
    "Input",
    "Inputs",
    "Layer",
    "LookAt",
    "Marker",
    "Mask",
    "Output",
    "Parameter",
    "Plant",
    "Program",
    "RestNode",
    "Run",
    "Sample1D",
    "Sample2D",
    "State",
    "StateMachine",
    "Steer",
    "TimeWarp",
    "Trace",
    "Transition",
    "TwoBone",
    "animate_crowd",
    "assemble",
    "build",
    "check",
    "crowd_changes",
    "crowd_events",
    "crowd_matrices",
    "find_cycle",
    "from_json",
    "in_place",
    "init",
    "inputs_from_json",
    "load",
    "prepare_crowd",
    "problems",
    "run",
    "run_program",
    "save",
    "set_parameter",
    "step",
    "to_json",
]
