"""Blending: means, masks, additive layers and differences."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from keypose.errors import ShapeError
from keypose.evaluate import add, blend, difference
from keypose.math import quat
from keypose.model import Pose
from tests.synthetic import as_type, random_pose


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def same(a: Pose, b: Pose, atol: float = 1e-12) -> None:
    assert_allclose(a.translations, b.translations, atol=atol)
    assert_allclose(a.scales, b.scales, atol=atol)
    assert_allclose(quat.angle_between(a.rotations, b.rotations), 0, atol=max(atol, 1e-7) if atol > 1e-10 else 1e-12)


def test_all_the_weight_on_one_pose_is_that_pose(rng: np.random.Generator) -> None:
    poses = [random_pose(rng, (2,), 4, scaled=True) for _ in range(3)]
    for n in range(3):
        same(blend(poses, np.eye(3)[n]), poses[n])
        same(blend(poses, 7 * np.eye(3)[n]), poses[n])


def test_two_poses_blend_as_lerp_and_nlerp(rng: np.random.Generator) -> None:
    a, b = random_pose(rng, (5,), 4, scaled=True), random_pose(rng, (5,), 4, scaled=True)
    half = blend([a, b], [1.0, 3.0])
    assert_allclose(half.translations, 0.25 * a.translations + 0.75 * b.translations, atol=1e-14)
    assert_allclose(half.scales, 0.25 * a.scales + 0.75 * b.scales, atol=1e-14)
    assert_allclose(quat.angle_between(half.rotations, quat.nlerp(a.rotations, b.rotations, 0.75)), 0, atol=1e-12)


def test_the_sign_of_a_quaternion_does_not_matter(rng: np.random.Generator) -> None:
    poses = [random_pose(rng, (), 6) for _ in range(3)]
    flipped = [poses[0], Pose(poses[1].translations, -poses[1].rotations, poses[1].scales), poses[2]]
    same(blend(poses, [0.2, 0.5, 0.3]), blend(flipped, [0.2, 0.5, 0.3]))


def test_blended_rotations_are_unit_even_for_opposite_ones() -> None:
    x, y, z = (quat.from_axis_angle(axis, np.pi) for axis in np.eye(3))
    poses = [Pose(np.zeros((1, 3)), q[None], np.ones((1, 3))) for q in (quat.identity(), x, y, z, -x, -quat.identity())]
    for weights in (np.ones(6), np.array([1, 1, 0, 0, 0, 0]), np.array([0, 0, 1, 1, 1, 0])):
        assert_allclose(np.linalg.norm(blend(poses, weights).rotations, axis=-1), 1, atol=1e-15)


def test_weights_and_poses_have_batches(rng: np.random.Generator) -> None:
    a, b = random_pose(rng, (3, 1), 4), random_pose(rng, (5,), 4)
    weights = rng.uniform(size=(3, 5, 2))
    mixed = blend([a, b], weights)
    assert mixed.batch_shape == (3, 5)
    same(mixed[1, 2], blend([a[1, 0], b[2]], weights[1, 2]))


def test_a_mask_limits_layers_to_joints(rng: np.random.Generator) -> None:
    base, wave = random_pose(rng, (), 4), random_pose(rng, (), 4)
    arm = blend([base, wave], [0.0, 1.0], mask=[0, 0, 1, 1])
    same(
        arm,
        Pose(
            *(
                np.concatenate([getattr(base, n)[:2], getattr(wave, n)[2:]])
                for n in ("translations", "rotations", "scales")
            )
        ),
    )
    each = blend([base, wave], [1.0, 1.0], mask=[[1, 1, 0, 0], [0, 1, 1, 0]])
    assert_allclose(each.translations[0], base.translations[0])
    assert_allclose(each.translations[1], (base.translations[1] + wave.translations[1]) / 2)
    assert_allclose(each.translations[2], wave.translations[2])
    assert_allclose(each.translations[3], base.translations[3])  # no weight at all: the first pose


def test_wrong_blends_are_refused(rng: np.random.Generator) -> None:
    a, b = random_pose(rng, (), 4), random_pose(rng, (), 5)
    for poses, weights, mask, message in (
        ([], [], None, "at least one pose"),
        ([a, b], [1, 1], None, "rotations: expected"),
        ([a, a], [1.0], None, "weights: expected"),
        ([a, a], [1, -1], None, "weights: expected finite numbers >= 0"),
        ([a, a], [1, np.nan], None, "weights: expected finite numbers >= 0"),
        ([a, a], [1, 1], [1, 1], "mask: expected"),
    ):
        with pytest.raises(ShapeError, match=message):
            blend(poses, weights, mask)


def test_adding_the_difference_gives_the_pose(rng: np.random.Generator) -> None:
    pose, reference = random_pose(rng, (2, 3), 4, scaled=True), random_pose(rng, (3,), 4, scaled=True)
    same(add(reference, difference(pose, reference)), pose)
    same(
        add(reference, difference(pose, reference), 0.0),
        Pose(
            *(
                np.broadcast_to(getattr(reference, n), (2, 3, 4, w))
                for n, w in (("translations", 3), ("rotations", 4), ("scales", 3))
            )
        ),
    )


def test_an_additive_layer_scales_the_angle_the_short_way(rng: np.random.Generator) -> None:
    pose = random_pose(rng, (), 2)
    turn = quat.from_axis_angle([0.0, 0.0, 1.0], 0.8)
    for sign in (1, -1):
        delta = Pose(np.full((2, 3), 2.0), np.stack([sign * turn, turn]), np.full((2, 3), 3.0))
        layered = add(pose, delta, -0.5, mask=[1, 0])
        expected = quat.multiply(pose.rotations[0], quat.from_axis_angle([0.0, 0.0, 1.0], -0.4))
        assert_allclose(quat.angle_between(layered.rotations[0], expected), 0, atol=1e-14)
        assert_allclose(layered.translations[0], pose.translations[0] - 1.0)
        assert_allclose(layered.scales[0], 0.0)
        same(Pose(*(getattr(layered, n)[1:] for n in ("translations", "rotations", "scales"))),
             Pose(*(getattr(pose, n)[1:] for n in ("translations", "rotations", "scales"))))  # fmt: skip


def test_weights_of_a_layer_along_time(rng: np.random.Generator) -> None:
    pose, delta = random_pose(rng, (6,), 3), random_pose(rng, (), 3)
    weights = np.linspace(0, 1, 6)
    layered = add(pose, delta, weights)
    for f in range(6):
        same(layered[f], add(pose[f], delta, weights[f]))


def test_a_zero_scale_has_no_ratio(rng: np.random.Generator) -> None:
    flat = Pose(np.zeros((1, 3)), quat.identity((1,)), [[1.0, 0.0, 2.0]])
    full = Pose(np.zeros((1, 3)), quat.identity((1,)), [[3.0, 4.0, 5.0]])
    assert_array_equal(difference(full, flat).scales, [[3.0, 1.0, 2.5]])


def test_precision_is_kept_whatever_the_weights_are(rng: np.random.Generator) -> None:
    a, b = (as_type(random_pose(rng, (2,), 3), np.float32) for _ in range(2))
    for pose in (blend([a, b], np.array([0.3, 0.7])), blend([a, b], [1, 2], mask=np.ones(3)), add(a, b, 0.5),
                 add(a, b, np.float64(0.25), mask=[1, 0, 1]), difference(a, b)):  # fmt: skip
        assert {str(x.dtype) for x in (pose.translations, pose.rotations, pose.scales)} == {"float32"}


def test_gradients_flow_through_blends_and_layers(rng: np.random.Generator) -> None:
    torch = pytest.importorskip("torch")
    a, b = (as_type(random_pose(rng, (2,), 3, scaled=True), torch.float64) for _ in range(2))
    rotations = [p.rotations.requires_grad_() for p in (a, b)]
    weights = torch.tensor([0.3, 0.7], dtype=torch.float64, requires_grad=True)

    def blended(qa: object, qb: object, w: object) -> object:
        poses = [Pose(a.translations, qa, a.scales), Pose(b.translations, qb, b.scales)]
        mixed = blend(poses, w, mask=[1.0, 0.5, 0.0])
        return mixed.translations, mixed.rotations, mixed.scales

    def layered(qa: object, qb: object, w: object) -> object:
        return add(Pose(a.translations, qa, a.scales), Pose(b.translations, qb, b.scales), w[0]).rotations

    assert torch.autograd.gradcheck(blended, [*rotations, weights])
    assert torch.autograd.gradcheck(layered, [*rotations, weights])
    plain = [Pose(*(t.detach().numpy() for t in (p.translations, p.rotations, p.scales))) for p in (a, b)]
    same(
        blend(plain, [0.3, 0.7]),
        Pose(
            *(t.detach().numpy() for t in (lambda p: (p.translations, p.rotations, p.scales))(blend([a, b], weights)))
        ),
    )
