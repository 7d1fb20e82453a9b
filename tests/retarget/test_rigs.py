"""Rigs of other builds: laws on bodies that are changed on purpose, so that what must come out is known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from keypose import evaluate, samples
from keypose.analysis import find_roles, roles_from_json
from keypose.errors import KeyposeError, ShapeError
from keypose.math import quat
from keypose.model import Motion, Pose, Scene, Skeleton
from keypose.retarget import (
    HandOptions,
    Prop,
    bind_stand,
    compare_with_reference,
    find_stand,
    ground_under,
    pose_of_other,
    retarget,
)
from keypose.retarget.attach import attach_limbs
from tests.animals import dog


@pytest.fixture(scope="module")
def walk() -> Scene:
    return samples.open_scene("sample:walk")


def motion_of(scene: Scene) -> Motion:
    animation = scene.animations[0]
    assert isinstance(animation, Motion)
    return animation


def world(skeleton: Skeleton, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    turned, places = evaluate.world_rotations_positions(skeleton, pose.broadcast())
    return np.asarray(turned, np.float64), np.asarray(places, np.float64)


def hung(skeleton: Skeleton, moved: dict[str, str]) -> Skeleton:
    """The same body with some joints on other parents, further up."""
    turned, places = world(skeleton, skeleton.rest)
    parents = np.array(skeleton.parents)
    translations, rotations = np.array(skeleton.rest.translations), np.array(skeleton.rest.rotations)
    for name, parent in moved.items():
        j, p = skeleton.names.index(name), skeleton.names.index(parent)
        parents[j] = p
        back = quat.conjugate(turned[p])
        translations[j] = quat.rotate(back, places[j] - places[p])
        rotations[j] = quat.multiply(back, turned[j])
    return Skeleton(skeleton.names, parents, Pose(translations, rotations, skeleton.rest.scales))


def from_model(skeleton: Skeleton, model: np.ndarray, hips: np.ndarray) -> Pose:
    """A pose by rotations in the model's space (T, J, 4), with the root at places (T, 3)."""
    local = np.array(model)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            local[:, joint] = quat.multiply(quat.conjugate(model[:, parent]), model[:, joint])
    translations = np.repeat(np.asarray(skeleton.rest.translations, np.float64)[None], len(model), axis=0)
    translations[:, 0] = hips
    return Pose(translations, local, skeleton.rest.scales)


def collapsed(skeleton: Skeleton) -> Skeleton:
    """The same bones, all of which point upwards in the rest pose, as some exporters write it."""
    _, places = world(skeleton, skeleton.rest)
    translations, rotations = (
        np.array(skeleton.rest.translations, np.float64),
        np.tile([1.0, 0, 0, 0], (len(places), 1)),
    )
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            translations[joint] = [0.0, np.linalg.norm(places[joint] - places[parent]), 0.0]
    return Skeleton(skeleton.names, skeleton.parents, Pose(translations, rotations, skeleton.rest.scales))


# ---- feet and hands that hang elsewhere ------------------------------------------------------------------------------


def test_feet_and_hands_that_hang_on_the_root_follow_their_limbs(walk: Scene) -> None:
    skeleton, motion = walk.character.skeleton, motion_of(walk)
    goals = hung(skeleton, dict.fromkeys(("LeftFoot", "RightFoot", "LeftHand", "RightHand"), "Hips"))
    roles = walk.character.roles
    plain = retarget(motion, skeleton, skeleton, target_roles=roles)
    done = retarget(motion, skeleton, goals, target_roles=roles)
    np.testing.assert_allclose(world(goals, done.motion.pose)[1], world(skeleton, plain.motion.pose)[1], atol=2e-5)
    assert any("hang outside their limbs" in note for note in done.notes)
    assert done.motion.joint_names == skeleton.names and done.report.slide_cm_s < 1.0


def test_limbs_in_one_piece_are_left_alone_and_others_go_there_and_back(walk: Scene) -> None:
    skeleton, motion = walk.character.skeleton, motion_of(walk)
    assert attach_limbs(skeleton, walk.character.roles) is None
    goals = hung(skeleton, {"LeftFoot": "Hips", "RightHand": "Spine"})
    attached = attach_limbs(goals, walk.character.roles)
    assert attached is not None
    assert attached.changed == tuple(skeleton.names.index(n) for n in ("LeftFoot", "RightHand"))
    inside = attached.pose_in(motion.pose.broadcast())
    np.testing.assert_allclose(
        world(attached.skeleton, inside)[1], world(goals, motion.pose)[1][:, attached.order], atol=1e-5
    )
    back = attached.pose_out(inside)
    np.testing.assert_allclose(world(goals, back)[1], world(goals, motion.pose)[1], atol=1e-5)


