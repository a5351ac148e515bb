"""Correction of the odometry as a transform."""

from __future__ import annotations

import math

import pytest

from rce.mapping.geometry import Pose
from tests.support.containers.recording_node import RecordingNode

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from builtin_interfaces.msg import Time

ROBOT, ODOMETRY = Pose(3.0, 1.0, 0.5), Pose(2.0, -1.0, 0.25)


def test_correction_moves_the_odometry_to_the_pose(interfaces: None) -> None:
    from rce_mapping import messages
    from rce_mapping.transforms import TransformSender

    node = RecordingNode()
    TransformSender(node, "map", "odom", "base_link").send(Time(sec=7), ROBOT, ODOMETRY)
    (sent,) = node.sent("/tf")[0].transforms
    assert (sent.header.frame_id, sent.child_frame_id, sent.header.stamp) == ("map", "odom", Time(sec=7))
    place, turn = sent.transform.translation, sent.transform.rotation
    assert Pose(place.x, place.y, messages.yaw_of(turn)) @ ODOMETRY == pytest.approx(ROBOT)


def test_without_odometry_the_robot_is_in_the_map(interfaces: None) -> None:
    from rce_mapping.transforms import TransformSender

    node = RecordingNode()
    TransformSender(node, "map", "odom", "base_link").send(Time(sec=7), ROBOT, None)
    (sent,) = node.sent("/tf")[0].transforms
    assert (sent.header.frame_id, sent.child_frame_id) == ("map", "base_link")
    assert (sent.transform.translation.x, sent.transform.translation.y) == (3.0, 1.0)
    assert sent.transform.rotation.w == pytest.approx(math.cos(0.25))


def test_nothing_is_sent_without_tf2(interfaces: None, monkeypatch: pytest.MonkeyPatch) -> None:
    from rce_mapping import transforms

    monkeypatch.setattr(transforms, "TFMessage", None)
    node = RecordingNode()
    transforms.TransformSender(node, "map", "odom", "base_link").send(Time(), ROBOT, None)
    assert node.publishers == {}
