"""Echo servers, on the event loop of the test."""

from __future__ import annotations

import asyncio

import pytest
from websockets.asyncio.client import connect

from rce.bench import echo


@pytest.mark.parametrize("size", [1, echo.READ, echo.READ + 1])
async def test_bytes_come_back_in_order(size: int) -> None:
    server = await asyncio.get_running_loop().create_server(echo.TcpEcho, "127.0.0.1", 0)
    async with server:
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname(), limit=2 * echo.READ)
        sent = bytes(number % 251 for number in range(size))
        writer.write(sent)
        assert await reader.readexactly(size) == sent
        writer.close()
        await writer.wait_closed()


@pytest.mark.parametrize("message", ["text", b"bytes", bytes(2_000_000)])
async def test_message_comes_back_with_its_kind(message: str | bytes) -> None:
    loop = asyncio.get_running_loop()
    server = await loop.create_server(echo.autobahn(loop), "127.0.0.1", 0)
    async with server:
        url = "ws://127.0.0.1:{1}/".format(*server.sockets[0].getsockname())
        async with connect(url, compression=None, max_size=None, proxy=None) as client:
            await client.send(message)
            assert await client.recv() == message
