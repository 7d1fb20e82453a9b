"""The control logic of a graph: one small object per node, and all state in two flat lists of numbers.

A node owns slots of the lists and nothing else, so that the state of many characters can be columns of two tables.
``advance`` moves times on, fires events and returns the step of the root; ``emit`` writes the pose program.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

from keypose.play.graph.assets import ClipAsset
from keypose.play.graph.program import (
    Add,
    Bend,
    Change,
    Fired,
    Look,
    Mix,
    Operation,
    Over,
    PlantFeet,
    Reach,
    Rest,
    Sample,
    Vector,
)
from keypose.play.graph.rootmotion import STILL, Ground, blended, compose
from keypose.play.graph.synchrony import Position, SyncTable, progress

LONGEST_STEP_S = 60.0  # the work of a step is bounded
FASTEST = 100.0  # of clips, for the same reason
SLOW_M_S = 0.1  # of a curved way
MOST_CURVED = 3.0  # radians per metre
SLOWEST = 1e-3  # of synchronised clips: a speed of 0 would stop the others too


@dataclass(slots=True)
class Moment:
    """One step of one character while it is computed."""

    floats: list[float]
    ints: list[int]
    number: int
    events: list[Fired] = field(default_factory=list[Fired])
    changes: list[Change] = field(default_factory=list[Change])
    begins: dict[int, list[Operation]] = field(default_factory=dict[int, "list[Operation]"])
    local_dt_s: dict[int, float] = field(default_factory=dict[int, float])


@dataclass(frozen=True, slots=True)
class Value:
    """A number, or the slot of the parameter that holds it."""

    slot: int
    constant: float

    def of(self, m: Moment) -> float:
        """Its value now."""
        return self.constant if self.slot < 0 else m.floats[self.slot]


@dataclass(frozen=True, slots=True, eq=False)
class RtNode(ABC):
    """A node at run time; ``synced`` says whether a parent of the same synchronisation can drive it."""

    name: str
    index: int
    synced: bool

    @abstractmethod
    def enter(self, m: Moment) -> None:
        """Start from the beginning."""

    @abstractmethod
    def advance(self, m: Moment, dt_s: float, weight: float) -> Ground:
        """Move on by itself; ``weight`` (how much of it is seen) goes to its events."""

    @abstractmethod
    def emit(self, m: Moment, ops: list[Operation]) -> None:
        """Write the operations that leave this node's pose on the stack."""

    @abstractmethod
    def cycles(self, m: Moment) -> float:
        """How many times it has played since it was entered."""

    def position(self, m: Moment) -> Position:
        """Where it stands among its sync markers."""
        return (0, 0.0)

    def place(self, m: Moment, at: Position) -> None:  # noqa: B027 - nothing to move where nothing is synchronised
        """Go to a place among its sync markers, without events and without travel."""

    def seconds(self, m: Moment, interval: int) -> float:
        """How long it would take from one sync marker to the next."""
        return 0.0

    def drive(self, m: Moment, at: Position, dt_s: float, weight: float) -> Ground:
        """Move on to a place among its sync markers; what is not synchronised moves on by ``dt_s``."""
        return self.advance(m, dt_s, weight)


# --- sources ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class RtRest(RtNode):
    """The rest pose."""

    def enter(self, m: Moment) -> None:
        """Nothing to do."""

    def advance(self, m: Moment, dt_s: float, weight: float) -> Ground:
        """Stands still."""
        return STILL

    def emit(self, m: Moment, ops: list[Operation]) -> None:
        """Push the rest pose."""
        ops.append(Rest())

    def cycles(self, m: Moment) -> float:
        """It is over at once."""
        return math.inf


