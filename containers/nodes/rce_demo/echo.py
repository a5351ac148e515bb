#!/usr/bin/env python3
"""A node as small as they come: what is said on /say is heard on /heard."""

import signal

import rclpy
from rclpy.node import Node
from std_msgs.msg import String


def main() -> None:
    for number in (signal.SIGINT, signal.SIGTERM):  # before rclpy, which calls these too: alone it may miss one
        signal.signal(number, signal.default_int_handler)
    rclpy.init()
    node = Node("echo")
    heard = node.create_publisher(String, "/heard", 10)
    node.create_subscription(String, "/say", heard.publish, 10)
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        node.destroy_node()


if __name__ == "__main__":
    main()
