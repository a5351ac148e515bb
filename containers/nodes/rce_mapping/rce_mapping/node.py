"""A mapper as a ROS 2 node.

In: `scan`; `odom`, or the odometry in `/tf`; where the laser is on the robot from `/tf_static`; `initialpose`. Out:
`map` (its first publication, still empty, says that the node is ready), `map_updates`, `pose` (one for each scan, with
the stamp of the scan, whatever the scan is worth: it is also the acknowledgement that lets a sender pace itself),
`path`, and in `/tf` the correction of the odometry. Services: `dynamic_map`, and those of services.py.
"""

from __future__ import annotations

from builtin_interfaces.msg import Time
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetMap
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.timer import Timer

from rce.mapping.mapper import Mapper
from rce.mapping.mappers import MAPPERS

from . import messages
from .map_output import MapOutput
from .parameters import INTERVAL, MAPPER, UPDATES, choice, declare, number, settings_of, text
from .services import Services
from .track import Track


class MapperNode(Node):
    """Feeds a mapper with what arrives and publishes what it says."""

    def __init__(self) -> None:
        super().__init__("mapper")
        declare(self, list(MAPPERS))
        self.settings = settings_of(self)
        self._kind = MAPPERS[choice(self, MAPPER, list(MAPPERS))]
        self._published = -1  # how many scans the last map has
        self._map_out = MapOutput(self, text(self, "map_frame"))
        self.track = Track(self, lambda scan: self.mapper.add(scan))
        self.create_service(GetMap, "dynamic_map", self._on_get_map)
        self._steering = Services(self)
        self._map_timer = self.create_timer(number(self, INTERVAL), self.publish)
        self._update_timer = self._timer_of_updates(number(self, UPDATES))
        self.add_post_set_parameters_callback(self._on_parameters)
        self.reset()

    def reset(self) -> None:
        """Forget the map and begin a new one."""
        self.begin(self._kind(self.settings))

    def begin(self, mapper: Mapper) -> None:
        """Go on with this mapper."""
        self.mapper = mapper
        self.track.restart([messages.stamp_of(row[0]) for row in mapper.trajectory()])
        self._published = -1
        self.publish()

    def publish(self) -> None:
        """Publish map and path, if there is anything new."""
        if self._published != len(self.track.stamps):
            self._publish_path()
            self._publish_map()

    def _publish_path(self) -> None:
        self.track.publish_path(self.mapper.trajectory())

    def _publish_map(self) -> OccupancyGrid:
        self._published = len(self.track.stamps)
        return self._map_out.publish(self.mapper.grid(), self._stamp())

    def _update(self) -> None:
        if self._map_out.followed and self._published != len(self.track.stamps):
            self._map_out.update(self.mapper.grid(), self._stamp())

    def _stamp(self) -> Time:
        return self.track.stamps[-1] if self.track.stamps else self.get_clock().now().to_msg()

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
