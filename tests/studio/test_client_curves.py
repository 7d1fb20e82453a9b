"""The browser's curves are those of `keypose.evaluate.sample_curve`, and its key operations keep their laws."""

from __future__ import annotations

import base64
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from client_node import answers, client_program

from keypose import evaluate
from keypose.editing.tangents import update_tangents
from keypose.math import euler, quat
from keypose.model import (
    ROTATION_ONLY,
    Channel,
    Character,
    Clip,
    Curve,
    CurveKind,
    Extrapolation,
    Interpolation,
    Pose,
    Property,
    Scene,
    Skeleton,
    Tangent,
)
from keypose.studio.payload import encode

SCRIPT = """
import { Curve } from "@/anim/curve";
import { eulerFromQuat, quatFromEuler } from "@/anim/euler";
import * as keys from "@/edit/keys";

const floats = (list) => (list === null ? null : Float64Array.from(list.flat(3)));
const bytes = (list) => (list === null ? null : Uint8Array.from(list.flat(2)));
const read = (c) => ({ ...c, components: c.values[0].length, channel: { key: "a", target: "a", property: "value", component: null },
  times: floats(c.times), values: floats(c.values), modes: bytes(c.modes), types: bytes(c.types),
  inTangents: floats(c.inTangents), outTangents: floats(c.outTangents), inHandles: floats(c.inHandles), outHandles: floats(c.outHandles) });
const told = (c) => c && Object.fromEntries(Object.entries(c).map(([k, v]) => [k, ArrayBuffer.isView(v) ? [...v] : v]));
function sampled(curve, times) {
  const sampler = new Curve(curve), out = new Float64Array(curve.components);
  return times.map((t) => (sampler.sample(t, out, 0), [...out]));
}
const operations = {
  refresh: (c) => ({ curve: keys.refreshTangents(c) }),
  insert: (c, { time }) => keys.insertKey(c, time),
  transform: (c, { indices, transform, masks }) => keys.transformKeys(c, Uint32Array.from(indices), transform, masks && Uint8Array.from(masks)),
  chain: (c, { indices, transforms }) => {
    const made = [null, null];
    let last;
    for (const transform of transforms) {
      last = keys.transformKeys(c, Uint32Array.from(indices), transform, null, made.at(-2));
      made.push(last.curve === c ? null : last.curve);
    }
    return { curve: keys.compact(last.curve, c), indices: last.indices };
  },
  retime: (c, { indices, rate }) => keys.retimeKeys(c, Uint32Array.from(indices), (t) => Math.round(t * rate) / rate),
  duplicate: (c, { indices, shift }) => keys.duplicateKeys(c, Uint32Array.from(indices), shift),
  remove: (c, { indices }) => ({ curve: keys.deleteKeys(c, Uint32Array.from(indices)), indices: [] }),
  paste: (c, { indices, options }) => {
    const copied = keys.copyKeys([{ curve: c, indices: Uint32Array.from(indices) }]);
    return keys.pasteKeys(c, copied.curves[0], copied.length, c.channel, options);
  },
  mode: (c, { indices, mode }) => ({ curve: keys.setMode(c, Uint32Array.from(indices), mode) }),
  type: (c, { indices, type, side }) => ({ curve: keys.setType(c, Uint32Array.from(indices), type, side) }),
  handle: (c, { key, side, seconds, value }) => ({ curve: keys.setHandle(c, key, 0, side, seconds, value) }),
  ease: (c, { indices, ease }) => ({ curve: keys.setEase(c, Uint32Array.from(indices), ease) }),
};
function answer({ curve, times, operation, given, angles, order }) {
  if (angles)
    return angles.map((a) => {
      const q = new Float64Array(4), back = [0, 0, 0];
      quatFromEuler(a, 0, order, q, 0);
      eulerFromQuat(q, 0, order, back, 0);
      return [[...q], back];
    });
  const own = read(curve);
  if (!operation) return { samples: sampled(own, times) };
  const before = JSON.stringify(told(own));
  const done = operations[operation](own, given ?? {});
  if (JSON.stringify(told(own)) !== before) throw new Error(operation + " wrote into its curve");
  return { curve: told(done.curve), indices: done.indices && [...done.indices], samples: times && sampled(done.curve, times) };
}
"""
PLAIN = (Interpolation.STEP, Interpolation.LINEAR, Interpolation.HERMITE, Interpolation.BEZIER)
KINDS = {
    CurveKind.SCALAR: (1, PLAIN),
    CurveKind.VECTOR: (3, PLAIN),
    CurveKind.EULER: (3, PLAIN),
    CurveKind.COLOR: (4, PLAIN),
    CurveKind.BOOLEAN: (1, (Interpolation.STEP,)),
    CurveKind.ROTATION: (
        4,
        (Interpolation.STEP, Interpolation.LINEAR, Interpolation.HERMITE, *ROTATION_ONLY),
    ),
}
STILL = {"scaleTime": 1, "shiftTime": 0, "scaleValue": 1, "shiftValue": 0}


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return client_program(SCRIPT, tmp_path_factory.mktemp("curves"))


