"""Every node against what it stands for: the reference functions of `evaluate`, computed another way."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from graph_fixtures import build, clip, clips, machine, single, skeleton, sources

from keypose import evaluate
from keypose.errors import ShapeError, UnknownName
from keypose.math import quat
from keypose.model import Pose
from keypose.play import graph as g
from keypose.play.graph.transitions import extrapolated, quintic

PLAIN = sources("none")


def at(program: g.Program, time_s: float, parameters: dict | None = None, dt_s: float | None = None) -> g.Output:
    """The output at a time, in one step or many."""
    state = g.init(program, parameters)
    state, out = g.step(state, dt_s=0.0)
    steps = 1 if dt_s is None else round(time_s / dt_s)
    for _ in range(steps if time_s else 0):
        state, out = g.step(state, dt_s=time_s / steps)
    return out


def same(a: Pose, b: Pose, tolerance: float = 1e-9) -> None:
    np.testing.assert_allclose(a.translations, b.translations, atol=tolerance)
    np.testing.assert_allclose(a.scales, b.scales, atol=tolerance)
    assert np.max(quat.angle_between(a.rotations, b.rotations)) < max(10 * tolerance, 2e-8)


def plain(node, **more) -> g.Program:
    return build(replace(single(node, **more), clips=PLAIN))


@pytest.mark.parametrize("time_s", [0.0, 0.013, 0.5, 0.99])
@pytest.mark.parametrize("dt_s", [None, 0.001])
def test_a_clip_plays_as_it_samples(time_s: float, dt_s: float | None) -> None:
    out = at(plain(g.ClipNode("a")), time_s, dt_s=dt_s)
    same(out.pose, evaluate.sample_motion(clips()["a"], time_s))
    expected = evaluate.sample_morphs(clips()["a"], ("smile", "blink"), time_s)
    np.testing.assert_allclose(out.morph_weights, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("node", "time_s", "place"),
    [
        (g.ClipNode("a", 2.0), 0.3, 0.6),
        (g.ClipNode("a", 1.0, start=0.25), 0.3, 0.55),
        (g.ClipNode("a", -1.0), 0.3, 0.7),
        (g.ClipNode("a", -1.0), 1.3, 0.7),
        (g.ClipNode("a", -1.0, start=0.25), 0.3, 0.45),
        (g.ClipNode("a"), 7.25, 0.25),
        (g.ClipNode("a", loops=2), 1.75, 0.75),
        (g.ClipNode("a", loops=2), 2.75, 1.0),
        (g.ClipNode("a", -1.0, loops=2), 1.75, 0.25),
        (g.ClipNode("a", -1.0, loops=2), 9.0, 0.0),
        (g.ClipNode("a", 0.0, start=0.5), 9.0, 0.5),
        (g.ClipNode("a", warp=((0.0, 0.0), (0.5, 0.8), (1.0, 1.0))), 0.25, 0.4),
        (g.ClipNode("a", warp=((0.0, 0.0), (0.5, 0.8), (1.0, 1.0))), 1.75, 0.9),
    ],
)
@pytest.mark.parametrize("dt_s", [None, 0.05])
def test_speed_loops_reverse_start_and_warp(node: g.ClipNode, time_s: float, place: float, dt_s: float | None) -> None:
    same(at(plain(node), time_s, dt_s=dt_s).pose, evaluate.sample_motion(clips()["a"], place), 1e-8)


def test_blends_are_weighted_means() -> None:
    poses = [evaluate.sample_motion(m, 0.4) for m in clips().values()]
    nodes = {n: g.ClipNode(n) for n in "abc"}
    blend = g.Blend(tuple(g.Input(n, w) for n, w in zip("abc", (0.5, 0.2, 0.1), strict=True)))
    out = at(build(g.Graph({**nodes, "top": blend}, "top", clips=PLAIN)), 0.4)
    same(out.pose, evaluate.blend(poses, [0.5, 0.2, 0.1]))
    line = g.Blend1D("u", tuple(g.Sample1D(n, float(i)) for i, n in enumerate("abc")))
    program = build(g.Graph({**nodes, "top": line}, "top", {"u": g.Parameter()}, PLAIN))
    same(at(program, 0.4, {"u": 1.25}).pose, evaluate.blend(poses[1:], [0.75, 0.25]))
    same(at(program, 0.4, {"u": -9.0}).pose, poses[0])


def test_blends_take_the_short_side() -> None:
    """A clip whose quaternions all have the other sign is the same clip."""
    flipped = clips()
    b = flipped["b"]
    flipped["b"] = b.with_pose(Pose(b.pose.translations, -b.pose.rotations, b.pose.scales))
    nodes = {"a": g.ClipNode("a"), "b": g.ClipNode("b"), "top": g.Blend((g.Input("a"), g.Input("b")))}
    graph = g.Graph(nodes, "top", clips=PLAIN)
    same(at(build(graph), 0.3).pose, at(g.build(graph, skeleton(), flipped), 0.3).pose)


def test_additive_adds_the_difference_to_its_reference() -> None:
    a, b = (evaluate.sample_motion(clips()[n], 0.4) for n in "ab")
    nodes = {"a": g.ClipNode("a"), "b": g.ClipNode("b")}
    for reference, pose in (("rest", skeleton().rest), ("c", evaluate.sample_motion(clips()["c"], 0.7))):
        for weight in (0.3, 1.0, -0.5):
            top = g.Additive("a", "b", weight, "", reference, 0.7)
            out = at(build(g.Graph({**nodes, "top": top}, "top", clips=PLAIN)), 0.4)
            same(out.pose, evaluate.add(a, evaluate.difference(b, pose), weight))


def test_layers_and_masks() -> None:
    a, b = (evaluate.sample_motion(clips()[n], 0.4) for n in "ab")
    mask = g.Mask({"spine": 1.0}, {"head": 0.5}, {"smile": 1.0})
    top = g.Layer("a", "b", 0.8, "upper")
    nodes = {"a": g.ClipNode("a"), "b": g.ClipNode("b"), "top": top}
    out = at(build(g.Graph(nodes, "top", clips=PLAIN, masks={"upper": mask})), 0.4)
    share = 0.8 * np.array([0, 1, 0.5, 0, 0, 0])
    same(out.pose, evaluate.blend([a, b], [1.0, 1.0], np.stack([1 - share, share])))
    smile = [evaluate.sample_morphs(clips()[n], ("smile", "blink"), 0.4) for n in "ab"]
    np.testing.assert_allclose(out.morph_weights, [0.2 * smile[0][0] + 0.8 * smile[1][0], smile[0][1]])


def test_time_warp_scales_what_is_below() -> None:
    nodes = {"a": g.ClipNode("a"), "top": g.TimeWarp("a", "pace")}
    program = build(g.Graph(nodes, "top", {"pace": g.Parameter()}, PLAIN))
    same(at(program, 0.8, {"pace": 0.5}).pose, evaluate.sample_motion(clips()["a"], 0.4))
    same(at(program, 0.8, {"pace": -3.0}).pose, evaluate.sample_motion(clips()["a"], 0.0))


def test_same_inputs_give_the_same_bits_and_states_can_be_copied() -> None:
    program = build(machine("inertial"))

    def run(state: g.State) -> list[bytes]:
        rng = np.random.default_rng(1)
        out = []
        for _ in range(60):
            state, o = g.step(state, {"go": rng.random() < 0.1, "back": rng.random() < 0.1}, dt_s=rng.random() * 0.1)
            out.append(o.pose.rotations.tobytes() + o.pose.translations.tobytes())
        return out

    first = g.init(program)
    middle, _ = g.step(first, {"go": True}, dt_s=0.1)
    assert run(first) == run(first) == run(g.init(build(machine("inertial"))))
    copy = replace(middle)
    assert run(middle) == run(copy)
    numbers = pickle.loads(pickle.dumps((middle.floats, middle.ints, middle.memory, middle.number, middle.root)))
    restored = g.State(program, *numbers[:4], middle.time_s, numbers[4])
    assert run(middle) == run(restored)


# --- transitions -----------------------------------------------------------------------------------------------------


def test_quintic_meets_its_conditions() -> None:
    rng = np.random.default_rng(0)
    x0, v0 = rng.normal(size=500), rng.normal(size=500) * rng.choice([0, 0.1, 10, 100], 500)
    h = 1e-7
    assert np.allclose(quintic(x0, v0, 0.0, 0.4), x0)
    speed = (quintic(x0, v0, h, 0.4) - x0) / h
    assert np.allclose(speed, v0, atol=1e-3 * (1 + np.abs(v0)))
    assert np.all(quintic(x0, v0, 0.4, 0.4) == 0) and np.all(quintic(x0, v0, 9.0, 0.4) == 0)
    near = quintic(x0, v0, 0.4 - 1e-3, 0.4)
    assert np.all(np.abs(near) < 1e-5 * (np.abs(x0) + np.abs(v0)))
    assert np.all(quintic(0.0, 0.0, np.linspace(0, 1, 5)[2], 0.4) == 0)


def test_quintic_without_speed_never_overshoots() -> None:
    values = np.array([quintic(1.0, 0.0, t, 0.4) for t in np.linspace(0, 0.4, 401)])
    assert np.all(np.diff(values) <= 1e-12) and values.min() >= 0


def test_extrapolation_is_the_integral_of_the_decaying_speed() -> None:
    times = np.linspace(0, 0.7, 70001)
    speed = 3.0 * 2.0 ** (-times / 0.1)
    assert extrapolated(np.array(3.0), np.array(0.1), 0.7) == pytest.approx(np.trapezoid(speed, times), rel=1e-7)


def world(program: g.Program, out: g.Output) -> np.ndarray:
    return evaluate.world_rotations_positions(program.skeleton, out.pose)[1]


def velocity_jumps(program: g.Program, signal: dict, start_s: float, h: float = 1e-5) -> np.ndarray:
    """Largest change of any joint's velocity in m/s from step to step of h; the third is at the switch."""
    state = g.init(program)
    state, _ = g.step(state, dt_s=start_s)
    places = []
    for n in range(6):
        state, out = g.step(state, signal if n == 3 else None, dt_s=h)
        assert bool(out.changes) == (n == 3)
        places.append(world(program, out))
    velocity = np.diff(np.array(places), axis=0) / h
    return np.linalg.norm(np.diff(velocity, axis=0), axis=-1).max(axis=1)


