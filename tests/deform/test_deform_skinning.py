"""Skinning: definitions, invariances, twists, normals, gradients, real bind poses."""

from __future__ import annotations

import gc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from keypose import deform
from keypose.deform import compiled
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import compiled as evaluate_compiled
from keypose.evaluate import world
from keypose.math import dualquat, quat, rigid
from keypose.model import Character, Mesh, Part, Pose, Skeleton, Skin, SkinningMethod
from tests.conftest import data_files
from tests.synthetic import as_type, random_mesh, random_pose, random_rotations, random_skeleton, random_skin

METHODS = tuple(SkinningMethod)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def rigid_matrices(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rigid.from_trs(rng.normal(size=(*shape, 3)), random_rotations(rng, *shape))


def affine_matrix(rng: np.random.Generator, determinant_sign: int = 1) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3] = rng.normal(size=(3, 4))
    if np.sign(np.linalg.det(matrix[:3, :3])) != determinant_sign:
        matrix[:3, 0] *= -1
    return matrix


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-12), (np.float32, 1e-6)])
@pytest.mark.parametrize("influences", [1, 3, 4, 9])
def test_the_bind_pose_reproduces_the_mesh(
    rng: np.random.Generator, method: str, dtype: type, tolerance: float, influences: int
) -> None:
    skeleton, mesh = random_skeleton(rng, 12), random_mesh(rng, 200)
    binding = random_skin(rng, skeleton, 200, influences)
    bind = world(skeleton, skeleton.rest)
    # The inverse bind matrices are stored in the precision of a file; what they undo is computed from them.
    matrices = binding.joint_from_mesh.astype(dtype)
    binding = Skin(binding.palette, matrices, binding.joints, binding.weights.astype(dtype))
    mesh = Mesh(mesh.positions.astype(dtype), mesh.triangles, mesh.normals.astype(dtype))
    positions, normals = deform.skin(mesh, binding, bind.astype(dtype), method, with_normals=True)
    assert positions.dtype == normals.dtype == dtype
    assert_allclose(positions, mesh.positions, atol=tolerance * 5)
    assert_allclose(normals, mesh.normals, atol=tolerance * 5)


def test_linear_blending_is_the_weighted_sum_of_the_joints_motions(rng: np.random.Generator) -> None:
    skeleton, mesh = random_skeleton(rng, 10), random_mesh(rng, 40)
    binding = random_skin(rng, skeleton, 40, 5)
    model_from_joint = world(skeleton, random_pose(rng, (), 10, scaled=True))
    expected = np.zeros((40, 3))
    for v in range(40):
        for joint, weight in zip(binding.joints[v], binding.weights[v], strict=True):
            matrix = model_from_joint[binding.palette[joint]] @ binding.joint_from_mesh[joint]
            expected[v] += weight * (matrix[:3, :3] @ mesh.positions[v] + matrix[:3, 3])
    assert_allclose(deform.skin(mesh, binding, model_from_joint), expected, atol=1e-13)


def test_the_palette_may_be_any_selection_of_the_joints(rng: np.random.Generator) -> None:
    skeleton, mesh = random_skeleton(rng, 10), random_mesh(rng, 30)
    full = random_skin(rng, skeleton, 30, 4)
    order = rng.permutation(10)
    back = np.argsort(order)
    shuffled = Skin(full.palette[order], full.joint_from_mesh[order], back[full.joints], full.weights)
    model_from_joint = world(skeleton, random_pose(rng, (), 10))
    for method in METHODS:
        assert_allclose(
            deform.skin(mesh, shuffled, model_from_joint, method), deform.skin(mesh, full, model_from_joint, method),
            atol=1e-13,
        )  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("sign", [1, -1])
