"""Invariants of the Master's state."""

from __future__ import annotations

import ipaddress

from master.graph.connections import OPPOSITE, split_kind
from master.graph.records import user_of
from master.graph.state import State, at
from rce.protocol.names import parse_type


def check(state: State) -> None:
    for holds in (
        names_and_owners,
        connections_are_pairs,
        who_waits_lacks_an_end,
        a_connection_is_up_if_both_sides_are_there,
        links_are_used_and_shared,
        machines_are_not_overfull,
        groups_have_distinct_addresses,
        who_has_joined_is_known,
    ):
        holds(state)


def names_and_owners(state: State) -> None:
    assert not {robot.name for robot in state.robots} & {environment.name for environment in state.environments}
    for inside in (*state.nodes, *state.parameters):
        assert inside.owner in state.environments
    for record in state.interfaces:
        home = state.environments if split_kind(record.kind)[1] == "Interface" else state.robots
        assert record.owner in home
    assert len({record.id for record in state.interfaces}) == len(state.interfaces)


def connections_are_pairs(state: State) -> None:
    providers = set()
    for connection in state.connections:
        sender, receiver = state.interfaces[connection.sender], state.interfaces[connection.receiver]
        assert user_of(sender.owner) == user_of(receiver.owner)
        assert parse_type(sender.type) == parse_type(receiver.type)
        (sends, _), (receives, _) = split_kind(sender.kind), split_kind(receiver.kind)
        assert sends in ("Subscriber", "ServiceProvider")
        assert OPPOSITE[receives] == sends
        if sends == "ServiceProvider":
            assert connection.sender not in providers
            providers.add(connection.sender)


def who_waits_lacks_an_end(state: State) -> None:
    for waiting in state.waiting:
        assert waiting.key not in state.connections
        assert waiting.sender not in state.interfaces or waiting.receiver not in state.interfaces
        assert not waiting.by or waiting.by in state.robots


def a_connection_is_up_if_both_sides_are_there(state: State) -> None:
    """A connection stays up while a side is away from the Master, because data flows on."""
    for connection in state.connections:
        owners = [state.interfaces[side].owner for side in (connection.sender, connection.receiver)]
        if all(state.host(owner) for owner in owners):
            assert connection.link
        if connection.link:
            link = state.links[connection.link]
            hosts = [state.robots[owner].endpoint if owner in state.robots else owner for owner in owners]
            assert {link.listener, link.dialler} == set(hosts)
            ends = (link.listener, link.dialler)
            assert link.incarnations == tuple(state.processes[end].incarnation for end in ends)
            assert link.alone_for in ("", connection.key)


def links_are_used_and_shared(state: State) -> None:
    seen = set()
    for link in state.links:
        assert state.connections.by(link.name)
        assert (link.key_hex == "") == (link.listener == link.dialler)
        purpose = (frozenset((link.listener, link.dialler)), link.alone_for)
        assert purpose not in seen
        seen.add(purpose)


def machines_are_not_overfull(state: State) -> None:
    for machine in state.processes.by("container"):
        assert sum(each.options.size for each in state.environments.by(at(machine.name))) <= machine.capacity


def groups_have_distinct_addresses(state: State) -> None:
    given = [
        (user_of(each.name), each.options.group, ipaddress.ip_address(each.address))
        for each in state.environments
        if each.options.group
    ]
    assert len(given) == len(set(given))


def who_has_joined_is_known(state: State) -> None:
    assert state.joined <= {process.name for process in state.processes}
    for process in state.processes.by("environment"):
        assert process.name in state.environments