@dataclass(frozen=True, slots=True, eq=False)
class RtClip(RtNode):
    """A playing clip. Its place is a count of loops (int) and a time inside the loop (float), exact after any time."""

    asset: ClipAsset
    clip: int
    speed: Value
    loops: int
    start: float
    warp: tuple[tuple[float, float], ...]
    table: SyncTable | None
    time: int  # slot of floats
    begun: int  # slot of floats: place at entry, in cycles
    loop: int  # slot of ints

    def enter(self, m: Moment) -> None:
        """Go to the start; played backwards, to as far from the end."""
        d = self.asset.duration_s
        back = self.speed.of(m) < 0
        share = 1.0 - self.start if back else self.start
        loop = max(self.loops - 1, 0) if back else 0
        if self.loops == 0 and share >= 1.0:
            share -= 1.0
        m.floats[self.time], m.ints[self.loop] = share * d, loop
        m.floats[self.begun] = loop + share

    def advance(self, m: Moment, dt_s: float, weight: float) -> Ground:
        """Play."""
        d = self.asset.duration_s
        moved = dt_s * min(max(self.speed.of(m), -FASTEST), FASTEST)
        if d <= 0 or moved == 0:
            return STILL
        loop, time = m.ints[self.loop], m.floats[self.time]
        whole = math.floor((time + moved) / d)
        inside = time + moved - whole * d
        if inside >= d:  # rounding
            whole, inside = whole + 1, 0.0
        return self._move(m, loop + whole, max(inside, 0.0), weight)

    def emit(self, m: Moment, ops: list[Operation]) -> None:
        """Push the clip at its time."""
        ops.append(Sample(self.clip, self._in_clip(m.floats[self.time]), self.index))

    def cycles(self, m: Moment) -> float:
        """Loops played since entry; a clip of one frame is over at once."""
        d = self.asset.duration_s
        if d <= 0:
            return math.inf
        return abs(m.ints[self.loop] + m.floats[self.time] / d - m.floats[self.begun])

    def position(self, m: Moment) -> Position:
        """Where it stands among its sync markers."""
        return (0, 0.0) if self.table is None else self.table.position(m.ints[self.loop], m.floats[self.time])

    def place(self, m: Moment, at: Position) -> None:
        """Go there, and count cycles from there."""
        if self.table is not None:
            loop, time = self.table.time(at)
            m.ints[self.loop], m.floats[self.time] = self._clamped(loop, time)
            m.floats[self.begun] = m.ints[self.loop] + m.floats[self.time] / self.asset.duration_s

    def seconds(self, m: Moment, interval: int) -> float:
        """At its own speed, forwards or backwards."""
        return (
            0.0
            if self.table is None
            else self.table.seconds(interval) / min(max(abs(self.speed.of(m)), SLOWEST), FASTEST)
        )

    def drive(self, m: Moment, at: Position, dt_s: float, weight: float) -> Ground:
        """Play to a place among the markers."""
        if self.table is None:
            return self.advance(m, dt_s, weight)
        loop, time = self.table.time(at)
        return self._move(m, loop, time, weight)

    def _clamped(self, loop: int, time: float) -> tuple[int, float]:
        if self.loops and loop >= self.loops:
            return self.loops - 1, self.asset.duration_s
        if self.loops and loop < 0:
            return 0, 0.0
        return loop, time

    def _in_clip(self, time: float) -> float:
        """The clip's own time, bent by the warp."""
        d = self.asset.duration_s
        if not self.warp or d <= 0:
            return time
        share = time / d
        for (x0, y0), (x1, y1) in zip(self.warp, self.warp[1:], strict=False):
            if share <= x1:
                return d * (y0 + (y1 - y0) * (share - x0) / (x1 - x0))
        return d

    def _move(self, m: Moment, loop: int, time: float, weight: float) -> Ground:
        d = self.asset.duration_s
        old_loop, old_time = m.ints[self.loop], m.floats[self.time]
        loop, time = self._clamped(loop, time)
        m.ints[self.loop], m.floats[self.time] = loop, time
        before, after = self._in_clip(old_time), self._in_clip(time)
        if self.asset.events and weight > 0:
            # The end of a loop is the beginning of the next.
            p0 = (old_loop + 1, 0.0) if before >= d else (old_loop, before)
            p1 = (loop + 1, 0.0) if after >= d else (loop, after)
            self._fire(m, p0, p1, weight)
        return self.asset.track.step((old_loop, loop), (before, after))

    def _fire(self, m: Moment, p0: tuple[int, float], p1: tuple[int, float], weight: float) -> None:
        """Events passed on the way: those at the start of the way count, those at its end only where the clip stops."""
        if p0 == p1:
            return
        d = self.asset.duration_s
        forward = p1 > p0
        # The seam belongs to two loops. Where the clip was entered there, only the one it plays into has begun.
        entered = p0 == (m.floats[self.begun], 0.0)
        low, high = (p0, p1) if forward else (p1, p0)
        stops = self.loops > 0 and p1 == ((self.loops, 0.0) if forward else (0, 0.0))
        found: list[tuple[tuple[int, float], int, int]] = []
        for loop in range(low[0] - 1, high[0] + 1):
            if self.loops and not 0 <= loop < self.loops:
                continue
            for i, (time, _, _) in enumerate(self.asset.events):
                at = (loop + 1, 0.0) if time >= d else (loop, time)
                if entered and at == p0 and forward == (time >= d):
                    continue
                if low < at < high or at == p0 or (stops and at == p1):
                    found.append((at, loop, i))
        for _, _, i in sorted(found, reverse=not forward):
            _, name, data = self.asset.events[i]
            m.events.append(Fired(name, data, self.asset.name, self.name, weight))


