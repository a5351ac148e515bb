"""One robot's way through a mapper: its scans and odometry in, a pose for each scan and the path out."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Path
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import LaserScan

from rce.mapping.geometry import ORIGIN, Pose, moved
from rce.mapping.mapper import UNCERTAIN, Estimate
from rce.mapping.pairing import OdometryPairing
from rce.mapping.scans import Scan

from . import messages
from .inputs import EVERYTHING, ScanInput, Transforms, listen_to_odometry
from .map_output import LATCHED
from .parameters import flag, number, text
from .transforms import TransformSender

CHECK = 0.1  # seconds between looks at scans that wait for odometry


class Track:
    """Topics `scan`, `odom`, `pose` and `path` under `prefix`, and tf. `add` takes a scan to the mapper.

    Mappers know the laser only; where it is on the robot is looked up at the first scan.
    """

    def __init__(self, node: Node, add: Callable[[Scan], Estimate], prefix: str = "") -> None:
        self.paused = False
        self.stamps: list[Time] = []  # of the scans that were mapped
        self._add = add
        self._frame = text(node, "map_frame")
        self._timeout = number(node, "odom_timeout")
        self._arrivals: deque[tuple[LaserScan, float]] = deque()  # each scan that waits, and its monotonic time
        self._pairing = OdometryPairing()
        self._laser = ORIGIN
        self._seen = False
        self._pose = ORIGIN  # of the robot, at the last scan
        frames = text(node, "odom_frame"), text(node, "base_frame")
        own = [f"{prefix}{frame}" for frame in frames]
        self._corrections = TransformSender(node, self._frame, own[0], own[1])
        self._path_out = node.create_publisher(Path, f"{prefix}path", LATCHED)
        self._pose_out = node.create_publisher(PoseWithCovarianceStamped, f"{prefix}pose", EVERYTHING)
        from_tf = flag(node, "odometry_from_tf")
        self._odometry_expected = flag(node, "use_odometry")
        if self._odometry_expected and not from_tf:
            listen_to_odometry(node, f"{prefix}odom", self._on_odometry)
        self.transforms = Transforms(node, own[0], own[1], self._on_odometry if from_tf else None)
        self.scans = ScanInput(node, f"{prefix}scan", self._on_scan)
        node.create_timer(CHECK, self._end_wait)

    def restart(self, stamps: list[Time]) -> None:
        """Go on with a mapper that has mapped the scans of these stamps."""
        self.stamps = stamps
        self._pairing = OdometryPairing()
        self._arrivals.clear()

    def in_laser_frame(self, robot: Pose) -> Pose:
        """The pose of the laser, where the robot is there."""
        return robot @ self._laser

    def publish_path(self, trajectory: NDArray[np.float64]) -> None:
        """`trajectory`: (n, 4) stamp, x, y, theta of the laser at each scan that was mapped, map frame."""
        way = moved(trajectory, self._laser.inverse())
        self._path_out.publish(messages.path_message(way, self.stamps, self._frame))

    def _on_odometry(self, stamp: Time, pose: Pose) -> None:
        self._odometry_expected = True
        self._pairing.add_odometry(messages.seconds(stamp), pose)
        self._map(self._pairing.ready())

    def _on_scan(self, message: LaserScan) -> None:
        if not self._seen:
            self._seen, self._laser = True, self.transforms.place(message.header.frame_id)
        self._arrivals.append((message, time.monotonic()))
        self._pairing.add_scan(messages.scan_from(message))
        self._map(self._pairing.ready() if self._odometry_expected else self._pairing.flush())

    def _end_wait(self) -> None:
        """Map scans whose odometry does not come. Until there is some again, no other scan waits."""
        if self._arrivals and time.monotonic() - self._arrivals[0][1] > self._timeout:
            self._odometry_expected = False
            self._map(self._pairing.flush())

    def _map(self, scans: list[Scan]) -> None:
        for scan in scans:
            stamp = self._arrivals.popleft()[0].header.stamp
            estimate = self._estimate(scan)
            if estimate.taken:
                self.stamps.append(stamp)
            self._pose = estimate.pose
            self._pose_out.publish(messages.pose_message(estimate, stamp, self._frame))
            self._corrections.send(stamp, estimate.pose, scan.odometry)

    def _estimate(self, scan: Scan) -> Estimate:
        """Where the robot was at this scan."""
        if self.paused:
            return Estimate(scan.stamp, self._pose, UNCERTAIN, matched=False, taken=False)
        odometry = scan.odometry and scan.odometry @ self._laser
        found = self._add(replace(scan, odometry=odometry))
        return replace(found, pose=found.pose @ self._laser.inverse())