@pytest.mark.parametrize("kind", ["inertial", "dead"])
@pytest.mark.parametrize("start_s", [0.111, 0.45, 3.337])
def test_no_velocity_jump_at_the_switch(kind: str, start_s: float) -> None:
    """Below 1 cm/s at any joint, with the travel of the root; a frozen transition jumps by far more."""
    assert velocity_jumps(build(machine(kind)), {"go": True}, start_s)[1:4].max() < 0.01
    assert velocity_jumps(build(machine("frozen")), {"go": True}, start_s)[1:4].max() > 0.1


@pytest.mark.parametrize("kind", ["inertial", "dead"])
def test_no_velocity_jump_when_interrupted(kind: str) -> None:
    program = build(machine(kind, interrupt="both"))
    state = g.init(program)
    state, _ = g.step(state, dt_s=0.31)
    state, _ = g.step(state, {"go": True}, dt_s=0.1)
    places = []
    for n in range(6):
        state, out = g.step(state, {"back": True} if n == 3 else None, dt_s=1e-5)
        places.append(world(program, out))
        assert [c.interrupted for c in out.changes] == ([True] if n == 3 else [])
    velocity = np.diff(np.array(places), axis=0) / 1e-5
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=-1).max() < 0.01


@pytest.mark.parametrize("kind", ["crossfade", "frozen", "inertial", "dead"])
def test_transitions_end_in_the_target_alone(kind: str) -> None:
    program = build(replace(machine(kind), clips=PLAIN))
    state = g.init(program)
    state, _ = g.step(state, dt_s=0.3)
    state, out = g.step(state, {"go": True}, dt_s=0.1)
    assert [c.kind for c in out.changes] == [kind]
    for _ in range(5):
        state, out = g.step(state, dt_s=0.1)
    same(out.pose, evaluate.sample_motion(clips()["b"], 0.6))


