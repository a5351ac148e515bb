"""Publishers and subscribers of a robot, made by the methods of `Robot` and `Environment`."""

from __future__ import annotations

import asyncio
import inspect
import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from typing import Any

from rce.client.backlog import Backlog, Encoded, Offline
from rce.client.connection import Connection, Message
from rce.client.interface import CONNECT_TIMEOUT, Interface, Owner
from rce.client.stream import Stream
from rce.client.values import decode_message, encode_message
from rce.errors import RceError
from rce.protocol.messages.commands import DEEP, SHALLOW, is_large

TOPIC_ID = "nil"  # msgID of topic messages, as the original's clients send it

log = logging.getLogger("rce.client")


class Publisher(Interface):
    """Interface through which the robot sends messages.

    Messages that had not reached the platform when the socket broke are lost; none is sent twice. What `publish` with
    `wait=False` does with messages that cannot be sent, because the robot is offline or the interface has no peer, is
    chosen with `offline`:

    - `drop`: they are dropped.
    - `newest`: the newest one is kept, and sent as soon as possible.
    - `store`: they are sent in their order as soon as possible; of more than 10,000 messages or 64 MiB the oldest are
      dropped.

    Attributes:
        tag: Name of the interface, unique within the robot.
        type_name: ROS message type.
    """

    def __init__(self, owner: Owner, tag: str, type_name: str, offline: Offline = "drop") -> None:
        super().__init__(owner, tag, type_name)
        self._backlog = Backlog(offline)
        self._sending: Connection | None = None  # in whose queue the first message of the backlog is
        self._drained = asyncio.Event()
        self._given_way = 0

    @property
    def dropped(self) -> int:
        """Number of messages that `offer`, and `publish` with `wait=False`, have dropped."""
        return self._given_way + self._backlog.dropped

    async def publish(self, value: Any, timeout: float = CONNECT_TIMEOUT, *, wait: bool = True) -> None:  # noqa: ASYNC109  # see wait_connected
        """Send a message, and wait for a peer and for room in the send queue first.

        So nothing is dropped on the way to the platform, and a slow link slows the sender down (back-pressure). While
        the robot is offline this waits for the reconnection. A control loop uses `wait=False`: then this never waits,
        older unsent messages give way (except with `store`), and `offline` of the publisher says what becomes of
        messages that cannot be sent now.

        Args:
            value: The message as a dict; bytes of a PNG or JPEG file for an image interface, or of the serialized
                message (CDR) for a raw one. In a dict, byte arrays may be bytes and lists may be numpy arrays.
            timeout: Seconds to wait for a peer.
            wait: False to return at once in any case.

        Raises:
            NotConnected: The interface had no peer for `timeout` seconds.
            InvalidRequest: The message cannot be expressed in JSON.
            Unavailable: The interface or the robot was closed.
            RceError: The platform refused the robot. A message that does not fit its ROS type is reported by the
                platform as a `ConversionError` in `Robot.events()`.
        """
        if not wait:
            self._put(value)
            return
        while True:
            await self.wait_connected(timeout)
            if self._backlog:
                self._drained.clear()
                await self._drained.wait()
                continue
            connection = self._connection()
            room = connection.room(self.tag) if connection is not None else None
            if connection is not None and room is None:
                break
            if room is not None:
                await asyncio.shield(room)  # other senders may wait for the same future
        text, blobs = encode_message(self.tag, self.type_name, TOPIC_ID, value)
        connection.put_message(self.tag, text, blobs)

    def offer(self, value: Any, keep: int = 1) -> bool:
        """Send a message without waiting; older unsent messages give way to it.

        For periodic data, such as poses and camera images, of which only the newest is of use.

        Args:
            value: The message, as for `publish`.
            keep: Messages of this interface that may wait in the send queue, including this one. The oldest are dropped
                and counted in `dropped`.

        Returns:
            False if the message was dropped because the robot is offline or the interface has no peer.

        Raises:
            InvalidRequest: The message cannot be expressed in JSON.
        """
        connection = self._connection()
        if connection is None:
            self._given_way += 1
            return False
        text, blobs = encode_message(self.tag, self.type_name, TOPIC_ID, value)
        self._given_way += connection.put_message(self.tag, text, blobs, keep)
        return True

    def _put(self, value: Any) -> None:
        if self._ended is not None:
            raise self._ended
        message = Encoded(*encode_message(self.tag, self.type_name, TOPIC_ID, value))
        self._backlog.put(message, possible=self._connection() is not None)
        self._send_next()

    def _send_next(self) -> None:
        """Queue the first message of the backlog; the others wait here, so that at most one is lost with the socket."""
        connection, message = self._connection(), self._backlog.first()
        if message is None:
            self._drained.set()
        elif connection is not None and self._sending is not connection:
            self._sending = connection
            connection.send_message(self.tag, *message, lambda: self._started(connection, message))

    def _started(self, connection: Connection, message: Encoded) -> None:
        self._backlog.remove(message)
        if self._sending is connection:
            self._sending = None
            asyncio.get_running_loop().call_soon(self._send_next)

    def _update(self) -> None:
        super()._update()
        if self._open.is_set():
            self._send_next()
        else:
            self._backlog.disconnected()

    def _disconnected(self) -> None:
        super()._disconnected()
        self._sending = None
        self._backlog.disconnected()
        self._drained.set()

    def _end(self, error: RceError | None) -> None:
        super()._end(error)
        self._drained.set()


