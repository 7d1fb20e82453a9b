"""Synchronisation: clips of different lengths meet at their markers; feet that touch the ground stand still."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from graph_fixtures import build, clips, skeleton, sources

from keypose import io, samples
from keypose.evaluate import sample_motion, world_rotations_positions
from keypose.model import Motion, Skeleton
from keypose.play import graph as g
from keypose.play.graph.synchrony import period, progress, table_for
from keypose.samples import graphs


def pair(sync: str, **more) -> g.Graph:
    nodes = {
        "a": g.ClipNode("a"),
        "b": g.ClipNode("b"),
        "top": g.Blend((g.Input("a", 0.6), g.Input("b", 0.4)), sync, **more),
    }
    return g.Graph(nodes, "top", clips=sources("none"))


def times(out: g.Output) -> list[float]:
    assert out.trace is not None
    return [c.time_s for c in out.trace.clips]


def test_phases_stay_equal_and_the_cycle_is_the_mean() -> None:
    program = build(pair("phase"))
    state = g.init(program)
    for n in range(1, 200):
        state, out = g.step(state, dt_s=0.017, trace=True)
        a, b = times(out)
        assert a / 1.0 == pytest.approx(b / 0.7, abs=1e-9)
        assert a == pytest.approx((n * 0.017 / (0.6 * 1.0 + 0.4 * 0.7)) % 1.0, abs=1e-9)


def test_markers_meet_and_time_is_even_between_them() -> None:
    left, right = "left", "right"
    marked = {
        "a": replace(sources("none")["a"], markers=(g.Marker(left, 0.1), g.Marker(right, 0.7))),
        "b": replace(sources("none")["b"], markers=(g.Marker(right, 0.2), g.Marker(left, 0.4))),
        "c": sources("none")["c"],
    }
    program = build(replace(pair("markers", markers=(left, right)), clips=marked))
    state = g.init(program)
    for _ in range(300):
        state, out = g.step(state, dt_s=0.011, trace=True)
        a, b = times(out)
        share_a = (a - 0.1) / 0.6 if 0.1 <= a < 0.7 else ((a - 0.7) % 1.0) / 0.4
        share_b = ((b - 0.4) % 0.7) / 0.5 if not 0.2 <= b < 0.4 else (b - 0.2) / 0.2
        assert (0.1 <= a < 0.7) == (not 0.2 <= b < 0.4)
        assert share_a == pytest.approx(share_b, abs=1e-9)


def test_steps_do_not_matter() -> None:
    for sync in ("phase", "none"):
        program = build(pair(sync))
        whole, _ = g.step(g.init(program), dt_s=6.3)
        state = g.init(program)
        for _ in range(630):
            state, _ = g.step(state, dt_s=0.01)
        np.testing.assert_allclose(state.floats, whole.floats, atol=1e-9)
        np.testing.assert_allclose(state.root, whole.root, atol=1e-9)


def test_nested_blends_share_their_parents_places() -> None:
    nodes = {
        "a": g.ClipNode("a"),
        "b": g.ClipNode("b"),
        "c": g.ClipNode("c"),
        "slow": g.Blend((g.Input("a", 0.5), g.Input("c", 0.5))),
        "top": g.Blend((g.Input("slow", 0.5), g.Input("b", 0.5)), "phase"),
    }
    program = build(g.Graph(nodes, "top", clips=sources()))
    state = g.init(program)
    for _ in range(50):
        state, out = g.step(state, dt_s=0.05, trace=True)
        assert out.trace is not None
        assert np.ptp([c.phase for c in out.trace.clips]) < 1e-9
    # 0.25 * 1.0 + 0.25 * 2.3 + 0.5 * 0.7 s per cycle
    assert out.trace.clips[0].phase == pytest.approx((2.5 / 1.175) % 1, abs=1e-9)


def test_a_clip_with_more_cycles_keeps_step() -> None:
    """Four markers against two: two cycles of the one are one of the other."""
    table = table_for([(0.1, "l"), (0.4, "r"), (0.6, "l"), (0.9, "r")], ("l", "r"), 1.0)
    short = table_for([(0.2, "r"), (0.5, "l")], ("l", "r"), 0.6)
    assert table is not None and short is not None
    assert period(["l", "r", "l", "r"]) == ("l", "r")
    assert table_for([(0.1, "l"), (0.2, "l"), (0.3, "r")], ("l", "r"), 1.0) is None
    for place in [(0, 0.0), (3, 0.5), (7, 0.999), (-3, 0.25), (1, 0.999)]:
        for t in (table, short):
            assert t.position(*t.time(place)) == pytest.approx(place)
    assert progress((0, 0.5), 10.0, lambda i: 1.0 if i % 2 else 3.0) == pytest.approx((5, 0.5))


def test_synced_transitions_start_in_step() -> None:
    graph = pair("phase")
    machine = g.StateMachine(
        {"a": "a", "b": "b"},
        (g.Transition("a", "b", (g.Condition("go"),), None, "crossfade", 0.3, sync=True),),
        sync="phase",
    )
    nodes = {"a": g.ClipNode("a"), "b": g.ClipNode("b"), "top": machine}
    program = build(g.Graph(nodes, "top", {"go": g.Parameter("trigger")}, graph.clips))
    state, _ = g.step(g.init(program), dt_s=0.37)
    state, out = g.step(state, {"go": True}, dt_s=0.1, trace=True)
    a, b = times(out)
    assert a == pytest.approx(b / 0.7, abs=1e-9) and 0.37 < a < 0.6
    for _ in range(3):
        state, out = g.step(state, dt_s=0.1, trace=True)
    assert len(times(out)) == 1


# --- feet ---------------------------------------------------------------------------------------------------------------


@dataclass
class Slide:
    """Speeds in cm/s of contacts in the frames in which all clips that are blended touch the ground."""

    mean: float
    most: float
    share: float


def slide(graph: g.Graph, body: Skeleton, motions: dict[str, Motion], parameter: float) -> Slide:
    program = g.build(graph, body, motions, dtype=np.float64)
    rate = 60.0
    run = g.run_program(replace(program), [g.Inputs(0.0, {"u": parameter})], frame_count=181, rate_hz=rate)
    _, positions = world_rotations_positions(body, run.motion.pose)
    feet = positions[:, [body.index(c.joint) for c in graph.contacts.values()]]
    speed = 100 * rate * np.linalg.norm(np.diff(feet[:, :, [0, 2]], axis=0), axis=-1)
    touching = (run.contacts[1:] > 0.999) & (run.contacts[:-1] > 0.999)
    assert touching.mean() > 0.05
    return Slide(float(speed[touching].mean()), float(speed[touching].max()), float(touching.mean()))


def blend_of(clips_: dict[str, g.ClipSource], contacts: dict[str, g.Contact], sync: str, plant: bool) -> g.Graph:
    nodes = {name: g.ClipNode(name) for name in clips_}
    nodes["blend"] = g.Blend1D("u", tuple(g.Sample1D(n, float(i)) for i, n in enumerate(clips_)), sync)
    if plant:
        nodes["plant"] = g.Plant("blend")
    return g.Graph(nodes, "plant" if plant else "blend", {"u": g.Parameter()}, clips_, {}, contacts)


def report(name: str, clips_, contacts, body, motions, parameter: float) -> tuple[Slide, Slide]:
    unsynced = slide(blend_of(clips_, contacts, "none", False), body, motions, parameter)
    synced = slide(blend_of(clips_, contacts, "markers", False), body, motions, parameter)
    planted = slide(blend_of(clips_, contacts, "markers", True), body, motions, parameter)
    print(
        f"\n{name} at {parameter:g}: foot slide in contact, mean (most) cm/s: unsynced {unsynced.mean:.2f} "
        f"({unsynced.most:.2f}), synced {synced.mean:.2f} ({synced.most:.2f}), planted {planted.mean:.3f} ({planted.most:.3f})"
    )
    assert synced.share > 1.1 * unsynced.share  # in step, the contacts meet
    return unsynced, planted


@pytest.mark.parametrize("parameter", [0.25, 0.5, 0.75])
def test_feet_of_a_walk_run_blend_do_not_slide(parameter: float) -> None:
    """Below 2 cm/s in contact: in step, with the feet planted where the mean of both clips' feet is."""
    human = samples.load("human")
    motions = {n: human.animation(n) for n in ("walk", "run")}
    clips_ = {n: g.ClipSource() for n in motions}
    body = human.character.skeleton
    unsynced, planted = report("walk and run", clips_, graphs.contacts(), body, motions, parameter)
    assert planted.most < 2.0 and unsynced.most > 10.0


