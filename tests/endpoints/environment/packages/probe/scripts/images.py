"""Echoes images."""

import time

import rclpy
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import Image

if __name__ == "__main__":
    try:
        with rclpy.init():
            node = rclpy.create_node("images")
            back = node.create_publisher(Image, "image_back", 10)
            while not back.get_subscription_count():
                time.sleep(0.001)  # what it publishes before would be lost
            node.create_subscription(Image, "image", back.publish, 10)
            rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # the node is stopped by SIGINT or SIGTERM
