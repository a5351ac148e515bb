"""Where an endpoint takes and makes data links.

A link opens with the key that the Master gave to both ends: the side that dials sends it, the other proves that it
knows it too by answering with its digest. A key is good for one opening. Environments on other machines are reached
through the relay there; an environment, which has no network, dials through its gate (see rce/passage.py).
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
from pathlib import Path
from typing import cast

from twisted.logger import Logger

from endpoints.link import StreamLink
from rce import passage
from rce.errors import Unavailable
from rce.logs import Sparing
from rce.passage import Passage
from rce.sockets import bound, reaching, split
from rce.tls import PLAIN, Tls, exposed

MAGIC = b"RCE1"
GREETING = passage.GREETING
OPEN_TIMEOUT = 10.0
EXPECT_TIMEOUT = 30.0  # the other side may have several addresses to try

log = Logger()
strangers = Sparing(log)


def answer_to(key: bytes) -> bytes:
    return hashlib.sha256(MAGIC + key).digest()[:16]


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
            strangers.warn("a connection to the data port presented no key that is expected: closed")
            transport.abort()
            return
        transport.write(MAGIC + answer_to(key))
        link.carry(transport)


class _Caller(_Greeter):
    """Dialling side: says the key, and hands the connection to `link` when the other side answers with its digest."""

    def __init__(self, link: StreamLink, key: bytes, first_words: bytes = b"") -> None:
        """`first_words` are for a relay on the way."""
        super().__init__()
        self.outcome: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._link = link
        self._key = key
        self._first_words = first_words

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        cast(asyncio.Transport, transport).write(self._first_words + MAGIC + self._key)

    def connection_lost(self, exc: Exception | None) -> None:
        self._refuse(str(exc) if exc else "closed by the other side")

    def greeted(self, greeting: bytes, transport: asyncio.Transport) -> None:
        if reason := passage.refused(greeting):
            self._refuse(f"the relay says: {reason}")
        elif not hmac.compare_digest(greeting, MAGIC + answer_to(self._key)):
            self._refuse("the other side does not know the key")
        elif not self.outcome.done():
            self.outcome.set_result(None)
            self.transport = None  # it is the link's now
            self._link.carry(transport)

    def _refuse(self, reason: str) -> None:
        if not self.outcome.done():
            self.outcome.set_exception(Unavailable(reason))


class DataPort:
    """Where an endpoint takes and makes links; `gate` is the socket by which to reach relays without a network, `tls`
    is for links over TCP.
    """

    def __init__(self, gate: Path | None = None, tls: Tls | None = None) -> None:
        self._tls = tls
        self.expected: dict[bytes, StreamLink] = {}
        self._gate = gate
        self._servers: list[asyncio.Server] = []

    async def listen_tcp(self, host: str, port: int) -> int:
        """Listen on `host` (port 0: any free one); returns the port."""
        loop = asyncio.get_running_loop()
        if exposed(host, self._tls):
            log.warn(PLAIN, what="data", host=host)
        context = self._tls.server if self._tls else None
        server = await loop.create_server(lambda: _Doorman(self.expected), host, port, ssl=context)
        self._servers.append(server)
        taken: int = server.sockets[0].getsockname()[1]
        return taken

    async def listen_unix(self, path: Path) -> None:
        """Listen at a socket of the file system, in the place of an earlier one."""
        loop = asyncio.get_running_loop()
        self._servers.append(await loop.create_unix_server(lambda: _Doorman(self.expected), sock=bound(path)))

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
            try:
                await self._try(link, key, address)
                return
            except (OSError, TimeoutError, ValueError, Unavailable) as error:
                reasons.append(f"{address}: {str(error) or 'no answer'}")
        link.fail("; ".join(reasons) or "it has no address")

    async def _try(self, link: StreamLink, key: bytes, address: str) -> None:
        kind, _, rest = address.partition(":")
        way, words = self._through_relay(rest) if kind == "relay" else (rest, b"")
        caller = _Caller(link, key, words)
        try:
            async with asyncio.timeout(OPEN_TIMEOUT):
                await self._connect(caller, way)
                await caller.outcome
        finally:
            if caller.transport is not None:
                caller.transport.abort()

    def _through_relay(self, address: str) -> tuple[str, bytes]:
        """Where to connect, and what to say first."""
        way = passage.split(address)
        if self._gate is not None:
            return str(self._gate), way.line()
        return way.relay, Passage(way.to).line()

    async def _connect(self, caller: _Caller, way: str) -> None:
        """`way` is the absolute path of a socket, or HOST:PORT."""
        loop = asyncio.get_running_loop()
        if way.startswith("/"):
            with reaching(Path(way)) as path:
                await loop.create_unix_connection(lambda: caller, path)
        else:
            host, port = split(way)
            await loop.create_connection(lambda: caller, host, port, ssl=self._tls.client if self._tls else None)

    async def close(self) -> None:
        for server in self._servers:
            server.close()
        self._servers.clear()
