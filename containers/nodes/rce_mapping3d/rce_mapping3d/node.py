"""ROS 2 node `mapper`: one map of the cameras, or of the lidars, of one robot or of several.

The parameter `robots` lists their names; topics of a robot are then under its name, otherwise there is one robot
without a prefix. See `member` for the topics. A first, empty `map` means that the node is ready.
"""

from __future__ import annotations

from rce_mapping.parameters import INTERVAL, number, text, texts
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node

from rce.mapping3d.offload.shared_map import MAIN, SharedMap
from rce.mapping3d.sensors import CAMERA, checked_sensor

from .member import Member
from .services import Services

ONLY = "robot"  # name of the robot where `robots` is empty


class Mapper3dNode(Node):
    """Node around a `SharedMap`.

    Attributes:
        shared: The map.
        map_frame: Frame of the map before there are key frames.
        sensor_frame: Frame of a camera or lidar in tf, below the name of its robot.
    """

    def __init__(self) -> None:
        """Declare the parameters and start an empty map."""
        super().__init__("mapper")
        robots = texts(
            self, "robots", "Names of robots that map together; empty: one robot, whose topics have no prefix."
        )
        limits = [FloatingPointRange(from_value=0.1, to_value=3600.0, step=0.0)]
        described = ParameterDescriptor(
            description="Wall time between publications of path, map and cloud, seconds.",
            floating_point_range=limits,
            read_only=True,
        )
        self.declare_parameter(INTERVAL, 5.0, described)
        described = ParameterDescriptor(description="Frame of a camera in tf.", read_only=True)
        self.declare_parameter("camera_frame", "camera_optical_frame", described)
        described = ParameterDescriptor(description="Frame of a lidar in tf.", read_only=True)
        self.declare_parameter("lidar_frame", "lidar", described)
        described = ParameterDescriptor(description="What robots measure with: camera or lidar.", read_only=True)
        self.declare_parameter("sensor", CAMERA, described)
        sensor = checked_sensor(text(self, "sensor"))
        self.map_frame, self.sensor_frame = MAIN, text(self, f"{sensor}_frame")
        self.shared = SharedMap(robots or [ONLY], sensor)
        self.members = [Member(self, name, f"{name}/" if robots else "") for name in self.shared.robots]
        self._control_services = Services(self)
        self.create_timer(number(self, INTERVAL), self.publish)
        self.publish()

    def tell(self) -> None:
        """Tell all robots which of their key frames have moved."""
        for member in self.members:
            member.tell()

    def publish(self) -> None:
        """Publish what has changed."""
        for member in self.members:
            member.publish()

    def use(self, shared: SharedMap) -> None:
        """Continue with another map."""
        self.shared.close()
        self.shared = shared
        for member in self.members:
            member.restart()
        self.publish()
