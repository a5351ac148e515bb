"""Clients of Foxglove over real sockets, friendly and hostile."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidStatus
from websockets.typing import Subprotocol

from endpoints.gateways.foxglove.client import MAX_REPORTED, SUBPROTOCOLS
from endpoints.gateways.graphs import Graphs
from endpoints.gateways.view import View
from rce.control.calls.watching import RosGraph, RosName
from rce.net.budget import MB
from tests.support.endpoints.platforms import Platform
from tests.support.endpoints.raw_robot import PASSWORD, USER, eventually


@pytest.fixture(autouse=True)
def graph(monkeypatch: pytest.MonkeyPatch) -> None:
    async def read(*_: Any) -> RosGraph:
        return RosGraph([RosName("/chat", ["std_msgs/msg/String"], 1)], [])

    monkeypatch.setattr(Graphs, "read", read)
    monkeypatch.setattr(Graphs, "check", read)


def dial(platform: Platform, *subprotocols: str) -> Any:
    url = f"ws://127.0.0.1:{platform.port}/foxglove/brain?userID={USER}&password={PASSWORD}"
    return connect(
        url, subprotocols=[Subprotocol(each) for each in subprotocols] or None, max_size=None, max_queue=None
    )


@pytest.fixture
async def socket(platform: Platform) -> AsyncIterator[ClientConnection]:
    """A client that has got the greeting and the channels."""
    async with dial(platform, SUBPROTOCOLS[0]) as socket:
        assert (await receive(socket))["op"] == "serverInfo"
        assert (await receive(socket))["op"] == "advertise"
        yield socket


async def receive(socket: ClientConnection) -> Any:
    return json.loads(await asyncio.wait_for(socket.recv(), 30))


@pytest.mark.parametrize("name", SUBPROTOCOLS)
async def test_subprotocol_that_is_offered_is_used(platform: Platform, name: str) -> None:
    async with dial(platform, "other", name) as socket:
        assert socket.subprotocol == name
        info = await receive(socket)
        assert info["supportedEncodings"] == ["cdr", "json"]
        assert info["name"] == "brain"
        assert [each["topic"] for each in (await receive(socket))["channels"]] == ["/chat"]


async def test_client_without_subprotocol_is_refused(platform: Platform) -> None:
    with pytest.raises(InvalidStatus) as refused:
        await dial(platform)
    assert refused.value.response.status_code == 400
    await eventually(lambda: not platform.endpoint.sessions)


HOSTILE: list[str | bytes] = [
    "",
    "{}",
    "[" * 50_000,
    b"",
    b"\x01\x00",
    b"\x01\x00\x00\x00\x00x",
    b"\x63",
    '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 999}]}',
    '{"op": "advertise", "channels": [{"id": 1, "topic": "/a", "encoding": "protobuf", "schemaName": "a/B"}]}',
    '{"op": "advertise", "channels": [{"id": 1, "topic": "/a", "encoding": "cdr", "schemaName": "?"}]}',
    '{"op": "setParameters", "parameters": [{"name": "x", "value": 1}]}',
]


@pytest.mark.parametrize("message", HOSTILE, ids=range(len(HOSTILE)))
async def test_bad_message_gets_a_clear_status_and_costs_nothing_else(socket: ClientConnection, message: Any) -> None:
    await socket.send(message)
    status = await receive(socket)
    assert (status["op"], status["level"]) == ("status", 2)
    assert len(status["message"]) > 10
    await socket.send('{"op": "fetchAsset", "uri": "package://a/b", "requestId": 7}')
    answer = await asyncio.wait_for(socket.recv(), 30)
    assert isinstance(answer, bytes)
    assert answer[:2] == b"\x04\x07"


async def test_flood_of_bad_messages_closes_the_socket(socket: ClientConnection) -> None:
    for _ in range(110):
        await socket.send("?")
    await socket.wait_closed()
    assert socket.close_code == 1008


async def test_items_of_a_message_are_handled_apart(socket: ClientConnection) -> None:
    bad = {"id": 1, "topic": "/a", "encoding": "protobuf", "schemaName": "a/B"}
    good = {"id": 2, "topic": "/a", "encoding": "json", "schemaName": "std_msgs/String"}
    await socket.send(json.dumps({"op": "advertise", "channels": [bad, good]}))
    assert "protobuf" in (await receive(socket))["message"]
    await socket.send(json.dumps({"op": "advertise", "channels": [good]}))
    answers = [await receive(socket), await receive(socket)]  # the other is that there is no environment
    assert any("channel 2 is advertised already" in each["message"] for each in answers)


@pytest.mark.slow
async def test_assets_for_a_client_that_does_not_read_are_bounded(
    platform: Platform, socket: ClientConnection, monkeypatch: pytest.MonkeyPatch
) -> None:
    fetched: list[str] = []

    async def asset(self: View, uri: str) -> bytes:
        fetched.append(uri)
        return bytes(32 * MB)

    monkeypatch.setattr(View, "asset", asset)
    (session,) = platform.endpoint.sessions.values()
    socket.transport.pause_reading()
    for number in range(20):
        await socket.send(json.dumps({"op": "fetchAsset", "uri": f"package://a/{number}", "requestId": number}))
    await eventually(lambda: session.outbox.waiting > 0)
    before = -1
    while before != len(fetched):
        before = len(fetched)
        await asyncio.sleep(0.5)
    assert before < 10
    assert session.budget.used > 0
    socket.transport.resume_reading()
    for _ in range(20):
        assert len(await asyncio.wait_for(socket.recv(), 30)) > 32 * MB


async def test_refused_items_of_a_message_are_told_within_bounds(socket: ClientConnection) -> None:
    wanted = [{"id": number, "channelId": 999} for number in range(5000)]
    await socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
    told = [(await receive(socket))["message"] for _ in range(MAX_REPORTED + 1)]
    assert told[-1] == f"{5000 - MAX_REPORTED} more items of the message were refused"
    await socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted * 3}))
    assert "10000" in (await receive(socket))["message"]
