# pyright: basic
"""The pose half of an animation graph for one character, joints in the lanes.

A pose is one row of float32: rotations [4][padded joints], the translations and the scales that move anywhere in the graph,
then the extras (morph weights; places, touch and turn of contacts), filled up to whole vectors. Everything after the rotations
adds linearly. Operations work on a stack of *values*: two rows and how far it is from one to the other, so that a sample of
a clip is the two decoded samples beside it and costs nothing until it is mixed. A value of one row has it twice.

What a state machine remembers of its last two poses is where those poses were written in the first place.
"""

from __future__ import annotations

import math

import numpy as np

from keypose.kernels import crowd as clips
from keypose.kernels.graphtables import (
    CHARACTER,
    CLIP_HANDLES,
    EXTRA_A,
    EXTRA_B,
    EXTRA_T,
    EXTRA_TABLES,
    EXTRAS,
    FINAL,
    JOINTS,
    JOINTS_NOW,
    LINEAR,
    MASKS,
    MEMORIES,
    MEMORY_COUNT,
    MEMORY_NUMBERS,
    MEMORY_SIZE,
    PADDED,
    POSE,
    REFERENCES,
    STACK,
    VALUE_A,
    VALUE_B,
    VALUE_T,
    VALUE_WEIGHT,
)
from keypose.kernels.rotations import load3, load4, quat_multiply, store4
from keypose.kernels.runtime import WIDTH, inlined, kernel
from keypose.kernels.vectors import (
    absolute,
    fill,
    flip_sign,
    float32_at,
    float64_at,
    int64_at,
    load,
    maximum,
    rsqrt,
    sqrt,
    store,
)

SHORTEST_HALF_LIFE_S, LONGEST_HALF_LIFE_S = 0.05, 0.5
RING, VELOCITY_S, KEPT = range(
    3
)  # of a memory: which row is the last one, seconds between the rows, whether it holds an offset
MEMORY_ROW = 4
ZERO, ONE, TWO = np.int64(0), np.int64(1), np.int64(2)  # plain numbers would be compiled for each value


# --- functions of vectors -------------------------------------------------------------------------------------------------


@inlined
def _minimum(a, b):
    return 0.0 - maximum(0.0 - a, 0.0 - b)


@inlined
def _nearest(x):
    """The nearest whole number, by the rounding of a sum that has no room for fractions."""
    return (x + 12582912.0) - 12582912.0


@inlined
def _cos_sinc(squared):
    """cos h and sin h / h of the h whose square is given, to about 2e-7."""
    h = sqrt(maximum(squared, 0.0 * squared + 1e-30))
    turns = _nearest(h * 0.3183098861837907)
    r = (h - turns * 3.140625) - turns * 9.676535897932795e-4
    odd = turns - 2.0 * _nearest(0.5 * turns)
    sign = 1.0 - 2.0 * (odd * odd)
    s = r * r
    sine = r * (1.0 + s * (-1 / 6 + s * (1 / 120 + s * (-1 / 5040 + s * (1 / 362880 - s * (1 / 39916800))))))
    cosine = 1.0 + s * (
        -0.5 + s * (1 / 24 + s * (-1 / 720 + s * (1 / 40320 + s * (-1 / 3628800 + s * (1 / 479001600)))))
    )
    return sign * cosine, (sign * sine) / h


@inlined
def _turned_by(x, y, z):
    """The quaternion of a rotation vector."""
    x, y, z = 0.5 * x, 0.5 * y, 0.5 * z
    c, s = _cos_sinc(x * x + y * y + z * z)
    return c, x * s, y * s, z * s


@inlined
def _arctangent(x):
    """Of 0 to 1, to 2e-8. Source: Abramowitz and Stegun, Handbook of Mathematical Functions, 4.4.49."""
    s = x * x
    p = 0.1065626393 + s * (-0.0752896400 + s * (0.0429096138 + s * (-0.0161657367 + s * 0.0028662257)))
    return x * (1.0 + s * (-0.3333314528 + s * (0.1999355085 + s * (-0.1420889944 + s * p))))


