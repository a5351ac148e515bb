"""ROS 2 node that sends the strings of `numbers` back on `numbers_back`, and prints each one."""

from __future__ import annotations

import sys

from lean import LeanNode, run
from std_msgs.msg import String

DEPTH = 1000  # so that nothing is lost here while another process does not run


class NumberedNode(LeanNode):
    """Node that sends back and prints what it receives."""

    def __init__(self, words: list[str]) -> None:
        """Create the topics."""
        super().__init__("numbered")
        self._back = self.create_publisher(String, "numbers_back", DEPTH)
        self.create_subscription(String, "numbers", self._send_back, DEPTH)

    def _send_back(self, message: String) -> None:
        self._back.publish(message)
        print(message.data, flush=True)


if __name__ == "__main__":
    sys.exit(run(NumberedNode))
