"""Crowds of graphs against the reference evaluator, which steps one character after the other."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest
from graph_fixtures import build, clips, machine, single, skeleton
from graph_fuzz import random_graph, random_inputs

from keypose import samples
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import world
from keypose.play import graph as g
from keypose.samples import graphs

STEPS_S = (1 / 240, 1 / 60, 1 / 60, 1 / 60, 0.1, 0.7, 3.3)


def by_node(entry: Any) -> Any:
    """Within a step, whose turn comes first is not promised across nodes."""
    return entry[0], entry[1].node


class Reference:
    """The characters of a crowd, each stepped by itself."""

    def __init__(self, crowd: g.GraphCrowd, root: Any = (0.0, 0.0, 0.0)) -> None:
        self.crowd = crowd
        self.states = [g.init(crowd.program, root=root) for _ in range(crowd.count)]
        self.outputs: list[g.Output] = []

    def step(self, values: list[dict[str, Any]], dt_s: float) -> None:
        self.outputs = []
        for i, chosen in enumerate(values):
            for name, value in chosen.items():
                g.set_parameter(self.crowd, name, value, [i])
            self.states[i], out = g.step(self.states[i], chosen, dt_s=dt_s)
            self.outputs.append(out)
        g.animate_crowd(self.crowd, dt_s)

    def distances(self) -> Any:
        """How far each joint is from where it should be, (count, J)."""
        true = np.stack([world(self.crowd.program.skeleton, out.pose)[:, :3, 3] for out in self.outputs])
        return np.linalg.norm(g.crowd_matrices(self.crowd)[..., :3, 3] - true, axis=-1)

    def check_numbers(self) -> None:
        """States, travel, events and transitions are those of the reference."""
        floats = np.array([s.floats for s in self.states]).reshape(self.crowd.count, -1)
        ints = np.array([s.ints for s in self.states]).reshape(self.crowd.count, -1)
        np.testing.assert_allclose(self.crowd.floats[:, :-1], floats, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(self.crowd.ints[:, :-1], ints)
        np.testing.assert_allclose(self.crowd.roots, [o.root for o in self.outputs], rtol=0, atol=1e-9)
        np.testing.assert_allclose(self.crowd.root_steps, [o.root_step for o in self.outputs], rtol=0, atol=1e-9)
        fired = [(i, e) for i, o in enumerate(self.outputs) for e in o.events]
        found = g.crowd_events(self.crowd)
        for (who, own), (other, event) in zip(sorted(found, key=by_node), sorted(fired, key=by_node), strict=True):
            assert (who, own._replace(weight=0.0)) == (other, event._replace(weight=0.0))
            assert own.weight == pytest.approx(event.weight, abs=1e-9)
        changes = [(i, c) for i, o in enumerate(self.outputs) for c in o.changes]
        assert sorted(g.crowd_changes(self.crowd), key=str) == sorted(changes, key=str)
        weights = np.array([o.morph_weights for o in self.outputs]).reshape(self.crowd.count, -1)
        np.testing.assert_allclose(self.crowd.morph_weights, weights, atol=2e-4)
        touching = np.array([list(o.contacts.values()) for o in self.outputs]).reshape(self.crowd.count, -1)
        np.testing.assert_allclose(self.crowd.contacts, touching, atol=1e-4)


@pytest.mark.parametrize("seed", range(20))
def test_random_graphs_do_what_the_reference_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    program = g.build(random_graph(rng, int(rng.integers(1, 24))), skeleton(), clips())
    reference = Reference(g.prepare_crowd(program, 3))
    apart: list[Any] = []
    for _ in range(30):
        reference.step([random_inputs(rng) for _ in range(3)], float(rng.choice(STEPS_S)))
        reference.check_numbers()
        apart.append(reference.distances())
    # A limb stretched to its very end magnifies rounding; everything else is within a tenth of a millimetre.
    assert np.quantile(apart, 0.95) < 1e-4
    assert np.max(apart) < 1e-3


@pytest.fixture(scope="module")
def human() -> g.Program:
    graph = graphs.load("locomotion")
    animations = {n: samples.open_scene(s.source).animation(s.animation) for n, s in graph.clips.items()}
    return g.build(graph, samples.load("human").character.skeleton, animations)


@pytest.fixture(scope="module")
def compiled(human: g.Program) -> g.GraphCrowd:
    """A crowd whose compiled clips others take over: making them takes most of the time."""
    return g.prepare_crowd(human, 1)


def test_the_human_walks_jumps_waves_and_looks_as_the_reference_does(human: g.Program, compiled: g.GraphCrowd) -> None:
    rng = np.random.default_rng(5)
    reference = Reference(g.prepare_crowd(human, 3, like=compiled))
    begun: set[str] = set()
    for k in range(150):
        values: list[dict[str, Any]] = [{} for _ in range(3)]
        for chosen in values:
            if rng.random() < 0.05:
                chosen["speed"] = float(rng.uniform(0, 3.2))
            if rng.random() < 0.05:
                chosen["turn"] = float(rng.uniform(-120, 120))
            if rng.random() < 0.02 and k > 20:
                chosen["jump"] = True
            if rng.random() < 0.05:
                chosen["wave"], chosen["look"] = float(rng.integers(2)), float(rng.integers(2))
        reference.step(values, 1 / 60)
        reference.check_numbers()
        begun |= {change.target for _, change in g.crowd_changes(reference.crowd)}
        assert reference.distances().max() < 1e-4
    assert begun >= {"move", "jump", "wave"}


def test_same_inputs_give_the_same_bits_on_any_number_of_threads(human: g.Program, compiled: g.GraphCrowd) -> None:
    rng = np.random.default_rng(1)
    speeds, turns = rng.uniform(0, 3, 70), rng.uniform(-90, 90, 70)
    seen: list[Any] = []
    inputs = {"speed": speeds, "turn": turns}
    for threads, like in ((1, compiled), (1, None), (3, compiled)):  # clips compiled twice are the same bits too
        crowd = g.prepare_crowd(human, 70, threads=threads, parameters=inputs, like=like)
        for k in range(12):
            if k == 5:
                g.set_parameter(crowd, "jump", True, np.arange(0, 70, 3))
            g.animate_crowd(crowd, 1 / 60)
        seen.append((crowd.models.copy(), crowd.floats.copy(), sorted(g.crowd_events(crowd), key=by_node)))
    for other in seen[1:]:
        np.testing.assert_array_equal(other[0], seen[0][0])
        np.testing.assert_array_equal(other[1], seen[0][1])
        assert other[2] == seen[0][2]


def test_a_character_does_not_depend_on_its_neighbours(human: g.Program, compiled: g.GraphCrowd) -> None:
    rng = np.random.default_rng(2)
    speeds = rng.uniform(0, 3, 40)
    places = rng.uniform(-5, 5, (40, 3))
    many = g.prepare_crowd(human, 40, parameters={"speed": speeds}, roots=places, like=compiled)
    alone = g.prepare_crowd(human, 1, parameters={"speed": speeds[37]}, roots=places[37], like=compiled)
    for _ in range(20):
        g.animate_crowd(many, 1 / 60)
        g.animate_crowd(alone, 1 / 60)
    np.testing.assert_array_equal(g.crowd_matrices(many)[37], g.crowd_matrices(alone)[0])
    np.testing.assert_array_equal(many.roots[37], alone.roots[0])


def test_blocks_that_are_due_less_often_take_all_the_time_at_once(human: g.Program, compiled: g.GraphCrowd) -> None:
    speeds = np.linspace(0.5, 3, 48)
    crowd = g.prepare_crowd(human, 48, parameters={"speed": speeds}, like=compiled)
    slow = g.prepare_crowd(human, 48, parameters={"speed": speeds}, like=compiled)
    lanes = crowd.models.shape[-1]
    crowd.every[:] = 4
    counts = np.zeros(len(crowd.every), int)
    for _ in range(16):
        before = crowd.models.copy()
        g.animate_crowd(crowd, 1 / 60)
        counts += np.any(crowd.models != before, axis=(1, 2, 3))
    assert np.all(counts == 4)
    # Blocks take turns; block 0 was due at calls 1, 5, 9 and 13.
    g.animate_crowd(slow, 1 / 60)
    for _ in range(3):
        g.animate_crowd(slow, 4 / 60)
    np.testing.assert_allclose(crowd.roots[:lanes], slow.roots[:lanes], atol=1e-9)
    np.testing.assert_allclose(crowd.models[0], slow.models[0], atol=1e-5)


def test_a_level_of_detail_leaves_joints_out_and_changes_no_other(human: g.Program) -> None:
    fingers = [n for n in human.skeleton.names if n[-1].isdigit() and "Hand" in n]
    speeds = np.linspace(0.5, 3, 32)
    levels = [fingers, [*fingers, "LeftEye", "Jaw"]]
    full = g.prepare_crowd(human, 32, parameters={"speed": speeds}, levels=levels)
    crowd = g.prepare_crowd(human, 32, parameters={"speed": speeds}, levels=levels, like=full)
    crowd.level[:] = 1
    crowd.level[-1] = 2
    for _ in range(5):
        g.animate_crowd(full, 1 / 60)
        g.animate_crowd(crowd, 1 / 60)
    assert set(crowd.level_joints[1]) == set(human.skeleton.names) - set(fingers)
    kept = [human.skeleton.index(n) for n in crowd.level_joints[2]]
    np.testing.assert_array_equal(crowd.models[:, kept], full.models[:, kept])
    assert np.all(crowd.models[:, [human.skeleton.index(n) for n in fingers]] == 0)
    with pytest.raises(UnknownName, match="LeftEar"):
        g.prepare_crowd(human, 1, levels=[["LeftEar"]])
    with pytest.raises(ShapeError, match="leaves out every joint"):
        g.prepare_crowd(human, 1, levels=[["Hips"]])
    crowd.level[0] = 3
    with pytest.raises(ShapeError, match="level: expected 0 to 2, got 3"):
        g.animate_crowd(crowd, 1 / 60)


def test_a_crowd_may_take_over_the_compiled_clips_of_another(human: g.Program) -> None:
    first = g.prepare_crowd(human, 20, parameters={"speed": 1.5})
    second = g.prepare_crowd(human, 20, parameters={"speed": 1.5}, like=first)
    assert second.clips is first.clips
    for crowd in (first, second):
        for _ in range(3):
            g.animate_crowd(crowd, 1 / 60)
    np.testing.assert_array_equal(second.models, first.models)
    for wrong in (build(single(g.ClipNode("a"))), human):
        with pytest.raises(ShapeError, match="same program and levels"):
            g.prepare_crowd(wrong, 1, like=first, levels=[["LeftEye"]] if wrong is human else ())


def test_more_events_than_there_is_room_for_are_all_kept() -> None:
    program = build(single(g.ClipNode("a", speed=5.0)))
    reference = Reference(g.prepare_crowd(program, 60))
    for _ in range(3):
        reference.step([{}] * 60, 3.0)  # 15 loops with two events each
        reference.check_numbers()
        assert len(g.crowd_events(reference.crowd)) == 60 * 30


def test_steps_allocate_nothing_that_stays(human: g.Program, compiled: g.GraphCrowd) -> None:
    crowd = g.prepare_crowd(human, 64, parameters={"speed": 2.0}, like=compiled)

    def run(steps: int) -> int:
        for k in range(steps):
            g.set_parameter(crowd, "jump", k % 50 == 0)
            g.animate_crowd(crowd, 1 / 60)
            g.crowd_events(crowd)
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    run(100)
    first = run(50)
    later = run(150)
    tracemalloc.stop()
    assert later - first < 5000


@pytest.mark.parametrize("kind", ["crossfade", "frozen", "inertial", "dead"])
def test_every_kind_of_transition_and_its_interruption(kind: str) -> None:
    program = build(machine(kind, interrupt="both"))
    reference = Reference(g.prepare_crowd(program, 2))
    for k in range(60):
        values: list[dict[str, Any]] = [{}, {}]
        if k in (10, 40):
            values[0]["go"] = True
        if k in (14, 45):  # half way
            values[0]["back"] = True
        if k == 20:
            values[1]["go"] = True
        reference.step(values, 1 / 60)
        reference.check_numbers()
        assert reference.distances().max() < 2e-5


def test_wrong_input_is_refused() -> None:
    crowd = g.prepare_crowd(build(machine("inertial")), 4)
    for dt_s in (0.0, -1.0, 61.0, float("nan")):
        with pytest.raises(ShapeError, match="dt_s: expected a time above 0"):
            g.animate_crowd(crowd, dt_s)
    with pytest.raises(UnknownName, match="goo"):
        g.set_parameter(crowd, "goo", 1)
    with pytest.raises(ShapeError, match=r"parameter 'go': expected \(4,\) or a number, got \(3,\)"):
        g.set_parameter(crowd, "go", [1, 0, 1])
    with pytest.raises(ShapeError, match="parameter 'go': expected finite numbers"):
        g.set_parameter(crowd, "go", float("inf"))
    with pytest.raises(ShapeError, match="count: expected a positive number, got 0"):
        g.prepare_crowd(crowd.program, 0)
    crowd.every[0] = 0
    with pytest.raises(ShapeError, match="every: expected at least 1"):
        g.animate_crowd(crowd, 1 / 60)
