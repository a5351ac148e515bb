"""What a robot's frames lead to: commands, data, blobs, services, with and without the features that it opted in to."""

from __future__ import annotations

import asyncio
import json
import struct
from typing import Any

import pytest
from platforms import Platform, pair
from raw_robot import USER, Json, Robot, dm, eventually, status

from rce.blobs import PART

ID, OTHER = "0a" * 16, "0b" * 16
BYTES = "std_msgs/UInt8MultiArray"


async def test_without_features_success_is_silent(platform: Platform) -> None:
    a, b = await pair(platform)
    await a.data("out", {"data": "hi"}, id=7)
    assert await b.take() == dm("in", {"data": "hi"})
    await a.silent()
    await a.send({"type": "CX", "data": {"disconnect": [{"tagA": "b/in", "tagB": "a/out"}]}, "id": 1})
    assert await a.take() == status("out", False)
    assert await b.take() == status("in", False)
    await a.data("out", {"data": "to nobody"})
    await a.silent()
    await a.send({"type": "CN", "data": {"removeNodes": [{"containerTag": "c", "nodeTag": "n"}]}, "id": 2})
    answer = await a.take()
    assert answer.keys() == {"type", "data"}
    assert isinstance(answer["data"], str)


@pytest.mark.parametrize("id", [0, -5, "", "text", 2**60])
async def test_a_frame_with_id_is_acknowledged(platform: Platform, id: int | str) -> None:
    a, b = await pair(platform, features="ack")
    await a.data("out", {"data": "hi"}, id=id)
    assert await a.take() == {"type": "ST", "id": id, "data": {"topic": "ack"}}
    await a.send({"type": "CN", "data": {}, "id": id})
    assert await a.take() == {"type": "ST", "id": id, "data": {"topic": "ack"}}
    await a.data("none", {"data": "hi"}, id=id)
    answer = await a.take()
    assert (answer["type"], answer["id"], answer["error"]["code"]) == ("ER", id, "not_found")
    await b.send("{}")
    assert "id" not in await b.take()


async def test_the_items_before_a_bad_one_stay_applied(platform: Platform) -> None:
    a = await platform.robot("a", "ack")
    await a.take()
    good = {"endpointTag": "a", "interfaceTag": "one", "interfaceType": "PublisherConverter", "className": "a/B"}
    good["className"] = "std_msgs/String"
    later = good | {"interfaceTag": "later"}
    bad = {key: value for key, value in good.items() if key != "className"}
    await a.send({"type": "CN", "id": 3, "data": {"setParam": [1], "addInterfaces": [good, bad, later]}})
    answer = await a.take()
    assert (answer["type"], answer["id"], answer["error"]["item"]) == ("ER", 3, "addInterfaces[1]")
    assert "className" in answer["data"]
    await a.silent()
    for tag, there in (("one", True), ("later", False)):
        item = {"endpointTag": "a", "interfaceTag": tag}
        await a.send({"type": "CN", "id": tag, "data": {"removeInterfaces": [item]}})
        answer = await a.take()
        assert (answer["type"], answer["id"]) == ("ST" if there else "ER", tag)


async def test_an_item_that_the_master_refuses_is_named_and_the_others_are_carried_out(platform: Platform) -> None:
    a = await platform.robot("a", "ack")
    await a.take()
    item = {"endpointTag": "a", "interfaceType": "PublisherConverter", "className": "std_msgs/String"}
    items = [item | {"interfaceTag": tag} for tag in ("one", "1", "two")]
    await a.send({"type": "CN", "id": 3, "data": {"addInterfaces": items}})
    answer = await a.take()
    assert (answer["type"], answer["id"], answer["error"]["item"]) == ("ER", 3, "addInterfaces[1]")
    await a.silent()
    assert set(platform.endpoint.sessions[f"{USER}/a"].interfaces) == {"one", "two"}


async def test_pipelined_commands_run_in_their_order(platform: Platform) -> None:
    a = await platform.robot("a", "ack")
    await a.take()
    for number in range(60):
        await a.add("x", "PublisherConverter")
        await a.add("y", "SubscriberConverter")
        await a.connect("a/x", "a/y")
        items = [{"endpointTag": "a", "interfaceTag": tag} for tag in "xy"]
        await a.send({"type": "CN", "id": number, "data": {"removeInterfaces": items}})
    frames = await a.until(lambda frame: frame.get("id") == 59)
    assert not [frame for frame in frames if frame["type"] == "ER"]
    assert sorted(frame["id"] for frame in frames if "id" in frame) == list(range(60))


