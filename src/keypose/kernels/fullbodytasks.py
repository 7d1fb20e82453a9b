# pyright: basic
"""Tasks of the full-body solver as inertias and forces on the joints' bodies, with cost and miss."""

from __future__ import annotations

import numpy as np

from keypose.kernels.fullbodytables import (
    C_BODY_COUNT,
    C_COUNT,
    C_FIRST,
    C_TERM,
    C_TERMS,
    CENTER,
    CONTACT,
    COUPLING_COLUMNS,
    EXTRA,
    FORCE,
    INERTIA,
    J_PARENT,
    J_PRIOR,
    JOINT_COLUMNS,
    LOOK_AT,
    MASS,
    MIXED,
    MOMENT,
    ORIENTATION,
    PLACE,
    POSITION,
    PRIOR,
    PRIOR_INERTIA,
    PRIOR_PULL,
    PULL,
    RELATIVE_PLACE,
    RELATIVE_TURN,
    ROOT_PRIOR,
    SLOTS,
    T_AT,
    T_JOINT,
    T_KIND,
    T_OPTION,
    TERM_COLUMNS,
    TORQUE,
    TURN,
    VIRIAL,
    WRENCHES,
)
from keypose.kernels.rotations import load3, load4, quat_multiply, quat_rotate, store3, store4
from keypose.kernels.runtime import inlined, kernel
from keypose.kernels.vectors import absolute, fill, flip_sign, load, maximum, sqrt, store


