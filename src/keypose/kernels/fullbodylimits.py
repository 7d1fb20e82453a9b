# pyright: basic
"""Limits in the full-body solver: joints brought inside, bounds that block, joints forced to go just to a bound.

Most joints stand well inside their limits, which all lanes are asked at once; the rest is done one solve at a time.
"""

from __future__ import annotations

import numpy as np

from keypose.kernels.fullbodytables import (
    BEST,
    BEST_SIDE,
    BOUND,
    CONE,
    EDGE,
    FORCED,
    HINGE,
    J_PARENT,
    J_PRIOR,
    JOINT_COLUMNS,
    L_HOME,
    L_I,
    L_J,
    L_JOINT,
    L_K,
    L_KIND,
    LIMIT_COLUMNS,
    LIMIT_NUMBERS,
    MOMENT,
    NEAR,
    NORMALS,
    PLACE,
    PRIOR_PULL,
    PULL,
    SAME,
    SIDE,
    SLOTS,
    STEP,
    TURN,
)
from keypose.kernels.fullbodytasks import cross
from keypose.kernels.rotations import load4, quat_multiply, quat_rotate
from keypose.kernels.runtime import inlined, kernel
from keypose.kernels.vectors import absolute, maximum, store


@kernel
def _wrapped(angle):
    return angle - 2.0 * np.pi * np.floor((angle + np.pi) / (2.0 * np.pi))


@kernel
def _held(angle, low, high):
    """The allowed angle next to one, and at which end of the range it stands (2: the range is one point)."""
    if high - low >= 2.0 * np.pi - 1e-12:
        return angle, 0.0
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    around = _wrapped(angle - middle)
    side = 2.0 if half < BOUND else 1.0 if around > half - BOUND else -1.0 if around < BOUND - half else 0.0
    if -half <= around <= half:
        return angle, side
    return middle + min(max(around, -half), half), side


@kernel
def _hold_hinge(a, b, c, d, table):
    """Axis 0-2, range 3 4."""
    x, y, z = table[0], table[1], table[2]
    angle, side = _held(2.0 * np.arctan2(b * x + c * y + d * z, a), table[3], table[4])
    sine = np.sin(0.5 * angle)
    return np.cos(0.5 * angle), sine * x, sine * y, sine * z, side, 2.0, 2.0


@kernel
def _hold_cone(a, b, c, d, table):
    """Axis 0-2, axes of the swing 3-5 and 6-8, their radii 9 10, twist 11 12."""
    if a < 0.0:
        a, b, c, d = -a, -b, -c, -d
    x, y, z = table[0], table[1], table[2]
    along = b * x + c * y + d * z
    norm = np.sqrt(a * a + along * along)
    tw, ts = 1.0, 0.0
    if norm > 1e-15:
        tw, ts = a / norm, along / norm
    e, f, g, h = quat_multiply(a, b, c, d, tw, -ts * x, -ts * y, -ts * z)  # the swing
    if e < 0.0:
        e, f, g, h = -e, -f, -g, -h
    twist, side = _held(_wrapped(2.0 * np.arctan2(ts, tw)), table[11], table[12])
    first, second = f * table[3] + g * table[4] + h * table[5], f * table[6] + g * table[7] + h * table[8]
    sine = np.sqrt(first * first + second * second)
    scale = 2.0 if sine < 1e-12 else 2.0 * np.arctan2(sine, e) / sine
    first, second = scale * first, scale * second
    reach = np.sqrt((first / table[9]) ** 2 + (second / table[10]) ** 2)
    swung = 1.0 if reach > 1.0 - BOUND and max(table[9], table[10]) < np.pi else 0.0
    if reach > 1.0:
        first, second = first / reach, second / reach
    half = 0.5 * np.sqrt(first * first + second * second)
    ratio = 0.5 if half < 1e-12 else 0.5 * np.sin(half) / half
    f = ratio * (first * table[3] + second * table[6])
    g = ratio * (first * table[4] + second * table[7])
    h = ratio * (first * table[5] + second * table[8])
    tw, ts = np.cos(0.5 * twist), np.sin(0.5 * twist)
    a, b, c, d = quat_multiply(np.cos(half), f, g, h, tw, ts * x, ts * y, ts * z)
    return a, b, c, d, side, swung, 0.0


