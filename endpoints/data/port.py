"""Data port of an endpoint: accepts and dials data links.

The Master gives both ends of a link the same key. The dialling side sends it, and the accepting side proves that it
has the key too by answering with its digest. A key opens one link. Environments on other machines are reached through
the relay of their machine; an environment has no network and dials through its gate (see `rce.net.relay_handshake`).
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
from pathlib import Path
from typing import cast

from twisted.logger import Logger

from endpoints.data.link import StreamLink
from rce.errors import Unavailable
from rce.net import relay_handshake
from rce.net.relay_handshake import RelayRequest
from rce.net.sockets import (
    advertised_host,
    bind_unix_socket,
    parse_host_port,
    receive_socket,
    unix_socket_path,
)
from rce.net.tls import PLAINTEXT_WARNING, Tls, is_exposed
from rce.process.logs import RateLimitedLogger

MAGIC = b"RCE1"
GREETING_SIZE = relay_handshake.GREETING_SIZE
OPEN_TIMEOUT = 10.0  # seconds for one address
DIAL_TIMEOUT = 25.0  # seconds for all addresses of a link
EXPECT_TIMEOUT = 30.0  # longer, because the other side may have to try several addresses

log = Logger()
rejection_log = RateLimitedLogger(log)


def key_digest(key: bytes) -> bytes:
    """Return the digest with which the accepting side proves that it has the key."""
    return hashlib.sha256(MAGIC + key).digest()[:16]


class _Handshake(asyncio.BufferedProtocol):
    """Reads the greeting of the other side, and not one byte of the frames that follow it."""

    def __init__(self) -> None:
        self.transport: asyncio.Transport | None = None
        self._greeting = bytearray(GREETING_SIZE)
        self._have = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)

    def get_buffer(self, sizehint: int) -> memoryview:
        return memoryview(self._greeting)[self._have :]

    def buffer_updated(self, nbytes: int) -> None:
        self._have += nbytes
        if self._have == GREETING_SIZE:
            assert self.transport is not None
            self.greeting_received(bytes(self._greeting), self.transport)

    def greeting_received(self, greeting: bytes, transport: asyncio.Transport) -> None:
        raise NotImplementedError


class _AcceptingHandshake(_Handshake):
    """Accepting side: attaches the connection to the link with the presented key."""

    def __init__(self, expected: dict[bytes, StreamLink], tls: Tls | None) -> None:
        super().__init__()
        self._expected = expected
        self._tls = tls
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        if self._tls is not None:
            self._tls.watch(transport)
        self._timer = asyncio.get_running_loop().call_later(OPEN_TIMEOUT, transport.abort)  # type: ignore[attr-defined]

    def connection_lost(self, exc: Exception | None) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def greeting_received(self, greeting: bytes, transport: asyncio.Transport) -> None:
        assert self._timer is not None
        self._timer.cancel()
        magic, key = greeting[: len(MAGIC)], greeting[len(MAGIC) :]
        link = self._expected.pop(key, None) if magic == MAGIC else None
        if link is None:
            rejection_log.warn("closed a connection to the data port that presented no expected key")
            transport.abort()
            return
        transport.write(MAGIC + key_digest(key))
        link.attach(transport)


class _DiallingHandshake(_Handshake):
    """Dialling side: sends the key, and attaches the connection to `link` when the answer is its digest."""

    def __init__(self, link: StreamLink, key: bytes, relay_line: bytes = b"") -> None:
        """Create the handshake of `link`; `relay_line` is sent first, for the relay on the way."""
        super().__init__()
        self.outcome: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._link = link
        self._key = key
        self._relay_line = relay_line

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        cast(asyncio.Transport, transport).write(self._relay_line + MAGIC + self._key)

    def connection_lost(self, exc: Exception | None) -> None:
        self._fail(str(exc) if exc else "closed by the other side")

    def greeting_received(self, greeting: bytes, transport: asyncio.Transport) -> None:
        if reason := relay_handshake.refusal_reason(greeting):
            self._fail(f"refused by the relay: {reason}")
        elif not hmac.compare_digest(greeting, MAGIC + key_digest(self._key)):
            self._fail("the other side does not have the key of this link")
        elif not self.outcome.done():
            self.outcome.set_result(None)
            self.transport = None  # it belongs to the link from now on
            self._link.attach(transport)

    def _fail(self, reason: str) -> None:
        if not self.outcome.done():
            self.outcome.set_exception(Unavailable(reason))


class DataPort:
    """Accepts and dials the data links of one endpoint.

    Attributes:
        expected: Links that wait for the other side to connect, by their keys.
    """

    def __init__(self, gate: Path | None = None, tls: Tls | None = None) -> None:
        """Create a port that does not listen yet.

        Args:
            gate: UNIX socket through which an endpoint without a network reaches relays.
            tls: TLS contexts for links over TCP.
        """
        self._tls = tls
        self.expected: dict[bytes, StreamLink] = {}
        self._gate = gate
        self._servers: list[asyncio.Server] = []

    async def listen(
        self, socket: Path, host: str = "", tcp_port: int = 0, address: str = "", *, offer: Path | None = None
    ) -> list[str]:
        """Listen on a UNIX socket and, if `host` is given, over TCP.

        Args:
            socket: Absolute path of the UNIX socket.
            host: Local address for TCP.
            tcp_port: Port for TCP; 0 for any free one.
            address: Name or address by which others dial `host`, if that is different.
            offer: UNIX socket at which the socket at `socket` is received instead of made, for an endpoint that
                cannot write to the directory.

        Returns:
            The addresses at which other endpoints dial this one.

        Raises:
            OSError: A socket cannot be made, or is not received.
        """
        await self.listen_unix(socket, offer)
        addresses = [f"unix:{socket}"]
        if host:
            addresses.append(f"tcp:{advertised_host(host, address)}:{await self.listen_tcp(host, tcp_port)}")
        return addresses

    async def listen_tcp(self, host: str, port: int) -> int:
        """Listen over TCP; return the port, which is a free one if `port` is 0."""
        loop = asyncio.get_running_loop()
        if is_exposed(host, self._tls):
            log.warn(PLAINTEXT_WARNING, what="data", host=host)
        context = self._tls.server if self._tls else None
        server = await loop.create_server(self._accept, host, port, ssl=context)
        self._servers.append(server)
        bound_port: int = server.sockets[0].getsockname()[1]
        return bound_port

    async def listen_unix(self, path: Path, offer: Path | None = None) -> None:
        """Listen on a UNIX socket, which replaces an earlier one at `path` or is received at `offer`."""
        listener = await asyncio.to_thread(receive_socket, offer) if offer else bind_unix_socket(path)
        loop = asyncio.get_running_loop()
        self._servers.append(await loop.create_unix_server(self._accept, sock=listener))

    def _accept(self) -> _AcceptingHandshake:
        return _AcceptingHandshake(self.expected, self._tls)

    def expect(self, link: StreamLink, key: bytes) -> None:
        """Attach the next connection with `key` to `link`; the link fails when none comes in time."""
        self.expected[key] = link
        reason = f"the other side did not connect within {EXPECT_TIMEOUT:g} s"
        timer = asyncio.get_running_loop().call_later(EXPECT_TIMEOUT, link.fail, reason)

        def stop_expecting(_: asyncio.Future[None]) -> None:
            timer.cancel()
            self.expected.pop(key, None)

        link.opened.add_done_callback(stop_expecting)

    async def dial(self, link: StreamLink, key: bytes, addresses: list[str]) -> None:
        """Open `link` at the first address that works; otherwise fail it with the reason of each address."""
        reasons: list[str] = []
        try:
            async with asyncio.timeout(DIAL_TIMEOUT):
                if await self._dial_each(link, key, addresses, reasons):
                    return
        except TimeoutError:
            reasons.append(f"no link within {DIAL_TIMEOUT:g} s")
        link.fail("; ".join(reasons) or "the other side has no address")

    async def _dial_each(self, link: StreamLink, key: bytes, addresses: list[str], reasons: list[str]) -> bool:
        """Try addresses in turn; return True for success. The reasons of failures are appended to `reasons`."""
        for address in addresses:
            try:
                await self._dial_one(link, key, address)
            except (OSError, TimeoutError, ValueError, Unavailable) as error:
                reasons.append(f"{address}: {str(error) or 'no answer'}")
            else:
                return True
        return False

    async def _dial_one(self, link: StreamLink, key: bytes, address: str) -> None:
        kind, _, rest = address.partition(":")
        target, relay_line = self._through_relay(rest) if kind == "relay" else (rest, b"")
        handshake = _DiallingHandshake(link, key, relay_line)
        try:
            async with asyncio.timeout(OPEN_TIMEOUT):
                await self._connect(handshake, target)
                await handshake.outcome
        finally:
            if handshake.transport is not None:
                handshake.transport.abort()

    def _through_relay(self, address: str) -> tuple[str, bytes]:
        """Return the address to connect to, and the line that tells the relay there the destination."""
        destination = relay_handshake.parse_relay_address(address)
        if self._gate is not None:
            return str(self._gate), destination.line()
        return destination.relay, RelayRequest(destination.to).line()

    async def _connect(self, handshake: _DiallingHandshake, target: str) -> None:
        """Connect to the absolute path of a UNIX socket, or to HOST:PORT."""
        loop = asyncio.get_running_loop()
        if target.startswith("/"):
            with unix_socket_path(Path(target)) as path:
                await loop.create_unix_connection(lambda: handshake, path)
        else:
            host, port = parse_host_port(target)
            context = self._tls.client if self._tls else None
            transport, _ = await loop.create_connection(lambda: handshake, host, port, ssl=context)
            if self._tls is not None:
                self._tls.watch(transport)

    async def close(self) -> None:
        """Stop listening."""
        for server in self._servers:
            server.close()
        self._servers.clear()
