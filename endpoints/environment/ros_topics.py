"""Subscriptions to serialized messages, and what they share with publishers. All methods run in the ROS thread."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.event_handler import EventHandler, SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from endpoints.environment.qos import describe, for_subscription, is_latched, mismatch
from endpoints.environment.ros import RosThread
from rce.protocol.messages import Qos

MAX_BATCH = 16  # messages taken of one entity before others have their turn
MAX_BATCH_BYTES = 64 * 1024  # a message with which they are reached is the last of its batch
# Fast DDS unmatches an entity that ends before it removes it from the graph cache, in a thread of its own.
GRAPH_DELAY = 0.2  # seconds after an event until the graph cache is right, on a busy machine too

Message = Any  # an instance of a generated message class; their module is known only at run time
Taken = tuple[bytes, bytes]
"""A message, and the gid of its publisher."""
Report = Callable[[str], None]
"""Reports an error to the owner of the interface; called in the ROS thread."""


@dataclass(frozen=True)
class Topic:
    """A topic as an interface wants it: the class of its messages, its name in ROS and its quality of service.

    `report` gets the reason when a node at the other side has an incompatible quality of service.
    """

    kind: type[Message]
    name: str
    qos: Qos
    report: Report


class TopicEnd:
    """Base of publishers and subscriptions: handles their QoS events."""

    subscriptions = clients = services = 0
    events = 2

    def __init__(self, ros: RosThread, topic: Topic) -> None:
        self.ros = ros
        self.topic = topic
        self.destroyed = False
        self._looks_again = False  # at the graph, after GRAPH_DELAY
        self._reported: set[str] = set()
        self.handlers: list[EventHandler] = []

    def add(self, wait_set: _rclpy.WaitSet) -> None:
        """Add the event handlers to the wait set."""
        for handler in self.handlers:
            handler.add_to_wait_set(wait_set)

    def take(self, wait_set: _rclpy.WaitSet) -> None:
        """Process the events that are ready."""
        changed = False
        for handler in self.handlers:
            if handler.is_ready(wait_set):
                handler.take_data()
                changed = True
        if changed:
            self.peers_changed()
            if not self._looks_again:
                self._looks_again = True
                self.ros.call_later(GRAPH_DELAY, self._look_again)

    def _look_again(self) -> None:
        self._looks_again = False
        if not self.destroyed:
            self.peers_changed()

    def peers_changed(self) -> None:
        """Handle a change of the publishers or subscriptions on the other side of the topic."""

    def check(self, pairs: list[tuple[QoSProfile, QoSProfile]]) -> None:
        """Report pairs of publisher and subscription with incompatible QoS, each reason once."""
        for offered, requested in pairs:
            if reason := mismatch(offered, requested):
                self._report_once(
                    f"topic {self.topic.name}: the publisher is {describe(offered)}, "
                    f"the subscription {describe(requested)}: {reason}. "
                    "Leave the qos of the interface at auto, or set it to a matching one"
                )

    def _report_once(self, reason: str) -> None:
        if reason not in self._reported:
            self._reported.add(reason)
            self.topic.report(reason)

    def without_own(self, infos: list[TopicEndpointInfo]) -> list[TopicEndpointInfo]:
        """Return the publishers or subscriptions that are not of this process."""
        return [info for info in infos if bytes(info.endpoint_gid[:12]) != self.ros.prefix]


class RawSubscription(TopicEnd):
    """Subscription to CDR bytes of all publishers except those of this process; paused until `start`.

    Attributes:
        had_publishers: True if the topic had publishers when the subscription was created.
    """

    subscriptions = 1

    def __init__(
        self, ros: RosThread, topic: Topic, taken: Callable[[Sequence[Taken]], bool], lost: Callable[[int], None]
    ) -> None:
        """Create a paused subscription.

        Args:
            ros: The ROS thread.
            topic: The topic.
            taken: Called with messages that came together; returns False to pause.
            lost: Called with the number of messages that the middleware dropped.
        """
        super().__init__(ros, topic)
        self._taken = taken
        self._lost = lost
        self._counted: set[bytes] = set()  # publishers of which a message was taken since `start`
        self._active = False
        self._started = False
        self._seen: dict[bytes, int] = {}  # last sequence number of each publisher
        publishers = self.publishers()
        self.had_publishers = bool(publishers)
        self._create(for_subscription(topic.qos, publishers))
        ros.add_waitable(self)
        self.check([(info.qos_profile, self._profile) for info in self.publishers()])

    @property
    def latched(self) -> bool:
        """True if late robots get earlier messages."""
        return is_latched(self._profile)

    def _create(self, profile: QoSProfile) -> None:
        events = SubscriptionEventCallbacks(matched=ignore, incompatible_qos=ignore, use_default_callbacks=False)
        self._subscription: Subscription[Message] = self.ros.node.create_subscription(
            self.topic.kind, self.topic.name, ignore, profile, event_callbacks=events, raw=True
        )
        self._profile = profile
        self.handlers = self._subscription.event_handlers

    def publishers(self) -> list[TopicEndpointInfo]:
        """Return the publishers of the topic that are not of this process."""
        return self.without_own(self.ros.node.get_publishers_info_by_topic(self.topic.name))

    def peers_changed(self) -> None:
        """Adapt the QoS to the publishers."""
        publishers = self.publishers()
        gids = {bytes(info.endpoint_gid) for info in publishers}
        self._seen = {gid: number for gid, number in self._seen.items() if gid in gids}
        self._counted &= gids
        profile = for_subscription(self.topic.qos, publishers)
        if publishers and profile != self._profile:
            # Set before _drain: the messages taken there do not come again, and must be kept if they are latched.
            self._profile = profile
            self._drain()
            self.ros.node.destroy_subscription(self._subscription)
            self._create(profile)
        self.check([(info.qos_profile, self._profile) for info in publishers])

    def start(self) -> None:
        """Take messages from now on, without those that came while there was no peer, unless the topic is latched.

        At the first start all messages are taken, because the robot is told that it is connected a moment before.
        """
        while self._started and not self.latched and self._next() is not None:
            pass
        self._counted.clear()
        self._started = self._active = True

    def resume(self) -> None:
        """Take messages again, including those that came since `pause`."""
        self._active = True

    def pause(self) -> None:
        """Leave messages in the middleware: it keeps the newest `depth`, or with `keep_all` makes publishers wait."""
        self._active = False

    def add(self, wait_set: _rclpy.WaitSet) -> None:
        """Add the subscription and its events to the wait set, unless it is paused.

        Events wait too, because Fast DDS has one condition for them and for messages: messages that are left there
        would wake the thread again and again.
        """
        self._index = None
        if self._active:
            super().add(wait_set)
            self._index = wait_set.add_subscription(self._subscription.handle)

    def take(self, wait_set: _rclpy.WaitSet) -> None:
        """Process events and take messages."""
        if self._index is None:
            return
        super().take(wait_set)  # publishers first: they decide whether messages are latched
        if wait_set.is_ready("subscription", self._index):
            self._take_batch()

    def _drain(self) -> None:
        while self._active and self._take_batch():
            pass

    def _take_batch(self) -> bool:
        """Take a few messages, and hand them on together; return False if there were none."""
        batch: list[Taken] = []
        size = count = 0
        while count < MAX_BATCH and size < MAX_BATCH_BYTES and (found := self._next()) is not None:
            count += 1
            if found[0]:
                batch.append(found)
                size += len(found[0])
        if batch and not self._taken(batch):
            self._active = False
        return count > 0

    def _next(self) -> Taken | None:
        """Return the next message and the gid of its publisher; None if there is none.

        The message is empty if this process published it, or if it was taken before.
        """
        found = self._subscription.handle.take_message(self.topic.kind, True)
        if found is None:
            return None
        payload, info = found
        assert info["publisher_gid"] is not None  # Fast DDS provides both
        assert info["publication_sequence_number"] is not None
        gid: bytes = info["publisher_gid"]["data"]
        number = info["publication_sequence_number"]
        if gid[:12] == self.ros.prefix or self._seen.get(gid, -1) >= number:
            return b"", gid
        if self._active and gid in self._counted and (missed := number - self._seen[gid] - 1):
            self._lost(missed)
        self._counted.add(gid)
        self._seen[gid] = number
        return bytes(payload), gid

    def destroy(self) -> None:
        """Destroy the subscription."""
        self.destroyed = True
        self.ros.node.destroy_subscription(self._subscription)


def ignore(_: object) -> None:
    """Do nothing about an event, which `TopicEnd.take` handles."""
