"""Local ports of `rce gateway`."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from rce.cli.lazy.gateway import opened
from rce.errors import NotFound, Unavailable

Options = Sequence[tuple[str, str]]


async def echo(client: ServerConnection) -> None:
    async for message in client:
        if message == "bye":
            await client.close(1008, "as you like")
        await client.send(message)


@asynccontextmanager
async def forwarding() -> AsyncIterator[int]:
    async with serve(echo, "127.0.0.1", 0) as server:
        port = next(iter(server.sockets)).getsockname()[1]

        async def dial(subprotocols: Sequence[Subprotocol] | None, options: Options) -> ClientConnection:
            return await connect(f"ws://127.0.0.1:{port}")

        async with opened(dial, 0) as forwarded:
            yield forwarded


async def test_messages_pass_in_both_directions() -> None:
    async with forwarding() as port, connect(f"ws://127.0.0.1:{port}") as client:
        for message in ("text", b"binary", "x" * 1_000_000):
            await client.send(message)
            assert await client.recv() == message


async def test_reason_of_a_closure_passes() -> None:
    async with forwarding() as port, connect(f"ws://127.0.0.1:{port}") as client:
        await client.send("bye")
        with pytest.raises(ConnectionClosed):
            await client.recv()
        assert (client.close_code, client.close_reason) == (1008, "as you like")


async def test_refusal_of_the_platform_closes_the_client_with_the_reason() -> None:
    async def dial(subprotocols: Sequence[Subprotocol] | None, options: Options) -> ClientConnection:
        raise NotFound("there is no environment brain")

    async with opened(dial, 0) as port, connect(f"ws://127.0.0.1:{port}") as client:
        await asyncio.wait_for(client.wait_closed(), 30)
        assert client.close_reason == "there is no environment brain"


async def test_options_in_the_url_of_a_client_pass() -> None:
    dialled: list[Options] = []

    async def dial(subprotocols: Sequence[Subprotocol] | None, options: Options) -> ClientConnection:
        dialled.append(options)
        raise NotFound("enough")

    async with opened(dial, 0) as port, connect(f"ws://127.0.0.1:{port}/?codec=draco&size=640x480") as client:
        await asyncio.wait_for(client.wait_closed(), 30)
    assert dialled == [[("codec", "draco"), ("size", "640x480")]]


async def test_port_in_use_is_an_error() -> None:
    async with forwarding() as port:
        with pytest.raises(Unavailable, match=f"port {port}"):
            async with forwarding_at(port):
                pass


@asynccontextmanager
async def forwarding_at(port: int) -> AsyncIterator[None]:
    async def dial(subprotocols: Sequence[Subprotocol] | None, options: Options) -> ClientConnection:
        raise NotFound("nothing is dialled")

    async with opened(dial, port):
        yield
