"""What the benchmark's nodes share: a node with as little beside its own work as rclpy allows, and how it is run."""

from __future__ import annotations

import sys
from collections.abc import Callable

import rclpy
from diagnostic_msgs.srv import AddDiagnostics
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import Image
from std_msgs.msg import String, UInt8MultiArray

DEPTH = 10
TOPICS = {"string": String, "bytes": UInt8MultiArray, "image": Image}
SERVICE = AddDiagnostics  # a string in, a string out


class LeanNode(Node):
    """Without parameter services and log topic: rclpy's executors look at every entity at every wake."""

    def __init__(self, name: str) -> None:
        super().__init__(name, start_parameter_services=False, enable_rosout=False)


def run(make: Callable[[list[str]], Node]) -> int:
    """Run a node, made from the command line's words, until SIGINT or SIGTERM."""
    rclpy.init()
    try:
        rclpy.spin(make(remove_ros_args(sys.argv)[1:]))
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    finally:
        rclpy.try_shutdown()
    return 0
