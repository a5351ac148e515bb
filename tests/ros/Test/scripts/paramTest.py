#!/usr/bin/env python3
"""Service /parameterTest answers the parameters int, str, float, bool and list as a JSON object, null where unset."""

from __future__ import annotations

import json
import signal

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from Test.srv import ParameterTest

NAMES = ("int", "str", "float", "bool", "list")


class ParameterTestNode(Node):
    def __init__(self) -> None:
        super().__init__(
            "paramTest", allow_undeclared_parameters=True, automatically_declare_parameters_from_overrides=True
        )
        self.create_service(ParameterTest, "/parameterTest", self.answer)

    def answer(self, request: ParameterTest.Request, response: ParameterTest.Response) -> ParameterTest.Response:
        response.msg = json.dumps({name: plain(self.get_parameter(name)) for name in NAMES})
        return response


def plain(parameter: Parameter) -> object:
    """The value as JSON has it: arrays of numbers arrive as `array.array`."""
    if parameter.type_ in (Parameter.Type.INTEGER_ARRAY, Parameter.Type.DOUBLE_ARRAY):
        return list(parameter.value)
    return parameter.value


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM):  # rclpy's own handlers now and then leave `spin` waiting
        signal.signal(number, signal.default_int_handler)
    try:
        with rclpy.init():
            rclpy.spin(ParameterTestNode())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # how a node is stopped
