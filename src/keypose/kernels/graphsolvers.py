# pyright: basic
"""Operations on one pose that need the skeleton, for one character: curved ways, look-at, two-bone limbs, planted feet.

They follow `keypose.play.graph.solvers` and `keypose.ik.limb` number by number; only the joints that they need are walked.
"""

from __future__ import annotations

import math

from keypose.kernels import crowd as clips
from keypose.kernels.graphposes import room_of, settle_here
from keypose.kernels.graphtables import (
    CHAIN,
    CLIP_HANDLES,
    CURVES,
    EFFECTORS,
    EXTRAS,
    JOINTS,
    PADDED,
    PARENTS,
    POSE,
    REALS,
    WORDS,
)
from keypose.kernels.rotations import quat_multiply, quat_rotate
from keypose.kernels.runtime import inlined, kernel
from keypose.kernels.vectors import float32_at, float64_at, int64_at

LINK = 16  # numbers of one walked joint: quaternion, place, matrix
REACH = 0.9995  # of a limb's length: a straight knee has no side to bend to
BIAS = 1e-5  # of a limb's length, towards where it bends at rest: rounding must not choose for a straight one
EPS = 2.220446049250313e-16
PATH_COUNT, PATH = range(2)  # of a solver's integers: joints that are walked, then joint and parent's number of each


@inlined
def bend(h, p, x, z, curvature):
    """Carry the contacts' places from a straight way onto an arc."""
    settle_here(h, p)
    row = float32_at(room_of(h, p))
    effectors = h[EFFECTORS]
    places = h[POSE] - h[EXTRAS] + h[CURVES]
    for e in range(effectors):
        at = places + 3 * e
        px, pz = float(row[at]), float(row[at + 2])
        along = px * x + pz * z
        aside_x, aside_z = px - along * x, pz - along * z
        turn = curvature * along
        straight, curved = along, 0.0
        if turn != 0:
            straight = along * math.sin(turn) / turn
            curved = along * math.sin(0.5 * turn) * math.sin(0.5 * turn) / (0.5 * turn)
        c, s = math.cos(turn), math.sin(turn)
        row[at] = straight * x + curved * z + c * aside_x + s * aside_z
        row[at + 2] = straight * z - curved * x - s * aside_x + c * aside_z
        row[places + 4 * effectors + e] += turn


