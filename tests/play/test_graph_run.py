"""The sample graph, its trace, and runs that are baked and written to files."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from graph_fixtures import build, clips, machine, skeleton, sources

from keypose import io, samples
from keypose.analysis import roundtrip_error
from keypose.errors import FormatError, ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.math import quat
from keypose.model import Motion
from keypose.play import graph as g
from keypose.samples import graphs

SESSION = (
    g.Inputs(0.5, {"speed": 1.2}),
    g.Inputs(2.0, {"turn": 60.0}),
    g.Inputs(3.0, {"speed": 3.0, "turn": 0.0}),
    g.Inputs(4.0, {"jump": True}),
    g.Inputs(5.8, {"speed": 0.0}),
    g.Inputs(6.8, {"wave": 1.0}),
    g.Inputs(8.0, {"wave": 0.0, "look": 1.0, "look_at": [2.0, 1.5, 1.0]}),
)


@pytest.fixture(scope="module")
def session() -> g.Run:
    return g.run(graphs.locomotion(), SESSION, duration_s=9.0, open_scene=samples.open_scene, trace=True)


def test_the_sample_graph_does_what_it_is_told(session: g.Run) -> None:
    assert session.motion.frame_count == 541
    ways = [(c.source, c.target) for _, c in session.changes if c.machine == "body"]
    assert ways == [("idle", "move"), ("move", "jump"), ("jump", "move"), ("move", "idle")]
    assert [e.name for _, e in session.events] == ["take_off", "land"]
    speed = np.linalg.norm(np.diff(session.root[:, :2], axis=0), axis=1) * 60
    assert np.allclose(speed[90:120], 1.2, atol=0.03)  # walking
    assert np.allclose(speed[215:235], 3.0, atol=0.15)  # running
    assert np.allclose(speed[440:], 0.0, atol=1e-3)  # standing
    assert np.degrees(session.root[180, 2] - session.root[120, 2]) == pytest.approx(60, abs=12)


def test_no_joint_jumps_between_frames(session: g.Run) -> None:
    """All transitions of the sample graph are smooth: accelerations stay those of a body that runs and jumps."""
    _, positions = world_rotations_positions(samples.load("human").character.skeleton, session.motion.pose)
    change = np.linalg.norm(np.diff(positions.astype(np.float64), 2, axis=0), axis=-1) * 3600
    plain = []
    for name in ("walk", "run", "jump", "wave"):
        scene = samples.load(name)
        _, p = world_rotations_positions(scene.character.skeleton, scene.animation(name).pose)
        plain.append(np.linalg.norm(np.diff(p.astype(np.float64), 2, axis=0), axis=-1).max() * 3600)
    assert change.max() < 1.5 * max(plain)


def test_feet_stay_above_the_floor(session: g.Run) -> None:
    body = samples.load("human").character.skeleton
    _, positions = world_rotations_positions(body, session.motion.pose)
    toes = positions[:, [body.index("LeftToeBase"), body.index("RightToeBase")], 1]
    assert toes.min() > 0.0255


def test_curves_come_through(session: g.Run) -> None:
    human = samples.load("human").character
    assert session.motion.morph_names == human.morph_names
    weights = np.asarray(session.motion.morph_weights)
    assert weights.shape == (541, len(human.morph_names)) and weights.max() > 0.5


def test_trace_adds_up(session: g.Run) -> None:
    for trace in session.traces:
        total = sum(trace.contributions.values())
        np.testing.assert_allclose(total, 1.0, atol=1e-9)
        for weights in trace.weights.values():
            assert sum(weights.values()) == pytest.approx(1)
        assert trace.operations["Sample"] == len(trace.clips)
    names = session.motion.joint_names
    waving = session.traces[475]
    hand, foot = names.index("RightHand"), names.index("LeftFoot")
    assert waving.contributions["wave"][hand] > 0.95 and waving.contributions["wave"][foot] == 0
    assert waving.contributions["idle"][foot] == pytest.approx(1)
    assert [(m.machine, m.state) for m in waving.machines] == [("body", "idle"), ("waving", "wave")] or {
        m.machine: m.state for m in waving.machines
    } == {"body": "idle", "waving": "wave"}
    running = session.traces[225]
    assert running.syncs[0].node == "gaits" and running.weights["gaits"]["run"] > 0.8
    assert running.clips[0].clip == "walk" and 0 < running.clips[0].weight < 0.2
    assert running.control_s > 0 and running.pose_s > 0


def test_trace_of_a_transition() -> None:
    program = build(machine("dead", 0.4))
    state, _ = g.step(g.init(program), dt_s=0.2)
    state, out = g.step(state, {"go": True}, dt_s=0.2, trace=True)
    trace = out.trace
    assert trace is not None
    (one,) = trace.machines
    assert (one.state, one.source, one.kind, one.share) == ("second", "first", "dead", pytest.approx(0.5))
    assert set(trace.contributions) == {"memory", "b"}
    np.testing.assert_allclose(trace.contributions["memory"], 0.5)
    assert [(c.source, c.target) for c in trace.changes] == [("first", "second")]


def test_tracing_changes_nothing() -> None:
    graph = graphs.locomotion()
    runs = [g.run(graph, SESSION, duration_s=2.0, open_scene=samples.open_scene, trace=t) for t in (False, True)]
    assert runs[0].motion.pose.rotations.tobytes() == runs[1].motion.pose.rotations.tobytes()
    assert not runs[0].traces


@pytest.mark.parametrize("suffix", ["glb", "bvh"])
def test_runs_are_written_and_read_back(session: g.Run, tmp_path, suffix: str) -> None:
    path = tmp_path / f"run.{suffix}"
    io.save(session.scene(), path)
    scene = io.load(path)
    error = roundtrip_error(
        session.motion, scene.animation(), session.scene().character.skeleton, scene.character.skeleton
    )
    assert error.position_mm < 0.1 and error.rotation_deg < 0.02 and error.frames_missing == 0


def test_the_same_on_every_run_and_in_every_process() -> None:
    code = (
        "import hashlib\nfrom keypose import samples\nfrom keypose.play import graph as g\nfrom keypose.samples import graphs\n"
        "r = g.run(graphs.locomotion(), [g.Inputs(0.1, {'speed': 2.0, 'turn': 30.0}), g.Inputs(0.9, {'jump': True})],"
        " duration_s=1.5, open_scene=samples.open_scene)\n"
        "p = r.motion.pose\nprint(hashlib.sha256(p.rotations.tobytes() + p.translations.tobytes()).hexdigest())\n"
    )
    seen = {
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    }
    assert len(seen) == 1


def test_in_place_runs_stay_and_tell_their_root() -> None:
    graph = graphs.locomotion()
    moving = g.run(graph, SESSION, duration_s=2.5, open_scene=samples.open_scene)
    still = g.run(g.in_place(graph), SESSION, duration_s=2.5, open_scene=samples.open_scene)
    assert np.array_equal(moving.root, still.root)
    hips = still.motion.pose.translations[:, 0]
    assert np.abs(hips[:, [0, 2]]).max() < 0.1
    turn = quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), moving.root[:, 2])
    placed = quat.rotate(turn, hips.astype(np.float64)) + np.insert(moving.root[:, :2], 1, 0.0, axis=1)
    np.testing.assert_allclose(placed, moving.motion.pose.translations[:, 0], atol=1e-5)


def test_inputs_from_json() -> None:
    text = json.dumps([{"at_s": 2, "set": {"jump": True}}, {"at_s": 0.5, "set": {"speed": 1.2, "look_at": [0, 1, 2]}}])
    inputs = g.inputs_from_json(text)
    assert [i.at_s for i in inputs] == [0.5, 2.0] and inputs[0].values["look_at"] == [0, 1, 2]
    for bad, message in (
        ("{", "no JSON"),
        ("{}", "expected a list"),
        ('[{"at_s": 1}]', r"\[0\]: expected an object"),
        ('[{"at_s": -1, "set": {}}]', r"\[0\].at_s"),
        ('[{"at_s": 1, "set": {"u": "x"}}]', r"\[0\].set.u"),
    ):
        with pytest.raises(FormatError, match=message):
            g.inputs_from_json(bad)


def test_what_a_run_cannot_do_is_said() -> None:
    graph = machine("inertial")
    with pytest.raises(g.GraphError, match="character: the graph names none"):
        g.run(graph, duration_s=1.0)
    with pytest.raises(g.GraphError, match=r"clips\['a'\]\.source"):
        g.run(graph, duration_s=1.0, character=skeleton())
    with pytest.raises(ShapeError, match="1000000 frames"):
        g.run(graph, duration_s=1e9, character=skeleton(), clips=clips())
    with pytest.raises(ShapeError, match="rising order"):
        g.run(graph, [g.Inputs(1.0, {}), g.Inputs(0.5, {})], duration_s=1.0, character=skeleton(), clips=clips())
    run = g.run(graph, duration_s=1.0, character=skeleton(), clips=clips())
    assert isinstance(run.motion, Motion) and run.motion.frame_count == 61
    with pytest.raises(ShapeError, match="not a character"):
        run.scene()


def test_clips_may_be_sparse_curves() -> None:
    """A `Clip` plays as the motion that it bakes to."""
    from keypose.evaluate import to_clip

    graph = replace(machine("inertial"), clips=sources("none"))
    outs = []
    for used in (clips(), {n: to_clip(m) for n, m in clips().items()}):
        program = g.build(graph, skeleton(), used, morph_names=("smile", "blink"))
        outs.append(g.step(g.init(program), dt_s=0.4)[1])
    np.testing.assert_allclose(outs[0].pose.rotations, outs[1].pose.rotations, atol=1e-6)
    np.testing.assert_allclose(outs[0].morph_weights, outs[1].morph_weights, atol=1e-6)


@pytest.mark.parametrize("speed", [0.0, 1.2, 2.2, 3.28])
@pytest.mark.parametrize("start_s", [1.0, 1.37])
def test_no_velocity_jump_when_the_human_jumps(speed: float, start_s: float) -> None:
    """Through blend space, inertialisation, planted feet and layers: below 1 cm/s at any of 61 joints at the switch."""
    human = samples.load("human")
    body, graph = human.character.skeleton, graphs.locomotion()
    program = g.build(graph, body, {n: human.animation(n) for n in graph.clips}, dtype=np.float64)
    state, places, h = g.init(program, {"speed": speed}), [], 1e-5
    for _ in range(round(start_s * 60)):
        state, _ = g.step(state, dt_s=1 / 60)
    for n in range(6):
        state, out = g.step(state, {"jump": True} if n == 3 else None, dt_s=h)
        assert bool(out.changes) == (n == 3)
        places.append(world_rotations_positions(body, out.pose)[1])
    velocity = np.diff(np.array(places), axis=0) / h
    jumps = np.linalg.norm(np.diff(velocity, axis=0), axis=-1).max(axis=1)
    print(
        f"\nfrom {speed:g} m/s at {start_s:g} s: velocity jump at the switch at most {100 * jumps[1:].max():.2f} cm/s"
    )
    assert jumps[1:].max() < 0.01


def test_states_travel_to_other_processes() -> None:
    program = build(machine("inertial"))
    state, _ = g.step(g.init(program), {"go": True}, dt_s=0.1)
    copy = pickle.loads(pickle.dumps(state))
    one, two = (g.step(s, dt_s=0.05)[1] for s in (state, copy))
    assert one.pose.rotations.tobytes() == two.pose.rotations.tobytes()


def test_a_run_goes_on_from_any_state_as_if_it_had_never_stopped() -> None:
    program, whom = g.assemble(graphs.locomotion(), open_scene=samples.open_scene)
    assert whom is samples.load("human").character
    inputs = (g.Inputs(0.1, {"speed": 3.0}), g.Inputs(0.5, {"jump": True}))
    whole = g.run_program(program, inputs, frame_count=61, rate_hz=60.0)
    state, _ = g.step(g.init(program), dt_s=0.0)
    for frame in range(1, 21):
        state, _ = g.step(state, inputs[0].values if frame == 6 else {}, dt_s=1 / 60)
    rest = g.run_program(program, (g.Inputs(10 / 60, {"jump": True}),), frame_count=41, start=state)
    assert np.allclose(rest.root[1:], whole.root[21:], atol=1e-12)
    assert np.array_equal(rest.motion.pose.rotations[1:], whole.motion.pose.rotations[21:])
    assert [e.name for _, e in rest.events] == [e.name for _, e in whole.events]
    other, _ = g.assemble(graphs.locomotion(), open_scene=samples.open_scene)
    with pytest.raises(ShapeError, match="same program"):
        g.run_program(other, frame_count=2, start=state)
