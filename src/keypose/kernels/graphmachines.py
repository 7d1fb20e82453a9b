# pyright: basic
"""Entering nodes of an animation graph, how often they have played, and state machines."""

from __future__ import annotations

import numpy as np

from keypose.kernels.graphclips import _queue
from keypose.kernels.graphsync import place, position, progress, weigh_members
from keypose.kernels.graphtables import (
    AT,
    AT_SHARE,
    BEFORE,
    BY_ITSELF,
    CHANGE,
    CHILDREN,
    CLIP,
    CONDITION_AT,
    CONDITIONS,
    COUNT,
    CROSSFADE,
    CUT_SHORT,
    DATA,
    DEAD,
    DEAD_HALF_LIFE_S,
    DRIVEN,
    DT,
    DURATION,
    ENTER,
    ENTER_COUNT,
    FADE,
    FIELDS,
    FLOATS,
    FRESH,
    FROM,
    HAS_EXIT,
    HOW,
    IN_STEP,
    INERTIAL,
    INTERRUPT,
    INTS,
    KIND,
    MACHINE,
    MEMORY,
    MIX,
    MODE,
    NODES,
    NONE,
    NUMBERS,
    PENDING,
    REALS,
    REST,
    SHARE,
    SPEED,
    START,
    STATE_FLOATS,
    STATE_INTS,
    STEER,
    STEP_NUMBER,
    STILL_PLAYS,
    SYNCED,
    TO,
    TRANSITION,
    TRAVEL,
    WEIGHT,
    WORDS,
    A,
    B,
    C,
    D,
    number,
    smooth,
)
from keypose.kernels.graphweights import weigh
from keypose.kernels.runtime import exact_inlined, exact_kernel
from keypose.kernels.vectors import float64_at, int64_at


@exact_kernel
def enter(h, node):
    """Start a node and all below it from the beginning."""
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, ints = float64_at(h[STATE_FLOATS]), int64_at(h[STATE_INTS])
    first = nodes[node * FIELDS + ENTER]
    for m in range(nodes[node * FIELDS + ENTER_COUNT]):
        own = words[first + m]
        row = own * FIELDS
        kind, at, loop_at, numbers = nodes[row + KIND], nodes[row + FLOATS], nodes[row + INTS], nodes[row + NUMBERS]
        if kind == CLIP:
            duration, loops = reals[numbers + DURATION], nodes[row + C]
            back = number(floats, nodes[row + A], reals[numbers + SPEED]) < 0
            share = 1.0 - reals[numbers + START] if back else reals[numbers + START]
            loop = max(loops - 1, 0) if back else 0
            if loops == 0 and share >= 1.0:
                share -= 1.0
            floats[at], ints[loop_at], floats[at + 1] = share * duration, loop, loop + share
        elif kind == MIX:
            if nodes[row + B]:
                lead = nodes[row + D]
                interval, share = position(h, lead)
                place(h, own, interval, share)
        elif kind == STEER:
            floats[at], floats[at + 1], floats[at + 2] = 0.0, 1.0, 0.0
        elif kind == MACHINE:
            ints[loop_at], ints[loop_at + 1], ints[loop_at + 2] = nodes[row + A], NONE, NONE
            ints[loop_at + 3], ints[loop_at + 4], ints[loop_at + 5] = NONE, -2, 0
            for i in range(7):
                floats[at + i] = 0.0
            int64_at(h[PENDING])[own] = 0


@exact_kernel
def cycles(h, node):
    """How many times a node has played since it was entered."""
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, ints, share = float64_at(h[STATE_FLOATS]), int64_at(h[STATE_INTS]), float64_at(h[SHARE])
    while True:
        row = node * FIELDS
        kind = nodes[row + KIND]
        if kind == REST:
            return np.inf
        if kind == CLIP:
            duration = reals[nodes[row + NUMBERS] + DURATION]
            if duration <= 0:
                return np.inf
            at = nodes[row + FLOATS]
            return abs(ints[nodes[row + INTS]] + floats[at] / duration - floats[at + 1])
        if kind == MIX:
            if nodes[row + B]:
                at = nodes[row + INTS]
                return (ints[at] - ints[at + 1] + floats[nodes[row + FLOATS]]) / nodes[row + C]
            weigh(h, node)
            children = nodes[row + CHILDREN]
            node = words[children]
            for i in range(1, nodes[row + COUNT]):
                if share[words[children + i]] > share[node]:
                    node = words[children + i]
        elif kind == MACHINE:
            node = words[nodes[row + CHILDREN] + ints[nodes[row + INTS]]]
        else:
            node = node + 1