@inlined
def _about(axis, angle):
    sine = np.sin(0.5 * angle)
    return np.cos(0.5 * angle), sine if axis == 0 else 0.0, sine if axis == 1 else 0.0, sine if axis == 2 else 0.0


@kernel
def _angles_of(a, b, c, d, table, i, j, k):
    """Turns about three different axes i, j, k (0-2) one after the other: the triple that is less outside its ranges.

    Source: Bernardes and Viollet, Quaternion to Euler angles conversion (2022).
    """
    parity = 1.0 if (j - i) % 3 == 1 else -1.0
    qi = b if i == 0 else c if i == 1 else d
    qj = b if j == 0 else c if j == 1 else d
    qk = parity * (b if k == 0 else c if k == 1 else d)
    px, py, mx, my = a + qj, qi + qk, a - qj, qi - qk
    plus, minus = np.sqrt(px * px + py * py), np.sqrt(mx * mx + my * my)
    middle = np.arctan2(2.0 * (a * qj + qi * qk), plus * minus)
    half_sum = 0.0 if plus < 1e-14 else np.arctan2(py, px)
    half_gap = 0.0 if minus < 1e-14 else np.arctan2(my, mx)
    if plus < 1e-14 or minus < 1e-14:  # locked: the third angle is 0
        first, third = 2.0 * (half_sum + half_gap), 0.0
    else:
        first, third = half_sum + half_gap, parity * (half_sum - half_gap)
    best0, best1, best2, least = first, middle, third, 1e300
    for turn in range(2):
        if turn == 1:
            first, middle, third = first + np.pi, np.pi - middle, third + np.pi
        held, _ = _held(_wrapped(first), table[0], table[1])
        over = abs(_wrapped(held - first))
        held, _ = _held(_wrapped(middle), table[2], table[3])
        over += abs(_wrapped(held - middle))
        held, _ = _held(_wrapped(third), table[4], table[5])
        over += abs(_wrapped(held - third))
        if over < least - 1e-9:
            least, best0, best1, best2 = over, first, middle, third
    return best0, best1, best2


@kernel
def _hold_angles(a, b, c, d, table, i, j, k):
    """Three ranges 0-5; of both triples the one whose allowed rotation is nearer."""
    first, middle, third = _angles_of(a, b, c, d, table, i, j, k)
    near, ra, rb, rc, rd, t0, t1, t2 = -1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for turn in range(2):
        if turn == 1:
            first, middle, third = first + np.pi, np.pi - middle, third + np.pi
        x, s0 = _held(_wrapped(first), table[0], table[1])
        y, s1 = _held(_wrapped(middle), table[2], table[3])
        z, s2 = _held(_wrapped(third), table[4], table[5])
        e, f, g, h = _about(i, x)
        p, q, r, s = _about(j, y)
        e, f, g, h = quat_multiply(e, f, g, h, p, q, r, s)
        p, q, r, s = _about(k, z)
        e, f, g, h = quat_multiply(e, f, g, h, p, q, r, s)
        cosine = abs(a * e + b * f + c * g + d * h)
        if cosine > near + 1e-14:
            near, ra, rb, rc, rd, t0, t1, t2 = cosine, e, f, g, h, s0, s1, s2
    return ra, rb, rc, rd, t0, t1, t2


