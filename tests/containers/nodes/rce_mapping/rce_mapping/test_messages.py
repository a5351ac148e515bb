"""Conversion between ROS messages and the types of the mapping library."""

from __future__ import annotations

import math
from array import array

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.mapper import Estimate

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Quaternion
from nav_msgs.msg import Odometry
from rce_mapping import messages
from sensor_msgs.msg import LaserScan

GRID = OccupancyGrid(np.arange(12, dtype=np.int8).reshape(3, 4), 0.05, -1.0, 2.0)


def test_stamps() -> None:
    assert messages.seconds(Time(sec=3, nanosec=250_000_000)) == 3.25
    assert messages.stamp_of(3.25) == Time(sec=3, nanosec=250_000_000)
    assert messages.stamp_of(1.9999999) == Time(sec=2, nanosec=0), "the carry goes to the seconds"
    assert messages.stamp_of(-0.25) == Time(sec=-1, nanosec=750_000_000)


def test_ranges_of_a_scan_are_a_view() -> None:
    message = LaserScan(angle_min=-0.5, angle_increment=0.25, range_max=8.0, ranges=array("f", [1.0, math.inf]))
    message.header.stamp = Time(sec=7)
    scan = messages.scan_from(message)
    assert (scan.stamp, scan.angle_min, scan.angle_increment, scan.range_max) == (7.0, -0.5, 0.25, 8.0)
    assert scan.odometry is None
    message.ranges[0] = 2.0
    assert scan.ranges.tolist() == [2.0, math.inf]


def test_scan_without_beams() -> None:
    assert messages.scan_from(LaserScan()).ranges.size == 0


@pytest.mark.parametrize("yaw", [0.0, 0.5, -3.0, math.pi / 2])
def test_yaw_does_not_depend_on_roll_and_pitch(yaw: float) -> None:
    half = yaw / 2
    assert messages.yaw_of(Quaternion(z=math.sin(half), w=math.cos(half))) == pytest.approx(yaw)
    roll = 0.2  # about the axis of the robot, before the yaw
    turned = Quaternion(
        x=math.cos(half) * math.sin(roll), y=math.sin(half) * math.sin(roll),
        z=math.sin(half) * math.cos(roll), w=math.cos(half) * math.cos(roll),
    )  # fmt: skip
    assert messages.yaw_of(turned) == pytest.approx(yaw)


def test_pose_in_the_plane_round_trips() -> None:
    message = Odometry()
    messages.fill_pose(message.pose.pose, 1.0, -2.0, 2.5)
    assert messages.pose_from(message) == pytest.approx((1.0, -2.0, 2.5))


def test_answer_has_the_covariance_of_x_y_and_yaw() -> None:
    covariance = np.arange(1.0, 10.0).reshape(3, 3)
    estimate = Estimate(7.0, Pose(1.0, 2.0, 0.5), covariance, matched=True)
    message = messages.pose_message(estimate, Time(sec=7), "map")
    assert (message.header.frame_id, message.header.stamp) == ("map", Time(sec=7))
    assert messages.pose_from(message) == pytest.approx((1.0, 2.0, 0.5))
    full = np.array(message.pose.covariance).reshape(6, 6)
    assert np.array_equal(full[np.ix_([0, 1, 5], [0, 1, 5])], covariance)
    assert not full[2:5].any()
    assert not full[:, 2:5].any()


def test_map_has_rows_from_the_bottom() -> None:
    cells = np.array([[0, 100, -1], [1, 2, 3]], np.int8)
    message = messages.grid_message(OccupancyGrid(cells, 0.05, -1.0, 2.0), Time(sec=7), "map")
    assert (message.info.width, message.info.height) == (3, 2)
    assert message.info.resolution == pytest.approx(0.05)
    assert (message.info.origin.position.x, message.info.origin.position.y) == (-1.0, 2.0)
    assert list(message.data) == [0, 100, -1, 1, 2, 3]


def test_path_has_the_stamps_as_received() -> None:
    stamps = [Time(sec=1, nanosec=1), Time(sec=2, nanosec=3)]
    path = messages.path_message(np.array([[1.0, 0.5, 0.0, 0.0], [2.0, 1.5, 0.0, 1.0]]), stamps, "map")
    assert [pose.header.stamp for pose in path.poses] == stamps
    assert path.header.stamp == stamps[-1]
    assert [pose.pose.position.x for pose in path.poses] == [0.5, 1.5]
    assert path.poses[1].pose.orientation.z == pytest.approx(math.sin(0.5))
    assert messages.path_message(np.empty((0, 4)), [], "map").poses == []


def test_path_needs_a_stamp_for_each_pose() -> None:
    with pytest.raises(ValueError, match="zip"):
        messages.path_message(np.zeros((2, 4)), [Time()], "map")


def test_map_is_that_of_the_message() -> None:
    message = messages.grid_message(GRID, Time(), "map")
    assert np.array_equal(messages.grid_from(message).cells, GRID.cells)
    message.info.width += 1
    with pytest.raises(InvalidRequest, match="values"):
        messages.grid_from(message)
    message.info.width -= 1
    message.info.origin.orientation.z = message.info.origin.orientation.w = math.sqrt(0.5)
    with pytest.raises(InvalidRequest, match="turned"):
        messages.grid_from(message)
