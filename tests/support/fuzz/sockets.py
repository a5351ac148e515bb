"""Raw connections of attackers, and robots that complete the handshake and then send anything."""

from __future__ import annotations

import asyncio
from urllib.parse import urlencode

from tests.support.endpoints.raw_robot import PASSWORD, USER, WEBSOCKET_HEADERS
from tests.support.fuzz.mutation import encode
from tests.support.fuzz.robot_frames import declarations, frame

PATIENCE = 60.0  # seconds until something counts as never answered, on a busy machine too
STRANGER = "127.0.0.77"  # address of clients without a login, whose wrong passwords block only this address


class RawConnection:
    """Connection that collects what it receives."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer
        self.received = bytearray()
        self.closed = False

    @classmethod
    async def open(cls, port: int, source: str = STRANGER) -> RawConnection:
        return cls(*await asyncio.open_connection("127.0.0.1", port, local_addr=(source, 0)))

    async def send(self, data: bytes) -> None:
        """Send bytes; those that the other side does not take any more are lost."""
        try:
            self._writer.write(data)
            await self._writer.drain()
        except (OSError, RuntimeError):
            self.closed = True

    async def receive(self) -> bool:
        """Receive more; return False once the other side has closed the connection."""
        try:
            data = await self._reader.read(1 << 16)
        except OSError:  # also that the socket is not connected any more
            data = b""
        self.received += data
        self.closed = self.closed or not data
        return bool(data)

    async def until(self, mark: bytes) -> bool:
        """Receive until the mark has come; return False if the other side closes the connection before."""
        async with asyncio.timeout(PATIENCE):
            while mark not in self.received:
                if not await self.receive():
                    return mark in self.received
        return True

    async def until_closed(self) -> bytes:
        """Send no more and wait until the other side closes the connection; return all that it has sent."""
        if not self.closed:
            try:
                self._writer.write_eof()
            except (OSError, RuntimeError):  # the latter from uvloop, of a transport that is closed
                self.closed = True
        async with asyncio.timeout(PATIENCE):
            while await self.receive():
                pass
        return bytes(self.received)

    def abort(self) -> None:
        self._writer.transport.abort()


async def join_robot(port: int, robot: str, features: str, deflate: bool) -> RawConnection:
    """Log a robot in and add its interfaces."""
    query = {"userID": USER, "robotID": robot, "password": PASSWORD, "features": features}
    query |= {"compress": "deflate"} if deflate else {}
    extension = "Sec-WebSocket-Extensions: permessage-deflate\r\n" if deflate else ""
    connection = await RawConnection.open(port, "127.0.0.1")
    request = f"GET /?{urlencode(query)} HTTP/1.1\r\n{WEBSOCKET_HEADERS}{extension}\r\n"
    await connection.send(request.encode())
    assert await connection.until(b"\r\n\r\n"), connection.received
    assert connection.received.startswith(b"HTTP/1.1 101"), connection.received
    await connection.send(b"".join(frame(encode(each)) for each in declarations(robot)))
    return connection
