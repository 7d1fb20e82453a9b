"""Laws of rigs on the built-in human: rest, batches, switches, goals, feet, spaces, look-at, fingers."""

from __future__ import annotations

import numpy as np
import pytest

from keypose import evaluate, samples
from keypose.errors import ShapeError, UnknownName
from keypose.math import quat
from keypose.model import FollowModule, LimbModule, Pose, Property, SpineModule, TwistModule
from keypose.rig import (
    auto_rig,
    evaluate_rig,
    match_fk_to_ik,
    match_ik_to_fk,
    solve_rig,
    switch_space,
)
from tests.rig.bodies import apart, human, human_rig, moved, places, random_controls, turns

RNG = np.random.default_rng


def test_controls_at_rest_give_the_rest_pose_to_the_bit() -> None:
    skeleton, rig = human().skeleton, human_rig()
    for values in ({}, {m.attribute("ik"): u for m in switched() for u in (0.0, 1.0)}, {"head.look": 1.0}):
        pose = evaluate_rig(rig, skeleton, None, values)
        for name in ("translations", "rotations", "scales"):
            assert np.array_equal(getattr(pose, name), getattr(skeleton.rest, name))
    solved = solve_rig(rig, skeleton)
    assert np.abs(solved.model_from_control - evaluate.world(rig.controls, rig.controls.rest)).max() < 1e-14


def switched() -> list[LimbModule | SpineModule]:
    return [m for m in human_rig().modules if isinstance(m, (LimbModule, SpineModule))]


def test_float32_stays_float32() -> None:
    character = samples.load("human").character
    rig = auto_rig(character.skeleton, character=character)
    pose = evaluate_rig(rig, character.skeleton, random_controls(rig, RNG(0)))
    assert pose.rotations.dtype == np.float32
    assert pose.translations.dtype == np.float32


@pytest.mark.parametrize("batch", [(), (0,), (1,), (7,), (2, 3)])
def test_batches_of_any_shape_are_the_poses_one_by_one(batch: tuple[int, ...]) -> None:
    skeleton, rig, rng = human().skeleton, human_rig(), RNG(1)
    controls = random_controls(rig, rng, batch)
    values = {a.name: rng.uniform(a.minimum, a.maximum, batch) for a in rig.attributes}
    whole = solve_rig(rig, skeleton, controls, values)
    assert whole.pose.batch_shape == batch
    assert whole.model_from_control.shape == (*batch, rig.controls.joint_count, 4, 4)
    for at in np.ndindex(batch):
        one = solve_rig(rig, skeleton, controls[at] if batch else controls, {n: v[at] for n, v in values.items()})
        assert apart(skeleton, one.pose, whole.pose[at] if batch else whole.pose) < 1e-7
        assert np.abs(one.model_from_control - whole.model_from_control[at]).max() < 1e-9


def test_one_pose_of_controls_with_many_values() -> None:
    skeleton, rig = human().skeleton, human_rig()
    pose = evaluate_rig(rig, skeleton, None, {"foot.L.roll": np.linspace(-1, 1, 5)})
    assert pose.batch_shape == (5,)
    assert apart(skeleton, pose[2], skeleton.rest) == 0


def test_joints_that_no_module_moves_are_those_of_the_base_pose() -> None:
    skeleton, rig, rng = human().skeleton, human_rig(), RNG(2)
    base = Pose(
        skeleton.rest.translations,
        quat.multiply(skeleton.rest.rotations, quat.from_rotation_vector(rng.normal(size=(skeleton.joint_count, 3)))),
        skeleton.rest.scales,
    )
    pose = evaluate_rig(rig, skeleton, None, {"twists.follow": 0.0, "eyes.look": 0.0}, base)
    free = [j for j, n in enumerate(skeleton.names) if n not in rig.joints or "Twist" in n or "Eye" in n]
    assert len(free) == 8
    assert np.array_equal(pose.rotations[free], base.rotations[free])
    hand = skeleton.index("LeftHand")
    assert np.abs(places(skeleton, pose)[hand] - places(skeleton, skeleton.rest)[hand]).max() < 1e-9


