"""Two ends of a data link, and a port with an address of each kind."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from raw_robot import WAIT

from endpoints.data_port import DataPort
from endpoints.frames import Message
from endpoints.link import Link, StreamLink
from endpoints.throttle import Throttle

KEY = bytes(range(16))
A, B = bytes(16), b"b" * 16


class End:
    """A link with what came out of it and how it ended."""

    def __init__(self, name: str = "l", throttle: Throttle | None = None) -> None:
        self.got: list[Message] = []
        self.lost: list[str] = []
        self.left: list[Message] = []
        self.news = asyncio.Event()
        self.link = StreamLink(name, self._deliver, self._lost, self.left.append, throttle)

    def _deliver(self, message: Message, link: Link) -> None:
        self.got.append(message)
        self.news.set()

    def _lost(self, link: StreamLink, reason: str) -> None:
        self.lost.append(reason)
        self.news.set()

    async def until(self, wanted: Callable[[], bool]) -> None:
        async with asyncio.timeout(WAIT):
            while not wanted():
                self.news.clear()
                await self.news.wait()


class Listener(DataPort):
    """A port with an address of each kind."""

    async def start(self, directory: Path) -> list[str]:
        path = directory / "data.sock"
        await self.listen_unix(path)
        return [f"unix:{path}", f"tcp:127.0.0.1:{await self.listen_tcp('127.0.0.1', 0)}"]
