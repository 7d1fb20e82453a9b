"""The way back: motions become controls and joints again; real captures with the figures that are promised."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from keypose import evaluate, io, samples
from keypose.analysis import find_roles
from keypose.errors import KeyposeError, ShapeError
from keypose.model import (
    Channel,
    Clip,
    Curve,
    CurveKind,
    Document,
    LimbModule,
    Motion,
    Pose,
    Property,
    Skeleton,
    SpineModule,
)
from keypose.project import add_character
from keypose.rig import auto_rig, bake_rig, evaluate_rig, fit_controls, is_keyed, perform, rigged_skeleton, sample_rig
from keypose.rig.baking import alone
from tests.conftest import data_files
from tests.rig.bodies import apart, double, human, human_rig, places, random_controls


def performance(name: str) -> tuple[Skeleton, Motion]:
    scene = samples.load(name)
    skeleton = human().skeleton
    animation = scene.animations[0]
    motion = animation if isinstance(animation, Motion) else evaluate.bake(animation, skeleton, 30.0)
    return skeleton, evaluate.match(motion, skeleton)


@pytest.mark.parametrize("name", ["walk", "wave", "jump"])
def test_a_motion_on_controls_is_the_motion_again(name: str) -> None:
    skeleton, motion = performance(name)
    fit = fit_controls(human_rig(), skeleton, motion)
    assert fit.error_m < 1e-6
    assert fit.fk_error_m < 1e-12
    assert fit.ik_error_m < 1e-6
    baked = bake_rig(human_rig(), skeleton, fit.clip)
    assert (baked.frame_count, baked.rate_hz, baked.start_s) == (motion.frame_count, motion.rate_hz, motion.start_s)
    assert np.abs(places(skeleton, baked.pose) - places(skeleton, motion.pose)).max() < 2e-6


@pytest.mark.parametrize("span", [1024, 16], ids=["at once", "in pieces"])
def test_the_figures_of_a_fit_are_those_of_its_clip(monkeypatch: pytest.MonkeyPatch, span: int) -> None:
    monkeypatch.setattr("keypose.rig.fitting._SPAN", span)
    skeleton, motion = performance("walk")
    rng = np.random.default_rng(3)
    # bones that grow and shrink: FK follows them, IK by the lengths that the clip keeps
    t = np.array(motion.pose.broadcast().translations)
    t[:, skeleton.index("LeftForeArm")] *= 1 + 0.1 * rng.random((len(t), 1))
    motion = replace(motion, pose=replace(motion.pose.broadcast(), translations=t))
    fit = fit_controls(human_rig(), skeleton, motion, {"arm.L.ik": 1.0, "spine.ik": 1.0})
    assert fit.clip.curves[Channel("arm.L.ik", Property.VALUE)].values[0, 0] == 1.0
    baked = bake_rig(human_rig(), skeleton, fit.clip)
    apart_m = np.linalg.norm(places(skeleton, baked.pose) - places(skeleton, motion.pose), axis=-1).max()
    assert apart_m < 1e-5
    assert abs(apart_m - fit.error_m) < 1e-5
    assert max(fit.fk_error_m, fit.ik_error_m) < 1e-6


def test_controls_that_were_posed_come_back_as_poses() -> None:
    skeleton, rig, rng = human().skeleton, human_rig(), np.random.default_rng(5)
    values = {"foot.L.roll": 0.4, "hand.L.curl": 0.6, "arm.R.ik": 1.0, "spine.ik": 1.0, "head.look": 0.5}
    pose = evaluate_rig(rig, skeleton, random_controls(rig, rng, (30,), 0.03), values)
    fit = fit_controls(rig, skeleton, Motion(skeleton.names, pose, 30.0))
    assert fit.error_m < 1e-6
    again = bake_rig(rig, skeleton, fit.clip)
    assert apart(skeleton, again.pose, pose) < 1e-5


def test_limbs_without_room_for_rounding_stay_exact() -> None:
    """Straight limbs: the middle joint's place goes as the square root of the reach."""
    skeleton, rig = human().skeleton, human_rig()
    rest = skeleton.rest
    straight = np.array(rest.translations)
    for side in ("Left", "Right"):
        for lower, end in (("ForeArm", "Hand"), ("Leg", "Foot")):
            a, b = skeleton.index(f"{side}{lower}"), skeleton.index(f"{side}{end}")
            straight[b] = straight[a] / np.linalg.norm(straight[a]) * np.linalg.norm(straight[b])
    body = replace(skeleton, rest=Pose(straight, rest.rotations, rest.scales))
    rig = auto_rig(body, human().roles)
    motion = Motion(body.names, Pose(straight, np.tile(rest.rotations, (4, 1, 1)), rest.scales), 30.0)
    fit = fit_controls(rig, body, motion)
    assert fit.ik_error_m < 1e-6
    pose = evaluate_rig(rig, body)
    assert np.array_equal(pose.rotations, rest.rotations)