def told(curve: Curve) -> dict[str, Any]:
    """A curve for the script."""

    def numbers(array: Any) -> Any:
        return None if array is None else np.asarray(array, np.float64).tolist()

    return {
        "kind": curve.kind.value,
        "times": numbers(curve.times_s),
        "values": numbers(curve.values),
        "modes": np.asarray(curve.modes).tolist(),
        "inTangents": numbers(curve.in_tangents),
        "outTangents": numbers(curve.out_tangents),
        "inHandles": numbers(curve.in_handles),
        "outHandles": numbers(curve.out_handles),
        "types": None if curve.tangent_types is None else np.asarray(curve.tangent_types).tolist(),
        "before": curve.before.value,
        "after": curve.after.value,
    }


def made(answer: dict[str, Any], like: Curve) -> Curve:
    """The curve that the script answered."""
    count, width = len(answer["times"]), like.values.shape[1]

    def shaped(name: str, *shape: int) -> Any:
        return None if answer[name] is None else np.array(answer[name], float).reshape(count, *shape)

    return Curve(
        np.array(answer["times"]),
        shaped("values", width),
        np.array(answer["modes"], np.uint8),
        shaped("inTangents", width),
        shaped("outTangents", width),
        like.kind,
        Extrapolation(answer["before"]),
        Extrapolation(answer["after"]),
        shaped("inHandles", width, 2),
        shaped("outHandles", width, 2),
        None if answer["types"] is None else np.array(answer["types"], np.uint8).reshape(count, 2),
    )


def random_curve(
    rng: np.random.Generator,
    kind: CurveKind,
    modes: Any,
    before: Extrapolation = Extrapolation.HOLD,
    after: Extrapolation = Extrapolation.HOLD,
    count: int = 9,
    types: Any = None,
) -> Curve:
    width = KINDS[kind][0]
    times = np.cumsum(rng.uniform(0.05, 0.7, count)) - 0.6
    values = rng.normal(size=(count, width))
    if kind is CurveKind.ROTATION:
        values /= np.linalg.norm(values, axis=1, keepdims=True)
    if kind is CurveKind.BOOLEAN:
        values = np.round(rng.uniform(size=(count, 1)))
    # some longer than their spans; never both, where a curve stands upright in its middle and no digit is sure
    reach = rng.uniform(0, 0.9, (2, count, width)) * np.array([1.0, 0.04])[rng.permutation(2), None, None]
    handles = [np.stack([s * reach[n], rng.normal(size=(count, width))], -1) for n, s in ((0, -1), (1, 1))]
    no_handles = kind in (CurveKind.ROTATION, CurveKind.BOOLEAN)
    return Curve(
        times,
        values,
        modes,
        rng.normal(size=(count, width)),
        rng.normal(size=(count, width)),
        kind,
        before,
        after,
        None if no_handles else handles[0],
        None if no_handles else handles[1],
        types,
    )


