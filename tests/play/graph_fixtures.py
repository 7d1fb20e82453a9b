"""A small skeleton, moving clips made by formula, and graphs to play them with."""

from __future__ import annotations

from typing import Any

import numpy as np

from keypose.math import quat
from keypose.model import Event, Motion, Pose, Skeleton
from keypose.play import graph as g

NAMES = ("hips", "spine", "head", "thigh", "shin", "foot")
PARENTS = [-1, 0, 1, 0, 3, 4]
OFFSETS = np.array([[0, 0.9, 0], [0, 0.3, 0], [0, 0.3, 0], [0.1, 0, 0], [0, -0.4, 0.03], [0, -0.4, -0.03]])


def skeleton(dtype: Any = np.float64) -> Skeleton:
    rest = Pose(OFFSETS.astype(dtype), quat.identity((6,)).astype(dtype), np.ones((6, 3), dtype))
    return Skeleton(NAMES, PARENTS, rest)


def clip(
    name: str,
    *,
    duration_s: float = 1.0,
    rate_hz: float = 60.0,
    travel: tuple[float, float, float] = (0.0, 0.0, 0.0),
    swing: float = 0.5,
    phase: float = 0.0,
    events: tuple[Event, ...] = (),
) -> Motion:
    """A cyclic motion: joints swing on sines; the hips travel (x, z, yaw) at constant speed on top."""
    count = round(duration_s * rate_hz) + 1
    u = np.arange(count) / (count - 1)
    angle = swing * np.sin(2 * np.pi * (u[:, None] + phase + 0.13 * np.arange(6)))
    axes = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0]], float)
    rotations = quat.from_axis_angle(np.broadcast_to(axes, (count, 6, 3)), angle)
    yaw = quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), u * travel[2])
    rotations[:, 0] = quat.multiply(yaw, rotations[:, 0])
    translations = np.tile(OFFSETS, (count, 1, 1))
    translations[:, 0] += np.stack([u * travel[0], 0.02 * np.sin(4 * np.pi * u), u * travel[1]], axis=-1)
    scales = np.ones((count, 6, 3))
    scales[:, 2] = 1 + 0.1 * np.sin(2 * np.pi * u)[:, None]
    weights = np.stack([0.5 - 0.5 * np.cos(2 * np.pi * u), u * (1 - u)], axis=-1)
    return Motion(
        NAMES,
        Pose(translations, rotations, scales),
        count and rate_hz,
        name,
        morph_names=("smile", "blink"),
        morph_weights=weights,
        events=events,
    )


def clips() -> dict[str, Motion]:
    return {
        "a": clip("a", duration_s=1.0, travel=(0.0, 1.2, 0.0), events=(Event(0.0, "start"), Event(0.5, "half"))),
        "b": clip("b", duration_s=0.7, travel=(0.1, 2.5, 0.4), swing=0.9, phase=0.2, events=(Event(0.7, "end"),)),
        "c": clip("c", duration_s=2.3, swing=0.2, phase=0.6, events=(Event(1.1, "mid"),)),
    }


def single(node: Any, **more: Any) -> g.Graph:
    """A graph of one node over the clips a, b and c."""
    return g.Graph({"top": node}, "top", clips=sources(), **more)


def sources(root_motion: Any = "full") -> dict[str, g.ClipSource]:
    return {name: g.ClipSource(root_motion=root_motion) for name in ("a", "b", "c")}


def build(graph: g.Graph, **options: Any) -> g.Program:
    return g.build(graph, skeleton(), clips(), **options)


def machine(kind: Any, duration_s: float = 0.3, **options: Any) -> g.Graph:
    """a -> b on the trigger ``go``, b -> a on ``back``."""
    nodes = {
        "a": g.ClipNode("a"),
        "b": g.ClipNode("b"),
        "top": g.StateMachine(
            {"first": "a", "second": "b"},
            (
                g.Transition("first", "second", (g.Condition("go"),), None, kind, duration_s, **options),
                g.Transition("second", "first", (g.Condition("back"),), None, kind, duration_s, **options),
            ),
        ),
    }
    parameters = {"go": g.Parameter("trigger"), "back": g.Parameter("trigger")}
    return g.Graph(nodes, "top", parameters, sources())