@inlined
def _local_place(h, row, j, which):
    """Translation (0) or scale (1) of a joint."""
    c = int64_at(h[CLIP_HANDLES])
    padded, moved, scaled = c[clips.PADDED], c[clips.MOVED], c[clips.SCALED]
    rest = float32_at(c[clips.REST])
    at = int64_at(c[clips.SCALED_AT] if which else c[clips.MOVED_AT])[j // clips.GROUP]
    x = y = z = 1.0
    if at >= 0:
        width = scaled if which else moved
        first = 4 * padded + (3 * moved if which else 0) + at + j % clips.GROUP
        x, y, z = float(row[first]), float(row[first + width]), float(row[first + 2 * width])
    elif at == clips.STILL:
        first = 3 * padded * which + j
        x, y, z = float(rest[first]), float(rest[first + padded]), float(rest[first + 2 * padded])
    return x, y, z


@kernel
def _walk(h, row, path, first):
    """Rotation, place and matrix in the character's space of the joints of a path, from one of its members on."""
    words, links, padded = int64_at(h[WORDS]), float64_at(h[CHAIN]), h[PADDED]
    for n in range(first, words[path + PATH_COUNT]):
        j, up = words[path + PATH + 2 * n], words[path + PATH + 2 * n + 1]
        w, x, y, z = float(row[j]), float(row[padded + j]), float(row[2 * padded + j]), float(row[3 * padded + j])
        tx, ty, tz = _local_place(h, row, j, 0)
        sx, sy, sz = _local_place(h, row, j, 1)
        xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
        wx, wy, wz = w * x, w * y, w * z
        a, b, c = (1 - 2 * (yy + zz)) * sx, 2 * (xy - wz) * sy, 2 * (xz + wy) * sz
        d, e, f = 2 * (xy + wz) * sx, (1 - 2 * (xx + zz)) * sy, 2 * (yz - wx) * sz
        g, k, i = 2 * (xz - wy) * sx, 2 * (yz + wx) * sy, (1 - 2 * (xx + yy)) * sz
        o = n * LINK
        if up < 0:
            links[o], links[o + 1], links[o + 2], links[o + 3] = w, x, y, z
            links[o + 4], links[o + 5], links[o + 6] = tx, ty, tz
            links[o + 7], links[o + 8], links[o + 9] = a, b, c
            links[o + 10], links[o + 11], links[o + 12] = d, e, f
            links[o + 13], links[o + 14], links[o + 15] = g, k, i
            continue
        q = up * LINK
        w, x, y, z = quat_multiply(links[q], links[q + 1], links[q + 2], links[q + 3], w, x, y, z)
        links[o], links[o + 1], links[o + 2], links[o + 3] = w, x, y, z
        for r in range(3):
            m0, m1, m2 = links[q + 7 + 3 * r], links[q + 8 + 3 * r], links[q + 9 + 3 * r]
            links[o + 4 + r] = links[q + 4 + r] + m0 * tx + m1 * ty + m2 * tz
            links[o + 7 + 3 * r] = m0 * a + m1 * d + m2 * g
            links[o + 8 + 3 * r] = m0 * b + m1 * e + m2 * k
            links[o + 9 + 3 * r] = m0 * c + m1 * f + m2 * i


@inlined
def _turn_of(links, n):
    o = n * LINK
    return links[o], links[o + 1], links[o + 2], links[o + 3]


@inlined
def _place_of(links, n):
    o = n * LINK + 4
    return links[o], links[o + 1], links[o + 2]


@inlined
def _set_world(links, row, words, path, padded, n, w, x, y, z):
    """Give a walked joint a rotation in the character's space: its local one follows from the joint above."""
    j, up = words[path + PATH + 2 * n], words[path + PATH + 2 * n + 1]
    if up >= 0:
        uw, ux, uy, uz = _turn_of(links, up)
        lw, lx, ly, lz = quat_multiply(uw, -ux, -uy, -uz, w, x, y, z)
    else:
        lw, lx, ly, lz = w, x, y, z
    length = math.sqrt(lw * lw + lx * lx + ly * ly + lz * lz)
    row[j], row[padded + j] = lw / length, lx / length
    row[2 * padded + j], row[3 * padded + j] = ly / length, lz / length
    o = n * LINK
    links[o], links[o + 1], links[o + 2], links[o + 3] = w, x, y, z


@inlined
def _least_axis(x, y, z):
    """The axis along which a vector is smallest."""
    a, b, c = abs(x), abs(y), abs(z)
    ax = ay = az = 0.0
    if a <= b and a <= c:
        ax = 1.0
    elif b <= c:
        ay = 1.0
    else:
        az = 1.0
    return ax, ay, az


@inlined
def _cross(ax, ay, az, bx, by, bz):
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@inlined
def _across(vx, vy, vz, dx, dy, dz):
    """The unit part of a vector across a unit direction; where there is none, of the axis least along it."""
    along = vx * dx + vy * dy + vz * dz
    x, y, z = vx - along * dx, vy - along * dy, vz - along * dz
    length = math.sqrt(x * x + y * y + z * z)
    if length <= 4 * EPS * math.sqrt(vx * vx + vy * vy + vz * vz):
        ax, ay, az = _least_axis(dx, dy, dz)
        along = ax * dx + ay * dy + az * dz
        x, y, z = ax - along * dx, ay - along * dy, az - along * dz
        length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


# --- look-at ----------------------------------------------------------------------------------------------------------------


@inlined
def _between_vectors(ax, ay, az, bx, by, bz):
    """The shortest rotation between two directions, as `keypose.math.quat.from_two_vectors`."""
    w, x, y, z = 1.0, 0.0, 0.0, 0.0
    la, lb = math.sqrt(ax * ax + ay * ay + az * az), math.sqrt(bx * bx + by * by + bz * bz)
    if la > 0 and lb > 0:
        ax, ay, az, bx, by, bz = ax / la, ay / la, az / la, bx / lb, by / lb, bz / lb
        sx, sy, sz = ax + bx, ay + by, az + bz
        obtuse = ax * bx + ay * by + az * bz < 0
        if obtuse:
            x, y, z = _cross(ax, ay, az, sx, sy, sz)
        else:
            x, y, z = _cross(ax, ay, az, bx - ax, by - ay, bz - az)
        w = 0.5 * (sx * sx + sy * sy + sz * sz)
        if obtuse and x * x + y * y + z * z <= 16 * EPS * EPS:
            w = 0.0
            ox, oy, oz = _least_axis(ax, ay, az)
            x, y, z = _across(ox, oy, oz, ax, ay, az)
        length = math.sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w / length, x / length, y / length, z / length
    return w, x, y, z


@kernel
def look(h, p, data, numbers, tx, ty, tz, weight):
    """Turn a chain of joints until the last one faces a target. Data: the chain's length, its members, then the path."""
    settle_here(h, p)
    words, reals, links, padded = int64_at(h[WORDS]), float64_at(h[REALS]), float64_at(h[CHAIN]), h[PADDED]
    row = float32_at(room_of(h, p))
    count = words[data]
    path = data + 1 + count
    head = words[data + count]
    limit, fx, fy, fz = reals[numbers], reals[numbers + 1], reals[numbers + 2], reals[numbers + 3]
    left = 0.0
    for i in range(count):
        left += reals[numbers + 4 + i]
    rest_angle, first = -1.0, 0
    for i in range(count):
        share = reals[numbers + 4 + i]
        if share == 0:
            continue
        _walk(h, row, path, first)
        w, x, y, z = _turn_of(links, head)
        ax, ay, az = quat_rotate(w, x, y, z, fx, fy, fz)
        px, py, pz = _place_of(links, head)
        sw, sx, sy, sz = _between_vectors(ax, ay, az, tx - px, ty - py, tz - pz)
        n = math.sqrt(sx * sx + sy * sy + sz * sz)
        angle = 2.0 * math.atan2(n, abs(sw))
        if rest_angle < 0:
            rest_angle = angle - min(angle, limit) * weight
        wanted = max(angle - rest_angle, 0.0) * share / left
        left -= share
        if wanted > 0 and n > 0:
            s = math.sin(0.5 * wanted) / n
            own = words[data + 1 + i]
            w, x, y, z = _turn_of(links, own)
            w, x, y, z = quat_multiply(math.cos(0.5 * wanted), s * sx, s * sy, s * sz, w, x, y, z)
            _set_world(links, row, words, path, padded, own, w, x, y, z)
            first = own


# --- limbs ------------------------------------------------------------------------------------------------------------------


@inlined
def _from_entries(a, b, c, d, e, f, g, k, i):
    """The quaternion of a rotation matrix. Source: Shepperd, Quaternion from Rotation Matrix (1978)."""
    t = a + e + i
    if t >= a and t >= e and t >= i:
        w, x, y, z = 1 + t, k - f, c - g, d - b
    elif a >= e and a >= i:
        w, x, y, z = k - f, 1 + a - e - i, b + d, c + g
    elif e >= i:
        w, x, y, z = c - g, b + d, 1 - a + e - i, f + k
    else:
        w, x, y, z = d - b, c + g, f + k, 1 - a - e + i
    length = math.sqrt(w * w + x * x + y * y + z * z)
    return w / length, x / length, y / length, z / length


@inlined
def _between_frames(ax, ay, az, anx, any_, anz, bx, by, bz, bnx, bny, bnz):
    """The rotation that carries a bone exactly onto another, and one normal as near as that allows."""
    la, lb = math.sqrt(ax * ax + ay * ay + az * az), math.sqrt(bx * bx + by * by + bz * bz)
    ax, ay, az, bx, by, bz = ax / la, ay / la, az / la, bx / lb, by / lb, bz / lb
    anx, any_, anz = _across(anx, any_, anz, ax, ay, az)
    bnx, bny, bnz = _across(bnx, bny, bnz, bx, by, bz)
    acx, acy, acz = _cross(ax, ay, az, anx, any_, anz)
    bcx, bcy, bcz = _cross(bx, by, bz, bnx, bny, bnz)
    return _from_entries(
        bx * ax + bnx * anx + bcx * acx, bx * ay + bnx * any_ + bcx * acy, bx * az + bnx * anz + bcx * acz,
        by * ax + bny * anx + bcy * acx, by * ay + bny * any_ + bcy * acy, by * az + bny * anz + bcy * acz,
        bz * ax + bnz * anx + bcz * acx, bz * ay + bnz * any_ + bcz * acy, bz * az + bnz * anz + bcz * acz,
    )  # fmt: skip


@inlined
def _change_between(links, row, words, path, padded, above, to):
    """Walk the rotations between two changed joints, whose local ones stay."""
    for n in range(above + 1, to):
        up = words[path + PATH + 2 * n + 1]
        # Only joints on the way: their parents are the changed joint or on the way themselves.
        if up >= above:
            j = words[path + PATH + 2 * n]
            uw, ux, uy, uz = _turn_of(links, up)
            w, x, y, z = quat_multiply(
                uw,
                ux,
                uy,
                uz,
                float(row[j]),
                float(row[padded + j]),
                float(row[2 * padded + j]),
                float(row[3 * padded + j]),
            )
            o = n * LINK
            links[o], links[o + 1], links[o + 2], links[o + 3] = w, x, y, z


@kernel
def _solve_limb(h, row, path, upper, middle, end, softness, bends, gx, gy, gz, down, fw, fx, fy, fz):
    """Bring a limb's end to a goal and give it a facing; the limb keeps bending the way it bends. ``down``: how far all sank."""
    words, links, padded = int64_at(h[WORDS]), float64_at(h[CHAIN]), h[PADDED]
    sx, sy, sz = _place_of(links, upper)
    mx, my, mz = _place_of(links, middle)
    ex, ey, ez = _place_of(links, end)
    sy, my, ey = sy - down, my - down, ey - down
    ux, uy, uz, lx, ly, lz = mx - sx, my - sy, mz - sz, ex - mx, ey - my, ez - mz
    first, second = math.sqrt(ux * ux + uy * uy + uz * uz), math.sqrt(lx * lx + ly * ly + lz * lz)
    if not (first > 0 and second > 0):
        return
    nx, ny, nz = ex - sx, ey - sy, ez - sz
    squared = nx * nx + ny * ny + nz * nz
    along = (ux * nx + uy * ny + uz * nz) / max(squared, 1e-30)
    px, py, pz = ux - nx * along, uy - ny * along, uz - nz * along
    reach = first + second
    reals = float64_at(h[REALS])
    w, x, y, z = _turn_of(links, upper)
    bx, by, bz = quat_rotate(w, x, y, z, reals[bends], reals[bends + 1], reals[bends + 2])
    px, py, pz = px + BIAS * reach * bx, py + BIAS * reach * by, pz + BIAS * reach * bz
    soft = min(softness, max(reach - math.sqrt(squared), 0.0))
    # As `keypose.ik.solve_limb`.
    dx, dy, dz = gx - sx, gy - sy, gz - sz
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    if distance > 0:
        dx, dy, dz = dx / distance, dy / distance, dz / distance
    else:
        dx, dy, dz = _least_axis(px, py, pz)
    used = distance
    if soft > 0 and distance > reach - soft:
        used = reach - soft + soft * (1 - math.exp(-(distance - reach + soft) / soft))
    used = min(max(used, abs(first - second)), reach)
    cosine = (first * first + used * used - second * second) / (2 * first * used) if used > 0 else 0.0
    cosine = min(max(cosine, -1.0), 1.0)
    sine = math.sqrt(1 - cosine * cosine)
    ax, ay, az = _across(px, py, pz, dx, dy, dz)
    cx, cy, cz = first * (cosine * dx + sine * ax), first * (cosine * dy + sine * ay), first * (cosine * dz + sine * az)
    rx, ry, rz = _cross(dx, dy, dz, ax, ay, az)
    kx, ky, kz = _cross(nx, ny, nz, px, py, pz)
    if not (kx != 0 or ky != 0 or kz != 0):
        kx, ky, kz = rx, ry, rz
    if kx * rx + ky * ry + kz * rz < 0:
        kx, ky, kz = -kx, -ky, -kz
    qw, qx, qy, qz = _between_frames(ux, uy, uz, kx, ky, kz, cx, cy, cz, rx, ry, rz)
    tw, tx, ty, tz = _between_frames(lx, ly, lz, kx, ky, kz, used * dx - cx, used * dy - cy, used * dz - cz, rx, ry, rz)
    w, x, y, z = _turn_of(links, upper)
    w, x, y, z = quat_multiply(qw, qx, qy, qz, w, x, y, z)
    vw, vx, vy, vz = _turn_of(links, middle)
    vw, vx, vy, vz = quat_multiply(tw, tx, ty, tz, vw, vx, vy, vz)
    _set_world(links, row, words, path, padded, upper, w, x, y, z)
    _change_between(links, row, words, path, padded, upper, middle)
    _set_world(links, row, words, path, padded, middle, vw, vx, vy, vz)
    _change_between(links, row, words, path, padded, middle, end)
    _set_world(links, row, words, path, padded, end, fw, fx, fy, fz)


@kernel
def reach(h, p, data, numbers, tx, ty, tz, weight):
    """Bring the end of a limb to a target. Data: upper, middle and end, then the path; numbers: softness, bend."""
    settle_here(h, p)
    words, links = int64_at(h[WORDS]), float64_at(h[CHAIN])
    row = float32_at(room_of(h, p))
    path, end = data + 3, words[data + 2]
    _walk(h, row, path, 0)
    ex, ey, ez = _place_of(links, end)
    w, x, y, z = _turn_of(links, end)
    _solve_limb(
        h, row, path, words[data], words[data + 1], end, float64_at(h[REALS])[numbers], numbers + 1,
        ex + weight * (tx - ex), ey + weight * (ty - ey), ez + weight * (tz - ez), 0.0, w, x, y, z,
    )  # fmt: skip


@inlined
def _goal(links, row, words, reals, foot, floor, places, turns, weight):
    """Where the end of a foot's limb goes, and its facing."""
    contact, joint, end = words[foot], words[foot + 1], words[foot + 4]
    jx, jy, jz = _place_of(links, joint)
    ex, ey, ez = _place_of(links, end)
    wx, wy, wz = (
        float(row[places + 3 * contact]),
        float(row[places + 3 * contact + 1]),
        float(row[places + 3 * contact + 2]),
    )
    wy = max(wy, reals[floor])
    half = 0.5 * weight * float(row[turns + contact])
    tw, ty = math.cos(half), math.sin(half)
    ox, oy, oz = quat_rotate(tw, 0.0, ty, 0.0, ex - jx, ey - jy, ez - jz)
    w, x, y, z = _turn_of(links, end)
    w, x, y, z = quat_multiply(tw, 0.0, ty, 0.0, w, x, y, z)
    return jx + weight * (wx - jx) + ox, jy + weight * (wy - jy) + oy, jz + weight * (wz - jz) + oz, w, x, y, z


@kernel
def plant(h, p, data, numbers, weight):
    """Move feet to where their contacts say. Data: feet; per foot contact, joint, upper, middle, end; then the path.

    Numbers: per foot the floor, then where it bends.
    """
    settle_here(h, p)
    words, reals, links = int64_at(h[WORDS]), float64_at(h[REALS]), float64_at(h[CHAIN])
    row = float32_at(room_of(h, p))
    feet = words[data]
    path = data + 1 + 5 * feet
    places = h[POSE] - h[EXTRAS] + h[CURVES]
    turns = places + 4 * h[EFFECTORS]
    _walk(h, row, path, 0)
    sink = 0.0
    for n in range(feet):
        foot = data + 1 + 5 * n
        gx, gy, gz, _, _, _, _ = _goal(links, row, words, reals, foot, numbers + 4 * n, places, turns, weight)
        sx, sy, sz = _place_of(links, words[foot + 2])
        mx, my, mz = _place_of(links, words[foot + 3])
        ex, ey, ez = _place_of(links, words[foot + 4])
        first = math.sqrt((mx - sx) ** 2 + (my - sy) ** 2 + (mz - sz) ** 2)
        second = math.sqrt((ex - mx) ** 2 + (ey - my) ** 2 + (ez - mz) ** 2)
        length = REACH * (first + second)
        across = math.hypot(gx - sx, gz - sz)
        if across < length:
            sink = max(sink, sy - gy - math.sqrt(length * length - across * across))
    if sink > 0:
        c = int64_at(h[CLIP_HANDLES])
        parents = int64_at(h[PARENTS])
        for j in range(h[JOINTS]):
            if parents[j] < 0:
                group = int64_at(c[clips.MOVED_AT])[j // clips.GROUP]
                row[4 * h[PADDED] + c[clips.MOVED] + group + j % clips.GROUP] -= sink
    for n in range(feet):
        foot = data + 1 + 5 * n
        gx, gy, gz, w, x, y, z = _goal(links, row, words, reals, foot, numbers + 4 * n, places, turns, weight)
        _solve_limb(
            h, row, path, words[foot + 2], words[foot + 3], words[foot + 4], 0.0, numbers + 4 * n + 1, gx, gy, gz, sink, w, x, y, z
        )  # fmt: skip
