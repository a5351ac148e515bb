"""A robot's node beside a node of the benchmark, on one executor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.support.spin import spin_until

DEPTH = 1000  # so that nothing is lost while this process does not run


class Bench:
    """Nodes on one executor.

    Attributes:
        robot: Node of the test.
    """

    def __init__(self) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        self._executor = SingleThreadedExecutor()
        self._nodes: list[Any] = []
        self.robot = rclpy.create_node("robot")
        self.add(self.robot)

    def add(self, node: Any) -> None:
        """Run a node, too."""
        self._nodes.append(node)
        self._executor.add_node(node)

    def until(self, condition: Callable[[], bool]) -> None:
        """Run the nodes until a condition holds."""
        spin_until(self._executor, condition)

    def publisher(self, kind: Any, topic: str) -> Any:
        """Return a publisher that a node has discovered."""
        made = self.robot.create_publisher(kind, topic, DEPTH)
        self.until(lambda: made.get_subscription_count() == 1)
        return made

    def received(self, kind: Any, topic: str) -> list[Any]:
        """Return the list that messages of a topic are added to, once its publisher was discovered."""
        found: list[Any] = []
        self.robot.create_subscription(kind, topic, found.append, DEPTH)
        self.until(lambda: all(each.get_subscription_count() for each in self._publishers(topic)))
        return found

    def _publishers(self, topic: str) -> list[Any]:
        return [each for node in self._nodes for each in node.publishers if each.topic_name == f"/{topic}"]

    def close(self) -> None:
        self._executor.shutdown()
        for node in self._nodes:
            node.destroy_node()


@pytest.fixture
def bench(start_ros: Callable[..., None]) -> Iterator[Bench]:
    start_ros()
    bench = Bench()
    yield bench
    bench.close()
