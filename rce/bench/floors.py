"""Lower bounds of round trips: bare TCP and bare Autobahn echoes, each in its own process."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable

from websockets.asyncio.client import connect

SOCKET_BUFFER = 4 * 1024 * 1024  # bytes, as in the data links
STREAM_LIMIT = 16 * 1024 * 1024
MAX_SIZE = 64 * 1024 * 1024

Sample = Callable[[int], Awaitable[float]]


@contextlib.asynccontextmanager
async def tcp() -> AsyncIterator[Sample]:
    """Yield the sample function of a bare TCP echo."""
    async with server("rce.bench.echo", "tcp") as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=STREAM_LIMIT)
        enlarge_buffers(writer.get_extra_info("socket"))

        async def sample(size: int) -> float:
            payload = bytes(size)
            started = time.perf_counter()
            writer.write(payload)
            await reader.readexactly(size)
            return time.perf_counter() - started

        try:
            yield sample
        finally:
            writer.close()


@contextlib.asynccontextmanager
async def autobahn() -> AsyncIterator[Sample]:
    """Yield the sample function of a bare Autobahn echo: a server on uvloop, and the WebSocket client of robots."""
    async with (
        server("rce.bench.echo", "autobahn") as port,
        connect(f"ws://127.0.0.1:{port}/", compression=None, max_size=MAX_SIZE, proxy=None) as socket,
    ):

        async def sample(size: int) -> float:
            payload = bytes(size)
            started = time.perf_counter()
            await socket.send(payload)
            await socket.recv()
            return time.perf_counter() - started

        yield sample


def enlarge_buffers(sock: socket.socket) -> None:
    """Set the buffers of a socket to SOCKET_BUFFER."""
    for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
        sock.setsockopt(socket.SOL_SOCKET, option, SOCKET_BUFFER)


@contextlib.asynccontextmanager
async def server(module: str, *arguments: str) -> AsyncIterator[int]:
    """Run an echo server, a module that prints its port, in its own process; yield the port."""
    words = [sys.executable, "-P", "-m", module, *arguments]
    process = await asyncio.create_subprocess_exec(*words, stdout=asyncio.subprocess.PIPE)
    assert process.stdout is not None
    try:
        yield int(await process.stdout.readline())
    finally:
        process.terminate()
        await process.wait()
