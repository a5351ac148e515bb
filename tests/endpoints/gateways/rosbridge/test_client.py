"""Clients of rosbridge over real sockets, friendly and hostile."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect

from endpoints.gateways.graphs import Graphs
from rce.control.calls.watching import RosGraph, RosName
from tests.support.endpoints.platforms import Platform
from tests.support.endpoints.raw_robot import PASSWORD, USER, eventually

QUERY = f"userID={USER}&password={PASSWORD}"
TOPICS: dict[str, Any] = {"op": "call_service", "service": "rosapi/topics", "id": "t"}


@pytest.fixture(autouse=True)
def graph(monkeypatch: pytest.MonkeyPatch) -> None:
    async def read(*_: Any) -> RosGraph:
        return RosGraph([RosName("/chat", ["std_msgs/msg/String"])], [])

    monkeypatch.setattr(Graphs, "read", read)
    monkeypatch.setattr(Graphs, "check", read)


@pytest.fixture
async def socket(platform: Platform) -> AsyncIterator[ClientConnection]:
    async with connect(f"ws://127.0.0.1:{platform.port}/rosbridge/brain?{QUERY}", max_size=None) as socket:
        yield socket


async def send(socket: ClientConnection, *operations: Any) -> None:
    for each in operations:
        await socket.send(each if isinstance(each, str | bytes) else json.dumps(each))


async def receive(socket: ClientConnection) -> Any:
    return json.loads(await asyncio.wait_for(socket.recv(), 30))


async def test_names_may_lack_their_slash(socket: ClientConnection) -> None:
    await send(socket, TOPICS)
    answer = await receive(socket)
    assert (answer["id"], answer["result"], answer["service"]) == ("t", True, "/rosapi/topics")
    assert answer["values"]["topics"] == ["/chat"]


async def test_operation_may_come_in_fragments(socket: ClientConnection) -> None:
    text = json.dumps(TOPICS)
    parts = [text[:20], text[20:]]
    for number in (1, 0):
        await send(socket, {"op": "fragment", "id": "f", "num": number, "total": 2, "data": parts[number]})
    assert (await receive(socket))["id"] == "t"


async def test_answer_may_be_sent_in_fragments(socket: ClientConnection) -> None:
    await send(socket, TOPICS | {"fragment_size": 128, "id": "x" * 200})
    first = await receive(socket)
    others = [await receive(socket) for _ in range(first["total"] - 1)]
    assert json.loads("".join(each["data"] for each in (first, *others)))["values"]["topics"] == ["/chat"]


HOSTILE = [
    "",
    "null",
    "[" * 50_000,
    '{"op": "dance"}',
    '{"op": "publish", "topic": 5}',
    '{"op": "publish", "topic": "/a", "msg": }',
    b"\xff\x00",
    '{"op": "fragment", "id": 1, "data": "{", "num": 0, "total": 99999999999}',
    '{"op": "fragment", "id": 2, "data": "{\\"op\\":\\"fragment\\"}", "num": 0, "total": 1}',
    '{"op": "subscribe", "topic": "/a", "type": "no type"}',
    '{"op": "advertise_service", "service": "/a", "type": ""}',
    '{"op": "service_response", "service": "/a", "values": {}, "result": true}',
    '{"op": "action_result", "action": "/a", "values": 7, "id": [1, {}]}',
    '{"op": "cancel_action_goal", "action": "/a", "id": "x"}',
]


@pytest.mark.parametrize("message", HOSTILE, ids=range(len(HOSTILE)))
async def test_bad_message_gets_a_clear_status_and_costs_nothing_else(socket: ClientConnection, message: Any) -> None:
    await send(socket, {"op": "set_level", "level": "error"}, message)
    status = await receive(socket)
    assert (status["op"], status["level"]) == ("status", "error")
    assert len(status["msg"]) > 10
    await send(socket, TOPICS)
    assert (await receive(socket))["id"] == "t"


async def test_statuses_are_sent_only_on_request(socket: ClientConnection) -> None:
    await send(socket, '{"op": "dance"}', '{"op": "auth", "mac": ""}', '{"op": "status", "level": "info"}', TOPICS)
    assert (await receive(socket))["id"] == "t"


async def test_flood_of_bad_messages_closes_the_socket_of_its_client_only(
    platform: Platform, socket: ClientConnection
) -> None:
    async with connect(f"ws://127.0.0.1:{platform.port}/rosbridge/brain?{QUERY}") as other:
        for _ in range(110):
            await send(socket, "?")
        await socket.wait_closed()
        assert socket.close_code == 1008
        assert "bad messages" in (socket.close_reason or "")
        await send(other, TOPICS)
        assert (await receive(other))["id"] == "t"


async def test_message_that_is_too_large_closes_the_socket(make_platform: Any) -> None:
    platform = await make_platform(message=100_000)
    async with connect(f"ws://127.0.0.1:{platform.port}/rosbridge/brain?{QUERY}") as socket:
        await send(socket, '{"op": "publish", "topic": "/a", "msg": "' + "x" * 100_000)
        await socket.wait_closed()
        assert socket.close_code == 1009


async def test_answers_of_rosapi_wait_for_a_client_that_does_not_read(
    platform: Platform, socket: ClientConnection, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = asyncio.Event()

    async def read(*_: Any) -> RosGraph:
        await asked.wait()
        return RosGraph([RosName(f"/{'t' * 200}{number}", ["std_msgs/msg/String"]) for number in range(1000)], [])

    monkeypatch.setattr(Graphs, "read", read)
    (session,) = platform.endpoint.sessions.values()
    guest: Any = session.socket
    socket.transport.pause_reading()
    await send(socket, *[TOPICS] * 300)
    await eventually(lambda: len(guest._work._tasks) == 300)
    asked.set()
    await eventually(lambda: session.outbox.backlog(b"") >= 8)
    for _ in range(300):
        await asyncio.sleep(0)
    assert session.outbox.backlog(b"") < 30
    socket.transport.resume_reading()
    for _ in range(300):
        assert (await receive(socket))["result"]
