"""Plain clips: what every format knows, as near as is said to Bezier handles, Euler angles, components and splines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import keypose.io
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import bake, is_plain, match, plain_clip, sample_clip, sample_curve, sample_value, unmatched
from keypose.math import quat
from keypose.model import (
    Channel,
    Character,
    Clip,
    Curve,
    CurveKind,
    Extrapolation,
    Pose,
    Property,
    Skeleton,
)
from tests.evaluate.test_evaluate_curves import BEZIER, HERMITE, LINEAR, SPHERE, STEP, TIMES, make
from tests.synthetic import random_skeleton

T, R, E, S, V = Property.TRANSLATION, Property.ROTATION, Property.EULER, Property.SCALE, Property.VALUE


@pytest.fixture
def skeleton() -> Skeleton:
    return random_skeleton(np.random.default_rng(3), 6, scaled=True)


def difference(a: Pose, b: Pose) -> float:
    """The largest distance of two poses: metres, radians, ratios."""
    return max(
        float(np.abs(a.translations - b.translations).max()),
        float(quat.angle_between(a.rotations, b.rotations).max()),
        float(np.abs(a.scales - b.scales).max()),
    )


# --- the new channels -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["XYZ", "ZXY", "zyx", "YXY"])
def test_euler_curves_are_scipys_rotations(skeleton: Skeleton, order: str) -> None:
    curve = make(CurveKind.EULER, BEZIER)
    clip = Clip({Channel("joint2", E): curve}, euler_orders={"joint2": order})
    times = np.linspace(-0.5, 3, 40)
    expected = Rotation.from_euler(order, sample_curve(curve, times)).as_quat(scalar_first=True)
    own = sample_clip(clip, skeleton, times).rotations[:, 2]
    assert_allclose(quat.angle_between(own, expected), 0, atol=1e-7)


def test_single_components_go_over_rest_and_over_whole_channels(skeleton: Skeleton) -> None:
    one = Curve([0.0, 1.0], [[2.0], [4.0]], kind=CurveKind.SCALAR)
    whole = Curve([0.0, 2.0], [[0.0, 0, 0], [2, 4, 6]])
    alone = sample_clip(Clip({Channel("joint1", T, 1): one}), skeleton, 0.5).translations[1]
    assert_allclose(alone, [skeleton.rest.translations[1, 0], 3, skeleton.rest.translations[1, 2]])
    # whatever the order in the clip
    over = Clip({Channel("joint1", T, 1): one, Channel("joint1", T): whole})
    assert_allclose(sample_clip(over, skeleton, 0.5).translations[1], [0.5, 3, 1.5])
    turned = sample_clip(Clip({Channel("joint1", E, 0): one}), skeleton, 0.5).rotations[1]
    _, y, z = Rotation.from_quat(skeleton.rest.rotations[1], scalar_first=True).as_euler("XYZ")
    expected = Rotation.from_euler("XYZ", [3.0, y, z]).as_quat(scalar_first=True)
    assert_allclose(quat.angle_between(turned, expected), 0, atol=1e-7)


def test_single_components_of_tensors_are_those_of_arrays(skeleton: Skeleton) -> None:
    torch = pytest.importorskip("torch")
    values = np.array([[2.0], [4.0]])

    def clip(array: object) -> Clip:
        one = Curve([0.0, 1.0], array, kind=CurveKind.SCALAR)
        return Clip(
            {
                Channel("joint1", T, 1): one,
                Channel("joint3", E, 2): one,
                Channel("joint3", T): make(CurveKind.VECTOR, LINEAR),
            }
        )

    plain, tensors = sample_clip(clip(values), skeleton, [0.3, 0.9]), torch.tensor(values, requires_grad=True)
    found = sample_clip(clip(tensors), skeleton, [0.3, 0.9])
    assert_allclose(found.translations.detach().numpy(), plain.translations, atol=1e-12)
    assert_allclose(found.rotations.detach().numpy(), plain.rotations, atol=1e-12)
    found.rotations.sum().backward()
    assert torch.any(tensors.grad != 0)


def test_a_joint_turns_one_way_only() -> None:
    with pytest.raises(ShapeError, match="joint 'arm': it has a rotation curve and Euler curves"):
        Clip(
            {Channel("arm", R): make(CurveKind.ROTATION, LINEAR), Channel("arm", E, 1): make(CurveKind.SCALAR, LINEAR)}
        )


def test_named_values_are_sampled_and_need_no_joint(skeleton: Skeleton) -> None:
    color, shown = make(CurveKind.COLOR, BEZIER), make(CurveKind.BOOLEAN, STEP)
    clip = Clip({Channel("lamp", V): color, Channel("hat", V): shown, Channel("lamp", V, 2): Curve([0.0], [[7.0]])})
    times = np.linspace(0, 3, 50)
    assert_array_equal(sample_value(clip, "hat", times), sample_curve(shown, times))
    lamp = sample_value(clip, "lamp", times)
    assert_allclose(lamp[:, [0, 1, 3]], sample_curve(color, times)[:, [0, 1, 3]])
    assert_array_equal(lamp[:, 2], 7.0)
    assert unmatched(clip, skeleton) == ()
    assert set(match(clip, skeleton).curves) == set(clip.curves)
    with pytest.raises(UnknownName, match="no value 'hut'; nearest: 'hat'"):
        sample_value(clip, "hut", 0)


def test_matching_keeps_components_and_orders() -> None:
    rest = Pose(np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.ones((1, 3)))
    one = Curve([0.0, 1.0], [[0.0], [1.0]], kind=CurveKind.SCALAR)
    clip = Clip({Channel("rig:Hips", E, 2): one}, euler_orders={"rig:Hips": "ZXY"})
    matched = match(clip, Skeleton(("hips",), [-1], rest))
    assert list(matched.curves) == [Channel("hips", E, 2)]
    assert matched.euler_orders == {"hips": "ZXY"}


# --- plain clips ------------------------------------------------------------------------------------------------------


def rich_clip() -> Clip:
    late = np.array([0.5, 1.7, 3.0])
    rotations = make(CurveKind.ROTATION, [SPHERE[2], STEP, LINEAR, HERMITE, STEP])
    return Clip(
        {
            Channel("joint0", T): make(CurveKind.VECTOR, BEZIER),
            Channel("joint0", R): make(CurveKind.ROTATION, SPHERE[1]),
            Channel("joint1", E): make(CurveKind.EULER, HERMITE, after=Extrapolation.CYCLE),
            Channel("joint2", R): make(CurveKind.ROTATION, SPHERE[0]),
            Channel("joint3", R): rotations,
            Channel("joint4", E, 1): make(CurveKind.SCALAR, LINEAR),
            Channel("joint4", T, 1): make(CurveKind.SCALAR, STEP),
            Channel("joint4", T, 2): make(CurveKind.SCALAR, LINEAR, times=late, before=Extrapolation.CYCLE),
            Channel("joint5", S, 0): make(CurveKind.SCALAR, HERMITE),
        },
        "rich",
        euler_orders={"joint1": "ZXY"},
    )  # fmt: skip


def test_a_plain_clip_is_as_near_as_it_says(skeleton: Skeleton) -> None:
    # Where long handles make a curve stand upright no cubic in time can follow; these are short.
    clip = rich_clip()
    rng = np.random.default_rng(8)
    handles = np.stack([np.full((5, 3), 0.01), rng.normal(size=(5, 3)) / 20], axis=-1)
    soft = Curve(TIMES, rng.normal(size=(5, 3)), BEZIER, in_handles=-handles[:, ::-1], out_handles=handles)
    clip = Clip({**clip.curves, Channel("joint0", T): soft}, "rich", euler_orders=clip.euler_orders)
    plain = plain_clip(clip, skeleton)
    assert is_plain(plain.clip)
    assert not is_plain(clip)
    assert plain.converted == 8
    assert plain.error <= 1e-5
    times = np.random.default_rng(0).uniform(0.1, 2.9, 5000)
    # Just before a jump a plain curve is already on its way.
    edges = np.concatenate([TIMES, [0.5, 1.7, 3.0]])
    times = times[np.min(np.abs(times[:, None] - edges), axis=1) > 1e-4]
    assert difference(sample_clip(plain.clip, skeleton, times), sample_clip(clip, skeleton, times)) < 3e-5
    keys = sample_clip(plain.clip, skeleton, TIMES[1:4])
    assert difference(keys, sample_clip(clip, skeleton, TIMES[1:4])) < 1e-6


def test_what_can_be_exact_is(skeleton: Skeleton) -> None:
    spans = np.diff(TIMES)
    smooth = make(CurveKind.VECTOR, HERMITE)
    out_s, in_s = np.append(spans, 1.0) / 3, np.insert(spans, 0, 1.0) / 3
    out = np.stack([np.repeat(out_s[:, None], 3, 1), out_s[:, None] * smooth.out_tangents], -1)
    back = np.stack([np.repeat(-in_s[:, None], 3, 1), -in_s[:, None] * smooth.in_tangents], -1)
    thirds = Curve(TIMES, smooth.values, BEZIER, in_handles=back, out_handles=out)
    parts = {Channel("joint1", S, c): make(CurveKind.SCALAR, HERMITE) for c in range(3)}
    plain = plain_clip(Clip({Channel("joint0", T): thirds, **parts}), skeleton)
    times = np.linspace(0, 3, 500)
    assert plain.error < 1e-13
    assert plain.clip.curve("joint0", T).key_count == len(TIMES)
    assert_allclose(
        sample_clip(plain.clip, skeleton, times).translations[:, 0], sample_curve(smooth, times), atol=1e-12
    )
    assert_allclose(
        sample_clip(plain.clip, skeleton, times).scales[:, 1], np.repeat(sample_curve(make(CurveKind.SCALAR, HERMITE), times), 3, 1),
        atol=1e-12,
    )  # fmt: skip


def test_plain_curves_stay_the_same_objects(skeleton: Skeleton) -> None:
    kept = make(CurveKind.ROTATION, HERMITE)
    clip = Clip({Channel("joint0", R): kept, Channel("joint1", T): make(CurveKind.VECTOR, BEZIER)})
    assert plain_clip(clip, skeleton).clip.curves[Channel("joint0", R)] is kept
    only = Clip({Channel("joint0", R): kept})
    assert plain_clip(only, skeleton).clip is only


def test_what_a_plain_clip_cannot_hold_is_noted(skeleton: Skeleton) -> None:
    clip = Clip(
        {
            Channel("lamp", V): make(CurveKind.COLOR, LINEAR),
            Channel("joint0", E): make(CurveKind.EULER, LINEAR, after=Extrapolation.CYCLE_OFFSET),
        },
        "walk",
    )
    plain = plain_clip(clip, skeleton)
    assert set(plain.clip.curves) == {Channel("joint0", R)}
    assert "clip 'walk': 1 named values, such as 'lamp', have no place" in plain.notes
    assert "clip 'walk': beyond its keys 'joint0.rotation' goes on in another way" in plain.notes
    with pytest.raises(ShapeError, match="tolerance: expected more than 0, got 0"):
        plain_clip(clip, skeleton, 0)


@pytest.mark.parametrize("suffix", [".glb", ".dae", ".bvh", ".npz", ".fbx"])
def test_saving_writes_what_the_clip_does(tmp_path: Path, skeleton: Skeleton, suffix: str) -> None:
    base = Skeleton(
        skeleton.names, skeleton.parents, Pose(skeleton.rest.translations, skeleton.rest.rotations, np.ones((6, 3)))
    )
    curves = {c: v for c, v in rich_clip().curves.items() if c.property in (R, E) and c.target != "joint3"}
    moves = {
        Channel("joint0", T): make(CurveKind.VECTOR, HERMITE),
        Channel("joint0", T, 1): make(CurveKind.SCALAR, LINEAR),
    }
    clip = Clip({**curves, **moves}, "rich", 100.0, {"joint1": "ZXY"})
    notes = keypose.io.save([Character(base), clip], tmp_path / f"rich{suffix}")
    assert any("Hermite keys" in note for note in notes)
    scene = keypose.io.load(tmp_path / f"rich{suffix}")
    own = scene.characters[0].skeleton if scene.characters else base
    found = scene.animations[0]
    start = found.start_s
    times = np.arange(int((TIMES[-1] - TIMES[0]) * 100)) / 100
    baked = bake(found, own, 100.0, start_s=start) if isinstance(found, Clip) else match(found, own)
    expected = sample_clip(clip, base, TIMES[0] + times)
    rows = [own.index(name) for name in base.names]
    angles = quat.angle_between(baked.pose.broadcast().rotations[: len(times), rows], expected.rotations)
    assert float(angles.max()) < 2e-3