def test_the_root_carries_the_whole_body_and_scales_it() -> None:
    skeleton, rig = human().skeleton, human_rig()
    turn = np.array([0.0, 0.7, 0.0])
    body = evaluate_rig(rig, skeleton, moved(rig, {"root": ((0.3, 0.1, -0.2), turn)}))
    root = rig.controls.rest.translations[0]
    wanted = (
        quat.rotate(quat.from_rotation_vector(turn), places(skeleton, skeleton.rest) - root) + root + [0.3, 0.1, -0.2]
    )
    assert np.abs(places(skeleton, body) - wanted).max() < 1e-9
    scales = np.array(rig.controls.rest.scales)
    scales[0] = 2.0
    rest = rig.controls.rest
    twice = evaluate_rig(rig, skeleton, Pose(rest.translations, rest.rotations, scales))
    assert np.abs(places(skeleton, twice) - (root + 2 * (places(skeleton, skeleton.rest) - root))).max() < 1e-9


# ---- limbs -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("limb", ["arm.L", "arm.R", "leg.L", "leg.R"])
def test_a_goal_in_reach_is_reached_and_bones_keep_their_length(limb: str) -> None:
    skeleton, rig, rng = human().skeleton, human_rig(), RNG(3)
    module = rig.module(limb)
    assert isinstance(module, LimbModule)
    controls = random_controls(rig, rng, (200,))
    solved = solve_rig(rig, skeleton, controls, {f"{limb}.ik": 1.0})
    upper, middle, end = (skeleton.index(j) for j in module.joints)
    at, rest = places(skeleton, solved.pose), places(skeleton, skeleton.rest)
    bones = [np.linalg.norm(rest[b] - rest[a]) for a, b in ((upper, middle), (middle, end))]
    assert np.abs(np.linalg.norm(at[:, middle] - at[:, upper], axis=-1) - bones[0]).max() < 1e-9
    assert np.abs(np.linalg.norm(at[:, end] - at[:, middle], axis=-1) - bones[1]).max() < 1e-9
    goal = solved.model_from_control[:, rig.controls.index(module.goal)]
    wish = goal[:, :3, 3]
    near = np.linalg.norm(wish - at[:, upper], axis=-1) < sum(bones) - 1e-3
    assert near.sum() > 50
    assert np.abs(at[near, end] - wish[near]).max() < 1e-9
    # and the end is turned as the goal is, from rest to rest
    own = rig.controls.rest
    assert own is not None
    turned = quat.from_matrix(goal[:, :3, :3])
    at_rest = evaluate.world_rotations_positions(rig.controls, rig.controls.rest)[0][rig.controls.index(module.goal)]
    since = quat.multiply(turned, quat.conjugate(at_rest))
    posed = quat.multiply(turns(skeleton, solved.pose)[:, end], quat.conjugate(turns(skeleton, skeleton.rest)[end]))
    assert np.asarray(quat.angle_between(since, posed)).max() < 1e-7


def test_the_middle_joint_bends_towards_the_pole() -> None:
    skeleton, rig = human().skeleton, human_rig()
    for turn in np.linspace(0, 2 * np.pi, 9):
        pole = np.array([np.cos(turn), 0.0, np.sin(turn)])
        knee = rig.controls.index("knee.L")
        t = np.array(rig.controls.rest.translations)
        t[rig.controls.index("foot_ik.L"), 1] += 0.3
        hip = places(skeleton, skeleton.rest)[skeleton.index("LeftUpLeg")]
        t[knee] += hip + 2 * pole - evaluate.world(rig.controls, rig.controls.rest)[knee, :3, 3]
        pose = evaluate_rig(rig, skeleton, Pose(t, rig.controls.rest.rotations, rig.controls.rest.scales))
        at = places(skeleton, pose)
        start, middle, end = (at[skeleton.index(j)] for j in ("LeftUpLeg", "LeftLeg", "LeftFoot"))
        line = (end - start) / np.linalg.norm(end - start)
        beside = middle - start - line * ((middle - start) @ line)
        pole = pole - line * (pole @ line)
        assert beside @ pole / np.linalg.norm(beside) / np.linalg.norm(pole) > 1 - 1e-9


