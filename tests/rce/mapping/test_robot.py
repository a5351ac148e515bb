"""Client of a mapping node, with a node that a test controls."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from typing import Any, TypeVar, cast

import numpy as np
import pytest

from rce.client import Environment, Event, Reconnected, Robot, Stream
from rce.errors import Died, TimedOut, Unavailable
from rce.mapping import robot as mapping_robot
from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.robot import (
    EMPTY_REQUEST,
    NODE,
    WINDOW,
    MappingRobot,
    grid_of,
    nanoseconds,
    odometry_cdr,
    scan_cdr,
    store,
    trajectory_of,
    types,
)
from rce.mapping.scans import Scan
from rce.protocol.messages import EnvironmentEvent, NodeEvent

T = TypeVar("T")
SECOND = 10**9


def scan(stamp: float, odometry: Pose | None = ORIGIN) -> Scan:
    return Scan(stamp, np.array([1.0, 2.5, math.inf], np.float32), -1.0, 0.5, 30.0, odometry)


SCANS = [scan(1.0 + i) for i in range(3 * WINDOW)]


def header(stamp: int) -> Any:
    time = types["builtin_interfaces/msg/Time"](sec=stamp // SECOND, nanosec=stamp % SECOND)
    return types["std_msgs/msg/Header"](stamp=time, frame_id="map")


def pose_message(pose: Pose) -> Any:
    return types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=pose.x, y=pose.y, z=0.0),
        orientation=types["geometry_msgs/msg/Quaternion"](
            x=0.0, y=0.0, z=math.sin(pose.theta / 2), w=math.cos(pose.theta / 2)
        ),
    )


def path_cdr(rows: list[tuple[int, Pose]]) -> bytes:
    """Serialise a path of poses and their stamps in nanoseconds."""
    stamped = types["geometry_msgs/msg/PoseStamped"]
    poses = [stamped(header=header(stamp), pose=pose_message(pose)) for stamp, pose in rows]
    return bytes(store.serialize_cdr(types["nav_msgs/msg/Path"](header=header(0), poses=poses), "nav_msgs/msg/Path"))


def map_cdr() -> bytes:
    """Serialise a map of 2 rows and 3 columns."""
    info = types["nav_msgs/msg/MapMetaData"](
        map_load_time=header(0).stamp, resolution=0.5, width=3, height=2, origin=pose_message(Pose(-1.0, 2.0, 0.0))
    )
    data = np.array([0, 100, -1, 50, 0, 0], np.int8)
    grid = types["nav_msgs/msg/OccupancyGrid"](header=header(0), info=info, data=data)
    return bytes(store.serialize_cdr(grid, "nav_msgs/msg/OccupancyGrid"))


def stamp_of(cdr: bytes, kind: str) -> int:
    message: Any = store.deserialize_cdr(cdr, kind)
    return int(message.header.stamp.sec) * SECOND + int(message.header.stamp.nanosec)


class Subscriber(Stream[T]):
    closed = False

    async def close(self) -> None:
        self.closed = True


class FakeNode:
    """Environment with a mapping node, which answers scans while `answers`; also the robot that uses it.

    Attributes:
        log: What was done, in order.
        mapped: Stamps of the scans that were answered.
    """

    tag = "env"

    def __init__(self) -> None:
        self.answers = True
        self.log: list[tuple[str, Any]] = []
        self.mapped: list[int] = []
        self.streams: dict[str, Subscriber[bytes]] = {}
        self.event_stream: Stream[Event] = Stream(100)

    def events(self) -> Stream[Event]:
        return self.event_stream

    async def set_parameter(self, name: str, value: object) -> None:
        self.log.append((name, value))

    async def add_node(self, tag: str, package: str, executable: str) -> None:
        self.log.append((tag, f"{package}/{executable}"))

    async def publisher(self, topic: str, kind: str, **_: object) -> FakePublisher:
        return FakePublisher(self, topic)

    async def subscriber(self, topic: str, kind: str, **_: object) -> Subscriber[bytes]:
        self.streams[topic] = Subscriber(100)
        if topic.endswith("/map"):
            self.streams[topic].put(b"ready")
        return self.streams[topic]

    async def service_client(self, service: str, kind: str, **_: object) -> FakeNode:
        self.log.append(("service", service))
        return self

    async def call(self, request: bytes, seconds: float) -> bytes:
        assert request == EMPTY_REQUEST
        self.put("path", path_cdr([(stamp, Pose(stamp / SECOND, 0.0, 0.0)) for stamp in self.mapped]))
        return map_cdr()

    def put(self, topic: str, cdr: bytes) -> None:
        next(stream for name, stream in self.streams.items() if name.endswith(f"/{topic}")).put(cdr)

    def receive(self, topic: str, cdr: bytes) -> None:
        kind = "nav_msgs/msg/Odometry" if topic.endswith("odom") else "sensor_msgs/msg/LaserScan"
        stamp = stamp_of(cdr, kind)
        self.log.append((topic, stamp))
        if topic.endswith("scan") and self.answers:
            self.answer(stamp)

    def answer(self, stamp: int) -> None:
        if stamp not in self.mapped:
            self.mapped.append(stamp)
        kind = "geometry_msgs/msg/PoseWithCovariance"
        pose = types[kind](pose=pose_message(ORIGIN), covariance=np.zeros(36))
        message = types["geometry_msgs/msg/PoseWithCovarianceStamped"](header=header(stamp), pose=pose)
        self.put("pose", bytes(store.serialize_cdr(message, "geometry_msgs/msg/PoseWithCovarianceStamped")))

    def sent(self, topic: str) -> list[int]:
        """Return the stamps of the messages on a topic."""
        return [stamp for name, stamp in self.log if name == topic]


class FakePublisher:
    def __init__(self, node: FakeNode, topic: str) -> None:
        self.node, self.topic = node, topic

    async def publish(self, cdr: bytes) -> None:
        self.node.receive(self.topic, cdr)


@pytest.fixture
def node() -> FakeNode:
    return FakeNode()


def client(node: FakeNode, namespace: str = "") -> MappingRobot:
    """Return the client under test; the fake has what it uses of a robot and of an environment."""
    return MappingRobot(cast(Robot, node), cast(Environment, node), namespace)


@pytest.fixture
async def robot(node: FakeNode) -> AsyncIterator[MappingRobot]:
    async with client(node) as robot:
        await robot.wire()
        yield robot


async def until_stuck(node: FakeNode, robot: MappingRobot) -> asyncio.Task[None]:
    """Start to drive with a node that does not answer, and wait until the window is full."""
    node.answers = False
    driving = asyncio.create_task(robot.drive(SCANS, lambda _: None))
    while len(node.sent("/scan")) < WINDOW:  # noqa: ASYNC110  # the fake answers in the same loop
        await asyncio.sleep(0)
    return driving


async def test_node_is_started_with_its_parameters(node: FakeNode) -> None:
    async with client(node, "/one") as robot:
        await robot.prepare({"mapper": "graph", "resolution": 0.1})
    assert node.log == [
        ("mapper", "graph"),
        ("resolution", 0.1),
        (NODE, "rce_mapping/mapper"),
        ("service", "/one/dynamic_map"),
    ]
    assert set(node.streams) == {"/one/pose", "/one/path", "/one/map"}
    assert node.streams["/one/map"].closed, "it only showed that the node is ready"


async def test_node_that_is_not_ready_in_time_is_given_up(node: FakeNode, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mapping_robot, "START_TIMEOUT", 0.01)
    monkeypatch.setattr(Subscriber, "put", lambda *_: None)
    async with client(node) as robot:
        with pytest.raises(TimedOut, match="to be ready"):
            await robot.wire()


async def test_each_scan_follows_its_odometry_and_is_counted(node: FakeNode, robot: MappingRobot) -> None:
    counts: list[int] = []
    await robot.drive([scan(1.0), scan(2.0, odometry=None), scan(3.0)], counts.append)
    stamps = [(topic, stamp // SECOND) for topic, stamp in node.log if topic != "service"]
    assert stamps == [("/odom", 1), ("/scan", 1), ("/scan", 2), ("/odom", 3), ("/scan", 3)]
    assert counts == [1, 2, 3]


async def test_few_scans_are_unanswered_at_a_time(node: FakeNode, robot: MappingRobot) -> None:
    driving = await until_stuck(node, robot)
    for _ in range(50):
        await asyncio.sleep(0)
    assert len(node.sent("/scan")) == WINDOW
    node.answers = True
    for stamp in node.sent("/scan"):
        node.answer(stamp)
    await driving
    assert node.sent("/scan") == [nanoseconds(each.stamp) for each in SCANS]


async def test_unanswered_scans_are_sent_again_after_a_reconnection(node: FakeNode, robot: MappingRobot) -> None:
    driving = await until_stuck(node, robot)
    node.answer(node.sent("/scan")[0])
    while len(node.sent("/scan")) == WINDOW:  # noqa: ASYNC110  # the fake answers in the same loop
        await asyncio.sleep(0)
    node.answers = True
    node.event_stream.put(Reconnected(resumed=True))
    await driving
    stamps = [nanoseconds(each.stamp) for each in SCANS]
    assert sorted(node.mapped) == stamps
    assert node.sent("/scan").count(stamps[0]) == 1, "this one was answered"
    assert node.sent("/scan").count(stamps[1]) == 2


@pytest.mark.parametrize(
    ("event", "reason"),
    [
        (NodeEvent("env", NODE, -9, ["a traceback"]), "status -9\na traceback"),
        (EnvironmentEvent("env", "lost", "the machine is gone"), "the machine is gone"),
    ],
    ids=["node", "environment"],
)
async def test_end_of_the_node_ends_the_drive(
    node: FakeNode, robot: MappingRobot, event: NodeEvent | EnvironmentEvent, reason: str
) -> None:
    driving = await until_stuck(node, robot)
    node.event_stream.put(NodeEvent("env", "other", 1))
    node.event_stream.put(NodeEvent("elsewhere", NODE, 1))
    node.event_stream.put(EnvironmentEvent("env", "ready"))
    node.event_stream.put(event)
    with pytest.raises(Died, match=reason):
        await driving


async def test_closed_robot_is_not_taken_for_a_slow_node(node: FakeNode, robot: MappingRobot) -> None:
    driving = await until_stuck(node, robot)
    node.event_stream.end()
    with pytest.raises(Unavailable, match="closed"):
        await driving


async def test_node_that_does_not_answer_is_given_up(
    node: FakeNode, robot: MappingRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mapping_robot, "STALL_TIMEOUT", 0.01)
    node.answers = False
    with pytest.raises(TimedOut, match="to answer the last scans"):
        await robot.drive(SCANS[:2], lambda _: None)


async def test_result_has_a_pose_for_each_scan(node: FakeNode, robot: MappingRobot) -> None:
    await robot.drive(SCANS, lambda _: None)
    node.put("path", path_cdr([(7, ORIGIN)] * len(SCANS)))  # from before the map was requested
    result = await robot.result()
    assert result.scans == len(SCANS)
    assert result.trajectory[:, 0].tolist() == [each.stamp for each in SCANS]
    assert result.grid.cells.shape == (2, 3)


async def test_result_waits_for_the_whole_path(node: FakeNode, robot: MappingRobot) -> None:
    await robot.drive(SCANS[:3], lambda _: None)
    last = node.mapped.pop()
    fetching = asyncio.create_task(robot.result())
    for _ in range(50):
        await asyncio.sleep(0)
    assert not fetching.done()
    node.put("path", path_cdr([(stamp, ORIGIN) for stamp in (*node.mapped, last)]))
    assert len((await fetching).trajectory) == 3


@pytest.mark.parametrize(
    ("stamp", "expected"), [(0.0, 0), (1.5, 1_500_000_000), (1134864629.895182, 1134864629_895182000)]
)
def test_stamps_have_microseconds(stamp: float, expected: int) -> None:
    assert nanoseconds(stamp) == expected


def test_scan_is_serialised_with_all_its_beams() -> None:
    message: Any = store.deserialize_cdr(scan_cdr(1_500_000_000, scan(1.5)), "sensor_msgs/msg/LaserScan")
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 500_000_000)
    assert (message.angle_min, message.angle_max, message.angle_increment, message.range_max) == (-1.0, 0.0, 0.5, 30.0)
    assert message.ranges.tolist() == [1.0, 2.5, math.inf]


def test_odometry_is_serialised_with_its_heading() -> None:
    cdr = odometry_cdr(1_500_000_000, Pose(1.0, -2.0, 2.5))
    message: Any = store.deserialize_cdr(cdr, "nav_msgs/msg/Odometry")
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
    assert (place.x, place.y, 2 * math.atan2(turn.z, turn.w)) == pytest.approx((1.0, -2.0, 2.5))


def test_path_is_read_as_a_trajectory() -> None:
    rows = trajectory_of(path_cdr([(1_500_000_000, Pose(1.0, 2.0, -3.0)), (2_000_000_000, Pose(3.0, 4.0, 3.0))]))
    np.testing.assert_allclose(rows, [[1.5, 1.0, 2.0, -3.0], [2.0, 3.0, 4.0, 3.0]])
    assert trajectory_of(path_cdr([])).shape == (0, 4)


def test_map_is_read_with_its_lowest_row_first() -> None:
    grid = grid_of(map_cdr())
    assert grid.cells.tolist() == [[0, 100, -1], [50, 0, 0]]
    assert (grid.resolution, grid.x, grid.y) == (0.5, -1.0, 2.0)
