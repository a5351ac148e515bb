"""Reader of ROS 1 and ROS 2 bags; it uses `rosbags` and needs no ROS."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

from rce.errors import InvalidRequest, RceError
from rce.mapping.clouds import CLOUD_TYPE, cloud_topic, decode
from rce.mapping.geometry import Pose
from rce.mapping.pairing import OdometryPairing
from rce.mapping.scan_cutting import BAND, Band, cut_scan
from rce.mapping.scans import Scan

if TYPE_CHECKING:
    from rosbags.typesys.stores.ros2_humble import (
        nav_msgs__msg__Odometry as Odometry,
    )
    from rosbags.typesys.stores.ros2_humble import (
        sensor_msgs__msg__LaserScan as LaserScan,
    )
    from rosbags.typesys.stores.ros2_humble import (
        std_msgs__msg__Header as Header,
    )

SCAN_TYPE = "sensor_msgs/msg/LaserScan"
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
ROS1_MAGIC = b"#ROSBAG V2.0\n"
UNEXPLAINED: dict[type[Exception], str] = {  # exceptions that `rosbags` raises without a message
    AssertionError: "its records do not match its index",
    MemoryError: "the size of a record exceeds the memory",
}
MAX_WAITING = 1000  # scans that may wait for odometry: in some bags the odometry ends early


class Bag:
    """Laser scans of one topic of a bag, each with the odometry of its stamp if there is an odometry topic.

    A topic that is not given is found by its type; of several, the one with the most messages is used. Where a bag has
    no scans, they are cut from its clouds.

    Attributes:
        name: Name of the bag.
        scans: Number of scans.
        duration: Seconds of the bag.
    """

    def __init__(self, path: Path, scan_topic: str = "", odometry_topic: str = "", band: Band = BAND) -> None:
        """Open a bag and choose its topics.

        Args:
            path: The file or directory.
            scan_topic: Topic of the scans, or of the clouds from which they are cut.
            odometry_topic: Topic of the odometry.
            band: What is cut from clouds.

        Raises:
            InvalidRequest: The bag cannot be read, or has no such topic or no scans.
        """
        self.name = path.name
        self._path = path
        with opened_bag(self._path) as reader:
            self.scan_topics: dict[str, int] = {}  # number of scans by topic
            self._band = band
            clouds = self._is_of_clouds(reader, scan_topic)
            scans = (
                self._connections(reader, CLOUD_TYPE, cloud_topic(reader, self.name, scan_topic))
                if clouds
                else self._connections(reader, SCAN_TYPE, scan_topic)
            )
            odometry = self._connections(reader, ODOMETRY_TYPE, odometry_topic)
            self.scans: int | None = sum(connection.msgcount for connection in scans)
            self.duration: float | None = max(reader.duration, 0) / 1e9
        if not self.scans:
            raise InvalidRequest(f"{self.name} has no laser scans: no messages of type {SCAN_TYPE}", field="path")
        self._scan_topic = scans[0].topic
        self._odometry_topic = odometry[0].topic if odometry else ""

    def __iter__(self) -> Iterator[Scan]:
        """Yield the scans in order of their stamps."""
        pairing = OdometryPairing()
        with opened_bag(self._path) as reader:
            topics = (self._scan_topic, self._odometry_topic)
            chosen = [connection for connection in reader.connections if connection.topic in topics]
            for connection, received, data in reader.messages(chosen):
                message = reader.deserialize(data, connection.msgtype)
                if connection.topic == self._scan_topic:
                    pairing.add_scan(self._scan_of(message, received))
                else:
                    pairing.add_odometry(*_odometry(cast("Odometry", message), received))
                yield from pairing.ready()
                if not self._odometry_topic or len(pairing) > MAX_WAITING:
                    yield from pairing.flush()
        yield from pairing.flush()

    def _is_of_clouds(self, reader: AnyReader, topic: str) -> bool:
        """Return whether the topic, or without one all that could be a scan, is of clouds."""
        topics = {each.topic: each.msgtype for each in reader.connections if each.msgcount}
        if topic in topics:
            return topics[topic] == CLOUD_TYPE
        return CLOUD_TYPE in topics.values() and SCAN_TYPE not in topics.values() and not topic

    def _scan_of(self, message: Any, received: int) -> Scan:
        if hasattr(message, "point_step"):
            return cut_scan(decode(message, received), self._band)
        return _scan(cast("LaserScan", message), received)

    def _connections(self, reader: AnyReader, kind: str, topic: str) -> list[Connection]:
        """Return the connections of a topic, or of the topic of this type that has the most messages.

        Raises:
            InvalidRequest: The bag has no such topic.
        """
        typed = [connection for connection in reader.connections if connection.msgtype == kind]
        counts = {connection.topic: 0 for connection in typed}
        for connection in typed:
            counts[connection.topic] += connection.msgcount
        if topic and topic not in counts:
            have = ", ".join(sorted(counts)) or "none"
            raise InvalidRequest(
                f"{self.name} has no topic {topic} of type {kind}; topics of this type: {have}", field="topic"
            )
        if kind == SCAN_TYPE:
            self.scan_topics = counts
        wanted = topic or max(sorted(counts), key=lambda name: counts[name], default="")
        return [connection for connection in typed if connection.topic == wanted]


@contextmanager
def opened_bag(path: Path) -> Iterator[AnyReader]:
    """Return the reader of a bag; errors of `rosbags` become InvalidRequest."""
    _check_kind(path)
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except RceError:
        raise
    except Exception as error:  # damaged files cause errors of assert, struct, sqlite, codecs ...
        reason = str(error) or UNEXPLAINED.get(type(error), type(error).__name__)
        # Clients of a service must not learn where it stores files.
        reason = reason.replace(str(path), path.name)
        raise InvalidRequest(
            f"{path.name} cannot be read as a bag: it is truncated, damaged or not indexed ({reason}). "
            "Try `rosbag reindex` or `ros2 bag reindex`.",
            field="path",
        ) from error


def _check_kind(path: Path) -> None:
    """Check the format of a file before `rosbags` does, whose errors are less clear.

    Raises:
        InvalidRequest: The file is not a bag of a supported format; the message names the remedy.
    """
    if path.is_dir():
        if not (path / "metadata.yaml").exists():
            raise InvalidRequest(f"{path.name} is not a ROS 2 bag: it has no metadata.yaml", field="path")
        return
    with path.open("rb") as file:
        start = file.readline(64)
    if not start:
        raise InvalidRequest(f"{path.name} is empty", field="path")
    if path.suffix == ".bag" and start != ROS1_MAGIC:
        what = "not a ROS bag"
        if start.startswith((b"#ROSRECORD V", b"#ROSBAG V")):
            version = start.partition(b"V")[2].strip().decode("ascii", "replace")
            what = (
                f"a ROS bag of format {version}; only 2.0 is supported: convert it with `rosbag fix`"
                if version != "2.0"
                else "a ROS bag whose first line is damaged"
            )
        raise InvalidRequest(f"{path.name} is {what}", field="path")


def _stamp(header: Header, received: int) -> float:
    """Return the stamp of a header in seconds, or the time of recording (nanoseconds) if the stamp is zero."""
    return (header.stamp.sec + header.stamp.nanosec * 1e-9) or received * 1e-9


def _scan(message: LaserScan, received: int) -> Scan:
    ranges = np.array(message.ranges, np.float32)
    stamp = _stamp(message.header, received)
    return Scan(stamp, ranges, message.angle_min, message.angle_increment, message.range_max)


def _odometry(message: Odometry, received: int) -> tuple[float, Pose]:
    position, q = message.pose.pose.position, message.pose.pose.orientation
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return _stamp(message.header, received), Pose(position.x, position.y, yaw)
