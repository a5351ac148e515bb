"""Publishers and subscriptions of serialized messages. All methods run in the ROS thread."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import EventHandler, PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from endpoints.data.frames import Buffer
from endpoints.environment.qos import describe, for_publisher, for_subscription, is_latched, mismatch
from endpoints.environment.ros import RosThread
from rce.protocol.messages import Qos
from rce.protocol.messages.commands import DEEP

MAX_BATCH = 16  # messages taken of one entity before others have their turn
LARGE = 256 * 1024  # bytes; publishing 10 MB takes 4 ms and more, so each such message is a turn of its own
# A node that has just appeared may get our messages before its own publishers have discovered their subscriptions: its
# replies to these messages would be lost.
SETTLING_TIME = 0.1  # seconds
WINDOW = 32  # with keep_all: unacknowledged messages at which publishing waits
BURST = 0.1  # seconds in which a burst may fill half of the history of DDS

_NO_TIME = Duration()

Message = Any  # an instance of a generated message class; their module is known only at run time
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


class _TopicEnd:
    """Base of publishers and subscriptions: handles their QoS events."""

    subscriptions = clients = services = 0
    events = 2

    def __init__(self, ros: RosThread, topic: Topic) -> None:
        self._ros = ros
        self._topic = topic
        self._reported: set[str] = set()
        self._handlers: list[EventHandler] = []

    def add(self, wait_set: _rclpy.WaitSet) -> None:
        """Add the event handlers to the wait set."""
        for handler in self._handlers:
            handler.add_to_wait_set(wait_set)

    def take(self, wait_set: _rclpy.WaitSet) -> None:
        """Process the events that are ready."""
        changed = False
        for handler in self._handlers:
            if handler.is_ready(wait_set):
                handler.take_data()
                changed = True
        if changed:
            self.peers_changed()

    def peers_changed(self) -> None:
        """Handle a change of the publishers or subscriptions on the other side of the topic."""

    def _check(self, pairs: list[tuple[QoSProfile, QoSProfile]]) -> None:
        """Report pairs of publisher and subscription with incompatible QoS, each reason once."""
        for offered, requested in pairs:
            if reason := mismatch(offered, requested):
                self._report_once(
                    f"topic {self._topic.name}: the publisher is {describe(offered)}, "
                    f"the subscription {describe(requested)}: {reason}. "
                    "Leave the qos of the interface at auto, or set it to a matching one"
                )

    def _report_once(self, reason: str) -> None:
        if reason not in self._reported:
            self._reported.add(reason)
            self._topic.report(reason)

    def _without_own(self, infos: list[TopicEndpointInfo]) -> list[TopicEndpointInfo]:
        return [info for info in infos if bytes(info.endpoint_gid[:12]) != self._ros.prefix]


class RawPublisher(_TopicEnd):
    """Publisher of CDR bytes, which waits while only this process subscribes, and keeps the last message.

    A late node gets the last message: by the middleware if both sides are transient_local, else it is published again.
    DDS cannot address one subscription, so that is done only while no other subscription would get it twice.

    Attributes:
        waiting: Messages to publish. The loop appends to the right, the ROS thread takes from the left and calls
            `published` afterwards.
    """

    def __init__(self, ros: RosThread, topic: Topic, published: Callable[[], None]) -> None:
        super().__init__(ros, topic)
        self.waiting: deque[Buffer] = deque()
        self._published = published
        self._unacknowledged = 0
        self._window_began = 0.0  # monotonic time since which these are counted
        self._matched = self._settled = False  # there is a subscription; and it has been there for SETTLING_TIME
        self._last: Buffer | None = None  # of the published messages
        self._subscribed: dict[bytes, bool] = {}  # subscriptions by gid; True if they got the last message
        self._create(for_publisher(topic.qos, self._without_own(ros.node.get_subscriptions_info_by_topic(topic.name))))
        ros.add_waitable(self)
        self.peers_changed()

    def _create(self, profile: QoSProfile) -> None:
        events = PublisherEventCallbacks(matched=_ignore, incompatible_qos=_ignore, use_default_callbacks=False)
        self._publisher: Publisher[Message] = self._ros.node.create_publisher(
            self._topic.kind, self._topic.name, profile, event_callbacks=events
        )
        self._profile = profile
        self._handlers = self._publisher.event_handlers

    def peers_changed(self) -> None:
        """Adapt the QoS to the subscriptions and publish what waits, if there are any."""
        infos = self._ros.node.get_subscriptions_info_by_topic(self._topic.name)
        subscriptions = self._without_own(infos)
        profile = for_publisher(self._topic.qos, subscriptions)
        self._subscribed = {
            gid: self._subscribed.get(gid, is_latched(self._profile) and is_latched(info.qos_profile))
            for info in subscriptions
            if (gid := bytes(info.endpoint_gid))
        }
        if is_latched(profile) and not is_latched(self._profile):
            self._ros.node.destroy_publisher(self._publisher)
            self._create(profile)
            self._subscribed = dict.fromkeys(self._subscribed, False)  # the new publisher has published nothing
        self._check([(self._profile, info.qos_profile) for info in subscriptions])
        own = [info for info in infos if info not in subscriptions and not mismatch(self._profile, info.qos_profile)]
        if self._publisher.get_subscription_count() <= len(own):
            self._matched = self._settled = False
        elif not self._matched:
            self._matched = True
            self._ros.call_later(SETTLING_TIME, self._settling_over)
        if self._last is not None and self._late():
            self._ros.call_later(SETTLING_TIME, self._publish_again)
        self.flush()

    def _settling_over(self) -> None:
        self._settled = self._matched
        self.flush()

    @property
    def has_subscription(self) -> bool:
        """True if a node subscribes to the topic."""
        return self._matched

    def _late(self) -> bool:
        """Return True if there are subscriptions, of which none got the last message."""
        return bool(self._subscribed) and not any(self._subscribed.values())

    def _publish_again(self) -> None:
        if self._settled and self._last is not None and self._late() and not self.waiting:
            self.waiting.appendleft(self._last)
            self.flush()

    def flush(self) -> None:
        """Publish what waits, once there are subscriptions and they have acknowledged enough."""
        if not self._settled:
            return
        for _ in range(MAX_BATCH):
            if not self.waiting:
                break
            if self._must_wait():
                self._ros.retry(self.flush)
                break
            payload = self.waiting.popleft()
            self._publisher.handle.publish_raw(payload)  # type: ignore[arg-type]  # its C++ takes bytes and bytearray
            if self._topic.qos.durability != "volatile":
                self._last = payload
            self._subscribed = dict.fromkeys(self._subscribed, True)
            self._unacknowledged += 1
            if len(payload) >= LARGE:
                self._ros.post(self.flush)
                break
        else:
            self._ros.post(self.flush)
        self._published()

    def _must_wait(self) -> bool:
        """Return True while nodes have to acknowledge messages first.

        With `keep_all`, that takes as long as they need. Otherwise DDS overwrites the oldest messages of a burst,
        perhaps before nodes have got them: after half of its history, publishing waits for a moment.
        """
        if self._unacknowledged < self._window:
            return False
        now = time.monotonic()
        over = self._topic.qos.history != "keep_all" and now - self._window_began > BURST
        if over or self._publisher.wait_for_all_acked(_NO_TIME):
            self._unacknowledged, self._window_began = 0, now
        return self._unacknowledged > 0

    @property
    def _window(self) -> float:
        """Number of messages after which nodes have to acknowledge them."""
        if self._topic.qos.history == "keep_all":
            return WINDOW
        return self._profile.depth // 2 if self._profile.depth >= DEEP else math.inf

    def destroy(self) -> None:
        """Destroy the publisher and drop what waits."""
        self._matched = self._settled = False
        self.waiting.clear()
        self._last = None
        self._ros.node.destroy_publisher(self._publisher)


class RawSubscription(_TopicEnd):
    """Subscription to CDR bytes of all publishers except those of this process; paused until `start`.

    Attributes:
        had_publishers: True if the topic had publishers when the subscription was created.
    """

    subscriptions = 1

    def __init__(
        self, ros: RosThread, topic: Topic, taken: Callable[[bytes, bytes], bool], lost: Callable[[int], None]
    ) -> None:
        """Create a paused subscription.

        Args:
            ros: The ROS thread.
            topic: The topic.
            taken: Called with a message and the gid of its publisher; returns False to pause.
            lost: Called with the number of messages that the middleware dropped.
        """
        super().__init__(ros, topic)
        self._taken = taken
        self._lost = lost
        self._counted: set[bytes] = set()  # publishers of which a message was taken since `start`
        self._active = False
        self._started = False
        self._seen: dict[bytes, int] = {}  # last sequence number of each publisher
        publishers = self._publishers()
        self.had_publishers = bool(publishers)
        self._create(for_subscription(topic.qos, publishers))
        ros.add_waitable(self)
        self._check([(info.qos_profile, self._profile) for info in self._publishers()])

    @property
    def latched(self) -> bool:
        """True if late robots get earlier messages."""
        return is_latched(self._profile)

    def _create(self, profile: QoSProfile) -> None:
        events = SubscriptionEventCallbacks(matched=_ignore, incompatible_qos=_ignore, use_default_callbacks=False)
        self._subscription: Subscription[Message] = self._ros.node.create_subscription(
            self._topic.kind, self._topic.name, _ignore, profile, event_callbacks=events, raw=True
        )
        self._profile = profile
        self._handlers = self._subscription.event_handlers

    def _publishers(self) -> list[TopicEndpointInfo]:
        return self._without_own(self._ros.node.get_publishers_info_by_topic(self._topic.name))

    def peers_changed(self) -> None:
        """Adapt the QoS to the publishers."""
        publishers = self._publishers()
        gids = {bytes(info.endpoint_gid) for info in publishers}
        self._seen = {gid: number for gid, number in self._seen.items() if gid in gids}
        self._counted &= gids
        profile = for_subscription(self._topic.qos, publishers)
        if publishers and profile != self._profile:
            # Set before _drain: the messages taken there do not come again, and must be kept if they are latched.
            self._profile = profile
            self._drain()
            self._ros.node.destroy_subscription(self._subscription)
            self._create(profile)
        self._check([(info.qos_profile, self._profile) for info in publishers])

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
            self._drain(MAX_BATCH)

    def _drain(self, most: int = -1) -> None:
        while self._active and most:
            found = self._next()
            if found is None:
                return
            if found[0] and not self._taken(*found):
                self._active = False
            most -= 1

    def _next(self) -> tuple[bytes, bytes] | None:
        """Return the next message and the gid of its publisher; None if there is none.

        The message is empty if this process published it, or if it was taken before.
        """
        found = self._subscription.handle.take_message(self._topic.kind, True)
        if found is None:
            return None
        payload, info = found
        assert info["publisher_gid"] is not None  # Fast DDS provides both
        assert info["publication_sequence_number"] is not None
        gid: bytes = info["publisher_gid"]["data"]
        number = info["publication_sequence_number"]
        if gid[:12] == self._ros.prefix or self._seen.get(gid, -1) >= number:
            return b"", gid
        if self._active and gid in self._counted and (missed := number - self._seen[gid] - 1):
            self._lost(missed)
        self._counted.add(gid)
        self._seen[gid] = number
        return bytes(payload), gid

    def destroy(self) -> None:
        """Destroy the subscription."""
        self._ros.node.destroy_subscription(self._subscription)


def _ignore(_: object) -> None: ...
