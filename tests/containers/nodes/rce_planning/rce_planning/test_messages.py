"""Conversion between messages and types; costs are tested in test_node.py."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.geometry import Pose
from tests.support.planning import walled


def test_map_is_that_of_the_message(interfaces: None) -> None:
    from builtin_interfaces.msg import Time
    from rce_mapping.messages import grid_message
    from rce_planning.messages import grid_from

    message = grid_message(walled(), Time(), "map")
    assert np.array_equal(grid_from(message).cells, walled().cells)
    message.info.width += 1
    with pytest.raises(InvalidRequest, match="values"):
        grid_from(message)
    message.info.width -= 1
    message.info.origin.orientation.z = message.info.origin.orientation.w = math.sqrt(0.5)
    with pytest.raises(InvalidRequest, match="turned"):
        grid_from(message)


def test_path_has_the_poses_in_its_frame(interfaces: None) -> None:
    from builtin_interfaces.msg import Time
    from rce_planning.messages import path_message, pose_from

    path = path_message(np.array([[1.0, 2.0, 0.5, 1.0]]), Time(sec=3), "map")
    assert path.poses[0].header.frame_id == "map"
    assert path.poses[0].header.stamp.sec == 3
    assert np.allclose(pose_from(path.poses[0].pose), Pose(1.0, 2.0, 0.5))
