# pyright: basic
"""Playing clips of an animation graph: their time, their travel on the ground and their events."""

from __future__ import annotations

import math

from keypose.kernels.graphsync import _clamped, _time_of_place
from keypose.kernels.graphtables import (
    AT,
    AT_SHARE,
    CHARACTER,
    DATA,
    DRIVEN,
    DURATION,
    EVENT,
    EVENT_AT,
    EVENT_ID,
    EVENTS,
    FASTEST,
    FIELDS,
    FLOATS,
    FRAMES,
    INTS,
    MOST_CURVED,
    NODES,
    NUMBERS,
    QUEUE,
    QUEUE_ROOM,
    QUEUE_ROW,
    QUEUE_WEIGHTS,
    QUEUED,
    RATE,
    REALS,
    SLOW_M_S,
    SPEED,
    STATE_FLOATS,
    STATE_INTS,
    SYNC_AT,
    SYNCS,
    TRACK_AT,
    TRAVEL,
    WARP_AT,
    WARPS,
    WORDS,
    A,
    C,
    number,
)
from keypose.kernels.runtime import exact_inlined, exact_kernel
from keypose.kernels.vectors import float64_at, int64_at


@exact_inlined
def compose(ax, az, a, bx, bz, b):
    """First a, then b seen from a."""
    c, s = math.cos(a), math.sin(a)
    return ax + c * bx + s * bz, az - s * bx + c * bz, a + b


@exact_inlined
def _between(ax, az, a, bx, bz, b):
    c, s = math.cos(a), math.sin(a)
    x, z = bx - ax, bz - az
    return c * x - s * z, s * x + c * z, b - a


@exact_kernel
def _repeated(x, z, a, count):
    if count < 0:
        x, z, a = _between(x, z, a, 0.0, 0.0, 0.0)
        count = -count
    rx, rz, r = 0.0, 0.0, 0.0
    while count:
        if count & 1:
            rx, rz, r = compose(rx, rz, r, x, z, a)
        x, z, a = compose(x, z, a, x, z, a)
        count >>= 1
    return rx, rz, r


@exact_inlined
def _ground_at(reals, track, frames, rate, time):
    last = frames - 1
    where = min(max(time * rate, 0.0), float(last))
    frame = min(int(where), max(last - 1, 0))
    u = where - frame
    p = track + 3 * frame
    q = track + 3 * min(frame + 1, last)
    return (
        reals[p] + u * (reals[q] - reals[p]),
        reals[p + 1] + u * (reals[q + 1] - reals[p + 1]),
        reals[p + 2] + u * (reals[q + 2] - reals[p + 2]),
    )


@exact_inlined
def _travelled(reals, track, frames, rate, loop, before, new_loop, after):
    """The step of the ground from one moment of a clip to another."""
    ax, az, a = _ground_at(reals, track, frames, rate, before)
    bx, bz, b = _ground_at(reals, track, frames, rate, after)
    if loop != new_loop:
        end = track + 3 * (frames - 1)
        cx, cz, c = _repeated(reals[end], reals[end + 1], reals[end + 2], new_loop - loop)
        bx, bz, b = compose(cx, cz, c, bx, bz, b)
    return _between(ax, az, a, bx, bz, b)


@exact_inlined
def in_clip(words, reals, data, duration, time):
    """The clip's own time, bent by the warp."""
    bent = time
    warps, at = words[data + WARPS], words[data + WARP_AT]
    if warps > 0 and duration > 0:
        share = time / duration
        bent = duration
        for i in range(warps - 1):
            x0, y0 = reals[at + 2 * i], reals[at + 2 * i + 1]
            x1, y1 = reals[at + 2 * i + 2], reals[at + 2 * i + 3]
            if share <= x1:
                bent = duration * (y0 + (y1 - y0) * (share - x0) / (x1 - x0))
                break
    return bent


@exact_inlined
def _queue(h, kind, what, node, weight):
    """An entry of the queue; where there is no room it is counted all the same, and the step is done again with more."""
    at = h[QUEUED]
    if at < h[QUEUE_ROOM]:
        queue, weights = int64_at(h[QUEUE]), float64_at(h[QUEUE_WEIGHTS])
        queue[QUEUE_ROW * at] = h[CHARACTER]
        queue[QUEUE_ROW * at + 1] = kind
        queue[QUEUE_ROW * at + 2] = what
        queue[QUEUE_ROW * at + 3] = node
        weights[at] = weight
    h[QUEUED] = at + 1


@exact_inlined
def _before(a, x, b, y):
    return a < b or (a == b and x < y)


