"""Connections: which interfaces they may join, and connections that wait for an end that is away.

A robot's own connections end with it. One that somebody else asked for waits until the end that left is declared
again by its name. The robot that asked for it is told when it waits, when it is back, and when it is gone.
"""

from __future__ import annotations

from msgspec.structs import replace

from master.graph.effects import Plan, Send
from master.graph.hard_limits import WAITING, check_keep_all
from master.graph.limits import Policy, check_connections
from master.graph.records import Connection, Interface, Waiting, ref, user_of
from master.graph.state import State, all_of
from master.graph.wiring import Ids, activate
from rce.control.calls.robots import SendStatus
from rce.errors import InvalidRequest, NotConnectable, RceError
from rce.protocol.messages import ConnectionEvent, ConnectionState
from rce.protocol.names import parse_type
from rce.spelling import with_article

OPPOSITE = {"Publisher": "Subscriber", "ServiceClient": "ServiceProvider", "ActionClient": "ActionProvider"}
ASKERS = ("ServiceProvider", "ActionProvider")  # the side that requests or goals come from
SENDERS = {"Subscriber", *ASKERS}


def split_kind(kind: str) -> tuple[str, str]:
    """Split an interface type, as `PublisherConverter` into `Publisher` and `Converter`.

    Raises:
        InvalidRequest: There is no such interface type.
    """
    for suffix in ("Interface", "Converter", "Forwarder"):
        if kind.endswith(suffix):
            return kind.removesuffix(suffix), suffix
    raise InvalidRequest(f"interfaceType {kind[:80]!r} does not exist", field="interfaceType")


def joining(one: Interface, other: Interface) -> Connection:
    """Return the connection that joins two interfaces, given in either order.

    Raises:
        NotConnectable: Their kinds are not opposite, or their types differ.
    """
    (prefix, _), (opposite, _) = split_kind(one.kind), split_kind(other.kind)
    if OPPOSITE.get(prefix) != opposite and OPPOSITE.get(opposite) != prefix:
        raise NotConnectable(
            f"{_tag(one.key)} is {with_article(one.kind)} and {_tag(other.key)} {with_article(other.kind)}: "
            "a Publisher goes with a Subscriber, a ServiceClient with a ServiceProvider, an ActionClient with an "
            "ActionProvider"
        )
    if parse_type(one.type) != parse_type(other.type):
        raise NotConnectable(f"{_tag(one.key)} has type {one.type} and {_tag(other.key)} {other.type}")
    sender, receiver = (one, other) if prefix in SENDERS else (other, one)
    return Connection(sender.key, receiver.key)


def check_new(state: State, connection: Connection, policy: Policy) -> None:
    """Check that a connection may be added.

    Raises:
        NotConnectable: It is a further one of a service or action provider.
        LimitExceeded: The user has all connections that `policy` allows, or all that must not drop.
    """
    sender, receiver = state.interfaces[connection.sender], state.interfaces[connection.receiver]
    if sender.kind.startswith(ASKERS) and state.connections.by(sender.key):
        raise NotConnectable(f"{_tag(sender.key)} is {with_article(sender.kind)}: it takes one connection only")
    check_keep_all(state, connection)
    if not any(state.visits(interface.owner) for interface in (sender, receiver)):
        check_connections(state, connection.user, policy)


# --- connections that wait --------------------------------------------------------------------------------------------


def end_left(state: State, connection: Connection, away: bool) -> Plan:
    """Let a connection wait whose end is `away`; if that was removed on purpose, the connection is gone."""
    if not away:
        return _tell(state, connection, "gone", "one of its interfaces was removed")
    of_user = state.waiting.by(all_of(user_of(connection.sender)))
    plan: Plan = []
    if len(of_user) >= WAITING:
        plan += _gone(state, of_user[0], f"{WAITING} newer connections wait for an end that is away")
    state.waiting.put(Waiting(connection.sender, connection.receiver, connection.by))
    return plan + _tell(state, connection, "waiting", "one of its interfaces is away; it is back when that is added")


def drop_waiting(state: State, term: str) -> Plan:
    """Remove the connections that wait and have this end, robot or user as their index term."""
    reason = "one of its interfaces was removed"
    return [sequence for each in state.waiting.by(term) for sequence in _gone(state, each, reason)]


def restore(state: State, interface: Interface, policy: Policy, ids: Ids) -> Plan:
    """Bring back the connections that waited for a new interface; one that is not possible any more is gone."""
    plan: Plan = []
    for waiting in state.waiting.by(interface.key):
        sender, receiver = state.interfaces.get(waiting.sender), state.interfaces.get(waiting.receiver)
        if sender is None or receiver is None:
            continue
        try:
            connection = joining(sender, receiver)
            check_new(state, connection, policy)
        except RceError as error:
            plan += _gone(state, waiting, str(error))
            continue
        state.waiting.drop(waiting.key)
        connection = replace(connection, by=waiting.by, restored=True)
        state.connections.put(connection)
        plan += activate(state, connection, ids) + _tell(state, connection, "restored")
    return plan


def _gone(state: State, waiting: Waiting, reason: str) -> Plan:
    state.waiting.drop(waiting.key)
    return _tell(state, waiting, "gone", reason)


def _tell(state: State, connection: Connection | Waiting, event: ConnectionState, reason: str = "") -> Plan:
    """Tell the robot that asked for a connection what became of it."""
    robot = state.robots.get(connection.by)
    if robot is None or robot.endpoint not in state.joined:
        return []
    status = ConnectionEvent(_tag(connection.sender), _tag(connection.receiver), event, reason)
    return [[Send(robot.endpoint, SendStatus([robot.name], status), ref(robot))]]


def _tag(key: str) -> str:
    return key.partition("/")[2]
