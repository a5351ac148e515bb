"""The interfaces of one endpoint and the routes between them and interfaces elsewhere."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable

import msgspec
from twisted.logger import Logger

from endpoints.frames import Message
from endpoints.link import DataPort, Link, LoopLink, StreamLink
from rce.calls import InterfaceSpec, LinkSpec, Route
from rce.errors import ErrorInfo, LimitExceeded, NotConnected, NotFound, RceError, Unavailable

MAX_REQUESTS = 1000  # service messages of one interface that may wait for a link

log = Logger()


class Interface(ABC):
    """One end of connections; subclasses say what to do with what arrives, and when peers come and go."""

    def __init__(self, spec: InterfaceSpec, switchboard: Switchboard) -> None:
        self.spec = spec
        self.id = bytes.fromhex(spec.id)
        self.switchboard = switchboard
        self.peers: dict[bytes, Link] = {}
        self.dropped = 0

    @abstractmethod
    def receive(self, message: Message, link: Link) -> None:
        """Take a message of a peer; must not raise for bad content, nor wait (`link.pause` asks the sender to)."""

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
            self.dropped += link.send(message, keep)
            return
        if not self.peers:
            raise NotConnected(f"interface {self.spec.tag} has no connection: wait for its status, or connect it")
        for link in set(self.peers.values()):
            self.dropped += link.send(message, keep)

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
        if request.source in self.peers:
            self.request(Message(self.id, request.msg_id, payload, destination=request.source, error=True))


def error_of(message: Message) -> RceError:
    """The error that a message with `error` carries."""
    return RceError.from_info(msgspec.msgpack.decode(message.payload, type=ErrorInfo))


class Switchboard:
    """Delivers between the interfaces here and the links; every change may be asked for twice."""

    def __init__(self, port: DataPort, link_lost: Callable[[str, str], None]) -> None:
        self.interfaces: dict[bytes, Interface] = {}
        self.links: dict[str, Link] = {}
        self._listeners: dict[bytes, dict[Interface, str]] = {}  # remote source -> who here listens, over which link
        self._port = port
        self._link_lost = link_lost
        self._dialling: set[asyncio.Task[None]] = set()

    # interfaces

    def bind(self, spec: InterfaceSpec, make: Callable[[InterfaceSpec], Interface]) -> Interface:
        """The interface of this spec; one that is there with another spec is replaced."""
        key = bytes.fromhex(spec.id)
        present = self.interfaces.get(key)
        if present is not None:
            if present.spec == spec:
                return present
            self.unbind(spec.id)
        interface = self.interfaces[key] = make(spec)
        return interface

    def unbind(self, id: str) -> None:
        interface = self.interfaces.get(bytes.fromhex(id))
        if interface is None:
            return
        for peer in list(interface.peers):
            self._part(interface, peer)
        del self.interfaces[interface.id]
        interface.close()

    # routes

    async def add_route(self, route: Route) -> None:
        """Route once the link is open, so that a started interface can be used at once. Unavailable, NotFound."""
        link = self.links.get(route.link)
        if link is None:
            raise NotFound(f"link {route.link} is not known here")
        await asyncio.shield(link.opened)
        interface = self.interfaces.get(bytes.fromhex(route.interface))
        if interface is None:
            raise NotFound(f"interface {route.interface} is not bound here")
        peer = bytes.fromhex(route.peer)
        if peer in interface.peers:
            return
        first = not interface.peers
        interface.peers[peer] = link
        self._listeners.setdefault(peer, {})[interface] = route.link
        if first:
            interface.started()
        interface.joined(peer)

    def remove_route(self, interface: str, peer: str) -> None:
        found = self.interfaces.get(bytes.fromhex(interface))
        if found is not None:
            self._part(found, bytes.fromhex(peer))

    def _part(self, interface: Interface, peer: bytes) -> None:
        link = interface.peers.pop(peer, None)
        if link is None:
            return
        listeners = self._listeners.get(peer, {})
        listeners.pop(interface, None)
        if not listeners:
            self._listeners.pop(peer, None)
        if link not in interface.peers.values():
            link.forget(interface.id)
        if not interface.peers:
            interface.stopped()

    def deliver(self, message: Message, link: Link) -> None:
        """What came in over a link goes to the interfaces that are routed to its source over that link."""
        for interface, name in list(self._listeners.get(message.source, {}).items()):
            if name == link.name and (message.destination is None or message.destination == interface.id):
                interface.receive(message, link)

    # links

    def open_link(self, spec: LinkSpec) -> None:
        """Open or expect a link; an older one of the same name goes, and its routes pass to the new one."""
        old = self.links.get(spec.name)
        if isinstance(old, LoopLink):
            return
        if not spec.key:
            self.links[spec.name] = LoopLink(spec.name, self.deliver)
            return
        link = StreamLink(spec.name, self.deliver, self._lost)
        link.opened.add_done_callback(lambda opened: opened.exception())  # said by `dial` or by `_lost`
        self.links[spec.name] = link
        if old is not None:
            old.close()
            self._move_routes(old, link)
        key = bytes.fromhex(spec.key)
        if spec.dial:
            task = asyncio.create_task(self._dial(link, key, spec.dial))
            self._dialling.add(task)
            task.add_done_callback(self._dialling.discard)
        else:
            self._port.expect(link, key)

    def close_link(self, name: str) -> None:
        link = self.links.pop(name, None)
        if link is not None:
            link.close()

    def _move_routes(self, old: Link, new: Link) -> None:
        for interface in self.interfaces.values():
            for peer, link in interface.peers.items():
                if link is old:
                    interface.peers[peer] = new

    async def _dial(self, link: StreamLink, key: bytes, addresses: list[str]) -> None:
        try:
            await self._port.dial(link, key, addresses)
        except Unavailable as error:
            self._lost(link, str(error))

    def _lost(self, link: StreamLink, reason: str) -> None:
        if self.links.get(link.name) is link:  # else it was closed on purpose, or replaced
            log.info("link {link} lost: {reason}", link=link.name, reason=reason)
            self._link_lost(link.name, reason)
