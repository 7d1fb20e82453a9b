"""Crowds for the browser: many characters play one graph here; their matrices go to the page, which draws them.

One page has one crowd, in a thread of its own. A step (`crowd_show`) steers, animates, chooses levels of detail by where the
page's camera is, and gives the roots of all characters and the joints of those that are due. The page acknowledges what it has
drawn; one that draws nothing (a hidden tab) gets no frames, and no steps are made for it.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from time import perf_counter
from typing import TYPE_CHECKING

from keypose.errors import KeyposeError
from keypose.play import steering
from keypose.studio import messages
from keypose.studio.container import pack
from keypose.studio.crowd_show import CrowdShow, View
from keypose.studio.requests import parse_crowd_request

if TYPE_CHECKING:
    from starlette.websockets import WebSocket

    from keypose.studio.session import Session

MOST_CROWDS = 6
"""Pages that show a crowd at the same time."""

WINDOW = 2
"""Frames that may be on their way or waiting to be drawn."""

_LONGEST_STEP_S = 0.1
_sockets: set[int] = set()  # of pages that show a crowd


class CrowdRunner:
    """The clock of a crowd, in a thread; methods may be called from any thread, ``send`` is called from the crowd's own."""

    def __init__(
        self,
        make: Callable[[], CrowdShow],
        send: Callable[[bytes], None],
        failed: Callable[[str], None],
        before: CrowdRunner | None = None,
    ) -> None:
        """``before`` goes on until this crowd is made, and ends then."""
        self._make, self._send, self._failed, self._before = make, send, failed, before
        self._changed = threading.Condition()
        self._closed = False
        self._paused, self._speed, self._rate_hz = False, 1.0, 30.0
        self._view, self._looked = View(), True
        self._behaviour: str | None = None
        self._sent = self._acknowledged = 0
        self._last = self._due = perf_counter()
        self._thread = threading.Thread(target=self._run, name="keypose crowd", daemon=True)

    def start(self) -> None:
        """Build the crowd, and let it go."""
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

    @property
    def sent(self) -> int:
        """Frames so far."""
        return self._sent

    def acknowledge(self, number: int) -> None:
        """Frames up to this one were drawn; numbers that were never sent are ignored."""
        with self._changed:
            before = self._before
            if self._acknowledged < number <= self._sent:
                self._acknowledged = number
                self._changed.notify()
        if before is not None:
            before.acknowledge(number)

    def pace(self, paused: bool, speed: float, rate_hz: float) -> None:
        """Stop or slow time, or make fewer steps of it."""
        with self._changed:
            if self._paused and not paused:
                self._last = self._due = perf_counter()
            self._paused, self._speed = paused, min(max(speed, 0.02), 4.0)
            self._rate_hz = min(max(rate_hz, 1.0), 120.0)
            self._changed.notify()

    def look(self, eye: list[float], fov_deg: float) -> None:
        """The camera is here now."""
        with self._changed:
            before = self._before
            self._view = View((eye[0], eye[1], eye[2]), min(max(fov_deg, 1.0), 170.0))
            self._looked = True
            self._changed.notify()
        if before is not None:
            before.look(eye, fov_deg)

    def behave(self, behaviour: str) -> None:
        """Do something else; an unknown behaviour is ignored."""
        with self._changed:
            if behaviour in steering.BEHAVIOURS:
                self._behaviour = behaviour

    def _run(self) -> None:
        try:
            try:
                show = self._make()
            finally:
                with self._changed:
                    before, self._before = self._before, None
                if before is not None:
                    before.close()
            if self._closed:
                return
            self._send(show.ready())
            self._last = self._due = perf_counter()
            while self._one(show):
                pass
        except KeyposeError as error:
            self._failed(str(error))
        except BaseException:
            self._failed("an error inside keypose; its terminal shows where")
            raise

    def _one(self, show: CrowdShow) -> bool:
        """Wait until it is time, and make one step; False once closed."""
        with self._changed:
            while not self._closed and (wait_s := self._wait_s()) != 0:
                self._changed.wait(wait_s)
            if self._closed:
                return False
            now = perf_counter()
            real = min(max(now - self._last, 0.0), _LONGEST_STEP_S)
            self._last = now
            in_time = 0 <= now - self._due < 1.0 / self._rate_hz
            self._due = (self._due if in_time else now) + 1.0 / self._rate_hz
            dt_s = 0.0 if self._paused else real * self._speed
            view, self._looked = self._view, False
            behaviour, self._behaviour = self._behaviour, None
        if behaviour is not None:
            steering.turn_to(show.steering, behaviour)  # type: ignore[arg-type]
        data = show.step(dt_s, view)
        with self._changed:
            self._sent += 1
        self._send(data)
        return True

    def _wait_s(self) -> float | None:
        """How long nothing is to be done: 0 for now, None until something changes."""
        if self._sent - self._acknowledged >= WINDOW:
            return None
        if self._paused and not (self._looked or self._sent == 0):
            return None
        return max(self._due - perf_counter(), 0.0)


