#!/usr/bin/env python3
"""ROS 2 node: publishes the mean of all temperatures of the topic /readings on the topic /mean."""

import contextlib

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from weather.msg import Reading


class Mean(Node):
    """The node, with the temperatures so far."""

    def __init__(self) -> None:
        super().__init__("mean")
        self._values: list[float] = []
        self._mean = self.create_publisher(Reading, "/mean", 10)
        self.create_subscription(Reading, "/readings", self._receive, 10)

    def _receive(self, reading: Reading) -> None:
        self._values.append(reading.celsius)
        self._mean.publish(Reading(station=reading.station, celsius=sum(self._values) / len(self._values)))


rclpy.init()
with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(Mean())
