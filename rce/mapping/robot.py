"""The robot that maps: it drives a recording through a mapping node in an environment and gets the map back.

Scans and odometry go as CDR through Forwarders. The node answers each scan with a pose of the same stamp; at most
`WINDOW` scans are on their way at once, fewer than any queue of the chain holds, so that none is ever dropped.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine, Iterable, Mapping
from contextlib import suppress
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from rce.client import Environment, Event, Reconnected, Robot, Stream
from rce.errors import Died, TimedOut
from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.scans import Scan
from rce.messages import EnvironmentEvent, NodeEvent, ParameterValue, Qos

NODE = "mapper"  # the tag of the mapping node
WINDOW = 8
START_TIMEOUT = 120.0  # seconds; a node compiles at its very first start
STALL_TIMEOUT = 60.0
DEPTH = 4 * WINDOW
EMPTY_REQUEST = b"\x00\x01\x00\x00\x00"  # CDR of a request without fields

NANO = 1_000_000_000

T = TypeVar("T")
store = get_typestore(Stores.ROS2_KILTED)
types = store.types
Progress = Callable[[int], None]


class Result(NamedTuple):
    """`trajectory`: (n, 4) stamp s, x m, y m, theta rad of each scan, map frame."""

    grid: OccupancyGrid
    trajectory: NDArray[np.float64]
    scans: int


class MappingRobot:
    """One recording, one environment, one map. Use it as an asynchronous context."""

    def __init__(self, robot: Robot, environment: Environment, namespace: str = "") -> None:
        """`namespace`: of the robot's topics and services in the environment, "/NAME" or none."""
        self._robot = robot
        self._environment = environment
        self._namespace = namespace
        self._sent = 0
        self._unanswered: dict[int, Scan] = {}  # by stamp, nanoseconds
        self._slots = asyncio.Semaphore(WINDOW)
        self._tasks: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> Self:
        self._trouble = asyncio.create_task(self._watch(self._robot.events()))
        self._tasks.append(self._trouble)
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def prepare(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Start the node, wire its topics, and wait until it is ready. StartFailed, TimedOut."""
        await start_node(self._environment, "mapper", parameters)
        await self.wire()

    async def wire(self) -> None:
        """Wire the topics of a node that was started, and wait until it is ready. TimedOut."""
        environment, own = self._environment, self._namespace
        latched = Qos(reliability="reliable", durability="transient_local", depth=1)
        deep = Qos(reliability="reliable", depth=DEPTH)
        self._scans = await environment.publisher(f"{own}/scan", "sensor_msgs/LaserScan", qos=deep, raw=True)
        self._odometry = await environment.publisher(f"{own}/odom", "nav_msgs/Odometry", qos=deep, raw=True)
        self._poses = await environment.subscriber(
            f"{own}/pose", "geometry_msgs/PoseWithCovarianceStamped", qos=deep, depth=DEPTH, raw=True
        )
        self._paths = await environment.subscriber(f"{own}/path", "nav_msgs/Path", qos=latched, depth=1, raw=True)
        self._maps = await environment.service_client(f"{own}/dynamic_map", "nav_msgs/GetMap", raw=True)
        ready = await environment.subscriber(f"{own}/map", "nav_msgs/OccupancyGrid", qos=latched, depth=1, raw=True)
        await self._guarded(ready.get(), START_TIMEOUT, "the mapping node to be ready")
        await ready.close()

    async def drive(self, recording: Iterable[Scan], progress: Progress) -> None:
        """Send all scans, each once, until all are answered. Died if the node or its environment does."""
        self._tasks.append(asyncio.create_task(self._take_answers(progress)))
        for scan in recording:
            await self._guarded(self._slots.acquire(), STALL_TIMEOUT, "the mapping node to answer a scan")
            self._unanswered[nanoseconds(scan.stamp)] = scan
            await self._send(scan)
            self._sent += 1
        for _ in range(WINDOW):  # all slots are free once all scans are answered
            await self._guarded(self._slots.acquire(), STALL_TIMEOUT, "the mapping node to answer the last scans")

    async def result(self) -> Result:
        """The map and the way, as they are now. Died, TimedOut."""
        return await self._guarded(self._fetch(self._sent), STALL_TIMEOUT, "the map")

    async def _send(self, scan: Scan) -> None:
        stamp = nanoseconds(scan.stamp)
        if scan.odometry is not None:
            await self._odometry.publish(odometry_cdr(stamp, scan.odometry))
        await self._scans.publish(scan_cdr(stamp, scan))

    async def _take_answers(self, progress: Progress) -> None:
        answered = 0
        async for cdr in self._poses:
            pose: Any = store.deserialize_cdr(cdr, "geometry_msgs/msg/PoseWithCovarianceStamped")
            if self._unanswered.pop(pose.header.stamp.sec * NANO + pose.header.stamp.nanosec, None) is not None:
                answered += 1
                self._slots.release()
                progress(answered)

    async def _fetch(self, sent: int) -> Result:
        """The node publishes its path before it answers with the map, but the two come by different ways.

        Paths that have come already do not count: in a team, what others have seen since may have moved this one.
        """
        with suppress(TimedOut):
            while True:
                await self._paths.get(0)
        response = await self._maps.call(EMPTY_REQUEST, STALL_TIMEOUT)
        trajectory = np.empty((0, 4))
        while len(trajectory) < sent:
            trajectory = trajectory_of(await self._paths.get())
        return Result(grid_of(response), trajectory, sent)

    async def _watch(self, events: Stream[Event]) -> None:
        tag = self._environment.tag
        async for event in events:
            match event:
                case NodeEvent(containerTag=where, nodeTag=name, status=status, lines=lines) if (
                    where == tag and name == NODE
                ):
                    raise Died("\n".join([f"the mapping node ended with status {status}", *lines]))
                case EnvironmentEvent(containerTag=where, state="lost" | "gone" | "failed", reason=why) if where == tag:
                    raise Died(f"the environment {tag} is lost: {why}")
                case Reconnected():  # what was on its way is lost; the node drops what it has had already
                    for scan in list(self._unanswered.values()):
                        await self._send(scan)

    async def _guarded(self, work: Coroutine[None, None, T], seconds: float, what: str) -> T:
        """The result of `work`, unless something happens that it would wait for in vain."""
        task = asyncio.ensure_future(work)
        try:
            await asyncio.wait({task, self._trouble}, timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
            if task.done():
                return task.result()
            if self._trouble.done():
                self._trouble.result()
            raise TimedOut(f"waited {seconds:g} s for {what} in vain")
        finally:
            task.cancel()


async def start_node(environment: Environment, executable: str, parameters: Mapping[str, ParameterValue]) -> None:
    """Start a node of the package rce_mapping. StartFailed."""
    for name, value in parameters.items():
        await environment.set_parameter(name, value)
    await environment.add_node(NODE, "rce_mapping", executable)


def nanoseconds(stamp: float) -> int:
    return round(stamp * 1e6) * 1000  # microseconds are what the formats of recordings have


def _header(stamp: int, frame: str) -> Any:
    time = types["builtin_interfaces/msg/Time"](sec=stamp // NANO, nanosec=stamp % NANO)
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def scan_cdr(stamp: int, scan: Scan) -> bytes:
    message = types["sensor_msgs/msg/LaserScan"](
        header=_header(stamp, "base_link"),
        angle_min=scan.angle_min,
        angle_max=scan.angle_min + scan.angle_increment * (len(scan.ranges) - 1),
        angle_increment=scan.angle_increment,
        time_increment=0.0,
        scan_time=0.0,
        range_min=0.0,
        range_max=scan.range_max,
        ranges=scan.ranges,
        intensities=np.empty(0, np.float32),
    )
    return bytes(store.serialize_cdr(message, "sensor_msgs/msg/LaserScan"))


def odometry_cdr(stamp: int, pose: Pose) -> bytes:
    point = types["geometry_msgs/msg/Point"](x=pose[0], y=pose[1], z=0.0)
    turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=math.sin(pose[2] / 2), w=math.cos(pose[2] / 2))
    zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    unknown = np.zeros(36)
    message = types["nav_msgs/msg/Odometry"](
        header=_header(stamp, "odom"),
        child_frame_id="base_link",
        pose=types["geometry_msgs/msg/PoseWithCovariance"](
            pose=types["geometry_msgs/msg/Pose"](position=point, orientation=turn), covariance=unknown
        ),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](
            twist=types["geometry_msgs/msg/Twist"](linear=zero, angular=zero), covariance=unknown
        ),
    )
    return bytes(store.serialize_cdr(message, "nav_msgs/msg/Odometry"))


def trajectory_of(cdr: bytes) -> NDArray[np.float64]:
    """The poses of a `nav_msgs/Path`: (n, 4) stamp, x, y, theta."""
    path: Any = store.deserialize_cdr(cdr, "nav_msgs/msg/Path")
    rows = [
        (
            each.header.stamp.sec + each.header.stamp.nanosec / NANO,
            each.pose.position.x,
            each.pose.position.y,
            2 * math.atan2(each.pose.orientation.z, each.pose.orientation.w),
        )
        for each in path.poses
    ]
    return np.array(rows, np.float64).reshape(-1, 4)


def grid_of(cdr: bytes) -> OccupancyGrid:
    """The map of a `nav_msgs/GetMap` response, whose only field it is."""
    found: Any = store.deserialize_cdr(cdr, "nav_msgs/msg/OccupancyGrid")
    cells = np.asarray(found.data, np.int8).reshape(found.info.height, found.info.width)
    return OccupancyGrid(cells, found.info.resolution, found.info.origin.position.x, found.info.origin.position.y)