def test_out_of_reach_the_limb_is_straight_or_stretches_or_slows_down() -> None:
    skeleton, rig = human().skeleton, human_rig()
    far = moved(rig, {"hand_ik.L": ((2.0, 0.5, 0.0), (0, 0, 0))})
    shoulder, hand = skeleton.index("LeftArm"), skeleton.index("LeftHand")
    goal = solve_rig(rig, skeleton, far).model_from_control[rig.controls.index("hand_ik.L"), :3, 3]

    def reach(**values: float) -> tuple[float, np.ndarray]:
        given = {f"arm.L.{name}": value for name, value in values.items()} | {"arm.L.ik": 1.0}
        at = places(skeleton, evaluate_rig(rig, skeleton, far, given))
        return float(np.linalg.norm(at[hand] - at[shoulder])), at

    rest = places(skeleton, skeleton.rest)
    elbow = skeleton.index("LeftForeArm")
    length = np.linalg.norm(rest[elbow] - rest[shoulder]) + np.linalg.norm(rest[hand] - rest[elbow])
    straight, at = reach()
    assert straight == pytest.approx(length, abs=1e-9)
    line = (goal - at[shoulder]) / np.linalg.norm(goal - at[shoulder])
    assert np.allclose((at[hand] - at[shoulder]) / straight, line, atol=1e-7)
    stretched, at = reach(stretch=1.0)
    assert np.abs(at[hand] - goal).max() < 1e-9
    assert reach(stretch=0.5)[0] == pytest.approx((straight + stretched) / 2)
    assert reach(soft=0.2)[0] < straight


def test_soft_reach_is_smooth_where_hard_reach_snaps() -> None:
    skeleton, rig = human().skeleton, human_rig()
    steps = np.linspace(0.0, 0.25, 251)
    t = np.broadcast_to(rig.controls.rest.translations, (len(steps), *rig.controls.rest.translations.shape)).copy()
    out = np.array([1.0, -1.0, 0.0]) / np.sqrt(2)
    t[:, rig.controls.index("hand_ik.L")] += steps[:, None] * out
    controls = Pose(t, rig.controls.rest.rotations, rig.controls.rest.scales)
    elbow = skeleton.index("LeftForeArm")

    def jerkiness(soft: float) -> float:
        at = places(skeleton, evaluate_rig(rig, skeleton, controls, {"arm.L.ik": 1.0, "arm.L.soft": soft}))[:, elbow]
        return float(np.abs(np.diff(at, 2, axis=0)).max())

    assert jerkiness(0.1) < 0.2 * jerkiness(0.0)


def test_switching_between_fk_and_ik_does_not_jump_after_matching() -> None:
    skeleton, rig, rng = human().skeleton, human_rig(), RNG(4)
    controls = random_controls(rig, rng, (20,))
    limbs = [m.name for m in switched()]
    fk = {f"{name}.ik": 0.0 for name in limbs}
    before = evaluate_rig(rig, skeleton, controls, fk)
    posed, values = match_ik_to_fk(rig, skeleton, controls, fk)
    assert np.allclose(values["arm.L.ik"], 0.0), "the switch itself stays"
    for share in (0.0, 0.3, 1.0):
        after = evaluate_rig(rig, skeleton, posed, values | {f"{name}.ik": share for name in limbs})
        assert apart(skeleton, after, before) < 3e-6
    ik = {f"{name}.ik": 1.0 for name in limbs} | {"foot.L.roll": 0.4, "spine.stretch": 1.0}
    before = evaluate_rig(rig, skeleton, controls, ik)
    posed, values = match_fk_to_ik(rig, skeleton, controls, ik)
    after = evaluate_rig(rig, skeleton, posed, values | {f"{name}.ik": 0.0 for name in limbs})
    assert np.abs(places(skeleton, after) - places(skeleton, before)).max() < 1e-9


def test_matching_names_its_modules() -> None:
    skeleton, rig = human().skeleton, human_rig()
    controls = random_controls(rig, RNG(5))
    posed, _ = match_ik_to_fk(rig, skeleton, controls, {"arm.L.ik": 0.0}, modules=["arm.L"])
    changed = {
        name
        for n, name in enumerate(rig.controls.names)
        if np.abs(posed.translations[n] - controls.translations[n]).max() > 1e-9
    }
    assert changed == {"hand_ik.L", "elbow.L"}
    with pytest.raises(ShapeError, match="module 'head' has no IK"):
        match_ik_to_fk(rig, skeleton, controls, modules=["head"])
    with pytest.raises(UnknownName, match=r"no module 'arm\.l'; nearest: 'arm\.L'"):
        match_fk_to_ik(rig, skeleton, controls, modules=["arm.l"])


