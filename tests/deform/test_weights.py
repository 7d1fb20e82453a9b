"""Automatic weights: sums, symmetry, invariances, rigid ends, pieces, damaged meshes, and what is refused."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from keypose import samples
from keypose.deform import automatic_weights, deform_character, skin, skin_character
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import world
from keypose.math import quat
from keypose.model import Character, Mesh, Part, Pose, Skeleton, SkinningMethod


def chain(places: Any, names: Any = None, parents: Any = None) -> Skeleton:
    """Joints without rotation at these places in the model."""
    places = np.asarray(places, float)
    parents = np.arange(len(places)) - 1 if parents is None else np.asarray(parents)
    offsets = places - np.where(parents[:, None] >= 0, places[parents], 0.0)
    ones = np.tile([1.0, 0, 0, 0], (len(places), 1))
    names = names or [f"j{n}" for n in range(len(places))]
    return Skeleton(tuple(names), parents, Pose(offsets, ones, np.ones((len(places), 3))))


def shifted(points: Any, x: float, y: float, z: float) -> np.ndarray:
    return np.asarray(points) + np.array([x, y, z], float)


def tube(length: float = 4.0, radius: float = 0.5, rings: int = 41, around: int = 16, closed: bool = True) -> Mesh:
    """A cylinder along X from 0, its ends closed by fans."""
    angles = np.linspace(0, 2 * np.pi, around, endpoint=False)
    x = np.repeat(np.linspace(0, length, rings), around)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1) * radius
    points = np.concatenate([x[:, None], np.tile(circle, (rings, 1))], axis=1)
    faces = []
    for ring in range(rings - 1):
        for k in range(around):
            a, b = ring * around + k, ring * around + (k + 1) % around
            faces += [(a, b, a + around), (b, b + around, a + around)]
    if closed:
        first, last = len(points), len(points) + 1
        points = np.concatenate([points, [[0, 0, 0], [length, 0, 0]]])
        end = (rings - 1) * around
        for k in range(around):
            faces += [(first, (k + 1) % around, k), (last, end + k, end + (k + 1) % around)]
    return Mesh(points, np.array(faces))


def joined(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(m.vertex_count for m in meshes)])
    faces = [np.asarray(m.triangles) + s for m, s in zip(meshes, starts, strict=False)]
    return Mesh(np.concatenate([m.positions for m in meshes]), np.concatenate(faces))


def dense(found: Any, joints: int, which: int = 0) -> np.ndarray:
    """Weights (V, J) of a result."""
    bound = found.skins[which]
    out = np.zeros((len(bound.joints), joints))
    np.add.at(out, (np.arange(len(out))[:, None], np.asarray(bound.palette)[bound.joints]), bound.weights)
    return out


ARM = chain([(0, 0, 0), (2, 0, 0)])  # two bones: the second reaches on to the end


def check_skin(bound: Any, most: int) -> None:
    assert bound.influence_count <= most
    assert np.all(bound.weights >= 0)
    assert_allclose(bound.weights.sum(axis=1), 1.0, atol=1e-6)
    assert np.all(bound.joints[bound.weights == 0] == 0)


@pytest.mark.parametrize("most", [1, 2, 4, 8])
def test_weights_sum_to_one_and_are_few(most: int) -> None:
    body = samples.load("human").character
    found = automatic_weights([p.mesh for p in body.parts], body.skeleton, max_influences=most)
    for bound in found.skins:
        check_skin(bound, most)
    assert found.report.influences <= most <= max(found.report.influences_before, most)


def test_a_bone_holds_its_middle_and_shares_at_the_joint() -> None:
    mesh = tube()
    weights = dense(automatic_weights(mesh, ARM), 2)
    x = mesh.positions[:, 0]
    assert np.all(weights[x < 1.2, 0] > 0.9) and np.all(weights[x > 2.8, 1] > 0.9)
    ring = np.abs(x - 2.0) < 1e-9
    assert_allclose(weights[ring, 0], 0.5, atol=0.1)
    along = np.array([weights[np.abs(x - v) < 1e-9, 1].mean() for v in np.unique(x)])
    assert np.all(np.diff(along) > -1e-6)  # from one bone to the other without a way back


def test_far_from_the_joint_a_tube_moves_with_its_bone_as_a_rigid_body() -> None:
    mesh = tube(length=8.0, rings=81)
    body = chain([(0, 0, 0), (4, 0, 0)])
    bound = automatic_weights(mesh, body, strength=4.0).skins[0]
    rotations = np.array(body.rest.rotations)
    rotations[1] = quat.from_axis_angle(np.array([0.0, 0, 1]), 1.0)
    moved = skin(mesh, bound, world(body, replace(body.rest, rotations=rotations)))
    turned = quat.rotate(rotations[1], shifted(mesh.positions, -4, 0, 0))
    turned = shifted(turned, 4, 0, 0)
    far = mesh.positions[:, 0] > 7.0
    assert np.abs(moved - turned)[far].max() < 0.03
    assert np.abs(moved - mesh.positions)[mesh.positions[:, 0] < 1.0].max() < 0.03


def test_the_rest_pose_is_kept() -> None:
    body = samples.load("human").character
    bound, _ = skin_character(body)
    rest = world(body.skeleton, body.skeleton.rest)
    for part, moved in zip(body.parts, deform_character(bound, rest), strict=True):
        assert_allclose(moved, part.mesh.positions, atol=1e-6)


def test_mirrored_meshes_get_mirrored_weights() -> None:
    # a T: a trunk and two arms, as one closed tube across and one down
    arms, trunk = tube(4.0, 0.3), tube(2.0, 0.4)
    across = Mesh(arms.positions - [2.0, 0, 0], arms.triangles)
    down = Mesh(trunk.positions[:, [1, 0, 2]] * [1, -1, 1] - [0, 0.2, 0], trunk.triangles)
    mesh = joined(across, down)
    names = ["hips", "chest", "left", "left_hand", "right", "right_hand"]
    places = [(0, -2, 0), (0, -0.6, 0), (0.5, 0, 0), (1.5, 0, 0), (-0.5, 0, 0), (-1.5, 0, 0)]
    body = chain(places, names, [-1, 0, 1, 2, 1, 4])
    weights = dense(automatic_weights(mesh, body), 6)
    flipped = mesh.positions * [-1, 1, 1]
    twin = np.argmin(((flipped[:, None] - mesh.positions[None]) ** 2).sum(-1), axis=1)
    assert_allclose(mesh.positions[twin], flipped, atol=1e-9)
    assert_allclose(weights[twin][:, [0, 1, 4, 5, 2, 3]], weights, atol=0.03)
    assert weights[:, [3, 5]].max() > 0.9


def test_order_of_vertices_and_scale_do_not_matter() -> None:
    mesh = tube()
    plain = dense(automatic_weights(mesh, ARM), 2)
    rng = np.random.default_rng(4)
    order = rng.permutation(mesh.vertex_count)
    place = np.argsort(order)
    shuffled = Mesh(mesh.positions[order], place[np.asarray(mesh.triangles)][rng.permutation(len(mesh.triangles))])
    assert_allclose(dense(automatic_weights(shuffled, ARM), 2)[place], plain, atol=1e-5)
    for factor in (1e-3, 100.0):
        big = Mesh(mesh.positions * factor, mesh.triangles)
        bones = replace(ARM, rest=replace(ARM.rest, translations=ARM.rest.translations * factor))
        assert_allclose(dense(automatic_weights(big, bones), 2), plain, atol=1e-5)


def test_turning_everything_hardly_matters() -> None:
    mesh = tube()
    plain = dense(automatic_weights(mesh, ARM), 2)
    turn = quat.from_axis_angle(np.array([0.6, 0.64, 0.48]), 0.8)
    turned = Mesh(shifted(quat.rotate(turn, mesh.positions), 1, 2, 3), mesh.triangles)
    bones = chain(shifted(quat.rotate(turn, np.array([[0.0, 0, 0], [2.0, 0, 0]])), 1, 2, 3))
    assert_allclose(dense(automatic_weights(turned, bones), 2), plain, atol=0.06)  # voxels stand still


def test_a_seam_does_not_crack_and_a_cut_mesh_is_one() -> None:
    mesh = tube()
    whole = dense(automatic_weights(mesh, ARM), 2)
    x = mesh.positions[mesh.triangles].mean(axis=1)[:, 0]
    halves = []
    for faces in (mesh.triangles[x < 1.9], mesh.triangles[x >= 1.9]):
        used, local = np.unique(faces, return_inverse=True)
        halves.append((used, Mesh(mesh.positions[used], local.reshape(-1, 3))))
    found = automatic_weights([m for _, m in halves], ARM)
    for n, (used, _) in enumerate(halves):
        assert_allclose(dense(found, 2, n), whole[used], atol=1e-5)
    assert found.report.pieces == 1
    unwelded = Mesh(mesh.positions[mesh.triangles.reshape(-1)], np.arange(3 * len(mesh.triangles)).reshape(-1, 3))
    soup = dense(automatic_weights(unwelded, ARM), 2)
    assert_allclose(soup, whole[mesh.triangles.reshape(-1)], atol=1e-5)


def test_heat_does_not_jump_from_one_leg_to_the_other() -> None:
    """Two tubes side by side, a hair's breadth apart: each sees its own bone only."""
    one = tube(4.0, 0.5)
    two = Mesh(shifted(one.positions, 0, 0, 1.06), one.triangles)
    # the second bone lies at the edge of its tube, nearer to the first tube's side than that one's own
    body = chain([(0, 0, 0), (0, 0, 0.0), (3.8, 0, 0), (0, 0, 0.65), (3.8, 0, 0.65)], parents=[-1, 0, 1, 0, 3])
    weights = dense(automatic_weights(joined(one, two), body, joints=[1, 2, 3, 4]), 5)
    assert np.all(weights[: one.vertex_count, :3].sum(axis=1) > 0.99)
    assert np.all(weights[one.vertex_count :, 3:].sum(axis=1) > 0.99)


