"""The interfaces of one endpoint and the routes between them and interfaces elsewhere."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable
from weakref import WeakValueDictionary

from twisted.logger import Logger

from endpoints.data_port import DataPort
from endpoints.frames import Message
from endpoints.hops import Watch
from endpoints.interface import Interface
from endpoints.link import Link, LoopLink, StreamLink
from endpoints.throttle import Throttle
from endpoints.traffic import Totals
from rce.calls.endpoints import (
    AddRoute,
    Bind,
    CloseLink,
    InterfaceSpec,
    LinkSpec,
    OpenLink,
    RemoveRoute,
    Route,
    Sync,
    Unbind,
)
from rce.calls.watching import CountTraffic, FollowMessages, Traffic
from rce.control import Handlers
from rce.errors import ErrorInfo, NotFound, RceError, Unavailable
from rce.metrics import Family, gauge

log = Logger()


Make = Callable[[InterfaceSpec], Awaitable[Interface]]


class Switchboard:
    """Delivers between the interfaces here and the links; every change may be asked for twice."""

    def __init__(self, port: DataPort, link_lost: Callable[[str, str], None]) -> None:
        self.interfaces: dict[bytes, Interface] = {}
        self.links: dict[str, Link] = {}
        self.watch = Watch()
        self._totals = Totals()
        self._listeners: dict[bytes, dict[Interface, str]] = {}  # remote source -> who here listens, over which link
        self._port = port
        self._link_lost = link_lost
        self._dialling: set[asyncio.Task[None]] = set()
        self._throttles: WeakValueDictionary[str, Throttle] = WeakValueDictionary()

    def add_to(self, handlers: Handlers, make: Make) -> None:
        """What the Master asks of every endpoint about interfaces, links and routes."""
        handlers.do(Bind, lambda call: self.bind(call.interface, make))
        handlers.do(Unbind, lambda call: self.unbind(call.interface))
        handlers.do(OpenLink, lambda call: self.open_link(call.link))
        handlers.do(CloseLink, lambda call: self.close_link(call.link))
        handlers.do(AddRoute, lambda call: self.add_route(call.route))
        handlers.do(RemoveRoute, lambda call: self.remove_route(call.interface, call.peer))
        handlers.on(CountTraffic, self.traffic)
        handlers.on(FollowMessages, self.watch.follow)

    # interfaces

    async def bind(self, spec: InterfaceSpec, make: Make) -> None:
        """Have the interface of this spec; one that is there with another spec is replaced."""
        key = bytes.fromhex(spec.id)
        present = self.interfaces.get(key)
        if present is not None and present.spec == spec:
            return
        interface = await make(spec)
        self.unbind(spec.id)
        self.interfaces[key] = interface

    def unbind(self, id: str) -> None:
        interface = self.interfaces.get(bytes.fromhex(id))
        if interface is None:
            return
        for peer in list(interface.peers):
            self._part(interface, peer)
        del self.interfaces[interface.id]
        self._totals.gone(interface.traffic.traffic(interface.dropped))
        interface.close()

    # routes

    async def add_route(self, route: Route) -> None:
        """Route once the link is open, so that a started interface can be used at once. Unavailable, NotFound."""
        link = self.links.get(route.link)
        if link is None:
            raise NotFound(f"link {route.link} is not known here")
        await asyncio.shield(link.opened)
        if self.links.get(route.link) is not link:
            raise Unavailable(f"link {route.link} was closed meanwhile")
        interface = self.interfaces.get(bytes.fromhex(route.interface))
        if interface is None:
            raise NotFound(f"interface {route.interface} is not bound here")
        peer = bytes.fromhex(route.peer)
        before = interface.peers.get(peer)
        if before is link:
            return
        first = not interface.peers
        interface.peers[peer] = link
        interface.traffic.of(peer)
        self._listeners.setdefault(peer, {})[interface] = route.link
        if first:
            interface.started()
        if before is None:
            interface.joined(peer)
        elif before not in interface.peers.values():
            before.forget(interface.id)

    def remove_route(self, interface: str, peer: str) -> None:
        found = self.interfaces.get(bytes.fromhex(interface))
        if found is not None:
            self._part(found, bytes.fromhex(peer))

    def _part(self, interface: Interface, peer: bytes) -> None:
        link = interface.peers.pop(peer, None)
        if link is None:
            return
        interface.traffic.part(peer)
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
                try:
                    self._hand_over(message, link, interface)
                except Exception:  # noqa: BLE001  # a defect in one interface must not cost others the link
                    log.failure("defect while delivering to {interface}", interface=interface.spec.tag)

    def _hand_over(self, message: Message, link: Link, interface: Interface) -> None:
        count = interface.traffic.of(message.source)
        count.passed(len(message.payload))
        self.watch.came(interface.id, message)
        before = interface.dropped
        interface.receive(message, link)
        if interface.dropped != before:
            count.drops += interface.dropped - before

    async def traffic(self, _: CountTraffic) -> Traffic:
        """What has passed each interface."""
        counted = {each.spec.id: each.traffic.traffic(each.dropped) for each in self.interfaces.values()}
        return Traffic(counted)

    def families(self) -> list[Family]:
        """What is here, for Prometheus."""
        present = [each.traffic.traffic(each.dropped) for each in self.interfaces.values()]
        queued = sum(link.backlog(each.id) for each in self.interfaces.values() for link in set(each.peers.values()))
        links = Counter("up" if link.opened.done() else "opening" for link in self.links.values())
        return [
            *self._totals.families(present),
            gauge("rce_interfaces", "Interfaces", [], {(): len(present)}),
            gauge("rce_links", "Data links", ["state"], {(state,): links[state] for state in ("up", "opening")}),
            gauge("rce_queued_messages", "Messages that wait for a data link", [], {(): queued}),
        ]

    async def sync(self, call: Sync, make: Make) -> dict[str, ErrorInfo]:
        """Have the interfaces, links and routes of this call and no others; returns what failed, by its name."""
        failed: dict[str, ErrorInfo] = {}
        for id in {interface.spec.id for interface in self.interfaces.values()} - {i.id for i in call.interfaces}:
            self.unbind(id)
        for name in set(self.links) - {link.name for link in call.links}:
            self.close_link(name)
        for link in call.links:
            self.open_link(link)
        for spec in call.interfaces:
            try:
                await self.bind(spec, make)
            except RceError as error:
                failed[spec.id] = error.info
        wanted = {(route.interface, route.peer) for route in call.routes}
        for interface in self.interfaces.values():
            for peer in [peer for peer in interface.peers if (interface.spec.id, peer.hex()) not in wanted]:
                self._part(interface, peer)
        await asyncio.gather(*map(self._restore, call.routes))  # beside each other: a link may take long to open
        return failed

    async def _restore(self, route: Route) -> None:
        try:
            await self.add_route(route)
        except RceError as error:  # the link or the interface failed: that has been said
            log.info("route not restored: {error}", error=str(error))

    # links

    def open_link(self, spec: LinkSpec) -> None:
        """Open or expect a link; one that is there stays, and one that has broken is reported (again)."""
        present = self.links.get(spec.name)
        if isinstance(present, StreamLink) and present.broken:
            self._link_lost(spec.name, present.broken)
        if present is not None:
            return
        if not spec.key:
            self.links[spec.name] = LoopLink(spec.name, self.deliver, self.watch.left)
            return
        link = StreamLink(spec.name, self.deliver, self._lost, self.watch.left, self._throttle(spec))
        self.links[spec.name] = link
        key = bytes.fromhex(spec.key)
        if spec.dial:
            task = asyncio.create_task(self._port.dial(link, key, spec.dial))
            self._dialling.add(task)
            task.add_done_callback(self._dialling.discard)
            link.opened.add_done_callback(lambda _: task.cancel() if link.broken else None)  # it was closed meanwhile
        else:
            self._port.expect(link, key)

    def _throttle(self, spec: LinkSpec) -> Throttle | None:
        """One for all links of a sender, as long as one of them is there."""
        if not spec.rate:
            return None
        throttle = self._throttles.get(spec.sender)
        if throttle is None:
            throttle = self._throttles[spec.sender] = Throttle(spec.rate)
        return throttle

    def close_link(self, name: str) -> None:
        link = self.links.pop(name, None)
        if link is not None:
            link.close()

    def _lost(self, link: StreamLink, reason: str) -> None:
        if self.links.get(link.name) is link:  # else it was replaced
            self._link_lost(link.name, reason)
