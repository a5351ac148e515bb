"""Ends of data links, and a data port with an address of each kind."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from endpoints.data.frames import Message
from endpoints.data.link import Link, StreamLink
from endpoints.data.port import DataPort
from endpoints.data.throttle import Throttle
from tests.support.endpoints.raw_robot import WAIT

KEY = bytes(range(16))
A, B = bytes(16), b"b" * 16


class End:
    """End of a link that records its messages and losses."""

    def __init__(self, name: str = "l", throttle: Throttle | None = None) -> None:
        self.received: list[Message] = []
        self.lost: list[str] = []
        self.sent: list[Message] = []
        self.changed = asyncio.Event()
        self.link = StreamLink(name, self._deliver, self._lost, self.sent.append, throttle)

    def _deliver(self, message: Message, link: Link) -> None:
        self.received.append(message)
        self.changed.set()

    def _lost(self, link: StreamLink, reason: str) -> None:
        self.lost.append(reason)
        self.changed.set()

    async def until_received(self, count: int) -> None:
        await self.until(lambda: len(self.received) == count)

    async def until(self, wanted: Callable[[], bool]) -> None:
        async with asyncio.timeout(WAIT):
            while not wanted():
                self.changed.clear()
                await self.changed.wait()


class Listener(DataPort):
    """Data port with an address of each kind."""

    async def start(self, directory: Path) -> list[str]:
        path = directory / "data.sock"
        await self.listen_unix(path)
        return [f"unix:{path}", f"tcp:127.0.0.1:{await self.listen_tcp('127.0.0.1', 0)}"]