def test_open_tubes_are_solid_too() -> None:
    mesh = tube(closed=False)
    found = automatic_weights(mesh, ARM)
    weights = dense(found, 2)
    x = mesh.positions[:, 0]
    assert found.report.open_pieces == 1
    assert np.all(weights[(x > 0.3) & (x < 1.0), 0] > 0.8) and np.all(weights[x > 3.0, 1] > 0.8)


def test_twist_joints_share_a_bone() -> None:
    body = chain([(0, 0, 0), (2, 0, 0), (1, 0, 0), (3, 0, 0)], ["arm", "hand", "twist", "finger"], [-1, 0, 0, 1])
    mesh = tube()
    weights = dense(automatic_weights(mesh, body), 4)
    x = mesh.positions[:, 0]
    ring = lambda v: weights[np.abs(x - v) < 1e-9].mean(axis=0)  # noqa: E731
    assert ring(0.4)[0] > 0.9 and ring(1.5)[2] > 0.9 and ring(2.6)[1] > 0.6 and ring(3.8)[3] > 0.9


def test_a_bead_around_a_leaf_joint_is_that_joints_own() -> None:
    bead = tube(0.2, 0.1, 5, 8)
    bead = Mesh(shifted(bead.positions, 3.0, 0.35, 0), bead.triangles)
    body = chain([(0, 0, 0), (2, 0, 0), (3.9, 0, 0), (3.1, 0.35, 0)], parents=[-1, 0, 1, 1])
    found = automatic_weights(joined(tube(), bead), body)
    weights = dense(found, 4)
    assert found.report.rigid == 1
    assert_array_equal(weights[-bead.vertex_count :, 3], 1.0)
    assert_array_equal(weights[: -bead.vertex_count, 3], 0.0)


