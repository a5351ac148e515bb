"""WebSocket of a robot, on picows, which receives large messages in 40 % less time than `websockets`."""

from __future__ import annotations

import asyncio
import logging
import socket
import ssl
from contextlib import suppress

from picows import WSInvalidStatusError
from picows.url import WSParsedURL
from picows.websockets.asyncio.client import ClientConnection, connect
from picows.websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus
from python_socks import ProxyError

from rce.client.dialing import dial, proxy_of
from rce.errors import Unavailable
from rce.protocol.assembler import AssemblyLimits
from rce.protocol.blobs import PART

__all__ = ["ConnectionClosed", "Refused", "WebSocket", "open_websocket"]

WRITE_LIMIT = 64 * 1024
"""Bytes that may be buffered below the outbox, in the library and in the kernel. Small frames cannot overtake them."""

HUNG_UP = "the connection was closed during the handshake"

# picows logs each connection at INFO, and at its own level below DEBUG the request line with the credentials.
log = logging.getLogger("rce.client.websocket")
log.setLevel(logging.WARNING)


class Refused(Exception):
    """The server answers the handshake with another status than 101.

    Attributes:
        status: Status of HTTP.
        standard: True if the reason is only the phrase of the status.
    """

    def __init__(self, status: int, reason: str, standard: bool) -> None:
        super().__init__(reason)
        self.status = status
        self.standard = standard


class WebSocket:
    """Open WebSocket.

    Attributes:
        socket: The socket below it.
    """

    def __init__(self, connection: ClientConnection, sock: socket.socket) -> None:
        self.socket = sock
        self._connection = connection

    def header(self, name: str) -> str | None:
        """Return a header of the server's answer to the handshake."""
        value: str | None = self._connection.response.headers.get(name)
        return value

    async def send(self, payload: bytes, text: bool) -> None:
        """Send a message; return when the next one may be sent.

        Raises:
            ConnectionClosed: The connection is closed.
        """
        await self._connection.send(payload, text)

    async def receive(self) -> bytes:
        """Return the next message.

        Raises:
            ConnectionClosed: The connection is closed.
        """
        payload = await self._connection.recv(decode=False)
        assert isinstance(payload, bytes)
        return payload

    async def close(self) -> None:
        """Close with code 1000."""
        await self._connection.close()

    def abort(self) -> None:
        """Break the connection at once; whoever receives gets ConnectionClosed."""
        _break(self.socket)

    @property
    def reason(self) -> str:
        """Reason of the close frame, or the close code if there is none."""
        return self._connection.close_reason or f"code {self._connection.close_code or 1006}"


async def open_websocket(
    uri: str, seconds: float, *, tls: ssl.SSLContext | None = None, direct: bool = False, compress: bool = False
) -> WebSocket:
    """Open a WebSocket.

    Args:
        uri: Its URI.
        seconds: Time until the server or the proxy accepts a connection, and again for proxy, TLS and handshake.
        tls: TLS context for `wss` in place of the system's certificates.
        direct: Use no proxy.
        compress: Offer to compress messages (permessage-deflate).

    Raises:
        InvalidURI: The URI is not that of a WebSocket.
        Refused: The server refuses the handshake.
        Unavailable: The server cannot be reached.
    """
    proxy = proxy_of(uri)
    sock: socket.socket | None = None
    connection: ClientConnection | None = None

    async def dial_host(host: WSParsedURL) -> socket.socket:
        nonlocal sock
        sock = await dial(str(host.host), int(host.port), seconds)
        _limit_kernel_buffer(sock)
        limit.reschedule(asyncio.get_running_loop().time() + seconds)  # the line may have come back just now
        return sock

    try:
        async with asyncio.timeout(seconds) as limit:
            connection = await connect(
                uri,
                ssl=tls,
                proxy=None if direct else proxy,
                socket_factory=dial_host,
                compression="deflate" if compress else None,
                open_timeout=None,
                ping_interval=10,
                close_timeout=2,
                max_size=AssemblyLimits().message + PART,
                write_limit=WRITE_LIMIT,
                logger=log,
            )
    except InvalidStatus as error:
        raise _refusal(error) from None
    except AssertionError:  # picows asserts that the server does not hang up during the handshake
        raise Unavailable(HUNG_UP) from None
    except (OSError, TimeoutError, ProxyError, InvalidHandshake) as error:
        raise Unavailable(str(error) or "no answer") from None
    finally:
        if connection is None and sock is not None:
            _break(sock)
    if connection is None or sock is None:  # it did, and Python runs without assertions
        raise Unavailable(HUNG_UP)
    return WebSocket(connection, sock)


def _refusal(error: InvalidStatus) -> Refused:
    """Return the refusal; its reason is the body, or that of the status line."""
    answer = error.__cause__
    assert isinstance(answer, WSInvalidStatusError)
    phrase = (answer.raw_header or b"").partition(b"\r\n")[0].partition(b" ")[2].partition(b" ")[2]
    reason = (answer.raw_body or phrase).decode(errors="replace")
    return Refused(error.response.status_code, reason, reason == error.response.reason_phrase)


def _break(sock: socket.socket) -> None:
    """Shut a socket down, whose transport closes it then."""
    with suppress(OSError):  # it may be closed already
        sock.shutdown(socket.SHUT_RDWR)


def _limit_kernel_buffer(sock: socket.socket) -> None:
    """Limit the unsent bytes in the kernel: the rest stays in the outbox, where small frames can overtake it."""
    option = getattr(socket, "TCP_NOTSENT_LOWAT", None)
    if option is not None:
        sock.setsockopt(socket.IPPROTO_TCP, option, WRITE_LIMIT)