# ---- reference poses -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lowered_deg", [-20.0, 0.0, 45.0, 80.0])
def test_arms_at_rest_from_t_to_hanging(walk: Scene, lowered_deg: float) -> None:
    """Any rest of the arms: their bones point where the source's do, and palms look where they did."""
    skeleton, motion = walk.character.skeleton, motion_of(walk)
    turned, _ = world(skeleton, skeleton.rest)
    model = np.array(turned)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        turn = quat.from_axis_angle(np.array([0.0, 0.0, -sign]), np.array(np.radians(lowered_deg - 40.0)))
        for j, name in enumerate(skeleton.names):
            if name.startswith(side) and any(part in name for part in ("Arm", "Hand")):
                model[j] = quat.multiply(turn, turned[j])
    rest = from_model(skeleton, model[None], np.asarray(skeleton.rest.translations)[None, 0])
    other = replace(skeleton, rest=Pose(rest.translations[0], rest.rotations[0], skeleton.rest.scales))
    roles = walk.character.roles
    plain = retarget(motion, skeleton, skeleton, plant=None, source_roles=roles, target_roles=roles)
    done = retarget(motion, skeleton, other, plant=None, source_roles=roles, target_roles=roles)
    assert (
        max(done.report.direction_deg[f"{s}_{b}"] for s in ("left", "right") for b in ("upper_arm", "lower_arm")) < 0.05
    )
    apart = world(other, done.motion.pose)[1] - world(skeleton, plain.motion.pose)[1]
    fingers = [j for j, name in enumerate(skeleton.names) if "Index" in name or "Pinky" in name]
    assert np.abs(apart[:, fingers]).max() < 0.03


def test_a_collapsed_rest_pose_with_a_spread_frame(walk: Scene) -> None:
    """A motion that begins in a T pose says how the rig stands: as good as a rest pose that does."""
    skeleton, motion = walk.character.skeleton, motion_of(walk)
    turned, places = world(skeleton, motion.pose)
    stands, at = world(skeleton, skeleton.rest)
    rig = collapsed(skeleton)
    # what a joint of the rig turns by: the bones' own directions do not count, so any constant turn per joint is right
    own = np.array([quat.normalize(np.random.default_rng(j).normal(size=4)) for j in range(len(stands))])
    model = quat.multiply(np.concatenate([stands[None], turned]), own)
    translations = np.repeat(np.asarray(rig.rest.translations)[None], len(model), axis=0)
    where = np.concatenate([at[None], places])
    for joint, parent in enumerate(rig.parents):
        if parent >= 0:
            step = where[:, joint] - where[:, parent]
            translations[:, joint] = quat.rotate(quat.conjugate(model[:, parent]), step)
        else:
            translations[:, joint] = where[:, joint]
    assert np.ptp(translations[:, 1:], axis=0).max() < 1e-5  # one and the same rig in all frames
    rig = replace(rig, rest=replace(rig.rest, translations=translations[0]))
    local = np.array(model)
    for joint, parent in enumerate(rig.parents):
        if parent >= 0:
            local[:, joint] = quat.multiply(quat.conjugate(model[:, parent]), model[:, joint])
    performed = Motion(rig.names, Pose(translations, local, rig.rest.scales), motion.rate_hz)
    roles = walk.character.roles
    stand, note = find_stand(rig, roles, performed)
    assert stand is not None and "frame 0" in note
    plain = retarget(motion, skeleton, skeleton, plant=None, source_roles=roles, target_roles=roles)
    done = retarget(performed, rig, skeleton, plant=None, source_roles=roles, target_roles=roles)
    apart = world(skeleton, done.motion.pose)[1][1:] - world(skeleton, plain.motion.pose)[1]
    apart -= apart[:, :1]
    assert np.abs(apart).max() < 2e-3
    put = retarget(motion, skeleton, rig, plant=None, source_roles=roles, target_roles=roles, target_motion=performed)
    apart = world(rig, put.motion.pose)[1] - world(skeleton, plain.motion.pose)[1]
    apart -= apart[:, :1]
    assert np.abs(apart).max() < 2e-3
    # without that frame the stand is made from the walk itself: bones still point the same ways
    later = replace(performed, pose=Pose(translations[1:], local[1:], rig.rest.scales))
    made = retarget(motion, skeleton, rig, plant=None, source_roles=roles, target_roles=roles, target_motion=later)
    assert any("mean of" in note for note in made.notes)
    assert made.report.mean_direction_deg < 3.0


