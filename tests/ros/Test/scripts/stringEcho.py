#!/usr/bin/env python3
"""Echo: service /stringEchoService answers its data, topic /stringEchoReq comes back on /stringEchoResp."""

from __future__ import annotations

import signal

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String
from Test.srv import StringEcho


class StringEchoNode(Node):
    def __init__(self) -> None:
        super().__init__("stringEcho")
        self.create_service(StringEcho, "/stringEchoService", self.answer)
        self.responses = self.create_publisher(String, "/stringEchoResp", 10)
        self.create_subscription(String, "/stringEchoReq", self.responses.publish, 10)

    def answer(self, request: StringEcho.Request, response: StringEcho.Response) -> StringEcho.Response:
        response.data = request.data
        return response


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM):  # rclpy's own handlers now and then leave `spin` waiting
        signal.signal(number, signal.default_int_handler)
    try:
        with rclpy.init():
            rclpy.spin(StringEchoNode())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # how a node is stopped