@kernel
def _spare_of_cone(row, q, home, table, n, near):
    """How far each solve's joint surely is from its bounds, in no unit; not above 0 where it must be looked at."""
    a, b, c, d = load4(row, q, n)
    e, f, g, h = load4(row, home, n)
    a, b, c, d = quat_multiply(e, 0.0 - f, 0.0 - g, 0.0 - h, a, b, c, d)
    along = b * table[0] + c * table[1] + d * table[2]
    swing = a * a + along * along - table[13]
    twist = table[14] * absolute(a) - absolute(along)
    store(row, near, 0.0 - maximum(0.0 - swing, 0.0 - twist))


@kernel
def hold_inside(limits, numbers, limit, row, q, data, work, near, n, active):
    """Bring one joint of every solve inside its limit and note at which bounds it stands; whether any was outside."""
    at = limit * LIMIT_COLUMNS
    kind, joint = limits[at + L_KIND], limits[at + L_JOINT]
    home, q, side = data + limits[at + L_HOME] * n, q + 4 * joint * n, work + (joint * SLOTS + SIDE) * n
    table = numbers[limit * LIMIT_NUMBERS : (limit + 1) * LIMIT_NUMBERS]
    found = False
    if kind == CONE:
        _spare_of_cone(row, q, home, table, n, near)
    for k in range(n):
        if active[k] == 0.0:
            continue
        if kind == CONE and row[near + k] > 0.0:
            row[side + k], row[side + n + k], row[side + 2 * n + k] = 0.0, 0.0, 0.0
            continue
        a, b, c, d = row[q + k], row[q + n + k], row[q + 2 * n + k], row[q + 3 * n + k]
        e, f, g, h = row[home + k], row[home + n + k], row[home + 2 * n + k], row[home + 3 * n + k]
        r, s, t, u = quat_multiply(e, -f, -g, -h, a, b, c, d)
        if kind == CONE:
            x, y, z, v, s0, s1, s2 = _hold_cone(r, s, t, u, table)
        elif kind == HINGE:
            x, y, z, v, s0, s1, s2 = _hold_hinge(r, s, t, u, table)
        else:
            i, j, m = limits[at + L_I], limits[at + L_J], limits[at + L_K]
            x, y, z, v, s0, s1, s2 = _hold_angles(r, s, t, u, table, i, j, m)
        row[side + k], row[side + n + k], row[side + 2 * n + k] = s0, s1, s2
        sign = 1.0 if r * x + s * y + t * z + u * v >= 0.0 else -1.0
        away = max(max(abs(x - sign * r), abs(y - sign * s)), max(abs(z - sign * t), abs(v - sign * u)))
        if away > 1e-15:
            x, y, z, v = quat_multiply(e, f, g, h, x, y, z, v)
            norm = 1.0 / np.sqrt(x * x + y * y + z * z + v * v)
            row[q + k], row[q + n + k] = x * norm, y * norm
            row[q + 2 * n + k], row[q + 3 * n + k] = z * norm, v * norm
            found = True
    return found


@kernel
def find_normals(joints, limits, numbers, limit, row, q, data, work, n, found):
    """The directions that bounds block now: those at which the joint stands and which it is pulled against."""
    joint = limits[limit * LIMIT_COLUMNS + L_JOINT]
    w = work + joint * SLOTS * n
    side, out = w + SIDE * n, w + NORMALS * n
    for k in range(n):
        for m in range(9):
            row[out + m * n + k] = 0.0
        for m in range(6):
            row[w + (EDGE + m) * n + k] = 0.0
        if row[side + k] == 0.0 and row[side + n + k] == 0.0 and row[side + 2 * n + k] == 0.0:
            continue
        _directions(joints, limits, numbers, limit, row, q + 4 * joint * n, data, work, n, k, found)
        gx, gy, gz = _gradient(joints, joint, row, w, n, k)
        if limits[limit * LIMIT_COLUMNS + L_KIND] == CONE:
            first, second = _cone_pulls(row[side + k], row[side + n + k], found, gx, gy, gz)
            if first:
                _block(row, out, n, k, found[0], found[1], found[2])
            if second > 0.0:
                _block(row, out, n, k, found[3], found[4], found[5])
                _edge_of_cone(
                    limits, numbers, limit, row, q + 4 * joint * n, data, w, n, k, second, found[3], found[4], found[5]
                )
            continue
        for m in range(3):
            bound = row[side + m * n + k]
            x, y, z = found[3 * m], found[3 * m + 1], found[3 * m + 2]
            if bound == 2.0 or (x * gx + y * gy + z * gz) * bound < 0.0:
                _block(row, out, n, k, x, y, z)