@pytest.mark.data
@pytest.mark.parametrize(("slow", "fast"), [(4, 12), (6, 9)])
def test_feet_of_captured_walks_do_not_slide(data_dir, slow: int, fast: int) -> None:
    """Walks of one person at two speeds, cut to their best cycle and closed; contacts found automatically."""
    contacts = {
        side: g.Contact(f"CC_Base_{side}_ToeBase", f"CC_Base_{side}_Thigh", height_m=0.04, speed_m_s=0.4)
        for side in "LR"
    }
    motions, clips_ = {}, {}
    for number in (slow, fast):
        scene = io.load(data_dir / f"bvh/cmu_iclone_007/007_{number:02d}.bvh")
        motion = scene.animation()
        start, end = g.find_cycle(motion, shortest_s=0.8, margin_s=0.1)
        motions[f"walk{number}"] = motion
        clips_[f"walk{number}"] = g.ClipSource(start_s=start, end_s=end, close_loop=True)
    body = scene.character.skeleton
    unsynced, planted = report(f"007 walks {slow} and {fast}", clips_, contacts, body, motions, 0.5)
    assert planted.most < 2.0 and unsynced.most > 10.0


def test_found_cycles_repeat() -> None:
    human = samples.load("human")
    start, end = g.find_cycle(human.animation("walk"))
    assert (end - start) % (62 / 60) == pytest.approx(0, abs=1.01 / 60) or (end - start) == pytest.approx(
        62 / 60, abs=0.02
    )