def test_crossfade_is_a_blend_of_both_clips() -> None:
    program = build(replace(machine("crossfade", 0.4), clips=PLAIN))
    state = g.init(program)
    state, _ = g.step(state, dt_s=0.3)
    state, _ = g.step(state, {"go": True}, dt_s=0.1)
    state, out = g.step(state, dt_s=0.0)
    u = 0.25 * 0.25 * (3 - 0.5)
    pair = [evaluate.sample_motion(clips()[n], t) for n, t in (("a", 0.4), ("b", 0.1))]
    same(out.pose, evaluate.blend(pair, [1 - u, u]))


def test_an_interrupted_crossfade_goes_on_from_what_was_seen() -> None:
    program = build(machine("crossfade", 0.4, interrupt="both"))
    state = g.init(program)
    state, _ = g.step(state, dt_s=0.3)
    state, before = g.step(state, {"go": True}, dt_s=0.15)
    state, after = g.step(state, {"back": True}, dt_s=1e-6)
    assert np.abs(world(program, after) - world(program, before)).max() < 1e-4


def test_triggers_are_used_once() -> None:
    nodes = {n: g.ClipNode(n) for n in "abc"}
    ring = tuple(
        g.Transition(x, y, (g.Condition("go"),), None, "crossfade", 0.0)
        for x, y in (("a", "b"), ("b", "c"), ("c", "a"))
    )
    top = g.StateMachine({n: n for n in "abc"}, ring)
    program = build(g.Graph({**nodes, "top": top}, "top", {"go": g.Parameter("trigger")}, sources()))
    state, out = g.step(g.init(program), {"go": True}, dt_s=0.1)
    assert [(c.source, c.target) for c in out.changes] == [("a", "b")]
    state, out = g.step(state, dt_s=0.1)
    assert out.changes == ()
    state, _ = g.step(state, {"go": True}, dt_s=0.0)  # no time passes: it waits
    state, out = g.step(state, dt_s=0.1)
    assert [(c.source, c.target) for c in out.changes] == [("b", "c")]


