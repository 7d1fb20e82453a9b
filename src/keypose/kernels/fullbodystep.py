# pyright: basic
"""The damped Newton step of the full-body solver, by eliminating joints from the leaves to the root and back.

The normal equations of a tree of joints are those of a mechanism: tasks are inertias and forces of bodies, and the step is
their acceleration. A joint that turns by d while what it hangs on turns by w and moves by v costs
(w + d, v)^T [A B; B^T C] (w + d, v) / 2 + (g, h)^T (w + d, v); it answers with d = -P ((A + T)^T w + B v + g), P the inverse of
A + sym(T) + damping, and leaves its parent what remains. T is the curvature: the sum of arm x force of all tasks below.

Source: R. Featherstone, "Rigid Body Dynamics Algorithms" (2008), chapter 7.
"""

from __future__ import annotations

from keypose.kernels.fullbodytables import (
    BEST,
    BY_MOVE,
    BY_PULL,
    BY_TURN,
    EDGE,
    FIXED,
    FORCE,
    FORCED,
    INERTIA,
    J_KIND,
    J_LIMIT,
    J_PARENT,
    J_PRIOR,
    JOINT_COLUMNS,
    MASS,
    MIXED,
    MOMENT,
    MOTION,
    NORMALS,
    PLACE,
    PRIOR_INERTIA,
    PRIOR_PULL,
    PULL,
    SLOTS,
    STEP,
    TORQUE,
    TURN,
    UPRIGHT,
    VIRIAL,
)
from keypose.kernels.fullbodytasks import add, add3, cross
from keypose.kernels.rotations import load3, load4, quat_multiply, quat_rotate, store3, store4
from keypose.kernels.runtime import inlined, kernel
from keypose.kernels.vectors import absolute, fill, flip_sign, load, maximum, sqrt, store


@inlined
def _least(a, b):
    return 0.0 - maximum(0.0 - a, 0.0 - b)


@inlined
def negative(row, x):
    """1 where a number is below 0, 0 elsewhere."""
    half = fill(row, 0.5)
    return half - flip_sign(half, x)


@inlined
def _across(xx, xy, xz, yy, yz, zz, nx, ny, nz, own):
    """A symmetric matrix across a unit normal, with ``own`` along it; a normal of no length changes nothing."""
    x, y, z = xx * nx + xy * ny + xz * nz, xy * nx + yy * ny + yz * nz, xz * nx + yz * ny + zz * nz
    half = 0.5 * (nx * x + ny * y + nz * z + own)
    x, y, z = x - half * nx, y - half * ny, z - half * nz
    return (
        xx - 2.0 * nx * x, xy - (nx * y + ny * x), xz - (nx * z + nz * x),
        yy - 2.0 * ny * y, yz - (ny * z + nz * y), zz - 2.0 * nz * z,
    )  # fmt: skip


@inlined
def _less(xx, xy, xz, yy, yz, zz, nx, ny, nz, scale):
    """A symmetric matrix less ``scale`` along a normal."""
    x, y, z = scale * nx, scale * ny, scale * nz
    return xx - x * nx, xy - x * ny, xz - x * nz, yy - y * ny, yz - y * nz, zz - z * nz


@inlined
def _inverse(row, sound, below, xx, xy, xz, yy, yz, zz):
    """The inverse of a symmetric matrix; ``sound`` falls to or below 0 where it is not positive definite.

    How many of its eigenvalues are negative is added up ``below``, if that is anywhere.
    """
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    whole = xx * a + xy * b + xz * c
    minor = xx * yy - xy * xy
    store(row, sound, _least(load(row, sound), _least(xx, _least(minor, whole))))
    if below >= 0:
        add(row, below, negative(row, xx) + negative(row, xx * minor) + negative(row, minor * whole))
    scale = 1.0 / whole
    return scale * a, scale * b, scale * c, scale * (xx * zz - xz * xz), scale * (xy * xz - xx * yz), scale * minor


@inlined
def _curvature(row, w, n, px, py, pz, bend):
    """T of a joint, nine entries, as far as it is wanted."""
    fx, fy, fz = load3(row, w + PULL * n, n)
    t0, t1, t2 = load3(row, w + VIRIAL * n, n)
    t3, t4, t5 = load3(row, w + (VIRIAL + 3) * n, n)
    t6, t7, t8 = load3(row, w + (VIRIAL + 6) * n, n)
    t0, t4, t8 = t0 - px * fx, t4 - py * fy, t8 - pz * fz
    trace = t0 + t4 + t8
    return (
        bend * (t0 - trace), bend * (t1 - px * fy), bend * (t2 - px * fz),
        bend * (t3 - py * fx), bend * (t4 - trace), bend * (t5 - py * fz),
        bend * (t6 - pz * fx), bend * (t7 - pz * fy), bend * (t8 - trace),
    )  # fmt: skip


