"""Small graphs of the tube, and a page without a browser that plays them."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from studio_scenes import arm_scene

from keypose.play import graph as g
from keypose.studio.container import array, unpack
from keypose.studio.graphs import OpenedGraph


def arm_graph() -> g.Graph:
    """Two clips in a blend space, a state machine with all kinds of transitions, and something added."""
    clips = {
        "wave": g.ClipSource("arm", "wave", events=(g.ClipEvent("half", 0.5),)),
        "sway": g.ClipSource("arm", "sway"),
    }
    nodes: dict[str, g.Node] = {
        "wave": g.ClipNode("wave"),
        "sway": g.ClipNode("sway"),
        "space": g.Blend1D("speed", (g.Sample1D("wave", 0.0), g.Sample1D("sway", 2.0))),
        "still": g.RestNode(),
        "other": g.ClipNode("wave", speed=0.5),
        "modes": g.StateMachine(
            {"go": "space", "rest": "still", "slow": "other"},
            (
                g.Transition("go", "rest", (g.Condition("stop"),), kind="crossfade", duration_s=0.3),
                g.Transition("rest", "slow", (g.Condition("stop"),), kind="inertial", duration_s=0.3),
                g.Transition("slow", "go", (g.Condition("stop"),), kind="frozen", duration_s=0.3, interrupt="both"),
                g.Transition("go", "slow", (g.Condition("fast", "set"),), None, "dead", 0.3),
            ),
        ),
        "extra": g.ClipNode("sway"),
        "top": g.Layer("modes", "extra", "amount"),
    }
    parameters = {
        "speed": g.Parameter("float", 0.0, 0.0, 2.0),
        "stop": g.Parameter("trigger"),
        "fast": g.Parameter("bool", default=False),
        "amount": g.Parameter("float", 0.0, 0.0, 1.0),
        "goal": g.Parameter("vector", (0.0, 1.0, 0.0)),
        "level": g.Parameter("int", 1.0),
    }
    return g.Graph(nodes, "top", parameters, clips, name="arm", character="arm")


def opened_arm(id: str = "file:0") -> OpenedGraph:
    """The graph as the studio has it."""
    return OpenedGraph(id, "arm.json", arm_graph(), lambda _: arm_scene())


class PlainPage:
    """The other end of the socket: acknowledges what it gets, and plays."""

    def __init__(self, socket: Any, *, draws: bool = True) -> None:
        self.socket, self.draws = socket, draws
        self.frames: list[dict[str, Any]] = []
        self.bodies: list[memoryview] = []
        self._sequence = 0

    def say(self, kind: str, **fields: Any) -> None:
        """Send a message."""
        self.socket.send(json.dumps({"type": kind, **fields}))

    def set(self, **values: Any) -> int:
        """Set parameters; the number that a frame says when it obeys."""
        self._sequence += 1
        lists = {name: value if isinstance(value, list) else [value] for name, value in values.items()}
        self.say("play_input", sequence=self._sequence, values=lists)
        return self._sequence

    def take(self, timeout_s: float = 20.0) -> dict[str, Any]:
        """The next message."""
        header, body = unpack(self.socket.recv(timeout=timeout_s))
        self.say("acknowledge", sequence=header["sequence"])
        message = header["message"]
        if message["type"] == "play_frame":
            self.frames.append(message)
            self.bodies.append(body)
            if self.draws:
                self.say("play_acknowledge", number=message["number"])
        return message

    def until(self, kind: str, condition: Callable[[dict[str, Any]], Any] = lambda _: True) -> dict[str, Any]:
        """The next message of this kind for which something holds."""
        end = time.monotonic() + 30
        while time.monotonic() < end:
            message = self.take()
            if message["type"] == kind and condition(message):
                return message
        raise AssertionError(f"waited in vain for {kind}")

    def silence(self, seconds: float) -> int:
        """How many frames come in a time."""
        count, end = 0, time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                count += self.take(left)["type"] == "play_frame"
            except TimeoutError:
                break
        return count

    def array(self, name: str, frame: int = -1) -> np.ndarray:
        """An array of a frame."""
        ref = self.frames[frame][name]
        return np.frombuffer(array(self.bodies[frame], ref), np.float32).reshape(ref["shape"])