def test_the_chest_goal_is_reached_and_bends_what_fk_gives() -> None:
    skeleton, rig, rng = human().skeleton, human_rig(), RNG(6)
    controls = random_controls(rig, rng, (50,))
    solved = solve_rig(rig, skeleton, controls, {"spine.ik": 1.0})
    chest, goal = skeleton.index("Spine2"), rig.controls.index("chest_ik")
    at = places(skeleton, solved.pose)[:, chest]
    assert np.abs(at - solved.model_from_control[:, goal, :3, 3]).max() < 1e-9
    short = evaluate_rig(rig, skeleton, controls, {"spine.ik": 1.0, "spine.stretch": 0.0})
    spine = places(skeleton, short)
    rest = places(skeleton, skeleton.rest)
    a, b = skeleton.index("Spine"), skeleton.index("Spine1")
    forward = evaluate_rig(rig, skeleton, controls, {"spine.ik": 0.0})
    lengths = np.linalg.norm(places(skeleton, forward)[:, b] - places(skeleton, forward)[:, a], axis=-1)
    assert np.allclose(np.linalg.norm(spine[:, b] - spine[:, a], axis=-1), lengths)
    assert rest.shape == spine.shape[1:]


# ---- feet --------------------------------------------------------------------------------------------------------------


def in_foot(skeleton, pose: Pose, joint: str, point) -> np.ndarray:
    """Where a point of the rest pose that is fixed to a joint goes."""
    j = skeleton.index(joint)
    rest, now = evaluate.world(skeleton, skeleton.rest)[j], evaluate.world(skeleton, pose)[..., j, :, :]
    local = np.linalg.inv(rest) @ np.array([*point, 1.0])
    return (now @ local)[..., :3]


@pytest.mark.parametrize(
    ("attribute", "value", "pivot", "joint"),
    [
        ("roll", -0.6, "heel", "LeftFoot"),
        ("roll", -0.6, "heel", "LeftToeBase"),
        ("roll", 0.5, "ball", "LeftFoot"),
        ("roll", 0.5, "ball", "LeftToeBase"),
        ("roll", 0.5, "tip", "LeftToeBase"),
        ("roll", 1.4, "tip", "LeftToeBase"),
        ("heel", 0.4, "heel", "LeftFoot"),
        ("ball", 0.4, "ball", "LeftFoot"),
        ("tip", 0.4, "tip", "LeftToeBase"),
        ("tip", 0.4, "tip", "LeftFoot"),
        ("bank", 0.3, "right", "LeftFoot"),
        ("bank", -0.3, "left", "LeftFoot"),
        ("swivel", 0.5, "ball", "LeftFoot"),
    ],
)
def test_a_rolling_foot_keeps_what_it_stands_on_where_it_is(
    attribute: str, value: float, pivot: str, joint: str
) -> None:
    skeleton, rig = human().skeleton, human_rig()
    module = rig.module("leg.L")
    assert isinstance(module, LimbModule)
    assert module.foot is not None
    point = np.array(getattr(module.foot, pivot))
    # a bent knee, so that the leg reaches whatever the foot does
    controls = moved(rig, {"pelvis": ((0, -0.25, 0), (0, 0, 0))})
    pose = evaluate_rig(rig, skeleton, controls, {f"foot.L.{attribute}": value})
    assert np.abs(in_foot(skeleton, pose, joint, point) - point).max() < 1e-9
    flat = evaluate_rig(rig, skeleton, controls)
    angle = quat.angle_between(turns(skeleton, pose), turns(skeleton, flat))[skeleton.index("LeftFoot")]
    assert angle == pytest.approx(abs(value), abs=1e-7)
    other = skeleton.index("RightFoot")
    assert np.abs(places(skeleton, pose)[other] - places(skeleton, flat)[other]).max() < 1e-12


