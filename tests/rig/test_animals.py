"""Rigs of animals on all fours: four legs that stand, a back, a neck, a tail."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from keypose import evaluate, samples
from keypose.errors import KeyposeError
from keypose.math import quat
from keypose.model import FollowModule, LimbModule, Motion, Pose, SpineModule
from keypose.rig import (
    auto_rig,
    bake_rig,
    evaluate_rig,
    fit_controls,
    match_fk_to_ik,
    match_ik_to_fk,
    mirror_controls,
    solve_rig,
)
from tests.animals import dog
from tests.rig.bodies import apart, double, moved, places, random_controls

LEGS = ("foreleg.L", "foreleg.R", "leg.L", "leg.R")


@pytest.mark.parametrize(("turned", "facing"), [(False, 0.0), (True, 0.0), (True, 130.0)])
def test_controls_at_rest_give_the_rest_pose_to_the_bit(turned: bool, facing: float) -> None:
    skeleton = dog(turned=turned, facing_deg=facing)
    rig = auto_rig(skeleton)
    assert [m.name for m in rig.modules if isinstance(m, LimbModule)] == ["foreleg.L", "leg.L", "foreleg.R", "leg.R"]
    assert {m.name for m in rig.modules if isinstance(m, FollowModule)} == {"body", "shoulder.L", "shoulder.R", "tail"}
    for ik in (0.0, 1.0):
        pose = evaluate_rig(rig, skeleton, values={f"{leg}.ik": ik for leg in LEGS} | {"spine.ik": ik})
        assert np.array_equal(pose.rotations, skeleton.rest.rotations)
        assert np.array_equal(pose.translations, skeleton.rest.translations)


def test_paws_stand_while_the_trunk_moves() -> None:
    skeleton = dog(turned=True)
    rig = auto_rig(skeleton)
    for name, module in ((m.name, m) for m in rig.modules if isinstance(m, LimbModule)):
        assert module.foot is not None and rig.attribute(f"{name}.ik").default == 1.0
    paws = [skeleton.index(f"{n}{s}") for n in ("Front3", "Rear3", "Rear4") for s in "LR"]
    pose = evaluate_rig(rig, skeleton, moved(rig, {"pelvis_control": ((0.02, -0.06, 0.03), (0.05, 0.1, 0.05))}))
    rest, now = places(skeleton, skeleton.rest), places(skeleton, pose)
    assert np.abs(now - rest)[paws].max() < 1e-9
    assert np.linalg.norm(now - rest, axis=-1)[skeleton.index("Skull")] > 0.03
    # knees go on bending forward and elbows backward
    for joint, sign in (("Rear2", 1.0), ("Front2", -1.0)):
        for side in "LR":
            upper, lower = joint[:-1] + "1", joint[:-1] + "3"
            middle, a, b = (now[skeleton.index(n + side)] for n in (joint, upper, lower))
            along = (b - a) / np.linalg.norm(b - a)
            bend = middle - a - along * ((middle - a) @ along)
            assert sign * bend[2] > 0.01


@pytest.mark.parametrize(("goal", "joint"), [("forefoot_ik.L", "Front3L"), ("foot_ik.R", "Rear3R")])
def test_a_goal_moves_its_paw(goal: str, joint: str) -> None:
    skeleton = dog(turned=True)
    rig = auto_rig(skeleton)
    solved = solve_rig(rig, skeleton, moved(rig, {goal: ((0.01, 0.08, 0.05), (0.0, 0.1, 0.0))}))
    now = places(skeleton, solved.pose)
    at = solved.model_from_control[rig.controls.index(goal), :3, 3]
    assert np.abs(now[skeleton.index(joint)] - at).max() < 1e-9
    still = [skeleton.index(n) for n in ("Front3R", "Rear3L", "Skull", "Tail4")]
    assert np.abs(now - places(skeleton, skeleton.rest))[still].max() < 1e-9


def test_a_paw_rolls_over_its_ball() -> None:
    skeleton = dog()
    rig = auto_rig(skeleton)
    for leg, joint in (("foreleg.L", "Front3L"), ("leg.L", "Rear3L")):
        module = rig.module(leg)
        assert isinstance(module, LimbModule) and module.foot is not None
        pose = evaluate_rig(rig, skeleton, values={f"{module.foot.name}.roll": 0.4})
        rest, now = (places(skeleton, p)[skeleton.index(joint)] for p in (skeleton.rest, pose))
        ball = np.array(module.foot.ball)
        assert np.linalg.norm(now - ball) == pytest.approx(np.linalg.norm(rest - ball), abs=1e-9)
        a, b = rest - ball, now - ball
        assert np.arccos(a @ b / (a @ a)) == pytest.approx(0.4, abs=1e-6)
        assert now[2] > rest[2] + 0.01, "it goes forward over the ball"


def test_the_tail_and_the_back_follow_their_controls() -> None:
    skeleton = dog(turned=True)
    rig = auto_rig(skeleton)
    wag = evaluate_rig(rig, skeleton, moved(rig, {"tail.2": ((0, 0, 0), (0.0, 0.0, 0.6))}))
    step = np.linalg.norm(places(skeleton, wag) - places(skeleton, skeleton.rest), axis=-1)
    assert step[skeleton.index("Tail4")] > 0.05
    assert np.delete(step, [skeleton.index("Tail3"), skeleton.index("Tail4")]).max() < 1e-9
    (spine,) = (m for m in rig.modules if isinstance(m, SpineModule))
    # controls bend about their X: the back arches up and down, it does not lean aside
    for control in (*spine.controls, "neck.1"):
        bent = evaluate_rig(rig, skeleton, moved(rig, {control: ((0, 0, 0), (0.3, 0, 0))}))
        away = (
            places(skeleton, bent)[skeleton.index("Skull")] - places(skeleton, skeleton.rest)[skeleton.index("Skull")]
        )
        assert abs(away[0]) < 1e-9 and away[1] < -0.01


def test_matching_and_mirroring() -> None:
    skeleton = dog(turned=True)
    rig = auto_rig(skeleton)
    controls = random_controls(rig, np.random.default_rng(3), size=0.02)
    before = evaluate_rig(rig, skeleton, controls, {f"{leg}.ik": 0.0 for leg in LEGS})
    there, values = match_ik_to_fk(rig, skeleton, controls, {f"{leg}.ik": 0.0 for leg in LEGS})
    assert (
        apart(skeleton, before, evaluate_rig(rig, skeleton, there, values | {f"{leg}.ik": 1.0 for leg in LEGS})) < 1e-6
    )
    back, values = match_fk_to_ik(rig, skeleton, there, values | {f"{leg}.ik": 1.0 for leg in LEGS})
    assert (
        apart(skeleton, before, evaluate_rig(rig, skeleton, back, values | {f"{leg}.ik": 0.0 for leg in LEGS})) < 1e-6
    )
    mirrored, values = mirror_controls(rig, controls, {"forefoot.L.roll": 0.3})
    now = places(skeleton, evaluate_rig(rig, skeleton, mirrored, values))
    one = places(skeleton, evaluate_rig(rig, skeleton, controls, {"forefoot.L.roll": 0.3}))
    for name in ("Front3", "Rear2", "Ear"):
        a, b = skeleton.index(f"{name}L"), skeleton.index(f"{name}R")
        assert np.abs(now[a] - one[b] * (-1, 1, 1)).max() < 1e-9
        assert np.abs(now[b] - one[a] * (-1, 1, 1)).max() < 1e-9


@pytest.mark.parametrize("seed", [1, 2])
def test_any_motion_comes_back_from_the_controls(seed: int) -> None:
    skeleton, rng = dog(turned=True), np.random.default_rng(seed)
    rig = auto_rig(skeleton)
    wave = np.sin(np.linspace(0, 6, 40)[:, None, None] + rng.uniform(0, 6, (1, skeleton.joint_count, 3)))
    turns = quat.multiply(skeleton.rest.rotations, quat.from_rotation_vector(0.25 * wave))
    steps = np.broadcast_to(skeleton.rest.translations, (*turns.shape[:2], 3)).copy()
    steps[:, 1] += 0.05 * wave[:, 1]
    motion = Motion(skeleton.names, Pose(steps, turns, np.ones_like(steps)), 30.0, name="m")
    fit = fit_controls(rig, skeleton, motion)
    assert max(fit.fk_error_m, fit.ik_error_m, fit.error_m) < 1e-6
    again = bake_rig(rig, skeleton, fit.clip)
    assert np.abs(places(skeleton, again.pose) - places(skeleton, motion.pose)).max() < 1e-6


@pytest.mark.data
@pytest.mark.parametrize("gait", ["Survey", "Walk", "Run"])
def test_the_fox_is_keyed_by_its_controls(data_dir: Path, gait: str) -> None:
    scene = samples.open_scene(str(data_dir / "gltf/khronos/Fox.glb"))
    skeleton = double(scene.character.skeleton)
    rig = auto_rig(skeleton, character=scene.character)
    assert {f"tail.{n}" for n in (1, 2, 3)} <= set(rig.controls.names)
    clip = scene.animation(gait)
    motion = clip if isinstance(clip, Motion) else evaluate.bake(clip, skeleton, 30.0)
    fit = fit_controls(rig, skeleton, motion)
    size = float(np.ptp(places(skeleton, skeleton.rest)[:, 1]))
    assert max(fit.error_m, fit.fk_error_m, fit.ik_error_m) < 1e-6 * size
    again = bake_rig(rig, skeleton, fit.clip, start_s=motion.start_s, end_s=motion.times_s[-1])
    assert np.abs(places(skeleton, again.pose) - places(skeleton, motion.pose)).max() < 1e-6 * size


def test_what_is_neither_human_nor_animal_is_refused() -> None:
    skeleton = dog()
    with pytest.raises(KeyposeError, match="no humanoid or animal"):
        auto_rig(
            type(skeleton)(
                ("a", "b"), np.array([-1, 0], np.int32), Pose(np.zeros((2, 3)), quat.identity((2,)), np.ones((2, 3)))
            )
        )
