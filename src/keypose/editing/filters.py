"""Smoothing of keys: Gaussian and Butterworth filters over keys at any times."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, cast

import numpy as np

from keypose.arrays import Array
from keypose.editing.keys import key_indices
from keypose.editing.tangents import update_tangents
from keypose.errors import ShapeError, UnknownName
from keypose.math import quat
from keypose.model import Curve, CurveKind, Tangent

_REACH = 3.0  # standard deviations


def smooth_keys(
    curve: Curve,
    width_s: float,
    keys: Any = None,
    *,
    method: Literal["gaussian", "butterworth"] = "gaussian",
    amount: float = 1.0,
    keep_ends: bool = True,
) -> Curve:
    """Keys (indices, or all) moved towards what a low-pass filter makes of the curve; times stay.

    Units: ``width_s`` is the standard deviation of the Gaussian, or half the period at which the Butterworth filter (second
    order, forwards and backwards, so that nothing is delayed) lets half of a wave through. ``amount`` 0..1 is how far keys go
    towards the filtered value. Outside its keys the curve is taken to go on turned about its end (odd extension), so that
    straight movement stays as it is; with ``keep_ends`` the first and the last key stay, too. Sides that were FREE and ALIGNED
    become AUTO. Rotations are filtered in the tangent space of each key's neighbourhood.

    Raises: ShapeError where the width is not positive, the amount not in 0..1, or an index none of the curve's; UnknownName
        for a method that does not exist.
    Source: Butterworth, On the theory of filter amplifiers (1930); zero phase by Gustafsson (1996).
    """
    if not (np.isfinite(width_s) and width_s > 0):
        raise ShapeError(f"width_s: expected more than 0, got {width_s}")
    if not 0 <= amount <= 1:
        raise ShapeError(f"amount: expected 0..1, got {amount}")
    if method not in ("gaussian", "butterworth"):
        raise UnknownName("filter", str(method), ("gaussian", "butterworth"))
    chosen = np.arange(curve.key_count) if keys is None else key_indices(curve, keys)
    if curve.kind is CurveKind.BOOLEAN or curve.key_count < 3:
        return curve
    values = np.asarray(curve.values, np.float64)
    rotation = curve.kind is CurveKind.ROTATION
    if rotation:
        values = quat.align_signs(values, axis=0)
    filtered = (_gaussian if method == "gaussian" else _butterworth)(curve.times_s, values, width_s)
    if rotation:
        filtered = quat.normalize(filtered)
    move = np.zeros(curve.key_count)
    move[chosen] = amount
    if keep_ends:
        move[[0, -1]] = 0.0
    if rotation:
        result = quat.slerp(values, filtered, move)
        flip = np.sum(result * np.asarray(curve.values, np.float64), axis=-1, keepdims=True) < 0
        result = np.where(flip, -result, result)
    else:
        result = values + move[:, None] * (filtered - values)
    touched = move > 0
    made = replace(curve, values=result.astype(curve.values.dtype))
    if curve.in_tangents is not None or curve.in_handles is not None:
        types = (
            np.zeros((curve.key_count, 2), np.uint8) if curve.tangent_types is None else np.array(curve.tangent_types)
        )
        loose = touched[:, None] & ((types == Tangent.FREE) | (types == Tangent.ALIGNED))
        made = replace(made, tangent_types=np.where(loose, np.uint8(Tangent.AUTO), types))
    return update_tangents(made)


def _extended(times: Array, values: Array, reach_s: float) -> tuple[Array, Array, int]:
    """Keys with their odd extension about both ends as far as ``reach_s``, and where the first key is."""
    before = np.nonzero(times[1:] - times[0] <= reach_s)[0] + 1
    after = np.nonzero(times[-1] - times[:-1] <= reach_s)[0]
    t = np.concatenate([2 * times[0] - times[before][::-1], times, 2 * times[-1] - times[after][::-1]])
    v = np.concatenate([2 * values[0] - values[before][::-1], values, 2 * values[-1] - values[after][::-1]])
    return t, v, len(before)


def _gaussian(times: Array, values: Array, sigma_s: float) -> Array:
    """Weighted means of keys; each counts as long as the time that it stands for (half of both its spans)."""
    t, v, _ = _extended(times, values, _REACH * sigma_s)
    gaps = np.diff(t)
    share = np.concatenate([[gaps[0] / 2], (gaps[1:] + gaps[:-1]) / 2, [gaps[-1] / 2]])
    low = np.searchsorted(t, times - _REACH * sigma_s, side="left")
    high = np.searchsorted(t, times + _REACH * sigma_s, side="right")
    widest = int(np.max(high - low))
    column = np.arange(widest)
    result = np.empty_like(values)
    block = max(1, 4_000_000 // max(widest, 1))
    for start in range(0, len(times), block):
        rows = slice(start, start + block)
        index = np.minimum(low[rows, None] + column, len(t) - 1)
        inside = low[rows, None] + column < high[rows, None]
        offset = t[index] - times[rows, None]
        weight = np.where(inside, share[index] * np.exp(-0.5 * (offset / sigma_s) ** 2), 0.0)
        total = weight.sum(axis=1)[:, None]
        # Unequal keys must not pull a straight movement off its line: the weights' own mean time is made the key's.
        mean = (weight * offset).sum(axis=1)[:, None] / total
        spread = (weight * offset**2).sum(axis=1)[:, None] / total - mean**2
        tilt = np.where(spread > 1e-12 * sigma_s**2, -mean / np.where(spread > 0, spread, 1.0), 0.0)
        weight = weight * (1 + tilt * (offset - mean)) / total
        result[rows] = np.einsum("kn,knc->kc", weight, v[index])
    return result


def _butterworth(times: Array, values: Array, half_period_s: float) -> Array:
    """Second-order low-pass forwards and backwards, on even samples between the keys."""
    step = float(np.min(np.diff(times)))
    step = max(step, (times[-1] - times[0]) / 200_000)
    count = int(np.ceil((times[-1] - times[0]) / step - 1e-6)) + 1
    even = np.linspace(times[0], times[-1], count)
    step = float(even[1] - even[0])
    dense = np.stack([np.interp(even, times, v) for v in values.T], axis=-1)
    _, v, first = _extended(even, dense, 6 * half_period_s)
    cut_hz = 0.5 / half_period_s  # once through leaves the root of a half of that wave, twice the half
    nyquist = 0.5 / step
    if cut_hz >= 0.95 * nyquist:
        return values
    from scipy.signal import butter, lfilter

    numerator, denominator = cast("tuple[Array, Array]", butter(2, cut_hz / nyquist))
    for _ in range(2):
        v = (v[0] + lfilter(numerator, denominator, v - v[0], axis=0))[::-1]
    smooth = v[first : first + count]
    return np.stack([np.interp(times, even, column) for column in smooth.T], axis=-1)
