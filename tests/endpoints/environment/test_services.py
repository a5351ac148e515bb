"""Service interfaces in both directions between a robot and a real node."""

from __future__ import annotations

import asyncio
import secrets

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

import msgspec
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import String
from std_srvs.srv import SetBool

from endpoints.data.frames import Message
from rce.control.calls.endpoints import NodeSpec, StartNode, StopNode
from rce.errors import ConversionError, NotFound, UnknownType
from tests.support.endpoints.environment_driver import LIMIT, FakeMaster, wait_for_line

TRUE = serialize_message(SetBool.Request(data=True))


async def test_robot_calls_node(master: FakeMaster) -> None:
    robot = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "flip")
    assert not deserialize_message(await robot.call(TRUE), SetBool.Response).success


async def test_concurrent_calls_get_their_own_responses(master: FakeMaster) -> None:
    robot = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "flip")
    requests = {secrets.token_hex(16): bool(number % 3) for number in range(200)}
    for name, value in requests.items():
        robot.request(Message(robot.id, name, serialize_message(SetBool.Request(data=value))))
    for _ in range(200):
        message = await asyncio.wait_for(robot.received.get(), LIMIT)
        assert deserialize_message(bytes(message.payload), SetBool.Response).success is not requests.pop(message.msg_id)


async def test_only_requesting_peer_gets_response(master: FakeMaster) -> None:
    bound = await master.bind("ServiceClientInterface", "std_srvs/SetBool", "flip")
    one, other = await master.connect(bound), await master.connect(bound)
    await one.call(TRUE)
    assert other.received.empty()


async def test_request_waits_until_service_appears(master: FakeMaster) -> None:
    robot = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "/soon/flip")
    begin = await master.interface("PublisherInterface", "std_msgs/String", "/soon/begin")
    await master.call(StartNode(NodeSpec("soon", "probe", "echo.py", "later", namespace="soon")))
    await wait_for_line(master, "soon", "words is")
    answer = asyncio.create_task(robot.call(TRUE))
    await asyncio.sleep(0)  # so that the request goes before the message at which the node provides the service
    begin.publish(serialize_message(String()))
    assert not deserialize_message(await answer, SetBool.Response).success
    await master.call(StopNode("soon"))


async def test_call_of_missing_service_fails(master: FakeMaster) -> None:
    robot = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "nowhere")
    with pytest.raises(NotFound, match="nowhere did not appear"):
        await robot.call(TRUE)


async def test_malformed_request_is_rejected(master: FakeMaster) -> None:
    robot = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "flip")
    with pytest.raises(ConversionError, match="SetBool_Request"):
        await robot.call(b"\0\1\0\0")


async def test_node_calls_robot(master: FakeMaster) -> None:
    """The caller is another interface of the environment, so the call passes through ROS."""
    provider = await master.interface("ServiceProviderInterface", "std_srvs/SetBool", "robots_own")
    client = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "robots_own")

    def answer(request: Message) -> Message:
        value = deserialize_message(bytes(request.payload), SetBool.Request).data
        return Message(provider.id, request.msg_id, serialize_message(SetBool.Response(success=value, message="ok")))

    provider.answer = answer
    response = deserialize_message(await client.call(TRUE), SetBool.Response)
    assert (response.success, response.message) == (True, "ok")


async def test_error_of_robot_is_reported(master: FakeMaster) -> None:
    provider = await master.interface("ServiceProviderInterface", "std_srvs/SetBool", "failing")
    client = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "failing")
    error = msgspec.msgpack.encode(NotFound("no arm").info)
    provider.answer = lambda request: Message(provider.id, request.msg_id, error, error=True)
    client.request(Message(client.id, "1", TRUE))
    report = await master.report(provider.spec.tag)
    assert report.error is not None
    assert (report.error.code, "no arm" in report.error.message) == ("not_found", True)


async def test_call_without_peer_is_reported(master: FakeMaster) -> None:
    provider = await master.bind("ServiceProviderInterface", "std_srvs/SetBool", "alone")
    client = await master.interface("ServiceClientInterface", "std_srvs/SetBool", "alone")
    client.request(Message(client.id, "1", TRUE))
    report = await master.report(provider.tag)
    assert report.error is not None
    assert report.error.code == "not_connected"


async def test_message_type_is_no_service_type(master: FakeMaster) -> None:
    with pytest.raises(UnknownType):
        await master.bind("ServiceClientInterface", "std_msgs/String", "a")
