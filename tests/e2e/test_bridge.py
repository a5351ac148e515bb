"""Two robots that run ROS 2 in domains of their own, each with a bridge to the same environment."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import sys
import threading
from array import array
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import msgspec
import pytest
import rclpy
from domains import domain
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import OccupancyGrid
from prometheus_client.parser import text_string_to_metric_families as parsed
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from real_platform import USER, RealPlatform, until
from sensor_msgs.msg import Image, LaserScan
from std_msgs.msg import String
from std_srvs.srv import Trigger

from provisioning.typesupport import build, shipped
from rce.mapping.recordings.bags import Bag
from rce.mapping.scans import Scan
from rce.mapping.simulation import simulate

ROBOTS = ("rover", "lander")


class RobotRos:
    """The nodes of one robot, in its ROS domain: what was heard on each topic."""

    def __init__(self, number: int) -> None:
        self.heard: dict[str, list[Any]] = {}
        self._context = Context()
        rclpy.init(context=self._context, domain_id=number, args=[])
        self.node = rclpy.create_node("robot", context=self._context, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)

    def spin(self) -> None:
        """To be called when all entities are there: rclpy does not like them to be made while another thread spins."""
        self._thread.start()

    def listen(self, topic: str, kind: type[Any], qos: QoSProfile | int = 10) -> list[Any]:
        heard = self.heard[topic] = []
        self.node.create_subscription(kind, topic, heard.append, qos)
        return heard

    def talk(self, topic: str, kind: type[Any], make: Callable[[], Any], seconds: float = 0.05) -> None:
        out = self.node.create_publisher(kind, topic, 10)
        self.node.create_timer(seconds, lambda: out.publish(make()))

    def stop(self) -> None:
        self._executor.shutdown()
        if self._thread.ident is not None:
            self._thread.join(5)
        self.node.destroy_node()
        self._context.try_shutdown()


@pytest.fixture
def robots(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, RobotRos]]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.syspath_prepend(build(shipped()).prefix / "python")
    found = {name: RobotRos(domain(name)) for name in ROBOTS}
    yield found
    for robot in found.values():
        robot.stop()


@asynccontextmanager
async def bridge(platform: RealPlatform, robot: str, directory: Path, **config: Any) -> AsyncIterator[Path]:
    """A bridge as a process of its own; gives its log. It must end well."""
    typesupport = build(shipped())
    file = directory / f"{robot}.json"
    whole = {"url": platform.url, "user": USER, "robot": robot, "password": USER, **config}
    file.write_bytes(msgspec.json.encode(whole))
    log = directory / f"{robot}.log"
    words = [sys.executable, "-P", "-m", "endpoints.bridge", str(file), "--typesupport", str(typesupport.prefix)]
    variables = {"ROS_DOMAIN_ID": str(domain(robot)), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with log.open("w") as output:
        process = await asyncio.create_subprocess_exec(*words, env=os.environ | variables, stderr=output)
    try:
        yield log
    finally:
        if process.returncode is None:
            process.send_signal(signal.SIGINT)
        status = await asyncio.wait_for(process.wait(), 20)
    assert status == 0, log.read_text()


async def test_topics_services_and_transforms_of_two_robots(
    platform: RealPlatform, robots: dict[str, RobotRos], tmp_path: Path
) -> None:
    rover, lander = robots["rover"], robots["lander"]
    rover.talk("/say", String, lambda: String(data="hello"))
    rover.talk("/tf", _tf(), lambda: _tf()(transforms=[_transform("base_link"), _transform("wheel")]), 0.02)
    rover.talk("/camera", Image, _image, 0.2)
    lander.node.create_service(Trigger, "/land", lambda _, response: _answered(response))
    said = lander.listen("/from_rover", String)
    seen = lander.listen("/camera", Image)
    frames = lander.listen("/tf", _tf())
    client = rover.node.create_client(Trigger, "/land")
    rover.spin()
    lander.spin()
    # An environment does not hear itself: what one robot sends there reaches another by a node.
    relay = "std_msgs/String sensor_msgs/Image tf2_msgs/TFMessage --ros-args -r in_String:=say -r in_Image:=camera"
    node = {"tag": "relay", "pkg": "Relay", "exe": "relay.py", "args": f"{relay} -r in_TFMessage:=tf"}
    environment = {"tag": "sky", "create": {}, "nodes": [node]}
    rover_sends = {
        "topics": [
            {"topic": "/say", "type": "std_msgs/String", "rate": 10},
            {"topic": "/camera", "type": "sensor_msgs/Image", "format": "jpeg"},
        ],
        "tf": {"frames": ["base_link"], "rate": 20},
    }
    rover_gets = {"services": [{"service": "/land", "type": "std_srvs/Trigger"}]}
    lander_sends = {"services": [{"service": "/land", "type": "std_srvs/Trigger"}]}
    lander_gets = {
        "topics": [
            {"topic": "/out_String", "type": "std_msgs/String", "to": "/from_rover"},
            {"topic": "/out_Image", "type": "sensor_msgs/Image", "to": "/camera", "format": "jpeg"},
            {"topic": "/out_TFMessage", "type": "tf2_msgs/TFMessage", "to": "/tf"},
        ],
    }
    async with bridge(
        platform, "rover", tmp_path, environment=environment, send=rover_sends, receive=rover_gets, compress=True
    ) as log:
        await until(lambda: "all is carried" in log.read_text(), 30)
        with socket.create_server(("127.0.0.1", 0)) as server:
            port = server.getsockname()[1]
        async with bridge(
            platform,
            "lander",
            tmp_path,
            environment={"tag": "sky"},
            send=lander_sends,
            receive=lander_gets,
            metrics=port,
        ):
            await until(lambda: said and seen and frames, 30)
            assert said[0].data == "hello"
            assert (seen[0].width, seen[0].height, seen[0].encoding) == (64, 48, "rgb8")
            assert {each.child_frame_id for message in frames for each in message.transforms} == {"base_link"}
            await until(client.service_is_ready, 20)
            call = client.call_async(Trigger.Request())
            await until(call.done, 20)
            assert call.result().message == "landed"
            told = await asyncio.to_thread(lambda: urlopen(f"http://127.0.0.1:{port}/metrics").read().decode())
            samples = {each.name: each for family in parsed(told) for each in family.samples if "received" in str(each)}
            assert samples["rce_messages_total"].value >= len(said) + len(seen)
            assert samples["rce_bytes_total"].value > 64 * 48
            assert 'rce_info{role="bridge"' in told
    async with platform.robot("later") as robot:
        await robot.create_environment("sky")  # it was destroyed at the bridge's end
        await robot.destroy_environment("sky")


async def test_requests_of_nodes(platform: RealPlatform, robots: dict[str, RobotRos], tmp_path: Path) -> None:
    rover = robots["rover"]
    rover.talk("/say", String, lambda: String(data="hello"))
    answers = rover.listen("/cloud_response", String)
    heard = rover.listen("/heard", String)
    maps = rover.listen("/cloud_map", OccupancyGrid, QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    scans = iter(simulate().records)
    rover.talk("/scan", LaserScan, lambda: _scan(next(scans)))
    ask = rover.node.create_publisher(String, "/cloud_request", 10)
    config: dict[str, Any] = {
        "environment": {"tag": "land", "create": {}, "nodes": [{"tag": "e", "pkg": "rce_demo", "exe": "echo.py"}]},
        "offload": False,
        "send": {"topics": [{"topic": "/say", "type": "std_msgs/String"}]},
        "receive": {"topics": [{"topic": "/heard", "type": "std_msgs/String"}]},
        "requests": {
            "on": {"action": "start"},
            "off": {"action": "stop"},
            "record": {
                "action": "record",
                "topics": {"/scan": "sensor_msgs/LaserScan"},
                "directory": str(tmp_path / "bags"),
            },
            "end": {"action": "end_record"},
            "map": {"action": "build_map", "out": str(tmp_path / "map")},
        },
    }

    services = {name: rover.node.create_client(Trigger, f"/cloud/{name}") for name in config["requests"]}
    rover.spin()

    async def answered(name: str, state: str) -> str:
        def find() -> list[str]:
            said = [json.loads(each.data) for each in answers]
            return [each.get("message", "") for each in said if (each["id"], each["state"]) == (name, state)]

        await until(find, 150, f"{name} {state}")
        return find()[0]

    async with bridge(platform, "rover", tmp_path, **config):
        await until(services["off"].service_is_ready, 20)
        await until(lambda: ask.get_subscription_count(), 20)
        ask.publish(String(data="on"))
        await answered("on", "done")
        await until(lambda: heard, 20)
        ask.publish(String(data="dance"))
        assert "there are: on, off, record, end, map" in await answered("dance", "failed")
        call = services["record"].call_async(Trigger.Request())
        await until(call.done, 20)
        assert call.result().success
        await asyncio.sleep(2)
        call = services["end"].call_async(Trigger.Request())
        await until(call.done, 20)
        assert call.result().success, call.result().message
        ask.publish(String(data="map"))
        call = services["off"].call_async(Trigger.Request())
        await until(call.done, 20)
        assert call.result().success
        count = len(heard)
        await asyncio.sleep(0.3)
        assert len(heard) <= count + 1
        assert "on /cloud_map" in await answered("map", "done")
        await until(lambda: maps, 20)
    assert max(maps[0].data) > 65
    assert (tmp_path / "map" / "map.png").exists()
    [bag] = (tmp_path / "bags").iterdir()
    assert len(list(Bag(bag))) > 5


async def test_a_bridge_waits_for_its_platform_and_goes_on_after_its_robot_endpoint_was_killed(
    fragile: RealPlatform, robots: dict[str, RobotRos], tmp_path: Path
) -> None:
    rover = robots["rover"]
    rover.talk("/say", String, lambda: String(data="hello"))
    heard = rover.listen("/heard", String)
    rover.spin()
    async with bridge(
        fragile,
        "rover",
        tmp_path,
        environment={"tag": "e", "create": {}, "nodes": [{"tag": "e", "pkg": "rce_demo", "exe": "echo.py"}]},
        send={"topics": [{"topic": "/say", "type": "std_msgs/String"}]},
        receive={"topics": [{"topic": "/heard", "type": "std_msgs/String"}]},
    ):
        await until(lambda: heard, 30)
        fragile.kill(fragile.pid("endpoints.robot"))
        await asyncio.sleep(0.5)
        count = len(heard)
        await until(lambda: len(heard) > count + 3, 30)


def _tf() -> Any:
    from tf2_msgs.msg import TFMessage

    return TFMessage


def _transform(child: str) -> TransformStamped:
    transform = TransformStamped(child_frame_id=child)
    transform.header.frame_id = "odom"
    return transform


def _image() -> Image:
    return Image(width=64, height=48, step=192, encoding="rgb8", data=bytes(64 * 48 * 3))


def _scan(scan: Scan) -> LaserScan:
    message = LaserScan(angle_min=scan.angle_min, angle_increment=scan.angle_increment, range_max=scan.range_max)
    message.header.stamp.sec, fraction = int(scan.stamp), scan.stamp % 1
    message.header.stamp.nanosec = int(fraction * 1e9)
    message.ranges = array("f", scan.ranges.tobytes())
    return message


def _answered(response: Trigger.Response) -> Trigger.Response:
    response.success, response.message = True, "landed"
    return response
