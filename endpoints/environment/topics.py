"""The topic interfaces of an environment: serialized messages pass through as they are."""

from __future__ import annotations

import asyncio
from collections import deque
from time import perf_counter
from uuid import uuid4

from endpoints.environment.interfaces import RosInterface, Surroundings
from endpoints.environment.ros_topics import SETTLING, RawPublisher, RawSubscription
from endpoints.environment.ros_types import message_class
from endpoints.frames import Buffer, Message
from endpoints.link import Link
from rce.calls.endpoints import InterfaceSpec
from rce.errors import ConversionError, InvalidRequest

HIGH_WATER = 8  # with keep_all: messages not yet published at which the sender has to wait
IN_HAND = 8  # messages taken from ROS that the loop has not yet handled
MOST_LATCHED = 100  # publishers of a latched topic whose last messages are kept for late robots
ENCAPSULATIONS = (b"\0\0", b"\0\1")  # CDR, big and little endian


class PublisherInterface(RosInterface):
    """Publishes what its peers send.

    Messages that come while nobody subscribes wait (the newest `depth`) for a node that is still starting, as the
    latched publishers of the original did. With keep_all none is dropped: the sender has to wait.
    """

    _publisher: RawPublisher
    _room: asyncio.Future[None] | None = None

    async def open(self) -> None:
        kind = message_class(self.spec.type, self._around.definitions)
        self._publisher = await self._make(
            lambda: RawPublisher(
                self._ros,
                kind,
                self.spec.addr,
                self.spec.qos,
                lambda sentence: self._complain_from_ros(InvalidRequest, sentence),
                self._published,
            )
        )

    def receive(self, message: Message, link: Link) -> None:
        payload = message.payload
        if len(payload) < 4 or payload[:2] not in ENCAPSULATIONS or message.error:
            self._complain(ConversionError(f"interface {self.spec.tag}: a message is not serialized as CDR"))
            return
        waiting = self._publisher.waiting
        waiting.append(bytes(payload) if isinstance(payload, memoryview) else payload)
        if self.keep is not None:
            self._forget_oldest(waiting, self.keep)
        elif len(waiting) >= HIGH_WATER:
            if self._room is None:
                self._room = asyncio.get_running_loop().create_future()
            link.pause(self._room)
        self._ros.post(lambda: self._flush(message))

    def _flush(self, message: Message) -> None:
        """In the ROS thread."""
        self._publisher.flush()
        if not self._publisher.waiting:
            self.watch.ended(self.id, message)

    def _forget_oldest(self, waiting: deque[Buffer], keep: int) -> None:
        while len(waiting) > keep:
            try:
                waiting.popleft()
            except IndexError:  # the ROS thread was faster
                return
            self.dropped += 1

    def _published(self) -> None:
        """In the ROS thread, after messages were published."""
        if self._room is not None:
            self._ros.deliver(self._has_room)

    def _has_room(self) -> None:
        if self._room is not None and len(self._publisher.waiting) < HIGH_WATER:
            self._room.set_result(None)
            self._room = None

    def close(self) -> None:
        if self._room is not None:
            self._room.set_result(None)
            self._room = None
        self._ros.post(lambda: self._ros.unwatch(self._publisher))


class SubscriberInterface(RosInterface):
    """Sends what is published to all its peers.

    The subscription is made with the interface, so that it has found its publishers before the first peer comes, and
    rests while there is none. The last messages of latched publishers are kept for late peers.
    """

    _subscription: RawSubscription

    def __init__(self, spec: InterfaceSpec, around: Surroundings) -> None:
        super().__init__(spec, around)
        self._taken = 0  # counted by the ROS thread
        self._handled = 0  # counted by the loop
        self._latched: dict[bytes, deque[bytes]] = {}  # by publisher
        self._each = spec.qos.depth if spec.qos.durability == "transient_local" else 1

    async def open(self) -> None:
        kind = message_class(self.spec.type, self._around.definitions)
        self._subscription = await self._make(
            lambda: RawSubscription(
                self._ros,
                kind,
                self.spec.addr,
                self.spec.qos,
                lambda sentence: self._complain_from_ros(InvalidRequest, sentence),
                self._take,
            )
        )
        if self._subscription.found_speakers:
            # They may take a moment to find us: what they said until then would be lost although the status is true.
            await asyncio.sleep(SETTLING)

    def receive(self, message: Message, link: Link) -> None:
        self._complain(InvalidRequest(f"interface {self.spec.tag} sends messages, it takes none"))

    def started(self) -> None:
        self._ros.post(self._subscription.start)

    def stopped(self) -> None:
        self._ros.post(self._subscription.rest)

    def joined(self, peer: bytes) -> None:
        for messages in self._latched.values():
            for payload in messages:
                self.send(Message(self.id, uuid4().hex, payload, destination=peer))

    def _take(self, payload: bytes, publisher: bytes) -> bool:
        """In the ROS thread: take a message, and say whether to go on; if not, the loop does once it has caught up."""
        self._taken += 1
        since = perf_counter()
        more = self._taken - self._handled < IN_HAND
        self._ros.deliver(lambda: self._handle(payload, publisher, more, since))
        return more

    def _handle(self, payload: bytes, publisher: bytes, more: bool, since: float) -> None:
        self._handled += 1
        if self._subscription.latched:
            self._keep_latched(payload, publisher)
        if self.peers:
            self.send(Message(self.id, uuid4().hex, payload, since=since))
        if not more:
            self._go_on()

    def _go_on(self) -> None:
        """Take more from ROS as soon as the links have room."""
        room = self.room()
        if room is not None:
            room.add_done_callback(lambda _: self._go_on())
        elif self.peers:
            self._ros.post(self._subscription.resume)

    def _keep_latched(self, payload: bytes, publisher: bytes) -> None:
        if publisher not in self._latched and len(self._latched) >= MOST_LATCHED:
            del self._latched[next(iter(self._latched))]
        self._latched.setdefault(publisher, deque(maxlen=self._each)).append(payload)

    def close(self) -> None:
        self._ros.post(lambda: self._ros.unwatch(self._subscription))
