#!/usr/bin/env python3
"""Publish a latched map once, numbers with best effort continuously, and on /go the requested number of large texts."""

from __future__ import annotations

import itertools
import signal

import rclpy
from nav_msgs.msg import MapMetaData, OccupancyGrid
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Int32, String

SIZE = 10_000
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
EVERYTHING = QoSProfile(history=HistoryPolicy.KEEP_ALL)


class SourceNode(Node):
    def __init__(self) -> None:
        super().__init__("source")
        self.map = self.create_publisher(OccupancyGrid, "/map", LATCHED)
        self.map.publish(OccupancyGrid(info=MapMetaData(width=2, height=2, resolution=0.5), data=[0, 100, -1, 50]))
        self.fast = self.create_publisher(Int32, "/fast", BEST_EFFORT)
        self.numbers = itertools.count()
        self.create_timer(0.02, lambda: self.fast.publish(Int32(data=next(self.numbers))))
        self.texts = self.create_publisher(String, "/texts", EVERYTHING)
        self.create_subscription(Int32, "/go", self.go, 10)

    def go(self, message: Int32) -> None:
        for number in range(message.data):
            text = String(data=f"{number} ".ljust(SIZE, "."))
            while not self.sent(text):
                pass

    def sent(self, text: String) -> bool:
        """With keep_all the middleware waits for its subscribers, but not for ever."""
        try:
            self.texts.publish(text)
        except rclpy_implementation.RCLError:
            return False
        return True


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        with rclpy.init():
            rclpy.spin(SourceNode())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # how a node is stopped
