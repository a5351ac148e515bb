"""Bridges of robots that run ROS 2, each in a domain of its own."""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import signal
import socket
import sys
import threading
from array import array
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from urllib.request import urlopen

import msgspec
import pytest
import rclpy
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import OccupancyGrid
from prometheus_client.parser import text_string_to_metric_families as parsed
from rclpy.action import ActionClient
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image, LaserScan
from std_msgs.msg import String
from std_srvs.srv import Trigger
from test_msgs.action import Fibonacci

from provisioning.typesupport import build, shipped
from rce.errors import Forbidden
from rce.mapping.evaluation.simulation import simulate
from rce.mapping.files.recordings.bags import Bag
from rce.mapping.scans import Scan
from tests.support.domains import domain
from tests.support.e2e.real_platform import USER, RealPlatform, until
from tests.support.paths import TEST_PACKAGE, TESTS
from tests.support.programs import running

ROBOTS = ("rover", "lander")
START_TIMEOUT, STOP_TIMEOUT = 120.0, 60.0  # seconds
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6  # of action_msgs/GoalStatus
TriggerClient = Client[Trigger.Request, Trigger.Response]


class RobotRos:
    """Nodes of one robot in its ROS domain."""

    def __init__(self, number: int) -> None:
        self._context = Context()
        rclpy.init(context=self._context, domain_id=number, args=[])
        self.node = rclpy.create_node("robot", context=self._context, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)

    def spin(self) -> None:
        """Start the thread, after all entities were created: rclpy is not safe to create them while it spins."""
        self._thread.start()

    def subscribe(self, topic: str, kind: type[Any], qos: QoSProfile | int = 10) -> list[Any]:
        """Subscribe to a topic; return the list to which its messages are added."""
        received: list[Any] = []
        self.node.create_subscription(kind, topic, received.append, qos)
        return received

    def publish(self, topic: str, kind: type[Any], make: Callable[[], Any], seconds: float = 0.05) -> None:
        """Publish a new message every `seconds`."""
        out = self.node.create_publisher(kind, topic, 10)
        self.node.create_timer(seconds, lambda: out.publish(make()))

    def stop(self) -> None:
        self._executor.shutdown()
        if self._thread.ident is not None:
            self._thread.join()
        self.node.destroy_node()
        self._context.try_shutdown()


@pytest.fixture
def robots(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, RobotRos]]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.syspath_prepend(build([*shipped(), TEST_PACKAGE]).prefix / "python")
    found = {name: RobotRos(domain(name)) for name in ROBOTS}
    yield found
    for robot in found.values():
        robot.stop()


@pytest.fixture
def metrics_port() -> Iterator[int]:
    """A port reserved by a socket that is bound but does not listen, so that a server with SO_REUSEADDR can bind it."""
    with socket.socket() as reservation:
        reservation.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        reservation.bind(("", 0))
        yield reservation.getsockname()[1]