def test_a_knee_that_is_bent_backwards_at_rest_keeps_its_rest_and_bends_forwards() -> None:
    skeleton = human().skeleton
    t = np.array(skeleton.rest.translations)
    for side in ("Left", "Right"):
        knee, foot = skeleton.index(f"{side}Leg"), skeleton.index(f"{side}Foot")
        t[knee, 2] -= 0.02
        t[foot, 2] += 0.02
    body = replace(skeleton, rest=replace(skeleton.rest, translations=t))
    rig = auto_rig(body, human().roles)
    assert rig.attribute("leg.L.rest_bend").default == 1.0
    assert np.abs(evaluate_rig(rig, body).translations - t).max() < 1e-9
    foot_ik = rig.controls.index("foot_ik.L")
    lifted = np.array(rig.controls.rest.translations)
    lifted[foot_ik, 1] += 0.3
    pose = evaluate_rig(rig, body, Pose(lifted, rig.controls.rest.rotations, rig.controls.rest.scales))
    at = places(body, pose)
    hip, knee, foot = (at[body.index(n)] for n in ("LeftUpLeg", "LeftLeg", "LeftFoot"))
    assert ((knee - hip) - (foot - hip) * 0.5)[2] > 0.05
    fit = fit_controls(rig, body, evaluate.match(performance("walk")[1], body))
    assert fit.ik_error_m < 1e-6


# ---- timelines ---------------------------------------------------------------------------------------------------------


def rigged_document() -> Document:
    document = add_character(Document("p"), human())
    rig = replace(human_rig(), name="Robin", character="Robin")
    return replace(document, rigs={"Robin": rig})


def keyed(document: Document, curves: dict[Channel, Curve]) -> Document:
    clip = Clip(curves, "Robin", 25.0)
    return replace(document, clips={**document.clips, "Robin": clip})


def test_a_rig_moves_nothing_before_it_is_keyed() -> None:
    document = rigged_document()
    joints = {
        Channel("Hips", Property.TRANSLATION): Curve([0.0, 1.0], [[0, 1.0, 0], [0, 1.0, 1.0]]),
    }
    document = keyed(document, joints)
    rig, track = document.rigs["Robin"], document.timelines["Robin"]
    assert not is_keyed(rig, track, document.clips)
    (clip,) = perform(document, "Robin").animations
    assert isinstance(clip, Clip), "its keys are what is exported"
    document = keyed(document, joints | {Channel("pelvis", Property.TRANSLATION): Curve([0.0], [[0, 1.1, 0]])})
    assert is_keyed(rig, track, document.clips)
    (motion,) = perform(document, "Robin").animations
    assert isinstance(motion, Motion)
    assert motion.joint_names == human().skeleton.names


