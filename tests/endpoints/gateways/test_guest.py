"""Guests of gateways at a real Master: login, rights, and the end of everything with the socket."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidStatus
from websockets.typing import Subprotocol

from endpoints.gateways.guest import Guest
from endpoints.gateways.uses import SUBSCRIBE
from endpoints.robot.session import MAX_COMMANDS
from rce.control.calls.robots import ReadGraphFor
from rce.control.calls.watching import RosGraph
from rce.protocol.messages import ConnectionEvent
from tests.support.endpoints.platforms import Platform
from tests.support.endpoints.raw_robot import PASSWORD, USER, dm, eventually, status


def url(platform: Platform, path: str = "rosbridge/brain", query: str = f"userID={USER}&password={PASSWORD}") -> str:
    return f"ws://127.0.0.1:{platform.port}/{path}?{query}"


@pytest.fixture
def brain(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the environment brain exist as far as its graph is asked for."""
    call = platform.endpoint.master.call

    async def answer(asked: Any, *args: Any, **options: Any) -> Any:
        if isinstance(asked, ReadGraphFor) and asked.environment == "brain":
            return RosGraph([], [])
        return await call(asked, *args, **options)

    monkeypatch.setattr(platform.endpoint.master, "call", answer)


async def ask(socket: ClientConnection, **operation: Any) -> Any:
    await socket.send(json.dumps(operation))
    return json.loads(await socket.recv())


@pytest.mark.parametrize(
    ("path", "query", "status"),
    [
        ("rosbridge/brain", f"userID={USER}&password={PASSWORD}", 404),
        ("rosbridge/admin/brain", f"userID={USER}&password={PASSWORD}", 404),
        ("rosbridge/brain", f"userID={USER}&password={'0' * 64}", 401),
        ("rosbridge/brain", f"userID={USER}", 400),
        ("rosbridge", f"userID={USER}&password={PASSWORD}", 404),
    ],
)
async def test_handshake_is_refused(platform: Platform, path: str, query: str, status: int) -> None:
    with pytest.raises(InvalidStatus) as refused:
        await connect(url(platform, path, query))
    assert refused.value.response.status_code == status
    await eventually(lambda: not platform.endpoint.sessions)


@pytest.mark.usefixtures("brain")
async def test_session_of_a_guest_ends_with_its_socket(platform: Platform) -> None:
    async with connect(url(platform)):
        (name,) = platform.endpoint.sessions
        assert name.startswith(f"{USER}/@rosbridge_")
        await eventually(lambda: name in platform.master.state.robots)
    await eventually(lambda: not platform.endpoint.sessions)
    await eventually(lambda: not platform.master.state.robots)


@pytest.mark.usefixtures("brain")
async def test_guest_is_closed_when_its_session_is_ended(platform: Platform) -> None:
    async with connect(url(platform)) as socket:
        (name,) = platform.endpoint.sessions
        await platform.master.sessions.disconnect(name, "the key was revoked")
        await socket.wait_closed()
        assert (socket.close_code, socket.close_reason) == (1008, "the key was revoked")


@pytest.mark.usefixtures("brain")
async def test_use_that_cannot_be_made_is_reported(platform: Platform) -> None:
    async with connect(url(platform)) as socket:
        await socket.send('{"op": "set_level", "level": "info"}')
        status = await ask(socket, op="subscribe", topic="/a", type="std_msgs/String", id=7)
        assert (status["op"], status["id"]) == ("status", 7)
        assert "brain" in status["msg"]
        answer = await ask(socket, op="call_service", service="/a", type="std_srvs/Empty", id="c")
        assert (answer["result"], answer["id"]) == (False, "c")


