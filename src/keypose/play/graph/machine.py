"""State machines at run time: which state plays, what may follow, and how one becomes the other."""

from __future__ import annotations

from dataclasses import dataclass

from keypose.play.graph.control import Moment, RtNode, Value
from keypose.play.graph.program import (
    BeginInertial,
    Change,
    Dead,
    Held,
    Hold,
    Inertial,
    Mix,
    Operation,
    Remember,
)
from keypose.play.graph.rootmotion import STILL, Ground, blended
from keypose.play.graph.synchrony import progress
from keypose.play.graph.transitions import quintic

NONE, MEMORY = -1, -2  # instead of a source state: none (no transition runs), or what the memory holds


@dataclass(frozen=True, slots=True)
class RtCondition:
    """A test of a parameter's slot."""

    value: Value
    test: str
    against: float
    trigger: bool

    def holds(self, m: Moment) -> bool:
        """Whether it holds now."""
        x, y = self.value.of(m), self.against
        match self.test:
            case "set":
                return x != 0
            case "not set":
                return x == 0
            case ">":
                return x > y
            case ">=":
                return x >= y
            case "<":
                return x < y
            case "<=":
                return x <= y
            case "==":
                return x == y
            case _:
                return x != y


@dataclass(frozen=True, slots=True)
class RtTransition:
    """A transition between numbered states; ``source`` -1 is any."""

    source: int
    target: int
    conditions: tuple[RtCondition, ...]
    exit_time: float | None
    kind: str
    duration_s: float
    interrupt: str
    sync: bool


