# pyright: basic
"""One step of an animation graph for one character: its numbers move on, then its pose is put together."""

from __future__ import annotations

from keypose.kernels.graphclips import in_clip, play_clip, steer
from keypose.kernels.graphmachines import begin_due, play_machine, travel_of_machine
from keypose.kernels.graphposes import (
    ONE,
    TWO,
    ZERO,
    add_to,
    apply_offset,
    begin_offset,
    copy_row,
    fade_dead,
    fade_held,
    hold,
    lay_over,
    mix,
    push_row,
    push_sample,
    remember,
    room_of,
)
from keypose.kernels.graphsolvers import bend, look, plant, reach
from keypose.kernels.graphsync import play_mix
from keypose.kernels.graphtables import (
    ADD,
    AT,
    AT_SHARE,
    BY_ITSELF,
    CHILDREN,
    CLIP,
    COUNT,
    DATA,
    DEAD,
    DRIVEN,
    DT,
    DURATION,
    EFFECTORS,
    END,
    FIELDS,
    FLOATS,
    FRESH,
    HOW,
    INERTIAL,
    INTS,
    KIND,
    LOCAL_DT,
    LONGEST_STEP_S,
    LOOK,
    MACHINE,
    MIX,
    MODE,
    NODE_COUNT,
    NODES,
    NONE,
    NUMBERS,
    OPEN,
    ORDER,
    OVER,
    PENDING,
    PLANT,
    REACH,
    REALS,
    REST,
    RESTING,
    SEEN,
    SHARE,
    STARTS,
    STATE_FLOATS,
    STATE_INTS,
    STEER,
    STEP_NUMBER,
    STILL_PLAYS,
    SYNCED,
    TRANSITION,
    TRAVEL,
    USED,
    VALUE_WEIGHT,
    WARP,
    WEIGHT,
    WORDS,
    A,
    B,
    C,
    D,
    number,
    smooth,
    top_amount,
)
from keypose.kernels.graphweights import weigh
from keypose.kernels.runtime import exact_kernel, kernel
from keypose.kernels.vectors import float64_at, int64_at


@exact_kernel
def control(h, dt_s):
    """Move one character's numbers on; its travel is left at node 0 of ``TRAVEL``."""
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, mode, dts, weights = (
        float64_at(h[STATE_FLOATS]),
        int64_at(h[MODE]),
        float64_at(h[DT]),
        float64_at(h[WEIGHT]),
    )
    ats, shares, used = int64_at(h[AT]), float64_at(h[AT_SHARE]), float64_at(h[USED])
    travel, order, pending = float64_at(h[TRAVEL]), int64_at(h[ORDER]), int64_at(h[PENDING])
    local_dt, fresh = float64_at(h[LOCAL_DT]), int64_at(h[FRESH])
    count = h[NODE_COUNT]
    for i in range(count):
        pending[i], local_dt[i] = 0, 0.0
    mode[0], dts[0], weights[0] = BY_ITSELF, dt_s, 1.0
    playing, i = 0, ZERO
    while i < count:
        row = i * FIELDS
        own, dt, weight = mode[i], dts[i], weights[i]
        if own == STILL_PLAYS:
            i = nodes[row + END]
            continue
        if own == DRIVEN and not nodes[row + SYNCED]:
            own = BY_ITSELF
        order[playing] = i
        playing += 1
        kind = nodes[row + KIND]
        if kind == CLIP:
            play_clip(h, i, own, dt, weight)
        elif kind == MIX:
            play_mix(h, i, own, dt, weight)
        elif kind == MACHINE:
            local_dt[i] = dt
            fresh[i] = begin_due(h, i, dt)
            if pending[i] == 1 + INERTIAL and nodes[row + D] >= 0:
                _start(h, i)
            play_machine(h, i, dt, weight)
        elif kind != REST:
            base = i + 1
            mode[base], dts[base], weights[base] = own, dt, weight
            ats[base], shares[base] = ats[i], shares[i]
            if kind == WARP:
                speed = number(floats, nodes[row + A], reals[nodes[row + NUMBERS]])
                dts[base] = min(dt * max(speed, 0.0), LONGEST_STEP_S)
            elif kind in (OVER, ADD):
                top = nodes[row + B]
                mode[top], dts[top] = BY_ITSELF, dt
                weights[top] = weight * min(abs(top_amount(nodes, reals, floats, i)), 1.0)
        i += 1
    for n in range(playing - 1, -1, -1):
        i = order[n]
        row = i * FIELDS
        kind = nodes[row + KIND]
        if kind == MACHINE:
            travel_of_machine(h, i, dts[i])
        elif kind == MIX:
            total, x, z, a = 0.0, 0.0, 0.0, 0.0
            for k in range(nodes[row + COUNT]):
                child = words[nodes[row + CHILDREN] + k]
                total += used[child]
                x += used[child] * travel[3 * child]
                z += used[child] * travel[3 * child + 1]
                a += used[child] * travel[3 * child + 2]
            still = not total > 0
            travel[3 * i] = 0.0 if still else x / total
            travel[3 * i + 1] = 0.0 if still else z / total
            travel[3 * i + 2] = 0.0 if still else a / total
        elif kind == STEER:
            steer(h, i, dts[i])
        elif kind == REST:
            travel[3 * i], travel[3 * i + 1], travel[3 * i + 2] = 0.0, 0.0, 0.0
        elif kind != CLIP:
            for k in range(3):
                travel[3 * i + k] = travel[3 * i + 3 + k]


