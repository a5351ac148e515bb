"""Client of a mapping node: sends a recording to a mapping node in an environment and fetches the map.

Scans and odometry travel as CDR through raw interfaces. The node answers each scan with a pose of the same stamp. At
most `WINDOW` scans are unanswered at a time, fewer than any queue on the way holds, so that none is dropped.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from rce.client import Environment, Robot
from rce.errors import TimedOut
from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.guard import NodeGuard
from rce.mapping.scans import Scan
from rce.protocol.messages import ParameterValue, Qos

NODE = "mapper"  # tag of the mapping node
WINDOW = 8  # scans that may be unanswered at a time
START_TIMEOUT = 120.0  # seconds; a node compiles its kernels at its first start
STALL_TIMEOUT = 60.0  # seconds without an answer after which the node is given up
DEPTH = 4 * WINDOW  # messages in the queues of topics
EMPTY_REQUEST = b"\x00\x01\x00\x00\x00"  # CDR of a service request without fields

NANO = 1_000_000_000

store = get_typestore(Stores.ROS2_KILTED)
types = store.types
Progress = Callable[[int], None]


class Result(NamedTuple):
    """Result of mapping a recording.

    Attributes:
        grid: The map.
        trajectory: (n, 4) stamp, x, y, theta of each scan; seconds, metres, radians, map frame.
        scans: Number of scans sent.
    """

    grid: OccupancyGrid
    trajectory: NDArray[np.float64]
    scans: int


class MappingRobot:
    """Client of one mapping node for one recording. Use it as an asynchronous context manager."""

    def __init__(self, robot: Robot, environment: Environment, namespace: str = "") -> None:
        """Use a mapping node in an environment.

        Args:
            robot: Connected robot.
            environment: Environment of the node.
            namespace: Namespace of the robot's topics and services in the environment, "/NAME" or empty.
        """
        self._environment = environment
        self._guard = NodeGuard(robot, environment, NODE, self._send_again)
        self._namespace = namespace
        self._sent = 0
        self._unanswered: dict[int, Scan] = {}  # by stamp in nanoseconds
        self._slots = asyncio.Semaphore(WINDOW)
        self._tasks: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> Self:
        """Start watching for failures of the node, its environment and the connection."""
        await self._guard.__aenter__()
        return self

    async def __aexit__(self, *_: object) -> None:
        """Cancel all tasks."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._guard.__aexit__()

    async def prepare(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Start the node, connect its topics, and wait until it is ready.

        Raises:
            StartFailed: The node did not start.
            TimedOut: It was not ready in time.
        """
        await start_node(self._environment, "mapper", parameters)
        await self.wire()

    async def wire(self) -> None:
        """Connect the topics of a node that was started already, and wait until it is ready.

        Raises:
            TimedOut: It was not ready in time.
        """
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
        await self._guard.wait(ready.get(), START_TIMEOUT, "the mapping node to be ready")
        await ready.close()

    async def drive(self, recording: Iterable[Scan], progress: Progress) -> None:
        """Send all scans and wait until all are answered.

        Args:
            recording: The scans.
            progress: Called with the number of scans answered so far.

        Raises:
            Died: The node or its environment ended.
            TimedOut: The node has not answered for STALL_TIMEOUT.
        """
        self._tasks.append(asyncio.create_task(self._receive_poses(progress)))
        for scan in recording:
            await self._guard.wait(self._slots.acquire(), STALL_TIMEOUT, "the mapping node to answer a scan")
            self._unanswered[nanoseconds(scan.stamp)] = scan
            await self._send(scan)
            self._sent += 1
        for _ in range(WINDOW):  # all slots are free once all scans are answered
            await self._guard.wait(self._slots.acquire(), STALL_TIMEOUT, "the mapping node to answer the last scans")

    async def result(self) -> Result:
        """Return the current map and trajectory.

        Raises:
            Died: The node or its environment ended.
            TimedOut: The node has not answered for STALL_TIMEOUT.
        """
        return await self._guard.wait(self._fetch(self._sent), STALL_TIMEOUT, "the map")

    async def _send(self, scan: Scan) -> None:
        stamp = nanoseconds(scan.stamp)
        if scan.odometry is not None:
            await self._odometry.publish(odometry_cdr(stamp, scan.odometry))
        await self._scans.publish(scan_cdr(stamp, scan))

    async def _receive_poses(self, progress: Progress) -> None:
        """Free a slot for each pose that answers a scan."""
        answered = 0
        async for cdr in self._poses:
            pose: Any = store.deserialize_cdr(cdr, "geometry_msgs/msg/PoseWithCovarianceStamped")
            if self._unanswered.pop(pose.header.stamp.sec * NANO + pose.header.stamp.nanosec, None) is not None:
                answered += 1
                self._slots.release()
                progress(answered)

    async def _fetch(self, sent: int) -> Result:
        """Return the map and the trajectory of `sent` scans.

        The node publishes its path before it answers with the map, but the two may arrive in any order. Paths that have
        arrived already are discarded: in a team, scans of other robots may have moved this trajectory since.
        """
        with suppress(TimedOut):
            while True:
                await self._paths.get(0)
        response = await self._maps.call(EMPTY_REQUEST, STALL_TIMEOUT)
        trajectory = np.empty((0, 4))
        while len(trajectory) < sent:
            trajectory = trajectory_of(await self._paths.get())
        return Result(grid_of(response), trajectory, sent)

    async def _send_again(self) -> None:
        """Send unanswered scans again; the node ignores scans that it has mapped already."""
        for scan in list(self._unanswered.values()):
            await self._send(scan)


async def start_node(
    environment: Environment,
    executable: str,
    parameters: Mapping[str, ParameterValue],
    package: str = "rce_mapping",
) -> None:
    """Start a mapping node of a package with these parameters.

    Raises:
        StartFailed: The node did not start.
    """
    for name, value in parameters.items():
        await environment.set_parameter(name, value)
    await environment.add_node(NODE, package, executable)


def nanoseconds(stamp: float) -> int:
    """Convert seconds to nanoseconds, rounded to microseconds, the precision of the formats of recordings."""
    return round(stamp * 1e6) * 1000


def _header(stamp: int, frame: str) -> Any:
    time = types["builtin_interfaces/msg/Time"](sec=stamp // NANO, nanosec=stamp % NANO)
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def scan_cdr(stamp: int, scan: Scan) -> bytes:
    """Serialise a scan as `sensor_msgs/LaserScan`, stamp in nanoseconds."""
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
    """Serialise a pose as `nav_msgs/Odometry` without velocity, stamp in nanoseconds."""
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
    """Deserialise a `nav_msgs/Path` as (n, 4) stamp, x, y, theta."""
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
    """Deserialise the map of a `nav_msgs/GetMap` response, its only field."""
    found: Any = store.deserialize_cdr(cdr, "nav_msgs/msg/OccupancyGrid")
    cells = np.asarray(found.data, np.int8).reshape(found.info.height, found.info.width)
    return OccupancyGrid(cells, found.info.resolution, found.info.origin.position.x, found.info.origin.position.y)
