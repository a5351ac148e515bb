"""Where an endpoint takes and makes data links.

A link opens with the key that the Master gave to both ends: the side that dials sends it, the other proves that it
knows it too by answering with its digest. A key is good for one opening.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import cast

from twisted.logger import Logger

from endpoints.link import StreamLink
from rce.errors import Unavailable

MAGIC = b"RCE1"
GREETING = len(MAGIC) + 16
OPEN_TIMEOUT = 10.0
EXPECT_TIMEOUT = 30.0  # the other side may have several addresses to try
LONGEST_SOCKET_PATH = 100  # sun_path has 108 bytes

log = Logger()


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

    def __init__(self) -> None:
        self.expected: dict[bytes, StreamLink] = {}
        self._servers: list[asyncio.Server] = []

    async def listen_tcp(self, host: str, port: int) -> int:
        """Listen on `host` (port 0: any free one); returns the port."""
        loop = asyncio.get_running_loop()
        server = await loop.create_server(lambda: _Doorman(self.expected), host, port)
        self._servers.append(server)
        taken: int = server.sockets[0].getsockname()[1]
        return taken

    async def listen_unix(self, path: str) -> None:
        loop = asyncio.get_running_loop()
        with _short(path) as short:
            self._servers.append(await loop.create_unix_server(lambda: _Doorman(self.expected), short))

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
            with _short(rest) as path:
                await loop.create_unix_connection(lambda: caller, path)
        else:
            host, _, port = rest.rpartition(":")
            await loop.create_connection(lambda: caller, host, int(port))

    async def close(self) -> None:
        for server in self._servers:
            server.close()
        self._servers.clear()


@contextmanager
def _short(path: str) -> Iterator[str]:
    """The path of a socket, or where it is too long for a UNIX socket, one by way of its opened directory."""
    if len(os.fsencode(path)) <= LONGEST_SOCKET_PATH:
        yield path
        return
    directory = os.open(Path(path).parent, os.O_PATH | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{directory}/{Path(path).name}"
    finally:
        os.close(directory)