def moments(curve: Curve) -> np.ndarray:
    first, last = curve.times_s[0], curve.times_s[-1]
    span = last - first
    return np.sort(np.concatenate([np.linspace(first - 2.3 * span, last + 2.3 * span, 151), curve.times_s]))


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.value)
def test_every_mode_and_extrapolation_is_pythons(program: Path, rng: np.random.Generator, kind: CurveKind) -> None:
    curves = [
        random_curve(rng, kind, mode, before, after, int(rng.integers(1, 8)))
        for mode, before, after in itertools.product(KINDS[kind][1], Extrapolation, Extrapolation)
    ]
    for _ in range(30):  # spans of all modes beside each other
        before, after = rng.choice(np.array(list(Extrapolation), object), 2)
        curves.append(random_curve(rng, kind, rng.choice([int(m) for m in KINDS[kind][1]], 9), before, after))
    questions = [{"curve": told(c), "times": moments(c).tolist()} for c in curves]
    for curve, answer in zip(curves, answers(program, *questions), strict=True):
        expected = evaluate.sample_curve(curve, moments(curve))
        assert np.allclose(answer["samples"], expected, rtol=1e-12, atol=1e-12), (
            curve.modes,
            curve.before,
            curve.after,
        )


def test_at_a_key_the_value_is_the_keys_own(program: Path, rng: np.random.Generator) -> None:
    for kind, (_, modes) in KINDS.items():
        curve = random_curve(rng, kind, modes[-1])
        (answer,) = answers(program, {"curve": told(curve), "times": curve.times_s.tolist()})
        assert np.array_equal(answer["samples"], curve.values)


def test_upright_handles_and_handles_of_no_length(program: Path) -> None:
    for dt0, dt1 in ((0.0, 0.0), (1.0, -1.0), (5.0, -5.0), (0.0, -1.0)):
        handles = np.zeros((2, 2, 1, 2))
        handles[0, 1, 0], handles[1, 0, 0] = (dt1, 0.7), (dt0, -1.3)
        curve = Curve(
            [0.0, 1.0],
            [[0.0], [2.0]],
            Interpolation.BEZIER,
            kind=CurveKind.SCALAR,
            in_handles=handles[0],
            out_handles=handles[1],
        )
        times = np.linspace(0.01, 0.99, 77)
        (answer,) = answers(program, {"curve": told(curve), "times": times.tolist()})
        # where the curve stands upright in the middle a value is as uncertain as the cube root of a rounding
        loose = 1e-4 if dt0 >= 1 else 1e-11
        assert np.allclose(answer["samples"], evaluate.sample_curve(curve, times), atol=loose)


@pytest.mark.parametrize("order", euler.CONVENTIONS)
def test_euler_angles_of_every_order_are_pythons(program: Path, rng: np.random.Generator, order: str) -> None:
    angles = np.concatenate([rng.uniform(-3, 3, (20, 3)), [[0.3, np.pi / 2, 0.2], [0.4, 0.0, 0.1], [0.0, np.pi, 0.5]]])
    (answer,) = answers(program, {"angles": angles.tolist(), "order": order})
    expected = euler.to_quat(angles, order)
    assert np.allclose([q for q, _ in answer], expected, atol=1e-14)
    assert np.allclose([back for _, back in answer], euler.from_quat(expected, order), atol=1e-7)


# ---- key operations --------------------------------------------------------------------------------------------------


def test_tangents_follow_their_types_as_in_python(program: Path, rng: np.random.Generator) -> None:
    curves = [
        random_curve(rng, kind, mode, count=count, types=rng.integers(0, 6, (count, 2)))
        for kind in (CurveKind.SCALAR, CurveKind.VECTOR)
        for mode in (Interpolation.HERMITE, Interpolation.BEZIER)
        for count in (1, 2, 3, 9)
        for _ in range(4)
    ]
    for curve, answer in zip(
        curves, answers(program, *({"curve": told(c), "operation": "refresh"} for c in curves)), strict=True
    ):
        got, expected = made(answer["curve"], curve), update_tangents(curve)
        for name in ("in_tangents", "out_tangents", "in_handles", "out_handles"):
            assert np.allclose(getattr(got, name), getattr(expected, name), rtol=1e-13, atol=1e-15), name


