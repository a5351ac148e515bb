"""Publishers and subscriptions of serialized messages. All methods run in the ROS thread, unless said otherwise."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import EventHandler, PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from endpoints.environment.qos import for_publisher, for_subscription, is_latched, mismatch, words
from endpoints.environment.ros import RosThread
from endpoints.frames import Buffer
from rce.messages import Qos

AT_ONCE = 16  # messages taken of one entity before the others have their turn
LARGE = 256 * 1024  # bytes; publishing 10 MB takes 4 ms and more, so each such message is a turn of its own
# A node that has just appeared may hear us before its own publishers have found those who listen to it: what it
# answered to a message of this moment would be lost.
SETTLING = 0.1  # seconds
WINDOW = 32  # with keep_all: messages published before the subscribers must have confirmed them

_NO_TIME = Duration()

Message = Any  # an instance of a generated message class; their module is known only at run time
Complain = Callable[[str], None]
"""Takes a sentence for the owner of the interface; called in the ROS thread."""


class _Topic:
    """What publishers and subscriptions share: their events."""

    subscriptions = clients = services = 0
    events = 2

    def __init__(self, ros: RosThread, kind: type[Message], topic: str, qos: Qos, complain: Complain) -> None:
        self.topic = topic
        self._ros = ros
        self._kind = kind
        self._qos = qos
        self._complain = complain
        self._complaints: set[str] = set()
        self._handlers: list[EventHandler] = []

    def add(self, wait_set: _rclpy.WaitSet) -> None:
        for handler in self._handlers:
            handler.add_to_wait_set(wait_set)

    def take(self, wait_set: _rclpy.WaitSet) -> None:
        changed = False
        for handler in self._handlers:
            if handler.is_ready(wait_set):
                handler.take_data()
                changed = True
        if changed:
            self.changed()

    def changed(self) -> None:
        """The other side of the topic has changed."""

    def _check(self, pairs: list[tuple[QoSProfile, QoSProfile]]) -> None:
        """Complain, once each, of publishers and subscriptions that do not match."""
        for offered, requested in pairs:
            reason = mismatch(offered, requested)
            if reason and reason not in self._complaints:
                self._complaints.add(reason)
                self._complain(
                    f"topic {self.topic}: the publisher is {words(offered)}, the subscription {words(requested)}: "
                    f"{reason}. Leave the interface's qos at auto, or set it to match"
                )

    def _others(self, infos: list[TopicEndpointInfo]) -> list[TopicEndpointInfo]:
        return [info for info in infos if bytes(info.endpoint_gid[:12]) != self._ros.prefix]


class RawPublisher(_Topic):
    """Publishes CDR bytes; keeps them while nobody but ourselves subscribes."""

    def __init__(
        self,
        ros: RosThread,
        kind: type[Message],
        topic: str,
        qos: Qos,
        complain: Complain,
        published: Callable[[], None],
    ) -> None:
        super().__init__(ros, kind, topic, qos, complain)
        self.waiting: deque[Buffer] = deque()
        """Put in at the right by the loop, in order; taken out at the left here, after which `published` is called."""
        self._published = published
        self._unconfirmed = 0
        self._listening = self._heard = False  # somebody is there; and has been for a moment
        self._make(for_publisher(qos, self._others(ros.node.get_subscriptions_info_by_topic(topic))))
        ros.watch(self)
        self.changed()

    def _make(self, profile: QoSProfile) -> None:
        events = PublisherEventCallbacks(matched=_ignore, incompatible_qos=_ignore, use_default_callbacks=False)
        self._publisher: Publisher[Message] = self._ros.node.create_publisher(
            self._kind, self.topic, profile, event_callbacks=events
        )
        self._profile = profile
        self._handlers = self._publisher.event_handlers

    def changed(self) -> None:
        infos = self._ros.node.get_subscriptions_info_by_topic(self.topic)
        listeners = self._others(infos)
        profile = for_publisher(self._qos, listeners)
        if is_latched(profile) and not is_latched(self._profile):
            self._ros.node.destroy_publisher(self._publisher)
            self._make(profile)
        self._check([(self._profile, info.qos_profile) for info in listeners])
        own = [info for info in infos if info not in listeners and not mismatch(self._profile, info.qos_profile)]
        if self._publisher.get_subscription_count() <= len(own):
            self._listening = self._heard = False
        elif not self._listening:
            self._listening = True
            self._ros.later(SETTLING, self._begin)
        self.flush()

    def _begin(self) -> None:
        self._heard = self._listening
        self.flush()

    def flush(self) -> None:
        """Publish what waits, if there is somebody to hear it and, with keep_all, what went before is confirmed."""
        if not self._heard:
            return
        for _ in range(AT_ONCE):
            if not self.waiting:
                break
            if self._must_wait():
                self._ros.again(self.flush)
                break
            payload = self.waiting.popleft()
            self._publisher.handle.publish_raw(payload)  # type: ignore[arg-type]  # its C++ takes bytes and bytearray
            self._unconfirmed += 1
            if len(payload) >= LARGE:
                self._ros.post(self.flush)
                break
        else:
            self._ros.post(self.flush)
        self._published()

    def _must_wait(self) -> bool:
        if self._qos.history != "keep_all" or self._unconfirmed < WINDOW:
            return False
        if self._publisher.wait_for_all_acked(_NO_TIME):
            self._unconfirmed = 0
        return self._unconfirmed > 0

    def destroy(self) -> None:
        self._listening = self._heard = False
        self.waiting.clear()
        self._ros.node.destroy_publisher(self._publisher)


class RawSubscription(_Topic):
    """Takes CDR bytes of all publishers but ourselves; rests until `start`."""

    subscriptions = 1

    def __init__(
        self,
        ros: RosThread,
        kind: type[Message],
        topic: str,
        qos: Qos,
        complain: Complain,
        taken: Callable[[bytes, bytes], bool],
    ) -> None:
        super().__init__(ros, kind, topic, qos, complain)
        self._taken = taken  # gets a message and the gid of its publisher, returns whether it takes more
        self._flow = False
        self._started = False
        self._seen: dict[bytes, int] = {}  # last sequence number of each publisher
        speakers = self._speakers()
        self.found_speakers = bool(speakers)
        """Whether somebody published on the topic already."""
        self._make(for_subscription(qos, speakers))
        ros.watch(self)
        self._check([(info.qos_profile, self._profile) for info in self._speakers()])

    @property
    def latched(self) -> bool:
        """Whether late robots get what was published before."""
        return is_latched(self._profile)

    def _make(self, profile: QoSProfile) -> None:
        events = SubscriptionEventCallbacks(matched=_ignore, incompatible_qos=_ignore, use_default_callbacks=False)
        self._subscription: Subscription[Message] = self._ros.node.create_subscription(
            self._kind, self.topic, _ignore, profile, event_callbacks=events, raw=True
        )
        self._profile = profile
        self._handlers = self._subscription.event_handlers

    def _speakers(self) -> list[TopicEndpointInfo]:
        return self._others(self._ros.node.get_publishers_info_by_topic(self.topic))

    def changed(self) -> None:
        speakers = self._speakers()
        gids = {bytes(info.endpoint_gid) for info in speakers}
        self._seen = {gid: number for gid, number in self._seen.items() if gid in gids}
        profile = for_subscription(self._qos, speakers)
        if speakers and profile != self._profile:
            self._profile = profile  # what is taken now does not come again: if it is latched, it is to be kept
            self._drain()
            self._ros.node.destroy_subscription(self._subscription)
            self._make(profile)
        self._check([(info.qos_profile, self._profile) for info in speakers])

    def start(self) -> None:
        """Take from now on. What came while there was no peer is only for latched topics.

        The first time all is taken: the robot hears that it is connected a moment before this is called.
        """
        while self._started and not self.latched and self._next() is not None:
            pass
        self._started = self._flow = True

    def resume(self) -> None:
        """Take again, also what has come since `rest`."""
        self._flow = True

    def rest(self) -> None:
        """Leave messages in the middleware: it keeps the newest `depth`, or with keep_all makes publishers wait."""
        self._flow = False

    def add(self, wait_set: _rclpy.WaitSet) -> None:
        """While it rests its events wait too: to Fast DDS they are one condition with the messages that are left there,
        which would wake the thread again and again.
        """
        self._index = None
        if self._flow:
            super().add(wait_set)
            self._index = wait_set.add_subscription(self._subscription.handle)

    def take(self, wait_set: _rclpy.WaitSet) -> None:
        if self._index is None:
            return
        super().take(wait_set)  # first who speaks, then what was said: only so it is known what to keep
        if wait_set.is_ready("subscription", self._index):
            self._drain(AT_ONCE)

    def _drain(self, most: int = -1) -> None:
        while self._flow and most:
            found = self._next()
            if found is None:
                return
            if found[0] and not self._taken(*found):
                self._flow = False
            most -= 1

    def _next(self) -> tuple[bytes, bytes] | None:
        """The next message, empty if it is our own or was here before, and its publisher; None if there is none."""
        found = self._subscription.handle.take_message(self._kind, True)
        if found is None:
            return None
        payload, info = found
        assert info["publisher_gid"] is not None  # Fast DDS has both
        assert info["publication_sequence_number"] is not None
        gid: bytes = info["publisher_gid"]["data"]
        number = info["publication_sequence_number"]
        if gid[:12] == self._ros.prefix or self._seen.get(gid, -1) >= number:
            return b"", gid
        self._seen[gid] = number
        return bytes(payload), gid

    def destroy(self) -> None:
        self._ros.node.destroy_subscription(self._subscription)


def _ignore(_: object) -> None: ...
