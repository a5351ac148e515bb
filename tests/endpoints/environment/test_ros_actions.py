"""Goals' ids in the messages of ROS actions."""

from __future__ import annotations

import uuid

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")
pytest.importorskip("test_msgs", reason="needs ros-test-msgs: pip install '.[dev]'")

from rclpy.serialization import deserialize_message, serialize_message
from test_msgs.action import Fibonacci

from endpoints.environment.ros_actions import with_goal_id, without_goal_id


def test_goal_id_is_added_and_removed_without_other_changes() -> None:
    id, payload = uuid.uuid4().hex, bytes(serialize_message(Fibonacci.Goal(order=7)))
    assert without_goal_id(with_goal_id(payload, id)) == (id, payload)
    request = deserialize_message(with_goal_id(payload, id), Fibonacci.Impl.SendGoalService.Request)
    assert (bytes(request.goal_id.uuid).hex(), request.goal.order) == (id, 7)
