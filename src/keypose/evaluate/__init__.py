"""Curves at times, poses of skeletons, forward kinematics, blending, and the bridge between clips and motions."""

from keypose.evaluate.baking import bake, resample, snap_to_keys, to_clip, to_motion
from keypose.evaluate.blending import add, blend, difference
from keypose.evaluate.curves import sample_curve
from keypose.evaluate.kinematics import local, world, world_rotations_positions
from keypose.evaluate.matching import MatchReport, match, match_report
from keypose.evaluate.plain import PlainClip, is_plain, plain_clip
from keypose.evaluate.rates import frame_rate, key_rate
from keypose.evaluate.sampling import sample, sample_clip, sample_morphs, sample_motion, sample_value, unmatched
from keypose.evaluate.tables import CurveTable, prepare_curves, sample_curves
from keypose.evaluate.timeline import (
    KeyedValue,
    bake_timeline,
    exposed_times,
    placement_duration,
    placement_times,
    sample_timeline,
    sample_timeline_morphs,
    sample_timeline_values,
    value_for_result,
)

__all__ = [
    "CurveTable",
    "KeyedValue",
    "MatchReport",
    "PlainClip",
    "add",
    "bake",
    "bake_timeline",
    "blend",
    "difference",
    "exposed_times",
    "frame_rate",
    "is_plain",
    "key_rate",
    "local",
    "match",
    "match_report",
    "placement_duration",
    "placement_times",
    "plain_clip",
    "prepare_curves",
    "resample",
    "sample",
    "sample_clip",
    "sample_curve",
    "sample_curves",
    "sample_morphs",
    "sample_motion",
    "sample_timeline",
    "sample_timeline_morphs",
    "sample_timeline_values",
    "sample_value",
    "snap_to_keys",
    "to_clip",
    "to_motion",
    "unmatched",
    "value_for_result",
    "world",
    "world_rotations_positions",
]