@inlined
def _power(w, x, y, z, exponent):
    """A rotation with its angle scaled, taken the short way."""
    x, y, z, w = flip_sign(x, w), flip_sign(y, w), flip_sign(z, w), absolute(w)
    squared = x * x + y * y + z * z
    n = sqrt(maximum(squared, 0.0 * squared + 1e-30))
    half = 2.0 * _arctangent(n / (1.0 + w))
    h = exponent * half
    c, s = _cos_sinc(h * h)
    s = s * h / n
    return c, x * s, y * s, z * s


@inlined
def _dying(x):
    """e^-x of x >= 0, to about 1e-6: the 64th part by its series, squared six times."""
    y = _minimum(x, 0.0 * x + 16.0) * (-1.0 / 64.0)
    e = 1.0 + y * (1.0 + y * (0.5 + y * (1 / 6 + y * (1 / 24 + y * (1 / 120)))))
    for _ in range(6):
        e = e * e
    return e


@inlined
def _unit(w, x, y, z):
    r = rsqrt(w * w + x * x + y * y + z * z)
    return w * r, x * r, y * r, z * r


# --- values ---------------------------------------------------------------------------------------------------------------


@inlined
def room_of(h, p):
    """Where the row of a value that is computed goes; the lowest is the character's final pose."""
    return h[FINAL] if p == 0 else h[STACK] + 4 * (p - 1) * h[POSE]


@kernel
def push_row(h, p, row):
    """A value of one row."""
    a, b, ea, eb = int64_at(h[VALUE_A]), int64_at(h[VALUE_B]), int64_at(h[EXTRA_A]), int64_at(h[EXTRA_B])
    a[p], b[p] = row, row
    ea[p] = row + 4 * (h[POSE] - h[EXTRAS])
    eb[p] = ea[p]
    float64_at(h[VALUE_T])[p], float64_at(h[EXTRA_T])[p] = 0.0, 0.0


@kernel
def push_sample(h, p, clip, time_s):
    """A clip at a time."""
    c = int64_at(h[CLIP_HANDLES])
    table, timing = int64_at(c[clips.CLIP_TABLE]), float64_at(c[clips.TIMING])
    row = clip * clips.CLIP
    layout = int64_at(table[row + clips.LAYOUT])
    frame, part = clips._frame_at(time_s, timing[2 * clip], timing[2 * clip + 1], layout[clips.FRAME_COUNT], False)
    knot, share = clips._knot_at(layout, frame, part)
    fineness = table[row + clips.FINENESS]
    share *= fineness
    part_of = min(int(share), fineness - 1)
    knot, share = knot * fineness + part_of, share - part_of
    after = min(knot + 1, table[row + clips.KNOTS] - 1) if share > 0 else knot
    base = table[row + clips.FIRST_KNOT]
    slot_of, knot_of, stamps = int64_at(c[clips.SLOT_OF]), int64_at(c[clips.KNOT_OF]), int64_at(c[clips.STAMPS])
    int64_at(h[VALUE_A])[p] = c[clips.POOL] + 4 * clips._pooled(c, clip, base + knot, slot_of, knot_of, stamps)
    int64_at(h[VALUE_B])[p] = c[clips.POOL] + 4 * clips._pooled(c, clip, base + after, slot_of, knot_of, stamps)
    float64_at(h[VALUE_T])[p] = share
    extras = int64_at(h[EXTRA_TABLES])[clip] + 4 * frame * h[EXTRAS]
    int64_at(h[EXTRA_A])[p] = extras
    int64_at(h[EXTRA_B])[p] = extras + 4 * h[EXTRAS] if part > 0 else extras
    float64_at(h[EXTRA_T])[p] = part


