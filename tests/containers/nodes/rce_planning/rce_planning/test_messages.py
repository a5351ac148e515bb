"""Conversion between messages and types; costs are tested in test_node.py."""

from __future__ import annotations

import numpy as np

from rce.mapping.geometry import Pose


def test_path_has_the_poses_in_its_frame(interfaces: None) -> None:
    from builtin_interfaces.msg import Time
    from rce_planning.messages import path_message, pose_from

    path = path_message(np.array([[1.0, 2.0, 0.5, 1.0]]), Time(sec=3), "map")
    assert path.poses[0].header.frame_id == "map"
    assert path.poses[0].header.stamp.sec == 3
    assert np.allclose(pose_from(path.poses[0].pose), Pose(1.0, 2.0, 0.5))