@inlined
def _columns(ixx, ixy, ixz, iyy, iyz, izz, x, y, z):
    """A symmetric matrix times a vector."""
    return ixx * x + ixy * y + ixz * z, ixy * x + iyy * y + iyz * z, ixz * x + iyz * y + izz * z


@kernel
def _restricted_inverse(row, w, near, n, upright, sound, below, own, mxx, mxy, mxz, myy, myz, mzz):
    """The inverse over what a joint may do, to ``near``."""
    for k in range(3):
        if upright and k == 2:
            break
        if upright:
            nx, ny, nz = fill(row, 1.0 - k), fill(row, 0.0), fill(row, 0.0 + k)
        else:
            nx, ny, nz = load3(row, w + (NORMALS + 3 * k) * n, n)
        mxx, mxy, mxz, myy, myz, mzz = _across(mxx, mxy, mxz, myy, myz, mzz, nx, ny, nz, own)
    xx, xy, xz, yy, yz, zz = _inverse(row, sound, below, mxx, mxy, mxz, myy, myz, mzz)
    scale = 1.0 / own
    for k in range(3):
        if upright and k == 2:
            break
        if upright:
            nx, ny, nz = fill(row, 1.0 - k), fill(row, 0.0), fill(row, 0.0 + k)
        else:
            nx, ny, nz = load3(row, w + (NORMALS + 3 * k) * n, n)
        xx, xy, xz, yy, yz, zz = _less(xx, xy, xz, yy, yz, zz, nx, ny, nz, scale)
    store3(row, near, n, xx, xy, xz)
    store3(row, near + 3 * n, n, yy, yz, zz)


@kernel
def _move_root(row, ways, move, kept, n, lam, sound, below, gain, c0, c1, c2, c3, c4, c5, hx, hy, hz):
    """The displacement that the whole rest answers with, along the axes that are free."""
    zero, one = fill(row, 0.0), fill(row, 1.0)
    if ways & 1 == 0:
        c0, c1, c2, hx = one, zero, zero, zero
    if ways & 2 == 0:
        c1, c3, c4, hy = zero, one, zero, zero
    if ways & 4 == 0:
        c2, c4, c5, hz = zero, zero, one, zero
    ixx, ixy, ixz, iyy, iyz, izz = _inverse(row, sound, below, c0 + lam, c1, c2, c3 + lam, c4, c5 + lam)
    if kept >= 0:
        # Axes that are not free answer nothing.
        if ways & 1 == 0:
            ixx = zero
        if ways & 2 == 0:
            iyy = zero
        if ways & 4 == 0:
            izz = zero
        store3(row, kept, n, ixx, ixy, ixz)
        store3(row, kept + 3 * n, n, iyy, iyz, izz)
    x, y, z = _columns(ixx, ixy, ixz, iyy, iyz, izz, hx, hy, hz)
    add(row, gain, 0.5 * (x * hx + y * hy + z * hz))
    store3(row, move, n, 0.0 - x, 0.0 - y, 0.0 - z)