@pytest.mark.slow
@pytest.mark.usefixtures("brain")
async def test_more_uses_are_begun_at_once_than_a_session_may_have_commands(platform: Platform) -> None:
    async with connect(url(platform)):
        (session,) = platform.endpoint.sessions.values()
        guest = session.socket
        assert isinstance(guest, Guest)
        uses = [
            guest.use(SUBSCRIBE, f"/t{n}", "std_msgs/String", lambda _: (), lambda *_: None)
            for n in range(MAX_COMMANDS // 2)  # each takes three
        ]
        await asyncio.wait([use.ready for use in uses], timeout=60)
        assert {str(use.ready.exception()) for use in uses} == {str(uses[0].ready.exception())}
        assert "brain" in str(uses[0].ready.exception()), "the environment, and not the number of commands"
        await eventually(lambda: not guest._removals)


@pytest.mark.usefixtures("brain")
async def test_graph_is_read_after_the_clients_earlier_operations(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with connect(url(platform)):
        (session,) = platform.endpoint.sessions.values()
        guest = session.socket
        assert isinstance(guest, Guest)
        await guest.view.graph()
        call, read = platform.endpoint.master.call, 0

        async def count(asked: Any, *args: Any, **options: Any) -> Any:
            nonlocal read
            read += isinstance(asked, ReadGraphFor)
            return await call(asked, *args, **options)

        monkeypatch.setattr(platform.endpoint.master, "call", count)
        await guest.view.graph()
        assert read == 0, "it was read a moment ago"
        use = guest.use(SUBSCRIBE, "/scan", "std_msgs/String", lambda _: (), lambda *_: None)
        await guest.view.graph()
        assert use.ready.done()
        assert read == 1


@pytest.mark.usefixtures("brain")
async def test_client_whose_environment_is_removed_is_closed(platform: Platform) -> None:
    async with connect(url(platform)) as socket:
        (session,) = platform.endpoint.sessions.values()
        guest = session.socket
        assert isinstance(guest, Guest)
        use = guest.use(SUBSCRIBE, "/scan", "std_msgs/String", lambda _: (), lambda *_: None)
        robot = guest.name.partition("/")[2]
        session.status(ConnectionEvent("brain/x", f"{robot}/u99", "gone"))
        session.status(ConnectionEvent(f"brain/{robot}.{use.tag}", f"{robot}/{use.tag}", "waiting"))
        assert session.socket is guest
        session.status(ConnectionEvent(f"brain/{robot}.{use.tag}", f"{robot}/{use.tag}", "gone"))
        await socket.wait_closed()
        assert socket.close_reason == "/scan: environment brain, or its interface, was removed"


@pytest.mark.usefixtures("brain")
async def test_what_a_robot_sends_is_a_topic(platform: Platform) -> None:
    robot = await platform.robot("r2")
    await robot.add("pose", "SubscriberConverter")
    async with connect(url(platform)) as socket:
        listed = await ask(socket, op="call_service", service="/rosapi/topics", id="t")
        assert listed["values"] == {"topics": ["/r2/pose"], "types": ["std_msgs/msg/String"]}
        await socket.send(json.dumps({"op": "subscribe", "topic": "/r2/pose"}))
        await robot.until(lambda message: message == status("pose", True))
        await robot.send(dm("pose", {"data": "here"}))
        assert json.loads(await socket.recv()) == {"op": "publish", "topic": "/r2/pose", "msg": {"data": "here"}}
        await socket.send(json.dumps({"op": "unsubscribe", "topic": "/r2/pose"}))
        await robot.until(lambda message: message == status("pose", False))
        assert not platform.master.state.interfaces.by(f"{USER}/brain"), "nothing was added to the environment"


@pytest.mark.usefixtures("brain")
async def test_robot_gets_what_a_client_publishes(platform: Platform) -> None:
    robot = await platform.robot("r2")
    await robot.add("cmd", "PublisherConverter")
    async with connect(url(platform)) as socket:
        await socket.send(json.dumps({"op": "publish", "topic": "/r2/cmd", "msg": {"data": "go"}}))
        got = await robot.until(lambda message: message["type"] == "DM")
        assert got[-1]["data"]["msg"] == {"data": "go"}


@pytest.mark.usefixtures("brain")
async def test_robots_come_and_go_as_channels_of_a_viewer(platform: Platform) -> None:
    robot = await platform.robot("r2")
    await robot.add("pose", "SubscriberConverter")
    async with connect(url(platform, "foxglove/brain"), subprotocols=[Subprotocol("foxglove.sdk.v1")]) as socket:
        assert json.loads(await socket.recv())["op"] == "serverInfo"
        (channel,) = json.loads(await socket.recv())["channels"]
        assert (channel["topic"], channel["schemaName"]) == ("/r2/pose", "std_msgs/msg/String")
        subscription = {"id": 7, "channelId": channel["id"]}
        await socket.send(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))
        await robot.until(lambda message: message == status("pose", True))
        await robot.send(dm("pose", {"data": "here"}))
        frame = await socket.recv()
        assert frame[:5] == b"\x01\x07\x00\x00\x00"
        assert b"here" in bytes(frame)
        await robot.send({"type": "CN", "data": {"removeInterfaces": [{"endpointTag": "r2", "interfaceTag": "pose"}]}})
        gone = [json.loads(await socket.recv()) for _ in range(2)]
        assert {"op": "unadvertise", "channelIds": [channel["id"]]} in gone
        assert any("the robot removed its interface r2/pose" in each.get("message", "") for each in gone)
