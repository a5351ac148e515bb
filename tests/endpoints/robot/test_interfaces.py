"""Data messages, blobs and service calls through the interfaces of robots."""

from __future__ import annotations

import asyncio
import json
import struct
import uuid
from typing import Any

import cv2
import numpy as np
import pytest

from endpoints.data.frames import Message
from endpoints.data.link import Link
from endpoints.robot.intake import MAX_CONVERSIONS
from endpoints.robot.interfaces import Publisher
from rce.net.budget import INTERFACE, OVERHEAD
from rce.protocol.blobs import PART
from tests.support.endpoints.platforms import Platform, pair
from tests.support.endpoints.raw_robot import USER, Json, Robot, dm, eventually

ID, OTHER = "0a" * 16, "0b" * 16
BYTES = "std_msgs/UInt8MultiArray"


@pytest.mark.parametrize("blob_first", [True, False])
async def test_blob_and_frame_come_in_any_order(platform: Platform, blob_first: bool) -> None:
    a, b = await pair(platform, BYTES)
    frame = {"type": "DM", "data": {"iTag": "out", "type": BYTES, "msgID": "n", "msg": {"data*": ID}}}
    blob = ID.encode() + bytes(range(256))
    await a.send(*((blob, json.dumps(frame)) if blob_first else (json.dumps(frame), blob)))
    got = await b.receive()
    assert got["type"] == "DM", got
    await a.expect_silence()