def test_a_patch_goes_along_with_the_surface_under_it() -> None:
    mesh = tube(rings=81, around=48)
    patch = Mesh(np.array([[1.8, 0.51, -0.05], [2.2, 0.51, -0.05], [1.8, 0.51, 0.05], [2.2, 0.51, 0.05]]), [[0, 2, 1], [1, 2, 3]])  # fmt: skip
    found = automatic_weights([mesh, patch], ARM)
    assert found.report.attached == 1
    under = np.argmin(((mesh.positions[None] - patch.positions[:, None]) ** 2).sum(-1), axis=1)
    assert_allclose(dense(found, 2, 1), dense(found, 2, 0)[under], atol=0.05)


def test_damaged_meshes_are_taken() -> None:
    mesh = tube()
    holes = np.asarray(mesh.triangles)[np.random.default_rng(1).permutation(len(mesh.triangles))[: int(0.9 * len(mesh.triangles))]]  # fmt: skip
    flat = np.array([[5, 5, 5], [3, 4, 3], [0, 16, 32]])  # no area, or a line
    loose = np.array([[1.0, 0.6, 0], [3.0, 0, 0.7]])
    twice = np.asarray(mesh.triangles)[:20]
    flipped = np.asarray(mesh.triangles)[40:60][:, ::-1]
    broken = Mesh(np.concatenate([mesh.positions, loose]), np.concatenate([holes, flat, twice, flipped]))
    found = automatic_weights(broken, ARM)
    check_skin(found.skins[0], 4)
    weights = dense(found, 2)
    x = broken.positions[:, 0]
    assert np.all(weights[x < 0.8, 0] > 0.8) and np.all(weights[x > 3.2, 1] > 0.8)


def test_a_cloud_without_triangles_takes_the_nearest_bone() -> None:
    cloud = Mesh(np.array([[0.5, 0.2, 0], [3.0, 0.1, 0.2], [1.0, 0, 0]]), np.empty((0, 3), int))
    assert_array_equal(dense(automatic_weights(cloud, ARM), 2), [[1, 0], [0, 1], [1, 0]])


def test_only_named_joints_move_something() -> None:
    body = chain([(0, 0, 0), (1, 0, 0), (2, 0, 0)])
    found = automatic_weights(tube(), body, joints=["j0", 2])
    weights = dense(found, 3)
    assert_array_equal(weights[:, 1], 0.0)
    assert found.report.joints == ("j0", "j2")
    x = tube().positions[:, 0]
    assert np.all(weights[x < 1.5, 0] > 0.8)  # what j1 would move, the joint above it moves


