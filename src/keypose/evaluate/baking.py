"""The bridge between `Clip` (sparse curves) and `Motion` (uniform samples), and changes of rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import ShapeError
from keypose.evaluate.matching import match
from keypose.evaluate.rates import frame_rate
from keypose.evaluate.sampling import sample_clip, sample_morphs, sample_motion
from keypose.math import quat
from keypose.model import ROTATION_ONLY, Channel, Clip, Curve, CurveKind, Interpolation, Motion, Property, Skeleton

# Durations come from files that round them: 1 % of a frame short is still a whole frame.
_FRAME_ROUNDING = 0.01


def bake(
    clip: Clip,
    skeleton: Skeleton,
    rate_hz: float,
    start_s: float | None = None,
    end_s: float | None = None,
    morph_names: Sequence[str] = (),
    rest_morph_weights: Array | None = None,
) -> Motion:
    """A clip sampled at a uniform rate, for the joints of a skeleton and the morphs asked for.

    Frame 0 is at ``start_s`` (the clip's first key if not given); the last frame is the last one not after ``end_s``
    (the clip's last key). A frame whose time is a key's but for the rounding of float32 (in which glTF stores times)
    takes the key itself, so that keys written at a rate come back bit for bit when they are baked at that rate.

    Raises:
        ShapeError: where the rate is not positive or the end comes before the start.
    """
    start = clip.start_s if start_s is None else float(start_s)
    end = clip.end_s if end_s is None else float(end_s)
    count = _frame_count(start, end, rate_hz)
    times = start + np.arange(count) / rate_hz
    sampled = np.clip(snap_to_keys(clip, times, np.minimum(_rounding_s(times), 0.25 / rate_hz)), start, max(start, end))
    weights = sample_morphs(clip, morph_names, sampled, rest_morph_weights) if morph_names else None
    return Motion(
        skeleton.names,
        sample_clip(clip, skeleton, sampled),
        rate_hz,
        name=clip.name,
        start_s=start,
        morph_names=tuple(morph_names),
        morph_weights=weights,
    )


def to_motion(animation: Clip | Motion, skeleton: Skeleton, rate_hz: float | None = None) -> Motion:
    """An animation of any kind as frames of a skeleton's joints, found by name, with its morphs, at its own rate or another.

    A clip's own rate is that of `frame_rate`.

    Raises:
        ShapeError: where the rate is not positive.
    """
    own = match(animation, skeleton)
    if isinstance(own, Motion):
        return own if rate_hz is None or rate_hz == own.rate_hz else resample(own, rate_hz)
    morphs = sorted({c.target for c in own.curves if c.property is Property.WEIGHT})
    return bake(own, skeleton, frame_rate(own) if rate_hz is None else rate_hz, morph_names=morphs)


def to_clip(
    motion: Motion, interpolation: Interpolation = Interpolation.LINEAR, *, reduce_constant: bool = False
) -> Clip:
    """A motion as a clip with one key per frame on every joint's translation, rotation and scale and on every morph.

    HERMITE tangents are central differences (one-sided at the ends); rotations are then put on one side of the sphere.
    Where a channel cannot have the interpolation (BEZIER of rotations, splines on the sphere of others) it gets HERMITE. With ``reduce_constant`` a channel that never changes gets one key.
    """
    times = motion.times_s
    times.setflags(write=False)
    pose = motion.pose.broadcast()
    curves: dict[Channel, Curve] = {}

    def put(target: str, property: Property, values: Array, kind: CurveKind) -> None:
        if reduce_constant and bool((values == values[:1]).all()):
            curves[Channel(target, property)] = Curve(times[:1], values[:1], Interpolation.STEP, kind=kind)
            return
        turns = kind is CurveKind.ROTATION
        impossible = interpolation is Interpolation.BEZIER if turns else interpolation in ROTATION_ONLY
        mode = Interpolation.HERMITE if impossible else interpolation
        tangents = handles = None
        if mode is Interpolation.HERMITE or mode is Interpolation.BEZIER:
            values = quat.align_signs(values, axis=0) if turns else values
            tangents = _tangents(values, motion.rate_hz)
        if mode is Interpolation.BEZIER and tangents is not None:
            third = 1 / (3 * motion.rate_hz)
            handles = np.stack([np.full_like(tangents, third), third * tangents], axis=-1)
            tangents = None
        curves[Channel(target, property)] = Curve(
            times,
            values,
            mode,
            tangents,
            tangents,
            kind,
            in_handles=None if handles is None else -handles,
            out_handles=handles,
        )

    if motion.frame_count == 0:
        return Clip({}, motion.name, motion.rate_hz)
    for j, name in enumerate(motion.joint_names):
        put(name, Property.TRANSLATION, pose.translations[:, j, :], CurveKind.VECTOR)
        put(name, Property.ROTATION, pose.rotations[:, j, :], CurveKind.ROTATION)
        put(name, Property.SCALE, pose.scales[:, j, :], CurveKind.VECTOR)
    for m, name in enumerate(motion.morph_names):
        put(name, Property.WEIGHT, _weights(motion)[:, m : m + 1], CurveKind.SCALAR)
    return Clip(curves, motion.name, motion.rate_hz)


def resample(motion: Motion, rate_hz: float) -> Motion:
    """The same motion at another rate: slerp of rotations, lerp of translations, scales and morph weights.

    Frame 0 keeps its time; the last frame is the last one not after the old end. Events keep their times.

    Raises:
        ShapeError: where the rate is not positive.
    """
    count = _frame_count(0.0, motion.duration_s, rate_hz)
    times = motion.start_s + np.arange(count) / rate_hz
    # Where old and new frames coincide take the frame itself.
    position = (times - motion.start_s) * motion.rate_hz
    nearest = np.rint(position)
    close = np.abs(position - nearest) <= 1e-6 * motion.rate_hz
    times = np.where(close, motion.start_s + nearest / motion.rate_hz, times)
    weights = None if motion.morph_weights is None else sample_morphs(motion, motion.morph_names, times)
    return replace(motion, pose=sample_motion(motion, times), rate_hz=rate_hz, morph_weights=weights)


def snap_to_keys(clip: Clip, times_s: Array, tolerance_s: Array | float) -> Array:
    """Times (T,), each moved onto the clip's nearest key where one is within ``tolerance_s``.

    Files store key times in float32 or in a few decimals; sampling beside the key would lose its exact value.
    """
    times = np.asarray(times_s, np.float64)
    tables = {curve.times_s.tobytes(): curve.times_s for curve in clip.curves.values()}
    if not tables:
        return times
    keys = np.unique(np.concatenate(list(tables.values())))
    right = np.clip(np.searchsorted(keys, times), 0, len(keys) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(np.abs(keys[left] - times) < np.abs(keys[right] - times), keys[left], keys[right])
    return np.where(np.abs(nearest - times) <= tolerance_s, nearest, times)


def _weights(motion: Motion) -> Array:
    if motion.morph_weights is None:
        raise ShapeError("motion: it has morph names but no weights")
    return motion.morph_weights


def _frame_count(start: float, end: float, rate_hz: float) -> int:
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise ShapeError(f"rate_hz: expected a positive number, got {rate_hz}")
    if not (np.isfinite(start) and np.isfinite(end) and end >= start):
        raise ShapeError(f"end_s: expected a time not before the start at {start} s, got {end} s")
    rounding = max(_FRAME_ROUNDING, min(float(_rounding_s(end)) * rate_hz, 0.25))
    return int(np.floor((end - start) * rate_hz + rounding)) + 1


def _rounding_s(times_s: Any) -> Any:
    """By how much two times may differ that were one before they were rounded to float32."""
    return 1e-6 + np.abs(times_s) * 2.0**-23


def _tangents(values: Array, rate_hz: float) -> Array:
    """Central differences in units per second, (T, C)."""
    if len(values) < 2:
        return np.zeros_like(values)
    steps = (values[1:] - values[:-1]) * rate_hz
    return np.concatenate([steps[:1], (steps[1:] + steps[:-1]) / 2, steps[-1:]]).astype(values.dtype)
