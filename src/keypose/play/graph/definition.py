"""The definition of an animation graph: frozen data, as Python or JSON; it holds names and numbers, no arrays and no state.

A graph is a tree of named nodes. Where a field is a ``Number`` it is either a number or the name of a parameter.
`check` finds everything that is wrong with a definition on its own; `build` then meets it with a skeleton and clips.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

Number: TypeAlias = float | str

SyncMode: TypeAlias = Literal["none", "phase", "markers"]

FORMAT = "keypose-graph"
VERSION = 1


def _nothing() -> Mapping[str, Any]:
    return {}


@dataclass(frozen=True, slots=True)
class Parameter:
    """An input of the graph; it keeps its value until it is set again.

    A trigger stays set until a transition uses it. ``half_life_s`` smooths a float or vector towards what was set.
    Values are kept within ``minimum`` and ``maximum``.
    """

    kind: Literal["float", "int", "bool", "trigger", "vector"] = "float"
    default: float | bool | tuple[float, float, float] = 0.0
    minimum: float | None = None
    maximum: float | None = None
    half_life_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Marker:
    """A named moment of a clip, for synchronisation."""

    name: str
    time_s: float


@dataclass(frozen=True, slots=True)
class ClipEvent:
    """Something that happens at a time of a clip."""

    name: str
    time_s: float
    data: str = ""


@dataclass(frozen=True, slots=True)
class ClipSource:
    """How an animation becomes a clip of the graph.

    ``source`` (``sample:walk``, a file) and ``animation`` say where it comes from when a graph file is run;
    ``start_s`` and ``end_s`` cut it (times from its first frame).
    ``root``: the joint whose travel becomes root motion ("" = the graph's); ``root_motion``: ``linear`` takes the even
    part of the travel (straight or on a circle) and leaves the sway in the pose, ``full`` takes all of it, ``none`` takes nothing.
    ``close_loop`` spreads the gap between last and first frame over the clip.
    ``markers`` are added to those found from the graph's contacts, ``events`` to the motion's own.
    """

    source: str = ""
    animation: str = ""
    start_s: float | None = None
    end_s: float | None = None
    root: str = ""
    root_motion: Literal["linear", "full", "none"] = "linear"
    close_loop: bool = False
    cyclic: bool = True
    markers: tuple[Marker, ...] = ()
    events: tuple[ClipEvent, ...] = ()


@dataclass(frozen=True, slots=True)
class Mask:
    """Weights of joints by name; ``branches`` weights a joint and everything below it, ``joints`` then single ones.

    ``curves`` weighs the morph weights, by name; ``*`` stands for all others.
    """

    branches: Mapping[str, float] = field(default_factory=_nothing)
    joints: Mapping[str, float] = field(default_factory=_nothing)
    curves: Mapping[str, float] = field(default_factory=_nothing)


@dataclass(frozen=True, slots=True)
class Contact:
    """A point that touches the ground: a joint, and the limb (its upper joint) that can hold it there."""

    joint: str
    limb: str = ""  # upper joint, for example LeftUpLeg
    height_m: float = 0.03  # over its lowest place in the clip
    speed_m_s: float = 0.5


# --- nodes ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ClipNode:
    """Plays a clip: ``loops`` times (0: for ever), then holds its end; a negative speed plays it backwards.

    ``start`` is the share of the clip it starts at. ``warp`` bends time inside the clip: points (share of the playing
    time, share of the clip), both rising from 0 to 1. ``sync`` lets a synchronised blend drive it.
    """

    clip: str
    speed: Number = 1.0
    loops: int = 0
    start: float = 0.0
    warp: tuple[tuple[float, float], ...] = ()
    sync: bool = True


@dataclass(frozen=True, slots=True)
class RestNode:
    """The skeleton's rest pose."""


@dataclass(frozen=True, slots=True)
class Sample1D:
    """A node at a place of a 1D blend space."""

    node: str
    at: float


@dataclass(frozen=True, slots=True)
class Blend1D:
    """Blends the two samples beside the parameter; outside the samples the nearest one plays alone."""

    parameter: Number
    samples: tuple[Sample1D, ...]
    sync: SyncMode = "none"
    markers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Sample2D:
    """A node at a place of a 2D blend space."""

    node: str
    at: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Blend2D:
    """Blends samples anywhere in the plane.

    ``delaunay``: the three corners of the triangle that holds the point; outside, the nearest place of the hull.
    ``gradient_band``: all samples whose bands hold the point, smooth, for few samples.
    """

    x: Number
    y: Number
    samples: tuple[Sample2D, ...]
    method: Literal["delaunay", "gradient_band"] = "delaunay"
    sync: SyncMode = "none"
    markers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Input:
    """A node with its weight in a blend."""

    node: str
    weight: Number = 1.0


@dataclass(frozen=True, slots=True)
class Blend:
    """The weighted mean of any number of nodes; negative weights count as 0, and where all are 0 the first plays."""

    inputs: tuple[Input, ...]
    sync: SyncMode = "none"
    markers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Additive:
    """Adds what ``delta`` does to a reference pose: ``rest``, or a clip at a time."""

    base: str
    delta: str
    weight: Number = 1.0
    mask: str = ""
    reference: str = "rest"  # "rest", or a clip's name
    reference_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Layer:
    """Lays ``layer`` over ``base``, where the mask says. Root motion stays the base's."""

    base: str
    layer: str
    weight: Number = 1.0
    mask: str = ""


@dataclass(frozen=True, slots=True)
class Condition:
    """A test of a parameter: ``set`` and ``not set`` for bools and triggers, comparisons for numbers."""

    parameter: str
    test: Literal["set", "not set", ">", ">=", "<", "<=", "==", "!="] = "set"
    value: float = 0.0


@dataclass(frozen=True, slots=True)
class Transition:
    """From one state (``*``: from any other) to another, once all conditions hold and the exit time is reached.

    ``exit_time`` counts cycles of the state that is left: 0.5 is half way through its clip, 2 after it has played twice.
    ``kind``: ``crossfade`` plays both; ``frozen`` fades from the pose that was last seen; ``inertial`` lets the
    difference die out on a quintic; ``dead`` lets the old motion run on by itself and fades.
    ``interrupt``: whose transitions may break this one off while it runs. ``sync`` starts the target in step with the
    source (needs the machine's sync) and keeps both in step while they fade.
    """

    source: str
    target: str
    conditions: tuple[Condition, ...] = ()
    exit_time: float | None = None
    kind: Literal["crossfade", "frozen", "inertial", "dead"] = "crossfade"
    duration_s: float = 0.2
    interrupt: Literal["none", "source", "target", "both"] = "none"
    sync: bool = False


@dataclass(frozen=True, slots=True)
class StateMachine:
    """One state plays at a time. ``states``: name of the state -> node. Transitions are tried in their order."""

    states: Mapping[str, str]
    transitions: tuple[Transition, ...] = ()
    entry: str = ""  # the first state if not given
    sync: SyncMode = "none"
    markers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class TimeWarp:
    """Runs what is below faster or slower; a negative speed stands still."""

    input: str
    speed: Number = 1.0


@dataclass(frozen=True, slots=True)
class Steer:
    """Curves the root motion by an angular speed in degrees per second, positive to the left."""

    input: str
    turn_deg_s: Number


@dataclass(frozen=True, slots=True)
class LookAt:
    """Turns a chain of joints (name -> share) so that the last one faces a target given in the character's space.

    ``forward`` is the facing axis in the last joint's own axes at rest; ``limit_deg`` bounds the whole turn.
    """

    input: str
    target: str  # a vector parameter
    joints: Mapping[str, float]
    weight: Number = 1.0
    forward: tuple[float, float, float] = (0.0, 0.0, 1.0)
    limit_deg: float = 80.0


@dataclass(frozen=True, slots=True)
class TwoBone:
    """Brings the end of a limb (upper joint, middle joint, end joint) to a target in the character's space."""

    input: str
    target: str  # a vector parameter
    upper: str
    middle: str
    end: str
    weight: Number = 1.0
    softness_m: float = 0.01


@dataclass(frozen=True, slots=True)
class Plant:
    """Puts the graph's contacts where the blend of the clips' own contact points is, so that planted feet do not slide."""

    input: str
    contacts: tuple[str, ...] = ()  # all that name a limb if empty
    weight: Number = 1.0


Node: TypeAlias = (
    ClipNode
    | RestNode
    | Blend1D
    | Blend2D
    | Blend
    | Additive
    | Layer
    | StateMachine
    | TimeWarp
    | Steer
    | LookAt
    | TwoBone
    | Plant
)

KINDS: Mapping[str, type[Any]] = {
    "clip": ClipNode,
    "rest": RestNode,
    "blend_1d": Blend1D,
    "blend_2d": Blend2D,
    "blend": Blend,
    "additive": Additive,
    "layer": Layer,
    "state_machine": StateMachine,
    "time_warp": TimeWarp,
    "steer": Steer,
    "look_at": LookAt,
    "two_bone": TwoBone,
    "plant": Plant,
}


@dataclass(frozen=True, slots=True)
class Graph:
    """A whole graph.

    ``root`` is the joint that travels ("" = the skeleton's first); ``apply_root``: the pose that comes out is where the
    character has got to (else it stays in place and the root is reported beside it).
    """

    nodes: Mapping[str, Node]
    output: str
    parameters: Mapping[str, Parameter] = field(default_factory=_nothing)
    clips: Mapping[str, ClipSource] = field(default_factory=_nothing)
    masks: Mapping[str, Mask] = field(default_factory=_nothing)
    contacts: Mapping[str, Contact] = field(default_factory=_nothing)
    name: str = ""
    character: str = ""  # where a graph file's character comes from
    root: str = ""
    apply_root: bool = True


def inputs_of(node: Node) -> tuple[tuple[str, str], ...]:
    """The nodes below a node, each with the field that names it."""
    match node:
        case ClipNode() | RestNode():
            return ()
        case Blend1D() | Blend2D():
            return tuple((f"samples[{i}].node", s.node) for i, s in enumerate(node.samples))
        case Blend():
            return tuple((f"inputs[{i}].node", s.node) for i, s in enumerate(node.inputs))
        case Additive():
            return (("base", node.base), ("delta", node.delta))
        case Layer():
            return (("base", node.base), ("layer", node.layer))
        case StateMachine():
            return tuple((f"states['{state}']", below) for state, below in node.states.items())
        case _:
            return (("input", node.input),)
