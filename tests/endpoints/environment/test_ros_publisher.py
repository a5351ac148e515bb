"""Publishing waits for acknowledgements and counts what it cannot wait for; nodes that come late get the last message.

With a fake of rclpy's publisher.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast
from unittest.mock import Mock

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from endpoints.environment import ros_publisher
from endpoints.environment.ros import Ros
from endpoints.environment.ros_publisher import LAST_MESSAGES, PATIENCE, SHORT_PATIENCE, WINDOW, RawPublisher
from endpoints.environment.ros_topics import Topic
from rce.net.budget import INTERFACE
from rce.protocol.messages import Qos
from rce.protocol.messages.commands import DEEP, SHALLOW
from tests.support.endpoints.fake_ros import InstantRos


class Node:
    """A node of rclpy with one publisher, whose one subscription is that of a node which the test controls.

    Attributes:
        subscriptions: What the graph cache of rmw lists.
    """

    def __init__(self) -> None:
        self.subscriptions: list[Any] = []
        self.created = 0
        self.published: list[bytes] = []
        self.acknowledges = True
        self.publisher = Mock()
        self.publisher.handle.publish_raw = self.published.append
        self.publisher.get_subscription_count.return_value = 1
        self.publisher.wait_for_all_acked = lambda timeout: self.acknowledges

    def create_publisher(self, *_: object, **__: object) -> Any:
        self.created += 1
        return self.publisher

    def destroy_publisher(self, _: object) -> None: ...

    def get_subscriptions_info_by_topic(self, _: str) -> list[Any]:
        return self.subscriptions

    def match(self, count: int) -> None:
        """Set the number of subscriptions that are matched."""
        self.publisher.get_subscription_count.return_value = count


class FakeRos(InstantRos):
    """ROS with that node; what shall run soon runs when the test says so."""

    prefix = b"own"

    def __init__(self) -> None:
        super().__init__()
        self.node = Node()
        self.soon: list[Callable[[], None]] = []
        self.later: list[Callable[[], None]] = []

    def call_later(self, seconds: float, action: Callable[[], None]) -> None:
        self.later.append(action)

    def call_soon(self, action: Callable[[], None]) -> None:
        self.soon.append(action)


class Discovery:
    """What runs when nodes have discovered this process: at once, or when the test says so.

    Attributes:
        waiting: Actions that wait, in the order in which they were given; None while every node has discovered it.
    """

    waiting: list[Callable[[], None]] | None = None

    def after_discovery(self, ros: object, nodes: object, action: Callable[[], None]) -> None:
        if self.waiting is None:
            action()
        else:
            self.waiting.append(action)


@pytest.fixture(autouse=True)
def discovery(monkeypatch: pytest.MonkeyPatch) -> Discovery:
    found = Discovery()
    monkeypatch.setattr(ros_publisher, "after_discovery", found.after_discovery)
    return found


class World:
    """A publisher and the clock of its patience."""

    def __init__(self, qos: Qos) -> None:
        self.now = 0.0
        self.lost = 0
        self.ros = FakeRos()
        self.node = self.ros.node
        topic = Topic(String, "/topic", qos, print)
        self.publisher = RawPublisher(cast(Ros, self.ros), topic, lambda: None, self.lose, lambda: self.now)

    def lose(self, count: int) -> None:
        self.lost += count

    def publish(self, count: int, size: int = 10) -> None:
        self.publisher.waiting.extend([bytes(size)] * count)
        self.proceed()

    def retry(self) -> None:
        """Run what the publisher wants to do again."""
        actions, self.ros.retries = self.ros.retries, []
        for action in actions:
            action()

    def proceed(self) -> None:
        """Let the publisher do what it can."""
        self.publisher.flush()
        while self.ros.soon:
            self.ros.soon.pop(0)()


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


def subscription(name: str) -> Mock:
    """Return what rmw tells of the volatile subscription of a node."""
    return Mock(endpoint_gid=name.ljust(24).encode(), qos_profile=QoSProfile(depth=10))


def restarted(world: World) -> None:
    """Publish a message to a node that ends afterwards."""
    world.node.subscriptions = [subscription("before")]
    world.publisher.peers_changed()
    world.publish(1)
    world.node.subscriptions = []
    world.node.match(0)
    world.publisher.peers_changed()


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_restarted_node_gets_last_message_whichever_question_it_answers_first(
    discovery: Discovery, order: tuple[int, int]
) -> None:
    world = World(Qos())
    restarted(world)
    discovery.waiting = []
    world.node.subscriptions = [subscription("after")]
    world.node.match(1)
    world.publisher.peers_changed()
    for each in order:
        discovery.waiting[each]()
    assert len(world.node.published) == 2


def test_restarted_node_gets_last_message_though_graph_cache_lists_the_ended_one_at_the_event() -> None:
    """Fast DDS unmatches the subscription of a node that ends, and then removes it from the graph cache."""
    world = World(Qos())
    world.node.subscriptions = [subscription("before")]
    world.publisher.peers_changed()
    world.publish(1)
    world.node.subscriptions = [subscription("before"), subscription("after")]
    world.publisher.events.run()
    assert len(world.node.published) == 1
    world.node.subscriptions = [subscription("after")]
    for action in world.ros.later:
        action()
    assert len(world.node.published) == 2


def test_publisher_that_was_destroyed_does_not_look_at_the_graph_again() -> None:
    world = World(Qos())
    world.publisher.events.run()
    world.publisher.destroy()
    world.node.subscriptions = [subscription("latched")]
    world.node.subscriptions[0].qos_profile = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    created = world.node.created
    for action in world.ros.later:
        action()
    assert world.node.created == created


def test_publisher_stays_until_nodes_have_got_its_messages(discovery: Discovery) -> None:
    world = World(Qos())
    world.node.acknowledges = False
    discovery.waiting = []
    world.node.match(0)
    world.publisher.peers_changed()
    world.publish(1)
    world.node.match(1)
    world.publisher.peers_changed()
    world.publisher.finish()
    assert not world.node.published, "the node has not discovered the publisher"
    for action in discovery.waiting:
        action()
    assert len(world.node.published) == 1
    world.retry()
    assert not world.publisher.destroyed, "it is not acknowledged"
    world.node.acknowledges = True
    world.retry()
    assert world.publisher.destroyed


def test_publisher_whose_messages_nobody_gets_ends_in_time() -> None:
    world = World(Qos())
    world.node.match(0)
    world.publisher.peers_changed()
    world.publish(1)
    world.publisher.finish()
    world.now = LAST_MESSAGES - 0.01
    world.retry()
    assert not world.publisher.destroyed
    world.now = LAST_MESSAGES
    world.retry()
    assert world.publisher.destroyed