class Subscriber(Interface):
    """Interface through which the robot receives messages.

    Iterate over it with `async for`, `get` the next message, or have a callback called. The newest `depth` unread
    messages are kept. While the robot is offline nothing arrives; readers wait. The iteration ends when the subscriber
    or the robot is closed.

    Messages are dicts; byte arrays are base64 strings, NaN and infinities are floats. An image interface gives the
    bytes of a PNG or JPEG file (see `rce.client.images`), a raw one the bytes of the serialized message (CDR).

    Attributes:
        tag: Name of the interface, unique within the robot.
        type_name: ROS message type.
        stream: Queue of the unread messages.
    """

    def __init__(self, owner: Owner, tag: str, type_name: str, depth: int) -> None:
        super().__init__(owner, tag, type_name)
        self.stream: Stream[Any] = Stream(depth or (SHALLOW if is_large(type_name) else DEEP))
        self._task: asyncio.Task[None] | None = None

    @property
    def dropped(self) -> int:
        """Number of messages that were dropped because more than `depth` were unread."""
        return self.stream.dropped

    def __aiter__(self) -> AsyncIterator[Any]:
        return aiter(self.stream)

    async def get(self, timeout: float | None = None) -> Any:  # noqa: ASYNC109  # as queues of other libraries
        """Return the next message, waiting for it if there is none.

        Args:
            timeout: Seconds to wait; None to wait without limit.

        Raises:
            TimedOut: No message arrived within `timeout` seconds.
            Unavailable: The subscriber or the robot was closed.
            RceError: The platform refused the robot.
        """
        return await self.stream.get(timeout)

    def call(self, callback: Callable[[Any], Awaitable[None] | None]) -> None:
        """Call a function with every message from now on, one after the other.

        Exceptions of the callback are logged; the next message is delivered all the same.

        Args:
            callback: Function or coroutine function.
        """
        self._task = asyncio.create_task(self._call(callback), name=f"rce subscriber {self.tag}")

    def _receive(self, message: Message) -> None:
        self.stream.put(decode_message(message.data, message.blobs))

    def _end(self, error: RceError | None) -> None:
        super()._end(error)
        self.stream.end(error)

    async def _call(self, callback: Callable[[Any], Awaitable[None] | None]) -> None:
        with suppress(RceError):  # the robot's methods raise the error that ended the stream
            async for value in self.stream:
                try:
                    result = callback(value)
                    if inspect.isawaitable(result):
                        await result
                except Exception:
                    log.exception("the callback of %s failed", self.tag)