@pytest.mark.parametrize("mode", PLAIN)
def test_an_inserted_key_changes_nothing(program: Path, rng: np.random.Generator, mode: Interpolation) -> None:
    for kind, type_ in itertools.product((CurveKind.SCALAR, CurveKind.VECTOR), (Tangent.AUTO, Tangent.FREE)):
        curve = random_curve(rng, kind, mode, types=np.full((9, 2), type_))
        curve = update_tangents(curve)
        times = np.linspace(curve.times_s[0], curve.times_s[-1], 200)
        for time in rng.uniform(curve.times_s[0] + 0.01, curve.times_s[-1] - 0.01, 6):
            (answer,) = answers(
                program,
                {"curve": told(curve), "operation": "insert", "given": {"time": time}, "times": times.tolist()},
            )
            assert len(answer["curve"]["times"]) == 10 or mode is Interpolation.BEZIER
            assert answer["curve"]["times"][answer["indices"][0]] == time
            # a step is looked at beside its edges
            assert np.allclose(answer["samples"], evaluate.sample_curve(curve, times), atol=1e-9)
            # and the sides that keep the shape do so when tangents are brought up to date again
            again = update_tangents(made(answer["curve"], curve))
            assert np.allclose(evaluate.sample_curve(again, times), answer["samples"], atol=1e-9)


def one(program: Path, curve: Curve, operation: str, **given: Any) -> tuple[Curve, list[int]]:
    (answer,) = answers(program, {"curve": told(curve), "operation": operation, "given": given})
    return made(answer["curve"], curve), answer.get("indices", [])


def test_all_keys_moved_and_scaled_are_the_same_curve_elsewhere(program: Path, rng: np.random.Generator) -> None:
    for mode in PLAIN:
        curve = random_curve(rng, CurveKind.VECTOR, mode)
        for scale, shift in ((1, 0.7), (2.5, -1.0), (0.3, 0.2), (-1.0, 2.0)):
            transform = {"scaleTime": scale, "shiftTime": shift, "scaleValue": -1.5, "shiftValue": 0.25}
            moved, indices = one(program, curve, "transform", indices=list(range(9)), transform=transform)
            assert indices == list(range(9))
            inner = np.linspace(curve.times_s[0] + 1e-4, curve.times_s[-1] - 1e-4, 97)
            expected = -1.5 * evaluate.sample_curve(curve, inner) + 0.25
            if mode is Interpolation.STEP and scale < 0:
                continue  # a step turned round jumps at the other end of its span
            assert np.allclose(evaluate.sample_curve(moved, scale * inner + shift), expected, atol=1e-9)


def test_a_moved_key_that_lands_on_another_takes_its_place(program: Path) -> None:
    curve = Curve([0.0, 1.0, 2.0, 3.0], [[0.0], [1.0], [2.0], [3.0]], kind=CurveKind.SCALAR)
    moved, indices = one(program, curve, "transform", indices=[1], transform={**STILL, "shiftTime": 1.0})
    assert moved.times_s.tolist() == [0.0, 2.0, 3.0]
    assert moved.values[:, 0].tolist() == [0.0, 1.0, 3.0]
    assert indices == [1]
    passed, indices = one(program, curve, "transform", indices=[0, 1], transform={**STILL, "shiftTime": 2.5})
    assert passed.times_s.tolist() == [2.0, 2.5, 3.0, 3.5]
    assert passed.values[:, 0].tolist() == [2.0, 0.0, 3.0, 1.0]
    assert indices == [1, 3]
    squeezed, indices = one(
        program, curve, "transform", indices=[1, 2], transform={**STILL, "scaleTime": 0.0, "shiftTime": 1.5}
    )
    assert squeezed.times_s.tolist() == [0.0, 1.5, 3.0]
    assert squeezed.values[1, 0] == 2.0
    assert indices == [1]


def test_memory_of_a_picture_before_is_no_part_of_the_result(program: Path, rng: np.random.Generator) -> None:
    curve = random_curve(rng, CurveKind.VECTOR, Interpolation.BEZIER, types=np.full((9, 2), Tangent.CLAMPED))
    transforms = [
        {**STILL, "scaleTime": scale, "shiftTime": shift, "shiftValue": value}
        for scale, shift, value in rng.permutation(
            [[1, 0, 0.5], [1, 0.01, 0], [1, 1.1, 0.3], [-1, 2.0, 0], [1, 0, -0.5], [0, 1.0, 0], [0.5, 0, 0], [1, 0, 0]]
            * 3
        ).tolist()
    ]
    for count in range(1, len(transforms) + 1):
        fresh, places = one(program, curve, "transform", indices=[2, 3, 6], transform=transforms[count - 1])
        again, same = one(program, curve, "chain", indices=[2, 3, 6], transforms=transforms[:count])
        assert places == same
        for name in ("times_s", "values", "modes", "in_handles", "out_handles", "tangent_types"):
            assert np.array_equal(getattr(fresh, name), getattr(again, name)), name


