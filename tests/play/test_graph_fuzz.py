"""Random graphs with random inputs and steps from 0 to 30 s; `graph_fuzz.py` runs longer as a script."""

from __future__ import annotations

import gc
import tracemalloc

import numpy as np
from graph_fixtures import clips, skeleton
from graph_fuzz import fuzz, fuzz_crowds, random_graph, random_inputs

from keypose.play import graph as g


def test_random_graphs_lose_no_event() -> None:
    totals = fuzz(np.random.default_rng(11), graphs=40, steps=250, poses=False)
    assert totals["checked"] > 1000 and totals["events"] > 10_000 and totals["changes"] > 500


def test_random_graphs_give_poses() -> None:
    totals = fuzz(np.random.default_rng(12), graphs=30, steps=60, poses=True)
    assert totals["changes"] > 50


def test_crowds_of_random_graphs_lose_no_event() -> None:
    totals = fuzz_crowds(np.random.default_rng(15), graphs=8, characters=300, steps=60)
    assert totals["checked"] > 1000 and totals["events"] > 10_000 and totals["changes"] > 500


def test_random_graphs_go_through_json() -> None:
    rng = np.random.default_rng(13)
    for _ in range(30):
        graph = random_graph(rng, 15)
        assert g.from_json(g.to_json(graph)) == graph


def test_memory_does_not_grow() -> None:
    rng = np.random.default_rng(14)
    program = g.build(random_graph(rng, 20), skeleton(), clips())
    state = g.init(program)

    def run(steps: int) -> int:
        nonlocal state
        for _ in range(steps):
            state, _ = g.step(state, random_inputs(rng), dt_s=0.05)
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    run(120)  # whatever is kept once is kept by now
    first = run(60)
    later = run(180)
    tracemalloc.stop()
    assert later - first < 100_000
