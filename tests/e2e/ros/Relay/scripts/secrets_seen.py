#!/usr/bin/env python3
"""ROS 2 node that publishes, latched, what it sees of the secret `password`: its file, and the variable PASSWORD."""

import json
import os
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

rclpy.init()
node = Node("secrets_seen")
seen = {
    "file": (Path(os.environ["RCE_SECRETS_DIR"]) / "password").read_text(),
    "variable": os.environ["PASSWORD"],
}
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_publisher(String, "/seen", latched).publish(String(data=json.dumps(seen)))
rclpy.spin(node)
