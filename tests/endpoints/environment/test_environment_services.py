"""Services in both directions between a robot and a real node."""

from __future__ import annotations

import asyncio
import secrets

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

import msgspec
from environment_driver import FakeMaster
from rclpy.serialization import deserialize_message, serialize_message
from std_srvs.srv import SetBool

from endpoints.frames import Message
from rce.calls.endpoints import NodeSpec, StartNode, StopNode
from rce.errors import ConversionError, NotFound, UnknownType

TRUE = serialize_message(SetBool.Request(data=True))


async def test_robot_asks_node(master: FakeMaster) -> None:
    robot = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "flip")
    assert not deserialize_message(await robot.ask(TRUE), SetBool.Response).success


async def test_many_at_a_time_and_each_gets_its_own_answer(master: FakeMaster) -> None:
    robot = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "flip")
    asked = {secrets.token_hex(16): bool(number % 3) for number in range(200)}
    for name, value in asked.items():
        robot.request(Message(robot.id, name, serialize_message(SetBool.Request(data=value))))
    for _ in range(200):
        message = await asyncio.wait_for(robot.got.get(), 10)
        assert deserialize_message(bytes(message.payload), SetBool.Response).success is not asked.pop(message.msg_id)


async def test_only_the_one_who_asked_gets_the_answer(master: FakeMaster) -> None:
    bound = await master.bind("ServiceClientInterface", "std_srvs/SetBool", "flip")
    one, other = await master.connect(bound), await master.connect(bound)
    await one.ask(TRUE)
    assert other.got.empty()


async def test_a_request_waits_for_its_service_to_appear(master: FakeMaster) -> None:
    robot = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "/soon/flip")
    answer = asyncio.create_task(robot.ask(TRUE))
    await master.call(StartNode(NodeSpec("soon", "probe", "echo.py", namespace="soon")))
    assert not deserialize_message(await answer, SetBool.Response).success
    await master.call(StopNode("soon"))


async def test_a_service_that_does_not_appear(master: FakeMaster) -> None:
    robot = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "nowhere")
    with pytest.raises(NotFound, match="nowhere has not appeared"):
        await robot.ask(TRUE)


async def test_a_request_that_is_none(master: FakeMaster) -> None:
    robot = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "flip")
    with pytest.raises(ConversionError, match="SetBool_Request"):
        await robot.ask(b"\0\1\0\0")


async def test_node_asks_robot(master: FakeMaster) -> None:
    """The asking node is another interface of the environment: ROS lies between them all the same."""
    provider = await master.interface("ServiceProviderInterface", "std_srvs/SetBool", "robots_own")
    client = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "robots_own")

    def answer(request: Message) -> Message:
        asked = deserialize_message(bytes(request.payload), SetBool.Request).data
        return Message(provider.id, request.msg_id, serialize_message(SetBool.Response(success=asked, message="ok")))

    provider.answer = answer
    answered = deserialize_message(await client.ask(TRUE), SetBool.Response)
    assert (answered.success, answered.message) == (True, "ok")


async def test_a_robot_that_fails_is_reported(master: FakeMaster) -> None:
    provider = await master.interface("ServiceProviderInterface", "std_srvs/SetBool", "failing")
    client = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "failing")
    error = msgspec.msgpack.encode(NotFound("no arm").info)
    provider.answer = lambda request: Message(provider.id, request.msg_id, error, error=True)
    client.request(Message(client.id, "1", TRUE))
    report = await master.report(provider.spec.tag)
    assert report.error is not None
    assert (report.error.code, "no arm" in report.error.message) == ("not_found", True)


async def test_nobody_connected_is_reported(master: FakeMaster) -> None:
    provider = await master.bind("ServiceProviderInterface", "std_srvs/SetBool", "alone")
    client = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "alone")
    client.request(Message(client.id, "1", TRUE))
    report = await master.report(provider.tag)
    assert report.error is not None
    assert report.error.code == "not_connected"


async def test_messages_are_no_services(master: FakeMaster) -> None:
    with pytest.raises(UnknownType):
        await master.bind("ServiceClientInterface", "std_msgs/String", "a")