@dataclass(frozen=True, slots=True, eq=False)
class RtMachine(RtNode):
    """A state machine. While it runs a transition it keeps both states, or the new state and a memory of the old pose."""

    states: tuple[RtNode, ...]
    state_names: tuple[str, ...]
    transitions: tuple[RtTransition, ...]
    entry: int
    memory: int
    state: int  # slots of ints, in this order: state, source, origin, transition, seen, begun
    elapsed: int  # slots of floats: elapsed, then last velocity of the root (3), then what is left of the old one (3)

    def enter(self, m: Moment) -> None:
        """Go to the entry state."""
        m.ints[self.state : self.state + 6] = [self.entry, NONE, NONE, NONE, -2, 0]
        m.floats[self.elapsed : self.elapsed + 7] = [0.0] * 7
        m.begins.pop(self.memory, None)
        self.states[self.entry].enter(m)

    def advance(self, m: Moment, dt_s: float, weight: float) -> Ground:
        """Take the transitions that are due, then play what runs."""
        m.local_dt_s[self.memory] = dt_s
        fresh = False
        if dt_s > 0:
            for _ in range(len(self.states) + 1):
                due = self._due(m)
                if due == NONE:
                    break
                self._begin(m, due)
                fresh = True
        step = self._play(m, dt_s, weight, fresh)
        if dt_s > 0:
            at = self.elapsed + 1
            m.floats[at : at + 3] = [n / dt_s for n in step]
        return step

    def cycles(self, m: Moment) -> float:
        """Of the state that plays."""
        return self.states[m.ints[self.state]].cycles(m)

    def emit(self, m: Moment, ops: list[Operation]) -> None:
        """The state, or both states of a transition, or the state and the memory."""
        begin = m.begins.pop(self.memory, None)
        state, source, _, running = m.ints[self.state : self.state + 4]
        target, elapsed = self.states[state], m.floats[self.elapsed]
        if running == NONE:
            target.emit(m, ops)
        else:
            t = self.transitions[running]
            share = smooth(elapsed / t.duration_s)
            if source >= 0:
                self.states[source].emit(m, ops)
                target.emit(m, ops)
                ops.append(Mix((1.0 - share, share)))
            else:
                self._emit_memory(m, ops, t, begin, share)
        fresh = m.ints[self.state + 4] < m.number - 1
        ops.append(Remember(self.memory, m.local_dt_s.get(self.memory, 0.0), fresh))
        m.ints[self.state + 4] = m.number

    def _emit_memory(
        self, m: Moment, ops: list[Operation], t: RtTransition, begin: list[Operation] | None, share: float
    ) -> None:
        target, elapsed = self.states[m.ints[self.state]], m.floats[self.elapsed]
        if begin is not None:
            ops.extend(begin)
        target.emit(m, ops)
        if begin is not None:
            dt_s = m.local_dt_s.get(self.memory, 0.0)
            ops.append(BeginInertial(self.memory, dt_s, t.duration_s) if t.kind == "inertial" else Hold(self.memory))
            m.ints[self.state + 5] = 1
        if not m.ints[self.state + 5]:  # nobody saw the old pose: there is nothing to hide
            return
        if t.kind == "inertial":
            ops.append(Inertial(self.memory, elapsed, t.duration_s))
        elif t.kind == "dead":
            ops.append(Dead(self.memory, elapsed, share))
        else:
            ops.append(Held(self.memory, share))

    def _due(self, m: Moment) -> int:
        """The first transition that may begin now."""
        state, _, origin, running = m.ints[self.state : self.state + 4]
        sources = {state}
        anywhere = True
        if running != NONE:
            allowed = self.transitions[running].interrupt
            sources = ({origin} if allowed in ("source", "both") else set[int]()) | (
                {state} if allowed in ("target", "both") else set[int]()
            )
            anywhere = allowed != "none"
        for i, t in enumerate(self.transitions):
            if t.source == NONE:
                if not anywhere or t.target == state:
                    continue
            elif t.source not in sources or (running != NONE and i == running):
                continue
            leaving = state if t.source == NONE else t.source
            if t.exit_time is not None and self.states[leaving].cycles(m) < t.exit_time:
                continue
            if all(c.holds(m) for c in t.conditions):
                return i
        return NONE

    def _begin(self, m: Moment, index: int) -> None:
        t = self.transitions[index]
        old, _, _, running = m.ints[self.state : self.state + 4]
        for c in t.conditions:
            if c.trigger:
                m.floats[c.value.slot] = 0.0
        m.changes.append(
            Change(
                self.name,
                self.state_names[old],
                self.state_names[t.target],
                t.kind,
                t.duration_s,
                running != NONE,
            )
        )
        target = self.states[t.target]
        both = t.sync and target.synced and self.states[old].synced
        place = self.states[old].position(m) if both else None
        target.enter(m)
        if place is not None:
            target.place(m, place)
        m.begins.pop(self.memory, None)
        m.floats[self.elapsed] = 0.0
        at = self.elapsed + 1
        m.floats[at + 3 : at + 6] = m.floats[at : at + 3]
        if t.duration_s == 0:
            m.ints[self.state : self.state + 4] = [t.target, NONE, NONE, NONE]
            return
        remembered = t.kind != "crossfade" or running != NONE or t.target == old
        m.ints[self.state : self.state + 4] = [t.target, MEMORY if remembered else old, old, index]
        m.ints[self.state + 5] = 0
        if remembered and m.ints[self.state + 4] == m.number - 1:
            start: list[Operation] = []
            if t.kind == "inertial":
                target.emit(m, start)
            m.begins[self.memory] = start

    def _play(self, m: Moment, dt_s: float, weight: float, fresh: bool) -> Ground:
        state, source, _, running = m.ints[self.state : self.state + 4]
        target = self.states[state]
        if running == NONE:
            return target.advance(m, dt_s, weight)
        t = self.transitions[running]
        before = m.floats[self.elapsed]
        elapsed = m.floats[self.elapsed] = before + dt_s
        share = smooth(elapsed / t.duration_s)
        if source >= 0:
            step = self._play_both(m, self.states[source], target, t, dt_s, weight, share)
        else:
            step = self._play_on(m, target.advance(m, dt_s, weight * share), t, dt_s, before, share, fresh)
        if elapsed >= t.duration_s:
            m.ints[self.state + 1 : self.state + 4] = [NONE, NONE, NONE]
        return step

    def _play_both(
        self, m: Moment, source: RtNode, target: RtNode, t: RtTransition, dt_s: float, weight: float, share: float
    ) -> Ground:
        old, new = weight * (1.0 - share), weight * share
        if t.sync and source.synced and target.synced:

            def seconds(interval: int) -> float:
                return (1.0 - share) * source.seconds(m, interval) + share * target.seconds(m, interval)

            at = progress(target.position(m), dt_s, seconds)
            steps = source.drive(m, at, dt_s, old), target.drive(m, at, dt_s, new)
        else:
            steps = source.advance(m, dt_s, old), target.advance(m, dt_s, new)
        return blended([(1.0 - share, steps[0]), (share, steps[1])])

    def _play_on(
        self, m: Moment, step: Ground, t: RtTransition, dt_s: float, before: float, share: float, fresh: bool
    ) -> Ground:
        """The travel of the new state, with what the transition keeps of the old one's velocity."""
        if dt_s <= 0:
            return STILL
        at = self.elapsed + 4
        kept = m.floats[at : at + 3]
        if t.kind == "inertial":
            if fresh:
                kept = m.floats[at : at + 3] = [k - n / dt_s for k, n in zip(kept, step, strict=True)]
            middle = min(before + 0.5 * dt_s, t.duration_s)
            left = float(quintic(1.0, 0.0, middle, t.duration_s)) * min(t.duration_s - before, dt_s)
            return step[0] + kept[0] * left, step[1] + kept[1] * left, step[2] + kept[2] * left
        slowed = 2.0 ** (-before / DEAD_HALF_LIFE_S) if t.kind == "dead" else 1.0
        old: Ground = (kept[0] * slowed * dt_s, kept[1] * slowed * dt_s, kept[2] * slowed * dt_s)
        return blended([(1.0 - share, old), (share, step)])


DEAD_HALF_LIFE_S = 0.2  # of the travel's speed in a dead blend


def smooth(u: float) -> float:
    """0 to 1 with no speed at both ends: smoothstep."""
    u = min(max(u, 0.0), 1.0)
    return u * u * (3.0 - 2.0 * u)
