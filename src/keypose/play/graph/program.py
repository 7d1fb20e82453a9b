"""The pose program: what the control logic of a step asks the arrays to do, as a flat list for a stack of poses.

The control logic (times, weights, phases, transitions: plain numbers of one character) emits these operations; an
evaluator runs them on arrays. Each takes its poses from the top of the stack and leaves its result there.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

Vector: TypeAlias = tuple[float, float, float]


class Sample(NamedTuple):
    """Push clip ``clip`` at a time."""

    clip: int
    time_s: float
    node: int  # the node that asks, for traces


class Rest(NamedTuple):
    """Push the rest pose."""


class Mix(NamedTuple):
    """Pop one pose per weight (the first was pushed first); push their mean. The weights sum to 1."""

    weights: tuple[float, ...]


class Over(NamedTuple):
    """Pop a layer, then its base; push the base with the layer over it, where mask * weight says (-1: everywhere)."""

    mask: int
    weight: float


class Add(NamedTuple):
    """Pop a pose, then a base; push the base with the pose's difference from a reference added."""

    mask: int
    weight: float
    reference: int


class Remember(NamedTuple):
    """Keep the top pose as what memory ``memory`` saw last, and how fast it moves (``fresh``: nothing was seen before)."""

    memory: int
    dt_s: float
    fresh: bool


class Hold(NamedTuple):
    """Copy what the memory saw last into what it holds; the top pose (the new motion) sets how the old one dies out."""

    memory: int


class Held(NamedTuple):
    """Pop a pose; push the held pose with ``weight`` of the popped one mixed in."""

    memory: int
    weight: float


class Dead(NamedTuple):
    """The same, but the held pose runs on by itself, slowing down."""

    memory: int
    elapsed_s: float
    weight: float


class BeginInertial(NamedTuple):
    """Pop the new motion at the step's end, then at its start; keep how the old one differs; push the end again."""

    memory: int
    dt_s: float
    duration_s: float


class Inertial(NamedTuple):
    """Pop a pose; push it with what is left of the difference."""

    memory: int
    elapsed_s: float
    duration_s: float


class Bend(NamedTuple):
    """Bend the top pose's contacts from a straight way (direction x, z) onto a curved one (radians per metre)."""

    x: float
    z: float
    curvature: float


class Look(NamedTuple):
    """Pop a pose; push it looking at a target."""

    chain: int
    target: Vector
    weight: float


class Reach(NamedTuple):
    """Pop a pose; push it with a limb's end at a target."""

    limb: int
    target: Vector
    weight: float


class PlantFeet(NamedTuple):
    """Pop a pose; push it with its limbs' contacts where its effectors say."""

    plant: int
    weight: float


Operation: TypeAlias = (
    Sample
    | Rest
    | Mix
    | Over
    | Add
    | Remember
    | Hold
    | Held
    | Dead
    | BeginInertial
    | Inertial
    | Bend
    | Look
    | Reach
    | PlantFeet
)


class Fired(NamedTuple):
    """An event that happened in a step: of a clip, with the weight its node had."""

    name: str
    data: str
    clip: str
    node: str
    weight: float


class Change(NamedTuple):
    """A transition that began in a step."""

    machine: str
    source: str
    target: str
    kind: str
    duration_s: float
    interrupted: bool