def test_export_bakes_what_the_rig_makes_of_layers(tmp_path: Path) -> None:
    document = rigged_document()
    skeleton, rig = human().skeleton, document.rigs["Robin"]
    rest = rig.controls.rest
    hand = rig.controls.index("hand_ik.L")
    far = rest.translations[hand] + [-0.2, 0.1, 0.2]
    document = keyed(
        document,
        {
            Channel("hand_ik.L", Property.TRANSLATION): Curve([0.0, 1.0], [rest.translations[hand], far]),
            Channel("arm.L.ik", Property.VALUE): Curve([0.0, 0.5], [[0.0], [1.0]]),
            Channel("pelvis", Property.TRANSLATION, 1): Curve([0.0, 1.0], [[0.9], [0.8]]),
            Channel("twists.follow", Property.VALUE): Curve([0.0], [[0.0]]),
            Channel("LeftArmTwist", Property.ROTATION): Curve(
                [0.0], [[np.cos(0.1), np.sin(0.1), 0, 0]], kind=CurveKind.ROTATION
            ),
        },
    )
    document = replace(document, timelines={"Robin": replace(document.timelines["Robin"], end_s=1.0)})
    (motion,) = perform(document, "Robin").animations
    assert isinstance(motion, Motion)
    assert motion.frame_count == 26
    sampled = sample_rig(rig, skeleton, document.timelines["Robin"], document.clips, motion.times_s)
    assert np.array_equal(sampled.pose.rotations, motion.pose.rotations)
    assert float(sampled.values["arm.L.ik"][5]) == pytest.approx(0.4)
    wish = sampled.model_from_control[-1, hand, :3, 3]
    assert np.abs(places(skeleton, motion.pose)[-1, skeleton.index("LeftHand")] - wish).max() < 1e-6
    twist = motion.pose.rotations[7, skeleton.index("LeftArmTwist")]
    assert np.allclose(twist, [np.cos(0.1), np.sin(0.1), 0, 0])
    # a file written from the project holds the same
    from keypose.project.file import save

    save(document, tmp_path / "p.keypose")
    scene = io.load(tmp_path / "p.keypose")
    io.save(scene, tmp_path / "p.glb")
    back = io.load(tmp_path / "p.glb")
    read = back.animations[0]
    read = read if isinstance(read, Motion) else evaluate.bake(read, back.character.skeleton, 25.0)
    hand_joint = back.character.skeleton.index("LeftHand")
    assert np.abs(places(back.character.skeleton, read.pose)[-1, hand_joint] - wish).max() < 1e-4


def test_joints_and_controls_are_one_skeleton_for_sampling() -> None:
    skeleton, rig = human().skeleton, human_rig()
    both = rigged_skeleton(rig, skeleton)
    assert both.names == (*skeleton.names, *rig.controls.names)
    assert both is rigged_skeleton(rig, skeleton)
    clip = Clip({Channel("pelvis", Property.TRANSLATION): Curve([0.0], [[0.0, 2.0, 0.0]])}, "c")
    solved = sample_rig(rig, skeleton, alone(clip), {"c": clip}, [0.0, 1.0])
    assert solved.pose.batch_shape == (2,)
    assert solved.model_from_control[0, rig.controls.index("pelvis"), 1, 3] == pytest.approx(2.0)


# ---- real skeletons ----------------------------------------------------------------------------------------------------

REAL = [
    "bvh/cmu_cgspeed/cmu_12_01_walk.bvh", "bvh/cmu_iclone_002/002_01.bvh", "bvh/fair1/dab.bvh", "bvh/freebvh/test_freebvh.bvh",
    "bvh/rokoko/jesse_dance.bvh", "makehuman/default.mhskel", "vrm/basic_armature.vrm", "vrm/debug_robot.vrm", "vrm/minimal.vrm",
    "fbx/geno/Geno.fbx", "fbx/ozz_pab/crossarms.fbx", "fbx/ozz_pab/skeleton.fbx", "fbx/ozz_pab/walk.fbx",
    "gltf/cc0/Knight.glb", "gltf/cc0/robot.glb", "gltf/khronos/cesium_man.gltf", "collada/ozz/astro_maya.dae",
    "usd/RiggedFigure.usdz", "asf_amc/cmu_02/02.asf",
]  # fmt: skip