def test_roots_on_the_ground_move_nothing() -> None:
    human = samples.load("human").character
    skeleton = human.skeleton
    rest = skeleton.rest
    grounded = Skeleton(
        ("ground", "camera", *skeleton.names),
        np.concatenate([[-1, 0], np.where(skeleton.parents < 0, 0, skeleton.parents + 2)]),
        Pose(
            np.concatenate([[[0, 0, 0], [0, 1, 3]], rest.translations]),
            np.concatenate([[[1, 0, 0, 0]] * 2, rest.rotations]),
            np.concatenate([np.ones((2, 3)), rest.scales]),
        ),
    )
    found = automatic_weights([p.mesh for p in human.parts], grounded)
    assert not {"ground", "camera"} & set(found.report.joints)
    assert {"Hips", "LeftHandPinky3", "RightToeBase", "LeftArmTwist", "Neck", "Jaw"} <= set(found.report.joints)


def test_a_skeleton_elsewhere_is_said_to_be() -> None:
    far = chain([(100.0, 0, 0), (102.0, 0, 0)])
    found = automatic_weights(tube(), far)
    check_skin(found.skins[0], 4)
    assert any("no bone is inside" in note for note in found.report.notes)


def test_a_rigid_character_becomes_a_skinned_one() -> None:
    mesh = tube()
    local = Mesh(mesh.positions - [2.0, 0, 0], mesh.triangles)
    rigid = Character(ARM, (Part("tube", local, joint=1),))
    bound, report = skin_character(rigid, method=SkinningMethod.DUAL_QUATERNION)
    part = bound.parts[0]
    assert part.skin is not None and part.joint is None and part.skin.method == SkinningMethod.DUAL_QUATERNION
    assert_allclose(deform_character(bound, world(ARM, ARM.rest))[0], mesh.positions, atol=1e-9)
    assert report.vertices == mesh.vertex_count


def test_progress_is_told() -> None:
    seen: list[tuple[int, int]] = []
    automatic_weights(tube(), ARM, progress=lambda done, total: seen.append((done, total)))
    assert seen and seen[-1][0] == seen[-1][1]
    assert all(a[0] <= b[0] for a, b in itertools.pairwise(seen))


def test_wrong_input_is_named() -> None:
    mesh = tube()
    with pytest.raises(ShapeError, match="max_influences"):
        automatic_weights(mesh, ARM, max_influences=0)
    with pytest.raises(ShapeError, match="strength"):
        automatic_weights(mesh, ARM, strength=float("nan"))
    with pytest.raises(UnknownName, match="nearest: 'j1'"):
        automatic_weights(mesh, ARM, joints=["j11"])
    with pytest.raises(ShapeError, match=r"joint: expected 0 to .*, got 7"):
        automatic_weights(mesh, ARM, joints=[7])
    with pytest.raises(ShapeError, match="at least one that may move"):
        automatic_weights(mesh, ARM, joints=[])
    with pytest.raises(ShapeError, match="model_from_joint"):
        automatic_weights(mesh, ARM, model_from_joint=np.eye(4)[None])
    with pytest.raises(ShapeError, match="at least one vertex"):
        automatic_weights([], ARM)
    with pytest.raises(ShapeError, match="one place"):
        automatic_weights(Mesh(np.ones((3, 3)), [[0, 1, 2]]), ARM)
    spoilt = np.array(mesh.positions)
    spoilt[7, 1] = np.inf
    with pytest.raises(ShapeError, match="vertex 7 of mesh 1"):
        automatic_weights([mesh, Mesh(spoilt, mesh.triangles)], ARM)
    with pytest.raises(UnknownName, match="skinning method"):
        automatic_weights(mesh, ARM, method="liner")
    with pytest.raises(ShapeError, match="no mesh"):
        skin_character(Character(ARM))


def test_what_touches_at_one_place_is_held_there() -> None:
    blade = np.array([[3.9, 0.55, 0.02], [3.9, 3.0, 0], [4.0, 0.55, -0.02], [4.0, 3.0, 0]])
    sword = Mesh(blade, np.array([[0, 1, 2], [2, 1, 3]]))
    found = automatic_weights([tube(), sword], ARM)
    weights = dense(found, 2, 1)
    assert found.report.attached == 1
    assert_allclose(weights, np.broadcast_to(weights[0], weights.shape), atol=1e-6)
    assert weights[0, 1] > 0.9


def test_what_is_mounted_on_a_joint_is_no_bone() -> None:
    body = chain([(0, 0, 0), (2, 0, 0), (2.05, 0, 0)], ["arm", "hand", "slot"])
    plain = dense(automatic_weights(tube(), ARM), 2)
    found = automatic_weights(tube(), body)
    assert found.report.joints == ("arm", "hand")
    assert_allclose(dense(found, 3)[:, :2], plain, atol=1e-6)
