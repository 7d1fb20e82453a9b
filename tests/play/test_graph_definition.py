"""Definitions: as JSON and back, and what is said about wrong ones."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from graph_fixtures import build, clips, machine, single, skeleton, sources

from keypose.errors import FormatError, UnknownName
from keypose.play import graph as g
from keypose.samples import graphs


def everything() -> g.Graph:
    """A graph with a node of every kind."""
    nodes = {
        "a": g.ClipNode("a", "pace", 3, 0.25, ((0.0, 0.0), (0.5, 0.7), (1.0, 1.0)), False),
        "b": g.ClipNode("b", -1.5),
        "c": g.ClipNode("c"),
        "b2": g.ClipNode("b"),
        "c2": g.ClipNode("c"),
        "a3": g.ClipNode("a"),
        "b3": g.ClipNode("b"),
        "c3": g.ClipNode("c"),
        "rest": g.RestNode(),
        "line": g.Blend1D("pace", (g.Sample1D("a", 0.0), g.Sample1D("b", 1.0)), "phase"),
        "plane": g.Blend2D(0.5, "pace", (g.Sample2D("b2", (0.0, 0.0)), g.Sample2D("c2", (1.0, 2.0))), "gradient_band"),
        "mean": g.Blend((g.Input("line"), g.Input("plane", "pace"), g.Input("rest", 0.1))),
        "sum": g.Additive("mean", "c", 0.5, "upper", "a", 0.25),
        "over": g.Layer("sum", "a3", "pace", "upper"),
        "warp": g.TimeWarp("over", 0.5),
        "steer": g.Steer("warp", 30.0),
        "states": g.StateMachine(
            {"move": "steer", "b": "b3", "c": "c3"},
            (
                g.Transition(
                    "move", "b", (g.Condition("go"), g.Condition("pace", ">=", 0.5)), 0.5, "dead", 0.2, "both"
                ),
                g.Transition("*", "c", (g.Condition("count", "==", 3.0),), None, "inertial", 0.4),
            ),
            "b",
        ),
        "look": g.LookAt("states", "target", {"spine": 0.4, "head": 0.6}),
        "reach": g.TwoBone("look", "target", "thigh", "shin", "foot", 0.3),
        "plant": g.Plant("reach", ("ground",)),
    }
    parameters = {
        "pace": g.Parameter("float", 0.5, 0.0, 2.0, 0.1),
        "count": g.Parameter("int", 2.0),
        "on": g.Parameter("bool", True),
        "go": g.Parameter("trigger"),
        "target": g.Parameter("vector", (0.0, 1.0, 2.0)),
    }
    mask = g.Mask({"spine": 1.0}, {"head": 0.5}, {"*": 0.3, "smile": 1.0})
    source = replace(sources()["a"], markers=(g.Marker("beat", 0.5),), events=(g.ClipEvent("clap", 0.2, "loud"),))
    return g.Graph(
        nodes,
        "plant",
        parameters,
        {**sources(), "a": source},
        {"upper": mask},
        {"ground": g.Contact("foot", "thigh")},
        "all",
    )


@pytest.mark.parametrize("make", [everything, graphs.locomotion, lambda: machine("dead")])
def test_json_round_trip(make) -> None:
    graph = make()
    g.check(graph)
    text = g.to_json(graph)
    assert g.from_json(text) == graph
    assert g.to_json(g.from_json(text)) == text
    assert json.loads(text)["version"] == 1


def test_every_kind_of_node_steps() -> None:
    program = build(replace(everything(), contacts={"ground": g.Contact("foot", "thigh")}))
    state = g.init(program)
    for _ in range(30):
        state, out = g.step(state, {"go": True, "pace": 1.0}, dt_s=0.05)
        assert np.all(np.isfinite(out.pose.rotations)) and np.all(np.isfinite(out.pose.translations))
        assert out.morph_weights.shape == (2,)


def test_saved_and_loaded(tmp_path) -> None:
    path = tmp_path / "graph.json"
    g.save(everything(), path)
    assert g.load(path) == everything()
    assert [p.name for p in tmp_path.iterdir()] == ["graph.json"]
    path.write_text(path.read_text().replace('"version": 1', '"version": 99'))
    with pytest.raises(FormatError, match=r"graph\.json: version: expected version 1, got 99"):
        g.load(path)
    with pytest.raises(FormatError, match="nowhere"):
        g.load(tmp_path / "nowhere.json")


def changed(path: str, value: object) -> str:
    """The JSON of `everything` with one place changed; a path of keys joined by /."""
    data = json.loads(g.to_json(everything()))
    place = data
    *way, last = path.split("/")
    for key in way:
        place = place[int(key)] if isinstance(place, list) else place[key]
    if value is ...:
        del place[last]
    elif isinstance(place, list):
        place[int(last)] = value
    else:
        place[last] = value
    return json.dumps(data)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("nodes/line/samples/1/node", "bb", "node 'line': samples[1].node: no node 'bb'; nearest: 'b'"),
        ("nodes/b/clip", "bee", "node 'b': clip: no clip 'bee'"),
        ("nodes/line/parameter", "pece", "node 'line': parameter: no parameter 'pece'; nearest: 'pace'"),
        ("nodes/line/parameter", True, "node 'line'.parameter: expected a number or a name, got true"),
        (
            "nodes/line/parameter",
            "target",
            "node 'line': parameter: expected a number, but parameter 'target' is a vector",
        ),
        ("nodes/line/sync", "phaze", "node 'line'.sync: no choice 'phaze'; nearest: 'phase'"),
        ("nodes/line/samples", [], "node 'line': samples: expected at least one sample"),
        ("nodes/line/smaples", [], "node 'line': no field 'smaples'; nearest: 'samples'"),
        ("nodes/line/kind", "blend1d", "node 'line': no kind of node 'blend1d'; nearest: 'blend_1d'"),
        ("nodes/line/samples/0/at", ..., "node 'line'.samples[0]: field 'at' is missing"),
        ("nodes/plane/samples/0/at", [1], "node 'plane'.samples[0].at: expected 2 values, got 1"),
        ("nodes/a/loops", -1, "node 'a': loops"),
        ("nodes/a/loops", 1.5, "node 'a'.loops: expected a whole number, got 1.5"),
        ("nodes/a/warp/1", [0.5, 1.2], "node 'a': warp: expected points that rise"),
        ("nodes/sum/mask", "uper", "node 'sum': mask: no mask 'uper'; nearest: 'upper'"),
        ("nodes/sum/reference", "d", "node 'sum': reference: no clip 'd'"),
        ("nodes/states/entry", "moov", "node 'states': entry: no state 'moov'; nearest: 'move'"),
        ("nodes/states/transitions/0/target", "d", "node 'states': transitions[0].target: no state 'd'"),
        ("nodes/states/transitions/0/duration_s", -1, "node 'states': transitions[0].duration_s"),
        ("nodes/states/transitions/0/sync", True, "the state machine's own sync is 'none'"),
        ("nodes/states/transitions/0/conditions/0/test", ">", "'>' does not fit the trigger 'go'"),
        ("nodes/states/transitions/1/conditions", [], "'*' to 'c' needs a condition or an exit time"),
        ("nodes/look/target", "pace", "node 'look': target: parameter 'pace' is no vector"),
        ("nodes/plant/contacts", ["grund"], "node 'plant': contacts[0]: no contact 'grund'; nearest: 'ground'"),
        ("nodes/over/layer", "sum", "is already an input of 'over'"),
        ("nodes/warp/input", "plant", "is its own input"),
        ("nodes/extra", {"kind": "rest"}, "node 'extra': nothing leads from it to the output"),
        ("output", "plan", "graph: output: no node 'plan'; nearest: 'plan"),
        ("parameters/target/default", 1.0, "default: expected three numbers"),
        ("parameters/pace/default", 1e999, "no JSON: Infinity is no number of JSON"),
        ("format", "gltf", "format: expected an object"),
    ],
)
def test_wrong_definitions_name_the_place(path: str, value: object, message: str) -> None:
    with pytest.raises(FormatError) as error:
        g.from_json(changed(path, value))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"contacts": {"ground": g.Contact("foott", "thigh")}},
            "contacts['ground'].joint: no joint 'foott'; nearest: 'foot'",
        ),
        ({"masks": {"upper": g.Mask({"spin": 1.0})}}, "masks['upper'].branches: no joint 'spin'; nearest: 'spine'"),
        (
            {"masks": {"upper": g.Mask({}, {}, {"smyle": 1.0})}},
            "masks['upper'].curves: no morph 'smyle'; nearest: 'smile'",
        ),
        ({"root": "hip"}, "root: no joint 'hip'; nearest: 'hips'"),
        (
            {"clips": {**sources(), "a": g.ClipSource(end_s=9.0)}},
            "clips['a']: cut from 0 s to 9 s of an animation of 1 s",
        ),
        (
            {"clips": {**sources(), "b": g.ClipSource(markers=(g.Marker("x", 2.0),))}},
            "clips['b'].markers[0]: 2 s is outside",
        ),
    ],
)
def test_what_does_not_fit_the_skeleton_or_the_clips(change: dict, message: str) -> None:
    with pytest.raises(g.GraphError) as error:
        build(replace(everything(), **change))
    assert message in str(error.value)


def test_missing_animation_is_named() -> None:
    with pytest.raises(g.GraphError, match=r"clips\['c'\]: no animation 'c'"):
        g.build(single(g.ClipNode("a")), skeleton(), {k: v for k, v in clips().items() if k != "c"})


def test_limb_must_be_a_chain() -> None:
    graph = everything()
    nodes = {**graph.nodes, "reach": g.TwoBone("look", "target", "thigh", "spine", "foot")}
    with pytest.raises(g.GraphError, match="node 'reach': end: expected three joints"):
        build(replace(graph, nodes=nodes))


def test_clips_of_a_group_must_have_the_same_markers() -> None:
    graph = everything()
    marked = {
        "a": g.ClipSource(markers=(g.Marker("l", 0.1), g.Marker("r", 0.6))),
        "b": g.ClipSource(markers=(g.Marker("l", 0.1),)),
    }
    nodes = {
        "a": g.ClipNode("a"),
        "b": g.ClipNode("b"),
        "top": g.Blend((g.Input("a"), g.Input("b")), "markers", ("l", "r")),
    }
    graph = g.Graph(nodes, "top", clips=marked)
    with pytest.raises(
        g.GraphError, match=r"node 'b': clip 'b' has the sync markers l; the group of 'top' repeats l, r"
    ):
        build(graph)
    nodes["top"] = g.Blend((g.Input("a"), g.Input("b")), "markers", ("x",))
    with pytest.raises(g.GraphError, match="node 'top': sync: none of its clips has the markers x"):
        build(g.Graph(nodes, "top", clips=marked))


def test_damaged_files_raise_one_line() -> None:
    """Bytes changed, cut and doubled: a graph or a FormatError, nothing else."""
    text = g.to_json(everything()).encode()
    rng = np.random.default_rng(7)
    for _ in range(400):
        data = bytearray(text)
        for _ in range(rng.integers(1, 4)):
            at = int(rng.integers(len(data)))
            if rng.random() < 0.5:
                data[at] = int(rng.integers(256))
            else:
                del data[at : at + int(rng.integers(1, 200))]
        try:
            g.from_json(bytes(data))
        except FormatError as error:
            assert "\n" not in str(error)
    for bad in (b"", b"[", b"[" * 100_000, b'{"format": "keypose-graph", "version": 1}', b"null", b"\xff\xfe"):
        with pytest.raises(FormatError):
            g.from_json(bad)


def test_a_name_that_appears_twice_is_refused() -> None:
    text = g.to_json(everything()).replace('"rest": {', '"c3": {', 1)
    with pytest.raises(FormatError, match="'c3' appears twice"):
        g.from_json(text)


def test_names_of_graphs() -> None:
    assert graphs.load("locomotion") == graphs.locomotion() and graphs.names() == ["locomotion"]
    with pytest.raises(UnknownName, match="nearest: 'locomotion'"):
        graphs.load("locomotoin")