@inlined
def cross(ax, ay, az, bx, by, bz):
    """a x b."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@inlined
def add(m, at, value):
    """Add to what is there."""
    store(m, at, load(m, at) + value)


@inlined
def add3(m, at, n, x, y, z):
    """Add to three slots."""
    add(m, at, x)
    add(m, at + n, y)
    add(m, at + 2 * n, z)


@kernel
def forward(joints, count, mover, row, q, off, shift, work, n):
    """Model rotations and places."""
    for j in range(count):
        w, p = work + j * SLOTS * n, joints[j * JOINT_COLUMNS + J_PARENT]
        a, b, c, d = load4(row, q + 4 * j * n, n)
        x, y, z = load3(row, off + 3 * j * n, n)
        if p >= 0:
            up = work + p * SLOTS * n
            e, f, g, h = load4(row, up + TURN * n, n)
            a, b, c, d = quat_multiply(e, f, g, h, a, b, c, d)
            x, y, z = quat_rotate(e, f, g, h, x, y, z)
            px, py, pz = load3(row, up + PLACE * n, n)
            x, y, z = x + px, y + py, z + pz
        if j == mover:
            sx, sy, sz = load3(row, shift, n)
            x, y, z = x + sx, y + sy, z + sz
        store4(row, w + TURN * n, n, a, b, c, d)
        store3(row, w + PLACE * n, n, x, y, z)


@inlined
def _counted(row, weight):
    """0 where a weight takes its task out, 1 elsewhere."""
    return weight / maximum(weight, fill(row, 1e-300))


@inlined
def _push(row, w, n, px, py, pz, fx, fy, fz):
    """A force at a place, in the plain sums."""
    add3(row, w + PULL * n, n, fx, fy, fz)
    mx, my, mz = cross(px, py, pz, fx, fy, fz)
    add3(row, w + MOMENT * n, n, mx, my, mz)
    add3(row, w + VIRIAL * n, n, px * fx, px * fy, px * fz)
    add3(row, w + (VIRIAL + 3) * n, n, py * fx, py * fy, py * fz)
    add3(row, w + (VIRIAL + 6) * n, n, pz * fx, pz * fy, pz * fz)


@kernel
def _position(row, w, at, left, n, pointed, plain, cost, miss, per_m):
    tx, ty, tz, weight = load4(row, at, n)
    px, py, pz = load3(row, w + PLACE * n, n)
    ww = weight * weight
    add(row, w + MASS * n, ww)
    add(row, w + (MASS + 3) * n, ww)
    add(row, w + (MASS + 5) * n, ww)
    if pointed:
        a, b, c, d = load4(row, w + TURN * n, n)
        bx, by, bz = load3(row, at + 4 * n, n)
        bx, by, bz = quat_rotate(a, b, c, d, bx, by, bz)
        px, py, pz = px + bx, py + by, pz + bz
        xx, yy, zz = bx * bx, by * by, bz * bz
        add3(row, w + INERTIA * n, n, ww * (yy + zz), 0.0 - ww * bx * by, 0.0 - ww * bx * bz)
        add3(row, w + (INERTIA + 3) * n, n, ww * (xx + zz), 0.0 - ww * by * bz, ww * (xx + yy))
        sx, sy, sz = ww * bx, ww * by, ww * bz
        add(row, w + (MIXED + 1) * n, 0.0 - sz)
        add(row, w + (MIXED + 2) * n, sy)
        add(row, w + (MIXED + 3) * n, sz)
        add(row, w + (MIXED + 5) * n, 0.0 - sx)
        add(row, w + (MIXED + 6) * n, 0.0 - sy)
        add(row, w + (MIXED + 7) * n, sx)
        gx, gy, gz = cross(sx, sy, sz, px - tx, py - ty, pz - tz)
        add3(row, w + TORQUE * n, n, gx, gy, gz)
    rx, ry, rz = px - tx, py - ty, pz - tz
    fx, fy, fz = ww * rx, ww * ry, ww * rz
    add3(row, w + FORCE * n, n, fx, fy, fz)
    if plain:
        _push(row, w, n, px, py, pz, fx, fy, fz)
    squared = rx * rx + ry * ry + rz * rz
    distance = sqrt(squared)
    store(row, left, distance)
    add(row, cost, 0.5 * (ww * squared))
    store(row, miss, maximum(load(row, miss), _counted(row, weight) * per_m * distance))


@kernel
def _logarithm(row, q, out, n):
    """The rotation vectors of unit quaternions, their angles, and (half angle / its sine) squared: five slots at ``out``."""
    for k in range(n):
        w, x, y, z = row[q + k], row[q + n + k], row[q + 2 * n + k], row[q + 3 * n + k]
        sign = -1.0 if w < 0.0 else 1.0
        sine = np.sqrt(x * x + y * y + z * z)
        half = np.arctan2(sine, sign * w)
        scale = 2.0 / (sign * w) if sine < 1e-12 else 2.0 * half / sine
        row[out + k], row[out + n + k], row[out + 2 * n + k] = sign * scale * x, sign * scale * y, sign * scale * z
        row[out + 3 * n + k] = 2.0 * half
        row[out + 4 * n + k] = 1.0 if half < 1e-8 else half * half / max(sine * sine, 1e-300)


@inlined
def _turn_inertia(row, vector, n, ww):
    """The six entries of ww (s I + (1 - s) axis axis^T), and the gradient, from what `_logarithm` wrote."""
    x, y, z, angle = load4(row, vector, n)
    s = load(row, vector + 4 * n)
    rest = ww * (1.0 - s) / maximum(angle * angle, fill(row, 1e-30))
    own = ww * s
    xx, xy, xz = own + rest * x * x, rest * x * y, rest * x * z
    yy, yz, zz = own + rest * y * y, rest * y * z, own + rest * z * z
    return xx, xy, xz, yy, yz, zz, ww * x, ww * y, ww * z


@kernel
def _orientation(row, w, at, left, n, near, plain, cost, miss, per_rad):
    a, b, c, d = load4(row, w + TURN * n, n)
    e, f, g, h = load4(row, at, n)
    weight = load(row, at + 4 * n)
    ww = weight * weight
    a, b, c, d = quat_multiply(a, b, c, d, e, 0.0 - f, 0.0 - g, 0.0 - h)
    store4(row, near, n, a, b, c, d)
    _logarithm(row, near, near + 4 * n, n)
    xx, xy, xz, yy, yz, zz, gx, gy, gz = _turn_inertia(row, near + 4 * n, n, ww)
    add3(row, w + INERTIA * n, n, xx, xy, xz)
    add3(row, w + (INERTIA + 3) * n, n, yy, yz, zz)
    add3(row, w + TORQUE * n, n, gx, gy, gz)
    if plain:
        add3(row, w + MOMENT * n, n, gx, gy, gz)
    angle = load(row, near + 7 * n)
    store(row, left, angle)
    add(row, cost, 0.5 * (ww * (angle * angle)))
    store(row, miss, maximum(load(row, miss), _counted(row, weight) * per_rad * angle))


@kernel
def _row_of_body(row, w, n, ww, ax, ay, az, vx, vy, vz, r, qx, qy, qz, plain):
    """One residual r that follows a body's turn by a and its motion by v; for the curvature its force pulls at q."""
    x, y, z = ww * ax, ww * ay, ww * az
    add3(row, w + INERTIA * n, n, x * ax, x * ay, x * az)
    add3(row, w + (INERTIA + 3) * n, n, y * ay, y * az, z * az)
    add3(row, w + MIXED * n, n, x * vx, x * vy, x * vz)
    add3(row, w + (MIXED + 3) * n, n, y * vx, y * vy, y * vz)
    add3(row, w + (MIXED + 6) * n, n, z * vx, z * vy, z * vz)
    add3(row, w + TORQUE * n, n, x * r, y * r, z * r)
    fx, fy, fz = ww * vx * r, ww * vy * r, ww * vz * r
    add3(row, w + FORCE * n, n, fx, fy, fz)
    if plain:
        px, py, pz = load3(row, w + PLACE * n, n)
        mx, my, mz = cross(px, py, pz, fx, fy, fz)
        add3(row, w + MOMENT * n, n, mx + x * r, my + y * r, mz + z * r)
        add3(row, w + PULL * n, n, fx, fy, fz)
        add3(row, w + VIRIAL * n, n, qx * fx, qx * fy, qx * fz)
        add3(row, w + (VIRIAL + 3) * n, n, qy * fx, qy * fy, qy * fz)
        add3(row, w + (VIRIAL + 6) * n, n, qz * fx, qz * fy, qz * fz)
    x, y, z = ww * vx, ww * vy, ww * vz
    add3(row, w + MASS * n, n, x * vx, x * vy, x * vz)
    add3(row, w + (MASS + 3) * n, n, y * vy, y * vz, z * vz)