def test_the_roll_goes_over_from_ball_to_tip_and_nothing_of_the_foot_sinks() -> None:
    skeleton, rig = human().skeleton, human_rig()
    module = rig.module("leg.L")
    assert isinstance(module, LimbModule)
    assert module.foot is not None
    rolls = np.linspace(-0.8, 1.5, 200)
    controls = moved(rig, {"pelvis": ((0, -0.3, 0), (0, 0, 0))})
    pose = evaluate_rig(rig, skeleton, controls, {"foot.L.roll": rolls})
    ground = module.foot.heel[1]
    low = np.min(
        [
            in_foot(skeleton, pose, joint, getattr(module.foot, pivot))[:, 1]
            for joint, pivot in (("LeftFoot", "heel"), ("LeftToeBase", "ball"), ("LeftToeBase", "tip"))
        ],
        axis=0,
    )
    assert np.abs(low - ground).max() < 1e-9, "it stands on one of the three at every roll"
    assert np.abs(np.diff(places(skeleton, pose)[:, skeleton.index("LeftFoot")], axis=0)).max() < 5e-3


def test_toes_follow_their_control_with_fk_and_ik_alike() -> None:
    skeleton, rig = human().skeleton, human_rig()
    controls = moved(rig, {"toes.L": ((0, 0, 0), (-0.5, 0, 0))})
    toes = skeleton.index("LeftToeBase")
    one, two = (turns(skeleton, evaluate_rig(rig, skeleton, controls, {"leg.L.ik": u}))[toes] for u in (0.0, 1.0))
    assert quat.angle_between(one, two) < 1e-7
    assert quat.angle_between(one, turns(skeleton, skeleton.rest)[toes]) == pytest.approx(0.5)


# ---- spaces, heads, eyes, fingers --------------------------------------------------------------------------------------


@pytest.mark.parametrize("space", ["root", "world", "pelvis", "chest", "head"])
@pytest.mark.parametrize("before", ["root", "chest"])
def test_another_space_leaves_a_control_where_it_is(before: str, space: str) -> None:
    skeleton, rig, rng = human().skeleton, human_rig(), RNG(7)
    labels = [s.name for s in rig.control("hand_ik.L").spaces]
    values = {"arm.L.ik": 1.0, "spine.ik": 0.5, "hand_ik.L.space": float(labels.index(before))}
    controls = random_controls(rig, rng, (5,))
    hand = rig.controls.index("hand_ik.L")
    was = solve_rig(rig, skeleton, controls, values)
    controls, changed = switch_space(rig, skeleton, "hand_ik.L", space, controls, values)
    assert np.all(changed["hand_ik.L.space"] == labels.index(space))
    now = solve_rig(rig, skeleton, controls, changed)
    assert np.abs(was.model_from_control[:, hand] - now.model_from_control[:, hand]).max() < 1e-9
    assert apart(skeleton, was.pose, now.pose) < 1e-7


def test_a_control_goes_with_the_space_that_it_has() -> None:
    skeleton, rig = human().skeleton, human_rig()
    hand, chest = rig.controls.index("hand_ik.L"), skeleton.index("Spine2")
    labels = [s.name for s in rig.control("hand_ik.L").spaces]
    controls = moved(rig, {"spine.1": ((0, 0, 0), (0.3, 0.2, 0.1)), "root": ((1.0, 0, 0), (0, 0, 0))})
    found = {label: solve_rig(rig, skeleton, controls, {"hand_ik.L.space": float(n)}) for n, label in enumerate(labels)}
    rest = evaluate.world(rig.controls, rig.controls.rest)[hand]
    assert np.allclose(found["world"].model_from_control[hand], rest)
    assert np.allclose(found["root"].model_from_control[hand, :3, 3], rest[:3, 3] + [1.0, 0, 0])
    now = evaluate.world(skeleton, found["chest"].pose)[chest]
    carried = now @ np.linalg.inv(evaluate.world(skeleton, skeleton.rest)[chest]) @ rest
    assert np.allclose(found["chest"].model_from_control[hand], carried)


def test_what_a_control_is_relative_to_puts_it_anywhere() -> None:
    skeleton, rig, rng = human().skeleton, human_rig(), RNG(8)
    controls = random_controls(rig, rng)
    solved = solve_rig(rig, skeleton, controls)
    local = evaluate.world(rig.controls, rig.controls.rest) * 0
    for n in range(rig.controls.joint_count):
        local[n] = np.linalg.inv(solved.model_from_frame[n]) @ solved.model_from_control[n]
    assert np.abs(local[:, :3, 3] - controls.translations).max() < 1e-9
    assert np.asarray(quat.angle_between(quat.from_matrix(local[:, :3, :3]), controls.rotations)).max() < 1e-7


