#!/usr/bin/env python3
"""Minimal ROS 2 node: publishes each message of the topic /say on the topic /heard."""

import signal

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

CHECK_INTERVAL = 0.2  # seconds
# Messages that wait in each direction. Robots send bursts, for instance all that they stored while they were offline;
# ROS 2's usual depth of 10 would drop most of them.
DEPTH = 1000


def main() -> None:
    """Run the node until SIGINT or SIGTERM."""
    # rclpy's own handlers miss a signal that comes while its executor starts, and then wait for ever.
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: signals.append(number))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("echo")
    publisher = node.create_publisher(String, "/heard", DEPTH)
    node.create_subscription(String, "/say", publisher.publish, DEPTH)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not signals:
        executor.spin_once(timeout_sec=CHECK_INTERVAL)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
