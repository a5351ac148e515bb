"""Topics and services of one robot."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from nav_msgs.srv import GetMap, GetPlan
from std_srvs.srv import Trigger

from rce.mapping3d.evaluation.room import QVGA
from rce.mapping3d.offload.streams import FORMAT, FrameEncoder
from tests.support.rgbd import CLEAN, simulated


@pytest.mark.slow
def test_frames_of_a_robot_that_does_not_track_are_tracked_and_mapped(start_ros: Callable[..., None]) -> None:
    from rce_mapping.inputs import LOSSLESS
    from rce_mapping3d.messages import compressed_message
    from rce_mapping3d.node import Mapper3dNode
    from std_msgs.msg import UInt8MultiArray

    from tests.support.containers.rgbd_robot import Nodes

    start_ros()
    nodes = Nodes(Mapper3dNode())
    pieces: list[UInt8MultiArray] = []
    nodes.node.create_subscription(UInt8MultiArray, "files", pieces.append, LOSSLESS)
    nodes.until_discovered(nodes.frames)
    encoder, recording = FrameEncoder(QVGA), simulated(0.4, 2.0, CLEAN)
    for frame in recording:
        nodes.frames.publish(compressed_message(frame.stamp, "camera", FORMAT, encoder.encode(frame)))
    nodes.frames.publish(compressed_message(9.0, "camera", FORMAT, b"damaged"))
    nodes.until(lambda: len(nodes.poses) == len(recording.way) + 1)
    assert nodes.poses[-1].pose.covariance[0] >= 1e6, "a frame without a pose is answered too"
    path = nodes.call(GetPlan, "get_path").plan
    assert len(path.poses) == len(nodes.tested[0].shared.mapper.store) > 1
    assert path.poses[0].header.frame_id == "map"
    grid = nodes.call(GetMap, "dynamic_map").map
    assert grid.header.frame_id == "map_level"
    assert max(grid.data) > 50
    goal = nodes.call(GetPlan, "next_goal").plan
    assert len(goal.poses) <= 1
    assert goal.header.frame_id == "map"
    names = json.loads(nodes.call(Trigger, "export").message)
    nodes.until(lambda: {piece.layout.dim[0].label for piece in pieces} == set(names))
    assert {"cloud.ply", "mesh.ply", "view.png", "map.pgm"} <= set(names)
    nodes.close()