def test_only_masked_components_move_and_rotations_stay_rotations(program: Path, rng: np.random.Generator) -> None:
    curve = random_curve(rng, CurveKind.VECTOR, Interpolation.LINEAR)
    moved, _ = one(program, curve, "transform", indices=[1, 4], transform={**STILL, "shiftValue": 2.0}, masks=[1, 6])
    change = moved.values - curve.values
    assert np.allclose(change[1], [2, 0, 0])
    assert np.allclose(change[4], [0, 2, 2])
    assert not np.any(change[[0, 2, 3, 5, 6, 7, 8]])
    turned = random_curve(rng, CurveKind.ROTATION, Interpolation.LINEAR)
    for shift in (0.1, 0.4, 5.0):
        moved, _ = one(program, turned, "transform", indices=[3], transform={**STILL, "shiftValue": shift}, masks=[4])
        assert np.isclose(np.linalg.norm(moved.values[3]), 1)
        assert np.isclose(moved.values[3, 2], min(1.0, turned.values[3, 2] + shift))


def test_retimed_duplicated_deleted_and_pasted(program: Path, rng: np.random.Generator) -> None:
    curve = random_curve(rng, CurveKind.VECTOR, Interpolation.BEZIER, types=np.full((9, 2), Tangent.AUTO))
    snapped, indices = one(program, curve, "retime", indices=list(range(9)), rate=100)
    assert len(indices) == 9
    assert np.allclose(snapped.times_s * 100, np.round(curve.times_s * 100))
    twice, indices = one(program, curve, "duplicate", indices=[0, 1, 2], shift=10.0)
    assert (twice.key_count, indices) == (12, [9, 10, 11])
    assert np.allclose(twice.values[9:], curve.values[:3])
    rest, _ = one(program, curve, "remove", indices=[0, 4, 8])
    assert np.array_equal(rest.times_s, curve.times_s[[1, 2, 3, 5, 6, 7]])
    assert np.array_equal(update_tangents(rest).in_handles, rest.in_handles)
    end = float(curve.times_s[-1])
    pasted, indices = one(program, curve, "paste", indices=[2, 3, 4], options={"at": end + 1})
    assert np.allclose(pasted.times_s[indices], curve.times_s[2:5] - curve.times_s[2] + end + 1)
    assert np.allclose(pasted.values[indices], curve.values[2:5])
    mirrored, indices = one(program, curve, "paste", indices=[2, 3, 4], options={"at": end + 1, "mirrored": True})
    assert np.allclose(mirrored.values[indices], curve.values[[4, 3, 2]])
    follows, indices = one(program, curve, "paste", indices=[2, 3, 4], options={"at": end + 1, "offset": True})
    assert np.allclose(follows.values[indices[0]], curve.values[-1])
    assert np.allclose(np.diff(follows.values[indices], axis=0), np.diff(curve.values[2:5], axis=0))


def test_hermite_becomes_bezier_exactly_and_back(program: Path, rng: np.random.Generator) -> None:
    curve = random_curve(rng, CurveKind.VECTOR, Interpolation.HERMITE)
    times = np.linspace(curve.times_s[0], curve.times_s[-1], 300)
    bezier, _ = one(program, curve, "mode", indices=list(range(9)), mode=int(Interpolation.BEZIER))
    assert np.allclose(evaluate.sample_curve(bezier, times), evaluate.sample_curve(curve, times), atol=1e-12)
    back, _ = one(program, bezier, "mode", indices=list(range(9)), mode=int(Interpolation.HERMITE))
    assert np.allclose(back.out_tangents[:-1], curve.out_tangents[:-1])
    straight = Curve(curve.times_s, curve.values, Interpolation.LINEAR, kind=CurveKind.VECTOR)
    soft, _ = one(program, straight, "mode", indices=[2], mode=int(Interpolation.BEZIER))
    assert soft.modes.tolist() == [1, 1, 3, 1, 1, 1, 1, 1, 1]
    assert soft.tangent_types[2, 1] == soft.tangent_types[3, 0] == Tangent.CLAMPED
    refused, _ = one(program, random_curve(rng, CurveKind.ROTATION, 1), "mode", indices=[2], mode=3)
    assert set(refused.modes.tolist()) == {1}


