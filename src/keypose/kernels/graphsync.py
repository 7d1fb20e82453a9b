# pyright: basic
"""Places among the sync markers of an animation graph, as `keypose.play.graph.synchrony` has them."""

from __future__ import annotations

import numpy as np

from keypose.kernels.graphtables import (
    AT,
    AT_SHARE,
    BY_ITSELF,
    CHILDREN,
    CLIP,
    COUNT,
    DATA,
    DRIVEN,
    DT,
    DURATION,
    FASTEST,
    FIELDS,
    FLOATS,
    INTS,
    KIND,
    MEMBER_COUNT,
    MEMBERS,
    MIX,
    MODE,
    NODES,
    NUMBERS,
    REALS,
    SECONDS,
    SHARE,
    SLOWEST,
    SOURCE,
    SPEED,
    STATE_FLOATS,
    STATE_INTS,
    SYNC_AT,
    SYNCED,
    SYNCS,
    USED,
    WARP,
    WEIGHT,
    WORDS,
    A,
    B,
    C,
    number,
)
from keypose.kernels.graphweights import weigh
from keypose.kernels.runtime import exact_inlined, exact_kernel
from keypose.kernels.vectors import float64_at, int64_at


@exact_inlined
def _marker_seconds(reals, at, count, duration, interval):
    i = interval % count
    after = reals[at + i + 1] if i + 1 < count else reals[at] + duration
    return after - reals[at + i]


@exact_inlined
def _time_of_place(reals, at, count, duration, interval, share):
    """Loop and time inside it of a place among the markers."""
    i = interval % count
    loop = (interval - i) // count
    time = reals[at + i] + share * _marker_seconds(reals, at, count, duration, i)
    while time >= duration:
        loop, time = loop + 1, time - duration
    return loop, time


@exact_kernel
def position(h, node):
    """Where a node stands among its sync markers."""
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, ints = float64_at(h[STATE_FLOATS]), int64_at(h[STATE_INTS])
    source = nodes[node * FIELDS + SOURCE]
    if source < 0:
        return 0, 0.0
    row = source * FIELDS
    if nodes[row + KIND] == MIX:
        return ints[nodes[row + INTS]], floats[nodes[row + FLOATS]]
    data, duration = nodes[row + DATA], reals[nodes[row + NUMBERS] + DURATION]
    count, at = words[data + SYNCS], words[data + SYNC_AT]
    loop, time = ints[nodes[row + INTS]], floats[nodes[row + FLOATS]]
    if time < reals[at]:
        loop, time = loop - 1, time + duration
    i = 0
    while i + 1 < count and reals[at + i + 1] <= time:
        i += 1
    share = (time - reals[at + i]) / _marker_seconds(reals, at, count, duration, i)
    return loop * count + i, min(max(share, 0.0), 1.0)


@exact_inlined
def _clamped(loops, duration, loop, time):
    if loops > 0 and loop >= loops:
        loop, time = loops - 1, duration
    elif loops > 0 and loop < 0:
        loop, time = 0, 0.0
    return loop, time


@exact_kernel
def place(h, node, interval, share):
    """Take all that is synchronised below a node to a place, without events and without travel."""
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, ints = float64_at(h[STATE_FLOATS]), int64_at(h[STATE_INTS])
    members = nodes[node * FIELDS + MEMBERS]
    for m in range(nodes[node * FIELDS + MEMBER_COUNT]):
        row = words[members + m] * FIELDS
        at, loop_at = nodes[row + FLOATS], nodes[row + INTS]
        if nodes[row + KIND] == MIX:
            ints[loop_at], ints[loop_at + 1], floats[at] = interval, interval, share
        elif nodes[row + KIND] == CLIP:
            data, duration = nodes[row + DATA], reals[nodes[row + NUMBERS] + DURATION]
            loop, time = _time_of_place(reals, words[data + SYNC_AT], words[data + SYNCS], duration, interval, share)
            loop, time = _clamped(nodes[row + C], duration, loop, time)
            ints[loop_at], floats[at], floats[at + 1] = loop, time, loop + time / duration