def test_the_head_looks_at_its_target() -> None:
    skeleton, rig = human().skeleton, human_rig()
    look, head = rig.controls.index("look"), skeleton.index("Head")
    rest = evaluate.world(skeleton, skeleton.rest)[head]
    at_rest = evaluate.world(rig.controls, rig.controls.rest)[look, :3, 3]
    ahead = rest[:3, :3].T @ (at_rest - rest[:3, 3])
    controls = moved(rig, {"look": ((1.0, 0.4, -0.2), (0, 0, 0)), "spine.2": ((0, 0, 0), (0.2, 0.3, 0))})
    solved = solve_rig(rig, skeleton, controls, {"head.look": 1.0})
    now = evaluate.world(skeleton, solved.pose)[head]
    wish = solved.model_from_control[look, :3, 3] - now[:3, 3]
    ahead_now = now[:3, :3] @ ahead
    assert ahead_now @ wish / np.linalg.norm(ahead_now) / np.linalg.norm(wish) == pytest.approx(1.0, abs=1e-12)
    neck = skeleton.index("Neck")
    still = evaluate_rig(rig, skeleton, controls, {"head.look": 0.0})
    part = quat.angle_between(turns(skeleton, still)[neck], turns(skeleton, solved.pose)[neck])
    assert 0.05 < part < quat.angle_between(turns(skeleton, still)[head], turns(skeleton, solved.pose)[head])


def test_eyes_look_at_their_own_targets_through_the_head() -> None:
    skeleton, rig = human().skeleton, human_rig()
    controls = moved(rig, {"eyes": ((0.2, 0.1, 0), (0, 0, 0)), "eye.L": ((0.02, 0, 0), (0, 0, 0))})
    solved = solve_rig(rig, skeleton, controls)
    for joint, control in (("LeftEye", "eye.L"), ("RightEye", "eye.R")):
        j, c = skeleton.index(joint), rig.controls.index(control)
        rest, now = (evaluate.world(skeleton, p)[j] for p in (skeleton.rest, solved.pose))
        ahead = rest[:3, :3].T @ (evaluate.world(rig.controls, rig.controls.rest)[c, :3, 3] - rest[:3, 3])
        wish = solved.model_from_control[c, :3, 3] - now[:3, 3]
        assert np.allclose(now[:3, :3] @ ahead / np.linalg.norm(ahead), wish / np.linalg.norm(wish), atol=1e-9)


def test_a_hand_closes_towards_its_palm_and_fans() -> None:
    skeleton, rig = human().skeleton, human_rig()
    for letter, side in (("L", "Left"), ("R", "Right")):
        closed = evaluate_rig(rig, skeleton, None, {f"hand.{letter}.curl": 1.0})
        hand, tip = skeleton.index(f"{side}Hand"), skeleton.index(f"{side}HandMiddle3")
        knuckle = skeleton.index(f"{side}HandMiddle1")
        rest, now = places(skeleton, skeleton.rest), places(skeleton, closed)
        along = rest[knuckle] - rest[hand]
        index, little = (rest[skeleton.index(f"{side}Hand{f}1")] for f in ("Index", "Pinky"))
        palm = np.cross(along, index - little) * (1 if letter == "L" else -1)
        assert (now[tip] - rest[tip]) @ palm / np.linalg.norm(palm) > 0.01
        one = evaluate_rig(rig, skeleton, None, {f"index.{letter}.curl": 1.0})
        assert np.abs(places(skeleton, one)[tip] - rest[tip]).max() < 1e-12
        fanned = places(skeleton, evaluate_rig(rig, skeleton, None, {f"hand.{letter}.spread": 0.3}))
        ends = [skeleton.index(f"{side}Hand{f}3") for f in ("Index", "Pinky")]
        assert np.linalg.norm(fanned[ends[0]] - fanned[ends[1]]) > 1.1 * np.linalg.norm(rest[ends[0]] - rest[ends[1]])


