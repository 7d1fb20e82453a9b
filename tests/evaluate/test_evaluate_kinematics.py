"""Forward kinematics: hand-computed chains, products of matrices, shear, batches, precision, gradients."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from keypose.errors import ShapeError
from keypose.evaluate import compiled, local, world, world_rotations_positions
from keypose.math import quat, rigid
from keypose.model import Pose, Skeleton
from tests.conftest import ROOT
from tests.synthetic import as_type, chain, random_pose, random_rotations, random_skeleton

X, Y, Z = np.eye(3)


def test_two_bones_by_hand() -> None:
    """The notes' P = R0 (R1 (O2) + O1) + O0 with quarter turns."""
    rest = Pose([[0, 1, 0], [2, 0, 0], [3, 0, 0]], quat.identity((3,)), np.ones((3, 3)))
    arm = Skeleton(("root", "elbow", "hand"), [-1, 0, 1], rest)
    turns = np.stack([quat.from_axis_angle(Z, np.pi / 2), quat.from_axis_angle(Y, np.pi / 2), quat.identity()])
    # elbow: (2,0,0) turned about Z is (0,2,0), plus the root; hand: (3,0,0) about Y is (0,0,-3), about Z the same.
    positions = world(arm, Pose(rest.translations, turns, rest.scales))[:, :3, 3]
    assert_allclose(positions, [[0, 1, 0], [0, 3, 0], [0, 3, -3]], atol=1e-15)


def test_a_parents_scale_moves_and_shears_its_children() -> None:
    rest = Pose([[0, 0, 0], [1, 1, 0]], [quat.identity(), quat.from_axis_angle(Z, np.pi / 4)], [[2, 1, 1], [1, 1, 1]])
    skeleton = Skeleton(("a", "b"), [-1, 0], rest)
    child = world(skeleton, rest)[1]
    assert_allclose(child[:3, 3], [2, 1, 0])
    h = np.sqrt(0.5)
    assert_allclose(child[:3, :3], [[2 * h, -2 * h, 0], [h, h, 0], [0, 0, 1]], atol=1e-15)
    assert abs(child[:3, 0] @ child[:3, 1]) > 1  # the axes are no longer perpendicular: shear


@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize(("joints", "roots"), [(1, 1), (2, 1), (30, 1), (30, 4), (5, 5)])
def test_it_is_the_product_of_the_matrices(joints: int, roots: int, scaled: bool) -> None:
    rng = np.random.default_rng(joints)
    skeleton = random_skeleton(rng, joints, roots=roots, scaled=scaled)
    pose = random_pose(rng, (), joints, scaled=scaled)
    assert_allclose(world(skeleton, pose), chain(skeleton, pose), atol=1e-12)


def test_a_chain_of_500_joints() -> None:
    rng = np.random.default_rng(0)
    pose = random_pose(rng, (), 500)
    rope = Skeleton(tuple(map(str, range(500))), np.arange(-1, 499), pose)
    assert_allclose(world(rope, pose), chain(rope, pose), atol=1e-11)


