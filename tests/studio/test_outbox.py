"""What waits for one browser."""

from __future__ import annotations

import asyncio

from keypose.studio.container import unpack
from keypose.studio.messages import Notice, Progress
from keypose.studio.outbox import Outbox


def notice(n: int) -> Notice:
    return Notice("notice", str(n), "")


def progress(fraction: float) -> Progress:
    return Progress("progress", "job", "", fraction, done=False)


async def taken(outbox: Outbox) -> dict[str, object]:
    return unpack(await asyncio.wait_for(outbox.next(), 2))[0]


def test_messages_arrive_in_order_and_numbered() -> None:
    async def run() -> None:
        outbox = Outbox()
        for n in range(3):
            outbox.put(notice(n))
        got = [await taken(outbox) for _ in range(3)]
        assert [g["sequence"] for g in got] == [1, 2, 3]
        assert [g["message"]["title"] for g in got] == ["0", "1", "2"]  # type: ignore[index]

    asyncio.run(run())


def test_a_newer_message_takes_the_place_of_an_undelivered_older_one() -> None:
    async def run() -> None:
        outbox = Outbox()
        outbox.put(progress(0.1), "job")
        outbox.put(notice(1))
        outbox.put(progress(0.9), "job")
        first, second = await taken(outbox), await taken(outbox)
        assert first["message"]["title"] == "1"  # type: ignore[index]
        assert second["message"]["fraction"] == 0.9  # type: ignore[index]
        assert outbox.dropped == 1

    asyncio.run(run())


def test_a_browser_that_does_not_acknowledge_gets_no_more_than_the_window() -> None:
    async def run() -> None:
        outbox = Outbox(window=2)
        for n in range(5):
            outbox.put(notice(n))
        await taken(outbox)
        await taken(outbox)
        waiting = asyncio.ensure_future(outbox.next())
        await asyncio.sleep(0.02)
        assert not waiting.done()
        outbox.acknowledge(99)  # was never sent: says nothing
        await asyncio.sleep(0.02)
        assert not waiting.done()
        outbox.acknowledge(1)
        assert unpack(await asyncio.wait_for(waiting, 2))[0]["sequence"] == 3

    asyncio.run(run())


def test_a_message_put_later_wakes_the_sender() -> None:
    async def run() -> None:
        outbox = Outbox()
        waiting = asyncio.ensure_future(outbox.next())
        await asyncio.sleep(0.01)
        outbox.put(notice(7))
        assert unpack(await asyncio.wait_for(waiting, 2))[0]["message"]["title"] == "7"

    asyncio.run(run())
