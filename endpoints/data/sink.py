"""Sink: a link that ends in this process, where something else than a peer takes the messages."""

from __future__ import annotations

import asyncio

from endpoints.data.frames import Message
from rce.net.outbox import Owner


class Sink:
    """Base of links from an interface to what takes its messages at once; nothing is queued in it."""

    name = "sink"
    to_environment = False

    def __init__(self) -> None:
        self.opened: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.opened.set_result(None)

    def send(self, message: Message, keep: int | None, owner: Owner | None = None) -> int:
        """Take a message; return the number of older ones that were dropped."""
        raise NotImplementedError

    def wait_for_room(self, source: bytes) -> asyncio.Future[None] | None:
        """Return None: there is always room."""
        return None

    def backlog(self, source: bytes) -> int:
        """Return 0: nothing waits."""
        return 0

    def discard(self, source: bytes) -> None:
        """Do nothing: nothing waits."""

    def gather(self) -> None:
        """Do nothing: messages need no system calls."""

    def flush(self) -> None:
        """Do nothing: nothing is gathered."""

    def pause(self, until: asyncio.Future[None]) -> None:
        """Do nothing: what uses sinks drops old messages instead of pausing links."""

    def close(self) -> None:
        """Do nothing."""
