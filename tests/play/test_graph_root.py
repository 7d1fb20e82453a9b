"""Root motion: what is taken out of a clip is put back by playing it, at any step, speed and loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from graph_fixtures import OFFSETS, build, clip, clips, single, skeleton, sources
from hypothesis import given
from hypothesis import strategies as st

from keypose import evaluate
from keypose.math import quat
from keypose.model import Motion, Pose
from keypose.play import graph as g
from keypose.play.graph.rootmotion import arc, between, compose, repeated, scaled

GROUND = st.tuples(*[st.floats(-3, 3)] * 3)


def matrix(p: tuple[float, float, float]) -> np.ndarray:
    q = quat.from_axis_angle([0, 1, 0], p[2])
    m = np.eye(4)
    m[:3, :3] = quat.to_matrix(q)
    m[:3, 3] = p[0], 0, p[1]
    return m


@given(GROUND, GROUND)
def test_steps_are_rigid_transforms(a, b) -> None:
    np.testing.assert_allclose(matrix(compose(a, b)), matrix(a) @ matrix(b), atol=1e-12)
    np.testing.assert_allclose(matrix(compose(a, between(a, b))), matrix(b), atol=1e-12)


@given(GROUND, st.integers(-7, 7))
def test_repeated_steps(a, count: int) -> None:
    np.testing.assert_allclose(matrix(repeated(a, count)), np.linalg.matrix_power(matrix(a), count), atol=1e-9)


@given(GROUND, st.integers(1, 9))
def test_parts_of_an_arc_make_the_whole(a, parts: int) -> None:
    np.testing.assert_allclose(matrix(repeated(scaled(a, 1 / parts), parts)), matrix(a), atol=1e-6)
    np.testing.assert_allclose(matrix(arc(a, 2.0)), matrix(repeated(arc(a, 0.5), 4)), atol=1e-9)


def world(program: g.Program, pose: Pose) -> np.ndarray:
    return evaluate.world(program.skeleton, pose)


@pytest.mark.parametrize("method", ["full", "linear", "none"])
@pytest.mark.parametrize("name", ["a", "b"])
def test_a_clip_played_once_is_where_the_motion_is(method, name: str) -> None:
    """Up to where the character stands at the start: the same rigid transform at all times."""
    graph = replace(single(g.ClipNode(name, loops=1)), clips=sources(method))
    program, motion = build(graph), clips()[name]
    state = g.init(program)
    state, out = g.step(state, dt_s=0.0)
    start = world(program, out.pose)[0] @ np.linalg.inv(world(program, motion.pose[0])[0])
    for frame in range(1, motion.frame_count):
        state, out = g.step(state, dt_s=1 / motion.rate_hz)
        expected = start @ world(program, motion.pose[frame])
        np.testing.assert_allclose(world(program, out.pose), expected, atol=2e-6)


@pytest.mark.parametrize("method", ["full", "linear"])
@pytest.mark.parametrize("speed", [1.0, -1.0, 2.3])
def test_steps_and_loops_do_not_matter(method, speed: float) -> None:
    """Seven loops and a bit, in one step, in many, and around a circle."""
    program = build(replace(single(g.ClipNode("b", speed)), clips=sources(method)))
    whole, out = g.step(g.init(program), dt_s=5.2)
    state = g.init(program)
    for _ in range(520):
        state, _ = g.step(state, dt_s=0.01)
    np.testing.assert_allclose(state.root, whole.root, atol=1e-9)
    cycles = speed * 5.2 / 0.7
    turn = out.root[2]
    assert turn == pytest.approx(0.4 * cycles, abs=0.9 if method == "full" else 1e-9)


def test_there_and_back_again() -> None:
    program = build(replace(single(g.ClipNode("b", "u"), parameters={"u": g.Parameter()}), clips=sources("full")))
    state = g.init(program, {"u": 1.0})
    for speed, dt_s in ((1.0, 3.0), (2.0, 0.35), (-1.0, 1.7), (-0.5, 4.0)):
        state, _ = g.step(state, {"u": speed}, dt_s=dt_s)
    np.testing.assert_allclose(state.root, (0, 0, 0), atol=1e-9)


def test_in_place_or_applied() -> None:
    graph = replace(single(g.ClipNode("a")), clips=sources("linear"))
    here, there = build(replace(graph, apply_root=False)), build(graph)
    a, b = (g.step(g.init(p, root=(1.0, 2.0, 0.5)), dt_s=2.5)[1] for p in (here, there))
    assert a.root == b.root
    np.testing.assert_allclose(world(there, b.pose), matrix(a.root) @ world(here, a.pose), atol=1e-9)
    assert abs(a.pose.translations[0, 2]) < 0.05
    np.testing.assert_allclose(b.root, compose((1.0, 2.0, 0.5), (0.0, 3.0, 0.0)), atol=1e-9)


def test_blended_travel_is_the_mean() -> None:
    nodes = {"a": g.ClipNode("a"), "c": g.ClipNode("c"), "top": g.Blend((g.Input("a", 0.75), g.Input("c", 0.25)))}
    program = build(g.Graph(nodes, "top", clips=sources("linear")))
    _, out = g.step(g.init(program), dt_s=4.0)
    np.testing.assert_allclose(out.root, (0.0, 0.75 * 1.2 * 4.0, 0.0), atol=1e-9)


def test_layers_and_what_is_added_do_not_travel() -> None:
    for top in (g.Layer("c", "a"), g.Additive("c", "a")):
        program = build(g.Graph({"a": g.ClipNode("a"), "c": g.ClipNode("c"), "top": top}, "top", clips=sources()))
        _, out = g.step(g.init(program), dt_s=2.3)
        np.testing.assert_allclose(out.root, (0, 0, 0), atol=1e-9)


def test_steering_walks_a_circle() -> None:
    """1.2 m/s at 45 degrees per second: a circle of 9.6 m, closed after 8 s."""
    nodes = {"a": g.ClipNode("a"), "top": g.Steer("a", 45.0)}
    program = build(g.Graph(nodes, "top", clips=sources("linear")))
    state, places = g.init(program), []
    for _ in range(800):
        state, out = g.step(state, dt_s=0.01)
        places.append(out.root[:2])
    assert np.linalg.norm(places[-1]) < 1e-6
    middle = np.mean(places, axis=0)
    assert np.allclose(np.linalg.norm(places - middle, axis=1), 1.2 / np.radians(45), rtol=1e-3)
    assert middle[0] > 1  # a positive turn goes to the left, +X


def test_a_clip_that_faces_elsewhere_is_turned_to_the_front() -> None:
    motion = clips()["a"]
    turn = quat.from_axis_angle([0, 1, 0], 2.0)
    pose = motion.pose
    rotations, translations = np.array(pose.rotations), np.array(pose.translations)
    rotations[:, 0] = quat.multiply(turn, rotations[:, 0])
    translations[:, 0] = quat.rotate(turn, translations[:, 0]) + np.array([3.0, 0.0, -4.0])
    moved = motion.with_pose(Pose(translations, rotations, pose.scales))
    graph = replace(single(g.ClipNode("a")), clips=sources("linear"))
    outs = []
    for m in (motion, moved):
        program = g.build(graph, skeleton(), {**clips(), "a": m})
        outs.append(g.step(g.init(program), dt_s=1.7)[1])
    np.testing.assert_allclose(outs[0].root, outs[1].root, atol=1e-9)
    np.testing.assert_allclose(world(program, outs[0].pose), world(program, outs[1].pose), atol=1e-9)


def test_travel_may_come_from_another_joint() -> None:
    """A skeleton with a root joint above the hips: the hips' travel is taken out, whatever the root does."""
    from keypose.model import Skeleton

    inner = skeleton()
    names = ("root", *inner.names)
    parents = [-1, *(int(p) + 1 for p in inner.parents)]
    rest = Pose(np.vstack([[0, 0, 0], OFFSETS]), quat.identity((7,)), np.ones((7, 3)))
    body, motion = Skeleton(names, parents, rest), clip("a", travel=(0.5, 1.0, 0.0))
    count = motion.frame_count

    def grown(a, row):
        return np.concatenate([np.tile(row, (count, 1, 1)), a], axis=1)

    pose = Pose(
        grown(motion.pose.translations, [0, 0, 0]),
        grown(motion.pose.rotations, [1, 0, 0, 0]),
        grown(motion.pose.scales, [1, 1, 1]),
    )
    under = Motion(names, pose, motion.rate_hz)
    for root, travel in (("hips", (0.5, 1.0)), ("root", (0.0, 0.0))):
        graph = g.Graph({"a": g.ClipNode("a")}, "a", clips={"a": g.ClipSource()}, root=root)
        _, out = g.step(g.init(g.build(graph, body, {"a": under})), dt_s=1.0)
        np.testing.assert_allclose(out.root[:2], travel, atol=1e-9)


def test_close_loop_meets_its_beginning() -> None:
    motion = clips()["b"]
    cut = replace(sources("linear")["b"], start_s=0.0, end_s=0.55, close_loop=True)
    graph = replace(single(g.ClipNode("b")), clips={**sources("linear"), "b": cut})
    asset = next(a for a in build(graph).assets if a.name == "b")
    np.testing.assert_allclose(quat.angle_between(asset.rotations[0], asset.rotations[-1]), 0, atol=1e-7)
    np.testing.assert_allclose(asset.translations[0], asset.translations[-1], atol=1e-12)
    np.testing.assert_allclose(asset.curves[0], asset.curves[-1], atol=1e-12)
    assert asset.duration_s == pytest.approx(0.55) and motion.duration_s == pytest.approx(0.7)