def test_a_figure_saved_in_the_middle_of_a_step_stands_as_its_skin_was_bound(walk: Scene) -> None:
    character, motion = walk.character, motion_of(walk)
    pose = motion.pose.broadcast()
    step = Pose(pose.translations[11], np.array(pose.rotations[11]), pose.scales[11])
    leg = character.skeleton.names.index("LeftUpLeg")
    lifted = np.array(step.rotations)
    lifted[leg] = quat.multiply(quat.from_axis_angle(np.array([1.0, 0, 0]), np.array(-1.0)), lifted[leg])
    saved = replace(character, skeleton=replace(character.skeleton, rest=replace(step, rotations=lifted)))
    assert bind_stand(character, character.roles) is None
    stand = bind_stand(saved, character.roles)
    assert stand is not None
    turned, places = world(saved.skeleton, stand)
    asked, at = world(character.skeleton, character.skeleton.rest)
    skinned = sorted({j for part in character.parts if part.skin is not None for j in part.skin.palette.tolist()})
    assert np.abs(quat.angle_between(turned[skinned], asked[skinned])).max() < 1e-3
    np.testing.assert_allclose((places - places[0])[skinned], (at - at[0])[skinned], atol=2e-3)
    ground = ground_under(saved, stand)
    assert ground is not None and abs(ground) < 1e-3


def test_the_stand_of_another_file_of_a_rig(walk: Scene) -> None:
    skeleton, motion = walk.character.skeleton, motion_of(walk)
    pose = motion.pose.broadcast()
    frame = Pose(pose.translations[20], pose.rotations[20], pose.scales[20])
    names = ("holder", *(f"rig:{name}" for name in skeleton.names))
    spin = quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), np.array(0.7))
    rest = skeleton.rest
    other = Skeleton(
        names,
        np.concatenate([[-1], np.asarray(skeleton.parents) + 1]),
        Pose(
            np.concatenate([[[0.0, 0, 0]], rest.translations]),
            np.concatenate([spin[None], rest.rotations]),
            np.concatenate([[[1.0, 1, 1]], rest.scales]),
        ),
    )
    put = pose_of_other(other, skeleton, frame)
    np.testing.assert_allclose(
        np.abs(np.sum(world(other, put)[0][1:] * world(skeleton, frame)[0], axis=-1)), 1.0, atol=1e-6
    )
    with pytest.raises(ShapeError, match="another rig"):
        pose_of_other(skeleton, replace(skeleton, names=tuple(f"x{j}" for j in range(skeleton.joint_count))), frame)


# ---- rolls -----------------------------------------------------------------------------------------------------------


def with_twists(skeleton: Skeleton, bones: dict[str, tuple[str, float]]) -> Skeleton:
    """The skeleton with joints of twist: name -> (joint on which it hangs, share of the way to that joint's first child)."""
    names, parents = list(skeleton.names), list(skeleton.parents)
    translations, rotations, scales = (
        list(np.asarray(a)) for a in (skeleton.rest.translations, skeleton.rest.rotations, skeleton.rest.scales)
    )
    for name, (on, share) in bones.items():
        j = skeleton.names.index(on)
        child = next(c for c, p in enumerate(skeleton.parents) if p == j and "Twist" not in skeleton.names[c])
        names.append(name)
        parents.append(j)
        translations.append(share * np.asarray(skeleton.rest.translations)[child])
        rotations.append(np.array([1.0, 0, 0, 0]))
        scales.append(np.ones(3))
    return Skeleton(
        tuple(names), np.array(parents), Pose(np.array(translations), np.array(rotations), np.array(scales))
    )


