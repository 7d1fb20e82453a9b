"""Timelines: placements, layers, exposure, and what to key so that a result comes about."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from keypose import evaluate, samples
from keypose.errors import ShapeError, UnknownName
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


def skeleton(rng: np.random.Generator | None = None) -> Skeleton:
    names = ("root", "arm", "hand")
    if rng is None:
        rest = Pose(np.array([[0, 1.0, 0], [0, 0.5, 0], [0, 0.4, 0]]), np.tile([1.0, 0, 0, 0], (3, 1)), np.ones((3, 3)))
    else:
        rest = Pose(rng.normal(size=(3, 3)), quat.normalize(rng.normal(size=(3, 4))), rng.uniform(0.5, 2, (3, 3)))
    return Skeleton(names, np.array([-1, 0, 1]), rest)


def moving(target: str = "root", rate: float = 1.0, end_s: float = 2.0, name: str = "move") -> Clip:
    curve = Curve([0.0, end_s], [[0.0, 0, 0], [rate * end_s, 0, 0]])
    return Clip({Channel(target, Property.TRANSLATION): curve}, name)


def posed(rng: np.random.Generator, names: tuple[str, ...] = ("root", "arm", "hand")) -> Clip:
    curves: dict[Channel, Curve] = {}
    for name in names:
        times = [0.0, 1.0, 2.0]
        curves[Channel(name, Property.TRANSLATION)] = Curve(times, rng.normal(size=(3, 3)))
        curves[Channel(name, Property.SCALE)] = Curve(times, rng.uniform(0.5, 2, (3, 3)))
        rotations = quat.normalize(rng.normal(size=(3, 4)))
        curves[Channel(name, Property.ROTATION)] = Curve(times, rotations, kind=CurveKind.ROTATION)
    return Clip(curves, "posed")


def one(placement: Placement, **options: object) -> Timeline:
    return Timeline((Layer("base", (placement,)),), end_s=10.0, **options)  # type: ignore[arg-type]


def x_of(timeline: Timeline, clips: dict[str, Clip | Motion], times: object, joint: int = 0) -> np.ndarray:
    return np.asarray(evaluate.sample_timeline(timeline, clips, skeleton(), times).translations)[..., joint, 0]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def test_a_single_placement_is_the_clip(rng: np.random.Generator) -> None:
    clip, body = posed(rng), skeleton(rng)
    times = np.linspace(-1, 4, 37)
    got = evaluate.sample_timeline(one(Placement("posed")), {"posed": clip}, body, times)
    asked = evaluate.sample_clip(clip, body, times)
    for name in ("translations", "rotations", "scales"):
        np.testing.assert_array_equal(getattr(got, name), getattr(asked, name))


def test_an_empty_timeline_rests() -> None:
    got = evaluate.sample_timeline(Timeline(), {}, skeleton(), np.zeros((2, 3)))
    assert got.translations.shape == (2, 3, 3, 3)
    np.testing.assert_array_equal(got.translations[1, 2], skeleton().rest.translations)


@pytest.mark.parametrize(
    ("placement", "times", "asked"),
    [
        (Placement("move", start_s=1.0), [0.5, 1.0, 2.0, 3.0, 9.0], [0.0, 0.0, 1.0, 2.0, 2.0]),
        (Placement("move", speed=2.0), [0.5, 1.0, 1.5], [1.0, 2.0, 2.0]),
        (Placement("move", speed=-1.0), [0.0, 0.5, 2.0], [2.0, 1.5, 0.0]),
        (Placement("move", in_s=0.5, out_s=1.5), [0.0, 0.25, 1.0, 5.0], [0.5, 0.75, 1.5, 1.5]),
        (Placement("move", cycles=2.0), [0.5, 2.0, 2.5, 4.0, 9.0], [0.5, 0.0, 0.5, 2.0, 2.0]),
        (Placement("move", cycles=1.25, speed=2.0), [0.75, 1.0, 1.1, 1.25, 9.0], [1.5, 0.0, 0.2, 0.5, 0.5]),
        (Placement("move", cycles=1.5, speed=-1.0), [2.5, 3.0], [1.5, 1.0]),
    ],
)
def test_where_a_placement_is_in_its_clip(placement: Placement, times: list[float], asked: list[float]) -> None:
    np.testing.assert_allclose(x_of(one(placement), {"move": moving()}, times), asked, atol=1e-12)


def test_a_clip_that_is_not_cut_off_goes_on_as_its_curves_say() -> None:
    rules = {"before": Extrapolation.LINEAR, "after": Extrapolation.CYCLE_OFFSET}
    curve = Curve([0.0, 1.0], [[0.0, 0, 0], [1.0, 0, 0]], **rules)  # type: ignore[arg-type]
    clips: dict[str, Clip | Motion] = {"go": Clip({Channel("root", Property.TRANSLATION): curve})}
    times = [-1.0, 0.5, 1.5, 3.25]
    np.testing.assert_allclose(x_of(one(Placement("go")), clips, times), times)
    np.testing.assert_allclose(x_of(one(Placement("go", in_s=0.0)), clips, times), [0.0, 0.5, 1.5, 3.25])
    np.testing.assert_allclose(x_of(one(Placement("go", out_s=1.0)), clips, times), [-1.0, 0.5, 1.0, 1.0])
    np.testing.assert_allclose(x_of(one(Placement("go", speed=-1.0)), clips, times), [2.0, 0.5, -0.5, -2.25])
    np.testing.assert_allclose(x_of(one(Placement("go", out_s=1.0, speed=-1.0)), clips, times), [1.0, 0.5, -0.5, -2.25])


def test_a_placement_that_does_not_hold_leaves_the_rest_pose_outside() -> None:
    got = x_of(one(Placement("move", start_s=1.0, hold=False)), {"move": moving()}, [0.5, 2.0, 3.5])
    np.testing.assert_allclose(got, [0.0, 1.0, 0.0])


def test_a_time_warp_says_where_the_clip_is() -> None:
    warp = Curve([0.0, 1.0, 3.0], [[0.0], [2.0], [0.0]], kind=CurveKind.SCALAR)
    placement = Placement("move", start_s=1.0, time_warp=warp)
    np.testing.assert_allclose(
        x_of(one(placement), {"move": moving()}, [1.5, 2.0, 3.0, 4.0, 8.0]), [1.0, 2.0, 1.0, 0.0, 0.0]
    )
    assert evaluate.placement_duration(placement, moving()) == 3.0


def test_fades_cross_from_a_held_clip_to_the_next() -> None:
    still = Clip({Channel("root", Property.TRANSLATION): Curve([0.0], [[1.0, 0, 0]])}, "a")
    other = Clip({Channel("root", Property.TRANSLATION): Curve([0.0, 4.0], [[3.0, 0, 0], [3.0, 0, 0]])}, "b")
    timeline = Timeline((Layer("base", (Placement("a"), Placement("b", start_s=1.0, fade_in_s=1.0))),))
    u = np.array([0.0, 0.25, 0.5, 1.0])
    smooth = u * u * (3 - 2 * u)
    np.testing.assert_allclose(x_of(timeline, {"a": still, "b": other}, 1.0 + u), 1.0 + 2.0 * smooth)
    np.testing.assert_allclose(x_of(timeline, {"a": still, "b": other}, [0.5, 4.0]), [1.0, 3.0])


def test_a_weight_curve_and_a_fade_out() -> None:
    weight = Curve([0.0, 2.0], [[0.0], [1.0]], kind=CurveKind.SCALAR)
    clip = Clip({Channel("root", Property.TRANSLATION): Curve([0.0, 2.0], [[4.0, 0, 0], [4.0, 0, 0]])}, "a")
    np.testing.assert_allclose(x_of(one(Placement("a", weight=weight)), {"a": clip}, [0.5, 1.0]), [1.0, 2.0])
    faded = x_of(one(Placement("a", fade_out_s=1.0)), {"a": clip}, [0.5, 1.5, 2.0, 3.0])
    np.testing.assert_allclose(faded, [4.0, 2.0, 0.0, 0.0])


def test_a_replacing_layer_leaves_alone_what_it_does_not_drive() -> None:
    base, top = moving(), Clip({Channel("root", Property.TRANSLATION, 1): Curve([0.0], [[7.0]], kind=CurveKind.SCALAR)})
    timeline = Timeline((Layer("base", (Placement("move"),)), Layer("top", (Placement("top"),))))
    got = evaluate.sample_timeline(timeline, {"move": base, "top": top}, skeleton(), 1.0)
    np.testing.assert_allclose(got.translations[0], [1.0, 7.0, 0.0])
    np.testing.assert_array_equal(got.translations[1:], skeleton().rest.translations[1:])


def test_replacing_goes_by_slerp_and_lerp(rng: np.random.Generator) -> None:
    a, b, body = posed(rng), posed(rng), skeleton(rng)
    timeline = Timeline((Layer("base", (Placement("a"),)), Layer("top", (Placement("b"),), influence=0.3)))
    got = evaluate.sample_timeline(timeline, {"a": a, "b": b}, body, 1.2)
    pa, pb = evaluate.sample_clip(a, body, 1.2), evaluate.sample_clip(b, body, 1.2)
    np.testing.assert_allclose(got.translations, 0.7 * pa.translations + 0.3 * pb.translations, atol=1e-12)
    np.testing.assert_allclose(got.scales, 0.7 * pa.scales + 0.3 * pb.scales, atol=1e-12)
    for j in range(3):
        ra = Rotation.from_quat(pa.rotations[j], scalar_first=True)
        turn = (ra.inv() * Rotation.from_quat(pb.rotations[j], scalar_first=True)).as_rotvec()
        asked = ra * Rotation.from_rotvec(0.3 * turn)
        off = (asked.inv() * Rotation.from_quat(got.rotations[j], scalar_first=True)).magnitude()
        assert off < 1e-7


def test_adding_multiplies_by_a_power_of_the_difference_to_rest(rng: np.random.Generator) -> None:
    a, b, body = posed(rng), posed(rng), skeleton(rng)
    layers = (Layer("base", (Placement("a"),)), Layer("add", (Placement("b"),), LayerMode.ADD, influence=0.4))
    got = evaluate.sample_timeline(Timeline(layers), {"a": a, "b": b}, body, 0.7)
    pa, pb, rest = evaluate.sample_clip(a, body, 0.7), evaluate.sample_clip(b, body, 0.7), body.rest
    np.testing.assert_allclose(
        got.translations, pa.translations + 0.4 * (pb.translations - rest.translations), atol=1e-12
    )
    np.testing.assert_allclose(got.scales, pa.scales * (1 + 0.4 * (pb.scales / rest.scales - 1)), atol=1e-12)
    for j in range(3):
        base, top, own = (Rotation.from_quat(p.rotations[j], scalar_first=True) for p in (pa, pb, rest))
        asked = base * Rotation.from_rotvec(0.4 * (own.inv() * top).as_rotvec())
        assert (asked.inv() * Rotation.from_quat(got.rotations[j], scalar_first=True)).magnitude() < 1e-7


def test_an_additive_layer_at_rest_changes_nothing(rng: np.random.Generator) -> None:
    a, body = posed(rng), skeleton(rng)
    rest = body.rest
    still = Clip(
        {
            Channel(name, property): Curve([0.0], values[j : j + 1], kind=kind)
            for j, name in enumerate(body.names)
            for property, values, kind in (
                (Property.TRANSLATION, rest.translations, CurveKind.VECTOR),
                (Property.ROTATION, rest.rotations, CurveKind.ROTATION),
                (Property.SCALE, rest.scales, CurveKind.VECTOR),
            )
        }
    )
    timeline = Timeline((Layer("base", (Placement("a"),)), Layer("add", (Placement("s"),), LayerMode.ADD)))
    got = evaluate.sample_timeline(timeline, {"a": a, "s": still}, body, 1.3)
    asked = evaluate.sample_clip(a, body, 1.3)
    np.testing.assert_allclose(got.translations, asked.translations, atol=1e-12)
    np.testing.assert_allclose(np.abs(np.sum(got.rotations * asked.rotations, -1)), 1.0, atol=1e-12)
    np.testing.assert_allclose(got.scales, asked.scales, atol=1e-12)


def test_mute_solo_masks_and_properties() -> None:
    clips: dict[str, Clip | Motion] = {"move": moving(), "far": moving(rate=10.0), "arm": moving("arm", 5.0)}
    base, far, arm = (Layer(n, (Placement(n),)) for n in ("move", "far", "arm"))
    from dataclasses import replace

    assert x_of(Timeline((base, far)), clips, 1.0) == 10.0
    assert x_of(Timeline((base, replace(far, muted=True))), clips, 1.0) == 1.0
    assert x_of(Timeline((replace(base, solo=True), far)), clips, 1.0) == 1.0
    assert x_of(Timeline((base, replace(far, joints={"arm": 1.0}))), clips, 1.0) == 1.0
    assert x_of(Timeline((base, replace(far, joints={"root": 0.5}))), clips, 1.0) == 5.5
    assert x_of(Timeline((base, replace(far, properties=frozenset({Property.ROTATION})))), clips, 1.0) == 1.0
    assert x_of(Timeline((base, arm)), clips, 1.0, joint=1) == 5.0
    fade = Curve([0.0, 2.0], [[0.0], [1.0]], kind=CurveKind.SCALAR)
    assert x_of(Timeline((base, replace(far, influence=fade))), clips, 1.0) == 5.5


@pytest.mark.parametrize(("hold", "asked"), [(0, 0.30), (1, 0.28), (2, 0.24), (3, 0.24)])
def test_exposure_on_ones_twos_and_threes(hold: int, asked: float) -> None:
    timeline = one(Placement("move"), hold_frames=hold)
    np.testing.assert_allclose(x_of(timeline, {"move": moving()}, 0.30), asked, atol=1e-12)
    starts = np.arange(50) / 25
    np.testing.assert_allclose(
        x_of(timeline, {"move": moving()}, starts), starts - (np.arange(50) % hold if hold else 0) / 25, atol=1e-12
    )


def test_morphs_replace_and_add() -> None:
    def weights(value: float) -> Clip:
        return Clip({Channel("smile", Property.WEIGHT): Curve([0.0], [[value]], kind=CurveKind.SCALAR)})

    clips: dict[str, Clip | Motion] = {"a": weights(0.5), "b": weights(0.2)}
    names = ["blink", "smile"]
    for mode, asked in ((LayerMode.REPLACE, 0.35), (LayerMode.ADD, 0.6)):
        timeline = Timeline((Layer("a", (Placement("a"),)), Layer("b", (Placement("b"),), mode, influence=0.5)))
        got = evaluate.sample_timeline_morphs(timeline, clips, names, [0.0, 1.0], np.array([0.25, 0.0]))
        np.testing.assert_allclose(got, [[0.25, asked]] * 2, atol=1e-12)


def test_motions_and_clips_stand_on_one_timeline() -> None:
    scene = samples.open_scene("sample:walk")
    character, animation = scene.characters[0], scene.animations[0]
    skel = character.skeleton
    motion = animation if isinstance(animation, Motion) else evaluate.bake(animation, skel, 30.0)
    wave = Clip(
        {Channel("LeftArm", Property.EULER): Curve([0.0, 1.0], [[0.0, 0, 0], [0, 0, 1.2]], kind=CurveKind.EULER)}
    )
    layers = (Layer("walk", (Placement("walk", cycles=3.0),)), Layer("wave", (Placement("wave"),), LayerMode.ADD))
    clips: dict[str, Clip | Motion] = {"walk": motion, "wave": wave}
    timeline = Timeline(layers, "both", 30.0, 0.0, 2.0)
    baked = evaluate.bake_timeline(timeline, clips, skel)
    assert baked.frame_count == 61 and baked.name == "both"
    arm, plain = skel.names.index("LeftArm"), evaluate.sample(motion, skel, baked.times_s, loop=True)
    turned = quat.angle_between(plain.rotations[:, arm], baked.pose.rotations[:, arm])
    np.testing.assert_allclose(turned[30:], 1.2, atol=1e-4)
    others = [j for j in range(len(skel.names)) if j != arm]
    agree = np.abs(np.sum(plain.rotations[:30, others] * baked.pose.rotations[:30, others], -1))
    np.testing.assert_allclose(agree, 1.0, atol=1e-5)


@pytest.mark.parametrize("layer", ["base", "middle", "add"])
def test_what_to_key_so_that_a_result_comes_about(rng: np.random.Generator, layer: str) -> None:
    body = skeleton(rng)
    clips: dict[str, Clip | Motion] = {n: posed(rng) for n in ("base", "middle", "add", "top")}
    layers = (
        Layer("base", (Placement("base"),)),
        Layer("middle", (Placement("middle"),), influence=0.8),
        Layer("add", (Placement("add"),), LayerMode.ADD, influence=0.7),
        Layer("top", (Placement("top"),), influence=0.2),
    )
    timeline = Timeline(layers)
    now = evaluate.sample_timeline(timeline, clips, body, 1.0)
    turns = quat.from_rotation_vector(rng.normal(size=(3, 3)) * 0.2)
    wanted = Pose(now.translations + 0.1, quat.multiply(now.rotations, turns), now.scales * 1.1)
    found = evaluate.value_for_result(timeline, clips, body, layer, 1.0, wanted)
    assert np.all(found.reachable)
    keyed = {
        Channel(name, property): Curve([1.0], values[j : j + 1], kind=kind)
        for j, name in enumerate(body.names)
        for property, values, kind in (
            (Property.TRANSLATION, found.pose.translations, CurveKind.VECTOR),
            (Property.ROTATION, found.pose.rotations, CurveKind.ROTATION),
            (Property.SCALE, found.pose.scales, CurveKind.VECTOR),
        )
    }
    # Another length must not change where a placement stands: the single key lies inside the old range.
    got = evaluate.sample_timeline(timeline, {**clips, layer: Clip(keyed)}, body, 1.0)
    np.testing.assert_allclose(got.translations, wanted.translations, atol=1e-9)
    np.testing.assert_allclose(got.scales, wanted.scales, atol=1e-9)
    np.testing.assert_allclose(quat.angle_between(got.rotations, wanted.rotations), 0.0, atol=1e-7)


def test_what_a_covered_layer_cannot_do_is_said() -> None:
    clips: dict[str, Clip | Motion] = {"move": moving(), "far": moving(rate=10.0)}
    timeline = Timeline((Layer("move", (Placement("move"),)), Layer("far", (Placement("far"),))))
    found = evaluate.value_for_result(timeline, clips, skeleton(), "move", 1.0, skeleton().rest)
    assert found.reachable.tolist() == [[False, True, True], [True, True, True], [True, True, True]]


def test_gradients_flow_through_layers() -> None:
    torch = pytest.importorskip("torch")
    values = torch.tensor([[0.0, 0, 0], [2.0, 0, 0]], dtype=torch.float64, requires_grad=True)
    clip = Clip({Channel("root", Property.TRANSLATION): Curve([0.0, 2.0], values)})
    timeline = Timeline((Layer("a", (Placement("a"),), influence=0.5),))
    evaluate.sample_timeline(timeline, {"a": clip}, skeleton(), 1.0).translations.sum().backward()
    np.testing.assert_allclose(values.grad.numpy(), np.full((2, 3), 0.25))


def test_float32_stays() -> None:
    body = samples.open_scene("sample:human").characters[0].skeleton
    clip = Clip({Channel("Hips", Property.TRANSLATION): Curve([0.0], np.zeros((1, 3), np.float32))})
    layers = (Layer("a", (Placement("a"),), influence=0.3), Layer("b", (Placement("a"),), LayerMode.ADD, influence=0.3))
    got = evaluate.sample_timeline(Timeline(layers), {"a": clip}, body, [0.0, 1.0])
    assert {a.dtype for a in (got.translations, got.rotations, got.scales)} == {body.rest.translations.dtype}


def test_wrong_input_is_refused_by_name() -> None:
    with pytest.raises(UnknownName, match="no animation 'mvoe'; nearest: 'move'"):
        evaluate.sample_timeline(one(Placement("mvoe")), {"move": moving()}, skeleton(), 0.0)
    with pytest.raises(ShapeError, match="times_s"):
        evaluate.sample_timeline(one(Placement("move")), {"move": moving()}, skeleton(), np.nan)
    with pytest.raises(UnknownName, match="layer"):
        evaluate.value_for_result(one(Placement("move")), {"move": moving()}, skeleton(), "bsae", 0.0, skeleton().rest)
    for options in (
        {"speed": 0.0},
        {"cycles": 0.0},
        {"fade_in_s": -1.0},
        {"start_s": np.inf},
        {"in_s": 2.0, "out_s": 1.0},
    ):
        with pytest.raises(ShapeError):
            Placement("move", **options)
    vector = Curve([0.0], [[0.0, 0, 0]])
    with pytest.raises(ShapeError, match="SCALAR"):
        Placement("move", weight=vector)
    with pytest.raises(ShapeError, match="SCALAR"):
        Layer("a", influence=vector)
    with pytest.raises(ShapeError, match="two are named 'a'"):
        Timeline((Layer("a"), Layer("a")))
    with pytest.raises(ShapeError, match="share"):
        Layer("a", joints={"arm": 2.0})
    with pytest.raises(ShapeError, match="rate_hz"):
        evaluate.bake_timeline(Timeline(), {}, skeleton(), rate_hz=0.0)


def test_interpolation_is_the_clips_own() -> None:
    step = Clip(
        {Channel("root", Property.TRANSLATION): Curve([0.0, 1.0], [[0.0, 0, 0], [1.0, 0, 0]], Interpolation.STEP)}
    )
    np.testing.assert_allclose(x_of(one(Placement("s")), {"s": step}, [0.5, 0.999, 1.0]), [0.0, 0.0, 1.0])