async def test_messages_without_an_id_have_one_each_within_the_platform(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b = await pair(platform, BYTES)
    ids: list[str] = []
    receive = Publisher.receive

    def record(self: Publisher, message: Message, link: Link) -> None:
        ids.append(message.msg_id)
        receive(self, message, link)

    monkeypatch.setattr(Publisher, "receive", record)
    for id in ("nil", "nil", "nil-1"):
        await a.send(json.dumps(dm("out", {"data": []}, BYTES, id)))
    assert [each["data"]["msgID"] for each in await b.receive_all(3)] == ["nil", "nil", "nil-1"], "its own stays"
    assert ids == ["nil-1", "nil-2", "nil-1"]


HEADER = "std_msgs/Header"


async def test_robot_without_features_reads_and_writes_json_as_with_the_original(platform: Platform) -> None:
    old, new = await platform.robot("old"), await platform.robot("new", "events")
    await new.receive()
    for name in ("old", "new"):
        await old.add("out", "SubscriberConverter", HEADER, of=name)
        await old.add("in", "PublisherConverter", HEADER, of=name)
    await old.connect("old/out", "new/in")
    await old.connect("new/out", "old/in")
    for robot in (old, new):
        await robot.receive_all(2)
    await new.data("out", {"stamp": {"sec": 1384510830, "nanosec": 5000}}, HEADER)
    assert (await old.receive())["data"]["msg"]["stamp"] == "2013-11-15T10:20:30.000005"
    await old.data("out", {"stamp": {"sec": "7", "nanosec": 1.5}}, HEADER)
    assert (await new.receive())["data"]["msg"]["stamp"] == {"sec": 7, "nanosec": 1}
    await new.data("out", {"stamp": {"sec": "7"}}, HEADER)
    assert "sec" in (await new.receive())["error"]["field"]


def image(content: str) -> Json:
    return {"type": "DM", "data": {"iTag": "out", "type": "std_msgs/String", "msgID": "n", "msg*": content}}


async def forwarders(platform: Platform, features: str = "", **more: Any) -> tuple[Robot, Robot]:
    a, b = await platform.robot("a", features), await platform.robot("b", features)
    if features:
        await a.receive()
        await b.receive()
    await a.add("out", "SubscriberForwarder", **more)
    await a.add("in", "PublisherForwarder", of="b", **more)
    await a.add("small", "SubscriberConverter")
    await a.add("little", "PublisherConverter", of="b")
    await a.connect("a/out", "b/in")
    await a.connect("a/small", "b/little")
    for robot in (a, b):
        await robot.receive_all(2)
    return a, b


@pytest.mark.parametrize("blob", [b"\x05\0\0\0hello", b"\x78\x9c\x01\0\0", b""])
async def test_forwarded_bytes_that_are_not_cdr_are_reported_once(platform: Platform, blob: bytes) -> None:
    a, b = await forwarders(platform)
    for _ in range(2):
        await a.send(image(ID), ID.encode() + blob)
        assert (await b.receive())["type"] == "DM"
        assert (await b.receive())[32:] == blob, "the Forwarder of another robot gets them in any case"
    error = await a.receive()
    assert error["type"] == "ER"
    assert "interface out: the blob is not CDR" in error["data"]
    await a.expect_silence()


async def test_small_message_overtakes_parts_of_large_one(platform: Platform) -> None:
    a, b = await forwarders(platform, "parts")
    large = bytes(100) * 200_000
    parts = [
        ID.encode() + struct.pack("!II", offset, len(large)) + large[offset : offset + PART]
        for offset in range(0, len(large), PART)
    ]
    b.socket.transport.pause_reading()
    await a.send(image(ID), *parts)
    await a.data("small", {"data": "quick"})
    await a.expect_silence()
    b.socket.transport.resume_reading()
    frames = await b.until(lambda frame: isinstance(frame, bytes) and len(frame) < PART + 40)
    kinds = ["part" if isinstance(frame, bytes) else frame["data"]["iTag"] for frame in frames]
    assert kinds[0] == "in"
    assert "little" in kinds[:-1], "before the last part"
    got = [frame for frame in frames if isinstance(frame, bytes)]
    assert b"".join(frame[40:] for frame in got) == large


async def test_slow_robot_gets_newest_messages_and_report_of_drops(platform: Platform) -> None:
    a, b = await forwarders(platform, "events", qos={"depth": 3})
    b.socket.transport.pause_reading()
    blob = bytes(1_000_000)
    for number in range(40):
        name = f"{number:032x}"
        await a.send(image(name), name.encode() + number.to_bytes(4, "big") + blob)
    await a.expect_silence()
    assert platform.endpoint.sessions[f"{USER}/b"].outbox.backlog(b"") < 20, "there is no report for each message"
    b.socket.transport.resume_reading()
    numbers: list[int] = []
    lost = 0

    def is_complete(frame: Any) -> bool:
        nonlocal lost
        if isinstance(frame, bytes):
            numbers.append(int.from_bytes(frame[32:36], "big"))
        elif frame["data"].get("topic") == "drops":  # so far
            lost = frame["data"]["count"]
            assert frame["data"] == {"topic": "drops", "iTag": "in", "count": lost, "where": "on the way to the robot"}
        return len(numbers) + lost == 40

    await b.until(is_complete)
    assert lost > 0
    assert numbers == sorted(numbers)
    assert numbers[-3:] == [37, 38, 39]


async def test_deep_queue_of_slow_robot_is_bounded_by_bytes(platform: Platform) -> None:
    a, b = await forwarders(platform, "parts", qos={"depth": 10_000})
    b.socket.transport.pause_reading()
    part = bytes(PART - 40)
    size = 4 * len(part)
    for number in range(30):
        name = f"{number:032x}".encode()
        await a.send(
            image(name.decode()), *(name + struct.pack("!II", each * len(part), size) + part for each in range(4))
        )
    await a.expect_silence()
    session = platform.endpoint.sessions[f"{USER}/b"]
    assert session.budget is not None
    await eventually(lambda: sum(each.dropped for each in platform.endpoint.switchboard.interfaces.values()) > 0)
    assert INTERFACE // 2 < session.budget.used < INTERFACE + 2 * size


async def test_robot_without_events_gets_summaries_of_all_drops(platform: Platform) -> None:
    a, b = await forwarders(platform, qos={"depth": 3})
    b.socket.transport.pause_reading()
    blob = bytes(1_000_000)
    for number in range(20):
        name = f"{number:032x}"
        await a.send(image(name), name.encode() + blob)
    await a.expect_silence()
    b.socket.transport.resume_reading()
    got = lost = 0

    def is_complete(frame: Any) -> bool:
        nonlocal got, lost
        if isinstance(frame, bytes):
            got += 1
        elif frame["type"] == "ER":
            assert frame.keys() == {"type", "data"}
            lost = int(frame["data"].partition("in: ")[2].split()[0])  # so far
            assert "on the way to the robot" in frame["data"]
        return got + lost == 20

    await b.until(is_complete)
    assert lost > 0
    await b.expect_silence()


async def test_keep_all_slows_down_sender_and_drops_nothing(platform: Platform) -> None:
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
    await eventually(lambda: bool(session.socket._pauses))  # type: ignore[union-attr]
    held = sum(len(queue.waiting) for queue in platform.endpoint.sessions[f"{USER}/b"].outbox._queues.values())
    assert held < 20, "the queue is bounded"
    assert not sending.done(), "the sender has to wait"
    await c.expect_silence()
    b.socket.transport.resume_reading()
    numbers = []
    for _ in range(count):
        await b.receive()
        numbers.append(int.from_bytes((await b.receive())[32:36], "big"))
    assert numbers == list(range(count))
    await sending


IMAGE = "sensor_msgs/Image"


def png(side: int) -> bytes:
    """Return a picture that is small as a file and takes long to convert."""
    written, data = cv2.imencode(".png", np.zeros((side, side), np.uint8))
    assert written
    return data.tobytes()


async def send_picture(robot: Robot, tag: str, data: bytes, msg_id: str = "n") -> None:
    name = uuid.uuid4().hex
    frame = {"type": "DM", "data": {"iTag": tag, "type": IMAGE, "msgID": msg_id, "msg*": name}}
    await robot.send(frame, name.encode() + data)


async def test_large_pictures_are_converted_outside_of_the_event_loop_and_stay_in_order(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b = await pair(platform, IMAGE)
    pictures = {side: png(side) for side in (3000, 8, 1500)}
    converted_here: list[tuple[int, ...]] = []
    decode, encode = cv2.imdecode, cv2.imencode

    def watched_decode(*arguments: Any) -> Any:
        found: Any = decode(*arguments)
        converted_here.append(found.shape)
        return found

    def watched_encode(kind: str, pixels: np.ndarray[Any, Any]) -> Any:
        converted_here.append(pixels.shape)
        return encode(kind, pixels)

    monkeypatch.setattr(cv2, "imdecode", watched_decode)
    monkeypatch.setattr(cv2, "imencode", watched_encode)
    for side, data in pictures.items():
        await send_picture(a, "out", data, str(side))
    frames = []
    for _ in pictures:
        frames.append(await b.receive())
        await b.receive()
    assert [frame["data"]["msgID"] for frame in frames] == ["3000", "8", "1500"]
    assert set(converted_here) <= {(8, 8)}, "the small one may be converted in place"


@pytest.mark.parametrize("features", ["", "ack"])
async def test_picture_for_nobody_is_not_converted(
    platform: Platform, monkeypatch: pytest.MonkeyPatch, features: str
) -> None:
    monkeypatch.setattr(platform.endpoint.workers, "encode", None)
    a = await platform.robot("a", features)
    if features:
        await a.receive()
    await a.add("out", "SubscriberConverter", IMAGE)
    await eventually(lambda: "out" in platform.endpoint.sessions[f"{USER}/a"].interfaces)
    await send_picture(a, "out", png(8))
    if features:
        assert (await a.receive())["error"]["code"] == "not_connected"
    await a.expect_silence()


async def test_picture_that_cannot_be_converted_is_reported_with_its_id(platform: Platform) -> None:
    a, _ = await pair(platform, IMAGE, "ack")
    name = uuid.uuid4().hex
    frame = {"type": "DM", "id": 3, "data": {"iTag": "out", "type": IMAGE, "msgID": "n", "msg*": name}}
    await a.send(frame, name.encode() + b"no picture")
    answer = await a.receive()
    assert (answer["id"], answer["error"]["code"], answer["error"]["fields"]["msgID"]) == (3, "conversion", "n")
    name = uuid.uuid4().hex
    frame["data"]["msg*"] = name  # type: ignore[index]
    await a.send(frame, name.encode() + png(8))
    assert await a.receive() == {"type": "ST", "id": 3, "data": {"topic": "ack"}}


async def test_reading_pauses_while_many_pictures_are_converted(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b = await pair(platform, IMAGE)
    begun, go = 0, asyncio.Event()
    encode = platform.endpoint.workers.encode

    async def slow(*arguments: Any) -> Any:
        nonlocal begun
        begun += 1
        await go.wait()
        return await encode(*arguments)

    monkeypatch.setattr(platform.endpoint.workers, "encode", slow)
    for number in range(MAX_CONVERSIONS + 5):
        await send_picture(a, "out", png(8), str(number))
    session = platform.endpoint.sessions[f"{USER}/a"]
    await eventually(lambda: begun == MAX_CONVERSIONS)
    assert session.socket._pauses  # type: ignore[union-attr]
    go.set()
    numbers = []
    for _ in range(MAX_CONVERSIONS + 5):
        numbers.append((await b.receive())["data"]["msgID"])
        await b.receive()
    assert numbers == [str(number) for number in range(MAX_CONVERSIONS + 5)]


@pytest.mark.parametrize("size", [3000, 200_000])
async def test_message_too_large_for_its_receiver_is_reported_and_the_next_is_delivered(
    platform: Platform, size: int
) -> None:
    """Short messages are converted in place and long ones by a worker."""
    a, b = await pair(platform, "std_msgs/Float64MultiArray", "events")
    platform.endpoint.sessions[f"{USER}/b"].limit = size
    kind = "std_msgs/Float64MultiArray"
    await a.data("out", {"data": [1 / 3] * (size // 10)}, kind, "large")
    await a.data("out", {"data": [1]}, kind, "small")
    answer = await a.receive()
    assert (answer["type"], answer["error"]["code"]) == ("ER", "limit_exceeded")
    assert (answer["error"]["fields"]["iTag"], answer["error"]["fields"]["msgID"]) == ("out", "large")
    frames = sorted(await b.receive_all(2), key=lambda frame: frame["type"])  # the report comes after a second
    assert frames[0]["data"]["msgID"] == "small"
    assert frames[1]["data"] == {"topic": "drops", "iTag": "in", "count": 1, "where": "on the way to the robot"}


async def test_large_blob_is_delivered_in_parts_where_granted(platform: Platform) -> None:
    a, b = await forwarders(platform, "parts")
    platform.endpoint.sessions[f"{USER}/b"].limit = 1000
    await a.send(image(ID), ID.encode() + struct.pack("!II", 0, 2000) + bytes(2000))
    assert (await b.receive())["data"]["iTag"] == "in"
    assert len(await b.receive()) == 40 + 2000


async def test_change_of_the_pace_drops_what_waits(platform: Platform) -> None:
    a, _ = await pair(platform)
    interface = platform.endpoint.sessions[f"{USER}/b"].interfaces["in"]
    assert isinstance(interface, Publisher)
    interface.set_pace(3600.0, 5)
    for number in range(4):
        await a.data("out", {"data": str(number)})
    await eventually(lambda: interface.budget.used > 3 * OVERHEAD)
    interface.set_pace(3600.0, 4)
    assert interface.budget.used == 0


async def test_pace_of_less_than_a_millisecond_is_none(platform: Platform) -> None:
    a, b = await pair(platform)
    interface = platform.endpoint.sessions[f"{USER}/b"].interfaces["in"]
    assert isinstance(interface, Publisher)
    interface.set_pace(1e-311, 0)
    await a.data("out", {"data": "hi"})
    assert await b.receive() == dm("in", {"data": "hi"})


async def with_delivery(platform: Platform, **delivery: Any) -> tuple[Robot, Robot]:
    """Return two robots; `little` of b has a delivery."""
    a, b = await platform.robot("a", "events,parts"), await platform.robot("b", "events,parts")
    await a.receive()
    await b.receive()
    await a.add("out", "SubscriberForwarder")
    await a.add("in", "PublisherForwarder", of="b")
    await a.add("small", "SubscriberConverter")
    await a.add("little", "PublisherConverter", of="b", delivery=delivery)
    await a.connect("a/out", "b/in")
    await a.connect("a/small", "b/little")
    for robot in (a, b):
        await robot.receive_all(2)
    return a, b


async def test_message_that_is_too_old_when_its_turn_comes_is_dropped_and_reported(platform: Platform) -> None:
    a, b = await with_delivery(platform, maxAge=1e-9)
    await a.data("small", {"data": "late"})
    assert (await b.receive())["data"] == {
        "topic": "drops", "iTag": "little", "count": 1, "where": "on the way to the robot",
    }  # fmt: skip


async def test_messages_beyond_the_rate_are_dropped(platform: Platform) -> None:
    a, b = await with_delivery(platform, rate=0.001)
    for number in range(3):
        await a.data("small", {"data": str(number)})
    assert (await b.receive())["data"]["msg"] == {"data": "0"}
    await b.expect_silence()


async def test_messages_of_high_priority_are_sent_before_all_parts_of_a_large_one(platform: Platform) -> None:
    a, b = await with_delivery(platform, priority="high")
    b.socket.transport.pause_reading()
    large = bytes(20_000_000)
    await a.send(image(ID), *(
        ID.encode() + struct.pack("!II", offset, len(large)) + large[offset : offset + PART]
        for offset in range(0, len(large), PART)
    ))  # fmt: skip
    for number in range(20):
        await a.data("small", {"data": str(number)})
    await a.expect_silence()
    b.socket.transport.resume_reading()
    frames = await b.until(lambda frame: isinstance(frame, bytes) and len(frame) < PART + 40)
    small = [index for index, frame in enumerate(frames) if not isinstance(frame, bytes)][1:]
    assert len(small) == 20
    assert small == list(range(small[0], small[0] + 20)), "no part is between them"
