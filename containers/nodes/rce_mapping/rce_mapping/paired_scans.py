"""Scans of one robot, each with its odometry, which comes as a separate stream."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from builtin_interfaces.msg import Time
from rclpy.node import Node
from sensor_msgs.msg import LaserScan

from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.pairing import OdometryPairing
from rce.mapping.scans import Scan

from . import messages
from .inputs import ScanInput, Transforms, subscribe_to_odometry
from .parameters import flag, number

CHECK_INTERVAL = 0.1  # seconds between checks for scans that have waited too long for odometry


class Frames(NamedTuple):
    """Names of the frames of one robot."""

    odom: str
    base: str


class PairedScans:
    """Topics `scan` and `odom`, or the odometry in tf. The parameters of the node say which odometry is used.

    Attributes:
        laser: Pose of the laser on the robot, which is looked up at the first scan.
    """

    def __init__(
        self, node: Node, frames: Frames, on_scan: Callable[[Time, Scan], None], scan_topic: str, odometry_topic: str
    ) -> None:
        """Subscribe to the topics, and call `on_scan` with the stamp of each scan as it was received, and the scan."""
        self.laser = ORIGIN
        self._laser_known = False
        self._on_paired = on_scan
        self._timeout = number(node, "odom_timeout")
        self._arrivals: deque[tuple[LaserScan, float]] = deque()  # waiting scans with the monotonic time of arrival
        self._pairing = OdometryPairing()
        from_tf = flag(node, "odometry_from_tf")
        self._odometry_expected = flag(node, "use_odometry")
        if self._odometry_expected and not from_tf:
            subscribe_to_odometry(node, odometry_topic, self._on_odometry)
        self._transforms = Transforms(node, frames.odom, frames.base, self._on_odometry if from_tf else None)
        self._scans = ScanInput(node, scan_topic, self._on_scan)
        node.create_timer(CHECK_INTERVAL, self._flush_overdue)

    def drain(self) -> list[tuple[Time, Scan]]:
        """Forget all odometry; return and remove the scans that wait, with their stamps."""
        waiting = [(self._arrivals.popleft()[0].header.stamp, scan) for scan in self._pairing.flush()]
        self._pairing = OdometryPairing()
        return waiting

    def _on_odometry(self, stamp: Time, pose: Pose) -> None:
        self._odometry_expected = True
        self._pairing.add_odometry(messages.seconds(stamp), pose)
        self._pass_on(self._pairing.ready())

    def _on_scan(self, message: LaserScan) -> None:
        if not self._laser_known:
            self._laser_known, self.laser = True, self._transforms.lookup(message.header.frame_id)
        self._arrivals.append((message, time.monotonic()))
        self._pairing.add_scan(messages.scan_from(message))
        self._pass_on(self._pairing.ready() if self._odometry_expected else self._pairing.flush())

    def _flush_overdue(self) -> None:
        """Pass on scans whose odometry has not come in time. No other scan waits until there is odometry again."""
        if self._arrivals and time.monotonic() - self._arrivals[0][1] > self._timeout:
            self._odometry_expected = False
            self._pass_on(self._pairing.flush())

    def _pass_on(self, scans: list[Scan]) -> None:
        for scan in scans:
            self._on_paired(self._arrivals.popleft()[0].header.stamp, scan)
