"""Commands of a robot, acknowledgements and errors, with and without features."""

from __future__ import annotations

import asyncio
import gc
import weakref
from typing import Any, cast

import pytest
from msgspec import Raw

from endpoints.robot.session import RobotSession
from endpoints.robot.streams import Streams
from rce.control.client import ControlClient
from rce.protocol import messages as m
from tests.support.endpoints.platforms import Platform, pair
from tests.support.endpoints.raw_robot import USER, dm, eventually, status
from tests.support.hand_turned import HandTurnedLoop


async def test_success_is_not_acknowledged_without_features(platform: Platform) -> None:
    a, b = await pair(platform)
    await a.data("out", {"data": "hi"}, id=7)
    assert await b.receive() == dm("in", {"data": "hi"})
    await a.expect_silence()
    await a.send({"type": "CX", "data": {"disconnect": [{"tagA": "b/in", "tagB": "a/out"}]}, "id": 1})
    assert await a.receive() == status("out", False)
    assert await b.receive() == status("in", False)
    await a.data("out", {"data": "to nobody"})
    await a.expect_silence()
    await a.send({"type": "CN", "data": {"removeNodes": [{"containerTag": "c", "nodeTag": "n"}]}, "id": 2})
    answer = await a.receive()
    assert answer.keys() == {"type", "data"}
    assert isinstance(answer["data"], str)


@pytest.mark.parametrize("id", [0, -5, "", "text", 2**60])
async def test_frame_with_id_is_acknowledged(platform: Platform, id: int | str) -> None:
    a, b = await pair(platform, features="ack")
    await a.data("out", {"data": "hi"}, id=id)
    assert await a.receive() == {"type": "ST", "id": id, "data": {"topic": "ack"}}
    await a.send({"type": "CN", "data": {}, "id": id})
    assert await a.receive() == {"type": "ST", "id": id, "data": {"topic": "ack"}}
    await a.data("none", {"data": "hi"}, id=id)
    answer = await a.receive()
    assert (answer["type"], answer["id"], answer["error"]["code"]) == ("ER", id, "not_found")
    await b.send("{}")
    assert "id" not in await b.receive()


async def test_items_before_malformed_one_are_executed(platform: Platform) -> None:
    a = await platform.robot("a", "ack")
    await a.receive()
    good = {"endpointTag": "a", "interfaceTag": "one", "interfaceType": "PublisherConverter", "className": "a/B"}
    good["className"] = "std_msgs/String"
    later = good | {"interfaceTag": "later"}
    bad = {key: value for key, value in good.items() if key != "className"}
    await a.send({"type": "CN", "id": 3, "data": {"setParam": [1], "addInterfaces": [good, bad, later]}})
    answer = await a.receive()
    assert (answer["type"], answer["id"], answer["error"]["item"]) == ("ER", 3, "addInterfaces[1]")
    assert "className" in answer["data"]
    await a.expect_silence()
    for tag, there in (("one", True), ("later", False)):
        item = {"endpointTag": "a", "interfaceTag": tag}
        await a.send({"type": "CN", "id": tag, "data": {"removeInterfaces": [item]}})
        answer = await a.receive()
        assert (answer["type"], answer["id"]) == ("ST" if there else "ER", tag)


async def test_rejected_item_is_named_and_others_are_executed(platform: Platform) -> None:
    a = await platform.robot("a", "ack")
    await a.receive()
    item = {"endpointTag": "a", "interfaceType": "PublisherConverter", "className": "std_msgs/String"}
    items = [item | {"interfaceTag": tag} for tag in ("one", "1", "two")]
    await a.send({"type": "CN", "id": 3, "data": {"addInterfaces": items}})
    answer = await a.receive()
    assert (answer["type"], answer["id"], answer["error"]["item"]) == ("ER", 3, "addInterfaces[1]")
    await a.expect_silence()
    assert set(platform.endpoint.sessions[f"{USER}/a"].interfaces) == {"one", "two"}


