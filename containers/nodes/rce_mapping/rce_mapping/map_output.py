"""Publication of the map: the whole map from time to time, and updates in between."""

from __future__ import annotations

from array import array

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import OccupancyGrid as GridMessage
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from rce.mapping.grid import OccupancyGrid

from . import messages
from .optional import OccupancyGridUpdate

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class MapOutput:
    """Topics `map` (latched) and `map_updates`.

    An update covers all that differs from the last whole map, so that a subscriber that misses one needs only the next.
    """

    def __init__(self, node: Node, frame: str) -> None:
        """Create the topics; `frame` is that of the map."""
        self._frame = frame
        self._whole: OccupancyGrid | None = None
        self._map = node.create_publisher(GridMessage, "map", LATCHED)
        self._updates = node.create_publisher(OccupancyGridUpdate, "map_updates", 10) if OccupancyGridUpdate else None

    @property
    def has_update_subscribers(self) -> bool:
        """True if `map_updates` has subscribers."""
        return self._updates is not None and self._updates.get_subscription_count() > 0

    def publish(self, grid: OccupancyGrid, stamp: Time) -> GridMessage:
        """Publish the whole map; return the message."""
        message = messages.grid_message(grid, stamp, self._frame)
        self._map.publish(message)
        self._whole = grid
        return message

    def update(self, grid: OccupancyGrid, stamp: Time) -> None:
        """Publish what has changed since the last whole map, or the whole map if it has grown or moved."""
        before = self._whole
        if before is None or (before.x, before.y, before.cells.shape) != (grid.x, grid.y, grid.cells.shape):
            self.publish(grid, stamp)
            return
        rows, columns = np.nonzero(before.cells != grid.cells)
        if self._updates is None or not len(rows):
            return
        (low, high), (left, right) = ((int(each.min()), int(each.max()) + 1) for each in (rows, columns))
        message = OccupancyGridUpdate()
        message.header.stamp, message.header.frame_id = stamp, self._frame
        message.x, message.y, message.width, message.height = left, low, right - left, high - low
        message.data = array("b", grid.cells[low:high, left:right].tobytes())
        self._updates.publish(message)
