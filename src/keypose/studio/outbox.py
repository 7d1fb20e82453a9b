"""What waits to be sent to one browser: in order, never more than a few unacknowledged, stale messages dropped."""

from __future__ import annotations

import asyncio
from collections import OrderedDict

from keypose.studio.container import Body, pack
from keypose.studio.messages import Envelope, ServerMessage

WINDOW = 8
"""How many messages may be on their way before the browser has to acknowledge one."""


class Outbox:
    """Messages for one connection.

    A message put with ``replaces`` takes the place of an undelivered older one of the same key, so that a slow browser
    sees the newest progress (or, in a live stream, the newest pose) instead of falling behind.
    """

    def __init__(self, window: int = WINDOW) -> None:
        self.dropped = 0
        self._waiting: OrderedDict[str | int, tuple[ServerMessage, Body | None]] = OrderedDict()
        self._window = window
        self._sent = 0
        self._acknowledged = 0
        self._count = 0
        self._changed = asyncio.Event()

    def put(self, message: ServerMessage, replaces: str | None = None, body: Body | None = None) -> None:
        """Queue a message, with the arrays that it names."""
        key: str | int
        if replaces is None:
            self._count += 1
            key = self._count
        else:
            key = replaces
            self.dropped += self._waiting.pop(key, None) is not None
        self._waiting[key] = message, body
        self._changed.set()

    def acknowledge(self, sequence: int) -> None:
        """The browser has handled everything up to this number; numbers never sent are ignored."""
        if self._acknowledged < sequence <= self._sent:
            self._acknowledged = sequence
            self._changed.set()

    async def next(self) -> bytes:
        """The next message as a container, as soon as there is one and the browser keeps up."""
        while not self._waiting or self._sent - self._acknowledged >= self._window:
            self._changed.clear()
            await self._changed.wait()
        _, (message, body) = self._waiting.popitem(last=False)
        self._sent += 1
        return pack(Envelope(self._sent, message), body)
