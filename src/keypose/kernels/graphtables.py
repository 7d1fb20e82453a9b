# pyright: basic
"""The tables that animation graphs are for kernels (made by `keypose.play.graph.tables`), and what all their kernels share.

Nodes are numbered so that a node comes before all that is below it, and a subtree is a range. No function calls itself:
what a parent decides for its children (whether they play, by how much time, to which place, how much they are seen) is
written beside them before they are reached; what children give back is gathered on the way up, in the reverse order. The
scalar arithmetic is done in the order of the reference (`keypose.play.graph.control` and `machine`), without fusing products
and sums, so that both decide alike.
"""

from __future__ import annotations

from keypose.kernels.runtime import exact_inlined

# One row of the table of nodes.
FIELDS = 19
(
    KIND, END, SYNCED, FLOATS, INTS, DATA, NUMBERS, COUNT, CHILDREN, ENTER, ENTER_COUNT, MEMBERS, MEMBER_COUNT, SOURCE,
    A, B, C, D, INDEX,
) = range(FIELDS)  # fmt: skip
REST, CLIP, MIX, OVER, ADD, WARP, STEER, LOOK, REACH, PLANT, MACHINE = range(11)
LINE, PLANE, BANDS, SHARES = range(4)
CROSSFADE, FROZEN, INERTIAL, DEAD = range(4)
INTERRUPTS = ("none", "source", "target", "both")
TESTS = ("set", "not set", ">", ">=", "<", "<=", "==", "!=")
# A clip's row of integers.
WARPS, WARP_AT, SYNCS, SYNC_AT, EVENTS, EVENT_AT, EVENT_ID, FRAMES, TRACK_AT = range(9)
# A clip's numbers.
SPEED, DURATION, START, RATE = range(4)
# A transition's integers; its numbers are exit time and duration.
TRANSITION = 8
FROM, TO, HOW, INTERRUPT, IN_STEP, CONDITIONS, CONDITION_AT, HAS_EXIT = range(TRANSITION)
NONE, MEMORY = -1, -2

# Where the array of sizes and addresses holds what.
(
    NODE_COUNT, NODES, WORDS, REALS, STATE_FLOATS, STATE_INTS, STEP_NUMBER, CHARACTER, MODE, DT, WEIGHT, AT, AT_SHARE, TRAVEL,
    SHARE, USED, SECONDS, ORDER, PENDING, LOCAL_DT, FADE, BEFORE, FRESH, QUEUE, QUEUE_WEIGHTS, QUEUE_ROOM, QUEUED,
    ROOT_STEP, CLIP_HANDLES, VALUE_A, VALUE_B, EXTRA_A, EXTRA_B, VALUE_T, EXTRA_T, VALUE_WEIGHT, STACK, POSE, LINEAR, EXTRAS,
    SEEN, OPEN, MEMORIES, MEMORY_SIZE, MEMORY_COUNT, MEMORY_NUMBERS, STARTS, MASKS, REFERENCES, RESTING, EXTRA_TABLES,
    FINAL, JOINTS, JOINTS_NOW, EFFECTORS, CURVES, CHAIN, PADDED, PARENTS,
) = range(59)  # fmt: skip
EVENT, CHANGE, CUT_SHORT = range(3)  # kinds of queue entries: an event, a transition, one that breaks another off
QUEUE_ROW = 4
STILL_PLAYS, BY_ITSELF, DRIVEN = range(3)  # MODE: it does not play, moves on by DT, or to the place AT

FASTEST, SLOW_M_S, MOST_CURVED, SLOWEST, LONGEST_STEP_S = 100.0, 0.1, 3.0, 1e-3, 60.0
DEAD_HALF_LIFE_S = 0.2


@exact_inlined
def number(floats, slot, constant):
    """A number, or the parameter in its place."""
    return constant if slot < 0 else floats[slot]


@exact_inlined
def smooth(u):
    """0 to 1 with no speed at both ends."""
    u = min(max(u, 0.0), 1.0)
    return u * u * (3.0 - 2.0 * u)


@exact_inlined
def top_amount(nodes, reals, floats, node):
    """How much a second node covers of its base, or adds to it."""
    row = node * FIELDS
    amount = number(floats, nodes[row + A], reals[nodes[row + NUMBERS]])
    low, high = (0.0, 1.0) if nodes[row + KIND] == OVER else (-10.0, 10.0)
    return min(max(amount, low), high)
