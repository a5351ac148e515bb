"""Publishers of serialized messages."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, QoSPublisherEventType
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

from endpoints.data.frames import Buffer
from endpoints.environment.discovery import after_discovery
from endpoints.environment.qos import for_publisher, is_latched, mismatch
from endpoints.environment.ros import Ros
from endpoints.environment.ros_topics import MAX_BATCH, Message, Topic, TopicEnd
from rce.net.budget import INTERFACE
from rce.protocol.messages.commands import DEEP

LARGE = 256 * 1024  # bytes; publishing 10 MB takes 4 ms and more, so each such message is a turn of its own
WINDOW = 32  # with keep_all: unacknowledged messages at which publishing waits
# Otherwise DDS would overwrite the oldest messages of a burst that nodes have not got yet. Publishing waits for them,
# but for these times at most: a node that was stopped must not hold up the others for long.
PATIENCE, SHORT_PATIENCE = 10.0, 0.1  # seconds, with a history of `DEEP` or more messages, and with a shorter one
LAST_MESSAGES = 1.0  # seconds that a publisher stays for messages that nodes have not got yet

EVENTS = (
    QoSPublisherEventType.RCL_PUBLISHER_MATCHED,
    QoSPublisherEventType.RCL_PUBLISHER_OFFERED_INCOMPATIBLE_QOS,
)
NO_DEFAULTS = PublisherEventCallbacks(use_default_callbacks=False)
_NO_TIME = Duration()


class RawPublisher(TopicEnd):
    """Publisher of CDR bytes, which waits while only this process subscribes, and keeps the last message.

    A late node gets the last message: by the middleware if both sides are transient_local, else it is published again.
    DDS cannot address one subscription, so that is done only while no other subscription would get it twice.

    Attributes:
        waiting: Messages to publish; see `flush`.
    """

    def __init__(
        self,
        ros: Ros,
        topic: Topic,
        published: Callable[[], None],
        lost: Callable[[int], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Create a publisher.

        Args:
            ros: The ROS node.
            topic: The topic.
            published: Called after messages were published.
            lost: Called with the number of messages that the middleware overwrites although a node that has not
                acknowledged for long may lack them.
            clock: Source of the time in seconds.
        """
        super().__init__(ros, topic)
        self.waiting: deque[Buffer] = deque()
        self._published = published
        self._lost = lost
        self._clock = clock
        self._unacknowledged = self._unacknowledged_bytes = 0  # since nodes had acknowledged all messages
        self._waits_since: float | None = None  # time since which publishing waits, or would wait, for nodes
        # A node that has just appeared may get our messages before its own publishers have discovered their
        # subscriptions: its replies to these messages would be lost.
        self._matched = self._settled = False  # there is a subscription; and its node has discovered ours
        self._last: Buffer | None = None  # of the published messages
        self._subscribed: dict[bytes, bool] = {}  # subscriptions by gid; True if they got the last message
        self._create(for_publisher(topic.qos, self._subscriptions()))
        self.peers_changed()

    def _create(self, profile: QoSProfile) -> None:
        self._publisher: Publisher[Message] = self.ros.node.create_publisher(
            self.topic.kind, self.topic.name, profile, event_callbacks=NO_DEFAULTS
        )
        self._profile = profile
        self.events = self.ros.listen_to_events(self.changed, self._publisher.handle, EVENTS)

    def _end(self) -> None:
        self.ros.end(self.events)
        self.ros.node.destroy_publisher(self._publisher)

    def _subscriptions(self) -> list[TopicEndpointInfo]:
        return self.without_own(self.ros.node.get_subscriptions_info_by_topic(self.topic.name))

    def peers_changed(self) -> None:
        """Adapt the QoS to the subscriptions and publish what waits, if there are any."""
        infos = self.ros.node.get_subscriptions_info_by_topic(self.topic.name)
        subscriptions = self.without_own(infos)
        profile = for_publisher(self.topic.qos, subscriptions)
        self._subscribed = {
            gid: self._subscribed.get(gid, is_latched(self._profile) and is_latched(info.qos_profile))
            for info in subscriptions
            if (gid := bytes(info.endpoint_gid))
        }
        if is_latched(profile) and not is_latched(self._profile):
            self._end()
            self._create(profile)
            self._subscribed = dict.fromkeys(self._subscribed, False)  # the new publisher has published nothing
        self.check([(self._profile, info.qos_profile) for info in subscriptions])
        own = [info for info in infos if info not in subscriptions and not mismatch(self._profile, info.qos_profile)]
        if self._publisher.get_subscription_count() <= len(own):
            self._matched = self._settled = False
        elif not self._matched:
            self._matched = True
            after_discovery(self.ros, self._subscriptions, self._settling_over)
        if self._last is not None and self._late():
            after_discovery(self.ros, self._subscriptions, self._publish_again)
        self.flush()

    def _settling_over(self) -> None:
        self._settled = self._matched
        self._publish_again()  # the question for it may have been answered first
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
                self.ros.retry(self.flush)
                break
            payload = self.waiting.popleft()
            self._publisher.handle.publish_raw(payload)  # type: ignore[arg-type]  # its C++ takes bytes and bytearray
            if self.topic.qos.durability != "volatile":
                self._last = payload
            self._subscribed = dict.fromkeys(self._subscribed, True)
            self._count(len(payload))
            if len(payload) >= LARGE:
                self.ros.call_soon(self.flush)
                break
        else:
            self.ros.call_soon(self.flush)
        self._published()

    def _count(self, size: int) -> None:
        """Count a message that was published, and the one that it has overwritten."""
        self._unacknowledged += 1
        self._unacknowledged_bytes += size
        if self.topic.qos.history != "keep_all" and self._unacknowledged > self._profile.depth:
            self._lost(1)

    def _must_wait(self) -> bool:
        """Return True while nodes have to acknowledge messages first.

        That takes as long as they need with `keep_all`, and a limited time otherwise.
        """
        keep_all = self.topic.qos.history == "keep_all"
        most = WINDOW if keep_all else self._profile.depth
        used = max(self._unacknowledged / most, self._unacknowledged_bytes / INTERFACE)
        if used < 0.5:  # asking is not free
            return False
        if self._publisher.wait_for_all_acked(_NO_TIME):
            self._unacknowledged = self._unacknowledged_bytes = 0
            self._waits_since = None
            return False
        if used < 1:
            return False
        if self._waits_since is None:
            self._waits_since = self._clock()
        patience = PATIENCE if self._profile.depth >= DEEP else SHORT_PATIENCE
        return keep_all or self._clock() - self._waits_since < patience

    def finish(self) -> None:
        """End the publisher as soon as nodes have got all messages, after `LAST_MESSAGES` seconds at the latest.

        A client may connect, publish and leave before the nodes have discovered the publisher.
        """
        until = self._clock() + LAST_MESSAGES

        def end() -> None:
            if self._clock() < until and (self.waiting or not self._publisher.wait_for_all_acked(_NO_TIME)):
                self.ros.retry(end)
            else:
                self.destroy()

        end()

    def destroy(self) -> None:
        """Destroy the publisher and drop what waits."""
        self.destroyed = True
        self._matched = self._settled = False
        self.waiting.clear()
        self._last = None
        self._end()