async def test_more_commands_than_may_be_under_way_are_refused(platform: Platform) -> None:
    a = await platform.robot("a", "ack")
    await a.take()
    items = [{"containerTag": "c", "nodeTag": "n"}] * 1001
    await a.send({"type": "CN", "id": 1, "data": {"removeNodes": items}})
    answer = await a.take()
    assert (answer["id"], answer["error"]["code"]) == (1, "limit_exceeded")
    await a.send({"type": "CN", "id": 2, "data": {"x": "y" * 5_000_000}})
    answer = await a.take()
    assert (answer["id"], answer["error"]["code"]) == (2, "limit_exceeded")
    await a.send({"type": "CN", "id": 3, "data": {}})
    assert (await a.take())["id"] == 3


@pytest.mark.parametrize("blob_first", [True, False])
async def test_a_blob_and_its_frame_in_either_order(platform: Platform, blob_first: bool) -> None:
    a, b = await pair(platform, BYTES)
    frame = {"type": "DM", "data": {"iTag": "out", "type": BYTES, "msgID": "n", "msg": {"data*": ID}}}
    blob = ID.encode() + bytes(range(256))
    await a.send(*((blob, json.dumps(frame)) if blob_first else (json.dumps(frame), blob)))
    got = await b.take()
    assert got["type"] == "DM", got
    await a.silent()


def image(content: str) -> Json:
    return {"type": "DM", "data": {"iTag": "out", "type": "std_msgs/String", "msgID": "n", "msg*": content}}


async def forwarders(platform: Platform, features: str = "", **more: Any) -> tuple[Robot, Robot]:
    a, b = await platform.robot("a", features), await platform.robot("b", features)
    if features:
        await a.take()
        await b.take()
    await a.add("out", "SubscriberForwarder", **more)
    await a.add("in", "PublisherForwarder", of="b", **more)
    await a.add("small", "SubscriberConverter")
    await a.add("little", "PublisherConverter", of="b")
    await a.connect("a/out", "b/in")
    await a.connect("a/small", "b/little")
    for robot in (a, b):
        await robot.take_all(2)
    return a, b


async def test_a_small_message_overtakes_the_parts_of_a_large_one(platform: Platform) -> None:
    a, b = await forwarders(platform, "parts")
    large = bytes(100) * 200_000
    parts = [
        ID.encode() + struct.pack("!II", offset, len(large)) + large[offset : offset + PART]
        for offset in range(0, len(large), PART)
    ]
    b.socket.transport.pause_reading()
    await a.send(image(ID), *parts)
    await a.data("small", {"data": "quick"})
    await a.silent()
    b.socket.transport.resume_reading()
    frames = await b.until(lambda frame: isinstance(frame, bytes) and len(frame) < PART + 40)
    kinds = ["part" if isinstance(frame, bytes) else frame["data"]["iTag"] for frame in frames]
    assert kinds[0] == "in"
    assert "little" in kinds[:-1], "before the last part"
    got = [frame for frame in frames if isinstance(frame, bytes)]
    assert b"".join(frame[40:] for frame in got) == large


async def test_a_slow_robot_keeps_the_newest_and_is_told_of_drops(platform: Platform) -> None:
    a, b = await forwarders(platform, "events", qos={"depth": 3})
    b.socket.transport.pause_reading()
    blob = bytes(1_000_000)
    for number in range(40):
        name = f"{number:032x}"
        await a.send(image(name), name.encode() + number.to_bytes(4, "big") + blob)
    await a.silent()
    assert platform.endpoint.sessions[f"{USER}/b"].outbox.backlog(b"") == 0
    b.socket.transport.resume_reading()
    frames = await b.until(lambda frame: isinstance(frame, dict) and frame["data"].get("topic") == "drops")
    drops = frames.pop()["data"]
    numbers = [int.from_bytes(frame[32:36], "big") for frame in frames if isinstance(frame, bytes)]
    assert numbers == sorted(numbers)
    assert numbers[-3:] == [37, 38, 39]
    assert drops == {"topic": "drops", "iTag": "in", "count": 40 - len(numbers), "where": "on the way to the robot"}