@kernel
def eliminate(
    joints, count, mover, ways, row, work, near, move, kept, n, curved, forced, damping, curving, sound, gain
):  # fmt: skip
    """From the leaves to the root: what each joint does in answer to the motion of its parent, and what it leaves it.

    The inverses of joints, and the root's after them, are kept where that is said (-1: nowhere), and after ``sound`` how many
    eigenvalues are negative.
    """
    below = sound + n if kept >= 0 else -1
    store(row, sound, fill(row, 1e300))
    if kept >= 0:
        store(row, below, fill(row, 0.0))
    store(row, gain, fill(row, 0.0))
    lam, bend = load(row, damping), load(row, curving)
    for back in range(count):
        j = count - 1 - back
        w, p = work + j * SLOTS * n, joints[j * JOINT_COLUMNS + J_PARENT]
        kind = joints[j * JOINT_COLUMNS + J_KIND]
        axx, axy, axz = load3(row, w + INERTIA * n, n)
        ayy, ayz, azz = load3(row, w + (INERTIA + 3) * n, n)
        b0, b1, b2 = load3(row, w + MIXED * n, n)
        b3, b4, b5 = load3(row, w + (MIXED + 3) * n, n)
        b6, b7, b8 = load3(row, w + (MIXED + 6) * n, n)
        c0, c1, c2 = load3(row, w + MASS * n, n)
        c3, c4, c5 = load3(row, w + (MASS + 3) * n, n)
        gx, gy, gz = load3(row, w + TORQUE * n, n)
        hx, hy, hz = load3(row, w + FORCE * n, n)
        px, py, pz = load3(row, w + PLACE * n, n)
        if kind != FIXED:
            k0, k1, k2, k3, k4, k5, k6, k7, k8 = axx, axy, axz, axy, ayy, ayz, axz, ayz, azz  # A + T
            if curved:
                t0, t1, t2, t3, t4, t5, t6, t7, t8 = _curvature(row, w, n, px, py, pz, bend)
                k0, k1, k2, k3, k4 = k0 + t0, k1 + t1, k2 + t2, k3 + t3, k4 + t4
                k5, k6, k7, k8 = k5 + t5, k6 + t6, k7 + t7, k8 + t8
            mxx, mxy, mxz = k0 + lam, 0.5 * (k1 + k3), 0.5 * (k2 + k6)
            myy, myz, mzz = k4 + lam, 0.5 * (k5 + k7), k8 + lam
            ex, ey, ez = gx, gy, gz
            if curved and joints[j * JOINT_COLUMNS + J_LIMIT] >= 0:
                x, y, z = load3(row, w + EDGE * n, n)
                mxx, mxy, mxz = mxx + bend * x, mxy + bend * y, mxz + bend * z
                x, y, z = load3(row, w + (EDGE + 3) * n, n)
                myy, myz, mzz = myy + bend * x, myz + bend * y, mzz + bend * z
            if joints[j * JOINT_COLUMNS + J_PRIOR]:
                x, y, z = load3(row, w + PRIOR_INERTIA * n, n)
                mxx, mxy, mxz = mxx + x, mxy + y, mxz + z
                x, y, z = load3(row, w + (PRIOR_INERTIA + 3) * n, n)
                myy, myz, mzz = myy + x, myz + y, mzz + z
                x, y, z = load3(row, w + PRIOR_PULL * n, n)
                ex, ey, ez = ex + x, ey + y, ez + z
            if forced:  # what a joint is sent by, against which its own stiffness pulls
                x, y, z = load3(row, w + FORCED * n, n)
                ux, uy, uz = _columns(mxx - lam, mxy, mxz, myy - lam, myz, mzz - lam, x, y, z)
                ex, ey, ez = ex + ux, ey + uy, ez + uz
            if kind == UPRIGHT or joints[j * JOINT_COLUMNS + J_LIMIT] >= 0:
                own = absolute(axx) + absolute(ayy) + absolute(azz) + lam
                _restricted_inverse(row, w, near, n, kind == UPRIGHT, sound, below, own, mxx, mxy, mxz, myy, myz, mzz)
                ixx, ixy, ixz = load3(row, near, n)
                iyy, iyz, izz = load3(row, near + 3 * n, n)
            else:
                ixx, ixy, ixz, iyy, iyz, izz = _inverse(row, sound, below, mxx, mxy, mxz, myy, myz, mzz)
            if kept >= 0:
                store3(row, kept + 6 * j * n, n, ixx, ixy, ixz)
                store3(row, kept + (6 * j + 3) * n, n, iyy, iyz, izz)
            a0, a3, a6 = _columns(ixx, ixy, ixz, iyy, iyz, izz, k0, k1, k2)
            a1, a4, a7 = _columns(ixx, ixy, ixz, iyy, iyz, izz, k3, k4, k5)
            a2, a5, a8 = _columns(ixx, ixy, ixz, iyy, iyz, izz, k6, k7, k8)
            store3(row, w + BY_TURN * n, n, a0, a1, a2)
            store3(row, w + (BY_TURN + 3) * n, n, a3, a4, a5)
            store3(row, w + (BY_TURN + 6) * n, n, a6, a7, a8)
            d0, d3, d6 = _columns(ixx, ixy, ixz, iyy, iyz, izz, b0, b3, b6)
            d1, d4, d7 = _columns(ixx, ixy, ixz, iyy, iyz, izz, b1, b4, b7)
            d2, d5, d8 = _columns(ixx, ixy, ixz, iyy, iyz, izz, b2, b5, b8)
            store3(row, w + BY_MOVE * n, n, d0, d1, d2)
            store3(row, w + (BY_MOVE + 3) * n, n, d3, d4, d5)
            store3(row, w + (BY_MOVE + 6) * n, n, d6, d7, d8)
            x, y, z = _columns(ixx, ixy, ixz, iyy, iyz, izz, ex, ey, ez)
            add(row, gain, 0.5 * (x * ex + y * ey + z * ez))
            if forced:
                ex, ey, ez = load3(row, w + FORCED * n, n)
                x, y, z = x - ex, y - ey, z - ez
            store3(row, w + BY_PULL * n, n, x, y, z)
            gx, gy = gx - (k0 * x + k1 * y + k2 * z), gy - (k3 * x + k4 * y + k5 * z)
            gz = gz - (k6 * x + k7 * y + k8 * z)
            hx, hy = hx - (b0 * x + b3 * y + b6 * z), hy - (b1 * x + b4 * y + b7 * z)
            hz = hz - (b2 * x + b5 * y + b8 * z)
            axx, axy = axx - (k0 * a0 + k1 * a3 + k2 * a6), axy - (k0 * a1 + k1 * a4 + k2 * a7)
            axz, ayy = axz - (k0 * a2 + k1 * a5 + k2 * a8), ayy - (k3 * a1 + k4 * a4 + k5 * a7)
            ayz, azz = ayz - (k3 * a2 + k4 * a5 + k5 * a8), azz - (k6 * a2 + k7 * a5 + k8 * a8)
            c0, c1 = c0 - (b0 * d0 + b3 * d3 + b6 * d6), c1 - (b0 * d1 + b3 * d4 + b6 * d7)
            c2, c3 = c2 - (b0 * d2 + b3 * d5 + b6 * d8), c3 - (b1 * d1 + b4 * d4 + b7 * d7)
            c4, c5 = c4 - (b1 * d2 + b4 * d5 + b7 * d8), c5 - (b2 * d2 + b5 * d5 + b8 * d8)
            b0, b1 = b0 - (k0 * d0 + k1 * d3 + k2 * d6), b1 - (k0 * d1 + k1 * d4 + k2 * d7)
            b2, b3 = b2 - (k0 * d2 + k1 * d5 + k2 * d8), b3 - (k3 * d0 + k4 * d3 + k5 * d6)
            b4, b5 = b4 - (k3 * d1 + k4 * d4 + k5 * d7), b5 - (k3 * d2 + k4 * d5 + k5 * d8)
            b6, b7 = b6 - (k6 * d0 + k7 * d3 + k8 * d6), b7 - (k6 * d1 + k7 * d4 + k8 * d7)
            b8 = b8 - (k6 * d2 + k7 * d5 + k8 * d8)
        if j == mover:
            root = kept + 6 * count * n if kept >= 0 else -1
            _move_root(row, ways, move, root, n, lam, sound, below, gain, c0, c1, c2, c3, c4, c5, hx, hy, hz)
        if p >= 0:
            up = work + p * SLOTS * n
            ux, uy, uz = load3(row, up + PLACE * n, n)
            rx, ry, rz = px - ux, py - uy, pz - uz
            # At the parent's place: B + D C and A - B D + D (B + D C)^T, with D x = r x x.
            x, y, z = cross(rx, ry, rz, hx, hy, hz)
            add3(row, up + TORQUE * n, n, gx + x, gy + y, gz + z)
            add3(row, up + FORCE * n, n, hx, hy, hz)
            x0, x1, x2 = cross(rx, ry, rz, b0, b1, b2)
            _, x4, x5 = cross(rx, ry, rz, b3, b4, b5)
            _, _, x8 = cross(rx, ry, rz, b6, b7, b8)
            x, y, z = cross(rx, ry, rz, c0, c1, c2)
            b0, b3, b6 = b0 + x, b3 + y, b6 + z
            x, y, z = cross(rx, ry, rz, c1, c3, c4)
            b1, b4, b7 = b1 + x, b4 + y, b7 + z
            x, y, z = cross(rx, ry, rz, c2, c4, c5)
            b2, b5, b8 = b2 + x, b5 + y, b8 + z
            y0, _, _ = cross(rx, ry, rz, b0, b1, b2)
            y1, y4, _ = cross(rx, ry, rz, b3, b4, b5)
            y2, y5, y8 = cross(rx, ry, rz, b6, b7, b8)
            add3(row, up + INERTIA * n, n, axx + x0 + y0, axy + x1 + y1, axz + x2 + y2)
            add3(row, up + (INERTIA + 3) * n, n, ayy + x4 + y4, ayz + x5 + y5, azz + x8 + y8)
            add3(row, up + MIXED * n, n, b0, b1, b2)
            add3(row, up + (MIXED + 3) * n, n, b3, b4, b5)
            add3(row, up + (MIXED + 6) * n, n, b6, b7, b8)
            add3(row, up + MASS * n, n, c0, c1, c2)
            add3(row, up + (MASS + 3) * n, n, c3, c4, c5)


