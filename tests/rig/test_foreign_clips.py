"""Clips of other files on a character with a rig: their joints are never taken for controls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from keypose.evaluate import sample_timeline
from keypose.math import quat
from keypose.model import Channel, Character, Clip, Curve, CurveKind, Document, Motion, Pose, Property, Skeleton
from keypose.project import add_character, import_animation
from keypose.project.commands import SetRig
from keypose.rig import auto_rig, is_keyed, sample_rig
from keypose.rig.baking import alone
from tests.rig.bodies import human, human_rig

TURN = quat.from_rotation_vector(np.array([0.0, 0.0, 0.7]))


def turning(*names: str) -> Clip:
    """A clip that turns joints of these names."""
    return Clip(
        {Channel(n, Property.ROTATION): Curve([0.0], TURN[None], kind=CurveKind.ROTATION) for n in names}, "other"
    )


def controls_of(clip: Clip | Motion) -> np.ndarray:
    """Where a timeline with this one clip puts the controls."""
    return sample_rig(
        human_rig(), human().skeleton, alone(Clip({}, clip.name)), {clip.name: clip}, 0.0
    ).model_from_control


def test_similar_names_move_joints_and_never_controls() -> None:
    skeleton, rig = human().skeleton, human_rig()
    clip = turning("mixamorig:LeftEye", "HAND.L", "Armature|hand.R", "pelvis.001", "file:root")
    found = sample_rig(rig, skeleton, alone(clip), {clip.name: clip}, 0.0)
    rest = sample_rig(rig, skeleton, alone(Clip({}, "other")), {"other": Clip({}, "other")}, 0.0)
    assert np.array_equal(found.model_from_control, rest.model_from_control)
    # what is a joint still goes by a similar name, beside keys on controls
    both = replace(clip, curves={**clip.curves, **turning("hand.L").curves})
    pose = sample_rig(rig, skeleton, alone(both), {both.name: both}, 0.0)
    assert not np.allclose(pose.model_from_control, rest.model_from_control)
    without = sample_timeline(alone(both), {both.name: both}, skeleton, 0.0)
    eye = skeleton.index("LeftEye")
    assert np.allclose(without.rotations[eye], TURN)


def test_euler_orders_stay_with_their_controls_and_joints() -> None:
    skeleton, rig = human().skeleton, human_rig()
    angles = Curve([0.0], [[0.3, 0.5, -0.2]], kind=CurveKind.EULER)
    clip = Clip(
        {Channel("hand.L", Property.EULER): angles, Channel("x:LeftUpLeg", Property.EULER): angles},
        "other",
        euler_orders={"hand.L": "ZXY", "x:LeftUpLeg": "YZX"},
    )
    exact = Clip(
        {Channel("hand.L", Property.EULER): angles, Channel("LeftUpLeg", Property.EULER): angles},
        "other",
        euler_orders={"hand.L": "ZXY", "LeftUpLeg": "YZX"},
    )
    one, two = (sample_rig(rig, skeleton, alone(c), {"other": c}, 0.0) for c in (clip, exact))
    assert np.array_equal(one.model_from_control, two.model_from_control)
    assert np.array_equal(one.pose.rotations, two.pose.rotations)


def test_motions_move_joints_alone() -> None:
    rest = Pose(np.zeros((1, 1, 3)), TURN[None, None], np.ones((1, 1, 3)))
    motion = Motion(("hand.L",), rest, 30.0, name="other")
    assert np.array_equal(controls_of(motion), controls_of(Clip({}, "other")))


def test_an_imported_clip_of_joints_called_like_controls_moves_none() -> None:
    document = SetRig(replace(human_rig(), name="Robin", character="Robin")).apply(
        add_character(Document("p"), human())
    )
    clip = turning("hand.L", "forearm.L", "pelvis")
    imported = import_animation(document, clip)
    (name,) = imported.clips.keys() - document.clips.keys()
    found = imported.clips[name]
    assert {c.target for c in found.curves} == {"joint:hand.L", "forearm.L", "joint:pelvis"}
    assert not is_keyed(human_rig(), alone(found), imported.clips)
    assert np.array_equal(controls_of(found), controls_of(Clip({}, "other")))
    # on a body that has such joints it means them
    other = Skeleton(("pelvis", "hand.L"), np.array([-1, 0], np.int32), _two())
    pose = sample_timeline(alone(found), imported.clips, other, 0.0)
    assert np.allclose(pose.rotations, TURN)


def test_clips_keyed_on_controls_and_joints_of_characters_are_imported_as_they_are() -> None:
    document = SetRig(replace(human_rig(), name="Robin", character="Robin")).apply(
        add_character(Document("p"), human())
    )
    keyed = turning("hand.L", "pelvis", "LeftEye")
    assert _new(document, keyed).curves == keyed.curves
    other = Character(Skeleton(("pelvis", "hand.L"), np.array([-1, 0], np.int32), _two()), name="Other")
    document = add_character(document, other)
    assert {c.target for c in _new(document, turning("hand.L", "pelvis", "strange")).curves} == {
        "hand.L",
        "pelvis",
        "strange",
    }


def test_controls_leave_names_free() -> None:
    rig = auto_rig(human().skeleton, character=human(), taken=("hand.L", "pelvis"))
    assert {"hand_control.L", "pelvis_control", "hand.R"} <= set(rig.controls.names)
    assert "hand.L" not in rig.controls.names


def _two() -> Pose:
    return Pose(np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), np.ones((2, 3)))


def _new(document: Document, clip: Clip) -> Clip:
    after = import_animation(document, clip)
    (name,) = after.clips.keys() - document.clips.keys()
    return after.clips[name]
