"""The public names, and the rate that a clip's keys were made at."""

from __future__ import annotations

import numpy as np
import pytest

from keypose import analysis, deform, evaluate
from keypose.evaluate import key_rate
from keypose.model import Channel, Clip, Curve, Property


def test_the_public_names() -> None:
    assert sorted(evaluate.__all__) == [
        "CurveTable", "KeyedValue", "MatchReport", "PlainClip", "add", "bake", "bake_timeline", "blend", "difference", "exposed_times", "frame_rate", "is_plain", "key_rate", "local", "match", "match_report",
        "placement_duration", "placement_times", "plain_clip", "prepare_curves", "resample", "sample", "sample_clip", "sample_curve", "sample_curves",
        "sample_morphs", "sample_motion", "sample_timeline", "sample_timeline_morphs", "sample_timeline_values", "sample_value", "snap_to_keys", "to_clip", "to_motion",
        "unmatched", "value_for_result", "world", "world_rotations_positions",
    ]  # fmt: skip
    assert sorted(deform.__all__) == [
        "AutomaticWeights", "PackReport", "SurfaceError", "WeightsReport", "automatic_weights", "deform_character",
        "deform_part", "limit_influences", "mirror_weights", "morph", "morph_absolute", "morphs_from_shapes",
        "nearest_kept", "pack", "rebind", "simplify", "skin", "skin_character", "skin_matrices", "skin_points",
        "smooth_weights", "surface_error", "transfer_weights", "transform_normals",
    ]  # fmt: skip
    assert sorted(analysis.__all__) == [
        "BodyMasses",
        "Examination",
        "Finding",
        "Footing",
        "Ground",
        "Quality",
        "RoleMap",
        "RoundtripError",
        "SceneError",
        "TakeDifference",
        "compare_takes",
        "contact_changes",
        "contact_spans",
        "examine",
        "find_contacts",
        "find_footing",
        "find_roles",
        "foot_contacts",
        "human_limits",
        "human_masses",
        "measure_quality",
        "roles_from_json",
        "roundtrip_error",
        "scene_error",
    ]
    for package in (evaluate, deform, analysis):
        assert all(hasattr(package, name) for name in package.__all__)


def clip_at(times: object, rate_hz: float | None = None) -> Clip:
    values = np.zeros((len(times), 3))
    return Clip({Channel("hips", Property.TRANSLATION): Curve(times, values)}, rate_hz=rate_hz)


@pytest.mark.parametrize("rate_hz", [12, 24000 / 1001, 24, 25, 30000 / 1001, 30, 60, 120, 37.5])
def test_the_rate_of_uniform_keys_is_found_in_float32_too(rate_hz: float) -> None:
    for start_s in (0.0, 100.0):
        times = (start_s + np.arange(300) / rate_hz).astype(np.float32)
        assert key_rate(clip_at(times)) == pytest.approx(rate_hz, rel=1e-4)


def test_keys_that_are_not_on_frames_have_no_rate() -> None:
    assert key_rate(clip_at([0.0, 0.1, 0.37, 0.9])) is None
    assert key_rate(clip_at([0.0, 1.0])) is None
    assert key_rate(Clip()) is None
    assert key_rate(clip_at([0.0, 0.1, 0.37], rate_hz=24.0)) == 24.0  # what the clip says wins


def test_sparse_keys_on_frames_have_the_rate_of_the_frames() -> None:
    frames = np.array([0, 1, 7, 12, 30, 31, 90])
    assert key_rate(clip_at(frames / 30)) == pytest.approx(30)
