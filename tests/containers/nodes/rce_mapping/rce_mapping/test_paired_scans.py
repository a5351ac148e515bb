"""Pairing of messages; the waiting and the laser's pose are also tested through tracks, in test_track.py."""

from __future__ import annotations

from array import array
from types import SimpleNamespace

import pytest

from rce.mapping.scans import Scan
from tests.support.containers.recording_node import RecordingNode

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

from tests.support.containers.mapper_robot import transform


def scan_at(second: int) -> LaserScan:
    message = LaserScan(ranges=array("f", [1.0]))
    message.header.stamp, message.header.frame_id = Time(sec=second), "laser"
    return message


def test_topics_are_those_given_and_scans_come_with_stamp_and_odometry(interfaces: None) -> None:
    from rce_mapping.paired_scans import Frames, PairedScans

    node = RecordingNode(odom_timeout=0.5, use_odometry=True, odometry_from_tf=False)
    got: list[tuple[Time, Scan]] = []
    frames = Frames("odom", "base_link")
    scans = PairedScans(node, frames, lambda stamp, scan: got.append((stamp, scan)), "front", "wheels")  # type: ignore[arg-type]
    fixed = transform("base_link", "laser", 0.5, 0.0, Time())
    node.receive("/tf_static", SimpleNamespace(transforms=[fixed]))
    node.receive("front", scan_at(1))
    assert got == []
    assert scans.laser == pytest.approx((0.5, 0.0, 0.0))
    odometry = Odometry()
    odometry.header.stamp, odometry.pose.pose.position.x = Time(sec=1), 2.0
    node.receive("wheels", odometry)
    ((stamp, scan),) = got
    assert (stamp, scan.odometry) == (Time(sec=1), (2.0, 0.0, 0.0))
    node.receive("front", scan_at(2))
    assert [stamp.sec for stamp, _ in scans.drain()] == [2]
    assert scans.drain() == []
