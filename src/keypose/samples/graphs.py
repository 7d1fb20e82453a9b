"""Graphs of the built-in human: data only; its clips are the built-in performances."""

from __future__ import annotations

from functools import cache

from keypose.errors import UnknownName
from keypose.play.graph import (
    Blend1D,
    ClipEvent,
    ClipNode,
    ClipSource,
    Condition,
    Contact,
    Graph,
    Layer,
    LookAt,
    Mask,
    Parameter,
    Plant,
    Sample1D,
    StateMachine,
    Steer,
    Transition,
)

WALK_M_S, RUN_M_S = 1.2097, 3.2857  # speeds of the two performances


def names() -> list[str]:
    """The graphs there are."""
    return ["locomotion"]


@cache
def load(name: str) -> Graph:
    """The graph of that name; raises `UnknownName`."""
    makers = {"locomotion": locomotion}
    if name not in makers:
        raise UnknownName("graph", name, names())
    return makers[name]()


def contacts() -> dict[str, Contact]:
    """The balls of both feet, held by the legs."""
    return {
        f"{side.lower()}_foot": Contact(f"{side}ToeBase", f"{side}UpLeg", height_m=0.008, speed_m_s=0.3)
        for side in ("Left", "Right")
    }


def locomotion() -> Graph:
    """Idle, walk and run by ``speed`` (m/s), turning by ``turn`` (degrees per second), ``jump``, ``wave``, and a look.

    Moving is a blend of idle, walk and run in step (marker sync on the feet). Jumping interrupts everything by
    inertialisation; waving is a layer on the right arm, the neck and the face that starts anew whenever ``wave`` leaves 0.
    """
    clips = {name: ClipSource(f"sample:{name}", name) for name in ("idle", "walk", "run")} | {
        "jump": ClipSource(
            "sample:jump", "jump", cyclic=False, events=(ClipEvent("take_off", 0.6), ClipEvent("land", 1.15))
        ),
        "wave": ClipSource("sample:wave", "wave", cyclic=False),
    }
    nodes = {
        "idle": ClipNode("idle", sync=False),
        "walk": ClipNode("walk"),
        "run": ClipNode("run"),
        "gaits": Blend1D("speed", (Sample1D("walk", WALK_M_S), Sample1D("run", RUN_M_S)), sync="markers"),
        "move": Steer("gaits", "turn"),
        "jump": ClipNode("jump", loops=1),
        "body": StateMachine(
            {"idle": "idle", "move": "move", "jump": "jump"},
            (
                Transition("*", "jump", (Condition("jump"),), kind="inertial", duration_s=0.25, interrupt="none"),
                Transition("jump", "move", (Condition("speed", ">", 0.3),), 0.92, "inertial", 0.3, "both"),
                Transition("jump", "idle", (), 0.97, "inertial", 0.3, "both"),
                Transition("idle", "move", (Condition("speed", ">", 0.3),), None, "inertial", 0.3, "both"),
                Transition("move", "idle", (Condition("speed", "<=", 0.3),), None, "inertial", 0.35, "both"),
            ),
        ),
        "planted": Plant("body"),
        "arms_down": ClipNode("idle", sync=False),
        "wave": ClipNode("wave"),
        "waving": StateMachine(
            {"rest": "arms_down", "wave": "wave"},
            (
                Transition("rest", "wave", (Condition("wave", ">", 0.01),), None, "crossfade", 0.0),
                Transition("wave", "rest", (Condition("wave", "<=", 0.01),), None, "crossfade", 0.0),
            ),
        ),
        "layered": Layer("planted", "waving", "wave", "right_arm"),
        "look": LookAt("layered", "look_at", {"Spine2": 0.2, "Neck": 0.3, "Head": 0.5}, "look", limit_deg=70.0),
    }
    return Graph(
        nodes,
        "look",
        {
            "speed": Parameter("float", 0.0, 0.0, RUN_M_S, half_life_s=0.1),
            "turn": Parameter("float", 0.0, -120.0, 120.0, half_life_s=0.1),
            "jump": Parameter("trigger"),
            "wave": Parameter("float", 0.0, 0.0, 1.0, half_life_s=0.22),
            "look": Parameter("float", 0.0, 0.0, 1.0, half_life_s=0.15),
            "look_at": Parameter("vector", (0.0, 1.5, 3.0), half_life_s=0.1),
        },
        clips,
        {"right_arm": Mask({"RightShoulder": 1.0}, {"Spine2": 0.3, "Neck": 0.6, "Head": 0.6}, {"*": 0.8})},
        contacts(),
        "locomotion",
        "sample:human",
    )
