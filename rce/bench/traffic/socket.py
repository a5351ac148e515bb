"""Bare WebSocket of a robot: text frames of JSON, and answers to pings. No more than a benchmark needs."""

from __future__ import annotations

import asyncio
import base64
import json
import os
import struct
from collections.abc import Callable
from typing import Any, cast
from urllib.parse import urlsplit

from rce.errors import InvalidRequest, Lost

TEXT, CLOSE, PING, PONG = 1, 8, 9, 10
FINAL = 0x80
HEADER_END = b"\r\n\r\n"
NO_MASK = bytes(4)  # clients must mask; with zeros the payload stays as it is


def client_frame(opcode: int, payload: bytes) -> bytes:
    """Return a frame of a client (RFC 6455, section 5.2)."""
    size = len(payload)
    if size < 126:
        head = struct.pack("!BB", FINAL | opcode, 0x80 | size)
    elif size < 1 << 16:
        head = struct.pack("!BBH", FINAL | opcode, 0x80 | 126, size)
    else:
        head = struct.pack("!BBQ", FINAL | opcode, 0x80 | 127, size)
    return head + NO_MASK + payload


class BareSocket(asyncio.Protocol):
    """WebSocket of one robot.

    Attributes:
        received: Called with each text message.
    """

    def __init__(self, host: str, path: str, received: Callable[[bytes], None]) -> None:
        self.received = received
        self.opened: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._request = (
            f"GET {path} HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {base64.b64encode(os.urandom(16)).decode()}\r\n\r\n"
        ).encode()
        self._buffer = b""
        self._transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Send the handshake."""
        self._transport = cast(asyncio.Transport, transport)  # that of uvloop is not an instance
        self._transport.write(self._request)

    def data_received(self, data: bytes) -> None:
        """Handle the answer to the handshake, then frames."""
        self._buffer += data
        if not self.opened.done():
            head, end, rest = self._buffer.partition(HEADER_END)
            if not end:
                return
            self._buffer = rest
            if b" 101 " not in head.partition(b"\r\n")[0] + b" ":
                self.opened.set_exception(
                    InvalidRequest(f"the robot was refused: {head.decode(errors='replace')[:200]}")
                )
                return
            self.opened.set_result(None)
        self._buffer = self._buffer[self._frames() :]

    def connection_lost(self, error: Exception | None) -> None:
        """Fail a handshake that waits."""
        if not self.opened.done():
            self.opened.set_exception(Lost(f"the connection of a robot was lost: {error}"))

    def send(self, text: bytes) -> None:
        """Send a text message."""
        self._transport.write(client_frame(TEXT, text))

    def close(self) -> None:
        """Close the connection, as a program that ends."""
        self._transport.write(client_frame(CLOSE, struct.pack("!H", 1000)))
        self._transport.close()

    def _frames(self) -> int:
        """Handle all complete frames; return the number of their bytes."""
        buffer, at = self._buffer, 0
        while len(buffer) - at >= 2:
            size, start = buffer[at + 1] & 0x7F, at + 2
            if size >= 126:
                wide = 2 if size == 126 else 8
                if len(buffer) < start + wide:
                    break
                size, start = int.from_bytes(buffer[start : start + wide], "big"), start + wide
            if len(buffer) < start + size:
                break
            opcode, payload = buffer[at] & 0x0F, buffer[start : start + size]
            if opcode == TEXT:
                self.received(payload)
            elif opcode == PING:
                self._transport.write(client_frame(PONG, payload))
            at = start + size
        return at


async def connect(url: str, query: str, received: Callable[[bytes], None]) -> BareSocket:
    """Connect a robot.

    Args:
        url: WebSocket address that the entry gave.
        query: Query of the login.
        received: Called with each text message.

    Raises:
        InvalidRequest: The robot was refused.
        Lost: The connection was lost during the handshake.
    """
    where = urlsplit(url)
    loop = asyncio.get_running_loop()
    _, protocol = await loop.create_connection(
        lambda: BareSocket(where.netloc, f"/?{query}", received), where.hostname or "", where.port or 0
    )
    await protocol.opened
    return protocol


class BareRobot:
    """Robot that gives one command after the other, with the feature `ack`.

    Attributes:
        name: Its robotID.
        socket: Its socket, once it is connected.
    """

    socket: BareSocket

    def __init__(self, name: str) -> None:
        self.name = name
        self._answer: asyncio.Future[None] | None = None

    async def command(self, kind: str, data: dict[str, Any]) -> None:
        """Give a command; return when it is acknowledged.

        Raises:
            InvalidRequest: It failed.
        """
        self._answer = asyncio.get_running_loop().create_future()
        self.socket.send(json.dumps({"type": kind, "id": 1, "data": data}).encode())
        await self._answer

    def received(self, text: bytes) -> None:
        """Take the answer to a command; other messages are ignored."""
        if self._answer is not None and not self._answer.done():
            if b'"ack"' in text and b'"id"' in text:
                self._answer.set_result(None)
            elif b'"ER"' in text:
                self._answer.set_exception(InvalidRequest(f"{self.name}: {text[:300].decode(errors='replace')}"))
