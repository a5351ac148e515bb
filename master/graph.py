"""The command graph: a command of a user changes the records and leads to effects. Nothing here waits.

What a user may name is what is that user's own: everything is looked up under `user/`, so another user's things do not
exist here. With `again` (a command repeated because its answer was lost) what is there already is no error.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, get_args

from master import ceilings, groups
from master.effects import Outcome, Plan, Send, Settle
from master.packages import resolve_all
from master.placement import place
from master.policies import UNLIMITED, Policy, check_connections, check_totals, granted
from master.records import Connection, Environment, Interface, Node, Parameter, State, what
from master.wiring import Ids, activate, connections_of, deactivate
from rce import messages as m
from rce.calls.endpoints import (
    Bind,
    DropParameter,
    InterfaceSpec,
    NodeSpec,
    ParameterSpec,
    PutParameter,
    StartNode,
    StopNode,
    Unbind,
)
from rce.calls.environments import EnvironmentSpec, StartEnvironment, StopEnvironment
from rce.errors import AlreadyExists, InvalidRequest, NotConnectable, NotFound
from rce.names import check_made, check_tag, parse_type, split_interface
from rce.variables import check_variables

KINDS = get_args(m.InterfaceType)
OPPOSITE = {"Publisher": "Subscriber", "ServiceClient": "ServiceProvider"}
SENDERS = {"Subscriber", "ServiceProvider"}  # the side that topics, or requests, come from

C = TypeVar("C")


def execute(
    state: State,
    user: str,
    command: m.Command,
    ids: Ids,
    again: bool = False,
    policy: Policy = UNLIMITED,
    guest: str = "",
) -> Outcome:
    """Apply one command of `user`. Raises the error that the user shall see; then nothing has changed.

    What goes beyond the user's `policy` is refused with LimitExceeded. `guest` is the robotID by which it comes, if it
    is a guest's: its own names are for it alone.
    """
    match command:
        case m.CreateContainer():
            return create_container(state, user, command, ids, again, policy)
        case m.Connect():
            return connect(state, user, command, ids, again, policy)
        case m.AddNode():
            return add_node(state, user, command, ids, again, guest)
        case m.AddInterface():
            return add_interface(state, user, command, ids, again, guest)
    return _actions[type(command)](state, user, command, ids, again)


# --- environments -----------------------------------------------------------------------------------------------------


def create_container(
    state: State, user: str, command: m.CreateContainer, ids: Ids, again: bool, policy: Policy
) -> Outcome:
    check_tag(command.containerTag, "containerTag")
    name = f"{user}/{command.containerTag}"
    if again and name in state.environments:
        return Outcome([], [what(state.environments[name])])
    if name in state.environments or name in state.robots:
        kind = "environment" if name in state.environments else "robot"
        raise AlreadyExists(f"containerTag {command.containerTag} is in use by a {kind} of yours", field="containerTag")
    check_variables(command.containerData.env)
    options = granted(policy, command.containerData)
    check_totals(state, user, policy, options)
    packages = resolve_all(state, user, options.packages)
    subnet, address = groups.join(state, user, options)
    machine = place(state, user, options)
    environment = Environment(name, options, ids(), machine, subnet, address, packages, policy.egress)
    state.environments.put(environment)
    return Outcome(start(state, environment), [what(environment)])


def start(state: State, environment: Environment) -> Plan:
    """At its machine, unless it waits for one. The token is made when the call leaves: it is for that call alone."""
    group = groups.spec(state, environment)
    spec = EnvironmentSpec(
        environment.name, environment.run, "", environment.options, group, environment.packages, environment.egress
    )
    return [[Send(environment.machine, StartEnvironment(spec), environment.name)]] if environment.machine else []


def destroy_container(state: State, user: str, command: m.DestroyContainer, ids: Ids, again: bool) -> Outcome:
    name = f"{user}/{command.containerTag}"
    if again and name not in state.environments:
        return Outcome([])
    return Outcome(remove_environment(state, _environment(state, user, command.containerTag)))


def remove_environment(state: State, environment: Environment) -> Plan:
    """Take an environment and all that is in it out of the graph, and stop it."""
    name = environment.name
    plan = remove_interfaces(state, name)
    for node in state.nodes.by(name):
        state.nodes.drop(node.key)
    for parameter in state.parameters.by(name):
        state.parameters.drop(parameter.key)
    state.environments.drop(name)
    state.forget(name)  # its process is told nothing more, and is not taken for that of a namesake to come
    if environment.machine in state.joined:  # else it is told when it joins again (KeepEnvironments)
        plan.append([Send(environment.machine, StopEnvironment(name), name)])
    return plan


# --- nodes and parameters ---------------------------------------------------------------------------------------------


def add_node(state: State, user: str, command: m.AddNode, ids: Ids, again: bool, guest: str = "") -> Outcome:
    owner = _environment(state, user, command.containerTag).name
    check_made(command.nodeTag, "nodeTag", guest)
    spec = NodeSpec(command.nodeTag, command.pkg, command.exe, command.args, command.name, command.namespace)
    node = Node(owner, spec)
    present = state.nodes.get(node.key)
    if present is not None:
        if again and present == node:
            return Outcome([], [what(node)])
        raise AlreadyExists(f"nodeTag {command.nodeTag} is in use in {command.containerTag}", field="nodeTag")
    ceilings.check_count(state.nodes, owner, ceilings.NODES, "nodeTag")
    state.nodes.put(node)
    return Outcome(_at_host(state, node, StartNode(spec)), [what(node)])


def remove_node(state: State, user: str, command: m.RemoveNode, ids: Ids, again: bool) -> Outcome:
    owner = _environment(state, user, command.containerTag).name
    node = state.nodes.get(f"{owner}/{command.nodeTag}")
    if node is None:
        if again:
            return Outcome([])
        raise NotFound(f"{command.containerTag} has no node {command.nodeTag}", field="nodeTag")
    return Outcome(drop_node(state, node))


def drop_node(state: State, node: Node) -> Plan:
    """Take a node out of the graph."""
    state.nodes.drop(node.key)
    return _at_host(state, node, StopNode(node.spec.tag))


def set_parameter(state: State, user: str, command: m.SetParameter, ids: Ids, again: bool) -> Outcome:
    owner = _environment(state, user, command.containerTag).name
    if command.nodeTag:
        check_tag(command.nodeTag, "nodeTag")
    parameter = Parameter(owner, ParameterSpec(command.name, command.value, command.nodeTag))
    ceilings.check_parameter(state, parameter)
    before = state.parameters.get(parameter.key)
    state.parameters.put(parameter)
    return Outcome(_at_host(state, parameter, PutParameter(parameter.spec)), [what(parameter)], before)


def delete_parameter(state: State, user: str, command: m.DeleteParameter, ids: Ids, again: bool) -> Outcome:
    owner = _environment(state, user, command.containerTag).name
    key = ParameterSpec(command.name, "", command.nodeTag).key
    parameter = state.parameters.drop(f"{owner}/{key}")
    if parameter is None:
        if again:
            return Outcome([])
        raise NotFound(f"{command.containerTag} has no parameter {command.name[:80]!r}", field="name")
    return Outcome(_at_host(state, parameter, DropParameter(key)))


# --- interfaces -------------------------------------------------------------------------------------------------------


def split_kind(kind: str) -> tuple[str, str]:
    """`PublisherConverter` as `Publisher`, `Converter`."""
    for suffix in ("Interface", "Converter", "Forwarder"):
        if kind.endswith(suffix):
            return kind.removesuffix(suffix), suffix
    raise InvalidRequest(f"interfaceType {kind[:80]!r} does not exist", field="interfaceType")


def add_interface(state: State, user: str, command: m.AddInterface, ids: Ids, again: bool, guest: str = "") -> Outcome:
    kind = m.ALIASES.get(command.interfaceType, command.interfaceType)
    if kind not in KINDS:
        raise InvalidRequest(
            f"interfaceType {kind[:80]!r} does not exist; it is one of {', '.join(KINDS)}", field="interfaceType"
        )
    if split_kind(kind)[1] == "Interface":
        owner = _environment(state, user, command.endpointTag, "endpointTag").name
        check_made(command.interfaceTag, "interfaceTag", guest)
    else:
        owner = f"{user}/{command.endpointTag}"
        if owner not in state.robots:
            raise NotFound(f"there is no robot {command.endpointTag[:80]!r} to take a {kind}", field="endpointTag")
        check_tag(command.interfaceTag, "interfaceTag")
    parse_type(command.className)
    spec = InterfaceSpec(
        ids(), owner, command.interfaceTag, kind, command.className, command.addr, command.qos, command.format
    )
    interface = Interface(spec)
    present = state.interfaces.get(interface.key)
    if present is not None:
        if again and (present.spec.kind, present.spec.type) == (kind, command.className):
            return Outcome([], [what(present)])
        raise AlreadyExists(
            f"interfaceTag {command.interfaceTag} is in use at {command.endpointTag}", field="interfaceTag"
        )
    ceilings.check_count(state.interfaces, owner, ceilings.INTERFACES, "interfaceTag")
    state.interfaces.put(interface)
    host = state.host(owner)
    plan: Plan = [[Send(host, Bind(spec), spec.id), Settle(what(interface))]] if host else []
    return Outcome(plan, [what(interface)])


def remove_interface(state: State, user: str, command: m.RemoveInterface, ids: Ids, again: bool) -> Outcome:
    interface = state.interfaces.get(f"{user}/{command.endpointTag}/{command.interfaceTag}")
    if interface is None:
        if again:
            return Outcome([])
        raise NotFound(
            f"{command.endpointTag[:80]} has no interface {command.interfaceTag[:80]!r}", field="interfaceTag"
        )
    return Outcome(drop_interface(state, interface))


def drop_interface(state: State, interface: Interface) -> Plan:
    """Take an interface and its connections out of the graph."""
    plan: Plan = []
    for connection in state.connections.by(interface.key):
        plan += _part(state, connection)
    state.interfaces.drop(interface.key)
    host = state.host(interface.spec.owner)
    if host:
        plan.append([Send(host, Unbind(interface.spec.id), interface.spec.id)])
    return plan


def remove_interfaces(state: State, owner: str) -> Plan:
    """Take all interfaces of a robot or environment out of the graph."""
    plan: Plan = []
    for connection in connections_of(state, owner):
        plan += _part(state, connection)
    for interface in state.interfaces.by(owner):
        plan += drop_interface(state, interface)
    return plan


# --- connections ------------------------------------------------------------------------------------------------------


def connect(state: State, user: str, command: m.Connect, ids: Ids, again: bool, policy: Policy) -> Outcome:
    one, other = _pair(state, user, command.tagA, command.tagB)
    (prefix, _), (opposite, _) = split_kind(one.spec.kind), split_kind(other.spec.kind)
    if OPPOSITE.get(prefix) != opposite and OPPOSITE.get(opposite) != prefix:
        raise NotConnectable(
            f"{command.tagA} is a {one.spec.kind} and {command.tagB} a {other.spec.kind}: "
            "a Publisher goes with a Subscriber, a ServiceClient with a ServiceProvider"
        )
    if parse_type(one.spec.type) != parse_type(other.spec.type):
        raise NotConnectable(f"{command.tagA} has type {one.spec.type} and {command.tagB} {other.spec.type}")
    sender, receiver = (one, other) if prefix in SENDERS else (other, one)
    connection = Connection(sender.key, receiver.key)
    if connection.key in state.connections:
        if again:
            return Outcome([], [what(connection)])
        raise AlreadyExists(f"{command.tagA} and {command.tagB} are connected already")
    if sender.spec.kind.startswith("ServiceProvider") and state.connections.by(sender.key):
        raise NotConnectable(f"{sender.key.partition('/')[2]} is a {sender.spec.kind}: it takes one connection only")
    if not any(state.visits(interface.spec.owner) for interface in (one, other)):
        check_connections(state, user, policy)
    state.connections.put(connection)
    return Outcome(activate(state, connection, ids), [what(connection)])


def disconnect(state: State, user: str, command: m.Disconnect, ids: Ids, again: bool) -> Outcome:
    one, other = _pair(state, user, command.tagA, command.tagB)
    for sender, receiver in ((one, other), (other, one)):
        connection = state.connections.get(Connection(sender.key, receiver.key).key)
        if connection is not None:
            return Outcome(_part(state, connection))
    if again:
        return Outcome([])
    raise NotFound(f"{command.tagA} and {command.tagB} are not connected")


def _part(state: State, connection: Connection) -> Plan:
    plan = deactivate(state, connection)
    state.connections.drop(connection.key)
    return plan


def _pair(state: State, user: str, tag_a: str, tag_b: str) -> tuple[Interface, Interface]:
    found = []
    for field, tag in (("tagA", tag_a), ("tagB", tag_b)):
        endpoint, name = split_interface(tag, field)
        interface = state.interfaces.get(f"{user}/{endpoint}/{name}")
        if interface is None:
            raise NotFound(f"there is no interface {tag}", field=field)
        found.append(interface)
    if found[0] is found[1]:
        raise NotConnectable(f"{tag_a} cannot be connected with itself")
    return found[0], found[1]


def _environment(state: State, user: str, tag: str, field: str = "containerTag") -> Environment:
    environment = state.environments.get(f"{user}/{tag}")
    if environment is None:
        raise NotFound(f"there is no environment {tag[:80]!r}", field=field)
    return environment


def _at_host(state: State, record: Node | Parameter, call: StartNode | StopNode | PutParameter | DropParameter) -> Plan:
    """A call at the environment if it is there; else its Sync will bring it."""
    host = state.host(record.owner)
    if not host:
        return []
    send = Send(host, call, what(record))
    return [[send] if isinstance(call, StopNode | DropParameter) else [send, Settle(what(record))]]


def undo(state: State, outcome: Outcome) -> Plan:
    """Take back what a command made, because it did not become real."""
    if outcome.replaced is not None and outcome.replaced.key in state.parameters:
        state.parameters.put(outcome.replaced)
        return _at_host(state, outcome.replaced, PutParameter(outcome.replaced.spec))
    return [sequence for awaited in outcome.awaits for sequence in _take_back(state, awaited)]


def _take_back(state: State, awaited: str) -> Plan:
    kind, _, key = awaited.partition(" ")
    plan: Plan = []
    if kind == "Environment" and (environment := state.environments.get(key)):
        plan = remove_environment(state, environment)
    elif kind == "Interface" and (interface := state.interfaces.get(key)):
        plan = drop_interface(state, interface)
    elif kind == "Connection" and (connection := state.connections.get(key)):
        plan = _part(state, connection)
    elif kind == "Node" and (node := state.nodes.get(key)):
        plan = drop_node(state, node)
    elif kind == "Parameter" and (parameter := state.parameters.drop(key)):
        plan = _at_host(state, parameter, DropParameter(parameter.spec.key))
    return plan


_actions: dict[type[m.Command], Callable[[State, str, Any, Ids, bool], Outcome]] = {
    m.DestroyContainer: destroy_container,
    m.AddNode: add_node,
    m.RemoveNode: remove_node,
    m.AddInterface: add_interface,
    m.RemoveInterface: remove_interface,
    m.SetParameter: set_parameter,
    m.DeleteParameter: delete_parameter,
    m.Disconnect: disconnect,
}
