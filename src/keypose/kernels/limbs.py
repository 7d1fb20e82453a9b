# pyright: basic
"""Two-bone limbs of crowds: one limb per lane, no angles, no branch that depends on a lane.

    `turn_lanes`  limbs [block][16][W]: start xyz, middle xyz, end xyz, target xyz, pole xyz, weight
                  turns [block][10][W]: start joint's wxyz, middle joint's wxyz, stretch, distance left
    `turns`       the same from and to arrays of points and quaternions, for `keypose.ik.solve_limbs`

Sines and cosines come from dot products, cross products and half-angle formulas. What is singular (a straight or folded
limb, a target on the start joint, a pole along the limb) is looked for in all lanes at once and mended where it is.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types

from keypose.errors import ShapeError
from keypose.kernels.rotations import load3, store4
from keypose.kernels.runtime import WIDTH, aligned, inlined, intrinsic, kernel, readable
from keypose.kernels.vectors import (
    absolute,
    fill,
    flip_sign,
    lanes,
    load,
    load_triples,
    maximum,
    pointer,
    rsqrt,
    store,
    store_quads,
)  # fmt: skip

IN_ROWS, OUT_ROWS = 16, 10
_FLOAT32 = np.dtype(np.float32)


def turn_lanes(
    limbs: np.ndarray, softness: float = 0.0, max_stretch: float = 1.0, out: np.ndarray | None = None
) -> np.ndarray:
    """Turns of limbs that lie in lanes.

    Shapes and units: limbs (blocks, 16, W) float32, metres; softness and max_stretch as of `keypose.ik.solve_limbs`. Returns
    (blocks, 10, W), in ``out`` if given.
    """
    shape = (len(limbs) if limbs.ndim else 0, OUT_ROWS, WIDTH)
    if limbs.shape[1:] != (IN_ROWS, WIDTH) or limbs.dtype != _FLOAT32 or not limbs.flags.carray:
        raise ShapeError(f"limbs: expected (blocks, {IN_ROWS}, {WIDTH}) of float32, got {limbs.shape} of {limbs.dtype}")
    if out is None:
        out = aligned(int(np.prod(shape))).reshape(shape)
    elif out.shape != shape or out.dtype != _FLOAT32 or not out.flags.carray:
        raise ShapeError(f"out: expected {shape} of float32, got {out.shape} of {out.dtype}")
    _turn_lanes(limbs, float(softness), float(max_stretch), out)
    return out


def turns(
    batch: tuple[int, ...], points: tuple[np.ndarray, ...], weight: Any, softness: float, max_stretch: float
) -> tuple[np.ndarray, ...]:
    """The parts of `keypose.ik.LimbTurns` from start, middle, end, target, pole and perhaps hinge, each (*batch, 3) or less."""
    count, dtype = math.prod(batch), points[0].dtype
    step = WIDTH if dtype == _FLOAT32 else WIDTH // 2
    room = -(-count // step) * step
    rows = [_whole(p, (*batch, 3), 3 * room) for p in points]
    share = _whole(np.asarray(weight, dtype), batch, room)
    first, second, rest = aligned(4 * room, dtype), aligned(4 * room, dtype), aligned(2 * room, dtype)
    options = len(rows) == 6, float(softness), float(max_stretch), float(np.finfo(dtype).eps)
    _turn_rows(*rows[:5], rows[-1], share, *options, first, second, rest)
    return (
        first[: 4 * count].reshape(*batch, 4), second[: 4 * count].reshape(*batch, 4),
        rest[:count].reshape(batch), rest[room : room + count].reshape(batch),
    )  # fmt: skip


def _whole(values: np.ndarray, shape: tuple[int, ...], size: int) -> np.ndarray:
    """The values as a flat array of whole vectors; what fills the last one are limbs of no size."""
    wanted = values if values.shape == shape else np.broadcast_to(values, shape)
    if wanted.size == size:
        return readable(wanted, values.dtype)
    out = aligned(size, values.dtype)
    out[: wanted.size] = wanted.ravel()
    return readable(out, values.dtype)


# --- what lanes differ in ---------------------------------------------------------------------------------------------------


@intrinsic
def select_less(typing, a, b, yes, no):
    """``yes`` in the lanes where a < b, ``no`` elsewhere."""

    def generate(context, builder, sig, args):
        a, b, yes, no = args
        return builder.select(builder.fcmp_ordered("<", a, b), yes, no)

    return a(a, a, a, a), generate


@intrinsic
def any_less(typing, a, b):
    """Whether a < b in any lane."""

    def generate(context, builder, sig, args):
        found = builder.bitcast(builder.fcmp_ordered("<", *args), ir.IntType(a.lanes))
        return builder.icmp_unsigned("!=", found, ir.Constant(found.type, 0))

    return types.boolean(a, a), generate


# --- on vectors -------------------------------------------------------------------------------------------------------------


@inlined
def _dot(ax, ay, az, bx, by, bz):
    return ax * bx + ay * by + az * bz


@inlined
def _cross(ax, ay, az, bx, by, bz):
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@inlined
def _root(x, tiny):
    """The square root of a number that is not negative; of one below ``tiny`` something less than its root."""
    return x * rsqrt(maximum(x, tiny))


@inlined
def _least_axis(x, y, z, zero, one):
    """The unit axis along which a vector is smallest, the first of equals."""
    x, y, z = absolute(x), absolute(y), absolute(z)
    ex, ey, ez = one, zero, zero
    ex, ey, x = select_less(y, x, zero, ex), select_less(y, x, one, ey), select_less(y, x, y, x)
    return select_less(z, x, zero, ex), select_less(z, x, zero, ey), select_less(z, x, one, ez)


@inlined
def _across(vx, vy, vz, ux, uy, uz, lost, tiny, zero, one):
    """The part of v across the unit vector u and its squared length; of the axis least along u where v has (almost) none."""
    along = _dot(vx, vy, vz, ux, uy, uz)
    x, y, z = vx - along * ux, vy - along * uy, vz - along * uz
    size, least = _dot(x, y, z, x, y, z), lost * _dot(vx, vy, vz, vx, vy, vz) + tiny
    if any_less(size, least):
        ex, ey, ez = _least_axis(ux, uy, uz, zero, one)
        along = _dot(ex, ey, ez, ux, uy, uz)
        ex, ey, ez = ex - along * ux, ey - along * uy, ez - along * uz
        x, y, z = select_less(size, least, ex, x), select_less(size, least, ey, y), select_less(size, least, ez, z)
        size = _dot(x, y, z, x, y, z)
    return x, y, z, size


@inlined
def _fading(x, limit, zero):
    """exp(-x) of x >= 0: the series of a 64th of it, squared six times."""
    x = 0.015625 * (zero - select_less(x, limit, x, limit))
    y = 1.0 + x * (1.0 / 12.0)
    for n in range(11, 0, -1):
        y = 1.0 + x * y * (1.0 / n)
    for _ in range(6):
        y = y * y
    return y


@inlined
def _softened(value, limit, softness, tiny, most, zero):
    """The value, bent from ``limit - softness`` on so that it nears the limit without end."""
    hard = limit - softness
    safe = maximum(softness, tiny)
    over = maximum(value - hard, zero)
    return select_less(zero, over, hard + softness * (1.0 - _fading(over / safe, most, zero)), value)


@inlined
def _from_entries(a, b, c, d, e, f, g, h, i, zero):
    """A quaternion (of some length) of a rotation matrix: a row of 4 q q^T that is not small.

    Source: Shepperd, Quaternion from Rotation Matrix (1978).
    """
    opposite = zero - e
    wx, wy, wz = h - f, c - g, d - b
    xy, xz, yz = b + d, c + g, f + h
    low, high, plus, minus = 1.0 - i, 1.0 + i, a + e, a - e
    return (
        select_less(i, zero, select_less(e, a, wx, wy), select_less(a, opposite, wz, high + plus)),
        select_less(i, zero, select_less(e, a, low + minus, xy), select_less(a, opposite, xz, wx)),
        select_less(i, zero, select_less(e, a, xy, low - minus), select_less(a, opposite, yz, wy)),
        select_less(i, zero, select_less(e, a, xz, yz), select_less(a, opposite, high - plus, wz)),
    )


@inlined
def _shared(w, x, y, z, weight):
    """So much of a quaternion of any length as the weight says."""
    r = rsqrt(w * w + x * x + y * y + z * z)
    t = flip_sign(weight * r, w)
    w, x, y, z = 1.0 + weight * (absolute(w * r) - 1.0), x * t, y * t, z * t
    r = rsqrt(w * w + x * x + y * y + z * z)
    return w * r, x * r, y * r, z * r


@inlined
def _limb(
    sx, sy, sz, mx, my, mz, ex, ey, ez, tx, ty, tz, px, py, pz, hx, hy, hz,
    weight, hinged, softness, max_stretch, noise, lost, zero, one, tiny, most,
):  # fmt: skip
    """Turn one limb per lane; the steps and names of `keypose.ik.limb`."""
    ax, ay, az, bx, by, bz = mx - sx, my - sy, mz - sz, ex - mx, ey - my, ez - mz
    dx, dy, dz = tx - sx, ty - sy, tz - sz
    aa, bb, ab = _dot(ax, ay, az, ax, ay, az), _dot(bx, by, bz, bx, by, bz), _dot(ax, ay, az, bx, by, bz)
    vx, vy, vz = _cross(ax, ay, az, bx, by, bz)

    # The axis of the bend.
    if hinged:
        nx, ny, nz = hx, hy, hz
        size = _dot(nx, ny, nz, nx, ny, nz)
        if any_less(size, tiny):
            lx, ly, lz = _least_axis(nx, ny, nz, zero, one)
            nx, ny, nz = (
                select_less(size, tiny, lx, nx),
                select_less(size, tiny, ly, ny),
                select_less(size, tiny, lz, nz),
            )
            size = select_less(size, tiny, one, size)
    else:
        nx, ny, nz = vx, vy, vz
        size = _dot(nx, ny, nz, nx, ny, nz)
        limit = aa * bb
        if any_less(size, 1e-4 * limit + tiny):
            # Nearly straight or folded: rounding has tilted the product, and may be all there is of it.
            r = rsqrt(maximum(aa, tiny))
            ux, uy, uz = ax * r, ay * r, az * r
            limit = noise * noise * limit + tiny
            fx, fy, fz = _cross(px, py, pz, ax, ay, az)
            fx, fy, fz, _ = _across(fx, fy, fz, ux, uy, uz, lost, tiny, zero, one)
            nx, ny, nz = (
                select_less(size, limit, fx, nx),
                select_less(size, limit, fy, ny),
                select_less(size, limit, fz, nz),
            )
            r = _dot(nx, ny, nz, ux, uy, uz)
            nx, ny, nz = nx - r * ux, ny - r * uy, nz - r * uz
            size = _dot(nx, ny, nz, nx, ny, nz)
    r = rsqrt(size)
    nx, ny, nz = nx * r, ny * r, nz * r
    cx, cy, cz = _cross(nx, ny, nz, bx, by, bz)

    # Lengths across it, and how far the limb reaches.
    along, aside2 = zero, zero
    if hinged:
        along, r = _dot(bx, by, bz, nx, ny, nz), _dot(ax, ay, az, nx, ny, nz)
        ab = ab - r * along
        wx, wy, wz = ax - r * nx, ay - r * ny, az - r * nz
        limit = noise * noise * aa
        aa = _dot(wx, wy, wz, wx, wy, wz)
        aa = select_less(limit, aa, aa, zero)
        limit = noise * noise * bb
        bb = _dot(cx, cy, cz, cx, cy, cz)
        bb = select_less(limit, bb, bb, zero)
        aside2 = (r + along) * (r + along)
    upper, lower, product = _root(aa, tiny), _root(bb, tiny), aa * bb
    weight = select_less(tiny, product, weight, zero)
    r = rsqrt(select_less(tiny, product, product, one))
    reach, shortest = upper + lower, absolute(upper - lower)
    if hinged:
        reach, shortest = _root(reach * reach + aside2, tiny), _root(shortest * shortest + aside2, tiny)
    dd = _dot(dx, dy, dz, dx, dy, dz)
    distance = _root(dd, tiny)
    used, stretch = distance, one
    if softness > 0.0:
        used = _softened(distance, reach, softness * reach, tiny, most, zero)
    used = maximum(used, shortest)
    used = select_less(used, reach, used, reach)
    if max_stretch > 1.0:
        stretch = select_less(used, distance, distance / maximum(used, tiny), one)
        slow = min(softness, max_stretch - 1.0)
        limit = max_stretch * one
        if softness > 0.0:
            stretch = _softened(stretch, limit, slow * one, tiny, most, zero)
        stretch = select_less(stretch, limit, stretch, limit)

    # From the bend that is to the one that shall be, by the law of cosines.
    half = 0.5 * r
    less, more = (reach - used) * (reach + used) * half, (used - shortest) * (used + shortest) * half
    cos_want, sin_want = 0.5 * (more - less), _root(maximum(less * more, zero), tiny)
    cos_now, sin_now = ab * r, _dot(nx, ny, nz, vx, vy, vz) * r
    cosine, sine = cos_want * cos_now + sin_want * sin_now, sin_want * cos_now - cos_want * sin_now
    larger = 1.0 + absolute(cosine)
    jw = select_less(cosine, zero, absolute(sine), larger)
    half = select_less(cosine, zero, flip_sign(larger, sine), sine)
    jw, jx, jy, jz = _shared(jw, half * nx, half * ny, half * nz, weight)

    # From the end as the bend has it to the target.
    fx, fy, fz = ax + cosine * bx + sine * cx, ay + cosine * by + sine * cy, az + cosine * bz + sine * cz
    if hinged:
        r = along - cosine * along
        fx, fy, fz = fx + r * nx, fy + r * ny, fz + r * nz
    if any_less(dd, tiny):
        lx, ly, lz = _least_axis(px, py, pz, zero, one)
        dx, dy, dz = select_less(dd, tiny, lx, dx), select_less(dd, tiny, ly, dy), select_less(dd, tiny, lz, dz)
        dd = select_less(dd, tiny, one, dd)
    r = rsqrt(dd)
    dx, dy, dz = dx * r, dy * r, dz * r
    size, limit = _dot(fx, fy, fz, fx, fy, fz), noise * noise * (reach * reach) + tiny
    if any_less(size, limit):
        lx, ly, lz = _cross(nx, ny, nz, ax, ay, az)
        fx, fy, fz = (
            select_less(size, limit, lx, fx),
            select_less(size, limit, ly, fy),
            select_less(size, limit, lz, fz),
        )
        size = _dot(fx, fy, fz, fx, fy, fz)
        fx, fy, fz = select_less(size, tiny, dx, fx), select_less(size, tiny, dy, fy), select_less(size, tiny, dz, fz)
        size = select_less(size, tiny, one, size)
    r = rsqrt(size)
    fx, fy, fz = fx * r, fy * r, fz * r
    ux, uy, uz, size = _across(px, py, pz, dx, dy, dz, lost, tiny, zero, one)
    r = rsqrt(size)
    ux, uy, uz = ux * r, uy * r, uz * r
    kx, ky, kz = _cross(ux, uy, uz, dx, dy, dz)
    if hinged:
        nx, ny, nz, size = _across(nx, ny, nz, fx, fy, fz, lost, tiny, zero, one)
        r = rsqrt(size)
        nx, ny, nz = nx * r, ny * r, nz * r
    gx, gy, gz = _cross(fx, fy, fz, nx, ny, nz)
    qw, qx, qy, qz = _from_entries(
        dx * fx + kx * nx + ux * gx, dx * fy + kx * ny + ux * gy, dx * fz + kx * nz + ux * gz,
        dy * fx + ky * nx + uy * gx, dy * fy + ky * ny + uy * gy, dy * fz + ky * nz + uy * gz,
        dz * fx + kz * nx + uz * gx, dz * fy + kz * ny + uz * gy, dz * fz + kz * nz + uz * gz, zero,
    )  # fmt: skip
    qw, qx, qy, qz = _shared(qw, qx, qy, qz, weight)
    return (qw, qx, qy, qz), (jw, jx, jy, jz), 1.0 + weight * (stretch - 1.0), absolute(distance - stretch * used)


# --- kernels ----------------------------------------------------------------------------------------------------------------


@kernel
def _turn_lanes(limbs, softness, max_stretch, out):
    zero, one, tiny, most = fill(limbs, 0.0), fill(limbs, 1.0), fill(limbs, 1e-36), fill(limbs, 40.0)
    blocks, limbs, out = limbs.shape[0], pointer(limbs), pointer(out)
    for block in range(blocks):
        i, o = block * IN_ROWS * WIDTH, block * OUT_ROWS * WIDTH
        sx, sy, sz = load3(limbs, i, WIDTH)
        mx, my, mz = load3(limbs, i + 3 * WIDTH, WIDTH)
        ex, ey, ez = load3(limbs, i + 6 * WIDTH, WIDTH)
        tx, ty, tz = load3(limbs, i + 9 * WIDTH, WIDTH)
        px, py, pz = load3(limbs, i + 12 * WIDTH, WIDTH)
        q, j, stretch, error = _limb(
            sx, sy, sz, mx, my, mz, ex, ey, ez, tx, ty, tz, px, py, pz, px, py, pz,
            load(limbs, i + 15 * WIDTH), False, softness, max_stretch, 7.6e-6, 2.3e-13, zero, one, tiny, most,
        )  # fmt: skip
        store4(out, o, WIDTH, q[0], q[1], q[2], q[3])
        store4(out, o + 4 * WIDTH, WIDTH, j[0], j[1], j[2], j[3])
        store(out, o + 8 * WIDTH, stretch)
        store(out, o + 9 * WIDTH, error)


@kernel
def _turn_rows(
    start, middle, end, target, pole, hinge, weight, hinged, softness, max_stretch, eps, first, second, rest
):
    zero, one, tiny, most = fill(start, 0.0), fill(start, 1.0), fill(start, 1e-36), fill(start, 40.0)
    count, step = weight.shape[0], lanes(weight)
    start, middle, end, target, pole = pointer(start), pointer(middle), pointer(end), pointer(target), pointer(pole)
    hinge, weight, first, second, rest = pointer(hinge), pointer(weight), pointer(first), pointer(second), pointer(rest)
    for n in range(0, count, step):
        i = 3 * n
        sx, sy, sz = load_triples(start, i)
        mx, my, mz = load_triples(middle, i)
        ex, ey, ez = load_triples(end, i)
        tx, ty, tz = load_triples(target, i)
        px, py, pz = load_triples(pole, i)
        hx, hy, hz = load_triples(hinge, i)
        q, j, stretch, error = _limb(
            sx, sy, sz, mx, my, mz, ex, ey, ez, tx, ty, tz, px, py, pz, hx, hy, hz,
            load(weight, n), hinged, softness, max_stretch, 64.0 * eps, 16.0 * eps * eps, zero, one, tiny, most,
        )  # fmt: skip
        store_quads(first, 4 * n, q[0], q[1], q[2], q[3])
        store_quads(second, 4 * n, j[0], j[1], j[2], j[3])
        store(rest, n, stretch)
        store(rest, count + n, error)
