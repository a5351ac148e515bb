"""Service clients and servers of serialized messages, which call each other through ROS."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from std_srvs.srv import SetBool

from endpoints.environment import ros_services
from endpoints.environment.ros_services import MAX_BATCH, Header, RawClient, RawService
from rce.errors import ConversionError, RceError, TimedOut
from tests.support.endpoints.ros_world import LIMIT, RosWorld

COUNT = 3 * MAX_BATCH


class Pair:
    """A client, and a server whose requests the test answers."""

    def __init__(self, world: RosWorld) -> None:
        self._ros = world.ros
        self.requests: asyncio.Queue[tuple[Header, bytes]] = asyncio.Queue()
        self.responses: asyncio.Queue[tuple[int, bytes]] = asyncio.Queue()
        self.lost: asyncio.Queue[RceError] = asyncio.Queue()
        self.service: RawService
        self.client: RawClient

    async def open(self) -> None:
        ros = self._ros
        self.client = RawClient(ros, SetBool, "/raw/flip", self._answered)
        assert not self.client.available(), "there is no server yet"
        self.service = RawService(ros, SetBool, "/raw/flip", self._requested, self._lost)

    def _answered(self, number: int, payload: bytes) -> None:
        self.responses.put_nowait((number, payload))

    def _requested(self, header: Header, payload: bytes) -> None:
        self.requests.put_nowait((header, payload))

    def _lost(self, kind: type[RceError], reason: str) -> None:
        self.lost.put_nowait(kind(reason))

    async def call(self, payload: bytes) -> int:
        return self.client.call(payload)

    async def answer(self, header: Header, payload: bytes) -> None:
        self.service.answer(header, payload)

    async def close(self) -> None:
        for each in (self.client, self.service):
            each.destroy()


@pytest.fixture
async def pair(world: RosWorld) -> AsyncIterator[Pair]:
    made = Pair(world)
    await made.open()
    await world.until(made.client.available)
    yield made
    await made.close()


def request(value: bool) -> bytes:
    return serialize_message(SetBool.Request(data=value))


def response(text: str) -> bytes:
    return serialize_message(SetBool.Response(success=True, message=text))


async def test_requests_are_answered_in_any_order(pair: Pair) -> None:
    numbers = [await pair.call(request(bool(index % 2))) for index in range(COUNT)]
    async with asyncio.timeout(LIMIT):
        requests = [await pair.requests.get() for _ in range(COUNT)]
        values = [deserialize_message(payload, SetBool.Request).data for _, payload in requests]
        assert values == [bool(index % 2) for index in range(COUNT)]
        for index, (header, _) in reversed(list(enumerate(requests))):
            await pair.answer(header, response(str(index)))
        answers = dict([await pair.responses.get() for _ in range(COUNT)])
    texts = {number: deserialize_message(payload, SetBool.Response).message for number, payload in answers.items()}
    assert texts == {number: str(index) for index, number in enumerate(numbers)}


@pytest.mark.parametrize("payload", [b"", b"\0\1\0\0"])
async def test_payload_of_another_type_is_refused(pair: Pair, payload: bytes) -> None:
    with pytest.raises(ConversionError, match=r"the request to /raw/flip is not a serialized .*SetBool_Request"):
        await pair.call(payload)
    await pair.call(request(True))
    header, _ = await asyncio.wait_for(pair.requests.get(), LIMIT)
    with pytest.raises(ConversionError, match=r"the response of /raw/flip is not a serialized .*SetBool_Response"):
        await pair.answer(header, payload)


async def test_service_that_is_gone_is_not_available(pair: Pair, world: RosWorld) -> None:
    pair.service.destroy()
    await world.until(lambda: not pair.client.available())
    pair.service = RawService(world.ros, SetBool, "/raw/flip", pair._requested, pair._lost)


async def test_response_is_sent_again_until_ros_knows_its_reader(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_services, "PAUSES", (0.01,) * 3)
    send, attempts = pair.service._sent, 0

    def find_reader_late(answer: Any, header: Header) -> bool:
        nonlocal attempts
        attempts += 1
        return attempts > 3 and send(answer, header)

    monkeypatch.setattr(pair.service, "_sent", find_reader_late)
    number = await pair.call(request(True))
    header, _ = await asyncio.wait_for(pair.requests.get(), LIMIT)
    await pair.answer(header, response("late"))
    assert (await asyncio.wait_for(pair.responses.get(), LIMIT))[0] == number
    assert pair.lost.empty()


async def test_response_without_reader_is_reported(
    pair: Pair, world: RosWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros_services, "PAUSES", (0.01,))
    # Its requests match the server's reader; the responses that it wants do not match the server's writer. Client and
    # server share a node, so that DDS matches both at once.
    ros, durable = world.ros, QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    client = ros.node.create_client(SetBool, "/raw/flip", qos_profile=durable)
    client.call_async(SetBool.Request(data=True))
    header, _ = await asyncio.wait_for(pair.requests.get(), LIMIT)
    await pair.answer(header, response("nobody reads this"))
    error = await asyncio.wait_for(pair.lost.get(), LIMIT)
    assert isinstance(error, TimedOut)
    assert str(error) == "ROS has not found the client to which /raw/flip should respond"
    ros.node.destroy_client(client)
