"""Where the characters of a crowd go: wandering, following, streams and gatherings, without running into each other.

Steering knows no graph. It looks at the roots and says a speed, a turn, a look, a wave and a jump for each character, which
are what a graph of locomotion takes as parameters. The same seed and the same roots give the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from keypose.arrays import Array, Floats, Ints
from keypose.errors import ShapeError, UnknownName

Behaviour = Literal["wander", "follow", "stream", "gather"]
BEHAVIOURS: tuple[Behaviour, ...] = get_args(Behaviour)

DECIDE_S = 0.1  # between two decisions
BODY_M = 0.32  # radius that a person claims
_NEIGHBOURS = 8
_SEEN_M = 4.0
_HORIZON_S = 3.0  # collisions farther off than this move nobody
_URGE = 1.5  # strength of the power law, m2/s2
_YIELD = 0.6  # share of the force that a person gives in to
_WALK_M_S, _STROLL_M_S, _RUN_M_S = 1.21, (1.21, 1.55), (2.4, 3.1)
_START_M_S, _STOP_M_S = 0.75, 0.45
_TURN_DEG_S = 110.0
_SHUFFLE = 0.12  # radians that one who stands turns in one decision
_EDGE_M = 1.6
_PUSH_M = 0.03  # that one who is in somebody else is moved in one decision, at most
_GROUP = 12  # followers of one leader
_WAVE_S, _JUMP_EVERY_S = 2.6, 45.0


@dataclass(slots=True, eq=False)
class Steering:
    """What a crowd wants; made by `init`, written by `step`.

    Shapes and units:
        speed: (N,) m/s; turn: (N,) degrees per second, to the left positive; wave: (N,) 0 or 1; jump: (N,) bool.
        look: (N,) 0 or 1; look_at: (N, 3) metres, in the character's own space.
        goals: (N, 2) metres; leader: (N,) who is followed, -1 for nobody.
    """

    count: int
    radius_m: float
    behaviour: Behaviour
    rng: np.random.Generator = field(repr=False)
    speed: Floats
    turn: Floats
    wave: Floats
    jump: Array
    look: Floats
    look_at: Floats
    goals: Floats
    leader: Ints
    pace: Floats  # what each likes to walk at
    resting_s: Floats  # how long each still stands
    waving_s: Floats
    blocked_s: Floats
    slot: Floats  # (N, 2) places behind the leader, or in a gathering
    due_s: float = 0.0


def init(count: int, radius_m: float, behaviour: Behaviour = "wander", seed: int = 0) -> Steering:
    """Steering for ``count`` characters on a round place of that radius.

    Raises:
        ShapeError: where a number is not positive.
        UnknownName: for another behaviour.
    """
    if count < 1 or not radius_m > 0:
        raise ShapeError(f"steering: expected a count and a radius above 0, got {count} and {radius_m}")
    if behaviour not in BEHAVIOURS:
        raise UnknownName("behaviour", behaviour, BEHAVIOURS)
    rng = np.random.default_rng(seed)
    zero = np.zeros(count)
    pace = rng.uniform(*_STROLL_M_S, count)
    runs = rng.random(count) < 0.12
    pace[runs] = rng.uniform(*_RUN_M_S, int(runs.sum()))
    made = Steering(
        count, float(radius_m), behaviour, rng, zero.copy(), zero.copy(), zero.copy(), np.zeros(count, bool), zero.copy(),
        np.tile((0.0, 1.5, 3.0), (count, 1)), np.zeros((count, 2)), np.full(count, -1, np.int64), pace,
        rng.uniform(0, 2.5, count), zero.copy(), zero.copy(), np.zeros((count, 2)),
    )  # fmt: skip
    _plan(made)
    return made


def turn_to(steering: Steering, behaviour: Behaviour) -> None:
    """Let the crowd do something else from now on; raises `UnknownName`."""
    if behaviour not in BEHAVIOURS:
        raise UnknownName("behaviour", behaviour, BEHAVIOURS)
    steering.behaviour = behaviour
    _plan(steering)


def place(count: int, radius_m: float, seed: int = 0, apart_m: float = 0.9) -> Floats:
    """Roots (count, 3), x, z and yaw, scattered over a round place: none nearer to another than ``apart_m`` where there is
    room for that."""
    rng = np.random.default_rng(seed + 7919)
    inner = max(radius_m - 1.0, 0.5 * radius_m)
    # A sunflower, shaken: even, and never two in one spot.
    n = np.arange(count) + 0.5
    angle = n * np.pi * (3 - np.sqrt(5))
    away = inner * np.sqrt(n / count)
    spare = max(0.0, inner * np.sqrt(np.pi / count) - apart_m) / 2
    shake = rng.uniform(-1, 1, (count, 2)) * min(spare, 1.0)
    roots = np.stack([away * np.cos(angle), away * np.sin(angle), rng.uniform(-np.pi, np.pi, count)], axis=1)
    roots[:, :2] += shake
    return rng.permutation(roots)


def step(steering: Steering, roots: Floats, dt_s: float) -> bool:
    """Look at the roots (N, 3), decide where it is time to, and keep characters apart; ``roots`` is written.

    Returns whether new decisions were made. Raises `ShapeError` where the roots are not (N, 3).

    Source: I. Karamouzas, B. Skinner, S. Guy, "Universal power law governing pedestrian interactions", 2014.
    """
    s = steering
    if roots.shape != (s.count, 3):
        raise ShapeError(f"roots: expected {(s.count, 3)}, got {roots.shape}")
    s.resting_s = np.maximum(s.resting_s - dt_s, 0.0)
    s.waving_s = np.maximum(s.waving_s - dt_s, 0.0)
    s.jump = np.zeros(s.count, bool)
    s.due_s -= dt_s
    if s.due_s > 0:
        return False
    s.due_s = max(s.due_s + DECIDE_S, 0.0)
    near, away = _neighbours(roots[:, :2])
    _spread(s, roots, near, away)
    _arrive(s, roots)
    _drive(s, roots, near, away)
    _show(s, roots, near, away)
    return True


# --- goals ----------------------------------------------------------------------------------------------------------------


def _somewhere(s: Steering, who: Ints) -> Floats:
    away = (s.radius_m - _EDGE_M) * np.sqrt(s.rng.random(len(who)))
    angle = s.rng.uniform(-np.pi, np.pi, len(who))
    return np.stack([away * np.cos(angle), away * np.sin(angle)], axis=1)


def _plan(s: Steering) -> None:
    """Goals for everybody when a behaviour begins."""
    everyone = np.arange(s.count)
    s.goals = _somewhere(s, everyone)
    s.leader = np.full(s.count, -1, np.int64)
    if s.behaviour == "follow":
        lead = everyone - everyone % _GROUP
        s.leader = np.where(lead == everyone, -1, lead)
        rank = everyone % _GROUP
        row = (rank + 1) // 2
        side = np.where(rank % 2 == 0, 1.0, -1.0) * np.where(row % 2 == 0, 1.5, 0.75)
        s.slot = np.stack([side, -1.15 * row], axis=1)
        s.resting_s[s.leader < 0] = 0.0
    elif s.behaviour == "stream":
        s.goals = _ahead(s, everyone)
        s.resting_s *= 0.3
    elif s.behaviour == "gather":
        # Rings around the middle, a step apart.
        order = s.rng.permutation(s.count)
        ring, first, left = 0, 0, s.count
        while left > 0:
            radius = 2.4 + 1.25 * ring
            room = max(1, min(left, int(2 * np.pi * radius / 1.15)))
            angle = 2 * np.pi * (np.arange(room) + 0.5 * (ring % 2)) / room
            s.goals[order[first : first + room]] = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            ring, first, left = ring + 1, first + room, left - room
        s.resting_s[:] = s.rng.uniform(0, 1.5, s.count)


def _ahead(s: Steering, who: Ints) -> Floats:
    """The far end of each one's own way: half of the crowd goes one way, half the other."""
    across = s.rng.uniform(-0.62, 0.62, len(who)) * s.radius_m
    way = np.where(who % 2 == 0, 1.0, -1.0)
    across = np.abs(across) * way * np.where(s.rng.random(len(who)) < 0.85, 1.0, -1.0)
    along = way * (np.sqrt(np.maximum(s.radius_m**2 - across**2, 1.0)) - _EDGE_M)
    return np.stack([along, across], axis=1)