def test_rolls_are_shared_along_limbs(walk: Scene) -> None:
    """An upper arm that rolls in its socket, and a hand that turns over: joints of twist take their share of it."""
    skeleton = walk.character.skeleton
    plain = Skeleton(
        *(
            lambda keep: (
                tuple(skeleton.names[j] for j in keep),
                np.array([keep.index(int(skeleton.parents[j])) if skeleton.parents[j] >= 0 else -1 for j in keep]),
                Pose(
                    *(
                        np.asarray(a)[keep]
                        for a in (skeleton.rest.translations, skeleton.rest.rotations, skeleton.rest.scales)
                    )
                ),
            )
        )([j for j, name in enumerate(skeleton.names) if "Twist" not in name])
    )
    rig = with_twists(
        plain,
        {"ArmTwist0": ("LeftArm", 0.0), "ArmTwist5": ("LeftArm", 0.5), "ForeTwist4": ("LeftForeArm", 0.4)},
    )
    turned, _ = world(plain, plain.rest)
    _, places = world(plain, plain.rest)
    index = {name: j for j, name in enumerate(plain.names)}
    angles = np.linspace(0.0, 1.2, 25)
    model = np.repeat(turned[None], len(angles), axis=0)
    arm = places[index["LeftForeArm"]] - places[index["LeftArm"]]
    fore = places[index["LeftHand"]] - places[index["LeftForeArm"]]
    below = [j for j, name in enumerate(plain.names) if name.startswith("Left") and ("Arm" in name or "Hand" in name)]
    socket = quat.from_axis_angle(np.tile(arm / np.linalg.norm(arm), (len(angles), 1)), angles)
    wrist = quat.from_axis_angle(np.tile(fore / np.linalg.norm(fore), (len(angles), 1)), 0.5 * angles)
    for j in below:
        name = plain.names[j]
        if name == "LeftArm":
            model[:, j] = quat.multiply(socket, model[:, j])
        elif "Hand" in name:
            model[:, j] = quat.multiply(quat.multiply(socket, wrist), model[:, j])
        elif name == "LeftForeArm":
            model[:, j] = quat.multiply(socket, model[:, j])
    performed = Motion(plain.names, from_model(plain, model, np.tile(places[0], (len(angles), 1))), 30.0)
    done = retarget(performed, plain, rig, plant=None)
    got, _ = world(rig, done.motion.pose)
    rest, _ = world(rig, rig.rest)

    def roll(name: str, axis: np.ndarray) -> np.ndarray:
        j = rig.names.index(name)
        out = quat.multiply(got[:, j], quat.conjugate(rest[j]))
        return np.linalg.norm(quat.to_rotation_vector(quat.shortest(out)), axis=-1) * np.sign(
            quat.to_rotation_vector(quat.shortest(out)) @ axis + 1e-15
        )

    np.testing.assert_allclose(roll("LeftArm", arm), angles, atol=2e-3)
    np.testing.assert_allclose(roll("ArmTwist0", arm), 0.0, atol=2e-3)
    np.testing.assert_allclose(roll("ArmTwist5", arm), 0.5 * angles, atol=2e-3)
    beyond = quat.multiply(quat.conjugate(socket), got[:, rig.names.index("ForeTwist4")])
    share = quat.angle_between(beyond, np.broadcast_to(rest[rig.names.index("ForeTwist4")], beyond.shape))
    np.testing.assert_allclose(share, 0.4 * 0.5 * angles, atol=2e-3)


@pytest.mark.data
def test_bones_in_pieces_roll_step_by_step_and_still_point_right(data_dir: Path, walk: Scene) -> None:
    body = samples.open_scene(str(data_dir / "makehuman/default.mhskel")).character
    done = retarget(motion_of(walk), walk.character.skeleton, body.skeleton, plant=None)
    assert (
        max(done.report.direction_deg[f"{s}_{b}"] for s in ("left", "right") for b in ("upper_arm", "upper_leg")) < 0.02
    )
    turned, _ = world(body.skeleton, done.motion.pose)
    names = body.skeleton.names
    first, second = (turned[:, names.index(n)] for n in ("upperarm01.L", "upperarm02.L"))
    between = quat.angle_between(first, second)
    rest = world(body.skeleton, body.skeleton.rest)[0]
    still = quat.angle_between(*(rest[names.index(n)] for n in ("upperarm01.L", "upperarm02.L")))
    assert np.ptp(between) > 0.05 and np.abs(between - still).max() < 1.0


# ---- hands -----------------------------------------------------------------------------------------------------------