@kernel
def _start(h, node):
    """The pose that a machine's new state starts with, kept for when the state's pose at the end of the step is there."""
    nodes, words, ints = int64_at(h[NODES]), int64_at(h[WORDS]), int64_at(h[STATE_INTS])
    row = node * FIELDS
    target = words[nodes[row + CHILDREN] + ints[nodes[row + INTS]]]
    pose(h, target, ONE)
    copy_row(h, ONE, int64_at(h[STARTS])[nodes[row + D]])


@kernel
def pose(h, top, p):
    """The pose of a node and all that is seen below it, left as value ``p``."""
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, ints, share = float64_at(h[STATE_FLOATS]), int64_at(h[STATE_INTS]), float64_at(h[SHARE])
    seen, opened = int64_at(h[SEEN]), int64_at(h[OPEN])
    seen[top] = 1
    open_count, i, end = 0, top, nodes[top * FIELDS + END]
    while True:
        while open_count > 0 and i >= nodes[opened[open_count - 1] * FIELDS + END]:
            open_count -= 1
            p = _finish(h, opened[open_count], p)
        if i >= end:
            break
        row = i * FIELDS
        if not seen[i]:
            i = nodes[row + END]
            continue
        kind = nodes[row + KIND]
        if kind == CLIP:
            time = in_clip(
                words, reals, nodes[row + DATA], reals[nodes[row + NUMBERS] + DURATION], floats[nodes[row + FLOATS]]
            )
            push_sample(h, p, nodes[row + B], time)
            p += 1
        elif kind == REST:
            push_row(h, p, h[RESTING])
            p += 1
        else:
            if kind == MIX:
                weigh(h, i)
                for k in range(nodes[row + COUNT]):
                    child = words[nodes[row + CHILDREN] + k]
                    seen[child] = 1 if share[child] > 0 else 0
            elif kind == MACHINE:
                at = nodes[row + INTS]
                for k in range(nodes[row + COUNT]):
                    seen[words[nodes[row + CHILDREN] + k]] = 0
                seen[words[nodes[row + CHILDREN] + ints[at]]] = 1
                if ints[at + 3] != NONE and ints[at + 1] >= 0:
                    seen[words[nodes[row + CHILDREN] + ints[at + 1]]] = 1
            else:
                seen[i + 1] = 1
                if kind in (OVER, ADD):
                    seen[nodes[row + B]] = 1 if top_amount(nodes, reals, floats, i) != 0 else 0
            opened[open_count] = i
            open_count += 1
        i += 1