def _arrive(s: Steering, roots: Floats) -> None:
    """Who is there, or cannot get there, wants something else."""
    if s.behaviour == "follow":
        led = np.nonzero(s.leader >= 0)[0]
        yaw = roots[s.leader[led], 2]
        sin, cos = np.sin(yaw), np.cos(yaw)
        x, z = s.slot[led].T
        s.goals[led] = roots[s.leader[led], :2] + np.stack([cos * x + sin * z, cos * z - sin * x], axis=1)
        out = np.linalg.norm(s.goals, axis=1, keepdims=True)
        s.goals *= np.minimum(1.0, (s.radius_m - _EDGE_M) / np.maximum(out, 1e-9))
    gap = np.linalg.norm(s.goals - roots[:, :2], axis=1)
    s.blocked_s = np.where((s.speed == 0) & (s.resting_s == 0) & (gap > 1.0), s.blocked_s + DECIDE_S, 0.0)
    there = (gap < 0.7) | (s.blocked_s > 4.0)
    there &= (s.leader < 0) & (s.resting_s == 0)
    if s.behaviour == "gather":
        return
    who = np.nonzero(there)[0]
    if not len(who):
        return
    if s.behaviour == "stream":
        s.goals[who] = _ahead(s, who)
        # At the end of the way it goes back on the other side: the two streams never meet head on for long.
        s.goals[who, 0] = -np.sign(roots[who, 0]) * np.abs(s.goals[who, 0])
        s.goals[who, 1] = -np.sign(roots[who, 0]) * np.abs(s.goals[who, 1])
    else:
        s.goals[who] = _somewhere(s, who)
        rests = s.rng.random(len(who)) < (0.75 if s.behaviour == "wander" else 0.3)
        s.resting_s[who] = np.where(rests, s.rng.uniform(1.5, 6.0, len(who)), 0.0)
        greets = rests & (s.rng.random(len(who)) < 0.35)
        s.waving_s[who] = np.where(greets, _WAVE_S, s.waving_s[who])
    s.blocked_s[who] = 0.0


