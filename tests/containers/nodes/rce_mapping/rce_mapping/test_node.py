"""The node `mapper`, with the node of a robot in the same process."""

from __future__ import annotations

import numpy as np
import pytest

from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.scans import Scan

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from nav_msgs.srv import GetMap

from tests.support.containers.mapper_robot import Robot, stamp_of


def test_each_scan_is_answered_with_its_stamp_and_mapped(robot: Robot, simulation: Simulation) -> None:
    assert (robot.maps[0].info.width, list(robot.maps[0].data)) == (1, [-1]), (
        "the first, empty map means that the node is ready"
    )
    sent = simulation.records[:40]
    for i, scan in enumerate(sent):
        for send in (robot.send_scan, robot.send_odometry)[:: 1 if i % 2 else -1]:
            send(scan)
    robot.until_poses(len(sent))
    assert [pose.header.stamp for pose in robot.poses] == [stamp_of(scan.stamp) for scan in sent]
    assert {pose.header.frame_id for pose in robot.poses} == {"map"}
    covariance = np.array(robot.poses[-1].pose.covariance).reshape(6, 6)
    assert np.diag(covariance)[[0, 1, 5]].min() > 0

    answer = robot.client.call_async(GetMap.Request())
    robot.until(lambda: answer.done() and len(robot.maps) == 2 and bool(robot.paths[-1].poses))
    assert answer.result().map == robot.maps[-1]
    assert robot.maps[-1].info.width * robot.maps[-1].info.height == len(robot.maps[-1].data)
    assert max(robot.maps[-1].data) > 65
    assert [pose.header.stamp for pose in robot.paths[-1].poses] == [stamp_of(scan.stamp) for scan in sent]
    last, answered = robot.paths[-1].poses[-1].pose, robot.poses[-1].pose.pose
    assert (last.position.x, last.position.y) == pytest.approx((answered.position.x, answered.position.y), abs=1e-9)


def test_scans_without_odometry_and_unusable_scans_are_answered(robot: Robot, simulation: Simulation) -> None:
    sent = [*simulation.records[:3], Scan(1.8e9, np.empty(0, np.float32), 0.0, 0.0, 0.0), simulation.records[3]]
    for scan in sent:
        robot.send_scan(scan)
    robot.until_poses(len(sent))
    assert [pose.header.stamp for pose in robot.poses] == [stamp_of(scan.stamp) for scan in sent]


def test_duplicate_scan_is_answered_but_not_mapped(robot: Robot, simulation: Simulation) -> None:
    for scan in (*simulation.records[:3], simulation.records[1]):
        robot.send_scan(scan)
    robot.until_poses(4)
    answer = robot.client.call_async(GetMap.Request())
    robot.until(lambda: answer.done() and bool(robot.paths[-1].poses))
    assert len(robot.paths[-1].poses) == 3