def test_weights_sum_to_one_so_one_motion_of_all_joints_moves_all_vertices(
    rng: np.random.Generator, method: str, sign: int
) -> None:
    """Partition of unity, with scale, shear and mirroring."""
    skeleton, mesh = random_skeleton(rng, 8), random_mesh(rng, 50)
    binding = random_skin(rng, skeleton, 50, 4)
    motion = affine_matrix(rng, sign)
    together = motion @ np.linalg.inv(binding.joint_from_mesh)
    expected = mesh.positions @ motion[:3, :3].T + motion[:3, 3]
    assert_allclose(deform.skin(mesh, binding, together, method), expected, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("scaled", [False, True])
def test_moving_the_whole_character_moves_its_skin(rng: np.random.Generator, method: str, scaled: bool) -> None:
    skeleton, mesh = random_skeleton(rng, 8), random_mesh(rng, 50)
    binding = random_skin(rng, skeleton, 50, 4)
    model_from_joint = world(skeleton, random_pose(rng, (), 8, scaled=scaled))
    motion = rigid_matrices(rng)
    before = deform.skin(mesh, binding, model_from_joint, method, with_normals=True)
    after = deform.skin(mesh, binding, motion @ model_from_joint, method, with_normals=True)
    assert_allclose(after[0], rigid.transform_points(motion, before[0]), atol=1e-11)
    assert_allclose(after[1], rigid.transform_vectors(motion, before[1]), atol=1e-11)


@pytest.mark.parametrize("method", METHODS)
def test_one_influence_is_rigid_binding_even_under_shear(rng: np.random.Generator, method: str) -> None:
    mesh = random_mesh(rng, 30)
    motions = np.stack([affine_matrix(rng), affine_matrix(rng, -1)])
    binding = Skin([0, 1], np.tile(np.eye(4), (2, 1, 1)), rng.integers(0, 2, (30, 1)), np.ones((30, 1)))
    expected = np.einsum("vij,vj->vi", motions[binding.joints[:, 0], :3, :3], mesh.positions)
    expected += motions[binding.joints[:, 0], :3, 3]
    assert_allclose(deform.skin(mesh, binding, motions, method), expected, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_order_and_empty_influences_do_not_matter(rng: np.random.Generator, method: str) -> None:
    skeleton, mesh = random_skeleton(rng, 8), random_mesh(rng, 50)
    binding = random_skin(rng, skeleton, 50, 4)
    model_from_joint = world(skeleton, random_pose(rng, (), 8))
    padded = Skin(
        binding.palette,
        binding.joint_from_mesh,
        np.hstack([rng.integers(0, 8, (50, 3)), binding.joints[:, ::-1]]),
        np.hstack([np.zeros((50, 3)), binding.weights[:, ::-1]]),
    )
    a, b = (deform.skin(mesh, s, model_from_joint, method, with_normals=True) for s in (binding, padded))
    assert_allclose(a[0], b[0], atol=1e-13)
    assert_allclose(a[1], b[1], atol=1e-13)


# --- twists: what dual quaternions are for ----------------------------------------------------------------------------


def tube_twisted_by(angle: float) -> tuple[Mesh, Skin, np.ndarray]:
    """A ring of radius 1 about X, half bound to a still joint, half to one that turns about X."""
    turns = np.linspace(0, 2 * np.pi, 33)[:-1]
    ring = np.stack([0 * turns, np.cos(turns), np.sin(turns)], axis=-1)
    mesh = Mesh(ring, np.zeros((0, 3), int), ring)
    binding = Skin([0, 1], np.tile(np.eye(4), (2, 1, 1)), np.tile([0, 1], (32, 1)), np.full((32, 2), 0.5))
    twist = quat.from_axis_angle([1.0, 0.0, 0.0], angle)
    return mesh, binding, rigid.from_trs(np.zeros((2, 3)), np.stack([quat.identity(), twist]))


@pytest.mark.parametrize("angle", np.radians([0, 10, 90, 150, 179, -179, 90 + 360]))
def test_dual_quaternions_keep_the_radius_of_a_twist_where_linear_blending_loses_it(angle: float) -> None:
    mesh, binding, model_from_joint = tube_twisted_by(angle)
    linear = np.linalg.norm(deform.skin(mesh, binding, model_from_joint), axis=1)
    short = np.arctan2(np.sin(angle), np.cos(angle))
    assert_allclose(linear, np.cos(short / 2), atol=1e-14)  # the candy wrapper: nothing is left at half a turn
    moved, normals = deform.skin(mesh, binding, model_from_joint, "dual_quaternion", with_normals=True)
    halfway = Rotation.from_rotvec([short / 2, 0, 0]).apply(np.array(mesh.positions))
    assert_allclose(moved, halfway, atol=1e-14)
    assert_allclose(normals, halfway, atol=1e-14)


def test_dual_quaternion_skinning_is_the_blend_of_dual_quaternions(rng: np.random.Generator) -> None:
    """Kavan et al. 2007, for rigid joints, against the general blend of `keypose.math`."""
    skeleton, mesh = random_skeleton(rng, 9), random_mesh(rng, 60)
    binding = random_skin(rng, skeleton, 60, 4)
    matrices = deform.skin_matrices(binding, world(skeleton, random_pose(rng, (5,), 9)))
    translations, rotations, _ = rigid.to_trs(matrices)
    motions = dualquat.from_rigid(rotations, translations)[:, binding.joints]
    expected = dualquat.transform_points(dualquat.blend(motions, binding.weights), mesh.positions)
    moved, _ = deform.skin_points(mesh.positions, None, binding, matrices, "dual_quaternion")
    assert_allclose(moved, expected, atol=1e-12)


def test_a_skin_is_skinned_by_its_own_method_unless_another_is_asked_for(rng: np.random.Generator) -> None:
    skeleton, mesh = random_skeleton(rng, 9), random_mesh(rng, 50)
    linear = random_skin(rng, skeleton, 50, 4)
    dual = replace(linear, method=SkinningMethod.DUAL_QUATERNION)
    assert linear.method is SkinningMethod.LINEAR
    assert replace(linear, method="dual_quaternion").method is SkinningMethod.DUAL_QUATERNION
    at = world(skeleton, random_pose(rng, (2,), 9))
    by_method = {m: deform.skin(mesh, linear, at, m) for m in SkinningMethod}
    assert np.abs(by_method[SkinningMethod.LINEAR] - by_method[SkinningMethod.DUAL_QUATERNION]).max() > 1e-3
    for skin in (linear, dual):
        character = Character(skeleton, (Part("a", mesh, skin=skin),))
        assert_allclose(deform.skin(mesh, skin, at), by_method[skin.method], atol=1e-12)
        assert_allclose(deform.deform_part(character, character.parts[0], at), by_method[skin.method], atol=1e-12)
        assert_allclose(deform.deform_character(character, at, method="linear")[0], by_method["linear"], atol=1e-12)
        assert deform.pack(skin, influences=2)[0].method is skin.method
    with pytest.raises(UnknownName, match="no skinning method 'dual'; known: 'linear', 'dual_quaternion'"):
        replace(linear, method="dual")


def test_the_dual_quaternion_blend_of_two_joints_is_a_rigid_motion(rng: np.random.Generator) -> None:
    mesh = random_mesh(rng, 30)
    for _ in range(20):
        binding = Skin([0, 1], np.tile(np.eye(4), (2, 1, 1)), np.tile([0, 1], (30, 1)), np.tile([0.3, 0.7], (30, 1)))
        moved = deform.skin(mesh, binding, rigid_matrices(rng, 2), "dual_quaternion")
        before = np.linalg.norm(mesh.positions[:, None] - mesh.positions, axis=-1)
        assert_allclose(np.linalg.norm(moved[:, None] - moved, axis=-1), before, atol=1e-12)


# --- normals ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("sign", [1, -1])
def test_normals_stay_normal_and_outside_under_any_matrix(rng: np.random.Generator, method: str, sign: int) -> None:
    """A sphere under an affine map is an ellipsoid; its normals are known."""
    directions = random_mesh(rng, 100).normals
    sphere = Mesh(directions, np.zeros((0, 3), int), directions)
    binding = Skin([0], np.eye(4)[None], np.zeros((100, 1), int), np.ones((100, 1)))
    for _ in range(5):
        matrix = affine_matrix(rng, sign)
        positions, normals = deform.skin(sphere, binding, matrix[None], method, with_normals=True)
        inverse = np.linalg.inv(matrix[:3, :3])
        expected = directions @ inverse
        assert_allclose(normals, expected / np.linalg.norm(expected, axis=1, keepdims=True), atol=1e-9)
        assert np.all(np.sum(normals * (positions - matrix[:3, 3]), axis=1) > 0)
        assert_allclose(deform.transform_normals(matrix, directions), normals, atol=1e-9)


def test_a_flattened_mesh_has_the_normals_of_its_plane() -> None:
    flat = rigid.from_trs([1.0, 2, 3], quat.identity(), [1.0, 0.0, 1.0])
    normals = deform.transform_normals(flat, np.array([[0.6, 0.8, 0.0], [0, 1.0, 0]]))
    assert_allclose(normals, [[0, 1, 0], [0, 1, 0]])
    assert np.all(np.isfinite(deform.transform_normals(np.zeros((4, 4)), np.eye(3))))


def test_blended_normals_are_unit(rng: np.random.Generator) -> None:
    skeleton, mesh = random_skeleton(rng, 8), random_mesh(rng, 50)
    binding = random_skin(rng, skeleton, 50, 4)
    for method in METHODS:
        _, normals = deform.skin(mesh, binding, world(skeleton, random_pose(rng, (3,), 8)), method, with_normals=True)
        assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-12)


# --- shapes, errors, gradients ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("batch", [(), (1,), (4,), (2, 3), (0,)])
def test_batches_of_any_shape(rng: np.random.Generator, method: str, batch: tuple[int, ...]) -> None:
    skeleton, mesh = random_skeleton(rng, 6), random_mesh(rng, 20)
    binding = random_skin(rng, skeleton, 20, 3)
    model_from_joint = world(skeleton, random_pose(rng, batch, 6, scaled=True))
    positions, normals = deform.skin(mesh, binding, model_from_joint, method, with_normals=True)
    assert positions.shape == normals.shape == (*batch, 20, 3)
    for index in np.ndindex(batch):
        alone = deform.skin(mesh, binding, model_from_joint[index], method, with_normals=True)
        assert_allclose(positions[index], alone[0], atol=1e-13)
        assert_allclose(normals[index], alone[1], atol=1e-13)


@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-12), (np.float32, 3e-5)])
def test_the_compiled_path_gives_what_numpy_gives(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, dtype: type, tolerance: float, scaled: bool
) -> None:
    skeleton, mesh = random_skeleton(rng, 30), random_mesh(rng, 500)
    full = random_skin(rng, skeleton, 500, 5)
    binding = Skin(full.palette, full.joint_from_mesh.astype(dtype), full.joints, full.weights.astype(dtype))
    mesh = Mesh(mesh.positions.astype(dtype), mesh.triangles, mesh.normals.astype(dtype))
    model_from_joint = world(skeleton, random_pose(rng, (3, 4), 30, scaled=scaled))

    def skinned(limit: int, matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        monkeypatch.setattr(evaluate_compiled, "_LOADED", limit)
        monkeypatch.setattr(evaluate_compiled, "_NOT_LOADED", limit)
        positions, normals = deform.skin(mesh, binding, matrices.astype(dtype), with_normals=True)
        assert positions.dtype == normals.dtype == dtype
        assert_allclose(positions, deform.skin(mesh, binding, matrices.astype(dtype)), atol=tolerance)
        return positions, normals

    plain = skinned(10**18, model_from_joint)
    fast = skinned(0, model_from_joint)
    alone = skinned(0, model_from_joint[1, 2])  # compiled by now: a single frame takes the same path
    for own, expected, one in zip(fast, plain, alone, strict=True):
        assert own.shape == (3, 4, 500, 3)
        assert_allclose(own, expected, atol=tolerance * (100 if own is fast[1] and dtype is np.float32 else 1))
        assert_allclose(one, own[1, 2], atol=tolerance)


def test_compiled_meshes_are_forgotten_with_their_arrays(rng: np.random.Generator) -> None:
    skeleton, mesh = random_skeleton(rng, 5), random_mesh(rng, 50)
    binding = random_skin(rng, skeleton, 50, 3)
    model_from_joint = world(skeleton, random_pose(rng, (9,), 5))
    gc.collect()
    before = len(compiled._uses)
    deform.skin(mesh, binding, model_from_joint)
    assert len(compiled._uses) == before + 1
    del mesh
    gc.collect()
    assert len(compiled._uses) == before


def test_writable_positions_are_never_taken_from_the_cache(rng: np.random.Generator) -> None:
    skeleton, mesh = random_skeleton(rng, 5), random_mesh(rng, 50)
    binding = random_skin(rng, skeleton, 50, 3)
    matrices = deform.skin_matrices(binding, world(skeleton, random_pose(rng, (9,), 5)))
    positions = np.array(mesh.positions)
    first, _ = deform.skin_points(positions, None, binding, matrices)
    positions += 1.0
    second, _ = deform.skin_points(positions, None, binding, matrices)
    assert np.abs(second - first).max() > 0.1


def test_what_does_not_fit_is_refused(rng: np.random.Generator) -> None:
    skeleton, mesh = random_skeleton(rng, 6), random_mesh(rng, 20)
    binding = random_skin(rng, skeleton, 20, 3)
    bind = world(skeleton, skeleton.rest)
    with pytest.raises(ShapeError, match="the skin uses joint 5, there are 4"):
        deform.skin(mesh, binding, bind[:4])
    with pytest.raises(ShapeError, match="skin: expected"):
        deform.skin(random_mesh(rng, 21), binding, bind)
    with pytest.raises(ShapeError, match="normals: the mesh has none"):
        deform.skin(Mesh(mesh.positions, mesh.triangles), binding, bind, with_normals=True)
    with pytest.raises(UnknownName, match="no skinning method 'dual_quat'; nearest: 'dual_quaternion'"):
        deform.skin(mesh, binding, bind, "dual_quat")
    none = Skin(binding.palette, binding.joint_from_mesh, np.zeros((20, 0), int), np.zeros((20, 0)))
    with pytest.raises(ShapeError, match="at least one influence"):
        deform.skin(mesh, none, bind)


@pytest.mark.parametrize("method", METHODS)
def test_torch_agrees_and_gradients_flow_from_rotations_to_vertices(rng: np.random.Generator, method: str) -> None:
    torch = pytest.importorskip("torch")
    skeleton, mesh = random_skeleton(rng, 5), random_mesh(rng, 6)
    binding = random_skin(rng, skeleton, 6, 3)
    pose = random_pose(rng, (2,), 5, scaled=True)
    tensors = as_type(pose, torch.float64)

    def skinned(translations: object, rotations: object, scales: object) -> object:
        model_from_joint = world(skeleton, Pose(translations, rotations, scales))
        return deform.skin(mesh, binding, model_from_joint, method, with_normals=True)

    inputs = [a.requires_grad_() for a in (tensors.translations, tensors.rotations, tensors.scales)]
    expected = deform.skin(mesh, binding, world(skeleton, pose), method, with_normals=True)
    for own, other in zip(skinned(*inputs), expected, strict=True):
        assert_allclose(own.detach().numpy(), other, atol=1e-11)
    assert torch.autograd.gradcheck(skinned, inputs, atol=1e-5)


def test_gradients_reach_weights_positions_and_bind_matrices(rng: np.random.Generator) -> None:
    torch = pytest.importorskip("torch")
    skeleton = random_skeleton(rng, 4)
    binding, mesh = random_skin(rng, skeleton, 5, 2), random_mesh(rng, 5)
    model_from_joint = torch.tensor(world(skeleton, random_pose(rng, (), 4)))

    def skinned(positions: object, weights: object, inverse_bind: object) -> object:
        own = Skin(binding.palette, inverse_bind, binding.joints, weights)
        return deform.skin_points(positions, None, own, deform.skin_matrices(own, model_from_joint))[0]

    inputs = [
        torch.tensor(np.array(a), requires_grad=True)
        for a in (mesh.positions, binding.weights, binding.joint_from_mesh)
    ]
    assert torch.autograd.gradcheck(skinned, inputs)


# --- real files -------------------------------------------------------------------------------------------------------


@pytest.mark.data
@pytest.mark.parametrize("path", data_files("gltf/**/*.gl*"), ids=lambda p: p.name)
def test_real_skins_reproduce_their_mesh_in_the_bind_pose(path: Path) -> None:
    """With every joint where its inverse bind matrix says it was bound, nothing moves."""
    from keypose.io import load

    scene = load(path)
    skinned = [(c, p) for c in scene.characters for p in c.parts if p.skin is not None]
    if not skinned:
        pytest.skip("no skin in this file")
    for character, part in skinned:
        binding, mesh = part.skin, part.mesh
        model_from_joint = np.tile(np.eye(4), (character.skeleton.joint_count, 1, 1))
        inverse_bind = np.asarray(binding.joint_from_mesh, np.float64)
        if np.any(np.abs(np.linalg.det(inverse_bind[:, :3, :3])) < 1e-12):
            pytest.skip("an inverse bind matrix of this file has no inverse")
        model_from_joint[binding.palette] = np.linalg.inv(inverse_bind)
        used = np.unique(binding.joints)
        if len(np.unique(binding.palette[used])) != len(used):
            pytest.skip("one joint is bound twice in this file")
        size = np.linalg.norm(np.ptp(mesh.positions, axis=0))
        for method in METHODS:
            moved = deform.skin(mesh, binding, model_from_joint, method)
            assert_allclose(moved, mesh.positions, atol=1e-6 * max(size, 1e-3), err_msg=f"{part.name}, {method}")


def test_the_skin_of_a_leaning_skeleton(rng: np.random.Generator) -> None:
    """A bind pose that is not at rest: what moves is the difference."""
    rest = Pose([[0, 1.0, 0], [0.5, 0, 0]], random_rotations(rng, 2), np.ones((2, 3)))
    skeleton = Skeleton(("a", "b"), [-1, 0], rest)
    binding = random_skin(rng, skeleton, 10, 2)
    mesh = random_mesh(rng, 10)
    assert_allclose(deform.skin_matrices(binding, world(skeleton, rest)), np.tile(np.eye(4), (2, 1, 1)), atol=1e-14)
    up = np.array([0, 0.25, 0])
    lifted = Pose(rest.translations + np.array([[1], [0]]) * up, rest.rotations, rest.scales)
    assert_allclose(deform.skin(mesh, binding, world(skeleton, lifted)), mesh.positions + up, atol=1e-14)
    assert_array_equal(binding.palette, [0, 1])