# --- motion ---------------------------------------------------------------------------------------------------------------


def _neighbours(places: Floats) -> tuple[Ints, Floats]:
    """Who is near each character (N, K) and how far away, infinite where there is nobody."""
    from scipy.spatial import KDTree

    count = len(places)
    k = min(_NEIGHBOURS + 1, count)
    away, near = KDTree(places).query(places, k=k, distance_upper_bound=_SEEN_M)
    away, near = np.reshape(away, (count, k)), np.reshape(near, (count, k))
    away = np.where(near == np.arange(count)[:, None], np.inf, away)
    return np.where(np.isfinite(away), near, 0).astype(np.int64), away


def _spread(s: Steering, roots: Floats, near: Ints, away: Floats) -> None:
    """Who stands in somebody else, or outside of the place, is moved a little."""
    deep = np.maximum(2 * BODY_M - away, 0.0)
    deep[~np.isfinite(away)] = 0.0
    gap = roots[:, None, :2] - roots[near, :2]
    push = np.sum(gap / np.maximum(away, 1e-3)[..., None] * (0.2 * deep)[..., None], axis=1)
    length = np.linalg.norm(push, axis=1, keepdims=True)
    most = np.where(s.speed > 0, _PUSH_M, 0.25 * _PUSH_M)[:, None]  # on who stands it would be seen
    roots[:, :2] += push * np.minimum(1.0, most / np.maximum(length, 1e-12))
    out = np.linalg.norm(roots[:, :2], axis=1, keepdims=True)
    roots[:, :2] *= np.minimum(1.0, np.maximum(s.radius_m, out - 0.1) / np.maximum(out, 1e-12))