@kernel
def _gradient(joints, joint, row, w, n, k):
    """Of one solve: what the cost grows by with a joint's turn, by all tasks and its prior."""
    px, py, pz = row[w + PLACE * n + k], row[w + (PLACE + 1) * n + k], row[w + (PLACE + 2) * n + k]
    fx, fy, fz = row[w + PULL * n + k], row[w + (PULL + 1) * n + k], row[w + (PULL + 2) * n + k]
    gx, gy, gz = cross(px, py, pz, fx, fy, fz)
    gx, gy = row[w + MOMENT * n + k] - gx, row[w + (MOMENT + 1) * n + k] - gy
    gz = row[w + (MOMENT + 2) * n + k] - gz
    if joints[joint * JOINT_COLUMNS + J_PRIOR]:
        gx, gy = gx + row[w + PRIOR_PULL * n + k], gy + row[w + (PRIOR_PULL + 1) * n + k]
        gz = gz + row[w + (PRIOR_PULL + 2) * n + k]
    return gx, gy, gz


@kernel
def _cone_pulls(twist, swing, found, gx, gy, gz):
    """Whether the bound of the twist is in the way, and how hard a joint is pulled over that of the swing.

    Where it stands at both, they push back as much as keeps it from crossing either, and never pull.
    """
    x, y, z = found[0], found[1], found[2]
    scale = 1.0 / max(np.sqrt(x * x + y * y + z * z), 1e-300)
    scale = 0.0 - scale if twist < 0.0 else scale
    x, y, z = scale * x, scale * y, scale * z
    first, second = 0.0 - (x * gx + y * gy + z * gz), 0.0 - (found[3] * gx + found[4] * gy + found[5] * gz)
    both = x * found[3] + y * found[4] + z * found[5]
    if twist == 0.0 or swing == 0.0:
        return twist == 2.0 or (twist != 0.0 and first > 0.0), second if swing != 0.0 else 0.0
    rest = second - both * first
    if rest > 0.0 and (twist == 2.0 or first > both * second):
        return True, rest / max(1.0 - both * both, 1e-6)
    if twist == 2.0 or (first > 0.0 and rest <= 0.0):
        return True, 0.0
    return False, second


@kernel
def _edge_of_cone(limits, numbers, limit, row, q, data, w, n, k, pull, nx, ny, nz):
    """How a joint that is pulled over the edge of its cone stiffens; see `keypose.ik.fullbody_limits`."""
    at = limit * LIMIT_COLUMNS
    home, q = data + limits[at + L_HOME] * n + k, q + k
    table = numbers[limit * LIMIT_NUMBERS : (limit + 1) * LIMIT_NUMBERS]
    a, b, c, d = quat_multiply(
        row[home], -row[home + n], -row[home + 2 * n], -row[home + 3 * n],
        row[q], row[q + n], row[q + 2 * n], row[q + 3 * n],
    )  # fmt: skip
    x, y, z, cos, sin, sine, angle, by_angle, by_way, shape, apart = _swing_of(a, b, c, d, table)
    if sine < 1e-6:
        return
    cosine = x * table[0] + y * table[1] + z * table[2]
    steep = np.sqrt(by_angle * by_angle + by_way * by_way)
    along, around = 0.0 - by_way / steep, by_angle / (steep * sine)
    bent = 2.0 * shape * along * along + 8.0 * angle * sin * cos * apart * along * around
    bent += 2.0 * angle * angle * (cos * cos - sin * sin) * apart * around * around
    bent += by_angle * sine * cosine * around * around - 2.0 * by_way * cosine * along * around
    bent *= pull / steep
    turn, half = w + TURN * n + k, 0.5 * pull
    x, y, z = quat_rotate(row[turn], row[turn + n], row[turn + 2 * n], row[turn + 3 * n], table[0], table[1], table[2])
    u, v, t = cross(x, y, z, nx, ny, nz)
    edge = w + EDGE * n + k
    row[edge] = bent * u * u - 2.0 * half * u * x
    row[edge + n] = bent * u * v - half * (u * y + v * x)
    row[edge + 2 * n] = bent * u * t - half * (u * z + t * x)
    row[edge + 3 * n] = bent * v * v - 2.0 * half * v * y
    row[edge + 4 * n] = bent * v * t - half * (v * z + t * y)
    row[edge + 5 * n] = bent * t * t - 2.0 * half * t * z


