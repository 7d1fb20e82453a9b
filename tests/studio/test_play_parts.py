"""The parts of playing that need no socket: what a step is told as, recordings, requests, and graphs by name."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from play_graphs import arm_graph, opened_arm

from keypose import samples
from keypose.errors import FormatError
from keypose.evaluate import world_rotations_positions
from keypose.play import graph as g
from keypose.samples import graphs
from keypose.studio import describe, messages
from keypose.studio.graphs import is_graph_name, open_graph
from keypose.studio.pacing import SOONEST_S, Cadence
from keypose.studio.player import Player, bake
from keypose.studio.requests import parse_request


def walk(graph: g.Graph, program: g.Program, steps: int) -> list[tuple[g.Trace, g.Output]]:
    """Random inputs, seeded."""
    random = np.random.default_rng(7)
    state = g.init(program)
    seen: list[tuple[g.Trace, g.Output]] = []
    for _ in range(steps):
        values: dict[str, float] = {}
        for name, p in graph.parameters.items():
            if p.kind != "vector" and random.random() < 0.06:
                low, high = p.minimum or 0.0, 1.0 if p.maximum is None else p.maximum
                values[name] = float(random.uniform(low, high)) if p.kind == "float" else float(random.integers(0, 2))
        state, output = g.step(state, values, dt_s=1 / 30, trace=True)
        assert output.trace is not None
        seen.append((output.trace, output))
    return seen


@pytest.mark.parametrize("name", ["arm", "locomotion"])
def test_what_a_parent_gets_sums_to_one_and_agrees_with_the_contributions(name: str) -> None:
    if name == "arm":
        program, graph = opened_arm().stage().program, arm_graph()
    else:
        graph = graphs.locomotion()
        program, _ = g.assemble(graph, open_scene=samples.open_scene)
    explain = describe.Explainer(program)
    kinds: set[str] = set()
    for trace, _ in walk(graph, program, 400):
        shares = explain.shares(trace)
        assert np.all((shares >= 0) & (shares <= 1 + 1e-12))
        kinds |= {m.kind for m in trace.machines}
        for n, placed in enumerate(explain.nodes):
            children = [k for k, child in enumerate(explain.nodes) if child.parent == n]
            if isinstance(placed.node, (g.Blend1D, g.Blend2D, g.Blend)):
                assert shares[children].sum() == pytest.approx(1.0)
            if isinstance(placed.node, g.StateMachine):
                m = next(m for m in trace.machines if m.machine == placed.name)
                # a pose in memory is no node: what it gives is missing from the sum
                total = shares[children].sum()
                assert total == pytest.approx(1.0) or (m.kind in ("frozen", "dead", "crossfade") and total <= 1.0)
        # the same question asked of the pose program: what reaches the tip of the tree, by clip
        reach = np.ones(len(shares))
        for n, placed in enumerate(explain.nodes[1:], 1):
            reach[n] = shares[n] * reach[placed.parent]
        if name == "arm":
            by_clip: dict[str, float] = {}
            for n, placed in enumerate(explain.nodes):
                if isinstance(placed.node, g.ClipNode):
                    under_layer = placed.name == "extra"
                    amount = trace.parameters["amount"][0]
                    share = reach[n] if under_layer else reach[n] * (1.0 - amount)
                    by_clip[placed.node.clip] = by_clip.get(placed.node.clip, 0.0) + share
            for clip, share in by_clip.items():
                given = trace.contributions.get(clip, np.zeros(1))[0]
                assert share == pytest.approx(given, abs=1e-9), (clip, trace.machines)
    assert {"", "inertial"} <= kinds


def test_the_tree_is_told_with_slots_places_and_triangles() -> None:
    nodes = {n.name: n for n in describe.nodes(graphs.locomotion())}
    assert nodes["waving"].slot == "layer"
    assert nodes["jump"].slot == "jump"
    assert nodes["walk"].at == [graphs.WALK_M_S]
    assert [(n.field, n.parameter) for n in nodes["move"].numbers] == [("turn_deg_s", "turn")]
    square = [g.Sample2D(n, at) for n, at in (("a", (0, 0)), ("b", (1, 0)), ("c", (0, 1)), ("d", (1, 1)))]
    flat = g.Graph(
        {**{n: g.RestNode() for n in "abcd"}, "field": g.Blend2D("x", "y", tuple(square))},
        "field",
        {"x": g.Parameter(), "y": g.Parameter()},
    )
    triangles = describe.nodes(flat)[0].triangles
    assert len(triangles) == 2
    assert {corner for triangle in triangles for corner in triangle} == {0, 1, 2, 3}
    assert describe.nodes(graphs.locomotion())[0].target == "look_at"


def test_a_recording_is_the_run_that_was_seen() -> None:
    """At an even rate the baked run is what was played, bit for bit, moved to the origin."""
    opened = open_graph("locomotion", "")
    stage = opened.stage()
    player = Player(1, opened, stage)
    player.step({"speed": [1.2], "turn": [30.0]}, 0.0)
    for _ in range(60):
        player.step({}, 1 / 60)
    player.record()
    seen: list[float] = []
    events: list[str] = []
    for n in range(120):
        frame, _ = player.step({"jump": [1.0]} if n == 30 else {}, 1 / 60)
        seen.append(frame.root[2])
        events += [e.name for e in frame.events]
    recording = player.end_recording()
    assert recording is not None
    assert player.end_recording() is None
    run = bake(recording, stage)
    assert run.motion.frame_count == recording.frame_count == 121
    turned = np.unwrap(run.root[1:, 2] + (seen[0] - run.root[1, 2]))
    assert np.allclose(turned, seen, atol=1e-9)
    assert [e.name for _, e in run.events] == events == ["take_off", "land"]
    assert np.allclose(run.root[0], 0)
    hips = world_rotations_positions(stage.character.skeleton, run.motion.pose)[1][0, 0]
    assert np.linalg.norm(hips[[0, 2]]) < 0.1


@pytest.mark.parametrize("hz", [50.0, 55.0, 59.94, 60.0, 60.5])
@pytest.mark.parametrize("offset", [0.0, 0.3, 0.6, 0.9])
def test_steps_fall_in_with_the_pictures_of_the_page(hz: float, offset: float) -> None:
    """Simulated: a step takes 3 ms, each way 1 ms, drawing 2 ms. After two seconds every picture shows one new step."""
    cadence = Cadence(0.0)
    steps: list[float] = []  # when each arrives
    pictures, shown, news = 0, 0, []
    now, free = 0.0, 0.0
    acknowledged: list[float] = []
    while now < 8.0:
        picture = (pictures + offset) / hz
        at = max(cadence.wait_s(now) + now, free)
        if acknowledged and acknowledged[0] <= min(at, picture):
            now = acknowledged.pop(0)
            cadence.drawn(now)
        elif picture <= at:
            now = picture
            pictures += 1
            arrived = sum(step <= now for step in steps)
            news.append(arrived - shown)
            if arrived > shown:
                acknowledged.append(now + 0.003)
            shown = arrived
        else:
            now = at
            cadence.step(now)
            free = now + 0.003
            steps.append(now + 0.004)
    settled = news[int(2 * hz) :]
    assert settled.count(1) >= len(settled) - 1, (settled.count(0), settled.count(2))


def test_alone_steps_come_at_sixty_hertz_and_an_input_hastens_one() -> None:
    cadence = Cadence(0.0)
    now = 0.0
    for _ in range(600):
        now += cadence.wait_s(now)
        cadence.step(now)
    assert now == pytest.approx(10.0, rel=0.03)
    cadence.hurry()
    assert cadence.wait_s(now) == pytest.approx(SOONEST_S)
    assert cadence.step(now + 5.0) == 5.0  # a stall is told as it is, and not caught up
    assert cadence.wait_s(now + 5.0) == pytest.approx(1 / 60, rel=0.03)


def test_reset_forgets_all_but_the_page() -> None:
    opened = opened_arm()
    player = Player(1, opened, opened.stage())
    first, _ = player.step({}, 0.0)
    player.step({"speed": [2.0]}, 0.05)
    player.record()
    player.reset()
    assert player.recording is None
    again, _ = player.step({}, 0.0)
    assert (again.time_s, again.root) == (first.time_s, first.root)
    assert again.number == 3


def test_requests_are_taken_as_their_dataclasses_say() -> None:
    assert parse_request('{"type": "play_pace", "paused": true, "speed": 1}') == messages.PlayPace("play_pace", True, 1)
    got = parse_request('{"type": "play_input", "sequence": 3, "values": {"look_at": [0, 1.5, 3]}}')
    assert got == messages.PlayInput("play_input", 3, {"look_at": [0, 1.5, 3]})
    assert parse_request("null") is None
    assert parse_request('{"type": ["play_close"]}') is None


# ---- what a user names -----------------------------------------------------------------------------------------------


def keypose(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "keypose", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


def test_graphs_are_told_from_scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert is_graph_name("sample:locomotion")
    assert is_graph_name("locomotion")
    assert is_graph_name("game.json")
    assert not is_graph_name("sample:walk")
    assert not is_graph_name("walk.bvh")
    monkeypatch.chdir(tmp_path)
    Path("locomotion").write_text("a file of that name")
    assert not is_graph_name("locomotion")


def test_a_graph_file_finds_its_clips_beside_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from studio_scenes import arm_scene

    from keypose import io

    (tmp_path / "game" / "clips").mkdir(parents=True)
    io.save(arm_scene(), tmp_path / "game" / "clips" / "arm.glb")
    source = g.ClipSource("clips/arm.glb", "sway")
    g.save(
        g.Graph({"a": g.ClipNode("sway")}, "a", clips={"sway": source}, character="clips/arm.glb"),
        tmp_path / "game" / "my.json",
    )
    monkeypatch.chdir(tmp_path)
    assert open_graph("game/my.json", "file:0").stage().program.assets[0].name == "sway"


def test_a_graph_file_that_was_changed_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "my.json"
    g.save(g.Graph({"a": g.RestNode()}, "a", character="sample:human"), path)
    opened = open_graph(str(path), "file:0")
    assert opened.current() is opened
    g.save(g.Graph({"bee": g.RestNode()}, "bee", character="sample:human"), path)
    again = opened.current()
    assert (again.entry, again.definition.output) == (opened.entry, "bee")
    path.write_text("{")
    with pytest.raises(FormatError, match=r"my\.json: line 1"):
        again.current()
    path.unlink()
    with pytest.raises(FormatError, match="No such file"):
        again.current()


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"output": "lok"}, "no node 'lok'; nearest: 'look'"),
        ({"character": ""}, "character: the graph names none"),
        ({"character": "gone.glb"}, "gone.glb: no such file"),
        ({"version": 9}, "version: expected version 1, got 9"),
    ],
)
def test_a_bad_graph_is_one_line_before_anything_is_served(
    tmp_path: Path, change: dict[str, object], what: str
) -> None:
    data = {**json.loads(g.to_json(graphs.locomotion())), **change}
    (tmp_path / "bad.json").write_text(json.dumps(data))
    done = keypose("play", tmp_path / "bad.json", "--no-browser")
    assert done.returncode == 1
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("error: ")
    assert "bad.json" in lines[0] or "gone.glb" in lines[0]
    assert what in lines[0]
    assert done.stdout == ""


def test_a_graph_that_does_not_fit_its_character_names_the_file(tmp_path: Path) -> None:
    graph = g.Graph({"a": g.RestNode()}, "a", contacts={"foot": g.Contact("LeftTo")}, character="sample:human")
    g.save(graph, tmp_path / "odd.json")
    with pytest.raises(FormatError, match=r"odd\.json.*contacts\['foot'\]\.joint: no joint 'LeftTo'"):
        open_graph(str(tmp_path / "odd.json"), "file:0")
