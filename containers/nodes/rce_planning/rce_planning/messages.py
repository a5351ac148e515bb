"""Conversion between ROS messages and the types of `rce.planning`."""

from __future__ import annotations

from array import array

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid as GridMessage
from nav_msgs.msg import Path
from numpy.typing import NDArray
from rce_mapping.messages import fill_pose, yaw_of

from rce.mapping.geometry import Pose
from rce.planning.costmap import BLOCKED, BORDER, LETHAL, Costmap


def costmap_message(costmap: Costmap, map_message: GridMessage) -> GridMessage:
    """Return the costs as Nav2 publishes them: 100 occupied, 99 blocked for the robot's centre, less for others."""
    percent = np.zeros(256, np.int8)
    percent[1:BLOCKED] = 1 + (97 * np.arange(BLOCKED - 1)) // (BLOCKED - 2)
    percent[BLOCKED], percent[LETHAL:] = 99, 100
    cells = percent[costmap.inscribed_costs[BORDER:-BORDER, BORDER:-BORDER]]
    message = GridMessage(header=map_message.header, info=map_message.info)
    message.data = array("b", cells.tobytes())
    return message


def pose_from(message: PoseMessage) -> Pose:
    """Return the pose in the plane of a message."""
    return Pose(message.position.x, message.position.y, yaw_of(message.orientation))


def path_message(poses: NDArray[np.float64], stamp: Time, frame: str) -> Path:
    """Convert poses (n, 4) of a path."""
    path = Path()
    path.header.stamp, path.header.frame_id = stamp, frame
    stamped = []
    for x, y, theta, _ in poses.tolist():
        pose = PoseStamped(header=path.header)
        fill_pose(pose.pose, x, y, theta)
        stamped.append(pose)
    path.poses = stamped
    return path
