"""A client of HTTP that never ends the head of its request."""

from __future__ import annotations

import asyncio
import contextlib

INTERVAL = 0.02  # seconds between two headers


async def drip(port: int) -> bytes:
    """Send headers until the server closes the connection; return what it answered."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)

    async def send() -> None:
        writer.write(b"GET / HTTP/1.1\r\n")
        while True:
            writer.write(b"X: y\r\n")
            await asyncio.sleep(INTERVAL)

    sending = asyncio.create_task(send())
    try:
        with contextlib.suppress(ConnectionResetError):
            return await asyncio.wait_for(reader.read(), 60)
        return b""
    finally:
        sending.cancel()
        writer.close()
