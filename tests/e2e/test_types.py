"""ROS 2 messages of many types between robots and a node, and QoS of topics."""

from __future__ import annotations

import asyncio
import math
import struct
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
import pytest

from rce.client import Environment, Publisher, Robot, Subscriber, images
from rce.errors import TimedOut
from rce.protocol.messages import Qos
from tests.support.e2e.original_robot import OriginalRobot, configure, connection, interface, status
from tests.support.e2e.real_platform import RealPlatform
from tests.support.e2e.traffic import call

TYPES = [
    *("sensor_msgs/LaserScan", "sensor_msgs/Image", "sensor_msgs/PointCloud2", "tf2_msgs/TFMessage"),
    *("map_msgs/OccupancyGridUpdate", "std_msgs/String"),
]
KEEP_ALL = Qos(reliability="reliable", history="keep_all")
PICTURE = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)


class World(NamedTuple):
    robot: Robot
    environment: Environment


@pytest.fixture(scope="module")
async def world(platform: RealPlatform) -> AsyncIterator[World]:
    """A robot with an environment and the nodes in it."""
    async with platform.robot("typist") as robot, robot.environment("types") as environment:
        await asyncio.gather(
            environment.add_node("relay", "Relay", "relay.py", args=" ".join(TYPES)),
            environment.add_node("source", "Relay", "source.py"),
            environment.add_node("camera", "Test", "converterTest.py"),
        )
        yield World(robot, environment)


async def round_trip(world: World, type_name: str, value: Any, raw: bool = False, format: str = "png") -> Any:
    name = type_name.partition("/")[2]
    back = await world.environment.subscriber(f"/out_{name}", type_name, raw=raw, format=format)
    out = await world.environment.publisher(f"/in_{name}", type_name, raw=raw, format=format)
    try:
        return await first_answer(out, back, value)
    finally:
        await out.close()
        await back.close()


async def first_answer(out: Publisher, back: Subscriber, value: Any) -> Any:
    """Send a message until it comes back: answers of a node are lost until DDS discovery has finished."""
    async with asyncio.timeout(60):
        while True:
            await out.publish(value)
            with suppress(TimedOut):
                return await back.get(1)


async def test_scan_with_infinity_and_nan(world: World) -> None:
    scan: dict[str, Any] = {
        "header": {"stamp": {"sec": 1_700_000_000, "nanosec": 123_456_789}, "frame_id": "laser"},
        "angle_min": -1.5,
        "angle_max": 1.5,
        "angle_increment": 0.5,
        "time_increment": 0.0,
        "scan_time": 0.25,
        "range_min": 0.0,
        "range_max": math.inf,
        "ranges": [0.5, math.inf, -math.inf, math.nan, 4.0],
        "intensities": [],
    }
    back = await round_trip(world, "sensor_msgs/LaserScan", scan)
    assert math.isnan(back["ranges"][3])
    back["ranges"][3] = scan["ranges"][3]  # NaN is not equal to itself
    assert back == scan


async def test_point_cloud_as_json(world: World) -> None:
    points = np.random.default_rng(1).random((1000, 3), np.float32)
    fields = [{"name": name, "offset": 4 * at, "datatype": 7, "count": 1} for at, name in enumerate("xyz")]
    cloud = {"height": 1, "width": 1000, "fields": fields, "point_step": 12, "row_step": 12000, "is_dense": True}
    back = await round_trip(world, "sensor_msgs/PointCloud2", {**cloud, "data": points.view(np.uint8).ravel()})
    import base64

    assert (np.frombuffer(base64.b64decode(back["data"]), np.float32) == points.ravel()).all()
    assert {key: back[key] for key in cloud} == cloud


async def test_point_cloud_as_cdr(world: World) -> None:
    """CDR through a Forwarder of the robot and the node's objects."""
    data = bytes(range(256)) * 4
    cdr = b"\x00\x01\x00\x00" + struct.pack("<iII4sIIIB3xIII", 7, 8, 4, b"map\0", 1, 1024, 0, 0, 1, 1024, 1024)
    cdr += data + b"\x01"
    assert (await round_trip(world, "sensor_msgs/PointCloud2", cdr, raw=True))[: len(cdr)] == cdr


async def test_scan_as_ros1_bytes(world: World) -> None:
    """A message of ROS 1 reaches a node of ROS 2, and comes back in the form of ROS 1."""
    header = struct.pack("<III", 0, 1_700_000_000, 5) + struct.pack("<I5s", 5, b"laser")
    scan = header + struct.pack("<7f", -1.5, 1.5, 0.5, 0, 0.25, 0, 30) + struct.pack("<I5fI", 5, 1, 2, 3, 4, 5, 0)
    assert await round_trip(world, "sensor_msgs/LaserScan", scan, raw=True, format="ros1") == scan


async def test_transforms_and_map_updates(world: World) -> None:
    """Types that the wheels of ROS 2 do not have."""
    rotation = {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}
    transform = {
        "header": {"stamp": {"sec": 5, "nanosec": 6}, "frame_id": "map"},
        "child_frame_id": "odom",
        "transform": {"translation": {"x": 1.0, "y": 2.0, "z": 3.0}, "rotation": rotation},
    }
    value: dict[str, Any] = {"transforms": [transform, transform]}
    assert await round_trip(world, "tf2_msgs/TFMessage", value) == value
    value = {"header": transform["header"], "x": 1, "y": -2, "width": 3, "height": 1, "data": [0, -1, 100]}
    assert await round_trip(world, "map_msgs/OccupancyGridUpdate", value) == value


