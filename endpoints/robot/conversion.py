"""Conversion of one interface's messages: fast ones in place, others by the workers, in order either way."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass
from typing import Any

from converters import Wire
from converters.reduction import AnyCodec as Codec
from endpoints.data.frames import Message
from endpoints.robot.workers import Workers
from rce.errors import RceError
from rce.net.outbox import Outbox, Owner
from rce.protocol.blobs import Buffer


class FromRobot:
    """Messages from a robot by one interface."""

    def __init__(self, workers: Workers, user: str) -> None:
        self._workers = workers
        self._user = user
        self._last: asyncio.Task[None] | None = None  # the newest message that is not done

    def convert(self, codec: Codec, wire: Wire, then: Callable[[Buffer], None]) -> asyncio.Task[None] | None:
        """Convert a message to CDR, and call `then` with it.

        Returns:
            None if that is done, else a task that is done when it is, and has the error of the conversion or of `then`.

        Raises:
            RceError: The conversion was done in place and failed, or `then` has raised it.
        """
        if self._last is None and codec.encodes_fast(wire):
            then(codec.encode(wire))
            return None
        task = self._last = asyncio.create_task(self._convert(codec, wire, then, self._last))
        task.add_done_callback(self._done)
        return task

    async def _convert(
        self, codec: Codec, wire: Wire, then: Callable[[Buffer], None], previous: asyncio.Task[None] | None
    ) -> None:
        try:
            if codec.encodes_fast(wire):
                cdr = codec.encode(wire)
            else:
                cdr = await self._workers.encode(self._user, codec.recipe, wire)
        finally:  # after an error too, because the next message waits for this one only
            if previous is not None:
                await asyncio.wait([previous])
        then(cdr)

    def _done(self, task: asyncio.Task[None]) -> None:
        if self._last is task:
            self._last = None


class SharedConversion:
    """Conversion of a message to one form, for all who want it in this form.

    Attributes:
        abandoned: True if it was cancelled, because nobody waited for it any more.
    """

    def __init__(self, work: Coroutine[Any, Any, Wire]) -> None:
        self.abandoned = False
        self._task = asyncio.create_task(work)
        self._waiting = 0

    async def result(self) -> Wire:
        """Return the converted message; raises the error of the conversion."""
        self._waiting += 1
        try:
            return await asyncio.shield(self._task)
        finally:
            self._waiting -= 1
            if not self._waiting and not self._task.done():
                self.abandoned = True
                self._task.cancel()


@dataclass(frozen=True, slots=True)
class Outgoing:
    """A message to a robot before its conversion.

    Attributes:
        codec: Its codec.
        start: Its text frame up to the message's content.
        message: The message.
        keep: Number of messages of its interface that may wait, the newest; None for all.
        until: Time of the monotonic clock by which it must begin to be sent.
    """

    codec: Codec
    start: bytes
    message: Message
    keep: int | None
    until: float = math.inf

    def frame(self, wire: Wire) -> tuple[Buffer, Mapping[str, Buffer]]:
        """Return the text frame and the blobs of the converted message."""
        key = b',"msg*":' if wire.is_blob else b',"msg":'
        return b"".join((self.start, key, wire.raw, b"}}")), wire.blobs

    def convert(self) -> tuple[Buffer, Mapping[str, Buffer]]:
        """Return the text frame and the blobs; raises ConversionError."""
        return self.frame(self.codec.decode(self.message.payload))

    async def convert_by(self, workers: Workers, user: str) -> tuple[Buffer, Mapping[str, Buffer]]:
        """Return the text frame and the blobs; the workers convert a message once for all who want it in this form.

        Raises:
            ConversionError: The bytes are not a message of the type.
            LimitExceeded: The conversion takes too much time or memory.
        """
        shared, recipe = self.message.conversions, self.codec.recipe
        if recipe not in shared or shared[recipe].abandoned:
            shared[recipe] = SharedConversion(workers.decode(user, recipe, self.message.payload))
        return self.frame(await shared[recipe].result())


class ToRobot:
    """Messages to a robot by one interface, which are converted by the workers before they enter the robot's queue.

    One is converted at a time, and the next when `proceed` is called because the robot's queue has taken that one. So a
    message that is dropped costs no conversion, whether the robot or the workers are slow.
    """

    def __init__(
        self,
        workers: Workers,
        user: str,
        converted: Callable[[Outgoing, Buffer, Mapping[str, Buffer]], None],
        failed: Callable[[Outgoing, RceError], None],
    ) -> None:
        """Create an empty queue.

        Args:
            workers: The workers.
            user: The robot's user.
            converted: Called with a message, its text frame and its blobs.
            failed: Called with a message that cannot be converted.
        """
        self._workers = workers
        self._user = user
        self._converted = converted
        self._failed = failed
        self._queue: Outbox[Outgoing] = Outbox(self._begin)
        self._task: asyncio.Task[None] | None = None

    @property
    def empty(self) -> bool:
        """True if a message can enter the robot's queue directly without overtaking one."""
        return self._queue.empty

    def put(self, message: Outgoing, size: int, owner: Owner) -> int:
        """Queue a message; return the number of dropped messages. For size and owner see `Outbox.put`."""
        return self._queue.put(b"", iter((message,)), message.keep, size, owner)

    def backlog(self) -> int:
        """Return the number of messages that wait."""
        return self._queue.backlog(b"")

    def wait_for_room(self) -> asyncio.Future[None] | None:
        """Return None while there is room, else a future that is done when there is."""
        return self._queue.wait_for_room(b"")

    def proceed(self) -> None:
        """Convert the next message unless one is being converted."""
        if self._task is None:
            self._queue.resume()

    def close(self) -> None:
        """Drop all messages."""
        self._queue.clear()
        if self._task is not None:
            self._task.cancel()

    def _begin(self, message: Outgoing) -> bool:
        self._task = asyncio.create_task(self._convert(message))
        return False

    async def _convert(self, outgoing: Outgoing) -> None:
        payload = outgoing.message.payload
        try:
            if outgoing.codec.decodes_fast(payload):
                frame, blobs = outgoing.convert()
            else:
                frame, blobs = await outgoing.convert_by(self._workers, self._user)
        except RceError as error:
            self._task = None
            self._failed(outgoing, error)
            self.proceed()
        else:
            self._task = None
            self._converted(outgoing, frame, blobs)
