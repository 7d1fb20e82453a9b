# pyright: basic
"""Limits in the full-body solver: joints brought inside, bounds that block, joints forced to go just to a bound.

Most joints stand well inside their limits, which all lanes are asked at once; the rest is done one solve at a time.
"""

from __future__ import annotations

import numpy as np

from keypose.kernels.fullbodytables import (
    BEST,
    BOUND,
    CONE,
    FORCED,
    HINGE,
    J_PARENT,
    J_PRIOR,
    JOINT_COLUMNS,
    KEEP,
    L_HOME,
    L_I,
    L_J,
    L_JOINT,
    L_K,
    L_KIND,
    LIMIT_COLUMNS,
    LIMIT_NUMBERS,
    MOMENT,
    NORMALS,
    PLACE,
    PRIOR_PULL,
    PULL,
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
    x, y, z = table[0], table[1], table[2]
    raw = 2.0 * np.arctan2(b * x + c * y + d * z, a)
    angle, side = _held(raw, table[3], table[4])
    sine = np.sin(0.5 * angle)
    return np.cos(0.5 * angle), sine * x, sine * y, sine * z, side, 2.0, 2.0


@kernel
def _hold_cone(a, b, c, d, table):
    """Axis 0-2, first across 3-5, second 6-8, radii 9 10, twist 11 12, cosines squared of half the swing that is surely
    inside 13, tangent of half such a twist 14."""
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
    swung = 1.0 if reach > 1.0 - BOUND and min(table[9], table[10]) < np.pi else 0.0
    if reach > 1.0:
        first, second = first / reach, second / reach
    half = 0.5 * np.sqrt(first * first + second * second)
    ratio = 0.5 if half < 1e-12 else 0.5 * np.sin(half) / half
    e, ts, tw = np.cos(half), np.sin(0.5 * twist), np.cos(0.5 * twist)
    f = ratio * (first * table[3] + second * table[6])
    g = ratio * (first * table[4] + second * table[7])
    h = ratio * (first * table[5] + second * table[8])
    a, b, c, d = quat_multiply(e, f, g, h, tw, ts * x, ts * y, ts * z)
    return a, b, c, d, side, swung, 0.0


@inlined
def _angle_about(axis, angle):
    sine = np.sin(0.5 * angle)
    return np.cos(0.5 * angle), sine if axis == 0 else 0.0, sine if axis == 1 else 0.0, sine if axis == 2 else 0.0


@kernel
def _angles_of(a, b, c, d, table, i, j, k):
    """Three different axes i, j, k (0-2) turned about one after the other; ranges in the table, low and high of each."""
    v0, v1, v2 = b, c, d
    parity = 1.0 if (j - i) % 3 == 1 else -1.0
    qi = v0 if i == 0 else v1 if i == 1 else v2
    qj = v0 if j == 0 else v1 if j == 1 else v2
    qk = parity * (v0 if k == 0 else v1 if k == 1 else v2)
    px, py, mx, my = a + qj, qi + qk, a - qj, qi - qk
    plus, minus = np.sqrt(px * px + py * py), np.sqrt(mx * mx + my * my)
    middle = np.arctan2(2.0 * (a * qj + qi * qk), plus * minus)
    half_sum = 0.0 if plus < 1e-14 else np.arctan2(py, px)
    half_gap = 0.0 if minus < 1e-14 else np.arctan2(my, mx)
    if plus < 1e-14 or minus < 1e-14:  # locked: the third angle is 0
        first, third = 2.0 * (half_sum + half_gap), 0.0
    else:
        first, third = half_sum + half_gap, half_sum - half_gap
    third = parity * third
    best0, best1, best2, least = first, middle, third, 1e300
    for turn in range(2):
        if turn == 1:
            first, middle, third = first + np.pi, np.pi - middle, third + np.pi
        over = 0.0
        h0, _ = _held(_wrapped(first), table[0], table[1])
        over += abs(_wrapped(h0 - first))
        h0, _ = _held(_wrapped(middle), table[2], table[3])
        over += abs(_wrapped(h0 - middle))
        h0, _ = _held(_wrapped(third), table[4], table[5])
        over += abs(_wrapped(h0 - third))
        if over < least:
            least, best0, best1, best2 = over, first, middle, third
    return best0, best1, best2


@kernel
def _hold_angles(a, b, c, d, table, i, j, k):
    first, middle, third = _angles_of(a, b, c, d, table, i, j, k)
    first, s0 = _held(_wrapped(first), table[0], table[1])
    middle, s1 = _held(_wrapped(middle), table[2], table[3])
    third, s2 = _held(_wrapped(third), table[4], table[5])
    a, b, c, d = _angle_about(i, first)
    e, f, g, h = _angle_about(j, middle)
    a, b, c, d = quat_multiply(a, b, c, d, e, f, g, h)
    e, f, g, h = _angle_about(k, third)
    a, b, c, d = quat_multiply(a, b, c, d, e, f, g, h)
    return a, b, c, d, s0, s1, s2


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
    found = False
    table = numbers[limit * LIMIT_NUMBERS : (limit + 1) * LIMIT_NUMBERS]
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
            x, y, z, v, s0, s1, s2 = _hold_angles(
                r, s, t, u, table, limits[at + L_I], limits[at + L_J], limits[at + L_K]
            )
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
def find_normals(joints, limits, numbers, limit, row, q, data, work, n):
    """The directions that bounds block now: those at which the joint stands and which it is pulled against."""
    at = limit * LIMIT_COLUMNS
    kind, joint = limits[at + L_KIND], limits[at + L_JOINT]
    w = work + joint * SLOTS * n
    home, q = data + limits[at + L_HOME] * n, q + 4 * joint * n
    side, out = w + SIDE * n, w + NORMALS * n
    p = joints[joint * JOINT_COLUMNS + J_PARENT]
    table = numbers[limit * LIMIT_NUMBERS : (limit + 1) * LIMIT_NUMBERS]
    found = np.zeros((3, 3))
    for k in range(n):
        s0, s1, s2 = row[side + k], row[side + n + k], row[side + 2 * n + k]
        for m in range(9):
            row[out + m * n + k] = 0.0
        if s0 == 0.0 and s1 == 0.0 and s2 == 0.0:
            continue
        a, b, c, d = row[q + k], row[q + n + k], row[q + 2 * n + k], row[q + 3 * n + k]
        e, f, g, h = row[home + k], row[home + n + k], row[home + 2 * n + k], row[home + 3 * n + k]
        a, b, c, d = quat_multiply(e, -f, -g, -h, a, b, c, d)
        found[:] = 0.0
        if kind == HINGE:
            x, y, z = table[0], table[1], table[2]
            found[0, 0], found[0, 1], found[0, 2] = x, y, z
            small = 0 if abs(x) <= abs(y) and abs(x) <= abs(z) else 1 if abs(y) <= abs(z) else 2
            ux, uy, uz = cross(
                x, y, z, 1.0 if small == 0 else 0.0, 1.0 if small == 1 else 0.0, 1.0 if small == 2 else 0.0
            )
            found[1, 0], found[1, 1], found[1, 2] = ux, uy, uz
            found[2, 0], found[2, 1], found[2, 2] = cross(x, y, z, ux, uy, uz)
        elif kind == CONE:
            _normals_of_cone(a, b, c, d, table, found)
        else:
            _normals_of_angles(a, b, c, d, table, limits[at + L_I], limits[at + L_J], limits[at + L_K], found)
        px, py, pz = row[w + PLACE * n + k], row[w + (PLACE + 1) * n + k], row[w + (PLACE + 2) * n + k]
        fx, fy, fz = row[w + PULL * n + k], row[w + (PULL + 1) * n + k], row[w + (PULL + 2) * n + k]
        gx, gy, gz = cross(px, py, pz, fx, fy, fz)
        gx, gy, gz = (
            row[w + MOMENT * n + k] - gx,
            row[w + (MOMENT + 1) * n + k] - gy,
            row[w + (MOMENT + 2) * n + k] - gz,
        )
        if joints[joint * JOINT_COLUMNS + J_PRIOR]:
            gx, gy = gx + row[w + PRIOR_PULL * n + k], gy + row[w + (PRIOR_PULL + 1) * n + k]
            gz = gz + row[w + (PRIOR_PULL + 2) * n + k]
        for m in range(3):
            bound = row[side + m * n + k]
            if bound == 0.0:
                continue
            x, y, z = quat_rotate(e, f, g, h, found[m, 0], found[m, 1], found[m, 2])
            if p >= 0:
                up = work + (p * SLOTS + TURN) * n + k
                x, y, z = quat_rotate(row[up], row[up + n], row[up + 2 * n], row[up + 3 * n], x, y, z)
            if bound == 2.0 or (x * gx + y * gy + z * gz) * bound < 0.0:
                place = out + 3 * m * n + k
                row[place], row[place + n], row[place + 2 * n] = x, y, z


@kernel
def _normals_of_cone(a, b, c, d, table, found):
    x, y, z = table[0], table[1], table[2]
    along = b * x + c * y + d * z
    size = max(a * a + along * along, 1e-300)
    ux, uy, uz = cross(x, y, z, b, c, d)
    ux, uy, uz = a * (a * x + ux) + along * b, a * (a * y + uy) + along * c, a * (a * z + uz) + along * d
    ux, uy, uz = quat_rotate(a, b, c, d, ux / size, uy / size, uz / size)
    found[0, 0], found[0, 1], found[0, 2] = ux, uy, uz
    px, py, pz = quat_rotate(a, b, c, d, x, y, z)
    first = px * table[3] + py * table[4] + pz * table[5]
    second = px * table[6] + py * table[7] + pz * table[8]
    sine = np.sqrt(first * first + second * second)
    angle = np.arctan2(sine, px * x + py * y + pz * z)
    safe = max(sine, 1e-12)
    cos, sin = first / safe, second / safe
    ra, rb = 1.0 / (table[9] * table[9]), 1.0 / (table[10] * table[10])
    ax, ay, az = cos * table[6] - sin * table[3], cos * table[7] - sin * table[4], cos * table[8] - sin * table[5]
    slope = 2.0 * angle * (sin * sin * ra + cos * cos * rb)
    turning = 2.0 * angle * angle * sin * cos * (ra - rb) / safe
    vx, vy, vz = cross(px, py, pz, ax, ay, az)
    vx, vy, vz = slope * ax + turning * vx, slope * ay + turning * vy, slope * az + turning * vz
    length = np.sqrt(vx * vx + vy * vy + vz * vz)
    if length > 1e-9:
        found[1, 0], found[1, 1], found[1, 2] = vx / length, vy / length, vz / length


@kernel
def _normals_of_angles(a, b, c, d, table, i, j, k, found):
    first, _, _ = _angles_of(a, b, c, d, table, i, j, k)
    rates = np.zeros((3, 3))
    rates[0, i] = 1.0
    e, f, g, h = _angle_about(i, first)
    rates[1, 0], rates[1, 1], rates[1, 2] = quat_rotate(
        e, f, g, h, 1.0 if j == 0 else 0.0, 1.0 if j == 1 else 0.0, 1.0 if j == 2 else 0.0
    )
    rates[2, 0], rates[2, 1], rates[2, 2] = quat_rotate(
        a, b, c, d, 1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0
    )
    x, y, z = cross(rates[0, 0], rates[0, 1], rates[0, 2], rates[1, 0], rates[1, 1], rates[1, 2])
    sign = 1.0 if x * rates[2, 0] + y * rates[2, 1] + z * rates[2, 2] > 0.0 else -1.0
    for m in range(3):
        u, v = rates[(m + 1) % 3], rates[(m + 2) % 3]
        x, y, z = cross(u[0], u[1], u[2], v[0], v[1], v[2])
        if x * x + y * y + z * z > 1e-12:
            found[m, 0], found[m, 1], found[m, 2] = sign * x, sign * y, sign * z


@kernel
def force_to_bound(joints, limits, limit, row, q, work, n, active):
    """Force a joint that its step carried over a bound to go just there; whether there is one."""
    at = limit * LIMIT_COLUMNS
    joint = limits[at + L_JOINT]
    w, q = work + joint * SLOTS * n, q + 4 * joint * n
    p = joints[joint * JOINT_COLUMNS + J_PARENT]
    found = False
    for k in range(n):
        if active[k] == 0.0:
            continue
        a, b, c, d = row[q + k], row[q + n + k], row[q + 2 * n + k], row[q + 3 * n + k]
        best = w + BEST * n + k
        a, b, c, d = quat_multiply(a, b, c, d, row[best], -row[best + n], -row[best + 2 * n], -row[best + 3 * n])
        scale = 2.0 / a if abs(a) > 1e-6 else 2e6
        x, y, z = scale * b, scale * c, scale * d
        if p >= 0:
            up = work + (p * SLOTS + TURN) * n + k
            x, y, z = quat_rotate(row[up], row[up + n], row[up + 2 * n], row[up + 3 * n], x, y, z)
        step = w + STEP * n + k
        ox, oy, oz = x - row[step], y - row[step + n], z - row[step + 2 * n]
        if np.sqrt(ox * ox + oy * oy + oz * oz) > 0.1 * np.sqrt(x * x + y * y + z * z) + 1e-6:
            row[w + KEEP * n + k] = 0.0
            place = w + FORCED * n + k
            row[place], row[place + n], row[place + 2 * n] = x, y, z
            found = True
    return found