def broader(skeleton: Skeleton, shoulders: float, arms: float) -> Skeleton:
    translations = np.array(skeleton.rest.translations, np.float64)
    for j, name in enumerate(skeleton.names):
        if name in ("LeftArm", "RightArm"):
            translations[j] *= shoulders
        if name in ("LeftForeArm", "RightForeArm", "LeftHand", "RightHand"):
            translations[j] *= arms
    return replace(skeleton, rest=replace(skeleton.rest, translations=translations))


def palms(skeleton: Skeleton, pose: Pose) -> dict[str, np.ndarray]:
    _, places = world(skeleton, pose)
    at = {name: places[:, j] for j, name in enumerate(skeleton.names)}
    found: dict[str, np.ndarray] = {}
    for side in ("Left", "Right"):
        knuckles = 0.5 * (at[f"{side}HandIndex1"] + at[f"{side}HandPinky1"])
        found[side] = at[f"{side}Hand"] + 0.6 * (knuckles - at[f"{side}Hand"])
    return found


@pytest.fixture(scope="module")
def clasped(walk: Scene) -> Motion:
    """Hands that come together before the chest and part again."""
    skeleton = walk.character.skeleton
    turned, places = world(skeleton, skeleton.rest)
    index = {name: j for j, name in enumerate(skeleton.names)}
    chest = places[index["Spine2"]]
    shares = 0.5 - 0.5 * np.cos(np.linspace(0.0, 2.0 * np.pi, 61))
    model = np.repeat(turned[None], len(shares), axis=0)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        start, elbow, wrist = (places[index[f"{side}{p}"]] for p in ("Arm", "ForeArm", "Hand"))
        palm = palms(
            skeleton,
            Pose(
                *(
                    np.asarray(a)[None]
                    for a in (skeleton.rest.translations, skeleton.rest.rotations, skeleton.rest.scales)
                )
            ),
        )[side][0]
        middle = chest + np.array([sign * 0.03, 0.0, 0.30])
        goal = wrist + shares[:, None] * (middle - palm)[None]
        from keypose.ik import rotation_between_frames, solve_limb

        lengths = float(np.linalg.norm(elbow - start)), float(np.linalg.norm(wrist - elbow))
        down = np.tile([sign * 0.3, -1.0, -0.2], (len(shares), 1))
        solved = solve_limb(np.tile(start, (len(shares), 1)), goal, down, upper_m=lengths[0], lower_m=lengths[1])
        normal = np.cross(wrist - start, down)
        first = rotation_between_frames(
            np.tile(elbow - start, (len(shares), 1)), normal, solved.middle - start, solved.normal
        )
        second = rotation_between_frames(
            np.tile(wrist - elbow, (len(shares), 1)), normal, solved.end - solved.middle, solved.normal
        )
        for j, name in enumerate(skeleton.names):
            if name == f"{side}Arm":
                model[:, j] = quat.multiply(first, model[:, j])
            elif name == f"{side}ForeArm":
                model[:, j] = quat.multiply(second, model[:, j])
    return Motion(skeleton.names, from_model(skeleton, model, np.tile(places[0], (len(shares), 1))), 30.0)


def test_hands_that_touch_do_so_on_a_broader_body(walk: Scene, clasped: Motion) -> None:
    skeleton = walk.character.skeleton
    other = broader(skeleton, 1.3, 0.9)
    roles = walk.character.roles
    away = {}
    for kept in (None, HandOptions()):
        done = retarget(clasped, skeleton, other, hands=kept, plant=None, source_roles=roles, target_roles=roles)
        at = palms(other, done.motion.pose)
        away[kept is not None] = np.linalg.norm(at["Left"] - at["Right"], axis=-1)
        if kept is not None:
            assert done.report.hands_off_cm is not None and done.report.hands_off_cm < 0.5
            assert any("hands beside body" in line for line in done.report.lines())
    source = palms(skeleton, clasped.pose)
    asked = np.linalg.norm(source["Left"] - source["Right"], axis=-1)
    middle = len(asked) // 2
    assert asked[middle] < 0.08
    assert abs(away[True][middle] - asked[middle]) < 0.01 < 0.03 < abs(away[False][middle] - asked[middle])
    np.testing.assert_allclose(away[True][0], away[False][0], atol=1e-3)  # far apart nothing is kept
    assert np.abs(np.diff(away[True], 2)).max() < 4.0 * np.abs(np.diff(asked, 2)).max()


