"""ROS 2 node that publishes numbered strings as fast as it can: `flood.py TOPIC SIZE`."""

from __future__ import annotations

import sys

from lean import LeanNode, run
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.serialization import serialize_message
from std_msgs.msg import String

DEPTH = 1000
DIGITS = 10  # of the number at the begin of each string
BATCH = 100  # messages between two looks for a signal
BEGIN = 8  # bytes of a serialized string before its content: encapsulation and length


class FloodNode(LeanNode):
    """Node that publishes from a timer that is always due, so that it ends at a signal."""

    def __init__(self, words: list[str]) -> None:
        """Create the topic."""
        topic, size = words
        super().__init__("flood")
        self._publisher = self.create_publisher(String, topic, DEPTH)
        self._message = bytearray(serialize_message(String(data="x" * int(size))))
        self._number = 0
        self.create_timer(1e-6, self._publish)

    def _publish(self) -> None:
        for _ in range(BATCH):
            self._message[BEGIN : BEGIN + DIGITS] = b"%0*d" % (DIGITS, self._number)
            try:
                self._publisher.publish(bytes(self._message))
            except _rclpy.RCLError:  # its queue is full of messages that a subscriber has not acknowledged for 0.1 s
                return
            self._number += 1


if __name__ == "__main__":
    sys.exit(run(FloodNode))