@pytest.mark.parametrize("dt_s", [0.01, 0.24, 5.0])
def test_exit_times_are_never_missed(dt_s: float) -> None:
    nodes = {"a": g.ClipNode("a"), "b": g.ClipNode("b")}
    go = g.Transition("a", "b", (), 2.5, "crossfade", 0.0)
    program = build(g.Graph({**nodes, "top": g.StateMachine({"a": "a", "b": "b"}, (go,))}, "top", clips=sources()))
    state, time_s = g.init(program), 0.0
    while True:
        state, out = g.step(state, dt_s=dt_s)
        if out.changes:
            break
        time_s += dt_s
    assert 2.5 <= time_s + 1e-9 < 2.5 + dt_s + 1e-9


@pytest.mark.parametrize(
    ("test", "value", "passes"),
    [(">", 2, [3]), (">=", 2, [2, 3]), ("<", 2, [1]), ("<=", 2, [1, 2]), ("==", 2, [2]), ("!=", 2, [1, 3])],
)
def test_conditions_on_numbers(test, value: float, passes: list[int]) -> None:
    nodes = {"a": g.ClipNode("a"), "b": g.ClipNode("b")}
    go = g.Transition("a", "b", (g.Condition("n", test, value),))
    machine_ = g.StateMachine({"a": "a", "b": "b"}, (go,))
    program = build(g.Graph({**nodes, "top": machine_}, "top", {"n": g.Parameter("int")}, sources()))
    for n in (1, 2, 3):
        _, out = g.step(g.init(program), {"n": n}, dt_s=0.1)
        assert bool(out.changes) == (n in passes)


def test_interruption_is_only_where_it_is_allowed() -> None:
    for interrupt, allowed in (("none", False), ("source", False), ("target", True), ("both", True)):
        program = build(machine("crossfade", 0.5, interrupt=interrupt))
        state, _ = g.step(g.init(program), {"go": True}, dt_s=0.1)
        state, out = g.step(state, {"back": True}, dt_s=0.1)
        assert bool(out.changes) is allowed
        for _ in range(4):
            state, later = g.step(state, dt_s=0.1)
            allowed = allowed or bool(later.changes)
        assert allowed or interrupt in ("none", "source")


