"""Data links: a stream between two endpoints (TCP or UNIX socket), or a queue between interfaces of one process."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Generic, Protocol, TypeVar

from twisted.logger import Logger

from endpoints.data.frames import Buffer, FrameReader, Message, pieces
from endpoints.data.throttle import Throttle
from endpoints.data.turns import SLICE, Turns
from rce.errors import LimitExceeded, Unavailable
from rce.net.budget import OVERHEAD
from rce.net.outbox import Outbox, Owner
from rce.net.sockets import tune

STRAYS = 1000  # messages a second without a receiver that a link may send for long, and 16 times as many at once
HIGH_WATER = 256 * 1024  # bytes; while the transport holds more, messages wait in the outbox, where they take turns
GATHERED = 4 * 1024  # bytes of a write that others may join
CLOSED = "closed by the other side"

log = Logger()
P = TypeVar("P")


class Link(Protocol):
    """Carrier of messages to the peers of an interface."""

    name: str
    opened: asyncio.Future[None]
    to_environment: bool  # False for a link to a Robot endpoint

    def send(self, message: Message, keep: int | None, owner: Owner | None = None) -> int:
        """Queue a message.

        Args:
            message: The message to send.
            keep: Number of messages of this source that may wait, the newest; None for all.
            owner: The interface, whose budget bounds the bytes of messages that wait.

        Returns:
            The number of older messages of the same source that were dropped.
        """

    def wait_for_room(self, source: bytes) -> asyncio.Future[None] | None:
        """Return None while `source` may send, else a future that is done when it may send again."""

    def backlog(self, source: bytes) -> int:
        """Return the number of messages of `source` that wait."""

    def discard(self, source: bytes) -> None:
        """Drop the waiting messages of `source`."""

    def gather(self) -> None:
        """Keep small messages back until `flush` is called, so that one system call is enough for all of them."""

    def flush(self) -> None:
        """Send what was gathered."""

    def pause(self, until: asyncio.Future[None]) -> None:
        """Stop receiving until the future is done."""

    def close(self) -> None:
        """Close the link on purpose, which is not reported as a loss."""


class _QueuedLink(Generic[P]):
    """Part of a link whose messages wait in an outbox."""

    _outbox: Outbox[P]

    def wait_for_room(self, source: bytes) -> asyncio.Future[None] | None:
        """Return None while `source` may send, else a future that is done when it may send again."""
        return self._outbox.wait_for_room(source)

    def backlog(self, source: bytes) -> int:
        """Return the number of messages of `source` that wait."""
        return self._outbox.backlog(source)

    def discard(self, source: bytes) -> None:
        """Drop the waiting messages of `source`."""
        self._outbox.discard(source)

    def gather(self) -> None:
        """Do nothing: messages need no system calls."""

    def flush(self) -> None:
        """Do nothing: nothing is gathered."""


class LoopLink(_QueuedLink[Message]):
    """Link between interfaces of one process; messages wait only while a receiver has paused it."""

    to_environment = True  # this one, where that matters

    def __init__(self, name: str, deliver: Callable[[Message, Link], None], sent: Callable[[Message], None]) -> None:
        """Create an open link; `sent` is called right before each message is delivered."""
        self.name = name
        self._sent = sent
        self.opened: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.opened.set_result(None)
        self._deliver = deliver
        self._outbox = Outbox(self._write)
        self._until: asyncio.Future[None] | None = None

    def send(self, message: Message, keep: int | None, owner: Owner | None = None) -> int:
        """Deliver a message, or queue it while the link is paused; return the number of dropped messages."""
        if self._outbox.idle:
            self._sent(message)
            self._deliver(message, self)
            return 0
        return self._outbox.put(message.source, iter((message,)), keep, len(message.payload) + OVERHEAD, owner)

    def pause(self, until: asyncio.Future[None]) -> None:
        """Stop delivering until the future is done."""
        if self._until is None:
            self._until = until
            self._outbox.pause()
            until.add_done_callback(self._resume)

    def close(self) -> None:
        """Drop all waiting messages."""
        self._outbox.clear()

    def _resume(self, _: asyncio.Future[None]) -> None:
        self._until = None
        self._outbox.resume()

    def _write(self, message: Message) -> bool:
        self._sent(message)
        self._deliver(message, self)
        return self._until is None


class StreamLink(_QueuedLink[list[Buffer]], asyncio.BufferedProtocol):
    """One end of a link over a socket.

    The link queues messages from the start. `DataPort` connects and authenticates it, then calls `attach`.

    Attributes:
        opened: Done when the link is open; fails with Unavailable when it cannot be opened.
        broken: Reason for which the link broke; empty while it has not.
    """

    to_environment = False

    def __init__(
        self,
        name: str,
        deliver: Callable[[Message, Link], None],
        lost: Callable[[StreamLink, str], None],
        sent: Callable[[Message], None],
        throttle: Throttle | None = None,
        turns: Turns | None = None,
        user: str = "",
    ) -> None:
        """Create a link that is not open yet.

        Args:
            name: Name of the link, the same at both ends.
            deliver: Called with each received message.
            lost: Called once with the reason when the link breaks or cannot be opened; not after `close`.
            sent: Called with each message right before its first frame goes out.
            throttle: Rate limit for received bytes, which several links may share.
            turns: Turns of the users whose links are received by this process.
            user: User of the other side.
        """
        self.name = name
        self.opened: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.opened.add_done_callback(lambda opened: opened.exception())  # mark it as retrieved: `lost` reports it
        self.broken = ""
        self._deliver = deliver
        self._lost = lost
        self._sent = sent
        self._reader = FrameReader()
        self._outbox = Outbox(self._write)
        self._outbox.pause()  # until the link is open
        self._streams = itertools.cycle(range(1 << 32))
        self._transport: asyncio.Transport | None = None
        self._full = False
        self._gathered: list[Buffer] | None = None  # small writes that go out together; None while none are kept
        self._throttle = throttle
        self._strays = Throttle(STRAYS)
        self._pauses = 0  # number of futures that must be done before reading resumes
        self._turns = turns or Turns()
        self._user = user
        self._received: deque[Message] = deque()  # not delivered yet
        self._turn: asyncio.Future[None] | None = None  # done when these are delivered; no more is read meanwhile

    def attach(self, transport: asyncio.Transport) -> None:
        """Open the link over `transport`, on which the handshake is complete."""
        if self.opened.done():  # closed during the handshake
            transport.abort()
            return
        transport.set_protocol(self)
        transport.set_write_buffer_limits(high=HIGH_WATER)
        tune(transport)
        self._transport = transport
        self.opened.set_result(None)
        self._outbox.resume()

    def fail(self, reason: str) -> None:
        """Mark the link as broken and report it; waiting messages are kept until it is closed."""
        if self._end(reason):
            log.warn("link {link}: {reason}", link=self.name, reason=reason)
            self._lost(self, reason)

    def _end(self, reason: str) -> bool:
        if self.broken:
            return False
        self.broken = reason
        self._outbox.pause()
        if not self.opened.done():
            self.opened.set_exception(Unavailable(f"link {self.name} did not open: {reason}"))
        return True

    # Link

    def send(self, message: Message, keep: int | None, owner: Owner | None = None) -> int:
        """Queue a message; return the number of older messages of the same source that were dropped."""
        size = len(message.payload) + OVERHEAD
        return self._outbox.put(message.source, self._pieces(message), keep, size, owner)

    def _pieces(self, message: Message) -> Iterator[list[Buffer]]:
        self._sent(message)
        yield from pieces(message, next(self._streams))

    def stray(self) -> None:
        """Count a message that no interface receives.

        A few come after a connection ended. More are a flood, which costs time that others need.

        Raises:
            LimitExceeded: The link carries too many of them.
        """
        if self._strays.consume(1):
            raise LimitExceeded(f"more than {STRAYS} messages a second belong to no connection")

    def pause(self, until: asyncio.Future[None]) -> None:
        """Stop reading from the socket until the future is done."""
        if self._transport is None or self._transport.is_closing():
            return
        self._pauses += 1
        if self._pauses == 1:
            self._transport.pause_reading()
        until.add_done_callback(self._pause_over)

    def _pause_over(self, _: asyncio.Future[None]) -> None:
        self._pauses -= 1
        if not self._pauses and self._transport is not None and not self._transport.is_closing():
            self._transport.resume_reading()

    def _pause_for(self, seconds: float) -> None:
        loop = asyncio.get_running_loop()
        over: asyncio.Future[None] = loop.create_future()
        loop.call_later(seconds, over.set_result, None)
        self.pause(over)

    def close(self) -> None:
        """Close the link and drop all waiting messages; `lost` is not called."""
        self._end("closed")
        self._outbox.clear()
        self._received.clear()
        if self._transport is not None:
            self._transport.close()

    # asyncio.BufferedProtocol

    def connection_lost(self, exc: Exception | None) -> None:
        """Report the loss of the connection."""
        self._transport = None
        if exc is not None:
            self.fail(str(exc))
        elif self._end(CLOSED):  # as a rule the other side was told first that the link is not needed any more
            log.info("link {link}: {reason}", link=self.name, reason=CLOSED)
            self._lost(self, CLOSED)

    def pause_writing(self) -> None:
        """Keep messages in the outbox while the transport is full."""
        self._full = True
        self._outbox.pause()

    def resume_writing(self) -> None:
        """Let messages leave the outbox again."""
        self._full = False
        if not self.broken:
            self._outbox.resume()

    def get_buffer(self, sizehint: int) -> memoryview:
        """Return the buffer for the next bytes."""
        return self._reader.get_buffer()

    def buffer_updated(self, nbytes: int) -> None:
        """Deliver the messages that the received bytes complete; a malformed stream breaks the link."""
        if self._throttle is not None and (wait := self._throttle.consume(nbytes)):
            self._pause_for(wait)
        try:
            self._received.extend(self._reader.buffer_updated(nbytes))
        except (LimitExceeded, UnicodeDecodeError) as error:
            self._abort(str(error))
            return
        if not self._received or self._turn is not None:
            return
        if self._turns.busy(self._user):
            self._wait_for_turn()
        else:
            self._deliver_slice()

    def _deliver_slice(self) -> None:
        """Deliver received messages for one slice of time; the rest waits for a turn."""
        end = time.monotonic() + SLICE
        try:
            while self._received:
                self._deliver(self._received.popleft(), self)
                if time.monotonic() > end and self._received:
                    self._wait_for_turn()
                    return
        except LimitExceeded as error:
            self._abort(str(error))
        if self._turn is not None:
            self._turn.set_result(None)
            self._turn = None

    def _wait_for_turn(self) -> None:
        if self._turn is None:
            self._turn = asyncio.get_running_loop().create_future()
            self.pause(self._turn)
        self._turns.wait(self._user, self._deliver_slice)

    def _abort(self, reason: str) -> None:
        """Break the link, because the other side violates a limit."""
        self._received.clear()
        self.fail(reason)
        if self._transport is not None:
            self._transport.abort()

    def _write(self, buffers: list[Buffer]) -> bool:
        assert self._transport is not None
        if self._gathered is None:
            self._transport.writelines(buffers)
        elif sum(map(len, buffers)) < GATHERED:
            self._gathered += buffers
        else:
            self._transport.writelines([*self._gathered, *buffers])
            self._gathered = []
        return not self._full

    def gather(self) -> None:
        """Keep small messages back until `flush` is called, so that one system call is enough for all of them."""
        if self._gathered is None:
            self._gathered = []

    def flush(self) -> None:
        """Send what was gathered."""
        gathered, self._gathered = self._gathered, None
        if gathered and self._transport is not None and not self._transport.is_closing():
            self._transport.writelines(gathered)