async def crowd_events(session: Session, socket: WebSocket) -> None:
    """One page's crowd, from its opening to the end of the connection."""
    await socket.accept()
    loop = asyncio.get_running_loop()
    waiting: asyncio.Queue[bytes] = asyncio.Queue()
    runner: CrowdRunner | None = None

    def later(data: bytes) -> None:
        if not loop.is_closed():
            loop.call_soon_threadsafe(waiting.put_nowait, data)

    def failed(text: str) -> None:
        later(pack(messages.CrowdFailure("crowd_failure", text)))

    async def send() -> None:
        while True:
            await socket.send_bytes(await waiting.get())

    sender = asyncio.create_task(send())
    try:
        async for text in socket.iter_text():
            request = parse_crowd_request(text)
            if isinstance(request, messages.CrowdOpen) and len(_sockets - {id(socket)}) >= MOST_CROWDS:
                failed(f"{MOST_CROWDS} pages show a crowd already; close one of them")
            elif isinstance(request, messages.CrowdOpen):
                _sockets.add(id(socket))
                # What is shown goes on until the new crowd is there.
                runner = _opened(session, request, later, failed, runner)
            elif request is None or (isinstance(request, messages.CrowdView) and len(request.eye) != 3):
                await socket.close(1003, "unknown message")
                break
            elif runner is not None:
                _tell(runner, request)
    finally:
        _sockets.discard(id(socket))
        if runner is not None:
            runner.close()
        sender.cancel()
        await asyncio.gather(sender, return_exceptions=True)


def _tell(runner: CrowdRunner, request: messages.CrowdRequest) -> None:
    match request:
        case messages.CrowdAcknowledge(number=number):
            runner.acknowledge(number)
        case messages.CrowdPace(paused=paused, speed=speed, rate_hz=rate_hz):
            runner.pace(paused, speed, rate_hz)
        case messages.CrowdView(eye=eye, fov_deg=fov_deg):
            runner.look(eye, fov_deg)
        case messages.CrowdBehave(behaviour=behaviour):
            runner.behave(behaviour)
        case messages.CrowdOpen():
            pass


def _opened(
    session: Session,
    request: messages.CrowdOpen,
    send: Callable[[bytes], None],
    failed: Callable[[str], None],
    before: CrowdRunner | None,
) -> CrowdRunner | None:
    opened = session.graphs.get(request.graph)
    if opened is None:
        if before is not None:
            before.close()
        failed(f"no graph '{request.graph[:60]}' is open")
        return None

    def make() -> CrowdShow:
        return CrowdShow(opened.stage(), opened.entry.name, request.count, request.behaviour, request.seed)

    runner = CrowdRunner(make, send, failed, before)
    runner.start()
    return runner
