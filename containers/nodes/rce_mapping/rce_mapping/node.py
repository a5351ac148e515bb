"""ROS 2 node `mapper`: builds a map from the scans of one robot.

Subscriptions: `scan`; `odom`, or the odometry in `/tf`; `/tf_static` for the pose of the laser on the robot;
`initialpose`. Publications: `map` (the first, empty one means that the node is ready), `map_updates`, `path`, the
correction of the odometry in `/tf`, and `pose`: exactly one for each scan, with its stamp, even for an unusable scan,
so that a sender can limit how many scans are unanswered. Services: `dynamic_map`, and those of `services`.
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

from .map_output import MapOutput
from .parameters import INTERVAL, MAPPER, UPDATES, choice, declare, number, settings_of, text
from .services import Services
from .track import Track


class MapperNode(Node):
    """Node around a `Mapper`.

    Attributes:
        settings: Settings from the parameters.
        mapper: The current mapper.
        track: Scans, odometry, poses and path of the robot.
    """

    def __init__(self) -> None:
        """Declare the parameters and start an empty map."""
        super().__init__("mapper")
        declare(self, list(MAPPERS))
        self.settings = settings_of(self)
        self._kind = MAPPERS[choice(self, MAPPER, list(MAPPERS))]
        self._published = -1  # number of scans in the last published map
        self._map_out = MapOutput(self, text(self, "map_frame"))
        self.track = Track(self, lambda scan: self.mapper.add(scan))
        self.create_service(GetMap, "dynamic_map", self._on_get_map)
        self._control_services = Services(self)
        self._map_timer = self.create_timer(number(self, INTERVAL), self.publish)
        self._update_timer = self._create_update_timer(number(self, UPDATES))
        self.add_post_set_parameters_callback(self._on_parameters)
        self.reset()

    def reset(self) -> None:
        """Discard the map and start an empty one."""
        self.use(self._kind(self.settings))

    def use(self, mapper: Mapper) -> None:
        """Continue with another mapper."""
        self.mapper = mapper
        self.track.restart(mapper.trajectory())
        self._published = -1
        self.publish()

    def publish(self) -> None:
        """Publish map and path if there are new scans."""
        if self._published != len(self.track.stamps):
            self._publish_path()
            self._publish_map()

    def _publish_path(self) -> None:
        self.track.publish_path(self.mapper.trajectory())

    def _publish_map(self) -> OccupancyGrid:
        self._published = len(self.track.stamps)
        return self._map_out.publish(self.mapper.grid(), self._stamp())

    def _update(self) -> None:
        if self._map_out.has_update_subscribers and self._published != len(self.track.stamps):
            self._map_out.update(self.mapper.grid(), self._stamp())

    def _stamp(self) -> Time:
        return self.track.stamps[-1] if self.track.stamps else self.get_clock().now().to_msg()

    def _on_get_map(self, _request: GetMap.Request, response: GetMap.Response) -> GetMap.Response:
        self._publish_path()
        response.map = self._publish_map()
        return response

    def _create_update_timer(self, seconds: float) -> Timer | None:
        return self.create_timer(seconds, self._update) if seconds else None

    def _on_parameters(self, parameters: list[Parameter[float]]) -> None:
        for parameter in parameters:
            if parameter.name == INTERVAL:
                self.destroy_timer(self._map_timer)
                self._map_timer = self.create_timer(parameter.value, self.publish)
            elif parameter.name == UPDATES:
                if self._update_timer is not None:
                    self.destroy_timer(self._update_timer)
                self._update_timer = self._create_update_timer(parameter.value)
