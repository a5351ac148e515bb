"""Wiring: a connection becomes routes over a data link while both of its sides are present.

A connection is *up* while its `link` is set. All connections between two processes share one link, except one that must
not drop (keep_all): it has a link of its own, so that its back-pressure slows nothing else.
"""

from __future__ import annotations

from collections.abc import Callable

from msgspec.structs import replace

from master.graph.effects import MarkReady, Plan, Send, Sequence
from master.graph.hard_limits import keeps_all
from master.graph.records import Connection, Environment, Interface, Link, Process, Ref, ref, user_of
from master.graph.state import State, pair
from rce.control.calls.endpoints import AddRoute, CloseLink, LinkSpec, OpenLink, RemoveRoute, Route

RELAY, UNIX = "relay:", "unix:"
Ids = Callable[[], str]
"""Returns 32 random hex digits."""


def activate(state: State, connection: Connection, ids: Ids) -> Plan:
    """Bring a connection up if both of its sides are present."""
    sender, receiver = state.interfaces[connection.sender], state.interfaces[connection.receiver]
    sending, receiving = state.host(sender.owner), state.host(receiver.owner)
    if not sending or not receiving:
        return []
    alone = connection.key if keeps_all(state, connection) else ""
    link = _link(state, state.processes[sending], state.processes[receiving], alone, ids)
    state.connections.put(replace(connection, link=link.name))
    # The receiving side is routed first, so that nothing that the sender sends finds no route.
    return [
        [
            *opening(state, link),
            Send(receiving, AddRoute(_route(receiver, sender, link)), interface_ref(receiver)),
            Send(sending, AddRoute(_route(sender, receiver, link)), interface_ref(sender)),
            MarkReady(ref(connection)),
        ]
    ]


def deactivate(state: State, connection: Connection) -> Plan:
    """Take a connection down; it stays wanted."""
    if not connection.link:
        return []
    state.connections.put(replace(connection, link=""))
    plan: Plan = []
    sides = (state.interfaces[connection.sender], state.interfaces[connection.receiver])
    for own, other in (sides, sides[::-1]):
        host = state.host(own.owner)
        if host:
            plan.append([Send(host, RemoveRoute(own.id, other.id), interface_ref(own))])
    if not state.connections.count(connection.link):
        plan += close(state, connection.link)
    return plan


def close(state: State, name: str) -> Plan:
    """Close a link at both ends."""
    link = state.links.drop(name)
    if link is None:
        return []
    ends = {link.listener, link.dialler} & state.joined
    return [[Send(end, CloseLink(name), ref(link))] for end in sorted(ends)]


def reopen(state: State, name: str, ids: Ids) -> Plan:
    """Move the connections of a link that broke, while both of its ends live, to a new link."""
    if name not in state.links:
        return []
    plan = close(state, name)
    for connection in state.connections.by(name):
        if all(state.host(state.interfaces[side].owner) for side in (connection.sender, connection.receiver)):
            plan += activate(state, connection, ids)  # the new route replaces the old one
        else:
            plan += deactivate(state, connection)
    return plan


def take_down(state: State, process: str) -> Plan:
    """Take down all links and connections of a process that is gone or was restarted."""
    plan: Plan = []
    for link in state.links.by(process):
        for connection in state.connections.by(link.name):
            plan += deactivate(state, connection)
        plan += close(state, link.name)
    return plan


def bring_up(state: State, owners: list[str], ids: Ids) -> Plan:
    """Bring up all connections of these robots and environments whose other side is present."""
    plan: Plan = []
    for owner in owners:
        for connection in connections_of(state, owner):
            if not connection.link:
                plan += activate(state, connection, ids)
    return plan


def connections_of(state: State, owner: str) -> list[Connection]:
    """Return the connections of an owner, each once even if both sides are the owner's."""
    found: dict[str, Connection] = {}
    for interface in state.interfaces.by(owner):
        found.update({connection.key: connection for connection in state.connections.by(interface.key)})
    return list(found.values())


def routes_of(state: State, interface: Interface) -> list[Route]:
    """Return the routes of an interface that are up."""
    routes = []
    for connection in state.connections.by(interface.key):
        if connection.link:
            peer = connection.receiver if connection.sender == interface.key else connection.sender
            routes.append(Route(interface.id, state.interfaces[peer].id, connection.link))
    return routes


def link_spec(state: State, link: Link, end: str) -> LinkSpec:
    """Return a link as the process `end` opens it."""
    if link.listener == link.dialler:
        return LinkSpec(link.name, link.key_hex)
    other = link.dialler if end == link.listener else link.listener
    environment = state.environments.get(other)
    rate = environment.options.bandwidth if environment else 0
    ways: list[str] = []
    listener, dialler = state.processes.get(link.listener), state.processes.get(link.dialler)
    if end == link.dialler and listener and dialler:
        ways = _ways(state, listener, dialler)
    return LinkSpec(link.name, link.key_hex, ways, rate, other)


def _ways(state: State, to: Process, of: Process) -> list[str]:
    """Return the addresses at which process `of` can dial process `to`, best first."""
    here = bool(to.host) and to.host == of.host
    environment = state.environments.get(to.name)
    if environment is None:
        return [address for address in to.addresses if here or not address.startswith(UNIX)]
    machine = state.processes.get(environment.machine)
    if machine is None:
        return []
    if here and machine.sockets:
        return [UNIX + _socket(machine.sockets, environment)]
    return [f"{RELAY}{machine.relays[to.host]}/{to.name}"] if to.host in machine.relays else []


def _socket(template: str, environment: Environment) -> str:
    """Return the path of an environment's socket for data links."""
    parts = {"{name}": environment.name, "{user}": user_of(environment.name), "{run}": environment.run}
    for part, value in parts.items():
        template = template.replace(part, value)
    return template


def opening(state: State, link: Link) -> Sequence:
    """Return the steps that open a link at both ends, unless it is open; an end that has it open ignores the call."""
    ends = [link.listener] if link.listener == link.dialler else [link.listener, link.dialler]
    opened = ref(link)
    return [
        *(Send(end, OpenLink(link_spec(state, link, end)), opened, unless=opened) for end in ends),
        MarkReady(opened),
    ]


def _link(state: State, one: Process, other: Process, alone_for: str, ids: Ids) -> Link:
    for link in state.links.by(pair(one.name, other.name)):
        if link.alone_for == alone_for:
            return link
    # An environment may have no network: prefer to dial it, at its socket or through the relay of its machine.
    listener, dialler = sorted((one, other), key=lambda process: (process.role != "environment", process.name))
    if not _ways(state, listener, dialler):
        listener, dialler = dialler, listener
    within = listener.name == dialler.name
    link = Link(
        name=f"{listener.name}~{dialler.name}~{ids()[:8]}",
        listener=listener.name,
        dialler=dialler.name,
        incarnations=(listener.incarnation, dialler.incarnation),
        key_hex="" if within else ids(),
        alone_for=alone_for,
    )
    state.links.put(link)
    return link


def _route(interface: Interface, peer: Interface, link: Link) -> Route:
    return Route(interface.id, peer.id, link.name, interface.key.partition("/")[2])


def interface_ref(interface: Interface) -> Ref:
    """Return the reference that orders calls about an interface: by its id, since names are used again."""
    return Ref("interface", interface.id)
