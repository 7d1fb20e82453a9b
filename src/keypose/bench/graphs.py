"""Whole animation graphs for crowds: how long a character takes, how many there may be, and how good what comes out is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from keypose import evaluate
from keypose.bench import data
from keypose.bench.suite import Suite
from keypose.model import Motion, Pose, Skeleton
from keypose.play import graph as g

_STEP_S = 1 / 60
_SPEEDS = (1.2, 2.4, 3.6)
_FLIPS = 64  # rounds of characters that change state, drawn before anything is timed
_LIVELY = 0.01  # of the characters change state in a step: each about every 1.7 s


def add(suite: Suite) -> None:
    """All rows of graphs."""
    skeleton, clips = _body()
    program = g.build(_full_graph(), skeleton, clips)
    checked = _check(suite, program)
    for count, name, unit in (
        (1000, "full graph, crowd 1,000", "us/character"),
        (10_000, "characters at 60 Hz on one core", "characters"),
    ):
        call = _lively(program, count, checked)
        reference = _one_by_one(program)
        note = f"2 blend spaces, 1 layer, state machine, {skeleton.joint_count} joints with scale"
        suite.case(name, unit, count, call, reference, "reference evaluator:", 1, note)
    _human(suite)


def _body() -> tuple[Skeleton, dict[str, Motion]]:
    rng = np.random.default_rng(1)
    parents, offsets = data.body()
    joints = len(parents)
    rest = Pose(offsets, np.tile([1.0, 0, 0, 0], (joints, 1)), np.ones((joints, 3)))
    skeleton = Skeleton(tuple(f"joint{j}" for j in range(joints)), parents, rest)
    clips: dict[str, Motion] = {}
    for name, speed, (rotations, translations) in zip("abc", _SPEEDS, data.clips(offsets, rng), strict=True):
        frames = len(rotations)
        phase = 2 * np.pi * np.arange(frames) / (frames - 1)
        scales = np.ones((frames, joints, 3))
        scales[:, 1:8] += (0.05 * np.sin(phase))[:, None, None]
        moved = np.array(translations, np.float64)
        moved[:, 0, 2] += speed * np.arange(frames) / 30.0
        clips[name] = Motion(skeleton.names, Pose(moved, np.array(rotations, np.float64), scales), 30.0, name)
    return skeleton, clips


def _full_graph() -> g.Graph:
    condition = g.Condition("aiming")
    nodes: dict[str, Any] = {name: g.ClipNode(name) for name in "abc"}
    nodes |= {f"{name}{side}": g.ClipNode(name) for name, side in (("a", "N"), ("b", "E"), ("c", "S"), ("a", "W"))}
    places = {"aN": (0.0, 1.0), "bE": (1.0, 0.0), "cS": (0.0, -1.0), "aW": (-1.0, 0.0)}
    nodes |= {
        "forward": g.Blend1D("speed", tuple(g.Sample1D(n, s) for n, s in zip("abc", _SPEEDS, strict=True)), "phase"),
        "aside": g.Blend2D("x", "y", tuple(g.Sample2D(n, at) for n, at in places.items()), sync="phase"),
        "body": g.StateMachine(
            {"forward": "forward", "aside": "aside"},
            (
                g.Transition("forward", "aside", (condition,), None, "inertial", 0.25, "both"),
                g.Transition("aside", "forward", (replace(condition, test="not set"),), None, "inertial", 0.25, "both"),
            ),
        ),
        "wave": g.ClipNode("c"),
        "layered": g.Layer("body", "wave", "amount", "upper"),
    }
    parameters = {
        "speed": g.Parameter("float", 2.0, half_life_s=0.1),
        "x": g.Parameter("float"),
        "y": g.Parameter("float"),
        "aiming": g.Parameter("bool"),
        "amount": g.Parameter("float", 0.7),
    }
    sources = {name: g.ClipSource() for name in "abc"}
    return g.Graph(nodes, "layered", parameters, sources, {"upper": g.Mask({"joint2": 1.0})})


def _values(count: int) -> dict[str, Any]:
    rng = np.random.default_rng(2)
    return {
        "speed": rng.uniform(1.2, 3.6, count),
        "x": rng.uniform(-0.6, 0.6, count),
        "y": rng.uniform(-0.6, 0.6, count),
        "aiming": rng.random(count) < 0.5,
        "amount": rng.uniform(0.3, 1.0, count),
    }


def _lively(program: g.Program, count: int, like: g.GraphCrowd) -> Callable[[], Any]:
    """A crowd, and a step in which some of its characters change state."""
    values = _values(count)
    crowd = g.prepare_crowd(program, count, parameters=values, like=like)
    rng = np.random.default_rng(3)
    turns = [rng.choice(count, max(int(count * _LIVELY), 1), replace=False) for _ in range(_FLIPS)]
    aiming = np.array(values["aiming"])
    done = 0

    def step() -> None:
        nonlocal done
        who = turns[done % _FLIPS]
        done += 1
        aiming[who] = ~aiming[who]
        g.set_parameter(crowd, "aiming", aiming)
        g.animate_crowd(crowd, _STEP_S)

    for _ in range(30):
        step()
    return step


def _one_by_one(program: g.Program) -> Callable[[], Any]:
    state = g.init(program, {name: float(values[0]) for name, values in _values(1).items()})

    def step() -> None:
        nonlocal state
        state, out = g.step(state, dt_s=_STEP_S)
        evaluate.world(program.skeleton, out.pose)

    return step


def _check(suite: Suite, program: g.Program) -> g.GraphCrowd:
    """A crowd that is where the reference evaluator puts it, through many transitions."""
    count = 4
    crowd = g.prepare_crowd(program, count)
    states = [g.init(crowd.program) for _ in range(count)]
    rng = np.random.default_rng(4)
    worst = 0.0
    for _ in range(60):
        chosen: dict[str, Any] = {"aiming": rng.random(count) < 0.1, "speed": rng.uniform(1.2, 3.6, count)}
        for name, values in chosen.items():
            g.set_parameter(crowd, name, values)
        g.animate_crowd(crowd, _STEP_S)
        got = g.crowd_matrices(crowd)[:, :, :3, 3]
        for i in range(count):
            states[i], out = g.step(states[i], {n: float(v[i]) for n, v in chosen.items()}, dt_s=_STEP_S)
            true = evaluate.world(program.skeleton, out.pose)[:, :3, 3]
            worst = max(worst, float(np.linalg.norm(got[i] - true, axis=-1).max()))
    suite.check("crowd of graphs: metres from the reference evaluator", worst, 1e-4)
    suite.known("crowd of graphs off the reference", "mm", 1000 * worst, 0.1, "limit", "largest")
    return crowd


# --- the built-in human ---------------------------------------------------------------------------------------------------


def _human(suite: Suite) -> None:
    """The built-in graph with planted feet: its time in a crowd, its feet and its transitions."""
    from keypose import samples
    from keypose.samples import graphs

    graph = graphs.load("locomotion")
    clips = {n: samples.open_scene(s.source).animation(s.animation) for n, s in graph.clips.items()}
    skeleton = samples.load("human").character.skeleton
    program = g.build(graph, skeleton, clips)
    rng = np.random.default_rng(5)
    count = 1000
    values = {"speed": rng.uniform(0, 3, count), "turn": rng.uniform(-60, 60, count), "wave": rng.random(count) < 0.3}
    crowd = g.prepare_crowd(program, count, parameters=values)
    suite.case(
        "built-in human, feet planted, crowd 1,000", "us/character", count,
        lambda: g.animate_crowd(crowd, _STEP_S), note=f"{skeleton.joint_count} joints, 15 nodes",
    )  # fmt: skip
    sources = {n: graph.clips[n] for n in ("walk", "run")}
    middle = 0.5 * (graphs.WALK_M_S + graphs.RUN_M_S)
    for sync, planted, name, limit in (
        ("none", False, "out of step", None),
        ("markers", False, "in step", None),
        ("markers", True, "in step, planted", 2.0),
    ):
        ends = ((g.Sample1D("walk", graphs.WALK_M_S)), (g.Sample1D("run", graphs.RUN_M_S)))
        nodes: dict[str, Any] = {"walk": g.ClipNode("walk"), "run": g.ClipNode("run")}
        nodes |= {"gaits": g.Blend1D(middle, ends, "none" if sync == "none" else "markers")}
        if planted:
            nodes["feet"] = g.Plant("gaits")
        blend = g.Graph(nodes, "feet" if planted else "gaits", {}, sources, {}, graph.contacts)
        mean, most = _slide(g.build(blend, skeleton, clips, dtype=np.float64))
        suite.known(f"foot slide, walk-run, {name}", "cm/s", most, limit, "limit" if limit else "", f"mean {mean:.2f}")
    jump = _velocity_jump(g.build(graph, skeleton, clips, dtype=np.float64))
    suite.known("velocity jump, inertialised transition", "cm/s", 100 * jump, 1.0, "limit", "any joint")


def _slide(program: g.Program) -> tuple[float, float]:
    """Mean and largest speed of contacts in cm/s while all clips that are blended touch the ground."""
    rate = 60.0
    run = g.run_program(program, [], frame_count=181, rate_hz=rate)
    _, places = evaluate.world_rotations_positions(program.skeleton, run.motion.pose)
    index = [program.skeleton.index(c.joint) for c in program.graph.contacts.values()]
    speed = 100 * rate * np.linalg.norm(np.diff(places[:, index][:, :, [0, 2]], axis=0), axis=-1)
    touching = (run.contacts[1:] > 0.999) & (run.contacts[:-1] > 0.999)
    return float(speed[touching].mean()), float(speed[touching].max())


def _velocity_jump(program: g.Program) -> float:
    """Largest change of a joint's velocity in m/s at the switch from walking to jumping."""
    short = 1e-5
    state = g.init(program, {"speed": 1.2})
    for _ in range(40):
        state, _ = g.step(state, {"speed": 1.2}, dt_s=_STEP_S)
    places: list[Any] = []
    for n in range(6):
        state, out = g.step(state, {"jump": True} if n == 3 else None, dt_s=short)
        places.append(evaluate.world_rotations_positions(program.skeleton, out.pose)[1])
    velocities = np.diff(np.array(places, np.float64), axis=0) / short
    return float(np.linalg.norm(np.diff(velocities, axis=0)[1:4], axis=-1).max())
