"""Publisher whose messages are stored until the platform has them."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import Any, get_args

import msgspec

from rce.client.backlog import Offline
from rce.client.connection import Connection
from rce.client.interface import CONNECT_TIMEOUT, Owner
from rce.client.store import MessageStore, Store, Stored
from rce.client.topics import TOPIC_ID, Publisher
from rce.client.values import encode
from rce.errors import InvalidRequest, LimitExceeded, NotConnected, RceError
from rce.protocol.blobs import detach
from rce.protocol.messages import Delivery

RETRY = 0.1  # seconds until a message is sent again whose peer had just gone

log = logging.getLogger("rce.client")


class StoringPublisher(Publisher):
    """Publisher that keeps each message until the Robot endpoint has acknowledged it.

    Messages are sent in their order, and once: what was not acknowledged when the socket broke is sent again, and the
    endpoint does not deliver what it has already. If that endpoint itself has ended meanwhile, nobody knows whether it
    had them; then they are dropped, and counted. Messages that are older than the `maxAge` of the delivery, and the
    oldest ones above `max_bytes` of the store, are dropped too.
    """

    def __init__(self, owner: Owner, tag: str, type_name: str, store: Store, delivery: Delivery) -> None:
        super().__init__(owner, tag, type_name, delivery=delivery)
        self._store = MessageStore(store, type_name)
        self._cursor = 0  # number of the last message that was written to the present connection
        self._waiting: dict[int, asyncio.Future[None]] = {}
        self._retry: asyncio.TimerHandle | None = None
        self._lost = 0
        self._surplus = 0  # number of the last message that was dropped because the store was full

    @property
    def dropped(self) -> int:
        """Number of messages that were dropped from the store."""
        return self._lost

    async def publish(self, value: Any, timeout: float = CONNECT_TIMEOUT, *, wait: bool = True) -> None:  # noqa: ASYNC109  # see wait_connected
        """Store a message, which is sent as soon as possible.

        Args:
            value: The message, as for `Publisher.publish`.
            timeout: Seconds to wait for a peer.
            wait: Wait for a peer first, and then until the platform has the message; False to return at once.

        Raises:
            NotConnected: The interface had no peer for `timeout` seconds; the message is not stored.
            InvalidRequest: The message cannot be expressed in JSON.
            LimitExceeded: The message was dropped from the store.
            DiskFull: The file of the store cannot grow.
            Unavailable: The interface or the robot was closed.
            RceError: The platform refused the message.
        """
        if wait:
            await self.wait_connected(timeout)
        if self._ended is not None:
            raise self._ended
        number = self._add(value)
        if not wait:
            self._send_next()
            return
        done = self._waiting[number] = asyncio.get_running_loop().create_future()
        self._send_next()
        await done

    def offer(self, value: Any, keep: int = 1) -> bool:  # all are kept
        """Store a message, as `publish` does that does not wait.

        Args:
            value: The message, as for `Publisher.publish`.
            keep: Ignored.

        Returns:
            False if the interface or the robot was closed.

        Raises:
            InvalidRequest: The message cannot be expressed in JSON.
            DiskFull: The file of the store cannot grow.
        """
        if self._ended is not None:
            return False
        self._add(value)
        self._send_next()
        return True

    def _add(self, value: Any) -> int:
        """Add a message to the store, in which the oldest ones give way; return its number."""
        wire, blobs = detach({"msg": value})
        number = self._store.add(time.time(), encode(wire), blobs)
        for surplus in self._store.surplus():
            self._surplus = surplus
            self._forget(surplus, LimitExceeded(f"{self.tag}: the store is full: the oldest messages are dropped"))
        return number

    def _send_next(self) -> None:
        """Queue the next message; the others wait in the store."""
        connection = self._connection()
        if connection is None or self._sending is connection:
            return
        self._check_incarnation(connection)
        message = self._store.after(self._cursor)
        if message is None:
            return
        if (early := self._early()) > 0:
            self._timer = self._timer or asyncio.get_running_loop().call_later(early, self._turn)
            return
        self._sending, self._next = connection, time.monotonic() + self._interval
        frame_id = f"{self.tag}/{message.number}"
        connection.put_message(
            self.tag, self._frame(message, frame_id), message.blobs, None, self._priority,
            lambda: self._begins(connection, message, frame_id),
        )  # fmt: skip

    def _frame(self, message: Stored, frame_id: str) -> bytes:
        start = {
            "iTag": self.tag,
            "type": self.type_name,
            "msgID": TOPIC_ID,
            "stream": self._store.stream,
            "number": message.number,
        }
        data = msgspec.json.encode(start)[:-1] + b"," + message.body[1:]
        return b'{"type":"DM","id":' + msgspec.json.encode(frame_id) + b',"data":' + data + b"}"

    def _check_incarnation(self, connection: Connection) -> None:
        """Drop what another Robot endpoint may have received already."""
        if self._store.sent and self._store.incarnation != connection.session.incarnation:
            unknown = 0
            while (message := self._store.after(0)) is not None and message.number <= self._store.sent:
                self._forget(message.number, LimitExceeded(f"{self.tag}: it is not known whether the message arrived"))
                unknown += 1
            if unknown:
                log.warning("%s: %d messages may or may not have arrived; they are not sent again", self.tag, unknown)
            self._store.written(0, connection.session.incarnation)

    def _begins(self, connection: Connection, message: Stored, frame_id: str) -> bool:
        """Take note that a message is written now; return False to drop it."""
        if self._sending is connection:
            self._sending, self._cursor = None, message.number
            asyncio.get_running_loop().call_soon(self._send_next)
        if self._ended is not None or message.number <= self._surplus:
            return False
        if time.time() > message.made + self._max_age:
            self._forget(message.number, LimitExceeded(f"{self.tag}: the message is too old"))
            return False
        if "ack" not in connection.features:  # a server of the original: what is written has arrived
            asyncio.get_running_loop().call_soon(self._answered, message.number, None)
            return True
        self._note_written(message.number, connection.session.incarnation)
        connection.expect(frame_id, lambda error: self._answered(message.number, error))
        return True

    def _note_written(self, number: int, incarnation: str) -> None:
        if number <= self._store.sent:
            return
        try:
            self._store.written(number, incarnation)
        except RceError as error:  # as a full disk: only the next program would need to know
            log.warning("%s: %s", self.tag, error)

    def _answered(self, number: int, error: RceError | None) -> None:
        """Remove a message that the endpoint has; keep one that it could not pass on, since the peer had gone."""
        if self._ended is not None:
            return
        if not isinstance(error, NotConnected):
            self._forget(number, error)
            return
        self._cursor = min(self._cursor, number - 1)
        self._retry = self._retry or asyncio.get_running_loop().call_later(RETRY, self._send_again)

    def _send_again(self) -> None:
        self._retry = None
        self._send_next()

    def _forget(self, number: int, error: RceError | None) -> None:
        try:
            self._store.remove(number)
            self._lost += isinstance(error, LimitExceeded)
        except RceError as failure:  # it is sent again later, and the endpoint knows it
            log.warning("%s: %s", self.tag, failure)
        done = self._waiting.pop(number, None)
        if done is not None and not done.done():
            done.set_exception(error) if error is not None else done.set_result(None)

    def _disconnected(self) -> None:
        self._cursor = 0
        super()._disconnected()

    def _end(self, error: RceError | None) -> None:
        if self._ended is not None:
            return
        super()._end(error)
        assert self._ended is not None
        if self._retry is not None:
            self._retry.cancel()
        for done in self._waiting.values():
            if not done.done():
                done.set_exception(self._ended)
        self._store.close()


def make_publisher(
    owner: Owner, tag: str, type_name: str, offline: Offline | Store, delivery: Delivery, codec: str = ""
) -> Publisher:
    """Return the publisher for a treatment of messages that cannot be sent.

    Raises:
        InvalidRequest: `offline` is none of the choices, or the file of the store cannot be used.
        RceError: The store cannot be opened; see `MessageStore`.
    """
    if offline == "store":
        offline = Store()
    if isinstance(offline, Store):
        if codec:
            raise InvalidRequest("a publisher that stores has no codec: leave it out, or drop what cannot be sent")
        return StoringPublisher(owner, tag, type_name, offline, delivery)
    if offline not in get_args(Offline):
        choices = ", ".join(get_args(Offline))
        raise InvalidRequest(f"offline={offline!r}: write {choices}, or give a Store", field="offline")
    return Publisher(owner, tag, type_name, keep_newest=offline == "newest", delivery=delivery, codec=codec)
