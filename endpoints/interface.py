"""One end of connections, whatever is behind it: a robot or ROS."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod

import msgspec
from twisted.logger import Logger

from endpoints.frames import Message
from endpoints.hops import Watch
from endpoints.link import Link
from endpoints.traffic import InterfaceCounts
from rce.calls.endpoints import InterfaceSpec
from rce.errors import ErrorInfo, LimitExceeded, NotConnected, RceError

MAX_REQUESTS = 1000  # service messages of one interface that may wait for a link

log = Logger()


class Interface(ABC):
    """One end of connections; subclasses say what to do with what arrives, and when peers come and go."""

    def __init__(self, spec: InterfaceSpec, watch: Watch) -> None:
        self.spec = spec
        self.id = bytes.fromhex(spec.id)
        self.watch = watch
        self.peers: dict[bytes, Link] = {}
        self.dropped = 0
        self.traffic = InterfaceCounts()

    @abstractmethod
    def receive(self, message: Message, link: Link) -> None:
        """Take a message of a peer; must not raise for bad content, nor wait (`link.pause` asks the sender to)."""

    @property
    def connected(self) -> bool:
        return bool(self.peers)

    def joined(self, peer: bytes) -> None:
        """A further peer is there."""

    def started(self) -> None:
        """The first peer is there."""

    def stopped(self) -> None:
        """The last peer is gone."""

    def close(self) -> None:
        """The interface is removed; it has no peers any more."""

    @property
    def keep(self) -> int | None:
        """How many messages to one peer may wait: the newest `depth` of a topic, or all."""
        return None if self.spec.qos.history == "keep_all" else self.spec.qos.depth

    def send(self, message: Message) -> None:
        """To every peer, or to `message.destination`. NotConnected when there is none."""
        self._deliver(message, self.keep)

    def _deliver(self, message: Message, keep: int | None) -> None:
        if message.destination is not None:
            link = self.peers.get(message.destination)
            if link is None:
                raise NotConnected(f"interface {self.spec.tag}: the peer that this is for is gone")
            self._put(message, link, keep)
            self.traffic.sent.passed(len(message.payload))
            return
        if not self.peers:
            raise NotConnected(f"interface {self.spec.tag} has no connection: wait for its status, or connect it")
        for link in set(self.peers.values()):
            self._put(message, link, keep)
        self.traffic.sent.passed(len(message.payload))

    def _put(self, message: Message, link: Link, keep: int | None) -> None:
        dropped = link.send(message, keep)
        if dropped:
            self.dropped += dropped
            for peer, towards in self.peers.items():
                if towards is link:
                    self.traffic.of(peer).drops += dropped

    def room(self) -> asyncio.Future[None] | None:
        """With keep_all: None while more may be sent, else what is done when it may."""
        if self.keep is None:
            for link in self.peers.values():
                waiting = link.room(self.id)
                if waiting is not None:
                    return waiting
        return None

    def request(self, message: Message) -> None:
        """Send one message of a service: none is dropped, LimitExceeded when too many wait."""
        if any(link.backlog(self.id) >= MAX_REQUESTS for link in self.peers.values()):
            raise LimitExceeded(f"{self.spec.owner}/{self.spec.tag}: {MAX_REQUESTS} requests wait already")
        self._deliver(message, None)

    def fail(self, request: Message, error: RceError) -> None:
        """Answer a request of a peer with an error."""
        payload = msgspec.msgpack.encode(error.info)
        try:
            self.request(Message(self.id, request.msg_id, payload, destination=request.source, error=True))
        except RceError as unsaid:  # the peer is gone, or takes no more: it will find its call timed out
            log.info("{error}; not told to the caller: {unsaid}", error=str(error), unsaid=str(unsaid))


def error_of(message: Message) -> RceError:
    """The error that a message with `error` carries."""
    try:
        return RceError.from_info(msgspec.msgpack.decode(message.payload, type=ErrorInfo))
    except msgspec.DecodeError:
        return RceError("the service failed, and how cannot be read")
