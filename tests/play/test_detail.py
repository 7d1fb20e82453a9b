"""Crowds with level of detail: who is where, when each is due, and that what is skinned is what `deform` says."""

from __future__ import annotations

import numpy as np
import pytest

from keypose import deform, evaluate, samples
from keypose.errors import ShapeError, UnknownName
from keypose.kernels.runtime import WIDTH
from keypose.model import Pose
from keypose.play import detail as d
from keypose.play.levels import LevelSpec, build
from keypose.samples import crowds


@pytest.fixture(scope="module")
def levels():
    return crowds.levels()


@pytest.fixture(scope="module")
def poses() -> Pose:
    motion = samples.load("run").animation("run")
    times = np.linspace(0, motion.duration_s, 40, endpoint=False)
    return evaluate.sample(motion, samples.load("human").character.skeleton, times)


def in_lanes(matrices):
    """(N, J, 4, 4) as a crowd has them."""
    count, joints = matrices.shape[:2]
    blocks = -(-count // WIDTH)
    rows = np.zeros((blocks * WIDTH, joints, 12), np.float32)
    rows[:count] = matrices[:, :, :3].reshape(count, joints, 12)
    return np.ascontiguousarray(rows.reshape(blocks, WIDTH, joints, 12).transpose(0, 2, 3, 1))


def flat(count=40):
    """Levels that cost nothing, to test who goes where."""
    specs = (
        LevelSpec(above=0.4),
        LevelSpec(0.5, above=0.2, every=2),
        LevelSpec(0.25, every=4),
    )
    return d.prepare(_tiny(specs), count)


def _tiny(specs):
    from keypose.model import Character, Mesh, Part, Skeleton, Skin

    positions, triangles = _grid(9)
    joints = np.zeros((len(positions), 1), int)
    skin = Skin(np.array([0]), np.eye(4)[None], joints, np.ones((len(positions), 1), np.float32))
    skeleton = Skeleton(("root",), np.array([-1]), Pose(np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.ones((1, 3))))
    return build(Character(skeleton, (Part("grid", Mesh(positions, triangles), skin=skin),)), specs)


def _grid(n):
    x, z = np.meshgrid(np.arange(n) / n, np.arange(n) / n, indexing="ij")
    positions = np.stack([x, 0.02 * np.sin(9 * x) * np.cos(7 * z), z], -1).reshape(-1, 3).astype(np.float32)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    return positions, np.concatenate([np.stack([a, a + 1, a + n], 1), np.stack([a + 1, a + n + 1, a + n], 1)])


def test_the_finest_level_is_what_deform_says(levels, poses):
    human = samples.load("human").character
    models = evaluate.world(human.skeleton, poses)
    crowd = d.prepare(levels, 40)
    d.choose(crowd, np.full(40, 1.0))
    d.skin(crowd, in_lanes(models))
    for character in (0, 7, 39):
        positions, normals = d.vertices_of(crowd, character)
        for n, part in enumerate(human.parts):
            true, turned = deform.skin(part.mesh, part.skin, models[character], with_normals=True)
            mine = levels[0].parts == n
            at = levels[0].vertices[mine]
            assert np.abs(positions[mine] - true[at]).max() < 1e-5
            lengths = np.linalg.norm(normals[mine], axis=1, keepdims=True)
            assert np.abs(normals[mine] / lengths - turned[at]).max() < 1e-4


def test_every_level_moves_as_its_own_skin_does(levels, poses):
    """Characters of mixed levels, from anywhere in the crowd, come out as each level's mesh skinned alone."""
    human = samples.load("human").character
    models = evaluate.world(human.skeleton, poses)
    crowd = d.prepare(levels, 40)
    heights = np.random.default_rng(3).permutation(np.geomspace(0.01, 1.0, 40))
    d.choose(crowd, heights)
    assert min(crowd.shown) > 0
    d.skin(crowd, in_lanes(models))
    for character in range(40):
        level = levels[crowd.level[character]]
        positions, _ = d.vertices_of(crowd, character)
        assert np.abs(positions - deform.skin(level.mesh, level.skin, models[character])).max() < 1e-5


def test_weights_of_dropped_joints_go_to_joints_above_and_sum_to_one(levels):
    skeleton = samples.load("human").character.skeleton
    before = set(range(skeleton.joint_count))
    for level in levels:
        assert np.abs(level.skin.weights.sum(axis=1) - 1).max() < 1e-6
        used = set(level.skin.palette.tolist())
        assert used <= before
        assert level.joint_count <= len(before)
    assert levels[0].joint_count > levels[1].joint_count > levels[2].joint_count > levels[3].joint_count
    fingers = {skeleton.index(f"LeftHand{f}1") for f in ("Index", "Middle", "Ring", "Pinky")}
    assert fingers & set(levels[0].skin.palette.tolist()) and not fingers & set(levels[3].skin.palette.tolist())


def test_the_stated_error_in_motion_holds_for_the_examples(levels):
    human = samples.load("human").character
    models = evaluate.world(human.skeleton, crowds.examples())
    for level in levels[1:]:
        moved = deform.skin(level.mesh, level.skin, models)
        worst = 0.0
        for n, part in enumerate(human.parts):
            mine = level.parts == n
            if mine.any():
                true = deform.skin(part.mesh, part.skin, models)[:, level.vertices[mine]]
                worst = max(worst, float(np.linalg.norm(moved[:, mine] - true, axis=-1).max()))
        assert worst == pytest.approx(level.motion_error.max_m, abs=1e-6)
        assert level.motion_error.rms_m < 0.01


def test_near_is_fine_and_far_is_coarse():
    crowd = flat()
    heights = np.geomspace(1.0, 0.01, 40)
    d.choose(crowd, heights)
    assert np.all(np.diff(crowd.level) >= 0)
    assert np.array_equal(crowd.level == 0, heights > 0.4)
    assert np.array_equal(crowd.level == 2, heights <= 0.2)
    assert d.view_heights(np.array([[0.0, 10.0]]), np.array([0.0, 0.9, 0.0]), 1.8, 45)[0] == pytest.approx(
        0.18 / (2 * np.tan(np.radians(22.5)))
    )


def test_who_stands_on_the_border_does_not_flicker():
    crowd = flat()
    rng = np.random.default_rng(0)
    d.choose(crowd, np.full(40, 0.4))
    changes = sum(len(d.choose(crowd, 0.4 * (1 + 0.07 * rng.uniform(-1, 1, 40)))) for _ in range(100))
    assert changes <= 40  # at most once each
    crowd = flat()
    d.choose(crowd, np.full(40, 0.4))
    bare = sum(len(d.choose(crowd, 0.4 * (1 + 0.07 * rng.uniform(-1, 1, 40)), hysteresis=0.0)) for _ in range(100))
    assert bare > 1000
    # It leaves where it is smaller by the whole share, and not before.
    d.choose(crowd, np.full(40, 0.41))
    assert len(d.choose(crowd, np.full(40, 0.4 * 0.851))) == 0
    assert len(d.choose(crowd, np.full(40, 0.4 * 0.849))) == 40


def test_a_full_level_keeps_the_tallest():
    specs = (LevelSpec(above=0.4, capacity=10), LevelSpec(0.5, every=2))
    crowd = d.prepare(_tiny(specs), 40)
    heights = np.random.default_rng(1).permutation(np.linspace(0.5, 2.0, 40))
    d.choose(crowd, heights)
    assert crowd.shown == [10, 30]
    assert heights[crowd.level == 0].min() > heights[crowd.level == 1].max()


def test_members_and_places_agree_through_any_changes():
    crowd = flat(300)
    rng = np.random.default_rng(2)
    for _ in range(200):
        d.choose(crowd, np.exp(rng.normal(-1.5, 1.0, 300)) * rng.uniform(0.1, 1))
        seen = np.zeros(300, int)
        for n, members in enumerate(crowd.members):
            who = members[members >= 0]
            seen[who] += 1
            assert np.all(crowd.level[who] == n)
            assert np.all(members[crowd.place[who]] == who)
            used = len(np.unique(np.nonzero(members >= 0)[0] // WIDTH))
            assert used <= max(-(-len(who) // WIDTH), 1.25 * -(-len(who) // WIDTH))
        assert np.all(seen == 1)


def test_updates_are_even_and_nobody_waits_longer_than_the_level_says():
    crowd = flat(40 * WIDTH)
    d.choose(crowd, np.full(40 * WIDTH, 0.1))  # all at the level of every fourth step
    d.begin(crowd)  # the first one draws everybody
    sizes = [len(d.begin(crowd)[2]) for _ in range(40)]
    assert set(sizes) == {10}
    d.choose(crowd, np.where(np.arange(40 * WIDTH) < 7 * WIDTH + 3, 0.3, 0.1))
    d.begin(crowd)
    for _ in range(40):
        blocks = d.begin(crowd)
        used = [len(np.unique(np.nonzero(m >= 0)[0] // WIDTH)) for m in crowd.members]
        for n, every in enumerate((1, 2, 4)):
            assert used[n] // every - 1 <= len(blocks[n]) <= -(-used[n] // every) + 1
            taken = np.any(crowd.members[n].reshape(-1, WIDTH) >= 0, axis=1)
            assert np.all(crowd.step - crowd.updated[n][taken] <= every)


def test_who_comes_new_is_skinned_at_once(levels, poses):
    models = in_lanes(evaluate.world(samples.load("human").character.skeleton, poses))
    crowd = d.prepare(levels, 40)
    d.choose(crowd, np.full(40, 0.01))
    for _ in range(5):
        d.skin(crowd, models)
    d.choose(crowd, np.where(np.arange(40) == 17, 1.0, 0.01))
    assert len(d.skin(crowd, models)[0]) == 1
    positions, _ = d.vertices_of(crowd, 17)
    assert positions[:, 1].max() > 1.4


def test_what_does_not_fit_is_refused(levels):
    with pytest.raises(ShapeError, match="at least one level"):
        d.prepare(levels, 0)
    crowd = flat()
    with pytest.raises(ShapeError, match="heights"):
        d.choose(crowd, np.zeros(3))
    with pytest.raises(ShapeError, match="heights"):
        d.choose(crowd, np.full(40, np.nan))
    with pytest.raises(ShapeError, match="hysteresis"):
        d.choose(crowd, np.ones(40), hysteresis=1.0)
    with pytest.raises(ShapeError, match="placed"):
        d.vertices_of(crowd, 0)
    with pytest.raises(ShapeError, match="models"):
        d.skin(crowd, np.zeros((1, 1, 12, WIDTH), np.float32))
    human = samples.load("human").character
    with pytest.raises(UnknownName, match="shirt"):
        build(human, (LevelSpec(without=("shrit",)),))
    for specs in ((), (LevelSpec(above=0.1),), (LevelSpec(above=0.1), LevelSpec(0.5, above=0.1)), (LevelSpec(0.0),)):
        with pytest.raises(ShapeError, match="specs"):
            build(human, specs)


def test_matrices_for_graphics_cards_move_the_mesh_as_skinning_does(levels, poses):
    human = samples.load("human").character
    models = np.array(evaluate.world(human.skeleton, poses))
    models[:, :, [0, 2], 3] -= models[:, :1, [0, 2], 3]  # where they are is said by their roots
    rng = np.random.default_rng(5)
    roots = np.concatenate([rng.uniform(-50, 50, (40, 2)), rng.uniform(-7, 7, (40, 1))], axis=1)
    sin, cos = np.sin(roots[:, 2]), np.cos(roots[:, 2])
    world = np.tile(np.eye(4), (40, 1, 1))
    world[:, 0, 0], world[:, 0, 2], world[:, 2, 0], world[:, 2, 2] = cos, sin, -sin, cos
    world[:, [0, 2], 3] = roots[:, :2]
    crowd = d.prepare(levels, 40)
    d.choose(crowd, np.geomspace(0.01, 1.0, 40))
    found = d.matrices(crowd, in_lanes(world[:, None] @ models), roots, d.begin(crowd), 1e-4)
    assert sorted(np.concatenate([who for who, _ in found]).tolist()) == list(range(40))
    for level, (who, small) in zip(levels, found, strict=True):
        rows = small.reshape(len(who), -1, 3, 4) * np.array([2.0**-14] * 3 + [1e-4])
        points = np.concatenate([level.mesh.positions, np.ones((level.mesh.vertex_count, 1))], axis=1)
        blended = np.einsum("vk,nvkrc->nvrc", level.skin.weights, rows[:, level.skin.joints])
        seen = np.einsum("nvrc,vc->nvr", blended, points)
        assert np.abs(seen - deform.skin(level.mesh, level.skin, models[who])).max() < 4e-4


@pytest.mark.data
def test_levels_of_a_real_character(data_dir):
    """A file with a vertex of its own for every corner of every triangle: still one closed surface, close to the finest."""
    from keypose import io

    character = io.load(data_dir / "gltf" / "khronos" / "Fox.glb").character
    fox = build(character)
    assert [level.triangle_count for level in fox] == [576, 576, 576, 300]
    assert fox[3].mesh.vertex_count < 400  # of 900 corners
    size = np.ptp(fox[0].mesh.positions, axis=0).max()
    assert fox[3].error.rms_m < 0.01 * size
    for level in fox:
        assert np.abs(level.skin.weights.sum(axis=1) - 1).max() < 1e-6
    models = np.asarray(evaluate.world(character.skeleton, character.skeleton.rest))[None].repeat(3, axis=0)
    crowd = d.prepare(fox, 3)
    d.choose(crowd, np.array([1.0, 0.1, 0.01]))
    d.skin(crowd, in_lanes(models))
    for n in range(3):
        level = fox[crowd.level[n]]
        assert np.abs(d.vertices_of(crowd, n)[0] - deform.skin(level.mesh, level.skin, models[n])).max() < 1e-5 * size


def test_flat_meshes_are_welded_but_hard_edges_stay():
    """Each triangle of a sphere on its own: welded, it goes to few triangles; of a cube nothing becomes round."""
    from keypose.model import Character, Mesh, Part, Skeleton, Skin

    def levels_of(positions, triangles):
        own = positions[triangles].reshape(-1, 3).astype(np.float32)
        skin = Skin(np.array([0]), np.eye(4)[None], np.zeros((len(own), 1), int), np.ones((len(own), 1), np.float32))
        rest = Pose(np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.ones((1, 3)))
        part = Part("all", Mesh(own, np.arange(len(own)).reshape(-1, 3)), skin=skin)
        return build(
            Character(Skeleton(("root",), np.array([-1]), rest), (part,)), (LevelSpec(above=0.1), LevelSpec(0.25))
        )

    angle = np.linspace(0, np.pi, 25)[:, None], np.linspace(0, 2 * np.pi, 49)[None]
    ball = np.stack(
        np.broadcast_arrays(np.sin(angle[0]) * np.cos(angle[1]), np.cos(angle[0]), np.sin(angle[0]) * np.sin(angle[1])),
        -1,
    )
    ball = np.round(ball, 6) + 0.0
    ball[:, -1] = ball[:, 0]
    corner = (np.arange(24)[:, None] * 49 + np.arange(48)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + 49], 1), np.stack([corner + 1, corner + 50, corner + 49], 1)]
    )
    fine, coarse = levels_of(ball.reshape(-1, 3), faces)
    assert coarse.triangle_count <= 0.26 * fine.triangle_count
    assert coarse.error.max_m < 0.06
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    box = levels_of(cube, np.array([t for a, b, c, e in sides for t in ((a, b, c), (a, c, e))]))[1]
    assert np.abs(np.abs(box.mesh.normals).max(axis=1) - 1).max() < 1e-6
