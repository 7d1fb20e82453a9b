# pyright: basic
"""Sampling of many curves at once, against SciPy's splines called one by one and against reading memory."""

from __future__ import annotations

import numpy as np

from keypose.bench.suite import BenchmarkError, Suite
from keypose.evaluate import prepare_curves, sample_curves
from keypose.kernels.runtime import WIDTH, aligned
from keypose.model import Curve, CurveKind, Interpolation

_CURVES, _KEYS, _LENGTH_S = 3000, 60, 20.0
_BAKED = 1200  # times: 20 s at 60 Hz
_LINE_CURVES, _LINE_KEYS = 1000, 1200


def add(suite: Suite) -> None:
    """All cases of the suite."""
    from scipy.interpolate import CubicHermiteSpline

    rng = np.random.default_rng(0)
    keys = [np.sort(rng.uniform(0, _LENGTH_S, _KEYS)) for _ in range(_CURVES)]
    values, slopes = rng.normal(size=(2, _CURVES, _KEYS, 1)).astype(np.float32)
    cubics = [
        Curve(k, v, Interpolation.HERMITE, m, m, CurveKind.SCALAR) for k, v, m in zip(keys, values, slopes, strict=True)
    ]
    table = prepare_curves(cubics)
    splines = [CubicHermiteSpline(k, v[:, 0], m[:, 0]) for k, v, m in zip(keys, values, slopes, strict=True)]
    inside = np.linspace(max(k[0] for k in keys), min(k[-1] for k in keys), _BAKED)
    off = max(np.abs(sample_curves(table, inside)[:, n] - splines[n](inside)).max() for n in range(0, _CURVES, 97))
    if off > 1e-4:
        raise BenchmarkError(f"curves: sampled values differ from SciPy's by {off:.2g}")
    moment = iter(np.tile(inside, 100_000))
    each = f"{_CURVES:,} cubic curves of {_KEYS} keys"
    suite.case(
        f"{each}, one time", "ns", _CURVES, lambda: sample_curves(table, next(moment)),
        lambda: [spline(inside[700]) for spline in splines], "SciPy CubicHermiteSpline per channel",
    )  # fmt: skip
    suite.case(
        f"{each}, {_BAKED:,} times", "ns", _CURVES * _BAKED, lambda: sample_curves(table, inside),
        lambda: [spline(inside) for spline in splines], "SciPy CubicHermiteSpline per channel",
    )  # fmt: skip
    _lines(suite, rng)
    _other_modes(suite, rng, keys, inside)


def _lines(suite: Suite, rng: np.random.Generator) -> None:
    """Linear keys on frames, as captures have them, read once and sampled once each, a third of a frame later.

    Counted are all bytes that must come from memory or go to it, against reading alone.
    """
    from keypose.bench.limits import _read

    keys = [start + np.arange(_LINE_KEYS) / 60 for start in rng.uniform(-0.01, 0, _LINE_CURVES)]
    lines = prepare_curves(
        [Curve(k, rng.normal(size=(_LINE_KEYS, 3)).astype(np.float32), Interpolation.LINEAR) for k in keys]
    )
    times = (np.arange(_LINE_KEYS - 1) + 1 / 3) / 60
    times = times[times <= min(k[-1] for k in keys)]
    moved = lines.byte_count + _LINE_CURVES * 3 * len(times) * 4
    size = 256 << 20
    results = np.empty((lines.component_count, len(times)), np.float32)
    memory, out = aligned(size // 4), aligned(WIDTH)
    memory[:] = 1
    suite.case(
        f"{_LINE_CURVES:,} linear curves of {_LINE_KEYS:,} keys, as many times", "GB/s", moved,
        lambda: sample_curves(lines, times, results), lambda: _read(memory, out), "reading memory", size,
        note="bytes of keys read and of results written",
    )  # fmt: skip


def _other_modes(suite: Suite, rng: np.random.Generator, keys: list[np.ndarray], inside: np.ndarray) -> None:
    handles = np.stack([np.full((_KEYS, 1), 0.1), rng.normal(size=(_KEYS, 1))], axis=-1).astype(np.float32)
    weighted = prepare_curves(
        [
            Curve(k, rng.normal(size=(_KEYS, 1)).astype(np.float32), Interpolation.BEZIER, kind=CurveKind.SCALAR,
                  in_handles=-handles, out_handles=handles)
            for k in keys
        ]
    )  # fmt: skip
    moment = iter(np.tile(inside, 100_000))
    suite.case(
        f"{_CURVES:,} Bezier curves with handles in time, one time",
        "ns",
        _CURVES,
        lambda: sample_curves(weighted, next(moment)),
    )
    turns = rng.normal(size=(_CURVES, _KEYS, 4))
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    rotations = prepare_curves(
        [Curve(k, q.astype(np.float32), kind=CurveKind.ROTATION) for k, q in zip(keys, turns, strict=True)]
    )
    suite.case(
        f"{_CURVES:,} rotation curves (slerp), one time", "ns", _CURVES, lambda: sample_curves(rotations, next(moment))
    )