@inlined
def _rotation(a, b, t, j, padded):
    """Unit rotations of W joints of a value; knots 30 degrees apart shorten a quaternion to 0.991."""
    w, x, y, z = load4(a, j, padded)
    bw, bx, by, bz = load4(b, j, padded)
    w, x, y, z = w + t * (bw - w), x + t * (bx - x), y + t * (by - y), z + t * (bz - z)
    n = w * w + x * x + y * y + z * z
    r = 1.875 + n * (0.375 * n - 1.25)
    return w * r, x * r, y * r, z * r


@inlined
def _numbers(h, p, at):
    """W of the linear numbers of a value, from ``at`` on."""
    if at < h[LINEAR]:
        a, b = float32_at(int64_at(h[VALUE_A])[p]), float32_at(int64_at(h[VALUE_B])[p])
        first = 4 * h[PADDED] + at
        t = float64_at(h[VALUE_T])[p]
        x = load(a, first)
        x = x + t * (load(b, first) - x)
    else:
        a, b = float32_at(int64_at(h[EXTRA_A])[p]), float32_at(int64_at(h[EXTRA_B])[p])
        t = float64_at(h[EXTRA_T])[p]
        x = load(a, at - h[LINEAR])
        x = x + t * (load(b, at - h[LINEAR]) - x)
    return x


@inlined
def _rotation_of(h, p, j):
    a, b = float32_at(int64_at(h[VALUE_A])[p]), float32_at(int64_at(h[VALUE_B])[p])
    return _rotation(a, b, fill(a, float64_at(h[VALUE_T])[p]), j, h[PADDED])


@kernel
def mix(h, p, count, to):
    """The mean of values by their weights, written to a row, which becomes the lowest of them."""
    out, padded, weights = float32_at(to), h[PADDED], float64_at(h[VALUE_WEIGHT])
    for j in range(0, h[JOINTS_NOW], WIDTH):
        w, x, y, z = _rotation_of(h, p, j)
        own = weights[p]
        w, x, y, z = own * w, own * x, own * y, own * z
        for k in range(p + 1, p + count):
            bw, bx, by, bz = _rotation_of(h, k, j)
            r = flip_sign(fill(out, weights[k]), w * bw + x * bx + y * by + z * bz)
            w, x, y, z = w + r * bw, x + r * bx, y + r * by, z + r * bz
        w, x, y, z = _unit(w, x, y, z)
        store4(out, j, padded, w, x, y, z)
    for at in range(0, h[LINEAR] + h[EXTRAS], WIDTH):
        total = weights[p] * _numbers(h, p, at)
        for k in range(p + 1, p + count):
            total = total + weights[k] * _numbers(h, k, at)
        store(out, 4 * padded + at, total)
    push_row(h, p, to)


@inlined
def settle(h, p, to):
    """A value as one row."""
    float64_at(h[VALUE_WEIGHT])[p] = 1.0
    mix(h, p, ONE, to)


@inlined
def settle_here(h, p):
    """A value as a row of the stack, which may be written."""
    if int64_at(h[VALUE_A])[p] != room_of(h, p):
        settle(h, p, room_of(h, p))


@kernel
def lay_over(h, p, mask, amount):
    """The upper of two values over the lower, where the mask says."""
    to = room_of(h, p)
    out, padded = float32_at(to), h[PADDED]
    shares = float32_at(h[MASKS] + 4 * mask * (padded + h[LINEAR] + h[EXTRAS]))
    for j in range(0, h[JOINTS_NOW], WIDTH):
        w, x, y, z = _rotation_of(h, p, j)
        bw, bx, by, bz = _rotation_of(h, p + 1, j)
        share = amount * load(shares, j)
        r = flip_sign(share, w * bw + x * bx + y * by + z * bz)
        left = 1.0 - share
        w, x, y, z = _unit(left * w + r * bw, left * x + r * bx, left * y + r * by, left * z + r * bz)
        store4(out, j, padded, w, x, y, z)
    for at in range(0, h[LINEAR] + h[EXTRAS], WIDTH):
        share = amount * load(shares, padded + at)
        base = _numbers(h, p, at)
        store(out, 4 * padded + at, base + share * (_numbers(h, p + 1, at) - base))
    push_row(h, p, to)


