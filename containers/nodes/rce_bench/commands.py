"""Answers each velocity command on `command` with the time when it came, on `arrival`: seconds, monotonic clock."""

from __future__ import annotations

import sys
import time

from geometry_msgs.msg import Twist
from lean import DEPTH, LeanNode, run
from std_msgs.msg import Float64


class CommandNode(LeanNode):
    def __init__(self, _words: list[str]) -> None:
        super().__init__("commands")
        self._arrivals = self.create_publisher(Float64, "arrival", DEPTH)
        self.create_subscription(Twist, "command", self._came, DEPTH)

    def _came(self, _command: Twist) -> None:
        self._arrivals.publish(Float64(data=time.monotonic()))


if __name__ == "__main__":
    sys.exit(run(CommandNode))
