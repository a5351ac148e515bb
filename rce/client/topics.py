"""Publishers and subscribers of a robot, made by the methods of `Robot` and `Environment`."""

from __future__ import annotations

import asyncio
import inspect
import logging
import math
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from typing import Any

from rce.client.backlog import Backlog, Encoded
from rce.client.connection import Connection, Message
from rce.client.interface import CONNECT_TIMEOUT, Interface, Owner
from rce.client.packing import Packer, Unpacker
from rce.client.stream import Stream
from rce.client.values import decode_message, encode_message
from rce.errors import RceError
from rce.net.outbox import Priority
from rce.protocol.messages import Delivery
from rce.protocol.messages.commands import DEEP, SHALLOW, is_large

ALL = Delivery()
KEY_FIELD = "key"  # of the error by which the platform asks for a key frame
TOPIC_ID = "nil"  # msgID of topic messages, as the original's clients send it

log = logging.getLogger("rce.client")


class Publisher(Interface):
    """Interface through which the robot sends messages.

    Messages that had not reached the platform when the socket broke are lost; none arrives twice. What `publish` with
    `wait=False` does with messages that cannot be sent, because the robot is offline or the interface has no peer, is
    chosen with `offline`:

    - `drop`: they are dropped.
    - `newest`: the newest one is kept, and sent as soon as possible.
    - `store`, or a `Store`: all are kept in memory or in a file until the platform has them, and none is lost with the
      socket; see `StoringPublisher`.

    Attributes:
        tag: Name of the interface, unique within the robot.
        type_name: ROS message type.
    """

    def __init__(
        self,
        owner: Owner,
        tag: str,
        type_name: str,
        *,
        keep_newest: bool = False,
        delivery: Delivery = ALL,
        codec: str = "",
    ) -> None:
        super().__init__(owner, tag, type_name)
        self._packer = Packer(codec, type_name) if codec else None
        self._backlog = Backlog(keep=keep_newest)
        self._priority = Priority[delivery.priority.upper()]
        self._max_age = delivery.maxAge or math.inf
        self._interval = 1 / delivery.rate if delivery.rate else 0.0
        self._next = 0.0  # time from which the next message may be sent
        self._timer: asyncio.TimerHandle | None = None
        self._sending: Connection | None = None  # in whose queue the first message of the backlog is
        self._drained = asyncio.Event()
        self._given_way = 0
        self._unpacked = 0  # of the dropped messages, those that were not packed

    @property
    def dropped(self) -> int:
        """Number of messages that were dropped: by `offer`, by `publish` with `wait=False`, or because of their age."""
        return self._given_way + self._backlog.dropped

    async def publish(self, value: Any, timeout: float = CONNECT_TIMEOUT, *, wait: bool = True) -> None:  # noqa: ASYNC109  # see wait_connected
        """Send a message, and wait for a peer and for room in the send queue first.

        So nothing is dropped on the way to the platform, and a slow link slows the sender down (back-pressure). While
        the robot is offline this waits for the reconnection. A control loop uses `wait=False`: then this never waits,
        an older unsent message gives way, and `offline` of the publisher says what becomes of
        messages that cannot be sent now.

        Args:
            value: The message as a dict; bytes of a PNG or JPEG file for an image interface, or of the serialized
                message (CDR) for a raw one. In a dict, byte arrays may be bytes and lists may be numpy arrays. With a
                codec, a numpy array, or a dict with `header` and `image` or `points`.
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
            if (early := self._early()) > 0:
                await asyncio.sleep(early)
                continue
            connection = self._connection()
            room = connection.room(self.tag) if connection is not None else None
            if connection is not None and room is None:
                break
            if room is not None:
                await asyncio.shield(room)  # other senders may wait for the same future
        self._send(connection, self._encoded(value), None)

    def offer(self, value: Any, keep: int = 1) -> bool:
        """Send a message without waiting; older unsent messages give way to it.

        For periodic data, such as poses and camera images, of which only the newest is of use.

        Args:
            value: The message, as for `publish`.
            keep: Messages of this interface that may wait in the send queue, including this one. The oldest are dropped
                and counted in `dropped`.

        Returns:
            False if the message was dropped because the robot is offline or the interface has no peer, unless `offline`
            of the publisher keeps it, or because the rate of the interface does not permit it yet.

        Raises:
            InvalidRequest: The message cannot be expressed in JSON.
        """
        connection = self._connection()
        if connection is None and self._backlog.keep and self._ended is None:
            self._put(value)
            return True
        if connection is None or self._early() > 0:
            self._given_way += 1
            self._unpacked += 1
            return False
        self._send(connection, self._encoded(value), keep)
        return True

    def _encoded(self, value: Any) -> Encoded:
        packed = value if self._packer is None else self._packer.pack(value, self.dropped - self._unpacked)
        return Encoded(*encode_message(self.tag, self.type_name, TOPIC_ID, packed))

    def _refused(self, error: RceError) -> bool:
        """Send a key frame if the platform cannot unpack video without one."""
        if self._packer is None or error.info.field != KEY_FIELD:
            return False
        self._packer.request_key()
        return True

    def _early(self) -> float:
        """Return the seconds until the rate of the interface permits a message."""
        return self._next - time.monotonic() if self._interval else 0.0

    def _send(self, connection: Connection, message: Encoded, keep: int | None) -> None:
        """Queue a message; it is dropped if it is too old when its turn comes."""
        now = time.monotonic()
        self._next = now + self._interval

        def may_start() -> bool:
            in_time = time.monotonic() <= now + self._max_age
            self._given_way += not in_time
            return in_time

        given_way = connection.put_message(self.tag, *message, keep, self._priority, may_start)
        self._given_way += given_way  # not in one statement, because `may_start` may run within the call

    def _put(self, value: Any) -> None:
        if self._ended is not None:
            raise self._ended
        message = self._encoded(value)
        self._backlog.put(message, self._connection() is not None, time.monotonic() + self._max_age)
        self._send_next()

    def _send_next(self) -> None:
        """Queue the first message of the backlog; the others wait here, so that at most one is lost with the socket."""
        self._backlog.drop_old(time.monotonic())
        connection, message = self._connection(), self._backlog.first()
        if message is None:
            self._drained.set()
        elif connection is None or self._sending is connection:
            return
        elif (early := self._early()) > 0:
            self._timer = self._timer or asyncio.get_running_loop().call_later(early, self._turn)
        else:
            self._sending, self._next = connection, time.monotonic() + self._interval
            connection.put_message(
                self.tag, *message, None, self._priority, lambda: self._may_start(connection, message)
            )

    def _turn(self) -> None:
        self._timer = None
        self._send_next()

    def _may_start(self, connection: Connection, message: Encoded) -> bool:
        """Take a message from the backlog when its turn comes; return False if it is not the first one any more."""
        self._backlog.drop_old(time.monotonic())
        present = self._backlog.first() is message
        if present:
            self._backlog.remove(message)
        if self._sending is connection:
            self._sending = None
            asyncio.get_running_loop().call_soon(self._send_next)
        return present

    def _update(self) -> None:
        super()._update()
        if self._open.is_set():
            if self._packer is not None:
                self._packer.request_key()
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
        if self._timer is not None:
            self._timer.cancel()


class Subscriber(Interface):
    """Interface through which the robot receives messages.

    Iterate over it with `async for`, `get` the next message, or have a callback called. The newest `depth` unread
    messages are kept. While the robot is offline nothing arrives; readers wait. The iteration ends when the subscriber
    or the robot is closed.

    Messages are dicts; byte arrays are base64 strings, NaN and infinities are floats. An image interface gives the
    bytes of a PNG or JPEG file (see `rce.client.images`), a raw one the bytes of the serialized message (CDR), and one
    with a codec an array (see `rce.client.packing`).

    Attributes:
        tag: Name of the interface, unique within the robot.
        type_name: ROS message type.
        stream: Queue of the unread messages.
    """

    def __init__(self, owner: Owner, tag: str, type_name: str, depth: int, codec: str = "") -> None:
        super().__init__(owner, tag, type_name)
        self._unpacker = Unpacker(codec, type_name) if codec else None
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
        value = decode_message(message.data, message.blobs)
        if self._unpacker is not None:
            value = self._unpacker.unpack(value)
        if value is not None:
            self.stream.put(value)

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
