"""Retargeting: laws on changed skeletons, real motions on real characters, an independent result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from keypose import evaluate, samples
from keypose.editing.planting import PlantOptions, plant_feet
from keypose.errors import KeyposeError, ShapeError
from keypose.math import quat
from keypose.model import Motion, Pose, Scene, Skeleton
from keypose.retarget import body_frames, find_stand, retarget


@pytest.fixture(scope="module")
def walk() -> Scene:
    return samples.open_scene("sample:walk")


def motion_of(scene: Scene) -> Motion:
    animation = scene.animations[0]
    return animation if isinstance(animation, Motion) else evaluate.bake(animation, scene.character.skeleton, 30.0)


def places(skeleton: Skeleton, pose: Pose) -> np.ndarray:
    return np.asarray(evaluate.world_rotations_positions(skeleton, pose.broadcast())[1], np.float64)


def reoriented(skeleton: Skeleton, rng: np.random.Generator) -> Skeleton:
    """The same body with other axes in every joint."""
    turned, where = (np.asarray(a, np.float64) for a in evaluate.world_rotations_positions(skeleton, skeleton.rest))
    axes = quat.normalize(rng.normal(size=turned.shape))
    model = quat.multiply(turned, axes)
    translations, rotations = np.array(where), np.array(model)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            back = quat.conjugate(model[parent])
            translations[joint] = quat.rotate(back, where[joint] - where[parent])
            rotations[joint] = quat.multiply(back, model[joint])
    return replace(skeleton, rest=Pose(translations, rotations, skeleton.rest.scales))


def test_the_same_skeleton_gets_the_same_motion(walk: Scene) -> None:
    skeleton, motion = walk.character.skeleton, motion_of(walk)
    done = retarget(motion, skeleton, skeleton, plant=None)
    moved = places(skeleton, done.motion.pose) - places(skeleton, motion.pose)
    moved -= moved[:, :1].mean(axis=0)  # the ground is found anew
    level = [j for j, name in enumerate(skeleton.names) if "Toe" not in name and "Twist" not in name]
    assert np.abs(moved[:, level]).max() < 1e-3
    assert done.notes == ()


def test_other_axes_in_every_joint_change_nothing(walk: Scene) -> None:
    skeleton, motion = walk.character.skeleton, motion_of(walk)
    other = reoriented(skeleton, np.random.default_rng(3))
    roles = walk.character.roles
    plain = retarget(motion, skeleton, skeleton, source_roles=roles, target_roles=roles)
    done = retarget(motion, skeleton, other, source_roles=roles, target_roles=roles)
    np.testing.assert_allclose(places(other, done.motion.pose), places(skeleton, plain.motion.pose), atol=2e-4)


def test_a_larger_body_walks_further(walk: Scene) -> None:
    skeleton, motion = walk.character.skeleton, motion_of(walk)
    large = replace(skeleton, rest=replace(skeleton.rest, translations=1.3 * np.asarray(skeleton.rest.translations)))
    plain, done = (retarget(motion, skeleton, target, plant=None) for target in (skeleton, large))
    np.testing.assert_allclose(places(large, done.motion.pose), 1.3 * places(skeleton, plain.motion.pose), atol=2e-4)
    short = retarget(motion, skeleton, large, plant=None, scale=0.5)
    hips = large.names.index("Hips")
    way, asked = (p[-1, hips] - p[0, hips] for p in (places(large, short.motion.pose), places(skeleton, motion.pose)))
    np.testing.assert_allclose(way[[0, 2]], 0.5 * asked[[0, 2]], atol=1e-3)


def test_hanging_and_spread_arms_at_rest_agree(walk: Scene) -> None:
    """The same body whose rest pose has its arms lowered: bones still point where the source's do."""
    skeleton, motion = walk.character.skeleton, motion_of(walk)
    rotations = np.array(skeleton.rest.rotations, np.float64)
    for name, sign in (("LeftArm", -1.0), ("RightArm", 1.0)):
        joint = skeleton.names.index(name)
        turn = quat.from_axis_angle(np.array([0.0, 0.0, 1.0]), np.array(sign * 0.6))
        rotations[joint] = quat.multiply(turn, rotations[joint])
    lowered = replace(skeleton, rest=replace(skeleton.rest, rotations=rotations))
    done = retarget(motion, skeleton, lowered, plant=None)
    for bone in ("left_upper_arm", "right_lower_arm", "left_lower_leg"):
        assert done.report.direction_deg[bone] < 0.05
    plain = retarget(motion, skeleton, skeleton, plant=None)
    hands = [skeleton.names.index(n) for n in ("LeftHandIndex1", "RightHandIndex1")]
    apart = places(lowered, done.motion.pose)[:, hands] - places(skeleton, plain.motion.pose)[:, hands]
    assert np.abs(apart).max() < 0.02