@kernel
def add_to(h, p, mask, amount, reference):
    """What the upper value differs from a reference by, on top of the lower one; contacts stay the lower one's."""
    to = room_of(h, p)
    out, padded, linear = float32_at(to), h[PADDED], h[LINEAR]
    shares = float32_at(h[MASKS] + 4 * mask * (padded + linear + h[EXTRAS]))
    from_ = float32_at(h[REFERENCES] + 4 * reference * h[POSE])
    for j in range(0, h[JOINTS_NOW], WIDTH):
        rw, rx, ry, rz = load4(from_, j, padded)
        w, x, y, z = _rotation_of(h, p + 1, j)
        w, x, y, z = quat_multiply(rw, 0.0 - rx, 0.0 - ry, 0.0 - rz, w, x, y, z)
        w, x, y, z = _power(w, x, y, z, amount * load(shares, j))
        bw, bx, by, bz = _rotation_of(h, p, j)
        w, x, y, z = quat_multiply(bw, bx, by, bz, w, x, y, z)
        w, x, y, z = _unit(w, x, y, z)
        store4(out, j, padded, w, x, y, z)
    scales = linear - 3 * int64_at(h[CLIP_HANDLES])[clips.SCALED]
    for at in range(0, linear + h[EXTRAS], WIDTH):
        base, own, old = _numbers(h, p, at), _numbers(h, p + 1, at), load(from_, 4 * padded + at)
        share = amount * load(shares, padded + at)  # 0 for contacts, see `keypose.play.graph.tables`
        if scales <= at < linear:
            # A scale of nothing has no ratio; it is left as it is.
            safe = maximum(absolute(old), 0.0 * old + 1e-30)
            change = flip_sign(own, old) / safe - 1.0
            change = change * _minimum(safe * 1e20, 0.0 * old + 1.0)
            store(out, 4 * padded + at, base * (1.0 + share * change))
        else:
            store(out, 4 * padded + at, base + share * (own - old))
    # Where contacts share a vector with morph weights, their share is 0.
    push_row(h, p, to)


# --- memory of state machines ---------------------------------------------------------------------------------------------
# Of each machine of each character: two rows (the last poses), then either an offset that dies out, [rotation vectors (3 rows of joints) and
# linear numbers] x (place, speed, acceleration, 1 / seconds), or a held pose with the way it still goes and how fast it slows down.


@inlined
def _memory(h, m):
    return h[MEMORIES] + 4 * (h[CHARACTER] * h[MEMORY_COUNT] + m) * h[MEMORY_SIZE]


@inlined
def _memory_numbers(h, m):
    return h[MEMORY_NUMBERS] + 8 * (h[CHARACTER] * h[MEMORY_COUNT] + m) * MEMORY_ROW


@inlined
def _last(h, m):
    return _memory(h, m) + 4 * int(float64_at(_memory_numbers(h, m))[RING]) * h[POSE]


@inlined
def _before_last(h, m):
    return _memory(h, m) + 4 * (1 - int(float64_at(_memory_numbers(h, m))[RING])) * h[POSE]


@kernel
def remember(h, p, m, dt_s, fresh):
    """Keep a value as what the machine saw last; ``fresh``: it saw nothing just before."""
    kept = float64_at(_memory_numbers(h, m))
    if fresh or dt_s > 0:
        kept[VELOCITY_S] = 0.0 if fresh else dt_s
        kept[RING] = 1.0 - kept[RING]
        settle(h, p, _last(h, m))
        return
    # No time has passed: the velocity stays, so the row before is carried along.
    settle_here(h, p)
    new, last, before = float32_at(room_of(h, p)), float32_at(_last(h, m)), float32_at(_before_last(h, m))
    padded = h[PADDED]
    for j in range(0, h[JOINTS_NOW], WIDTH):
        w, x, y, z = load4(new, j, padded)
        if kept[VELOCITY_S] > 0:
            lw, lx, ly, lz = load4(last, j, padded)
            bw, bx, by, bz = load4(before, j, padded)
            cw, cx, cy, cz = quat_multiply(bw, bx, by, bz, lw, 0.0 - lx, 0.0 - ly, 0.0 - lz)
            cw, cx, cy, cz = quat_multiply(cw, cx, cy, cz, w, x, y, z)
            store4(before, j, padded, cw, cx, cy, cz)
        store4(last, j, padded, w, x, y, z)
    for at in range(4 * padded, h[POSE], WIDTH):
        x = load(new, at)
        store(before, at, load(before, at) + (x - load(last, at)))
        store(last, at, x)
    push_row(h, p, _last(h, m))