@kernel
def gather_forces(joints, count, row, work, n):
    """Plain forces, moments and virials of everything below each joint."""
    for back in range(count):
        j = count - 1 - back
        p = joints[j * JOINT_COLUMNS + J_PARENT]
        if p >= 0:
            for k in range(MOMENT, VIRIAL + 9):
                add(row, work + (p * SLOTS + k) * n, load(row, work + (j * SLOTS + k) * n))


@inlined
def _gradient(row, w, n, px, py, pz):
    """The plain torque of everything below a joint about its place."""
    fx, fy, fz = load3(row, w + PULL * n, n)
    mx, my, mz = load3(row, w + MOMENT * n, n)
    x, y, z = cross(px, py, pz, fx, fy, fz)
    return mx - x, my - y, mz - z


@kernel
def _gain_of_forced(joints, j, row, w, n, curved, lam, bend, gain, ox, oy, oz, vx, vy, vz):
    """What a joint's step adds to the promise where some joints are forced.

    Half of minus gradient times step, of the damping on what is free of it, and of what pulls at what is forced.
    """
    px, py, pz = load3(row, w + PLACE * n, n)
    x, y, z = load3(row, w + STEP * n, n)
    gx, gy, gz = _gradient(row, w, n, px, py, pz)
    k0, k1, k2 = load3(row, w + INERTIA * n, n)
    k4, k5, k8 = load3(row, w + (INERTIA + 3) * n, n)
    k3, k6, k7 = k1, k2, k5
    if curved:
        t0, t1, t2, t3, t4, t5, t6, t7, t8 = _curvature(row, w, n, px, py, pz, bend)
        k0, k1, k2, k3, k4 = k0 + t0, k1 + t1, k2 + t2, k3 + t3, k4 + t4
        k5, k6, k7, k8 = k5 + t5, k6 + t6, k7 + t7, k8 + t8
    b0, b1, b2 = load3(row, w + MIXED * n, n)
    b3, b4, b5 = load3(row, w + (MIXED + 3) * n, n)
    b6, b7, b8 = load3(row, w + (MIXED + 6) * n, n)
    ex, ey, ez = load3(row, w + TORQUE * n, n)
    ex = ex + k0 * ox + k3 * oy + k6 * oz + b0 * vx + b1 * vy + b2 * vz
    ey = ey + k1 * ox + k4 * oy + k7 * oz + b3 * vx + b4 * vy + b5 * vz
    ez = ez + k2 * ox + k5 * oy + k8 * oz + b6 * vx + b7 * vy + b8 * vz
    xy, xz, yz = 0.5 * (k1 + k3), 0.5 * (k2 + k6), 0.5 * (k5 + k7)
    if curved and joints[j * JOINT_COLUMNS + J_LIMIT] >= 0:
        mx, my, mz = load3(row, w + EDGE * n, n)
        k0, xy, xz = k0 + bend * mx, xy + bend * my, xz + bend * mz
        mx, my, mz = load3(row, w + (EDGE + 3) * n, n)
        k4, yz, k8 = k4 + bend * mx, yz + bend * my, k8 + bend * mz
    if joints[j * JOINT_COLUMNS + J_PRIOR]:
        mx, my, mz = load3(row, w + PRIOR_PULL * n, n)
        gx, gy, gz = gx + mx, gy + my, gz + mz
        ex, ey, ez = ex + mx, ey + my, ez + mz
        mx, my, mz = load3(row, w + PRIOR_INERTIA * n, n)
        k0, xy, xz = k0 + mx, xy + my, xz + mz
        mx, my, mz = load3(row, w + (PRIOR_INERTIA + 3) * n, n)
        k4, yz, k8 = k4 + mx, yz + my, k8 + mz
    ex, ey, ez = ex + k0 * x + xy * y + xz * z, ey + xy * x + k4 * y + yz * z, ez + xz * x + yz * y + k8 * z
    fx, fy, fz = load3(row, w + FORCED * n, n)
    own = (x - fx) * (x - fx) + (y - fy) * (y - fy) + (z - fz) * (z - fz)
    add(row, gain, 0.5 * (lam * own - (gx * x + gy * y + gz * z) - (fx * ex + fy * ey + fz * ez)))