# --- mixtures ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Weigher(ABC):
    """What gives the weights of a mixture."""

    @abstractmethod
    def weights(self, m: Moment) -> list[float]:
        """One weight per child, >= 0, of sum 1."""


@dataclass(frozen=True, slots=True, eq=False)
class RtMix(RtNode):
    """A weighted mean of children; where they are synchronised, one place among the markers drives them all."""

    children: tuple[RtNode, ...]
    weigher: Weigher
    group: bool  # whether its children are synchronised with each other
    pattern: int  # markers of one cycle
    interval: int  # slot of ints
    begun: int  # slot of ints
    share: int  # slot of floats

    def enter(self, m: Moment) -> None:
        """Start all children; synchronised ones all where the first of them starts."""
        for child in self.children:
            child.enter(m)
        if self.group:
            lead = next(c for c in self.children if c.synced)
            self._go(m, lead.position(m))

    def advance(self, m: Moment, dt_s: float, weight: float) -> Ground:
        """Children play, each by itself or all in step."""
        weights = self.weigher.weights(m)
        if not self.group:
            return blended([(w, c.advance(m, dt_s, weight * w)) for c, w in zip(self.children, weights, strict=True)])
        at = progress(self.position(m), dt_s, lambda interval: self._seconds(m, interval, weights))
        return self._drive(m, at, dt_s, weight, weights)

    def emit(self, m: Moment, ops: list[Operation]) -> None:
        """Children that are seen, and their mean."""
        emit_mean(m, ops, self.children, self.weigher.weights(m))

    def cycles(self, m: Moment) -> float:
        """Those of the synchronised children together, else of the child of the most weight."""
        if self.group:
            whole, share = self.position(m)
            return (whole - m.ints[self.begun] + share) / self.pattern
        weights = self.weigher.weights(m)
        return self.children[weights.index(max(weights))].cycles(m)

    def position(self, m: Moment) -> Position:
        """Where all synchronised children stand."""
        return (m.ints[self.interval], m.floats[self.share]) if self.group else (0, 0.0)

    def place(self, m: Moment, at: Position) -> None:
        """Take all synchronised children there."""
        if self.group:
            self._go(m, at)

    def seconds(self, m: Moment, interval: int) -> float:
        """The weighted mean of the synchronised children."""
        return self._seconds(m, interval, self.weigher.weights(m))

    def drive(self, m: Moment, at: Position, dt_s: float, weight: float) -> Ground:
        """Drive the synchronised children."""
        if not self.group:
            return self.advance(m, dt_s, weight)
        return self._drive(m, at, dt_s, weight, self.weigher.weights(m))

    def _go(self, m: Moment, at: Position) -> None:
        m.ints[self.interval], m.floats[self.share] = at
        m.ints[self.begun] = at[0]
        for child in self.children:
            if child.synced:
                child.place(m, at)

    def _seconds(self, m: Moment, interval: int, weights: Sequence[float]) -> float:
        pairs = [(w, c.seconds(m, interval)) for c, w in zip(self.children, weights, strict=True) if c.synced]
        total = sum(w for w, _ in pairs)
        if total > 0:
            return sum(w * s for w, s in pairs) / total
        return sum(s for _, s in pairs) / len(pairs)

    def _drive(self, m: Moment, at: Position, dt_s: float, weight: float, weights: Sequence[float]) -> Ground:
        m.ints[self.interval], m.floats[self.share] = at
        return blended(
            [
                (w, c.drive(m, at, dt_s, weight * w) if c.synced else c.advance(m, dt_s, weight * w))
                for c, w in zip(self.children, weights, strict=True)
            ]
        )