@inlined
def _log(w, x, y, z):
    """The rotation vector of a unit quaternion, the short way."""
    if w < 0:
        w, x, y, z = -w, -x, -y, -z
    n = math.sqrt(x * x + y * y + z * z)
    ratio = 2.0 * math.atan2(n, w) / n if n > 1e-9 else 2.0
    return ratio * x, ratio * y, ratio * z


@inlined
def _turn_between(a, b, j, padded):
    """The rotation that leads from one row's joint to another's."""
    return quat_multiply(
        float(b[j]), float(b[padded + j]), float(b[2 * padded + j]), float(b[3 * padded + j]),
        float(a[j]), -float(a[padded + j]), -float(a[2 * padded + j]), -float(a[3 * padded + j]),
    )  # fmt: skip


@inlined
def _spin(h, m, last, before, j, padded):
    seconds = float64_at(_memory_numbers(h, m))[VELOCITY_S]
    x, y, z = 0.0, 0.0, 0.0
    if seconds > 0:
        w, x, y, z = _turn_between(before, last, j, padded)
        x, y, z = _log(w, x, y, z)
        x, y, z = x / seconds, y / seconds, z / seconds
    return x, y, z


@inlined
def _half_life(difference, velocity):
    ratio = LONGEST_HALF_LIFE_S
    if velocity != 0:
        ratio = min(max(difference / velocity, SHORTEST_HALF_LIFE_S), LONGEST_HALF_LIFE_S)
    return ratio


@kernel
def hold(h, p, m, runs_on):
    """Hold what was last seen; where it runs on by itself, how far it still goes depends on the new motion, a value."""
    padded, pose, linear = h[PADDED], h[POSE], 4 * h[PADDED]
    last, before = float32_at(_last(h, m)), float32_at(_before_last(h, m))
    held = float32_at(_memory(h, m) + 8 * pose)
    for at in range(0, pose, WIDTH):
        store(held, at, load(last, at))
    float64_at(_memory_numbers(h, m))[KEPT] = 1.0
    if not runs_on:
        return
    settle_here(h, p)
    target = float32_at(room_of(h, p))
    way = pose
    rate = way + 3 * padded + pose - linear
    seconds = float64_at(_memory_numbers(h, m))[VELOCITY_S]
    for j in range(h[JOINTS]):
        w, x, y, z = _turn_between(last, target, j, padded)
        turn = _log(w, x, y, z)
        spin = _spin(h, m, last, before, j, padded)
        for axis in range(3):
            half = _half_life(turn[axis], spin[axis])
            held[way + axis * padded + j] = spin[axis] * half / math.log(2.0)
            held[rate + axis * padded + j] = math.log(2.0) / half
    for at in range(linear, pose):
        velocity = (float(last[at]) - float(before[at])) / seconds if seconds > 0 else 0.0
        half = _half_life(float(target[at]) - float(last[at]), velocity)
        held[way + 3 * padded + at - linear] = velocity * half / math.log(2.0)
        held[rate + 3 * padded + at - linear] = math.log(2.0) / half


