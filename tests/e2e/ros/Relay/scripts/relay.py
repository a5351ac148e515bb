#!/usr/bin/env python3
"""Send messages on /in_NAME back on /out_NAME, through Python objects, for each type PACKAGE/NAME in the arguments.

Subscriptions and publishers keep DEPTH messages, or as many as the first argument says.
"""

from __future__ import annotations

import importlib
import signal
import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

DEPTH = 1000  # for times when a busy machine does not run this node


class RelayNode(Node):
    def __init__(self, types: list[str]) -> None:
        super().__init__("relay")
        depth = int(types.pop(0)) if types[0].isdigit() else DEPTH
        for package, name in (each.split("/") for each in types):
            kind = getattr(importlib.import_module(f"{package}.msg"), name)
            out = self.create_publisher(kind, f"/out_{name}", depth)
            self.create_subscription(kind, f"/in_{name}", out.publish, depth)


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        with rclpy.init():
            rclpy.spin(RelayNode(remove_ros_args(sys.argv)[1:]))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # how a node is stopped