def emit_mean(m: Moment, ops: list[Operation], children: Sequence[RtNode], weights: Sequence[float]) -> None:
    """The poses of the children that have weight, and their mean; one alone is left as it is."""
    seen = [(c, w) for c, w in zip(children, weights, strict=True) if w > 0]
    for child, _ in seen:
        child.emit(m, ops)
    if len(seen) > 1:
        total = sum(w for _, w in seen)
        ops.append(Mix(tuple(w / total for _, w in seen)))


# --- nodes over one base ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class RtOver(RtNode):
    """A node that works on one base; time, travel and synchronisation are the base's."""

    base: RtNode

    def enter(self, m: Moment) -> None:
        """Start the base."""
        self.base.enter(m)

    def advance(self, m: Moment, dt_s: float, weight: float) -> Ground:
        """The base moves on."""
        return self.base.advance(m, dt_s, weight)

    def cycles(self, m: Moment) -> float:
        """Of the base."""
        return self.base.cycles(m)

    def position(self, m: Moment) -> Position:
        """Of the base."""
        return self.base.position(m)

    def place(self, m: Moment, at: Position) -> None:
        """Of the base."""
        self.base.place(m, at)

    def seconds(self, m: Moment, interval: int) -> float:
        """Of the base."""
        return self.base.seconds(m, interval)

    def drive(self, m: Moment, at: Position, dt_s: float, weight: float) -> Ground:
        """Of the base."""
        return self.base.drive(m, at, dt_s, weight)

    def emit(self, m: Moment, ops: list[Operation]) -> None:
        """The base's pose."""
        self.base.emit(m, ops)


@dataclass(frozen=True, slots=True, eq=False)
class RtTop(RtOver):
    """A base with a second node on top: a layer, or something added (``reference`` >= 0)."""

    top: RtNode
    weight: Value
    mask: int
    reference: int
    limit: float  # layers cover at most wholly; what is added may be any multiple

    def enter(self, m: Moment) -> None:
        """Start both."""
        self.base.enter(m)
        self.top.enter(m)

    def advance(self, m: Moment, dt_s: float, weight: float) -> Ground:
        """Both move on; the travel is the base's."""
        step = self.base.advance(m, dt_s, weight)
        self.top.advance(m, dt_s, weight * min(abs(self._amount(m)), 1.0))
        return step

    def drive(self, m: Moment, at: Position, dt_s: float, weight: float) -> Ground:
        """The base is driven, the top moves on by itself."""
        step = self.base.drive(m, at, dt_s, weight)
        self.top.advance(m, dt_s, weight * min(abs(self._amount(m)), 1.0))
        return step

    def emit(self, m: Moment, ops: list[Operation]) -> None:
        """Both poses and how they are joined; what has no weight is left out."""
        self.base.emit(m, ops)
        amount = self._amount(m)
        if amount == 0:
            return
        self.top.emit(m, ops)
        ops.append(Over(self.mask, amount) if self.reference < 0 else Add(self.mask, amount, self.reference))

    def _amount(self, m: Moment) -> float:
        amount = self.weight.of(m)
        return min(max(amount, 0.0), 1.0) if self.reference < 0 else min(max(amount, -self.limit), self.limit)


