"""Morph targets, packing and whole characters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from keypose import deform
from keypose.errors import ShapeError
from keypose.evaluate import world
from keypose.math import rigid
from keypose.model import Character, Mesh, MorphSet, Part, Skin, SkinningMethod
from tests.synthetic import random_mesh, random_pose, random_skeleton, random_skin


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(21)


def sparse_morphs(rng: np.random.Generator, vertices: int, count: int = 3, normals: bool = True) -> MorphSet:
    moved = rng.uniform(size=(count, vertices, 1)) < 0.3
    names = tuple(f"shape{m}" for m in range(count))
    deltas = rng.normal(size=(2, count, vertices, 3)) * moved
    return MorphSet.from_dense(names, deltas[0], deltas[1] if normals else None)


# --- deltas -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("batch", [(), (4,), (2, 3), (0,)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_deltas_add_up_with_any_weights(rng: np.random.Generator, batch: tuple[int, ...], dtype: type) -> None:
    mesh = random_mesh(rng, 30)
    mesh = Mesh(mesh.positions.astype(dtype), mesh.triangles, mesh.normals.astype(dtype))
    morphs = sparse_morphs(rng, 30)
    morphs = replace(
        morphs, position_deltas=morphs.position_deltas.astype(dtype), normal_deltas=morphs.normal_deltas.astype(dtype)
    )
    weights = rng.uniform(-2, 3, (*batch, 3))  # extremes and several at once
    positions, normals = deform.morph(mesh, morphs, weights, with_normals=True)
    assert positions.dtype == normals.dtype == dtype
    dense_positions, dense_normals = morphs.dense(30)
    tolerance = 1e-5 if dtype is np.float32 else 1e-13
    assert_allclose(positions, mesh.positions + np.einsum("...m,mvc->...vc", weights, dense_positions), atol=tolerance)
    turned = mesh.normals + np.einsum("...m,mvc->...vc", weights, dense_normals)
    assert_allclose(normals, turned / np.linalg.norm(turned, axis=-1, keepdims=True), atol=10 * tolerance)


def test_no_weight_is_the_mesh_itself_and_full_weight_the_target(rng: np.random.Generator) -> None:
    neutral, smile, frown = (random_mesh(rng, 20) for _ in range(3))
    morphs = deform.morphs_from_shapes(neutral, {"smile": smile, "frown": frown})
    assert morphs.names == ("smile", "frown")
    assert_array_equal(deform.morph(neutral, morphs, [0.0, 0.0]), neutral.positions)
    positions, normals = deform.morph(neutral, morphs, [0.0, 1.0], with_normals=True)
    assert_allclose(positions, frown.positions, atol=1e-15)
    assert_allclose(normals, frown.normals, atol=1e-15)


def test_morphs_without_normal_deltas_leave_the_normals(rng: np.random.Generator) -> None:
    mesh = random_mesh(rng, 20)
    positions, normals = deform.morph(mesh, sparse_morphs(rng, 20, normals=False), np.ones((2, 3)), with_normals=True)
    assert positions.shape == normals.shape == (2, 20, 3)
    assert_array_equal(normals[1], mesh.normals)


def test_wrong_morphs_are_refused(rng: np.random.Generator) -> None:
    mesh = random_mesh(rng, 20)
    with pytest.raises(ShapeError, match="weights: expected"):
        deform.morph(mesh, sparse_morphs(rng, 20), [1.0, 0.0])
    with pytest.raises(ShapeError, match="the mesh has 20 vertices"):
        deform.morph(mesh, MorphSet(("a",), [0, 1], [20], [[0.0, 0, 1]]), [1.0])
    with pytest.raises(ShapeError, match="normals: the mesh has none"):
        deform.morph(Mesh(mesh.positions, mesh.triangles), sparse_morphs(rng, 20), [1.0, 0, 0], with_normals=True)


@pytest.mark.parametrize("normals", [False, True])
def test_morphs_in_torch_have_gradients(rng: np.random.Generator, normals: bool) -> None:
    torch = pytest.importorskip("torch")
    mesh, morphs = random_mesh(rng, 8), sparse_morphs(rng, 8, normals=normals)
    weights = torch.tensor(rng.normal(size=(2, 3)), requires_grad=True)
    expected = deform.morph(mesh, morphs, weights.detach().numpy(), with_normals=True)
    for own, other in zip(deform.morph(mesh, morphs, weights, with_normals=True), expected, strict=True):
        assert_allclose(own.detach().numpy(), other, atol=1e-13)
    assert torch.autograd.gradcheck(lambda w: deform.morph(mesh, morphs, w, with_normals=normals), [weights])


# --- absolute shapes --------------------------------------------------------------------------------------------------


def test_absolute_shapes_are_their_weighted_mean(rng: np.random.Generator) -> None:
    shapes = {name: random_mesh(rng, 15) for name in ("neutral", "smile", "frown")}
    weights = rng.dirichlet([1, 1, 1], (4, 2))
    positions, normals = deform.morph_absolute(shapes, weights, with_normals=True)
    stacked = np.stack([m.positions for m in shapes.values()])
    assert_allclose(positions, np.einsum("...m,mvc->...vc", weights, stacked), atol=1e-14)
    assert_allclose(np.linalg.norm(normals, axis=-1), 1)
    # The two forms of the notes agree: absolute weights that sum to 1 are deltas from any of the shapes.
    morphs = deform.morphs_from_shapes(shapes["neutral"], {k: shapes[k] for k in ("smile", "frown")})
    assert_allclose(positions, deform.morph(shapes["neutral"], morphs, weights[..., 1:]), atol=1e-14)


def test_absolute_weights_must_sum_to_one_or_are_normalised(rng: np.random.Generator) -> None:
    shapes = {name: random_mesh(rng, 5) for name in ("a", "b")}
    with pytest.raises(ShapeError, match=r"sum to 1, got 1\.5"):
        deform.morph_absolute(shapes, [[0.5, 0.5], [1.0, 0.5]])
    expected = deform.morph_absolute(shapes, [2 / 3, 1 / 3])
    assert_allclose(deform.morph_absolute(shapes, [1.0, 0.5], normalize=True), expected)
    with pytest.raises(ShapeError, match="their sum is 0"):
        deform.morph_absolute(shapes, [1.0, -1.0], normalize=True)
    assert deform.morph_absolute(shapes, np.full(2, 0.5, np.float32)).dtype == np.float64


def test_shapes_with_other_vertices_are_refused_by_name(rng: np.random.Generator) -> None:
    shapes = {"neutral": random_mesh(rng, 5), "smile": random_mesh(rng, 5), "jaw": random_mesh(rng, 6)}
    with pytest.raises(ShapeError, match="target 'jaw' has 6 vertices, 'neutral' has 5"):
        deform.morph_absolute(shapes, [1.0, 0.0, 0.0])
    with pytest.raises(ShapeError, match="target 'jaw' has 6 vertices, 'neutral' has 5"):
        deform.morphs_from_shapes(shapes["neutral"], {"jaw": shapes["jaw"]})
    with pytest.raises(ShapeError, match="at least one shape"):
        deform.morph_absolute({}, [])


# --- packing ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kept", [1, 2, 4, 8])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_packing_keeps_the_largest_and_says_what_it_lost(rng: np.random.Generator, kept: int, dtype: type) -> None:
    skeleton = random_skeleton(rng, 12)
    binding = random_skin(rng, skeleton, 60, 7)
    binding = replace(binding, weights=binding.weights.astype(dtype))
    packed, report = deform.pack(binding, kept)
    assert packed.weights.shape == (60, kept)
    assert packed.weights.dtype == dtype
    assert_allclose(packed.weights.sum(axis=1), 1, atol=1e-6)
    lost = np.sort(binding.weights, axis=1)[:, : max(7 - kept, 0)].sum(axis=1)
    assert_allclose(report.max_lost_weight, lost.max(initial=0), atol=1e-6)
    assert_allclose(report.mean_lost_weight, lost.mean(), atol=1e-6)
    assert report.vertices_changed == (60 if kept < 7 else 0)
    assert (report.worst_vertex == int(np.argmax(lost))) if kept < 7 else (report.worst_vertex == -1)
    for v in range(60):
        before = dict(zip(binding.joints[v].tolist(), binding.weights[v].tolist(), strict=True))
        largest = sorted(before, key=before.__getitem__, reverse=True)[:kept]
        after = {j: w for j, w in zip(packed.joints[v].tolist(), packed.weights[v].tolist(), strict=True) if w > 0}
        assert set(after) == set(largest)
        assert_allclose(
            [after[j] * sum(before[k] for k in largest) for j in after], [before[j] for j in after], rtol=1e-5
        )


def test_packing_states_the_displacement_in_given_poses(rng: np.random.Generator) -> None:
    skeleton, mesh = random_skeleton(rng, 12), random_mesh(rng, 60)
    binding = random_skin(rng, skeleton, 60, 6)
    poses = world(skeleton, random_pose(rng, (5,), 12))
    packed, report = deform.pack(binding, mesh=mesh, model_from_joint=poses)
    moved = deform.skin(mesh, packed, poses) - deform.skin(mesh, binding, poses)
    assert report.max_displacement_m == pytest.approx(np.linalg.norm(moved, axis=-1).max())
    assert "vertices move by up to" in str(report)
    with pytest.raises(ShapeError, match="both mesh and model_from_joint"):
        deform.pack(binding, mesh=mesh)


def test_packing_few_or_repeated_influences_loses_nothing(rng: np.random.Generator) -> None:
    inverse_bind = np.tile(np.eye(4), (3, 1, 1))
    few = Skin([0, 1, 2], inverse_bind, [[0, 1], [2, 2]], [[0.25, 0.75], [0.5, 0.5]])
    packed, report = deform.pack(few)
    assert_array_equal(packed.joints, [[1, 0, 0, 0], [2, 0, 0, 0]])
    assert_array_equal(packed.weights, [[0.75, 0.25, 0, 0], [1, 0, 0, 0]])
    assert str(report) == "2 vertices, at most 2 influences: nothing lost"
    repeated = Skin([0, 1, 2], inverse_bind, [[0, 1, 0, 2, 0]], [[0.1, 0.3, 0.1, 0.3, 0.2]])
    packed, report = deform.pack(repeated, 3)
    assert report.max_lost_weight == 0
    assert dict(zip(packed.joints[0].tolist(), packed.weights[0].round(12).tolist(), strict=True)) == {
        0: 0.4,
        1: 0.3,
        2: 0.3,
    }
    with pytest.raises(ShapeError, match="at least 1"):
        deform.pack(few, 0)
    nothing = Skin([0], inverse_bind[:1], np.zeros((0, 5), int), np.zeros((0, 5)))
    assert deform.pack(nothing)[1].max_lost_weight == 0


# --- characters -------------------------------------------------------------------------------------------------------


@pytest.fixture
def character(rng: np.random.Generator) -> Character:
    skeleton = random_skeleton(rng, 6)
    body, hat, eye = (random_mesh(rng, n) for n in (40, 10, 12))
    parts = (
        Part(
            "body",
            body,
            skin=random_skin(rng, skeleton, 40, 3),
            morphs=sparse_morphs(rng, 40),
            morph_channels=[3, 0, 1],
        ),
        Part("hat", hat, joint=4),
        Part("eye", eye, joint=5, morphs=sparse_morphs(rng, 12, 1), morph_channels=[2]),
    )
    names = ("smile", "frown", "blink", "jaw")
    return Character(skeleton, parts, morph_names=names, rest_morph_weights=[0.1, 0.2, 0.3, 0.4])


@pytest.mark.parametrize("method", tuple(SkinningMethod))
def test_a_part_is_morphed_first_and_then_skinned(
    rng: np.random.Generator, character: Character, method: deform.Method
) -> None:
    body = character.parts[0]
    model_from_joint = world(character.skeleton, random_pose(rng, (5,), 6))
    weights = rng.uniform(size=(5, 4))
    positions, normals = deform.deform_part(
        character, body, model_from_joint, weights, with_normals=True, method=method
    )
    for f in range(5):
        morphed = deform.morph(body.mesh, body.morphs, weights[f][[3, 0, 1]], with_normals=True)
        mesh = Mesh(morphed[0], body.mesh.triangles, morphed[1])
        expected = deform.skin(mesh, body.skin, model_from_joint[f], method, with_normals=True)
        assert_allclose(positions[f], expected[0], atol=1e-13)
        assert_allclose(normals[f], expected[1], atol=1e-13)
    rest = deform.deform_part(character, body, model_from_joint, method=method)
    at_rest = deform.deform_part(character, body, model_from_joint, [0.1, 0.2, 0.3, 0.4], method=method)
    assert_array_equal(rest, at_rest)


def test_rigid_parts_hang_on_their_joint(rng: np.random.Generator, character: Character) -> None:
    pose = random_pose(rng, (2, 3), 6, scaled=True)
    model_from_joint = world(character.skeleton, pose)
    _, hat, eye = character.parts
    positions, normals = deform.deform_part(character, hat, model_from_joint, with_normals=True)
    carrier = model_from_joint[..., 4, :, :]
    assert_allclose(positions, rigid.transform_points(carrier[..., None, :, :], hat.mesh.positions), atol=1e-14)
    for index in np.ndindex(2, 3):
        expected = hat.mesh.normals @ np.linalg.inv(carrier[index][:3, :3])
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        assert_allclose(normals[index], expected, atol=1e-10)
    assert_array_equal(hat.mesh.positions, character.parts[1].mesh.positions)
    weights = rng.uniform(size=(2, 3, 4))
    morphed = deform.deform_part(character, eye, model_from_joint, weights)
    local = eye.mesh.positions + weights[1, 2, 2] * eye.morphs.dense(12)[0][0]
    assert_allclose(morphed[1, 2], rigid.transform_points(model_from_joint[1, 2, 5], local), atol=1e-13)


def test_a_whole_character(rng: np.random.Generator, character: Character) -> None:
    model_from_joint = world(character.skeleton, random_pose(rng, (3,), 6))
    parts = deform.deform_character(character, model_from_joint)
    assert [p.shape for p in parts] == [(3, 40, 3), (3, 10, 3), (3, 12, 3)]
    both = deform.deform_character(character, model_from_joint, with_normals=True)
    for plain, (positions, normals), part in zip(parts, both, character.parts, strict=True):
        assert_array_equal(plain, positions)
        assert normals.shape == positions.shape
        assert_array_equal(plain, deform.deform_part(character, part, model_from_joint))


def test_wrong_input_names_the_part(rng: np.random.Generator, character: Character) -> None:
    model_from_joint = world(character.skeleton, character.skeleton.rest)
    with pytest.raises(ShapeError, match=r"model_from_joint: expected .* to match the character's 6 joints"):
        deform.deform_part(character, character.parts[0], model_from_joint[:5])
    with pytest.raises(ShapeError, match="morph_weights: expected"):
        deform.deform_part(character, character.parts[0], model_from_joint, [1.0])
    bald = replace(character.parts[1], mesh=Mesh(np.zeros((3, 3)), [[0, 1, 2]]))
    with pytest.raises(ShapeError, match="part 'hat': its mesh has no normals"):
        deform.deform_part(character, bald, model_from_joint, with_normals=True)


def test_characters_in_torch_have_gradients_from_weights_and_poses(
    rng: np.random.Generator, character: Character
) -> None:
    torch = pytest.importorskip("torch")
    model_from_joint = torch.tensor(world(character.skeleton, random_pose(rng, (), 6)), requires_grad=True)
    weights = torch.tensor([0.1, 0.5, 0.2, 0.9], dtype=torch.float64, requires_grad=True)
    for part in character.parts:
        own = deform.deform_part(character, part, model_from_joint, weights, with_normals=True)
        expected = deform.deform_part(
            character, part, model_from_joint.detach().numpy(), weights.detach().numpy(), with_normals=True
        )
        for a, b in zip(own, expected, strict=True):
            assert_allclose(a.detach().numpy(), b, atol=1e-12)
    inputs = [model_from_joint, weights]
    assert torch.autograd.gradcheck(lambda m, w: deform.deform_part(character, character.parts[0], m, w), inputs)