async def test_pipelined_commands_are_executed_in_order(platform: Platform) -> None:
    a = await platform.robot("a", "ack")
    await a.receive()
    for number in range(60):
        await a.add("x", "PublisherConverter")
        await a.add("y", "SubscriberConverter")
        await a.connect("a/x", "a/y")
        items = [{"endpointTag": "a", "interfaceTag": tag} for tag in "xy"]
        await a.send({"type": "CN", "id": number, "data": {"removeInterfaces": items}})
    frames = await a.until(lambda frame: frame.get("id") == 59)
    assert not [frame for frame in frames if frame["type"] == "ER"]
    assert sorted(frame["id"] for frame in frames if "id" in frame) == list(range(60))


async def test_commands_in_progress_are_limited(platform: Platform) -> None:
    a = await platform.robot("a", "ack")
    await a.receive()
    items = [{"containerTag": "c", "nodeTag": "n"}] * 1001
    await a.send({"type": "CN", "id": 1, "data": {"removeNodes": items}})
    answer = await a.receive()
    assert (answer["id"], answer["error"]["code"]) == (1, "limit_exceeded")
    await a.send({"type": "CN", "id": 2, "data": {"x": "y" * 5_000_000}})
    answer = await a.receive()
    assert (answer["id"], answer["error"]["code"]) == (2, "limit_exceeded")
    value = {"containerTag": "c", "name": "n", "value": [0] * 10_001}
    await a.send({"type": "CN", "id": 3, "data": {"setParam": [value]}})
    answer = await a.receive()
    assert answer["id"] == 3
    assert answer["error"]["message"] == "the frame has more than 10000 values: divide it"
    await a.send({"type": "CN", "id": 4, "data": {}})
    assert (await a.receive())["id"] == 4


def test_commands_in_progress_are_cancelled_when_the_session_ends(hand: HandTurnedLoop) -> None:
    """The fixture fails if one is not."""
    answers: list[asyncio.Future[Any]] = []

    class Master:
        async def issue(self, call: Any) -> asyncio.Future[Any]:
            answers.append(hand.create_future())
            return answers[-1]

    session = hand.do(lambda: RobotSession(f"{USER}/a", cast(ControlClient, Master()), Streams("i")))
    items = b'[{"containerTag": "c", "nodeTag": "n"}, {"containerTag": "c", "nodeTag": "o"}]'
    frame = m.Frame("CN", Raw(b'{"removeNodes": ' + items + b"}"))
    hand.do(lambda: session.command(frame))
    assert len(answers) == 1, "a frame is one call"
    hand.do(lambda: session.end("the robot left"))
    assert answers[0].cancelled()
    gc.collect()
    hand.settle()


async def test_unknown_key_of_a_command_is_refused_unless_the_robot_is_one_of_the_original(platform: Platform) -> None:
    old, new = await platform.robot("old"), await platform.robot("new", "events")
    await new.receive()
    command = {"type": "CN", "data": {"setParam": [{"containerTag": "none", "name": "x", "value": 1, "nodeTga": "n"}]}}
    await new.send(command)
    assert "nodeTga: there is no such key: did you mean nodeTag?" in (await new.receive())["error"]["message"]
    await old.send(command)
    assert "nodeTga" not in (await old.receive())["data"]


async def test_ended_session_and_its_socket_are_freed_at_once(platform: Platform) -> None:
    """Leave nothing to the garbage collector, which stops all robots of the process while it runs."""
    a, _ = await pair(platform, features="ack")
    await a.data("out", {"data": "hi"})
    session = weakref.ref(platform.endpoint.sessions[f"{USER}/a"])
    socket, interface = weakref.ref(session().socket), weakref.ref(session().interfaces["out"])
    gc.disable()
    try:
        await a.socket.close()
        await eventually(lambda: session() is socket() is interface() is None)
    finally:
        gc.enable()