@pytest.mark.parametrize("batch", [(), (1,), (3,), (2, 3), (0,), (2, 1, 0)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_batches_of_any_shape(batch: tuple[int, ...], dtype: type) -> None:
    rng = np.random.default_rng(2)
    skeleton = random_skeleton(rng, 12)
    pose = as_type(random_pose(rng, batch, 12, scaled=True), dtype)
    result = world(skeleton, pose)
    assert result.shape == (*batch, 12, 4, 4)
    assert result.dtype == dtype
    rotations, positions = world_rotations_positions(skeleton, pose)
    assert rotations.shape == (*batch, 12, 4)
    assert positions.shape == (*batch, 12, 3)
    assert rotations.dtype == positions.dtype == dtype
    for index in np.ndindex(batch):
        assert_allclose(result[index], chain(skeleton, pose[index]), atol=1e-4 if dtype is np.float32 else 1e-12)


def test_parts_of_a_pose_may_have_different_batches() -> None:
    rng = np.random.default_rng(3)
    skeleton = random_skeleton(rng, 9)
    turning = Pose(skeleton.rest.translations, random_rotations(rng, 6, 9), np.ones((9, 3)))
    assert_allclose(world(skeleton, turning), world(skeleton, turning.broadcast()), atol=0)
    moving = Pose(rng.normal(size=(4, 1, 9, 3)), random_rotations(rng, 6, 9), np.ones((9, 3)))
    assert world(skeleton, moving).shape == (4, 6, 9, 4, 4)
    for a, b in zip(
        world_rotations_positions(skeleton, moving),
        world_rotations_positions(skeleton, moving.broadcast()),
        strict=True,
    ):
        assert_allclose(a, b, atol=1e-14)


@pytest.mark.parametrize("scaled", [False, True])
def test_rotations_and_positions_are_those_of_the_matrices(scaled: bool) -> None:
    rng = np.random.default_rng(4)
    skeleton = random_skeleton(rng, 25)
    pose = random_pose(rng, (7,), 25, scaled=scaled)
    rotations, positions = world_rotations_positions(skeleton, pose)
    assert_allclose(positions, world(skeleton, pose)[..., :3, 3], atol=1e-12)
    unscaled = Pose(pose.translations, pose.rotations, np.ones((25, 3)))
    assert_allclose(quat.to_matrix(rotations), world(skeleton, unscaled)[..., :3, :3], atol=1e-12)


def test_moving_the_root_moves_everything_rigidly() -> None:
    rng = np.random.default_rng(5)
    skeleton = random_skeleton(rng, 20)
    pose = random_pose(rng, (), 20, scaled=True)
    r, t = random_rotations(rng), rng.normal(size=3)
    translations, rotations = pose.translations.copy(), pose.rotations.copy()
    translations[0], rotations[0] = quat.rotate(r, translations[0]) + t, quat.multiply(r, rotations[0])
    moved = world(skeleton, Pose(translations, rotations, pose.scales))
    assert_allclose(moved, rigid.from_trs(t, r) @ world(skeleton, pose), atol=1e-12)


def test_local_is_the_inverse_of_world() -> None:
    rng = np.random.default_rng(6)
    skeleton = random_skeleton(rng, 20, roots=2)
    pose = random_pose(rng, (3,), 20, scaled=True)
    assert_allclose(
        local(skeleton, world(skeleton, pose)),
        rigid.from_trs(pose.translations, pose.rotations, pose.scales),
        atol=1e-11,
    )


def test_the_wrong_number_of_joints_is_named() -> None:
    rng = np.random.default_rng(7)
    skeleton = random_skeleton(rng, 5)
    with pytest.raises(ShapeError, match=r"rotations: expected \(\*B, 5, 4\) to match the skeleton's 5 joints"):
        world(skeleton, random_pose(rng, (), 4))
    with pytest.raises(ShapeError, match="model_from_joint"):
        local(skeleton, np.zeros((4, 4, 4)))


@pytest.mark.parametrize("path", ["numpy", "kernels"])
@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-12), (np.float32, 2e-4)])
def test_both_paths_give_what_one_frame_gives(
    monkeypatch: pytest.MonkeyPatch, path: str, scaled: bool, dtype: type, tolerance: float
) -> None:
    for limit in ("_LOADED", "_NOT_LOADED"):
        monkeypatch.setattr(compiled, limit, 0 if path == "kernels" else 10**18)
    rng = np.random.default_rng(8)
    skeleton = random_skeleton(rng, 40)
    for pose in (random_pose(rng, (3, 7), 40, scaled=scaled), random_pose(rng, (), 40, scaled=scaled)):
        batch = pose.batch_shape
        parts = as_type(Pose(pose.translations[(0,) * len(batch)], pose.rotations, pose.scales), dtype)
        full = as_type(pose, dtype)
        for typed in (full, parts, Pose(full.translations, full.rotations, full.scales[(0,) * len(batch)])):
            result = world(skeleton, typed)
            rotations, positions = world_rotations_positions(skeleton, typed)
            assert result.dtype == rotations.dtype == positions.dtype == dtype
            assert (result.shape, rotations.shape) == ((*batch, 40, 4, 4), (*batch, 40, 4))
            assert_allclose(positions, result[..., :3, 3], atol=tolerance)
            for index in np.ndindex(batch):
                one = Pose(*(np.asarray(a, float) for a in vars_of(typed[index])))
                assert_allclose(result[index], chain(skeleton, one), atol=tolerance)
                plain = Pose(one.translations, one.rotations, np.ones((40, 3)))
                assert_allclose(quat.to_matrix(rotations[index]), chain(skeleton, plain)[:, :3, :3], atol=tolerance)


