#!/usr/bin/env python3
"""Print messages on /loud, and exit with status 3 after the message `die`."""

from __future__ import annotations

import signal
from contextlib import suppress

import rclpy
from rclpy.node import Node
from std_msgs.msg import String


def receive(message: String) -> None:
    print(message.data, flush=True)
    if message.data == "die":
        raise SystemExit(3)


def main() -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    rclpy.init()
    node = Node("loud")
    node.create_subscription(String, "/loud", receive, 10)
    print("listening", flush=True)
    with suppress(KeyboardInterrupt):  # how a node is stopped
        rclpy.spin(node)


if __name__ == "__main__":
    main()
