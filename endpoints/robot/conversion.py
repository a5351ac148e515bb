"""Conversion of one interface's messages: fast ones in place, others by the workers, in order either way."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine, Mapping
from functools import partial
from time import monotonic
from typing import Any

from msgspec import Struct

from converters import Wire
from converters.reduction import AnyCodec as Codec
from endpoints.data.frames import Message
from endpoints.data.turns import SLICE
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


Frame = tuple[Buffer, Mapping[str, Buffer]]
"""Text frame of a message, and its blobs."""
Receive = Callable[["asyncio.Task[Wire]"], None]


class SharedConversion:
    """Conversion of a message to one form, for all who want it in this form.

    Many receivers of a large message take milliseconds together, so they get it in slices of time.

    Attributes:
        abandoned: True if it was cancelled, because nobody waited for it any more.
    """

    def __init__(self, work: Coroutine[Any, Any, Wire]) -> None:
        self.abandoned = False
        self._receivers: dict[Receive, None] = {}
        self._task = asyncio.create_task(work)
        self._task.add_done_callback(lambda _: self._hand_out())

    def hand_to(self, receive: Receive) -> None:
        """Call `receive` with the task once it is done; never before this method returns."""
        if self._task.done() and not self._receivers:
            asyncio.get_running_loop().call_soon(self._hand_out)
        self._receivers[receive] = None

    def forget(self, receive: Receive) -> None:
        """Do not call `receive` any more."""
        self._receivers.pop(receive, None)
        if not self._receivers and not self._task.done():
            self.abandoned = True
            self._task.cancel()

    def _hand_out(self) -> None:
        if self._task.cancelled():  # nobody waits, or the workers are closed
            self._receivers.clear()
        end = monotonic() + SLICE
        try:
            while self._receivers and monotonic() < end:
                receive = next(iter(self._receivers))
                del self._receivers[receive]
                receive(self._task)
        finally:  # a defect of one receiver must not cost the others the message
            if self._receivers:
                asyncio.get_running_loop().call_soon(self._hand_out)


class Outgoing(Struct, frozen=True):
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

    def frame(self, wire: Wire) -> Frame:
        """Return the text frame and the blobs of the converted message."""
        key = b',"msg*":' if wire.is_blob else b',"msg":'
        return b"".join((self.start, key, wire.raw, b"}}")), wire.blobs

    def convert(self) -> Frame:
        """Return the text frame and the blobs; raises ConversionError."""
        return self.frame(self.codec.decode(self.message.payload))

    def shared(self, workers: Workers, user: str) -> SharedConversion:
        """Return the conversion by the workers, which convert a message once for all who want it in this form."""
        conversions, recipe = self.message.conversions, self.codec.recipe
        if recipe not in conversions or conversions[recipe].abandoned:
            conversions[recipe] = SharedConversion(workers.decode(user, recipe, self.message.payload))
        found: SharedConversion = conversions[recipe]
        return found


def _ignore(*_: object) -> None:
    pass


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
        self._cancel: Callable[[], None] | None = None  # cancels the conversion that is in progress

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
        if self._cancel is None:
            self._queue.resume()

    def close(self) -> None:
        """Drop all messages, for good."""
        self._queue.clear()
        if self._cancel is not None:
            self._cancel()
        self._converted = self._failed = _ignore  # break the reference cycle with the interface

    def _begin(self, outgoing: Outgoing) -> bool:
        if outgoing.codec.decodes_fast(outgoing.message.payload):
            self._cancel = asyncio.get_running_loop().call_soon(self._finish, outgoing, outgoing.convert).cancel
            return False
        shared = outgoing.shared(self._workers, self._user)

        def receive(done: asyncio.Task[Wire]) -> None:
            self._finish(outgoing, lambda: outgoing.frame(done.result()))

        self._cancel = partial(shared.forget, receive)
        shared.hand_to(receive)
        return False

    def _finish(self, outgoing: Outgoing, convert: Callable[[], Frame]) -> None:
        self._cancel = None
        try:
            frame, blobs = convert()
        except RceError as error:
            self._failed(outgoing, error)
            self.proceed()
        else:
            self._converted(outgoing, frame, blobs)
