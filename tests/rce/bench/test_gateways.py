"""Routes of gateways, with a gateway that a test plays."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from typing import Any

import pytest
from websockets.asyncio.client import connect
from websockets.asyncio.server import ServerConnection, serve

from rce.bench.gateways import JSON, FoxgloveClient, RosbridgeClient, channel_echo, foxglove, rosbridge, topic_echo
from rce.errors import ConversionError, InvalidRequest
from tests.support.bench import fake_place

SHORT = "/short"


async def answer(client: ServerConnection) -> None:
    """Play gateway and echo: a message comes back on the topic with _back, shortened on SHORT."""
    async for message in client:
        operation = json.loads(message)
        if operation["op"] == "publish":
            value = operation["msg"] if operation["topic"] != SHORT else {"data": ""}
            await client.send(json.dumps({"op": "publish", "topic": operation["topic"] + "_back", "msg": value}))


@pytest.fixture
async def client() -> AsyncIterator[RosbridgeClient]:
    async with serve(answer, "127.0.0.1", 0) as server:
        port = next(iter(server.sockets)).getsockname()[1]
        async with connect(f"ws://127.0.0.1:{port}") as socket:
            yield RosbridgeClient(socket)


async def test_message_is_sent_and_received_back(client: RosbridgeClient) -> None:
    sample = await topic_echo(client, JSON[0], "/a")
    assert await sample(5000) > 0


async def test_shortened_message_is_an_error(client: RosbridgeClient) -> None:
    with pytest.raises(ConversionError, match="0 of"):
        await topic_echo(client, JSON[0], SHORT)


@pytest.mark.parametrize("route", [rosbridge, foxglove])
async def test_route_needs_the_address_of_the_platform(route: Any) -> None:
    async with AsyncExitStack() as stack:
        place, *_ = fake_place(stack)
        with pytest.raises(InvalidRequest, match="address"):
            await route(place)


async def view(client: ServerConnection) -> None:
    """Play the gateway of Foxglove and the echo."""
    await client.send('{"op": "serverInfo"}')
    async for message in client:
        if isinstance(message, str) and '"advertise"' in message:
            await client.send('{"op": "advertise", "channels": [{"id": 5, "topic": "/a_back"}]}')
        elif isinstance(message, bytes):
            await client.send("{}")
            await client.send(b"\x01" + bytes(12) + message[5:])


async def test_channel_is_measured() -> None:
    async with serve(view, "127.0.0.1", 0) as server:
        port = next(iter(server.sockets)).getsockname()[1]
        async with connect(f"ws://127.0.0.1:{port}") as socket:
            sample = await channel_echo(FoxgloveClient(socket), "/a")
            assert await sample(5000) > 0