def test_joints_of_twist_take_their_share_of_a_roll() -> None:
    skeleton, rig = human().skeleton, human_rig()
    module = rig.module("twists")
    assert isinstance(module, TwistModule)
    assert len(module.joints) == 6
    rest = places(skeleton, skeleton.rest)
    for angle in (-1.4, 0.3, 1.0):
        for twist in module.twists:
            # the hand rolls about its forearm, an upper arm or thigh in its socket
            moved_joint = twist.end or twist.bone
            end = next(
                j for j in skeleton.children(skeleton.index(twist.bone)) if skeleton.names[j] not in module.joints
            )
            way = rest[end] - rest[skeleton.index(twist.bone)]
            roll = quat.from_axis_angle(way, angle)
            control = next(
                c
                for m in rig.modules
                if isinstance(m, LimbModule)
                for j, c in zip(m.joints, m.controls, strict=True)
                if j == moved_joint
            )
            n = rig.controls.index(control)
            at = evaluate.world_rotations_positions(rig.controls, rig.controls.rest)[0]
            r = np.array(rig.controls.rest.rotations)
            r[n] = quat.multiply(r[n], quat.multiply(quat.conjugate(at[n]), quat.multiply(roll, at[n])))
            controls = Pose(rig.controls.rest.translations, r, rig.controls.rest.scales)
            pose = evaluate_rig(rig, skeleton, controls, {"leg.L.ik": 0.0, "leg.R.ik": 0.0})
            turned = turns(skeleton, pose)
            wanted = quat.from_axis_angle(way, twist.share * angle)
            # every rest rotation of the human is the identity
            assert quat.angle_between(turned[skeleton.index(twist.joint)], wanted) < 1e-7
            assert quat.angle_between(turned[skeleton.index(moved_joint)], roll) < 1e-7
            still = evaluate_rig(rig, skeleton, controls, {"twists.follow": 0.0, "leg.L.ik": 0.0, "leg.R.ik": 0.0})
            joint = skeleton.index(twist.joint)
            assert np.array_equal(still.rotations[joint], skeleton.rest.rotations[joint])


def test_both_sides_are_mirror_images() -> None:
    skeleton, rig = human().skeleton, human_rig()
    turn = np.array([0.4, 0.2, -0.3])
    for control, joint in (
        ("upper_arm", "Arm"),
        ("lower_arm", "ForeArm"),
        ("upper_leg", "UpLeg"),
        ("index.1", "HandIndex1"),
    ):
        bent = [
            places(
                skeleton,
                evaluate_rig(
                    rig, skeleton, moved(rig, {f"{control}.{s}": ((0, 0, 0), (turn[0], 0, 0))}), {f"leg.{s}.ik": 0.0}
                ),
            )
            for s in "LR"
        ]
        ends = [skeleton.index(f"{side}{'Hand' if 'Leg' not in joint else 'Foot'}") for side in ("Left", "Right")]
        if control == "index.1":
            ends = [skeleton.index(f"{side}HandIndex3") for side in ("Left", "Right")]
        left, right = bent[0][ends[0]], bent[1][ends[1]]
        assert np.allclose(left * [-1, 1, 1], right, atol=1e-6)


# ---- what is refused ---------------------------------------------------------------------------------------------------


def test_wrong_input_is_named() -> None:
    skeleton, rig = human().skeleton, human_rig()
    with pytest.raises(UnknownName, match=r"no attribute 'arm\.L\.IK'; nearest: 'arm\.L\.ik'"):
        evaluate_rig(rig, skeleton, None, {"arm.L.IK": 1.0})
    with pytest.raises(ShapeError, match="finite"):
        evaluate_rig(rig, skeleton, None, {"arm.L.ik": np.nan})
    with pytest.raises(ShapeError, match="control_pose: expected"):
        evaluate_rig(rig, skeleton, skeleton.rest)
    with pytest.raises(ShapeError, match="do not broadcast"):
        evaluate_rig(rig, skeleton, random_controls(rig, RNG(0), (3,)), {"arm.L.ik": np.zeros(4)})
    with pytest.raises(UnknownName, match=r"no space of 'hand_ik.L' 'hips'"):
        switch_space(rig, skeleton, "hand_ik.L", "hips", rig.controls.rest)


def test_controls_have_no_names_that_animations_could_take_for_joints() -> None:
    skeleton, rig = human().skeleton, human_rig()
    folded = {n.casefold() for n in skeleton.names}
    assert not folded & {n.casefold() for n in rig.controls.names}
    assert {m.name for m in rig.modules if isinstance(m, FollowModule)} == {"body", "jaw", "shoulder.L", "shoulder.R"}
    assert all(Property.SCALE not in look.moves for look in rig.looks[1:])