def vars_of(pose: Pose) -> tuple[object, object, object]:
    return pose.translations, pose.rotations, pose.scales


def test_few_frames_do_not_load_the_compiler() -> None:
    script = (
        "import sys, numpy as np; from tests.synthetic import random_pose, random_skeleton;"
        "from keypose.evaluate import world; rng = np.random.default_rng(0); s = random_skeleton(rng, 60);"
        "world(s, random_pose(rng, (100,), 60)); print('numba' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    assert run.stdout.strip() == "False"


def test_pymotion_agrees() -> None:
    skeleton_ops = pytest.importorskip("pymotion.ops.skeleton")
    rng = np.random.default_rng(9)
    skeleton = random_skeleton(rng, 20)
    offsets = skeleton.rest.translations.copy()
    rotations, roots = random_rotations(rng, 11, 20), rng.normal(size=(11, 3))
    translations = np.broadcast_to(offsets, (11, 20, 3)).copy()
    translations[:, 0] = roots
    offsets[0] = 0
    parents = skeleton.parents.copy()
    parents[0] = 0
    expected, _ = skeleton_ops.fk(rotations, roots, offsets, parents)
    _, positions = world_rotations_positions(skeleton, Pose(translations, rotations, np.ones((20, 3))))
    assert_allclose(positions, expected, atol=2e-6)  # it computes in float32


@pytest.mark.parametrize("scaled", [False, True])
def test_torch_agrees_and_gradients_are_those_of_finite_differences(scaled: bool) -> None:
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(10)
    skeleton = random_skeleton(rng, 6, roots=2)
    pose = random_pose(rng, (2,), 6, scaled=scaled)
    tensors = as_type(pose, torch.float64)
    assert_allclose(world(skeleton, tensors).numpy(), world(skeleton, pose), atol=1e-13)
    assert world(skeleton, as_type(pose, torch.float32)).dtype == torch.float32
    inputs = [a.requires_grad_() for a in (tensors.translations, tensors.rotations, tensors.scales)]
    assert torch.autograd.gradcheck(lambda *a: world(skeleton, Pose(*a)), inputs)
    assert torch.autograd.gradcheck(lambda *a: world_rotations_positions(skeleton, Pose(*a)), inputs)
    assert torch.autograd.gradcheck(lambda m: local(skeleton, m), world(skeleton, tensors).detach().requires_grad_())


def test_constant_numpy_parts_follow_torch_rotations() -> None:
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(11)
    skeleton = random_skeleton(rng, 5)
    rotations = torch.tensor(random_rotations(rng, 3, 5), requires_grad=True)
    pose = Pose(skeleton.rest.translations, rotations, skeleton.rest.scales)
    world(skeleton, pose)[..., :3, 3].square().sum().backward()
    assert float(rotations.grad.abs().max()) > 0
    assert_array_equal(world(skeleton, pose).detach().numpy().shape, (3, 5, 4, 4))
