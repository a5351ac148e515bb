"""ROS 2 node of a robot: says something every second and prints what it hears; it knows nothing of the platform.

Run it beside the bridge; see bridge.yaml. It ends when it has heard three messages.
"""

import rclpy
from rclpy.node import Node
from std_msgs.msg import String


class Talker(Node):
    """The node, with the number of messages it has heard."""

    def __init__(self) -> None:
        super().__init__("talker")
        self.heard = 0
        self._say = self.create_publisher(String, "/say", 10)
        self.create_subscription(String, "/heard", self._receive, 10)
        self.create_timer(0.5, lambda: self._say.publish(String(data="hello cloud")))

    def _receive(self, message: String) -> None:
        self.heard += 1
        print(f"heard: {message.data}")


rclpy.init()
node = Talker()
while node.heard < 3:
    rclpy.spin_once(node)
rclpy.shutdown()
