#!/usr/bin/env python3
"""Service /converterTest answers the sum of two numbers and a small colour image whose every pixel is known."""

from __future__ import annotations

import signal

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import Image
from Test.srv import ConverterTest

WIDTH, HEIGHT = 16, 8


class ConverterTestNode(Node):
    def __init__(self) -> None:
        super().__init__("converterTest")
        self.create_service(ConverterTest, "/converterTest", self.answer)

    def answer(self, request: ConverterTest.Request, response: ConverterTest.Response) -> ConverterTest.Response:
        response.sum = request.a + request.b
        response.img = image()
        return response


def image() -> Image:
    """rgb8: red is 10 times the column, green 10 times the row, blue 255."""
    pixels = bytes(value for row in range(HEIGHT) for column in range(WIDTH) for value in (10 * column, 10 * row, 255))
    return Image(height=HEIGHT, width=WIDTH, encoding="rgb8", step=3 * WIDTH, data=pixels)


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM):  # rclpy's own handlers now and then leave `spin` waiting
        signal.signal(number, signal.default_int_handler)
    try:
        with rclpy.init():
            rclpy.spin(ConverterTestNode())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # how a node is stopped
