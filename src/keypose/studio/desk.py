"""What one page asks of its player, and what becomes of it. Everything here runs on the event loop."""

from __future__ import annotations

import asyncio
import itertools
from contextlib import suppress
from typing import TYPE_CHECKING

from keypose.errors import KeyposeError
from keypose.studio import messages
from keypose.studio.container import Body
from keypose.studio.outbox import Outbox
from keypose.studio.pacing import Pacer
from keypose.studio.player import Player, Recording, bake

if TYPE_CHECKING:
    from keypose.studio.session import Session

MOST_PLAYERS = 8
"""Pages that play at the same time; each costs a fifth of a core."""

TAKES_KEPT = 4

STAGES_KEPT = 2 * MOST_PLAYERS
"""Characters that pages may fetch; a file that is changed again and again leaves old ones behind."""


class PlayDesk:
    """One page's player, from its opening to the end of the connection."""

    def __init__(self, session: Session, outbox: Outbox) -> None:
        self._session, self._outbox = session, outbox
        self._pacer: Pacer | None = None
        self._opening: asyncio.Task[None] | None = None
        self._baking: set[asyncio.Task[None]] = set()
        self._numbers = itertools.count(1)
        self._takes: list[str] = []

    def handle(self, request: messages.PlayRequest) -> None:
        """Do what a page asks; what cannot be done is said to that page."""
        pacer = self._pacer
        match request:
            case messages.PlayOpen(graph=graph):
                self._leave()
                self._opening = asyncio.create_task(self._open(graph))
            case messages.PlayClose():
                self._leave()
            case _ if pacer is None:
                pass  # an answer to a player that is gone already
            case messages.PlayInput(values=values, sequence=sequence):
                wrong = pacer.player.unknown(values)
                if wrong:
                    self._fail("This input was not taken", wrong)
                else:
                    pacer.set(values, sequence)
            case messages.PlayAcknowledge(number=number):
                pacer.acknowledge(number)
            case messages.PlayPace(paused=paused, speed=speed):
                pacer.pace(paused=paused, speed=speed)
            case messages.PlayStep():
                pacer.single_step()
            case messages.PlayReset():
                pacer.order(lambda player: player.reset())
            case messages.PlayExplain(joint=joint):
                pacer.order(lambda player: setattr(player, "joint", joint))
            case messages.PlayRecord(on=True):
                pacer.order(lambda player: player.record())
            case messages.PlayRecord():
                pacer.end_recording()

    def close(self) -> None:
        """The page is gone."""
        self._leave()
        for task in self._baking:
            task.cancel()
        for id in self._takes:
            self._session.takes.pop(id, None)

    # ---- opening ---------------------------------------------------------------------------------------------------

    async def _open(self, id: str) -> None:
        opened = self._session.graphs.get(id)
        if opened is None:
            self._fail("This graph cannot be played", f"no graph '{id[:60]}' is open")
            return
        if len(self._session.desks) >= MOST_PLAYERS:
            self._fail("Too many players", f"{MOST_PLAYERS} pages play already; close one of them")
            return
        self._session.desks.add(self)
        number = next(self._numbers)
        job = f"play {number}"
        self._put(messages.Progress("progress", job, f"Preparing {opened.entry.name}", None, done=False), job)
        try:
            opened = self._session.graphs[id] = await asyncio.to_thread(opened.current)
            stage = await asyncio.to_thread(opened.stage)
        except (KeyposeError, OSError, MemoryError) as error:
            self._session.desks.discard(self)
            self._fail("This graph cannot be played", f"{opened.entry.name}: {error}")
            return
        finally:
            self._put(messages.Progress("progress", job, "", 1.0, done=True), job)
        player = Player(number, opened, stage)
        stages = self._session.stages
        stages.pop(stage.scene.id, None)
        stages[stage.scene.id] = stage.payload
        while len(stages) > STAGES_KEPT:
            del stages[next(iter(stages))]
        self._put(player.ready())
        loop = asyncio.get_running_loop()

        def later(function: object, *arguments: object) -> None:
            with suppress(RuntimeError):  # the studio ends in the middle of a step
                loop.call_soon_threadsafe(function, *arguments)  # type: ignore[arg-type]

        def frame(frame: messages.PlayFrame, body: Body) -> None:
            later(self._outbox.put, frame, None, body)

        self._pacer = Pacer(
            player,
            frame=frame,
            recorded=lambda recording: later(self._begin_bake, player, recording),
            failed=lambda text: later(self._fail, "The graph stopped", text),
        )
        self._pacer.start()

    def _leave(self) -> None:
        if self._opening is not None:
            self._opening.cancel()
            self._opening = None
        if self._pacer is not None:
            self._pacer.close()
            self._pacer = None
        self._session.desks.discard(self)

    # ---- takes -----------------------------------------------------------------------------------------------------

    def _begin_bake(self, player: Player, recording: Recording) -> None:
        task = asyncio.create_task(self._bake(player, recording))
        self._baking.add(task)
        task.add_done_callback(self._baking.discard)

    async def _bake(self, player: Player, recording: Recording) -> None:
        id = self._session.next_take()
        job = f"bake {id}"
        self._put(messages.Progress("progress", job, "Baking the recording", None, done=False), job)
        try:
            run = await asyncio.to_thread(bake, recording, player.stage)
        finally:
            self._put(messages.Progress("progress", job, "", 1.0, done=True), job)
        motion = run.motion
        self._session.takes[id] = run.scene()
        self._takes.append(id)
        while len(self._takes) > TAKES_KEPT:
            self._session.takes.pop(self._takes.pop(0), None)
        name = f"{motion.name}-{id}"
        take = messages.PlayTake(
            "play_take", player.number, id, name, motion.frame_count, motion.rate_hz, motion.duration_s
        )
        self._put(take)

    def _put(self, message: messages.ServerMessage, replaces: str | None = None) -> None:
        self._outbox.put(message, replaces)

    def _fail(self, title: str, message: str) -> None:
        self._put(messages.Failure("failure", title, message))