@kernel
def follow(joints, count, mover, row, q, work, move, active, gain, size, n, curved, forced, damping, curving):
    """From the root to the leaves: the step, the rotations after it, and what it promises."""
    lam, mask, bend = load(row, damping), load(row, active), load(row, curving)
    zero = fill(row, 0.0)
    largest, spent = zero, zero
    if forced:
        store(row, gain, zero)
    for j in range(count):
        w, p = work + j * SLOTS * n, joints[j * JOINT_COLUMNS + J_PARENT]
        ox, oy, oz = zero, zero, zero
        vx, vy, vz = zero, zero, zero
        if p >= 0:
            up = work + p * SLOTS * n
            px, py, pz = load3(row, w + PLACE * n, n)
            ux, uy, uz = load3(row, up + PLACE * n, n)
            ox, oy, oz = load3(row, up + MOTION * n, n)
            vx, vy, vz = load3(row, up + (MOTION + 3) * n, n)
            x, y, z = cross(ox, oy, oz, px - ux, py - uy, pz - uz)
            vx, vy, vz = vx + x, vy + y, vz + z
        if j == mover:
            x, y, z = load3(row, move, n)
            vx, vy, vz = vx + x, vy + y, vz + z
            squared = x * x + y * y + z * z
            if forced:
                fx, fy, fz = load3(row, w + PULL * n, n)
                add(row, gain, 0.5 * (lam * squared - (fx * x + fy * y + fz * z)))
            else:
                spent = spent + squared
            largest = maximum(largest, maximum(absolute(x), maximum(absolute(y), absolute(z))))
        if joints[j * JOINT_COLUMNS + J_KIND] != FIXED:
            a0, a1, a2 = load3(row, w + BY_TURN * n, n)
            a3, a4, a5 = load3(row, w + (BY_TURN + 3) * n, n)
            a6, a7, a8 = load3(row, w + (BY_TURN + 6) * n, n)
            d0, d1, d2 = load3(row, w + BY_MOVE * n, n)
            d3, d4, d5 = load3(row, w + (BY_MOVE + 3) * n, n)
            d6, d7, d8 = load3(row, w + (BY_MOVE + 6) * n, n)
            x, y, z = load3(row, w + BY_PULL * n, n)
            x = 0.0 - (x + a0 * ox + a1 * oy + a2 * oz + d0 * vx + d1 * vy + d2 * vz)
            y = 0.0 - (y + a3 * ox + a4 * oy + a5 * oz + d3 * vx + d4 * vy + d5 * vz)
            z = 0.0 - (z + a6 * ox + a7 * oy + a8 * oz + d6 * vx + d7 * vy + d8 * vz)
            store3(row, w + STEP * n, n, x, y, z)
            if forced:
                _gain_of_forced(joints, j, row, w, n, curved, lam, bend, gain, ox, oy, oz, vx, vy, vz)
            else:
                spent = spent + x * x + y * y + z * z
            largest = maximum(largest, maximum(absolute(x), maximum(absolute(y), absolute(z))))
            ox, oy, oz = ox + x, oy + y, oz + z
            # The turn is in the model's axes, the rotation in the parent's; solves that are done stay.
            x, y, z = 0.5 * mask * x, 0.5 * mask * y, 0.5 * mask * z
            if p >= 0:
                e, f, g, h = load4(row, work + (p * SLOTS + TURN) * n, n)
                x, y, z = quat_rotate(e, 0.0 - f, 0.0 - g, 0.0 - h, x, y, z)
            e, f, g, h = load4(row, w + BEST * n, n)
            a, b, c, d = quat_multiply(fill(row, 1.0), x, y, z, e, f, g, h)
            scale = 1.0 / sqrt(a * a + b * b + c * c + d * d)
            store4(row, q + 4 * j * n, n, scale * a, scale * b, scale * c, scale * d)
        store3(row, w + MOTION * n, n, ox, oy, oz)
        store3(row, w + (MOTION + 3) * n, n, vx, vy, vz)
    if not forced:
        add(row, gain, 0.5 * (lam * spent))
    store(row, size, largest)
