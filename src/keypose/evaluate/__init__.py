"""Curves at times, poses of skeletons, forward kinematics, blending, and the bridge between clips and motions."""

from keypose.evaluate.baking import bake, reduce_keys, resample, snap_to_keys, to_clip
from keypose.evaluate.blending import add, blend, difference
from keypose.evaluate.kinematics import local, world, world_rotations_positions
from keypose.evaluate.matching import MatchReport, match, match_report
from keypose.evaluate.rates import key_rate
from keypose.evaluate.sampling import sample, sample_clip, sample_curve, sample_morphs, sample_motion, unmatched

__all__ = [
    "MatchReport",
    "add",
    "bake",
    "blend",
    "difference",
    "key_rate",
    "local",
    "match",
    "match_report",
    "reduce_keys",
    "resample",
    "sample",
    "sample_clip",
    "sample_curve",
    "sample_morphs",
    "sample_motion",
    "snap_to_keys",
    "to_clip",
    "unmatched",
    "world",
    "world_rotations_positions",
]