@kernel
def fade_held(h, p, m, weight):
    """The held pose with ``weight`` of a value mixed in."""
    if float64_at(_memory_numbers(h, m))[KEPT] == 0.0:
        return
    push_row(h, p + 1, _memory(h, m) + 8 * h[POSE])
    weights = float64_at(h[VALUE_WEIGHT])
    weights[p], weights[p + 1] = weight, 1.0 - weight
    mix(h, p, TWO, room_of(h, p))


@kernel
def fade_dead(h, p, m, elapsed_s, weight):
    """The held motion, running on by itself and slowing down, with ``weight`` of a value mixed in."""
    if float64_at(_memory_numbers(h, m))[KEPT] == 0.0:
        return
    to, padded, pose, linear = room_of(h, p), h[PADDED], h[POSE], 4 * h[PADDED]
    out, held = float32_at(to), float32_at(_memory(h, m) + 8 * pose)
    way = pose
    rate = way + 3 * padded + pose - linear
    old = 1.0 - weight
    for j in range(0, h[JOINTS_NOW], WIDTH):
        x, y, z = load3(held, way + j, padded)
        rx, ry, rz = load3(held, rate + j, padded)
        x = x * (1.0 - _dying(rx * elapsed_s))
        y = y * (1.0 - _dying(ry * elapsed_s))
        z = z * (1.0 - _dying(rz * elapsed_s))
        w, x, y, z = _turned_by(x, y, z)
        hw, hx, hy, hz = load4(held, j, padded)
        w, x, y, z = quat_multiply(w, x, y, z, hw, hx, hy, hz)
        bw, bx, by, bz = _rotation_of(h, p, j)
        r = flip_sign(fill(out, weight), w * bw + x * bx + y * by + z * bz)
        w, x, y, z = _unit(old * w + r * bw, old * x + r * bx, old * y + r * by, old * z + r * bz)
        store4(out, j, padded, w, x, y, z)
    for at in range(0, pose - linear, WIDTH):
        gone = load(held, way + 3 * padded + at) * (1.0 - _dying(load(held, rate + 3 * padded + at) * elapsed_s))
        alone = load(held, linear + at) + gone
        store(out, linear + at, old * alone + weight * _numbers(h, p, at))
    push_row(h, p, to)


@inlined
def _keep_offset(row, at, stride, place, speed, duration_s):
    """What the quintic needs of one number, see `keypose.play.graph.transitions.quintic`."""
    side = -1.0 if place < 0 else 1.0
    x, v = side * place, side * speed
    reached = -x / (v * duration_s) if v < 0 else 0.0
    t1 = duration_s * max(min(5.0 * reached, 1.0), 1.0 - 10.0 * reached)
    a0 = min(15.0 * reached, 1.0) * max((-8.0 * v * t1 - 20.0 * x) / (t1 * t1), 0.0)
    row[at] = place
    row[at + stride] = side * v * t1
    row[at + 2 * stride] = side * a0 * t1 * t1
    row[at + 3 * stride] = 1.0 / t1