@exact_inlined
def _holds(words, reals, floats, at):
    """A condition: slot, test, whether it is a trigger, where its number is."""
    x, y, test = floats[words[at]], reals[words[at + 3]], words[at + 1]
    result = x != y
    if test == 0:
        result = x != 0
    elif test == 1:
        result = x == 0
    elif test == 2:
        result = x > y
    elif test == 3:
        result = x >= y
    elif test == 4:
        result = x < y
    elif test == 5:
        result = x <= y
    elif test == 6:
        result = x == y
    return result


@exact_kernel
def _due(h, node):
    """The first transition that may begin now."""
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, ints = float64_at(h[STATE_FLOATS]), int64_at(h[STATE_INTS])
    row = node * FIELDS
    at, table, numbers = nodes[row + INTS], nodes[row + DATA], nodes[row + NUMBERS]
    state, origin, running = ints[at], ints[at + 2], ints[at + 3]
    first, second, anywhere = state, -3, True
    if running != NONE:
        allowed = words[table + running * TRANSITION + INTERRUPT]
        first = origin if allowed == 1 or allowed == 3 else -3
        second = state if allowed >= 2 else -3
        anywhere = allowed != 0
    for i in range(nodes[row + C]):
        t = table + i * TRANSITION
        source = words[t + FROM]
        if source == NONE:
            if not anywhere or words[t + TO] == state:
                continue
        elif (source != first and source != second) or (running != NONE and i == running):
            continue
        if words[t + HAS_EXIT]:
            leaving = state if source == NONE else source
            if cycles(h, words[nodes[row + CHILDREN] + leaving]) < reals[numbers + 2 * i]:
                continue
        good = True
        for c in range(words[t + CONDITIONS]):
            good = good and _holds(words, reals, floats, words[t + CONDITION_AT] + 4 * c)
        if good:
            return i
    return NONE


@exact_kernel
def _begin(h, node, index):
    """Begin a transition; what must be done with the old pose is left in ``PENDING``."""
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, ints, pending = float64_at(h[STATE_FLOATS]), int64_at(h[STATE_INTS]), int64_at(h[PENDING])
    row = node * FIELDS
    at, elapsed, children = nodes[row + INTS], nodes[row + FLOATS], nodes[row + CHILDREN]
    t = nodes[row + DATA] + index * TRANSITION
    old, running, state = ints[at], ints[at + 3], words[t + TO]
    for c in range(words[t + CONDITIONS]):
        condition = words[t + CONDITION_AT] + 4 * c
        if words[condition + 2]:
            floats[words[condition]] = 0.0
    _queue(h, CUT_SHORT if running != NONE else CHANGE, index, node, float(old))
    target = words[children + state]
    both = words[t + IN_STEP] and nodes[target * FIELDS + SYNCED] and nodes[words[children + old] * FIELDS + SYNCED]
    interval, share = position(h, words[children + old]) if both else (0, 0.0)
    enter(h, target)
    if both:
        place(h, target, interval, share)
    pending[node] = 0
    floats[elapsed] = 0.0
    for i in range(3):
        floats[elapsed + 4 + i] = floats[elapsed + 1 + i]
    ints[at] = state
    if reals[nodes[row + NUMBERS] + 2 * index + 1] == 0:
        ints[at + 1], ints[at + 2], ints[at + 3] = NONE, NONE, NONE
        return
    remembered = words[t + HOW] != CROSSFADE or running != NONE or state == old
    ints[at + 1], ints[at + 2], ints[at + 3] = MEMORY if remembered else old, old, index
    ints[at + 5] = 0
    if remembered and ints[at + 4] == h[STEP_NUMBER] - 1:
        pending[node] = 1 + words[t + HOW]


@exact_inlined
def begin_due(h, node, dt_s):
    """Take the transitions that are due; whether any was."""
    fresh = 0
    if dt_s > 0:
        for _ in range(int64_at(h[NODES])[node * FIELDS + COUNT] + 1):
            due = _due(h, node)
            if due == NONE:
                break
            _begin(h, node, due)
            fresh = 1
    return fresh


