"""Conversion between ROS messages and the types of `rce.mapping`.

Arrays are viewed or copied as a whole, never item by item.
"""

from __future__ import annotations

import math
from array import array

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Quaternion
from nav_msgs.msg import OccupancyGrid as GridMessage
from nav_msgs.msg import Odometry, Path
from numpy.typing import NDArray
from sensor_msgs.msg import LaserScan

from rce.errors import InvalidRequest
from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.mapper import Estimate
from rce.mapping.scans import Scan

PLANAR = (0, 1, 5)  # x, y and yaw among the six dimensions of a ROS covariance
NO_TURN = 1e-3  # radians; a map that is turned by less is not turned


def seconds(stamp: Time) -> float:
    """Convert a stamp to seconds."""
    return float(stamp.sec + stamp.nanosec * 1e-9)


def stamp_of(seconds: float) -> Time:
    """Convert seconds to a stamp, rounded to microseconds."""
    microseconds = round(seconds * 1e6)
    return Time(sec=microseconds // 10**6, nanosec=microseconds % 10**6 * 1000)


def scan_from(message: LaserScan) -> Scan:
    """Convert a scan; its ranges are a view of those of the message."""
    ranges = np.frombuffer(message.ranges, np.float32)
    stamp = seconds(message.header.stamp)
    return Scan(stamp, ranges, message.angle_min, message.angle_increment, message.range_max)


def yaw_of(q: Quaternion) -> float:
    """Return the yaw of a rotation, radians."""
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))


def pose_from(message: Odometry | PoseWithCovarianceStamped) -> Pose:
    """Return the pose in the plane of a message."""
    position = message.pose.pose.position
    return Pose(position.x, position.y, yaw_of(message.pose.pose.orientation))


def fill_pose(message: PoseMessage, x: float, y: float, theta: float) -> None:
    """Set a pose message to a pose in the plane."""
    message.position.x, message.position.y = x, y
    message.orientation.z, message.orientation.w = math.sin(theta / 2), math.cos(theta / 2)


def pose_message(estimate: Estimate, stamp: Time, frame: str) -> PoseWithCovarianceStamped:
    """Convert the answer of a mapper."""
    message = PoseWithCovarianceStamped()
    message.header.stamp, message.header.frame_id = stamp, frame
    fill_pose(message.pose.pose, *estimate.pose)
    covariance = np.zeros((6, 6))
    covariance[np.ix_(PLANAR, PLANAR)] = estimate.covariance
    message.pose.covariance = covariance.ravel()
    return message


def grid_message(grid: OccupancyGrid, stamp: Time, frame: str) -> GridMessage:
    """Convert a map."""
    message = GridMessage()
    message.header.stamp, message.header.frame_id = stamp, frame
    message.info.map_load_time = stamp
    message.info.resolution = grid.resolution
    message.info.height, message.info.width = grid.cells.shape
    fill_pose(message.info.origin, grid.x, grid.y, 0.0)
    message.data = array("b", grid.cells.tobytes())
    return message


def grid_from(message: GridMessage) -> OccupancyGrid:
    """Convert a map.

    Raises:
        InvalidRequest: It is empty, turned, or its data do not fit its size.
    """
    info = message.info
    cells = np.frombuffer(message.data, np.int8)
    if cells.size == 0 or cells.size != info.width * info.height or not info.resolution > 0:
        raise InvalidRequest(f"a map of {info.width} x {info.height} cells has {cells.size} values")
    if abs(yaw_of(info.origin.orientation)) > NO_TURN:
        raise InvalidRequest("the map is turned in its frame; only maps without rotation are supported")
    origin = info.origin.position
    return OccupancyGrid(cells.reshape(info.height, info.width).copy(), info.resolution, origin.x, origin.y)


def path_message(trajectory: NDArray[np.float64], stamps: list[Time], frame: str) -> Path:
    """Convert a trajectory.

    Args:
        trajectory: (n, 4) stamp, x, y, theta.
        stamps: The same stamps as they were received, without rounding.
        frame: Frame of the trajectory.
    """
    message = Path()
    message.header.frame_id = frame
    poses = []
    for stamp, (_, x, y, theta) in zip(stamps, trajectory.tolist(), strict=True):
        pose = PoseStamped()
        pose.header.stamp, pose.header.frame_id = stamp, frame
        fill_pose(pose.pose, x, y, theta)
        poses.append(pose)
    message.poses = poses
    if stamps:
        message.header.stamp = stamps[-1]
    return message
