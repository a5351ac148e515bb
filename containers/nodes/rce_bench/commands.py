"""ROS 2 node that answers each velocity command on `command` with the time of its arrival on `arrival`.

The time is in seconds of the monotonic clock, which all processes of a machine share.
"""

from __future__ import annotations

import sys
import time

from geometry_msgs.msg import Twist
from lean import DEPTH, LeanNode, run
from std_msgs.msg import Float64


class CommandNode(LeanNode):
    """Node that time-stamps velocity commands."""

    def __init__(self, _words: list[str]) -> None:
        """Create the topics; the node takes no arguments."""
        super().__init__("commands")
        self._arrivals = self.create_publisher(Float64, "arrival", DEPTH)
        self.create_subscription(Twist, "command", self._on_command, DEPTH)

    def _on_command(self, _command: Twist) -> None:
        self._arrivals.publish(Float64(data=time.monotonic()))


if __name__ == "__main__":
    sys.exit(run(CommandNode))
