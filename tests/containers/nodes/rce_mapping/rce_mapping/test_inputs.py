"""Scans, odometry and transforms that a mapper receives."""

from __future__ import annotations

import math
import time
from types import SimpleNamespace
from typing import Any

import pytest

from rce.mapping.evaluation.simulation import Simulation
from tests.support.containers.recording_node import RecordingNode

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan

from tests.support.containers.mapper_robot import Robot, stamp_of, transform

RESEND_AFTER = 0.2  # seconds after which a best-effort message without an answer is sent again


def test_scans_of_best_effort_driver_are_received(robot: Robot, simulation: Simulation) -> None:
    robot.node.destroy_publisher(robot.scans)
    robot.scans = robot.node.create_publisher(LaserScan, "scan", qos_profile_sensor_data)
    robot.until(lambda: robot.scans.get_subscription_count() == 1)
    sent = -math.inf
    # The node may not have matched the publisher yet, and then a best-effort message is lost: send it again.
    while not robot.poses:
        if time.monotonic() - sent > RESEND_AFTER:
            robot.send_scan(simulation.records[0])
            sent = time.monotonic()
        robot.until(lambda sent=sent: bool(robot.poses) or time.monotonic() - sent > RESEND_AFTER)  # type: ignore[misc]


def test_pose_of_laser_on_robot_is_read_from_static_transforms(robot: Robot, simulation: Simulation) -> None:
    """The laser is on a mast half a metre in front of the axle and looks backwards."""
    from rce_mapping.inputs import STATIC_TRANSFORMS
    from tf2_msgs.msg import TFMessage

    fixed = robot.node.create_publisher(TFMessage, "/tf_static", STATIC_TRANSFORMS)
    now = stamp_of(1.0)
    fixed.publish(
        TFMessage(
            transforms=[
                transform("base_link", "mast", 0.5, 0.0, now),
                transform("mast", "laser", 0.0, math.pi, now),
                transform("base_link", "wheel", 3.0, 0.0, now),
            ]
        )
    )
    robot.until(lambda: robot.mapper.track._scans._transforms.lookup("laser") == pytest.approx((0.5, 0.0, -math.pi)))
    assert robot.mapper.track._scans._transforms.lookup("unknown") == (0.0, 0.0, 0.0)
    for scan in simulation.records[:3]:
        robot.send_scan(scan, frame="laser")
    robot.until_poses(3)
    first = robot.poses[0].pose.pose
    assert (first.position.x, first.orientation.z) == (pytest.approx(0.5), pytest.approx(-1.0))


@pytest.mark.parametrize("parameters", [["odometry_from_tf:=true", "odom_timeout:=60.0"]], indirect=True)
def test_odometry_is_read_from_transforms(robot: Robot, simulation: Simulation) -> None:
    from tf2_msgs.msg import TFMessage

    out = robot.node.create_publisher(TFMessage, "/tf", 100)
    robot.until(lambda: out.get_subscription_count() == 1)
    for scan in simulation.records[:5]:
        assert scan.odometry
        x, _, theta = scan.odometry
        out.publish(TFMessage(transforms=[transform("odom", "base_link", x, theta, stamp_of(scan.stamp))]))
        robot.send_scan(scan)
    robot.until_poses(5)
    assert robot.mapper.track._scans._odometry_expected, "no scan has timed out waiting for its odometry"


def test_scans_are_received_without_loss_unless_the_publisher_refuses(interfaces: None) -> None:
    from rce_mapping.inputs import BEST_EFFORT, LOSSLESS, ScanInput

    node = RecordingNode()
    ScanInput(node, "scan", lambda scan: None)
    assert node.subscriptions["scan"].qos_profile == LOSSLESS
    node.subscriptions["scan"].events.incompatible_qos(None)
    second = node.subscriptions["scan"]
    assert second.qos_profile == BEST_EFFORT
    second.events.incompatible_qos(None)
    assert node.subscriptions["scan"] is second
    assert len(node.logged) == 1


def test_lost_scans_are_counted_and_logged_from_time_to_time(interfaces: None) -> None:
    from rce_mapping.inputs import ScanInput

    node = RecordingNode()
    scans = ScanInput(node, "scan", lambda scan: None)
    for change in (1, 98, 1, 1):
        node.subscriptions["scan"].events.message_lost(SimpleNamespace(total_count_change=change))
    assert scans.lost == 101
    assert [line.split()[0] for line in node.logged] == ["1", "100"]


def static(*transforms: TransformStamped) -> SimpleNamespace:
    return SimpleNamespace(transforms=transforms)


def test_static_transforms_are_chained(interfaces: None) -> None:
    from rce_mapping.inputs import Transforms

    node = RecordingNode()
    transforms = Transforms(node, "odom", "base_link", None)
    now = stamp_of(1.0)
    node.receive("/tf_static", static(transform("mast", "/laser", 0.2, math.pi, now)))
    assert transforms.lookup("laser") == (0.0, 0.0, 0.0), "the mast is unknown yet"
    node.receive("/tf_static", static(transform("/base_link", "mast", 0.5, math.pi / 2, now)))
    assert transforms.lookup("/laser") == pytest.approx((0.5, 0.2, -math.pi / 2))
    assert transforms.lookup("base_link") == (0.0, 0.0, 0.0)
    assert "/tf" not in node.subscriptions


def test_circular_transforms_are_unknown(interfaces: None) -> None:
    from rce_mapping.inputs import Transforms

    node = RecordingNode()
    transforms = Transforms(node, "odom", "base_link", None)
    now = stamp_of(1.0)
    node.receive("/tf_static", static(transform("a", "b", 1.0, 0.0, now), transform("b", "a", 1.0, 0.0, now)))
    assert transforms.lookup("a") == (0.0, 0.0, 0.0)


def test_only_the_transform_of_the_robot_is_its_odometry(interfaces: None) -> None:
    from rce_mapping.inputs import Transforms

    node = RecordingNode()
    received: list[Any] = []
    Transforms(node, "odom", "base_link", lambda stamp, pose: received.append((stamp, pose)))
    now = stamp_of(1.5)
    wheel, robot = transform("base_link", "wheel", 9.0, 0.0, now), transform("/odom", "/base_link", 2.0, 0.5, now)
    node.receive("/tf", static(wheel, robot))
    assert received == [(now, pytest.approx((2.0, 0.0, 0.5)))]


def test_odometry_of_a_topic(interfaces: None) -> None:
    from rce_mapping.inputs import LOSSLESS, subscribe_to_odometry

    node = RecordingNode()
    received: list[Any] = []
    subscribe_to_odometry(node, "odom", lambda stamp, pose: received.append((stamp, pose)))
    message = Odometry()
    message.header.stamp, message.pose.pose.position.y = stamp_of(1.5), 3.0
    node.receive("odom", message)
    assert received == [(stamp_of(1.5), (0.0, 3.0, 0.0))]
    assert node.subscriptions["odom"].qos_profile == LOSSLESS
