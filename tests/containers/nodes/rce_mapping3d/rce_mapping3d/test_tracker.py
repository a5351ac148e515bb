"""The node `tracker`, with a camera and a mapper in the same process."""

from __future__ import annotations

from collections.abc import Callable

import pytest

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from geometry_msgs.msg import PoseStamped

from rce.mapping3d.evaluation.room import QVGA
from tests.support.rgbd import CLEAN, simulated


@pytest.mark.slow
def test_camera_of_a_robot_with_ros_is_tracked_and_mapped(start_ros: Callable[..., None]) -> None:
    from rce_mapping3d.node import Mapper3dNode
    from rce_mapping3d.tracker import TrackerNode

    from tests.support.containers.rgbd_robot import Nodes

    start_ros()
    mapper, tracker = Mapper3dNode(), TrackerNode()
    nodes = Nodes(mapper, tracker)
    poses: list[PoseStamped] = []
    nodes.node.create_subscription(PoseStamped, "camera_pose", poses.append, 100)
    nodes.until_discovered(nodes.key_frames)
    for topic in (nodes.color, nodes.depth, nodes.info):  # the mapper would track the images itself
        nodes.until(lambda topic=topic: topic.get_subscription_count() == 2)  # type: ignore[misc]
    del mapper.members[0]._images
    for subscription in [each for each in mapper.subscriptions if "/camera/" in each.topic_name]:
        mapper.destroy_subscription(subscription)
    nodes.until(lambda: tracker._pose_out.get_subscription_count() == 1)
    nodes.until(lambda: tracker._key_frames_out.get_subscription_count() == 1)
    nodes.send_camera(QVGA)
    nodes.until(lambda: tracker._images._camera is not None)
    for number, frame in enumerate(simulated(0.4, 2.0, CLEAN), 1):
        nodes.send_images(frame)
        nodes.until(lambda number=number: len(poses) == number)  # type: ignore[misc]
    assert tracker._tracking is not None
    nodes.until(lambda: len(tracker._tracking.outbox) == 0)  # type: ignore[union-attr]
    assert len(mapper.shared.mapper.store) == tracker._tracking.key_frames > 1
    assert poses[-1].header.frame_id == "map"
    nodes.close()
