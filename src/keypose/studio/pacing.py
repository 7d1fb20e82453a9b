"""The clock of a player: a thread that makes a step whenever it is time and the page has drawn what was sent before.

Steps take real time, so nothing has to be caught up. They fall in with the page's own pictures: a step that is nearly due
is made as soon as the page says that it has drawn, so that every picture shows one new step, and shows it fresh. A page that does not acknowledge (a hidden tab, a machine that
cannot keep up) gets no further frames, and no steps are made for it: nothing piles up, and nothing is skipped.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from time import perf_counter

from keypose.errors import KeyposeError
from keypose.studio.container import Body
from keypose.studio.messages import PlayFrame
from keypose.studio.player import LONGEST_STEP_S, LONGEST_TAKE_S, RATE_HZ, Player, Recording

WINDOW = 3
"""Frames that may be on their way or waiting to be drawn."""

WINDOW_FOR_INPUT = 6
"""The same for a step that obeys a new input: on a slow machine it is seen one picture sooner."""

SOONEST_S = 0.006
"""An input is obeyed at once, but not sooner than this after the last step."""

PERIOD_S = 1.0 / RATE_HZ
NEARLY_S = 0.8 * PERIOD_S
DRIFT = 0.98
"""Without a picture to fall in with, steps come a little faster than pictures do, until they meet one."""
PATIENCE_S = 0.004
"""And once they have met, the clock waits this much longer for the next picture before it goes alone."""

Order = Callable[[Player], None]


class Cadence:
    """When the next step is due. Times are seconds of any clock."""

    def __init__(self, now: float) -> None:
        self._last = self._due = now
        self._met = False

    def wait_s(self, now: float) -> float:
        """How long until the next step."""
        return max(self._due - now, 0.0)

    def hurry(self) -> None:
        """There is an input: the next step comes soon."""
        self._due = min(self._due, self._last + SOONEST_S)

    def drawn(self, now: float) -> None:
        """The page has drawn a step."""
        if now - self._last >= NEARLY_S:
            self._due, self._met = now, True

    def begin(self, now: float) -> None:
        """Time begins to run again: what passed does not count."""
        self._last = self._due = now

    def step(self, now: float) -> float:
        """A step is made; how long after the one before."""
        if self._met:
            self._due, self._met = now + PERIOD_S + PATIENCE_S, False
        else:
            in_time = 0 <= now - self._due < PERIOD_S
            self._due = (self._due if in_time else now) + DRIFT * PERIOD_S
        passed, self._last = max(now - self._last, 0.0), now
        return passed


class Pacer:
    """Runs one player. All methods may be called from any thread; the callbacks are called from the player's own."""

    def __init__(
        self,
        player: Player,
        *,
        frame: Callable[[PlayFrame, Body], None],
        recorded: Callable[[Recording], None],
        failed: Callable[[str], None],
    ) -> None:
        self.player = player
        self._frame, self._recorded, self._failed = frame, recorded, failed
        self._changed = threading.Condition()
        self._closed = False
        self._paused, self._speed = False, 1.0
        self._values: dict[str, list[float]] = {}
        self._heard = 0
        self._orders: list[Order] = []
        self._single = 0
        self._sent = self._acknowledged = 0
        self._sent_at: dict[int, float] = {}
        self._round_trip_s = 0.0
        self._cadence = Cadence(perf_counter())
        self._first = True
        self._thread = threading.Thread(target=self._run, name="keypose player", daemon=True)

    def start(self) -> None:
        """Begin to play."""
        self._thread.start()

    def close(self) -> None:
        """End; does not wait for the step that is being made."""
        with self._changed:
            self._closed = True
            self._changed.notify()

    def join(self, timeout_s: float) -> bool:
        """Wait for the thread after `close`; whether it has ended."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    # ---- what the page asks ----------------------------------------------------------------------------------------

    def set(self, values: dict[str, list[float]], sequence: int) -> None:
        """Set parameters in the next step."""
        with self._changed:
            self._values.update(values)
            self._heard = max(self._heard, sequence)
            self._cadence.hurry()
            self._changed.notify()

    def acknowledge(self, number: int) -> None:
        """Frames up to this one were drawn; numbers that were never sent are ignored."""
        with self._changed:
            if not self._acknowledged < number <= self._sent:
                return
            self._acknowledged = number
            now, at = perf_counter(), self._sent_at.get(number)
            if at is not None:
                self._round_trip_s = now - at
            self._cadence.drawn(now)
            for old in [n for n in self._sent_at if n <= number]:
                del self._sent_at[old]
            self._changed.notify()

    def pace(self, *, paused: bool, speed: float) -> None:
        """Stop or slow time."""
        with self._changed:
            if self._paused and not paused:
                self._cadence.begin(perf_counter())  # the pause itself is no time
            self._paused, self._speed = paused, min(max(speed, 0.05), 4.0)
            self._changed.notify()

    def single_step(self) -> None:
        """Pause, and make one step."""
        with self._changed:
            self._paused = True
            self._single = min(self._single + 1, 10)
            self._changed.notify()

    def order(self, order: Order) -> None:
        """Do something with the player between two steps."""
        with self._changed:
            self._orders.append(order)
            self._changed.notify()

    def end_recording(self) -> None:
        """Hand over what was recorded."""
        self.order(self._hand_over)

    def _hand_over(self, player: Player) -> None:
        recording = player.end_recording()
        if recording is not None:
            self._recorded(recording)

    # ---- the thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            while self._one():
                pass
        except KeyposeError as error:
            self._failed(str(error))
        except BaseException:
            self._failed("an error inside keypose; its terminal shows where")
            raise

    def _one(self) -> bool:
        """Wait until it is time, and make one step; False once closed."""
        with self._changed:
            while not self._closed and (wait_s := self._wait_s()) != 0:
                self._changed.wait(wait_s)
            if self._closed:
                return False
            dt_s = self._time_s(self._cadence.step(perf_counter()))
            values, self._values = self._values, {}
            orders, self._orders = self._orders, []
            heard, round_trip_s = self._heard, self._round_trip_s
        for order in orders:
            order(self.player)
        frame, body = self.player.step(values, dt_s, heard=heard, round_trip_s=round_trip_s)
        with self._changed:
            self._sent = frame.number
            self._sent_at[frame.number] = perf_counter()
        self._frame(frame, body)
        if frame.recorded_s is not None and frame.recorded_s > LONGEST_TAKE_S:
            self._hand_over(self.player)
        return True

    def _wait_s(self) -> float | None:
        """How long nothing is to be done: 0 for now, None until something changes."""
        if self._sent - self._acknowledged >= (WINDOW_FOR_INPUT if self._values else WINDOW):
            return None
        if self._first or self._orders or self._single:
            return 0.0
        if self._paused:
            return 0.0 if self._values else None
        return self._cadence.wait_s(perf_counter())

    def _time_s(self, passed_s: float) -> float:
        """How much time of the character a step takes."""
        if self._first:
            self._first = False
            return 0.0
        if self._single:
            self._single -= 1
            return PERIOD_S
        return 0.0 if self._paused else min(passed_s, LONGEST_STEP_S) * self._speed