def test_a_source_that_faces_another_way_walks_the_same_way(walk: Scene) -> None:
    skeleton, motion = walk.character.skeleton, motion_of(walk)
    half = quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), np.array(np.pi / 2))
    rotations = np.array(skeleton.rest.rotations, np.float64)
    rotations[0] = quat.multiply(half, rotations[0])
    turned = replace(skeleton, rest=replace(skeleton.rest, rotations=rotations))
    plain, done = retarget(motion, skeleton, skeleton), retarget(motion, skeleton, turned)
    np.testing.assert_allclose(places(turned, done.motion.pose), places(skeleton, plain.motion.pose), atol=1e-3)


def test_a_rest_pose_that_lies_is_turned_upright(walk: Scene) -> None:
    skeleton, motion = walk.character.skeleton, motion_of(walk)
    lay = quat.from_axis_angle(np.array([1.0, 0.0, 0.0]), np.array(-np.pi / 2))
    rest = skeleton.rest
    rotations, translations = np.array(rest.rotations, np.float64), np.array(rest.translations, np.float64)
    rotations[0], translations[0] = quat.multiply(lay, rotations[0]), quat.rotate(lay, translations[0])
    lying = replace(skeleton, rest=Pose(translations, rotations, rest.scales))
    found, note = find_stand(lying, walk.character.roles)
    assert found is not None and "upright" in note
    np.testing.assert_allclose(places(lying, found), places(skeleton, rest), atol=1e-5)
    done = retarget(motion, skeleton, lying)
    assert any("target" in note for note in done.notes)
    plain = retarget(motion, skeleton, skeleton)
    np.testing.assert_allclose(places(lying, done.motion.pose), places(skeleton, plain.motion.pose), atol=1e-3)


@pytest.mark.data
def test_planting_twice_changes_nothing(data_dir: Path) -> None:
    source = samples.open_scene(str(data_dir / "asf_amc/cmu_02/02_01.amc"))
    body = samples.open_scene("sample:human").character
    done = retarget(source.animations[0], source.character.skeleton, body.skeleton, plant=None)
    heights = done.target.places[:, 1]
    first = plant_feet(done.motion, body.skeleton, body.roles, heights=heights)
    second = plant_feet(first.motion, body.skeleton, body.roles, touching=first.touching, heights=heights)
    moved = places(body.skeleton, second.motion.pose) - places(body.skeleton, first.motion.pose)
    assert first.short_m < 5e-3
    assert np.abs(moved).max() < 2e-3  # legs out of reach the first time
    assert second.moved_m.max() < 0.1 * first.moved_m.max()


def test_a_motion_without_contacts_is_left_alone(walk: Scene) -> None:
    skeleton, motion = walk.character.skeleton, motion_of(walk)
    none = {f"{s}_{p}": np.zeros(motion.frame_count, bool) for s in ("left", "right") for p in ("heel", "ball")}
    done = plant_feet(motion, skeleton, walk.character.roles, touching=none)
    np.testing.assert_allclose(places(skeleton, done.motion.pose), places(skeleton, motion.pose), atol=1e-6)


def test_wrong_input_is_refused(walk: Scene) -> None:
    skeleton, motion = walk.character.skeleton, motion_of(walk)
    stick = Skeleton(("a", "b"), np.array([-1, 0]), Pose(np.zeros((2, 3)), quat.identity((2,)), np.ones((2, 3))))
    with pytest.raises(KeyposeError, match="no humanoid"):
        retarget(motion, skeleton, stick)
    with pytest.raises(KeyposeError, match="no humanoid"):
        body_frames(stick, {"hips": 0})
    with pytest.raises(ShapeError, match="scale"):
        retarget(motion, skeleton, skeleton, scale=-1.0)
    with pytest.raises(ShapeError, match="no frames"):
        empty = replace(
            motion,
            pose=Pose(
                *(
                    a[:0]
                    for a in (
                        motion.pose.broadcast().translations,
                        motion.pose.broadcast().rotations,
                        motion.pose.broadcast().scales,
                    )
                )
            ),
            morph_weights=None,
            morph_names=(),
        )
        retarget(empty, skeleton, skeleton)
    with pytest.raises(ShapeError, match="options"):
        PlantOptions(height_m=0.0)
