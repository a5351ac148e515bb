#!/usr/bin/env python3
"""Echoes a topic and a service, has parameters, and publishes with the QoS that its arguments name."""

from __future__ import annotations

import sys
import time
from functools import partial
from typing import Any

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from std_srvs.srv import SetBool

PATIENCE = 30.0  # seconds


def publish(publisher: Publisher[Any], message: Any) -> None:
    """Publish a message as soon as there is a subscription: before, it would be lost."""
    until = time.monotonic() + PATIENCE
    while not publisher.get_subscription_count() and time.monotonic() < until and rclpy.ok():
        time.sleep(0.001)
    publisher.publish(message)


class Echo(Node):
    def __init__(self) -> None:
        super().__init__("echo")
        qos = QoSProfile(
            depth=4000 if "deep" in sys.argv else 10,
            history=HistoryPolicy.KEEP_ALL if "keep_all" in sys.argv else HistoryPolicy.KEEP_LAST,
            reliability=ReliabilityPolicy.BEST_EFFORT if "best_effort" in sys.argv else ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if "latched" in sys.argv else DurabilityPolicy.VOLATILE,
        )
        back = self.create_publisher(String, "back", qos)
        self.create_subscription(String, "there", partial(publish, back), qos)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        kept = self.create_publisher(String, "latched", latched)
        while "once_subscribed" in sys.argv and not kept.get_subscription_count():
            time.sleep(0.0001)  # to publish right when the subscription appears
        kept.publish(String(data="kept"))
        if "later" in sys.argv:
            self.create_subscription(String, "begin", self.begin, 10)
        else:
            self.begin()
        self.declare_parameter("speed", 1.0)
        self.declare_parameter("words", ["none"])
        self.add_on_set_parameters_callback(self.check)
        for name in ("speed", "words"):
            self.get_logger().info(f"{name} is {self.get_parameter(name).value}")

    def begin(self, _: String | None = None) -> None:
        self.create_service(SetBool, "flip", self.flip)

    def flip(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success = not request.data
        return response

    def check(self, parameters: list[Parameter[float]]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name == "speed" and parameter.value > 10:
                return SetParametersResult(successful=False, reason="too fast")
            self.get_logger().info(f"{parameter.name} becomes {parameter.value}")
        return SetParametersResult(successful=True)


if __name__ == "__main__":
    try:
        with rclpy.init():
            rclpy.spin(Echo())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # the node is stopped by SIGINT or SIGTERM
