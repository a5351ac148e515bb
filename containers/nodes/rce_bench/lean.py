"""Common base of the benchmark's nodes: a node with as little overhead as rclpy allows, and its main function."""

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
SERVICE = AddDiagnostics  # a string in the request, a string in the response


class LeanNode(Node):
    """Node without parameter services and log topic: at each wake-up an executor of rclpy looks at every entity."""

    def __init__(self, name: str) -> None:
        """Create a node of this name."""
        super().__init__(name, start_parameter_services=False, enable_rosout=False)


def run(make: Callable[[list[str]], Node]) -> int:
    """Run a node until SIGINT or SIGTERM; return the exit status.

    Args:
        make: Returns the node, given the arguments of the command line without those of ROS.
    """
    rclpy.init()
    try:
        rclpy.spin(make(remove_ros_args(sys.argv)[1:]))
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    finally:
        rclpy.try_shutdown()
    return 0
