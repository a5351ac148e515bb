"""Topic interfaces of an environment, which pass serialized messages through unchanged."""

from __future__ import annotations

import asyncio
from collections import deque
from time import perf_counter
from uuid import uuid4

from endpoints.data.frames import Buffer, Message
from endpoints.data.interface import error_of
from endpoints.data.link import Link
from endpoints.environment.interfaces import RosContext, RosInterface
from endpoints.environment.ros_publisher import RawPublisher
from endpoints.environment.ros_topics import SETTLING_TIME, RawSubscription, Topic
from endpoints.environment.ros_types import message_class
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import ConversionError, InvalidRequest, LimitExceeded
from rce.net.budget import INTERFACE
from rce.protocol.messages.commands import SHALLOW

HIGH_WATER = 8  # unpublished messages at which the sender has to wait, with keep_all
MAX_UNHANDLED = 8  # messages taken from ROS that the loop has not handled yet
NODE_START = 5  # seconds in which a node starts and subscribes, on a busy machine too
MAX_LATCHED = 100  # publishers of a latched topic whose last messages are kept for late robots
ENCAPSULATIONS = (b"\0\0", b"\0\1")  # CDR, big and little endian


class _TopicInterface(RosInterface):
    """Interface to a topic."""

    def _topic(self) -> Topic:
        """Return the topic that the spec describes; raise UnknownType if there is no such message type."""
        return Topic(
            message_class(self.spec.type, self._context.definitions),
            self.spec.addr,
            self.qos,
            lambda reason: self._report_from_ros(InvalidRequest, reason),
        )

    def _lost(self, count: int) -> None:
        """Count messages that the middleware dropped; called in the ROS thread."""
        self._ros.deliver(lambda: self.evicted(count))


class PublisherInterface(_TopicInterface):
    """Publishes the messages of its peers.

    While there is no subscription, the newest `depth` messages wait for nodes that are still starting. Without a depth,
    these are the messages of the last `NODE_START` seconds, and `SHALLOW` messages at least. Others are not dropped but
    unheard, since no node would have received them. Nodes that start later get the last message (see `RawPublisher`),
    as from the latched publishers of the original. With `keep_all` none is dropped: the sender has to wait.
    """

    _publisher: RawPublisher
    _room: asyncio.Future[None] | None = None
    _largest = 0  # size of the largest message since messages began to wait

    def __init__(self, spec: InterfaceSpec, context: RosContext) -> None:
        super().__init__(spec, context)
        self._received = deque([0], maxlen=NODE_START)  # number of messages in each of the last seconds

    async def open(self) -> None:
        """Create the ROS entity."""
        topic = self._topic()
        self._publisher = await self._create(lambda: RawPublisher(self._ros, topic, self._published, self._lost))

    def receive(self, message: Message, link: Link) -> None:
        """Queue a message for the ROS thread to publish."""
        payload = message.payload
        if len(payload) < 4 or payload[:2] not in ENCAPSULATIONS or message.error:
            self._report_once(ConversionError(f"interface {self.spec.tag}: a message is not serialized as CDR"))
            return
        self._context.shared.publish(self.spec, message, link, self.qos.durability == "transient_local")
        waiting = self._publisher.waiting
        waiting.append(bytes(payload) if isinstance(payload, memoryview) else payload)
        self._largest = max(self._largest, len(payload)) if len(waiting) > 1 else len(payload)
        if self.keep is not None:
            self._received[-1] += 1
            self._shorten(self.keep)
        elif len(waiting) >= HIGH_WATER or self._too_large(waiting):
            if self._room is None:
                self._room = asyncio.get_running_loop().create_future()
            link.pause(self._room)
        self._ros.post(lambda: self._flush(message))

    def tick(self, now: float) -> None:
        """Forget messages that came long before any node subscribes."""
        if self.keep is not None and not self.qos.depth and not self._publisher.has_subscription:
            self._shorten(max(SHALLOW, sum(self._received)))
        self._received.append(0)

    def _flush(self, message: Message) -> None:
        """Publish what waits; called in the ROS thread."""
        self._publisher.flush()
        if not self._publisher.waiting:
            self.hops.delivered(self.id, message)

    def _too_large(self, waiting: deque[Buffer]) -> bool:
        """Return True if more than one message waits and their bytes exceed those of an interface."""
        if len(waiting) < 2 or len(waiting) * self._largest <= INTERFACE:
            return False
        return sum(map(len, list(waiting))) > INTERFACE  # a copy: the ROS thread takes messages meanwhile

    def _shorten(self, keep: int) -> None:
        """Remove the oldest messages beyond `keep`, or beyond the bytes of an interface.

        They are dropped if a node subscribes, and unheard if no robot does either.
        """
        waiting = self._publisher.waiting
        removed = 0
        while len(waiting) > keep or self._too_large(waiting):
            try:
                waiting.popleft()
            except IndexError:  # the ROS thread has published it meanwhile
                break
            removed += 1
        if self._publisher.has_subscription:
            self.dropped += removed
        elif not self._context.shared.has_receivers(self.spec):
            self.unheard += removed

    def _published(self) -> None:
        """Handle that messages were published; called in the ROS thread."""
        if self._room is not None:
            self._ros.deliver(self._has_room)

    def _has_room(self) -> None:
        if self._room is not None and len(self._publisher.waiting) < HIGH_WATER:
            self._room.set_result(None)
            self._room = None

    def close(self) -> None:
        """Destroy the publisher; messages that wait are dropped."""
        if self._room is not None:
            self._room.set_result(None)
            self._room = None
        self._ros.post(lambda: self._ros.remove_waitable(self._publisher))