@pytest.mark.data
@pytest.mark.parametrize("name", REAL)
def test_humanoids_of_every_kind_get_a_rig_that_keeps_their_rest_and_their_motion(data_dir: Path, name: str) -> None:
    if name.startswith("usd"):
        pytest.importorskip("pxr")
    scene = io.load(data_dir / name)
    character = scene.character
    skeleton = double(character.skeleton)
    rig = auto_rig(skeleton, find_roles(skeleton, known=character.roles or None), character=character)
    pose = evaluate_rig(rig, skeleton)
    for part in ("translations", "rotations", "scales"):
        assert np.abs(getattr(pose, part) - getattr(skeleton.rest, part)).max() < 1e-9, part
    both = {m.attribute("ik"): 1.0 for m in rig.modules if isinstance(m, (LimbModule, SpineModule))}
    assert (
        np.abs(places(skeleton, evaluate_rig(rig, skeleton, None, both)) - places(skeleton, skeleton.rest)).max() < 1e-6
    )
    if not scene.animations:
        return
    animation = scene.animations[0]
    motion = animation if isinstance(animation, Motion) else evaluate.bake(animation, skeleton, 30.0)
    motion = Motion(motion.joint_names, motion.pose[: min(200, motion.frame_count)], motion.rate_hz)
    fit = fit_controls(rig, skeleton, motion)
    assert max(fit.error_m, fit.ik_error_m) < 1e-4, (fit.error_m, fit.ik_error_m, fit.worst)
    assert fit.fk_error_m < 1e-6


@pytest.mark.data
@pytest.mark.parametrize("path", data_files("asf_amc/cmu_02/02_0[12].amc"), ids=lambda p: p.stem)
def test_cmu_captures_come_back_from_controls(path: Path) -> None:
    scene = io.load(path)
    skeleton = double(scene.character.skeleton)
    rig = auto_rig(skeleton)
    animation = scene.animations[0]
    motion = animation if isinstance(animation, Motion) else evaluate.bake(animation, skeleton, 120.0)
    motion = evaluate.match(motion, skeleton)
    fit = fit_controls(rig, skeleton, motion)
    print(
        f"{path.stem}: {motion.frame_count} frames, joints within {1e3 * fit.error_m:.2g} mm and {fit.error_deg:.2g} degrees; "
        f"all IK {1e3 * fit.ik_error_m:.2g} mm, all FK {1e3 * fit.fk_error_m:.2g} mm"
    )
    assert max(fit.error_m, fit.fk_error_m, fit.ik_error_m) < 1e-4
    baked = bake_rig(rig, skeleton, fit.clip)
    ends = [skeleton.index(n) for n in ("lhand", "rhand", "lfoot", "rfoot", "lradius", "rtibia")]
    assert np.abs(places(skeleton, baked.pose)[:, ends] - places(skeleton, motion.pose)[:, ends]).max() < 1e-6


def test_a_motion_without_frames_is_refused() -> None:
    skeleton, motion = performance("walk")
    with pytest.raises(ShapeError, match="at least one frame"):
        fit_controls(human_rig(), skeleton, replace(motion, pose=motion.pose[:0], morph_names=(), morph_weights=None))


def test_what_is_no_humanoid_gets_no_rig() -> None:
    skeleton = human().skeleton
    with pytest.raises(KeyposeError, match="nothing plays"):
        auto_rig(skeleton, {"hips": 0})
    rest = skeleton.rest
    lying = replace(skeleton, rest=Pose(rest.translations * 0, rest.rotations, rest.scales))
    with pytest.raises(KeyposeError, match="no stand"):
        auto_rig(lying, human().roles)
    tail = Skeleton(
        ("a", "b"), np.array([-1, 0]), Pose(np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), np.ones((2, 3)))
    )
    with pytest.raises(KeyposeError, match="no humanoid"):
        auto_rig(tail)