def test_planted_feet_leave_a_single_clip_as_it_is() -> None:
    human = samples.load("human")
    body, motion = human.character.skeleton, human.animation("walk")
    graph = g.Graph(
        {"walk": g.ClipNode("walk"), "top": g.Plant("walk")},
        "top",
        clips={"walk": g.ClipSource(root_motion="none", cyclic=False)},
        contacts=graphs.contacts(),
    )
    program = g.build(graph, body, {"walk": motion}, dtype=np.float64)
    state, worst = g.init(program), 0.0
    for frame in range(motion.frame_count - 1):
        state, out = g.step(state, dt_s=1 / 60 if frame else 0.0)
        places = world_rotations_positions(body, out.pose)[1]
        still = world_rotations_positions(body, sample_motion(motion, frame / 60))[1]
        worst = max(worst, float(np.abs(places - still).max()))
    # what the contacts move while they touch, taken out: toes that leave the ground gently are 2 cm away when that is told
    assert worst < 0.02


def test_contacts_without_a_plant_node_change_nothing() -> None:
    """A contact whose limb is not planted changes nothing."""
    with_contact = replace(pair("none"), contacts={"ground": g.Contact("foot")})
    outs = [g.step(g.init(g.build(x, skeleton(), clips())), dt_s=0.3)[1] for x in (pair("none"), with_contact)]
    assert np.array_equal(outs[0].pose.rotations, outs[1].pose.rotations)
    assert set(outs[1].contacts) == {"ground"} and not outs[0].contacts


@pytest.mark.parametrize(("name", "turn_deg_s"), [("walk", 60.0), ("walk", -30.0), ("run", 60.0)])
def test_feet_stand_on_a_curved_way(name: str, turn_deg_s: float) -> None:
    """Turning a walk about the root would drag the feet along; bending their places with the way does not."""
    human = samples.load("human")
    body = human.character.skeleton
    nodes = {"gait": g.ClipNode(name), "turn": g.Steer("gait", turn_deg_s), "plant": g.Plant("turn")}
    graph = g.Graph(nodes, "plant", clips={name: g.ClipSource()}, contacts=graphs.contacts())
    without = replace(graph, nodes={k: v for k, v in nodes.items() if k != "plant"}, output="turn")
    worst = []
    for one in (without, graph):
        program = g.build(one, body, {name: human.animation(name)}, dtype=np.float64)
        run = g.run_program(program, frame_count=241, rate_hz=120.0)
        _, positions = world_rotations_positions(body, run.motion.pose)
        feet = positions[:, [body.index(c.joint) for c in graph.contacts.values()]]
        speed = 12000 * np.linalg.norm(np.diff(feet[:, :, [0, 2]], axis=0), axis=-1)
        touching = (run.contacts[1:] > 0.999) & (run.contacts[:-1] > 0.999)
        touching[0] = False
        worst.append(float(speed[touching].max()))
    print(
        f"\n{name} at {turn_deg_s:g} degrees/s: foot slide in contact at most {worst[0]:.1f}, planted {worst[1]:.2f} cm/s"
    )
    assert worst[1] < 2.0 and worst[0] > 8.0
