"""Data links: one stream between two endpoints (TCP, UNIX socket), or none where both ends are in one process.

A link opens with the key that the Master gave to both ends: the side that dials sends it, the other proves that it
knows it too by answering with its digest. A key is good for one opening.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import itertools
import socket
import ssl
from collections.abc import Callable
from typing import NamedTuple, Protocol, cast

from twisted.logger import Logger

from endpoints.frames import Buffer, FrameReader, Message, pieces
from rce.errors import LimitExceeded, Unavailable
from rce.outbox import Outbox

MAGIC = b"RCE1"
GREETING = len(MAGIC) + 16
HIGH_WATER = 256 * 1024  # bytes in the transport at which the outbox keeps what follows, where it can be overtaken
SOCKET_BUFFER = 1024 * 1024  # four times this doubles the time for which a small message waits, and carries no more
OPEN_TIMEOUT = 10.0
EXPECT_TIMEOUT = 30.0  # the other side may have several addresses to try

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

    def __init__(self, name: str, deliver: Callable[[Message, Link], None]) -> None:
        self.name = name
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
        self._deliver(message, self)
        return self._until is None


def answer_to(key: bytes) -> bytes:
    return hashlib.sha256(MAGIC + key).digest()[:16]


class StreamLink(asyncio.BufferedProtocol):
    """One end of a link over a socket; `opened` is done once the other side has proved itself, or has not."""

    def __init__(
        self,
        name: str,
        deliver: Callable[[Message, Link], None],
        lost: Callable[[StreamLink, str], None],
    ) -> None:
        """`lost` is called once, if the link breaks or does not open; not when it is closed on purpose."""
        self.name = name
        self.opened: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.opened.add_done_callback(lambda opened: opened.exception())  # `lost` has said it
        self.broken = ""  # why, once it is
        self._deliver = deliver
        self._lost = lost
        self._reader = FrameReader()
        self._outbox: Outbox[list[Buffer]] = Outbox(self._write)
        self._outbox.pause()  # until the greeting is over
        self._streams = itertools.cycle(range(1 << 32))
        self._transport: asyncio.Transport | None = None
        self._full = False

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
        return self._outbox.put(message.source, pieces(message, next(self._streams)), keep)

    def room(self, source: bytes) -> asyncio.Future[None] | None:
        return self._outbox.room(source)

    def backlog(self, source: bytes) -> int:
        return self._outbox.backlog(source)

    def forget(self, source: bytes) -> None:
        self._outbox.forget(source)

    def pause(self, until: asyncio.Future[None]) -> None:
        transport = self._transport
        if transport is not None and transport.is_reading():
            transport.pause_reading()
            until.add_done_callback(lambda _: None if transport.is_closing() else transport.resume_reading())

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


class _Greeter(asyncio.BufferedProtocol):
    """Reads the first bytes of a connection, as many as a greeting has and not one of what follows."""

    def __init__(self) -> None:
        self.transport: asyncio.Transport | None = None
        self._greeting = bytearray(GREETING)
        self._have = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)

    def get_buffer(self, sizehint: int) -> memoryview:
        return memoryview(self._greeting)[self._have :]

    def buffer_updated(self, nbytes: int) -> None:
        self._have += nbytes
        if self._have == GREETING:
            assert self.transport is not None
            self.greeted(bytes(self._greeting), self.transport)

    def greeted(self, greeting: bytes, transport: asyncio.Transport) -> None:
        raise NotImplementedError


class _Doorman(_Greeter):
    """Listening side: hands the connection to the link whose key it says."""

    def __init__(self, expected: dict[bytes, StreamLink]) -> None:
        super().__init__()
        self._expected = expected
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._timer = asyncio.get_running_loop().call_later(OPEN_TIMEOUT, transport.abort)  # type: ignore[attr-defined]

    def connection_lost(self, exc: Exception | None) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def greeted(self, greeting: bytes, transport: asyncio.Transport) -> None:
        assert self._timer is not None
        self._timer.cancel()
        magic, key = greeting[: len(MAGIC)], greeting[len(MAGIC) :]
        link = self._expected.pop(key, None) if magic == MAGIC else None
        if link is None:
            log.warn("a connection to the data port presented no key that is expected: closed")
            transport.abort()
            return
        transport.write(MAGIC + answer_to(key))
        link.carry(transport)


class _Caller(_Greeter):
    """Dialling side: says the key, and hands the connection to `link` when the other side answers with its digest."""

    def __init__(self, link: StreamLink, key: bytes) -> None:
        super().__init__()
        self.outcome: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._link = link
        self._key = key

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        cast(asyncio.Transport, transport).write(MAGIC + self._key)

    def connection_lost(self, exc: Exception | None) -> None:
        self._refuse(str(exc) if exc else "closed by the other side")

    def greeted(self, greeting: bytes, transport: asyncio.Transport) -> None:
        if not hmac.compare_digest(greeting, MAGIC + answer_to(self._key)):
            self._refuse("the other side does not know the key")
        elif not self.outcome.done():
            self.outcome.set_result(None)
            self.transport = None  # it is the link's now
            self._link.carry(transport)

    def _refuse(self, reason: str) -> None:
        if not self.outcome.done():
            self.outcome.set_exception(Unavailable(reason))


class DataPort:
    """Where an endpoint takes and makes links."""

    def __init__(self, tls: LinkTls | None = None) -> None:
        self.expected: dict[bytes, StreamLink] = {}
        self._servers: list[asyncio.Server] = []
        self._tls = tls

    async def listen_tcp(self, host: str, port: int) -> int:
        """Listen on `host` (port 0: any free one); returns the port."""
        loop = asyncio.get_running_loop()
        server = await loop.create_server(
            lambda: _Doorman(self.expected), host, port, ssl=self._tls.server if self._tls else None
        )
        self._servers.append(server)
        taken: int = server.sockets[0].getsockname()[1]
        return taken

    async def listen_unix(self, path: str) -> None:
        server = await asyncio.get_running_loop().create_unix_server(lambda: _Doorman(self.expected), path)
        self._servers.append(server)

    def expect(self, link: StreamLink, key: bytes) -> None:
        """Take the connection that says `key` for `link`; it fails when none comes."""
        self.expected[key] = link
        late = "nobody has come to open it"
        timer = asyncio.get_running_loop().call_later(EXPECT_TIMEOUT, link.fail, late)

        def over(_: asyncio.Future[None]) -> None:
            timer.cancel()
            self.expected.pop(key, None)

        link.opened.add_done_callback(over)

    async def dial(self, link: StreamLink, key: bytes, addresses: list[str]) -> None:
        """Open `link` at the first address that answers; it fails, with the reason of each, when none does."""
        reasons = []
        for address in addresses:
            caller = _Caller(link, key)
            try:
                async with asyncio.timeout(OPEN_TIMEOUT):
                    await self._connect(caller, address)
                    await caller.outcome
                return
            except (OSError, TimeoutError, ValueError, Unavailable) as error:
                reasons.append(f"{address}: {str(error) or 'no answer'}")
            finally:
                if caller.transport is not None:
                    caller.transport.abort()
        link.fail("; ".join(reasons) or "it has no address")

    async def _connect(self, caller: _Caller, address: str) -> None:
        loop = asyncio.get_running_loop()
        kind, _, rest = address.partition(":")
        if kind == "unix":
            await loop.create_unix_connection(lambda: caller, rest)
        else:
            host, _, port = rest.rpartition(":")
            await loop.create_connection(lambda: caller, host, int(port), ssl=self._tls.client if self._tls else None)

    async def close(self) -> None:
        for server in self._servers:
            server.close()
        self._servers.clear()


class LinkTls(NamedTuple):
    """Contexts for links between machines; both ends prove themselves by certificate."""

    server: ssl.SSLContext
    client: ssl.SSLContext


def tune(transport: asyncio.BaseTransport) -> None:
    """Large socket buffers for large messages, no delay for small ones."""
    sock: socket.socket | None = transport.get_extra_info("socket")
    if sock is None:
        return
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BUFFER)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SOCKET_BUFFER)
    if sock.family in (socket.AF_INET, socket.AF_INET6):
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
