"""The robot's ends of topics. Made by `Robot` and `Environment`, which add and connect them."""

from __future__ import annotations

import asyncio
import inspect
import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from typing import Any

from rce.client.connection import Message
from rce.client.interface import CONNECT_TIMEOUT, Interface, Owner
from rce.client.stream import Stream
from rce.client.values import decode_message, encode_message
from rce.errors import RceError

TOPIC_ID = "nil"  # the msgID of topics, by convention

log = logging.getLogger("rce.client")


class Publisher(Interface):
    """Sends messages of a topic. What had not arrived when the socket broke is lost, never sent twice."""

    dropped = 0
    """Messages that `offer` did not send."""

    async def publish(self, value: Any, timeout: float = CONNECT_TIMEOUT) -> None:  # noqa: ASYNC109  # see wait_connected
        """Send a message: a dict, or the bytes of an image or of a raw interface.

        Waits for a peer and for room in the queue, so that nothing is dropped on the way to the platform. Raises
        NotConnected after `timeout` seconds without a peer, InvalidRequest for what JSON cannot say.
        """
        while True:
            await self.wait_connected(timeout)
            connection = self._connection()
            room = connection.room(self.tag) if connection is not None else None
            if connection is not None and room is None:
                break
            if room is not None:
                await asyncio.shield(room)  # others may wait for the same
        text, blobs = encode_message(self.tag, self.type_name, TOPIC_ID, value)
        connection.put_message(self.tag, text, blobs)

    def offer(self, value: Any, keep: int = 1) -> bool:
        """Send a message without waiting, and let it replace older ones so that at most `keep` wait.

        False if it was dropped because there is no peer. Raises InvalidRequest.
        """
        connection = self._connection()
        if connection is None:
            self.dropped += 1
            return False
        text, blobs = encode_message(self.tag, self.type_name, TOPIC_ID, value)
        self.dropped += connection.put_message(self.tag, text, blobs, keep)
        return True


class Subscriber(Interface):
    """Receives messages of a topic: iterate over it, `get` the next, or give a callback when it is made.

    Keeps the newest `depth` that were not taken yet and counts the others in `dropped`.
    """

    def __init__(self, owner: Owner, tag: str, type_name: str, depth: int) -> None:
        super().__init__(owner, tag, type_name)
        self.stream: Stream[Any] = Stream(depth)
        self._task: asyncio.Task[None] | None = None

    @property
    def dropped(self) -> int:
        return self.stream.dropped

    def __aiter__(self) -> AsyncIterator[Any]:
        return aiter(self.stream)

    async def get(self, timeout: float | None = None) -> Any:  # noqa: ASYNC109  # as queues of other libraries
        """The next message. Raises TimedOut after `timeout` seconds."""
        return await self.stream.get(timeout)

    def call(self, callback: Callable[[Any], Awaitable[None] | None]) -> None:
        """Have `callback` called with every message, one after the other; its errors are logged."""
        self._task = asyncio.create_task(self._call(callback), name=f"rce subscriber {self.tag}")

    def received(self, message: Message) -> None:
        self.stream.put(decode_message(message.data, message.blobs))

    def ended(self, error: RceError | None) -> None:
        super().ended(error)
        self.stream.end(error)

    async def _call(self, callback: Callable[[Any], Awaitable[None] | None]) -> None:
        with suppress(RceError):  # why the robot ended is told to those who ask it
            async for value in self.stream:
                try:
                    result = callback(value)
                    if inspect.isawaitable(result):
                        await result
                except Exception:
                    log.exception("the callback of %s failed", self.tag)
