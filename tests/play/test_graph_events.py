"""Events are fired exactly once, whatever the step, the speed and the number of loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from graph_fixtures import build, clip, clips, single, skeleton, sources
from hypothesis import given, settings
from hypothesis import strategies as st

from keypose.model import Event
from keypose.play import graph as g

TIMES = (0.0, 0.2, 0.2, 0.5, 1.0)


def program(node: g.ClipNode) -> g.Program:
    motion = clip("a", events=tuple(Event(t, f"e{i}") for i, t in enumerate(TIMES)))
    return g.build(single(node, parameters={"u": g.Parameter()}), skeleton(), {**clips(), "a": motion})


def fired(p: g.Program, steps: list[tuple[float, float]]) -> list[str]:
    """Names of the events of steps (time, speed), in order."""
    state, names = g.init(p, {"u": steps[0][1]}), []
    for dt_s, speed in steps:
        state, out = g.step(state, {"u": speed}, dt_s=dt_s)
        names += [e.name for e in out.events]
    return names


def test_one_loop_forwards_and_backwards() -> None:
    assert fired(program(g.ClipNode("a", loops=1)), [(0.1, 0)] * 30) == ["e0", "e1", "e2", "e3", "e4"]
    assert fired(program(g.ClipNode("a", -1.0, loops=1)), [(0.1, 0)] * 30) == ["e4", "e3", "e2", "e1", "e0"]
    assert fired(program(g.ClipNode("a", loops=1)), [(30.0, 0)] * 3) == ["e0", "e1", "e2", "e3", "e4"]


def test_a_step_longer_than_the_clip() -> None:
    names = fired(program(g.ClipNode("a")), [(3.6, 0)])
    assert names == ["e0", "e1", "e2", "e3", *["e4", "e0", "e1", "e2", "e3"] * 3][:19]
    assert len(names) == 19


@settings(deadline=None, max_examples=150)
@given(
    speed=st.sampled_from([1.0, -1.0, 0.37, -2.5, 13.0]),
    loops=st.sampled_from([0, 1, 3]),
    start=st.sampled_from([0.0, 0.25, 0.5, 1.0]),
    cuts=st.lists(st.one_of(st.floats(0, 0.3), st.sampled_from([0.0, 0.2, 0.5, 1.0, 2.7])), min_size=1, max_size=25),
)
def test_steps_do_not_matter(speed: float, loops: int, start: float, cuts: list[float]) -> None:
    """The same way in one step and in many fires the same events, but for rounding exactly at their times."""
    p = program(g.ClipNode("a", "u", loops, start))
    total = sum(cuts)
    past = [start + speed * total - t for t in TIMES]
    if total > 59 or any(abs(way - round(way)) < 1e-6 for way in past):  # ends at an event, on either side of it
        return
    one, many = fired(p, [(total, speed)]), fired(p, [(c, speed) for c in cuts])
    assert sorted(one) == sorted(many)


@settings(deadline=None, max_examples=100)
@given(st.lists(st.tuples(st.floats(0.001, 0.4), st.floats(-4, 4)), min_size=2, max_size=60))
def test_going_back_and_forth_counts_every_crossing(steps: list[tuple[float, float]]) -> None:
    """An oracle that knows only the way: the events whose time is crossed, in either direction."""
    entry = 0.1234567891234  # so that no step ends exactly at an event
    p = program(g.ClipNode("a", "u", start=entry))
    state = g.init(p, {"u": 1.0})
    place, expected, found = entry, 0, 0
    for dt_s, speed in steps:
        before, place = place, place + dt_s * speed
        for t in (0.0, 0.2, 0.2, 0.5):  # 1.0 is 0.0 of the next loop: both are events
            low, high = min(before, place), max(before, place)
            first, last = np.ceil(low - t), np.floor(high - t)
            crossings = int(last - first + 1) if last >= first else 0
            expected += crossings * (2 if t == 0.0 else 1)
        state, out = g.step(state, {"u": speed}, dt_s=dt_s)
        found += len(out.events)
    assert found == expected


def test_events_carry_the_weight_of_their_clip_and_unseen_clips_are_silent() -> None:
    nodes = {"a": g.ClipNode("a"), "b": g.ClipNode("b"), "top": g.Blend((g.Input("a", "u"), g.Input("b", 0.25)))}
    p = build(g.Graph(nodes, "top", {"u": g.Parameter()}, sources()))
    _, out = g.step(g.init(p, {"u": 0.75}), dt_s=0.8)
    assert [(e.name, e.clip, e.node, round(e.weight, 9)) for e in out.events] == [
        ("start", "a", "a", 0.75),
        ("half", "a", "a", 0.75),
        ("end", "b", "b", 0.25),
    ]
    _, out = g.step(g.init(p, {"u": 0.0}), dt_s=0.8)
    assert {e.clip for e in out.events} == {"b"}


def test_events_of_synchronised_clips_are_fired_once_per_cycle() -> None:
    nodes = {"a": g.ClipNode("a"), "b": g.ClipNode("b"), "top": g.Blend((g.Input("a"), g.Input("b")), "phase")}
    p = build(g.Graph(nodes, "top", clips=sources()))
    for dt_s in (0.01, 0.33, 8.5):
        state, names = g.init(p), []
        for _ in range(round(8.5 / dt_s) + (dt_s < 8.5)):
            state, out = g.step(state, dt_s=dt_s)
            names += [e.name for e in out.events]
        # A cycle takes 0.85 s: ten of them.
        assert names.count("half") == 10 and names.count("end") in (9, 10), dt_s


def test_sources_add_events_to_those_of_the_motion() -> None:
    source = replace(sources()["a"], events=(g.ClipEvent("clap", 0.3, "loud"),))
    graph = replace(single(g.ClipNode("a")), clips={**sources(), "a": source})
    _, out = g.step(g.init(build(graph)), dt_s=0.9)
    assert [(e.name, e.data) for e in out.events] == [("start", ""), ("clap", "loud"), ("half", "")]


@pytest.mark.parametrize("dt_s", [0.05, 1.7])
def test_events_below_a_time_warp_and_a_layer(dt_s: float) -> None:
    nodes = {
        "a": g.ClipNode("a"),
        "slow": g.TimeWarp("a", 0.5),
        "c": g.ClipNode("c"),
        "top": g.Layer("c", "slow", 0.5),
    }
    p = build(g.Graph(nodes, "top", clips=sources()))
    state, names = g.init(p), []
    for _ in range(round(3.4 / dt_s)):
        state, out = g.step(state, dt_s=dt_s)
        names += [(e.name, e.weight) for e in out.events if e.clip == "a"]
    assert names == [("start", 0.5), ("half", 0.5), ("start", 0.5), ("half", 0.5)]
