"""Messages that a Foxglove client receives, with a gateway that a test plays."""

from __future__ import annotations

import json
import time
from contextlib import AsyncExitStack
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.asyncio.server import ServerConnection, serve

from rce.bench import channels
from rce.bench.channels import CONTENT, MESSAGE, STREAMS, Received, measure
from rce.client.address import Address
from rce.errors import InvalidRequest
from tests.support.bench import fake_place


async def show(client: ServerConnection) -> None:
    """Play the gateway: both channels, and messages of which the second is missing."""
    await client.send('{"op": "serverInfo"}')
    offered = [{"id": 10 + number, "topic": f"/{stream.name}"} for number, stream in enumerate(STREAMS)]
    await client.send(json.dumps({"op": "advertise", "channels": offered}))
    subscribed = [json.loads(await client.recv())["subscriptions"][0] for _ in STREAMS]
    assert {each["channelId"] for each in subscribed} == {10, 11}
    number = 0
    while True:
        for each in subscribed:
            content = CONTENT.pack(number, time.monotonic())
            await client.send(MESSAGE.pack(1, each["id"], 0) + bytes(16) + content)
        number += 2
        await (await client.ping())  # the client has read them


async def test_messages_and_gaps_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(channels, "SETTLED", 0.0)
    monkeypatch.setattr(channels, "START_TIMEOUT", 5.0)
    async with serve(show, "127.0.0.1", 0) as server, AsyncExitStack() as stack:
        port = next(iter(server.sockets)).getsockname()[1]
        place, *_ = fake_place(stack)

        async def dial(*_: Any) -> ClientConnection:
            return await connect(f"ws://127.0.0.1:{port}")

        monkeypatch.setattr(channels, "dial_gateway", dial)
        seen = await measure(place._replace(address=Address("http://127.0.0.1", "testUser", "a", "testUser")), 0.5)
    assert [each.stream for each in seen] == list(STREAMS)
    for each in seen:
        assert each.missing == len(each.delays) - 1
        assert min(each.delays) >= 0


async def test_platform_is_needed() -> None:
    async with AsyncExitStack() as stack:
        place, *_ = fake_place(stack)
        with pytest.raises(InvalidRequest, match="address"):
            await measure(place, 1)


def test_figures_are_a_table_and_data() -> None:
    seen = [Received(STREAMS[0], [0.001, 0.002], 3, 7), Received(STREAMS[1])]
    lines = channels.as_text(seen, 2.0).splitlines()
    assert lines[1].split() == ["large", "100", "1000000", "1.0", "3", "1.5", "2.0", "2.0"]
    assert lines[2].split()[:5] == ["small", "10", "100", "0.0", "0"]
    assert channels.as_data(seen, 2.0)["channels"][0]["missing"] == 3
