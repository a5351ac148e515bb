"""Publishing waits for acknowledgements, and counts what it cannot wait for; with a fake of rclpy's publisher."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast
from unittest.mock import Mock

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from std_msgs.msg import String

from endpoints.environment import ros_publisher
from endpoints.environment.ros import RosThread
from endpoints.environment.ros_publisher import PATIENCE, SHORT_PATIENCE, WINDOW, RawPublisher
from endpoints.environment.ros_topics import Topic
from rce.net.budget import INTERFACE
from rce.protocol.messages import Qos
from rce.protocol.messages.commands import DEEP, SHALLOW
from tests.support.endpoints.fake_ros import InstantRos


class Node:
    """A node of rclpy with one publisher, whose one subscription is that of a node which the test controls."""

    def __init__(self) -> None:
        self.published: list[bytes] = []
        self.acknowledges = True
        self.publisher = Mock(event_handlers=[])
        self.publisher.handle.publish_raw = self.published.append
        self.publisher.get_subscription_count.return_value = 1
        self.publisher.wait_for_all_acked = lambda timeout: self.acknowledges

    def create_publisher(self, *_: object, **__: object) -> Any:
        return self.publisher

    def get_subscriptions_info_by_topic(self, _: str) -> list[Any]:
        return []


class Ros(InstantRos):
    """ROS thread with that node; posted actions run when the one that posts them is done."""

    prefix = b"own"

    def __init__(self) -> None:
        super().__init__()
        self.node = Node()
        self.posted: list[Callable[[], None]] = []

    def post(self, action: Callable[[], None]) -> None:
        self.posted.append(action)

    def add_waitable(self, waitable: object) -> None: ...


@pytest.fixture(autouse=True)
def discovered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every node has discovered this process."""
    monkeypatch.setattr(ros_publisher, "after_discovery", lambda ros, nodes, action: action())


class World:
    """A publisher and the clock of its patience."""

    def __init__(self, qos: Qos) -> None:
        self.now = 0.0
        self.lost = 0
        self.ros = Ros()
        self.node = self.ros.node
        topic = Topic(String, "/topic", qos, print)
        self.publisher = RawPublisher(cast(RosThread, self.ros), topic, lambda: None, self.lose, lambda: self.now)

    def lose(self, count: int) -> None:
        self.lost += count

    def publish(self, count: int, size: int = 10) -> None:
        self.publisher.waiting.extend([bytes(size)] * count)
        self.proceed()

    def proceed(self) -> None:
        """Let the publisher do what it can."""
        self.publisher.flush()
        while self.ros.posted:
            self.ros.posted.pop(0)()


@pytest.mark.parametrize(("qos", "most"), [(Qos(), DEEP), (Qos(depth=3), 3), (Qos(history="keep_all"), WINDOW)])
def test_publishing_waits_when_history_is_full_of_unacknowledged_messages(qos: Qos, most: int) -> None:
    world = World(qos)
    world.node.acknowledges = False
    world.publish(most + 5)
    assert len(world.node.published) == most
    world.node.acknowledges = True
    world.proceed()
    assert len(world.node.published) == most + 5
    assert world.lost == 0


def test_acknowledged_messages_are_forgotten_before_history_is_full() -> None:
    """So a node that is killed later does not stop the others at once."""
    world = World(Qos())
    for _ in range(DEEP):
        world.publish(1)
    world.node.acknowledges = False
    world.publish(DEEP // 2)
    assert len(world.node.published) == DEEP + DEEP // 2


def test_bytes_that_wait_for_acknowledgement_are_bounded() -> None:
    world = World(Qos())
    world.node.acknowledges = False
    world.publish(5, INTERFACE // 2)
    assert len(world.node.published) == 2


@pytest.mark.parametrize(("qos", "patience"), [(Qos(), PATIENCE), (Qos(depth=SHALLOW), SHORT_PATIENCE)])
def test_node_that_never_acknowledges_stops_publishing_for_a_limited_time_only(qos: Qos, patience: float) -> None:
    world = World(qos)
    depth = qos.depth or DEEP
    world.node.acknowledges = False
    world.publish(depth + 5)
    world.now = patience - 0.01
    world.proceed()
    assert len(world.node.published) == depth
    world.now = patience
    world.publish(20)
    assert len(world.node.published) == depth + 25
    assert world.lost == 25, "those that DDS has overwritten"
    world.node.acknowledges = True
    world.publish(depth)
    assert world.lost == 25


def test_publishing_never_loses_with_keep_all() -> None:
    world = World(Qos(history="keep_all"))
    world.node.acknowledges = False
    world.publish(WINDOW + 1)
    world.now = 1000 * PATIENCE
    world.proceed()
    assert len(world.node.published) == WINDOW
    assert world.lost == 0
