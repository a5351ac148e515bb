"""Connections become routes over data links when both of their sides are there, and stop when one goes.

A connection is *up* while its `link` is set. Between two processes all connections share one link, but one that must
not drop (keep_all) has a link of its own, so that its back-pressure slows nobody else.
"""

from __future__ import annotations

from collections.abc import Callable

from msgspec.structs import replace

from master.effects import Plan, Send, Sequence, Settle
from master.records import Connection, Interface, Link, Process, State, what
from rce.calls.endpoints import AddRoute, CloseLink, LinkSpec, OpenLink, RemoveRoute, Route

RELAY, UNIX = "relay:", "unix:"
Ids = Callable[[], str]
"""Makes 32 random hex digits."""


def activate(state: State, connection: Connection, ids: Ids) -> Plan:
    """Bring a connection up if both of its sides are there."""
    sender, receiver = state.interfaces[connection.sender], state.interfaces[connection.receiver]
    sending, receiving = state.host(sender.spec.owner), state.host(receiver.spec.owner)
    if not sending or not receiving:
        return []
    alone = connection.key if "keep_all" in (sender.spec.qos.history, receiver.spec.qos.history) else ""
    link = _link(state, state.processes[sending], state.processes[receiving], alone, ids)
    state.connections.put(replace(connection, link=link.name))
    # The receiving side first: once the sender starts, nothing it sends may find no route.
    return [
        [
            *opening(state, link),
            Send(receiving, AddRoute(Route(receiver.spec.id, sender.spec.id, link.name)), receiver.spec.id),
            Send(sending, AddRoute(Route(sender.spec.id, receiver.spec.id, link.name)), sender.spec.id),
            Settle(what(connection)),
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
        host = state.host(own.spec.owner)
        if host:
            plan.append([Send(host, RemoveRoute(own.spec.id, other.spec.id), own.spec.id)])
    if not state.connections.by(connection.link):
        plan += close(state, connection.link)
    return plan


def close(state: State, name: str) -> Plan:
    """Close a link at both ends."""
    link = state.links.drop(name)
    if link is None:
        return []
    ends = {link.listener, link.dialler} & state.joined
    return [[Send(end, CloseLink(name), name)] for end in sorted(ends)]


def reopen(state: State, name: str, ids: Ids) -> Plan:
    """A link broke while both ends live: its connections move to a new one."""
    if name not in state.links:
        return []
    plan = close(state, name)
    for connection in state.connections.by(name):
        if all(state.host(state.interfaces[side].spec.owner) for side in (connection.sender, connection.receiver)):
            plan += activate(state, connection, ids)  # the new route takes the place of the old one
        else:
            plan += deactivate(state, connection)
    return plan


def take_down(state: State, process: str) -> Plan:
    """A process is gone or another one now: its links are void, their connections down."""
    plan: Plan = []
    for link in state.links.by(process):
        for connection in state.connections.by(link.name):
            plan += deactivate(state, connection)
        plan += close(state, link.name)
    return plan


def bring_up(state: State, owners: list[str], ids: Ids) -> Plan:
    """Bring up all connections of these robots and environments whose other side is there."""
    plan: Plan = []
    for owner in owners:
        for connection in connections_of(state, owner):
            if not connection.link:
                plan += activate(state, connection, ids)
    return plan


def connections_of(state: State, owner: str) -> list[Connection]:
    """Each once, also where both sides are the owner's."""
    found: dict[str, Connection] = {}
    for interface in state.interfaces.by(owner):
        found.update({connection.key: connection for connection in state.connections.by(interface.key)})
    return list(found.values())


def routes_of(state: State, interface: Interface) -> list[Route]:
    """The routes of an interface that are up."""
    routes = []
    for connection in state.connections.by(interface.key):
        if connection.link:
            peer = connection.receiver if connection.sender == interface.key else connection.sender
            routes.append(Route(interface.spec.id, state.interfaces[peer].spec.id, connection.link))
    return routes


def link_spec(state: State, link: Link, end: str) -> LinkSpec:
    """A link as one of its ends shall open it."""
    if link.listener == link.dialler:
        return LinkSpec(link.name, link.key_hex)
    other = link.dialler if end == link.listener else link.listener
    environment = state.environments.get(other)
    rate = environment.options.bandwidth if environment else 0
    ways: list[str] = []
    listener, dialler = state.processes.get(link.listener), state.processes.get(link.dialler)
    if end == link.dialler and listener and dialler:
        ways = _ways(state, listener, dialler)
    return LinkSpec(link.name, link.key_hex, ways, rate, other if rate else "")


def _ways(state: State, to: Process, of: Process) -> list[str]:
    """The addresses at which one process can dial another, the best first."""
    if to.host and to.host == of.host:
        return to.addresses
    ways = [address for address in to.addresses if not address.startswith(UNIX)]
    environment = state.environments.get(to.name)
    machine = state.processes.get(environment.machine) if environment else None
    if machine is not None:
        ways += [f"{address}/{to.name}" for address in machine.addresses if address.startswith(RELAY)]
    return ways


def opening(state: State, link: Link) -> Sequence:
    """Tell both ends to open a link; an end that has it open already leaves it as it is."""
    ends = [link.listener] if link.listener == link.dialler else [link.listener, link.dialler]
    return [Send(end, OpenLink(link_spec(state, link, end)), link.name) for end in ends]


def _link(state: State, one: Process, other: Process, alone_for: str, ids: Ids) -> Link:
    for link in state.links.by(one.name):
        if {link.listener, link.dialler} == {one.name, other.name} and link.alone_for == alone_for:
            return link
    # An environment may be walled in: it is dialled, at its socket or through its machine's relay, where that can be.
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
