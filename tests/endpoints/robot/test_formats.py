"""Formats of interfaces: ROS 1 in Forwarders, and users' converters, between robots of one endpoint."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import Any

import cbor2
import pytest

from converters import Recipe, TypeRegistry, Wire
from converters.custom_files import Description
from endpoints.robot.formats import Formats, WorkerCodec
from endpoints.robot.workers import Workers
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import StartFailed
from rce.protocol.names import parse_type
from tests.support.endpoints.platforms import Platform
from tests.support.endpoints.raw_robot import Robot

ID = "0a" * 16
HEADER = "std_msgs/Header"
ROS1 = struct.pack("<IIII", 9, 7, 5, 3) + b"map"
CDR = b"\0\1\0\0" + struct.pack("<III", 7, 5, 4) + b"map\0"
SHORT = """
from converters import Converter

class Short(Converter):
    name = "short"
    type = "std_msgs/Header"

    def from_robot(self, value):
        return {"frame_id": value.decode() if isinstance(value, bytes) else value["f"]}

    def to_robot(self, message):
        return message["frame_id"].upper().encode()
"""


async def robots(platform: Platform, features: str = "events") -> tuple[Robot, Robot]:
    a, b = await platform.robot("a", features), await platform.robot("b", "events")
    if features:
        await a.receive()
    await b.receive()
    return a, b


async def connect(a: Robot, b: Robot, sender: tuple[str, Any], receiver: tuple[str, Any]) -> None:
    """Connect an interface of `a` to one of `b`, each given by its kind and options."""
    await a.add("out", sender[0], HEADER, **sender[1])
    await a.add("in", receiver[0], HEADER, of="b", **receiver[1])
    await a.connect("a/out", "b/in")
    for robot in (a, b):
        await robot.receive_all(1)


async def send(robot: Robot, data: bytes) -> None:
    frame = {"type": "DM", "data": {"iTag": "out", "type": HEADER, "msgID": "n", "msg*": ID}}
    await robot.send(json.dumps(frame), ID.encode() + data)


async def test_ros1_bytes_of_a_forwarder_are_a_message_for_others(platform: Platform) -> None:
    a, b = await robots(platform)
    await connect(a, b, ("SubscriberForwarder", {"format": "ros1"}), ("PublisherConverter", {}))
    await send(a, ROS1)
    message = (await b.receive())["data"]["msg"]
    assert message == {"stamp": {"sec": 7, "nanosec": 5}, "frame_id": "map"}


async def test_message_reaches_a_forwarder_as_ros1_bytes(platform: Platform) -> None:
    a, b = await robots(platform)
    await connect(a, b, ("SubscriberForwarder", {"format": "cdr"}), ("PublisherForwarder", {"format": "ros1"}))
    await send(a, CDR)
    assert (await b.receive())["type"] == "DM"
    assert (await b.receive())[32:] == bytes(4) + ROS1[4:]


async def test_wrong_bytes_get_an_error_and_the_next_message_is_delivered(platform: Platform) -> None:
    a, b = await robots(platform, "")
    await connect(a, b, ("SubscriberForwarder", {"format": "ros1"}), ("PublisherConverter", {}))
    await send(a, CDR)
    error = await a.receive()
    assert error["type"] == "ER"
    assert "std_msgs/msg/Header" in error["data"]
    assert "not this type as ROS 1 serializes it" in error["data"]
    await send(a, ROS1)
    assert (await b.receive())["data"]["msg"]["frame_id"] == "map"


async def test_robots_without_features_can_have_ros1_by_default(platform: Platform) -> None:
    platform.endpoint._formats = Formats(original_forwarders="ros1")
    a, b = await robots(platform, "")
    await connect(a, b, ("SubscriberForwarder", {}), ("PublisherForwarder", {}))
    await send(a, ROS1)
    assert (await b.receive())["type"] == "DM"
    assert (await b.receive())[32 : 32 + len(CDR)] == CDR, "b has features, so its Forwarders have CDR"


async def test_robot_may_have_the_json_of_rosbridge(platform: Platform) -> None:
    a, b = await robots(platform)
    await connect(a, b, ("SubscriberForwarder", {}), ("PublisherConverter", {"format": "rosbridge"}))
    await send(a, CDR)
    message = (await b.receive())["data"]["msg"]
    assert message == {"stamp": {"sec": 7, "nanosec": 5}, "frame_id": "map"}


async def test_robot_may_have_cbor(platform: Platform) -> None:
    a, b = await robots(platform)
    await connect(a, b, ("SubscriberForwarder", {}), ("PublisherConverter", {"format": "cbor"}))
    await send(a, CDR)
    assert "msg*" in (await b.receive())["data"]
    assert cbor2.loads((await b.receive())[32:])["frame_id"] == "map"


async def test_large_message_is_converted_by_a_worker(platform: Platform) -> None:
    platform.endpoint.workers.close()
    platform.endpoint.workers = workers = Workers(1)
    await workers.encode("u", Recipe("std_msgs/msg/Bool", "png"), Wire(False, b"{}", {}))  # it runs now
    a, b = await robots(platform)
    await a.add("out", "SubscriberForwarder", "tf2_msgs/TFMessage", format="ros1")
    await a.add("in", "PublisherForwarder", "tf2_msgs/TFMessage", of="b", format="ros1")
    await a.connect("a/out", "b/in")
    for robot in (a, b):
        await robot.receive_all(1)
    data = struct.pack("<I", 1000) + 1000 * bytes(76)
    frame = {"iTag": "out", "type": "tf2_msgs/TFMessage", "msgID": "n", "msg*": ID}
    await a.send(json.dumps({"type": "DM", "data": frame}), ID.encode() + data)
    assert (await b.receive())["type"] == "DM"
    assert (await b.receive())[32:] == data


@pytest.mark.parametrize(
    ("kind", "type_name", "format", "reason"),
    [
        ("SubscriberForwarder", HEADER, "rso1", "no format 'rso1' for a SubscriberForwarder: it has cdr and ros1"),
        ("SubscriberConverter", HEADER, "ros1", "no format 'ros1' for std_msgs/Header.*png, jpeg, json"),
        ("SubscriberForwarder", "no/Such", "ros1", "unknown type no/msg/Such"),
    ],
)
async def test_format_that_does_not_fit_is_refused(
    platform: Platform, kind: str, type_name: str, format: str, reason: str
) -> None:
    a, _ = await robots(platform)
    await a.add("out", kind, type_name, format=format)
    error = await a.receive()
    assert error["type"] == "ER"
    assert re.search(reason, error["data"]), error


async def with_converters(platform: Platform, path: Path) -> None:
    platform.endpoint.workers.close()
    platform.endpoint.workers = Workers(1, str(path))
    await platform.endpoint.load_converters()


async def test_converter_of_a_user_serves_interfaces_that_name_it(platform: Platform, tmp_path: Path) -> None:
    file = tmp_path / "short.py"
    file.write_text(SHORT)
    await with_converters(platform, file)
    a, b = await robots(platform)
    await connect(a, b, ("SubscriberConverter", {"format": "short"}), ("PublisherConverter", {"format": "short"}))
    await a.add("plain", "PublisherConverter", HEADER, of="b")
    await a.connect("a/out", "b/plain")
    await b.receive_all(1)
    await send(a, b"odom")
    got = [await b.receive() for _ in range(3)]
    assert b"ODOM" in [each[32:] for each in got if isinstance(each, bytes)]
    (message,) = (each["data"]["msg"] for each in got if isinstance(each, dict) and "msg" in each["data"])
    assert message["frame_id"] == "odom"
    await a.data("out", {"g": 1}, HEADER)
    assert "short.py, line 9: KeyError" in (await a.receive())["data"]


async def test_broken_converter_fails_at_start(platform: Platform, tmp_path: Path) -> None:
    file = tmp_path / "broken.py"
    file.write_text("import nothing_like_it\n")
    with pytest.raises(StartFailed, match=r"broken.py, line 1: ModuleNotFoundError.*: correct it"):
        await with_converters(platform, file)


def test_default_converter_serves_interfaces_without_a_format() -> None:
    formats = Formats([Description("short", "std_msgs/msg/Header", default=True)])
    assert formats._custom(spec("png")) == "short"
    assert formats._custom(spec("json")) is None
    assert Formats([Description("short", "std_msgs/msg/Header", default=False)])._custom(spec("png")) is None


def spec(format: str) -> InterfaceSpec:
    return InterfaceSpec("1", "u/r", "tag", "SubscriberConverter", HEADER, "", format=format)


def test_codec_of_workers_converts_nothing_itself() -> None:
    codec = WorkerCodec(Recipe("a/msg/B", "png", converter="x"))
    assert not codec.encodes_fast(Wire(False, b"1", {}))
    assert not codec.decodes_fast(b"")
    with pytest.raises(NotImplementedError):
        codec.encode(Wire(False, b"1", {}))
    with pytest.raises(NotImplementedError):
        codec.decode(b"")


SCAN = {"header": {"frame_id": "laser"}, "angle_increment": 0.5, "ranges": [1.0, 2.0, 3.0]}
SMALLER = {"fields": ["header.frame_id", "ranges"], "decimate": {"step": 2}}


async def scans(platform: Platform, kind: str, **options: Any) -> Robot:
    """Return a robot that receives a scan of another one."""
    a, b = await robots(platform)
    await a.add("out", "SubscriberConverter", "sensor_msgs/LaserScan")
    await a.add("in", kind, "sensor_msgs/LaserScan", of="b", **options)
    await a.connect("a/out", "b/in")
    for robot in (a, b):
        await robot.receive_all(1)
    await a.data("out", SCAN, "sensor_msgs/LaserScan")
    return b


async def test_robot_gets_the_fields_and_beams_that_it_asked_for(platform: Platform) -> None:
    robot = await scans(platform, "PublisherConverter", delivery=SMALLER)
    assert (await robot.receive())["data"]["msg"] == {"header": {"frame_id": "laser"}, "ranges": [1.0, 3.0]}


async def test_cbor_and_cdr_have_the_fields_and_beams_that_were_asked_for(platform: Platform) -> None:
    robot = await scans(platform, "PublisherConverter", delivery=SMALLER, format="cbor")
    await robot.receive()
    found = cbor2.loads((await robot.receive())[32:])
    assert (found["header"], len(found)) == ({"frame_id": "laser"}, 2)


async def test_forwarder_gets_a_smaller_message_of_the_same_type(platform: Platform) -> None:
    robot = await scans(platform, "PublisherForwarder", delivery=SMALLER)
    await robot.receive()
    cdr = (await robot.receive())[32:]
    codec = TypeRegistry().message(parse_type("sensor_msgs/LaserScan"))
    found = json.loads(bytes(codec.decode(cdr).raw))
    assert (found["ranges"], found["header"]["frame_id"], found["angle_increment"]) == ([1.0, 3.0], "laser", 0.0)


async def test_wrong_fields_are_refused_when_the_interface_is_added(platform: Platform) -> None:
    a, _ = await robots(platform)
    for kind in ("PublisherConverter", "PublisherForwarder"):
        await a.add("in", kind, "sensor_msgs/LaserScan", delivery={"fields": ["range"]})
        error = (await a.receive())["error"]
        assert (error["code"], error["field"]) == ("invalid_request", "delivery.fields")
        assert "did you mean ranges?" in error["message"]