def _drive(s: Steering, roots: Floats, near: Ints, away: Floats) -> None:
    ahead = np.stack([np.sin(roots[:, 2]), np.cos(roots[:, 2])], axis=1)
    to_goal = s.goals - roots[:, :2]
    gap = np.linalg.norm(to_goal, axis=1)
    pace = s.pace.copy()
    led = s.leader >= 0
    if np.any(led):
        lag = gap[led]
        pace[led] = np.clip(s.speed[s.leader[led]] + 0.8 * (lag - 0.4), 0.0, _RUN_M_S[1])
        pace[led] = np.where(lag < 0.5, 0.0, np.maximum(pace[led], _WALK_M_S))
    leads = np.zeros(s.count, bool)
    leads[s.leader[led]] = True
    pace[leads] = np.minimum(pace[leads], 1.3)  # so that the others can keep up
    if s.behaviour == "gather":
        pace = np.where(gap < 0.45, 0.0, pace)
        s.pace = np.where(s.pace > 2, np.where(gap < 6.0, 1.45, s.pace), s.pace)
    wanted = to_goal / np.maximum(gap, 1e-6)[:, None] * pace[:, None]
    # Who stands looks at the way that it wants to go, not at where it faces.
    moving = np.where((s.speed > 0)[:, None], ahead * s.speed[:, None], 0.8 * wanted)
    wanted += _avoidance(roots[:, :2], moving, near, away)
    edge = np.linalg.norm(roots[:, :2], axis=1)
    inward = -roots[:, :2] / np.maximum(edge, 1e-6)[:, None]
    soon = edge - np.sum(moving * inward, axis=1)  # in a second
    wanted += inward * np.maximum(soon - (s.radius_m - _EDGE_M), 0.0)[:, None] * 2.5
    # Nobody in the way may be walked into: the free way ahead limits the speed.
    free = _free_way(roots[:, :2], ahead, near, away)
    amount = np.linalg.norm(wanted, axis=1)
    off = np.arctan2(wanted[:, 0], wanted[:, 1]) - roots[:, 2]
    off = np.arctan2(np.sin(off), np.cos(off))
    amount = np.minimum(amount * (0.35 + 0.65 * np.maximum(np.cos(off), 0.0)), pace * 1.25)
    amount = np.minimum(amount, np.maximum(free, 0.0) * 2.2)
    amount = np.where(pace > 0, amount, 0.0)
    goes = amount > np.where(s.speed > 0, _STOP_M_S, _START_M_S)
    # Who has to turn round walks all the same, for a graph turns only those who go; without room it shuffles round.
    turns = (pace > 0) & (np.abs(off) > 0.5) & (gap > 0.8)
    goes |= turns & (free > 0.6) & (edge < s.radius_m - 0.7)
    goes &= s.resting_s == 0
    shuffles = ~goes & (s.speed == 0) & turns & (s.resting_s == 0)
    roots[shuffles, 2] += np.clip(off[shuffles], -_SHUFFLE, _SHUFFLE)
    if s.behaviour == "gather":  # who is there turns to the middle
        there = (pace == 0) & (s.speed == 0)
        back = np.arctan2(-roots[:, 0], -roots[:, 1]) - roots[:, 2]
        back = np.arctan2(np.sin(back), np.cos(back))
        roots[there, 2] += np.clip(0.5 * back[there], -_SHUFFLE, _SHUFFLE)
    s.speed = np.where(goes, np.maximum(amount, _WALK_M_S), 0.0)
    s.turn = np.where(goes, np.clip(np.degrees(off) * 2.2, -_TURN_DEG_S, _TURN_DEG_S), 0.0)


