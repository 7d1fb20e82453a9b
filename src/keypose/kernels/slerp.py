# pyright: basic
"""Spherical interpolation of many quaternions at once, without trigonometry.

sin(t a) / sin(a) is a polynomial in t and in (cos a - 1). Eight terms, the last one adjusted, are good to 3e-5, which
is a hundredth of a degree; `keypose.math.quat.slerp` is exact.

Source: D. Eberly, "A Fast and Accurate Algorithm for Computing SLERP", Journal of Graphics, GPU, and Game Tools, 2011.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from keypose.errors import ShapeError
from keypose.kernels.rotations import load4, store4
from keypose.kernels.runtime import WIDTH, inlined, kernel, readable
from keypose.kernels.vectors import absolute, flip_sign, load, load_quads, pointer, store_quads

_LAST = 1.85298109240830  # Eberly, table 1: takes the place of the terms left out
_U = [np.float32((_LAST if k == 8 else 1.0) / (k * (2 * k + 1))) for k in range(1, 9)]
_V = [np.float32((_LAST if k == 8 else 1.0) * k / (2 * k + 1)) for k in range(1, 9)]
_U1, _U2, _U3, _U4, _U5, _U6, _U7, _U8 = _U
_V1, _V2, _V3, _V4, _V5, _V6, _V7, _V8 = _V


def slerp(a: Any, b: Any, t: Any) -> np.ndarray:
    """The short way from ``a`` to ``b``, to within 3e-5.

    Shapes: unit quaternions a and b (N, 4) and t (N,) from 0 to 1, taken as float32. Returns (N, 4) float32.
    """
    a, b, t = np.asarray(a, np.float32), np.asarray(b, np.float32), np.asarray(t, np.float32)
    count = len(t)
    if t.ndim != 1 or a.shape != (count, 4) or b.shape != (count, 4):
        raise ShapeError(f"slerp: expected (N, 4), (N, 4) and (N,), got {a.shape}, {b.shape} and {t.shape}")
    missing = max(WIDTH - count, 0) if count else 0
    if missing:
        a, b, t = np.pad(a, [(0, missing), (0, 0)]), np.pad(b, [(0, missing), (0, 0)]), np.pad(t, (0, missing))
    out = np.empty((count + missing, 4), np.float32)
    _slerp_quads(readable(a, np.float32), readable(b, np.float32), readable(t, np.float32), out.reshape(-1))
    return out[:count]


def slerp_lanes(a: np.ndarray, b: np.ndarray, t: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """As `slerp` for components in rows.

    Shapes: a and b (4, N) and t (N,) float32, N a multiple of the vector width. Returns (4, N), in ``out`` if given.
    """
    count = len(t)
    out = np.empty((4, count), np.float32) if out is None else out
    for name, array, shape in (
        ("a", a, (4, count)),
        ("b", b, (4, count)),
        ("t", t, (count,)),
        ("out", out, (4, count)),
    ):
        if array.shape != shape or array.dtype != np.float32 or not array.flags.c_contiguous or count % WIDTH:
            raise ShapeError(f"{name}: expected {shape} of float32, a multiple of {WIDTH}, got {array.shape}")
    _slerp_rows(a, b, t, out)
    return out


@inlined
def _share(t, x):
    """sin(t a) / sin(a) with x = cos(a) - 1, for angles a up to a quarter turn."""
    s = t * t
    r = 1.0 + (s * _U8 - _V8) * x
    r = 1.0 + (s * _U7 - _V7) * x * r
    r = 1.0 + (s * _U6 - _V6) * x * r
    r = 1.0 + (s * _U5 - _V5) * x * r
    r = 1.0 + (s * _U4 - _V4) * x * r
    r = 1.0 + (s * _U3 - _V3) * x * r
    r = 1.0 + (s * _U2 - _V2) * x * r
    r = 1.0 + (s * _U1 - _V1) * x * r
    return t * r


@inlined
def _slerp(aw, ax, ay, az, bw, bx, by, bz, t):
    cosine = aw * bw + ax * bx + ay * by + az * bz
    x = absolute(cosine) - 1.0
    of_a, of_b = _share(1.0 - t, x), flip_sign(_share(t, x), cosine)  # q and -q are one rotation: the short side
    return of_a * aw + of_b * bw, of_a * ax + of_b * bx, of_a * ay + of_b * by, of_a * az + of_b * bz


@kernel
def _slerp_quads(a, b, t, out):
    count = t.shape[0]
    for at in range(0, count, WIDTH):
        at = min(at, count - WIDTH)  # the last block overlaps the one before it
        aw, ax, ay, az = load_quads(a, 4 * at)
        bw, bx, by, bz = load_quads(b, 4 * at)
        w, x, y, z = _slerp(aw, ax, ay, az, bw, bx, by, bz, load(t, at))
        store_quads(out, 4 * at, w, x, y, z)


@kernel
def _slerp_rows(a, b, t, out):
    count = t.shape[0]
    a, b, t, out = pointer(a), pointer(b), pointer(t), pointer(out)
    for at in range(0, count, WIDTH):
        aw, ax, ay, az = load4(a, at, count)
        bw, bx, by, bz = load4(b, at, count)
        w, x, y, z = _slerp(aw, ax, ay, az, bw, bx, by, bz, load(t, at))
        store4(out, at, count, w, x, y, z)
