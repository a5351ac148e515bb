"""ROS 2 node that receives the images on `image` and discards them."""

from __future__ import annotations

import sys

from lean import DEPTH, LeanNode, run
from sensor_msgs.msg import Image


class ImageNode(LeanNode):
    """Node that discards images."""

    def __init__(self, _words: list[str]) -> None:
        """Create the topic; the node takes no arguments."""
        super().__init__("images")
        self.create_subscription(Image, "image", lambda _image: None, DEPTH)


if __name__ == "__main__":
    sys.exit(run(ImageNode))
