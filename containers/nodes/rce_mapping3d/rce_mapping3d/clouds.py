"""Clouds of a lidar: `sensor_msgs/PointCloud2` of any layout."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from rce.errors import RceError
from rce.mapping.clouds import Sweep, decode

from .images import NEWEST


class CloudInput:
    """Topic `points` of a robot."""

    def __init__(self, node: Node, prefix: str, on_sweep: Callable[[Sweep, Time], None]) -> None:
        """Subscribe; call `on_sweep` with each sweep, and its stamp as it came."""
        self._node, self._on_sweep = node, on_sweep
        self._last = -np.inf
        node.create_subscription(PointCloud2, f"{prefix}points", self._on_cloud, NEWEST)

    def _on_cloud(self, message: PointCloud2) -> None:
        """Take a cloud that is newer than the last. A damaged one is logged."""
        try:
            sweep = decode(message)
            if sweep.stamp > self._last:
                self._last = sweep.stamp
                self._on_sweep(sweep, message.header.stamp)
        except RceError as error:
            self._node.get_logger().warning(str(error), throttle_duration_sec=5.0)
