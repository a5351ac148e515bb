"""Data links: one stream between two endpoints (TCP, UNIX socket), or none where both ends are in one process."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Iterator
from typing import Protocol

from twisted.logger import Logger

from endpoints.frames import Buffer, FrameReader, Message, pieces
from endpoints.throttle import Throttle
from rce.errors import LimitExceeded, Unavailable
from rce.outbox import Outbox
from rce.sockets import tune

HIGH_WATER = 256 * 1024  # bytes in the transport at which the outbox keeps what follows, where it can be overtaken

log = Logger()


class Link(Protocol):
    """Where a route leads."""

    name: str
    opened: asyncio.Future[None]

    def send(self, message: Message, keep: int | None) -> int:
        """Queue a message; returns how many older ones of its source were dropped for it."""

    def room(self, source: bytes) -> asyncio.Future[None] | None:
        """None while `source` may send on, else what is done when it may."""

    def backlog(self, source: bytes) -> int:
        """How many messages of `source` wait."""

    def forget(self, source: bytes) -> None:
        """Drop what waits of `source`."""

    def pause(self, until: asyncio.Future[None]) -> None:
        """Take nothing more from the other side until then."""

    def close(self) -> None:
        """End it on purpose: nobody is told."""


class LoopLink:
    """A link between interfaces of one process: it queues only while its receiver asks it to pause."""

    def __init__(self, name: str, deliver: Callable[[Message, Link], None], left: Callable[[Message], None]) -> None:
        self.name = name
        self._left = left
        self.opened: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.opened.set_result(None)
        self._deliver = deliver
        self._outbox: Outbox[Message] = Outbox(self._write)
        self._until: asyncio.Future[None] | None = None

    def send(self, message: Message, keep: int | None) -> int:
        return self._outbox.put(message.source, iter((message,)), keep)

    def room(self, source: bytes) -> asyncio.Future[None] | None:
        return self._outbox.room(source)

    def backlog(self, source: bytes) -> int:
        return self._outbox.backlog(source)

    def forget(self, source: bytes) -> None:
        self._outbox.forget(source)

    def pause(self, until: asyncio.Future[None]) -> None:
        if self._until is None:
            self._until = until
            self._outbox.pause()
            until.add_done_callback(self._resume)

    def close(self) -> None:
        self._outbox.clear()

    def _resume(self, _: asyncio.Future[None]) -> None:
        self._until = None
        self._outbox.resume()

    def _write(self, message: Message) -> bool:
        self._left(message)
        self._deliver(message, self)
        return self._until is None


class StreamLink(asyncio.BufferedProtocol):
    """One end of a link over a socket; `opened` is done once the other side has proved itself, or has not."""

    def __init__(
        self,
        name: str,
        deliver: Callable[[Message, Link], None],
        lost: Callable[[StreamLink, str], None],
        left: Callable[[Message], None],
        throttle: Throttle | None = None,
    ) -> None:
        """`lost` is called once, if the link breaks or does not open; not when it is closed on purpose. `left` is
        called with each message that begins to go out.

        `throttle` is for what comes in, perhaps together with other links.
        """
        self.name = name
        self.opened: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.opened.add_done_callback(lambda opened: opened.exception())  # `lost` has said it
        self.broken = ""  # why, once it is
        self._deliver = deliver
        self._lost = lost
        self._left = left
        self._reader = FrameReader()
        self._outbox: Outbox[list[Buffer]] = Outbox(self._write)
        self._outbox.pause()  # until the greeting is over
        self._streams = itertools.cycle(range(1 << 32))
        self._transport: asyncio.Transport | None = None
        self._full = False
        self._throttle = throttle
        self._holding = 0  # how many reasons there are to take nothing at present

    def carry(self, transport: asyncio.Transport) -> None:
        """The greeting is over: this end of the link has `transport` from now on."""
        if self.opened.done():  # it was closed meanwhile
            transport.abort()
            return
        transport.set_protocol(self)
        transport.set_write_buffer_limits(high=HIGH_WATER)
        tune(transport)
        self._transport = transport
        self.opened.set_result(None)
        self._outbox.resume()

    def fail(self, reason: str) -> None:
        """It broke, or did not open; what waits is kept until it is closed."""
        if not self._end(reason):
            return
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

    def send(self, message: Message, keep: int | None) -> int:
        return self._outbox.put(message.source, self._pieces(message), keep)

    def _pieces(self, message: Message) -> Iterator[list[Buffer]]:
        self._left(message)
        yield from pieces(message, next(self._streams))

    def room(self, source: bytes) -> asyncio.Future[None] | None:
        return self._outbox.room(source)

    def backlog(self, source: bytes) -> int:
        return self._outbox.backlog(source)

    def forget(self, source: bytes) -> None:
        self._outbox.forget(source)

    def pause(self, until: asyncio.Future[None]) -> None:
        if self._transport is None or self._transport.is_closing():
            return
        self._holding += 1
        if self._holding == 1:
            self._transport.pause_reading()
        until.add_done_callback(self._released)

    def _released(self, _: asyncio.Future[None]) -> None:
        self._holding -= 1
        if not self._holding and self._transport is not None and not self._transport.is_closing():
            self._transport.resume_reading()

    def _hold(self, seconds: float) -> None:
        loop = asyncio.get_running_loop()
        over: asyncio.Future[None] = loop.create_future()
        loop.call_later(seconds, over.set_result, None)
        self.pause(over)

    def close(self) -> None:
        self._end("closed")
        self._outbox.clear()
        if self._transport is not None:
            self._transport.close()

    # asyncio

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        self.fail(str(exc) if exc else "closed by the other side")

    def pause_writing(self) -> None:
        self._full = True
        self._outbox.pause()

    def resume_writing(self) -> None:
        self._full = False
        if not self.broken:
            self._outbox.resume()

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._reader.buffer()

    def buffer_updated(self, nbytes: int) -> None:
        if self._throttle is not None and (wait := self._throttle.take(nbytes)):
            self._hold(wait)
        try:
            for message in self._reader.filled(nbytes):
                self._deliver(message, self)
        except (LimitExceeded, UnicodeDecodeError) as error:
            self.fail(str(error))
            if self._transport is not None:
                self._transport.abort()

    def _write(self, buffers: list[Buffer]) -> bool:
        assert self._transport is not None
        self._transport.writelines(buffers)
        return not self._full
