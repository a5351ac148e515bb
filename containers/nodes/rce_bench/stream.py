"""ROS 2 node that publishes numbered messages at a fixed rate: arguments `TOPIC RATE SIZE`.

A message is a `std_msgs/UInt8MultiArray` of SIZE bytes, which begin with its number (u64) and the time by the monotonic
clock (f64), both little-endian. It is published as bytes, so that the node is not the limit.
"""

from __future__ import annotations

import struct
import sys
import time

from lean import DEPTH, LeanNode, run
from std_msgs.msg import UInt8MultiArray

HEAD = struct.Struct("<4sIIIQd")  # encapsulation, no dimensions, offset, length, number, time


class StreamNode(LeanNode):
    """Node that publishes on one topic."""

    def __init__(self, words: list[str]) -> None:
        """Create the topic of the arguments."""
        topic, rate, size = words[0], float(words[1]), int(words[2])
        super().__init__("stream")
        self._out = self.create_publisher(UInt8MultiArray, topic, DEPTH)
        self._message = bytearray(HEAD.size + size - 16)
        self._size = size
        self._number = 0
        self.create_timer(1 / rate, self._publish)

    def _publish(self) -> None:
        HEAD.pack_into(self._message, 0, b"\0\1\0\0", 0, 0, self._size, self._number, time.monotonic())
        self._number += 1
        self._out.publish(bytes(self._message))


if __name__ == "__main__":
    sys.exit(run(StreamNode))
