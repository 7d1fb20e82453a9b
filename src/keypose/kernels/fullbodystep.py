# pyright: basic
"""The damped Newton step of the full-body solver, by eliminating joints from the leaves to the root and back.

The normal equations of a tree of joints are those of a mechanism: tasks are inertias and forces of bodies, and the step is
their acceleration. A joint at p that turns by d while what it hangs on turns by w and moves by v costs
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
    FIXED,
    FORCE,
    FORCED,
    INERTIA,
    J_KIND,
    J_LIMIT,
    J_PARENT,
    J_PRIOR,
    JOINT_COLUMNS,
    KEEP,
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
from keypose.kernels.vectors import absolute, fill, load, maximum, sqrt, store


@inlined
def _minimum(a, b):
    return 0.0 - maximum(0.0 - a, 0.0 - b)


@kernel
def _without(row, at, n, nx, ny, nz):
    """The inverse at ``at`` (six entries) without the direction of a normal; one of no length changes nothing."""
    xx, xy, xz = load3(row, at, n)
    yy, yz, zz = load3(row, at + 3 * n, n)
    x, y, z = xx * nx + xy * ny + xz * nz, xy * nx + yy * ny + yz * nz, xz * nx + yz * ny + zz * nz
    along = maximum(nx * x + ny * y + nz * z, 1e-13 * (xx + yy + zz))
    scale = 1.0 / maximum(along, fill(row, 1e-290))
    sx, sy, sz = scale * x, scale * y, scale * z
    store3(row, at, n, xx - sx * x, xy - sx * y, xz - sx * z)
    store3(row, at + 3 * n, n, yy - sy * y, yz - sy * z, zz - sz * z)


@kernel
def _inverse(row, at, n, xx, xy, xz, yy, yz, zz, sound):
    """The inverse of a symmetric matrix to ``at``; ``sound`` falls to or below 0 where it is not positive definite."""
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    whole = xx * a + xy * b + xz * c
    minor = xx * yy - xy * xy
    store(row, sound, _minimum(load(row, sound), _minimum(xx, _minimum(minor, whole))))
    scale = 1.0 / whole
    store3(row, at, n, scale * a, scale * b, scale * c)
    store3(row, at + 3 * n, n, scale * (xx * zz - xz * xz), scale * (xy * xz - xx * yz), scale * minor)


@kernel
def eliminate(joints, count, mover, ways, row, work, near, move, n, curved, forced, damping, curving, sound):
    """From the leaves to the root: what each joint does in answer to the motion of its parent, and what it leaves it."""
    store(row, sound, fill(row, 1e300))
    lam = load(row, damping)
    bend = load(row, curving)
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
        rx, ry, rz = px, py, pz  # from the parent
        if p >= 0:
            ux, uy, uz = load3(row, work + (p * SLOTS + PLACE) * n, n)
            rx, ry, rz = px - ux, py - uy, pz - uz
        if kind != FIXED:
            # K = A + T, what a turn of the joint does to the turns above it; T is the curvature.
            k0, k1, k2, k3, k4, k5, k6, k7, k8 = axx, axy, axz, axy, ayy, ayz, axz, ayz, azz
            if curved:
                fx, fy, fz = load3(row, w + PULL * n, n)
                t0, t1, t2 = load3(row, w + VIRIAL * n, n)
                t3, t4, t5 = load3(row, w + (VIRIAL + 3) * n, n)
                t6, t7, t8 = load3(row, w + (VIRIAL + 6) * n, n)
                t0, t1, t2 = t0 - px * fx, t1 - px * fy, t2 - px * fz
                t3, t4, t5 = t3 - py * fx, t4 - py * fy, t5 - py * fz
                t6, t7, t8 = t6 - pz * fx, t7 - pz * fy, t8 - pz * fz
                trace = t0 + t4 + t8
                t0, t4, t8 = t0 - trace, t4 - trace, t8 - trace
                k0, k1, k2 = k0 + bend * t0, k1 + bend * t1, k2 + bend * t2
                k3, k4, k5 = k3 + bend * t3, k4 + bend * t4, k5 + bend * t5
                k6, k7, k8 = k6 + bend * t6, k7 + bend * t7, k8 + bend * t8
            mxx, mxy, mxz = k0 + lam, 0.5 * (k1 + k3), 0.5 * (k2 + k6)
            myy, myz, mzz = k4 + lam, 0.5 * (k5 + k7), k8 + lam
            ex, ey, ez = gx, gy, gz
            if joints[j * JOINT_COLUMNS + J_PRIOR]:
                x, y, z = load3(row, w + PRIOR_INERTIA * n, n)
                mxx, mxy, mxz = mxx + x, mxy + y, mxz + z
                x, y, z = load3(row, w + (PRIOR_INERTIA + 3) * n, n)
                myy, myz, mzz = myy + x, myz + y, mzz + z
                x, y, z = load3(row, w + PRIOR_PULL * n, n)
                ex, ey, ez = ex + x, ey + y, ez + z
            _inverse(row, near, n, mxx, mxy, mxz, myy, myz, mzz, sound)
            if kind == UPRIGHT:
                one, zero = fill(row, 1.0), fill(row, 0.0)
                _without(row, near, n, one, zero, zero)
                _without(row, near, n, zero, zero, one)
            if joints[j * JOINT_COLUMNS + J_LIMIT] >= 0:
                for k in range(3):
                    x, y, z = load3(row, w + (NORMALS + 3 * k) * n, n)
                    _without(row, near, n, x, y, z)
            ixx, ixy, ixz = load3(row, near, n)
            iyy, iyz, izz = load3(row, near + 3 * n, n)
            if forced:
                keep = load(row, w + KEEP * n)
                ixx, ixy, ixz = keep * ixx, keep * ixy, keep * ixz
                iyy, iyz, izz = keep * iyy, keep * iyz, keep * izz
            # P K^T, P B, P g
            a0, a1, a2 = ixx * k0 + ixy * k1 + ixz * k2, ixx * k3 + ixy * k4 + ixz * k5, ixx * k6 + ixy * k7 + ixz * k8
            a3, a4, a5 = ixy * k0 + iyy * k1 + iyz * k2, ixy * k3 + iyy * k4 + iyz * k5, ixy * k6 + iyy * k7 + iyz * k8
            a6, a7, a8 = ixz * k0 + iyz * k1 + izz * k2, ixz * k3 + iyz * k4 + izz * k5, ixz * k6 + iyz * k7 + izz * k8
            store3(row, w + BY_TURN * n, n, a0, a1, a2)
            store3(row, w + (BY_TURN + 3) * n, n, a3, a4, a5)
            store3(row, w + (BY_TURN + 6) * n, n, a6, a7, a8)
            d0, d1, d2 = ixx * b0 + ixy * b3 + ixz * b6, ixx * b1 + ixy * b4 + ixz * b7, ixx * b2 + ixy * b5 + ixz * b8
            d3, d4, d5 = ixy * b0 + iyy * b3 + iyz * b6, ixy * b1 + iyy * b4 + iyz * b7, ixy * b2 + iyy * b5 + iyz * b8
            d6, d7, d8 = ixz * b0 + iyz * b3 + izz * b6, ixz * b1 + iyz * b4 + izz * b7, ixz * b2 + iyz * b5 + izz * b8
            store3(row, w + BY_MOVE * n, n, d0, d1, d2)
            store3(row, w + (BY_MOVE + 3) * n, n, d3, d4, d5)
            store3(row, w + (BY_MOVE + 6) * n, n, d6, d7, d8)
            x, y, z = ixx * ex + ixy * ey + ixz * ez, ixy * ex + iyy * ey + iyz * ez, ixz * ex + iyz * ey + izz * ez
            if forced:
                ex, ey, ez = load3(row, w + FORCED * n, n)
                x, y, z = x - ex, y - ey, z - ez
            store3(row, w + BY_PULL * n, n, x, y, z)
            # what is left
            gx, gy, gz = (
                gx - (k0 * x + k1 * y + k2 * z),
                gy - (k3 * x + k4 * y + k5 * z),
                gz - (k6 * x + k7 * y + k8 * z),
            )
            hx, hy, hz = (
                hx - (b0 * x + b3 * y + b6 * z),
                hy - (b1 * x + b4 * y + b7 * z),
                hz - (b2 * x + b5 * y + b8 * z),
            )
            axx, axy, axz = (
                axx - (k0 * a0 + k1 * a3 + k2 * a6),
                axy - (k0 * a1 + k1 * a4 + k2 * a7),
                axz - (k0 * a2 + k1 * a5 + k2 * a8),
            )
            ayy, ayz, azz = (
                ayy - (k3 * a1 + k4 * a4 + k5 * a7),
                ayz - (k3 * a2 + k4 * a5 + k5 * a8),
                azz - (k6 * a2 + k7 * a5 + k8 * a8),
            )
            c0, c1, c2 = (
                c0 - (b0 * d0 + b3 * d3 + b6 * d6),
                c1 - (b0 * d1 + b3 * d4 + b6 * d7),
                c2 - (b0 * d2 + b3 * d5 + b6 * d8),
            )
            c3, c4, c5 = (
                c3 - (b1 * d1 + b4 * d4 + b7 * d7),
                c4 - (b1 * d2 + b4 * d5 + b7 * d8),
                c5 - (b2 * d2 + b5 * d5 + b8 * d8),
            )
            b0, b1, b2 = (
                b0 - (k0 * d0 + k1 * d3 + k2 * d6),
                b1 - (k0 * d1 + k1 * d4 + k2 * d7),
                b2 - (k0 * d2 + k1 * d5 + k2 * d8),
            )
            b3, b4, b5 = (
                b3 - (k3 * d0 + k4 * d3 + k5 * d6),
                b4 - (k3 * d1 + k4 * d4 + k5 * d7),
                b5 - (k3 * d2 + k4 * d5 + k5 * d8),
            )
            b6, b7, b8 = (
                b6 - (k6 * d0 + k7 * d3 + k8 * d6),
                b7 - (k6 * d1 + k7 * d4 + k8 * d7),
                b8 - (k6 * d2 + k7 * d5 + k8 * d8),
            )
        if j == mover:
            _inverse(row, near, n, c0 + lam, c1, c2, c3 + lam, c4, c5 + lam, sound)
            for k in range(3):
                if (ways >> k) & 1 == 0:
                    one, zero = fill(row, 1.0), fill(row, 0.0)
                    if k == 0:
                        _without(row, near, n, one, zero, zero)
                    elif k == 1:
                        _without(row, near, n, zero, one, zero)
                    else:
                        _without(row, near, n, zero, zero, one)
            ixx, ixy, ixz = load3(row, near, n)
            iyy, iyz, izz = load3(row, near + 3 * n, n)
            store3(
                row, move, n, 0.0 - (ixx * hx + ixy * hy + ixz * hz),
                0.0 - (ixy * hx + iyy * hy + iyz * hz), 0.0 - (ixz * hx + iyz * hy + izz * hz),
            )  # fmt: skip
        if p >= 0:
            up = work + p * SLOTS * n
            # to the parent's place: B + D C, A - B D + D (B + D C)^T, with D x = r x x
            x, y, z = cross(rx, ry, rz, hx, hy, hz)
            add3(row, up + TORQUE * n, n, gx + x, gy + y, gz + z)
            add3(row, up + FORCE * n, n, hx, hy, hz)
            x0, x1, x2 = cross(rx, ry, rz, b0, b1, b2)
            x3, x4, x5 = cross(rx, ry, rz, b3, b4, b5)
            x6, x7, x8 = cross(rx, ry, rz, b6, b7, b8)
            e0, e3, e6 = cross(rx, ry, rz, c0, c1, c2)
            e1, e4, e7 = cross(rx, ry, rz, c1, c3, c4)
            e2, e5, e8 = cross(rx, ry, rz, c2, c4, c5)
            b0, b1, b2, b3, b4, b5 = b0 + e0, b1 + e1, b2 + e2, b3 + e3, b4 + e4, b5 + e5
            b6, b7, b8 = b6 + e6, b7 + e7, b8 + e8
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
def gather_forces(joints, count, row, work, n, curved):
    """Plain forces, moments and virials of everything below each joint."""
    last = VIRIAL + 9 if curved else VIRIAL
    for back in range(count):
        j = count - 1 - back
        p = joints[j * JOINT_COLUMNS + J_PARENT]
        if p >= 0:
            for k in range(MOMENT, last):
                add(row, work + (p * SLOTS + k) * n, load(row, work + (j * SLOTS + k) * n))


@kernel
def follow(joints, count, mover, row, q, work, move, active, promised, size, n, curved, forced, damping, curving):
    """From the root to the leaves: the step, the rotations after it, and what it promises."""
    lam, mask = load(row, damping), load(row, active)
    bend = load(row, curving)
    gain, largest = fill(row, 0.0), fill(row, 0.0)
    zero = fill(row, 0.0)
    for j in range(count):
        w, p = work + j * SLOTS * n, joints[j * JOINT_COLUMNS + J_PARENT]
        ox, oy, oz = zero, zero, zero
        vx, vy, vz = zero, zero, zero
        px, py, pz = load3(row, w + PLACE * n, n)
        if p >= 0:
            up = work + p * SLOTS * n
            ux, uy, uz = load3(row, up + PLACE * n, n)
            ox, oy, oz = load3(row, up + MOTION * n, n)
            vx, vy, vz = load3(row, up + (MOTION + 3) * n, n)
            x, y, z = cross(ox, oy, oz, px - ux, py - uy, pz - uz)
            vx, vy, vz = vx + x, vy + y, vz + z
        if j == mover:
            x, y, z = load3(row, move, n)
            vx, vy, vz = vx + x, vy + y, vz + z
            fx, fy, fz = load3(row, w + PULL * n, n)
            gain = gain - 0.5 * (fx * x + fy * y + fz * z) + 0.5 * lam * (x * x + y * y + z * z)
            largest = maximum(largest, maximum(absolute(x), maximum(absolute(y), absolute(z))))
        a, b, c, d = load4(row, q + 4 * j * n, n)
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
            fx, fy, fz = load3(row, w + PULL * n, n)
            mx, my, mz = load3(row, w + MOMENT * n, n)
            gx, gy, gz = cross(px, py, pz, fx, fy, fz)
            gx, gy, gz = mx - gx, my - gy, mz - gz
            ridden = joints[j * JOINT_COLUMNS + J_PRIOR] != 0
            if ridden:
                mx, my, mz = load3(row, w + PRIOR_PULL * n, n)
                gx, gy, gz = gx + mx, gy + my, gz + mz
            gain = gain - 0.5 * (gx * x + gy * y + gz * z)
            squared = x * x + y * y + z * z
            if forced:
                keep = load(row, w + KEEP * n)
                gain = gain + 0.5 * lam * (keep * squared)
                # What pulls at a forced joint: (A + T) step + (A + T)^T above + B v + g, of what is left below it.
                k0, k1, k2 = load3(row, w + INERTIA * n, n)
                k4, k5, k8 = load3(row, w + (INERTIA + 3) * n, n)
                k3, k6, k7 = k1, k2, k5
                if curved:
                    t0, t1, t2 = load3(row, w + VIRIAL * n, n)
                    t3, t4, t5 = load3(row, w + (VIRIAL + 3) * n, n)
                    t6, t7, t8 = load3(row, w + (VIRIAL + 6) * n, n)
                    t0, t1, t2 = t0 - px * fx, t1 - px * fy, t2 - px * fz
                    t3, t4, t5 = t3 - py * fx, t4 - py * fy, t5 - py * fz
                    t6, t7, t8 = t6 - pz * fx, t7 - pz * fy, t8 - pz * fz
                    trace = t0 + t4 + t8
                    k0, k1, k2 = k0 + bend * (t0 - trace), k1 + bend * t1, k2 + bend * t2
                    k3, k4, k5 = k3 + bend * t3, k4 + bend * (t4 - trace), k5 + bend * t5
                    k6, k7, k8 = k6 + bend * t6, k7 + bend * t7, k8 + bend * (t8 - trace)
                b0, b1, b2 = load3(row, w + MIXED * n, n)
                b3, b4, b5 = load3(row, w + (MIXED + 3) * n, n)
                b6, b7, b8 = load3(row, w + (MIXED + 6) * n, n)
                ex, ey, ez = load3(row, w + TORQUE * n, n)
                ex = ex + k0 * ox + k3 * oy + k6 * oz + b0 * vx + b1 * vy + b2 * vz
                ey = ey + k1 * ox + k4 * oy + k7 * oz + b3 * vx + b4 * vy + b5 * vz
                ez = ez + k2 * ox + k5 * oy + k8 * oz + b6 * vx + b7 * vy + b8 * vz
                xy, xz, yz = 0.5 * (k1 + k3), 0.5 * (k2 + k6), 0.5 * (k5 + k7)
                if ridden:
                    w0, w1, w2 = load3(row, w + PRIOR_INERTIA * n, n)
                    w3, w4, w5 = load3(row, w + (PRIOR_INERTIA + 3) * n, n)
                    k0, xy, xz, k4, yz, k8 = k0 + w0, xy + w1, xz + w2, k4 + w3, yz + w4, k8 + w5
                    ex, ey, ez = ex + mx, ey + my, ez + mz
                ex = ex + k0 * x + xy * y + xz * z
                ey = ey + xy * x + k4 * y + yz * z
                ez = ez + xz * x + yz * y + k8 * z
                gain = gain - 0.5 * (1.0 - keep) * (ex * x + ey * y + ez * z)
            else:
                gain = gain + 0.5 * lam * squared
            largest = maximum(largest, maximum(absolute(x), maximum(absolute(y), absolute(z))))
            ox, oy, oz = ox + x, oy + y, oz + z
            # The turn is in the model's axes, the rotation in the parent's; done solves stay.
            x, y, z = 0.5 * mask * x, 0.5 * mask * y, 0.5 * mask * z
            if p >= 0:
                e, f, g, h = load4(row, work + (p * SLOTS + TURN) * n, n)
                x, y, z = quat_rotate(e, 0.0 - f, 0.0 - g, 0.0 - h, x, y, z)
            e, f, g, h = load4(row, w + BEST * n, n)
            one = fill(row, 1.0)
            a, b, c, d = quat_multiply(one, x, y, z, e, f, g, h)
            scale = 1.0 / sqrt(a * a + b * b + c * c + d * d)
            store4(row, q + 4 * j * n, n, scale * a, scale * b, scale * c, scale * d)
        store3(row, w + MOTION * n, n, ox, oy, oz)
        store3(row, w + (MOTION + 3) * n, n, vx, vy, vz)
    store(row, promised, gain)
    store(row, size, largest)
