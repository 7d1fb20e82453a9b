"""Tracks of numbers along time: cyclic and eased keys, blinks, and the contact of a foot with the ground."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from keypose.arrays import Floats
from keypose.samples.skeleton import rest_positions

# How far tracks are rounded off at their keys: seconds to each side, and shares of a cycle.
_ROUND_S = 0.07
_ROUND_PHASE = 0.025
_SAMPLES = 16


def cyclic(phase: Floats, keys: Sequence[tuple[float, float]]) -> Floats:
    """A periodic track near (phase, value) keys, phase in 0..1, that never overshoots (monotone cubic, rounded off)."""
    from scipy.interpolate import PchipInterpolator

    times, values = np.array(sorted(keys), np.float64).T
    laps = np.concatenate([times - 1, times, times + 1])
    return _rounded(PchipInterpolator(laps, np.tile(values, 3)), np.asarray(phase) % 1, _ROUND_PHASE)


def eased(times_s: Floats, keys: Sequence[tuple[float, float]]) -> Floats:
    """A track near (second, value) keys that eases in and out at each and never overshoots (monotone cubic, rounded off).

    It stands still before the first key and after the last.
    """
    from scipy.interpolate import PchipInterpolator

    times, values = np.array([(keys[0][0] - 1.0, keys[0][1]), *keys, (keys[-1][0] + 1.0, keys[-1][1])], np.float64).T
    curve = PchipInterpolator(times, values)
    return _rounded(lambda t: curve(np.clip(t, times[0], times[-1])), np.asarray(times_s, np.float64), _ROUND_S)


def _rounded(curve: Callable[[Floats], Floats], at: Floats, half_width: float) -> Floats:
    """A curve averaged over a raised cosine: what joins cubics with one speed has one acceleration as well."""
    offsets = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * 2 - 1
    weights = 1 + np.cos(np.pi * offsets)
    moved = np.asarray(at)[..., None] + half_width * offsets
    return curve(moved) @ (weights / weights.sum())


def rounded(track: Floats, frames: int) -> Floats:
    """A track (T, C) averaged over a raised cosine of so many frames to each side, its ends held."""
    from scipy.ndimage import convolve1d

    weights = 1 + np.cos(np.pi * np.arange(-frames, frames + 1) / (frames + 1))
    return convolve1d(track, weights / weights.sum(), axis=0, mode="nearest")


def bump(times_s: Floats, centre_s: float, rise_s: float, fall_s: float | None = None) -> Floats:
    """A smooth bump of height 1 that rises and falls within the given times (raised cosine)."""
    fall_s = rise_s if fall_s is None else fall_s
    offset = np.asarray(times_s) - centre_s
    part = np.where(offset < 0, -offset / rise_s, offset / fall_s)
    return 0.5 + 0.5 * np.cos(np.pi * np.minimum(part, 1.0))


def blinks(times_s: Floats, moments_s: Sequence[float]) -> dict[str, Floats]:
    """Weights of both lids: quick to close, slower to open."""
    lids = np.zeros_like(times_s)
    for moment in moments_s:
        lids = np.maximum(lids, bump(times_s, moment, 0.075, 0.14))
    return {"eyeBlinkLeft": lids, "eyeBlinkRight": lids}


def smooth_sum(times_s: Floats, period_s: float, waves: Sequence[tuple[int, float, float]]) -> Floats:
    """A looping wander: (harmonic of the period, amplitude, phase in turns) added up."""
    phase = np.asarray(times_s) / period_s
    total = np.zeros_like(phase)
    for harmonic, amplitude, shift in waves:
        total += amplitude * np.sin(2 * np.pi * (harmonic * phase + shift))
    return total


def rolled_ankle(side: str, flat_ankle: Floats, pitch_deg: Floats, yaw_deg: float) -> tuple[Floats, Floats]:
    """The ankle and the toe bend of a foot that rolls over the ground without sliding.

    Positive pitch turns on the heel (toes up), negative pitch on the toe joint (heel up, toes flat).

    Shapes and units:
        flat_ankle: (3,) or (T, 3) the ankle's place when the foot is flat; pitch_deg: (T,).
        Returns the ankle (T, 3) and the toe bend (T,) in degrees.
    """
    rest = rest_positions()
    ankle, ball = rest[f"{side}Foot"], rest[f"{side}ToeBase"]
    heel = np.array([ankle[0], 0.0, ankle[2] - 0.045])
    out = np.radians(yaw_deg if side == "Left" else -yaw_deg)
    pitch = np.radians(pitch_deg)
    pivot = np.where((pitch > 0)[:, None], heel, ball)
    arm = ankle - pivot
    # Pitch turns about -x: toes up for positive angles.
    y = arm[:, 1] * np.cos(pitch) + arm[:, 2] * np.sin(pitch)
    z = arm[:, 2] * np.cos(pitch) - arm[:, 1] * np.sin(pitch)
    moved = np.stack([arm[:, 0], y, z], axis=-1) + pivot - ankle
    turned = np.stack(
        [
            moved[:, 0] * np.cos(out) + moved[:, 2] * np.sin(out),
            moved[:, 1],
            moved[:, 2] * np.cos(out) - moved[:, 0] * np.sin(out),
        ],
        axis=-1,
    )
    return flat_ankle + turned, np.degrees(np.maximum(-pitch, 0.0))
