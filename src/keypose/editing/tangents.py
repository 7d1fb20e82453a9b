"""Tangents and handles that follow their keys, by the type of each side.

The rule, which the editor in the browser follows too (``client/src/edit/tangents.ts``). Key k has the time t, one component
has the value v; h0 = t[k] - t[k-1] and h1 = t[k+1] - t[k] are the spans beside it, and s0 = (v[k] - v[k-1]) / h0 and
s1 = (v[k+1] - v[k]) / h1 the slopes of their chords. Each side of a key gets a slope per second:

    FREE, ALIGNED   as it is
    FLAT            0
    VECTOR          before the key s0, after it s1; at the first and the last key that of the only chord
    AUTO            (v[k+1] - v[k-1]) / (t[k+1] - t[k-1]); at the first and the last key that of the only chord
    CLAMPED         0 at the first and the last key and where s0 s1 <= 0; else that of AUTO, but no further from 0 than
                    3 min(|s0|, |s1|), so that no span leaves the range of its two keys

A HERMITE tangent is that slope. A BEZIER handle reaches a third of its span: h0 / 3 before and h1 / 3 after the key; beyond
the first and the last key as far as on the other side; its value is slope times seconds. A curve of one key has slope 0 and
handles of no length. Rotations follow the rule component by component, on signs that keep neighbours on one side of the
sphere.

Source: AUTO is Catmull and Rom 1974 over the times of the keys (lecture notes, Catmull-Rom); CLAMPED the sufficient square
of Fritsch and Carlson, Monotone piecewise cubic interpolation (1980).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.model import Curve, Interpolation, Tangent

FOLLOWING = (Tangent.VECTOR, Tangent.AUTO, Tangent.CLAMPED, Tangent.FLAT)
"""Types whose sides are computed from the keys."""


def update_tangents(curve: Curve, keys: Any = None) -> Curve:
    """The curve with the sides that follow their keys brought up to date, of all keys or of some (indices).

    What a key's neighbours did can change its sides, so after a change give the changed keys and those beside them. A curve
    without tangent types, or without tangents and handles, is returned as it is.
    """
    if curve.tangent_types is None or (curve.in_tangents is None and curve.in_handles is None):
        return curve
    chosen = np.ones(curve.key_count, bool)
    if keys is not None:
        chosen = np.zeros(curve.key_count, bool)
        chosen[np.asarray(keys, np.intp)] = True
    types = np.asarray(curve.tangent_types)
    follows = chosen[:, None] & np.isin(types, FOLLOWING)
    if not np.any(follows):
        return curve
    slopes = _slopes(curve, types)
    before, after = reaches(curve.times_s)
    changes: dict[str, Array] = {}
    for side, sign, reach in ((0, -1.0, before), (1, 1.0, after)):
        name = ("in", "out")[side]
        mine = follows[:, side, None]
        tangents, handles = getattr(curve, f"{name}_tangents"), getattr(curve, f"{name}_handles")
        if tangents is not None:
            changes[f"{name}_tangents"] = np.where(mine, slopes[side], tangents).astype(tangents.dtype)
        if handles is not None:
            seconds = np.broadcast_to(sign * reach[:, None], slopes[side].shape)
            own = np.stack([seconds, seconds * slopes[side]], axis=-1)
            changes[f"{name}_handles"] = np.where(mine[..., None], own, handles).astype(handles.dtype)
    return replace(curve, **changes)


def reaches(times_s: Array) -> tuple[Array, Array]:
    """A third of the span before and after each key (K,), in seconds; at the ends that of the only span."""
    if len(times_s) == 1:
        return np.zeros(1), np.zeros(1)
    thirds = np.diff(times_s) / 3
    return np.concatenate([thirds[:1], thirds]), np.concatenate([thirds, thirds[-1:]])


def with_tangents(curve: Curve) -> Curve:
    """A curve that has tangents: of Bezier spans the slopes of their handles, of all others those of their chords."""
    if curve.in_tangents is not None:
        return curve
    out, back = _end_slopes(curve)
    return replace(curve, in_tangents=back, out_tangents=out)


def with_handles(curve: Curve) -> Curve:
    """A curve that has handles: of Hermite spans those of the same cubic, of all others a third of the way along the chord."""
    if curve.in_handles is not None:
        return curve
    out, back = _end_slopes(curve)
    before, after = reaches(curve.times_s)

    def handles(slopes: Array, reach: Array) -> Array:
        seconds = np.broadcast_to(reach[:, None], slopes.shape)
        return np.stack([seconds, seconds * slopes], axis=-1).astype(slopes.dtype)

    return replace(curve, in_handles=handles(back, -before), out_handles=handles(out, after))


def with_types(curve: Curve) -> Curve:
    """A curve that has tangent types: FREE where nothing was said."""
    if curve.tangent_types is not None:
        return curve
    return replace(curve, tangent_types=np.zeros((curve.key_count, 2), np.uint8))


def _end_slopes(curve: Curve) -> tuple[Array, Array]:
    """Slopes (K, C) after and before each key: those of its spans, beyond the ends 0."""
    values = np.asarray(curve.values)
    out, back = np.zeros_like(values), np.zeros_like(values)
    if curve.key_count < 2:
        return out, back
    chords = np.diff(values, axis=0) / np.diff(curve.times_s)[:, None]
    modes = np.asarray(curve.modes[:-1])[:, None]
    for side, into, near in ((1, out, slice(None, -1)), (0, back, slice(1, None))):
        name = ("in", "out")[side]
        tangents, handles = getattr(curve, f"{name}_tangents"), getattr(curve, f"{name}_handles")
        slopes = chords
        if tangents is not None:
            slopes = np.where(modes == Interpolation.HERMITE, tangents[near], slopes)
        if handles is not None:
            seconds, value = handles[near, :, 0], handles[near, :, 1]
            steep = np.where(seconds == 0, chords, value / np.where(seconds == 0, 1.0, seconds))
            slopes = np.where(modes == Interpolation.BEZIER, steep, slopes)
        into[near] = slopes
    return out, back


def _slopes(curve: Curve, types: Array) -> tuple[Array, Array]:
    """Slopes (K, C) of both sides by their types; of FREE and ALIGNED sides anything."""
    values, times = np.asarray(curve.values, np.float64), curve.times_s
    if curve.key_count == 1:
        return np.zeros_like(values), np.zeros_like(values)
    chords = np.diff(values, axis=0) / np.diff(times)[:, None]
    before, after = np.concatenate([chords[:1], chords]), np.concatenate([chords, chords[-1:]])
    auto = np.concatenate([chords[:1], (values[2:] - values[:-2]) / (times[2:] - times[:-2])[:, None], chords[-1:]])
    limit = 3.0 * np.minimum(np.abs(before), np.abs(after))
    clamped = np.where(before * after <= 0, 0.0, np.clip(auto, -limit, limit))
    clamped[[0, -1]] = 0.0
    found: list[Array] = []
    for side, vector in ((0, before), (1, after)):
        kind = types[:, side, None]
        found.append(
            np.where(
                kind == Tangent.VECTOR,
                vector,
                np.where(kind == Tangent.AUTO, auto, np.where(kind == Tangent.CLAMPED, clamped, 0.0)),
            )
        )
    return found[0], found[1]
