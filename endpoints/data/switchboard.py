"""Switchboard: the interfaces of one endpoint, and the routes from them to interfaces elsewhere."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable
from weakref import WeakValueDictionary

from twisted.logger import Logger

from endpoints.data.frames import Message
from endpoints.data.hops import HopRecorder
from endpoints.data.interface import Interface
from endpoints.data.link import Link, LoopLink, StreamLink
from endpoints.data.port import DataPort
from endpoints.data.throttle import Throttle
from endpoints.data.traffic import TrafficTotals
from endpoints.data.turns import Turns
from rce.control.calls.endpoints import (
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
from rce.control.calls.watching import CountTraffic, FollowMessages, Traffic
from rce.control.connection import Handlers
from rce.errors import ErrorInfo, NotFound, RceError, TimedOut, Unavailable
from rce.process.metrics import Family, gauge_family

SYNC_PATIENCE = 5.0  # seconds for which the answer to a Sync waits for interfaces

log = Logger()
MakeInterface = Callable[[InterfaceSpec], Awaitable[Interface]]


class Switchboard:
    """Routes messages between local interfaces and links. Every change is idempotent."""

    def __init__(self, port: DataPort, link_lost: Callable[[str, str], None]) -> None:
        """Create an empty switchboard; `link_lost` is called with the name of a lost link and the reason."""
        self.interfaces: dict[bytes, Interface] = {}
        self.links: dict[str, Link] = {}
        self.hops = HopRecorder()
        self.turns = Turns()
        self._totals = TrafficTotals()
        # For each remote source: the local interfaces that receive its messages, and the link over which they do.
        self._listeners: dict[bytes, dict[Interface, str]] = {}
        self._port = port
        self._link_lost = link_lost
        self._tasks: set[asyncio.Task[None]] = set()  # dialling links, and creating interfaces
        self._binding: dict[str, asyncio.Task[None]] = {}  # by id: interfaces that a Sync creates
        self._restoring: dict[tuple[str, str], asyncio.Task[None]] = {}  # routes that wait for their link, after a Sync
        self._throttles: WeakValueDictionary[str, Throttle] = WeakValueDictionary()

    def add_to(self, handlers: Handlers, make: MakeInterface) -> None:
        """Register the handlers of the Master's calls about interfaces, links and routes."""
        handlers.do(Bind, lambda call: self.bind(call.interface, make))
        handlers.do(Unbind, lambda call: self.unbind(call.interface))
        handlers.do(OpenLink, lambda call: self.open_link(call.link))
        handlers.do(CloseLink, lambda call: self.close_link(call.link))
        handlers.do(AddRoute, lambda call: self.add_route(call.route))
        handlers.do(RemoveRoute, lambda call: self.remove_route(call.interface, call.peer))
        handlers.on(CountTraffic, self.traffic)
        handlers.on(FollowMessages, self.hops.follow)

    # interfaces

    async def bind(self, spec: InterfaceSpec, make: MakeInterface) -> None:
        """Create the interface of `spec`; one with the same id and another spec is replaced."""
        self._stop_binding(spec.id)
        await self._bind(spec, make)

    async def _bind(self, spec: InterfaceSpec, make: MakeInterface) -> None:
        key = bytes.fromhex(spec.id)
        present = self.interfaces.get(key)
        if present is not None and present.spec == spec:
            return
        interface = await make(spec)
        self._remove(key)
        self.interfaces[key] = interface

    def unbind(self, id: str) -> None:
        """Remove an interface with its routes, if it exists."""
        self._stop_binding(id)
        self._remove(bytes.fromhex(id))

    def _remove(self, id: bytes) -> None:
        interface = self.interfaces.get(id)
        if interface is None:
            return
        for peer in list(interface.peers):
            self._remove_peer(interface, peer)
        del self.interfaces[id]
        self._totals.add_removed(interface.counted)
        interface.close()

    def _stop_binding(self, id: str) -> None:
        task = self._binding.pop(id, None)
        if task is not None:
            task.cancel()

    # routes

    async def add_route(self, route: Route) -> None:
        """Add a route when its link is open, so that an interface can be used as soon as it has started.

        A route to the same peer over another link is replaced.

        Raises:
            NotFound: The link or the interface does not exist.
            Unavailable: The link did not open, or was closed meanwhile.
        """
        self._stop_restoring((route.interface, route.peer))
        await self._add_route(route)

    async def _add_route(self, route: Route) -> None:
        link = self.links.get(route.link)
        if link is None:
            raise NotFound(f"link {route.link} does not exist at this endpoint")
        await asyncio.shield(link.opened)
        if self.links.get(route.link) is not link:
            raise Unavailable(f"link {route.link} was closed before the route was added")
        interface = self.interfaces.get(bytes.fromhex(route.interface))
        if interface is None:
            raise NotFound(f"interface {route.name or route.interface} was not added: correct it and add it again")
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
            interface.unlinked(before)

    def remove_route(self, interface: str, peer: str) -> None:
        """Remove a route, if it exists."""
        self._stop_restoring((interface, peer))
        found = self.interfaces.get(bytes.fromhex(interface))
        if found is not None:
            self._remove_peer(found, bytes.fromhex(peer))

    def _remove_peer(self, interface: Interface, peer: bytes) -> None:
        link = interface.peers.pop(peer, None)
        if link is None:
            return
        interface.traffic.remove_peer(peer)
        listeners = self._listeners.get(peer, {})
        listeners.pop(interface, None)
        if not listeners:
            self._listeners.pop(peer, None)
        if link not in interface.peers.values():
            interface.unlinked(link)
        interface.left(peer)
        if not interface.peers:
            interface.stopped()

    def deliver(self, message: Message, link: Link) -> None:
        """Pass a message from a link to the interfaces that have a route to its source over that link.

        Raises:
            LimitExceeded: The link carries too many messages that no interface receives.
        """
        heard = False
        for each in message.by_sender():
            heard = self._deliver_from(each, link) or heard
        if not heard and isinstance(link, StreamLink):
            link.stray()

    def _deliver_from(self, message: Message, link: Link) -> bool:
        """Pass a message to the interfaces that have a route to its source; return False if there are none."""
        heard = False
        for interface, name in list(self._listeners.get(message.source, {}).items()):
            if name != link.name:
                continue
            heard = True
            if message.destination is None or message.destination == interface.id:
                try:
                    count = interface.traffic.of(message.source)
                    count.count(len(message.payload))
                    self.hops.received(interface.id, message)
                    before = interface.dropped
                    interface.receive(message, link)
                    if interface.dropped != before:
                        count.drops += interface.dropped - before
                except Exception:  # noqa: BLE001  # a defect in one interface must not cost others the link
                    log.failure("defect while delivering to interface {interface}", interface=interface.spec.tag)
        return heard

    async def traffic(self, _: CountTraffic) -> Traffic:
        """Return the traffic of each interface."""
        counted = {each.spec.id: each.counted for each in self.interfaces.values()}
        return Traffic(counted)

    def families(self) -> list[Family]:
        """Return the metrics of all interfaces and links."""
        present = [each.counted for each in self.interfaces.values()]
        queues = {(link, each.queue) for each in self.interfaces.values() for link in each.peers.values()}
        queued = sum(link.backlog(queue) for link, queue in queues)
        links = Counter("up" if link.opened.done() else "opening" for link in self.links.values())
        return [
            *self._totals.families(present),
            gauge_family("rce_interfaces", "Interfaces", [], {(): len(present)}),
            gauge_family("rce_links", "Data links", ["state"], {(state,): links[state] for state in ("up", "opening")}),
            gauge_family("rce_queued_messages", "Messages that wait for a data link", [], {(): queued}),
        ]

    async def sync(self, call: Sync, make: MakeInterface) -> dict[str, ErrorInfo]:
        """Reconcile interfaces, links and routes with those of the call; return the errors of interfaces, by id.

        Links open in the background, and so do routes over them, because one user's link may take long. An interface
        that takes longer than SYNC_PATIENCE is reported with an error, and is created in the background too.
        """
        for id in {interface.spec.id for interface in self.interfaces.values()} - {i.id for i in call.interfaces}:
            self.unbind(id)
        for name in set(self.links) - {link.name for link in call.links}:
            self.close_link(name)
        for link in call.links:
            self.open_link(link)
        wanted = {(route.interface, route.peer) for route in call.routes}
        for interface in self.interfaces.values():
            for peer in [peer for peer in interface.peers if (interface.spec.id, peer.hex()) not in wanted]:
                self._remove_peer(interface, peer)
        for id in list(self._binding):
            self._stop_binding(id)
        for key in list(self._restoring):
            self._stop_restoring(key)
        failed: dict[str, ErrorInfo] = {}
        for spec in call.interfaces:
            self._binding[spec.id] = self._keep(asyncio.create_task(self._bind_or_fail(spec, make, failed)))
        binding = dict(self._binding)
        routes = [self._restore(route, binding.get(route.interface)) for route in call.routes]
        at_once = [task for task, route in zip(routes, call.routes, strict=True) if self._is_open(route.link)]
        if binding:
            await asyncio.wait([*binding.values(), *at_once], timeout=SYNC_PATIENCE)
        for spec in call.interfaces:
            if not binding[spec.id].done():
                failed[spec.id] = TimedOut(f"interface {spec.tag} still waits for the definition of {spec.type}").info
        return dict(failed)

    def _is_open(self, link: str) -> bool:
        return link in self.links and self.links[link].opened.done()

    async def _bind_or_fail(self, spec: InterfaceSpec, make: MakeInterface, failed: dict[str, ErrorInfo]) -> None:
        try:
            await self._bind(spec, make)
        except RceError as error:
            log.info("interface {interface} was not restored: {error}", interface=spec.tag, error=str(error))
            failed[spec.id] = error.info
        finally:
            if self._binding.get(spec.id) is asyncio.current_task():
                del self._binding[spec.id]

    def _restore(self, route: Route, binding: asyncio.Task[None] | None) -> asyncio.Task[None]:
        """Add a route as soon as its interface is bound and its link is open, unless it changes before."""

        async def restore() -> None:
            if binding is not None:
                await asyncio.wait([binding])
            try:
                await self._add_route(route)
            except RceError as error:  # the failure of the link or of the interface is reported by itself
                log.info("route not restored: {error}", error=str(error))

        key = (route.interface, route.peer)
        task = self._keep(asyncio.create_task(restore()))
        self._restoring[key] = task
        task.add_done_callback(lambda done: self._restoring.pop(key) if self._restoring.get(key) is done else None)
        return task

    def _stop_restoring(self, key: tuple[str, str]) -> None:
        task = self._restoring.pop(key, None)
        if task is not None:
            task.cancel()

    def _keep(self, task: asyncio.Task[None]) -> asyncio.Task[None]:
        """Hold a task until it ends."""
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    # links

    def open_link(self, spec: LinkSpec) -> None:
        """Open or expect a link unless it exists; one that is broken is reported again."""
        present = self.links.get(spec.name)
        if isinstance(present, StreamLink) and present.broken:
            self._link_lost(spec.name, present.broken)
        if present is not None:
            return
        if not spec.key:
            self.links[spec.name] = LoopLink(spec.name, self.deliver, self.hops.sent)
            return
        user = spec.sender.partition("/")[0]
        link = StreamLink(spec.name, self.deliver, self._lost, self.hops.sent, self._throttle(spec), self.turns, user)
        link.to_environment = "/" in spec.sender  # user/tag
        self.links[spec.name] = link
        key = bytes.fromhex(spec.key)
        if spec.dial:
            task = asyncio.create_task(self._port.dial(link, key, spec.dial))
            self._keep(task)
            link.opened.add_done_callback(lambda _: task.cancel() if link.broken else None)  # closed while dialling
        else:
            self._port.expect(link, key)

    def _throttle(self, spec: LinkSpec) -> Throttle | None:
        """Return the rate limit of the sender, which all its links share; None without a limit."""
        if not spec.rate:
            return None
        throttle = self._throttles.get(spec.sender)
        if throttle is None:
            throttle = self._throttles[spec.sender] = Throttle(spec.rate)
        return throttle

    def close_link(self, name: str) -> None:
        """Close a link, if it exists."""
        link = self.links.pop(name, None)
        if link is not None:
            link.close()

    def _lost(self, link: StreamLink, reason: str) -> None:
        if self.links.get(link.name) is link:  # else it was replaced
            self._link_lost(link.name, reason)