def _avoidance(places: Floats, moving: Floats, near: Ints, away: Floats) -> Floats:
    """The change of velocity (N, 2) by which collisions that are to come are avoided: the more urgent, the harder."""
    x = places[near] - places[:, None]
    v = moving[:, None] - moving[near]
    seen = np.isfinite(away)
    radius = np.minimum(2 * BODY_M, 0.99 * np.where(seen, away, 1.0))
    a = np.sum(v * v, axis=-1)
    b = np.sum(x * v, axis=-1)
    c = np.where(seen, np.sum(x * x, axis=-1) - radius**2, 1.0)
    root = b * b - a * c
    meets = seen & (root > 0) & (a > 1e-4) & (b > 0)
    root = np.sqrt(np.where(meets, root, 1.0))
    a = np.where(meets, a, 1.0)
    tau = np.where(meets, (b - root) / a, np.inf)
    meets &= (tau > 0) & (tau < _HORIZON_S)
    tau = np.where(meets, np.maximum(tau, 0.25), 1.0)
    fade = _URGE * np.exp(-tau / _HORIZON_S) / (a * tau**2) * (2 / tau + 1 / _HORIZON_S)
    force = -fade[..., None] * (v - (b[..., None] * v - a[..., None] * x) / root[..., None])
    force = np.where(meets[..., None], force, 0.0)
    # Two who come straight at each other pass on the right.
    size = np.linalg.norm(force, axis=-1, keepdims=True)
    side = np.stack([-v[..., 1], v[..., 0]], axis=-1) / np.sqrt(a)[..., None]
    force += 0.25 * size * side
    total = force.sum(axis=1) * _YIELD
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return total * np.minimum(1.0, 2.5 / np.maximum(length, 1e-9))


def _free_way(places: Floats, ahead: Floats, near: Ints, away: Floats) -> Floats:
    """How far each can go straight on before it touches somebody who stands there now, in metres."""
    x = places[near] - places[:, None]
    along = np.sum(x * ahead[:, None], axis=-1)
    across = np.abs(x[..., 0] * ahead[:, None, 1] - x[..., 1] * ahead[:, None, 0])
    hits = np.isfinite(away) & (along > 0) & (across < 1.5 * BODY_M)
    return np.where(hits, along - 2 * BODY_M, np.inf).min(axis=1, initial=np.inf)


def _show(s: Steering, roots: Floats, near: Ints, away: Floats) -> None:
    """Waves, jumps, and looks at who is nearest."""
    standing = s.speed == 0
    if s.behaviour == "gather":
        begins = standing & (s.waving_s == 0) & (s.rng.random(s.count) < DECIDE_S / 9.0)
        s.waving_s = np.where(begins, _WAVE_S, s.waving_s)
    s.wave = np.where(s.waving_s > 0.3, 1.0, 0.0)
    s.jump = (s.speed > 0) & (s.rng.random(s.count) < DECIDE_S / _JUMP_EVERY_S)
    if s.behaviour == "gather":
        s.jump |= standing & (s.rng.random(s.count) < DECIDE_S / (0.6 * _JUMP_EVERY_S))
    first = np.argmin(away, axis=1)
    rows = np.arange(s.count)
    whom, gap = near[rows, first], away[rows, first]
    target = roots[whom, :2].copy()
    if s.behaviour == "gather":
        target, gap = np.zeros((s.count, 2)), np.linalg.norm(roots[:, :2], axis=1)
    dx, dz = (target - roots[:, :2]).T
    sin, cos = np.sin(roots[:, 2]), np.cos(roots[:, 2])
    side, front = cos * dx - sin * dz, sin * dx + cos * dz
    sees = np.isfinite(gap) & (front > 0.3 * np.abs(side)) & (gap > 0.4)
    s.look = np.where(sees & (standing | (gap < 2.2)), 1.0, 0.0)
    s.look_at = np.where(sees[:, None], np.stack([side, np.full(s.count, 1.55), front], axis=1), s.look_at)
