"""Topics of one robot: its scans and odometry go to a mapper, a pose for each scan and the path come back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Path
from numpy.typing import NDArray
from rclpy.node import Node

from rce.mapping.geometry import ORIGIN, Pose, trajectory_of_offset
from rce.mapping.mapper import UNMATCHED_COVARIANCE, Estimate
from rce.mapping.scans import Scan

from . import messages
from .inputs import LOSSLESS
from .map_output import LATCHED
from .paired_scans import Frames, PairedScans
from .parameters import text
from .transforms import TransformSender


class Track:
    """Topics `scan`, `odom`, `pose` and `path`, and tf, of one robot.

    Mappers know only the laser.

    Attributes:
        paused: Whether scans are answered with the last pose and not mapped.
        stamps: Stamps of the scans that were mapped.
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
        self._pose = ORIGIN  # pose of the robot at the last scan
        own = Frames(f"{prefix}{text(node, 'odom_frame')}", f"{prefix}{text(node, 'base_frame')}")
        self._corrections = TransformSender(node, self._frame, own.odom, own.base)
        self._path_out = node.create_publisher(Path, f"{prefix}path", LATCHED)
        self._pose_out = node.create_publisher(PoseWithCovarianceStamped, f"{prefix}pose", LOSSLESS)
        self._scans = PairedScans(node, own, self._on_scan, f"{prefix}scan", f"{prefix}odom")

    def restart(self, trajectory: NDArray[np.float64]) -> None:
        """Continue with another mapper. Waiting scans are answered, but not mapped.

        Args:
            trajectory: (n, 4) stamp, x, y, theta of the laser at each scan that this mapper has mapped, map frame.
        """
        self.stamps = [messages.stamp_of(row[0]) for row in trajectory]
        laser = self._scans.laser
        self._pose = Pose(*trajectory[-1, 1:].tolist()) @ laser.inverse() if len(trajectory) else ORIGIN
        for stamp, scan in self._scans.drain():
            self._answer(self._unmapped(scan), stamp, scan)

    def in_laser_frame(self, robot: Pose) -> Pose:
        """Return the pose of the laser when the robot is at a pose."""
        return robot @ self._scans.laser

    def publish_path(self, trajectory: NDArray[np.float64]) -> None:
        """Publish the path of the robot.

        Args:
            trajectory: (n, 4) stamp, x, y, theta of the laser at each scan that was mapped, map frame.
        """
        path = trajectory_of_offset(trajectory, self._scans.laser.inverse())
        self._path_out.publish(messages.path_message(path, self.stamps, self._frame))

    def _on_scan(self, stamp: Time, scan: Scan) -> None:
        """Map a scan and publish the answer."""
        self._answer(self._unmapped(scan) if self.paused else self._mapped(scan), stamp, scan)

    def _answer(self, estimate: Estimate, stamp: Time, scan: Scan) -> None:
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
        laser = self._scans.laser
        odometry = scan.odometry and scan.odometry @ laser
        found = self._add(replace(scan, odometry=odometry))
        return replace(found, pose=found.pose @ laser.inverse())