@exact_kernel
def play_machine(h, node, dt_s, weight):
    """Say which states play, and how."""
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, ints, mode, dts = float64_at(h[STATE_FLOATS]), int64_at(h[STATE_INTS]), int64_at(h[MODE]), float64_at(h[DT])
    weights, ats, shares = float64_at(h[WEIGHT]), int64_at(h[AT]), float64_at(h[AT_SHARE])
    row = node * FIELDS
    at, children = nodes[row + INTS], nodes[row + CHILDREN]
    for i in range(nodes[row + COUNT]):
        mode[words[children + i]] = STILL_PLAYS
    running = ints[at + 3]
    target = words[children + ints[at]]
    mode[target], dts[target], weights[target] = BY_ITSELF, dt_s, weight
    if running == NONE:
        return
    elapsed = nodes[row + FLOATS]
    duration = reals[nodes[row + NUMBERS] + 2 * running + 1]
    before = floats[elapsed]
    floats[elapsed] = before + dt_s
    share = smooth(floats[elapsed] / duration)
    float64_at(h[FADE])[node], float64_at(h[BEFORE])[node] = share, before
    weights[target] = weight * share
    if ints[at + 1] >= 0:
        source = words[children + ints[at + 1]]
        mode[source], dts[source], weights[source] = BY_ITSELF, dt_s, weight * (1.0 - share)
        in_step = words[nodes[row + DATA] + running * TRANSITION + IN_STEP]
        if in_step and nodes[source * FIELDS + SYNCED] and nodes[target * FIELDS + SYNCED]:
            weigh_members(h, source)
            weigh_members(h, target)
            interval, where = position(h, target)
            interval, where = progress(h, source, target, share, interval, where, dt_s)
            mode[source], ats[source], shares[source] = DRIVEN, interval, where
            mode[target], ats[target], shares[target] = DRIVEN, interval, where


@exact_inlined
def _quintic(x0, v0, elapsed_s, duration_s):
    """As `keypose.play.graph.transitions.quintic`."""
    side = -1.0 if x0 < 0 else 1.0
    x, v = side * x0, side * v0
    reached = -x / (v * duration_s) if v < 0 else 0.0
    t1 = duration_s * max(min(5.0 * reached, 1.0), 1.0 - 10.0 * reached)
    a0 = min(15.0 * reached, 1.0) * max((-8.0 * v * t1 - 20.0 * x) / (t1 * t1), 0.0)
    u = min(elapsed_s / t1, 1.0)
    a, w = a0 * t1 * t1, v * t1
    c5 = -(a + 6.0 * w + 12.0 * x) / 2
    c4 = (3.0 * a + 16.0 * w + 30.0 * x) / 2
    c3 = -(3.0 * a + 12.0 * w + 20.0 * x) / 2
    left = ((((c5 * u + c4) * u + c3) * u + a / 2) * u + w) * u + x
    return 0.0 if u >= 1.0 else side * left


@exact_kernel
def travel_of_machine(h, node, dt_s):
    """The travel of what plays, with what a transition keeps of the old one's velocity; ends the transition."""
    nodes, words, reals = int64_at(h[NODES]), int64_at(h[WORDS]), float64_at(h[REALS])
    floats, ints, travel = float64_at(h[STATE_FLOATS]), int64_at(h[STATE_INTS]), float64_at(h[TRAVEL])
    row = node * FIELDS
    at, children, elapsed = nodes[row + INTS], nodes[row + CHILDREN], nodes[row + FLOATS]
    running = ints[at + 3]
    target, own = 3 * words[children + ints[at]], 3 * node
    if running == NONE:
        for i in range(3):
            travel[own + i] = travel[target + i]
    else:
        duration = reals[nodes[row + NUMBERS] + 2 * running + 1]
        share, before = float64_at(h[FADE])[node], float64_at(h[BEFORE])[node]
        kind = words[nodes[row + DATA] + running * TRANSITION + HOW]
        if ints[at + 1] >= 0:
            source = 3 * words[children + ints[at + 1]]
            total = (1.0 - share) + share
            for i in range(3):
                travel[own + i] = ((1.0 - share) * travel[source + i] + share * travel[target + i]) / total
        elif dt_s <= 0:
            for i in range(3):
                travel[own + i] = 0.0
        elif kind == INERTIAL:
            if int64_at(h[FRESH])[node]:
                for i in range(3):
                    floats[elapsed + 4 + i] -= travel[target + i] / dt_s
            middle = min(before + 0.5 * dt_s, duration)
            left = _quintic(1.0, 0.0, middle, duration) * min(duration - before, dt_s)
            for i in range(3):
                travel[own + i] = travel[target + i] + floats[elapsed + 4 + i] * left
        else:
            slowed = 2.0 ** (-before / DEAD_HALF_LIFE_S) if kind == DEAD else 1.0
            total = (1.0 - share) + share
            for i in range(3):
                old = floats[elapsed + 4 + i] * slowed * dt_s
                travel[own + i] = ((1.0 - share) * old + share * travel[target + i]) / total
        if floats[elapsed] >= duration:
            ints[at + 1], ints[at + 2], ints[at + 3] = NONE, NONE, NONE
    if dt_s > 0:
        for i in range(3):
            floats[elapsed + 1 + i] = travel[own + i] / dt_s