class SubscriberInterface(_TopicInterface):
    """Sends the messages of a topic to all its peers.

    The subscription is created with the interface, so that it has discovered its publishers before the first peer
    comes, and is paused while there is no peer. The last messages of latched publishers are kept for late peers.
    """

    _subscription: RawSubscription

    def __init__(self, spec: InterfaceSpec, context: RosContext) -> None:
        super().__init__(spec, context)
        self._taken = 0  # counted by the ROS thread
        self._handled = 0  # counted by the loop
        self._latched: dict[bytes, deque[bytes]] = {}  # by publisher
        self._latched_size = 0
        self._latched_depth = (spec.qos.depth or SHALLOW) if spec.qos.durability == "transient_local" else 1

    async def open(self) -> None:
        """Create the ROS entity."""
        topic = self._topic()
        self._subscription = await self._create(lambda: RawSubscription(self._ros, topic, self._take, self._lost))
        self._context.shared.add(self)
        if self._subscription.had_publishers:
            # Messages that they publish before they discover the subscription would be lost after the status is true.
            await asyncio.sleep(SETTLING_TIME)

    def receive(self, message: Message, link: Link) -> None:
        """Report an error: that of a message which did not reach its robot, or that this interface receives none."""
        if message.error:
            self._report_once(error_of(message))
        else:
            self._report_once(InvalidRequest(f"interface {self.spec.tag} sends messages and cannot receive any"))

    def receive_shared(self, message: Message, link: Link, latched: bool) -> None:
        """Send a message that another interface of the environment publishes.

        What came from an environment goes to robots only: environments that are connected in a circle would pass a
        message on for ever.
        """
        payload = bytes(message.payload)
        if latched or self._subscription.latched:
            self._keep_latched(payload, message.source)
        links = {each for each in self.peers.values() if not (link.to_environment and each.to_environment)}
        if not links:
            return
        passed_on = Message(self.id, uuid4().hex, payload)
        for each in links:
            self._put(passed_on, each, self.keep)
        self.traffic.sent.count(len(payload))
        room = self.wait_for_room()
        if room is not None:
            link.pause(room)

    def started(self) -> None:
        """Start taking messages."""
        self._ros.post(self._subscription.start)

    def stopped(self) -> None:
        """Stop taking messages."""
        self._ros.post(self._subscription.pause)

    def joined(self, peer: bytes) -> None:
        """Send the kept messages of latched publishers to a new peer."""
        for messages in self._latched.values():
            for payload in messages:
                self.send(Message(self.id, uuid4().hex, payload, destination=peer))

    def _take(self, payload: bytes, publisher: bytes) -> bool:
        """Pass a message to the loop; return False to pause until the loop has caught up. Called in the ROS thread."""
        self._taken += 1
        since = perf_counter()
        more = self._taken - self._handled < MAX_UNHANDLED
        self._ros.deliver(lambda: self._handle(payload, publisher, more, since))
        return more

    def _handle(self, payload: bytes, publisher: bytes, more: bool, since: float) -> None:
        self._handled += 1
        try:
            message = Message(self.id, uuid4().hex, payload, entered_at=since)
        except LimitExceeded as error:
            self.dropped += 1
            self._report_once(error)
        else:
            if self._subscription.latched:
                self._keep_latched(payload, publisher)
            if self.peers:
                self.send(message)
        if not more:
            self._resume()

    def _resume(self) -> None:
        """Continue to take messages as soon as the links have room."""
        room = self.wait_for_room()
        if room is not None:
            room.add_done_callback(lambda _: self._resume())
        elif self.peers:
            self._ros.post(self._subscription.resume)

    def _keep_latched(self, payload: bytes, publisher: bytes) -> None:
        kept = self._latched[publisher] = self._latched.pop(publisher, deque())  # the last of the publishers now
        kept.append(payload)
        self._latched_size += len(payload)
        if len(kept) > self._latched_depth:
            self._latched_size -= len(kept.popleft())
        while len(self._latched) > MAX_LATCHED or self._latched_size > max(INTERFACE, len(payload)):
            self._forget_latched()

    def _forget_latched(self) -> None:
        """Forget the oldest message of the publisher that has not published for the longest time."""
        publisher, kept = next(iter(self._latched.items()))
        self._latched_size -= len(kept.popleft())
        if not kept:
            del self._latched[publisher]

    def close(self) -> None:
        """Destroy the subscription."""
        self._context.shared.remove(self)
        self._ros.post(lambda: self._ros.remove_waitable(self._subscription))