@pytest.mark.parametrize("format", ["png", "jpeg", "json"])
async def test_image(world: World, format: str) -> None:
    """Send PNG and receive each format."""
    robot, environment = world
    out = await environment.publisher("/in_Image", "sensor_msgs/Image")
    await robot.add_interface("types", f"image_{format}", "SubscriberInterface", "sensor_msgs/Image", addr="/out_Image")
    back = await robot.subscriber(f"image_{format}", "sensor_msgs/Image", to=f"types/image_{format}", format=format)
    got = await first_answer(out, back, images.encode(PICTURE))
    if format == "json":
        assert (got["height"], got["width"], got["step"]) == (48, 64, 192)
        assert got["encoding"] in ("rgb8", "bgr8")
    else:
        seen = images.decode(got)
        assert seen.shape == PICTURE.shape
        assert format == "jpeg" or (seen == PICTURE).all()
    await out.close()
    await back.close()
    await robot.remove_interface("types", f"image_{format}")


async def test_service_of_a_user_defined_type(world: World) -> None:
    """The Robot endpoint gets the definition of the type from the environment."""
    service = await world.environment.service_client("/converterTest", "Test/ConverterTest")
    answer = await call(service, {"a": 40, "b": 2})
    assert answer["sum"] == 42
    picture = images.decode(answer["img"])
    assert picture.shape == (8, 16, 3)
    assert picture[3, 5].tolist() == [50, 30, 255]


async def test_late_robot_gets_latched_map(platform: RealPlatform, world: World) -> None:
    async def look(name: str) -> list[int]:
        async with platform.robot(name) as robot:
            seen = await robot.environment("types").subscriber("/map", "nav_msgs/OccupancyGrid")
            data: list[int] = (await seen.get(60))["data"]
            return data

    for name in ("first", "late"):
        assert await look(name) == [0, 100, -1, 50]


async def test_best_effort_topic(world: World) -> None:
    """An interface without QoS accepts what the publisher offers."""
    numbers = await world.environment.subscriber("/fast", "std_msgs/Int32", depth=1000)
    got = [(await numbers.get(60))["data"] for _ in range(20)]
    assert got == sorted(set(got))
    await numbers.close()


async def until_discovered(go: Publisher, robot: OriginalRobot) -> None:
    """Ask for single texts until one arrives: they are lost until DDS discovery has finished."""
    async with asyncio.timeout(60):
        while True:
            await go.publish({"data": 1})
            with suppress(AssertionError):
                await robot.take_data("texts", 1)
                return


async def number_of_text(robot: OriginalRobot) -> int:
    return int((await robot.take_data("texts"))["msg"]["data"].split()[0])


async def test_keep_all_loses_nothing_with_a_slow_robot(platform: RealPlatform, world: World) -> None:
    """A robot does not read for a while: 15 MB are more than all buffers up to the node hold."""
    count = 1500
    qos = {"reliability": "reliable", "history": "keep_all"}
    go = await world.environment.publisher("/go", "std_msgs/Int32")
    async with OriginalRobot(platform.url, "slow") as slow:
        await slow.send(
            interface("types", "texts", "SubscriberInterface", "std_msgs/String", addr="/texts", qos=qos),
            interface("slow", "texts", "PublisherConverter", "std_msgs/String", qos=qos),
            connection("types/texts", "slow/texts"),
        )
        await slow.take_frame(status("texts", True))
        await until_discovered(go, slow)
        slow.reading.clear()
        await go.publish({"data": count})
        await slow.wait_until_stalled()
        slow.reading.set()
        got = [await number_of_text(slow)]
        while got[-1] != count - 1:
            got.append(await number_of_text(slow))
        assert got[-count:] == list(range(count))
        assert set(got[:-count]) <= {0}  # further texts of the discovery
        await slow.send(configure("removeInterfaces", endpointTag="types", interfaceTag="texts"))
        await slow.take_frame(status("texts", False))
    await go.close()


async def test_environments_are_separated(platform: RealPlatform, world: World) -> None:
    async with world.robot.environment("other") as other:
        await other.add_node("relay", "Relay", "relay.py", args="std_msgs/String")
        heard = {env.tag: await env.subscriber("/out_String", "std_msgs/String") for env in (world.environment, other)}
        for environment in (world.environment, other):
            out = await environment.publisher("/in_String", "std_msgs/String")
            await first_answer(out, heard[environment.tag], {"data": f"{environment.tag} discovered"})
            for number in range(3):
                await out.publish({"data": f"{environment.tag} {number}"})
        for tag, subscriber in heard.items():
            got = [(await subscriber.get(60))["data"]]
            while got[-1] != f"{tag} 2":
                got.append((await subscriber.get(60))["data"])
            assert got[-3:] == [f"{tag} {number}" for number in range(3)]
            assert set(got[:-3]) <= {f"{tag} discovered"}
            assert subscriber.dropped == 0
