"""Random graphs, random inputs, random steps: never a crash, never a lost event, never a pose that is not one.

As a script it goes on for as long as it is told to, on the scalar logic alone, with poses, or as crowds:

    python tests/play/graph_fuzz.py --steps 10000000 [--poses | --crowd] [--seed 1]
"""

from __future__ import annotations

import argparse
import math
import resource
import time
from dataclasses import replace
from typing import Any

import numpy as np
from graph_fixtures import clips, skeleton, sources

from keypose.play import graph as g
from keypose.play.graph.control import RtClip
from keypose.play.graph.program import Sample
from keypose.play.graph.stepping import control_step

STEPS_S = (0.0, 1e-9, 1e-4, 1 / 240, 1 / 60, 1 / 60, 1 / 60, 0.1, 0.7, 1.0, 3.3, 30.0)


def random_graph(rng: np.random.Generator, size: int = 12) -> g.Graph:
    """A tree of about ``size`` random nodes over the fixtures' clips."""
    nodes: dict[str, Any] = {}
    parameters = {
        "u": g.Parameter("float", 0.3, -2.0, 2.0, 0.1),
        "v": g.Parameter("float", 0.0),
        "n": g.Parameter("int", 1),
        "flag": g.Parameter("bool"),
        "go": g.Parameter("trigger"),
        "hop": g.Parameter("trigger"),
        "t": g.Parameter("vector", (0.0, 1.0, 1.0)),
    }

    def pick(*items: Any) -> Any:
        return items[int(rng.integers(len(items)))]

    def number() -> float | str:
        return pick("u", "v", float(rng.normal()), 1.0, 0.0)

    def conditions() -> tuple[g.Condition, ...]:
        some = (
            g.Condition("u", pick(">", "<"), float(rng.normal())),
            g.Condition("n", pick("==", "!=", ">="), float(rng.integers(4))),
            g.Condition("flag", pick("set", "not set")),
            g.Condition("go"),
            g.Condition("hop"),
        )
        return tuple(pick(*some) for _ in range(int(rng.integers(1, 3))))

    def transition(states: list[str]) -> g.Transition:
        return g.Transition(
            pick("*", *states),
            pick(*states),
            conditions(),
            pick(None, None, 0.3, 1.0, 2.5),
            pick("crossfade", "frozen", "inertial", "dead"),
            pick(0.0, 0.1, 0.3, 2.0),
            pick("none", "source", "target", "both"),
        )

    def make(budget: int) -> str:
        kind = pick(
            "line", "plane", "mean", "add", "over", "machine", "machine", "warp", "steer", "look", "reach", "plant"
        )
        if budget <= 1:
            kind = pick("clip", "clip", "clip", "clip", "rest")
        many = int(rng.integers(1, 4))
        below = (
            [make((budget - 1) // many) for _ in range(many)] if kind in ("line", "plane", "mean", "machine") else []
        )
        sync = pick("none", "none", "phase")
        match kind:
            case "clip":
                warp = pick((), ((0.0, 0.0), (0.3, 0.6), (1.0, 1.0)))
                node: Any = g.ClipNode(
                    pick(*"abc"),
                    pick(1.0, -1.0, "v", 7.0),
                    pick(0, 0, 1, 3),
                    pick(0.0, 0.4, 1.0),
                    warp,
                    pick(True, False),
                )
            case "rest":
                node = g.RestNode()
            case "line":
                node = g.Blend1D(number(), tuple(g.Sample1D(b, float(rng.integers(-2, 3))) for b in below), sync)
            case "plane":
                places = tuple(g.Sample2D(b, (float(rng.integers(-2, 3)), float(rng.integers(-2, 3)))) for b in below)
                node = g.Blend2D(number(), number(), places, pick("delaunay", "gradient_band"), sync)
            case "mean":
                node = g.Blend(tuple(g.Input(b, number()) for b in below), sync)
            case "machine":
                names = [f"s{i}" for i in range(many)]
                ways = tuple(transition(names) for _ in range(int(rng.integers(1, 6))))
                node = g.StateMachine(dict(zip(names, below, strict=True)), ways, pick(*names))
            case "add":
                half = (budget - 1) // 2
                node = g.Additive(make(half), make(half), number(), pick("", "upper"), pick("rest", "c"), 0.5)
            case "over":
                half = (budget - 1) // 2
                node = g.Layer(make(half), make(half), number(), pick("", "upper"))
            case "warp":
                node = g.TimeWarp(make(budget - 1), number())
            case "steer":
                node = g.Steer(make(budget - 1), pick("v", 90.0))
            case "look":
                node = g.LookAt(make(budget - 1), "t", {"spine": 0.5, "head": 0.5}, number())
            case "reach":
                node = g.TwoBone(make(budget - 1), "t", "thigh", "shin", "foot", number())
            case _:
                node = g.Plant(make(budget - 1), (), number())
        name = f"{kind}{len(nodes)}"
        nodes[name] = node
        return name

    output = make(size)
    mask = g.Mask({"spine": 1.0}, {"head": 0.5}, {"*": 0.5})
    contacts = {"ground": g.Contact("foot", "thigh")}
    ways = {n: replace(s, root_motion=pick("full", "linear", "none")) for n, s in sources().items()}
    graph = g.Graph(nodes, output, parameters, ways, {"upper": mask}, contacts)
    while True:  # a phase group needs a clip that takes part: where there is none, it is no group
        try:
            g.build(graph, skeleton(), clips())
            return graph
        except g.GraphError as error:
            if error.field != "sync":
                raise
            graph = replace(graph, nodes={**graph.nodes, error.node: replace(graph.nodes[error.node], sync="none")})


def random_inputs(rng: np.random.Generator) -> dict[str, Any]:
    """Some of the parameters."""
    drawn = {
        "u": rng.normal() * 2,
        "v": rng.normal() * 3,
        "n": int(rng.integers(4)),
        "flag": bool(rng.integers(2)),
        "go": True,
        "hop": True,
        "t": rng.normal(size=3) * 2,
    }
    return {name: value for name, value in drawn.items() if rng.random() < 0.15}


def crossings(times_s: list[float], duration_s: float, before: float, after: float) -> int:
    """How many events lie on the way between two places counted in seconds through all loops, ends left out."""
    low, high = min(before, after), max(before, after)
    count = 0
    for t in times_s:
        first, last = math.floor((low - t) / duration_s) + 1, math.ceil((high - t) / duration_s) - 1
        count += max(last - first + 1, 0)
    return count


class Ledger:
    """Counts the events of every clip node against the way that its clip has gone."""

    def __init__(self, program: g.Program) -> None:
        self.program = program
        self.clips = [n for n in program.nodes if isinstance(n, RtClip) and not n.warp]
        self.checked = self.fired = 0

    def place(self, node: RtClip, floats: Any, ints: Any) -> float:
        return ints[node.loop] * node.asset.duration_s + floats[node.time]

    def check(self, before: g.State, moment: Any, seen: set[int]) -> None:
        """Fired events are at least those strictly on the way, and at most those and the ones at its two ends."""
        self.fired += len(moment.events)
        if moment.changes:  # a clip that is entered anew jumps
            return
        names: dict[str, int] = {}
        for event in moment.events:
            names[event.node] = names.get(event.node, 0) + 1
        for node in self.clips:
            d = node.asset.duration_s
            a = self.place(node, before.floats, before.ints)
            b = self.place(node, moment.floats, moment.ints)
            times_s = [e[0] for e in node.asset.events]
            count = names.get(node.name, 0)
            margin = 1e-7 * (1 + abs(a) + abs(b))
            inner = (a + margin, b - margin) if b > a else (a - margin, b + margin)
            least = crossings(times_s, d, *inner) if abs(b - a) > 2 * margin else 0
            wide = (a - margin, b + margin) if b > a else (a + margin, b - margin)
            most = crossings(times_s, d, *wide) if a != b else 0
            assert count <= most, (node.name, a, b, count, most)
            if node.index in seen:  # then it must be all of them
                assert count >= least, (node.name, a, b, count, least)
                self.checked += 1


def fuzz(rng: np.random.Generator, graphs: int, steps: int, poses: bool) -> dict[str, int]:
    """Steps of random graphs; raises AssertionError where something is wrong."""
    totals = {"steps": 0, "events": 0, "checked": 0, "changes": 0}
    for _ in range(graphs):
        program = g.build(random_graph(rng, int(rng.integers(1, 24))), skeleton(), clips())
        state, ledger = g.init(program), Ledger(program)
        sizes = len(state.floats), len(state.ints), len(state.memory)
        for _ in range(steps):
            dt_s = float(rng.choice(STEPS_S))
            values = random_inputs(rng)
            moment, travel, ops = control_step(state, values, dt_s)
            assert all(map(math.isfinite, moment.floats)) and all(map(math.isfinite, travel))
            assert len(ops) <= 8 * len(program.nodes) + 8
            ledger.check(state, moment, {op.node for op in ops if isinstance(op, Sample)})
            totals["changes"] += len(moment.changes)
            if poses:
                state, out = g.step(state, values, dt_s=dt_s)
                assert state.floats == tuple(moment.floats) and out.events == tuple(moment.events)
                assert np.all(np.abs(np.linalg.norm(out.pose.rotations, axis=-1) - 1) < 1e-6)
                assert np.all(np.isfinite(out.pose.translations)) and np.all(np.isfinite(out.pose.scales))
                assert np.all(np.isfinite(out.morph_weights))
            else:
                state = replace(state, floats=tuple(moment.floats), ints=tuple(moment.ints), number=state.number + 1)
            assert (len(state.floats), len(state.ints), len(state.memory)) == sizes
        totals["steps"] += steps
        totals["events"] += ledger.fired
        totals["checked"] += ledger.checked
    return totals


class CrowdLedger:
    """The same accounts for a whole crowd: per clip node and character, events against the way that the clip has gone."""

    def __init__(self, crowd: g.GraphCrowd) -> None:
        self.crowd = crowd
        self.clips = [(i, n) for i, n in enumerate(crowd.tables.nodes) if isinstance(n, RtClip) and not n.warp]
        self.fired = self.checked = self.changes = 0
        self.places = [self._place(n) for _, n in self.clips]

    def _place(self, node: RtClip) -> Any:
        return self.crowd.ints[:, node.loop] * node.asset.duration_s + self.crowd.floats[:, node.time]

    def check(self) -> None:
        """Each node that moved has fired all that lay on its way, or nothing, where nobody saw it."""
        from keypose.kernels import graphtables as k

        crowd, counts = self.crowd, np.zeros((len(self.crowd.tables.nodes), self.crowd.count), int)
        changed = np.zeros(crowd.count, bool)
        for worker in crowd.workers:
            rows = worker.parts["queue"].reshape(-1, k.QUEUE_ROW)[: worker.numbers[k.QUEUED]]
            events = rows[rows[:, 1] == k.EVENT]
            np.add.at(counts, (events[:, 3], events[:, 0]), 1)
            changed[rows[rows[:, 1] != k.EVENT][:, 0]] = True
            self.fired += len(events)
            self.changes += len(rows) - len(events)
        for n, (i, node) in enumerate(self.clips):
            a, b = self.places[n], self._place(node)
            d = node.asset.duration_s
            least, most = np.zeros(crowd.count, int), np.zeros(crowd.count, int)
            for t in (e[0] for e in node.asset.events):
                low, high, margin = np.minimum(a, b), np.maximum(a, b), 1e-7 * (1 + np.abs(a) + np.abs(b))
                inside = np.ceil((high - margin - t) / d) - np.floor((low + margin - t) / d) - 1
                around = np.ceil((high + margin - t) / d) - np.floor((low - margin - t) / d) - 1
                least += np.maximum(inside, 0).astype(int)
                most += np.where(a != b, np.maximum(around, 0), 0).astype(int)
            right = (counts[i] <= most) & ((counts[i] >= least) | (counts[i] == 0))
            wrong = np.flatnonzero(~(right | changed))
            assert len(wrong) == 0, (node.name, wrong[:3], counts[i][wrong[:3]], least[wrong[:3]], most[wrong[:3]])
            self.checked += int(np.sum((counts[i] > 0) & ~changed))
            self.places[n] = b


def fuzz_crowds(rng: np.random.Generator, graphs: int, characters: int, steps: int) -> dict[str, int]:
    """Steps of crowds of random graphs; raises AssertionError where something is wrong."""
    totals = {"steps": 0, "events": 0, "checked": 0, "changes": 0}
    for _ in range(graphs):
        program = g.build(random_graph(rng, int(rng.integers(1, 24))), skeleton(), clips())
        crowd = g.prepare_crowd(program, characters)
        ledger = CrowdLedger(crowd)
        for _ in range(steps):
            for name, value in random_inputs(rng).items():
                some = np.flatnonzero(rng.random(characters) < 0.3)
                spread = value if isinstance(value, (bool, int)) else value * rng.random((len(some), *np.shape(value)))
                g.set_parameter(crowd, name, spread, some)
            g.animate_crowd(crowd, float(rng.choice(STEPS_S[1:])))
            ledger.check()
            assert np.all(np.isfinite(crowd.floats)) and np.all(np.isfinite(crowd.roots))
            assert np.all(np.isfinite(crowd.models)) and np.all(np.isfinite(crowd.morph_weights))
        totals["steps"] += steps * characters
        totals["events"] += ledger.fired
        totals["checked"] += ledger.checked
        totals["changes"] += ledger.changes
    return totals


def main() -> None:
    """Fuzz for a number of steps and print what was seen."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--poses", action="store_true")
    parser.add_argument("--crowd", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng, done, began = np.random.default_rng(options.seed), 0, time.perf_counter()
    totals: dict[str, int] = {}
    while done < options.steps:
        few = min(1000, options.steps - done)
        some = fuzz_crowds(rng, 5, few, 200) if options.crowd else fuzz(rng, 10, few, options.poses)
        done += some["steps"]
        totals = {key: totals.get(key, 0) + value for key, value in some.items()}
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"{totals} in {time.perf_counter() - began:.0f} s, at most {memory:.0f} MiB", flush=True)


if __name__ == "__main__":
    main()
