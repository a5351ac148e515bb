"""Service clients and providers: responses, errors, and what happens when the socket breaks."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping
from typing import Any, cast

import pytest

from rce.client.connection import Connection, Message
from rce.client.services import ServiceClient, ServiceProvider
from rce.errors import InvalidRequest, NotFound, RceError, TimedOut, Unavailable
from rce.protocol.blobs import Buffer
from rce.protocol.messages import DataMessage, decode_as, decode_frame

SET_BOOL = "std_srvs/SetBool"


class FakeConnection:
    """Connection that keeps the messages that are sent."""

    def __init__(self, features: frozenset[str] = frozenset({"ack"})) -> None:
        self.features = features
        self.sent: asyncio.Queue[DataMessage] = asyncio.Queue()

    def put_message(self, source: str, text: bytes, blobs: Mapping[str, Buffer], keep: int | None = None) -> int:
        self.sent.put_nowait(decode_as(DataMessage, decode_frame(text).data, "DM"))
        return 0


class FakeOwner:
    """Robot with a connection."""

    def __init__(self, connection: FakeConnection | None) -> None:
        self.name = "a"
        self.connection = cast(Connection | None, connection)

    async def remove_interface(self, endpoint: str, tag: str) -> None:
        raise AssertionError("no test removes an interface")


def message(msg_id: str, value: Any = None, error: str = "") -> Message:
    data = {"iTag": "srv", "type": SET_BOOL, "msgID": msg_id} | ({"error": error} if error else {"msg": value})
    return Message(decode_as(DataMessage, json.dumps(data).encode(), "DM"), {})


@pytest.fixture
def connection() -> FakeConnection:
    return FakeConnection()


@pytest.fixture
def client(connection: FakeConnection) -> ServiceClient:
    client = ServiceClient(FakeOwner(connection), "srv", SET_BOOL)
    client._set_status(True)
    return client


async def begin(client: ServiceClient, connection: FakeConnection) -> tuple[asyncio.Task[Any], str]:
    """Begin a call; return it with its msgID."""
    call = asyncio.create_task(client.call({"data": True}, 20))
    return call, (await connection.sent.get()).msgID


async def test_responses_are_matched_by_their_ids(client: ServiceClient, connection: FakeConnection) -> None:
    first, first_id = await begin(client, connection)
    second, second_id = await begin(client, connection)
    client._receive(message(second_id, {"success": True}))
    client._receive(message(first_id, {"success": False}))
    assert (await first, await second) == ({"success": False}, {"success": True})


async def test_error_response_is_raised(client: ServiceClient, connection: FakeConnection) -> None:
    call, msg_id = await begin(client, connection)
    client._receive(message(msg_id, error="stuck"))
    with pytest.raises(RceError, match="stuck"):
        await call


async def test_error_of_the_platform_fails_the_call_that_it_names(
    client: ServiceClient, connection: FakeConnection
) -> None:
    call, msg_id = await begin(client, connection)
    assert not client._fail_call(NotFound("x"), "other")
    assert client._fail_call(NotFound("the provider is gone"), msg_id)
    with pytest.raises(NotFound, match="gone"):
        await call
    assert not client._fail_call(NotFound("x"), msg_id)


async def test_call_times_out_and_its_late_response_is_ignored(
    client: ServiceClient, connection: FakeConnection
) -> None:
    with pytest.raises(TimedOut, match=r"srv \(std_srvs/SetBool\) did not answer within 0\.001 s"):
        await client.call({"data": True}, 0.001)
    client._receive(message(connection.sent.get_nowait().msgID, {"success": True}))


@pytest.mark.parametrize(
    ("lose", "reason"),
    [(lambda client: client._disconnected(), "not known"), (lambda client: client._end(None), "closed")],
    ids=["socket", "robot"],
)
async def test_pending_calls_fail_at_the_end(
    client: ServiceClient, connection: FakeConnection, lose: Callable[[ServiceClient], None], reason: str
) -> None:
    call, _ = await begin(client, connection)
    lose(client)
    with pytest.raises(Unavailable, match=reason):
        await call


async def test_request_that_is_not_json_is_refused(client: ServiceClient, connection: FakeConnection) -> None:
    with pytest.raises(InvalidRequest, match="cannot be sent"):
        await client.call({"data": object()})
    assert connection.sent.empty()


@pytest.mark.parametrize("kind", ["function", "coroutine function"])
async def test_result_of_the_handler_is_the_response(connection: FakeConnection, kind: str) -> None:
    async def coroutine(request: dict[str, bool]) -> dict[str, bool]:
        return {"success": request["data"]}

    handler = coroutine if kind == "coroutine function" else lambda request: {"success": request["data"]}
    provider = ServiceProvider(FakeOwner(connection), "srv", SET_BOOL, handler)
    provider._receive(message("7", {"data": True}))
    response = await connection.sent.get()
    assert (response.msgID, bytes(cast(bytes, response.msg))) == ("7", b'{"success":true}')


@pytest.mark.parametrize(
    ("handler", "reason"),
    [
        (lambda request: request["x"], "KeyError: 'x'"),
        (lambda request: {"success": object()}, "cannot be sent as JSON"),
    ],
    ids=["exception", "unusable response"],
)
async def test_failed_handler_sends_its_error(
    connection: FakeConnection, handler: Callable[[Any], Any], reason: str
) -> None:
    provider = ServiceProvider(FakeOwner(connection), "srv", SET_BOOL, handler)
    provider._receive(message("7", {"data": True}))
    response = await connection.sent.get()
    assert response.msgID == "7"
    assert reason in response.error


async def test_original_server_gets_no_error_response() -> None:
    connection = FakeConnection(frozenset())
    provider = ServiceProvider(FakeOwner(connection), "srv", SET_BOOL, lambda request: request["missing"])
    provider._receive(message("7", {}))
    await asyncio.gather(*provider._tasks)
    assert connection.sent.empty()


async def test_response_while_offline_is_dropped() -> None:
    provider = ServiceProvider(FakeOwner(None), "srv", SET_BOOL, lambda request: {"success": True})
    provider._receive(message("7", {}))
    await asyncio.gather(*provider._tasks)


async def test_calls_run_concurrently_and_end_with_the_provider(connection: FakeConnection) -> None:
    running: list[str] = []
    both, never = asyncio.Event(), asyncio.Event()

    async def hang(request: dict[str, str]) -> None:
        running.append(request["name"])
        if len(running) == 2:
            both.set()
        try:
            await never.wait()
        finally:
            running.remove(request["name"])

    provider = ServiceProvider(FakeOwner(connection), "srv", SET_BOOL, hang)
    provider._receive(message("1", {"name": "first"}))
    provider._receive(message("2", {"name": "second"}))
    await both.wait()
    tasks = [*provider._tasks]
    provider._end(None)
    await asyncio.wait(tasks)
    assert running == []
