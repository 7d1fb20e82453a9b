"""The figure of bones follows its skeleton exactly."""

import numpy as np
import pytest

from keypose import deform, evaluate, io
from keypose.model import Character, Pose, Scene, Skeleton
from keypose.render import DARK, Camera, RenderSettings, render_image
from keypose.render.bones import axes_figure, bones_figure, figure_joints, side_of, sides
from tests.conftest import data_files

LEFT = [
    "LeftArm",
    "leftHand",
    "mixamorig:LeftUpLeg",
    "L_Wrist",
    "arm.L",
    "arm_l",
    "Bip01 L Thigh",
    "lThumb1",
    "handL",
    "foot_L_01",
]
RIGHT = ["RightArm", "right_foot", "R_Wrist", "arm.R", "hand_r", "Bip01 R Thigh", "rShin", "handR"]
CENTER = ["Hips", "Spine1", "Neck", "Head", "pelvis", "root", "LowerBack", "jaw", "rig", "collar", "Lumbar", "Ribs"]


@pytest.mark.parametrize(("names", "side"), [(LEFT, 1), (RIGHT, -1), (CENTER, 0)])
def test_names_tell_the_side(names, side):
    assert [(n, side_of(n)) for n in names] == [(n, side) for n in names]


def random_skeleton(seed, joints=30, scale=1.0):
    random = np.random.default_rng(seed)
    parents = np.array([-1] + [int(random.integers(0, j)) for j in range(1, joints)])
    leaves = [j for j in range(joints) if j not in parents]
    q = random.normal(size=(joints, 4))
    rest = Pose(
        scale * random.normal(size=(joints, 3)), q / np.linalg.norm(q, axis=1, keepdims=True), np.ones((joints, 3))
    )
    ends = tuple((j, tuple(scale * random.normal(size=3))) for j in leaves)
    return Skeleton(tuple(f"j{i}" for i in range(joints)), parents, rest, ends)


def test_sides_fall_back_to_the_rest_pose():
    rest = Pose([[0, 1, 0], [0.5, 0, 0], [-0.5, 0, 0]], np.tile([1.0, 0, 0, 0], (3, 1)), np.ones((3, 3)))
    np.testing.assert_array_equal(sides(Skeleton(("a", "b", "c"), [-1, 0, 0], rest)), [0, 1, -1])


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_bones_start_at_their_joint_and_end_at_the_next(scale):
    skeleton = random_skeleton(1, scale=scale)
    figure = bones_figure(skeleton, DARK)
    random = np.random.default_rng(2)
    q = random.normal(size=(5, 30, 4))
    # longer and shorter bones than at rest, too
    moved = np.tile(skeleton.rest.translations, (5, 1, 1)) * random.uniform(0.8, 1.3, (5, 30, 1))
    pose = Pose(moved, q / np.linalg.norm(q, axis=-1, keepdims=True), np.ones((30, 3)))
    world = evaluate.world(skeleton, pose)
    matrices = figure.matrices(world)
    mesh = figure.character.parts[0].mesh
    pieces = figure.character.parts[0].skin.joints[:, 0]
    tip_of_end = dict(skeleton.end_offsets)
    for t in range(5):
        vertices = deform.deform_part(figure.character, figure.character.parts[0], matrices[t])
        for p, (joint, tip) in enumerate(zip(figure.joints, figure.tips, strict=True)):
            own = vertices[pieces == p]
            start = world[t, joint, :3, 3]
            if tip >= 0:
                goal = world[t, tip, :3, 3]
            elif p < len(figure.joints) - 30:
                goal = world[t, joint, :3, :3] @ tip_of_end[joint] + start
            else:
                np.testing.assert_allclose(own.mean(axis=0), start, atol=2e-5 * scale)  # a joint's sphere
                continue
            for place in (start, goal):
                assert np.linalg.norm(own - place, axis=1).min() < 3e-5 * scale
    assert np.all(np.linalg.det(matrices[..., :3, :3]) > 0)
    assert mesh.vertex_count == len(pieces)


def test_scaled_joints_do_not_scale_the_figure():
    skeleton = random_skeleton(3)
    world = np.array(evaluate.world(skeleton, skeleton.rest))[None]
    scaled = world.copy()
    scaled[..., :3, :3] *= 7.0
    figure = bones_figure(skeleton, DARK)
    np.testing.assert_allclose(figure.matrices(world), figure.matrices(scaled), atol=1e-6)


def test_faces_look_outwards():
    mesh = bones_figure(random_skeleton(4), DARK).character.parts[0].mesh
    a, b, c = (mesh.positions[mesh.triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    assert np.sum(face * mesh.normals[mesh.triangles[:, 0]], axis=1).min() > 0.8


def test_axes_point_along_the_joints_axes():
    skeleton = random_skeleton(5)
    figure = axes_figure(skeleton)
    world = np.array(evaluate.world(skeleton, skeleton.rest))[None]
    vertices = deform.deform_part(figure.character, figure.character.parts[0], figure.matrices(world)[0])
    per_joint = len(vertices) // 30
    for j in range(30):
        own = vertices[j * per_joint : (j + 1) * per_joint].reshape(3, -1, 3) - world[0, j, :3, 3]
        tips = own[:, -1] / np.linalg.norm(own[:, -1], axis=1, keepdims=True)
        np.testing.assert_allclose(tips, world[0, j, :3, :3].T, atol=1e-4)


def test_a_skeleton_without_bones_still_shows():
    rest = Pose(np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.ones((1, 3)))
    scene = Scene((Character(Skeleton(("only",), [-1], rest)),))
    picture = render_image(
        scene, settings=RenderSettings(width=64, height=64, transparent=True, ground=False, backend="cpu")
    )
    assert (picture[..., 3] > 128).sum() > 100


@pytest.mark.data
@pytest.mark.parametrize("path", data_files("bvh/*/tpose.bvh") + data_files("cmu_01_01/*.bvh"), ids=lambda p: p.stem)
def test_real_skeletons_fill_the_picture(path):
    settings = RenderSettings(
        width=200, height=200, transparent=True, ground=False, backend="cpu", camera=Camera.front()
    )
    alpha = render_image(io.load(path), settings=settings)[..., 3]
    rows = np.nonzero(alpha.max(axis=1))[0]
    assert 0.5 < np.ptp(rows) / 200 < 0.9
    assert (alpha > 0).mean() > 0.02


def test_roots_with_nothing_below_are_no_part_of_a_figure() -> None:
    places = np.array([[50.0, 0, 0], [0, 1, 0], [0, 0.5, 0]])
    pose = Pose(places, np.tile([1.0, 0, 0, 0], (3, 1)), np.ones((3, 3)))
    assert figure_joints(Skeleton(("camera", "hips", "spine"), np.array([-1, -1, 1]), pose)).tolist() == [1, 2]
    assert figure_joints(Skeleton(("a", "b", "c"), np.array([-1, -1, -1]), pose)).tolist() == [0, 1, 2]