@dataclass(frozen=True, slots=True, eq=False)
class RtWarp(RtOver):
    """Time runs faster or slower."""

    speed: Value

    def advance(self, m: Moment, dt_s: float, weight: float) -> Ground:
        """The base moves on by its own time."""
        return self.base.advance(m, self._scaled(m, dt_s), weight)

    def seconds(self, m: Moment, interval: int) -> float:
        """A fast base takes less time."""
        return self.base.seconds(m, interval) / max(self.speed.of(m), SLOWEST)

    def drive(self, m: Moment, at: Position, dt_s: float, weight: float) -> Ground:
        """Its own time for what is not synchronised."""
        return self.base.drive(m, at, self._scaled(m, dt_s), weight)

    def _scaled(self, m: Moment, dt_s: float) -> float:
        return min(dt_s * max(self.speed.of(m), 0.0), LONGEST_STEP_S)


@dataclass(frozen=True, slots=True, eq=False)
class RtSteer(RtOver):
    """The travel turns, and the places of the contacts are bent with it: what stands on a straight way stands on a curve.

    Below about ``SLOW_M_S`` there is no way to bend: a character that turns on the spot turns its feet too.
    """

    turn_deg_s: Value
    way: int  # slots of floats: direction x, z, curvature

    def enter(self, m: Moment) -> None:
        """Start the base on a straight way."""
        m.floats[self.way : self.way + 3] = [0.0, 1.0, 0.0]
        self.base.enter(m)

    def emit(self, m: Moment, ops: list[Operation]) -> None:
        """The base's pose, its contacts bent."""
        self.base.emit(m, ops)
        x, z, curvature = m.floats[self.way : self.way + 3]
        if curvature != 0:
            ops.append(Bend(x, z, curvature))

    def advance(self, m: Moment, dt_s: float, weight: float) -> Ground:
        """The base's step on an arc."""
        return self._turned(m, self.base.advance(m, dt_s, weight), dt_s)

    def drive(self, m: Moment, at: Position, dt_s: float, weight: float) -> Ground:
        """The base's step on an arc."""
        return self._turned(m, self.base.drive(m, at, dt_s, weight), dt_s)

    def _turned(self, m: Moment, step: Ground, dt_s: float) -> Ground:
        turn = math.radians(self.turn_deg_s.of(m))
        length = math.hypot(step[0], step[1])
        if dt_s > 0:
            speed = length / dt_s
            curvature = turn * speed / (speed * speed + SLOW_M_S * SLOW_M_S)
            x, z = (step[0] / length, step[1] / length) if length > 0 else (0.0, 1.0)
            m.floats[self.way : self.way + 3] = [x, z, min(max(curvature, -MOST_CURVED), MOST_CURVED)]
        half = (0.0, 0.0, 0.5 * dt_s * turn)
        return compose(half, compose(step, half))


@dataclass(frozen=True, slots=True, eq=False)
class RtAim(RtOver):
    """Look-at, two-bone limb or planted feet: an operation on the base's pose."""

    kind: type[Look] | type[Reach] | type[PlantFeet]
    solver: int
    target: int  # slot of floats; -1 for planted feet
    weight: Value

    def emit(self, m: Moment, ops: list[Operation]) -> None:
        """The base's pose and the operation on it."""
        self.base.emit(m, ops)
        weight = min(max(self.weight.of(m), 0.0), 1.0)
        if weight == 0:
            return
        if self.kind is PlantFeet:
            ops.append(PlantFeet(self.solver, weight))
            return
        x, y, z = m.floats[self.target : self.target + 3]
        target: Vector = (x, y, z)
        ops.append(Look(self.solver, target, weight) if self.kind is Look else Reach(self.solver, target, weight))