def test_handles_set_by_hand_keep_aligned_sides_in_line(program: Path, rng: np.random.Generator) -> None:
    curve = random_curve(rng, CurveKind.SCALAR, Interpolation.BEZIER, types=np.full((9, 2), Tangent.AUTO))
    curve = update_tangents(curve)
    bent, _ = one(program, curve, "handle", key=4, side=1, seconds=0.2, value=0.6)
    assert bent.tangent_types[4].tolist() == [Tangent.ALIGNED, Tangent.ALIGNED]
    assert np.allclose(bent.out_handles[4, 0], [0.2, 0.6])
    assert np.isclose(bent.in_handles[4, 0, 1] / bent.in_handles[4, 0, 0], 3.0)
    assert bent.in_handles[4, 0, 0] == curve.in_handles[4, 0, 0]
    upright, _ = one(program, bent, "handle", key=4, side=1, seconds=-0.3, value=0.5)
    assert np.allclose(upright.out_handles[4, 0], [0, 0.5])
    assert upright.in_handles[4, 0, 0] == 0
    assert upright.in_handles[4, 0, 1] < 0
    free, _ = one(program, curve, "type", indices=[4], type=int(Tangent.FREE))
    broken, _ = one(program, free, "handle", key=4, side=1, seconds=0.2, value=0.6)
    assert np.array_equal(broken.in_handles[4], curve.in_handles[4])


def test_an_ease_is_the_css_curve(program: Path) -> None:
    curve = Curve([1.0, 3.0], [[2.0], [6.0]], kind=CurveKind.SCALAR)
    eased, _ = one(program, curve, "ease", indices=[0], ease=[0.42, 0, 0.58, 1])
    u = np.linspace(0, 1, 41)
    x, y = (3 * (1 - u) ** 2 * u * a + 3 * (1 - u) * u**2 * b + u**3 for a, b in ((0.42, 0.58), (0.0, 1.0)))
    assert np.allclose(evaluate.sample_curve(eased, 1 + 2 * x)[:, 0], 2 + 4 * y)


def test_whatever_is_done_a_curve_stays_one(program: Path, rng: np.random.Generator) -> None:
    """Keys in order, arrays that fit, handles on their own sides: `Curve` refuses all else."""
    curves, questions = [], []
    for _ in range(400):
        kind = rng.choice(np.array(list(KINDS), object))
        allowed = [int(m) for m in KINDS[kind][1]]
        count = int(rng.integers(1, 12))
        types = rng.integers(0, 6, (count, 2)) if rng.random() < 0.7 else None
        curve = random_curve(rng, kind, rng.choice(allowed, count), count=count, types=types)
        indices = np.flatnonzero(rng.random(count) < 0.5)
        if len(indices) == 0:
            indices = np.array([0])
        first, last = curve.times_s[0], curve.times_s[-1]
        operation, given = [
            ("transform", {"transform": {**STILL, "scaleTime": float(rng.choice([1, -1, 0, 0.3, -2])),
                                         "shiftTime": float(rng.normal()), "shiftValue": float(rng.normal())}}),
            ("retime", {"rate": float(rng.choice([2, 5, 25]))}),
            ("duplicate", {"shift": float(rng.choice([0, 0.1, -3]))}),
            ("insert", {"time": float(rng.uniform(first - 0.5, last + 0.5))}),
            ("paste", {"options": {"at": float(rng.uniform(first, last)), "mirrored": bool(rng.random() < 0.5),
                                   "offset": bool(rng.random() < 0.5), "overwrite": bool(rng.random() < 0.5)}}),
            ("mode", {"mode": int(rng.integers(0, 7))}),
            ("type", {"type": int(rng.integers(0, 6))}),
            ("ease", {"ease": [0.36, 0, 0.66, -0.56]}),
            ("handle", {"key": int(indices[0]), "side": int(rng.integers(0, 2)), "seconds": float(rng.normal()), "value": 1.0}),
        ][int(rng.integers(0, 9))]  # fmt: skip
        curves.append(curve)
        questions.append(
            {"curve": told(curve), "operation": operation, "given": {"indices": indices.tolist(), **given}}
        )
    for curve, question, answer in zip(curves, questions, answers(program, *questions), strict=True):
        done = made(answer["curve"], curve)
        assert np.all(np.isfinite(done.values)), question
        places = answer.get("indices") or []
        assert all(0 <= k < done.key_count for k in places), question
        assert np.all(np.diff(places) > 0), question


