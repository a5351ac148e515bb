"""Recordings of a few scans, written by tests."""

from __future__ import annotations

import gzip
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

RANGES = (1.0, 2.5, 81.91, 3.0)


def flaser(stamp: float, x: float = 0.0, ranges: tuple[float, ...] = RANGES) -> str:
    values = " ".join(f"{value:.2f}" for value in ranges)
    return f"FLASER {len(ranges)} {values} 9 9 9 {x} 2.0 0.5 {stamp:.6f} host 0.1\n"


def carmen(path: Path, text: str) -> Path:
    if path.suffix == ".gz":
        path.write_bytes(gzip.compress(text.encode()))
    else:
        path.write_text(text)
    return path


Message = Any  # types made by rosbags at run time


class Sample:
    """Messages of one robot: scans at 1.0, 1.5 and 2.0 s, odometry at 1.0 and 2.0 s."""

    def __init__(self, store: Stores) -> None:
        self.store, self.ros1 = get_typestore(store), store is Stores.ROS1_NOETIC

    def make(self, name: str, *fields: Message) -> Message:
        return self.store.types[name](*fields)

    def header(self, stamp: float) -> Message:
        time = self.make("builtin_interfaces/msg/Time", int(stamp), round(stamp % 1 * 1e9))
        sequence = (0,) if self.ros1 else ()
        return self.make("std_msgs/msg/Header", *sequence, time, "laser")

    def scan(self, stamp: float) -> Message:
        ranges, none = np.array(RANGES, np.float32), np.array([], np.float32)
        values = (-1.0, 1.0, 0.5, 0.0, 0.0, 0.1, 80.0, ranges, none)
        return self.make("sensor_msgs/msg/LaserScan", self.header(stamp), *values)

    def odometry(self, stamp: float, x: float) -> Message:
        point = self.make("geometry_msgs/msg/Point", x, 2.0, 0.0)
        turn = self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(0.25), math.cos(0.25))
        pose = self.make("geometry_msgs/msg/Pose", point, turn)
        zero = self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        twist, covariance = self.make("geometry_msgs/msg/Twist", zero, zero), np.zeros(36)
        return self.make(
            "nav_msgs/msg/Odometry",
            self.header(stamp),
            "base_link",
            self.make("geometry_msgs/msg/PoseWithCovariance", pose, covariance),
            self.make("geometry_msgs/msg/TwistWithCovariance", twist, covariance),
        )

    def messages(self) -> list[tuple[str, float, Message]]:
        scans = [("/scan", stamp, self.scan(stamp)) for stamp in (1.0, 1.5, 2.0)]
        moves = [("/odom", stamp, self.odometry(stamp, x)) for stamp, x in ((1.0, 1.0), (2.0, 3.0))]
        rear = [("/rear", 1.0, self.scan(1.0))]
        return sorted(scans + moves + rear, key=lambda item: item[1])


def bag1(directory: Path) -> Path:
    sample, path = Sample(Stores.ROS1_NOETIC), directory / "a.bag"
    with rosbag1.Writer(path) as writer:
        connections = {}
        for topic, stamp, message in sample.messages():
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=sample.store)
            data = sample.store.serialize_ros1(message, kind)
            writer.write(connections[topic], round(stamp * 1e9), data)
    return path


def bag2(directory: Path, storage: rosbag2.StoragePlugin) -> Path:
    sample, path = Sample(Stores.ROS2_HUMBLE), directory / "bag"
    with rosbag2.Writer(path, version=9, storage_plugin=storage) as writer:
        connections = {}
        for topic, stamp, message in sample.messages():
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=sample.store)
            writer.write(connections[topic], round(stamp * 1e9), sample.store.serialize_cdr(message, kind))
    return path


WRITERS: dict[str, Callable[[Path], Path]] = {
    "ros1": bag1,
    "db3": lambda directory: bag2(directory, rosbag2.StoragePlugin.SQLITE3),
    "mcap": lambda directory: bag2(directory, rosbag2.StoragePlugin.MCAP),
}
