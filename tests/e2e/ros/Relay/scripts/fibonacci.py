#!/usr/bin/env python3
"""Action server /fibonacci: an order of 0 runs until it is canceled, a negative one is rejected."""

from __future__ import annotations

import signal
import time
from typing import Any

import rclpy
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from test_msgs.action import Fibonacci


class FibonacciNode(Node):
    def __init__(self) -> None:
        super().__init__("fibonacci")
        self.server = ActionServer(
            self,
            Fibonacci,
            "/fibonacci",
            self.execute,
            callback_group=ReentrantCallbackGroup(),
            goal_callback=lambda goal: GoalResponse.REJECT if goal.order < 0 else GoalResponse.ACCEPT,
            cancel_callback=lambda goal: CancelResponse.ACCEPT,
        )

    def execute(self, goal: Any) -> Any:
        numbers = [0, 1]
        while not goal.request.order or len(numbers) < goal.request.order:
            if goal.is_cancel_requested:
                goal.canceled()
                return Fibonacci.Result(sequence=numbers[:5])
            numbers = [*numbers, sum(numbers[-2:]) % 2**31][-40:]
            goal.publish_feedback(Fibonacci.Feedback(sequence=numbers))
            if not goal.request.order:
                time.sleep(0.05)
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