@kernel
def _look_at(row, w, at, left, n, plain, cost, miss, per_rad):
    a, b, c, d = load4(row, w + TURN * n, n)
    tx, ty, tz, weight = load4(row, at, n)
    bx, by, bz = load3(row, at + 4 * n, n)
    ux, uy, uz = load3(row, at + 7 * n, n)
    bx, by, bz = quat_rotate(a, b, c, d, bx, by, bz)
    ux, uy, uz = quat_rotate(a, b, c, d, ux, uy, uz)
    px, py, pz = load3(row, w + PLACE * n, n)
    x, y, z = tx - px - bx, ty - py - by, tz - pz - bz
    far = maximum(sqrt(x * x + y * y + z * z), fill(row, 1e-9))
    x, y, z = x / far, y / far, z / far
    ww, one = weight * weight, 1.0 / far
    rx, ry, rz = ux - x, uy - y, uz - z
    # By moving: (I - d d^T) / far. By turning by t: the axis changes by t x u, the foot by t x b.
    sxx, sxy, sxz = one * (1.0 - x * x), 0.0 - one * x * y, 0.0 - one * x * z
    syy, syz, szz = one * (1.0 - y * y), 0.0 - one * y * z, one * (1.0 - z * z)
    ax, ay, az = cross(bx, by, bz, sxx, sxy, sxz)
    _row_of_body(row, w, n, ww, ax, ay + uz, az - uy, sxx, sxy, sxz, rx, px, py, pz, plain)
    ax, ay, az = cross(bx, by, bz, sxy, syy, syz)
    _row_of_body(row, w, n, ww, ax - uz, ay, az + ux, sxy, syy, syz, ry, px, py, pz, plain)
    ax, ay, az = cross(bx, by, bz, sxz, syz, szz)
    _row_of_body(row, w, n, ww, ax + uy, ay - ux, az, sxz, syz, szz, rz, px, py, pz, plain)
    squared = rx * rx + ry * ry + rz * rz
    angle = sqrt(squared)
    store(row, left, angle)
    add(row, cost, 0.5 * (ww * squared))
    store(row, miss, maximum(load(row, miss), _counted(row, weight) * per_rad * angle))


@kernel
def _contact(row, w, at, left, n, on, plain, cost, miss, per_m):
    a, b, c, d = load4(row, w + TURN * n, n)
    ox, oy, oz = load3(row, at, n)
    nx, ny, nz = load3(row, at + 3 * n, n)
    weight = load(row, at + 6 * n)
    bx, by, bz = load3(row, at + 7 * n, n)
    bx, by, bz = quat_rotate(a, b, c, d, bx, by, bz)
    px, py, pz = load3(row, w + PLACE * n, n)
    px, py, pz = px + bx, py + by, pz + bz
    height = (px - ox) * nx + (py - oy) * ny + (pz - oz) * nz
    ww = weight * weight
    if not on:
        half = fill(row, 0.5)
        below = half - flip_sign(half, height)
        ww, height = ww * below, height * below
    store(row, left, absolute(height))
    ax, ay, az = cross(bx, by, bz, nx, ny, nz)
    _row_of_body(row, w, n, ww, ax, ay, az, nx, ny, nz, height, px, py, pz, plain)
    add(row, cost, 0.5 * (ww * height * height))
    store(row, miss, maximum(load(row, miss), _counted(row, weight) * per_m * absolute(height)))