@kernel
def _directions(joints, limits, numbers, limit, row, q, data, work, n, k, found):
    """Of one solve: the directions of a joint's bounds where it is turned as ``q`` says, in the model's space."""
    at = limit * LIMIT_COLUMNS
    kind, joint = limits[at + L_KIND], limits[at + L_JOINT]
    home = data + limits[at + L_HOME] * n
    p = joints[joint * JOINT_COLUMNS + J_PARENT]
    table = numbers[limit * LIMIT_NUMBERS : (limit + 1) * LIMIT_NUMBERS]
    a, b, c, d = row[q + k], row[q + n + k], row[q + 2 * n + k], row[q + 3 * n + k]
    e, f, g, h = row[home + k], row[home + n + k], row[home + 2 * n + k], row[home + 3 * n + k]
    a, b, c, d = quat_multiply(e, -f, -g, -h, a, b, c, d)
    found[:] = 0.0
    if kind == HINGE:
        _normals_of_hinge(table, found)
    elif kind == CONE:
        _normals_of_cone(a, b, c, d, table, found)
    else:
        _normals_of_angles(a, b, c, d, table, limits[at + L_I], limits[at + L_J], limits[at + L_K], found)
    for m in range(0, 9, 3):
        x, y, z = quat_rotate(e, f, g, h, found[m], found[m + 1], found[m + 2])
        if p >= 0:
            up = work + (p * SLOTS + TURN) * n + k
            x, y, z = quat_rotate(row[up], row[up + n], row[up + 2 * n], row[up + 3 * n], x, y, z)
        found[m], found[m + 1], found[m + 2] = x, y, z


@kernel
def _block(row, out, n, k, x, y, z):
    """Add a direction to those of one solve that are blocked, as far as it is across them: which, and how far it is."""
    scale = 1.0 / max(np.sqrt(x * x + y * y + z * z), 1e-300)
    x, y, z = scale * x, scale * y, scale * z
    free = -1
    for m in range(3):
        place = out + 3 * m * n + k
        u, v, t = row[place], row[place + n], row[place + 2 * n]
        if u == 0.0 and v == 0.0 and t == 0.0:
            free = m if free < 0 else free
        along = x * u + y * v + z * t
        x, y, z = x - along * u, y - along * v, z - along * t
    length = np.sqrt(x * x + y * y + z * z)
    if free >= 0 and length > SAME:
        place = out + 3 * free * n + k
        row[place], row[place + n], row[place + 2 * n] = x / length, y / length, z / length
        return free, length
    return -1, 0.0


@kernel
def _normals_of_hinge(table, found):
    x, y, z = table[0], table[1], table[2]
    found[0], found[1], found[2] = x, y, z
    small = 0 if abs(x) <= abs(y) and abs(x) <= abs(z) else 1 if abs(y) <= abs(z) else 2
    a, b, c = cross(x, y, z, 1.0 if small == 0 else 0.0, 1.0 if small == 1 else 0.0, 1.0 if small == 2 else 0.0)
    found[3], found[4], found[5] = a, b, c
    a, b, c = cross(x, y, z, a, b, c)
    found[6], found[7], found[8] = a, b, c