# ---- as they travel --------------------------------------------------------------------------------------------------

TRAVEL = """
import { ClipAnimation, curveArrays } from "@/anim/animation";
import { Pose, Rig } from "@/anim/rig";
import { Arrays, unpack } from "@/net/container";

function answer({ bytes, times }) {
  const container = unpack(Uint8Array.from(atob(bytes), (c) => c.charCodeAt(0)).buffer);
  const { header } = container, arrays = new Arrays(container);
  const [character] = header.characters, [clip] = header.animations;
  const rig = new Rig(character.skeleton, arrays, [0, 0]);
  const bound = new ClipAnimation(clip, arrays, "s1", 0).bind(rig, ["blink", "smile"]);
  const pose = new Pose(rig.count, 2);
  const list = (a) => a && [...a];
  return {
    poses: times.map((time) => {
      bound.apply(time, pose);
      return [pose.translations, pose.rotations, pose.scales, pose.morphs].map(list);
    }),
    curves: clip.curves.map((c) => ({ ...curveArrays(c, arrays), target: c.target, property: c.property, component: c.component, types: c.types && list(arrays.uint8(c.types)) })).map(
      (c) => Object.fromEntries(Object.entries(c).map(([k, v]) => [k, ArrayBuffer.isView(v) ? [...v] : v])),
    ),
  };
}
"""


def test_a_clip_of_angles_and_single_components_moves_as_in_python(tmp_path: Path, rng: np.random.Generator) -> None:
    rest = Pose(rng.normal(size=(3, 3)), quat.normalize(rng.normal(size=(3, 4))), np.ones((3, 3)))
    skeleton = Skeleton(("root", "arm", "hand"), np.array([-1, 0, 1]), rest)
    bezier, kinds = Interpolation.BEZIER, CurveKind
    types = np.full((9, 2), Tangent.CLAMPED)
    curves = {
        Channel("root", Property.TRANSLATION, 1): random_curve(rng, kinds.SCALAR, bezier, types=types),
        Channel("root", Property.TRANSLATION): random_curve(rng, kinds.VECTOR, bezier),
        Channel("root", Property.EULER, 2): random_curve(rng, kinds.SCALAR, bezier),
        Channel("arm", Property.EULER): random_curve(rng, kinds.EULER, bezier, after=Extrapolation.CYCLE_OFFSET),
        Channel("arm", Property.EULER, 0): random_curve(rng, kinds.SCALAR, Interpolation.LINEAR),
        Channel("arm", Property.SCALE, 2): random_curve(rng, kinds.SCALAR, Interpolation.STEP),
        Channel("hand", Property.ROTATION): random_curve(rng, kinds.ROTATION, Interpolation.SQUAD),
        Channel("smile", Property.WEIGHT): random_curve(rng, kinds.SCALAR, Interpolation.HERMITE),
        Channel("lamp", Property.VALUE): random_curve(rng, kinds.COLOR, bezier),
    }
    clip = Clip(curves, "all", euler_orders={"arm": "zxy"})
    data = encode(Scene((Character(skeleton),), (clip,)), id="s1", name="all")
    times = np.linspace(-2, 8, 61)
    program = client_program(TRAVEL, tmp_path)
    (answer,) = answers(program, {"bytes": base64.b64encode(data).decode(), "times": times.tolist()})
    pose, morphs = evaluate.sample_clip(clip, skeleton, times), evaluate.sample_morphs(clip, ["blink", "smile"], times)
    for n, row in enumerate(answer["poses"]):
        for got, expected in zip(row, (pose.translations, pose.rotations, pose.scales, morphs), strict=True):
            assert np.allclose(got, np.asarray(expected)[n].ravel(), atol=1e-12)
    sent = {(c["target"], c["property"], c["component"]): c for c in answer["curves"]}
    for channel, curve in curves.items():
        own = sent[channel.target, channel.property.value, channel.component]
        assert own["kind"] == curve.kind.value
        for name, array in (("inHandles", curve.in_handles), ("types", curve.tangent_types)):
            assert own[name] == (None if array is None else np.asarray(array).ravel().tolist())
