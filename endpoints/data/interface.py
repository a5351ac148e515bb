"""Interface: one end of connections, with a robot or ROS behind it."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod

import msgspec
from twisted.logger import Logger

from endpoints.data.frames import Message, Phase
from endpoints.data.hops import HopRecorder
from endpoints.data.link import Link
from endpoints.data.traffic import InterfaceCounter
from rce.control.calls.endpoints import InterfaceSpec
from rce.control.calls.watching import InterfaceTraffic
from rce.errors import MALFORMED, ErrorInfo, LimitExceeded, NotConnected, RceError
from rce.net.budget import INTERFACE, MB, Budget
from rce.protocol.messages.commands import DEEP, SHALLOW

MAX_REQUESTS = 1000  # service messages of one interface that may wait for a link

log = Logger()


class Interface(ABC):
    """One end of connections.

    Subclasses implement what happens to received messages and what happens when peers come and go.

    Attributes:
        peers: Link to each peer, by the id of the peer's interface.
        dropped: Number of messages dropped so far, in both directions.
        unheard: Number of messages discarded so far because no node and no robot subscribes to the topic.
        budget: Bytes that the interface's messages may hold while they wait.
        qos: Quality of service, with the default depth for the type.
        keep: Number of messages to one peer that may wait: the newest `depth` of a topic; None for all.
    """

    def __init__(self, spec: InterfaceSpec, hops: HopRecorder, within: Budget | None = None) -> None:
        """Create an interface without peers; its budget is a part of `within`."""
        self.spec = spec
        self.budget = Budget(INTERFACE, within, spare=1)
        self.qos = spec.qos.for_type(spec.type)
        depth = self.qos.depth or (SHALLOW if self.qos.reliability == "best_effort" else DEEP)
        self.keep = None if self.qos.history == "keep_all" else depth
        self.id = bytes.fromhex(spec.id)
        self.hops = hops
        self.peers: dict[bytes, Link] = {}
        self.dropped = self.unheard = 0
        self.traffic = InterfaceCounter()

    @property
    def counted(self) -> InterfaceTraffic:
        """The traffic so far."""
        return self.traffic.snapshot(self.dropped, self.unheard)

    @abstractmethod
    def receive(self, message: Message, link: Link) -> None:
        """Handle a message of a peer.

        It must not raise for malformed content and must not block; `link.pause` applies back-pressure to the sender.
        """

    @property
    def connected(self) -> bool:
        """True if the interface has a peer."""
        return bool(self.peers)

    @property
    def queue(self) -> bytes:
        """Source of the interface's messages in the queues of links."""
        return self.id

    def joined(self, peer: bytes) -> None:
        """Handle a new peer."""

    def unlinked(self, link: Link) -> None:
        """Handle that no peer is behind a link any more: drop what waits there."""
        link.discard(self.id)

    def left(self, peer: bytes) -> None:
        """Handle the departure of a peer."""

    def started(self) -> None:
        """Handle the arrival of the first peer; called before `joined`."""

    def stopped(self) -> None:
        """Handle the departure of the last peer."""

    def close(self) -> None:
        """Release what the interface holds; it has no peers any more."""

    def send(self, message: Message) -> None:
        """Send a message to every peer, or to `message.destination`.

        Raises:
            NotConnected: There is no such peer.
        """
        self._deliver(message, self.keep)

    def _deliver(self, message: Message, keep: int | None) -> None:
        if message.destination is None:
            links = set(self.peers.values())
        elif message.destination in self.peers:
            links = {self.peers[message.destination]}
        else:
            raise NotConnected(f"interface {self.spec.tag}: the peer to which this message is addressed is gone")
        if not links:
            raise NotConnected(f"interface {self.spec.tag} has no connection: wait for its status, or connect it")
        for link in links:
            dropped = link.send(message, keep, self)
            if dropped:
                self.count_drops(dropped, link)
        self.traffic.sent.count(len(message.payload))

    def evicted(self, count: int) -> None:
        """Count messages that were dropped from a queue because a larger budget was exceeded."""
        self.dropped += count
        if len(self.peers) == 1:
            self.traffic.of(next(iter(self.peers))).drops += count

    def count_drops(self, count: int, link: Link) -> None:
        """Count messages that were dropped on the way to a link."""
        self.dropped += count
        for peer, towards in self.peers.items():
            if towards is link:
                self.traffic.of(peer).drops += count

    def wait_for_room(self) -> asyncio.Future[None] | None:
        """Return None while more may be sent, else a future that is done when it may; only with `keep_all`."""
        if self.keep is None:
            for link in self.peers.values():
                waiting = link.wait_for_room(self.id)
                if waiting is not None:
                    return waiting
        return None

    def request(self, message: Message) -> None:
        """Send a message of a service, which is never dropped.

        Raises:
            LimitExceeded: Too many messages wait already.
            NotConnected: There is no such peer.
        """
        most = 1 if self.budget.full else MAX_REQUESTS
        if any(link.backlog(self.id) >= most for link in self.peers.values()):
            raise LimitExceeded(
                f"{self.spec.owner}/{self.spec.tag}: {MAX_REQUESTS} service messages, or {INTERFACE // MB} MB of them, "
                "wait already: send fewer at a time"
            )
        self._deliver(message, None)

    def fail(self, request: Message, error: RceError, phase: Phase = Phase.NONE) -> None:
        """Answer the request of a peer, or end its goal, with an error; with CANCEL only its request to cancel it."""
        payload = msgspec.msgpack.encode(error.info)
        try:
            answer = Message(self.id, request.msg_id, payload, request.source, True, phase, request.numbered)
            self.request(answer)
        except RceError as undelivered:  # the peer is gone or its queue is full: its call will time out
            log.info(
                "the answer to a request was not delivered ({undelivered}): {error}",
                error=str(error),
                undelivered=str(undelivered),
            )


def error_of(message: Message) -> RceError:
    """Return the error that a message with `error` set carries."""
    try:
        return RceError.from_info(msgspec.msgpack.decode(message.payload, type=ErrorInfo))
    except MALFORMED:
        return RceError("the service failed, and its error message is malformed")
