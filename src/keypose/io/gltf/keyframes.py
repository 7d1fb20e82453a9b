"""Curves as glTF samplers: one interpolation for all keys, and one set of times for all of a node's weights.

A curve may mix interpolations and a node's morphs may have keys of their own; glTF's samplers may not. Keys are then
added where they change nothing: on a line, on a cubic, just before a step.

Source: glTF 2.0 Specification, appendix C; course notes B4 (Hermite).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from keypose.math import quat
from keypose.model import Curve, CurveKind, Interpolation

LARGEST_ARC = np.radians(4.0)  # of a rotation that becomes a cubic; the error is then below 1e-8


@dataclass(frozen=True, slots=True)
class Track:
    """Keys of one interpolation: ``values`` (K, C), tangents (K, C) for HERMITE."""

    times_s: NDArray[np.float64]
    values: NDArray[np.floating]
    mode: Interpolation
    in_tangents: NDArray[np.floating] | None = None
    out_tangents: NDArray[np.floating] | None = None

    def columns(self, indices: Sequence[int]) -> Track:
        """Some of the components."""
        ins, outs = self.in_tangents, self.out_tangents
        return Track(
            self.times_s,
            self.values[:, indices],
            self.mode,
            None if ins is None else ins[:, indices],
            None if outs is None else outs[:, indices],
        )


def track_of(curve: Curve) -> Track:
    """The same curve with one interpolation for all its spans."""
    modes = {Interpolation(int(m)) for m in curve.modes[:-1]}
    if curve.key_count == 1 or not modes:
        return Track(curve.times_s, curve.values, Interpolation.STEP if curve.modes[0] == 0 else Interpolation.LINEAR)
    if len(modes) == 1:
        mode = modes.pop()
        if mode is Interpolation.HERMITE:
            return Track(curve.times_s, curve.values, mode, curve.in_tangents, curve.out_tangents)
        return Track(curve.times_s, curve.values, mode)
    return _as_cubic(curve) if Interpolation.HERMITE in modes else _as_lines(curve)


def single_precision(track: Track) -> tuple[Track, int]:
    """The track with its times rounded, and how many keys fell on the time of their successor and were dropped."""
    times = track.times_s.astype(np.float32).astype(np.float64)
    kept = np.concatenate([times[:-1] < times[1:], [True]])
    if np.all(kept):
        return replace(track, times_s=times), 0
    ins, outs = track.in_tangents, track.out_tangents
    first = np.concatenate([[True], kept[:-1]])  # of keys at one time, the first has what arrives, the last what leaves
    rounded = Track(
        times[kept],
        track.values[kept],
        track.mode,
        None if ins is None else ins[first],
        None if outs is None else outs[kept],
    )
    return rounded, int(np.sum(~kept))


def _just_before(time_s: float) -> float:
    return float(np.nextafter(np.float32(time_s), np.float32(-np.inf)))


def _as_lines(curve: Curve) -> Track:
    """Steps become lines that stay level until just before the next key."""
    times, values = [], []
    for k in range(curve.key_count):
        times.append(float(curve.times_s[k]))
        values.append(curve.values[k])
        if k + 1 < curve.key_count and curve.modes[k] == Interpolation.STEP:
            before = _just_before(curve.times_s[k + 1])
            if before > times[-1]:
                times.append(before)
                values.append(curve.values[k])
    return Track(np.array(times), np.array(values), Interpolation.LINEAR)


def _as_cubic(curve: Curve) -> Track:
    """Lines and steps become cubics."""
    if curve.kind is CurveKind.ROTATION:
        curve = _on_one_side(curve)
    times, values, ins, outs = [], [], [], []
    flat = np.zeros(curve.values.shape[1])
    entering = flat

    def key(time: float, value: NDArray[np.floating], arriving: NDArray[np.floating], leaving: NDArray[np.floating]):
        times.append(time)
        values.append(value)
        ins.append(arriving)
        outs.append(leaving)

    for k in range(curve.key_count):
        time, value = float(curve.times_s[k]), curve.values[k]
        if k + 1 == curve.key_count:
            key(time, value, entering, flat)
            break
        following, after = curve.values[k + 1], float(curve.times_s[k + 1])
        span = after - time
        mode = curve.modes[k]
        if mode == Interpolation.HERMITE and curve.out_tangents is not None and curve.in_tangents is not None:
            key(time, value, entering, curve.out_tangents[k])
            entering = curve.in_tangents[k + 1]
        elif mode == Interpolation.STEP:
            key(time, value, entering, flat)
            before = _just_before(after)
            if before > time:
                key(before, value, flat, (following - value) / (after - before))
            entering = (following - value) / (after - max(before, time))
        elif curve.kind is CurveKind.ROTATION:
            turn = np.asarray(quat.log(quat.difference(value, following)), np.float64)  # half-angle vector
            pieces = int(max(np.ceil(2 * np.linalg.norm(turn) / LARGEST_ARC), 1))
            speed = np.concatenate([[0.0], turn]) / span  # of q' = speed * q
            for piece in range(pieces):
                at = np.asarray(quat.multiply(quat.exp(turn * (piece / pieces)), value), np.float64)
                slope = np.asarray(quat.multiply(speed, at))
                key(time + span * piece / pieces, at if piece else value, slope if piece else entering, slope)
            last = np.asarray(quat.multiply(quat.exp(turn), value), np.float64)
            entering = np.asarray(quat.multiply(speed, last))
        else:
            slope = (following - value) / span
            key(time, value, entering, slope)
            entering = slope
    return Track(np.array(times), np.array(values), Interpolation.HERMITE, np.array(ins), np.array(outs))


def _on_one_side(curve: Curve) -> Curve:
    """The same rotations, with signs such that the ends of each slerped span are on the short way."""
    dots = np.sum(curve.values[:-1] * curve.values[1:], axis=1)
    turns = np.where((curve.modes[:-1] == Interpolation.LINEAR) & (dots < 0), -1, 1)
    sign = np.concatenate([[1], np.cumprod(turns)])[:, None].astype(curve.values.dtype)
    ins, outs = curve.in_tangents, curve.out_tangents
    return Curve(
        curve.times_s,
        curve.values * sign,
        curve.modes,
        None if ins is None else ins * sign,
        None if outs is None else outs * sign,
        curve.kind,
    )


def join(tracks: Sequence[Track]) -> Track:
    """Several scalar tracks as one with a column for each; keys are added where a track has none of its own."""
    modes = {t.mode for t in tracks if len(t.times_s) > 1}
    if not modes:
        modes = {Interpolation.LINEAR}
    if len(modes) > 1:
        tracks = [_raised(t, Interpolation.HERMITE in modes) for t in tracks]
        mode = Interpolation.HERMITE if Interpolation.HERMITE in modes else Interpolation.LINEAR
    else:
        mode = modes.pop()
    times = tracks[0].times_s
    if not all(np.array_equal(times, t.times_s) for t in tracks):
        times = np.unique(np.concatenate([t.times_s for t in tracks]))
    columns = [_at(t, times, mode) for t in tracks]
    values, ins, outs = (np.concatenate([c[i] for c in columns], axis=1) for i in range(3))
    return Track(times, values, mode, *((ins, outs) if mode is Interpolation.HERMITE else (None, None)))


def _raised(track: Track, cubic: bool) -> Track:
    if len(track.times_s) == 1 or track.mode is Interpolation.HERMITE:
        return track
    curve = Curve(track.times_s, track.values, track.mode)
    return _as_cubic(curve) if cubic else _as_lines(curve)


def _at(
    track: Track, times: NDArray[np.float64], mode: Interpolation
) -> tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating]]:
    """Values and tangents of a track at more times than its own."""
    own, values = track.times_s, track.values
    zeros = np.zeros((len(times), values.shape[1]), values.dtype)
    cubic = mode is Interpolation.HERMITE and track.in_tangents is not None and track.out_tangents is not None
    if np.array_equal(own, times):
        return (values, track.in_tangents, track.out_tangents) if cubic else (values, zeros, zeros)  # type: ignore[return-value]
    k = np.clip(np.searchsorted(own, times, side="right") - 1, 0, max(len(own) - 2, 0))
    after = np.minimum(k + 1, len(own) - 1)
    span = np.where(after > k, own[after] - own[k], 1.0)
    u = np.clip((times - own[k]) / span, 0.0, 1.0)[:, None]
    exact = np.isin(times, own)
    nearest = np.clip(np.searchsorted(own, times), 0, len(own) - 1)
    if not cubic:
        between = values[k] if mode is Interpolation.STEP else values[k] * (1 - u) + values[after] * u
        if mode is Interpolation.STEP:
            between = np.where((times >= own[-1])[:, None], values[-1], between)
        return np.where(exact[:, None], values[nearest], between), zeros, zeros
    ins, outs = track.in_tangents, track.out_tangents
    if ins is None or outs is None:
        return values, zeros, zeros
    p0, p1, m0, m1 = values[k], values[after], outs[k] * span[:, None], ins[after] * span[:, None]
    value = (
        (2 * u**3 - 3 * u**2 + 1) * p0 + (u**3 - 2 * u**2 + u) * m0 + (3 * u**2 - 2 * u**3) * p1 + (u**3 - u**2) * m1
    )
    slope = (6 * u**2 - 6 * u) * (p0 - p1) + (3 * u**2 - 4 * u + 1) * m0 + (3 * u**2 - 2 * u) * m1
    slope = np.where(((times > own[0]) & (times < own[-1]))[:, None], slope / span[:, None], 0.0)
    here = exact[:, None]
    arriving = np.where(here & (times > own[0])[:, None], ins[nearest], np.where(here, 0.0, slope))
    leaving = np.where(here & (times < own[-1])[:, None], outs[nearest], np.where(here, 0.0, slope))
    return np.where(here, values[nearest], value), arriving, leaving
