"""The rate a clip's keys were made at."""

from __future__ import annotations

import numpy as np

from keypose.model import Clip

# A key may lie this share of a frame beside its place: formats keep times in float32 or in six decimals.
_ON_FRAME = 0.02
_COMMON_HZ = np.array([12, 15, 24000 / 1001, 24, 25, 30000 / 1001, 30, 48, 50, 60000 / 1001, 60, 90, 100, 120, 240])


FALLBACK_RATE_HZ = 30.0
"""Frames a second of a clip that states no rate and whose keys have none."""


def frame_rate(clip: Clip) -> float:
    """The rate in Hz by which frames of a clip count: that of `key_rate`, else `FALLBACK_RATE_HZ`."""
    return key_rate(clip) or FALLBACK_RATE_HZ


def key_rate(clip: Clip) -> float | None:
    """The rate in Hz whose frames hold every key of the clip, or None where the keys are not uniform.

    A rate that the clip states wins; a rate found within rounding of a usual one (25, 29.97, 30, 60, ...) is that one.
    """
    if clip.rate_hz is not None:
        return clip.rate_hz
    times = np.unique(np.concatenate([np.zeros(0), *(c.times_s for c in clip.curves.values())]))
    if len(times) < 3:
        return None
    times = times - times[0]
    gaps = np.diff(times)
    gaps = gaps[gaps > 1e-5]  # keys closer than rounding are one key
    if not len(gaps):
        return None
    rate = 1 / float(np.min(gaps))
    steps = np.rint(times[-1] * rate)
    rate = float(steps / times[-1])  # over the whole length, rounding of one gap no longer counts
    common = _COMMON_HZ[np.argmin(np.abs(_COMMON_HZ - rate))]
    candidates = [float(common), rate] if abs(common - rate) < 0.005 * common else [rate]
    for candidate in candidates:
        frames = times * candidate
        if np.all(np.abs(frames - np.rint(frames)) <= _ON_FRAME):
            return candidate
    return None