async def test_keep_all_slows_its_sender_and_loses_nothing(platform: Platform) -> None:
    a, b = await forwarders(platform, qos={"history": "keep_all"})
    c = await platform.robot("c")
    b.socket.transport.pause_reading()
    count, blob = 60, bytes(1_000_000)

    async def stream() -> None:
        for number in range(count):
            name = f"{number:032x}"
            await a.send(image(name), name.encode() + number.to_bytes(4, "big") + blob)

    sending = asyncio.create_task(stream())
    session = platform.endpoint.sessions[f"{USER}/a"]
    await eventually(lambda: session.socket._hold is not None)  # type: ignore[union-attr]
    held = sum(len(queue.waiting) for queue in platform.endpoint.sessions[f"{USER}/b"].outbox._queues.values())
    assert held < 20, "what waits is bounded"
    assert not sending.done(), "the sender waits"
    await c.silent()
    b.socket.transport.resume_reading()
    numbers = []
    for _ in range(count):
        await b.take()
        numbers.append(int.from_bytes((await b.take())[32:36], "big"))
    assert numbers == list(range(count))
    await sending


async def service(platform: Platform, features: str = "") -> tuple[Robot, Robot]:
    """`caller` asks through its interface `ask`, `server` answers at `serve`."""
    caller, server_ = await platform.robot("caller", features), await platform.robot("server", features)
    if features:
        await caller.take()
        await server_.take()
    await caller.add("ask", "ServiceProviderConverter", "std_srvs/SetBool")
    await caller.add("serve", "ServiceClientConverter", "std_srvs/SetBool", of="server")
    await caller.connect("caller/ask", "server/serve")
    await caller.take()
    await server_.take()
    return caller, server_


async def test_a_service_call_between_robots(platform: Platform) -> None:
    caller, provider = await service(platform)
    kind = "std_srvs/SetBool"
    for number in range(5):
        await caller.data("ask", {"data": True}, kind, f"call{number}")
    requests = await provider.take_all(5)
    assert len({request["data"]["msgID"] for request in requests}) == 5
    for number, request in reversed(list(enumerate(requests))):
        answer = {"success": True, "message": str(number)}
        await provider.data("serve", answer, kind, request["data"]["msgID"])
    answers = await caller.take_all(5)
    assert {(each["data"]["msgID"], each["data"]["msg"]["message"]) for each in answers} == {
        (f"call{number}", str(number)) for number in range(5)
    }
    await provider.data("serve", {"success": True}, kind, requests[0]["data"]["msgID"])
    assert "no call" in (await provider.take())["data"], "an answer counts once"


async def test_a_service_call_that_fails_is_told(make_platform: Any) -> None:
    platform = await make_platform(service_timeout=0.2)
    caller, provider = await service(platform, "ack")
    kind = "std_srvs/SetBool"

    async def failure() -> tuple[str, str]:
        answer = await caller.take()
        assert answer["type"] == "ER", answer
        assert answer["error"]["fields"]["iTag"] == "ask"
        return answer["error"]["fields"]["msgID"], answer["error"]["code"]

    await caller.data("ask", {"data": True}, kind, "late")
    late = (await provider.take())["data"]["msgID"]
    assert await failure() == ("late", "timed_out")
    await provider.data("serve", {"success": True}, kind, late)
    assert (await provider.take())["error"]["code"] == "not_connected"

    await caller.data("ask", {"data": True}, kind, "refused")
    name = (await provider.take())["data"]["msgID"]
    await provider.send({"type": "DM", "data": {"iTag": "serve", "type": kind, "msgID": name, "error": "no motor"}})
    assert (await failure())[0] == "refused"

    await caller.data("ask", {"data": True}, kind, "wrong")
    name = (await provider.take())["data"]["msgID"]
    await provider.data("serve", {"success": "perhaps"}, kind, name)
    assert (await failure()) == ("wrong", "conversion")
    assert (await provider.take())["error"]["code"] == "conversion"

    await caller.data("ask", {"data": True}, kind, "cut")
    await provider.take()
    await provider.send({"type": "CX", "data": {"disconnect": [{"tagA": "caller/ask", "tagB": "server/serve"}]}})
    frames = await caller.take_all(2)
    assert {frame["type"] for frame in frames} == {"ER", "ST"}
