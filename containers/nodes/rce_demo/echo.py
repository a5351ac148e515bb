#!/usr/bin/env python3
"""Minimal ROS 2 node: publishes each message of the topic /say on the topic /heard."""

import signal

import rclpy
from rclpy.node import Node
from std_msgs.msg import String


def main() -> None:
    """Run the node until SIGINT or SIGTERM."""
    # Installed before rclpy, whose handlers call these as well: a signal during its start could be lost otherwise.
    # They do not raise KeyboardInterrupt: in the middle of rclpy that would leave half-made objects behind.
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: signals.append(number))
    rclpy.init()
    try:
        node = Node("echo")
        publisher = node.create_publisher(String, "/heard", 10)
        node.create_subscription(String, "/say", publisher.publish, 10)
        if not signals:
            rclpy.spin(node)
    except Exception:  # rclpy stops at these signals; what it is doing then fails with one of several errors
        if not signals:
            raise


if __name__ == "__main__":
    main()