def test_the_same_body_keeps_its_hands_as_they_are(walk: Scene, clasped: Motion) -> None:
    skeleton, roles = walk.character.skeleton, walk.character.roles
    plain, done = (
        retarget(clasped, skeleton, skeleton, hands=h, plant=None, source_roles=roles, target_roles=roles)
        for h in (None, HandOptions())
    )
    np.testing.assert_allclose(world(skeleton, done.motion.pose)[1], world(skeleton, plain.motion.pose)[1], atol=2e-3)


def test_a_prop_stays_in_the_hand(walk: Scene, clasped: Motion) -> None:
    skeleton, roles = walk.character.skeleton, walk.character.roles
    other = broader(skeleton, 1.2, 0.95)
    middle = clasped.frame_count // 2
    held = palms(skeleton, clasped.pose)["Right"]
    there = held[middle] + np.array([0.05, 0.03, 0.0])
    options = HandOptions(props=[Prop(held[middle], there)])
    done = retarget(clasped, skeleton, other, hands=options, plant=None, source_roles=roles, target_roles=roles)
    loose = retarget(clasped, skeleton, other, plant=None, source_roles=roles, target_roles=roles)
    near, far = (np.linalg.norm(palms(other, d.motion.pose)["Right"][middle] - there) for d in (done, loose))
    assert near < 0.6 * far
    for nowhere in (np.zeros((4, 3)), np.array([0.0, np.nan, 0.0])):
        with pytest.raises(ShapeError, match="prop: expected finite places"):
            retarget(clasped, skeleton, other, hands=HandOptions(props=[Prop(nowhere)]))
    with pytest.raises(ShapeError, match="reach"):
        HandOptions(reach=0.0)


# ---- animals ---------------------------------------------------------------------------------------------------------

FOX = {
    "hips": "b_Hip_01", "spine": "b_Spine01_02", "chest": "b_Spine02_03", "neck": "b_Neck_04", "head": "b_Head_05",
    "tail:1": "b_Tail01_012", "tail:2": "b_Tail02_013", "tail:3": "b_Tail03_014",
    **{
        f"{side.lower()}_{part}": f"b_{side}{name}"
        for side, numbers in (("Left", ("09", "010", "011", "015", "016", "017", "018")), ("Right", ("06", "07", "08", "019", "020", "021", "022")))
        for part, name in zip(
            ("upper_arm", "lower_arm", "hand", "upper_leg", "lower_leg", "foot", "toes"),
            (f"{word}_{n}" for word, n in zip(("UpperArm", "ForeArm", "Hand", "Leg01", "Leg02", "Foot01", "Foot02"), numbers, strict=True)),
            strict=True,
        )
    },
}  # fmt: skip


def other_animal(skeleton: Skeleton) -> tuple[Skeleton, dict[str, str]]:
    """A longer-legged, smaller animal with other names and axes, and an ear that the first does not have."""
    rng = np.random.default_rng(4)
    turned, places = world(skeleton, skeleton.rest)
    names = skeleton.names
    lengths = np.ones(len(names))
    for j, name in enumerate(names):
        if any(word in name for word in ("ForeArm", "Hand", "Leg02", "Foot01")):
            lengths[j] = 1.25
        if "Tail" in name:
            lengths[j] = 0.7
    where = np.array(places)
    for j, parent in enumerate(skeleton.parents):
        if parent >= 0:
            where[j] = where[parent] + 0.6 * lengths[j] * (places[j] - places[parent])
    model = quat.multiply(turned, quat.normalize(rng.normal(size=turned.shape)))
    translations, rotations = np.array(where), np.array(model)
    for j, parent in enumerate(skeleton.parents):
        if parent >= 0:
            back = quat.conjugate(model[parent])
            translations[j], rotations[j] = quat.rotate(back, where[j] - where[parent]), quat.multiply(back, model[j])
    head = names.index(FOX["head"])
    other = Skeleton(
        (*(f"q{j}" for j in range(len(names))), "ear"),
        np.array([*skeleton.parents, head]),
        Pose(
            np.concatenate([translations, [[0.0, 1.0, 0.0]]]),
            np.concatenate([rotations, [[1.0, 0, 0, 0]]]),
            np.ones((len(names) + 1, 3)),
        ),
    )
    return other, {role: f"q{names.index(name)}" for role, name in FOX.items()}