def test_parameters_are_checked_kept_and_smoothed() -> None:
    parameters = {"u": g.Parameter("float", 0.0, 0.0, 1.0, 0.1), "n": g.Parameter("int"), "v": g.Parameter("vector")}
    graph = replace(single(g.ClipNode("a", "u")), parameters=parameters)
    program = build(graph)
    with pytest.raises(UnknownName, match="no parameter 'uu'; nearest: 'u'"):
        g.init(program, {"uu": 1.0})
    for bad in ({"u": math.nan}, {"n": 1.5}, {"v": (1.0, 2.0)}, {"u": (1.0, 2.0)}):
        with pytest.raises(ShapeError, match=f"parameter '{next(iter(bad))}'"):
            g.init(program, bad)
    for dt_s in (-0.1, math.nan, 61.0):
        with pytest.raises(ShapeError, match="dt_s"):
            g.step(g.init(program), dt_s=dt_s)
    state = g.init(program)
    for _ in range(10):
        state, _ = g.step(state, {"u": 5.0}, dt_s=0.01)
    _, out = g.step(state, dt_s=0.0, trace=True)
    assert out.trace is not None
    assert out.trace.parameters["u"][0] == pytest.approx(0.5)  # one half-life of the way to the maximum


# --- solvers -----------------------------------------------------------------------------------------------------------


def test_look_at_faces_its_target() -> None:
    nodes = {"a": g.ClipNode("c"), "top": g.LookAt("a", "t", {"spine": 0.3, "head": 0.7}, limit_deg=180.0)}
    program = build(g.Graph(nodes, "top", {"t": g.Parameter("vector")}, PLAIN))
    rng = np.random.default_rng(5)
    for _ in range(20):
        target = np.array([0, 1.4, 0]) + rng.normal(size=3) * 2
        out = at(program, 0.3, {"t": target})
        turned, places = evaluate.world_rotations_positions(program.skeleton, out.pose)
        facing, wanted = quat.rotate(turned[2], [0, 0, 1.0]), target - places[2]
        assert facing @ wanted / np.linalg.norm(wanted) == pytest.approx(1, abs=1e-6)


def test_look_at_keeps_its_limit() -> None:
    nodes = {"a": g.RestNode(), "top": g.LookAt("a", "t", {"head": 1.0}, limit_deg=30.0)}
    program = build(g.Graph(nodes, "top", {"t": g.Parameter("vector")}, PLAIN))
    out = at(program, 0.0, {"t": (5.0, 1.5, 0.0)})
    assert np.degrees(quat.angle_between(out.pose.rotations[2], quat.identity())) == pytest.approx(30)


@pytest.mark.parametrize("weight", [0.0, 0.5, 1.0])
def test_two_bone_reaches_and_keeps_the_foot(weight: float) -> None:
    nodes = {"a": g.ClipNode("c"), "top": g.TwoBone("a", "t", "thigh", "shin", "foot", weight, 0.0)}
    program = build(g.Graph(nodes, "top", {"t": g.Parameter("vector")}, PLAIN))
    still = evaluate.world_rotations_positions(skeleton(), evaluate.sample_motion(clips()["c"], 0.3))
    target = np.array([0.15, 0.3, 0.2])
    out = at(program, 0.3, {"t": target})
    turned, places = evaluate.world_rotations_positions(program.skeleton, out.pose)
    np.testing.assert_allclose(places[5], (1 - weight) * still[1][5] + weight * target, atol=1e-7)
    assert quat.angle_between(turned[5], still[0][5]) < 1e-6
    np.testing.assert_allclose(np.linalg.norm(places[5] - places[4]), np.linalg.norm(still[1][5] - still[1][4]))


def test_no_clip_of_another_size_is_mixed_up() -> None:
    """A clip of one frame stands still and may be blended with others."""
    pose = clip("c", duration_s=1 / 60)
    one = replace(pose, pose=pose.pose[:1], morph_weights=pose.morph_weights[:1])
    nodes = {"a": g.ClipNode("a"), "c": g.ClipNode("c"), "top": g.Blend((g.Input("a"), g.Input("c")), "phase")}
    program = g.build(g.Graph(nodes, "top", clips=PLAIN), skeleton(), {**clips(), "c": one})
    out = at(program, 7.3)
    expected = [evaluate.sample_motion(clips()["a"], 0.3), one.pose[0]]
    same(out.pose, evaluate.blend(expected, [1.0, 1.0]), 1e-8)
