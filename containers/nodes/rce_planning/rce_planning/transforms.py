"""Pose of the robot on the map, from `/tf` and `/tf_static`."""

from __future__ import annotations

from typing import Any

from rce_mapping.inputs import STATIC_TRANSFORMS
from rce_mapping.messages import yaw_of
from rce_mapping.optional import TFMessage
from rclpy.node import Node

from rce.mapping.geometry import ORIGIN, Pose


class RobotPose:
    """Newest transforms, each child frame in its parent."""

    def __init__(self, node: Node, map_frame: str, base_frame: str) -> None:
        """Subscribe to the transforms, if their type is installed."""
        self._map, self._base = map_frame, base_frame
        self._within: dict[str, tuple[str, Pose]] = {}
        if TFMessage is not None:
            node.create_subscription(TFMessage, "/tf", self.take, 100)
            node.create_subscription(TFMessage, "/tf_static", self.take, STATIC_TRANSFORMS)

    def take(self, message: Any) -> None:
        """Keep the transforms of a message."""
        for each in message.transforms:
            place, turn = each.transform.translation, yaw_of(each.transform.rotation)
            parent = each.header.frame_id.lstrip("/")
            self._within[each.child_frame_id.lstrip("/")] = parent, Pose(place.x, place.y, turn)

    def newest(self) -> Pose | None:
        """Return the pose of the robot on the map, or None if no transforms lead from one to the other."""
        frame, pose = self._base, ORIGIN
        for _ in range(len(self._within) + 1):
            if frame == self._map:
                return pose
            if frame not in self._within:
                return None
            frame, within = self._within[frame]
            pose = within @ pose
        return None
