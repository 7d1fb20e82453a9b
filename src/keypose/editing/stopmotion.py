"""Stop motion: a puppet is posed, photographed, posed again, so that every pose is held and none is quite exact."""

from __future__ import annotations

import zlib

import numpy as np

from keypose.arrays import Array
from keypose.editing.selection import EVERYTHING, Selection, chosen_channels, with_curves
from keypose.errors import ShapeError
from keypose.evaluate import sample_curve
from keypose.math import quat
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation, Property


def stop_motion(
    clip: Clip,
    selection: Selection = EVERYTHING,
    hold_frames: int = 2,
    rate_hz: float = 25.0,
    jitter_deg: float = 0.0,
    jitter_m: float = 0.0,
    seed: int = 1,
) -> Clip:
    """The clip as held poses, one for every ``hold_frames`` frames: on ones, twos, threes; with the unsteadiness of hands.

    Chosen channels are sampled at the start of every exposure and hold until the next one. ``jitter_deg`` turns every joint
    of every pose a little (the standard deviation, in degrees, about a random axis), ``jitter_m`` moves what has positions;
    the same seed gives the same film. Values that are nowhere keyed but once stay still.

    Raises: ShapeError where ``hold_frames`` is below 1 or another number out of its range.
    """
    if hold_frames < 1:
        raise ShapeError(f"hold_frames: expected 1 or more, got {hold_frames}")
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise ShapeError(f"rate_hz: expected more than 0, got {rate_hz}")
    for label, number in (("jitter_deg", jitter_deg), ("jitter_m", jitter_m)):
        if not (np.isfinite(number) and number >= 0):
            raise ShapeError(f"{label}: expected 0 or more, got {number}")
    channels = chosen_channels(clip, selection)
    start = min((float(clip.curves[c].times_s[0]) for c in channels), default=0.0)
    end = max((float(clip.curves[c].times_s[-1]) for c in channels), default=0.0)
    start = start if selection.start_s is None else selection.start_s
    end = end if selection.end_s is None else selection.end_s
    exposure = hold_frames / rate_hz
    # Exposures lie on the grid of frames from zero, so that all clips of a film change pose together.
    first = np.floor(start / exposure + 1e-6)
    times = exposure * np.arange(first, np.floor(end / exposure + 1e-6) + 1)
    made: dict[Channel, Curve] = {}
    for channel in channels:
        curve = clip.curves[channel]
        if curve.key_count == 1:
            continue
        values = np.array(sample_curve(curve, times), np.float64)
        random = np.random.default_rng([seed, zlib.crc32(str(channel).encode())])
        values = _unsteady(values, channel, curve.kind, jitter_deg, jitter_m, random)
        made[channel] = Curve(
            times,
            values.astype(np.asarray(curve.values).dtype),
            Interpolation.STEP,
            kind=curve.kind,
            before=curve.before,
            after=curve.after,
        )
    return with_curves(clip, made)


def _unsteady(
    values: Array, channel: Channel, kind: CurveKind, jitter_deg: float, jitter_m: float, random: np.random.Generator
) -> Array:
    if kind is CurveKind.ROTATION and jitter_deg:
        axis = random.normal(size=(len(values), 3))
        axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
        angle = np.radians(jitter_deg) * random.normal(size=len(values))
        return quat.multiply(values, quat.from_axis_angle(axis, angle))
    if channel.property is Property.EULER and jitter_deg:
        return values + np.radians(jitter_deg) / np.sqrt(3) * random.normal(size=values.shape)
    if channel.property is Property.TRANSLATION and jitter_m:
        return values + jitter_m / np.sqrt(3) * random.normal(size=values.shape)
    return values
