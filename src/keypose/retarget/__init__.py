"""Retargeting: any humanoid's motion on any humanoid, feet planted."""

from keypose.retarget.body import BodyFrames, body_frames
from keypose.retarget.report import RetargetReport, compare_motions
from keypose.retarget.stand import find_stand
from keypose.retarget.transfer import RetargetResult, retarget

__all__ = [
    "BodyFrames",
    "RetargetReport",
    "RetargetResult",
    "body_frames",
    "compare_motions",
    "find_stand",
    "retarget",
]
