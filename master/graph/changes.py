"""Changes of the graph that commands and reconciliation share: removals, and the start of environments."""

from __future__ import annotations

from master.graph import connections, groups
from master.graph.catalogue_records import Use
from master.graph.effects import MarkReady, Outcome, Plan, Send
from master.graph.records import Connection, Environment, Interface, Node, Parameter, Recorder, Ref, ref
from master.graph.state import State
from master.graph.translation import container_data, parameter_spec
from master.graph.wiring import deactivate, interface_ref
from rce.control.calls.endpoints import (
    DropParameter,
    PutParameter,
    StartNode,
    StartRecorder,
    StopNode,
    StopRecorder,
    Unbind,
)
from rce.control.calls.environments import EnvironmentSpec, StartEnvironment, StopEnvironment


def start(state: State, environment: Environment) -> Plan:
    """Return the plan that starts an environment at its machine; an empty plan while it waits for a machine.

    The join token is issued when the call leaves: it is valid for that call alone.
    """
    if not environment.machine:
        return []
    group = groups.spec(state, environment)
    options = container_data(environment.options)
    spec = EnvironmentSpec(
        environment.name, environment.run, "", options, group, environment.packages, environment.egress
    )
    return [[Send(environment.machine, StartEnvironment(spec), ref(environment))]]


def remove_environment(state: State, environment: Environment, away: bool = False) -> Plan:
    """Remove an environment and all that is in it from the graph, and stop it.

    `away`: it was not removed on purpose. Connections of others wait until its interfaces are added again.
    """
    name = environment.name
    plan = [sequence for use in state.uses.by(name) for sequence in end_use(state, use, lost=True)]
    state.instances.drop(name)
    plan += remove_interfaces(state, name, away)
    for node in state.nodes.by(name):
        state.nodes.drop(node.key)
    for end in state.ends.by(name):
        state.ends.drop(end.key)
    for parameter in state.parameters.by(name):
        state.parameters.drop(parameter.key)
    for recorder in state.recorders.by(name):
        state.recorders.drop(recorder.key)
    state.environments.drop(name)
    state.forget(name)  # no further calls go to its process, and a later environment of this name gets a process anew
    if environment.machine in state.joined:  # else KeepEnvironments tells it when it joins again
        plan.append([Send(environment.machine, StopEnvironment(name), ref(environment))])
    return plan


def end_use(state: State, use: Use, lost: bool = False) -> Plan:
    """End the part of a robot in an instance: remove its interfaces and nodes there, and its own interfaces.

    The robot is told that its connections are gone if the instance is `lost`.
    """
    plan: Plan = []
    for key in use.interfaces if lost else reversed(use.interfaces):
        if (interface := state.interfaces.get(key)) is not None:
            plan += remove_interface(state, interface)
    for key in use.nodes:
        if (node := state.nodes.get(key)) is not None:
            plan += remove_node(state, node)
            plan += _remove_parameters_of(state, node)
    state.uses.drop(use.key)
    return plan


def _remove_parameters_of(state: State, node: Node) -> Plan:
    plan: Plan = []
    for parameter in state.parameters.by(node.owner):
        if parameter.node == node.tag:
            state.parameters.drop(parameter.key)
            plan += call_host(state, parameter, DropParameter(parameter_spec(parameter).key))
    return plan


def remove_node(state: State, node: Node) -> Plan:
    """Remove a node from the graph and stop it."""
    state.nodes.drop(node.key)
    drop_launched(state, node)
    return call_host(state, node, StopNode(node.tag))


def remove_recorder(state: State, recorder: Recorder) -> Plan:
    """Remove a recorder from the graph and stop it."""
    state.recorders.drop(recorder.key)
    return call_host(state, recorder, StopRecorder(recorder.tag))


def drop_launched(state: State, launch: Node) -> None:
    """Remove the nodes of a launch from the graph, which ends or starts anew."""
    for node in launched_by(state, launch):
        state.nodes.drop(node.key)


def launched_by(state: State, launch: Node) -> list[Node]:
    """Return the nodes of a launch."""
    return [each for each in state.nodes.by(launch.owner) if each.part_of == launch.tag] if launch.launch else []


def remove_interface(state: State, interface: Interface, away: bool = False) -> Plan:
    """Remove an interface and its connections from the graph; if it is only `away`, those of others wait for it."""
    plan: Plan = []
    for connection in state.connections.by(interface.key):
        plan += remove_connection(state, connection)
        if connection.by != interface.owner:
            plan += connections.end_left(state, connection, away)
    if not away:
        plan += connections.drop_waiting(state, interface.key)
    state.interfaces.drop(interface.key)
    host = state.host(interface.owner)
    if host:
        plan.append([Send(host, Unbind(interface.id), interface_ref(interface))])
    return plan


def remove_interfaces(state: State, owner: str, away: bool) -> Plan:
    """Remove all interfaces of a robot or environment from the graph."""
    return [
        sequence for interface in state.interfaces.by(owner) for sequence in remove_interface(state, interface, away)
    ]


def remove_connection(state: State, connection: Connection) -> Plan:
    """Remove a connection from the graph, and its routes."""
    plan = deactivate(state, connection)
    state.connections.drop(connection.key)
    return plan


HostCall = StartNode | StopNode | PutParameter | DropParameter | StartRecorder | StopRecorder


def call_host(state: State, record: Node | Parameter | Recorder, call: HostCall) -> Plan:
    """Return the plan for a call at a record's environment. An environment that is away gets it by its Sync."""
    host = state.host(record.owner)
    if not host:
        return []
    send = Send(host, call, ref(record))
    return [[send] if isinstance(call, StopNode | DropParameter | StopRecorder) else [send, MarkReady(ref(record))]]


def undo(state: State, outcome: Outcome) -> Plan:
    """Take back what a command made, because it did not become ready."""
    if outcome.parameter is not None:
        return _undo_parameter(state, outcome.parameter, outcome.replaced)
    plan: Plan = []
    if outcome.use is not None and state.uses.get(outcome.use.key) is outcome.use:
        plan += end_use(state, outcome.use)
    return plan + [sequence for awaited in outcome.awaits for sequence in _undo_one(state, awaited)]


def _undo_parameter(state: State, parameter: Parameter, before: Parameter | None) -> Plan:
    """Restore the parameter that a command replaced, unless a later command changed it again."""
    if state.parameters.get(parameter.key) is not parameter:
        return []
    if before is None:
        state.parameters.drop(parameter.key)
        return call_host(state, parameter, DropParameter(parameter_spec(parameter).key))
    state.parameters.put(before)
    return call_host(state, before, PutParameter(parameter_spec(before)))


def _undo_one(state: State, awaited: Ref) -> Plan:
    plan: Plan = []
    match awaited.kind:
        case "environment" if environment := state.environments.get(awaited.key):
            plan = remove_environment(state, environment)
        case "interface" if interface := state.interfaces.get(awaited.key):
            plan = remove_interface(state, interface, away=True)  # its owner may declare it again
        case "connection" if connection := state.connections.get(awaited.key):
            plan = remove_connection(state, connection)
        case "node" if node := state.nodes.get(awaited.key):
            plan = remove_node(state, node)
        case "recorder" if recorder := state.recorders.get(awaited.key):
            plan = remove_recorder(state, recorder)
    return plan
