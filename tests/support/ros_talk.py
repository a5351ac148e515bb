"""ROS 2 programs for the tests of type support: `talk.py publish`, and `talk.py CHECK`, which prints what it got."""

from __future__ import annotations

import contextlib
import json
import signal
import sys
from array import array
from typing import Any

import rclpy
from geometry_msgs.msg import TransformStamped
from map_msgs.msg import OccupancyGridUpdate
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from Test.srv import ConverterTest, ParameterTest, StringEcho, StringTest
from tf2_msgs.msg import TFMessage

SERVICES = {
    "stringEcho": (StringEcho, "/stringEchoService", {"data": "grüß dich"}),
    "paramTest": (ParameterTest, "/parameterTest", {}),
    "converterTest": (ConverterTest, "/converterTest", {"a": 40, "b": 2}),
    "stringTester": (StringTest, "/stringTestService", {"testType": "service"}),
}


def publish(node: Node) -> None:
    transforms = node.create_publisher(TFMessage, "/transforms", 10)
    updates = node.create_publisher(OccupancyGridUpdate, "/updates", 10)

    def tick() -> None:
        transforms.publish(TFMessage(transforms=[TransformStamped(child_frame_id="laser")]))
        updates.publish(OccupancyGridUpdate(x=-3, width=2, height=1, data=[100, -1]))

    node.create_timer(0.05, tick)
    rclpy.spin(node)


def receive(node: Node) -> dict[str, object]:
    got: dict[str, Any] = {}
    node.create_subscription(TFMessage, "/transforms", lambda message: got.update(tf=message), 10)
    node.create_subscription(OccupancyGridUpdate, "/updates", lambda message: got.update(update=message), 10)
    while len(got) < 2:
        rclpy.spin_once(node)
    update = got["update"]
    return {"child": got["tf"].transforms[0].child_frame_id, "x": update.x, "data": list(update.data)}


def call(node: Node, name: str) -> dict[str, object]:
    kind, address, request = SERVICES[name]
    client = node.create_client(kind, address)
    client.wait_for_service()
    future = client.call_async(kind.Request(**request))
    while not future.done():
        rclpy.spin_until_future_complete(node, future, timeout_sec=5)
        if not future.done():  # the answer is lost if the service had not discovered this client yet
            future = client.call_async(kind.Request(**request))
    response = future.result()
    return {field: plain(getattr(response, field)) for field in response.get_fields_and_field_types()}


def plain(value: Any) -> object:
    """A response's field as JSON: an image as its pixels in hexadecimal, an array as a list."""
    if hasattr(value, "encoding"):
        return bytes(value.data).hex()
    return list(value) if isinstance(value, array) else value


def main(check: str) -> None:
    with rclpy.init():
        node = rclpy.create_node("talk")
        if check == "publish":
            publish(node)
        else:
            print(json.dumps(receive(node) if check == "receive" else call(node, check)))


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM):  # rclpy's own handlers now and then leave `spin` waiting
        signal.signal(number, signal.default_int_handler)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        main(sys.argv[1])
