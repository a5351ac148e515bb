"""ROS 2 node `localiser`: finds and tracks a robot in a stored map, with the names of Nav2's AMCL.

Subscriptions: `map` (transient local), `scan`, `odom` or the odometry in `/tf`, `/tf_static` for the pose of the laser
on the robot, `initialpose`. Publications: `amcl_pose` (transient local) for each scan that was used while the pose is
known, `localised` (transient local): whether it is, and the transform from the map to the odometry. Services:
`reinitialize_global_localization` and `request_nomotion_update`.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from rce_mapping import messages
from rce_mapping.map_output import LATCHED
from rce_mapping.paired_scans import Frames, PairedScans
from rce_mapping.parameters import flag, number, text
from rce_mapping.transforms import TransformSender
from rclpy.node import Node
from std_msgs.msg import Bool
from std_srvs.srv import Empty

from rce.errors import InvalidRequest
from rce.mapping.geometry import Pose
from rce.mapping.localiser import Localiser
from rce.mapping.mapper import Estimate, MapperSettings
from rce.mapping.scans import Scan

from .parameters import declare, initial_pose

LONGEST = 200.0  # metres; of beams without another limit


class LocaliserNode(Node):
    """Node around a `Localiser`, which exists from the first map on."""

    def __init__(self) -> None:
        """Declare the parameters, and wait for a map."""
        super().__init__("localiser", automatically_declare_parameters_from_overrides=True)
        declare(self)
        longest = number(self, "laser_max_range")
        self._max_range = longest if longest > 0 else LONGEST
        self._min_range = number(self, "laser_min_range")
        self._min_motion = number(self, "update_min_d"), number(self, "update_min_a")
        self._frame = text(self, "global_frame_id")
        self._localiser: Localiser | None = None
        self._pose: Pose | None = None  # of the robot at the last scan that was used, while it is known
        self._used: Pose | None = None  # odometry of that scan
        self._start: list[Pose | None] = []  # pose of the robot to continue from with the next scan; None: search it
        self._update_requested = False
        frames = Frames(text(self, "odom_frame_id"), text(self, "base_frame_id"))
        broadcast = flag(self, "tf_broadcast")
        self._transforms = TransformSender(self, self._frame, frames.odom, frames.base) if broadcast else None
        self._pose_out = self.create_publisher(PoseWithCovarianceStamped, "amcl_pose", LATCHED)
        self._localised_out = self.create_publisher(Bool, "localised", LATCHED)
        self._localised = False
        self._localised_out.publish(Bool(data=False))
        self.create_subscription(OccupancyGrid, text(self, "map_topic"), self._on_map, LATCHED)
        self.create_subscription(PoseWithCovarianceStamped, "initialpose", self._on_initial_pose, 10)
        self.create_service(Empty, "reinitialize_global_localization", self._on_search)
        self.create_service(Empty, "request_nomotion_update", self._on_update)
        self._scans = PairedScans(self, frames, self._on_scan, text(self, "scan_topic"), "odom")

    # --- what changes the start ---------------------------------------------------------------------------------------

    def _on_map(self, message: OccupancyGrid) -> None:
        """Localise in a map from the next scan on: from the last pose, or else the initial one."""
        if self._localiser is not None and flag(self, "first_map_only"):
            return
        try:
            grid = messages.grid_from(message)
        except InvalidRequest as error:
            self.get_logger().error(f"a map is not used: {error}")
            return
        settings = MapperSettings(resolution=grid.resolution, max_range=self._max_range)
        self._localiser = Localiser(grid, settings=settings)
        if self._start and not flag(self, "always_reset_initial_pose"):
            return  # an initial pose that came before the map
        keep = self._pose is not None and not flag(self, "always_reset_initial_pose")
        self._start = [self._pose if keep else initial_pose(self)]

    def _on_initial_pose(self, message: PoseWithCovarianceStamped) -> None:
        frame = message.header.frame_id.lstrip("/")
        if frame not in ("", self._frame):
            self.get_logger().warning(f"an initial pose in the frame {frame!r} is ignored; it must be in {self._frame}")
            return
        self._start = [messages.pose_from(message)]

    def _on_search(self, _request: Empty.Request, response: Empty.Response) -> Empty.Response:
        """Search the robot in the whole map."""
        self._start = [None]
        self._report(None)
        return response

    def _on_update(self, _request: Empty.Request, response: Empty.Response) -> Empty.Response:
        """Use the next scan even if the robot does not move."""
        self._update_requested = True
        return response

    # --- scans --------------------------------------------------------------------------------------------------------

    def _on_scan(self, stamp: Time, scan: Scan) -> None:
        if self._localiser is None:
            return
        if self._start:
            start = self._start.pop()
            self._localiser.relocate(start @ self._scans.laser if start else None)
            self._used = None
        if self._is_due(scan):
            self._use(self._localiser, stamp, scan)
        elif self._pose and self._used and scan.odometry:
            self._send_transform(stamp, self._pose @ self._used.to(scan.odometry), scan.odometry)

    def _is_due(self, scan: Scan) -> bool:
        """Return whether a scan is used: the robot has moved, or nobody knows whether it has, or it was requested."""
        if self._update_requested or self._pose is None or self._used is None or scan.odometry is None:
            return True
        motion = self._used.to(scan.odometry)
        way, turn = self._min_motion
        return bool(math.hypot(motion.x, motion.y) >= way or abs(motion.theta) >= turn)

    def _use(self, localiser: Localiser, stamp: Time, scan: Scan) -> None:
        self._update_requested = False
        estimate = self._localise(localiser, scan)
        if localiser.lost:
            self._report(None)
        elif estimate.accepted:  # and not late
            self._used = scan.odometry
            self._report(estimate.pose)
            self._pose_out.publish(messages.pose_message(estimate, stamp, self._frame))
            self._send_transform(stamp, estimate.pose, scan.odometry)

    def _localise(self, localiser: Localiser, scan: Scan) -> Estimate:
        """Return the pose of the robot at a scan."""
        laser = self._scans.laser
        ranges = scan.ranges
        if self._min_range > 0:
            ranges = np.where(ranges < self._min_range, np.float32(np.nan), ranges)
        found = localiser.add(replace(scan, ranges=ranges, odometry=scan.odometry and scan.odometry @ laser))
        return replace(found, pose=found.pose @ laser.inverse())

    def _report(self, pose: Pose | None) -> None:
        """Keep the pose, and tell when it becomes known or unknown."""
        self._pose = pose
        if self._localised == (pose is not None):
            return
        self._localised = pose is not None
        self._localised_out.publish(Bool(data=self._localised))
        if pose is None:
            self.get_logger().warning("the robot is lost: it is searched in the whole map while it drives")
        else:
            self.get_logger().info(f"the robot is at x {pose.x:.2f}, y {pose.y:.2f}, yaw {pose.theta:.2f}")

    def _send_transform(self, stamp: Time, pose: Pose, odometry: Pose | None) -> None:
        if self._transforms is not None:
            valid = messages.stamp_of(messages.seconds(stamp) + number(self, "transform_tolerance"))
            self._transforms.send(valid, pose, odometry)
