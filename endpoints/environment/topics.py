"""Topic interfaces of an environment, which pass serialized messages through unchanged."""

from __future__ import annotations

import asyncio
from collections import deque

from endpoints.data.frames import Buffer, Message
from endpoints.data.interface import error_of
from endpoints.data.link import Link
from endpoints.environment.interfaces import RosContext, RosInterface
from endpoints.environment.ros_publisher import RawPublisher
from endpoints.environment.ros_topics import Topic
from endpoints.environment.ros_types import message_class
from endpoints.environment.shared_subscription import SharedSubscription
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import ConversionError, InvalidRequest, RceError
from rce.net.budget import INTERFACE
from rce.protocol.messages.commands import SHALLOW

HIGH_WATER = 8  # unpublished messages at which the sender has to wait, with keep_all
NODE_START = 5  # seconds in which a node starts and subscribes, on a busy machine too
ENCAPSULATIONS = (b"\0\0", b"\0\1")  # CDR, big and little endian


class PublisherInterface(RosInterface):
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
        self._publisher = self._create(lambda: RawPublisher(self._ros, topic, self._published, self.evicted))

    def _topic(self) -> Topic:
        """Return the topic that the spec describes; raise UnknownType if there is no such message type."""
        return Topic(
            message_class(self.spec.type, self._context.definitions),
            self.spec.addr,
            self.qos,
            lambda reason: self._report_from_ros(InvalidRequest, reason),
        )

    def receive(self, message: Message, link: Link) -> None:
        """Publish a message, or let it wait."""
        payload = message.payload
        if len(payload) < 4 or payload[:2] not in ENCAPSULATIONS or message.error:
            self._report_once(ConversionError(f"interface {self.spec.tag}: a message is not serialized as CDR"))
            return
        self._context.shared.publish(self.spec, message, link, self.qos.durability == "transient_local")
        waiting = self._publisher.waiting
        waiting.append(bytes(payload) if isinstance(payload, memoryview) else payload)
        self._largest = max(self._largest, len(payload)) if len(waiting) > 1 else len(payload)
        self._publisher.flush()
        if not waiting:
            self.hops.delivered(self.id, message)
        if self.keep is not None:
            self._received[-1] += 1
            self._shorten(self.keep)
        elif len(waiting) >= HIGH_WATER or self._too_large(waiting):
            if self._room is None:
                self._room = asyncio.get_running_loop().create_future()
            link.pause(self._room)

    def tick(self, now: float) -> None:
        """Forget messages that came long before any node subscribes."""
        if self.keep is not None and not self.qos.depth and not self._publisher.has_subscription:
            self._shorten(max(SHALLOW, sum(self._received)))
        self._received.append(0)

    def _too_large(self, waiting: deque[Buffer]) -> bool:
        """Return True if more than one message waits and their bytes exceed those of an interface."""
        if len(waiting) < 2 or len(waiting) * self._largest <= INTERFACE:
            return False
        return sum(map(len, waiting)) > INTERFACE

    def _shorten(self, keep: int) -> None:
        """Remove the oldest messages beyond `keep`, or beyond the bytes of an interface.

        They are dropped if a node subscribes, and unheard if no robot does either.
        """
        waiting = self._publisher.waiting
        removed = 0
        while len(waiting) > keep or self._too_large(waiting):
            waiting.popleft()
            removed += 1
        if self._publisher.has_subscription:
            self.dropped += removed
        elif not self._context.shared.has_receivers(self.spec):
            self.unheard += removed

    def _published(self) -> None:
        """Handle that messages were published."""
        if self._room is not None and len(self._publisher.waiting) < HIGH_WATER:
            self._room.set_result(None)
            self._room = None

    def close(self) -> None:
        """End the publisher, once nodes that subscribe have got the messages that wait."""
        if self._room is not None:
            self._room.set_result(None)
            self._room = None
        self._publisher.finish()


class SubscriberInterface(RosInterface):
    """Sends the messages of a topic to all its peers.

    The subscription, which it shares with others that want the same, is created before the first peer comes, so that it
    has discovered its publishers, and is paused while nobody has a peer.
    """

    _subscription: SharedSubscription

    async def open(self) -> None:
        """Join the subscription of the topic, or create it."""
        kind = message_class(self.spec.type, self._context.definitions)
        self._subscription = await self._context.subscriptions.join(self, self.qos, self.keep, kind, self._create)

    @property
    def queue(self) -> bytes:
        """Source of its messages in the queues of links."""
        return self._subscription.id

    def receive(self, message: Message, link: Link) -> None:
        """Report an error: that of a message which did not reach its robot, or that this interface receives none."""
        if message.error:
            self._report_once(error_of(message))
        else:
            self._report_once(InvalidRequest(f"interface {self.spec.tag} sends messages and cannot receive any"))

    def joined(self, peer: bytes) -> None:
        """Take messages, and send the kept ones of latched publishers to a new peer."""
        self._subscription.peers_changed()
        self._subscription.send_latched(self, peer)

    def unlinked(self, link: Link) -> None:
        """Stop taking messages if nobody has a peer any more."""
        self._subscription.peers_changed()

    def sent(self, size: int) -> None:
        """Count a message to the peers."""
        self.traffic.sent.count(size)

    def lost(self, count: int, link: Link | None) -> None:
        """Count messages that were dropped, on the way to a link or before."""
        if link is None:
            self.evicted(count)
        else:
            self.count_drops(count, link)

    def refused(self, error: RceError) -> None:
        """Report an error once."""
        self._report_once(error)

    def close(self) -> None:
        """Leave the subscription."""
        self._context.subscriptions.leave(self, self._subscription)