@pytest.mark.data
@pytest.mark.parametrize("gait", ["Survey", "Walk", "Run"])
def test_an_animal_on_all_fours_moves_another(data_dir: Path, gait: str) -> None:
    scene = samples.open_scene(str(data_dir / "gltf/khronos/Fox.glb"))
    skeleton = scene.character.skeleton
    other, named = other_animal(skeleton)
    roles, theirs = roles_from_json(json.dumps(FOX), skeleton), roles_from_json(json.dumps(named), other)
    done = retarget(scene.animation(gait), skeleton, other, source_roles=roles, target_roles=theirs)
    assert done.source.on_all_fours and done.target.on_all_fours
    bare = retarget(scene.animation(gait), skeleton, other, source_roles=roles, target_roles=theirs, plant=None)
    assert max(bare.report.direction_deg[b] for b in bare.report.direction_deg if "_" in b) < 0.05
    assert done.report.slide_cm_s < 1.0 * done.target.leg_m / 0.85
    assert done.report.mean_direction_deg < 8.0
    animation = scene.animation(gait)
    motion = evaluate.bake(animation, skeleton, bare.motion.rate_hz) if not isinstance(animation, Motion) else animation
    tails = [(skeleton.names.index(FOX[f"tail:{n}"]), other.names.index(named[f"tail:{n}"])) for n in (1, 2, 3)]
    (a, _), (b, _) = world(skeleton, motion.pose), world(other, bare.motion.pose)
    a0, b0 = world(skeleton, skeleton.rest)[0], world(other, other.rest)[0]
    for j, k in tails:
        turns = (quat.multiply(x[:, i], quat.conjugate(x0[i])) for x, x0, i in ((a, a0, j), (b, b0, k)))
        assert quat.angle_between(*turns).max() < 1e-3


@pytest.mark.data
@pytest.mark.parametrize("gait", ["Survey", "Walk", "Run"])
def test_animals_move_each_other_by_their_roles_alone(data_dir: Path, gait: str) -> None:
    scene = samples.open_scene(str(data_dir / "gltf/khronos/Fox.glb"))
    skeleton = scene.character.skeleton
    other, named = other_animal(skeleton)
    by_maps = retarget(
        scene.animation(gait), skeleton, other,
        source_roles=roles_from_json(json.dumps(FOX), skeleton), target_roles=roles_from_json(json.dumps(named), other),
    )  # fmt: skip
    found = retarget(scene.animation(gait), skeleton, other)
    assert np.array_equal(found.motion.pose.rotations, by_maps.motion.pose.rotations)
    # and a dog with shoulder blades, four joints in its back and a longer tail
    body = dog(turned=True)
    done = retarget(scene.animation(gait), skeleton, body)
    bare = retarget(scene.animation(gait), skeleton, body, plant=None)
    assert done.target.on_all_fours
    directions = {k: v for k, v in bare.report.direction_deg.items() if "_" in k}
    assert max(v for k, v in directions.items() if "shoulder" not in k) < 0.05
    assert done.report.slide_cm_s < 1.0
    assert done.report.mean_direction_deg < 8.0


@pytest.mark.data
def test_an_animal_is_no_human(data_dir: Path, walk: Scene) -> None:
    fox = samples.open_scene(str(data_dir / "gltf/khronos/Fox.glb")).character.skeleton
    for roles in (None, find_roles(fox).roles):
        with pytest.raises(KeyposeError, match="four feet and the other on two"):
            retarget(motion_of(walk), walk.character.skeleton, fox, target_roles=roles)


@pytest.mark.data
def test_a_body_on_two_feet_is_not_compared_with_one_on_four(data_dir: Path, walk: Scene) -> None:
    fox = samples.open_scene(str(data_dir / "gltf/khronos/Fox.glb"))
    skeleton = fox.character.skeleton
    run = evaluate.bake(fox.animations[0], skeleton, 30.0)
    two, four = (
        (motion_of(walk), walk.character.skeleton, find_roles(walk.character.skeleton).roles),
        (run, skeleton, find_roles(skeleton).roles),
    )
    for first, second in ((two, four), (four, two)):
        with pytest.raises(KeyposeError, match="four feet and the other on two"):
            compare_with_reference(*first, *second, {})
    assert compare_with_reference(*four, *four, {}).mean_direction_deg < 1e-6