@kernel
def _prior(row, w, up, q, at, left, n, near, cost):
    """A joint's own prior: it weighs on the joint's turn alone, not on the body."""
    a, b, c, d = load4(row, q, n)
    e, f, g, h = load4(row, at, n)
    weight = load(row, at + 4 * n)
    ww = weight * weight
    a, b, c, d = quat_multiply(a, b, c, d, e, 0.0 - f, 0.0 - g, 0.0 - h)
    store4(row, near, n, a, b, c, d)
    _logarithm(row, near, near + 4 * n, n)
    if up >= 0:
        a, b, c, d = load4(row, up + TURN * n, n)
        x, y, z = load3(row, near + 4 * n, n)
        x, y, z = quat_rotate(a, b, c, d, x, y, z)
        store3(row, near + 4 * n, n, x, y, z)
    xx, xy, xz, yy, yz, zz, gx, gy, gz = _turn_inertia(row, near + 4 * n, n, ww)
    add3(row, w + PRIOR_INERTIA * n, n, xx, xy, xz)
    add3(row, w + (PRIOR_INERTIA + 3) * n, n, yy, yz, zz)
    add3(row, w + PRIOR_PULL * n, n, gx, gy, gz)
    angle = load(row, near + 7 * n)
    store(row, left, angle)
    add(row, cost, 0.5 * (ww * (angle * angle)))


@kernel
def _root_prior(row, w, shift, at, left, n, plain, cost):
    """A spring at the joint that moves, above which nothing does."""
    tx, ty, tz, weight = load4(row, at, n)
    x, y, z = load3(row, shift, n)
    x, y, z, ww = x - tx, y - ty, z - tz, weight * weight
    squared = x * x + y * y + z * z
    store(row, left, sqrt(squared))
    add(row, cost, 0.5 * ww * squared)
    add(row, w + MASS * n, ww)
    add(row, w + (MASS + 3) * n, ww)
    add(row, w + (MASS + 5) * n, ww)
    x, y, z = ww * x, ww * y, ww * z
    add3(row, w + FORCE * n, n, x, y, z)
    if plain:
        px, py, pz = load3(row, w + PLACE * n, n)
        _push(row, w, n, px, py, pz, x, y, z)


@inlined
def first_body(terms, couples, head):
    """Where the bodies of a term that couples several begin in the table of terms."""
    return couples + C_TERMS + terms[couples + C_COUNT] * COUPLING_COLUMNS + terms[head + C_FIRST]


@inlined
def _wrench(row, at, n, fx, fy, fz, mx, my, mz):
    """How one residual follows a body: by moving and by turning."""
    store3(row, at, n, fx, fy, fz)
    store3(row, at + 3 * n, n, mx, my, mz)


@inlined
def _point_wrenches(row, at, n, bx, by, bz, sx, sy, sz):
    """How the three coordinates of a point at an arm follow its body, times a factor each."""
    zero = fill(row, 0.0)
    _wrench(row, at, n, sx, zero, zero, zero, sx * bz, 0.0 - sx * by)
    _wrench(row, at + 6 * n, n, zero, sy, zero, 0.0 - sy * bz, zero, sy * bx)
    _wrench(row, at + 12 * n, n, zero, zero, sz, sz * by, 0.0 - sz * bx, zero)


@inlined
def _pull_at(row, w, n, bx, by, bz, fx, fy, fz, plain):
    """A force at an arm of a body, which no inertia belongs to."""
    add3(row, w + FORCE * n, n, fx, fy, fz)
    mx, my, mz = cross(bx, by, bz, fx, fy, fz)
    add3(row, w + TORQUE * n, n, mx, my, mz)
    if plain:
        px, py, pz = load3(row, w + PLACE * n, n)
        _push(row, w, n, px + bx, py + by, pz + bz, fx, fy, fz)


