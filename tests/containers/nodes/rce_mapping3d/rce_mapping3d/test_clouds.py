"""The node `mapper` with a lidar, and the node of a robot in the same process."""

# ruff: noqa: E402  (ROS is imported only if it is installed)

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs the extra `ros`")

from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import UInt8MultiArray

from rce.mapping3d.evaluation.building import spinning
from tests.support.sweeps import drive, message


def cloud(sweep: Any) -> PointCloud2:
    flat = message(sweep, time=("t", "u4", 1e-9))
    result = PointCloud2(height=1, width=flat.width, point_step=flat.point_step, row_step=flat.row_step)
    result.header.stamp.sec, result.header.stamp.nanosec = flat.header.stamp.sec, flat.header.stamp.nanosec
    result.fields = [PointField(name=f.name, offset=f.offset, datatype=f.datatype, count=1) for f in flat.fields]
    result.data = array("B", flat.data)
    return result


def test_sweeps_are_answered_and_become_a_surface(start_ros: Callable[..., None]) -> None:
    from rce_mapping.map_output import LATCHED
    from rce_mapping3d.node import Mapper3dNode

    from tests.support.containers.rgbd_robot import Nodes

    start_ros("sensor:=lidar")
    nodes = Nodes(Mapper3dNode())
    points = nodes.node.create_publisher(PointCloud2, "points", 10)
    meshes: list[UInt8MultiArray] = []
    nodes.node.create_subscription(UInt8MultiArray, "mesh", meshes.append, LATCHED)
    nodes.until_discovered(points)
    sweeps = list(drive(0.3, spinning(16, 180), begin=5.0))
    for number, sweep in enumerate(sweeps, 1):
        points.publish(cloud(sweep))
        nodes.until(lambda number=number: len(nodes.poses) == number)
    assert nodes.poses[1].header.stamp.nanosec == pytest.approx(1e8, abs=1e3)
    assert np.array(nodes.poses[1].pose.covariance).reshape(6, 6).diagonal().max() < 1
    broken = cloud(sweeps[0])
    broken.fields = []
    points.publish(broken)
    node = nodes.tested[0]
    node.publish()
    nodes.until(lambda: bool(meshes))
    assert meshes[-1].layout.dim[0].label == "mesh.ply"
    assert bytes(meshes[-1].data[:4]) == b"ply\n"
    assert len(meshes[-1].data) == meshes[-1].layout.dim[0].size > 10_000
    nodes.close()
