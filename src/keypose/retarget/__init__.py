"""Retargeting: any humanoid's motion on any humanoid, feet planted."""

from keypose.retarget.body import BodyFrames, body_frames
from keypose.retarget.character import bind_stand, ground_under
from keypose.retarget.hands import HandOptions, Prop
from keypose.retarget.reference import ReferenceReport, compare_with_reference
from keypose.retarget.report import RetargetReport, compare_motions
from keypose.retarget.stand import find_stand, pose_of_other
from keypose.retarget.transfer import RetargetResult, retarget

__all__ = [
    "BodyFrames",
    "HandOptions",
    "Prop",
    "ReferenceReport",
    "RetargetReport",
    "RetargetResult",
    "bind_stand",
    "body_frames",
    "compare_motions",
    "compare_with_reference",
    "find_stand",
    "ground_under",
    "pose_of_other",
    "retarget",
]
