"""The planner node and the node of a robot, on one executor."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.support.spin import spin_until


class World:
    """A planner node and a robot."""

    def __init__(self) -> None:
        import rclpy
        from rce_planning.node import PlannerNode
        from rclpy.action.client import ActionClient
        from rclpy.executors import SingleThreadedExecutor

        self.planner = PlannerNode()
        self.node = rclpy.create_node("robot")
        self.action = importlib.import_module("nav2_msgs.action").ComputePathToPose
        self.client: Any = ActionClient(self.node, self.action, "/compute_path_to_pose")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.planner)
        self.executor.add_node(self.node)

    def until(self, condition: Callable[[], bool]) -> None:
        spin_until(self.executor, condition)

    def compute(self, **fields: Any) -> Any:
        """Send a goal and return its result."""
        self.until(self.client.server_is_ready)
        accepted = self.client.send_goal_async(self.action.Goal(**fields))
        self.until(accepted.done)
        result = accepted.result().get_result_async()
        self.until(result.done)
        return result.result().result

    def close(self) -> None:
        self.executor.shutdown()
        self.client.destroy()
        self.node.destroy_node()
        self.planner.destroy_node()


@pytest.fixture
def world(start_ros: Callable[..., None]) -> Iterator[World]:
    start_ros("allow_unknown:=false", "robot_radius:=0.15", "max_planning_time:=60.0")
    world = World()
    yield world
    world.close()
