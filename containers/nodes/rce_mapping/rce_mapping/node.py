"""A mapper as a ROS 2 node.

In: `scan`; `odom`, or the odometry in `/tf`; where the laser is on the robot from `/tf_static`. Out: `map`
(its first publication, still empty, says that the node is ready), `map_updates`, `pose` (one for each scan, with the
stamp of the scan, whatever the scan is worth: it is also the acknowledgement that lets a sender pace itself), `path`,
and in `/tf` the correction of the odometry. Services: `dynamic_map`, and those of services.py.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import replace

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Path
from nav_msgs.srv import GetMap
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.timer import Timer
from sensor_msgs.msg import LaserScan

from rce.mapping.geometry import ORIGIN, Pose, moved
from rce.mapping.mapper import UNCERTAIN, Estimate, Mapper, MapperSettings
from rce.mapping.mappers import MAPPERS
from rce.mapping.pairing import OdometryPairing
from rce.mapping.scans import Scan

from . import messages
from .inputs import EVERYTHING, ScanInput, Transforms, listen_to_odometry
from .map_output import LATCHED, MapOutput
from .parameters import INTERVAL, MAPPER, UPDATES, choice, declare, flag, number, text
from .services import Services
from .transforms import TransformSender

CHECK = 0.1  # seconds between looks at scans that wait for odometry


class MapperNode(Node):
    """Feeds a mapper with what arrives and publishes what it says."""

    def __init__(self) -> None:
        super().__init__("mapper")
        declare(self, list(MAPPERS))
        self._settings = MapperSettings(
            resolution=number(self, "resolution"),
            max_range=number(self, "max_range"),
            particles=int(number(self, "particles")),
            seed=int(number(self, "seed")),
        )
        self._kind = MAPPERS[choice(self, MAPPER, list(MAPPERS))]
        self.paused = False
        self.frame = text(self, "map_frame")
        self._timeout = number(self, "odom_timeout")
        self._arrivals: deque[tuple[LaserScan, float]] = deque()  # each scan that waits, and its monotonic time
        self._laser = ORIGIN  # where it is on the robot, as known at the first scan
        self._seen = False
        self._pose = ORIGIN  # of the robot, at the last scan
        frames = text(self, "odom_frame"), text(self, "base_frame")
        self._base = frames[1]
        self._corrections = TransformSender(self, self.frame, *frames)
        self._map_out = MapOutput(self, self.frame)
        self._path_out = self.create_publisher(Path, "path", LATCHED)
        self._pose_out = self.create_publisher(PoseWithCovarianceStamped, "pose", EVERYTHING)
        from_tf = flag(self, "odometry_from_tf")
        self._odometry_expected = flag(self, "use_odometry")
        if self._odometry_expected and not from_tf:
            listen_to_odometry(self, self._on_odometry)
        self._transforms = Transforms(self, *frames, self._on_odometry if from_tf else None)
        self.scans = ScanInput(self, self._on_scan)
        self.create_service(GetMap, "dynamic_map", self._on_get_map)
        self._steering = Services(self)
        self.create_timer(CHECK, self._end_wait)
        self._map_timer = self.create_timer(number(self, INTERVAL), self.publish)
        self._update_timer = self._timer_of_updates(number(self, UPDATES))
        self.add_post_set_parameters_callback(self._on_parameters)
        self.begin(self._kind(self._settings))

    # --- for the services

    def begin(self, mapper: Mapper, last: Estimate | None = None) -> None:
        """Go on with this mapper, whose last estimate was `last`."""
        self.mapper = mapper
        self._pairing = OdometryPairing()
        self._arrivals.clear()
        self._stamps: list[Time] = [messages.stamp_of(row[0]) for row in mapper.trajectory()]
        self._published = -1  # how many of them the last map has
        if last is not None:
            self._pose = last.pose @ self._laser.inverse()
        self.publish()

    def reset(self) -> None:
        """Forget the map and begin a new one."""
        self.begin(self._kind(self._settings))

    def publish(self) -> None:
        """Publish map and path, if there is anything new."""
        if self._published != len(self._stamps):
            self._publish_path()
            self._publish_map()

    # --- what comes in

    def _on_odometry(self, stamp: Time, pose: Pose) -> None:
        self._odometry_expected = True
        self._pairing.add_odometry(messages.seconds(stamp), pose)
        self._map(self._pairing.ready())

    def _on_scan(self, message: LaserScan) -> None:
        if not self._seen:
            self._seen, self._laser = True, self._transforms.place(message.header.frame_id)
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
                self._stamps.append(stamp)
            self._pose = estimate.pose
            self._pose_out.publish(messages.pose_message(estimate, stamp, self.frame))
            self._corrections.send(stamp, estimate.pose, scan.odometry)

    def _estimate(self, scan: Scan) -> Estimate:
        """Where the robot was at this scan. Mappers know the laser only."""
        if self.paused:
            return Estimate(scan.stamp, self._pose, UNCERTAIN, matched=False, taken=False)
        odometry = scan.odometry and scan.odometry @ self._laser
        found = self.mapper.add(replace(scan, odometry=odometry))
        return replace(found, pose=found.pose @ self._laser.inverse())

    # --- what goes out

    def _publish_path(self) -> None:
        trajectory = moved(self.mapper.trajectory(), self._laser.inverse())
        self._path_out.publish(messages.path_message(trajectory, self._stamps, self.frame))

    def _publish_map(self) -> OccupancyGrid:
        self._published = len(self._stamps)
        return self._map_out.publish(self.mapper.grid(), self._stamp())

    def _update(self) -> None:
        if self._map_out.followed and self._published != len(self._stamps):
            self._map_out.update(self.mapper.grid(), self._stamp())

    def _stamp(self) -> Time:
        return self._stamps[-1] if self._stamps else self.get_clock().now().to_msg()

    def _on_get_map(self, _request: GetMap.Request, response: GetMap.Response) -> GetMap.Response:
        self._publish_path()
        response.map = self._publish_map()
        return response

    def _timer_of_updates(self, seconds: float) -> Timer | None:
        return self.create_timer(seconds, self._update) if seconds else None

    def _on_parameters(self, parameters: list[Parameter[float]]) -> None:
        for parameter in parameters:
            if parameter.name == INTERVAL:
                self.destroy_timer(self._map_timer)
                self._map_timer = self.create_timer(parameter.value, self.publish)
            elif parameter.name == UPDATES:
                if self._update_timer is not None:
                    self.destroy_timer(self._update_timer)
                self._update_timer = self._timer_of_updates(parameter.value)