@kernel
def begin_offset(h, p, m, start_row, dt_s, duration_s):
    """Keep how the motion last seen differs from the new one (a row at the step's start, a value at its end)."""
    kept = float64_at(_memory_numbers(h, m))
    if not dt_s > 0:
        kept[KEPT] = 0.0
        return
    kept[KEPT] = 1.0
    settle_here(h, p)
    padded, pose, linear = h[PADDED], h[POSE], 4 * h[PADDED]
    start, end = float32_at(start_row), float32_at(room_of(h, p))
    last, before = float32_at(_last(h, m)), float32_at(_before_last(h, m))
    offset = float32_at(_memory(h, m) + 8 * pose)
    for j in range(h[JOINTS]):
        w, x, y, z = _turn_between(start, end, j, padded)
        sx, sy, sz = _log(w, x, y, z)
        ox, oy, oz = _spin(h, m, last, before, j, padded)
        w, x, y, z = _turn_between(start, last, j, padded)
        vx, vy, vz = _log(w, x, y, z)
        # The old motion's angular velocity against the new one's, both in the parent's axes at the old pose.
        tx, ty, tz = 2 * (y * sz - z * sy), 2 * (z * sx - x * sz), 2 * (x * sy - y * sx)
        ox -= (sx + w * tx + y * tz - z * ty) / dt_s
        oy -= (sy + w * ty + z * tx - x * tz) / dt_s
        oz -= (sz + w * tz + x * ty - y * tx) / dt_s
        # The rotation vector's derivative: the inverse of the left Jacobian of SO(3).
        squared = vx * vx + vy * vy + vz * vz
        angle = math.sqrt(squared)
        factor = 1 / 12 + squared / 720
        if angle > 1e-2:
            factor = (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / squared
        cx, cy, cz = vy * oz - vz * oy, vz * ox - vx * oz, vx * oy - vy * ox
        dx, dy, dz = vy * cz - vz * cy, vz * cx - vx * cz, vx * cy - vy * cx
        _keep_offset(offset, j, 3 * padded, vx, ox - 0.5 * cx + factor * dx, duration_s)
        _keep_offset(offset, j + padded, 3 * padded, vy, oy - 0.5 * cy + factor * dy, duration_s)
        _keep_offset(offset, j + 2 * padded, 3 * padded, vz, oz - 0.5 * cz + factor * dz, duration_s)
    for at in range(linear, pose):
        velocity = (float(last[at]) - float(before[at])) / kept[VELOCITY_S] if kept[VELOCITY_S] > 0 else 0.0
        speed = velocity - (float(end[at]) - float(start[at])) / dt_s
        place = float(last[at]) - float(start[at])
        _keep_offset(offset, 12 * padded + at - linear, pose - linear, place, speed, duration_s)


@inlined
def _left(row, at, stride, elapsed_s):
    """What is left of the offset: the quintic from (x, w) to rest at 0, in units of its duration."""
    x, w, a, rate = load(row, at), load(row, at + stride), load(row, at + 2 * stride), load(row, at + 3 * stride)
    u = _minimum(elapsed_s * rate, 0.0 * rate + 1.0)
    c5 = -0.5 * (a + 6.0 * w + 12.0 * x)
    c4 = 0.5 * (3.0 * a + 16.0 * w + 30.0 * x)
    c3 = -0.5 * (3.0 * a + 12.0 * w + 20.0 * x)
    return ((((c5 * u + c4) * u + c3) * u + 0.5 * a) * u + w) * u + x


@kernel
def apply_offset(h, p, m, elapsed_s):
    """A value with what is left of the difference."""
    if float64_at(_memory_numbers(h, m))[KEPT] == 0.0:
        return
    to, padded, pose, linear = room_of(h, p), h[PADDED], h[POSE], 4 * h[PADDED]
    out, offset = float32_at(to), float32_at(_memory(h, m) + 8 * pose)
    for j in range(0, h[JOINTS_NOW], WIDTH):
        x = _left(offset, j, 3 * padded, elapsed_s)
        y = _left(offset, j + padded, 3 * padded, elapsed_s)
        z = _left(offset, j + 2 * padded, 3 * padded, elapsed_s)
        w, x, y, z = _turned_by(x, y, z)
        bw, bx, by, bz = _rotation_of(h, p, j)
        w, x, y, z = quat_multiply(w, x, y, z, bw, bx, by, bz)
        store4(out, j, padded, w, x, y, z)
    for at in range(0, pose - linear, WIDTH):
        moved = _left(offset, 12 * padded + at, pose - linear, elapsed_s)
        store(out, linear + at, _numbers(h, p, at) + moved)
    push_row(h, p, to)


@kernel
def copy_row(h, p, to):
    """A value as a row anywhere, the value itself left as it is."""
    if int64_at(h[VALUE_A])[p] != room_of(h, p):
        settle(h, p, room_of(h, p))
    row, out = float32_at(room_of(h, p)), float32_at(to)
    for at in range(0, h[POSE], WIDTH):
        store(out, at, load(row, at))