@inlined
def _swing_of(a, b, c, d, table):
    """Where the axis of a cone's joint points, the way there, its sine and angle; what is bounded, angle^2 shape, by its
    slope along the angle and around over the sine; shape and the difference of its ends.
    """
    px, py, pz = quat_rotate(a, b, c, d, table[0], table[1], table[2])
    first = px * table[3] + py * table[4] + pz * table[5]
    second = px * table[6] + py * table[7] + pz * table[8]
    sine = np.sqrt(first * first + second * second)
    angle = np.arctan2(sine, px * table[0] + py * table[1] + pz * table[2])
    safe = max(sine, 1e-12)
    cos, sin = first / safe, second / safe
    ra, rb = 1.0 / (table[9] * table[9]), 1.0 / (table[10] * table[10])
    shape = sin * sin * ra + cos * cos * rb
    turning = 2.0 * angle * angle * sin * cos * (ra - rb) / safe
    return px, py, pz, cos, sin, sine, angle, 2.0 * angle * shape, turning, shape, ra - rb


@kernel
def _normals_of_cone(a, b, c, d, table, found):
    """The gradients of twist and swing; see `keypose.ik.fullbody_limits`."""
    x, y, z = table[0], table[1], table[2]
    along = b * x + c * y + d * z
    size = max(a * a + along * along, 1e-300)
    ux, uy, uz = cross(x, y, z, b, c, d)
    ux, uy, uz = a * (a * x + ux) + along * b, a * (a * y + uy) + along * c, a * (a * z + uz) + along * d
    ux, uy, uz = quat_rotate(a, b, c, d, ux / size, uy / size, uz / size)
    found[0], found[1], found[2] = ux, uy, uz
    px, py, pz, cos, sin, _, _, slope, turning, _, _ = _swing_of(a, b, c, d, table)
    ax, ay, az = cos * table[6] - sin * table[3], cos * table[7] - sin * table[4], cos * table[8] - sin * table[5]
    vx, vy, vz = cross(px, py, pz, ax, ay, az)
    vx, vy, vz = slope * ax + turning * vx, slope * ay + turning * vy, slope * az + turning * vz
    length = np.sqrt(vx * vx + vy * vy + vz * vz)
    if length > 1e-9:
        found[3], found[4], found[5] = vx / length, vy / length, vz / length


@kernel
def _normals_of_angles(a, b, c, d, table, i, j, k, found):
    """Across the axes of the other two angles."""
    first, _, _ = _angles_of(a, b, c, d, table, i, j, k)
    rx, ry, rz = 1.0 if i == 0 else 0.0, 1.0 if i == 1 else 0.0, 1.0 if i == 2 else 0.0
    e, f, g, h = _about(i, first)
    sx, sy, sz = quat_rotate(e, f, g, h, 1.0 if j == 0 else 0.0, 1.0 if j == 1 else 0.0, 1.0 if j == 2 else 0.0)
    tx, ty, tz = quat_rotate(a, b, c, d, 1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)
    ux, uy, uz = cross(sx, sy, sz, tx, ty, tz)
    vx, vy, vz = cross(tx, ty, tz, rx, ry, rz)
    wx, wy, wz = cross(rx, ry, rz, sx, sy, sz)
    sign = 1.0 if wx * tx + wy * ty + wz * tz > 0.0 else -1.0
    if ux * ux + uy * uy + uz * uz > 1e-12:
        found[0], found[1], found[2] = sign * ux, sign * uy, sign * uz
    if vx * vx + vy * vy + vz * vz > 1e-12:
        found[3], found[4], found[5] = sign * vx, sign * vy, sign * vz
    if wx * wx + wy * wy + wz * wz > 1e-12:
        found[6], found[7], found[8] = sign * wx, sign * wy, sign * wz


