"""The node `mapper`, with the node of a robot in the same process."""

# ruff: noqa: E402  (ROS is imported only if it is installed)

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs the extra `ros`")

from std_srvs.srv import Trigger

from rce.mapping3d.offload.messages import encode
from tests.support.key_frames import key_frame


def test_robots_of_a_team_have_their_own_topics_and_one_map(start_ros: Callable[..., None]) -> None:
    from rce_mapping3d.messages import compressed_message
    from rce_mapping3d.node import Mapper3dNode

    from tests.support.containers.rgbd_robot import Nodes

    start_ros("robots:=[ann, bob]")
    nodes = Nodes(Mapper3dNode(), prefix="bob/")
    nodes.until(lambda: bool(nodes.maps))
    assert list(nodes.maps[0].data) == [-1], "the first, empty map means that the node is ready"
    nodes.until_discovered(nodes.key_frames)
    for index in (0, 1, 1):
        nodes.key_frames.publish(compressed_message(float(index), "camera", "rce_key_frame", encode(key_frame(index))))
    nodes.until(lambda: len(nodes.poses) == 3 and len(nodes.corrections) >= 2)
    assert [each.header.stamp.sec for each in nodes.poses] == [0, 1, 1], "each key frame is answered"
    assert nodes.poses[1].pose.pose.position.x == pytest.approx(0.1)
    assert np.array(nodes.poses[1].pose.covariance).reshape(6, 6).diagonal().min() > 0
    assert [len(each.poses) for each in nodes.corrections] == [1, 1], "what has not moved is not told again"
    node = nodes.tested[0]
    node.publish()
    nodes.until(lambda: bool(nodes.teams) and json.loads(nodes.teams[-1].data) == ["bob"])
    assert nodes.call(Trigger, "reset").success
    assert len(node.shared.mapper.store) == 0
    nodes.close()
