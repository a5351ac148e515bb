"""Topics of one robot: its scans and odometry go to a mapper, a pose for each scan and the path come back."""

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

from rce.mapping.geometry import ORIGIN, Pose, trajectory_of_offset
from rce.mapping.mapper import UNMATCHED_COVARIANCE, Estimate
from rce.mapping.pairing import OdometryPairing
from rce.mapping.scans import Scan

from . import messages
from .inputs import LOSSLESS, ScanInput, Transforms, subscribe_to_odometry
from .map_output import LATCHED
from .parameters import flag, number, text
from .transforms import TransformSender

CHECK_INTERVAL = 0.1  # seconds between checks for scans that have waited too long for odometry


class Track:
    """Topics `scan`, `odom`, `pose` and `path`, and tf, of one robot.

    Mappers know only the laser; its pose on the robot is looked up at the first scan.

    Attributes:
        paused: Whether scans are answered with the last pose and not mapped.
        stamps: Stamps of the scans that were mapped.
        transforms: Transforms of the robot.
        scans: Subscription to the scans.
    """

    def __init__(self, node: Node, add: Callable[[Scan], Estimate], prefix: str = "") -> None:
        """Create the topics.

        Args:
            node: Node whose parameters apply.
            add: Maps a scan.
            prefix: Prefix of the names of topics, `NAME/` or empty.
        """
        self.paused = False
        self.stamps: list[Time] = []
        self._add = add
        self._frame = text(node, "map_frame")
        self._timeout = number(node, "odom_timeout")
        self._arrivals: deque[tuple[LaserScan, float]] = deque()  # waiting scans with the monotonic time of arrival
        self._pairing = OdometryPairing()
        self._laser = ORIGIN  # pose on the robot
        self._laser_known = False
        self._pose = ORIGIN  # pose of the robot at the last scan
        frames = text(node, "odom_frame"), text(node, "base_frame")
        own = [f"{prefix}{frame}" for frame in frames]
        self._corrections = TransformSender(node, self._frame, own[0], own[1])
        self._path_out = node.create_publisher(Path, f"{prefix}path", LATCHED)
        self._pose_out = node.create_publisher(PoseWithCovarianceStamped, f"{prefix}pose", LOSSLESS)
        from_tf = flag(node, "odometry_from_tf")
        self._odometry_expected = flag(node, "use_odometry")
        if self._odometry_expected and not from_tf:
            subscribe_to_odometry(node, f"{prefix}odom", self._on_odometry)
        self.transforms = Transforms(node, own[0], own[1], self._on_odometry if from_tf else None)
        self.scans = ScanInput(node, f"{prefix}scan", self._on_scan)
        node.create_timer(CHECK_INTERVAL, self._flush_overdue)

    def restart(self, trajectory: NDArray[np.float64]) -> None:
        """Continue with another mapper. Waiting scans are answered, but not mapped.

        Args:
            trajectory: (n, 4) stamp, x, y, theta of the laser at each scan that this mapper has mapped, map frame.
        """
        self.stamps = [messages.stamp_of(row[0]) for row in trajectory]
        self._pose = Pose(*trajectory[-1, 1:].tolist()) @ self._laser.inverse() if len(trajectory) else ORIGIN
        for scan in self._pairing.flush():
            self._answer(self._unmapped(scan), scan)
        self._pairing = OdometryPairing()

    def in_laser_frame(self, robot: Pose) -> Pose:
        """Return the pose of the laser when the robot is at a pose."""
        return robot @ self._laser

    def publish_path(self, trajectory: NDArray[np.float64]) -> None:
        """Publish the path of the robot.

        Args:
            trajectory: (n, 4) stamp, x, y, theta of the laser at each scan that was mapped, map frame.
        """
        path = trajectory_of_offset(trajectory, self._laser.inverse())
        self._path_out.publish(messages.path_message(path, self.stamps, self._frame))

    def _on_odometry(self, stamp: Time, pose: Pose) -> None:
        self._odometry_expected = True
        self._pairing.add_odometry(messages.seconds(stamp), pose)
        self._map(self._pairing.ready())

    def _on_scan(self, message: LaserScan) -> None:
        if not self._laser_known:
            self._laser_known, self._laser = True, self.transforms.lookup(message.header.frame_id)
        self._arrivals.append((message, time.monotonic()))
        self._pairing.add_scan(messages.scan_from(message))
        self._map(self._pairing.ready() if self._odometry_expected else self._pairing.flush())

    def _flush_overdue(self) -> None:
        """Map scans whose odometry has not come in time. No other scan waits until there is odometry again."""
        if self._arrivals and time.monotonic() - self._arrivals[0][1] > self._timeout:
            self._odometry_expected = False
            self._map(self._pairing.flush())

    def _map(self, scans: list[Scan]) -> None:
        """Map scans and publish the answers."""
        for scan in scans:
            estimate = self._unmapped(scan) if self.paused else self._mapped(scan)
            self._answer(estimate, scan)

    def _answer(self, estimate: Estimate, scan: Scan) -> None:
        """Publish the answer to the scan that has waited longest."""
        stamp = self._arrivals.popleft()[0].header.stamp
        if estimate.accepted:
            self.stamps.append(stamp)
        self._pose = estimate.pose
        self._pose_out.publish(messages.pose_message(estimate, stamp, self._frame))
        self._corrections.send(stamp, estimate.pose, scan.odometry)

    def _unmapped(self, scan: Scan) -> Estimate:
        """Return the last pose as the answer to a scan."""
        return Estimate(scan.stamp, self._pose, UNMATCHED_COVARIANCE, matched=False, accepted=False)

    def _mapped(self, scan: Scan) -> Estimate:
        """Map a scan; return the pose of the robot at it."""
        odometry = scan.odometry and scan.odometry @ self._laser
        found = self._add(replace(scan, odometry=odometry))
        return replace(found, pose=found.pose @ self._laser.inverse())
