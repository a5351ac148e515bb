#!/usr/bin/env python3
"""Action server /fibonacci of the tutorials of ROS 2: it appends `order` - 1 numbers, one in half a second."""

from __future__ import annotations

import signal
import time
from typing import Any

import rclpy
from example_interfaces.action import Fibonacci
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node


class FibonacciNode(Node):
    def __init__(self) -> None:
        super().__init__("example_fibonacci")
        self.server = ActionServer(
            self,
            Fibonacci,
            "/fibonacci",
            self.execute,
            callback_group=ReentrantCallbackGroup(),
            cancel_callback=lambda goal: CancelResponse.ACCEPT,
        )

    def execute(self, goal: Any) -> Any:
        numbers = [0, 1]
        for _ in range(1, goal.request.order):
            if goal.is_cancel_requested:
                goal.canceled()
                return Fibonacci.Result(sequence=numbers)
            numbers.append(numbers[-1] + numbers[-2])
            goal.publish_feedback(Fibonacci.Feedback(sequence=numbers))
            time.sleep(0.5)
        goal.succeed()
        return Fibonacci.Result(sequence=numbers)


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        with rclpy.init():
            rclpy.spin(FibonacciNode(), MultiThreadedExecutor(8))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # how a node is stopped
