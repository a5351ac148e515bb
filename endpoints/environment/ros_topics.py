"""Subscriptions to serialized messages, and what they share with publishers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.event_handler import QoSSubscriptionEventType, SubscriptionEventCallbacks
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from endpoints.environment.qos import describe, for_subscription, is_latched, mismatch
from endpoints.environment.ros import Ros
from endpoints.environment.ros_listener import Listener
from rce.protocol.messages import Qos

MAX_BATCH = 16  # messages taken of one entity before others have their turn
MAX_BATCH_BYTES = 64 * 1024  # a message with which they are reached is the last of its batch
# Fast DDS unmatches an entity that ends before it removes it from the graph cache, in a thread of its own.
GRAPH_DELAY = 0.2  # seconds after an event until the graph cache is right, on a busy machine too

EVENTS = (
    QoSSubscriptionEventType.RCL_SUBSCRIPTION_MATCHED,
    QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS,
)
NO_DEFAULTS = SubscriptionEventCallbacks(use_default_callbacks=False)
Message = Any  # an instance of a generated message class; their module is known only at run time
Taken = tuple[bytes, bytes]
"""A message, and the gid of its publisher."""
Report = Callable[[str], None]
"""Reports an error to the owner of the interface."""


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
    """Base of publishers and subscriptions, which handles their QoS events.

    Attributes:
        events: The listener of these events.
    """

    events: Listener

    def __init__(self, ros: Ros, topic: Topic) -> None:
        self.ros = ros
        self.topic = topic
        self.destroyed = False
        self._looks_again = False  # at the graph, after GRAPH_DELAY
        self._reported: set[str] = set()

    def changed(self) -> None:
        """Handle an event."""
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

    def __init__(
        self, ros: Ros, topic: Topic, taken: Callable[[Sequence[Taken]], bool], lost: Callable[[int], None]
    ) -> None:
        """Create a paused subscription.

        Args:
            ros: The ROS node.
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
        self.check([(info.qos_profile, self._profile) for info in self.publishers()])

    @property
    def latched(self) -> bool:
        """True if late robots get earlier messages."""
        return is_latched(self._profile)

    def _create(self, profile: QoSProfile) -> None:
        self._subscription: Subscription[Message] = self.ros.node.create_subscription(
            self.topic.kind, self.topic.name, ignore, profile, event_callbacks=NO_DEFAULTS, raw=True
        )
        self._profile = profile
        self._messages = self.ros.listen(self._take_some, self._subscription.handle)
        self.events = self.ros.listen_to_events(self.changed, self._subscription.handle, EVENTS)
        if not self._active:
            self.pause()

    def _end(self) -> None:
        self.ros.end(self._messages)
        self.ros.end(self.events)
        self.ros.node.destroy_subscription(self._subscription)

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
            self._end()
            self._create(profile)
        self.check([(info.qos_profile, self._profile) for info in publishers])

    def start(self) -> None:
        """Take messages from now on, without those that came while there was no peer, unless the topic is latched.

        At the first start all messages are taken, because the robot is told that it is connected a moment before.
        """
        while self._started and not self.latched and self._next() is not None:
            pass
        self._counted.clear()
        self._started = True
        self.resume()

    def resume(self) -> None:
        """Take messages again, including those that came since `pause`."""
        self._active = True
        self.events.resume()
        self._messages.resume()

    def pause(self) -> None:
        """Leave messages in the middleware: it keeps the newest `depth`, or with `keep_all` makes publishers wait."""
        self._active = False
        self.events.pause()
        self._messages.pause()

    def _take_some(self) -> None:
        self.events.run()  # publishers first: they decide whether messages are latched
        if self._active and self._take_batch():
            self._messages.again()

    def _drain(self) -> None:
        while self._active and self._take_batch():
            pass

    def _take_batch(self) -> bool:
        """Take a few messages, and hand them on together; return True if there may be more."""
        batch: list[Taken] = []
        size = count = 0
        more = True
        while more and count < MAX_BATCH and size < MAX_BATCH_BYTES:
            found = self._next()
            if found is None:
                more = False
                break
            count += 1
            if found[0]:
                batch.append(found)
                size += len(found[0])
        if batch and not self._taken(batch):
            self.pause()
        return more

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
        self._end()


def ignore(_: object) -> None:
    """Do nothing about a message, which a `RawSubscription` takes."""