@exact_kernel
def weigh_members(h, node):
    nodes, words = int64_at(h[NODES]), int64_at(h[WORDS])
    members = nodes[node * FIELDS + MEMBERS]
    for m in range(nodes[node * FIELDS + MEMBER_COUNT]):
        if nodes[words[members + m] * FIELDS + KIND] == MIX:
            weigh(h, words[members + m])


@exact_kernel
def seconds(h, node, interval):
    """How long a node would take from one sync marker to the next; its mixtures are weighed."""
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, share, seconds = float64_at(h[STATE_FLOATS]), float64_at(h[SHARE]), float64_at(h[SECONDS])
    members = nodes[node * FIELDS + MEMBERS]
    for m in range(nodes[node * FIELDS + MEMBER_COUNT]):
        own = words[members + m]
        row = own * FIELDS
        kind, numbers = nodes[row + KIND], nodes[row + NUMBERS]
        if kind == CLIP:
            data = nodes[row + DATA]
            length = _marker_seconds(
                reals, words[data + SYNC_AT], words[data + SYNCS], reals[numbers + DURATION], interval
            )
            speed = number(floats, nodes[row + A], reals[numbers + SPEED])
            seconds[own] = length / min(max(abs(speed), SLOWEST), FASTEST)
        elif kind == MIX:
            total, mean, plain, count = 0.0, 0.0, 0.0, 0
            for i in range(nodes[row + COUNT]):
                child = words[nodes[row + CHILDREN] + i]
                if nodes[child * FIELDS + SYNCED]:
                    total += share[child]
                    mean += share[child] * seconds[child]
                    plain += seconds[child]
                    count += 1
            seconds[own] = mean / total if total > 0 else plain / count
        elif kind == WARP:
            seconds[own] = seconds[own + 1] / max(number(floats, nodes[row + A], reals[numbers]), SLOWEST)
        else:
            seconds[own] = seconds[own + 1]
    return seconds[node]


@exact_kernel
def progress(h, first, second, fade, interval, share, dt_s):
    """The place after a time; with a second node, intervals last as long as the mean of both says."""
    while dt_s > 0:
        length = seconds(h, first, interval)
        if second >= 0:
            length = (1.0 - fade) * length + fade * seconds(h, second, interval)
        length = max(length, 1e-6)
        left = (1.0 - share) * length
        if dt_s < left:
            return interval, share + dt_s / length
        dt_s -= left
        interval, share = interval + 1, 0.0
    return interval, share


@exact_kernel
def play_mix(h, node, own_mode, dt_s, weight):
    """Say how the children of a mixture play, each by itself or all in step."""
    nodes, words = int64_at(h[NODES]), int64_at(h[WORDS])
    floats, ints, mode, dts = float64_at(h[STATE_FLOATS]), int64_at(h[STATE_INTS]), int64_at(h[MODE]), float64_at(h[DT])
    weights, ats, shares = float64_at(h[WEIGHT]), int64_at(h[AT]), float64_at(h[AT_SHARE])
    share, used = float64_at(h[SHARE]), float64_at(h[USED])
    row = node * FIELDS
    children, group = nodes[row + CHILDREN], nodes[row + B]
    interval, where = ats[node], shares[node]
    if group and own_mode == BY_ITSELF:
        weigh_members(h, node)
        interval, where = progress(
            h, node, np.int64(-1), 0.0, ints[nodes[row + INTS]], floats[nodes[row + FLOATS]], dt_s
        )
    else:
        weigh(h, node)
    if group:
        ints[nodes[row + INTS]], floats[nodes[row + FLOATS]] = interval, where
    for i in range(nodes[row + COUNT]):
        child = words[children + i]
        used[child] = share[child]
        dts[child], weights[child], ats[child], shares[child] = dt_s, weight * share[child], interval, where
        mode[child] = DRIVEN if group and nodes[child * FIELDS + SYNCED] else BY_ITSELF