@kernel
def force_to_bound(joints, limits, numbers, limit, row, q, data, work, n, active, sound, found):
    """Send a joint that its step carried over a bound just there, free along it; whether there is one."""
    joint = limits[limit * LIMIT_COLUMNS + L_JOINT]
    w, at = work + joint * SLOTS * n, q + 4 * joint * n
    p = joints[joint * JOINT_COLUMNS + J_PARENT]
    out, hit = w + NORMALS * n, False
    for k in range(n):
        side = w + SIDE * n + k
        if active[k] == 0.0 or row[sound + k] <= 0.0:  # a step that is none tells nothing of bounds
            continue
        if row[side] == 0.0 and row[side + n] == 0.0 and row[side + 2 * n] == 0.0:
            continue
        a, b, c, d = row[at + k], row[at + n + k], row[at + 2 * n + k], row[at + 3 * n + k]
        best = w + BEST * n + k
        a, b, c, d = quat_multiply(a, b, c, d, row[best], -row[best + n], -row[best + 2 * n], -row[best + 3 * n])
        if a < 0.0:
            a, b, c, d = -a, -b, -c, -d
        scale = 2.0 / max(a, 1e-6)  # the inverse of how a step becomes a rotation
        x, y, z = scale * b, scale * c, scale * d
        if p >= 0:
            up = work + (p * SLOTS + TURN) * n + k
            x, y, z = quat_rotate(row[up], row[up + n], row[up + 2 * n], row[up + 3 * n], x, y, z)
        step = w + STEP * n + k
        ox, oy, oz = x - row[step], y - row[step + n], z - row[step + 2 * n]
        if np.sqrt(ox * ox + oy * oy + oz * oz) <= 0.1 * np.sqrt(x * x + y * y + z * z) + 1e-6:
            continue
        hit = True
        if _forced_to_near(joints, limits, numbers, limit, row, data, work, n, k, found):
            continue
        _directions(joints, limits, numbers, limit, row, at, data, work, n, k, found)
        for m in range(3):
            if row[side + m * n] != 0.0:
                _block(row, out, n, k, found[3 * m], found[3 * m + 1], found[3 * m + 2])
        place = w + FORCED * n + k
        for m in range(3):
            normal = out + 3 * m * n + k
            u, v, t = row[normal], row[normal + n], row[normal + 2 * n]
            along = x * u + y * v + z * t
            row[place] += along * u
            row[place + n] += along * v
            row[place + 2 * n] += along * t
    return hit


@kernel
def _forced_to_near(joints, limits, numbers, limit, row, data, work, n, k, found):
    """Of one solve: send a joint straight to the bounds that it met, if it stands close to them all; whether it does.

    Close to a bound that is curved, where a step came back inside says little of where it went out: bounds are taken as
    flat and curved as they are here.
    """
    at = limit * LIMIT_COLUMNS
    kind, joint = limits[at + L_KIND], limits[at + L_JOINT]
    w = work + joint * SLOTS * n
    side, best = w + SIDE * n + k, w + BEST * n
    _directions(joints, limits, numbers, limit, row, best, data, work, n, k, found)
    _rooms(limits, numbers, limit, row, best, data, n, k, row[side], row[side + n], row[side + 2 * n], found)
    for m in range(3):
        if row[side + m * n] != 0.0 and found[9 + m] > NEAR:
            return False
    if kind == CONE:
        before = w + BEST_SIDE * n + k
        first = row[before] if row[side] == 0.0 else row[side]
        second = row[before + n] if row[side + n] == 0.0 else row[side + n]
        gx, gy, gz = _gradient(joints, joint, row, w, n, k)
        _, pull = _cone_pulls(first, second, found, gx, gy, gz)
        for m in range(6):
            row[w + (EDGE + m) * n + k] = 0.0
        if pull > 0.0:
            _edge_of_cone(limits, numbers, limit, row, best, data, w, n, k, pull, found[3], found[4], found[5])
    place, out = w + FORCED * n + k, w + NORMALS * n
    for m in range(3):
        bound = row[side + m * n]
        if bound == 0.0:
            continue
        sign = -1.0 if bound < 0.0 else 1.0
        x, y, z = sign * found[3 * m], sign * found[3 * m + 1], sign * found[3 * m + 2]
        length = max(np.sqrt(x * x + y * y + z * z), 1e-300)
        x, y, z = x / length, y / length, z / length
        free, across = _block(row, out, n, k, x, y, z)
        if free >= 0:
            left = found[9 + m] - (x * row[place] + y * row[place + n] + z * row[place + 2 * n])
            normal, left = out + 3 * free * n + k, left / across
            row[place] += left * row[normal]
            row[place + n] += left * row[normal + n]
            row[place + 2 * n] += left * row[normal + 2 * n]
    return True


