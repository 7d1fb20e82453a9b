"""The browser's timelines are those of `keypose.evaluate.sample_timeline`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from client_node import answers, client_program

from keypose import evaluate
from keypose.math import quat
from keypose.model import (
    Channel,
    Clip,
    Curve,
    CurveKind,
    Extrapolation,
    Interpolation,
    Layer,
    LayerMode,
    Motion,
    Placement,
    Pose,
    Property,
    Skeleton,
    Timeline,
)

SCRIPT = """
import { bindTimeline } from "@/anim/timeline";
import { Pose, Rig } from "@/anim/rig";

const floats = (list) => (list === null ? null : Float64Array.from(list.flat(3)));
const curveOf = (c) => c && { ...c, times: floats(c.times), values: floats(c.values), modes: Uint8Array.from(c.modes),
  inTangents: floats(c.inTangents), outTangents: floats(c.outTangents), inHandles: null, outHandles: null, types: null };
function answer({ rest, clips, timeline, times, wanted }) {
  const direct = { int32: (a) => Int32Array.from(a), float64: floats, float32: floats };
  const rig = new Rig({ ...rest, end_offsets: [], end_joints: [], controls: 0 }, direct, [0.25, 0]);
  const placed = (p) => ({ ...p, timeWarp: curveOf(p.timeWarp), weight: curveOf(p.weight) });
  const layers = timeline.layers.map((l) => ({ ...l, placements: l.placements.map(placed),
    influence: typeof l.influence === "number" ? l.influence : curveOf(l.influence) }));
  const source = {
    clips: new Map(Object.entries(clips).map(([name, c]) => [name, { ...c, name, curves: new Map(c.curves.map((k) => [k.channel.key, curveOf(k)])) }])),
    timelines: new Map([["t", { ...timeline, layers }]]),
  };
  const bound = bindTimeline(source, "t", rig, ["blink", "smile"]);
  if (bound !== bindTimeline(source, "t", rig, ["blink", "smile"])) throw new Error("not kept");
  const pose = new Pose(rig.count, 2);
  const at = (time) => {
    bound.apply(time, pose);
    return [pose.translations, pose.rotations, pose.scales, pose.morphs].map((a) => [...a]);
  };
  return { poses: times.map(at), keyed: wanted.map((w) => bound.valueForResult(w.layer, w.time, w.joint, w)) };
}
"""
NAMES = ("root", "arm", "hand")


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return client_program(SCRIPT, tmp_path_factory.mktemp("timeline"))


def body(rng: np.random.Generator) -> Skeleton:
    rest = Pose(rng.normal(size=(3, 3)), quat.normalize(rng.normal(size=(3, 4))), rng.uniform(0.5, 2, (3, 3)))
    return Skeleton(NAMES, np.array([-1, 0, 1]), rest)


def clip_of(rng: np.random.Generator, euler: bool) -> Clip:
    times = np.cumsum(rng.uniform(0.2, 0.8, 4))
    curves: dict[Channel, Curve] = {}
    after = rng.choice(np.array(list(Extrapolation)))
    for name in NAMES[: rng.integers(1, 4)]:
        tangents = rng.normal(size=(2, 4, 3))
        curves[Channel(name, Property.TRANSLATION)] = Curve(
            times, rng.normal(size=(4, 3)), Interpolation.HERMITE, *tangents, after=after
        )
        if rng.random() < 0.5:
            curves[Channel(name, Property.SCALE, 1)] = Curve(
                times, rng.uniform(0.5, 2, (4, 1)), kind=CurveKind.SCALAR, before=after
            )
        if euler and rng.random() < 0.5:
            curves[Channel(name, Property.EULER, 2)] = Curve(times, rng.normal(size=(4, 1)), kind=CurveKind.SCALAR)
        elif euler:
            curves[Channel(name, Property.EULER)] = Curve(times, rng.normal(size=(4, 3)), kind=CurveKind.EULER)
        else:
            rotations = quat.normalize(rng.normal(size=(4, 4)))
            curves[Channel(name, Property.ROTATION)] = Curve(times, rotations, kind=CurveKind.ROTATION)
    curves[Channel("smile", Property.WEIGHT)] = Curve(times, rng.uniform(0, 1, (4, 1)), kind=CurveKind.SCALAR)
    return Clip(curves, euler_orders={"arm": "ZXY"})


def placement_of(rng: np.random.Generator, name: str) -> Placement:
    options: dict[str, Any] = {"start_s": rng.uniform(-1, 1), "hold": bool(rng.random() < 0.7)}
    if rng.random() < 0.3:
        values = rng.uniform(0, 2, (3, 1))
        options["time_warp"] = Curve([0.0, 0.7, 1.9], values, kind=CurveKind.SCALAR)
    else:
        options |= {"speed": rng.choice([-1.3, 0.6, 1.0, 2.0]), "cycles": rng.choice([1.0, 1.0, 2.5])}
    if rng.random() < 0.3:
        options |= {"in_s": 0.4, "out_s": 1.3}
    if rng.random() < 0.5:
        options |= {"fade_in_s": 0.5, "fade_out_s": 0.3}
    if rng.random() < 0.3:
        options["weight"] = Curve([0.0, 1.0], [[0.2], [0.9]], kind=CurveKind.SCALAR)
    return Placement(name, **options)


def timeline_of(rng: np.random.Generator, names: list[str]) -> Timeline:
    layers: list[Layer] = []
    for n in range(int(rng.integers(1, 5))):
        fade = Curve([0.0, 3.0], [[0.1], [0.8]], kind=CurveKind.SCALAR)
        layers.append(
            Layer(
                f"layer {n}",
                tuple(placement_of(rng, str(rng.choice(names))) for _ in range(int(rng.integers(1, 4)))),
                LayerMode.ADD if rng.random() < 0.5 else LayerMode.REPLACE,
                fade if rng.random() < 0.3 else float(rng.choice([0.4, 1.0])),
                {"arm": 0.5, "root": 1.0, "smile": 0.7} if rng.random() < 0.3 else {},
                frozenset({Property.EULER, Property.TRANSLATION}) if rng.random() < 0.3 else None,
                muted=bool(rng.random() < 0.1),
                solo=bool(rng.random() < 0.1),
            )
        )
    return Timeline(tuple(layers), rate_hz=25.0, hold_frames=int(rng.choice([0, 0, 1, 3])))


def curve_json(channel: Channel, curve: Curve) -> dict[str, Any]:
    def listed(array: Any) -> Any:
        return None if array is None else np.asarray(array).tolist()

    key = f"{channel.target}\0{channel.property.value}\0{'' if channel.component is None else channel.component}"
    return {
        "channel": {
            "key": key, "target": channel.target, "property": channel.property.value, "component": channel.component,
        },
        "kind": curve.kind.value, "components": curve.values.shape[1], "times": listed(curve.times_s),
        "values": listed(curve.values), "modes": listed(curve.modes), "inTangents": listed(curve.in_tangents),
        "outTangents": listed(curve.out_tangents), "before": curve.before.value, "after": curve.after.value,
    }  # fmt: skip


def timeline_json(timeline: Timeline) -> dict[str, Any]:
    scalar = Channel("", Property.VALUE)

    def curve(value: Curve | None) -> Any:
        return None if value is None else curve_json(scalar, value)

    def placement(p: Placement) -> dict[str, Any]:
        return {
            "animation": p.animation, "start": p.start_s, "inTime": p.in_s, "outTime": p.out_s, "speed": p.speed,
            "cycles": p.cycles, "fadeIn": p.fade_in_s, "fadeOut": p.fade_out_s, "timeWarp": curve(p.time_warp),
            "weight": curve(p.weight), "hold": p.hold, "muted": p.muted,
        }  # fmt: skip

    def layer(one: Layer) -> dict[str, Any]:
        return {
            "name": one.name, "placements": [placement(p) for p in one.placements], "mode": one.mode.value,
            "influence": curve(one.influence) if isinstance(one.influence, Curve) else one.influence,
            "joints": dict(one.joints), "muted": one.muted, "solo": one.solo, "locked": one.locked,
            "properties": None if one.properties is None else [p.value for p in one.properties],
        }  # fmt: skip

    return {
        "name": timeline.name, "layers": [layer(one) for one in timeline.layers], "rate": timeline.rate_hz,
        "start": timeline.start_s, "end": timeline.end_s, "holdFrames": timeline.hold_frames, "markers": [],
    }  # fmt: skip


def question(
    skeleton: Skeleton, clips: dict[str, Clip], timeline: Timeline, times: Any, wanted: list[Any]
) -> dict[str, Any]:
    rest = skeleton.rest
    return {
        "rest": {
            "names": list(skeleton.names), "parents": skeleton.parents.tolist(),
            "translations": rest.translations.tolist(), "rotations": rest.rotations.tolist(), "scales": rest.scales.tolist(),
        },
        "clips": {
            name: {"rate": None, "eulerOrders": dict(clip.euler_orders), "curves": [curve_json(*c) for c in clip.curves.items()]}
            for name, clip in clips.items()
        },
        "timeline": timeline_json(timeline), "times": list(times), "wanted": wanted,
    }  # fmt: skip


def test_random_timelines_agree(program: Path) -> None:
    rng = np.random.default_rng(11)
    asked, expected = list[Any](), list[Any]()
    times = np.linspace(-2, 5, 57) + 1e-3
    for n in range(60):
        skeleton, clips = body(rng), {name: clip_of(rng, n % 2 == 1) for name in "abc"}
        timeline, animations = timeline_of(rng, list(clips)), dict[str, Clip | Motion](clips)
        pose = evaluate.sample_timeline(timeline, animations, skeleton, times)
        weights = evaluate.sample_timeline_morphs(
            timeline, animations, ["blink", "smile"], times, np.array([0.25, 0.0])
        )
        expected.append((pose, weights))
        asked.append(question(skeleton, clips, timeline, times, []))
    for got, (pose, weights) in zip(answers(program, *asked), expected, strict=True):
        t, r, s, m = (np.array([p[i] for p in got["poses"]]) for i in range(4))
        np.testing.assert_allclose(t.reshape(pose.translations.shape), pose.translations, atol=1e-11)
        np.testing.assert_allclose(s.reshape(pose.scales.shape), pose.scales, atol=1e-11)
        np.testing.assert_allclose(m, weights, atol=1e-11)
        turned = quat.angle_between(quat.normalize(r.reshape(pose.rotations.shape)), quat.normalize(pose.rotations))
        np.testing.assert_allclose(turned, 0.0, atol=1e-10)


def test_what_to_key_agrees(program: Path) -> None:
    rng = np.random.default_rng(13)
    asked, expected = list[Any](), list[Any]()
    for n in range(40):
        skeleton, clips = body(rng), {name: clip_of(rng, n % 2 == 1) for name in "abc"}
        plain = timeline_of(rng, list(clips))
        timeline = replace(plain, layers=tuple(replace(one, muted=False, solo=False) for one in plain.layers))
        layer = str(rng.choice([one.name for one in timeline.layers]))
        wanted = Pose(rng.normal(size=(3, 3)), quat.normalize(rng.normal(size=(3, 4))), rng.uniform(0.5, 2, (3, 3)))
        time_s = float(rng.uniform(0, 2))
        expected.append(evaluate.value_for_result(timeline, dict(clips), skeleton, layer, time_s, wanted))
        joints = [
            {
                "layer": layer, "time": time_s, "joint": j, "translation": wanted.translations[j].tolist(),
                "rotation": wanted.rotations[j].tolist(), "scale": wanted.scales[j].tolist(),
            }
            for j in range(3)
        ]  # fmt: skip
        asked.append(question(skeleton, clips, timeline, [], joints))
    for got, found in zip(answers(program, *asked), expected, strict=True):
        for j, keyed in enumerate(got["keyed"]):
            says = [keyed["reachable"][name] for name in ("translation", "rotation", "scale")]
            assert says == found.reachable[j].tolist()
            if says[0]:
                np.testing.assert_allclose(keyed["translation"], found.pose.translations[j], rtol=1e-9, atol=1e-9)
            if says[2]:
                np.testing.assert_allclose(keyed["scale"], found.pose.scales[j], rtol=1e-9, atol=1e-9)
            if says[1]:
                turned = quat.angle_between(np.array(keyed["rotation"]), found.pose.rotations[j])
                assert turned < 1e-8
