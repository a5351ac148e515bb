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
HIGH_WATER = 512 * 1024  # bytes in the transport at which the outbox keeps what follows, where it can be overtaken
SOCKET_BUFFER = 4 * 1024 * 1024
OPEN_TIMEOUT = 10.0

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
    """A link between interfaces of one process."""

    def __init__(self, name: str, deliver: Callable[[Message, Link], None]) -> None:
        self.name = name
        self.opened: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.opened.set_result(None)
        self._deliver = deliver

    def send(self, message: Message, keep: int | None) -> int:
        self._deliver(message, self)
        return 0

    def room(self, source: bytes) -> asyncio.Future[None] | None:
        return None

    def backlog(self, source: bytes) -> int:
        return 0

    def forget(self, source: bytes) -> None: ...

    def pause(self, until: asyncio.Future[None]) -> None: ...

    def close(self) -> None: ...


def answer_to(key: bytes) -> bytes:
    return hashlib.sha256(MAGIC + key).digest()[:16]


class StreamLink(asyncio.BufferedProtocol):
    """One end of a link over a socket. `opened` is done once the other side has proved itself."""

    def __init__(
        self,
        name: str,
        deliver: Callable[[Message, Link], None],
        lost: Callable[[StreamLink, str], None],
    ) -> None:
        self.name = name
        self.opened: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.broken = ""  # why, once it is
        self._deliver = deliver
        self._lost = lost
        self._reader = FrameReader()
        self._outbox: Outbox[list[Buffer]] = Outbox(self._write)
        self._outbox.pause()  # until the greeting is over
        self._streams = itertools.cycle(range(1 << 32))
        self._transport: asyncio.Transport | None = None
        self._full = False
        self._greeting = bytearray(GREETING)
        self._greeted = 0
        self._expected = b""

    # the two ways to open

    def greet(self, key: bytes) -> None:
        """Dialling side: say the key, and await its digest."""
        assert self._transport is not None
        self._expected = MAGIC + answer_to(key)
        self._transport.write(MAGIC + key)

    def accept(self, transport: asyncio.Transport, key: bytes) -> None:
        """Listening side: the key was good; take over the transport."""
        self.connection_made(transport)
        transport.write(MAGIC + answer_to(key))
        self._open()

    def _open(self) -> None:
        self.opened.set_result(None)
        self._outbox.resume()

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
        if self._transport is not None:
            self._transport.close()

    def abort(self, reason: str) -> None:
        log.warn("link {link}: {reason}", link=self.name, reason=reason)
        if self._transport is not None:
            self._transport.abort()

    # asyncio

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._transport.set_write_buffer_limits(high=HIGH_WATER)
        tune(self._transport)

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        self._outbox.pause()
        self.broken = reason = str(exc) if exc else "closed by the other side"
        if not self.opened.done():
            self.opened.set_exception(Unavailable(f"link {self.name} was refused: {reason}"))
        self._lost(self, reason)

    def pause_writing(self) -> None:
        self._full = True
        self._outbox.pause()

    def resume_writing(self) -> None:
        self._full = False
        self._outbox.resume()

    def get_buffer(self, sizehint: int) -> memoryview:
        if self.opened.done():
            return self._reader.buffer()
        return memoryview(self._greeting)[self._greeted :]

    def buffer_updated(self, nbytes: int) -> None:
        if not self.opened.done():
            self._greeted += nbytes
            if self._greeted == GREETING:
                self._check_answer()
            return
        try:
            for message in self._reader.filled(nbytes):
                self._deliver(message, self)
        except (LimitExceeded, UnicodeDecodeError) as error:
            self.abort(str(error))

    def _check_answer(self) -> None:
        if hmac.compare_digest(bytes(self._greeting), self._expected):
            self._open()
        else:
            self.abort("the other side does not know the key")

    def _write(self, buffers: list[Buffer]) -> bool:
        assert self._transport is not None
        self._transport.writelines(buffers)
        return not self._full


class _Doorman(asyncio.BufferedProtocol):
    """Reads the greeting of an incoming connection and hands the connection to the link whose key it says."""

    def __init__(self, port: DataPort) -> None:
        self._port = port
        self._greeting = bytearray(GREETING)
        self._have = 0
        self._timer: asyncio.TimerHandle | None = None
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._timer = asyncio.get_running_loop().call_later(OPEN_TIMEOUT, self._transport.abort)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def get_buffer(self, sizehint: int) -> memoryview:
        return memoryview(self._greeting)[self._have :]

    def buffer_updated(self, nbytes: int) -> None:
        self._have += nbytes
        if self._have < GREETING:
            return
        assert self._transport is not None
        assert self._timer is not None
        self._timer.cancel()
        magic, key = bytes(self._greeting[: len(MAGIC)]), bytes(self._greeting[len(MAGIC) :])
        link = self._port.expected.pop(key, None)
        if magic != MAGIC or link is None:
            log.warn("a connection to the data port presented no key that is expected: closed")
            self._transport.abort()
            return
        self._transport.set_protocol(link)
        link.accept(self._transport, key)


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
            lambda: _Doorman(self), host, port, ssl=self._tls.server if self._tls else None
        )
        self._servers.append(server)
        taken: int = server.sockets[0].getsockname()[1]
        return taken

    async def listen_unix(self, path: str) -> None:
        server = await asyncio.get_running_loop().create_unix_server(lambda: _Doorman(self), path)
        self._servers.append(server)

    def expect(self, link: StreamLink, key: bytes) -> None:
        self.expected[key] = link

    async def dial(self, link: StreamLink, key: bytes, addresses: list[str]) -> None:
        """Open `link` at the first address that answers. Unavailable, with the reason of each, when none does."""
        reasons = []
        for address in addresses:
            try:
                async with asyncio.timeout(OPEN_TIMEOUT):
                    await self._connect(link, address)
                    link.greet(key)
                    await link.opened
                return
            except (OSError, TimeoutError, Unavailable) as error:
                reasons.append(f"{address}: {error or 'no answer'}")
                if link.opened.done():
                    break
        raise Unavailable(f"link {link.name} did not open: {'; '.join(reasons) or 'no address given'}")

    async def _connect(self, link: StreamLink, address: str) -> None:
        loop = asyncio.get_running_loop()
        kind, _, rest = address.partition(":")
        if kind == "unix":
            await loop.create_unix_connection(lambda: link, rest)
        else:
            host, _, port = rest.rpartition(":")
            await loop.create_connection(lambda: link, host, int(port), ssl=self._tls.client if self._tls else None)

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