@kernel
def _rooms(limits, numbers, limit, row, q, data, n, k, first, second, third, found):
    """Of one solve: how far a joint may turn straight towards the ends of its ranges that it met, to found[9-11]."""
    at = limit * LIMIT_COLUMNS
    home = data + limits[at + L_HOME] * n + k
    table = numbers[limit * LIMIT_NUMBERS : (limit + 1) * LIMIT_NUMBERS]
    a, b, c, d = quat_multiply(
        row[home], -row[home + n], -row[home + 2 * n], -row[home + 3 * n],
        row[q + k], row[q + n + k], row[q + 2 * n + k], row[q + 3 * n + k],
    )  # fmt: skip
    found[9:] = 0.0
    if limits[at + L_KIND] == HINGE:
        angle = 2.0 * np.arctan2(b * table[0] + c * table[1] + d * table[2], a)
        found[9] = _room(angle, table[3], table[4], first)
    elif limits[at + L_KIND] == CONE:
        angle = 2.0 * np.arctan2(b * table[0] + c * table[1] + d * table[2], a)
        steep = np.sqrt(found[0] * found[0] + found[1] * found[1] + found[2] * found[2])
        found[9] = _room(angle, table[11], table[12], first) / max(steep, 1e-300)
        if second != 0.0:
            found[10] = _room_of_swing(a, b, c, d, table)
    else:
        i, j, m = limits[at + L_I], limits[at + L_J], limits[at + L_K]
        x, y, z = _angles_of(a, b, c, d, table, i, j, m)
        # A direction is as long as the volume of the three axes times how fast the angle grows along it.
        volume = found[3] * (found[7] * found[2] - found[8] * found[1])
        volume += found[4] * (found[8] * found[0] - found[6] * found[2])
        volume += found[5] * (found[6] * found[1] - found[7] * found[0])
        volume = np.sqrt(abs(volume))
        for e in range(3):
            length = np.sqrt(found[3 * e] ** 2 + found[3 * e + 1] ** 2 + found[3 * e + 2] ** 2)
            angle, side = x if e == 0 else y if e == 1 else z, first if e == 0 else second if e == 1 else third
            found[9 + e] = _room(angle, table[2 * e], table[2 * e + 1], side) * volume / max(length, 1e-300)


@kernel
def _room(angle, low, high, side):
    """From an angle to the end of its range that it met."""
    around, half = _wrapped(angle - 0.5 * (low + high)), 0.5 * (high - low)
    return 0.0 if side == 0.0 else half + around if side < 0.0 else half - around


@kernel
def _room_of_swing(a, b, c, d, table):
    """From where the axis of a cone's joint points to the edge, along the slope of what is bounded."""
    _, _, _, _, _, _, angle, slope, turning, shape, _ = _swing_of(a, b, c, d, table)
    return (1.0 - angle * angle * shape) / max(np.sqrt(slope * slope + turning * turning), 1e-12)