@exact_kernel
def _fire(h, node, loop0, time0, loop1, time1, weight):
    """Events passed on the way: those at the start of the way count, those at its end only where the clip stops."""
    if loop0 == loop1 and time0 == time1:
        return
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats = float64_at(h[STATE_FLOATS])
    row = node * FIELDS
    data, duration, loops = nodes[row + DATA], reals[nodes[row + NUMBERS] + DURATION], nodes[row + C]
    forward = _before(loop0, time0, loop1, time1)
    entered = time0 == 0.0 and float(loop0) == floats[nodes[row + FLOATS] + 1]
    stops = loops > 0 and time1 == 0.0 and loop1 == (loops if forward else 0)
    low, low_time, high, high_time = loop0, time0, loop1, time1
    if not forward:
        low, low_time, high, high_time = loop1, time1, loop0, time0
    count, at = words[data + EVENTS], words[data + EVENT_AT]
    for n in range(high - low + 2):
        loop = low - 1 + n if forward else high - n
        if loops > 0 and not 0 <= loop < loops:
            continue
        for k in range(count):
            i = k if forward else count - 1 - k
            time = reals[at + i]
            seam = time >= duration
            where, when = (loop + 1, 0.0) if seam else (loop, time)
            at_start = where == loop0 and when == time0
            if entered and at_start and forward == seam:
                continue
            inside = _before(low, low_time, where, when) and _before(where, when, high, high_time)
            if inside or at_start or (stops and where == loop1 and when == time1):
                _queue(h, EVENT, words[data + EVENT_ID] + i, node, weight)


@exact_kernel
def _move(h, node, loop, time, weight):
    """Take a clip to a moment; its events are queued, its travel is left beside it."""
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, ints, travel = float64_at(h[STATE_FLOATS]), int64_at(h[STATE_INTS]), float64_at(h[TRAVEL])
    row = node * FIELDS
    data, numbers = nodes[row + DATA], nodes[row + NUMBERS]
    duration = reals[numbers + DURATION]
    at, loop_at = nodes[row + FLOATS], nodes[row + INTS]
    old_loop, old_time = ints[loop_at], floats[at]
    loop, time = _clamped(nodes[row + C], duration, loop, time)
    ints[loop_at], floats[at] = loop, time
    before = in_clip(words, reals, data, duration, old_time)
    after = in_clip(words, reals, data, duration, time)
    if words[data + EVENTS] > 0 and weight > 0:
        # The end of a loop is the beginning of the next.
        loop0, time0 = (old_loop + 1, 0.0) if before >= duration else (old_loop, before)
        loop1, time1 = (loop + 1, 0.0) if after >= duration else (loop, after)
        _fire(h, node, loop0, time0, loop1, time1, weight)
    x, z, a = _travelled(
        reals, words[data + TRACK_AT], words[data + FRAMES], reals[numbers + RATE], old_loop, before, loop, after
    )
    travel[3 * node], travel[3 * node + 1], travel[3 * node + 2] = x, z, a


@exact_inlined
def play_clip(h, node, mode, dt_s, weight):
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, ints, travel = float64_at(h[STATE_FLOATS]), int64_at(h[STATE_INTS]), float64_at(h[TRAVEL])
    row = node * FIELDS
    numbers, data = nodes[row + NUMBERS], nodes[row + DATA]
    duration = reals[numbers + DURATION]
    if mode == DRIVEN:
        interval, share = int64_at(h[AT])[node], float64_at(h[AT_SHARE])[node]
        loop, time = _time_of_place(reals, words[data + SYNC_AT], words[data + SYNCS], duration, interval, share)
        _move(h, node, loop, time, weight)
    else:
        speed = number(floats, nodes[row + A], reals[numbers + SPEED])
        moved = dt_s * min(max(speed, -FASTEST), FASTEST)
        if duration <= 0 or moved == 0:
            travel[3 * node], travel[3 * node + 1], travel[3 * node + 2] = 0.0, 0.0, 0.0
        else:
            time = floats[nodes[row + FLOATS]]
            whole = math.floor((time + moved) / duration)
            inside = time + moved - whole * duration
            if inside >= duration:  # rounding
                whole, inside = whole + 1, 0.0
            _move(h, node, ints[nodes[row + INTS]] + int(whole), max(inside, 0.0), weight)


@exact_kernel
def steer(h, node, dt_s):
    """The base's step on an arc."""
    nodes, reals = int64_at(h[NODES]), float64_at(h[REALS])
    floats, travel = float64_at(h[STATE_FLOATS]), float64_at(h[TRAVEL])
    row, base = node * FIELDS, 3 * (node + 1)
    turn = number(floats, nodes[row + A], reals[nodes[row + NUMBERS]]) * (math.pi / 180.0)
    length = math.hypot(travel[base], travel[base + 1])
    if dt_s > 0:
        speed = length / dt_s
        curvature = turn * speed / (speed * speed + SLOW_M_S * SLOW_M_S)
        way = nodes[row + FLOATS]
        floats[way] = travel[base] / length if length > 0 else 0.0
        floats[way + 1] = travel[base + 1] / length if length > 0 else 1.0
        floats[way + 2] = min(max(curvature, -MOST_CURVED), MOST_CURVED)
    half = 0.5 * dt_s * turn
    x, z, a = compose(travel[base], travel[base + 1], travel[base + 2], 0.0, 0.0, half)
    x, z, a = compose(0.0, 0.0, half, x, z, a)
    travel[3 * node], travel[3 * node + 1], travel[3 * node + 2] = x, z, a