@kernel
def _relative_place(row, w, v, at, left, wrenches, n, plain, cost, miss, per_m):
    """A point of one body at a point of another: two points pulled together."""
    a, b, c, d = load4(row, w + TURN * n, n)
    bx, by, bz = load3(row, at + 4 * n, n)
    bx, by, bz = quat_rotate(a, b, c, d, bx, by, bz)
    a, b, c, d = load4(row, v + TURN * n, n)
    tx, ty, tz, weight = load4(row, at, n)
    tx, ty, tz = quat_rotate(a, b, c, d, tx, ty, tz)
    px, py, pz = load3(row, w + PLACE * n, n)
    ux, uy, uz = load3(row, v + PLACE * n, n)
    rx, ry, rz = px + bx - ux - tx, py + by - uy - ty, pz + bz - uz - tz
    _point_wrenches(row, wrenches, n, bx, by, bz, weight, weight, weight)
    back = 0.0 - weight
    _point_wrenches(row, wrenches + WRENCHES * n, n, tx, ty, tz, back, back, back)
    ww = weight * weight
    fx, fy, fz = ww * rx, ww * ry, ww * rz
    _pull_at(row, w, n, bx, by, bz, fx, fy, fz, plain)
    _pull_at(row, v, n, tx, ty, tz, 0.0 - fx, 0.0 - fy, 0.0 - fz, plain)
    squared = rx * rx + ry * ry + rz * rz
    distance = sqrt(squared)
    store(row, left, distance)
    add(row, cost, 0.5 * (ww * squared))
    store(row, miss, maximum(load(row, miss), _counted(row, weight) * per_m * distance))


@kernel
def _relative_turn(row, w, v, at, left, wrenches, n, near, plain, cost, miss, per_rad):
    """One body turned in another: how the rotation vector between them, in the model's axes, follows both."""
    a, b, c, d = load4(row, v + TURN * n, n)
    e, f, g, h = load4(row, at, n)
    weight = load(row, at + 4 * n)
    a, b, c, d = quat_multiply(a, b, c, d, e, f, g, h)  # what the first body is to be turned like
    e, f, g, h = load4(row, w + TURN * n, n)
    a, b, c, d = quat_multiply(e, f, g, h, a, 0.0 - b, 0.0 - c, 0.0 - d)
    store4(row, near, n, a, b, c, d)
    _logarithm(row, near, near + 4 * n, n)
    x, y, z, angle = load4(row, near + 4 * n, n)
    zero, half = fill(row, 0.0), 0.5 * angle
    own = sqrt(maximum(load(row, near + 8 * n) - half * half, zero))  # half angle / its tangent
    rest = (1.0 - own) / maximum(angle * angle, fill(row, 1e-30))
    # Rows of the inverse left Jacobian: own I + rest v v^T - [v] / 2.
    for k in range(2):
        s, out = (weight if k == 0 else 0.0 - weight), wrenches + k * WRENCHES * n
        _wrench(
            row, out, n, zero, zero, zero,
            s * (own + rest * x * x), s * (rest * x * y + 0.5 * z), s * (rest * x * z - 0.5 * y),
        )  # fmt: skip
        _wrench(
            row, out + 6 * n, n, zero, zero, zero,
            s * (rest * x * y - 0.5 * z), s * (own + rest * y * y), s * (rest * y * z + 0.5 * x),
        )  # fmt: skip
        _wrench(
            row, out + 12 * n, n, zero, zero, zero,
            s * (rest * x * z + 0.5 * y), s * (rest * y * z - 0.5 * x), s * (own + rest * z * z),
        )  # fmt: skip
    ww = weight * weight
    gx, gy, gz = ww * x, ww * y, ww * z
    add3(row, w + TORQUE * n, n, gx, gy, gz)
    add3(row, v + TORQUE * n, n, 0.0 - gx, 0.0 - gy, 0.0 - gz)
    if plain:
        add3(row, w + MOMENT * n, n, gx, gy, gz)
        add3(row, v + MOMENT * n, n, 0.0 - gx, 0.0 - gy, 0.0 - gz)
    store(row, left, angle)
    add(row, cost, 0.5 * (ww * (angle * angle)))
    store(row, miss, maximum(load(row, miss), _counted(row, weight) * per_rad * angle))


