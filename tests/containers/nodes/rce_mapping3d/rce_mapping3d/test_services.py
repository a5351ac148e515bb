"""Services of a mapper as a whole."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from std_srvs.srv import Trigger

from tests.support.key_frames import key_frame


def test_session_is_saved_and_continued(start_ros: Callable[..., None], tmp_path: Path) -> None:
    from rce_mapping3d.node import Mapper3dNode
    from slam_toolbox.srv import DeserializePoseGraph, SerializePoseGraph

    from tests.support.containers.rgbd_robot import Nodes

    start_ros()
    node = Mapper3dNode()
    nodes = Nodes(node)
    node.shared.add("robot", key_frame(0))
    node.shared.add("robot", key_frame(1))
    saved = nodes.call(SerializePoseGraph, "slam_toolbox/serialize_map", filename=str(tmp_path / "session"))
    assert saved.result == SerializePoseGraph.Response.RESULT_SUCCESS
    nodes.call(Trigger, "reset")
    assert len(node.shared.mapper.store) == 0
    nodes.call(DeserializePoseGraph, "slam_toolbox/deserialize_map", filename=str(tmp_path / "session"))
    assert len(node.shared.mapper.store) == 2
    assert nodes.call(Trigger, "optimise").success
    nodes.call(DeserializePoseGraph, "slam_toolbox/deserialize_map", filename=str(tmp_path / "none"))
    assert len(node.shared.mapper.store) == 2, "a session that cannot be read changes nothing"
    nodes.close()