@kernel
def _finish(h, node, p):
    """Join what is below a node, the values under ``p``, to its own; returns the number of values."""
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, share, weights = float64_at(h[STATE_FLOATS]), float64_at(h[SHARE]), float64_at(h[VALUE_WEIGHT])
    row = node * FIELDS
    kind, data, numbers = nodes[row + KIND], nodes[row + DATA], nodes[row + NUMBERS]
    if kind == MIX:
        total, count = 0.0, ZERO
        for k in range(nodes[row + COUNT]):
            child = words[nodes[row + CHILDREN] + k]
            if share[child] > 0:
                total += share[child]
                count += 1
        first = p - count
        if count > 1:
            n = first
            for k in range(nodes[row + COUNT]):
                child = words[nodes[row + CHILDREN] + k]
                if share[child] > 0:
                    weights[n] = share[child] / total
                    n += 1
            mix(h, first, count, room_of(h, first))
        return first + 1
    if kind == MACHINE:
        return _finish_machine(h, node, p)
    if kind in (OVER, ADD):
        amount = top_amount(nodes, reals, floats, node)
        if amount == 0:
            return p
        if kind == OVER:
            lay_over(h, p - 2, nodes[row + C], amount)
        else:
            add_to(h, p - 2, nodes[row + C], amount, nodes[row + D])
        return p - 1
    if kind == STEER:
        way = nodes[row + FLOATS]
        if floats[way + 2] != 0 and h[EFFECTORS] > 0:
            bend(h, p - 1, floats[way], floats[way + 1], floats[way + 2])
    elif kind in (LOOK, REACH, PLANT):
        weight = min(max(number(floats, nodes[row + A], reals[numbers]), 0.0), 1.0)
        if weight == 0:
            return p
        if kind == PLANT:
            plant(h, p - 1, data, numbers + 1, weight)
        else:
            target = nodes[row + C]
            x, y, z = floats[target], floats[target + 1], floats[target + 2]
            if kind == LOOK:
                look(h, p - 1, data, numbers + 1, x, y, z, weight)
            else:
                reach(h, p - 1, data, numbers + 1, x, y, z, weight)
    return p


@kernel
def _finish_machine(h, node, p):
    """The state, or both states of a transition, or the state and the memory; then what the machine remembers."""
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, ints, weights = float64_at(h[STATE_FLOATS]), int64_at(h[STATE_INTS]), float64_at(h[VALUE_WEIGHT])
    pending = int64_at(h[PENDING])
    row = node * FIELDS
    at, elapsed, m = nodes[row + INTS], floats[nodes[row + FLOATS]], nodes[row + D]
    begins, pending[node] = pending[node], 0
    running = ints[at + 3]
    dt_s = float64_at(h[LOCAL_DT])[node]
    if running != NONE:
        duration = reals[nodes[row + NUMBERS] + 2 * running + 1]
        kind = words[nodes[row + DATA] + running * TRANSITION + HOW]
        share = smooth(elapsed / duration)
        if ints[at + 1] >= 0:
            # Values lie in the order of the states.
            later = ints[at] > ints[at + 1]
            weights[p - 2], weights[p - 1] = (1.0 - share, share) if later else (share, 1.0 - share)
            mix(h, p - 2, TWO, room_of(h, p - 2))
            p -= 1
        else:
            if begins:
                if kind == INERTIAL:
                    begin_offset(h, p - 1, m, int64_at(h[STARTS])[m], dt_s, duration)
                else:
                    hold(h, p - 1, m, kind == DEAD)
                ints[at + 5] = 1
            if ints[at + 5]:
                if kind == INERTIAL:
                    apply_offset(h, p - 1, m, elapsed)
                elif kind == DEAD:
                    fade_dead(h, p - 1, m, elapsed, share)
                else:
                    fade_held(h, p - 1, m, share)
    fresh = ints[at + 4] < h[STEP_NUMBER] - 1
    if m >= 0:
        remember(h, p - 1, m, dt_s, fresh)
    ints[at + 4] = h[STEP_NUMBER]
    return p