@kernel
def _center(terms, bodies, body_count, row, work, at, left, wrenches, n, plain, cost, miss, per_m):
    """The centre of mass: every body's point counts by its mass."""
    rx, ry, rz, weight = load4(row, at, n)
    ax, ay, az = load3(row, at + 4 * n, n)
    rx, ry, rz = 0.0 - rx, 0.0 - ry, 0.0 - rz
    sx, sy, sz = weight * ax, weight * ay, weight * az
    for k in range(body_count):
        w, own, out = work + terms[bodies + k] * SLOTS * n, at + (7 + 4 * k) * n, wrenches + WRENCHES * k * n
        bx, by, bz, mass = load4(row, own, n)
        a, b, c, d = load4(row, w + TURN * n, n)
        bx, by, bz = quat_rotate(a, b, c, d, bx, by, bz)
        px, py, pz = load3(row, w + PLACE * n, n)
        rx, ry, rz = rx + mass * (px + bx), ry + mass * (py + by), rz + mass * (pz + bz)
        _point_wrenches(row, out, n, bx, by, bz, mass * sx, mass * sy, mass * sz)
    fx, fy, fz = sx * sx * rx, sy * sy * ry, sz * sz * rz
    for k in range(body_count):
        w, own = work + terms[bodies + k] * SLOTS * n, at + (7 + 4 * k) * n
        bx, by, bz, mass = load4(row, own, n)
        a, b, c, d = load4(row, w + TURN * n, n)
        bx, by, bz = quat_rotate(a, b, c, d, bx, by, bz)
        _pull_at(row, w, n, bx, by, bz, mass * fx, mass * fy, mass * fz, plain)
    rx, ry, rz = ax * rx, ay * ry, az * rz
    squared = rx * rx + ry * ry + rz * rz
    distance = sqrt(squared)
    store(row, left, distance)
    add(row, cost, 0.5 * (weight * weight * squared))
    store(row, miss, maximum(load(row, miss), _counted(row, weight) * per_m * distance))


@kernel
def gather_tasks(
    joints, count, terms, term_count, row, q, shift, work, data, near, cost, miss, n, plain, per_m, per_rad
):
    """Inertias and forces of all tasks, cost, miss and what is left of each; the plain sums only where they are wanted."""
    zero = fill(row, 0.0)
    last = VIRIAL + 9 if plain else MOMENT
    for j in range(count):
        w = work + j * SLOTS * n
        for k in range(INERTIA, last):
            store(row, w + k * n, zero)
        if joints[j * JOINT_COLUMNS + J_PRIOR]:
            for k in range(PRIOR_INERTIA, PRIOR_PULL + 3):
                store(row, w + k * n, zero)
    store(row, cost, zero)
    store(row, miss, zero)
    for t in range(term_count):
        k = t * TERM_COLUMNS
        kind, joint, option = terms[k + T_KIND], terms[k + T_JOINT], terms[k + T_OPTION]
        w, at, left = work + joint * SLOTS * n, data + terms[k + T_AT] * n, data + (term_count + t) * n
        if kind == POSITION:
            _position(row, w, at, left, n, option != 0, plain, cost, miss, per_m)
        elif kind == ORIENTATION:
            _orientation(row, w, at, left, n, near, plain, cost, miss, per_rad)
        elif kind == LOOK_AT:
            _look_at(row, w, at, left, n, plain, cost, miss, per_rad)
        elif kind == CONTACT:
            _contact(row, w, at, left, n, option != 0, plain, cost, miss, per_m)
        elif kind == PRIOR:
            up = joints[joint * JOINT_COLUMNS + J_PARENT]
            _prior(row, w, work + up * SLOTS * n if up >= 0 else -1, q + 4 * joint * n, at, left, n, near, cost)
        elif kind == ROOT_PRIOR:
            _root_prior(row, w, shift, at, left, n, plain, cost)
    couples = term_count * TERM_COLUMNS
    for c in range(terms[couples + C_COUNT]):
        head = couples + C_TERMS + c * COUPLING_COLUMNS
        t, bodies = terms[head + C_TERM], first_body(terms, couples, head)
        wrenches = near + (EXTRA + WRENCHES * terms[head + C_FIRST]) * n
        k, at, left = t * TERM_COLUMNS, data + terms[t * TERM_COLUMNS + T_AT] * n, data + (term_count + t) * n
        kind, w, v = terms[k + T_KIND], work + terms[bodies] * SLOTS * n, work + terms[bodies + 1] * SLOTS * n
        if kind == RELATIVE_PLACE:
            _relative_place(row, w, v, at, left, wrenches, n, plain, cost, miss, per_m)
        elif kind == RELATIVE_TURN:
            _relative_turn(row, w, v, at, left, wrenches, n, near, plain, cost, miss, per_rad)
        elif kind == CENTER:
            _center(
                terms, bodies, terms[head + C_BODY_COUNT], row, work, at, left, wrenches, n, plain, cost, miss, per_m
            )