@asynccontextmanager
async def bridge(platform: RealPlatform, robot: str, directory: Path, **config: Any) -> AsyncIterator[Path]:
    """Run a bridge as a process of its own; yield its log. It must end with status 0."""
    typesupport = build([*shipped(), TEST_PACKAGE])
    file = directory / f"{robot}.json"
    whole = {"url": platform.url, "user": USER, "robot": robot, "password": USER, **config}
    file.write_bytes(msgspec.json.encode(whole))
    log = directory / f"{robot}.log"
    command = [sys.executable, "-P", "-m", "endpoints.bridge", str(file), "--typesupport", str(typesupport.prefix)]
    variables = {"ROS_DOMAIN_ID": str(domain(robot)), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with log.open("w") as output:
        process = await asyncio.create_subprocess_exec(*command, env=os.environ | variables, stderr=output)
    try:
        yield log
    finally:
        if process.returncode is None:
            process.send_signal(signal.SIGINT)
        try:
            status = await asyncio.wait_for(process.wait(), STOP_TIMEOUT)
        except TimeoutError:
            process.kill()
            raise
    assert status == 0, log.read_text()


@asynccontextmanager
async def fibonacci_server(robot: str) -> AsyncIterator[asyncio.subprocess.Process]:
    """Run the action server /fibonacci in the ROS domain of a robot."""
    program = TESTS / "e2e" / "ros" / "Relay" / "scripts" / "fibonacci.py"
    variables = {"ROS_DOMAIN_ID": str(domain(robot)), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    async with running(sys.executable, str(program), env=os.environ | variables) as process:
        yield process


class SentGoal(NamedTuple):
    """A goal that a node has sent, its feedback so far, and its result, if it was waited for."""

    handle: Any
    feedback: list[Any]
    result: Any = None


async def future_of(future: Any) -> Any:
    """Return the result of a future of rclpy."""
    await until(future.done)
    return future.result()


def add_to(feedback: list[Any], message: Any) -> None:
    feedback.append(message.feedback.sequence)


async def accepted_goal(client: ActionClient[Any, Any, Any], order: int, whole: bool = True) -> SentGoal:
    """Send a goal until it gets feedback, as this is lost until DDS discovery has finished.

    Raises:
        Forbidden: It was rejected.
    """
    await until(client.server_is_ready)
    async with asyncio.timeout(START_TIMEOUT):
        while True:
            feedback: list[Any] = []
            handle = await future_of(client.send_goal_async(Fibonacci.Goal(order=order), partial(add_to, feedback)))
            if not handle.accepted and order >= 0:
                await asyncio.sleep(0.1)  # the server of the robot is not there yet
                continue
            if not handle.accepted:
                raise Forbidden("the goal was rejected")
            if not whole:
                return SentGoal(handle, feedback)
            result = await future_of(handle.get_result_async())
            if feedback:
                return SentGoal(handle, feedback, result)


async def answer_of(client: TriggerClient) -> Trigger.Response:
    """Call a service until it answers: answers are lost until DDS discovery has finished."""
    await until(client.service_is_ready)
    async with asyncio.timeout(START_TIMEOUT):
        while True:
            call = client.call_async(Trigger.Request())
            with suppress(AssertionError):
                await until(call.done, 5)
            if (answer := call.result()) is not None:
                return answer


async def test_topics_services_and_transforms_between_two_robots(
    platform: RealPlatform, robots: dict[str, RobotRos], tmp_path: Path, metrics_port: int
) -> None:
    rover, lander = robots["rover"], robots["lander"]
    rover.publish("/say", String, lambda: String(data="hello"))
    rover.publish("/tf", _tf(), lambda: _tf()(transforms=[_transform("base_link"), _transform("wheel")]), 0.02)
    rover.publish("/camera", Image, _image, 0.2)
    lander.node.create_service(Trigger, "/land", lambda _, response: _answered(response))
    texts = lander.subscribe("/from_rover", String)
    images = lander.subscribe("/camera", Image)
    frames = lander.subscribe("/tf", _tf())
    client: TriggerClient = rover.node.create_client(Trigger, "/land")
    rover.spin()
    lander.spin()
    # Bridges do not receive what other bridges publish, so a node in the environment relays it.
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
        await until(lambda: "are open" in log.read_text(), START_TIMEOUT)
        async with bridge(
            platform,
            "lander",
            tmp_path,
            environment={"tag": "sky"},
            send=lander_sends,
            receive=lander_gets,
            metrics=metrics_port,
        ):
            await until(lambda: texts and images and frames, START_TIMEOUT)
            assert texts[0].data == "hello"
            assert (images[0].width, images[0].height, images[0].encoding) == (64, 48, "rgb8")
            assert {each.child_frame_id for message in frames for each in message.transforms} == {"base_link"}
            assert (await answer_of(client)).message == "landed"
            received = len(texts) + len(images)
            metrics = await asyncio.to_thread(
                lambda: urlopen(f"http://127.0.0.1:{metrics_port}/metrics").read().decode()
            )
            samples = {
                each.name: each for family in parsed(metrics) for each in family.samples if "received" in str(each)
            }
            assert samples["rce_messages_total"].value >= received
            assert samples["rce_bytes_total"].value > 64 * 48
            assert 'rce_info{role="bridge"' in metrics
    async with platform.robot("later") as robot:
        await robot.create_environment("sky")  # the bridge has destroyed it at its end
        await robot.destroy_environment("sky")


async def test_actions_in_both_directions(platform: RealPlatform, robots: dict[str, RobotRos], tmp_path: Path) -> None:
    """A node of the lander uses the rover's action through the environment: it passes both kinds of flows."""
    lander = robots["lander"]
    robots["rover"].spin()
    goals = ActionClient(lander.node, Fibonacci, "/count")
    lander.spin()
    action = {"action": "/fibonacci", "type": "test_msgs/Fibonacci", "to": "/rover/fibonacci", "cancel_if_lost": True}
    count = {"action": "/rover/fibonacci", "type": "test_msgs/Fibonacci", "to": "/count"}
    environment = {"tag": "counting", "create": {}}
    sends, gets = {"actions": [action]}, {"actions": [count]}
    async with (
        fibonacci_server("rover") as server,
        bridge(platform, "rover", tmp_path, environment=environment, send=sends) as log,
    ):
        await until(lambda: "are open" in log.read_text(), START_TIMEOUT)
        async with bridge(platform, "lander", tmp_path, environment={"tag": "counting"}, receive=gets) as its_log:
            await until(lambda: "are open" in its_log.read_text(), START_TIMEOUT)
            first = await accepted_goal(goals, 8)
            assert (first.result.status, list(first.result.result.sequence)) == (SUCCEEDED, [0, 1, 1, 2, 3, 5, 8, 13])
            assert list(first.feedback[-1]) == [0, 1, 1, 2, 3, 5, 8, 13]
            with pytest.raises(Forbidden):
                await accepted_goal(goals, -1)

            endless = await accepted_goal(goals, 0, whole=False)
            await until(lambda: endless.feedback)
            canceled = await future_of(endless.handle.cancel_goal_async())
            assert len(canceled.goals_canceling) == 1
            assert (await future_of(endless.handle.get_result_async())).status == CANCELED

            lost = await accepted_goal(goals, 0, whole=False)
            await until(lambda: lost.feedback)
            server.terminate()
            assert (await future_of(lost.handle.get_result_async())).status == ABORTED


async def test_nodes_request_actions(platform: RealPlatform, robots: dict[str, RobotRos], tmp_path: Path) -> None:
    rover = robots["rover"]
    said: list[int] = []

    def number() -> String:
        said.append(len(said))
        return String(data=str(said[-1]))

    rover.publish("/say", String, number)
    answers = rover.subscribe("/cloud_response", String)
    echoed = rover.subscribe("/heard", String)
    scans_published = rover.subscribe("/scan", LaserScan)
    maps = rover.subscribe(
        "/cloud_map", OccupancyGrid, QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    )
    scans = itertools.cycle(simulate().records)
    rover.publish("/scan", LaserScan, lambda: _scan(next(scans)))
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

    services: dict[str, TriggerClient] = {
        name: rover.node.create_client(Trigger, f"/cloud/{name}") for name in config["requests"]
    }
    rover.spin()

    def ended(name: str) -> list[dict[str, str]]:
        responses = [json.loads(each.data) for each in answers]
        return [each for each in responses if each["id"] == name and each["state"] in ("done", "failed")]

    async def response(name: str, state: str) -> str:
        await until(lambda: ended(name), 300, f"end of {name}")
        assert ended(name)[0]["state"] == state, answers
        return ended(name)[0].get("message", "")

    async def call(name: str) -> None:
        called = services[name].call_async(Trigger.Request())
        await until(called.done)
        answer = called.result()
        assert answer is not None
        assert answer.success, answer.message

    async with bridge(platform, "rover", tmp_path, **config):
        for each in services.values():
            await until(each.service_is_ready, START_TIMEOUT)
        async with asyncio.timeout(START_TIMEOUT):
            while not ended("dance"):  # responses are lost until DDS discovery has finished
                ask.publish(String(data="dance"))
                with suppress(AssertionError):
                    await until(lambda: ended("dance"), 1)
        assert "has: on, off, record, end, map" in await response("dance", "failed")
        ask.publish(String(data="on"))
        await response("on", "done")
        await until(lambda: echoed)
        await call("record")
        await until(lambda: rover.node.count_subscribers("/scan") > 1, what="the recorder is discovered")
        count = len(scans_published)
        await until(lambda: len(scans_published) > count + 40)
        await call("end")
        ask.publish(String(data="map"))
        await call("off")
        last = len(said) - 1
        await until(lambda: len(said) > last + 6)
        assert "on /cloud_map" in await response("map", "done")
        await until(lambda: maps)
        assert max(int(each.data) for each in echoed) <= last, "messages after the end of offloading"
    assert max(maps[0].data) > 65
    assert (tmp_path / "map" / "map.png").exists()
    [bag] = (tmp_path / "bags").iterdir()
    assert len(list(Bag(bag))) > 5


async def test_bridge_continues_after_its_robot_endpoint_was_killed(
    fragile: RealPlatform, robots: dict[str, RobotRos], tmp_path: Path
) -> None:
    rover = robots["rover"]
    rover.publish("/say", String, lambda: String(data="hello"))
    echoed = rover.subscribe("/heard", String)
    rover.spin()
    async with bridge(
        fragile,
        "rover",
        tmp_path,
        environment={"tag": "e", "create": {}, "nodes": [{"tag": "e", "pkg": "rce_demo", "exe": "echo.py"}]},
        send={"topics": [{"topic": "/say", "type": "std_msgs/String"}]},
        receive={"topics": [{"topic": "/heard", "type": "std_msgs/String"}]},
    ):
        await until(lambda: echoed, START_TIMEOUT)
        killed = fragile.pid("-m endpoints.robot ")
        fragile.kill(killed)
        await until(lambda: fragile.pid("-m endpoints.robot ", but=killed))
        count = len(echoed)
        await until(lambda: len(echoed) > count + 3, START_TIMEOUT)


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
