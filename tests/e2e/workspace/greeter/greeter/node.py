"""Service /greet."""

from __future__ import annotations

import signal

import rclpy
from greeter_msgs.srv import Greet
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from greeter.words import greeting


def answer(request: Greet.Request, response: Greet.Response) -> Greet.Response:
    response.text = greeting(request.name)
    return response


def main() -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        with rclpy.init():
            node = Node("greeter")
            node.create_service(Greet, "/greet", answer)
            rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # how a node is stopped