@pytest.mark.data
def test_a_rest_pose_in_mid_step_gives_way_to_upright_frames(data_dir: Path, walk: Scene) -> None:
    """The same rig saved at rest tells how well bones can point at all."""
    reports = []
    for name in ("jog", "skeleton"):
        rig = samples.open_scene(str(data_dir / f"fbx/ozz_pab/{name}.fbx"))
        skeleton = rig.character.skeleton
        own = evaluate.bake(rig.animations[0], skeleton, 30.0) if rig.animations else None
        done = retarget(motion_of(walk), walk.character.skeleton, skeleton, target_motion=own)
        reports.append(done.report)
        assert any("upright frames" in note for note in done.notes) == (name == "jog")
    jog, rest = reports
    assert jog.mean_direction_deg < rest.mean_direction_deg + 1.0
    assert jog.direction_deg["right_upper_leg"] < 5.0


# ---- fingers and spines ----------------------------------------------------------------------------------------------


@pytest.mark.data
@pytest.mark.parametrize("file", ["fbx/ozz_pab/arnaud.fbx", "makehuman/default.mhskel", "collada/ozz/astro_maya.dae"])
def test_fingers_point_where_the_sources_do(data_dir: Path, file: str) -> None:
    """Two bones or three, whatever axes and rest: those that both hands have."""
    scene = samples.open_scene("sample:wave")
    source, motion = scene.character, motion_of(scene)
    body = samples.open_scene(str(data_dir / file)).character.skeleton
    done = retarget(motion, source.skeleton, body, plant=None)
    (_, a), (_, b) = world(source.skeleton, motion.pose), world(body, done.motion.pose)
    bones = [
        (f"{side}_{finger}_{low}", f"{side}_{finger}_{high}")
        for side in ("left", "right")
        for finger, low, high in (
            ("thumb", "metacarpal", "proximal"),
            ("index", "proximal", "intermediate"),
            ("middle", "proximal", "intermediate"),
            ("little", "proximal", "intermediate"),
        )
    ]
    moved = 0.0
    for low, high in bones:
        u, v = (
            at[:, roles[high]] - at[:, roles[low]] for at, roles in ((a, done.source.roles), (b, done.target.roles))
        )
        u, v = (x / np.linalg.norm(x, axis=-1, keepdims=True) for x in (u, v))
        assert np.degrees(2.0 * np.arcsin(0.5 * np.linalg.norm(u - v, axis=-1))).max() < 0.1, low
        moved = max(moved, float(np.ptp(u, axis=0).max()))
    assert moved > 0.3


def test_a_spine_of_twice_the_joints_bends_as_far(walk: Scene) -> None:
    """A joint halfway along every bone of the trunk: the turn is shared out, and chest and head end up where they were."""
    skeleton, motion = walk.character.skeleton, motion_of(walk)
    trunk = [n for n in ("Spine", "Spine1", "Spine2") if n in skeleton.names]
    names, parents, rest = list[str](), list[int](), list[tuple[np.ndarray, np.ndarray, np.ndarray]]()
    where: dict[str, int] = {}
    for j, name in enumerate(skeleton.names):
        t, r, s = (
            np.asarray(x)[j] for x in (skeleton.rest.translations, skeleton.rest.rotations, skeleton.rest.scales)
        )
        parent = where[skeleton.names[skeleton.parents[j]]] if skeleton.parents[j] >= 0 else -1
        if name in trunk:
            names.append(f"{name}_half")
            parents.append(parent)
            rest.append((0.5 * t, np.array([1.0, 0, 0, 0]), s))
            parent, t = len(names) - 1, 0.5 * t
        where[name] = len(names)
        names.append(name)
        parents.append(parent)
        rest.append((t, r, s))
    other = Skeleton(tuple(names), np.array(parents), Pose(*(np.stack(x) for x in zip(*rest, strict=True))))
    roles = {role: where[skeleton.names[j]] for role, j in walk.character.roles.items()}
    done = retarget(motion, skeleton, other, plant=None, source_roles=walk.character.roles, target_roles=roles)
    plain = retarget(
        motion, skeleton, skeleton, plant=None, source_roles=walk.character.roles, target_roles=walk.character.roles
    )
    (a, x), (b, y) = world(skeleton, plain.motion.pose), world(other, done.motion.pose)
    for role in ("head", "left_upper_arm", "left_hand"):
        j, k = walk.character.roles[role], roles[role]
        assert np.degrees(quat.angle_between(a[:, j], b[:, k])).max() < 0.1, role
        assert np.linalg.norm((x[:, j] - x[:, 0]) - (y[:, k] - y[:, 0]), axis=-1).max() < 0.02, role
