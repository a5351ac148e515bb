#!/usr/bin/env python3
"""Service /stringTestService measures round trips to stringEcho.py.

`testType` is `service` or `topic`. The answer has one time in milliseconds for each of SIZES, -1 where no answer came;
it is empty for another `testType`.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from threading import Event
from time import perf_counter

import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String
from Test.srv import StringEcho, StringTest

SIZES = (
    *(3, 10, 20, 42, 88, 183, 379, 784, 1623, 3359, 6951, 14384, 29763, 61584, 127427, 263665, 545559),
    *(1128837, 2335721, 4832930, 10000000),
)  # bytes
TIMEOUT = 15.0  # seconds
FAILED = -1.0


class StringTesterNode(Node):
    """Needs two threads: one waits in `measure` for what the other receives."""

    def __init__(self) -> None:
        super().__init__("stringTester")
        group = ReentrantCallbackGroup()
        self.create_service(StringTest, "/stringTestService", self.measure, callback_group=group)
        self.echo = self.create_client(StringEcho, "/stringEchoService", callback_group=group)
        self.requests = self.create_publisher(String, "/stringEchoReq", 10)
        self.create_subscription(String, "/stringEchoResp", self.receive, 10, callback_group=group)
        self.expected = ""
        self.arrived = Event()

    def measure(self, request: StringTest.Request, response: StringTest.Response) -> StringTest.Response:
        trips = {"service": self.call, "topic": self.publish}
        if trip := trips.get(request.testType):
            response.times = [milliseconds(trip, "x" * size) for size in SIZES]
        else:
            self.get_logger().error(f"testType {request.testType!r} is neither service nor topic")
        return response

    def call(self, text: str) -> None:
        if not self.echo.wait_for_service(TIMEOUT):
            raise TimeoutError
        self.echo.call(StringEcho.Request(data=text), TIMEOUT)

    def publish(self, text: str) -> None:
        self.expected = text
        self.arrived.clear()
        self.requests.publish(String(data=text))
        if not self.arrived.wait(TIMEOUT):
            raise TimeoutError

    def receive(self, message: String) -> None:
        if message.data == self.expected:
            self.arrived.set()


def milliseconds(trip: Callable[[str], None], text: str) -> float:
    start = perf_counter()
    try:
        trip(text)
    except TimeoutError:
        return FAILED
    return 1000 * (perf_counter() - start)


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM):  # rclpy's own handlers now and then leave `spin` waiting
        signal.signal(number, signal.default_int_handler)
    try:
        with rclpy.init():
            rclpy.spin(StringTesterNode(), MultiThreadedExecutor(2))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # how a node is stopped
